"""Features of synthetic grounds: tables of a problem file, below ``[terrain.synthetic]``.

A feature is a record with the method `added`, and an entry of `FEATURES`.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from slipfree.files.toml.types import Count, NonNegative, Pair, Positive, Record
from slipfree.terrain import synthetic
from slipfree.terrain.base import Grid

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
