"""What samples and repeated calls cost: Rocky 7 on the grid of wmrde, the three-wheeler on hills.

``python benchmarks/samples.py`` prints

1. CPU of one `simulate` over 5 m: integration alone, the rest of a call with two samples, each
   further sample, the whole call with 101 samples, and this over what it may take: integration,
   3 ms, and 0.05 ms (three-wheeler: 0.02 ms) a sample; beside it wmrde, a kinematic simulator in
   C++, as an audit of version 0.1.0 measured it on such a machine, 101 samples included there too;
2. growth with the number of samples: exponent from 1001 to 5001 samples;
3. `rollouts` of Rocky 7 over 2 m with 21 samples: runs a minute in one process, with inputs that
   are constant and with inputs that jump at every second sample; memory after 40 and 200 runs.

Every time is the least of a few calls. Integration is the call of the integrator.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from reference import heading

from slipfree import (
    Bicubic,
    Dae,
    Grid,
    SolverOptions,
    Trajectory,
    catalog,
    direct_kinematics,
    rollouts,
    settle,
    simulate,
)
from slipfree.solve import simulate as module

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "physics"))
sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from test_rovers import rocky_case, rover_ground

TURNS = 5
WMRDE = {1e-3: 5.4, 1e-4: 42.0}  # [ms]
CALL, FEW, SOME, MANY = 3.0, 101, 1001, 5001  # [ms], samples
Case = tuple[Dae, Trajectory, Any, float, float]


def rocky() -> Case:
    """Return model, start, inputs, duration [s] and the allowance of a sample [ms]."""
    return *rocky_case(rover_ground(), 0.0, 0.1), 10.0, 0.05


def three() -> Case:
    """Return the same of the paper's vehicle with its masses, so that forces are computed."""
    axis = np.linspace(-10, 10, 201)
    ground = Bicubic(Grid(axis, axis, 0.05 * np.add.outer(np.sin(axis), np.cos(1.3 * axis))))
    model = direct_kinematics(catalog.three_wheeler(), ground)
    inputs = model.inputs(right_rate=0.5, left_rate=0.45, steer_rate=0.0)
    return model, settle(model), inputs, 10.0, 0.02


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


def call(case: Case, options: SolverOptions, clock: Clock) -> None:
    """Print what one call costs."""
    model, start, inputs, duration, allowance = case

    def drive(count: int) -> tuple[float, float]:
        t = np.linspace(0, duration, count)
        return least(lambda: simulate(model, start, inputs, t, options=options), clock)

    (two, way), (few, _), (some, _) = map(drive, (2, FEW, SOME))
    sample = (some - few) / (SOME - FEW)
    allowed = way + CALL + allowance * FEW
    words = "compiled   " if options.compiled else "interpreted"
    peer = f"; wmrde {WMRDE[options.tolerance]:g} ms" if allowance == 0.05 else ""
    print(
        f"  {options.tolerance:.0e} {words}: integration {way:5.1f} ms, rest of a call "
        f"{two - way:4.1f} ms, a sample {sample:.3f} ms; {FEW} samples {few:5.1f} ms, "
        f"{few / allowed:.2f} of the allowance{peer}"
    )


def growth(case: Case, options: SolverOptions, clock: Clock) -> None:
    """Print how the CPU grows with the number of samples."""
    model, start, inputs, duration, _ = case
    times = []
    for count in (SOME, MANY):
        t = np.linspace(0, duration, count)
        times.append(least(lambda t=t: simulate(model, start, inputs, t, options=options), clock))
    exponent = np.log(times[1][0] / times[0][0]) / np.log(MANY / SOME)
    print(
        f"  {SOME} to {MANY} samples: {times[0][0]:.0f}, {times[1][0]:.0f} ms, exponent "
        f"{exponent:.2f}"
    )


def resident() -> float:
    """Return the memory of this process. [MB]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6


def many(case: Case, options: SolverOptions) -> None:
    """Print what rollouts cost."""
    model, start, _, _, _ = case
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


def main() -> None:
    """Print all lines."""
    heading()
    clock = Clock()
    for name, case in (("Rocky 7, 5 m", rocky()), ("three-wheeler, 1.4 m, with forces", three())):
        print(name)
        for compiled in (True, False):
            for tolerance in WMRDE:
                call(case, SolverOptions(tolerance=tolerance, compiled=compiled), clock)
        growth(case, SolverOptions(tolerance=1e-4, compiled=True), clock)
    print("rollouts of Rocky 7, 2 m, 21 samples, tolerance 1e-3, compiled")
    many(rocky(), SolverOptions(tolerance=1e-3, compiled=True))


if __name__ == "__main__":
    main()
