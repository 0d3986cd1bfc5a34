"""Polynomials for collocation at Radau points, represented by their values at nodes."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from slipfree.core.records import Array


class RadauBasis(NamedTuple):
    """Polynomials on the interval [0, 1], represented by their values at Radau points.

    Attributes
    ----------
    points : ndarray, shape (k,)
        Radau points in (0, 1]; the last is 1.
    tied : ndarray, shape (k, k + 1)
        Matrix of the derivatives at the points, from the values at zero and at the points.
    free : ndarray, shape (k, k)
        Matrix of the derivatives at the points, from the values at the points only.
    """

    points: Array
    tied: Array
    free: Array

    def values(self, at: Array, *, tied: bool) -> Array:
        """Return the matrix that interpolates nodal values at n points of [0, 1].

        Its shape is (n, k), or (n, k + 1) if ``tied``: zero is then the first node.
        """
        nodes = np.append(0.0, self.points) if tied else self.points
        return _lagrange_values(nodes, at)

    def integrals(self, at: Array) -> Array:
        """Return the matrix, shape (n, k), that integrates nodal values from 0 to n points."""
        nodes, weights = legendre.leggauss(len(self.points))
        inner = _lagrange_values(self.points, np.outer(at, (1 + nodes) / 2).ravel())
        means = weights / 2 @ inner.reshape(len(at), len(nodes), len(self.points))
        return np.asarray(at[:, None] * means, dtype=np.float64)


@cache
def radau_basis(degree: int) -> RadauBasis:
    """Return the collocation polynomials for ``degree`` Radau points."""
    difference = np.zeros(degree + 1)
    difference[-2:] = 1.0, -1.0  # the roots of this Legendre series are the Radau points
    points = np.append((1 + legendre.legroots(difference)[:-1].real) / 2, 1.0)
    nodes = np.append(0.0, points)
    return RadauBasis(points, _lagrange_derivatives(nodes)[1:], _lagrange_derivatives(points))


def _lagrange_values(nodes: Array, at: Array) -> Array:
    """Return the values of Lagrange polynomials at points, shape (n_points, n_nodes)."""
    rows = np.ones((len(at), len(nodes)))
    for j, node in enumerate(nodes):
        for other in np.delete(nodes, j):
            rows[:, j] *= (at - other) / (node - other)
    return rows


def _lagrange_derivatives(nodes: Array) -> Array:
    """Return the derivatives of Lagrange polynomials, one row per node, shape (n, n)."""
    gaps = nodes[:, None] - nodes + np.eye(len(nodes))
    weights = 1 / gaps.prod(axis=1)
    matrix: Array = weights / weights[:, None] / gaps
    np.fill_diagonal(matrix, 0.0)
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    return matrix
