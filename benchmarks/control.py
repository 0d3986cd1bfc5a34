"""Control while driving: rates of planning by sampling, four ways to follow a plan, obstacles.

``python benchmarks control [PART ...]``

``rate``
    Cycles of 2048 candidates of 2 m in ten intervals: CPU time of a cycle, cycles a second with two
    threads, and errors of the candidates' ends and costs against steps of a tenth of the vehicle.
``follow``
    ``slipfree track``: Rocky 7 and a rigid four-wheeler follow plans of 2.6 m in 10 s, on rough
    ground (3 cm rms) that is wrong by 2 cm rms, with inputs that are 100 ms late; Rocky 7 with
    quasi-statics and friction that is wrong by 20 %, the other with kinematics.
``bicycle``
    Model predictive path integral control with a bicycle on the plane, and with exact contact,
    towards a goal behind a ridge: 512 candidates each, the same noise.
``corridor``
    A corridor of 2.4 m in which obstacles appear at 1 m: collisions, and distances from the goal.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from common import run_parts

from slipfree import (
    Bicubic,
    Grid,
    Region,
    SamplingTask,
    SolverError,
    SolverOptions,
    catalog,
    commanded,
    direct_kinematics,
    load_problem,
    run_problem,
    sample_plan,
    settle,
    simulate,
)
from slipfree.core.dae import Dae
from slipfree.core.records import leaves
from slipfree.core.trajectory import Trajectory
from slipfree.files.netcdf import write
from slipfree.plan import sampling
from slipfree.problem.verbs.plan_tracking import follow_plan, tracking_lines, tracking_rows
from slipfree.terrain.grid_ops import disturbed
from slipfree.terrain.synthetic import blank, power_law
from slipfree.vehicle.tree import Vehicle

ROCKY, RIGID = catalog.rocky7(steered="corners"), catalog.rigid_skid_steer()
NAMES = {"Rocky 7": ROCKY, "rigid four-wheeler": RIGID}
CYCLES, SPEED = 8, 0.5  # cycles of which the fastest counts; speed of candidates [m/s]
FINE = 0.1  # step of the reference of candidates [size of the vehicle]
SEEDS = 10  # of `follow` and `bicycle`
WORLDS = {  # wheels of the rigid vehicle press into the ground, without a model of its friction
    "Rocky 7": ["model=quasi-static", "law.coulomb.creep=0.01", "solver.compiled=true"],
    "rigid four-wheeler": ["solver.compiled=true"],
}
DISTURB = {"heights": 0.02, "friction": 0.2, "latency": 0.1}
PROBLEM = """\
verb = "plan"
vehicle = {{ catalog = {vehicle} }}
start = {{}}
goal = {{ x = 0.5, y = 2.5 }}
costs = {{ slip = 1e3, effort = 0.01 }}
driver = {{ name = "follow", speed = 0.26, path = [[0, 0], [0.05, 0.8], [0.45, 1.7], [0.5, 2.5]] }}
time = {{ duration = 10.0, step = 0.1 }}
plan = {{ intervals = 20, smooth = 0.002, duration = 10.0 }}

[terrain]
friction = 0.6

[terrain.synthetic]
x = [-4, 4]
y = [-4, 6]
spacing = 0.1
power_law = {{ rms = 0.03, hurst = 0.9, longest = 4.0, shortest = 0.8, seed = 3 }}
"""
SPECS = {"Rocky 7": '"rocky7", steered = "corners"', "rigid four-wheeler": '"rigid_skid_steer"'}
EXACT = SolverOptions(tolerance=1e-6)


@cache
def rough() -> Bicubic:
    """Return the rough map of `benchmarks batch`."""
    sheet = blank((-6.0, 6.0), (-6.0, 6.0), 0.1)
    return Bicubic(power_law(sheet, rms=0.03, hurst=0.9, longest=4.0, shortest=0.8, seed=3), mu=0.6)


def task_of(model: Dae, vehicle: Vehicle, **options: Any) -> SamplingTask:
    """Return a task with 2048 candidates of 2 m, for wheel rates or commands."""
    ranges = dict[str, tuple[float, float]]()
    for label in leaves(model.labels.u):
        radius = vehicle.wheels[0].radius
        ranges[label.full] = {
            "forward": (0.6 * SPEED, 1.4 * SPEED),
            "yaw_rate": (-0.5, 0.5),
            "joints": (-0.2, 0.2),
        }.get(label.name, (0.6 * SPEED / radius, 1.4 * SPEED / radius))
        if label.full.startswith("steer"):
            ranges[label.full] = (-0.2, 0.2)
    goal = {"x": 0.5, "y": 2.0}
    return SamplingTask(model, {"slip": 1.0}, goal, 4.0, ranges, candidates=2048, **options)


def rate() -> None:
    """Print rates and errors of cycles."""
    print(f"{'':32}CPU of a cycle [ms]  cycles/s, 2 threads  error of ends, cost: median, 95 %")
    for name, vehicle in NAMES.items():
        model = direct_kinematics(vehicle, rough())
        for words, dae in (("wheel rates", model), ("commands", commanded(model, speed=SPEED))):
            x = dae.rows("x", settle(dae), -1) + dae.shift[0]
            times = []
            for threads in (1, 2):
                task, clocks = task_of(dae, vehicle, threads=threads, spread=0.1), []
                cycle = sample_plan(task, x)
                for _ in range(CYCLES):
                    cpu, wall = time.process_time(), time.perf_counter()
                    cycle = sample_plan(task, x, cycle, elapsed=0.05)
                    clocks.append((time.process_time() - cpu, time.perf_counter() - wall))
                times.append(np.min(clocks, axis=0))
            print(
                f"{name + ', ' + words:32}{1e3 * times[0][0]:19.0f}  {1 / times[1][1]:19.1f}  "
                f"{_errors(task, x)}",
                flush=True,
            )


def _errors(task: SamplingTask, x: np.ndarray) -> str:
    """Return errors of the candidates, against small steps."""
    aims = sampling._Aims(task, task.goal, (), sampling._first_state(task, x))
    low, high = task.limits
    inputs = sampling._candidates(task, np.tile((low + high) / 2, task.intervals), 0)[..., :256]
    usual, results = sampling.STEP, []
    for step in (usual, FINE):
        sampling.STEP = step
        results.append(sampling._simulated(aims, inputs))
    sampling.STEP = usual
    (costs, motions), (exact, reference) = results
    ends = np.hypot(*(motions.samples[-1, :2] - reference.samples[-1, :2]))
    middle, large = 1e3 * np.nanquantile(ends, (0.5, 0.95))
    usual, rare = 100 * np.nanquantile(np.abs(costs / exact - 1), (0.5, 0.95))
    return f"{middle:.1f}, {large:.1f} mm; {usual:.1f}, {rare:.1f} %"


def follow() -> None:
    """Print the tables of four ways to follow plans."""
    for name, vehicle in SPECS.items():
        print(f"\n{name}, {SEEDS} worlds", flush=True)
        with tempfile.TemporaryDirectory() as folder:
            problem, plan = Path(folder, "plan.toml"), Path(folder, "plan.nc")
            problem.write_text(PROBLEM.format(vehicle=vehicle))
            result = run_problem(load_problem(problem))
            write(plan, result.trajectory, result.arrays)
            test = follow_plan(plan, WORLDS[name], disturb=DISTURB, seeds=SEEDS, period=0.1)
            print("\n".join(tracking_lines(tracking_rows(test))), flush=True)


class Loop(NamedTuple):
    """Motion under a controller that decides every `PERIOD`, and CPU time of a decision [s]."""

    run: list[Trajectory]
    cpu: float

    def path(self) -> np.ndarray:
        """Return positions of the platform's centre, shape (n, 2)."""
        return np.concatenate([np.column_stack([each["x"], each["y"]]) for each in self.run])


PERIOD, SPAN, CRAWL, CANDIDATES = 0.2, 4.0, 0.4, 512  # [s, s, m/s]
ARRIVED = 0.15  # distance from the goal that counts as arrival [m]
MARGIN = 0.03  # of the keep-out regions, for errors of the prediction [m]


def closed_loop(
    decide: Callable[[np.ndarray], np.ndarray], world: Dae, here: Trajectory, cycles: int, near: Any
) -> Loop:
    """Drive a commanded world until it is near the goal or ends at a limit."""
    runs, cpu = list[Trajectory](), 0.0
    for _ in range(cycles):
        x = world.rows("x", here, -1) + world.shift[0]
        clock = time.process_time()
        forward, yaw_rate = decide(x)
        cpu += time.process_time() - clock
        inputs = world.inputs(forward=float(forward), yaw_rate=float(yaw_rate))
        here = simulate(world, here, inputs, np.linspace(0.0, PERIOD, 3), options=EXACT)
        runs.append(here)
        if (
            here.stop is not None
            or np.hypot(here["x"][-1] - near[0], here["y"][-1] - near[1]) < 0.15
        ):
            break
    return Loop(runs, cpu / len(runs))


class Bicycle:
    """Path integral control of a kinematic bicycle on the plane, for comparison."""

    def __init__(self, goal: tuple[float, float], size: float, seed: int) -> None:
        self.goal, self.size, self.seed = np.array(goal), size, seed
        self.mean, self.cycle = np.tile([[CRAWL / 2], [0.0]], 10), 0

    def __call__(self, x: np.ndarray) -> np.ndarray:
        """Return forward velocity and yaw rate."""
        low, high = np.array([[0.0], [-0.8]]), np.array([[CRAWL], [0.8]])
        rng = np.random.default_rng((self.seed, self.cycle))
        noise = rng.standard_normal((2, 10, CANDIDATES))
        for k in range(1, 10):
            noise[:, k] = 0.7 * noise[:, k - 1] + np.sqrt(0.51) * noise[:, k]
        inputs = np.clip(
            self.mean[..., None] + 0.2 * (high - low)[..., None] * noise,
            low[..., None],
            high[..., None],
        )
        at, heading = np.tile(x[:2, None], CANDIDATES), np.full(CANDIDATES, x[2])
        h, steps = SPAN / 10, 4
        for k in range(10):
            for _ in range(steps):
                heading = heading + inputs[1, k] * h / steps / 2
                at = at + inputs[0, k] * h / steps * np.array([-np.sin(heading), np.cos(heading)])
                heading = heading + inputs[1, k] * h / steps / 2
        cost = (((at - self.goal[:, None]) / self.size) ** 2).sum(axis=0)
        weights = sampling._weights(cost)
        self.mean, self.cycle = inputs @ weights, self.cycle + 1
        first = self.mean[:, 0]
        part = PERIOD / h
        self.mean = (1 - part) * self.mean + part * np.roll(self.mean, -1, axis=1)
        self.mean[:, -1] = self.mean[:, -2]
        return first


def exact_controller(
    task: SamplingTask, goal: dict[str, float], regions: Callable[[np.ndarray], list[Region]]
) -> Callable[[np.ndarray], np.ndarray]:
    """Return `sample_plan` as a function of the state."""
    cycles: list[sampling.SampledPlan | None] = [None]

    def decide(x: np.ndarray) -> np.ndarray:
        try:
            cycles[0] = sample_plan(
                task, x, cycles[0], elapsed=PERIOD, goal=goal, keep_out=regions(x)
            )
        except SolverError:  # the vehicle stands for a period
            return np.zeros(2)
        return cycles[0].inputs[:, 0]

    return decide


def bicycle() -> None:
    """Print ends, slip and time of controllers that know the ground, and of one that does not."""
    axis = np.arange(-3.0, 5.0, 0.1)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    # a ridge across the way, steeper than friction or tip-over allow, with a gap 1 m to the right
    ridge = 0.9 * np.exp(-(((y - 1.5) / 0.35) ** 2)) * (1 - np.exp(-(((x - 1.0) / 0.6) ** 2)))
    waves = power_law(
        Grid(axis, axis, 0 * x), rms=0.02, hurst=0.9, longest=3.0, shortest=0.8, seed=5
    )
    believed = Grid(axis, axis, ridge + waves.z)
    goal = (0.6, 3.0)
    for name, vehicle in NAMES.items():
        model = commanded(direct_kinematics(vehicle, Bicubic(believed, (0, 0))), speed=CRAWL)
        rows = {"bicycle": list[tuple[float, ...]](), "exact contact": []}
        for seed in range(SEEDS):
            real = Bicubic(disturbed(believed, 0.02, 2 * model.size, seed + 1), (0, 0))
            world = commanded(direct_kinematics(vehicle, real), speed=CRAWL)
            task = SamplingTask(
                model,
                {"slip": 100.0},
                dict(zip("xy", goal, strict=True)),
                SPAN,
                {"forward": (0.0, CRAWL), "yaw_rate": (-0.8, 0.8)},
                candidates=CANDIDATES,
                seed=seed,
            )
            for way, decide in (
                ("bicycle", Bicycle(goal, model.size, seed)),
                ("exact contact", exact_controller(task, task.goal, lambda _: [])),
            ):
                loop = closed_loop(decide, world, settle(world), 80, goal)
                last = loop.run[-1]
                away = np.hypot(last["x"][-1] - goal[0], last["y"][-1] - goal[1])
                slip = np.concatenate(
                    [np.hypot(each["slip_along"], each["slip_across"]) for each in loop.run]
                )
                tilt = max(np.abs([each["pitch"], each["roll"]]).max() for each in loop.run)
                rows[way].append(
                    (
                        away,
                        1e3 * np.sqrt((slip**2).mean()),
                        np.degrees(tilt),
                        1e3 * loop.cpu,
                        last.stop is not None,
                    )
                )
        print(f"\n{name}, {SEEDS} worlds: medians, and at the goal, ended at a limit")
        for way, found in rows.items():
            away, slip, tilt, cpu, ended = np.array(found, dtype=float).T
            print(
                f"{way:14} {np.median(away):.2f} m from the goal, slip {np.median(slip):.2f} mm/s, "
                f"tilt {np.median(tilt):.0f} degrees, {np.median(cpu):.1f} ms CPU a cycle; "
                f"{(away < ARRIVED).sum()}, {int(ended.sum())}",
                flush=True,
            )


WIDTH, LENGTH, SEEN, OBSTACLES, RADIUS = 2.4, 5.0, 1.0, 4, 0.15  # of the corridor [m]


class Corridor(NamedTuple):
    """Obstacles of a corridor along y from 0 to `LENGTH`, and half the width of the vehicle [m]."""

    centers: np.ndarray
    half_width: float

    def seen(self, x: np.ndarray) -> list[Region]:
        """Return keep-out regions of the walls, and of obstacles within `SEEN`, for the centre."""
        wall = WIDTH / 2 - self.half_width - MARGIN
        sides = ((wall, 9.0), (-9.0, -wall))
        regions = [
            Region.polygon([(a, -3.0), (b, -3.0), (b, LENGTH + 3.0), (a, LENGTH + 3.0)])
            for a, b in sides
        ]
        near = np.hypot(*(self.centers - x[:2]).T) < SEEN + RADIUS
        radius = RADIUS + self.half_width + MARGIN
        return regions + [Region.disc(*each, radius=radius) for each in self.centers[near].tolist()]

    def clearance(self, path: np.ndarray) -> float:
        """Return the least distance of the vehicle's circle from walls and obstacles. [m]."""
        gaps = np.hypot(*(path[:, None] - self.centers).T).T.min(axis=1) - RADIUS
        return float(np.minimum(gaps, WIDTH / 2 - np.abs(path[:, 0])).min() - self.half_width)


def corridor_of(seed: int, half_width: float) -> Corridor:
    """Return obstacles at random, with a gap beside each that the vehicle fits through."""
    rng = np.random.default_rng(seed)
    y = np.linspace(1.0, LENGTH - 0.8, OBSTACLES) + rng.uniform(-0.15, 0.15, OBSTACLES)
    x = rng.uniform(-0.45, 0.45, OBSTACLES)
    return Corridor(np.column_stack([x, y]), half_width)


def drive_corridor(
    vehicle: Vehicle, task: SamplingTask, seed: int, world: Dae
) -> tuple[float, float, Loop]:
    """Return the clearance, the distance from the goal, and the motion through a corridor."""
    half_width = max(abs(wheel.at[0]) for wheel in vehicle.wheels) + 0.08
    course = corridor_of(seed, half_width)
    decide = exact_controller(task, task.goal, course.seen)
    goal = (0.0, LENGTH)
    loop = closed_loop(decide, world, settle(world), 150, goal)
    away = float(np.hypot(*(loop.path()[-1] - goal)))
    return course.clearance(loop.path()), away, loop


def corridor() -> None:
    """Print collisions and distances from the goal."""
    ground = rough()
    vehicle = ROCKY
    model = commanded(direct_kinematics(vehicle, ground), speed=CRAWL)
    real = Bicubic(disturbed(ground.grid, 0.02, 2 * model.size, 1), ground.center, ground.mu)
    world = commanded(direct_kinematics(vehicle, real), speed=CRAWL)
    found = []
    for seed in range(20):
        task = SamplingTask(
            model,
            {"slip": 1.0},
            {"x": 0.0, "y": LENGTH},
            SPAN,
            {"forward": (-0.15, CRAWL), "yaw_rate": (-1.0, 1.0)},
            candidates=CANDIDATES,
            seed=seed,
        )
        found.append(drive_corridor(vehicle, task, seed, world)[:2])
    clearance, away = np.array(found).T
    reached = (clearance > 0) & (away < ARRIVED)
    print(
        f"reached without collision: {reached.sum()} of {reached.size}; least clearance "
        f"{1e3 * clearance.min():.0f} mm, largest distance from the goal {away.max():.2f} m"
    )


def main() -> None:
    """Run the parts that the command line names."""
    run_parts({"rate": rate, "follow": follow, "bicycle": bicycle, "corridor": corridor})
