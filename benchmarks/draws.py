"""Fits of known truth: bias and coverage of 95 % intervals over draws of errors.

``python benchmarks draws [--count COUNT]`` fits logs of 40 s of three robots, with errors of 10 mm
and 10 mrad (`tests/helpers/drives.py`). Each drive has two draws with errors of opposite signs.
"""

import argparse

import common  # noqa: F401 - path of the helpers of tests
import numpy as np

from helpers.drives import DRAWN, ROBOTS, draws_of_fits


def main() -> None:
    """Print bias, deviation and coverage of each constant."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--count", type=int, default=200)
    count = parser.parse_args().count
    for robot, (truth, speed) in ROBOTS.items():
        errors, deviations, inside = draws_of_fits(truth, speed, count)
        print(f"{robot}, {count} draws: {100 * inside.mean():.1f} % inside")
        spread, stated = errors.std(axis=0), np.median(deviations, axis=0)
        for k, name in enumerate(DRAWN):
            print(
                f"  {name:21} bias {errors[:, k].mean() / spread[k]:+.2f} deviations, stated "
                f"{stated[k] / spread[k]:.2f} of one, inside {100 * inside[:, k].mean():.1f} %",
                flush=True,
            )
