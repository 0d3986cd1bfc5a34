"""From a problem of inverse kinematics to a model, a start and inputs, and along a path."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from slipfree.dae import Dae
from slipfree.errors import ModelError, SlipfreeError
from slipfree.files.toml.errors import Fault, names, problem_error
from slipfree.laws.rolling import Rolling
from slipfree.models.given_rates import EULER, OMEGA, VELOCITY
from slipfree.models.inverse import (
    LEAST_MARGIN,
    PLANAR,
    along,
    inverse_kinematics,
    steering_note,
    steering_slip,
)
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.platform_rates import Wanted
from slipfree.models.reach import SUBSET
from slipfree.problem import schema
from slipfree.problem.build_common import (
    Setup,
    build_start,
    build_terrain,
    build_vehicle,
    check_names,
    read_columns,
    samples,
    turned,
)
from slipfree.problem.build_ground import at, build_ground
from slipfree.problem.commands import ROBOT
from slipfree.problem.load import Problem, S
from slipfree.problem.subset import build_subset, drive_subset, is_subset
from slipfree.records import Array
from slipfree.solve.collocation import drive
from slipfree.solve.options import SolverOptions
from slipfree.solve.replay import replay, spline_inputs
from slipfree.solve.trim import apply_inputs
from slipfree.trajectory import Trajectory
from slipfree.vehicle.tree import Vehicle

KNOWN = (*VELOCITY, *OMEGA, *EULER)
COLUMNS = ("t", "x", "y", "heading")
LEAST_POINTS = 6  # way-points of a spline of degree five
SLOW = 0.1  # speed from which a motion is sought whose velocity is not given [m/s]


def is_sought(spec: schema.Motion) -> bool:
    """Return whether `drive_along` solves the problem, so that more is done than to integrate."""
    return isinstance(spec, schema.Inverse) and (_is_path(spec) or is_subset(spec))


def _is_path(spec: schema.Inverse) -> bool:
    """Return whether the steering is sought along a path, so that nothing is integrated."""
    return spec.path is not None and spec.steering == "angle"


def build_inverse(problem: Problem[S], spec: schema.Inverse) -> Setup:
    """Return the models, the start and the inputs of a problem."""
    if is_subset(spec):
        return build_subset(problem, spec)
    given = dict(spec.given) if spec.given is not None else dict.fromkeys(PLANAR, 0.0)
    faults = [*_given(given)]
    if spec.exact is not None and not _is_path(spec):
        expected = f"no key 'exact' but with {', '.join(SUBSET)} or a path"
        faults.append(Fault(("exact",), expected, str(spec.exact).lower()))
    if faults:
        raise problem_error(problem.source, faults)
    points, sought = _points(problem, spec), _is_path(spec)
    with at(problem, ("vehicle",)):
        vehicle = build_vehicle(spec.vehicle, problem.folder)
        if sought and not _rolls(vehicle):
            return build_subset(problem, spec, points)
        _check_rolls(vehicle)
    ground = build_ground(problem)
    with at(problem, ("vehicle",)):
        terrain = build_terrain(problem, ground)
        dae = inverse_kinematics(
            vehicle,
            terrain,
            given=tuple(given),
            solve_for="rates" if points is not None or spec.steering == "rate" else "angles",
            least_margin=0.0 if sought else LEAST_MARGIN,
        )
        direct = direct_kinematics(vehicle, terrain, slip=Rolling())
    check_names(problem, direct, None)
    start = build_start(problem, direct)
    with at(problem, ("given",) if points is None else ("path",)):
        if points is None:
            inputs = dae.inputs(**given)
            ahead = _ahead(direct, vehicle, start, given)
            start = apply_inputs(direct, start, ahead, options=spec.solver.options)
        else:
            t, x, y, heading = points
            inputs = along(dae, start, x, y, heading, t=t)
        if not sought:
            start = apply_inputs(dae, start, inputs, options=spec.solver.options)
    driven = _words(spec, points)
    return Setup(
        ground, terrain, vehicle, direct, dae, start, inputs, samples(spec.time, {})[0], driven
    )


def _given(given: dict[str, float]) -> Iterator[Fault]:
    """Yield what keeps rates from being three that may be given together."""
    known = list(dict.fromkeys((*KNOWN, *SUBSET, *ROBOT)))
    unknown = [*names(("given",), given, known)]
    yield from unknown
    if ours := [name for name in given if name in {*SUBSET, *ROBOT} - {*KNOWN}]:
        expected = (
            f"rates in the platform's heading frame ({', '.join(SUBSET)}; with frame = 'rep103' "
            f"also {', '.join(ROBOT)}) or others alone"
        )
        yield Fault(("given", ours[0]), expected, ", ".join(given))
    for name, value in given.items():
        if not isinstance(value, float):
            yield Fault(
                ("given", name),
                "a number",
                f"values in time, which only {', '.join(SUBSET)} may have",
            )
    if len(given) != 3:
        listed = f": {', '.join(given)}" if given else ""
        yield Fault(("given",), "three rates of the platform", f"{len(given)}{listed}")
    angular = [name for name in given if name in (*OMEGA, *EULER)]
    if set(angular) & set(OMEGA) and set(angular) & set(EULER):
        expected = f"some of {', '.join(OMEGA)} or some of {', '.join(EULER)}, not of both"
        yield Fault(("given",), expected, ", ".join(angular))


def _rolls(vehicle: Vehicle) -> bool:
    """Return whether a vehicle can roll without slip and has three inputs."""
    free = sum(not wheel.driven for wheel in vehicle.wheels)
    inputs = len(vehicle.wheels) - free + len(vehicle.of("commanded"))
    return inputs == 3 and len(vehicle.of("passive")) + free == 2 * len(vehicle.wheels) - 3


def _check_rolls(vehicle: Vehicle) -> None:
    if not _rolls(vehicle):
        raise ModelError(
            f"{vehicle.name} cannot roll without slip, as inverse kinematics at these rates "
            f"requires, or does not have three inputs; give some of {', '.join(SUBSET)} in "
            "[given], or a path with steering = 'angle'"
        )


def _words(spec: schema.Inverse, points: Array | None) -> str:
    """Return what drives the vehicle."""
    steering = f"the steering {spec.steering} is unknown"
    if points is not None:
        return f"path of {points.shape[1]} way-points in {points[0, -1]:g} s; {steering}"
    rates = ", ".join(
        f"{name} {value:g} {'m/s' if name in VELOCITY else 'rad/s'}"
        for name, value in (spec.given or {}).items()
    )
    return f"{rates}; {steering}"


def _points(problem: Problem[S], spec: schema.Inverse) -> Array | None:
    """Return times, places and headings of the way-points, shape (4, n), if there is a path."""
    path = spec.path
    if path is None:
        return None
    place = ("path", "t" if path.file is None else "file")
    if path.file is None:
        points = np.array([path.t, path.x, path.y, path.heading], dtype=float)
    else:
        with at(problem, place):
            rows = read_columns(problem.folder / path.file, COLUMNS)
        points = np.array(rows, dtype=float).reshape(-1, len(COLUMNS)).T
    if faults := [*_times(points[0], place, spec.time.duration)]:
        raise problem_error(problem.source, faults)
    points[3] += turned(problem)
    return points


def _times(t: Array, place: tuple[str, ...], duration: float) -> Iterator[Fault]:
    """Yield what is wrong with the times of a path."""
    if t.size < LEAST_POINTS:
        yield Fault(place, f"{LEAST_POINTS} or more way-points", str(t.size))
    elif t[0] != 0 or not (np.diff(t) > 0).all():
        yield Fault(place, "times that ascend from 0", ", ".join(f"{each:g}" for each in t[:4]))
    elif t[-1] < duration:
        expected = f"at most the time of the last way-point, {t[-1]:g} s"
        yield Fault(("time", "duration"), expected, f"{duration:g}")


def _ahead(direct: Dae, vehicle: Vehicle, start: Trajectory, given: dict[str, float]) -> Any:
    """Return inputs of the direct model that move the vehicle about as it is given."""
    heading, speed = float(start["heading"][-1]), SLOW
    if "velocity_x" in given and "velocity_y" in given:
        speed = given["velocity_y"] * np.cos(heading) - given["velocity_x"] * np.sin(heading)
    rates = {f"{w.name}_rate": speed / w.radius for w in vehicle.wheels if w.driven}
    commanded = {f"{c.name}_rate": 0.0 for c in vehicle.of("commanded")}
    return direct.inputs(**rates, **commanded)


def drive_along(
    setup: Setup, options: SolverOptions, progress: Callable[[float], None] | None
) -> Trajectory:
    """Return the motion along a path, with how far the direct model's replay is from it.

    Or under given rates in the platform's heading frame.
    """
    if isinstance(setup.dae.u, Wanted):
        return drive_subset(setup, options, progress)
    sought = [c.name for c in setup.vehicle.of("commanded")]
    found = drive(setup.dae, setup.start, setup.inputs, setup.t, sought=sought, options=options)
    run, words, gaps = found.run, "", dict[str, float]()
    if progress is not None:
        progress(float(run.t[-1]))
    try:
        inputs = spline_inputs(setup.model, found.t, found.unknowns)
        again = replay(setup.model, run, inputs, options=options)
    except (SlipfreeError, np.linalg.LinAlgError) as error:
        words = f"the replay by the direct model failed: {error}"
    else:
        gaps = {f"replay_{name}": size for name, size in again.difference.items()}
        if (stop := again.motion.stop) is not None:
            words = f"at {stop.t:.6g} s: {stop.words}"
    return replace(
        run,
        statistics={**run.statistics, "tolerance": options.tolerance, **gaps},
        attributes={"replay_stopped": words} if words else {},
    )


def finished(run: Trajectory) -> Trajectory:
    """Return a motion with the slip of its steering, or the reason why the steering failed."""
    if "steering_lever" in run.columns:
        return steering_slip(run)
    if run.stop is None or run.stop.name != "solver" or "steering_growth" not in run.columns:
        return run
    words = "; ".join(filter(None, [run.stop.words, steering_note(run)]))
    return replace(run, stop=run.stop._replace(words=words))
