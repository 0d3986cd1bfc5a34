"""Equations of a motion, and blocks of algebraic equations, with their Jacobians.

Functions that depend only on the model are built, and compiled, once for all inputs and grounds;
expressions of the inputs are added by the chain rule.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.lookups import (
    Lookup,
    constant_function,
    found_column,
    lookup_results,
    needed_lookups,
)
from slipfree.core.records import Array
from slipfree.system.codegen_cache import compiled_functions, load_or_compile, source

# one forward derivative per column: with as many states as rates, fewer operations than reverse
FORWARD = {"helper_options": {"ad_weight": 0.0}}


def motion_equations(
    dae: Dae, count: int, law: Sequence[ca.SX], u: ca.SX, *, compiled: bool
) -> tuple[ca.Function, ca.Function]:
    """Return the equations of a motion with the first ``count`` unknowns of ``z``, under inputs.

    The first function, ``(t, x, m, u) -> (ode, alg)``, returns the rates of the states and the
    residuals of the algebraic equations, without unit; it is differentiable with respect to ``x``
    and the unknowns ``m``. The second one, ``(t, x, m, p, u) -> (ode_x, alg_x, ode_m, alg_m)``, are
    the derivatives, with the names that CasADi's interface to IDAS requires; ``p`` is empty.
    ``law`` has one expression per input, in the symbols of the model and the numbers ``u``.
    """
    x, z, _ = dae.columns()
    own_inputs, lookups, values, slopes_of = _model_equations(dae, count, compiled=compiled)
    m = z[:count]
    # Laws of other inputs may contain unknowns that do not belong to the motion.
    used = (each if own else ca.SX(0) for each, own in zip(law, own_inputs, strict=True))
    driven = ca.vertcat(ca.SX(0, 1), *used)
    symbols = [dae.t, x, m, u]
    derivatives = ca.jacobian(driven, ca.vertcat(x, m))
    law_values = dae.function("law", symbols, [driven], {"cse": True})
    law_slopes = dae.function("law_slopes", symbols, [derivatives], {"cse": True})
    given = [ca.MX.sym(name, each.numel()) for name, each in zip("txmu", symbols, strict=True)]
    results = lookup_results(lookups, symbols[:3], given[:3])
    point = [*given[:3], law_values(*given), results]
    ode, alg = values(*point)
    ends = [0, x.numel(), x.numel() + count]
    slopes = slopes_of(*point)
    by_state, by_input = ca.horzsplit(slopes, [0, ends[-1], slopes.shape[1]])
    total = by_state + by_input @ law_slopes(*given)
    (ode_x, ode_m), (alg_x, alg_m) = ca.blocksplit(total, ends, ends)
    # the columns for t and u are zero and unused
    own: list[Any] = [*given, *(ca.MX.sym("result", part.numel()) for part in (ode, alg))]
    parts: list[Any] = []
    for part, *row in ((ode, ode_x, ode_m), (alg, alg_x, alg_m)):
        parts += [ca.MX(part.numel(), 1), *row, ca.MX(part.numel(), u.numel())]
    options: dict[str, Any] = {
        "jac_penalty": 0,
        "custom_jacobian": ca.Function("jac_core", own, parts),
        "is_diff_in": [False, True, True, False],
        "never_inline": True,
    }
    names = ["jac_ode_x", "jac_alg_x", "jac_ode_z", "jac_alg_z"]  # CasADi's names
    parameters = [*given[:3], ca.MX.sym("p", 0), given[3]]
    return (
        ca.Function("core", given, [ode, alg], options),
        ca.Function("jacF", parameters, [ode_x, alg_x, ode_m, alg_m], [*"txzpu"], names),
    )


def scaled_jacobian(jacobian: ca.Function, x_size: Array, m_size: Array) -> ca.Function:
    """Return the Jacobian of `motion_equations` for states and unknowns divided by their sizes.

    Entries are multiplied by one number each, since products with diagonal matrices take longer.
    """
    t, x, m, p, u = jacobian.mx_in()
    one = np.ones(m_size.size)  # residuals have no unit
    sizes = [(x_size, x_size), (one, x_size), (x_size, m_size), (one, m_size)]
    parts = [
        part * ca.project(ca.DM(np.outer(1 / row, column)), part.sparsity())
        for part, (row, column) in zip(
            jacobian(t, x * ca.DM(x_size), m * ca.DM(m_size), p, u), sizes, strict=True
        )
    ]
    names = jacobian.name_in(), jacobian.name_out()
    return ca.Function("jacF", [t, x, m, p, u], parts, *names)


@lru_cache(maxsize=8)
def _model_equations(
    dae: Dae, count: int, *, compiled: bool
) -> tuple[tuple[bool, ...], tuple[Lookup, ...], ca.Function, ca.Function]:
    """Return the equations of a model as functions of its inputs ``v``; cached.

    Results are one flag per input, whether the equations depend on it; the lookups that they use,
    with the results ``c``; ``(t, x, m, v, c) -> (ode, alg)``; and the Jacobian of these with
    respect to ``x``, ``m`` and ``v``.
    """
    x, z, v = dae.columns()
    alg = ca.vertcat(ca.SX(0, 1), *dae.residuals)[:count]
    (rows,) = dae.without_continuation([ca.densify(ca.vertcat(dae.ode, alg))])
    rows = ca.cse(rows)
    lookups = needed_lookups(dae.lookups, [rows])
    given = [dae.t, x, z[:count], v, found_column(lookups)]
    parts = ca.vertsplit(rows, [0, x.numel(), rows.numel()])
    values = ca.Function("values", given, parts)

    held, key = dae.held, values
    if held is not None:
        differentiated = ca.cse(ca.densify(ca.vertcat(held.ode, alg)))
        key = ca.Function("key", [*given, held.symbols], [*parts, differentiated, held.values])

    def make() -> list[ca.Function]:
        point = ca.vertcat(*given[1:4])
        if held is None:
            slopes = ca.jacobian(rows, point, FORWARD)
        else:
            slopes = ca.jacobian(differentiated, point, FORWARD)
            slopes = ca.substitute(slopes, held.symbols, held.values)
        return [values, ca.Function("slopes", given, [slopes])]

    functions = compiled_functions(key, ("values", "slopes"), make, compiled=compiled)
    lookups = compiled_lookups(lookups) if compiled else lookups
    inputs = ca.vertsplit(v) if v.numel() else []
    own = tuple(ca.depends_on(rows, each) for each in inputs)
    return own, lookups, functions[0], functions[1]


def model_function(
    dae: Dae,
    name: str,
    symbols: Sequence[ca.SX],
    expressions: Sequence[ca.SX],
    *,
    compiled: bool,
) -> ca.Function:
    """Return expressions of a model as a function without derivatives, which may be compiled."""
    lookups = needed_lookups(dae.lookups, expressions)
    plain = ca.Function(name, [*symbols, found_column(lookups)], [*expressions], {"cse": True})
    (plain,) = compiled_functions(plain, (name,), lambda: [plain], compiled=compiled)
    lookups = compiled_lookups(lookups) if compiled else lookups
    given = [ca.MX.sym("given", *each.shape) for each in symbols]
    return ca.Function(name, given, plain.call([*given, lookup_results(lookups, symbols, given)]))


def compiled_lookups(lookups: Sequence[Lookup]) -> tuple[Lookup, ...]:
    """Return lookups with compiled functions, where these are not compiled already."""
    return tuple(each._replace(function=_compiled_lookup(each.function)) for each in lookups)


@lru_cache(maxsize=32)
def _compiled_lookup(function: ca.Function) -> ca.Function:
    parts = [function, *function.find_functions()]
    if any(part.class_name() == "External" for part in parts):
        return function
    functions = load_or_compile(source([function]), (function.name(),), lambda: [function])
    return constant_function(functions[0]) if functions else function


def block_functions(
    dae: Dae,
    span: tuple[int, int],
    law: Sequence[ca.SX],
    u: ca.SX,
    continuation: ca.SX,
    *,
    compiled: bool,
) -> tuple[ca.Function, ca.Function]:
    """Return the residual without unit of a block under inputs, and a function with its Jacobian.

    Both take ``(t, x, z, u, continuation)``; the second one also returns the Jacobian by the
    unknowns of the block, ``z[span[0]:span[1]]``. ``law`` has one expression per input, in the
    symbols of the model and the numbers ``u``.
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
    results = lookup_results(lookups, symbols[:3], given[:3])
    point = [*given[:3], inputs, given[4], results]
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
