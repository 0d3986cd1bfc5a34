"""Tests of the catalogue's rovers: textbook motion, published end points, poor starts, noise."""

from __future__ import annotations

import re
from functools import cache

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.cases import DATA, closure_model, hills
from slipfree import (
    Analytic,
    Bicubic,
    Grid,
    ModelError,
    SolverOptions,
    quasi_statics,
    settle,
    simulate,
    straight,
)
from slipfree.catalog import (
    ackermann,
    articulated,
    differential_drive,
    open_source_rover,
    rocky7,
    seven_wheels,
    skid_steer,
)
from slipfree.control.path_following import follow
from slipfree.geometry.path import Path
from slipfree.models.inverse import inverse_kinematics
from slipfree.models.wheel_authority import wheel_rates
from slipfree.plan.plan import plan
from slipfree.records import leaves, pack
from slipfree.solve import initial_conditions
from slipfree.terrain.rolled import rolled
from slipfree.vehicle.inertia import body_inertia

LIGHT = {"mass": 0.0, "wheel_mass": 0.0}  # no forces: the motion alone
FLAT, HILLS = Analytic(lambda x, _: 0 * x), Analytic(hills)
CATALOG = {
    "differential_drive": differential_drive(**LIGHT),
    "ackermann": ackermann(**LIGHT),
    "skid_steer": skid_steer(**LIGHT),
    "articulated": articulated(**LIGHT),
    "rocky7": rocky7(**LIGHT),
    "open_source_rover": open_source_rover(**LIGHT),
}
RADIUS = 0.15  # of the wheels of the first three


@cache
def rover_ground():
    """The rover-scale grid of wmrde (its notice is beside the file)."""
    values = np.array((DATA / "gridsurfdata.txt").read_text().strip(" \n,").split(","), float)
    (x0, x1, nx), (y0, y1, ny) = values[:3], values[3:6]
    z = values[6:].reshape(int(ny), int(nx)).T
    return Grid(np.linspace(x0, x1, int(nx)), np.linspace(y0, y1, int(ny)), np.array(z, order="C"))


def rates_at(vehicle, ground, rates, **start):
    """Rates of a vehicle at a start, by name."""
    dae = closure_model(vehicle, ground)
    given = {label.full: 0.0 for label in leaves(dae.labels.u)} | rates
    run = simulate(dae, settle(dae, **start), dae.inputs(**given), np.array([0.0, 1e-6]))
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
@pytest.mark.parametrize(
    ("vehicle", "within"),
    [
        (rocky7(steered="corners", **LIGHT), 1e-6),  # its axles are level to 0.03 mm
        (open_source_rover(**LIGHT), 1e-12),
    ],
    ids=["rocky7", "open_source_rover"],
)
def test_rovers_turn_about_their_middle_axle_without_slip(vehicle, within):
    turning, away = 0.2, 0.8  # the middle of the turn, to the left [rad/s], [m]
    dae = closure_model(vehicle, FLAT)
    rest = settle(dae)
    axle = rest["center_y"][0, [w.name.startswith("middle") for w in vehicle.wheels]][0]
    start, rates = {}, {}
    for k, wheel in enumerate(vehicle.wheels):
        right, ahead = rest["center_x"][0, k] + away, rest["center_y"][0, k] - axle
        angle = np.arctan2(ahead, right)
        if wheel.parent.startswith("steer"):
            start[wheel.parent] = angle
        rates[f"{wheel.name}_rate"] = turning * np.hypot(right, ahead) / wheel.radius
    found = rates_at(vehicle, FLAT, rates, **start)
    assert_allclose(found["heading_rate"], turning, atol=within)
    assert_allclose([found["slip_along"], found["slip_across"]], 0, atol=within)


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


@pytest.mark.parametrize("name", CATALOG)
def test_unknowns_are_as_many_as_the_formulas_say(name):
    vehicle = CATALOG[name]
    labels = closure_model(vehicle, FLAT).labels
    wheels, passive = len(vehicle.wheels), len(vehicle.of("passive"))
    free = sum(not wheel.driven for wheel in vehicle.wheels)
    assert len([*leaves(labels.x)]) == 3 + len(vehicle.of("commanded")) + passive
    assert len([*leaves(labels.z)]) == 5 * wheels + 3 + passive + free
    assert len(vehicle.of("suspension")) == wheels - 3


@pytest.mark.slow
@pytest.mark.parametrize("name", CATALOG)
def test_rates_of_what_the_ground_decides_are_the_derivative_of_the_closure(name):
    vehicle = CATALOG[name]
    dae = closure_model(vehicle, HILLS)
    given = {label.full: 0.2 for label in leaves(dae.labels.u)}
    start = settle(dae, x=0.7, heading=0.4)
    run = simulate(dae, start, dae.inputs(**given), np.linspace(0, 1, 5))
    symbols = [pack(dae.x), pack(dae.z)]
    position = pack(dae.z.position)
    follows = -ca.solve(ca.jacobian(dae.alg[0], position), ca.jacobian(dae.alg[0], symbols[0]))
    count = 3 + len(vehicle.of("suspension"))
    rates = dae.z.rates
    found = pack((rates.z, rates.roll, rates.pitch, rates.suspension))
    gap = ca.Function("gap", [*symbols, pack(dae.u)], [(follows @ dae.ode)[:count] - found])
    u = np.full(pack(dae.u).numel(), 0.2)
    for k in range(run.t.size):
        states = dae.rows("x", run, k), dae.rows("z", run, k)
        assert np.abs(np.array(gap(*states, u))).max() < 1e-12


ENDS = {  # radius of the tubes, steering: x, y, z after 10 s, found with another code
    (0.0, 0.0): (6.052913, -0.342339, 0.175481),
    (0.0, 0.1): (5.761722, 1.333289, 0.268086),
    (0.02, 0.1): (5.752414, 1.337478, 0.266629),
}


def rocky_case(ground, r1=0.02, steer=0.0):
    """Rocky 7 on a ground: the model, its start and its inputs."""
    vehicle = rocky7(r1=r1, **LIGHT)
    dae = closure_model(vehicle, Bicubic(ground))
    steering = {f"steer_front_{side}": steer for side in ("right", "left")}
    rates = {f"{wheel.name}_rate": 0.5 / 0.065 for wheel in vehicle.wheels}
    inputs = dae.inputs(**rates, **{f"{name}_rate": 0.0 for name in steering})
    return dae, settle(dae, x=1.1, y=0.0, heading=-np.pi / 2, **steering), inputs


def rocky_run(ground, r1=0.02, steer=0.0, tolerance=1e-8, duration=10.0):
    case = rocky_case(ground, r1, steer)
    return simulate(
        *case, np.linspace(0, duration, 101), options=SolverOptions(tolerance=tolerance)
    )


@pytest.mark.slow
@pytest.mark.parametrize("case", ENDS)
def test_rocky_7_ends_where_another_code_has_it(case):
    run = rocky_run(rover_ground(), *case)
    assert_allclose([run[name][-1] for name in "xyz"], ENDS[case], atol=1e-5)
    assert run["closure_residual"].max() < 1e-12
    below = run["center_z"] - Bicubic(rover_ground()).elevation(run["center_x"], run["center_y"])
    assert below.min() > 0


def test_at_a_loose_tolerance_it_is_near():
    run = rocky_run(rover_ground(), 0.0, 0.0, tolerance=1e-4)
    assert np.linalg.norm(np.subtract([run[n][-1] for n in "xy"], ENDS[0.0, 0.0][:2])) < 3e-4
    assert run["closure_residual"].max() < 1e-5


def test_rocky_7_has_the_inertia_that_another_code_assumes():
    """A box of 0.40 x 0.26 x 0.16 m (wmrde): 11/12 (0.26^2 + 0.16^2) kg m^2 about the long axis."""
    found = body_inertia(rocky7(mass=11.0), "platform")
    assert_allclose(np.diag(found), [0.170133, 0.085433, 0.208633], atol=1e-6)
    assert rocky7(mass=0.0).body.inertia is None


@pytest.mark.slow
def test_rocky_7_settles_from_poor_guesses(monkeypatch):
    """60 guesses off by up to 0.2 m and 0.4 rad: the one pose, wheels above the ground."""
    rng, vehicle = np.random.default_rng(7), rocky7(**LIGHT)
    dae = closure_model(vehicle, Bicubic(rover_ground()))
    place = {"x": 2.0, "y": 0.2, "heading": -np.pi / 2}
    right = settle(dae, **place)
    names = ("z", "roll", "pitch", *(c.name for c in vehicle.of("suspension")))
    solved, steps = initial_conditions._newton_step, []

    def counted(*args, check):
        steps[-1] += not check
        return solved(*args, check=check)

    monkeypatch.setattr(initial_conditions, "_newton_step", counted)
    for _ in range(60):
        sizes = np.array([0.2] + [0.4] * 5)
        off = rng.uniform(-sizes, sizes)
        steps.append(0)
        guess = {name: float(right[name][0]) + d for name, d in zip(names, off, strict=True)}
        found = settle(dae, guess=guess, **place)
        assert_allclose(
            [found[name][0] for name in names], [right[name][0] for name in names], atol=1e-9
        )
    assert np.median(steps) <= 10 + 1  # and one for the rates


@pytest.mark.slow
def test_noise_that_no_wheel_follows_is_named_and_rolled_away():
    grid = rover_ground()
    noise = np.random.default_rng(5).normal(0, 0.005, grid.z.shape)
    rough = Grid(grid.x, grid.y, grid.z + noise)
    words = r"more concave than the wheel|touches a second time"
    try:
        stop = rocky_run(rough).stop
        assert stop is not None
        found = stop.words
    except ModelError as error:
        found = str(error)
    assert re.search(words, found)
    assert any(
        f"{end}_{side}" in found
        for end in ("front", "middle", "rear")
        for side in ("right", "left")
    )
    part = Grid(rough.x[20:80], rough.y[20:80], np.ascontiguousarray(rough.z[20:80, 20:80]))
    run = rocky_run(rolled(part, 0.065).grid, tolerance=1e-4, duration=2.0)  # 10 s: benchmarks
    assert run.stop is None


def test_a_caster_without_trail_is_named():
    vehicle = differential_drive(trail=0.0, **LIGHT)
    dae = closure_model(vehicle, FLAT)
    with pytest.raises(ModelError, match=r"no equation determines caster_angle_rate"):
        settle(dae)


# Seven cases on hills: inputs, start


HILL_CASES = {
    "cart straight": ("differential_drive", {"right_rate": 1.0, "left_rate": 0.95}, {}),
    "cart on the spot": ("differential_drive", {"right_rate": 0.7, "left_rate": -0.7}, {}),
    "cart backwards": (
        "differential_drive",
        {"right_rate": -1.0, "left_rate": -0.97},
        {"caster_angle": 0.05},
    ),
    "car, fitting rates": (
        "ackermann",
        {"rear_right_rate": 1.053, "rear_left_rate": 0.947},
        {"steer": 0.1},
    ),
    "car, equal rates": (
        "ackermann",
        {"rear_right_rate": 1.0, "rear_left_rate": 1.0},
        {"steer": 0.3},
    ),
    "skid straight": ("skid_steer", dict.fromkeys(("right", "left"), 1.0), {}),
    "skid turning": ("skid_steer", {"right": 1.0, "left": 0.7}, {}),
}


def hill_run(case, tolerance, duration=20.0):
    name, rates, start = HILL_CASES[case]
    dae = closure_model(CATALOG[name], HILLS)
    if name == "skid_steer":
        rates = {f"{end}_{side}_rate": rates[side] for end in ("front", "rear") for side in rates}
    given = {label.full: 0.0 for label in leaves(dae.labels.u)} | rates
    begin = settle(dae, heading=0.3, **start)
    return simulate(
        dae,
        begin,
        dae.inputs(**given),
        np.linspace(0, duration, 101),
        options=SolverOptions(tolerance=tolerance),
    )


@pytest.mark.slow
@pytest.mark.parametrize("case", HILL_CASES)
def test_hill_cases_at_a_tolerance_of_a_micrometre(case):
    run, exact = hill_run(case, 1e-6), hill_run(case, 1e-10)
    assert run.stop is None
    gaps = [
        np.hypot(run["x"] - exact["x"], run["y"] - exact["y"]).max(),
        np.abs(run["z"] - exact["z"]).max(),
    ]
    assert max(gaps) < 2e-5
    assert (run["center_z"] - HILLS.elevation(run["center_x"], run["center_y"])).min() > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["ackermann", "articulated", "rocky7", "open_source_rover", "skid_steer"]
)
def test_rovers_follow_paths(name):
    vehicle = CATALOG[name]
    way = Path(np.array([(0.0, 0.0), (0.5, 2.0), (2.0, 4.0), (2.0, 7.0)]))
    dae = closure_model(vehicle, HILLS)
    start = settle(dae, heading=-0.245)
    run = simulate(
        dae,
        start,
        follow(dae, vehicle, way, speed=0.2),
        np.linspace(0, 36, 73),
        options=SolverOptions(tolerance=1e-6),
    )
    assert run.stop is None
    places = np.stack([run["x"], run["y"]], 1)
    dense = way.at(np.linspace(0, way.length, 2000))
    line = np.stack([dense.x, dense.y], 1)
    gaps = np.linalg.norm(places[:, None] - line[None], axis=2).min(axis=1)
    assert gaps.max() < 0.15  # it starts with straight wheels at the beginning of a bend
    assert gaps[-1] < 0.05
    assert np.linalg.norm(places[-1] - places[0]) > 5


# With masses: forces, friction and plans, for all without special code


MAKERS = (
    differential_drive,
    ackermann,
    skid_steer,
    articulated,
    rocky7,
    open_source_rover,
    seven_wheels,
)
GENTLE = Analytic(lambda x, y: 0.2 * (hills(x, y) - 2), mu=0.7)


def ahead(dae, vehicle, start):
    if vehicle.name == "seven_wheels":
        rates = {
            f"{wheel.name}_rate": 0.0 if "across" in wheel.name else 2.0 for wheel in vehicle.wheels
        }
        return dae.inputs(**rates)
    return straight(dae, vehicle, start, speed=0.2)


@pytest.mark.slow
@pytest.mark.parametrize("make", MAKERS, ids=lambda make: make.__name__)
def test_every_vehicle_stands_drives_and_creeps(make):
    vehicle = make()
    level = settle(closure_model(vehicle, Analytic(lambda x, _: 0 * x, mu=0.7)))
    assert level["force_normal"].min() > 0.05 * vehicle.weight / len(vehicle.wheels)
    assert level["force_normal"].sum() == pytest.approx(vehicle.weight, rel=1e-9)
    runs = []
    for dae in (closure_model(vehicle, GENTLE), quasi_statics(vehicle, GENTLE)):
        start = settle(dae, x=0.3, heading=0.2)
        runs.append(
            simulate(
                dae,
                start,
                ahead(dae, vehicle, start),
                np.linspace(0, 5, 6),
                options=SolverOptions(tolerance=1e-6),
            )
        )
        assert runs[-1].stop is None
        assert runs[-1]["force_normal"].min() > 0
        assert runs[-1]["utilisation"].max() < 1
    places = [np.array([run["x"][-1], run["y"][-1]]) for run in runs]
    assert np.linalg.norm(places[0] - [0.3, 0]) > 0.6
    assert np.linalg.norm(places[0] - places[1]) < 5e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    "make", [differential_drive, articulated, rocky7], ids=lambda make: make.__name__
)
def test_every_vehicle_is_planned_for(make):
    vehicle = make(mass=0.0, wheel_mass=0.0)
    dae = closure_model(vehicle, HILLS)
    start = settle(dae, heading=0.2)
    guess = simulate(
        dae,
        start,
        ahead(dae, vehicle, start),
        np.linspace(0, 5, 6),
        options=SolverOptions(tolerance=1e-6),
    )
    goal = {"x": float(guess["x"][-1]) + 0.05, "y": float(guess["y"][-1])}
    found = plan(
        dae,
        start,
        guess,
        goal=goal,
        costs={"slip": 100.0, "effort": 1e-3},
        duration=5.0,
        intervals=4,
        degree=2,
        smooth=1e-3,
        accuracy=1e-2,
    )
    assert found.success
    assert found.accurate
    assert max(found.difference[name] for name in ("x", "y")) < 1e-2
    assert (
        found.run["center_z"] > HILLS.elevation(found.run["center_x"], found.run["center_y"])
    ).all()


# Seven wheels on rollers


@pytest.mark.slow
def test_seven_wheels_go_anywhere_on_level_ground(rng):
    vehicle = seven_wheels()
    dae = closure_model(vehicle, Analytic(lambda x, _: 0 * x, mu=0.5))
    rest = settle(dae)
    v_ahead, v_right, turning = rng.uniform(-0.2, 0.2, 3)
    rates = {}
    for k, wheel in enumerate(vehicle.wheels):
        x, y = rest["center_x"][0, k], rest["center_y"][0, k]
        velocity = np.array([v_right - turning * y, v_ahead + turning * x])
        forward = {"rear_across": (1, 0), "front_across": (-1, 0)}.get(wheel.name, (0, 1))
        rates[f"{wheel.name}_rate"] = velocity @ forward / wheel.radius
    found = rates_at(vehicle, Analytic(lambda x, _: 0 * x, mu=0.5), rates)
    assert_allclose(heading_frame(found, 0.0), (v_ahead, v_right), atol=1e-12)
    assert_allclose(found["heading_rate"], turning, atol=1e-12)
    assert_allclose(found["slip_along"], 0, atol=1e-12)
    across = [w.name.endswith("across") for w in vehicle.wheels]
    assert_allclose(rest["force_normal"][0, across], 20.0, rtol=1e-9)
    assert rest["force_normal"].sum() == pytest.approx(21.6 * 9.81, rel=1e-9)


@pytest.mark.slow
def test_seven_wheels_on_ground_that_varies_ahead_alone_are_as_in_the_plane():
    """All wheels of an axle find one height: springs between pairs hardly move, nothing rolls."""
    ground = Analytic(lambda _, y: 0.02 * ca.sin(3 * y), mu=0.9)
    vehicle = seven_wheels()
    dae = closure_model(vehicle, ground)
    rates = {
        f"{wheel.name}_rate": 0.0 if "across" in wheel.name else 2.0 for wheel in vehicle.wheels
    }
    run = simulate(
        dae,
        settle(dae),
        dae.inputs(**rates),
        np.linspace(0, 5, 26),
        options=SolverOptions(tolerance=1e-6),
    )
    assert run.stop is None
    assert np.abs(run["pitch_joint"]).max() > 0.02
    assert_allclose([run["roll"], run["roll_joint"]], 0, atol=1e-12)
    assert max(np.abs(run["press_rear"]).max(), np.abs(run["press_front"]).max()) < 1e-4


@pytest.mark.slow
def test_seven_wheels_follow_and_are_given_three_rates():
    vehicle = seven_wheels()
    dae = closure_model(vehicle, FLAT)
    start = settle(dae)
    law = straight(dae, vehicle, start, speed=0.2)
    run = simulate(dae, start, law, np.linspace(0, 5, 6), options=SolverOptions(tolerance=1e-6))
    assert_allclose([run["x"][-1], run["y"][-1]], [0, 1], atol=1e-3)
    with pytest.raises(ModelError, match="'seven_wheels': expected the given rate 'right'"):
        inverse_kinematics(vehicle, FLAT, given=("forward", "yaw_rate"))
    given = {"forward": 0.1, "yaw_rate": 0.2, "right": 0.05}
    rates = wheel_rates(vehicle, dae, start, **given)
    found = rates_at(vehicle, FLAT, {f"{name}": rate for name, rate in rates.items()})
    assert_allclose(heading_frame(found, 0.0), (0.1, 0.05), atol=1e-12)
    assert_allclose(found["heading_rate"], 0.2, atol=1e-12)


def test_seven_rigid_wheels_are_too_many():
    with pytest.raises(ModelError, match="seven rigid contacts are too many for five degrees"):
        seven_wheels(stiffness=0.0)


@pytest.mark.parametrize(
    ("build", "words"),
    [
        (
            lambda: differential_drive(half_track=0.0),
            "differential_drive: half_track: expected a finite p",
        ),
        (
            lambda: ackermann(wheelbase=-1.0),
            "ackermann: wheelbase: expected a finite positive length",
        ),
        (
            lambda: skid_steer(wheelbase=np.inf),
            "skid_steer: wheelbase: expected a finite positive length",
        ),
        (lambda: articulated(rear=0.0), "articulated: rear: expected a finite positive length"),
        (
            lambda: rocky7(steered="all"),
            "rocky7: steered: expected 'front' or 'corners', found 'all",
        ),
        (lambda: rocky7(r1=0.1), "r2: expected a finite radius of zero or more"),
    ],
)
def test_what_is_no_vehicle_is_refused(build, words):
    with pytest.raises(ModelError, match=words):
        build()
