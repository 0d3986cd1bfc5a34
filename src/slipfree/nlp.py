"""Nonlinear program: interface between other transcriptions and the solver of plans."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from slipfree.records import Array


@dataclass(frozen=True, eq=False)
class Nlp:
    """Nonlinear program: minimise ``f(x)`` within bounds of ``x`` and of ``g(x)``.

    Attributes
    ----------
    x, f, g : MX
        Unknowns divided by their scales; objective and constraints as functions of them.
    guess, scale, lower, upper : ndarray, shape (n_x,)
        Initial guess, scales and bounds of the unknowns, in physical units.
    g_lower, g_upper : ndarray, shape (n_g,)
        Bounds of the constraints.
    where : mapping of str to ndarray
        Indices of the unknowns of each quantity, in the shape of the quantity.
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
