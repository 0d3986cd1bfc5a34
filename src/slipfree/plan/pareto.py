"""Pareto fronts of two objectives by the epsilon-constraint method.

The second objective is bounded at several values, and the first objective is minimised for each
(Haimes, Lasdon and Wismer, IEEE Trans. Systems, Man, and Cybernetics 1, 1971). Unlike weighted
sums, the method finds the parts of a front that are not convex.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.records import with_overview
from slipfree.core.trajectory import Outcome

SLACK = 0.01  # relative distance of the smallest bound from the least second objective
MARGIN = 1e-3  # smallest relative gain of a point that dominates another


@with_overview
class FrontPoint(NamedTuple):
    """Point of a Pareto front: minimum of the first objective for a bound on the second one."""

    bound: float  # bound on the second objective
    first: float = np.nan  # objectives of the solution; NaN without a solution
    second: float = np.nan
    slope: float = np.nan  # of the first objective with respect to the bound; or NaN
    outcome: Outcome = Outcome.INTERRUPTED  # ``COMPLETE`` for a verified solution
    words: str = ""  # reason of another outcome
    solution: Any = None  # solution, from which others start
    is_dominated: bool = False  # a local optimum, but not a global one

    @property
    def is_solved(self) -> bool:
        """Whether the point has a verified solution."""
        return self.outcome is Outcome.COMPLETE


class FrontTask(NamedTuple):
    """Minimisation of the first objective for one point of a front."""

    number: int  # index of the point, from 0 at the smallest bound
    bound: float  # bound on the second objective
    start: FrontPoint  # solved point as initial guess


def pareto_front(
    solve: Callable[[Sequence[FrontTask]], Sequence[FrontPoint]],
    least: FrontPoint,
    best: FrontPoint,
    count: int,
) -> tuple[FrontPoint, ...]:
    """Return the points of a Pareto front, by increasing bound on the second objective.

    The bounds have equal ratios, from 1 % above that of ``least`` to that of ``best``. Each point
    is solved from the nearest solved points on both sides, and dominated points once more from the
    dominating point, since a search may end in a local optimum; the best solution is kept.
    """
    check_count(count)
    for name, point in (("second", least), ("first", best)):
        if not point.is_solved:
            why = f" ({point.words})" if point.words else ""
            raise ModelError(
                f"pareto_front: expected a minimum of the {name} objective, found the outcome "
                f"{point.outcome.title!r}{why}; give a solved point"
            )
        if not point.second > 0:
            raise ModelError(
                "pareto_front: expected a positive second objective at the minimum of the "
                f"{name} objective, found {point.second:g}; choose another second objective"
            )
    lowest = (1 + SLACK) * least.second
    if lowest >= best.second:
        return (best,)
    bounds = np.geomspace(lowest, best.second, count)
    known = {-1: least, count - 1: best}
    for batch in _batches(count):
        tasks = [
            FrontTask(k, float(bounds[k]), start) for k in batch for start in _neighbours(known, k)
        ]
        _keep_better(known, tasks, solve(tasks))
    points = [known[k] for k in range(count)]
    dominating = [_dominating(point, points) for point in points]
    again = [
        FrontTask(k, point.bound, start)
        for k, (point, start) in enumerate(zip(points, dominating, strict=True))
        if start is not None
    ]
    _keep_better(known, again, solve(again))
    points = [known[k] for k in range(count)]
    return tuple(
        point._replace(is_dominated=_dominating(point, points) is not None) for point in points
    )


def check_count(count: int) -> None:
    """Raise ModelError for a front of fewer than two points."""
    if count < 2:
        raise ModelError(f"pareto_front: expected two points or more, found {count}; increase it")


def is_better(point: FrontPoint, other: FrontPoint) -> bool:
    """Return whether a point is better than another point with the same bound."""
    if not (point.is_solved and other.is_solved):
        return point.is_solved
    return point.first < other.first


def _batches(count: int) -> Iterator[list[int]]:
    """Yield the indices of all points but the last: the first, then midpoints of known ones."""
    known = [0, count - 1]
    yield [0]
    while batch := [(a + b) // 2 for a, b in pairwise(known) if b - a > 1]:
        yield batch
        known = sorted([*known, *batch])


def _neighbours(points: dict[int, FrontPoint], k: int) -> Iterator[FrontPoint]:
    """Yield the nearest solved points below and above point ``k``; only below for the first one."""
    solved = [j for j, point in points.items() if point.is_solved]
    yield points[max(j for j in solved if j < k)]
    if k:
        yield points[min(j for j in solved if j > k)]


def _keep_better(
    known: dict[int, FrontPoint], tasks: Sequence[FrontTask], points: Sequence[FrontPoint]
) -> None:
    """Store the points of tasks in ``known`` where they are better than the stored points."""
    for task, point in zip(tasks, points, strict=True):
        if is_better(point, known.setdefault(task.number, point)):
            known[task.number] = point


def _dominating(point: FrontPoint, points: Sequence[FrontPoint]) -> FrontPoint | None:
    """Return the best point that dominates a point; None if none does."""
    better = [
        each
        for each in points
        if each.is_solved
        and point.is_solved
        and each.second <= point.second * (1 + MARGIN)
        and each.first < point.first * (1 - MARGIN)
    ]
    return min(better, key=lambda each: each.first, default=None)
