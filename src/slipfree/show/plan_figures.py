"""Figures of a plan: map of traversability with routes, and planned quantities with bounds.

Each drawing function draws on the given axes, labels the artists for a legend, and returns the
axes; the caller adds the legend. ``plan_plots`` composes the figures.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, Normalize, to_rgba
from matplotlib.figure import Figure

from slipfree.core.facts import starting_with
from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.routing.traversability import Traversability, blocked_by
from slipfree.show import ground_drawing, style
from slipfree.show.ground_drawing import Place, Window
from slipfree.show.plots import WRAP, Panel, Plot, beside, stack
from slipfree.show.style import MM, PAGE, PLATFORM
from slipfree.terrain.base import Grid

# The scale is light blue, so that warm colours mark blocked nodes; all differ in lightness too.
COSTS = ListedColormap(colormaps["Blues"](np.linspace(0.08, 0.85, 256)), name="costs")
MAX_PERCENTILE = 99.0  # percentile of the costs at the end of the scale, without extreme nodes
MIN_SCALE_END = 1.1  # smallest end of the scale, for uniform costs [1]
BLOCKED = {  # colour and description of blocked nodes by reason, in order of priority
    "keep_out": ("0.4", "too close to a keep-out region"),
    "edge": ("0.8", "too close to the edge of the map"),
    "hole": ("0.9", "too close to a hole in the map"),
    "friction": ("#D55E00", "friction holds no heading"),
    "pose": ("#CC79A7", "the vehicle does not stand"),
}
ROW = 34.0  # height of a row of the figure of a plan [mm]
NO_GUESS = np.zeros((0, 2))
TRACKING_HEIGHT = 70.0  # [mm]
ENTRIES = 7  # lines of a legend beside a row of that height
Range = tuple[float, float]
NO_AREAS: Mapping[str, Window] = {}


def cost_map(layers: Traversability, grid: Grid, ax: Axes, window: Window) -> Axes:
    """Draw the cost in the best direction in a window of the map, and reasons of blocked nodes.

    Without poses, only the reasons are drawn.
    """
    where = ground_drawing.extent(layers.x, layers.y) | {"interpolation": "nearest"}
    shown = (layers.x >= window[0]) & (layers.x <= window[1])
    part = shown[:, None] & (layers.y >= window[2]) & (layers.y <= window[3])
    least = layers.least_cost
    free = np.isfinite(least)
    inside = least[free & part]
    top = MIN_SCALE_END
    if inside.size:
        top = max(float(np.percentile(inside, MAX_PERCENTILE)), MIN_SCALE_END)
    costs = ax.imshow(np.where(free, least, np.nan).T, cmap=COSTS, norm=Normalize(1, top), **where)
    colors, masks, left = np.zeros((*least.shape, 4)), blocked_by(layers), np.isinf(least)
    for name, (color, words) in BLOCKED.items():
        mine = masks[name] & left
        colors[mine] = to_rgba(color)
        left = left & ~mine
        if (mine & part).any():
            ax.plot([], [], "s", color=color, ms=6, label=words)
    ax.imshow(colors.transpose(1, 0, 2), **where)
    ground_drawing.contours(grid, ax, window)
    ground_drawing.hatch(grid, grid.holes, window, "no heights", "0.4", ax)
    ground_drawing.plan_marks(ax, layers.limits.keep_out)
    if layers.poses is None:
        return ax
    dearer = inside.size > 0 and inside.max() > top
    label = "cost of 1 m of path [m of level ground]"
    style.side_bar(costs, ax, label, "max" if dearer else "neither")
    return ax


def initial_routes(routes: Sequence[Array], ax: Axes) -> Axes:
    """Draw the routes of the initial guesses, shape (n, 2) each [m], with their lengths."""
    for k, points in enumerate(routes):
        length = float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())
        name = f"initial route {k + 1}" if len(routes) > 1 else "initial route"
        ax.plot(
            *points.T,
            color=PLATFORM,
            ls=style.DASHES[1 + k % 3],
            lw=1.0,
            zorder=3,
            label=f"{name}, {length:.4g} m",
            path_effects=style.halo(2.0),
        )
    return ax


def motion(
    run: Trajectory, places: Sequence[Place], ax: Axes, areas: Mapping[str, Window] = NO_AREAS
) -> Axes:
    """Draw the planned path of the platform's centre, with start, way-points and goal.

    Places that have an area are drawn as areas.
    """
    look: dict[str, Any] = {"color": PLATFORM, "lw": 1.6, "path_effects": style.halo(3.0)}
    ax.plot(run["x"], run["y"], zorder=4, label="planned motion", **look)
    return ground_drawing.plan_marks(ax, (), places, areas)


def inputs(run: Trajectory, bounds: Mapping[str, Range], ax: Axes) -> Axes:
    """Draw the planned inputs over time and their finite bounds."""
    ends: dict[float, list[str]] = {}
    style.history(run, [*bounds], ax)
    for k, pair in enumerate(bounds.values()):
        for value in filter(np.isfinite, pair):
            ends.setdefault(value, []).append(style.look(k)["color"])
    for value, colors in ends.items():
        # a bound of several inputs is grey
        _bound(value, ax, colors[0] if len(colors) == 1 else "0.4", "bound")
    return ax


def limited(run: Trajectory, name: str, pair: Range, ax: Axes) -> Axes:
    """Draw a quantity, or that of a wheel as in ``slip_along[left]``, over time with its limits."""
    quantity, _, wheel = name.removesuffix("]").partition("[")
    style.history(run, quantity, ax)
    for line in list(ax.lines) if wheel else []:
        if line.get_label() != style.words(wheel):
            line.remove()
    for value in filter(np.isfinite, pair):
        _bound(value, ax)
    return ax


def keep_out_distance(run: Trajectory, layers: Traversability, ax: Axes) -> Axes:
    """Draw the distance between the circle around the wheels and each keep-out region over time."""
    for k, region in enumerate(layers.limits.keep_out):
        away = region.distance(run["x"], run["y"]) - layers.limits.reach
        ax.plot(run.t, away, label=region.words, **style.look(k))
    _bound(0.0, ax)
    ax.set_ylabel("distance to keep-out regions [m]")
    return style.time_axis(run, ax)


def plan_plots(
    run: Trajectory,
    grid: Grid,
    layers: Traversability,
    *,
    places: Sequence[Place] = (),
    areas: Mapping[str, Window] = NO_AREAS,
    found: Sequence[Array] = (),
    guess: Array = NO_GUESS,
    bounds: Mapping[str, Range] | None = None,
    limits: Mapping[str, Range] | None = None,
) -> tuple[Plot, ...]:
    """Return the figures of a plan, not drawn yet: inputs and limits, and the map.

    ``places`` are names, x and y of start, way-points and goal, ``areas`` the areas of those that
    are no points; ``found`` and ``guess`` routes and
    paths of the initial guesses, with NaN between paths, all in map coordinates [m].
    """
    bounds, limits = bounds or {}, limits or {}
    drawings: list[tuple[float, Callable[[Axes], Any]]] = []
    if bounds:
        entries = sum(len(textwrap.wrap(style.words(name), WRAP)) for name in bounds)
        drawings.append((max(1.0, (entries + 1) / ENTRIES), partial(inputs, run, bounds)))
    drawings += [(1.0, partial(limited, run, name, pair)) for name, pair in limits.items()]
    if layers.limits.keep_out:
        drawings.append((1.0, partial(keep_out_distance, run, layers)))
    panels = [Panel(beside(draw), ROW * height, has_legend=False) for height, draw in drawings]
    shown = {"m": ".2g>mm", "rad": ".2g>deg"}  # units that people read
    missed = [
        f"{style.words(name)} {gap:{shown.get(gap.unit, '.2g')}}"
        for name, gap in starting_with("plan_difference_", run.facts).items()
    ]
    note = f"Simulated with the planned inputs; deviates from the plan by {', '.join(missed)}."

    def draw_map() -> Figure:
        """Draw cost map, routes, initial guess and motion of a plan."""
        known = guess[np.isfinite(guess).all(axis=1)]
        points = np.concatenate([np.stack([run["x"], run["y"]], axis=1), *found, known])
        figure, ax, window = ground_drawing.map_figure(points[:, 0], points[:, 1], grid, 0.25)
        cost_map(layers, grid, ax, window)
        initial_routes(found, ax)
        if guess.size:
            edge = style.halo(1.7)
            ax.plot(*guess.T, color="0.35", lw=0.7, label="initial guess", path_effects=edge)
        motion(run, places, ax, areas)
        return style.cropped(style.finished(figure, run, [ax]), ax)

    caption = "Planned inputs, and quantities with their limits."
    planned = Plot("plan", caption, lambda: stack(run, panels, note if missed else ""))
    caption = "Cost per metre of path, initial guess, and the planned motion."
    ground = Plot("traversability", caption, draw_map)
    return (planned, ground) if panels else (ground,)


def tracking_plot(
    name: str,
    plan: Trajectory,
    motions: Sequence[tuple[str, Trajectory]],
    grid: Grid,
    marks: Mapping[str, Any] = {},
) -> Plot:
    """Return the figure of motions that follow a plan, with the names of their controllers.

    ``marks`` are the keyword arguments of `plan_marks` for the regions and places of the plan.
    """
    caption = "Paths of a plan and of the motions that follow it, and distances at equal times."

    def make() -> Figure:
        """Draw plan and tracked motions on a map, and their distances over time."""
        figure = style.figure(PAGE, TRACKING_HEIGHT * MM)
        ground, error = figure.subplots(1, 2)
        runs = [plan, *(run for _, run in motions)]
        x, y = (np.concatenate([run[axis] for run in runs]) for axis in "xy")
        ground_drawing.muted(grid, ground, ground_drawing.about(x, y, grid, 0.15))
        ground_drawing.plan_marks(ground, **marks)
        wide: dict[str, Any] = {"color": PLATFORM, "lw": 3.5, "alpha": 0.4}
        ground.plot(plan["x"], plan["y"], label="plan", **wide)
        names = list(dict.fromkeys(name for name, _ in motions))
        for way, run in motions:
            look = style.look(names.index(way))
            ground.plot(run["x"], run["y"], lw=1.0, zorder=3, **look)
            at = [np.interp(run.t, plan.t, plan[axis]) for axis in "xy"]
            distance = np.hypot(run["x"] - at[0], run["y"] - at[1])
            error.plot(run.t, distance, lw=1.0, label=way, **look)
        style.time_axis(plan, error).set_ylabel("distance from the plan [m]")
        return style.finished(figure, plan, [ground, error])

    return Plot(name, caption, make)


def _bound(value: float, ax: Axes, color: str = "0.4", words: str = "limit") -> None:
    ax.axhline(value, color=color, lw=0.8, ls=(0, (6, 2)), zorder=1, label=words)
    ax.autoscale(axis="y")  # an axis in degrees has fixed the limits of the other
