"""Tests of a route, a plan and a drive around a hole in a ragged map without a window."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slipfree.core.outcome import Outcome
from slipfree.problem.load import load_problem
from slipfree.problem.result import run_problem
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.grid_ops import hole_distance

PROBLEM = """
[terrain]
file = "site.npz"
[vehicle]
catalog = "three_wheeler"
axle = "fixed"
[start]
x = 10.0
y = 4.0
[solver]
tolerance = 1e-6
"""
PLAN = """
verb = "plan"
goal = { x = 10.0, y = 16.0 }
costs = { effort = 0.01 }
limits = { steer = [-0.8, 0.8] }
bounds = { right_rate = [0, 3], left_rate = [0, 3], steer_rate = [-1, 1] }
plan = { intervals = 20, smooth = 0.002 }
driver = { name = "route", speed = 0.5, turning_radius = 2.5 }
time = { duration = 60.0, step = 0.25 }
"""
DRIVE = """
verb = "direct"
driver = { name = "straight", speed = 0.5 }
time = { duration = 60.0, step = 0.5 }
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a map of hills in a ragged diamond around a hole."""
    x = 0.25 * np.arange(81)
    z = 0.1 * np.sin(0.6 * x)[:, None] * np.cos(0.5 * x)
    border = 12.5 + 0.6 * np.sin(3 * x)[:, None]
    ragged = np.abs(x[:, None] - 10) + np.abs(x - 10) > border
    pit = np.hypot(x[:, None] - 10.3, x - 10) < 1.2
    np.savez(tmp_path / "site.npz", x=x, y=x, z=np.where(ragged | pit, np.nan, z))
    return tmp_path


def _solved(folder: Path, text: str):
    (folder / "p.toml").write_text(f"{text}{PROBLEM}")
    return run_problem(load_problem(folder / "p.toml"))


def _clearance(result) -> np.ndarray:
    """Return the least distance of the contacts from holes at each sample [m]."""
    run, grid = result.trajectory, result.setup.ground.grid
    distance = Bicubic(type(grid)(grid.x, grid.y, hole_distance(grid)))
    return distance.elevation(run["contact_x"], run["contact_y"]).min(axis=1)


@pytest.mark.slow
def test_a_plan_leads_around_the_hole(folder: Path) -> None:
    found = _solved(folder, PLAN)
    run, grid = found.trajectory, found.setup.ground.grid
    assert run.outcome is Outcome.COMPLETE
    assert np.hypot(run["x"][-1] - 10, run["y"][-1] - 16) < 0.01
    assert not grid.touches(grid.holes, run["contact_x"], run["contact_y"]).any()
    assert _clearance(found).min() > 0
    assert np.abs(run["x"] - 10.3).max() > 1.2 + 0.5  # around it, by half the track


def test_a_drive_ends_at_the_hole(folder: Path) -> None:
    found = _solved(folder, DRIVE)
    run = found.trajectory
    assert run.outcome is Outcome.LIMIT
    assert "reaches a hole in the map" in run.stop.words
    assert 0 < _clearance(found)[-1] < 0.25  # a cell
