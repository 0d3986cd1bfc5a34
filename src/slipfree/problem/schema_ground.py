"""Schema of the ground of a problem: the table ``[terrain]`` and its subtables.

A feature of synthetic grounds is a record with the method `added`, and an entry of `FEATURES`.
"""

from __future__ import annotations

from math import inf, pi
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, PlainValidator, create_model

from slipfree.core.errors import ModelError
from slipfree.files.toml.types import (
    IN_RADIANS,
    Angle,
    Count,
    NonNegative,
    Pair,
    Positive,
    Record,
    Rock,
    Window,
    coefficient,
)
from slipfree.geometry.regions import Region
from slipfree.terrain import synthetic
from slipfree.terrain.base import Grid


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


SEED = "seed of the random numbers"


class Feature(Record):
    """A feature of a synthetic ground."""

    def added(self, grid: Grid) -> Grid:
        """Return a ground with the feature added to its heights."""
        raise NotImplementedError


class Ramp(Feature):
    """A ramp along y."""

    start: float = Field(description="y at which the ramp begins [m]")
    end: float = Field(description="y at which the ramp ends [m]")
    rise: float = Field(description="height behind the ramp [m]")
    smooth: bool = Field(
        default=True,
        description="whether the slope is continuous, at most 15/8 of its mean; otherwise constant",
    )
    rounding: NonNegative = Field(
        default=0.0, description="length of the rounding of each edge of a constant slope [m]"
    )

    def added(self, grid: Grid) -> Grid:
        """Return a ground with the feature added."""
        return synthetic.ramp(grid, **dict(self))


class Ridge(Feature):
    """A Gaussian ridge, with its crest perpendicular to the y axis."""

    middle: float = Field(description="y of the crest [m]")
    height: float = Field(description="height of the crest; negative for a trench [m]")
    width: Positive = Field(description="distance from the crest to 1/e of its height [m]")

    def added(self, grid: Grid) -> Grid:
        """Return a ground with the feature added."""
        return synthetic.ridge(grid, **dict(self))


class PowerLaw(Feature):
    """Self-affine roughness, whose spectrum is a power of the wave number."""

    rms: Positive = Field(description="root mean square of the added heights [m]")
    hurst: Annotated[float, Field(gt=0, le=1)] = Field(
        description="Hurst exponent: 0.5 is jagged, 1 is smooth [1]"
    )
    longest: Positive = Field(description="longest wavelength [m]")
    shortest: Positive = Field(description="shortest wavelength, at least twice the spacing [m]")
    seed: Count = Field(description=SEED)

    def added(self, grid: Grid) -> Grid:
        """Return a ground with the feature added."""
        return synthetic.power_law(grid, **dict(self))


class Craters(Feature):
    """Craters scattered over the ground."""

    count: Count = Field(
        description="number of craters; a larger number adds craters to those of a smaller number"
    )
    diameters: Pair = Field(description="smallest and largest diameter of the rim crests [m]")
    seed: Count = Field(description=SEED)

    def added(self, grid: Grid) -> Grid:
        """Return a ground with the feature added."""
        return synthetic.craters(grid, **dict(self))


class Rocks(Feature):
    """Rocks scattered over the ground."""

    count: Count = Field(
        description="number of rocks; a larger number adds rocks to those of a smaller number"
    )
    diameters: Pair = Field(description="smallest and largest diameter of the rocks [m]")
    height_ratio: Positive = Field(description="height of a rock divided by its diameter [1]")
    seed: Count = Field(description=SEED)

    def added(self, grid: Grid) -> Grid:
        """Return a ground with the feature added."""
        return synthetic.rocks(grid, **dict(self))


FEATURES: dict[str, type[Feature]] = {  # in the order in which they are added
    "ramp": Ramp,
    "ridge": Ridge,
    "power_law": PowerLaw,
    "craters": Craters,
    "rocks": Rocks,
}


class Incline(Record):
    """A ramp up to a plateau; it begins at x = 0."""

    angle: Annotated[float, Field(gt=0, le=pi / 2), IN_RADIANS] = Field(
        description="angle of the ramp [rad]"
    )
    height: Positive = Field(description="height of the plateau [m]")


class Step(Record):
    """A vertical step at x = 0 up to a plateau."""

    height: Positive = Field(description="height of the plateau [m]")


class Kerb(Record):
    """A rectangular block; it begins at x = 0."""

    height: Positive = Field(description="height of the block [m]")
    length: Positive = Field(description="length of the block along x [m]")


class Stairs(Record):
    """Stairs up to a plateau; they begin at x = 0."""

    height: Positive = Field(description="height of a step [m]")
    depth: Positive = Field(description="depth of a step along x [m]")
    count: Annotated[int, Field(ge=1, le=1000)] = Field(description="number of steps")


class Shapes(Record):
    """Obstacles of which a problem gives one."""

    ramp: Incline | None = Field(default=None, description="a ramp up to a plateau")
    step: Step | None = Field(default=None, description="a step up to a plateau")
    kerb: Kerb | None = Field(default=None, description="a block")
    stairs: Stairs | None = Field(default=None, description="stairs up to a plateau")


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

    def features(self) -> list[Feature]:
        """Return the features to add to the level grid, in order."""
        found = (getattr(self, name) for name in FEATURES)
        return [each for each in found if each is not None]


def _description(feature: type[Feature]) -> str:
    """Return the description of a feature's key: the first line of its docstring."""
    words = (feature.__doc__ or "").partition("\n")[0].rstrip(".")
    return words[:1].lower() + words[1:]


if TYPE_CHECKING:
    Synthetic = MadeGround
else:
    Synthetic = create_model(
        "Synthetic",
        __base__=MadeGround,
        __doc__=MadeGround.__doc__,
        **{
            name: (feature | None, Field(default=None, description=_description(feature)))
            for name, feature in FEATURES.items()
        },
    )


class HeightErrors(Record):
    """Random errors of the heights of a map."""

    rms: Positive = Field(description="standard deviation [m]")
    correlation: Positive = Field(
        description="distance at which the correlation has fallen to 1/e [m]"
    )


class ElevationError(HeightErrors):
    """A random error of the heights of a map."""

    seed: Count = Field(description=SEED)


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
