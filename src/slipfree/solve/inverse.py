"""States and inputs found from what is wanted: motions along a path, starts from a contact or pose.

Along a path the steering of a vehicle is sought, not integrated. Its rate enters the equations of
rolling with a lever that may be small and change sign, so that an initial value of the angle is
forgotten at once or never held: the angle follows from the path. Collocation finds it. On every
element the states that are sought are polynomials without an initial value; the others continue
from element to element, so that the elements can be solved one after the other. What is left over
at the ends, the jump of the sought states between elements, measures the error.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.polynomial import legendre

from slipfree.dae import Dae
from slipfree.errors import ModelError, SolverError
from slipfree.named import Array, leaves, pack, unpack
from slipfree.solve.loop import Loop, Samples, close, table
from slipfree.solve.settle import consistent, first_violation, settle
from slipfree.solve.simulate import simulate
from slipfree.trajectory import Stop, Trajectory

Model = Dae[Any, Any, Any, Any, Any]
NEWTON = 25  # steps at most on one element
CONVERGED = 1e-12  # residual of an element's equations


class Basis(NamedTuple):
    """Polynomials on an element, by their values at collocation points of (0, 1].

    Attributes
    ----------
    points : ndarray, shape (k,)
        Radau points; the last is one.
    tied : ndarray, shape (k, k + 1)
        Derivatives at the points from values at zero and at the points.
    free : ndarray, shape (k, k)
        The same, of polynomials that have no value at zero.
    """

    points: Array
    tied: Array
    free: Array

    def values(self, at: Array, *, tied: bool) -> Array:
        """Return what leads from the nodal values to those at places of [0, 1]."""
        return _lagrange(np.append(0.0, self.points) if tied else self.points, at)


def basis(degree: int) -> Basis:
    """Return the polynomials of collocation at that many Radau points."""
    difference = np.zeros(degree + 1)
    difference[-2:] = 1.0, -1.0  # of Legendre polynomials: its roots are Radau's points
    points = np.append((1 + legendre.legroots(difference)[:-1].real) / 2, 1.0)
    nodes = np.append(0.0, points)
    return Basis(points, _derivative(nodes)[1:], _derivative(points))


def _lagrange(nodes: Array, at: Array) -> Array:
    """Return the Lagrange polynomials of nodes at places, shape (n_places, n_nodes)."""
    rows = np.ones((len(at), len(nodes)))
    for j, node in enumerate(nodes):
        for other in np.delete(nodes, j):
            rows[:, j] *= (at - other) / (node - other)
    return rows


def _derivative(nodes: Array) -> Array:
    """Return the derivatives of the Lagrange polynomials at their nodes, row by row."""
    gaps = nodes[:, None] - nodes + np.eye(len(nodes))
    weights = 1 / gaps.prod(axis=1)
    matrix = weights / weights[:, None] / gaps
    np.fill_diagonal(matrix, 0.0)
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    return matrix


class Element(NamedTuple):
    """The motion over one element: times of its ends, start of its states, and nodal values."""

    begin: float
    end: float
    first: Array
    x: Array
    z: Array


@dataclass(frozen=True, eq=False)
class Scheme:
    """Collocation of a DAE under laws, some of whose states have no initial value.

    Attributes
    ----------
    loop : Loop
        The DAE.
    basis : Basis
        The polynomials.
    sought : ndarray of bool, shape (n_x,)
        Which states.
    point : casadi Function
        ``(t, x, z) -> (ode, alg, Jacobian of both in x and z)``, mapped over the points.
    """

    loop: Loop
    basis: Basis
    sought: Any
    point: ca.Function

    def solve(self, element: Element) -> Element:
        """Return the element whose equations hold, from a guess of it.

        Raises
        ------
        SolverError
            If Newton's method does not converge.
        """
        x, z = element.x, element.z
        for _ in range(NEWTON):
            residual, jacobian = self._equations(element._replace(x=x, z=z))
            size = float(np.abs(residual).max())
            if not np.isfinite(size):
                break
            step = np.linalg.lstsq(jacobian, residual, rcond=1e-13)[0]
            n_x, k = x.shape
            x = x - step[: n_x * k].reshape(n_x, k)
            z = z - step[n_x * k :].reshape(z.shape)
            if size < CONVERGED:
                return element._replace(x=x, z=z)
        raise SolverError(f"no motion from t = {element.begin:.6g} to {element.end:.6g} s "
            f"(residual {size:.1e})")

    def _equations(self, element: Element) -> tuple[Array, Array]:
        n_x, k = element.x.shape
        n_z, h = element.z.shape[0], element.end - element.begin
        t = element.begin + h * self.basis.points
        ode, alg, jac = (np.array(part) for part in self.point(t[None], element.x, element.z))
        jac = jac.reshape(n_x + n_z, k, n_x + n_z).transpose(1, 0, 2)
        slope = element.x @ self.basis.tied[:, 1:].T + np.outer(element.first, self.basis.tied[:, 0])
        slope[self.sought] = element.x[self.sought] @ self.basis.free.T
        residual = np.concatenate([(slope - h * ode).ravel(), alg.ravel()])
        whole = np.zeros(((n_x + n_z) * k,) * 2)
        grid = whole.reshape(n_x + n_z, k, n_x + n_z, k)
        for p in range(k):
            grid[:n_x, p, :, p] = -h * jac[p, :n_x]
            grid[n_x:, p, :, p] = jac[p, n_x:]
        for i in range(n_x):
            grid[i, :, i, :] += self.basis.free if self.sought[i] else self.basis.tied[:, 1:]
        return residual, whole
