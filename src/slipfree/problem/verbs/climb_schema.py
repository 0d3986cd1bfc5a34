"""Schema of climbs: tables of a problem file with ``verb = "climb"``."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field

from slipfree.control import sensor_noise, step_climbing
from slipfree.files.toml.source import Place as KeyPath
from slipfree.files.toml.types import NonNegative, Pair, Positive, Record
from slipfree.problem.law_record import law_record
from slipfree.problem.schema import TOLERANCE, VERB, Runnable, Solver
from slipfree.problem.schema_solids import Shapes
from slipfree.solve.options import MAX_TOLERANCE, MIN_TOLERANCE, Method
from slipfree.vehicle import climber as vehicle


class Solid(Record):
    """A convex polygon of the ground."""

    points: Annotated[tuple[Pair, ...], Field(strict=False)] = Field(
        description="corners x and z, in order [m]"
    )


class Profile(Shapes):
    """The ground of a climb: a floor with one obstacle, or polygons, given here or in a file."""

    solids: Annotated[tuple[Solid, ...], Field(strict=False)] | None = Field(
        default=None, description="convex polygons"
    )
    file: str | None = Field(
        default=None, description="a CSV file with the corners of convex polygons"
    )


class ClimberBody(Record):
    """A body of a climbing vehicle; the defaults are the catalogue's."""

    mass: Positive | None = Field(default=None, description="mass, wheels included [kg]")
    ahead: float | None = Field(default=None, description="centre of mass ahead of the joint [m]")
    above: float | None = Field(default=None, description="centre of mass above the joint [m]")
    inertia: Positive | None = Field(
        default=None,
        description="moment of inertia about the centre of mass, without wheel rotation [kg m2]",
    )


class ClimberAxle(Record):
    """An axle of a climbing vehicle; the defaults are the catalogue's."""

    ahead: float | None = Field(
        default=None, description="distance ahead of the joint, along the body [m]"
    )
    wheels: Annotated[int, Field(ge=1, le=100)] | None = Field(
        default=None, description="number of wheels, with one motor each"
    )
    inertia: Positive | None = Field(
        default=None,
        description="moment of inertia of all wheels and rotors about the axle [kg m2]",
    )


class Climber(Record):
    """A climbing vehicle of the catalogue, and its dimensions."""

    catalog: Literal["seven_wheels"] = Field(description="name in the catalogue")
    joint: float = Field(
        default=0.0, description="distance of the joint ahead of the middle axle [m]"
    )
    torque: Positive = Field(default=inf, description="largest torque of a wheel's motor [N m]")
    radius: Positive | None = Field(
        default=None, description="radius of all wheels; default: the catalogue's [m]"
    )
    rear_body: ClimberBody = Field(default=ClimberBody(), description="the body with two axles")
    front_body: ClimberBody = Field(default=ClimberBody(), description="the body with one axle")
    rear: ClimberAxle = Field(default=ClimberAxle(), description="the last axle")
    middle: ClimberAxle = Field(default=ClimberAxle(), description="the axle near the joint")
    front: ClimberAxle = Field(default=ClimberAxle(), description="the first axle")


class Friction(Record):
    """Static and kinetic coefficients of friction of a climb."""

    static: Positive = Field(description="static coefficient [1]")
    kinetic: Positive = Field(description="kinetic coefficient [1]")


class Compliance(Record):
    """Numbers of the law `slipfree.laws.compliant.Compliant` and of its static depth."""

    stiffness: Positive = Field(
        default=vehicle.Climber.stiffness, description="stiffness of a contact [N/m]"
    )
    damping: NonNegative = Field(
        default=10.0, description="damping of Hunt and Crossley: share of the force per speed [s/m]"
    )
    creep: Positive = Field(
        default=5e-4, description="slip speed at which friction is almost fully developed [m/s]"
    )
    stribeck: Positive = Field(
        default=0.01,
        description="slip speed over which friction decreases from static to kinetic [m/s]",
    )


if TYPE_CHECKING:
    Noise = Record
else:
    Noise = law_record(sensor_noise.Noise)


class ControlKeys(Record):
    """Keys of the control of the wheels that are not parameters of the controller."""

    speed: Positive = Field(description="speed of the vehicle [m/s]")
    period: Positive | None = Field(
        default=None,
        description="sample time of the controller; by default the control is continuous [s]",
    )
    noise: Noise | None = Field(
        default=None, description="noise of the sensors; without this table, exact measurements"
    )


if TYPE_CHECKING:
    Control = ControlKeys
else:
    Control = law_record(step_climbing.Control, ControlKeys)


class Approach(Record):
    """Start of a climb: distance of the front wheels from the obstacle, and speed."""

    distance: float = Field(description="distance of the front wheels from the obstacle [m]")
    speed: NonNegative | None = Field(
        default=None, description="speed at the start; default: that of the control [m/s]"
    )


class Legs(Record):
    """Specification of the plan of a climb; a leg is the climb of one axle."""

    cost: Literal["time", "friction", "slip"] = Field(
        default="time", description="objective: duration, required friction, or slip"
    )
    nodes: Annotated[int, Field(ge=20, le=5000)] = Field(
        default=60, description="number of nodes per leg"
    )
    friction: Positive | None = Field(
        default=None, description="coefficient of friction; default: the static one [1]"
    )
    speed: Positive | None = Field(
        default=None, description="largest speed of an axle; default: that of the control [m/s]"
    )


class Stiff(Solver):
    """Options of the integrator for climbs, whose equations are stiff."""

    tolerance: Annotated[float, Field(ge=MIN_TOLERANCE, le=MAX_TOLERANCE)] = Field(
        default=1e-6, description=TOLERANCE
    )
    method: Method | None = Field(default=None, description="the integrator")


class Climb(Runnable):
    """A climb of a vehicle with two bodies over an obstacle, with controlled wheels."""

    verb: Literal["climb"] = Field(description=VERB)
    solver: Stiff = Field(default=Stiff(), description="options of the integrator")
    profile: Profile = Field(description="the ground in the plane")
    vehicle: Climber = Field(description="the vehicle")
    friction: Friction = Field(description="coefficients of friction between wheels and ground")
    contact: Compliance = Field(default=Compliance(), description="compliance of the contacts")
    control: Control = Field(description="control of the wheels")
    start: Approach = Field(description="start of the climb")
    plan: Legs | None = Field(
        default=None, description="specification of a plan; without it the climb is not planned"
    )

    alternatives: ClassVar[Mapping[KeyPath, tuple[str, ...]]] = {
        ("profile",): ("ramp", "step", "kerb", "stairs", "solids", "file")
    }
