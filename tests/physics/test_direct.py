"""Tests of direct kinematics: a reference motion, closed forms, invariances, a locked plane."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import slipfree as sf
from helpers.cases import PAPER_RATES, case1, closure_model, drive, hills
from slipfree.catalog import three_wheeler
from slipfree.control.step_climbing import ControlLaw, controlled
from slipfree.core.rearrange import new_variable
from slipfree.core.records import Label
from slipfree.geometry.frame import Pose

MOTION = ("x", "y", "heading", "tilt_right", "tilt_left", "z", "roll", "pitch")
PLACES = ("contact_x", "contact_y")
WHEELS = ("right", "left", "front")
T = np.linspace(0, 6, 31)
TOLERANCE = 1e-10
ERROR = 100  # error of a 6 s run in units of the tolerance, as measured on the reference motion


GROUND, REFERENCE = case1()


def test_reference_motion():
    run = drive(GROUND, REFERENCE["t"], tolerance=1e-12)
    assert run.stop is None
    assert error(run, REFERENCE) < 2e-9
    for wheel in WHEELS:
        angle = run["wheel_angle", wheel]
        assert_allclose(angle, REFERENCE[f"theta_{wheel}"], rtol=0, atol=2e-9)
    assert np.abs([run["slip_along"], run["slip_across"]]).max() < 1e-12


def test_error_follows_the_tolerance():
    tolerances = np.array([1e-5, 1e-6, 1e-8, 1e-10])
    runs = [drive(GROUND, REFERENCE["t"], tolerance=each) for each in tolerances]
    errors = [error(run, REFERENCE) for run in runs]
    assert 0.5 < np.polyfit(np.log(tolerances), np.log(errors), 1)[0] < 1.1
    assert errors[2] < 2e-6
    assert errors[3] < 5e-8
    for run, tolerance in zip(runs, tolerances, strict=True):
        assert run["closure_residual"].max() < 1e-12
        assert run["least_slip_residual"].max() < 1e-12
        assert run["newton_step"].max() < 100 * tolerance
        assert run["singular_value"].min() > 1e-3


def error(run, expected, names=(*MOTION, *PLACES)):
    return max(np.abs(run[name] - expected[name]).max() for name in names)


def test_flat_ground_is_planar_kinematics():
    run = drive(sf.Analytic(lambda x, _: 0 * x), np.array([0.0, 0.1]))
    expected = {
        "velocity_x": 0.015,
        "velocity_y": 0.135,
        "velocity_z": 0.0,
        "heading_rate": 0.015,
        "tilt_right_rate": 0.075,
        "tilt_left_rate": 0.075,
        "front_rate": 0.45,
        "z": 0.3,
    }
    for name, value in expected.items():
        assert_allclose(run[name][0], value, rtol=0, atol=1e-10, err_msg=name)


def test_rolling_equals_least_slip_where_the_vehicle_can_roll():
    least = drive(sf.Analytic(hills), T, tolerance=TOLERANCE, heading=0.3)
    dae = closure_model(three_wheeler(), sf.Analytic(hills), slip=sf.Rolling())
    start, inputs = sf.settle(dae, heading=0.3), dae.inputs(**PAPER_RATES)
    rolling = sf.simulate(dae, start, inputs, T, options=sf.SolverOptions(tolerance=TOLERANCE))
    same_motion(rolling, least)
    assert rolling["no_slip_residual"].max() < 1e-14


def test_rates_are_the_derivatives_of_the_motion():
    t = np.linspace(0, 3, 601)
    run = drive(GROUND, t, tolerance=1e-11)
    pairs = [(f"velocity_{axis}", axis) for axis in "xyz"]
    pairs += [(f"{name}_rate", name) for name in ("heading", "roll", "pitch", "tilt_right")]
    for rate, value in pairs:
        differences = (run[value][2:] - run[value][:-2]) / (t[2:] - t[:-2])
        assert_allclose(run[rate][1:-1], differences, rtol=0, atol=2e-5, err_msg=rate)
    turned = np.trapezoid(run["wheel_rate", "front"], t)
    assert_allclose(run["wheel_angle", "front"][-1], turned, rtol=0, atol=2e-6)


def same_motion(run, expected, **moved):
    """Compare two runs after moving the expected one, in units of the tolerance."""
    for name in MOTION:
        want = moved.get(name, expected[name])
        assert_allclose(run[name], want, rtol=0, atol=ERROR * TOLERANCE, err_msg=name)


def test_the_motion_moves_with_the_ground():
    angle = 0.7
    c, s = np.cos(angle), np.sin(angle)
    moved = sf.Analytic(
        lambda x, y: hills(c * (x - 3) + s * (y + 2), c * (y + 2) - s * (x - 3)) + 5
    )
    still = drive(sf.Analytic(hills), T, tolerance=TOLERANCE)
    run = drive(moved, T, tolerance=TOLERANCE, x=3.0, y=-2.0, heading=angle)
    x, y = still["x"], still["y"]
    expected = {"x": c * x - s * y + 3, "y": s * x + c * y - 2, "z": still["z"] + 5}
    same_motion(run, still, heading=still["heading"] + angle, **expected)


def test_translation_of_a_map_by_kilometres():
    grid, t = GROUND.grid, REFERENCE["t"]
    far = sf.Bicubic(sf.Grid(grid.x + 4.0e5, grid.y + 5.5e6, grid.z + 2048.0))
    still = drive(GROUND, t)
    run = drive(far, t, x=4.0e5, y=5.5e6)
    for name, offset in (("x", 4.0e5), ("y", 5.5e6), ("z", 2048.0), ("tilt_right", 0.0)):
        assert_allclose(run[name] - offset, still[name], rtol=0, atol=1e-8, err_msg=name)
    assert run["closure_residual"].max() < 1e-12


def test_mirror_image():
    mirrored = sf.Analytic(lambda x, y: hills(-x, y))
    still = drive(sf.Analytic(hills), T, tolerance=TOLERANCE, heading=0.3)
    rates = {"right_rate": 0.4, "left_rate": 0.5, "steer_rate": 0.0}
    run = drive(mirrored, T, tolerance=TOLERANCE, rates=rates, heading=-0.3)
    odd = {name: -still[name] for name in ("x", "heading", "roll")}
    same_motion(run, still, **odd, tilt_right=-still["tilt_left"], tilt_left=-still["tilt_right"])


def test_twice_the_rates_take_half_the_time():
    still = drive(sf.Analytic(hills), T, tolerance=TOLERANCE)
    rates = {name: 2 * rate for name, rate in PAPER_RATES.items()}
    run = drive(sf.Analytic(hills), T / 2, tolerance=TOLERANCE, rates=rates)
    same_motion(run, still)


def test_reported_frame_is_x_forward():
    dae = closure_model(three_wheeler(), sf.Analytic(lambda x, y: 0.3 * x + 0.1 * y))
    run = sf.settle(dae, heading=0.4)
    quaternion = [run[f"quaternion_{axis}"][0] for axis in "xyzw"]
    assert_allclose(np.linalg.norm(quaternion), 1, atol=1e-14)
    forward = Rotation.from_quat(quaternion).apply([1.0, 0.0, 0.0])
    assert_allclose(np.arctan2(forward[1], forward[0]), run["yaw"][0], atol=1e-14)
    level = np.array([0.3, 0.1]) @ forward[:2]  # a vector in the plane climbs as the plane does
    assert_allclose(forward[2], level, atol=1e-12)


def test_contact_coordinates_lead_back_to_the_contact_point():
    """The torus at (u, v), carried by the wheel, is the contact point; psi turns the frames."""
    r1, r2 = 0.05, 0.25
    dae = closure_model(three_wheeler(), sf.Analytic(hills))
    run = sf.settle(dae, x=0.4, y=1.0, heading=0.6, tilt_right=0.2, tilt_left=-0.1, steer=0.3)
    level = sf.settle(closure_model(three_wheeler(), sf.Analytic(lambda x, _: 0 * x)))
    assert_allclose(level["wheel_v"], 1.5 * np.pi, atol=1e-12)
    assert_allclose(level["wheel_u"], np.pi / 2, atol=1e-12)
    assert_allclose(np.cos(level["psi"]), -1, atol=1e-12)
    for wheel in WHEELS:
        u, v = run["wheel_u", wheel][0], run["wheel_v", wheel][0]
        arm = [r1 * np.cos(u), *((r2 + r1 * np.sin(u)) * np.array([np.cos(v), np.sin(v)]))]
        span = [run[f"contact_{a}", wheel][0] - run[f"center_{a}", wheel][0] for a in "xyz"]
        assert_allclose(np.linalg.norm(arm), np.linalg.norm(span), atol=1e-13)


def test_signs_of_pitch_and_roll():
    dae = closure_model(three_wheeler(), sf.Analytic(lambda _, y: 0.2 * y))
    assert sf.settle(dae)["pitch"][0] == pytest.approx(np.arctan(0.2))
    assert sf.settle(dae, heading=np.pi / 2)["roll"][0] == pytest.approx(np.arctan(-0.2))
    east_is_low = closure_model(three_wheeler(), sf.Analytic(lambda x, _: -0.2 * x))
    assert sf.settle(east_is_low)["roll"][0] == pytest.approx(np.arctan(0.2))


# Vehicles locked to a plane, and of models with a controller

WAVES = sf.Analytic(lambda _x, y: 0.05 * ca.sin(2 * y), mu=0.8)
TIGHT = sf.SolverOptions(tolerance=1e-8)
PLANAR_T = np.linspace(0, 1.5, 16)


def driven(drive):
    vehicle = sf.catalog.rigid_skid_steer()
    return replace(vehicle, wheels=tuple(replace(each, drive=drive) for each in vehicle.wheels))


@pytest.mark.slow
def test_a_planar_vehicle_moves_as_a_symmetric_one_in_space():
    """The ground does not vary along x; the start has no roll and no speed aside."""
    vehicle = sf.catalog.rocky7()
    space, plane = sf.dynamics(vehicle, WAVES), sf.dynamics(sf.planar(vehicle), WAVES)
    start, level = (sf.settle(each, y=0.3, speed=0.5) for each in (space, plane))
    for name in ("z", "pitch", "velocity_y", "velocity_z"):
        assert_allclose(level[name], start[name], atol=1e-6, err_msg=name)
    rates = {label.full: 4.0 for label in space.labels.u.wheels}
    rates |= {label.full: 0.0 for label in space.labels.u.joints}
    run = sf.simulate(space, start, space.inputs(**rates), PLANAR_T, options=TIGHT)
    same = sf.simulate(plane, level, plane.inputs(**rates), PLANAR_T, options=TIGHT)
    assert (run.stop, same.stop) == (None, None)
    assert run["y"][-1] - run["y"][0] > 0.3
    for name in ("x", "y", "z", "heading", "roll", "pitch", "velocity_y", "omega_x"):
        assert_allclose(same[name], run[name], atol=2e-6, err_msg=name)
    assert_allclose(same["spin"], run["spin"], atol=2e-5)
    assert_allclose(same["contact_z"], run["contact_z"], atol=2e-6)


def test_the_tip_over_margin_of_a_planar_vehicle_is_that_of_its_ends():
    vehicle = sf.planar(sf.catalog.rigid_skid_steer())
    start = sf.settle(sf.dynamics(vehicle, FLAT), y=0.0)
    platform = Pose(ca.SX.eye(3), ca.SX([0, 0, start["z"][0]]))
    masses = [(mass, np.array(ca.evalf(at))) for _, mass, at in vehicle.masses(platform, {})]
    center = sum(mass * at for mass, at in masses).ravel() / vehicle.mass
    height = center[2] - start["contact_z"][0, 0]
    ends = start["contact_y"][0] - center[1]
    expected = np.arctan2([ends.max(), -ends.min()], height).min()
    assert_allclose(start["tip_over_margin"][0], expected, rtol=1e-9)


@pytest.mark.parametrize("model", [sf.direct_kinematics, sf.quasi_statics, sf.rigid_dynamics])
def test_other_models_refuse_planar_vehicles(model):
    for vehicle in (sf.catalog.three_wheeler(), sf.catalog.rigid_skid_steer()):
        with pytest.raises(sf.ModelError, match="found one locked to a plane; use "):
            model(sf.planar(vehicle), WAVES)


def test_a_controller_of_torques_equals_the_motors_of_a_vehicle():
    """PI control of the rates: as states of a controller, and as drives of the wheels."""
    motors = sf.dynamics(driven(sf.Motor(stall=1e6, no_load=1e6, kp=3.0, ki=20.0)), FLAT)
    model = sf.dynamics(driven(sf.Torque()), FLAT)
    names = [wheel.name for wheel in sf.catalog.rigid_skid_steer().wheels]
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
    run = sf.simulate(motors, sf.settle(motors), motors.inputs(**rates), PLANAR_T, options=TIGHT)
    same = sf.simulate(
        closed, sf.settle(closed), closed.inputs(wanted=3.0), PLANAR_T, options=TIGHT
    )
    for name in ("y", "z", "pitch", "work"):
        assert_allclose(same[name], run[name], atol=1e-5, err_msg=name)
    assert_allclose(same["first_error"], 3.0 - same["wheel_rate"][:, 0], atol=1e-12)


FLAT = sf.Analytic(lambda x, _y: 0 * x, mu=0.8)


def test_a_controller_has_a_law_for_every_input():
    model = sf.dynamics(driven(sf.Torque()), FLAT)
    with pytest.raises(sf.ModelError, match="expected 4 laws, one per input of the model, found 0"):
        controlled(model, ControlLaw((), (), (), ()))
