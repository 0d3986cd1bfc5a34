"""Tighten the limits of a plan until a required share of its simulations satisfies them.

Each simulation runs in a drawn world: the model with random errors, for example of ground, friction
and inputs.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import Annotated, Any, Generic, NamedTuple, TypeVar

import numpy as np
import scipy  # its parts are imported when they are used, since scipy.stats takes 0.3 s
from annotated_types import Ge, Gt, Le, Lt, Unit

from slipfree.core.dae import Dae, Limit
from slipfree.core.errors import ModelError, SlipfreeError
from slipfree.core.records import with_overview
from slipfree.core.trajectory import Trajectory
from slipfree.plan.constraints import number, role_of
from slipfree.plan.polynomial_motion import PolynomialMotion
from slipfree.plan.problem import near_conditions
from slipfree.plan.transcription import PlanTask
from slipfree.plan.verification import largest, limit_name, limit_values, tolerated_excess
from slipfree.solve.sampling import periodic_states, same_turn

P = TypeVar("P")
Draw = tuple[int, int, int]
LOWER, UPPER = "lower", "upper"
CONFIDENCE = 0.95  # level of the confidence interval of a share
MAX_ROUNDS = 5  # largest number of times that the limits are tightened
MIN_STEP = 1 / 8  # smallest step between two plans, as a fraction of the round's tightening
FINAL = 0  # random stream of the draws for the reported shares only


class Bound(NamedTuple):
    """A bound of a limit, goal or way-point, or the requirement that the motion reaches its end."""

    name: str  # such as "utilisation[left]", "y at the goal", "motion ends early (roll)"
    side: str = ""  # ``"lower"``, ``"upper"``, or empty for an early end

    def __str__(self) -> str:
        return f"{self.side} bound of {self.name}" if self.side else self.name


Tightening = Mapping[Bound, float]


class DisturbedRun(NamedTuple):
    """Simulation of a plan in a drawn world, compared with the bounds."""

    # largest value beyond each bound and its tolerance, in the unit of the quantity: positive if
    # violated, infinite if tightening cannot help
    excess: dict[Bound, float]
    distance: float  # of its end from that of the plan in x and y, or NaN [m]

    @property
    def holds(self) -> bool:
        """Whether the simulation satisfies all bounds."""
        return max(self.excess.values(), default=0.0) <= 0


class Replays(NamedTuple):
    """Simulations of a plan in drawn worlds."""

    each: tuple[DisturbedRun, ...]  # one simulation for each draw

    def __repr__(self) -> str:
        return f"Replays: {self.held} of {self.draws} satisfy all bounds"

    @property
    def draws(self) -> int:
        """Number of simulations."""
        return len(self.each)

    @property
    def held(self) -> int:
        """Number of simulations that satisfy all bounds."""
        return sum(replay.holds for replay in self.each)

    @property
    def share(self) -> float:
        """Share of the simulations that satisfy all bounds."""
        return self.held / self.draws

    @property
    def interval(self) -> tuple[float, float]:
        """Clopper-Pearson confidence interval of the share, at the level `CONFIDENCE`."""
        low, high = scipy.stats.binomtest(self.held, self.draws).proportion_ci(CONFIDENCE)
        return float(low), float(high)

    @property
    def violated(self) -> dict[Bound, int]:
        """Number of simulations that violate each violated bound, the largest number first."""
        counts = Counter(
            bound for replay in self.each for bound, size in replay.excess.items() if size > 0
        )
        return dict(counts.most_common())

    def distances(self, *levels: float) -> list[float]:
        """Return quantiles in m of the distance from the planned end; NaN if all end early."""
        finite = [replay.distance for replay in self.each if np.isfinite(replay.distance)]
        return [float(np.quantile(finite, level)) if finite else np.nan for level in levels]


@with_overview
class RobustPlan(NamedTuple, Generic[P]):
    """A plan with tightened limits, and its simulations in drawn worlds."""

    plan: P  # the plan with the tightest limits that were solved
    before: Replays  # simulations of the first plan for the final draws
    after: Replays  # simulations of this plan for the same draws
    tightening: dict[Bound, float]  # distance from the given bound, in its unit
    rounds: int  # number of times that the limits were tightened
    failure: str  # why the last round could not tighten the limits as far as intended


def robust_plan(
    first: P,
    solve: Callable[[Tightening, P], P],
    replay: Callable[[Sequence[P], Sequence[Draw]], Sequence[Replays]],
    *,
    share: Annotated[float, Gt(0), Lt(1), Unit("1")] = 0.95,
    draws: Annotated[int, Ge(1), Le(100_000)] = 50,
    final_draws: Annotated[int, Ge(1), Le(100_000)] = 200,
    seed: Annotated[int, Ge(0)] = 0,
) -> RobustPlan[P]:
    """Tighten the limits of a plan until a required share of its simulations satisfies them.

    Every round simulates the newest plan for draws that it does not depend on. If the share is
    missed, the limits of the next plan are tightened by quantiles of these violations, chosen such
    that only half as many of these draws would fail as the share allows: few draws are an uncertain
    sample. If the next plan is not solved, the limits are tightened in smaller steps, as far as
    possible. The result, with simulations of the final draws, may miss the share.

    Parameters
    ----------
    first : plan
        Plan without tightening.
    solve : callable
        Function of the tightening and the previous plan that returns the next plan.
    replay : callable
        Function of plans and draws that returns the simulations of each plan.
    share : float
        Share of draws for which the plan must satisfy its limits. [1]
    draws : int
        Number of draws that determine the tightening of a round.
    final_draws : int
        Number of further draws, which determine the final share.
    seed : int
        Seed of all draws.
    """
    now, tightening, rounds, failure = first, dict[Bound, float](), 0, ""
    for stream in range(FINAL + 1, FINAL + 1 + MAX_ROUNDS):
        (replays,) = replay([now], _draws(seed, stream, draws))
        added = {} if replays.share >= share else added_tightening(replays, (1 + share) / 2)
        if not added:  # the share is reached, or the motions fail for another reason
            break
        done, step = 0.0, 1.0
        while done < 1 and step >= MIN_STEP:
            further = min(done + step, 1.0)
            try:
                now, done = solve(_sum(tightening, added, further), now), further
            except SlipfreeError as error:
                failure, step = str(error), step / 2
        failure = failure if done < 1 else ""
        if not done:
            break
        tightening, rounds = _sum(tightening, added, done), rounds + 1
    plans = [first, now] if rounds else [first]
    final = replay(plans, _draws(seed, FINAL, final_draws))
    return RobustPlan(now, final[0], final[-1], tightening, rounds, failure)


def _sum(first: Tightening, second: Tightening, factor: float) -> dict[Bound, float]:
    return {
        bound: first.get(bound, 0.0) + factor * second.get(bound, 0.0)
        for bound in {**first, **second}
    }


def added_tightening(replays: Replays, share: float) -> dict[Bound, float]:
    """Return the additional tightening of each violated bound, a quantile of its excess.

    The level of the quantile is the same for all bounds: the smallest level at which at least the
    fraction ``share`` of the simulations exceeds no bound by more than its quantile. Simulations
    with an infinite excess count as failed.
    """
    finite = [each.excess for each in replays.each if np.isfinite([*each.excess.values()]).all()]
    bounds = [*dict.fromkeys(b for excess in finite for b, size in excess.items() if size > 0)]
    if not bounds:
        return {}
    sizes = np.array([[excess.get(bound, -np.inf) for bound in bounds] for excess in finite])
    ranks = scipy.stats.rankdata(sizes, method="max", axis=0).astype(int)
    needed = min(math.ceil(share * replays.draws), len(finite))
    level = np.sort(ranks.max(axis=1))[needed - 1]
    quantiles = np.sort(sizes, axis=0)[level - 1].tolist()
    return {bound: size for bound, size in zip(bounds, quantiles, strict=True) if size > 0}


def tightened_task(task: PlanTask, tightening: Tightening) -> PlanTask:
    """Return a task with tightened limits, goal and way-points; equal bounds stay."""
    tight = {bound.name for bound in tightening}
    own = [limit for limit in model_limits(task) if limit_name(limit) in tight]
    conditions = tuple(
        each._replace(limits=tuple(_tightened(each.limits, tightening, role_of(each.fraction))))
        for each in task.conditions
    )
    limits = tuple(_tightened((*task.limits, *own), tightening, ""))
    return replace(task, limits=limits, conditions=conditions)


def _tightened(limits: Sequence[Limit], tightening: Tightening, role: str) -> Iterator[Limit]:
    """Yield limits whose bounds are tightened; those of one value stay."""
    for limit in limits:
        if limit.lower == limit.upper:
            yield limit
            continue
        lower, upper = (tightening.get(bound_of(limit, side, role), 0.0) for side in (LOWER, UPPER))
        limit = limit._replace(lower=limit.lower + lower, upper=limit.upper - upper)
        if limit.lower > limit.upper:
            raise ModelError(
                f"expected a range of {bound_of(limit, '', role)} at least as wide as the "
                f"tightening of its bounds, {number(limit.label, lower + upper)}, found "
                f"{number(limit.label, limit.upper - limit.lower + lower + upper)}; widen the range"
            )
        yield limit


def bound_of(limit: Limit, side: str, role: str) -> Bound:
    """Return a bound of a limit, goal or way-point by its name."""
    name = limit_name(limit)
    return Bound(f"{name} at the {role}" if role else name, side)


def replay_of(
    task: PlanTask,
    planned: tuple[Dae, PolynomialMotion],
    run: Trajectory,
    *,
    accuracy: float,
    goal: float | None,
) -> DisturbedRun:
    """Compare a simulation in a drawn world, by its task, with the bounds of plan and model.

    ``accuracy`` is the tolerated violation, ``goal`` the tolerance of conditions with equal bounds,
    which are ignored without it.
    """
    dae, plan = task.dae, planned[1]
    samples = run.t, *(dae.rows(record, run) for record in "xzu")
    limits = (*task.limits, *model_limits(task))
    excess = [*_excess(dae, limits, samples, "", accuracy, None)]
    if run.stop is not None:
        excess.append(_excess_at_stop(*planned, run))
        return DisturbedRun(largest(excess), np.nan)
    fractions = run.t / plan.duration
    periodic = periodic_states(dae, samples[1][:, 0], limits)
    states = [lambda fraction: plan.states(np.array([fraction]))[:, 0]]
    samples = (
        run.t,
        same_turn(samples[1], plan.states(np.minimum(fractions, 1.0)), periodic),
        *samples[2:],
    )
    for condition in near_conditions(dae, task.conditions, periodic, states):
        k = int(np.abs(fractions - condition.fraction).argmin())
        at, role = tuple(rows[..., k : k + 1] for rows in samples), role_of(condition.fraction)
        excess += _excess(dae, condition.limits, at, role, accuracy, goal)
    rows = dae.state_rows("x", "y")
    gaps = samples[1][rows, -1] - plan.states(np.ones(1))[rows, 0]
    return DisturbedRun(largest(excess), float(np.hypot(*gaps)))


def model_limits(task: PlanTask) -> Iterator[Limit]:
    """Yield the limits of the model, which end simulations, except those of the task."""
    names = {limit_name(limit) for limit in task.limits}
    yield from (limit for limit in task.dae.all_limits if limit_name(limit) not in names)


def _excess_at_stop(dae: Dae, plan: PolynomialMotion, run: Trajectory) -> tuple[Bound, float]:
    """Return the bound at which a simulation of a plan ended, and an estimate of the excess.

    The simulation does not show by how much the bound would have been violated. The excess is the
    distance of the plan from the bound at this time: tightening by it excludes the plan. It is
    infinite if the motion does not end at a limit of the model or the plan itself violates it.
    """
    for limit in dae.all_limits:
        if run.stop is not None and limit.label.full == run.stop.name:
            part = np.minimum(run.t[-1:] / plan.duration, 1.0)
            sample = run.t[-1:], plan.states(part), plan.algebraic(part), plan.inputs(part)
            value = float(limit_values(dae, (limit,), sample)[0, 0])
            side, away = min(
                (LOWER, value - limit.lower), (UPPER, limit.upper - value), key=itemgetter(1)
            )
            return bound_of(limit, side, ""), max(away, 0.0) or np.inf
    name = "" if run.stop is None else f" ({run.stop.name})"
    return Bound(f"motion ends early{name}"), np.inf


def _excess(
    dae: Dae,
    limits: tuple[Limit, ...],
    samples: Any,
    role: str,
    accuracy: float,
    tolerance: float | None,
) -> Iterator[tuple[Bound, float]]:
    """Yield every finite bound of limits, and its largest violation beyond `tolerated_excess`.

    ``samples`` are t, x, z and u of a simulated motion. ``role`` is that of the limits at a point,
    such as the goal; empty for limits of the whole motion. There, a given value is met within
    ``tolerance`` or not checked if it is None. Tightening cannot help a violated value, whose
    excess is therefore infinite.
    """
    values, tolerated = limit_values(dae, limits, samples), tolerated_excess(limits, accuracy)
    for limit, row, least in zip(limits, values, tolerated, strict=True):
        is_point = bool(role) and limit.lower == limit.upper
        if is_point and tolerance is None:
            continue
        allowed = max(least, tolerance or 0.0) if is_point else float(least)
        for side, beyond in ((LOWER, limit.lower - row), (UPPER, row - limit.upper)):
            size = float(beyond.max()) - allowed
            if np.isfinite(size):
                helps = size <= 0 or limit.lower < limit.upper
                yield bound_of(limit, side, role), size if helps else np.inf


def _draws(seed: int, stream: int, count: int) -> list[Draw]:
    return [(seed, stream, number) for number in range(count)]
