"""Inputs of direct problems from commands of joints in MCAP files."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.errors import DataError
from slipfree.core.records import Array
from slipfree.files.mcap_reader import JointCommands, is_mcap, read_joint_commands
from slipfree.files.toml.types import Piecewise
from slipfree.files.urdf.links import Robot, joint_values
from slipfree.problem.build_ground import at
from slipfree.problem.build_vehicle import read_robot
from slipfree.problem.problem import Problem
from slipfree.problem.schema import FILE, MotionKeys
from slipfree.vehicle.tree import Vehicle

START_TOLERANCE = 1e-6  # of the first commanded position [rad, m]


class _Actuator(NamedTuple):
    """Input that moves a joint: ``joint = offset + slope * q``, with rate ``q'`` of the input.

    ``q`` is a coordinate, or the angle of a wheel if ``is_wheel`` is set; ``name`` is that of the
    input.
    """

    name: str
    slope: float
    offset: float
    is_wheel: bool


def read_joint_inputs(problem: Problem[Any], file: str, vehicle: Vehicle) -> dict[str, Piecewise]:
    """Return the inputs that an MCAP file commands, by name; joints without input are ignored.

    The rates are the commanded velocities. If some messages have no velocity, the rates between two
    messages are constant, and each position is reached at the time of its message.

    Raises
    ------
    ProblemError
        If the file is not an MCAP file or cannot be read, if it commands no input, if some messages
        for a joint lack a velocity and some lack a position, or if the first commanded position of
        a joint differs from its start.
    """
    spec: MotionKeys = problem.spec
    robot = read_robot(spec.vehicle, problem)
    actuators, found = _actuators(vehicle, robot), dict[str, Piecewise]()
    with at(problem, ("inputs", FILE)):
        if not is_mcap(Path(file)):
            raise DataError(
                f"expected an MCAP file, whose name ends in .mcap, found {file!r}; convert the "
                "commands to MCAP"
            )
        commands = read_joint_commands(problem.folder / file)
        for joint, actuator in actuators.items():
            if joint in commands and actuator.name not in found:
                rates = _rates(joint, commands[joint], actuator, problem)
                found[actuator.name] = rates
        if not found:
            raise DataError(
                f"{file}: expected commands of one or more of the joints {', '.join(actuators)}, "
                + (
                    f"found those of {', '.join(commands)}; rename the joints in the file"
                    if commands
                    else "found no joint names; record the commands with names"
                )
            )
    return found


def _actuators(vehicle: Vehicle, robot: Robot | None) -> dict[str, _Actuator]:
    """Return the inputs by the names of coordinates and of joints that they move linearly."""
    names = [c.name for c in vehicle.coordinates]
    wheels = [wheel.name for wheel in vehicle.wheels]
    q = ca.SX.sym("q", len(names) + len(wheels))
    values = dict(zip(names, ca.vertsplit(q)[: len(names)], strict=True))
    angles = dict(zip(wheels, ca.vertsplit(q)[len(names) :], strict=True))
    driven = {c.name for c in vehicle.of("commanded")} | {
        w.name for w in vehicle.wheels if w.driven
    }
    found = {
        c.name: _Actuator(f"{c.name}_rate", 1.0, 0.0, is_wheel=False)
        for c in vehicle.of("commanded")
    }
    for joint, value in joint_values(vehicle, robot, values, angles).items():
        slopes = ca.jacobian(value, q)
        if slopes.nnz() != 1 or ca.symvar(slopes):
            continue
        name = [*names, *wheels][slopes.sparsity().get_triplet()[1][0]]
        if name in driven:
            slope, offset = float(ca.sum2(ca.DM(slopes))), float(_at_zero(value, q))
            found[joint] = _Actuator(f"{name}_rate", slope, offset, name in wheels)
    return found


def _at_zero(value: ca.SX, q: ca.SX) -> ca.DM:
    return ca.Function("value", [q], [value])(0)


def _rates(
    joint: str, given: JointCommands, actuator: _Actuator, problem: Problem[Any]
) -> Piecewise:
    """Return the rate of an input over time, from the commands of its joint.

    Raises
    ------
    DataError
        If some messages lack a velocity and some lack a position, or the first position is not that
        of the start.
    """
    if np.isfinite(given.velocities).all():
        rates = given.velocities / actuator.slope
    elif np.isfinite(given.positions).all():
        wanted = (given.positions - actuator.offset) / actuator.slope
        if not actuator.is_wheel:
            _check_start(joint, float(wanted[0]), actuator, problem)
        rates = np.append(np.diff(wanted) / np.diff(given.t), 0.0)
    else:
        raise DataError(
            f"expected a velocity, or a position, of joint {joint} in every message that names it, "
            "found messages without velocity and messages without position; record either in "
            "every message"
        )
    later: Array = given.t if given.t[0] == 0 else np.append(0.0, given.t)
    padded = np.append(np.zeros(later.size - rates.size), rates)
    return tuple(zip(later.tolist(), padded.tolist(), strict=True))


def _check_start(joint: str, first: float, actuator: _Actuator, problem: Problem[Any]) -> None:
    """Raise DataError if a coordinate does not start at the first commanded position."""
    name = actuator.name.removesuffix("_rate")
    start = problem.spec.start.get(name, 0.0)
    if abs(start - first) > START_TOLERANCE:
        raise DataError(
            f"expected the first position of joint {joint} at the start, {name} = {start:.9g}, "
            f"found {first:.9g}; set {name} = {first:.9g} in [start]"
        )
