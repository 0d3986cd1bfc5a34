"""Tests of the seven-wheeler on a ramp and a step against the results of a separate study.

The study used a prototype with its own equations and also fixed the tolerances. True slip and the
slip (20) of the paper are means over the three axles, in percent.
"""

from dataclasses import replace

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
from slipfree import SolverOptions
from slipfree.catalog import step_climber
from slipfree.catalog.step_climber import AXLES
from slipfree.climb.metrics import climb_window
from slipfree.control.reference_speeds import PerAxle, directions
from slipfree.control.step_climbing import StepClimbing, check_period, held_torques
from slipfree.core.errors import ModelError
from slipfree.core.records import pack
from slipfree.core.trajectory import Column
from slipfree.solve.settle import settle
from slipfree.solve.simulate import simulate
from slipfree.solve.zero_order_hold import simulate_sampled
from slipfree.terrain.solids import flat, kerb, stairs

HELD = [f"{axle}_torque" for axle in AXLES]


def slip(*case, **options):
    return 100 * climb(*case, **options).metrics.slip.mean()


def true(*case, **options):
    return 100 * climb(*case, **options).metrics.true_slip.mean()


def disturbance(*case, **options):
    return 100 * climb(*case, **options).metrics.disturbance.mean()


def climbed(*case, **options):
    return climb(*case, **options).metrics.window.climbed


def ratio(measure, profile, control, contact, **options):
    return measure(profile, control, contact, **options) / measure(
        profile, FIXED, contact, **options
    )


# Statics, energy and accuracy


def test_dropped_on_the_floor_it_comes_to_rest_under_its_weight():
    _, dae = gripped(step_climber(), flat(), FIXED, TABLE_I)
    rest = settle(dae, y=0.0)
    raised = {"z": rest["z"] + 1e-3, "fold": rest["fold"] + 0.003}
    start = replace(
        rest,
        columns={
            **rest.columns,
            **{k: Column(rest.columns[k].label, v) for k, v in raised.items()},
        },
    )
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


@pytest.mark.slow
def test_energy_balances():
    rough, fine = climb(RAMP, EXACT, TABLE_I), climb(RAMP, EXACT, TABLE_I, tolerance=1e-8)
    assert rough.imbalance < 2e-4
    assert fine.imbalance < 5e-6
    assert fine.run["lost_energy"][-1] > 1
    assert (np.diff(fine.run["lost_energy"]) > -1e-9).all()


def test_the_motion_converges_with_the_tolerance():
    rough, fine = (climb(RAMP, EXACT, TABLE_I, tolerance=each) for each in (1e-6, 1e-10))
    for name in ("y", "z", "pitch", "fold"):
        assert_allclose(rough.run[name], fine.run[name], atol=1e-5)
    assert abs(rough.metrics.slip.mean() - fine.metrics.slip.mean()) < 2e-4
    assert rough.run.statistics["steps"] < 6000


def test_both_integrators_agree():
    dae, start = begin(step_climber(), STEP, EXACT, TWICE)
    t = np.linspace(0, 0.4, 41)
    runs = [
        simulate(
            dae,
            start,
            dae.inputs(reference_speed=SPEED),
            t,
            options=SolverOptions(tolerance=1e-8, method=method),
        )
        for method in (None, "idas")
    ]
    for name in ("y", "z", "fold", "spin"):
        assert_allclose(runs[0][name], runs[1][name], atol=2e-5)


@pytest.mark.slow
def test_friction_that_creeps_less_and_stiffer_contacts_change_little():
    sharp = TABLE_I._replace(creep=1e-4)
    for control in (FIXED, EXACT):
        assert abs(slip(RAMP, control, TABLE_I) - slip(RAMP, control, sharp)) < 0.15
    for stiffness in (5e5, 2e6):
        contact = TABLE_I._replace(stiffness=stiffness, damping=20.0)
        assert 0.55 < ratio(slip, RAMP, EXACT, contact) < 0.60


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


# The ramp with the friction of Table I


def test_ramp_with_fixed_references():
    assert_allclose(slip(RAMP, FIXED, TABLE_I), 7.1, atol=0.4)
    assert_allclose(true(RAMP, FIXED, TABLE_I), 6.8, atol=0.4)


def test_ramp_with_known_directions():
    assert_allclose(slip(RAMP, EXACT, TABLE_I), 4.1, atol=0.3)
    assert 0.54 < ratio(slip, RAMP, EXACT, TABLE_I) < 0.62
    assert 0.37 < ratio(true, RAMP, EXACT, TABLE_I) < 0.46


def test_ramp_with_directions_that_sensors_see():
    assert 0.60 < ratio(slip, RAMP, SENSED, TABLE_I) < 0.70
    assert 0.48 < ratio(true, RAMP, SENSED, TABLE_I) < 0.58
    run = climb(RAMP, SENSED, TABLE_I).run
    contact = (run["solid_load_1", "front"] > 0) & (run["solid_load_0", "front"] == 0)
    contact &= run["center_z", "front"] < 0.09 + 0.066 * np.cos(np.pi / 4)  # on the face
    seen = run["direction_seen", "front"][contact]
    assert np.degrees(np.median(seen)) == pytest.approx(45, abs=6)


def test_ramp_with_laws_as_printed():
    assert ratio(slip, RAMP, PRINTED_16, TABLE_I) > 1.7
    assert ratio(slip, RAMP, PRINTED_6_8, TABLE_I) > 1.4
    assert ratio(slip, RAMP, PRINTED_14, TABLE_I) > 1.4


def test_ramp_with_weak_motors():
    """Fixed references make the wheels fight through the ground; saturated, all slow down."""
    assert ratio(disturbance, RAMP, SENSED, TABLE_I, torque=2.0) < 0.55
    fixed, sensed = (climb(RAMP, each, TABLE_I, torque=2.0) for each in (FIXED, SENSED))
    assert fixed.metrics.limited > 5 * sensed.metrics.limited > 0
    assert np.abs(fixed.run["motor_torque"]).max() < 2 + 1e-12


# The step, with more friction


def test_step_with_fixed_references():
    assert_allclose(slip(STEP, FIXED, TWICE), 13.8, atol=0.7)


@pytest.mark.slow
def test_step_with_known_and_seen_directions():
    assert 0.58 < ratio(true, STEP, SENSED, TWICE) < 0.70
    assert 0.50 < ratio(true, STEP, EXACT, TWICE) < 0.62
    assert ratio(true, STEP, EXACT_95, TWICE) < 0.40
    assert all(climbed(STEP, each, TWICE) for each in (FIXED, EXACT, EXACT_95, SENSED))


def test_step_with_weak_motors():
    assert ratio(disturbance, STEP, SENSED, TWICE, torque=4.5) < 0.75


@pytest.mark.slow
@pytest.mark.parametrize("control", [PRINTED_6_8, PRINTED_14, PRINTED_16])
def test_laws_as_printed_do_not_climb_the_step(control):
    assert not climbed(STEP, control, TWICE, until=4.0, tolerance=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("control", [FIXED, EXACT, EXACT_95, SENSED, PRINTED_16])
def test_the_friction_of_the_paper_climbs_no_step(control):
    assert not climbed(STEP, control, TABLE_I, until=4.0, tolerance=1e-5)


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
        columns = {name: Column(rolling.columns[name].label, 0 * rolling[name]) for name in rolling}
        columns |= {k: Column(columns[k].label, np.array([v])) for k, v in start.items()}
        rolling = replace(rolling, columns=columns)
    inputs = dae.inputs(reference_speed=SPEED, **held)
    return simulate_sampled(dae, rolling, inputs, t, options=SolverOptions(tolerance=1e-6))


@pytest.mark.slow
def test_a_sampled_controller_does_as_the_continuous_one():
    continuous, run = climb(RAMP, SENSED, TABLE_I), sampled(2e-3, SENSED)
    assert run.stop is None
    assert_allclose(run["y"], continuous.run["y"][: run.t.size], atol=2e-3)
    held = np.stack([run[name] for name in HELD], axis=1)
    assert_allclose(held, run["motor_torque"] * [2, 1, 2], atol=1e-12)
    assert climb_window(run, continuous.vehicle, RAMP).climbed


def test_too_slow_a_sampled_controller_is_refused_since_free_wheels_swing_up():
    words = r"between 0 and 0\.0025 s, the stability limit of the wheel rates .* found 0\.005 s"
    with pytest.raises(ModelError, match=words):
        check_period(5e-3, FIXED, CLIMBER)
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
    with pytest.raises(ModelError, match="evenly spaced"):
        simulate_sampled(dae, start, dae.inputs(reference_speed=0.2, **zeros), t**2)
    laws = zeros | {HELD[0]: dae.u.model.wheels[0]}
    with pytest.raises(ModelError, match="contains an input given by an expression"):
        simulate_sampled(dae, start, dae.inputs(reference_speed=0.2, **laws), t)
    laws = zeros | {HELD[0]: ca.SX.sym("stranger")}
    with pytest.raises(ModelError, match="the unknown symbol stranger"):
        simulate_sampled(dae, start, dae.inputs(reference_speed=0.2, **laws), t)


def test_derivative_and_unwinding_are_those_of_their_equations():
    control = replace(FIXED, derivative=0.02, lag=0.01, unwinding=20.0)
    run = climb(STEP, control, TWICE, torque=3.0, until=1.0).run
    error = run["reference"] - run["spin"]
    wanted = 4 * error + 40 * run["error_sum"] + 2 * (error - run["error_lag"])
    scale = 3 / np.maximum(3, np.abs(wanted).max(axis=1))
    assert_allclose(run["motor_torque"], scale[:, None] * wanted, rtol=1e-9, atol=1e-12)
    assert scale.min() < 0.9
    for name, rate in (
        ("error_lag", (error - run["error_lag"]) / 0.01),
        ("error_sum", error - 0.5 * (wanted - run["motor_torque"])),
    ):
        whole = np.cumsum((rate[1:] + rate[:-1]) / 2 * 2e-3, axis=0)
        assert_allclose(run[name][1:] - run[name][0], whole, atol=0.03 * np.ptp(run[name]))
    plain = climb(STEP, FIXED, TWICE, torque=3.0, until=1.0).run
    assert np.abs(run["error_sum"]).max() < 0.8 * np.abs(plain["error_sum"]).max()


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
    values = {"z": 0.4, "pitch": 0.3, "fold": -0.3, "omega_x": -9.0, "fold_rate": 18.0}
    columns = {k: Column(rest.columns[k].label, np.array([v])) for k, v in values.items()}
    start = replace(rest, columns={**rest.columns, **columns})
    t, options = np.linspace(0, 1, 101), SolverOptions(tolerance=1e-6)
    run = simulate(dae, start, dae.inputs(reference_speed=0.0), t, options=options)
    assert run.stop.name == "front_upright"
    assert "the front body overturns (tilt): 1.4" in run.stop.words
    assert run.stop.t < 0.3


def test_what_touches_only_the_floor_has_no_climb():
    with pytest.raises(ModelError, match="touches only the floor"):
        _ = climb(RAMP, FIXED, TABLE_I, until=0.1).metrics
