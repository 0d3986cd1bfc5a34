"""Engines: error against CPU time of MuJoCo, Drake, PyBullet and slipfree on nine tasks.

``python benchmarks compared [TASK ...] [--engines MODULE ...] [--write FOLDER]`` (packages mujoco,
drake, pybullet; an engine that is not installed has no rows)
"""

from __future__ import annotations

import argparse
import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import distributions
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import engines
import matplotlib as mpl
import numpy as np
from engines.on_slipfree import poses, start_of, vehicle_of
from scenes import (
    CELL,
    HALF_BASE,
    HALF_TRACK,
    RADIUS,
    Motion,
    Pose,
    Scene,
    Size,
    cart,
    rocker_bogie,
    share,
)
from scipy.integrate import cumulative_trapezoid
from scipy.spatial.transform import Rotation

from slipfree import Analytic, SolverOptions, direct_kinematics, simulate
from slipfree.vehicle.formula import evaluate

FIGURE = Path(__file__).parent.parent / "docs" / "figures" / "compared.png"
REPEATS, LONG = 3, 1.0  # runs, of which the median counts; one if it is longer [s]
SLOPE = 0.3  # along y
FRICTION = 0.8
RATE = 2.0  # of wheels that drive [rad/s]
LOG = Path(__file__).parent.parent / "problems" / "skid_steer_log.csv"
HELP = (
    "file with the columns t [s], left, right [rad/s], x, y [m], heading from the y axis [rad]; "
    "then radius, half track, half wheelbase, place of the centre of mass ahead [m], square of the "
    "radius of gyration [m^2], friction, slip stiffness [s/m]"
)
KNOWN = (0.155, 0.31, 0.25, 0.03, 0.0975, 0.6, 12.0)
WARM_UP, PREDICTED, WINDOW = 2.0, 20.0, 2.0  # of a log: start, duration and windows [s]
EXACT = SolverOptions(tolerance=1e-11)
STAIRS = ((-2.0, 0.0), (0.6, 0.02), (1.0, 0.04), (1.4, 0.06))
PLACES = ((0.4, 0.3, 0.2), (-0.9, 0.8, 1.4), (1.1, -0.7, -2.0), (0.2, -1.2, 2.9))
ENGINES = ("mujoco", "drake", "pybullet")  # packages
COLOURS = {"MuJoCo": "C1", "Drake": "C2", "PyBullet": "C3", "slipfree": "C0"}
MARKERS = "os^Dv"


class Task(NamedTuple):
    """A task: scenes, and the errors of a motion of a scene [m]."""

    title: str
    scenes: tuple[Scene, ...]
    # [m]; of a log also the error of the turn [rad]
    error: Callable[[Scene, Motion], float | tuple[float, float]]


def relief(x: Any, y: Any, of: Any) -> Any:
    """Return hills [m], whose curvature is far below that of the balls."""
    return 0.06 * of.sin(2.3 * x + 0.4) * of.cos(1.9 * y) + 0.03 * of.sin(1.1 * y - 0.7 * x)


def waves(x: Any, y: Any, of: Any) -> Any:
    """Return waves along x [m]."""
    return 0.04 * (1 - of.cos(2 * np.pi * x / 1.2)) + 0 * y


def inclined(slope: float) -> Callable[[Any, Any, Any], Any]:
    """Return a plane that rises along y."""
    return lambda x, y, _: slope * y + 0 * x


def nodes(x: float, y: float) -> dict[str, np.ndarray]:
    """Return axes of a map from -2 m to x and from -y to y [m]."""
    return {"x": np.arange(-2.0, x + CELL, CELL), "y": np.arange(-y, y + CELL, CELL)}


def of(
    urdf: str, height: Any, start: Any, rates: Mapping[str, float], end: float, **more: Any
) -> Scene:
    """Return a scene with samples every 0.1 s."""
    given = {"couplings": {}, "raised": 0.0, "friction": FRICTION, **nodes(4.5, 2.0), **more}
    return Scene(
        urdf=urdf,
        height=height,
        start=start,
        rates=rates,
        t=np.linspace(0, end, round(10 * end) + 1),
        **given,
    )


def wheels(urdf: str, left: float, right: float) -> dict[str, float]:
    """Return rates of the driven wheels of both sides [rad/s]."""
    names = [wheel.name for wheel in vehicle_of(urdf).wheels if wheel.driven]
    return {name: left if name.endswith("left") else right for name in names}


def ground_of(scene: Scene) -> Analytic:
    """Return the true ground."""
    return Analytic(lambda x, y: scene.height(x, y, ca), mu=scene.friction)


def exact_pose(scene: Scene) -> Pose:
    """Return the pose at rest on the true ground, raised."""
    vehicle = vehicle_of(scene.urdf)
    run = start_of(direct_kinematics(vehicle, ground_of(scene)), scene)
    position, rotation = poses(run)
    joints = {joint.name: _angle(joint, run) for joint in vehicle.joints}
    return Pose(position[0] + [0, 0, scene.raised], rotation[0], joints)


def _angle(joint: Any, run: Any) -> float:
    """Return the angle of a passive joint [rad]."""
    (name,) = joint.coordinates
    return float(evaluate(joint.value, {name: ca.SX(run[name][0])}))


def missed_rest(scene: Scene, motion: Motion) -> float:
    """Return the error of height, and of angles times half the wheelbase, at the final place."""
    at, turned = motion.position[-1], motion.rotation[-1]
    heading = yaw = _yaw(turned)
    for _ in range(3):  # headings of `settle` are those before pitch and roll
        start = (at[0], at[1], heading)
        pose = exact_pose(scene._replace(start=start, raised=0.0))
        heading += yaw - _yaw(pose.rotation)
    angle = Rotation.from_matrix(pose.rotation.T @ turned).magnitude()
    return max(abs(at[2] - pose.position[2]), HALF_BASE * angle)


def _yaw(rotation: np.ndarray) -> float:
    """Return the direction of the axis ahead on the map [rad]."""
    return float(np.arctan2(rotation[1, 0], rotation[0, 0]))


def missed_way(scene: Scene, motion: Motion) -> float:
    """Return the largest error of position and, times half the wheelbase, of rotation."""
    position, rotation = reference(scene)
    angle = Rotation.from_matrix(np.swapaxes(rotation, 1, 2) @ motion.rotation).magnitude()
    return float(
        max(np.linalg.norm(motion.position - position, axis=1).max(), HALF_BASE * angle.max())
    )


REFERENCES: dict[int, Any] = {}


def reference(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and rotations by the kinematics on the true ground."""
    if len(scene.slabs) > 1:
        return climb(scene)
    if id(scene) not in REFERENCES:
        model = direct_kinematics(vehicle_of(scene.urdf), ground_of(scene))
        rates = {f"{k}_rate": v * share(model.t, ca) for k, v in scene.rates.items()}
        run = simulate(model, start_of(model, scene), model.inputs(**rates), scene.t, options=EXACT)
        REFERENCES[id(scene)] = poses(run)
    return REFERENCES[id(scene)]


def even_time(t: np.ndarray) -> np.ndarray:
    """Return the integrals of `share` up to samples [s]."""
    fine = np.linspace(0, t[-1], 100001)
    return np.interp(t, fine, cumulative_trapezoid(share(fine), fine, initial=0))


def missed_turn(scene: Scene, motion: Motion) -> float:
    """Return displacement, or the error of the angle times half the wheelbase.

    Four equal loads slide at the same speed; the sum of the moments of friction vanishes if the
    vehicle turns at v b / (b^2 + l^2), with the speed v of the treads, half track b and half
    wheelbase l, for every coefficient of friction.
    """
    speed = RADIUS * max(scene.rates.values())
    angle = speed * HALF_TRACK / (HALF_TRACK**2 + HALF_BASE**2) * even_time(scene.t)[-1]
    heading = np.unwrap(np.arctan2(motion.rotation[:, 1, 0], motion.rotation[:, 0, 0]))
    moved = np.linalg.norm((motion.position - motion.position[0])[-1, :2])
    return max(moved, HALF_BASE * abs(heading[-1] - heading[0] - angle))


def missed_line(scene: Scene, motion: Motion) -> float:
    """Return the distance of the end from the way r phi along x."""
    way = RADIUS * max(scene.rates.values()) * even_time(scene.t)[-1]
    return float(np.linalg.norm(motion.position[-1] - motion.position[0] - [way, 0, 0]))


def tasks(log: Task) -> dict[str, Task]:
    """Return the tasks by name."""
    four, rear, rover = cart(), cart("rear"), rocker_bogie()
    still, around = wheels(four, 0, 0), wheels(four, -RATE, RATE)
    linked = {"rock_left_rocker": "rock_right_rocker"}
    fallen = {"raised": 0.03}
    return {
        "rest": Task(
            "Rest of a four-wheeler",
            tuple(of(four, relief, place, still, 2.0, **fallen) for place in PLACES),
            missed_rest,
        ),
        "bogie": Task(
            "Rest of a rocker-bogie",
            tuple(
                of(rover, relief, p, wheels(rover, 0, 0), 2.0, couplings=linked, **fallen)
                for p in PLACES
            ),
            missed_rest,
        ),
        "waves": Task(
            "Straight over waves, 3 m",
            (of(rear, waves, (0.0, 0.0, 0.0), wheels(rear, RATE, RATE), 10.0),),
            missed_way,
        ),
        "turn": Task(
            "Turning on the spot",
            (of(four, inclined(0.0), (0.0, 0.0, 0.0), around, 6.0),),
            missed_turn,
        ),
        "box": Task(
            "Turning on the spot, on a box",
            (of(four, inclined(0.0), (0.0, 0.0, 0.0), around, 6.0, slabs=STAIRS[:1]),),
            missed_turn,
        ),
        "creep": Task(
            "Standing across a slope, 10 s",
            (of(four, inclined(SLOPE), (0.0, 0.0, 0.0), still, 10.0),),
            missed_line,
        ),
        "slope": Task(
            "Driving across a slope, 3 m",
            (of(four, inclined(SLOPE), (0.0, 0.0, 0.0), wheels(four, RATE, RATE), 10.0),),
            missed_line,
        ),
        "stairs": Task(
            "Up three stairs of 20 mm",
            (of(rear, inclined(0.0), (0.0, 0.0, 0.0), wheels(rear, 1, 1), 13.0, slabs=STAIRS),),
            missed_way,
        ),
        "log": log,
    }


def stairs(scene: Scene) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return rotation of the driven rear wheels [rad], and place and pitch of a slow climb.

    Axles follow circles around the edges, and the rear wheels roll along the path of their axle.
    The place is x, z of the middle between the axles, shape (2, n) [m]; the pitch is positive with
    the nose up [rad].
    """

    def path(x: np.ndarray) -> np.ndarray:
        """Return the height of an axle."""
        ahead = ((np.clip(edge - x, 0, RADIUS), top) for edge, top in scene.slabs)
        return np.max([top + np.sqrt(RADIUS**2 - gap**2) for gap, top in ahead], axis=0)

    x = np.linspace(scene.start[0] - HALF_BASE, scene.x[-1] - 3 * HALF_BASE, 200001)
    pitch = 0 * x
    for _ in range(20):
        pitch = np.arcsin((path(x + 2 * HALF_BASE * np.cos(pitch)) - path(x)) / (2 * HALF_BASE))
    rolled = np.append(0, np.cumsum(np.hypot(np.diff(x), np.diff(path(x)))))
    middle = [x + HALF_BASE * np.cos(pitch), path(x) + HALF_BASE * np.sin(pitch)]
    return rolled / RADIUS + pitch, np.array(middle), pitch  # the pitch turns the wheels backward


def climb(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and rotations of a slow climb without slip."""
    rolled, (x, z), pitch = stairs(scene)
    turned = max(scene.rates.values()) * even_time(scene.t)
    x, z, pitch = (np.interp(turned, rolled, each) for each in (x, z, pitch))
    return np.column_stack([x, 0 * x, z]), Rotation.from_euler("y", -pitch[:, None]).as_matrix()


def prediction(name: Path, numbers: Sequence[float]) -> Task:
    """Return the prediction of the windows of a log from its wheel rates.

    Columns and numbers are those of `HELP`.
    """
    *sizes, friction, stiffness = numbers
    log = np.genfromtxt(name, delimiter=",", names=True)
    log = log[log["t"] <= log["t"][0] + WARM_UP + PREDICTED]
    urdf, t = cart(size=Size(*sizes)), log["t"] - log["t"][0]
    rates = {
        wheel.name: share(t) * log["left" if wheel.name.endswith("left") else "right"]
        for wheel in vehicle_of(urdf).wheels
    }
    wide = {"x": np.array([-99.0, 99.0]), "y": np.array([-99.0, 99.0])}
    level = {"slabs": ((-99.0, 0.0),), "slip_stiffness": stiffness, "friction": friction, **wide}
    scene = of(urdf, inclined(0.0), (0.0, 0.0, log["heading"][0] + np.pi / 2), rates, 0.0, **level)
    begin = np.searchsorted(t, np.arange(WARM_UP, t[-1] - WINDOW + 1e-9, WINDOW))
    end = np.searchsorted(t, t[begin] + WINDOW - 1e-9)

    def change(place: np.ndarray, heading: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return displacements relative to the vehicle, and turns, in windows."""
        ahead = np.exp(-1j * heading[begin])
        return ahead * (place[end] - place[begin]), heading[end] - heading[begin]

    measured = change(log["x"] + 1j * log["y"], np.unwrap(log["heading"]) + np.pi / 2)

    def missed(_: Scene, motion: Motion) -> tuple[float, float]:
        """Return the root mean squares of the errors of position [m] and heading [rad]."""
        heading = np.unwrap(np.arctan2(motion.rotation[:, 1, 0], motion.rotation[:, 0, 0]))
        found = change(motion.position[:, 0] + 1j * motion.position[:, 1], heading)
        place, turn = (
            float(np.sqrt(np.mean(np.abs(a - b) ** 2)))
            for a, b in zip(found, measured, strict=True)
        )
        return place, turn

    return Task("Prediction of a log, 2 s", (scene._replace(t=t),), missed)


class Row(NamedTuple):
    """A setting of an engine in a task."""

    task: str
    series: str
    setting: str
    milliseconds: float
    error: float


def measured(name: str, task: Task, modules: Sequence[str]) -> list[Row]:
    """Run and print all settings of engines."""
    rows, starts = [], [exact_pose(scene) for scene in task.scenes]
    for module in modules:
        try:
            engine = importlib.import_module(f"engines.{module}")
        except ImportError as error:
            print(f"  {module}: {error}")
            continue
        for series, settings in engine.SERIES.items():
            for setting in settings:
                words = ", ".join(
                    f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}"
                    for k, v in setting.items()
                )
                try:
                    seconds, errors = [], []
                    for scene, pose in zip(task.scenes, starts, strict=True):
                        runs = [engine.motion(scene, pose, **setting)]
                        while len(runs) < REPEATS and runs[0].seconds < LONG:
                            runs.append(engine.motion(scene, pose, **setting))
                        seconds.append(np.median([run.seconds for run in runs]))
                        errors.append(np.atleast_1d(task.error(scene, runs[0])))
                except Exception as error:
                    print(f"  {series:20} {words:42} {str(error).strip().splitlines()[-1][:90]}")
                    continue
                error, *turn = np.max(errors, axis=0)
                row = Row(name, series, words, 1e3 * float(np.mean(seconds)), float(error))
                print(
                    f"  {series:20} {words:42} {row.milliseconds:10.3f} ms {error:10.2e} m",
                    *(f"{1e3 * each:5.1f} mrad" for each in turn),
                    flush=True,
                )
                rows.append(row)
    return rows


def ratios(rows: list[Row]) -> None:
    """Print our time over that of each other engine, at the error of its most accurate setting."""
    for name in [each for each in COLOURS if each != "slipfree"]:
        theirs = [row for row in rows if row.series.startswith(name) and np.isfinite(row.error)]
        if not theirs:
            continue
        best = min(theirs, key=lambda row: row.error)
        ours = [
            r.milliseconds
            for r in rows
            if r.series.startswith("slipfree") and r.error <= best.error
        ]
        ratio = f"{min(ours) / best.milliseconds:.2g} times its time" if ours else "none of ours"
        print(f"  {name}, least error {best.error:.1e} m ({best.milliseconds:.3g} ms): {ratio}")


def _program(series: str) -> str:
    return series.partition(",")[0]


def draw(rows: list[Row], shown: dict[str, Task]) -> None:
    """Draw error against CPU time."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    marks = dict[str, str]()
    for series in dict.fromkeys(row.series for row in rows):
        marks[series] = MARKERS[sum(_program(each) == _program(series) for each in marks)]
    figure, axes = plt.subplots(3, 3, figsize=(11, 9.5), layout="constrained")
    for axis, (name, task) in zip(axes.flat, shown.items(), strict=False):
        for series, mark in marks.items():
            line = [
                (r.milliseconds, max(r.error, 1e-13))
                for r in rows
                if (r.task, r.series) == (name, series)
            ]
            if line:
                style = {"color": COLOURS.get(_program(series), "0.4"), "marker": mark}
                axis.loglog(*np.transpose(line), lw=1, ms=4, label=series, **style)
        axis.set_title(task.title, fontsize=10)
        axis.grid(alpha=0.3)
    for axis in axes[-1]:
        axis.set_xlabel("CPU time [ms]")
    for axis in axes[:, 0]:
        axis.set_ylabel("error [m]")
    lines = {line.get_label(): line for axis in axes.flat for line in axis.lines}
    figure.legend(lines.values(), lines, loc="outside lower center", ncols=5, fontsize=8)
    figure.savefig(FIGURE, dpi=110)


LICENCE = """Reference data of `python benchmarks compared` (slipfree), licence CC BY 4.0.

TASK_N.urdf: vehicle, x ahead; wheels are balls. TASK_N_map.csv: nodes x, y, z [m].
TASK_N_slabs.csv: beginnings x and heights [m] of steps, in place of a map.
TASK_N_drive.csv: time [s] and rates of the driven wheels [rad/s], which rise as
tanh((t / 0.5)^2); those of the log are linear between samples.
TASK_N_reference.csv: time, position of the root link [m] and its quaternion (x, y, z, w): the
pose at rest, or the motion that rolls without slip, on the true ground, at a tolerance of 1e-11
(stairs: axles on circles around the edges).
Turning on the spot: no displacement, angle v b / (b^2 + l^2) t for the speed v of the treads.
Standing and driving across a slope: no drift; the way is the radius times the wheels' angle.
The log is `problems/skid_steer_log.csv`.
"""


def write(folder: Path, known: Mapping[str, Task]) -> None:
    """Write vehicles, maps, rates and references, for use without slipfree."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "README.md").write_text(LICENCE, encoding="utf-8")
    for name, task in known.items():
        for k, scene in enumerate(task.scenes):
            stem = folder / f"{name}_{k}"
            stem.with_suffix(".urdf").write_text(scene.urdf, encoding="utf-8")
            drive = np.column_stack([scene.t, scene.rates_at(scene.t)])
            tables = {"drive": (",".join(["t", *scene.rates]), drive)}
            if scene.slabs:
                tables["slabs"] = ("x,height", np.array(scene.slabs))
            else:
                tables["map"] = ("x,y,z", scene.triangles()[0])
            if task.error in (missed_way, missed_rest):
                pose = exact_pose(scene._replace(raised=0.0))
                way = (
                    reference(scene)
                    if task.error is missed_way
                    else (pose.position[None], pose.rotation[None])
                )
                turned = Rotation.from_matrix(way[1]).as_quat()
                rows = np.column_stack([scene.t[: len(turned)], way[0], turned])
                tables["reference"] = ("t,x,y,z,qx,qy,qz,qw", rows)
            for kind, (header, rows) in tables.items():
                file = folder / f"{name}_{k}_{kind}.csv"
                np.savetxt(file, rows, fmt="%.10g", delimiter=",", header=header, comments="")


def main() -> None:
    """Run the tasks that are named, or all."""
    parser = argparse.ArgumentParser()
    parser.add_argument("tasks", nargs="*", default=[])
    every = [module.name for module in pkgutil.iter_modules(engines.__path__)]
    parser.add_argument("--engines", nargs="+", default=every, help="modules of benchmarks/engines")
    parser.add_argument("--write", type=Path)
    parser.add_argument("--log", nargs=len(KNOWN) + 1, default=(LOG, *KNOWN), help=HELP)
    given = parser.parse_args()
    name, *numbers = given.log
    known = tasks(prediction(Path(name), [float(each) for each in numbers]))
    if unknown := [name for name in given.tasks if name not in known]:
        parser.error(f"expected tasks among {', '.join(known)}, found {', '.join(unknown)}")
    print(", ".join(f"{d.name} {d.version}" for d in distributions() if d.name in ENGINES))
    rows = []
    shown = {name: known[name] for name in given.tasks or known}
    for name, task in shown.items():
        print(f"\n{task.title}", flush=True)
        rows += (new := measured(name, task, given.engines))
        ratios(new)
    if not given.tasks and given.engines == every:
        draw(rows, shown)
    if given.write:
        write(given.write, shown)
        print(f"wrote the data of {len(shown)} tasks to {given.write}")
