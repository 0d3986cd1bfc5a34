"""Tests of guarantees: enclosures against vehicles placed by brute force on grounds of the band."""

import sys
from dataclasses import replace
from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from helpers.shaped import shape_distance, with_shapes
from slipfree import (
    Analytic,
    Bicubic,
    Grid,
    ModelError,
    atlas,
    catalog,
    direct_kinematics,
    dynamics,
    settle,
)
from slipfree.batch.evaluator import evaluator_of
from slipfree.batch.many import solve_positions, start_states
from slipfree.core.interval import Intervals, exactly
from slipfree.enclosure.ground_range import range_of
from slipfree.enclosure.guarantee import (
    OFF_MAP,
    Verdict,
    contact_points,
    enclose_poses,
    guarantee,
    lower_margins,
    wheel_frames,
)
from slipfree.enclosure.wheel_gaps import Boxes, gap_bounds, pose_graphs, tangents
from slipfree.files.maps.elevation import jacksboro
from slipfree.vehicle.shapes import Box

HALF = 6.0  # half of the side of the maps [m]
FAR = 0.3  # change of a pose to another rest [m, rad]
MARGINS = "tip_over_margin", "clearance_body"
MESH = 4e-5  # error of the gaps of a mesh of a wheel, and tolerance of the search [m]


def rough(rms=0.15, shortest=1.2, seed=1, h=0.2):
    """Return a map of waves of random directions with an rms slope along both axes."""
    rng, axis = np.random.default_rng(seed), np.linspace(-HALF, HALF, round(2 * HALF / h) + 1)
    k = np.geomspace(2 * np.pi / 12, 2 * np.pi / shortest, 80)
    a = k**-0.8
    a *= rms / np.sqrt(0.25 * (a**2 * k**2).sum())
    turn, phase = rng.uniform(0, 2 * np.pi, (2, k.size))
    waves = k * np.cos(turn) * axis[:, None, None] + k * np.sin(turn) * axis[:, None] + phase
    return Bicubic(Grid(axis, axis, (a * np.cos(waves)).sum(axis=-1)))


class Placing:
    """Poses of a model, and rigid wheels as dense meshes, independent of the enclosures."""

    def __init__(self, model, seed=0, n=5, reach=3.0):
        rng, evaluate = np.random.default_rng(seed), evaluator_of(model, compiled=False)
        (x, y, heading), origin = rng.uniform(-reach, reach, (3, n)), model.ground.origin
        start = {"x": x + origin[0], "y": y + origin[1], "heading": heading}
        states = start_states(evaluate.graphs, start)
        states = states[:, solve_positions(evaluate, states).has_pose]
        rows = evaluate.graphs.rows
        self.model, self.x, self.z = model, states[rows.x], states[rows.p]
        self.n, self.count = states.shape[1], len(model.vehicle.wheels)
        self.q = self.z[: self.count]
        self._meshes = []
        for wheel in model.vehicle.wheels:
            r1, r2 = wheel.section.torus_radii
            v = np.linspace(-np.pi, 0, 401) if r2 else np.linspace(-np.pi, 0, 721)
            u, v = np.meshgrid(np.linspace(0, np.pi, 61) if r1 else np.pi / 2, v)
            rho = r2 + r1 * np.sin(u)
            mesh = np.stack([r1 * np.cos(u), rho * np.cos(v), rho * np.sin(v)], -1)
            self._meshes.append(mesh.reshape(-1, 3))

    def enclose(self, error, spread=0.0):
        radius = np.zeros(len(self.x))
        radius[:3] = spread
        contacts = contact_points(self.model, self.z)
        return enclose_poses(self.model, self.x, self.q, contacts, error, radius)

    def gaps(self, x, q, extra=lambda x, _: 0 * x):
        """Return the smallest heights of the wheels above the map plus ``extra``."""
        return self.lowest(x, q, extra)[0]

    def lowest(self, x, q, extra):
        """Return the smallest heights of the wheels, where they are, and centres of the wheels."""
        poses = np.array(pose_graphs(self.model).poses(np.concatenate([x, q])))
        ground, gaps, spots = self.model.ground, [], []
        columns = np.reshape(poses[-12 * len(self._meshes) :], (-1, 4, 3))
        for mesh, (center, *axes) in zip(self._meshes, columns, strict=True):
            points = center + mesh @ np.array(axes) + ground.origin
            height = ground.elevation(points[:, 0], points[:, 1]) + extra(*points.T[:2])
            spots.append(points[(points[:, 2] - height).argmin()] - ground.origin)
            gaps.append((points[:, 2] - height).min())
        return np.array(gaps), np.array(spots), columns[:, 0]

    def place(self, x, q, extra=lambda x, _: 0 * x):
        """Return a pose at which all wheels touch the ground; None if the search finds none."""
        step = 1e-4
        jacobian = np.empty((q.size, q.size))
        for k, unit in enumerate(np.eye(q.size)):
            ahead, behind = (self.gaps(x, q + s * step * unit, extra) for s in (1, -1))
            jacobian[:, k] = (ahead - behind) / (2 * step)
        for damping in (1.0, 0.4):
            best = q
            for _ in range(40):
                gap = self.gaps(x, best, extra)
                if np.abs(gap).max() < MESH:
                    return best
                best = best - damping * np.linalg.solve(jacobian, gap)
        return None


def bands(rng, error, contacts):
    """Return differences from the map of magnitude ``error``: blocks, kinks, stones and waves."""
    side = rng.choice([-1.0, 1.0], contacts.shape[1])

    def blocks(x, y):  # one sign under each wheel, with walls between, smooth enough to be found
        away = np.hypot(x[:, None] - contacts[0], y[:, None] - contacts[1])
        return error * side[away.argmin(axis=1)] * (0.9 + 0.1 * np.sin(31 * x + 17 * y))

    k, phase = rng.uniform(5, 60, (2, 2)), rng.uniform(0, 2 * np.pi, 2)
    sharp = rng.choice([1.0, 5.0])

    def kinks(x, y):
        wave = np.sin(k[0, 0] * x + k[0, 1] * y + phase[0])
        return error * np.clip(sharp * wave * np.sin(k[1, 0] * x - k[1, 1] * y + phase[1]), -1, 1)

    spots = contacts[:, rng.integers(0, contacts.shape[1], 12)] + rng.normal(0, 0.08, (2, 12))

    def stones(x, y):
        away = np.hypot(x[:, None] - spots[0], y[:, None] - spots[1]).min(axis=1)
        return error * np.clip(2 - 2 * away / 0.05, -1, 1)

    return blocks, kinks, stones


def margins_of(placing, x, q, extra):
    """Return tip-over margin and clearance of a rigid three-wheeler with a box, by brute force.

    The ground is the map plus ``extra``; both are upper bounds, exact up to the meshes.
    """
    model, origin = placing.model, np.array(placing.model.ground.origin)
    body, turn = model.vehicle.body, Rotation.from_euler("ZYX", [x[2], q[1], q[2]]).as_matrix()
    (_, box), place = model.vehicle.shapes[0], np.array([x[0], x[1], q[0]])
    _, contacts, centers = placing.lowest(x, q, extra)
    masses = [body.mass, *(wheel.mass for wheel in model.vehicle.wheels)]
    at = np.stack([place + turn @ body.at, *centers])
    arms = contacts - np.average(at, axis=0, weights=masses)
    normals = np.cross(arms, np.roll(arms, -1, axis=0))  # right, left, front: clockwise
    tip = np.arcsin(-normals[:, 2] / np.linalg.norm(normals, axis=1)).min()
    grid = np.linspace(-1, 1, 161)
    u, v = (a.ravel() + b for a, b in zip(np.meshgrid(grid, grid), place + origin, strict=False))
    ground = np.stack([u, v, model.ground.elevation(u, v) + extra(u, v)], axis=-1)
    near = (ground - origin - place) @ turn
    return np.array([tip, shape_distance(box, near).min()])


def is_within(pose, found, lane):
    """Return whether a pose is within bounds, up to the error of the mesh."""
    room = 40 * MESH
    low, high = found.low[:, lane], found.high[:, lane]
    return bool(((pose > low - room) & (pose < high + room)).all())


def used(placing, found, error, kinds, spread=0.0, seen=None):
    """Return the used shares of the bounds by vehicles on grounds of the band; assert all < 1."""
    rng, shares = np.random.default_rng(7), list[float]()
    contacts = contact_points(placing.model, placing.z)
    contacts += np.array(placing.model.ground.origin[:2])[:, None, None]
    for lane in np.flatnonzero(found.is_enclosed):
        x, q = placing.x[:, lane].copy(), placing.q[:, lane]
        x[:3] += spread * rng.choice([-1.0, 1.0], 3)
        for extra in bands(rng, error, contacts[..., lane])[:kinds]:
            pose = placing.place(x, q, extra)
            if pose is not None and np.abs(pose - q).max() < FAR:  # others are other rests
                assert is_within(pose, found, lane)
                if seen is not None:
                    seen.append((lane, x, pose, extra))
                shares.append(np.abs((pose - q) / (found.high[:, lane] - q)).max())
    return np.array(shares)


@pytest.fixture(scope="module")
def wheeler():
    return Placing(direct_kinematics(catalog.three_wheeler(), rough()))


def test_interval_operations_contain_exact_results():
    rng = np.random.default_rng(3)
    scale = 10.0 ** rng.integers(-12, 12, (2, 3, 400))
    points = np.sort(rng.normal(size=scale.shape) * scale, axis=1)  # ends, and one in between
    a, b = (Intervals(low, high) for low, _, high in points)
    found = (
        (a + b, lambda p, q: p + q),
        (a - b, lambda p, q: p - q),
        (a * b, lambda p, q: p * q),
        (a.square(), lambda p, _: p * p),
        (b.inverse(), lambda _, q: 1 / q),
        (a * 0.1, lambda p, _: p * Fraction(0.1)),
    )
    for result, exact in found:
        for k in np.flatnonzero(np.isfinite(result.low)):
            low, high = Fraction(result.low[k]), Fraction(result.high[k])
            for p, q in product(*(map(Fraction, each[:, k]) for each in points)):
                assert low <= exact(p, q) <= high
    assert (np.isfinite([each.low for each, _ in found]).all(axis=0) == ~b.contains_zero).all()
    values = np.array([2.0, 3e-7, 5e11, 1.0])
    root = exactly(values).sqrt()
    for low, high, value in zip(root.low, root.high, values, strict=True):
        assert Fraction(low) ** 2 <= Fraction(value) <= Fraction(high) ** 2


def test_interval_sines_contain_all_values():
    rng = np.random.default_rng(5)
    low = rng.uniform(-10, 10, 3000)
    box = Intervals(low, low + rng.uniform(0, 8, 3000) ** 2 / 8)
    share = np.linspace(0, 1, 101)[:, None]
    angles = box.low + share * (box.high - box.low)
    for function in ("sin", "cos"):
        found, values = getattr(box, function)(), getattr(np, function)(angles)
        assert (found.low <= values).all()
        assert (values <= found.high).all()
        assert (found.high - found.low <= np.ptp(values, axis=0) + 0.02).all()


@pytest.mark.parametrize("h", [0.05, 0.2])
def test_ground_bounds_contain_heights_and_slopes(h):
    terrain = rough(h=h, shortest=0.6)
    ground, rng = range_of(terrain), np.random.default_rng(2)
    x, y = rng.uniform(-4, 4, (2, 200))
    jets = ground.jets(np.stack([x, y]))
    for reach in (0.0, 0.01, 0.3):
        box = np.full((2, 200), reach)
        heights, slopes = ground.heights(jets, box), ground.slopes(jets, Intervals(-box, box))
        for a, b in rng.uniform(-1, 1, (40, 2)) * reach:
            z = terrain.elevation(x + a, y + b) - terrain.origin[2]
            assert ((heights.low <= z + 1e-14) & (z - 1e-14 <= heights.high)).all()
            steps = 1e-5 * np.array([[[1], [-1], [0], [0]], [[0], [0], [1], [-1]]])
            ends = terrain.elevation(x + a + steps[0], y + b + steps[1])
            slope = (ends[::2] - ends[1::2]) / 2e-5
            assert ((slopes.low < slope + 1e-7) & (slope - 1e-7 < slopes.high)).all()
    assert_allclose(jets.height, terrain.elevation(x, y) - terrain.origin[2], atol=1e-12)


def curved_rocker():
    """Return a rover whose joints turn by nonlinear functions of their coordinates."""
    vehicle = catalog.rocky7()
    joints = (replace(each, value=f"1.1 * sin({each.value})") for each in vehicle.joints)
    return replace(vehicle, joints=tuple(joints))


@pytest.mark.parametrize(
    "vehicle",
    [catalog.three_wheeler(axle="sliding"), catalog.differential_drive(), curved_rocker()],
    ids=lambda vehicle: vehicle.name,
)
def test_gap_bounds_of_single_and_divided_contacts_contain_gaps_of_meshes(vehicle, monkeypatch):
    """Boxes are curved, and all coordinates vary, also those of joints with nonlinear formulas."""
    placing = Placing(direct_kinematics(vehicle, rough(rms=0.1)), n=6)
    contacts, rng = contact_points(placing.model, placing.z), np.random.default_rng(4)
    middle, ground = np.concatenate([placing.x, placing.q]), range_of(placing.model.ground)
    graphs = pose_graphs(placing.model, len(placing.x) * (True,))
    frame, curve = wheel_frames(*tangents(graphs, ground, middle, contacts)[1:], graphs.given)
    radius = np.full_like(middle, 0.005)
    boxes = Boxes(middle, frame, 1.5 * curve, radius, contacts)
    both = [gap_bounds(graphs, ground, boxes, divided=divided) for divided in (False, True)]
    assert (both[0].slope.low != both[1].slope.low).any(axis=0).mean() > 0.6  # single contacts
    monkeypatch.setattr("slipfree.enclosure.wheel_gaps.library", lambda: None)
    plain = gap_bounds(graphs, ground, boxes, divided=True)
    assert_allclose(plain.gap.low, both[1].gap.low, 1e-9, 1e-12)
    assert_allclose(plain.mean_slope.high, both[1].mean_slope.high, 1e-9, 1e-12)
    for found in both:
        for _ in range(12):
            s = radius * rng.choice([-1.0, -0.3, 0.6, 1.0], radius.shape)
            away = np.einsum("kan,an->kn", frame, s)
            away += np.einsum("kabn,an,bn->kn", boxes.curve, s, s) / 2
            poses = (np.split(pose, [graphs.given]) for pose in (middle + away).T)
            gaps = np.transpose([placing.gaps(*pose) for pose in poses])
            change = found.mean_slope * s[:, None]
            assert (found.gap.low + change.low.sum(axis=0) < gaps + 1e-9).all()
            assert (gaps - MESH < found.gap.high + change.high.sum(axis=0)).all()


@pytest.mark.parametrize("error", [0.001, 0.005, 0.02, 0.05])
def test_bounds_of_a_mobility_map_contain_the_computed_extremes_and_are_tight(wheeler, error):
    x = np.array([-1.0, 0.5, HALF - 0.1])  # the last one is too close to the border to stand
    places = {"headings": [0.3, 2.5], "x": x, "y": [0.2], "compiled": False}
    whole = atlas(wheeler.model, **places, error=error, guarantee=error)
    assert np.isnan(whole["proved"][:, 2]).all()
    found = {name: band.values[:, :2] for name, band in whole.bands.items()}
    assert (found["proved"] == 1).all()
    alone = guarantee(wheeler.model, settle(wheeler.model, x=-1.0, y=0.2, heading=0.3), error)
    for name in ("roll", "pitch"):
        bounds, ends = (
            [found[f"{name}{kind}_{end}"] for end in ("low", "high")] for kind in ("", "_computed")
        )
        assert (bounds[0] <= ends[0]).all()
        assert (ends[0] < found[name]).all()
        assert (found[name] < ends[1]).all()
        assert (ends[1] <= bounds[1]).all()
        own = alone.low[name][0], alone.high[name][0]
        assert_allclose([each[0, 0, 0] for each in bounds], own, rtol=1e-6)
        widths = [each[1] - each[0] for each in (bounds, ends)]
        assert (widths[0] <= widths[1] * (1.005 + 4 * error) + 4e-5).all()


@pytest.mark.parametrize(
    ("error", "spread"), [(0.005, 0.0), (0.005, 0.02), (0.02, 0.0), (0.05, 0.0)]
)
def test_vehicles_placed_on_grounds_of_the_band_are_within_bounds(wheeler, error, spread):
    found = wheeler.enclose(error, spread)
    assert found.is_enclosed.all()
    shares = used(wheeler, found, error, kinds=3, spread=spread)
    assert shares.size > wheeler.n  # others are kinked so much that the search does not converge
    assert shares.max() > 0.7


@pytest.mark.parametrize("error", [0.0, 0.005, 0.02])
def test_margins_of_vehicles_placed_on_grounds_of_the_band_are_above_their_lower_bounds(error):
    vehicle = with_shapes(catalog.three_wheeler(axle="fixed"), Box((0.5, 0.8, 0.2), (0.05, 0.3, 0)))
    placing = Placing(direct_kinematics(vehicle, rough(rms=0.1)), n=5)
    found, seen = placing.enclose(error), []
    used(placing, found, error, kinds=3, seen=seen)
    graphs, ground = pose_graphs(placing.model), range_of(placing.model.ground)
    bounds = lower_margins(placing.model, graphs, ground, found.boxes, error)
    low = np.stack([bounds[name] for name in MARGINS], axis=1)
    room = [margins_of(placing, *pose) - low[lane] for lane, *pose in seen]
    assert len(room) > placing.n
    assert np.min(room) > -MESH
    assert np.min(room, axis=0)[1] < 0.004 + 2 * error  # of the pose and of the ground below


def test_without_error_the_bounds_are_those_of_rounding_and_patches(wheeler):
    found = wheeler.enclose(0.0)
    assert found.is_enclosed.all()
    assert ((found.low <= wheeler.q) & (wheeler.q <= found.high)).all()
    assert (found.high - found.low < 2e-5).all()


def test_errors_larger_than_the_vehicle_are_undecided(wheeler):
    for error in (0.6, 2.0, 1e3):
        found = wheeler.enclose(error)
        assert not found.is_enclosed.any()
        assert found.on_map.all() or error > 0.6
        assert np.isnan(found.low).all()


def test_poses_with_too_many_patches_are_given_up(wheeler, monkeypatch):
    monkeypatch.setattr("slipfree.enclosure.wheel_gaps.MAX_PATCHES", 100)
    monkeypatch.setattr(sys.modules["slipfree.enclosure.guarantee"], "QUICK_TRIES", 0)
    found = wheeler.enclose(0.005)
    assert not found.is_enclosed.any()
    assert found.on_map.all()
    assert np.isnan(found.high).all()


@pytest.mark.parametrize(
    ("name", "error"),
    [
        ("three_wheeler", 0.02),
        ("articulated", 0.02),
        ("rocky7", 0.005),
        ("differential_drive", 0.01),
    ],
)
def test_poses_on_a_measured_map_are_guaranteed_and_contain_placed_vehicles(name, error):
    model = direct_kinematics(getattr(catalog, name)(), Bicubic(jacksboro(0.005)))
    placing = Placing(model, n=4, reach=15.0)
    found = placing.enclose(error)
    assert found.is_enclosed.all()
    assert used(placing, found, error, kinds=2).size >= placing.n


@pytest.mark.parametrize("seed", range(4))
def test_hostile_grounds_are_never_guaranteed_wrongly(seed):
    """Walls, folds and hollows narrower than the wheels: a guarantee holds where it is given."""
    rng = np.random.default_rng(seed)
    ground = rough(rms=0.2 + 0.1 * seed, shortest=0.3 + 0.1 * seed, seed=seed, h=0.1)
    z = ground.grid.z.copy()
    wall = rng.uniform(-2, 2)
    z[:, ground.grid.y > wall] += rng.uniform(0.1, 0.3)
    ground = Bicubic(Grid(ground.grid.x, ground.grid.y, z))
    placing = Placing(direct_kinematics(catalog.three_wheeler(), ground), seed=seed, n=6)
    for error in (0.002, 0.02):
        found = placing.enclose(error)
        assert not (found.is_enclosed & found.penetrates).any()
        poses = zip(placing.x.T, placing.q.T, strict=True)
        gap = np.array([placing.gaps(*pose).min() for pose in poses])
        assert found.penetrates[gap < -1e-3].all()  # the contact is not that of a rigid wheel
        assert (gap[found.penetrates] < MESH - 1e-6).all()
        used(placing, found, error, kinds=2)


def test_several_contacts_of_a_wheel_are_enclosed():
    """A wheel in a groove touches both of its edges: no single contact is assumed."""
    axis = np.linspace(-4, 4, 161)
    groove = -0.05 * np.exp(-(((axis - 1.0) / 0.06) ** 2))
    ground = Bicubic(Grid(axis, axis, np.tile(groove, (161, 1))))
    model = direct_kinematics(catalog.three_wheeler(), ground)
    placing = Placing(model, n=1)
    placing.x[:] = 0.0
    level = placing.place(placing.x[:, 0], np.array([0.3 - model.ground.origin[2], 0.0, 0.0]))
    placing.q[:, 0] = level + np.array([2 * MESH, 0, 0])  # the mesh is slightly inside the wheel
    found = placing.enclose(0.002)
    assert found.is_enclosed.all()
    assert is_within(level, found, 0)


def test_edges_of_the_map_and_holes_are_undecided():
    axis = np.linspace(-4, 4, 41)
    grid = Grid(axis, axis, np.zeros((41, 1)) + 0.01 * axis)
    hole = np.zeros((41, 41), dtype=bool)
    hole[20, 26] = True
    for holes, y, reason in (
        (None, 2.8, OFF_MAP),
        (None, 2.0, ""),
        (hole, 0.0, OFF_MAP),
        (hole, -2.5, ""),
    ):
        ground = Bicubic(replace(grid, holes=holes))
        model = direct_kinematics(catalog.three_wheeler(), ground)
        found = guarantee(model, settle(replace(model, limits=(), checks=()), y=y), 0.01)
        assert found.reasons == (reason,)
        assert found.is_guaranteed.all() == (not reason)


def test_a_second_contact_refutes_the_nominal_pose():
    axis = np.linspace(-4, 4, 161)
    z = 0.2 * np.exp(-(axis[:, None] ** 2 + (axis - 1.25) ** 2) / (2 * 0.06**2))
    model = direct_kinematics(catalog.three_wheeler(), Bicubic(Grid(axis, axis, z)))
    pose = settle(replace(model, checks=()))  # the rest without second contact is higher
    assert settle(model)["z"][0] > pose["z"][0]
    found = guarantee(model, pose, 0.01)
    assert found.verdicts == (Verdict.REFUTED,)
    assert np.isnan(found.low["roll"]).all()


def test_invalid_models_and_names_are_refused(wheeler):
    model = wheeler.model
    run = settle(model)
    with pytest.raises(ModelError, match="spread: expected one of x, y, heading"):
        guarantee(model, run, 0.01, spread={"z": 0.1})
    with pytest.raises(ModelError, match="found pressed wheels or inertia; use"):
        pose_graphs(dynamics(catalog.skid_steer(), replace(model.ground, mu=0.5)))
    plane = direct_kinematics(catalog.three_wheeler(), Analytic(lambda x, y: 0.1 * x + 0 * y))
    with pytest.raises(ModelError, match="expected a model of a vehicle on a map"):
        guarantee(plane, settle(plane), 0.01)
    with pytest.raises(ModelError, match="expected a map"):
        atlas(plane, x=[0.0], y=[0.0], error=0.01, compiled=False)
