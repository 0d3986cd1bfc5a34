"""Long plans of planning problems: windows along a route."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

from slipfree.contact.closure import has_exact_closure
from slipfree.control.path_following import follow
from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.geometry.path import Path
from slipfree.plan.plan import PlanProgress
from slipfree.plan.warm_start import SavedPlan
from slipfree.plan.windows import LongPlan, plan_windows
from slipfree.problem.build_common import Setup
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem
from slipfree.problem.verbs.plan_schema import PlanKeys
from slipfree.vehicle.tree import Vehicle

OVERLAP = 1 / 3  # default overlap, relative to the window


def check_windows(
    problem: Problem[PlanKeys], spec: PlanKeys, vehicle: Vehicle, paths: tuple[Array, ...]
) -> None:
    """Raise ProblemError if a problem with windows has keys or a vehicle that do not suit them."""
    window = spec.plan.window
    if window is None:
        if spec.plan.overlap is not None:
            with at(problem, ("plan", "overlap")):
                raise ModelError(
                    "expected this key only with 'window', found no 'window'; add it to [plan], or "
                    "remove 'overlap'"
                )
        return
    for key, words in _contradictions(spec, vehicle, paths, window):
        with at(problem, key):
            raise ModelError(words)


def _contradictions(
    spec: PlanKeys, vehicle: Vehicle, paths: tuple[Array, ...], window: float
) -> Iterator[tuple[tuple[str, ...], str]]:
    """Yield key and message of each reason why a problem cannot be planned in windows."""
    if len(paths) != 1:
        yield (
            ("plan", "window"),
            "expected a driver that follows one path (name = 'route' with count = 1, or 'follow' "
            f"with 'path' or 'file'), found {len(paths) or 'no'} paths; use such a driver, or "
            "remove 'window'",
        )
        return
    if _overlap(spec, window) >= window:
        yield (
            ("plan", "overlap"),
            f"expected less than the window, {window:g} m, found {_overlap(spec, window):g} m; "
            "reduce the overlap",
        )
    for name, is_given in (
        ("duration", spec.plan.duration is not None),
        ("starts", spec.plan.starts > 1),
    ):
        if is_given:
            yield (
                ("plan", name),
                f"expected no '{name}' with 'window', found both; remove one of them",
            )
    for name, advice in (
        ("way_points", "remove the way-points, or lead the driver's path through them"),
        ("cost_limits", "remove 'cost_limits'"),
    ):
        if getattr(spec, name):
            yield (name,), f"expected no {name!r} with plan.window, found both; {advice}"
    if not has_exact_closure(vehicle):
        yield (
            ("plan", "window"),
            "expected a vehicle with exact contact of all wheels, found "
            f"{vehicle.name}, whose wheels press into the ground; remove 'window'",
        )
    speed = abs(spec.driver.speed) if spec.driver else 1.0
    least = Path(paths[0]).length / speed
    if spec.time.duration < least:
        yield (
            ("time", "duration"),
            f"expected at least {least:.6g} s, which the path takes at {speed:g} m/s, found "
            f"{spec.time.duration:g} s; increase the duration",
        )


def _overlap(spec: PlanKeys, window: float) -> float:
    """Return the overlap of the windows [m]."""
    return OVERLAP * window if spec.plan.overlap is None else spec.plan.overlap


def search_arguments(spec: PlanKeys) -> dict[str, Any]:
    """Return the arguments of `plan` about mesh, accuracy, solver and sampling of a problem."""
    return {
        "intervals": spec.plan.intervals,
        "degree": spec.plan.degree,
        "accuracy": spec.plan.accuracy,
        "options": spec.solver.options,
        "step": spec.time.step,
    }


def long_plan(
    problem: Problem[PlanKeys],
    setup: Setup,
    route: Array,
    arguments: Mapping[str, Any],
    resume: SavedPlan | None,
    progress: PlanProgress,
    keep: Callable[[LongPlan], None],
) -> LongPlan:
    """Return the plan of a problem along a route, planned in windows.

    Parameters
    ----------
    problem, setup : Problem, Setup
        The problem and its set-up.
    route : ndarray, shape (n, 2)
        Points of the route in map coordinates. [m]
    arguments : mapping
        Arguments of `plan` for the problem.
    resume : SavedPlan or None
        Plan in windows from which the search continues.
    progress, keep : callable
        As for `plan_windows`.

    Raises
    ------
    ProblemError
        If speed, lengths or limits are not valid, or ``resume`` is a plan of another model.
    SolverError
        If no motion along the route can be simulated from the start.
    """
    spec = problem.spec
    window, speed = spec.plan.window or 0.0, spec.driver.speed if spec.driver else 0.0
    options = {
        name: value
        for name, value in arguments.items()
        if name not in ("way_points", "cost_limits")
    }
    with at(problem, ("plan",)):
        return plan_windows(
            setup.dae,
            partial(follow, setup.dae, setup.vehicle, speed=speed),
            setup.start,
            Path(route),
            speed=abs(speed),
            length=window,
            overlap=_overlap(spec, window),
            resume=resume,
            progress=progress,
            keep=keep,
            **search_arguments(spec),
            **options,
        )
