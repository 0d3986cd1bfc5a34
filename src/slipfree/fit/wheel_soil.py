"""Fit of the constants of a soil to single-wheel tests, with cross-validation.

The residuals are computed minus measured drawbar pull, side force, torque and sinkage, divided by a
deviation of each quantity. The estimate minimises a robust loss of the residuals and of the
deviations from priors, with exact derivatives; its covariance is that of `slipfree.fit.estimate`
for independent runs. Cross-validation predicts each run by constants fitted to runs of other parts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Any, NamedTuple

import casadi as ca
import numpy as np
from annotated_types import Ge, Le

from slipfree.core.errors import ModelError, check_known
from slipfree.core.records import Array
from slipfree.fit.estimate import (
    EDGES,
    NORMAL_MEDIAN,
    REWEIGHTINGS,
    Estimate,
    Interval,
    Prediction,
    Priors,
    Residuals,
    Sought,
    Unknown,
    bootstrap,
    check_nominal,
    inner_bounds,
    law_constants,
    law_limits,
)
from slipfree.laws.soil import STEADY_CREEP, Soil, WheelSize, depth_under_load, forces_at_speeds
from slipfree.models.single_wheel import WheelRuns
from slipfree.system.interrupt import interrupt_requested
from slipfree.vehicle.tree import EARTH_GRAVITY

QUANTITIES = {"pull": "N", "side": "N", "torque": "N m", "sinkage": "m"}
FIRST_SHARE = 0.3  # of the variation of a quantity, as deviation of residuals in the first estimate
SAME_MOTION = 0.05  # largest difference of the speeds of repeats, over the largest speed
LEAST_SHARE = 0.02  # of the largest value of a quantity, as deviation without repeats
BY_PEAKS = " with the limits of 'peak' and 'peak_rate'; change the bounds, or fit only one of both"
SMALLEST = 1e-9  # deviation of a quantity that is not measured, or fitted exactly
TOLERANCE = 1e-7  # of searches
NOT_STEADY = ("damping_ratio", "creep", "regions", "coupled_shear")  # of a soil
STEADY_CONSTANTS = tuple(name for name in law_constants(Soil()) if name not in NOT_STEADY)


class WheelModel:
    """Functions of the forces on a wheel for constants, depth and motion, and derivatives."""

    def __init__(
        self, soil: Soil, size: WheelSize, unknowns: Sequence[Unknown], gravity: float
    ) -> None:
        values, depth, motion = (
            ca.SX.sym(name, rows)
            for name, rows in (("values", len(unknowns)), ("depth", 1), ("motion", 3))
        )
        symbols: dict[str, Any] = {u.quantity: values[k] for k, u in enumerate(unknowns)}
        speeds = motion[0], motion[1], motion[2]
        forces = forces_at_speeds(
            replace(soil, **symbols), size, depth, *speeds, STEADY_CREEP, gravity
        )
        rows = ca.vertcat(forces.pull, -ca.sign(motion[2]) * forces.side, forces.torque)
        normal = ca.vertcat(forces.normal, ca.jacobian(forces.normal, depth))
        slopes = [ca.densify(ca.jacobian(rows, by)) for by in (depth, values)]
        softer = ca.densify(ca.jacobian(forces.normal, values))
        arguments = [values, depth, motion]
        self.normal = ca.Function("normal", arguments, [normal])
        self.forces = ca.Function("forces", arguments, [rows, *slopes, normal[1], softer])
        self.radius = size.radius


class WheelPredictor:
    """Forces and sinkage of a wheel in given runs, and derivatives by the unknowns."""

    def __init__(self, model: WheelModel, runs: WheelRuns) -> None:
        count = runs.load.size
        self._normal, self._forces = model.normal.map(count), model.forces.map(count)
        self._runs, self._radius, self._depth = runs, model.radius, np.full(count, model.radius / 4)
        self._last: tuple[Array, Prediction] | None = None

    def __call__(self, values: Array) -> Prediction:
        """Return pull, side, torque and sinkage, shape (n, 4), and derivatives (n, 4, p)."""
        if self._last is not None and np.array_equal(self._last[0], values):
            return self._last[1]
        runs, many = self._runs, np.tile(values[:, None], self._runs.load.size)
        self._depth = depth = depth_under_load(
            lambda h: self._normal(many, h[None], runs.motion).full(),
            self._radius,
            runs.load,
            self._depth,
        )
        rows, by_depth, by_values, stiffness, softer = (
            each.full() for each in self._forces(many, depth[None], runs.motion)
        )
        count = depth.size
        # a wheel that has sunk to its axle stays there
        sinking = -softer.reshape(count, values.size) / stiffness.T
        sinking[depth >= self._radius] = 0
        direct = by_values.reshape(3, count, -1).transpose(1, 0, 2)
        slopes = direct + by_depth.T[..., None] * sinking[:, None]
        slopes = np.concatenate([slopes, sinking[:, None]], axis=1)
        self._last = values.copy(), Prediction(np.column_stack([rows.T, depth]), slopes)
        return self._last[1]

    accept = __call__


class QuantityErrors(NamedTuple):
    """Root mean square errors of a quantity over all runs, in its unit, with 95 % intervals."""

    name: str
    points: int  # number of measured values
    variation: float  # standard deviation of the measured values
    repeats: float  # standard deviation between repeats; nan without repeats
    nominal: Interval  # with the constants before the fit
    validated: Interval  # of runs predicted by constants fitted to others


class SoilFit(NamedTuple):
    """Result of a fit of p constants of a soil to n points of a wheel."""

    estimate: Estimate
    soil: Soil  # with the fitted constants
    resampled: Array  # shape (p, 2): 95 % intervals of fits to runs drawn at random; nan without
    nominal: Array  # shape (n, 4): computed with the constants before and after the fit
    fitted: Array
    validated: Array  # shape (n, 4): each by constants fitted to other runs; nan if interrupted
    errors: tuple[QuantityErrors, ...]  # of the measured quantities
    excess: float  # deviation of the residuals over that of repeats; nan without repeats
    sunk: int  # number of points at which the fitted wheel sinks to its axle


def fit_soil(
    soil: Soil,
    size: WheelSize,
    unknowns: Sequence[Unknown],
    runs: WheelRuns,
    *,
    folds: Annotated[int, Ge(2), Le(1000)] = 5,
    resamples: Annotated[int, Ge(0), Le(10_000)] = 100,
    gravity: float = EARTH_GRAVITY,
) -> SoilFit:
    """Fit constants of a soil to runs of a wheel, and predict each run from the others.

    Parameters
    ----------
    soil : Soil
        Constants with which the search begins; those that are not unknowns stay.
    size : WheelSize
        Radius and width of the wheel.
    unknowns : sequence of Unknown
        Constants to be fitted, with bounds and priors.
    runs : WheelRuns
        Measured points. Those with the same number of a run stay together in cross-validation and
        bootstrap; they are repeats if their motion is the same.
    folds : int
        Number of parts of the runs, each predicted by a fit to the others; in a wheel file, by
        default at most that of the runs.
    resamples : int
        Number of fits to runs drawn at random, for intervals.
    gravity : float
        Gravitational acceleration, for the soil that the wheel pushes aside. [m/s^2]

    Raises
    ------
    ModelError
        If an unknown is no constant of steady motion in soil, there are fewer runs than folds or
        not more than unknowns without a prior, or the search does not converge.
    """
    problem = SoilProblem(soil, size, unknowns, runs, gravity)
    numbers = np.unique(runs.run)
    needed = max(sum(each.prior is None for each in unknowns) + 1, folds)
    if numbers.size < needed:
        raise ModelError(
            f"fit of soil: expected at least {needed} runs, for {len(unknowns)} unknowns and "
            f"{folds} folds, found {numbers.size}; give each measurement its own number in the "
            "column 'run', measure more, or reduce 'folds' or the unknowns"
        )
    spread = problem.spread
    values, deviations, converged = problem.solve(runs, problem.nominal)
    if not converged:
        raise ModelError(
            "fit of soil: expected convergence, found none; give bounds or priors of the "
            "unknowns, or fit fewer of them"
        )
    nominal, fitted = (problem.predict(runs, v)[0] for v in (problem.nominal, values))
    rng, validated = np.random.default_rng(0), np.full(runs.values.shape, np.nan)
    draws, is_interrupted = list[Array](), False
    fold = (rng.permutation(numbers.size) % folds)[np.searchsorted(numbers, runs.run)]
    rows_of = [np.flatnonzero(runs.run == number) for number in numbers]
    try:
        for k in range(folds):
            others, _, _ = problem.solve(runs.take(fold != k), problem.nominal)
            validated[fold == k] = problem.predict(runs.take(fold == k), others)[0]
        for _ in range(resamples):
            rows = np.concatenate([rows_of[k] for k in rng.integers(0, len(rows_of), len(rows_of))])
            draws.append(problem.search(runs.take(rows), values, deviations).x)
    except KeyboardInterrupt:
        if not interrupt_requested():
            raise
        is_interrupted = True
    errors = list[QuantityErrors]()
    for k, name in enumerate(QUANTITIES):
        known = np.isfinite(runs.values[:, k])
        if not known.any():
            continue
        intervals = []
        for computed in (nominal, validated):  # runs are drawn for the intervals
            squares = np.where(known, (computed[:, k] - runs.values[:, k]) ** 2, 0)
            sums = np.array([[squares[rows].sum(), known[rows].sum()] for rows in rows_of])
            intervals.append(
                bootstrap(sums, lambda s: float(np.sqrt(s[:, 0].sum() / max(s[:, 1].sum(), 1))))
            )
        measured = runs.values[known, k]
        numbers_of = measured.size, float(measured.std()), float(spread[k])
        errors.append(QuantityErrors(name, *numbers_of, *intervals))
    resampled = np.quantile(draws, EDGES, axis=0).T if draws else np.full((values.size, 2), np.nan)
    return SoilFit(
        problem.estimate(values, deviations)._replace(is_interrupted=is_interrupted),
        replace(soil, **dict(zip(problem.names, values.tolist(), strict=True))),
        resampled,
        nominal,
        fitted,
        validated,
        tuple(errors),
        float(np.nanmedian(deviations / spread)) if np.isfinite(spread).any() else np.nan,
        int((fitted[:, 3] >= size.radius).sum()),
    )


def repeat_spread(runs: WheelRuns) -> Array:
    """Return the pooled standard deviation between repeats of each quantity; nan without them.

    Points of one run are repeats if their speeds agree within 0.05 of the largest.
    """
    squares, freedom = np.zeros(len(QUANTITIES)), np.zeros(len(QUANTITIES))
    for number in np.unique(runs.run):
        rows = runs.run == number
        values = np.ma.masked_invalid(runs.values[rows])
        if len(values) > 1 and np.ptp(runs.motion[:, rows], axis=1).max() < SAME_MOTION:
            squares += np.ma.filled((values.anom(axis=0) ** 2).sum(axis=0), 0.0)
            freedom += np.maximum(values.count(axis=0) - 1, 0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(squares > 0, np.sqrt(squares / freedom), np.nan)


class SoilProblem:
    """Unknowns of a fit with their bounds and scales, and searches over parts of the runs."""

    def __init__(
        self,
        soil: Soil,
        size: WheelSize,
        unknowns: Sequence[Unknown],
        runs: WheelRuns,
        gravity: float = EARTH_GRAVITY,
    ) -> None:
        self._runs = runs
        self.spread = repeat_spread(runs)
        # Smallest deviation of each quantity. With priors, there may be fewer runs than unknowns:
        # their residuals vanish, and so would the robust deviation.
        share = LEAST_SHARE if np.unique(runs.run).size <= len(unknowns) else 0.0
        known = np.where(np.isfinite(runs.values), np.abs(runs.values), 0.0)
        self._least = np.where(np.isnan(self.spread), share * known.max(axis=0), 0.0) + SMALLEST
        self.names = [unknown.quantity for unknown in unknowns]
        for unknown in unknowns:
            check_constant(unknown, soil)
            if self.names.count(unknown.quantity) > 1:
                raise ModelError(
                    f"unknown {unknown.name!r}: expected each constant once, found "
                    f"{unknown.quantity!r} twice; remove one"
                )
        self.nominal = np.array([float(getattr(soil, name)) for name in self.names])
        limits = np.array([_limits(each, soil, self.names) for each in unknowns]).reshape(-1, 2)
        for unknown, (low, high) in zip(unknowns, limits.tolist(), strict=True):
            # the peaks of the stress limit each other
            unknown.check_bounds(low, high, BY_PEAKS)
        # deviation of the prior, nominal or usual value, or a tenth of the range
        sizes = [
            (unknown.prior and unknown.prior[1])
            or abs(value)
            or abs(float(getattr(Soil(), unknown.quantity)))
            or (high - low) / 10
            for unknown, value, (low, high) in zip(unknowns, self.nominal, limits, strict=True)
        ]
        scales, constants = np.array(sizes), law_constants(soil)
        labels = tuple(replace(constants[each.quantity], name=each.name) for each in unknowns)
        bounds = inner_bounds(limits, scales)
        self._sought = Sought(labels, self.nominal, bounds, scales, Priors.of(unknowns))
        self._model = WheelModel(soil, size, unknowns, gravity)

    def predict(self, runs: WheelRuns, values: Array) -> Prediction:
        """Return computed quantities and their derivatives, as `WheelPredictor`."""
        return WheelPredictor(self._model, runs)(values)

    def search(self, runs: WheelRuns, start: Array, deviations: Array) -> Any:
        """Return the result of `least_squares` for given deviations of the quantities."""
        search = Residuals(WheelPredictor(self._model, runs), runs.values, deviations, self._sought)
        return search.run(start, xtol=TOLERANCE, ftol=TOLERANCE)

    def solve(self, runs: WheelRuns, start: Array) -> tuple[Array, Array, bool]:
        """Return estimates, deviations of the quantities, and whether the last search converged."""
        values, converged = np.clip(start, *self._sought.bounds), False
        # not the residuals of the nominal constants: a quantity far off would keep a small weight
        mean = np.nanmean(np.where(np.isfinite(runs.values).any(axis=0), runs.values, 0), axis=0)
        deviations = self._deviations(FIRST_SHARE * (runs.values - mean))
        for k in range(REWEIGHTINGS):
            if k:
                deviations = self._deviations(self.predict(runs, values)[0] - runs.values)
            result = self.search(runs, values, deviations)
            values, converged = np.asarray(result.x), bool(result.status)
        return values, deviations, converged

    def _deviations(self, missed: Array) -> Array:
        """Return robust deviations of residuals, at least those of repeats."""
        missed = np.where(np.isfinite(missed).any(axis=0), missed, 0)  # no quantity without values
        robust = np.nanmedian(np.abs(missed), axis=0) / NORMAL_MEDIAN
        return np.fmax(np.fmax(robust, self.spread), self._least)

    def estimate(self, values: Array, deviations: Array) -> Estimate:
        """Return the estimate with its covariance, for independent runs."""
        scales, runs = np.maximum(self._sought.scales, np.abs(values)), self._runs
        predict = WheelPredictor(self._model, runs)
        search = Residuals(predict, runs.values, deviations, self._sought._replace(scales=scales))
        return search.estimate(values, predict(values), runs.run)


def check_constant(unknown: Unknown, soil: Soil) -> None:
    """Raise ModelError unless an unknown is a constant of steady motion, within its bounds."""
    name, quantity = unknown.name, unknown.quantity
    check_known(f"unknown {name!r}", [quantity], STEADY_CONSTANTS, "one of the constants of soil")
    check_nominal(unknown, getattr(soil, unknown.quantity), _limits(unknown, soil, ()), "soil")


def _limits(unknown: Unknown, soil: Soil, names: Sequence[str]) -> tuple[float, float]:
    """Return the bounds of a constant, with a stress that is largest ahead of the lowest point."""
    low, high = law_limits(unknown, soil)
    both = {"peak", "peak_rate"} <= set(names)
    if unknown.quantity == "peak":
        rate = 1 / 3 if both else soil.peak_rate
        low, high = max(low, rate), min(high, 1 - rate)
    elif unknown.quantity == "peak_rate":
        high = min(high, 1 / 3 if both else min(soil.peak, 1 - soil.peak))
    return low, high
