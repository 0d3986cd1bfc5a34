"""Tests of grids: validated, synthetic and rolled ones, and grounds given by a formula."""

import math
import pickle
from itertools import pairwise
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import RectBivariateSpline

from helpers.cases import function_of
from helpers.commands import refuses
from slipfree.catalog import rigid_skid_steer
from slipfree.core.errors import DataError, ModelError, SlipfreeError
from slipfree.geometry.regions import Region
from slipfree.laws import soil
from slipfree.models.kinematics import press
from slipfree.plan import problem
from slipfree.terrain.analytic import Analytic
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.rolled import _close_by_ball, rolled
from slipfree.terrain.synthetic import (
    Rock,
    _scatter,
    blank,
    craters,
    place_rocks,
    power_law,
    ramp,
    rocks,
)

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
    refuses(SlipfreeError, words, Grid, x, y, z)


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
    refuses(DataError, "axis y must be uniform to 1e-09", Grid, X, drifting, np.zeros((5, 2000)))


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
    refuses(ModelError, words, Analytic, function, domain)


# Rolled ground, on which hollows narrower than a wheel are filled

RADIUS = 0.3


def rough_ground(spacing=0.05):
    ground = power_law(
        blank((0, 6), (0, 5), spacing), rms=0.06, hurst=0.6, longest=3, shortest=2 * spacing, seed=1
    )
    return place_rocks(ground, [(2.0, 2.0, 0.5, 0.2), (4.0, 3.0, 0.3, 0.15)])


def brute_closing(z, step, radius):
    """Lower envelope of all positions of the ball above the ground, node by node."""
    i, j = np.indices(z.shape)
    centre = np.full(z.shape, -np.inf)
    for p, q in np.ndindex(z.shape):
        s = radius**2 - step**2 * ((i - p) ** 2 + (j - q) ** 2)
        near = s >= 0
        centre[near] = np.maximum(centre[near], z[p, q] + np.sqrt(s[near]))
    closed = np.full(z.shape, np.inf)
    for p, q in np.ndindex(z.shape):
        s = radius**2 - step**2 * ((i - p) ** 2 + (j - q) ** 2)
        near = s >= 0
        closed[near] = np.minimum(closed[near], centre[p, q] - np.sqrt(s[near]))
    return closed


def test_closing_is_what_the_ball_leaves_free():
    z = 0.1 * np.random.default_rng(0).standard_normal((30, 26))
    closed = _close_by_ball(z, (0.1, 0.1), 0.35)
    inner = (slice(7, -7), slice(7, -7))  # the border is continued, the ball's reach is 2 x 3 nodes
    assert_allclose(closed[inner], brute_closing(z, 0.1, 0.35)[inner], atol=1e-14)


def test_closing_only_raises_and_repeats_nothing():
    z = rough_ground().z
    once = _close_by_ball(z, (0.05, 0.05), 0.45)
    assert (once >= z - 1e-12).all()
    assert (once > z + 1e-3).any()
    twice = _close_by_ball(once, (0.05, 0.05), 0.45)
    inner = (slice(20, -20), slice(20, -20))
    assert_allclose(twice[inner], once[inner], atol=1e-12)


def test_a_plane_is_unchanged_up_to_its_edges():
    flat = blank((0, 4), (-1, 2), 0.1)
    plane = Grid(flat.x, flat.y, 5 + 0.4 * flat.x[:, None] - 0.3 * flat.y)
    result = rolled(plane, RADIUS)
    assert result.largest < 1e-12
    assert_allclose(result.grid.z, Bicubic(plane).elevation(result.grid.x[:, None], result.grid.y))


def test_nodes_and_ends():
    result = rolled(rough_ground(), RADIUS)
    assert max(result.grid.spacing) <= RADIUS / 8
    assert_allclose(result.grid.x[[0, -1]], [0, 6])
    assert_allclose(result.grid.y[[0, -1]], [0, 5])
    old = Bicubic(rough_ground()).elevation(result.grid.x[:, None], result.grid.y)
    assert_allclose(result.grid.z - result.change.z, old, atol=1e-14)
    assert_allclose(result.largest, np.abs(result.change.z).max())
    assert_allclose(result.rms, np.sqrt(np.mean(result.change.z**2)))


def test_smooth_ground_hardly_changes():
    step = 0.05
    flat = blank((0, 8), (0, 8), step)
    # Valleys of radius 1/(0.2 * 1.2**2) = 3.5 m: the wheel reaches every point.
    hills = Grid(flat.x, flat.y, 0.2 * np.sin(1.2 * flat.x)[:, None] * np.cos(1.2 * flat.y))
    result = rolled(hills, RADIUS)
    # A Gaussian lowers a wave by (k sigma)**2 / 2 in each direction: 0.2 * (1.2 * 0.075)**2.
    assert result.largest < 1.1 * 0.2 * (1.2 * 0.075) ** 2
    # A ball of nodes misses the point it would touch by up to half a diagonal.
    closed = _close_by_ball(hills.z, (step, step), 0.45)
    assert_allclose(closed, hills.z, atol=step**2 / (4 * 0.45))


def test_a_wheel_touches_once():
    rng = np.random.default_rng(3)

    def double_contacts(grid):
        ground, found = Bicubic(grid), 0
        s = np.linspace(-0.999 * RADIUS, 0.999 * RADIUS, 801)
        for x, y, heading in rng.uniform([0.5, 0.5, 0], [5.5, 4.5, 7], (500, 3)):
            # A disc set down from above rests where this is largest.
            rests = ground.elevation(x + s * np.cos(heading), y + s * np.sin(heading))
            rests = rests + np.sqrt(RADIUS**2 - s**2)
            found += np.count_nonzero((rests[1:-1] > rests[:-2]) & (rests[1:-1] > rests[2:])) > 1
        return found

    ground = rough_ground()
    assert double_contacts(ground) > 50
    assert double_contacts(rolled(ground, RADIUS).grid) == 0


def test_a_radius_that_is_not_positive_or_larger_than_the_ground_is_refused():
    with pytest.raises(ModelError, match="rolled: radius: expected a number, found float nan"):
        rolled(blank((0, 1), (0, 1), 0.1), np.nan)
    with pytest.raises(ModelError, match=r"radius must be at most 0\.6667"):
        rolled(blank((0.0, 2.0), (0.0, 4.0), 0.1), 1e9)


# Synthetic grounds: seeds, stated sizes, independence of the spacing

ROUGH = {"rms": 0.05, "hurst": 0.8, "longest": 8.0, "shortest": 0.4, "seed": 3}
CRATERS = {"count": 20, "diameters": (0.5, 3.0), "seed": 4}
ROCKS = {"count": 30, "diameters": (0.1, 0.6), "height_ratio": 0.5, "seed": 5}


def test_blank():
    grid = blank((-1, 1), (0, 0.3), 0.1)
    assert_allclose(grid.x, np.linspace(-1, 1, 21))
    assert grid.z.shape == (21, 4)
    assert not grid.z.any()
    for x_range, spacing, words in (
        ((0, 1.05), 0.1, "x_range whose length is a multiple"),
        ((1, 0), 0.1, "x_range whose length is a multiple"),
        ((0, 1), 0.0, "spacing: expected .*, found 0"),
    ):
        refuses(ModelError, words, blank, x_range, (0, 1), spacing)


@pytest.mark.parametrize(
    ("make", "options"), [(power_law, ROUGH), (craters, CRATERS), (rocks, ROCKS)]
)
def test_seeds(make, options):
    grid = blank((0, 10), (0, 8), 0.1)
    first, again = make(grid, **options), make(grid, **options)
    other = make(grid, **{**options, "seed": 99})
    np.testing.assert_array_equal(first.z, again.z)
    assert np.abs(other.z - first.z).max() > 0.01
    assert not grid.z.any()


@pytest.mark.parametrize(("make", "options"), [(craters, CRATERS), (rocks, ROCKS)])
def test_spacing_does_not_matter_and_more_keep_the_first(make, options):
    grid = blank((0, 10), (0, 8), 0.1)
    coarse, fine = make(blank((0, 10), (0, 8), 0.2), **options), make(grid, **options)
    # The rim of a crater is cut off at 1e-7 of its height, where the grid decides.
    assert_allclose(fine.z[::2, ::2], coarse.z, rtol=0, atol=1e-8)
    more = make(grid, **{**options, "count": 2 * options["count"]})
    assert ((np.abs(more.z) > 0) | (fine.z == 0)).mean() > 0.999
    assert not make(grid, **{**options, "count": 0}).z.any()


def test_power_law_rms_and_refinement():
    slope = ramp(blank((0, 20), (0, 10), 0.2), start=0, end=10, rise=1)
    coarse = power_law(slope, **ROUGH).z - slope.z
    assert_allclose(coarse.mean(), 0, atol=1e-15)
    assert_allclose(np.sqrt(np.mean(coarse**2)), 0.05, rtol=1e-12)
    fine = power_law(blank((0, 20), (0, 10), 0.1), **ROUGH).z
    # The same ground but for the mean over the nodes.
    assert np.corrcoef(fine[::2, ::2].ravel(), coarse.ravel())[0, 1] > 1 - 1e-10
    assert_allclose(fine[::2, ::2].std(), coarse.std(), rtol=0.02)
    step = np.abs(np.diff(fine, axis=0)).max()
    assert np.abs(fine[0] - fine[-1]).max() > 3 * step  # it has no period


def test_power_law_spectrum():
    n, h, hurst = 400, 0.1, 0.9
    grid = blank((0, (n - 1) * h), (0, (n - 1) * h), h)
    z = power_law(grid, rms=0.1, hurst=hurst, longest=20, shortest=0.5, seed=6).z
    window = np.hanning(n)
    power = np.abs(np.fft.fft2(z * np.outer(window, window))) ** 2
    k = 2 * np.pi * np.fft.fftfreq(n, h)
    ring = np.hypot(k[:, None], k)
    edges = np.geomspace(2 * np.pi / 8, 2 * np.pi / 0.7, 12)
    middle = np.sqrt(edges[1:] * edges[:-1])
    density = [power[(ring >= a) & (ring < b)].mean() for a, b in pairwise(edges)]
    fitted = np.polyfit(np.log(middle), np.log(density), 1)[0]
    assert_allclose(fitted, -2 * (hurst + 1), atol=0.25)
    # Beyond the shortest wavelength there is nothing.
    assert power[ring > 2 * np.pi / 0.4].max() < 1e-6 * power.max()


def test_crater_proportions():
    grid = craters(blank((-20, 20), (-20, 20), 0.05), count=1, diameters=(4, 4), seed=1)
    assert_allclose(grid.z.max() - grid.z.min(), 0.2 * 4, rtol=1e-3)
    assert_allclose(grid.z.max(), 0.04 * 4, rtol=1e-3)
    centre = np.unravel_index(grid.z.argmin(), grid.z.shape)
    x, y = grid.x[centre[0]], grid.y[centre[1]]
    distance = np.hypot(grid.x[:, None] - x, grid.y - y)
    crest = grid.z > 0.9999 * grid.z.max()
    assert_allclose(distance[crest], 2, atol=0.1)
    steepest = np.hypot(*np.gradient(grid.z, 0.05)).max()
    assert_allclose(np.rad2deg(np.arctan(steepest)), 31.6, atol=0.5)


def test_sizes_follow_the_power_law():
    grid = blank((0, 10), (0, 10), 2.0)
    scattered = np.array(_scatter("rocks", grid, 20_000, (0.1, 1.0), 7))
    d = scattered[:, 2]
    assert d.min() >= 0.1
    assert d.max() <= 1.0
    bins = np.geomspace(0.1, 0.5, 8)
    above = np.array([(d > b).mean() for b in bins]) + 0.01  # 1 % would be above the largest
    assert_allclose(np.polyfit(np.log(bins), np.log(above), 1)[0], -2, atol=0.1)


def test_place_rocks():
    base = blank((0, 4), (0, 4), 0.1)
    sloping = ramp(base, start=0, end=4, rise=1, smooth=False)
    placed = [Rock(1.0, 1.0, 0.8, 0.3), (3.0, 3.0, 1.0, 0.2), Rock(1.2, 1.0, 0.8, 0.1)]
    change = place_rocks(sloping, placed).z - sloping.z
    assert_allclose(change[10, 10], 0.3)  # joined by the maximum, not by the sum
    assert_allclose(change[30, 30], 0.2)
    assert change.max() <= 0.3 + 1e-12
    outside = np.ones_like(change, dtype=bool)
    for x, y, d, _ in placed:
        outside &= np.hypot(base.x[:, None] - x, base.y - y) >= d / 2
    assert_allclose(change[outside], 0, atol=1e-15)
    assert_allclose(place_rocks(base, [(0, 4, 1, 0.2)]).z[0, -1], 0.2)
    assert not place_rocks(base, [(-5, 2, 1, 0.2)]).z.any()
    fine = blank((0, 9), (0, 9), 0.02)
    grid = rocks(fine, count=40, diameters=(0.5, 0.5), height_ratio=0.4, seed=2)
    assert_allclose(grid.z.max(), 0.2, rtol=1e-3)
    assert grid.z.min() == 0


@pytest.mark.parametrize("smooth", [True, False])
def test_ramp(smooth):
    grid = ramp(blank((0, 1), (0, 10), 0.1), start=2, end=6, rise=0.5, smooth=smooth)
    assert_allclose(grid.z[:, :21], 0, atol=1e-15)
    assert_allclose(grid.z[:, 60:], 0.5)
    assert_allclose(grid.z[3, 40], 0.25)
    assert_allclose(grid.z[0], grid.z[-1])
    steepest = np.diff(grid.z[0]).max() / 0.1
    assert_allclose(steepest, 0.125 * (15 / 8 if smooth else 1), rtol=3e-3)


def test_ramp_with_round_edges():
    h, start, end, slope, rounding = 0.01, 2.0, 6.0, 0.3, 2.4
    flat, rise = blank((0, 1), (0, 8), h), slope * (end - start)
    grid = ramp(flat, start=start, end=end, rise=rise, smooth=False, rounding=rounding)
    z, half = grid.z[0], rounding / 2
    even = np.clip(slope * (grid.y - start), 0, rise)
    away = (np.abs(grid.y - start) >= half) & (np.abs(grid.y - end) >= half)
    assert_allclose(z[away], even[away], atol=1e-14)
    assert_allclose(np.gradient(z, h).max(), slope, rtol=1e-4)
    curvature = np.diff(z, 2) / h**2
    assert_allclose(curvature.max(), 1.5 * slope / rounding, rtol=1e-3)
    assert_allclose(curvature, -curvature[::-1], atol=1e-9)
    assert np.abs(np.diff(curvature)).max() < 7 * slope * h / rounding**2  # 6 where an edge begins


EVEN = {"start": 1, "end": 2, "rise": 1, "smooth": False}


@pytest.mark.parametrize(
    ("make", "options", "words"),
    [
        (ramp, EVEN | {"rounding": 1.5}, "a rounding from 0 to 1 m, the length of the ramp, found"),
        (ramp, EVEN | {"smooth": True, "rounding": 0.5}, "expected no rounding for a smooth ramp"),
        (ramp, EVEN | {"start": 2}, "ramp: expected start < end"),
        (place_rocks, {"placed": [(1, 1, 0, 1)]}, "diameter and height must be positive"),
        (craters, CRATERS | {"diameters": (2, 1)}, "0 < smallest <= largest"),
        (craters, CRATERS | {"count": -2}, "craters: count: expected .*, found -2"),
        (power_law, ROUGH | {"shortest": 0.1}, "shortest >= 0.2 m, twice the spacing, found 0.1 m"),
        (power_law, ROUGH | {"longest": 0.3}, "shortest < longest"),
        (power_law, ROUGH | {"hurst": 0.0}, "power_law: hurst: expected .*, found 0"),
        (power_law, ROUGH | {"rms": -1.0}, "power_law: rms: expected .*, found -1"),
    ],
)
def test_refusals(make, options, words):
    refuses(ModelError, words, make, blank((0, 4), (0, 4), 0.1), **options)


# Smoothed absolute values and maxima: without offset far from the kink, without jump at it

SMOOTHING_X = ca.SX.sym("x")
CART = rigid_skid_steer()
DEPTH = CART.numeric.wheels[0].depth


def work(power):
    dae = SimpleNamespace(named=lambda name: [power if name == "drive_torque" else 1.0])
    return problem._driving_power(dae)


def load(depth):
    return 4 * DEPTH * press(CART, ca.repmat(depth, 4, 1), 0.1).load[0]


def ramp_smoothing(x):
    return max(x, 0.0)


CASES = {  # expression, exact function, width of the transition
    "ratio on soil": (soil._smooth_size(SMOOTHING_X**2), abs, soil.RATIO_SMOOTHING),
    "positive power": (work(SMOOTHING_X), ramp_smoothing, problem.BLENDED_POWER),
    "load of a pressed wheel": (load(SMOOTHING_X), ramp_smoothing, 0.1 * DEPTH),
    "distance from a disc": (Region.disc(0, 0, 1).outside(SMOOTHING_X, ca.SX(0)) + 1, abs, 1e-3),
    "distance from a corner": (
        Region.polygon(((0, 0), (-1, 1), (-1, -1))).outside(SMOOTHING_X, ca.SX(0)),
        lambda x: x if x > 0 else np.nan,
        1e-3,
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_a_smoothing_has_no_offset_far_from_its_kink(name):
    expression, exact, width = CASES[name]
    smooth = ca.Function(
        "smooth", [SMOOTHING_X], [expression, ca.jacobian(expression, SMOOTHING_X)]
    )
    for x in (-1e5 * width, -1e3 * width, 1e3 * width, 1e5 * width):
        value, slope = map(float, smooth(x))
        if np.isfinite(exact(x)):
            assert value == pytest.approx(exact(x), abs=2e-3 * width)
            assert slope == pytest.approx((exact(1.1 * x) - exact(x)) / (0.1 * x), abs=1e-3)
    assert np.isfinite(np.array(list(map(float, smooth(0.0))))).all()
