"""Driving laws of problems."""

from __future__ import annotations

from typing import Any

import numpy as np

from slipfree.catalog.step_climber import climber_of
from slipfree.control.path_following import follow, straight
from slipfree.control.reference_speeds import Noise
from slipfree.control.step_climbing import StepClimbing, check_period, climbing, held_torques
from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.records import Array
from slipfree.core.trajectory import Trajectory
from slipfree.files.tables import read_columns
from slipfree.geometry.path import Path
from slipfree.problem.build_ground import at
from slipfree.problem.build_world import World
from slipfree.problem.problem import Problem, S
from slipfree.problem.schema import Driver
from slipfree.terrain.solids import Profile, section_of
from slipfree.vehicle.tree import Vehicle


def build_law(
    problem: Problem[S],
    driver: Driver,
    dae: Dae,
    vehicle: Vehicle,
    start: Trajectory,
) -> Any:
    """Return the inputs that the driving law of a problem computes from state and time.

    Raises
    ------
    ProblemError
        If ``path`` and ``file`` do not fit the name of the law, the file cannot be read, or the law
        cannot drive the vehicle along the path.
    """
    with at(problem, ("driver",)):
        if driver.name == "straight":
            if driver.path is not None or driver.file is not None:
                key = "path" if driver.path is not None else "file"
                raise ModelError(
                    f"driver: expected no path with name = 'straight', found the key {key!r}; use "
                    "name = 'follow', or remove the key"
                )
            return straight(dae, vehicle, start, speed=driver.speed)
        return follow(dae, vehicle, Path(path_points(problem, driver)), speed=driver.speed)


def build_climbing(problem: Problem[Any], world: World) -> tuple[Dae, Any]:
    """Return the model of a step climber with its controller, and the inputs of this model.

    Raises
    ------
    ProblemError
        If the vehicle is not a step climber, or a number of the controller is out of range.
    """
    driver = problem.spec.driver
    with at(problem, ("driver", "control")):
        values = dict(driver.control)
        noise = values.pop("noise")
        control = StepClimbing(**values, noise=None if noise is None else Noise(**dict(noise)))
    with at(problem, ("vehicle",)):
        climber = climber_of(world.vehicle)
    if driver.period is not None:
        with at(problem, ("driver", "period")):
            check_period(driver.period, control, climber)
    with at(problem, ("driver", "control", "directions")):
        sampled = driver.period is not None
        dae = climbing(world.dae, world.vehicle, control, level_section(world), sampled=sampled)
    held = held_torques(dae, control) if sampled else {}
    return dae, dae.inputs(reference_speed=driver.speed, **held)


def level_section(world: World) -> Profile | None:
    """Return the section of level ground and solids in the vehicle's plane; None without it."""
    if not world.terrain.is_level:
        return None
    return section_of(world.prisms, float(world.terrain.grid.z[0, 0]))


def path_points(problem: Problem[S], driver: Driver) -> Array:
    """Return the points of the path that a driving law follows, shape (n, 2) [m].

    Raises
    ------
    ModelError
        If neither or both of ``path`` and ``file`` are given.
    DataError
        If the file cannot be read or has no columns x and y.
    """
    if (driver.path is None) == (driver.file is None):
        raise ModelError(
            "driver: name = 'follow' requires either 'path' (an array of [x, y]) or 'file', found "
            + ("neither; give one" if driver.path is None else "both; remove one")
        )
    if driver.path is not None:
        return np.array(driver.path)
    return np.array(read_columns(problem.folder / str(driver.file), "xy").rows())
