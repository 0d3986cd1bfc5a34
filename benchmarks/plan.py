"""Measure plans of least slip: simulated slip, computing time, growth, and a plain Opti program.

``python benchmarks/plan.py`` prints, for a rigid-axle three-wheeler on the hills of the tests,
from (0, 0, 0) to (0.6, 2.6) in 20 s:

1. Slip of several driving methods. Plans are simulated, interval by interval, with ten samples
   each; slip is the root mean square over time and wheels, or its path divided by that of the
   platform. In the quasi-static model the same inputs, or the same law, drive the vehicle.
2. Time beside that of the prototype in the same run, on its problem with its weights.
3. A plan by the public function, on the hills and on a map of them: functions interpreted, compiled
   and cached (hills and map do not share the cache); each in a separate process.
4. Time and memory of an iteration by number of intervals, compiled; each in a separate process.
5. Iterations from an existing plan: the same plan, another mesh, and a goal moved by 5 %.
6. The ramp of the tests, too steep to climb straight with its friction, from several starts.
7. The same task by ``casadi.Opti`` with ``casadi.interpolant`` for the ground, on a map of the
   hills, and ours on that map; each in a separate process, since the stock node may crash.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path as File
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from direct import Stock
from reference import heading

from slipfree import (
    Analytic,
    Bicubic,
    Coulomb,
    Grid,
    Path,
    SlipfreeError,
    SolverOptions,
    direct_kinematics,
    follow,
    quasi_statics,
    settle,
    simulate,
)
from slipfree.catalog import three_wheeler
from slipfree.codegen_cache import FOLDER
from slipfree.models.friction_feasibility import best_utilisation
from slipfree.plan.plan import Plan, plan
from slipfree.plan.transcription import transcribe
from slipfree.plan.verification import simulate_plan
from slipfree.trajectory import Trajectory, path_length

sys.path.insert(0, str(File(__file__).parent.parent / "tests" / "physics"))
sys.path.insert(0, str(File(__file__).parent.parent / "tests"))
import test_climb

from helpers.cases import hills

PROTOTYPE = File(__file__).parents[2] / "shared" / "lab" / "planning" / "rigid.py"
LINE = re.compile(r"it=(\d+) ([\d.]+)s .*rms slip per wheel=(\S+) m/s\s+\S+=([\d.]+)\s+nvar=(\d+)")
GOAL, DURATION = (0.6, 2.6), 20.0  # [m], [s]
RATES = {f"{name}_rate": (-2.0, 2.0) for name in ("right", "left", "steer")}  # [rad/s]
STEER = {"steer": (-1.0, 1.0)}  # [rad]
WEIGHTS, SMOOTH = {"slip": 7e4, "effort": 0.01}, 0.002
LAB_WEIGHTS, LAB_SMOOTH = {"slip": 1e5, "effort": 0.01}, 0.005  # those of the prototype
EASY = {"slip": 1e3, "effort": 0.01}  # few iterations
STARTS = ((0.45, 0.45), (0.3, 0.3), (0.47, 0.43))  # rates of the guess, right and left [rad/s]
INTERVALS, DEGREE, SAMPLES = 40, 3, 10
SIZES = (25, 50, 100, 200, 400)
MU, CREEP = 0.6, 1e-4  # [1], [m/s]
CREEPS = (1e-3, 1e-4, 1e-5, 1e-6)  # [m/s]
TOLERANCE = 1e-8  # [m, rad]
FRICTION_TOLERANCE = 1e-6  # at less, the integrator finds no start after some jumps of the inputs
SPACING, EXTENT = 0.25, (-3.0, 4.0, -3.0, 6.0)  # of the map [m]
MOST, PATIENCE = 100, 120  # iterations of the plain way, seconds for a process


Drive = Callable[[Any, Trajectory, float], Trajectory]  # model, start, tolerance


class Row(NamedTuple):
    """Driving method: a law of a model and its start, and the cost of finding it."""

    words: str
    drive: Drive
    found: Plan | None
    seconds: float


def level(x: Any, _y: Any) -> Any:
    """Return the height of flat ground. [m]."""
    return 2 + 0 * x


def planned(
    terrain: Any,
    *,
    vehicle: Any = None,
    goal: tuple[float, float] = GOAL,
    rates: tuple[float, float] = STARTS[0],
    compiled: bool = False,
    **options: Any,
) -> tuple[Plan, float]:
    """Return the plan of the task on a ground, and its wall time [s].

    Inputs are constant on every interval by default, as in the prototype.
    """
    dae = direct_kinematics(vehicle or three_wheeler(axle="fixed"), terrain)
    solver = SolverOptions(compiled=compiled)
    start = settle(dae, options=solver)
    inputs = dae.inputs(right_rate=rates[0], left_rate=rates[1], steer_rate=0.0)
    guess = simulate(dae, start, inputs, np.linspace(0, DURATION, 61), options=solver)
    given = {"costs": WEIGHTS, "smooth": SMOOTH, "intervals": INTERVALS, "continuous": False}
    begin = time.perf_counter()
    found = plan(
        dae,
        start,
        guess,
        goal=dict(zip("xy", goal, strict=True)),
        duration=DURATION,
        inputs=RATES,
        limits=STEER,
        degree=DEGREE,
        options=solver,
        **(given | options),
    )
    return found, time.perf_counter() - begin


def rms_slip(run: Trajectory) -> float:
    """Return the root mean square of the slip over time and wheels. [m/s]."""
    squares = run["slip_along"] ** 2 + run["slip_across"] ** 2
    return float(np.sqrt(np.trapezoid(squares.mean(axis=1), run.t) / np.ptp(run.t)))


def sliding(run: Trajectory) -> float:
    """Return the slip path of a wheel, averaged, divided by the platform's path [mm/m]."""
    slip = np.hypot(run["slip_along"], run["slip_across"]).mean(axis=1)
    return 1e3 * float(np.trapezoid(slip, run.t)) / path_length(run)


def effort(run: Trajectory) -> float:
    """Return the integral of the squared inputs. [rad2/s]."""
    return float(np.trapezoid(sum(run[name] ** 2 for name in RATES), run.t))


def rows() -> list[Row]:
    """Return all driving methods."""
    ground, found = Analytic(hills), []
    for rates in STARTS:
        best, seconds = planned(ground, rates=rates)
        found.append((f"least slip, from {rates[0]}/{rates[1]} rad/s", best, seconds))
    found.append(("rates continuous", *planned(ground, continuous=True)))
    found.append(("effort only", *planned(ground, costs={"effort": WEIGHTS["effort"]})))
    found.append(("plan for flat ground", *planned(Analytic(level))))
    ways = [Row(words, by_plan(best), best, seconds) for words, best, seconds in found]
    return [*ways, Row("follow, straight line", followed, None, np.nan)]


def by_plan(found: Plan) -> Drive:
    """Return the driving method that replays a plan."""
    step = DURATION / INTERVALS / SAMPLES
    return lambda dae, start, tolerance: simulate_plan(
        dae, start, found.motion, step=step, options=SolverOptions(tolerance=tolerance)
    )


def followed(dae: Any, start: Trajectory, tolerance: float) -> Trajectory:
    """Return the motion by the driving law along the straight line to the goal."""
    vehicle, line = three_wheeler(axle="fixed"), Path(np.array([(0.0, 0.0), GOAL]))
    law = follow(dae, vehicle, line, speed=line.length / DURATION)
    t = np.linspace(0, DURATION, INTERVALS * SAMPLES + 1)
    return simulate(dae, start, law, t, options=SolverOptions(tolerance=tolerance))


def frictional(creep: float) -> Any:
    """Return the quasi-static model."""
    return quasi_statics(three_wheeler(axle="fixed"), Analytic(hills, mu=MU), law=Coulomb(creep))


def by_friction(drive: Drive, creep: float) -> tuple[float, str]:
    """Return the rms slip of a driving method with friction [m/s], and its stop reason."""
    dae = frictional(creep)
    try:
        run = drive(dae, settle(dae), FRICTION_TOLERANCE)
    except SlipfreeError as error:
        return np.nan, str(error)
    if run.stop is not None:
        return np.nan, f"ends at {run.t[-1]:.2f} s: {run.stop.name}"
    return rms_slip(run), ""


def table() -> None:
    """Print the slip of all driving methods."""
    dae = direct_kinematics(three_wheeler(axle="fixed"), Analytic(hills))
    start, ways = settle(dae), rows()
    print(f"least slip, {INTERVALS} intervals, degree {DEGREE}; traction: mu {MU}, creep {CREEP:g}")
    print(f"{'':33}rms slip  sliding  int u2   from goal  itera-  seconds    rms slip [m/s]")
    print(f"{'':33}[m/s]     [mm/m]   [1/s]    [mm]       tions   all/IPOPT  by traction")
    slips = np.zeros((len(ways), 2))
    for k, way in enumerate(ways):
        run = way.drive(dae, start, TOLERANCE)
        away = 1e3 * np.hypot(run["x"][-1] - GOAL[0], run["y"][-1] - GOAL[1])
        slips[k, 0], (slips[k, 1], why) = rms_slip(run), by_friction(way.drive, CREEP)
        print(
            f"{way.words:33}{slips[k, 0]:.2e}  {sliding(run):7.3f}  {effort(run):6.2f}  "
            f"{away:10.4f}  {cost(way)}  {why or format(slips[k, 1], '.2e')}"
        )
    ratios = slips[-1] / slips[0]
    print(
        f"follow slips {ratios[0]:.1f} times as much as the plan where slip is least, "
        f"{ratios[1]:.1f} times by traction"
    )
    floors(ways[0].drive, dae)


def cost(way: Row) -> str:
    """Return the cost of finding a driving method."""
    if way.found is None:
        return f"{'-':>6}  {'-':>9}"
    count = sum(stage.iterations for stage in way.found.stages)
    mark = "" if way.found.success else f" {way.found.stages[-1].status}"
    return f"{count:6}  {way.seconds:4.1f}/{search(way.found):4.1f}{mark}"


def search(found: Plan) -> float:
    """Return the wall time of all stages of the search. [s]."""
    return sum(stage.seconds["total"] for stage in found.stages)


def floors(drive: Drive, dae: Any) -> None:
    """Print the slip of a quasi-static plan by creep speed, and that due to gravity alone."""
    print(
        "the plan of the first row by traction: rms slip [m/s], and that at rest in its poses, "
        "by gravity alone"
    )
    run = drive(dae, settle(dae), TOLERANCE)
    for creep in CREEPS:
        slip, why = by_friction(drive, creep)
        model, squares = frictional(creep), []
        for k in range(0, run.t.size, 2 * SAMPLES):
            pose = {name: run[name][k] for name in ("x", "y", "heading", "steer")}
            rest = settle(model, **pose)
            squares.append((rest["slip_along"] ** 2 + rest["slip_across"] ** 2).mean())
        print(
            f"  creep {creep:g} m/s: {why or format(slip, '.2e')}, at rest "
            f"{np.sqrt(np.mean(squares)):.2e}"
        )


def prototype() -> None:
    """Print the time of the prototype beside ours, on its problem."""
    if not PROTOTYPE.exists():
        print("prototype: it is not beside the project")
        return
    done = subprocess.run(
        [sys.executable, str(PROTOTYPE), str(INTERVALS)],
        capture_output=True,
        text=True,
        check=True,
        cwd=PROTOTYPE.parent,
        timeout=PATIENCE,
    )
    stages = [[float(word) for word in words] for words in LINE.findall(done.stdout)]
    *staged, cold = stages
    total = sum(stage[1] for stage in staged)
    best, _ = planned(Analytic(hills), costs=LAB_WEIGHTS, smooth=LAB_SMOOTH)
    ours, slip = search(best), np.sqrt(best.costs["slip"] / DURATION / 3)
    print(f"{'':22}iterations         seconds  ms each  rms slip [m/s]  int u2")
    for words, part in (("prototype, in stages", staged), ("prototype, at once", [cold])):
        lab_counts, seconds = [int(stage[0]) for stage in part], sum(stage[1] for stage in part)
        measured(words, lab_counts, seconds, part[-1][2:4])
    counts = [stage.iterations for stage in best.stages]
    measured("ours, its weights", counts, ours, [slip, best.costs["effort"]])
    print(
        f"the prototype takes {total / ours:.2f} times as long as ours, all stages of both, and "
        f"{(total + cold[1]) / ours:.2f} times\nif it plans in both ways, as its file does; "
        f"{to_equal(staged, cold, slip) / ours:.2f} times to our slip within 2 %"
    )


def measured(words: str, counts: list[int], seconds: float, reached: list[float]) -> None:
    """Print the cost and the result of a search."""
    print(
        f"{words:22}{'+'.join(map(str, counts)):18} {seconds:7.2f}  "
        f"{1e3 * seconds / sum(counts):7.1f}  {reached[0]:.2e}        "
        f"{reached[1]:.2f}"
    )


def to_equal(staged: list[list[float]], cold: list[float], slip: float) -> float:
    """Return the least time in which the prototype reaches a slip; infinite if it does not. [s]."""
    times = np.cumsum([stage[1] for stage in staged]).tolist()
    ways = [*zip(times, (stage[2] for stage in staged), strict=True), (cold[1], cold[2])]
    return min((seconds for seconds, reached in ways if reached <= 1.02 * slip), default=np.inf)


def grown(intervals: int) -> dict[str, float]:
    """Return the cost of a plan on a number of intervals."""
    found, seconds = planned(Analytic(hills), costs=EASY, intervals=intervals, compiled=True)
    count = sum(stage.iterations for stage in found.stages)
    parts = {
        part: 1e3 * sum(stage.seconds[part] for stage in found.stages) / count
        for part in ("functions", "rest")
    }
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return {
        "unknowns": found.program.scale.size,
        "rows": found.program.g_lower.size,
        "iterations": count,
        "outside": seconds - search(found),
        "peak": peak,
        "success": found.success,
        **parts,
    }


def called(ground: str, intervals: int, *, compiled: bool) -> dict[str, Any]:
    """Return the cost of a plan with continuous inputs by the public function."""
    terrain = Analytic(hills) if ground == "hills" else Bicubic(surface())
    found, seconds = planned(terrain, intervals=intervals, continuous=True, compiled=compiled)
    parts = {
        part: sum(stage.seconds[part] for stage in found.stages) for part in ("functions", "total")
    }
    begin = time.perf_counter()
    transcribe(found.program.task, found.program.mesh, found.program.options)
    return {
        "iterations": "+".join(str(stage.iterations) for stage in found.stages),
        **parts,
        "seconds": seconds,
        "build": time.perf_counter() - begin,
        "compiled": found.program.compiled,
    }


def calls() -> None:
    """Print the costs of plans by the public function."""
    print(
        "                                     iterations  all    IPOPT  functions  building  rest\n"
        "                                                 [s]    [s]    of IPOPT   again [s] [s]"
    )
    with tempfile.TemporaryDirectory() as folder:
        for ground, intervals in (("hills", 50), ("hills", 200), ("map", 50), ("map", 200)):
            os.environ[FOLDER] = folder
            for words, asked in (("interpreted", ""), ("compiled", "yes"), ("cached", "yes")):
                found = apart("called", ground, str(intervals), asked)
                if isinstance(found, str):
                    print(f"{ground:5} {intervals:4} {words:25} {found}")
                    continue
                rest = found["seconds"] - found["total"] - found["build"]
                print(
                    f"{ground:5} {intervals:4} {words:25} {found['iterations']:10}  "
                    f"{found['seconds']:5.2f}  {found['total']:5.2f}  "
                    f"{100 * found['functions'] / found['total']:7.0f} %  "
                    f"{found['build']:8.2f}  {rest:5.2f}",
                    flush=True,
                )
            shutil.rmtree(folder)
    os.environ.pop(FOLDER)


def growth() -> None:
    """Print time and memory of an iteration over the number of intervals."""
    print(
        "intervals  unknowns  rows    iterations  functions  linear solver and rest  all   "
        "outside  peak\n"
        "                                         [ms an iteration]                       "
        "[s]      [MB]"
    )
    sizes, times = [], []
    for size in SIZES:
        found = apart("growth", str(size))
        if isinstance(found, str):
            print(f"{size:9}  {found}")
            continue
        each = found["functions"] + found["rest"]
        sizes.append(size)
        times.append(each)
        mark = "" if found["success"] else "  not solved"
        print(
            f"{size:9}  {found['unknowns']:8}  {found['rows']:6}  {found['iterations']:10}  "
            f"{found['functions']:9.1f}  {found['rest']:22.1f}  {each:5.1f}  "
            f"{found['outside']:6.1f}  {found['peak']:6.0f}{mark}"
        )
    slope = np.polyfit(np.log(sizes), np.log(times), 1)[0]
    print(f"time of an iteration grows with the intervals to the power {slope:.2f}")


def warm() -> None:
    """Print the iterations from an existing plan, beside those from a simple motion."""
    first, _ = planned(Analytic(hills))
    print("from the plan of the first row                 iterations, cold  from the plan")
    for words, goal, intervals in (
        ("the same", GOAL, INTERVALS),
        ("goal 5 % farther", (1.05 * GOAL[0], 1.05 * GOAL[1]), INTERVALS),
        ("goal 5 % nearer", (0.95 * GOAL[0], 0.95 * GOAL[1]), INTERVALS),
        ("60 intervals", GOAL, 60),
    ):
        cold, resumed = (
            sum(
                stage.iterations
                for stage in planned(
                    Analytic(hills), goal=goal, intervals=intervals, resume=former
                )[0].stages
            )
            for former in (None, first.saved)
        )
        print(f"{words:46} {cold:16}  {resumed:13}")


def ramp() -> None:
    """Print the climb of a ramp of 20 degrees with a coefficient of friction of 0.5."""
    flat, law = test_climb.model(), test_climb.model(quasi_statics)
    places = [settle(flat, x=0.0, y=y) for y in np.linspace(3.0, 6.0, 16)]
    best = [
        best_utilisation(test_climb.VEHICLE, test_climb.GROUND, place)["utilisation_best"][0]
        for place in places
    ]
    print(
        f"straight up: friction needed over that of the ground, load-weighted "
        f"{max(place['utilisation'].max() for place in places):.3f}, at best {max(best):.3f}"
    )
    task = test_climb.Task(test_climb.START, test_climb.GOAL, test_climb.DURATION, 24, 3)
    for words, ways in (
        ("straight", (0.0,)),
        ("bow to the right", (2.0,)),
        ("bow to the left", (-2.0,)),
        ("all three", (0.0, 2.0, -2.0)),
    ):
        begin = time.perf_counter()
        found = test_climb.planned(task, [test_climb.bow(way) for way in ways])
        seconds, run = time.perf_counter() - begin, found.run
        names = ("x", "y", "heading", "steer")
        held = [settle(law, **{name: run[name][k] for name in names}) for k in range(run.t.size)]
        used = max(place["utilisation"].max() for place in held)
        slip = max(np.hypot(place["slip_along"], place["slip_across"]).max() for place in held)
        count = sum(stage.iterations for stage in found.stages)
        print(
            f"  from {words}: {'solved' if found.success else 'not solved'}, "
            f"{test_climb.length(found.replay):.2f} m, load-weighted "
            f"{run['utilisation'].max():.3f}; by friction at rest at all {run.t.size} nodes "
            f"{used:.3f}, creep {slip / test_climb.CREEP:.2f} eps; {count} iterations, "
            f"{seconds:.1f} s"
        )


def apart(*words: str) -> Any:
    """Return a result of this file from a separate process, or the error as text."""
    command = [sys.executable, __file__, *words]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        return f"no result in {PATIENCE} s"
    if done.returncode < 0:
        return f"crashed: {signal.Signals(-done.returncode).name}"
    if done.returncode:
        return f"failed: {(done.stderr.strip().splitlines() or ['without words'])[-1]}"
    return json.loads(done.stdout.strip().splitlines()[-1])


def surface() -> Grid:
    """Return the hills as a map."""
    x = np.arange(EXTENT[0], EXTENT[1] + SPACING / 2, SPACING)
    y = np.arange(EXTENT[2], EXTENT[3] + SPACING / 2, SPACING)
    return Grid(x, y, Analytic(hills).elevation(*np.meshgrid(x, y, indexing="ij")))


class StockMap(Stock):
    """Terrain of any extent with CasADi's own spline."""

    def __init__(self, grid: Grid) -> None:
        super().__init__(grid)
        self.domain = grid.domain


def plain(hessian: str) -> dict[str, Any]:
    """Return the cost of the plain Opti program for the task, on the map."""
    dae = direct_kinematics(
        three_wheeler(axle="fixed", mass=0.0, wheel_mass=0.0), StockMap(surface())
    )
    opti, slips = written(dae, ca.collocation_points(DEGREE, "radau"))
    opti.solver(
        "ipopt",
        {"print_time": False},
        {
            "print_level": 0,
            "sb": "yes",
            "max_iter": MOST,
            "max_wall_time": 0.75 * PATIENCE,
            "hessian_approximation": hessian,
        },
    )
    begin = time.perf_counter()
    with contextlib.suppress(RuntimeError):  # what was reached is looked at below
        opti.solve_limited()
    seconds, stats = time.perf_counter() - begin, opti.stats()
    integral = float(opti.debug.value(slips))
    return report(stats["return_status"], stats["iter_count"], seconds, integral)


def report(status: str, iterations: int, seconds: float, integral: float) -> dict[str, Any]:
    """Return the printed values of a method; the slip is that at the collocation points."""
    return {
        "status": status,
        "iterations": iterations,
        "seconds": seconds,
        "slip": float(np.sqrt(integral / DURATION / 3)),
    }


def written(dae: Any, points: list[float]) -> tuple[ca.Opti, ca.MX]:
    """Return the task as a hand-written Opti program, and the integral of its squared slip."""
    x, z, u = dae.columns()
    slip = ca.vertcat(*dae.named("slip_along"), *dae.named("slip_across"))
    core = ca.Function("core", [x, z, u], [dae.ode, ca.vertcat(*dae.alg), ca.sumsqr(slip)])
    lagrange, _, weights = ca.collocation_coeff(points)
    lagrange, weights = ca.DM(np.array(lagrange)), weights.nonzeros()
    opti, h, count = ca.Opti(), DURATION / INTERVALS, INTERVALS * DEGREE
    states, unknowns = opti.variable(x.numel(), 1 + count), opti.variable(z.numel(), count)
    inputs, slips = opti.variable(u.numel(), INTERVALS), ca.MX(0)
    for k in range(INTERVALS):
        nodes = states[:, DEGREE * k : DEGREE * (k + 1) + 1]
        for j in range(DEGREE):
            at = DEGREE * k + j
            ode, alg, square = core(states[:, at + 1], unknowns[:, at], inputs[:, k])
            opti.subject_to(nodes @ lagrange[:, j] == h * ode)
            opti.subject_to(alg == 0)
            slips += h * weights[j] * square
    change = ca.sumsqr(inputs[:, 1:] - inputs[:, :-1]) / h
    opti.minimize(
        WEIGHTS["slip"] * slips + WEIGHTS["effort"] * h * ca.sumsqr(inputs) + SMOOTH * change
    )
    opti.subject_to(opti.bounded(-2, inputs, 2))
    opti.subject_to(opti.bounded(-1, states[3, 1:], 1))
    opti.subject_to(states[:2, -1] == ca.DM(GOAL))
    guessed(dae, opti, (states, unknowns, inputs), points)
    return opti, slips


def guessed(dae: Any, opti: ca.Opti, unknowns: tuple[ca.MX, ca.MX, ca.MX], points: Any) -> None:
    """Set the start and the initial guess of our plans."""
    nodes = (np.arange(INTERVALS)[:, None] + np.array(points)).ravel() / INTERVALS
    start, right_left = settle(dae), STARTS[0]
    given = (*right_left, 0.0)
    run = simulate(
        dae,
        start,
        dae.inputs(**dict(zip(RATES, given, strict=True))),
        np.concatenate([[0.0], DURATION * nodes]),
    )
    states, algebraic, inputs = unknowns
    opti.subject_to(states[:, 0] == dae.rows("x", run, 0))
    count = range(run.t.size)
    opti.set_initial(states, np.column_stack([dae.rows("x", run, k) for k in count]))
    opti.set_initial(algebraic, np.column_stack([dae.rows("z", run, k) for k in count[1:]]))
    opti.set_initial(inputs, np.tile(np.array(given)[:, None], INTERVALS))


def ours() -> dict[str, Any]:
    """Return the cost of our method for the task, on the map."""
    found, _ = planned(
        Bicubic(surface()), vehicle=three_wheeler(axle="fixed", mass=0.0, wheel_mass=0.0)
    )
    count = sum(stage.iterations for stage in found.stages)
    return report(found.stages[-1].status, count, search(found), found.costs["slip"])


def beside() -> None:
    """Print the plain Opti program beside our method."""
    print(f"on a map of {SPACING} m, at most {MOST} iterations of the plain way")
    print(
        "                                     status                       iterations  "
        "ms each  seconds  rms slip at the points [m/s]"
    )
    each, totals = [], []
    for words, arguments in (
        ("ours, bicubic, in stages", ("ours",)),
        ("Opti, stock spline, limited memory", ("plain", "limited-memory")),
        ("Opti, stock spline, exact Hessian", ("plain", "exact")),
    ):
        found = apart(*arguments)
        if isinstance(found, str):
            print(f"{words:36} {found}")
            continue
        each.append(1e3 * found["seconds"] / max(found["iterations"], 1))
        totals.append(found["seconds"])
        print(
            f"{words:36} {found['status']:28} {found['iterations']:10}  {each[-1]:7.1f}  "
            f"{found['seconds']:7.1f}  {found['slip']:.2e}"
        )
    if len(each) == 3:
        print(
            f"with the exact Hessian the plain way takes {each[2] / each[0]:.1f} times as long "
            f"an iteration, {totals[2] / totals[0]:.1f} times in all"
        )


def main() -> None:
    """Print all tables."""
    heading()
    for part in (table, prototype, calls, growth, warm, ramp, beside):
        print()
        part()


if __name__ == "__main__":
    if sys.argv[1:2] == ["growth"]:
        print(json.dumps(grown(int(sys.argv[2]))))
    elif sys.argv[1:2] == ["called"]:
        print(json.dumps(called(sys.argv[2], int(sys.argv[3]), compiled=bool(sys.argv[4]))))
    elif sys.argv[1:2] == ["calls"]:
        heading()
        calls()
    elif sys.argv[1:2] == ["plain"]:
        print(json.dumps(plain(sys.argv[2])))
    elif sys.argv[1:2] == ["ours"]:
        print(json.dumps(ours()))
    else:
        main()
