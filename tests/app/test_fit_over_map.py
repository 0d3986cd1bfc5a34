"""``slipfree fit`` of models over a map: table, figure, other logs, refusals."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.commands import printed
from helpers.hillside import AXIS, HILL, TRUE, drive
from slipfree.fit.ground_fit import judge
from slipfree.fit.ground_motion import MODELS, Slopes
from slipfree.problem.load import load_problem
from slipfree.problem.verbs.fit_over_map import fit_over_map

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


def write_log(path: Path, seed: int) -> None:
    """Write a log of the robot."""
    log = drive(seed, path.parent.name)
    path.parent.mkdir(exist_ok=True)
    t = log.dt * np.arange(len(log.place))
    rows = np.column_stack([t, log.place, log.sides])
    np.savetxt(path, rows, delimiter=",", header="t,x,y,left,right", comments="")


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
    assert "wrote table.csv and table.png" in words
    with Path("table.csv").open() as file:
        rows = {(r["model"], float(r["length"])): r for r in csv.DictReader(file)}
    assert set(rows) == {(m, length) for m in ("differential", "slope") for length in (5.0, 0.0)}
    for length in (5.0, 0.0):
        worse, better = (float(rows[m, length]["position_rms"]) for m in ("differential", "slope"))
        assert better < 0.2 * worse


def test_other_logs_are_predicted(folder: Path) -> None:
    write_log(folder / "other.csv", 9)
    own = ("--predict", "other.csv", "--no-draw", "--set", "models=['slope']")
    shown = json.loads(printed("--json", "fit", "hill.toml", *own))
    (first, _) = shown["errors"]
    assert first["logs"] == 1
    assert first["position_rms"] < 0.05
    words = str(shown["facts"]["slip and turning by the slope"])
    found = dict(each.split()[:2] for each in words.split(", "))
    for name, true in TRUE.items():
        assert float(found[name]) == pytest.approx(true, rel=0.03), name


@pytest.mark.usefixtures("folder")
def test_wrong_problems_are_refused() -> None:
    Path("a/0.csv").write_text("t,x,y,left\n0,0,0,1\n1,0,0,1\n")
    words = "a/0.csv: expected the columns t, x, y, left, right, found no column 'right'"
    assert words in printed("fit", "hill.toml", "--no-draw", code=2)
    for rows, words in (
        ("0,0,0,1,1\n", "longer than 0.2 s, found 0 s"),
        ("0,0,0,1,1\n2,0,0,1,1\n1,0,0,1,1\n", "found 1 s after 2 s"),
    ):
        Path("a/0.csv").write_text(f"t,x,y,left,right\n{rows}")
        assert words in printed("fit", "hill.toml", "--no-draw", code=2)
    assert "omit --write" in printed("fit", "hill.toml", "--write", "v.toml", code=2)
    Path("hill.toml").write_text(PROBLEM.replace("step = 0.2", "step = 0.6"))
    assert "step" in printed("fit", "hill.toml", "--no-draw", code=2)
    Path("hill.toml").write_text(PROBLEM.replace("slope", "ice"))
    words = printed("fit", "hill.toml", "--no-draw", code=2)
    assert "models[1]: expected 'straight'" in words
    assert "found 'ice'" in words


def test_folders_of_the_same_name_are_left_out_separately(folder: Path) -> None:
    """Courses follow from the positions alone: the logs have no velocities of the receiver."""
    files = [f"{campaign}/logs/{k}.csv" for k, campaign in enumerate(("may", "may", "june"))]
    logs = []
    for k, name in enumerate(files):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        log = drive(k, str(folder / name))
        write_log(folder / name, k)
        names = ("place", "good", "direction", "sides")  # the last sample is not reached
        log = log._replace(**{key: getattr(log, key)[:-1] for key in names}, group=name[:3])
        velocity = np.gradient(log.place, log.dt, axis=0)
        speed = np.hypot(*velocity.T)
        logs.append(log._replace(velocity=velocity, speed=speed, is_velocity_measured=False))
    old = '["a/0.csv", "a/1.csv", "b/2.csv", "b/3.csv"]'
    Path("hill.toml").write_text(PROBLEM.replace(old, json.dumps(files)))
    _, scores, fits = fit_over_map(load_problem(folder / "hill.toml", command="fit"))
    assert [len(each) for each in fits.values()] == [2, 2]
    models = {"slope": MODELS["slope"]}
    expected, _ = judge(logs, Slopes(HILL, 0.0), models, [(5.0, 0.0)])
    measured = [log._replace(is_velocity_measured=True) for log in logs]
    other, _ = judge(measured, Slopes(HILL, 0.0), models, [(5.0, 0.0)])
    found, right, wrong = (
        np.sort(each["slope"][5.0, 0.0].errors.along) for each in (scores, expected, other)
    )
    assert_allclose(found, right, atol=1e-5)
    assert np.abs(found - wrong).max() > 1e-4
