"""What a plan leaves for the next one: its unknowns and multipliers, on its mesh."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from slipfree.errors import DataError
from slipfree.named import Array
from slipfree.plan.course import Course
from slipfree.plan.solver import Solution
from slipfree.plan.transcribe import Layout, Mesh, Program, positions

PREFIX = "plan_"  # of the names of the arrays


class Saved(NamedTuple):
    """A plan as numbers, from which another may start.

    Attributes
    ----------
    ends : ndarray, shape (n + 1,)
        Of the intervals, fractions of the duration.
    sizes : ndarray, shape (5,)
        Degree, numbers of states, algebraic unknowns and inputs, and one if inputs are continuous.
    unknowns, bound_multipliers : ndarray, shape (n_w,)
        Unknowns, not scaled, and multipliers of their bounds.
    row_multipliers : ndarray, shape (n_g,)
        Multipliers of the rows.
    """

    ends: Array
    sizes: Array
    unknowns: Array
    bound_multipliers: Array
    row_multipliers: Array

    @property
    def course(self) -> Course:
        """The motion."""
        degree, n_x, n_z, n_u, continuous = (int(value) for value in self.sizes)
        mesh = Mesh(self.ends, degree)
        layout = positions(mesh, (n_x, n_z, n_u), continuous=bool(continuous))
        return Course(mesh, layout, self.unknowns)

    @property
    def arrays(self) -> dict[str, Array]:
        """What to write to a file, by name."""
        return {f"{PREFIX}{name}": value for name, value in self._asdict().items()}


def saved(program: Program, found: Solution) -> Saved:
    """Return what a solution leaves."""
    layout: Layout = program.layout
    sizes = [program.mesh.degree, layout.first.size, layout.unknowns.shape[2],
             layout.inputs.shape[1], len(layout.inputs) == program.mesh.ends.size]  # fmt: skip
    return Saved(program.mesh.ends, np.array(sizes, dtype=float), found.unknowns,
                 found.bound_multipliers, found.row_multipliers)  # fmt: skip


def from_arrays(arrays: Mapping[str, Array], where: str) -> Saved:
    """Return what a file holds.

    Raises
    ------
    DataError
        If it holds no plan.
    """
    names = [f"{PREFIX}{name}" for name in Saved._fields]
    if not set(names) <= set(arrays):
        raise DataError(
            f"{where}: expected the result of a plan, found none in it; give a file that slipfree "
            'run wrote for a problem of verb = "plan"'
        )
    return Saved(*(arrays[name] for name in names))
