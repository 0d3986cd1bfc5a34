"""Schema of the ground of a problem: the table ``[terrain]`` and its subtables."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, PlainValidator

from slipfree.files.toml.types import (
    Count,
    NonNegative,
    Pair,
    Positive,
    Record,
    Rock,
    Window,
    coefficient,
)

SEED = "of the random numbers"


class PowerLaw(Record):
    """Roughness that falls with the wave number by a power, added to the ground."""

    rms: Positive = Field(description="root mean square of the added heights [m]")
    hurst: Annotated[float, Field(gt=0, le=1)] = Field(
        description="Hurst exponent: 0.5 is jagged, 1 is smooth [1]"
    )
    longest: Positive = Field(description="longest wavelength [m]")
    shortest: Positive = Field(description="shortest wavelength, at least twice the spacing [m]")
    seed: Count = Field(description=SEED)


class Craters(Record):
    """Craters scattered over the ground."""

    count: Count = Field(description="how many; more keep those of fewer")
    diameters: Pair = Field(description="smallest and largest, from crest to crest [m]")
    seed: Count = Field(description=SEED)


class Rocks(Record):
    """Rocks scattered over the ground."""

    count: Count = Field(description="how many; more keep those of fewer")
    diameters: Pair = Field(description="smallest and largest [m]")
    height_ratio: Positive = Field(description="height over diameter [1]")
    seed: Count = Field(description=SEED)


class Ramp(Record):
    """A ramp along y."""

    start: float = Field(description="y where it begins [m]")
    end: float = Field(description="y where it ends [m]")
    rise: float = Field(description="height beyond it [m]")
    smooth: bool = Field(
        default=True,
        description="slope without jumps, 15/8 of the mean at most; else an even slope",
    )
    rounding: NonNegative = Field(
        default=0.0, description="length over which either edge of an even slope is round [m]"
    )


class Synthetic(Record):
    """A made ground: a level grid, and what is added to it in the order of these keys."""

    x: Pair = Field(description="first and last node [m]")
    y: Pair = Field(description="first and last node [m]")
    spacing: Positive = Field(description="between nodes [m]")
    base: float = Field(default=0.0, description="height before anything is added [m]")
    ramp: Ramp | None = Field(default=None, description="a ramp along y")
    power_law: PowerLaw | None = Field(default=None, description="roughness")
    craters: Craters | None = Field(default=None, description="craters, scattered")
    rocks: Rocks | None = Field(default=None, description="rocks, scattered")
    placed_rocks: Annotated[tuple[Rock, ...], Field(strict=False)] = Field(
        default=(), description="rocks at places [m]"
    )


class ElevationError(Record):
    """A random error of the heights of a map."""

    rms: Positive = Field(description="standard deviation [m]")
    correlation: Positive = Field(
        description="distance at which the correlation has fallen to 1/e [m]"
    )
    seed: Count = Field(description=SEED)


class Terrain(Record):
    """The ground: a file, the sample that matplotlib ships, or a made one; and its friction."""

    file: str | None = Field(default=None, description="the map, beside the problem file")
    sample: Literal["jacksboro"] | None = Field(
        default=None, description="the map that matplotlib ships"
    )
    synthetic: Synthetic | None = Field(default=None, description="a made ground")
    cell: Positive | None = Field(
        default=None, description="width of a cell of a picture that does not say it [m]"
    )
    registration: Literal["area", "point"] | None = Field(
        default=None,
        description="of such a picture: values belong to the middles of cells, or to nodes",
    )
    spacing: Positive | None = Field(
        default=None, description="between nodes, for scattered points [m]"
    )
    geographic: Literal["local"] | None = Field(
        default=None, description="makes metres of degrees; without it degrees are refused"
    )
    fill: Literal["linear"] | None = Field(
        default=None,
        description="fills holes from the heights around; without it holes are refused",
    )
    scale: Positive = Field(default=1.0, description="multiplies x, y and heights [1]")
    horizontal_scale: Positive = Field(default=1.0, description="multiplies x and y besides [1]")
    vertical_scale: Positive = Field(default=1.0, description="multiplies heights besides [1]")
    window: Window | None = Field(
        default=None, description="part that is used, in coordinates of the scaled ground [m]"
    )
    smooth: Positive | None = Field(
        default=None, description="standard deviation of a Gaussian average of the heights [m]"
    )
    error: ElevationError | None = Field(default=None, description="a random error of the heights")
    rolled: Positive | None = Field(
        default=None, description="radius of the wheel as which the ground is felt, the largest [m]"
    )
    friction: Annotated[float | str | None, PlainValidator(coefficient)] = Field(
        default=None, description="coefficient of friction, or the name of a map of it [1]"
    )
