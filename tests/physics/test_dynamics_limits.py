"""Tests of dynamics beyond kinematics (tip-over, flight, spinning wheels), and of agreement."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from helpers.dynamics import FLAT, center_height, four_wheels, moved
from slipfree import Analytic, catalog, dynamics, quasi_statics, settle
from slipfree.laws.compliant import Compliant
from slipfree.laws.coulomb import Coulomb
from slipfree.vehicle.drives import Torque
from slipfree.vehicle.tree import EARTH_GRAVITY


@pytest.mark.slow
def test_inside_wheels_lift_at_the_speed_of_the_closed_form():
    """``v^2 (h + sum I_a / (m R)) = g r b (1 - 2 s)`` for the share s of the inside wheels."""
    radius, half_track, wheel, axial = 2.0, 0.3, 0.15, 0.5 * 2.0 * 0.15**2
    vehicle = four_wheels(mass=40.0, height=0.4, turn=radius, static_depth=1e-4)
    model = dynamics(vehicle, replace(FLAT, mu=3.0))
    height = center_height(vehicle, 0.4)
    limit = np.sqrt(EARTH_GRAVITY * radius * half_track / height)
    speed = limit * (0.55 + 0.07 * model.t) * ca.tanh(3 * model.t)
    ways = [
        np.hypot(radius + side, ahead) for ahead in (0.7, 0.0) for side in (half_track, -half_track)
    ]
    rates = {
        label.full: speed / wheel * way / radius
        for label, way in zip(model.labels.u.wheels, ways, strict=True)
    }
    run = moved(model, settle(model), np.linspace(0, 5, 101), 1e-7, **rates)
    loads = run["force_normal"]
    share = loads[:, 1::2].sum(1) / loads.sum(1)
    at = int(np.argmax(share < 0.1))
    assert at > 20
    lateral = (run["omega_z"] * np.hypot(run["velocity_x"], run["velocity_y"]))[at]
    needed = EARTH_GRAVITY * half_track * (1 - 2 * share[at])
    spinning = 4 * axial / (48 * wheel)
    # contacts yield: 0.990 in the lab, and 0.956 without the gyroscopic moment
    assert lateral * (height + spinning) / needed == pytest.approx(1, abs=0.01)
    assert lateral * height / needed < 0.965


HILLS = Analytic(
    lambda x, y: (
        0.12 * ca.sin(2 * np.pi * x / 7) * ca.cos(2 * np.pi * y / 9)
        + 0.05 * ca.sin(2 * np.pi * (x + 0.6 * y) / 4.3)
    ),
    mu=0.8,
)


def turned(model, speed):
    """Return the end of a turn of a skid-steer from rest, over a way of about 1 m [m]."""
    ramp = ca.tanh(model.t * speed / 0.3) ** 2
    rates = {
        label.full: speed / 0.15 * ramp * (1.2 if "right" in label.full else 0.6)
        for label in model.labels.u.wheels
    }
    run = moved(model, settle(model), np.linspace(0, 1.3 / speed, 3), 1e-7, **rates)
    return np.array([run["x"][-1], run["y"][-1]])


@pytest.mark.slow
def test_the_difference_from_quasi_statics_is_of_second_order_in_the_speed():
    """About 0.025 m over 1 m at 0.8 m/s, besides what the depth of the wheels shifts it by."""
    vehicle, apart = catalog.skid_steer(), []
    for speed in (0.8, 0.4, 0.2):
        still = quasi_statics(vehicle, HILLS, law=Coulomb(creep=0.01 * speed))
        moving = dynamics(vehicle, HILLS, law=Compliant(creep=0.01 * speed))
        apart.append(turned(moving, speed) - turned(still, speed))
    assert 0.02 < np.linalg.norm(apart[0]) < 0.03
    fast, slow = np.linalg.norm(np.diff(apart, axis=0), axis=1)
    assert fast / slow == pytest.approx(4, rel=0.1)


@pytest.mark.slow
def test_a_car_off_a_ledge_flies_and_lands():
    """Off 0.3 m at 6 m/s: the centre of mass falls freely while no wheel touches."""
    drop = Analytic(lambda x, y: -0.15 * (1 + ca.tanh((y - 2) / 0.08)) + 0 * x, mu=0.7)
    vehicle = four_wheels(spring=4000.0)
    model = dynamics(vehicle, drop)
    rates = {label.full: 40.0 for label in model.labels.u.wheels}
    t = np.linspace(0, 0.8, 201)
    run = moved(model, settle(model, speed=6.0), t, 1e-7, **rates)
    flying = np.flatnonzero(run["force_normal"].max(1) == 0)
    span = slice(flying[0], flying[0] + int(np.argmin([*(np.diff(flying) == 1), False])) + 1)
    assert t[span][-1] - t[span][0] > 0.08
    rest = 40 / 4 * EARTH_GRAVITY / 4000
    springs = sum(4000 / 2 * (run[f"s{k}"] + rest) ** 2 for k in range(4))
    height = (run["potential_energy"] - springs) / (vehicle.mass * EARTH_GRAVITY)
    assert 2 * np.polyfit(t[span], height[span], 2)[0] == pytest.approx(-EARTH_GRAVITY, rel=1e-6)
    assert run["force_normal"][-1].min() > 0
    assert run["z"][-1] == pytest.approx(run["z"][0] - 0.3, abs=0.02)


def test_one_wheel_on_ice_spins_up():
    """Its spin is that of the torque and of the friction under its load."""
    patch = Analytic(
        lambda x, y: np.tan(np.deg2rad(8)) * y + 0 * x,
        mu=lambda x, y: (
            0.7 - 0.17 * (1 + ca.tanh((x - 0.1) / 0.02)) * (1 + ca.tanh((y - 0.4) / 0.02))
        ),
    )
    model = dynamics(four_wheels(drive=Torque(), static_depth=1e-4), patch)
    torques = {label.full: 2.8 for label in model.labels.u.wheels}
    run = moved(model, settle(model), np.linspace(0, 1, 101), 1e-7, **torques)
    spin, axial = run["wheel_rate", "w0"], 0.5 * 2.0 * 0.15**2
    moment = 2.8 - 0.02 * 0.15 * run["force_normal", "w0"]
    gain = np.trapezoid(moment, run.t) / axial
    assert spin[-1] == pytest.approx(gain, rel=1e-4)
    # without the fourth wheel's pull the car rolls back
    assert run["velocity_y"][-1] < 0
    assert np.abs(run["wheel_rate"][-1, 1:] * 0.15 - run["velocity_y"][-1]).max() < 5e-3
