"""Conversion of URDF to vehicles: joints, wheels from round links, masses from inertials."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from slipfree.files.urdf.guesses import (
    CASTER,
    facing_forward,
    is_level,
    joint_guess,
    link_frames,
    wheel_guesses,
)
from slipfree.files.urdf.links import wheel_name
from slipfree.files.urdf.tree import Faults, Mimic, Shape, Tree, UrdfJoint
from slipfree.files.vehicle_draft import (
    MAX_LENGTH,
    Draft,
    Guess,
    UnfitError,
    degrees_words,
    from_rep103,
    is_symbol,
    misfits,
    rotation_of,
)
from slipfree.geometry.frame import Vector, unit_vector
from slipfree.records import Array
from slipfree.vehicle.sections.registry import section_of_radii
from slipfree.vehicle.tree import Body, Coordinate, Joint, Kind
from slipfree.vehicle.wheel import ORIGIN, Wheel

MAX_AXLE_RISE = 0.5  # largest vertical component of the axle of a recognised wheel
MAX_ECCENTRICITY = 1e-3  # largest distance of a wheel's centre from its joint's axis [radius]
MIN_AXLE_LEFT = 1e-6  # a wheel with a smaller leftward component of its axle rolls sideways
MASS_OFFSET = 1e-3  # larger distances of a wheel's centre of mass from its centre are reported [m]
RIGHT = (0.0, -1.0, 0.0)


class JointRole(NamedTuple):
    """Properties of a joint that URDF does not contain: the kind, and keywords of `Coordinate`."""

    kind: Kind | Literal["fixed"]
    keywords: Mapping[str, Any] = {}


class WheelRole(NamedTuple):
    """Properties of a wheel that URDF may not contain.

    Attributes
    ----------
    driven : bool or None
        Whether the wheel is driven; None to derive it from the transmissions of the URDF.
    radius : float or None
        Rolling radius; None for the radius of the shape in the URDF. [m]
    tube : float or None
        Radius of the tube of a torus; None for ``Roles.tube``. [m]
    grip : float
        Factor that multiplies the ground's coefficient of friction. [1]
    rollers : bool
        Whether the wheel has rollers (omnidirectional wheel).
    """

    driven: bool | None = None
    radius: float | None = None
    tube: float | None = None
    grip: float = 1.0
    rollers: bool = False


@dataclass(frozen=True)
class Roles:
    """Roles of the joints of a URDF, by name.

    Attributes
    ----------
    joints : mapping of str to JointRole
        Kinds of the joints; not required for joints with a transmission, a command interface or a
        mimic.
    wheels : mapping of str to WheelRole
        Properties of wheels by name of their joint. These joints carry wheels even if the URDF has
        no suitable shape.
    tube : float
        Tube radius of wheels whose link is a cylinder. [m]
    radius : float or None
        Rolling radius of wheels whose link has no round shape; None for a guess. [m]
    forward : {"x", "-x", "y", "-y"}
        Axis of the root link that points forward.
    """

    joints: Mapping[str, JointRole]
    wheels: Mapping[str, WheelRole]
    tube: float = 0.0
    radius: float | None = None
    forward: str = "x"


NO_ROLES = Roles({}, {})


def read_urdf(tree: Tree, roles: Roles = NO_ROLES) -> Draft:
    """Return the vehicle of a URDF, in axes x right, y forward, z up.

    The platform is the root link. A joint carries a wheel if it has a wheel role, or if it is
    continuous with a nearly horizontal axis, no other joint moves below it, and its link has a
    cylinder or a sphere about its axis. Joints that carry neither a wheel nor a mass are omitted.

    Parameters
    ----------
    tree : Tree
        Result of `slipfree.files.urdf.tree.read_tree`.
    roles : Roles
        Information that the URDF does not have.

    Raises
    ------
    UnfitError
        If the kind of a joint or the shape of a wheel is unknown, or if the numbers of wheels and
        suspension coordinates do not match.
    """
    draft, faults = _Reading(tree, roles).draft()
    draft = from_rep103(draft)
    if faults.found:
        raise UnfitError(faults.lines, draft)
    wrong = [f"{tree.file}:1: expected {e}, found {f}" for e, f in misfits(draft)]
    if wrong:
        raise UnfitError(wrong, draft)
    return draft


class _Reading:
    """Conversion of a URDF tree to a vehicle, with coordinates, notes and errors found so far."""

    def __init__(self, tree: Tree, roles: Roles) -> None:
        self.roles, self.faults = roles, Faults(tree.file)
        tree = facing_forward(tree, roles.forward)
        self.released = _released(tree, roles)
        self.tree = tree._replace(
            joints={
                name: j._replace(type="revolute") if name in self.released else j
                for name, j in tree.joints.items()
            }
        )
        self.coordinates: dict[str, Coordinate] = {}
        self.notes: list[str] = []
        self.turns = _orientations(tree)
        self.guesses: list[Guess] = []
        unknown = [
            j
            for j in self.tree.joints.values()
            if j.name not in roles.joints and not self._is_wheel(j)
        ]
        guesses = wheel_guesses(self.tree, unknown, roles.radius)
        wheels = dict(roles.wheels)
        for name, guess in guesses.items():
            shape = self._shape(self.tree.joints[name])
            radius = guess.radius or (shape.radius if shape else None)
            values: dict[str, float | bool] = {} if radius is None else {"radius": radius}
            wheels[name] = WheelRole(None, guess.radius)
            if guess.is_ball and radius:
                values |= {"tube": radius, "driven": False, "rollers": True}
                wheels[name] = WheelRole(False, radius, radius, rollers=True)
            self._guess("wheels", name, values, f"a wheel: {guess.reason}")
        self.roles = replace(roles, wheels=wheels)
        found = [j for j in self.tree.joints.values() if self._is_wheel(j)]
        gears = self._gears([j for j in found if j.name not in roles.wheels])
        for name in gears:
            reason = "no wheel but fixed: its shape ends far above the lowest wheel"
            self._guess("joints", name, {"kind": "fixed"}, reason)
        fixed = dict.fromkeys(gears, JointRole("fixed"))
        self.roles = replace(self.roles, joints={**self.roles.joints, **fixed})
        self.wheels = [j for j in found if j.name not in gears]
        self._check_meshes()

    def draft(self) -> tuple[Draft, Faults]:
        """Return the draft of the vehicle in axes x forward, y left, and its errors."""
        tree = self.tree
        self._check_fixed()
        kept = self._used_joints()
        part_of = {tree.root: "platform"} | {j.child: j.name for j in kept}
        joints = tuple(self._joint(j, part_of[j.parent]) for j in kept)
        wheels = tuple(wheel for j in self.wheels if (wheel := self._wheel(j, part_of)) is not None)
        self._add_notes(kept)
        notes = tuple(self.notes)
        body = _body(tree, tree.root)
        coordinates = tuple(self.coordinates.values())
        guesses = tuple(self.guesses)
        return Draft(tree.name, coordinates, joints, wheels, body, notes, guesses), self.faults

    def _is_wheel(self, joint: UrdfJoint) -> bool:
        """Return whether a joint carries a wheel, by its role or its shape."""
        tree = self.tree
        if joint.name in self.roles.wheels:
            return True
        last = not any(below.moves for below in tree.below(joint.child))
        if joint.type != "continuous" or joint.name in self.roles.joints or not last:
            return False
        axis = unit_vector(joint.axis)
        if abs((self.turns[joint.child] @ axis)[2]) > MAX_AXLE_RISE:
            return False
        shape = self._shape(joint)
        return shape is not None and _is_about(shape, axis)

    def _check_meshes(self) -> None:
        """Add an error for each joint that may carry a wheel of unknown radius, a mesh."""
        for joint in self.tree.joints.values():
            last = not any(below.moves for below in self.tree.below(joint.child))
            link = self.tree.links[joint.child]
            if (
                joint.type == "continuous"
                and joint not in self.wheels
                and joint.name not in self.roles.joints
                and last
                and link.meshed
                and not link.shapes
                and is_level(self.tree, joint)
            ):
                self.faults.add(
                    joint.line,
                    f"joint {joint.name!r}: expected a cylinder or a sphere as its wheel, found a "
                    "mesh, which is not read; write radius = ... for all such wheels, or the kind "
                    f'of the joint in "joints" if it carries no wheel{self._in_file()}',
                )

    def _gears(self, joints: list[UrdfJoint]) -> list[str]:
        """Return the names of joints whose round shapes are too high to touch the ground.

        Such a shape ends above the lowest one by more than half of the largest radius.
        """
        frames = link_frames(self.tree)
        lows: dict[str, tuple[float, float]] = {}
        for joint in joints:
            shape, (rotation, origin) = self._shape(joint), frames[joint.child]
            if shape is not None:
                lows[joint.name] = (float(origin[2]) + _lowest(shape, rotation), shape.radius)
        lowest = min((low for low, _ in lows.values()), default=0.0)
        most = lowest + max((radius for _, radius in lows.values()), default=0.0) / 2
        return [name for name, (low, _) in lows.items() if low > most]

    def _guess(
        self, table: str, name: str, values: Mapping[str, float | bool | str], reason: str
    ) -> None:
        """Record a guess, once."""
        guess = Guess(table, name, values, reason)
        if guess not in self.guesses:
            self.guesses.append(guess)

    def _check_fixed(self) -> None:
        """Add an error for each role of a joint that cannot move: type fixed, without an axis."""
        for joint in self.tree.joints.values():
            role = self.roles.joints.get(joint.name)
            if not joint.moves and role is not None and role.kind != "fixed":
                self.faults.add(
                    joint.line,
                    f"joint {joint.name!r}: expected a joint that can be "
                    f"{role.kind}, found one of type 'fixed' without an axis; write "
                    'its axis in the URDF, as in <axis xyz="0 1 0"/>, or remove it '
                    'from "joints"',
                )

    def _shape(self, joint: UrdfJoint) -> Shape | None:
        """Return the lowest cylinder or sphere of a wheel's link; None if it has none.

        Shapes about the axis of a moving joint take precedence. The width of cylinders is ignored,
        since the wheel becomes a disc or torus at the centre of the cylinder.
        """
        shapes, rotation = self.tree.links[joint.child].shapes, self.turns[joint.child]
        if joint.moves:
            axis = unit_vector(joint.axis)
            shapes = tuple(shape for shape in shapes if _is_about(shape, axis)) or shapes
        return min(shapes, key=lambda shape: _lowest(shape, rotation), default=None)

    def _used_joints(self) -> list[UrdfJoint]:
        """Return the joints that carry a wheel or a mass, parents before children."""
        tree, names = self.tree, {wheel.name for wheel in self.wheels}
        on_wheels = {j.name for wheel in self.wheels for j in tree.below(wheel.child)}
        carrying = {wheel.parent for wheel in self.wheels}
        kept: list[UrdfJoint] = []
        for joint in reversed(tree.joints.values()):
            if joint.name in names | on_wheels:
                continue
            if joint.child in carrying or tree.links[joint.child].mass:
                kept.append(joint)
                carrying.add(joint.parent)
        left = [
            j.name
            for j in tree.joints.values()
            if j.name not in names | on_wheels and j not in kept
        ]
        if left:
            self.notes.append(f"omitted, since they carry no wheel and no mass: {', '.join(left)}")
        return kept[::-1]

    def _joint(self, joint: UrdfJoint, parent: str) -> Joint:
        """Return the vehicle's joint for a joint of the URDF."""
        return Joint(
            joint.name,
            parent,
            _axis(joint),
            joint.at,
            self._value(joint),
            "slide" if joint.type == "prismatic" else "turn",
            _body(self.tree, joint.child),
            joint.turned,
        )

    def _value(self, joint: UrdfJoint) -> str:
        """Return the formula of a joint's value; create the coordinate in the formula."""
        if joint.type in ("floating", "planar"):
            self.faults.add(
                joint.line,
                f"joint {joint.name!r}: expected fixed, revolute, "
                f"continuous or prismatic, found {joint.type}; replace it by "
                "such joints",
            )
            return "0"
        leader, multiplier, offset = self._leader(joint)
        role = self.roles.joints.get(leader.name)
        if role is None and leader.moves and leader.lower == leader.upper:
            fixed = {"kind": "fixed"}
            self._guess("joints", leader.name, fixed, "fixed: its limits are equal")
            return repr(offset + multiplier * leader.lower)
        if role is None and leader.moves and leader.name not in self.tree.actuated:
            role = self._guessed_role(leader)
        if not leader.moves or (role is not None and role.kind == "fixed"):
            return repr(offset)
        name = self._coordinate(leader, role)
        self._restrict(name, joint, leader, multiplier, offset)
        if (multiplier, offset) == (1.0, 0.0):
            return name
        scaled = f"-{name}" if multiplier == -1 else f"{multiplier!r}*{name}"
        return scaled + (f" + {offset!r}" if offset else "")

    def _leader(self, joint: UrdfJoint) -> tuple[UrdfJoint, float, float]:
        """Return the joint that a joint follows through its mimics, with factor and offset."""
        chain, multiplier, offset = [joint], 1.0, 0.0
        while (mimic := self._mimic(chain[-1])) is not None:
            leader = self.tree.joints.get(mimic.joint)
            wrong = (
                "no joint of that name"
                if leader is None
                else "a wheel"
                if leader in self.wheels
                else "a joint that follows this one"
                if leader in chain
                else ""
            )
            if leader is None or wrong:
                words = (
                    f"expected a mimic of an independent joint, found {mimic.joint!r}, {wrong}; "
                    "correct the name"
                )
                self.faults.add(chain[-1].line, f"joint {chain[-1].name!r}: {words}")
                break
            offset += multiplier * mimic.offset
            multiplier *= mimic.multiplier
            chain.append(leader)
        return chain[-1], multiplier, offset

    def _mimic(self, joint: UrdfJoint) -> Mimic | None:
        return None if joint.name in self.roles.joints or not joint.moves else joint.mimic

    def _guessed_role(self, joint: UrdfJoint) -> JointRole:
        """Return the probable role of a joint that has none and no actuator."""
        names = frozenset(wheel.name for wheel in self.wheels)
        taken = sum(c.kind == "suspension" for c in self.coordinates.values())
        known = self._symbol(joint.name) in self.coordinates
        most = len(names) - 3 - taken + known
        kind, reason = joint_guess(self.tree, joint, names, most)
        word = kind or "fixed"
        self._guess("joints", joint.name, {"kind": word}, f"{word}: {reason}")
        return JointRole(kind or "fixed")

    def _coordinate(self, joint: UrdfJoint, given: JointRole | None) -> str:
        """Return the name of a joint's coordinate; create the coordinate if it is new."""
        name = self._symbol(joint.name)
        if name in self.coordinates:
            return name
        role = given or JointRole("commanded")
        if name != joint.name:
            self.notes.append(f"joint {joint.name} is the coordinate {name}")
        for key in ("lower", "upper", "rest"):
            value = role.keywords.get(key, 0.0)
            if joint.type != "prismatic" and (words := degrees_words(value)):
                self.faults.add(
                    joint.line,
                    f"joint {joint.name!r}: {key}: expected radians ({words}), found {value:g}",
                )
        words = f"joint {joint.name} of the URDF"
        kind: Any = role.kind
        self.coordinates[name] = Coordinate(name, kind, **{"words": words, **role.keywords})
        return name

    def _symbol(self, joint: str) -> str:
        """Return a valid coordinate name for the name of a joint."""
        name = re.sub(r"\W", "_", joint)
        name = name if name.isidentifier() else f"_{name}"
        while not is_symbol(name) or (name != joint and name in self.tree.joints):
            name += "_"
        return name

    def _in_file(self) -> str:
        return f' in a vehicle file with urdf = "{Path(self.tree.file).name}"'

    def _restrict(
        self, name: str, joint: UrdfJoint, leader: UrdfJoint, multiplier: float, offset: float
    ) -> None:
        """Restrict the stops and the rate of a coordinate to the limits of a joint that it moves.

        Limits in the role of the leading joint take precedence.

        Parameters
        ----------
        name : str
            Name of the coordinate.
        joint, leader : UrdfJoint
            Joint that the coordinate moves, and the joint that it follows.
        multiplier, offset : float
            Value of the joint: ``offset + multiplier coordinate``.
        """
        c, role = self.coordinates.get(name), self.roles.joints.get(leader.name)
        if multiplier == 0:
            return
        sides = ("lower", "upper") if multiplier > 0 else ("upper", "lower")
        ends = {
            side: (self._limit(joint, key) - offset) / multiplier
            for key, side in zip(("lower", "upper"), sides, strict=True)
            if role is None or side not in role.keywords
        }
        if c is None:
            return
        lower = max(c.lower, ends.get("lower", -math.inf))
        upper = min(c.upper, ends.get("upper", math.inf))
        if not lower < upper:
            self.faults.add(
                joint.line,
                f"joint {joint.name!r}: expected a lower limit of {name} below the "
                f"upper one, found {lower:g} and {upper:g}; write {leader.name} = "
                '"fixed" in "joints" if it does not move, else its "lower" and "upper", '
                f"which override those of the URDF,{self._in_file()}",
            )
            return
        rate = c.max_rate
        if role is None or "max_rate" not in role.keywords:
            rate = min(rate, joint.max_rate / abs(multiplier))
        self.coordinates[name] = replace(c, lower=lower, upper=upper, max_rate=rate)

    def _limit(self, joint: UrdfJoint, key: str) -> float:
        """Return a limit of a joint in the URDF; add an error if its unit looks wrong."""
        value = joint.lower if key == "lower" else joint.upper
        expected = ""
        if not math.isinf(value) and joint.type == "prismatic" and abs(value) > MAX_LENGTH:
            expected = f"metres, at most {MAX_LENGTH:g} (did you mean millimetres?)"
        elif not math.isinf(value) and joint.type != "prismatic" and degrees_words(value):
            expected = f"radians ({degrees_words(value)})"
        if expected:
            self.faults.add(
                joint.line,
                f"joint {joint.name!r}: expected {key} in {expected}, found {value:g}; correct it",
            )
        return value

    def _wheel(self, joint: UrdfJoint, part_of: Mapping[str, str]) -> Wheel | None:
        """Return a wheel of the vehicle; None with an error added if it is invalid."""
        if joint.parent not in part_of:
            self.faults.add(
                joint.line,
                f"joint {joint.name!r}: expected the parent of a wheel to be the "
                "platform or a joint, found another wheel; remove one of the wheels",
            )
            return None
        role = self.roles.wheels.get(joint.name, WheelRole())
        size = self._size(joint, role)
        below = self.tree.below(joint.child)
        if size is None or any(each.moves for each in below):
            if size is not None:
                self.faults.add(
                    joint.line,
                    f"joint {joint.name!r}: expected a wheel without moving "
                    "joints below it, found some; remove the joints or the wheel",
                )
            return None
        radius, tube, at = size
        driven = role.driven
        if driven is None:
            driven = self._is_driven(joint)
        links = [joint.child, *(each.child for each in below)]
        mass = sum(self.tree.links[link].mass or 0.0 for link in links)
        name = wheel_name(joint.name)
        if name != joint.name:
            self.notes.append(f"joint {joint.name} carries the wheel {name}")
        return Wheel(
            name,
            part_of[joint.parent],
            _sum(joint.at, rotation_of(joint.turned) @ at),
            section_of_radii(tube, radius - tube, rollers=role.rollers),
            driven,
            role.grip,
            mass,
            self._axle(joint),
        )

    def _is_driven(self, joint: UrdfJoint) -> bool:
        """Return whether a wheel has an actuator; without any, all but casters are driven."""
        actuated = self.tree.actuated
        if any(wheel.name in actuated for wheel in self.wheels):
            if joint.name not in actuated:
                reason = "free: other wheels have an actuator"
                self._guess("wheels", joint.name, {"driven": False}, reason)
            return joint.name in actuated
        above = {each.child for each in self.tree.joints.values() if CASTER.search(each.name)}
        is_caster = bool(CASTER.search(f"{joint.name} {joint.child}")) or joint.parent in above
        reason = "free: a caster" if is_caster else "driven: no wheel has an actuator"
        self._guess("wheels", joint.name, {"driven": not is_caster}, reason)
        return not is_caster

    def _size(self, joint: UrdfJoint, role: WheelRole) -> tuple[float, float, Vector] | None:
        """Return rolling radius, tube radius and position of a wheel in its link [m].

        The result is None, with an error added, if they are invalid.
        """
        shape = self._shape(joint)
        radius = role.radius or (shape.radius if shape else None)
        if radius is None:
            self.faults.add(
                joint.line,
                f"joint {joint.name!r}: expected a cylinder or a sphere as "
                f"its wheel, found none; write wheels = {{ {joint.name} = {{ radius = "
                f"... }} }}{self._in_file()}",
            )
            return None
        ball = shape is not None and shape.kind == "sphere"
        tube = role.tube if role.tube is not None else radius if ball else self.roles.tube
        if tube > radius:
            self.faults.add(
                joint.line,
                f"joint {joint.name!r}: expected a tube of at most the "
                f"radius, {radius:g} m, found {tube:g}; reduce it",
            )
            return None
        if shape is None:
            return radius, tube, ORIGIN
        if joint.moves and _eccentricity(shape, unit_vector(joint.axis)) > MAX_ECCENTRICITY:
            self.faults.add(
                joint.line,
                f"joint {joint.name!r}: expected a wheel about its axis, "
                f"found its {shape.kind} at {_spelled(shape.at)} m; move the shape or the "
                "axis",
            )
            return None
        return radius, tube, shape.at

    def _axle(self, joint: UrdfJoint) -> Vector:
        """Return the axle of a wheel in its parent's frame, a unit vector that points to the right.

        Add a note if the rate of the wheel has another sign than that of the joint, or if the wheel
        rolls sideways.
        """
        parent = self.turns[joint.parent]
        if not joint.moves:
            return _vector(parent.T @ RIGHT)
        axis = rotation_of(joint.turned) @ unit_vector(joint.axis)
        left = float((parent @ axis)[1])
        if left < -MIN_AXLE_LEFT:
            self.notes.append(
                f"wheel {joint.name}: its rate is positive forward, opposite to the sign of "
                "its joint in the URDF"
            )
            return _vector(axis)
        if left < MIN_AXLE_LEFT:
            self.notes.append(
                f"wheel {joint.name}: rolls sideways; its rate has the sign of its joint; if the "
                "robot drives this way, write forward = 'y' or '-y'"
            )
        return _vector(-axis)

    def _add_notes(self, kept: list[UrdfJoint]) -> None:
        """Add notes on the assumptions made in the conversion."""
        links = [self.tree.root, *(j.child for j in (*kept, *self.wheels))]
        bare = [link for link in links if self.tree.links[link].mass is None]
        if bare:
            self.notes.append(f"without mass, since they have no inertial: {', '.join(bare)}")
        released = [j.name for j in kept if j.name in self.released]
        if released:
            self.notes.append(
                "of type fixed in the URDF, but treated as revolute, since they or the "
                f'joints that they mimic are in "joints": {", ".join(released)}'
            )
        for reason in dict.fromkeys(guess.reason for guess in self.guesses):
            alike = [guess for guess in self.guesses if guess.reason == reason]
            self.notes.append(
                f"guessed {reason}: {', '.join(guess.name for guess in alike)}; override by "
                f"{alike[0].table} = {{ {alike[0].toml} }}"
            )
        self._add_shape_notes()
        thin = [
            j.name
            for j in self.wheels
            if not self.roles.tube
            and self.roles.wheels.get(j.name, WheelRole()).tube is None
            and (s := self._shape(j))
            and s.kind == "cylinder"
        ]
        away = [j.name for j in self.wheels if self._hangs_off(j)]
        if away:
            self.notes.append(
                "centre of mass moved from the inertial's origin to the wheel's centre: "
                f"{', '.join(away)}"
            )
        if thin:
            self.notes.append(
                f"cylinders treated as thin discs; change by tube = ...: {', '.join(thin)}"
            )

    def _add_shape_notes(self) -> None:
        """Add a note for each wheel whose link has several shapes, with the chosen radius."""
        alike: dict[str, list[str]] = {}
        for joint in self.wheels:
            shapes, chosen = self.tree.links[joint.child].shapes, self._shape(joint)
            given = self.roles.wheels.get(joint.name, WheelRole()).radius
            if chosen is None or given is not None or all(s == chosen for s in shapes):
                continue
            counts = Counter((s.kind, s.radius) for s in shapes)
            found = ", ".join(
                f"{n} {kind}{'s' * (n > 1)} of {radius:g} m" for (kind, radius), n in counts.items()
            )
            words = (
                f"several shapes ({found}), radius {chosen.radius:g} m of the shape about the "
                "axle that touches level ground first"
            )
            alike.setdefault(words, []).append(joint.name)
        for words, names in alike.items():
            self.notes.append(
                f"{words}; override by wheels = {{ {names[0]} = {{ radius = ... }} "
                f"}}: {', '.join(names)}"
            )

    def _hangs_off(self, joint: UrdfJoint) -> bool:
        """Return whether a wheel's centre of mass is more than 1 mm from its centre."""
        link, shape = self.tree.links[joint.child], self._shape(joint)
        at = shape.at if shape else ORIGIN
        return bool(link.mass) and math.dist(link.center, at) > MASS_OFFSET


def _released(tree: Tree, roles: Roles) -> frozenset[str]:
    """Return the names of fixed joints that move because of the roles.

    Such a joint has an axis, and it or the joint that it mimics has a role other than ``fixed``.
    """
    fixed = [
        j
        for j in tree.joints.values()
        if not j.moves and any(j.axis) and j.name not in roles.wheels
    ]
    found = {
        j.name for j in fixed if j.name in roles.joints and roles.joints[j.name].kind != "fixed"
    }
    followers = [j for j in fixed if j.mimic is not None and j.name not in roles.joints]
    while more := {j.name for j in followers if j.mimic and j.mimic.joint in found} - found:
        found |= more
    return frozenset(found)


def _orientations(tree: Tree) -> dict[str, Array]:
    """Return the rotation matrix from each link to the root, with all joints at zero, by link."""
    turns = {tree.root: np.eye(3)}
    for joint in tree.joints.values():
        turns[joint.child] = turns[joint.parent] @ rotation_of(joint.turned)
    return turns


def _axis(joint: UrdfJoint) -> Vector:
    return unit_vector(joint.axis) if joint.moves and any(joint.axis) else (0.0, 0.0, 1.0)


def _body(tree: Tree, link: str) -> Body:
    found = tree.links[link]
    return Body(found.mass or 0.0, found.center)


def _eccentricity(shape: Shape, axis: Vector) -> float:
    """Return the distance of a shape's centre from an axis through its link's origin [radii]."""
    return float(np.linalg.norm(np.cross(shape.at, axis))) / shape.radius


def _is_about(shape: Shape, axis: Vector) -> bool:
    """Return whether a shape is rotationally symmetric about an axis through its link's origin."""
    along = float(rotation_of(shape.turned)[:, 2] @ axis)
    parallel = shape.kind == "sphere" or math.isclose(abs(along), 1, abs_tol=MAX_ECCENTRICITY)
    return parallel and _eccentricity(shape, axis) <= MAX_ECCENTRICITY


def _lowest(shape: Shape, rotation: Array) -> float:
    """Return the height of a shape's lowest point above its link's origin [m]."""
    upward = 0.0
    if shape.kind == "cylinder":
        upward = min(1.0, abs(float((rotation @ rotation_of(shape.turned))[2, 2])))
    return float(rotation[2] @ shape.at) - shape.radius * math.sqrt(1 - upward**2)


def _vector(array: Array) -> Vector:
    x, y, z = (float(each) for each in array)
    return x, y, z


def _sum(at: Vector, offset: Array) -> Vector:
    return _vector(np.asarray(at) + offset)


def _spelled(at: Vector) -> str:
    return f"({', '.join(f'{each:g}' for each in at)})"
