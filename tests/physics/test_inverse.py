"""Tests of inverse kinematics: direct model, known condition numbers, and refused problems."""

from dataclasses import replace
from itertools import combinations

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.cases import closure_model, hills
from helpers.commands import refuses
from slipfree import (
    Analytic,
    Bicubic,
    Grid,
    ModelError,
    Rolling,
    SolverError,
    SolverOptions,
    Vehicle,
    settle,
    simulate,
)
from slipfree.catalog import three_wheeler
from slipfree.control.path_following import path_inputs
from slipfree.models.given_rates import EULER, OMEGA, PLANAR, VELOCITY, conditions, omega
from slipfree.models.inverse import inverse_kinematics, steering_note, steering_slip
from slipfree.solve.collocation import drive
from slipfree.solve.replay import replay, spline_inputs
from slipfree.solve.sampling import Samples, complete_samples, to_trajectory
from slipfree.solve.system import solve_initial_conditions, with_inputs
from slipfree.vehicle.sections import Torus
from slipfree.vehicle.tree import Wheel

CROSSING = {"given": PLANAR, "solve_for": "rates", "least_margin": 0.0}
WHEEL_RATES = ("right_rate", "left_rate", "steer_rate")
PAPER_MOTION = {"velocity_x": 0.01255, "velocity_y": 0.12865, "heading_rate": 0.0159}
PAPER_STOP = 0.35  # tilt at which the paper's figures end [rad]


def rough(x, y):
    ripples = 0.03 * ca.sin(3.1 * x + 2.3 * y + 0.7) + 0.02 * ca.cos(4.3 * x - 2.9 * y)
    return hills(x, y) + ripples


FLAT, HILLS = Analytic(lambda x, _: 0 * x), Analytic(hills)
MIRRORED = Analytic(lambda x, y: -hills(x, y))


def direct_run(terrain, t, *, tolerance=1e-10, **start):
    """Drive with smoothly changing rates of all three inputs."""
    dae = closure_model(three_wheeler(), terrain, slip=Rolling())
    right = 0.45 + 0.05 * ca.sin(0.5 * dae.t)
    left = 0.45 - 0.05 * ca.sin(0.5 * dae.t + 0.3)
    rates = dae.inputs(right_rate=right, left_rate=left, steer_rate=0.05 * ca.cos(0.6 * dae.t))
    begin = settle(dae, **start)
    return dae, begin, simulate(dae, begin, rates, t, options=SolverOptions(tolerance=tolerance))


def repeated(direct, found):
    """The direct model's motion under the inputs found along a path."""
    inputs = spline_inputs(direct, found.t, found.unknowns)
    return replay(direct, found.run, inputs)


def with_omega(run):
    """Return a function of name and sample that also knows the angular velocity."""
    g, b = ca.SX.sym("g"), ca.SX.sym("b")
    to_omega = ca.Function("omega", [g, b], [omega(g, b)])
    euler = np.array([run[name] for name in EULER])
    turning = [
        np.array(to_omega(run["heading"][k], run["roll"][k])) @ euler[:, k]
        for k in range(run.t.size)
    ]
    values = dict(zip(OMEGA, np.array(turning).T, strict=True))
    return lambda name, k: values[name][k] if name in values else run[name][k]


@pytest.mark.slow
def test_rates_come_back_at_recorded_states():
    """Choices of three rates, at every state where they determine the others."""
    _, _, run = direct_run(HILLS, np.linspace(0, 6, 2), x=0.3, heading=0.2)
    value, returned = with_omega(run), 0
    choices = [*combinations((*VELOCITY, *OMEGA), 3)][::3]
    for given in (*choices, PLANAR, EULER):
        dae = inverse_kinematics(
            three_wheeler(), HILLS, given=given, least_margin=0.0, solve_for="rates"
        )
        for k in range(run.t.size):
            system = with_inputs(dae, dae.inputs(**{name: value(name, k) for name in given}), 0)
            x, z = dae.rows("x", run, k), dae.rows("z", run, k)
            if dae.checks[-1].margin(x[:, None], z[:, None])[0] < 1e-3:
                continue
            z = solve_initial_conditions(
                system, 0.0, x, np.where(np.arange(z.size) < 9, z, 0.0), system.u[:, 0]
            )
            expected, n = dae.rows("z", run, k), system.motion_size
            assert_allclose(z[:n], expected[:n], rtol=0, atol=1e-10, err_msg=str(given))
            returned += 1
    assert returned > 9


def test_integrated_rates_come_back_where_the_steering_is_stable():
    t = np.linspace(0, 8, 161)
    _, begin, run = direct_run(HILLS, t, tolerance=1e-11, x=0.3, heading=0.2)
    dae = inverse_kinematics(three_wheeler(), HILLS, given=PLANAR, solve_for="rates")
    inputs = path_inputs(dae, begin, t, run["x"], run["y"], run["heading"])
    back = simulate(dae, begin, inputs, t, options=SolverOptions(tolerance=1e-10))
    assert back["steering_growth"].max() < 0  # lever times forward speed stays positive
    assert back.stop is None
    assert steering_note(back) == ""
    for name in WHEEL_RATES:
        assert_allclose(back[name], run[name], rtol=0, atol=1e-6, err_msg=name)
    assert np.abs(back["slip_across"]).max() < 1e-12


def test_growth_is_the_derivative_of_the_steering_rate_in_the_steering_angle():
    dae = inverse_kinematics(three_wheeler(), HILLS, given=PLANAR, solve_for="rates")
    _, _, run = direct_run(HILLS, np.linspace(0, 2, 3), x=0.3)
    system = with_inputs(dae, dae.inputs(**{name: run[name][-1] for name in PLANAR}), 0)
    x, z, u = dae.rows("x", run, -1), dae.rows("z", run, -1), system.u[:, 0]
    steer = np.array([label.name == "steer" for label in (*dae.labels.x[:3], *dae.labels.x.joints)])
    less, more = (
        solve_initial_conditions(system, 0.0, x + step * steer, z, u)[system.motion_size - 1]
        for step in (-1e-5, 1e-5)
    )
    growth = ca.Function("growth", list(dae.columns()), dae.named("steering_growth"))
    assert_allclose(float(growth(x, z, u)), (more - less) / 2e-5, rtol=1e-6)


@pytest.mark.slow
def test_unstable_steering_is_told():
    """Where the contact leads the steering axis the steering runs away, and it is said so."""
    vehicle = three_wheeler(mass=0.0, wheel_mass=0.0)  # else the front wheel lifts off before
    dae = inverse_kinematics(vehicle, MIRRORED, given=PLANAR, solve_for="rates")
    begin = settle(closure_model(vehicle, MIRRORED))
    reached = simulate(dae, begin, dae.inputs(**PAPER_MOTION), np.linspace(0, 4, 81))
    assert reached.stop.name == "inverse_margin"
    assert_allclose(reached.t[-1], 0.841102, atol=2e-6)  # as at a tolerance of 1e-10
    assert abs(reached["steer"][-1]) > 0.5
    assert_allclose(reached["steering_growth"][0], 4.75, atol=0.01)
    assert "unstable steering from t = 0 s: errors of the steering angle grow at up to" in (
        steering_note(reached)
    )


def test_crossing_stops_the_rate_form_by_name():
    """The contact crosses the steering axis from behind."""
    t = np.linspace(0, 8, 161)
    _, begin, run = direct_run(HILLS, t, tolerance=1e-11, x=1.0, y=0.5)
    dae = inverse_kinematics(three_wheeler(), HILLS, given=PLANAR, solve_for="rates")
    margin = dae.checks[-1].margin(
        *(np.column_stack([dae.rows(r, run, k) for k in range(t.size)]) for r in "xz")
    )
    assert margin.min() < 0 < margin[0]
    k = int(np.argmin(margin))
    words = dae.checks[-1].describe(dae.rows("x", run, k), dae.rows("z", run, k))
    assert words.startswith(
        "platform rates 'heading_rate' and 'velocity_x' cannot be imposed independently: "
        "'steer_rate' is not determined, since the contact of wheel 'front' lies on the axis of "
        "'steer' (smallest singular value "
    )
    inputs = path_inputs(dae, begin, t, run["x"], run["y"], run["heading"])
    with pytest.raises(ModelError, match=r"found a violation: .* is not determined, since the con"):
        simulate(dae, run.part(slice(k, k + 1)), inputs, t)


@pytest.mark.slow
def test_path_passes_where_the_contact_crosses_the_steering_axis():
    t = np.linspace(0, 8, 161)
    direct, begin, run = direct_run(HILLS, t, tolerance=1e-13, x=1.0, y=0.5)
    dae = inverse_kinematics(three_wheeler(), HILLS, **CROSSING)
    found = drive(
        dae,
        begin,
        path_inputs(dae, begin, t, run["x"], run["y"], run["heading"]),
        t,
        free_states=["steer"],
    )
    growth = found.run["steering_growth"]
    assert growth.min() < 0 < growth.max()
    error = found.run.statistics["sought_error"]
    assert error < 3e-6
    assert_allclose(found.run["steer"], run["steer"], rtol=0, atol=3 * error)
    # an error of the steering angle changes its rate by as much times the growth
    bound = 3 * error * np.maximum(1, np.abs(growth))
    for name in WHEEL_RATES:
        assert (np.abs(found.run[name] - run[name]) < bound).all(), name
    assert_allclose(found.run["wheel_angle"], run["wheel_angle"], rtol=0, atol=1e-7)
    assert found.run["no_slip_residual"].max() < 1e-7
    assert found.run["closure_residual"].max() < 1e-12
    motion, difference = repeated(direct, found)
    assert motion.stop is None
    assert max(difference.values()) < 2e-6


def test_collocation_of_a_system_with_a_known_slow_solution():
    """On flat ground the lever is zero and the steering is that of the plane: no slope, no tilt."""
    direct = closure_model(three_wheeler(), FLAT)
    dae = inverse_kinematics(three_wheeler(), FLAT, **CROSSING)
    begin = settle(direct)
    rate = 0.02
    heading = rate * dae.t  # the middle of the rear axle moves along its own heading
    x = 0.5 * (1 - ca.sin(heading)) - 0.5 - 6.75 * (1 - ca.cos(heading))
    y = 0.5 * ca.cos(heading) - 0.5 + 6.75 * ca.sin(heading)
    path = zip(PLANAR, (x, y, heading), strict=True)
    found = drive(
        dae,
        begin,
        dae.inputs(**{name: ca.jacobian(each, dae.t) for name, each in path}),
        np.linspace(0, 4, 41),
        free_states=["steer"],
    )
    steer = np.arctan(1.5 * rate / 0.135)
    assert_allclose(found.run["steer"], steer, atol=1e-10)
    assert_allclose(found.run["tilt_left"], 0, atol=1e-10)
    assert_allclose(found.run["right_rate"], (0.135 + rate) / 0.3, atol=1e-10)


def moving(dae, stands):
    """Return one sample for each start, with equal rates of the rear wheels and fixed steering."""
    system = with_inputs(dae, dae.inputs(right_rate=0.45, left_rate=0.45, steer_rate=0.0), 0)
    u, n = system.u[:, 0], len(stands)
    x = [dae.rows("x", begin, 0) for begin in stands]
    z = [
        solve_initial_conditions(system, 0.0, at, dae.rows("z", begin, 0), u)
        for at, begin in zip(x, stands, strict=True)
    ]
    columns = np.column_stack(x), np.column_stack(z), np.zeros((4, n)), np.tile(u[:, None], n)
    return to_trajectory(system, *complete_samples(system, Samples(np.arange(float(n)), *columns)))


def test_conditions_on_flat_ground():
    dae = closure_model(three_wheeler(), FLAT, slip=Rolling())
    run = moving(dae, [settle(dae, heading=0.0)])
    by_rate = conditions(dae, run, "rates")
    assert len(by_rate) == 20
    assert all(np.isinf(value).all() for value in by_rate.values())
    by_angle = conditions(dae, run, "angles")
    usable = {given: value[0] for given, value in by_angle.items() if np.isfinite(value[0])}
    assert list(usable) == [("velocity_x", "velocity_y", "omega_z")]
    assert_allclose(usable["velocity_x", "velocity_y", "omega_z"], 5.9, atol=0.05)


@pytest.mark.slow
def test_conditions_on_hills(rng):
    """(Vx, Vy, Oz) is by far the best in both forms."""
    ground, stands = Analytic(rough), []
    dae = closure_model(three_wheeler(), ground, slip=Rolling())
    names = ("x", "y", "heading", "tilt_right", "tilt_left", "steer")
    while len(stands) < 60:
        values = rng.uniform(-1, 1, 6) * [3, 3, 3.1, 0.2, 0.2, 0.4]
        try:
            stands.append(settle(dae, **dict(zip(names, values, strict=True))))
        except ModelError:
            continue  # a second touch
    run, best = moving(dae, stands), ("velocity_x", "velocity_y", "omega_z")
    by_rate = conditions(dae, run, "rates")
    by_angle = conditions(dae, run, "angles")
    assert 12 < np.median(by_rate[best]) < 35
    assert min(by_rate, key=lambda given: np.median(by_rate[given])) == best
    assert 5.8 < np.median(by_angle[best]) < 6.2
    assert max(by_angle[best]) < 31
    assert min(np.median(v) for given, v in by_angle.items() if given != best) > 20


@pytest.mark.slow
@pytest.mark.parametrize("solve_for", ["rates", "angles"])
def test_inverse_input_of_the_paper_runs_until_a_tilt_stop(solve_for):
    """The paper draws tilts up to its end and mentions no stop; here 0.35 rad come at 4.1 s."""
    vehicle = three_wheeler(tilt_stop=PAPER_STOP)
    dae = inverse_kinematics(vehicle, HILLS, solve_for=solve_for, given=PLANAR)
    begin = settle(closure_model(vehicle, HILLS))
    run = simulate(dae, begin, dae.inputs(**PAPER_MOTION), np.linspace(0, 6, 61))
    assert run.stop.name in ("tilt_left_stop", "tilt_right_stop")
    assert_allclose(run.stop.t, 4.11, atol=0.1)


def test_steering_angle_on_flat_ground_is_that_of_the_plane():
    """The slip of the steering is lever times rate; the rate follows from the samples."""
    dae = inverse_kinematics(three_wheeler(), FLAT, solve_for="angles", given=PLANAR)
    begin = settle(closure_model(three_wheeler(), FLAT))
    t = np.linspace(0, 2, 41)
    run = steering_slip(three_wheeler(), simulate(dae, begin, dae.inputs(**PAPER_MOTION), t))
    heading = run["heading"]
    forward = -PAPER_MOTION["velocity_x"] * np.sin(heading)
    forward += PAPER_MOTION["velocity_y"] * np.cos(heading)
    left = -PAPER_MOTION["velocity_x"] * np.cos(heading)
    left -= PAPER_MOTION["velocity_y"] * np.sin(heading)
    steer = np.arctan2(left + PAPER_MOTION["heading_rate"], forward)
    assert_allclose(run["steer"][0], steer[0], atol=1e-12)
    assert_allclose(run["steer"], steer, atol=3e-4)  # but for the roll of the platform
    assert_allclose(run["steer_rate"], np.gradient(run["steer"], t, edge_order=2), atol=1e-5)
    assert_allclose(run["steering_slip"], run["steering_lever"] * np.abs(run["steer_rate"]))


def test_steering_angle_needs_motion():
    dae = inverse_kinematics(three_wheeler(), HILLS, solve_for="angles", given=PLANAR)
    begin = settle(closure_model(three_wheeler(), HILLS))
    with pytest.raises(ModelError, match="no equation determines steer"):
        simulate(dae, begin, dae.inputs(**dict.fromkeys(PLANAR, 0.0)), np.array([0.0, 1.0]))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"given": ("velocity_x", "velocity_y")}, "expected a list of three different names"),
        ({"given": ("velocity_x", "velocity_y", "velocity_x")}, "give each name once"),
        ({"given": ("v_x", "v_y")}, r"one or more names from forward, right, yaw_rate, found .'v"),
        ({"given": ("velocity_x", "velocity_y", "turn")}, "expected three of vel.*, found 'turn'"),
        ({"given": ("velocity_x", "omega_z", "roll_rate")}, "or Euler rates .*, not both"),
        ({"solve_for": "torques"}, "expected 'rates' or 'angles', found str 'torques'"),
        ({"least_margin": -1.0}, "least_margin: expected a number >= 0"),
    ],
)
def test_choices_are_checked(options, words):
    with pytest.raises(ModelError, match=words):
        inverse_kinematics(three_wheeler(), HILLS, **({"given": PLANAR} | options))


def test_vehicles_that_do_not_suit_are_refused():
    whole = three_wheeler()
    rear = (
        Wheel("right", "platform", (1.0, -0.5, 0.0), Torus(0.05, 0.25), driven=True),
        Wheel("left", "platform", (-1.0, -0.5, 0.0), Torus(0.05, 0.25), driven=True),
    )
    rigid = Vehicle("rigid", whole.coordinates[2:], whole.joints[2:], (*rear, whole.wheels[2]))
    words = r"'rigid' cannot roll without slip.*: expected 3 .*, found 1"
    refuses(ModelError, words, inverse_kinematics, rigid, HILLS, given=PLANAR, solve_for="rates")
    wheels = tuple(replace(wheel, driven=True) for wheel in whole.wheels)
    loose = tuple(replace(c, kind="passive") for c in whole.coordinates)
    castor = Vehicle("castor", loose, whole.joints, wheels)
    inverse_kinematics(castor, HILLS, given=PLANAR, solve_for="rates")
    braced = Vehicle("braced", whole.coordinates, whole.joints, (*wheels[:2], wheels[2]))
    with pytest.raises(ModelError, match="'braced' cannot roll"):
        inverse_kinematics(braced, HILLS, given=PLANAR, solve_for="rates")
    with pytest.raises(ModelError, match=r"with a commanded coordinate .* found none in 'castor'"):
        inverse_kinematics(castor, HILLS, solve_for="angles", given=PLANAR)


def test_paths_are_checked():
    dae = inverse_kinematics(three_wheeler(), HILLS, given=PLANAR, solve_for="rates")
    other = inverse_kinematics(three_wheeler(), HILLS, given=VELOCITY, solve_for="rates")
    begin = settle(closure_model(three_wheeler(), HILLS))
    t, still = np.linspace(0, 1, 11), np.zeros(11)
    path_inputs(dae, begin, t, still, t, still + 2 * np.pi)  # a whole turn is none
    for words, model, path, times in (
        ("heading of the start, found y = 1 instead of 0", dae, (still, 1 + t, still), t),
        ("expected at least 6 way-points, found 5", dae, (still[:5], t[:5], still[:5]), t[:5]),
        (r"expected 11 values each of x, y and heading, .*\(5,\)", dae, (still, t, still[:5]), t),
        ("expected finite times and values", dae, (still * np.nan, t, still), t),
        ("expected increasing times, found 1 s followed by 0.9 s", dae, (still, t, still), t[::-1]),
        ("expected an inverse model with the inputs velocity_x", other, (still, t, still), t),
    ):
        refuses(ModelError, words, path_inputs, model, begin, times, *path)


def test_drives_are_checked():
    direct = closure_model(three_wheeler(), HILLS)
    dae = inverse_kinematics(three_wheeler(), HILLS, **CROSSING)
    begin, t = settle(direct), np.linspace(0, 1, 11)
    inputs = dae.inputs(**PAPER_MOTION)
    words = r"free_states: expected names of states, x, y, .*, found 'sail'"
    refuses(ModelError, words, drive, dae, begin, inputs, t, free_states=["sail"])
    late = dae.inputs(velocity_x=0.0, velocity_y=ca.sqrt(dae.t - 0.5), heading_rate=0.0)
    with pytest.raises(SolverError, match=r"no motion from t = 0 to .* s that follows the"):
        drive(dae, begin, late, t, free_states=["steer"])


def test_path_ends_at_a_limit():
    direct = closure_model(three_wheeler(tilt_stop=0.1), HILLS)
    dae = inverse_kinematics(three_wheeler(tilt_stop=0.1), HILLS, **CROSSING)
    begin, t = settle(direct), np.linspace(0, 4, 41)
    found = drive(dae, begin, dae.inputs(**PAPER_MOTION), t, free_states=["steer"])
    assert found.run.stop.name in ("tilt_left_stop", "tilt_right_stop")
    assert found.run.t[-1] < 4
    with pytest.raises(ModelError, match=r"at least two samples within the limits .*: joint tilt"):
        drive(dae, begin, dae.inputs(**PAPER_MOTION), t[[0, -1]], free_states=["steer"])
    leaning = settle(closure_model(three_wheeler(), HILLS), tilt_left=0.2)
    with pytest.raises(ModelError, match=r"found a violation: joint tilt_left .* reaches its stop"):
        drive(dae, leaning, dae.inputs(**PAPER_MOTION), t, free_states=["steer"])


@pytest.mark.parametrize("solve_for", ["rates", "angles"])
def test_a_steered_wheel_beside_its_axis_has_a_guess_on_a_map(solve_for):
    """The guess looks the ground up below the wheels; angles that are sought are zero in it."""
    vehicle = three_wheeler()
    off = replace(vehicle.wheels[2], at=(0.0, -0.1, 0.0))
    vehicle = replace(vehicle, wheels=(*vehicle.wheels[:2], off))
    axis = np.linspace(-4, 4, 41)
    heights = 0.05 * np.sin(axis)[:, None] * np.cos(axis)
    guesses = []
    for ground in (
        Bicubic(Grid(axis, axis, heights)),
        Analytic(lambda x, y: 0.05 * ca.sin(x) * ca.cos(y)),
    ):
        dae = inverse_kinematics(vehicle, ground, solve_for=solve_for, given=PLANAR)
        function = dae.function("guess", [dae.columns()[0]], [dae.guess])
        guesses.append(np.array(function(np.full(function.size1_in(0), 0.1))))
    assert_allclose(guesses[0][0] + heights.mean(), guesses[1][0], atol=1e-4)
    assert_allclose(guesses[0][1:], guesses[1][1:], atol=1e-4)
