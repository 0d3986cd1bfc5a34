"""Tests of elements evaluated at all points at once: equal to one evaluation after the other."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from slipfree.plan.sparse_assembly import _evaluate_by_columns, assemble, nlp_block


def branches(a, b):
    return ca.if_else(a > b, ca.fmin(a, 0.3) * ca.sin(b), ca.floor(3 * a) / (1 + b**2) + 2)


@pytest.mark.parametrize("count", [1, 50])
def test_columns_are_what_one_number_after_the_other_gives(count, rng):
    v, q = ca.SX.sym("v", 2), ca.SX.sym("q")
    value = branches(v[0], v[1]) * q
    results = [value, ca.jacobian(value, v), ca.triu(ca.hessian(value, v)[0]), ca.SX(4.0)]
    f = ca.Function("f", [v, q], results)
    columns = [ca.MX.sym(name, count) for name in "ab"]
    q_all = ca.MX.sym("q")
    found = _evaluate_by_columns(f, [columns, [q_all]])
    full = [
        ca.horzcat(*(e if e.numel() == count else ca.repmat(e, count) for e in each))
        for each in found
    ]
    at, factor = rng.uniform(-2.0, 2.0, (count, 2)), 1.7
    together = ca.Function("all", [*columns, q_all], full)(at[:, 0], at[:, 1], factor)
    for k in range(count):
        for one, every in zip(f(at[k], factor), together, strict=True):
            assert_array_equal(np.array(every[k, :]).ravel(), np.array(one.nonzeros()))


def test_rows_with_the_same_index_are_summed(rng):
    """Sum of q v^3 over three points, as one row, beside a row of each point."""
    v, q, p = ca.SX.sym("v"), ca.SX.sym("q"), ca.SX.sym("p", 0)
    rows = ca.vertcat(ca.sin(v), q * v**3)
    indices = np.arange(3)[:, None], np.array([[0, 3], [1, 3], [2, 3]])
    constants = np.array([1.0, -2.0, 0.5])
    made = assemble(
        [nlp_block((v, q, p), v**2, rows, (), indices, constants[:, None])], np.ones(3), 0
    )
    w, prices = rng.normal(size=3), rng.normal(size=4)
    g = np.append(np.sin(w), constants @ w**3)
    slopes = np.vstack([np.diag(np.cos(w)), 3 * constants * w**2])
    curvature = np.diag(2 - prices[:3] * np.sin(w) + 6 * prices[3] * constants * w)
    values = ca.Function("v", [made.w, made.p], [made.g])(w, [])
    assert_allclose(np.array(values).ravel(), g, atol=1e-14)
    found, jacobian = made.jacobian(w, [])
    assert_allclose(np.array(found).ravel(), g, atol=1e-14)
    assert_allclose(np.array(ca.DM(jacobian)), slopes, atol=1e-14)
    assert_allclose(np.array(ca.DM(made.hessian(w, [], 1.0, prices))), curvature, atol=1e-14)
