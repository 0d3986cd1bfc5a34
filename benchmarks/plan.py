"""Plans: slip by driving method, moving horizon, starts, windows, momentum, robust plans.

``python benchmarks plan [PART ...]``:

slip       a rigid-axle three-wheeler on the hills of the tests, from (0, 0, 0) to (0.6, 2.6) in
           20 s, by several driving methods. Plans are simulated, interval by interval, with ten
           samples each; slip is the root mean square over time and wheels, or its path divided by
           that of the platform. In the quasi-static model the same inputs, or the same law, drive
           the vehicle.
horizon    the same task with a moving horizon of 20 intervals, from the start of a plan of 50
           intervals and from beside it
worlds     the same in 40 worlds with errors of the ground (2 cm rms), lost wheel rates (up to 10 %)
           and noise of the measured states (1 cm, 0.01 rad), by one step per cycle and by IPOPT
hills      best of four starts against one, ten seeds: the ground of plan_rigid_hills, twice as
           rough and with a farther goal
obstacles  the same over 20 m of hills with eight keep-out discs, where the additional starts are
           routes of other homotopy classes
windows    plan_long_dem with goals 0.4, 1.3 and 3.5 km away, each in a separate process, and the
           driving law along the same routes
momentum   over a bump on a slope with `rigid_dynamics`, simulated by `dynamics` on compliant
           contacts: a car with four torque drives over a ridge; a skid-steered cart over a bump
           beside its path, with wheels that roll, then slide (decreasing creep speeds)
goals      the shipped plans from hand-made guesses, from guesses that are found (without driver,
           duration and search options), and with ground, vehicle, start, goal and costs alone
scenes     own scenes with goal and costs alone (plan_scenes.toml), and for those without a plan
           whether a grid of poses connects start and goal
times      the command `slipfree run` on the shipped plans: CPU time, and the part inside IPOPT
robust     plan_crater_field, with a limit of the utilisation, and plan_climb_ramp, in worlds with
           errors of heights, friction and inputs: 50 draws a round tighten the limits, and 200
           other draws give the shares on which a plan holds

Slip of the parts from ``hills`` to ``windows`` is the slip path in the simulation, per wheel and
metre driven.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from common import HERE, PROBLEMS, apart, run_parts

from helpers.cases import BOUNDED_RATES, hills
from slipfree import (
    Analytic,
    Bicubic,
    Coulomb,
    Grid,
    LinearCreep,
    Mesh,
    Path,
    Search,
    SlipfreeError,
    SolverOptions,
    Torque,
    Vehicle,
    catalog,
    direct_kinematics,
    follow,
    load_problem,
    quasi_statics,
    rigid_dynamics,
    run_problem,
    settle,
    simulate,
)
from slipfree.catalog import three_wheeler
from slipfree.core.rearrange import substitute
from slipfree.core.records import leaves
from slipfree.core.trajectory import Trajectory, path_length
from slipfree.laws.protocols import GroundLaw
from slipfree.models.rigid_dynamics import dynamic_guess
from slipfree.plan.mpc import Horizon, horizon
from slipfree.plan.plan import Plan, plan
from slipfree.plan.tracking import Decision, Replanning, TrackingWorld, track_plan
from slipfree.plan.verification import simulate_plan
from slipfree.problem.build import build_world
from slipfree.problem.result import motion_facts
from slipfree.problem.verbs.base import Watch, integrate
from slipfree.problem.verbs.plan_setup import places_of, regions
from slipfree.routing.search import separation_words
from slipfree.routing.traversability import traversability
from slipfree.terrain.grid_ops import disturbed

GOAL, DURATION = (0.6, 2.6), 20.0  # [m], [s]
STEER = {"steer": (-1.0, 1.0)}  # [rad]
WEIGHTS, SMOOTH = {"slip": 7e4, "effort": 0.01}, 0.002
STARTS = ((0.45, 0.45), (0.3, 0.3), (0.47, 0.43))  # rates of the guess, right and left [rad/s]
INTERVALS, DEGREE, SAMPLES = 40, 3, 10
MU, CREEP = 0.6, 1e-4  # [1], [m/s]
TOLERANCE = 1e-8  # [m, rad]
FRICTION_TOLERANCE = 1e-6  # at less, the integrator finds no start after some jumps of the inputs


Drive = Callable[[Any, Trajectory, float], Trajectory]  # model, start, tolerance


class Row(NamedTuple):
    """Driving method: a law of a model and its start, and the cost of finding it."""

    words: str
    drive: Drive
    found: Plan | None
    seconds: float


def planned(
    terrain: Any, *, rates: tuple[float, float] = STARTS[0], compiled: bool = False, **options: Any
) -> tuple[Plan, float]:
    """Return the plan of the task on a ground, and its wall time [s].

    Inputs are constant on every interval by default, as in the prototype.
    """
    dae = direct_kinematics(three_wheeler(axle="fixed"), terrain)
    solver = SolverOptions(compiled=compiled)
    start = settle(dae, options=solver)
    inputs = dae.inputs(right_rate=rates[0], left_rate=rates[1], steer_rate=0.0)
    guess = simulate(dae, start, inputs, np.linspace(0, DURATION, 61), options=solver)
    given = {"costs": WEIGHTS, "smooth": SMOOTH, "mesh": Mesh(INTERVALS, DEGREE, continuous=False)}
    begin = time.perf_counter()
    found = plan(
        dae,
        start,
        guess,
        goal=dict(zip("xy", GOAL, strict=True)),
        duration=DURATION,
        inputs=BOUNDED_RATES,
        limits=STEER,
        options=solver,
        **(given | options),
    )
    return found, time.perf_counter() - begin


def rms_slip(run: Trajectory) -> float:
    """Return the root mean square of the slip over time and wheels. [m/s]."""
    squares = run["slip_along"] ** 2 + run["slip_across"] ** 2
    return float(np.sqrt(np.trapezoid(squares.mean(axis=1), run.t) / np.ptp(run.t)))


def rows() -> list[Row]:
    """Return all driving methods."""
    ground = Analytic(hills)
    found = [
        (f"least slip, from {right}/{left} rad/s", *planned(ground, rates=(right, left)))
        for right, left in STARTS
    ]
    found.append(("rates continuous", *planned(ground, mesh=Mesh(INTERVALS, DEGREE))))
    found.append(("effort only", *planned(ground, costs={"effort": WEIGHTS["effort"]})))
    found.append(("plan for flat ground", *planned(Analytic(lambda x, _: 2 + 0 * x))))
    ways = (Row(words, by_plan(best), best, seconds) for words, best, seconds in found)
    return [*ways, Row("follow, straight line", followed, None, np.nan)]


def by_plan(found: Plan) -> Drive:
    """Return the driving method that replays a plan."""
    step = DURATION / INTERVALS / SAMPLES
    return lambda dae, start, tolerance: simulate_plan(
        dae, start, found.motion, step=step, options=SolverOptions(tolerance=tolerance)
    )


def followed(dae: Any, start: Trajectory, tolerance: float) -> Trajectory:
    """Return the motion by the driving law along the straight line to the goal."""
    line = Path(np.array([(0.0, 0.0), GOAL]))
    law = follow(dae, line, speed=line.length / DURATION)
    t = np.linspace(0, DURATION, INTERVALS * SAMPLES + 1)
    return simulate(dae, start, law, t, options=SolverOptions(tolerance=tolerance))


def by_friction(drive: Drive, creep: float) -> tuple[float, str]:
    """Return the rms slip of a driving method with friction [m/s], and its stop reason."""
    vehicle, ground = three_wheeler(axle="fixed"), Analytic(hills, mu=MU)
    dae = quasi_statics(vehicle, ground, law=Coulomb(creep))
    try:
        run = drive(dae, settle(dae), FRICTION_TOLERANCE)
    except SlipfreeError as error:
        return np.nan, str(error)
    if run.stop is not None:
        return np.nan, f"ends at {run.t[-1]:.2f} s: {run.stop.name}"
    return rms_slip(run), ""


def slip_table() -> None:
    """Print the slip of all driving methods."""
    dae = direct_kinematics(three_wheeler(axle="fixed"), Analytic(hills))
    start, ways = settle(dae), rows()
    print(f"least slip, {INTERVALS} intervals, degree {DEGREE}; traction: mu {MU}, creep {CREEP:g}")
    print(f"{'':33}rms slip  sliding  int u2   from goal  itera-  seconds    rms slip [m/s]")
    print(f"{'':33}[m/s]     [mm/m]   [1/s]    [mm]       tions   all/IPOPT  by traction")
    slips = np.zeros((len(ways), 2))
    for k, way in enumerate(ways):
        run = way.drive(dae, start, TOLERANCE)
        effort = np.trapezoid(sum(run[name] ** 2 for name in BOUNDED_RATES), run.t)
        away = 1e3 * np.hypot(run["x"][-1] - GOAL[0], run["y"][-1] - GOAL[1])
        slips[k, 0], (slips[k, 1], why) = rms_slip(run), by_friction(way.drive, CREEP)
        print(
            f"{way.words:33}{slips[k, 0]:.2e}  {slip_path(run):7.3f}  {effort:6.2f}  "
            f"{away:10.4f}  {cost(way)}  {why or format(slips[k, 1], '.2e')}"
        )
    ratios = slips[-1] / slips[0]
    print(
        f"follow slips {ratios[0]:.1f} times as much as the plan where slip is least, "
        f"{ratios[1]:.1f} times by traction"
    )


def cost(way: Row) -> str:
    """Return the cost of finding a driving method."""
    if way.found is None:
        return f"{'-':>6}  {'-':>9}"
    count = sum(stage.iterations for stage in way.found.stages)
    search = sum(stage.seconds["total"] for stage in way.found.stages)
    mark = "" if way.found.success else f" {way.found.stages[-1].status}"
    return f"{count:6}  {way.seconds:4.1f}/{search:4.1f}{mark}"


# Moving horizon

SPAN, WINDOW, PERIOD = 8.0, 20, 0.4  # of the window, and between cycles [s]
ASIDE = ({}, {"x": 0.03, "y": -0.03, "heading": 0.02}, {"x": -0.03, "heading": -0.03})
DRIVEN, WRONG, LOST, NOISE = 40, 0.02, 0.1, 0.01  # heights [m]; share of rates; states [m, rad]
AXIS = np.arange(-3.0, 5.01, 0.25)
GRID = Grid(AXIS, AXIS, Analytic(hills).elevation(*np.meshgrid(AXIS, AXIS, indexing="ij")))
HEADER = f"""{"":49}  rms slip   largest from goal violation    missed  failures   CPU p50   CPU p99
{"":49}     [m/s]     [m/s]      [mm]             [periods]            [ms/cycle]"""


class Measuring(Replanning):
    """Replanning from states with noise, which keeps the violations."""

    def __init__(self, window: Horizon, noise: float, seed: int) -> None:
        super().__init__(window, period=PERIOD)
        self.rng, self.noise, self.violations = np.random.default_rng(seed), noise, []

    def _decide(self, t: float, end: float, x: np.ndarray) -> Decision:
        decision = super()._decide(t, end, x + self.noise * self.rng.standard_normal(x.size))
        self.violations.append(self._cycle.violation)
        return decision


def drive(window: Horizon, world: Any, start: dict, noise: float = 0.0, seed: int = 0) -> list:
    """Return slip [m/s], distance from the goal [mm], violation, misses, failures, times [ms]."""
    controller = Measuring(window, noise, seed)
    place = TrackingWorld(world, None, settle(world, **start))
    tracked = track_plan(controller, place, duration=DURATION)
    away = np.hypot(tracked.run["x"][-1] - GOAL[0], tracked.run["y"][-1] - GOAL[1])
    counts = max(controller.violations), tracked.missed, tracked.failures
    return [rms_slip(tracked.run), 1e3 * away, *counts, 1e3 * tracked.seconds]


def report(words: str, motions: list[list]) -> None:
    """Print the median and the largest slip of motions, and the sums of what went wrong."""
    slip, away, violation, *counts = np.array([each[:-1] for each in motions], dtype=float).T
    times = np.quantile(np.concatenate([each[-1] for each in motions]), (0.5, 0.99))
    numbers = np.median(slip), slip.max(), np.median(away), violation.max(), *map(sum, counts)
    print(f"{words:49}", *(f"{number:9.3g}" for number in (*numbers, *times)), flush=True)


def moving_horizon() -> None:
    """Print slip and times of motions with a moving horizon."""
    found, _ = planned(Analytic(hills), mesh=Mesh(50), compiled=True)
    print(HEADER)
    for start in ASIDE:
        where = ", ".join(f"{name} {value:+g}" for name, value in start.items()) or "on the plan"
        for words, steps in (("one step", 1), ("to convergence", 100)):
            window = horizon(found, span=SPAN, intervals=WINDOW, iterations=steps)
            report(f"{where}: {words}", [drive(window, found.program.task.dae, start)])


def worlds() -> None:
    """Print slip, misses and violations of replanning in worlds that the plan does not know."""
    found, _ = planned(Bicubic(GRID), mesh=Mesh(50), compiled=True)
    window = horizon(found, span=SPAN, intervals=WINDOW)
    motions: dict[int, list[list]] = {1: [], 0: []}  # by number of steps
    for seed in range(1, DRIVEN + 1):
        ground = Bicubic(disturbed(GRID, WRONG, 1.0, seed))
        model = direct_kinematics(three_wheeler(axle="fixed"), ground)
        kept = 1 - np.append(
            np.random.default_rng(seed).uniform(0, LOST, 2), 0.0
        )  # not of steering
        rates = list(leaves(model.u))
        world = substitute(model, rates, [k * u for k, u in zip(kept, rates, strict=True)])
        for steps, own in motions.items():
            own.append(drive(replace(window, steps=steps), world, {}, NOISE, seed))
    print(HEADER)
    report(f"{DRIVEN} worlds: one step", motions[1])
    report(f"{DRIVEN} worlds: IPOPT with a line search", motions[0])


# Several starts

SEVERAL, TERRAINS, DISCS = 4, 10, 8
ROUGHER = (
    "terrain.synthetic.power_law.rms=0.2",
    "terrain.synthetic.power_law.shortest=1.5",
    "goal={x=1.5, y=4.0}",
    "driver={name='route', speed=0.2, turning_radius=1.0}",
    "plan.duration=",
    "plan.intervals=25",
)
FIELD = (
    "terrain.synthetic.craters=",
    "terrain.synthetic.power_law.rms=0.2",
    "goal={x=20.0, y=25.0}",
    "driver={name='route', speed=0.5, turning_radius=2.0}",
    "plan.duration=",
    "plan.intervals=30",
    "plan.accuracy=5e-3",
)


class Optimum(NamedTuple):
    """Text, cost, slip [mm per wheel and m], wall time [s], and the table of starts."""

    words: str
    cost: float
    slip: float
    seconds: float
    table: str


def problem_of(kind: str, seed: int, starts: int):
    """Return the problem of a kind and a seed."""
    more = (f"terrain.synthetic.power_law.seed={seed}", f"plan.starts={starts}")
    if kind == "hills":
        return load_problem(PROBLEMS / "plan_rigid_hills.toml", (*ROUGHER, *more))
    rng = np.random.default_rng(seed)
    places = rng.uniform([12, 11, 0.3], [28, 21, 1.2], (DISCS, 3)).round(3)
    discs = ", ".join(f"{{x={x}, y={y}, radius={radius}}}" for x, y, radius in places)
    return load_problem(PROBLEMS / "plan_crater_field.toml", (*FIELD, *more, f"keep_out=[{discs}]"))


def solved(kind: str, seed: int, starts: int) -> Optimum:
    """Return the plan on a terrain."""
    problem = problem_of(kind, seed, starts)
    begin = time.perf_counter()
    run = run_problem(problem).trajectory
    seconds = time.perf_counter() - begin
    weights = {**problem.spec.costs, "smoothness": problem.spec.plan.smooth}
    cost = sum(weights[name] * run.facts[f"plan_cost_{name}"].value for name in weights)
    lines = [": ".join(line) for line in motion_facts(run)]
    first = next((k for k, line in enumerate(lines) if line.startswith("starts: ")), len(lines))
    table = "\n".join(lines[first : first + 1 + starts])
    slip, end = slip_path(run), run.outcome.name.lower()
    words = f"{end}, cost {cost:.4f}, slip {slip:.3f} mm/m, {seconds:.0f} s"
    return Optimum(words, cost, slip, seconds, table)


def compare(kind: str) -> None:
    """Print the table of a kind of terrain."""
    found = []
    for seed in range(1, TERRAINS + 1):
        one, several = solved(kind, seed, 1), solved(kind, seed, SEVERAL)
        optima, *rows = several.table.splitlines()
        print(f"{kind}, seed {seed}: one start {one.words}", flush=True)
        print(f"  best of {SEVERAL} {several.words}", flush=True)
        names = ", ".join(row.partition(", cost")[0] for row in rows)
        print(f"  {optima}, the best first: {names}", flush=True)
        found.append([several[k] / one[k] for k in (1, 2, 3)])
    print(f"{kind}, best of {SEVERAL} over one start: smallest, median, largest ratio")
    for name, ratios in zip(("cost", "slip", "time"), np.array(found).T, strict=True):
        print(f"  {name}: {', '.join(format(q, '.3f') for q in np.quantile(ratios, (0, 0.5, 1)))}")


def slip_path(run: Trajectory) -> float:
    """Return the slip path of a motion, per wheel and metre driven [mm/m]."""
    slip = np.trapezoid(np.hypot(run["slip_along"], run["slip_across"]), run.t, axis=0).mean()
    return 1e3 * float(slip) / path_length(run)


# Windows

DISTANT_GOALS = {"0.4 km": (900.0, 2900.0), "1.3 km": (1400.0, 2000.0), "3.5 km": (2600.0, 600.0)}


def windows_words(run: Trajectory) -> str:
    """Return slip and utilisation of a motion as text."""
    return (
        f"{run.outcome.name.lower()}, {path_length(run):.0f} m, slip {slip_path(run):.4f} mm/m, "
        f"utilisation at most {run['utilisation'].max():.3f}"
    )


def planned_in_windows(name: str) -> None:
    """Plan to a goal and print a row."""
    x, y = DISTANT_GOALS[name]
    problem = load_problem(PROBLEMS / "plan_long_dem.toml", (f"goal.x={x}", f"goal.y={y}"))
    begin = time.perf_counter()
    result = run_problem(problem)
    seconds, run = time.perf_counter() - begin, result.trajectory
    print(f"{name}: plan {windows_words(run)}", flush=True)
    print(f"  {dict(motion_facts(run))['windows']}", flush=True)
    checked = result.verification
    worst = max((fact.value for name, fact in checked.items() if "violation" in name), default=0.0)
    print(f"  {seconds:.0f} s, {seconds / path_length(run):.2f} s/m; largest violation {worst:.1e}")
    law, times = result.setup.starts[0]
    setup = replace(result.setup, inputs=law, t=np.arange(0.0, times[-1], 1.0))
    driven = integrate(setup, problem.spec.solver.options, Watch())
    print(f"  follow {windows_words(driven)}", flush=True)


def windows() -> None:
    """Print plans in windows, each from a separate process."""
    for name in DISTANT_GOALS:
        apart(planned_in_windows, name)


# Momentum

GRIP, SLOPE = 0.8, np.tan(np.radians(20))
ROLLING = 1.15  # of the kinematic motion of the initial guess [m/s]
ROUGH = SolverOptions(tolerance=1e-5)


def slope(y: ca.SX) -> ca.SX:
    """Return heights of a slope of 20 degrees that begins at y = 1.2 m."""
    return SLOPE * 0.15 * ca.log(1 + ca.exp((y - 1.2) / 0.15))


RIDGE = Analytic(lambda x, y: 0 * x + slope(y) + 0.13 * ca.exp(-(((y - 3.2) / 0.35) ** 2)), mu=GRIP)
BUMP = Analytic(
    lambda x, y: slope(y) + 0.12 * ca.exp(-(((y - 3.0) / 0.35) ** 2) - ((x - 0.2) / 0.8) ** 2),
    mu=GRIP,
)


def with_torques(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle with a torque as the input of every wheel."""
    wheels = tuple(replace(wheel, drive=Torque()) for wheel in vehicle.wheels)
    return replace(vehicle, wheels=wheels)


CAR = with_torques(catalog.skid_steer(wheelbase=0.7, mass=40.0, center_of_mass=(0.0, 0.0, 0.07)))
CART = with_torques(catalog.skid_steer())


def rolled(model: Any, count: int) -> Trajectory:
    """Return the motion of a model straight on at equal wheel rates, with ``count`` samples."""
    rates = {label.full: ROLLING / 0.15 for label in model.labels.u.wheels}
    times = np.linspace(0, 4, count)
    return simulate(model, settle(model), model.inputs(**rates), times, options=ROUGH)


def planned_with_inertia(
    vehicle: Vehicle,
    ground: Analytic,
    law: GroundLaw,
    bounds: tuple[float, float, int],
    before: Plan | None = None,
    *,
    last: bool = True,
) -> Plan:
    """Return a plan; ``bounds`` are the torque of a wheel [N m], the goal's y [m] and intervals.

    Only the last of several plans has to agree with its simulation.
    """
    torque, goal, intervals = bounds
    model = rigid_dynamics(vehicle, ground, law=law)
    start = settle(model)
    run = rolled(direct_kinematics(vehicle, ground), 41)
    run = run.part(slice(0, int(np.abs(run["y"] - goal).argmin()) + 1))
    return plan(
        model,
        start,
        dynamic_guess(model, start, run),
        goal={"y": (goal, goal + 1)},
        costs={"time": 1.0, "effort": 1e-3},
        duration=(0.5, 20.0),
        smooth=2e-5,
        inputs={label.full: (-torque, torque) for label in model.labels.u.wheels},
        mesh=Mesh(intervals, continuous=False, accuracy=0.01 if last else 1.0),
        search=Search(resume=None if before is None else before.saved),
    )


def momentum_row(name: str, *arguments: Any, **options: Any) -> Plan:
    """Print a row about a plan with inertia and its simulation, and return the plan."""
    clock = time.process_time()
    found = planned_with_inertia(*arguments, **options)
    seconds = time.process_time() - clock
    iterations = " + ".join(str(stage.iterations) for stage in found.stages)
    search = sum(stage.seconds["total"] for stage in found.stages)
    away = max(found.difference[axis] for axis in "xyz")
    used = np.hypot(found.run["friction_used_along"], found.run["friction_used_across"])
    least = [run["force_normal"].min() for run in (found.run, found.replay)]
    print(
        f"{name}: {found.stages[-1].status}, {iterations} iterations, {search:.1f} s of "
        f"search, {seconds:.1f} s CPU in all; {found.motion.duration:.4f} s, least N {least[0]:.1f}"
        f" N, simulated {least[1]:.1f} N, friction used {used.max():.3f}; simulation "
        f"{1e3 * away:.2f} mm apart, end y {found.replay['y'][-1]:.4f} m",
        flush=True,
    )
    return found


def momentum() -> None:
    """Print plans over bumps on a slope."""
    run = rolled(quasi_statics(CAR, RIDGE), 201)
    needed = run["drive_torque"].sum(axis=1)
    k = int(needed.argmax())
    print(f"car, driven slowly: {needed[k]:.1f} N m at y = {run['y'][k]:.2f} m; drives give 26 N m")
    found = momentum_row("car, rolling", CAR, RIDGE, LinearCreep(), (6.5, 4.6, 50))
    fast = np.hypot(found.replay["velocity_y"], found.replay["velocity_z"])
    print(
        f"  {np.interp(2.8, found.replay['y'], fast):.2f} m/s at the foot of the ridge, y = 2.8 m"
    )
    momentum_row("cart, rolling", CART, BUMP, LinearCreep(), (5.3, 4.4, 40))
    before = None
    for creep in (0.3, 0.1, 0.03):
        name, law = f"cart, sliding, creep {creep} m/s", Coulomb(creep)
        before = momentum_row(name, CART, BUMP, law, (5.3, 4.4, 40), before, last=creep == 0.03)


# Goal and costs alone

HAND = {  # settings of hand-made guesses
    "plan_rigid_hills": [
        "inputs={right_rate=0.45, left_rate=0.45, steer_rate=0.0}",
        "time.duration=20",
    ],
    "plan_tilt_limits": [
        "inputs={right_rate=0.45, left_rate=0.45, steer_rate=0.0}",
        "time.duration=40",
    ],
    "plan_parking": ["driver={name='reeds-shepp', speed=0.4, turning_radius=1.5}"],
    "plan_crater_field": ["driver={name='route', speed=0.5, turning_radius=2.5}"],
    "plan_momentum": ["driver={name='straight', speed=1.2}", "time.duration=3.9"],
    "plan_climb_ramp": [],  # from its own paths
    "plan_sandy_slope": [],
    "plan_rigid_robot": ["driver={name='straight', speed=0.99}", "time.duration=6"],
    "plan_real_dem": ["driver={name='route', speed=1.0, turning_radius=3.0}"],
    "plan_long_dem": ["driver={name='route', speed=1.0, turning_radius=3.0}"],
}
SEARCHES, TASKS = ("plan", "driver", "solver"), ("limits", "bounds", "keep_out")


def goals() -> None:
    """Print the plans of three forms of each problem."""
    for name, hand in HAND.items():
        file = PROBLEMS / f"{name}.toml"
        keys = tomllib.loads(file.read_text("utf-8"))
        found = [f"{key}=" for key in SEARCHES if key in keys]
        alone = [*found, *(f"{key}=" for key in TASKS if key in keys)]
        for form, settings in (("by hand", hand), ("found", found), ("goal, costs", alone)):
            apart(goal_row, f"{name:18}{form:13}", file.name, settings)


def goal_row(words: str, name: str, settings: list[str]) -> None:
    """Plan a problem with settings, and print a row that begins with words."""
    problem, clock = load_problem(PROBLEMS / name, settings), time.process_time()
    try:
        result = run_problem(problem)
    except SlipfreeError as error:
        print(f"{words}refused\n  {error}\n  {grid_words(problem)}")
        return
    spent, run = time.process_time() - clock, result.trajectory
    print(
        f"{words}{run.outcome.name.lower()}: {spent:.1f} s CPU, "
        f"{run.facts['plan_iterations'].value:.0f} iterations, {run.t[-1]:.1f} s long, slip "
        f"{slip_path(run):.3f} mm/m, guess: {result.setup.guide.name or 'inputs'}"
    )
    if run.stop is not None:
        print(f"  {run.stop.words}\n  {grid_words(problem)}")


def scenes() -> None:
    """Print the plans of own scenes."""
    table = tomllib.loads((HERE / "plan_scenes.toml").read_text("utf-8"))
    for scene in table["scene"]:
        settings = [*table["all"], *table["vehicles"][scene["vehicle"]], *scene["settings"]]
        apart(goal_row, f"{scene['name']}, {scene['vehicle']}: ", "plan_rigid_hills.toml", settings)


def grid_words(problem: Any) -> str:
    """Return where poses on a grid end between start and goal."""
    world = build_world(problem)
    layers = traversability(world.terrain, world.vehicle, keep_out=regions(problem))
    places = [place[1:] for place in places_of(problem, world.terrain.domain)[0]]
    limited = "utilisation" in problem.spec.limits
    words = separation_words(layers, places, by_friction=limited)
    return f"grid: {words or 'poses connect start and goal'}"


# Times


def times() -> None:
    """Print the CPU time of the command on each shipped plan, and the part inside IPOPT."""
    print(f"{'':18}CPU s  in IPOPT")
    for name in (each for each in HAND if each != "plan_long_dem"):
        before, begin = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime, time.perf_counter()
        with TemporaryDirectory() as folder:
            file, out = str(PROBLEMS / f"{name}.toml"), f"{folder}/plan.nc"
            command = [sys.executable, "-m", "slipfree", "run", file, "-o", out, "--json"]
            done = subprocess.run(command, stdout=subprocess.PIPE, check=True)
        spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
        facts = json.loads(done.stdout)["result"]["facts"]
        share = facts["plan_seconds"]["value"] / (time.perf_counter() - begin)  # of the wall time
        print(f"{name:18}{spent:5.1f}{share * spent:10.1f}", flush=True)


# Robust plans

DRAWN = "friction={friction}, inputs={inputs}, map={{rms={rms}, correlation=1.0}}"
WIDE = ("terrain.synthetic.x=[-8.0, 8.0]",)  # room for the detours of the ramp
WORLDS = (
    ("plan_crater_field", 0.05, 0.01, 0.02, ("limits.utilisation=[0.0, 0.5]",)),
    ("plan_climb_ramp", 0.02, 0.002, 0.002, WIDE),
    ("plan_climb_ramp", 0.05, 0.01, 0.005, WIDE),
)


def robust() -> None:
    """Print robust plans."""
    for name, friction, inputs, rms, settings in WORLDS:
        drawn = DRAWN.format(friction=friction, inputs=inputs, rms=rms)
        problem = load_problem(PROBLEMS / f"{name}.toml", (*settings, f"plan.robust={{{drawn}}}"))
        begin = time.perf_counter()
        run = run_problem(problem).trajectory
        print(f"{name}, {drawn}: {run.outcome.title}, {time.perf_counter() - begin:.0f} s")
        lines = dict(motion_facts(run))
        for name in ("robust plan", "  tightened", "  cost of this", "  violated", "  end"):
            if name in lines:
                print(f"  {name.strip()}: {lines[name]}", flush=True)


def main() -> None:
    """Print the parts."""
    starts = {kind: partial(compare, kind) for kind in ("hills", "obstacles")}
    parts = {"windows": windows, "momentum": momentum, "goals": goals, "scenes": scenes}
    named = {
        "slip": slip_table,
        "horizon": moving_horizon,
        "worlds": worlds,
        "times": times,
        "robust": robust,
    }
    run_parts({**named, **starts, **parts})
