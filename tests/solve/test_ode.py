"""Tests of solvers: models without algebraic unknowns, Newton's method, turns, codes and stops."""

from dataclasses import replace
from functools import partial
from math import pi
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import hilbert

import slipfree as sf
from helpers.commands import error_of, refuses
from helpers.rounding import root
from helpers.toy_models import model, toy
from slipfree import plan as search
from slipfree.catalog import three_wheeler
from slipfree.core.dae import Continuation, PiecewiseLinear
from slipfree.core.newton import solve_equations, solve_linear
from slipfree.core.records import leaves
from slipfree.core.trajectory import IPOPT_STATUSES, SUNDIALS_FLAGS, ipopt_words, sundials_words
from slipfree.plan.mpc import first_cycle, horizon
from slipfree.plan.problem import limits_of, near_conditions, timed_conditions
from slipfree.solve.integrator import STALLED_STEPS, StepObserver
from slipfree.solve.sampling import periodic_states, same_turn
from slipfree.system.interrupt import InterruptGuard


def test_a_stiff_equation_has_its_solution():
    """``x' = -1e4 (x - cos t)``, which explicit methods take 1e4 steps for."""
    k, t = 1e4, np.linspace(0, 3, 31)
    dae = model(lambda t, x, u: -k * (x - ca.cos(t)) + u)
    start = sf.settle(dae, x=0.0)
    exact = (k**2 * (np.cos(t) - np.exp(-k * t)) + k * np.sin(t)) / (k**2 + 1)
    for tolerance in (1e-6, 1e-8):
        run = sf.simulate(
            dae, start, dae.inputs(push=0.0), t, options=sf.SolverOptions(tolerance=tolerance)
        )
        assert run.stop is None
        assert_allclose(run["x"], exact, atol=10 * tolerance)
        assert_allclose(run["twice"], 2 * run["x"])
        steps = run.statistics["steps"]
        assert_allclose(run["sum"], np.sin(t) - exact / k, atol=steps * tolerance)
        assert steps < 500
    other = sf.simulate(
        dae, start, dae.inputs(push=0.0), t, options=sf.SolverOptions(tolerance=1e-8, method="idas")
    )
    assert_allclose(other["x"], exact, atol=1e-6)


def test_newtons_method_ends_within_the_tolerance():
    """A block under a growing push, ``v' = u sin t - mu g v / sqrt(v^2 + eps^2)``.

    Its friction changes slope while CVODES keeps its Jacobian. CVODES's default criterion for
    Newton's method gives errors of up to 3.6 tolerances here.
    """
    mu_g, eps, t = 0.8 * 9.81, 1e-3, np.linspace(0, 1.5, 16)
    dae = model(lambda t, v, u: u * ca.sin(t) - mu_g * v / ca.sqrt(v**2 + eps**2))
    start, inputs = sf.settle(dae, x=0.0), dae.inputs(push=0.7 * 9.81)
    exact = sf.simulate(dae, start, inputs, t, options=sf.SolverOptions(tolerance=1e-12))
    for tolerance in np.geomspace(1e-4, 1e-9, 11):
        run = sf.simulate(dae, start, inputs, t, options=sf.SolverOptions(tolerance=tolerance))
        assert_allclose(run["x"], exact["x"], atol=tolerance)


def test_steps_that_do_not_advance_end_the_call():
    observer = StepObserver(InterruptGuard())
    for t in [*np.linspace(0, 1e-9, 500), *np.full(1 + STALLED_STEPS, 3.0)]:
        observer.observe(t, 1.0, 1.0)
    refuses(sf.SolverError, "shorter than the rounding", observer.observe, 3.0, 1.0, 1.0)


def test_a_limit_ends_the_motion_at_its_crossing():
    dae = model(lambda _t, x, u: x + u, limits=[(-np.inf, 2.0)])
    run = sf.simulate(dae, sf.settle(dae, x=1.0), dae.inputs(push=0.0), np.linspace(0, 3, 7))
    assert run.stop.name == "bound"
    assert_allclose(run.stop.t, np.log(2), atol=1e-5)
    assert run["x"][-1] <= 2 + 1e-5
    dae = model(lambda _t, _x, u: u, limits=[(-np.inf, 0.55)])
    start, inputs = sf.settle(dae, x=0.0), dae.inputs(push=1.0)
    run = sf.simulate(dae, start, inputs, np.arange(11) * 0.1, sampled=True)
    assert run.stop.name == "bound"
    assert_allclose(run.stop.t, 0.55, atol=1e-5)
    assert "x is out of bounds: 0.55" in run.stop.words


@pytest.mark.slow
def test_a_motion_that_goes_to_infinity_is_told_of():
    dae, t = model(lambda _t, x, u: x**2 + u), np.linspace(0, 2, 21)
    with pytest.raises(sf.SolverError, match=r"stopped at t = (0\.99|1)") as caught:
        sf.simulate(dae, sf.settle(dae, x=1.0), dae.inputs(push=0.0), t)
    assert "steps have become shorter" in str(caught.value)
    assert caught.value.trajectory["x"][-1] > 50
    with pytest.raises(sf.SolverError, match=r"stopped at t = 0\.9"):
        sf.simulate(dae, sf.settle(dae, x=1.0), dae.inputs(push=0.0), t, sampled=True)


def test_jumps_of_an_input():
    dae, t = model(lambda _t, x, u: u - x), np.linspace(0, 2, 3)
    run = sf.simulate(dae, sf.settle(dae, x=0.0), dae.inputs(push=np.array([1.0, -1.0])), t)
    assert_allclose(run["x"], [0, 1 - np.exp(-1), (2 - np.exp(-1)) * np.exp(-1) - 1], atol=1e-7)


# Sampled


def test_a_held_law_has_its_difference_equation():
    """``x' = u``, u held at ``-k x``: x is multiplied by ``1 - k T``."""
    dae, period, k = model(lambda _t, _x, u: u), 0.1, 7.0
    t = np.arange(21) * period
    law = dae.inputs(push=-k * dae.x[0])
    run = sf.simulate(dae, sf.settle(dae, x=1.0), law, t, sampled=True)
    exact = (1 - k * period) ** np.arange(21)
    assert_allclose(run["x"], exact, atol=1e-10)
    assert_allclose(run["push"], -k * exact, atol=1e-9)
    steps = period * (exact[1:] + exact[:-1]) / 2
    assert_allclose(run["sum"], np.append(0, np.cumsum(steps)), atol=20e-8)


def test_a_held_law_knows_the_time():
    dae = model(lambda t, _x, u: u + t)
    t = 1.0 + np.arange(11) * 0.1
    start = sf.settle(dae, x=0.0)
    run = sf.simulate(dae, start, dae.inputs(push=-dae.t), t, sampled=True)
    assert_allclose(run["x"], 0.1**2 / 2 * np.arange(11), atol=10e-8)
    numbers = np.arange(10.0)
    run = sf.simulate(dae, start, dae.inputs(push=numbers), t, sampled=True)
    own = sf.simulate(dae, start, dae.inputs(push=numbers), t)
    assert_allclose(run["x"], own["x"], atol=1e-7)


def test_what_a_method_cannot_do_is_refused():
    dae, t = (
        sf.direct_kinematics(three_wheeler(), sf.Analytic(lambda x, _y: 0 * x)),
        np.arange(3) * 0.1,
    )
    start, given = sf.settle(dae), dae.inputs(right_rate=0.5, left_rate=0.5, steer_rate=0.0)
    with pytest.raises(
        sf.ModelError, match=r"'cvodes' cannot solve for the \d+ algebraic unknowns"
    ):
        sf.simulate(dae, start, given, t, options=sf.SolverOptions(method="cvodes"))
    held = partial(sf.simulate, sampled=True)
    refuses(sf.ModelError, r"sampled controller, found \d+", held, dae, start, given, t)
    refuses(sf.ModelError, "'cvodes' or 'explicit', found str 'rk'", sf.SolverOptions, method="rk")
    dae = model(lambda _t, _x, u: u)
    slope = PiecewiseLinear(np.zeros(2), np.ones(2))
    idas = {"options": sf.SolverOptions(method="idas")}
    for times, push, options, words in (
        (t, 0.0, idas, "expected 'cvodes' for a sampled controller"),
        (t, slope, {}, "inputs that are linear in time"),
        ([0.0], 0.0, {}, "t: "),
        ([0.0, 0.1, 0.3], 0.0, {}, "evenly spaced times"),
        ([0.0, np.nan], 0.0, {}, "t: "),
    ):
        with pytest.raises(sf.ModelError, match=words):
            held(dae, sf.settle(dae, x=0.0), dae.inputs(push=push), np.array(times), **options)


# Newton's method: damping, step limit, and equations without a regular solution


def arctangent(z, rows):
    """Return the equations ``atan z = 0``, from which full steps diverge beyond 1.39."""
    assert len(z) == len(rows)
    return np.arctan(z), 1 / (1 + z[..., None] ** 2)


def test_damped_steps_converge_where_full_ones_diverge():
    found = solve_equations(
        arctangent, np.array([[0.5], [3.0], [-40.0]]), tolerance=1e-12, steps=40
    )
    assert_allclose(found.z, 0, atol=1e-12)
    assert_allclose(found.jacobian, 1)
    assert (found.size < 1e-12).all()


def test_steps_are_limited_in_units_of_the_scale():
    places = []

    def line(z, _):
        places.append(z[0].copy())
        return z - 1.0, np.broadcast_to(np.eye(2), (len(z), 2, 2))

    solve_equations(
        line, np.zeros((1, 2)), tolerance=1e-12, steps=9, scale=np.array([0.5, 2.0]), longest=0.2
    )
    assert_allclose(np.abs(np.diff(places, axis=0)).max(), 0.1)
    assert_allclose(places[-1], 0.9)


@pytest.mark.parametrize(
    ("equations", "size"),
    [
        (lambda z, _: (1 + z**2, 2 * z[..., None]), 1.0),  # without a root
        (lambda z, _: (z * np.nan, z[..., None] * np.nan), np.nan),
    ],
)
def test_unsolved_samples_are_told_by_their_residual(equations, size):
    found = solve_equations(equations, np.array([[0.7]]), tolerance=1e-12, steps=50)
    assert_allclose(found.size, size, rtol=1e-3)


def test_singular_systems_have_solutions_of_least_norm():
    matrices = np.array(
        [[[1.0, 1.0], [1.0, 1.0]], [[2.0, 0.0], [0.0, 1.0]], np.full((2, 2), np.nan)]
    )
    right = np.array([[2.0, 2.0], [2.0, 3.0], [1.0, 1.0]])
    expected = [[1, 1], [1, 3], [np.nan, np.nan]]
    assert_allclose(solve_linear(matrices, right), expected)
    nearly = matrices[:1] + np.diag([0.0, 1e-13])
    assert_allclose(solve_linear(nearly, right[:1], 1e-12), expected[:1], rtol=1e-9)


# The roots that other tests compute on their own


def test_roots_are_as_accurate_as_their_bounds(request):
    """Of an ill-conditioned system of whole numbers, in units of its rounding errors."""
    rows = np.round(27720 * hilbert(6))
    found, rounding = root(lambda x: rows @ x**3 - rows.sum(axis=1), np.full(6, 0.9))
    assert (np.abs(found - 1) < 2 * rounding).all()
    assert rounding.max() < 1e-8
    assert request.node.get_closest_marker("rounding")


# Solver codes are printed with their meaning

CASADI = "casadi/interfaces/sundials/idas_interface.cpp:620: IDASolve returned "


def test_codes_are_printed_with_their_meaning() -> None:
    assert all((IPOPT_STATUSES | SUNDIALS_FLAGS).values())
    for flag, meaning in (
        ("IDA_ILL_INPUT", "an input of the integrator, such as an initial value, is invalid"),
        ("CV_CONV_FAILURE", "the equations of a step could not be solved"),
        ("IDA_UNHEARD_OF", "the integrator failed"),
    ):
        message = f'Error in Function::call\n{CASADI}"{flag}". Consult IDAS documentation.'
        assert sundials_words(message) == f"{meaning} ({flag})"
    assert sundials_words("a\ncasadi/core/function.cpp:12: it is wrong\n") == "it is wrong"
    assert ipopt_words("Restoration_Failed") == (
        "the search could not return to motions that meet the constraints "
        "(IPOPT: Restoration_Failed)"
    )
    assert ipopt_words("Unheard_Of") == "the search failed (IPOPT: Unheard_Of)"


def test_flags_that_casadi_raises_have_a_meaning() -> None:
    x = ca.SX.sym("x")
    for method in ("idas", "cvodes"):
        options = {"max_num_steps": 2, "disable_internal_warnings": True}
        f = ca.integrator("f", method, {"x": x, "ode": -x}, 0.0, [9.0], options)
        error = error_of(RuntimeError, f, x0=1.0)
        words = sundials_words(str(error))
        assert words.startswith("too many steps between two samples ("), words
        assert words.endswith("_TOO_MUCH_WORK)")


# Stops of models with a continuation are distinguished from solver failures


def cubic(size):
    """x' = 1 and s^3 / 3 - s = x with z = size s: from -1 on, a fold at x = 2/3, s = -1."""
    dae = toy(1, lambda _t, _x, _z, u: [u])
    eased, s, x = ca.SX.sym("eased"), dae.z.values[0] / size, dae.x.values[0]
    rows = (size * (s**3 / 3 - s + eased * s - x),)
    return replace(dae, alg=rows, continuation=Continuation(eased, (10.0, 1.0, 0.0)))


@pytest.mark.parametrize("size", [0.005, 0.05, 1.0])
def test_a_fold_is_found_whatever_the_size_of_its_jump(size):
    dae = cubic(size)
    options = sf.SolverOptions(tolerance=1e-8)
    start = sf.settle(dae, options=options, x0=-1.0)
    run = sf.simulate(dae, start, dae.inputs(drive=1.0), np.linspace(0, 2, 41), options=options)
    assert run.stop.name == "fold"
    assert run.outcome is sf.Outcome.NO_EQUILIBRIUM
    assert run.t[-1] == pytest.approx(5 / 3, abs=1e-3)
    assert run["square"][-1] == pytest.approx(-size, rel=0.05)
    assert f"only with a jump, for example of square from {-size:.1g}"[:-1] in run.stop.words
    assert f"to {2 * size:.1g}"[:-1] in run.stop.words


# Angles modulo a turn: periodic states, goals, plans compared with simulations

GROUND = sf.Analytic(lambda x, y: 0.1 * x * y)


def _periodic(dae: sf.Dae, **limits: tuple[float, float]) -> set[str]:
    x = sf.settle(dae, heading=0.4)
    found = periodic_states(dae, dae.rows("x", x, 0), limits_of(dae, limits))
    return {label.full for label, each in zip(leaves(dae.labels.x), found, strict=True) if each}


def test_headings_and_joints_without_stop_and_spring_are_periodic() -> None:
    cart = sf.catalog.differential_drive()
    assert _periodic(sf.direct_kinematics(cart, GROUND)) == {"heading", "caster_angle"}
    assert _periodic(sf.direct_kinematics(cart, GROUND), heading=(-1.0, 1.0)) == {"caster_angle"}
    steered = sf.catalog.three_wheeler(axle="fixed")
    assert _periodic(sf.direct_kinematics(steered, GROUND)) == {"heading", "steer"}
    coordinates = tuple(
        replace(each, lower=-2.0, upper=2.0) if each.name == "caster_angle" else each
        for each in cart.coordinates
    )
    stopped = sf.direct_kinematics(replace(cart, coordinates=coordinates), GROUND)
    assert _periodic(stopped) == {"heading"}


def test_angles_are_compared_modulo_a_turn() -> None:
    periodic = np.array([True, False])
    values, near = np.array([[3.1, 7.0], [3.1, 7.0]]), np.array([[-3.1, 0.5], [-3.1, 0.5]])
    found = same_turn(values, near, periodic)
    assert_allclose(found, [[3.1 - 2 * pi, 7.0 - 2 * pi], [3.1, 7.0]])


@pytest.mark.parametrize(
    ("goal", "guess", "expected"),
    [
        (0.2 - 4 * pi, 0.0, 0.2),
        (6.0, 0.0, 6.0 - 2 * pi),
        (-3.1416, 0.0, -3.1416),  # both ways are as short: the one as written
        (0.2 + 2 * pi, 6.0, 0.2 + 2 * pi),  # the guess turns around
        (0.2, 6.0, 0.2),
        ((6.0, 7.0), 0.0, (6.0 - 2 * pi, 7.0 - 2 * pi)),
        ((5.0, 12.0), 0.0, (5.0, 12.0)),  # more than a turn
    ],
)
def test_a_goal_is_reached_the_short_way(goal: Any, guess: float, expected: Any) -> None:
    dae = sf.direct_kinematics(sf.catalog.differential_drive(), GROUND)
    given = [*timed_conditions(dae, {"x": 9.0, "heading": goal}, {0.5: {"heading": goal}})]
    periodic = np.array([label.full == "heading" for label in leaves(dae.labels.x)])
    motions = [
        lambda _: np.where(periodic, 0.0, 1.0),
        lambda part: np.where(periodic, guess * part, 1.0),
    ]
    way, end = near_conditions(dae, given, periodic, motions)
    low, high = expected if isinstance(expected, tuple) else (expected, expected)
    x, heading = end.limits
    assert (x.lower, x.upper) == (9.0, 9.0)
    assert (heading.lower, heading.upper) == pytest.approx((low, high))
    assert abs(way.limits[0].lower) <= 2 * pi or isinstance(goal, tuple)


def test_a_measured_heading_may_be_a_turn_away_from_the_plan() -> None:
    cart = sf.catalog.differential_drive()
    dae = sf.direct_kinematics(cart, GROUND)
    start = sf.settle(dae)
    guess = sf.simulate(dae, start, dae.inputs(right_rate=1.7, left_rate=1.7), np.linspace(0, 4, 9))
    found = search(
        dae, start, guess, goal={"y": 1.0, "heading": 2 * pi}, costs={"effort": 1.0},
        duration=4.0, mesh=sf.Mesh(4),
    )  # fmt: skip
    assert found.accurate
    assert found.replay["heading"][-1] == pytest.approx(0.0, abs=1e-3)
    window = horizon(found, span=2.0, intervals=2)
    measured = window.plan.states(np.array([0.1])).ravel()
    turned = measured + 2 * pi * np.array(
        [label.full == "heading" for label in leaves(dae.labels.x)]
    )
    first, second = (sf.replan(window, first_cycle(window), 0.4, x) for x in (measured, turned))
    assert_allclose(second.motion.unknowns, first.motion.unknowns, atol=1e-6)
