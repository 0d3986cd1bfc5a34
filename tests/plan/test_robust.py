"""Robust plans: tightening of limits by replay, on a plan that is a number."""

from collections.abc import Mapping, Sequence

import numpy as np
import pytest
from scipy.stats import binomtest

from slipfree.plan.robust import MAX_ROUNDS, Draw, Share, added_tightening, robust_plan

SPREAD = 0.1
SEEN: list[Draw] = []


def solve(tightening: Mapping[str, float], _before: float) -> float | None:
    """Return the largest value below a tightened bound of 1; none below 0.5."""
    value = 1 - tightening.get("utilisation", 0.0)
    return value if value > 0.5 else None


def replay(value: float, seeds: Sequence[Draw], spread: float = SPREAD) -> list[dict[str, float]]:
    """Return the excess of a disturbed value over its bound."""
    SEEN.extend(seeds)
    return [
        {"utilisation": value + spread * np.random.default_rng(seed).normal() - 1} for seed in seeds
    ]


def test_share_is_reached_at_the_quantile_of_the_disturbance() -> None:
    SEEN.clear()
    found = robust_plan(1.0, solve, replay, share=0.9, draws=400, final_draws=2000, seed=3)
    assert found.before.value == pytest.approx(0.5, abs=0.05)
    assert found.is_solved
    assert found.after.value == pytest.approx(0.9, abs=0.04)
    assert found.tightening["utilisation"] == pytest.approx(1.2816 * SPREAD, rel=0.25)
    final = set(SEEN[-2000:])
    assert final == set(SEEN[-4000:-2000])  # the same draws before and after
    assert not final & set(SEEN[:-4000])  # which the tightening never saw


def test_plan_that_holds_is_not_changed() -> None:
    found = robust_plan(0.0, solve, replay, share=0.95, draws=20, final_draws=20, seed=0)
    assert (found.plan, found.tightening, found.rounds) == (0.0, {}, 0)
    assert found.is_reached


def test_unsolvable_tightening_keeps_the_plan_and_says_so() -> None:
    def wild(value: float, seeds: Sequence[Draw]) -> list[dict[str, float]]:
        return replay(value, seeds, 2.0)

    found = robust_plan(1.0, solve, wild, share=0.95, draws=50, final_draws=50, seed=0)
    assert found.plan == 1.0
    assert not found.is_solved
    assert not found.is_reached


def test_failed_motions_count_as_violations_but_do_not_tighten() -> None:
    def failing(_value: float, seeds: Sequence[Draw]) -> list[dict[str, float]]:
        return [{"motion": np.inf} for _ in seeds]

    found = robust_plan(1.0, solve, failing, share=0.9, draws=5, final_draws=5, seed=0)
    assert found.after == Share(0, 5)
    assert found.tightening == {}
    assert found.rounds < MAX_ROUNDS


def test_violated_limits_divide_the_share() -> None:
    excess = [{"a": k - 50.0, "b": -1.0, "c": 50.0 - k} for k in range(101)]
    assert added_tightening(excess, 0.9) == {"a": 45.0, "c": 45.0}


@pytest.mark.parametrize(("held", "draws"), [(0, 10), (10, 10), (187, 200)])
def test_interval_is_that_of_clopper_and_pearson(held: int, draws: int) -> None:
    expected = binomtest(held, draws).proportion_ci(0.95, "exact")
    assert Share(held, draws).interval == pytest.approx((expected.low, expected.high))
