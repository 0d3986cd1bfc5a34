"""Tests of several starts of a plan: guesses, local optima, best verified plan, processes."""

import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_array_equal

import slipfree as sf
from helpers.cases import PROBLEMS
from helpers.commands import invoke, printed, refuses, sets
from slipfree.catalog import three_wheeler
from slipfree.core.dae import Limit
from slipfree.core.records import Label
from slipfree.core.trajectory import Stop
from slipfree.files import netcdf
from slipfree.files.toml import ProblemError
from slipfree.plan import plan as planning
from slipfree.plan.search import count_distinct, distances, further_guesses
from slipfree.plan.verification import verify_plan

pytestmark = pytest.mark.slow

PROBLEM = PROBLEMS / "plan_rigid_hills.toml"
FEW = ("plan.intervals=7", "plan.starts=2")
FREE = np.array([[-2.0, 2.0]] * 3)


def bump(x, y):
    """A hill beside the straight way, 0.4 m high."""
    return 0.4 * ca.exp(-(((x - 0.03) / 0.5) ** 2) - ((y - 1.5) / 0.5) ** 2)


@pytest.fixture(scope="module")
def model():
    dae = sf.direct_kinematics(three_wheeler(axle="fixed"), sf.Analytic(bump))
    return dae, sf.settle(dae)


def led(model, side):
    """Return the motion past the hill on a side."""
    dae, start = model
    way = sf.Path(np.array([[0.0, 0.0], [0.5 * side, 0.8], [0.9 * side, 1.5], [0.0, 3.0]]))
    law = sf.follow(dae, way, speed=0.25)
    return sf.simulate(dae, start, law, np.linspace(0, way.length / 0.25, 41))


def planned(model, guess, **options):
    """Return a plan that stays off the top of the hill."""
    dae, start = model
    top = (dae.x.x - 0.03) ** 2 + (dae.x.y - 1.5) ** 2
    return sf.plan(
        dae,
        start,
        guess,
        goal={"x": 0.0, "y": 3.0},
        costs={"effort": 0.01, "slip": 1e3},
        duration=16.0,
        smooth=0.002,
        inputs=dict.fromkeys(("right_rate", "left_rate", "steer_rate"), (-2.0, 2.0)),
        limits=[Limit(Label("top", "m2", "the hill is too near"), top, 0.16, np.inf)],
        mesh=sf.Mesh(10, accuracy=1e-2),
        **options,
    )


def test_both_sides_of_a_hill_are_local_optima_and_the_cheaper_one_is_returned(model):
    both = planned(model, [led(model, -1), led(model, 1)])
    assert both.success
    assert both.solution.cost == both.optima[0].cost < both.optima[1].cost
    assert [each.outcome for each in both.optima] == ["verified", "solved"]
    assert distances(both.optima)[1] > 0.5
    assert count_distinct(both.optima) == 2


def test_the_best_verified_plan_counts(model, monkeypatch):
    """The simulation of the cheapest plan is made to miss it."""
    calls = []

    def missed(*args, **options):
        found = verify_plan(*args, **options)
        calls.append(found)
        return found._replace(accurate=len(calls) > 1, worse=np.zeros(0, dtype=bool), misses=())

    monkeypatch.setattr(planning, "verify_plan", missed)
    both = planned(model, [led(model, -1), led(model, 1)])
    assert both.accurate
    assert [each.outcome for each in both.optima] == ["verified", "inaccurate"]
    assert both.optima[0].cost > both.optima[1].cost
    assert both.solution.cost == both.optima[0].cost


def test_a_plan_is_verified_at_its_tolerance_where_a_tighter_one_fails(model, monkeypatch):
    def simulated(*args, options, simulate=sf.simulate, **more):
        run = simulate(*args, options=options, **more)
        if options.tolerance == 1e-8:
            return run
        stop = Stop("solver", run.t[1], "IDA_CONV_FAIL", sf.Outcome.SOLVER_FAILURE)
        raise sf.SolverError(stop.words, replace(run.part(slice(2)), stop=stop))

    guess = led(model, 1)
    monkeypatch.setattr("slipfree.solve.simulate.simulate", simulated)
    found = planned(model, [guess])
    assert (found.accurate, found.replay.statistics["tolerance"]) == (True, 1e-8)
    asked = found.program, found.solution.unknowns, model[1]
    late = verify_plan(*asked, accuracy=1e-2, step=0.1, deadline=0.0)
    shown = late.accurate, late.difference, late.replay.stop.name, late.replay.outcome
    assert shown == (False, {}, "plan_unverified", sf.Outcome.TIME_LIMIT)
    assert late.replay.stop.words.endswith("at t = 0 s of 16 s; raise plan.seconds")


def test_further_guesses_depend_on_the_seed_alone_and_keep_to_bounds(model):
    dae, start = model
    inputs = dae.inputs(right_rate=0.5, left_rate=0.5, steer_rate=0.0)
    guess = sf.simulate(dae, start, inputs, np.linspace(0, 4, 21))

    def rates(bounds=FREE, seed=0):
        found = further_guesses(dae, start, guess, bounds, 3, seed)
        return {name: run["right_rate"] for name, run in found}

    first, again, other = rates(), rates(), rates(seed=1)
    assert list(first) == ["reversed", "perturbed 1", "perturbed 2"]
    assert first["reversed"].max() < 0
    assert_array_equal([*first.values()], [*again.values()])
    for another in (other["perturbed 1"], first["perturbed 2"]):
        assert np.abs(first["perturbed 1"] - another).max() > 0.01
    forward = rates(np.array([[0.0, 0.55], [0.0, 0.55], [-1.0, 1.0]]))
    assert list(forward) == ["perturbed 1", "perturbed 2", "perturbed 3"]
    values = np.concatenate(list(forward.values()))
    assert_array_equal(values, values.clip(0, 0.55))


def test_no_starts_and_starts_that_cannot_be_simulated_are_an_error(model, monkeypatch):
    with pytest.raises(sf.ModelError, match="Search: starts: expected a number >= 1, found 0"):
        planned(model, led(model, 1), search=sf.Search(starts=0))
    monkeypatch.setattr("slipfree.system.processes.available_cores", lambda: 1)

    def fail(*_args, **_options):
        raise sf.ModelError("no guess")

    monkeypatch.setattr("slipfree.problem.verbs.plan_search.find_plan", fail)
    refuses(ProblemError, "guess 1 failed: no guess", sf.run_problem, sf.load_problem(PROBLEM, FEW))


def table(run):
    """Return the rows of the table of starts without the times of their search."""
    return [{**row, "seconds": 0.0} for row in run.facts["plan_starts"].value]


def test_starts_in_processes_are_those_of_one_process(tmp_path, monkeypatch):
    out = tmp_path / "p.nc"
    invoke("run", PROBLEM, "-o", out, "--no-draw", *sets(*FEW), code=0)
    told = printed("info", out)
    assert re.search(r"^starts +\d local optim\w+ from 2 starts$", told, re.MULTILINE)
    assert re.search(r"^  follow +verified, cost 0\.\d+, duration ", told, re.MULTILINE)
    stored = netcdf.read(out)
    monkeypatch.setattr("slipfree.system.processes.available_cores", lambda: 1)
    alone = sf.run_problem(sf.load_problem(PROBLEM, FEW)).trajectory
    assert table(stored) == table(alone)
    assert_array_equal(stored["x"], alone["x"])


def test_an_interrupt_keeps_the_best_start_so_far(monkeypatch):
    monkeypatch.setattr("slipfree.system.processes.available_cores", lambda: 1)

    def interrupt(phase, line):
        if phase == "starts" and "1 of 2" in line:
            raise KeyboardInterrupt

    found = sf.run_problem(sf.load_problem(PROBLEM, FEW), tell=interrupt)
    assert found.outcome is sf.Outcome.INTERRUPTED
    assert len(found.trajectory.facts["plan_starts"].value) == 1
    assert found.trajectory["y"][-1] == pytest.approx(2.6, abs=1e-3)
