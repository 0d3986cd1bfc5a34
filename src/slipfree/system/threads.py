"""Restriction of linear algebra to one thread, which is faster for small matrices.

The restriction has an effect only before numpy is imported.
"""

import os

# environment variables with the number of threads
NAMES = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")


def single() -> None:
    """Set the number of threads of linear algebra to one, unless the user has set it."""
    for name in NAMES:
        os.environ.setdefault(name, "1")
