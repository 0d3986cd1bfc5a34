"""Estimates of unknowns, with covariance and identifiable directions; calibration on a log.

The residuals are the differences between predicted and measured poses at the ends of the windows,
divided by their standard deviations, which follow from the residuals themselves. The estimate
minimises a robust loss of the residuals and of the deviations from priors (Gauss-Newton with trust
region, `scipy.optimize.least_squares`, exact Jacobian). The covariance is the sandwich estimate for
independent groups: ``B^-1 M B^-1`` with the Hessian ``B`` of the loss without second derivatives of
the prediction, and ``M`` the sum over the groups of the products of their gradients (Huber, Robust
Statistics, 1981, 6.3; Liang and Zeger, Biometrika 73, 1986). Groups are windows, manoeuvres, whole
logs, or runs of a wheel.

The estimate follows groups that alone determine an unknown, such as the windows in which friction
saturates, and their gradients are then too small. Gradients are therefore enlarged by the leverage
of their group, and intervals are those of Student's distribution, whose degrees of freedom are the
effective number of groups of each unknown (Bell and McCaffrey, Survey Methodology 28, 2002).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, get_type_hints

import numpy as np
import scipy  # its parts are imported when they are used, since this takes 0.2 s

from slipfree.core.errors import ModelError, read_table
from slipfree.core.records import Array, Indices, Label
from slipfree.core.schema import keys_of
from slipfree.system.interrupt import check_interrupt


@dataclass(frozen=True)
class Unknown:
    """A number to be fitted.

    Attributes
    ----------
    name : str
        Name in results.
    quantity : str
        One of `BALANCE`, or a constant of a law.
    wheels : tuple of str
        Names of the wheels that share the number, for a quantity of wheels; empty for all wheels.
    lower, upper : float
        Bounds, in the unit of the quantity; infinite for none.
    prior : tuple of 2 floats or None
        Mean and standard deviation of a normal prior, in the unit of the quantity.
    of : str
        Name of the surface or campaign whose number it is; by default of all.

    Raises
    ------
    ModelError
        If the bounds are not in ascending order, or the deviation of the prior is not positive.
    """

    name: str
    quantity: str
    wheels: tuple[str, ...] = ()
    lower: float = -math.inf
    upper: float = math.inf
    prior: tuple[float, float] | None = None
    of: str = ""

    def __post_init__(self) -> None:
        self.check_bounds(self.lower, self.upper, "; correct them")
        if self.prior is not None and not 0 < self.prior[1] < math.inf:
            raise ModelError(
                f"unknown {self.name!r}: expected a finite positive standard deviation of the "
                f"prior, found {self.prior[1]:g}; correct it"
            )

    def check_bounds(self, lower: float, upper: float, words: str) -> None:
        """Raise ModelError with ``words`` at its end unless bounds are in ascending order."""
        if not lower < upper:
            raise ModelError(
                f"unknown {self.name!r}: expected a lower bound below the upper one, found "
                f"{lower:.4g} and {upper:.4g}{words}"
            )


class BalanceQuantity(NamedTuple):
    """A number of the force balance, its usual value, bounds and prior."""

    unit: str  # unit and description
    words: str
    start: float
    bounds: tuple[float, float]
    deviation: float  # of the prior; of the natural logarithm if ``is_log``
    is_log: bool = False
    of: str = ""  # "surface" or "campaign": each may have its own number


BALANCE = {
    name: BalanceQuantity(**{**row, "bounds": tuple(row["bounds"])})
    for name, row in read_table(__file__, "balance.toml").items()
}


def check_nominal(
    unknown: Unknown, value: float, limits: tuple[float, float], subject: str
) -> None:
    """Raise ModelError unless the value of a ``subject`` before the fit is within the bounds."""
    low, high = limits
    if not low <= value <= high:
        raise ModelError(
            f"unknown {unknown.name!r}: expected a nominal value within the bounds, {low:g} to "
            f"{high:g}, found {value:g}; change the bounds, or the {subject}"
        )


def law_limits(unknown: Unknown, law: Any) -> tuple[float, float]:
    """Return the bounds of a constant of a law: its own, and those of its annotation."""
    least, most = unknown.lower, unknown.upper
    hint = get_type_hints(type(law), include_extras=True)[unknown.quantity]
    for bound in getattr(hint, "__metadata__", ()):
        least = max(least, getattr(bound, "gt", least), getattr(bound, "ge", least))
        most = min(most, getattr(bound, "lt", most), getattr(bound, "le", most))
    return least, most


def law_constants(law: Any) -> dict[str, Label]:
    """Return the constants of a law, by name, from the annotations of its dataclass."""
    return {key.name: Label(key.name, key.unit or "1", key.meaning) for key in keys_of(type(law))}


REWEIGHTINGS = 4  # estimates, each with the deviations of the residuals of the one before
NORMAL_MEDIAN = 0.6745  # median of the absolute value of a standard normal variable
SINGULAR = 1e-12  # smaller eigenvalues of the Hessian, over the largest, count as zero
KNOWN = 0.1  # larger eigenvalues never do: priors have at least one
LOST_SHARE = 1e-6  # share of an undetermined direction from which an unknown is undetermined
WEAK = 0.1  # deviation of a direction, relative to its scale, from which it is weakly determined
CONFIDENCE = 0.95
EDGES = 0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2  # of confidence intervals, as shares of draws
RESAMPLES = 2000  # of a bootstrap
MIN_ACCEPTED = 2  # accepted values, with the start, from which an interrupted fit is kept
EDGE = 1e-4  # distance of estimates from their bounds [scales]
MAX_LEVERAGE = 0.99  # of a group on an estimate
AT_BOUND = 1e-3  # distance from a bound that counts as zero [scales]


class Direction(NamedTuple):
    """A combination of unknowns, with its standard deviation."""

    deviation: float  # relative to the scales of the unknowns; infinite if undetermined
    weights: Array  # shape (n,): components in units of the scales; a unit vector


class Estimate(NamedTuple):
    """Result of a calibration with n unknowns."""

    labels: tuple[Label, ...]  # names, units and descriptions of the unknowns
    nominal: Array  # shape (n,): values before and after the fit, in the unit of each label
    values: Array
    covariance: Array  # shape (n, n): infinite if undetermined, zero at a bound
    intervals: Array  # shape (n, 2): 95 % confidence intervals
    scales: Array  # shape (n,): sizes of the unknowns: deviation of the prior, or nominal value
    at_bound: tuple[bool, ...]  # whether it is at a bound; its interval is then that value
    directions: tuple[Direction, ...]  # principal, of the covariance, best determined first
    deviations: Array  # of the residuals: two of position [m], and heading [rad]
    is_interrupted: bool = False  # by Ctrl-C: values of the last accepted step

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of the unknowns whose standard deviation is larger than their scale."""
        wide = np.sqrt(np.diag(self.covariance)) > self.scales
        return tuple(
            label.name for label, is_wide in zip(self.labels, wide, strict=True) if is_wide
        )


class Prediction(NamedTuple):
    """Predicted quantities, such as end poses of windows, and their derivatives."""

    values: Array  # shape (n, m): as those measured, for end poses ``Windows.end`` [m, m, rad]
    slopes: Array  # shape (n, m, n_unknowns): derivatives with respect to the unknowns


class Predicting(Protocol):
    """Protocol of predictions as a function of the unknowns."""

    def __call__(self, values: Array) -> Prediction:
        """Return the prediction for values of the unknowns; MotionError if there is none."""

    def accept(self, values: Array) -> Prediction:
        """Return the prediction for values from which a search goes on, with derivatives."""


class Priors(NamedTuple):
    """Indices of the unknowns with a prior, its mean values and standard deviations."""

    rows: Indices
    mean: Array
    deviation: Array

    @classmethod
    def of(cls, unknowns: Sequence[Unknown]) -> Priors:
        """Return the priors of unknowns."""
        rows = [k for k, each in enumerate(unknowns) if each.prior is not None]
        pairs = np.array([unknowns[k].prior for k in rows], dtype=float).reshape(-1, 2)
        return cls(np.array(rows, dtype=int), pairs[:, 0], pairs[:, 1])

    def missed(self, values: Array) -> Array:
        """Return the differences of values from the mean, over the deviations."""
        return np.asarray((values[self.rows] - self.mean) / self.deviation)

    def slopes(self, count: int) -> Array:
        """Return the derivatives of these differences by all unknowns."""
        return np.asarray(np.eye(count)[self.rows] / self.deviation[:, None])


class Sought(NamedTuple):
    """Unknowns of a search, with bounds that leave out the ends of intervals, sizes and priors."""

    labels: tuple[Label, ...]
    nominal: Array  # shape (p,)
    bounds: tuple[Array, Array]
    scales: Array
    priors: Priors


def inner_bounds(limits: Array, scales: Array) -> tuple[Array, Array]:
    """Return lower and upper bounds within limits, shape (p, 2), without their ends."""
    margin = np.minimum(EDGE * scales, (limits[:, 1] - limits[:, 0]) / 4)
    return limits[:, 0] + margin, limits[:, 1] - margin


class Residuals:
    """Residuals and their Jacobian at sought values, without unit; accepted and rejected values.

    `scipy.optimize.least_squares` rejects a trial whose residuals are not finite, and requests the
    Jacobian only where it accepts one. Measured values (n, m) may be NaN: not measured.
    """

    def __init__(
        self, predict: Predicting, measured: Array, deviations: Array, sought: Sought
    ) -> None:
        self._predict, self._measured, self._known = predict, measured, np.isfinite(measured)
        self._deviations, self._sought = deviations, sought
        self.accepted = list[Array]()  # the first is the start

    def run(self, start: Array, **options: float) -> Any:
        """Return the result of `scipy.optimize.least_squares`, with options of its tolerances."""
        return scipy.optimize.least_squares(
            self._residual,
            np.clip(start, *self._sought.bounds),
            self._jacobian,
            bounds=self._sought.bounds,
            x_scale=self._sought.scales,
            loss="soft_l1",
            **options,
        )

    def _residual(self, values: Array) -> Array:
        check_interrupt()
        missed = (self._predict(values).values - self._measured) / self._deviations
        return np.append(missed[self._known], self._sought.priors.missed(values))

    def _jacobian(self, values: Array) -> Array:
        self.accepted.append(values.copy())
        slopes = self._predict.accept(values).slopes / self._deviations[:, None]
        return np.concatenate([slopes[self._known], self._sought.priors.slopes(values.size)])

    def estimate(self, values: Array, prediction: Prediction, groups: Array | Indices) -> Estimate:
        """Return the estimate for a prediction at its values.

        The rows of a prediction belong to independent ``groups``, shape (n,).
        """
        labels, nominal, bounds, scales, priors = self._sought
        edges = np.minimum(np.abs(values - bounds[0]), np.abs(values - bounds[1]))
        at_bound = edges < AT_BOUND * scales
        # residuals, shape (n, m), and derivatives by the p free unknowns in units of their scales
        free, known = ~at_bound, self._known
        missed = (prediction.values - self._measured) / self._deviations
        slopes = prediction.slopes[..., free] / self._deviations[:, None] * scales[free]
        missed, slopes = np.where(known, missed, 0.0), np.where(known[..., None], slopes, 0.0)
        of_row = np.unique(groups, return_inverse=True)[1].ravel()
        size = 1 + missed**2
        count, p = int(of_row.max()) + 1, int(free.sum())
        scores, parts = np.zeros((count, p)), np.zeros((count, p, p))
        np.add.at(scores, of_row, np.einsum("ni,nip->np", missed / np.sqrt(size), slopes))
        np.add.at(parts, of_row, np.einsum("nip,ni,niq->npq", slopes, size**-1.5, slopes))
        prior = np.diag((priors.slopes(scales.size).sum(axis=0) * scales)[free] ** 2)
        eigenvalues, vectors = np.linalg.eigh(parts.sum(axis=0) + prior)
        lost = eigenvalues <= min(SINGULAR * max(eigenvalues.max(initial=0.0), 1e-300), KNOWN)
        half = vectors[:, ~lost] / np.sqrt(eigenvalues[~lost])  # half @ half.T: inverse Hessian
        leverage, axes = np.linalg.eigh(half.T @ parts @ half)
        larger = np.sqrt(1 - np.minimum(leverage, MAX_LEVERAGE))
        scores = np.einsum(
            "gij,gj->gi", axes, np.einsum("gij,gi->gj", axes, scores @ half) / larger
        )
        own = half.T @ prior @ half
        scaled = half @ (scores.T @ scores + own) @ half.T
        shares = np.einsum("pi,gij,pj->gp", half, half.T @ parts @ half, half)  # of the variances
        total = shares.sum(axis=0) + np.diag(half @ own @ half.T)
        freedom = np.ones(scales.size)  # degrees of each unknown
        freedom[free] = np.maximum(total**2 / np.maximum((shares**2).sum(axis=0), 1e-300) - 1, 1)
        undetermined = (vectors[:, lost] ** 2).sum(axis=1) > LOST_SHARE
        covariance = np.zeros((scales.size, scales.size))
        part = scaled * np.outer(scales[free], scales[free])
        part[np.diag_indices(p)] = np.where(undetermined, np.inf, np.diag(part))
        covariance[np.ix_(free, free)] = part
        reach = scipy.special.stdtrit(freedom, EDGES[1]) * np.sqrt(np.diag(covariance))
        kept = vectors[:, ~lost]
        squares, turns = np.linalg.eigh(kept.T @ scaled @ kept)
        found = np.sqrt(np.maximum(squares, 0.0)), np.full(int(lost.sum()), np.inf)
        principal = np.hstack([kept @ turns, vectors[:, lost]])
        largest, least = (f(axis=0, initial=0.0) for f in (principal.max, principal.min))
        signs = np.where(largest < -least, -1.0, 1.0)  # of the largest components
        return Estimate(
            labels,
            nominal,
            values,
            covariance,
            np.column_stack([values - reach, values + reach]),
            scales,
            tuple(at_bound.tolist()),
            tuple(map(Direction, np.concatenate(found).tolist(), (signs * principal).T)),
            self._deviations,
        )


class Interval(NamedTuple):
    """A statistic, and its 95 % confidence interval."""

    value: float
    lower: float
    upper: float


def bootstrap(
    rows: Array | Indices, statistic: Callable[[Any], float], draws: int = RESAMPLES
) -> Interval:
    """Return a statistic of rows, shape (n, ...), with its 95 % interval by resampling rows."""
    rng = np.random.default_rng(0)
    values = [statistic(rows[rng.integers(0, len(rows), len(rows))]) for _ in range(draws)]
    low, high = np.quantile(values, EDGES)
    return Interval(statistic(rows), float(low), float(high))
