"""Check that the motion of a vehicle does not depend on its size.

``python benchmarks/scales.py`` multiplies all lengths of kinematic problems - vehicle, ground,
start, path, speeds - by 1e-6 to 1e6 and prints, for each scale, the largest difference of the
scaled motion from that at scale 1, over all kinematic quantities and samples, in units of the
tolerance, 1e-8. The tolerance of lengths is relative to the size of the vehicle, so that it is
scaled too. ``python benchmarks/scales.py 0.01 1000`` uses other scales.
"""

from __future__ import annotations

import sys
from pathlib import Path

from reference import heading

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from helpers.scale_cases import CASES, difference
from slipfree import SlipfreeError, Trajectory

SCALES = (1e-6, 1e-4, 1e-3, 1e-2, 1e-1, 1e1, 1e2, 1e3, 1e4, 1e6)
WIDTH = 9  # of a column


def cell(first: Trajectory, name: str, scale: float) -> str:
    """Return the difference of a case at a scale as text of one column."""
    try:
        run = CASES[name](scale)
    except SlipfreeError:
        return "fails"
    if (run.stop and run.stop.name) != (first.stop and first.stop.name):
        return "stops"
    return f"{difference(first, run, scale)[1]:.1e}"


def main(scales: tuple[float, ...]) -> None:
    """Print a row for each case and a column for each scale."""
    heading()
    print(f"{'largest difference [tolerances]':32}" + "".join(f"{s:>{WIDTH}g}" for s in scales))
    for name, motion in CASES.items():
        first = motion(1.0)
        cells = (cell(first, name, scale) for scale in scales)
        print(f"{name:32}" + "".join(f"{each:>{WIDTH}}" for each in cells), flush=True)


if __name__ == "__main__":
    main(tuple(map(float, sys.argv[1:])) or SCALES)
