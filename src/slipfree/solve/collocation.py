"""Solve motions by collocation, with some states determined by a path instead of a start.

The rate of such a state, as of a steering angle, enters the equations with a factor that may be
small and change sign, so that an initial value is forgotten at once or never held: the state
follows from the path. On every element the states that are sought are polynomials without an
initial value; the others continue from element to element, so that the elements are solved one
after the other. The jump of the sought states between elements measures the error.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.forks import computing
from slipfree.records import Array, Mask, leaves
from slipfree.solve.options import SolverOptions
from slipfree.solve.radau import RadauBasis, radau_basis
from slipfree.solve.sampling import Samples, complete_samples, to_trajectory
from slipfree.solve.simulate import check_times
from slipfree.solve.system import System, with_inputs
from slipfree.solve.violations import first_violation
from slipfree.trajectory import SolverError, Stop, Trajectory

TRIED_DEGREES = (8, 10, 12, 14)  # of an element, tried in this order
MAX_ELEMENTS = 4096
NOISE_GROWTH = 3.0  # growth of the difference of degrees that shows amplified noise
MAX_VAIN_REFINEMENTS = 2  # refinements without improvement
MAX_NEWTON_STEPS = 20  # per element
CONVERGED_RESIDUAL = 1e-13  # residual of an element's equations, without unit
ROUNDING_RESIDUAL = 1e-10  # the same, if it does not become less
WEAK_SINGULAR_VALUE = (
    1e-2  # relative singular value below which a rate stays out of the first guess
)


class CollocationElement(NamedTuple):
    """The motion over one element.

    Attributes
    ----------
    begin, end : float
        Times of its ends. [s]
    first : ndarray, shape (n_x,)
        States at its beginning.
    x, z : ndarray, shape (n_x, k) and (n_z, k)
        States and unknowns at its points.
    """

    begin: float
    end: float
    first: Array
    x: Array
    z: Array


@dataclass(frozen=True, eq=False)
class CollocationScheme:
    """Collocation of a DAE under laws, some of whose states have no initial value.

    Attributes
    ----------
    system : System
        The DAE.
    sought : ndarray of bool, shape (n_x,)
        Which states.
    basis : Basis
        The polynomials.
    point : casadi Function
        ``(t, x, z) -> (ode, alg, Jacobian of ode and alg in x and z)``, at all points, where
        ``z`` are the unknowns of the motion.
    """

    system: System
    sought: Mask
    basis: RadauBasis
    point: ca.Function

    def march(self, t: Array, first: Array, z: Array) -> list[CollocationElement]:
        """Return the motion over the elements between times, from a start and a guess of ``z``."""
        elements: list[CollocationElement] = []
        degree, x = len(self.basis.points), first
        for begin, end in pairwise(t):
            guess = CollocationElement(
                begin, end, first, *(np.repeat(v[:, None], degree, 1) for v in (x, z))
            )
            elements.append(self._solved(guess))
            first = x = elements[-1].x[:, -1]
            z = elements[-1].z[:, -1]
        return elements

    def _solved(self, element: CollocationElement) -> CollocationElement:
        """Solve the equations of an element by Newton's method, from a guess of it."""
        size, n_x = np.inf, element.x.size
        for _ in range(MAX_NEWTON_STEPS):
            residual, jacobian = self._equations(element)
            former, size = size, float(np.abs(residual).max())
            if (
                not np.isfinite(size)
                or size < CONVERGED_RESIDUAL
                or former < min(2 * size, ROUNDING_RESIDUAL)
            ):
                break
            try:
                step = np.linalg.solve(jacobian, residual)
            except np.linalg.LinAlgError:
                break
            element = element._replace(
                x=element.x - step[:n_x].reshape(element.x.shape),
                z=element.z - step[n_x:].reshape(element.z.shape),
            )
        if not size < ROUNDING_RESIDUAL:
            raise SolverError(
                f"no motion from t = {element.begin:.4g} to {element.end:.4g} s follows the path "
                f"(residual {size:.1e}): it may stand still, or be too winding there"
            )
        return element

    def _equations(self, element: CollocationElement) -> tuple[Array, Array]:
        """Return residual and Jacobian; unknowns are ``x``, then ``z``, point by point."""
        (n_x, k), n = element.x.shape, len(element.x) + len(element.z)
        h, tied, free = element.end - element.begin, self.basis.tied, self.basis.free
        t = element.begin + h * self.basis.points
        ode, alg, jac = (np.array(part) for part in self.point(t[None], element.x, element.z))
        slope = element.x @ tied[:, 1:].T + np.outer(element.first, tied[:, 0])
        slope[self.sought] = element.x[self.sought] @ free.T
        size = self.system.dae.sizes.x
        residual = np.concatenate([((slope - h * ode) / size[:, None]).ravel(), alg.ravel()])
        jac = jac.reshape(n, k, n)
        jac[:n_x] *= -h / size[:, None, None]
        matrix = np.zeros((n, k, n, k))
        matrix[:, np.arange(k), :, np.arange(k)] = jac.transpose(1, 0, 2)
        for i in range(n_x):
            matrix[i, :, i, :] += (free if self.sought[i] else tied[:, 1:]) / size[i]
        return residual, matrix.reshape(n * k, n * k)

    def samples(self, elements: Sequence[CollocationElement], t: Array) -> Samples:
        """Return the motion at times; the quadratures begin at zero."""
        ends = np.array([element.end for element in elements])
        which = np.minimum(np.searchsorted(ends, t), len(elements) - 1)
        x, z = (np.zeros((len(v), t.size)) for v in (elements[0].x, elements[0].z))
        q = np.zeros((self.system.dae.quad.numel(), t.size))
        quad = self.system.quad.map(len(self.basis.points))
        given = np.repeat(self.system.u[:, :1], len(self.basis.points), axis=1)
        total = np.zeros((len(q), 1))
        for index, element in enumerate(elements):
            h, here = element.end - element.begin, which == index
            at = (t[here] - element.begin) / h
            tied, free = self.basis.values(at, tied=True), self.basis.values(at, tied=False)
            x[:, here] = np.column_stack([element.first, element.x]) @ tied.T
            x[np.ix_(self.sought, here)] = element.x[self.sought] @ free.T
            z[:, here] = element.z @ free.T
            times = element.begin + h * self.basis.points
            rates = h * np.array(quad(times[None], element.x, element.z, given))
            q[:, here] = total + rates @ self.basis.integrals(at).T
            total = total + rates @ self.basis.integrals(np.ones(1)).T
        rest = np.full((self.system.dae.guess.numel() - len(z), t.size), np.nan)
        return Samples(
            t, x, np.concatenate([z, rest]), q, np.repeat(self.system.u[:, :1], t.size, axis=1)
        )

    def points(self, elements: Sequence[CollocationElement]) -> tuple[Array, Array]:
        """Return the times of the start and of all points, and the unknowns there in rows."""
        first, points = elements[0], self.basis.points
        begin = first.z @ self.basis.values(np.zeros(1), tied=False).T
        times = [e.begin + (e.end - e.begin) * points for e in elements]
        return np.concatenate([[first.begin], *times]), np.hstack([begin, *(e.z for e in elements)])


def collocation_schemes(system: System, sought: Mask) -> list[CollocationScheme]:
    """Return the collocations of a DAE under laws at the numbers of points that are tried."""
    t, x, z = (ca.MX.sym(name, system.core.size1_in(k)) for k, name in enumerate("txz"))
    u = ca.DM(system.u[:, 0])
    ode, alg = system.core(t, x, z, u)
    ode_x, alg_x, ode_z, alg_z = system.jacobian(t, x, z, ca.MX(0, 1), u)
    slopes = ca.densify(ca.blockcat([[ode_x, ode_z], [alg_x, alg_z]]))
    point = ca.Function("point", [t, x, z], [ode, alg, slopes])
    return [
        CollocationScheme(system, sought, radau_basis(degree), point.map(degree))
        for degree in TRIED_DEGREES
    ]


class Drive(NamedTuple):
    """A motion along a path.

    Attributes
    ----------
    run : Trajectory
        The motion.
    t : ndarray, shape (n,)
        Times of the collocation points. [s]
    unknowns : dict of str to ndarray of shape (n,)
        The unknowns of the motion at these times, by name.
    """

    run: Trajectory
    t: Array
    unknowns: dict[str, Array]


@computing
def drive(
    dae: Dae,
    start: Trajectory,
    inputs: Any,
    t: Array,
    *,
    sought: Sequence[str],
    options: SolverOptions = SolverOptions(),
) -> Drive:
    """Return the motion of a model some of whose states have no initial value.

    Elements are shortened until two degrees agree on the sought states within the tolerance, or as
    well as they ever do: on short elements of high degree fast changes count as smooth, and noise
    of the path is amplified.

    Parameters
    ----------
    dae : Dae
        The model.
    start : Trajectory
        Its last sample is where the motion starts, but for the sought states.
    inputs : record
        From ``dae.inputs(...)``: constants, or expressions of time.
    t : ndarray, shape (n,)
        Ascending times of the samples. [s]
    sought : sequence of str
        States without an initial value.
    options : SolverOptions
        Options of the solvers; the tolerance is that of the sought states.

    Raises
    ------
    ModelError
        If an argument is not usable, or the start is not valid.
    SolverError
        If there is no such motion.
    """
    t, names = check_times(t), [label.full for label in leaves(dae.labels.x)]
    if not set(sought) <= set(names):
        raise ModelError(f"sought: expected some of {', '.join(names)}, found {', '.join(sought)}")
    clock, system = time.process_time(), with_inputs(dae, inputs, 0, options)
    mask = np.array([name in sought for name in names])
    best, elements, error = _refine_elements(system, mask, start, t, options.tolerance)
    samples, report = _correct_pose(system, best.samples(elements, t))
    run = to_trajectory(system, samples, report)
    fault = first_violation(system, run, samples)
    if fault is not None:
        run = _cut_before(run, *fault)
    statistics = {
        "elements": float(len(elements)),
        "degree": float(len(best.basis.points)),
        "sought_error": error,
        "cpu_seconds": time.process_time() - clock,
    }
    times, unknowns = best.points(elements)
    names = [label.full for label in leaves(dae.labels.z)][: len(unknowns)]
    return Drive(
        replace(run, statistics=statistics), times, dict(zip(names, unknowns, strict=True))
    )


def _refine_elements(
    system: System, sought: Mask, start: Trajectory, t: Array, tolerance: float
) -> tuple[CollocationScheme, list[CollocationElement], float]:
    """Return the motion on the elements on which two degrees agree best, and how well."""
    x = system.dae.rows("x", start, -1)
    z = _guess_unknowns(system, float(t[0]), x, system.dae.rows("z", start, -1))[
        : system.motion_size
    ]
    tried = collocation_schemes(system, sought)
    best: tuple[CollocationScheme, list[CollocationElement], float] | None = None
    failure, count, vain = SolverError("no motion was found"), 1, 0
    while count <= MAX_ELEMENTS and vain < MAX_VAIN_REFINEMENTS:
        ends, vain = np.linspace(t[0], t[-1], count + 1), vain + (best is not None)
        former: tuple[CollocationScheme, list[CollocationElement], Array] | None = None
        least = np.inf
        for each in tried:
            try:
                elements = each.march(ends, x, z)
            except SolverError as problem:
                failure = problem
                break
            values = each.samples(elements, t).x[sought] / system.dae.sizes.x[sought, None]
            if former is not None:
                error = float(np.abs(values - former[2]).max(initial=0.0))
                if best is None or error < best[2]:
                    best, vain = (former[0], former[1], error), 0  # it amplifies noise less
                if error < tolerance:
                    return best
                if error > NOISE_GROWTH * least:
                    break
                least = error
            former = each, elements, values
        count += (count + 1) // 2
    if best is None:
        raise failure
    return best


def _guess_unknowns(system: System, t: float, x: Array, z: Array) -> Array:
    """Return a first guess of ``z``: rates that need not be large are left at zero."""
    for block in system.blocks:
        if block.linear:
            z[block.span] = 0.0
            point = (t, x, z, system.u[:, 0], block.stages[-1])
            jacobian, residual = np.array(block.jacobian(*point)), np.array(block.residual(*point))
            size = system.dae.sizes.z[block.span]
            step = np.linalg.lstsq(jacobian * size, residual.ravel(), rcond=WEAK_SINGULAR_VALUE)[0]
            z[block.span] = -size * step
    return z


def _correct_pose(system: System, samples: Samples) -> tuple[Samples, dict[str, Array]]:
    """Return the samples after a Newton step on the first block, and their residuals."""
    block, z = system.blocks[0], samples.z.copy()
    for k, t in enumerate(samples.t):
        point = (t, samples.x[:, k], z[:, k], samples.u[:, k], block.stages[-1])
        z[block.span, k] -= np.linalg.solve(
            np.array(block.jacobian(*point)), np.array(block.residual(*point)).ravel()
        )
    step = np.abs(z - samples.z)[block.span].max(axis=0)
    found, report = complete_samples(system, samples._replace(z=z))
    return found, {"newton_step": step, **report}


def _cut_before(run: Trajectory, k: int, stop: Stop) -> Trajectory:
    """Return the samples before the one that violates a limit."""
    if k == 0:
        raise ModelError(f"the start is not valid: {stop.words}")
    if k == 1:
        raise ModelError(f"t: a motion needs two samples, and before the second {stop.words}")
    return run.part(slice(k), stop._replace(t=float(run.t[k - 1])))
