"""The compiled evaluator of bicubic grounds, where a compiler was found when this was installed.

`kernel.c` looks up the polynomial of a cell, as `slipfree.terrain.bicubic` does with CasADi's
tables. CasADi calls it as an external function.
"""

from __future__ import annotations

import ctypes
import secrets
import threading
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.records import Array

KEY_BITS = 52  # whole numbers that a double holds
LAYOUT = 2  # of what `kernel.c` is given; an older library is left alone


class Layout(NamedTuple):
    """Where the cells of a table of coefficients lie.

    Attributes
    ----------
    place : tuple of 2 floats
        Local coordinates of the node nearest to the local origin. [m]
    spacing : tuple of 2 floats
        Between nodes. [m]
    node, last : tuple of 2 int
        Numbers of that node and of the last cell, along x and y.
    """

    place: tuple[float, float]
    spacing: tuple[float, float]
    node: tuple[int, int]
    last: tuple[int, int]


class Opened(NamedTuple):
    """A ground registered with the compiled evaluator.

    Attributes
    ----------
    slot : int
        Its number there.
    key : float
        Identifies it among grounds that had the same number.
    function : casadi Function
        ``[x, y, key] -> [x_0, y_0, h, h_x, h_xx, h_xxx, h_y, h_xy, ...]``: the middle of the cell
        and the 16 derivatives there, local. While it or anything made of it lives, the number is
        not given to another ground.
    library : ctypes.CDLL
        Where it is.
    """

    slot: int
    key: float
    function: ca.Function
    library: ctypes.CDLL

    def heights(self, x: Array, y: Array) -> Array:
        """Return the local heights at local points, shape (n,) [m]."""
        x, y = np.ascontiguousarray(x), np.ascontiguousarray(y)
        heights = np.empty(x.size)
        held = (_address(array) for array in (x, y, heights))
        self.library.kernel_heights(self.slot, ctypes.c_longlong(x.size), *held)
        return heights


def opened(table: Array, layout: Layout) -> Opened | None:
    """Register a ground with the compiled evaluator; return None if it is absent or full.

    Parameters
    ----------
    table : ndarray, shape (n_x + 2, n_y + 2)
        Coefficients of the spline; kept while the ground is in use. [m]
    layout : Layout
        Where its cells lie.
    """
    compiled = library()
    if compiled is None:
        return None
    key = float(secrets.randbits(KEY_BITS))
    numbers = np.array(
        [key, *layout.place, *layout.spacing, *layout.node, *layout.last], dtype=float
    )
    with _LOCK:
        free = [slot for slot in range(compiled.kernel_slots()) if not compiled.kernel_in_use(slot)]
        for slot in free:
            compiled.kernel_close(slot)
            _TABLES.pop(slot, None)
        if not free:
            return None
        slot = free[0]
        _TABLES[slot] = table
        compiled.kernel_open(
            slot, _address(table), ctypes.c_longlong(table.shape[1]), _address(numbers)
        )
        return Opened(slot, key, ca.external(f"ground{slot}", compiled._name), compiled)


_LOCK = threading.Lock()
_TABLES: dict[int, Array] = {}  # what the slots point to


@cache
def library() -> ctypes.CDLL | None:
    """Return the compiled evaluator, None where none was built that can be used here."""
    for file in (Path(__file__).with_name(f"_kernel{suffix}") for suffix in EXTENSION_SUFFIXES):
        try:
            found = ctypes.CDLL(str(file))
            if found.kernel_layout() == LAYOUT:
                return found
        except (OSError, AttributeError):  # none, one of another system, or an older one
            continue
    return None


def _address(array: Array) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)
