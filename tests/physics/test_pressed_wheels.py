"""Tests of vehicles whose wheels cannot all touch the ground: loads, limits, motion, errors."""

from dataclasses import replace
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import slipfree as sf
from helpers.commands import refuses
from slipfree.contact.closure import has_exact_closure
from slipfree.core.errors import ModelError
from slipfree.models.friction_feasibility import best_utilisation
from slipfree.models.kinematics import SMOOTHING, pressed_dae
from slipfree.models.montana import montana_kinematics
from slipfree.models.samples import lightest_wheel, rocks
from slipfree.solve.replay import round_trip
from slipfree.solve.settle import stable_poses
from slipfree.solve.system import SolverOptions

ROBOT = sf.catalog.rigid_skid_steer()
RADIUS, WHEELBASE, HALF_TRACK = 0.165, 0.51, 0.285
HIGH = RADIUS + 38.0 * 0.05 / 46.0  # of the centre of mass: the platform has 38 kg of 46 kg


def hills(rms, seed=3, count=14):
    """Return a height function: waves of 1 to 4 m with a root mean square [m]."""
    rng = np.random.default_rng(seed)
    lengths, ways = rng.uniform(1, 4, count), rng.uniform(0, 2 * np.pi, count)
    phases, size = rng.uniform(0, 2 * np.pi, count), rms * np.sqrt(2 / count)
    k = 2 * np.pi / lengths

    def height(x, y):
        waves = zip(k * np.cos(ways), k * np.sin(ways), phases, strict=True)
        return sum(size * ca.sin(a * x + b * y + phase) for a, b, phase in waves)

    return height


def level(x, y):
    return 0 * x + 0 * y


HILLS = sf.Analytic(hills(0.02), mu=0.8)


def with_depth(vehicle, share):
    """Return a vehicle with a static depth of a share of the wheels' radii."""
    wheels = tuple(replace(w, static_depth=w.radius * share) for w in vehicle.wheels)
    return replace(vehicle, wheels=wheels)


def rates(model, value):
    names = [label.full for label in (*model.labels.u.wheels, *model.labels.u.joints)]
    driven = len(model.labels.u.wheels)
    return model.inputs(**{name: value * (k < driven) for k, name in enumerate(names)})


@pytest.mark.slow
def test_loads_on_a_slope_have_a_closed_form():
    """Moments about the contacts give the loads of the axles; depth changes them at order d0."""
    slope, errors = np.radians(15), []
    ground = sf.Analytic(lambda x, y: np.tan(slope) * y + 0 * x)
    weight = ROBOT.weight
    front = weight / 2 * (np.cos(slope) / 2 - HIGH * np.sin(slope) / WHEELBASE)
    rear = weight / 2 * np.cos(slope) - front
    for share in (1 / 50, 1 / 500):
        start = sf.settle(sf.direct_kinematics(with_depth(ROBOT, share), ground))
        loads = start["force_normal"][0]
        assert loads.sum() == pytest.approx(weight * np.cos(slope), rel=2e-4)
        assert start["force_along"][0].sum() == pytest.approx(weight * np.sin(slope), rel=2e-4)
        errors.append(np.abs(loads - [front, front, rear, rear]).max() / weight)
    assert errors[1] < 1e-4
    assert errors[0] / errors[1] == pytest.approx(10, rel=0.1)


@pytest.mark.slow
def test_exact_contact_is_the_limit_at_order_depth():
    vehicle, options = sf.catalog.skid_steer(), SolverOptions(tolerance=1e-9)
    t, apart = np.linspace(0, 4, 9), []
    exact = sf.direct_kinematics(vehicle, HILLS)
    motion = sf.simulate(exact, sf.settle(exact), rates(exact, 1.5), t, options=options)
    for share in (1 / 25, 1 / 250):
        model = pressed_dae(with_depth(vehicle, share), HILLS, sf.LeastSlip(), SMOOTHING)
        run = sf.simulate(model, sf.settle(model), rates(model, 1.5), t, options=options)
        apart.append(np.hypot(run["x"] - motion["x"], run["y"] - motion["y"]).max())
    assert apart[0] < 1e-3
    assert apart[0] / apart[1] == pytest.approx(10, rel=0.15)


def test_turning_on_the_spot_has_a_closed_form():
    """Least squares of slip along, ``w b - v``, and across, ``w L / 2``, of four wheels."""
    model, rate = sf.direct_kinematics(ROBOT, sf.Analytic(level)), 2.0
    signs = {w.name: 1.0 if "right" in w.name else -1.0 for w in ROBOT.wheels}
    inputs = model.inputs(**{f"{name}_rate": sign * rate for name, sign in signs.items()})
    run = sf.simulate(model, sf.settle(model), inputs, np.linspace(0, 1, 3))
    expected = rate * RADIUS * HALF_TRACK / (HALF_TRACK**2 + WHEELBASE**2 / 4)
    # the centre of mass lies in the middle, so that all wheels carry the same
    np.testing.assert_allclose(run["heading_rate"], expected, rtol=1e-9)
    np.testing.assert_allclose(run["load_share"], 1.0, rtol=5e-3)
    assert np.abs([run["x"], run["y"]]).max() < 1e-9


@pytest.mark.slow
def test_the_motion_does_not_depend_on_the_origin_of_the_platform():
    """The same robot, described about its rear axle: its wheels move alike."""
    shift = np.array([0.05, -WHEELBASE / 2, 0.08])
    wheels = tuple(replace(w, at=tuple(np.array(w.at) - shift)) for w in ROBOT.wheels)
    center = tuple(np.array(ROBOT.body.at) - shift)
    other = replace(ROBOT, wheels=wheels, body=replace(ROBOT.body, at=center))
    t, ends = np.linspace(0, 3, 4), []
    for vehicle, at in ((ROBOT, np.zeros(3)), (other, shift)):
        model = sf.direct_kinematics(vehicle, HILLS)
        start = sf.settle(model)
        if at.any():  # where the first robot's wheels are
            angles = [ends[0][name][0] for name in ("heading", "roll", "pitch")]
            arm = Rotation.from_euler("ZYX", angles).apply(at)
            place = np.array([ends[0][name][0] for name in "xyz"]) + arm
            pose = {name: ends[0][name][0] for name in ("roll", "pitch")}
            start = sf.settle(model, x=place[0], y=place[1], guess={"z": place[2]} | pose)
        ends.append(sf.simulate(model, start, rates(model, 3.0), t))
    for axis in "xyz":
        first, second = (run[f"center_{axis}"] for run in ends)
        np.testing.assert_allclose(second, first, atol=2e-6)


def test_poor_starts_settle():
    rng = np.random.default_rng(0)
    model = sf.direct_kinematics(ROBOT, sf.Analytic(hills(0.05)))
    for _ in range(4):
        x, y, heading = rng.uniform(-5, 5, 3)
        z, roll, pitch = rng.uniform([-0.2, -0.5, -0.5], [0.4, 0.5, 0.5])
        start = sf.settle(
            model, x=x, y=y, heading=heading, guess={"z": 0.165 + z, "roll": roll, "pitch": pitch}
        )
        assert (start["x"][0], start["heading"][0]) == (x, heading)
        still = [start[f"{name}_rate"][0] for name in ("roll", "pitch", "heading")]
        assert np.abs(still).max() < 1e-5
        assert start["load_share"][0].mean() > 0.9


@pytest.mark.slow
def test_a_robot_may_stand_on_different_wheels():
    ground = sf.Analytic(hills(0.05))
    poses = stable_poses(sf.direct_kinematics(ROBOT, ground), x=1.2, y=4.95)
    assert [lightest_wheel(pose, 0)[0] for pose in poses] == ["rear_left", "front_right"]
    assert all(pose["depth"].min() < 0 for pose in poses)  # a diagonal lies on each
    exact = sf.direct_kinematics(sf.catalog.skid_steer(), ground)
    assert len(stable_poses(exact, x=1.2, y=4.95)) == 1


@pytest.mark.slow
def test_a_robot_rocks_and_says_when():
    model = sf.direct_kinematics(ROBOT, sf.Analytic(hills(0.05)))
    run = sf.simulate(model, sf.settle(model), rates(model, 6.0), np.linspace(0, 6, 301))
    assert run.stop is None
    found = rocks(run)
    lightest = [ROBOT.wheels[k].name for k in run["load_share"].argmin(axis=1)]
    assert len(found) == sum(a != b for a, b in pairwise(lightest)) > 1
    assert [found[0].before, found[-1].after] == [lightest[0], lightest[-1]]
    name, share, depth = lightest_wheel(run, 0)
    assert (name, share, depth) == (lightest[0], run["load_share", name][0], run["depth", name][0])
    assert (run["depth"] < 0).any()


@pytest.mark.slow
def test_rates_of_commands_round_trip():
    options = SolverOptions(tolerance=1e-8)
    inverse = sf.inverse_kinematics(ROBOT, HILLS, given=["forward", "yaw_rate"])
    given = inverse.inputs(forward=0.5, yaw_rate=0.2)
    run = sf.simulate(inverse, sf.settle(inverse), given, np.linspace(0, 2, 21), options=options)
    assert run.stop is None
    direct = sf.direct_kinematics(ROBOT, HILLS)
    names = ["velocity_x", "velocity_y", "velocity_z", "heading_rate", "roll_rate", "pitch_rate"]
    assert max(round_trip(direct, run, names).values()) < 1e-9


@pytest.mark.slow
def test_six_wheels_and_no_mass():
    robot = sf.catalog.rigid_skid_steer(axles=3, mass=0.0, wheel_mass=0.0)
    assert robot.mass == 0
    model = sf.direct_kinematics(robot, HILLS)
    run = sf.simulate(model, sf.settle(model), rates(model, 6.0), np.linspace(0, 1, 5))
    assert run.stop is None
    assert "force_normal" not in run.columns
    assert run["load_share"].mean() == pytest.approx(1.0, rel=0.02)


@pytest.mark.parametrize(("heading", "arm"), [(0.0, HALF_TRACK), (np.pi / 2, WHEELBASE / 2)])
def test_a_vehicle_stands_on_a_slope_until_it_tips_over(heading, arm):
    """The load of upper wheels follows from moments about lower ones, up to the order of depths."""
    models = [
        sf.direct_kinematics(ROBOT, sf.Analytic(lambda x, _, a=share * arm / HIGH: a * x + 9))
        for share in (0.85, 1.01)
    ]
    run, slope = sf.settle(models[0], heading=heading), np.arctan(0.85 * arm / HIGH)
    assert np.hypot(run["roll"][0], run["pitch"][0]) == pytest.approx(slope, abs=0.01)
    assert run["load_share"].min() == pytest.approx(0.15 * np.cos(slope), abs=0.02 * RADIUS / arm)
    best = best_utilisation(ROBOT, sf.Analytic(lambda x, _: 0.85 * arm / HIGH * x + 9), run)
    assert best["utilisation_best"][0] == pytest.approx(np.tan(slope), rel=1e-7)
    refuses(ModelError, "tips over at the start, .* gentler", sf.settle, models[1], heading=heading)


@pytest.mark.parametrize(
    ("name", "build"),
    [
        ("rolling without slip", lambda: sf.direct_kinematics(ROBOT, HILLS, slip=sf.Rolling())),
        ("quasi-static model", lambda: sf.quasi_statics(ROBOT, HILLS, law=sf.Coulomb())),
        ("Montana's form", lambda: montana_kinematics(ROBOT, HILLS)),
    ],
)
def test_models_of_exact_contact_refuse_rigid_vehicles_by_name(name, build):
    words = f"{name}: expected a vehicle whose wheels can all touch.* beyond three .1., found 0"
    refuses(ModelError, words, build)
    assert not has_exact_closure(ROBOT)


def test_static_depths_and_axles_are_checked():
    refuses(ModelError, r"static_depth: expected a number > 0, found 0\.0", with_depth, ROBOT, 0.0)
    refuses(ModelError, "expected axles = 2 or 3, found 4", sf.catalog.rigid_skid_steer, axles=4)
