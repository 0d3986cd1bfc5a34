"""Checks of the arguments of public functions and records, by the annotations of their signatures.

Types, lengths, bounds and units are stated once, as annotations. Another type, a number that is not
a number, an empty array or an angle that is probably in degrees raises ModelError, which states the
argument, what was expected, what was found and the remedy.
"""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, wraps
from math import inf, pi
from numbers import Integral, Real
from types import NoneType, SimpleNamespace, UnionType
from typing import (
    Annotated,
    Any,
    ClassVar,
    Literal,
    NamedTuple,
    TypeVar,
    Union,
    get_args,
    get_origin,
    get_type_hints,
)

import casadi as ca
import numpy as np
from annotated_types import Unit
from typing_extensions import get_protocol_members, is_protocol

from slipfree.core.errors import ModelError, read_table, similar
from slipfree.core.schema import BOUNDS

FULL_TURN = 2 * pi * 1.001  # larger bare angles are probably degrees; the margin allows rounding
MAX_NUMBER = 1e300  # largest accepted number
MAX_SHOWN = 60  # characters of a value in a message
PACKAGE = "slipfree."  # of callers whose angles are not asked about
BY_NAME = "values by name of a quantity of the model, in its unit"  # mark of an annotation
ASCENDING = "a smallest and a largest value"  # mark of an annotation
F = TypeVar("F", bound=Callable[..., Any])
WORDS: dict[Any, str] = {
    float: "a number",
    int: "an integer",
    bool: "True or False",
    str: "text",
    np.ndarray: "an array of numbers",
    Mapping: "a mapping",
    Sequence: "a sequence",
    Callable: "a function",
}
REMEDIES = read_table(__file__, "remedies.toml")


class WithUnit(float):
    """A number that was written with a unit, converted to SI units."""

    unit: ClassVar[str]
    words: ClassVar[str]


class _Wrong(Exception):  # noqa: N818 - becomes a ModelError
    """A value that does not fit: its place, and the expected and found values in words."""

    def __init__(self, place: str, expected: str, found: str, remedy: str = "") -> None:
        super().__init__(place)
        self.place, self.expected, self.found = place, expected, found
        self.remedy = remedy or REMEDIES.get(expected, "")


class _Context(NamedTuple):
    symbolic: bool  # whether expressions stand for numbers, as in records
    units: Mapping[str, str] | None  # of the quantities of the model; None to take any angle


def degrees_question(value: float, spelling: str) -> str:
    """Return a question if a bare angle exceeds a full turn, and the spelling; empty if not."""
    if isinstance(value, WithUnit) or not FULL_TURN < abs(value) < inf:
        return ""
    return f"did you mean {value:.6g} degrees? write {spelling}"


def check_finite(argument: str, values: np.ndarray[Any, Any]) -> None:
    """Raise ModelError unless all values are finite numbers, with the first that is not."""
    if not np.isfinite(values).all():
        wrong = values[~np.isfinite(values)][0]
        raise ModelError(f"{argument}: expected finite numbers, found {wrong}; correct them")


def checked(target: F) -> F:
    """Return a function or a dataclass that checks its arguments by their annotations.

    Lists become arrays or tuples where these are annotated. Angles, and whether vehicle and ground
    are those of the model, are checked in calls from outside the package, which itself continues
    headings over several turns and lets a controller know another vehicle than the true one.
    """
    new: Any = target
    if isinstance(target, type):
        new.__init__ = _checked_call(new.__init__, target.__name__.lstrip("_"), target)
    else:
        new = _checked_call(target, target.__name__)
    return new  # type: ignore[no-any-return]


def _checked_call(
    function: Callable[..., Any], name: str, owner: type | None = None
) -> Callable[..., Any]:
    """Return the function with its arguments converted and checked against its annotations."""
    signature = inspect.signature(function)

    @cache
    def hints() -> dict[str, Any]:
        if owner is not None:
            return get_type_hints(owner, include_extras=True)
        kept = {k: v for k, v in function.__annotations__.items() if k != "return"}
        shim: Any = SimpleNamespace(__annotations__=kept)
        return get_type_hints(shim, inspect.unwrap(function).__globals__, include_extras=True)

    @wraps(function)
    def call(*args: Any, **named: Any) -> Any:
        """Check and convert the arguments, then call the function."""
        try:
            bound = signature.bind(*args, **named)
        except TypeError as error:
            known = [each for each in signature.parameters if each != "self"]
            words = f"the arguments {', '.join(known)}, found {error}; correct the call"
            if others := [each for each in named if each not in known]:
                words = f"arguments among {', '.join(known)}, found {others[0]!r}; "
                words += f"{similar(others[0], known)}correct it"
            raise ModelError(f"{name}: expected {words}") from None
        given, caller = bound.arguments, sys._getframe(1).f_globals.get("__name__", "")
        is_outer = not caller.startswith(PACKAGE)
        # units of the quantities of a model among the arguments
        units = [getattr(getattr(each, "model", each), "units", None) for each in given.values()]
        own = next((each for each in units if isinstance(each, Mapping)), {})
        context = _Context(owner is not None, own if is_outer else None)
        for parameter, value in given.items():
            hint = hints().get(parameter, Any)
            try:
                if signature.parameters[parameter].kind is inspect.Parameter.VAR_KEYWORD:
                    value.update({k: _converted(hint, v, k, context) for k, v in value.items()})
                else:
                    given[parameter] = _converted(hint, value, parameter, context)
            except _Wrong as wrong:
                is_named = owner and isinstance(given.get("name"), str)
                who = f"{name.lower()} {given['name']!r}" if is_named else name
                default = signature.parameters[parameter].default
                usual = isinstance(default, int | float) and f"the default is {default:g}"
                remedy = _exchange(parameter, given, hints()) or wrong.remedy or usual
                raise ModelError(
                    f"{who}: {wrong.place}: expected {wrong.expected}, found {wrong.found}; "
                    f"{remedy or 'correct it'}"
                ) from None
        return function(*bound.args, **bound.kwargs)

    return call


def _exchange(parameter: str, given: Mapping[str, Any], hints: Mapping[str, Any]) -> str:
    """Return the remedy for two exchanged arguments; empty if no exchange helps."""

    def fits(name: str, value: Any) -> bool:
        try:
            _converted(hints.get(name, Any), value, name, _Context(False, None))
        except _Wrong:
            return False
        return True

    for other, value in given.items():
        if fits(parameter, value) and fits(other, given[parameter]) and not fits(other, value):
            return f"exchange {parameter!r} and {other!r}"
    return ""


def _converted(hint: Any, value: Any, place: str, context: _Context) -> Any:
    """Return a value as its annotation has it; raise `_Wrong` for a value that does not fit."""
    kind, parts = get_origin(hint) or hint, get_args(hint)
    if kind is Annotated:
        value = _converted(parts[0], value, place, context)
        for note in sorted(parts[1:], key=lambda each: not isinstance(each, Unit)):
            _check_note(note, value, place, context)
        return value
    if kind in (Union, UnionType):
        return _one_of(parts, value, place, context)
    if kind is np.ndarray:
        return _array(hint, value, place)
    if kind in (tuple, Sequence):
        return _sequence(hint, value, place, context)
    if not _is_instance(kind, parts, value, context):
        similar_one = similar(value, parts) if kind is Literal and isinstance(value, str) else ""
        is_known = similar_one or (kind is float and isinstance(value, Real))
        remedy = f"{similar_one}correct it" if is_known else ""
        remedy = f"call it: {value.__name__}()" if isinstance(value, type) else remedy
        raise _Wrong(place, _words(hint), _shown(value), remedy)
    if kind is Mapping:
        pairs = ((k, _converted(parts[0], k, f"{place}, name", context)) for k in value)
        return {new: _converted(parts[1], value[k], f"{place}[{k!r}]", context) for k, new in pairs}
    return value


def _one_of(parts: Sequence[Any], value: Any, place: str, context: _Context) -> Any:
    """Return a value as the first alternative that fits has it."""
    remedies = list[str]()
    for part in parts:
        try:
            return _converted(part, value, place, context)
        except _Wrong as wrong:
            if wrong.expected != _words(part):  # the type fits: an element or a bound does not
                raise
            remedies.append(wrong.remedy)
    words = " or ".join(dict.fromkeys(_words(part) for part in parts if part is not NoneType))
    raise _Wrong(place, words, _shown(value), next(filter(None, remedies), ""))


def _is_instance(kind: Any, parts: tuple[Any, ...], value: Any, context: _Context) -> bool:
    """Return whether a value fits an annotation without parameters, or a protocol."""
    is_logical = isinstance(value, bool | np.bool_)
    if kind is Literal:
        return any(type(value) is type(each) and value == each for each in parts)
    if kind is float:
        if isinstance(value, ca.SX):
            return context.symbolic
        is_scalar = isinstance(value, np.ndarray) and not value.ndim and value.dtype.kind in "fiu"
        is_number = isinstance(value, Real) or is_scalar
        return is_number and not is_logical and (abs(value) <= MAX_NUMBER or abs(value) == inf)
    if kind in (int, bool):
        return is_logical if kind is bool else isinstance(value, Integral) and not is_logical
    if isinstance(kind, type) and is_protocol(kind):
        missing = object()
        names = get_protocol_members(kind)
        has = (inspect.getattr_static(value, each, missing) is not missing for each in names)
        return not isinstance(value, type) and all(has)
    if kind is Callable:
        return callable(value) and not isinstance(value, type)
    return kind is Any or not isinstance(kind, type) or isinstance(value, kind)


def _array(hint: Any, value: Any, place: str) -> Any:
    """Return a value as an array of numbers or truth values; raise `_Wrong` for others."""
    is_mask = np.bool_ in get_args(get_args(hint)[-1])
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        array = np.empty(0, dtype=object)
    if np.ma.isMaskedArray(value):
        remedy = "replace masked values by numbers: .filled(...)"
        raise _Wrong(place, _words(hint), "a masked array", remedy)
    is_numeric = array.dtype.kind in ("b" if is_mask else "fiu") and array.size and array.ndim
    if hasattr(value, "_fields") or not is_numeric:
        raise _Wrong(place, _words(hint), _shown(value))
    return array.astype(bool if is_mask else np.float64, copy=False)


def _sequence(hint: Any, value: Any, place: str, context: _Context) -> Any:
    """Return the items of a tuple or sequence, checked and converted.

    ``hint`` is the annotation, ``place`` the name of the value in messages.
    """
    kind, parts = get_origin(hint), get_args(hint)
    is_record = parts[0] is object  # tuple[object, ...]: a record of a model, not converted
    if isinstance(value, np.ndarray) and not is_record:
        value = value.tolist()
    length = None if kind is Sequence or parts[1:] == (...,) else len(parts)
    fits = isinstance(value, tuple if is_record else Sequence)
    if not fits or isinstance(value, str | bytes) or length not in (None, len(value)):
        raise _Wrong(place, _words(hint), _shown(value))
    if is_record:
        return value
    hints = [parts[0]] * len(value) if length is None else parts
    each = [
        _converted(part, item, f"{place}[{k}]", context)
        for k, (part, item) in enumerate(zip(hints, value, strict=True))
    ]
    return tuple(each) if kind is tuple else each


def _check_note(note: Any, value: Any, place: str, context: _Context) -> None:
    """Raise `_Wrong` if a value violates an annotated bound, or an angle is probably in degrees."""
    if note is BY_NAME and context.units:
        for name, each in value.items() if isinstance(value, Mapping) else [(place, value)]:
            if context.units.get(name) == "rad":
                _check_radians(each, place if name == place else f"{place}[{name!r}]")
    elif isinstance(note, Unit) and note.unit == "rad" and context.units is not None:
        _check_radians(value, place)
    elif note is ASCENDING and value[0] > value[-1]:
        raise _Wrong(place, "ascending bounds", f"{value[0]} to {value[-1]}", "exchange them")
    for name, (sign, holds) in BOUNDS.items():
        edge = getattr(note, name, None)
        if edge is None or not isinstance(value, np.ndarray | Real):
            continue
        numbers = np.ravel(np.asarray(value))
        for k in np.flatnonzero(~holds(numbers, edge))[:1]:
            words = "a finite number" if abs(edge) == inf else f"a number {sign} {edge:g}"
            at = f"{place}[{k}]" if isinstance(value, np.ndarray) else place
            raise _Wrong(at, words, _text(numbers[k]))


def check_angles(name: str, values: Mapping[str, Any], units: Mapping[str, str]) -> None:
    """Raise ModelError if a value in rad by name of a quantity is probably in degrees."""
    try:
        _check_note(BY_NAME, values, name, _Context(False, units))
    except _Wrong as wrong:
        words = f"{wrong.place}: expected {wrong.expected}, found {wrong.found}; {wrong.remedy}"
        raise ModelError(words) from None


def _check_radians(value: Any, place: str) -> None:
    for number in _numbers(value):
        if question := degrees_question(number, f"np.radians({number:.6g})"):
            remedy = f"{question}, or remove whole turns"
            raise _Wrong(place, "an angle in radians", f"{number:.6g}", remedy)


def _numbers(value: Any) -> Iterator[float]:
    """Yield the numbers in a value; of an array, the one with the largest absolute value."""
    if isinstance(value, Real):
        yield float(value) if not isinstance(value, WithUnit) else value
    elif isinstance(value, np.ndarray):
        yield float(value.flat[np.abs(value).argmax()])
    elif isinstance(value, tuple | list):
        for each in value:
            yield from _numbers(each)


def _words(hint: Any) -> str:
    """Return an annotated type in words."""
    kind, parts = get_origin(hint) or hint, get_args(hint)
    if kind is Annotated:
        return _words(parts[0])
    if kind in (Union, UnionType):
        return " or ".join(dict.fromkeys(map(_words, parts)))
    if kind is Literal:
        return " or ".join(map(repr, parts))
    if kind is tuple and parts[0] is object:
        return "a record of inputs"
    if kind is tuple and parts[-1] is not ...:
        return f"{len(parts)} {'numbers' if _words(parts[0]) == WORDS[float] else 'values'}"
    if kind in (tuple, Sequence):
        return f"a sequence of {_words(parts[0])}"
    return WORDS.get(kind) or str(getattr(kind, "__name__", kind))


def _shown(value: Any) -> str:
    """Return type and value in words, short enough for a message."""
    if isinstance(value, np.ndarray):
        return f"an array of shape {value.shape}" if value.size else "an empty array"
    if isinstance(value, list | tuple) and not value:
        return f"an empty {type(value).__name__}"
    if isinstance(value, type):
        return f"the class {value.__name__}"
    if not isinstance(value, str | Real | list | dict):
        return "None" if value is None else type(value).__name__
    return f"{type(value).__name__} {_text(value)}"


def _text(value: Any) -> str:
    try:
        text = f"{value}" if isinstance(value, Real) else repr(value)
    except ValueError:  # of integers with thousands of digits
        return "..."
    return text if len(text) <= MAX_SHOWN else "..."
