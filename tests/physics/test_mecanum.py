"""Tests of rollers at any angle: closed forms, rollers as bodies of their own, own balances."""

from dataclasses import replace
from math import cos, pi, radians, sin, tan

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import bisect, linprog
from scipy.spatial.transform import Rotation

import slipfree as sf
from helpers.cases import hills
from helpers.commands import refuses
from helpers.dynamics import FLAT, energy_error, moved, slope, states
from helpers.rounding import root
from slipfree.contact.closure import ContactFrame, without_rolling
from slipfree.laws.soil import SOILS, known_soil
from slipfree.models.friction_feasibility import best_utilisation
from slipfree.solve.replay import replay, round_trip
from slipfree.system import codegen_cache
from slipfree.vehicle.sections import Disc, Omni, Torus
from slipfree.vehicle.tree import EARTH_GRAVITY, Torque, Wheel

VEHICLE = sf.catalog.mecanum()
HALF_TRACK, HALF_BASE, RADIUS = 0.15, 0.235, 0.0475
PLACES = {
    "front_right": (HALF_TRACK, HALF_BASE),
    "front_left": (-HALF_TRACK, HALF_BASE),
    "rear_right": (HALF_TRACK, -HALF_BASE),
    "rear_left": (-HALF_TRACK, -HALF_BASE),
}
NAMES = tuple(PLACES)
CONTACTS = np.array([[*place, -RADIUS] for place in PLACES.values()])
SIGNS = np.array([-1, 1, 1, -1])  # of the angles of rollers
DIRECTIONS = {
    "forward": (0.3, 0.0, 0.0),
    "left": (0.0, 0.3, 0.0),
    "diagonal": (0.2, 0.2, 0.0),
    "spin": (0.0, 0.0, 0.7),
    "all": (0.2, -0.1, 0.5),
}  # v_x forward, v_y left [m/s], counter-clockwise rate [rad/s]


def platform(angle=pi / 4, **more):
    return sf.catalog.mecanum(roller_angle=angle, **more)


def textbook(v_x, v_y, omega, angle=pi / 4):
    """Wheel rates of four mecanum wheels, with X or O on top of the wheels for either sign.

    For 45 degrees and an X, ``(v_x -+ v_y -+ (l + w) omega) / R``.
    """
    arm = HALF_TRACK + HALF_BASE / tan(angle)
    left = v_y / tan(angle)
    return {
        "front_left_rate": (v_x - left - arm * omega) / RADIUS,
        "front_right_rate": (v_x + left + arm * omega) / RADIUS,
        "rear_left_rate": (v_x + left - arm * omega) / RADIUS,
        "rear_right_rate": (v_x - left + arm * omega) / RADIUS,
    }


def rates_at(dae, rates, **start):
    """Quantities of a motion at its start."""
    run = sf.simulate(dae, sf.settle(dae, **start), dae.inputs(**rates), np.array([0.0, 1e-6]))
    return {name: run[name][0] for name in run.columns}


def attitude(found):
    """Axes right, forward and up of the platform, as columns."""
    angles = [float(found[name]) for name in ("heading", "roll", "pitch")]
    return Rotation.from_euler("ZYX", angles).as_matrix()


# Kinematics


@pytest.mark.parametrize("angle", [pi / 4, -pi / 4, radians(30), radians(-60), radians(80)])
@pytest.mark.parametrize("name", DIRECTIONS)
def test_level_ground_against_closed_forms(name, angle):
    vehicle, (v_x, v_y, omega) = platform(angle), DIRECTIONS[name]
    dae, rates = sf.direct_kinematics(vehicle, FLAT), textbook(v_x, v_y, omega, angle)
    found = rates_at(dae, rates)
    assert_allclose([found["velocity_y"], -found["velocity_x"]], [v_x, v_y], rtol=0, atol=1e-12)
    assert_allclose(found["heading_rate"], omega, rtol=0, atol=1e-12)
    assert np.abs([found["slip_along"], found["slip_across"]]).max() < 1e-12
    inverse = sf.inverse_kinematics(vehicle, FLAT, given=("forward", "right", "yaw_rate"))
    given = inverse.inputs(forward=v_x, right=-v_y, yaw_rate=omega)
    sought = sf.simulate(inverse, sf.settle(inverse), given, np.array([0.0, 1e-6]))
    for wheel, rate in rates.items():
        assert sought[wheel][0] == pytest.approx(rate, abs=1e-11)


def rollers_as_bodies(wheels, rates):
    """Least slip of a platform whose rollers turn, in its own plane, by least squares.

    Unknowns are the velocity to the right and forward, the turning rate, and the rate of the roller
    on the ground of each wheel. Wheels are (centre, axle, angle of rollers, tube, circle). The
    result are the velocities, and the slip of each wheel in three components.
    """
    up, count = np.array([0.0, 0.0, 1.0]), len(wheels)
    rows, right_side = np.zeros((3 * count, 3 + count)), np.zeros(3 * count)
    for k, ((center, axle, angle, tube, circle), rate) in enumerate(
        zip(wheels, rates, strict=True)
    ):
        outward = -(up - (up @ axle) * axle)
        outward /= np.linalg.norm(outward)  # from the axle to the roller on the ground
        point = center + circle * outward - tube * up
        roller = Rotation.from_rotvec(angle * -outward).apply(axle)  # the axle, turned about -e
        span = slice(3 * k, 3 * k + 3)
        rows[span, 0], rows[span, 1] = (1, 0, 0), (0, 1, 0)
        rows[span, 2] = np.cross(up, point)
        rows[span, 3 + k] = np.cross(roller, point - (center + circle * outward))
        right_side[span] = rate * np.cross(axle, point - center)
    values, *_ = np.linalg.lstsq(rows, right_side, rcond=None)
    return values[:3], (rows @ values - right_side).reshape(count, 3)


@pytest.mark.parametrize("camber", [0.0, 0.3])
@pytest.mark.parametrize("angle", [pi / 4, radians(-25), radians(70), pi / 2])
def test_least_slip_on_a_tilted_plane_is_that_of_rollers_as_bodies(camber, angle, rng):
    """Four rates for three velocities: the wheels must slip. Leaning wheels shorten the axles."""
    ground = sf.Analytic(lambda x, y: 0.2 * x - 0.1 * y)
    section = Torus(0.0125, 0.035)
    wheels, geometry = [], []
    for wheel in VEHICLE.wheels:
        side = np.sign(PLACES[wheel.name][0])
        axle = (cos(camber), 0.0, side * sin(camber))
        # the second pair is oblique to the first, so that no motion is free at 90 degrees
        own = angle if wheel.name.startswith("front") else -0.6 * angle
        wheels.append(replace(wheel, section=Omni(section, own), axle=axle))
        center = np.array([*PLACES[wheel.name], 0.0])
        geometry.append((center, np.array(axle), own, section.r1, section.r2))
    rates = rng.uniform(-3, 3, 4)
    dae = sf.direct_kinematics(replace(VEHICLE, wheels=tuple(wheels)), ground)
    found = rates_at(dae, dict(zip((f"{n}_rate" for n in NAMES), rates, strict=True)), heading=0.7)
    axes = attitude(found)
    (right, forward, turning), slips = rollers_as_bodies(geometry, rates)
    velocity = [found[f"velocity_{axis}"] for axis in "xyz"]
    assert_allclose(velocity, axes @ [right, forward, 0], rtol=0, atol=1e-12)
    heading = found["heading"]  # angular velocity from Euler rates
    about = np.array([0, 0, 1]), [-sin(heading), cos(heading), 0], axes[:, 0]
    euler = (found[f"{name}_rate"] for name in ("heading", "roll", "pitch"))
    omega = sum(rate * np.array(axis) for rate, axis in zip(euler, about, strict=True))
    assert_allclose(omega, turning * axes[:, 2], rtol=0, atol=1e-12)
    assert_allclose(found["slip_across"], slips[:, 0], rtol=0, atol=1e-12)
    assert_allclose(found["slip_along"], slips[:, 1], rtol=0, atol=1e-12)
    assert np.abs(slips).max() > 1e-3


def test_rollers_at_90_degrees_are_those_of_an_omni_wheel():
    """The expression is that without the slip across the wheel, operation by operation."""
    wheel = Wheel("w", "platform", (0, 0, 0), Omni(Disc(0.1)), driven=True)
    vectors = [ca.SX.sym(name, 3) for name in ("point", "normal", "along", "across", "axle")]
    frame = ContactFrame(*vectors, ca.SX.sym("uprightness"), ca.SX.sym("hessian", 2, 2))
    velocity = ca.SX.sym("velocity", 3)
    expected = velocity - frame.across * ca.dot(frame.across, velocity)
    assert str(without_rolling(wheel, frame, velocity)) == str(expected)


def test_rollers_along_the_axle_are_refused():
    """At zero degrees the wheel's rate would have no effect, and the contact no force forward."""
    for angle in (0.0, radians(91), np.nan):
        refuses(sf.ModelError, r"(angle|rollers): expected a", Omni, Disc(0.1), angle)


MIRRORED = {"half_track": 0.2, "wheelbase": 0.4, "angle": -pi / 4}
ALIKE = [replace(w, section=Omni(w.section.rim, radians(30))) for w in VEHICLE.wheels]
PARALLEL = replace(VEHICLE, wheels=tuple(ALIKE))


def test_rollers_that_permit_a_motion_are_refused():
    """An O on top of the wheels of a square: all axles on the ground point to the centre."""
    square = platform(**MIRRORED)
    for model in (sf.direct_kinematics, sf.quasi_statics):
        refuses(
            sf.ModelError,
            "about a point 0 m to the right of its centre and 0 m",
            model,
            square,
            FLAT,
        )
    with pytest.raises(sf.ModelError, match="none that resists its motion about a point 0 m"):
        sf.inverse_kinematics(square, hills_ground(), given=("forward", "right", "yaw_rate"))
    with pytest.raises(sf.ModelError, match="its motion 30 degrees to the left of forward, across"):
        sf.direct_kinematics(PARALLEL, FLAT)
    sf.direct_kinematics(platform(pi / 4, half_track=0.2, wheelbase=0.4), FLAT)
    sf.direct_kinematics(platform(-pi / 4), FLAT)


def test_a_rigid_platform_moves_on_level_ground_as_one_with_a_rocking_axle():
    """Its wheels are pressed into the ground, by the rolling radius over 50."""
    wheels = (
        replace(each, parent="platform", at=(*PLACES[each.name], 0.0)) for each in VEHICLE.wheels
    )
    rigid = replace(VEHICLE, coordinates=(), joints=(), wheels=tuple(wheels))
    v_x, v_y, omega = DIRECTIONS["all"]
    found = rates_at(sf.direct_kinematics(rigid, FLAT), textbook(v_x, v_y, omega))
    assert_allclose([found["velocity_y"], -found["velocity_x"]], [v_x, v_y], rtol=0, atol=1e-9)
    assert_allclose(found["heading_rate"], omega, rtol=0, atol=1e-9)
    dae = sf.direct_kinematics(rigid, hills_ground())
    run = sf.simulate(
        dae, sf.settle(dae), dae.inputs(**textbook(0.1, 0.1, 0.2)), np.linspace(0, 3, 16)
    )
    assert run.stop is None
    along = run["slip_along"] * SIGNS
    assert_allclose(along, run["slip_across"], rtol=0, atol=1e-5)  # along the rollers


# Commands


def hills_ground(mu=0.8):
    return sf.Analytic(hills, mu=mu)


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("angle", [pi / 4, -pi / 4])
def test_commands_are_met_and_the_direct_model_repeats_them(angle, exact):
    vehicle, ground = platform(angle), hills_ground()
    options = sf.SolverOptions(1e-8)
    t = np.linspace(0, 4, 41)
    dae = sf.inverse_kinematics(
        vehicle, ground, given=("forward", "right", "yaw_rate"), exact=exact
    )
    given = {"forward": 0.1, "right": -0.15, "yaw_rate": 0.3}
    run = sf.simulate(dae, sf.settle(dae, options=options), dae.inputs(**given), t, options=options)
    assert run.stop is None
    # on any ground, each wheel meets the one condition along its rollers by its rate
    assert np.hypot(run["slip_along"], run["slip_across"]).max() < 1e-12
    if not exact:
        assert max(np.abs(run[f"{name}_error"]).max() for name in given) < 1e-12
    direct = sf.direct_kinematics(vehicle, ground)
    missed = round_trip(direct, run, ("velocity_x", "velocity_y", "heading_rate"))
    assert max(missed.values()) < 1e-9
    _, difference = replay(direct, run, options=options)
    assert max(difference[name] for name in ("x", "y", "heading")) < 1e-6


def test_forward_alone_is_refused_since_the_vehicle_may_move_sideways():
    with pytest.raises(sf.ModelError, match="'mecanum': expected the given rate 'right'"):
        sf.inverse_kinematics(VEHICLE, FLAT, given=("forward", "yaw_rate"))


@pytest.mark.parametrize("angle", [pi / 4, -radians(60)])
def test_a_path_is_followed(angle):
    vehicle, path = platform(angle), sf.Path(np.array([[0.0, 0.0], [0.0, 0.5], [-0.5, 1.0]]))
    dae = sf.direct_kinematics(vehicle, FLAT)
    run = sf.simulate(dae, sf.settle(dae), sf.follow(dae, path, speed=0.2), np.linspace(0, 6, 31))
    assert np.hypot(run["slip_along"], run["slip_across"]).max() < 1e-12
    assert np.hypot(run["x"][-1] + 0.5, run["y"][-1] - 1.0) < 0.15


# Friction


def roller_axles(angle):
    """Directions of the axles of the rollers on the ground, one row each."""
    angles = angle * SIGNS
    return np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=-1)


def resultant(forces):
    """Force, moment, and moment about the front axle, which turns about y, of forces on wheels."""
    axle = np.cross(CONTACTS[:2] - [0, HALF_BASE, 0], forces[:2])[:, 1].sum()
    return np.array([*forces.sum(axis=0), *np.cross(CONTACTS, forces).sum(axis=0), axle])


def gravity(found):
    """Resultant of the weight, which acts at the origin, in the platform's axes."""
    return np.append(attitude(found).T @ [0, 0, -EARTH_GRAVITY * (22 + 4 * 1.4)], [0, 0, 0, 0])


def own_balance(found, rates, angle, mu, eps):
    """Slip and forces along the rollers' axles, from an own balance in the platform's axes."""
    axles = roller_axles(angle)

    def forces(unknown):
        right, forward, turning, *loads = unknown
        x, y, _ = CONTACTS.T
        slip = axles[:, 0] * (right - turning * y)
        slip += axles[:, 1] * (forward + turning * x - RADIUS * np.array(rates))
        return slip, -mu * np.array(loads) * slip / np.hypot(slip, eps)

    def balance(unknown):
        _, friction = forces(unknown)
        force = friction[:, None] * axles + unknown[3:, None] * [0, 0, 1]
        return resultant(force) + gravity(found)

    start = [0.0, 0.0, 0.0, *[27.6 * EARTH_GRAVITY / 4] * 4]
    solved, rounding = root(balance, start)
    return (*forces(solved), solved[3:], angle * SIGNS, rounding)


@pytest.mark.parametrize("across", [False, True])
@pytest.mark.parametrize("angle", [pi / 4, radians(60), radians(-40)])
def test_creep_on_a_slope_against_an_own_balance(across, angle):
    eps, mu, degrees = 1e-3, 0.6, 10
    rates = {"front_right_rate": 1e-3, "rear_left_rate": -2e-3, "front_left_rate": 0.0}
    rates["rear_right_rate"] = 3e-3
    dae = sf.quasi_statics(platform(angle), slope(degrees, mu, across), law=sf.Coulomb(eps))
    for given in (dict.fromkeys(rates, 0.0), rates):
        found = rates_at(dae, given)
        values = [given[f"{name}_rate"] for name in NAMES]
        slip, friction, loads, angles, rounding = own_balance(found, values, angle, mu, eps)
        load, speed = 100 * rounding[3:].max(), 100 * rounding[:3].sum()  # arms are below 1 m
        force = mu * (load + loads.max() * speed / eps)
        assert_allclose(found["force_normal"], loads, rtol=0, atol=load)
        assert_allclose(found["force_along"], friction * np.sin(angles), rtol=0, atol=force)
        assert_allclose(found["force_across"], friction * np.cos(angles), rtol=0, atol=force)
        assert_allclose(found["slip_along"], slip * np.sin(angles), rtol=0, atol=speed)
        assert_allclose(found["slip_across"], slip * np.cos(angles), rtol=0, atol=speed)
        torque = RADIUS * friction * np.sin(angles)
        assert_allclose(found["drive_torque"], torque, rtol=0, atol=RADIUS * force)
    # at rest all wheels use the same share: only the component along the rollers holds
    share = sin(abs(angle)) if not across else cos(angle)
    used = tan(radians(degrees)) / (mu * share)
    found = rates_at(dae, dict.fromkeys(rates, 0.0))
    assert_allclose(found["utilisation"], used, rtol=1e-6)
    creep = np.hypot(found["slip_along"], found["slip_across"])
    assert_allclose(creep, eps * used / np.sqrt(1 - used**2), rtol=1e-6)


@pytest.mark.parametrize("heading", [0.0, 0.5, pi / 2])
def test_the_least_utilisation_against_a_linear_programme(heading):
    """Friction only along the rollers' axles; the least utilisation by bisection of programmes."""
    ground, mu = slope(12, mu=0.5), 0.5
    dae = sf.direct_kinematics(VEHICLE, ground)
    found = best_utilisation(VEHICLE, ground, sf.settle(dae, heading=heading))
    axles, up = roller_axles(pi / 4), np.array([0.0, 0.0, 1.0])
    sides = [np.outer(np.eye(4)[k], side) for k in range(4) for side in (axles[k], up)]
    equal = np.stack([resultant(side) for side in sides], axis=-1)
    weight = gravity({name: found[name][0] for name in ("heading", "roll", "pitch")})

    def holds(level):
        rows = np.kron(np.eye(4), [[1, -level * mu], [-1, -level * mu]])
        bounds = [(None, None), (0, None)] * 4
        return linprog(np.zeros(8), rows, np.zeros(8), equal, -weight, bounds).status == 0

    least = bisect(lambda level: 0.5 - holds(level), 0, 4, xtol=1e-9)
    assert found["utilisation_best"][0] == pytest.approx(least, rel=1e-5)


def test_forces_of_a_motion_act_along_the_rollers():
    """The load-weighted forces of kinematics have no component across the rollers' axles."""
    ground = hills_ground()
    dae = sf.direct_kinematics(VEHICLE, ground)
    rates = textbook(0.1, 0.1, 0.2)
    run = sf.simulate(dae, sf.settle(dae), dae.inputs(**rates), np.linspace(0, 2, 5))
    ratio = run["force_along"] / run["force_across"]
    assert_allclose(ratio, np.broadcast_to(SIGNS, ratio.shape), rtol=1e-4)  # wheels lean a little
    assert np.ptp(run["force_along"]) > 1


def test_soil_refuses_oblique_rollers():
    words = "'front_right': expected a wheel on soil without oblique"
    refuses(sf.ModelError, words, sf.dynamics, VEHICLE, FLAT, law=known_soil(next(iter(SOILS))))


# Dynamics


def free_wheels(vehicle, **more):
    """A vehicle whose drives exert no torque unless it is given."""
    wheels = (replace(each, drive=Torque(), **more) for each in vehicle.wheels)
    return replace(vehicle, wheels=tuple(wheels))


def standing_states(model, **values):
    """States at rest on level ground, with other values."""
    rest = sf.settle(sf.dynamics(free_wheels(VEHICLE), FLAT))
    return states(model, z=rest["z"][0], **values)


@pytest.mark.parametrize("angle", [pi / 4, radians(30), radians(-50)])
@pytest.mark.parametrize("sideways", [False, True])
def test_coasting_wheels_take_their_share_of_momentum(angle, sideways):
    """From a velocity with wheels at rest to rolling: ``v1 (m + 4 I c^2 / R^2) = m v0``.

    Friction spins the wheels up to ``c v / R``, with ``c = 1`` forward and ``cot(angle)`` sideways.
    """
    vehicle = free_wheels(platform(angle))
    model = sf.dynamics(vehicle, FLAT)
    speed = 0.3
    start = standing_states(model, **{"velocity_x" if sideways else "velocity_y": speed})
    run = moved(model, start, np.linspace(0, 3, 31), tolerance=1e-10)
    mass, inertia = 22 + 4 * 1.4, 1.4 * RADIUS**2 / 2
    factor = 1 / tan(angle) if sideways else 1.0
    expected = speed * mass / (mass + 4 * inertia * factor**2 / RADIUS**2)
    name, other = ("velocity_x", "velocity_y")[:: 1 if sideways else -1]
    assert_allclose(run[name][-1], expected, rtol=1e-6)
    assert_allclose(run[other][-1], 0, atol=1e-6)  # only the front axle rocks
    assert_allclose(run["omega_z"][-1], 0, atol=1e-6)
    signs = SIGNS if sideways else np.ones(4)
    assert_allclose(run["wheel_rate"][-1], signs * factor * expected / RADIUS, rtol=1e-5)
    assert np.abs(energy_error(run)).max() < 1e-6 * run["kinetic_energy"][0]


def test_momentum_of_free_motions_is_kept():
    """Wheels held at rest: a square with an O spins on, one with parallel rollers slides on."""
    square = platform(**MIRRORED)
    model = sf.dynamics(square, FLAT)
    run = moved(model, standing_states(model, omega_z=0.5), np.linspace(0, 2, 11))
    assert_allclose(run["omega_z"], 0.5, rtol=0, atol=1e-9)
    model = sf.dynamics(PARALLEL, FLAT)
    free = 0.3 * np.array([-sin(radians(30)), cos(radians(30))])
    start = standing_states(model, velocity_x=free[0], velocity_y=free[1])
    run = moved(model, start, np.linspace(0, 2, 11))
    assert_allclose(run["velocity_x"], free[0], rtol=0, atol=1e-9)
    assert_allclose(run["velocity_y"], free[1], rtol=0, atol=1e-9)
    start = standing_states(model, velocity_x=0.3 * cos(radians(30)), velocity_y=0.15)
    run = moved(model, start, np.linspace(0, 2, 11))  # along the axles: friction stops it
    assert np.hypot(run["velocity_x"], run["velocity_y"])[-1] < 1e-3


def test_the_energy_ledger_of_driven_wheels_on_hills():
    model = sf.dynamics(free_wheels(VEHICLE), hills_ground())
    names = [label.full for label in model.labels.u.wheels]
    inputs = dict(zip(names, -0.4 * SIGNS, strict=True))
    run = moved(model, sf.settle(model), np.linspace(0, 2, 21), tolerance=1e-9, **inputs)
    assert np.abs(energy_error(run)).max() < 1e-6 * np.abs(run["work"]).max()
    assert run["lost_energy"][-1] > 0
    assert np.abs(run["wheel_rate"]).max() > 5


# Batches


@pytest.mark.parametrize("model", [sf.direct_kinematics, sf.quasi_statics])
def test_batch_repeats_single_motions(model, tmp_path, monkeypatch):
    monkeypatch.setenv(codegen_cache.FOLDER, str(tmp_path))
    dae = model(VEHICLE, hills_ground())
    t, headings = np.linspace(0, 2, 11), np.array([0.0, 1.0])
    rates = textbook(0.1, 0.1, 0.3)
    lanes = sf.rollouts(dae, {"heading": headings}, rates, t, method="batch", step=0.02)
    assert (lanes["outcome"] == "complete").all()
    for k, heading in enumerate(headings):
        options = sf.SolverOptions(1e-9)
        run = sf.simulate(
            dae, sf.settle(dae, heading=heading), dae.inputs(**rates), t, options=options
        )
        for name in ("x", "y", "heading", "roll"):
            assert_allclose(lanes[name][k], run[name], rtol=0, atol=1e-6)
