"""Regions of soils, and the drawbar-pull reserve."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from slipfree import (
    Analytic,
    Bicubic,
    Grid,
    ModelError,
    Region,
    Soil,
    SolverOptions,
    catalog,
    dynamics,
    quasi_statics,
    settle,
    simulate,
)
from slipfree.laws.soil import static_sinkage, wheel_size
from slipfree.laws.soil_regions import SoilRegion, soil_at
from slipfree.laws.soils import known_soil
from slipfree.models.single_wheel import SLIP_LIMIT, drawbar_reserve, single_wheel

LOOSE = replace(Soil(), cohesion=300.0, frictional_modulus=4e5)
PATCH = Region.polygon([(98.0, 199.0), (102.0, 199.0), (102.0, 203.0), (98.0, 203.0)])
SOIL = Soil(regions=(SoilRegion(PATCH, LOOSE, 0.4),))


def cart():
    """Return a skid-steered cart with wheels of 107 mm width."""
    return catalog.skid_steer(mass=20.0, wheel_mass=1.0, r1=0.0535, r2=0.0965)


def ground(slope):
    """Return an even slope whose local origin is not that of the map."""
    x, y = np.linspace(95, 105, 21), np.linspace(195, 209, 29)
    return Bicubic(Grid(x, y, np.add.outer(0 * x, slope * (y - 200.0))))


def constant(x, y, name):
    """Return a constant of the soil at a point."""
    place = [ca.SX.sym("x"), ca.SX.sym("y")]
    value = ca.SX(getattr(soil_at(SOIL, *place), name))
    return float(ca.Function("constant", place, [value])(x, y))


def test_constants_are_blended_across_the_border():
    for name in ("cohesion", "frictional_modulus"):
        low, high = getattr(LOOSE, name), getattr(SOIL, name)
        assert constant(100.0, 201.0, name) == low
        assert constant(97.79, 201.0, name) == high
        assert constant(98.0, 201.0, name) == pytest.approx((low + high) / 2, rel=1e-12)
        values = [constant(x, 201.0, name) for x in np.linspace(97.8, 98.2, 9)]
        assert np.all(np.diff(values) < 0)
    assert constant(100.0, 201.0, "exponent") == SOIL.exponent
    assert soil_at(LOOSE, ca.SX.sym("x"), ca.SX.sym("y")) is LOOSE


def test_later_regions_cover_earlier_ones():
    hole = SoilRegion(Region.disc(100.0, 201.0, 0.5), known_soil("lunar"), 0.1)
    soil = replace(SOIL, regions=(*SOIL.regions, hole))
    at = [ca.SX.sym("x"), ca.SX.sym("y")]
    cohesion = ca.Function("f", at, [soil_at(soil, *at).cohesion])
    assert float(cohesion(100.0, 201.0)) == pytest.approx(known_soil("lunar").cohesion)
    assert float(cohesion(100.0, 202.5)) == LOOSE.cohesion


@pytest.mark.slow
def test_wheels_sink_as_in_the_soil_of_their_place():
    vehicle = cart()
    model = quasi_statics(vehicle, ground(0.0), law=SOIL)
    for y, soil in ((201.0, LOOSE), (205.0, Soil())):
        start = settle(model, x=100.0, y=y)
        expected = static_sinkage(soil, wheel_size(vehicle.wheels[0]), start["force_normal"][0, 0])
        assert start["sinkage"][0] == pytest.approx(np.full(4, expected), rel=1e-6)


@pytest.mark.slow
def test_a_moving_wheel_sinks_at_the_border():
    model = dynamics(cart(), ground(0.0), law=SOIL)
    start = settle(model, x=100.0, y=198.0)
    inputs = model.inputs(**{label.full: 3.0 for label in model.labels.u.wheels})
    run = simulate(model, start, inputs, np.linspace(0, 6, 4), options=SolverOptions(1e-5))
    assert run["depth"][-1] == pytest.approx(1.6 * run["depth"][0], rel=0.1)
    assert run["y"][-1] > 199.5


@pytest.mark.slow
def test_the_reserve_is_that_of_the_single_wheel():
    vehicle = cart()
    model = quasi_statics(vehicle, ground(0.1), law=SOIL)
    start = settle(model, x=100.0, y=201.0)
    inputs = model.inputs(**{label.full: 1.5 for label in model.labels.u.wheels})
    run = drawbar_reserve(vehicle, SOIL, simulate(model, start, inputs, np.linspace(0, 0.5, 3)))
    size = wheel_size(vehicle.wheels[1])
    load, used = run["force_normal"][-1, 1], run["force_along"][-1, 1]
    largest = single_wheel(LOOSE, size, load, [SLIP_LIMIT]).pull[0, 0]
    assert run["drawbar_reserve"][-1, 1] == pytest.approx(largest - used, rel=1e-6)
    assert used > 0
    speed = np.hypot(run["velocity_y"][-1], run["velocity_z"][-1])
    assert run["slip_ratio"][-1] == pytest.approx(np.full(4, 1 - speed / (0.15 * 1.5)), rel=1e-4)
    assert run["slip_ratio"][-1].max() < SLIP_LIMIT
    assert run["drawbar_reserve"][-1].min() > 0


@pytest.mark.slow
def test_the_reserve_is_the_same_backwards():
    """A symmetric cart climbs a slope forwards and, turned round, backwards."""
    vehicle, soil = catalog.skid_steer(mass=20.0), Soil()
    model = quasi_statics(vehicle, Analytic(lambda x, y: 0.14 * y + 0 * x), law=soil)
    reserves = []
    for heading, rate in ((0.0, 1.0), (np.pi, -1.0)):
        inputs = model.inputs(**{label.full: rate for label in model.labels.u.wheels})
        run = simulate(model, settle(model, heading=heading), inputs, np.linspace(0, 0.2, 3))
        assert (rate * run["force_along"][-1] > 5).all()
        reserves.append(np.sort(drawbar_reserve(vehicle, soil, run)["drawbar_reserve"][-1]))
    assert reserves[1] == pytest.approx(reserves[0], rel=1e-6)


def test_regions_are_checked():
    with pytest.raises(ModelError, match="width: expected a finite positive width, found 0"):
        SoilRegion(PATCH, LOOSE, 0.0)
    with pytest.raises(ModelError, match="expected a soil without regions"):
        SoilRegion(PATCH, SOIL, 0.4)
