"""Single-threaded linear algebra: for small matrices, several threads only wait for each other.

The setting has an effect only before numpy is imported.
"""

import os

NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def single() -> None:
    """Set one thread for linear algebra, unless the user has set another number."""
    for name in NAMES:
        os.environ.setdefault(name, "1")
