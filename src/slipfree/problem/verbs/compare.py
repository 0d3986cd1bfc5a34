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
from slipfree.problem.build_common import (
    build_start,
    build_terrain,
    build_vehicle,
    check_names,
    samples,
)
from slipfree.problem.build_driver import build_law
from slipfree.problem.build_ground import Ground, at, build_ground
from slipfree.problem.problem import Problem
from slipfree.problem.schema import INPUTS, VERB, Driver, Task
from slipfree.problem.schema import Vehicle as VehicleTable
from slipfree.problem.verbs.base import Verb
from slipfree.solve.options import SolverOptions
from slipfree.solve.simulate import simulate
from slipfree.solve.system import with_inputs
from slipfree.system.interrupt import interrupt_requested
from slipfree.vehicle.tree import Vehicle

RANK = 1e-9  # smaller singular values, relative to the largest, count as zero


class Compared(VehicleTable):
    """A named vehicle of a comparison."""

    name: Annotated[str, Field(min_length=1)] = Field(description="name of the vehicle")


class Compare(Task):
    """Several vehicles on one ground: at common rates, and at the rates of a driving law."""

    verb: Literal["compare"] = Field(description=VERB)
    vehicles: Annotated[tuple[Compared, ...], Field(strict=False, min_length=1)] = Field(
        description="the vehicles to compare"
    )
    inputs: dict[str, Quantity] = Field(description=INPUTS)
    driver: Driver = Field(description="the driving law")


class CompareVerb(Verb):
    """Comparison of several vehicles on one ground."""

    schema = Compare
    commands = ("compare",)


class Drive(NamedTuple):
    """Results of one motion of a vehicle of a comparison.

    Attributes
    ----------
    along, across, measured : ndarray, shape (n_wheels,)
        Largest slip velocity of every wheel: along and across the wheel in the model, and in total,
        computed from the wheel poses alone. [m/s]
    friction : float
        Largest coefficient of friction that a wheel needs, load-weighted where forces are
        indeterminate; NaN for a vehicle without mass. [1]
    tilt : float
        Largest absolute angle of the passive joints that turn; zero without such joints. [rad]
    width : tuple of 2 floats
        Smallest and largest distance between the centres of the first two wheels. [m]
    stop : Stop or None
        Stop of a motion that ended early; None for a complete motion.
    """

    along: Array
    across: Array
    measured: Array
    friction: float
    tilt: float
    width: tuple[float, float]
    stop: Stop | None


class Row(NamedTuple):
    """One vehicle of a comparison.

    Attributes
    ----------
    name : str
        Name of the vehicle.
    wheels : tuple of str
        Names of its wheels, in the order of the arrays.
    rank, conditions : int
        Rank of the Jacobian of the slip in the unknown rates, and number of slip conditions; the
        vehicle can roll without slip if they are equal.
    same, fitting : Drive
        Motions at the common rates, and at the rates of the driving law.
    """

    name: str
    wheels: tuple[str, ...]
    rank: int
    conditions: int
    same: Drive
    fitting: Drive


def compare(problem: Problem[Compare], progress: Callable[[str], None]) -> tuple[Ground, list[Row]]:
    """Compare vehicles on one ground; return the ground and the results of each vehicle.

    After a Ctrl-C held back by `held_interrupt`, the results are those of the finished vehicles.

    Parameters
    ----------
    problem : Problem
        The comparison.
    progress : callable
        Called with the name of each vehicle before its computation.

    Raises
    ------
    ProblemError
        If the problem cannot be built.
    SolverError
        If a motion fails before its first sample.
    """
    ground, rows = build_ground(problem), []
    terrain = build_terrain(problem, ground)
    for index, spec in enumerate(problem.spec.vehicles):
        progress(spec.name)
        with at(problem, ("vehicles", index)):
            vehicle = build_vehicle(spec, problem)
        try:
            rows.append(_row(problem, spec.name, vehicle, direct_kinematics(vehicle, terrain)))
        except KeyboardInterrupt:
            if not (rows and interrupt_requested()):
                raise
            break
    return ground, rows


def _row(
    problem: Problem[Compare],
    name: str,
    vehicle: Vehicle,
    dae: Dae,
) -> Row:
    spec, start = problem.spec, build_start(problem, dae)
    known = [label.full for label in leaves(dae.labels.u)]
    free = {f"{wheel.name}_rate" for wheel in vehicle.wheels if not wheel.driven}
    given = {key: rate for key, rate in spec.inputs.items() if key not in free}
    check_names(problem, dae, {**dict.fromkeys(known, 0.0), **given})
    t, _ = samples(spec.time, {})
    same = dae.inputs(**{key: given.get(key, 0.0) for key in known})
    law = build_law(problem, spec.driver, dae, vehicle, start)
    drives = [_drive(vehicle, dae, start, inputs, t, spec.solver.options) for inputs in (same, law)]
    return Row(
        name, start.wheels, _rank(dae, start, spec.solver.options), 3 * len(vehicle.wheels), *drives
    )


def _drive(
    vehicle: Vehicle,
    dae: Dae,
    start: Trajectory,
    inputs: Any,
    t: Array,
    options: SolverOptions,
) -> Drive:
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
    return Drive(
        np.abs(run["slip_along"]).max(axis=0),
        np.abs(run["slip_across"]).max(axis=0),
        slip.max(axis=0),
        float(run["friction_needed"].max()) if vehicle.mass else float("nan"),
        max((float(np.abs(tilt).max()) for tilt in tilts), default=0.0),
        (float(width.min()), float(width.max())),
        run.stop,
    )


def _rank(dae: Dae, start: Trajectory, options: SolverOptions) -> int:
    """Return the rank of the Jacobian ``A`` of the slip in the unknown rates.

    The Jacobian of the rates of the model contains ``A'A``, which has the same rank.
    """
    rest = dae.inputs(**{label.full: 0.0 for label in leaves(dae.labels.u)})
    system = with_inputs(dae, rest, 0, options)
    x, z = dae.rows("x", start, -1), dae.rows("z", start, -1)
    rates = system.blocks[1]
    _, jacobian = rates.newton(0.0, x, z, system.u[:, 0], 0.0)
    block = np.array(jacobian) * dae.sizes.z[rates.span]
    count = len(block) - len(start.wheels)
    values = np.linalg.svd(block[:count, :count], compute_uv=False)
    return int((values > RANK * values[0]).sum())
