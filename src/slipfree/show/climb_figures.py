"""Figures of a climb: positions, references, slip and disturbance, forces.

Each drawing function draws on the given axes, labels the artists for a legend, and returns the
axes; the caller adds the legend. ``climb_plots`` composes the figures.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon

from slipfree.climb.metrics import MIN_LOAD, disturbance_ratio, most_loaded, slip_ratio
from slipfree.records import Array
from slipfree.show import style
from slipfree.show.force_figures import normal_forces
from slipfree.show.plots import Panel, Plot, stack
from slipfree.show.style import MM, PAGE
from slipfree.terrain.solids import Profile, Solid
from slipfree.trajectory import Trajectory
from slipfree.vehicle.climber import AXLES, Climber

EVERY, POSES = 0.3, 2  # time between dots [s], number of dots per drawn vehicle
TIMES = colormaps["viridis"]
LATEST = 0.85  # used part of the colour scale: its yellow end is too light for lines
GROUND = "0.85"
ROOM, BELOW = 0.04, 0.03  # margins around and below the motions [m]
HIGHEST = 100.0  # larger ratios are cut off [%]


def ground(solids: Iterable[Solid], ax: Axes) -> Axes:
    """Draw the solids of a ground, filled.

    Parameters
    ----------
    solids : iterable of Solid
        The ground.
    ax : Axes
        The axes; their aspect becomes equal.
    """
    for solid in solids:
        ax.add_patch(Polygon(solid.points, fc=GROUND, ec=GROUND, lw=0.3, zorder=0))
    ax.set_aspect("equal")
    ax.set(xlabel="forward $x$ [m]", ylabel="height $z$ [m]")
    return ax


def strobe(
    run: Trajectory, climber: Climber, profile: Profile, ax: Axes, every: float = EVERY
) -> Axes:
    """Draw the ground, the paths of the axles, and the vehicle at regular intervals.

    Dots mark the positions of the axles at equal time intervals; the vehicle is drawn at every
    second dot.

    Parameters
    ----------
    run : Trajectory
        The motion.
    climber, profile : Climber, Profile
        Vehicle and ground.
    ax : Axes
        The axes.
    every : float
        Time between two dots. [s]
    """
    ground(profile.solids, ax)
    for axle in AXLES:
        ax.plot(run["center_y", axle], run["center_z", axle], color="0.5", lw=0.6, zorder=2)
    duration = float(run.t[-1] - run.t[0])
    times = run.t[0] + every * np.arange(int(duration / every) + 1)
    for number, k in enumerate(np.searchsorted(run.t, times - 1e-9)):
        color = TIMES(LATEST * (run.t[k] - run.t[0]) / duration)
        if number % POSES == 0:
            _pose(run, climber, int(k), ax, color)
        dots = {"mfc": "white", "mec": color, "mew": 0.8, "ms": 2.6, "ls": "none", "zorder": 4}
        ax.plot(run["center_y"][k], run["center_z"][k], "o", **dots)
    above = max(climber.rear_body.above, climber.front_body.above)
    return frame_motions([run], climber.radius, ax, above)


def _pose(run: Trajectory, climber: Climber, k: int, ax: Axes, color: Any) -> None:
    """Draw wheels, links and centres of mass at a sample."""
    links, centers = _skeleton(run, climber, k)
    ax.plot(*links, color=color, lw=1.3, zorder=3, solid_joinstyle="round")
    ax.plot(*centers, "+", color=color, ms=4, mew=0.8, zorder=3)
    for x, z in zip(run["center_y"][k], run["center_z"][k], strict=True):
        ax.add_patch(Circle((x, z), climber.radius, fc="none", ec=color, lw=0.9, zorder=3))


def _skeleton(run: Trajectory, climber: Climber, k: int) -> tuple[Array, Array]:
    """Return rear axle, joint and front axle, and the centres of mass, both of shape (2, n)."""
    joint = np.array([run["y"][k], run["z"][k]])
    ends = [
        np.array([run[name, axle][k] for name in ("center_y", "center_z")])
        for axle in ("rear", "front")
    ]
    centers = []
    for body, name in ((climber.rear_body, "rear"), (climber.front_body, "front")):
        cosine, sine = np.cos(run[f"tilt_{name}"][k]), np.sin(run[f"tilt_{name}"][k])
        turn = np.array([[cosine, -sine], [sine, cosine]])
        centers.append(joint + turn @ (body.ahead, body.above))
    return np.stack([ends[0], joint, ends[1]], axis=1), np.stack(centers, axis=1)


def frame_motions(runs: Sequence[Trajectory], radius: float, ax: Axes, above: float = 0.0) -> Axes:
    """Set the limits of axes to contain wheels of all motions, with a margin of ground below them.

    The height of the margin above them includes ``above`` [m].
    """
    reach = radius + ROOM
    x, z = (
        np.concatenate([run[name].ravel() for run in runs]) for name in ("center_y", "center_z")
    )
    top = z.max() + reach + above
    ax.set(xlim=(x.min() - reach, x.max() + reach), ylim=(z.min() - radius - BELOW, top))
    return ax


def references(run: Trajectory, climber: Climber, ax: Axes) -> Axes:
    """Draw the reference and the actual rim speeds of the wheels over time."""
    style.by_wheel(run, climber.radius * run["spin"], ax, lw=0.6, alpha=0.5)
    style.by_wheel(run, climber.radius * run["reference"], ax)
    ax.set_ylabel("rim speed [m/s]")
    return _over_time(run, ax)


def slip(run: Trajectory, climber: Climber, ax: Axes) -> Axes:
    """Draw the slip ratio of every axle over time, equation (20) of Chugo et al. (2009)."""
    return _ratios(run, slip_ratio(run, climber), "slip, eq. (20) [%]", ax)


def true_slip(run: Trajectory, climber: Climber, profile: Profile, ax: Axes) -> Axes:
    """Draw the slip ratio of every axle over time, from the slip velocity at the contact.

    The ratio is the slip velocity divided by the rim speed, at the contact with the largest load.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = -most_loaded(run, profile, "slip") / (climber.radius * run["spin"])
    return _ratios(run, ratio, "true slip [%]", ax)


def disturbance(run: Trajectory, ax: Axes) -> Axes:
    """Draw the relative rate error of each axle over time, equation (21) of Chugo et al. (2009)."""
    return _ratios(run, disturbance_ratio(run), "disturbance, eq. (21) [%]", ax)


def _ratios(run: Trajectory, ratios: Array, words: str, ax: Axes) -> Axes:
    style.by_wheel(run, np.clip(100 * ratios, -HIGHEST, HIGHEST), style.with_zero(ax), lw=0.9)
    ax.set_ylabel(words)
    return _over_time(run, ax)


def tilts(run: Trajectory, ax: Axes) -> Axes:
    """Draw the tilts of both bodies over time."""
    style.over_time(run, ("tilt_rear", "tilt_front"), ax, first=len(AXLES))
    ax.set_ylabel("tilt, nose up [rad]")
    return _over_time(run, style.degrees(ax))


def loads(run: Trajectory, ax: Axes) -> Axes:
    """Draw the normal force on each axle over time, without the peaks of impacts."""
    normal_forces(run, ax)
    ax.set_ylim(0, 1.1 * float(np.percentile(run["force_normal"], 99.5)))
    return _over_time(run, ax)


def torques(run: Trajectory, climber: Climber, ax: Axes) -> Axes:
    """Draw the torque of one wheel of every axle over time, and the torque limits if near."""
    style.by_wheel(run, run["motor_torque"], style.with_zero(ax))
    if climber.torque < 1.5 * np.abs(run["motor_torque"]).max():
        for limit in (-climber.torque, climber.torque):
            ax.axhline(limit, color="0.4", lw=0.8, ls="--")
    ax.set_ylabel("torque of a wheel [N m]")
    return _over_time(run, ax)


def planned_speeds(run: Trajectory, plan: Trajectory, climber: Climber, ax: Axes) -> Axes:
    """Draw the planned rim speeds over the progress, and the actual ones as thin lines.

    Parameters
    ----------
    run : Trajectory
        The motion that tracks a plan.
    plan : Trajectory
        The plan, with its ``progress``.
    climber : Climber
        The vehicle.
    ax : Axes
        The axes.
    """
    plan_speeds, speeds = climber.radius * plan["wheel_rate"], climber.radius * run["spin"]
    ax.set_ylabel("rim speed [m/s]")
    return _over_progress(run, speeds, plan, plan_speeds, ax)


def planned_friction(run: Trajectory, plan: Trajectory, profile: Profile, ax: Axes) -> Axes:
    """Draw the planned friction ratio over the progress, and the actual one as thin lines.

    The ratio is the tangential force divided by the normal force. The actual ratio is that of the
    contact with the largest load.

    Parameters
    ----------
    run : Trajectory
        The motion that tracks a plan.
    plan : Trajectory
        The plan, with its ``progress``.
    profile : Profile
        The ground.
    ax : Axes
        The axes.
    """
    force, load = (most_loaded(run, profile, name) for name in ("friction", "load"))
    wanted = np.abs(plan["friction"]) / np.maximum(plan["load"], MIN_LOAD)
    ax.axhline(plan.statistics["mu"], color="0.4", lw=0.8, ls="--")
    ax.set_ylabel("friction used [1]")
    return _over_progress(run, np.abs(force) / load, plan, wanted, ax)


def _over_progress(
    run: Trajectory, driven: Array, plan: Trajectory, planned: Array, ax: Axes
) -> Axes:
    """Draw planned values over the progress, and actual values as thin lines."""
    progress = (run["center_y"] + run["center_z"]).mean(axis=1)
    style.by_wheel(run, driven, ax, progress, lw=0.6, alpha=0.6)
    style.by_wheel(plan, planned, ax, plan["progress"])
    ax.set_xlabel("progress: mean over the axles of $x + z$ [m]")
    ax.margins(x=0.02)
    return ax


def _over_time(run: Trajectory, ax: Axes) -> Axes:
    """Label the time axis, and shade the times that averages do not include."""
    counts = run.statistics
    if "climb_from" in counts:
        for left, right in ((run.t[0], counts["climb_from"]), (counts["climb_to"], run.t[-1])):
            ax.axvspan(left, right, color="0.94", lw=0, zorder=0)
    return style.time_axis(run, ax)


def climb_plots(
    run: Trajectory, climber: Climber, profile: Profile, plan: Trajectory | None = None
) -> tuple[Plot, ...]:
    """Return the figures of a climb, the most important first.

    Parameters
    ----------
    run : Trajectory
        A motion of `slipfree.climb.dynamics.climbing`.
    climber, profile : Climber, Profile
        Vehicle and ground.
    plan : Trajectory, optional
        The plan that the motion tracks.

    Returns
    -------
    tuple of Plot
        ``strobe, references, slip, forces``, 180 mm wide; ``plan`` after the first one if there is
        a plan.
    """
    left_out = "Shaded: not included in averages."
    strobed = Plot(
        "strobe", "The vehicle at several times.", lambda: _strobe(run, climber, profile)
    )
    stacks = {
        "references": (
            "Rates of the wheels: references and motion.",
            [Panel(partial(references, run, climber)), Panel(partial(tilts, run))],
            f"Thin lines: actual rim speed. {left_out}",
        ),
        "slip": (
            "Slip and disturbance of every axle.",
            [
                Panel(partial(slip, run, climber)),
                Panel(partial(true_slip, run, climber, profile), has_legend=False),
                Panel(partial(disturbance, run), has_legend=False),
            ],
            f"Values are cut off at {HIGHEST:g} %. Equation numbers of Chugo et al. (2009); (20) "
            f"uses the speed of the middle axle for all wheels. {left_out}",
        ),
        "forces": (
            "Normal forces and torques of every axle.",
            [
                Panel(partial(loads, run)),
                Panel(partial(torques, run, climber), has_legend=False),
            ],
            f"Short peaks of impacts are cut off. {left_out}",
        ),
    }
    if plan is not None:
        panels = [
            Panel(partial(planned_speeds, run, plan, climber)),
            Panel(partial(planned_friction, run, plan, profile), has_legend=False),
        ]
        note = "Thin lines: actual motion. Dashed: friction coefficient of the plan."
        stacks = {"plan": ("Planned speeds and friction.", panels, note), **stacks}
    return strobed, *(
        Plot(name, caption, partial(stack, run, panels, note))
        for name, (caption, panels, note) in stacks.items()
    )


def _strobe(run: Trajectory, climber: Climber, profile: Profile) -> Figure:
    figure = style.figure(PAGE, 70 * MM)
    ax = strobe(run, climber, profile, figure.subplots())
    _sized(figure, ax)
    note = (
        f"Dots every {EVERY:g} s, the vehicle every {POSES * EVERY:g} s, from violet to green; + "
    )
    note += "centres of mass."
    return style.finished(figure, run, [], note + _outcome(run))


def _sized(figure: Figure, ax: Axes, room: float = 17 * MM) -> None:
    """Set the height of a figure so that its axes, of equal aspect, fill the width."""
    width, height = np.ptp(ax.get_xlim()), np.ptp(ax.get_ylim())
    figure.set_figheight((PAGE - 14 * MM) * float(height / width) + room)


def _outcome(run: Trajectory) -> str:
    """Return a sentence on the end of a climb; empty if the result has no description."""
    words = run.attributes.get("climb", "")
    return "" if words.startswith("unfinished") or not words else f" The vehicle {words}."
