"""A skid-steered robot on a hillside: errors of baselines and of models on the map.

``python benchmarks hill FOLDER [--judge OTHER] [--models NAME ...] [--unknowns NAME ...]
[--from-positions] [--figures DIR]`` reads public logs that are not part of the project (source:
docs/measured.md): folders of logs ``*.txt.gz``, one for each campaign, and the elevation model.
Each campaign is predicted with constants that were fitted to the others; with ``--judge``, the logs
of OTHER with constants that were fitted to all of FOLDER.

``python benchmarks hill [--draws N]`` fits synthetic logs with known truth.
"""

from __future__ import annotations

import argparse
import gzip
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from slipfree import Coulomb, LeastSlip, catalog, direct_kinematics, quasi_statics
from slipfree.fit.ground_fit import (
    FITTED,
    Kind,
    Score,
    by_logs,
    fit_on_uncertain_map,
    judge,
    rms,
)
from slipfree.fit.ground_motion import (
    DRIVES_AND_SENSORS,
    MODELS,
    DriveLog,
    Slopes,
    slope_rates,
    windows_of,
    with_drives_and_sensors,
)
from slipfree.fit.ground_vehicle import vehicle_model
from slipfree.fit.unknowns import Unknown
from slipfree.terrain.base import Grid
from slipfree.terrain.grid_ops import disturbed

DT = 0.1  # between samples [s]
DELAY = 2  # from a command to the drives, in samples
UNIT, LEVER = 0.0217, 0.12  # [m/s] of a unit of the drives; units of an angular command, each side
LIMIT = 90.0  # of a side's command [%]
SMOOTHING, SHIFT = 1.5, (-1.5, 1.0)  # of the map; of the positions on it [m]
GAP, CHORD_ERROR, STATED = 1.5, 0.25, 0.1  # of good positions [s, m/s, m]
JUDGED = ["straight", "differential", "icr", "slope"]
FRICTION, CREEP = 0.6, 0.03  # of the vehicle's law: their ratio gives the measured slip on slopes
CART = catalog.skid_steer(  # assumed: the logs state no dimensions
    half_track=0.4, wheelbase=0.8, r1=0.06, r2=0.14, mass=70.0, wheel_mass=3.0
)
LEFT, RIGHT = (tuple(w.name for w in CART.wheels if side in w.name) for side in ("left", "right"))
UNKNOWNS = (  # "turn", since the unit of an angular command is unknown
    Unknown("radius_left", "radius", LEFT),
    Unknown("radius_right", "radius", RIGHT),
    Unknown("turn", "turn", lower=1.5),
)
CENTER = (
    Unknown("center_of_mass_ahead", "center_of_mass_ahead", lower=-0.06, upper=0.06),
    Unknown("center_of_mass_up", "center_of_mass_up", lower=-0.1, upper=0.2),
)
MADE = 16  # synthetic logs
FURTHER = 4  # maps with further errors
TRUE = {"scale": 1.02, "track": 0.7, "drift": 0.02, "slip_slope": 0.2, "turn_slope": 2.0}
VEHICLES = {
    "vehicle_kinematics": vehicle_model(
        "vehicle with least slip",
        lambda ground, vehicle, law: direct_kinematics(vehicle, ground, slip=law),
        CART,
        LeastSlip(),
        UNKNOWNS,
        FRICTION,
    ),
    "vehicle_friction": vehicle_model(
        "vehicle with friction",
        lambda ground, vehicle, law: quasi_statics(vehicle, ground, law=law),
        CART,
        Coulomb(creep=CREEP),
        (*UNKNOWNS, *CENTER),
        FRICTION,
    ),
}
ALL = MODELS | {name: with_drives_and_sensors(model, UNKNOWNS) for name, model in VEHICLES.items()}
Scores = dict[str, dict[Kind, Score]]
KINDS = {FITTED: "5 m of path", (20.0, 0.0): "20 m of path", (0.0, 5.0): "5 s"}


def utm(lat: np.ndarray, lon: np.ndarray, meridian: float = -3.0) -> tuple[np.ndarray, np.ndarray]:
    """Return easting and northing on WGS 84 (Krueger's series) [m]."""
    flattening = 1 / 298.257223563
    n = flattening / (2 - flattening)
    radius = 6378137.0 / (1 + n) * (1 + n**2 / 4 + n**4 / 64)
    series = (
        n / 2 - 2 / 3 * n**2 + 5 / 16 * n**3,
        13 / 48 * n**2 - 3 / 5 * n**3,
        61 / 240 * n**3,
    )
    p, q, c = np.radians(lat), np.radians(lon - meridian), 2 * np.sqrt(n) / (1 + n)
    t = np.sinh(np.arctanh(np.sin(p)) - c * np.arctanh(c * np.sin(p)))
    xi, eta = np.arctan2(t, np.cos(q)), np.arctanh(np.sin(q) / np.hypot(1, t))
    east, north = eta.copy(), xi.copy()
    for j, s in enumerate(series, 1):
        east += s * np.cos(2 * j * xi) * np.sinh(2 * j * eta)
        north += s * np.sin(2 * j * xi) * np.cosh(2 * j * eta)
    return 5e5 + 0.9996 * radius * east, 0.9996 * radius * north


def percent_to_reading(u: np.ndarray) -> np.ndarray:
    """Return the steady drive reading of a linear command [%]."""
    return 0.196 * u + 0.00144 * u * np.abs(u)


def read_log(path: Path, origin: np.ndarray) -> DriveLog | None:
    """Return a log; None if it is shorter than 5 s."""
    rows = []
    with gzip.open(path, "rt", errors="replace") as file:
        for words in map(str.split, file):
            if len(words) == 16:
                h, m, s = words[15].split(":")
                rows.append([*map(float, words[:15]), 3600 * int(h) + 60 * int(m) + float(s)])
    a = np.array(rows)
    clock = a[:, 15] - a[0, 15]
    fix = np.append(True, np.any(np.diff(a[:, [9, 10, 12, 13]], axis=0) != 0, axis=1))
    east, north = (each[fix] - o for each, o in zip(utm(a[:, 9], a[:, 10]), origin, strict=True))
    t, when = np.arange(0, clock[-1], DT), clock[fix]
    if t.size <= 50:
        return None

    def at(values: np.ndarray, shift: float = 0.0) -> np.ndarray:
        return np.interp(t + shift, when, values)

    speed, course = 0.514444 * a[fix, 13], np.radians(a[fix, 12])
    chord = np.hypot(at(east, 0.5) - at(east, -0.5), at(north, 0.5) - at(north, -0.5))
    mean = np.convolve(at(speed), np.ones(11) / 11, "same")
    good = at(np.gradient(when)) < GAP
    good &= (np.abs(chord - mean) < CHORD_ERROR) & (at(a[fix, 14]) <= STATED)
    good = np.convolve(~good, np.ones(11), "same") < 0.5
    hold = np.clip(np.searchsorted(clock, t + 1e-9, side="right") - 1, 0, len(clock) - 1)
    linear, angular = a[hold, 0], a[hold, 1]
    one, other = (np.clip(linear + sign * angular, -LIMIT, LIMIT) for sign in (1, -1))
    forward, turn = percent_to_reading((one + other) / 2), LEVER * (one - other) / 2
    sides = UNIT * np.column_stack([forward + turn, forward - turn])
    sides = np.concatenate([np.repeat(sides[:1], DELAY, axis=0), sides[:-DELAY]])
    return DriveLog(
        path.name.split(".")[0],
        path.parent.name,
        DT,
        np.column_stack([at(east), at(north)]) + SHIFT,
        np.column_stack([at(speed * np.sin(course)), at(speed * np.cos(course))]),
        at(speed),
        good,
        np.where(linear > 20, 1, np.where(linear < -20, -1, 0)),
        sides,
    )


def read_logs(folder: Path, origin: np.ndarray, has_velocities: bool) -> list[DriveLog]:
    """Return the logs of all campaigns in a folder, with or without the receiver's velocities."""
    logs = (read_log(path, origin) for path in sorted(folder.glob("*/*.txt.gz")))
    return [log._replace(is_velocity_measured=has_velocities) for log in logs if log is not None]


def made_logs(rng: np.random.Generator, slopes: Slopes, draws: int) -> list[list[DriveLog]]:
    """Return logs of a robot with the constants `TRUE` on a synthetic hillside, without errors."""
    count, dt, fine, n = 400, 0.2, 10, draws * MADE
    values = {name: np.full(n, value) for name, value in TRUE.items()}
    place, heading = rng.uniform(-12, 12, (2, n)).T @ [1, 1j], rng.uniform(-3, 3, n)
    sides, path = np.empty((count, n, 2)), np.empty((count, n), dtype=complex)
    for k in range(count):
        if k % 15 == 0:  # a new command every three seconds; back to the middle from 20 m
            away = np.sign(np.angle(-place * np.exp(-1j * heading))) * (np.abs(place) > 20)
            turn = rng.normal(0, 0.06, n) + 0.08 * away
        sides[k], path[k] = np.column_stack([0.5 - turn / 2, 0.5 + turn / 2]), place
        for _ in range(fine):
            up, _ = slopes.tilt(place, heading)
            v, _, yaw = slope_rates(values, *sides[k].T, up)
            middle = heading + yaw * dt / fine / 2
            place = place + v * np.sqrt(1 - up**2) * dt / fine * np.exp(1j * middle)
            heading = heading + yaw * dt / fine
    places = np.stack([path.real, path.imag], axis=2)
    velocity, sure = np.gradient(places, dt, axis=0), np.ones(count)
    logs = [
        DriveLog(
            str(k),
            "made",
            dt,
            places[:, k],
            velocity[:, k],
            np.hypot(*velocity[:, k].T),
            sure > 0,
            sure,
            sides[:, k],
        )
        for k in range(n)
    ]
    return [logs[k : k + MADE] for k in range(0, n, MADE)]


def synthetic(draws: int) -> Iterator[str]:
    """Yield bias and coverage of fits of synthetic logs, on the true map and on wrong ones."""
    axis = np.arange(-40.0, 41.0)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    hill = Grid(axis, axis, 2.5 * np.sin(x / 9) * np.cos(y / 11) + 0.05 * x)
    made = made_logs(np.random.default_rng(0), Slopes(hill, 0.0), draws)
    for error in 0.0, 0.1:
        found = []
        for draw, logs in enumerate(made):
            rng = np.random.default_rng(draw)
            seen = [
                log._replace(place=log.place + rng.normal(0, 0.02, log.place.shape)) for log in logs
            ]
            windows = windows_of(logs, 5.0)
            grid = disturbed(hill, error, 3.0, draw) if error else hill
            more = [
                Slopes(disturbed(grid, error, 3.0, draws + FURTHER * draw + k), 0.0)
                for k in range(FURTHER if error else 0)
            ]
            maps = Slopes(grid, 0.0), more
            found.append(fit_on_uncertain_map(MODELS["slope"], seen, windows, maps))
        yield (
            f"{draws} draws, about {len(windows.log)} windows of {MADE} logs, positions to 20 mm, "
            f"map to {error:g} m: bias, deviation, stated, coverage of 95 %"
        )
        for name, true in TRUE.items():
            values = np.array([each.values[name] for each in found])
            ends = np.array([each.intervals[name] for each in found])
            inside = np.mean((ends[:, 0] <= true) & (true <= ends[:, 1]))
            stated = np.mean([each.deviation[name] for each in found])
            yield (
                f"  {name:11} truth {true:5.3f}, bias {values.mean() - true:+.1e} (standard error "
                f"{values.std(ddof=1) / np.sqrt(draws):.1e}), deviation {values.std(ddof=1):.2e}, "
                f"stated {stated:.2e}, coverage {100 * inside:.1f} %"
            )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--judge", type=Path)
    parser.add_argument("--figures", type=Path)
    parser.add_argument("--from-positions", action="store_true", help="courses from positions only")
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--models", nargs="+", choices=ALL, default=JUDGED)
    parser.add_argument("--unknowns", nargs="+", choices=DRIVES_AND_SENSORS, default=[])
    given = parser.parse_args()
    if given.folder is None:
        for line in synthetic(given.draws):
            print(line, flush=True)
        return
    folder = given.folder
    heights = np.loadtxt(next(folder.glob("*DEM.csv"))).T
    origin = np.loadtxt(next(folder.glob("*Offset.csv")))
    grid = Grid(*(np.arange(float(count)) for count in heights.shape), heights)
    slopes = Slopes(grid, SMOOTHING)
    how = origin, not given.from_positions
    logs = read_logs(folder, *how)
    others = read_logs(given.judge, *how) if given.judge else []
    began = time.perf_counter()
    unknowns = [Unknown(name, name) for name in given.unknowns]
    models = {name: with_drives_and_sensors(ALL[name], unknowns) for name in given.models}
    scores, fits = judge(logs, slopes, models, others=others)
    print(f"{len(logs)} logs, {time.perf_counter() - began:.0f} s")
    for part in (errors_of, against, slips_of):
        for line in part(scores):
            print(line)
        print()
    for name, each in fits.items():
        for fitted in each:
            words = (
                f"{key} {value:.3f} ({fitted.deviation[key]:.3f})"
                for key, value in fitted.values.items()
            )
            print(f"{ALL[name].words}: {', '.join(words)}")
    if given.figures:
        save_figure(scores, given.figures)


def errors_of(scores: Scores) -> Iterator[str]:
    """Yield tables of the errors of all models by kind of window."""
    for kind, words in KINDS.items():
        first = next(iter(scores.values()))[kind]
        logs = len(np.unique(first.windows.log))
        yield f"\nwindows of {words}: {len(first.grade)} of {logs} logs\n"
        yield (
            "| model | position rms [m] | median | along | across | course rms [deg] | median | "
            "90 % intervals hold [%] |\n| --- | --- | --- | --- | --- | --- | --- | --- |"
        )
        for name, own in scores.items():
            errors, log = own[kind].errors, own[kind].windows.log
            value, low, high = by_logs(errors.position, log, rms)
            turn, least, most = np.rad2deg(by_logs(errors.course, log, rms))
            inside = ", ".join(f"{100 * share:.0f}" for share in own[kind].coverage)
            yield (
                f"| {ALL[name].words} | {value:.3f} ({low:.3f} to {high:.3f}) | "
                f"{np.median(errors.position):.3f} | {rms(errors.along):.3f} | "
                f"{rms(errors.across):.3f} | {turn:.1f} ({least:.1f} to {most:.1f}) | "
                f"{np.rad2deg(np.median(np.abs(errors.course))):.1f} | {inside} |"
            )


def against(scores: Scores, other: str = "icr") -> Iterator[str]:
    """Yield the position errors of all models relative to those of another one."""
    for name in scores if other in scores else ():
        if name == other:
            continue
        for kind, words in KINDS.items():
            squares = np.column_stack([scores[k][kind].errors.position ** 2 for k in (name, other)])

            def ratio(values: np.ndarray) -> float:
                return float(np.sqrt(values[:, 0].mean() / values[:, 1].mean()) - 1)

            value, low, high = 100 * np.array(
                by_logs(squares, scores[name][kind].windows.log, ratio)
            )
            yield (
                f"- {ALL[name].words} against {ALL[other].words}, {words}: position rms "
                f"{value:+.1f} % ({low:+.1f} to {high:+.1f})"
            )


def slips_of(scores: Scores) -> Iterator[str]:
    """Yield the error of the slip of all models by class of grade, from windows of 5 s."""
    for name, own in scores.items():
        classes = (
            f"{np.rad2deg(low):.0f} to {np.rad2deg(high):.0f} deg {error:+.3f} ({count})"
            for low, high, count, error in own[0.0, 5.0].slip()
        )
        yield f"- error of slip, {ALL[name].words}: {', '.join(classes)}"


def save_figure(scores: Scores, folder: Path) -> None:
    """Save the figure of position errors and of slip."""
    from slipfree.show.fit_figures import ground_plot
    from slipfree.show.plots import save

    words = {name: ALL[name].words for name in scores}
    save([ground_plot("measured_hill", {words[name]: own for name, own in scores.items()})], folder)
