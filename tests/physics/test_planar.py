"""Tests of vehicles locked to a plane, and of models with a controller."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from slipfree import (
    Analytic,
    SolverOptions,
    catalog,
    direct_kinematics,
    dynamics,
    planar,
    quasi_statics,
    rigid_dynamics,
    settle,
    simulate,
)
from slipfree.control.step_climbing import ControlLaw, controlled
from slipfree.core.errors import ModelError
from slipfree.core.rearrange import new_variable
from slipfree.core.records import Label
from slipfree.geometry.frame import Pose
from slipfree.vehicle.drives import Motor, Torque

WAVES = Analytic(lambda _x, y: 0.05 * ca.sin(2 * y), mu=0.8)
TIGHT = SolverOptions(tolerance=1e-8)
T = np.linspace(0, 1.5, 16)


def driven(drive):
    vehicle = catalog.rigid_skid_steer()
    return replace(vehicle, wheels=tuple(replace(each, drive=drive) for each in vehicle.wheels))


@pytest.mark.slow
def test_a_planar_vehicle_moves_as_a_symmetric_one_in_space():
    """The ground does not vary along x; the start has no roll and no speed aside."""
    vehicle = catalog.rocky7()
    space, plane = dynamics(vehicle, WAVES), dynamics(planar(vehicle), WAVES)
    start, level = (settle(each, y=0.3, speed=0.5) for each in (space, plane))
    for name in ("z", "pitch", "velocity_y", "velocity_z"):
        assert_allclose(level[name], start[name], atol=1e-6, err_msg=name)
    rates = {label.full: 4.0 for label in space.labels.u.wheels}
    rates |= {label.full: 0.0 for label in space.labels.u.joints}
    run = simulate(space, start, space.inputs(**rates), T, options=TIGHT)
    same = simulate(plane, level, plane.inputs(**rates), T, options=TIGHT)
    assert (run.stop, same.stop) == (None, None)
    assert run["y"][-1] - run["y"][0] > 0.3
    for name in ("x", "y", "z", "heading", "roll", "pitch", "velocity_y", "omega_x"):
        assert_allclose(same[name], run[name], atol=2e-6, err_msg=name)
    assert_allclose(same["spin"], run["spin"], atol=2e-5)
    assert_allclose(same["contact_z"], run["contact_z"], atol=2e-6)


def test_the_tip_over_margin_of_a_planar_vehicle_is_that_of_its_ends():
    vehicle = planar(catalog.rigid_skid_steer())
    start = settle(dynamics(vehicle, FLAT), y=0.0)
    platform = Pose(ca.SX.eye(3), ca.SX([0, 0, start["z"][0]]))
    masses = [(mass, np.array(ca.evalf(at))) for _, mass, at in vehicle.masses(platform, {})]
    center = sum(mass * at for mass, at in masses).ravel() / vehicle.mass
    height = center[2] - start["contact_z"][0, 0]
    ends = start["contact_y"][0] - center[1]
    expected = np.arctan2([ends.max(), -ends.min()], height).min()
    assert_allclose(start["tip_over_margin"][0], expected, rtol=1e-9)


@pytest.mark.parametrize("model", [direct_kinematics, quasi_statics, rigid_dynamics])
def test_other_models_refuse_planar_vehicles(model):
    for vehicle in (catalog.three_wheeler(), catalog.rigid_skid_steer()):
        with pytest.raises(ModelError, match="found one locked to a plane; use "):
            model(planar(vehicle), WAVES)


def test_a_controller_of_torques_equals_the_motors_of_a_vehicle():
    """PI control of the rates: as states of a controller, and as drives of the wheels."""
    motors = dynamics(driven(Motor(stall=1e6, no_load=1e6, kp=3.0, ki=20.0)), FLAT)
    model = dynamics(driven(Torque()), FLAT)
    names = [wheel.name for wheel in catalog.rigid_skid_steer().wheels]
    sums = [new_variable(model, Label(f"sum_{name}", "N m", "integral")) for name in names]
    wanted = new_variable(model, Label("wanted", "rad s-1", "wanted rate"))
    errors = [wanted.symbol - rate for rate in model.y.common.wheel_rate]
    controller = ControlLaw(
        tuple(replace(s, rate=20.0 * error) for s, error in zip(sums, errors, strict=True)),
        (wanted,),
        tuple(3.0 * error + s.symbol for error, s in zip(errors, sums, strict=True)),
        ((Label("first_error", "rad s-1", "error of the first wheel"), errors[0]),),
    )
    closed = controlled(model, controller)
    rates = {label.full: 3.0 for label in motors.labels.u.wheels}
    run = simulate(motors, settle(motors), motors.inputs(**rates), T, options=TIGHT)
    same = simulate(closed, settle(closed), closed.inputs(wanted=3.0), T, options=TIGHT)
    for name in ("y", "z", "pitch", "work"):
        assert_allclose(same[name], run[name], atol=1e-5, err_msg=name)
    assert_allclose(same["first_error"], 3.0 - same["wheel_rate"][:, 0], atol=1e-12)


FLAT = Analytic(lambda x, _y: 0 * x, mu=0.8)


def test_a_controller_has_a_law_for_every_input():
    model = dynamics(driven(Torque()), FLAT)
    with pytest.raises(ModelError, match="expected 4 laws, one per input of the model, found 0"):
        controlled(model, ControlLaw((), (), (), ()))
