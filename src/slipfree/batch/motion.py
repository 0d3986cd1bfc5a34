"""Integrate many motions at once with fixed steps and exact contact.

Positions are integrated with the states by Ralston's third-order method, and corrected by one
Newton step at each stage. The prediction is so close that one step suffices: Newton steps from the
positions of the stage before would reduce the order to two. The integration restarts at each
sample, where the inputs may jump. The number of steps of an interval follows from the speed of the
lane alone, and every lane is computed by the same operations in any company, so that results do
not depend on the other lanes.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from slipfree.batch.evaluator import Evaluator
from slipfree.batch.graph import Graph
from slipfree.core.dae import LIMIT_ROUNDING
from slipfree.core.records import Array, Indices, Mask, leaves

ORDER, RELAXING_ORDER = 3, 1
MAX_CHANGE = 0.3  # largest correction of the positions by a Newton step [typical sizes]
MAX_ERROR = 1e-6  # of the rates: residual of linear equations, or square of the last Newton step
MAX_RATE_STEPS = 40  # further Newton steps of the rates, after jumps of the inputs
REFINEMENT, MAX_TRIES = 8, 3  # shorter steps where corrections are too large
CROSSING_TOLERANCE = 1e-6  # width of the final bracket of a crossing [s]
FIRST_STEP, LEAST_STEP, MAX_RELAXATIONS = 0.005, 1e-3, 300  # of the relaxation to rest [s]
STEP_GROWTH, STEP_LOSS, GROWING = 1.4, 0.5, 0.02  # after steps below and above GROWING [size]
MAX_RELAXATION = 0.1  # longest step of the relaxation [size]
AT_REST = 1e-11  # last step of the relaxation, of more than a second [size]
MAX_STEPS = 20_000  # in an interval; faster lanes end there
MAX_CANDIDATE_STEPS = 64  # in an interval of a candidate, at the first of several attempts
CANDIDATE_TRIES, CANDIDATE_REFINEMENT = 5, 2
MAX_BISECTIONS = 90
NEAR = 0.05  # clearance at a limit below which a second contact may be earlier [size]
PARTS = 16  # of the time before such a limit, at whose ends clearances are computed
MIN_SHARE = 0.02  # of a bracket on either side of a secant
SETTLED = 1e-3  # correction of the positions beyond a limit [typical sizes]
POSITION_STEPS = 12  # most Newton steps of the positions at samples
POSITION_CHANGE = 1e-6  # change that needs another step: the error is its square [typical sizes]
FORCE_STEPS = 4  # Newton steps of the forces at a start, and repeated ones of a sample
FORCE_CHANGE = 1e-12  # last one at a start [sum of the forces]
RATES, CHANGE, ERROR, FORCES, DOUBT, DISTANCES = 2, 3, 4, 6, 7, 8  # parts of the graph "checked"
COMPLETE, UNSOLVED, INVALID_START, LOST, TOO_FAST = -1, -2, -3, -4, -5  # ends without a limit


class Motions(NamedTuple):
    """Motions of n lanes over m samples."""

    # states at the samples in local coordinates, NaN after the end of a lane, shape (m, n_rows, n)
    samples: Array
    end: Array  # time of the end, shape (n,) [s]
    # index of the limit or, after the limits, of the check that ended the lane; `COMPLETE`, or
    # `UNSOLVED` if corrections of the positions stay too large in short steps, or `TOO_FAST`;
    # one for each of the n lanes
    reason: Array
    # states just beyond the limit; the states at the end for other lanes, shape (n_rows, n)
    beyond: Array
    error: Array  # estimate of the error of x and y at the last sample of a lane, shape (n,) [m]
    # distances to the bounds of the limits at the first sample, shape (n_bounds, n)
    distances: Array
    steps: Indices  # numbers of steps, shape (n,)


def integrate_lanes(
    evaluate: Evaluator,
    states: Array,
    inputs: Array,
    t: Array,
    step: float,
    *,
    certify: bool = True,
) -> Motions:
    """Return the motions of lanes from states with consistent positions.

    The states have the shape (n_rows, n), the inputs (n_u, m - 1, n). ``step`` is the largest
    length of a step along the path [m]; with ``certify``, checks of samples are evaluated.
    """
    with np.errstate(all="ignore"):
        motions = _integrate(evaluate, states, inputs, t, step, certify=certify)
        for k in range(1, MAX_TRIES):
            # where half the step fails, nothing is known of the error
            again = np.isnan(motions.error) & (motions.reason != INVALID_START)
            again |= motions.reason == LOST
            if not again.any():
                break
            chosen = states[:, again], inputs[..., again]
            finer = _integrate(evaluate, *chosen, t, step / REFINEMENT**k, certify=certify)
            finer.reason[finer.reason == TOO_FAST] = LOST  # only for such short steps
            for values, new in zip(motions, finer, strict=True):
                values[..., again] = new
    motions.reason[motions.reason == LOST] = UNSOLVED
    return motions


class Candidates(NamedTuple):
    """Motions of n lanes over m samples, of which only the ends are named."""

    # integrated rows of the states at the samples, shape (m, n_integrated, n), NaN after the end
    samples: Array
    # time of the first step beyond a limit, or of the last sample before unsolved steps [s]
    end: Array
    reason: Array  # index of the limit that ended the lane; `COMPLETE` or `UNSOLVED`, shape (n,)


def candidate_lanes(
    evaluate: Evaluator, states: Array, inputs: Array, t: Array, step: float
) -> Candidates:
    """Return motions as `integrate_lanes`, for many candidates of which few are kept.

    Errors are not estimated, checks of samples not evaluated, and the time of an end is that of the
    first step beyond a limit. Limits are evaluated after each step.
    """
    graphs = evaluate.graphs
    samples = np.full((t.size, graphs.rows.q.stop, states.shape[1]), np.nan)
    bounds = MAX_CHANGE, MAX_ERROR, LIMIT_ROUNDING
    numbers = step, MAX_CANDIDATE_STEPS, *bounds, FORCE_STEPS, CANDIDATE_TRIES, CANDIDATE_REFINEMENT
    with np.errstate(all="ignore"):
        ends = evaluate.drive(states, inputs, t, numbers, samples)
        if ends is None:
            ends = _drive(evaluate, states.copy(), inputs, t, step, samples)
    codes = np.array([*graphs.bounds, UNSOLVED, COMPLETE])  # the last two have the indices -2, -1
    return Candidates(samples, ends[0], codes[ends[1].astype(int)])


def _drive(
    evaluate: Evaluator, states: Array, inputs: Array, t: Array, step: float, samples: Array
) -> Array:
    """Fill in the samples of candidates; return times and codes of their ends, as compiled code."""
    rows = evaluate.graphs.rows
    move = advance if evaluate.graphs.dae.lag is None else advance_relaxing
    ends = np.array([[t[-1]], [COMPLETE]]) * np.ones(states.shape[1])
    rates, speed = np.empty((rows.q.stop, states.shape[1])), np.zeros(states.shape[1])

    def check(lanes: Indices, some: Array) -> tuple[Array, Array, Mask, Mask]:
        """Return rates, speeds, and which lanes are solved inside limits and which not solved."""
        slope, solved, fast, distances = _checked(evaluate, some)
        beyond = solved & ~(margins(distances) >= 0)
        ends[0, lanes[beyond]] = some[rows.t][0, beyond]
        ends[1, lanes[beyond]] = smallest(distances)[beyond]
        return slope, fast, solved & ~beyond, ~solved

    for k, now in enumerate(t):  # from sample k - 1 to sample k
        span = now - t[k - 1] if k else 0.0
        number = np.clip(np.ceil(speed * span / step - 1e-9), 1, MAX_CANDIDATE_STEPS)
        first, slopes, left = states.copy(), rates.copy(), np.flatnonzero(ends[1] == COMPLETE)
        for _ in range(CANDIDATE_TRIES if k else 1):
            going, some, slope = left, first[:, left], slopes[:, left]
            arrived, lost = list[tuple[Indices, Array]](), list[Indices]()
            for taken in range(int(number[left].max(initial=0)) if k else 0):
                if taken:
                    slope, _, kept, bad = check(going, some)
                    lost.append(going[bad])
                    going, some, slope = (_of(kept, each) for each in (going, some, slope))
                some, good = move(evaluate, some, slope, span / number[going], np.ones_like(going))
                lost.append(going[~good])
                there, more = (
                    good & (number[going] == taken + 1),
                    good & (number[going] > taken + 1),
                )
                arrived.append((going[there], some[:, there]))
                going, some, slope = (_of(more, each) for each in (going, some, slope))
            arrived = arrived or [(going, some)]
            lanes, some = (np.concatenate(each, axis=-1) for each in zip(*arrived, strict=True))
            some[rows.t] = now
            if k < t.size - 1:
                some[rows.u] = inputs[:, k, lanes]
            slope, fast, kept, bad = check(lanes, some)
            states[:, lanes[kept]], rates[:, lanes[kept]] = some[:, kept], slope[:, kept]
            speed[lanes[kept]] = fast[kept]
            left = np.concatenate([*lost, lanes[bad]])
            number[left] *= CANDIDATE_REFINEMENT
            if not left.size:
                break
        ends[0, left], ends[1, left] = t[max(k - 1, 0)], UNSOLVED
        alive = ends[1] == COMPLETE
        samples[k][:, alive] = states[: rows.q.stop, alive]
    return ends


def _integrate(
    evaluate: Evaluator, states: Array, inputs: Array, t: Array, step: float, *, certify: bool
) -> Motions:
    """Return the motions of lanes, with errors estimated from half the step."""
    names = [label.full for label in leaves(evaluate.graphs.dae.labels.x)]
    place = [names.index("x"), names.index("y")]
    run = _Run(evaluate, states, inputs, t, step, certify=certify)
    run.run()
    finer = _Run(evaluate, states, inputs, t, step, place)
    finer.run(counts=2 * run.counts)
    reached = np.maximum(np.isfinite(run.samples[:, 0]).sum(axis=0) - 1, 0)
    apart = (run.samples[:, place] - finer.samples)[reached, :, np.arange(reached.size)]
    order = ORDER if evaluate.graphs.dae.lag is None else RELAXING_ORDER
    error = np.hypot(*apart.T) / (1 - 0.5**order)
    steps = run.counts.sum(axis=0)
    return Motions(run.samples, run.end, run.reason, run.beyond, error, run.distances, steps)


class _Step(NamedTuple):
    """States, rates and lengths [s] of the last steps of lanes."""

    states: Array
    rates: Array
    h: Array

    def of(self, lanes: Mask) -> _Step:
        return _Step(*(_of(lanes, each) for each in self))


class _Interval(NamedTuple):
    """States and rates of lanes at the last sample, and numbers of steps to the next one.

    The columns are those of all lanes; columns of lanes that ended before are not defined.
    """

    states: Array
    rates: Array
    number: Indices

    def until(self, lanes: Indices, time: Array, row: slice) -> tuple[_Step, Indices]:
        """Return the first steps of lanes on their way to a time, and their numbers."""
        states, number = self.states[:, lanes], self.number[lanes]
        return _Step(states, self.rates[:, lanes], (time - states[row][0]) / number), number


class _Run:
    """Motions of lanes while they are integrated; ``counts`` are numbers of steps, (m - 1, n).

    ``kept`` are the rows of the states that the samples have, by default all.
    """

    def __init__(
        self,
        evaluate: Evaluator,
        states: Array,
        inputs: Array,
        t: Array,
        step: float,
        kept: list[int] | None = None,
        *,
        certify: bool = True,
    ) -> None:
        count = states.shape[1]
        self.evaluate, self.rows, self.step = evaluate, evaluate.graphs.rows, step
        self.first, self.inputs, self.t = states, inputs, t
        self.interval: _Interval | None = None
        self.near = list[tuple[Indices, _Step, Indices]]()  # lanes of `_search_contacts`
        self.advance = advance if evaluate.graphs.dae.lag is None else advance_relaxing
        self.counts = np.zeros((t.size - 1, count), dtype=int)
        self.tries = np.ones(count, dtype=int)  # to reach the next sample
        self.certify = certify
        self.kept = slice(None) if kept is None else kept
        self.samples = np.full((t.size, *states[self.kept].shape), np.nan)
        self.end, self.reason = np.full(count, t[-1]), np.full(count, COMPLETE)
        self.beyond = states.copy()

    def run(self, *, counts: Array | None = None) -> None:
        """Integrate; with given numbers of steps, limits are not evaluated."""
        lanes, states, limited = np.arange(self.end.size), self.first.copy(), counts is None
        before: _Step | None = None
        if limited:
            states[self.rows.u], states[self.rows.t] = self.inputs[:, 0], self.t[0]
            self.distances = solve_forces(self.evaluate, states)
        for k, now in enumerate(self.t):
            if limited:
                lanes, states, rates, speed = self._arrive(lanes, states, before, k)
            else:
                self._enter(states, lanes, k)
                rates, _, speed = derivatives(self.evaluate, states)
            self.samples[k][:, lanes] = states[self.kept]
            if k == self.t.size - 1:
                break
            if counts is not None:
                on_way = counts[k, lanes] > 0  # others have ended
                lanes, states, rates = (_of(on_way, each) for each in (lanes, states, rates))
            if not lanes.size:
                break
            span = self.t[k + 1] - now
            needed = speed * span / self.step
            if limited and (fast := ~(needed <= MAX_STEPS)).any():
                self.reason[lanes[fast]] = TOO_FAST
                self._close(_of(fast, lanes), _of(fast, states), _of(fast, states))
                lanes, states, rates, needed = (
                    _of(~fast, each) for each in (lanes, states, rates, needed)
                )
                if not lanes.size:
                    break
            number = _numbers(needed) if counts is None else counts[k, lanes]
            if np.ptp(number):  # lanes of a vector take as many steps as the slowest one
                order = np.argsort(number, kind="stable")
                lanes, number, states, rates = (
                    lanes[order],
                    number[order],
                    states[:, order],
                    rates[:, order],
                )
            step = _Step(states, rates, span / number)
            if limited:
                self.tries[lanes] = 1
                lanes, states, before = self._advance_to_sample(lanes, step, number, k)
            else:
                states, solved = self.advance(self.evaluate, *step, number)
                states[:, ~solved] = np.nan  # such a lane needs no more Newton steps
        self._search_contacts()

    def _enter(self, states: Array, lanes: Indices, k: int) -> None:
        states[self.rows.t] = self.t[k]
        if k < self.t.size - 1:
            states[self.rows.u] = self.inputs[:, k, lanes]

    def _arrive(
        self, lanes: Indices, states: Array, before: _Step | None, k: int
    ) -> tuple[Indices, Array, Array, Array]:
        """End lanes at a sample; return the others, their states, rates and speeds.

        Lanes without rates there come once more from the sample before, in shorter steps.
        """
        self._enter(states, lanes, k)
        rates, good, speed, margin = self._checked(states)
        while before is not None and self.interval is not None:
            again = ~good & self._may_repeat(lanes)
            if not again.any():
                break
            some = _of(again, lanes)
            step, number = self.interval.until(some, np.full(some.size, self.t[k]), self.rows.t)
            self.tries[some] += 1
            step, number = step._replace(h=step.h / REFINEMENT), number * REFINEMENT
            there, came, last = self._advance_to_sample(some, step, number, k - 1)
            self._enter(came, there, k)
            new = there, came, *last, *self._checked(came)
            old = (_of(~again, v) for v in (lanes, states, *before, rates, good, speed, margin))
            lanes, states, *steps, rates, good, speed, margin = (
                np.concatenate(pair, axis=-1) for pair in zip(old, new, strict=True)
            )
            before = _Step(*steps)
        kept = good & (margin >= 0)
        self._end(lanes, states, before, good, kept)
        lanes, states, rates, speed = (_of(kept, each) for each in (lanes, states, rates, speed))
        if not self.certify:
            return lanes, states, rates, speed
        clear = clearances(self.evaluate, states).min(axis=0) >= 0
        self._end_at_checks(_of(~clear, lanes), _of(~clear, states))
        return _of(clear, lanes), _of(clear, states), _of(clear, rates), _of(clear, speed)

    def _begin(self, lanes: Indices, step: _Step, number: Indices) -> None:
        if self.interval is None:
            shapes = ((*each.shape[:-1], self.end.size) for each in (step.states, step.rates))
            first, rates = (np.empty(shape) for shape in shapes)
            self.interval = _Interval(first, rates, np.ones(self.end.size, dtype=int))
        for values, new in zip(self.interval, (step.states, step.rates, number), strict=True):
            values[..., lanes] = new

    def _advance_to_sample(
        self, lanes: Indices, step: _Step, number: Indices, interval: int
    ) -> tuple[Indices, Array, _Step]:
        """Return the lanes that reach the next sample, their states and last steps.

        Lanes whose corrections are too large start again from the last sample in shorter steps.
        """
        arrived = list[tuple[Any, ...]]()
        while lanes.size:
            self.counts[interval, lanes] = number
            self._begin(lanes, step, number)
            again = self._attempt(lanes, step, number, arrived)
            lanes, number, step = _of(again, lanes), _of(again, number), step.of(again)
            self.tries[lanes] += 1
            step, number = step._replace(h=step.h / REFINEMENT), number * REFINEMENT
        lanes, states, *last = (
            rows[0] if len(rows) == 1 else np.concatenate(rows, axis=-1)
            for rows in zip(*arrived, strict=True)
        )
        return lanes, states, _Step(*last)

    def _attempt(
        self, lanes: Indices, step: _Step, number: Indices, arrived: list[tuple[Any, ...]]
    ) -> Mask:
        """Append lanes that reach the sample to ``arrived``; return which should start again."""
        every, failed = lanes, list[Indices]()
        for k in range(1, number.max() + 1):
            states, solved = self.advance(self.evaluate, *step, np.ones(lanes.size, dtype=int))
            failed.append(self._end(lanes, states, step, solved, solved))
            here, on_way = solved & (number == k), solved & (number > k)
            arrived.append((_of(here, lanes), _of(here, states), *step.of(here)))
            if not on_way.any():
                break
            lanes, states, number = (_of(on_way, each) for each in (lanes, states, number))
            step = step.of(on_way)
            rates, good, _, margin = self._checked(states)
            kept = good & (margin >= 0)
            failed.append(self._end(lanes, states, step, good, kept))
            lanes, states, number = (_of(kept, each) for each in (lanes, states, number))
            step = _Step(states, _of(kept, rates), _of(kept, step.h))
        return np.isin(every, np.concatenate(failed))

    def _may_repeat(self, lanes: Indices) -> Mask:
        """Return which lanes may start again from the last sample, in shorter steps."""
        if self.interval is None:
            return np.zeros(lanes.size, dtype=bool)
        is_short = self.interval.number[lanes] * REFINEMENT <= MAX_STEPS
        return np.asarray(is_short & (self.tries[lanes] < MAX_TRIES))

    def _leave_unsolved(self, lanes: Indices, states: Array) -> None:
        self.reason[lanes] = UNSOLVED
        self._close(lanes, states, states)

    def _checked(self, states: Array) -> tuple[Array, Mask, Array, Array]:
        """Return the results of `derivatives`, and the least distances to the limits."""
        rates, good, speed, distances = _checked(self.evaluate, states)
        return rates, good, speed, margins(distances)

    def _end(
        self, lanes: Indices, states: Array, before: _Step | None, good: Mask, kept: Mask
    ) -> Indices:
        """End lanes beyond a limit, located in the last step, and lanes that are not solved.

        Of the latter, those are returned instead that may start again in shorter steps.
        """
        limited = good & ~kept
        if before is None:
            self.reason[lanes[~good]], self.reason[lanes[limited]] = UNSOLVED, INVALID_START
            self._close(_of(~kept, lanes), _of(~kept, states), _of(~kept, states))
            return lanes[:0]
        again = ~good & self._may_repeat(lanes)
        unsolved = ~good & ~again
        self._leave_unsolved(_of(unsolved, lanes), before.of(unsolved).states)
        if limited.any():
            which = _of(limited, lanes)
            graph, bounds = self.evaluate.graphs.checked, np.array(self.evaluate.graphs.bounds)
            one = np.ones(which.size, dtype=int)
            low, high, lost = self._locate(
                before.of(limited), one, _of(limited, states), lambda _, margin: margin
            )
            values = self.evaluate(graph, high)
            distances, change = values[graph.parts[DISTANCES]], values[graph.parts[CHANGE]][0]
            # a contact that jumps has no limit to name
            lost |= ~(change < SETTLED) | ~(margins(distances) < 0)
            self.reason[which] = np.where(lost, LOST, bounds[smallest(distances)])
            self._close(which, low, high)
            if self.certify and self.interval is not None:
                near = NEAR * self.evaluate.graphs.dae.size
                close = clearances(self.evaluate, low).min(axis=0) < near
                which, low = _of(close, which), _of(close, low)
                first = self.interval.until(which, low[self.rows.t][0], self.rows.t)
                self.near.append((which, *first))
        return lanes[again]

    def _search_contacts(self) -> None:
        """End lanes at a second contact that came and went between the last sample and a limit."""
        if not self.near:
            return
        ended, steps, numbers = zip(*self.near, strict=True)
        lanes, number = np.concatenate(ended), np.concatenate(numbers)
        step = _Step(*(np.concatenate(rows, axis=-1) for rows in zip(*steps, strict=True)))
        for part in range(1, PARTS + 1):
            at, _ = self.advance(self.evaluate, *step._replace(h=step.h * part / PARTS), number)
            bad = ~(clearances(self.evaluate, at).min(axis=0) >= 0)
            self._end_at_checks(_of(bad, lanes), _of(bad, at), step.of(bad), _of(bad, number))
            lanes, number, step = _of(~bad, lanes), _of(~bad, number), step.of(~bad)
            if not lanes.size:
                break

    def _end_at_checks(
        self, lanes: Indices, states: Array, step: _Step | None = None, number: Any = None
    ) -> None:
        """End lanes that fail a check, which is located between the last sample and the states."""
        if not lanes.size:
            return
        if self.interval is None:
            self.reason[lanes] = INVALID_START
            self._close(lanes, states, states)
            return
        if step is None:
            step, number = self.interval.until(lanes, states[self.rows.t][0], self.rows.t)
        failed = smallest(clearances(self.evaluate, states))
        for check in np.unique(failed):
            chosen = failed == check
            margin = partial(_clearance, self.evaluate, int(check))
            low, high, lost = self._locate(
                step.of(chosen), number[chosen], _of(chosen, states), margin
            )
            which, reason = lanes[chosen], check + len(self.evaluate.graphs.dae.limits)
            self.reason[which] = np.where(lost, LOST, reason)
            self._close(which, low, high)
            earlier = ~(clearances(self.evaluate, low).min(axis=0) >= 0)  # of another wheel
            self.reason[which[earlier]] = LOST

    def _close(self, lanes: Indices, last: Array, beyond: Array) -> None:
        self.end[lanes] = last[self.rows.t]
        self.beyond[:, lanes] = beyond

    def _locate(
        self, step: _Step, count: Indices, at: Array, margin: Callable[[Array, Array], Array]
    ) -> tuple[Array, Array, Mask]:
        """Return states just before and beyond the zero of a margin within ``count`` steps.

        The third result is true for lanes that are not solved beyond it.

        ``margin(states, distance)`` is negative beyond it; ``at`` are the states at the end. There
        the inputs of the next interval may apply: if the margin is positive with those of the
        steps, the motion ends there.
        """
        low, high = np.zeros(step.h.size), np.ones(step.h.size)
        at_low, at_high = np.full((2, step.h.size), np.nan)
        inside, beyond = step.states.copy(), at.copy()
        for k in range(MAX_BISECTIONS):
            wide = (high - low) * step.h * count > CROSSING_TOLERANCE
            if not wide.any():
                break
            secant = np.clip(at_low / (at_low - at_high), MIN_SHARE, 1 - MIN_SHARE)
            share = np.where(np.isnan(secant) | (k % 3 == 0), 0.5, secant)
            share = (low + (high - low) * (share if k else 1.0))[wide]
            part = step.of(wide)
            part = part._replace(h=part.h * share)
            states, solved = self.advance(self.evaluate, *part, count[wide])
            _, good, _, distance = self._checked(states)
            value = np.where(solved & good, margin(states, distance), np.nan)
            fine = value >= 0  # not for NaN
            shares = np.full(high.shape, 0.0)
            shares[wide] = share
            values = np.full(high.shape, np.nan)
            values[wide] = value
            good = np.zeros(high.shape, dtype=bool)
            good[wide] = fine
            low, at_low = np.where(good, shares, low), np.where(good, values, at_low)
            bad = wide & ~good
            high, at_high = np.where(bad, shares, high), np.where(bad, values, at_high)
            inside[:, good] = states[:, fine]
            beyond[:, bad] = states[:, ~fine] if k else beyond[:, bad]
        return inside, beyond, np.isnan(at_high) & (low < 1)


def _numbers(least: Array) -> Indices:
    """Return numbers of steps, rounded up to 1, 2, 3, 4, 6, 8, 12, ...

    Few different numbers occur then, and lanes with the same one are computed together.
    """
    power = 2.0 ** np.ceil(np.log2(np.maximum(np.ceil(least - 1e-9), 1)))
    power *= np.where((least <= 0.75 * power) & (power > 2), 0.75, 1.0)
    return np.asarray(power, dtype=int)


def smallest(values: Array) -> Indices:
    """Return the row of the smallest value of each column, or of one that is not a number."""
    return np.asarray(np.where(np.isnan(values), -np.inf, values).argmin(axis=0))


def _of(lanes: Mask, array: Any) -> Any:
    return array if lanes.all() else np.compress(lanes, array, axis=-1)


def solve_forces(evaluate: Evaluator, states: Array) -> Array:
    """Return the distances to the bounds of limits; solve for the forces in the states.

    The forces of a lane that is solved do not change, whatever the others need.
    """
    graph, rows = evaluate.graphs.checked, evaluate.graphs.rows
    distances = np.empty((0, 0))
    lanes, part = np.arange(states.shape[1]), states
    for k in range(FORCE_STEPS):
        values = _iterated(evaluate, graph, part)
        _derivatives(evaluate, graph, values, part)
        change = np.abs(values[graph.parts[FORCES]] - part[rows.f]).sum(axis=0)
        part[rows.f] = values[graph.parts[FORCES]]
        found = values[graph.parts[DISTANCES]]
        if k:
            states[:, lanes], distances[:, lanes] = part, found
        else:
            distances = found.copy()
        moving = ~(change <= FORCE_CHANGE * np.abs(part[rows.f]).sum(axis=0))
        if not moving.any():
            break
        lanes, part = lanes[moving], part[:, moving]
    return distances


def _checked(evaluate: Evaluator, states: Array) -> tuple[Array, Mask, Array, Array]:
    """Return the results of `derivatives`, and the distances to the bounds of limits."""
    graph, forces = evaluate.graphs.checked, evaluate.graphs.rows.f
    values = _iterated(evaluate, graph, states)
    result = _derivatives(evaluate, graph, values, states)
    for _ in range(FORCE_STEPS):
        states[forces] = values[graph.parts[FORCES]]
        rough = ~(values[graph.parts[DOUBT]][0] <= 0)
        if not rough.any():
            break
        values[:, rough] = evaluate(graph, _of(rough, states))
    return *result, values[graph.parts[DISTANCES]]


def margins(distances: Array) -> Array:
    """Return the least distances to limits, of which rounding is no violation; NaN with NaN."""
    return np.asarray(distances.min(axis=0, initial=np.inf) + LIMIT_ROUNDING)


def clearances(evaluate: Evaluator, states: Array, only: int | None = None) -> Array:
    """Return the margins of the checks, or of one, (n_checks, n); infinite without checks.

    The positions in the states are corrected to rounding first: a wheel that is a micrometre in the
    ground would touch it all around its contact.
    """
    checks, graph = evaluate.graphs.checks, evaluate.graphs.placing
    if not checks or not states.shape[1]:
        return np.full((1, states.shape[1]), np.inf)
    place, p = evaluate.graphs.place, evaluate.graphs.rows.p
    moving = np.ones(states.shape[1], dtype=bool)
    for _ in range(POSITION_STEPS):
        values = evaluate(place, _of(moving, states))
        states[p, moving] = values[place.parts[0]]
        moving[moving] = values[place.parts[1]][0] > POSITION_CHANGE
        if not moving.any():
            break
    placed, chosen = evaluate(graph, states), range(len(checks)) if only is None else [only]
    return np.stack([checks[k].margin_at(placed[graph.parts[k]]) for k in chosen])


def _clearance(evaluate: Evaluator, check: int, states: Array, _: Array) -> Array:
    return np.asarray(clearances(evaluate, states, check)[0])


def derivatives(evaluate: Evaluator, states: Array) -> tuple[Array, Mask, Array]:
    """Return rates of the integrated rows, which lanes are solved, and speeds [m/s].

    Positions and rates in the states are corrected by one Newton step.
    """
    graph = evaluate.graphs.motion
    values = _iterated(evaluate, graph, states)
    return _derivatives(evaluate, graph, values, states)


def _iterated(evaluate: Evaluator, graph: Graph, states: Array) -> Array:
    """Return the results of a graph after as many Newton steps of the rates as a lane needs.

    A law with a continuation parameter is solved at all its values where the steps do not converge.
    """
    values = evaluate(graph, states)
    rows, stages = evaluate.graphs.rows.stage, evaluate.graphs.stages
    rough = _repeat(evaluate, graph, states, values)
    if not stages or not rough.any():
        return values
    some = states[:, rough]
    for stage in stages:
        some[rows] = stage
        more = evaluate(graph, some)
        _repeat(evaluate, graph, some, more)
        some[evaluate.graphs.rows.w] = more[graph.parts[RATES]]
    values[:, rough] = more
    return values


def _repeat(evaluate: Evaluator, graph: Graph, states: Array, values: Array) -> Mask:
    """Repeat Newton steps of the rates in ``values``; return which lanes are not solved."""
    w, error = graph.parts[RATES], graph.parts[ERROR]
    for _ in range(MAX_RATE_STEPS):
        rough = np.asarray(values[error][0] > MAX_ERROR)
        if not rough.any():
            break
        some = _of(rough, states)
        some = some.copy() if some is states else some
        some[evaluate.graphs.rows.w] = values[w][:, rough]
        values[:, rough] = evaluate(graph, some)
    return np.asarray(~(values[error][0] <= MAX_ERROR))


def _derivatives(
    evaluate: Evaluator, graph: Graph, values: Array, states: Array
) -> tuple[Array, Mask, Array]:
    rows = evaluate.graphs.rows
    rates, p, w, change, error, speed = graph.parts[:6]
    states[rows.p], states[rows.w] = values[p], values[w]
    good = (values[change][0] < MAX_CHANGE) & (values[error][0] <= MAX_ERROR)
    return values[rates], good, values[speed][0]


def advance(
    evaluate: Evaluator, states: Array, rates: Array, h: Array, count: Indices
) -> tuple[Array, Mask]:
    """Return the states after steps of Ralston's third-order method, and which are solved.

    A. Ralston, Runge-Kutta methods with minimum error bounds, Math. Comp. 16 (1962), eq. (4.1). The
    positions of the result are predicted, not yet corrected. The compiled code does the same.
    ``count`` are the numbers of steps of the lanes.
    """
    compiled = evaluate.advance(states, rates, h, count, (MAX_CHANGE, MAX_ERROR))
    if compiled is not None:
        return compiled
    return _repeated(partial(_ralston_step, evaluate), evaluate, states, rates, h, count)


def advance_relaxing(
    evaluate: Evaluator, states: Array, rates: Array, h: Array, count: Indices
) -> tuple[Array, Mask]:
    """Return the states after steps of a model whose last states relax, and which are solved.

    The relaxing states take two linearly implicit half steps, whose damping is complete for
    infinitely stiff contacts; the others take a step of the midpoint rule.
    """
    return _repeated(partial(_relaxing_step, evaluate), evaluate, states, rates, h, count)


def _repeated(
    step: Callable[[Array, Array, Array], tuple[Array, Mask]],
    evaluate: Evaluator,
    states: Array,
    rates: Array,
    h: Array,
    count: Indices,
) -> tuple[Array, Mask]:
    """Return the states after one step, or as many as each lane needs, and which are solved."""
    states, solved = step(states, rates, h)
    for k in range(1, count.max(initial=1)):
        on_way = count > k
        some = states[:, on_way]
        rates, good, _ = derivatives(evaluate, some)
        states[:, on_way], also_good = step(some, rates, h[on_way])
        solved[on_way] &= good & also_good
        states[:, ~solved] = np.nan  # such a lane needs no more Newton steps
    return states, solved


def _ralston_step(evaluate: Evaluator, states: Array, rates: Array, h: Array) -> tuple[Array, Mask]:
    rows = evaluate.graphs.rows
    moving = slice(0, rows.q.stop)
    start, stage = states[moving], states.copy()
    stage[moving] = start + (0.5 * h) * rates
    stage[rows.t] += 0.5 * h
    second, solved, _ = derivatives(evaluate, stage)
    stage[moving] = start + (0.75 * h) * second
    stage[rows.t] = states[rows.t] + 0.75 * h
    third, good, _ = derivatives(evaluate, stage)
    stage[moving] = start + (h / 9) * (2 * rates + 3 * second + 4 * third)
    stage[rows.t] = states[rows.t] + h
    return stage, solved & good


def _relaxing_step(
    evaluate: Evaluator,
    states: Array,
    rates: Array,  # noqa: ARG001 - of another lag
    h: Array,
) -> tuple[Array, Mask]:
    dae, rows = evaluate.graphs.dae, evaluate.graphs.rows
    moving = slice(0, rows.q.stop)
    relaxing = slice(rows.x.stop - dae.rest.numel(), rows.x.stop)
    half, stage = 0.5 * h, states.copy()
    stage[rows.lag] = half
    first, solved, _ = derivatives(evaluate, stage)
    start = stage[moving].copy()
    stage[moving] = start + half * first
    stage[rows.t] += half
    middle = stage[relaxing].copy()
    second, good, _ = derivatives(evaluate, stage)
    stage[moving] = start + h * second
    stage[relaxing] = middle + half * second[relaxing]
    stage[rows.lag] = 0.0
    stage[rows.t] = states[rows.t] + h
    return stage, solved & good


def relax(evaluate: Evaluator, states: Array) -> Mask:
    """Relax states at rest to their equilibrium; return which have reached it.

    Implicit steps follow the relaxation; they grow while they are small, and end as Newton's
    method.
    """
    dae, rows = evaluate.graphs.dae, evaluate.graphs.rows
    relaxing = slice(rows.x.stop - dae.rest.numel(), rows.x.stop)
    size = dae.sizes.x[relaxing, None]
    at_rest = np.zeros(states.shape[1], dtype=bool)
    states[rows.u] = 0.0
    lanes, part, h = np.arange(at_rest.size), states.copy(), np.full(at_rest.size, FIRST_STEP)
    for _ in range(MAX_RELAXATIONS):
        part[rows.lag] = h
        rates, good, _ = derivatives(evaluate, part)
        step = h * rates[relaxing]
        length = np.abs(step / size).max(axis=0, initial=1e-300)
        # a wheel far from its contact takes steps of bounded length
        part[relaxing] += step * np.minimum(1.0, MAX_RELAXATION / length)
        done = (length < AT_REST) & (h > 1.0) & good
        # steps that always grow miss many poses on rough ground
        h = np.where(length > GROWING, np.maximum(STEP_LOSS * h, LEAST_STEP), STEP_GROWTH * h)
        if done.any():
            states[:, lanes[done]], at_rest[lanes[done]] = part[:, done], True
            lanes, part, h = lanes[~done], _of(~done, part), h[~done]
            if not lanes.size:
                break
    states[:, lanes] = part
    states[rows.lag] = 0.0
    return at_rest
