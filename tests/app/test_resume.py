"""Tests of plans that continue from a result file, and of files of interrupted searches."""

import re
import shlex

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import slipfree as sf
from helpers.cases import PROBLEMS
from helpers.commands import invoke, refused, sets
from slipfree.files import netcdf
from slipfree.plan.polynomial_motion import from_arrays
from slipfree.problem.report import report

HILLS = PROBLEMS / "plan_rigid_hills.toml"
SMALL = ("plan.intervals=8", "costs.slip=1e3", "time.step=0.5")


def command(out, *options, settings=SMALL, code=None):
    words = sets(*settings)
    return invoke("run", HILLS, "-o", out, "--no-draw", *options, *words, code=code)


@pytest.fixture(scope="module")
def solved(tmp_path_factory):
    out = tmp_path_factory.mktemp("plans") / "first.nc"
    command(out, code=0)
    return out


def iterations(file):
    return netcdf.read(file).facts["plan_iterations"].value


@pytest.mark.slow
def test_another_goal_takes_at_most_half_the_iterations(solved, tmp_path):
    out = tmp_path / "moved.nc"
    moved = (*SMALL, "goal.x=0.63", "goal.y=2.73")
    command(out, "--resume", str(solved), settings=moved, code=0)
    assert iterations(out) <= iterations(solved) / 2  # of a goal 4 cm away
    assert netcdf.read(out)["x"][-1] == pytest.approx(0.63, abs=1e-4)


@pytest.mark.slow
def test_a_file_keeps_what_a_plan_leaves(solved):
    saved = from_arrays(netcdf.read_arrays(solved), "file")
    assert saved.motion.mesh.ends.size == 9
    assert saved.motion.duration == 20.0
    assert saved.motion.continuous
    assert_array_equal(saved.arrays["plan_unknowns"], saved.unknowns)


@pytest.mark.parametrize(
    ("name", "value"), [("sizes", [3, 0, 2, 3, 1]), ("sizes", [3, 4e8, 2, 3, 1]), ("ends", [0, 2])]
)
def test_a_damaged_plan_is_refused(name, value):
    sizes, ends = np.array([1.0, 1, 1, 1, 0]), np.array([0.0, 1.0])
    plan = {"sizes": sizes, "ends": ends, "unknowns": np.zeros(5), "shift": np.zeros(2)}
    plan = {f"plan_{key}": each for key, each in (plan | {"model": np.ones(1)}).items()}
    assert from_arrays(plan, "a.nc").motion.duration == 0
    with pytest.raises(sf.DataError, match=r"a\.nc: .*the file is damaged"):
        from_arrays(plan | {f"plan_{name}": np.array(value, dtype=float)}, "a.nc")


def interrupt_search(monkeypatch, calls):
    """Press Ctrl-C at one of the reports of progress."""

    left = iter(range(calls))

    def poll():
        if next(left, None) is None:
            raise KeyboardInterrupt

    monkeypatch.setattr("slipfree.system.interrupt.check_interrupt", poll)


@pytest.fixture
def stopped(tmp_path, monkeypatch):
    """Return the file of an interrupted search and what the command prints."""
    file = tmp_path / "stopped here.nc"
    with monkeypatch.context() as patch:
        interrupt_search(patch, 7)  # two reports of phases precede those of the iterates
        return file, command(file)


@pytest.mark.slow
def test_an_interrupted_plan_says_so_first_and_names_the_command_that_goes_on(stopped):
    file, result = stopped
    assert result.exit_code == 130
    begin = "the search was stopped (IPOPT: User_Requested_Stop) after 5 iterations; the result is"
    assert re.match(rf"outcome +interrupted: {re.escape(begin)}", result.stdout)
    assert "\niterate  " in result.stdout
    assert np.isfinite(from_arrays(netcdf.read_arrays(file), str(file)).unknowns).all()
    assert (netcdf.read(file).stop.name, netcdf.read(file).outcome.name) == ("plan", "INTERRUPTED")
    first, second = result.stderr.splitlines()
    assert first == f"interrupted; {file} contains the result so far"
    go_on = second.removeprefix("to resume: ")
    settings = " ".join(f"--set {each}" for each in SMALL)
    end = f"-o '{file}' --no-draw --resume '{file}'"
    assert go_on == f"slipfree run {HILLS} {settings} {end}"
    info = invoke("info", str(file))
    assert info.stdout.startswith("outcome ")
    assert f"to resume: slipfree run {HILLS} {settings} --resume '{file}'" in info.stdout
    assert begin in report(file).lead
    again = invoke(*shlex.split(go_on)[1:], code=0)
    assert re.match("outcome +complete\n", again.stdout)
    assert netcdf.read(file).outcome is sf.Outcome.COMPLETE


@pytest.mark.slow
def test_an_interrupted_refinement_gives_no_advice_on_the_mesh():
    def interrupt(phase, _):
        if phase.endswith("intervals"):
            raise KeyboardInterrupt

    outcome = sf.run_problem(sf.load_problem(HILLS, [*SMALL, "plan.accuracy=1e-7"]), tell=interrupt)
    stop = outcome.trajectory.stop
    assert stop.name == "plan_accuracy"
    assert stop.outcome is sf.Outcome.INTERRUPTED
    pattern = (
        r"no usable plan: its simulation misses x by [\d.e-]+ m, .* rad.*; "
        "plan.accuracy allows 1e-07: the refinement of its mesh was stopped"
    )
    assert re.fullmatch(pattern, stop.words)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("problem", "words"),
    [
        ("plan_rigid_hills.toml", "expected the result of a plan, found no plan in it"),
        ("real_dem_direct.toml", "expected 'plan' for --resume, found 'direct'"),
    ],
)
def test_what_cannot_be_gone_on_from_is_told(solved, tmp_path, problem, words):
    other = tmp_path / "other.nc"
    netcdf.write(other, netcdf.read(solved))
    named = ["run", str(PROBLEMS / problem), "-o", str(tmp_path / "x.nc"), "--resume", str(other)]
    assert words in refused(*named)
