"""Integrate many motions at once with fixed steps and exact contact.

Positions are integrated with the states by Ralston's third-order method, and corrected by one
Newton step at each stage. The prediction is so close that one step suffices: Newton steps from the
positions of the stage before would reduce the order to two. The integration restarts at each
sample, where the inputs may jump. The number of steps of an interval follows from the speed of the
lane alone, and every lane is computed by the same operations in any company, so that results do
not depend on the other lanes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from slipfree.batch.evaluator import Evaluator
from slipfree.batch.graph import Graph
from slipfree.core.dae import LIMIT_ROUNDING
from slipfree.core.records import Array, Indices, Mask

ORDER, RELAXING_ORDER = 3, 1
# errors over the differences from half the step: of third order; of relaxing states the geometric
# mean of first and second order, between which the stiffness decides
HALVED, RELAXING_HALVED = 8 / 7, (2 * 4 / 3) ** 0.5
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
# Relaxing states at samples, and rates that depend on them, have the error of the last step: steps
# of half the length follow each other, down to a share of the relaxation time. They shrink with
# steps below `GRADED_STEP` [size], or their error would remain however short the other steps are.
GRADED, LAST_SHARE, GRADED_STEP = 6, 1 / 8, 0.015
NEAR = 0.05  # clearance at a limit below which a second contact may be earlier [size]
# parts of the time before such a limit or an unsolved step, at whose ends clearances are computed;
# a contact often vanishes soon after a second one
PARTS = (*np.arange(8) / 8, *1 - 0.5 ** np.arange(4, 12), 1.0)
MIN_SHARE = 0.02  # of a bracket on either side of a secant
SETTLED = 1e-3  # correction of the positions beyond a limit [typical sizes]
POSITION_STEPS = 12  # most Newton steps of the positions at samples
POSITION_CHANGE = 1e-6  # change that needs another step: the error is its square [typical sizes]
FORCE_STEPS = 4  # Newton steps of the forces at a start, and repeated ones of a sample
FORCE_CHANGE = 1e-6  # last one at a start, after which the error is 1e-12 [sum of the forces]
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
    # states just beyond the limit; of no meaning for other lanes, shape (n_rows, n)
    beyond: Array
    errors: Array  # estimated errors of the states ``x`` at the last sample, shape (n_x, n)
    # distances to the bounds of the limits at starts with `INVALID_START`, shape (n_bounds, n)
    distances: Array
    steps: Indices  # numbers of equal steps, shape (n,)


class Candidates(NamedTuple):
    """Motions of n lanes over m samples, of which only the ends are named."""

    # integrated rows of the states at the samples, shape (m, n_integrated, n), NaN after the end
    samples: Array
    # time of the first step beyond a limit, or of the last sample before unsolved steps [s]
    end: Array
    reason: Array  # index of the limit that ended the lane; `COMPLETE` or `UNSOLVED`, shape (n,)


class _Step(NamedTuple):
    """States at the begin and lengths [s] of the last steps of lanes."""

    states: Array
    h: Array

    def of(self, lanes: Mask) -> _Step:
        return _Step(*(_of(lanes, each) for each in self))


class _Numbers(NamedTuple):
    """Numbers that control `_drive`."""

    step: float  # largest length of a step along the path [m]
    longest: float  # largest number of steps in an interval at the first attempt
    tries: float  # attempts to reach a sample; zero if the numbers of steps are given
    finer: float  # factor of the number of steps after each of them
    estimated: bool  # whether errors are estimated
    rounding: float = LIMIT_ROUNDING
    repeats: int = FORCE_STEPS  # of the forces; without limits, -1
    fastest: float = MAX_STEPS
    # number of steps at the end of an interval that halve their lengths, and the last one [s]
    graded: float = 0
    shortest: float = 0.0
    change: float = MAX_CHANGE
    error: float = MAX_ERROR
    placed: float = POSITION_CHANGE  # of positions of certified samples
    places: int = POSITION_STEPS


# steps of given numbers, without limits
GIVEN = _Numbers(np.inf, np.inf, 0, 1, estimated=False, rounding=np.inf, repeats=-1)


class _Course(NamedTuple):
    """Results of `_drive`, for n lanes and m samples."""

    # states or their first rows at the samples, and estimated errors of ``x`` if there are any,
    # NaN after the end of a lane, shape (m, n_kept + n_errors, n)
    samples: Array
    counts: Array  # numbers of steps, shape (m - 1, n)
    doubt: Array  # zero for samples at which each wheel has a single contact, shape (m, n)
    end: Array  # time of the first step beyond a limit, or of the last sample, shape (n,) [s]
    reason: Array  # index of the limit, or a code, shape (n,)
    beyond: Array  # states at the first step beyond a limit, shape (n_rows, n)
    last: _Step  # last step

    @property
    def reached(self) -> Indices:
        """Index of the last sample of each lane, -1 without a sample."""
        return np.asarray(np.isfinite(self.samples[:, 0]).sum(axis=0) - 1)


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
            again = np.isnan(motions.errors[0]) & (motions.reason != INVALID_START)
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


def candidate_lanes(
    evaluate: Evaluator, states: Array, inputs: Array, t: Array, step: float
) -> Candidates:
    """Return motions as `integrate_lanes`, for many candidates of which few are kept.

    Errors are not estimated, checks of samples not evaluated, and the time of an end is that of the
    first step beyond a limit. Limits are evaluated after each step.
    """
    numbers = _Numbers(
        step, MAX_CANDIDATE_STEPS, CANDIDATE_TRIES, CANDIDATE_REFINEMENT, estimated=False
    )
    with np.errstate(all="ignore"):
        run = _drive(evaluate, states, inputs, t, numbers, evaluate.graphs.rows.q.stop)
    return Candidates(run.samples, run.end, np.where(run.reason == TOO_FAST, UNSOLVED, run.reason))


def _integrate(
    evaluate: Evaluator, states: Array, inputs: Array, t: Array, step: float, *, certify: bool
) -> Motions:
    """Return the motions of lanes: integrate, check the samples, locate the ends.

    ``states`` (n_rows, n) are the starts, ``inputs`` (n_u, m - 1, n) are constant between the times
    ``t`` (m,), ``step`` is the largest length of a step along the path [m], and ``certify`` adds
    the checks of samples.
    """
    rows, states = evaluate.graphs.rows, states.copy()
    states[rows.u], states[rows.t] = inputs[:, 0], t[0]
    # the defect says little where relaxation or creep is faster than the steps
    dae = evaluate.graphs.dae
    is_stiff = dae.lag is not None or not evaluate.graphs.linear
    numbers = _Numbers(step, MAX_STEPS, MAX_TRIES, REFINEMENT, estimated=not is_stiff)
    if dae.lag is not None:
        last = LAST_SHARE * min(1.0, step / (GRADED_STEP * dae.size)) * dae.relaxation_time
        numbers = numbers._replace(graded=GRADED, shortest=last)
    run = _drive(evaluate, states, inputs, t, numbers, rows.t.stop, certify=certify)
    samples, reached = run.samples[:, : rows.t.stop], run.reached
    if is_stiff:
        half = GIVEN._replace(graded=numbers.graded, shortest=numbers.shortest / 2)
        # of motions with half the step; relaxing states have the error of the last, halved too
        x, lanes = rows.x, np.arange(reached.size)
        finer = _drive(evaluate, states, inputs, t, half, x.stop, 2 * run.counts)
        errors = (run.samples[:, x] - finer.samples)[np.maximum(reached, 0), :, lanes].T
        errors *= HALVED if dae.lag is None else RELAXING_HALVED
    ends = _Ends(evaluate, t, run, certify=certify)
    started = reached >= 0
    ends.reason[~started & (run.reason >= 0)] = INVALID_START
    failed = ends.check_samples() if certify else np.full(reached.size, t.size)
    ends.locate_limits(np.flatnonzero(started & (run.reason >= 0) & (failed == t.size)))
    ends.end_at_samples(failed)
    if certify and (run.reason == UNSOLVED).any():
        ends.end_unsolved(np.flatnonzero((run.reason == UNSOLVED) & started & (failed == t.size)))
    for k in np.unique(failed[failed < t.size]):
        run.samples[k:, :, failed == k] = np.nan
    if not is_stiff:
        errors = run.samples[np.maximum(reached, 0), rows.t.stop :, np.arange(reached.size)].T
    invalid = ends.reason == INVALID_START
    distances = np.full((len(evaluate.graphs.bounds), invalid.size), np.nan)
    distances[:, invalid] = solve_forces(evaluate, states[:, invalid])
    found = samples, ends.end, ends.reason, ends.beyond, errors, distances
    return Motions(*found, run.counts.sum(axis=0).astype(int))


def _drive(
    evaluate: Evaluator,
    states: Array,
    inputs: Array,
    t: Array,
    numbers: _Numbers,
    kept: int,
    counts: Array | None = None,
    *,
    certify: bool = False,
) -> _Course:
    """Integrate lanes by compiled code, or by `_drive_plainly`.

    ``kept`` is the number of rows of the samples. Times have the shape (m,), or (m, n) for lanes
    with times of their own. Numbers of steps may be given. With ``certify``, compiled code corrects
    the positions of samples and compares known bounds of the ground with the curvature of wheels.
    """
    rows, n = evaluate.graphs.rows, states.shape[1]
    t = np.broadcast_to(t.reshape(len(t), -1), (len(t), n))
    samples = np.empty((n, len(t), kept + numbers.estimated * rows.x.stop)).transpose(1, 2, 0)
    counts = np.zeros((len(t) - 1, n)) if counts is None else counts
    sizes = np.cumsum([1, 1, rows.t.stop, rows.t.stop])
    out = np.empty((n, sizes[-1] + 1)).T
    end, reason, beyond, last, h = np.split(out, sizes)
    doubt, graphs = np.ones((n, len(t))), evaluate.graphs
    run = _Course(samples, counts, doubt.T, end[0], reason[0], beyond, _Step(last, h[0]))
    wheels = graphs.wheels.items() if certify else ()
    bounds = {graphs.placing.parts[k].start: check.known_bounds() for k, check in wheels}
    if not evaluate.drive(states, inputs, t, kept, numbers, bounds, samples, counts, out, doubt):
        _drive_plainly(evaluate, states, inputs, t, numbers, kept, run)
    codes = np.array([*evaluate.graphs.bounds, 0])
    reason = run.reason.astype(int)
    return run._replace(reason=np.where(reason >= 0, codes[np.maximum(reason, 0)], reason))


def _drive_plainly(
    evaluate: Evaluator,
    states: Array,
    inputs: Array,
    t: Array,
    numbers: _Numbers,
    kept: int,
    run: _Course,
) -> None:
    """Fill in the results of lanes: the specification of the compiled ``drive``."""
    rows, last = evaluate.graphs.rows, run.last
    graded = int(numbers.graded)
    n, a, is_given = states.shape[1], states.copy(), numbers.tries == 0
    run.end[:], run.reason[:], run.beyond[:], run.samples[:] = t[-1], COMPLETE, a, np.nan
    last.states[:], last.h[:] = a, 0.0
    rates, slopes, before, means = np.zeros((4, rows.q.stop, n))
    sums, speed, number = np.zeros((rows.x.stop, n)), np.zeros(n), np.ones(n)

    def check(lanes: Indices) -> tuple[Indices, Indices]:
        """Correct lanes; return which are solved inside the limits, and which are not solved."""
        some = a[:, lanes]
        slope, solved, fast, distances = _checked(evaluate, some, numbers.repeats)
        beyond = solved & ~(margins(distances, numbers.rounding) >= 0)
        ended, inside = lanes[beyond], solved & ~beyond
        run.end[ended], run.reason[ended] = some[rows.t][0, beyond], smallest(distances)[beyond]
        run.beyond[:, ended] = some[:, beyond]
        a[:, lanes[inside]], slopes[:, lanes[inside]] = some[:, inside], slope[:, inside]
        speed[lanes[inside]] = fast[inside]
        return lanes[inside], lanes[~solved]

    for k, now in enumerate(t):  # from sample k - 1 to sample k
        since, left = t[max(k - 1, 0)], np.flatnonzero(run.reason == COMPLETE)
        halves = 2.0**graded - 1  # sum of the lengths of graded steps, in those of the last one
        span = now - since
        shortest = np.minimum(numbers.shortest, span / (2 * max(halves, 1)))
        if k:
            needed = speed * span / numbers.step
            number = np.clip(np.ceil(needed - 1e-9), 1, numbers.longest)
            number = run.counts[k - 1].copy() if is_given else number
            fast = left[(number == 0 if is_given else ~(needed <= numbers.fastest))[left]]
            run.reason[fast], run.end[fast] = TOO_FAST, since[fast]
            left = np.setdiff1d(left, fast)
        first = a.copy(), rates.copy(), sums.copy()
        for _ in range(int(numbers.tries) if k and not is_given else 1):
            if not left.size:
                break
            is_short = number[left] <= numbers.fastest
            going, lost = left[is_short], [left[~is_short]]
            for values, begin in zip((a, slopes, sums), first, strict=True):
                values[:, left] = begin[:, left]
            if k and not is_given:
                run.counts[k - 1, left] = number[left]
            arrived = [] if k else [going]
            # steps of equal length, then graded ones, each half as long as the one before
            for taken in range(1, int(number[going].max(initial=0)) + graded + 1 if k else 1):
                past = np.maximum(taken - number[going], 0)
                equal = (span - halves * shortest)[going] / number[going]
                h = np.where(past > 0, shortest[going] * 2.0 ** (graded - past), equal)
                some, slope = a[:, going], slopes[:, going]
                last.states[:, going], before[:, going], last.h[going] = some, slope, h
                a[:, going], solved, means[:, going] = _stepped(evaluate, some, slope, h)
                lost.append(going[~solved])
                is_last = number[going] + graded <= taken
                here = going[solved & is_last]
                arrived.append(here)
                going, unsolved = check(going[solved & ~is_last])
                lost.append(unsolved)
                if numbers.estimated:  # with the inputs of this interval
                    slopes[:, here] = derivatives(evaluate, a[:, here])[0]
                    which = np.concatenate([going, here])
                    parts = (each[:, which] for each in (before, means, slopes, sums))
                    step = _Step(*(each[..., which] for each in last))
                    sums[:, which] += _step_errors(evaluate, step, *parts)
                if not going.size:
                    break
            there = np.concatenate(arrived)
            a[rows.t, there] = now[there]
            if k < len(t) - 1:
                a[rows.u, there] = inputs[:, k, there]
            there, unsolved = check(there)
            rates[:, there] = slopes[:, there]
            # lanes with a failed step repeat the whole interval with shorter steps
            left = np.concatenate([*lost, unsolved])
            number[left] *= numbers.finer
        run.end[left], run.reason[left] = since[left], UNSOLVED
        alive = run.reason == COMPLETE
        run.samples[k, :kept, alive] = a[:kept, alive].T
        if numbers.estimated:
            run.samples[k, kept:, alive] = sums[:, alive].T


def _step_errors(
    evaluate: Evaluator, step: _Step, rates: Array, mean: Array, slope: Array, sums: Array
) -> Array:
    """Return the errors of steps: the integral of the defect on the cubic path by the 3/8 rule.

    ``rates`` and ``slope`` are those at the begins and ends, and ``sums`` the errors before. The
    defect is evaluated beside the path, at the states with their errors, so that it has the rates
    of these errors as well. At the ends of the path, with a quarter of the weights of the rule,
    there is no defect and no displacement: the other points are displaced by 4/3 of the errors.
    """
    rows, h = evaluate.graphs.rows, step.h
    moving = slice(0, rows.q.stop)
    errors = ((rates + slope) / 8 - mean)[rows.x]
    for c in (1 / 3, 2 / 3):
        at, d = step.states.copy(), 1 - c
        parts = c * d**2 * rates, c**2 * (3 - 2 * c) * mean, -(c**2) * d * slope
        at[moving] += h * sum(parts)
        at[rows.x] += 4 / 3 * sums
        at[rows.t] += c * h
        errors += 0.375 * derivatives(evaluate, at)[0][rows.x]
    return np.asarray(h * errors)


class _Ends:
    """Ends of lanes, which are located after the integration."""

    def __init__(self, evaluate: Evaluator, t: Array, run: _Course, *, certify: bool) -> None:
        self.evaluate, self.t, self.run, self.certify = evaluate, t, run, certify
        self.rows = evaluate.graphs.rows
        self.end, self.reason, self.beyond = run.end, run.reason, run.beyond

    def check_samples(self) -> Indices:
        """Return the index of the first sample of each lane that fails a check, or m."""
        reached, failed = self.run.reached, np.full(self.end.size, self.t.size)
        every = range(len(self.evaluate.graphs.checks))
        others = [k for k in every if k not in self.evaluate.graphs.wheels]
        for k, doubt in enumerate(self.run.doubt > 0):
            on = (reached >= k) & (failed == self.t.size)
            for lanes, checks in ((on & doubt, every), (on & ~doubt, others)):
                if checks and lanes.any():
                    some = self.run.samples[k, : self.rows.t.stop, lanes].T.copy()
                    clear = clearances(self.evaluate, some, checks).min(axis=0) >= 0
                    self.run.samples[k, self.rows.p, lanes] = some[self.rows.p].T
                    failed[np.flatnonzero(lanes)[~clear]] = k
        return failed

    def end_at_samples(self, failed: Indices) -> None:
        """End lanes at the checks of samples that they fail, before which they are located."""
        start = np.flatnonzero(failed == 0)
        if start.size:
            states = self.run.samples[0, : self.rows.t.stop, start].T
            self.reason[start] = INVALID_START
            self._close(start, states, states)
        lanes = np.flatnonzero((failed > 0) & (failed < self.t.size))
        self.reason[lanes] = LOST
        self._search_contacts(lanes, failed[lanes] - 1, self.t[failed[lanes]])

    def end_unsolved(self, lanes: Indices) -> None:
        """End lanes that are not solved beyond their last steps at second contacts before, if any.

        Beyond a second contact, the contact of a wheel may vanish.
        """
        last = _Step(*(each[..., lanes] for each in self.run.last))
        self._search_contacts(lanes, self.run.reached[lanes], last.states[self.rows.t][0])
        left = self.reason[lanes] == UNSOLVED
        self._search_parts(lanes[left], last.of(left), np.ones(left.sum(), dtype=int))

    def locate_limits(self, lanes: Indices) -> None:
        """Locate the ends of lanes at limits in their last steps.

        The end is where the first margin becomes negative, found by secants and bisection. A lane
        at which no such point is found is lost. With ``certify``, a contact of another point of a
        wheel before it ends the lane there.
        """
        if not lanes.size:
            return
        graph, one = self.evaluate.graphs.checked, np.ones(lanes.size, dtype=int)
        last = _Step(*(each[..., lanes] for each in self.run.last))
        low, high, lost = self._locate(last, one, self.beyond[:, lanes], lambda _, margin: margin)
        values = self.evaluate(graph, high)
        distances, change = values[graph.parts[DISTANCES]], values[graph.parts[CHANGE]][0]
        # a contact that jumps has no limit to name
        lost |= ~(change < SETTLED) | ~(margins(distances) < 0)
        bounds = np.array(self.evaluate.graphs.bounds)
        self.reason[lanes] = np.where(lost, LOST, bounds[smallest(distances)])
        self._close(lanes, low, high)
        if self.certify:
            near = NEAR * self.evaluate.graphs.dae.size
            close = clearances(self.evaluate, low).min(axis=0) < near
            which = lanes[close]
            self._search_contacts(which, self.run.reached[which], low[self.rows.t][0, close])

    def _search_contacts(self, lanes: Indices, k: Indices, time: Array) -> None:
        """End lanes at their first second contact between samples ``k`` and times, if any."""
        if not lanes.size:
            return
        states = self.run.samples[k, : self.rows.t.stop, lanes].T.copy()
        number = self.run.counts[k, lanes].astype(int)
        h = (time - states[self.rows.t][0]) / number
        self._search_parts(lanes, _Step(states, h), number)

    def _search_parts(self, lanes: Indices, step: _Step, number: Indices) -> None:
        """End lanes at their first second contact within steps, if any."""
        if not lanes.size:
            return
        times = step.states[self.rows.t] + np.reshape(PARTS, (-1, 1)) * step.h * number
        counts = np.ceil(np.diff(PARTS)[:, None] * number)
        parts = self._driven(step.states, times, counts)
        at = np.moveaxis(parts[1:], 1, 0).copy()
        clear = clearances(self.evaluate, at.reshape(len(at), -1)).min(axis=0)
        bad = clear.reshape(counts.shape) < 0  # not where it is unsolved
        first = np.where(bad.any(axis=0), bad.argmax(axis=0), len(counts))
        for k in np.unique(first[first < len(counts)]):
            here = first == k
            part = _Step(parts[k], (times[k + 1] - times[k]) / counts[k]).of(here)
            self._end_at_checks(lanes[here], at[:, k, here], part, counts[k, here].astype(int))

    def _end_at_checks(self, lanes: Indices, states: Array, step: _Step, number: Indices) -> None:
        """End lanes that fail a check, which is located between a sample and the states."""
        if not lanes.size:
            return
        failed = smallest(clearances(self.evaluate, states))
        for check in np.unique(failed):
            chosen = failed == check

            def margin(at: Array, _: Array, only: Indices = check[None]) -> Array:
                return np.asarray(clearances(self.evaluate, at, only)[0])

            at = _of(chosen, states)
            low, high, lost = self._locate(step.of(chosen), number[chosen], at, margin)
            which, reason = lanes[chosen], check + len(self.evaluate.graphs.dae.limits)
            self.reason[which] = np.where(lost, LOST, reason)
            self._close(which, low, high)
            earlier = clearances(self.evaluate, low).min(axis=0) < 0  # of another wheel
            self.reason[which[earlier]] = LOST
            part = step.of(chosen)
            h = (low - part.states)[self.rows.t][0] / number[chosen]
            for width in (h, part.h - h):  # neither at the begin nor as late as before
                earlier &= width * number[chosen] > CROSSING_TOLERANCE
            self._end_at_checks(
                which[earlier],
                low[:, earlier],
                part._replace(h=h).of(earlier),
                number[chosen][earlier],
            )

    def _close(self, lanes: Indices, last: Array, beyond: Array) -> None:
        self.end[lanes] = last[self.rows.t]
        self.beyond[:, lanes] = beyond

    def _driven(self, states: Array, times: Array, counts: Array) -> Array:
        """Return the states at times (m, n) after given numbers of steps (m - 1, n) between."""
        inputs = np.repeat(states[self.rows.u][:, None], len(counts), axis=1)
        run = _drive(self.evaluate, states, inputs, times, GIVEN, self.rows.t.stop, counts)
        return np.asarray(run.samples)

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
            start = part.states[self.rows.t]
            times, counts = np.concatenate([start, start + part.h * count[wide]]), count[None, wide]
            states = self._driven(part.states, times, counts.astype(float))[1]
            _, good, _, distances = _checked(self.evaluate, states)
            value = np.where(good, margin(states, margins(distances)), np.nan)
            fine, lanes = value >= 0, np.flatnonzero(wide)  # not for NaN
            before, after = lanes[fine], lanes[~fine]
            low[before], at_low[before], inside[:, before] = (
                share[fine],
                value[fine],
                states[:, fine],
            )
            high[after], at_high[after] = share[~fine], value[~fine]
            if k:
                beyond[:, after] = states[:, ~fine]
        return inside, beyond, np.isnan(at_high) & (low < 1)


def smallest(values: Array) -> Indices:
    """Return the row of the smallest value of each column, or of one that is not a number."""
    return np.asarray(np.where(np.isnan(values), -np.inf, values).argmin(axis=0))


def _of(lanes: Mask, array: Any) -> Any:
    return array if lanes.all() else np.compress(lanes, array, axis=-1)


def solve_forces(evaluate: Evaluator, states: Array) -> Array:
    """Solve for the forces of ``states``, shape (n_rows, n_lanes), in place.

    Return the distances to the bounds of limits, shape (n_bounds, n_lanes). The forces of a lane
    that is solved do not change, whatever the others need.
    """
    graph, rows = evaluate.graphs.checked, evaluate.graphs.rows
    distances = np.empty((len(evaluate.graphs.bounds), states.shape[1]))
    lanes, part = np.arange(states.shape[1]), states
    for _ in range(FORCE_STEPS):
        values = _iterated(evaluate, graph, part)
        _derivatives(evaluate, graph, values, part)
        change = np.abs(values[graph.parts[FORCES]] - part[rows.f]).sum(axis=0)
        part[rows.f] = values[graph.parts[FORCES]]
        states[:, lanes], distances[:, lanes] = part, values[graph.parts[DISTANCES]]
        moving = ~(change <= FORCE_CHANGE * np.abs(part[rows.f]).sum(axis=0))
        if not moving.any():
            break
        lanes, part = lanes[moving], part[:, moving]
    return distances


def _checked(
    evaluate: Evaluator, states: Array, repeats: int = FORCE_STEPS
) -> tuple[Array, Mask, Array, Array]:
    """Return the results of `derivatives`, and the distances to the bounds of limits.

    There are no limits if ``repeats`` is negative.
    """
    if repeats < 0:
        return *derivatives(evaluate, states), np.zeros((1, states.shape[1]))
    graph, forces = evaluate.graphs.checked, evaluate.graphs.rows.f
    values = _iterated(evaluate, graph, states)
    result = _derivatives(evaluate, graph, values, states)
    for _ in range(repeats):
        states[forces] = values[graph.parts[FORCES]]
        rough = ~(values[graph.parts[DOUBT]][0] <= 0)
        if not rough.any():
            break
        values[:, rough] = evaluate(graph, _of(rough, states))
    return *result, values[graph.parts[DISTANCES]]


def margins(distances: Array, rounding: float = LIMIT_ROUNDING) -> Array:
    """Return the least distances to limits, increased by ``rounding``; NaN with NaN."""
    return np.asarray(distances.min(axis=0, initial=np.inf) + rounding)


def clearances(evaluate: Evaluator, states: Array, only: Iterable[int] | None = None) -> Array:
    """Return the margins of the checks, or of some, (n_checks, n); infinite without checks.

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
    placed, chosen = evaluate(graph, states), range(len(checks)) if only is None else only
    return np.stack([checks[k].margin_at(placed[graph.parts[k]]) for k in chosen])


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
    """Return rates, whether they are solved, and the speed along the path [m/s] of lanes.

    Positions and rates in the states are corrected by the step of the graph.
    """
    rows = evaluate.graphs.rows
    rates, p, w, change, error, speed = graph.parts[:6]
    states[rows.p], states[rows.w] = values[p], values[w]
    good = (values[change][0] < MAX_CHANGE) & (values[error][0] <= MAX_ERROR)
    return values[rates], good, values[speed][0]


def _stepped(
    evaluate: Evaluator, states: Array, rates: Array, h: Array
) -> tuple[Array, Mask, Array]:
    """Return the states after a step, which are solved, and the mean rates.

    The method is Ralston's of third order: A. Ralston, Runge-Kutta methods with minimum error
    bounds, Math. Comp. 16 (1962), eq. (4.1). States that relax take two linearly implicit half
    steps, whose damping is complete for infinitely stiff contacts, and the others then a step of
    the midpoint rule.
    """
    dae, rows = evaluate.graphs.dae, evaluate.graphs.rows
    moving, stage = slice(0, rows.q.stop), states.copy()
    if dae.lag is None:
        stage[moving] = states[moving] + (0.5 * h) * rates
        stage[rows.t] += 0.5 * h
        second, solved, _ = derivatives(evaluate, stage)
        stage[moving] = states[moving] + (0.75 * h) * second
        stage[rows.t] = states[rows.t] + 0.75 * h
        third, good, _ = derivatives(evaluate, stage)
        mean = (2 * rates + 3 * second + 4 * third) / 9
        stage[moving] = states[moving] + h * mean
    else:  # `rates` are those of another lag
        relaxing = slice(rows.x.stop - dae.rest.numel(), rows.x.stop)
        stage[rows.lag] = 0.5 * h
        first, solved, _ = derivatives(evaluate, stage)
        start = stage[moving].copy()
        stage[moving] = start + 0.5 * h * first
        stage[rows.t] += 0.5 * h
        middle = stage[relaxing].copy()
        mean, good, _ = derivatives(evaluate, stage)
        stage[moving] = start + h * mean
        stage[relaxing] = middle + 0.5 * h * mean[relaxing]
        stage[rows.lag] = 0.0
    stage[rows.t] = states[rows.t] + h
    return stage, solved & good, mean


def relax(evaluate: Evaluator, states: Array) -> Mask:
    """Relax states at rest to their equilibrium; return which have reached it.

    Implicit steps follow the relaxation; they grow while they are small, and end as Newton's
    method. A vehicle is at rest if a step of more than a second changes its pose by less than
    `AT_REST`.
    """
    dae, rows = evaluate.graphs.dae, evaluate.graphs.rows
    relaxing = slice(rows.x.stop - dae.rest.numel(), rows.x.stop)
    size, tilt = dae.sizes.x[relaxing, None], dae.state_rows("roll", "pitch")
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
        going = ~done & (np.cos(part[tilt]).prod(axis=0) > 0)  # others overturn
        if not going.all():
            states[:, lanes[~going]], at_rest[lanes[done]] = part[:, ~going], True
            lanes, part, h = lanes[going], part[:, going], h[going]
            if not lanes.size:
                break
    states[:, lanes] = part
    states[rows.lag] = 0.0
    return at_rest
