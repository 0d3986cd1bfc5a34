"""Tests of models without algebraic unknowns: CVODES, and sampled controllers."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.toy_models import model
from slipfree import Analytic, SolverOptions, direct_kinematics
from slipfree.catalog import three_wheeler
from slipfree.core.dae import PiecewiseLinear
from slipfree.core.errors import ModelError
from slipfree.core.trajectory import SolverError
from slipfree.solve.integrator import STALLED_STEPS, StepObserver
from slipfree.solve.settle import settle
from slipfree.solve.simulate import simulate
from slipfree.solve.zero_order_hold import simulate_sampled
from slipfree.system.interrupt import InterruptGuard


def test_a_stiff_equation_has_its_solution():
    """``x' = -1e4 (x - cos t)``, which explicit methods take 1e4 steps for."""
    k, t = 1e4, np.linspace(0, 3, 31)
    dae = model(lambda t, x, u: -k * (x - ca.cos(t)) + u)
    start = settle(dae, x=0.0)
    exact = (k**2 * (np.cos(t) - np.exp(-k * t)) + k * np.sin(t)) / (k**2 + 1)
    for tolerance in (1e-6, 1e-8):
        run = simulate(
            dae, start, dae.inputs(push=0.0), t, options=SolverOptions(tolerance=tolerance)
        )
        assert run.stop is None
        assert_allclose(run["x"], exact, atol=10 * tolerance)
        assert_allclose(run["twice"], 2 * run["x"])
        steps = run.statistics["steps"]
        assert_allclose(run["sum"], np.sin(t) - exact / k, atol=steps * tolerance)
        assert steps < 500
    other = simulate(
        dae, start, dae.inputs(push=0.0), t, options=SolverOptions(tolerance=1e-8, method="idas")
    )
    assert_allclose(other["x"], exact, atol=1e-6)


def test_newtons_method_ends_within_the_tolerance():
    """A block under a growing push, ``v' = u sin t - mu g v / sqrt(v^2 + eps^2)``.

    Its friction changes slope while CVODES keeps its Jacobian. CVODES's default criterion for
    Newton's method gives errors of up to 3.6 tolerances here.
    """
    mu_g, eps, t = 0.8 * 9.81, 1e-3, np.linspace(0, 1.5, 16)
    dae = model(lambda t, v, u: u * ca.sin(t) - mu_g * v / ca.sqrt(v**2 + eps**2))
    start, inputs = settle(dae, x=0.0), dae.inputs(push=0.7 * 9.81)
    exact = simulate(dae, start, inputs, t, options=SolverOptions(tolerance=1e-12))
    for tolerance in np.geomspace(1e-4, 1e-9, 11):
        run = simulate(dae, start, inputs, t, options=SolverOptions(tolerance=tolerance))
        assert_allclose(run["x"], exact["x"], atol=tolerance)


def test_steps_that_do_not_advance_end_the_call():
    observer = StepObserver(InterruptGuard())
    for t in [*np.linspace(0, 1e-9, 500), *np.full(1 + STALLED_STEPS, 3.0)]:
        observer(t, 1.0, 1.0)
    with pytest.raises(SolverError, match="shorter than the rounding"):
        observer(3.0, 1.0, 1.0)


def test_a_limit_ends_the_motion_at_its_crossing():
    dae = model(lambda _t, x, u: x + u, limits=[(-np.inf, 2.0)])
    run = simulate(dae, settle(dae, x=1.0), dae.inputs(push=0.0), np.linspace(0, 3, 7))
    assert run.stop.name == "bound"
    assert_allclose(run.stop.t, np.log(2), atol=1e-5)
    assert run["x"][-1] <= 2 + 1e-5
    dae = model(lambda _t, _x, u: u, limits=[(-np.inf, 0.55)])
    run = simulate_sampled(dae, settle(dae, x=0.0), dae.inputs(push=1.0), np.arange(11) * 0.1)
    assert run.stop.name == "bound"
    assert_allclose(run.t[-1], 0.6)
    assert "x is out of bounds: 0.6, allowed at most 0.55 m" in run.stop.words


@pytest.mark.slow
def test_a_motion_that_goes_to_infinity_is_told_of():
    dae, t = model(lambda _t, x, u: x**2 + u), np.linspace(0, 2, 21)
    with pytest.raises(SolverError, match=r"stopped at t = (0\.99|1)") as caught:
        simulate(dae, settle(dae, x=1.0), dae.inputs(push=0.0), t)
    assert "steps have become shorter" in str(caught.value)
    assert caught.value.trajectory["x"][-1] > 50
    with pytest.raises(SolverError, match=r"stopped at t = 0\.9"):
        simulate_sampled(dae, settle(dae, x=1.0), dae.inputs(push=0.0), t)


def test_jumps_of_an_input():
    dae, t = model(lambda _t, x, u: u - x), np.linspace(0, 2, 3)
    run = simulate(dae, settle(dae, x=0.0), dae.inputs(push=np.array([1.0, -1.0])), t)
    assert_allclose(run["x"], [0, 1 - np.exp(-1), (2 - np.exp(-1)) * np.exp(-1) - 1], atol=1e-7)


# Sampled


def test_a_held_law_has_its_difference_equation():
    """``x' = u``, u held at ``-k x``: x is multiplied by ``1 - k T``."""
    dae, period, k = model(lambda _t, _x, u: u), 0.1, 7.0
    t = np.arange(21) * period
    run = simulate_sampled(dae, settle(dae, x=1.0), dae.inputs(push=-k * dae.x[0]), t)
    exact = (1 - k * period) ** np.arange(21)
    assert_allclose(run["x"], exact, atol=1e-10)
    assert_allclose(run["push"], -k * exact, atol=1e-9)
    steps = period * (exact[1:] + exact[:-1]) / 2
    assert_allclose(run["sum"], np.append(0, np.cumsum(steps)), atol=20e-8)


def test_a_held_law_knows_the_time():
    dae = model(lambda t, _x, u: u + t)
    t = 1.0 + np.arange(11) * 0.1
    run = simulate_sampled(dae, settle(dae, x=0.0), dae.inputs(push=-dae.t), t)
    assert_allclose(run["x"], 0.1**2 / 2 * np.arange(11), atol=10e-8)
    numbers = np.arange(10.0)
    run = simulate_sampled(dae, settle(dae, x=0.0), dae.inputs(push=numbers), t)
    own = simulate(dae, settle(dae, x=0.0), dae.inputs(push=numbers), t)
    assert_allclose(run["x"], own["x"], atol=1e-7)


def test_what_a_method_cannot_do_is_refused():
    dae, t = direct_kinematics(three_wheeler(), Analytic(lambda x, _y: 0 * x)), np.arange(3) * 0.1
    start, given = settle(dae), dae.inputs(right_rate=0.5, left_rate=0.5, steer_rate=0.0)
    with pytest.raises(ModelError, match=r"'cvodes' cannot solve for the \d+ algebraic unknowns"):
        simulate(dae, start, given, t, options=SolverOptions(method="cvodes"))
    with pytest.raises(ModelError, match=r"sampled controller, found \d+"):
        simulate_sampled(dae, start, given, t)
    with pytest.raises(ModelError, match="'cvodes' or 'explicit', found str 'rk'"):
        SolverOptions(method="rk")
    dae = model(lambda _t, _x, u: u)
    slope, idas = (
        PiecewiseLinear(np.zeros(2), np.ones(2)),
        {"options": SolverOptions(method="idas")},
    )
    for times, push, options, words in (
        (t, 0.0, idas, "expected 'cvodes' for a sampled controller"),
        (t, slope, {}, "inputs that are linear in time"),
        ([0.0], 0.0, {}, "t: "),
        ([0.0, 0.1, 0.3], 0.0, {}, "t: "),
        ([0.0, np.nan], 0.0, {}, "t: "),
    ):
        with pytest.raises(ModelError, match=words):
            simulate_sampled(
                dae, settle(dae, x=0.0), dae.inputs(push=push), np.array(times), **options
            )
