"""Tighten the limits of a plan until a share of its replays on drawn worlds keeps them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from scipy.special import betaincinv

P = TypeVar("P")
Sizes = Mapping[str, float]
Draw = tuple[int, int, int]
CONFIDENCE = 0.95  # level of the interval of a share
MAX_ROUNDS = 5  # largest number of plans after the first
FINAL = 0  # stream of the draws that only the reported shares use


class Share(NamedTuple):
    """Share of draws on which a plan holds.

    Attributes
    ----------
    held, draws : int
        Number of draws on which all limits are kept, and number of draws.
    """

    held: int
    draws: int

    @property
    def value(self) -> float:
        """Share of the draws."""
        return self.held / self.draws

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson interval of the share at the level `CONFIDENCE`."""
        k, n, tail = self.held, self.draws, (1 - CONFIDENCE) / 2
        low = float(betaincinv(k, n - k + 1, tail)) if k else 0.0
        high = float(betaincinv(k + 1, n - k, 1 - tail)) if k < n else 1.0
        return low, high


class RobustPlan(NamedTuple, Generic[P]):
    """A plan with tightened limits, and its test.

    Attributes
    ----------
    plan : P
        The plan with the tightest limits that could be solved.
    before, after : Share
        Shares of the first plan and of this one, on the same draws, which neither the tightening
        nor its end depends on.
    tightening : dict of str to float
        Tightening of each limit, in its unit.
    rounds : int
        Number of plans after the first.
    is_solved : bool
        Whether every tightened problem was solved.
    is_reached : bool
        Whether the share is reached on the draws of `after`.
    """

    plan: P
    before: Share
    after: Share
    tightening: dict[str, float]
    rounds: int
    is_solved: bool
    is_reached: bool


def robust_plan(
    first: P,
    solve: Callable[[Sizes, P], P | None],
    replay: Callable[[P, Sequence[Draw]], Sequence[Sizes]],
    *,
    share: float,
    draws: int,
    final_draws: int,
    seed: int,
) -> RobustPlan[P]:
    """Tighten the limits of a plan until a share of its replays keeps them.

    Every round replays the newest plan on draws that it does not depend on. If the share is missed,
    these draws tighten the limits for the next plan.

    Parameters
    ----------
    first : P
        The plan with the limits as given.
    solve : callable
        Function of the tightening of each limit, by name and in its unit, and of the plan before,
        for a warm start; returns a plan, or None if none is found.
    replay : callable
        Function of a plan and of seeds; returns for each seed the value of every limit in excess of
        its given bound: positive if it is violated, infinite if the motion fails.
    share : float
        Share of draws that keep all limits. [1]
    draws, final_draws : int
        Number of draws of a round, and of the final test.
    seed : int
        Seed of all draws.
    """
    now, tightening, rounds, is_solved = first, dict[str, float](), 0, True
    for stream in range(FINAL + 1, FINAL + 1 + MAX_ROUNDS):
        excess = replay(now, _seeds(seed, stream, draws))
        if share_of(excess).value >= share:
            break
        added = added_tightening(excess, share)
        if not added:  # the motions fail, or miss a limit that cannot be told apart
            break
        wanted = {
            name: tightening.get(name, 0.0) + added.get(name, 0.0) for name in tightening | added
        }
        found = solve(wanted, now)
        if found is None:
            is_solved = False
            break
        now, tightening, rounds = found, wanted, rounds + 1
    final = _seeds(seed, FINAL, final_draws)
    before = share_of(replay(first, final))
    after = share_of(replay(now, final)) if rounds else before
    return RobustPlan(now, before, after, tightening, rounds, is_solved, after.value >= share)


def share_of(excess: Sequence[Sizes]) -> Share:
    """Return the share of draws on which no limit is violated."""
    return Share(sum(max(each.values(), default=0.0) <= 0 for each in excess), len(excess))


def added_tightening(excess: Sequence[Sizes], share: float) -> dict[str, float]:
    """Return the tightening of each violated limit: a quantile of its excess.

    The draws that may fail are divided equally among the violated limits, so that all limits
    together keep the share. Failed motions have no finite excess and do not count.
    """
    values = {
        name: np.array([each[name] for each in excess if np.isfinite(each.get(name, np.inf))])
        for name in {name: None for each in excess for name in each}
    }
    violated = {name: sizes for name, sizes in values.items() if sizes.max(initial=0.0) > 0}
    level = 1 - (1 - share) / max(len(violated), 1)
    found = {
        name: float(np.quantile(sizes, level, method="higher")) for name, sizes in violated.items()
    }
    return {name: size for name, size in found.items() if size > 0}


def _seeds(seed: int, stream: int, count: int) -> list[Draw]:
    """Return the seeds of a stream of draws; streams have no draw in common."""
    return [(seed, stream, number) for number in range(count)]
