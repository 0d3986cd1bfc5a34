"""Estimates of unknowns, with covariance and identifiable directions; calibration on a log.

The residuals are the differences between predicted and measured poses at the ends of the windows,
divided by their standard deviations, which follow from the residuals themselves. The estimate
minimises a robust loss of the residuals and of the deviations from priors (Gauss-Newton with trust
region, `scipy.optimize.least_squares`, exact Jacobian). The covariance is the sandwich estimate for
independent windows: ``B^-1 M B^-1`` with the Hessian ``B`` of the loss without second derivatives
of the prediction, and ``M`` the sum over the windows of the products of their gradients (Huber,
Robust Statistics, 1981, 6.3; Liang and Zeger, Biometrika 73, 1986). Fits of soils and of motions
over a map minimise the same loss; their independent groups are the runs of a wheel, or whole logs.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
import scipy  # its parts are imported when they are used, since this takes 0.2 s

from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Indices, Label, Mask
from slipfree.fit.body_motion import BodyMotion, MotionError, Velocities, body_motion, velocities
from slipfree.fit.unknowns import (
    SENSOR,
    Unknown,
    label_of,
    limits_of,
    parametric_model,
    value_of,
)
from slipfree.fit.windows import Windows, end_poses
from slipfree.system.interrupt import check_interrupt, interrupt_requested
from slipfree.vehicle.tree import Vehicle

Loss = Literal["soft_l1", "linear"]
REWEIGHTINGS = 4  # estimates, each with the deviations of the residuals of the one before
NORMAL_MEDIAN = 0.6745  # median of the absolute value of a standard normal variable
LEAST_POSITION, LEAST_HEADING = 1e-6, 1e-6  # smallest deviations of residuals [m], [rad]
SINGULAR = 1e-12  # smaller eigenvalues of the Hessian, over the largest, count as zero
LOST_SHARE = 1e-6  # share of an undetermined direction from which an unknown is undetermined
WEAK = 0.1  # deviation of a direction, relative to its scale, from which it is weakly determined
CONFIDENCE = 0.95
EDGES = 0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2  # of confidence intervals, as shares of draws
EXTREMUM = 0.02  # ratio of derivatives, to that at the nominal value, at an extremum
RESAMPLES = 2000  # of a bootstrap
MIN_ACCEPTED = 2  # accepted values, with the start, from which an interrupted fit is kept
EDGE = 1e-4  # distance of estimates from their bounds [scales]
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


class Predictor:
    """Predictions of a parametric model over windows, as a function of the unknowns.

    Each prediction starts from the accepted one; others do not influence it.
    """

    def __init__(self, dae: Dae, unknowns: Sequence[Unknown], windows: Windows) -> None:
        self.motion: BodyMotion = body_motion(dae)
        self.windows = windows
        self._unknowns = unknowns
        self._of_sensor = [k for k, u in enumerate(unknowns) if u.quantity in SENSOR]
        self._of_model = [k for k, u in enumerate(unknowns) if u.quantity not in SENSOR]
        self._axes = [list(SENSOR).index(unknowns[k].quantity) for k in self._of_sensor]
        count, samples, width = windows.given.shape
        rows = windows.given.reshape(-1, width)
        self._given, self._inverse = np.unique(rows, axis=0, return_inverse=True)
        self._shape = count, samples, 3
        self._near: Velocities | None = None
        self._last: tuple[Array, Prediction, Velocities] | None = None

    def __call__(self, values: Array) -> Prediction:
        """Return the prediction for values of the unknowns; MotionError if there is no motion."""
        if self._last is not None and np.array_equal(self._last[0], values):
            return self._last[1]
        try:
            motion = velocities(self.motion, self._given, values[self._of_model], self._near)
        except MotionError as error:
            raise MotionError(self._message(error, values), error.sample) from error
        sensor = np.zeros(3)
        sensor[self._axes] = values[self._of_sensor]
        at = self._inverse.ravel()
        velocity = motion.values[at].reshape(self._shape)
        end, by_velocity, by_sensor = end_poses(self.windows, velocity, sensor)
        slopes = np.zeros((*end.shape, values.size))
        by_model = motion.slopes[at].reshape(*self._shape, -1)
        slopes[..., self._of_model] = np.einsum(
            "nikj,nkjp->nip", by_velocity, by_model, optimize=True
        )
        slopes[..., self._of_sensor] = by_sensor[..., self._axes]
        self._last = values.copy(), Prediction(end, slopes), motion
        return self._last[1]

    def accept(self, values: Array) -> Prediction:
        """Return the prediction for values, from which the following ones start."""
        prediction = self(values)
        if self._last is not None:
            self._near = self._last[2]
        return prediction

    def _message(self, error: MotionError, values: Array) -> str:
        """Return the message of a sample without motion: reason, window, time, rates, values."""
        window, k = divmod(int(np.argmax(self._inverse.ravel() == error.sample)), self._shape[1])
        number, start, dt, *_ = (part[window] for part in self.windows)
        rates = _words(self.motion.names, self._given[error.sample])
        return (
            f"window {number:g}, t = {start + dt[:k].sum():.6g} s: expected a motion of the "
            f"vehicle at {rates}, with {_words([each.name for each in self._unknowns], values)}, "
            f"found none: {error}; correct the log or the vehicle, or use another model"
        )


def estimate(
    dae: Dae,
    law: object,
    unknowns: Sequence[Unknown],
    windows: Windows,
    loss: Loss = "soft_l1",
) -> Estimate:
    """Fit unknowns to windows of a log, with a loss of each residual.

    ModelError is raised if the problem is not determined, the nominal values have no motion, or the
    search does not converge or ends at an edge or extremum of the prediction.
    """
    sought = _sought(dae, law, unknowns)
    if len(windows.end) <= len(unknowns):
        raise ModelError(
            f"estimate: expected more windows than unknowns, found {len(windows.end)} windows and "
            f"{len(unknowns)} unknowns; use a longer log, shorter windows or fewer unknowns"
        )
    predict = Predictor(dae, unknowns, windows)
    values = np.clip(sought.nominal, *sought.bounds)
    predict.accept(values)
    is_interrupted = False
    for k in range(REWEIGHTINGS):
        deviations = _deviations(predict(values).values - windows.end)
        search = Residuals(predict, windows.end, deviations, sought)
        try:
            result = search.run(values, loss, xtol=1e-10)
        except KeyboardInterrupt:
            if not interrupt_requested() or k + len(search.accepted) < MIN_ACCEPTED:
                raise
            values, is_interrupted = [values, *search.accepted][-1], True
            break
        values = np.asarray(result.x)
    prediction, groups = predict(values), np.arange(len(windows.end))
    fitted = search.estimate(values, prediction, groups, loss)._replace(
        is_interrupted=is_interrupted
    )
    if not is_interrupted:
        search.check_inside(values)
        if not result.status:
            raise ModelError(
                f"estimate: expected convergence, found none after {result.nfev} evaluations; give "
                "bounds or priors of the unknowns, or fit fewer of them"
            )
        for k, label in enumerate(fitted.labels):
            if label.name in fitted.undetermined:
                other = values.copy()
                other[k] = sought.nominal[k]
                _check_extremum(predict, (prediction, predict(other)), label, values[k], k)
    return fitted


def _check_extremum(
    predict: Predictor,
    predictions: tuple[Prediction, Prediction],
    label: Label,
    value: float,
    k: int,
) -> None:
    """Raise ModelError if the predicted motion has an extremum at the estimate of an unknown.

    The log then favours a motion beyond all those of the model, which biases the other estimates.
    """
    here, there = (float(np.linalg.norm(each.slopes[:, :, k])) for each in predictions)
    if not here < EXTREMUM * there:
        return
    windows = predict.windows
    turns, others = (np.abs(each.values[:, 2]) for each in predictions)
    sign = 1 if turns.sum() > others.sum() else -1
    superlative, comparative = ("fastest", "faster") if sign > 0 else ("slowest", "slower")
    row = int(np.argmax(sign * (np.abs(windows.end[:, 2]) - turns)))
    raise ModelError(
        "estimate: expected a log that the model can follow, found that the vehicle turns "
        f"{superlative} with {label.name} = {value:.4g} {label.unit} and the log turns "
        f"{comparative}: by {np.abs(windows.end[row, 2]):.4g} rad in window "
        f"{windows.number[row]:g}, from t = {windows.start[row]:.6g} s, with "
        f"{_words(predict.motion.names, windows.given[row, 0])}; the model turns by at "
        f"{'most' if sign > 0 else 'least'} {turns[row]:.4g} rad with any {label.name!r}; correct "
        "the rates of the log or the vehicle, use another model, or give a prior of "
        f"{label.name!r}"
    )


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


def _sought(dae: Dae, law: object, unknowns: Sequence[Unknown]) -> Sought:
    if not unknowns:
        raise ModelError("estimate: expected at least one unknown, found none; add one")
    labels, vehicle = tuple(label_of(each, law) for each in unknowns), dae.vehicle.numeric
    nominal = [value_of(each, vehicle, law) for each in unknowns]
    limits = [limits_of(each, vehicle, law) for each in unknowns]
    for unknown, value, (low, high) in zip(unknowns, nominal, limits, strict=True):
        if not low <= value <= high:
            raise ModelError(
                f"unknown {unknown.name!r}: expected a nominal value within the bounds, {low:g} to "
                f"{high:g}, found {value:g}; change the bounds, or the vehicle or the law"
            )
    sizes = [
        each.prior[1] if each.prior else abs(value) or dae.size_of(label)
        for each, label, value in zip(unknowns, labels, nominal, strict=True)
    ]
    scales = np.array(sizes)
    bounds = inner_bounds(np.array(limits), scales)
    return Sought(labels, np.array(nominal), bounds, scales, Priors.of(unknowns))


def _deviations(residual: Array) -> Array:
    """Return robust standard deviations of residuals: one of position, one of heading."""
    spread = np.median(np.abs(residual[:, :2])), np.median(np.abs(residual[:, 2]))
    position, heading = (each / NORMAL_MEDIAN for each in spread)
    return np.array(
        [max(position, LEAST_POSITION)] * 2 + [max(heading, LEAST_HEADING)], dtype=float
    )


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
        self._rejected = list[tuple[Array, MotionError]]()
        self.accepted = list[Array]()  # the first is the start

    def run(self, start: Array, loss: Loss, **options: float) -> Any:
        """Return the result of `scipy.optimize.least_squares`, with options of its tolerances."""
        return scipy.optimize.least_squares(
            self._residual,
            np.clip(start, *self._sought.bounds),
            self._jacobian,
            bounds=self._sought.bounds,
            x_scale=self._sought.scales,
            loss=loss,
            **options,
        )

    def _residual(self, values: Array) -> Array:
        check_interrupt()
        try:
            missed = (self._predict(values).values - self._measured) / self._deviations
        except MotionError as error:
            self._rejected.append((values.copy(), error))
            missed = np.full(self._measured.shape, np.nan)
        return np.append(missed[self._known], self._sought.priors.missed(values))

    def _jacobian(self, values: Array) -> Array:
        self.accepted.append(values.copy())
        slopes = self._predict.accept(values).slopes / self._deviations[:, None]
        return np.concatenate([slopes[self._known], self._sought.priors.slopes(values.size)])

    def check_inside(self, found: Array) -> None:
        """Raise ModelError if a search ended beside rejected values."""
        for values, error in self._rejected:
            if np.abs((values - found) / self._sought.scales).max() < AT_BOUND:
                raise ModelError(
                    "estimate: expected estimates within the range in which the vehicle can move, "
                    f"found that the log favours values beyond it: {error}"
                ) from error

    def estimate(
        self,
        values: Array,
        prediction: Prediction,
        groups: Array | Indices,
        loss: Loss,
        spent: int = 0,
    ) -> Estimate:
        """Return the estimate for a prediction at its values.

        The rows of a prediction belong to independent ``groups``, shape (n,); their number less the
        ``spent`` one, by default that of the unknowns, is that of the degrees of freedom.
        """
        labels, nominal, bounds, scales, priors = self._sought
        edges = np.minimum(np.abs(values - bounds[0]), np.abs(values - bounds[1]))
        at_bound = edges < AT_BOUND * scales
        missed = (prediction.values - self._measured) / self._deviations
        slopes = prediction.slopes[..., ~at_bound] / self._deviations[:, None] * scales[~at_bound]
        numbers, of_row = np.unique(groups, return_inverse=True)
        covariance, directions = _sandwich(
            np.where(self._known, missed, 0.0),
            np.where(self._known[..., None], slopes, 0.0),
            (of_row, max(numbers.size - (spent or int((~at_bound).sum())), 1)),
            priors,
            scales,
            ~at_bound,
            loss,
        )
        freedom = max(numbers.size - (spent or values.size), 1)
        quantile = float(scipy.special.stdtrit(freedom, 0.5 + CONFIDENCE / 2))
        reach = quantile * np.sqrt(np.diag(covariance))
        return Estimate(
            labels,
            nominal,
            values,
            covariance,
            np.column_stack([values - reach, values + reach]),
            scales,
            tuple(at_bound.tolist()),
            directions,
            self._deviations,
        )


def _words(names: Sequence[str], values: Array) -> str:
    """Return names with their values, for messages."""
    return ", ".join(f"{name} = {each:.4g}" for name, each in zip(names, values, strict=True))


def _sandwich(
    missed: Array,
    slopes: Array,
    groups: tuple[Indices, int],
    priors: Priors,
    scales: Array,
    free: Mask,
    loss: Loss,
) -> tuple[Array, tuple[Direction, ...]]:
    """Return the covariance of estimates, and the principal directions of the free ones.

    ``missed``, shape (n, m), are residuals without unit, ``slopes`` their derivatives by the p free
    unknowns in units of their scales; ``groups`` are the index of the independent group of each
    row, and the number of degrees of freedom of the groups.
    """
    size = 1 + missed**2 if loss == "soft_l1" else np.ones_like(missed)
    of_row, freedom = groups
    count, p = int(of_row.max()) + 1, int(free.sum())
    scores = np.zeros((count, p))
    np.add.at(scores, of_row, np.einsum("ni,nip->np", missed / np.sqrt(size), slopes))
    bread = np.einsum("nip,ni,niq->pq", slopes, size**-1.5, slopes)
    meat = scores.T @ scores * count / freedom
    known = priors.slopes(scales.size).sum(axis=0)
    prior = np.diag((known * scales)[free] ** 2)
    bread, meat = bread + prior, meat + prior
    values, vectors = np.linalg.eigh(bread)
    lost = values <= SINGULAR * max(values.max(initial=0.0), 1e-300)
    inverse = vectors[:, ~lost] / values[~lost] @ vectors[:, ~lost].T
    scaled = inverse @ meat @ inverse
    directions = _directions(scaled, vectors, lost)
    undetermined = (vectors[:, lost] ** 2).sum(axis=1) > LOST_SHARE
    covariance = np.zeros((scales.size, scales.size))
    part = scaled * np.outer(scales[free], scales[free])
    part[np.diag_indices(p)] = np.where(undetermined, np.inf, np.diag(part))
    covariance[np.ix_(free, free)] = part
    return covariance, directions


def _directions(scaled: Array, vectors: Array, lost: Mask) -> tuple[Direction, ...]:
    """Return the principal directions of a covariance, and those that are undetermined."""
    kept = vectors[:, ~lost]
    values, axes = np.linalg.eigh(kept.T @ scaled @ kept)
    known = [
        Direction(float(np.sqrt(max(value, 0.0))), _signed(kept @ axis))
        for value, axis in zip(values, axes.T, strict=True)
    ]
    return (*known, *(Direction(np.inf, _signed(vector)) for vector in vectors[:, lost].T))


def _signed(vector: Array) -> Array:
    """Return a vector with a positive largest component."""
    return np.asarray(vector * np.sign(vector[np.abs(vector).argmax()]))


class EndErrors(NamedTuple):
    """Predicted minus measured end poses of n windows."""

    measured: Array  # shape (n, 3): measured end poses, as ``Windows.end`` [m, m, rad]
    nominal: Array  # shape (n, 3): errors before and after the fit [m, m, rad]
    fitted: Array


class Calibration(NamedTuple):
    """Result of a calibration."""

    estimate: Estimate  # estimates from the windows for training
    train: EndErrors  # errors in the windows for training and in those for testing
    test: EndErrors


class Interval(NamedTuple):
    """A statistic, and its 95 % confidence interval."""

    value: float
    lower: float
    upper: float


def calibrate(
    build: Callable[[Vehicle, Any], Dae],
    vehicle: Vehicle,
    law: Any,
    unknowns: Sequence[Unknown],
    windows: Windows,
    predicted: Windows | None = None,
    *,
    train: float = 0.7,
    seed: int = 0,
    loss: Loss = "soft_l1",
) -> Calibration:
    """Fit unknowns to a random part of the windows, a share ``train``, and predict the others.

    With windows to be ``predicted``, such as those of another log, fit to all and predict these.
    """
    if not 0 < train < 1:
        raise ModelError(
            "calibrate: train: expected the share of windows to fit to, between 0 and 1, found "
            f"{train:g}; correct it"
        )
    order = np.random.default_rng(seed).permutation(len(windows.end))
    count = round(train * len(order))
    if count == len(order) and predicted is None:
        raise ModelError(
            "calibrate: expected windows for training and for testing, found only "
            f"{len(order)}; use a longer log or shorter windows"
        )
    dae = parametric_model(build, vehicle, law, unknowns)
    learnt, other = windows, predicted
    if other is None:
        learnt, other = windows.take(np.sort(order[:count])), windows.take(np.sort(order[count:]))
    fitted = estimate(dae, law, unknowns, learnt, loss)
    errors = [_errors(dae, unknowns, part, fitted) for part in (learnt, other)]
    return Calibration(fitted, *errors)


def _errors(dae: Dae, unknowns: Sequence[Unknown], windows: Windows, fitted: Estimate) -> EndErrors:
    """Return the errors of end poses with nominal and with fitted values."""
    predict = Predictor(dae, unknowns, windows)
    errors = [predict(values).values - windows.end for values in (fitted.nominal, fitted.values)]
    return EndErrors(windows.end, *errors)


def position_rms(errors: Array) -> float:
    """Return the root mean square distance of predicted from measured positions [m]."""
    return float(np.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()))


def heading_rms(errors: Array) -> float:
    """Return the root mean square error of the heading [rad]."""
    return float(np.sqrt((errors[:, 2] ** 2).mean()))


def bootstrap(
    rows: Array | Indices, statistic: Callable[[Any], float], draws: int = RESAMPLES
) -> Interval:
    """Return a statistic of rows, shape (n, ...), with its 95 % interval by resampling rows."""
    rng = np.random.default_rng(0)
    values = [statistic(rows[rng.integers(0, len(rows), len(rows))]) for _ in range(draws)]
    low, high = np.quantile(values, EDGES)
    return Interval(statistic(rows), float(low), float(high))
