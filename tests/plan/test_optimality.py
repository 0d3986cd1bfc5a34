"""Tests of second-order conditions, and of prices of limits as derivatives of the least cost."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from helpers.cases import hills
from helpers.toy_models import task, toy
from slipfree import Analytic, direct_kinematics, settle, simulate
from slipfree.catalog import three_wheeler
from slipfree.core.dae import Limit
from slipfree.core.records import Label
from slipfree.plan.ipopt import NlpSolution, solve_program
from slipfree.plan.optimality import check_optimality, limit_prices, price_rows, prices_words
from slipfree.plan.plan import plan
from slipfree.plan.search import Search
from slipfree.plan.stage import Cost
from slipfree.plan.transcription import CollocationMesh, Mesh, TimedCondition, transcribe

STEER, GOAL, DURATION = 0.12, (0.12, 1.3), 10.0


def integrator(cost, *, count=40, goal=(0.0, 0.0), limits=(), duration=1.0):
    """Return the program of x' = u from 0 to a range, u constant on every interval."""
    dae = toy(1, lambda _t, _x, _z, u: [u])
    end = TimedCondition(1.0, (Limit(Label("end", "m", ""), dae.x.values[0], *goal),))
    asked = task(
        dae,
        [0.0],
        costs=[Cost("cost", cost(dae.t, dae.x.values[0], dae.u.values[0]), "", "")],
        places=[end],
        limits=[Limit(Label("bound", "m", ""), each(dae), -np.inf, top) for each, top in limits],
        duration=duration,
    )
    return transcribe(asked, CollocationMesh(np.linspace(0, 1, count + 1), 3))


def checked(program, unknowns=None):
    weights = np.array([1.0, 0.0])
    if unknowns is None:
        first = np.zeros(program.scale.size)
        first[program.layout.duration] = program.task.duration[0]
        found = solve_program(program, weights, first)
        assert found.success
    else:
        zeros = np.zeros(program.g_lower.size), np.zeros(program.scale.size)
        found = NlpSolution(unknowns, zeros[0], 0.0, *zeros, "", True, 0, {})
    return check_optimality(program, found, weights)


def test_the_curvature_of_an_integrator_is_known():
    """The integral of u^2 over n intervals of length h has the Hessian 2 h; the goal takes one."""
    found = checked(integrator(lambda _t, _x, u: u**2, count=10, goal=(2.0, 2.0)))
    assert found.is_minimum
    assert found.directions == 9
    assert found.weak == 0
    assert found.curvature == pytest.approx(0.2, rel=1e-6)


@pytest.mark.parametrize(("factor", "is_minimum"), [(0.98, True), (1.02, False), (1e6, False)])
def test_a_conjugate_point_ends_the_minimum(factor, is_minimum):
    """Jacobi: rest is least for u^2 - c x^2 and x(0) = x(1) = 0 as long as c < pi^2."""
    c = factor * np.pi**2
    program = integrator(lambda _t, x, u: u**2 - c * ca.times(x, x))
    rest = np.zeros(program.scale.size)
    rest[program.layout.duration] = 1.0
    found = checked(program, rest)
    assert found.is_minimum == is_minimum
    assert ("a strict local minimum" in found.words) == is_minimum


def test_a_cost_that_does_not_change_in_some_direction_is_no_strict_minimum():
    """Inputs of the second half cost nothing."""
    found = checked(integrator(lambda t, _x, u: u**2 * (t < 0.5), count=10, goal=(1.0, 1.0)))
    assert not found.is_minimum
    assert found.curvature == 0.0


def test_active_constraints_may_determine_the_plan():
    """The least time to 1 m at most at 1 m/s."""
    program = integrator(
        lambda _t, _x, _u: ca.SX(1),
        count=4,
        goal=(1.0, 1.0),
        limits=[(lambda dae: dae.u.values[0], 1.0)],
        duration=(0.5, 5.0),
    )
    found = checked(program)
    assert found.directions == 0
    assert found.words == "the active constraints determine the plan"


def test_bounds_that_are_touched_without_a_multiplier_are_told():
    """The cost alone takes u = 1/2, the bound, at every point."""
    limits = [(lambda dae: dae.u.values[0], 0.5)]
    program = integrator(
        lambda _t, _x, u: 1 + (u - 0.5) ** 2, count=4, goal=(-5.0, 5.0), limits=limits
    )
    found = checked(program)
    assert found.is_minimum
    assert found.weak == 12
    assert "strict complementarity fails at 12 bounds" in found.words


@pytest.fixture(scope="module")
def model():
    dae = direct_kinematics(three_wheeler(axle="fixed"), Analytic(hills))
    start = settle(dae)
    inputs = dae.inputs(right_rate=0.45, left_rate=0.45, steer_rate=0.0)
    return dae, start, simulate(dae, start, inputs, np.linspace(0, DURATION, 31))


def planned(model, *, steer=STEER, x=GOAL[0], duration=DURATION, rate=0.1, **options):
    rates = {"right_rate": (-2.0, 2.0), "left_rate": (-2.0, 2.0), "steer_rate": (-rate, rate)}
    return plan(
        *model,
        goal={"x": x, "y": GOAL[1]},
        costs={"slip": 1e3, "effort": 0.01},
        smooth=0.002,
        duration=duration,
        limits={"steer": (-steer, steer)},
        inputs=rates,
        mesh=Mesh(5, accuracy=1.0),
        **options,
    )


@pytest.mark.slow
def test_prices_are_the_derivatives_of_the_least_cost(model):
    """Central differences of plans with limits on both sides; told in units and shares."""
    found, rates = planned(model), {}
    for price in found.prices:
        sign = -1 if price.side == "at least" else 1
        key = price.role, price.label.name
        rates[key] = rates.get(key, 0.0) + sign * price.rate
    for key, name, value, step in (
        (("limit", "steer"), "steer", STEER, 1e-4),
        (("goal", "x"), "x", GOAL[0], 1e-4),
        (("duration", "duration"), "duration", DURATION, 1e-2),
        (("input", "steer_rate"), "rate", 0.1, 1e-4),
    ):
        more, less = (planned(model, **{name: value + each}) for each in (step, -step))
        assert more.success
        assert less.success
        slope = (more.solution.cost - less.solution.cost) / (2 * step)
        assert rates[key] == pytest.approx(slope, rel=2e-3), key
    (price,) = (each for each in found.prices if each.label.name == "steer")
    share = 100 * abs(price.rate) * 0.001 / found.solution.cost
    side = "at least -0.12" if price.side == "at least" else "at most 0.12"
    direction = "less" if price.side == "at least" else "more"
    words = (
        f"steer of the vehicle {side} rad: 0.001 rad {direction} saves {share:.2g} % of the cost"
    )
    assert price.words == words
    assert words in prices_words(price_rows(found.prices))
    assert prices_words(()) == "no limit increases the cost noticeably"


def test_price_of_a_limited_cost_is_its_lagrange_multiplier():
    """The integral of x^2 from 0 to 1 is least for x = sinh kt / sinh k at a price of 1/k^2."""
    dae, k = toy(1, lambda _t, _x, _z, u: [u]), 3.0
    x, u, size = dae.x.values[0], dae.u.values[0], np.sinh(k) ** 2
    asked = task(
        dae,
        [0.0],
        costs=[Cost("area", x**2, "m2 s", ""), Cost("work", u**2, "m2 s-1", "", 0.0)],
        places=[TimedCondition(1.0, (Limit(Label("end", "m", ""), x, 1.0, 1.0),))],
        continuous=True,
        cost_limits=((1, k**2 * (0.5 + np.sinh(2 * k) / (4 * k)) / size),),
    )
    program = transcribe(asked, CollocationMesh(np.linspace(0, 1, 21), 3))
    first = np.zeros(program.scale.size)
    first[program.layout.duration] = 1.0
    found = solve_program(program, np.array([1.0, 0.0, 0.0]), first)
    assert found.success
    assert found.cost == pytest.approx((np.sinh(2 * k) / (4 * k) - 0.5) / size, rel=1e-5)
    (price,) = (each for each in limit_prices(program, found) if each.role == "cost")
    assert price.rate == pytest.approx(-1 / k**2, rel=1e-3)
    assert price.words.startswith(f"cost work at most {price.bound:.4g} m2/s: ")


@pytest.mark.slow
def test_a_plan_that_is_not_solved_has_no_prices(model):
    search = Search(progress=lambda _words, iterate: iterate.number < 1)
    found = planned(model, search=search)
    assert not found.success
    assert found.optimality is None
    assert found.prices == ()
