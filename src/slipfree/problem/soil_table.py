"""Tables of soils: a name of the catalogue, constants that replace its own, regions."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Annotated, Any

from pydantic import AfterValidator, Field, create_model
from pydantic_core import PydanticCustomError

from slipfree.files.toml.types import Positive, Record
from slipfree.laws.soil import Soil
from slipfree.laws.soil_regions import OF_THE_LAW, SoilRegion
from slipfree.laws.soils import SOILS, known_soil
from slipfree.problem.law_record import given_values, law_record
from slipfree.problem.region_table import RegionTable, region_of

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
