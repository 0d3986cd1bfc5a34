"""Shared by benchmarks: versions and machine, parts of a script, calls in separate processes."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import scipy

HERE = Path(__file__).parent
PROBLEMS = HERE.parent / "problems"
TESTS = HERE.parent / "tests"
sys.path.append(str(TESTS))  # helpers that tests share
CALL = (
    "import importlib, json, sys; sys.path.insert(0, sys.argv[1]); "
    "function = getattr(importlib.import_module(sys.argv[2]), sys.argv[3]); "
    "print('\\n' + json.dumps(function(*json.loads(sys.argv[4]))))"
)


def heading() -> None:
    """Print versions, machine and reference times, to which all timings can be compared."""
    versions = f"casadi {ca.__version__}, numpy {np.__version__}, scipy {scipy.__version__}"
    print(f"python {platform.python_version()}, {versions}")
    print(f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores")
    print(
        f"reference line: python -c 'import casadi' {least(import_casadi):.2f} s, "
        f"chained Rosenbrock NLP (500 unknowns, IPOPT) {least(rosenbrock):.2f} s",
        flush=True,
    )


def run_parts(parts: Mapping[str, Callable[[], object]]) -> None:
    """Run the parts of a script that the command line names, by default all."""
    names = sys.argv[1:] or list(parts)
    if unknown := [name for name in names if name not in parts]:
        sys.exit(f"expected parts among {', '.join(parts)}, found {', '.join(unknown)}")
    for name in names:
        print(f"\n{name}", flush=True)
        parts[name]()


def apart(
    function: Callable[..., Any],
    *arguments: Any,
    timeout: float | None = None,
    variables: Mapping[str, str] | None = None,
) -> Any:
    """Return the result of a function of a script, called in a separate process.

    Arguments and result are JSON; lines that the function prints are printed.
    """
    name = Path(function.__code__.co_filename).stem
    command = [sys.executable, "-c", CALL, str(HERE), name, function.__name__]
    done = subprocess.run(
        [*command, json.dumps(arguments)],
        env={**os.environ, **(variables or {})},
        stdout=subprocess.PIPE,
        text=True,
        timeout=timeout,
        check=True,
    )
    *lines, result = done.stdout.rstrip("\n").split("\n")
    print("\n".join(lines).rstrip("\n"), end="\n" if any(lines) else "", flush=True)
    return json.loads(result)


def cpu(task: Callable[[], Any], repeats: int = 3) -> tuple[float, Any]:
    """Return the least CPU time of a call [s], and its result; calls take a second together."""
    times, result = [], None
    while len(times) < repeats or sum(times) < 1.0:
        begin = time.process_time()
        result = task()
        times.append(time.process_time() - begin)
    return min(times), result


def least(task: Callable[[], object], repeats: int = 3) -> float:
    """Return the least wall time of a few calls. [s]."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        task()
        times.append(time.perf_counter() - begin)
    return min(times)


def import_casadi() -> None:
    """Import CasADi in a fresh process."""
    subprocess.run([sys.executable, "-c", "import casadi"], check=True)


def rosenbrock() -> None:
    """Solve a fixed NLP."""
    x = ca.SX.sym("x", 500)
    f = ca.sum1(100 * (x[1:] - x[:-1] ** 2) ** 2 + (1 - x[:-1]) ** 2)
    options = {"print_time": False, "ipopt": {"print_level": 0, "sb": "yes"}}
    ca.nlpsol("nlp", "ipopt", {"x": x, "f": f, "g": x[0] - x[-1]}, options)(x0=0.5, lbg=0, ubg=0)
