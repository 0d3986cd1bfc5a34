"""Assemble a sparse nonlinear program with exact derivatives from small repeated blocks.

A block is a function of few unknowns, repeated at many points. Results of ground lookups are its
arguments, so that it contains no calls: it is the same for every ground, and CasADi computes its
exact derivatives. They are evaluated for many points at once (`slipfree.core.lookups.in_lanes`),
or point by point if they are compiled. The results are added to large sparse matrices by index.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from slipfree.core.lookups import Lookup, check_order, found_column, in_lanes, needed_lookups
from slipfree.core.records import Array
from slipfree.system.codegen_cache import compiled_functions

Index = npt.NDArray[np.intp]
DERIVATIVE_ORDER = 4  # of the ground height: two in the model, two more in the Hessian
BlockFunctions = tuple[ca.Function, ca.Function, ca.Function, ca.Function]
# results of the functions of a block, by rows and columns: unknowns "v", rows "g", or one
RESULTS = {
    "gradient": [("", ""), ("v", "")],
    "rows": [("g", "")],
    "jacobian": [("g", ""), ("g", "v")],
    "hessian": [("v", "v")],
}


class BlockLookup(NamedTuple):
    """Ground lookup of a block: a function, and the expression of its argument."""

    argument: ca.Function  # function ``(v, q, p, c) ->``; ``c``: results of preceding lookups
    function: ca.Function  # function from the argument to the result of the lookup


class NlpBlock(NamedTuple):
    """Cost and constraint functions that a program repeats at n points, with derivatives.

    The arguments of all functions are unknowns ``v``, constants ``q``, parameters ``p`` and lookup
    results ``c``; derivatives are with respect to ``v``.
    """

    gradient: ca.Function  # function ``(v, q, p, c) -> (cost, gradient of the cost)``
    rows: ca.Function  # function ``(v, q, p, c) -> rows`` (constraint functions)
    jacobian: ca.Function  # function ``(v, q, p, c) -> (rows, Jacobian of the rows)``
    hessian: ca.Function  # function ``(v, q, p, c, s, l) ->`` upper triangle
    lookups: tuple[BlockLookup, ...]  # lookups in the order of their evaluation
    variable_indices: Index  # shape (n, n_v): indices of ``v`` among the unknowns
    row_indices: Index  # shape (n, n_rows): indices among all rows of the program
    constants: Array  # shape (n, n_q): values of ``q`` for each point


def nlp_block(
    symbols: tuple[ca.SX, ca.SX, ca.SX],
    cost: ca.SX,
    rows: ca.SX,
    lookups: Sequence[Lookup],
    indices: tuple[Index, Index],
    constants: Array,
    *,
    compiled: bool = False,
) -> NlpBlock:
    """Return a block of a program with its derivatives.

    ``cost`` and ``rows`` at a point are expressions of ``symbols``, the unknowns, constants and
    parameters ``v, q, p``, and of ``lookups``. ``indices`` are ``variable_indices`` and
    ``row_indices`` of `NlpBlock`, ``constants`` the values of ``q`` for each point, shape (n, n_q).
    """
    lookups = needed_lookups(lookups, [cost, rows])
    check_order(lookups, DERIVATIVE_ORDER, "a plan")
    # Derivatives of these rows have few common subexpressions (5 % of the operations of Hessians);
    # the search for them would take a third of a transcription.
    results = [ca.densify(cost), ca.cse(ca.densify(rows))]
    values = ca.Function("values", [*symbols, found_column(lookups)], results)
    block_lookups = tuple(
        BlockLookup(
            ca.Function("argument", [*symbols, found_column(lookups[:k])], [each.argument]),
            each.function,
        )
        for k, each in enumerate(lookups)
    )
    functions = differentiate_block(values.serialize(), compiled=compiled)
    return NlpBlock(*functions, block_lookups, *indices, constants)


@lru_cache(maxsize=8)
def differentiate_block(text: str, *, compiled: bool) -> BlockFunctions:
    """Return the functions of `NlpBlock`; cached, since blocks are equal on all meshes.

    ``text`` is the serialised function ``(v, q, p, c) -> (cost, rows)``.
    """
    values = ca.Function.deserialize(text)
    arguments = values.sx_in()
    v, (cost, rows) = arguments[0], values.call(arguments)

    def large() -> list[ca.Function]:
        """Return the rows, their Jacobian and the Hessian of the Lagrangian."""
        s, multipliers = ca.SX.sym("s"), ca.SX.sym("l", rows.numel())
        hessian = ca.triu(ca.hessian(s * cost + ca.dot(multipliers, rows), v)[0])
        return [
            ca.Function("rows", arguments, [rows]),
            ca.Function("jacobian", arguments, [rows, ca.jacobian(rows, v)]),
            ca.Function("hessian", [*arguments, s, multipliers], [hessian]),
        ]

    names = ("rows", "jacobian", "hessian")
    of_rows, jacobian, hessian = compiled_functions(values, names, large, compiled=compiled)
    gradient = ca.Function("gradient", arguments, [cost, ca.gradient(cost, v)])
    return gradient, of_rows, jacobian, hessian


class ProgramFunctions(NamedTuple):
    """Cost ``f(w, p)`` and constraint functions ``g(w, p)`` of a program, with derivatives."""

    w: ca.MX  # shape (n_w, 1): unknowns, divided by their scale
    p: ca.MX  # shape (n_p, 1): parameters
    f: ca.MX  # shape (1, 1): cost
    g: ca.MX  # shape (n_g, 1): rows (constraint functions)
    gradient: ca.Function  # function ``(w, p) -> (f, gradient of f)``
    jacobian: ca.Function  # function ``(w, p) -> (g, Jacobian of g)``
    hessian: ca.Function  # function ``(w, p, s, l) ->`` upper triangle of ``s f + l' g``


def assemble(blocks: Sequence[NlpBlock], scale: Array, n_p: int) -> ProgramFunctions:
    """Return the program of blocks, which take the unknowns times ``scale``; equal rows add up."""
    n_g = 1 + max(each.row_indices.max(initial=-1) for each in blocks)
    w, p = ca.MX.sym("w", scale.size), ca.MX.sym("p", n_p)
    sigma, multipliers = ca.MX.sym("sigma"), ca.MX.sym("lambda", n_g)
    v = w * scale

    def together(name: str, *of_hessian: ca.MX) -> list[ca.MX]:
        """Return the results of a function of all blocks, as matrices of the program."""
        # values, entries and factors of each block
        parts: list[list[tuple[ca.MX, tuple[Index, Index], Array]]] = [[] for _ in RESULTS[name]]
        for each in blocks:
            count, function = len(each.variable_indices), getattr(each, name)
            own = [_gather(v, each.variable_indices), ca.MX(ca.DM(each.constants)), p.T]
            lookups = ca.MX(count, 0)
            for argument, lookup in each.lookups:
                asked = _evaluate_everywhere(argument, [*own, lookups], count)[0]
                found = lookup.map(count)(ca.reshape(asked, count, -1).T)
                lookups = ca.horzcat(lookups, found.T)
            own.append(lookups)
            if of_hessian:
                own += [of_hessian[0], _gather(of_hessian[1], each.row_indices)]
            values = _evaluate_everywhere(function, own, count)
            none = np.zeros((count, 1), dtype=np.intp)
            at = {"": none, "v": each.variable_indices, "g": each.row_indices}
            for k, axes in enumerate(RESULTS[name]):
                inside = function.sparsity_out(k).get_triplet()
                row, column = (np.array(part, dtype=np.intp) for part in inside)
                rows, columns = at[axes[0]].T[row].ravel(), at[axes[1]].T[column].ravel()
                factor = sizes[axes[0]][rows] * sizes[axes[1]][columns]
                if axes == ("v", "v"):
                    # If two unknowns of a block are one unknown of the program, both triangles
                    # count.
                    twice = np.repeat(row != column, count) & (rows == columns)
                    rows, columns = np.minimum(rows, columns), np.maximum(rows, columns)
                    factor = factor * (1 + twice)
                parts[k].append((values[k], (rows, columns), factor))
        return [
            sum((ca.sum1(value) for value, *_ in own), ca.MX(0))
            if axes == ("", "")
            else _sum_entries(own, (sizes[axes[0]].size, sizes[axes[1]].size))
            for axes, own in zip(RESULTS[name], parts, strict=True)
        ]

    sizes = {"": np.ones(1), "v": scale, "g": np.ones(n_g)}
    of = [w, p, sigma, multipliers]
    gradient, jacobian = together("gradient"), together("jacobian")
    (g,) = together("rows")
    return ProgramFunctions(
        w,
        p,
        gradient[0],
        ca.densify(g),
        ca.Function("gradient", of[:2], [ca.densify(each) for each in gradient]),
        ca.Function("jacobian", of[:2], jacobian),
        ca.Function("hessian", of, together("hessian", sigma, multipliers)),
    )


def _gather(values: ca.MX, where: Index) -> ca.MX:
    return ca.reshape(values[where.T.ravel().tolist()], *where.shape)


def _evaluate_everywhere(f: ca.Function, arguments: Sequence[ca.MX], count: int) -> list[ca.MX]:
    """Return each result of a block's function as a column, the first entry at all points first."""
    rows = tuple(each.shape[0] for each in arguments)
    if count > 1 and (run := in_lanes(f, rows)) is not None:
        return [ca.vec(part) for part in run.call([*arguments])]
    run = f.map("all", "serial", count, [k for k, n in enumerate(rows) if n == 1 < count], [])
    results = run.call([each.T for each in arguments])
    return [  # CasADi returns constant zeros without entries
        ca.vec(ca.reshape(part.nz[:], -1, count).T) if part.nnz() else ca.MX.zeros(f.nnz_out(k))
        for k, part in enumerate(results)
    ]


def _sum_entries(
    parts: Sequence[tuple[ca.MX, tuple[Index, Index], Array]], shape: tuple[int, int]
) -> ca.MX:
    """Return the sparse matrix of values times factors, summed where entries coincide."""
    values, entries, factors = zip(*parts, strict=True)
    rows, columns = (np.concatenate(part) for part in zip(*entries, strict=True))
    weights = np.concatenate(factors)
    key, where = np.unique(columns.astype(np.int64) * shape[0] + rows, return_inverse=True)
    ends = np.searchsorted(key, shape[0] * np.arange(shape[1] + 1))
    pattern = ca.Sparsity(*shape, ends.tolist(), (key % shape[0]).tolist())
    column = ca.vertcat(*values)
    if key.size == where.size:  # no entries coincide: a product takes five times as long
        return ca.MX(pattern, (ca.DM(weights) * column)[where.argsort().tolist()])
    # from lists, six times as fast as from SciPy's matrix or numpy arrays of indices
    summed = ca.Sparsity(key.size, where.size, list(range(where.size + 1)), where.tolist())
    return ca.MX(pattern, ca.DM(summed, weights) @ column)
