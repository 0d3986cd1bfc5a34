"""Tests of dynamics: closed forms, invariants, driven joints, and limits beyond kinematics."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq

import slipfree as sf
from helpers.commands import refuses
from helpers.dynamics import FLAT, center_height, energy_error, four_wheels, moved, slope, states
from helpers.rounding import root
from slipfree.geometry.frame import Pose, rotation_of
from slipfree.models.multibody import Speeds, mass_matrix, multibody
from slipfree.solve.settle import stable_poses
from slipfree.vehicle.sections import Disc, Sphere, Torus
from slipfree.vehicle.shapes import Box, Hull
from slipfree.vehicle.tree import EARTH_GRAVITY, RATE

LIGHT = sf.Body(1e-9, inertia=(1e-9, 1e-9, 1e-9, 0, 0, 0))


def lone_wheel(section, mass=2.0, inertia=None, **more):
    """Return a single free wheel."""
    wheel = sf.Wheel("w", "platform", (0, 0, 0), section, driven=False, mass=mass, inertia=inertia)
    return sf.Vehicle("wheel", (), (), (replace(wheel, **more),), LIGHT)


def pendulum():
    """Return two bodies on a platform with joints about skew axes, and one wheel."""
    coordinates = tuple(sf.Coordinate(name, "passive", f"coordinate {name}") for name in "abc")
    first = sf.Body(1.0, (0.0, 0.3, -0.1), (0.02, 0.03, 0.04, 0.001, 0.002, -0.003))
    joints = (
        sf.Joint("A", "platform", "x", (0, 0, 0), "a", body=first),
        sf.Joint(
            "B", "A", (0.3, 1, 0.2), (0, 0.5, 0), "b - 0.3*a", body=sf.Body(0.7, (0.1, 0, -0.4))
        ),
        sf.Joint("C", "B", "z", (0.1, 0.2, 0), "c + 0.1*c**2", "slide", sf.Body(0.3, (0, 0, 0.1))),
    )
    wheel = sf.Wheel("w", "C", (0.1, 0, 0.2), Torus(0.03, 0.12), driven=False, mass=0.5)
    return sf.Vehicle("pendulum", coordinates, joints, (wheel,), sf.Body(1.0))


def test_a_tumbling_vehicle_keeps_its_energy_and_falls_freely():
    model = replace(sf.dynamics(pendulum(), FLAT), limits=(), checks=())
    start = states(
        model,
        z=60.0,
        velocity_x=0.7,
        velocity_y=-0.4,
        omega_x=0.3,
        omega_y=-0.2,
        omega_z=0.5,
        a_rate=2.0,
        b_rate=-3.0,
        c_rate=0.4,
        **{"spin[w]": 20.0},
    )
    t = np.linspace(0, 3, 31)
    run = moved(model, start, t, 1e-10)
    exchanged = np.ptp(run["kinetic_energy"])
    assert exchanged > 1000
    assert np.abs(energy_error(run)).max() < 1e-8 * exchanged
    norm = sum(run[f"attitude_{axis}"] ** 2 for axis in "wxyz")
    assert np.abs(norm - 1).max() < 2e-9  # 20 tolerances
    # the centre of mass is in free fall: potential energy is that of a parabola
    height = run["potential_energy"] / (3.5 * EARTH_GRAVITY)
    fall = np.polyfit(t, height, 2)
    assert fall[0] == pytest.approx(-EARTH_GRAVITY / 2, rel=2e-9)  # 20 tolerances
    assert np.abs(height - np.polyval(fall, t)).max() < 1e-8


def test_headings_count_whole_turns():
    model = sf.dynamics(sf.catalog.rigid_skid_steer(), FLAT)
    left, right = (
        {f"{end}_{side}_rate": rate for end in ("front", "rear")}
        for side, rate in (("left", -4.0), ("right", 4.0))
    )
    start = sf.settle(model, heading=3.0)
    run = sf.simulate(model, start, model.inputs(**left, **right), np.linspace(0, 4, 41))
    assert run["heading"][-1] > 4
    assert np.abs(np.diff(run["heading"])).max() < 0.5


@pytest.mark.parametrize(
    ("section", "inertia"),
    [(Sphere(0.1), (0.4 * 2 * 0.01, 0.4 * 2 * 0.01)), (Torus(0.03, 0.12), None)],
    ids=["ball", "torus"],
)
def test_a_wheel_rolls_down_with_the_acceleration_of_the_closed_form(section, inertia):
    vehicle, angle = lone_wheel(section, inertia=inertia), np.deg2rad(15)
    radius, axial = vehicle.wheels[0].radius, inertia[0] if inertia else 0.5 * 2 * 0.15**2
    expected = EARTH_GRAVITY * np.sin(angle) / (1 + axial / (2 * radius**2))
    errors = []
    for creep in (1e-2, 1e-3):
        model = sf.dynamics(vehicle, slope(15, 0.8), law=sf.Compliant(creep=creep))
        depth = radius / 50 * np.cos(angle)  # one wheel: no exact closure
        start = states(model, z=(radius - depth) / np.cos(angle))
        run = moved(model, start, np.linspace(0, 2, 3))
        errors.append(1 - np.hypot(run["velocity_y"], run["velocity_z"])[-1] / 2 / expected)
    # creep delays the rotation: an error proportional to the creep, 7.6e-6 at 1 mm/s in the lab
    assert abs(errors[1]) < 3e-5
    assert errors[1] / errors[0] == pytest.approx(0.1, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lean", "rho", "section"), [(35, 0.3, Torus(0.03, 0.12)), (20, 0.8, Disc(0.15))]
)
def test_a_leaning_wheel_rolls_on_a_circle(lean, rho, section):
    mass, b = 2.0, np.deg2rad(lean)
    r1, r2 = (section.r1, section.r2) if isinstance(section, Torus) else (0.0, 0.15)
    axial, across = 0.5 * mass * 0.15**2, 0.25 * mass * 0.15**2
    # steady precession: balance of moments about the contact
    spin = (rho + r2 * np.sin(b)) / (r1 * np.cos(b) + r2) - np.sin(b)
    swing = (r1 + r2 * np.cos(b)) * mass * rho
    swing += np.cos(b) * (axial * spin + across * np.sin(b))
    omega = np.sqrt(mass * EARTH_GRAVITY * r2 * np.sin(b) / swing)
    depth = 1e-5
    vehicle = lone_wheel(section, mass, (axial, across), static_depth=depth)
    model = sf.dynamics(vehicle, replace(FLAT, mu=1.0), law=sf.Compliant(creep=1e-4))
    start = states(
        model,
        x=rho,
        z=r1 + r2 * np.cos(b) - depth,
        attitude_w=np.cos(b / 2),
        attitude_y=-np.sin(b / 2),
        velocity_y=omega * rho,
        omega_z=omega,
        **{"spin[w]": omega * spin},
    )
    turns = 3 * 2 * np.pi / omega
    run = moved(model, start, np.linspace(0, turns, 61))
    angle = np.unwrap(np.arctan2(run["y"], run["x"]))[-1]
    assert angle / (6 * np.pi) == pytest.approx(1, abs=4e-4)
    assert np.abs(np.rad2deg(run["roll"]) + lean).max() < 0.01


def test_locked_wheels_stop_a_car_in_the_distance_of_coulomb_friction():
    model = sf.dynamics(
        four_wheels(static_depth=1e-4), replace(FLAT, mu=0.5), law=sf.Compliant(creep=1e-4)
    )
    zero = dict.fromkeys(model.input_names, 0 * model.t)  # inputs may be expressions
    run = moved(model, sf.settle(model, speed=4.0), np.linspace(0, 2, 5), **zero)
    # 1 ms until the wheels are locked, and pitch: 5e-5 in the lab for wheels locked at once
    assert run["y"][-1] == pytest.approx(4.0**2 / (2 * 0.5 * EARTH_GRAVITY), rel=1e-3)
    assert run["velocity_y"][-1] == pytest.approx(0, abs=1e-6)


def test_a_braking_car_pitches_as_its_springs_yield():
    spring = 4000.0
    vehicle = four_wheels(spring=spring, static_depth=1e-4)
    model = sf.dynamics(vehicle, replace(FLAT, mu=0.5))
    run = moved(model, sf.settle(model, speed=12.0), np.array([0, 2.0, 2.2, 2.3]), 1e-8)
    loads, slowing = run["force_normal"][-1], np.diff(run["velocity_y"])[-1] / 0.1
    assert slowing == pytest.approx(-0.5 * EARTH_GRAVITY, rel=1e-4)
    # the centre of mass moves ahead over the contacts as the car pitches
    lever = center_height(vehicle, 0.25)
    transfer = vehicle.mass * 0.5 * EARTH_GRAVITY * lever / 0.7
    assert loads[:2].sum() - loads[2:].sum() == pytest.approx(2 * transfer, rel=0.03)
    assert run["pitch"][-1] == pytest.approx(-transfer / (spring * 0.7), rel=0.01)


@pytest.mark.slow
def test_an_ideal_rate_equals_a_stiff_controller_in_a_fast_turn():
    loads, yaw_rates = [], []
    for drive in ({}, {"drive": sf.Motor(stall=1e6, no_load=1e6, kp=1e4)}):
        vehicle = four_wheels(inertia=(0.08, 0.04), static_depth=1e-4, **drive)
        model = sf.dynamics(vehicle, replace(FLAT, mu=1.2))
        rates = {
            label.full: ca.tanh(model.t) * 2 / 0.15 * share
            for label, share in zip(model.labels.u.wheels, (0.7, 1.3, 0.7, 1.3), strict=True)
        }
        run = moved(model, sf.settle(model), np.linspace(0, 5, 6), 1e-8, **rates)
        loads.append(run["force_normal"][-1])
        yaw_rates.append(run["omega_z"][-1])
    assert abs(yaw_rates[0]) > 0.5
    assert yaw_rates[0] == pytest.approx(yaw_rates[1], rel=1e-3)
    assert np.abs(loads[0] - loads[1]).max() < 0.1


@pytest.mark.slow
def test_a_lone_ridge_after_a_steady_drive_is_not_passed_over():
    """In steady motion steps would grow until one covers the whole ridge, with an error of 18 J."""
    crest, vehicle = 6.0, sf.catalog.rigid_skid_steer()
    vehicle = replace(vehicle, wheels=tuple(replace(w, drive=sf.Torque()) for w in vehicle.wheels))
    ground = sf.Analytic(lambda x, y: 0.02 * ca.exp(-(((y - crest) / 0.1) ** 2)) + 0 * x, mu=0.8)
    model = sf.dynamics(vehicle, ground)
    inputs = model.inputs(**{label.full: 0.5 for label in model.labels.u.wheels})
    run = sf.simulate(
        model, sf.settle(model), inputs, np.linspace(0, 9, 301), options=sf.SolverOptions(1e-6)
    )
    assert run["y"][-1] > crest + 0.5
    assert np.ptp(run["z"]) > 0.009  # half the height of the ridge, under two of four wheels
    assert np.abs(energy_error(run)).max() < 1e-2


@pytest.mark.slow
def test_a_jacobian_without_inertial_terms_changes_neither_motion_nor_cost():
    waves = sf.Analytic(lambda x, y: 0.02 * ca.sin(8 * y) * ca.cos(6 * x), mu=0.8)
    held = sf.dynamics(four_wheels(spring=4e3), waves)
    rates = {label.full: 1.0 / 0.15 for label in held.labels.u.wheels}
    start, t = sf.settle(held), np.linspace(0, 1, 11)
    runs = [moved(model, start, t, 1e-8, **rates) for model in (held, replace(held, held=None))]
    for name in ("x", "y", "z"):
        assert np.abs(runs[0][name] - runs[1][name]).max() < 1e-7
    counts = [[run.statistics[name] for name in ("steps", "residuals")] for run in runs]
    assert_allclose(counts[0], counts[1], rtol=0.15)


def test_the_mass_matrix_is_the_hessian_of_the_kinetic_energy():
    vehicle = pendulum()
    model = sf.dynamics(vehicle, FLAT)
    x, lookups = model.columns()[0], model.lookups
    rng, speeds = np.random.default_rng(2), slice(10, 20)
    point = rng.uniform(-1, 1, x.numel())
    point[3:7] /= np.linalg.norm(point[3:7])
    kinetic = model.y.kinetic_energy
    assert not any(ca.depends_on(kinetic, each.found) for each in lookups)
    hessian = ca.Function("hessian", [x], [ca.hessian(kinetic, x)[0]])
    by_energy = np.array(hessian(point))[speeds, speeds]
    names = [c.name for c in vehicle.coordinates]
    body = multibody(
        vehicle,
        Pose(rotation_of(x[3:7]), x[:3]),
        dict(zip(names, model.x.joints, strict=True)),
        Speeds(x[10:13], x[13:16], x[16:19], (x[19],)),
    )
    matrix = np.array(ca.Function("matrix", [x], [mass_matrix(body)])(point))
    np.testing.assert_allclose(matrix, by_energy[:9, :9], rtol=0, atol=1e-13 * np.abs(matrix).max())


def test_a_wheel_in_the_air_has_no_second_contact():
    """Beside a bump that a wheel put down onto the ground would touch."""
    bump = sf.Analytic(lambda x, y: 0.2 * ca.exp(-(((y - 0.22) / 0.05) ** 2)) + 0 * x, mu=0.8)
    model = sf.dynamics(lone_wheel(Torus(0.03, 0.12)), bump)
    run = states(model, z=0.45)
    assert run["depth"][0, 0] < 0
    assert run["clearance"].min() > 0


@pytest.mark.slow
def test_the_stable_poses_of_a_rigid_vehicle_are_found():
    hollow = sf.Analytic(lambda x, y: 0.03 * ca.cos(7 * x) * ca.cos(7 * y), mu=0.8)
    vehicle = sf.catalog.rigid_skid_steer()
    poses = stable_poses(sf.dynamics(vehicle, hollow), x=0.1, y=0.2)
    others = stable_poses(sf.direct_kinematics(vehicle, hollow), x=0.1, y=0.2)
    assert len(poses) == len(others)
    for pose, other in zip(poses, others, strict=True):
        assert pose["roll"][0] == pytest.approx(other["roll"][0], abs=2e-3)


def test_a_motor_stalls_at_its_torque_and_recovers():
    motor = sf.Motor(stall=2.0, no_load=20.0, kp=5.0, ki=20.0, rotor_inertia=0.01)
    model = sf.dynamics(four_wheels(drive=motor, static_depth=1e-4), FLAT)
    rates = {label.full: 5.0 for label in model.labels.u.wheels}
    run = moved(model, sf.settle(model), np.linspace(0, 8, 81), 1e-7, **rates)
    torque, rate = run["drive_torque"], run["wheel_rate"]
    available = 2.0 * np.minimum(1, 1 - rate / 20.0)
    assert (torque <= available + 1e-9).all()
    assert torque.max() == pytest.approx(2.0, rel=1e-3)
    assert rate[-1] == pytest.approx(5.0, rel=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("section", [Disc(0.12), Sphere(0.12)])
def test_discs_and_balls_stand_on_maps(section):
    x = np.linspace(-1, 1, 21)
    plane = sf.Bicubic(sf.Grid(x, x, 0.1 * np.add.outer(x, 0 * x)), mu=0.8)
    vehicle = sf.catalog.rigid_skid_steer()
    wheels = tuple(replace(wheel, section=section) for wheel in vehicle.wheels)
    load = sf.settle(sf.dynamics(replace(vehicle, wheels=wheels), plane))["force_normal"].sum()
    assert load == pytest.approx(vehicle.weight * np.cos(np.arctan(0.1)), rel=1e-3)


def test_a_coordinate_without_mass_is_refused():
    words = "coordinate 'press_rear': expected a part or a wheel with mass"
    refuses(sf.ModelError, words, sf.dynamics, sf.catalog.seven_wheels(), FLAT)
    model = sf.dynamics(sf.catalog.seven_wheels(wheel_mass=0.4), FLAT)
    rates = {label.full: 1.0 for label in model.labels.u.wheels if "across" not in label.full}
    run = moved(model, sf.settle(model), np.linspace(0, 1, 3), 1e-6, **rates)
    assert run["y"][-1] == pytest.approx(0.066, abs=2e-3)


# Dynamics beyond kinematics (tip-over, flight, spinning wheels), and of agreement


@pytest.mark.slow
def test_inside_wheels_lift_at_the_speed_of_the_closed_form():
    """``v^2 (h + sum I_a / (m R)) = g r b (1 - 2 s)`` for the share s of the inside wheels."""
    radius, half_track, wheel, axial = 2.0, 0.3, 0.15, 0.5 * 2.0 * 0.15**2
    vehicle = four_wheels(mass=40.0, height=0.4, turn=radius, static_depth=1e-4)
    model = sf.dynamics(vehicle, replace(FLAT, mu=3.0))
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
    run = moved(model, sf.settle(model), np.linspace(0, 5, 101), 1e-7, **rates)
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


HILLS = sf.Analytic(
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
    run = moved(model, sf.settle(model), np.linspace(0, 1.3 / speed, 3), 1e-7, **rates)
    return np.array([run["x"][-1], run["y"][-1]])


@pytest.mark.slow
def test_the_difference_from_quasi_statics_is_of_second_order_in_the_speed():
    """About 0.025 m over 1 m at 0.8 m/s, besides what the depth of the wheels shifts it by."""
    vehicle, apart = sf.catalog.skid_steer(), []
    for speed in (0.8, 0.4, 0.2):
        still = sf.quasi_statics(vehicle, HILLS, law=sf.Coulomb(creep=0.01 * speed))
        moving = sf.dynamics(vehicle, HILLS, law=sf.Compliant(creep=0.01 * speed))
        apart.append(turned(moving, speed) - turned(still, speed))
    assert 0.02 < np.linalg.norm(apart[0]) < 0.03
    fast, slow = np.linalg.norm(np.diff(apart, axis=0), axis=1)
    assert fast / slow == pytest.approx(4, rel=0.1)


def test_one_wheel_on_ice_spins_up():
    """Its spin is that of the torque and of the friction under its load."""
    patch = sf.Analytic(
        lambda x, y: np.tan(np.deg2rad(8)) * y + 0 * x,
        mu=lambda x, y: (
            0.7 - 0.17 * (1 + ca.tanh((x - 0.1) / 0.02)) * (1 + ca.tanh((y - 0.4) / 0.02))
        ),
    )
    model = sf.dynamics(four_wheels(drive=sf.Torque(), static_depth=1e-4), patch)
    torques = {label.full: 2.8 for label in model.labels.u.wheels}
    run = moved(model, sf.settle(model), np.linspace(0, 1, 101), 1e-7, **torques)
    spin, axial = run["wheel_rate", "w0"], 0.5 * 2.0 * 0.15**2
    moment = 2.8 - 0.02 * 0.15 * run["force_normal", "w0"]
    gain = np.trapezoid(moment, run.t) / axial
    assert spin[-1] == pytest.approx(gain, rel=1e-4)
    # without the fourth wheel's pull the car rolls back
    assert run["velocity_y"][-1] < 0
    assert np.abs(run["wheel_rate"][-1, 1:] * 0.15 - run["velocity_y"][-1]).max() < 5e-3


# Drives of commanded coordinates in dynamics: closed forms, energy, motors, errors

MOTOR = sf.Motor(stall=6.0, no_load=4.0, kp=40.0, ki=80.0, rotor_inertia=0.3)
CENTERED = sf.Body(3.0, inertia=(0.2, 0.3, 0.4, 0.0, 0.0, 0.0))


def two_bodies(motion, drive):
    """Return a platform with wheel and an arm, with all centres of mass on the arm's axis."""
    arm = sf.Coordinate("arm", "commanded", "arm", drive=drive)
    joint = sf.Joint("boom", "platform", "z", (0, 0, 0.3), "arm", motion, CENTERED)
    wheel = sf.Wheel(
        "w", "platform", (0, 0, -0.2), Torus(0.03, 0.12), driven=False, mass=2.0, inertia=(0.1, 0.1)
    )
    body = sf.Body(5.0, inertia=(0.5, 0.6, 0.7, 0.0, 0.0, 0.0))
    return sf.Vehicle("two bodies", (arm,), (joint,), (wheel,), body)


def with_arm(drive, axis="x", **more):
    """Return a car with an arm of 4 kg."""
    arm = sf.Coordinate("arm", "commanded", "arm", drive=drive, **more)
    body = sf.Body(4.0, (0.0, 0.3, 0.05), (0.03, 0.01, 0.03, 0.0, 0.0, 0.0))
    joint = sf.Joint("boom", "platform", axis, (0.0, 0.35, 0.3), "arm", body=body)
    return replace(four_wheels(), coordinates=(arm,), joints=(joint,))


@pytest.mark.parametrize("motion", ["turn", "slide"])
def test_an_effort_accelerates_two_bodies_in_free_fall(motion):
    """Relative motion has the reduced inertia, whatever the attitude and gravity."""
    first, second = (0.4, 0.7 + 0.1) if motion == "turn" else (3.0, 5.0 + 2.0)
    name = "arm_torque" if motion == "turn" else "arm_force"
    model = replace(sf.dynamics(two_bodies(motion, sf.Torque()), FLAT), limits=(), checks=())
    label = model.labels.u.joints[0]
    assert (label.full, label.unit) == (name, "N m" if motion == "turn" else "N")
    t = np.linspace(0, 1, 6)
    run = moved(model, states(model, z=60.0), t, 1e-10, **{name: 0.9})
    expected = 0.9 * (1 / first + 1 / second)
    assert run["arm_speed"] == pytest.approx(expected * t, rel=1e-8)
    assert run["arm"] == pytest.approx(expected * t**2 / 2, rel=1e-8)
    assert run["work"][-1] == pytest.approx(0.9 * expected / 2, rel=1e-8)


@pytest.mark.parametrize("motion", ["turn", "slide"])
def test_a_motor_at_its_limit_approaches_its_no_load_rate(motion):
    first, second = (0.4, 0.7 + 0.1) if motion == "turn" else (3.0, 5.0 + 2.0)
    motor = sf.Motor(stall=0.8, no_load=2.0, kp=1e3, rotor_inertia=0.25)
    model = replace(sf.dynamics(two_bodies(motion, motor), FLAT), limits=(), checks=())
    t = np.linspace(0, 2, 11)
    run = moved(model, states(model, z=60.0), t, 1e-10, arm_rate=50.0)
    inertia = first * second / (first + second) + 0.25
    expected = 2.0 * (1 - np.exp(-0.8 * t / (2.0 * inertia)))
    assert run["arm_speed"] == pytest.approx(expected, rel=1e-7)
    kinetic = run["kinetic_energy"] + run["potential_energy"]
    assert kinetic - kinetic[0] == pytest.approx(run["work"], abs=1e-7)
    assert run["work"][-1] == pytest.approx(inertia * expected[-1] ** 2 / 2, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("drive", [sf.Torque(), replace(MOTOR, stall=20.0)])
def test_the_energy_balance_contains_drives_springs_and_dampers_of_joints(drive):
    loads = {"stiffness": 20.0, "rest": 0.2, "damping": 0.4, "upper": 0.1, "bump": 400.0}
    model = sf.dynamics(with_arm(drive, **loads), FLAT)
    law = {model.labels.u.joints[0].full: 12.0 * ca.cos(3 * model.t)}
    run = moved(model, sf.settle(model), np.linspace(0, 1.5, 16), 1e-8, **law)
    assert np.abs(run["work"]).max() > 0.5
    assert run["arm"].max() > 0.11
    exchanged = np.abs(run["work"]).max() + run["lost_energy"][-1]
    assert np.abs(energy_error(run)).max() < 100 * 1e-8 * exchanged


@pytest.mark.slow
def test_a_prescribed_rate_equals_a_stiff_motor():
    """Of an arm with an eccentric mass, which a car swings to and fro."""
    stiff, t = sf.Motor(stall=1e6, no_load=1e6, kp=1e5), np.linspace(0, 2, 41)
    runs = []
    for drive in (RATE, stiff):
        model = sf.dynamics(with_arm(drive), FLAT)
        law = {"arm_rate": ca.sin(2 * np.pi * model.t)}
        runs.append(moved(model, sf.settle(model), t, 1e-8, **law))
    prescribed, motor = runs
    assert np.ptp(prescribed["force_normal"][:, 0]) > 5
    # prescribed rates lag by 1 ms
    bounds = {"arm": 1.5e-3, "pitch": 5e-6, "force_normal": 0.1, "arm_torque": 0.1}
    for name, bound in bounds.items():  # the motor has no torque at the start
        assert np.abs(prescribed[name] - motor[name])[1:].max() < bound, name


@pytest.mark.slow
def test_quasi_statics_uses_the_rate_and_its_actuator_bears_spring_and_damper():
    """The torque at a rate is that of the rigid arm, less spring and damper."""
    ground, t = sf.Analytic(lambda x, y: 0.02 * x * y, mu=0.8), np.linspace(0, 1, 3)
    vehicle, torques = sf.catalog.articulated(), []
    (name,) = (c.name for c in vehicle.of("commanded"))
    for loads in ({}, {"drive": MOTOR, "stiffness": 30.0, "rest": 0.1, "damping": 2.0}):
        bend = tuple(replace(c, **loads) if c.name == name else c for c in vehicle.coordinates)
        model = sf.quasi_statics(replace(vehicle, coordinates=bend), ground)
        run = moved(model, sf.settle(model), t, 1e-8, **{f"{name}_rate": 0.2})
        torques.append(run[f"{name}_torque"])
    load = 30.0 * (run[name] - 0.1) + 2.0 * 0.2
    assert torques[1] - torques[0] == pytest.approx(load, abs=1e-6)


def test_drives_that_do_not_fit_are_refused():
    words = r"since its rate is an input.*or use a drive with an eff"
    refuses(sf.ModelError, words, sf.Coordinate, "c", "commanded", "c", stiffness=1.0)
    vehicle = sf.catalog.ackermann()
    free = (
        replace(c, drive=sf.Torque()) if c.kind == "commanded" else c for c in vehicle.coordinates
    )
    model = sf.dynamics(replace(vehicle, coordinates=tuple(free)), FLAT)
    path = sf.Path(np.array([[0.0, 0.0], [0.0, 1.0]]))
    with pytest.raises(sf.ModelError, match=r"commanded coordinates as inputs, found steer_torque"):
        sf.follow(model, path, speed=0.5)


EARTH, MOON, MASS = 9.81, 1.62, 48.0  # [m/s2], [kg]
RADIUS, LENGTH = 0.15, 0.7  # of the wheels; between the axles [m]
CENTER = 0.35, 0.1 * 40 / MASS  # of mass: ahead of the rear axle, above it [m]
AXLE, POINT = MASS * EARTH / 2 / 1e-3, MASS * EARTH / 2e-3  # stiffness of two wheels, a point [N/m]
KEEL, BELLY = 0.02, 0.08  # below the axles [m]


def model_of(shape, heights, gravity=EARTH, make=sf.dynamics, **law):
    """Return a model of a car with a shape; gravity does not change the stiffness of its wheels."""
    vehicle = four_wheels(static_depth=MASS * EARTH / 2 / AXLE)
    vehicle = replace(vehicle, body=replace(vehicle.body, shapes=(shape,)))
    return make(sf.in_gravity(vehicle, gravity), sf.Analytic(heights, mu=0.3), **law)


def at_rest(shape, heights, height, gravity):
    """Return the rest of a car that is dropped from a height of its axles."""
    law = sf.Compliant(body_depth=MASS * gravity / POINT)
    model = model_of(shape, heights, gravity, law=law)
    run = moved(model, states(model, z=height), np.linspace(0, 6, 3), 1e-8)
    assert run["kinetic_energy"][-1] < 1e-12
    return run


def on_ridge(place, rise, gravity):
    """Return the rest of a car on a ridge along it that is ``rise`` above its level keel."""
    keel, top = Hull(((0.0, place, -KEEL),)), RADIUS - KEEL + rise
    height = RADIUS + max(rise, 0) + 1e-3
    return at_rest(keel, lambda x, y: top * ca.exp(-((x / 0.05) ** 2)) + 0 * y, height, gravity)


def keel_load(place, rise, gravity):
    """Load of the keel while all wheels touch, of a beam on three springs [N]."""
    b, c = place / LENGTH, CENTER[0] / LENGTH
    # the keel touches first at a negative rise, since the springs of the wheels give way
    onset = -MASS * gravity / AXLE * ((1 - b) * (1 - c) + b * c)
    return (rise - onset) / (1 / POINT + ((1 - b) ** 2 + b**2) / AXLE)


def rest_loads(place, rise, gravity):
    """Loads of rear axle, front axle and keel by own balances, with the arms of a pitched car."""

    def forces_and_arms(unknowns):
        z, pitch = 1e-3 * unknowns  # from level wheels that just touch
        c, s = np.cos(pitch), np.sin(pitch)
        depths = [-z, -z - LENGTH * s, rise - z - place * s + KEEL * (c - 1)]
        arms = [0, LENGTH * c, place * c + KEEL * s]
        return np.maximum(depths, 0) * [AXLE, AXLE, POINT], arms, CENTER[0] * c - CENTER[1] * s

    def unbalance(unknowns):
        forces, arms, middle = forces_and_arms(unknowns)
        return np.array([forces.sum(), forces @ arms]) / (MASS * gravity) - [1, middle]

    # leaning on the keel and on the axle on the other side of the weight, all a little pressed
    lean, up = 1e3 * max(rise, 0), place < CENTER[0]
    start = (
        [lean * LENGTH / (LENGTH - place), -lean / (LENGTH - place)] if up else [0, lean / place]
    )
    return forces_and_arms(root(unbalance, start - np.array([0.1, 0]))[0])[0]


@pytest.mark.parametrize("gravity", [EARTH, MOON])
@pytest.mark.parametrize(
    ("place", "rise", "lifts"),
    [(0.2, -5e-5, False), (0.45, 1e-5, False), (0.2, 0.02, True), (0.5, 0.03, True)],
)
def test_a_keel_on_a_ridge_bears_its_share(place, rise, lifts, gravity):
    """Loads by statics; after an axle has lifted off, the lever rule holds on earth and moon."""
    run, weight = on_ridge(place, rise, gravity), MASS * gravity
    rear, front, keel = rest_loads(place, rise, gravity)
    loads = run["force_normal"][-1]
    assert run["body_load"][-1] == pytest.approx(keel, abs=1e-5 * weight)
    assert [loads[2:].sum(), loads[:2].sum()] == pytest.approx([rear, front], abs=1e-5 * weight)
    assert (min(rear, front) == 0) == lifts
    if lifts:  # of a car that is almost level
        axle = 0 if place > CENTER[0] else LENGTH
        assert keel / weight == pytest.approx((CENTER[0] - axle) / (place - axle), rel=0.02)
    else:
        assert keel == pytest.approx(keel_load(place, rise, gravity), rel=1e-3)


def crest(radius):
    """Return the heights of a crest along x, a cylinder whose top is at zero."""
    return lambda x, y: ca.sqrt(radius**2 - (y - CENTER[0]) ** 2) - radius + 0 * x


FLAT_BELLY = Box((0.4, 0.5, 0.2), at=(0.0, CENTER[0], 0.1 - BELLY))
# (radius + RADIUS)^2 = (LENGTH / 2)^2 + (radius + BELLY)^2, if axles and belly touch the crest
LEAST = ((LENGTH / 2) ** 2 + BELLY**2 - RADIUS**2) / (2 * (RADIUS - BELLY))  # radius [m]


def crest_loads(z, radius):
    """Loads of wheels and belly with the axles at a height, three points of the belly on top."""
    away = np.hypot(LENGTH / 2, z + radius)
    wheels = 2 * AXLE * max(radius + RADIUS - away, 0) * (z + radius) / away
    return np.array([wheels, 3 * POINT * max(BELLY - z, 0)])


def crest_height(radius, gravity, bearing):
    """Height of the axles over a crest at rest, with or without the load of the belly [m]."""
    weight = MASS * gravity
    return brentq(lambda z: crest_loads(z, radius) @ [1, bearing] - weight, 0, RADIUS, xtol=1e-12)


@pytest.mark.parametrize("gravity", [EARTH, MOON])
@pytest.mark.parametrize(
    ("make", "share"),
    [
        (sf.dynamics, 2e-4),
        (sf.direct_kinematics, 1e-2),
    ],  # the law of the load is smoother in the second
)
def test_the_breakover_of_a_crest_has_its_closed_form(make, share, gravity):
    """The clearance over the top up to a share of the depth, and the radius at which it is zero."""
    first = brentq(lambda r: crest_height(r, gravity, False) - BELLY, LEAST, 2 * LEAST)
    depth = MASS * gravity / AXLE / 2
    for radius in (first + 1e-4, 1.0, 3.0):
        start = sf.settle(model_of(FLAT_BELLY, crest(radius), gravity, make))
        clearance = crest_height(radius, gravity, False) - BELLY
        assert start["clearance_body"][0] == pytest.approx(clearance, abs=share * depth)
    assert first == pytest.approx(LEAST, rel=0.02)
    with pytest.raises(sf.ModelError, match="the platform touches the ground"):
        sf.settle(model_of(FLAT_BELLY, crest(first - 1e-4), gravity, make))


@pytest.mark.parametrize("gravity", [EARTH, MOON])
@pytest.mark.parametrize("beyond", [-1e-3, 0.0, 0.05])
def test_a_belly_on_a_crest_bears_its_share(beyond, gravity):
    """The wheels push obliquely from both sides."""
    radius = LEAST + beyond
    run, z = at_rest(FLAT_BELLY, crest(radius), 0.1, gravity), crest_height(radius, gravity, True)
    load = crest_loads(z, radius)[1]
    assert run["z"][-1] == pytest.approx(z, abs=1e-7)
    assert run["body_load"][-1] == pytest.approx(load, abs=1e-4 * MASS * gravity)
    assert (load > 0) == (beyond < 0.01)
