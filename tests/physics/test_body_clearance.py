"""Tests of the clearance of bodies: brute force, closed forms, stops by name, and plans."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from slipfree import (
    Analytic,
    Bicubic,
    Grid,
    ModelError,
    direct_kinematics,
    dynamics,
    montana_kinematics,
    quasi_statics,
    rollouts,
    settle,
    simulate,
)
from slipfree.catalog import rigid_skid_steer, rocky7, skid_steer, three_wheeler
from slipfree.contact.nearest_points import NearestPoints
from slipfree.core.evaluation import evaluate
from slipfree.core.records import leaves
from slipfree.plan.plan import plan
from slipfree.plan.problem import costs_of
from slipfree.routing.traversability import blocking_reasons, traversability
from slipfree.vehicle.shapes import Ball, Box, Hull

AXIS = np.linspace(-4, 4, 81)
TOLERANCE = 1e-6  # of the clearance against brute force [m]


def with_shapes(vehicle, *shapes, **joints):
    """Return a vehicle with shapes on its platform, and on joints by name."""
    moved = (
        replace(j, body=replace(j.body, shapes=joints.get(j.name, ()))) for j in vehicle.joints
    )
    return replace(
        vehicle, body=replace(vehicle.body, shapes=shapes), joints=tuple(moved), name="shaped"
    )


LATTICE = tuple((0.3 * i, 0.4 + 0.3 * j, 0.0) for i in (-1, 0, 1) for j in (-1, 0, 1))
SHAPED = {
    "box": with_shapes(skid_steer(), Box((0.3, 0.7, 0.2), (0.02, 0.05, 0.13), (0.05, -0.1, 0.3))),
    "rocker": with_shapes(
        rocky7(),
        Box((0.26, 0.4, 0.16), (0.0, 0.1, 0.2)),
        rocker_right=(Ball(0.05, (0.0, -0.05, -0.05)),),
        bogie_left=(Ball(0.02, (0.0, 0.0, 0.03)),),
    ),
    "hull": with_shapes(three_wheeler(axle="fixed"), Hull(LATTICE), Ball(0.1, (0.2, 0.5, 0.2))),
}


def rough(seed=3, relief=0.03):
    """Random ground with waves of half a metre, and its heights by scipy alone."""
    z = gaussian_filter(np.random.default_rng(seed).normal(size=(81, 81)), 3, mode="wrap")
    z *= relief / z.std()
    return Bicubic(Grid(AXIS, AXIS, z), mu=0.8), RectBivariateSpline(AXIS, AXIS, z, s=0).ev


def shape_distance(shape, points):
    """Distances of points, in the shape's part, from a shape; negative in a box."""
    if isinstance(shape, Ball):
        return np.linalg.norm(points - shape.at, axis=-1) - shape.radius
    if isinstance(shape, Hull):
        corners = np.array(shape.points)
        return np.linalg.norm(points[..., None, :] - corners, axis=-1).min(axis=-1)
    axes = Rotation.from_euler("xyz", shape.turned).as_matrix()
    beyond = np.abs((points - shape.at) @ axes) - np.array(shape.size) / 2
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=-1)
    return outside + np.minimum(beyond.max(axis=-1), 0)


def part_frames(vehicle, run):
    """Origins and axes of the parts with shapes, by elementary geometry."""
    euler = Rotation.from_euler("ZYX", [run[name][0] for name in ("heading", "roll", "pitch")])
    frames = {"platform": (np.array([run[axis][0] for axis in "xyz"]), euler.as_matrix())}
    for joint in vehicle.joints:
        assert joint.axis in ("x", "z")
        sign = -1 if joint.value.startswith("-") else 1
        angle = sign * run[joint.value.lstrip("-")][0]
        origin, axes = frames[joint.parent]
        turned = Rotation.from_euler(joint.axis, angle).as_matrix()
        frames[joint.name] = origin + axes @ joint.at, axes @ turned
    return frames


def brute_clearance(vehicle, run, heights):
    """Least distance of dense samples of the ground from the shapes, improved by Nelder and Mead.

    Sampling alone, 2 cm apart, is at most 0.3 mm above the minimum.
    """
    frames, least = part_frames(vehicle, run), np.inf
    for name, shape in vehicle.shapes:
        origin, axes = frames[name]
        middle = origin + axes @ np.mean(
            getattr(shape, "points", [getattr(shape, "at", 0)]), axis=0
        )

        def distance(x, y, shape=shape, origin=origin, axes=axes):
            points = np.stack([x, y, heights(x, y)], axis=-1)
            return shape_distance(shape, (points - origin) @ axes)

        sides = [np.arange(center - 0.9, center + 0.9, 0.02) for center in middle[:2]]
        x, y = np.meshgrid(*sides, indexing="ij")
        values = distance(x, y)
        inner = values[1:-1, 1:-1]
        around = [
            values[1 + i : values.shape[0] - 1 + i, 1 + j : values.shape[1] - 1 + j]
            for i in (-1, 0, 1)
            for j in (-1, 0, 1)
        ]
        low = np.argwhere(inner <= np.min(around, axis=0)) + 1
        low = low[np.argsort(values[tuple(low.T)])]
        for i, j in low[:4]:
            if values[i, j] > min(least, values.min()) + 1e-3:
                break
            at = minimize(
                lambda p: float(distance(p[0], p[1])),
                [x[i, j], y[i, j]],
                method="Nelder-Mead",
                options={"xatol": 1e-7, "fatol": 1e-10},
            )
            least = min(least, at.fun)
    return least


def settled_poses(vehicle, count, relief=0.03):
    """Yield starts at random places of rough ground, and their clearances by brute force."""
    ground, heights = rough(relief=relief)
    model, rng = direct_kinematics(vehicle, ground), np.random.default_rng(count)
    while count:
        x, y, heading = rng.uniform((-2, -2, -3), (2, 2, 3))
        try:
            run = settle(model, x=x, y=y, heading=heading)
        except ModelError:  # a wheel touches a second time
            continue
        yield run, brute_clearance(vehicle, run, heights)
        count -= 1


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
    bump = Analytic(lambda x, y: 0.1 * ca.exp(-((x - 0.05) ** 2 + (y + 0.1) ** 2) / 0.02))
    at = level(box, height=0.3, ground=bump)
    assert_allclose(at.gap, 0.3 - 0.1 - 0.1, atol=1e-9)
    assert_allclose(at.foot, [[0.05, -0.1, 0.1]], atol=1e-6)
    ridge = Analytic(lambda x, y: 0.1 * ca.exp(-(x**2) / 0.02) + 0.01 * y)
    at = level(box, height=0.3, ground=ridge)
    assert_allclose(at.foot[0, :2], [0.0, 0.4], atol=1e-2)
    assert at.gap[0] < 0.3 - 0.1 - 0.1 - 0.01 * 0.4 + 1e-6


def test_clearance_over_a_sphere_has_its_closed_form():
    """The ground is the top of a sphere: its centre is as far from the shape as the radius more."""
    radius = 2.0
    ground = Analytic(lambda x, y: ca.sqrt(radius**2 - x**2 - y**2) - radius)
    rng, center = np.random.default_rng(0), np.array([0.0, 0.0, -radius])
    for _ in range(20):
        rotation, height = rng.uniform(-0.6, 0.6, 3), rng.uniform(0.5, 0.9)
        axes = Rotation.from_euler("xyz", rotation).as_matrix()
        for shape in (Box((0.4, 0.7, 0.2)), Ball(0.2), Hull(((0.1, 0.2, -0.1), (-0.2, 0.1, 0.0)))):
            at = level(shape, height=height, rotation=rotation, ground=ground)
            distance = shape_distance(shape, (center - [0, 0, height]) @ axes)
            assert_allclose(at.gap, distance - radius, atol=1e-9)


def test_a_plane_map_and_a_plane_formula_agree():
    """The clearance from a plane has a closed form, which the search on a map must find."""
    z = np.add.outer(0.1 * AXIS, 0.2 * AXIS)
    shapes = (Box((0.4, 0.7, 0.2), (0.1, 0, 0), (0.3, 0.2, 0.1)), Ball(0.1), Hull(LATTICE))
    grounds = Bicubic(Grid(AXIS, AXIS, z)), Analytic(lambda x, y: 0.1 * x + 0.2 * y)
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


RIDGE = Bicubic(
    Grid(
        AXIS,
        AXIS,
        np.outer(np.exp(-((AXIS / 0.2) ** 2)), 0.22 * np.exp(-(((AXIS - 1) / 0.2) ** 2))),
    ),
    mu=0.8,
)
LOW = with_shapes(skid_steer(), Box((0.3, 0.6, 0.1)))


@pytest.mark.parametrize("make", [direct_kinematics, quasi_statics, dynamics])
def test_a_motion_ends_by_name_where_the_belly_touches(make):
    """The wheels pass beside the ridge; the stop is at the same place in each model."""
    model = make(LOW, RIDGE)
    start = settle(model, y=-0.8)
    assert_allclose(start["clearance_body"], 0.1, atol=2e-3)
    inputs = {label.full: 2.0 for label in leaves(model.labels.u)}
    run = simulate(model, start, model.inputs(**inputs), np.linspace(0, 8, 81))
    assert run.stop.name == "clearance_body"
    assert "the platform touches the ground at (" in run.stop.words
    assert_allclose(run["y"][-1], 0.53, atol=0.02)  # the front edge where the ridge is 0.1 m high
    assert abs(run["clearance_body"][-1]) < 1e-6


def test_a_start_on_the_ridge_is_refused():
    with pytest.raises(ModelError, match=r"the platform touches the ground at \(-?0\.0"):
        settle(direct_kinematics(LOW, RIDGE), y=1.0)


def test_pressed_wheels_and_montana_have_the_clearance_of_the_drawing():
    box = Box((0.3, 0.5, 0.1), (0.0, 0.0, 0.05))
    flat = Analytic(lambda x, _: 0 * x, mu=0.8)
    rigid = settle(direct_kinematics(with_shapes(rigid_skid_steer(), box), flat))
    assert_allclose(rigid["clearance_body"], rigid["z"], atol=1e-9)  # the box ends at height zero
    vehicle = with_shapes(three_wheeler(), box)
    start, rolling = settle(direct_kinematics(vehicle, flat)), montana_kinematics(vehicle, flat)
    inputs = rolling.inputs(right_rate=0.5, left_rate=0.5, steer_rate=0.0)
    run = simulate(rolling, start, inputs, np.linspace(0, 1, 3))
    assert_allclose(run["clearance_body"], 0.3, atol=1e-6)


def test_a_body_of_a_joint_moves_with_it():
    """A ball on a rocker comes down with it, and is named by the joint."""
    vehicle = with_shapes(rocky7(), bogie_right=(Ball(0.01, (0.0, 0.2, -0.05)),))
    model = direct_kinematics(vehicle, RIDGE)
    flat, tilted = settle(model, x=-2.0, y=-2.0), settle(model, x=-0.2, y=0.9)
    assert tilted["clearance_body"][0] != pytest.approx(flat["clearance_body"][0], abs=1e-3)
    words = model.checks[-1].describe(model.rows("x", flat, 0), model.rows("z", flat, 0))
    assert words.startswith("the body of joint 'bogie_right' touches the ground at (")


def test_the_expression_for_planners_agrees_near_the_ground():
    """Value and gradient along a motion up to the contact."""
    model = direct_kinematics(LOW, RIDGE)
    start = settle(model, y=0.3)
    inputs = model.inputs(**{label.full: 1.0 for label in leaves(model.labels.u)})
    run = simulate(model, start, inputs, np.linspace(0, 2, 41))
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
    model = direct_kinematics(LOW, RIDGE)
    (cost,) = costs_of(model, {"clearance_body": 2.0})
    (distance,) = model.named("clearance_body")
    x, z, _ = model.columns()
    f = model.function("f", [x, z], [cost.expression, distance])
    run = settle(model, y=-0.8)
    value, clear = (float(each) for each in f(model.rows("x", run, 0), model.rows("z", run, 0)))
    assert_allclose(value, 1 / (clear**2 + 1e-6))
    assert_allclose(clear, run["clearance_body"][0], atol=1e-6)


@pytest.mark.filterwarnings("ignore:equations are interpreted")
def test_a_batch_ends_where_a_single_motion_ends():
    model = direct_kinematics(LOW, RIDGE)
    inputs, t = {label.full: 2.0 for label in leaves(model.labels.u)}, np.linspace(0, 8, 9)
    starts = {"x": np.array([0.0, 1.5]), "y": np.full(2, -0.8)}
    single, many = (
        rollouts(model, starts, inputs, t, method=method) for method in ("simulate", "batch")
    )
    assert_allclose(many["end"], single["end"], atol=1e-3)
    assert "the platform touches the ground" in str(many["reason"].values[0])
    assert not str(many["reason"].values[1])


def test_routes_avoid_ground_as_high_as_the_body():
    layers = traversability(RIDGE, LOW)
    assert_allclose(layers.limits.clearance, 0.1)
    assert "body clears 0.1 m" in blocking_reasons(layers, 0.0, 1.0)
    high = traversability(RIDGE, with_shapes(skid_steer(), Box((0.3, 0.6, 0.1), (0.0, 0.0, 0.3))))
    assert "body" not in blocking_reasons(high, 0.0, 1.0)


@pytest.mark.slow
def test_a_plan_drives_around_the_ridge():
    """Straight ahead the belly touches; the plan keeps the margin, and its simulation, too."""
    bump = np.outer(np.exp(-(((AXIS - 0.02) / 0.25) ** 2)), np.exp(-(((AXIS - 0.6) / 0.25) ** 2)))
    model = direct_kinematics(
        with_shapes(skid_steer(), Box((0.3, 0.6, 0.1), (0.0, 0.0, -0.04))),
        Bicubic(Grid(AXIS, AXIS, 0.1 * bump), mu=0.8),
    )
    start = settle(model, y=-0.8)
    names = [label.full for label in leaves(model.labels.u)]
    straight, t = dict.fromkeys(names, 1.5), np.linspace(0, 14, 61)
    run = simulate(model, start, model.inputs(**straight), t)
    assert run.stop.name == "clearance_body"
    blind = replace(model, checks=())
    guess = simulate(blind, start, blind.inputs(**straight), t)
    for limits, least in (({}, 0.0), ({"clearance_body": (0.02, np.inf)}, 0.02)):
        found = plan(
            model,
            start,
            guess,
            goal={"x": 0.0, "y": float(guess["y"][-1])},
            costs={"slip": 100.0, "effort": 0.01},
            duration=14.0,
            smooth=0.002,
            inputs=dict.fromkeys(names, (-4.0, 4.0)),
            limits=limits,
            intervals=20,
        )
        assert found.accurate
        assert found.replay.stop is None
        assert found.replay["clearance_body"].min() > least - 1e-3
        assert np.abs(found.replay["x"]).max() > 0.2


def test_invalid_shapes_are_refused():
    for make, words in (
        (lambda: Box((0.1, 0.0, 0.1)), "three positive edges"),
        (lambda: Ball(-1.0), "positive, finite number"),
        (lambda: Hull(()), "at least one point"),
        (lambda: Hull(((0.0, 0.0),)), "three finite numbers"),
    ):
        with pytest.raises(ModelError, match=words):
            make()
