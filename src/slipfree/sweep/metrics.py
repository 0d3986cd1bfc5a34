"""Metrics of a run, by which the runs of a sweep are compared."""

from __future__ import annotations

from math import isfinite
from typing import Any

from slipfree.core.facts import Fact, numbers
from slipfree.core.trajectory import Trajectory
from slipfree.problem.load import verb_of
from slipfree.problem.problem import Problem
from slipfree.sweep.task import COMPLETE

Figures = dict[str, tuple[float, str]]
CLOCK = "seconds"  # statistics with this in their names are not reproducible


def figures_of(run: Trajectory, problem: Problem[Any]) -> Figures:
    """Return the metrics of a motion by name: value and unit.

    Parameters
    ----------
    run : Trajectory
        The motion.
    problem : Problem
        Its problem.

    Returns
    -------
    dict of str to (float, str)
        Values at the end (``end_x``), extremes over time and wheels (``pitch_largest``, of absolute
        values; ``clearance_least``), ``slip_rms`` over time and wheels, ``tilt_largest`` of all
        tilt angles, differences between end and start (``work``), and the solver's statistics
        except computing times. Values that are not finite are omitted. ``complete`` is 1 if the
        motion reached its end. ``within_limits`` of a plan is 1 if its simulation is complete and
        violates no limit by more than ``plan.accuracy``.
    """
    verb = verb_of(problem)
    found = {COMPLETE: Fact(float(run.stop is None), "1")}
    found |= numbers(verb.facts(run))
    found |= {name: Fact(value) for name, value in run.statistics.items()}
    return {
        name: (float(fact.value), fact.unit)
        for name, fact in found.items()
        if CLOCK not in name and isfinite(fact.value)
    }
