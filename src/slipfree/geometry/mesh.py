"""Triangle meshes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from slipfree.core.records import Array

Faces = npt.NDArray[np.uint32]


class TriangleMesh(NamedTuple):
    """A triangle mesh: vertices (n, 3) [m], and faces (m, 3).

    Faces are the indices of three vertices, counter-clockwise seen from outside.
    """

    vertices: Array
    faces: Faces


def sheet(points: Array, closed: tuple[bool, bool] = (False, False)) -> TriangleMesh:
    """Return the mesh through a grid of points (n, m, 3) [m].

    ``closed`` is whether the last line of points connects to the first, for each direction.
    """
    n, m, _ = points.shape
    i, j = (
        np.arange(size if each else size - 1) for size, each in zip((n, m), closed, strict=True)
    )
    first, right = i[:, None] * m, ((i + 1) % n)[:, None] * m
    here, up = j[None, :], ((j + 1) % m)[None, :]
    a, b, c, d = first + here, right + here, right + up, first + up
    faces = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=2)
    return TriangleMesh(points.reshape(-1, 3), faces.reshape(-1, 3).astype(np.uint32))
