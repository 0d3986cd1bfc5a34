"""One thread for linear algebra: its matrices are small here, and threads only wait for each other.

It counts if it is asked for before numpy is imported.
"""

import os

NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def single() -> None:
    """Ask for one thread, where the user has not asked for another number."""
    for name in NAMES:
        os.environ.setdefault(name, "1")
