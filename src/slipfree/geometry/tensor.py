"""Symmetric tensors of second order, such as inertia tensors, and their six elements."""

from __future__ import annotations

import numpy as np

from slipfree.core.records import Array

Elements = tuple[float, float, float, float, float, float]


def tensor(elements: Elements) -> Array:
    """Return the symmetric matrix, shape (3, 3), of the elements xx, yy, zz, xy, xz, yz."""
    xx, yy, zz, xy, xz, yz = elements
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def elements(matrix: Array) -> Elements:
    """Return the elements xx, yy, zz, xy, xz, yz of a symmetric matrix, shape (3, 3)."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = matrix.tolist()
    return xx, yy, zz, xy, xz, yz


def in_axes(rotation: Array, given: Elements) -> Elements:
    """Return the elements of a tensor in other axes.

    Parameters
    ----------
    rotation : ndarray, shape (3, 3)
        Rotation matrix from the axes of ``given`` to the other axes.
    given : tuple of 6 floats
        Elements of the tensor in its axes.
    """
    return elements(rotation @ tensor(given) @ rotation.T)
