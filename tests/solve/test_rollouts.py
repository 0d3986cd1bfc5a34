"""Rollouts: each run equals one simulation, whatever the processes; errors stop one run only."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_array_equal

from helpers.cases import LIGHT, hills
from slipfree import (
    Analytic,
    ModelError,
    SolverOptions,
    direct_kinematics,
    rollouts,
    settle,
    simulate,
)
from slipfree.catalog import three_wheeler

T = np.linspace(0, 2, 5)
OPTIONS = SolverOptions(tolerance=1e-6)


def on_hills(trail=0.0):
    """A model of a vehicle without masses, with a parameter that lifts the ground."""
    return direct_kinematics(three_wheeler(**LIGHT), Analytic(lambda x, y: hills(x, y) + trail))


@pytest.fixture(scope="module")
def dae():
    return on_hills()


def rates(count, seed=0):
    found = np.random.default_rng(seed).uniform(0.2, 0.6, (2, count, T.size - 1))
    return {"right_rate": found[0], "left_rate": found[1], "steer_rate": 0.0}


def of_run(inputs, k):
    return {name: each[k] if np.ndim(each) == 2 else each for name, each in inputs.items()}


def test_each_run_equals_a_simulation(dae):
    headings, inputs = np.array([0.0, -1.1]), rates(2)
    found = rollouts(dae, {"heading": headings, "x": 0.2}, inputs, T, options=OPTIONS)
    assert found["slip_along"].dims == ("run", "time", "wheel")
    assert found["x"].attrs["units"] == "m"
    for k, heading in enumerate(headings):
        start = settle(dae, heading=heading, x=0.2, options=OPTIONS)
        run = simulate(dae, start, dae.inputs(**of_run(inputs, k)), T, options=OPTIONS)
        for name in run:
            assert_array_equal(found[name][k], run[name], err_msg=name)
    assert (found["outcome"] == "complete").all()
    assert (found["end"] == T[-1]).all()


@pytest.mark.slow
def test_results_do_not_depend_on_processes_or_order():
    inputs, p = rates(7), {"trail": [0.0, 0.3, 0.0, 0.3, 0.0, 0.0, 0.3]}
    arguments = {"p": p, "quantities": ("x", "z", "clearance"), "options": OPTIONS}
    alone = rollouts(on_hills, {}, inputs, T, **arguments)
    assert set(alone) == {"x", "z", "clearance", "outcome", "reason", "end"}
    two = rollouts(on_hills, {}, inputs, T, processes=2, **arguments)
    assert alone.identical(two)
    back = {k: v[::-1] if np.ndim(v) else v for k, v in inputs.items()}
    reverse = rollouts(on_hills, {}, back, T, **(arguments | {"p": {"trail": p["trail"][::-1]}}))
    for name in alone:
        assert_array_equal(reverse[name][::-1], alone[name])
    assert np.ptp(alone["z"].values[:, 0]) > 0.29  # the parameter has an effect


def test_a_run_that_ends_early_or_has_no_start_does_not_stop_the_others():
    ground = Analytic(hills, (-3.0, 3.0, -3.0, 1.3))
    dae = direct_kinematics(three_wheeler(**LIGHT), ground)
    speeds = {"right_rate": [[0.1], [2.0], [0.1]], "left_rate": [[0.1], [2.0], [0.1]]}
    starts = {"y": [0.0, 0.0, 5.0]}
    found = rollouts(dae, starts, speeds | {"steer_rate": 0.0}, T, options=OPTIONS)
    assert found["outcome"].values.tolist() == ["complete", "limit", "failed"]
    complete, limit, failed = found["reason"].values.tolist()
    assert complete == ""
    assert "map" in limit
    assert "start" in failed
    assert 0 < found["end"][1] < T[-1]
    assert np.isnan(found["end"][2])
    assert_array_equal(np.isnan(found["x"]).all(axis=1), [False, False, True])
    assert_array_equal(np.isnan(found["x"][1]), found["end"][1].item() < T)


def test_trajectories_and_expressions_are_starts_and_inputs(dae):
    starts = [settle(dae, heading=heading) for heading in (0.0, 0.5)]
    law = {"right_rate": 0.3 + 0.1 * ca.sin(dae.t), "left_rate": 0.3, "steer_rate": 0.0}
    found = rollouts(dae, starts, law, T)
    run = simulate(dae, starts[1], dae.inputs(**law), T)
    assert_array_equal(found["heading"][1], run["heading"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"starts": {"x": np.zeros((2, 2))}}, r"starts\['x'\]: expected .*found shape \(2, 2\)"),
        ({"starts": {"x": np.zeros(3)}}, r"starts\['x'\]: expected values for 1 run or for 4 runs"),
        (
            {"starts": 1.0},
            "starts: expected Trajectory or a sequence of Trajectory or a mapping, found float",
        ),
        ({"inputs": rates(4) | {"steer_rate": np.zeros(3)}}, r"steer_rate.*found shape \(3,\)"),
        ({"inputs": {"right_rate": 0.1}}, "inputs: expected values for .*no value for"),
        ({"p": {"trail": [0.0]}}, "model: expected a function of the parameters in p"),
        ({"processes": 2}, "model: expected a function for 2 processes, found a model"),
        ({"processes": 0}, "processes: expected a number >= 1, found 0"),
        ({"quantities": ["speed"]}, "expected a quantity of the trajectory, found 'speed'"),
        (
            {"model": lambda: None, "processes": 2},
            "model: expected a function at the level of a module.*pickle",
        ),
    ],
)
def test_wrong_arguments_are_refused(dae, arguments, words):
    given = {"model": dae, "starts": {}, "inputs": rates(4), "t": T} | arguments
    if callable(given["model"]):
        given["model"] = lambda: dae
    with pytest.raises(ModelError, match=words):
        rollouts(**given)


@pytest.mark.filterwarnings("ignore:equations are interpreted:UserWarning")
def test_runs_at_absurd_speeds_end_by_name(dae):
    inputs = {"right_rate": np.array([[1e9], [0.5]]), "left_rate": 0.5, "steer_rate": 0.0}
    found = rollouts(dae, {"heading": 0.3}, inputs, np.linspace(0, 1, 3), method="batch")
    assert found["outcome"].values.tolist() == ["solver_failure", "complete"]
    assert "at most 20000 steps of" in found["reason"].values[0]
