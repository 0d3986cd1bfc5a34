"""Comparison of several vehicles on one ground: rolling without slip, or remaining slip."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from pydantic import Field

from slipfree.core.dae import Dae
from slipfree.core.records import Array, leaves
from slipfree.core.trajectory import SolverError, Stop, Trajectory
from slipfree.files.toml.types import Quantity
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.samples import measured_slip
from slipfree.problem.build import (
    build_law,
    build_start,
    build_terrain,
    build_vehicle,
    check_names,
)
from slipfree.problem.build_ground import GroundMap, build_ground
from slipfree.problem.problem import Problem
from slipfree.problem.schema import INPUTS, VERB, DriverTable, TerrainKeys, VehicleSource
from slipfree.solve.options import SolverOptions
from slipfree.solve.sampling import input_samples
from slipfree.solve.simulate import simulate
from slipfree.solve.system import with_inputs
from slipfree.system.interrupt import interrupt_requested
from slipfree.vehicle.tree import Vehicle

RANK = 1e-9  # smaller singular values, relative to the largest, count as zero


class NamedVehicle(VehicleSource):
    """A named vehicle of a comparison."""

    name: Annotated[str, Field(min_length=1)] = Field(description="name of the vehicle")


class Compare(TerrainKeys):
    """Several vehicles on one ground: at common rates, and at the rates of a driving law."""

    verb: Literal["compare"] = Field(description=VERB)
    vehicles: Annotated[tuple[NamedVehicle, ...], Field(strict=False, min_length=1)] = Field(
        description="the vehicles to compare"
    )
    inputs: dict[str, Quantity] = Field(description=INPUTS)
    driver: DriverTable = Field(description="the driving law")


class ComparedMotion(NamedTuple):
    """Largest values over one motion of a vehicle of a comparison; slip is per wheel."""

    along: Array  # slip along the wheel in the model [m/s]
    across: Array  # slip across the wheel in the model [m/s]
    measured: Array  # total slip, computed from the wheel poses alone [m/s]
    friction: float  # coefficient needed, load-weighted; NaN without mass [1]
    tilt: float  # of the passive joints that turn; zero without such joints [rad]
    width: tuple[float, float]  # least and largest distance of the first two wheels [m]
    stop: Stop | None


class ComparedVehicle(NamedTuple):
    """One vehicle of a comparison; it can roll without slip if rank and conditions are equal."""

    name: str
    wheels: tuple[str, ...]  # in the order of the arrays
    rank: int  # of the Jacobian of the slip in the unknown rates
    conditions: int  # number of slip conditions
    same: ComparedMotion  # motion at the common rates
    fitting: ComparedMotion  # motion at the rates of the driving law


def compare(
    problem: Problem[Compare], progress: Callable[[str], None]
) -> tuple[GroundMap, list[ComparedVehicle]]:
    """Compare vehicles on one ground; return the ground and the results of each vehicle.

    ``progress`` is called with the name of each vehicle before its computation. After a Ctrl-C held
    back by `held_interrupt`, the results are those of the finished vehicles. ProblemError is raised
    if the problem cannot be built; SolverError if a motion fails before its first sample.
    """
    ground, rows = build_ground(problem), []
    terrain = build_terrain(problem, ground)
    for index, spec in enumerate(problem.spec.vehicles):
        progress(spec.name)
        vehicle = build_vehicle(problem, spec, ("vehicles", index))
        try:
            rows.append(_compared(problem, spec.name, vehicle, direct_kinematics(vehicle, terrain)))
        except KeyboardInterrupt:
            if not (rows and interrupt_requested()):
                raise
            break
    return ground, rows


def _compared(problem: Problem[Compare], name: str, vehicle: Vehicle, dae: Dae) -> ComparedVehicle:
    spec, start = problem.spec, build_start(problem, dae)
    options = spec.solver.options
    known = [label.full for label in leaves(dae.labels.u)]
    free = {f"{wheel.name}_rate" for wheel in vehicle.wheels if not wheel.driven}
    rates = {key: rate for key, rate in spec.inputs.items() if key not in free}
    check_names(problem, dae, {**dict.fromkeys(known, 0.0), **rates})
    t, _ = input_samples(spec.time.duration, spec.time.step, {})
    same = dae.inputs(**{key: rates.get(key, 0.0) for key in known})
    law = build_law(problem, spec.driver, dae, vehicle, start)
    drives = [_drive(vehicle, dae, start, inputs, t, options) for inputs in (same, law)]
    rank, conditions = _rank(dae, start, options), 3 * len(vehicle.wheels)
    return ComparedVehicle(name, start.wheels, rank, conditions, *drives)


def _drive(
    vehicle: Vehicle, dae: Dae, start: Trajectory, inputs: Any, t: Array, options: SolverOptions
) -> ComparedMotion:
    try:
        run = simulate(dae, start, inputs, t, options=options)
    except SolverError as error:
        if error.trajectory is None:
            raise
        run = error.trajectory
    even = run if run.stop is None else run.part(slice(-1))  # a stop lies between the samples
    slip = np.linalg.norm(measured_slip(vehicle, even), axis=2)
    tilts = [run[c.name] for c in vehicle.of("passive") if vehicle.unit(c.name) == "rad"]
    gaps = [run[f"center_{axis}"][:, 0] - run[f"center_{axis}"][:, 1] for axis in "xyz"]
    width = np.sqrt(sum(gap**2 for gap in gaps))
    return ComparedMotion(
        np.abs(run["slip_along"]).max(axis=0),
        np.abs(run["slip_across"]).max(axis=0),
        slip.max(axis=0),
        float(run["friction_needed"].max()) if vehicle.mass else float("nan"),
        max((float(np.abs(tilt).max()) for tilt in tilts), default=0.0),
        (float(width.min()), float(width.max())),
        run.stop,
    )


def _rank(dae: Dae, start: Trajectory, options: SolverOptions) -> int:
    """Return the rank of ``A``, the Jacobian of the slip in the unknown rates."""
    # the Jacobian of the rates contains A'A, which has the same rank
    rest = dae.inputs(**{label.full: 0.0 for label in leaves(dae.labels.u)})
    system = with_inputs(dae, rest, 0, options)
    x, z = dae.rows("x", start, -1), dae.rows("z", start, -1)
    rates = system.blocks[1]
    _, jacobian = rates.newton(0.0, x, z, system.u[:, 0], 0.0)
    block = np.array(jacobian) * dae.sizes.z[rates.span]
    count = len(block) - len(start.wheels)
    values = np.linalg.svd(block[:count, :count], compute_uv=False)
    return int((values > RANK * values[0]).sum())
