"""Schema of solids: obstacles on the ground, for dynamics."""

from __future__ import annotations

from math import inf, pi
from typing import Annotated

from pydantic import Field

from slipfree.files.toml.angles import IN_RADIANS, Angle
from slipfree.files.toml.types import Pair, Positive, Record


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
