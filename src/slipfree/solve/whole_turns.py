"""Angles that differ by whole turns and mean the same."""

from __future__ import annotations

from collections.abc import Iterable

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae, Limit
from slipfree.core.records import Array, Mask, leaves

TURN = 2 * np.pi
ROUNDING = 1e-7  # relative difference of expressions that counts as rounding


def periodic_states(dae: Dae, x: Array, limits: Iterable[Limit] = ()) -> Mask:
    """Return which states are angles that mean the same after a whole turn, shape (n_x,).

    Such states are headings, and joints without stop and spring, such as casters. Rates, equations
    and limits of the model are compared at a state and one turn further.

    Parameters
    ----------
    dae : Dae
        The model.
    x : ndarray, shape (n_x,)
        A state, in local coordinates.
    limits : iterable of Limit
        Further limits; the state is not periodic if a turn changes one of them.
    """
    angles = np.array([label.unit == "rad" for label in leaves(dae.labels.x)], dtype=bool)
    expressions = (limit.expression for limit in (*dae.limits, *limits))
    rows = ca.vertcat(dae.ode, *dae.alg, *expressions)
    evaluate = dae.function("turned", [dae.t, *dae.columns()], [rows])
    others = np.ones_like(dae.scale), np.ones(len(list(leaves(dae.u))))
    first = np.array(evaluate(0.0, x, *others)).ravel()
    for k in np.flatnonzero(angles):
        turned = np.array(evaluate(0.0, x + TURN * (np.arange(x.size) == k), *others)).ravel()
        size = np.nan_to_num(np.abs(first)).max(initial=1.0)
        angles[k] = np.allclose(turned, first, rtol=0, atol=ROUNDING * size, equal_nan=True)
    return angles


def same_turn(values: Array, near: Array, periodic: Mask) -> Array:
    """Return states with whole turns added to the periodic ones, nearest to other states.

    Both have the shape (n_x, n).
    """
    turns = TURN * np.round((near - values) / TURN)
    return np.where(periodic[:, None], values + np.nan_to_num(turns), values)
