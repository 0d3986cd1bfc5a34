"""Run random climbs, each in a separate process, and count their endings.

``python benchmarks/climb.py random`` runs 200 climbs, two at a time. It prints how many climb,
stall or tip over, and which are not finished or fail by an error, a crash, numbers that are not
finite, or a timeout. ``python benchmarks/climb_random.py 3 4`` prints the outcomes of the seeds 3
and 4.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from helpers.climb_drawn import drawn, drive, finite
from slipfree.climb.dynamics import prisms
from slipfree.models.obstacle_ending import obstacle_ending
from slipfree.vehicle.climber import side_view

COUNT, LONGEST = 200, 300.0  # seconds of a run


def one(seed: int) -> dict[str, object]:
    """Return the outcome of a seed."""
    case, clock = drawn(seed), time.process_time()
    run = drive(case)
    told = obstacle_ending(run, side_view(case.climber), prisms(case.profile))
    return {
        "name": told.name if finite(run) else "not finite",
        "words": told.words,
        "seconds": time.process_time() - clock,
        "real": float(run.t[-1]),
        "sampled": case.period is not None,
    }


def apart(seed: int) -> dict[str, object]:
    """Return the outcome of a seed, computed in a separate process that may crash."""
    command = [sys.executable, __file__, str(seed)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=LONGEST, check=False)
    except subprocess.TimeoutExpired:
        return {"name": "too long", "words": f"more than {LONGEST:g} s"}
    if done.returncode:
        return {"name": "fails", "words": done.stderr.strip().splitlines()[-1:]}
    return dict(json.loads(done.stdout.splitlines()[-1]))


def random(count: int = COUNT) -> None:
    """Print the endings of climbs."""
    with ThreadPoolExecutor(2) as pool:
        found = list(pool.map(apart, range(count)))
    ends = Counter(str(each["name"]) for each in found)
    print(
        f"{count} climbs at random: " + ", ".join(f"{name} {n}" for name, n in ends.most_common())
    )
    done = [each for each in found if "seconds" in each]
    for sampled in (False, True):
        factors = [each["real"] / each["seconds"] for each in done if each["sampled"] == sampled]
        if factors:
            print(
                f"  {'sampled' if sampled else 'continuous'}: {len(factors)}, times real time "
                f"{min(factors):.1f} to {max(factors):.1f}"
            )
    for seed, each in enumerate(found):
        if each["name"] not in ("climbs", "stalls", "tips over"):
            print(f"  seed {seed}: {each['name']}: {each['words']}")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        for given in sys.argv[1:]:
            print(json.dumps(one(int(given))))
    else:
        random()
