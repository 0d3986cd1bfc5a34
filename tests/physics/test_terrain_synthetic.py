"""Tests of synthetic grounds: seeds, stated sizes, independence of the spacing."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_allclose

from slipfree.core.errors import ModelError
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
        with pytest.raises(ModelError, match=words):
            blank(x_range, (0, 1), spacing)


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
    with pytest.raises(ModelError, match=words):
        make(blank((0, 4), (0, 4), 0.1), **options)
