"""Tests of direct kinematics against a reference motion, closed forms and invariances."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.cases import PAPER_RATES, case1, closure_model, drive, hills
from slipfree import Analytic, Bicubic, Grid, Rolling, SolverOptions, settle, simulate
from slipfree.catalog import three_wheeler

MOTION = ("x", "y", "heading", "tilt_right", "tilt_left", "z", "roll", "pitch")
PLACES = ("contact_x", "contact_y")
WHEELS = ("right", "left", "front")
T = np.linspace(0, 6, 31)
TOLERANCE = 1e-10
ERROR = 100  # error of a 6 s run in units of the tolerance, as measured on the reference motion


@pytest.fixture(scope="module")
def reference():
    return case1()


def error(run, expected, names=(*MOTION, *PLACES)):
    return max(np.abs(run[name] - expected[name]).max() for name in names)


@pytest.mark.parametrize(
    ("tolerance", "allowed"), [(1e-8, 2e-6), (1e-10, 5e-8), (1e-12, 2e-9)], ids=str
)
def test_reference_motion(reference, tolerance, allowed):
    terrain, expected = reference
    run = drive(terrain, expected["t"], tolerance=tolerance)
    assert run.stop is None
    assert error(run, expected) < allowed
    for wheel in WHEELS:
        angle = run["wheel_angle", wheel]
        assert_allclose(angle, expected[f"theta_{wheel}"], rtol=0, atol=allowed)


def test_error_follows_the_tolerance(reference):
    terrain, expected = reference
    tolerances = 10.0 ** -np.arange(5, 12)
    errors = [error(drive(terrain, expected["t"], tolerance=each), expected) for each in tolerances]
    slope = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert 0.5 < slope < 1.1


def test_flat_ground_is_planar_kinematics():
    run = drive(Analytic(lambda x, _: 0 * x), np.array([0.0, 0.1]))
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


@pytest.mark.parametrize("tolerance", [1e-6, 1e-8, 1e-10])
def test_samples_lie_on_the_ground(reference, tolerance):
    run = drive(reference[0], T, tolerance=tolerance)
    assert run["closure_residual"].max() < 1e-12
    assert run["least_slip_residual"].max() < 1e-12
    assert run["newton_step"].max() < 100 * tolerance
    assert run["singular_value"].min() > 1e-3


def test_rolls_without_slip(reference):
    run = drive(reference[0], T)
    assert np.abs(run["slip_along"]).max() < 1e-12
    assert np.abs(run["slip_across"]).max() < 1e-12


def test_rolling_equals_least_slip_where_the_vehicle_can_roll():
    vehicle, ground = three_wheeler(), Analytic(hills)
    least = closure_model(vehicle, ground)
    rolling = closure_model(vehicle, ground, slip=Rolling())
    runs = [
        simulate(
            dae,
            settle(dae, heading=0.3),
            dae.inputs(**PAPER_RATES),
            T,
            options=SolverOptions(tolerance=TOLERANCE),
        )
        for dae in (least, rolling)
    ]
    same_motion(runs[1], runs[0])
    assert runs[1]["no_slip_residual"].max() < 1e-14


def test_rates_are_the_derivatives_of_the_motion(reference):
    t = np.linspace(0, 3, 601)
    run = drive(reference[0], t, tolerance=1e-11)
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


def test_translation_of_analytic_ground_and_vehicle():
    moved = Analytic(lambda x, y: hills(x - 3.0, y + 2.0) + 5.0)
    still = drive(Analytic(hills), T, tolerance=TOLERANCE)
    run = drive(moved, T, tolerance=TOLERANCE, x=3.0, y=-2.0)
    same_motion(run, still, x=still["x"] + 3, y=still["y"] - 2, z=still["z"] + 5)


def test_translation_of_a_map_by_kilometres():
    terrain, expected = case1()
    grid = terrain.grid
    far = Bicubic(Grid(grid.x + 4.0e5, grid.y + 5.5e6, grid.z + 2048.0))
    still = drive(terrain, expected["t"])
    run = drive(far, expected["t"], x=4.0e5, y=5.5e6)
    for name, offset in (("x", 4.0e5), ("y", 5.5e6), ("z", 2048.0), ("tilt_right", 0.0)):
        assert_allclose(run[name] - offset, still[name], rtol=0, atol=1e-8, err_msg=name)
    assert run["closure_residual"].max() < 1e-12


def test_rotation_about_the_vertical():
    angle = 0.7
    c, s = np.cos(angle), np.sin(angle)
    turned = Analytic(lambda x, y: hills(c * x + s * y, c * y - s * x))
    still = drive(Analytic(hills), T, tolerance=TOLERANCE)
    run = drive(turned, T, tolerance=TOLERANCE, heading=angle)
    x, y = still["x"], still["y"]
    same_motion(run, still, x=c * x - s * y, y=s * x + c * y, heading=still["heading"] + angle)


def test_mirror_image():
    mirrored = Analytic(lambda x, y: hills(-x, y))
    still = drive(Analytic(hills), T, tolerance=TOLERANCE, heading=0.3)
    rates = {"right_rate": 0.4, "left_rate": 0.5, "steer_rate": 0.0}
    run = drive(mirrored, T, tolerance=TOLERANCE, rates=rates, heading=-0.3)
    odd = {name: -still[name] for name in ("x", "heading", "roll")}
    same_motion(run, still, **odd, tilt_right=-still["tilt_left"], tilt_left=-still["tilt_right"])


def test_twice_the_rates_take_half_the_time():
    still = drive(Analytic(hills), T, tolerance=TOLERANCE)
    rates = {name: 2 * rate for name, rate in PAPER_RATES.items()}
    run = drive(Analytic(hills), T / 2, tolerance=TOLERANCE, rates=rates)
    same_motion(run, still)


def test_sphere_and_disc_wheels_roll_too():
    for r1, r2 in ((0.3, 0.0), (0.0, 0.3)):
        run = drive(Analytic(hills), T[:6], vehicle=three_wheeler(r1=r1, r2=r2))
        assert run["closure_residual"].max() < 1e-12
        gap = run["center_z"] - run["contact_z"]
        assert gap.min() > 0.25


def test_reported_frame_is_x_forward():
    dae = closure_model(three_wheeler(), Analytic(lambda x, y: 0.3 * x + 0.1 * y))
    run = settle(dae, heading=0.4)
    x, y, z, w = (run[f"quaternion_{axis}"][0] for axis in "xyzw")
    forward = [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)]
    assert_allclose(np.arctan2(forward[1], forward[0]), run["yaw"][0], atol=1e-14)
    level = np.array([0.3, 0.1]) @ forward[:2]  # a vector in the plane climbs as the plane does
    assert_allclose(forward[2], level, atol=1e-12)
    assert_allclose(w * w + x * x + y * y + z * z, 1, atol=1e-14)


def test_contact_coordinates_lead_back_to_the_contact_point():
    """The torus at (u, v), carried by the wheel, is the contact point; psi turns the frames."""
    r1, r2 = 0.05, 0.25
    dae = closure_model(three_wheeler(), Analytic(hills))
    run = settle(dae, x=0.4, y=1.0, heading=0.6, tilt_right=0.2, tilt_left=-0.1, steer=0.3)
    level = settle(closure_model(three_wheeler(), Analytic(lambda x, _: 0 * x)))
    assert_allclose(level["wheel_v"], 1.5 * np.pi, atol=1e-12)
    assert_allclose(level["wheel_u"], np.pi / 2, atol=1e-12)
    assert_allclose(np.cos(level["psi"]), -1, atol=1e-12)
    for wheel in WHEELS:
        u, v = run["wheel_u", wheel][0], run["wheel_v", wheel][0]
        arm = [r1 * np.cos(u), *((r2 + r1 * np.sin(u)) * np.array([np.cos(v), np.sin(v)]))]
        span = [run[f"contact_{a}", wheel][0] - run[f"center_{a}", wheel][0] for a in "xyz"]
        assert_allclose(np.linalg.norm(arm), np.linalg.norm(span), atol=1e-13)


def test_signs_of_pitch_and_roll():
    dae = closure_model(three_wheeler(), Analytic(lambda _, y: 0.2 * y))
    assert settle(dae)["pitch"][0] == pytest.approx(np.arctan(0.2))
    assert settle(dae, heading=np.pi / 2)["roll"][0] == pytest.approx(np.arctan(-0.2))
    east_is_low = closure_model(three_wheeler(), Analytic(lambda x, _: -0.2 * x))
    assert settle(east_is_low)["roll"][0] == pytest.approx(np.arctan(0.2))


def test_analytic_and_spline_ground_agree():
    """The spline of a fine grid drives like the formula it was sampled from."""
    axes = np.arange(-4, 4.01, 0.05)
    value = ca.Function("h", [x := ca.SX.sym("x"), y := ca.SX.sym("y")], [hills(x, y)])
    a, b = np.meshgrid(axes, axes, indexing="ij")
    z = np.array(value.map(a.size)(a.reshape(1, -1), b.reshape(1, -1))).reshape(a.shape)
    smooth = drive(Analytic(hills), T, tolerance=TOLERANCE)
    run = drive(Bicubic(Grid(axes, axes, z)), T, tolerance=TOLERANCE)
    for name in MOTION:
        assert_allclose(run[name], smooth[name], rtol=0, atol=1e-6, err_msg=name)
