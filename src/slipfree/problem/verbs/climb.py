"""Climbs of a vehicle with two bodies over an obstacle, in a vertical plane."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import groupby
from math import degrees, isfinite, sqrt
from typing import TYPE_CHECKING, Any

import numpy as np

from slipfree.catalog.step_climber import step_climber
from slipfree.climb.dynamics import climbing, floor_loads, held_torques, prisms, standing
from slipfree.climb.friction_demand import least_friction
from slipfree.climb.metrics import climb_window, metrics
from slipfree.climb.plan_tracking import Tracking, tracked_plan
from slipfree.control.sensor_noise import Noise
from slipfree.control.step_climbing import Control, check_period
from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.files.netcdf import NOTHING
from slipfree.files.tables import read_columns
from slipfree.files.toml.source import Fault, Place, problem_error
from slipfree.laws.compliant import Compliant
from slipfree.models.obstacle_ending import obstacle_ending
from slipfree.problem.build_common import SampledTimes, sampled_times, samples
from slipfree.problem.build_ground import at
from slipfree.problem.build_solids import OBSTACLES
from slipfree.problem.problem import Problem
from slipfree.problem.summary import Facts
from slipfree.problem.verbs import climb_schema
from slipfree.problem.verbs.base import (
    ANIMATION,
    Extremes,
    MotionVerb,
    Quantity,
    Result,
    Solution,
    Viewer,
    Watch,
    integrate,
    largest_tilt,
    with_diagnostics,
)
from slipfree.problem.verbs.climb_plan import (
    Planned,
    arrays_of,
    plan_climb,
    plan_of,
    plan_statistics,
    poses_of_plan,
)
from slipfree.problem.verbs.climb_summary import ENDING, SLOW_CLIMB, climb_facts
from slipfree.records import Array
from slipfree.solve.settle import settle
from slipfree.terrain.solids import Profile, Solid
from slipfree.trajectory import SolverError, Trajectory
from slipfree.vehicle.climber import AXLES, Climber, side_view
from slipfree.vehicle.tree import GRAVITY

if TYPE_CHECKING:
    from slipfree.plan.warm_start import SavedPlan
    from slipfree.show.drive_scene import Driven
    from slipfree.show.plots import Plot

SLACK = 1e-5  # largest distance of wheels from their equilibrium on the floor [m]
SUNK = 2e-3  # largest depth of contacts at rest, so that the end of a climb is recognised [m]
MEASURES = ("slip", "true_slip", "disturbance", "effort", "bearing")
EXTREMES = Extremes(
    end=("y", "z", "tilt_rear", "tilt_front"),
    largest=("motor_torque", "power"),
    gained=("work", "lost_energy", "energy"),
)
MEANS = ("climb_slip", "climb_true_slip", "climb_disturbance")


@dataclass(frozen=True, eq=False)
class Climbing:
    """Set-up of the simulation of a climb.

    Attributes
    ----------
    climber, profile : Climber, Profile
        Vehicle and ground.
    control : Control or Tracking
        Controller of the wheels.
    dae : Dae
        Dynamic model of the climb.
    start : Trajectory
        One sample: the vehicle on the floor, in front of the obstacle.
    inputs : record
        Reference speed of the vehicle, and torque laws of a sampled controller.
    t : ndarray, shape (n,)
        Times of the samples. [s]
    every : int
        Number of controller steps per sample of the result; zero for continuous control.
    facts : Facts
        Facts about ground, vehicle and control: pairs of name and text.
    plan : Trajectory or None
        Plan to track; None without a plan.
    """

    climber: Climber
    profile: Profile
    control: Control | Tracking
    dae: Dae
    start: Trajectory
    inputs: Any
    t: Array
    every: int
    facts: Facts
    plan: Trajectory | None = None


class ClimbVerb(MotionVerb):
    """Climb of a vehicle with two bodies over an obstacle, in a vertical plane."""

    schema = climb_schema.Climb
    options = (ANIMATION,)
    checks = ("energy", "slow climb", "integrator")
    metrics_shown = ("climb_up", "climb_true_slip", "climb_limited")

    def build(self, problem: Problem[climb_schema.Climb]) -> Climbing:
        """Return the model, the start and the inputs of a problem.

        Raises
        ------
        ProblemError
            If obstacle, vehicle, contact law or control are not valid, keys contradict each other,
            or the vehicle cannot stand on the floor in front of the obstacle.
        """
        spec = problem.spec
        profile = _profile(problem)
        with at(problem, ("vehicle",)):
            climber = _climber(spec)
        with at(problem, ("control",)):
            options = spec.control.model_dump(exclude={"speed", "period", "noise"})
            noise = spec.control.noise
            control = Control(**options, noise=None if noise is None else Noise(**dict(noise)))
        if spec.plan is not None:
            _check_tracking(problem)
        times = _times(problem, control, climber)
        dae = _model(problem, climber, profile, control)
        start = _start(problem, dae, climber, profile)
        held = {} if spec.control.period is None else held_torques(climber, dae)
        inputs = dae.inputs(speed=spec.control.speed, **held)
        return Climbing(
            climber,
            profile,
            control,
            dae,
            start,
            inputs,
            *times,
            _facts(spec, climber, control),
        )

    def solve(
        self,
        problem: Problem[climb_schema.Climb],
        setup: Climbing,
        watch: Watch,
        resume: SavedPlan | None,
    ) -> Solution:
        """Return the motion of a climb, which tracks a plan if the problem has a table ``plan``.

        Raises
        ------
        ProblemError
            If a plan is not possible, for example because the vehicle gets stuck.
        SolverError
            If no plan is found, or the integrator fails before the first sample.
        """
        spec, arrays = problem.spec, NOTHING
        if spec.plan is not None:
            with at(problem, ("plan",)):
                plan = plan_climb(
                    setup.climber,
                    setup.profile,
                    spec.plan,
                    spec.friction.static,
                    spec.control.speed,
                )
            setup = _tracking(problem, setup, plan)
            arrays = arrays_of(plan.run)
        run = _judged(integrate(setup, spec.solver.options, watch), setup)
        if spec.plan is not None:
            run = replace(run, statistics={**run.statistics, **plan_statistics(plan, run)})
        run = with_diagnostics(
            run,
            {SLOW_CLIMB: partial(_with_slow_climb, setup)},
            lambda run: watch.keep(Solution(run, setup, arrays)),
        )
        return Solution(run, setup, arrays)

    def describe_start(
        self, problem: Problem[climb_schema.Climb], setup: Climbing
    ) -> tuple[Trajectory, Facts]:
        """Return the start, and facts about the start and the samples."""
        start = setup.start
        place = ", ".join(f"{name} {start[name][0]:.6g}" for name in ("y", "z", "velocity_y"))
        samples = f"{setup.t.size} to {setup.t[-1]:g} s"
        return start, [("start", f"{place} (m, m/s)"), ("samples", samples)]

    def facts(self, run: Trajectory) -> Facts:
        """Return the facts of the summary of a climb, pairs of name and text."""
        return [*climb_facts(run)]

    def metrics(self, run: Trajectory, spec: climb_schema.Climb) -> dict[str, Quantity]:
        """Return last values, extremes, and means over the axles of a climb, by name."""
        found = EXTREMES.of(run) | largest_tilt(run)
        for mean in MEANS:
            names = [f"{mean}_{axle}" for axle in run.wheels]
            parts = [run.statistics[name] for name in names if name in run.statistics]
            if parts:
                found[mean] = Quantity(float(np.mean(parts)), "1")
        return found

    def describe_end(self, run: Trajectory) -> str:
        """Return the description of the end of a climb."""
        return run.attributes[ENDING]

    def figures(self, result: Result) -> tuple[Plot, ...]:
        """Return the figures of a climb, the most important first; errors are those of `shown`."""
        from slipfree.show.climb_figures import climb_plots

        climber, profile = _vehicle_and_ground(result)
        plan = plan_of(result.trajectory, result.arrays)
        return climb_plots(result.trajectory, climber, profile, plan)

    def viewer(self) -> Viewer:
        """Return the function that builds the scene of climbs, for the viewer."""
        from slipfree.show.climb_scene import climb_scene

        return Viewer("climbs", climb_scene)

    def shown(self, result: Result, name: str) -> Driven:
        """Return the motion of a result with ground and vehicle, as input of the viewer.

        Raises
        ------
        DataError
            If the result is from a file without problem, or input files are missing.
        """
        from slipfree.show.climb_scene import in_space

        climber, profile = _vehicle_and_ground(result)
        plan = poses_of_plan(result.trajectory, result.arrays, climber)
        return in_space(name, result.trajectory, climber, profile, plan)


def _vehicle_and_ground(result: Result) -> tuple[Climber, Profile]:
    """Return vehicle and ground of a result, from its set-up if present, or from its problem.

    Raises
    ------
    DataError
        If the result is from a file without problem, or input files are missing.
    """
    if result.setup is not None:
        return result.setup.climber, result.setup.profile
    problem = result.problem
    with at(problem, ("vehicle",)):
        return _climber(problem.spec), _profile(problem)


def _check_tracking(problem: Problem[climb_schema.Climb]) -> None:
    """Raise ProblemError for control keys or a friction that the tracking of a plan cannot use."""
    spec = problem.spec
    given = spec.control.model_dump(exclude_unset=True, exclude={"speed", "proportional"})
    words = "only the keys 'speed' and 'proportional' in [control] with a [plan]"
    faults = [Fault(("control", name), words, f"{name!r}; remove it") for name in given]
    mu = spec.plan.friction if spec.plan else None
    if mu is not None and mu > spec.friction.static:
        expected = f"at most friction.static, {spec.friction.static:g}"
        found = f"{mu:g}; reduce it, or increase friction.static"
        faults.append(Fault(("plan", "friction"), expected, found))
    if faults:
        raise problem_error(problem.source, faults)


def _times(
    problem: Problem[climb_schema.Climb], control: Control, climber: Climber
) -> SampledTimes:
    """Return the times of the computation: of the samples, or of a sampled controller.

    Raises
    ------
    ProblemError
        If the period of the controller is too large, does not divide the time between samples, or
        the integrator cannot be used with it.
    """
    period, time = problem.spec.control.period, problem.spec.time
    if period is None:
        return SampledTimes(samples(time, {})[0], 0)
    with at(problem, ("control", "period")):
        check_period(period, control, climber)
    if problem.spec.solver.method == "idas":
        expected, found = "'cvodes' for a sampled controller", "'idas'; change it"
        fault = Fault(("solver", "method"), expected, found)
        raise problem_error(problem.source, [fault])
    return sampled_times(problem, ("control", "period"), period)


def _profile(problem: Problem[climb_schema.Climb]) -> Profile:
    """Return the ground of a climb.

    Raises
    ------
    ProblemError
        If an obstacle, a polygon or the file is not valid, with the line of its key.
    """
    spec = problem.spec.profile
    for name, make in OBSTACLES.items():
        given = getattr(spec, name)
        if given is not None:
            with at(problem, ("profile", name)):
                return make(**dict(given))
    if spec.file is not None:
        with at(problem, ("profile", "file")):
            return Profile(_from_file(problem, spec.file))
    solids = []
    for k, each in enumerate(spec.solids or ()):
        with at(problem, ("profile", "solids", k)):
            solids.append(Solid(each.points))
    with at(problem, ("profile", "solids")):
        return Profile(tuple(solids))


def _from_file(problem: Problem[climb_schema.Climb], name: str) -> tuple[Solid, ...]:
    """Return the polygons of a CSV file with the columns solid, x, z and corners in order.

    Raises
    ------
    ModelError
        If the corners of a solid are not in consecutive rows or not those of a convex polygon.
    DataError
        If the file cannot be read.
    """
    columns = read_columns(problem.folder / name, ("solid", "x", "z"), "corners of solids")
    rows = columns.rows()
    found: list[Solid] = []
    numbers = [number for number, _ in groupby(row[0] for row in rows)]
    for number in numbers:
        if numbers.count(number) > 1:
            raise ModelError(
                f"{name}: solid {number:g}: expected its corners in consecutive rows, "
                "found rows of another solid between them; sort the rows"
            )
    for number, corners in groupby(rows, key=lambda row: row[0]):
        try:
            found.append(Solid(tuple((x, z) for _, x, z in corners)))
        except ModelError as error:
            raise ModelError(f"{name}: solid {number:g}: {error}") from error
    return tuple(found)


def _climber(spec: climb_schema.Climb) -> Climber:
    """Return the vehicle of the catalogue, with the numbers that the problem gives."""
    given = spec.vehicle
    plain = step_climber(given.joint, given.torque)
    parts = {
        name: getattr(plain, name)._replace(**getattr(given, name).model_dump(exclude_none=True))
        for name in ("rear_body", "front_body", *AXLES)
    }
    radius = given.radius or plain.radius
    return replace(plain, radius=radius, stiffness=spec.contact.stiffness, **parts)


def _model(
    problem: Problem[climb_schema.Climb],
    climber: Climber,
    profile: Profile,
    control: Control | Tracking,
) -> Dae:
    """Return the dynamic model of a climb.

    Raises
    ------
    ProblemError
        If the kinetic friction exceeds the static friction, or a number of the law is out of range.
    """
    friction, numbers = problem.spec.friction, problem.spec.contact
    if friction.kinetic > friction.static:
        expected = f"at most friction.static, {friction.static:g}"
        found = f"{friction.kinetic:g}; reduce it"
        raise problem_error(problem.source, [Fault(("friction", "kinetic"), expected, found)])
    with at(problem, ("contact",)):
        law = Compliant(
            damping_ratio=numbers.damping * sqrt(GRAVITY * climber.static_depth) / 2,
            creep=numbers.creep,
            sliding=friction.kinetic / friction.static,
            stribeck_speed=numbers.stribeck,
        )
    period = problem.spec.control.period
    return climbing(climber, profile, control, law, friction=friction.static, period=period)


def _start(
    problem: Problem[climb_schema.Climb],
    dae: Dae,
    climber: Climber,
    profile: Profile,
) -> Trajectory:
    """Return the vehicle on the floor, its front wheels at the given distance from the obstacle.

    Raises
    ------
    ProblemError
        If no obstacle can be touched, wheels are inside a solid or not on the floor, or the
        contacts are too soft.
    """
    spec = problem.spec.start
    sunk = _sunk(problem, climber)
    with at(problem, ("profile",)):
        front = _first_contact(climber, profile) - spec.distance
    speed = problem.spec.control.speed if spec.speed is None else spec.speed
    with at(problem, ("start",)):
        start = settle(
            dae,
            guess=None,
            options=problem.spec.solver.options,
            **standing(climber, front, speed),
        )
    faults = [
        fault
        for k in range(len(profile.solids))
        if (fault := _misplaced(start, k, sunk, spec.distance)) is not None
    ]
    if faults:
        raise problem_error(problem.source, faults)
    return start


def _sunk(problem: Problem[climb_schema.Climb], climber: Climber) -> Array:
    """Return the depths to which wheels at rest sink into a level floor, by axle [m].

    Raises
    ------
    ProblemError
        If an axle bears no load, or the contacts are too soft.
    """
    loads, faults = floor_loads(climber), []
    softest = float(loads.max()) / SUNK
    if not (loads > 0).all():
        axle = int(loads.argmin())
        faults.append(
            Fault(
                ("vehicle",),
                "centres of mass such that all axles bear load on a level floor",
                f"{loads[axle]:.3g} N on the {AXLES[axle]} axle; move the centres of mass",
            )
        )
    elif climber.stiffness < softest:
        expected = (
            f"at least {softest:.3g} N/m, so that wheels sink in by at most {1e3 * SUNK:g} mm"
        )
        found = f"{climber.stiffness:g}; increase it"
        faults.append(Fault(("contact", "stiffness"), expected, found))
    if faults:
        raise problem_error(problem.source, faults)
    return loads / climber.stiffness


def _first_contact(climber: Climber, profile: Profile) -> float:
    """Return x of the front axle where its wheels first touch an obstacle [m].

    The distance from a convex solid along a line is convex, so that it decreases to zero once.

    Raises
    ------
    ModelError
        If wheels on the floor can touch no solid.
    """
    from scipy.optimize import brentq, minimize_scalar  # imported here: the import takes 0.2 s

    radius, found = climber.radius, []
    for solid in profile.solids[1:]:

        def gap(x: float, solid: Solid = solid) -> float:
            return float(solid.distance(x, radius)[0]) - radius

        places = [x for x, _ in solid.points]
        ends = min(places) - 2 * radius, max(places) + 2 * radius
        nearest = float(minimize_scalar(gap, bounds=ends, method="bounded").x)
        if gap(nearest) < 0:
            found.append(float(brentq(gap, ends[0], nearest)))
    if not found:
        raise ModelError(
            "profile: expected a solid that wheels on the floor (the first solid, level at height "
            f"0) can touch, found none among the {len(profile.solids) - 1} others; move a solid, "
            "or add one"
        )
    return min(found)


def _misplaced(start: Trajectory, k: int, sunk: Array, distance: float) -> Fault | None:
    """Return the error for wheels inside solid k, or not on the floor (k = 0).

    The result is None if the wheels are placed correctly. ``sunk`` are the depths of the axles'
    wheels at rest, shape (3,) [m].
    """
    gap = start[f"solid_gap_{k + 1}"][0]
    off = gap + sunk
    wrong = np.abs(off) > SLACK if k == 0 else off < -SLACK
    if not wrong.any():
        return None
    axle = int(np.flatnonzero(wrong)[-1])  # report the front wheels first
    wheels = f"the {AXLES[axle]} wheels, at x = {start['center_y'][0, axle]:.4g} m,"
    if k == 0:
        side = "above it" if off[axle] > 0 else "inside it"
        place: Place = ("profile",)
        return Fault(
            place,
            "a floor as first solid, level and at height 0 under the vehicle",
            f"{wheels} {1e3 * abs(off[axle]):.3g} mm {side}; extend or level the first solid",
        )
    inside = f"{wheels} {-1e3 * gap[axle]:.3g} mm inside solid {k}"
    if AXLES[axle] == "front":
        return Fault(
            ("start", "distance"),
            "at least 0 m, so that the vehicle starts outside all solids",
            f"{distance:g} m: {inside}; increase the distance",
        )
    remedy = "move the solid"
    return Fault(("start",), "a vehicle that starts outside all solids", f"{inside}; {remedy}")


def _tracking(problem: Problem[climb_schema.Climb], setup: Climbing, plan: Planned) -> Climbing:
    """Return the set-up of a climb with the controller that tracks a plan."""
    given = problem.spec.control.model_dump(exclude_unset=True, include={"proportional"})
    with at(problem, ("plan",)):
        control = Tracking(tracked_plan(plan.parts), **given)
    dae = _model(problem, setup.climber, setup.profile, control)
    start = _start(problem, dae, setup.climber, setup.profile)
    inputs = dae.inputs(speed=problem.spec.control.speed)
    return replace(setup, control=control, dae=dae, start=start, inputs=inputs, plan=plan.run)


def _judged(run: Trajectory, setup: Climbing) -> Trajectory:
    """Return a motion with the description of its end and averages.

    The samples are reduced to those of the result if a sampled controller has more steps.
    """
    end = obstacle_ending(run, side_view(setup.climber), prisms(setup.profile))
    statistics = {**run.statistics, **_averages(run, setup)}
    attributes = {**run.attributes, ENDING: str(end)}
    run = run.part(slice(0, None, setup.every or 1), run.stop)
    return replace(run, statistics=statistics, attributes=attributes)


def _with_slow_climb(setup: Climbing, run: Trajectory) -> Trajectory:
    """Return a motion with the friction that a quasi-static climb needs, and its description."""
    statistics, words = _slow(setup)
    return replace(
        run,
        statistics={**run.statistics, **statistics},
        attributes={**run.attributes, SLOW_CLIMB: words},
    )


def _averages(run: Trajectory, setup: Climbing) -> dict[str, float]:
    """Return averages over the climb by name; empty if the wheels do not touch an obstacle."""
    try:
        window = climb_window(run, setup.climber, setup.profile)
    except ModelError:
        return {}
    found = metrics(run, setup.climber, setup.profile)
    ends = run.t[window.span][[0, -1]]
    values = {
        "climb_from": float(ends[0]),
        "climb_to": float(ends[1]),
        "climb_up": float(window.climbed),
        "climb_limited": found.limited,
    }
    for measure in MEASURES:
        for axle, value in zip(AXLES, getattr(found, measure), strict=True):
            values[f"climb_{measure}_{axle}"] = float(value)
    return values


def _slow(setup: Climbing) -> tuple[dict[str, float], str]:
    """Return the friction that a quasi-static climb needs, as a statistic, and its description.

    Without a result, the description is the reason.
    """
    try:
        need = least_friction(setup.climber, setup.profile)
    except (ModelError, SolverError) as error:
        return {}, str(error)
    if not isfinite(need.mu):
        return {}, f"no contact forces hold the vehicle where the {need.axle} wheels climb"
    where = f"where the {need.axle} wheels climb"
    tilts = ", ".join(
        f"{name} body {round(degrees(tilt))}"
        for name, tilt in zip(("rear", "front"), need.q[2:], strict=True)
    )
    words = (
        f"needs a coefficient of {need.mu:.3f}, {where} ({tilts} degrees nose-up), with the "
        "best distribution of forces"
    )
    return {"slow_climb_friction": need.mu}, words


def _facts(spec: climb_schema.Climb, climber: Climber, control: Control) -> Facts:
    """Return the facts about ground, vehicle and laws of a climb."""
    axles = ", ".join(
        f"{name} {axle.wheels} x {climber.radius:g} m at {axle.ahead + 0:g} m"
        for name, axle in zip(AXLES, climber.axles, strict=True)
    )
    contact = spec.contact
    limit = f"{climber.torque:g} N m per wheel" if isfinite(climber.torque) else "no torque limit"
    return [
        ("profile", _profile_words(spec.profile)),
        ("vehicle", f"{spec.vehicle.catalog}: wheels {axles} ahead of the joint"),
        (
            "mass",
            f"rear body {climber.rear_body.mass:g} kg, front body {climber.front_body.mass:g} kg",
        ),
        ("motors", limit),
        (
            "friction",
            f"{spec.friction.static:g} at rest, {spec.friction.kinetic:g} at speed; full at a "
            f"slip of {contact.creep:g} m/s",
        ),
        ("contact", f"stiffness {contact.stiffness:g} N/m, damping {contact.damping:g} s/m"),
        ("control", _control_words(spec, control)),
    ]


def _control_words(spec: climb_schema.Climb, control: Control) -> str:
    if spec.plan is not None:
        allowed = "" if spec.plan.friction is None else f", friction {spec.plan.friction:g}"
        return f"tracks torques and rates of a plan of least {spec.plan.cost}{allowed}"
    used = "" if control.law == "fixed" else f", directions from {control.directions}"
    used += f", times {control.share:g}" if used and control.share != 1 else ""
    rhythm = "continuous" if spec.control.period is None else f"every {spec.control.period:g} s"
    return (
        f"{control.law} references for {spec.control.speed:g} m/s{used}; gains "
        f"{control.proportional:g} N m s/rad, {control.integral:g} N m/rad, "
        f"{control.derivative:g} N m s2/rad; {rhythm}"
    )


def _profile_words(spec: climb_schema.Profile) -> str:
    if spec.ramp is not None:
        return f"ramp of {degrees(spec.ramp.angle):.4g} degrees, {spec.ramp.height:g} m high"
    if spec.step is not None:
        return f"step, {spec.step.height:g} m high"
    if spec.kerb is not None:
        return f"kerb, {spec.kerb.height:g} m high, {spec.kerb.length:g} m long"
    if spec.stairs is not None:
        steps = spec.stairs
        return f"{steps.count} steps, {steps.height:g} m high, {steps.depth:g} m deep"
    if spec.file is not None:
        return f"convex solids of {spec.file}"
    return f"{len(spec.solids or ())} convex solids"
