"""Schema of the ground of a problem: the table ``[terrain]`` and its subtables."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, PlainValidator, create_model

from slipfree.files.toml.types import (
    Count,
    Pair,
    Positive,
    Record,
    Rock,
    Window,
    coefficient,
)
from slipfree.problem.ground_features import FEATURES, SEED, Feature
from slipfree.problem.schema_solids import Obstacle


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
