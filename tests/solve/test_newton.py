"""Tests of Newton's method: damping, step limit, and equations without a regular solution."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from slipfree.core.newton import solve_equations, solve_linear


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
