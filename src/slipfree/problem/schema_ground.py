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

SEED = "seed of the random numbers"


class PowerLaw(Record):
    """Self-affine roughness, whose spectrum is a power of the wave number."""

    rms: Positive = Field(description="root mean square of the added heights [m]")
    hurst: Annotated[float, Field(gt=0, le=1)] = Field(
        description="Hurst exponent: 0.5 is jagged, 1 is smooth [1]"
    )
    longest: Positive = Field(description="longest wavelength [m]")
    shortest: Positive = Field(description="shortest wavelength, at least twice the spacing [m]")
    seed: Count = Field(description=SEED)


class Craters(Record):
    """Craters scattered over the ground."""

    count: Count = Field(description="number; a larger number adds to those of a smaller one")
    diameters: Pair = Field(description="smallest and largest, from crest to crest [m]")
    seed: Count = Field(description=SEED)


class Rocks(Record):
    """Rocks scattered over the ground."""

    count: Count = Field(description="number; a larger number adds to those of a smaller one")
    diameters: Pair = Field(description="smallest and largest [m]")
    height_ratio: Positive = Field(description="height over diameter [1]")
    seed: Count = Field(description=SEED)


class Ramp(Record):
    """A ramp along y."""

    start: float = Field(description="y where it begins [m]")
    end: float = Field(description="y where it ends [m]")
    rise: float = Field(description="height behind the ramp [m]")
    smooth: bool = Field(
        default=True,
        description="whether the slope is continuous, at most 15/8 of its mean; otherwise constant",
    )
    rounding: NonNegative = Field(
        default=0.0, description="length of the rounding of each edge of a constant slope [m]"
    )


class Synthetic(Record):
    """A synthetic ground: a level grid with additions in the order of these keys."""

    x: Pair = Field(description="first and last node [m]")
    y: Pair = Field(description="first and last node [m]")
    spacing: Positive = Field(description="distance between nodes [m]")
    base: float = Field(default=0.0, description="height of the level grid [m]")
    ramp: Ramp | None = Field(default=None, description="a ramp along y")
    power_law: PowerLaw | None = Field(default=None, description="roughness")
    craters: Craters | None = Field(default=None, description="random craters")
    rocks: Rocks | None = Field(default=None, description="random rocks")
    placed_rocks: Annotated[tuple[Rock, ...], Field(strict=False)] = Field(
        default=(), description="rocks at given positions [m]"
    )


class ElevationError(Record):
    """A random error of the heights of a map."""

    rms: Positive = Field(description="standard deviation [m]")
    correlation: Positive = Field(
        description="distance at which the correlation has fallen to 1/e [m]"
    )
    seed: Count = Field(description=SEED)


class Terrain(Record):
    """The ground: a file, matplotlib's sample, or a synthetic one; and its friction."""

    file: str | None = Field(default=None, description="the map file, relative to the problem file")
    sample: Literal["jacksboro"] | None = Field(
        default=None, description="the sample map of matplotlib"
    )
    synthetic: Synthetic | None = Field(default=None, description="a synthetic ground")
    cell: Positive | None = Field(
        default=None, description="width of a cell, for pictures without coordinates [m]"
    )
    registration: Literal["area", "point"] | None = Field(
        default=None,
        description="position of the values of such a picture: centres of cells, or nodes",
    )
    spacing: Positive | None = Field(
        default=None, description="distance between nodes, for scattered points [m]"
    )
    geographic: Literal["local"] | None = Field(
        default=None, description="converts degrees to metres; without it degrees are an error"
    )
    fill: Literal["linear"] | None = Field(
        default=None,
        description="fills holes from surrounding heights; without it holes are an error",
    )
    scale: Positive = Field(default=1.0, description="factor on x, y and heights [1]")
    horizontal_scale: Positive = Field(default=1.0, description="further factor on x and y [1]")
    vertical_scale: Positive = Field(default=1.0, description="further factor on heights [1]")
    window: Window | None = Field(
        default=None, description="part that is used, in coordinates of the scaled ground [m]"
    )
    smooth: Positive | None = Field(
        default=None, description="standard deviation of a Gaussian average of the heights [m]"
    )
    error: ElevationError | None = Field(default=None, description="a random error of the heights")
    rolled: Positive | None = Field(
        default=None, description="radius of the largest wheel, for which hollows are filled [m]"
    )
    friction: Annotated[float | str | None, PlainValidator(coefficient)] = Field(
        default=None, description="coefficient of friction, or the name of a map of it [1]"
    )
