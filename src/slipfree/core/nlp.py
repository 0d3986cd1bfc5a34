"""Nonlinear program: interface between other transcriptions and the solver of plans."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from slipfree.core.records import Array


@dataclass(frozen=True, eq=False)
class Nlp:
    """Nonlinear program: minimise ``f`` within bounds of the unknowns and of ``g``.

    Attributes
    ----------
    x : MX, shape (n_x, 1)
        Unknowns divided by their scales.
    f, g : MX, shapes (1, 1) and (n_g, 1)
        Objective and constraints as functions of ``x``.
    guess, scale, lower, upper : ndarray, shape (n_x,)
        Initial guess, scales and bounds of the unknowns, each in the unit of its quantity.
    g_lower, g_upper : ndarray, shape (n_g,)
        Bounds of the constraints, in the units of ``g``.
    where : mapping of str to ndarray of int
        Indices into ``x`` by name of the quantity; each array has the shape of its quantity.
    """

    x: ca.MX
    f: ca.MX
    g: ca.MX
    guess: Array
    scale: Array
    lower: Array
    upper: Array
    g_lower: Array
    g_upper: Array
    where: Mapping[str, npt.NDArray[np.intp]]
