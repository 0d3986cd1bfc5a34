"""Solve a model's algebraic equations at one instant by Newton's method."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.facts import Fact
from slipfree.core.lookups import dense, evaluate
from slipfree.core.newton import ROUNDING, solve_equations, solve_linear
from slipfree.core.records import Array, leaves
from slipfree.solve.system import Block, System

MAX_STEP = 0.25  # largest Newton step of an unknown [typical size]
MAX_STEPS = 100
MAX_DIVISIONS = 3  # maximum depth of bisections of a stage of the continuation
CONVERGED_RESIDUAL = 1e-13  # residual without unit
WEAK_SINGULAR_VALUE = 1e-12  # smaller ones do not take part in a step, relative to the largest
MIN_SINGULAR_VALUE = 1e-10  # smallest singular value of a block, relative to the largest


class UnsolvedError(ModelError):
    """Failure of Newton's method to converge; ``z`` is its last iterate."""

    def __init__(self, message: str, z: Array) -> None:
        super().__init__(message)
        self.z = z


def solve_initial_conditions(
    system: System, t: float, x: Array, z: Array, u: Array, *, continuation: bool = True
) -> Array:
    """Return ``z`` that satisfies all algebraic equations at ``t``, ``x`` and ``u``.

    The equations are solved in blocks, one after another. A block that is linear in its unknowns is
    solved by one Newton step, other blocks by damped Newton steps of limited size, since the
    contact of wheels and ground is strongly nonlinear far from the ground. Without ``continuation``
    only the last value of its parameter is used, which requires a guess ``z`` near a solution.

    ModelError is raised if Newton's method does not converge or a Jacobian is singular. The message
    gives the violated limit, the equation with the largest residual, or the unknown that no
    equation determines.
    """
    z = z.copy()
    for block in system.blocks:
        if block.linear:
            # A step from zero gives the solution itself, so that it does not depend on the guess.
            z[block.span] = 0.0
            residual, jacobian = linearized(block, (t, x, z, u, block.stages[-1]))
            size = system.dae.sizes.z[block.span]
            step = solve_linear((jacobian * size)[None], residual[None], WEAK_SINGULAR_VALUE)
            z[block.span] = -size * step[0]
            _check_regular(system, block, jacobian)
            continue
        z = _solve_block(system, block, (t, x, z, u, block.stages[0 if continuation else -1]))
        for stage in pairwise(block.stages) if continuation else ():
            z = _solve_stage(system, block, (t, x, z, u), stage, MAX_DIVISIONS)
    return z


def _solve_stage(
    system: System,
    block: Block,
    point: tuple[float, Array, Array, Array],
    stage: tuple[float, float],
    depth: int,
) -> Array:
    """Return the unknowns at the second value of the continuation parameter, from the first.

    If Newton's method fails, the stage is divided at the geometric mean of its two values,
    recursively at most ``depth`` times.
    """
    t, x, z, u = point
    try:
        return _solve_block(system, block, (*point, stage[1]))
    except UnsolvedError:
        if not depth:
            raise
    between = float(np.sqrt(stage[0] * stage[1]))
    z = _solve_stage(system, block, (t, x, z, u), (stage[0], between), depth - 1)
    return _solve_stage(system, block, (t, x, z, u), (between, stage[1]), depth - 1)


def _solve_block(
    system: System, block: Block, point: tuple[float, Array, Array, Array, float]
) -> Array:
    t, x, first, u, continuation = point
    z = first.copy()

    def equations(unknowns: Array, _: Any) -> tuple[Array, Array]:
        z[block.span] = unknowns[0]
        residual, jacobian = linearized(block, (t, x, z, u, continuation))
        return residual[None], jacobian[None]

    solution = solve_equations(
        equations,
        first[None, block.span],
        tolerance=CONVERGED_RESIDUAL,
        steps=MAX_STEPS,
        scale=system.dae.scale[block.span],
        longest=MAX_STEP,
        rcond=WEAK_SINGULAR_VALUE,
    )
    z[block.span] = solution.z[0]
    # The descent may end above CONVERGED_RESIDUAL by rounding.
    if not solution.size[0] < ROUNDING * CONVERGED_RESIDUAL:
        raise UnsolvedError(_failure_message(system, block, (t, x, z, u, continuation), first), z)
    _check_regular(system, block, solution.jacobian[0])
    return z


def linearized(block: Block, point: tuple[Any, ...]) -> tuple[Array, Array]:
    """Return the residual of a block, shape (m,), and its Jacobian, shape (m, m)."""
    residual, slopes = evaluate(block.newton, *(np.reshape(each, (-1, 1)) for each in point))
    return residual[:, 0], dense(slopes, block.newton.sparsity_out(1))[0]


def _check_regular(system: System, block: Block, jacobian: Array) -> None:
    """Raise ModelError if the equations of a block do not determine its unknowns."""
    if not np.isfinite(jacobian).all():
        return
    _, values, right = np.linalg.svd(jacobian * system.dae.sizes.z[block.span])
    if values[-1] < MIN_SINGULAR_VALUE * values[0]:
        labels = list(leaves(system.dae.labels.z))[block.span]
        weakest = labels[int(np.abs(right[-1]).argmax())]
        raise ModelError(
            f"the model is singular here: no equation determines {weakest.full} "
            f"({weakest.words}): smallest singular value {values[-1]:.1e}, largest "
            f"{values[0]:.1e}; change the start, the inputs or the vehicle"
        )


def _failure_message(system: System, block: Block, point: tuple[Any, ...], first: Array) -> str:
    """Return a message on a start without a solution: largest residual and violated limits."""
    _, x, z, u, _ = point
    if len(block.stages) > 1:  # there may be no solution, for reasons that the limits describe
        for limit in system.dae.limits:
            if limit.describe is not None:
                words = limit.describe(x, z)
                if words:
                    return f"the vehicle cannot stand at the start: {words}"
    residual = np.nan_to_num(np.abs(np.array(block.residual(*point)).ravel()), nan=np.inf)
    worst = block.labels[int(residual.argmax())]
    size = Fact(float(residual.max()) * system.dae.size_of(worst), worst.unit)
    message = (
        f"no solution was found at the start: {worst.full} ({worst.words}) has a residual of "
        f"{size:.2g}"
    )
    for state in (first, z):
        _, values, _ = system.outputs(0.0, x, state, u)
        for limit, value in zip(system.dae.limits, np.array(values).ravel(), strict=True):
            if limit.violated_by(value, system.dae.size_of(limit.label)):
                words = limit.message(value, x, state)
                return f"{message}; {words}; choose another start or initial guess"
    return f"{message}; choose another start or initial guess"
