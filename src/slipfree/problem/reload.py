"""From a result file back to ground and vehicle, so that the motion can be drawn in space."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from slipfree.climb.vehicle import Climber
from slipfree.errors import DataError
from slipfree.files.netcdf import read as read_result
from slipfree.files.netcdf import read_arrays
from slipfree.files.toml.errors import ProblemError
from slipfree.models.poses import wheel_poses
from slipfree.plan.warm_start import ARRAY_PREFIX, from_arrays
from slipfree.problem import schema
from slipfree.problem.build_common import build_terrain, build_vehicle
from slipfree.problem.build_ground import at, build_ground
from slipfree.problem.goals import regions
from slipfree.problem.input_files import DRAWN, input_names
from slipfree.problem.load import Problem, climbs, read_earlier
from slipfree.problem.verbs.climb import build_climb
from slipfree.problem.verbs.climb_plan import PROGRESS
from slipfree.records import Array
from slipfree.regular_files import resolve_links, unescape_name
from slipfree.show.climb_scene import Climbed
from slipfree.show.drive_scene import Driven
from slipfree.terrain.bicubic import Bicubic
from slipfree.trajectory import Column, Trajectory
from slipfree.vehicle.tree import Vehicle

MOST = 401  # samples of a plan
SAME = 1e-3  # how far wheels may be from where they were and from the ground, in radii
POSE = ("x", "z", "tilt_rear", "tilt_front")  # of a climb


def shown(file: Path, name: str, folder: Path | None = None) -> Driven | Climbed:
    """Return the motion in a result file, with the ground and the vehicle of its problem.

    Parameters
    ----------
    file : Path
        A result file of ``slipfree run``.
    name : str
        What to call the motion.
    folder : Path, optional
        Where names of files in the problem start; by default the folder that the problem was in,
        that of the result, or the current one, whichever has them first.

    Raises
    ------
    DataError
        If the file cannot be read, holds no problem, or files that its problem names are missing or
        make another ground or vehicle than that of the motion.
    """
    run = read_result(file)
    problem = problem_of(file, run, folder)
    arrays = read_arrays(file)
    if climbs(problem):
        setup = build_climb(problem)
        plan = _planned_climb(run, arrays, setup.climber)
        return Climbed(name, run, setup.climber, setup.profile, plan)
    terrain = build_terrain(problem, build_ground(problem))
    with at(problem, ("vehicle",)):
        vehicle = build_vehicle(problem.spec.vehicle, problem.folder)
    _check_vehicle(file, run, vehicle, problem)
    _check_ground(file, run, terrain, vehicle, problem)
    keep_out = regions(problem, problem.spec) if isinstance(problem.spec, schema.Plan) else ()
    return Driven(name, run, terrain, vehicle, keep_out, _planned(run, arrays, terrain))


def problem_of(
    file: Path, run: Trajectory, folder: Path | None = None
) -> Problem[schema.Motion] | Problem[schema.Climb]:
    """Return the problem whose text and settings a result holds.

    Parameters and errors are those of `shown`; ``run`` is what the file holds.
    """
    text = run.attributes.get("problem")
    if text is None:
        raise DataError(
            f"{file}: expected a result with its problem in it, found none; give a file that "
            "slipfree run wrote"
        )
    settings = run.attributes.get("settings", "").splitlines()
    name = Path(run.attributes.get("problem_file", "problem.toml")).name
    with tempfile.TemporaryDirectory() as scratch:
        copy = Path(scratch) / "problem.toml"  # a name out of a file may be anything
        copy.write_text(text, encoding="utf-8")
        try:
            problem = read_earlier(copy, settings)
        except ProblemError as error:
            faults = (fault.replace(str(copy), name) for fault in error.faults)
            raise ProblemError(
                f"{file}: its problem is not one of this version:", *faults
            ) from error
    recorded = unescape_name(run.attributes.get("problem_folder", ""))
    place = _folder(file, problem.spec, recorded, folder)
    source = replace(problem.source, path=place / name)
    return replace(problem, source=source)


def _folder(
    file: Path, spec: schema.Motion | schema.Climb, recorded: str, folder: Path | None
) -> Path:
    """Return the folder that holds the files which a problem names."""
    needed = input_names(spec, DRAWN)
    here, beside = Path.cwd(), file.absolute().parent
    usual = [*(resolve_links(each / recorded) for each in (here, beside) if recorded), beside, here]
    tried = [folder] if folder is not None else list(dict.fromkeys(usual))
    for place in tried:
        missing = [name for name in needed if not _is_file(place / name)]
        if not missing:
            return place
    raise DataError(
        f"{file}: its problem needs {missing[0]}, found none in {' or '.join(map(str, tried))}; "
        "name the folder of the problem file: --folder DIR"
    )


def _is_file(path: Path) -> bool:
    return os.path.isfile(path)  # noqa: PTH113 - False for names that are too long


def _check_vehicle(
    file: Path, run: Trajectory, vehicle: Vehicle, problem: Problem[schema.Motion]
) -> None:
    """Refuse a vehicle whose parts were not where the motion has its wheels and their contacts."""
    named = problem.spec.vehicle.file or str(problem.spec.vehicle.catalog)
    wheels = tuple(wheel.name for wheel in vehicle.wheels)
    if wheels != run.wheels or not {c.name for c in vehicle.coordinates} <= {*run.columns}:
        raise _changed(file, "vehicle", named, "its wheels or joints have other names")
    placed = wheel_poses(vehicle, run)
    center, contact = (
        np.stack([run[f"{name}_{axis}"] for axis in "xyz"], axis=-1)
        for name in ("center", "contact")
    )
    away = np.linalg.norm(placed.origins - center, axis=-1)
    along = np.einsum("nki,nki->nk", contact - center, placed.rotations[..., 0])
    out = np.sqrt(np.maximum(((contact - center) ** 2).sum(axis=-1) - along**2, 0))
    columns = zip(vehicle.wheels, run["wheel_u"].T, strict=True)
    x, rho = np.stack([wheel.section.outline(u) for wheel, u in columns], axis=-1)
    off = max(away.max(), np.hypot(along - x, out - rho).max())
    if not off <= SAME * min(wheel.radius for wheel in vehicle.wheels):
        raise _changed(file, "vehicle", named, f"its wheels are {off:.2g} m from the motion's")


def _check_ground(
    file: Path,
    run: Trajectory,
    terrain: Bicubic,
    vehicle: Vehicle,
    problem: Problem[schema.Motion],
) -> None:
    """Refuse a ground that is not where the wheels of the motion touched it."""
    off = np.abs(terrain.elevation(run["contact_x"], run["contact_y"]) - run["contact_z"]).max()
    if not off <= SAME * min(wheel.radius for wheel in vehicle.wheels):
        words = f"it is up to {off:.2g} m from the contact points"
        raise _changed(file, "ground", problem.spec.terrain.file or "that is made", words)


def _changed(file: Path, what: str, named: str, words: str) -> DataError:
    return DataError(
        f"{file}: expected the {what} that it was run with, found another one ({named}): {words}; "
        "put the file back as it was, name the folder that has it by --folder DIR, or run again"
    )


def _planned(run: Trajectory, arrays: Mapping[str, Array], terrain: Bicubic) -> Trajectory | None:
    """Return the plan that a motion simulates, as far as its poses go; None if there is none.

    States and algebraic unknowns of a plan are the first quantities of its simulation, in order,
    up to the contacts. The turns of its wheels are those of the simulation.
    """
    if f"{ARRAY_PREFIX}unknowns" not in arrays:
        return None
    saved = from_arrays(arrays, "result")
    course = saved.motion
    places = np.linspace(0, 1, min(MOST, 10 * course.mesh.ends.size))
    rows = np.concatenate([course.states(places), course.algebraic(places)])
    rows = rows + saved.shift[: len(rows), None]
    columns, t, first = {}, run.t[0] + places * course.duration, 0
    for name, column in run.columns.items():
        if name == "contact_x":
            break
        columns[name] = Column(column.label, rows[first])
        first += 1
    # Contacts are unknowns wheel by wheel: x and y of the first one, then those of the next.
    pairs = rows[first : first + 2 * len(run.wheels)].reshape(len(run.wheels), 2, -1)
    for axis, name in enumerate(("contact_x", "contact_y")):
        columns[name] = Column(run.columns[name].label, pairs[:, axis].T)
    columns["wheel_angle"] = _turns(run, t)
    height = terrain.elevation(columns["contact_x"].values, columns["contact_y"].values)
    columns["contact_z"] = Column(run.columns["contact_z"].label, height)
    return Trajectory(t, columns, run.wheels)


def _turns(run: Trajectory, t: Array) -> Column:
    """Return how far the wheels of a motion have turned at some times."""
    turns = run.columns["wheel_angle"]
    values = [np.interp(t, run.t, each) for each in turns.values.T]
    return Column(turns.label, np.stack(values, axis=1))


def _planned_climb(
    run: Trajectory, arrays: Mapping[str, Array], climber: Climber
) -> Trajectory | None:
    """Return the plan that a climb tracks, at the times when it is as far; None if there is none.

    Its time counts from when the motion has come to where the plan begins.
    """
    if "plan_time" not in arrays:
        return None
    columns = {name: Column(run.columns[name].label, arrays[f"plan_{name}"]) for name in POSE}
    x, z, rear, front = (columns[name].values for name in POSE)
    ahead = np.array([axle.ahead for axle in climber.axles])
    tilts = np.stack([rear, rear, front], axis=1)
    for name, start, turned in (("axle_x", x, np.cos), ("axle_z", z, np.sin)):
        places = start[:, None] + ahead * turned(tilts)
        columns[name] = Column(run.columns[name].label, places)
    come = (run["axle_x"] + run["axle_z"]).mean(axis=1)
    begins = run.t[int((come > arrays[f"plan_{PROGRESS.name}"][0]).argmax())]
    t = begins + arrays["plan_time"]
    return Trajectory(t, columns | {"wheel_angle": _turns(run, t)}, run.wheels)
