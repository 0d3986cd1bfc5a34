"""Fits of motion models to logs over a map, and their errors on logs that were left out.

The constants minimise a robust loss of the errors at the ends of windows, divided by their own
deviations. The covariance is the sandwich estimate with one sum of gradients for each log, since
the windows of a log share its ground, its weather and its driver (`slipfree.fit.estimate`).
Prediction intervals are the errors that 90 % of the fitted windows do not exceed, with the
correction of conformal prediction for their number; whole groups of logs are left out in turn.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Label, Mask
from slipfree.fit.estimate import (
    NORMAL_MEDIAN,
    Interval,
    Prediction,
    Priors,
    Residuals,
    Sought,
    bootstrap,
)
from slipfree.fit.ground_motion import (
    DriveLog,
    GroundPredictor,
    MotionModel,
    PathErrors,
    PathWindows,
    Slopes,
    windows_of,
)

FIRST_DEVIATIONS = 0.25, 0.25, 0.15  # of the errors before they are known [m, m, rad]
LEAST_DEVIATION = 1e-6  # [m, m, rad]
COVERED = 0.9  # share of the errors inside a prediction interval
STRAIGHT = np.deg2rad(15)  # largest error of the course of windows used for the error of the slip
CLASSES = (-35, -25, -12, -6, 0, 6, 12, 25, 35)  # limits of the classes of grade [deg]
# of constants; otherwise the start value, or 1
SIZES = {"drift": 0.1, "slip_slope": 1.0, "turn_slope": 5.0, "ahead": 1.0}
RESAMPLES = 1000
MAX_EVALUATIONS = 60  # of a search, without those for derivatives
STEP = 1e-4  # of derivatives [sizes]


class GroundFit(NamedTuple):
    """Fitted constants of a motion model."""

    values: dict[str, float]
    deviation: dict[str, float]  # standard deviations; zero at a bound
    intervals: dict[str, tuple[float, float]]  # 95 % confidence intervals
    errors: PathErrors  # of the fitted windows


def fit_ground(model: MotionModel, predict: GroundPredictor, where: str = "the logs") -> GroundFit:
    """Fit the constants of a model to windows; those of one log are not independent.

    ModelError is raised, with the name of the logs, if there are not more windows than constants,
    the search does not converge, or the windows do not determine a constant.
    """
    names = tuple(model.start)
    start = np.array([model.start[name] for name in names])
    bounds = np.array([model.bounds[name] for name in names]).T
    sizes = np.array([SIZES.get(name, abs(model.start[name]) or 1.0) for name in names])
    if len(predict.windows.log) <= len(names):
        raise ModelError(
            f"{where}: expected more windows than the {len(names)} constants of the model, found "
            f"{len(predict.windows.log)}; use longer logs, shorter windows or a simpler model"
        )

    labels = tuple(Label(name, model.units[name], "") for name in names)
    sought = Sought(labels, start, (bounds[0], bounds[1]), sizes, Priors.of(()))
    errors, values = _Errors(model, predict, sizes, bounds), start
    none = np.zeros_like(errors(start).values)  # MotionError without a motion at the start values
    deviations = np.array(FIRST_DEVIATIONS)
    for _ in range(2):  # the second time with the deviations of the first one
        search = Residuals(errors, none, deviations, sought)
        result = search.run(values, "soft_l1", xtol=1e-5, ftol=1e-6, max_nfev=MAX_EVALUATIONS)
        values = result.x
        spread = np.median(np.abs(errors(values).values), axis=0) / NORMAL_MEDIAN
        deviations = np.maximum(spread, LEAST_DEVIATION)
    search.check_inside(values)
    if not result.status:
        raise ModelError(
            f"{where}: expected convergence of the fit of the model {model.words!r}, found none "
            f"after {result.nfev} evaluations; use longer logs or a simpler model"
        )
    search = Residuals(errors, none, deviations, sought)
    fit = search.estimate(values, errors.accept(values), predict.windows.log, "soft_l1", spent=1)
    if fit.undetermined:
        raise ModelError(
            f"{where}: expected windows that determine {', '.join(fit.undetermined)} of the "
            f"model {model.words!r}, found a standard deviation larger than the size of the "
            "constant; use logs with other manoeuvres and slopes, or a model without them"
        )
    numbers, spread = dict(zip(names, values.tolist(), strict=True)), np.diag(fit.covariance)
    return GroundFit(
        numbers,
        dict(zip(names, np.sqrt(spread).tolist(), strict=True)),
        {
            name: (low, high)
            for name, (low, high) in zip(names, fit.intervals.tolist(), strict=True)
        },
        predict(model, numbers),
    )


class _Errors(NamedTuple):
    """Errors of a model at the ends of windows, along, across and of the course [m, m, rad]."""

    model: MotionModel
    predict: GroundPredictor
    sizes: Array  # of the constants
    bounds: Array  # shape (2, n_constants)

    def _at(self, values: Array) -> Array:
        """Return the errors, shape (n, 3), or (n, m, 3) for values of shape (m, n_constants)."""
        constants = dict(zip(self.model.start, values.T, strict=True))
        return np.stack(self.predict(self.model, constants)[:3], axis=-1)

    def __call__(self, values: Array) -> Prediction:
        """Return the errors without derivatives, which take a motion for each constant."""
        return Prediction(self._at(values), np.zeros(0))

    def accept(self, values: Array) -> Prediction:
        """Return the errors and their derivatives, by differences."""
        steps = STEP * self.sizes
        steps = np.where(values + steps > self.bounds[1], -steps, steps)
        ends = self._at(values + np.vstack([np.zeros_like(steps), np.diag(steps)])).swapaxes(1, 2)
        return Prediction(ends[..., 0], np.asarray((ends[..., 1:] - ends[..., :1]) / steps))


def fit_on_uncertain_map(
    model: MotionModel,
    logs: Sequence[DriveLog],
    windows: PathWindows,
    maps: tuple[Slopes, Sequence[Slopes]],
    where: str = "the logs",
) -> GroundFit:
    """Fit the constants of a model over a map with errors of a known size.

    Errors of a map attenuate the influence of its slopes. What further errors of the same size
    change is subtracted (simulation extrapolation; Cook and Stefanski, J. Am. Stat. Assoc. 89,
    1994), and their spread is added to the deviations. ``maps`` are the slopes of the map, and
    those of the map with further errors: none, or at least two.
    """
    given, others = maps
    fitted = fit_ground(model, GroundPredictor(logs, windows, given), where)
    if not others:
        return fitted
    near = model._replace(start=fitted.values)
    again = [
        fit_ground(near, GroundPredictor(logs, windows, each), where).values for each in others
    ]
    values, deviation, intervals = {}, {}, {}
    for name, value in fitted.values.items():
        drawn = np.array([each[name] for each in again])
        values[name] = 2 * value - float(drawn.mean())
        deviation[name] = float(np.hypot(fitted.deviation[name], drawn.std(ddof=1)))
        low, high = fitted.intervals[name]
        ratio = deviation[name] / fitted.deviation[name] if fitted.deviation[name] else 0.0
        half = (high - low) / 2 * ratio
        intervals[name] = values[name] - half, values[name] + half
    errors = GroundPredictor(logs, windows, given)(model, values)
    return GroundFit(values, deviation, intervals, errors)


class Score(NamedTuple):
    """Errors of a model on windows of logs that were not fitted."""

    errors: PathErrors
    windows: PathWindows
    grade: Array  # mean of the slope along the path [rad]
    is_beyond: Mask  # whether the grade is beyond those of the fitted windows
    reach: Array  # shape (3, n): half widths of the 90 % intervals [m, m, rad]

    @property
    def coverage(self) -> Array:
        """Shares of the errors along, across and of the course inside their intervals."""
        return np.asarray((np.abs(np.array(self.errors[:3])) <= self.reach).mean(axis=1))

    def slip(self) -> list[tuple[float, float, int, float]]:
        """Return limits [rad], number of straight windows, and error of the slip by class."""
        straight = np.abs(self.errors.course) < STRAIGHT
        share, limits = self.errors.along / self.errors.displacement, np.deg2rad(CLASSES)
        return [
            (low, high, int(rows.sum()), float(np.median(share[rows])))
            for low, high in pairwise(limits.tolist())
            if (rows := straight & (self.grade >= low) & (self.grade < high)).any()
        ]


Kind = tuple[float, float]  # length of path [m] and duration [s] of windows; one is zero
FITTED: Kind = (5.0, 0.0)


def judge(
    logs: Sequence[DriveLog],
    slopes: Slopes,
    models: Mapping[str, MotionModel],
    kinds: Sequence[Kind] = (FITTED, (20.0, 0.0), (0.0, 5.0)),
    others: Sequence[DriveLog] = (),
    further: Sequence[Slopes] = (),
) -> tuple[dict[str, dict[Kind, Score]], dict[str, list[GroundFit]]]:
    """Predict each group of logs with constants fitted to the other groups.

    With ``others``, these logs are predicted with constants fitted to all ``logs``. ``further`` are
    slopes of the map with further errors, for `fit_on_uncertain_map`. Scores are by model and kind
    of window, fits by model, one for each group that is left out.
    """
    windows = {kind: windows_of(logs, *kind) for kind in {*kinds, FITTED}}
    test = {kind: windows_of(others, *kind) for kind in kinds} if others else windows
    group = np.array([log.group for log in logs])
    folds = sorted(set(group.tolist())) if not others else [""]
    scores = dict[str, dict[Kind, Score]]()
    fits = dict[str, list[GroundFit]]()
    for name, model in models.items():
        folded = {kind: list[Score]() for kind in kinds}
        fits[name] = []
        for fold in folds:
            rest = {kind: part.take(group[part.log] != fold) for kind, part in windows.items()}
            where = f"the logs without {fold}" if fold else "the logs"
            maps = slopes, further
            fitted = fit_on_uncertain_map(model, logs, rest[FITTED], maps, where)
            fits[name].append(fitted)
            for kind in kinds:
                own = test[kind] if others else test[kind].take(group[test[kind].log] == fold)
                if own.log.size:  # the logs of a group may be too short
                    seen = GroundPredictor(logs, rest[kind], slopes)
                    predict = GroundPredictor(others or logs, own, slopes)
                    known = grades(logs, rest[kind], slopes)
                    grade = grades(others or logs, own, slopes)
                    is_beyond = (grade < known.min()) | (grade > known.max())
                    reach = [conformal(each) for each in seen(model, fitted.values)[:3]]
                    folded[kind].append(
                        Score(
                            predict(model, fitted.values),
                            own,
                            grade,
                            is_beyond,
                            np.tile(np.reshape(reach, (3, 1)), grade.size),
                        )
                    )
        scores[name] = {kind: _joined(parts) for kind, parts in folded.items()}
    return scores, fits


def _joined(parts: Sequence[Score]) -> Score:
    """Return the errors on the windows of all groups."""
    errors, windows, grade, is_beyond, reach = zip(*parts, strict=True)
    return Score(
        PathErrors(*map(np.concatenate, zip(*errors, strict=True))),
        PathWindows(*map(np.concatenate, zip(*windows, strict=True))),
        np.concatenate(grade),
        np.concatenate(is_beyond),
        np.concatenate(reach, axis=1),
    )


def conformal(errors: Array) -> float:
    """Return the half width of an interval that contains the next error in 90 % of the cases."""
    rank = min(int(np.ceil(COVERED * (errors.size + 1))), errors.size)
    return float(np.sort(np.abs(errors))[rank - 1])


def grades(logs: Sequence[DriveLog], windows: PathWindows, slopes: Slopes) -> Array:
    """Return the mean slope of the map along the measured paths of windows [rad]."""
    means = []
    for k, first, last in zip(*windows[:3], strict=True):
        log, part = logs[k], slice(first, last)
        course = np.arctan2(log.velocity[part, 1], log.velocity[part, 0])
        means.append(np.arcsin(slopes.tilt(log.place[part] @ [1, 1j], course)[0].mean()))
    return np.array(means)


def by_logs(values: Array, log: Array, statistic: Callable[[Array], float]) -> Interval:
    """Return a statistic of values, and its 95 % interval by resampling whole logs.

    A single log has no interval: its ends are NaN.
    """
    names = np.unique(log)
    if names.size == 1:
        return Interval(statistic(values), np.nan, np.nan)
    rows = [np.flatnonzero(log == each) for each in names]
    return bootstrap(
        np.arange(names.size),
        lambda drawn: statistic(values[np.concatenate([rows[k] for k in drawn.tolist()])]),
        RESAMPLES,
    )


def rms(values: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))
