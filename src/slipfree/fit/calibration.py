"""Calibration on a part of the windows of a log, and its errors on the other part."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.fit.estimate import CONFIDENCE, Estimate, Loss, Predictor, estimate
from slipfree.fit.unknowns import Unknown, parametric_model
from slipfree.fit.windows import Windows
from slipfree.vehicle.tree import Vehicle

RESAMPLES = 2000  # of a bootstrap


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
        raise ModelError(f"calibrate: train: expected a share between 0 and 1, found {train:g}")
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
    fitted = estimate(dae, vehicle, law, unknowns, learnt, loss)
    errors = [_errors(dae, unknowns, part, fitted) for part in (learnt, other)]
    return Calibration(fitted, *errors)


def _errors(dae: Dae, unknowns: Sequence[Unknown], windows: Windows, fitted: Estimate) -> EndErrors:
    """Return the errors of end poses with nominal and with fitted values."""
    predict = Predictor(dae, unknowns, windows)
    errors = [predict(values).end - windows.end for values in (fitted.nominal, fitted.values)]
    return EndErrors(windows.end, *errors)


def position_rms(errors: Array) -> float:
    """Return the root mean square distance of predicted from measured positions [m]."""
    return float(np.sqrt((errors[:, :2] ** 2).sum(axis=1).mean()))


def heading_rms(errors: Array) -> float:
    """Return the root mean square error of the heading [rad]."""
    return float(np.sqrt((errors[:, 2] ** 2).mean()))


def bootstrap(errors: Array, statistic: Callable[[Array], float]) -> Interval:
    """Return a statistic of errors, shape (n, ...), with its 95 % interval by resampling rows."""
    rng = np.random.default_rng(0)
    values = [
        statistic(errors[rng.integers(0, len(errors), len(errors))]) for _ in range(RESAMPLES)
    ]
    low, high = np.quantile(values, [0.5 - CONFIDENCE / 2, 0.5 + CONFIDENCE / 2])
    return Interval(statistic(errors), float(low), float(high))
