"""Solution of problems, their results and result files; C code of a vehicle for a controller."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, ValidationError

from slipfree.core.arguments import checked
from slipfree.core.errors import DataError, ModelError, SlipfreeError
from slipfree.core.facts import Fact, Lines, as_attributes, lines
from slipfree.core.records import Array
from slipfree.core.trajectory import Outcome, Stop, Trajectory, thin
from slipfree.files.controller import ControllerCode, export_controller
from slipfree.files.netcdf import MapCoordinate, check_motion, check_name, read, read_arrays
from slipfree.files.toml import ProblemError
from slipfree.files.urdf.links import Robot
from slipfree.files.vehicle_toml import file_of, read_toml, vehicle_text
from slipfree.models.given_rates import COMMANDS, ROBOT
from slipfree.models.montana import Difference
from slipfree.plan.polynomial_motion import SavedPlan
from slipfree.problem import build_vehicle
from slipfree.problem.build import Setup, World
from slipfree.problem.build_ground import GroundMap, at, ground_table
from slipfree.problem.inputs import DIGESTS, digests
from slipfree.problem.load import check_option, find_motion_verb, load_again, load_problem, verb_of
from slipfree.problem.problem import Problem, shared
from slipfree.problem.schema import MotionKeys, Runnable
from slipfree.problem.verbs import base
from slipfree.problem.verbs.inverse import Inverse, are_commands, read_commands
from slipfree.routing.traversability import extents
from slipfree.show.meshes import reduced
from slipfree.system.forks import computing
from slipfree.system.regular_files import escape_name, unescape_name
from slipfree.terrain.base import Grid
from slipfree.terrain.grid_ops import cut
from slipfree.vehicle.sections import TriangleMesh


@computing
def build(problem: Problem[Runnable]) -> Any:
    """Return the set-up of a problem; raise ProblemError if it cannot be built."""
    return verb_of(problem).build(problem)


@checked
@computing
def run_problem(
    problem: Problem[Runnable],
    progress: Callable[[float], None] | None = None,
    tell: Callable[[str, str], None] | None = None,
    resume: SavedPlan | None = None,
    path: Callable[[Array], None] | None = None,
    keep: Callable[[base.Result], None] = lambda _: None,
    beside: Path | None = None,
) -> base.Result:
    """Solve a problem and return its motion.

    After Ctrl-C, or after an error in a diagnostic, the result is what was computed before.

    Parameters
    ----------
    problem : Problem
        Result of `load_problem`.
    progress : callable, optional
        Called with the time reached by the integrator. [s]
    tell : callable, optional
        Called for every iterate of a plan with the phase of the search and a line of text.
    resume : SavedPlan, optional
        Plan for a warm start; only for planning problems.
    path : callable, optional
        Called for every iterate of a plan with the path of the platform, shape (n, 2). [m]
    keep : callable, optional
        Called with what is computed so far, such as a solved plan that is not verified.
    beside : Path, optional
        Output, next to which a folder keeps the drawn worlds of a robust plan until it is found:
        after Ctrl-C, they are not simulated again.

    Returns
    -------
    Result
        The motion, complete or up to its stop.

    Raises
    ------
    ProblemError
        If the problem cannot be built, or cannot be solved from its start, for example because
        start, goal and limits of a plan contradict each other.
    SolverError
        If the integrator fails before the first sample; a later failure is the stop of
        the trajectory.
    KeyboardInterrupt
        After Ctrl-C before anything is computed.
    """
    verb, kept = verb_of(problem), list[base.Result]()

    def store(run: Trajectory, arrays: Mapping[str, Array]) -> None:
        kept[:] = [result_of(problem, verb, setup, run, arrays, files)]
        keep(kept[-1])

    setup = build(problem)
    watch = base.Watch(progress, tell, path, store, beside)
    files = digests(problem)  # before a long search, in which files may change
    try:
        with at(problem, ("start",)):
            run, arrays = verb.solve(problem, setup, watch, resume)
        return result_of(problem, verb, setup, run, arrays, files)
    except KeyboardInterrupt:
        if not kept:
            raise
    except Exception as error:
        if not kept:
            raise
        run = kept[-1].trajectory
        before = f"{run.stop.words}; " if run.stop else ""
        words = f"{before}{type(error).__name__}: {error}"
        stop = Stop("solver", float(run.t[-1]), words, Outcome.SOLVER_FAILURE)
        kept[-1] = replace(kept[-1], trajectory=replace(run, stop=stop))
    return kept[-1]


def result_of(
    problem: Problem[Any],
    verb: base.DriveVerb,
    setup: Setup,
    run: Trajectory,
    arrays: Mapping[str, Array],
    further: dict[str, str],
) -> base.Result:
    """Return the result of a problem with all that its file contains, and further attributes."""
    world, world_arrays = store_world(problem, setup, run, arrays)
    source = problem.source
    settings = {"settings": "\n".join(dict.fromkeys(source.settings.values()))}
    own = {
        "title": problem.spec.title or source.path.stem,
        base.VERB_ATTRIBUTE: verb.name,
        "problem_file": source.path.name,
        "problem_folder": str(source.path.parent),  # as given
        "problem": source.text,
        **(settings if source.settings else {}),
        **verb.attributes(problem, setup),
        **as_attributes(setup.facts),
    }
    own = {name: escape_name(text) for name, text in own.items()} | {STORED: world} | further
    run = replace(run, attributes={**run.attributes, **own})
    table, friction = ground_table(problem.spec.terrain), problem.spec.terrain.friction
    problem = replace(problem, grounds={table: (friction, setup.ground)})
    arrays = {**arrays, **world_arrays}
    if isinstance(problem.spec, MotionKeys):
        run = run.in_frame(problem.spec.frame)
    return base.Result(verb.name, run, verb.verification(run), setup, arrays, lambda: problem)


@computing
def cross_check(result: base.Result) -> tuple[str, tuple[Difference, ...]]:
    """Return the other formulation of contact, and the differences of the motion from that in it.

    ProblemError is raised if the verb of the problem does not offer a cross-check.
    """
    problem = result.problem
    check_option(problem, base.CROSS_CHECK)
    return verb_of(problem).cross_check(result)


@checked
def open_result(path: str | os.PathLike[str], *, samples: int | None = None) -> base.Result:
    """Return the result in a file of ``slipfree run``; no other file is read.

    Parameters
    ----------
    path : path
        The result file.
    samples : int, optional
        Approximate number of samples to keep, in addition to all extremes (see
        `slipfree.core.trajectory.thin`); by default all are kept.

    Raises
    ------
    DataError
        If the file cannot be read or is not a result.
    """
    file = Path(path)
    run = read(file) if samples is None else thin(read(file, lazy=True), samples)
    verb = find_motion_verb(run.attributes.get(base.VERB_ATTRIBUTE))
    kind, verification = (verb.name, verb.verification(run)) if verb else ("", {})
    arrays = read_arrays(file)
    problem = cache(partial(problem_of, file, run, arrays))
    return base.Result(kind, run, verification, None, arrays, problem)


def motion_facts(run: Trajectory) -> Lines:
    """Return the summary of a stored motion, pairs of name and text; see `facts_of` for errors."""
    return facts_of(run)[1]


def facts_of(run: Trajectory) -> tuple[Mapping[str, Fact], Lines]:
    """Return the facts of a stored motion by name, and its summary, pairs of name and text.

    DataError is raised if facts of the result file have other types than those of its verb.
    """
    verb = find_motion_verb(run.attributes.get(base.VERB_ATTRIBUTE))
    try:
        facts = verb.facts(run) if verb else run.facts
        return facts, lines(verb.rows if verb else base.PLAIN_ROWS, base.values_of(run, facts))
    except (AttributeError, TypeError, ValueError) as error:
        if isinstance(error, SlipfreeError):
            raise
        raise DataError(
            f"expected facts as slipfree run writes them, found others ({error}); run the problem "
            "again"
        ) from error


def export_mcap(file: Path, out: Path) -> None:
    """Write the motion in a result file as an MCAP file of ROS 2 messages; see `write_mcap`.

    Parameters
    ----------
    file : Path
        The result file.
    out : Path
        File to write, ending in ``.mcap``.

    Raises
    ------
    DataError
        If the result cannot be read, is not a motion over terrain or does not contain problem and
        vehicle, or if ``out`` cannot be written.
    """
    from slipfree.files.mcap import write_mcap

    check_name(out, file, (".mcap",))
    result = open_result(file)
    check_motion(file, result.trajectory, ("x", "y", "z", "wheel_angle", "slip_along"))
    robot = build_vehicle.vehicle_file(result.problem.spec.vehicle, result.problem).robot
    write_mcap(out, result.trajectory, base.world_of(result).vehicle, robot)


def result_files(file: Path) -> list[Path]:
    """Return a result file and the files from which it was computed, as far as it names them."""
    files = [file]
    with suppress(SlipfreeError, ValueError, TypeError):  # the command reports unreadable results
        attributes = read(file, lazy=True).attributes
        folder = Path(unescape_name(attributes.get("problem_folder", "")))
        names = [attributes["problem_file"], *json.loads(attributes.get(DIGESTS, "{}"))]
        files += [folder / name for name in names]
    return files


def problem_of(
    file: Path, run: Trajectory, arrays: Mapping[str, Array], changes: Sequence[str] = ()
) -> Problem[Any]:
    """Return the problem stored in a result, with further settings ``changes``.

    Ground and vehicle are those in the result, unless a setting changes them; names of files in
    ``changes`` are relative to the current folder. DataError is raised if the result does not
    contain its problem, ground and vehicle; ProblemError if the problem is not valid in this
    version.
    """
    text = run.attributes.get("problem")
    if text is None:
        raise DataError(
            f"{file}: expected a result that contains its problem, found none; use a file written "
            "by slipfree run"
        )
    grounds, vehicles = read_world(file, run, arrays)
    settings = run.attributes.get("settings", "").splitlines()
    name = Path(Path(run.attributes.get("problem_file", "problem.toml")).name)
    try:
        problem = load_again(name, text, settings, grounds=grounds)
        stored, spec = {None, *vehicles}, problem.spec
        if spec.vehicle.file not in stored or ground_table(spec.terrain) not in grounds:
            raise DataError(
                f"{file}: expected a result with the ground and vehicle of its problem, found "
                "others; run the problem again"
            )
        if changes:
            problem = load_again(name, text, [*settings, *changes], grounds=grounds)
    except ProblemError as error:
        raise ProblemError(
            f"{file}: its problem is not valid in this version of slipfree; correct these "
            "errors and run the problem again:",
            *error.faults,
        ) from error
    return replace(problem, vehicles=vehicles)


STORED = "stored_world"  # attribute of a result file
MAX_NODES = 2**18  # of a map that is stored whole, with 2 MB
MAX_FACES = 100_000  # of all links of a vehicle, with 2 MB
MARGIN, NEXT, CELLS = 1.0, 6.0, 32  # of a cut map [extent of the motion, reach of the vehicle, 1]
GROUND, FRICTION = "ground", "friction"  # beginnings of the names of arrays
MASKS = "filled", "holes"
Grounds = dict[str, tuple[float | str | None, GroundMap]]  # as in `Problem`


class StoredVehicle(BaseModel):
    """Vehicle of a result from a file, without the meshes of its links."""

    model_config = ConfigDict(ser_json_inf_nan="constants")
    file: str  # its name in the problem
    text: str  # the vehicle as a vehicle file in TOML
    notes: tuple[str, ...]  # of the reader
    robot: Robot | None


class StoredWorld(BaseModel):
    """Ground and vehicle of a result without arrays; None for a vehicle of the catalogue."""

    model_config = ConfigDict(ser_json_inf_nan="constants")
    ground: str  # keys on which the heights depend, as JSON
    friction: float | str | None  # value of the key
    coordinates: tuple[MapCoordinate, ...]  # as in `GroundMap`
    crs: str
    vehicle: StoredVehicle | None


def store_world(
    problem: Problem[Any], world: World, run: Trajectory, further: Mapping[str, Array]
) -> tuple[str, dict[str, Array]]:
    """Return the attribute and the arrays with which a result keeps ground and vehicle.

    Maps are cut to the surroundings of the motion and of the positions in ``further`` arrays.
    """
    spec, ground, vehicle = problem.spec, world.ground, None
    reach = extents(world.vehicle)[2]
    arrays = _arrays(GROUND, ground.grid, reach, run, further)
    if isinstance(ground.mu, Grid):
        arrays |= _arrays(FRICTION, ground.mu, reach, run, further)
    if (name := spec.vehicle.file) is not None:
        contents = build_vehicle.vehicle_file(spec.vehicle, problem)
        key = problem.folder / name, problem.trusted
        visuals = shared(
            "visuals", key, lambda: reduced(build_vehicle.visual_meshes(contents), MAX_FACES)
        )
        built, robot, _ = problem.vehicles[name] = contents._replace(visuals=visuals)
        if robot is not None:
            robot = robot._replace(tree=replace(robot.tree, file=Path(robot.tree.file).name))
            for k, link in enumerate(robot.tree.links):
                if link in visuals:
                    arrays[f"link{k}_vertices"] = visuals[link].vertices.astype("f4")
                    arrays[f"link{k}_faces"] = visuals[link].faces.astype(float)
        text = vehicle_text(built)
        vehicle = StoredVehicle(file=name, text=text, notes=built.notes, robot=robot)
    stored = StoredWorld(
        ground=ground_table(spec.terrain),
        friction=spec.terrain.friction,
        coordinates=ground.coordinates,
        crs=ground.crs,
        vehicle=vehicle,
    )
    return stored.model_dump_json(), arrays


def _arrays(
    name: str, grid: Grid, reach: float, run: Trajectory, further: Mapping[str, Array]
) -> dict[str, Array]:
    """Return the arrays of a map by name, cut to the surroundings of motion, guess and routes."""
    if grid.z.size > MAX_NODES:
        window = list[float]()
        places = [
            np.concatenate([run[axis], run[f"contact_{axis}"].ravel(), *others])
            for axis in "xy"
            for others in [[v for k, v in further.items() if k.endswith(f"_{axis}")]]
        ]
        extent = max(float(np.nanmax(each) - np.nanmin(each)) for each in places)
        for each, cell in zip(places, grid.spacing, strict=True):
            away = MARGIN * extent + NEXT * reach + CELLS * cell
            window += [float(np.nanmin(each)) - away, float(np.nanmax(each)) + away]
        grid = cut(grid, (window[0], window[1], window[2], window[3]))
    fields = {key: getattr(grid, key) for key in ("x", "y", "z", *MASKS)}
    return {f"{name}_{k}": v.astype(float) for k, v in fields.items() if v is not None}


def read_world(
    file: Path, run: Trajectory, arrays: Mapping[str, Array]
) -> tuple[Grounds, dict[str, build_vehicle.VehicleFile]]:
    """Return ground and vehicle of the result ``file``; raise DataError if they are damaged."""
    try:
        stored = StoredWorld.model_validate_json(run.attributes.get(STORED, ""))
        vehicle, vehicles = stored.vehicle, dict[str, build_vehicle.VehicleFile]()
        friction = stored.friction
        mu = _grid(FRICTION, arrays) if isinstance(friction, str) else friction
        words = "" if friction is None else str(friction)
        place = stored.coordinates, stored.crs
        ground = GroundMap(_grid(GROUND, arrays), str(file), None, mu, words, [], *place)
        if vehicle is not None:
            built = replace(read_toml(file_of(file, vehicle.text)).vehicle(), notes=vehicle.notes)
            visuals = {} if vehicle.robot is None else _visuals(vehicle.robot, arrays)
            vehicles[vehicle.file] = build_vehicle.VehicleFile(built, vehicle.robot, visuals)
    except (ValidationError, KeyError, DataError, ModelError) as error:
        found = f"others ({str(error).splitlines()[0]}); run the problem again"
        if STORED not in run.attributes or isinstance(error, KeyError):
            found = "none; run the problem again, and write the arrays of the result as well"
        raise DataError(
            f"{file}: expected a result with its ground and vehicle as slipfree run stores them, "
            f"found {found}"
        ) from error
    return {stored.ground: (friction, ground)}, vehicles


def _grid(name: str, arrays: Mapping[str, Array]) -> Grid:
    x, y, z = (arrays[f"{name}_{key}"] for key in "xyz")
    filled, holes = (arrays.get(f"{name}_{key}") for key in MASKS)
    return Grid(x, y, z, *(None if mask is None else mask != 0 for mask in (filled, holes)))


def _visuals(robot: Robot, arrays: Mapping[str, Array]) -> dict[str, TriangleMesh]:
    """Return the meshes of the links of a URDF, by name, and check its tree."""
    known, visuals = {robot.tree.root}, dict[str, TriangleMesh]()
    for name, joint in robot.tree.joints.items():
        if name != joint.name or joint.parent not in known or joint.child in known:
            raise DataError(f"the joint {name!r} in a loop, or before its parent")
        known.add(joint.child)
    if known != {*robot.tree.links}:
        raise DataError("links without a joint")
    for k, link in enumerate(robot.tree.links):
        if f"link{k}_vertices" in arrays:
            vertices, faces = (arrays[f"link{k}_{each}"] for each in ("vertices", "faces"))
            shapes = vertices.shape[1:], faces.shape[1:]
            if shapes != ((3,), (3,)) or not 0 <= faces.min() <= faces.max() < len(vertices):
                raise DataError(f"an invalid mesh of the link {link!r}")
            visuals[link] = TriangleMesh(vertices, faces.astype(np.uint32))
    return visuals


def export_code(file: Path, folder: Path, trust: Sequence[Path] = ()) -> ControllerCode:
    """Write C code of the vehicle of a problem or of a vehicle file; see `export_controller`.

    The velocities of an inverse problem are those that it gives, in its frame. Those of other
    problems and of vehicle files are all three, to which the answer is the nearest motion; those of
    vehicle files are in the frame of robots (REP 103).

    Parameters
    ----------
    file : Path
        The problem or vehicle file.
    folder : Path
        Folder of the files; made if it does not exist.
    trust : sequence of Path
        Xacro files that may be expanded.

    Raises
    ------
    DataError
        If the file cannot be read, its values are not valid, or a file cannot be written.
    ModelError
        If the vehicle cannot follow the velocities, or an inverse problem gives other rates.
    """
    if build_vehicle.is_vehicle_file(file):
        return export_controller(build_vehicle.read_vehicle(file, trust=trust), folder)
    problem: Problem[Any] = load_problem(file, command="vehicle", trust=trust)
    spec, given, exact = problem.spec, tuple(COMMANDS), False
    vehicle = build_vehicle.build_vehicle(problem)
    if isinstance(spec, Inverse) and spec.given:
        if not are_commands(spec.given):
            raise ModelError(
                f"{file}: [given]: expected velocities from {', '.join(COMMANDS)} (or, with frame "
                f"= 'rep103', {', '.join(ROBOT)}) to export code, found {', '.join(spec.given)}; "
                "give velocities in the frame of the heading"
            )
        commands, _ = read_commands(problem, spec)
        given = tuple(name for name in COMMANDS if name in commands)
        exact = len(given) < len(COMMANDS) if spec.exact is None else spec.exact
    return export_controller(vehicle, folder, given=given, exact=exact, frame=spec.frame)
