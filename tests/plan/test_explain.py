"""Tests of infeasible plans and their conflicts, of second-order conditions, and of prices."""

import re
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from helpers.cases import BOUNDED_RATES, hills, straight_on
from helpers.toy_models import task, toy
from slipfree import Analytic, Outcome, catalog, direct_kinematics, settle
from slipfree.catalog import articulated, three_wheeler
from slipfree.core.dae import Limit
from slipfree.core.records import Label
from slipfree.plan.constraints import conflicts, with_first_limits
from slipfree.plan.explanation import explanation, more_time, relax, violation_words, violations
from slipfree.plan.ipopt import TIME_STATUS, NlpSolution, solve_program
from slipfree.plan.optimality import check_optimality, limit_prices, price_rows, prices_words
from slipfree.plan.plan import plan
from slipfree.plan.polynomial_motion import guess_unknowns, motion_of
from slipfree.plan.problem import task_of
from slipfree.plan.search import Search, SearchState, solve_relaxed
from slipfree.plan.stage import Cost
from slipfree.plan.transcription import CollocationMesh, Mesh, TimedCondition, transcribe
from slipfree.plan.verification import excess_between


def integrator():
    """x0' = u."""
    return toy(1, lambda _t, _x, _z, u: [u])


def at_end(expression, low, high=None, name="x0_limit", fraction=1.0):
    label = Label(name, "m", "limited by the plan")
    return TimedCondition(fraction, (Limit(label, expression, low, low if high is None else high),))


def along(expression, low, high, name="x0_limit"):
    return Limit(Label(name, "m", "what happens there"), expression, low, high)


def effort(dae):
    return Cost("effort", dae.u.values[0] ** 2, "", "")


def attempted(asked, intervals=8, degree=2, **options):
    """Return the program of a task, where its search ended, and where it began."""
    program = transcribe(asked, CollocationMesh(np.linspace(0, 1, intervals + 1), degree))
    first = np.full(program.scale.size, 0.1)
    first[program.layout.duration] = asked.duration[0]
    weights = np.append(np.ones(len(asked.costs)), 0.0)
    return program, solve_program(program, weights, first, **options), first


def violations_of(program, unknowns):
    rows = np.array(program.jacobian(unknowns / program.scale, np.zeros(1))[0]).ravel()
    blank = solve_program(program, np.zeros(1), unknowns, iterations=0)
    return violations(program, blank._replace(unknowns=unknowns, rows=rows))


def test_a_goal_beyond_the_reach_of_the_input_names_what_must_give():
    """4 m in 1 s at |u| <= 1: the goal is missed by 3 m, or the input has to be 3 larger."""
    dae = integrator()
    goal = at_end(dae.x.values[0], 4.0)
    asked = task(dae, [0.0], costs=[effort(dae)], places=[goal], inputs=(-1, 1))
    program, found, first = attempted(asked)
    assert (found.success, conflicts(asked, None)) == (False, [])
    given = relax(program, first)
    assert given.success
    # In parts of the range of the input 3 / 2 have to be given up, of the goal 3.
    (one,) = given.relaxed
    assert (one.label.full, one.role, one.bound) == ("drive", "input", 1.0)
    assert one.size == pytest.approx(3.0, abs=1e-4)
    held = {(each.label.full, each.role, each.side): each.share for each in given.opposing}
    # A metre less of the goal takes 1 / 2 off; 4 m in 1 s (1 + d) take 4 / 2 d off.
    shares = {("x0", "goal", ""): 0.5, ("duration", "duration", "at most"): 2.0}
    assert held == pytest.approx(shares, rel=1e-2)
    states = given.solution[program.layout.states[:, -1, 0]]
    np.testing.assert_allclose(states[-1], 4.0, atol=1e-6)
    told = explanation(program, found, first).words
    for words in (
        "the constraints contradict each other where the search ended (IPOPT: Infea",
        "x0 at the goal is 3 m below 4 m at t = 1 s",
        "relaxed bounds (one sufficient set; others may exist):\n  input drive: 4 m instead of 1 m",
        "these bounds were not relaxed; relaxing one of them",
        "  x0 at the goal: 4 m",
        "  duration: at most 1 s",
    ):
        assert words in told


@pytest.mark.parametrize("weight", [1.0, 1e4])
def test_a_narrower_goal_gives_before_a_wide_input(weight):
    """The same with a range of the goal of 8 m: now the goal gives, whatever the costs."""
    dae = integrator()
    costs, places = [effort(dae)._replace(weight=weight)], [at_end(dae.x.values[0], 4.0, 12.0)]
    asked = task(dae, [0.0], costs=costs, inputs=(-1, 1), places=places)
    program, _, first = attempted(asked)
    (one,) = relax(program, 0.1 * first).relaxed
    assert (one.label.full, one.role, one.bound, one.t, one.interval) == ("x0", "goal", 4.0, 1.0, 7)
    assert one.value == pytest.approx(1.0, abs=1e-5)
    assert violation_words(one) == "x0 at the goal is 3 m below 4 m at t = 1 s"


def test_motions_that_give_up_the_same_differ_by_their_cost():
    """2 m are asked for, 0.75 m allowed: which way there is free, and even speed costs least."""
    dae = integrator()
    x, options = dae.x.values[0], {"inputs": (-4, 4), "costs": [effort(dae)]}
    limits, places = [along(x, -9.0, 0.75)], [at_end(x, 2.0, 3.0)]
    program, _, first = attempted(task(dae, [0.0], limits=limits, places=places, **options))
    given = relax(program, first)
    (one,) = given.relaxed
    assert (one.label.full, one.role) == ("x0", "limit")
    assert one.value == pytest.approx(2.0, abs=1e-5)
    np.testing.assert_allclose(given.solution[program.layout.inputs], 2.0, atol=1e-3)


def test_times_and_places_of_violations_are_those_of_the_mesh():
    """Of x0 = t on [0, 2] with 2 square <= 4.5 along the way, a way-point, and jumping inputs."""
    dae = integrator()
    x, z = dae.x.values[0], dae.z.values[0]
    limits = [
        along(2 * z, -np.inf, 4.5, "formula"),
        along(z, -np.inf, 4.0, "square_limit"),
        along(x, -np.inf, 1.5),
    ]
    places = [at_end(x, 0.5, fraction=0.5), at_end(x, 2.0)]
    asked = task(dae, [0.0], duration=2.0, inputs=(-0.5, 0.75), limits=limits, places=places)
    asked = replace(asked, accelerations=np.array([[-1.0, 1.0]]))
    program = transcribe(asked, CollocationMesh(np.array([0.0, 0.25, 0.5, 1.0]), 1))
    layout, w = program.layout, np.zeros(program.scale.size)
    w[layout.states[:, 0, 0]] = 0.5, 1.0, 2.0
    w[layout.unknowns[:, 0, 0]] = 0.25, 1.0, 4.0
    w[layout.inputs[:, 0]], w[layout.duration] = (1.0, 0.5, 1.5), 2.0
    found = {(each.role, each.label.full): each for each in violations_of(program, w)}
    assert {key: (each.t, each.interval, each.size, each.bound) for key, each in found.items()} == {
        ("equation", "x0_motion"): (2.0, 2, 0.5, 0.0),
        ("limit", "formula"): (2.0, 2, 3.5, 4.5),
        ("limit", "x0"): (2.0, 2, 0.5, 1.5),
        ("way-point at 0.5", "x0"): (1.0, 1, 0.5, 0.5),
        ("input", "drive"): (1.0, 2, 0.75, 0.75),
        ("input", "drive_change"): (1.0, 1, 1.0, 1.0),
    }
    # In parts of the range 1.25 of the input, of that of its rate 2, and of the formula's own 8.
    sizes = {"drive": 0.75 / 1.25, "drive_change": 1 / 2, "formula": 3.5 / 8}
    assert [name for _, name in found if name in sizes] == list(sizes)
    assert violation_words(found["equation", "x0_motion"]) == (
        "equation x0_motion of the vehicle (collocation equation of state 0) has a residual "
        "of 0.5 m at t = 2 s"
    )
    words = "input drive_change is 1 1/s2 above 1 1/s2 at t = 1 s"
    assert violation_words(found["input", "drive_change"]) == words


def test_what_is_solved_violates_nothing_and_gives_nothing_up():
    dae = integrator()
    x, options = dae.x.values[0], {"inputs": (-1, 1), "costs": [effort(dae)]}
    asked = task(dae, [0.0], places=[at_end(x, 0.5)], limits=[along(x, -1.0, 1.0)], **options)
    program, found, first = attempted(asked)
    assert found.success
    assert (conflicts(asked, None), violations(program, found)) == ([], [])
    given = relax(program, first)
    assert (given.success, given.relaxed, given.opposing) == (True, [], [])
    told = explanation(program, found, first).words
    assert told.startswith("the plan is solved (IPOPT: Solve_Succeeded")
    stuck = solve_program(program, np.array([1.0, 0.0]), first, iterations=0)
    words = "the search reached its maximum number of iterations (?s:.*)no bound has to be relaxed"
    told = explanation(program, stuck, first).words
    assert re.match(f"{words}.*; plan.starts = 4 tries other initial", told)
    late = explanation(program, stuck._replace(status=TIME_STATUS), first).words
    assert late.endswith("was found; raise plan.seconds")
    many = replace(program, mesh=CollocationMesh(np.linspace(0, 1, 82), 1))
    assert more_time(many).endswith("seconds, or plan the way in (shorter) parts: plan.window")


def test_intervals_on_which_a_plan_exceeds_a_limit_between_its_points_are_known():
    """Through 0, 1 and 0 at 0, 1/3 and 1 a parabola rises to 9/8."""
    dae = integrator()
    program = transcribe(task(dae, [0.0]), CollocationMesh(np.array([0, 0.5, 1]), 2))
    unknowns = np.ones(program.scale.size)
    unknowns[program.layout.states[:, :, 0]] = [[1, 0], [0, 0]]
    unknowns[program.layout.first] = 0
    motion = motion_of(program, unknowns)
    for top, worse in ((1.1, [True, False]), (1.13, [False, False])):
        limit = along(dae.x.values[0], -np.inf, top)
        assert (excess_between(program, motion, limit) > 1e-6).tolist() == worse


def test_the_motion_of_the_relaxation_is_the_result_after_the_time_limit():
    """Unless a bound has to be relaxed."""
    dae = integrator()
    for goal in (0.5, 4.0):
        places = [at_end(dae.x.values[0], goal)]
        asked = task(dae, [0.0], costs=[effort(dae)], inputs=(-1, 1), places=places, deadline=0.0)
        program, over, first = attempted(asked, iterations=0)
        over = over._replace(status=TIME_STATUS)
        found = solve_relaxed(SearchState(program, over, first, ()), np.inf, None)
        assert (found.found.success, found.found.status) == (goal < 1, TIME_STATUS)
        missed = violations(program, found.found)
        assert bool(missed) == bool(found.relaxation.relaxed) == (goal > 1)


def test_searches_with_pressed_wheels_are_limited_to_attitudes_in_which_the_vehicle_stands():
    expected = {catalog.rigid_skid_steer: ["upright", "tip_over"], catalog.skid_steer: []}
    for make, names in expected.items():
        dae = direct_kinematics(make(), Analytic(lambda x, y: 0.02 * x * y))
        asked = task_of(dae, settle(dae), goal={"y": 1.0}, costs={"effort": 1.0})
        assert [limit.label.name for limit in with_first_limits(asked).limits] == names


def test_equations_without_a_solution_and_stopped_searches_are_said_to_be_so():
    """z = x0^2 and x0' = sqrt(-1 - z): no input helps."""
    dae = toy(1, lambda _t, _x, z, u: [u + ca.sqrt(-1 - z)])
    asked = task(dae, [0.0], places=[at_end(dae.x.values[0], 0.5)], inputs=(-1, 1))
    assert "although all bounds except those of the sta" in explanation(*attempted(asked)).words
    dae = integrator()
    asked = task(dae, [0.0], places=[at_end(dae.x.values[0], 4.0)], inputs=(-1, 1))
    told = explanation(*attempted(asked, on_iterate=lambda _: False)).words
    assert told.startswith("the search was stopped (IPOPT: User_Requested_Stop")
    assert "x0 at the goal is" in told


def test_conflicts_are_named_before_solving():
    dae = integrator()
    x = dae.x.values[0]
    asked = task(
        dae,
        [-0.5],
        inputs=(1, -1),
        limits=[along(x, 0.0, 2.0), along(x**2 - x, -9, 5, "fence")],
        places=[at_end(x, 3.0, fraction=0.5), at_end(x, 4.0), at_end(x, 5.0, 6.0)],
    )
    asked = replace(asked, accelerations=np.array([[0.5, 1.0]]))
    assert conflicts(asked, None) == [
        "input drive must be at least 1 m and at most -1 m: exchange its bounds",
        "input drive_change must be 0.5 to 1 1/s2, but all inputs are constant on the last "
        "interval: widen the bounds so that they include 0",
        "x0 of the vehicle must be 0 to 2 m, but the start has -0.5 m: start elsewhere or widen "
        "the limit",
        "fence of the vehicle must be -9 to 5 m, but the way-point at 0.5 has 6 m (what happens "
        "there): move the way-point or widen the limit",
        "fence of the vehicle must be -9 to 5 m, but the goal has 12 m (what happens there): move "
        "the goal or widen the limit",
        "x0 at the way-point at 0.5 must be 3 m, but x0 of the vehicle must be 0 to 2 m: move the "
        "way-point or widen the limit",
        "x0 at the goal must be 4 m, but x0 at the goal must be 5 to 6 m: move the goal",
        "x0 at the goal must be 4 m, but x0 of the vehicle must be 0 to 2 m: move the goal or "
        "widen the limit",
        "x0 at the goal must be 5 to 6 m, but x0 of the vehicle must be 0 to 2 m: move the goal or "
        "widen the limit",
    ]


def test_values_are_told_in_map_coordinates():
    dae = replace(integrator(), shift=(np.array([100.0]), np.zeros(1)))
    x = dae.x.values[0]
    asked = task(dae, [0.0], limits=[along(x, -1.0, 2.0)], places=[at_end(x, 4.0)])
    (told,) = conflicts(asked, None)
    assert told.startswith("x0 at the goal must be 104 m, but x0 of the vehicle must be 99 to 102")
    program, found, first = attempted(asked)
    told = explanation(program, found, first).words
    assert "of the vehicle: 104 m instead of 102 m at t = 1 s" in told
    given = relax(program, first)
    near = given._replace(relaxed=[given.relaxed[0]._replace(value=102.00001)])
    told = explanation(program, found, first, near).words
    assert "of the vehicle: 1e-05 m above 102 m at t = 1 s" in told
    assert "x0 at the goal: 104 m" in told


@pytest.mark.slow
def test_limits_of_wheels_and_of_the_model_are_named():
    """A stop of the tilt that the goal exceeds, and a limit that one wheel does not keep to."""
    vehicle, t = three_wheeler(tilt_stop=0.04), np.linspace(0, 5, 31)
    dae, start, guess = straight_on(vehicle, Analytic(hills), 0.45, t)
    goal = {"tilt_right": 0.1, "y": 0.5}
    limits = {"slip_across": (-1.0, 1.0), "contact_y": (-9.0, -0.6)}
    asked = task_of(dae, start, goal=goal, limits=limits, costs={"effort": 1.0}, duration=5.0)
    told = conflicts(asked, start)
    assert told[-1] == (
        "tilt_right at the goal must be 0.1 rad, but model's own tilt_right_stop of the vehicle "
        "must be -0.04 to 0.04 rad: move the goal or adapt vehicle or ground"
    )
    (front,) = [each for each in told if "contact_y of wheel front" in each]
    assert front.startswith("contact_y of wheel front must be -9 to -0.6 m, but the start has ")
    program = transcribe(asked, CollocationMesh(np.linspace(0, 1, 3), 2))
    w = guess_unknowns(program, guess)
    found = {each.label.full: each for each in violations_of(program, w)}
    worst = found["contact_y[front]"]
    assert worst.value == pytest.approx(guess["contact_y", "front"].max(), abs=1e-9)
    assert (worst.t, worst.interval, worst.label.wheel) == (5.0, 1, "front")


# Second-order conditions, and of prices of limits as derivatives of the least cost

STEER, GOAL, DURATION = 0.12, (0.12, 1.3), 10.0


def integrator_optimality(cost, *, count=40, goal=(0.0, 0.0), limits=(), duration=1.0):
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


def checked(program, *, solved=True):
    weights, first = np.array([1.0, 0.0]), np.zeros(program.scale.size)
    first[program.layout.duration] = program.task.duration[0]
    zeros = np.zeros(program.g_lower.size), np.zeros(program.scale.size)
    found = NlpSolution(first, zeros[0], 0.0, *zeros, "", True, 0, {})
    if solved:
        found = solve_program(program, weights, first)
    # a search for strong negative curvatures agrees with the regularisation of IPOPT's last step
    told, again = (
        check_optimality(program, each, weights)
        for each in (found, found._replace(regularisation=np.inf))
    )
    assert (found.success, told) == (True, again)
    return told


def test_the_curvature_of_an_integrator_is_known():
    """The integral of u^2 over n intervals of length h has the Hessian 2 h; the goal takes one."""
    found = checked(integrator_optimality(lambda _t, _x, u: u**2, count=10, goal=(2.0, 2.0)))
    assert (found.is_minimum, found.directions, found.weak) == (True, 9, 0)
    assert found.curvature == pytest.approx(0.2, rel=1e-6)


@pytest.mark.parametrize("solved", [False, True])  # IPOPT takes no step from rest
@pytest.mark.parametrize(("factor", "is_minimum"), [(0.98, 1), (1.02, 0), (1e6, 0), (1e14, 0)])
def test_a_conjugate_point_ends_the_minimum(factor, is_minimum, solved):
    """Jacobi: rest is least for u^2 - c x^2 and x(0) = x(1) = 0 as long as c < pi^2."""
    c = factor * np.pi**2
    program = integrator_optimality(lambda _t, x, u: u**2 - c * ca.times(x, x))
    found = checked(program, solved=solved)
    assert found.is_minimum == is_minimum
    assert ("a strict local minimum" in found.words) == is_minimum


def test_a_cost_that_does_not_change_in_some_direction_is_no_strict_minimum():
    """Inputs of the second half cost nothing."""
    program = integrator_optimality(lambda t, _x, u: u**2 * (t < 0.5), count=10, goal=(1.0, 1.0))
    found = checked(program)
    assert (found.is_minimum, found.curvature) == (False, 0.0)


def test_active_constraints_may_determine_the_plan():
    """The least time to 1 m at most at 1 m/s."""
    limits, times = [(lambda dae: dae.u.values[0], 1.0)], (0.5, 5.0)
    options = {"count": 4, "goal": (1.0, 1.0), "limits": limits, "duration": times}
    found = checked(integrator_optimality(lambda _t, _x, _u: ca.SX(1), **options))
    assert (found.directions, found.words) == (0, "the active constraints determine the plan")


def test_bounds_that_are_touched_without_a_multiplier_are_told():
    """The cost alone takes u = 1/2, the bound, at every point."""
    limits = [(lambda dae: dae.u.values[0], 0.5)]
    program = integrator_optimality(
        lambda _t, _x, u: 1 + (u - 0.5) ** 2, count=4, goal=(-5.0, 5.0), limits=limits
    )
    found = checked(program)
    assert (found.is_minimum, found.weak) == (True, 12)
    assert "strict complementarity fails at 12 bounds" in found.words


@pytest.fixture(scope="module")
def model():
    t = np.linspace(0, DURATION, 31)
    return straight_on(three_wheeler(axle="fixed"), Analytic(hills), 0.45, t)


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
        assert (more.success, less.success) == (True, True)
        slope = (more.solution.cost - less.solution.cost) / (2 * step)
        assert rates[key] == pytest.approx(slope, rel=2e-3), key
    (price,) = (each for each in found.prices if each.label.name == "steer")
    share = 100 * abs(price.rate) * 0.001 / found.solution.cost
    side, change = ("-0.12", "less") if price.side == "at least" else ("0.12", "more")
    words = f"{price.side} {side} rad: 0.001 rad {change} saves {share:.2g} % of the cost"
    assert price.words == f"steer of the vehicle {words}"
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
@pytest.mark.parametrize("limit", [{"progress": lambda _, it: it.number < 1}, {"seconds": 1e-3}])
def test_a_plan_that_is_not_solved_has_no_prices(model, limit):
    found = planned(model, search=Search(**limit))
    timed = "seconds" in limit
    assert (found.success, found.run.outcome is Outcome.TIME_LIMIT) == (False, timed)
    assert ("before its first iteration: the set-up" in found.run.stop.words) == timed
    assert (found.optimality, found.prices) == (None, ())


@pytest.mark.slow
def test_a_steered_frame_does_not_fold_on_the_way_to_a_goal_behind():
    """The stop of its joint holds in the first search."""
    dae = direct_kinematics(articulated(), Analytic(lambda x, y: 0.05 * ca.sin(x) * ca.cos(y)))
    given = {"costs": {"slip": 7e4, "effort": 0.01}, "mesh": Mesh(20, accuracy=5e-3)}
    found = plan(dae, settle(dae), goal={"x": 0.0, "y": -5.0}, **given)
    assert found.success
    assert not any("bend_stop" in stage.words for stage in found.stages)
    (stop,) = (each for each in dae.limits if each.label.full == "bend_stop")
    assert np.abs(found.replay["bend"]).max() < stop.upper


@pytest.mark.slow
def test_a_car_parks_with_its_steering_at_the_stops():
    """Between the points of each finer mesh the steering angle exceeded its stop again."""
    ground = Analytic(lambda x, y: 0.03 * ca.sin(x + 0.4) * ca.cos(y))
    dae = direct_kinematics(catalog.ackermann(), ground)
    x, y = dae.x.x, dae.x.y
    discs = [along((x - 1.5) ** 2 + (y - 2.2 * k) ** 2, 1.96, np.inf, f"d{k}") for k in (1, -1)]
    given = {"costs": {"slip": 1e3, "effort": 0.01}, "limits": discs}
    found = plan(dae, settle(dae), goal={"x": 1.5, "y": 0.0, "heading": 0.0}, **given)
    assert (found.accurate, len(found.stages)) == (True, 3)  # on one finer mesh
    assert 0.69 < np.abs(found.replay["steer"]).max() < 0.7


@pytest.mark.slow
def test_a_bank_that_is_too_high_is_named_with_its_place():
    bank = Analytic(lambda x, y: 0 * x + 0.6 * (1 + ca.tanh((y - 1.5) / 0.4)))
    dae = direct_kinematics(three_wheeler(axle="fixed"), bank)
    goal, limits = {"x": 0.0, "y": (2.5, 3.0)}, {"z": (-1.0, 0.4)}
    given = {"costs": {"effort": 0.01}, "duration": 12.0, "mesh": Mesh(8, degree=2, accuracy=1.0)}
    stop = plan(dae, settle(dae), goal=goal, limits=limits, inputs=BOUNDED_RATES, **given).run.stop
    assert stop.outcome is Outcome.INFEASIBLE
    place = r"at t = .* s, x = -?0\.\d+ m, y = (.*) m"
    assert re.search(rf"largest violations .*\n  .* {place}", stop.words)
    (y,) = re.findall(rf"z of the vehicle: 1\.\d+ m instead of 0\.4 m {place}", stop.words)
    assert 2.0 < float(y) <= 3.0  # on the bank
