"""Follow a plan in closed loop: replan over a moving window from the measured state."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.forks import computing
from slipfree.plan.mpc import Cycle, Horizon, cycle_inputs, first_cycle, replan
from slipfree.records import leaves
from slipfree.solve.options import SolverOptions
from slipfree.solve.simulate import simulate
from slipfree.trajectory import SolverError, Trajectory, joined


class TrackedPlan(NamedTuple):
    """Motion of a vehicle that follows a plan.

    Attributes
    ----------
    run : Trajectory
        The motion, with times since the plan began.
    cycles, failures : int
        Number of cycles, and of those whose optimisation failed, so that the vehicle continued with
        the cycle before.
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
) -> TrackedPlan:
    """Simulate a vehicle that replans over a moving window at every period.

    The controller knows the model of the plan; the vehicle moves in another model, for example on
    another ground. It measures all states without error and delay.

    Parameters
    ----------
    window : Horizon
        Window of the plan, from `slipfree.plan.mpc.horizon`.
    world : Dae
        Model in which the vehicle moves, with the states and inputs of the plan's model.
    start : Trajectory
        Its last sample is where the vehicle starts, in the world's model.
    period : float
        Time between two cycles. [s]
    options : SolverOptions
        Options of the simulation.
    progress : callable, optional
        Called with the time reached at every cycle. [s]

    Returns
    -------
    TrackedPlan
        The motion ends early at the first violated limit of the world's model.

    Raises
    ------
    ModelError
        If the period is not positive, or the models have different states or inputs.
    """
    duration, dae = window.plan.duration, window.program.task.dae
    if not 0 < period <= duration:
        raise ModelError(f"period: expected at most {duration:g} s and above 0, found {period:g} s")
    for record in ("x", "u"):
        found, expected = (
            [label.full for label in leaves(getattr(each.labels, record))] for each in (world, dae)
        )
        if found != expected:
            raise ModelError(
                "world: expected the states and inputs of the plan's model, "
                f"{', '.join(expected)}, found {', '.join(found)}; change parameters of the "
                "vehicle, not its joints or wheels"
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
        here = _drive(world, here, window, cycle, (t, end), options)
        runs.append(here)
        if here.stop is not None or here.t[-1] < end - 1e-9:
            break
    run = joined(*(each.part(slice(-1)) for each in runs[:-1]), runs[-1])
    return TrackedPlan(run, len(runs), failures)


def _drive(
    world: Dae,
    here: Trajectory,
    window: Horizon,
    cycle: Cycle,
    span: tuple[float, float],
    options: SolverOptions,
) -> Trajectory:
    """Return the motion under the inputs of a cycle, with times since the plan began."""
    inputs, times = cycle_inputs(window, cycle, *span)
    try:
        run = simulate(world, here, inputs, times, options=options)
    except SolverError as error:
        if error.trajectory is None:
            raise
        run = error.trajectory
    stop = run.stop and run.stop._replace(t=run.stop.t + cycle.t)
    return replace(run, t=run.t + cycle.t, stop=stop)
