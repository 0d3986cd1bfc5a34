"""Planning by sampling: model predictive path integral control with exact contact.

In each cycle, candidates are drawn around the inputs of the cycle before, all are simulated side by
side by the batch, and the inputs become the mean of the candidates with weights
``exp(-cost / lambda)`` [1]_. Noise is smooth in time; inputs stay in their ranges by construction.
A candidate that ends at a limit has no weight while others complete. The temperature ``lambda``
follows from the number of candidates that shall have weight, so that it needs no tuning when the
costs change.

.. [1] G. Williams, A. Aldrich, E. A. Theodorou, Model predictive path integral control: from theory
   to parallel computation, J. Guid. Control Dyn. 40(2), 2017, pp. 344-357.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Annotated, NamedTuple

import casadi as ca
import numpy as np

from slipfree.batch.evaluator import Evaluator, EvaluatorOf, evaluator_of, evaluator_of_graphs
from slipfree.batch.graph import Graph, graph_of
from slipfree.batch.many import solve_positions, start_states
from slipfree.batch.motion import (
    COMPLETE,
    UNSOLVED,
    Candidates,
    candidate_lanes,
    clearances,
    smallest,
    solve_forces,
)
from slipfree.core.arguments import BY_NAME, checked
from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Indices, Label, leaves
from slipfree.core.schema import Count, NonNegative, Positive
from slipfree.core.trajectory import SolverError
from slipfree.geometry.regions import Region
from slipfree.plan.problem import Range, costs_of, range_of
from slipfree.plan.stage import Cost
from slipfree.system.forks import cached_property

CORRELATION = 0.7  # of the noise in neighbouring intervals
EFFECTIVE = 0.02  # share of the candidates that shall have weight
BISECTIONS = 60  # of the temperature
STEP = 0.75  # longest step [size of the vehicle]; at most the trail of a caster
CHECKED_POINTS = 4  # of an interval, for keep-out regions
LEAST_WEIGHT = 1e-4  # of a candidate that is certified
IN_REGION = -6  # reason of an end, beside those of the batch


class _ForcedCost(NamedTuple):
    """Graph of the integrand of costs that depend on forces."""

    graph: Graph

    @property
    def every(self) -> tuple[Graph, ...]:
        """The graph."""
        return tuple(self)


@checked
@dataclass(frozen=True, eq=False)
class SamplingTask:
    """Costs, goal and ranges of a sampling controller, and parameters of the method.

    Attributes
    ----------
    model : Dae
        Model of kinematics or quasi-statics.
    costs : mapping of str to float, or sequence of Cost
        Weights by name, as in `slipfree.plan`, or terms. They are integrated with the motion; those
        that depend on forces follow by the trapezoidal rule between the samples.
    goal : mapping of str to float
        Values of states at the end of the horizon, in map coordinates. [m, rad]
    span : float
        Length of the horizon. [s]
    ranges : mapping of str to tuple of 2 floats
        Smallest and largest value of every input.
    goal_weight : float
        Cost of a distance of one vehicle size, or of a radian, from the goal.
    intervals : int
        Number of intervals of the horizon, with constant inputs.
    candidates : int
        Number of candidates of a cycle.
    spread : float
        Standard deviation of the noise as a share of the ranges.
    threads : int
        Number of threads that simulate candidates, if the equations are compiled.
    seed : int
        Seed of the noise; the same seed gives the same inputs.
    compiled : bool
        Whether to compile the equations.

    Raises
    ------
    ModelError
        If a number or a range is invalid, or a name is unknown.
    """

    model: Dae
    costs: Mapping[str, NonNegative] | Sequence[Cost]
    goal: Annotated[Mapping[str, float], BY_NAME]
    span: Positive
    ranges: Mapping[str, Range]
    goal_weight: Positive = 1.0
    intervals: Count = field(default=10, kw_only=True)
    candidates: Count = field(default=512, kw_only=True)
    spread: Positive = field(default=0.2, kw_only=True)
    threads: Count = field(default=1, kw_only=True)
    seed: int = field(default=0, kw_only=True)
    compiled: bool = field(default=True, kw_only=True)

    def __post_init__(self) -> None:
        names = self.model.input_names
        if sorted(names) != sorted(self.ranges):
            raise ModelError(
                f"ranges: expected one for each input, {', '.join(names)}, found "
                f"{', '.join(self.ranges) or 'none'}; correct them"
            )
        self.model.start(**self.goal)  # names

    @cached_property
    def t(self) -> Array:
        """Times of the samples of the horizon, shape (intervals + 1,) [s]."""
        return np.linspace(0.0, self.span, self.intervals + 1)

    @cached_property
    def evaluate(self) -> Evaluator:
        """Evaluator of the model, whose only quadrature is the cost that needs no forces."""
        dae, cost = self.model, ca.SX.sym("cost")
        rate = sum((each.weight * each.expression for each in self._terms[0]), ca.SX(0))
        label = Label("cost", "1", "integral of the costs that do not depend on forces")
        own = replace(dae, q=(cost,), quad=rate, labels=dae.labels._replace(q=(label,)))
        return evaluator_of(own, compiled=self.compiled)

    @cached_property
    def evaluate_forced(self) -> EvaluatorOf[_ForcedCost] | None:
        """Evaluator of the costs that depend on forces, if any."""
        if not self._terms[1]:
            return None
        rate = sum((each.weight * each.expression for each in self._terms[1]), ca.SX(0))
        graph = graph_of(self.model, self.evaluate.graphs.state, "forced", [rate])
        return evaluator_of_graphs(_ForcedCost(graph), compiled=self.compiled)

    @cached_property
    def _terms(self) -> tuple[tuple[Cost, ...], tuple[Cost, ...]]:
        """Costs that do not depend on unknowns that follow from the motion, and costs that do."""
        z = self.model.columns()[1]
        known = sum(block.numel() for block in self.model.alg[:2])
        found: tuple[list[Cost], list[Cost]] = [], []
        for each in costs_of(self.model, self.costs):
            found[ca.depends_on(each.expression, z[known:])].append(each)
        return tuple(found[0]), tuple(found[1])

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Smallest and largest inputs, shape (n_u, 1)."""
        pairs = [range_of(self.ranges[name]) for name in self.model.input_names]
        low, high = np.array(pairs, dtype=float).T[..., None]
        return low, high


class SampledPlan(NamedTuple):
    """Result of a cycle of `sample_plan`.

    Attributes
    ----------
    inputs : ndarray, shape (n_u, n_intervals)
        Inputs in the intervals of the horizon; apply the first ones.
    x : ndarray, shape (n_x, n_intervals + 1)
        States at the samples, in map coordinates; NaN after an early end.
    cost : float
        Cost of these inputs; infinite if their motion ends early.
    complete : float
        Share of the candidates that complete the horizon. [1]
    ends : mapping of str to int
        Numbers of candidates that end early, by the words of the limit.
    cycle : int
        Number of the cycle, from zero.
    """

    inputs: Array
    x: Array
    cost: float
    complete: float
    ends: Mapping[str, int]
    cycle: int


@checked
def sample_plan(
    task: SamplingTask,
    x: Array,
    former: SampledPlan | None = None,
    *,
    elapsed: float | None = None,
    goal: Annotated[Mapping[str, float | Array], BY_NAME] | None = None,
    keep_out: Sequence[Region] = (),
) -> SampledPlan:
    """Return inputs of low cost from a state on, by sampling.

    Parameters
    ----------
    task : SamplingTask
        Model, costs, goal and ranges.
    x : ndarray, shape (n_x,)
        State of the vehicle, in map coordinates and the order of ``model.x``.
    former : SampledPlan, optional
        Result of the cycle before, around which candidates are drawn; by default the middle of the
        ranges.
    elapsed : float, optional
        Time since the cycle before, by which its inputs are shifted; by default one interval. [s]
    goal : mapping of str to float or ndarray, optional
        Goal of this cycle; by default that of the task. An array of shape (intervals + 1,) contains
        values at the samples ``task.t``, such as those of a plan that is followed; their mean
        square distance counts. [m, rad]
    keep_out : sequence of Region
        Regions that the centre of the platform must not enter, such as obstacles that were seen
        since the last cycle, enlarged by half the width of the vehicle. They are checked at
        `CHECKED_POINTS` points of every interval. In a region in which it starts, it must not go
        deeper.

    Returns
    -------
    SampledPlan
        The cheapest of the weighted mean and the best candidate.

    Raises
    ------
    ModelError
        If the state or an array of the goal has a wrong shape or is not finite, or a name of the
        goal is unknown.
    SolverError
        If the vehicle cannot stand at ``x``, or a limit is violated there.
    """
    if goal is not None:
        task.model.start(**dict.fromkeys(goal, 0.0))  # names
        for name, value in goal.items():
            if np.shape(value) not in ((), task.t.shape):
                raise ModelError(
                    f"goal: {name}: expected a number or one for each of the {task.t.size} samples "
                    f"of the horizon, found the shape {np.shape(value)}; give values at `task.t`"
                )
    aims = _Aims(task, task.goal if goal is None else goal, tuple(keep_out), _first_state(task, x))
    low, high = task.limits
    mean = np.tile((low + high) / 2, task.intervals)
    number = 0
    if former is not None:
        mean = _shifted(task, former.inputs, task.t[1] if elapsed is None else elapsed)
        number = former.cycle + 1
    inputs = _candidates(task, mean, number)
    costs, motions = _simulated(aims, inputs)
    if not (motions.end > 0).any():
        words = ", ".join(_ends(task, motions)) or "no pose was found"
        raise SolverError(f"sampling: the vehicle cannot start at this state: {words}")
    weights = _certified_weights(aims, costs, motions)
    both = np.stack([inputs @ weights, inputs[..., int(weights.argmax())]], axis=-1)
    values, run = _simulated(aims, both)
    _certify(aims, values, run, np.arange(2))
    best = int(values.argmin() if np.isfinite(values).any() else run.end.argmax())
    rows = task.evaluate.graphs.rows.x
    return SampledPlan(
        both[..., best],
        run.samples[:, rows, best].T + task.model.shift[0][:, None],
        float(values[best]),
        float((motions.reason == COMPLETE).mean()),
        _ends(task, motions),
        number,
    )


class _Aims(NamedTuple):
    """Task, goal and obstacles of a cycle, and the rows of the state that it starts from."""

    task: SamplingTask
    goal: Mapping[str, float | Array]
    keep_out: tuple[Region, ...]
    first: Array


def _shifted(task: SamplingTask, inputs: Array, elapsed: float) -> Array:
    """Return inputs of the last cycle from a later time on: means; the last ones are held."""
    whole, part = divmod(elapsed / task.t[1], 1.0)
    index = np.minimum(np.arange(task.intervals) + int(whole), task.intervals - 1)
    later = np.minimum(index + 1, task.intervals - 1)
    return np.asarray((1 - part) * inputs[:, index] + part * inputs[:, later])


def _candidates(task: SamplingTask, mean: Array, number: int) -> Array:
    """Return inputs of candidates, shape (n_u, intervals, candidates).

    The first is the mean. The second has the smallest inputs, zero if the ranges allow it: where
    every other motion meets an obstacle, the vehicle can stop.
    """
    low, high = task.limits
    rng = np.random.default_rng((task.seed, number))
    noise = rng.standard_normal((*mean.shape, task.candidates))
    for k in range(1, task.intervals):
        noise[:, k] = CORRELATION * noise[:, k - 1] + np.sqrt(1 - CORRELATION**2) * noise[:, k]
    noise[..., 0] = 0.0
    spread = task.spread * (high - low)
    inputs = np.clip(mean[..., None] + spread[..., None] * noise, low[..., None], high[..., None])
    inputs[..., 1:2] = np.clip(0.0, low, high)[..., None]
    return np.asarray(inputs)


def _first_state(task: SamplingTask, x: Array) -> Array:
    """Return the rows of the vehicle at a state, shape (n_rows, 1)."""
    first = start_states(task.evaluate.graphs, {})
    first[task.evaluate.graphs.rows.x, 0] = task.model.local_state(x)
    if not solve_positions(task.evaluate, first).has_pose.all():
        raise SolverError(
            "sampling: expected a state at which the vehicle stands on the ground, found no pose "
            f"at {np.round(x, 6).tolist()}; correct its position, heading or joints"
        )
    return first


def _simulated(aims: _Aims, inputs: Array) -> tuple[Array, Candidates]:
    """Return the costs and the motions of candidate inputs, simulated by parts in threads."""
    task, n = aims.task, inputs.shape[-1]

    def run(part: Indices) -> tuple[Array, Candidates]:
        """Return costs and motions of candidates; those that end early have infinite costs."""
        many, own = np.repeat(aims.first, part.size, axis=1), inputs[..., part]
        step = min(STEP * task.model.size, task.model.vehicle.trail)
        motions = candidate_lanes(task.evaluate, many, own, task.t, step)
        _end_in_regions(aims, motions)
        costs = _costs(aims, many, motions, own)
        return np.where(motions.reason == COMPLETE, costs, np.inf), motions

    evaluators = [task.evaluate, task.evaluate_forced]
    is_compiled = all(each is None or each.is_compiled for each in evaluators)
    if task.threads == 1 or not is_compiled:
        return run(np.arange(n))
    with ThreadPoolExecutor(task.threads) as pool:
        results = list(pool.map(run, np.array_split(np.arange(n), min(task.threads, n))))
    costs, motions = zip(*results, strict=True)
    joined = (np.concatenate(each, axis=-1) for each in zip(*motions, strict=True))
    return np.concatenate(costs), Candidates(*joined)


def _end_in_regions(aims: _Aims, motions: Candidates) -> None:
    """End motions whose platform enters a region, or goes deeper into one in which it starts.

    Straight lines connect the samples.
    """
    dae = aims.task.model
    x, y = (motions.samples[:, k] + dae.shift[0][k] for k in dae.state_rows("x", "y"))
    for region in aims.keep_out:
        least = np.minimum(region.distance(x[0], y[0]), 0.0)
        for part in np.linspace(1.0, 0.0, CHECKED_POINTS, endpoint=False)[::-1]:
            at = ((1 - part) * each[:-1] + part * each[1:] for each in (x, y))
            inside = region.distance(*at) < least
            first = np.where(inside.any(axis=0), aims.task.t[inside.argmax(axis=0)], np.inf)
            earlier = (first < motions.end) | (inside.any(axis=0) & (motions.reason == COMPLETE))
            motions.end[earlier], motions.reason[earlier] = first[earlier], IN_REGION


def _costs(aims: _Aims, many: Array, motions: Candidates, inputs: Array) -> Array:
    """Return the costs of candidates: integrals of quantities and forces, and the missed goal."""
    task, rows = aims.task, aims.task.evaluate.graphs.rows
    total, forced = motions.samples[-1][rows.q][0].copy(), task.evaluate_forced
    with np.errstate(all="ignore"):
        if forced is not None:
            for k, h in enumerate(np.diff(task.t)):
                many[rows.u] = inputs[:, k]
                for sample in motions.samples[k : k + 2]:
                    many[: rows.q.stop] = sample
                    solve_forces(task.evaluate, many)
                    total += 0.5 * h * forced(forced.graphs.graph, many)[0]
        labels = list(leaves(task.model.labels.x))
        for name, value in aims.goal.items():
            (k,) = task.model.state_rows(name)
            count = 1 if np.isscalar(value) else task.intervals
            wanted = np.reshape(value, (-1, 1))[-count:] - task.model.shift[0][k]
            miss = motions.samples[-count:, k] - wanted
            is_angle = labels[k].unit == "rad"
            miss = 2 * np.sin(miss / 2) if is_angle else miss / task.model.size_of(labels[k])
            total += task.goal_weight * (miss**2).mean(axis=0)
    return np.where(np.isfinite(total), total, np.inf)


def _certified_weights(aims: _Aims, costs: Array, motions: Candidates) -> Array:
    """Return the weights of candidates; those with weight touch the ground only at their contacts.

    Only candidates with weight are certified, since a certificate takes as long as the motion.
    """
    certified = np.zeros(costs.size, dtype=bool)
    while True:
        weights = _weights(costs if np.isfinite(costs).any() else -motions.end)
        new = np.flatnonzero((weights > LEAST_WEIGHT) & np.isfinite(costs) & ~certified)
        if not new.size:
            return weights
        _certify(aims, costs, motions, new)
        certified[new] = True


def _certify(aims: _Aims, costs: Array, motions: Candidates, lanes: Indices) -> None:
    """End lanes at a second contact of a wheel at a sample after the first.

    Their costs become infinite. Reasons count the limits of the model first, then its checks.
    """
    evaluate, samples = aims.task.evaluate, motions.samples[1:, :, lanes]
    states = np.repeat(aims.first, samples.shape[0] * lanes.size, axis=1)
    states[: samples.shape[1]] = samples.swapaxes(0, 1).reshape(samples.shape[1], -1)
    least = clearances(evaluate, states).reshape(-1, samples.shape[0], lanes.size)
    bad = (least < 0).any(axis=0)
    ended = lanes[bad.any(axis=0)]
    when = bad.argmax(axis=0)[bad.any(axis=0)]
    check = smallest(least[:, when, bad.any(axis=0)])
    costs[ended], motions.end[ended] = np.inf, aims.task.t[when]
    motions.reason[ended] = len(aims.task.model.limits) + check


def _weights(costs: Array) -> Array:
    """Return weights of candidates of which about `EFFECTIVE` of the candidates count."""
    above = costs - costs.min()
    wanted = max(1.0, EFFECTIVE * costs.size)
    low, high = 1e-12, max(float(above[np.isfinite(above)].max(initial=0.0)), 1e-9)
    for _ in range(BISECTIONS):
        temperature = np.sqrt(low * high)
        weights = np.exp(-above / temperature)
        if weights.sum() ** 2 / (weights**2).sum() < wanted:
            low = temperature
        else:
            high = temperature
    return np.asarray(weights / weights.sum())


def _ends(task: SamplingTask, motions: Candidates) -> dict[str, int]:
    labels = [each.label for part in (task.model.limits, task.model.checks) for each in part]
    words = {k: label.words for k, label in enumerate(labels)}
    words[UNSOLVED] = "Newton's method did not follow the contacts"
    words[IN_REGION] = "the platform enters a keep-out region"
    return dict(Counter(words[k] for k in motions.reason[motions.reason != COMPLETE].tolist()))
