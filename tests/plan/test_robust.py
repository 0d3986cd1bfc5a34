"""Tests of robust plans: tightening of limits by replay, with a scalar as plan."""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from scipy.stats import binomtest

from slipfree.core.errors import ModelError
from slipfree.plan.robust import (
    MAX_ROUNDS,
    Bound,
    DisturbedRun,
    Draw,
    Replays,
    added_tightening,
    robust_plan,
)

SPREAD = 0.1
LIMIT = Bound("utilisation", "upper")
SEEN: list[Sequence[Draw]] = []


def solve(tightening: Mapping[Bound, float], _before: float) -> float:
    """Return the largest value below a tightened bound of 1; none below 0.5."""
    value = 1 - tightening.get(LIMIT, 0.0)
    if value <= 0.5:
        raise ModelError("too tight")
    return value


def replay(values: Sequence[float], draws: Sequence[Draw], spread: float = SPREAD) -> list[Replays]:
    """Return the excess of disturbed values over their bound."""
    SEEN.append(draws)
    errors = [spread * np.random.default_rng(draw).normal() for draw in draws]
    return [
        Replays(tuple(DisturbedRun({LIMIT: value + error - 1}, abs(error)) for error in errors))
        for value in values
    ]


def replays(*excess: dict[Bound, float]) -> Replays:
    """Return simulations with a given excess of bounds."""
    return Replays(tuple(DisturbedRun(each, 0.0) for each in excess))


def test_share_is_reached_at_the_quantile_of_the_disturbance() -> None:
    SEEN.clear()
    found = robust_plan(1.0, solve, replay, share=0.9, draws=400, final_draws=2000, seed=3)
    assert found.before.share == pytest.approx(0.5, abs=0.05)
    assert not found.failure
    assert 0.9 <= found.after.share == pytest.approx(0.95, abs=0.03)  # half of the failures left
    assert found.tightening[LIMIT] == pytest.approx(1.6449 * SPREAD, rel=0.25)
    *tightening, final = SEEN
    assert len(final) == found.before.draws == found.after.draws == 2000
    assert not set(final) & {draw for draws in tightening for draw in draws}
    assert found.after.distances(0.5) == [pytest.approx(0.6745 * SPREAD, rel=0.1)]


def test_plan_that_holds_is_not_changed() -> None:
    found = robust_plan(0.0, solve, replay, share=0.95, draws=20, final_draws=20, seed=0)
    assert (found.plan, found.tightening, found.rounds) == (0.0, {}, 0)
    assert found.after.share == 1


def test_limits_that_cannot_be_tight_enough_are_as_tight_as_possible() -> None:
    def wild(values: Sequence[float], draws: Sequence[Draw]) -> list[Replays]:
        return replay(values, draws, 0.5)

    found = robust_plan(1.0, solve, wild, share=0.95, draws=50, final_draws=50, seed=0)
    assert found.failure == "too tight"
    assert 0.5 < found.plan < 0.9
    assert found.before.share < found.after.share < 0.95


def test_unsolvable_problem_keeps_the_plan() -> None:
    def fail(_tightening: Mapping[Bound, float], _before: float) -> float:
        raise ModelError("no plan")

    found = robust_plan(1.0, fail, replay, share=0.95, draws=50, final_draws=50, seed=0)
    assert (found.plan, found.tightening, found.failure) == (1.0, {}, "no plan")


def test_failed_motions_count_as_violations_but_do_not_tighten() -> None:
    def failing(values: Sequence[float], draws: Sequence[Draw]) -> list[Replays]:
        each = Replays(tuple(DisturbedRun({Bound("motion"): np.inf}, np.nan) for _ in draws))
        return [each for _ in values]

    found = robust_plan(1.0, solve, failing, share=0.9, draws=5, final_draws=5, seed=0)
    assert found.after.held == 0
    assert found.after.violated == {Bound("motion"): 5}
    assert found.tightening == {}
    assert found.rounds < MAX_ROUNDS
    assert np.isnan(found.after.distances(0.5, 0.95)).all()


def test_violated_limits_keep_the_share_together() -> None:
    a, b, c = (Bound(name, "upper") for name in "abc")
    excess = replays(*({a: k - 50.0, b: -1.0, c: 50.0 - k} for k in range(100)))
    # opposed errors: 5 draws at each end may fail; errors in common: the 10 largest
    assert added_tightening(excess, 0.9) == {a: 44.0, c: 45.0}
    common = replays(*({a: k - 50.0, c: 2 * (k - 50.0)} for k in range(100)))
    assert added_tightening(common, 0.9) == {a: 39.0, c: 78.0}


def test_failed_motions_leave_less_of_the_share_for_limits() -> None:
    failed = [{Bound("motion"): np.inf}] * 5
    excess = replays(*failed, *({LIMIT: k - 50.0} for k in range(95)))
    assert added_tightening(excess, 0.9) == {LIMIT: 39.0}  # 90 of 100 draws keep the bound


@pytest.mark.parametrize(("held", "draws"), [(0, 10), (10, 10), (187, 200)])
def test_interval_is_that_of_clopper_and_pearson(held: int, draws: int) -> None:
    found = replays(*({LIMIT: -1.0 if k < held else 1.0} for k in range(draws)))
    expected = binomtest(held, draws).proportion_ci(0.95, "exact")
    assert found.interval == pytest.approx((expected.low, expected.high))
