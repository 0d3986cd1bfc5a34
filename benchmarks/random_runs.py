"""Run random climbs and drives with inertia, count their endings, and check their energy.

``python benchmarks/random_runs.py climbs`` runs 200 climbs of `tests/helpers/random_climbs.py`, one
after another, and prints how many end in each way, the largest error of the energy balance over its
bound, and every climb that is unfinished or fails. ``... drives`` does the same for 300 drives of
`tests/helpers/random_dynamics.py`, and prints the largest difference of every twentieth from its
mirror image and from the drive turned by 90 degrees, over ten times the tolerance. With numbers,
such as ``... climbs 3 4``, it prints the endings of these alone.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from pathlib import Path
from types import ModuleType

from reference import heading

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from helpers import random_climbs, random_dynamics

KINDS: dict[str, tuple[ModuleType, int]] = {
    "climbs": (random_climbs, 200),
    "drives": (random_dynamics, 300),
}
EVERY = 20  # of the drives that are mirrored and turned


def endings(kind: str) -> None:
    """Print the endings of runs of a kind."""
    runs, count = KINDS[kind]
    begin, kinds, worst = time.process_time(), Counter[str](), (0.0, "")
    for index in range(count):
        case = runs.draw(index)
        found = runs.ending(case)
        kinds[found.kind] += 1
        worst = max(worst, (found.ledger, case.words))
        if found.kind in ("unfinished", "failure") or not found.ledger < 1:
            print(f"  {case.words}: {found.kind}, {found.words}, {found.ledger:.2g}", flush=True)
    counts = ", ".join(f"{name} {times}" for name, times in kinds.most_common())
    print(f"{count} {kind}, {time.process_time() - begin:.0f} s of CPU: {counts}")
    print(f"  error of the energy balance at most {worst[0]:.2g} of its bound: {worst[1]}")


def views() -> None:
    """Print how far mirrored and turned drives are from those as drawn."""
    cases = [random_dynamics.draw(index) for index in range(0, KINDS["drives"][1], EVERY)]
    for view in ("mirrored", "turned"):
        gaps = [(random_dynamics.difference(case, view), case.words) for case in cases]
        gap, words = max(gaps)
        print(
            f"  {len(gaps)} {view}: at most {gap / (10 * random_dynamics.TOLERANCE):.2g}: {words}"
        )


if __name__ == "__main__":
    chosen = sys.argv[1]
    if numbers := sys.argv[2:]:
        for case in map(KINDS[chosen][0].draw, map(int, numbers)):
            print(f"{case.words}: {KINDS[chosen][0].ending(case)}")
    else:
        heading()
        endings(chosen)
        if chosen == "drives":
            views()
