"""Schema of the ground of a problem: the table ``[terrain]`` and its subtables.

A feature of synthetic grounds is a function with annotated parameters, and an entry of
`slipfree.terrain.synthetic.FEATURES`.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, PlainValidator, create_model

from slipfree.core.errors import ModelError
from slipfree.files.toml.types import (
    Angle,
    Count,
    Pair,
    Positive,
    Record,
    Rock,
    Window,
    coefficient,
    record_of,
)
from slipfree.geometry.regions import Region
from slipfree.terrain import solids
from slipfree.terrain.base import Grid
from slipfree.terrain.solids import Profile
from slipfree.terrain.synthetic import FEATURES

OBSTACLES: dict[str, tuple[Callable[..., Profile], str]] = {  # and their descriptions
    "ramp": (solids.ramp, "a ramp up to a plateau, which begins at x = 0"),
    "step": (solids.step, "a vertical step at x = 0 up to a plateau"),
    "kerb": (solids.kerb, "a rectangular block, which begins at x = 0"),
    "stairs": (solids.stairs, "stairs up to a plateau, which begin at x = 0"),
}
KINDS = (*OBSTACLES, "points")


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

    ModelError is raised if the region is neither a disc nor a valid polygon.
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


def _optional(kind: Callable[..., Any], meaning: str) -> Any:
    """Return the definition of an optional table with the parameters of a function."""
    record = record_of(kind, omitted=("grid",), meaning=f"{meaning[:1].upper()}{meaning[1:]}.")
    return record | None, Field(default=None, description=meaning)


if TYPE_CHECKING:
    Shapes = Record
else:
    Shapes = create_model(
        "Shapes",
        __base__=Record,
        __doc__="Obstacles of which a problem gives one.",
        **{name: _optional(*entry) for name, entry in OBSTACLES.items()},
    )


class Obstacle(Shapes):
    """An obstacle on the ground: a profile with vertical sides, at a position and heading."""

    points: Annotated[tuple[Pair, ...], Field(strict=False)] | None = Field(
        default=None,
        description="corners of a convex polygon: distance along the heading, and height [m]",
    )
    x: float = Field(default=0.0, description="x of the point where the profile begins [m]")
    y: float = Field(default=0.0, description="y of the point where the profile begins [m]")
    heading: Angle = Field(
        default=0.0,
        description="direction of the profile, counter-clockwise from the axis of frame [rad]",
    )
    half_width: Positive = Field(
        default=inf, description="half the width across the heading; infinite by default [m]"
    )


class MadeGround(Record):
    """A synthetic ground: a level grid, to which features are added in the order of these keys."""

    x: Pair = Field(description="x of the first and the last node [m]")
    y: Pair = Field(description="y of the first and the last node [m]")
    spacing: Positive = Field(description="distance between nodes [m]")
    base: float = Field(default=0.0, description="height of the level grid [m]")
    placed_rocks: Annotated[tuple[Rock, ...], Field(strict=False)] = Field(
        default=(), description="rocks at given positions, added last [m]"
    )

    def with_features(self, grid: Grid) -> Grid:
        """Return a grid with the features of the ground added, in order."""
        for name, add in FEATURES.items():
            table = getattr(self, name)
            if table is not None:
                grid = add(grid, **dict(table))
        return grid


def _description(feature: Callable[..., Grid]) -> str:
    """Return the noun of "Return the grid with ... added", the docstring of a feature."""
    summary = (feature.__doc__ or "").partition("\n")[0]
    return summary.removeprefix("Return the grid with ").replace(" added", "").rstrip(".")


if TYPE_CHECKING:
    Synthetic = MadeGround
else:
    Synthetic = create_model(
        "Synthetic",
        __base__=MadeGround,
        __doc__=MadeGround.__doc__,
        **{name: _optional(feature, _description(feature)) for name, feature in FEATURES.items()},
    )


class HeightErrors(Record):
    """Random errors of the heights of a map."""

    rms: Positive = Field(description="standard deviation [m]")
    correlation: Positive = Field(
        description="distance at which the correlation has fallen to 1/e [m]"
    )


class ElevationError(HeightErrors):
    """A random error of the heights of a map."""

    seed: Count = Field(description="seed of the random numbers")


class TerrainTable(Record):
    """Ground of a problem, from a map file, a sample map or a description, and its friction."""

    file: str | None = Field(default=None, description="map file, relative to the problem file")
    sample: Literal["jacksboro"] | None = Field(
        default=None, description="the sample map of matplotlib"
    )
    synthetic: Synthetic | None = Field(default=None, description="a synthetic ground")
    cell: Positive | None = Field(
        default=None, description="width of a cell, for pictures without coordinates [m]"
    )
    registration: Literal["area", "point"] | None = Field(
        default=None,
        description="'area': values of a picture are at cell centres; 'point': at nodes",
    )
    spacing: Positive | None = Field(
        default=None, description="distance between nodes, for scattered points [m]"
    )
    geographic: Literal["local"] | None = Field(
        default=None, description="conversion of degrees to metres; by default degrees are an error"
    )
    fill: Literal["linear"] | None = Field(
        default=None,
        description="interpolation of holes inside the map; wheels must not touch other holes",
    )
    scale: Positive = Field(default=1.0, description="factor of x, y and heights [1]")
    horizontal_scale: Positive = Field(default=1.0, description="further factor of x and y [1]")
    vertical_scale: Positive = Field(default=1.0, description="further factor of heights [1]")
    window: Window | None = Field(default=None, description="part of the scaled ground to use [m]")
    smooth: Positive | None = Field(
        default=None, description="standard deviation of a Gaussian filter of the heights [m]"
    )
    error: ElevationError | None = Field(default=None, description="a random error of the heights")
    rolled: Positive | None = Field(
        default=None,
        description="radius of the largest wheel; hollows that it cannot touch are filled [m]",
    )
    friction: Annotated[float | str | None, PlainValidator(coefficient)] = Field(
        default=None, description="coefficient of friction, or the name of a friction map [1]"
    )
    obstacles: Annotated[tuple[Obstacle, ...], Field(strict=False)] = Field(
        default=(), description="solids on the ground, for model = 'dynamics'"
    )
