"""Sweeps: gain by processes, and check that a killed sweep loses no run.

``python benchmarks sweep [RUNS]`` (200 by default) prints

1. the wall time of a sweep over seeded random grounds by one process and by two, each with one
   thread, and their ratio; also the time that the workers spend on the runs themselves, and the
   throughput of two independent processes on this machine relative to one;
2. the same sweep on two processes, killed with SIGKILL half-way and resumed: the numbers of
   finished runs that were kept and of runs done twice, and whether the tables are identical;
3. the CPU time of a run that shares map and model with the run before, relative to one that does
   not, and whether their results are identical, for three problems and a key of each.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from common import HERE, PROBLEMS

from slipfree.problem.inputs import recipe_of
from slipfree.problem.load import load_problem
from slipfree.sweep import KEPT, RunTask, work

PROBLEM = PROBLEMS / "paper_direct.toml"
RUNS = 200
ALONE = 300  # solutions of the reference NLP
TICK = 0.02  # between two looks at the log [s]
SHARED = (
    ("paper_direct", "inputs.right_rate", (0.5, 0.51, 0.52)),
    ("real_dem_direct", "driver.speed", (0.5, 0.51, 0.52)),
    ("dynamics_rocks", "start.heading", (0.1, 0.2, 0.3)),
)


def command(folder: Path, processes: int, runs: int) -> list[str]:
    """Return the command of the sweep."""
    words = f"--repeat {runs} --processes {processes} --no-draw -o {folder}".split()
    return [sys.executable, "-m", "slipfree", "sweep", str(PROBLEM), *words]


def rows(folder: Path) -> list[dict[str, object]]:
    """Return the finished runs in a log."""
    lines = (folder / "parts.jsonl").read_bytes().split(b"\n")[1:-1]
    return [json.loads(line) for line in lines]


def timed(folder: Path, processes: int, runs: int) -> tuple[float, float, float]:
    """Return the wall time of a sweep, the sum of those of its runs, and processor time. [s]."""
    begin, before = time.perf_counter(), processor()
    subprocess.run(command(folder, processes, runs), check=True, capture_output=True)
    wall, used = time.perf_counter() - begin, processor() - before
    return wall, sum(float(str(row["seconds"])) for row in rows(folder)), used


def processor() -> float:
    """Return the CPU time of all child processes that have ended [s]."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def apart() -> float:
    """Return the throughput of two independent processes relative to one."""
    code = f"from common import rosenbrock\nfor _ in range({ALONE}): rosenbrock()"

    def wall(count: int) -> float:
        begin = time.perf_counter()
        running = [subprocess.Popen([sys.executable, "-c", code], cwd=HERE) for _ in range(count)]
        for process in running:
            process.wait()
        return time.perf_counter() - begin

    return 2 * min(wall(1) for _ in range(2)) / min(wall(2) for _ in range(2))


def killed(folder: Path, runs: int) -> list[dict[str, object]]:
    """Start a sweep, kill it half-way, and return its finished runs."""
    process = subprocess.Popen(command(folder, 2, runs), stdout=subprocess.DEVNULL)
    log = folder / "parts.jsonl"
    while not log.exists() or log.read_bytes().count(b"\n") <= runs // 2:
        if process.poll() is not None:
            raise RuntimeError("the sweep ended before it was killed")
        time.sleep(TICK)
    process.kill()
    process.wait()
    return rows(folder)


def shared(name: str, key: str, values: tuple[float, ...]) -> str:
    """Return the CPU time of runs that share their model, and whether results are identical."""
    problem = load_problem(PROBLEM.with_name(f"{name}.toml"))
    tasks = [RunTask(k, recipe_of(problem, f"{key}={x}"), ()) for k, x in enumerate(values)]

    def results(*, share: bool) -> tuple[float, list[object]]:
        work(tasks[0])
        begin, found = time.process_time(), list[object]()
        for task in tasks[1:]:
            if not share:
                KEPT.clear()
            found.append(work(task).row.figures)
        return time.process_time() - begin, found

    (alone, expected), (together, found) = results(share=False), results(share=True)
    same = "the same" if found == expected else "other ones"
    return (
        f"{name}, {key}: {together / alone:.2f} times the CPU time of a run alone, results {same}"
    )


def main() -> None:
    """Print the times of a sweep, the remaining runs of a killed one, and the gain of sharing."""
    runs = int(sys.argv[1]) if sys.argv[1:] else RUNS
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        one, _, _ = timed(folder / "start", 1, 1)
        print(f"\n{PROBLEM.name}, {runs} seeded grounds; a sweep of one run takes {one:.2f} s")
        walls, used = {}, {}
        for count in (1, 2):
            walls[count], worked, used[count] = timed(folder / str(count), count, runs)
            idle = walls[count] - worked / count
            print(
                f"{count} process{'es' * (count > 1)}: {walls[count]:.1f} s; a run "
                f"{worked / runs:.3f} s, the rest (starting, importing, log, table) {idle:.1f} s; "
                f"processor {used[count]:.1f} s"
            )
        print(f"ratio {walls[1] / walls[2]:.2f}; of programs that share nothing {apart():.2f}")
        before = killed(folder / "killed", runs)
        timed(folder / "killed", 2, runs)
        after = rows(folder / "killed")
        kept = sum(row in after for row in before)
        twice = sum(count > 1 for count in Counter(str(row["run"]) for row in after).values())
        tables = {(folder / each / "table.csv").read_bytes() for each in ("1", "2", "killed")}
        print(
            f"killed after {len(before)} runs and resumed: {kept} kept, {twice} twice, "
            f"{len(after)} in all; table {'the same' if len(tables) == 1 else 'another one'}"
        )
    for name, key, values in SHARED:
        print(shared(name, key, values))
