"""Interval arithmetic on arrays, rounded outward, and interval evaluation of CasADi graphs.

A bound that was rounded to nearest is moved outward by more than its rounding error: by 2^-51 of
its magnitude and by the smallest number `TINY`, which covers underflow. Bounds that are not numbers
enclose nothing; every test of them is false.

Functions that jump, such as signs and comparisons, have no bounds around a jump, so that bounds of
the derivatives of a function with kinks are infinite at the kinks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from slipfree.core.records import Array, Mask

ROUNDING = 2.0**-51  # relative outward shift, four times the error of rounding to nearest
TINY = 1e-300  # absolute outward shift
LIBRARY_ERROR = 2.0**-50  # largest error of NumPy's sine and cosine, which is 4 ulp
NEAR_EXTREME = 1e-9  # distance from an extreme of the sine that counts as on it [angle + 1]


@dataclass(frozen=True, eq=False, slots=True)
class Intervals:
    """Intervals ``low <= value <= high``, arrays of one shape."""

    low: Array
    high: Array

    __array_ufunc__ = None  # NumPy must not take an interval as an element of an array

    def __getitem__(self, index: Any) -> Intervals:
        """Return the intervals at an index of the arrays."""
        return Intervals(self.low[index], self.high[index])

    def __iter__(self) -> Iterator[Intervals]:
        """Return the rows, along the first axis of the arrays."""
        return (self[k] for k in range(len(self.low)))

    def __neg__(self) -> Intervals:
        return Intervals(-self.high, -self.low)

    def __add__(self, other: Intervals | Array | float) -> Intervals:
        low, high = _bounds(other)
        return _outward(self.low + low, self.high + high, 0.0)

    def __sub__(self, other: Intervals | Array | float) -> Intervals:
        low, high = _bounds(other)
        return _outward(self.low - high, self.high - low, 0.0)

    def __mul__(self, other: Intervals | Array | float) -> Intervals:
        if not isinstance(other, Intervals):
            a, b = self.low * other, self.high * other
            return _outward(np.minimum(a, b), np.maximum(a, b))
        a, b = self.low * other.low, self.high * other.high
        c, d = self.low * other.high, self.high * other.low
        low = np.minimum(a, b)
        high = np.maximum(a, b, out=a)
        low = np.minimum(low, np.minimum(c, d, out=b), out=low)
        return _outward(low, np.maximum(high, np.maximum(c, d, out=c), out=high))

    def square(self) -> Intervals:
        """Return the squares."""
        a, b = self.low * self.low, self.high * self.high
        low = np.where(self.contains_zero, 0.0, np.minimum(a, b))
        return _outward(low, np.maximum(a, b))

    def inverse(self) -> Intervals:
        """Return the reciprocals, without bounds for intervals that contain zero."""
        low, high = 1.0 / self.high, 1.0 / self.low
        bad = self.contains_zero
        return _outward(np.where(bad, -np.inf, low), np.where(bad, np.inf, high))

    def sqrt(self) -> Intervals:
        """Return the square roots; not a number where an interval has negative values."""
        return _outward(np.sqrt(self.low), np.sqrt(self.high))

    def cos(self) -> Intervals:
        """Return the cosines."""
        return _wave(self, np.cos, 0.0)

    def sin(self) -> Intervals:
        """Return the sines."""
        return _wave(self, np.sin, 0.5)

    @property
    def contains_zero(self) -> Mask:
        """Whether the intervals contain zero, also where a bound is not a number."""
        return np.asarray(~((self.low > 0) | (self.high < 0)))

    @property
    def magnitude(self) -> Array:
        """Largest absolute values."""
        return np.maximum(np.abs(self.low), np.abs(self.high))


def around(middle: Array, radius: Array | float) -> Intervals:
    """Return the intervals with given middles and radii."""
    return _outward(middle - radius, middle + radius)


def exactly(values: Array) -> Intervals:
    """Return the intervals that contain one number each."""
    return Intervals(values, values)


def stack(parts: Sequence[Intervals], axis: int = 0) -> Intervals:
    """Return intervals of equal shapes, stacked along a new axis."""
    return Intervals(
        *(np.stack(ends, axis) for ends in zip(*((p.low, p.high) for p in parts), strict=True))
    )


def _bounds(other: Intervals | Array | float) -> tuple[Any, Any]:
    return (other.low, other.high) if isinstance(other, Intervals) else (other, other)


def _outward(low: Array, high: Array, tiny: float = TINY) -> Intervals:
    """Return ends moved outward, in place; sums need no ``tiny``, since they are exact there."""
    down, up = np.abs(low), np.abs(high)
    for shift in (down, up):  # in place, since most of the time goes to memory
        shift *= ROUNDING
        if tiny:
            shift += tiny
    low -= down
    high += up
    return Intervals(low, high)


def _wave(angle: Intervals, function: Callable[[Array], Array], shift: float) -> Intervals:
    """Return the values of a sine or cosine, whose maxima are at ``shift`` pi plus full turns."""
    a, b = function(angle.low), function(angle.high)
    # half turns from the maximum; an extreme that is only near also counts
    near = NEAR_EXTREME * (1 + angle.magnitude)
    first, last = angle.low / np.pi - shift - near, angle.high / np.pi - shift + near
    has_maximum = 2 * np.ceil(first / 2) <= last
    has_minimum = 2 * np.ceil((first - 1) / 2) + 1 <= last
    low = np.maximum(np.minimum(a, b) - LIBRARY_ERROR, -1.0)
    high = np.minimum(np.maximum(a, b) + LIBRARY_ERROR, 1.0)
    return Intervals(np.where(has_minimum, -1.0, low), np.where(has_maximum, 1.0, high))


def _rising(function: Callable[[Array], Array]) -> Callable[[Intervals], Intervals]:
    """Return the extension to intervals of a function of NumPy that never falls."""

    def values(a: Intervals) -> Intervals:
        low, high = function(a.low), function(a.high)
        return _outward(low - LIBRARY_ERROR * np.abs(low), high + LIBRARY_ERROR * np.abs(high))

    return values


def _magnitudes(a: Intervals) -> Intervals:
    least = np.minimum(np.abs(a.low), np.abs(a.high))
    return Intervals(np.where(a.contains_zero, 0.0, least), a.magnitude)


def _power(a: Intervals, b: Intervals) -> Intervals:
    """Return bounds of powers; the exponent must be one number."""
    if b.low.size != 1 or b.low[0] != b.high[0]:
        return UNBOUNDED
    exponent = float(b.low[0])
    if exponent < 0:
        return _power(a, -b).inverse()
    return _rising(lambda each: each**exponent)(_magnitudes(a) if exponent % 2 == 0 else a)


def _each(function: Callable[[Array, Array], Array]) -> Callable[..., Intervals]:
    """Return the extension to intervals of a function that falls in no argument."""
    return lambda a, b: Intervals(function(a.low, b.low), function(a.high, b.high))


def _steps(low: Array, high: Array) -> Intervals:
    """Return the values of a step function, without bounds where it jumps."""
    jumps = ~(low == high)
    return Intervals(np.where(jumps, -np.inf, low), np.where(jumps, np.inf, high))


def _if_else_zero(condition: Intervals, a: Intervals) -> Intervals:
    jumps, never = np.isinf(condition.low), condition.high <= 0
    low, high = np.where(never, 0.0, a.low), np.where(never, 0.0, a.high)
    return Intervals(np.where(jumps, -np.inf, low), np.where(jumps, np.inf, high))


UNBOUNDED = Intervals(np.full(1, -np.inf), np.full(1, np.inf))
OPERATIONS: dict[int, Callable[..., Intervals]] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: lambda a, b: a + b,
    ca.OP_SUB: lambda a, b: a - b,
    ca.OP_MUL: lambda a, b: a.square() if a is b else a * b,
    ca.OP_DIV: lambda a, b: a * b.inverse(),
    ca.OP_NEG: lambda a: -a,
    ca.OP_SQ: lambda a: a.square(),
    ca.OP_TWICE: lambda a: a + a,
    ca.OP_INV: lambda a: a.inverse(),
    ca.OP_SQRT: lambda a: a.sqrt(),
    ca.OP_SIN: lambda a: a.sin(),
    ca.OP_COS: lambda a: a.cos(),
    ca.OP_FABS: _magnitudes,
    ca.OP_FMIN: _each(np.minimum),
    ca.OP_FMAX: _each(np.maximum),
    ca.OP_HYPOT: lambda a, b: (a.square() + b.square()).sqrt(),
    ca.OP_POW: _power,
    ca.OP_CONSTPOW: _power,
    ca.OP_LT: lambda a, b: _steps(1.0 * (a.high < b.low), 1.0 * ~(a.low >= b.high)),
    ca.OP_LE: lambda a, b: _steps(1.0 * (a.high <= b.low), 1.0 * ~(a.low > b.high)),
    ca.OP_AND: _each(np.minimum),
    ca.OP_OR: _each(np.maximum),
    ca.OP_NOT: lambda a: Intervals(1.0 - a.high, 1.0 - a.low),
    ca.OP_SIGN: lambda a: _steps(np.sign(a.low), np.sign(a.high)),
    ca.OP_FLOOR: lambda a: _steps(np.floor(a.low), np.floor(a.high)),
    ca.OP_CEIL: lambda a: _steps(np.ceil(a.low), np.ceil(a.high)),
    ca.OP_IF_ELSE_ZERO: _if_else_zero,
    ca.OP_COSH: lambda a: _rising(np.cosh)(_magnitudes(a)),
}
RISING = {"EXP": np.exp, "LOG": np.log, "TANH": np.tanh, "SINH": np.sinh}
RISING |= {"ATAN": np.arctan, "ASIN": np.arcsin}
OPERATIONS |= {getattr(ca, f"OP_{name}"): _rising(rising) for name, rising in RISING.items()}


def evaluate_interval(function: ca.Function, argument: Intervals) -> Intervals:
    """Return enclosures of an SX function of one column, at boxes (n_rows, n).

    The result has the shape (n_results, n); results of operations that are not in `OPERATIONS` have
    no bounds.
    """
    values: dict[int, Intervals] = {}
    n = argument.low.shape[1]
    results = np.zeros((2, function.nnz_out(0), n))
    for k in range(function.n_instructions()):
        kind, operands = function.instruction_id(k), function.instruction_input(k)
        places = function.instruction_output(k)
        if kind == ca.OP_CONST:
            values[places[0]] = exactly(np.full(1, function.instruction_constant(k)))
        elif kind == ca.OP_INPUT:
            values[places[0]] = argument[operands[1]]
        elif kind == ca.OP_OUTPUT:
            value = values[operands[0]]
            results[0, places[1]], results[1, places[1]] = value.low, value.high
        else:
            operation, given = OPERATIONS.get(kind), (values[each] for each in operands)
            with np.errstate(all="ignore"):
                values[places[0]] = UNBOUNDED if operation is None else operation(*given)
    return Intervals(*results)
