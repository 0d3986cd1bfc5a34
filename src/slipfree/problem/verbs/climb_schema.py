"""Schema of climbs: tables of a problem file with ``verb = "climb"``."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf, pi
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from slipfree.climb.control import Directions
from slipfree.climb.reference import Law
from slipfree.files.toml.angles import IN_RADIANS
from slipfree.files.toml.source_lines import Place as KeyPath
from slipfree.files.toml.types import (
    Count,
    NonNegative,
    NonNegativeAngle,
    NonNegativeRate,
    Pair,
    Positive,
    Record,
)
from slipfree.problem.schema import TOLERANCE, VERB, Runnable, Solver
from slipfree.solve.options import MIN_TOLERANCE, Method


class Incline(Record):
    """A ramp up to a plateau, from x = 0 on."""

    angle: Annotated[float, Field(gt=0, le=pi / 2), IN_RADIANS] = Field(
        description="of the ramp [rad]"
    )
    height: Positive = Field(description="of the plateau [m]")


class Step(Record):
    """A plateau, from x = 0 on."""

    height: Positive = Field(description="of the plateau [m]")


class Kerb(Record):
    """A block, from x = 0 on."""

    height: Positive = Field(description="of the block [m]")
    length: Positive = Field(description="of the block, along x [m]")


class Stairs(Record):
    """Stairs, from x = 0 on, the last step a plateau."""

    height: Positive = Field(description="of a step [m]")
    depth: Positive = Field(description="of a step, along x [m]")
    count: Annotated[int, Field(ge=1)] = Field(description="how many steps")


class Solid(Record):
    """A convex polygon of the ground."""

    points: Annotated[tuple[Pair, ...], Field(strict=False)] = Field(
        description="corners x and z, in order [m]"
    )


class Profile(Record):
    """The ground of a climb: a floor with one obstacle, or solids, here or in a file."""

    ramp: Incline | None = Field(default=None, description="a ramp up to a plateau")
    step: Step | None = Field(default=None, description="a step up to a plateau")
    kerb: Kerb | None = Field(default=None, description="a block")
    stairs: Stairs | None = Field(default=None, description="stairs up to a plateau")
    solids: Annotated[tuple[Solid, ...], Field(strict=False)] | None = Field(
        default=None, description="convex polygons"
    )
    file: str | None = Field(default=None, description="a file of the corners of convex polygons")


class ClimberBody(Record):
    """A body of a vehicle that climbs; the defaults are the catalogue's."""

    mass: Positive | None = Field(default=None, description="with its wheels [kg]")
    ahead: float | None = Field(default=None, description="centre of mass ahead of the joint [m]")
    above: float | None = Field(default=None, description="centre of mass above the joint [m]")
    inertia: Positive | None = Field(
        default=None, description="about its centre of mass, its wheels' spin left out [kg m2]"
    )


class ClimberAxle(Record):
    """Wheels of a vehicle that climbs; the defaults are the catalogue's."""

    ahead: float | None = Field(default=None, description="ahead of the joint, along the body [m]")
    wheels: Annotated[int, Field(ge=1)] | None = Field(
        default=None, description="how many, a motor each"
    )
    inertia: Positive | None = Field(
        default=None, description="of all of them and their rotors, about the axle [kg m2]"
    )


class Climber(Record):
    """A vehicle that climbs, of the catalogue, and its dimensions."""

    catalog: Literal["seven_wheels"] = Field(description="name in the catalogue")
    joint: float = Field(default=0.0, description="of the bodies, ahead of the middle axle [m]")
    torque: Positive = Field(default=inf, description="largest of a wheel's motor [N m]")
    radius: Positive | None = Field(
        default=None, description="of all wheels; default: the catalogue's [m]"
    )
    rear_body: ClimberBody = Field(default=ClimberBody(), description="the body with two axles")
    front_body: ClimberBody = Field(default=ClimberBody(), description="the body with one axle")
    rear: ClimberAxle = Field(default=ClimberAxle(), description="the last axle")
    middle: ClimberAxle = Field(default=ClimberAxle(), description="the axle near the joint")
    front: ClimberAxle = Field(default=ClimberAxle(), description="the first axle")


class Friction(Record):
    """Coefficients of friction of a climb: at rest, and at speed."""

    static: Positive = Field(description="coefficient at rest [1]")
    kinetic: Positive = Field(description="coefficient at speed [1]")


class Compliance(Record):
    """How contacts give way; the defaults are those of `slipfree.climb.contact.Contact`."""

    stiffness: Positive | None = Field(default=None, description="of a contact [N/m]")
    damping: NonNegative | None = Field(
        default=None, description="of Hunt and Crossley: part of the force for each speed [s/m]"
    )
    creep: Positive | None = Field(
        default=None, description="slip speed at which friction is nearly full [m/s]"
    )
    stribeck: Positive | None = Field(
        default=None,
        description="slip speed over which friction falls from static to kinetic [m/s]",
    )


class Noise(Record):
    """Noise of a climb's sensors; the defaults are those of `slipfree.climb.noise.Noise`."""

    tilt: NonNegativeAngle | None = Field(
        default=None, description="root mean square, of the bodies' tilts [rad]"
    )
    tilt_rate: NonNegativeRate | None = Field(
        default=None, description="root mean square, of the tilts' rates [rad/s]"
    )
    wheel_rate: NonNegative | None = Field(
        default=None, description="root mean square, of the wheels' rates [rad/s]"
    )
    band: Positive | None = Field(default=None, description="largest frequency [Hz]")
    seed: Count | None = Field(default=None, description="of the random numbers")


class Control(Record):
    """How wheels are driven; the defaults are those of `slipfree.climb.control.Control`."""

    speed: Positive = Field(description="of the vehicle [m/s]")
    law: Law | None = Field(default=None, description="reference speeds of the axles")
    directions: Directions | None = Field(
        default=None,
        description="in which axles move: as sensors see them, or those of the contacts",
    )
    smoothing: Positive | None = Field(
        default=None, description="time constant of the sensors' low pass [s]"
    )
    share: NonNegative | None = Field(
        default=None, description="part of the contacts' directions that the law is told [1]"
    )
    cap: Annotated[float, Field(ge=1)] | None = Field(
        default=None, description="largest reference speed over the vehicle's [1]"
    )
    proportional: Positive | None = Field(default=None, description="gain on the error [N m s/rad]")
    integral: Positive | None = Field(default=None, description="gain on its integral [N m/rad]")
    derivative: NonNegative | None = Field(
        default=None, description="gain on its derivative [N m s2/rad]"
    )
    lag: Positive | None = Field(
        default=None, description="time constant of the filter behind the derivative [s]"
    )
    unwinding: NonNegative | None = Field(
        default=None, description="rate at which torque beyond the limit leaves the integral [1/s]"
    )
    period: Positive | None = Field(
        default=None,
        description="of a controller that samples; without it control is continuous [s]",
    )
    noise: Noise | None = Field(default=None, description="noise of the sensors; none by default")


class Approach(Record):
    """Where a climb begins: how far the front wheels are from the obstacle, and how fast."""

    distance: float = Field(description="of the front wheels from the obstacle [m]")
    speed: NonNegative | None = Field(
        default=None, description="at the start; default: that of the control [m/s]"
    )


class Legs(Record):
    """What a climb is planned for, leg by leg."""

    cost: Literal["time", "friction", "slip"] = Field(
        default="time", description="what is least: time, the coefficient needed, or creep"
    )
    nodes: Annotated[int, Field(ge=20)] = Field(default=60, description="of a leg")
    friction: Positive | None = Field(
        default=None, description="coefficient it may use; default: the static one [1]"
    )
    speed: Positive | None = Field(
        default=None, description="largest of an axle; default: that of the control [m/s]"
    )


class Stiff(Solver):
    """What is asked of the integrator of a stiff motion."""

    tolerance: Annotated[float, Field(ge=MIN_TOLERANCE, lt=1)] = Field(
        default=1e-6, description=TOLERANCE
    )
    method: Method | None = Field(default=None, description="which integrator")


class Climb(Runnable):
    """A vehicle of two bodies climbs an obstacle: the motion under control of its wheels."""

    verb: Literal["climb"] = Field(description=VERB)
    solver: Stiff = Field(default=Stiff(), description="what is asked of the integrator")
    profile: Profile = Field(description="the ground, in the plane")
    vehicle: Climber = Field(description="what climbs")
    friction: Friction = Field(description="between wheels and ground")
    contact: Compliance = Field(default=Compliance(), description="how contacts give way")
    control: Control = Field(description="how wheels are driven")
    start: Approach = Field(description="where it begins")
    plan: Legs | None = Field(
        default=None, description="what it is planned for; without it it is not"
    )

    alternatives: ClassVar[Mapping[KeyPath, tuple[str, ...]]] = {
        ("profile",): ("ramp", "step", "kerb", "stairs", "solids", "file")
    }
