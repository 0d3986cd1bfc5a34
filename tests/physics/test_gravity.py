"""Tests of gravity as a number of the vehicle: scaling of forces, and closed forms of motions."""

from dataclasses import replace
from math import inf, nan, pi, sqrt

import casadi as ca
import numpy as np
import pytest

import slipfree as sf
from helpers.dynamics import FLAT, four_wheels, moved, states
from helpers.rasters import from_origin, geotiff
from slipfree.climb.contact_path import least_friction
from slipfree.problem.result import build
from slipfree.terrain.solids import step
from slipfree.vehicle.tree import (
    BODIES,
    EARTH_GRAVITY,
    foreign_map_words,
    gravity_of,
    gravity_words,
)

HILLS = sf.Analytic(lambda x, y: 0.05 * ca.sin(x) + 0.03 * x * y + 0.04 * y, mu=0.6)
MOON = BODIES["moon"].gravity
# G M [km^3/s^2] and radius [km], equatorial of planets, mean of others
ATTRACTION = {
    "moon": (4902.800, 1737.4),
    "mars": (42828.37, 3396.19),
    "mercury": (22031.87, 2440.53),
}
ATTRACTION |= {"venus": (324858.59, 6051.8), "ceres": (62.628, 469.7), "vesta": (17.288, 261.385)}
ATTRACTION |= {"io": (5959.915, 1821.49), "europa": (3202.712, 1560.8), "pluto": (869.6, 1188.3)}
ATTRACTION |= {"ganymede": (9887.833, 2631.2), "callisto": (7179.283, 2410.3)}
ATTRACTION |= {
    "titan": (8978.137, 2574.76),
    "enceladus": (7.210, 252.1),
    "triton": (1428.495, 1352.6),
}


def test_bodies_attract_by_their_mass_and_radius():
    for name, (attraction, radius) in ATTRACTION.items():
        assert BODIES[name].gravity == pytest.approx(1e3 * attraction / radius**2, rel=4e-3)
        assert BODIES[name].radius == pytest.approx(1e3 * radius)
    assert set(BODIES) == {"earth", *ATTRACTION}
    assert gravity_of("Moon") == gravity_of(1.62) == sf.in_gravity(cart(), "moon").gravity
    assert gravity_words(1.62) == "1.62 m/s^2 (moon)"
    assert gravity_words(1.7) == "1.7 m/s^2"


def test_a_map_of_another_body_with_the_gravity_of_the_earth_is_noted(tmp_path):
    words = '; but the map is of a body with a radius of 1737.4 km: set gravity = "moon"'
    assert foreign_map_words(EARTH_GRAVITY, 1737400.0) == words
    assert foreign_map_words(EARTH_GRAVITY, 1e6).endswith("1000 km: set 'gravity' [m/s^2]")
    for gravity, radius in ((1.62, 1737400.0), (EARTH_GRAVITY, 6378388.0), (EARTH_GRAVITY, nan)):
        assert not foreign_map_words(gravity, radius)
    crs = "+proj=stere +lat_0=-90 +a=1737400 +b=1737400 +units=m"
    geotiff(tmp_path / "m.tif", np.zeros((40, 40)), from_origin(-20, 20, 1), crs=crs)
    (tmp_path / "p.toml").write_text(
        'verb = "direct"\nterrain = { file = "m.tif" }\n'
        'vehicle = { catalog = "skid_steer", mass = 20.0 }\nstart = { x = 0.0, y = 0.0 }\n'
        'driver = { name = "straight", speed = 0.5 }\ntime = { duration = 1, step = 0.5 }\n'
    )
    noted = {(): f"9.81 m/s^2 (earth){words}", ("gravity=moon",): "1.62 m/s^2 (moon)"}
    for settings, expected in noted.items():
        facts = dict(build(sf.load_problem(tmp_path / "p.toml", settings)).facts)
        assert facts["gravity"] == expected


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (0, "expected a positive, finite number in m.s.2, .*found 0; change it"),
        *((value, f"found.* {value}") for value in (-1.62, inf, nan, True)),
        ("mon", "one of the bodies earth, moon.*found 'mon'; did you mean 'moon'"),
        ("qqq", "found 'qqq'; give the number"),
    ],
)
def test_other_gravities_are_errors(value, words):
    with pytest.raises(sf.ModelError, match=words):
        sf.in_gravity(cart(), value)
    if isinstance(value, float):
        with pytest.raises(sf.ModelError, match=r"gravity: expected a (positive, |finite )*number"):
            replace(cart(), gravity=value)


def cart(**keys):
    return sf.catalog.three_wheeler(mass=30.0, wheel_mass=2.0, center_of_mass=(0, 0, 0.1), **keys)


def driven(model, duration=2.0):
    inputs = model.inputs(right_rate=0.5, left_rate=0.4, steer_rate=0.0)
    return sf.simulate(model, sf.settle(model), inputs, np.linspace(0, duration, 6))


def on_earth_and_moon(model, **keys):
    """Return the motions of a cart with the same rates in both gravities."""
    vehicles = cart(**keys), sf.in_gravity(cart(**keys), MOON)
    return [driven(model(vehicle, HILLS)) for vehicle in vehicles]


def test_loads_and_torques_scale_with_gravity_and_friction_does_not():
    earth, moon = on_earth_and_moon(sf.direct_kinematics)
    for name in ("x", "y", "heading", "tilt_left", "slip_across"):
        assert np.array_equal(moon[name], earth[name])
    for name in ("utilisation", "friction_needed", "tip_over_margin"):
        assert moon[name] == pytest.approx(earth[name], rel=1e-9)
    ratio = MOON / EARTH_GRAVITY
    for name in ("force_normal", "force_along", "drive_torque", "power", "potential_energy"):
        assert moon[name] == pytest.approx(ratio * earth[name], rel=1e-9, abs=1e-9)
    assert np.abs(earth["drive_torque"]).max() > 1


def test_friction_decides_a_slow_motion_alike_in_any_gravity_unless_springs_act():
    earth, moon = on_earth_and_moon(sf.quasi_statics, axle="fixed")
    assert moon["slip_along"] == pytest.approx(earth["slip_along"], abs=1e-9)
    assert moon["utilisation"] == pytest.approx(earth["utilisation"], rel=1e-6)
    ratio = MOON / EARTH_GRAVITY
    assert moon["force_normal"] == pytest.approx(ratio * earth["force_normal"], rel=1e-6)
    earth, moon = on_earth_and_moon(sf.quasi_statics, axle="tilting", stiffness=60.0)
    # the loads overturn tilts; springs that are as stiff everywhere hold them better on the moon
    assert np.abs(moon["tilt_left"]).max() < 0.5 * np.abs(earth["tilt_left"]).max()


def test_a_climb_needs_as_much_friction_in_any_gravity():
    vehicle = sf.catalog.step_climber()
    earth, moon = (
        least_friction(each, step(0.06)) for each in (vehicle, sf.in_gravity(vehicle, 1.62))
    )
    assert moon.mu == pytest.approx(earth.mu, rel=1e-9)
    assert sf.in_gravity(vehicle, 1.62).weight == pytest.approx(21.6 * 1.62)
    stiffness = [v.weight / v.wheels[0].depth for v in (vehicle, sf.in_gravity(vehicle, 1.62))]
    assert stiffness[0] == pytest.approx(stiffness[1])  # of contacts: a property of the wheels


def heave(gravity):
    """Return the sag of the struts and the frequency of the heave of a car on them."""
    spring = 4000.0
    car = four_wheels(spring=spring, static_depth=1e-4)
    free = (replace(c, damping=0.0, rest=0.0) for c in car.coordinates)
    car = sf.in_gravity(replace(car, coordinates=tuple(free)), gravity)
    model = sf.dynamics(car, FLAT)
    rest = sf.settle(model)
    t = np.linspace(0, 2, 401)
    struts = ("s0", "s1", "s2", "s3")
    values = {name: rest[name][0] for name in (*struts, "attitude_w", "attitude_x", "y", "z")}
    low = dict(values)
    for name in struts:  # the platform is lower, the wheels stay
        values[name] += 1e-3 * gravity / EARTH_GRAVITY
    values["z"] -= 1e-3 * gravity / EARTH_GRAVITY
    run = moved(model, states(model, **values), t, 1e-9)
    height = run["z"] - low["z"]
    crossings = np.flatnonzero(np.diff(np.sign(height)))
    at = t[crossings] - height[crossings] * np.diff(t)[crossings] / np.diff(height)[crossings]
    return np.mean([low[f"s{k}"] for k in range(4)]), (len(at) - 1) / 2 / (at[-1] - at[0])


def test_a_suspension_sags_with_gravity_and_keeps_its_frequency():
    (sag, frequency), (less, same) = heave(EARTH_GRAVITY), heave(MOON)
    assert abs(sag) == pytest.approx(40 * EARTH_GRAVITY / 4 / 4000, rel=1e-3)
    assert less == pytest.approx(sag * MOON / EARTH_GRAVITY, rel=1e-3)
    assert frequency == pytest.approx(sqrt(4 * 4000 / 40) / (2 * pi), rel=5e-3)
    assert same == pytest.approx(frequency, rel=1e-4)


def hanging(gravity):
    """Return a heavy car from which a bob hangs on a joint across it, 0.5 m long."""
    car = four_wheels(static_depth=1e-4, mass=1e5, driven=False)
    body = sf.Body(1.0, (0, 0, -0.5), (0.01, 0.01, 0.01, 0, 0, 0))
    bob = sf.Joint("rod", "platform", "x", (0, 0.35, 2.0), "swing", body=body)
    swing = sf.Coordinate("swing", "passive", "angle of the bob")
    return sf.in_gravity(replace(car, coordinates=(swing,), joints=(bob,)), gravity)


@pytest.mark.parametrize("body", ["moon", "mars", "earth"])
def test_a_pendulum_swings_and_a_vehicle_falls_as_the_closed_forms_say(body):
    gravity, t = BODIES[body].gravity, np.linspace(0, 1, 11)
    model = replace(sf.dynamics(sf.in_gravity(four_wheels(), body), FLAT), limits=(), checks=())
    run = moved(model, states(model, z=30.0, velocity_y=0.5), t)
    assert run["z"] == pytest.approx(30 - gravity * t**2 / 2, abs=1e-6)
    assert run["potential_energy"] == pytest.approx(
        run["potential_energy"][0] - 48 * gravity**2 * t**2 / 2, rel=1e-6
    )
    model = sf.dynamics(hanging(gravity), FLAT)
    omega = sqrt(gravity * 0.5 / (0.25 + 0.01))
    run = moved(
        model,
        states(model, z=0.15 - 1e-4 * gravity / EARTH_GRAVITY, swing=0.01),
        np.linspace(0, 5, 51),
        1e-9,
    )
    assert run["swing"] == pytest.approx(0.01 * np.cos(omega * run.t), abs=2e-5)


def test_the_rigid_model_of_plans_bears_the_weight_in_any_gravity():
    run = sf.settle(sf.rigid_dynamics(sf.in_gravity(four_wheels(), MOON), FLAT))
    assert run["force_normal"].sum() == pytest.approx(48 * MOON, rel=1e-3)
