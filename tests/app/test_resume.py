"""Plans that go on from a result file, and files of searches that were interrupted."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from typer.testing import CliRunner

from slipfree import DataError
from slipfree.cli import app
from slipfree.files import netcdf
from slipfree.outcome import Outcome
from slipfree.plan.warm_start import from_arrays
from slipfree.problem.load import load_problem
from slipfree.problem.solve import run_problem

PROBLEMS = Path(__file__).parents[2] / "problems"
HILLS = PROBLEMS / "plan_rigid_hills.toml"
SMALL = ("plan.intervals=8", "costs.slip=1e3", "time.step=0.5")


def command(out, *options, settings=SMALL):
    words = [word for each in settings for word in ("--set", each)]
    return CliRunner().invoke(
        app, ["run", str(HILLS), "-o", str(out), "--no-draw", *options, *words]
    )


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    out = tmp_path_factory.mktemp("plans") / "first.nc"
    result = command(out)
    assert result.exit_code == 0, result.output
    return out


def iterations(file):
    return netcdf.read(file).statistics["plan_iterations"]


def test_a_plan_goes_on_from_a_file(solved, tmp_path):
    out = tmp_path / "second.nc"
    result = command(out, "--resume", str(solved))
    assert result.exit_code == 0, result.output
    assert iterations(out) <= 3
    assert netcdf.read(out)["x"][-1] == pytest.approx(0.6, abs=1e-4)


def test_another_goal_takes_at_most_half_the_iterations(solved, tmp_path):
    moved = (*SMALL, "goal.x=0.63", "goal.y=2.73")
    cold, warm = tmp_path / "cold.nc", tmp_path / "warm.nc"
    for out, options in ((cold, ()), (warm, ("--resume", str(solved)))):
        result = command(out, *options, settings=moved)
        assert result.exit_code == 0, result.output
    assert iterations(warm) <= iterations(cold) / 2


def test_a_file_keeps_what_a_plan_leaves(solved):
    arrays = netcdf.read_arrays(solved)
    saved = from_arrays(arrays, "file")
    assert saved.motion.mesh.ends.size == 9
    assert saved.motion.duration == 20.0
    assert saved.motion.continuous
    assert_array_equal(saved.arrays["plan_unknowns"], saved.unknowns)


def test_a_search_that_is_interrupted_leaves_a_file_to_go_on_from(tmp_path):
    told = []

    def interrupt(line):
        told.append(line)
        if len(told) == 5:
            raise KeyboardInterrupt

    outcome = run_problem(load_problem(HILLS, list(SMALL)), tell=interrupt)
    stop = outcome.trajectory.stop
    assert stop.name == "plan"
    assert stop.outcome is Outcome.INTERRUPTED
    assert "the search was stopped" in stop.words
    assert stop.words.endswith("; go on with --resume OUT.nc")
    file = tmp_path / "stopped.nc"
    netcdf.write(file, outcome.trajectory, outcome.arrays)
    kept = from_arrays(netcdf.read_arrays(file), str(file))
    assert np.isfinite(kept.unknowns).all()
    assert netcdf.read(file).stop.name == "plan"
    assert netcdf.read(file).outcome is Outcome.INTERRUPTED
    assert command(tmp_path / "on.nc", "--resume", str(file)).exit_code == 0


def test_an_interrupted_refinement_gives_no_advice_on_the_mesh():
    def interrupt(line):
        if "intervals: iteration" in line:
            raise KeyboardInterrupt

    outcome = run_problem(load_problem(HILLS, [*SMALL, "plan.accuracy=1e-7"]), tell=interrupt)
    stop = outcome.trajectory.stop
    assert stop.name == "plan_accuracy"
    assert stop.outcome is Outcome.INTERRUPTED
    assert stop.words.endswith("was asked for: interrupted; go on with --resume OUT.nc")


@pytest.mark.parametrize(
    ("problem", "words"),
    [
        ("plan_rigid_hills.toml", "expected the result of a plan, found none in it"),
        ("real_dem_direct.toml", "expected 'plan' for --resume, found 'direct'"),
    ],
)
def test_what_cannot_be_gone_on_from_is_told(solved, tmp_path, problem, words):
    other = tmp_path / "other.nc"
    netcdf.write(other, netcdf.read(solved))
    named = ["run", str(PROBLEMS / problem), "-o", str(tmp_path / "x.nc"), "--resume", str(other)]
    result = CliRunner().invoke(app, named)
    assert result.exit_code == 2
    assert words in result.stderr


def test_a_file_without_a_plan_is_refused():
    with pytest.raises(DataError, match="found none in it"):
        from_arrays({}, "file")
