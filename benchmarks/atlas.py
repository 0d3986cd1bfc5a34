"""Mobility maps: times, accuracy against single poses, and errors of heights against draws.

``python benchmarks atlas [PART ...]`` prints, for vehicles on the Jacksboro map of matplotlib (403
x 344 nodes; the vehicles are scaled to its cells, about 0.4 m here):

``rates``
    CPU time of 16 headings at every sixteenth row, the time that all rows would take, and
    the reasons of poses that do not stand.
``accuracy``
    Random poses beside `settle` and `best_utilisation`: largest difference of inclinations and
    tip-over margin, poses whose least friction is outside its bounds, and the widths of the bounds;
    the same on rough maps.
``errors``
    Standard deviations over draws of the heights, beside the predicted ones.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from batch import ROUGH, cpu, ground
from common import run_parts

from slipfree import Bicubic, Grid, ModelError, catalog, direct_kinematics, settle
from slipfree.atlas.atlas import atlas
from slipfree.files.maps.elevation import jacksboro
from slipfree.models.friction_feasibility import best_utilisation

CELL = 0.4  # to which the map is scaled [m]
VEHICLES = {
    "three-wheeler": catalog.three_wheeler(),
    "Rocky 7": catalog.rocky7(),
    "Ackermann car": catalog.ackermann(),
    "rigid four-wheeler": catalog.rigid_skid_steer(),
}
HEADINGS, COMPARED, DRAWS = 16, 100, 200


def scaled() -> Bicubic:
    """Return the Jacksboro map with cells of `CELL`, and as steep as it is."""
    return Bicubic(jacksboro(CELL / jacksboro().spacing[0]), mu=0.6)


def rates() -> None:
    """Print times of maps."""
    terrain = scaled()
    grid = terrain.grid
    print(f"{grid.x.size} x {grid.y.size} nodes, {HEADINGS} headings")
    for name, vehicle in VEHICLES.items():
        model = direct_kinematics(vehicle, terrain)
        atlas(model, terrain, headings=1, x=grid.x[:64:8], y=grid.y[:64:8])  # compiles
        for error in (None, 0.05):
            took, found = cpu(
                lambda m=model, e=error: atlas(
                    m, terrain, headings=HEADINGS, y=grid.y[2::16], error=e
                ),
                1,
            )
            count = found["reason"].size
            whole = HEADINGS * grid.x.size * grid.y.size
            reasons = Counter(found["reason"].ravel().astype(int).tolist())
            print(
                f"{name:20} error {error}: {took:6.1f} s, {count / took:7.0f} poses/s, all rows "
                f"{whole * took / count:6.0f} s;",
                {found.reasons[k][:40]: n for k, n in reasons.most_common(5)},
                flush=True,
            )


def accuracy() -> None:
    """Print differences from single poses."""
    maps = {"Jacksboro": scaled()} | {name: ground(*rough) for name, rough in ROUGH.items()}
    for name, vehicle in VEHICLES.items():
        for map_name, terrain in maps.items():
            _compare(name, map_name, direct_kinematics(vehicle, terrain), terrain)


def _compare(name: str, map_name: str, model: Any, terrain: Bicubic) -> None:
    rng = np.random.default_rng(5)
    x, y = (
        np.sort(rng.uniform(axis[4], axis[-5], 12)) for axis in (terrain.grid.x, terrain.grid.y)
    )
    found = atlas(model, terrain, headings=rng.uniform(-3, 3, 4), x=x, y=y)
    apart, wrong, widths, missed, rests = [0.0], 0, [0.0], 0, 0
    places = rng.permutation(np.argwhere(np.ones(found["reason"].shape)))[:COMPARED]
    for at in map(tuple, places):
        place = {"heading": found.heading[at[0]], "x": x[at[1]], "y": y[at[2]]}
        try:
            pose = settle(model, **place)
        except ModelError:
            missed += found.stands[at]
            continue
        if not found.stands[at]:
            missed += found["reason"][at] == 1
            continue
        if "rests" in found.bands and found["rests"][at] > 1:
            rests += 1
            continue
        apart.append(
            max(
                abs(found[quantity][at] - pose[quantity][0])
                for quantity in ("roll", "pitch", "tip_over_margin")
            )
        )
        if "rests" not in found.bands:
            best = best_utilisation(vehicle_of(name), terrain, pose)["utilisation_best"][0]
            low, high = (found[f"least_friction_{k}"][at] for k in ("low", "high"))
            wrong += not low - 1e-6 <= terrain.mu * best <= high + 1e-6
            widths.append(high - low)
    print(
        f"{name:20} {map_name:13} {len(apart) - 1} poses: largest difference {max(apart):.0e} "
        f"(median {np.median(apart):.0e}), {wrong} outside the bounds, width 99.9 % "
        f"{np.quantile(widths, 0.999):.0e}; {missed} stand in one of both only, {rests} with "
        "several rests",
        flush=True,
    )


def vehicle_of(name: str) -> Any:
    """Return a vehicle by name."""
    return VEHICLES[name]


def errors() -> None:
    """Print ratios of standard deviations over draws and predicted ones."""
    terrain, rng = scaled(), np.random.default_rng(1)
    grid = terrain.grid
    for name, vehicle in VEHICLES.items():
        if name.startswith("rigid"):
            continue
        model = direct_kinematics(vehicle, terrain)
        ratios: dict[str, list[float]] = {}
        beyond = 0
        for _ in range(3):
            place = {"x": rng.choice(grid.x[9:-9]), "y": rng.choice(grid.y[9:-9])}
            found = atlas(
                model, terrain, headings=[0.5], x=[place["x"]], y=[place["y"]], error=0.02
            )
            if not found.stands.all():
                continue
            drawn = [_drawn(vehicle, grid, place, rng) for _ in range(DRAWS)]
            here = settle(model, heading=0.5, **place)
            for k, quantity in enumerate(("roll", "pitch", "tip_over_margin")):
                values = np.array([each[k] for each in drawn]) - here[quantity][0]
                predicted = found[f"{quantity}_deviation"].item()
                ratios.setdefault(quantity, []).append(
                    float(np.sqrt((values**2).mean())) / predicted
                )
                beyond += int((np.abs(values) > found[f"{quantity}_worst"].item()).sum())
        text = {key: (round(min(each), 2), round(max(each), 2)) for key, each in ratios.items()}
        print(
            f"{name:20} deviation over predicted {text}; {beyond} beyond the worst case", flush=True
        )


def _drawn(vehicle: Any, grid: Grid, place: dict[str, float], rng: Any) -> list[float]:
    """Return inclinations and margin on a map with other heights around a place."""
    i, j = (int(np.searchsorted(axis, place[k])) for axis, k in ((grid.x, "x"), (grid.y, "y")))
    near = slice(max(i - 24, 0), i + 24), slice(max(j - 24, 0), j + 24)
    z = grid.z[near] + 0.02 * rng.standard_normal(grid.z[near].shape)
    other = Bicubic(Grid(grid.x[near[0]], grid.y[near[1]], z), mu=0.6)
    pose = settle(direct_kinematics(vehicle, other), heading=0.5, **place)
    return [float(pose[quantity][0]) for quantity in ("roll", "pitch", "tip_over_margin")]


def main() -> None:
    """Print the parts that the command line names."""
    run_parts({"rates": rates, "accuracy": accuracy, "errors": errors})


if __name__ == "__main__":
    main()
