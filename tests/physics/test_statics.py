"""Tests of forces against balances of free bodies, closed forms and invariances.

Forces are checked only with the recorded coordinates and contact points: positions and axes of all
parts are computed again, every part is cut free, and its forces and moments are summed.
"""

from dataclasses import replace
from functools import partial
from itertools import permutations
from types import SimpleNamespace
from typing import NamedTuple

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import make_interp_spline
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

import slipfree as sf
from helpers.cases import LIGHT, PAPER_RATES, closure_model, drive, hills
from helpers.commands import refuses
from helpers.dynamics import slope
from helpers.vehicles import four_wheels, part_frames
from slipfree.catalog import three_wheeler
from slipfree.core.lookups import LookupTable
from slipfree.core.records import leaves
from slipfree.models.base import Configuration, Dependent, VehicleState
from slipfree.models.friction_feasibility import best_utilisation
from slipfree.models.limits import tip_over_margin
from slipfree.vehicle.sections import Torus
from slipfree.vehicle.tree import actuated

G = 9.81
LA, LS, R1, R2 = 1.0, 1.5, 0.05, 0.25
R = H = R1 + R2  # of the wheels, and height of the centre of mass
RIGHT, LEFT, FRONT = 0, 1, 2
FORCES = ("force_along", "force_across", "force_normal")
OF_FORCES = (*FORCES, "friction_needed", "utilisation", "drive_torque", "power", "dissipation")
OF_FORCES += ("potential_energy", "work", "tip_over_margin")
VEHICLE = three_wheeler()
WEIGHT = 36 * G
HILLS = sf.Analytic(hills)
PATCHY = sf.Analytic(hills, mu=lambda x, y: 0.6 + 0.2 * ca.sin(2.0 * x) * ca.cos(1.5 * y))
POSES = [
    {"x": 0.3, "y": -0.2, "heading": 0.4, "tilt_right": 0.2, "tilt_left": -0.15, "steer": 0.3},
    {"x": -1.0, "y": 1.4, "heading": 2.0, "tilt_right": -0.3, "tilt_left": -0.25, "steer": -0.5},
    {"x": 2.1, "y": 0.8, "heading": -1.2, "tilt_right": 0.4, "tilt_left": 0.35, "steer": 0.9},
    {"x": -2.0, "y": -1.7, "heading": 3.0, "tilt_right": 0.0, "tilt_left": 0.3, "steer": -0.1},
]
MASS = {"mass": 20.0, "center_of_mass": (0.1, -0.05, 0.2), "wheel_mass": 3.0}
SLID = [{"x": 0.4, "heading": 0.7, "slide_right": 0.1, "steer": -0.3}]


def terrace(drop):
    """Return ground that is level at either axle, higher by ``drop`` at the rear one."""
    return sf.Analytic(lambda _, y: drop / 2 * (1 - ca.tanh(40 * (y - LS / 6))))


def stand(vehicle, ground, *, slip=sf.LeastSlip(), **start):  # noqa: B008
    return sf.settle(closure_model(vehicle, ground, slip=slip), **start)


def forces(run, k=0):
    """Return along, across, normal of every wheel, one after the other."""
    return np.column_stack([run[name][k] for name in FORCES]).ravel()


def normal(ground, x, y, step=5e-3):
    """Return the unit normal by differences of order six."""
    ahead, weights = np.arange(-3, 4) * step, np.array([-1, 9, -45, 0, 45, -9, 1]) / (60 * step)
    rises = [
        weights @ ground.elevation(x + ahead, y + 0 * ahead),
        weights @ ground.elevation(x + 0 * ahead, y + ahead),
    ]
    return np.array([-rises[0], -rises[1], 1]) / np.hypot(np.hypot(*rises), 1)


class Balance(NamedTuple):
    """What contact forces (along, across, normal by wheel) do, and what else acts.

    ``rows`` and ``load`` belong to the freedoms: forces and moments on the whole, moments about
    free joints on what they carry, moments about the axles of free wheels. ``held`` are the same
    by name for commanded joints, ``axles`` moments about all axles.
    """

    rows: np.ndarray
    load: np.ndarray
    held: dict
    axles: np.ndarray

    def solved(self):
        return np.linalg.solve(self.rows, -self.load)

    def left(self, found):
        return np.abs(self.rows @ found + self.load).max() / np.abs(self.load).max()


def balance(vehicle, ground, run, k=0):
    """Cut the parts of a vehicle free at a sample."""
    found = part_frames(vehicle, run).items()
    parts = {name: (turn[k].as_matrix(), place[k]) for name, (place, turn) in found}
    chain, joints = {"platform": ()}, {}
    for joint in vehicle.joints:
        axis = parts[joint.parent][0][:, "xyz".index(joint.axis)]
        chain[joint.name] = (*chain[joint.parent], joint.name)
        joints[joint.name] = axis, parts[joint.name][1], joint.motion == "turn"
    bodies = [("platform", vehicle.body), *((j.name, j.body) for j in vehicle.joints)]
    bodies += [(wheel.parent, sf.Body(wheel.mass, wheel.at)) for wheel in vehicle.wheels]
    frames, points, hubs = [], [], []
    for i, wheel in enumerate(vehicle.wheels):
        base, origin = parts[wheel.parent]
        point = np.array([run[f"contact_{name}"][k, i] for name in "xyz"])
        up, axle = normal(ground, *point[:2]), base[:, 0]
        forward = np.cross(up, axle) / np.linalg.norm(np.cross(up, axle))
        frames.append(np.column_stack([forward, np.cross(forward, up), up]))
        points.append(point)
        hubs.append((axle, origin + base @ wheel.at))

    def act(axis, pivot, turns, carried):
        """Return force or moment: row of the contact forces, and what gravity adds."""

        def lever(point):
            return np.cross(axis, point - pivot) if turns else axis

        row = [
            lever(points[i]) @ frames[i] if carried(wheel.parent) else np.zeros(3)
            for i, wheel in enumerate(vehicle.wheels)
        ]
        weight = sum(
            -G * body.mass * lever(parts[part][1] + parts[part][0] @ body.at)[2]
            for part, body in bodies
            if carried(part)
        )
        return np.concatenate(row), weight

    def on_joints(name):
        acts = [
            act(*joints[j.name], lambda part, j=j: j.name in chain[part])
            for j in vehicle.joints
            if j.value == name
        ]
        return sum(row for row, _ in acts), sum(weight for _, weight in acts)

    axles = np.zeros((len(hubs), 3 * len(hubs)))
    for i, (axle, hub) in enumerate(hubs):
        axles[i, 3 * i : 3 * i + 3] = np.cross(axle, points[i] - hub) @ frames[i]
    acts = [
        act(axis, parts["platform"][1], turns, lambda _: True)
        for turns in (False, True)
        for axis in np.eye(3)
    ]
    held = {}
    for c in vehicle.coordinates:
        row, weight = on_joints(c.name)
        if c.kind == "commanded":
            held[c.name] = row, weight
            continue
        spring = c.stiffness * (run[c.name][k] - c.rest) + c.damping * run[f"{c.name}_rate"][k]
        acts.append((row, weight - spring))
    acts += [(axles[i], 0.0) for i, wheel in enumerate(vehicle.wheels) if not wheel.driven]
    rows, load = zip(*acts, strict=True)
    return Balance(np.array(rows), np.array(load), held, axles)


def loaded(*, stiffness=0.0, rest=0.0, damping=0.0):
    """Return a four-wheeler whose front axle rocks, with mass everywhere."""
    bare = four_wheels(rock=True)
    rock = replace(bare.coordinates[0], stiffness=stiffness, rest=rest, damping=damping)
    axle = replace(bare.joints[0], body=sf.Body(4.0, (0.02, 0.0, -0.03)))
    knuckles = [replace(j, body=sf.Body(0.5, (0.01, 0.02, 0.0))) for j in bare.joints[1:]]
    return replace(
        bare,
        coordinates=(rock, bare.coordinates[1]),
        joints=(axle, *knuckles),
        wheels=tuple(replace(w, mass=1.5, grip=0.8 + 0.1 * i) for i, w in enumerate(bare.wheels)),
        body=sf.Body(40.0, (0.03, 0.3, 0.1)),
    )


# Closed forms


@pytest.mark.parametrize(("heading", "sign"), [(0.0, 1), (np.pi, -1)])
def test_friction_needed_straight_up_and_down(heading, sign):
    steep = np.tan(np.radians(20))
    run = stand(VEHICLE, slope(20), heading=heading)
    expected = steep / (2 / 3 + sign * H / LS * steep)
    assert_allclose(run["friction_needed"][0], [expected, expected, 0], rtol=0, atol=1e-12)
    push = sign * np.sin(np.radians(20)) / 2
    assert_allclose(run["force_along"][0] / WEIGHT, [push, push, 0], rtol=0, atol=1e-12)
    assert_allclose(run["drive_torque"][0] / WEIGHT, [push * R, push * R, 0], atol=1e-12)


@pytest.mark.parametrize("side", [1, -1], ids=["uphill right", "uphill left"])
def test_friction_needed_across(side):
    """The front wheel bears all of the side force; the drives hold its moment."""
    s = np.radians(20)
    run = stand(VEHICLE, slope(20), heading=side * np.pi / 2)
    assert_allclose(run["friction_needed", "front"][0], 3 * np.tan(s), rtol=0, atol=1e-12)
    across = np.array([0, 0, side * np.sin(s)])
    along = np.array([1, -1, 0]) * side * np.sin(s) * (2 * LS / 3) / (2 * LA)
    bears = np.cos(s) / 3 - np.array([1, -1, 0]) * side * H * np.sin(s) / (2 * LA)
    for name, expected in zip(FORCES, (along, across, bears), strict=True):
        assert_allclose(run[name][0] / WEIGHT, expected, rtol=0, atol=1e-12)


# The free bodies of the three-wheeler


@pytest.mark.slow
@pytest.mark.parametrize(
    ("vehicle", "poses"),
    [
        (VEHICLE, POSES),
        (three_wheeler(stiffness=25.0, **MASS), POSES),
        (three_wheeler(r1=0.0), POSES),
        (three_wheeler(axle="sliding", stiffness=300.0, **MASS), SLID),
        (three_wheeler(axle="prismatic_undriven", stiffness=300.0, **MASS), SLID),
    ],
    ids=["paper's", "sprung, off its centre", "discs", "sliding", "sliding, undriven"],
)
def test_forces_and_torques_balance_the_free_bodies(vehicle, poses):
    for pose in poses:
        run = stand(vehicle, HILLS, **pose)
        found = balance(vehicle, HILLS, run)
        assert np.abs(forces(run) - found.solved()).max() < 1e-10 * vehicle.mass * G
        assert_allclose(run["drive_torque"][0], found.axles @ forces(run), atol=1e-10 * WEIGHT)
        row, weight = found.held["steer"]
        assert_allclose(run["steer_torque"][0], -(row @ forces(run) + weight), atol=1e-10 * WEIGHT)
        assert abs(run["steer_torque"][0]) > 1e-3


def test_ratios_of_the_forces():
    run = stand(three_wheeler(grip=0.7), PATCHY, **POSES[0])
    needed = np.hypot(run["force_along"], run["force_across"]) / run["force_normal"]
    assert_allclose(run["friction_needed"], needed, rtol=1e-13)
    x, y = run["contact_x"], run["contact_y"]
    offered = 0.7 * (0.6 + 0.2 * np.sin(2 * x) * np.cos(1.5 * y))
    assert_allclose(run["utilisation"], needed / offered, rtol=1e-12)


# Tipping over and lifting off

TALL = {"axle": "fixed", "center_of_mass": (0.0, 0.0, 0.9)}
H_TALL = R + 0.9 * 30 / 36
TIPPING = np.arctan(2 / 3 * LA / H_TALL)


@pytest.mark.parametrize("degrees", [0, 20])
def test_tip_over_margin_across_a_slope(degrees):
    """Angles between gravity and the planes through the centre of mass and an edge.

    The edge from the front wheel to a rear one has the normal (L, la) in the plane of the contacts,
    over the root of the sum of squares.
    """
    q, zeta = np.hypot(LS, LA), np.radians(degrees)
    foot, rear = LA * (2 / 3 * LS) / q, LS / 3  # distances of the edges from the centre of mass
    downhill = foot * np.cos(zeta) - H_TALL * LS / q * np.sin(zeta)
    expected = min(
        np.arcsin(downhill / np.hypot(foot, H_TALL)),
        np.arcsin(rear * np.cos(zeta) / np.hypot(rear, H_TALL)),
    )
    for heading in (np.pi / 2, -np.pi / 2):
        run = stand(three_wheeler(**TALL), slope(degrees), heading=heading)
        assert_allclose(run["tip_over_margin"][0], expected, rtol=0, atol=1e-12)


ROWS = np.array([[-0.4, 0.4] * 4, np.repeat(np.arange(4) * 0.35, 2)])  # two rows of wheels


def margin_of_all_pairs(points, center):
    """Return the least angle of the pairs with no contact right of them or beyond their ends."""
    least = np.inf
    for i, j in permutations(range(points.shape[1]), 2):
        edge, arms = points[:, j] - points[:, i], (points.T - points[:, i])[:, :2]
        across = edge[0] * arms[:, 1] - edge[1] * arms[:, 0]
        along = arms @ edge[:2] / (edge[:2] @ edge[:2])
        on_line = np.abs(across) < 1e-12
        between = on_line & (along > -1e-12) & (along < 1 + 1e-12)
        if on_line.all() or not ((across > 1e-12) | between).all():
            continue
        arm = points[:, i] - center
        edge /= np.linalg.norm(edge)
        arm -= arm @ edge * edge
        arm /= np.linalg.norm(arm)
        inside = -np.cross(edge, arm)[2]
        # the closest direction of the half-plane is the edge's if gravity points away from it
        closest = np.arccos(abs(edge[2])) if arm[2] > 0 else np.arcsin(abs(inside))
        least = min(least, np.sign(inside) * closest)
    return least if np.isfinite(least) else -np.pi


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "places",
    [
        *(np.random.default_rng(count).standard_normal((2, count)) for count in (3, 12)),
        ROWS,
        Rotation.from_euler("z", 0.3).as_matrix()[:2, :2] @ ROWS,
        ROWS[:, ::2],  # all on one line
    ],
)
def test_tip_over_margin_is_that_of_the_polygon_around_all_contacts(places, seed):
    rng = np.random.default_rng(seed)
    heights = 0.3 * rng.standard_normal(places.shape[1])
    points = rng.permutation(np.vstack([places, heights]), axis=1)
    center = (*(points[:2].mean(axis=1) + 0.2 * rng.standard_normal(2)), 0.8)
    wheels = tuple(
        sf.Wheel(f"wheel_{k}", "platform", (*p, 0.0), Torus(R1, R2), driven=False)
        for k, p in enumerate(points.T[:, :2])
    )
    vehicle = sf.Vehicle("rover", (), (), wheels, sf.Body(10.0, center))
    contacts = [SimpleNamespace(point=ca.SX(point)) for point in points.T]
    zero = ca.SX(0)
    place = Configuration(zero, zero, zero, ()), Dependent(zero, zero, zero, (), ())
    found = tip_over_margin(VehicleState(vehicle, None, LookupTable(), *place), contacts)
    assert_allclose(float(found), margin_of_all_pairs(points, center), rtol=0, atol=1e-12)


def test_the_uphill_wheel_is_free_of_load_where_the_vehicle_tips_over():
    vehicle, start = three_wheeler(**TALL), {"heading": np.pi / 2}
    run = stand(vehicle, slope(np.degrees(TIPPING - 1e-10)), **start)
    assert 0 <= run["force_normal"][0, RIGHT] < 1e-9 * WEIGHT
    assert 0 <= run["tip_over_margin"][0] < 1e-9
    words = r"found a violation: the vehicle tips over: the line of gravity"
    refuses(sf.ModelError, words, stand, vehicle, slope(np.degrees(TIPPING + 1e-6)), **start)


@pytest.mark.slow
def test_a_vehicle_that_drives_into_tipping_stops_there():
    ground = sf.Analytic(lambda x, y: (0.35 + 0.1 * y) * x)  # ever steeper to the north
    t, rates = np.linspace(0, 23, 231), {"right_rate": 0.5, "left_rate": 0.5, "steer_rate": 0.0}
    run = drive(ground, t, vehicle=three_wheeler(**TALL), rates=rates, tolerance=1e-9)
    assert run.stop is not None
    assert run.stop.name == "tip_over"
    assert run.stop.words.startswith(
        "the vehicle tips over: the line of gravity leaves the support polygon (angle to its "
        "nearest edge)"
    )
    assert run["tip_over_margin"][-1] == pytest.approx(0, abs=1e-5)
    assert run["force_normal", "right"][-1] < 1e-4 * WEIGHT


@pytest.mark.slow
def test_a_wheel_that_a_stiff_spring_lifts_stops_the_motion_by_name():
    vehicle, ground = loaded(stiffness=400.0), sf.Analytic(lambda x, y: 0.12 * x * y**2)
    rates = {"rear_right_rate": 0.8, "rear_left_rate": 0.8, "steer_rate": 0.0}
    run = drive(ground, np.linspace(0, 8, 81), vehicle=vehicle, rates=rates, tolerance=1e-9)
    loads = run["force_normal"]
    assert run.stop is not None
    assert loads[:-1].min() > 0
    assert loads[-1].min() == pytest.approx(0, abs=1e-4 * loads[0].min())
    first = vehicle.wheels[int(loads[-1].argmin())].name
    assert run.stop.name == f"lift_off[{first}]"
    assert f"wheel {first} lifts off: equilibrium would need" in run.stop.words
    assert run["tip_over_margin"][-1] > 0.1


# Springs


@pytest.mark.parametrize("stiffness", [0.0, 30.0])
def test_sprung_tilts_by_hand(stiffness):
    """On two levels: moments about the tilt axes, and about the forward axis on the ground."""
    d = np.radians(20)
    drop, reach, lift = R2 * (1 - np.cos(d)), R2 * np.sin(d), R1 + R2 * np.cos(d)
    run = stand(three_wheeler(stiffness=stiffness), terrace(drop), tilt_right=d, tilt_left=d)
    assert abs(run["pitch"][0]) < 1e-13
    # unknown: both normal and both side forces
    system = [
        [1, 1, 0, 0],
        [-(LA - reach), LA + reach, drop, drop],
        [reach, 0, -lift, 0],
        [0, reach, 0, -lift],
    ]
    moment = stiffness * d
    right, left, *push = np.linalg.solve(system, [2 / 3 * WEIGHT, 0, moment, moment])
    expected = [right, left, WEIGHT / 3]
    assert_allclose(run["force_normal"][0], expected, rtol=0, atol=1e-11 * WEIGHT)
    expected = [*push, -sum(push)]
    assert_allclose(run["force_across"][0], expected, rtol=0, atol=1e-11 * WEIGHT)
    if stiffness == 0:
        used = run["force_across"][0] / run["force_normal"][0]
        assert_allclose(used, np.array([1, 1, -2]) * reach / lift, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_springs_and_dampers_in_suspension_by_hand():
    """On hills, on the way: what the rocker bears balances its spring and its damper."""
    vehicle = loaded(stiffness=60.0, damping=60.0, rest=0.05)
    rates = {"rear_right_rate": 2.0, "rear_left_rate": 1.8, "steer_rate": 0.1}
    ground = sf.Analytic(lambda x, y: 0.1 * ca.sin(1.3 * x) * ca.cos(0.9 * y))
    run = drive(ground, np.linspace(0, 2, 5), vehicle=vehicle, rates=rates, x=0.4, heading=0.2)
    for k in range(run.t.size):
        assert balance(vehicle, ground, run, k).left(forces(run, k)) < 1e-10


def test_elastic_stops_push_back_beyond_the_stop():
    bumped = three_wheeler(tilt_stop=0.1, bump=50.0)
    inside = stand(bumped, HILLS, tilt_right=0.09, tilt_left=-0.05)
    free = stand(VEHICLE, HILLS, tilt_right=0.09, tilt_left=-0.05)
    assert_allclose(forces(inside), forces(free), atol=1e-9)
    run = stand(bumped, HILLS, tilt_right=0.3, tilt_left=-0.25)
    found = balance(VEHICLE, HILLS, run)
    found.load[6:8] -= [50 * (0.3 - 0.1), -50 * (0.25 - 0.1)]
    assert np.abs(forces(run) - found.solved()).max() < 1e-10 * WEIGHT


# Work, power and losses

CLIMB = {"right_rate": 0.45, "left_rate": 0.44, "steer_rate": 0.0}


def grade(x, y):
    return hills(x, y) + 0.15 * y


def climb(*, axle="tilting", end=4.0, count=201, tolerance=1e-12, flags=(), **changes):
    """Drive up a grade with hills."""
    vehicle = three_wheeler(axle=axle, **changes)
    rates = CLIMB | ({"slide_right_rate": 0.01} if axle == "actuated" else {})
    given = {"vehicle": vehicle, "rates": rates, "tolerance": tolerance, "flags": flags}
    return drive(sf.Analytic(grade), np.linspace(0, end, count), **given, x=0.013, y=0.017)


def gained(run):
    return run["potential_energy"] - run["potential_energy"][0]


def lost(run):
    """Return the integral of the dissipation."""
    return make_interp_spline(run.t, run["dissipation"], k=5).antiderivative()(run.t)


def assert_power_balance(run):
    """Power is the rate of the energy, by differences of order six, and the dissipation."""
    windows = np.lib.stride_tricks.sliding_window_view(run["potential_energy"], 7)
    rate = windows @ np.array([-1, 9, -45, 0, 45, -9, 1]) / (60 * run.t[1])
    left = run["power"][3:-3] - rate - run["dissipation"][3:-3]
    assert np.abs(left).max() < 1e-6 * np.abs(run["power"]).max()


def test_without_slip_the_work_of_the_drives_is_the_energy_gained():
    run = climb(end=20.0, tolerance=1e-8)
    assert run.stop is None
    assert_allclose(gained(run)[-1], 119.9, rtol=1e-3)  # its start is known to 1 cm
    assert np.abs(run["work"] - gained(run)).max() < 1e-6 * gained(run)[-1]
    assert np.abs(run["dissipation"]).max() < 1e-9
    expected = run["drive_torque"][:, 0] * 0.45 + run["drive_torque"][:, 1] * 0.44
    assert_allclose(run["power"], expected, rtol=0, atol=1e-12)
    expected = 30 * G * run["z"] + 2 * G * run["center_z"].sum(axis=1)
    assert_allclose(run["potential_energy"], expected, rtol=1e-13)
    torque = np.abs(run["drive_torque"])
    assert_allclose(torque.max(), 16.4, rtol=0, atol=0.06)
    assert_allclose((torque @ [0.45, 0.44, 0]).max(), 9.2, rtol=0, atol=0.06)
    bears = run["force_normal"] / WEIGHT
    assert_allclose([bears.min(), bears.max()], [0.29, 0.36], rtol=0, atol=5.01e-3)


def test_work_from_samples_has_an_error_of_fourth_order():
    exact, flags = climb(), {"sampled_work": True, "states_only": True}
    rough, fine = runs = [climb(count=n, flags=flags) for n in (21, 41)]
    errors = [abs(run["work"][-1] / exact["work"][-1] - 1) for run in runs]
    assert 12 * errors[1] < errors[0] < 1e-6
    assert not climb(count=3, flags={"sampled_work": None})["work"].any()
    assert rough.statistics["steps"] < 0.7 * exact.statistics["steps"]
    assert max(abs(fine[name][-1] - exact[name][-1]) for name in ("x", "y", "heading")) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("axle", ["fixed", "prismatic", "actuated"])
def test_energy_is_gained_or_lost_by_slip(axle):
    run = climb(axle=axle)
    assert run.stop is None
    assert np.abs(run["dissipation"]).max() > 1e-3
    wrong = run["work"] - gained(run) - lost(run)
    assert np.abs(wrong).max() < 1e-6 * np.abs(lost(run)).max()
    along, across = (run[f"force_{way}"] * run[f"slip_{way}"] for way in ("along", "across"))
    assert_allclose(run["dissipation"], -(along + across).sum(axis=1), rtol=0, atol=1e-12)
    assert_power_balance(run)


@pytest.mark.slow
def test_energy_is_gained_or_lost_by_dampers():
    run = climb(damping=5.0, stiffness=40.0)
    rates = run["tilt_right_rate"] ** 2 + run["tilt_left_rate"] ** 2
    assert_allclose(run["dissipation"], 5.0 * rates, rtol=0, atol=1e-10)
    wrong = run["work"] - gained(run) - lost(run)
    # Integrated at 1e-12: judged by the energy that is exchanged, 1e4 times what is lost.
    assert np.abs(wrong).max() < 1e3 * 1e-12 * np.abs(run["work"]).max()
    assert_power_balance(run)


# Vehicles whose forces equilibrium leaves open

OPEN = {
    "fixed": (three_wheeler(axle="fixed", **MASS), {"x": 0.4, "heading": 0.8, "steer": 0.3}),
    "prismatic": (
        three_wheeler(axle="prismatic", **MASS),
        {"y": 1.1, "heading": -2.0, "slide_right": 0.1},
    ),
    "locked tilt": (
        actuated(three_wheeler(**MASS), "tilt_right"),
        {"heading": 1.3, "tilt_right": 0.2},
    ),
    "rocker": (loaded(stiffness=50.0), {"x": -0.7, "heading": 2.3, "steer": -0.2}),
}


@pytest.mark.parametrize("name", OPEN)
def test_distributed_forces_are_least_weighted_by_their_loads(name):
    """Internal forces do not change sum |f_t|^2/(mu N) to first order, N in the weight kept."""
    vehicle, start = OPEN[name]
    run = best_utilisation(vehicle, PATCHY, stand(vehicle, PATCHY, **start))
    found, bodies = forces(run), balance(vehicle, PATCHY, run)
    assert bodies.left(found) < 1e-10
    internal = null_space(bodies.rows)
    assert internal.shape[1] > 0
    x, y = run["contact_x"][0], run["contact_y"][0]
    mu = [wheel.grip for wheel in vehicle.wheels] * (0.6 + 0.2 * np.sin(2 * x) * np.cos(1.5 * y))
    weight = np.repeat(mu * run["force_normal"][0], 3)
    gradient = np.where(np.arange(found.size) % 3 != 2, found / weight, 0.0)
    assert np.linalg.norm(gradient) > 0.1
    assert np.abs(internal.T @ gradient).max() < 1e-10
    assert 0 < run["utilisation_best"][0] <= run["utilisation"].max() * (1 + 1e-8)


def test_oblique_climbing_of_a_rigid_vehicle():
    vehicle, ground, steep = three_wheeler(axle="fixed"), slope(20), np.tan(np.radians(20))
    straight = steep / (2 / 3 + H / LS * steep)
    for heading, needed, best, digits in (
        (0, straight, straight, (1e-12, 1e-7)),
        (30, 0.473, 0.466, (5.01e-4, 5.01e-4)),
        (45, 0.445, 0.432, (5.01e-4, 5.01e-4)),
        (60, 0.411, 0.389, (5.01e-4, 5.01e-4)),
        (90, steep, steep, (1e-12, 1e-7)),
    ):
        run = best_utilisation(vehicle, ground, stand(vehicle, ground, heading=np.radians(heading)))
        assert_allclose(run["utilisation"].max(), needed, rtol=0, atol=digits[0])
        assert_allclose(run["utilisation_best"], best, rtol=0, atol=digits[1])


def test_the_best_is_all_there_is_where_equilibrium_determines_the_forces():
    run = best_utilisation(VEHICLE, HILLS, drive(HILLS, np.linspace(0, 4, 21)))
    assert_allclose(run["utilisation_best"], run["utilisation"].max(axis=1), rtol=1e-6)


# Invariances


def compare(run, other, atol=1e-10):
    for name in ("force_along", "force_across", "force_normal", "drive_torque", "steer_torque"):
        assert_allclose(other[name], run[name], rtol=0, atol=atol * WEIGHT, err_msg=name)


TILTS = {"tilt_right": 0.2, "tilt_left": 0.1}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axle", "tilts", "mirrored_tilts"),
    [("tilting", TILTS, {"tilt_right": -0.1, "tilt_left": -0.2}), ("fixed", {}, {})],
)
def test_forces_move_with_the_ground_and_scale_with_the_masses(axle, tilts, mirrored_tilts):
    vehicle = three_wheeler(axle=axle)
    run = stand(vehicle, HILLS, x=0.4, y=-0.3, heading=0.5, steer=0.2, **tilts)
    c, s = np.cos(0.7), np.sin(0.7)
    moved = sf.Analytic(lambda x, y: hills(c * (x - 3) + s * (y + 2), -s * (x - 3) + c * (y + 2)))
    x, y = c * 0.4 + s * 0.3 + 3, s * 0.4 - c * 0.3 - 2
    compare(run, stand(vehicle, moved, x=x, y=y, heading=1.2, steer=0.2, **tilts))
    heavy = three_wheeler(axle=axle, mass=90.0, wheel_mass=6.0)
    heavy = stand(heavy, HILLS, x=0.4, y=-0.3, heading=0.5, steer=0.2, **tilts)
    for name in (*FORCES, "drive_torque", "steer_torque", "potential_energy"):
        assert_allclose(heavy[name], 3 * run[name], rtol=1e-9, atol=1e-10 * WEIGHT, err_msg=name)
    assert_allclose(heavy["friction_needed"], run["friction_needed"], rtol=1e-9)
    mirrored = sf.Analytic(lambda x, y: hills(-x, y))
    seen = stand(vehicle, mirrored, x=-0.4, y=-0.3, heading=-0.5, steer=-0.2, **mirrored_tilts)
    swap = [LEFT, RIGHT, FRONT]
    for name, sign in (*zip(FORCES, (1, -1, 1), strict=True), ("drive_torque", 1)):
        assert_allclose(seen[name], sign * run[name][:, swap], rtol=0, atol=1e-10 * WEIGHT)
    assert_allclose(seen["steer_torque"], -run["steer_torque"], rtol=0, atol=1e-10 * WEIGHT)
    assert_allclose(seen["tip_over_margin"], run["tip_over_margin"], rtol=0, atol=1e-12)


# Locks and actuators


def test_a_lock_bears_the_moment_about_its_axis():
    names = ("tilt_left", "tilt_right")
    vehicle = actuated(three_wheeler(**MASS), *names)
    run = stand(vehicle, HILLS, heading=0.9, tilt_right=0.2, tilt_left=-0.1, steer=0.3)
    found = balance(vehicle, HILLS, run)
    for name in names:
        row, weight = found.held[name]
        expected = -(row @ forces(run) + weight)
        assert_allclose(run[f"{name}_torque"][0], expected, rtol=0, atol=1e-10 * WEIGHT)


def test_two_locked_tilts_need_no_more_friction_than_the_slope():
    """Across 20 degrees, upright: every wheel holds its own share against the slope."""
    s = np.radians(20)
    vehicle, ground = actuated(VEHICLE, "tilt_right", "tilt_left"), slope(20)
    run = best_utilisation(vehicle, ground, stand(vehicle, ground, heading=np.pi / 2))
    assert_allclose(run["friction_needed"][0], np.tan(s), rtol=1e-12)
    assert_allclose(run["utilisation_best"], np.tan(s), rtol=1e-7)
    bears = WEIGHT * (np.cos(s) / 3 - np.array([1, -1]) * H * np.sin(s) / (2 * LA))
    torque = [run[f"tilt_{side}_torque"][0] for side in ("right", "left")]
    assert_allclose(torque, R * np.tan(s) * bears, rtol=1e-11)
    assert_allclose(torque, [10, 14], rtol=0, atol=0.5)


def test_an_actuated_axle_bears_a_force():
    run = stand(three_wheeler(axle="actuated"), slope(20), heading=np.pi / 2)
    assert run.columns["slide_right_force"].label.unit == "N"
    across = run["force_across", "right"][0] - 2 * G * np.sin(np.radians(20))
    assert_allclose(run["slide_right_force"][0], -across, rtol=1e-11)


def test_a_lock_takes_out_springs():
    locked = actuated(three_wheeler(stiffness=20.0, damping=1.0, bump=5.0), "tilt_right")
    assert [c.is_loaded for c in locked.coordinates] == [False, True, False]
    assert [c.kind for c in locked.coordinates] == ["commanded", "passive", "commanded"]


# Other models


@pytest.mark.slow
def test_montanas_form_bears_the_same():
    vehicle, t = three_wheeler(stiffness=20.0), np.linspace(0, 3, 7)
    closure, other = closure_model(vehicle, HILLS), sf.montana_kinematics(vehicle, HILLS)
    start = sf.settle(closure, heading=0.3, tilt_right=0.1, tilt_left=-0.05, steer=0.2)
    runs = [
        sf.simulate(
            dae, start, dae.inputs(**PAPER_RATES), t, options=sf.SolverOptions(tolerance=1e-10)
        )
        for dae in (closure, other)
    ]
    for name in (*OF_FORCES, "steer_torque"):
        size = np.abs(runs[0][name]).max() + 1e-3
        assert_allclose(runs[1][name][0], runs[0][name][0], rtol=0, atol=1e-9 * size, err_msg=name)
        assert_allclose(runs[1][name], runs[0][name], rtol=0, atol=1e-6 * size, err_msg=name)


@pytest.mark.slow
def test_the_inverse_model_bears_the_same():
    direct = closure_model(VEHICLE, HILLS, slip=sf.Rolling())
    start, inputs = (
        sf.settle(direct, heading=0.3),
        direct.inputs(**PAPER_RATES | {"steer_rate": 0.02}),
    )
    t, options = np.linspace(0, 4, 5), sf.SolverOptions(tolerance=1e-10)
    run = sf.simulate(direct, start, inputs, t, options=options)
    given = ("velocity_x", "velocity_y", "heading_rate")
    dae = sf.inverse_kinematics(VEHICLE, HILLS, given=given, solve_for="rates")
    for k in range(run.t.size):
        inputs = dae.inputs(**{name: run[name][k] for name in given})
        again = sf.simulate(dae, run.part(slice(k, k + 1)), inputs, np.array([0.0, 0.01]))
        for name in (*FORCES, "drive_torque", "steer_torque", "power"):
            assert_allclose(again[name][0], run[name][k], rtol=0, atol=1e-9 * WEIGHT, err_msg=name)


def test_rolling_bears_what_least_slip_bears():
    start = {"heading": 0.4, "tilt_right": 0.2, "steer": 0.1}
    compare(stand(VEHICLE, HILLS, **start), stand(VEHICLE, HILLS, slip=sf.Rolling(), **start))


# Utilisation as a limit


def test_the_square_of_the_utilisation_has_derivatives_at_zero_force():
    """A root is the outermost operation, so that a planner can leave it out."""
    for vehicle in (VEHICLE, three_wheeler(axle="fixed")):
        dae = closure_model(vehicle, sf.Analytic(hills, mu=0.5))
        for used in (*dae.y.forces.utilisation, *dae.y.forces.friction_needed):
            assert used.op() == ca.OP_SQRT
        # with a fixed axle, the tangential forces are products of normal forces and virtual rates
        known = dae.y.forces if dae.z.forces.virtual else dae.z.forces
        force = ca.vertcat(known.along[0], known.across[0])
        unknown = ca.vertcat(*dae.z.forces.virtual) if dae.z.forces.virtual else force
        square, normal = dae.y.forces.utilisation[0].dep(0), ca.vertcat(*dae.z.forces.normal)
        results = [square, *ca.hessian(square, unknown), ca.jacobian(force, unknown)]
        f = ca.Function("f", [*dae.columns()], results)
        z = ca.vertcat(*leaves(dae.z))
        at = np.zeros(z.numel())
        at[[k for k in range(z.numel()) if ca.is_equal(z[k], normal[0])]] = 40.0
        zero = [np.zeros(part.shape) for part in (dae.columns()[0], dae.columns()[2])]
        value, bend, slope, by = (np.array(each) for each in f(zero[0], at, zero[1]))
        assert_allclose(value, 0)
        assert_allclose(slope, 0)
        assert_allclose(bend, 2 * by.T @ by / (0.5 * 40.0) ** 2, atol=1e-15)
        assert np.linalg.matrix_rank(bend) == 2
        at[:] = 0.0
        assert float(f(zero[0], at, zero[1])[0]) == np.inf


# What has no forces, and what is refused


def test_a_vehicle_without_mass_has_no_forces():
    run = stand(three_wheeler(**LIGHT), HILLS)
    assert not {*OF_FORCES, "steer_torque", "tip_over", "lift_off"} & set(run)
    assert {*OF_FORCES, "steer_torque", "tip_over", "lift_off"} <= set(stand(VEHICLE, HILLS))


wheel = partial(sf.Wheel, "w", "platform", (0, 0, 0), Torus(0.1, 0.1), driven=True)
passive = partial(sf.Coordinate, "c", "passive", "c")


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (lambda: sf.Body(np.nan), "Body: mass: expected a number, found float nan"),
        (lambda: sf.Body(1.0, (0.0, np.inf, 0.0)), r"Body: at.1.: expected a finite number"),
        (lambda: wheel(mass=-2.0), "wheel 'w': mass: expected a number >= 0"),
        (lambda: wheel(grip=0.0), "wheel 'w': grip: expected a number > 0, found 0.0"),
        (lambda: passive(stiffness=-1.0), "coordinate 'c': stiffness: expected a number >= 0"),
        (lambda: passive(rest=np.inf), "coordinate 'c': rest: expected a finite"),
        (
            lambda: sf.Coordinate("c", "commanded", "c", max_rate=0.0),
            "coordinate 'c': max_rate: expected a number > 0, found 0.0",
        ),
        (
            lambda: sf.Coordinate("c", "commanded", "c", stiffness=1.0),
            "coordinate 'c': a commanded coordinate cannot have a spring",
        ),
        (
            lambda: actuated(VEHICLE, "steer"),
            "passive coordinates tilt_right, tilt_left, found 'steer'",
        ),
        (lambda: actuated(three_wheeler(axle="fixed"), "tilt"), r"coordinates \(none\), found"),
        (
            lambda: three_wheeler(axle="fixed", stiffness=1.0),
            "with a free joint .* found the fixed axle",
        ),
        (lambda: three_wheeler(mass=-1.0), "mass: expected a number >= 0"),
    ],
)
def test_what_cannot_be_is_refused(build, words):
    refuses(sf.ModelError, words, build)
