"""Common parts of the verbs that move one vehicle over terrain."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from slipfree.contact.closure import has_exact_closure
from slipfree.core.errors import DataError
from slipfree.core.facts import Fact
from slipfree.core.records import Array, leaves
from slipfree.core.trajectory import Trajectory
from slipfree.files.cf import MAP_TRANSFORM, encode_map_coordinates
from slipfree.files.urdf.meshes import FORMATS, MeshFiles, find_mesh
from slipfree.geometry.mesh import TriangleMesh
from slipfree.laws.soil import Soil
from slipfree.models.friction_feasibility import BEST, best_utilisation
from slipfree.models.records import is_determinate
from slipfree.models.samples import (
    CLOSEST,
    closest_fact,
    has_pressed_wheels,
    obstacle_ending,
    wheel_poses,
)
from slipfree.models.single_wheel import RESERVE, drawbar_reserve
from slipfree.problem.build import (
    Setup,
    build_solids,
    build_terrain,
    build_vehicle,
    law_name,
    model_law,
)
from slipfree.problem.build_ground import GroundMap, at, build_ground
from slipfree.problem.build_vehicle import VehicleFile, vehicle_file
from slipfree.problem.inputs import digest
from slipfree.problem.problem import Problem
from slipfree.problem.schema import Modelled, MotionKeys
from slipfree.problem.verbs.base import (
    Lines,
    MotionVerb,
    Result,
    VerbSolution,
    Watch,
    integrator_fact,
    with_diagnostics,
)
from slipfree.problem.verbs.drive_facts import (
    CHECKS,
    FILLED,
    OBSTACLES,
    angle_lines,
    certificate,
    clearance_lines,
    contact_lines,
    drive_facts,
    force_lines,
    path_lines,
    slip_lines,
    soil_lines,
    start_lines,
    trust_lines,
)
from slipfree.solve.settle import stable_poses
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.solids import Prism
from slipfree.vehicle.tree import Vehicle

if TYPE_CHECKING:
    from slipfree.plan.polynomial_motion import SavedPlan
    from slipfree.show.drive_scene import Driven
    from slipfree.show.plots import Plot

Diagnostic = Callable[[Trajectory], Trajectory]
STEEPEST = 3.0  # ratio of vertical to normal distance from the ground, at a slope of 70 degrees
SAME = 1e-3  # largest distance of wheels from stored positions and from the ground, in radii


class DriveVerb(MotionVerb):
    """Base class of the verbs for the motion of one vehicle over terrain."""

    commands = ("run", "check", "vehicle")
    checks: ClassVar[tuple[str, ...]] = CHECKS
    metrics_shown = ("slip_rms", "tilt_largest", "utilisation_largest")

    @abstractmethod
    def build(self, problem: Problem[Any]) -> Setup:
        """Return model, start and inputs of a problem."""

    @abstractmethod
    def drive(
        self, problem: Problem[Any], setup: Any, watch: Watch, resume: SavedPlan | None
    ) -> tuple[Trajectory, Mapping[str, Array]]:
        """Return the motion without diagnostics, and further arrays for the result file by name."""

    def solve(
        self, problem: Problem[Any], setup: Any, watch: Watch, resume: SavedPlan | None
    ) -> VerbSolution:
        """Return the motion of a problem with its diagnostics."""
        run, arrays = self.drive(problem, setup, watch, resume)
        if setup.vehicle.mass:
            run = run.with_facts({"gravity": Fact(setup.vehicle.gravity, "m s-2")})
        law = model_law(problem) if isinstance(problem.spec, Modelled) else None

        run = with_diagnostics(run, _diagnostics(setup, law, run), watch, setup, arrays)
        return VerbSolution(run, setup, arrays)

    def describe_start(
        self, problem: Problem[MotionKeys], setup: Setup
    ) -> tuple[Trajectory, Lines]:
        """Return the start in the frame of the problem, and facts about start and samples."""
        spec = problem.spec
        start = setup.start.in_frame(spec.frame)
        own = [name for name in spec.start if name in start.columns]
        names = dict.fromkeys([*own, "z", "pitch", "roll"])
        pose = ", ".join(f"{name} {start[name][0]:.6g}" for name in names)
        return start, [
            ("start", f"{pose} (m, rad)"),
            *start_lines(_stable_poses(problem, setup)),
            ("contact certificate", certificate(start)),
            *clearance_lines(closest_fact(setup.vehicle, setup.terrain, setup.start)),
            ("samples", self.describe_samples(problem, setup)),
        ]

    def describe_samples(self, problem: Problem[Any], setup: Setup) -> str:
        """Return the description of the sampling of the result."""
        return f"{setup.t[:: setup.every or 1].size} to {setup.t[-1]:g} s"

    def describe_end(self, run: Trajectory) -> str:
        """Return the ending of a motion over solids; empty without solids."""
        ending = run.facts.get(OBSTACLES)
        return f"{ending.value}: {ending.words}" if ending else ""

    def facts(self, run: Trajectory) -> dict[str, Fact]:
        """Return last values, extremes, path length, slip and stored facts of a motion."""
        return {**drive_facts(run), **run.facts}

    def summary(self, run: Trajectory) -> Lines:
        """Return the summary of a motion, pairs of name and text."""
        facts = self.facts(run)
        return [
            *path_lines(run, facts),
            *self.own_lines(run),
            *contact_lines(run, facts),
            *soil_lines(run, facts),
            *slip_lines(run, facts),
            *angle_lines(run, facts),
            *clearance_lines(facts),
            *force_lines(run, facts),
            *trust_lines(run, facts, self.tolerance(run)),
            *self.cost_lines(run),
        ]

    def own_lines(self, run: Trajectory) -> Iterable[tuple[str, str]]:
        """Return the lines of the summary that are specific to this verb; none by default."""
        return []

    def tolerance(self, run: Trajectory) -> float | None:
        """Return the tolerance of the integrator; None if a motion was not integrated."""
        return run.statistics.get("tolerance")

    def cost_lines(self, run: Trajectory) -> Iterable[tuple[str, str]]:
        """Return the lines about the computational cost."""
        return [integrator_fact(run)]

    def figures(self, result: Result) -> tuple[Plot, ...]:
        """Return the figures of a motion, the most important first."""
        from slipfree.show.motion_figures import motion_plots

        ground = ground_of(result)
        terrain = build_terrain(result.problem, ground)
        prisms = build_solids(result.problem, terrain)
        return motion_plots(result.trajectory, ground.grid, prisms=prisms)

    def shown(self, result: Result, name: str) -> Driven:
        """Return the motion of a result with ground and vehicle, as input of the viewer."""
        from slipfree.show.drive_scene import Driven

        run, problem = result.trajectory, result.problem
        terrain, vehicle = build_terrain(problem, ground_of(result)), vehicle_of(result)
        prisms = build_solids(problem, terrain)
        _check_ground(result, terrain, prisms, vehicle)
        name_of_file = problem.spec.vehicle.file
        stored = None if name_of_file is None else vehicle_file(name_of_file, problem)
        robot, visuals = stored and stored.robot, visual_meshes(stored)
        return Driven(name, run, terrain, vehicle, prisms=prisms, robot=robot, visuals=visuals)

    def attributes(self, problem: Problem[Any], setup: Setup) -> dict[str, str]:
        """Return attributes of the result: input names, coordinates of the map file."""
        coordinates = setup.ground.coordinates
        return {
            "inputs": " ".join(label.full for label in leaves(setup.dae.labels.u)),
            **({MAP_TRANSFORM: encode_map_coordinates(coordinates)} if coordinates else {}),
        }


def visual_meshes(file: VehicleFile | None) -> dict[str, TriangleMesh]:
    """Return the meshes of the links of a URDF by name, those that the result used and exist."""
    from slipfree.show.meshes import joined

    visuals: dict[str, TriangleMesh] = {}
    if file is None or file.robot is None:
        return visuals
    folder, known = Path(file.robot.tree.file).parent, []
    for link in file.robot.tree.links.values():
        with suppress(DataError):  # the vehicle is then drawn with simple bodies
            if link.visuals and all(_is_known(mesh.name, folder, file) for mesh in link.visuals):
                known.append(link)
    files = MeshFiles((mesh for link in known for mesh in link.visuals), folder)
    for link in known:
        with suppress(DataError):
            visuals[link.name] = joined(*map(files.triangles, link.visuals))
    return visuals


def _is_known(mesh: str, folder: Path, file: VehicleFile) -> bool:
    """Return whether a mesh is that with which a result was computed; True for other vehicles."""
    if file.meshes is None:
        return True
    is_mesh = mesh.lower().endswith(FORMATS)
    return is_mesh and file.meshes.get(mesh) == digest(find_mesh(mesh, folder))


def _stable_poses(problem: Problem[MotionKeys], setup: Setup) -> tuple[Trajectory, ...]:
    """Return the stable poses at the start, the motion's own first, in the problem's frame."""
    model, spec = setup.model, problem.spec
    if model.standing is not None and model.standing.guess is None:
        model = model.standing.model
    poses: Sequence[Trajectory] = ()
    if relaxed := model.rest.numel():
        states = [label.full for label in leaves(model.labels.x)][:-relaxed]
        held: dict[str, Any] = {name: float(setup.start[name][0]) for name in states}
        poses = stable_poses(model, options=spec.solver.options, **held)
    return tuple(pose.in_frame(spec.frame) for pose in poses or (setup.start,))


def model_attributes(spec: Modelled) -> dict[str, str]:
    """Return the names of the model and the law of a problem, for its result file."""
    return {"model": spec.model, "law": law_name(spec)}


def ground_of(result: Result) -> GroundMap:
    """Return the ground of a result, from its set-up if present, or built from its problem."""
    return build_ground(result.problem) if result.setup is None else result.setup.ground


def vehicle_of(result: Result) -> Vehicle:
    """Return the vehicle of a result; raise DataError if it does not match the motion."""
    problem = result.problem
    with at(problem, ("vehicle",)):
        vehicle = build_vehicle(problem.spec.vehicle, problem)
    _check_vehicle(result.trajectory, vehicle)
    return vehicle


def _diagnostics(setup: Setup, law: object, run: Trajectory) -> dict[str, Diagnostic]:
    vehicle = setup.vehicle
    diagnostics: dict[str, Diagnostic] = {
        "filled_ground": partial(_with_filled, setup.ground.grid),
        OBSTACLES: partial(_with_ending, setup),
        CLOSEST: partial(_with_closest, setup),
    }
    has_choice = vehicle.mass and has_exact_closure(vehicle) and not is_determinate(vehicle)
    if has_choice and "kinetic_energy" not in run:  # dynamics has one distribution of forces
        diagnostics[BEST.name] = partial(best_utilisation, vehicle, setup.terrain)
    if isinstance(law, Soil):
        diagnostics[RESERVE.name] = partial(drawbar_reserve, vehicle, law)
    return diagnostics


def _with_filled(grid: Grid, run: Trajectory) -> Trajectory:
    """Return a motion with facts about wheel paths over filled holes, if the map has holes."""
    if grid.filled is None:
        return run
    on = grid.touches(grid.filled, run["contact_x"], run["contact_y"])
    steps = np.sqrt(sum(np.diff(run[f"contact_{axis}"], axis=0) ** 2 for axis in "xyz"))
    lengths = (0.5 * (on[:-1].astype(float) + on[1:]) * steps).sum(axis=0)
    rows = [
        {"wheel": wheel, "length": length, "path_length": whole}
        for wheel, length, whole in zip(
            run.wheels, lengths.tolist(), steps.sum(axis=0).tolist(), strict=True
        )
    ]
    samples = int(np.count_nonzero(on.any(axis=1)))
    return run.with_facts({FILLED: Fact(samples, "1"), "filled_paths": Fact(rows)})


def _with_closest(setup: Setup, run: Trajectory) -> Trajectory:
    """Return a motion with facts about the closest body and place, if bodies have shapes."""
    facts = closest_fact(setup.vehicle, setup.terrain, run)
    return run.with_facts(facts) if facts else run


def _with_ending(setup: Setup, run: Trajectory) -> Trajectory:
    """Return a motion with a fact about its ending on solids, if there are solids."""
    ending = obstacle_ending(run, setup.vehicle, setup.prisms)
    if ending is None:
        return run
    return run.with_facts({OBSTACLES: Fact(ending.name, words=ending.words)})


def _check_vehicle(run: Trajectory, vehicle: Vehicle) -> None:
    """Raise DataError unless the vehicle has the wheels, joints and contacts of the motion."""
    wheels = tuple(wheel.name for wheel in vehicle.wheels)
    if wheels != run.wheels or not {c.name for c in vehicle.coordinates} <= {*run.columns}:
        raise _changed("vehicle", None, "its wheels or joints have other names")
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
    if not off <= np.abs(_depth(run)).max() + SAME * min(wheel.radius for wheel in vehicle.wheels):
        raise _changed("vehicle", None, f"its wheels are {off:.2g} m from those of the result")


def _check_ground(
    result: Result, terrain: Bicubic, prisms: Sequence[Prism], vehicle: Vehicle
) -> None:
    """Raise DataError unless the ground or a solid is at the contact points of the motion."""
    run = result.trajectory
    heights = terrain.elevation(run["contact_x"], run["contact_y"])
    # points on wheels that press into the ground, or are above it
    away = np.abs(heights - run["contact_z"]) - STEEPEST * np.abs(_depth(run))
    points = np.stack([run[f"contact_{axis}"] for axis in "xyz"], axis=-1)
    for prism in prisms:
        away = np.minimum(away, np.abs(prism.distance(points)[0]) - np.abs(_depth(run)))
    off = away.max()
    if not off <= SAME * min(wheel.radius for wheel in vehicle.wheels):
        words = f"it is up to {off:.2g} m from the contact points"
        raise _changed("ground", result.problem.spec.terrain.file, words)


def _depth(run: Trajectory) -> Array:
    return run["depth"] if has_pressed_wheels(run) else np.zeros(1)


def _changed(what: str, file: str | None, words: str) -> DataError:
    remedy = "restore the file, give its folder with --folder DIR, or " if file else ""
    return DataError(
        f"expected the {what} with which the result was computed, found a different one"
        f"{f' ({file})' if file else ''}: {words}; {remedy}run the problem again"
    )
