"""Solve random problems of all kinds in one process, and check that its memory does not grow.

``python benchmarks/soak.py --minutes 60 [--seed N]`` makes a new random ground every time,
simulates, plans, climbs, writes, reads, draws and reports, and prints the resources of the process:
resident memory, open files and threads. At the end it prints the slope of memory per hour, from a
line fitted to the second half, and its standard error. The exit code is 1 if a problem ended in a
traceback.
"""

from __future__ import annotations

import argparse
import gc
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter
from pathlib import Path
from random import Random

import matplotlib as mpl

mpl.use("Agg")
import numpy as np
import psutil

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from helpers.fuzz_files import SIDE, bases, document
from slipfree.errors import SlipfreeError
from slipfree.files import netcdf
from slipfree.files.export import export_path
from slipfree.problem.load import load_problem
from slipfree.problem.report import report
from slipfree.problem.result import motion_facts
from slipfree.problem.solve import run_problem
from slipfree.problem.verbs.registry import verb_of
from slipfree.show.html_report import page
from slipfree.show.plots import save

KINDS = ("direct", "direct", "direct", "inverse", "inverse", "plan", "climb")
COMPILED = ("direct", "plan")  # of these every third, what is compiled stays loaded
ROOT = Path(__file__).parent.parent
EVERY = 30.0  # between two lines [s]


def drawn(kind: str, rng: Random) -> str:
    """Return a problem on a new random ground."""
    data = dict(rng.choice(bases(kind)))
    if kind == "climb":
        data["profile"] = {"step": {"height": rng.uniform(0.02, 0.09)}}
        data["time"] = {"duration": 0.6, "step": 0.005}
    elif "file" not in data["terrain"]:
        rough = {
            "rms": rng.uniform(0.005, 0.06),
            "hurst": rng.uniform(0.6, 1.0),
            "longest": 8.0,
            "shortest": 2.0,
            "seed": rng.randrange(10**6),
        }
        made = {
            "x": [-4, 4],
            "y": [-4, 5],
            "spacing": rng.choice([0.2, 0.25, 0.5]),
            "power_law": rough,
        }
        data["terrain"] = {"synthetic": made}
    if kind == "plan":
        data["plan"] = {"intervals": rng.choice([4, 6, 8]), "degree": rng.choice([2, 3])}
    if kind in COMPILED and rng.random() < 0.3:
        data["solver"] = {**data.get("solver", {}), "compiled": True}
    return document(data)


def whole(text: str, folder: Path, rng: Random) -> str:
    """Solve a problem, write, read and draw the result; return the outcome."""
    for name, content in SIDE.items():
        (folder / name).write_text(content)
    shutil.copy(ROOT / "problems" / "vehicles" / "trailer.toml", folder / "vehicle.toml")
    file = folder / "p.toml"
    file.write_text(text)
    try:
        problem = load_problem(file)
        outcome = run_problem(problem)
    except SlipfreeError as error:
        return type(error).__name__
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
    rng, ends, rows = Random(seed), Counter[str](), []
    process, begin, last = psutil.Process(), time.monotonic(), -EVERY
    print(f"{'minutes':>8}{'problems':>10}{'resident MB':>13}{'open files':>12}{'threads':>9}")
    while (now := time.monotonic() - begin) < 60 * minutes:
        if now - last >= min(EVERY, 60 * minutes / 8):
            rows.append(_row(process, now, ends.total()))
            last = now
        kind = rng.choice(KINDS)
        text = drawn(kind, rng)
        with tempfile.TemporaryDirectory() as folder:
            try:
                ends[f"{kind} {whole(text, Path(folder), rng)}"] += 1
            except Exception:  # what is to be found
                ends[f"{kind} traceback"] += 1
                print(text, traceback.format_exc(), sep="\n")
    rows.append(_row(process, time.monotonic() - begin, ends.total()))
    print(", ".join(f"{name} {n}" for name, n in sorted(ends.items())))
    _slope(np.array(rows))
    return int(any(name.endswith("traceback") for name in ends))


def _row(process: psutil.Process, now: float, count: int) -> tuple[float, float, float]:
    """Print the resources of the process; return minutes, resident memory [MB] and open files."""
    gc.collect()
    memory, files = process.memory_info().rss / 1e6, len([*Path("/proc/self/fd").iterdir()])
    print(
        f"{now / 60:>8.2f}{count:>10}{memory:>13.1f}{files:>12}{process.num_threads():>9}",
        flush=True,
    )
    return now / 60, memory, files


def _slope(rows: np.ndarray) -> None:
    """Print the slope of memory over the second half."""
    late = rows[rows[:, 0] >= rows[-1, 0] / 2]
    if len(late) < 4:
        print("too short for a slope")
        return
    (slope, _), covariance = np.polyfit(late[:, 0] / 60, late[:, 1], 1, cov=True)
    print(
        f"memory over the second half: {slope:+.1f} +- {np.sqrt(covariance[0, 0]):.1f} MB/h, "
        f"{late[0, 1]:.1f} to {late[-1, 1]:.1f} MB; open files {late[0, 2]:.0f} to "
        f"{late[-1, 2]:.0f}"
    )


def main() -> int:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Soak.")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    return soak(asked.minutes, asked.seed)


if __name__ == "__main__":
    sys.exit(main())
