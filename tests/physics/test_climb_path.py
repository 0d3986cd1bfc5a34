"""Tests of planned climbs: equations of motion, least friction, least time, and limits.

Values with three digits are those of a separate study with its own code, whose climbs begin and
end 0.2 % of the height from floor and plateau, with wheels without rotational inertia.
"""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np
import pytest
import scipy.sparse
from numpy.testing import assert_allclose
from scipy.optimize import brentq, linprog

from helpers.climb_cases import dimensions
from slipfree.catalog.step_climber import AXLES
from slipfree.climb.contact_path import axle_arms, least_friction, legs, sample
from slipfree.climb.time_scaling import MIN_ACCELERATION, climb, history, in_sequence
from slipfree.core.errors import ModelError
from slipfree.core.nlp import Nlp
from slipfree.core.trajectory import SolverError
from slipfree.plan.ipopt import solve_nlp
from slipfree.terrain.solids import kerb, ramp, stairs, step

SPEED, WEIGHT = 0.25, 9.81 * 21.6
PROFILES = {"ramp": ramp(np.pi / 4, 0.09), **{f"{mm} mm": step(mm / 1000) for mm in (50, 90, 128)}}
LEAST = {
    "ramp": (0.251, 0.323, 0.249),
    "50 mm": (0.460, 0.542, 0.539),
    "90 mm": (0.579, 0.630, 0.677),
    "128 mm": (0.579, 0.608, 0.624),
}
ORDER = ("front", "middle", "rear")
CLIMBER = dimensions()


@cache
def way(name, climber=CLIMBER):
    return legs(climber, PROFILES[name])


@cache
def planned(name, leg, cost="time", mu=None, climber=CLIMBER, **options):
    """Return the plan of a leg and its history."""
    plan = climb(climber, PROFILES[name], way(name, climber)[leg], cost, mu=mu, **options)
    return plan, history(plan, solve_nlp(plan.nlp).unknowns)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(PROFILES))
def test_least_friction(name):
    for leg, expected in enumerate(LEAST[name]):
        plan, run = planned(name, leg, "friction")
        assert way(name)[leg].axle == ORDER[leg]
        assert plan.nodes.s.size == 60
        assert abs(run.statistics["mu"] - expected) < 0.01
        assert (np.abs(run["friction"]) <= run.statistics["mu"] * run["load"] + 1e-5).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["50 mm", "90 mm"])
def test_speed_saves_friction(name):
    """A slow climb may be planned, so that no plan needs more; momentum saves some of it."""
    slow = least_friction(CLIMBER, PROFILES[name], 25)
    most = [demand.mu for demand in slow.demands]
    found = [planned(name, leg, "friction")[1].statistics["mu"] for leg in range(3)]
    assert (np.array(found) < np.array(most) + 3e-4).all()
    if name == "90 mm":
        assert found[2] < most[2] - 0.03
    creeping = planned(name, 2, "friction", speed=1e-3, s=480)[1].statistics["mu"]
    assert_allclose(creeping, most[2], atol=2e-3)


@pytest.mark.slow
def test_meshes_converge():
    coarse, fine = (
        planned("90 mm", leg, "friction", s=n)[1].statistics["mu"] for leg, n in ((2, 60), (2, 240))
    )
    assert_allclose(coarse, fine, atol=5e-4)
    times = [planned("90 mm", 2, mu=0.7, s=n)[1].statistics["duration"] for n in (60, 240)]
    assert_allclose(*times, rtol=3e-3)


def nodes_of_the_study(name, leg, height, climber):
    """Return 60 nodes from 0.2 to 99.8 % of the climbing axle's rise."""
    axle, profile = AXLES.index(ORDER[leg]), PROFILES[name]

    def risen(s, part):
        q = sample(climber, profile, way(name, climber)[leg], np.array([s])).q
        return q[0, 1] + axle_arms(climber, q)[0, axle, 1] - climber.radius - part * height

    low, high = (
        brentq(risen, 0, way(name, climber)[leg].length, (part,)) for part in (0.002, 0.998)
    )
    return low + (high - low) * np.linspace(0, 1, 60) ** 2


@pytest.mark.slow
@pytest.mark.parametrize(("leg", "seconds"), [(0, 0.63), (1, 0.73), (2, 0.89)])
def test_least_time(leg, seconds):
    light = CLIMBER._replace(
        **{name: getattr(CLIMBER, name)._replace(inertia=1e-12) for name in AXLES}
    )
    nodes = nodes_of_the_study("90 mm", leg, 0.09, light)
    track = way("90 mm", light)[leg]
    least = climb(light, PROFILES["90 mm"], track, "friction", s=nodes)
    mu = 1.03 * history(least, solve_nlp(least.nlp).unknowns).statistics["mu"]
    plan = climb(light, PROFILES["90 mm"], track, mu=mu, s=nodes)
    assert abs(history(plan, solve_nlp(plan.nlp).unknowns).statistics["duration"] - seconds) < 0.01


def lagrange(climber):
    """Return ``(q, v) ->`` mass matrix, and other terms, of both bodies, and the axles' Jacobian.

    From the energies, in a form of its own: nothing of the package but the vehicle's figures.
    """
    q, v = ca.SX.sym("q", 4), ca.SX.sym("v", 4)
    kinetic, height = ca.SX(0), ca.SX(0)
    for body, tilt in ((climber.rear_body, q[2]), (climber.front_body, q[3])):
        turn = ca.vertcat(
            ca.horzcat(ca.cos(tilt), -ca.sin(tilt)), ca.horzcat(ca.sin(tilt), ca.cos(tilt))
        )
        center = q[:2] + turn @ ca.vertcat(body.ahead, body.above)
        kinetic += body.mass * ca.sumsqr(ca.jtimes(center, q, v)) / 2
        kinetic += body.inertia * ca.jtimes(tilt, q, v) ** 2 / 2
        height += 9.81 * body.mass * center[1]
    momentum = ca.gradient(kinetic, v)
    rest = ca.jtimes(momentum, q, v) - ca.gradient(kinetic - height, q)
    places = [
        q[:2] + axle.ahead * ca.vertcat(ca.cos(q[k]), ca.sin(q[k]))
        for axle, k in zip(climber.axles, (2, 2, 3), strict=True)
    ]
    return ca.Function(
        "lagrange",
        [q, v],
        [
            ca.jacobian(momentum, v),
            rest,
            ca.jacobian(ca.vertcat(*places), q),
            kinetic + height,
        ],
    )


@pytest.mark.slow
@pytest.mark.parametrize("joint", [0.0, 0.06])
@pytest.mark.parametrize("leg", [0, 1, 2])
def test_equations_of_motion(leg, joint):
    """Forces and torques of a plan are those of Lagrange's equations and of every wheel's spin."""
    climber = dimensions(joint)
    plan, run = planned("90 mm", leg, mu=0.8, climber=climber)
    middles, terms = plan.middles, lagrange(climber)
    torque = run["torque"]
    spin = np.array([axle.inertia for axle in climber.axles])
    for k in range(0, run.t.size, 7):
        speed, change = run["path_speed"][k], run["path_acceleration"][k]
        mass, rest, slopes, _ = map(np.array, terms(middles.q[k], middles.first[k] * speed))
        acceleration = middles.first[k] * change + middles.second[k] * speed**2
        normal = middles.normals[k]
        along = np.stack([normal[:, 1], -normal[:, 0]], axis=1)
        pushed = (run["load"][k][:, None] * normal + run["friction"][k][:, None] * along).ravel()
        reaction = np.array([0, 0, torque[k, 0] + torque[k, 1], torque[k, 2]])
        assert_allclose(
            mass @ acceleration + rest.ravel(), slopes.T @ pushed + reaction, atol=1e-6 * WEIGHT
        )
        spun = (middles.speeds[k] * change + middles.slopes[k] * speed**2) / climber.radius
        assert_allclose(spin * spun, torque[k] - climber.radius * run["friction"][k], atol=1e-9)


def test_energy():
    """The motors' work is what the energy of bodies and wheels grows by."""
    plan, run = planned("90 mm", 2, mu=0.75, s=240)
    terms, spin = lagrange(CLIMBER), [axle.inertia for axle in CLIMBER.axles]

    def energy(k):
        bodies = terms(plan.middles.q[k], plan.middles.first[k] * run["path_speed"][k])[3]
        return float(bodies) + (spin * run["wheel_rate"][k] ** 2).sum() / 2

    tilting = plan.middles.first[:, [2, 2, 3]] * run["path_speed"][:, None]
    power = (run["torque"] * (run["wheel_rate"] + tilting)).sum(axis=1)
    work = ((power[1:] + power[:-1]) / 2 * np.diff(run.t)).sum()
    assert_allclose(work, energy(-1) - energy(0), rtol=1e-3)
    climbed = plan.middles.q[-1, 1] - plan.middles.q[0, 1]
    assert 0.9 * 9.81 * 13.8 * 0.081 / 0.215 * 0.09 < work < WEIGHT * max(climbed, 0.09)


def linear(plan, speed):
    """Return matrices of linear programs ``A x = b, C(mu) x <= 0`` in b, a, and the forces.

    The plan's intervals with Lagrange's equations, a separate transcription.
    """
    climber, middles, steps = plan.climber, plan.middles, np.diff(plan.nodes.s)
    terms, count = lagrange(climber), steps.size
    rows, values = scipy.sparse.lil_matrix((5 * count, 8 * count + 1)), np.zeros(5 * count)
    spin = np.array([axle.inertia for axle in climber.axles]) / climber.radius
    tilts = np.array([[0, 0, 1, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    for k in range(count):
        b, a, forces = [k, k + 1], count + 1 + k, 2 * count + 1 + 6 * k + np.arange(6)
        mass, rest, slopes, _ = map(np.array, terms(middles.q[k], middles.first[k]))
        weight = np.array(terms(middles.q[k], np.zeros(4))[1]).ravel()
        row = slice(5 * k, 5 * k + 4)
        spun = (spin * middles.slopes[k]) @ tilts
        per_b = mass @ middles.second[k] + rest.ravel() - weight - spun
        rows[row, b] = np.stack([per_b, per_b], axis=1) / 2
        rows[row, a] = (mass @ middles.first[k] - (spin * middles.speeds[k]) @ tilts)[:, None]
        for i, normal in enumerate(middles.normals[k]):
            place = slopes[2 * i : 2 * i + 2].T
            rows[row, forces[i]] = -(place @ normal)[:, None]
            along = np.array([normal[1], -normal[0]])
            rows[row, forces[3 + i]] = -(place @ along + climber.radius * tilts[i])[:, None]
        values[row] = -weight
        rows[5 * k + 4, b], rows[5 * k + 4, a] = [-1, 1], -2 * steps[k]
    top = speed**2 / (plan.nodes.speeds**2).max(axis=1)
    low = np.minimum(2 * MIN_ACCELERATION * plan.nodes.s, 1e-4 * speed**2)
    bounds = [(0, 0), *zip(low[1:], top[1:], strict=True), *[(None, None)] * (7 * count)]
    return rows.tocsr(), values, bounds


def friction_rows(count, mu):
    one = np.block([[-mu * np.eye(3), np.eye(3)], [-mu * np.eye(3), -np.eye(3)]])
    cones = scipy.sparse.block_diag([one] * count)
    return scipy.sparse.hstack([scipy.sparse.csr_matrix((6 * count, 2 * count + 1)), cones]).tocsr()


@pytest.mark.parametrize(("name", "leg"), [("ramp", 1), ("50 mm", 0), ("90 mm", 2), ("128 mm", 2)])
def test_least_friction_by_linear_programs(name, leg):
    plan, run = planned(name, leg, "friction")
    rows, values, bounds = linear(plan, SPEED)
    count, mu = run.t.size, run.statistics["mu"]

    def climbs(mu):
        cones = friction_rows(count, mu)
        none = np.zeros(cones.shape[0])
        return linprog(np.zeros(rows.shape[1]), cones, none, rows, values, bounds).status == 0

    assert climbs(mu + 1e-5)
    assert not climbs(mu - 3e-4)  # the plan also pays 1e-4 /s for its duration


def test_limits_and_rests():
    plan = climb(CLIMBER, PROFILES["90 mm"], way("90 mm")[1], mu=0.9, halt=True)
    unknowns = solve_nlp(plan.nlp).unknowns
    run, b = history(plan, unknowns), unknowns[plan.nlp.where["b"]]
    assert_allclose(b[[0, -1]], 0, atol=1e-12)
    assert (b[1:-1] > 0).all()
    assert_allclose(run["path_speed"] ** 2, (b[1:] + b[:-1]) / 2, rtol=1e-9)
    axles = plan.middles.speeds * run["path_speed"][:, None]
    assert (np.abs(axles) < SPEED * 1.02).all()
    assert np.abs(axles).max() > 0.99 * SPEED
    assert_allclose(axles / CLIMBER.radius, run["wheel_rate"], rtol=1e-12)
    assert (run["load"] > -1e-6).all()
    assert (np.abs(run["friction"]) <= 0.9 * run["load"] + 1e-5).all()
    assert (np.diff(run.t) > 0).all()
    assert 0 < run.t[0] < run.t[-1] < run.statistics["duration"]


def test_torque_limits():
    free, weak = (
        planned("90 mm", 0, mu=0.9, torques=(2 * most, most, 2 * most))[1] for most in (np.inf, 2.0)
    )
    assert np.abs(free["torque"] / (2, 1, 2)).max() > 2.5
    assert np.abs(weak["torque"] / (2, 1, 2)).max() < 2.0 + 1e-6
    assert weak.statistics["duration"] > 1.1 * free.statistics["duration"]


@pytest.mark.parametrize("leg", [0, 1, 2])
def test_motors_of_4_newton_meters_need_no_more_friction(leg):
    found = planned("90 mm", leg, "friction", torques=(8.0, 4.0, 8.0))[1].statistics["mu"]
    assert_allclose(found, planned("90 mm", leg, "friction")[1].statistics["mu"], atol=1e-3)


def test_more_friction_takes_less_time():
    durations = [planned("90 mm", 1, mu=mu)[1].statistics["duration"] for mu in (0.64, 0.7, 1.0)]
    assert durations[0] > durations[1] > durations[2]


def test_least_slip_creeps_less_than_least_time():
    def creep(run):
        return (
            run["friction"] ** 2
            / run["load"]
            * run["path_speed"][:, None]
            * np.gradient(run.t)[:, None]
        ).sum()

    (_, careful), (_, fast) = (planned("90 mm", 2, cost, mu=0.8) for cost in ("slip", "time"))
    assert creep(careful) < 0.8 * creep(fast)
    assert careful.statistics["duration"] > fast.statistics["duration"]


def test_a_climb_with_too_little_friction_is_refused():
    with pytest.raises(SolverError, match="Infeasible"):
        planned("90 mm", 0, mu=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("profile", [kerb(0.05, 0.3), stairs(0.09, 0.3, 2)])
def test_whole_climbs(profile):
    """From kink to kink at rest: over a kerb and down again, and up stairs."""
    found = legs(CLIMBER, profile)
    slow = least_friction(CLIMBER, profile, 15)
    runs = []
    for leg, demand in zip(found, slow.demands, strict=True):
        plan = climb(CLIMBER, profile, leg, "friction", halt=True, s=40)
        runs.append(history(plan, solve_nlp(plan.nlp).unknowns))
        assert runs[-1].statistics["mu"] < demand.mu + 2e-3
    whole = in_sequence(runs)
    assert (np.diff(whole.t) > 0).all()
    assert_allclose(whole.statistics["duration"], sum(run.statistics["duration"] for run in runs))
    assert whole.statistics["mu"] == max(run.statistics["mu"] for run in runs)
    first, last = (
        sample(CLIMBER, profile, leg, np.array([s])).q[0, 0]
        for leg, s in ((found[0], 0.0), (found[-1], found[-1].length))
    )
    assert_allclose(whole["y"][[0, -1]], [first, last], atol=1e-3)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"cost": "comfort"}, "found the cost .comfort."),
        ({"cost": "time"}, "coefficient of friction"),
        ({"cost": "friction", "mu": 0.5}, "without one; found"),
        ({"cost": "time", "mu": 0.8, "s": [0.0, 0.02, 0.01]}, "increasing nodes"),
        (
            {"cost": "time", "mu": 0.8, "speed": 0.0},
            "expected positive numbers for .speed.",
        ),
    ],
)
def test_wrong_questions(options, words):
    with pytest.raises(ModelError, match=words):
        climb(CLIMBER, PROFILES["90 mm"], way("90 mm")[0], **options)


def test_programs_are_solved_in_their_own_units():
    x = ca.MX.sym("x", 2)
    program = Nlp(
        x,
        ca.sumsqr(x * ca.DM([2.0, 3.0]) - ca.DM([4.0, 5.0])),
        x[0] * 2 + x[1] * 3,
        np.zeros(2),
        np.array([2.0, 3.0]),
        np.array([-np.inf, 0.0]),
        np.array([np.inf, 3.5]),
        np.array([-np.inf]),
        np.array([7.0]),
        {"both": np.array([0, 1])},
    )
    found = solve_nlp(program)
    assert_allclose(found.unknowns, [3.5, 3.5], atol=1e-6)
    assert_allclose(found.rows, 7.0, atol=1e-6)
    with pytest.raises(SolverError, match="Maximum_Iterations"):
        solve_nlp(program, iterations=1)
