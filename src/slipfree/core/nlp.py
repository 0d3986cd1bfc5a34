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
    """Nonlinear program: minimise ``f`` within bounds of the unknowns and of ``g``."""

    x: ca.MX  # unknowns divided by their scales, shape (n_x, 1)
    # f and g: objective and constraints as functions of ``x``, shapes (1, 1) and (n_g, 1)
    f: ca.MX
    g: ca.MX
    # guess, scale, lower, upper: initial guess, scales and bounds of the unknowns, each in
    # the unit of its quantity, shape (n_x,)
    guess: Array
    scale: Array
    lower: Array
    upper: Array
    # g_lower and g_upper: bounds of the constraints, in the units of ``g``, shape (n_g,)
    g_lower: Array
    g_upper: Array
    # indices into ``x`` by name of the quantity; each array has the shape of its quantity
    where: Mapping[str, npt.NDArray[np.intp]]
