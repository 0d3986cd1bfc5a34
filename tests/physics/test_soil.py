"""Tests of wheels in soil: closed forms, quadrature, symmetry, derivatives, regions, test bed."""

from dataclasses import replace
from itertools import pairwise
from math import acos, cos, exp, pi, radians, sin, tan

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import quad

import slipfree as sf
from helpers.commands import refuses
from helpers.dynamics import energy_error
from slipfree.laws import soil as law
from slipfree.laws.soil import (
    SOILS,
    SoilRegion,
    WheelSize,
    forces_at_slip,
    forces_at_speeds,
    known_soil,
    soil_at,
    static_sinkage,
    wheel_size,
)
from slipfree.models.rigid_dynamics import rigid_dynamics
from slipfree.models.single_wheel import (
    SLIP_LIMIT,
    drawbar_reserve,
    motion_at_slip,
    single_wheel,
    steady_forces,
)
from slipfree.vehicle.sections import Disc
from slipfree.vehicle.tree import EARTH_GRAVITY

SAND, SIZE, LOAD = sf.Soil(), WheelSize(0.092, 0.107), 64.7
DIGGING = replace(SAND, exponent_slip=0.4, exponent_skid=0.8, coupled_shear=True)
SMALL = 1e-9  # peak of the stress at the lowest point, almost
SHEARLESS = sf.Soil(shear_along=1e9, shear_across=1e9, peak=SMALL, peak_rate=0.0)
STATES = [  # depth, rim speed, forward and sideways speed: driven, braked, locked, sideways, ...
    (0.012, 0.2, 0.15, 0.03),
    (0.015, 0.1, 0.2, -0.05),
    (0.02, 1e-5, 0.2, 0.1),
    (0.01, 0.0, 0.0, 0.2),
    (0.03, 0.3, 0.001, 0.002),
    (0.012, -0.2, -0.15, 0.03),
    (0.012, 5e-4, 2e-4, -3e-4),
]


def stiffness(soil, size=SIZE):
    """Return the modulus of the pressure-sinkage relation [N/m^(n+2)]."""
    return soil.cohesive_modulus / size.width + soil.frictional_modulus


def numbers(forces):
    """Return forces as an array of four numbers."""
    return np.array([float(each) for each in forces])


def by_quadrature(soil, size, depth, s, beta, gravity=EARTH_GRAVITY):
    """Return the forces by adaptive quadrature of the published integrands."""
    r, b = size
    entry, leaving = acos(1 - depth / r), -acos(1 - soil.exit_depth * depth / r)
    peak = (soil.peak + soil.peak_rate * s) * entry
    k_x = soil.shear_along + soil.shear_along_rate * abs(beta)
    k_y = soil.shear_across + soil.shear_across_rate * abs(beta)
    phi, r_s = soil.friction_angle, r + soil.grouser_height
    ratio = 1 - s if s >= 0 else 1 / (1 + s)  # of the speed of the centre to that of the rim
    held_back = max(ratio - 1, 0)  # speeds over that of the rim
    skid = np.hypot(held_back, ratio * tan(beta)) / np.hypot(ratio, ratio * tan(beta))
    exponent = soil.exponent + soil.exponent_slip * max(s, 0) + soil.exponent_skid * skid
    x_c = pi / 4 - phi / 2
    d_1, d_2 = 1 / tan(x_c) + tan(x_c + phi), 1 / tan(x_c) + tan(phi) / tan(x_c) ** 2

    def stresses(theta):
        ahead = theta >= peak
        ref = theta if ahead else entry - (theta - leaving) / (peak - leaving) * (entry - peak)
        sigma = stiffness(soil, size) * max(r * (cos(ref) - cos(entry)), 0) ** exponent
        strength = soil.cohesion + sigma * tan(phi)
        j_x = r_s * (entry - theta - ratio * (sin(entry) - sin(theta)))
        j_y = r_s * ratio * (entry - theta) * tan(beta)
        size_x, size_y = (1 - exp(-abs(j) / k) for j, k in ((j_x, k_x), (j_y, k_y)))
        along, across = strength * np.copysign(size_x, j_x), strength * np.copysign(size_y, j_y)
        if soil.coupled_shear:
            shear = strength * (1 - exp(-np.hypot(j_x / k_x, j_y / k_y))) / np.hypot(j_x, j_y)
            along, across = shear * j_x, shear * j_y
        height = r * (cos(theta) - cos(entry))
        weight = soil.density * gravity
        pushed = d_1 * (soil.cohesion * height + d_2 * weight * height**2 / 2)
        return sigma, along, across, pushed * (r - height * cos(theta)) * np.sign(beta)

    def integral(part):
        options = {"epsabs": 1e-11, "epsrel": 1e-12, "limit": 200}
        breaks = sorted({leaving, peak, entry, *_sign_changes(entry, ratio, leaving)})
        pairs = pairwise(breaks)
        return sum(quad(lambda t: part(t, *stresses(t)), *pair, **options)[0] for pair in pairs)

    return np.array(
        [
            integral(lambda t, sg, tx, _y, _p: r * b * (sg * cos(t) + tx * sin(t))),
            integral(lambda t, sg, tx, _y, _p: r * b * (tx * cos(t) - sg * sin(t))),
            integral(lambda _t, _s, _x, ty, p: -r * b * ty - p),
            integral(lambda _t, _s, tx, _y, _p: r * r_s * b * tx),
        ]
    )


def _sign_changes(entry, ratio, leaving):
    """Return the angles at which the shear path along the wheel changes its sign."""
    theta = np.linspace(leaving, entry, 4001)[:-1]
    path = entry - theta - ratio * (np.sin(entry) - np.sin(theta))
    return theta[:-1][np.diff(np.sign(path)) != 0].tolist()


def test_a_wheel_at_rest_sinks_as_in_the_closed_form():
    soil, depth = replace(SHEARLESS, exit_depth=1.0), 0.02
    entry = acos(1 - depth / SIZE.radius)
    segment = SIZE.radius**2 * (entry - sin(entry) * cos(entry))
    load = SIZE.width * stiffness(soil) * segment  # pressure times depth over a circular segment
    assert static_sinkage(soil, SIZE, load) == pytest.approx(depth, rel=1e-7)


@pytest.mark.parametrize("exponent", [1.0, 0.8])
def test_a_towed_wheel_meets_the_compaction_resistance_of_bekker(exponent):
    soil, depth = replace(SHEARLESS, exit_depth=0.0, exponent=exponent), 0.02
    work = SIZE.width * stiffness(soil) * depth ** (exponent + 1) / (exponent + 1)
    pull = float(forces_at_slip(soil, SIZE, depth, 0.0, 0.0).pull)
    exact = exponent == int(exponent)  # otherwise the stress has a branch point at the edges
    assert pull == pytest.approx(-work, rel=1e-7 if exact else 1e-3)


@pytest.mark.parametrize("slip", [0.1, 1.0])
def test_hard_soil_is_coulomb_friction(slip):
    soil = replace(SAND, cohesion=0.0, frictional_modulus=1e15, shear_along=1e-12)
    curves = single_wheel(soil, SIZE, LOAD, [slip])
    grip = LOAD * tan(soil.friction_angle)
    assert curves.sinkage[0, 0] < 1e-7
    assert curves.pull[0, 0] == pytest.approx(grip, rel=1e-3)
    assert curves.torque[0, 0] == pytest.approx(SIZE.radius * grip, rel=1e-3)


@pytest.mark.parametrize("name", SOILS)
@pytest.mark.parametrize("slip", [-0.99, -0.15, 0.0, 0.3, 0.95])
def test_the_forces_are_those_of_the_published_integrals(name, slip, monkeypatch):
    """The shear path of a braked wheel changes its sign, or saturates within a small angle."""
    soil = replace(known_soil(name), grouser_height=0.005)
    errors, converged = [], []
    for depth, beta in ((0.004, 0.0), (0.015, radians(10)), (0.03, radians(30))):
        expected = by_quadrature(soil, SIZE, depth, slip, beta)
        scale = np.array([1, 1, 1, SIZE.radius]) * expected[0]
        found = numbers(forces_at_slip(soil, SIZE, depth, slip, beta))
        errors.append(np.abs(found - expected) / scale)
        with monkeypatch.context() as patch:
            points, weights = np.polynomial.legendre.leggauss(40)
            patch.setattr(law, "POINTS", points)
            patch.setattr(law, "WEIGHTS", weights)
            found = numbers(forces_at_slip(soil, SIZE, depth, slip, beta))
        converged.append(np.abs(found - expected) / scale)
    moon = by_quadrature(soil, SIZE, 0.03, slip, radians(30), 1.62)
    found = numbers(forces_at_slip(soil, SIZE, 0.03, slip, radians(30), 1.62))
    errors.append(np.abs(found - moon) / scale)
    smooth = soil.exponent == 1  # otherwise the stress has a branch point at both edges
    assert np.max(errors) < (1e-4 if slip < 0 else 1e-10 if smooth else 2e-9)
    if smooth and slip >= 0:
        assert np.max(converged) < 1e-12


@pytest.mark.parametrize("slip", [-0.9, -0.15, 0.3, 0.95])
def test_coupled_shear_and_slip_sinkage_are_those_of_their_integrals(slip):
    for depth, beta in ((0.015, radians(10)), (0.03, radians(30))):
        expected = by_quadrature(DIGGING, SIZE, depth, slip, beta)
        scale = np.array([1, 1, 1, SIZE.radius]) * expected[0]
        found = numbers(forces_at_slip(DIGGING, SIZE, depth, slip, beta))
        assert np.abs((found - expected) / scale).max() < 2e-9


def test_shear_is_coupled_only_with_a_slip_angle():
    coupled = replace(SAND, coupled_shear=True)
    for slip in (-0.5, 0.0, 0.4):
        straight = [numbers(forces_at_slip(s, SIZE, 0.015, slip, 0.0)) for s in (SAND, coupled)]
        assert straight[1] == pytest.approx(straight[0], rel=1e-6, abs=1e-6)
    # where both stresses saturate their resultant is the strength, and their ratio that of paths
    sliding = replace(SHEARLESS, shear_along=1e-6, shear_across=1e-6, density=0.0, cohesion=0.0)
    motion = 1e-4, 0.0, 0.2, 0.1, 1e-8  # so shallow that arc and chord are equal
    single = numbers(forces_at_speeds(replace(sliding, coupled_shear=True), SIZE, *motion))
    assert single[3] / SIZE.radius == pytest.approx(2 * single[2], rel=1e-2)
    both = numbers(forces_at_speeds(sliding, SIZE, *motion))
    assert both[3] / SIZE.radius == pytest.approx(both[2], rel=1e-2)


def test_sinkage_grows_with_slip_and_skid():
    def depths(soil, motion):
        load = np.full(motion.shape[1], LOAD)
        return steady_forces(soil, SIZE, motion, load).sinkage

    slips = motion_at_slip(np.array([0.0, 0.3, 0.6]), np.zeros(3))
    published, digging = (depths(soil, slips) for soil in (SAND, DIGGING))
    assert (np.diff(digging) > 2 * np.abs(np.diff(published))).all()
    assert digging[0] == pytest.approx(published[0], rel=1e-9)
    free = replace(SHEARLESS, shear_along=1e15, exponent_skid=0.8, exit_depth=1.0)
    angle = np.linspace(0, pi / 2, 5)
    locked = depths(free, np.vstack([0 * angle, np.cos(angle), np.sin(angle)]))
    assert locked == pytest.approx(np.full(5, locked[0]), rel=1e-6)  # skid ratio one
    more = replace(free, exponent=free.exponent + 0.8, exponent_skid=0)
    assert locked[0] == pytest.approx(depths(more, slips)[0], rel=1e-6)


@pytest.mark.parametrize("slip", [0.1, 0.3, 0.6])
@pytest.mark.parametrize("growth", [0.4, 0.8])
def test_slip_sinkage_has_the_published_exponent(slip, growth):
    """Ding et al. (2015): ``n = n_0 + n_1 s``, without an offset of the smoothing at slip zero."""
    motion, load = motion_at_slip(np.array([slip]), np.zeros(1)), np.array([LOAD])
    grown = replace(SAND, exponent_slip=growth)
    published = replace(SAND, exponent=SAND.exponent + growth * slip)
    found, expected = (steady_forces(s, SIZE, motion, load).sinkage for s in (grown, published))
    assert found == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("soil", [SAND, DIGGING])
def test_forces_are_symmetric(soil):
    for depth, rim, forward, sideways in STATES:
        there = numbers(forces_at_speeds(soil, SIZE, depth, rim, forward, sideways, 1e-3))
        back = numbers(forces_at_speeds(soil, SIZE, depth, -rim, -forward, sideways, 1e-3))
        other = numbers(forces_at_speeds(soil, SIZE, depth, rim, forward, -sideways, 1e-3))
        assert back == pytest.approx(there * [1, -1, 1, -1], rel=1e-12, abs=1e-12)
        assert other == pytest.approx(there * [1, 1, -1, 1], rel=1e-12, abs=1e-12)


def test_slip_ratio_and_slip_angle_are_speeds():
    for slip, rim, forward in ((0.3, 0.2, 0.14), (-0.3, 0.14, 0.2)):
        angle = radians(12)
        sideways = forward * tan(angle)
        expected = numbers(forces_at_slip(SAND, SIZE, 0.015, slip, angle))
        found = numbers(forces_at_speeds(SAND, SIZE, 0.015, rim, forward, sideways, 1e-8))
        assert found == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("soil", [SAND, DIGGING])
def test_the_ground_resists_every_motion(soil):
    """A braked, locked, spinning or sideways wheel loses power to the soil."""
    for depth, rim, forward, sideways in STATES:
        _, pull, side, torque = numbers(
            forces_at_speeds(soil, SIZE, depth, rim, forward, sideways, 1e-3)
        )
        assert torque * rim / SIZE.radius - pull * forward - side * sideways > 0
    locked = numbers(forces_at_slip(soil, SIZE, 0.015, -1.0, 0.0))
    spinning = numbers(forces_at_slip(soil, SIZE, 0.015, 1.0, 0.0))
    assert locked[1] < 0 < spinning[1]
    assert locked[3] < 0 < spinning[3]


@pytest.mark.parametrize("soil", [SAND, DIGGING])
def test_values_and_derivatives_are_finite_at_standstill_and_in_the_air(soil):
    x = [ca.SX.sym(f"x{k}") for k in range(4)]
    forces = ca.vertcat(*forces_at_speeds(soil, SIZE, *x, 1e-3))
    both = ca.Function("both", x, [forces, ca.jacobian(forces, ca.vertcat(*x))])
    for depth in (-0.1, 0.0, 1e-12, 0.01, 0.2):
        for each in both(depth, 0, 0, 0):
            assert np.isfinite(np.array(each)).all()
    assert np.array(both(-0.1, 0.2, 0.1, 0.05)[0]) == pytest.approx(np.zeros((4, 1)), abs=1e-7)


def cart():
    """Return a skid-steered cart of 24 kg with wheels of 107 mm width."""
    return sf.catalog.skid_steer(
        mass=20.0, wheel_mass=1.0, center_of_mass=(0, 0, 0.05), r1=0.0535, r2=0.0965
    )


@pytest.mark.slow
def test_a_cart_climbs_sand_with_the_slip_of_its_balance():
    """An independent balance of forces on the level cart has slip 0.1393 on 8 degrees."""
    ground, motions = sf.Analytic(lambda x, y: tan(radians(8)) * y + 0 * x), []
    for make, duration in ((sf.dynamics, 6.0), (sf.quasi_statics, 1.0)):
        model = make(cart(), ground, law=SAND)
        inputs = model.inputs(**{label.full: 0.2 / 0.15 for label in model.labels.u.wheels})
        t = np.linspace(0, duration, 6)
        motions.append(
            sf.simulate(model, sf.settle(model), inputs, t, options=sf.SolverOptions(1e-7))
        )
        assert motions[-1].stop is None
    run, slow = motions
    assert run["slip_ratio"][-1] == pytest.approx(0.1393, abs=5e-5)
    assert np.abs(energy_error(run)).max() < 1e-5 * run["work"][-1]
    speed = np.hypot(*(np.gradient(slow[name], slow.t) for name in ("y", "z")))
    assert 1 - speed[2] / 0.2 == pytest.approx(0.1393, abs=5e-5)
    rise = np.gradient(slow["potential_energy"], slow.t)
    assert slow["power"] - slow["dissipation"] == pytest.approx(rise, rel=1e-6)
    assert slow["sinkage"][-1] == pytest.approx(run["depth"][-1], rel=0.01)
    assert slow["drive_torque"][-1] == pytest.approx(run["drive_torque"][-1], rel=0.01)


@pytest.mark.parametrize("gravity", [1.62, 3.71])
def test_wheels_in_little_gravity_have_the_forces_and_the_balance_of_their_weight(gravity):
    """Slip and sinkage on a slope, across and along, satisfy the published integrals."""
    slopes = tan(radians(6)), tan(radians(15))
    ground = sf.Analytic(lambda x, y: slopes[0] * y + slopes[1] * x)
    vehicle = sf.in_gravity(cart(), gravity)
    model = sf.quasi_statics(vehicle, ground, law=SAND)
    inputs = model.inputs(**{label.full: 0.2 / 0.15 for label in model.labels.u.wheels})
    run = sf.simulate(model, sf.settle(model), inputs, np.linspace(0, 0.2, 3))
    size = WheelSize(0.15, 0.107)
    forces = np.stack([run[f"force_{name}"][-1] for name in ("normal", "along", "across")], axis=1)
    rim = 0.15 * run["wheel_rate"][-1]
    forward, sideways = run["slip_along"][-1] + rim, run["slip_across"][-1]
    for k, force in enumerate(forces):
        beta, slip = np.arctan2(sideways[k], forward[k]), 1 - forward[k] / rim[k]
        assert 0.05 < slip < 0.3
        assert abs(beta) > 0.03  # three times the angle of smoothing
        expected = by_quadrature(SAND, size, run["sinkage"][-1, k], slip, beta, gravity)
        # creep of 1 mm/s at 0.2 m/s
        assert force == pytest.approx(expected[:3], abs=1e-4 * forces.sum())
        earthly = by_quadrature(SAND, size, run["sinkage"][-1, k], slip, beta)
        assert abs(earthly[2] - expected[2]) > 1e-3 * abs(expected[2])  # bulldozed soil
    normal = np.array([-slopes[1], -slopes[0], 1]) / np.hypot(1, np.hypot(*slopes))
    weight = 24 * gravity
    assert forces[:, 0].sum() == pytest.approx(weight * normal[2], rel=1e-6)
    tangential = np.hypot(*forces[:, 1:].sum(axis=0))
    assert tangential == pytest.approx(weight * np.hypot(*normal[:2]), rel=1e-6)


def test_a_single_wheel_carries_its_load():
    slips, angles = np.linspace(-0.9, 0.9, 7), [0.0, radians(15), -radians(15)]
    curves = single_wheel(SAND, SIZE, LOAD, slips, angles)
    for k, angle in enumerate(angles):
        for i, slip in enumerate(slips):
            found = numbers(forces_at_slip(SAND, SIZE, curves.sinkage[k, i], slip, angle))
            values = curves.pull[k, i], -np.sign(angle) * curves.side[k, i], curves.torque[k, i]
            assert found == pytest.approx([LOAD, *values], rel=1e-9, abs=1e-9)
    assert np.all(np.diff(curves.pull[0]) > 0)
    assert curves.side[1] == pytest.approx(curves.side[2])
    assert np.all(curves.side[1:] > 0)


def test_grousers_shear_at_a_larger_radius():
    smooth, lugs = (
        single_wheel(replace(SAND, grouser_height=height), SIZE, LOAD, [0.2])
        for height in (0.0, 0.01)
    )
    assert lugs.torque[0, 0] > smooth.torque[0, 0]
    assert lugs.pull[0, 0] > smooth.pull[0, 0]


def test_a_catalogued_soil_has_a_source():
    for name, (soil, source) in SOILS.items():
        assert known_soil(name) == soil
        assert "20" in source  # the year
    refuses(sf.ModelError, r"expected one of regolith_simulant.*found 'mud'", known_soil, "mud")


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"friction_angle": 37.2}, "friction_angle: expected an angle in radians, found 37.2"),
        ({"exponent": 0.0}, "exponent: expected a number > 0"),
        ({"peak_rate": 0.4}, "expected 'peak_rate' < 'peak'"),
        ({"peak": 0.9}, r"'peak' \+ 'peak_rate' < 1"),
    ],
)
def test_constants_are_checked(values, words):
    refuses(sf.ModelError, words, sf.Soil, **values)


def test_wheels_have_a_width_and_do_not_sink_to_the_axle():
    ground = sf.Analytic(lambda x, y: 0 * x + 0 * y)
    vehicle = cart()
    thin = replace(
        vehicle, wheels=tuple(replace(wheel, section=Disc(0.15)) for wheel in vehicle.wheels)
    )
    for model in (sf.dynamics, sf.quasi_statics):
        words = r"'front_right': expected a torus.*Torus\(r1, r2\)"
        refuses(sf.ModelError, words, model, thin, ground, law=SAND)
    soft = replace(SAND, cohesion=0.0, frictional_modulus=10.0, cohesive_modulus=1.0)
    with pytest.raises(sf.ModelError, match=r"expected a sinkage smaller than the wheel's radius"):
        sf.dynamics(vehicle, ground, law=soft)
    with pytest.raises(sf.ModelError, match=r"at slip 0.1 and slip angle 0 rad; reduce the load"):
        single_wheel(soft, SIZE, LOAD, [0.1])
    for bad, words in (
        ((0.0, [0.1], [0.0]), "load: expected a finite positive force"),
        ((LOAD, [1.1], [0.0]), "slips: expected slip ratios from -1 to 1"),
        ((LOAD, [0.1], [1.6]), "angles: expected slip angles between -pi/2 and pi/2"),
    ):
        refuses(sf.ModelError, words, single_wheel, SAND, SIZE, *bad)
    with pytest.raises(sf.ModelError, match="found Soil; use another law"):
        rigid_dynamics(vehicle, level_ground(0.5), law=SAND)
    refuses(
        sf.ModelError, r"law: expected ContactLaw, found", sf.dynamics, vehicle, ground, law=sf.Soil
    )


def level_ground(mu):
    """Return level ground with a coefficient of friction."""
    return sf.Analytic(lambda x, y: 0 * x + 0 * y, mu=mu)


# Regions of soils, and the drawbar-pull reserve

LOOSE = replace(sf.Soil(), cohesion=300.0, frictional_modulus=4e5)
PATCH = sf.Region.polygon([(98.0, 199.0), (102.0, 199.0), (102.0, 203.0), (98.0, 203.0)])
SOIL = sf.Soil(regions=(SoilRegion(PATCH, LOOSE, 0.4),))


def cart_regions():
    """Return a skid-steered cart with wheels of 107 mm width."""
    return sf.catalog.skid_steer(mass=20.0, wheel_mass=1.0, r1=0.0535, r2=0.0965)


def ground(slope):
    """Return an even slope whose local origin is not that of the map."""
    x, y = np.linspace(95, 105, 21), np.linspace(195, 209, 29)
    return sf.Bicubic(sf.Grid(x, y, np.add.outer(0 * x, slope * (y - 200.0))))


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
    hole = SoilRegion(sf.Region.disc(100.0, 201.0, 0.5), known_soil("lunar"), 0.1)
    soil = replace(SOIL, regions=(*SOIL.regions, hole))
    at = [ca.SX.sym("x"), ca.SX.sym("y")]
    cohesion = ca.Function("f", at, [soil_at(soil, *at).cohesion])
    assert float(cohesion(100.0, 201.0)) == pytest.approx(known_soil("lunar").cohesion)
    assert float(cohesion(100.0, 202.5)) == LOOSE.cohesion


@pytest.mark.slow
def test_wheels_sink_as_in_the_soil_of_their_place():
    vehicle = cart_regions()
    model = sf.quasi_statics(vehicle, ground(0.0), law=SOIL)
    for y, soil in ((201.0, LOOSE), (205.0, sf.Soil())):
        start = sf.settle(model, x=100.0, y=y)
        expected = static_sinkage(soil, wheel_size(vehicle.wheels[0]), start["force_normal"][0, 0])
        assert start["sinkage"][0] == pytest.approx(np.full(4, expected), rel=1e-6)


@pytest.mark.slow
def test_a_moving_wheel_sinks_at_the_border():
    model = sf.dynamics(cart_regions(), ground(0.0), law=SOIL)
    start = sf.settle(model, x=100.0, y=198.0)
    inputs = model.inputs(**{label.full: 3.0 for label in model.labels.u.wheels})
    run = sf.simulate(model, start, inputs, np.linspace(0, 6, 4), options=sf.SolverOptions(1e-5))
    assert run["depth"][-1] == pytest.approx(1.6 * run["depth"][0], rel=0.1)
    assert run["y"][-1] > 199.5


@pytest.mark.slow
def test_the_reserve_is_that_of_the_single_wheel():
    vehicle = cart_regions()
    model = sf.quasi_statics(vehicle, ground(0.1), law=SOIL)
    start = sf.settle(model, x=100.0, y=201.0)
    inputs = model.inputs(**{label.full: 1.5 for label in model.labels.u.wheels})
    run = drawbar_reserve(vehicle, SOIL, sf.simulate(model, start, inputs, np.linspace(0, 0.5, 3)))
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
    vehicle, soil = sf.catalog.skid_steer(mass=20.0), sf.Soil()
    model = sf.quasi_statics(vehicle, sf.Analytic(lambda x, y: 0.14 * y + 0 * x), law=soil)
    reserves = []
    for heading, rate in ((0.0, 1.0), (np.pi, -1.0)):
        inputs = model.inputs(**{label.full: rate for label in model.labels.u.wheels})
        run = sf.simulate(model, sf.settle(model, heading=heading), inputs, np.linspace(0, 0.2, 3))
        assert (rate * run["force_along"][-1] > 5).all()
        reserves.append(np.sort(drawbar_reserve(vehicle, soil, run)["drawbar_reserve"][-1]))
    assert reserves[1] == pytest.approx(reserves[0], rel=1e-6)


def test_regions_are_checked():
    with pytest.raises(sf.ModelError, match="width: expected a finite positive width, found 0"):
        SoilRegion(PATCH, LOOSE, 0.0)
    refuses(sf.ModelError, "expected a soil without regions", SoilRegion, PATCH, SOIL, 0.4)
