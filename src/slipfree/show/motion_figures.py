"""Figures of a motion and of its ground.

Each drawing function draws on the given axes, labels the artists for a legend, and returns the
axes; the caller adds the legend. ``motion_plots`` composes the standard figures.
Angles are drawn in radians, with degrees on a second axis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter

from slipfree.atlas.atlas import Atlas
from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError, check_known
from slipfree.core.quantities import QUANTITIES, joint_angles
from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.models.samples import CLOSEST, has_friction
from slipfree.plan.plan import Plan
from slipfree.show import ground_drawing, style
from slipfree.show.atlas_figures import atlas_plots, view_of
from slipfree.show.ground_drawing import HEATMAP, side_plot
from slipfree.show.plots import Panel, Plot, PlottedDrive, beside, draw, stack
from slipfree.show.style import PAGE, PLATFORM, STEEP, STOPPED
from slipfree.terrain.base import Grid, Terrain
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.solids import Prism, Solids

OVER = "#67001F"  # colour of utilisation above one
CEILING = 3.0  # largest drawn utilisation
HEADROOM = 1.1  # height of the axes over the largest utilisation
LEAST_SLIP = 1.0  # smallest end of the colours of slip [mm/s]
Compose = Callable[[PlottedDrive], Plot | None]
FILLED = "#D60093"  # hatching of filled holes
ROUNDING = 1e-9  # smaller slip is rounding [m/s]
STILL = 1e-9  # a joint that moves less counts as fixed [rad]
BELOW: dict[str, Any] = {"color": "0.75", "lw": 2.6, "zorder": 1}  # visible below other lines
DISTINCT = 0.01  # smallest distance of distinguishable lines [height of the axes]
AROUND = 0.5  # margin of the ground drawn around a motion [extent of the motion]
NODES = 101  # of an axis of the ground of a formula
NOTES = {  # on the slip, by model
    "kinematics": "Least slip that the kinematics allows, a lower bound; real slip depends on "
    "friction.",
    "quasi-static": "Slip of quasi-static equilibrium under friction, without inertia.",
    "dynamics": "Slip of a motion with inertia and compliant contact.",
}


def utilisation(run: Trajectory, ax: Axes) -> Axes:
    """Draw the utilisation of friction of every wheel over time, and its largest value."""
    values = run["utilisation"]
    for k, wheel in enumerate(run.wheels):
        ax.plot(run.t, _finite(values[:, k]), label=style.words(wheel), **style.look(k))
    if "utilisation_best" in run:
        best = _finite(run["utilisation_best"])
        ax.plot(run.t, best, color="black", ls=":", lw=0.8, label="optimal distribution of forces")
    words = "friction limit" if has_friction(run) else "a friction coefficient of 1"
    ax.axhline(1, color="0.4", lw=0.8, ls="--", label=words)
    largest = float(values.max())
    ax.set_ylim(0, CEILING if largest > CEILING else HEADROOM * max(1.0, largest))
    ax.set_ylabel(f"{_quantity(run)} [1]")
    style.time_axis(run, ax)
    if largest > CEILING:
        words = "" if np.isfinite(largest) else "; infinite where a wheel bears no load"
        ax.plot([], [], " ", label=f"not drawn above {CEILING:g}{words}")
    k, worst = _worst(run)
    height = min(float(values[k, worst]), ax.get_ylim()[1])
    mark: dict[str, Any] = {"color": style.look(worst)["color"], "mec": "black", "ms": 5}
    ax.plot(
        run.t[k], height, "o", label=_worst_words(run), ls="none", clip_on=False, zorder=5, **mark
    )
    return ax


def tracks(run: Trajectory, ax: Axes) -> Axes:
    """Draw the tracks of contact points in plan view, coloured by utilisation, or by slip.

    The largest utilisation is marked.
    """
    if "utilisation" in run:
        values, top, label = run["utilisation"], 1.0, f"{_quantity(run)} [1]"
    else:
        values = 1e3 * np.hypot(run["slip_along"], run["slip_across"])
        top, label = max(float(values.max()), LEAST_SLIP), "slip [mm/s]"
    x, y = run["contact_x"], run["contact_y"]
    ax.plot(x, y, lw=3, color="white", solid_capstyle="round", zorder=2)
    points = np.stack([x, y], axis=-1)
    pieces = np.stack([points[:-1], points[1:]], axis=2).reshape(-1, 2, 2)
    largest = _finite(np.maximum(values[:-1], values[1:])).ravel()
    order = np.argsort(largest, kind="stable")
    look: dict[str, Any] = {"linewidths": 2, "capstyle": "round", "zorder": 3}
    look |= {"cmap": style.RISK.with_extremes(over=OVER), "norm": Normalize(0, top)}
    lines = LineCollection(list(pieces[order]), array=largest[order], **look)
    ax.add_collection(lines, autolim=False)
    style.side_bar(lines, ax, label, "max")
    if "utilisation" in run:
        k, wheel = _worst(run)
        mark: dict[str, Any] = {"ls": "none", "mfc": "none", "mec": "black", "zorder": 4}
        ax.plot(x[k, wheel], y[k, wheel], "D", ms=8, label=_worst_words(run), **mark)
        if values[k, wheel] > 1:
            words = "above the friction limit" if has_friction(run) else "above 1"
            ax.plot([], [], color=OVER, lw=2, label=words)
    return ax


def utilisation_plot(scene: PlottedDrive) -> Plot | None:
    """Return the figure of the friction that the wheels need; None for a vehicle without mass."""
    run = scene.run
    if "utilisation" not in run:
        return None
    panels = [Panel(partial(utilisation, run), 60)]
    if "tip_over_margin" in run:
        margin = partial(style.history, run, "tip_over_margin", has_zero=True)
        panels.append(Panel(margin, 26, has_legend=False))
    caption = "Friction that every wheel needs over time, and the margin to tipping over."
    return Plot("utilisation", caption, lambda: stack(run, panels))


def _finite(values: Array) -> Array:
    """Return values limited to a large number, so that lines with infinite values are drawn."""
    return np.minimum(values, 1e3 * CEILING)


def _quantity(run: Trajectory) -> str:
    return "utilisation" if has_friction(run) else "friction needed $|f_t|/N$"


def _worst(run: Trajectory) -> tuple[int, int]:
    values = run["utilisation"]
    k, wheel = np.unravel_index(np.argmax(values), values.shape)
    return int(k), int(wheel)


def _worst_words(run: Trajectory) -> str:
    k, wheel = _worst(run)
    value = run["utilisation"][k, wheel]
    number = f"{value:.3g}" if np.isfinite(value) else "infinite"
    words = f"largest {_quantity(run).partition(' $')[0]}: {number}"
    return f"{words}, {style.words(run.wheels[wheel])} at {run.t[k]:.4g} s"


def ground(grid: Grid, ax: Axes) -> Axes:
    """Draw the heights of a ground as a shaded map with contour lines and a colour bar."""
    x, y, z = ground_drawing.patch(grid, grid.domain, HEATMAP)
    heights = ground_drawing.relief(x, y, z, ax)
    if np.nanmax(z) > np.nanmin(z):
        ax.contour(x, y, z.T, levels=12, colors="0.5", linewidths=0.4)
    ground_drawing.hatch(grid, grid.filled, grid.domain, "filled holes", FILLED, ax)
    ground_drawing.hatch(grid, grid.holes, grid.domain, "no heights", "0.4", ax)
    bar = style.side_bar(heights, ax, "height $z$ [m], relief shaded")
    bar.locator, bar.formatter = style.ticks(6), ScalarFormatter(useOffset=False)
    return ax


def ground_plot(grid: Grid, place: tuple[float, float] | None = None) -> Plot:
    """Return the figure of a ground: heights and slopes, with a place where a vehicle stands."""

    def make() -> Figure:
        """Draw heights and slope of a ground on two maps."""
        x, y, z = ground_drawing.patch(grid, grid.domain, HEATMAP)
        slope = np.degrees(np.arctan(np.hypot(*np.gradient(z, x[1] - x[0], y[1] - y[0]))))
        figure = style.figure(PAGE, PAGE)  # cropped below
        left, right = figure.subplots(1, 2, sharex=True, sharey=True)
        ground(grid, left)
        how = {"cmap": style.RISK, "vmin": 0.0, "vmax": STEEP, **ground_drawing.extent(x, y)}
        drawn = right.imshow(slope.T, **how)  # without relief: its shadows look like steep ground
        ground_drawing.map_axes(x, y, right).set_ylabel("")
        ground_drawing.hatch(grid, grid.holes, grid.domain, "", "0.4", right)
        style.side_bar(drawn, right, "slope [deg]", "max")
        if place is not None:
            for ax in (left, right):
                ax.plot(*place, "o", mfc="white", mec="black", ms=5, label="start")
        return style.cropped(style.finished(figure, None, [left]), left)

    return Plot("ground", "Heights and slopes of the ground.", make)


def path(run: Trajectory, ax: Axes) -> Axes:
    """Draw the path of the platform's centre in plan view, with start, end and stop.

    The place where a body came closest to the ground is marked if the facts contain it.
    """
    x, y = run["x"], run["y"]
    ax.plot(x, y, color=PLATFORM, label="platform", path_effects=style.halo(2.4), zorder=3)
    marks: dict[str, Any] = {"ls": "none", "mec": "black", "ms": 5, "zorder": 5}
    above = marks | {"ms": 4, "zorder": 6}  # visible if the vehicle turns on the spot
    ax.plot(x[:1], y[:1], "o", mfc="white", label=f"start, {run.t[0]:.4g} s", **above)
    if run.stop is None:
        ax.plot(
            x[-1:], y[-1:], "s", mfc="black", label=f"end, {run.t[-1]:.4g} s", **marks | {"ms": 6}
        )
    else:
        words = f"stopped, {run.stop.t:.4g} s: {run.stop.name}"
        ax.plot(x[-1:], y[-1:], "X", mfc=STOPPED, label=words, **marks | {"ms": 7})
    if CLOSEST in run.facts:
        at = run.facts[CLOSEST].value
        words = f"a body closest to the ground, {at['t']:.4g} s"
        ax.plot(at["x"], at["y"], "v", mfc="white", label=words, **marks)
    return ax


def elevation(run: Trajectory, ground: Terrain, ax: Axes) -> Axes:
    """Draw heights over the distance driven: platform, contacts, ground below the platform."""
    s, z = _distance(run), run["z"]
    are_apart = np.abs(run["contact_z"].T - z).max() > DISTINCT * np.ptp(z)
    for k, wheel in enumerate(run.wheels if are_apart else ()):
        ax.plot(s, run["contact_z", wheel], label=f"contact {style.words(wheel)}", **style.look(k))
    ax.plot(s, run["z"], color=PLATFORM, label="platform")
    below = ground.elevation(run["x"], run["y"])
    ax.plot(s, below, **BELOW, label="ground below the platform")
    ax.set(xlabel="distance driven [m]", ylabel="height $z$ [m]")
    return ax


def slope(run: Trajectory, ground: Terrain, ax: Axes) -> Axes:
    """Draw the slope of the ground below the platform along its heading, and the pitch."""
    heading = run.in_frame("rep103")["heading"]
    dz_dx, dz_dy = ground_drawing.gradient(ground, run["x"], run["y"])
    s, rise = _distance(run), np.arctan(np.cos(heading) * dz_dx + np.sin(heading) * dz_dy)
    ax.plot(s, rise, **BELOW, label="ground along the heading")
    ax.plot(s, run["pitch"], color=PLATFORM, label="pitch of the platform")
    ax.set(xlabel="distance driven [m]", ylabel="slope [rad]")
    ax.legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    return style.degrees(ax)


def motion_plots(
    run: Trajectory,
    grid: Grid,
    surface: Terrain | None = None,
    prisms: tuple[Prism, ...] = (),
    marks: Mapping[str, Any] = {},
) -> tuple[Plot, ...]:
    """Return the figures of `FIGURES` that have content, the most important first.

    ``marks`` are the keyword arguments of `plan_marks` for the regions and places of a plan.
    """
    drive = PlottedDrive(run, grid, surface or Bicubic(grid), prisms, marks)
    return tuple(plot for compose in FIGURES if (plot := compose(drive)) is not None)


@checked
def plot(
    result: Trajectory | Plan | Atlas | Bicubic,
    name: str | None = None,
    *,
    ground: Terrain | Solids | None = None,
) -> Figure:
    """Draw a motion, a plan, a mobility map or a ground.

    Parameters
    ----------
    result : Trajectory, Plan, Atlas or Bicubic
        What is drawn; of a plan, the simulated motion.
    name : str, optional
        Name of the figure, as of the files of ``slipfree run --figures-all`` and ``slipfree
        atlas``: ``"map"`` and ``"slip"`` of motions, ``"headings"`` and ``"friction"`` of mobility
        maps, and others. By default the first one.
    ground : Terrain or Solids, optional
        The ground of a result from a file; other results contain theirs.

    Returns
    -------
    Figure
        A figure of Matplotlib, which notebooks show.

    Raises
    ------
    ModelError
        If the result has no figure of this name, or if not exactly one ground is known.
    """
    if (result.ground is None) == (ground is None):
        found = "two" if ground is not None else "none"
        remedy = "remove 'ground'" if ground is not None else "give 'ground'"
        raise ModelError(f"ground: expected that of the result, found {found}; {remedy}")
    terrain: Any = result.ground if ground is None else ground
    if isinstance(result, Bicubic):
        plots: tuple[Plot, ...] = (ground_plot(result.grid),)
    elif isinstance(result, Atlas):
        plots = atlas_plots(view_of(result, terrain))
    else:
        run = result.replay if isinstance(result, Plan) else result
        solids = isinstance(terrain, Solids)
        base, prisms = (terrain.base, terrain.prisms) if solids else (terrain, ())
        grid = getattr(base, "grid", None)
        if not isinstance(grid, Grid):  # heights of a formula around the motion
            margin = 1.0 + AROUND * float(max(np.ptp(run["x"]), np.ptp(run["y"])))
            x, y = (
                np.linspace(
                    max(run[n].min() - margin, low), min(run[n].max() + margin, high), NODES
                )
                for n, low, high in zip("xy", base.domain[::2], base.domain[1::2], strict=True)
            )
            grid = Grid(x, y, base.elevation(x[:, None], y))
        plots = motion_plots(run, grid, base, prisms)
    known = {plot.name: plot for plot in plots}
    name = plots[0].name if name is None else name
    check_known("name", [name], known, "one of the figures")
    return draw([known[name]])[name]


def map_plot(drive: PlottedDrive) -> Plot:
    """Return the figure of ground, path and tracks in plan view."""

    def make() -> Figure:
        """Draw the paths of platform and wheels on a map."""
        run, grid = drive.run, drive.grid
        x, y = (np.append(run[name], run[f"contact_{name}"]) for name in "xy")
        figure, ax, window = ground_drawing.map_figure(x, y, grid, 0.15)
        ground_drawing.solids(drive.prisms, ground_drawing.muted(grid, ax, window))
        ground_drawing.hatch(grid, grid.filled, window, "filled holes", FILLED, ax)
        ground_drawing.hatch(grid, grid.holes, window, "no heights", "0.4", ax)
        places = [place for place in drive.marks.get("places", ()) if place[0] != "start"]
        path(run, ground_drawing.plan_marks(ax, **{**drive.marks, "places": places}))
        if "slip_along" in run:
            tracks(run, ax)
        return style.cropped(style.finished(figure, run, [ax]), ax)

    words = "Ground and path in plan view, with tracks in the colours of utilisation or slip."
    return Plot("map", words, make)


def elevation_plot(drive: PlottedDrive) -> Plot:
    """Return the figure of heights and slopes along the path."""
    top, bottom = (partial(draw, drive.run, drive.surface) for draw in (elevation, slope))
    panels = [Panel(top, 45.0), Panel(bottom, 30.0, has_legend=False)]
    return Plot("elevation", "Heights and slopes along the path.", lambda: stack(drive.run, panels))


def over_time(name: str, caption: str) -> Compose:
    """Return a function for a figure over time of the quantities whose rows name it.

    The function returns None for motions without these quantities. Names in the table of quantities
    are ``*`` for moving joints, ``*_rate`` for their rates, and others for all that end so.
    """

    def compose(drive: PlottedDrive) -> Plot | None:
        """Return the plot of a group of quantities over time; None if the motion has none."""
        run = drive.run
        names = [each.name for each in QUANTITIES.values() if each.figure == name]
        groups = panels(run, names)
        drawn = [Panel(partial(style.history, run, each, has_zero=True)) for each in groups]
        if len({run.wheels if run[first].ndim == 2 else first for first, *_ in groups}) > 1:
            drawn = [Panel(beside(panel.draw), has_legend=False) for panel in drawn]
        note = NOTES.get(str(run.attributes.get("model")), NOTES["kinematics"])
        note = note if name == "slip" else ""
        return Plot(name, caption, lambda: stack(run, drawn, note)) if drawn else None

    return compose


def panels(run: Trajectory, patterns: Sequence[str]) -> list[list[str]]:
    """Return the quantities in each panel: one of wheels, or others with the same unit."""
    names = list[str]()
    moving = [n for n in joint_angles(run) if n.startswith("tilt_") or np.ptp(run[n]) > STILL]
    for pattern in patterns:
        end = pattern.removeprefix("*")
        of_moving = [f"{name}{end}" for name in moving] if end in ("", "_rate") else run
        names += [name for name in of_moving if name.endswith(end)] if "*" in pattern else [pattern]
    found, last = list[list[str]](), ""
    for name in (each for each in dict.fromkeys(names) if each in run):
        values, unit = run[name], run.columns[name].label.unit
        largest = np.abs(np.nan_to_num(values, posinf=0.0)).max()
        if largest < ROUNDING and name not in moving and not style.row(name).is_residual:
            continue
        if values.ndim == 1 and unit == last:
            found[-1].append(name)
        else:
            found.append([name])
        last = unit if values.ndim == 1 and not style.row(name).is_residual else ""
    return found


FIGURES: tuple[Compose, ...] = (
    side_plot,
    map_plot,
    elevation_plot,
    over_time("slip", "Slip of every wheel over time."),
    utilisation_plot,
    over_time("contact", "Depth and slip ratio of every wheel over time."),
    over_time("clearance", "Least distance of the vehicle's bodies from the ground over time."),
    over_time("tilts", "Angles of the joints over time."),
    over_time("checks", "Accuracy and validity: residuals and margins over time."),
    over_time("rates", "Rates of wheels and joints over time."),
    over_time("forces", "Forces between wheels and ground, and torques of the drives."),
    over_time("energy", "Work of the drives, energy of the vehicle, and losses."),
)  # of a motion over terrain, the most important first


def _distance(run: Trajectory) -> Array:
    """Return the length of the platform's path up to each sample, shape (n,) [m]."""
    return np.append(0.0, np.cumsum(np.sqrt(sum(np.diff(run[name]) ** 2 for name in "xyz"))))
