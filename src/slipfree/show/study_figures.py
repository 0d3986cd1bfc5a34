"""Figures of many runs: sweeps, fronts of slip against another cost, tests of a wheel, fits.

Each drawing function of a sweep draws on the given axes, labels the artists for a legend, and
returns the axes; the caller adds the legend. ``sweep_plots`` returns one figure per metric:
the distribution over the runs without varied keys, a curve for one key, a heat map for two keys.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import combinations
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from scipy.stats import chi2

from slipfree.core.facts import printed_unit
from slipfree.core.records import Array
from slipfree.fit.drive_fit import Score, WindowKind, by_logs, rms
from slipfree.fit.estimate import CONFIDENCE
from slipfree.fit.wheel_soil import QUANTITIES, SoilFit
from slipfree.models.single_wheel import WheelCurves
from slipfree.plan.pareto import FrontPoint
from slipfree.show import style
from slipfree.show.plots import Panel, Plot, Swept, Varied, stack
from slipfree.show.style import MM, PAGE, PALETTE, STOPPED

# words in the names of metrics, and their colours, on which black numbers are legible
COLOURS = {
    "margin|clearance|within_limits|complete": style.RISK.reversed(),
    "slip|utilisation|friction|tilt|sinkage|violation": style.RISK,
    "": style.HEIGHTS,
}
NOTHING = "0.85"  # colour of cells without a run
MOST_WORDS = 8  # maximum number of cells per side with numbers
ROOM = 7  # maximum number of horizontal texts at an axis
WIDE = 30.0  # smallest ratio of values drawn on a logarithmic axis
SWEPT_HEIGHT = 61.0  # of a panel [mm]
TANGENT = 0.06  # length of a tangent on each side [second objective]
FAILED_HEIGHT = 0.03  # height of the marks of unsolved points [axes]
PANELS = (
    ("pull", "drawbar pull [N]", 1.0),
    ("side", "side force [N]", 1.0),
    ("torque", "torque [N m]", 1.0),
    ("sinkage", "sinkage [mm]", 1e3),
)  # quantity, axis label, factor from SI units
SAME_LOAD = 0.01  # relative difference from the load of the curves [1]
SAME_ANGLE = np.deg2rad(0.5)  # measured points within this angle of a curve have its colour [rad]
MAX_ELLIPSES = 6  # drawn, with the strongest correlations first
COLUMNS = 3
ROW_HEIGHT = 55.0  # [mm]
CIRCLE_POINTS = 100


def distribution(swept: Swept, ax: Axes) -> Axes:
    """Draw the cumulative distribution over the runs, and the mean."""
    values = swept.values[np.isfinite(swept.values)]
    count = "1 run" if values.size == 1 else f"{values.size} runs"
    ax.ecdf(values, color=PALETTE[0], label=count)
    ax.axvline(values.mean(), color=PALETTE[1], ls="--", label=f"mean {values.mean():.4g}")
    ax.set_xlabel(_labelled(swept.name, swept.unit))
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
        look: dict[str, Any] = {"color": PALETTE[0], "alpha": 0.3, "label": "range"}
        if varied.numbers:
            ax.fill_between(x, low, high, lw=0, **look)
        else:
            ax.vlines(x, low, high, lw=3, **look)
        at = np.repeat(x, values.shape[1])
        ax.plot(at, values.ravel(), ".", ms=3, mew=0, color="0.35", label="runs", zorder=2)
    if not varied.numbers:
        _ticks(ax.xaxis, varied.values)
    ax.set_xlabel(_labelled(varied.name, varied.unit))
    ax.set_ylabel(_labelled(swept.name, swept.unit))
    return ax


def heat_map(swept: Swept, ax: Axes) -> Axes:
    """Draw a heat map of the mean over repetitions against two keys, grey without value."""
    across, up = swept.axes
    mean = _over(np.nanmean, swept.values)
    orders = [np.argsort(_positions(each)) for each in (across, up)]
    mean = mean[np.ix_(*orders)]
    ax.set_facecolor(NOTHING)
    colors = next(colors for words, colors in COLOURS.items() if re.search(words, swept.name))
    drawn: Any = ax.imshow(mean.T, origin="lower", aspect="auto", cmap=colors)
    bar = ax.figure.colorbar(drawn, ax=ax)
    more = ", mean" if swept.values.shape[-1] > 1 else ""
    bar.set_label(_labelled(f"{swept.name}{more}", swept.unit))
    for axis, varied, order in zip((ax.xaxis, ax.yaxis), (across, up), orders, strict=True):
        numbers = varied.numbers or ()
        # as many digits as tell the numbers apart, such as northings with seven before the point
        n = next(n for n in range(4, 18) if len({f"{x:.{n}g}" for x in numbers}) == len({*numbers}))
        names = [f"{x:.{n}g}" for x in numbers] or varied.values
        _ticks(axis, [names[k] for k in order])
        axis.set_label_text(_labelled(varied.name, varied.unit))
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
    axis.set_ticks(
        range(0, len(values), every),
        words,
        rotation=45 if crowded else 0,
        **({"ha": "right"} if crowded else {}),
    )


def _labelled(name: str, unit: str) -> str:
    return f"{name} [{printed_unit(unit)}]" if unit else name


def front_plot(against: str, unit: str, points: Sequence[FrontPoint], given: FrontPoint) -> Plot:
    """Return the figure of a front: minimised objective with tangents, and slip per metre.

    ``against`` and ``unit`` are those of the second objective. Solutions of ``points``, and of the
    plan ``given`` with the costs of the problem, have the slip per wheel and metre in ``slip``.
    """

    def upper(ax: Axes) -> None:
        """Draw first over second objective, with tangents from the multipliers of the bounds."""
        _draw_points(points, given, lambda point: 1e6 * point.first, ax)
        label = "slope (price)"
        for point in points:  # short tangents, by the derivative with respect to the bound
            away = TANGENT * point.second * np.array([-1.0, 1.0])
            values = 1e6 * (point.first + point.slope * away)
            if point.slope < 0 and values.min() > 0:
                ax.plot(point.second + away, values, lw=2.5, alpha=0.5, color="0.4", label=label)
                label = ""
        ax.set_ylabel("squared slip and\nsmoothness [mm$^2$/s]")

    def lower(ax: Axes) -> None:
        _draw_points(points, given, lambda point: 1e3 * point.solution.slip, ax)
        ax.set_ylabel("slip [mm per\nwheel and metre]")
        ax.set_xlabel(f"{style.words(against)} [{printed_unit(unit)}]")

    return Plot("pareto", "Pareto front", lambda: stack(None, [Panel(upper), Panel(lower)]))


def _draw_points(
    points: Sequence[FrontPoint], given: FrontPoint, value: Callable[[FrontPoint], float], ax: Axes
) -> None:
    """Draw the points of a Pareto front: solved, dominated, not solved, and the given one."""
    solved = [point for point in points if point.is_solved]
    shown = [value(point) for point in (*solved, given)]
    if min(shown) > 0 and max(shown) > WIDE * min(shown):
        ax.set_yscale("log")
    kept = [point for point in solved if not point.is_dominated]
    look: dict[str, Any] = {"ms": 4, "color": PALETTE[0]}
    ax.plot([point.second for point in kept], [*map(value, kept)], "o-", label="front", **look)
    if worse := [point for point in solved if point.is_dominated]:
        at = [point.second for point in worse]
        ax.plot(at, [*map(value, worse)], "o", mfc="none", label="dominated", **look)
    if missed := [point.bound for point in points if not point.is_solved]:
        heights, across = [FAILED_HEIGHT] * len(missed), ax.get_xaxis_transform()
        ax.plot(missed, heights, "x", color=STOPPED, label="not solved", transform=across)
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
        "fitted to other runs, and 95 % confidence ellipses with the strongest correlations."
    )
    return Plot(name, words, partial(soil_figure, measured, fit))


def soil_figure(measured: Array, fit: SoilFit) -> Figure:
    """Return the figure of computed over measured quantities, and of ellipses of the estimate."""
    names, estimate = [*QUANTITIES.items()], fit.estimate
    spread = np.sqrt(np.diag(estimate.covariance))
    known = np.flatnonzero((spread > 0) & (spread < np.inf)).tolist()

    def weakness(pair: tuple[int, int]) -> float:
        return -abs(float(estimate.covariance[pair] / spread[[*pair]].prod()))

    pairs = sorted(combinations(known, 2), key=weakness)[:MAX_ELLIPSES]
    panels = np.flatnonzero(np.isfinite(measured).any(axis=0)).tolist()
    rows = -(-(len(panels) + len(pairs)) // COLUMNS)
    made = style.figure(PAGE, rows * ROW_HEIGHT * MM)
    axes = iter(made.subplots(rows, COLUMNS, squeeze=False).ravel())
    models = {"before": fit.nominal, "fitted to others": fit.validated}
    for at, ax in zip(panels, axes, strict=False):
        for k, (label, values) in enumerate(models.items()):
            look: dict[str, Any] = {"ms": 2, "mew": 0, "alpha": 0.6, "color": PALETTE[k]}
            ax.plot(measured[:, at], values[:, at], "o", label=label, **look)
        ends = np.nanmin(measured[:, at]), np.nanmax(measured[:, at])
        ax.plot(ends, ends, color="black", lw=0.6)
        ax.set(xlabel="measured {} [{}]".format(*names[at]), ylabel="computed")
    made.axes[0].legend()
    for pair, ax in zip(pairs, axes, strict=False):
        values, vectors = np.linalg.eigh(estimate.covariance[np.ix_(pair, pair)])
        radii = np.sqrt(np.maximum(values, 0) * float(chi2.ppf(CONFIDENCE, 2)))
        angle = np.linspace(0, 2 * np.pi, CIRCLE_POINTS)
        ring: Array = vectors @ (radii[:, None] * np.array([np.cos(angle), np.sin(angle)]))
        x, y = estimate.values[[*pair]]
        ax.plot(x + ring[0], y + ring[1], color=PALETTE[1])
        ax.plot(x, y, "+", color="black", ms=4)
        for k, axis in zip(pair, (ax.xaxis, ax.yaxis), strict=True):
            name, unit = estimate.labels[k].name, estimate.labels[k].unit
            axis.set_major_locator(MaxNLocator(3))
            axis.set_label_text(name if unit == "1" else f"{name} [{unit}]")
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
