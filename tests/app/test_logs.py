"""Tests of fits: logs as others write them, read as meant or refused, and the command."""

import csv
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import slipfree as sf
from helpers.cases import DATA, PROBLEMS
from helpers.commands import error_of, printed, refused, refuses, sets
from helpers.drives import HALF, HILL, Truth, drives
from slipfree import DataError, catalog
from slipfree.core.records import Array
from slipfree.files.logs import MotionLog, check_motion, rate_ratios
from slipfree.files.mcap import read_motion_log, write_mcap
from slipfree.files.netcdf import write
from slipfree.files.tables import write_rows
from slipfree.files.toml import ProblemError
from slipfree.files.vehicle_toml import vehicle_text
from slipfree.fit.drives import DriveLog, lanes_of
from slipfree.geometry.frame import unit_vector
from slipfree.problem.load import load_problem
from slipfree.problem.verbs.fit import _Reader, inputs_of, model_of
from slipfree.problem.verbs.inverse import _points, _read_file

pytestmark = pytest.mark.usefixtures("folder")

RADIUS, TRACK, HEAD = 0.153, 0.52, "t,left,right,x,y,heading"
PROBLEM = (DATA / "fit_of_a_log.toml").read_text()

LEAST_SLIP = """
[constants]
stiffness = 1e-3
friction = 1
delay = 0
age = 0
"""


def drive(seed: int = 0, start: complex = 0j) -> Array:
    """Return times, rates of the sides and poses of a differential drive, shape (400, 6)."""
    rng, fine = np.random.default_rng(seed), 20
    t = np.linspace(0, 39.9, 399 * fine + 1)
    knots = rng.uniform(1.5, 5, (2, 21))
    left, right = (np.interp(t, np.linspace(0, 40, 21), each) for each in knots)
    speed, yaw_rate = RADIUS * (left + right) / 2, RADIUS * (right - left) / TRACK

    def integral(rate: Array) -> Array:
        return np.append(0.0, np.cumsum((rate[1:] + rate[:-1]) / 2) * t[1])

    heading = 0.1 + integral(yaw_rate)
    place = start + integral(speed * np.exp(1j * heading).real)
    place = place + 1j * integral(speed * np.exp(1j * heading).imag)
    return np.column_stack([t, left, right, place.real, place.imag, heading])[::fine]


DRIVE, OTHER = drive(), drive(1, 9 - 10j)


def table(rows: Array, head: str = HEAD, separator: str = ",") -> str:
    """Return rows as text."""
    lines = (separator.join(f"{value:.9f}" for value in row) for row in rows.tolist())
    return "\n".join([head.replace(",", separator), *lines, ""])


def changed(columns: dict[int, Callable[[Array], Array]], head: str = HEAD) -> str:
    """Return the drive with changes of some columns."""
    rows = DRIVE.copy()
    for k, change in columns.items():
        rows[:, k] = change(rows[:, k])
    return table(rows, head)


def stamped(stamp: Callable[[float], str], head: str = HEAD) -> str:
    """Return the drive with other times."""
    rest = (",".join(f"{value:.9f}" for value in row[1:]) for row in DRIVE.tolist())
    return "\n".join(
        [head, *(f"{stamp(t)},{row}" for t, row in zip(DRIVE[:, 0], rest, strict=True))]
    )


def mixed(rows: Array) -> str:
    """Return rows sorted by time."""
    return table(rows[np.argsort(rows[:, 0], kind="stable")])


def merged() -> str:
    """Return poses and rates in rows of their own, as topics that were joined."""
    rows = np.repeat(DRIVE, 2, axis=0)
    rows[1::2, 0] += 1e-5
    rows[::2, 3:] = rows[1::2, 1:3] = np.nan
    return table(rows).replace("nan", "")


def sparse(rows: Array) -> Array:
    """Return rows of which every tenth has a pose."""
    is_pose = np.arange(rows.shape[1]) // 3 == 1
    return np.where(np.arange(len(rows))[:, None] % 10 * is_pose > 0, np.nan, rows)


def quaternions(names: str, count: int) -> str:
    """Return the drive with quaternions in place of headings."""
    half, zero = DRIVE[:, 5] / 2, 0 * DRIVE[:, 0]
    parts = [zero, zero, np.sin(half), np.cos(half)][4 - count :]
    return table(np.column_stack([DRIVE[:, :5], *parts]), names)


ROS = "t,left,right,pose.position.x,pose.position.y," + ",".join(
    f"pose.orientation.{part}" for part in "xyzw"
)
READ = {  # text, further columns in the problem
    "headings that wrap": (changed({5: lambda h: (h + np.pi) % (2 * np.pi) - np.pi}), ""),
    "degrees, named": (changed({5: np.rad2deg}, HEAD + "_deg"), ""),
    "semicolons and decimal commas": (table(DRIVE, separator=";").replace(".", ","), ""),
    "tabs": (table(DRIVE, separator="\t"), ""),
    "a header again": (table(DRIVE).replace("\n20.000000000", f"\n{HEAD}\n20.000000000"), ""),
    "dates": (stamped(lambda t: f"2024-05-01 12:00:{t:09.6f}"), ""),
    "microseconds, named": (stamped(lambda t: f"{1e6 * (1.7e9 + t):.0f}"), 't = "t [us]"'),
    "nanoseconds, named": (stamped(lambda t: f"{1e9 * (1.7e9 + t):.0f}"), 't = "t [ns]"'),
    "seconds and nanoseconds": (
        stamped(lambda t: f"1700000000,{1e9 * t:.0f}", "h.secs,h.nsecs" + HEAD[1:]),
        "",
    ),
    "quaternions": (quaternions("t,left,right,x,y,qx,qy,qz,qw", 4), ""),
    "quaternions by number": (quaternions("t,left,right,x,y,q[1],q[2],q[3],q[0]", 4), ""),
    "quaternions of ArduPilot": (quaternions("t,left,right,x,y,Q2,Q3,Q4,Q1", 4), ""),
    "quaternions of a plane": (quaternions("t,left,right,x,y,qz,qw", 2), ""),
    "names of messages": (quaternions(ROS, 4), ""),
    "topics in rows of their own": (merged(), ""),
    "repeated rows": (table(np.repeat(DRIVE, 2, axis=0)), ""),
}


def read(text: str, columns: str = "") -> tuple[DriveLog, str]:
    """Return a log at equal intervals, and the line on what is left out of it."""
    Path("log.csv").write_text(text)
    Path("fit.toml").write_text(PROBLEM + columns)
    problem, rows = load_problem("fit.toml", command="fit"), list[tuple[str, str]]()
    (log,) = _Reader(problem, inputs_of(problem), None, rows).read([Path("log.csv")], ())
    return log, rows[0][1]


@pytest.mark.parametrize("kind", READ)
def test_logs_that_are_read_as_they_are_meant(kind: str) -> None:
    wanted, _ = read(table(DRIVE))
    found, words = read(*READ[kind])
    assert words.startswith("400 samples")
    assert not re.search("gaps|begin or end", words)
    assert wanted.heading is not None
    assert found.heading is not None
    turned = found.heading - wanted.heading
    assert_allclose(turned, 2 * np.pi * np.round(turned[0] / 2 / np.pi), atol=2e-5)
    assert_allclose(found.place, wanted.place, atol=2e-5)
    assert_allclose(found.inputs, wanted.inputs, atol=1e-3)
    assert found.good.all()


def test_inputs_of_rows_without_poses_are_used() -> None:
    """Samples of several rows have means, whose integral is that of the rows."""
    fast = DRIVE * [0.2, 5, 5, 1, 1, 1]
    rows = sparse(np.column_stack([fast, (fast[:, 2] - fast[:, 1]) * RADIUS / TRACK]))
    found, words = read(table(rows, HEAD + ",gyro"), "yaw_rate = 'gyro'")
    assert words == "79 samples; 360 rows left out: no position or heading (inputs are used)"
    for each in (found, found._replace(yaw_rate=found.inputs @ [RADIUS, -RADIUS] / TRACK)):
        assert_allclose(each.turned, DRIVE[:391:5, 5] - 0.1, atol=2e-3)


LATE = [*range(40), 41, 40, *range(42, 400)]
COMPASS = {5: lambda heading: np.pi / 2 - heading}
TICKS = np.append(0.0, np.cumsum(DRIVE[1:, 1]))
REFUSED = {
    "a clock that starts again": (
        table(np.vstack([DRIVE[:200], OTHER[:200]])),
        "found 0 s after 19.9 s in line 202: the clock starts again; divide the log before this",
    ),
    "a clock that jumps": (
        changed({0: lambda t: t + 1.7e9 * (t > 19.95)}),
        "found 1700000020 s after 19.9 s in line 202: the clock jumps; divide the log",
    ),
    "a row without order": (table(DRIVE[LATE]), "in line 43: one row is late; sort the rows by"),
    "rows without order": (table(DRIVE[::-1]), "in line 3: so do many others; sort the rows"),
    "w last, named first": (
        quaternions("t,left,right,x,y,qw,qx,qy,qz", 4),
        "found tilts of more than 45 degrees in more than 10% of the rows; .*: w is",
    ),
    "drives sorted, with other times": (
        mixed(np.vstack([DRIVE, OTHER[::3] + 0.03 * np.eye(6)[0]])),
        "in line 3: two drives were probably sorted by time into one file; use a file for each",
    ),
    "times in whole seconds": (
        stamped(lambda t: f"2024-05-01 12:00:{int(t + 1e-9):02d}"),
        "in line 3 at t = 0 s; .* if the times are rounded, write them with more digits",
    ),
    "dates of another form": (
        stamped(lambda t: f"05/01/2024 12:00:{t:06.3f}"),
        r"log.csv:2: .* found '05/01/2024.*; write dates as in 2026-03-01T12:00:00.5",
    ),
    "degrees of latitude": (
        changed({3: lambda x: -4.5 + x / 89e3, 4: lambda y: 36.7 + y / 111e3}),
        "found degrees of longitude and latitude; project them to the map's system, EPSG:32630",
    ),
    "hundredths of degrees": (changed({5: lambda h: 100 * np.rad2deg(h)}), "in cdeg .* .cdeg."),
    "headings in degrees": (changed({5: np.rad2deg}), "in deg .*as in 'heading \\[deg\\]'"),
    "headings clockwise from north": (
        changed(COMPASS),
        "found the opposite: clockwise from north.* rad at the course .* rad.; write "
        "90 deg minus the heading$",
    ),
    "headings from another axis": (
        changed({5: lambda heading: heading - np.pi / 2}),
        "found a constant difference of 90 deg .* frame=rep103 .*; else add 90 deg to them",
    ),
    "north and east exchanged": (
        table(DRIVE[:200, [0, 1, 2, 4, 3, 5]]),
        "turns against headings and wheels .*; exchange the columns of x, to the east",
    ),
    "sides exchanged": (
        table(DRIVE[:, [0, 2, 1, 3, 4, 5]]),
        "to the left where right wheels are faster, .*; exchange the rates of the sides",
    ),
    "north, east and down": (
        changed(dict.fromkeys((4, 5), np.negative)),
        "change their sign if they are positive backward, or change the signs of y and of",
    ),
    "left rates positive backward": (
        changed({1: np.negative}),
        "agree with the opposite sign of the left side; change its sign",
    ),
    "right rates positive backward, without headings": (
        changed({2: np.negative}, "t,left,right,x,y,other"),
        "agree with the opposite sign of the right side; change its sign",
    ),
    "nanoseconds": (
        changed({0: lambda t: 1.7e18 + 1e9 * t}),
        r"probably nanoseconds; name it 't \[ns\]' in \[data.columns\]",
    ),
    "milliseconds": (
        changed({0: lambda t: 1e3 * t}),
        r"at most 10 s apart, found 100 s \(median\); if the times are in other units, name",
    ),
    "counts of encoders that start again": (
        table(np.column_stack([DRIVE[:, 0], TICKS % 50, TICKS % 60, DRIVE[:, 3:]])),
        "probably angles or counts of an encoder; write their change over the time",
    ),
    "counts of every sample": (
        changed(dict.fromkeys((1, 2), lambda rate: np.round(15 * rate, 3))),
        "moved 0.0679 times as far as its wheels rolled, probably since the log has another unit",
    ),
    "speeds of wheels": (
        changed(dict.fromkeys((1, 2), lambda rate: 0.15 * rate)),
        "probably .*speeds of the wheels in m/s, which must be divided by the radius",
    ),
    "speeds of wheels, named": (
        table(DRIVE, "t,left [m/s],right [m/s],x,y,heading"),
        "expected values in rad/s .* found m/s; divide the speeds by the radius of the wheels",
    ),
    "rates of one side in rpm": (changed({2: lambda r: r / 0.10472}), "on the right .* in rpm, as"),
    "a side that is not recorded": (changed({1: np.zeros_like}), "on both sides or zero on one"),
    "positions without motion": (changed(dict.fromkeys((3, 4), np.zeros_like)), "that change"),
    "y to the right": (changed({4: np.negative}), "headings and wheels .*; change the sign of y$"),
    "late inputs": (table(np.c_[DRIVE[30:, 0], DRIVE[:-30, 1:3], DRIVE[30:, 3:]]), "3 s before"),
    "no rates": (table(DRIVE[:, [0, 3, 4, 5]], "t,x,y,heading"), "found no column 'right'"),
}


@pytest.mark.parametrize("kind", REFUSED)
def test_logs_that_are_refused(kind: str) -> None:
    text, words = REFUSED[kind]
    refuses(DataError, words, read, text)


def test_a_log_without_windows_is_refused() -> None:
    Path("log.csv").write_text(table(DRIVE[:20]))
    Path("fit.toml").write_text(PROBLEM)
    assert "found none; use longer logs" in printed("fit", "fit.toml", "--no-draw", code=2)


def test_constants_take_the_place_of_unknowns() -> None:
    log, _ = read(table(DRIVE))
    constants = ["constants.radius=0.2", "constants.track=0.7"]
    problem = load_problem("fit.toml", constants, command="fit")
    model = model_of(problem, inputs_of(problem), [log])
    lanes = lanes_of(model, model.start[None], {})
    assert_allclose(lanes.radius, 0.2)
    assert_allclose(lanes.values["track"], 0.7)
    assert not {"radius", "track"} & {each.quantity for each in model.unknowns}


def test_a_drive_to_one_side_has_no_sense_of_turning() -> None:
    """A straight drive along its heading is accepted, and a drive without headings."""
    assert read(changed({}, "t,left,right,x,y,other"))[0].heading is None
    rows = DRIVE.copy()
    rows[:, 1] = rows[:, 2] = 2.0
    rows[:, 3:] = np.column_stack([2 * RADIUS * rows[:, 0], 0 * rows[:, 0], 0 * rows[:, 0]])
    assert read(table(rows))[1] == "400 samples"


def test_remedies_work() -> None:
    """Parts of a divided log are one fit or a test; degrees are projected; a compass is turned."""
    for name, rows in (("a.csv", DRIVE), ("b.csv", sparse(OTHER))):
        Path(name).write_text(table(rows))
    problem = 'model = "kinematics"\n' + PROBLEM + LEAST_SLIP
    Path("fit.toml").write_text(problem.replace('"log.csv"', '["a.csv", "b.csv"]'))
    shown = json.loads(printed("--json", "fit", "fit.toml", "--no-draw"))
    assert shown["facts"]["fitted windows"] == "38"
    found = {each["name"]: each["value"] for each in shown["estimates"]}
    for name, true in (("radius", RADIUS), ("track", TRACK)):
        assert found[name] == pytest.approx(true, rel=1e-4)

    Path("fit.toml").write_text(problem.replace("log.csv", "a.csv"))
    own = ("fit", "fit.toml", "--no-draw", "--predict")
    shown = json.loads(printed("--json", *own, "b.csv"))
    assert shown["facts"]["fitted windows"] == "19"
    assert shown["errors"][0]["position_rms"] < 1e-3
    assert "found a.csv in both" in printed(*own, "a.csv", code=2)

    degrees = changed({3: lambda x: -4.5 + x / 89e3, 4: lambda y: 36.7 + y / 111e3})
    minutes = degrees.replace("x,y", "lon,lat").replace(",36.", ",3642.")
    refuses(DataError, "perhaps degrees and minutes", read, minutes, 'x = "lon"\ny = "lat"')
    refused = error_of(DataError, read, degrees.replace("x,y", "lon,lat"))
    (command,) = re.findall(r'python -c "(.*)"', str(refused))
    subprocess.run([sys.executable, "-c", command], check=True)
    # the scale of the projection, and its north
    found, wanted = read(Path("log_m.csv").read_text())[0], read(table(DRIVE))[0]
    moved = [np.diff(each.place[::20]) for each in (found, wanted)]
    assert_allclose(*moved, atol=0.02)


def test_rows_and_windows_are_left_out_by_reason() -> None:
    rows = np.column_stack([DRIVE, np.full(400, 0.01)])
    rows[50:60, 6], rows[50:60, 3] = 3.0, 100.0
    rows[205, 3] += 5
    rows[300:, 3:5] += 4
    rows[250:280, 3:5] = rows[250, 3:5]
    text = table(np.delete(rows, np.arange(102, 119), axis=0), HEAD + ",sigma")
    text = text.replace(f",{rows[350, 5]:.9f},", ",nan,")
    _, words = read(text, 'error = "sigma"')
    for part in (
        "1 rows left out: no position or heading",
        "10 rows left out: stated error above 0.1 m",
        "1 rows left out: position that jumps away and back",
        "inputs not given for at most 1.8 s, from t = 10.1 s",
        "29 at a position that is repeated while the wheels turn",
        "2 gaps or leaps of the position",
    ):
        assert part in words, words


def test_commands_that_stop() -> None:
    """Commands are held, or zero after a time-out; the longest hold is reported."""
    t = np.append(np.arange(0, 1.05, 0.1), np.arange(19, 20.05, 0.1)).round(1)
    rows = [f"{each},{1 + each},{'' if k % 2 else 0.1}" for k, each in enumerate(t.tolist())]
    file = Path("cmd.csv")
    file.write_text("\n".join(["t,v_x,omega_z", *rows]))
    columns, notes = _read_file(file, 25.0, None)
    assert notes == ["held for at most 18 s, from 1 s"]
    assert [value for _, value in columns["omega_z"]] == [0.1] * 22
    columns, notes = _read_file(file, 25.0, 0.5)
    zeros = [time for time, value in columns["v_x"] if value == 0]
    assert_allclose(zeros, [1.5, 20.5])
    assert notes == ["zero 0.5 s after the last command, for at most 17.5 s, from 1.5 s"]
    for row, words in (
        ("0.5,1,1", "found 0.5 s after 20 s in line 24: the clock starts again; divide the log"),
        ("20,2,1", "found 20 s after 20 s with other values; keep one row for each time"),
    ):
        file.write_text("\n".join(["t,v_x,omega_z", *rows, row]))
        refuses(DataError, words, _read_file, file, 25.0, None)


def test_headings_of_a_path() -> None:
    """They are read across half a turn, and refused if they turn against the path."""
    t = np.arange(21.0)
    angle = 3.0 + 0.1 * t
    rows = np.column_stack([t, np.sin(angle), -np.cos(angle), np.angle(np.exp(1j * angle))])
    problem = 'verb = "inverse"\nframe = "rep103"\npath.file = "way.csv"\nstart = {}\n'
    problem += "terrain.synthetic = { x = [-3, 3], y = [-3, 3], spacing = 0.5 }\n"
    problem += 'vehicle.catalog = "differential_drive"\ntime = { duration = 20, step = 1 }\n'
    Path("p.toml").write_text(problem)
    Path("way.csv").write_text(table(rows, "t,x,y,heading"))
    vehicle = catalog.differential_drive()
    points, _ = _points(load_problem("p.toml"), vehicle)
    assert points is not None
    assert_allclose(points[3], angle - np.pi / 2)
    Path("way.csv").write_text(table(rows * [1, 1, 1, -1], "t,x,y,heading"))
    words = "clockwise from north.*; write 0 deg minus the"
    refuses(ProblemError, words, _points, load_problem("p.toml"), vehicle)


# The command: shipped problems, logs without a problem file, errors

SHIPPED = PROBLEMS / "fit_skid_steer.toml"
TRUE = {"radius_left": 0.155, "radius_right": 0.155, "track": 0.62}
TRUE |= {"center_of_mass_ahead": 0.03, "stiffness": 12.0, "friction": 0.6}
LOG = (DATA / "fit_least_slip.toml").read_text()

RUN = (DATA / "run_fitted.toml").read_text()
RATES = [f"{end}_{side}_rate" for end in ("front", "rear") for side in ("left", "right")]


def _estimates(path: str) -> dict[str, dict[str, str]]:
    with Path(path).open() as file:
        return {row["name"]: row for row in csv.DictReader(file)}


@pytest.mark.slow
def test_shipped_problem_finds_the_truth_and_a_vehicle_that_runs() -> None:
    words = printed("fit", str(SHIPPED), "--write", "fitted.toml")
    assert "readings new every" not in words
    found = _estimates("fit_skid_steer.csv")
    for name, true in TRUE.items():
        assert float(found[name]["lower"]) < true < float(found[name]["upper"]), name
    with Path("fit_skid_steer_windows.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if float(row["duration"]) == 2]
    assert len(rows) >= 59
    assert np.sqrt(np.mean([float(row["error_along"]) ** 2 for row in rows])) < 0.02
    assert Path("fit_skid_steer.png").is_file()
    vehicle = sf.read_vehicle("fitted.toml")
    radii = {wheel.name: wheel.radius for wheel in vehicle.wheels}
    assert_allclose(radii["front_left"], float(found["radius_left"]["value"]), atol=1e-12)
    masses = [(mass, ca.evalf(place)) for _, mass, place in vehicle.masses()]
    ahead = sum(float(place[1]) * mass for mass, place in masses) / vehicle.mass
    assert_allclose(ahead, float(found["center_of_mass_ahead"]["value"]), atol=1e-12)
    keys = dict(re.findall(r"# (\S+) = (\S+)", Path("fitted.toml").read_text()))
    assert keys["law.coulomb.slip_stiffness"] == keys["law.compliant.slip_stiffness"]
    assert_allclose(float(keys["terrain.friction"]), float(found["friction"]["value"]))
    Path("run.toml").write_text(RUN)
    assert "complete" in printed("run", "run.toml", "--no-draw")
    own = (f"{name}={value}" for name, value in keys.items() if "coulomb" not in name)
    assert "complete" in printed("run", "run.toml", "--no-draw", *sets("model=dynamics", *own))


def _motion() -> tuple[sf.Vehicle, np.ndarray, np.ndarray]:
    """Return a vehicle, and times and rates of its left and right wheels."""
    vehicle = sf.catalog.rigid_skid_steer(half_track=0.3, r2=0.12)
    times = np.linspace(0, 20, 201)
    rates = np.random.default_rng(3).uniform(1, 4, (2, 20)).repeat(10, axis=1)
    return vehicle, times, rates


@pytest.mark.slow
def test_a_log_with_headings_from_x() -> None:
    """Rates are constant within windows; the row after a jump has the later rate."""
    vehicle, times, (left, right) = _motion()
    dae = sf.direct_kinematics(vehicle, sf.Analytic(lambda x, _: 0 * x))
    inputs = {name: left if "left" in name else right for name in RATES}
    run = sf.simulate(dae, sf.settle(dae, heading=0.4), dae.inputs(**inputs), times)
    rows = [
        [k, run.t[i], run["x"][i], run["y"][i], run["heading"][i] + np.pi / 2, left[j], right[j]]
        for k in range(20)
        for j in (10 * k,)
        for i in range(j, j + 11)
    ]
    write_rows(Path("log.csv"), ["n", "time", "x", "y", "heading", "l", "r"], rows)
    rates = "".join(f"{name} = '{name.split('_')[1][0]}'\n" for name in RATES)
    text = LOG.replace("window = 1.0", f"window = 'n'\n[data.rates]\n{rates}")
    Path("fit.toml").write_text(f"frame = 'rep103'\n{text}")
    shown = json.loads(printed("--json", "fit", "fit.toml", "--no-draw"))
    assert {"radius", "track"} <= {each["name"] for each in shown["estimates"]}
    found = _estimates("fit.csv")
    assert_allclose(float(found["radius"]["value"]), 0.17, rtol=1e-4)
    assert_allclose(float(found["track"]["value"]), 0.6, rtol=1e-4)


@pytest.mark.slow
def test_results_of_slipfree_are_logs(monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses of an MCAP file may be rarer than its joint states."""

    def rare(path: Path) -> tuple[dict[str, Array], object]:
        poses, joints = read_motion_log(path)
        return {name: column[::5] for name, column in poses.items()}, joints

    monkeypatch.setattr("slipfree.files.logs.read_motion_log", rare)
    vehicle, times, _ = _motion()
    dae = sf.direct_kinematics(vehicle, sf.Analytic(lambda x, _: 0 * x))
    left, right = 2 + dae.t / 10, 3 - dae.t / 20
    inputs = {name: left if "left" in name else right for name in RATES}
    run = sf.simulate(dae, sf.settle(dae), dae.inputs(**inputs), times)
    write("log.nc", run)
    write_mcap(Path("log.mcap"), run, vehicle)
    for name in ("log.nc", "log.mcap"):
        Path("fit.toml").write_text(LOG.replace("log.csv", name))
        printed("fit", "fit.toml", "--no-draw")
        found = _estimates("fit.csv")
        assert_allclose(float(found["radius"]["value"]), 0.17, rtol=1e-4)
        assert_allclose(float(found["track"]["value"]), 0.6, rtol=1e-3)
    text = LOG.replace("[unk", "[data.rates]\nfront_left_rate = 'a'\n[unk", 1)
    Path("fit.toml").write_text(text.replace("log.csv", "log.mcap"))
    assert "found no joint 'a' among front_right" in printed("fit", "fit.toml", code=2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("track", "mass"), r"fit.toml:10: .*one of the quantities radius, track.*found 'mass'"),
        (("verb", "frame = 'x'\nverb"), r"fit.toml:2: .*'paper' or 'rep103'.*'x'"),
        (("window = 1.0", "window = -1"), r"fit.toml:\d+: data.window: .*than 0, or text in quo"),
    ],
)
def test_errors_name_the_line(change: tuple[str, str], words: str) -> None:
    Path("log.csv").write_text("t,x,y,heading\n0,0,0,0\n1,0,0,0\n")
    Path("fit.toml").write_text(LOG.replace(*change))
    found = printed("fit", "fit.toml", code=2)
    assert re.search(words, found), found


def test_undetermined_unknowns_end_with_exit_code_1() -> None:
    """A straight drive says nothing about the track."""
    times = np.arange(0, 20.05, 0.1)
    y = 0.17 * (2 * times + 1 - np.cos(times)) + np.random.default_rng(0).normal(0, 1e-3, 201)
    rows = zip(times, 0 * times, y, 0 * times, 2 + np.sin(times), strict=True)
    write_rows(Path("log.csv"), ["t", "x", "y", "heading", "rate_rad_s"], rows)
    rates = "".join(f"{name} = 'rate'\n" for name in RATES)
    text = LOG.replace("prior = [0.57, 0.3]\n", "")
    Path("fit.toml").write_text(text.replace("[unk", f"[data.rates]\n{rates}[unk", 1))
    shown = printed("fit", "fit.toml", "--no-draw", "--write", "v.toml", code=1)
    assert re.search(r"track .*as its prior: not determined by these data\)", shown)
    assert "no information on track; no vehicle was written" in shown
    assert not Path("v.toml").exists()
    assert_allclose(float(_estimates("fit.csv")["radius"]["value"]), 0.17, rtol=0.01)


@pytest.mark.parametrize("name", sf.catalog.__all__)
def test_vehicles_of_the_catalogue_are_written(name: str) -> None:
    """Axles are written as vectors, and joints are sorted by their distance from the platform."""
    vehicle = getattr(sf.catalog, name)()
    Path("v.toml").write_text(vehicle_text(vehicle, ["comment"]))
    found = sf.read_vehicle("v.toml")
    wheels = tuple(replace(wheel, axle=unit_vector(wheel.axle)) for wheel in vehicle.wheels)
    assert tuple(replace(w, axle=unit_vector(w.axle)) for w in found.wheels) == wheels
    assert sorted(found.joints, key=str) == sorted(vehicle.joints, key=str)
    for field in ("name", "coordinates", "body"):
        assert getattr(found, field) == getattr(vehicle, field)


TIMES = np.linspace(0, 20, 201)
YAW = 0.5 * TIMES  # more than a turn
CIRCLE = np.column_stack([TIMES, 3 + 0 * TIMES, 4 + 0 * TIMES, np.sin(YAW), 1 - np.cos(YAW), YAW])


@pytest.mark.parametrize(
    ("factors", "words"),
    [
        ({0: 1e3}, "times in ms, as in 't [ms]'"),
        ({0: 1 / 60}, "times in minutes, as in 't [minutes]'"),
        ({1: 30 / np.pi, 2: 30 / np.pi}, "rates in rpm, as in 'left [rpm]'"),
        ({1: 0.5 / np.pi, 2: 0.5 / np.pi}, "rates in rev/s, as in 'left [rev/s]'"),
        ({3: 1e3, 4: 1e3}, "positions in mm, as in 'x [mm]'"),
        ({3: 1 / 0.3048, 4: 1 / 0.3048}, "positions in feet, as in 'x [feet]'"),
        ({0: 1 / 86400}, "times in days, which must be multiplied by 86400"),
    ],
)
def test_units_by_the_travel_of_the_wheels(factors: dict[int, float], words: str) -> None:
    log = CIRCLE.copy()
    log[:, 0] /= 100  # so dense that milliseconds pass for seconds
    log[:, 1:3] *= 100
    for column, factor in factors.items():
        log[:, column] *= factor
    values = {"x": log[:, 3], "y": log[:, 4]}
    every = np.arange(201), {"t": log[:, 0]}, TIMES >= 0
    read = MotionLog(Path("log.csv"), log[:, 0], values, (), Counter(), (0.0, 0.0), *every)
    check = partial(check_motion, read, ratios=rate_ratios([0.15, 0.15]))
    refuses(sf.DataError, re.escape(words), check, speed=0.15 * log[:, 1:3].mean(axis=1))
    check(speed=np.where(TIMES < 10, 1.0, -0.2) * log[:, 1])  # the wheels slip


def test_missing_columns_of_logs_without_a_problem_file() -> None:
    Path("log.csv").write_text("a,b\n1,2\n2,3\n")
    assert "as in --set data.columns.x=east; the unit" in printed("fit", "log.csv", code=2)
    Path("car.toml").write_text(vehicle_text(sf.catalog.ackermann(), []))
    found = printed("fit", "log.csv", "--vehicle", "car.toml", code=2)
    assert "data.rates, as in --set data.columns.x=east, or hold joints that do not move" in found


@pytest.mark.parametrize(
    ("half_base", "half_track", "unit"), [(0.1, 0.125, "m/s"), (0.75, 0.6, "rad/s")]
)
def test_size_of_a_vehicle_that_is_not_given(
    half_base: float, half_track: float, unit: str
) -> None:
    """A log determines the effective track, not the wheelbase; bad predictions are no success."""
    size = half_base**2 + half_track**2
    truth = Truth(1.0, 1.0, 0.6, 8.0, 0.6 * size, half_base / 10, 0.0, half_base, half_track)
    t, sides, place, heading = drives(1, truth, duration=24.0, speed=2 * half_track)
    radius = 0.3 if unit == "rad/s" else 1.0
    columns = [t, place.real[:, 0], place.imag[:, 0], heading[:, 0], *sides[:, :, 0].T / radius]
    rows, head = np.column_stack(columns), ["t", "x", "y", "heading", "left", "right"]
    rows[:, 1:4] += np.random.default_rng(0).normal(size=(len(t), 3)) * [0.002, 0.002, 0.005]
    write_rows(Path("log.csv"), head, rows.tolist())
    own = ["log.csv", "--no-draw", *sets("frame=rep103", f"data.unit={unit}")]
    shown = json.loads(printed("--json", "fit", *own))
    found = {each["name"]: each for each in shown["estimates"]}
    true = {"effective_track": 2 * size / half_track, "radius_left": radius}
    for name, value in true.items():
        assert_allclose(found[name]["value"], value, rtol=0.03)
    true |= {"friction": 0.6, "stiffness": 8.0, "center_of_mass_ahead": half_base / 10}
    for name, value in (true | {"gyration": truth.gyration}).items():
        assert found[name]["lower"] < value < found[name]["upper"]
    assert "track" not in found
    assert shown["facts"]["outcome"] == "complete"
    assert shown["errors"][0]["position_rms"] < 0.02 * 2 * 2 * half_track
    rows[:, 1] += half_track * np.sin(1.5 * t)
    write_rows(Path("log.csv"), head, rows.tolist())
    words = printed("fit", *own, code=1)
    assert re.match(r"outcome +inaccurate: errors of [1-9]\d %", words)


def test_logs_without_a_problem_file_over_a_map() -> None:
    """The fit is kept, has its facts, and predicts other logs as the fit without them does."""
    t, sides, place, heading = drives(2, duration=24.0, size=1.0)
    for k, name in enumerate(("a.csv", "b.csv")):
        columns = [t, place[:, k].real, place[:, k].imag, heading[:, k], *sides[:, :, k].T]
        rows = np.column_stack(columns)[::2].tolist()
        write_rows(Path(name), ["t", "x", "y", "heading", "left", "right"], rows)
    heights = "\n".join(" ".join(map(str, row)) for row in HILL.z.T[::-1].tolist())
    head = "ncols 81\nnrows 81\nxllcenter -40\nyllcenter -40\ncellsize 1\n"
    Path("hill.asc").write_text(f"{head}{heights}\n")
    vehicle = sf.catalog.rigid_skid_steer(half_track=HALF, wheelbase=2 * HALF, r1=0.1, r2=0.1)
    Path("robot.toml").write_text(vehicle_text(vehicle, []))
    own = ["--map", "hill.asc", "--vehicle", "robot.toml", "-o", "fit.nc", *sets("frame=rep103")]
    fitted = json.loads(printed("--json", "fit", "a.csv", *own, *["--predict", "b.csv"] * 2))
    names = {each["name"] for each in fitted["estimates"]}
    assert {"radius_left", "track", "stiffness", "friction", "turn_slope"} <= names
    (error,) = [each["position_rms"] for each in fitted["errors"] if each["duration"] == 2]
    assert error < 0.05
    further = ["--predict", "b.csv", "--no-draw"]
    again = printed("--json", "fit", "fit.nc", *further, "b.csv", "-o", "p.csv")
    assert json.loads(again)["errors"] == fitted["errors"]
    assert json.loads(printed("--json", "info", "fit.nc"))["facts"] == fitted["facts"]
    assert "a fit, which has no motion; use slipfree info" in refused("report", "fit.nc")
    assert "wrote fit_fit.csv" in printed("fit", "fit.nc", *further)
    assert "data.rates: expected a vehicle" in refused("fit", "a.csv", *sets("data.rates.a='b'"))
    surfaces = sets("frame=rep103", "data.surfaces=['x', 'y']")
    words = printed("fit", "a.csv", "b.csv", "-o", "two.csv", "--no-draw", *surfaces, code=1)
    assert "inaccurate: errors of" in words  # of drives on a hillside, without its map
    assert "one of x, y, found none" in refused("fit", "two.nc", *further)
    assert "windows" in printed("fit", "two.nc", *further, *sets("data.surfaces=['y']"))
    Path("c.nc").write_bytes(b"CDF\x01")
    assert "expected" in printed("fit", "c.nc", *further, code=2)
