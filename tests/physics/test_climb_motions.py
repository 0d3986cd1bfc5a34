"""Tests of the step climber: reference speeds, averages, and motions on a ramp and a step.

Motions are compared with the results of a separate study. It used a prototype with its own
equations and also fixed the tolerances. True slip and the slip (20) of the paper are means over the
three axles, in percent.
"""

from dataclasses import replace
from functools import partial

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers import climb_stepping as stepping
from helpers.climb_cases import (
    AMPLE,
    CLIMBER,
    EXACT,
    EXACT_95,
    FIXED,
    PRINTED_6_8,
    PRINTED_14,
    PRINTED_16,
    RAMP,
    SENSED,
    SPEED,
    STEP,
    TABLE_I,
    TWICE,
    Grip,
    begin,
    climb,
    gripped,
)
from helpers.commands import refuses
from slipfree import SolverOptions
from slipfree.catalog import AXLES, step_climber
from slipfree.climb.metrics import climb_metrics, disturbance_ratio, slip_ratio
from slipfree.control.step_climbing import (
    PerAxle,
    StepClimbing,
    Tilts,
    check_period,
    directions,
    estimated_directions,
    held_torques,
    largest_period,
    limited,
    ratios,
    reference,
)
from slipfree.core.errors import ModelError
from slipfree.core.records import Label, pack
from slipfree.core.trajectory import Column, Trajectory
from slipfree.solve.settle import settle
from slipfree.solve.simulate import simulate
from slipfree.terrain.solids import flat, kerb, stairs

ALPHA, TH_A, TH_B = np.radians([45, 12, 7])
TILTS = Tilts(TH_B, TH_A + TH_B)


def numbers(record):
    return np.array([float(ca.DM(each)) for each in record])


def closure(climber, tilts, directions):
    """The closure of both bodies in v_R, v_M, v_F and the tilt rates: one motion is left."""
    behind, middle, ahead = (wheel.at[1] for wheel in climber.wheels)
    link, d = middle - behind, -middle
    along = [np.array([np.cos(a), np.sin(a)]) for a in directions]
    rear, front = (np.array([-np.sin(a), np.cos(a)]) for a in tilts)
    rows = np.zeros((4, 5))
    rows[:2, 0], rows[:2, 1], rows[:2, 3] = -along[0], along[1], -link * rear
    rows[2:, 1], rows[2:, 2] = -along[1], along[2]
    rows[2:, 3], rows[2:, 4] = -d * rear, -ahead * front
    return np.linalg.svd(rows)[2][-1]


def test_the_law_is_the_one_motion_without_slip():
    rng, worst = np.random.default_rng(0), 0.0
    vehicles = [step_climber(joint=joint) for joint in (0.0, 0.06, 0.126)]
    for _ in range(2000):
        climber = vehicles[rng.integers(3)]
        tilts = Tilts(*rng.uniform(-0.6, 0.6, 2))
        directions = PerAxle(*rng.uniform(-0.3, np.pi / 2, 3))
        speeds = numbers(ratios(climber, tilts, directions))
        null = closure(climber, tilts, directions)[:3]
        speeds, null = speeds / np.linalg.norm(speeds), null / np.linalg.norm(null)
        worst = max(worst, np.abs(speeds - np.sign(speeds @ null) * null).max())
    assert worst < 1e-12


@pytest.mark.parametrize(
    ("directions", "expected"),
    [
        ((0, 0, 1), (1, 1 / 0.95058)),
        ((0, 1, 0), (0.79392, 0.95058)),
        ((0, 1, 1), None),
        ((1, 0, 0), (1.25957, 1)),
    ],
)
def test_phases_of_a_climb(directions, expected):
    """Figures of the lab for alpha = 45, th_a = 12, th_b = 7 degrees; (6) and (8) are one each."""
    speeds = numbers(ratios(CLIMBER, TILTS, PerAxle(*(ALPHA * d for d in directions))))
    speeds = speeds[[0, 2]] / speeds[1]
    six = np.cos(ALPHA - TH_B) / np.cos(TH_B)
    eight = np.cos(TH_A + TH_B) / np.cos(ALPHA - TH_A - TH_B)
    if expected is not None:
        assert_allclose(speeds, expected, atol=1e-4)
    if directions[1]:
        assert_allclose(speeds[0], six, rtol=1e-12)
    if directions == (0, 0, 1):
        assert_allclose(speeds[1], eight, rtol=1e-12)
        assert abs(speeds[0] - six) > 0.2
    # The middle axle is on the slope in (6) and on the floor in (8): never both.
    assert not np.allclose(speeds, [six, eight], atol=0.05)


def test_at_a_wall_the_front_axle_goes_alone():
    climber, level = CLIMBER, Tilts(0.0, 0.0)
    wall = PerAxle(0.0, 0.0, np.pi / 2)
    speeds = numbers(reference(climber, level, wall, cap=1.5))
    assert_allclose(speeds, [0, 0, 1.5], atol=1e-12)
    tilted = numbers(reference(climber, Tilts(0.0, 0.4), wall, cap=1.5))
    assert_allclose(tilted[2], 1.5)
    assert_allclose(tilted[1], 1.5 * np.tan(0.4))
    assert_allclose(numbers(reference(climber, TILTS, wall, law="fixed")), 1)
    flat = numbers(reference(climber, level, PerAxle(0.0, 0.0, 0.0)))
    assert_allclose(flat, 1)


# As printed


def printed(law, cap=10.0):
    directions = PerAxle(0.0, 0.0, ALPHA)
    return numbers(reference(CLIMBER, TILTS, directions, law=law, cap=cap))


def test_printed_references():
    """(16) slows the wheel that climbs where (6) and (8) say the contrary."""
    assert_allclose(printed("printed_6_8"), [0.7939, 1, 1.0520], atol=1e-4)
    assert_allclose(printed("printed_16"), [1 / 0.79392, 1, 0.95058], atol=1e-4)
    rear = np.cos(ALPHA - TH_B) / np.cos(TH_B) / 5
    front = np.cos(TH_A + TH_B) / np.cos(ALPHA - TH_A - TH_B) / 5
    forward = np.array([rear, 0, -rear, 1 / 5, front, 0, -front])  # row of (14) with k = r = 1
    inverse = np.linalg.pinv(forward[None])
    assert_allclose(printed("printed_14"), inverse[[0, 3, 4], 0], rtol=1e-12)
    wall = PerAxle(0.0, 0.0, np.pi / 2)
    for law in ("printed_6_8", "printed_14", "printed_16"):
        assert np.isfinite(numbers(reference(CLIMBER, Tilts(0.0, 0.0), wall, law=law))).all()


# Directions that the sensors see


@pytest.mark.parametrize("directions", [(0, 0, 0), (0, 0, 0.8), (0, 0.6, 0), (0.7, 0, 0)])
def test_sensors_see_the_direction_of_the_axle_that_climbs(directions):
    for joint in (0.0, 0.06):
        climber = step_climber(joint=joint)
        tilts = Tilts(0.1, 0.25)
        motion = closure(climber, tilts, directions)
        motion *= 0.25 / motion[1]
        spins = PerAxle(*(motion[:3] / RADIUS))
        seen = numbers(estimated_directions(climber, tilts, Tilts(*motion[3:]), spins))
        assert_allclose(seen, directions, atol=1e-12)


def test_sensors_see_no_more_than_they_can():
    climber = CLIMBER
    fast = estimated_directions(climber, Tilts(0, 0), Tilts(0, 5.0), PerAxle(1, 1, 1))
    assert_allclose(numbers(fast), [0, 0, np.arcsin(0.985)])
    at_rest = estimated_directions(climber, Tilts(0, 0), Tilts(0, 0), PerAxle(0, 0, 0))
    assert_allclose(numbers(at_rest), 0)


# Torques


def test_torques_are_scaled_together():
    wanted = PerAxle(4.0, 1.0, -6.0)
    for limit, scale in ((np.inf, 1.0), (7.0, 1.0), (3.0, 0.5)):  # the largest is negative
        torques, factor = limited(limit, wanted)
        assert_allclose(float(ca.DM(factor)), scale)
        assert_allclose(numbers(torques), scale * np.array(wanted))


def test_largest_period_of_a_sampled_controller():
    assert_allclose(largest_period(StepClimbing(), CLIMBER), 2.5e-3)
    assert_allclose(largest_period(StepClimbing(motors=(1, 1, 1)), CLIMBER), 2.5e-3)
    assert_allclose(largest_period(StepClimbing(proportional=32.0), CLIMBER), 2.5e-3 / 8)
    assert_allclose(largest_period(StepClimbing(integral=4000.0), CLIMBER), 2e-3)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"law": "best"}, "law: expected 'projective' or .*, found str 'best'"),
        ({"directions": "eyes"}, "directions: expected 'contact' or 'sensors', found str 'eyes'"),
        ({"cap": 0.9}, "cap: expected a number >= 1, found 0.9"),
        ({"share": np.inf}, "share: expected a finite number, found inf"),
        ({"motors": (2, 0, 2)}, "expected one motor or more per axle as 'motors', found"),
    ],
)
def test_unusable_controls_are_refused(values, words):
    refuses(ModelError, words, StepClimbing, **values)


# Averages over a climb, with samples computed by hand

N, RADIUS = 101, 0.066  # a sample every 10 ms
PER_AXLE = {
    "spin": (4.0, 5.0, 0.2),
    "reference": (5.0, 4.0, 4.0),
    "drive_torque": (2.0, -2.0, 6.0),
    "solid_load_0": (30.0, 0.0, 10.0),
    "solid_load_1": (0.0, 0.5, 60.0),
    "solid_slip_0": (-0.033, 1.0, 1.0),
    "solid_slip_1": (1.0, 1.0, 0.00132),
}


def motion(**changes):
    """Constants, but that the front wheel touches at 0.3 s and the rear axle is up at 0.6 s."""
    t = np.arange(N) * 0.01
    columns = {name: np.tile(values, (N, 1)) for name, values in PER_AXLE.items()}
    columns["solid_gap_1"] = np.where(t < 0.295, 0.01, -0.01)[:, None] * [0, 0, 1.0]
    columns["center_y"] = np.where(t < 0.595, 0.0, 0.03)[:, None] * [1.0, 1, 1]
    columns["center_z"] = np.full((N, 3), 0.09 + RADIUS - 0.002)
    # The middle axle is 0.1 m behind the joint, whose velocity is (0.15, 0.1) m/s.
    columns["y"], columns["z"] = columns["center_y"][:, 1] + 0.1, columns["center_z"][:, 1]
    constants = {"velocity_y": 0.15, "velocity_z": 0.1, "omega_x": -1.0, "fold_rate": 9.0}
    columns |= {name: np.full(N, value) for name, value in constants.items()}
    columns["torque_scale"] = np.where(t < 0.395, 1.0, 0.5)
    columns |= changes
    return Trajectory(t, {k: Column(Label(k, "1", k), v) for k, v in columns.items()}, wheels=AXLES)


def averaged(run):
    return climb_metrics(run, step_climber(), STEP)


def test_averages_of_samples():
    found = averaged(motion())
    assert (found.window.span, found.window.climbed) == (slice(25, 70), True)
    assert_allclose(found.window.t, 0.6)
    speed = 0.25
    # The front wheel is too slow for ratios.
    assert_allclose(
        found.slip, [1 - speed / (4 * RADIUS), 1 - speed / (5 * RADIUS), np.nan], atol=1e-12
    )
    assert_allclose(found.disturbance, [1 / 4, 1 / 5, np.nan])
    # On the solid that bears more; nothing where none bears a newton.
    assert_allclose(found.true_slip, [0.033 / (4 * RADIUS), 0, 0.00132 / (0.2 * RADIUS)])
    assert_allclose(found.effort, np.array([2, 2, 6]) / 10)
    assert_allclose(found.bearing, np.array([30, 0.5, 70]) / 100.5)
    assert_allclose(found.limited, 30 / 45)


def test_ratios_are_signed_but_averages_count_at_most_one():
    run = motion(spin=np.tile((-4.0, 0.5, 0.5), (N, 1)))
    ratios = slip_ratio(run, step_climber())
    assert_allclose(ratios[0], 1 - 0.25 / (RADIUS * np.array([-4, 0.5, 0.5])))
    assert_allclose(disturbance_ratio(run)[0], [-9 / 4, 7, 7])
    assert_allclose(averaged(run).slip, 1)
    assert_allclose(averaged(run).disturbance, 1)


def test_what_does_not_come_up_is_averaged_to_its_end():
    found = averaged(motion(center_y=np.zeros((N, 3))))
    assert (found.window.span, found.window.climbed) == (slice(25, N), False)
    assert_allclose(found.window.t, 1.0)


def test_what_does_not_touch_is_refused():
    with pytest.raises(ModelError, match=r"touches only the floor until t = 1 s"):
        averaged(motion(solid_gap_1=np.ones((N, 3))))


# Motions

HELD = [f"{axle}_torque" for axle in AXLES]


def average(name, *case, **options):
    return 100 * getattr(climb(*case, **options).metrics, name).mean()


slip, true, disturbance = (partial(average, name) for name in ("slip", "true_slip", "disturbance"))


def climbed(*case, **options):
    return climb(*case, **options).metrics.window.climbed


def ratio(measure, profile, control, contact, **options):
    return measure(profile, control, contact, **options) / measure(
        profile, FIXED, contact, **options
    )


def placed_at(start, **values):
    """Return a start with other values of some quantities."""
    columns = {k: start.columns[k]._replace(values=np.atleast_1d(v)) for k, v in values.items()}
    return replace(start, columns=start.columns | columns)


# Statics, energy and accuracy


def test_dropped_on_the_floor_it_comes_to_rest_under_its_weight():
    _, dae = gripped(step_climber(), flat(), FIXED, TABLE_I)
    rest = settle(dae, y=0.0)
    start = placed_at(rest, z=rest["z"] + 1e-3, fold=rest["fold"] + 0.003)
    run = simulate(dae, start, dae.inputs(reference_speed=0.0), np.linspace(0, 1.5, 11))
    assert_allclose(run["force_normal"][-1, ::-1], [67.07, 93.83, 51.00], rtol=2e-3)
    assert_allclose(rest["force_normal"][0, ::-1], [67.07, 93.83, 51.00], rtol=2e-3)
    names = ("velocity_y", "velocity_z", "omega_x", "fold_rate")
    assert max(abs(run[name][-1]) for name in names) < 1e-6


def test_standing_is_equilibrium_with_the_joint_anywhere():
    for joint in (0.0, 0.06):
        _, dae = gripped(step_climber(joint=joint), flat(), FIXED, TABLE_I)
        start = settle(dae, y=0.3)
        run = simulate(dae, start, dae.inputs(reference_speed=0.0), np.linspace(0, 0.2, 11))
        assert_allclose(run["force_normal"], np.tile(start["force_normal"], (11, 1)), rtol=1e-6)
        assert_allclose(run["y"], 0.3, atol=1e-9)


def test_the_motion_converges_with_the_tolerance():
    rough, fine = (climb(RAMP, EXACT, TABLE_I, tolerance=each) for each in (1e-6, 1e-10))
    for name in ("y", "z", "pitch", "fold"):
        assert_allclose(rough.run[name], fine.run[name], atol=1e-5)
    assert abs(rough.metrics.slip.mean() - fine.metrics.slip.mean()) < 2e-4
    assert rough.run.statistics["steps"] < 6000


def test_both_integrators_agree():
    dae, start = begin(step_climber(), STEP, EXACT, TWICE)
    given = dae, start, dae.inputs(reference_speed=SPEED), np.linspace(0, 0.4, 41)
    runs = [
        simulate(*given, options=SolverOptions(tolerance=1e-8, method=method))
        for method in (None, "idas")
    ]
    for name in ("y", "z", "fold", "spin"):
        assert_allclose(runs[0][name], runs[1][name], atol=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize(("profile", "contact"), [(RAMP, TABLE_I), (STEP, TWICE)])
def test_stiff_contacts_give_the_motion_of_rigid_ones(profile, contact, exact):
    """Rigid time stepping with its own equations, at 0.2 ms."""
    control = StepClimbing("projective" if exact else "fixed", "contact", share=0.9, cap=2.0)
    stiff = contact._replace(stiffness=1e7, damping=50.0, creep=2e-4)
    angle = np.arctan2(*profile.summit[::-1])
    case = stepping.Case(angle, contact.static, contact.dynamic, exact)
    rigid, up = stepping.climb(case, 2e-4)
    assert up
    assert_allclose(slip(profile, control, stiff, torque=np.inf), 100 * rigid.mean(), rtol=0.05)


@pytest.mark.slow
def test_sensitivities_agree_with_differences():
    """Through the first impact, to speed and to the friction at speed."""
    x, final = sensitive_start()
    outcome, slope = (
        ca.Function("outcome", [x], [each]) for each in (final, ca.jacobian(final, x))
    )
    at, size = np.array([SPEED, 0.675]), 1e-4
    slopes = np.array(slope(at))
    for k, unit in enumerate(np.eye(2)):
        difference = np.array(outcome(at + size * unit) - outcome(at - size * unit)).ravel()
        difference /= 2 * size
        assert_allclose(slopes[:, k], difference, rtol=1e-3, atol=1e-5 * np.abs(difference).max())
        assert np.abs(difference).max() > 1e-3


def sensitive_start():
    """Speed and dynamic friction, and the configuration after the front wheel's impact."""
    low, high = (TWICE._replace(dynamic=mu) for mu in (0.6, 0.7))
    dae, start = begin(step_climber(), STEP, EXACT, low)
    _, other = gripped(step_climber(), STEP, EXACT, high)
    more = ca.substitute(other.ode, ca.vertcat(*other.columns()), ca.vertcat(*dae.columns()))
    given = ca.SX.sym("given", 2)  # forces, and so the rates, are linear in the friction
    ode = dae.ode + (given[1] - 0.6) / 0.1 * (more - dae.ode)
    ode = ca.substitute(ode, pack(dae.u), given[0])
    system = {"x": pack(dae.x), "p": given, "ode": ode}
    options = {"reltol": 1e-9, "abstol": 1e-11, "max_num_steps": 100000}
    march = ca.integrator("march", "cvodes", system, 0.0, 0.4, options)
    p = ca.MX.sym("p", 2)
    return p, march(x0=dae.rows("x", start, -1), p=p)["xf"][:4]


# Tables II and III: the ramp with the friction of Table I, the step with more friction


@pytest.mark.parametrize(
    ("measure", "profile", "control", "value", "within"),
    [
        (slip, RAMP, FIXED, 7.1, 0.4),
        (true, RAMP, FIXED, 6.8, 0.4),
        (slip, RAMP, EXACT, 4.1, 0.3),
        (slip, STEP, FIXED, 13.8, 0.7),
    ],
)
def test_averages_over_a_climb(measure, profile, control, value, within):
    contact = TABLE_I if profile is RAMP else TWICE
    assert_allclose(measure(profile, control, contact), value, atol=within)


@pytest.mark.parametrize(
    ("measure", "profile", "control", "low", "high", "torque"),
    [
        (slip, RAMP, EXACT, 0.54, 0.62, AMPLE),
        (true, RAMP, EXACT, 0.37, 0.46, AMPLE),
        (slip, RAMP, SENSED, 0.60, 0.70, AMPLE),
        (true, RAMP, SENSED, 0.48, 0.58, AMPLE),
        (slip, RAMP, PRINTED_16, 1.7, np.inf, AMPLE),
        (slip, RAMP, PRINTED_6_8, 1.4, np.inf, AMPLE),
        (slip, RAMP, PRINTED_14, 1.4, np.inf, AMPLE),
        # fixed references make the wheels fight through the ground; saturated, all slow down
        (disturbance, RAMP, SENSED, 0.0, 0.55, 2.0),
        (disturbance, STEP, SENSED, 0.0, 0.75, 4.5),
        pytest.param(true, STEP, SENSED, 0.58, 0.70, AMPLE, marks=pytest.mark.slow),
        pytest.param(true, STEP, EXACT, 0.50, 0.62, AMPLE, marks=pytest.mark.slow),
        pytest.param(true, STEP, EXACT_95, 0.0, 0.40, AMPLE, marks=pytest.mark.slow),
    ],
)
def test_averages_relative_to_fixed_references(measure, profile, control, low, high, torque):
    contact = TABLE_I if profile is RAMP else TWICE
    assert low < ratio(measure, profile, control, contact, torque=torque) < high
    assert profile is RAMP or climbed(profile, control, contact, torque=torque)


def test_sensors_see_the_direction_of_the_ramp():
    run = climb(RAMP, SENSED, TABLE_I).run
    contact = (run["solid_load_1", "front"] > 0) & (run["solid_load_0", "front"] == 0)
    contact &= run["center_z", "front"] < 0.09 + 0.066 * np.cos(np.pi / 4)  # on the face
    seen = run["direction_seen", "front"][contact]
    assert np.degrees(np.median(seen)) == pytest.approx(45, abs=6)


def test_weak_motors_are_limited():
    fixed, sensed = (climb(RAMP, each, TABLE_I, torque=2.0) for each in (FIXED, SENSED))
    assert fixed.metrics.limited > 5 * sensed.metrics.limited > 0
    assert np.abs(fixed.run["motor_torque"]).max() < 2 + 1e-12


@pytest.mark.slow
@pytest.mark.parametrize(
    ("control", "contact"),
    [
        *((each, TWICE) for each in (PRINTED_6_8, PRINTED_14, PRINTED_16)),
        *((each, TABLE_I) for each in (FIXED, EXACT, EXACT_95, SENSED, PRINTED_16)),
    ],
)
def test_what_does_not_climb_the_step(control, contact):
    """Laws as printed; with the friction of the paper, none."""
    assert not climbed(STEP, control, contact, until=4.0, tolerance=1e-5)


@pytest.mark.parametrize(
    ("profile", "most", "floor", "within"), [(RAMP, 0.3, 3.9, 0.2), (STEP, 1.5, 9.2, 0.5)]
)
def test_the_slip_of_the_paper_is_not_zero_without_slip(profile, most, floor, within):
    """(20) relates all wheels to the middle axle."""
    control = replace(EXACT, proportional=32.0)
    contact = Grip(1.0, 1.0) if profile is RAMP else Grip(2.0, 2.0)
    assert true(profile, control, contact, torque=np.inf) < most
    assert_allclose(slip(profile, control, contact, torque=np.inf), floor, atol=within)


# Sampled and other control


def sampled(period, control, start=None, until=3.4, torque=AMPLE):
    control = replace(control, torque=torque)
    dae, rolling = begin(step_climber(), RAMP, control, TABLE_I, sampled=True)
    held = held_torques(dae, control)
    t = np.arange(round(until / period) + 1) * period
    if start is not None:
        rolling = placed_at(rolling, **{name: 0 * rolling[name] for name in rolling} | start)
    inputs = dae.inputs(reference_speed=SPEED, **held)
    options = SolverOptions(tolerance=1e-6)
    return simulate(dae, rolling, inputs, t, options=options, sampled=True)


def test_too_slow_a_sampled_controller_is_refused_since_free_wheels_swing_up():
    words = r"between 0 and 0\.0025 s, the stability limit of the wheel rates .* found 0\.005 s"
    refuses(ModelError, words, check_period, 5e-3, FIXED, CLIMBER)
    in_the_air = {"y": -2.0, "z": 1.0}
    calm, wild = (sampled(period, FIXED, in_the_air, 0.12) for period in (2.3e-3, 2.7e-3))
    assert np.abs(calm["spin"][-1] - SPEED / 0.066).max() < 0.1
    swings = np.stack([wild[name] for name in HELD], axis=1)[-6:-1] / [2, 1, 2]
    assert_allclose(np.abs(swings), AMPLE)
    assert (np.sign(swings[1:]) == -np.sign(swings[:-1])).all()


def test_too_large_an_integral_makes_free_wheels_swing_up():
    """From T = 2 kp / ki = 2.22 ms on, where the proportional gain alone would allow 2.5 ms."""
    control = replace(FIXED, integral=3600.0)
    sizes = []
    for period in (2.1e-3, 2.35e-3):
        run = sampled(period, control, {"y": -2.0, "z": 1.0}, 0.2, np.inf)
        error = np.abs(run["spin", "rear"] - SPEED / 0.066)
        sizes.append((error[10:30].max(), error[-20:].max()))
    (early, late), (before, after) = sizes
    assert late < early / 2
    assert after > 2 * before
    with pytest.raises(ModelError, match=r"between 0 and 0\.00195122 s"):
        check_period(2e-3, replace(FIXED, integral=4100.0), CLIMBER)


def test_held_inputs_are_checked():
    dae, start = begin(step_climber(), RAMP, FIXED, TABLE_I, sampled=True)
    t, zeros = np.linspace(0, 0.01, 11), dict.fromkeys(HELD, 0.0)
    laws = zeros | {HELD[0]: dae.u[0].wheels[0]}
    with pytest.raises(ModelError, match="found one that contains inputs"):
        simulate(dae, start, dae.inputs(reference_speed=0.2, **laws), t, sampled=True)
    laws = zeros | {HELD[0]: ca.SX.sym("stranger")}
    with pytest.raises(ModelError, match="found the symbol 'stranger'"):
        simulate(dae, start, dae.inputs(reference_speed=0.2, **laws), t, sampled=True)


# Other grounds


def test_over_a_kerb_and_up_stairs():
    grip = Grip(1.2, 1.0)
    over = climb(kerb(0.05, 0.6), SENSED, grip, until=7.0).run
    assert over["center_y", "rear"][-1] > 0.7
    assert_allclose(over["center_z"][-1], 0.066, atol=1e-3)
    up = climb(stairs(0.03, 0.3, 2), SENSED, grip, until=5.0)
    assert up.metrics.window.climbed
    assert_allclose(up.run["center_z"][-1], 0.126, atol=1e-3)


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ((-0.3, 0.066), 0),  # on the floor
        ((-0.066, 0.066), 90),  # on the floor, at the wall
        ((0.3, 0.156), 0),  # on top
        ((-0.066 * np.sin(0.5), 0.09 + 0.066 * np.cos(0.5)), np.degrees(0.5)),  # over its edge
        ((0.6 + 0.066 * np.sin(0.5), 0.09 + 0.066 * np.cos(0.5)), -np.degrees(0.5)),
        ((0.666, 0.066), 0),  # down on the floor, touching what it came from
        ((0.3, 0.5), 0),  # in the air
    ],
)
def test_directions_over_a_kerb(place, expected):
    """Pressed in by 1 mm, at which nearness is 0.9998."""
    center = ca.SX.sym("center", 2)
    axles = directions(kerb(0.09, 0.6), 0.067, PerAxle(center, center, center))
    found = ca.Function("direction", [center], [axles.front])(place)
    assert np.degrees(float(found)) == pytest.approx(expected, abs=0.05)


def test_falling_over_is_named():
    _, dae = gripped(step_climber(), flat(), FIXED, TABLE_I)
    rest = settle(dae, y=0.0)
    start = placed_at(rest, z=0.4, pitch=0.3, fold=-0.3, omega_x=-9.0, fold_rate=18.0)
    t, options = np.linspace(0, 1, 101), SolverOptions(tolerance=1e-6)
    run = simulate(dae, start, dae.inputs(reference_speed=0.0), t, options=options)
    assert run.stop.name == "front_upright"
    assert "the front body overturns (tilt): 80.21" in run.stop.words
    assert run.stop.t < 0.3
