"""Tests of slow and planned climbs: path, friction demand, time scaling, and tracking.

Values with three digits are those of a separate study with its own code. It samples slow climbs at
fewer points and uses bisection; its planned climbs begin and end 0.2 % of the height from floor and
plateau, with wheels without rotational inertia.
"""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import Bounds, LinearConstraint, brentq, linprog, milp

from helpers.climb_cases import (
    CLIMBER,
    FIXED,
    MOTORS,
    SENSED,
    SPEED,
    STEP,
    Grip,
    planned,
    solved_legs,
    tracking,
)
from helpers.climb_cases import climb as driven_climb
from helpers.commands import refuses
from slipfree.catalog import AXLES, step_climber
from slipfree.climb import contact_path
from slipfree.climb.contact_path import LEVEL_SLOPE, demand, least_friction, legs, sample
from slipfree.climb.metrics import axle_speeds
from slipfree.core.dae import Nlp
from slipfree.core.errors import ModelError
from slipfree.core.trajectory import SolverError
from slipfree.models.force_distribution import NORMAL_FORCE_ROUNDING
from slipfree.models.samples import obstacle_ending
from slipfree.plan import ipopt
from slipfree.plan.ipopt import solve_nlp
from slipfree.terrain.solids import Profile, Solid, flat, kerb, placed, ramp, stairs, step

RADIUS, LINKS, WEIGHT = 0.066, (0.215, 0.255), 9.81 * 21.6
PROFILES = {"ramp": ramp(np.pi / 4, 0.09), **{f"{mm} mm": step(mm / 1000) for mm in (50, 90, 128)}}
ORDER = ("front", "middle", "rear")
SPINS = np.array([wheel.inertia[0] for wheel in CLIMBER.wheels])


@cache
def ways(name, joint=0.0, count=201):
    """Return vehicle, profile, and legs with their configurations."""
    climber, profile = step_climber(joint=joint), PROFILES[name]
    found = legs(climber, profile)
    paths = [sample(climber, profile, leg, np.linspace(0, leg.length, count)) for leg in found]
    return climber, profile, list(zip(found, paths, strict=True))


@cache
def friction(name, joint=0.0, samples=25):
    return least_friction(step_climber(joint=joint), PROFILES[name], samples)


# Path


@pytest.mark.slow
@pytest.mark.parametrize("joint", [0.0, 0.06])
@pytest.mark.parametrize("name", ["ramp", "50 mm", "90 mm"])
def test_wheels_stay_on_the_ground(name, joint):
    """Rims touch the outline of the ground: its nearest point is a radius away."""
    edge, height = PROFILES[name].summit
    corners = np.array([(-0.7, 0), (0, 0), (edge, height), (0.7, height)])
    outline = np.concatenate(
        [a + np.linspace(0, 1, 20001)[:, None] * (b - a) for a, b in pairwise(corners)]
    )
    for _, path in ways(name, joint)[2]:
        for center in path.axles[::20].reshape(-1, 2):
            assert abs(np.hypot(*(outline - center).T).min() - RADIUS) < 3e-6


@pytest.mark.parametrize("joint", [0.0, 0.06])
def test_speeds_meet_the_law_of_the_links(joint):
    """Speeds along either link agree; the tilt's rate is that of the axles across the rear one."""
    for _, path in ways("90 mm", joint)[2]:
        along = np.arctan2(-path.normals[..., 0], path.normals[..., 1])
        (rear, front), turn, v = path.q[:, 2:].T, path.first[:, 2], path.speeds
        over_rear, over_front = along - rear[:, None], along - front[:, None]
        lengthwise, across = v * np.cos(over_rear), v * np.sin(over_rear)
        assert_allclose(lengthwise[:, 0], lengthwise[:, 1], atol=1e-9)
        assert_allclose(LINKS[0] * turn, across[:, 1] - across[:, 0], atol=1e-9)
        forward = v * np.cos(over_front)
        swing = joint * turn * np.sin(front - rear)
        assert_allclose(forward[:, 2], forward[:, 1] + swing, atol=1e-9)
        assert_allclose((v**2).mean(axis=1), 1, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("joint", [0.0, 0.06])
@pytest.mark.parametrize("name", ["ramp", "90 mm"])
def test_derivatives_along_the_way(name, joint):
    climber, profile, found = ways(name, joint)
    for leg, _ in found:
        s, small = np.linspace(0.1, 0.9, 23) * leg.top, 1e-5
        before, here, after = (sample(climber, profile, leg, s + k * small) for k in (-1, 0, 1))
        smooth = np.abs(after.second - before.second).max(axis=1) < 0.5  # not where arcs begin
        assert smooth.sum() > 17
        for slope, value in (("first", "q"), ("second", "first"), ("slopes", "speeds")):
            change = (getattr(after, value) - getattr(before, value)) / (2 * small)
            error = np.abs(change - getattr(here, slope))[smooth].max()
            assert error < 1e-3 * max(1, np.abs(change[smooth]).max())


def test_the_front_wheel_climbs_the_wall_and_the_edge():
    leg = ways("90 mm")[2][0][0]
    s = np.linspace(0, leg.top, 2001)
    speed = sample(CLIMBER, STEP, leg, s).speeds[:, 2]
    way = ((speed[1:] + speed[:-1]) / 2 * np.diff(s)).sum()
    assert_allclose(way, 0.09 - RADIUS + RADIUS * (np.pi / 2 - LEVEL_SLOPE), rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("profile", "order"),
    [
        (STEP, "front 001, middle 011, rear 111"),
        (kerb(0.05, 0.3), "front 001, middle 011, front 010, rear 110, middle 100, rear 000"),
        (stairs(0.09, 0.3, 2), "front 001, middle 011, front 012, rear 112, middle 122, rear 222"),
        # front and middle wheels meet solids together, or nearly so
        (
            stairs(0.09, np.sqrt(LINKS[1] ** 2 - 0.09**2), 2),
            "front 001, middle 012, rear 112, middle 122, rear 222",
        ),
        (
            stairs(0.09, 0.215, 3),
            "front 001, front 002, middle 012, front 013, rear 113, middle 123, rear 223, "
            "middle 233, rear 333",
        ),
    ],
)
def test_order_of_the_legs(profile, order):
    found = [f"{leg.axle} {''.join(map(str, leg.solids))}" for leg in legs(CLIMBER, profile)]
    assert ", ".join(found) == order


def test_a_solid_counts_once():
    twice = Profile((*step(0.05).solids, step(0.05).solids[1]))
    lengths = [[leg.length for leg in legs(CLIMBER, each)] for each in (step(0.05), twice)]
    assert_allclose(*lengths, atol=1e-5)


@pytest.mark.parametrize(
    ("solids", "words"),
    [
        (step(0.3).solids, r"front wheels climbing.*upright.*lower obstacle"),
        (step(0.26).solids, r"middle wheels climbing.*upright"),
        (
            (*flat().solids, Solid(((0.2, 0.0), (1.0, 0.0), (1.0, 0.3), (-0.1, 0.3)))),
            r"front wheels.*caught between two solids",
        ),
        (flat().solids, "expected an obstacle that begins before the end of the floor"),
        (
            (
                Solid(((-5.0, -1.0), (5.0, -1.0), (5.0, 0.5), (-5.0, 0.0))),
                Solid(((0.0, -1.0), (1.0, -1.0), (1.0, 0.5), (0.0, 0.5))),
            ),
            "expected a level floor",
        ),
    ],
)
def test_what_cannot_be_climbed_is_refused(solids, words):
    refuses(ModelError, words, legs, CLIMBER, Profile(solids))


# Friction of slow climbs


def test_loads_at_rest():
    leg, path = ways("90 mm")[2][-1]
    hold = demand(CLIMBER, leg, sample(CLIMBER, STEP, leg, path.s[-1:]))
    assert_allclose(hold.normal[0], [51.00, 93.83, 67.07], rtol=2e-3)
    assert_allclose(hold.tangential, 0, atol=1e-7)
    moments = 9.81 * np.array([13.8 * 0.081 / 0.215, 7.8 * 0.2235 / 0.255])
    assert_allclose(hold.normal[0, [0, 2]], moments, rtol=1e-9)
    assert_allclose(hold.normal.sum(), WEIGHT, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("angle", [0.1, 0.4, 0.8])
def test_a_long_ramp_needs_the_tangent_of_its_angle(angle):
    profile = ramp(angle, 1.2 * np.sin(angle))
    leg = legs(CLIMBER, profile)[2]
    path = sample(CLIMBER, profile, leg, leg.length * np.array([0.1]))
    assert_allclose(demand(CLIMBER, leg, path).mu, np.tan(angle), rtol=1e-7)


def assert_least(matrix, load, mu, below):
    """Assert that forces within a friction hold the vehicle, and do not within less."""
    for factor, status in ((1 + 1e-4, 0), (below, 2)):
        cone = np.block([[-factor * mu * np.eye(3), sign * np.eye(3)] for sign in (1, -1)])
        bounds = [(0, None)] * 3 + [(None, None)] * 3
        found = linprog(np.zeros(6), cone, np.zeros(6), matrix, load / load[1], bounds)
        assert found.status == status


@pytest.mark.parametrize("name", ["ramp", "90 mm"])
def test_least_friction_is_what_linear_programs_find(name):
    climber, profile, found = ways(name)
    for leg, path in found:
        few = sample(climber, profile, leg, path.s[[0, 30, 60]])
        hold = demand(climber, leg, few)
        bearing = hold.normal + NORMAL_FORCE_ROUNDING * WEIGHT
        assert (np.abs(hold.tangential) <= hold.mu[:, None] * bearing + 1e-9).all()
        forces = np.hstack([hold.normal, hold.tangential])
        assert_allclose(np.einsum("nij,nj->ni", few.matrix, forces), few.load, atol=1e-8)
        for matrix, load, mu in zip(few.matrix, few.load, hold.mu, strict=True):
            assert_least(matrix, load, mu, 1 - 1e-4)


@pytest.mark.slow
def test_wheels_that_nearly_jam_are_not_given_up():
    plain, profile = step_climber(joint=0.097), step(0.098)
    body = replace(plain.body, at=(0.0, -0.199, plain.body.at[2]))
    section = replace(plain.wheels[0].section, radius=0.068)
    wheels = tuple(replace(wheel, section=section) for wheel in plain.wheels)
    climber = replace(plain, body=body, wheels=wheels)
    found = least_friction(climber, profile, 15)
    worst = max(found.demands, key=lambda each: each.mu.max())
    k = int(worst.mu.argmax())
    path = sample(climber, profile, worst.leg, worst.s[k : k + 1])
    assert_least(path.matrix[0], path.load[0], found.mu, 1 - 1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "joint", "expected", "within"),
    [
        ("ramp", 0.0, [0.323], 0.005),
        ("50 mm", 0.0, [0.460, 0.543, 0.540], 0.002),
        ("90 mm", 0.0, [0.579, 0.630, 0.710], 0.002),
        ("90 mm", 0.06, [0.68], 0.01),
        ("90 mm", 0.126, [0.90], 0.01),
    ],
)
def test_friction_that_a_climb_needs(name, joint, expected, within):
    found = friction(name, joint)
    assert found.mu == pytest.approx(max(expected), abs=within)
    assert tuple(each.leg.axle for each in found.demands) == ORDER
    if len(expected) == 3:
        assert_allclose([each.mu.max() for each in found.demands], expected, atol=within)


@pytest.mark.slow
def test_worst_configuration_is_found_between_the_samples():
    fine, coarse = (friction("90 mm", samples=n) for n in (161, 15))
    assert_allclose(coarse.mu, fine.mu, rtol=1e-3)
    rear = fine.demands[2]
    assert rear.mu.max() == fine.mu
    assert rear.leg.top / 20 < rear.s[rear.mu.argmax()] < rear.leg.top / 2


def test_no_friction_is_enough_where_the_front_body_stands_up():
    found = friction("128 mm", 0.126)
    front = found.demands[0]
    assert np.isinf(found.mu)
    assert np.isnan(front.normal[np.isinf(front.mu)]).all()


@pytest.mark.slow
def test_highest_step_for_a_friction():
    """About 29 mm with the friction of the paper's table; 90 mm is out of its reach."""
    low, high = (least_friction(CLIMBER, step(height)).mu for height in (0.028, 0.030))
    assert low < 0.4 < high


# Time scaling


@cache
def solved(name, leg, cost="time", mu=None, joint=0.0, **options):
    """Return the plan of a leg and its history."""
    climber, profile, found = ways(name, joint)
    plan = contact_path.climb(climber, profile, found[leg][0], cost, mu=mu, **options)
    return plan, contact_path.history(plan, solve_nlp(plan.nlp).unknowns)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("ramp", (0.251, 0.323, 0.249)),
        ("50 mm", (0.460, 0.542, 0.539)),
        ("90 mm", (0.579, 0.630, 0.677)),
        ("128 mm", (0.579, 0.608, 0.624)),
    ],
)
def test_least_friction_of_plans(name, expected):
    """A slow climb may be planned, so that no plan needs more; momentum saves some of it."""
    for leg, (least, slow) in enumerate(zip(expected, friction(name).demands, strict=True)):
        plan, told = solved(name, leg, "friction")
        assert plan.nodes.s.size == 60
        assert told.mu == pytest.approx(least, abs=0.01)
        assert told.mu < slow.mu.max() + 3e-4
        assert (np.abs(told.friction) <= told.mu * told.load + 1e-5).all()


@pytest.mark.slow
def test_speed_saves_friction():
    slow = friction("90 mm").demands[2].mu.max()
    assert solved("90 mm", 2, "friction")[1].mu < slow - 0.03
    assert_allclose(solved("90 mm", 2, "friction", speed=1e-3, s=480)[1].mu, slow, atol=2e-3)


@pytest.mark.slow
def test_meshes_converge():
    coarse, fine = (solved("90 mm", 2, "friction", s=n)[1].mu for n in (60, 240))
    assert_allclose(coarse, fine, atol=5e-4)
    times = [solved("90 mm", 2, mu=0.7, s=n)[1].duration for n in (60, 240)]
    assert_allclose(*times, rtol=3e-3)


@pytest.mark.slow
@pytest.mark.parametrize(("leg", "seconds"), [(0, 0.63), (1, 0.73), (2, 0.89)])
def test_least_time(leg, seconds):
    """On the nodes of the study: 60 from 0.2 to 99.8 % of the climbing axle's rise."""
    wheels = tuple(replace(wheel, inertia=(1e-12, 1e-12)) for wheel in CLIMBER.wheels)
    light, axle = replace(CLIMBER, wheels=wheels), AXLES.index(ORDER[leg])
    way = legs(light, STEP)[leg]

    def risen(s, part):
        height = sample(light, STEP, way, np.array([s])).axles[0, axle, 1]
        return height - RADIUS - part * 0.09

    low, high = (brentq(risen, 0, way.length, (part,)) for part in (0.002, 0.998))
    nodes = low + (high - low) * np.linspace(0, 1, 60) ** 2
    least = contact_path.climb(light, STEP, way, "friction", s=nodes)
    mu = 1.03 * contact_path.history(least, solve_nlp(least.nlp).unknowns).mu
    plan = contact_path.climb(light, STEP, way, mu=mu, s=nodes)
    assert abs(contact_path.history(plan, solve_nlp(plan.nlp).unknowns).duration - seconds) < 0.01


@cache
def lagrange(climber):
    """Return ``(q, v) ->`` mass matrix, and other terms, of both bodies, and the axles' Jacobian.

    From the energies, in a form of its own: nothing of the package but the vehicle's figures.
    """
    q, v = ca.SX.sym("q", 4), ca.SX.sym("v", 4)
    kinetic, height = ca.SX(0), ca.SX(0)
    for body, tilt in ((climber.body, q[2]), (climber.joints[0].body, q[3])):
        turn = ca.vertcat(
            ca.horzcat(ca.cos(tilt), -ca.sin(tilt)), ca.horzcat(ca.sin(tilt), ca.cos(tilt))
        )
        center = q[:2] + turn @ ca.vertcat(*body.at[1:])
        kinetic += body.mass * ca.sumsqr(ca.jtimes(center, q, v)) / 2
        kinetic += body.inertia[0] * ca.jtimes(tilt, q, v) ** 2 / 2
        height += 9.81 * body.mass * center[1]
    momentum = ca.gradient(kinetic, v)
    rest = ca.jtimes(momentum, q, v) - ca.gradient(kinetic - height, q)
    places = [
        q[:2] + wheel.at[1] * ca.vertcat(ca.cos(q[k]), ca.sin(q[k]))
        for wheel, k in zip(climber.wheels, (2, 2, 3), strict=True)
    ]
    results = [ca.jacobian(momentum, v), rest, ca.jacobian(ca.vertcat(*places), q)]
    return ca.Function("lagrange", [q, v], results)


@pytest.mark.slow
@pytest.mark.parametrize("joint", [0.0, 0.06])
@pytest.mark.parametrize("leg", [0, 1, 2])
def test_equations_of_motion(leg, joint):
    """Forces and torques of a plan are those of Lagrange's equations and of every wheel's spin."""
    plan, told = solved("90 mm", leg, mu=0.8, joint=joint)
    middles, terms = plan.middles, lagrange(plan.climber)
    for k in range(0, told.t.size, 7):
        speed, change, torque = told.path_speed[k], told.path_acceleration[k], told.torque[k]
        mass, rest, slopes = map(np.array, terms(middles.q[k], middles.first[k] * speed))
        acceleration = middles.first[k] * change + middles.second[k] * speed**2
        normal = middles.normals[k]
        along = np.stack([normal[:, 1], -normal[:, 0]], axis=1)
        pushed = (told.load[k][:, None] * normal + told.friction[k][:, None] * along).ravel()
        reaction = np.array([0, 0, torque[0] + torque[1], torque[2]])
        assert_allclose(
            mass @ acceleration + rest.ravel(), slopes.T @ pushed + reaction, atol=1e-6 * WEIGHT
        )
        spun = (middles.speeds[k] * change + middles.slopes[k] * speed**2) / RADIUS
        assert_allclose(SPINS * spun, torque - RADIUS * told.friction[k], atol=1e-9)


def status_of(nlp, mu):
    """Return the status of a linear program: for a given friction, all constraints are linear."""
    place, x = nlp.where["mu"], nlp.guess / nlp.scale
    low, high = nlp.lower / nlp.scale, nlp.upper / nlp.scale
    x[place] = low[place] = high[place] = mu
    rows, slopes = ca.Function("g", [nlp.x], [nlp.g, ca.jacobian(nlp.g, nlp.x)])(x)
    rest = np.array(slopes @ x - rows).ravel()
    limits = LinearConstraint(slopes.sparse(), nlp.g_lower + rest, nlp.g_upper + rest)
    return milp(np.zeros(x.size), constraints=limits, bounds=Bounds(low, high)).status


@pytest.mark.parametrize(("name", "leg"), [("ramp", 1), ("50 mm", 0), ("90 mm", 2), ("128 mm", 2)])
def test_least_friction_by_linear_programs(name, leg):
    plan, told = solved(name, leg, "friction")
    # the plan also pays 1e-4 /s for its duration
    for mu, status in ((told.mu + 1e-5, 0), (told.mu - 3e-4, 2)):
        assert status_of(plan.nlp, mu) == status


def test_limits_and_rests():
    plan = contact_path.climb(CLIMBER, STEP, ways("90 mm")[2][1][0], mu=0.9, halt=True)
    unknowns = solve_nlp(plan.nlp).unknowns
    told, b = contact_path.history(plan, unknowns), unknowns[plan.nlp.where["b"]]
    assert_allclose(b[[0, -1]], 0, atol=1e-12)
    assert (b[1:-1] > 0).all()
    assert_allclose(told.path_speed**2, (b[1:] + b[:-1]) / 2, rtol=1e-9)
    axles = plan.middles.speeds * told.path_speed[:, None]
    assert 0.99 * SPEED < np.abs(axles).max() < 1.02 * SPEED
    assert_allclose(axles / RADIUS, told.wheel_rate, rtol=1e-12)
    assert (told.load > -1e-6).all()
    assert (np.abs(told.friction) <= 0.9 * told.load + 1e-5).all()
    assert (np.diff(told.t, prepend=0, append=told.duration) > 0).all()


def test_torque_limits():
    free, weak = (
        solved("90 mm", 0, mu=0.9, torques=tuple(most * n for n in MOTORS))[1]
        for most in (np.inf, 2.0)
    )
    assert np.abs(free.torque / MOTORS).max() > 2.5
    assert np.abs(weak.torque / MOTORS).max() < 2.0 + 1e-6
    assert weak.duration > 1.1 * free.duration


@pytest.mark.parametrize("leg", [0, 1, 2])
def test_motors_of_4_newton_meters_need_no_more_friction(leg):
    found = solved("90 mm", leg, "friction", torques=(8.0, 4.0, 8.0))[1].mu
    assert_allclose(found, solved("90 mm", leg, "friction")[1].mu, atol=1e-3)


def test_more_friction_takes_less_time():
    durations = [solved("90 mm", 1, mu=mu)[1].duration for mu in (0.64, 0.7, 1.0)]
    assert durations[0] > durations[1] > durations[2]


def test_least_slip_creeps_less_than_least_time():
    def creep(told):
        ratios = told.friction**2 / told.load * told.path_speed[:, None]
        return (ratios * np.gradient(told.t)[:, None]).sum()

    (_, careful), (_, fast) = (solved("90 mm", 2, cost, mu=0.8) for cost in ("slip", "time"))
    assert creep(careful) < 0.8 * creep(fast)
    assert careful.duration > fast.duration


def test_a_climb_with_too_little_friction_is_refused():
    refuses(SolverError, "Infeasible", solved, "90 mm", 0, mu=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("profile", [kerb(0.05, 0.3), stairs(0.09, 0.3, 2)])
def test_whole_climbs(profile):
    """From kink to kink at rest: over a kerb and down again, and up stairs."""
    for each in least_friction(CLIMBER, profile, 15).demands:
        plan = contact_path.climb(CLIMBER, profile, each.leg, "friction", halt=True, s=40)
        assert contact_path.history(plan, solve_nlp(plan.nlp).unknowns).mu < each.mu.max() + 2e-3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"cost": "comfort"}, "found the cost .comfort."),
        ({"cost": "time"}, "coefficient of friction"),
        ({"cost": "friction", "mu": 0.5}, "without one; found"),
        ({"mu": 0.8, "s": [0.0, 0.02, 0.01]}, "increasing nodes"),
        ({"mu": 0.8, "speed": 0.0}, "expected positive numbers for .speed."),
    ],
)
def test_wrong_questions(options, words):
    refuses(ModelError, words, contact_path.climb, CLIMBER, STEP, ways("90 mm")[2][0][0], **options)


def test_programs_are_solved_in_their_own_units(monkeypatch):
    x, infinite = ca.MX.sym("x", 2), np.array([np.inf])
    program = Nlp(
        x,
        ca.sumsqr(x * ca.DM([2.0, 3.0]) - ca.DM([4.0, 5.0])),
        x[0] * 2 + x[1] * 3,
        np.zeros(2),
        np.array([2.0, 3.0]),
        np.array([-np.inf, 0.0]),
        np.array([np.inf, 3.5]),
        -infinite,
        np.array([7.0]),
        {"both": np.array([0, 1])},
    )
    found = solve_nlp(program)
    assert_allclose(found.unknowns, [3.5, 3.5], atol=1e-6)
    assert_allclose(found.rows, 7.0, atol=1e-6)
    monkeypatch.setattr(ipopt, "MAX_ITERATIONS", 1)
    refuses(SolverError, "Maximum_Iterations", solve_nlp, program)


# Tracking


def driven(control, mu, part=0.75, until=13.0):
    motion = driven_climb(STEP, control, Grip(mu, part * mu), until=until)
    return motion, obstacle_ending(motion.run, motion.vehicle, placed(STEP)).name


def test_a_course_is_the_plan_over_the_progress():
    track, starts = planned(STEP, 0.7), 0
    assert (np.diff(track.p) > 0).all()
    for plan, unknowns in solved_legs(STEP, 0.7):
        told, middles = contact_path.history(plan, unknowns), plan.middles
        p = contact_path.progress(middles)
        columns = ("torques", told.torque), ("directions", None), ("speeds", middles.speeds)
        for name, expected in columns:
            found = np.stack([np.interp(p, track.p, each) for each in getattr(track, name).T])
            if expected is None:  # as the axles' velocities say, by differences of their places
                slopes = np.gradient(middles.axles, axis=0)[1:-1]
                angles = np.arctan2(slopes[..., 1], slopes[..., 0])
                assert_allclose(found.T[1:-1], angles, atol=0.03)
            else:
                assert_allclose(found.T, expected, atol=1e-9)
        # legs rest where they meet, and their torques differ there
        if starts:
            assert_allclose(track.square[[starts - 1, starts]], 0, atol=1e-9)
            assert_allclose(track.p[starts], track.p[starts - 1], atol=1e-4)
            assert np.abs(track.torques[starts] - track.torques[starts - 1]).max() > 0.5
        starts += 2 * plan.nodes.s.size - 1
    assert_allclose(track.square[[0, -2, -1]] > 0, [False, True, True])


def test_unusable_trackings_are_refused():
    plan, unknowns = solved_legs(STEP, 0.7)[2]
    backwards = replace(plan, nodes=plan.nodes._replace(axles=plan.nodes.axles[::-1]))
    with pytest.raises(ModelError, match=r"mean of x . z.*decrease at -?0\.\d+ m"):
        contact_path.tracked_plan([(backwards, unknowns)])
    for name in ("proportional", "spare", "lead"):
        with pytest.raises(ModelError, match=f"Tracking: {name}: expected a number > 0, found 0"):
            contact_path.Tracking(planned(STEP, 0.7), **{name: 0.0})


@pytest.mark.slow
def test_a_tracked_plan_climbs_with_less_friction_than_references():
    """Least friction of both, to 0.005: 0.715 and 0.785."""
    assert driven(tracking(STEP, 0.725), 0.725)[1] == "climbs"
    refuses(SolverError, "no solution", tracking, STEP, 0.70)
    assert driven(contact_path.Tracking(planned(STEP, 0.7)), 0.68)[1] == "stalls"
    for control in (FIXED, SENSED):
        assert driven(control, 0.76, until=6.0)[1] != "climbs"


@pytest.mark.slow
def test_a_plan_of_least_friction_need_not_know_the_friction():
    control = contact_path.Tracking(planned(STEP))
    assert driven(control, 0.74)[1] == "climbs"
    assert driven(control, 1.0, until=7.0)[1] == "climbs"


def test_motion_and_torques_are_those_planned():
    control = contact_path.Tracking(planned(STEP, 0.7))
    motion, _ = driven(control, 1.0, part=1.0)
    run, track = motion.run, control.plan
    p = (run["center_y"] + run["center_z"]).mean(axis=1) + control.lead
    on = (p > track.p[0]) & (p < track.p[-1])
    speed = np.sqrt(np.interp(p, track.p, track.square))
    moving, going = on & (speed > 0.05), axle_speeds(run, motion.vehicle)
    for k, axle in enumerate(AXLES):
        aim = speed * np.interp(p, track.p, track.speeds[:, k])
        assert np.sqrt(np.mean((going[:, k] - aim)[moving] ** 2)) < 0.02
        torque = np.interp(p, track.p, track.torques[:, k]) / MOTORS[k]
        back = control.proportional * (run["reference", axle] - run["spin", axle])
        assert_allclose(run["motor_torque", axle][on], (torque + back)[on], atol=0.02)
    assert motion.metrics.true_slip.max() < 0.02
    slip = RADIUS * run["reference"] - going
    assert np.quantile(slip[on], 0.99) < 1.5 * control.spare


def test_it_is_driven_at_the_speed_before_and_behind_the_plan():
    run = driven(contact_path.Tracking(planned(STEP, 0.7)), 0.9)[0].run
    assert_allclose(run["velocity_y"][-1], SPEED, atol=2e-3)
    assert run["velocity_y"][np.argmax(run["solid_gap_1", "front"] < 0)] < 0.08
