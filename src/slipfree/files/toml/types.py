"""Types of the values in TOML files, and the base class of their tables.

Angles and their rates are numbers in radians, or text with a unit as in "30 deg".
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import MISSING
from functools import cache
from itertools import pairwise
from math import pi
from typing import Annotated, Any, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    PlainValidator,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    create_model,
    model_validator,
)
from pydantic_core import PydanticCustomError

from slipfree.core.arguments import MAX_NUMBER, WithUnit, degrees_question
from slipfree.core.schema import Key, keys_of, meanings
from slipfree.files.toml.source import Fault, Place, format_value

EXAMPLE = 'a number, or text with an angular unit, as in "30 deg" or "5 deg/s"'
PAIRS = "a number, or an array of [time, value] pairs"
TEXT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?)\s*(deg|rad)(/s2?)?\s*")
MAX_FRICTION = 10.0  # larger coefficients are probably percent
Piecewise = tuple[tuple[float, float], ...]


class Record(BaseModel):
    """Base class of the tables of TOML files: frozen, without type conversion or unknown keys."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        """Describe the keys as the docstrings of this record and of those above it do."""
        for base in cls.__mro__:
            for name, words in meanings(base).items():
                field = cls.model_fields.get(name)
                if field is not None and (base is cls or field.description is None):
                    field.description = words

    @classmethod
    def schema_for(cls, data: Any) -> type[Record]:  # noqa: ARG003 - for records that depend on it
        """Return the schema for a table with given contents, by default this one."""
        return cls

    @classmethod
    def known_keys(cls) -> list[str]:
        """Return the keys that messages about unknown keys list."""
        return [*cls.model_fields]

    @model_validator(mode="wrap")
    @classmethod
    def _by_contents(cls, data: Any, handler: ModelWrapValidatorHandler[Record]) -> Record:
        """Validate a table by the schema for its contents."""
        schema = cls.schema_for(data)
        return handler(data) if schema is cls else schema.model_validate(data)


def expected_error(text: str) -> PydanticCustomError:
    """Return a validation error of pydantic with a description of the expected value."""
    return PydanticCustomError("expected", "{words}", {"words": text})


class AngleWithUnit(WithUnit):
    """An angle [rad]."""

    unit, words = "rad", "an angle"


class RateWithUnit(WithUnit):
    """An angular rate [rad/s]."""

    unit, words = "rad s-1", "an angular rate"


class _AccelerationWithUnit(WithUnit):
    """An angular acceleration [rad/s2]."""

    unit, words = "rad s-2", "an angular acceleration"


KINDS = {None: AngleWithUnit, "/s": RateWithUnit, "/s2": _AccelerationWithUnit}


def parse_unit(value: Any) -> Any:
    """Return the number of a text such as "30 deg" in SI units; return other values unchanged."""
    match = TEXT.fullmatch(value) if isinstance(value, str) and len(value) < 100 else None
    if match is None:
        return value
    number = float(match[1])
    return KINDS[match[3]](number * pi / 180 if match[2] == "deg" else number)


def _reader(unit: type[WithUnit], text: str) -> WrapValidator:
    def read(value: Any, validate: ValidatorFunctionWrapHandler) -> float:
        parsed = parse_unit(value)
        if not isinstance(parsed, WithUnit):
            if isinstance(parsed, str):
                raise expected_error(text)
            number: float = validate(parsed)
            return number
        if not isinstance(parsed, unit):
            raise expected_error(text)
        validate(float(parsed))
        return parsed

    return WrapValidator(read)


WITH_UNIT = _reader(WithUnit, EXAMPLE)
Quantity = Annotated[float, WITH_UNIT]  # `unit_faults` checks the unit, which depends on the key
IN_RADIANS = _reader(AngleWithUnit, 'a number, or text as in "30 deg"')
IN_RADIANS_PER_SECOND = _reader(RateWithUnit, 'a number, or text as in "5 deg/s"')
Angle = Annotated[float, IN_RADIANS]
Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Count = Annotated[int, Field(ge=0)]
# arrays are read as tuples; types of elements are not converted
Pair = Annotated[tuple[float, float], Field(strict=False)]
Point = Annotated[tuple[float, float, float], Field(strict=False)]
Column = Annotated[tuple[float, ...], Field(strict=False)]
Angles = Annotated[tuple[Angle, ...], Field(strict=False)]
Window = Annotated[tuple[float, float, float, float], Field(strict=False)]
Rock = Annotated[tuple[float, float, float, float], Field(strict=False)]


def unit_faults(
    place: Place, values: Mapping[str, Any], units: Mapping[str, str], *, bare: bool = False
) -> Iterator[Fault]:
    """Yield an error for each value with another unit, and if ``bare`` for angles above a turn."""
    for name, value in values.items():
        unit = units.get(name, "")
        for number in _numbers(value) if unit else ():
            if isinstance(number, WithUnit) and number.unit != unit:
                wanted = unit.replace(" s-", "/s").replace("/s1", "/s")
                found = f"{number.words}; correct the unit"
                yield Fault((*place, name), f"a number in {wanted}", found)
                break
            if bare and unit == "rad" and (hint := bare_words(number)):
                yield Fault((*place, name), hint, format_value(number))
                break


def bare_words(value: float) -> str:
    """Return the expected value for an angle above a full turn without unit, in words; else ""."""
    question = degrees_question(value, f'"{value:.6g} deg"')
    return question and f"radians ({question})"


def in_radians(value: float) -> float:
    """Return an angle unchanged; raise an error if it has no unit and exceeds a full turn."""
    if hint := bare_words(value):
        raise expected_error(hint)
    return value


ANGULAR = {  # angles and rates may have a unit; a bare angle of more than a full turn is an error
    "rad": (IN_RADIANS, AfterValidator(in_radians)),
    "rad/s": (IN_RADIANS_PER_SECOND,),
}


@cache
def record_of(
    kind: Callable[..., Any],
    base: type[Record] = Record,
    *,
    omitted: tuple[str, ...] = (),
    meaning: str = "",
) -> type[Any]:
    """Return the record of a dataclass or function, with the keys of ``base`` before its own."""
    keys: dict[str, Any] = {
        key.name: (
            _toml_type(key),
            Field(
                default=... if key.default is MISSING else key.default, description=key.description
            ),
        )
        for key in keys_of(kind)
        if key.name not in omitted
    }
    meaning = meaning or (kind.__doc__ or "").partition("\n")[0]
    name = kind.__name__
    name = name if isinstance(kind, type) else name.title().replace("_", "")
    return create_model(name, __base__=base, __doc__=meaning, **keys)


def decoded(kind: Callable[..., Any]) -> Any:
    """Return the type of a table that is decoded into a dataclass with annotated fields."""
    made = AfterValidator(lambda table: kind(**given_values(table)))
    return Annotated[record_of(kind), made]


def _toml_type(key: Key) -> Any:
    plain = getattr(key.hint, "__origin__", key.hint)
    if tuple in (plain, get_origin(plain)):
        return Annotated[key.hint, Field(strict=False)]
    return Annotated[key.hint, *ANGULAR.get(key.unit, (Field(),))]


def given_values(table: Record) -> dict[str, Any]:
    """Return the values that a file gives for the keys of a table, without defaults."""
    return {name: getattr(table, name) for name in table.model_fields_set}


def _numbers(value: Any) -> Iterator[float]:
    if isinstance(value, float):
        yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from _numbers(part)


def is_number(value: Any) -> bool:
    """Return whether a value is a number that fits a float; a bool is not."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        return False
    return abs(value) <= MAX_NUMBER  # integers may exceed all floats


def _number(value: Any) -> float:
    return value if isinstance(value, WithUnit) else float(value)


def _piecewise_constant(value: Any) -> float | Piecewise:
    """Return a number, or the (time, value) pairs of a piecewise-constant function."""
    value = parse_unit(value)
    if is_number(value):
        return _number(value)
    pairs = value if isinstance(value, list) else []
    if not pairs or not all(isinstance(pair, list) and len(pair) == 2 for pair in pairs):
        raise expected_error(PAIRS)
    pairs = [(time, parse_unit(rate)) for time, rate in pairs]
    if not all(map(is_number, (number for pair in pairs for number in pair))):
        raise expected_error(PAIRS)
    times = [time for time, _ in pairs]
    if times[0] != 0 or any(b <= a for a, b in pairwise(times)):
        raise expected_error("[time, value] pairs whose times ascend from 0")
    return tuple((float(t), _number(rate)) for t, rate in pairs)


def _piecewise_constant_or_file(value: Any) -> float | Piecewise | str:
    value = parse_unit(value)
    return value if isinstance(value, str) and value else _piecewise_constant(value)


def _time_function(value: Any) -> float | Piecewise | str:
    value = parse_unit(value)
    is_formula = isinstance(value, str) and value
    if not (is_formula or is_number(value) or isinstance(value, list)):
        raise expected_error(
            "a number, an array of [time, value] pairs, or a formula of t in quotes"
        )
    return _piecewise_constant_or_file(value)


def _range(value: Any) -> tuple[float, float]:
    value = [*map(parse_unit, value)] if isinstance(value, list) else parse_unit(value)
    ends = value if isinstance(value, list) else [value, value]
    if len(ends) == 2 and all(map(is_number, ends)):
        low, high = map(_number, ends)
        if low <= high:
            return low, high
    raise expected_error("a number, or [low, high] in ascending order")


def coefficient(value: Any) -> float | str:
    """Return a coefficient of friction, or the name of a friction map file."""
    if isinstance(value, str) and value:
        return value
    if is_number(value) and 0 < value <= MAX_FRICTION:
        return float(value)
    percent = ""
    if is_number(value) and value > MAX_FRICTION:
        percent = f"at most {MAX_FRICTION:g} (did you mean percent? write {value / 100:g}), "
    raise expected_error(f"a number greater than 0, {percent}or the name of a file in quotes")


def one_of(known: Collection[str]) -> AfterValidator:
    """Return a validator that accepts the names among ``known``, which may change later."""

    def check(name: str) -> str:
        if name not in known:
            raise expected_error(f"one of {', '.join(known)}")
        return name

    return AfterValidator(check)


def not_zero(value: float) -> float:
    """Return a speed unchanged; raise an error for zero."""
    if value == 0:
        raise expected_error("a speed other than zero")
    return value


PiecewiseConstant = Annotated[Any, PlainValidator(_piecewise_constant)]
PiecewiseConstantOrFile = Annotated[Any, PlainValidator(_piecewise_constant_or_file)]
TimeFunction = Annotated[Any, PlainValidator(_time_function)]
Range = Annotated[Any, PlainValidator(_range)]
