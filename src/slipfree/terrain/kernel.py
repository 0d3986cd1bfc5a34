"""Compiled evaluator of bicubic grounds, if a compiler was found at installation.

`kernel.c` looks up the polynomial of a cell, as `slipfree.terrain.bicubic` does with CasADi
interpolants, and the ground point nearest to a wheel, as `slipfree.contact.touch` does with a
CasADi graph. CasADi calls both as external functions, and functions at many points
(`slipfree.core.lookups.in_lanes`).
"""

from __future__ import annotations

import ctypes
import secrets
import threading
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.lookups import KEY_BITS, Cells, library, pointer
from slipfree.core.records import Array, Indices


class Opened(NamedTuple):
    """A ground registered with the compiled evaluator.

    ``key`` distinguishes grounds with the same slot of the library. ``function`` maps ``[x, y,
    key]`` to ``[x_0, y_0, h, h_x, h_xx, h_xxx, h_y, h_xy, ...]``: the centre of the cell and the 16
    derivatives there, in local coordinates. The slot is not reused while the function, or any
    function that contains it, exists. ``nearest`` maps ``[C, a, r1, r2, r, key]`` to the results of
    `slipfree.contact.touch.search_function`, for the centre, the axle, the radii of the torus and
    the rolling radius of a wheel.
    """

    slot: int
    key: float
    function: ca.Function
    nearest: ca.Function
    library: ctypes.CDLL

    def heights(self, x: Array, y: Array) -> Array:
        """Return the local heights at local points, shape (n,) [m]."""
        x, y = np.ascontiguousarray(x), np.ascontiguousarray(y)
        heights = np.empty(x.size)
        held = (pointer(array) for array in (x, y, heights))
        self.library.kernel_heights(self.slot, ctypes.c_longlong(x.size), *held)
        return heights

    def smallest_gaps(
        self,
        middles: Array,
        radii: Array,
        turned: Array,
        circle: Array,
        touching: float,
        near: float,
        most: float,
    ) -> tuple[Array, Indices]:
        """Return the smallest gaps of n wheels and the indices of their points on the tread.

        Parameters
        ----------
        middles : ndarray, shape (n, n_across, 3)
            Points on the axles, in local coordinates. [m]
        radii : ndarray, shape (n, n_across)
            Distances of the points of the tread from the axle. [m]
        turned : ndarray, shape (n, 2, 3)
            Unit vectors from the axle, to the contact and a quarter of a turn from it. [1]
        circle : ndarray, shape (n_rim, 2)
            Cosines and sines of the angles of points around the rim. [1]
        touching, near : float
            Penetration that counts as contact, and gap below which minima are refined. [m]
        most : float
            Gap above which nothing is searched; results are not larger. [m]
        """
        (n, across), rim = radii.shape, len(circle)
        best, index = np.full(n, most), np.empty(n, dtype=np.int64)
        arrays = [np.ascontiguousarray(each) for each in (middles, radii, turned, circle)]
        self.library.kernel_gaps(
            self.slot,
            *(ctypes.c_longlong(each) for each in (n, rim, across)),
            *(pointer(each) for each in arrays),
            *(ctypes.c_double(each) for each in (touching, near)),
            *(pointer(each) for each in (np.empty(rim * (across + 1)), best, index)),
        )
        return best, index


def register_ground(cells: Cells) -> Opened | None:
    """Register a ground with the compiled evaluator; return None without evaluator or free slot.

    The coefficients of the cells are kept while they are in use.
    """
    compiled = library()
    if compiled is None:
        return None
    key = float(secrets.randbits(KEY_BITS))
    numbers, table = np.array([key, *cells.numbers]), cells.coefficients
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
            slot, pointer(table), ctypes.c_longlong(table.shape[1]), pointer(numbers)
        )
        cell, nearest = (
            ca.external(f"{name}{slot}", compiled._name) for name in ("ground", "nearest")
        )
        return Opened(slot, key, cell, nearest, compiled)


_LOCK = threading.Lock()
_TABLES: dict[int, Array] = {}  # tables of the slots, kept alive
