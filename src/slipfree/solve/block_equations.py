"""Blocks of algebraic equations and their Jacobians as functions, for Newton's method.

Functions that depend only on the model are built, and compiled, once for all inputs and grounds.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import casadi as ca

from slipfree.core.dae import Dae
from slipfree.core.lookups import Lookup, found_column, lookup_results, needed_lookups
from slipfree.solve.equations import FORWARD, compiled_lookups
from slipfree.system.codegen_cache import compiled_functions


def block_functions(
    dae: Dae,
    span: tuple[int, int],
    law: Sequence[ca.SX],
    u: ca.SX,
    continuation: ca.SX,
    *,
    compiled: bool,
) -> tuple[ca.Function, ca.Function]:
    """Return the residual of a block under given inputs, and a function with its Jacobian.

    Parameters
    ----------
    dae : Dae
        The model.
    span : tuple of 2 int
        Indices of the first unknown of the block in ``z`` and of the first after it.
    law : sequence of SX
        One expression per input, in the symbols of the model and ``u``.
    u : SX
        Symbols of the numbers in ``law``.
    continuation : SX
        Symbol of the continuation parameter.
    compiled : bool
        Whether to compile the equations of the model.

    Returns
    -------
    residual : casadi Function
        ``(t, x, z, u, continuation) ->`` the residual without unit.
    newton : casadi Function
        The same arguments to the residual and its Jacobian by the unknowns of the block.
    """
    x, z, _ = dae.columns()
    own, driven = z[slice(*span)], ca.vertcat(ca.SX(0, 1), *law)
    by_law = ca.jacobian(driven, own)
    follows = bool(by_law.nnz())  # laws of unknowns of the block add to its Jacobian
    lookups, *functions = _model_block(dae, span, continuation, follows, compiled)
    symbols = [dae.t, x, z, u, continuation]
    laws = dae.function("law", symbols, [driven, by_law], {"cse": True})
    given = [ca.MX.sym(name, each.numel()) for name, each in zip("txzuc", symbols, strict=True)]
    inputs, slopes = laws.call(given)
    found = lookup_results(lookups, symbols[:3], given[:3])
    point = [*given[:3], inputs, given[4], found]
    residual, (rows, jacobian) = functions[0].call(point)[0], functions[1].call(point)
    if follows:
        by_own, by_inputs = ca.horzsplit(jacobian, [0, own.numel(), jacobian.shape[1]])
        jacobian = by_own + by_inputs @ slopes
    return (
        ca.Function("residual", given, [residual]),
        ca.Function("newton", given, [rows, jacobian]),
    )


@lru_cache(maxsize=32)
def _model_block(
    dae: Dae, span: tuple[int, int], continuation: ca.SX, follows: bool, compiled: bool
) -> tuple[tuple[Lookup, ...], ca.Function, ca.Function]:
    """Return the lookups of a block, its residual and its Jacobian for given inputs.

    Both are functions of ``(t, x, z, v, continuation, c)``, where ``v`` are the inputs and ``c``
    the results of the lookups. The Jacobian is that by the unknowns and, if ``follows``, by the
    inputs.
    """
    x, z, v = dae.columns()
    # Before differentiation: of the Jacobian, it takes five times as long for 3 % fewer operations.
    rows = ca.cse(ca.densify(ca.vertcat(ca.SX(0, 1), *dae.residuals)[slice(*span)]))
    lookups = needed_lookups(dae.lookups, [rows])
    given = [dae.t, x, z, v, continuation, found_column(lookups)]
    by = ca.vertcat(z[slice(*span)], v) if follows else z[slice(*span)]
    residual = ca.Function("residual_v" if follows else "residual", given, [rows])

    def make() -> list[ca.Function]:
        slopes = ca.jacobian(rows, by, FORWARD)
        return [residual, ca.Function("newton", given, [rows, slopes])]

    names = (residual.name(), "newton")
    values, newton = compiled_functions(residual, names, make, compiled=compiled)
    return compiled_lookups(lookups) if compiled else lookups, values, newton
