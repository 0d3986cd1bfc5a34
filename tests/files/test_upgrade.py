"""Tests of results of version 0.1 under current keys."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import netcdf_file

from helpers.cases import DATA
from slipfree.errors import DataError
from slipfree.files import netcdf
from slipfree.files.upgrade import sums_0_1, upgrade_0_1
from slipfree.outcome import Outcome
from slipfree.problem.load import load_problem
from slipfree.problem.solve import run_problem
from slipfree.records import Label
from slipfree.trajectory import Column, Stop, Trajectory

PROBLEMS = Path(__file__).parents[2] / "problems"
STOPS_OF_0_1 = [
    ("map_margin[front]", "wheel front leaves the map", Outcome.LIMIT),
    ("no_equilibrium", "on level ground the vehicle tips over", Outcome.NO_EQUILIBRIUM),
    ("fold", "the motion ends in a fold", Outcome.NO_EQUILIBRIUM),
    ("solver", "the integrator stopped", Outcome.SOLVER_FAILURE),
    ("closure_residual", "the equations have no exact solution", Outcome.SOLVER_FAILURE),
    ("interrupted", "the progress callable ended it", Outcome.INTERRUPTED),
    ("plan", "(Infeasible_Problem_Detected, after 9 iterations)", Outcome.INFEASIBLE),
    ("plan", "(User_Requested_Stop, after 2 iterations)", Outcome.INTERRUPTED),
    ("plan", "(Maximum_Iterations_Exceeded, after 500 iterations)", Outcome.SOLVER_FAILURE),
    ("plan_accuracy", "its mesh was not refined any further", Outcome.INACCURATE),
    ("plan_accuracy", "interrupted; go on with --resume OUT.nc", Outcome.INTERRUPTED),
]


@pytest.mark.parametrize(("name", "words", "outcome"), STOPS_OF_0_1)
def test_outcome_follows_from_the_stop(name, words, outcome):
    old = {"stop_name": name, "stop_time": 1.5, "stop_words": words}
    assert upgrade_0_1(old) == {**old, "outcome": outcome.name.lower()}


def test_ending_of_a_climb_gets_its_own_key():
    old = {"outcome": "climbs: at t = 2.86 s the rear axle is up, or past"}
    assert upgrade_0_1(old) == {"outcome": "complete", "climb": old["outcome"]}


LEAST = {"model": "kinematics", "law": "least"}


@pytest.mark.parametrize(
    ("problem", "settings", "expected"),
    [
        ('verb = "direct"', "", {"verb": "direct", "formulation": "closure", **LEAST}),
        (
            'verb = "plan"',
            "slip=traction",
            {"verb": "plan", "model": "quasi-static", "law": "coulomb"},
        ),
        ('verb = "inverse"', "", {"verb": "inverse", "solved_by": "integration"}),
        ('verb = "inverse"', "path.file=p.csv", {"verb": "inverse", "solved_by": "collocation"}),
        ('verb = "climb"', "", {"verb": "climb"}),
        ("verb =", "", {}),
    ],
)
def test_verb_and_model_follow_from_the_problem(problem, settings, expected):
    old = {"problem": problem, "settings": settings}
    assert upgrade_0_1(old) == {**old, **expected, "outcome": "complete"}


@pytest.fixture
def files(tmp_path):
    """Return a result for each outcome."""
    x = {"x": Column(Label("x", "m", "place"), np.zeros(2))}
    motions = [
        Trajectory(np.arange(2.0), x, stop=Stop("a", 1.0, "b", outcome)) for outcome in Outcome
    ]
    for outcome, motion in zip(Outcome, motions, strict=True):
        netcdf.write(tmp_path / f"{outcome.name}.nc", motion)
    return [tmp_path / f"{outcome.name}.nc" for outcome in Outcome]


def test_outcomes_are_stored(files):
    assert [netcdf.read(file).outcome for file in files] == list(Outcome)
    assert {outcome.name: outcome.exit_code for outcome in Outcome if outcome.exit_code != 1} == {
        "COMPLETE": 0,
        "INTERRUPTED": 130,
    }


def test_unknown_outcomes_are_refused(files):
    data = files[1].read_bytes()
    assert b"limit\0\0\0" in data
    files[1].write_bytes(data.replace(b"limit\0\0\0", b"limbo\0\0\0"))
    with pytest.raises(DataError, match="the unknown outcome 'limbo'"):
        netcdf.read(files[1])


def test_motions_without_a_stop_are_complete():
    motion = Trajectory(np.zeros(1), {})
    assert motion.outcome is Outcome.COMPLETE
    assert motion.metadata["outcome"] == "complete"


def test_quantities_of_climbs_have_the_names_of_dynamics():
    names = ("x", "tilt_rear", "wheel_rate", "axle_x", "load_0", "gap_1", "rubbed", "damped")
    found = sums_0_1({name: Label(name, "1", name) for name in names})
    assert found["solid_load_1"] == {"load_0": 1.0}
    assert found["solid_gap_2"] == {"gap_1": 1.0}
    assert found["y"] == {"x": 1.0}
    assert found["tilt_rear"] == {"tilt_rear": 1.0}
    assert found["lost_energy"] == {"rubbed": 1.0, "damped": 1.0}
    assert "axle_x" not in found
    assert sums_0_1({"x": Label("x", "m", "x")}) == {"x": {"x": 1.0}}


def test_climbs_are_those_of_today():
    """``slipfree run problems/climb_ramp.toml --set time.duration=0.6 --set time.step=0.1``.

    The wheel angles of version 0.1 were absolute.
    """
    old = netcdf.read(DATA / "climb-0.1.0.nc")
    problem = load_problem(PROBLEMS / "climb_ramp.toml", ["time.duration=0.6", "time.step=0.1"])
    new = run_problem(problem).trajectory
    assert old["tilt_front"].max() > 0.1
    for name in ("y", "z", "center_y", "center_z", "tilt_rear", "tilt_front", "wheel_angle"):
        np.testing.assert_allclose(new[name], old[name], atol=1e-5, err_msg=name)
    stored = netcdf_file(DATA / "climb-0.1.0.nc", mmap=False).variables["wheel_angle"].data
    assert np.abs(stored[:, 2] - old["wheel_angle", "front"]).max() > 0.1
