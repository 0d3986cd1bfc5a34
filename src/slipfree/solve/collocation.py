"""Solve motions by collocation where a path, not an initial value, determines some states.

The equations contain the rate of such a state, for example of a steering angle, times a factor that
may be small and may change sign. The effect of an initial value then vanishes at once or grows
without bound; the path determines the state instead. On every element, these states are polynomials
without an initial value. The other states are continuous between elements, so that the elements are
solved one after the other. The error is estimated from the solutions of two polynomial degrees.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from numpy.polynomial import legendre

from slipfree.core.dae import Dae, invalid_start
from slipfree.core.errors import ModelError, check_known
from slipfree.core.newton import solve_equations, solve_linear
from slipfree.core.records import Array, Mask, Record, leaves
from slipfree.core.trajectory import SolverError, Trajectory
from slipfree.solve.sampling import Samples, complete_samples, linearize, to_trajectory
from slipfree.solve.simulate import check_times, first_violation
from slipfree.solve.system import SolverOptions, System, with_inputs
from slipfree.system.forks import computing

TRIED_DEGREES = (8, 10, 12, 14)  # degrees of the polynomials, tried in this order
MAX_ELEMENTS = 4096
NOISE_GROWTH = 3.0  # growth of the difference of degrees that shows amplified noise
MAX_VAIN_REFINEMENTS = 2  # maximum number of consecutive refinements without improvement
MAX_NEWTON_STEPS = 20  # maximum number of Newton steps per element
CONVERGED_RESIDUAL = 1e-13  # residual of an element's equations, without unit
ROUNDING_RESIDUAL = 1e-10  # residual that is accepted if further steps do not halve it
# relative singular value below which a rate stays out of the first guess
WEAK_SINGULAR_VALUE = 1e-2


class RadauBasis(NamedTuple):
    """Polynomials on the interval [0, 1], represented by their values at Radau points."""

    points: Array  # Radau points in (0, 1]; the last is 1, shape (k,)
    # matrix of the derivatives at the points, from the values at zero and there, shape (k, k + 1)
    tied: Array
    # matrix of the derivatives at the points, from the values at the points only, shape (k, k)
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
    same = np.eye(len(nodes), dtype=bool)
    gaps, away = nodes[:, None] - nodes, at[:, None, None] - nodes
    return np.asarray(
        np.where(same, 1.0, away).prod(axis=2) / np.where(same, 1.0, gaps).prod(axis=1)
    )


def _lagrange_derivatives(nodes: Array) -> Array:
    """Return the derivatives of Lagrange polynomials, one row per node, shape (n, n)."""
    gaps = nodes[:, None] - nodes + np.eye(len(nodes))
    weights = 1 / gaps.prod(axis=1)
    matrix: Array = weights / weights[:, None] / gaps
    np.fill_diagonal(matrix, 0.0)
    np.fill_diagonal(matrix, -matrix.sum(axis=1))
    return matrix


class CollocationElement(NamedTuple):
    """Motion over one element of the collocation."""

    # begin and end: times of its beginning and its end [s]
    begin: float
    end: float
    # states at the beginning; unused for states without an initial value, shape (n_x,)
    first: Array
    # x, z: states (n_x, k) and unknowns (n_z, k) of the motion at the k collocation points
    x: Array
    z: Array


@dataclass(frozen=True, eq=False)
class CollocationScheme:
    """Collocation of a DAE under given inputs; some of its states have no initial value."""

    system: System
    free_states: Mask  # true for the states without an initial value, shape (n_x,)
    basis: RadauBasis  # polynomials on an element
    # ``(t, x, z) -> (ode, alg, Jacobian of both with respect to x and z)`` at all collocation
    # points of an element; ``z`` are the unknowns of the motion
    point: ca.Function

    def march(self, t: Array, first: Array, z: Array) -> list[CollocationElement]:
        """Return the elements of a motion between times ``t``, solved one after the other.

        ``first`` are the states at the beginning, ``z`` an initial guess of the unknowns of the
        motion. Raises SolverError if Newton's method fails on an element.
        """
        elements: list[CollocationElement] = []
        degree, x = len(self.basis.points), first
        for begin, end in pairwise(t):
            guess = CollocationElement(
                begin, end, first, *(np.repeat(v[:, None], degree, 1) for v in (x, z))
            )
            elements.append(self._solve_element(guess))
            first = x = elements[-1].x[:, -1]
            z = elements[-1].z[:, -1]
        return elements

    def _solve_element(self, element: CollocationElement) -> CollocationElement:
        """Return the solution of an element by Newton's method from an initial guess."""
        n_x = element.x.size

        def at(values: Array) -> CollocationElement:
            x, z = values[:n_x].reshape(element.x.shape), values[n_x:].reshape(element.z.shape)
            return element._replace(x=x, z=z)

        def equations(values: Array, _: Any) -> tuple[Array, Array]:
            residual, jacobian = self._equations(at(values[0]))
            return residual[None], jacobian[None]

        first = np.concatenate([element.x.ravel(), element.z.ravel()])[None]
        root = solve_equations(
            equations, first, tolerance=CONVERGED_RESIDUAL, steps=MAX_NEWTON_STEPS
        )
        if not root.size[0] < ROUNDING_RESIDUAL:
            raise SolverError(
                f"found no motion from t = {element.begin:.4g} to {element.end:.4g} s that follows "
                f"the path (residual {root.size[0]:.1e}): the path may stop or bend too sharply "
                "there; smooth the path or omit this part"
            )
        return at(root.z[0])

    def _equations(self, element: CollocationElement) -> tuple[Array, Array]:
        """Return the residual and the Jacobian of an element, shapes (n k,) and (n k, n k).

        Equations and unknowns are in the order of ``x``, then ``z``; each component has its values
        at the k points in succession.
        """
        (n_x, k), n = element.x.shape, len(element.x) + len(element.z)
        h, tied, free = element.end - element.begin, self.basis.tied, self.basis.free
        t = element.begin + h * self.basis.points
        ode, alg, jac = (np.array(part) for part in self.point(t[None], element.x, element.z))
        slope = element.x @ tied[:, 1:].T + np.outer(element.first, tied[:, 0])
        # The polynomials of free states have no node at the beginning.
        slope[self.free_states] = element.x[self.free_states] @ free.T
        size = self.system.dae.sizes.x
        residual = np.concatenate([((slope - h * ode) / size[:, None]).ravel(), alg.ravel()])
        jac = jac.reshape(n, k, n)
        # Rows are divided by the sizes of the states, so that one tolerance suits all equations.
        jac[:n_x] *= -h / size[:, None, None]
        matrix = np.zeros((n, k, n, k))
        matrix[:, np.arange(k), :, np.arange(k)] = jac.transpose(1, 0, 2)
        for i in range(n_x):
            matrix[i, :, i, :] += (free if self.free_states[i] else tied[:, 1:]) / size[i]
        return residual, matrix.reshape(n * k, n * k)

    def samples(self, elements: Sequence[CollocationElement], t: Array) -> Samples:
        """Return the motion at times, with quadratures that are zero at the beginning.

        Unknowns that do not belong to the motion are NaN.
        """
        ends = np.array([element.end for element in elements])
        which = np.minimum(np.searchsorted(ends, t), len(elements) - 1)
        x, z = (np.zeros((len(v), t.size)) for v in (elements[0].x, elements[0].z))
        q = np.zeros((self.system.dae.quad.numel(), t.size))
        watch = self.system.watch.map(len(self.basis.points))
        given = np.repeat(self.system.u[:, :1], len(self.basis.points), axis=1)
        total = np.zeros((len(q), 1))
        for index, element in enumerate(elements):
            h, here = element.end - element.begin, which == index
            at = (t[here] - element.begin) / h
            tied, free = self.basis.values(at, tied=True), self.basis.values(at, tied=False)
            x[:, here] = np.column_stack([element.first, element.x]) @ tied.T
            x[np.ix_(self.free_states, here)] = element.x[self.free_states] @ free.T
            z[:, here] = element.z @ free.T
            times = element.begin + h * self.basis.points
            rates = h * np.array(watch(times[None], element.x, element.z, given)[0])
            q[:, here] = total + rates @ self.basis.integrals(at).T
            total = total + rates @ self.basis.integrals(np.ones(1)).T
        rest = np.full((self.system.dae.guess.numel() - len(z), t.size), np.nan)
        return Samples(
            t, x, np.concatenate([z, rest]), q, np.repeat(self.system.u[:, :1], t.size, axis=1)
        )

    def points(self, elements: Sequence[CollocationElement]) -> tuple[Array, Array]:
        """Return the times of the start and of all collocation points, and the unknowns there.

        Their shapes are (n,) and (n_z, n).
        """
        first, points = elements[0], self.basis.points
        begin = first.z @ self.basis.values(np.zeros(1), tied=False).T
        times = [e.begin + (e.end - e.begin) * points for e in elements]
        return np.concatenate([[first.begin], *times]), np.hstack([begin, *(e.z for e in elements)])


def collocation_schemes(system: System, free_states: Mask) -> list[CollocationScheme]:
    """Return the collocation schemes of a DAE, one for each of `TRIED_DEGREES`."""
    t, x, z = (ca.MX.sym(name, system.core.size1_in(k)) for k, name in enumerate("txz"))
    u = ca.DM(system.u[:, 0])
    ode, alg = system.core(t, x, z, u)
    ode_x, alg_x, ode_z, alg_z = system.jacobian(t, x, z, ca.MX(0, 1), u)
    slopes = ca.densify(ca.blockcat([[ode_x, ode_z], [alg_x, alg_z]]))
    point = ca.Function("point", [t, x, z], [ode, alg, slopes])
    return [
        CollocationScheme(system, free_states, radau_basis(degree), point.map(degree))
        for degree in TRIED_DEGREES
    ]


class CollocatedMotion(NamedTuple):
    """Result of `drive`: a motion, and its unknowns at the collocation points."""

    run: Trajectory  # the motion, with a stop if it violates a limit
    t: Array  # times of the collocation points, shape (n,) [s]
    unknowns: dict[str, Array]  # unknowns of the motion at these times, by name, shape (n,)


@computing
def drive(
    dae: Dae,
    start: Trajectory,
    inputs: Record,
    t: Array,
    *,
    free_states: Sequence[str],
    options: SolverOptions = SolverOptions(),
) -> CollocatedMotion:
    """Return the motion of a model with states that have no initial value.

    Elements are shortened until the solutions of two polynomial degrees agree on these states
    within the tolerance. If they never do, the solution with the best agreement is returned, since
    short elements of high degree amplify noise of the path. The motion ends before the first sample
    that violates a limit.

    Parameters
    ----------
    dae : Dae
        The model.
    start : Trajectory
        Trajectory whose last sample is the start; its values of ``free_states`` are only an
        initial guess.
    inputs : record
        From ``dae.inputs(...)``: constants, or expressions of time.
    t : ndarray, shape (n,)
        Ascending times of the samples. [s]
    free_states : sequence of str
        States without an initial value.
    options : SolverOptions
        Options of the solvers; the tolerance applies to the states in ``free_states``.

    Raises
    ------
    ModelError
        If an argument is invalid, or the first or second sample violates a limit.
    SolverError
        If Newton's method finds no solution of the collocation equations.
    """
    t, names = check_times(t), [label.full for label in leaves(dae.labels.x)]
    check_known("free_states", free_states, names, "names of states,")
    clock, system = time.process_time(), with_inputs(dae, inputs, 0, options)
    mask = np.array([name in free_states for name in names])
    best, elements, error = _refine_elements(system, mask, start, t, options.tolerance)
    # a Newton step on the first block, that of the pose
    samples, block = best.samples(elements, t), system.blocks[0]
    residual, jacobian = linearize(block, samples)
    step = solve_linear(jacobian, residual.T).T
    samples.z[block.span] -= step
    samples, report = complete_samples(system, samples)
    report = {"newton_step": np.abs(step).max(axis=0), **report}
    run = to_trajectory(system, samples, report)
    fault = first_violation(system, run, samples)
    if fault is not None:
        k, stop = fault
        if k == 0:
            raise invalid_start(stop.words)
        if k == 1:
            raise ModelError(
                "t: expected at least two samples within the limits of the model, found a "
                f"violation at the second: {stop.words}; choose another start or a shorter first "
                "step"
            )
        run = run.part(slice(k), stop._replace(t=float(run.t[k - 1])))
    statistics = {
        "elements": float(len(elements)),
        "degree": float(len(best.basis.points)),
        "sought_error": error,
        "cpu_seconds": time.process_time() - clock,
    }
    times, unknowns = best.points(elements)
    names = [label.full for label in leaves(dae.labels.z)][: len(unknowns)]
    return CollocatedMotion(
        replace(run, statistics=statistics), times, dict(zip(names, unknowns, strict=True))
    )


def _refine_elements(
    system: System, free_states: Mask, start: Trajectory, t: Array, tolerance: float
) -> tuple[CollocationScheme, list[CollocationElement], float]:
    """Return the scheme and elements at which two degrees agree best, and an error estimate.

    The degrees are those of the polynomials on the elements. The estimate is the largest difference
    of the free states, divided by their sizes. If the differences decrease from degree to degree,
    it is at least what this decrease predicts: a smaller difference is due to chance.
    """
    x = system.dae.rows("x", start, -1)
    z = system.dae.rows("z", start, -1)
    for block in system.blocks:
        if block.linear:  # least norm: rates that the block hardly determines stay near zero
            z[block.span] = 0.0
            point = (float(t[0]), x, z, system.u[:, 0], block.stages[-1])
            residual, jacobian = (np.array(each) for each in block.newton(*point))
            size = system.dae.sizes.z[block.span]
            step = np.linalg.lstsq(jacobian * size, residual.ravel(), rcond=WEAK_SINGULAR_VALUE)[0]
            z[block.span] = -size * step
    z = z[: system.motion_size]
    tried = collocation_schemes(system, free_states)
    best: tuple[CollocationScheme, list[CollocationElement], float] | None = None
    failure = SolverError("found no motion that follows the path; smooth the path")
    count, vain = 1, 0
    while count <= MAX_ELEMENTS and vain < MAX_VAIN_REFINEMENTS:
        ends, vain = np.linspace(t[0], t[-1], count + 1), vain + (best is not None)
        former: tuple[CollocationScheme, list[CollocationElement], Array] | None = None
        least, trend = np.inf, 0.0
        for each in tried:
            try:
                elements = each.march(ends, x, z)
            except SolverError as problem:
                failure = problem
                break
            values = (
                each.samples(elements, t).x[free_states] / system.dae.sizes.x[free_states, None]
            )
            if former is not None:
                difference = float(np.abs(values - former[2]).max(initial=0.0))
                error = max(difference, trend)  # noise of the higher degree may cancel the error
                if best is None or error < best[2]:
                    best, vain = (former[0], former[1], error), 0  # lower degree, less noise
                if error < tolerance:
                    return best
                if difference > NOISE_GROWTH * least:
                    break
                trend = difference**2 / least if difference < least else 0.0
                least = difference
            former = each, elements, values
        count += (count + 1) // 2
    if best is None:
        raise failure
    return best
