"""Whether random problems end as they should: done, stopped by name, or refused by name.

``python benchmarks/robustness.py`` draws 500 problems - ground, vehicle, start, inputs and
tolerance - from seeds 0 to 499, each in a process of its own with a limit on its time, and prints
what became of them. Everything that must not be is listed with its seed: a hang, a crash, another
exception, a warning, a refusal without a cause, a run that breaks a law of geometry.

``python benchmarks/robustness.py --seed 17`` tells one; ``--set ground=flat tolerance=1e-6``
changes it, to find out what matters.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
import warnings
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from reference import heading

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from random_cases import Case, draw, outcome

COUNT = 500
WORKERS = 2
PATIENCE = 60  # seconds for a case


def one(case: Case) -> dict[str, Any]:
    """Return what becomes of a case, in this process; warnings are faults."""
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        found = outcome(case)
    found.faults += [f"warning: {each.category.__name__}: {each.message}" for each in heard]
    return asdict(found)


def apart(seed: int) -> dict[str, Any]:
    """Return what becomes of a case in a process of its own."""
    command = [sys.executable, __file__, "--seed", str(seed), "--json"]
    begin = time.perf_counter()
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        found = {"kind": "hang", "faults": [f"no end within {PATIENCE} s"]}
    else:
        found = _understood(done)
    return {"seed": seed, "cause": "", "words": "", "measures": {}} | found | {
        "wall": time.perf_counter() - begin
    }  # fmt: skip


def _understood(done: subprocess.CompletedProcess[str]) -> dict[str, Any]:
    if done.returncode < 0:
        return {"kind": "crash", "faults": [f"signal {-done.returncode}: {done.stderr[-300:]}"]}
    if done.returncode:
        return {"kind": "exception", "faults": [done.stderr[-1500:]]}
    *printed, last = done.stdout.strip().splitlines()
    found = json.loads(last)
    said = "\n".join(printed) + done.stderr
    if said.strip():
        found["faults"].append(f"printed: {said.strip()[:300]}")
    return dict(found)


def table(found: list[dict[str, Any]]) -> None:
    """Print how many ended how, the extremes of what was measured, and every fault."""
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
        values = [(each["measures"][name], each["seed"]) for each in found
                  if name in each["measures"]]  # fmt: skip
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
    parser.add_argument("--json", action="store_true", help="print only its outcome")
    parser.add_argument("--first", type=int, default=0, help="first seed of many")
    parser.add_argument("--count", type=int, default=COUNT, help="how many seeds")
    given = parser.parse_args()
    if given.seed is not None:
        as_drawn = draw(given.seed)
        pairs = (word.split("=", 1) for word in given.set)
        changes = {name: _like(getattr(as_drawn, name), value) for name, value in pairs}
        case = as_drawn._replace(**changes)
        if not given.json:
            print(case)
        print(json.dumps(one(case), indent=None if given.json else 1))
        return
    heading()
    seeds = range(given.first, given.first + given.count)
    with ThreadPoolExecutor(WORKERS) as pool:
        table(list(pool.map(apart, seeds)))


def _like(value: Any, words: str) -> Any:
    return words == "True" if isinstance(value, bool) else type(value)(words)


if __name__ == "__main__":
    main()
