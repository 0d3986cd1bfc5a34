"""How CPU times grow: wheels, map nodes, plan intervals; start-up.

``python benchmarks growth [PART ...]``; the last lines of a table are exponents: the slope of a
line through the logarithms of all rows, and that of the last two rows, to which fixed costs
contribute least. Each part runs in a process with one thread.

wheels   vehicles of 3 to 12 wheels, three of them rigid and the others on springs, over hills,
         interpreted: building the model with its start, a step of the integrator, a sample
map      nodes of a map: its ground, the model with its start, integration over 8 m
plan     intervals: an iteration of IPOPT with compiled and cached functions
calls    Rocky 7 over 5 m and the three-wheeler on hills, the least of a few calls: integration
         alone, the rest of a call with two samples, each further sample, the call with 101 samples;
         `rollouts` of Rocky 7 over 2 m with 21 samples: runs a minute in one process, with inputs
         that are constant or jump; memory after 40 and 200 runs
start    imports and help in new processes, wall time
"""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from common import apart, run_parts
from common import least as least_wall

from helpers.cases import hills, rocky_case, rover_ground
from plan import planned
from slipfree import (
    Analytic,
    Bicubic,
    Dae,
    Grid,
    Mesh,
    Search,
    SolverOptions,
    Trajectory,
    direct_kinematics,
    dynamics,
    quasi_statics,
    rollouts,
    settle,
    simulate,
    straight,
)
from slipfree.catalog import three_wheeler
from slipfree.plan.ipopt import Iterate
from slipfree.solve import integrator as module
from slipfree.system.forks import THREAD_COUNTS
from slipfree.vehicle.sections import Torus
from slipfree.vehicle.tree import Body, Coordinate, Joint, Vehicle, Wheel

SIDES = (200, 500, 1000, 2000, 4000)  # nodes of maps along a side
WHEELS = (3, 4, 6, 8, 10, 12)
MODELS = {"kinematics": direct_kinematics, "quasi-statics": quasi_statics, "dynamics": dynamics}
SPACING, SPEED, FEW, MANY = 0.1, 0.5, 2, 101  # [m], [m/s], samples
Costs = dict[str, float]
SIZES = (25, 50, 100, 200, 400)  # intervals of a plan
EASY = {"slip": 1e3, "effort": 0.01}  # costs of a plan with few iterations
TURNS = 5
CALLS = (2, 101, 1001)  # samples
Case = tuple[Dae, Trajectory, Any, float]


def rocky() -> Case:
    """Return model, start, inputs and duration [s]."""
    return *rocky_case(rover_ground(), 0.0, 0.1), 10.0


def three() -> Case:
    """Return the same of the paper's vehicle with its masses, so that forces are computed."""
    axis = np.linspace(-10, 10, 201)
    ground = Bicubic(Grid(axis, axis, 0.05 * np.add.outer(np.sin(axis), np.cos(1.3 * axis))))
    model = direct_kinematics(three_wheeler(), ground)
    inputs = model.inputs(right_rate=0.5, left_rate=0.45, steer_rate=0.0)
    return model, settle(model), inputs, 10.0


class Clock:
    """Sum of the CPU of all calls of the integrator. [s]."""

    def __init__(self) -> None:
        self.seconds, self.run = 0.0, module._run
        module._run = self

    def __call__(self, *given: Any) -> Any:
        """Call the integrator."""
        begin = time.process_time()
        found = self.run(*given)
        self.seconds += time.process_time() - begin
        return found


def least(task: Callable[[], object], clock: Clock, turns: int = TURNS) -> tuple[float, float]:
    """Return the least CPU of a task, and that of the integrator in this call. [ms]."""
    found = []
    for _ in range(turns + 1):
        clock.seconds, begin = 0.0, time.process_time()
        task()
        found.append((1e3 * (time.process_time() - begin), 1e3 * clock.seconds))
    return min(found[1:])


def table(words: str, sizes: Sequence[int], costs: Callable[[int], Costs]) -> None:
    """Print the costs of each size in milliseconds, and their exponents."""
    rows = [costs(size) for size in sizes]
    x, y = np.log(sizes), np.log([[*row.values()] for row in rows])
    slopes = {"exponent": np.polyfit(x, y, 1)[0], "at the end": (y[-1] - y[-2]) / (x[-1] - x[-2])}
    lines = [(str(size), [*row.values()]) for size, row in zip(sizes, rows, strict=True)]
    print(f"\n{words:24}" + "".join(f"{name:>17}" for name in rows[0]))
    for first, values in lines:
        print(f"{first:>24}" + "".join(f"{value:17.4g}" for value in values))
    for first, values in slopes.items():
        print(f"{first:>24}" + "".join(f"{value:17.2f}" for value in values), flush=True)


def timed(task: Callable[[], Any]) -> tuple[Any, float]:
    """Return the result of a task and its CPU time [ms]."""
    begin = time.process_time()
    return task(), 1e3 * (time.process_time() - begin)


def vehicle(count: int) -> Vehicle:
    """Return a vehicle of three rigid wheels and others on springs, in two rows."""
    rigid = {"right": (0.4, 0.0), "left": (-0.4, 0.0), "front": (0.0, 1.8)}
    sprung = {f"sprung_{k}": (0.4 * (-1) ** k, 0.3 * (1 + k // 2)) for k in range(count - 3)}
    wheels = [
        Wheel(
            name,
            name if name in sprung else "platform",
            (0.0, 0.0, 0.0) if name in sprung else (*rigid[name], 0.0),
            Torus(0.03, 0.12),
            driven=True,
            mass=2.0,
        )
        for name in (*rigid, *sprung)
    ]
    springs, slides = list[Coordinate](), list[Joint]()
    for name, at in sprung.items():
        spring = {"stiffness": 1500.0, "rest": -0.02, "damping": 60.0}
        springs.append(Coordinate(f"travel_{name}", "suspension", "travel", **spring))
        slides.append(Joint(name, "platform", "z", (*at, 0.0), f"travel_{name}", motion="slide"))
    body = Body(60.0, (0.0, 0.7, 0.1))
    return Vehicle(f"{count} wheels", tuple(springs), tuple(slides), tuple(wheels), body)


def of_wheels(model: str, clock: Clock) -> Callable[[int], Costs]:
    """Return the function of the costs of a motion in a model by number of wheels."""
    ground, options = (
        Analytic(lambda x, y: 0.3 * hills(x, y), mu=0.7),
        SolverOptions(tolerance=1e-6),
    )

    def build(made: Vehicle) -> tuple[Any, Any]:
        dae = MODELS[model](made, ground)
        return dae, settle(dae, x=0.1, y=0.0)

    def costs(count: int) -> Costs:
        made = vehicle(count)
        building, _ = least(lambda: build(made), clock, 3)
        dae, start = build(made)
        inputs = dae.inputs(**{f"{w.name}_rate": SPEED / w.radius for w in made.wheels})

        def drive(samples: int) -> Any:
            t = np.linspace(0, 2 / SPEED, samples)
            return simulate(dae, start, inputs, t, options=options)

        (two, way), (many, _) = (least(lambda n=n: drive(n), clock, 5) for n in (FEW, MANY))
        steps = drive(FEW).statistics["steps"]
        return {"building": building, "step": way / steps, "sample": (many - two) / (MANY - FEW)}

    return costs


def of_map(clock: Clock) -> Callable[[int], Costs]:
    """Return the function of the costs of a drive by number of nodes."""
    body = three_wheeler(mass=0.0, wheel_mass=0.0)

    def costs(nodes: int) -> Costs:
        side = round(nodes**0.5)
        axis = SPACING * (np.arange(side) - side // 2)
        grid = Grid(axis, axis, 0.1 * np.add.outer(np.sin(axis), np.cos(1.3 * axis)))
        terrain, making = timed(lambda: Bicubic(grid))
        (dae, start), building = timed(lambda: build(terrain))
        inputs = straight(dae, start, speed=SPEED)
        t = np.linspace(0, 8 / SPEED, MANY)
        _, way = least(lambda: simulate(dae, start, inputs, t), clock, 3)
        return {"ground": making, "model": building, "integration": way}

    def build(terrain: Bicubic) -> tuple[Any, Any]:
        dae = direct_kinematics(body, terrain)
        return dae, settle(dae, x=0.0, y=-4.0)

    return costs


def of_plan(intervals: int) -> Costs:
    """Return the costs of an iteration by number of intervals."""
    times = list[tuple[str, int, float]]()

    def record(words: str, iterate: Iterate) -> bool:
        times.append((words, iterate.number, time.process_time()))
        return True

    mesh, search = Mesh(intervals, continuous=False), Search(progress=record)
    planned(Analytic(hills), costs=EASY, mesh=mesh, search=search, compiled=True)
    each = [b[2] - a[2] for a, b in pairwise(times) if a[1] < b[1]]
    return {"iteration": 1e3 * float(np.mean(each))}


def call(case: Case, options: SolverOptions, clock: Clock) -> None:
    """Print the costs of one call."""
    model, start, inputs, duration = case

    def drive(count: int) -> tuple[float, float]:
        t = np.linspace(0, duration, count)
        return least(lambda: simulate(model, start, inputs, t, options=options), clock)

    (two, way), (few, _), (some, _) = map(drive, CALLS)
    words = "compiled   " if options.compiled else "interpreted"
    print(
        f"  {options.tolerance:.0e} {words}: integration {way:5.1f} ms, rest of a call "
        f"{two - way:4.1f} ms, a sample {(some - few) / (CALLS[2] - CALLS[1]):.3f} ms; "
        f"{CALLS[1]} samples {few:5.1f} ms"
    )


def calls() -> None:
    """Print the costs of single calls and of rollouts."""
    clock = Clock()
    for name, case in (("Rocky 7, 5 m", rocky()), ("three-wheeler, 1.4 m, with forces", three())):
        print(name)
        for compiled in (True, False):
            for tolerance in (1e-3, 1e-4):
                call(case, SolverOptions(tolerance=tolerance, compiled=compiled), clock)
    print("rollouts of Rocky 7, 2 m, 21 samples, tolerance 1e-3, compiled")
    many(rocky(), SolverOptions(tolerance=1e-3, compiled=True))


def resident() -> float:
    """Return the memory of this process. [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


def many(case: Case, options: SolverOptions) -> None:
    """Print what rollouts cost."""
    model, start, _, _ = case
    t, rng = np.linspace(0, 4, 21), np.random.default_rng(0)
    names = [label.full for label in model.labels.u.wheels]
    rest = {label.full: 0.0 for label in model.labels.u.joints}
    for words, steps in (("constant inputs", 1), ("inputs that jump 9 times", 10)):
        memory = list[float]()
        for count in (40, 160):
            rates = 0.5 / 0.065 * rng.uniform(0.8, 1.2, (count, steps))
            values = np.repeat(rates, 20 // steps, axis=1)
            begin = time.process_time()
            found = rollouts(model, start, dict.fromkeys(names, values) | rest, t, options=options)
            cpu = time.process_time() - begin
            memory.append(resident())
        complete = float((found["outcome"] == "complete").mean())
        print(
            f"  {words}: {60 * count / cpu:.0f} runs a minute, {100 * complete:.0f} % complete; "
            f"memory {memory[0]:.0f}, {memory[1]:.0f} MB, results {found.nbytes / 1e6:.0f} MB"
        )


def start_up() -> None:
    """Print the wall time of imports and help in new processes."""
    for words in (["-c", "import casadi"], ["-c", "import slipfree"], ["-m", "slipfree", "--help"]):
        command = [sys.executable, *words]
        seconds = least_wall(
            lambda c=command: subprocess.run(c, check=True, capture_output=True), 5
        )
        print(f"python {' '.join(words):24} {seconds:.2f} s")


def print_table(subject: str) -> None:
    """Print the tables of a subject."""
    clock = Clock()
    if subject == "wheels":
        for model in MODELS:
            table(f"wheels, {model} [ms]", WHEELS, of_wheels(model, clock))
    elif subject == "map":
        table("nodes of a map [ms]", [side**2 for side in SIDES], of_map(clock))
    elif subject == "plan":
        of_plan(SIZES[0])  # compiles the functions
        table("intervals of a plan [ms]", SIZES, of_plan)
    elif subject == "calls":
        calls()
    else:
        start_up()


def main() -> None:
    """Print the parts."""
    threads = dict.fromkeys(THREAD_COUNTS, "1")
    names = ("wheels", "map", "plan", "calls", "start")
    run_parts({name: partial(apart, print_table, name, variables=threads) for name in names})
