"""Tests of infeasible plans: conflicts found before solving, violations and relaxations after."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from helpers.cases import hills
from helpers.toy_models import task, toy
from slipfree import Analytic, direct_kinematics, settle, simulate
from slipfree.catalog import three_wheeler
from slipfree.core.dae import Limit
from slipfree.core.records import Label
from slipfree.plan.constraints import conflicts
from slipfree.plan.explanation import explanation, relax, violation_words, violations
from slipfree.plan.ipopt import solve_program
from slipfree.plan.polynomial_motion import guess_unknowns
from slipfree.plan.problem import limits_of
from slipfree.plan.stage import Cost
from slipfree.plan.transcription import CollocationMesh, PlanTask, TimedCondition, transcribe


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


def test_a_goal_beyond_the_reach_of_the_input_names_what_must_give():
    """4 m in 1 s at |u| <= 1: the goal is missed by 3 m, or the input has to be 3 larger."""
    dae = integrator()
    goal = at_end(dae.x.values[0], 4.0)
    asked = task(dae, [0.0], costs=[effort(dae)], places=[goal], inputs=(-1, 1))
    program, found, first = attempted(asked)
    assert not found.success
    assert conflicts(asked, None) == []
    given = relax(program, first)
    assert given.success
    # In parts of the range of the input 3 / 2 have to be given up, of the goal 3.
    (one,) = given.relaxed
    assert (one.label.full, one.role, one.bound) == ("drive", "input", 1.0)
    assert one.size == pytest.approx(3.0, abs=1e-4)
    held = {(each.label.full, each.role, each.side): each for each in given.opposing}
    assert set(held) == {("x0", "goal", ""), ("duration", "duration", "at most")}
    # A metre less of the goal takes 1 / 2 off; 4 m in 1 s (1 + d) take 4 / 2 d off.
    assert held["x0", "goal", ""].share == pytest.approx(0.5, rel=1e-2)
    assert held["duration", "duration", "at most"].share == pytest.approx(2.0, rel=1e-2)
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
    asked = task(
        dae,
        [0.0],
        costs=[effort(dae)._replace(weight=weight)],
        inputs=(-1, 1),
        places=[at_end(dae.x.values[0], 4.0, 12.0)],
    )
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
    rows = np.array(program.jacobian(w / program.scale, np.zeros(1))[0]).ravel()
    blank = solve_program(program, np.zeros(1), w, iterations=0)._replace(unknowns=w, rows=rows)
    found = {(each.role, each.label.full): each for each in violations(program, blank)}
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
    assert conflicts(asked, None) == []
    assert violations(program, found) == []
    given = relax(program, first)
    assert given.success
    assert given.relaxed == given.opposing == []
    told = explanation(program, found, first).words
    assert told.startswith("the plan is solved (IPOPT: Solve_Succeeded")
    stuck = solve_program(program, np.array([1.0, 0.0]), first, iterations=0)
    told = explanation(program, stuck, first).words
    words = "the search reached its maximum number of iterations (IPOPT: Maximum_Iterations"
    assert told.startswith(words)
    assert "no bound has to be relaxed" in told


def test_equations_without_a_solution_and_stopped_searches_are_said_to_be_so():
    """z = x0^2 and x0' = sqrt(-1 - z): no input helps."""
    dae = toy(1, lambda _t, _x, z, u: [u + ca.sqrt(-1 - z)])
    asked = task(dae, [0.0], places=[at_end(dae.x.values[0], 0.5)], inputs=(-1, 1))
    words = "although all bounds except those of the start"
    assert words in explanation(*attempted(asked)).words
    dae = integrator()
    asked = task(dae, [0.0], places=[at_end(dae.x.values[0], 4.0)], inputs=(-1, 1))
    told = explanation(*attempted(asked, on_iterate=lambda _: False)).words
    assert told.startswith("the search was stopped (IPOPT: User_Requested_Stop")
    assert "x0 at the goal is" in told
    assert "suffices" not in told


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
    assert "x0 at the goal: 104 m" in told


@pytest.mark.slow
def test_limits_of_wheels_and_of_the_model_are_named():
    """A stop of the tilt that the goal exceeds, and a limit that one wheel does not keep to."""
    dae = direct_kinematics(three_wheeler(tilt_stop=0.04), Analytic(hills))
    start = settle(dae)
    inputs = dae.inputs(right_rate=0.45, left_rate=0.45, steer_rate=0.0)
    guess = simulate(dae, start, inputs, np.linspace(0, 5, 31))
    asked = PlanTask(
        dae,
        dae.rows("x", start, -1),
        (5.0, 5.0),
        (),
        (TimedCondition(1.0, limits_of(dae, {"tilt_right": (0.1, 0.1), "y": (0.5, 0.5)})),),
        limits_of(dae, {"slip_across": (-1.0, 1.0), "contact_y": (-9.0, -0.6)}),
        np.array([[-0.5, 0.5]] * 3),
        np.tile([-np.inf, np.inf], (3, 1)),
        0.01,
    )
    told = conflicts(asked, start)
    assert told[-1] == (
        "tilt_right at the goal must be 0.1 rad, but model's own tilt_right_stop of the vehicle "
        "must be -0.04 to 0.04 rad: move the goal or adapt vehicle or ground"
    )
    (front,) = [each for each in told if "contact_y of wheel front" in each]
    assert front.startswith("contact_y of wheel front must be -9 to -0.6 m, but the start has ")
    program = transcribe(asked, CollocationMesh(np.linspace(0, 1, 3), 2))
    w = guess_unknowns(program, guess)
    rows = np.array(program.jacobian(w / program.scale, np.zeros(1))[0]).ravel()
    blank = solve_program(program, np.zeros(1), w, iterations=0)._replace(unknowns=w, rows=rows)
    found = {each.label.full: each for each in violations(program, blank)}
    worst = found["contact_y[front]"]
    assert worst.value == pytest.approx(guess["contact_y", "front"].max(), abs=1e-9)
    assert (worst.t, worst.interval, worst.label.wheel) == (5.0, 1, "front")
