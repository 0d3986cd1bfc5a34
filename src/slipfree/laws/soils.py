"""Published parameters of soils.

Each source gives the parameters of sinkage and strength, and the shear deformation modulus. All
other parameters have the defaults of `Soil`: angles of largest stress, exit depth and density.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import radians
from typing import NamedTuple

from slipfree.core.errors import ModelError, read_table
from slipfree.laws.soil import Soil


class KnownSoil(NamedTuple):
    """A soil and the publication of its parameters."""

    soil: Soil
    source: str


def _read_soils() -> Iterator[tuple[str, KnownSoil]]:
    for name, row in read_table(__file__, "soils.toml").items():
        source, shear = row.pop("source"), row.pop("shear", None)
        if shear is not None:
            row["friction_angle"] = radians(row.pop("degrees"))
            row |= {"shear_along": shear, "shear_along_rate": 0.0}
            row |= {"shear_across": shear, "shear_across_rate": 0.0}
        yield name, KnownSoil(Soil(**row), source)


SOILS = dict(_read_soils())


def known_soil(name: str) -> Soil:
    """Return a soil of the catalogue by name; ModelError if there is no soil of this name."""
    if name not in SOILS:
        raise ModelError(
            f"soil: expected one of {', '.join(SOILS)}, found {name!r}; choose one of them, or "
            "give the constants of Soil(...)"
        )
    return SOILS[name].soil
