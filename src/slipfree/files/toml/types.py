"""Types of the values in TOML files, and the base class of their tables."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from itertools import pairwise
from math import pi
from typing import Annotated, Any, ClassVar

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PlainValidator,
    ValidatorFunctionWrapHandler,
    WrapValidator,
)
from pydantic_core import PydanticCustomError

from slipfree.files.toml.source import Fault, format_value
from slipfree.files.toml.source import Place as KeyPath

FULL_TURN = 2 * pi * 1.001  # larger bare angles are probably degrees; the margin allows rounding
EXAMPLE = 'a number, or text with an angular unit, as in "30 deg" or "5 deg/s"'
TEXT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?)\s*(deg|rad)(/s2?)?\s*")
MAX_NUMBER = 1e300  # largest accepted number
Piecewise = tuple[tuple[float, float], ...]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=0)]
# arrays are read as tuples; types of elements are not converted
Pair = Annotated[tuple[float, float], Field(strict=False)]
Place = Annotated[tuple[float, float, float], Field(strict=False)]
Column = Annotated[tuple[float, ...], Field(strict=False)]
Window = Annotated[tuple[float, float, float, float], Field(strict=False)]
Rock = Annotated[tuple[float, float, float, float], Field(strict=False)]


class WithUnit(float):
    """A number that was written with a unit, converted to SI units."""

    unit: ClassVar[str]
    words: ClassVar[str]


class AngleWithUnit(WithUnit):
    """An angle [rad]."""

    unit, words = "rad", "an angle"


class RateWithUnit(WithUnit):
    """An angular rate [rad/s]."""

    unit, words = "rad s-1", "an angular rate"


class AccelerationWithUnit(WithUnit):
    """An angular acceleration [rad/s2]."""

    unit, words = "rad s-2", "an angular acceleration"


KINDS: dict[str | None, type[WithUnit]] = {
    None: AngleWithUnit,
    "/s": RateWithUnit,
    "/s2": AccelerationWithUnit,
}


def parse_unit(value: Any) -> Any:
    """Return the number of a text such as "30 deg" in SI units; return other values unchanged."""
    found = TEXT.fullmatch(value) if isinstance(value, str) and len(value) < 100 else None
    if found is None:
        return value
    number = float(found[1])
    return KINDS[found[3]](number * pi / 180 if found[2] == "deg" else number)


def _read(value: Any, validate: ValidatorFunctionWrapHandler) -> float:
    """Return a validated number: a `WithUnit` if it has a unit, which `unit_faults` checks."""
    found = parse_unit(value)
    if isinstance(found, str):
        raise PydanticCustomError("expected", "{words}", {"words": EXAMPLE})
    number: float = validate(float(found) if isinstance(found, WithUnit) else found)
    return found if isinstance(found, WithUnit) else number


def _reader(unit: type[WithUnit]) -> WrapValidator:
    """Return a validator that accepts numbers, and texts with the given unit."""
    words = f'a number, or text as in "{"5 deg/s" if unit is RateWithUnit else "30 deg"}"'

    def read(value: Any, validate: ValidatorFunctionWrapHandler) -> float:
        found = parse_unit(value)
        if isinstance(found, str) or (isinstance(found, WithUnit) and not isinstance(found, unit)):
            raise PydanticCustomError("expected", "{words}", {"words": words})
        return _read(value, validate)

    return WrapValidator(read)


WITH_UNIT = WrapValidator(_read)


Quantity = Annotated[float, WITH_UNIT]  # `unit_faults` checks the unit, which depends on the key


IN_RADIANS, IN_RADIANS_PER_SECOND = _reader(AngleWithUnit), _reader(RateWithUnit)


Angle = Annotated[float, IN_RADIANS]


def unit_faults(
    place: KeyPath, values: Mapping[str, Any], units: Mapping[str, str], *, bare: bool = False
) -> Iterator[Fault]:
    """Yield an error for each value with a unit other than the expected one.

    Parameters
    ----------
    place : tuple of str or int
        Keys of the table in its file, for the location in messages.
    values : mapping
        Numbers, ranges, or piecewise constants by name of the key.
    units : mapping of str to str
        Expected units by name, as in ``rad s-1``; values without an entry are not checked.
    bare : bool
        Whether an angle of more than a full turn without a unit is an error too.
    """
    for name, value in values.items():
        unit = units.get(name, "")
        for number in _numbers(value) if unit else ():
            if isinstance(number, WithUnit) and number.unit != unit:
                spelled = unit.replace(" s-", "/s").replace("/s1", "/s")
                found = f"{number.words}; correct the unit"
                yield Fault((*place, name), f"a number in {spelled}", found)
                break
            if bare and unit == "rad" and (words := bare_words(number)):
                yield Fault((*place, name), words, format_value(number))
                break


def bare_words(value: float) -> str:
    """Return the expected value, in words, for an angle that is probably given in degrees.

    Such an angle has no unit and exceeds a full turn. The result is empty for other values.
    """
    if isinstance(value, WithUnit) or abs(value) <= FULL_TURN:
        return ""
    return f'radians (did you mean {value:.6g} degrees? write "{value:.6g} deg")'


def in_radians(value: float) -> float:
    """Return an angle unchanged; raise an error if it has no unit and exceeds a full turn."""
    if words := bare_words(value):
        raise PydanticCustomError("expected", "{words}", {"words": words})
    return value


def _numbers(value: Any) -> Iterator[float]:
    """Yield all numbers of a value: a scalar, a range or a piecewise constant."""
    if isinstance(value, float):
        yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from _numbers(part)


NonNegativeAngle = Annotated[NonNegative, IN_RADIANS]


NonNegativeRate = Annotated[NonNegative, IN_RADIANS_PER_SECOND]


Angles = Annotated[tuple[Angle, ...], Field(strict=False)]


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
