"""A vehicle as a tree of joints with wheels at its ends."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import casadi as ca

from slipfree.errors import ModelError
from slipfree.geometry.frame import AXES, Pose, translation, turn
from slipfree.vehicle.wheel import Wheel

Kind = Literal["commanded", "passive", "suspension"]


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
    """

    name: str
    kind: Kind
    words: str
    lower: float = -float("inf")
    upper: float = float("inf")

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise ModelError(
                f"coordinate {self.name}: stops must ascend, found {self.lower} to {self.upper}"
            )


@dataclass(frozen=True)
class Joint:
    """A part that turns about, or slides along, an axis of its parent.

    Attributes
    ----------
    name : str
        Unique in the vehicle.
    parent : str
        An earlier joint, or ``"platform"``.
    axis : {"x", "y", "z"}
        Axis of the parent's frame: right, forward, up.
    at : tuple of 3 floats
        Origin of the part in the parent's frame. [m]
    coordinate : str
        The coordinate whose value is the right-handed angle or the length.
    motion : {"turn", "slide"}
        Which of the two.
    """

    name: str
    parent: str
    axis: Literal["x", "y", "z"]
    at: tuple[float, float, float]
    coordinate: str
    motion: Literal["turn", "slide"] = "turn"

    def pose(self, value: ca.SX) -> Pose:
        """Return the pose of the part in its parent's frame at a value of its coordinate."""
        if self.motion == "turn":
            return translation(*self.at) @ turn(self.axis, value)
        x, y, z = (at + value * along for at, along in zip(self.at, AXES[self.axis], strict=True))
        return translation(x, y, z)


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

    def __post_init__(self) -> None:
        _unique("coordinate", (c.name for c in self.coordinates))
        _unique("part", ["platform", *(j.name for j in self.joints)])
        _unique("wheel", (w.name for w in self.wheels))
        known, names = {"platform"}, {c.name for c in self.coordinates}
        for joint in self.joints:
            _found("joint", joint.name, "parent", joint.parent, known)
            _found("joint", joint.name, "coordinate", joint.coordinate, names)
            known.add(joint.name)
        for wheel in self.wheels:
            _found("wheel", wheel.name, "parent", wheel.parent, known)
        turning = {j.coordinate for j in self.joints if j.motion == "turn"}
        for joint in self.joints:
            if joint.motion == "slide" and joint.coordinate in turning:
                raise ModelError(f"coordinate {joint.coordinate} both turns and slides: use two")
        unused = names - {joint.coordinate for joint in self.joints}
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
        slides = any(j.coordinate == name and j.motion == "slide" for j in self.joints)
        return "m" if slides else "rad"

    def carriers(self, platform: Pose, values: Mapping[str, ca.SX]) -> tuple[Pose, ...]:
        """Return the pose of every wheel's carrier, at the wheel's centre.

        Parameters
        ----------
        platform : Pose
            Pose of the platform.
        values : mapping of str to SX
            Value of every coordinate, by name. [rad or m]
        """
        parts = {"platform": platform}
        for joint in self.joints:
            parts[joint.name] = parts[joint.parent] @ joint.pose(values[joint.coordinate])
        return tuple(parts[wheel.parent] @ translation(*wheel.at) for wheel in self.wheels)


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
