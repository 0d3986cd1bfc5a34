"""Fit of the force balance to windows of logs, and errors on windows that were left out.

The estimate minimises a robust loss of the errors of the windows, divided by their own deviations,
and of the deviations from priors. Positive numbers are sought as logarithms. The covariance is the
sandwich estimate with one sum of gradients for each campaign or manoeuvre, whose windows are not
independent (`slipfree.fit.estimate`).

Prediction intervals are the errors that 90 % of the fitted windows do not exceed, times ``exp(0.84
tau sqrt(1 + 1 / n))``: tau is the spread of the logarithms of the errors of n campaigns, with a
prior of 0.25 worth three campaigns. The slip on slopes has a deviation of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Indices, Label, Mask, Names
from slipfree.fit.drives import (
    DriveLog,
    Model,
    Predictor,
    Slopes,
    WindowErrors,
    Windows,
    age_of_poses,
    windows_of,
)
from slipfree.fit.estimate import (
    BALANCE,
    MIN_ACCEPTED,
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
)
from slipfree.system.interrupt import interrupt_requested

FIRST_DEVIATIONS = 0.25, 0.25, 0.15  # of errors before they are known [m, m, rad]
LEAST_DEVIATION = 1e-3  # [m, m, rad]
SAME_DEVIATION = 0.1  # relative change of deviations at which they are known
MAX_EVALUATIONS, REFINEMENTS = 25, 6  # of a search, and from the values of another fit
AGE_DEVIATION = 0.05  # of ages that turning rates show [s]
STEP = 1e-4  # of derivatives [scales]
COVERED = 0.9  # share of the errors inside a prediction interval
SPREAD = 0.25  # of log scales of campaigns before they are known
PRIOR_CAMPAIGNS = 3  # weight of this spread
QUANTILE = 0.84  # of a standard normal variable, at 80 %
SLIP_SPREAD = 0.15  # deviation of the slip over the sine of the grade between campaigns
LEAST_WINDOWS = 8  # of a campaign whose scale is known
BLOCKS = 5  # of whole manoeuvres that are left out in turn
STRAIGHT = np.deg2rad(15)  # largest error of the course of windows used for the error of the slip
CLASSES = (-35, -25, -12, -6, 0, 6, 12, 25, 35)  # limits of the classes of grade [deg]
RESAMPLES = 1000
AGES = np.arange(0.0, 0.95, 0.1)  # of poses, as initial guesses [s]


@dataclass(frozen=True)
class Known:
    """A model with values of its unknowns."""

    model: Model
    values: Array  # shape (p,): of the unknowns

    def predict(self, logs: Sequence[DriveLog], windows: Windows, slopes: Slopes | None) -> Array:
        """Return the errors of windows, shape (n, 3) [m, m, rad]."""
        return Predictor(self.model, logs, windows, slopes).errors(self.values[None])[:, 0]


@dataclass(frozen=True)
class DriveFit(Known):
    """Fitted force balance."""

    estimate: Estimate  # of the unknowns, or of their logarithms
    errors: Array  # shape (n, 3): of the fitted windows [m, m, rad]


class Scale(NamedTuple):
    """Coordinates of a search: logarithms of positive numbers."""

    is_log: Array

    @classmethod
    def of(cls, unknowns: Sequence[Unknown]) -> Scale:
        """Return the coordinates of unknowns."""
        return cls(np.array([BALANCE[each.quantity].is_log for each in unknowns], bool))

    def sought(self, values: Array) -> Array:
        """Return coordinates of values, shape (..., p)."""
        return np.where(self.is_log, np.log(np.where(self.is_log, values, 1.0)), values)

    def values(self, sought: Array) -> Array:
        """Return values of coordinates, shape (..., p)."""
        return np.where(self.is_log, np.exp(np.where(self.is_log, sought, 0.0)), sought)


class _Errors(NamedTuple):
    """Errors as a function of coordinates of the search."""

    predict: Predictor
    scale: Scale
    sizes: Array

    def __call__(self, values: Array) -> Prediction:
        """Return the errors without derivatives, which take a motion for each unknown."""
        return Prediction(self.predict.errors(self.scale.values(values)[None])[:, 0], np.zeros(0))

    def accept(self, values: Array) -> Prediction:
        """Return the errors and their derivatives, by differences."""
        steps = STEP * self.sizes
        many = values + np.vstack([np.zeros_like(steps), np.diag(steps)])
        ends = self.predict.errors(self.scale.values(many)).swapaxes(1, 2)
        return Prediction(ends[..., 0], np.asarray((ends[..., 1:] - ends[..., :1]) / steps))


def sought_of(model: Model) -> Sought:
    """Return start, bounds, sizes and priors of a search; logarithms of positive numbers."""
    scale, nominal = Scale.of(model.unknowns), model.start
    start = scale.sought(nominal)
    labels, limits = list[Label](), list[tuple[float, float]]()
    means, sizes = start.copy(), np.empty(nominal.size)
    for k, each in enumerate(model.unknowns):
        row = BALANCE[each.quantity]
        labels.append(Label(each.name, row.unit, row.words))
        limits.append((max(row.bounds[0], each.lower), min(row.bounds[1], each.upper)))
        check_nominal(each, nominal[k], limits[k], "vehicle")
        means[k], sizes[k] = each.prior or (start[k], row.deviation)
        if each.prior and row.is_log:
            means[k], sizes[k] = np.log(means[k]), sizes[k] / means[k]
    bounds = inner_bounds(scale.sought(np.array(limits).T).T, sizes)
    return Sought(tuple(labels), start, bounds, sizes, Priors(np.arange(sizes.size), means, sizes))


def fit_drives(
    model: Model,
    predict: Predictor,
    groups: Indices,
    start: Array | None = None,
    deviations: Array | None = None,
) -> DriveFit:
    """Fit the unknowns of a model to windows; those of a group are not independent.

    A ``start`` and ``deviations`` of an earlier fit shorten the search. ModelError is raised if
    there are not more errors of windows than unknowns.
    """
    sought, scale = sought_of(model), Scale.of(model.unknowns)
    count = 3 * predict.windows.log.size
    if count <= len(model.unknowns):
        raise ModelError(
            f"windows: expected more residuals than the {len(model.unknowns)} unknowns, found "
            f"{count // 3} windows with three each (along, across, turn); use longer logs, shorter "
            "windows or fewer unknowns"
        )
    errors = _Errors(predict, scale, sought.scales)
    values = sought.nominal.copy() if start is None else scale.sought(start)
    ages = [k for k, each in enumerate(model.unknowns) if each.quantity == "age" and start is None]
    values[ages] = sought.priors.mean[ages]
    if rows := [k for k in ages if not model.unknowns[k].prior]:
        # search from the ages of poses at which the nominal motion is nearest
        many = np.repeat(values[None], AGES.size, axis=0)
        many[:, rows] = AGES[:, None]
        missed = predict.errors(scale.values(many)) / np.array(FIRST_DEVIATIONS)
        cost, names = np.sqrt(1 + missed**2).sum(axis=2), predict.names["campaign"]
        for k in rows:
            own = (names == model.unknowns[k].of) | (not model.unknowns[k].of)
            values[k] = max(float(AGES[int(cost[own].sum(axis=0).argmin())]), 0.01)
    spread = np.array(FIRST_DEVIATIONS) if deviations is None else deviations
    none = np.zeros((predict.windows.log.size, 3))
    is_interrupted = False
    count, most = (REWEIGHTINGS, MAX_EVALUATIONS) if deviations is None else (1, REFINEMENTS)
    for _ in range(count):
        search = Residuals(errors, none, spread, sought)
        try:
            values = search.run(values, xtol=1e-4, ftol=1e-5, max_nfev=most).x
        except KeyboardInterrupt:
            if not interrupt_requested() or len(search.accepted) < MIN_ACCEPTED:
                raise
            values, is_interrupted = search.accepted[-1], True
            break
        if deviations is None:
            found = np.median(np.abs(errors(values).values), axis=0) / NORMAL_MEDIAN
            # a vehicle that does not move has no errors across: half of those along count
            found[:2] = np.maximum(found[:2], found[:2].max() / 2)
            spread, before = np.maximum(found, LEAST_DEVIATION), spread
            if np.allclose(spread, before, rtol=SAME_DEVIATION):
                break
    prediction = errors.accept(values)
    search = Residuals(errors, none, spread, sought)
    estimate = search.estimate(values, prediction, groups)._replace(is_interrupted=is_interrupted)
    return DriveFit(model, scale.values(values), estimate, prediction.values)


def age_priors(unknowns: Sequence[Unknown], logs: Sequence[DriveLog]) -> tuple[Unknown, ...]:
    """Return unknowns with priors of the ages that measured turning rates show."""

    def known(unknown: Unknown) -> Unknown:
        own = [log for log in logs if unknown.of in ("", log.campaign)]
        ages = [age for log in own if (age := age_of_poses(log)) is not None]
        if unknown.quantity != "age" or unknown.prior or not ages:
            return unknown
        return replace(unknown, prior=(float(np.mean(ages)), AGE_DEVIATION))

    return tuple(map(known, unknowns))


def fit_on_uncertain_map(
    model: Model,
    logs: Sequence[DriveLog],
    windows: Windows,
    maps: tuple[Slopes | None, Sequence[Slopes]],
    known: DriveFit | None = None,
) -> DriveFit:
    """Fit over a map with errors of a known size; ``known`` is an earlier fit, as initial guess.

    Errors of a map attenuate the influence of its slopes. What further errors of the same size
    change is subtracted (simulation extrapolation; Cook and Stefanski, J. Am. Stat. Assoc. 89,
    1994), and their spread is added to the deviations. ``maps`` are the slopes of the map, and
    those of the map with further errors: none, or at least two.
    """
    given, others = maps
    groups = manoeuvres_of(logs, windows)
    start = (None, None) if known is None else (known.values, known.estimate.deviations)
    fitted = fit_drives(model, Predictor(model, logs, windows, given), groups, *start)
    if not others:
        return fitted
    near = fitted.values, fitted.estimate.deviations
    scale, again = Scale.of(model.unknowns), list[Array]()
    for each in others:
        found = fit_drives(model, Predictor(model, logs, windows, each), groups, *near)
        again.append(scale.sought(found.values))
    estimate = fitted.estimate
    low, high = sought_of(model).bounds
    values = np.clip(2 * estimate.values - np.mean(again, axis=0), low, high)
    before = np.sqrt(np.diag(estimate.covariance))
    wider = np.hypot(before, np.std(again, axis=0, ddof=1)) / np.where(before > 0, before, 1.0)
    reach = np.diff(estimate.intervals, axis=1)[:, 0] / 2 * wider
    estimate = estimate._replace(
        values=values,
        covariance=estimate.covariance * np.outer(wider, wider),
        intervals=np.column_stack([values - reach, values + reach]),
    )
    new = Known(model, scale.values(values))
    return DriveFit(model, new.values, estimate, new.predict(logs, windows, given))


def manoeuvres_of(logs: Sequence[DriveLog], windows: Windows) -> Indices:
    """Return the number of the independent group of each window: its log, or its manoeuvre."""
    if len(logs) >= BLOCKS:
        return windows.log
    own = [logs[k].manoeuvre[i] for k, i in zip(windows.log, windows.first, strict=True)]
    return np.unique(np.column_stack([windows.log, own]), axis=0, return_inverse=True)[1].ravel()


def folds_of(logs: Sequence[DriveLog], windows: Windows) -> Indices:
    """Return the number of the part with which each window is left out.

    Parts are campaigns if each surface has two of them, otherwise blocks of whole manoeuvres.
    """
    campaigns = {
        log.surface: {each.campaign for each in logs if each.surface == log.surface} for log in logs
    }
    if all(len(each) > 1 for each in campaigns.values()):
        return np.unique(windows.names(logs, "campaign"), return_inverse=True)[1].ravel()
    parts = np.zeros(windows.log.size, int)
    for k, log in enumerate(logs):
        numbers, rank = np.unique(log.manoeuvre, return_inverse=True)
        block = rank.ravel() * BLOCKS // numbers.size
        own = windows.log == k
        parts[own] = block[windows.first[own]]
    return parts


class Score(NamedTuple):
    """Errors of windows that were not fitted."""

    errors: WindowErrors  # shape (n,) each
    windows: Windows
    grade: Array  # shape (n,): mean of the slope along the path [rad]
    is_beyond: Mask  # whether the grade is beyond those of the fitted windows
    reach: Array  # shape (3, n): half widths of the 90 % intervals [m, m, rad]
    campaigns: int  # number of campaigns on which the intervals rest

    @property
    def coverage(self) -> Array:
        """Shares of the errors along, across and of the course inside their intervals."""
        return np.asarray((np.abs(np.array(self.errors)) <= self.reach).mean(axis=1))

    @property
    def share(self) -> float:
        """Root mean square of the errors of positions over the mean path."""
        return rms(self.errors.position) / max(float(self.windows.length.mean()), 1e-9)

    def slip(self) -> list[tuple[float, float, int, float]]:
        """Return limits [rad], number of straight windows, and error of the slip by class."""
        moved = np.maximum(self.windows.length, 1e-9)
        straight = np.abs(self.errors.turn) < STRAIGHT
        share, limits = self.errors.along / moved, np.deg2rad(CLASSES)
        return [
            (low, high, int(rows.sum()), float(np.median(share[rows])))
            for low, high in pairwise(limits.tolist())
            if (rows := straight & (self.grade >= low) & (self.grade < high)).any()
        ]


class WindowKind(NamedTuple):
    """Length of path [m] or duration [s] of windows; without both, windows are whole pieces."""

    length: float = 0.0
    duration: float = 0.0

    @property
    def words(self) -> str:
        """Name of the windows."""
        length, duration = self
        return f"{length:g} m of path" if length else f"{duration:g} s" if duration else "windows"


class Fitted(NamedTuple):
    """Windows on which intervals rest, by kind, with their errors."""

    errors: Array  # shape (n, 3) [m, m, rad]
    surface: Names  # shape (n,)
    campaign: Names
    grade: Array  # shape (n,) [rad]

    @classmethod
    def of(
        cls, known: Known, logs: Sequence[DriveLog], windows: Windows, slopes: Slopes | None
    ) -> Fitted:
        """Return the errors of windows of fitted logs."""
        surface, campaign = (windows.names(logs, key) for key in ("surface", "campaign"))
        errors = known.predict(logs, windows, slopes)
        return cls(errors, surface, campaign, grades(logs, windows, slopes))

    def reach(self, surface: Names, slide: Array) -> tuple[Array, int]:
        """Return half widths of intervals, shape (3, n), and the number of campaigns.

        ``slide`` are path times sine of the grade of the windows on each ``surface``, shape (n,).
        """
        widths, count = np.empty((3, surface.size)), np.inf
        for name in np.unique(surface):
            own = self.surface == name if (self.surface == name).any() else self.surface != ""
            campaigns = np.unique(self.campaign[own])
            n = campaigns.size
            parts = [np.abs(self.errors[own & (self.campaign == each)]) for each in campaigns]
            known = [part for part in parts if len(part) >= LEAST_WINDOWS]
            medians = (
                [np.median(part, axis=0) for part in known] if len(known) > 1 else [np.ones(3)]
            )
            logs = np.log(np.maximum(medians, LEAST_DEVIATION))
            squares = PRIOR_CAMPAIGNS * SPREAD**2 + len(logs) * logs.var(axis=0)
            tau = np.sqrt(squares / (PRIOR_CAMPAIGNS + len(logs) - 1))
            factor = np.exp(QUANTILE * tau * np.sqrt(1 + 1 / n))
            rows = surface == name
            widths[:, rows] = (factor * [conformal(each) for each in self.errors[own].T])[:, None]
            count = min(count, n)
        widths[0] = np.hypot(widths[0], 1.645 * SLIP_SPREAD * slide)
        return widths, int(count)


def score_windows(
    known: Known, fitted: Fitted, logs: Sequence[DriveLog], windows: Windows, slopes: Slopes | None
) -> Score:
    """Return the errors of windows that were not fitted, with intervals that rest on others."""
    grade = grades(logs, windows, slopes)
    is_beyond = (grade < fitted.grade.min()) | (grade > fitted.grade.max())
    reach, campaigns = fitted.reach(windows.names(logs, "surface"), windows.length * np.sin(grade))
    errors = WindowErrors(*known.predict(logs, windows, slopes).T)
    return Score(errors, windows, grade, is_beyond, reach, campaigns)


def judge(
    model: Model,
    logs: Sequence[DriveLog],
    maps: tuple[Slopes | None, Sequence[Slopes]],
    kinds: Sequence[WindowKind],
    others: Sequence[DriveLog] = (),
    alike: Sequence[Model] = (),
) -> tuple[DriveFit, dict[WindowKind, Fitted], dict[WindowKind, Score]]:
    """Fit a model to windows of the first kind, and predict windows that are left out.

    Each part of the logs is predicted by a fit to the other parts; the logs ``others`` by the fit
    to all ``logs``. Kinds of which there are no windows have no score. The intervals of the
    constants contain those of fits of models ``alike``, which the logs hardly tell apart.
    """
    slopes = maps[0]
    windows = {kind: found for kind in kinds if (found := find_windows(logs, kind)) is not None}
    windows = windows or {kinds[0]: windows_of(logs, *kinds[0])}  # raises its error
    first = next(iter(windows))
    whole = fit_on_uncertain_map(model, logs, windows[first], maps)
    rests = {kind: Fitted.of(whole, logs, own, slopes) for kind, own in windows.items()}
    if whole.estimate.is_interrupted:
        return whole, rests, {}
    for variant in alike:
        estimate = fit_on_uncertain_map(variant, logs, windows[first], maps, whole).estimate
        ends = np.hstack([whole.estimate.intervals, estimate.intervals])
        union = np.column_stack([ends.min(axis=1), ends.max(axis=1)])
        whole = replace(whole, estimate=whole.estimate._replace(intervals=union))
    if others:
        return whole, rests, score_kinds(whole, rests, others, slopes)
    parts = {kind: folds_of(logs, own) for kind, own in windows.items()}
    folded = {kind: list[Score]() for kind in windows}
    for part in np.unique(parts[first]).tolist():
        kept = windows[first].take(parts[first] != part)
        if 3 * kept.log.size <= len(model.unknowns):
            continue
        fit = fit_on_uncertain_map(model, logs, kept, maps, whole)
        for kind, own in windows.items():
            is_out = parts[kind] == part
            if is_out.any() and not is_out.all():
                fitted = Fitted.of(fit, logs, own.take(~is_out), slopes)
                folded[kind].append(score_windows(fit, fitted, logs, own.take(is_out), slopes))
    scores = {}
    for kind, each in folded.items():
        if each:
            errors, left_out, grade, is_beyond, reach, campaigns = zip(*each, strict=True)
            scores[kind] = Score(
                WindowErrors(*map(np.concatenate, zip(*errors, strict=True))),
                Windows(*map(np.concatenate, zip(*left_out, strict=True))),
                np.concatenate(grade),
                np.concatenate(is_beyond),
                np.hstack(reach),
                min(campaigns),
            )
    return whole, rests, scores


def score_kinds(
    known: Known,
    rests: Mapping[WindowKind, Fitted],
    logs: Sequence[DriveLog],
    slopes: Slopes | None,
) -> dict[WindowKind, Score]:
    """Return the errors of logs that were not fitted, by kind of window.

    The age of their poses follows from a measured turning rate, or is the mean of the fit.
    """
    unknowns, values = list(known.model.unknowns), known.values
    fitted = [row for row, each in enumerate(unknowns) if each.quantity == "age"]
    ofs = {unknowns[row].of for row in fitted}
    for name in {log.campaign for log in logs} - ofs if fitted else ():
        shown = [age for log in logs if log.campaign == name and (age := age_of_poses(log))]
        values = np.append(values, np.mean(shown or known.values[fitted]))
        unknowns.append(Unknown(f"age_{name}", "age", of=name))
    known = Known(known.model._replace(unknowns=tuple(unknowns)), values)
    return {
        kind: score_windows(known, fitted, logs, windows, slopes)
        for kind, fitted in rests.items()
        if (windows := find_windows(logs, kind)) is not None
    }


def find_windows(logs: Sequence[DriveLog], kind: WindowKind) -> Windows | None:
    """Return the windows of a kind, or None without any."""
    try:
        return windows_of(logs, *kind)
    except ModelError:
        return None


def conformal(errors: Array) -> float:
    """Return the half width of an interval that contains the next error in 90 % of the cases."""
    rank = min(int(np.ceil(COVERED * (errors.size + 1))), errors.size)
    return float(np.sort(np.abs(errors))[rank - 1])


def grades(logs: Sequence[DriveLog], windows: Windows, slopes: Slopes | None) -> Array:
    """Return the mean slope of the map along the measured paths of windows [rad]."""
    if slopes is None:
        return np.zeros(windows.log.size)
    means = []
    for k, first, last in zip(*windows[:3], strict=True):
        log, part = logs[k], slice(first, last)
        means.append(np.arcsin(slopes.tilt(log.place[part], np.angle(log.moved[part]))[0].mean()))
    return np.array(means)


def by_logs(values: Array, log: Indices, statistic: Callable[[Array], float]) -> Interval:
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
