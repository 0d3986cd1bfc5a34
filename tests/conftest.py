"""Fixtures shared by the tests."""

import os
import signal
import sys
import warnings

# Before numpy is imported: threads of processes side by side wait for each other.
os.environ["OPENBLAS_NUM_THREADS"] = "1"

import matplotlib
import numpy as np
import pytest

from helpers.rounding import depends_on_rounding
from slipfree.terrain import kernel

matplotlib.use("Agg")
# Jobs of a shell in the background ignore Ctrl-C, and so would all that they start.
signal.signal(signal.SIGINT, signal.default_int_handler)
os.environ["SLIPFREE_CACHE"] = ""  # nothing that was compiled before


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        if depends_on_rounding(item.function):
            item.add_marker("rounding")


@pytest.fixture(autouse=True)
def _no_progress_lines(monkeypatch):
    """Keep slow runs from printing lines that fast ones do not print."""
    monkeypatch.setattr("slipfree.cli.console.FIRST_LINE", np.inf)


@pytest.fixture(autouse=True)
def _coarse_figures(monkeypatch):
    """Draw figures with fewer pixels, in a third less time."""
    if "slipfree.show.plots" in sys.modules:
        monkeypatch.setattr("slipfree.show.plots.DPI", 100)


@pytest.fixture
def direct_reads(request, monkeypatch):
    """Read files of other programs in this process, except in tests that are marked `bounded`."""

    def call(function, *arguments, **_):
        with warnings.catch_warnings(action="ignore"):
            return function(*arguments)

    if request.node.get_closest_marker("bounded") is None:
        for place in ("system.processes", "files.urdf.meshes"):
            monkeypatch.setattr(f"slipfree.{place}.bounded_call", call)


@pytest.fixture
def built():
    """Tests run where the package was installed with a compiler, in CI always."""
    if kernel.library() is None:
        if os.environ.get("CI"):
            pytest.fail("the kernel was not built")
        pytest.skip("no C compiler was found when slipfree was installed")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return an empty folder, which is the current one."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def rng():
    return np.random.default_rng(20261121)
