"""Tests of tracked climb plans on the 90 mm step, and of sensor noise."""

from dataclasses import replace
from functools import cache

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.climb_cases import (
    AMPLE,
    CLIMBER,
    FIXED,
    MOTORS,
    RAMP,
    SENSED,
    SPEED,
    STEP,
    TABLE_I,
    Grip,
    climb,
    planned,
    tracking,
)
from slipfree.climb.contact_path import legs
from slipfree.climb.metrics import axle_speeds
from slipfree.climb.time_scaling import Tracking, history, in_sequence, tracked_plan
from slipfree.climb.time_scaling import climb as program
from slipfree.control.reference_speeds import Noise, PerAxle, Tilts, measured
from slipfree.core.errors import ModelError
from slipfree.core.trajectory import SolverError
from slipfree.models.samples import obstacle_ending
from slipfree.plan.external_nlp import solve_nlp
from slipfree.terrain.solids import placed

UNTIL = 13.0


@cache
def plans():
    """Programs and solutions of the legs over the step, for a friction of 0.7."""
    ways = legs(CLIMBER, STEP)
    programs = [
        program(
            CLIMBER,
            STEP,
            leg,
            "slip",
            mu=0.7,
            speed=SPEED,
            torques=AMPLE * np.array(MOTORS),
            halt=leg is not ways[-1],
        )
        for leg in ways
    ]
    return [(plan, solve_nlp(plan.nlp).unknowns) for plan in programs]


def driven(control, mu, part=0.75, **options):
    return climb(STEP, control, Grip(mu, part * mu), **options)


def ending(control, mu, **options):
    motion = driven(control, mu, **options)
    return obstacle_ending(motion.run, motion.vehicle, placed(motion.profile)).name


def progress(run):
    return (run["center_y"] + run["center_z"]).mean(axis=1)


# The plan over the progress


def test_a_course_is_the_plan_over_the_progress():
    track, told = tracked_plan(plans()), in_sequence([history(*each) for each in plans()])
    heights, places = (
        np.stack(
            [
                told[name] + axle.ahead * turn(told[f"tilt_{body}"])
                for axle, body in zip(CLIMBER.axles, ("rear", "rear", "front"), strict=True)
            ]
        )
        for name, turn in (("z", np.sin), ("y", np.cos))
    )
    p = (heights + places).mean(axis=0)
    assert (np.diff(track.p) > 0).all()
    for k in range(3):
        assert_allclose(np.interp(p, track.p, track.torques[:, k]), told["torque"][:, k], atol=1e-9)
        rates = np.interp(p, track.p, track.speeds[:, k]) * told["path_speed"] / CLIMBER.radius
        assert_allclose(rates, told["wheel_rate"][:, k], atol=1e-9)
    # As the slope of the way says: the axles' velocities, by differences of their places.
    slopes = np.gradient(heights, axis=1), np.gradient(places, axis=1)
    angles = np.arctan2(*slopes)
    inside = np.ones(p.size, dtype=bool)
    inside[[0, 58, 59, 117, 118, -1]] = False
    found = np.stack([np.interp(p, track.p, each) for each in track.directions.T])
    assert_allclose(found[:, inside], angles[:, inside], atol=0.03)
    assert_allclose(track.square[[0, -2, -1]] > 0, [False, True, True])


def test_legs_rest_where_they_meet():
    track = tracked_plan(plans())
    ends = np.cumsum([2 * plan.nodes.s.size - 1 for plan, _ in plans()])[:-1]
    assert_allclose(track.square[[*ends, *(ends - 1)]], 0, atol=1e-9)
    assert_allclose(track.p[ends] - track.p[ends - 1], 0, atol=1e-4)
    assert (np.abs(track.torques[ends] - track.torques[ends - 1]).max(axis=1) > 0.5).all()


def test_what_leads_down_is_refused():
    plan, unknowns = plans()[2]
    backwards = replace(plan, nodes=plan.nodes._replace(q=plan.nodes.q[::-1]))
    with pytest.raises(ModelError, match=r"mean of x . z.*decrease at -?0\.\d+ m"):
        tracked_plan([(backwards, unknowns)])


def test_unusable_trackings_are_refused():
    track = tracked_plan(plans())
    for name in ("proportional", "spare", "lead"):
        with pytest.raises(ModelError, match=f"Tracking: '{name}': expected a number > 0, found 0"):
            Tracking(track, **{name: 0.0})


# Driven


@pytest.mark.slow
def test_a_tracked_plan_climbs_with_less_friction_than_references():
    """Least friction of both, to 0.005: 0.715 and 0.785."""
    assert ending(tracking(STEP, 0.725), 0.725, until=UNTIL) == "climbs"
    with pytest.raises(SolverError, match="no solution"):
        tracking(STEP, 0.70)  # 0.678 is the least of a plan
    assert ending(Tracking(tracked_plan(plans())), 0.68, until=UNTIL) == "stalls"
    for control in (FIXED, SENSED):
        assert ending(control, 0.76, until=6.0) != "climbs"


@pytest.mark.slow
def test_a_plan_of_least_friction_need_not_know_the_friction():
    control = Tracking(planned(STEP))
    assert ending(control, 0.74, until=UNTIL) == "climbs"
    assert ending(control, 1.0, until=7.0) == "climbs"


def test_motion_and_torques_are_those_planned():
    control = Tracking(tracked_plan(plans()))
    motion = driven(control, 1.0, part=1.0, until=UNTIL)
    run, track = motion.run, control.plan
    p = progress(run) + control.lead
    on = (p > track.p[0]) & (p < track.p[-1])
    speed = np.sqrt(np.interp(p, track.p, track.square))
    moving = on & (speed > 0.05)
    for k, axle in enumerate(("rear", "middle", "front")):
        going = axle_speeds(run, motion.vehicle)[:, k]
        aim = speed * np.interp(p, track.p, track.speeds[:, k])
        assert np.sqrt(np.mean((going - aim)[moving] ** 2)) < 0.02
        torque = np.interp(p, track.p, track.torques[:, k]) / MOTORS[k]
        back = control.proportional * (run["reference", axle] - run["spin", axle])
        assert_allclose(run["motor_torque", axle][on], (torque + back)[on], atol=0.02)
    assert motion.metrics.true_slip.max() < 0.02
    slip = CLIMBER.radius * run["reference"] - axle_speeds(run, motion.vehicle)
    assert np.quantile(slip[on], 0.99) < 1.5 * control.spare


def test_it_is_driven_at_the_speed_before_and_behind_the_plan():
    run = driven(Tracking(tracked_plan(plans())), 0.9, until=UNTIL).run
    assert_allclose(run["velocity_y"][-1], SPEED, atol=2e-3)
    at_wall = np.argmax(run["solid_gap_1", "front"] < 0)
    assert run["velocity_y"][at_wall] < 0.08


# Noise


def test_noise_is_of_its_size_and_band_and_seed():
    t = np.linspace(0, 20, 8001)
    noise = Noise(tilt=1e-3, tilt_rate=0.02, wheel_rate=0.3, band=10.0, seed=4)
    at = ca.SX.sym("t")
    zero = Tilts(0.0, 0.0), Tilts(0.0, 0.0), PerAxle(0.0, 0.0, 0.0)

    def series(noise):
        parts = measured(noise, at, *zero)
        column = ca.vertcat(*(each for record in parts for each in record))
        return np.array(ca.Function("noise", [at], [column])(t[None]))

    found = series(noise)
    sizes = [1e-3] * 2 + [0.02] * 2 + [0.3] * 3
    assert_allclose(np.sqrt((found**2).mean(axis=1)), sizes, rtol=0.05)
    assert np.abs(np.corrcoef(found) - np.eye(7)).max() < 0.2
    strength = np.abs(np.fft.rfft(found * np.hanning(t.size))) ** 2
    above = np.fft.rfftfreq(t.size, t[1]) > 10.2
    assert strength[:, above].sum() < 1e-4 * strength.sum()
    assert_allclose(series(noise), found)
    assert np.abs(series(replace(noise, seed=5)) - found).max() > 0.1
    with pytest.raises(ModelError, match="Noise: 'band': expected a number > 0, found 0"):
        Noise(band=0.0)


@pytest.mark.slow
def test_noise_of_the_wheels_sensors_makes_them_slip():
    plain, slight, strong = (
        climb(RAMP, replace(SENSED, noise=noise), TABLE_I)
        for noise in (None, Noise(tilt_rate=1e-6), Noise(tilt_rate=0.1, wheel_rate=0.3))
    )
    assert_allclose(slight.run["y"], plain.run["y"], atol=1e-5)
    assert strong.metrics.window.climbed
    slips = [each.metrics.true_slip.mean() for each in (plain, strong)]
    assert slips[1] > 1.3 * slips[0]
