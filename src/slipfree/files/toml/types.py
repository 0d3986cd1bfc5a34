"""Types of the values in problem files, and the base class of their tables."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, PlainValidator
from pydantic_core import PydanticCustomError

from slipfree.files.toml.angles import (
    IN_RADIANS,
    IN_RADIANS_PER_SECOND,
    Angle,
    WithUnit,
    parse_unit,
)

MAX_NUMBER = 1e300  # largest accepted number
Piecewise = tuple[tuple[float, float], ...]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
NonNegativeAngle = Annotated[NonNegative, IN_RADIANS]
NonNegativeRate = Annotated[NonNegative, IN_RADIANS_PER_SECOND]
Count = Annotated[int, Field(ge=0)]
# arrays are read as tuples; types of elements are not converted
Pair = Annotated[tuple[float, float], Field(strict=False)]
Place = Annotated[tuple[float, float, float], Field(strict=False)]
Column = Annotated[tuple[float, ...], Field(strict=False)]
Angles = Annotated[tuple[Angle, ...], Field(strict=False)]
Window = Annotated[tuple[float, float, float, float], Field(strict=False)]
Rock = Annotated[tuple[float, float, float, float], Field(strict=False)]


class Record(BaseModel):
    """Base class of the tables of TOML files: frozen, without type conversion or unknown keys."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


def _is_number(value: Any) -> bool:
    """Return whether a value is a number with an absolute value of at most 1e300."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return abs(value) <= MAX_NUMBER  # integers may exceed all floats


def _number(value: Any) -> float:
    """Return a number as float; return a `WithUnit` unchanged."""
    return value if isinstance(value, WithUnit) else float(value)


def _piecewise_constant(value: Any) -> float | Piecewise:
    """Return a number, or the (time, value) pairs of a piecewise-constant function."""
    value = parse_unit(value)
    if _is_number(value):
        return _number(value)
    pairs = value if isinstance(value, list) else []
    if not pairs or not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs):
        raise PydanticCustomError("expected", "a number, or an array of [time, value] pairs")
    pairs = [(time, parse_unit(rate)) for time, rate in pairs]
    if not all(map(_is_number, (number for pair in pairs for number in pair))):
        raise PydanticCustomError("expected", "a number, or an array of [time, value] pairs")
    times = [pair[0] for pair in pairs]
    if times[0] != 0 or any(b <= a for a, b in pairwise(times)):
        raise PydanticCustomError("expected", "[time, value] pairs whose times ascend from 0")
    return tuple((float(t), _number(rate)) for t, rate in pairs)


def _piecewise_constant_or_file(value: Any) -> float | Piecewise | str:
    """Return a number, the pairs of a piecewise-constant function, or the name of a file."""
    value = parse_unit(value)
    return value if isinstance(value, str) and value else _piecewise_constant(value)


def _time_function(value: Any) -> float | Piecewise | str:
    """Return a number, the pairs of a piecewise-constant function, or a formula of time."""
    value = parse_unit(value)
    if isinstance(value, str) and value:
        return value
    if not _is_number(value) and not isinstance(value, list):
        expected = "a number, an array of [time, value] pairs, or a formula of t in quotes"
        raise PydanticCustomError("expected", expected)
    return _piecewise_constant(value)


def _range(value: Any) -> tuple[float, float]:
    """Return the range (low, high) of a pair in ascending order, or of a number (low = high)."""
    value = [*map(parse_unit, value)] if isinstance(value, list) else parse_unit(value)
    if _is_number(value):
        return _number(value), _number(value)
    if isinstance(value, list) and len(value) == 2 and all(map(_is_number, value)):
        low, high = map(_number, value)
        if low <= high:
            return low, high
    raise PydanticCustomError("expected", "a number, or [low, high] in ascending order")


def coefficient(value: Any) -> float | str:
    """Return a coefficient of friction, or the name of a friction map file."""
    if isinstance(value, str) and value:
        return value
    if _is_number(value) and value > 0:
        return float(value)
    raise PydanticCustomError(
        "expected", "a number greater than 0, or the name of a file in quotes"
    )


def not_zero(value: float) -> float:
    """Return a speed unchanged; raise an error for zero."""
    if value == 0:
        raise PydanticCustomError("expected", "a speed other than zero")
    return value


PiecewiseConstant = Annotated[Any, PlainValidator(_piecewise_constant)]
PiecewiseConstantOrFile = Annotated[Any, PlainValidator(_piecewise_constant_or_file)]
TimeFunction = Annotated[Any, PlainValidator(_time_function)]
Range = Annotated[Any, PlainValidator(_range)]
