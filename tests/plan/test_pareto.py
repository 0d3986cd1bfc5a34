"""Tests of Pareto fronts with closed forms: convex or not, with local optima or failures."""

from __future__ import annotations

import numpy as np
import pytest

from slipfree.core.errors import ModelError
from slipfree.core.outcome import Outcome
from slipfree.plan.pareto import FrontPoint, pareto_front

DONE = Outcome.COMPLETE


def convex(bound):
    return 1 / bound


def concave(bound):
    """A quarter of a circle of radius 5; weighted sums find only its ends."""
    return np.sqrt(25 - bound**2)


def front(value, count, high=4.0, change=None):
    def solve(tasks):
        points = [FrontPoint(b, value(b), b, outcome=DONE, solution=b) for _, b, _ in tasks]
        return points if change is None else list(map(change, tasks, points))

    ends = (FrontPoint(b, value(b), b, outcome=DONE, solution=b) for b in (1.0, high))
    return pareto_front(solve, *ends, count)


@pytest.mark.parametrize("value", [convex, concave])
@pytest.mark.parametrize("count", [2, 3, 8])
def test_points_are_on_the_front_at_equal_ratios(value, count):
    found = front(value, count)
    bounds = [point.bound for point in found]
    np.testing.assert_allclose(bounds, np.geomspace(1.01, 4.0, count))
    assert [point.first for point in found] == [value(b) for b in bounds]
    assert not any(point.is_dominated for point in found)


def test_local_optima_are_solved_again_or_marked():
    def stuck(task, point):
        helped = task.number != 2 and task.start.solution > task.bound
        return point if helped or task.number not in (2, 3) else point._replace(first=9.0)

    found = front(convex, 6, change=stuck)
    assert [point.is_dominated for point in found] == [False, False, True, False, False, False]


def test_points_that_are_not_solved_are_kept_with_their_reason():
    def failing(task, point):
        failed = FrontPoint(task.bound, outcome=Outcome.INFEASIBLE, words="why")
        return failed if task.number == 1 else point

    found = front(convex, 5, change=failing)
    assert [point.is_solved for point in found] == [True, False, True, True, True]
    assert found[1].words == "why"
    assert not found[1].is_dominated


def test_without_conflict_the_front_is_one_point():
    assert len(front(convex, 5, high=1.005)) == 1


def test_one_point_is_no_front():
    with pytest.raises(ModelError, match="expected two points or more, found 1"):
        front(convex, 1)
