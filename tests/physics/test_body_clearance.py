"""Tests of bodies and ground: clearance, stops by name, plans, hang-up, and loads in dynamics."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import RectBivariateSpline
from scipy.spatial.transform import Rotation

import slipfree as sf
from helpers.cases import PROBLEMS
from helpers.commands import refuses
from helpers.dynamics import FLAT, energy_error, four_wheels, moved, states
from helpers.shaped import (
    AXIS,
    LATTICE,
    SHAPED,
    brute_clearance,
    rough,
    settled_poses,
    shape_distance,
    with_shapes,
)
from slipfree.catalog import rigid_skid_steer, rocky7, skid_steer, three_wheeler
from slipfree.contact.nearest_points import NearestPoints
from slipfree.core.lookups import evaluate
from slipfree.core.records import leaves
from slipfree.plan.problem import costs_of
from slipfree.problem.load import find_motion_verb
from slipfree.routing.traversability import blocking_reasons, traversability
from slipfree.terrain.solids import placed, step
from slipfree.vehicle.shapes import Ball, Box, Hull

TOLERANCE = 1e-9  # of the clearance against brute force [m]


@pytest.mark.parametrize("name", SHAPED)
@pytest.mark.parametrize(
    "count", [34, pytest.param(334, marks=pytest.mark.slow)], ids=["few", "many"]
)
def test_clearance_is_that_of_dense_sampling(name, count):
    """Poses on rough ground, 1000 in all, of a box, of balls on rockers and of a hull."""
    pairs = [(run["clearance_body"][0], exact) for run, exact in settled_poses(SHAPED[name], count)]
    values, exact = np.array(pairs).T
    assert np.ptp(values) > 0.01
    assert np.abs(values - exact).max() < TOLERANCE


def placing(*shapes, height, rotation, ground):
    """Origins and axes of shapes whose common frame has a height and a rotation."""
    axes = Rotation.from_euler("xyz", rotation).as_matrix()
    frames = [
        (axes @ shape.at, axes @ Rotation.from_euler("xyz", shape.turned).as_matrix())
        if isinstance(shape, Box)
        else (axes @ getattr(shape, "at", np.zeros(3)), axes)
        for shape in shapes
    ]
    columns = [[*(origin + np.array([0, 0, height])), *own.T.ravel()] for origin, own in frames]
    return (
        np.concatenate(columns)[:, None]
        - np.tile([*ground.origin, *np.zeros(9)], len(shapes))[:, None]
    )


def level(*shapes, height=0.0, rotation=(0.0, 0.0, 0.0), ground=None):
    """Nearest points of shapes whose common frame has a height and a rotation."""
    placed = placing(*shapes, height=height, rotation=rotation, ground=ground)
    return NearestPoints(ground, tuple(("platform", shape) for shape in shapes))(placed)


def test_ground_that_rises_between_the_corners_is_seen():
    """Over a bump and a ridge, the least distance is that of the face and of an edge."""
    box = Box((0.6, 0.8, 0.2))
    bump = sf.Analytic(lambda x, y: 0.1 * ca.exp(-((x - 0.05) ** 2 + (y + 0.1) ** 2) / 0.02))
    at = level(box, height=0.3, ground=bump)
    assert_allclose(at.gap, 0.3 - 0.1 - 0.1, atol=1e-9)
    assert_allclose(at.foot, [[0.05, -0.1, 0.1]], atol=1e-6)
    ridge = sf.Analytic(lambda x, y: 0.1 * ca.exp(-(x**2) / 0.02) + 0.01 * y)
    at = level(box, height=0.3, ground=ridge)
    assert_allclose(at.foot[0, :2], [0.0, 0.4], atol=1e-2)
    assert at.gap[0] < 0.3 - 0.1 - 0.1 - 0.01 * 0.4 + 1e-6


def test_clearance_over_a_sphere_has_its_closed_form():
    """The ground is the top of a sphere: its centre is as far from the shape as the radius more."""
    radius = 2.0
    ground = sf.Analytic(lambda x, y: ca.sqrt(radius**2 - x**2 - y**2) - radius)
    rng, center = np.random.default_rng(0), np.array([0.0, 0.0, -radius])
    for _ in range(20):
        rotation, height = rng.uniform(-0.6, 0.6, 3), rng.uniform(0.5, 0.9)
        axes = Rotation.from_euler("xyz", rotation).as_matrix()
        for shape in (Box((0.4, 0.7, 0.2)), Ball(0.2), Hull(((0.1, 0.2, -0.1), (-0.2, 0.1, 0.0)))):
            at = level(shape, height=height, rotation=rotation, ground=ground)
            distance = shape_distance(shape, (center - [0, 0, height]) @ axes)
            assert_allclose(at.gap, distance - radius, atol=1e-9)


@pytest.mark.parametrize(("edges", "cell"), [((6.0, 3.0, 0.5), 0.1), ((0.7, 0.3, 0.2), 0.05)])
def test_clearance_of_a_wide_body_is_that_of_dense_sampling(edges, cell):
    """The body is wider than many cells, on ground whose neighbouring nodes differ by 1 cm."""
    rng, axis, box = np.random.default_rng(5), np.arange(-5, 5 + cell / 2, cell), Box(edges)
    z = 0.05 * np.sin(2 * axis)[:, None] * np.cos(3 * axis) + rng.normal(0, 0.01, (axis.size,) * 2)
    ground, heights = sf.Bicubic(sf.Grid(axis, axis, z)), RectBivariateSpline(axis, axis, z, s=0).ev
    side = np.arange(-max(edges), max(edges), cell / 10) / 1.6
    points = np.stack([*np.meshgrid(side, side, indexing="ij"), np.empty((side.size,) * 2)], -1)
    points[..., 2] = heights(points[..., 0], points[..., 1])
    for _ in range(12):
        rotation = rng.uniform(-1, 1, 3) * (0.02, 0.02, 3)
        height = 0.4 + edges[2] / 2
        axes = Rotation.from_euler("xyz", rotation).as_matrix()
        least = shape_distance(box, (points - [0, 0, height]) @ axes).min()
        (found,) = level(box, height=height, rotation=rotation, ground=ground).gap
        assert least - 0.05 * cell < found < least + 1e-9


def test_a_plane_map_and_a_plane_formula_agree():
    """The clearance from a plane has a closed form, which the search on a map must find."""
    z = np.add.outer(0.1 * AXIS, 0.2 * AXIS)
    shapes = (Box((0.4, 0.7, 0.2), (0.1, 0, 0), (0.3, 0.2, 0.1)), Ball(0.1), Hull(LATTICE))
    grounds = sf.Bicubic(sf.Grid(AXIS, AXIS, z)), sf.Analytic(lambda x, y: 0.1 * x + 0.2 * y)
    for shape in shapes:
        one, other = (
            level(shape, height=0.8, rotation=(0.1, -0.2, 0.5), ground=each) for each in grounds
        )
        assert_allclose(one.gap, other.gap, atol=1e-9)
        assert_allclose(one.foot, other.foot, atol=1e-6)


def test_the_nearest_of_several_shapes_is_named():
    lifted = Box((0.1, 0.1, 0.1), (0.0, 0.0, 0.5))
    ground, _ = rough()
    both = level(lifted, Box((0.3, 0.3, 0.1)), height=0.4, ground=ground)
    alone = level(Box((0.3, 0.3, 0.1)), height=0.4, ground=ground)
    assert both.shape.tolist() == [1]
    assert_allclose(both.gap, alone.gap, atol=1e-12)


def test_quick_bounds_are_below_the_clearance():
    """Where only contacts matter, bounds replace larger clearances, and never exceed them."""
    shapes = Box((0.5, 0.7, 0.1)), Ball(0.1, (0.0, 0.5, 0.2))
    (ground, _), rng, skipped = rough(), np.random.default_rng(1), 0
    search = NearestPoints(ground, tuple(("platform", shape) for shape in shapes))
    for _ in range(40):
        rotation, height = rng.uniform(-0.2, 0.2, 3), rng.uniform(0.1, 0.6)
        placed = placing(*shapes, height=height, rotation=rotation, ground=ground)
        bound, gap = search.lower_bounds(placed, 0.05)[0], search(placed).gap[0]
        assert bound <= min(gap, 0.05)
        skipped += bound == 0.05
    assert skipped > 10


HUMP = np.outer(np.exp(-((AXIS / 0.2) ** 2)), 0.22 * np.exp(-(((AXIS - 1) / 0.2) ** 2)))
RIDGE = sf.Bicubic(sf.Grid(AXIS, AXIS, HUMP), mu=0.8)
LOW = with_shapes(skid_steer(), Box((0.3, 0.6, 0.1)))


@pytest.mark.parametrize("make", [sf.direct_kinematics, sf.quasi_statics, sf.dynamics])
def test_a_motion_ends_by_name_where_the_belly_touches(make):
    """The wheels pass beside the ridge; the stop is at the same place in each model."""
    model = make(LOW, RIDGE)
    start = sf.settle(model, y=-0.8)
    assert_allclose(start["clearance_body"], 0.1, atol=2e-3)
    inputs = {label.full: 2.0 for label in leaves(model.labels.u)}
    run = sf.simulate(model, start, model.inputs(**inputs), np.linspace(0, 8, 81))
    assert run.stop.name == "clearance_body"
    assert "the platform touches the ground at (" in run.stop.words
    assert_allclose(run["y"][-1], 0.53, atol=0.02)  # the front edge where the ridge is 0.1 m high
    assert abs(run["clearance_body"][-1]) < 1e-6


def test_a_start_on_the_ridge_is_refused():
    with pytest.raises(sf.ModelError, match=r"the platform touches the ground at \(-?0\.0"):
        sf.settle(sf.direct_kinematics(LOW, RIDGE), y=1.0)


def test_pressed_wheels_and_montana_have_the_clearance_of_the_drawing():
    box = Box((0.3, 0.5, 0.1), (0.0, 0.0, 0.05))
    flat = sf.Analytic(lambda x, _: 0 * x, mu=0.8)
    rigid = sf.settle(sf.direct_kinematics(with_shapes(rigid_skid_steer(), box), flat))
    assert_allclose(rigid["clearance_body"], rigid["z"], atol=1e-9)  # the box ends at height zero
    vehicle = with_shapes(three_wheeler(), box)
    start, rolling = (
        sf.settle(sf.direct_kinematics(vehicle, flat)),
        sf.montana_kinematics(vehicle, flat),
    )
    inputs = rolling.inputs(right_rate=0.5, left_rate=0.5, steer_rate=0.0)
    run = sf.simulate(rolling, start, inputs, np.linspace(0, 1, 3))
    assert_allclose(run["clearance_body"], 0.3, atol=1e-6)


def test_a_body_of_a_joint_moves_with_it():
    """A ball on a rocker comes down with it, and is named by the joint."""
    vehicle = with_shapes(rocky7(), bogie_right=(Ball(0.01, (0.0, 0.2, -0.05)),))
    model = sf.direct_kinematics(vehicle, RIDGE)
    flat, tilted = sf.settle(model, x=-2.0, y=-2.0), sf.settle(model, x=-0.2, y=0.9)
    assert tilted["clearance_body"][0] != pytest.approx(flat["clearance_body"][0], abs=1e-3)
    heights = RectBivariateSpline(AXIS, AXIS, RIDGE.grid.z, s=0).ev
    for run in (flat, tilted):
        exact = brute_clearance(vehicle, run, heights)
        assert_allclose(run["clearance_body"][0], exact, atol=TOLERANCE)
    words = model.checks[-1].describe(model.rows("x", flat, 0), model.rows("z", flat, 0))
    assert words.startswith("the body of joint 'bogie_right' touches the ground at (")


def test_the_expression_for_planners_agrees_near_the_ground():
    """Value and gradient along a motion up to the contact."""
    model = sf.direct_kinematics(LOW, RIDGE)
    start = sf.settle(model, y=0.3)
    inputs = model.inputs(**{label.full: 1.0 for label in leaves(model.labels.u)})
    run = sf.simulate(model, start, inputs, np.linspace(0, 2, 41))
    x, z, _ = model.columns()
    (expression,) = model.named("clearance_body")
    rows = [np.array([model.rows(each, run, k) for k in range(run.t.size)]).T for each in "xz"]
    (values,) = evaluate(model.function("f", [x, z], [expression]), *rows)
    assert_allclose(values[0], run["clearance_body"], atol=1e-6)
    slope = ca.jtimes(
        expression,
        ca.vertcat(x, z),
        ca.SX(ca.vertcat(0, 1, ca.SX.zeros(x.numel() + z.numel() - 2))),
    )
    f = model.function("f", [x, z], [expression, slope])
    at = [row[:, -2] for row in rows]
    moved = [at[0] + 1e-5 * np.eye(at[0].size)[1], at[0] - 1e-5 * np.eye(at[0].size)[1]]
    numeric = (float(f(moved[0], at[1])[0]) - float(f(moved[1], at[1])[0])) / 2e-5
    assert_allclose(float(f(*at)[1]), numeric, rtol=1e-5)


def test_the_lack_of_clearance_has_a_cost():
    """The cost by name is the inverse square, which has no pole."""
    model = sf.direct_kinematics(LOW, RIDGE)
    (cost,) = costs_of(model, {"clearance_body": 2.0})
    (distance,) = model.named("clearance_body")
    x, z, _ = model.columns()
    f = model.function("f", [x, z], [cost.expression, distance])
    run = sf.settle(model, y=-0.8)
    value, clear = (float(each) for each in f(model.rows("x", run, 0), model.rows("z", run, 0)))
    assert_allclose(value, 1 / (clear**2 + 1e-6))
    assert_allclose(clear, run["clearance_body"][0], atol=1e-6)


@pytest.mark.filterwarnings("ignore:slower")
def test_a_batch_ends_where_a_single_motion_ends():
    model = sf.direct_kinematics(LOW, RIDGE)
    inputs, t = {label.full: 2.0 for label in leaves(model.labels.u)}, np.linspace(0, 8, 9)
    starts = {"x": np.array([0.0, 1.5]), "y": np.full(2, -0.8)}
    single, many = (
        sf.rollouts(model, starts, inputs, t, method=method) for method in ("simulate", "batch")
    )
    assert_allclose(many["end"], single["end"], atol=1e-3)
    assert "the platform touches the ground" in str(many["reason"].values[0])
    assert not str(many["reason"].values[1])


def test_routes_avoid_ground_as_high_as_the_body():
    narrow = three_wheeler(axle="fixed", half_track=0.3, wheelbase=0.5, r1=0.02, r2=0.08)
    low, high = (with_shapes(narrow, Box((0.3, 0.4, 0.1), (0.0, 0.2, z))) for z in (0.03, 0.4))
    places = {"spacing": 0.5, "places": np.array([[-1.0, 0.9], [1.0, 0.9]])}
    blocked = traversability(RIDGE, low, **places)
    at = int(np.abs(blocked.x).argmin()), int(np.abs(blocked.y - 0.9).argmin())
    assert "a body touches the ground" in blocking_reasons(blocked, 0.0, blocked.y[at[1]])
    free = traversability(RIDGE, high, **places)
    assert np.isfinite(free.cost[:, *at]).sum() > np.isfinite(blocked.cost[:, *at]).sum()


@pytest.mark.slow
def test_a_plan_drives_around_the_ridge():
    """Straight ahead the belly touches; the plan keeps the margin, and its simulation, too."""
    bump = np.outer(np.exp(-(((AXIS - 0.02) / 0.25) ** 2)), np.exp(-(((AXIS - 0.6) / 0.25) ** 2)))
    model = sf.direct_kinematics(
        with_shapes(skid_steer(), Box((0.3, 0.6, 0.1), (0.0, 0.0, -0.04))),
        sf.Bicubic(sf.Grid(AXIS, AXIS, 0.1 * bump), mu=0.8),
    )
    start = sf.settle(model, y=-0.8)
    names = [label.full for label in leaves(model.labels.u)]
    straight, t = dict.fromkeys(names, 1.5), np.linspace(0, 14, 61)
    run = sf.simulate(model, start, model.inputs(**straight), t)
    assert run.stop.name == "clearance_body"
    blind = replace(model, checks=())
    guess = sf.simulate(blind, start, blind.inputs(**straight), t)
    for limits, least in (({}, 0.0), ({"clearance_body": (0.02, np.inf)}, 0.02)):
        found = sf.plan(
            model,
            start,
            guess,
            goal={"x": 0.0, "y": float(guess["y"][-1])},
            costs={"slip": 100.0, "effort": 0.01},
            duration=14.0,
            smooth=0.002,
            inputs=dict.fromkeys(names, (-4.0, 4.0)),
            limits=limits,
            mesh=sf.Mesh(20),
        )
        assert found.accurate
        assert found.replay.stop is None
        assert found.replay["clearance_body"].min() > least - 1e-3
        assert np.abs(found.replay["x"]).max() > 0.2


def test_invalid_shapes_are_refused():
    for make, words in (
        (lambda: Box((0.1, 0.0, 0.1)), r"size\[1\]: expected a number > 0, found 0.0"),
        (lambda: Ball(-1.0), "radius: expected a number > 0, found -1.0"),
        (lambda: Hull(()), "at least one point"),
        (lambda: Hull(((0.0, 0.0),)), r"points\[0\]: expected 3 numbers"),
    ):
        refuses(sf.ModelError, words, make)


# Bodies that bear load in dynamics: closed forms, energy, hanging and rolling over

DEPTH, WEIGHT = 2e-3, 48 * 9.81
LAW = sf.Compliant(body_depth=DEPTH)
BELLY = Box((0.4, 0.5, 0.2), at=(0.0, 0.35, 0.1))  # its lower face is at the axles


def car(*shapes, **keys):
    """Return a car with shapes on its platform; its centre of mass is above their middle."""
    vehicle = four_wheels(static_depth=1e-4, **keys)
    return replace(vehicle, body=replace(vehicle.body, shapes=shapes))


def sunk(*shapes, mu=0.8, **keys):
    """Return a model of a car whose wheels are above the lowest points of its shapes."""
    return sf.dynamics(car(*shapes, **keys), replace(FLAT, mu=mu), law=LAW)


@pytest.mark.parametrize(
    ("shapes", "share"),
    [
        ((Box((0.4, 0.5, 0.4), at=(0, 0.35, 0)),), 1 / 9),
        ((Hull(tuple((x, y, -0.2) for x in (-0.2, 0.2) for y in (0.1, 0.6))),), 1 / 4),
        (tuple(Ball(0.05, (x, y, -0.15)) for x, y in ((-0.2, 0.1), (0.2, 0.1), (0, 0.6))), 3 / 8),
    ],
)
@pytest.mark.parametrize("gravity", [9.81, 1.62])
def test_a_car_on_its_belly_is_as_deep_as_its_weight_asks(shapes, share, gravity):
    """All points bear the weight; a moon's car with the same depth has softer points."""
    model = sf.dynamics(sf.in_gravity(car(*shapes), gravity), FLAT, law=LAW)
    run = moved(model, states(model, z=0.2), np.linspace(0, 4, 5), 1e-8)
    assert run["body_load"][-1] == pytest.approx(48 * gravity, rel=1e-5)
    assert run["force_normal"][-1] == pytest.approx(0, abs=1e-9)
    middle = run["z"][-1] + 0.35 * np.sin(run["pitch"][-1])
    # on unequal depths the car pitches by 1 mrad, and its centre of mass moves: 4e-4 more
    assert 0.2 - middle == pytest.approx(share * DEPTH, rel=1e-3)
    assert np.abs(energy_error(run)).max() < 1e-5 * 48 * gravity * 0.2


def test_a_car_slides_on_its_belly_as_far_as_friction_lets_it():
    """v^2 / (2 mu g), on points that bear the weight from the beginning."""
    box = Box((0.4, 0.5, 0.4), at=(0, 0.35, 0))
    model = sunk(box, mu=0.5)
    start = states(model, z=0.2 - DEPTH / 9, velocity_y=3.0)
    run = moved(model, start, np.linspace(0, 1.5, 16), 1e-8)
    assert run["y"][-1] == pytest.approx(3.0**2 / (2 * 0.5 * 9.81), rel=3e-3)
    assert np.abs(energy_error(run)).max() < 1e-6 * 24 * 9
    assert run["body_load"][-1] == pytest.approx(WEIGHT, rel=1e-6)
    # pitched by friction on the front corners until it stops
    assert run["body_load"] == pytest.approx(WEIGHT, rel=0.3)


def test_a_ball_bounces_as_a_damped_oscillator_without_friction():
    """Own integration of m z'' = k d max(0, 1 + c d') - m g, one point, no other motion."""
    from scipy.integrate import solve_ivp

    ball = Ball(0.3, (0, 0, 0))
    lone = car(ball)
    body = replace(lone.body, mass=lone.body.mass, at=(0.0, 0.0, 0.0))
    wheels = tuple(
        replace(w, at=(x, y, 0.5))
        for w, (x, y) in zip(lone.wheels, ((1, 1), (-1, 1), (1, -1), (-1, -1)), strict=True)
    )
    vehicle = replace(lone, body=body, wheels=wheels)
    law = sf.Compliant(body_depth=DEPTH, damping_ratio=0.1)
    model = sf.dynamics(vehicle, FLAT, law=law)
    t = np.linspace(0, 1, 201)
    run = moved(model, states(model, z=0.4), t, 1e-9)
    stiffness, damping = WEIGHT / DEPTH, 2 * 0.1 / np.sqrt(9.81 * DEPTH)

    def rates(_t, y):
        load = stiffness * max(0.3 - y[0], 0) * max(0, 1 - damping * y[1])
        return [y[1], load / 48 - 9.81]

    own = solve_ivp(rates, (0, 1), [0.4, 0], t_eval=t, rtol=1e-10, atol=1e-12, max_step=1e-3)
    assert run["z"] == pytest.approx(own.y[0], abs=1e-6)
    assert np.ptp(run["z"]) > 0.09


def test_energy_balances_where_points_slide_over_a_ridge():
    """Forces along the ground's normal instead of the gap's gradient would gain 0.05 J."""
    ridge = sf.Analytic(
        lambda x, y: 0.05 * ca.exp(-(((y - 1.2) / 0.15) ** 2) - (x / 0.4) ** 2), mu=0.3
    )
    runners = Hull(tuple((x, y, -0.2) for x in (-0.2, 0.2) for y in (0.1, 0.6)))
    model = sf.dynamics(car(runners), ridge, law=sf.Compliant(body_depth=5e-3))
    start = states(model, z=0.2 - 5e-3 / 4, velocity_y=3.0)
    run = moved(model, start, np.linspace(0, 0.6, 31), 1e-8)
    assert run["body_load"].max() > 3 * WEIGHT
    assert np.abs(energy_error(run)).max() < 100 * 1e-8 * run["kinetic_energy"][0]


def test_a_roll_over_ends_on_the_roof():
    """A car dropped upside down, tilted, comes to rest on the corners of its roof."""
    box = Box((0.7, 0.9, 0.5), at=(0.0, 0.35, 0.25))
    model = sunk(box)
    half = np.deg2rad(150) / 2
    start = states(model, z=0.9, attitude_w=np.cos(half), attitude_y=np.sin(half))
    run = moved(model, start, np.linspace(0, 6, 61), 1e-8)
    assert run["body_load"][-1] == pytest.approx(WEIGHT, rel=1e-3)
    assert run["force_normal"][-1] == pytest.approx(0, abs=1e-9)
    assert run["z"][-1] == pytest.approx(0.5, abs=2e-3)  # the roof is 0.5 m above the axles
    up = 1 - 2 * (run["attitude_x"][-1] ** 2 + run["attitude_y"][-1] ** 2)
    assert up == pytest.approx(-1, abs=1e-4)
    assert run["kinetic_energy"][-1] < 1e-4
    assert np.abs(energy_error(run)).max() < 1e-4 * WEIGHT


def test_without_a_depth_the_motion_ends_at_a_touch():
    box = Box((0.4, 0.5, 0.4), at=(0, 0.35, 0))
    for law in (sf.Compliant(), sf.Soil()):
        model = sf.dynamics(car(box), FLAT, law=law)
        assert [check.label.name for check in model.checks][-1] == "clearance_body"
        assert not model.labels.y.body_load
    model = sunk(box)
    assert not model.checks
    assert "upright" not in [limit.label.name for limit in model.limits]


def test_a_start_that_touches_is_refused():
    model = sunk(Box((0.4, 0.5, 0.2), at=(0, 0.35, -0.1)))
    refuses(sf.ModelError, "the platform touches the ground", sf.settle, model)


def test_too_many_points_are_refused():
    points = tuple((0.0, 0.0, 0.001 * k) for k in range(201))
    refuses(
        sf.ModelError, "at most 200 points, 26 of each box, found 201 in 'car'", sunk, Hull(points)
    )
    assert sf.dynamics(car(BELLY), sf.Solids(FLAT, placed(step(0.1))), law=LAW).labels.y.body_load


def test_the_robot_of_the_shipped_problem_hangs_up():
    problem = sf.load_problem(PROBLEMS / "dynamics_hang_up.toml")
    result = sf.run_problem(problem)
    run = result.trajectory
    assert run.stop is None
    assert run["body_load"][-1] > 34 * 9.81 / 2
    assert (run["force_normal"][-1][:2] == 0).all()  # front wheels
    assert abs(run["velocity_y"][-1]) < 1e-3
    assert run["slip_along"][-1][2:] == pytest.approx(-0.4, abs=0.01)  # rear wheels turn in place
    summary = dict(find_motion_verb(result.kind).summary(run))
    assert summary["body on the ground"].startswith("at ")
    assert summary["energy balance"].startswith("closed to ")
