"""Search for the plan of a planning problem."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from slipfree.contact.closure import has_exact_closure
from slipfree.core.dae import Dae
from slipfree.core.outcome import Outcome
from slipfree.core.records import Array
from slipfree.core.trajectory import PLAN, SolverError, Stop, Trajectory
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.rigid_dynamics import dynamic_guess
from slipfree.plan.ipopt import Iterate
from slipfree.plan.plan import Plan as FoundPlan
from slipfree.plan.plan import plan
from slipfree.plan.robust import Tightening, tightened_arguments
from slipfree.plan.warm_start import SavedPlan
from slipfree.problem.build_common import in_frame, solver_options
from slipfree.problem.build_ground import at
from slipfree.problem.build_model import model_law
from slipfree.problem.problem import Problem
from slipfree.problem.verbs.plan_schema import Plan
from slipfree.problem.verbs.plan_setup import (
    Planning,
    momentum_models,
    plan_arguments,
    settled_start,
)
from slipfree.problem.verbs.plan_windows import search_arguments
from slipfree.solve.simulate import simulate

SMOOTHINGS = (1.0, 0.3)  # smoothing widths of the load law in the first plans, in static depths
ROUGH = 1e-5  # tolerance of initial guesses [m, rad]


def guess_motion(setup: Planning, start: tuple[Any, Array]) -> Trajectory:
    """Return the motion under the inputs of an initial guess, simulated with a loose tolerance.

    If the guess follows a path and the goal has x and y, the motion ends at its sample nearest to
    the goal; ranges of x and y are represented by their middle. If the integrator fails after the
    first sample, the motion ends where the integrator stopped.

    Parameters
    ----------
    setup : Planning
        Set-up of the problem.
    start : tuple of (record, ndarray)
        Inputs of the guess, and times of its samples. [s]

    Raises
    ------
    SolverError
        If the integrator fails before the first sample.
    """
    law, t = start
    try:
        rough = replace(setup.spec.solver.options, tolerance=ROUGH)
        run = simulate(setup.guide, setup.guide_start, law, t, options=rough)
    except SolverError as error:
        if error.trajectory is None:
            raise
        run = error.trajectory
    if setup.paths and setup.places[-1][0] == "goal":
        _, x, y = setup.places[-1]
        away = np.hypot(run["x"] - x, run["y"] - y)
        run = run.part(slice(max(int(away.argmin()), 1) + 1))
    if setup.guide is setup.dae:
        return run
    return dynamic_guess(setup.dae, setup.vehicle, setup.start, run)


def find_plan(
    problem: Problem[Plan],
    setup: Planning,
    guesses: list[Trajectory],
    resume: SavedPlan | None,
    progress: Callable[[str, Iterate], bool],
    length: float,
    tightening: Tightening = MappingProxyType({}),
    keep: Callable[[FoundPlan], None] | None = None,
) -> FoundPlan:
    """Return the plan of a problem.

    For wheels that press into the ground, plans with smoother load laws are computed first, for
    wheels that slide, plans with larger creep speeds; each search starts from the previous plan.
    If a search fails, the previous plan is returned.

    Parameters
    ----------
    problem, setup : Problem, Planning
        The problem and its set-up.
    guesses : list of Trajectory
        Initial guesses; empty with ``resume``.
    resume : SavedPlan or None
        Plan from which the search starts.
    progress : callable
        As for `plan`.
    length : float
        Duration of the plan if the problem gives none. [s]
    tightening : mapping of Bound to float
        Distance of each tightened bound from the given one, in the unit of the quantity.
    keep : callable, optional
        As for `plan`.

    Raises
    ------
    ProblemError
        If start, goal and limits contradict each other, or ``resume`` is a plan of another model.
    SolverError
        If the plan cannot be simulated from the start.
    """
    spec, found, saved = problem.spec, None, resume
    for dae in (*([] if resume else _smoothed_models(problem, setup)), setup.dae):
        is_same = dae is setup.dae or dae.replay is not None  # creep does not change the start
        start = setup.start if is_same else settled_start(dae, setup)
        model = (dae, setup.vehicle, setup.terrain)
        arguments = plan_arguments(spec, setup.keep_out, model, setup.between)
        search = search_arguments(spec) | {"options": solver_options(problem)}
        if dae.replay and dae is not setup.dae:  # only the last creep speed has to be accurate
            search["accuracy"] = np.inf
        with at(problem, ("plan",)):
            now = plan(
                dae,
                start,
                [] if saved else guesses,
                **tightened_arguments(dae, arguments, tightening),
                **search,
                duration=spec.plan.duration or (length, length),
                resume=saved,
                progress=progress,
                keep=keep if keep is None or dae is setup.dae else partial(_keep_smoothed, keep),
            )
        if found is not None:
            if not now.success and now.run.outcome is not Outcome.INTERRUPTED:
                return found
            now = replace(now, stages=(*found.stages, *now.stages))
        if not now.success or dae is setup.dae:
            break
        found, saved = now, now.saved
    return now


def _keep_smoothed(keep: Callable[[FoundPlan], None], found: FoundPlan) -> None:
    """Keep a plan of one of the first searches; its stop says that it is not the final one."""
    words = "the search was interrupted; this plan has a smoother load law or a larger creep speed"
    stop = Stop(PLAN, float(found.replay.t[-1]), words, Outcome.INTERRUPTED)
    keep(replace(found, replay=replace(found.replay, stop=stop)))


def _smoothed_models(problem: Problem[Plan], setup: Planning) -> list[Dae]:
    """Return models for searches before that of the plan, the smoothest first.

    They have smoothed load laws of wheels that press into the ground, or, with inertia, larger
    creep speeds of wheels that slide. The list is empty for other vehicles.
    """
    if problem.spec.model == "dynamics":
        return momentum_models(problem, setup.vehicle, setup.terrain)[:-1]
    if has_exact_closure(setup.vehicle):
        return []
    slip = model_law(problem, problem.spec)
    return [
        in_frame(
            problem, direct_kinematics(setup.vehicle, setup.terrain, slip=slip, smoothing=width)
        )
        for width in SMOOTHINGS
    ]
