"""Regions of a ground with another soil."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, fields
from math import inf
from typing import Any, ClassVar, Protocol, TypeVar

import casadi as ca

from slipfree.core.errors import ModelError
from slipfree.geometry.regions import Region

OF_THE_LAW = (
    "grouser_height",
    "damping_ratio",
    "creep",
    "coupled_shear",
    "regions",
)  # not constants of the ground


class RegionalSoil(Protocol):
    """Dataclass of the constants of a soil, with regions of other soils."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def regions(self) -> tuple[SoilRegion, ...]:
        """Regions of other soils."""


S = TypeVar("S", bound=RegionalSoil)


@dataclass(frozen=True)
class SoilRegion:
    """A region of the ground with another soil.

    Across the border, the constants of the soils are blended: their weights change as the
    polynomial of degree five with two continuous derivatives at both ends.

    Attributes
    ----------
    region : Region
        The region, in map coordinates.
    soil : Soil
        Its soil. Grousers, damping ratio and creep are those of the law.
    width : float
        Width of the transition, half of it on each side of the border. [m]

    Raises
    ------
    ModelError
        If the width is not positive and finite, or the soil of the region has regions.
    """

    region: Region
    soil: RegionalSoil
    width: float

    def __post_init__(self) -> None:
        if not 0 < self.width < inf:
            raise ModelError(
                f"soil region: width: expected a finite positive width, found {self.width} m; give "
                "the width in which one soil becomes the other"
            )
        if self.soil.regions:
            raise ModelError(
                "soil region: expected a soil without regions, found one with regions; list all "
                "regions in one soil: later ones cover earlier ones"
            )

    def weight(self, x: ca.SX, y: ca.SX) -> ca.SX:
        """Return the weight of the region's soil at a point in map coordinates, 0 to 1 [1]."""
        s = ca.fmax(0, ca.fmin(0.5 - self.region.outside(x, y) / self.width, 1))
        return ca.SX(s**3 * (10 + s * (6 * s - 15)))


def soil_at(soil: S, x: ca.SX, y: ca.SX) -> S:
    """Return a soil with the constants at a map point, as expressions where regions blend them.

    Later regions cover earlier ones.
    """
    if not soil.regions:
        return soil
    names = [each.name for each in fields(soil) if each.name not in OF_THE_LAW]
    values = {name: getattr(soil, name) for name in names}
    for region in soil.regions:
        weight = region.weight(x, y)
        values = {k: v + weight * (getattr(region.soil, k) - v) for k, v in values.items()}
    here = copy(soil)  # without the check of constants, which are expressions now
    for name, value in ({"regions": ()} | values).items():
        object.__setattr__(here, name, value)
    return here
