"""Schemas of domain dataclasses: laws, soils, and vehicles of the catalogue."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import MISSING, dataclass, fields, replace
from functools import cache
from typing import Annotated, Any, cast, get_origin, get_type_hints

from annotated_types import DocInfo, Unit
from pydantic import (
    AfterValidator,
    BaseModel,
    Field,
    ModelWrapValidatorHandler,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from slipfree import catalog
from slipfree.files.toml.source import record_at, similar_hint
from slipfree.files.toml.types import (
    IN_RADIANS,
    IN_RADIANS_PER_SECOND,
    Positive,
    Record,
    in_radians,
)
from slipfree.geometry.frame import Vector
from slipfree.laws.registry import CONTACT_LAWS, GROUND_LAWS, SLIP_LAWS
from slipfree.laws.soil import Soil
from slipfree.laws.soil_regions import OF_THE_LAW, SoilRegion
from slipfree.laws.soils import SOILS, known_soil
from slipfree.problem.schema_ground import RegionTable, region_of
from slipfree.vehicle.tree import Vehicle

ANGULAR = {"rad": IN_RADIANS, "rad/s": IN_RADIANS_PER_SECOND}


@cache
def law_record(law: type, base: type[Record] = Record) -> type[Record]:
    """Return the record of a law's parameters, from the annotated fields of its dataclass.

    Keys of ``base`` come first.
    """
    hints = get_type_hints(law, include_extras=True)
    keys: dict[str, Any] = {
        each.name: (
            _with_unit(hints[each.name]),
            Field(
                default=... if each.default is MISSING else each.default,
                description=_description(hints[each.name]),
            ),
        )
        for each in fields(law)
        if hasattr(hints[each.name], "__metadata__")
    }
    words = (law.__doc__ or "").partition("\n")[0]
    return create_model(law.__name__, __base__=base, __doc__=words, **keys)


def _with_unit(hint: Any) -> Any:
    """Return the annotation of a parameter; angles accept "30 deg" as well, and tuples arrays."""
    if get_origin(getattr(hint, "__origin__", None)) is tuple:
        return Annotated[hint, Field(strict=False)]
    for each in getattr(hint, "__metadata__", ()):
        if isinstance(each, Unit) and each.unit in ANGULAR:
            return Annotated[hint, ANGULAR[each.unit]]
    return hint


def _description(hint: Any) -> str:
    """Return the description and unit in the annotation of a parameter."""
    metadata = getattr(hint, "__metadata__", ())
    words = [each.documentation for each in metadata if isinstance(each, DocInfo)]
    return " ".join([*words, *(f"[{each.unit}]" for each in metadata if isinstance(each, Unit))])


def given_values(table: Record) -> dict[str, Any]:
    """Return the values that a file gives for the keys of a table, without defaults."""
    return {name: getattr(table, name) for name in table.model_fields_set}


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
def catalog_record(base: type[BaseModel], catalog: str) -> type[BaseModel]:
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
        return catalog_record(base, catalog).model_validate(data)
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


DEFAULT = next(iter(SOILS))
OF_REGIONS = (*RegionTable.model_fields, "width")  # keys of a region that are not of its soil


def _known(name: str) -> str:
    """Return the name of a soil unchanged; raise PydanticCustomError if it is unknown."""
    if name not in SOILS:
        raise PydanticCustomError("expected", "one of {names}", {"names": ", ".join(SOILS)})
    return name


SoilName = Annotated[str, AfterValidator(_known)]
NAME: Any = (
    SoilName,
    Field(default=DEFAULT, description=f"soil of the catalogue: one of {', '.join(SOILS)}"),
)


@cache
def named_soil() -> type[Record]:
    """Return the record of a soil: its name, and constants that replace those of this soil."""
    words = "Name of a soil, and constants that replace those of this soil."
    return create_model("NamedSoil", __base__=law_record(Soil), __doc__=words, name=NAME)


@cache
def _soil_region() -> type[Record]:
    """Return the record of a region: its border, the width of its transition, its soil."""
    constants: dict[str, Any] = {
        key: (Annotated[field.annotation, *field.metadata], field)
        for key, field in law_record(Soil).model_fields.items()
        if key not in OF_THE_LAW
    }
    width: Any = (
        Positive,
        Field(description="width in which the soil around the region becomes its soil [m]"),
    )
    words = "A region with another soil: a disc or a polygon."
    return create_model(
        "SoilRegion", __base__=RegionTable, __doc__=words, name=NAME, width=width, **constants
    )


@cache
def soil_table() -> type[Record]:
    """Return the record of the table ``[law.soil]``: a soil, and regions of other soils."""
    regions: Any = (
        Annotated[tuple[_soil_region(), ...], Field(strict=False)],  # type: ignore[misc]
        Field(default=(), description="regions of other soils; later ones cover earlier ones"),
    )
    words = (Soil.__doc__ or "").partition("\n")[0]
    return create_model("SoilTable", __base__=named_soil(), __doc__=words, regions=regions)


def soil_of(
    *, name: str = DEFAULT, regions: tuple[RegionTable, ...] = (), **constants: float
) -> Soil:
    """Return the soil of a table.

    Parameters
    ----------
    name : str
        Name in the catalogue.
    regions : tuple of RegionTable
        Records of the regions.
    **constants : float
        Constants that replace those of the catalogue.

    Raises
    ------
    ModelError
        If a constant is not valid, or a region is neither a disc nor a valid polygon.
    """
    return replace(known_soil(name), regions=tuple(map(_region, regions)), **constants)


def _region(table: Any) -> SoilRegion:
    """Return the region of a table with its soil."""
    given = given_values(table)
    soil = soil_of(**{key: value for key, value in given.items() if key not in OF_REGIONS})
    return SoilRegion(region_of(table), soil, table.width)


def known_slip(name: str) -> str:
    """Return the name of a slip law unchanged; raise PydanticCustomError if it is unknown."""
    if name not in SLIP_LAWS:
        raise PydanticCustomError("expected", "one of {names}", {"names": ", ".join(SLIP_LAWS)})
    return name


def registered_laws() -> dict[str, Any]:
    """Return the laws that have parameters, by name."""
    laws: dict[str, Any] = {**SLIP_LAWS, **GROUND_LAWS, **CONTACT_LAWS}
    return {name: law for name, law in laws.items() if fields(law)}


def table_of(law: type) -> type[Record]:
    """Return the record of the table of a law; that of soil also has names and regions."""
    return soil_table() if law is Soil else law_record(law)


class Law(Record):
    """Parameters of a law, in a table of its name."""

    @model_validator(mode="wrap")
    @classmethod
    def _by_name(cls, data: Any, handler: ModelWrapValidatorHandler[Law]) -> Law:
        """Validate each table by the schema of its law; raise ValidationError with all errors."""
        if cls is not Law or not isinstance(data, dict):
            return handler(data)
        try:
            return law_tables().model_validate(data)
        except ValidationError as error:
            errors = [dict(each) for each in error.errors(include_url=False)]
            raise ValidationError.from_exception_data(
                cls.__name__, [reworded(each, _known_keys(each)) for each in errors]
            ) from error

    def parameters(self, name: str) -> dict[str, Any]:
        """Return the parameters that a problem gives for a law, by name."""
        table = getattr(self, name, None)
        return {} if table is None else given_values(table)


def _known_keys(error: dict[str, Any]) -> list[str]:
    """Return the keys of the table in which an error of pydantic found an unknown key."""
    if error["type"] != "extra_forbidden":
        return []
    return list(record_at(law_tables(), error["loc"][:-1]).model_fields)


def law_tables() -> type[Law]:
    """Return the record of the tables of all registered laws."""
    keys: dict[str, Any] = {
        name: (
            table_of(law) | None,
            Field(default=None, description=f"parameters of {name}"),
        )
        for name, law in registered_laws().items()
    }
    return cast("type[Law]", create_model("Laws", __base__=Law, __doc__=Law.__doc__, **keys))
