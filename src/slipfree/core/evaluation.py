"""Evaluation of CasADi functions at many points, without conversions of CasADi's matrices."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Any, cast

import casadi as ca
import numpy as np

from slipfree.core.records import Array


def evaluate(function: ca.Function, *columns: Array) -> tuple[Array, ...]:
    """Return the results of a function at n points.

    Column k of each argument (m, n) belongs to point k. The results (nnz, n) are the structural
    nonzeros in CasADi's order: by columns. ValueError is raised for a wrong number of values,
    RuntimeError if the evaluation fails.
    """
    count = columns[0].shape[1]
    mapped = function if count == 1 else _mapped(function, count)
    results = [np.empty((count, function.nnz_out(k))) for k in range(function.n_out())]
    run_buffered(mapped, dict(enumerate(columns)), dict(enumerate(results)))
    return tuple(each.T for each in results)


def run_buffered(
    function: ca.Function, columns: Mapping[int, Array], results: Mapping[int, Array]
) -> ca.FunctionBuffer:
    """Evaluate a function from and to memory of numpy; return the buffer, which has statistics.

    ``columns`` are arguments (m, n) by index, others are zero; ``results`` is the memory (n, m) of
    results by index, one row for each column of a result. Errors are those of `evaluate`.
    """
    buffer = ca.FunctionBuffer(function)
    # CasADi's annotations require a second argument, which memory views do not have
    set_argument, set_result = cast(Any, buffer.set_arg), cast(Any, buffer.set_res)
    given = {k: np.ascontiguousarray(each.T, dtype=float) for k, each in columns.items()}
    for k, array in given.items():
        if array.size != function.nnz_in(k):
            raise ValueError(
                f"argument {k}: expected {function.nnz_in(k)} numbers, found {array.size}"
            )
        if array.size:
            set_argument(k, memoryview(array.data))
    for k, array in results.items():
        if array.size:
            set_result(k, memoryview(array.data))
    buffer._eval()
    if buffer.ret():
        raise RuntimeError(f"the evaluation of {function.name()!r} failed")
    return buffer


# function of many points at once, by function and number of points; repeated runs share it
_mapped = lru_cache(maxsize=32)(ca.Function.map)


def dense(values: Array, sparsity: ca.Sparsity) -> Array:
    """Return matrices from their structural nonzeros of `evaluate`, shape (n, rows, columns)."""
    matrices = np.zeros((values.shape[1], *sparsity.shape))
    rows, columns = sparsity.get_triplet()
    matrices[:, rows, columns] = values.T
    return matrices
