"""Follow a plan in closed loop by replanning over a moving window from the measured state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.records import leaves
from slipfree.core.trajectory import SolverError, Trajectory, joined
from slipfree.plan.mpc import Cycle, Horizon, cycle_inputs, first_cycle, replan
from slipfree.solve.options import SolverOptions
from slipfree.solve.simulate import interrupted_at, simulate
from slipfree.system.forks import computing
from slipfree.system.interrupt import interrupt_requested


class TrackedMotion(NamedTuple):
    """Motion of a vehicle that follows a plan in closed loop.

    Attributes
    ----------
    run : Trajectory
        The simulated motion, with times since the beginning of the plan.
    cycles : int
        Number of simulated cycles.
    failures : int
        Number of cycles whose optimisation failed; in these the vehicle used the inputs of the last
        successful cycle.
    """

    run: Trajectory
    cycles: int
    failures: int


@computing
def track_plan(
    window: Horizon,
    world: Dae,
    start: Trajectory,
    *,
    period: float,
    options: SolverOptions = SolverOptions(),
    progress: Callable[[float], None] | None = None,
) -> TrackedMotion:
    """Simulate a vehicle that replans over a moving window at every period.

    The controller uses the model of the plan; the vehicle moves according to the model ``world``,
    for example on another ground. The controller measures all states without error or delay.

    Parameters
    ----------
    window : Horizon
        Window of the plan, from `slipfree.plan.mpc.horizon`.
    world : Dae
        Model in which the vehicle moves, with the states and inputs of the plan's model.
    start : Trajectory
        Trajectory of the model ``world`` whose last sample is the initial state of the vehicle.
    period : float
        Time between two cycles, at most the duration of the plan. [s]
    options : SolverOptions
        Options of the simulation.
    progress : callable, optional
        Function called in each cycle with the time at which it begins. [s]

    Returns
    -------
    TrackedMotion
        The motion ends early if a limit of ``world`` is violated, the simulation fails, or a
        Ctrl-C is held back by `held_interrupt`.

    Raises
    ------
    ModelError
        If the period is not positive or exceeds the duration of the plan, or if the models have
        different states or inputs.
    SolverError
        If the first cycle fails, or if a simulation cannot be started.
    """
    duration, dae = window.plan.duration, window.program.task.dae
    if not 0 < period <= duration:
        raise ModelError(
            f"period: expected a period above 0 and at most {duration:g} s, the duration of the "
            f"plan, found {period:g} s; choose a period in this range"
        )
    for record in ("x", "u"):
        found, expected = (
            [label.full for label in leaves(getattr(each.labels, record))] for each in (world, dae)
        )
        if found != expected:
            raise ModelError(
                "world: expected the states and inputs of the plan's model, "
                f"{', '.join(expected)}, found {', '.join(found)}; use a vehicle with the same "
                "joints and wheels (its parameters may differ)"
            )
    times = np.append(np.arange(0.0, duration - 0.5 * period, period), duration)
    cycle, here, runs, failures = first_cycle(window), start, list[Trajectory](), 0
    for t, end in pairwise(times):
        try:
            cycle = replan(window, cycle, t, dae.rows("x", here, -1))
        except SolverError:
            failures += 1
        if progress is not None:
            progress(t)
        try:
            here = _drive(world, here, window, cycle, (t, end), options)
        except KeyboardInterrupt:
            if not (runs and interrupt_requested()):
                raise
            runs[-1] = replace(here, stop=interrupted_at(t))
            break
        runs.append(here)
        if here.stop is not None or here.t[-1] < end - 1e-9:
            break
    run = joined(*(each.part(slice(-1)) for each in runs[:-1]), runs[-1])
    return TrackedMotion(run, len(runs), failures)


def _drive(
    world: Dae,
    here: Trajectory,
    window: Horizon,
    cycle: Cycle,
    span: tuple[float, float],
    options: SolverOptions,
) -> Trajectory:
    """Return the motion under the inputs of a cycle, with times since the beginning of the plan."""
    inputs, times = cycle_inputs(window, cycle, *span)
    try:
        run = simulate(world, here, inputs, times, options=options)
    except SolverError as error:
        if error.trajectory is None:
            raise
        run = error.trajectory
    stop = run.stop and run.stop._replace(t=run.stop.t + cycle.t)
    return replace(run, t=run.t + cycle.t, stop=stop)
