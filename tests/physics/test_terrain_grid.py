"""Tests of the validated grid, and of grounds given by a formula."""

from __future__ import annotations

import math
import pickle

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import RectBivariateSpline

from helpers.cases import function_of
from slipfree.core.errors import DataError, ModelError, SlipfreeError
from slipfree.terrain.analytic import Analytic
from slipfree.terrain.base import Grid

X, Y = np.arange(5.0), 10 + 0.5 * np.arange(7)
Z = np.add.outer(X, Y)


def hills(x, y):
    return 0.3 * ca.sin(x) * ca.cos(2 * y)


def with_value(array, index, value):
    changed = array.copy()
    changed[index] = value
    return changed


def test_spacing_of_an_axis_far_from_zero():
    assert Grid(X, Y, Z).spacing == (1.0, 0.5)
    x = 4.1e6 + 0.1 * np.arange(1000)
    assert_allclose(Grid(x, Y, np.zeros((1000, 7))).spacing[0], 0.1, rtol=1e-10)


def test_arrays_are_kept_but_read_only():
    grid = Grid(X, Y, Z)
    assert np.shares_memory(grid.z, Z)
    assert Z.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        grid.z[0, 0] = 1.0
    assert Grid(list(X), Y, Z.astype(np.int16)).z.dtype == np.float64


@pytest.mark.parametrize(
    ("x", "y", "z", "words"),
    [
        (X, Y, np.ma.masked_less(Z, 11), r"found a masked array; .*\.filled"),
        (np.meshgrid(X, Y)[0], Y, Z, r"axis x must have one dimension.*\(7, 5\).*meshgrid"),
        (X[:3], Y, Z[:3], "axis x must have at least 4 nodes .* found 3"),
        (X, with_value(Y, 2, np.nan), Z, r"axis y must be finite, found y\[2\] = nan"),
        (X[::-1], Y, Z, r"axis x .* from 4 to 0; flip .* x\[::-1\] and z\[::-1, :\]"),
        (X, Y[::-1], Z, r"axis y must increase.* flip .* y\[::-1\] and z\[:, ::-1\]"),
        (X, with_value(Y, 3, 10.0), Z, r"found y\[2\] = 11 followed by y\[3\] = 10; sort axis"),
        (X, Y, Z.T, r"shape \(x.size, y.size\) = \(5, 7\), found \(7, 5\).* pass z\.T"),
        (X, Y, Z[:, :4], r"= \(5, 7\), found \(5, 4\); reshape z"),
        (
            X,
            Y,
            with_value(Z, (slice(2, 4), 3), np.nan),
            r"found 2 of 35 that are not, the first z\[2, 3\] = nan at x = 2 m, y = 11\.5 m; fill",
        ),
    ],
)
def test_grid_refuses(x, y, z, words):
    with pytest.raises(SlipfreeError, match=words):
        Grid(x, y, z)


def test_non_uniform_axis_is_named_with_its_remedy():
    x = np.concatenate([np.arange(0, 8.0), np.arange(9.0, 14.0)])
    words = r"before node 8 at x = 9 m, where the median step is 1 m; resample: (x_even = .*)"
    with pytest.raises(DataError, match=words) as caught:
        Grid(x, Y, np.add.outer(x, Y))
    # The remedy in the message is a statement that works.
    remedy = str(caught.value).split("resample: ")[1].replace("scipy.interpolate.", "")
    names = {"np": np, "x": x, "y": Y, "z": np.add.outer(x, Y)}
    exec(remedy, {"RectBivariateSpline": RectBivariateSpline}, names)
    assert_allclose(Grid(names["x_even"], Y, names["z"]).z, np.add.outer(names["x_even"], Y))
    drifting = np.linspace(0, 1, 2000)
    drifting += 1e-8 * np.sin(np.pi * drifting)
    with pytest.raises(DataError, match="axis y must be uniform to 1e-09"):
        Grid(X, drifting, np.zeros((5, 2000)))


def test_analytic_height_and_elevation_agree():
    ground = Analytic(hills)
    x, y = np.random.default_rng(0).uniform(-3, 3, (2, 4, 5))
    assert_allclose(ground.elevation(x, y), 0.3 * np.sin(x) * np.cos(2 * y), atol=1e-15)
    assert ground.origin == (0, 0, 0)
    assert ground.domain == (-math.inf, math.inf, -math.inf, math.inf)
    u, v = ca.SX.sym("u"), ca.SX.sym("v")
    slope = function_of([u, v], lambda lookups: [ca.jacobian(ground.height(u, v, lookups), u)])
    assert_allclose(float(slope(0.4, 0.7)), 0.3 * math.cos(0.4) * math.cos(1.4), rtol=1e-14)
    assert_allclose(Analytic(lambda _x, _y: 2.0).elevation(x, y), np.full(x.shape, 2.0))
    bounded = Analytic(hills, (-1, 1, -2, 2))
    copy = pickle.loads(pickle.dumps(bounded))
    assert copy.domain == bounded.domain
    np.testing.assert_array_equal(copy.elevation(x, y), ground.elevation(x, y))


@pytest.mark.parametrize(
    ("function", "domain", "words"),
    [
        (hills, (1, -1, 0, 1), "with x_min < x_max"),
        (lambda x, y: max(x, y), (0, 1, 0, 1), r"RuntimeError: .*use casadi.fmax"),
        (lambda x, _y: math.sin(x), (0, 1, 0, 1), r"result is nan.*casadi.sin"),
        (lambda _x, _y: None, (0, 1, 0, 1), r"cannot be evaluated with symbols \(NotImpl"),
        (lambda x, y: ca.vertcat(x, y), (0, 1, 0, 1), r"one height, found shape \(2, 1\)"),
        (lambda x, _y: x + ca.SX.sym("mu"), (0, 1, 0, 1), r"only on x and y, found .*mu"),
    ],
)
def test_analytic_refuses(function, domain, words):
    with pytest.raises(ModelError, match=words):
        Analytic(function, domain)
