"""Convergence of the searches for a plan: cost, violation and barrier of every iterate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from slipfree.core.records import Array, field_overview

PREFIX = "convergence_"  # prefix of the names of the arrays in a file
IPOPT_NAMES = ("obj", "inf_pr", "inf_du", "mu")


class Convergence(NamedTuple):
    """Values of IPOPT at every iterate of a search, from the initial guess on.

    Violation and dual infeasibility are those of the scaled program, which IPOPT's tolerance
    refers to.

    Attributes
    ----------
    cost : ndarray, shape (n,)
        Cost, the sum of all weighted terms.
    violation : ndarray, shape (n,)
        Largest violation of a constraint.
    dual_infeasibility : ndarray, shape (n,)
        Largest component of the gradient of the Lagrangian.
    barrier : ndarray, shape (n,)
        Barrier parameter.
    """

    cost: Array
    violation: Array
    dual_infeasibility: Array
    barrier: Array

    def __repr__(self) -> str:
        return field_overview(self)


NO_CONVERGENCE = Convergence(*np.zeros((4, 0)))


def convergence_of(stats: Mapping[str, Any]) -> Convergence:
    """Return the convergence of a search from the statistics of ``casadi.nlpsol``."""
    iterations = stats.get("iterations") or {name: [] for name in IPOPT_NAMES}
    return Convergence(*(np.array(iterations[name], dtype=float) for name in IPOPT_NAMES))


def convergence_arrays(searches: Sequence[Convergence]) -> dict[str, Array]:
    """Return consecutive searches as arrays for a file, by name; empty without iterates.

    The array ``convergence_search`` has the index of the search of every iterate.
    """
    if not any(each.cost.size for each in searches):
        return {}
    found = {
        f"{PREFIX}{name}": np.concatenate([getattr(each, name) for each in searches])
        for name in Convergence._fields
    }
    numbers = [np.full(each.cost.size, float(k)) for k, each in enumerate(searches)]
    return {**found, f"{PREFIX}search": np.concatenate(numbers)}


def convergence_from(arrays: Mapping[str, Array]) -> dict[int, Convergence]:
    """Return the searches in the arrays of a file, by index; empty if the file has none."""
    numbers = arrays.get(f"{PREFIX}search", np.zeros(0))
    values = {name: arrays.get(f"{PREFIX}{name}", np.zeros(0)) for name in Convergence._fields}
    return {
        int(k): Convergence(*(values[name][numbers == k] for name in Convergence._fields))
        for k in np.unique(numbers)
    }
