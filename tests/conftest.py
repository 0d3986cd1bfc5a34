"""Fixtures shared by the tests."""

import os

# Before numpy is imported: threads of processes side by side wait for each other.
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")
os.environ["SLIPFREE_CACHE"] = ""  # nothing that was compiled before


@pytest.fixture
def rng():
    return np.random.default_rng(20261121)
