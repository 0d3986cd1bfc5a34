"""Tests of rearranged models: labels, guesses, numbers and checks."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from helpers.cases import hills
from slipfree import Analytic, Bicubic, Grid, direct_kinematics, settle
from slipfree.catalog import three_wheeler
from slipfree.core.rearrange import blocks, rearrange, substitute, variables, with_outputs
from slipfree.core.records import Label

AXIS = np.linspace(-4, 4, 41)
GROUNDS = {
    "formula": Analytic(hills),
    "map": Bicubic(
        Grid(AXIS + 100, AXIS, 0.1 * np.sin(AXIS)[:, None] * np.cos(AXIS)), (100.0, 0.0)
    ),
}


@pytest.fixture(params=GROUNDS)
def direct(request):
    return direct_kinematics(three_wheeler(), GROUNDS[request.param])


def evaluated(dae, start):
    """Guess and residuals at a start."""
    symbols = [*dae.columns()]
    function = dae.function("all", symbols, [dae.guess, ca.vertcat(*dae.alg)])
    x, z = dae.rows("x", start, 0), dae.rows("z", start, 0)
    return [np.array(part) for part in function(x, z, np.full(symbols[2].shape, 0.3))]


def test_the_same_places_give_the_same_model(direct):
    same = rearrange(direct, *variables(direct), blocks(direct))
    assert same.labels == direct.labels
    assert_array_equal(same.scale, direct.scale)
    for record in (0, 1):
        assert_array_equal(same.shift[record], direct.shift[record])
    start = settle(direct, x=float(direct.shift[0][0]), heading=0.2)
    for one, other in zip(evaluated(same, start), evaluated(direct, start), strict=True):
        assert_array_equal(one, other)
    x, z = direct.rows("x", start, 0), direct.rows("z", start, 0)
    for one, other in zip(same.checks, direct.checks, strict=True):
        assert one.label == other.label
        assert_array_equal(one.margin(x[:, None], z[:, None]), other.margin(x[:, None], z[:, None]))


def test_a_state_among_the_unknowns_is_zero_in_the_guess_and_keeps_its_shift(direct):
    x, z, u = variables(direct)
    z = z._replace(position=z.position._replace(z=x.x))
    moved = rearrange(direct, x._replace(x=variables(direct)[1].position.z), z, u, blocks(direct))
    assert moved.labels.x.x.name == "z"
    assert_allclose(moved.shift[0][0], direct.shift[1][0])
    assert_allclose(moved.shift[1][0], direct.shift[0][0])
    at = np.array([7.0, 0.5, 0.1, 0.0, 0.0, 0.0])  # z, y, heading, joints
    former = np.array([0.0, 0.5, 0.1, 0.0, 0.0, 0.0])
    guess = moved.function("guess", [moved.columns()[0]], [moved.guess])(at)
    other = direct.function("guess", [direct.columns()[0]], [direct.guess])(former)
    assert_allclose(np.array(guess)[0], 0.0)
    assert_array_equal(np.array(guess)[1:], np.array(other)[1:])
    assert moved.ode[0].is_zero()


def test_values_take_the_place_of_inputs_and_outputs_are_added(direct):
    half = substitute(direct, direct.u.wheels, [ca.SX(0.5), 2 * direct.t])
    assert not ca.depends_on(ca.vertcat(*half.alg, half.quad), ca.vertcat(*direct.u.wheels))
    named = with_outputs(half, [(Label("twice", "s", "twice the time"), 2 * direct.t)])
    assert ca.is_equal(named.named("twice")[0], 2 * direct.t, 3)
