"""Mobility maps: times, accuracy against single poses, and guarantees.

``python benchmarks atlas [PART ...]`` prints, for vehicles on the Jacksboro map of matplotlib (403
x 344 nodes; the vehicles are scaled to its cells, about 0.4 m here):

``rates``
    CPU time of 16 headings at every sixteenth row, the time that all rows would take, and
    the reasons of poses that do not stand.
``accuracy``
    Random poses beside `settle` and `best_utilisation`: largest difference of inclinations and
    tip-over margin, of a rigid vehicle from the nearest rest that `settle` finds from five starts;
    poses whose least friction is outside its bounds, and the widths of the bounds; the same on
    rough maps.
``guarantees``
    At random nodes: share of poses that are proved for every ground within an error of the map,
    median widths of their bounds, also relative to those of the computed extremes, and CPU time.
``memory``
    Largest memory of a process of ``slipfree atlas`` on GeoTIFFs of 1000, 4000 and 20 000 nodes a
    side, at equal numbers of nodes that are spread over the whole map.
``plans``
    Plans of a three-wheeler across 20 maps of hills, whose initial guess follows a route: whether
    they are solved, iterations, slip, friction used and cost.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import rasterio
from batch import ROUGH, cpu, ground
from common import PROBLEMS, run_parts

from slipfree import (
    Bicubic,
    ModelError,
    SlipfreeError,
    catalog,
    direct_kinematics,
    load_problem,
    run_problem,
    settle,
)
from slipfree.atlas.atlas import SAME_REST, TILT, atlas
from slipfree.core.trajectory import Outcome, path_length
from slipfree.files.maps.elevation import jacksboro
from slipfree.models.friction_feasibility import best_utilisation

CELL = 0.4  # to which the map is scaled [m]
VEHICLES = {
    "three-wheeler": catalog.three_wheeler(),
    "Rocky 7": catalog.rocky7(),
    "Ackermann car": catalog.ackermann(),
    "rigid four-wheeler": catalog.rigid_skid_steer(),
}
HEADINGS, COMPARED = 16, 100
NODES, ERRORS = 7, (0.001, 0.005, 0.02, 0.05)  # along each axis, and of the heights [m]
MAPS = 20  # of plans
SIDES = 1000, 4000, 20_000  # nodes of maps whose memory is measured
HILLS = (0.4, 0.6), (0.7, 0.8)  # root mean square of the heights [m], and friction, in turn
FIELD = (  # 18 m across hills
    *("terrain.synthetic.craters=", "keep_out=", "limits.utilisation=[0.0, 0.95]"),
    *("terrain.synthetic.x=[0.0, 24.0]", "terrain.synthetic.y=[0.0, 24.0]"),
    *("terrain.synthetic.power_law.longest=12.0", "terrain.synthetic.power_law.shortest=2.5"),
    *("start={x=12.0, y=3.0, heading=0.0}", "goal={x=12.0, y=21.0}", "plan.intervals=40"),
    *("plan.accuracy=0.002", "plan.duration=", "time.step=0.25"),
    *("driver={name='route', speed=0.5, turning_radius=2.5}", "solver.tolerance=1e-8"),
)


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
        atlas(model, headings=1, x=grid.x[:64:8], y=grid.y[:64:8])  # compiles
        took, found = cpu(lambda m=model: atlas(m, terrain, headings=HEADINGS, y=grid.y[2::16]), 1)
        count = found["reason"].size
        whole = HEADINGS * grid.x.size * grid.y.size
        reasons = Counter(found["reason"].ravel().astype(int).tolist())
        print(
            f"{name:20} {took:6.1f} s, {count / took:7.0f} poses/s, all rows "
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
    found = atlas(model, headings=rng.uniform(-3, 3, 4), x=x, y=y)
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
        rests += "rests" in found.bands and found["rests"][at] > 1
        away = [np.inf]
        for rest in rests_of(model, place, pose):
            away.append(_apart(found, at, rest))
            if away[-1] < SAME_REST:
                break
        apart.append(min(away))
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


def _apart(found: Any, at: tuple[int, ...], pose: Any) -> float:
    names = "roll", "pitch", "tip_over_margin"
    return float(max(abs(found[name][at] - pose[name][0]) for name in names))


def rests_of(model: Any, place: dict[str, float], pose: Any) -> Iterator[Any]:
    """Yield the rests that `settle` finds, also from starts tilted towards the four corners."""
    yield pose
    if model.rest.numel():
        for turn in np.pi / 4 + np.pi / 2 * np.arange(4):
            tilted = {
                "roll": pose["roll"][0] + TILT * np.cos(turn),
                "pitch": pose["pitch"][0] + TILT * np.sin(turn),
            }
            with suppress(ModelError):  # no rest from there
                yield settle(model, **place, z=pose["z"][0], **tilted)


def vehicle_of(name: str) -> Any:
    """Return a vehicle by name."""
    return VEHICLES[name]


def guarantees() -> None:
    """Print shares of proved poses, widths of their bounds, and times."""
    terrain, rng = scaled(), np.random.default_rng(1)
    grid = terrain.grid
    for name in ("three_wheeler", "articulated", "rocky7"):
        model = direct_kinematics(getattr(catalog, name)(), terrain)
        x, y = (np.sort(rng.choice(axis[8:-8], NODES, replace=False)) for axis in (grid.x, grid.y))
        headings, place = rng.uniform(0, 2 * np.pi, 2), {"x": x, "y": y, "compiled": False}
        for error in ERRORS:
            run_atlas = partial(atlas, model, headings=headings, **place)
            computed = run_atlas(error=error)
            plain, _ = cpu(run_atlas, 1)
            took, found = cpu(partial(run_atlas, guarantee=error), 1)
            proved, words = found["proved"] == 1, list[str]()
            for angle in ("roll", "pitch") if proved.any() else ():
                ends = (computed[f"{angle}_computed_{end}"][proved] for end in ("low", "high"))
                bounds = (found[f"{angle}_{end}"][proved] for end in ("low", "high"))
                width, reached = (np.diff(list(each), axis=0)[0] for each in (bounds, ends))
                share, half = np.nanmedian(width / reached), np.rad2deg(np.median(width)) / 2
                words.append(
                    f", {angle} +-{half:.2f} degrees, {share:.3f} times the computed width"
                )
            count = int(found.stands.sum())
            print(
                f"{name:14} {1e3 * error:4.0f} mm: {proved.sum()} of {count} poses proved"
                f"{''.join(words)}; {1e3 * (took - plain) / count:.1f} ms for each pose",
                flush=True,
            )


def memory() -> None:
    """Print the largest memory of processes that map grounds of several sizes."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "map.tif")
        for side in (SIDES[0], *SIDES):  # the first compiles the equations
            write_waves(path, side)
            words = "atlas", path, "three_wheeler", "--every", side // 200, "--headings", 4
            command = [sys.executable, "-m", "slipfree", *map(str, words), "--no-draw", "-j", "1"]
            start = time.perf_counter()
            done = subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL)
            _, code, used = os.wait4(done.pid, 0)
            took = time.perf_counter() - start
            print(
                f"{side:6} x {side} nodes, {path.stat().st_size / 1e6:6.0f} MB: "
                f"{used.ru_maxrss / 1024:5.0f} MB at most, {took:4.0f} s, status {code}",
                flush=True,
            )


def write_waves(path: Path, side: int) -> None:
    """Write a square GeoTIFF of waves with cells of 0.5 m, block by block."""
    place = rasterio.Affine(0.5, 0.0, 0.0, 0.0, -0.5, 0.5 * side)
    shape = {"width": side, "height": side, "count": 1, "dtype": "float32", "transform": place}
    blocks = {"tiled": True, "blockxsize": 256, "blockysize": 256}
    rows = np.arange(side)
    along = np.sin(rows / 11.0).astype(np.float32)
    with rasterio.open(path, "w", driver="GTiff", **shape, **blocks) as file:
        for first in range(0, side, 256):
            wave = 2 * np.cos(rows[first : first + 256, None] / 17.0).astype(np.float32) * along
            file.write(wave, 1, window=((first, first + len(wave)), (0, side)))


def plans() -> None:
    """Print plans that start from routes."""
    rows = []
    for seed in range(1, MAPS + 1):
        rough, friction = HILLS[seed % 2]
        settings = (
            *FIELD,
            f"terrain.friction={friction}",
            f"terrain.synthetic.power_law.seed={seed}",
            f"terrain.synthetic.power_law.rms={rough}",
        )
        try:
            run = run_problem(
                load_problem(PROBLEMS / "plan_crater_field.toml", settings)
            ).trajectory
        except SlipfreeError as error:
            print(f"map {seed:2}: {error}", flush=True)
            continue
        slip = np.trapezoid(np.hypot(run["slip_along"], run["slip_across"]), run.t, axis=0).mean()
        row = (
            run.outcome is Outcome.COMPLETE,
            run.facts["plan_iterations"].value,
            1e3 * float(slip) / path_length(run),
            float(run["utilisation"].max()),
            1e3 * run.facts["plan_cost_slip"].value + 0.01 * run.facts["plan_cost_effort"].value,
        )
        rows.append(row)
        print(
            f"map {seed:2}: {'solved' if row[0] else 'not solved'}, {row[1]} iterations, slip "
            f"{row[2]:.3f} mm/m, utilisation {row[3]:.3f}, cost {row[4]:.3f}",
            flush=True,
        )
    solved = np.array([row[1:] for row in rows if row[0]])
    middle = np.median(solved, axis=0)
    print(
        f"{len(solved)} of {MAPS} solved; medians: {middle[0]:.0f} iterations, slip "
        f"{middle[1]:.3f} mm/m, utilisation {middle[2]:.3f}, cost {middle[3]:.3f}; all "
        f"{sum(row[1] for row in rows)} iterations"
    )


def main() -> None:
    """Print the parts that the command line names."""
    parts = rates, accuracy, guarantees, memory, plans
    run_parts({part.__name__: part for part in parts})


if __name__ == "__main__":
    main()
