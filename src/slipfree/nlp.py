"""A nonlinear program: what models of their own transcription hand to the solver of plans."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import casadi as ca
import numpy as np
import numpy.typing as npt

from slipfree.records import Array


@dataclass(frozen=True, eq=False)
class Nlp:
    """A function of unknowns to be made least within bounds of the unknowns and of rows.

    Attributes
    ----------
    x, f, g : MX
        Unknowns, each divided by its scale; cost and rows in their terms.
    guess, scale, lower, upper : ndarray, shape (n_x,)
        Where to start, sizes of the unknowns, and their bounds; none of them divided.
    g_lower, g_upper : ndarray, shape (n_g,)
        Bounds of the rows.
    where : mapping of str to ndarray
        By name, which of the unknowns a quantity is, in its own shape.
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
