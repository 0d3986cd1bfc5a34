"""Schemas of domain dataclasses: laws, soils, and vehicles of the catalogue."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, cast

from pydantic import (
    BaseModel,
    Field,
    ModelWrapValidatorHandler,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from slipfree import catalog
from slipfree.core.schema import keys_of
from slipfree.files.toml.source import record_at, similar_hint
from slipfree.files.toml.types import Positive, Record, given_values, one_of, record_of
from slipfree.laws.registry import CONTACT_LAWS, GROUND_LAWS, SLIP_LAWS
from slipfree.laws.soil import Soil
from slipfree.laws.soil_regions import OF_THE_LAW, SoilRegion
from slipfree.laws.soils import SOILS, known_soil
from slipfree.problem.schema_ground import RegionTable, region_of
from slipfree.vehicle.tree import Vehicle

CATALOG: dict[str, Callable[..., Vehicle]] = {
    name: getattr(catalog, name) for name in catalog.__all__
}
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
        table: BaseModel = record_of(CATALOG[catalog], base).model_validate(data)
    except ValidationError as error:
        keys = [key.name for key in keys_of(CATALOG[catalog])]
        known = ["catalog", *keys, "actuated", *(["name"] if "name" in base.model_fields else [])]
        faults = [reworded(dict(each), known) for each in error.errors(include_url=False)]
        raise ValidationError.from_exception_data(base.__name__, faults) from error
    return table


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


class SoilKeys(Record):
    """Name of a soil, and constants that replace those of this soil."""

    name: Annotated[str, one_of(SOILS)] = Field(
        default=DEFAULT, description=f"soil of the catalogue: one of {', '.join(SOILS)}"
    )


class SoilRegionKeys(SoilKeys, RegionTable):
    """A region with another soil: a disc or a polygon."""

    width: Positive = Field(
        description="width in which the soil around the region becomes its soil [m]"
    )


OF_REGIONS = (*RegionTable.model_fields, "width")  # keys of a region that are not of its soil
NamedSoil: Any = record_of(Soil, SoilKeys)


SoilRegions: Any = Annotated[
    tuple[record_of(Soil, SoilRegionKeys, omitted=OF_THE_LAW), ...],  # type: ignore[misc]
    Field(strict=False),
]


class SoilTable(NamedSoil):  # type: ignore[misc]
    """Table ``[law.soil]``: a soil, and regions of other soils."""

    regions: SoilRegions = Field(
        default=(), description="regions of other soils; later ones cover earlier ones"
    )


def soil_of(
    *, name: str = DEFAULT, regions: tuple[RegionTable, ...] = (), **constants: float
) -> Soil:
    """Return the soil of a table.

    ModelError is raised if a constant is not valid, or a region is neither a disc nor a valid
    polygon.

    Parameters
    ----------
    name : str
        Name in the catalogue.
    regions : tuple of RegionTable
        Records of the regions.
    **constants : float
        Constants that replace those of the catalogue.
    """
    return replace(known_soil(name), regions=tuple(map(_region, regions)), **constants)


def _region(table: Any) -> SoilRegion:
    """Return the region of a table with its soil."""
    given = given_values(table)
    soil = soil_of(**{key: value for key, value in given.items() if key not in OF_REGIONS})
    return SoilRegion(region_of(table), soil, table.width)


def registered_laws() -> dict[str, Any]:
    """Return the laws that have parameters, by name."""
    laws: dict[str, Any] = {**SLIP_LAWS, **GROUND_LAWS, **CONTACT_LAWS}
    return {name: law for name, law in laws.items() if fields(law)}


def table_of(law: type) -> type[Record]:
    """Return the record of the table of a law; that of soil also has names and regions."""
    return SoilTable if law is Soil else record_of(law)


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
