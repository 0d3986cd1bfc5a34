"""Tests of the bicubic ground against SciPy's spline and exactly reproduced polynomials.

Errors are relative to the largest magnitude of the derivative they belong to. Rounding alone
leaves about 1e-14; 1e-10 allows for other processors. Offsets of 1e3 m in height and 4e6 m in
position cost the data 3 and 7 digits before they reach the spline: 1e-8.
"""

import math
import pickle

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import NdBSpline, RectBivariateSpline

from helpers.cases import function_of
from slipfree.terrain import bicubic
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic

ORDERS = [(k, n - k) for n in range(5) for k in range(n + 1)]


def derivatives(ground):
    """Return a Function of local x, y to all derivatives up to the fourth, in ORDERS."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")

    def make(lookups):
        known = {(0, 0): ground.height(x, y, lookups)}
        for i, j in ORDERS[1:]:
            known[i, j] = ca.jacobian(known[i - 1, j], x) if i else ca.jacobian(known[i, j - 1], y)
        return [known[order] for order in ORDERS]

    return function_of([x, y], make)


def evaluate(ground, x, y):
    """Return all derivatives at map points as a dict from order to an array."""
    x_0, y_0, z_0 = ground.origin
    function = derivatives(ground).map(x.size)
    found = function((x.ravel() - x_0)[None], (y.ravel() - y_0)[None])
    result = {o: np.asarray(row).ravel() for o, row in zip(ORDERS, found, strict=True)}
    result[0, 0] = result[0, 0] + z_0
    return result


def scipy_spline(grid):
    # RectBivariateSpline itself evaluates no third derivatives.
    t_x, t_y, c = RectBivariateSpline(grid.x, grid.y, grid.z, s=0).tck
    return NdBSpline((t_x, t_y), c.reshape(grid.z.shape), 3)


def rough(n_x=40, n_y=25):
    rng = np.random.default_rng(0)
    return Grid(np.linspace(-3, 5, n_x), np.linspace(1, 4, n_y), rng.standard_normal((n_x, n_y)))


def polynomial(weights, x, y, order=(0, 0)):
    c = np.polynomial.polynomial.polyder(weights, order[0], axis=0)
    c = np.polynomial.polynomial.polyder(c, order[1], axis=1)
    return np.polynomial.polynomial.polyval2d(*np.broadcast_arrays(x, y), c)


def places(grid):
    rng = np.random.default_rng(1)
    x_ends, y_ends = grid.x[[0, -1]], grid.y[[0, -1]]
    x, y = rng.uniform(*x_ends, 2000), rng.uniform(*y_ends, 2000)
    return {
        "anywhere": (rng.uniform(*x_ends, 10_000), rng.uniform(*y_ends, 10_000)),
        "knots": tuple(a.ravel() for a in np.meshgrid(grid.x, grid.y, indexing="ij")),
        "knot lines": (grid.x[rng.integers(0, grid.x.size, 2000)], y),
        "first x": (np.full(2000, x_ends[0]), y),
        "last x": (np.full(2000, x_ends[1]), y),
        "first y": (x, np.full(2000, y_ends[0])),
        "last y": (x, np.full(2000, y_ends[1])),
    }


def test_derivatives_equal_scipy():
    grid = rough()
    spline = scipy_spline(grid)
    everywhere = np.stack(places(grid)["anywhere"], axis=-1)
    sizes = {o: np.abs(spline(everywhere, nu=o)).max() for o in ORDERS if max(o) <= 3}
    for place, (x, y) in places(grid).items():
        for order, found in evaluate(Bicubic(grid), x, y).items():
            if max(order) == 4:
                assert_allclose(found, 0)
                continue
            expected = spline(np.stack([x, y], axis=-1), nu=order)
            words = f"{place}, {order}"
            assert_allclose(found, expected, rtol=0, atol=1e-10 * sizes[order], err_msg=words)


def test_offsets_cost_no_accuracy():
    grid, offset = rough(), (5e5, 4.1e6, 1e3)
    spline = scipy_spline(grid)
    far = Bicubic(
        Grid(*(axis + by for axis, by in zip((grid.x, grid.y, grid.z), offset, strict=True)))
    )
    x, y = places(grid)["anywhere"]
    centre = np.array(far.origin) - offset
    found = derivatives(far).map(x.size)((x - centre[0])[None], (y - centre[1])[None])
    for order, row in zip(ORDERS, found, strict=True):
        if sum(order) <= 3:
            expected = spline(np.stack([x, y], axis=-1), nu=order) - centre[2] * (order == (0, 0))
            atol = 1e-8 * np.abs(expected).max()
            assert_allclose(np.asarray(row).ravel(), expected, rtol=0, atol=atol)


@pytest.mark.parametrize("shape", [(4, 4), (12, 10)])
def test_bicubics_are_reproduced_with_fourth_derivatives(shape):
    weights = np.random.default_rng(2).standard_normal((4, 4))
    x, y = np.linspace(-1, 1, shape[0]), np.linspace(0, 1.5, shape[1])
    ground = Bicubic(Grid(x, y, polynomial(weights, x[:, None], y[None, :])))
    # Half a unit outside too: there the polynomials of the border cells continue.
    p, q = np.random.default_rng(3).uniform(-0.5, 0.5, (2, 500)) * [[3], [2.5]] + [[0], [0.75]]
    found = evaluate(ground, p, q)
    for order in ORDERS:
        expected = polynomial(weights, p, q, order)
        # Rounding in the heights grows with the fourth power of the nodes per unit.
        tolerance = 1e-8 * max(1, np.abs(expected).max())
        assert_allclose(found[order], expected, rtol=0, atol=tolerance, err_msg=str(order))
    assert not found[4, 0].any()
    assert not found[0, 4].any()


def test_fourth_derivatives_on_knots_are_finite_every_time():
    grid = rough()
    first, *others = (evaluate(Bicubic(grid), *places(grid)["knots"]) for _ in range(4))
    for order in ORDERS:
        assert np.isfinite(first[order]).all()
        for again in others:
            np.testing.assert_array_equal(again[order], first[order])


def test_rounding_beside_a_knot_does_not_change_the_cell():
    ground = Bicubic(rough())
    x, y = np.full(1, ground.grid.x[7]), np.full(1, 2.03)
    on, below = evaluate(ground, x, y), evaluate(ground, np.nextafter(x, -9), y)
    further = evaluate(ground, x - 1e-6, y)
    assert_allclose(below[3, 0], on[3, 0], rtol=1e-9)
    assert abs(further[3, 0] - on[3, 0]) > 0.01 * abs(on[3, 0])


def test_forward_and_reverse_agree_and_never_enter_the_look_up():
    """In SX, and of a function that looks up, whose derivatives CasADi's MX makes."""
    ground = Bicubic(rough())
    q, v = ca.SX.sym("q", 2), ca.SX.sym("v", 2)

    def make(lookups):
        h = ground.height(q[0], q[1], lookups)
        gradient, forward = ca.gradient(h, q), ca.jtimes(h, q, v)
        curved = ca.jtimes(ca.jtimes(gradient, q, v), q, v)
        return h, gradient, forward, ca.hessian(h, q)[0], curved

    function = function_of([q, v], make)
    at, way = [0.3, -0.2], [0.7, -1.1]
    h, slope, along, hessian, _ = function(at, way)
    assert_allclose(float(along), float(ca.dot(slope, ca.DM(way))), rtol=1e-13)
    symbol = ca.MX.sym("q", 2)
    again = ca.hessian(function(symbol, way)[0], symbol)
    found = ca.Function(
        "again", [symbol], [*again, ca.jtimes(function(symbol, way)[0], symbol, ca.DM(way))]
    )(at)
    for one, other in zip(found, (hessian, slope, along), strict=True):
        assert_allclose(np.array(ca.DM(one)), np.array(ca.DM(other)), rtol=1e-12)
    assert float(h) != 0


def test_elevation_equals_height():
    ground = Bicubic(rough())
    x, y = np.random.default_rng(4).uniform([[-4], [0]], [[6], [5]], (2, 20_000))
    expected = evaluate(ground, x, y)[0, 0]
    size = np.abs(expected).max()
    found = ground.elevation(x.reshape(100, 200), y.reshape(100, 200))
    assert found.shape == (100, 200)
    assert_allclose(found.ravel(), expected, rtol=0, atol=1e-13 * size)
    assert_allclose(ground.elevation(ground.grid.x[:, None], ground.grid.y), ground.grid.z)
    unknown = ground.elevation(np.array([np.nan, 0.0]), np.array([2.0, 2.0]))
    assert np.isnan(unknown).tolist() == [True, False]


def test_a_nan_or_endless_point_gives_nan_not_a_crash():
    function = derivatives(Bicubic(rough()))
    for bad in (math.nan, math.inf, -math.inf):
        assert not np.isfinite(float(function(bad, 0.1)[0]))
    assert np.isfinite(float(function(1e6, 0.1)[0]))


def test_pickle_gives_the_same_numbers():
    ground = Bicubic(rough())
    data = pickle.dumps(ground)
    assert len(data) < 2 * ground.grid.z.nbytes
    function = derivatives(ground)
    for copy in (derivatives(pickle.loads(data)), pickle.loads(pickle.dumps(function))):
        for one, other in zip(function(0.1, 0.2), copy(0.1, 0.2), strict=True):
            assert float(one) == float(other)


def test_both_layouts_of_the_look_up_are_exact(monkeypatch):
    table = np.random.default_rng(6).uniform(-1, 1, (9, 12))
    for largest in (0, table.size):
        monkeypatch.setattr(bicubic, "MAX_FOURFOLD_SIZE", largest)
        look_up = bicubic._gather_function(table)
        for i in range(6):
            for j in range(9):
                expected = table[i : i + 4, j : j + 4].ravel(order="F")
                np.testing.assert_array_equal(np.asarray(look_up([i, j])).ravel(), expected)


def test_size_changes_nothing():
    weights, x = np.random.default_rng(7).standard_normal((4, 4)), np.linspace(0, 1, 2000)
    ground = Bicubic(Grid(x, x, polynomial(weights, x[:, None], x[None, :])))
    p, q = np.random.default_rng(8).uniform(0, 1, (2, 1000))
    expected = polynomial(weights, p, q)
    assert_allclose(ground.elevation(p, q), expected, rtol=0, atol=1e-13)
    u, v = ca.SX.sym("u"), ca.SX.sym("v")
    height = function_of([u, v], lambda lookups: [ground.height(u, v, lookups)]).map(p.size)
    found = np.asarray(height((p - 0.5)[None], (q - 0.5)[None])).ravel() + ground.origin[2]
    assert_allclose(found, expected, rtol=0, atol=1e-13)
