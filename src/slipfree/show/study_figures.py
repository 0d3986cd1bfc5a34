"""Figures of many runs: sweeps, fronts of slip against another cost, tests of a wheel, fits.

Each drawing function of a sweep draws on the given axes, labels the artists for a legend, and
returns the axes; the caller adds the legend. ``sweep_plots`` returns one figure per metric:
the distribution over the runs without varied keys, a curve for one key, a heat map for two keys.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from slipfree.core.facts import printed_unit
from slipfree.core.records import Array
from slipfree.fit.drive_fit import Score, WindowKind, by_logs, rms
from slipfree.fit.wheel_soil import QUANTITIES, SoilFit
from slipfree.models.single_wheel import WheelCurves
from slipfree.plan.pareto import FrontPoint
from slipfree.show import style
from slipfree.show.plots import Panel, Plot, Swept, Varied, stack
from slipfree.show.style import MM, PAGE, PALETTE

# words in the names of metrics; whether large values are risks (1) or good (-1)
RISKS = {
    "margin|clearance|within_limits|complete": -1,
    "slip|utilisation|friction|tilt|sinkage|violation": 1,
    "": 0,
}
# on which black numbers are legible
COLOURS = {-1: style.RISK.reversed(), 1: style.RISK, 0: style.HEIGHTS}
NOTHING = "0.85"  # colour of cells without a run
MOST_WORDS = 8  # maximum number of cells per side with numbers
ROOM = 7  # maximum number of horizontal texts at an axis
WIDE = 30.0  # smallest ratio of values drawn on a logarithmic axis
SWEPT_HEIGHT = 61.0  # of a panel [mm]
PANELS = (
    ("pull", "drawbar pull [N]", 1.0),
    ("side", "side force [N]", 1.0),
    ("torque", "torque [N m]", 1.0),
    ("sinkage", "sinkage [mm]", 1e3),
)  # quantity, axis label, factor from SI units
SAME_LOAD = 0.01  # relative difference from the load of the curves [1]
SAME_ANGLE = np.deg2rad(0.5)  # measured points within this angle of a curve have its colour [rad]
COLUMNS = 3
ROW_HEIGHT = 55.0  # [mm]


def distribution(swept: Swept, ax: Axes) -> Axes:
    """Draw the cumulative distribution over the runs, and the mean."""
    values = swept.values[np.isfinite(swept.values)]
    count = "1 run" if values.size == 1 else f"{values.size} runs"
    ax.ecdf(values, color=PALETTE[0], label=count)
    ax.axvline(values.mean(), color=PALETTE[1], ls="--", label=f"mean {values.mean():.4g}")
    ax.set_xlabel(labelled(swept.name, swept.unit))
    ax.set_ylabel("share of runs [1]")
    return ax


def curve(swept: Swept, ax: Axes) -> Axes:
    """Draw mean and range over repetitions, and the value of every run, over one varied key."""
    (varied,) = swept.axes
    x, values = _positions(varied), swept.values
    order = np.argsort(x)
    x, values = x[order], values[order]
    mean, low, high = (_over(f, values) for f in (np.nanmean, np.nanmin, np.nanmax))
    line = "-" if varied.numbers else "none"
    is_repeated = values.shape[1] > 1
    label = "mean" if is_repeated else None
    ax.plot(x, mean, "o", ls=line, ms=4, color=PALETTE[0], label=label, zorder=3)
    if is_repeated:
        ax.vlines(x, low, high, lw=3, color=PALETTE[0], alpha=0.3, label="range")
        at = np.repeat(x, values.shape[1])
        ax.plot(at, values.ravel(), ".", ms=3, mew=0, color="0.35", label="runs", zorder=2)
    if not varied.numbers:
        _ticks(ax.xaxis, varied.values)
    ax.set_xlabel(labelled(varied.name, varied.unit))
    ax.set_ylabel(labelled(swept.name, swept.unit))
    return ax


def heat_map(swept: Swept, ax: Axes) -> Axes:
    """Draw a heat map of the mean over repetitions against two keys, grey without value."""
    across, up = swept.axes
    mean = _over(np.nanmean, swept.values)
    orders = [np.argsort(_positions(each)) for each in (across, up)]
    mean = mean[np.ix_(*orders)]
    ax.set_facecolor(NOTHING)
    drawn: Any = ax.imshow(mean.T, origin="lower", aspect="auto", cmap=COLOURS[risk(swept.name)])
    bar = ax.figure.colorbar(drawn, ax=ax)
    more = ", mean" if swept.values.shape[-1] > 1 else ""
    bar.set_label(labelled(f"{swept.name}{more}", swept.unit))
    for axis, varied, order in zip((ax.xaxis, ax.yaxis), (across, up), orders, strict=True):
        _ticks(axis, [varied.words[k] for k in order])
        axis.set_label_text(labelled(varied.name, varied.unit))
    is_small = max(mean.shape) <= MOST_WORDS
    for i, j in np.argwhere(np.isfinite(mean)).tolist() if is_small else ():
        ax.text(i, j, f"{mean[i, j]:.3g}", ha="center", va="center", fontsize=6)
    return ax


def sweep_plots(quantities: Sequence[Swept]) -> list[Plot]:
    """Return the figures of metrics over at most two varied keys."""

    def make(swept: Swept) -> Figure:
        draw = (distribution, curve, heat_map)[len(swept.axes)]
        return stack(None, [Panel(partial(draw, swept), SWEPT_HEIGHT)])

    return [Plot(each.name, "", partial(make, each)) for each in quantities]


def risk(name: str) -> int:
    """Return the sign of the risk of large values of a metric, zero if it is neither."""
    return next(sign for words, sign in RISKS.items() if re.search(words, name))


def _over(reduce: Any, values: Array) -> Array:
    """Return a reduction such as the mean over repetitions; NaN where no repetition has a value."""
    there = np.isfinite(values).any(axis=-1)
    reduced = np.full(there.shape, np.nan)
    reduced[there] = reduce(values[there], axis=-1)
    return reduced


def _positions(varied: Varied) -> Array:
    """Return the positions of values on an axis: numbers, or consecutive integers."""
    return np.array(varied.numbers or range(len(varied.values)), dtype=float)


def _ticks(axis: Any, values: Sequence[str]) -> None:
    """Label an axis with varied values, at most so many that they are legible."""
    every = -(-len(values) // (2 * ROOM))
    words = [value.strip('"') for value in values[::every]]
    crowded = axis.axis_name == "x" and sum(map(len, words)) > 6 * ROOM
    look: dict[str, Any] = {"rotation": 45, "ha": "right"} if crowded else {}
    axis.set_ticks(range(0, len(values), every), words, **look)


def labelled(name: str, unit: str) -> str:
    """Return the name of a quantity with its unit."""
    return f"{name} [{printed_unit(unit)}]" if unit else name


def front_plot(against: str, unit: str, points: Sequence[FrontPoint], given: FrontPoint) -> Plot:
    """Return the figure of a front: minimised objective, and slip per metre.

    ``against`` and ``unit`` are those of the second objective. Solutions of ``points``, and of the
    plan ``given`` with the costs of the problem, have the slip per wheel and metre in ``slip``.
    """

    def upper(ax: Axes) -> None:
        _draw_points(points, given, lambda point: 1e6 * point.first, ax)
        ax.set_ylabel("squared slip and\nsmoothness [mm$^2$/s]")

    def lower(ax: Axes) -> None:
        _draw_points(points, given, lambda point: 1e3 * point.solution.slip, ax)
        ax.set_ylabel("slip [mm per\nwheel and metre]")
        ax.set_xlabel(f"{style.words(against)} [{printed_unit(unit)}]")

    return Plot("pareto", "Pareto front", lambda: stack(None, [Panel(upper), Panel(lower)]))


def _draw_points(
    points: Sequence[FrontPoint], given: FrontPoint, value: Callable[[FrontPoint], float], ax: Axes
) -> None:
    """Draw the points of a Pareto front that are not dominated, and the given one."""
    kept = [point for point in points if point.is_solved and not point.is_dominated]
    values = [*map(value, kept)]
    if 0 < WIDE * min(values, default=0.0) < max(values, default=0.0):
        ax.set_yscale("log")
    ax.plot([e.second for e in kept], values, "o-", label="front", ms=4, color=PALETTE[0])
    star: dict[str, Any] = {"ms": 8, "color": PALETTE[1], "zorder": 3}
    ax.plot(given.second, value(given), "*", label="costs of the problem", **star)


def wheel_plot(
    name: str,
    curves: WheelCurves,
    load: float,
    measured: Mapping[str, tuple[Array, Array, Array, Array]],
) -> Plot:
    """Return the undrawn figure of a single-wheel test, with the name of its file.

    ``load`` is that of the curves [N]; ``measured`` are slip ratios, slip angles [rad], loads [N]
    and values of the measured quantities, by name.
    """

    def panel(quantity: str, words: str, factor: float, ax: Axes) -> None:
        """Draw a quantity over the slip ratio: curves of the law, and measured points."""
        ax.set(xlabel="slip ratio [1]", ylabel=words)
        for k, angle in enumerate(curves.angle):
            computed, label = getattr(curves, quantity)[k], f"{np.rad2deg(angle):.3g} deg"
            ax.plot(curves.slip, factor * computed, label=label, **style.look(k))
            if quantity in measured:
                slip, angles, loads, values = measured[quantity]
                near = np.abs(angles - angle) < SAME_ANGLE
                same = np.abs(loads / load - 1) < SAME_LOAD
                for marker, rows in (("o", near & same), ("x", near & ~same)):
                    look = {"ms": 2.5, "mfc": "none", "mew": 0.6, "color": style.look(k)["color"]}
                    ax.plot(slip[rows], factor * values[rows], marker, ls="", **look)

    words = "Drawbar pull, side force, torque and sinkage over the slip ratio."
    return Plot(name, words, lambda: stack(None, [Panel(partial(panel, *each)) for each in PANELS]))


def soil_plot(name: str, measured: Array, fit: SoilFit) -> Plot:
    """Return the figure of a fit of a soil to quantities, shape (n, 4), to be drawn later."""
    words = (
        "Computed over measured quantities, with the constants before the fit and with those "
        "fitted to other runs."
    )
    return Plot(name, words, partial(soil_figure, measured, fit))


def soil_figure(measured: Array, fit: SoilFit) -> Figure:
    """Return the figure of computed over measured quantities."""
    panels = np.flatnonzero(np.isfinite(measured).any(axis=0)).tolist()
    rows = -(-len(panels) // COLUMNS)
    made = style.figure(PAGE, rows * ROW_HEIGHT * MM)
    axes = made.subplots(rows, COLUMNS, squeeze=False).ravel()
    models = {"before": fit.nominal, "fitted to others": fit.validated}
    for at, ax in zip(panels, axes, strict=False):
        for k, (label, values) in enumerate(models.items()):
            look: dict[str, Any] = {"ms": 2, "mew": 0, "alpha": 0.6, "color": PALETTE[k]}
            ax.plot(measured[:, at], values[:, at], "o", label=label, **look)
        ends = np.nanmin(measured[:, at]), np.nanmax(measured[:, at])
        ax.plot(ends, ends, color="black", lw=0.6)
        ax.set(xlabel="measured {} [{}]".format(*[*QUANTITIES.items()][at]), ylabel="computed")
    axes[0].legend()
    for ax in axes[len(panels) :]:
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
        color = PALETTE[k % len(PALETTE)]
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
    place.errorbar(path, value, bars, fmt="o-", ms=3, capsize=2, color=PALETTE[0])
    place.set(xlabel="path [m]", ylabel="position error, rms [m]", xlim=(0, None), ylim=(0, None))
    turn.set(xlabel="error of the heading or course [deg]", ylabel="share of windows")
    slide.set(xlabel="grade [deg]", ylabel="error of the slip, median [%]")
    slide.axhline(0, color="black", lw=0.6)
    turn.legend(fontsize="x-small")
    return made
