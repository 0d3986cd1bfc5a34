"""Tests of elements evaluated at all points at once: equal to one evaluation after the other."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from slipfree.plan.nlp_block import nlp_block
from slipfree.plan.sparse_assembly import _evaluate_by_columns, assemble


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


def test_elements_add_up_where_they_share_unknowns(rng):
    """Of a chain whose links meet, and of one that begins and ends at the same unknown."""
    v, q, p = ca.SX.sym("v", 2), ca.SX.sym("q"), ca.SX.sym("p", 2)
    where = np.array([[0, 1], [2, 1], [2, 2]])
    rows, constants = np.array([[4, 0], [1, 3], [2, 5]]), np.array([[1.0], [2.0], [-3.0]])
    cost, each = p[0] * q * v[0] ** 2 * v[1], ca.vertcat(ca.sin(v[0] * v[1]), p[1] * v[1])
    scale = np.array([1.0, 0.5, 3.0])
    made = assemble([nlp_block((v, q, p), cost, each, (), (where, rows), constants)], scale, 2)
    w, p_all = ca.MX.sym("w", 3), ca.MX.sym("p", 2)
    x = w * scale
    f = sum(p_all[0] * c * x[i] ** 2 * x[j] for (i, j), (c,) in zip(where, constants, strict=True))
    g = [None] * 6
    for (i, j), (one, other) in zip(where, rows, strict=True):
        g[one], g[other] = ca.sin(x[i] * x[j]), p_all[1] * x[j]
    g = ca.vertcat(*g)
    sigma, prices = 0.4, rng.normal(size=6)
    lagrangian = sigma * f + ca.dot(ca.DM(prices), g)
    expected = ca.Function(
        "e", [w, p_all], [f, g, ca.jacobian(g, w), ca.triu(ca.hessian(lagrangian, w)[0])]
    )
    at = rng.normal(size=3), rng.normal(size=2)
    values = ca.Function("v", [made.w, made.p], [made.f, made.g])(*at)
    found = [*values, made.jacobian(*at)[1], made.hessian(*at, sigma, prices)]
    for one, other in zip(found, expected(*at), strict=True):
        assert_allclose(np.array(ca.DM(one)), np.array(ca.DM(other)), atol=1e-14)


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
