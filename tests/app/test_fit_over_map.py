"""``slipfree fit`` of models over a map: table, figure, other logs, refusals."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.commands import printed
from helpers.hillside import AXIS, HILL, TRUE, drive
from slipfree import read_vehicle
from slipfree.core.records import Array
from slipfree.fit.ground_fit import judge
from slipfree.fit.ground_motion import MODELS, Slopes
from slipfree.fit.unknowns import track
from slipfree.problem.load import load_problem
from slipfree.problem.verbs.fit_over_map import _read_log, fit_over_map, models_of
from slipfree.system import codegen_cache

PROBLEM = """\
verb = "fit-over-map"
models = ["differential", "slope"]
lengths = [5.0]

[terrain]
file = "hill.asc"

[data]
files = ["a/0.csv", "a/1.csv", "b/2.csv", "b/3.csv"]
step = 0.2
"""


def write_log(path: Path, seed: int, sensor: tuple[complex, float] = (0j, 0.0)) -> None:
    """Write a log of the robot, with velocities, and with headings of a sensor at an angle."""
    log = drive(seed, path.parent.name, sensor=sensor)
    path.parent.mkdir(exist_ok=True)
    t = log.dt * np.arange(len(log.place))
    columns = [t, log.place, log.sides, log.velocity]
    columns += [] if log.heading is None else [np.rad2deg(log.heading) % 360]
    header = "t,x,y,left,right,vx,vy,yaw [deg]"[: None if sensor[1] else -10]
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with a problem, its map and its logs."""
    monkeypatch.chdir(tmp_path)
    head = f"ncols {AXIS.size}\nnrows {AXIS.size}\nxllcenter -40\nyllcenter -40\ncellsize 1\n"
    rows = "\n".join(" ".join(f"{z:.6f}" for z in row) for row in HILL.z.T[::-1])
    Path("hill.asc").write_text(head + rows + "\n")
    Path("hill.toml").write_text(PROBLEM)
    for k, name in enumerate(("a", "a", "b", "b")):
        write_log(tmp_path / name / f"{k}.csv", k)
    return tmp_path


@pytest.mark.usefixtures("folder")
def test_folders_are_predicted_in_turn() -> None:
    words = printed("fit", "hill.toml", "-o", "table.csv")
    assert "wrote table.csv and table_constants.csv and table_windows.csv and table.png" in words
    with Path("table.csv").open() as file:
        rows = {(r["model"], float(r["length"])): r for r in csv.DictReader(file)}
    assert set(rows) == {(m, length) for m in ("differential", "slope") for length in (5.0, 0.0)}
    for length in (5.0, 0.0):
        worse, better = (float(rows[m, length]["position_rms"]) for m in ("differential", "slope"))
        assert better < 0.2 * worse
    with Path("table_windows.csv").open() as file:
        windows = [r for r in csv.DictReader(file) if r["model"] == "slope"]
    row = rows["slope", 5.0]
    own = [r for r in windows if float(r["length"]) == 5.0]
    inside = [abs(float(r["error_across"])) <= float(r["reach_across"]) for r in own]
    assert len(own) == int(row["windows"])
    assert np.mean(inside) == pytest.approx(float(row["coverage_across"]))
    assert {r["log"] for r in own} == {"0", "1", "2", "3"}


def test_other_logs_are_predicted(folder: Path) -> None:
    write_log(folder / "other.csv", 9)
    own = ("--predict", "other.csv", "--no-draw", "--set", "models=['slope']")
    shown = json.loads(printed("--json", "fit", "hill.toml", *own))
    (first, _) = shown["errors"]
    assert first["logs"] == 1
    assert first["position_rms"] < 0.05
    assert " m, " in shown["facts"]["5 m of path, slope"].split(";")[0]  # no interval of one log
    found = {each["name"]: each["value"] for each in shown["estimates"]}
    for name, true in TRUE.items():
        assert found[name] == pytest.approx(true, rel=0.03), name


@pytest.mark.usefixtures("folder")
def test_wrong_problems_are_refused() -> None:
    words = printed("fit", "hill.toml", "--no-draw", "--set", "shift=[100, 0]", code=2)
    assert "x from -40 to 40 m and y from -40 to 40 m, found none, the first at x = " in words
    Path("a/0.csv").write_text("t,x,y,left\n0,0,0,1\n1,0,0,1\n")
    words = "a/0.csv: expected the columns t, x, y, left, right, found no column 'right'"
    assert words in printed("fit", "hill.toml", "--no-draw", code=2)
    for rows, words in (
        ("0,0,0,1,1\n", "longer than 0.2 s, found 0 s"),
        ("0,0,0,1,1\n2,0,0,1,1\n1,0,0,1,1\n", "found 1 s after 2 s"),
    ):
        Path("a/0.csv").write_text(f"t,x,y,left,right\n{rows}")
        assert words in printed("fit", "hill.toml", "--no-draw", code=2)
    assert "found 0.csv in both" in printed("fit", "hill.toml", "--predict", "a/0.csv", code=2)
    assert "omit --write" in printed("fit", "hill.toml", "--write", "v.toml", code=2)
    Path("hill.toml").write_text(PROBLEM.replace("step = 0.2", "step = 0.6"))
    assert "step" in printed("fit", "hill.toml", "--no-draw", code=2)
    Path("hill.toml").write_text(PROBLEM.replace("slope", "ice"))
    words = printed("fit", "hill.toml", "--no-draw", code=2)
    assert "models[1]: expected 'straight'" in words
    assert "found 'ice'" in words


def test_pose_of_the_sensors_is_found(folder: Path) -> None:
    """Compass at an angle, receiver ahead of the centre; a column has degrees."""
    for k in range(4):
        write_log(folder / "ab"[k // 2] / f"{k}.csv", k, (0.5 + 0j, 0.4))
    write_log(folder / "other.csv", 9, (0.5 + 0j, 0.4))
    columns = '\n[data.columns]\nvelocity = ["vx", "vy"]\nheading = "yaw"\n'
    unknowns = "[unknowns.receiver]\nquantity = 'sensor_ahead'\n[unknowns.sensor_heading]\n"
    Path("hill.toml").write_text(PROBLEM + columns + unknowns)
    own = ("--predict", "other.csv", "--no-draw", "--set", "models=['slope']")
    shown = json.loads(printed("--json", "fit", "hill.toml", *own))
    found = {each["name"]: each for each in shown["estimates"]}
    for name, true in (TRUE | {"sensor_ahead": 0.5, "sensor_heading": 0.4}).items():
        assert found[name]["value"] == pytest.approx(true, rel=0.03), name
    angle = found["sensor_heading"]
    assert angle["unit"] == "rad"
    assert 0 < angle["upper"] - angle["lower"] < 0.01


def test_vehicles_and_their_unknowns(folder: Path) -> None:
    vehicle = '\n[vehicle]\ncatalog = "skid_steer"\n[unknowns.track]\nlower = 0.65\n'
    Path("hill.toml").write_text(PROBLEM + vehicle + "[unknowns.turn_lag]\n")
    models = models_of(load_problem(folder / "hill.toml", command="fit"), 0.6)
    assert models["vehicle"].start == {"track": 0.65, "turn_lag": 0.1}  # nominal: 0.6
    assert "turn_lag" in models["slope"].start
    Path("hill.toml").write_text(PROBLEM + "[unknowns.track]\n")
    words = printed("fit", "hill.toml", "--no-draw", code=2)
    assert "found 'track'; correct it, or add the table [vehicle]" in words
    printed_words = printed(
        "fit", "hill.toml", "--set", "models=[]", "--set", "unknowns={}", code=2
    )
    assert "expected at least one model, or a vehicle, found none" in printed_words


@pytest.mark.slow  # 8 s: the equations of the vehicle are compiled
def test_vehicle_is_judged_beside_the_models(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fitted, least slip predicts the motion of a differential drive of another track."""
    monkeypatch.setenv(codegen_cache.FOLDER, str(folder / "cache"))
    own = PROBLEM.replace('"differential", "slope"', '"differential"')
    own = own.replace(', "b/2.csv", "b/3.csv"', "")
    unknowns = "[unknowns.radius]\n[unknowns.track]\nlower = 0.6\n"
    Path("hill.toml").write_text(own + '[vehicle]\ncatalog = "differential_drive"\n' + unknowns)
    own = ("--no-draw", "--predict", "b/2.csv", "--write", "fitted.toml")
    shown = json.loads(printed("--json", "fit", "hill.toml", *own))
    errors = {(r["model"], r["length"]): r["position_rms"] for r in shown["errors"]}
    for length in (5.0, 0.0):
        ratio = errors["vehicle", length] / errors["differential", length]
        assert ratio == pytest.approx(1.0, abs=0.03)
    found = {(each["model"], each["name"]): each["value"] for each in shown["estimates"]}
    width = found["vehicle", "track"]
    assert width == pytest.approx(found["differential", "track"], rel=0.02)
    assert track(read_vehicle("fitted.toml")) == pytest.approx(width)
    tables = "[terrain]\nfile = 'hill.asc'\n[vehicle]\nfile = 'fitted.toml'\n[start]\n"
    tables += "[time]\nduration = 0.4\nstep = 0.2\n[inputs]\nleft_rate = 1\nright_rate = 1\n"
    Path("drive.toml").write_text("verb = 'direct'\n" + tables)
    assert "complete" in printed("run", "drive.toml", "--no-draw")


def test_folders_of_the_same_name_are_left_out_separately(folder: Path) -> None:
    """Courses follow from the positions alone unless the columns of the velocities are named."""
    files = [f"{campaign}/logs/{k}.csv" for k, campaign in enumerate(("may", "may", "june"))]
    logs = []
    for k, name in enumerate(files):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        log = drive(k, str(folder / name))
        write_log(folder / name, k)
        # the last sample is not reached
        names = ("place", "velocity", "speed", "good", "direction", "sides")
        logs.append(log._replace(**{key: getattr(log, key)[:-1] for key in names}, group=name[:3]))
    old = '["a/0.csv", "a/1.csv", "b/2.csv", "b/3.csv"]'
    own = PROBLEM.replace(old, json.dumps(files)).replace('"differential", ', "")
    Path("hill.toml").write_text(own)
    scores = fit_over_map(load_problem(folder / "hill.toml", command="fit")).scores
    Path("hill.toml").write_text(
        Path("hill.toml").read_text() + '[data.columns]\nvelocity = ["vx", "vy"]\n'
    )
    others = fit_over_map(load_problem(folder / "hill.toml", command="fit")).scores
    models = {"slope": MODELS["slope"]}
    for own, is_measured in ((scores, False), (others, True)):
        given = [log._replace(is_velocity_measured=is_measured) for log in logs]
        expected, _ = judge(given, Slopes(HILL, 0.0), models, [(5.0, 0.0)])
        found, right = (np.sort(e["slope"][5.0, 0.0].errors.along) for e in (own, expected))
        assert_allclose(found, right, atol=1e-5)
    one, other = (np.sort(e["slope"][5.0, 0.0].errors.along) for e in (scores, others))
    assert np.abs(one - other).max() > 1e-4


def test_jumps_of_positions_are_left_out(folder: Path) -> None:
    """Measured velocities show them; samples a second away remain."""
    log, at = drive(9, ""), 300
    table = np.column_stack([log.dt * np.arange(700), log.place, log.sides, log.velocity])
    table[at:, 1] += 0.3
    np.savetxt("jump.csv", table, delimiter=",", header="t,x,y,left,right,vx,vy", comments="")
    columns = '[data.columns]\nvelocity = ["vx", "vy"]\n'
    Path("hill.toml").write_text(PROBLEM.replace(', "slope"', "") + columns)
    fitted = fit_over_map(load_problem(folder / "hill.toml", command="fit"), [Path("jump.csv")])
    bad = np.flatnonzero(~fitted.predicted[0].good)
    assert set(range(at - 2, at + 2)) <= set(bad.tolist()) <= set(range(at - 6, at + 6))


def _changed(change: Callable[[Array], object], head: str = "t,x,y,left,right,yaw") -> None:
    """Write a log with a change of its columns, as the first one of the problem."""
    log = drive(0, "a")
    course = np.unwrap(np.arctan2(log.velocity[:, 1], log.velocity[:, 0]))
    rows = np.column_stack([log.dt * np.arange(700), log.place, log.sides, course])
    changed = change(rows)
    rows = rows if changed is None else np.asarray(changed)
    np.savetxt("a/0.csv", rows, delimiter=",", header=head, comments="", fmt="%.9f")


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda a: a[:, [0, 1, 2, 4, 3, 5]],
            "found a course that turns the other way; ex",
        ),
        (lambda a: a[:, [0, 2, 1, 3, 4, 5]], "turns against headings and wheels"),
        (lambda a: a * [1, 1, 1, 1, 1, -1], "write 0 deg minus the heading"),
        (lambda a: a + np.eye(6)[5], "a constant difference of -57 deg"),
        (lambda a: a * [1, 1, 1, 3.6, 3.6, 1], "probably speeds in km/h, as in 'left [km/h]'"),
        (lambda a: a / [1, 1, 1, 0.15, 0.15, 1], "rates of wheels in rad/s, which must be multi"),
        (lambda a: a / [1, 1e5, 1e5, 1, 1, 1], "found degrees of longitude and latitude; project"),
        (
            lambda a: np.vstack([a, a]),
            "found 0 s after 139.8 s in line 702: the clock start",
        ),
        (lambda a: a * [1e3, 1, 1, 1, 1, 1], "at most 10 s apart, found 200 s (median)"),
    ],
)
def test_columns_that_contradict_each_other(change: Callable[[Array], Array], words: str) -> None:
    _changed(change)
    heading = "" if "course that" in words else 'heading = "yaw"\n'
    Path("hill.toml").write_text(f"{PROBLEM}[data.columns]\n{heading}")
    assert words in printed("fit", "hill.toml", "--no-draw", code=2)


@pytest.mark.usefixtures("folder")
def test_what_is_left_out_is_counted() -> None:
    """Half of a log beyond the map, a gap, a leap, bad positions, and commands that stop."""

    def change(rows: Array) -> Array:
        rows[:, 1] += 40 - np.median(rows[:, 1])
        rows[600:, 2] += 3
        rows[300:390, 3:5] = np.nan
        rows = np.column_stack([rows, np.full(700, 0.01)])
        rows[500:510, 6] = 2.0
        return np.delete(rows, np.arange(100, 120), axis=0)

    _changed(change, "t,x,y,left,right,yaw,sigma")
    settings = 'timeout = 2.0\n[data.columns]\nerror = "sigma"\n'
    Path("hill.toml").write_text(PROBLEM + settings)
    problem = load_problem(Path("hill.toml"), command="fit")
    lines: list[tuple[str, str]] = []
    log = _read_log(problem.spec, HILL, lines, Path("a/0.csv"), "a")
    ((name, words),) = lines
    assert name == "log 0"
    for part in (
        "699 samples, 350 beyond the map, 33 in gaps or at leaps of the position; ",
        "not begin or end at 396 near positions that are not good, 10 slower than",
        "10 rows left out: stated error above 0.1 m; inputs not given for at most 18.2 s, from",
    ):
        assert part in words, words
    assert (~log.good).sum() >= 350
    assert not log.sides[312:389].any()  # zero after 2 s
    assert log.sides[299:309].all()
