"""Results and times of two versions of the package, beside each other.

``python benchmarks/versions.py results OUT [--against OTHER] [--compiled] [--only NAME ...]`` runs
all shipped problems of motions, writes their results to the folder OUT and prints the exit code and
the CPU time of each. With ``--against`` it prints the largest difference to the results of the same
names in another folder, in units of the range of each variable (between 0.01 and 10). ``--no-run``
compares what is there.

``python benchmarks/versions.py times --old PYTHON [--new PYTHON] [--cases NAME ...]`` times the
cases below with the interpreters of two environments in which the package is installed. One
process each stays open, and they are called alternately, so that both see the same load. It prints
the least CPU time of each and the ratio of these minima.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from reference import heading
from scipy.io import netcdf_file

PROBLEMS = Path(__file__).parent.parent / "problems"
REPEATS = 9
SMALLEST, LARGEST = 1e-2, 10.0  # ranges that differences are divided by
CASES = (
    "three_wheeler",
    "rover",
    "plan 50",
    "plan 200",
    "three_wheeler compiled",
    "rover compiled",
    "plan 50 compiled",
    "three_wheeler without kernel",
    "rover without kernel",
    "model three_wheeler",
    "model rover",
    "residual three_wheeler",
    "residual rover",
    "jacobian three_wheeler",
    "jacobian rover",
    "hessian 50",
)
WORKER = r"""
import json, resource, sys, time
import casadi as ca, numpy as np
import slipfree as sf
from dataclasses import replace
from slipfree.plan.plan import plan
try:
    from slipfree.records import leaves
    from slipfree.solve.system import with_inputs
except ModuleNotFoundError:  # version 0.1.0
    from slipfree.named import leaves
    from slipfree.solve.loop import close as with_inputs
from slipfree.terrain import kernel

name = sys.argv[1]
compiled = name.endswith(" compiled")
if name.endswith("without kernel"):
    kernel.library = lambda: None
x, y = np.linspace(-6, 6, 241), np.linspace(-3, 9, 241)
hills = 0.1 * np.sin(1.3 * x)[:, None] * np.cos(0.9 * y) + 0.02 * np.sin(4 * x)[:, None]


def vehicle():
    if "rover" in name:
        return sf.rocky7()
    planned = name.startswith(("plan", "hessian"))
    return sf.three_wheeler(axle="fixed" if planned else "tilting")


def model():
    dae = sf.direct_kinematics(vehicle(), sf.Bicubic(sf.Grid(x, y, hills)))
    return replace(dae, compiled=compiled)


def best(function, number=200):
    least = float("inf")
    for _ in range(5):
        begin = time.process_time()
        for _ in range(number):
            function()
        least = min(least, (time.process_time() - begin) / number)
    return least


if name.startswith("model"):
    def call():
        dae = model()
        begin = time.process_time()
        with_inputs(dae, dae.inputs(**{each.full: 0.0 for each in leaves(dae.labels.u)}), 0)
        return time.process_time() - begin
elif name.startswith(("residual", "jacobian")):
    dae = model()
    law = {each.full: 0.4 for each in leaves(dae.labels.u)}
    system, start = with_inputs(dae, dae.inputs(**law), 0), sf.settle(dae)
    point = [0.0, dae.rows("x", start, 0), dae.rows("z", start, 0)[: system.moving], system.u[:, 0]]
    function = system.core
    if name.startswith("jacobian"):
        function = function.jacobian()
        point += [np.zeros(function.size1_in(4 + k)) for k in range(function.n_in() - 4)]
    buffer, memory = function.buffer()
    held = [np.zeros(function.nnz_in(k)) + np.ravel(each) for k, each in enumerate(point)]
    outs = [np.zeros(function.nnz_out(k)) for k in range(function.n_out())]
    for k, each in enumerate(held):
        buffer.set_arg(k, memoryview(each))
    for k, each in enumerate(outs):
        if each.size:
            buffer.set_res(k, memoryview(each))
    def call():
        return best(memory, 2000)
elif name.startswith(("plan", "hessian")):
    dae = model()
    start = sf.settle(dae, x=0.0, y=0.0, heading=0.0)
    law = dae.inputs(right_rate=0.45, left_rate=0.45, steer_rate=0.0)
    guess = sf.simulate(dae, start, law, np.linspace(0, 20, 201))
    rates = {f"{each}_rate": (-2.0, 2.0) for each in ("right", "left", "steer")}
    def found():
        return plan(dae, start, guess, goal={"x": 0.6, "y": 2.6}, duration=20.0, inputs=rates,
                    costs={"slip": 7e4, "effort": 0.01}, limits={"steer": (-1.0, 1.0)},
                    smooth=0.002, intervals=int(name.split()[1]))
    if name.startswith("plan"):
        def call():
            begin = time.process_time()
            found()
            return time.process_time() - begin
    else:
        kept = []
        make = ca.nlpsol
        def watching(label, solver, problem, options=None):
            result = make(label, solver, problem, options or {})
            kept.append(options["hess_lag"])
            return result
        ca.nlpsol = watching
        found()
        hessian = kept[0]
        point = [np.full(hessian.sparsity_in(k).shape, 0.3) for k in range(hessian.n_in())]
        def call():
            return best(lambda: hessian.call(point), 20)
else:
    dae = model()
    v = vehicle()
    def call():
        begin = time.process_time()
        start = sf.settle(dae, x=0.0, y=0.0, heading=0.0)
        law = sf.straight(dae, v, start, speed=0.5)
        sf.simulate(dae, start, law, np.linspace(0, 10, 101))
        return time.process_time() - begin

call()
print("ready", flush=True)
for _ in sys.stdin:
    print(json.dumps(call()), flush=True)
"""


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    runs = commands.add_parser("results")
    runs.add_argument("out", type=Path)
    runs.add_argument("--against", type=Path)
    runs.add_argument("--compiled", action="store_true")
    runs.add_argument("--only", nargs="*", default=[])
    runs.add_argument("--no-run", action="store_true")
    times = commands.add_parser("times")
    times.add_argument("--old", required=True)
    times.add_argument("--new", default=sys.executable)
    times.add_argument("--cases", nargs="*", default=CASES)
    times.add_argument("--repeats", type=int, default=REPEATS)
    asked = parser.parse_args()
    heading()
    if asked.command == "times":
        print_times(asked.old, asked.new, asked.cases, asked.repeats)
        return
    asked.out.mkdir(parents=True, exist_ok=True)
    if not asked.no_run:
        run_problems(asked.out, asked.only, compiled=asked.compiled)
    if asked.against:
        print_differences(asked.against, asked.out, asked.only)


def names(only: list[str]) -> list[str]:
    """Return the names of the shipped problems that make results."""
    found = sorted(path.stem for path in PROBLEMS.glob("*.toml"))
    return [name for name in found if name != "compare_axles" and (not only or name in only)]


def run_problems(out: Path, only: list[str], *, compiled: bool) -> None:
    """Run the shipped problems; print exit codes and wall time."""
    more = ["--set", "solver.compiled=true"] if compiled else []
    for name in names(only):
        command = [sys.executable, "-m", "slipfree", "run", str(PROBLEMS / f"{name}.toml")]
        begin = time.perf_counter()
        done = subprocess.run(
            [*command, "--no-draw", "-o", str(out / f"{name}.nc"), *more],
            check=False, capture_output=True, text=True,
        )  # fmt: skip
        if done.returncode == 2 and more:  # a step climber, which is not compiled
            done = subprocess.run(
                [*command, "--no-draw", "-o", str(out / f"{name}.nc")],
                check=False, capture_output=True, text=True,
            )  # fmt: skip
        seconds = time.perf_counter() - begin
        print(f"{name:22} exit code {done.returncode}, {seconds:6.1f} s", flush=True)


def variables(path: Path) -> dict[str, np.ndarray]:
    """Return the variables of a result."""
    with netcdf_file(path, mmap=False) as file:
        return {name: np.array(each.data) for name, each in file.variables.items()}


def differences(old: dict[str, np.ndarray], new: dict[str, np.ndarray]) -> dict[str, float]:
    """Return the largest difference of each variable over its range; infinite if none is left."""
    found = dict[str, float]()
    for name, before in old.items():
        if before.dtype.kind != "f":
            continue
        after = new.get(name)
        if after is None or after.shape != before.shape:
            found[name] = np.inf
            continue
        both = np.isfinite(before) & np.isfinite(after)
        if (np.isfinite(before) != both).any():
            found[name] = np.inf
        elif both.any():
            size = float(np.clip(np.ptp(before[both]), SMALLEST, LARGEST))
            found[name] = float(np.abs(before - after)[both].max()) / size
    return found


def print_differences(old: Path, new: Path, only: list[str]) -> None:
    """Print the largest differences of results of the same names."""
    for name in names(only):
        if not (old / f"{name}.nc").exists() or not (new / f"{name}.nc").exists():
            print(f"{name:22} no result")
            continue
        found = differences(variables(old / f"{name}.nc"), variables(new / f"{name}.nc"))
        worst = sorted(found, key=lambda each: -found[each])[:3]
        words = ", ".join(f"{each} {found[each]:.1e}" for each in worst)
        print(f"{name:22} {len(found)} variables, largest differences: {words}")


def print_times(old: str, new: str, cases: list[str], repeats: int) -> None:
    """Print the least time of each case with two interpreters, and the ratio."""
    print(f"{'case':30} {'old':>10} {'new':>10} {'new / old':>10}")
    for case in cases:
        workers = [worker(python, case) for python in (old, new)]
        found: list[list[float]] = [[], []]
        for _ in range(repeats):
            for each, values in zip(workers, found, strict=True):
                values.append(asked(each))
        for each in workers:
            each.stdin.close()
            each.wait()
        before, after = (min(values) for values in found)
        print(f"{case:30} {before:10.3g} {after:10.3g} {after / before:10.2f}", flush=True)


def worker(python: str, case: str) -> Any:
    """Start a process that times a case as often as it is asked to."""
    process = subprocess.Popen(
        [python, "-c", WORKER, case], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    if process.stdout.readline().strip() != "ready":
        raise SystemExit(f"{python}: {case} did not start")
    return process


def asked(process: Any) -> float:
    """Return one time [s]."""
    process.stdin.write("\n")
    process.stdin.flush()
    return float(json.loads(process.stdout.readline()))


if __name__ == "__main__":
    main()
