"""Tests that stops of models with a continuation are distinguished from solver failures."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from helpers.toy_models import toy
from slipfree.core.dae import Continuation
from slipfree.core.outcome import Outcome
from slipfree.solve.options import SolverOptions
from slipfree.solve.settle import settle
from slipfree.solve.simulate import simulate


def cubic(size):
    """x' = 1 and s^3 / 3 - s = x with z = size s: from -1 on, a fold at x = 2/3, s = -1."""
    dae = toy(1, lambda _t, _x, _z, u: [u])
    eased, s, x = ca.SX.sym("eased"), dae.z.values[0] / size, dae.x.values[0]
    rows = (size * (s**3 / 3 - s + eased * s - x),)
    return replace(dae, alg=rows, continuation=Continuation(eased, (10.0, 1.0, 0.0)))


@pytest.mark.parametrize("size", [0.005, 0.05, 1.0])
def test_a_fold_is_found_whatever_the_size_of_its_jump(size):
    dae = cubic(size)
    options = SolverOptions(tolerance=1e-8)
    start = settle(dae, options=options, x0=-1.0)
    run = simulate(dae, start, dae.inputs(drive=1.0), np.linspace(0, 2, 41), options=options)
    assert run.stop.name == "fold"
    assert run.outcome is Outcome.NO_EQUILIBRIUM
    assert run.t[-1] == pytest.approx(5 / 3, abs=1e-3)
    assert run["square"][-1] == pytest.approx(-size, rel=0.05)
    assert f"only with a jump, for example of square from {-size:.1g}"[:-1] in run.stop.words
    assert f"to {2 * size:.1g}"[:-1] in run.stop.words
