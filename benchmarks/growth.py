"""Measure how costs grow with wheels, nodes of a map, intervals of a plan, and samples.

``python benchmarks/growth.py [wheels|map|plan|samples]`` prints all tables or those named, with
the exponent of each cost: the slope of a line through the logarithms. CPU times are the least of a
few calls; each vehicle, map and plan has its own process, whose peak memory is printed.

wheels    vehicles of 3 to 12 wheels, of which three are rigid and the others on springs, 2 m over
          hills, interpreted: building a model with its start, one step of the integrator, the
          integration, and a whole call with 101 samples
map       nodes of a map in ``.npz``: reading it, making a model with its start, 10 m of a motion
plan      25 to 400 intervals: an iteration of IPOPT, the search, the whole call with verification;
          compiled and cached
samples   of one motion, compiled: a call of `simulate`, and its memory
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from maps import peak
from reference import heading
from samples import Clock, least, rocky, three

from plan import EASY, hills, planned, search
from slipfree import (
    Analytic,
    Bicubic,
    Grid,
    SolverOptions,
    direct_kinematics,
    dynamics,
    quasi_statics,
    settle,
    simulate,
    straight,
)
from slipfree.catalog import three_wheeler
from slipfree.files.maps.elevation import read_grid
from slipfree.vehicle.sections.torus import Torus
from slipfree.vehicle.tree import Body, Coordinate, Joint, Vehicle
from slipfree.vehicle.wheel import Wheel

WHEELS, NODES = (3, 4, 6, 8, 10, 12), (100, 200, 400, 1000, 2000, 4000)
INTERVALS, SAMPLES = (25, 50, 100, 200, 400), (1001, 5001, 20001, 100001)
MODELS = {"kinematics": direct_kinematics, "quasi-statics": quasi_statics, "dynamics": dynamics}
SPACING, SPEED, TURNS = 0.1, 0.5, 3  # [m], [m/s], calls
Row = dict[str, float]


def vehicle(count: int) -> Vehicle:
    """Return a vehicle of three rigid wheels and others on springs, in two rows."""
    at = {"right": (0.4, 0.0), "left": (-0.4, 0.0), "front": (0.0, 1.8)}
    springs, slides, wheels = [], [], []
    for k in range(count - 3):
        name = f"sprung_{k}"
        at[name] = (0.4 * (-1) ** k, 0.3 * (1 + k // 2))
        words = "travel of a wheel, up positive"
        springs.append(
            Coordinate(
                f"travel_{k}", "suspension", words, stiffness=1500.0, rest=-0.02, damping=60.0
            )
        )
        slides.append(Joint(name, "platform", "z", (*at[name], 0.0), f"travel_{k}", motion="slide"))
    for name, (x, y) in at.items():
        parent, place = (
            (name, (0.0, 0.0, 0.0)) if name.startswith("sprung") else ("platform", (x, y, 0.0))
        )
        wheels.append(Wheel(name, parent, place, Torus(0.03, 0.12), driven=True, mass=2.0))
    body = Body(60.0, (0.0, 0.7, 0.1))
    return Vehicle(f"{count} wheels", tuple(springs), tuple(slides), tuple(wheels), body)


def of_wheels(model: str, count: int) -> Row:
    """Return the costs of a motion of a vehicle. [ms]."""
    ground = Analytic(lambda x, y: 0.3 * hills(x, y), mu=0.7)
    clock, t = Clock(), np.linspace(0, 2.0 / SPEED, 101)
    make, options = MODELS[model], SolverOptions(tolerance=1e-6)

    def build() -> tuple[Any, Any]:
        dae = make(vehicle(count), ground)
        return dae, settle(dae, x=0.1, y=0.0)

    building, _ = least(build, clock, 1)
    dae, start = build()
    rates = {f"{w.name}_rate": SPEED / w.radius for w in vehicle(count).wheels}
    inputs = dae.inputs(**rates)
    whole, way = least(lambda: simulate(dae, start, inputs, t, options=options), clock, TURNS)
    steps = simulate(dae, start, inputs, t, options=options).statistics["steps"]
    return {
        "building [ms]": building,
        "steps": steps,
        "one step [ms]": way / steps,
        "integration [ms]": way,
        "call [ms]": whole,
        "peak [MB]": peak(),
    }


def of_map(count: int) -> Row:
    """Return the costs of reading a map, of making a model on it, and of a motion."""
    axis = SPACING * (np.arange(count) - count // 2)
    grid = Grid(axis, axis, 0.1 * np.add.outer(np.sin(axis), np.cos(1.3 * axis)))
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "map.npz"
        np.savez(file, x=grid.x, y=grid.y, z=grid.z)
        return json.loads(_apart("drive", str(file)))


def drive(file: str) -> Row:
    """Return the costs of a map in a file. [ms, MB]."""
    clock, before = Clock(), peak()
    reading, _ = least(lambda: read_grid(file), clock, TURNS)
    grid = read_grid(file)

    def build() -> tuple[Any, Any]:
        dae = direct_kinematics(three_wheels(), Bicubic(grid))
        return dae, settle(dae, x=0.0, y=-4.0)

    building, _ = least(build, clock, TURNS)
    dae, start = build()
    inputs = straight(dae, three_wheels(), start, speed=SPEED)
    t = np.linspace(0, 8.0 / SPEED, 101)
    whole, way = least(lambda: simulate(dae, start, inputs, t), clock, TURNS)
    return {
        "reading [ms]": reading,
        "building [ms]": building,
        "integration [ms]": way,
        "call [ms]": whole,
        "memory [MB]": peak() - before,
    }


def three_wheels() -> Vehicle:
    """Return the paper's vehicle without masses."""
    return three_wheeler(mass=0.0, wheel_mass=0.0)


def of_plan(count: int) -> Row:
    """Return the costs of a plan on a number of intervals."""
    planned(Analytic(hills), costs=EASY, intervals=INTERVALS[0], compiled=True)
    begin = time.process_time()
    found, _ = planned(Analytic(hills), costs=EASY, intervals=count, compiled=True)
    whole = time.process_time() - begin
    iterations = sum(stage.iterations for stage in found.stages)
    functions = sum(stage.seconds["functions"] for stage in found.stages)
    return {
        "unknowns": found.program.scale.size,
        "iterations": iterations,
        "functions [ms/iteration]": 1e3 * functions / iterations,
        "iteration [ms]": 1e3 * search(found) / iterations,
        "search [s]": search(found),
        "call [s]": whole,
        "peak [MB]": peak(),
    }


def of_samples(vehicle_: str, count: int) -> Row:
    """Return the costs of one motion with a number of samples."""
    model, start, inputs, duration, _ = {"Rocky 7": rocky, "three-wheeler": three}[vehicle_]()
    clock, t = Clock(), np.linspace(0, duration, count)
    options = SolverOptions(tolerance=1e-4, compiled=True)
    whole, way = least(lambda: simulate(model, start, inputs, t, options=options), clock, TURNS)
    return {"integration [ms]": way, "call [ms]": whole, "peak [MB]": peak()}


def _apart(*words: str) -> str:
    """Return the last line that this file prints in a separate process."""
    done = subprocess.run(
        [sys.executable, __file__, "--part", *words], capture_output=True, text=True, check=False
    )
    if done.returncode:
        sys.exit(done.stderr)
    return done.stdout.splitlines()[-1]


PARTS = {
    "of_wheels": of_wheels,
    "of_map": of_map,
    "drive": drive,
    "of_plan": of_plan,
    "of_samples": of_samples,
}


def table(words: str, part: str, sizes: Sequence[int], *before: str) -> None:
    """Print the costs of each size, and their exponents."""
    rows = [json.loads(_apart(part, *before, str(size))) for size in sizes]
    names = [*rows[0]]
    print(f"\n{words}\n{'':>10}" + "".join(f"{name:>{len(name) + 3}}" for name in names))
    for size, row in zip(sizes, rows, strict=True):
        print(f"{size:>10}" + "".join(f"{row[n]:{len(n) + 3}.4g}" for n in names))
    power = 2 if part == "of_map" else 1  # costs over the number of nodes, not of a side
    x = power * np.log(sizes)
    slopes = [np.polyfit(x, np.log([row[n] for row in rows]), 1)[0] for n in names]
    print(
        f"{'exponent':>10}"
        + "".join(f"{k:{len(n) + 3}.2f}" for n, k in zip(names, slopes, strict=True))
    )
    last = np.diff(x[-2:])[0]
    ends = [np.log(rows[-1][n] / rows[-2][n]) / last for n in names]
    print(
        f"{'at the end':>10}"
        + "".join(f"{k:{len(n) + 3}.2f}" for n, k in zip(names, ends, strict=True)),
        flush=True,
    )


def main(asked: Sequence[str]) -> None:
    """Print the tables that are asked for."""
    heading()
    if "wheels" in asked:
        for model in MODELS:
            table(f"wheels, {model}", "of_wheels", WHEELS, model)
    if "map" in asked:
        table("nodes of a side of a map", "of_map", NODES)
    if "plan" in asked:
        table("intervals of a plan", "of_plan", INTERVALS)
    if "samples" in asked:
        for name in ("Rocky 7", "three-wheeler"):
            table(f"samples, {name}", "of_samples", SAMPLES, name)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--part"]:
        name, *words = sys.argv[2:]
        given: list[Any] = [int(word) if word.isdigit() else word for word in words]
        print(json.dumps(PARTS[name](*given)))
    else:
        main(sys.argv[1:] or ["wheels", "map", "plan", "samples"])
