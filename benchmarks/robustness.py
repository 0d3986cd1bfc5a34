"""Check that random problems end regularly: complete, at a named limit, or refused by name.

``python benchmarks/robustness.py`` draws 500 problems - ground, vehicle, start, inputs and
tolerance - from seeds 0 to 499, each in a separate process with a time limit, and prints their
outcomes. Every failure is listed with its seed: a hang, a crash, another exception, a warning, a
refusal without a cause, or a run that violates a law of geometry.

``python benchmarks/robustness.py --seed 17`` prints one case; ``--set ground=flat tolerance=1e-6``
changes it, to isolate a cause.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import threading
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from reference import heading

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from helpers.random_cases import Case, Outcome, draw, outcome

COUNT = 500
WORKERS = 2
PATIENCE = 60.0  # for a case [s]
ANSWER = "outcome: "  # what a line with an outcome begins with


def one(case: Case) -> dict[str, Any]:
    """Return the outcome of a case, run in this process; warnings are errors."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        try:
            found = outcome(case)
        except Exception:
            found = Outcome("exception", faults=[traceback.format_exc()[-1500:]])
    found.faults += [f"warning: {each.category.__name__}: {each.message}" for each in heard]
    return {"seed": case.seed} | asdict(found)


def serve() -> None:
    """Read seeds, line by line, and print their outcomes."""
    for seed in sys.stdin:
        print(ANSWER + json.dumps(one(draw(int(seed)))), flush=True)


class Worker:
    """Child process that solves one case after another, and is replaced after a crash."""

    def __init__(self, patience: float) -> None:
        self.patience, self.child = patience, None

    def ask(self, seed: int) -> dict[str, Any]:
        """Return the outcome of a case, which may be a hang or a crash."""
        if self.child is None:
            command = [sys.executable, "-u", __file__, "--serve"]
            pipe = subprocess.PIPE
            self.child = subprocess.Popen(
                command, stdin=pipe, stdout=pipe, stderr=subprocess.STDOUT, text=True
            )
        child, said = self.child, []
        timer = threading.Timer(self.patience, child.kill)
        begin = time.perf_counter()
        timer.start()
        child.stdin.write(f"{seed}\n")
        child.stdin.flush()
        for line in child.stdout:
            if line.startswith(ANSWER):
                timer.cancel()
                found = json.loads(line.removeprefix(ANSWER))
                found["faults"] += [f"printed: {''.join(said)[:300]}"] if said else []
                return found
            said.append(line)
        self.child = None
        if time.perf_counter() - begin >= self.patience:
            faults, kind = [f"no end within {self.patience:g} s"], "hang"
        else:
            faults, kind = [f"exit code {child.wait()}: {''.join(said)[-300:]}"], "crash"
        return {"seed": seed} | asdict(Outcome(kind, faults=faults))

    def close(self) -> None:
        """End the child."""
        if self.child is not None:
            self.child.communicate("")


def every(seeds: range, patience: float) -> Iterator[dict[str, Any]]:
    """Yield the outcomes of many cases, in the order of their seeds."""
    mine, workers = threading.local(), []

    def ask(seed: int) -> dict[str, Any]:
        if not hasattr(mine, "worker"):
            mine.worker = Worker(patience)
            workers.append(mine.worker)
        return mine.worker.ask(seed)

    with ThreadPoolExecutor(WORKERS) as pool:
        yield from pool.map(ask, seeds)
    for worker in workers:
        worker.close()


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


def main() -> None:
    """Run one case, or all of them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, help="one case, told in full")
    parser.add_argument("--set", nargs="*", default=[], metavar="WORD=VALUE", help="change it")
    parser.add_argument("--first", type=int, default=0, help="first seed of many")
    parser.add_argument("--count", type=int, default=COUNT, help="how many seeds")
    parser.add_argument("--patience", type=float, default=PATIENCE, help="seconds for a case")
    parser.add_argument("--lines", type=Path, help="file for the outcomes, one JSON line each")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.serve:
        serve()
    elif given.seed is not None:
        as_drawn = draw(given.seed)
        pairs = (word.split("=", 1) for word in given.set)
        changes = {name: _like(getattr(as_drawn, name), value) for name, value in pairs}
        case = as_drawn._replace(**changes)
        print(case, json.dumps(one(case), indent=1), sep="\n")
    else:
        heading()
        found = []
        for each in every(range(given.first, given.first + given.count), given.patience):
            found.append(each)
            if given.lines:
                with given.lines.open("a") as file:
                    file.write(json.dumps(each) + "\n")
        table(found)


def _like(value: Any, words: str) -> Any:
    return words == "True" if isinstance(value, bool) else type(value)(words)


if __name__ == "__main__":
    main()
