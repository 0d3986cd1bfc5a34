"""Tests of solids on a ground: distances, wheel contacts, and climbs in three dimensions."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import slipfree as sf
from helpers.commands import refuses
from helpers.dynamics import FLAT, energy_error, four_wheels, moved
from slipfree.contact import touch
from slipfree.contact.touch import solid_touch
from slipfree.core.lookups import LookupTable, lookup_function
from slipfree.core.trajectory import Outcome, Stop
from slipfree.geometry.frame import Pose
from slipfree.models.samples import obstacle_ending
from slipfree.terrain.solids import Prism, Solid, kerb, placed, ramp, step
from slipfree.vehicle.sections import Disc, Sphere, Torus
from slipfree.vehicle.tree import Wheel

GRIPPY = replace(FLAT, mu=0.9)
BLOCK = Solid(((0.0, -0.2), (0.5, -0.2), (0.5, 0.3), (0.0, 0.3)))
COUNT = 150


def test_the_distance_of_a_turned_block_is_that_of_its_box():
    prism = Prism(BLOCK, 0.3, -0.4, 0.1, heading=0.7, half_width=0.25)
    place = np.random.default_rng(0).uniform(-0.8, 0.8, (3, COUNT))
    inside = prism.axes.T @ (place - [[0.3], [-0.4], [0.1]])
    low, high = np.array([[0.0, -0.25, -0.2], [0.5, 0.25, 0.3]])[..., None]
    outside = np.linalg.norm(inside - np.clip(inside, low, high), axis=0)
    depth = np.minimum(inside - low, high - inside).min(axis=0)
    expected = np.where(outside > 0, outside, -depth)
    p = ca.SX.sym("p", 3)
    gap = ca.Function("gap", [p], [*prism.gap(p), ca.gradient(prism.gap(p)[0], p)])
    distance, normal, gradient = (np.array(each) for each in gap.map(COUNT)(place))
    assert (expected < 0).sum() > 2
    assert_allclose(distance[0], expected, atol=1e-9)
    assert_allclose(normal, gradient, atol=1e-6)
    assert_allclose(np.linalg.norm(normal, axis=0), 1, atol=1e-9)
    again = prism.distance(place.T)
    assert_allclose(again[0], expected, atol=1e-9)
    assert_allclose(again[1], normal.T, atol=1e-12)


def test_the_elevation_is_that_of_the_highest_surface():
    rising = sf.Analytic(lambda x, y: 0.1 * y + 0 * x, mu=1.0)
    ground = sf.Solids(
        rising, placed(ramp(np.pi / 4, 0.2), x=1.0, y=2.0, z=0.2, heading=-np.pi / 2)
    )
    x = np.array([0.5, 1.0, 1.1, 1.5, 1.5, 1.5])
    y = np.array([2.0, 2.0, 2.0, 2.0, 3.0, 6.0])
    assert_allclose(ground.elevation(x, y), [0.2, 0.2, 0.3, 0.4, 0.4, 0.6], atol=1e-12)
    narrow = sf.Solids(rising, placed(kerb(0.3, 0.4), y=2.0, half_width=0.5))
    assert_allclose(narrow.elevation([0.4, 0.6, 0.4], [2.2, 2.2, 2.5]), [0.3, 0.22, 0.25])


def poses(rng):
    """Return axles and centres of wheels above, on and in a step, leaning and steered."""
    heading, lean = rng.uniform(-1, 1, COUNT), rng.uniform(-0.5, 0.5, COUNT)
    cosine = np.cos(lean)
    axle = np.array([np.cos(heading) * cosine, np.sin(heading) * cosine, np.sin(lean)])
    y, z = rng.uniform(-0.12, 0.12, COUNT), rng.uniform(0.03, 0.2, COUNT)
    return np.vstack([rng.uniform(-0.05, 0.05, COUNT), y, z]), axle


def contact_function(prism, section, terrain=FLAT):
    center, axle = ca.SX.sym("center", 3), ca.SX.sym("axle", 3)
    forward = ca.cross(axle, ca.SX([0, 0, 1]))
    forward /= ca.norm_2(forward)
    pose = Pose(ca.horzcat(axle, forward, ca.cross(axle, forward)), center)
    wheel = Wheel("w", "platform", (0, 0, 0), section, True)
    at = solid_touch(prism, terrain, wheel, pose, LookupTable())
    found = [at.gap, at.frame.normal, at.frame.point, ca.gradient(at.gap, center)]
    return ca.Function("contact", [center, axle], found, {"cse": True})


@pytest.mark.slow
@pytest.mark.parametrize(
    "prism",
    [placed(step(0.09))[0], placed(ramp(np.pi / 4, 0.09))[0], Prism(BLOCK, half_width=0.04)],
    ids=["step", "ramp", "block"],
)
def test_the_gap_of_a_leaning_torus_is_the_distance_of_its_disc(prism):
    r1, r2 = 0.02, 0.045
    center, axle = poses(np.random.default_rng(2))
    gap, normal, point, gradient = (
        np.array(each) for each in contact_function(prism, Torus(r1, r2)).map(COUNT)(center, axle)
    )
    side = np.cross(axle.T, [0, 0, 1.0])
    side /= np.linalg.norm(side, axis=1)[:, None]
    other = np.cross(side, axle.T)
    radius, angle = np.meshgrid(np.linspace(0, r2, 10), np.linspace(0, 2 * np.pi, 541))
    discs = center.T[:, None] + radius.ravel()[None, :, None] * (
        np.cos(angle.ravel())[None, :, None] * side[:, None]
        + np.sin(angle.ravel())[None, :, None] * other[:, None]
    )
    expected = prism.distance(discs)[0].min(axis=1) - r1
    near = (expected > -0.005) & (expected < 0.02)
    assert near.sum() > 10
    assert_allclose(gap[0, near], expected[near], atol=5e-5)  # of the sampled disc
    assert_allclose(normal[:, near], gradient[:, near], atol=2e-3)
    wide = np.median(np.abs(normal - gradient)[:, near].max(axis=0))
    assert wide < 1e-8
    on_solid = point - gap * normal
    assert np.abs(prism.distance(on_solid[:, near].T)[0]).max() < 1e-5


@pytest.mark.parametrize("section", [Torus(0.03, 0.12), Sphere(0.15)], ids=str)
def test_a_wheel_touches_the_top_of_a_solid_as_it_touches_a_plane(section):
    prism = Prism(Solid(((-9.0, -1.0), (9.0, -1.0), (9.0, 0.0), (-9.0, 0.0))))
    rng = np.random.default_rng(3)
    axle = rng.standard_normal((3, COUNT)) * [[1.0], [1.0], [0.4]]
    axle /= np.linalg.norm(axle, axis=0)
    center = np.vstack([rng.uniform(-1, 1, (2, COUNT)), rng.uniform(0.12, 0.3, COUNT)])
    gap, normal, point, _ = (
        np.array(each) for each in contact_function(prism, section).map(COUNT)(center, axle)
    )
    search = touch.search_function(FLAT, section, 0.15)
    plane_gap, plane_point = ground_contacts(FLAT, section, search)(center, axle)
    assert_allclose(gap, plane_gap, atol=1e-9)
    assert_allclose(point, plane_point, atol=1e-9)
    assert_allclose(normal, np.tile([[0], [0], [1]], COUNT), atol=1e-12)


def test_a_plane_needs_no_search():
    slope = sf.Analytic(lambda x, y: 0.3 * x - 0.1 * y + 0.05, mu=0.8)
    section = Torus(0.03, 0.12)
    plane = touch.plane_of(slope)
    assert isinstance(touch.search_function(slope, section, 0.15), touch.Plane)
    rng = np.random.default_rng(0)
    axle = rng.standard_normal((3, COUNT)) * [[1.0], [1.0], [0.4]]
    center, axle = rng.uniform(-1, 1, (3, COUNT)), axle / np.linalg.norm(axle, axis=0)
    searched = ground_contacts(slope, section, touch._search_graph(slope, section, 0.15))
    for one, other in zip(
        ground_contacts(slope, section, plane)(center, axle), searched(center, axle), strict=True
    ):
        assert_allclose(one, other, atol=1e-12)
    assert touch.plane_of(sf.Analytic(lambda x, y: x * y)) is None


def ground_contacts(terrain, section, search):
    """Gap and point of a wheel on a ground, as a function of centres and axles (3, n)."""
    symbols = ca.SX.sym("center", 3), ca.SX.sym("axle", 3)
    wheel, lookups = Wheel("w", "platform", (0, 0, 0), section, True), LookupTable()
    pose = Pose(ca.horzcat(symbols[1], ca.SX.zeros(3, 2)), symbols[0])
    at = touch.touch(terrain, wheel, pose, search, lookups)
    found = lookup_function(lookups.lookups, "plane", symbols, [at.gap, at.frame.point])
    return lambda *given: [np.array(each) for each in found.map(COUNT)(*given)]


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [3, 10, 20])
def test_the_gap_of_a_wheel_along_an_edge(degrees):
    """The wheel leans on the edge of a step; alternating projections alone converge slowly."""
    prism, (r1, r2) = placed(step(0.09))[0], (0.02, 0.045)
    angle = np.deg2rad(degrees)
    axle = np.array([-np.sin(angle), np.cos(angle), 0.0])  # edge along x
    contact = contact_function(prism, Torus(r1, r2))
    turn = np.linspace(0, 2 * np.pi, 100_001)
    forward, up = np.array([np.cos(angle), np.sin(angle), 0.0]), np.array([0.0, 0.0, 1.0])
    rim = r2 * (np.cos(turn)[:, None] * forward + np.sin(turn)[:, None] * up)
    for center in ([0.0, -0.02, 0.12], [0.0, -0.015, 0.13]):
        disc = np.concatenate([center + share * rim for share in (1.0, 0.9, 0.8, 0.7, 0.5)])
        expected = prism.distance(disc)[0].min() - r1
        assert float(contact(center, axle)[0]) == pytest.approx(expected, abs=1e-4)


@pytest.mark.parametrize("degrees", [1, 3, 10])
def test_the_normal_is_the_gradient_where_a_wheel_is_nearly_parallel_to_a_face(degrees):
    """Otherwise its spin does work: the normal must be perpendicular to the rim of the disc."""
    count, rng, (r1, r2) = 600, np.random.default_rng(4), (0.02, 0.045)
    tilt = np.tan(np.deg2rad(degrees)) * rng.uniform(-1, 1, (2, count))
    axle = np.array([tilt[0], np.ones(count), tilt[1]])
    axle /= np.linalg.norm(axle, axis=0)
    y, z = -r1 - rng.uniform(0, 2e-3, count), rng.uniform(0.05, 0.13, count)
    center = np.array([np.zeros(count), y, z])
    contact = contact_function(placed(step(0.09))[0], Torus(r1, r2))
    _, normal, point, gradient = (np.array(each) for each in contact.map(count)(center, axle))
    rim = np.cross(axle.T, (point + r1 * normal - center).T) / r2
    assert np.abs((rim * normal.T).sum(axis=1)).max() < 1e-7
    assert_allclose(normal, gradient, atol=1e-6)


def test_a_disc_keeps_its_radius_in_its_plane():
    prism, radius = placed(step(0.09))[0], 0.066
    contact = contact_function(prism, Disc(radius))
    for y, z in ((-0.063, 0.03), (-0.05, 0.13), (0.2, 0.155)):  # face, edge, top
        found = contact([0.0, y, z], [1.0, 0.0, 0.0])
        away, _ = prism.distance(np.array([[0.0, y, z]]))
        assert float(found[0]) == pytest.approx(away[0] - radius, abs=1e-9)


def climbing(vehicle, ground, heading, speed, duration, count=101):
    """Return a motion from rest at rates of a forward speed."""
    model = sf.dynamics(vehicle, ground)
    rates = {label.full: 0.0 for part in model.labels.u for label in part}
    for wheel in vehicle.wheels:
        rates[f"{wheel.name}_rate"] = speed / wheel.radius * ca.tanh(model.t / 0.3)
    start = sf.settle(model, x=0.0, y=0.0, heading=heading)
    return moved(model, start, np.linspace(0, duration, count), 1e-6, **rates)


def ledger(run):
    """Return the error of the energy balance over its bound, 100 x tolerance x work."""
    error = np.abs(energy_error(run)).max()
    return error / (100 * run.statistics["tolerance"] * np.abs(run["work"]).max())


@pytest.mark.slow
def test_rocky_7_climbs_a_step_higher_than_its_wheels_at_a_heading():
    """Mirror images agree, and all wheels end on the step."""
    ground = sf.Solids(GRIPPY, placed(step(0.09), y=0.6))
    vehicle = sf.catalog.rocky7()
    run = climbing(vehicle, ground, np.deg2rad(20), 0.2, 9.0)
    assert run.stop is None
    assert run["center_z"][-1].min() > 0.09 + 0.06
    assert run["solid_load_1"][0].max() == 0
    assert run["solid_load_1"][-1].sum() == pytest.approx(vehicle.weight, rel=0.2)
    assert ledger(run) < 1
    right = climbing(vehicle, ground, -np.deg2rad(20), 0.2, 1.53, 18)
    assert_allclose(-right["x"], run["x"][:18], atol=1e-5)  # before wheels slide
    assert_allclose(right["z"], run["z"][:18], atol=1e-5)


@pytest.mark.slow
def test_with_too_little_friction_it_stays_below():
    ground = sf.Solids(replace(FLAT, mu=0.2), placed(step(0.09), y=0.6))
    run = climbing(sf.catalog.rocky7(), ground, 0.0, 0.2, 4.0)
    assert run["center_z"][-1].max() < 0.09
    assert np.abs(run["x"]).max() < 1e-6
    ending = obstacle_ending(run, sf.catalog.rocky7(), ground.prisms)
    assert ending.name == "stalls"
    assert "0 of 6 wheels had reached the top, z = 0.09 m" in ending.words
    early = obstacle_ending(run.part(slice(0, 5)), sf.catalog.rocky7(), ground.prisms)
    assert (early.name, early.words) == ("unfinished", "no wheel touched an obstacle")
    words = "the platform overturns (cosine of its inclination)"
    over = replace(run, stop=Stop("upright", 4.0, words, Outcome.LIMIT))
    ending = obstacle_ending(over, sf.catalog.rocky7(), ground.prisms)
    assert str(ending) == f"tips over: at t = 4 s {words}"
    assert obstacle_ending(run, sf.catalog.rocky7(), ()) is None


@pytest.mark.slow
def test_a_start_that_touches_a_solid_is_refused():
    model = sf.dynamics(four_wheels(), sf.Solids(FLAT, placed(step(0.1), y=0.5)))
    refuses(
        sf.ModelError, "touches a solid at the start", sf.settle, model, x=0.0, y=0.0, heading=0.0
    )


@pytest.mark.parametrize(
    "model",
    [
        sf.direct_kinematics,
        sf.quasi_statics,
        sf.montana_kinematics,
        lambda vehicle, ground: sf.inverse_kinematics(
            vehicle, ground, given=("forward", "yaw_rate")
        ),
    ],
    ids=["direct", "quasi-statics", "montana", "inverse"],
)
def test_models_without_inertia_refuse_solids(model):
    ground = sf.Solids(FLAT, placed(step(0.1), y=2.0))
    with pytest.raises(sf.ModelError, match=r"expected Terrain, found Solids; .*dynamics"):
        model(sf.catalog.three_wheeler(), ground)


@pytest.mark.parametrize(
    ("words", "numbers"),
    [
        ("heading: expected a number", {"heading": np.nan}),
        ("half_width: expected a number > 0", {"half_width": 0.0}),
    ],
)
def test_a_prism_of_invalid_numbers_is_refused(words, numbers):
    refuses(sf.ModelError, words, Prism, BLOCK, **numbers)
