"""Run random climbs in three dimensions and count their endings.

``python benchmarks/climb_solids.py`` runs 200 climbs of `tests/helpers/random_climbs.py`, one after
another, and prints how many end in each way, the largest error of the energy balance over its
bound, and every climb that is unfinished or fails. ``python benchmarks/climb_solids.py 3 4`` prints
the endings of climbs 3 and 4.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from pathlib import Path

from reference import heading

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from helpers.random_climbs import draw, ending

COUNT = 200


def main(count: int = COUNT) -> None:
    """Print the endings of climbs."""
    heading()
    begin, kinds, worst = time.process_time(), Counter[str](), (0.0, "")
    for index in range(count):
        case = draw(index)
        found = ending(case)
        kinds[found.kind] += 1
        worst = max(worst, (found.ledger, case.words))
        if found.kind in ("unfinished", "failure") or not found.ledger < 1:
            print(f"  {case.words}: {found.kind}, {found.words}, {found.ledger:.2g}", flush=True)
    counts = ", ".join(f"{kind} {times}" for kind, times in kinds.most_common())
    print(f"{count} climbs over solids, {time.process_time() - begin:.0f} s of CPU: {counts}")
    print(f"  error of the energy balance at most {worst[0]:.2g} of its bound: {worst[1]}")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        for given in sys.argv[1:]:
            case = draw(int(given))
            print(f"{case.words}: {ending(case)}")
    else:
        main()
