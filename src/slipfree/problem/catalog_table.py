"""Vehicles of the catalogue, and the keys that a problem file may give for each of them."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, get_type_hints

from pydantic import AfterValidator, BaseModel, Field, ValidationError, create_model
from pydantic_core import InitErrorDetails, PydanticCustomError

from slipfree import catalog
from slipfree.files.toml.source import similar_hint
from slipfree.files.toml.types import IN_RADIANS, in_radians
from slipfree.geometry.frame import Vector
from slipfree.vehicle.tree import Vehicle

CATALOG: dict[str, Callable[..., Vehicle]] = {
    name: getattr(catalog, name) for name in catalog.__all__
}
MAY_BE_ZERO = ("r1", "r2", "stiffness", "damping", "bump", "mass", "wheel_mass")
ANGLES = ("steer_stop", "bend_stop", "tilt_stop")
ANY_SIGN = ("trail", "joint", "preload")
OWN = ("catalog", "file", "actuated", "name")  # keys that are not keywords of the function


@dataclass(frozen=True)
class Found:
    """Description of a found value, which replaces the value in an error of pydantic."""

    words: str

    def __str__(self) -> str:
        return self.words


def fault(place: str | None, expected: str, found: str, hint: str = "") -> InitErrorDetails:
    """Return a pydantic error about the key ``place`` of a table; None stands for the table."""
    kind = PydanticCustomError("expected", "{words}", {"words": expected, "hint": hint})
    return InitErrorDetails(type=kind, loc=(place,) if place else (), input=Found(found))


@cache
def table_of(base: type[BaseModel], catalog: str) -> type[BaseModel]:
    """Return the schema of a table for a vehicle of the catalogue.

    Its keys are those of the schema ``base`` and the keyword arguments of the vehicle's function.
    """
    function = CATALOG[catalog]
    hints = get_type_hints(function)
    fields: dict[str, Any] = {
        key: (_kind(key, hints[key]) | None, None) for key in inspect.signature(function).parameters
    }
    return create_model(f"{base.__name__}_{catalog}", __base__=base, **fields)


def _kind(key: str, hint: Any) -> Any:
    """Return the type of a keyword; the vehicle's function checks its value."""
    if hint is float:
        if key in ANY_SIGN:
            return Annotated[float, Field()]
        if key in ANGLES:
            return Annotated[float, Field(gt=0), IN_RADIANS, AfterValidator(in_radians)]
        return (
            Annotated[float, Field(ge=0)] if key in MAY_BE_ZERO else Annotated[float, Field(gt=0)]
        )
    return Annotated[Vector, Field(strict=False)] if hint == Vector else hint


def read_table(base: type[BaseModel], data: Any, read: Callable[[Any], BaseModel]) -> BaseModel:
    """Return the table of a vehicle, from a file or from the catalogue with its keywords.

    Parameters
    ----------
    base : type
        Schema of the common keys.
    data : Any
        Contents of the table.
    read : callable
        Validator of the common keys.

    Raises
    ------
    ValidationError
        If the table is invalid. It contains all errors; those about unknown keys list the known
        keys.
    """
    if not isinstance(data, dict) or not set(base.model_fields) <= set(OWN):
        return read(data)
    if ("catalog" in data) == ("file" in data):
        place, found = ("file", "catalog and file") if "file" in data else (None, "none")
        wrong = fault(place, "exactly one of catalog, file", found)
        raise ValidationError.from_exception_data(base.__name__, [wrong])
    catalog = data.get("catalog")
    if catalog not in tuple(CATALOG):
        return read(data)
    try:
        return table_of(base, catalog).model_validate(data)
    except ValidationError as error:
        keys = list(inspect.signature(CATALOG[catalog]).parameters)
        known = ["catalog", *keys, "actuated", *(["name"] if "name" in base.model_fields else [])]
        faults = [reworded(dict(each), known) for each in error.errors(include_url=False)]
        raise ValidationError.from_exception_data(base.__name__, faults) from error


def reworded(error: dict[str, Any], known: list[str]) -> InitErrorDetails:
    """Return a pydantic error as one that states the expected and the found value.

    For an unknown key, the expected value is the list of ``known`` keys.
    """
    if error["type"] == "extra_forbidden":
        name = str(error["loc"][-1])
        expected, found = f"one of {', '.join(known)}", f"the unknown key {name!r}"
        details = fault(name, expected, found, similar_hint(name, known))
    elif error["type"] == "missing":
        expected = "a number" if isinstance(error["loc"][-1], int) else "a value"
        details = fault(None, expected, "none")
    elif error["type"] == "expected":
        context = error.get("ctx", {}) | {"words": error["msg"]}
        kind = PydanticCustomError("expected", "{words}", context)
        details = InitErrorDetails(type=kind, loc=(), input=error["input"])
    else:
        details = InitErrorDetails(type=error["type"], loc=(), input=error["input"])
        if "ctx" in error:
            details["ctx"] = error["ctx"]
    details["loc"] = error["loc"]
    return details
