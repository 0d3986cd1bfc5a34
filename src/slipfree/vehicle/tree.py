"""A vehicle as a tree of joints with wheels at its ends."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca

from slipfree.errors import ModelError
from slipfree.geometry.frame import Axis, Pose, Vector, check_vector, translation, turn, unit_vector
from slipfree.records import field_overview, overview
from slipfree.vehicle.formula import evaluate, names_in
from slipfree.vehicle.wheel import ORIGIN, Wheel

Kind = Literal["commanded", "passive", "suspension"]
GRAVITY = 9.81  # [m/s^2]


@dataclass(frozen=True)
class Body:
    """The mass of a part.

    Attributes
    ----------
    mass : float
        Zero for a part without one. [kg]
    at : tuple of 3 floats
        Centre of mass in the part's frame. [m]
    """

    mass: float = 0.0
    at: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __repr__(self) -> str:
        return field_overview(self)

    def __post_init__(self) -> None:
        if not 0 <= self.mass < math.inf:
            raise ModelError(f"body: mass must be zero or more kilograms, found {self.mass}")
        check_vector("body: its centre of mass", self.at)


@dataclass(frozen=True)
class Coordinate:
    """An angle or a length that one or more joints follow.

    Attributes
    ----------
    name : str
        Unique in the vehicle.
    kind : {"commanded", "passive", "suspension"}
        Its rate is an input; or follows from rolling; or its value follows from the ground.
    words : str
        One line that says what it is.
    lower, upper : float
        Stops. [rad or m]
    stiffness, rest : float
        Of a spring, and the value at which it is slack. [N m/rad or N/m; rad or m]
    damping : float
        Of a viscous damper. [N m s/rad or N s/m]
    bump : float
        Stiffness of the stops. Zero if they are rigid: then reaching one ends the motion, and what
        goes on from there is the vehicle with that joint locked (`actuated`). [N m/rad or N/m]
    max_rate : float
        Largest rate of its actuator, which steering laws respect. [rad/s or m/s]
    """

    name: str
    kind: Kind
    words: str
    lower: float = -math.inf
    upper: float = math.inf
    stiffness: float = 0.0
    rest: float = 0.0
    damping: float = 0.0
    bump: float = 0.0
    max_rate: float = math.inf

    def __repr__(self) -> str:
        return field_overview(self)

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise ModelError(
                f"coordinate {self.name}: stops must ascend, found {self.lower} to {self.upper}"
            )
        for key in ("stiffness", "damping", "bump"):
            value = getattr(self, key)
            if not 0 <= value < math.inf:
                raise ModelError(
                    f"coordinate {self.name}: {key} must be zero or more, found {value}"
                )
        if not self.max_rate > 0:
            raise ModelError(
                f"coordinate {self.name}: max_rate must be positive, found {self.max_rate}"
            )
        if self.bump and not (math.isfinite(self.lower) or math.isfinite(self.upper)):
            raise ModelError(f"coordinate {self.name}: bump needs a stop, found none")
        if not math.isfinite(self.rest):
            raise ModelError(f"coordinate {self.name}: rest must be finite, found {self.rest}")
        if self.kind == "commanded" and self.is_loaded:
            raise ModelError(
                f"coordinate {self.name}: its rate is commanded, so that it takes no spring, "
                "damper or elastic stop"
            )

    @property
    def is_loaded(self) -> bool:
        """Whether a spring, a damper or an elastic stop acts on it."""
        return any((self.stiffness, self.damping, self.bump))

    def potential(self, value: ca.SX) -> ca.SX:
        """Return the energy in its spring and its stops at a value. [J]."""
        energy = ca.SX(0.5 * self.stiffness * (value - self.rest) ** 2)
        for stop, outward in ((self.upper, 1), (self.lower, -1)):
            if math.isfinite(stop):
                energy += 0.5 * self.bump * ca.fmax(outward * (value - stop), 0) ** 2
        return energy


@dataclass(frozen=True)
class Joint:
    """A part that turns about, or slides along, an axis.

    Attributes
    ----------
    name : str
        Unique in the vehicle.
    parent : str
        An earlier joint, or ``"platform"``.
    axis : {"x", "y", "z"} or tuple of 3 floats
        Axis in the part's frame: right, forward, up, or any direction.
    at : tuple of 3 floats
        Origin of the part in the parent's frame. [m]
    value : str
        The right-handed angle or the length: a coordinate, or a formula of coordinates such as
        ``"-rocker"`` (see `slipfree.vehicle.formula.evaluate`); ``"0"`` for a rigid joint.
    motion : {"turn", "slide"}
        Which of the two.
    body : Body
        Its mass, that of the wheels apart.
    turned : tuple of 3 floats
        How the part is turned in the parent's frame at value zero: angles about the parent's x,
        then y, then z. [rad]
    """

    name: str
    parent: str
    axis: Axis
    at: Vector
    value: str
    motion: Literal["turn", "slide"] = "turn"
    body: Body = Body()
    turned: Vector = ORIGIN

    def __repr__(self) -> str:
        return field_overview(self)

    def __post_init__(self) -> None:
        for key in ("at", "turned"):
            check_vector(f"joint {self.name}: {key}", getattr(self, key))
        try:
            unit_vector(self.axis)
            names_in(self.value)
        except ModelError as error:
            raise ModelError(f"joint {self.name}: {error}") from error

    @property
    def coordinates(self) -> frozenset[str]:
        """The coordinates that move it."""
        return names_in(self.value)

    def pose(self, values: Mapping[str, ca.SX]) -> Pose:
        """Return the pose of the part in its parent's frame at values of the coordinates."""
        value = evaluate(self.value, values)
        x, y, z = self.turned
        place = translation(*self.at)
        if any(self.turned):
            place = place @ turn("z", z) @ turn("y", y) @ turn("x", x)
        if self.motion == "turn":
            return place @ turn(self.axis, value)
        return place @ translation(*(value * along for along in unit_vector(self.axis)))


@dataclass(frozen=True)
class Vehicle:
    """A platform, its joints and its wheels; the order of the tuples is the order everywhere.

    Attributes
    ----------
    name : str
        What it is called in results.
    coordinates : tuple of Coordinate
        Its internal freedoms.
    joints : tuple of Joint
        Parents before children.
    wheels : tuple of Wheel
        At least three.
    body : Body
        Mass of the platform. A vehicle without any mass moves, but bears no forces.
    notes : tuple of str
        What to know about how it was read from a file.

    Raises
    ------
    ModelError
        If a name is used twice or is unknown, or if the wheels and the suspension coordinates do
        not match: every wheel leaves one constraint, three of them place the platform, and each
        further one needs a suspension coordinate to yield.
    """

    name: str
    coordinates: tuple[Coordinate, ...]
    joints: tuple[Joint, ...]
    wheels: tuple[Wheel, ...]
    body: Body = Body()
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        driven = sum(wheel.driven for wheel in self.wheels)
        return overview(
            f"Vehicle {self.name!r}: {len(self.wheels)} wheels ({driven} driven), {self.mass:g} kg",
            wheels=(wheel.name for wheel in self.wheels),
            joints=(joint.name for joint in self.joints),
            coordinates=(f"{c.name} ({c.kind})" for c in self.coordinates),
            notes=self.notes,
        )

    def __post_init__(self) -> None:
        _unique("coordinate", (c.name for c in self.coordinates))
        _unique("part", ["platform", *(j.name for j in self.joints)])
        _unique("wheel", (w.name for w in self.wheels))
        known, names = {"platform"}, {c.name for c in self.coordinates}
        for joint in self.joints:
            _found("joint", joint.name, "parent", joint.parent, known)
            for used in sorted(joint.coordinates):
                _found("joint", joint.name, "coordinate", used, names)
            known.add(joint.name)
        for wheel in self.wheels:
            _found("wheel", wheel.name, "parent", wheel.parent, known)
        turning = {c for j in self.joints if j.motion == "turn" for c in j.coordinates}
        sliding = {c for j in self.joints if j.motion == "slide" for c in j.coordinates}
        if turning & sliding:
            raise ModelError(f"coordinate {min(turning & sliding)} both turns and slides: use two")
        unused = names - turning - sliding
        if unused:
            raise ModelError(f"coordinate {min(unused)} moves no joint: remove it or use it")
        if len(self.wheels) < 3:
            raise ModelError(
                f"a vehicle needs three wheels or more to stand, found {len(self.wheels)}"
            )
        given, needed = len(self.of("suspension")), len(self.wheels) - 3
        if given != needed:
            have = ", ".join(c.name for c in self.of("suspension")) or "none"
            raise ModelError(
                f"{len(self.wheels)} wheels need {needed} suspension coordinates, found {given} "
                f"({have}): " + ("lock one" if given > needed else "a wheel would hang in the air")
            )

    def of(self, kind: Kind) -> tuple[Coordinate, ...]:
        """Return the coordinates of one kind, in order."""
        return tuple(c for c in self.coordinates if c.kind == kind)

    def unit(self, name: str) -> Literal["rad", "m"]:
        """Return the unit of a coordinate, as its joints use it."""
        slides = any(name in j.coordinates and j.motion == "slide" for j in self.joints)
        return "m" if slides else "rad"

    @property
    def mass(self) -> float:
        """Mass of all parts. [kg]."""
        bodies = [self.body, *(joint.body for joint in self.joints)]
        return sum(body.mass for body in bodies) + sum(wheel.mass for wheel in self.wheels)

    @property
    def weight(self) -> float:
        """Weight of all parts. [N]."""
        return self.mass * GRAVITY

    def carriers(self, platform: Pose, values: Mapping[str, ca.SX]) -> tuple[Pose, ...]:
        """Return the pose of every wheel's carrier, at the wheel's centre.

        Parameters
        ----------
        platform : Pose
            Pose of the platform.
        values : mapping of str to SX
            Value of every coordinate, by name. [rad or m]
        """
        parts = self.parts(platform, values)
        return tuple(parts[wheel.parent] @ wheel.mount for wheel in self.wheels)

    def masses(
        self, platform: Pose, values: Mapping[str, ca.SX]
    ) -> Iterator[tuple[str, float, ca.SX]]:
        """Yield name, mass and centre of every part that has a mass, wheels by themselves. [kg, m].

        Parameters are those of `carriers`.
        """
        parts = self.parts(platform, values)
        bodies = [("platform", self.body), *((joint.name, joint.body) for joint in self.joints)]
        bodies += [(wheel.parent, Body(wheel.mass, wheel.at)) for wheel in self.wheels]
        for part, body in bodies:
            if body.mass:
                yield part, body.mass, (parts[part] @ translation(*body.at)).origin

    def parts(self, platform: Pose, values: Mapping[str, ca.SX]) -> dict[str, Pose]:
        """Return the poses of the platform and of all joints' parts, by name.

        Parameters are those of `carriers`.
        """
        parts = {"platform": platform}
        for joint in self.joints:
            parts[joint.name] = parts[joint.parent] @ joint.pose(values)
        return parts


def actuated(vehicle: Vehicle, *names: str) -> Vehicle:
    """Return the vehicle with actuators in passive joints: their rates become inputs.

    An actuator at rate zero is a lock. The torque that either has to bear is an output. Springs,
    dampers and elastic stops of these joints are taken out.

    Raises
    ------
    ModelError
        If a name is not that of a passive coordinate.
    """
    passive = [c.name for c in vehicle.of("passive")]
    for name in names:
        if name not in passive:
            raise ModelError(
                f"actuated: expected one of the passive coordinates "
                f"({', '.join(passive) or 'there is none'}), found {name!r}"
            )
    coordinates = tuple(
        replace(c, kind="commanded", stiffness=0.0, damping=0.0, bump=0.0) if c.name in names else c
        for c in vehicle.coordinates
    )
    return replace(vehicle, coordinates=coordinates)


def _unique(what: str, names: Iterable[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ModelError(f"two {what}s are called {name!r}: names must be unique")
        seen.add(name)


def _found(what: str, name: str, role: str, wanted: str, known: set[str]) -> None:
    if wanted not in known:
        raise ModelError(
            f"{what} {name}: its {role} {wanted!r} is not known; known so far: "
            + ", ".join(sorted(known))
        )
