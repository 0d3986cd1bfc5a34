"""Mobility maps: poses of settle, bounds of friction, errors of heights, and reasons."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import block_diag
from scipy.optimize import linprog

import slipfree as sf
from helpers.commands import refuses
from slipfree.core.records import leaves
from slipfree.models.friction_feasibility import best_utilisation
from slipfree.terrain.synthetic import blank, power_law
from slipfree.vehicle.shapes import Ball, Box

PLACES = np.array([-1.5, 0.0, 0.7, 1.6])
HEADINGS = (0.0, 0.8, 2.5)


def hills(mu=0.5, rms=0.25):
    grid = blank((-4.0, 4.0), (-4.0, 4.0), 0.2)
    return sf.Bicubic(power_law(grid, rms=rms, hurst=0.8, shortest=1.5, longest=6.0, seed=4), mu=mu)


def picked(found, at):
    """Return the values of an atlas at the pose ``at``, by name of the band."""
    return {name: float(band.values[at]) for name, band in found.bands.items()}


@pytest.mark.parametrize(
    "vehicle", [sf.catalog.three_wheeler(), sf.catalog.ackermann()], ids=("three-wheeler", "car")
)
def test_poses_and_bounds_equal_those_of_single_poses(vehicle):
    """Each pose is that of settle, and its least friction that of the exact optimum."""
    ground = hills()
    model = sf.direct_kinematics(vehicle, ground)
    found = sf.atlas(model, headings=HEADINGS, x=PLACES, y=PLACES, compiled=False)
    assert found.stands.mean() > 0.7
    compared = np.argwhere(found.stands)[::5]
    for k, i, j in compared:
        at = {"x": PLACES[i], "y": PLACES[j], "heading": HEADINGS[k]}
        pose = sf.settle(model, **at)
        values = picked(found, (k, i, j))
        for name in ("roll", "pitch", "tip_over_margin"):
            assert values[name] == pytest.approx(pose[name][0], abs=2e-7)  # single precision
        least = 0.5 * best_utilisation(vehicle, ground, pose)["utilisation_best"][0]
        assert values["least_friction_low"] <= least + 1e-6
        assert values["least_friction_high"] >= least - 1e-6
        assert values["least_friction_high"] - values["least_friction_low"] < 1e-3
    assert len(compared) > 6


def test_friction_that_differs_between_wheels_scales_the_bounds():
    """On a map of friction, the bounds are coefficients of the wheel with the largest one."""
    vehicle = sf.catalog.ackermann()
    grid = hills().grid
    rows = 0.3 + 0.5 * (grid.x > 0.5)[:, None] * np.ones(grid.y.size)
    ground = sf.Bicubic(grid, mu=sf.Grid(grid.x, grid.y, rows))
    model = sf.direct_kinematics(vehicle, ground)
    found = sf.atlas(model, headings=[0.3], x=[0.4], y=PLACES, compiled=False)
    assert found.stands[0, 0].all()
    for j in range(PLACES.size):
        pose = sf.settle(model, x=0.4, y=PLACES[j], heading=0.3)
        least = best_utilisation(vehicle, ground, pose)["utilisation_best"][0]
        values = picked(found, (0, 0, j))
        assert values["least_utilisation_low"] - 1e-6 <= least
        assert values["least_utilisation_high"] + 1e-6 >= least
        assert values["least_utilisation_high"] - values["least_utilisation_low"] < 2e-3


def level_ground():
    axis = np.linspace(-3.0, 3.0, 25)
    return sf.Bicubic(sf.Grid(axis, axis, np.zeros((axis.size, axis.size))), mu=0.5)


def test_computed_extremes_on_level_ground_are_those_of_the_contact_heights():
    """The pose of a level three-wheeler follows from the heights at its contacts alone.

    The clearance of a ball also follows from the height below it.
    """
    vehicle, error = sf.catalog.three_wheeler(), 0.02
    ball = Ball(0.05, (0.2, 0.3, 0.0))
    vehicle = replace(vehicle, body=replace(vehicle.body, shapes=(ball,)))
    model = sf.direct_kinematics(vehicle, level_ground())
    found = sf.atlas(model, headings=[0.4], x=[0.1], y=[-0.05], error=error, compiled=False)
    pose = sf.settle(model, x=0.1, y=-0.05, heading=0.4)
    turned = np.array([[np.cos(0.4), -np.sin(0.4)], [np.sin(0.4), np.cos(0.4)]])
    spot = [0.1, -0.05] + turned @ ball.at[:2]
    contacts = np.stack([pose[f"contact_{c}"][0] for c in "xy"])
    right, left, front = contacts.T
    middle = (right + left) / 2
    shares = np.linalg.solve(np.vstack([contacts, np.ones(3)]), [*spot, 1.0])
    reaches = {
        "roll": 2 * error / np.hypot(*(right - left)),
        "pitch": 2 * error / np.hypot(*(front - middle)),
        "clearance_body": error * (1 + np.abs(shares).sum()),
    }
    values = picked(found, (0, 0, 0))
    for name, reach in reaches.items():
        assert values[f"{name}_computed_low"] == pytest.approx(values[name] - reach, rel=5e-3)
        assert values[f"{name}_computed_high"] == pytest.approx(values[name] + reach, rel=5e-3)


def test_computed_extremes_of_a_rigid_vehicle_are_those_of_a_plane_on_springs():
    """On level ground it rests on the plane through its four contacts by least squares.

    The weight above the springs softens them by the ratio of static depth and height to the square
    of half the track, half a percent.
    """
    model, error = sf.direct_kinematics(sf.catalog.rigid_skid_steer(), level_ground()), 0.02
    found = sf.atlas(model, headings=[0.0], x=[0.1], y=[-0.05], error=error, compiled=False)
    pose = sf.settle(model, x=0.1, y=-0.05)
    offsets = np.stack([pose[f"contact_{c}"][0] for c in "xy"]) - np.array([[0.1], [-0.05]])
    slopes = np.linalg.pinv(np.vstack([np.ones(4), offsets]).T)[1:]
    values = picked(found, (0, 0, 0))
    for name, slope in zip(("roll", "pitch"), slopes, strict=True):
        reach = error * np.abs(slope).sum()
        for end, sign in (("low", -1.0), ("high", 1.0)):
            value = values[f"{name}_computed_{end}"]
            assert value == pytest.approx(values[name] + sign * reach, rel=1e-2, abs=1e-6)


def test_reasons_name_the_border_steep_ground_and_the_share_of_headings():
    """A pose without a valid rest has a reason, and NaN in all other bands."""
    axis = np.linspace(-3.0, 3.0, 31)
    steep = np.where(axis > 1.0, 1.6 * (axis - 1.0), 0.0)[:, None] + np.zeros(axis.size)
    ground = sf.Bicubic(sf.Grid(axis, axis, steep), mu=0.5)
    model = sf.direct_kinematics(sf.catalog.three_wheeler(), ground)
    found = sf.atlas(model, headings=4, y=[0.0], compiled=False)
    reasons = [found.reasons[int(k)] for k in found["reason"][:, :, 0].ravel()]
    assert any("leaves the map" in words for words in reasons)
    assert "the vehicle stands" in reasons
    assert np.isnan(found["roll"][~found.stands]).all()
    held, not_held = found.held(0.5)
    assert held[:, 12, 0].all()  # level ground
    assert not_held[:, 26, 0].all()  # 58 degrees
    assert found.share(tip_over_margin=(0.1, np.inf))[12, 0] == 1.0
    value, heading = found.extreme("tip_over_margin", largest=False)
    assert value[12, 0] == found["tip_over_margin"][:, 12, 0].min()
    assert heading[12, 0] in found.heading
    with pytest.raises(sf.ModelError, match="expected one of the bands"):
        found["slope"]


def test_no_ground_far_inside_a_hole_is_named():
    """Heights there are placeholders, of which no pose is found."""
    axis = np.linspace(-3.0, 3.0, 31)
    holes = np.broadcast_to((axis > 0)[:, None], (31, 31))
    z = np.where(holes, np.random.default_rng(1).normal(0, 50, holes.shape), 0.0)
    model = sf.direct_kinematics(
        sf.catalog.rigid_skid_steer(), sf.Bicubic(sf.Grid(axis, axis, z, holes=holes))
    )
    found = sf.atlas(model, headings=4, x=[-2.0, 2.0], y=[0.0, 0.5], compiled=False)
    assert found.stands[:, 0].all()
    assert {found.reasons[int(k)][:20] for k in found["reason"][:, 1].ravel()} == {
        "a wheel reaches a ho"
    }


def test_a_rigid_vehicle_is_held_by_its_own_loads():
    """Bounds for given loads enclose a linear programme; poses are those of settle."""
    ground, vehicle = hills(rms=0.1), sf.catalog.rigid_skid_steer()
    model = sf.direct_kinematics(vehicle, ground)
    found = sf.atlas(model, headings=[0.4], x=PLACES, y=PLACES, compiled=False)
    compared = np.argwhere(found.stands & (found["rests"] == 1))[::6]
    assert len(compared) >= 3
    for at in compared:
        pose = sf.settle(model, x=PLACES[at[1]], y=PLACES[at[2]], heading=0.4)
        values = picked(found, tuple(at))
        for name in ("roll", "pitch"):
            assert values[name] == pytest.approx(pose[name][0], abs=1e-6)
        terms = model.function(
            "terms",
            [*model.columns()],
            [ca.densify(model.holding.matrix), model.holding.load, model.holding.normal],
        )
        x, z, u = (model.rows(record, pose, 0) for record in "xzu")
        matrix, load, normal = (np.array(each) for each in terms(x, z, u))
        least = least_by_polygons(matrix, load[:, 0], normal[:, 0])
        assert values["least_friction_low"] <= least * 1.0004
        assert values["least_friction_high"] >= least
        assert values["least_friction_high"] - values["least_friction_low"] < 1e-3


def least_by_polygons(matrix, load, normal, sides=128):
    """Return the least coefficient with circles replaced by polygons around them."""
    turns = 2 * np.pi * np.arange(sides) / sides
    disc = np.column_stack([np.cos(turns), np.sin(turns)])
    rows = np.column_stack([block_diag(*[disc] * normal.size), np.repeat(-normal, sides)])
    equal = np.column_stack([matrix.T, np.zeros(load.size)])
    cost = np.append(np.zeros(2 * normal.size), 1.0)
    bounds = [(None, None)] * (2 * normal.size) + [(0, None)]
    return linprog(cost, rows, np.zeros(len(rows)), equal, -load, bounds).fun


@pytest.mark.parametrize(("twist", "rests"), [(0.0, 1), (0.2, 2)])
def test_a_rigid_vehicle_rocks_on_twisted_ground(twist, rests):
    """On a saddle, a symmetric rigid vehicle rests in two ways; on level ground in one."""
    axis = np.linspace(-3.0, 3.0, 31)
    ground = sf.Bicubic(sf.Grid(axis, axis, twist * axis[:, None] * axis), mu=0.5)
    model = sf.direct_kinematics(sf.catalog.rigid_skid_steer(), ground)
    found = sf.atlas(model, headings=[0.0, np.pi / 2], x=[0.0], y=[0.0], compiled=False)
    assert (found["rests"] == rests).all()
    assert (np.hypot(found["roll"], found["pitch"]) > 0.03).all() == (rests == 2)


@pytest.mark.parametrize("on_soil", [True, False])
def test_energy_slip_and_sinkage_are_those_of_the_motion(on_soil):
    """At given rates the bands are those of simulate; relaxation to rest keeps the inputs."""
    vehicles, ground = sf.catalog, hills(rms=0.05 if on_soil else 0.1)
    model = sf.direct_kinematics(vehicles.rigid_skid_steer(), ground)
    if on_soil:
        model = sf.quasi_statics(vehicles.three_wheeler(axle="fixed"), ground, law=sf.Soil())
    inputs = {label.full: 1.0 * ("steer" not in label.full) for label in leaves(model.labels.u)}
    found = sf.atlas(model, headings=[0.4], x=[0.0], y=[0.6], inputs=inputs, compiled=False)
    run = sf.settle(model, x=0.0, y=0.6, heading=0.4)
    run = sf.simulate(model, run, model.inputs(**inputs), [0.0, 0.01])
    energy = run["power"][0] / np.hypot(run["velocity_x"][0], run["velocity_y"][0])
    assert found["energy_per_metre"].item() == pytest.approx(energy, rel=1e-6 if on_soil else 1e-4)
    for name in ("sinkage", "slip_ratio") if on_soil else ():
        assert found[name].item() == pytest.approx(run[name][0].max(), rel=1e-5)


@pytest.mark.parametrize("height", [-0.1, 0.4], ids=("low", "high"))
def test_the_clearance_of_bodies_is_that_of_single_poses(height):
    """A box keeps the distance that settle reports, near the ground and far from it."""
    box = sf.Body(10.0, shapes=(Box((0.5, 0.8, 0.1), (0.0, 0.0, height)),))
    vehicle = replace(sf.catalog.rigid_skid_steer(), body=box)
    ground = hills(rms=0.05)
    model = sf.direct_kinematics(vehicle, ground)
    found = sf.atlas(model, headings=[0.2], x=PLACES, y=[0.3], compiled=False)
    assert found.stands.all()
    for i in range(PLACES.size):
        pose = sf.settle(model, x=PLACES[i], y=0.3, heading=0.2)
        clearance = pose["clearance_body"][0]
        assert found["clearance_body"][0, i, 0] == pytest.approx(clearance, abs=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"headings": 0}, "headings: expected a number >= 1, found 0"),
        ({"inputs": {"left": 1.0}}, "inputs: expected one of right_rate, .* found 'left'"),
    ],
)
def test_wrong_arguments_are_named(arguments, message):
    ground = hills()
    model = sf.direct_kinematics(sf.catalog.three_wheeler(), ground)
    refuses(sf.ModelError, message, sf.atlas, model, compiled=False, **arguments)


def test_a_pose_does_not_depend_on_others():
    """Errors of heights have the same digits alone and beside poses with wider wheels."""
    ground = hills()
    model = sf.direct_kinematics(sf.catalog.three_wheeler(), ground)
    common = {"x": [0.7], "y": [0.0], "error": 0.02, "compiled": False}
    alone = sf.atlas(model, headings=[0.8], **common)
    beside = sf.atlas(model, headings=[0.0, 0.8, 2.0], **common)
    for name in alone.bands:
        assert_allclose(beside[name][1], alone[name][0], rtol=1e-6, err_msg=name)
