"""Build an optimal control problem from a model and from costs, limits and goals by name."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, repeat
from typing import Annotated, TypeVar

import casadi as ca
import numpy as np

from slipfree.core.arguments import ASCENDING, BY_NAME
from slipfree.core.dae import Dae, Limit
from slipfree.core.errors import ModelError, check_known
from slipfree.core.facts import SCALES
from slipfree.core.records import Array, Mask, leaves
from slipfree.core.trajectory import Trajectory
from slipfree.plan.constraints import LIMITED_SUFFIX, conflicts, unit_words
from slipfree.plan.stage import Cost
from slipfree.plan.transcription import PlanTask, TimedCondition
from slipfree.solve.sampling import TURN, periodic_states

DURATIONS = (0.5, 2.0)  # default range of the duration, relative to that of the initial guess
HALF_TURN = np.pi + 1e-3  # such as a goal of 3.1416: both ways are short [rad]
Term = TypeVar("Term", Limit, Cost)
Range = Annotated[tuple[float, float], ASCENDING]
# values or ranges by name, or limits in the symbols of the model
Conditions = Annotated[Mapping[str, float | Range], BY_NAME] | Sequence[Limit]
MIN_CLEARANCE = 1e-3  # clearances below this all have about the same cost [m]
BLENDED_POWER = 0.1  # width of the smooth transition between work and braking [W]
ROUNDED_FRACTION = 0.01  # rounding of a square root at zero, relative to its bound


def range_of(value: float | Range) -> Range:
    """Return the bounds of a number or of a range."""
    ends = np.ravel(value)
    return float(ends[0]), float(ends[-1])


def spelled(bounds: Range, unit: str = "") -> str:
    """Return the text of a range, or of a value if both bounds are equal; angles in degrees."""
    scale, shown = (SCALES["deg"], "deg") if unit == "rad" else (1.0, unit_words(unit))
    low, high = (f"{round(scale * each, 6):.10g}" for each in bounds)
    return f"{low if low == high else f'{low} to {high}'} {shown}".rstrip()


def free_durations(durations: Sequence[float]) -> Range:
    """Return the default range of the duration of a plan from initial guesses [s]."""
    return DURATIONS[0] * min(durations), DURATIONS[1] * max(durations)


def duration_of(value: float | Range) -> Range:
    """Return the smallest and the largest duration in s, from a number or a range."""
    low, high = range_of(value)
    if not 0 < low <= high < np.inf:
        raise ModelError(
            "plan: duration: expected a positive, finite duration or an ascending range of such "
            f"durations (smallest, largest), found {value} s; correct it"
        )
    return low, high


def costs_of(dae: Dae, costs: Mapping[str, float] | Sequence[Cost]) -> tuple[Cost, ...]:
    """Return the terms of the cost from weights by name, or terms unchanged."""
    if not isinstance(costs, Mapping):
        return _scalars(costs)
    return tuple(_cost_term(dae, name)._replace(weight=weight) for name, weight in costs.items())


def _scalars(terms: Sequence[Term]) -> tuple[Term, ...]:
    """Return terms unchanged; ModelError is raised unless the expression of each is a scalar."""
    for each in terms:
        if (shape := each.expression.shape) != (1, 1):
            raise ModelError(
                f"plan: {each.label.full}: expected a scalar expression, found one of shape "
                f"{shape}; give each of its entries its own limit or cost"
            )
    return tuple(terms)


def cost_limits_of(
    dae: Dae, costs: Sequence[Cost], highest_of: Mapping[str, float]
) -> tuple[tuple[Cost, ...], tuple[tuple[int, float], ...]]:
    """Return the terms of the cost, with weight 0 if only limited, and the limits by index."""
    names, terms = [cost.name for cost in costs], list(costs)
    limits = list[tuple[int, float]]()
    for name, highest in highest_of.items():
        if name not in names:
            names.append(name)
            terms.append(_cost_term(dae, name)._replace(weight=0.0))
        limits.append((names.index(name), float(highest)))
    return tuple(terms), tuple(limits)


def _cost_term(dae: Dae, name: str) -> Cost:
    """Return the term of the cost with a name, such as ``"time"``, with weight 1."""
    if name == "time":
        return Cost(name, ca.SX(1), "s", "duration")
    if name == "effort":
        units = {label.unit for label in leaves(dae.labels.u)}
        unit = "N2 m2 s" if units & {"N m", "N"} else "rad2 s-1"
        return Cost(name, ca.sumsqr(ca.vertcat(*leaves(dae.u))), unit, "squared inputs")
    if name == "slip":
        slip = ca.sumsqr(ca.vertcat(*dae.named("slip_along"), *dae.named("slip_across")))
        return Cost(name, slip, "m2 s-1", "squared slip of all wheels")
    if name == "clearance_body":  # a square would price clearance instead of its lack
        (distance,) = dae.named(name)
        inverse = 1 / (distance**2 + MIN_CLEARANCE**2)
        return Cost(name, inverse, "s m-2", "inverse square of the clearance of the body")
    if name == "energy":
        return Cost(name, _driving_power(dae), "J", "work of the drives, without braking")
    away = dae.reported.get(name, 0.0)
    terms = (each + away if away else each for each in dae.named(name))
    # the square of a square root ``sqrt(e)`` is ``e``, which is differentiable at zero
    squares = ca.SX(sum(each.dep(0) if each.op() == ca.OP_SQRT else each**2 for each in terms))
    meaning = f"squared {name}, integrated over time"
    unit = next(each.unit for each, _ in dae.quantities if name in (each.name, each.full))
    return Cost(name, squares, "s" if unit == "1" else f"({unit})2 s", meaning)


def _driving_power(dae: Dae) -> ca.SX:
    """Return the sum of the positive drive powers [W], smooth where a power changes sign.

    A power ``p`` contributes ``p (1 + tanh(p / e)) / 2`` with ``e`` = `BLENDED_POWER`, which is
    zero at standstill, and exact where the size of ``p`` is large.
    """
    pairs = zip(dae.named("drive_torque"), dae.named("wheel_rate"), strict=True)
    powers = [torque * rate for torque, rate in pairs]
    return ca.SX(sum(p * (1 + ca.tanh(p / BLENDED_POWER)) / 2 for p in powers))


def limits_of(dae: Dae, limits: Conditions) -> tuple[Limit, ...]:
    """Return limits from values or ranges by name, in map coordinates, or limits unchanged."""
    if not isinstance(limits, Mapping):
        return _scalars(limits)
    return tuple(limit for name, value in limits.items() for limit in _conditions(dae, name, value))


def _conditions(dae: Dae, name: str, bounds: float | Range) -> Iterator[Limit]:
    """Yield limits on a quantity, given in map coordinates; one per wheel for wheel quantities."""
    low, high = range_of(bounds)
    is_known = False
    shifts = chain(*dae.shift, repeat(0.0))  # states and unknowns are in local coordinates
    for (label, expression), shift in zip(dae.quantities, shifts, strict=False):
        if name in (label.name, label.full):
            away = dae.reported.get(label.full, 0.0) + float(shift)
            meaning = f"{label.words}{LIMITED_SUFFIX}"
            own = replace(label, name=f"{label.name}_limit", words=meaning)
            yield _smooth_limit(Limit(own, expression, low - away, high - away))
            is_known = True
    for limit in dae.all_limits:
        if name in (limit.label.name, limit.label.full):
            own = replace(limit.label, words=f"{limit.label.words}{LIMITED_SUFFIX}")
            narrow = limit._replace(lower=max(low, limit.lower), upper=min(high, limit.upper))
            yield narrow._replace(label=own)
            is_known = True
    if not is_known:
        dae.named(name)  # raises an error with the known names


def _smooth_limit(limit: Limit) -> Limit:
    """Return a limit on a square root that is differentiable where its argument vanishes.

    ``sqrt(e) <= b`` is equivalent to ``sqrt(e + d^2) <= sqrt(b^2 + d^2)`` for every ``d``.
    """
    if limit.expression.op() != ca.OP_SQRT or limit.upper <= 0:
        return limit
    tip = (ROUNDED_FRACTION * limit.upper) ** 2 if np.isfinite(limit.upper) else ROUNDED_FRACTION**2
    low = -np.inf if limit.lower <= 0 else float(np.sqrt(limit.lower**2 + tip))
    high = float(np.sqrt(limit.upper**2 + tip))
    return limit._replace(expression=ca.sqrt(limit.expression.dep(0) + tip), lower=low, upper=high)


def timed_conditions(
    dae: Dae, goal: Conditions, way_points: Mapping[float, Conditions]
) -> Iterator[TimedCondition]:
    """Yield the conditions at the way-points in order of time, then those at the goal."""
    for fraction, wanted in sorted(way_points.items()):
        if not 0 < fraction < 1:
            raise ModelError(
                "plan: way_points: expected fractions of the duration above 0 and below 1, found "
                f"{fraction:g}; correct it, or use the goal for conditions at the end"
            )
        yield TimedCondition(fraction, limits_of(dae, wanted))
    yield TimedCondition(1.0, limits_of(dae, goal))


def bounds_of(dae: Dae, ranges: Mapping[str, Range]) -> Array:
    """Return the bounds of all inputs, infinite for inputs without bounds, shape (n_u, 2)."""
    names = dae.input_names
    bounds = np.tile([-np.inf, np.inf], (len(names), 1))
    check_known("plan: bounds of inputs", ranges, names)
    for name, value in ranges.items():
        bounds[names.index(name)] = range_of(value)
    return bounds


def task_of(
    dae: Dae,
    start: Trajectory,
    *,
    goal: Conditions,
    costs: Mapping[str, float] | Sequence[Cost],
    duration: float | Range | None = None,
    smooth: float = 0.0,
    continuous: bool = True,
    limits: Conditions = (),
    way_points: Mapping[float, Conditions] | None = None,
    inputs: Mapping[str, Range] | None = None,
    accelerations: Mapping[str, Range] | None = None,
    cost_limits: Mapping[str, float] | None = None,
    initial_inputs: Mapping[str, float] | None = None,
) -> PlanTask:
    """Return the optimal control problem of a plan; arguments as in `slipfree.plan.plan.plan`.

    `check_task` finds contradictory bounds.
    """
    if not goal:
        raise ModelError(
            "plan: goal: expected values or ranges by name, found none; give at least one"
        )
    terms, highest = cost_limits_of(dae, costs_of(dae, costs), cost_limits or {})
    begin = dae.rows("x", start, -1)
    own = limits_of(dae, limits)
    # Bounds of all inputs at the beginning, equal for given values, shape (n_u, 2).
    ranges, initial = inputs or {}, initial_inputs or {}
    bounds = bounds_of(dae, ranges)
    values = bounds_of(dae, {name: (value, value) for name, value in initial.items()})
    fixed = np.clip(values, bounds[:, :1], bounds[:, 1:])
    for name, value in initial.items():
        low, high = range_of(ranges.get(name, (-np.inf, np.inf)))
        if not low <= value <= high:
            raise ModelError(
                f"plan: initial_inputs: expected an initial value of {name!r} from {low:g} to "
                f"{high:g}, its bounds, found {value:g}; choose a value in this range or widen "
                "the bounds"
            )
    return PlanTask(
        dae,
        begin,
        (0.0, np.inf) if duration is None else duration_of(duration),
        terms,
        tuple(timed_conditions(dae, goal, way_points or {})),
        (*own, *(dae.replay.limits if dae.replay else ())),
        bounds,
        bounds_of(dae, accelerations or {}),
        smooth,
        continuous,
        highest,
        fixed,
        periodic_states(dae, begin, own),
    )


def check_task(task: PlanTask, start: Trajectory) -> None:
    """Raise ModelError if start, goal, way-points and limits of a task contradict each other."""
    if wrong := conflicts(task, start):
        raise ModelError("plan: " + "; ".join(wrong))


def near_conditions(
    dae: Dae,
    conditions: Sequence[TimedCondition],
    periodic: Mask,
    motions: Sequence[Callable[[float], Array]],
) -> tuple[TimedCondition, ...]:
    """Return conditions with whole turns added to values and ranges of periodic states.

    A condition is kept if it is within half a turn of one of the motions, or if its range is a turn
    or more; otherwise it gets the turns that bring it nearest to the first motion.
    """
    symbols = [(k, x) for k, x in enumerate(leaves(dae.x)) if periodic[k]]
    near_ones = []
    for condition in conditions:
        states = [motion(condition.fraction) for motion in motions]
        limits = []
        for limit in condition.limits:
            k = next((k for k, x in symbols if ca.is_equal(limit.expression, x)), None)
            if k is not None and limit.upper - limit.lower < TURN:
                middle = (limit.lower + limit.upper) / 2
                values = [float(each[k]) for each in states]
                if min(abs(value - middle) for value in values) > HALF_TURN:
                    turns = TURN * round((values[0] - middle) / TURN)
                    limit = limit._replace(lower=limit.lower + turns, upper=limit.upper + turns)
            limits.append(limit)
        near_ones.append(condition._replace(limits=tuple(limits)))
    return tuple(near_ones)
