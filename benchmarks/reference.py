"""Print the versions, the machine, and reference times with which to compare all timings."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import time

import casadi as ca
import numpy as np
import scipy


def heading() -> None:
    """Print versions and the reference line, timed now."""
    versions = f"casadi {ca.__version__}, numpy {np.__version__}, scipy {scipy.__version__}"
    print(f"python {platform.python_version()}, {versions}")
    print(f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores")
    print(
        f"reference line: python -c 'import casadi' {least(import_casadi):.2f} s, "
        f"chained Rosenbrock NLP (500 unknowns, IPOPT) {least(rosenbrock):.2f} s"
    )


def least(task: object, repeats: int = 3) -> float:
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
