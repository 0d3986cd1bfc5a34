"""From a problem of direct kinematics to a model, a start and inputs."""

from __future__ import annotations

from typing import Any

import numpy as np

from slipfree.control.path_following import follow, straight
from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.geometry.path import Path
from slipfree.models.montana import montana_kinematics
from slipfree.problem import schema
from slipfree.problem.build_common import (
    Setup,
    build_start,
    build_terrain,
    build_vehicle,
    check_names,
    read_columns,
    samples,
)
from slipfree.problem.build_ground import at, build_ground
from slipfree.problem.build_model import build_model, slip_law
from slipfree.problem.load import Problem, S
from slipfree.records import Array
from slipfree.trajectory import Trajectory
from slipfree.vehicle.tree import Vehicle


def build_direct(problem: Problem[S], spec: schema.Direct) -> Setup:
    """Return the model, the settled start and the inputs of a problem."""
    ground = build_ground(problem)
    with at(problem, ("vehicle",)):
        vehicle = build_vehicle(spec.vehicle, problem.folder)
    terrain = build_terrain(problem, ground)
    dae: Dae
    model = dae = build_model(problem, spec, vehicle, terrain)
    check_names(problem, dae, spec.inputs)
    start = build_start(problem, dae)
    t, rates = samples(spec.time, spec.inputs or {})
    if spec.formulation == "montana":
        with at(problem, ("formulation",)):
            if spec.model != "kinematics":
                raise ModelError(f"'montana' expects model = 'kinematics', found {spec.model!r}")
            dae = montana_kinematics(vehicle, terrain, slip=slip_law(problem, spec))
    if spec.driver is None:
        driven = "inputs " + ", ".join(spec.inputs or {})
        with at(problem, ("inputs",)):
            inputs = dae.inputs(**rates)
    else:
        driven = f"driver {spec.driver.name}"
        inputs = build_law(problem, spec.driver, dae, vehicle, start)
    return Setup(ground, terrain, vehicle, model, dae, start, inputs, t, driven)


def build_law(
    problem: Problem[S],
    driver: schema.Driver,
    dae: Dae,
    vehicle: Vehicle,
    start: Trajectory,
) -> Any:
    """Return the inputs of the driving law of a problem."""
    with at(problem, ("driver",)):
        if driver.name == "straight":
            if driver.path is not None or driver.file is not None:
                raise ModelError("driver: 'straight' takes no path; use name = 'follow'")
            return straight(dae, vehicle, start, speed=driver.speed)
        return follow(dae, vehicle, Path(way_of(problem, driver)), speed=driver.speed)


def way_of(problem: Problem[S], driver: schema.Driver) -> Array:
    """Return the points of the path that a driving law follows, shape (n, 2) [m]."""
    if (driver.path is None) == (driver.file is None):
        raise ModelError("driver: 'follow' needs either path, an array of [x, y], or file")
    return np.array(driver.path or read_columns(problem.folder / str(driver.file), "xy"))
