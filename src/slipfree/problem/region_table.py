"""Tables of regions of the ground: discs and polygons."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from slipfree.core.errors import ModelError
from slipfree.files.toml.types import Pair, Positive, Record
from slipfree.geometry.regions import Region


class RegionTable(Record):
    """A region of the ground: a disc or a polygon."""

    x: float | None = Field(default=None, description="coordinate of the centre of a disc [m]")
    y: float | None = Field(default=None, description="coordinate of the centre of a disc [m]")
    radius: Positive | None = Field(default=None, description="radius of a disc [m]")
    points: Annotated[tuple[Pair, ...], Field(strict=False)] | None = Field(
        default=None, description="corners of a polygon [m]"
    )


def region_of(table: RegionTable) -> Region:
    """Return the region of a table.

    Raises
    ------
    ModelError
        If the region is neither a disc nor a valid polygon.
    """
    disc = (table.x, table.y, table.radius)
    if table.points is not None and disc == (None, None, None):
        return Region.polygon(table.points)
    if table.points is None and None not in disc:
        return Region.disc(*(float(value or 0.0) for value in disc))
    keys = ("x", "y", "radius", "points")
    given = [repr(key) for key in keys if getattr(table, key) is not None]
    raise ModelError(
        "expected either 'x', 'y' and 'radius' (a disc), or 'points' (a polygon), found "
        f"{', '.join(given) or 'none'}; add the missing keys or remove the others"
    )
