"""Tests of moving horizons along a plan, and of closed loops: they return to the plan."""

import itertools
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import slipfree as sf
from helpers.cases import BOUNDED_RATES, hills, straight_on
from helpers.commands import refuses
from slipfree.catalog import differential_drive, skid_steer, three_wheeler
from slipfree.plan import tracking
from slipfree.plan.ipopt import warm_solver
from slipfree.plan.mpc import cycle_inputs, first_cycle, horizon, refine, replan
from slipfree.plan.plan import plan
from slipfree.plan.tracking import Following, Replanning, Sampling, TrackingWorld, track_plan
from slipfree.plan.verification import simulate_plan
from slipfree.terrain.grid_ops import disturbed

pytestmark = pytest.mark.slow

GOAL, DURATION, COUNT = {"x": 0.2, "y": 0.9}, 8.0, 12
VEHICLE = three_wheeler(axle="fixed")
AXIS = np.arange(-3.0, 4.0, 0.25)
GRID = sf.Grid(AXIS, AXIS, sf.Analytic(hills).elevation(*np.meshgrid(AXIS, AXIS, indexing="ij")))


@pytest.fixture(scope="module")
def found():
    return plan(
        *straight_on(VEHICLE, sf.Bicubic(GRID), 0.4, np.linspace(0, DURATION, 30)),
        goal=GOAL,
        costs={"slip": 7e4, "effort": 0.01},
        smooth=0.002,
        duration=DURATION,
        inputs=BOUNDED_RATES,
        limits={"steer": (-1.0, 1.0)},
        mesh=sf.Mesh(COUNT),
    )


@pytest.fixture(scope="module")
def window(found):
    return horizon(found, span=DURATION / 2, intervals=COUNT // 2)


def track(window, world, start, *, latency=0.0, progress=None, **options):
    """Drive in another world by replanning."""
    place, controller = TrackingWorld(world, None, start, latency), Replanning(window, **options)
    return track_plan(controller, place, duration=DURATION, progress=progress)


def state_at_start(task):
    """Return the state at the start of a plan, in map coordinates."""
    return task.start + task.dae.shift[0]


def away(run):
    return float(np.hypot(run["x"][-1] - GOAL["x"], run["y"][-1] - GOAL["y"]))


def test_where_nothing_disturbs_a_step_stays_on_the_plan(found):
    window = horizon(found, span=DURATION, intervals=COUNT)
    first, count = first_cycle(window), found.motion.layout.duration
    start = state_at_start(found.program.task)
    cycle = replan(window, first, 0.0, start)
    for one in (first, cycle):
        assert_allclose(one.motion.unknowns[:count], found.motion.unknowns[:count], atol=1e-6)
        assert one.violation < 1e-9


def test_steps_converge(found):
    """From a start beside the plan, without moving: to what many iterations find at once."""
    window, many = (
        horizon(found, span=DURATION, intervals=COUNT, iterations=count) for count in (1, 50)
    )
    start = state_at_start(found.program.task) + np.array([0.02, -0.02, 0.03, 0.0])
    cycle, misses = first_cycle(window), []
    whole = replan(many, cycle, 0.0, start)
    for _ in range(8):
        cycle = replan(window, cycle, 0.0, start)
        misses.append(np.abs(cycle.motion.unknowns - whole.motion.unknowns).max())
    assert misses[-1] < 1e-4
    assert misses[1] < misses[0] / 3
    assert cycle.violation < 1e-6


@pytest.mark.parametrize("continuous", [False, True])
def test_steps_converge_to_the_solution_of_ipopt_where_limits_are_active(continuous):
    """With bounded accelerations, limits of unknowns and outputs, and an input at its bound."""
    found = plan(
        *straight_on(VEHICLE, sf.Bicubic(GRID), 0.4, np.linspace(0, DURATION, 30)),
        goal={"x": 0.1, "y": (0.7, 0.9)},
        costs={"slip": 7e4, "effort": 0.01},
        duration=DURATION,
        inputs=BOUNDED_RATES | {"steer_rate": (-0.05, 0.05)},
        accelerations={"right_rate": (-0.03, 0.03)},
        limits={"steer": (-1.0, 1.0), "pitch": (-0.6, 0.6), "velocity_y": (-0.05, 0.13)},
        mesh=sf.Mesh(6, continuous=continuous, accuracy=0.1),
    )
    window = horizon(found, span=DURATION, intervals=6, iterations=50)
    alone = replace(window, steps=0, careful=warm_solver(window.program, 500))
    start = state_at_start(found.program.task) + np.array([0.01, -0.005, 0.01, 0.0])
    cycle, other = (replan(each, first_cycle(each), 0.0, start) for each in (window, alone))
    assert cycle.violation < 1e-7
    assert_allclose(cycle.motion.unknowns, other.motion.unknowns, atol=2e-5)
    size = np.abs(other.multipliers).max()
    assert_allclose(cycle.multipliers, other.multipliers, atol=1e-4 * size)
    rates = cycle.motion.unknowns[cycle.motion.layout.inputs]
    assert np.abs(rates[:, 2]).max() > 0.04999
    changes = np.diff(rates[:, 0]) / (DURATION / 6)
    assert np.abs(changes).max() == pytest.approx(0.03, rel=1e-3)


def test_steps_lead_back_to_the_plan_and_end_at_its_goal(found, window):
    many, dae = replace(window, steps=50), found.program.task.dae
    start, period = sf.settle(dae, x=0.02, y=-0.02, heading=0.03), DURATION / COUNT
    end, converged = (track(each, dae, start, period=period).run for each in (window, many))
    assert away(end) < 1e-3
    assert away(converged) < 1e-3
    assert np.hypot(end["x"][-1] - converged["x"][-1], end["y"][-1] - converged["y"][-1]) < 1e-3
    cycle = first_cycle(window)  # what is left of the last cycle that decides is driven on
    assert replan(window, cycle, 0.9 * DURATION, state_at_start(found.program.task)) is cycle


def test_inputs_keep_to_their_bounds(found, window):
    start = state_at_start(found.program.task)
    start[1] -= 0.5  # metres behind
    cycle = first_cycle(window)
    for _ in range(8):
        cycle = replan(window, cycle, 0.0, start)
    rates = cycle.motion.unknowns[cycle.motion.layout.inputs]
    assert np.abs(rates).max() <= 2.0 + 1e-6


def test_a_period_that_does_not_divide_the_duration_ends_at_the_goal(found, window):
    """It becomes the nearest part of the duration, and late inputs do not last longer."""
    dae, times = found.program.task.dae, []
    tracked = track(window, dae, sf.settle(dae), period=0.7, progress=times.append)
    assert (tracked.cycles, tracked.failures) == (11, 0)
    assert_allclose(times, np.arange(11) * DURATION / 11)
    assert away(tracked.run) < 1e-4
    late = track(window, dae, sf.settle(dae), latency=0.7, period=0.7)
    assert [each.run.t[-1] for each in (tracked, late)] == pytest.approx([DURATION] * 2)
    assert (np.diff(tracked.run.t) > 0).all()


def test_on_a_wrong_ground_and_beside_the_start_replanning_ends_nearer(window):
    world = sf.direct_kinematics(VEHICLE, sf.Bicubic(disturbed(GRID, 0.02, 1.0, 1)))
    start = sf.settle(world, x=0.04, y=-0.03, heading=0.03)
    alone = simulate_plan(world, start, window.plan, step=0.2)
    tracked = track(window, world, start, period=0.4)
    assert away(tracked.run) < away(alone) / 5


def test_a_cycle_far_from_the_equations_is_repeated_with_a_line_search(window):
    idle = warm_solver(window.program, 0)  # stays at the guess
    first = first_cycle(window)
    far = state_at_start(window.program.task) + np.array([0.3, 0, 0, 0])
    with pytest.raises(sf.SolverError, match="the inputs of the previous cycle may still be used"):
        replan(replace(window, steps=0, careful=idle), first, 0.0, far)
    cycle = replan(replace(window, steps=0), first, 0.0, far)
    assert cycle.violation < 0.02
    assert_allclose(
        cycle.motion.states(np.array([0.0]))[:, 0] + window.program.task.dae.shift[0],
        far,
        atol=1e-12,
    )


def test_the_velocities_of_a_plan_with_a_cusp_are_followed_backwards_and_forwards():
    def states(at):  # backwards by 0.5 m along the y axis, then forwards along a circle of 1 m
        t = 10 * at
        angle = 0.25 * np.maximum(t - 2, 0.0)
        y = np.where(t < 2, -0.25 * t, np.sin(angle) - 0.5)
        return np.array([np.cos(angle) - 1, y, angle])

    dae, period = sf.direct_kinematics(skid_steer(), sf.Analytic(lambda x, _: 0 * x)), 0.1
    law = Following(dae, SimpleNamespace(duration=10.0, states=states), 0.25, period=period)
    x, y, heading = 0.03, 0.02, 0.1
    for k in range(100):
        t = period * k
        sent = law.step(np.array([x, y, heading]), t)
        v, turning = sent["forward"], sent["yaw_rate"]
        assert (v < 0) == (t < 1.95)
        assert abs(turning) < 0.6
        heading += turning * period / 2  # a unicycle, by the midpoint rule
        x, y = x - v * period * np.sin(heading), y + v * period * np.cos(heading)
        heading += turning * period / 2
    assert_allclose([x, y, heading], states(np.array([1.0]))[:, 0], rtol=0, atol=2e-3)


def test_the_time_of_the_controller_is_charged_to_the_loop(window, monkeypatch):
    """Every other decision takes two and a half periods; meanwhile the last inputs are held."""
    dae, period = window.program.task.dae, DURATION / COUNT
    clock = itertools.cycle([0.0, 0.0, 0.0, 2.5 * period])  # read before and after each decision
    monkeypatch.setattr(tracking, "time", SimpleNamespace(process_time=clock.__next__))
    tracked = track(window, dae, sf.settle(dae), period=period, updated=False)
    assert (tracked.cycles, tracked.missed) == (COUNT, COUNT // 2)
    shown = np.array([0, 1, 1, 1, 4, 5, 5, 5, 8, 9, 9, 9])  # times of the inputs, in periods
    rates = window.plan.inputs(shown / COUNT)[dae.input_names.index("right_rate")]
    starts = period * np.arange(COUNT)
    assert_allclose(np.interp(starts, tracked.run.t, tracked.run["right_rate"]), rates, atol=1e-6)


def test_steps_of_controllers_build_no_graphs(found, window, monkeypatch):
    """Steps return the inputs of the plan's model, or commands, and only evaluate functions."""
    dae, motion = found.program.task.dae, found.motion
    driven = sf.commanded(dae, speed=0.12)
    ranges = dict.fromkeys(driven.input_names, (-0.3, 0.3))
    task = sf.SamplingTask(driven, {"slip": 1.0}, {}, 2.0, ranges, candidates=16, compiled=False)
    alone, planned = (Replanning(window, period=0.2, updated=each) for each in (False, True))
    law = Following(dae, motion, 0.12, period=0.2)
    first, later = motion.states(np.array([0.0, 0.4]) / DURATION).T + dae.shift[0]
    controllers = alone, planned, law, Sampling(dae, task, motion, period=0.2)
    for each in controllers:
        each.prepare(first)
        each.step(first, 0.0)
    for name in ("Function", "nlpsol", "integrator", "substitute", "SX.sym", "MX.sym"):
        monkeypatch.setattr(f"casadi.{name}", None)
    inputs, *_ = [each.step(later, 0.4) for each in controllers]
    middle = motion.inputs(np.array([0.5]) / DURATION)[:, 0]  # linear in each interval of 2 / 3 s
    assert_allclose([inputs[name] for name in dae.input_names], middle, atol=1e-9)


def test_sampled_inputs_are_refined(found, window):
    """The motion ends at the same place, with less cost; an early end is named."""
    dae = found.program.task.dae
    start = sf.settle(dae, x=0.02)
    noise = 0.2 * np.random.default_rng(3).standard_normal((3, COUNT // 2))
    sampled = np.array([[0.4], [0.4], [0.0]]) + noise
    cycle = refine(window, start, sampled)

    def driven(inputs, times):
        run = sf.simulate(dae, start, inputs, times)
        slip = (run["slip_along"] ** 2 + run["slip_across"] ** 2).sum(axis=1)
        effort = sum(run[f"{name}_rate"] ** 2 for name in ("right", "left", "steer"))
        return run, np.trapezoid(7e4 * slip + 0.01 * effort, run.t)

    fine = np.linspace(0.0, DURATION / 2, 20 * (COUNT // 2) + 1)
    rows = dict(zip(dae.input_names, np.repeat(sampled, 20, axis=1), strict=True))
    before, paid = driven(dae.inputs(**rows), fine)
    after, less = driven(*cycle_inputs(window, cycle, 0.0, DURATION / 2))
    assert np.hypot(*(after[axis][-1] - before[axis][-1] for axis in "xy")) < 0.01
    assert less < 0.7 * paid
    with pytest.raises(sf.SolverError, match="refine: expected a motion over the window of 4 s"):
        refine(window, sf.settle(dae, y=2.4), np.full((3, 2), 2.0))


def test_a_limit_of_the_world_ends_the_motion(window):
    part = slice(7, 18)
    grid = sf.Grid(AXIS[part], AXIS[part], np.ascontiguousarray(GRID.z[part, part]))
    world = sf.direct_kinematics(VEHICLE, sf.Bicubic(grid))
    tracked = track(window, world, sf.settle(world), period=0.8)
    assert tracked.run.stop.name.startswith("map_margin")
    assert tracked.run.stop.t == pytest.approx(tracked.run.t[-1])
    assert tracked.run.t[-1] < DURATION


def test_what_is_no_window_period_world_or_state_is_refused(found, window):
    task, first = found.program.task, first_cycle(window)
    start = state_at_start(task)
    for given, words in (
        ({"span": 9.0}, "at most 8 s, the duration of the plan, found 9"),
        ({"span": 4.0, "intervals": 0}, "intervals: expected a number >= 1, found 0"),
        ({"span": 4.0, "iterations": -1}, "iterations: expected a number >= 1, found -1"),
    ):
        refuses(sf.ModelError, words, horizon, found, **given)
    # a window counts time from its own beginning
    cost = task.costs[0]._replace(expression=task.costs[0].expression * task.dae.t)
    late = replace(found.program, task=replace(task, costs=(cost,)))
    with pytest.raises(sf.ModelError, match="a goal that do not depend on time"):
        horizon(replace(found, program=late), span=4.0)
    words = "period: expected a period above 0 and at most 8 s, the duration"
    refuses(sf.ModelError, words, track, window, task.dae, sf.settle(task.dae), period=0.0)
    other = sf.direct_kinematics(differential_drive(), sf.Bicubic(GRID))
    with pytest.raises(sf.ModelError, match="world: expected the states and inputs of the plan's"):
        track(window, other, sf.settle(other), period=0.8)
    with pytest.raises(sf.ModelError, match=r"expected 'begin' from 0 to below 4 s"):
        cycle_inputs(window, first, 8.5, 9.0)
    states = start[:-1], start * np.nan, start[0]
    for given, words in (
        *(((first, 0.0, state), "expected (finite values|an array)") for state in states),
        ((first, np.nan, start), "t: expected a number, found float nan"),
        ((first._replace(t=1.0), 0.5, start), "expected a time t of at least 1 s"),
    ):
        refuses(sf.ModelError, words, replan, window, *given)
    assert replan(window, first, 0.0, start).violation < 1e-6
