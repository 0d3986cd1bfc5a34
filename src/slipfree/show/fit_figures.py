"""Figures of fits: end poses and confidence ellipses of a calibration; errors over a map."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.stats import chi2

from slipfree.core.records import Array
from slipfree.fit.drive_fit import Score, WindowKind, by_logs, rms
from slipfree.fit.estimate import CONFIDENCE, Estimate
from slipfree.fit.wheel_soil import QUANTITIES, SoilFit
from slipfree.show import style
from slipfree.show.plots import Plot
from slipfree.show.style import MM, PAGE

MAX_ELLIPSES = 6  # drawn, with the strongest correlations first
COLUMNS = 3
ROW_HEIGHT = 55.0  # [mm]
CIRCLE_POINTS = 100


def _pairs(estimate: Estimate) -> list[tuple[int, int]]:
    spread = np.sqrt(np.diag(estimate.covariance))
    known = np.flatnonzero((spread > 0) & (spread < np.inf)).tolist()

    def weakness(pair: tuple[int, int]) -> float:
        return -abs(float(estimate.covariance[pair] / spread[[*pair]].prod()))

    return sorted(combinations(known, 2), key=weakness)[:MAX_ELLIPSES]


def _draw_ellipse(ax: Axes, estimate: Estimate, i: int, j: int) -> None:
    part = estimate.covariance[np.ix_([i, j], [i, j])]
    values, vectors = np.linalg.eigh(part)
    radii = np.sqrt(np.maximum(values, 0) * float(chi2.ppf(CONFIDENCE, 2)))
    angle = np.linspace(0, 2 * np.pi, CIRCLE_POINTS)
    ring: Array = vectors @ (radii[:, None] * np.array([np.cos(angle), np.sin(angle)]))
    ax.plot(estimate.values[i] + ring[0], estimate.values[j] + ring[1], color=style.PALETTE[1])
    ax.plot(estimate.values[i], estimate.values[j], "+", color="black", ms=4)
    for k, set_label in ((i, ax.set_xlabel), (j, ax.set_ylabel)):
        label = estimate.labels[k]
        (ax.xaxis if k == i else ax.yaxis).set_major_locator(MaxNLocator(3))
        set_label(label.name if label.unit == "1" else f"{label.name} [{label.unit}]")


def soil_plot(name: str, measured: Array, fit: SoilFit) -> Plot:
    """Return the figure of a fit of a soil to quantities, shape (n, 4), to be drawn later."""
    words = (
        "Computed over measured quantities, with the constants before the fit and with those "
        "fitted to other runs, and 95 % confidence ellipses with the strongest correlations."
    )
    return Plot(name, words, partial(soil_figure, measured, fit))


def soil_figure(measured: Array, fit: SoilFit) -> Figure:
    """Return the figure of computed over measured quantities, and of ellipses of the estimate."""
    names, pairs = [*QUANTITIES.items()], _pairs(fit.estimate)
    panels = np.flatnonzero(np.isfinite(measured).any(axis=0)).tolist()
    rows = -(-(len(panels) + len(pairs)) // COLUMNS)
    made = style.figure(PAGE, rows * ROW_HEIGHT * MM)
    axes = iter(made.subplots(rows, COLUMNS, squeeze=False).ravel())
    models = {"before": fit.nominal, "fitted to others": fit.validated}
    for at, ax in zip(panels, axes, strict=False):
        for k, (label, values) in enumerate(models.items()):
            look: dict[str, Any] = {"ms": 2, "mew": 0, "alpha": 0.6, "color": style.PALETTE[k]}
            ax.plot(measured[:, at], values[:, at], "o", label=label, **look)
        ends = np.nanmin(measured[:, at]), np.nanmax(measured[:, at])
        ax.plot(ends, ends, color="black", lw=0.6)
        ax.set(xlabel="measured {} [{}]".format(*names[at]), ylabel="computed")
    made.axes[0].legend()
    for pair, ax in zip(pairs, axes, strict=False):
        _draw_ellipse(ax, fit.estimate, *pair)
    for ax in axes:
        ax.set_axis_off()
    return made


def fit_plot(name: str, scores: Mapping[WindowKind, Score]) -> Plot:
    """Return the figure of errors of predictions, to be drawn later, with the name of its file."""
    words = (
        "Errors of predictions of windows that were not fitted: of the position by length of path, "
        "of heading or course over that of the position, and of the slip by grade."
    )
    return Plot(name, words, partial(fit_figure, scores))


def fit_figure(scores: Mapping[WindowKind, Score]) -> Figure:
    """Return the figure of errors of predictions by kind of window."""
    made = style.figure(PAGE, 1.3 * ROW_HEIGHT * MM)
    place, turn, slide = made.subplots(1, 3)
    rows = list[tuple[float, ...]]()
    for k, (kind, score) in enumerate(scores.items()):
        color = style.PALETTE[k % len(style.PALETTE)]
        value, low, high = by_logs(score.errors.position, score.windows.log, rms)
        path = float(score.windows.length.mean())
        rows.append((path, value, *(max(x, 0.0) for x in (value - low, high - value))))
        share = np.linspace(0, 1, score.windows.log.size)
        turns = np.rad2deg(np.sort(np.abs(score.errors.turn)))
        turn.plot(turns, share, color=color, label=kind.words)
        slips = score.slip()
        middle = np.rad2deg([(low + high) / 2 for low, high, *_ in slips])
        slide.plot(middle, [100 * each[3] for each in slips], "o-", ms=3, color=color)
    path, value, *bars = np.nan_to_num(np.array(sorted(rows)).T)
    place.errorbar(path, value, bars, fmt="o-", ms=3, capsize=2, color=style.PALETTE[0])
    place.set(xlabel="path [m]", ylabel="position error, rms [m]", xlim=(0, None), ylim=(0, None))
    turn.set(xlabel="error of the heading or course [deg]", ylabel="share of windows")
    slide.set(xlabel="grade [deg]", ylabel="error of the slip, median [%]")
    slide.axhline(0, color="black", lw=0.6)
    turn.legend(fontsize="x-small")
    return made
