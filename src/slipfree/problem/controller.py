"""C code for a controller, from a problem or a vehicle file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from slipfree.core.errors import ModelError
from slipfree.files.controller import ControllerCode, export_controller
from slipfree.models.given_rates import COMMANDS, ROBOT
from slipfree.problem.build_vehicle import build_vehicle, is_vehicle_file, read_vehicle
from slipfree.problem.load import load_problem
from slipfree.problem.problem import Problem
from slipfree.problem.verbs.inverse import Inverse, are_commands, read_commands


def export_code(file: Path, folder: Path, trust: Sequence[Path] = ()) -> ControllerCode:
    """Write C code of the vehicle of a problem or of a vehicle file; see `export_controller`.

    The velocities of an inverse problem are those that it gives, in its frame. Those of other
    problems and of vehicle files are all three, to which the answer is the nearest motion; those of
    vehicle files are in the frame of robots (REP 103).

    Parameters
    ----------
    file : Path
        The problem or vehicle file.
    folder : Path
        Folder of the files; made if it does not exist.
    trust : sequence of Path
        Xacro files that may be expanded.

    Raises
    ------
    DataError
        If the file cannot be read, its values are not valid, or a file cannot be written.
    ModelError
        If the vehicle cannot follow the velocities, or an inverse problem gives other rates.
    """
    if is_vehicle_file(file):
        return export_controller(read_vehicle(file, trust=trust), folder)
    problem: Problem[Any] = load_problem(file, command="vehicle", trust=trust)
    spec, given, exact = problem.spec, tuple(COMMANDS), False
    vehicle = build_vehicle(problem)
    if isinstance(spec, Inverse) and spec.given:
        if not are_commands(spec.given):
            raise ModelError(
                f"{file}: [given]: expected velocities from {', '.join(COMMANDS)} (or, with frame "
                f"= 'rep103', {', '.join(ROBOT)}) to export code, found {', '.join(spec.given)}; "
                "give velocities in the frame of the heading"
            )
        commands, _ = read_commands(problem, spec)
        given = tuple(name for name in COMMANDS if name in commands)
        exact = len(given) < len(COMMANDS) if spec.exact is None else spec.exact
    return export_controller(vehicle, folder, given=given, exact=exact, frame=spec.frame)
