"""A skid-steered robot on a hillside: errors of predictions on the map.

``python benchmarks hill FOLDER [--judge OTHER] [--from-positions]`` reads public logs that are not
part of the project (source: docs/measured.md): folders of logs ``*.txt.gz``, one for each campaign,
and the elevation model. Each campaign is predicted with constants that were fitted to the others;
with ``--judge``, the logs of OTHER with constants that were fitted to all of FOLDER.
"""

from __future__ import annotations

import argparse
import gzip
import time
from pathlib import Path

import common  # noqa: F401 - path of the helpers of tests
import numpy as np
import pyproj

from helpers.drives import WHEELS, four_wheels
from slipfree.fit.drive_fit import WindowKind, by_logs, judge, rms
from slipfree.fit.drives import DriveLog, Model, Slopes
from slipfree.fit.estimate import Unknown
from slipfree.problem.verbs.fit import constant_rows
from slipfree.terrain.base import Grid

UTM = pyproj.Transformer.from_crs(4326, 32630, always_xy=True)
DT = 0.1  # between samples [s]
DELAY = 2  # from a command to the drives, in samples
UNIT, LEVER = 0.0217, 0.12  # [m/s] of a unit of the drives; units of an angular command, each side
LIMIT = 90.0  # of a side's command [%]
SMOOTHING, SHIFT = 1.5, (-1.5, 1.0)  # of the map; of the positions on it [m]
GAP, CHORD_ERROR, STATED = 1.5, 0.25, 0.1  # of good positions [s, m/s, m]
HALF, FRICTION = 0.4, 0.6  # half track and half wheelbase [m], friction: assumed, not stated
KINDS = WindowKind(5.0), WindowKind(20.0), WindowKind(0.0, 5.0)


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
    places = UTM.transform(a[fix, 10], a[fix, 9])
    east, north = (each - o for each, o in zip(places, origin, strict=True))
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
    place = at(east) + 1j * at(north) + complex(*SHIFT)
    one = np.zeros(t.size, int)
    return DriveLog(
        *(path.name.split(".")[0], path.parent.name, "hill", DT, four_wheels(HALF, HALF), sides),
        *(one, one, (t // 20).astype(int), place, good, np.ones(t.size, bool)),
        velocity=at(speed * np.exp(1j * (np.pi / 2 - course))),
        direction=np.where(linear > 20, 1, np.where(linear < -20, -1, 0)),
    )


def read_logs(folder: Path, origin: np.ndarray, has_velocities: bool) -> list[DriveLog]:
    """Return the logs of all campaigns in a folder, with or without the receiver's velocities."""
    logs = (read_log(path, origin) for path in sorted(folder.glob("*/*.txt.gz")))
    kept = [log for log in logs if log is not None]
    return kept if has_velocities else [log._replace(velocity=None) for log in kept]


MODEL = Model(
    (
        Unknown("radius_left", "radius", WHEELS[:2]),
        Unknown("radius_right", "radius", WHEELS[2:]),
        Unknown("turn", "turn", lower=0.3),  # the unit of an angular command is unknown
        Unknown("stiffness", "stiffness"),
        Unknown("turn_slope", "turn_slope"),
    ),
    {"inertia": 0.0, "friction": FRICTION},
    np.ones(4),
    WHEELS,
    HALF,
)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--judge", type=Path)
    parser.add_argument("--from-positions", action="store_true", help="courses from positions only")
    given = parser.parse_args()
    folder = given.folder
    heights = np.loadtxt(next(folder.glob("*DEM.csv"))).T
    origin = np.loadtxt(next(folder.glob("*Offset.csv")))
    grid = Grid(*(np.arange(float(count)) for count in heights.shape), heights)
    slopes = Slopes(grid, SMOOTHING)
    logs = read_logs(folder, origin, not given.from_positions)
    others = read_logs(given.judge, origin, not given.from_positions) if given.judge else []
    began = time.perf_counter()
    fit, _, scores = judge(MODEL, logs, (slopes, []), KINDS, others)
    print(f"{len(logs)} logs, {time.perf_counter() - began:.0f} s\n")
    print(
        "| windows | position rms [m] | median | along | across | course rms [deg] | median | "
        "90 % intervals hold [%] |\n| --- | --- | --- | --- | --- | --- | --- | --- |"
    )
    for kind, score in scores.items():
        errors, log = score.errors, score.windows.log
        value, low, high = by_logs(errors.position, log, rms)
        turn, least, most = np.rad2deg(by_logs(errors.turn, log, rms))
        inside = ", ".join(f"{100 * share:.0f}" for share in score.coverage)
        print(
            f"| {kind.words}, {log.size} | {value:.3f} ({low:.3f} to {high:.3f}) | "
            f"{np.median(errors.position):.3f} | {rms(errors.along):.3f} | "
            f"{rms(errors.across):.3f} | {turn:.1f} ({least:.1f} to {most:.1f}) | "
            f"{np.rad2deg(np.median(np.abs(errors.turn))):.1f} | {inside} |"
        )
    slips = (
        f"{np.rad2deg(low):.0f} to {np.rad2deg(high):.0f} deg {error:+.3f} ({count})"
        for low, high, count, error in scores[0.0, 5.0].slip()
    )
    print(f"\nerror of slip: {', '.join(slips)}")
    for name, *_, value, deviation, low, high, _, _ in map(dict.values, constant_rows(fit)):
        print(f"{name} {value:.3f} ({low:.3f} to {high:.3f}), deviation {deviation:.3f}")
