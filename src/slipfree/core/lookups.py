"""Lookups: coefficients of a ground that are symbols of a model.

Inside a cell a bicubic ground is a polynomial. Its coefficients are symbols of the model. A lookup
function returns the coefficients for a position; it is constant within each cell, and CasADi takes
its derivatives as zero. The model is therefore an SX graph without function calls, whose
derivatives of any order CasADi computes. A ground that is not piecewise polynomial is replaced by
its Taylor polynomial about the current position.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Iterator, Mapping, Sequence
from functools import cache, lru_cache
from importlib.machinery import EXTENSION_SUFFIXES
from math import inf
from pathlib import Path
from secrets import randbits
from typing import Any, NamedTuple, cast

import casadi as ca
import numpy as np

from slipfree.core.errors import ModelError
from slipfree.core.records import Array

WIDTH = 256  # points at once; their numbers stay in the cache of the processor
OPERATIONS = (  # in the order of `kernel.c`
    *("INPUT", "OUTPUT", "CONST", "ASSIGN", "ADD", "SUB", "MUL", "DIV", "NEG", "SQ", "TWICE"),
    *("INV", "SQRT", "SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN", "ATAN2", "EXP", "LOG", "POW"),
    *("CONSTPOW", "FABS", "SIGN", "FMIN", "FMAX", "LT", "LE", "EQ", "NE", "NOT", "AND", "OR"),
    *("IF_ELSE_ZERO", "FLOOR", "TANH", "HYPOT", "EXPM1", "LOG1P", "SINH", "COSH", "CEIL"),
    *("FMOD", "COPYSIGN", "ERF"),
)
CODES = {getattr(ca, f"OP_{name}"): code for code, name in enumerate(OPERATIONS)}
MIN_INSTRUCTIONS = 300  # of a function in lanes; smaller ones leave their slots to others
KERNEL = Path(__file__).parents[1] / "terrain" / "_kernel"  # without the suffix
KEY_BITS = 52  # bits of integers that a double represents exactly
LAYOUT = 6  # version of the arguments of `kernel.c`; libraries of other versions are not used


class Cells(NamedTuple):
    """Cells of a bicubic spline, from which compiled code looks up polynomials."""

    # coefficients of the uniform cubic B-splines, divided by 36, shape (n_x + 2, n_y + 2) [m]
    coefficients: Array
    # place and spacing: local coordinates of the node nearest to the local origin, and distances
    # between nodes [m]
    place: tuple[float, float]
    spacing: tuple[float, float]
    # node and last: indices of that node and of the last cell, along x and y
    node: tuple[int, int]
    last: tuple[int, int]

    @property
    def numbers(self) -> tuple[float, ...]:
        """Places, distances and indices, as `kernel.c` and ``lanes.c`` take them."""
        pairs = self.place, self.spacing, self.node, self.last
        return tuple(number for pair in pairs for number in pair)


class CellBounds(NamedTuple):
    """Bounds of slope and curvature around cells of a ground, from which compiled code reads."""

    # places along x and y of square blocks of cells, and addresses of their bounds; shape (n, 3)
    table: Array
    # cells along the side of a block; distance up to which bounds hold; local coordinates of the
    # corner of block (0, 0); sides of the cells; least and greatest x and y where bounds hold [m]
    numbers: tuple[float, ...]
    blocks: list[Array]  # bounds in each block, shape (2, side, side) [1, 1/m]


class Lookup(NamedTuple):
    """A lookup function, its argument in a model, and the symbols of its result."""

    # argument of the function, in the symbols of the model and of earlier lookups, shape (n, 1)
    argument: ca.SX
    found: ca.SX  # symbols of the result; derivatives treat them as constants, shape (m, 1)
    # function from the argument to the result; CasADi takes its derivatives as zero
    function: ca.Function
    # highest order up to which derivatives of expressions of the result, with respect to the
    # argument, are exact; infinite for a bicubic ground
    order: float
    # cells in which the function looks up the polynomial at the first two rows of its argument
    cells: Cells | None = None


class LookupTable:
    """Table of the lookups of a model during its construction; equal arguments share a lookup."""

    def __init__(self) -> None:
        self._known: dict[tuple[float, ...], tuple[Lookup, ca.Function]] = {}

    @property
    def lookups(self) -> tuple[Lookup, ...]:
        """Lookups in the order of their creation, which is a valid order of evaluation."""
        return tuple(lookup for lookup, _ in self._known.values())

    def find(
        self,
        function: ca.Function,
        argument: ca.SX,
        *,
        order: float = inf,
        cells: Cells | None = None,
    ) -> ca.SX:
        """Return symbols that represent the result of a function of an argument.

        Calls with equal functions, arguments and orders share a lookup and its symbols (m, 1). The
        function maps one dense column to one dense column; the other arguments are as in `Lookup`.
        """
        argument = ca.densify(argument)
        entries = (entry.element_hash() for entry in ca.vertsplit(argument))
        key = (hash(function), order, *entries)
        if key not in self._known:
            found = ca.SX.sym(f"found{len(self._known)}", function.numel_out(0))
            lookup = Lookup(argument, found, constant_function(function), order, cells)
            # the function is kept alive: another one could get its hash
            self._known[key] = lookup, function
        return self._known[key][0].found


def constant_function(function: ca.Function) -> ca.Function:
    """Return the same function with derivatives that CasADi takes as zero."""
    at = ca.MX.sym("at", function.sparsity_in(0))
    options: dict[str, Any] = {"is_diff_in": [False], "is_diff_out": [False], "never_inline": True}
    return ca.Function("lookup", [at], function.call([at]), options)


def found_column(lookups: Sequence[Lookup]) -> ca.SX:
    """Return the symbols of the results of lookups as one column, shape (m, 1)."""
    return ca.vertcat(ca.SX(0, 1), *(each.found for each in lookups))


def needed_lookups(lookups: Sequence[Lookup], expressions: Sequence[ca.SX]) -> tuple[Lookup, ...]:
    """Return the lookups on which expressions depend, directly or through other lookups."""
    used = _symbols(ca.veccat(ca.SX(0, 1), *expressions))
    needed = list[Lookup]()
    for lookup in reversed(lookups):
        if not used.isdisjoint(_symbols(lookup.found)):
            needed.append(lookup)
            used |= _symbols(lookup.argument)
    return tuple(reversed(needed))


def _symbols(expression: ca.SX) -> set[int]:
    return {symbol.element_hash() for symbol in ca.symvar(expression)}


def check_order(lookups: Sequence[Lookup], order: int, purpose: str) -> None:
    """Raise ModelError if lookups are not differentiable up to an order."""
    least = min((each.order for each in lookups), default=inf)
    if least < order:
        raise ModelError(
            f"{purpose} needs derivatives of the ground up to order {order}, found a ground with "
            f"derivatives up to order {least:g}; use a ground given by a formula or a map"
        )


def substitute_lookups(
    lookups: Sequence[Lookup], symbols: Sequence[ca.SX], values: Sequence[ca.SX]
) -> tuple[tuple[Lookup, ...], list[ca.SX], list[ca.SX]]:
    """Return lookups with symbols replaced by values in their arguments.

    The new lookups have new symbols for their results. The last results are the complete
    substitution for other expressions: it also replaces the results of the given lookups.
    """
    before, after, new = [*symbols], [*values], list[Lookup]()
    for lookup in lookups:
        (argument,) = ca.substitute([lookup.argument], before, after)
        found = ca.SX.sym("found", lookup.found.numel())
        new.append(lookup._replace(argument=argument, found=found))
        before.append(lookup.found)
        after.append(found)
    return tuple(new), before, after


def lookup_results(
    lookups: Sequence[Lookup], symbols: Sequence[ca.SX], given: Sequence[ca.MX]
) -> ca.MX:
    """Return the results of lookups for given values of a model's symbols, shape (m, 1)."""
    found = ca.MX(0, 1)
    for group in _stages(lookups):
        before = found_column(lookups[: group.start])
        inputs = [*symbols, before]
        arguments = ca.Function("arguments", inputs, [lookups[k].argument for k in group])
        values = arguments.call([*given, found])
        results = (lookups[k].function(at) for k, at in zip(group, values, strict=True))
        found = ca.vertcat(found, *results)
    return found


def _stages(lookups: Sequence[Lookup]) -> Iterator[range]:
    """Yield consecutive index ranges of lookups that can be evaluated together.

    Arguments of lookups do not depend on results of lookups in the same range.
    """
    start, found = 0, set[int]()
    for k, lookup in enumerate(lookups):
        if not found.isdisjoint(_symbols(lookup.argument)):
            yield range(start, k)
            start, found = k, set()
        found |= _symbols(lookup.found)
    if lookups:
        yield range(start, len(lookups))


def lookup_function(
    lookups: Sequence[Lookup],
    name: str,
    symbols: Sequence[ca.SX],
    expressions: Sequence[ca.SX],
    options: dict[str, Any] | None = None,
) -> ca.Function:
    """Return expressions as a function of ``symbols`` that evaluates the required lookups.

    Only lookups on which the expressions depend are evaluated. ``options`` are those of
    `casadi.Function`.
    """
    needed = needed_lookups(lookups, expressions)
    if not needed:
        return ca.Function(name, [*symbols], [*expressions], options or {})
    plain = ca.Function(
        name,
        [*symbols, found_column(needed)],
        [*expressions],
        {"is_diff_in": [*(True for _ in symbols), False], **(options or {})},
    )
    given = [ca.MX.sym("given", *each.shape) for each in symbols]
    return ca.Function(name, given, plain.call([*given, lookup_results(needed, symbols, given)]))


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


@lru_cache(maxsize=32)
def instructions_of(
    function: ca.Function,
) -> tuple[list[int], list[list[int]], list[list[int]], list[float]]:
    """Return operations, indices of arguments and results, and constants of a function; cached."""
    each = range(function.n_instructions())
    operations = list(map(function.instruction_id, each))
    constants = [
        function.instruction_constant(k) if operations[k] == ca.OP_CONST else 0.0 for k in each
    ]
    sources = list(map(function.instruction_input, each))
    return operations, sources, list(map(function.instruction_output, each)), constants


def evaluate_lanes(function: ca.Function, *columns: Array) -> Array:
    """Return the result of an SX function at many points, shape (nnz, n), as `evaluate` does.

    `WIDTH` points are evaluated at once, in a tenth of the time (`in_lanes`).
    """
    together, count = in_lanes(function, (WIDTH,) * len(columns)), columns[0].shape[1]
    if together is None:
        return evaluate(function, *columns)[0]
    found = np.empty((function.nnz_out(0), count))
    for begin in range(0, count, WIDTH):
        lanes = np.minimum(np.arange(begin, begin + WIDTH), count - 1)  # the last one repeated
        part = np.empty((function.nnz_out(0), WIDTH))
        given = {k: each[:, lanes].T for k, each in enumerate(columns)}
        run_buffered(together, given, {0: part})
        found[:, begin : begin + WIDTH] = part[:, : count - begin]
    return found


@lru_cache(maxsize=16)
def in_lanes(function: ca.Function, rows: tuple[int, ...]) -> ca.Function | None:
    """Return an SX function of columns of points, evaluated by `terrain/kernel.c`; None without.

    Argument k is a matrix with ``rows[k]`` rows, one for each point or one for all, and a column
    for each entry; a result has a row for each point, and a column for each structural nonzero.
    """
    compiled: Any = library()
    if not hasattr(compiled, "kernel_open_lanes") or not function.is_a("SXFunction"):
        return None  # also with older libraries
    operations, sources, targets, constants = instructions_of(function)
    if len(operations) < MIN_INSTRUCTIONS or not CODES.keys() >= set(operations):
        return None
    lines = enumerate(zip(operations, sources, targets, strict=True))
    code = [[CODES[op], to[0], *of, *to[1:], k, k][:4] for k, (op, of, to) in lines]
    shapes = [[n, function.nnz_in(k), 1] for k, n in enumerate(rows)]
    found = range(function.n_out())
    shapes += [[1, 1, 1], *([max(rows), function.nnz_out(k), 1] for k in found)]
    sizes = len(code), max(rows), len(rows) + 1, len(found), function.sz_w(), randbits(KEY_BITS)
    arrays = np.array(code, np.int32), np.array(constants), np.array(shapes), np.array(sizes)
    given = [ca.MX.sym("a", *shape[:2]) for shape in shapes[: len(rows)]]
    with _LANES_LOCK:
        for slot in range(compiled.kernel_slots()):
            if not compiled.kernel_lanes_in_use(slot):
                _LANES[slot] = arrays
                compiled.kernel_open_lanes(slot, *map(pointer, arrays))
                run = ca.external(f"lanes{slot}", compiled._name)
                return ca.Function("lanes", given, run.call([*given, ca.MX(sizes[-1])]))
    return None


@cache
def library() -> ctypes.CDLL | None:
    """Return the compiled evaluator; None if it cannot be used."""
    for suffix in EXTENSION_SUFFIXES:
        try:
            kernel = ctypes.CDLL(f"{KERNEL}{suffix}")
            if kernel.kernel_layout() == LAYOUT:
                return kernel
        except (OSError, AttributeError):  # missing, of another system, or of an older version
            continue
    return None


def pointer(array: np.ndarray[Any, Any]) -> ctypes.c_void_p:
    """Return the address of a contiguous array."""
    return array.ctypes.data_as(ctypes.c_void_p)


def run_buffered(
    function: ca.Function, columns: Mapping[int, Array], results: Mapping[int, Array]
) -> ca.FunctionBuffer:
    """Evaluate a function from and to memory of numpy; return the buffer, which has statistics.

    ``columns`` are arguments (m, n) by index, others are zero; ``results`` is the memory (n, m) of
    results by index, one row for each column of a result. Errors are those of `evaluate`.
    """
    buffer = _buffer(function, tuple(columns), tuple(results), threading.get_ident())
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


_LANES_LOCK = threading.Lock()
_LANES: dict[int, tuple[np.ndarray[Any, Any], ...]] = {}  # numbers of the slots, kept alive
# buffer of a function by the indices of its arguments and results, and by thread; a new one would
# allocate the function's memory in each evaluation
_buffer = lru_cache(maxsize=32)(lambda function, *_: ca.FunctionBuffer(function))
# function of many points at once, by function and number of points; repeated runs share it
_mapped = lru_cache(maxsize=32)(ca.Function.map)


def dense(values: Array, sparsity: ca.Sparsity) -> Array:
    """Return matrices from their structural nonzeros of `evaluate`, shape (n, rows, columns)."""
    matrices = np.zeros((values.shape[1], *sparsity.shape))
    rows, columns = sparsity.get_triplet()
    matrices[:, rows, columns] = values.T
    return matrices
