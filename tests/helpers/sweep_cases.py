"""Sweeps shared by tests: a small problem, its grid, and functions to start, kill and read it."""

import csv
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil

from helpers.commands import invoke
from helpers.problem_files import rough_ground
from slipfree.problem.inputs import recipe_of
from slipfree.problem.load import load_problem
from slipfree.sweep import RunTask
from slipfree.system.parts import LOG

PROBLEM = """\
verb = "direct"
vehicle = { catalog = "three_wheeler" }
start = { heading = 0 }
driver = { name = "straight", speed = 1.0 }
time = { duration = 0.3, step = 0.1 }
""" + rough_ground("[-3, 3]", "[-3, 2.25]", 0.25, "rms = 0.02, longest = 4.0, shortest = 2.0", 1)
SPEED, ROUGH = "driver.speed", "terrain.synthetic.power_law.rms"
GRID = ["--vary", f"{SPEED}=0.5,1.0", "--vary", f"{ROUGH}=0.01,0.02", "--repeat", "3"]
RUNS = 12  # of the grid


def sweep_in(folder: Path, *words: str, code: int | None = None) -> Any:
    return invoke("sweep", folder / "p.toml", "-o", folder / "out", *words, code=code)


def begin_sweep(folder: Path, *words: str) -> subprocess.Popen[str]:
    """Begin a sweep in a process of its own, and return it when some runs are finished."""
    command = [sys.executable, "-m", "slipfree", "sweep", str(folder / "p.toml")]
    command += ["-o", str(folder / "out"), *words]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    log, end = folder / "out" / LOG, time.monotonic() + 600
    while not log.exists() or log.read_bytes().count(b"\n") < 3:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < end
        time.sleep(0.005)
    return process


def kill_sweep(process: subprocess.Popen[str]) -> None:
    """End a sweep at once; its processes end by themselves."""
    children = psutil.Process(process.pid).children(recursive=True)
    process.kill()
    process.communicate()
    _, alive = psutil.wait_procs(children, timeout=20)
    assert not alive


def log_lines(folder: Path) -> list[bytes]:
    return (folder / "out" / LOG).read_bytes().splitlines(keepends=True)


def table_rows(folder: Path) -> list[dict[str, str]]:
    with (folder / "out" / "table.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def tasks_of(file: Path, *settings: str) -> list[RunTask]:
    return [
        RunTask(k, recipe_of(load_problem(file), setting), (setting,))
        for k, setting in enumerate(settings, 1)
    ]
