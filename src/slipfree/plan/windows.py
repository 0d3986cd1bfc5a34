"""Plan long motions along a route in consecutive windows.

Each window begins at a hand-over, a simulated state of the preceding plan, and extends beyond the
next hand-over by an overlap, which the next window plans again. A program therefore never has more
unknowns than one window. The parts before the hand-overs join to one motion, which is simulated
without a jump of states or continuous inputs.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.dae import Dae, Limit
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Label, with_overview
from slipfree.core.schema import Positive
from slipfree.core.trajectory import PLAN, Outcome, Stop, Trajectory, joined
from slipfree.geometry.path import Path
from slipfree.plan.ipopt import seconds_left
from slipfree.plan.plan import Plan, SimulatedPlan, solve_task
from slipfree.plan.polynomial_motion import (
    PolynomialMotion,
    SavedPlan,
    first_intervals,
    joined_motions,
    local_motion,
    save_motion,
    transfer_motion,
)
from slipfree.plan.search import PlanProgress, Search, SolvedStage, cost_terms
from slipfree.plan.transcription import Mesh, PlanTask, TimedCondition, transcribe
from slipfree.plan.verification import GUESS_TOLERANCE, largest, simulate_plan
from slipfree.solve.simulate import simulate_to_failure
from slipfree.solve.system import SolverOptions
from slipfree.system.forks import computing

WINDOW_POINTS = 400  # points of the route in a guess
POINTS_PER_METRE = 4  # points per metre of the route among which the nearest one is searched
ASIDE = 0.25  # largest distance from the route at the end of a window, relative to overlap
OTHER_LENGTHS = (0.5, -0.5)  # changes of the length of an unsolved window, in overlaps
MIN_REST = 1e-6  # shortest part of a route that is planned [m]
TIME_TOLERANCE = 1e-9  # largest difference of times that count as equal [s]
GOAL_SUFFIX = " at the goal"  # of the violations of conditions at the end of a plan


@with_overview
class RouteWindow(NamedTuple):
    """One window of a long plan."""

    begin: float  # arc lengths of the route between which the window was planned [m]
    end: float
    t: float  # time at which the window begins [s]
    duration: float  # duration of the part before the hand-over [s]
    iterations: int  # of all its programs, including those without solution
    seconds: float  # wall time of these programs [s]
    accurate: bool  # whether differences and violations of its simulation are within the accuracy


@dataclass(frozen=True, eq=False, repr=False)
class LongPlan(SimulatedPlan):
    """Plan of a long motion, composed of the parts of windows before their hand-overs.

    The states at a hand-over jump by the difference between plan and simulation. The simulated
    motion extends to the goal or to an unsolved window. Differences and violations are the largest
    of all windows, costs their totals. The solved programs include windows of other lengths, and
    the search may continue from ``saved``.
    """

    windows: tuple[RouteWindow, ...]
    compiled: bool  # whether the functions of the programs are compiled

    def __repr__(self) -> str:
        end = self.windows[-1].end if self.windows else 0.0
        extent = f"in {len(self.windows)} windows, up to {end:.6g} m of the route"
        return self.described(extent, {})


class _Part(NamedTuple):
    """Part of a window before its hand-over, or an earlier plan."""

    window: RouteWindow
    motion: PolynomialMotion
    replay: Trajectory
    stages: tuple[SolvedStage, ...] = ()
    planned: Plan | None = None  # of the whole window; None for an earlier plan
    violation: Mapping[str, float] = {}  # before the hand-over, as for `Plan`


class _HandOver(NamedTuple):
    """State in which a window begins."""

    run: Trajectory  # trajectory whose last sample is the state
    inputs: Array | None  # shape (n_u, 2): at this state, as of `PlanTask`; None if they may jump
    reached: float  # arc length of the nearest point of the route [m]


@checked
@computing
def plan_windows(
    task: PlanTask,
    law: Callable[[Path], Any],
    start: Trajectory,
    route: Path,
    *,
    speed: Positive,
    length: float,
    overlap: float,
    mesh: Mesh = Mesh(),
    options: SolverOptions = SolverOptions(),
    resume: SavedPlan | None = None,
    progress: PlanProgress | None = None,
    keep: Callable[[LongPlan], None] | None = None,
    seconds: float = math.inf,
) -> LongPlan:
    """Return the plan of a task along a long route, planned in windows that overlap.

    Each window but the last ends on a line across the route, at most a quarter of the overlap to
    its left or right. Between these lines the motion may leave the route. ``law`` returns inputs
    that move the vehicle along a path, for guesses; ``length`` and ``overlap`` are along the route
    [m]; ``resume`` is an earlier result that ended before the goal; ``keep`` is called with the
    plan before each window; ``seconds`` is the time limit of all windows. The task has neither
    way-points nor limits of costs; its duration is not used.

    If a window has no solution, the plan ends before it, and the stop of ``replay`` names it.
    """
    if not 0 < overlap < length:
        raise ModelError(
            "expected a positive overlap shorter than the window, found an overlap "
            f"of {overlap:g} m and a window of {length:g} m; adjust one of them"
        )
    deadline = time.monotonic() + seconds
    here, parts, stop, dae = _HandOver(start, None, 0.0), list[_Part](), None, task.dae

    def attempt(here: _HandOver, end: float) -> Plan:
        """Return the plan of a window from a hand-over to an arc length in m."""
        of = f"{here.reached:.0f} to {end:.0f} m of {route.length:.0f} m"

        def keep_first(planned: Plan) -> None:
            if keep is not None and not parts:
                part = _first_part(planned, (0.0, end), 0.0, 0.0, planned.stages)
                keep(_join([part], None, _stop_of(planned, here, end), dae, options))

        # The guess leads along the route, and towards it.
        s = np.linspace(here.reached, end, WINDOW_POINTS)
        at = route.at(s)
        points = np.column_stack([at.x, at.y])
        away = np.array([float(here.run[name][-1]) for name in "xy"]) - points[0]
        left = np.clip(1 - (s - here.reached) / min(overlap, end - here.reached), 0, 1)
        path = Path(points + away * (left**2 * (3 - 2 * left))[:, None])
        duration = (end - here.reached) / speed
        t = np.linspace(0, duration, max(int(np.ceil(duration / mesh.step)), 1) + 1)
        rough = SolverOptions(tolerance=GUESS_TOLERANCE)
        guess = simulate_to_failure(dae, here.run, law(path), t, rough)
        gate = TimedCondition(1.0, _gate(dae, guess, ASIDE * overlap))
        window = replace(
            task,
            start=dae.rows("x", here.run, -1),
            duration=(float(guess.t[-1]),) * 2,
            initial_inputs=here.inputs,
            conditions=(gate,) if end < route.length else task.conditions,
        )
        return solve_task(
            window,
            here.run,
            [guess],
            mesh=mesh,
            search=Search(
                progress=progress and (lambda words, iterate: progress(f"{of}: {words}", iterate)),
                keep=keep_first,
                seconds=seconds_left(deadline),
            ),
            options=options,
        )

    if resume is not None:
        motion = local_motion(resume, dae)
        replay = simulate_plan(dae, start, motion, step=mesh.step, options=options)
        if replay.stop is not None:
            raise ModelError(
                "plan: expected a saved plan that can be simulated to its end, found one that "
                f"stops at {replay.t[-1]:.6g} s: {replay.stop.words}; plan without the saved plan"
            )
        reached = _nearest(route, replay, 0.0, route.length)
        former = RouteWindow(0.0, reached, 0.0, motion.duration, 0, 0.0, True)
        parts.append(_Part(former, motion, replay))
        here = _HandOver(replay, _end_inputs(task, motion), reached)
    while stop is None and here.reached < route.length - MIN_REST:
        if keep is not None and parts:
            words = f"the plan from {here.reached:.4g} m of the route was interrupted"
            keep(_join(parts, None, Stop(PLAN, 0.0, words, Outcome.INTERRUPTED), dae, options))
        stages: tuple[SolvedStage, ...] = ()
        # a window without solution may have one if it ends elsewhere, apart from an obstacle
        for change in (0.0, *OTHER_LENGTHS):
            end = here.reached + length + change * overlap
            end = route.length if route.length - end < overlap else end
            planned = attempt(here, end)
            stages += planned.stages
            if planned.success or planned.run.outcome in (Outcome.INTERRUPTED, Outcome.TIME_LIMIT):
                break
        stop = _stop_of(planned, here, end)
        if planned.success or not parts:
            t = sum(part.window.duration for part in parts)
            rest = 0.0 if end == route.length or stop else overlap / speed
            part = _first_part(planned, (here.reached, end), t, rest, stages)
            parts.append(part)
            reached = _nearest(route, part.replay, here.reached, end) if rest else end
            here = _HandOver(part.replay, _end_inputs(task, part.motion), reached)
    return _join(parts, task, stop, dae, options)


def _gate(dae: Dae, guess: Trajectory, half: float) -> tuple[Limit, Limit]:
    """Return the conditions at a window's end: the position is on a line across the guess."""
    x, y, heading = (float(guess[name][-1]) for name in ("x", "y", "heading"))
    right, forward = dae.x.x - (x - dae.shift[0][0]), dae.x.y - (y - dae.shift[0][1])
    ahead = forward * np.cos(heading) - right * np.sin(heading)
    aside = right * np.cos(heading) + forward * np.sin(heading)
    return (
        Limit(Label("ahead", "m", "distance beyond the end of the window"), ahead, 0.0, 0.0),
        Limit(Label("aside", "m", "distance to the right of the route"), aside, -half, half),
    )


def _nearest(route: Path, run: Trajectory, low: float, high: float) -> float:
    """Return the arc length, in a range, of the route nearest to a motion's end [m]."""
    s = np.linspace(low, high, int((high - low) * POINTS_PER_METRE) + 2)
    at = route.at(s)
    return float(s[np.hypot(at.x - run["x"][-1], at.y - run["y"][-1]).argmin()])


def _stop_of(planned: Plan, here: _HandOver, end: float) -> Stop | None:
    """Return the stop of a window that is not solved or whose simulation stops; otherwise None."""
    stop = planned.replay.stop if planned.success else planned.run.stop
    if stop is None:
        return None
    words = f"the plan from {here.reached:.4g} to {end:.4g} m of the route: {stop.words}"
    return stop._replace(words=words)


def _first_part(
    planned: Plan, span: tuple[float, float], t: float, rest: float, stages: tuple[SolvedStage, ...]
) -> _Part:
    """Return the part of a window before its hand-over, which leaves at least ``rest`` seconds."""
    motion, run = planned.motion, planned.replay
    times = motion.ends
    count = max(int(np.searchsorted(times, times[-1] - rest + TIME_TOLERANCE)) - 1, 1)
    last = min(int(np.searchsorted(run.t, times[count] - TIME_TOLERANCE)), run.t.size - 1)
    own = run.part(slice(last + 1))
    violation = {
        name: size
        for name, size in planned.violation.items()
        if not (rest and name.endswith(GOAL_SUFFIX))
    }
    iterations = sum(stage.iterations for stage in stages)
    seconds = sum(stage.seconds["total"] for stage in stages)
    return _Part(
        RouteWindow(*span, t, float(own.t[-1]), iterations, seconds, planned.accurate),
        first_intervals(motion, count),
        own,
        stages,
        planned,
        violation,
    )


def _end_inputs(task: PlanTask, motion: PolynomialMotion) -> Array | None:
    """Return the inputs at the end of a motion as equal bounds; None if inputs may jump."""
    if not motion.continuous:
        return None
    values = np.clip(motion.inputs(np.ones(1)).ravel(), *task.inputs.T)  # IPOPT relaxes bounds
    return np.stack([values, values], axis=1)


def _join(
    parts: list[_Part], task: PlanTask | None, stop: Stop | None, dae: Dae, options: SolverOptions
) -> LongPlan:
    """Return the plan of all windows joined in time, with the costs of each summed."""
    motion, begin, runs = joined_motions([part.motion for part in parts]), 0.0, list[Trajectory]()
    for run in (part.replay for part in parts):  # with times since the beginning of the first one
        events = {name: t + begin for name, t in run.events.items()}
        runs.append(replace(run, t=run.t + begin, events=events))
        begin += run.t[-1]
    replay = joined(*(run.part(slice(-1)) for run in runs[:-1]), runs[-1])
    windows = tuple(part.window for part in parts)
    stop = stop and stop._replace(t=float(replay.t[-1]))
    plans = [part.planned for part in parts if part.planned is not None]
    costs = list[dict[str, float]]()
    for own in (part.motion for part in parts):
        if task is not None:
            first, length = own.unknowns[own.layout.first], own.duration
            alone = replace(task, start=first, duration=(length, length), cost_limits=())
            alone = replace(alone, conditions=(), limits=())
            program = transcribe(alone, own.mesh, replace(options, compiled=False))
            costs.append(cost_terms(program, transfer_motion(own, program)))
    return LongPlan(
        motion,
        replace(replay, stop=stop),
        largest(pair for each in plans for pair in each.difference.items()),
        largest(pair for part in parts for pair in part.violation.items()),
        {name: unit for each in plans for name, unit in each.units.items()},
        {name: sum(each[name] for each in costs) for name in (costs[0] if costs else ())},
        stop is None,
        stop is None and all(window.accurate for window in windows),
        tuple(stage for part in parts for stage in part.stages),
        save_motion(motion, dae),
        windows,
        parts[-1].planned is not None and parts[-1].planned.compiled,
    )
