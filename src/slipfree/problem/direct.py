"""From a problem of direct kinematics to a model, a start and inputs."""

from __future__ import annotations

from typing import Any

import numpy as np

from slipfree.control.path_following import follow, straight
from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.files.toml.errors import ProblemError
from slipfree.geometry.path import Path
from slipfree.laws.coulomb import Coulomb
from slipfree.laws.registry import SLIP_LAWS
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.montana import montana_kinematics
from slipfree.models.quasi_statics import quasi_statics
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
from slipfree.problem.load import Problem, S
from slipfree.records import Array
from slipfree.terrain.base import Terrain
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
            if spec.slip == "traction":
                raise ModelError("expected slip = 'least' or 'rolling', found 'traction'")
            dae = montana_kinematics(vehicle, terrain, slip=SLIP_LAWS[spec.slip]())
    if spec.driver is None:
        driven = "inputs " + ", ".join(spec.inputs or {})
        with at(problem, ("inputs",)):
            inputs = dae.inputs(**rates)
    else:
        driven = f"driver {spec.driver.name}"
        inputs = build_law(problem, spec.driver, dae, vehicle, start)
    return Setup(ground, terrain, vehicle, model, dae, start, inputs, t, driven)


def build_model(
    problem: Problem[S], spec: schema.Direct | schema.Plan, vehicle: Vehicle, terrain: Terrain
) -> Dae:
    """Return the model of a vehicle on a ground by the law of slip that a problem asks for."""
    if spec.traction is not None and spec.slip != "traction":
        where = problem.source.where(("traction",))
        raise ProblemError(f"{where}: traction: expected slip = 'traction', found {spec.slip!r}")
    with at(problem, ("slip",)):
        if spec.slip == "traction":
            law = Coulomb(**dict(spec.traction or schema.Traction()))
            return quasi_statics(vehicle, terrain, law=law)
        return direct_kinematics(vehicle, terrain, slip=SLIP_LAWS[spec.slip]())


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
