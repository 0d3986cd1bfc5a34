"""Tests of drives of commanded coordinates in dynamics: closed forms, energy, motors, errors."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from helpers.dynamics import FLAT, energy_error, four_wheels, moved, states
from slipfree import Analytic, ModelError, catalog, follow, quasi_statics, settle
from slipfree.geometry.path import Path
from slipfree.models.dynamics import dynamics
from slipfree.vehicle.drives import RATE, Motor, Torque
from slipfree.vehicle.sections import Torus
from slipfree.vehicle.tree import Body, Coordinate, Joint, Vehicle
from slipfree.vehicle.wheel import Wheel

MOTOR = Motor(stall=6.0, no_load=4.0, kp=40.0, ki=80.0, rotor_inertia=0.3)
CENTERED = Body(3.0, inertia=(0.2, 0.3, 0.4, 0.0, 0.0, 0.0))


def two_bodies(motion, drive):
    """Return a platform with wheel and an arm, with all centres of mass on the arm's axis."""
    arm = Coordinate("arm", "commanded", "arm", drive=drive)
    joint = Joint("boom", "platform", "z", (0, 0, 0.3), "arm", motion, CENTERED)
    wheel = Wheel(
        "w", "platform", (0, 0, -0.2), Torus(0.03, 0.12), driven=False, mass=2.0, inertia=(0.1, 0.1)
    )
    body = Body(5.0, inertia=(0.5, 0.6, 0.7, 0.0, 0.0, 0.0))
    return Vehicle("two bodies", (arm,), (joint,), (wheel,), body)


def with_arm(drive, axis="x", **more):
    """Return a car with an arm of 4 kg."""
    arm = Coordinate("arm", "commanded", "arm", drive=drive, **more)
    body = Body(4.0, (0.0, 0.3, 0.05), (0.03, 0.01, 0.03, 0.0, 0.0, 0.0))
    joint = Joint("boom", "platform", axis, (0.0, 0.35, 0.3), "arm", body=body)
    return replace(four_wheels(), coordinates=(arm,), joints=(joint,))


def imbalance(run):
    """Return the largest error of the energy balance over the energy exchanged."""
    return np.abs(energy_error(run)).max() / (np.abs(run["work"]).max() + run["lost_energy"][-1])


@pytest.mark.parametrize("motion", ["turn", "slide"])
def test_an_effort_accelerates_two_bodies_in_free_fall(motion):
    """Relative motion has the reduced inertia, whatever the attitude and gravity."""
    first, second = (0.4, 0.7 + 0.1) if motion == "turn" else (3.0, 5.0 + 2.0)
    name = "arm_torque" if motion == "turn" else "arm_force"
    model = replace(dynamics(two_bodies(motion, Torque()), FLAT), limits=(), checks=())
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
    motor = Motor(stall=0.8, no_load=2.0, kp=1e3, rotor_inertia=0.25)
    model = replace(dynamics(two_bodies(motion, motor), FLAT), limits=(), checks=())
    t = np.linspace(0, 2, 11)
    run = moved(model, states(model, z=60.0), t, 1e-10, arm_rate=50.0)
    inertia = first * second / (first + second) + 0.25
    expected = 2.0 * (1 - np.exp(-0.8 * t / (2.0 * inertia)))
    assert run["arm_speed"] == pytest.approx(expected, rel=1e-7)
    kinetic = run["kinetic_energy"] + run["potential_energy"]
    assert kinetic - kinetic[0] == pytest.approx(run["work"], abs=1e-7)
    assert run["work"][-1] == pytest.approx(inertia * expected[-1] ** 2 / 2, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("drive", [Torque(), replace(MOTOR, stall=20.0)])
def test_the_energy_balance_contains_drives_springs_and_dampers_of_joints(drive):
    loads = {"stiffness": 20.0, "rest": 0.2, "damping": 0.4, "upper": 0.1, "bump": 400.0}
    model = dynamics(with_arm(drive, **loads), FLAT)
    law = {model.labels.u.joints[0].full: 12.0 * ca.cos(3 * model.t)}
    run = moved(model, settle(model), np.linspace(0, 1.5, 16), 1e-8, **law)
    assert np.abs(run["work"]).max() > 0.5
    assert run["arm"].max() > 0.11
    assert imbalance(run) < 100 * 1e-8


@pytest.mark.slow
def test_a_prescribed_rate_equals_a_stiff_motor():
    """Of an arm with an eccentric mass, which a car swings to and fro."""
    stiff, t = Motor(stall=1e6, no_load=1e6, kp=1e5), np.linspace(0, 2, 41)
    runs = []
    for drive in (RATE, stiff):
        model = dynamics(with_arm(drive), FLAT)
        law = {"arm_rate": ca.sin(2 * np.pi * model.t)}
        runs.append(moved(model, settle(model), t, 1e-8, **law))
    prescribed, motor = runs
    assert np.ptp(prescribed["force_normal"][:, 0]) > 5
    # prescribed rates lag by 1 ms
    bounds = {"arm": 1.5e-3, "pitch": 5e-6, "force_normal": 0.1, "arm_torque": 0.1}
    for name, bound in bounds.items():  # the motor has no torque at the start
        assert np.abs(prescribed[name] - motor[name])[1:].max() < bound, name


@pytest.mark.slow
def test_quasi_statics_uses_the_rate_and_its_actuator_bears_spring_and_damper():
    """The torque at a rate is that of the rigid arm, less spring and damper."""
    ground, t = Analytic(lambda x, y: 0.02 * x * y, mu=0.8), np.linspace(0, 1, 3)
    vehicle, torques = catalog.articulated(), []
    (name,) = (c.name for c in vehicle.of("commanded"))
    for loads in ({}, {"drive": MOTOR, "stiffness": 30.0, "rest": 0.1, "damping": 2.0}):
        bend = tuple(replace(c, **loads) if c.name == name else c for c in vehicle.coordinates)
        model = quasi_statics(replace(vehicle, coordinates=bend), ground)
        run = moved(model, settle(model), t, 1e-8, **{f"{name}_rate": 0.2})
        torques.append(run[f"{name}_torque"])
    load = 30.0 * (run[name] - 0.1) + 2.0 * 0.2
    assert torques[1] - torques[0] == pytest.approx(load, abs=1e-6)


def test_drives_that_do_not_fit_are_refused():
    with pytest.raises(ModelError, match="coordinate 'c': expected a drive only for kind = 'comm"):
        Coordinate("c", "passive", "c", drive=Torque())
    with pytest.raises(ModelError, match=r"since its rate is an input.*or use a drive with an eff"):
        Coordinate("c", "commanded", "c", stiffness=1.0)
    vehicle = catalog.ackermann()
    free = (replace(c, drive=Torque()) if c.kind == "commanded" else c for c in vehicle.coordinates)
    model = dynamics(replace(vehicle, coordinates=tuple(free)), FLAT)
    path = Path(np.array([[0.0, 0.0], [0.0, 1.0]]))
    with pytest.raises(ModelError, match=r"commanded coordinates as inputs, found steer_torque"):
        follow(model, path, speed=0.5)
