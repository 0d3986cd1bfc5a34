"""Evaluate a DAE under given inputs: residuals, Jacobians, outputs and limits as functions.

`solve_initial_conditions` solves the algebraic equations at one instant by Newton's method.
Functions that depend only on the model are built, and compiled, once for all inputs and grounds;
expressions of the inputs are added by the chain rule. `SolverOptions` are the options of all
functions that solve a model.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache, lru_cache, partial
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple

import casadi as ca
import numpy as np
from annotated_types import Ge, Le, Unit

from slipfree.core.arguments import check_finite, checked
from slipfree.core.dae import Dae, PiecewiseLinear
from slipfree.core.errors import ModelError
from slipfree.core.facts import Fact
from slipfree.core.lookups import (
    Lookup,
    constant_function,
    dense,
    evaluate,
    found_column,
    lookup_results,
    needed_lookups,
)
from slipfree.core.newton import ROUNDING, solve_equations, solve_linear
from slipfree.core.records import Array, Label, Record, leaves, pack, unpack
from slipfree.core.schema import Flag
from slipfree.system.codegen_cache import compiled_functions, load_or_compile, source

MIN_TOLERANCE = 1e-14  # rounding dominates below it
PERIOD_TOLERANCE = 1e-6  # largest relative difference between sampling periods that count as equal
MAX_TOLERANCE = 1e-2  # errors do not grow with the tolerance beyond it: steps are uncontrolled
Method = Literal["idas", "cvodes", "explicit"]


@checked
@dataclass(frozen=True)
class SolverOptions:
    """Options of starts, simulations and plans.

    Every function that solves a model accepts all options and uses those that apply; a start uses
    only `compiled`.

    Attributes
    ----------
    tolerance : float
        Relative and absolute tolerance of the integrator; that of a length is multiplied by the
        size of the vehicle, ``dae.size``. [size, rad]
    method : {"idas", "cvodes", "explicit"} or None
        Name of the integrator. By default CVODES for motions without algebraic unknowns, and IDAS
        for motions with them, which CVODES cannot solve. The error test of CVODES includes the
        quadratures. ``"explicit"`` are the fixed steps of the batch (`slipfree.rollouts`), refined
        until the estimated error of ``x`` and ``y`` at the end is below the tolerance; for
        kinematics and quasi-statics with inputs that are numbers. It is fast if compiled, for
        tolerances from about 1e-6.
    compiled : bool
        Whether to compile the equations with the system's C compiler; the libraries are cached.
        Without a compiler the equations are interpreted, and a warning gives the reason.

    Raises
    ------
    ModelError
        If the tolerance is not between 1e-14 and 0.01, or the method is unknown.
    """

    tolerance: Annotated[float, Ge(MIN_TOLERANCE), Le(MAX_TOLERANCE), Unit("1")] = 1e-8
    method: Method | None = None
    compiled: Flag = False


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
    law_values = dae.function("law", symbols, [driven])
    law_slopes = dae.function("law_slopes", symbols, [derivatives])
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

    ``x_size`` and ``m_size`` are the sizes of states and unknowns. Entries are multiplied by one
    number each, since products with diagonal matrices take longer.
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
    dae: Dae, name: str, symbols: Sequence[ca.SX], expressions: Sequence[ca.SX], *, compiled: bool
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
    laws = dae.function("law", symbols, [driven, by_law])
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


MAX_NEWTON_STEPS = 25  # limit for blocks that depend on the motion


class Block(NamedTuple):
    """One block of algebraic equations, which Newton's method solves at once."""

    span: slice  # indices of its unknowns in ``z``
    residual: ca.Function  # function of ``(t, x, z, u, continuation)``: the residual without unit
    # function of the same arguments: the residual, and its Jacobian with respect to the unknowns of
    # the block
    newton: ca.Function
    linear: bool  # whether the block is linear in its unknowns
    # values of the continuation parameter at a start, in the order of solution; a single value if
    # the block does not depend on it
    stages: tuple[float, ...]
    labels: tuple[Label, ...]  # names of its equations


class System(NamedTuple):
    """A DAE whose inputs are numbers or have been replaced by expressions.

    The unknowns of the motion, ``m``, are the first entries of ``z``; dependent blocks determine
    the other entries after the motion.
    """

    dae: Dae
    # values of the inputs in every interval; values of an input given by an expression are unused.
    # If inputs are linear in time, the rows of their slopes follow, shape (n_u, n) or (2 n_u, n)
    u: Array
    # blocks and dependent_blocks: the algebraic equations of the motion, and those that are solved
    # after it
    blocks: tuple[Block, ...]
    dependent_blocks: tuple[Block, ...]
    # The following functions are built when they are asked for, since a start needs few of them.
    # Equations of the motion and their derivatives; see `motion_equations`
    make_motion: Callable[[], tuple[ca.Function, ca.Function]]
    # ``solves ->`` function ``(t, x, m, u) -> (rates of the quadratures, least distance to a limit
    # of the motion, pace)``; the distance is negative beyond a limit, with lengths in sizes of the
    # vehicle. Unless it solves the dependent blocks, rates that depend on them are zero
    make_watch: Callable[[bool], ca.Function]
    make_outputs: Callable[[], ca.Function]

    @property
    def core(self) -> ca.Function:
        """Function ``(t, x, m, u) -> (ode, alg)``; ``alg`` is without unit."""
        return self.make_motion()[0]

    @property
    def jacobian(self) -> ca.Function:
        """Derivatives of ``core`` for IDAS; see `motion_equations`."""
        return self.make_motion()[1]

    @property
    def watch(self) -> ca.Function:
        """Rates, distance and pace as in ``make_watch``, with all rates."""
        return self.make_watch(True)

    @property
    def outputs(self) -> ca.Function:
        """Function ``(t, x, z, u) ->`` values of the outputs, limits and inputs."""
        return self.make_outputs()

    @property
    def motion_size(self) -> int:
        """Number of algebraic unknowns in the blocks of the motion."""
        return self.blocks[-1].span.stop if self.blocks else 0


def with_inputs(
    dae: Dae, inputs: Record, intervals: int, options: SolverOptions = SolverOptions()
) -> System:
    """Return a DAE under given inputs.

    Inputs are numbers, arrays with a value for each of the ``intervals`` between samples,
    `PiecewiseLinear` values, or expressions in the symbols of the model.

    ModelError is raised if an array has another length, a number is complex or not finite, an
    expression is not a scalar or contains other symbols than time, states and unknowns, or a block
    of equations contains unknowns of later blocks.
    """
    if dae.p:
        raise ModelError(
            "expected a model without parameters, found "
            f"{', '.join(each.label.name for each in dae.p)}; use the model without shifts of the "
            "ground"
        )
    u = dae.columns()[2]
    law, values = list(ca.vertsplit(u)) if u.numel() else [], np.zeros((u.numel(), intervals or 1))
    slopes, slope = np.zeros_like(values), ca.SX.sym("slope", u.numel())
    for index, (label, value) in enumerate(zip(leaves(dae.labels.u), leaves(inputs), strict=True)):
        if isinstance(value, ca.SX):
            law[index] = check_law(dae, label, value)
        elif isinstance(value, PiecewiseLinear):
            law[index] += slope[index] * dae.t
            values[index] = _check_numbers(label, value.base, intervals)
            slopes[index] = _check_numbers(label, value.slope, intervals)
        else:
            values[index] = _check_numbers(label, value, intervals)
    linear = any(isinstance(value, PiecewiseLinear) for value in leaves(inputs))
    numbers = np.concatenate([values, slopes]) if linear else values
    if any(isinstance(value, ca.SX) for value in leaves(inputs)):
        system = _build(dae, law, ca.vertcat(u, slope) if linear else u, compiled=options.compiled)
    else:
        system = _with_numbers(dae, linear=linear, compiled=options.compiled)
    return system._replace(u=numbers)


def with_held_inputs(
    dae: Dae, inputs: Record, t: Array, options: SolverOptions
) -> tuple[System, ca.Function]:
    """Return a DAE for inputs that are constant between evenly spaced samples, and their law.

    The law is a function ``(t, x, u)`` of the inputs that are numbers, with the values of all
    inputs; those given by expressions are zero in the system. ModelError is raised as by
    `with_inputs`, and for algebraic unknowns and inputs that are linear in time.
    """
    steps, (state, _, driven) = np.diff(t), dae.columns()
    if np.abs(steps - steps[0]).max() > PERIOD_TOLERANCE * steps[0]:
        raise ModelError(
            "t: expected evenly spaced times for a sampled controller, found steps from "
            f"{steps.min():.9g} to {steps.max():.9g} s; use a constant step"
        )
    if dae.guess.numel():
        raise ModelError(
            "model: expected a model without algebraic unknowns for a sampled controller, found "
            f"{dae.guess.numel()} of them; give one value of the inputs for each interval"
        )
    if options.method in ("idas", "explicit"):
        raise ModelError(
            "method: expected 'cvodes' for a sampled controller, found "
            f"{options.method!r}; omit the method"
        )
    given = list(leaves(inputs))
    if any(isinstance(value, PiecewiseLinear) for value in given):
        raise ModelError(
            "inputs: expected constants or expressions for a sampled controller, found inputs that "
            "are linear in time; give them as expressions of model.t"
        )
    numbers = [0.0 if isinstance(value, ca.SX) else value for value in given]
    pairs = [*zip(given, ca.vertsplit(driven), strict=True)]
    numeric = [symbol for value, symbol in pairs if not isinstance(value, ca.SX)]
    for label, value in zip(leaves(dae.labels.u), given, strict=True):
        if isinstance(value, ca.SX):
            check_law(dae, label, ca.substitute([value], numeric, [ca.SX(0)] * len(numeric))[0])
    laws = [value if isinstance(value, ca.SX) else symbol for value, symbol in pairs]
    law = dae.function("law", [dae.t, state, driven], [ca.vertcat(*laws)])
    return with_inputs(dae, unpack(dae.u, numbers), t.size - 1, options), law


@lru_cache(maxsize=8)
def _with_numbers(dae: Dae, *, linear: bool, compiled: bool) -> System:
    """Return a model with numeric inputs; cached, since it is valid for all starts and numbers.

    If ``linear``, the numbers are the values of the inputs at time zero and their slopes.
    """
    u = dae.columns()[2]
    if not linear:
        return _build(dae, list(leaves(dae.u)), u, compiled=compiled)
    slopes = ca.SX.sym("slope", u.numel())
    law = ca.vertsplit(u + slopes * dae.t)
    return _build(dae, law, ca.vertcat(u, slopes), compiled=compiled)


def _build(dae: Dae, law: list[ca.SX], u: ca.SX, *, compiled: bool) -> System:
    """Return the system of a model with the law of its inputs inserted."""
    _, z, inputs = dae.columns()
    limits = ca.vertcat(ca.SX(0, 1), *(limit.expression for limit in dae.limits))
    continuation = (
        ca.SX.sym("continuation") if dae.continuation is None else dae.continuation.symbol
    )
    continued = [dae.quad, limits, dae.pace, pack(dae.y), dae.ode, *dae.residuals]
    continued = dae.without_continuation(continued)
    watched, shown = continued[:3], [ca.densify(continued[k]) for k in (3, 1)]
    ode, *parts = ca.substitute(continued[4:], [inputs], [ca.vertcat(ca.SX(0, 1), *law)])
    blocks = _equation_blocks(dae, law, u, continuation, compiled=compiled)
    # Blocks after the last one on which the states or earlier equations depend are solved after the
    # motion; a model whose states depend on no unknown is still solved for its first block.
    first = len(blocks)
    while first > 1:
        others = ca.vertcat(ode, *parts[: first - 1])
        if ca.depends_on(others, z[blocks[first - 1].span]):
            break
        first -= 1
    motion, dependent = blocks[:first], blocks[first:]
    m = z[: motion[-1].span.stop] if motion else z[:0]

    @cache
    def watch(solves: bool) -> ca.Function:
        """Return rates of quadratures and the least margin as a function.

        With ``solves``, it solves the dependent unknowns first, if the rates depend on them.
        """
        x, count = dae.columns()[0], m.numel() if dependent else z.numel()
        follows = [ca.depends_on(each, z[count:]) for each in law]
        late = (v for v, each in zip(leaves(dae.u), follows, strict=True) if each)
        following = ca.vertcat(z[count:], *late)
        quad, margin = watched[0], ca.SX(np.inf)
        pairs = zip(dae.limits, ca.vertsplit(watched[1]) if dae.limits else [], strict=True)
        for limit, value in pairs:
            size = dae.size_of(limit.label)
            if ca.depends_on(value, following):
                continue
            if np.isfinite(limit.lower):
                margin = ca.fmin(margin, (value - limit.lower) / size)
            if np.isfinite(limit.upper):
                margin = ca.fmin(margin, (limit.upper - value) / size)
        if not solves:
            if not ca.depends_on(quad, following):
                return watch(True)
            rates = (0 * q if ca.depends_on(q, following) else q for q in ca.vertsplit(quad))
            quad = ca.vertcat(ca.SX(0, 1), *rates)
        solves = bool(dependent) and ca.depends_on(quad, following)
        unknowns, used = (z, law) if solves else (z[:count], [])
        if not solves:  # neither quadratures nor margin depend on these inputs
            used = [ca.SX(0) if late else each for each, late in zip(law, follows, strict=True)]
        given = [
            ca.MX.sym(name, size)
            for name, size in zip("txmu", (1, x.numel(), count, u.numel()), strict=True)
        ]
        t_0, x_0, found, u_0 = given
        if solves:
            guess = dae.function("guess", [x], [dae.guess[count:]])
            found = ca.vertcat(found, guess(x_0))
            for block in dependent:
                found = _solve_symbolically(block, [t_0, x_0, found, u_0])
        laws = dae.function("law", [dae.t, x, unknowns, u], [ca.vertcat(ca.SX(0, 1), *used)])
        of = [dae.t, x, unknowns, inputs]
        values = model_function(dae, "watch", of, [quad, margin, watched[2]], compiled=compiled)
        at = t_0, x_0, found
        return ca.Function("watch", given, list(values(*at, laws(*at, u_0))))

    @cache
    def outputs() -> ca.Function:
        # not compiled: outputs contain the origin of the map, so a library would serve one map
        at = [dae.t, *dae.columns()[:2], inputs]
        values = model_function(dae, "outputs", at, shown, compiled=False)
        laws = dae.function("law", [*at[:3], u], [ca.densify(ca.vertcat(ca.SX(0, 1), *law))])
        given = laws.mx_in()
        driven = laws(*given)
        return ca.Function("outputs", given, [*values(*given[:3], driven), ca.densify(driven)])

    motion_functions = partial(motion_equations, dae, m.numel(), law, u, compiled=compiled)
    numbers = np.zeros((u.numel(), 0))
    return System(dae, numbers, motion, dependent, cache(motion_functions), watch, outputs)


def _solve_symbolically(block: Block, point: list[ca.MX]) -> ca.MX:
    """Return ``z`` with the symbolic solution of a block; ``point`` contains the guess."""
    t, x, z, u = point
    before, guess, rest = ca.vertsplit(z, [0, block.span.start, block.span.stop, z.numel()])
    if block.linear:
        at = (t, x, z, u, block.stages[-1])
        residual, jacobian = block.newton(*at)
        found = guess - ca.solve(ca.densify(jacobian), residual)
        return ca.vertcat(before, found, rest)
    unknown, given = ca.MX.sym("unknown", guess.numel()), ca.vertcat(t, x, before, u)
    symbol = ca.MX.sym("given", given.numel())
    ends = np.cumsum([0, 1, x.numel(), before.numel(), u.numel()]).tolist()
    t_0, x_0, z_0, u_0 = ca.vertsplit(symbol, ends)
    other = ca.vertcat(z_0, unknown, ca.MX.zeros(rest.numel()))
    at = (t_0, x_0, other, u_0, block.stages[-1])
    residual, jacobian = block.newton(*at)
    # CasADi's own Jacobian would also contain the derivatives with respect to `symbol`.
    slopes = ca.Function("slopes", [unknown, symbol], [ca.densify(jacobian), residual])
    problem: dict[str, Any] = {"x": unknown, "p": symbol, "g": block.residual(*at)}
    options: dict[str, Any] = {
        "error_on_fail": False,
        "max_iter": MAX_NEWTON_STEPS,
        "show_eval_warnings": False,
        "jacobian_function": slopes,
    }
    solver = ca.rootfinder("following", "newton", problem, options)
    return ca.vertcat(before, solver(x0=guess, p=given)["x"], rest)


def check_law(dae: Dae, label: Label, law: ca.SX) -> ca.SX:
    """Return an input's expression of time, states and unknowns; ModelError for another one."""
    x, z, u = dae.columns()
    if law.shape != (1, 1):
        raise ModelError(
            f"input {label.full}: expected a scalar expression, found shape {law.shape}; give one "
            "expression for each input"
        )
    if ca.depends_on(law, u):
        raise ModelError(
            f"input {label.full}: expected an expression of time, states and unknowns, found one "
            "that contains inputs; remove or substitute them"
        )
    check_symbols(f"input {label.full}", dae, law, (dae.t, x, z))
    return law


def check_symbols(name: str, dae: Dae, expression: ca.SX, symbols: Sequence[ca.SX]) -> None:
    """Raise ModelError for an expression with other symbols; ``name`` is its name."""
    known = [*symbols, found_column(dae.lookups)]
    if free := ca.Function("known", known, [expression], {"allow_free": True}).free_sx():
        raise ModelError(
            f"{name}: expected an expression of the symbols of this model, found the symbol "
            f"{free[0].name()!r} of another model or of SX.sym; use those of the Dae, as dae.t"
        )


def _check_numbers(label: Label, value: Any, intervals: int) -> Array:
    """Return an input as a number or as one number per interval; raise ModelError else."""
    if isinstance(value, ca.MX | str) or np.iscomplexobj(value):
        raise ModelError(
            f"input {label.full}: expected real numbers or an SX expression, found {value!r}; give "
            "floats, an array, or an expression of the symbols of the model"
        )
    numbers = np.asarray(value, dtype=float)
    if numbers.ndim > 1 or (numbers.ndim == 1 and numbers.size != intervals):
        raise ModelError(
            f"input {label.full}: expected a number, an expression or one value for each of the "
            f"{intervals} intervals between samples, found shape {numbers.shape}; correct the shape"
        )
    check_finite(f"input {label.full}", numbers)
    return numbers


def _equation_blocks(
    dae: Dae, law: list[ca.SX], u: ca.SX, continuation: ca.SX, *, compiled: bool
) -> tuple[Block, ...]:
    """Return the blocks of equations in their order; ModelError if one needs a later block.

    ``law`` are the inputs as expressions, ``u`` their numbers, and ``continuation`` the symbol that
    varies from an easy problem to the given one.
    """
    z, driven = dae.columns()[1], ca.vertcat(ca.SX(0, 1), *law)
    blocks = list[Block]()
    for residual, part, labels in zip(dae.residuals, dae.block_rows, dae.labels.alg, strict=True):
        if not labels:
            continue
        (inserted,) = ca.substitute([residual], [dae.columns()[2]], [driven])
        if ca.depends_on(inserted, z[part.stop :]):
            raise ModelError(
                "alg: expected blocks of equations without unknowns of later blocks, found a block "
                f"with such unknowns, which begins with {labels[0].full}; "
                "change the order of the blocks"
            )
        is_continued = dae.continuation is not None and ca.depends_on(inserted, continuation)
        span = part.start, part.stop
        blocks.append(
            Block(
                part,
                *block_functions(dae, span, law, u, continuation, compiled=compiled),
                ca.is_linear(inserted, z[part]),
                dae.continuation.values if dae.continuation and is_continued else (0.0,),
                labels,
            )
        )
    return tuple(blocks)


MAX_STEP = 0.25  # largest Newton step of an unknown [typical size]
MAX_STEPS = 1000  # a start at a speed of many sizes a second takes hundreds
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
    """Return ``z`` with the unknowns of one block solved; ``point`` is t, x, z, u, continuation."""
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
