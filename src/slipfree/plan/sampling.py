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
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.batch.evaluator import Evaluator, EvaluatorOf, evaluator_of, evaluator_of_graphs
from slipfree.batch.graph import Graph, graph_of
from slipfree.batch.many import solve_positions
from slipfree.batch.motion import (
    COMPLETE,
    INVALID_START,
    UNSOLVED,
    Motions,
    candidate_lanes,
    derivatives,
    margins,
    smallest,
    solve_forces,
)
from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Indices, leaves
from slipfree.core.trajectory import SolverError
from slipfree.plan.problem import Range, costs_of
from slipfree.plan.stage import Cost

CORRELATION = 0.7  # of the noise in neighbouring intervals
EFFECTIVE = 0.02  # share of the candidates that shall have weight
BISECTIONS = 60  # of the temperature
NEAR_GROUND = "a wheel or a body touches the ground at the start"
STEP = 0.5  # longest step [size of the vehicle]


class _CostGraphs(NamedTuple):
    """Graphs of the costs: integrands, and cost at the end."""

    running: Graph
    final: Graph

    @property
    def every(self) -> tuple[Graph, ...]:
        """All graphs."""
        return tuple(self)


@dataclass(frozen=True, eq=False)
class SamplingTask:
    """Costs, goal and ranges of a sampling controller, and parameters of the method.

    Attributes
    ----------
    model : Dae
        Model of kinematics or quasi-statics.
    costs : mapping of str to float, or sequence of Cost
        Weights by name, as in `slipfree.plan`, or terms. They are integrated by the trapezoidal
        rule between the samples.
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
    costs: Mapping[str, float] | Sequence[Cost]
    goal: Mapping[str, float]
    span: float
    ranges: Mapping[str, Range]
    goal_weight: float = 1.0
    intervals: int = field(default=10, kw_only=True)
    candidates: int = field(default=512, kw_only=True)
    spread: float = field(default=0.2, kw_only=True)
    threads: int = field(default=1, kw_only=True)
    seed: int = field(default=0, kw_only=True)
    compiled: bool = field(default=True, kw_only=True)

    def __post_init__(self) -> None:
        for name in ("span", "goal_weight", "spread"):
            if not 0 < getattr(self, name) < np.inf:
                raise ModelError(
                    f"{name}: expected a positive number, found {getattr(self, name)}; correct it"
                )
        for name in ("intervals", "candidates", "threads"):
            if getattr(self, name) < 1:
                raise ModelError(
                    f"{name}: expected a number of at least 1, found {getattr(self, name)}; "
                    "correct it"
                )
        names = [label.full for label in leaves(self.model.labels.u)]
        if sorted(names) != sorted(self.ranges):
            raise ModelError(
                f"ranges: expected one for each input, {', '.join(names)}, found "
                f"{', '.join(self.ranges) or 'none'}; correct them"
            )
        for name, (low, high) in self.ranges.items():
            if not low <= high:
                raise ModelError(
                    f"ranges: {name}: expected an ascending range, found {low}, {high}; correct it"
                )
        self.model.start(**self.goal)  # names

    @cached_property
    def t(self) -> Array:
        """Times of the samples of the horizon, shape (intervals + 1,) [s]."""
        return np.linspace(0.0, self.span, self.intervals + 1)

    @cached_property
    def evaluate(self) -> Evaluator:
        """Evaluator of the model."""
        return evaluator_of(self.model, compiled=self.compiled)

    @cached_property
    def evaluate_costs(self) -> EvaluatorOf[_CostGraphs]:
        """Evaluator of the costs."""
        dae, state = self.model, self.evaluate.graphs.state
        terms = [each.weight * each.expression for each in costs_of(dae, self.costs)]
        away = ca.SX(0)
        labels = list(leaves(dae.labels.x))
        x = list(leaves(dae.x))
        for name, value in self.goal.items():
            k = [label.full for label in labels].index(name)
            miss = x[k] + float(dae.shift[0][k]) - value
            if labels[k].unit == "rad":
                miss = 2 * ca.sin(miss / 2)
            away += (miss / (dae.size if labels[k].unit == "m" else 1.0)) ** 2
        running = graph_of(dae, state, "running", [ca.SX(sum(terms))])
        return evaluator_of_graphs(
            _CostGraphs(running, graph_of(dae, state, "final", [self.goal_weight * away])),
            compiled=self.compiled,
        )

    @cached_property
    def has_forces(self) -> bool:
        """Whether the integrands depend on unknowns that follow from the motion."""
        graphs, terms = self.evaluate.graphs, costs_of(self.model, self.costs)
        forces = graphs.state[graphs.rows.f]
        return (
            any(ca.depends_on(each.expression, forces) for each in terms)
            if forces.numel()
            else False
        )

    @cached_property
    def limits(self) -> tuple[Array, Array]:
        """Smallest and largest inputs, shape (n_u, 1)."""
        pairs = [self.ranges[label.full] for label in leaves(self.model.labels.u)]
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


def sample_plan(
    task: SamplingTask, x: Array, former: SampledPlan | None = None, *, elapsed: float | None = None
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

    Returns
    -------
    SampledPlan
        The cheapest of the weighted mean and the best candidate.

    Raises
    ------
    SolverError
        If the vehicle cannot stand at ``x``, or a limit is violated there.
    """
    low, high = task.limits
    mean = np.tile((low + high) / 2, task.intervals)
    number = 0
    if former is not None:
        mean = _shifted(task, former.inputs, task.t[1] if elapsed is None else elapsed)
        number = former.cycle + 1
    inputs = _candidates(task, mean, number)
    costs, motions = _simulated(task, x, inputs)
    complete = motions.reason == COMPLETE
    if not (motions.end > 0).any():
        words = ", ".join(_ends(task, motions)) or "no pose was found"
        raise SolverError(f"sampling: the vehicle cannot start at this state: {words}")
    chosen = costs if np.isfinite(costs).any() else -motions.end
    both = np.stack([inputs @ _weights(chosen), inputs[..., int(chosen.argmin())]], axis=-1)
    values, run = _simulated(task, x, both)
    best = int(values.argmin() if np.isfinite(values).any() else run.end.argmax())
    rows = task.evaluate.graphs.rows.x
    return SampledPlan(
        both[..., best],
        run.samples[:, rows, best].T + task.model.shift[0][:, None],
        float(values[best]),
        float(complete.mean()),
        _ends(task, motions),
        number,
    )


def _shifted(task: SamplingTask, inputs: Array, elapsed: float) -> Array:
    """Return inputs of the last cycle from a later time on; the last ones are held."""
    middles = task.t[:-1] + 0.5 * task.t[1] + elapsed
    index = np.clip((middles / task.t[1]).astype(int), 0, task.intervals - 1)
    return np.asarray(inputs[:, index])


def _candidates(task: SamplingTask, mean: Array, number: int) -> Array:
    """Return inputs of candidates, shape (n_u, intervals, candidates); the first is the mean."""
    low, high = task.limits
    rng = np.random.default_rng((task.seed, number))
    noise = rng.standard_normal((*mean.shape, task.candidates))
    for k in range(1, task.intervals):
        noise[:, k] = CORRELATION * noise[:, k - 1] + np.sqrt(1 - CORRELATION**2) * noise[:, k]
    noise[..., 0] = 0.0
    spread = task.spread * (high - low)
    return np.clip(mean[..., None] + spread[..., None] * noise, low[..., None], high[..., None])


def _simulated(task: SamplingTask, x: Array, inputs: Array) -> tuple[Array, Motions]:
    """Return costs and motions of inputs (n_u, intervals, n)."""
    rows, n = task.evaluate.graphs.rows, inputs.shape[-1]
    states = np.zeros((rows.t.stop, 1))
    states[rows.x, 0] = x - task.model.shift[0]
    states[rows.c] = np.reshape([each.value for each in task.model.p], (-1, 1))
    states[rows.stage] = np.reshape(task.evaluate.graphs.stages[-1:], (-1, 1))
    if not solve_positions(task.evaluate, states).all():
        raise SolverError("sampling: no pose was found at this state; correct it")
    step = STEP * task.model.size
    is_parallel = task.evaluate.is_compiled and task.evaluate_costs.is_compiled
    parts = np.array_split(np.arange(n), min(task.threads, n) if is_parallel else 1)

    def run(part: Indices) -> tuple[Array, Motions]:
        many = np.repeat(states, part.size, axis=1)
        motions = candidate_lanes(task.evaluate, many, inputs[..., part], task.t, step)
        return _costs(task, motions, inputs[..., part]), motions

    if len(parts) == 1:
        return run(parts[0])
    with ThreadPoolExecutor(task.threads) as pool:
        results = list(pool.map(run, parts))
    costs = np.concatenate([cost for cost, _ in results])
    motions = zip(*(found for _, found in results), strict=True)
    return costs, Motions(*(np.concatenate(each, axis=-1) for each in motions))


def _costs(task: SamplingTask, motions: Motions, inputs: Array) -> Array:
    """Return the costs of motions by the trapezoidal rule; infinite for early ends."""
    evaluate, graphs, rows = (
        task.evaluate_costs,
        task.evaluate_costs.graphs,
        task.evaluate.graphs.rows,
    )
    prepare = solve_forces if task.has_forces else derivatives
    total = np.zeros(motions.end.size)
    with np.errstate(all="ignore"):
        for k, h in enumerate(np.diff(task.t)):
            for states in (motions.samples[k], motions.samples[k + 1]):
                part = states.copy()
                part[rows.u] = inputs[:, k]
                prepare(task.evaluate, part)
                total += 0.5 * h * evaluate(graphs.running, part)[0]
        total += evaluate(graphs.final, motions.samples[-1])[0]
    return np.where((motions.reason == COMPLETE) & np.isfinite(total), total, np.inf)


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


def _ends(task: SamplingTask, motions: Motions) -> dict[str, int]:
    """Return the numbers of early ends by words."""
    labels = [each.label for part in (task.model.limits, task.model.checks) for each in part]
    words = {k: label.words for k, label in enumerate(labels)}
    words |= {UNSOLVED: "Newton's method did not follow the contacts", INVALID_START: NEAR_GROUND}
    beyond = (motions.reason == INVALID_START) & (margins(motions.distances) < 0)
    bounds = np.array(task.evaluate.graphs.bounds)[smallest(motions.distances)]
    codes = np.where(beyond, bounds, motions.reason)
    return dict(Counter(words[code] for code in codes[codes != COMPLETE].tolist()))
