"""Interface between commands and verbs, and the lines of all summaries.

A verb is a kind of problem: the value of the key ``verb`` in a problem file. Commands use only this
interface and `slipfree.problem.load`; everything specific to a verb is in the module of the verb.
"""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, get_args

import numpy as np
from typing_extensions import TypeVar

from slipfree.core.errors import DataError
from slipfree.core.facts import Fact, Facts, Lines, Row, guesses, lines, named_rows, rows
from slipfree.core.quantities import QUANTITIES, extremes, joint_angles
from slipfree.core.records import Array, HtmlRepr, leaves
from slipfree.core.trajectory import Outcome, Stop, Trajectory, outcome_words, path_length
from slipfree.files.netcdf import MAP_TRANSFORM, NOTHING
from slipfree.files.urdf.links import beyond_limits
from slipfree.laws.soil import Soil
from slipfree.models.base import is_determinate
from slipfree.models.friction_feasibility import BEST, best_utilisation
from slipfree.models.samples import (
    CLOSEST,
    closest_fact,
    has_friction,
    has_pressed_wheels,
    lightest_wheel,
    obstacle_ending,
    rocks,
)
from slipfree.models.single_wheel import RESERVE, drawbar_reserve
from slipfree.problem.build import Setup, World, build_world, law_name, model_law
from slipfree.problem.build_vehicle import vehicle_file, visual_meshes
from slipfree.problem.problem import Problem
from slipfree.problem.schema import CommonKeys, Modelled, MotionKeys
from slipfree.solve.settle import stable_poses
from slipfree.solve.simulate import simulate_to_failure
from slipfree.solve.system import SolverOptions
from slipfree.system.interrupt import check_interrupt

if TYPE_CHECKING:
    from slipfree.models.montana import Difference
    from slipfree.plan.polynomial_motion import SavedPlan
    from slipfree.problem.verbs.plan_setup import Domain
    from slipfree.show.plots import Plot
    from slipfree.show.scene import Driven


VERB_ATTRIBUTE = "verb"  # attribute of result files with the name of the verb
FAILED_DIAGNOSTICS = "failed_diagnostics"  # fact with names and errors of diagnostics
DURATION_LINE = "duration: {duration:g}, {samples} samples"
INTEGRATOR_LINE = """\
!integrator: {steps:.0f} steps, {residuals:.0f} evaluations, {cpu_seconds:.3g} s CPU, tolerance \
{tolerance:g}"""
PLAIN_ROWS = rows(f"{DURATION_LINE}\n{INTEGRATOR_LINE}")
CROSS_CHECK, RESUME = "cross-check", "resume"  # options of slipfree run
P = TypeVar("P", bound=CommonKeys, default=Any)  # record of a problem
D = TypeVar("D", default=Any)  # its set-up, or None


def ranges(run: Trajectory) -> Lines:
    """Return the facts about the range of every quantity over time and wheels.

    On a ground without a friction coefficient, ``utilisation`` equals ``friction_needed`` and is
    omitted.
    """
    facts = []
    for name, column in run.columns.items():
        if name == "utilisation" and not has_friction(run):
            continue
        low, high = (float(end.reduce(column.values, axis=None)) for end in (np.fmin, np.fmax))
        unit, ends = column.label.unit, dict.fromkeys((low, high))
        n = 10 if unit == "m" and high > 1e3 else 6  # a northing has seven before the point
        span = " to ".join("infinite" if np.isinf(end) else f"{end:.{n}g}" for end in ends)
        facts.append((name, span if unit == "1" or np.isinf(low) else f"{span} {unit}"))
    return facts


def outcome_fact(run: Trajectory) -> tuple[str, str]:
    """Return the fact about the outcome of a motion, the first line of every summary."""
    return "outcome", outcome_words(run)


def values_of(run: Trajectory, facts: Facts) -> dict[str, Any]:
    """Return the values in the rows of summaries: facts, attributes, statistics, samples."""
    duration, share = Fact(float(run.t[-1] - run.t[0]), "s"), ""
    # the integrator's error test ignores the unknowns of pressed wheels and of plans
    ignored = "depth" in run or "plan_iterations" in facts
    if "newton_step_largest" in facts and "steps" in run.statistics and not ignored:
        error = facts["newton_step_largest"].value / run.statistics["tolerance"]
        share = f", {error:.3g} x the tolerance"
    counted = {"samples": run.t.size, "duration": duration, "of_tolerance": share}
    return {**counted, **run.attributes, **run.statistics, **facts}


class Watch(NamedTuple):
    """Callbacks during the solution of a problem; the first three may raise KeyboardInterrupt."""

    time: Callable[[float], None] | None = None  # called with the time reached [s]
    line: Callable[[str, str], None] | None = None  # phase of the search, and a line, per iterate
    path: Callable[[Array], None] | None = None  # path of an iterate on the map, shape (n, 2) [m]
    # what is computed so far: the last one is the result if the computation ends early
    keep: Callable[[Trajectory, Mapping[str, Array]], None] = lambda *_: None
    beside: Path | None = None  # output, next to which a folder keeps finished parts

    def begin(self, phase: str) -> None:
        """Report the beginning of a phase without iterates of its own."""
        if self.line is not None:
            self.line(phase, phase)


def integrate(setup: Any, options: SolverOptions, watch: Watch) -> Trajectory:
    """Return the motion of a set-up, or its part up to Ctrl-C or to a failure of the integrator.

    The motion has all samples of a sampled driving law. SolverError is raised if the integrator
    fails before the first sample.
    """

    def progress(t: float) -> bool:
        """Show the time; return False, which ends the motion, after Ctrl-C."""
        try:
            if watch.time is not None:
                watch.time(t)
        except KeyboardInterrupt:
            return False
        return True

    problem = setup.dae, setup.start, setup.inputs, setup.t
    return simulate_to_failure(*problem, options, progress=progress, sampled=bool(setup.every))


def with_diagnostics(
    run: Trajectory,
    diagnostics: Mapping[str, Callable[[Trajectory], Trajectory]],
    watch: Watch,
    arrays: Mapping[str, Array] = NOTHING,
) -> Trajectory:
    """Return a motion with diagnostics, by name; a fact names those that fail, with the error.

    After Ctrl-C the motion is kept with the diagnostics so far, and KeyboardInterrupt is raised.
    """
    for name, diagnose in diagnostics.items():
        try:
            check_interrupt()
            watch.begin(f"checking the motion: {name.replace('_', ' ')}")
            run = diagnose(run)
        except KeyboardInterrupt:
            t = float(run.t[-1])
            words = f"the motion is computed to its end, but not all diagnostics: without {name}"
            stop = run.stop or Stop("interrupted", t, words, Outcome.INTERRUPTED)
            watch.keep(replace(run, stop=stop), arrays)
            raise
        except Exception as error:  # a failed diagnostic must not lose the motion
            earlier = run.facts[FAILED_DIAGNOSTICS].value if FAILED_DIAGNOSTICS in run.facts else []
            failures = [*earlier, f"{name}: {type(error).__name__}: {error}"]
            run = run.with_facts({FAILED_DIAGNOSTICS: Fact(failures)})
    return run


@dataclass(frozen=True, eq=False)
class Result(HtmlRepr, Generic[P, D]):
    """Motion of a problem, from `run_problem` or from a result file.

    Attributes
    ----------
    kind : str
        Name of the verb; empty if the result file does not name a known verb.
    trajectory : Trajectory
        The motion, complete or up to its stop.
    verification : mapping of str to Fact
        Largest differences of the motion from an independent computation, and violations of
        limits, by name; empty for verbs without verification.
    setup : Setup or None
        Model, start and inputs of the motion; None if it was read from a file.
    arrays : mapping of str to ndarray
        Arrays of the result file besides the samples, such as the plan for a warm start.
    load : callable
        Function without arguments that returns the problem.
    """

    kind: str
    trajectory: Trajectory
    verification: Mapping[str, Fact]
    setup: D
    arrays: Mapping[str, Array]
    load: Callable[[], Problem[P]]

    def __repr__(self) -> str:
        return f"Result: {self.kind}, {self.outcome.title}\n{self.trajectory!r}"

    @property
    def outcome(self) -> Outcome:
        """Outcome of the motion."""
        return self.trajectory.outcome

    @property
    def problem(self) -> Problem[P]:
        """Problem of the result, read from the result file when it is needed.

        Raises
        ------
        DataError
            If the result was read from a file without its problem, ground and vehicle.
        ProblemError
            If the problem is not valid in this version.
        """
        return self.load()


class Verb:
    """A kind of problem: the record of its files, and the commands that accept them."""

    commands: tuple[str, ...]  # the first one solves the problems

    def __init__(self, module: str, record: str, *commands: str) -> None:
        self._module, self._record, self.commands = module, record, commands

    @property
    def schema(self) -> type[CommonKeys]:
        """The record, imported when it is used: that of fits takes 27 ms."""
        record: type[CommonKeys] = getattr(import_module(self._module), self._record)
        return record

    @property
    def name(self) -> str:
        """Value of the key ``verb``."""
        (name,) = get_args(self.schema.model_fields["verb"].annotation)
        return str(name)


FORMULATION = "formulation"  # attribute of results of direct problems
OBSTACLES = "obstacles"  # fact of motions over solids: their ending
FILLED = "filled_samples"  # fact of motions on a map with filled holes
UNIQUE = ("clearance", "relative_curvature")  # not negative if every wheel has one contact point
AT_END = "x", "heading"  # quantities whose lines of the summary come first
FIRST_LINES = """\
*path length: {path_length:.6g} in {duration:g}, heights {z_least.value:.4f} to {z_greatest:.4f}
*obstacles: {obstacles}: {obstacles.words}
filled ground: {filled_samples} of {samples} samples have a wheel on interpolated heights; along \
the contact points: <filled_paths> {wheel} {length:.4g} of {path_length:.4g} m"""
SMALLEST_PATH = 0.1  # of the slip, of motions other than turns on the spot [1]
START = 0.1  # time within which torques at sudden rates decrease, in dynamics [s]
SLIDES = 0.999  # utilisation above which a wheel slides, in models with friction
SLIDING, MIN_SLIP = 0.05, 1e-3  # slip above which a wheel slides: share of its speed, and [m/s]
LAST_LINES = """\
*faster than the URDF allows: <faster_wheels> {wheel} {value:.3g} of {limit:.3g} rad/s
*more torque than the URDF allows: <overloaded_wheels> {wheel} {value:.3g} of {limit:.3g} N m at \
{t:.4g} s
*!not converged: <not_converged> {name} at {fact} of {samples} samples
*!diagnostics failed: <failed_diagnostics> {fact}"""
START_ROWS = named_rows("start") + rows(QUANTITIES["clearance_body"].line)
Diagnostic = Callable[[Trajectory], Trajectory]


class DriveVerb(Verb, ABC):
    """Base class of the verbs whose solution is the motion of one vehicle over terrain."""

    commands = ("run", "check", "vehicle")
    options: ClassVar[tuple[str, ...]] = ()  # of slipfree run: CROSS_CHECK, RESUME
    is_timed: ClassVar[bool] = True  # whether the solver proceeds along the time, as integrators do
    # rows of the summary of a motion that only this verb has: after those of the pose, and last
    own_rows: ClassVar[tuple[Row, ...]] = ()
    last_rows: ClassVar[tuple[Row, ...]] = ()
    metrics_shown: ClassVar[tuple[str, ...]] = ("slip_rms", "tilt_largest", "utilisation_largest")
    verified: ClassVar[tuple[str, ...]] = ()  # beginnings of the facts of `verification`

    def __init__(self) -> None:
        """Keep the record and the commands of the class."""

    @property
    def rows(self) -> tuple[Row, ...]:
        """Rows of the summary of a motion, with the lines of the table of quantities."""
        texts = {name: each.line for name, each in QUANTITIES.items() if each.line}
        first = [DURATION_LINE, FIRST_LINES, *(texts.pop(name) for name in AT_END)]
        others = rows("\n".join([*texts.values(), LAST_LINES, INTEGRATOR_LINE]))
        return *rows("\n".join(first)), *self.own_rows, *others, *self.last_rows

    @abstractmethod
    def build(self, problem: Problem[Any]) -> Setup:
        """Return model, start and inputs of a problem; raise ProblemError for an invalid one."""

    @abstractmethod
    def drive(
        self, problem: Problem[Any], setup: Any, watch: Watch, resume: SavedPlan | None
    ) -> tuple[Trajectory, Mapping[str, Array]]:
        """Return the motion without diagnostics, and further arrays for the result file by name.

        ``watch`` reports the progress, ``resume`` is a plan for a warm start. SolverError is raised
        if the solver fails before the first sample; a later failure is the stop of the trajectory.
        """

    def solve(
        self, problem: Problem[Any], setup: Any, watch: Watch, resume: SavedPlan | None
    ) -> tuple[Trajectory, Mapping[str, Array]]:
        """Return the motion of a problem with its diagnostics, and arrays as `drive` does."""
        run, arrays = self.drive(problem, setup, watch, resume)
        if setup.vehicle.mass:
            run = run.with_facts({"gravity": Fact(setup.vehicle.gravity, "m s-2")})
        vehicle, grid = setup.vehicle, setup.ground.grid
        if robot := vehicle_file(problem.spec.vehicle, problem).robot:
            beyond = beyond_limits(robot, run)
            run = run.with_facts({name: Fact(wheels) for name, wheels in beyond.items()})

        def with_filled(run: Trajectory) -> Trajectory:
            """Return a motion with facts about wheel paths over filled holes of the map."""
            on = grid.touches(grid.filled, run["contact_x"], run["contact_y"])
            steps = np.sqrt(sum(np.diff(run[f"contact_{axis}"], axis=0) ** 2 for axis in "xyz"))
            lengths = (0.5 * (on[:-1].astype(float) + on[1:]) * steps).sum(axis=0)
            paths = _by_wheel(run, {"length": lengths, "path_length": steps.sum(axis=0)})
            samples = int(np.count_nonzero(on.any(axis=1)))
            return run.with_facts({FILLED: Fact(samples, "1"), "filled_paths": Fact(paths)})

        def with_ending(run: Trajectory) -> Trajectory:
            """Return a motion with a fact about its ending on solids, if there are solids."""
            ending = obstacle_ending(run, vehicle, setup.prisms)
            facts = {OBSTACLES: Fact(ending.name, words=ending.words)} if ending else {}
            return run.with_facts(facts)

        diagnostics = dict[str, Diagnostic]()
        if grid.filled is not None:
            diagnostics["filled_ground"] = with_filled
        diagnostics[OBSTACLES] = with_ending
        diagnostics[CLOSEST] = lambda run: run.with_facts(closest_fact(vehicle, setup.terrain, run))
        has_choice = vehicle.mass and not is_determinate(vehicle)
        if has_choice and "kinetic_energy" not in run:  # dynamics has one distribution of forces
            diagnostics[BEST.name] = partial(best_utilisation, vehicle, setup.terrain)
        law = model_law(problem) if isinstance(problem.spec, Modelled) else None
        if isinstance(law, Soil):
            diagnostics[RESERVE.name] = partial(drawbar_reserve, vehicle, law)
        return with_diagnostics(run, diagnostics, watch, arrays), arrays

    def describe_start(
        self, problem: Problem[MotionKeys], setup: Setup
    ) -> tuple[Trajectory, Lines]:
        """Return the start in the frame of the problem, and facts about start and samples."""
        spec = problem.spec
        start = setup.start.in_frame(spec.frame)
        own = [name for name in spec.start if name in start.columns]
        units = {name: start.columns[name].label.unit for name in (*own, "z", "pitch", "roll")}
        pose = ", ".join(
            f"{name} {Fact(start[name][0], unit):{'.2f>deg' if unit == 'rad' else '.3f'}}"
            for name, unit in units.items()
        )
        facts = drive_facts(start) | closest_fact(setup.vehicle, setup.terrain, setup.start)
        if has_pressed_wheels(start):
            model, poses = setup.model, [setup.start]
            if model.standing is not None and model.standing.guess is None:
                model = model.standing.model
            if relaxed := model.rest.numel():  # the motion's own pose comes first
                states = [label.full for label in leaves(model.labels.x)][:-relaxed]
                held: dict[str, Any] = {name: float(setup.start[name][0]) for name in states}
                poses = [*stable_poses(model, options=spec.solver.options, **held)] or poses
            table = list[dict[str, Any]]()
            for each in poses:
                wheel, share, depth = lightest_wheel(each, 0)
                angles = {name: float(each[name][0]) for name in ("pitch", "roll")}
                table.append({**angles, "wheel": wheel, "share": share, "depth": depth})
            facts["stable_poses"] = Fact(table)
        samples = self.describe_samples(problem, setup)
        return start, [("start", pose), *lines(START_ROWS, facts), ("samples", samples)]

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

    def summary(self, run: Trajectory, *, main: bool = False) -> Lines:
        """Return the lines of the summary of a motion, all or the main ones.

        The main lines omit a clean contact certificate, and the friction needed without slip where
        a simulation with friction states the utilisation.
        """
        facts = self.facts(run)
        certificate = f"{facts.get('contact_certificate', '')}"
        omitted = {"contact certificate"} if certificate.startswith("clean") else set[str]()
        omitted |= {"friction"} if "friction_utilisation_largest" in facts else set()
        omitted |= {"drives"} if "energy_imbalance" not in facts else set()
        main_rows = (row for row in self.rows if row.is_main and row.name not in omitted)
        shown = lines(main_rows if main else self.rows, values_of(run, facts))
        return shown + guesses(run.attributes) * main

    def warnings(self, run: Trajectory) -> Sequence[str]:
        """Return warnings about a motion; none by default."""
        return ()

    def verification(self, run: Trajectory) -> dict[str, Fact]:
        """Return differences from an independent computation and violations of limits, by name."""
        return {name: fact for name, fact in run.facts.items() if name.startswith(self.verified)}

    def cross_check(self, result: Result) -> tuple[str, tuple[Difference, ...]]:
        """Return the other formulation of contact, and differences from it, if the verb has one."""
        raise NotImplementedError(CROSS_CHECK)

    def figures(self, result: Result) -> tuple[Plot, ...]:
        """Return the figures of a motion, the most important first."""
        from slipfree.show.motion_figures import motion_plots

        world = world_of(result)
        marks = self.marks(result.problem, world.terrain.domain)
        return motion_plots(result.trajectory, world.ground.grid, prisms=world.prisms, marks=marks)

    def marks(self, problem: Problem[Any], domain: Domain) -> dict[str, Any]:
        """Return keep-out regions and places of a plan; none for other motions."""
        return {}

    def shown(self, result: Result, name: str) -> Driven:
        """Return the motion of a result with ground and vehicle, as input of the viewer."""
        from slipfree.show.scene import Driven

        run, problem, world = result.trajectory, result.problem, world_of(result)
        contents = vehicle_file(problem.spec.vehicle, problem)
        robot, visuals = contents.robot, visual_meshes(contents)
        drawn: dict[str, Any] = {"prisms": world.prisms, "robot": robot, "visuals": visuals}
        drawn |= self.marks(problem, world.terrain.domain)
        return Driven(name, run, world.terrain, world.vehicle, **drawn)

    def attributes(self, problem: Problem[Any], setup: Setup) -> dict[str, str]:
        """Return attributes of the result: input names, coordinates of the map file."""
        coordinates = setup.ground.coordinates
        return {
            "inputs": " ".join(setup.dae.input_names),
            **({MAP_TRANSFORM: json.dumps(coordinates)} if coordinates else {}),
        }


def drive_facts(run: Trajectory) -> dict[str, Fact]:
    """Return the facts of a motion: last values, extremes, path length, slip, energy, rocking."""
    facts = extremes(run)
    duration, length = float(run.t[-1] - run.t[0]), path_length(run)
    facts["duration"], facts["path_length"] = Fact(duration, "s"), Fact(length, "m")
    tilts = [name for name in joint_angles(run) if name.startswith("tilt_")]
    if largest := extremes(run, dict.fromkeys(tilts, "largest")):
        facts |= largest
        facts["tilt_largest"] = Fact(max(fact.value for fact in largest.values()), "rad")
    slip = np.hypot(run["slip_along"], run["slip_across"])
    facts["slip_largest"] = Fact(float(slip.max()), "m s-1")
    by_wheel = {
        "along_largest": np.abs(run["slip_along"]).max(axis=0),
        "across_largest": np.abs(run["slip_across"]).max(axis=0),
        "rms": np.sqrt(np.mean(slip**2, axis=0)),
    }
    facts["slip_by_wheel"] = Fact(_by_wheel(run, by_wheel))
    if duration > 0:
        squares = np.trapezoid(slip**2, run.t, axis=0).mean()
        facts["slip_rms"] = Fact(float(np.sqrt(squares / duration)), "m s-1")
    total = np.trapezoid(slip, run.t, axis=0).mean()
    if length > SMALLEST_PATH * total:
        facts["slip_per_path"] = Fact(float(total / length), "m m-1")
    steps = np.hypot(np.diff(run["x"]), np.diff(run["y"]))
    facts["sample_distance_largest"] = Fact(float(steps.max(initial=0.0)), "m")
    unknown = {
        name: int(np.isnan(column.values).reshape(run.t.size, -1).any(axis=1).sum())
        for name, column in run.columns.items()
    }
    facts["not_converged"] = Fact({name: count for name, count in unknown.items() if count})
    if "drawbar_reserve" in run:
        reserve = run["drawbar_reserve"].sum(axis=1)
        least = int(np.nanargmin(reserve))
        facts["drawbar_least"] = Fact(float(reserve[least]), "N", f"t = {run.t[least]:.4g} s")
    if "body_load" in run:
        facts["body_on_ground"] = Fact(float((run["body_load"] > 0).mean()), "1")
    if "utilisation_largest" in facts:
        facts["friction"] = Fact(_friction(run, facts))
    if has_pressed_wheels(run):
        facts |= _pressed_facts(run)
    model = run.attributes.get("model", "kinematics")
    law = run.attributes.get("law", "least")
    if model == "kinematics" and duration > 0:
        speeds = (np.gradient(run[name], run.t, axis=0) for name in ("contact_x", "contact_y"))
        if np.any(slip > SLIDING * np.hypot(*speeds) + MIN_SLIP):
            words = "without the friction of sliding wheels, which model = 'dynamics' has"
            inverse = " in a direct problem with their rates (export --rates, [inputs] file)"
            is_inverse = run.attributes.get(VERB_ATTRIBUTE) == "inverse"
            facts["left_out"] = Fact(words + inverse * is_inverse)
    meaning = f"by the slip law {law!r}, not a prediction"
    if law == "least":
        meaning = "the least that kinematics allows: a lower bound, not a prediction"
    if model == "dynamics":
        energy = run["kinetic_energy"] + run["potential_energy"] + run["contact_energy"]
        work, lost = (run[name] - run[name][0] for name in ("work", "lost_energy"))
        balance = float(np.abs(energy - energy[0] - work + lost).max())
        facts["energy_imbalance"] = Fact(balance, "J")
        torques = np.nan_to_num(np.abs(run["drive_torque"])).max(axis=1)
        since = run.t - run.t[0]
        if since[torques.argmax()] <= START < since[-1]:
            later = float(torques[since > START].max())
            facts["torque_after_start"] = Fact(later, "N m", f"{START:g} s")
        meaning = f"a prediction with inertia, by the wheel-ground law {law!r}"
    else:
        facts["contact_certificate"] = Fact(_certificate(run, facts))
    if model == "quasi-static":
        meaning = f"a quasi-static prediction by the wheel-ground law {law!r}"
    facts["slip_law"] = Fact(meaning)
    return facts


def _by_wheel(run: Trajectory, columns: Mapping[str, Array]) -> list[dict[str, Any]]:
    """Return a row for each wheel, of columns with a value for each wheel."""
    rows = zip(run.wheels, *(values.tolist() for values in columns.values()), strict=True)
    return [dict(zip(("wheel", *columns), row, strict=True)) for row in rows]


def _pressed_facts(run: Trajectory) -> dict[str, Fact]:
    """Return facts about pressed wheels: time in the air, lift-offs and rocking."""
    depth = run["depth"]
    flying = np.concatenate([[False], (depth < 0).all(axis=1), [False]])
    ends = np.append(run.t, run.t[-1])  # of flights, with all wheels in the air
    edges = np.flatnonzero(np.diff(flying)).reshape(-1, 2).tolist()
    flights = [float(ends[last] - run.t[first]) for first, last in edges]
    in_air = {"share_of_samples": (depth < 0).mean(axis=0), "height": -depth.min(axis=0)}
    changes = [rock._asdict() for rock in rocks(run)]
    facts = {
        "time_in_air": Fact(sum(flights), "s"),
        "wheels_in_air": Fact([e for e in _by_wheel(run, in_air) if e["share_of_samples"]]),
        "lift_offs": Fact(int(((depth[:-1] >= 0) & (depth[1:] < 0)).sum()), "1"),
        "rocks": Fact(changes),
        "wheel_contact": Fact("compliant contact"),
    }
    if flights:
        facts["longest_flight"] = Fact(max(flights), "s")
    if run.attributes.get("model") == "dynamics":
        return facts
    return facts | {
        "wheel_contact": Fact("pressed wheels"),
        "least_loaded": Fact(lightest_wheel(run, 0)[0]),
        "load_changes": Fact(str(len(changes))),
    }


def _friction(run: Trajectory, facts: Facts) -> str:
    """Return the largest utilisation of friction, or without friction the coefficient needed.

    A wheel that bears almost no load can need much more friction than the vehicle: its load is
    stated. If the forces are indeterminate, only the best distribution of them proves that friction
    is not sufficient.
    """
    used, best = facts["utilisation_largest"], facts.get("utilisation_best_largest")
    k, wheel = np.unravel_index(np.nanargmax(run["utilisation"]), run["utilisation"].shape)
    load = f", load {run['force_normal'][k, wheel]:.4g} N, t = "
    where = f"at most {used:.4g} ({used.words.replace(', t = ', load)})"
    others = "" if best is None else f"; at most {best:.4g} with the best distribution of forces"
    if "ground_friction" not in run.attributes:
        none = "no coefficient of the ground is given (terrain.friction)"
        return f"coefficient needed: {where}{others}; {none}"
    spread = ", for the forces that this motion needs"
    if run.attributes.get("model") in ("quasi-static", "dynamics"):
        sliding = 100 * (run["utilisation"] > SLIDES).any(axis=1).mean()
        words = f": a wheel slides at {sliding:.2g} % of the samples" * bool(sliding)
        spread = f" by the law {run.attributes['law']!r}{words}"
    enough = "" if used.value <= 1 else "; friction is not sufficient for this motion"
    if best is not None and best.value <= 1 < used.value:
        enough = ": friction can be sufficient"
    coefficient = run.attributes["ground_friction"]
    return (
        f"utilisation {where}, as a share of the coefficient {coefficient}{spread}{others}{enough}"
    )


def _certificate(run: Trajectory, facts: Mapping[str, Fact]) -> str:
    """Return the text of the contact certificate: whether each wheel has a single contact point.

    It begins with "clean" if this is certain at all samples, otherwise with "broken".
    """
    if UNIQUE[0] not in run:
        return "clean: the ground is a plane"
    clearance, curvature = (facts[f"{name}_least"].value for name in UNIQUE)
    clean = "clean" if min(clearance, curvature) >= 0 else "broken"
    if run.stop is not None and run.stop.name.partition("[")[0] in UNIQUE:
        clean += " up to the stop"
    room = f"clearance beside the contacts {clearance:.4g} m at least"
    room = "no other part of the ground near the wheels" if np.isinf(clearance) else room
    words = f"{clean}: {room}, relative curvature {curvature:.4g} 1/m at least"
    if run.t.size == 1:
        return words
    return f"{words}; samples at most {facts['sample_distance_largest'].value:.3g} m apart"


def model_attributes(spec: Modelled) -> dict[str, str]:
    """Return the names of the model and the law of a problem, for its result file."""
    return {"model": spec.model, "law": law_name(spec)}


def world_of(result: Result) -> World:
    """Return ground and vehicle of a result; raise DataError if they do not match the motion."""
    if result.setup is not None:
        setup: Setup = result.setup
        return setup
    world = build_world(result.problem)
    vehicle = world.vehicle
    run, names = result.trajectory, tuple(wheel.name for wheel in vehicle.wheels)
    if names != run.wheels or not {c.name for c in vehicle.coordinates} <= {*run.columns}:
        raise DataError(
            f"expected the vehicle of the motion, with wheels {', '.join(run.wheels)}, found "
            f"{vehicle.name!r} with other wheels or joints; run the problem again"
        )
    return world
