"""Random problems: how they end, energy of climbs and drives, memory of a process over an hour.

``python benchmarks random_runs problems [--count N] [--first N] [--patience S]`` draws problems -
ground, vehicle, start, inputs and tolerance - from seeds 0 to 499, in separate processes with a
time limit, and prints their outcomes. Every failure is listed with its seed: a hang, a crash,
another exception, a warning, a refusal without a cause, or a run that violates a law of geometry.
``--seed 17`` prints one case; ``--set ground=flat tolerance=1e-6`` changes it, to isolate a cause.

``python benchmarks random_runs climbs`` (or ``drives``, ``overturns``) ``[--count N]`` runs 200
climbs (300 drives with inertia, 100 hang-ups and roll-overs of vehicles whose bodies bear load) of
`tests/helpers`, and prints how many end in each way, the largest error of the energy balance over
its bound, the longest run, and every run that is unfinished or fails. Every twentieth drive is
compared with its mirror image and with the drive turned by 90 degrees, over ten times the
tolerance. ``--seed 17`` prints one.

``python benchmarks random_runs soak [--minutes M] [--seed N]`` solves problems of all verbs and
models on new random grounds in one process, writes, reads, draws and reports the results, and
prints the resources of the process: resident memory, memory in use, integrators kept for later
calls, loaded libraries, open files and threads. Memory in use is that which C and C++ code, CasADi
and numpy included, has allocated and not freed; resident memory also contains freed memory that the
allocator of the C library keeps, and Python objects, whose number is printed. At the end it prints
the CPU of each kind, and the slopes of both memories per hour, from lines fitted to the second
half, with their standard errors. The exit code is 1 if a problem ended in a traceback.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import shutil
import subprocess
import tempfile
import time
import tomllib
import traceback
import warnings
from collections import Counter
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import asdict
from itertools import repeat
from pathlib import Path
from random import Random
from types import ModuleType
from typing import Any, NamedTuple

import matplotlib as mpl

mpl.use("Agg")
import numpy as np
import psutil
from common import PROBLEMS, apart

from helpers import random_climbs, random_dynamics, random_overturns
from helpers.fuzz_files import SIDE, bases, document
from helpers.random_cases import Outcome, draw, outcome
from slipfree import Bicubic, SolverOptions, catalog, direct_kinematics, rollouts
from slipfree.core.errors import SlipfreeError
from slipfree.files import netcdf
from slipfree.files.netcdf import export_path
from slipfree.problem.load import load_problem, verb_of
from slipfree.problem.report import report
from slipfree.problem.result import motion_facts, run_problem
from slipfree.problem.verbs.fit import constant_rows, facts, fit
from slipfree.show.html_page import page
from slipfree.show.plots import save
from slipfree.solve import integrator
from slipfree.terrain.synthetic import blank, power_law

SHIPPED = {  # problems that get a random ground, and their settings
    "quasi-statics": ("traction_hills", {"time": {"duration": 2.0, "step": 0.1}}),
    "rigid": ("rigid_hills", {"time": {"duration": 1.0, "step": 0.1}}),
    "dynamics": ("dynamics_rocks", {"time": {"duration": 0.5, "step": 0.05}}),
    "solids": ("dynamics_step", {"time": {"duration": 2.0, "step": 0.1}}),
    "soil": ("plan_sandy_slope", {"time": {"duration": 2.0, "step": 0.1}}),
}
KINDS = (*("direct", "inverse") * 2, "plan", "climb", "climb plan", "fit", "rollouts", *SHIPPED)
COMPILED = ("direct", "plan", "quasi-statics", "rigid", "dynamics", "soil")  # every third compiled
ROWS, RUNS = 121, 6  # of the log of a fit; of rollouts
EVERY = 30.0  # between two lines [s]
Table = dict[str, Any]
COUNT, WORKERS, PATIENCE = 500, 2, 60.0  # random problems; processes; time for a case [s]
RUNS_OF: dict[str, tuple[ModuleType, int]] = {
    "climbs": (random_climbs, 200),
    "drives": (random_dynamics, 300),
    "overturns": (random_overturns, 100),
}
MIRRORED = 20  # interval of the drives that are mirrored and turned


def solve_drawn(seed: int, settings: list[str]) -> dict[str, Any]:
    """Return the outcome of a drawn problem with some values replaced; warnings are errors."""
    case = draw(seed)
    for name, value in (setting.split("=", 1) for setting in settings):
        kind = type(getattr(case, name))
        case = case._replace(**{name: value == "True" if kind is bool else kind(value)})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            found = outcome(case)
        except Exception:
            found = Outcome("exception", faults=[traceback.format_exc()[-1500:]])
    found.faults += [f"warning: {each.category.__name__}: {each.message}" for each in caught]
    return {"seed": seed} | asdict(found)


def solve_apart(seed: int, patience: float) -> dict[str, Any]:
    """Return the outcome of a problem from a separate process, which may hang or crash."""
    try:
        return apart(solve_drawn, seed, [], timeout=patience)
    except subprocess.TimeoutExpired:
        failed = Outcome("hang", faults=[f"no end within {patience:g} s"])
    except subprocess.CalledProcessError as error:
        failed = Outcome("crash", faults=[f"exit code {error.returncode}"])
    return {"seed": seed} | asdict(failed)


def table(found: list[dict[str, Any]]) -> None:
    """Print the number of cases by outcome, extremes of measured values, and all errors."""
    counts = Counter((each["kind"], each["cause"]) for each in found)
    print("\noutcome    cause                  cases")
    for (kind, cause), count in sorted(counts.items(), key=lambda item: (item[0][0], -item[1])):
        print(f"{kind:10} {cause:22} {count:5}")
    grounds = Counter((draw(each["seed"]).ground, each["kind"]) for each in found)
    kinds = sorted({each["kind"] for each in found})
    print(f"\n{'ground':9}" + "".join(f"{kind:>10}" for kind in kinds))
    for ground in sorted({ground for ground, _ in grounds}):
        print(f"{ground:9}" + "".join(f"{grounds[ground, kind]:10}" for kind in kinds))
    print("\nmeasure                     runs    median   largest  seed")
    for name in sorted({name for each in found for name in each["measures"]}):
        values = [
            (each["measures"][name], each["seed"]) for each in found if name in each["measures"]
        ]
        middle, (most, seed) = float(np.median([value for value, _ in values])), max(values)
        print(f"{name:26} {len(values):5} {middle:9.1e} {most:9.1e} {seed:5}")
    bad = [each for each in found if each["faults"]]
    print(f"\n{len(bad)} of {len(found)} with faults")
    for each in bad:
        print(f"seed {each['seed']}: {draw(each['seed'])}\n  {each['kind']} {each['cause']}")
        print("".join(f"  - {fault}\n" for fault in each["faults"]), end="")


def ending_of(kind: str, index: int) -> tuple[str, random_dynamics.Ending, float]:
    """Return description, ending and CPU time [s] of a run of a kind."""
    runs, begin = RUNS_OF[kind][0], time.process_time()
    case = runs.draw(index)
    found = runs.ending(case)
    return case.words, found, time.process_time() - begin


def endings(kind: str, count: int) -> None:
    """Print the endings of runs of a kind."""
    kinds, worst, longest, total = Counter[str](), (0.0, ""), (0.0, ""), 0.0
    with ProcessPoolExecutor(WORKERS) as pool:
        for words, found, cost in pool.map(ending_of, repeat(kind, count), range(count)):
            kinds[found.kind] += 1
            worst, longest = max(worst, (found.ledger, words)), max(longest, (cost, words))
            total += cost
            if found.kind in ("unfinished", "failure", "not finite") or not found.ledger < 1:
                print(f"  {words}: {found.kind}, {found.words}, {found.ledger:.2g}", flush=True)
    counts = ", ".join(f"{name} {times}" for name, times in kinds.most_common())
    print(f"{count} {kind}, {total:.0f} s of CPU: {counts}")
    print(f"  error of the energy balance at most {worst[0]:.2g} of its bound: {worst[1]}")
    print(f"  longest run {longest[0]:.1f} s of CPU: {longest[1]}")


def views(count: int) -> None:
    """Print how far mirrored and turned drives are from those as drawn."""
    cases = [random_dynamics.draw(index) for index in range(0, count, MIRRORED)]
    for view in ("mirrored", "turned"):
        gaps = [(random_dynamics.difference(case, view), case.words) for case in cases]
        gap, words = max(gaps)
        print(
            f"  {len(gaps)} {view}: at most {gap / (10 * random_dynamics.TOLERANCE):.2g}: {words}"
        )


def drawn(kind: str, rng: Random) -> Table:
    """Return a problem on a new random ground."""
    if kind == "fit":
        data = tomllib.loads((PROBLEMS / "fit_skid_steer.toml").read_text())
        return data | {"law": {"coulomb": {"creep": rng.uniform(0.02, 0.2)}}}
    if kind.startswith("climb"):
        data = dict(bases("plan" if kind == "climb plan" else "direct")[-1])
        obstacle = {"step": {"height": rng.uniform(0.02, 0.09)}}
        data["terrain"] = {**data["terrain"], "obstacles": [obstacle]}
        data["time"] = {"duration": 0.6, "step": 0.005}
        return data
    if kind in SHIPPED:
        name, settings = SHIPPED[kind]
        data = tomllib.loads((PROBLEMS / f"{name}.toml").read_text()) | settings
        data.pop("output", None)
    else:
        data = dict(rng.choice(bases(kind)))
    if kind == "soil":
        rates = {name: rng.uniform(0.5, 3.0) for name in ("rear_right_rate", "rear_left_rate")}
        data = {key: data[key] for key in ("title", "terrain", "vehicle", "start", "time", "law")}
        data |= {"verb": "direct", "model": "quasi-static", "inputs": {**rates, "steer_rate": 0.0}}
    ground = data["terrain"]
    if "file" not in ground:
        rest = {key: ground[key] for key in ("friction", "obstacles") if key in ground}
        data["terrain"] = {"synthetic": _rough(rng), **rest}
    if kind == "solids":
        step = {"step": {"height": rng.uniform(0.02, 0.09)}, "y": rng.uniform(0.5, 0.55)}
        data["terrain"]["obstacles"] = [{**step, "heading": "90 deg"}]
    if kind == "plan":
        data["plan"] = {"intervals": rng.choice([4, 6, 8]), "degree": rng.choice([2, 3])}
    if kind in COMPILED and rng.random() < 0.3:
        data["solver"] = {**data.get("solver", {}), "compiled": True}
    return data


def _rough(rng: Random) -> Table:
    """Return the table of a random ground."""
    rough = {
        "rms": rng.uniform(0.005, 0.06),
        "hurst": rng.uniform(0.6, 1.0),
        "longest": 8.0,
        "shortest": 2.0,
        "seed": rng.randrange(10**6),
    }
    spacing = rng.choice([0.2, 0.25, 0.5])
    return {"x": [-4, 4], "y": [-4, 5], "spacing": spacing, "power_law": rough}


def solved(kind: str, rng: Random, folder: Path) -> str:
    """Solve a random problem of a kind; return the outcome."""
    if kind == "rollouts":
        return _rolled(rng)
    try:
        return (_fitted if kind == "fit" else whole)(drawn(kind, rng), folder, rng)
    except SlipfreeError as error:
        return type(error).__name__


def _rolled(rng: Random) -> str:
    """Simulate a model several times, with random inputs; return the outcomes."""
    rough = {"hurst": rng.uniform(0.6, 1.0), "longest": 8.0, "shortest": 2.0}
    grid = power_law(blank((-4, 4), (-4, 5), 0.25), rms=0.03, seed=rng.randrange(10**6), **rough)
    model = direct_kinematics(catalog.three_wheeler(), Bicubic(grid))
    rates = np.random.default_rng(rng.randrange(10**6)).uniform(0.3, 0.6, (RUNS, 4))
    inputs = {"right_rate": rates, "left_rate": rates, "steer_rate": 0.0}
    options = SolverOptions(tolerance=1e-4, compiled=rng.random() < 0.3)
    found = rollouts(model, {"heading": 0.0}, inputs, np.linspace(0, 2, 5), options=options)
    return " and ".join(sorted(set(found["outcome"].values.tolist())))


def _fitted(data: Table, folder: Path, rng: Random) -> str:
    """Fit numbers to a part of a log; return the outcome."""
    names, *rows = (PROBLEMS / "skid_steer_log.csv").read_text().splitlines()
    first = rng.randrange(len(rows) - ROWS)
    (folder / "skid_steer_log.csv").write_text("\n".join([names, *rows[first : first + ROWS]]))
    (folder / "p.toml").write_text(document(data))
    problem: Any = load_problem(folder / "p.toml", command="fit")
    found = fit(problem)
    facts(found)
    if found.fit is not None:
        constant_rows(found.fit)
    return "complete"


def whole(data: Table, folder: Path, rng: Random) -> str:
    """Solve a problem, write, read and draw the result; return the outcome."""
    for name, content in SIDE.items():
        (folder / name).write_text(content)
    shutil.copy(PROBLEMS / "vehicles" / "trailer.toml", folder / "vehicle.toml")
    file = folder / "p.toml"
    file.write_text(document(data))
    problem = load_problem(file)
    outcome = run_problem(problem)
    netcdf.write(folder / "p.nc", outcome.trajectory, outcome.arrays)
    motion = netcdf.read(folder / "p.nc")
    motion_facts(motion)
    netcdf.write_csv(folder / "p.csv", motion)
    if "y" in motion.columns:
        export_path(folder / "p.nc", folder / "p.geojson")
    if rng.random() < 0.2:
        save(verb_of(problem).figures(outcome), folder)
    if rng.random() < 0.1:
        page(report(folder / "p.nc", folder))
    return "complete" if motion.stop is None else "stopped"


def soak(minutes: float, seed: int) -> int:
    """Solve problems for a time, print the resources of the process; return 1 after an error."""
    rng, ends, costs, rows = Random(seed), Counter[str](), Counter[str](), []
    process, begin, last = psutil.Process(), time.monotonic(), -EVERY
    print(
        " minutes  problems  resident MB  in use MB  Python objects  integrators  libraries"
        "  open files  threads"
    )
    while (now := time.monotonic() - begin) < 60 * minutes:
        if now - last >= min(EVERY, 60 * minutes / 8):
            rows.append(_row(process, now, ends.total()))
            last = now
        kind, state = rng.choice(KINDS), rng.getstate()
        clock = time.process_time()
        with tempfile.TemporaryDirectory() as folder:
            try:
                ends[f"{kind} {solved(kind, rng, Path(folder))}"] += 1
            except Exception:  # what is to be found
                ends[f"{kind} traceback"] += 1
                again = Random()
                again.setstate(state)
                text = "" if kind == "rollouts" else document(drawn(kind, again))
                print(kind, text, traceback.format_exc(), sep="\n")
        costs[kind] += time.process_time() - clock
    rows.append(_row(process, time.monotonic() - begin, ends.total()))
    print(", ".join(f"{name} {n}" for name, n in sorted(ends.items())))
    print("CPU [s]: " + ", ".join(f"{kind} {cost:.0f}" for kind, cost in sorted(costs.items())))
    _slope(rows)
    return int(any(name.endswith("traceback") for name in ends))


class Row(NamedTuple):
    """Resources of the process at a time; memory in MB."""

    minutes: float
    resident: float
    in_use: float
    files: int


class _Heap(ctypes.Structure):
    """``struct mallinfo2`` of glibc: bytes of the heap and of blocks mapped one by one."""

    NAMES = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
    _fields_ = tuple((name, ctypes.c_size_t) for name in NAMES.split())


def _in_use() -> float:
    """Return the memory that was allocated and not freed [MB], NaN without glibc."""
    try:
        read = ctypes.CDLL(None).mallinfo2
    except (AttributeError, TypeError):
        return float("nan")
    read.restype = _Heap
    heap = read()
    return float(heap.uordblks + heap.hblkhd) / 1e6


def _row(process: psutil.Process, now: float, count: int) -> Row:
    """Print and return the resources of the process."""
    gc.collect()
    memory, files = process.memory_info().rss / 1e6, len([*Path("/proc/self/fd").iterdir()])
    row = Row(now / 60, memory, _in_use(), files)
    maps = Path("/proc/self/maps").read_text().split()
    cached = {word for word in maps if "slipfree/compiled" in word}
    print(
        f"{row.minutes:8.2f}{count:10}{memory:13.1f}{row.in_use:11.1f}{len(gc.get_objects()):16}"
        f"{integrator.count_idle():13}{len(cached):11}{files:12}{process.num_threads():9}",
        flush=True,
    )
    return row


def _slope(rows: list[Row]) -> None:
    """Print the slopes of memory over the second half."""
    late = [row for row in rows if row.minutes >= rows[-1].minutes / 2]
    if len(late) < 4:
        print("too short for a slope")
        return
    hours, *memories, files = np.array(late).T / [[60.0], [1.0], [1.0], [1.0]]
    for name, memory in zip(("resident memory", "memory in use"), memories, strict=True):
        (slope, _), covariance = np.polyfit(hours, memory, 1, cov=True)
        print(
            f"{name} over the second half: {slope:+.1f} +- {np.sqrt(covariance[0, 0]):.1f} MB/h, "
            f"{memory[0]:.1f} to {memory[-1]:.1f} MB, range {memory.min():.1f} to "
            f"{memory.max():.1f} MB"
        )
    print(f"open files {files[0]:.0f} to {files[-1]:.0f}")


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=("problems", *RUNS_OF, "soak"))
    parser.add_argument("--seed", type=int, help="one case, in full; of all draws of a soak")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE", help="change it")
    parser.add_argument("--first", type=int, default=0, help="first seed of random problems")
    parser.add_argument("--count", type=int, help="number of seeds")
    parser.add_argument("--patience", type=float, default=PATIENCE, help="time for a problem [s]")
    parser.add_argument("--minutes", type=float, default=60.0, help="duration of a soak")
    options = parser.parse_args()
    if options.kind == "soak":
        return soak(options.minutes, options.seed or 1)
    if options.kind in RUNS_OF:
        runs, count = RUNS_OF[options.kind]
        if options.seed is not None:
            case = runs.draw(options.seed)
            print(f"{case.words}: {runs.ending(case)}")
            return 0
        endings(options.kind, options.count or count)
        if options.kind == "drives":
            views(options.count or count)
    elif options.seed is not None:
        print(draw(options.seed), *options.set)
        print(json.dumps(solve_drawn(options.seed, options.set), indent=1))
    else:
        seeds = range(options.first, options.first + (options.count or COUNT))
        with ThreadPoolExecutor(WORKERS) as pool:
            table([*pool.map(solve_apart, seeds, repeat(options.patience))])
    return 0
