"""Figures of a run: the numbers by which runs of a sweep are compared."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from math import isfinite
from typing import Any

import numpy as np

from slipfree.frames import to_problem_frame
from slipfree.problem.problem import Problem
from slipfree.problem.verbs.base import Quantity
from slipfree.problem.verbs.registry import verb_of
from slipfree.sweep.task import COMPLETE
from slipfree.trajectory import Trajectory

Figures = dict[str, tuple[float, str]]
END = ("x", "y", "z", "heading", "pitch", "roll", "yaw", "tilt_rear", "tilt_front")
LARGEST = (
    "pitch",
    "roll",
    "utilisation",
    "utilisation_best",
    "friction_needed",
    "drive_torque",
    "torque",
    "power",
    "steering_slip",
    "drift_position",
    "closure_residual",
    "newton_step",
)
LEAST = (
    "tip_over_margin",
    "force_normal",
    "clearance",
    "relative_curvature",
    "singular_value",
    "inverse_margin",
)
GAINED = ("work", "rubbed", "damped", "energy", "potential_energy")
CLOCK = "seconds"  # statistics with this in their names differ from run to run


def figures_of(run: Trajectory, problem: Problem[Any]) -> Figures:
    """Return the figures of a motion by name: value and unit.

    Parameters
    ----------
    run : Trajectory
        The motion.
    problem : Problem
        Its problem.

    Returns
    -------
    dict of str to (float, str)
        Ends (``end_x``), extremes over time and wheels (``pitch_largest``, of sizes;
        ``clearance_least``), ``slip_rms`` over time and wheels, ``tilt_largest`` of all tilts,
        what was gained from start to end (``work``), and the solver's statistics but for times.
        ``complete`` is 1 if the motion reached its end; ``within_limits`` of a plan is 1 if its
        simulation is complete and violates nothing by more than ``plan.accuracy``.
    """
    run = to_problem_frame(run)
    own = verb_of(problem).metrics(run, problem.spec)
    found = {COMPLETE: Quantity(float(run.stop is None), "1")}
    for name, quantity in (*_of_samples(run), *own.items(), *_of_statistics(run.statistics, run)):
        if isfinite(quantity.value):
            found[name] = quantity
    return {name: (float(q.value), q.unit) for name, q in found.items()}


def _of_samples(run: Trajectory) -> Iterator[tuple[str, Quantity]]:
    units = {name: column.label.unit for name, column in run.columns.items()}
    for name in END:
        if name in run.columns:
            yield f"end_{name}", Quantity(run[name][-1], units[name])
    for name in LARGEST:
        if name in run.columns:
            yield f"{name}_largest", Quantity(np.abs(run[name]).max(), units[name])
    for name in LEAST:
        if name in run.columns:
            yield f"{name}_least", Quantity(run[name].min(), units[name])
    for name in GAINED:
        if name in run.columns:
            yield name, Quantity(run[name][-1] - run[name][0], units[name])
    tilts = [
        name
        for name in run
        if name.startswith("tilt_") and not name.endswith(("_rate", "_stop", "_torque"))
    ]
    if tilts:
        yield "tilt_largest", Quantity(max(np.abs(run[name]).max() for name in tilts), "rad")


def _of_statistics(counts: Mapping[str, float], run: Trajectory) -> Iterator[tuple[str, Quantity]]:
    for name, value in counts.items():
        if CLOCK not in name:
            of = name.removeprefix("plan_difference_").removeprefix("replay_")
            unit = run.columns[of].label.unit if of != name and of in run.columns else ""
            yield name, Quantity(value, unit)
