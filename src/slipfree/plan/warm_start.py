"""Save the unknowns and multipliers of a plan for a warm start of another plan."""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.errors import DataError, ModelError
from slipfree.core.records import Array, field_overview, leaves
from slipfree.plan.ipopt import Solution
from slipfree.plan.polynomial_motion import PolynomialMotion, motion_of
from slipfree.plan.transcription import CollocationMesh, Program, variable_layout

ARRAY_PREFIX = "plan_"  # prefix of the names of the arrays in a file


class SavedPlan(NamedTuple):
    """Arrays of a plan, for a warm start of another plan.

    Attributes
    ----------
    ends : ndarray, shape (n + 1,)
        Ends of the intervals, as fractions of the duration.
    sizes : ndarray, shape (5,)
        Degree; numbers of states, algebraic unknowns and inputs; 1 if inputs are continuous,
        otherwise 0.
    unknowns : ndarray, shape (n_w,)
        Unknowns, not scaled, in local coordinates.
    bound_multipliers : ndarray, shape (n_w,)
        Multipliers of the bounds of the scaled unknowns; empty if not known.
    row_multipliers : ndarray, shape (n_g,)
        Multipliers of the rows; empty if not known.
    shift : ndarray, shape (n_x + n_z,)
        Map coordinates minus local coordinates of the states and algebraic unknowns.
    model : ndarray, shape (1,)
        CRC-32 of the names of the states, algebraic unknowns and inputs.
    """

    ends: Array
    sizes: Array
    unknowns: Array
    bound_multipliers: Array
    row_multipliers: Array
    shift: Array
    model: Array

    def __repr__(self) -> str:
        return field_overview(self)

    @property
    def motion(self) -> PolynomialMotion:
        """Motion of the plan, in the local coordinates of its model."""
        degree, n_x, n_z, n_u, continuous = (int(value) for value in self.sizes)
        mesh = CollocationMesh(self.ends, degree)
        layout = variable_layout(mesh, (n_x, n_z, n_u), continuous=bool(continuous))
        return PolynomialMotion(mesh, layout, self.unknowns)

    @property
    def arrays(self) -> dict[str, Array]:
        """Arrays to write to a file, by name; files have no empty arrays."""
        return {
            f"{ARRAY_PREFIX}{name}": value for name, value in self._asdict().items() if value.size
        }


def save_plan(program: Program, found: Solution) -> SavedPlan:
    """Return the arrays of a solution for a later warm start."""
    motion = motion_of(program, found.unknowns)
    return save_motion(motion, program.task.dae)._replace(
        bound_multipliers=found.bound_multipliers, row_multipliers=found.row_multipliers
    )


def save_motion(motion: PolynomialMotion, dae: Dae) -> SavedPlan:
    """Return the arrays of a motion of a model, without multipliers."""
    layout = motion.layout
    sizes = [
        motion.mesh.degree,
        layout.first.size,
        layout.unknowns.shape[2],
        layout.inputs.shape[1],
        motion.continuous,
    ]
    return SavedPlan(
        motion.mesh.ends,
        np.array(sizes, dtype=float),
        motion.unknowns,
        np.zeros(0),
        np.zeros(0),
        np.concatenate(dae.shift),
        _model_number(dae),
    )


def _model_number(dae: Dae) -> Array:
    names = " ".join(
        label.full for part in (dae.labels.x, dae.labels.z, dae.labels.u) for label in leaves(part)
    )
    return np.array([float(zlib.crc32(names.encode()))])


def local_motion(former: SavedPlan, dae: Dae) -> PolynomialMotion:
    """Return a saved motion in the local coordinates of a model.

    Raises
    ------
    ModelError
        If the model and the saved plan have different states, algebraic unknowns or inputs.
    """
    if not np.array_equal(former.model, _model_number(dae)):
        raise ModelError(
            "plan: expected a saved plan with the states, unknowns and inputs of this model, found "
            "others (of another vehicle, model or law); restore the vehicle, model and law of the "
            "saved plan, or plan without the saved plan"
        )
    found, away = former.motion, former.shift - np.concatenate(dae.shift)
    unknowns, n_x = found.unknowns.copy(), dae.shift[0].size
    count = found.layout.unknowns.shape[2]
    unknowns[found.layout.first] += away[:n_x]
    unknowns[found.layout.states] += away[:n_x]
    unknowns[found.layout.unknowns] += away[n_x : n_x + count]
    return found._replace(unknowns=unknowns)


def from_arrays(arrays: Mapping[str, Array], where: str) -> SavedPlan:
    """Return the saved plan in the arrays of a file; ``where`` names the file in error messages.

    Raises
    ------
    DataError
        If an array of a plan is missing.
    """
    multipliers = {"bound_multipliers", "row_multipliers"}
    found = {name: arrays.get(f"{ARRAY_PREFIX}{name}") for name in SavedPlan._fields}
    if any(value is None for name, value in found.items() if name not in multipliers):
        raise DataError(
            f"{where}: expected the result of a plan, found no plan in it; give a file that "
            'slipfree run wrote for a problem with verb = "plan"'
        )
    return SavedPlan(*(np.zeros(0) if value is None else value for value in found.values()))
