"""Schemas of domain dataclasses: laws, soils, and vehicles of the catalogue."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Annotated, Any, cast

from pydantic import (
    Field,
    create_model,
)

from slipfree import catalog
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


DEFAULT = next(iter(SOILS))
OF_REGIONS = (*RegionTable.model_fields, "width")  # keys of a region that are not of its soil


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


NamedSoil: Any = record_of(Soil, SoilKeys)


REGION = SoilRegionKeys.__doc__ or ""
SoilRegions: Any = Annotated[
    tuple[record_of(Soil, SoilRegionKeys, omitted=OF_THE_LAW, meaning=REGION), ...],  # type: ignore[misc]
    Field(strict=False),
]


class SoilTable(NamedSoil):  # type: ignore[misc]
    """Loose soil under rigid wheels, for dynamics and quasi-statics."""

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

    @classmethod
    def schema_for(cls, data: Any) -> type[Record]:
        """Return the record of all registered laws; they may be added after the import."""
        return law_tables() if cls is Law and isinstance(data, dict) else cls

    def parameters(self, name: str) -> dict[str, Any]:
        """Return the parameters that a problem gives for a law, by name."""
        table = getattr(self, name, None)
        return {} if table is None else given_values(table)


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
