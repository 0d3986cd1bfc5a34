"""Measure path following over 100 m of hills, with and without the tilt term of the law.

``python benchmarks/follow.py``
"""

from __future__ import annotations

import numpy as np
from reference import heading

from slipfree import Bicubic, Path, Trajectory, direct_kinematics, follow, settle, simulate
from slipfree.catalog import three_wheeler
from slipfree.control import path_following as laws
from slipfree.terrain.synthetic import blank, power_law

WAY = np.array([(0, 0), (25, 3), (50, 0), (75, -3), (100, 0)], dtype=float)
SPEED = 0.5  # [m/s]


def cross_track(run: Trajectory, path: Path) -> float:
    """Return the largest distance of a sample from the path. [m]."""
    places = path.at(np.linspace(0, path.length, 20001))
    squares = (run["x"][:, None] - places.x) ** 2 + (run["y"][:, None] - places.y) ** 2
    return float(np.sqrt(squares.min(axis=1)).max())


def main() -> None:
    """Print both runs."""
    heading()
    ground = blank((-10.0, 110.0), (-30.0, 30.0), 0.25)
    ground = power_law(ground, rms=0.15, hurst=0.9, longest=20.0, shortest=6.0, seed=4)
    vehicle, path = three_wheeler(), Path(WAY)
    dae = direct_kinematics(vehicle, Bicubic(ground))
    place = path.at(np.zeros(1))
    start = settle(dae, heading=float(place.heading[0] - np.arctan(0.5 * place.curvature[0])))
    t, gain = np.linspace(0, path.length / SPEED, 401), laws.TILT_GAIN
    print(f"{path.length:.0f} m of hills, relief {np.ptp(ground.z):.2f} m, at {SPEED} m/s")
    for words, laws.TILT_GAIN in (("the law", gain), ("without the tilt term", 0.0)):
        run = simulate(dae, start, follow(dae, vehicle, path, speed=SPEED), t)
        tilt = max(np.abs(run[f"tilt_{side}"]).max() for side in ("right", "left"))
        print(f"{words:22} largest tilt {tilt:.4f} rad, cross-track {cross_track(run, path):.4f} m")


if __name__ == "__main__":
    main()
