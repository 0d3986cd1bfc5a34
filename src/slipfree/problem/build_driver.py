"""Driving laws of problems."""

from __future__ import annotations

from typing import Any

import numpy as np

from slipfree.control.path_following import follow, straight
from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.files.tables import read_columns
from slipfree.geometry.path import Path
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem, S
from slipfree.problem.schema import Driver
from slipfree.records import Array
from slipfree.trajectory import Trajectory
from slipfree.vehicle.tree import Vehicle


def build_law(
    problem: Problem[S],
    driver: Driver,
    dae: Dae,
    vehicle: Vehicle,
    start: Trajectory,
) -> Any:
    """Return inputs by the driving law of a problem, as functions of state and time."""
    with at(problem, ("driver",)):
        if driver.name == "straight":
            if driver.path is not None or driver.file is not None:
                raise ModelError(
                    "driver: expected no path with name = 'straight', found one; use name = "
                    "'follow', or remove the path"
                )
            return straight(dae, vehicle, start, speed=driver.speed)
        return follow(dae, vehicle, Path(path_points(problem, driver)), speed=driver.speed)


def path_points(problem: Problem[S], driver: Driver) -> Array:
    """Return the points of the path that a driving law follows, shape (n, 2) [m]."""
    if (driver.path is None) == (driver.file is None):
        raise ModelError(
            "driver: expected either path, an array of [x, y], or file for name = 'follow', found "
            + ("none; give one of them" if driver.path is None else "both; remove one")
        )
    return np.array(driver.path or read_columns(problem.folder / str(driver.file), "xy"))
