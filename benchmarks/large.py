"""Measure times and memory of commands with large vehicles, sweeps and results.

``python benchmarks/large.py`` measures the imported package. The result of a million samples
repeats a short one; ``python benchmarks/large.py FILE`` writes it in a separate process, since the
peak memory of a command includes that of the process that starts it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from reference import heading

from slipfree.files.netcdf import read, write
from slipfree.trajectory import Column

SAMPLES, POINTS = 1_000_000, 100_000
PROBLEM = Path(__file__).parents[1] / "problems" / "paper_direct.toml"


def slipfree(*words: str) -> list[str]:
    """Return a command of the package."""
    return [sys.executable, "-m", "slipfree", *words]


def measure(name: str, command: list[str], folder: Path) -> None:
    """Print wall time, CPU time and peak memory of a command."""
    process = subprocess.Popen(
        command, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    begin = time.perf_counter()
    _, status, usage = os.wait4(process.pid, 0)
    wall, memory = time.perf_counter() - begin, usage.ru_maxrss / 1e3
    code = os.waitstatus_to_exitcode(status)
    cpu = usage.ru_utime + usage.ru_stime
    print(f"{name:44} {wall:6.2f} s, CPU {cpu:6.2f} s, {memory:6.0f} MB, exit code {code}")


def repeat(file: Path, count: int) -> None:
    """Repeat the samples of a result file up to a number of samples."""
    run = read(file)
    rows = np.resize(np.arange(run.t.size), count)
    columns = {name: Column(c.label, c.values[rows]) for name, c in run.columns.items()}
    write(file, replace(run, t=np.linspace(0, run.t[-1], count), columns=columns))


def measure_all(folder: Path) -> None:
    """Print the times of all commands."""
    run = slipfree("run", str(PROBLEM), "-o", "r.nc", "--no-draw", "--set", "time.duration=2")
    for command in (run, [sys.executable, __file__, str(folder / "r.nc")]):
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
    measure("python -c 'import casadi'", [sys.executable, "-c", "import casadi"], folder)
    size = (folder / "r.nc").stat().st_size / 1e6
    measure(f"info, {SAMPLES} samples, {size:.0f} MB", slipfree("info", "r.nc"), folder)
    measure("report of it", slipfree("report", "r.nc"), folder)
    axis = f"start.heading=0:1:{POINTS}"
    plan = slipfree("sweep", str(PROBLEM), "--vary", axis, "--dry-run")
    measure(f"sweep of {POINTS} points, planned", plan, folder)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        repeat(Path(sys.argv[1]), SAMPLES)
    else:
        heading()
        with tempfile.TemporaryDirectory() as scratch:
            measure_all(Path(scratch))
