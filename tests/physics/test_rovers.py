"""Tests of the catalogue's rovers: textbook motion, published end points, poor starts, noise."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import slipfree as sf
from helpers.cases import LIGHT, closure_model, hills, rocky_run, rover_ground
from helpers.commands import refuses
from slipfree.catalog import (
    ackermann,
    articulated,
    differential_drive,
    open_source_rover,
    rocky7,
    seven_wheels,
    skid_steer,
)
from slipfree.core.records import leaves
from slipfree.vehicle.tree import body_inertia

FLAT, HILLS = sf.Analytic(lambda x, _: 0 * x), sf.Analytic(hills)
CATALOG = {
    make.__name__: make(**LIGHT)
    for make in (differential_drive, ackermann, skid_steer, articulated, open_source_rover)
}
RADIUS = 0.15  # of the wheels of the first three


def rates_at(vehicle, ground, rates, **start):
    """Rates of a vehicle at a start, by name."""
    dae = closure_model(vehicle, ground)
    given = {label.full: 0.0 for label in leaves(dae.labels.u)} | rates
    run = sf.simulate(dae, sf.settle(dae, **start), dae.inputs(**given), np.array([0.0, 1e-6]))
    return {name: run[name][0] for name in run.columns}


def heading_frame(found, heading):
    """Velocity ahead and to the right of the heading."""
    v_x, v_y = found["velocity_x"], found["velocity_y"]
    ahead = -np.sin(heading) * v_x + np.cos(heading) * v_y
    return ahead, np.cos(heading) * v_x + np.sin(heading) * v_y


def test_differential_drive_and_its_caster_move_as_in_the_textbook():
    half, ahead, trail, angle = 0.25, 0.35, 0.08, 0.2
    right, left = 1.0, 0.8
    found = rates_at(
        CATALOG["differential_drive"],
        FLAT,
        {"right_rate": right, "left_rate": left},
        heading=0.3,
        caster_angle=angle,
    )
    v, turning = RADIUS * (right + left) / 2, RADIUS * (right - left) / (2 * half)
    assert_allclose(heading_frame(found, 0.3), (v, 0), atol=1e-12)
    assert_allclose(found["heading_rate"], turning, atol=1e-12)
    pivot = np.array([-turning * ahead, v])  # right and ahead
    across = np.array([np.cos(angle), np.sin(angle)]) @ pivot
    along = np.array([-np.sin(angle), np.cos(angle)]) @ pivot
    assert_allclose(found["caster_angle_rate"], -across / trail - turning, atol=1e-12)
    assert_allclose(found["caster_rate"], along / (RADIUS * 2 / 3), atol=1e-12)


def test_ackermann_turns_about_the_rear_axle_without_slip():
    v, steer, base, half = 0.15, 0.3, 0.7, 0.3
    turning = v * np.tan(steer) / base
    rates = {
        "rear_right_rate": (v + half * turning) / RADIUS,
        "rear_left_rate": (v - half * turning) / RADIUS,
    }
    found = rates_at(CATALOG["ackermann"], FLAT, rates, heading=0.3, steer=steer)
    assert_allclose(heading_frame(found, 0.3), (v, 0), atol=1e-12)
    assert_allclose(found["heading_rate"], turning, atol=1e-12)
    assert_allclose([found["slip_along"], found["slip_across"]], 0, atol=1e-12)
    places = np.array([[half, base], [-half, base]])  # the middle of the turn is to the left
    distances = np.hypot(places[:, 0] + v / turning, places[:, 1])
    fronts = [found[f"front_{side}_rate"] for side in ("right", "left")]
    assert_allclose(fronts, turning * distances / RADIUS, atol=1e-12)


def test_a_skid_steered_cart_turns_less_by_its_length():
    half, base, right, left = 0.3, 0.5, 1.0, 0.6
    rates = {
        f"{end}_{side}_rate": value
        for end in ("front", "rear")
        for side, value in (("right", right), ("left", left))
    }
    found = rates_at(CATALOG["skid_steer"], FLAT, rates, heading=0.3)
    turning = half * RADIUS * (right - left) / (2 * (half**2 + (base / 2) ** 2))
    assert_allclose(heading_frame(found, 0.3), (RADIUS * (right + left) / 2, 0), atol=1e-12)
    assert_allclose(found["heading_rate"], turning, atol=1e-12)


@pytest.mark.slow
def test_a_rover_turns_about_its_middle_axle_without_slip():
    turning, away = 0.2, 0.8  # the middle of the turn, to the left [rad/s], [m]
    vehicle = CATALOG["open_source_rover"]
    rest = sf.settle(closure_model(vehicle, FLAT))
    axle = rest["center_y"][0, [w.name.startswith("middle") for w in vehicle.wheels]][0]
    start, rates = {}, {}
    for k, wheel in enumerate(vehicle.wheels):
        right, ahead = rest["center_x"][0, k] + away, rest["center_y"][0, k] - axle
        if wheel.parent.startswith("steer"):
            start[wheel.parent] = np.arctan2(ahead, right)
        rates[f"{wheel.name}_rate"] = turning * np.hypot(right, ahead) / wheel.radius
    found = rates_at(vehicle, FLAT, rates, **start)
    assert_allclose(found["heading_rate"], turning, atol=1e-12)
    assert_allclose([found["slip_along"], found["slip_across"]], 0, atol=1e-12)


def test_the_articulated_loader_turns_about_where_its_axles_meet():
    bend, front, rear, half, radius, v = 0.3, 0.4, 0.4, 0.35, 0.2, 0.2
    away = (rear + front * np.cos(bend)) / np.sin(bend)  # of the front axle's middle
    turning, behind = v / away, (front + rear * np.cos(bend)) / np.sin(bend)
    rates = {}
    for side, way in (("right", 1), ("left", -1)):
        rates[f"front_{side}_rate"] = turning * (away + way * half) / radius
        rates[f"rear_{side}_rate"] = turning * (behind + way * half) / radius
    # bent to the right, the rear half swings out and the front turns left
    found = rates_at(CATALOG["articulated"], FLAT, rates, bend=-bend)
    assert_allclose(found["heading_rate"], turning, atol=1e-12)
    assert_allclose([found["slip_along"], found["slip_across"]], 0, atol=1e-12)


ENDS = {  # radius of the tubes, steering: x, y, z after 10 s, found with another code
    (0.0, 0.0): (6.052913, -0.342339, 0.175481),
    (0.02, 0.1): (5.752414, 1.337478, 0.266629),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", ENDS)
def test_rocky_7_ends_where_another_code_has_it(case):
    run = rocky_run(rover_ground(), *case)
    assert_allclose([run[name][-1] for name in "xyz"], ENDS[case], atol=1e-5)
    assert run["closure_residual"].max() < 1e-12
    below = run["center_z"] - sf.Bicubic(rover_ground()).elevation(run["center_x"], run["center_y"])
    assert below.min() > 0


def test_rocky_7_has_the_inertia_that_another_code_assumes():
    """A box of 0.40 x 0.26 x 0.16 m (wmrde): 11/12 (0.26^2 + 0.16^2) kg m^2 about the long axis."""
    found = body_inertia(rocky7(mass=11.0), "platform")
    assert_allclose(np.diag(found), [0.170133, 0.085433, 0.208633], atol=1e-6)
    assert rocky7(mass=0.0).body.inertia is None
    # a part extends to its joints: 0.6 x 0.8 x 0.15 m, from the caster's joint to the axle
    sizes = {"half_track": 0.3, "caster_ahead": 0.8, "r2": 0.12, "caster_scale": 1.0}
    cart = body_inertia(sf.catalog.differential_drive(mass=12.0, **sizes), "platform")
    assert_allclose(np.diag(cart), [0.6625, 0.3825, 1.0], rtol=1e-12)


# Seven cases on hills: inputs, start


@pytest.mark.slow
@pytest.mark.parametrize("name", ["articulated", "open_source_rover"])
def test_rovers_follow_paths(name):
    vehicle = CATALOG[name]
    way = sf.Path(np.array([(0.0, 0.0), (0.5, 2.0), (2.0, 4.0), (2.0, 7.0)]))
    dae = closure_model(vehicle, HILLS)
    start, law = sf.settle(dae, heading=-0.245), sf.follow(dae, way, speed=0.2)
    run = sf.simulate(
        dae, start, law, np.linspace(0, 36, 73), options=sf.SolverOptions(tolerance=1e-6)
    )
    assert run.stop is None
    gaps = way.distance(run["x"], run["y"])
    assert gaps.max() < 0.15  # it starts with straight wheels at the beginning of a bend
    assert gaps[-1] < 0.05
    assert np.hypot(run["x"][-1], run["y"][-1]) > 5


# With masses: forces, friction and plans, for all without special code


GENTLE = sf.Analytic(lambda x, y: 0.2 * (hills(x, y) - 2), mu=0.7)


def ahead(dae, vehicle, start):
    if vehicle.name == "seven_wheels":
        rates = {
            f"{wheel.name}_rate": 0.0 if "across" in wheel.name else 2.0 for wheel in vehicle.wheels
        }
        return dae.inputs(**rates)
    return sf.straight(dae, start, speed=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("make", [differential_drive, articulated, rocky7, seven_wheels])
def test_every_vehicle_stands_drives_and_creeps(make):
    vehicle = make()
    level = sf.settle(closure_model(vehicle, sf.Analytic(lambda x, _: 0 * x, mu=0.7)))
    assert level["force_normal"].min() > 0.05 * vehicle.weight / len(vehicle.wheels)
    assert level["force_normal"].sum() == pytest.approx(vehicle.weight, rel=1e-9)
    places, t, options = [], np.linspace(0, 5, 6), sf.SolverOptions(tolerance=1e-6)
    for dae in (closure_model(vehicle, GENTLE), sf.quasi_statics(vehicle, GENTLE)):
        start = sf.settle(dae, x=0.3, heading=0.2)
        run = sf.simulate(dae, start, ahead(dae, vehicle, start), t, options=options)
        assert run.stop is None
        assert run["force_normal"].min() > 0
        assert run["utilisation"].max() < 1
        places.append(np.array([run["x"][-1], run["y"][-1]]))
    assert np.linalg.norm(places[0] - [0.3, 0]) > 0.6
    assert np.linalg.norm(places[0] - places[1]) < 5e-3


# Seven wheels on rollers


@pytest.mark.slow
def test_seven_wheels_go_anywhere_on_level_ground():
    vehicle = seven_wheels()
    ground = sf.Analytic(lambda x, _: 0 * x, mu=0.5)
    dae = closure_model(vehicle, ground)
    rest = sf.settle(dae)
    given = {"forward": 0.1, "yaw_rate": 0.2, "right": 0.05}
    rates = {}
    for k, wheel in enumerate(vehicle.wheels):
        x, y = rest["center_x"][0, k], rest["center_y"][0, k]
        velocity = np.array([0.05 - 0.2 * y, 0.1 + 0.2 * x])
        forward = {"rear_across": (1, 0), "front_across": (-1, 0)}.get(wheel.name, (0, 1))
        rates[f"{wheel.name}_rate"] = velocity @ forward / wheel.radius
    inverse = sf.inverse_kinematics(vehicle, ground, given=tuple(given))
    sought = sf.simulate(
        inverse, sf.settle(inverse), inverse.inputs(**given), np.array([0.0, 1e-6])
    )
    assert_allclose([sought[name][0] for name in rates], list(rates.values()), atol=1e-12)
    found = rates_at(vehicle, ground, rates)
    assert_allclose(heading_frame(found, 0.0), (0.1, 0.05), atol=1e-12)
    assert_allclose(found["heading_rate"], 0.2, atol=1e-12)
    assert_allclose(found["slip_along"], 0, atol=1e-12)
    across = [w.name.endswith("across") for w in vehicle.wheels]
    assert_allclose(rest["force_normal"][0, across], 20.0, rtol=1e-9)
    assert rest["force_normal"].sum() == pytest.approx(21.6 * 9.81, rel=1e-9)
    with pytest.raises(sf.ModelError, match="'seven_wheels': expected the given rate 'right'"):
        sf.inverse_kinematics(vehicle, ground, given=("forward", "yaw_rate"))
    law = sf.straight(dae, rest, speed=0.2)
    run = sf.simulate(
        dae, rest, law, np.linspace(0, 5, 6), options=sf.SolverOptions(tolerance=1e-6)
    )
    assert_allclose([run["x"][-1], run["y"][-1]], [0, 1], atol=1e-3)


@pytest.mark.parametrize(
    ("make", "options", "words"),
    [
        (differential_drive, {"half_track": 0.0}, "half_track: expected a number > 0, found 0.0"),
        (skid_steer, {"wheelbase": np.inf}, "skid_steer: wheelbase: expected a finite number"),
        (rocky7, {"steered": "all"}, "steered: expected 'front' or 'corners', found str 'all"),
        (rocky7, {"r1": 0.1}, "r2: expected a number >= 0, found -0.035"),
        (seven_wheels, {"stiffness": 0.0}, "stiffness: expected a number > 0, found 0.0"),
    ],
)
def test_what_is_no_vehicle_is_refused(make, options, words):
    refuses(sf.ModelError, words, make, **options)
