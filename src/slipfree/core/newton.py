"""Newton's method with damped steps of limited length, for many samples of equations at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from slipfree.core.records import Array

MAX_HALVINGS = 12  # of a step that does not reduce the residual
SINGULAR_VALUE = 1e-15  # smaller ones count as zero in a singular matrix, relative to the largest
ROUNDING = 1e3  # a residual that no step reduces is solved below this multiple of the tolerance


class Roots(NamedTuple):
    """Unknowns (n, m) of n samples, the Jacobians (n, m, m) and the sizes of the residuals (n,)."""

    z: Array
    jacobian: Array
    size: Array


def solve_equations(
    equations: Callable[[Array, Any], tuple[Array, Array]],
    z: Array,
    *,
    tolerance: float,
    steps: int,
    scale: Array | float = 1.0,
    longest: float = np.inf,
    rcond: float | None = None,
) -> Roots:
    """Return the unknowns of n samples after damped Newton steps from ``z``, shape (n, m).

    ``equations(z, rows)`` returns residuals (k, m) and Jacobians (k, m, m) of the samples ``rows``
    at unknowns (k, m). Steps are at most ``longest`` in units of ``scale``, and are halved until
    they reduce the norm of the residual. A sample is finished at a norm below ``tolerance``, where
    its Jacobian is not finite, and where no step reduces the residual, by rounding or at a local
    minimum. ``rcond`` is that of `solve_linear`.
    """
    z, is_open = z.copy(), np.ones(len(z), dtype=bool)
    residual, jacobian = (each.copy() for each in equations(z, np.arange(len(z))))
    size = np.linalg.norm(residual, axis=1)
    for _ in range(steps):
        is_open &= ~(size < tolerance) & np.isfinite(jacobian).all(axis=(1, 2))
        left = np.flatnonzero(is_open)
        if not left.size:
            break
        step = np.zeros(z.shape)
        step[left] = scale * solve_linear(jacobian[left] * scale, residual[left], rcond)
        length = np.abs(step / scale).max(axis=1)
        step *= np.minimum(1.0, longest / np.maximum(length, 1e-300))[:, None]
        for _ in range(MAX_HALVINGS):
            trial = z[left] - step[left]
            new, slopes = equations(trial, left)
            trial_size = np.linalg.norm(new, axis=1)
            # from a residual that is NaN, the first step is accepted
            is_better = (trial_size < size[left]) | ~(size[left] > 0)
            good = left[is_better]
            z[good], residual[good], jacobian[good], size[good] = (
                each[is_better] for each in (trial, new, slopes, trial_size)
            )
            is_open[left] = is_better
            left = left[~is_better & (size[left] > ROUNDING * tolerance)]
            if not left.size:
                break
            step[left] /= 2
    return Roots(z, jacobian, size)


def solve_linear(matrices: Array, right: Array, rcond: float | None = None) -> Array:
    """Return the solutions of n linear systems, shape (n, m) or (n, m, k).

    Singular systems have solutions of least norm; with ``rcond`` these are the systems with a
    singular value below this share of the largest. Systems that are not finite have NaN.
    """
    columns = right.reshape(*right.shape[:2], -1)
    if rcond is None:
        try:
            return np.asarray(np.linalg.solve(matrices, columns).reshape(right.shape))
        except np.linalg.LinAlgError:
            rcond = SINGULAR_VALUE
    finite, found = np.isfinite(matrices).all(axis=(1, 2)), np.full(columns.shape, np.nan)
    found[finite] = np.linalg.pinv(matrices[finite], rcond) @ columns[finite]
    return found.reshape(right.shape)
