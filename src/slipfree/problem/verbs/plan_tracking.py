"""Test of a plan in a changed world: several ways to follow it, in the same disturbed worlds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import fields, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slipfree.control.path_following import commanded
from slipfree.core.errors import DataError, ModelError, check_known
from slipfree.core.facts import Fact, TableColumn, table
from slipfree.core.rearrange import substitute
from slipfree.core.records import leaves
from slipfree.core.schema import Length
from slipfree.core.trajectory import Outcome, SolverError, Trajectory, path_length
from slipfree.files.netcdf import read, read_arrays, write
from slipfree.laws.coulomb import check_friction
from slipfree.plan import tracking
from slipfree.plan.mpc import Horizon, horizon
from slipfree.plan.polynomial_motion import from_arrays
from slipfree.plan.sampling import SamplingTask
from slipfree.problem.build import World, build_model, build_start, build_world, solver_options
from slipfree.problem.inputs import ProblemParts, file_states, input_files
from slipfree.problem.result import open_result, problem_of, result_of
from slipfree.problem.verbs.base import VERB_ATTRIBUTE, Result, drive_facts
from slipfree.problem.verbs.plan import FRICTION_TOLERANCE, PlanVerb, initial_speed, start_values
from slipfree.problem.verbs.plan_search import find_plan, scaled_friction
from slipfree.problem.verbs.plan_setup import build_planning
from slipfree.solve.settle import SPEED, settle
from slipfree.system.parts import PartsWatch, study, until_interrupt
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.grid_ops import disturbed
from slipfree.vehicle.sections import Section

CYCLES_PER_WINDOW = 20  # default number of periods in a window
WINDOWS_PER_PLAN = 5  # duration of a plan divided by the default window
WAYS = ("inputs", "follow", "replan", "sampling")
DISTURBANCES = ("heights", "friction", "radii", "inputs", "latency")
COUNTS = ("cycles", "failed_cycles", "missed_periods")
MAX_RADIUS_ERROR = 0.2  # rms of relative errors: wheels of larger ones may vanish
CORRELATION = 2.0  # length of the errors of heights [size of the vehicle]
TURN_RANGE = 1.5  # largest yaw rate of candidates, relative to speed over size of the vehicle
SPEED_RANGE = (-0.25, 1.75)  # forward velocity of candidates, relative to the mean speed
SPREAD, CANDIDATES, GOAL_WEIGHT = 0.08, 512, 10.0  # of `slipfree.SamplingTask`


class Followed(NamedTuple):
    """Attempt to follow a plan in a disturbed world."""

    name: str  # of the controller
    seed: int  # of the disturbances
    words: str = ""  # the error, if any
    result: Result | None = None  # None if it does not suit the vehicle, or fails at the start
    # those of `TrackedMotion`
    cycles: int = 0
    failures: int = 0
    missed: int = 0
    cpu: tuple[float, float] = (0.0, 0.0)  # median and 99 % quantile [s]


class TrackFolder(ProblemParts[Followed]):
    """Folder with the finished motions of a test of a plan."""

    def store(self, number: int, result: Followed) -> None:
        """Store a motion, unless Ctrl-C ended it."""
        record, found = result._asdict(), result.result
        del record["result"]
        if found is None:
            self.add(number, record)
        elif found.outcome is not Outcome.INTERRUPTED:
            self.add(number, record, lambda part: write(part, found.trajectory, found.arrays))

    def load(self, number: int) -> Followed:
        """Return a stored motion."""
        file = self.file(number)
        return Followed(**self.record(number), result=open_result(file) if file.exists() else None)


class TrackingTest(NamedTuple):
    """A plan, simulated on its own ground, and the motions that follow it in disturbed worlds."""

    plan: Trajectory
    motions: tuple[Followed, ...]
    parts: TrackFolder | None  # closed

    @property
    def results(self) -> list[tuple[str, Result]]:
        """Names of controllers and results of their motions, on their disturbed grounds."""
        return [(each.name, each.result) for each in self.motions if each.result is not None]


def follow_plan(
    file: Path,
    changes: Sequence[str] = (),
    *,
    by: Sequence[str] = WAYS,
    disturb: Mapping[str, float] = {},
    seeds: int = 1,
    period: float | None = None,
    window: float | None = None,
    time: Callable[[str, int, float], None] | None = None,
    beside: Path | None = None,
    watch: PartsWatch = PartsWatch(),
) -> TrackingTest:
    """Follow the plan of a result file in changed worlds, in several ways.

    ``by`` are names of `WAYS`: the inputs of the plan; its velocities, corrected for the errors of
    place and heading; `slipfree.replan` over a moving window; and `slipfree.sample_plan` towards
    the plan at the window's end, with commands as inputs. All decide at every ``period``, from the
    states. The controllers know the plan's ground and vehicle. The settings of the world are
    ``changes``; its disturbances have the sizes ``disturb`` and the ``seeds`` 1, 2, ... By default
    a window lasts a fifth of the plan, and a period a twentieth of the window. [s]

    Disturbances are the rms of errors of the heights, correlated over twice the vehicle's size [m],
    a change of the friction, up or down at random, and standard deviations of the errors of wheel
    radii and inputs, all relative; inputs take effect after a latency, rounded to periods [s].

    After a Ctrl-C held back by `held_interrupt`, the motions are those simulated until then. A
    folder next to the output ``beside`` keeps finished motions, which are not repeated.
    ``time`` is called with the controller, the seed and the time reached. [s]

    DataError is raised if the file contains no plan or the changed problem cannot be built;
    ModelError if a name, period, window, joints or wheels do not suit the plan; SolverError if the
    first window cannot be solved, or a motion fails before its first sample.
    """
    for names, known, what in ((by, WAYS, "by"), (disturb, DISTURBANCES, "disturb")):
        check_known(what, names, known)
    for name, most in (("friction", 1.0), ("radii", MAX_RADIUS_ERROR)):
        if disturb.get(name, 0.0) >= most:
            raise ModelError(
                f"disturb: {name}: expected a relative change below {most:g}, found "
                f"{disturb[name]:g}; reduce it"
            )
    run = read(file)
    arrays = read_arrays(file)
    saved = from_arrays(arrays, str(file))
    planned, real = (problem_of(file, run, arrays, each) for each in ((), changes))
    if not isinstance(planned.spec, PlanVerb.schema):
        raise DataError(
            f"{file}: expected the result of a plan, found one with verb = {planned.spec.verb!r}; "
            "give the result of a planning problem"
        )
    if planned.spec.model == "dynamics":
        raise DataError(
            f"{file}: expected a plan without inertia, found model = 'dynamics', whose controllers "
            "are not built; give the result of a plan with model = 'kinematics' or 'quasi-static'"
        )
    setup = build_planning(planned)
    duration = saved.motion.duration
    plan = find_plan(setup, [], saved, lambda *_: True)
    window = duration / WINDOWS_PER_PLAN if window is None else window
    period = window / CYCLES_PER_WINDOW if period is None else period
    options = solver_options(real)
    if real.spec.model != "kinematics":
        options = replace(options, tolerance=max(options.tolerance, FRICTION_TOLERANCE))
    frame, dae = horizon(plan, span=window), plan.program.task.dae
    speed = path_length(plan.replay) / plan.motion.duration

    @lru_cache(1)  # all controllers of a seed follow each other
    def world_of(seed: int) -> tuple[tracking.TrackingWorld, World]:
        """Return the world of the changed problem with disturbances, and its ground and vehicle."""
        built, rng = build_world(real), np.random.default_rng(seed)
        sign, wheels = rng.choice([-1.0, 1.0]), built.vehicle.wheels
        radii = 1 + disturb.get("radii", 0.0) * rng.standard_normal(len(wheels))
        factors = 1 + disturb.get("inputs", 0.0) * rng.standard_normal(len(list(leaves(dae.u))))
        grid, mu = built.ground.grid, built.ground.mu
        if disturb.get("heights"):
            grid = disturbed(grid, disturb["heights"], CORRELATION * dae.size, seed)
        if disturb.get("friction"):
            check_friction("disturb: friction (of a quasi-static model)", built.terrain)
            mu = scaled_friction(mu, 1 + sign * disturb["friction"])
        terrain = Bicubic(grid, built.terrain.center, mu)
        pairs = zip(wheels, radii.tolist(), strict=True)
        own = tuple(replace(wheel, section=_scaled(wheel.section, k)) for wheel, k in pairs)
        model = build_model(real, replace(built.vehicle, wheels=own), terrain, built.prisms)
        u = list(leaves(model.u))
        if "inputs" in disturb:
            changed = [each * factor for each, factor in zip(u, factors, strict=True)]
            model = substitute(model, u, changed)
        start = build_start(real, model)
        if real.spec.model == "dynamics":
            values = start_values(real.spec, start) | {SPEED: initial_speed(plan.replay)}
            start = settle(model, options=options, **values)
        try:
            # the robot computes its rates with the vehicle of the plan, not with its real radii
            driven = commanded(replace(model, vehicle=dae.vehicle), speed=speed)
        except ModelError:  # the controllers report it
            driven = None
        world = tracking.TrackingWorld(model, driven, start, disturb.get("latency", 0.0))
        ground = built.ground._replace(grid=grid, mu=mu)
        return world, replace(built, ground=ground, terrain=terrain)

    def follow(method: tuple[str, int]) -> Followed:
        """Return the motion of a controller, by name, in the world of a seed."""
        name, seed = method
        world, driven_world = world_of(seed)
        report = partial(time, name, seed) if time else None
        try:
            controller = controller_of(name, frame, speed, period)
        except ModelError as error:
            return Followed(name, seed, str(error))
        try:
            tracked = tracking.track_plan(
                controller, world, duration=duration, options=options, progress=report
            )
        except SolverError as error:
            return Followed(name, seed, str(error))
        own, further = replace(setup, **vars(driven_world)), {VERB_ATTRIBUTE: "direct"}
        result = result_of(real, PlanVerb(), own, tracked.run, saved.arrays, further)
        median, late = np.quantile(tracked.seconds, (0.5, 0.99)).tolist()
        return Followed(name, seed, "", result, *tracked[1:4], (median, late))

    tasks = [(name, seed) for seed in range(1, seeds + 1) for name in by]
    with ExitStack() as stack:
        parts = None
        if beside is not None:
            states = file_states({**input_files(real), "": file})
            own = {"tasks": tasks, "disturb": dict(disturb), "period": period, "window": window}
            kind, count = "test of a plan", len(tasks)
            parts = TrackFolder(beside, kind, count, real, ".nc", states, **own)
            stack.enter_context(parts)
        run_tasks = stack.enter_context(study(follow, parts, watch=watch))
        numbers = range(1, len(tasks) + 1)
        followed = dict(until_interrupt(run_tasks(numbers, lambda number: tasks[number - 1])))
    return TrackingTest(plan.replay, tuple(followed[k] for k in sorted(followed)), parts)


def controller_of(name: str, frame: Horizon, speed: float, period: float) -> tracking.Controller:
    """Return the controller of a name in `WAYS`, for the plan of a window.

    The mean ``speed`` of the plan [m/s] is the size of its commands. ModelError is raised for
    vehicles without commands.
    """
    dae, plan = frame.program.task.dae, frame.plan
    if name in ("inputs", "replan"):
        return tracking.Replanning(frame, period=period, updated=name == "replan")
    driven = commanded(dae, speed=speed)
    if name == "follow":
        return tracking.Following(dae, plan, speed, period=period)
    (low, high), turn = SPEED_RANGE, TURN_RANGE * speed / driven.size
    ranges = {"forward": (low * speed, high * speed), "yaw_rate": (-turn, turn)}
    task = SamplingTask(driven, {"slip": 1.0}, {}, frame.span, ranges, goal_weight=GOAL_WEIGHT)
    task = replace(task, candidates=CANDIDATES, spread=SPREAD)
    return tracking.Sampling(dae, task, plan, period=period)


def _scaled(section: Section, factor: float) -> Section:
    """Return a section with all lengths multiplied by a factor."""
    values: dict[str, Any] = {}
    for field in fields(section):
        value = getattr(section, field.name)
        if isinstance(value, Section):
            values[field.name] = _scaled(value, factor)
        elif field.type in (Length, "Length"):
            values[field.name] = factor * value
    return replace(section, **values)


def tracking_rows(test: TrackingTest) -> list[dict[str, Any]]:
    """Return for the plan and each way to follow it the results over all seeds.

    Names, the number of seeds and of complete motions, median and largest distance of the end from
    the plan's [m], slip [m/s], path length [m], median and 99 % quantile of the controller's CPU
    time [s], numbers of cycles, of those without a solution and of missed periods, and messages.
    """

    def measured(run: Trajectory) -> dict[str, float]:
        facts, unknown = drive_facts(run), Fact(np.nan)
        return {name: facts.get(name, unknown).value for name in ("slip_rms", "path_length")}

    rows = [{"name": "plan", **measured(test.plan), "words": ["on its own ground"]}]
    for name in dict.fromkeys(each.name for each in test.motions):
        attempts = [each for each in test.motions if each.name == name]
        motions = [(each, each.result.trajectory) for each in attempts if each.result is not None]
        medians, totals = list[dict[str, float]](), list[dict[str, int]]()
        for each, run in motions:
            gap = float(np.hypot(*(run[axis][-1] - test.plan[axis][-1] for axis in "xy")))
            medians.append({"end_distance": gap, "cycle_cpu": each.cpu[0], **measured(run)})
            counts = dict(zip(COUNTS, (each.cycles, each.failures, each.missed), strict=True))
            totals.append({"complete": int(run.stop is None), **counts})
        row: dict[str, Any] = {"name": name, "seeds": len(attempts)}
        if motions:
            row |= {key: float(np.median([each[key] for each in medians])) for key in medians[0]}
            row |= {key: sum(each[key] for each in totals) for key in totals[0]}
            row["cycle_cpu_p99"] = max(each.cpu[1] for each, _ in motions)
            row["end_distance_max"] = max(each["end_distance"] for each in medians)
        stops = [
            f"seed {each.seed}: stopped at {run.t[-1]:.4g} s: {run.stop.words}"
            for each, run in motions
            if run.stop is not None
        ]
        errors = dict.fromkeys(each.words for each in attempts if each.words)
        rows.append({**row, "words": [*stops, *errors]})
    return rows


COLUMNS = (
    TableColumn("", "name"),
    TableColumn("complete", "complete"),
    TableColumn("end from plan [m]", "end_distance", ".3g"),
    TableColumn("largest", "end_distance_max", ".3g"),
    TableColumn("rms slip [mm/s]", "slip_rms", ".3g", "mm/s"),
    TableColumn("path [m]", "path_length", ".4g"),
    TableColumn("cycles failed", "failed"),
    TableColumn("periods missed", "missed"),
    TableColumn("CPU p50 [ms]", "cycle_cpu", ".3g", "ms"),
    TableColumn("p99", "cycle_cpu_p99", ".3g", "ms"),
)


def tracking_lines(rows: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield the lines of the table of `tracking_rows`, and the messages below it."""
    shares = {
        "complete": "{complete} of {seeds}",
        "failed": "{failed_cycles} of {cycles}",
        "missed": "{missed_periods} of {cycles}",
    }
    texts = [
        {key: text.format_map(row) for key, text in shares.items() if "complete" in row}
        for row in rows
    ]
    yield from table(COLUMNS, [{**row, **more} for row, more in zip(rows, texts, strict=True)])
    for row in rows:
        for words in row["words"]:
            yield f"{row['name']}: {words}"
