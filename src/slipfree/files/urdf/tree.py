"""Links and joints of a URDF with their frames, roles that complete them, findings of a conversion.

Roles are information in a vehicle file that completes or overrides a URDF.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import PurePath
from typing import Annotated, Any, Literal, NamedTuple, NoReturn, TypeVar

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field

from slipfree.core.records import Array
from slipfree.core.schema import KEY
from slipfree.files.toml import NonNegative, Positive, Record, decoded, given_values
from slipfree.files.urdf.evidence import WHEEL, Evidence, Plugin
from slipfree.files.vehicle_toml import (
    At,
    Axis,
    DriveTable,
    Guess,
    Inertia,
    Length,
    Rollers,
    Value,
    VehicleError,
    WheelInertia,
    placed,
    rotation_of,
    vector_of,
)
from slipfree.geometry.frame import ORIGIN, Elements, Vector, in_axes, unit_vector
from slipfree.system.forks import cached_property
from slipfree.vehicle.shapes import Box
from slipfree.vehicle.tree import RATE, Kind

MIRROR = 0.05  # largest distance from a mirror image, in distances from the root's origin
MAX_ECCENTRICITY = 1e-3  # largest distance of a wheel's centre from its axis, in radii
STEEP = 0.5  # largest vertical component of a level axis, such as an axle
FORWARD_YAW = {"x": 0.0, "y": np.pi / 2, "-x": np.pi, "-y": -np.pi / 2}  # of the axes [rad]


class Shape(NamedTuple):
    """A round shape in the frame of its link: a sphere, or a body of revolution about its z axis.

    The radius of a mesh is the largest distance of its points from the axis; ``tube`` is the radius
    of its rounded tread. ``length`` is that of a cylinder, or of a capsule between the centres of
    its ends. Position [m], roll, pitch, yaw [rad], radii and length [m].
    """

    kind: Literal["cylinder", "sphere", "capsule", "mesh"]
    radius: float
    at: Vector
    turned: Vector
    tube: float = 0.0
    length: float = 0.0


class MeshFile(NamedTuple):
    """A mesh in the frame of its link: name and scale as in the URDF, and the pose [m, rad]."""

    name: str
    scale: Vector
    at: Vector
    turned: Vector


Geometry = Shape | Box | MeshFile
G = TypeVar("G", Shape, Box, MeshFile)


class Link(NamedTuple):
    """A link of a URDF."""

    name: str
    mass: float | None = None  # mass; None if the URDF does not contain it [kg]
    center: Vector = ORIGIN  # centre of mass in the frame of the link [m]
    shapes: tuple[Shape, ...] = ()  # collision shapes; visual ones if there are none
    meshes: tuple[MeshFile, ...] = ()
    boxes: tuple[Box, ...] = ()
    inertia: Elements | None = None  # ``Ixx, Iyy, Izz, Ixy, Ixz, Iyz`` about the centre [kg m^2]
    visuals: tuple[Geometry, ...] = ()
    collisions: tuple[Geometry, ...] = ()


class Mimic(NamedTuple):
    """Dependence of a joint's value on another joint: ``offset + multiplier * other``."""

    joint: str
    multiplier: float
    offset: float


class UrdfJoint(NamedTuple):
    """A joint of a URDF."""

    name: str
    type: str
    parent: str  # names of the links that it connects
    child: str
    at: Vector  # position in the parent link [m]
    turned: Vector = ORIGIN  # roll, pitch, yaw of its frame in the parent link [rad]
    axis: Vector = ORIGIN  # axis in the joint's frame; zero for a fixed joint without axis [1]
    lower: float = -math.inf  # limits of the value; infinite without limits [rad or m]
    upper: float = math.inf
    max_rate: float = math.inf  # largest rate; infinite without a limit [rad/s or m/s]
    max_effort: float = math.inf  # largest torque or force; infinite without a limit [N m or N]
    mimic: Mimic | None = None  # dependence on another joint; None for an independent joint
    line: int = 1

    @property
    def moves(self) -> bool:
        """Whether the joint is not of type ``fixed``."""
        return self.type != "fixed"

    @property
    def names(self) -> str:
        """Names of the joint and of its child link, to search for words such as "wheel"."""
        return f"{self.name} {self.child}"


@dataclass(frozen=True)
class Tree:
    """Links and joints of a URDF."""

    file: str  # names of the file, the robot and the root link
    name: str
    root: str
    links: dict[str, Link]
    joints: dict[str, UrdfJoint]  # joints by name, parents before children
    # of actuators and springs, by joint
    evidence: Mapping[str, Sequence[Evidence]] = field(default_factory=dict)
    plugins: tuple[Plugin, ...] = ()  # of simulators
    omitted: tuple[str, ...] = ()  # links with unexpanded xacro, and the links below them
    notes: tuple[str, ...] = ()  # notes on values that replace expressions of xacro
    unknown: tuple[str, ...] = ()  # elements of the robot that URDF does not have, with their lines

    @cached_property
    def actuated(self) -> frozenset[str]:
        """Names of the joints with a transmission, a command interface or a drive of Gazebo."""
        pairs = self.evidence.items()
        return frozenset(n for n, each in pairs if any(e.choice == "commanded" for e in each))

    @cached_property
    def drives(self) -> dict[str, Plugin]:
        """Plugins of the wheels that drives of simulators turn, by the name of the joint."""
        return {
            word: plugin
            for plugin in self.plugins
            for word, tag in plugin.words.items()
            if plugin.drives and word in self.joints and "steer" not in tag
        }

    @cached_property
    def frames(self) -> dict[str, tuple[Array, Array]]:
        """Rotation and origin [m] of each link in the root's frame, with all joints at zero."""
        frames = {self.root: (np.eye(3), np.zeros(3))}
        for joint in self.joints.values():
            rotation, origin = frames[joint.parent]
            at = origin + rotation @ np.asarray(joint.at)
            frames[joint.child] = rotation @ rotation_of(joint.turned), at
        return frames

    def below(self, link: str) -> list[UrdfJoint]:
        """Return all joints below a link: its joints, those of their child links, and so on."""
        below, links = [], {link}
        for joint in self.joints.values():
            if joint.parent in links:
                below.append(joint)
                links.add(joint.child)
        return below

    def followed(
        self, joint: UrdfJoint, independent: Container[str] = ()
    ) -> tuple[list[UrdfJoint], float, float]:
        """Return the joints that a joint follows through its mimics, itself first.

        Its value is ``offset + multiplier * last``, of the last joint; the multiplier [1] and the
        offset [rad or m] follow the joints. The chain ends at a joint that does not move or is in
        ``independent``, and before a loop or a name that no joint has.
        """
        chain, multiplier, offset = {joint.name: joint}, 1.0, 0.0  # chains may be long
        while joint.moves and joint.mimic is not None and joint.name not in independent:
            mimic, leader = joint.mimic, self.joints.get(joint.mimic.joint)
            if leader is None or leader.name in chain:
                break
            offset += multiplier * mimic.offset
            multiplier *= mimic.multiplier
            joint = chain[leader.name] = leader
        return [*chain.values()], multiplier, offset

    def axis(self, joint: UrdfJoint) -> Array:
        """Return the unit vector of a joint's axis in the root's frame."""
        return np.asarray(self.frames[joint.child][0] @ unit_vector(joint.axis))

    def is_level(self, joint: UrdfJoint) -> bool:
        """Return whether the axis of a joint is nearly level, with all joints at zero."""
        return abs(float(self.axis(joint)[2])) <= STEEP

    def is_last(self, joint: UrdfJoint) -> bool:
        """Return whether no joint below a joint moves."""
        return not any(below.moves for below in self.below(joint.child))

    @cached_property
    def turning(self) -> tuple[UrdfJoint, ...]:
        """Continuous joints about level axes, such as those of wheels."""
        return tuple(j for j in self.joints.values() if j.type == "continuous" and self.is_level(j))

    @cached_property
    def steered(self) -> frozenset[str]:
        """Names of the joints below joints that turn about steep axes."""
        return frozenset(
            below.name
            for joint in self.joints.values()
            if joint.type in ("continuous", "revolute") and not self.is_level(joint)
            for below in self.below(joint.child)
        )

    @cached_property
    def fixed_to_wheels(self) -> frozenset[str]:
        """Names of the joints below joints that turn about a level axis, if none moves.

        A round shape whose axis is beside that of the joint above does not turn with it, as a wheel
        beside the gear that drives it.
        """
        frames, fixed = self.frames, set()
        for joint in filter(self.is_last, self.turning):
            axis, hub = self.axis(joint), self.radius_of(joint)
            for below in self.below(joint.child):
                offset = frames[below.child][1] - frames[joint.child][1]
                reach = max(hub, self.radius_of(below) / 2)
                is_beside = np.linalg.norm(np.cross(offset, axis)) > reach
                if not (is_beside and self.links[below.child].shapes and WHEEL.search(below.names)):
                    fixed.add(below.name)
        return frozenset(fixed)

    def radius_of(self, joint: UrdfJoint) -> float:
        """Return the largest radius of the round shapes of a joint's link; zero without any [m]."""
        return max((shape.radius for shape in self.links[joint.child].shapes), default=0.0)

    def bottom(self, link: str, shapes: Iterable[Shape]) -> float:
        """Return the height of the lowest point of round shapes; infinite without any [m]."""
        rotation, origin = self.frames[link]
        heights = (lowest(shape, rotation) + float(origin[2]) for shape in shapes)
        return min(heights, default=math.inf)

    def mirror_image(self, joint: UrdfJoint, others: Iterable[UrdfJoint]) -> UrdfJoint | None:
        """Return the joint whose link is at the mirror image of a joint's link; None in the plane.

        The plane is midway between the outermost links that turn about level axes.
        """
        frames = self.frames
        sides = [float(frames[j.child][1][1]) for j in self.turning] or [0.0]
        x, y, z = frames[joint.child][1] - (0, (max(sides) + min(sides)) / 2, 0)
        near = MIRROR * float(np.linalg.norm((x, y, z)))
        image = frames[joint.child][1] - (0, 2 * y, 0)
        images = [
            other for other in others if np.linalg.norm(frames[other.child][1] - image) <= near
        ]
        return images[-1] if images and abs(y) > near else None


class Findings:
    """Errors, notes and guesses of the conversion of a URDF; ``file`` is its name in messages."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.errors: list[tuple[int, str]] = []
        self.notes: list[str] = []
        self.guesses: list[Guess] = []

    def add(self, line: int, message: str) -> None:
        """Add an error with its line of the file, unless it is there."""
        self.errors += [(line, message)] * ((line, message) not in self.errors)

    def wrong(self, joint: UrdfJoint, message: str) -> None:
        """Add an error of a joint."""
        self.add(joint.line, f"joint {joint.name!r}: {message}")

    @property
    def completion(self) -> str:
        """Where to write keys that complete the URDF, for messages."""
        return f'in a vehicle file with urdf = "{PurePath(self.file).name}"'

    def ask(self, joints: Sequence[UrdfJoint], message: str, *lines: str) -> None:
        """Add an error of joints, at the first one, with the lines that correct it."""
        also = f"(also {', '.join(joint.name for joint in joints[1:])}) " if joints[1:] else ""
        remedy = f"{self.completion}, write {' or '.join(lines)}"
        self.wrong(joints[0], f"{also}{message} {remedy}")

    def note(
        self, words: str, names: Iterable[str], other: Callable[[str], str] | None = None
    ) -> None:
        """Add a note on joints or links, if any; ``other`` is the line for the other choice."""
        first, *more = [*names] or [""]
        if first:
            line = f"; otherwise write {other(first)}" if other else ""
            self.notes.append(f"{words}: {', '.join([first, *more])}{line}")

    def guess(
        self, table: str, name: str, values: Mapping[str, Value], reason: str, other: str
    ) -> None:
        """Record a guess unless it is recorded already."""
        guess = Guess(table, name, values, reason, other)
        if guess not in self.guesses:
            self.guesses.append(guess)

    @property
    def lines(self) -> list[str]:
        """Messages of all errors in the order of their lines, as ``file:line: message``."""
        return [f"{self.file}:{line}: {message}" for line, message in sorted(self.errors)]

    def stop(self) -> NoReturn:
        """Raise VehicleError with all errors."""
        raise VehicleError(*self.lines)


def lowest(shape: Shape, rotation: Array) -> float:
    """Return the height of a shape's lowest point above its link's origin [m]."""
    upward = min(1.0, abs(float((rotation @ rotation_of(shape.turned))[2, 2])))
    depth = shape.radius + upward * shape.length / 2  # of a capsule; a sphere has no length
    if shape.kind in ("cylinder", "mesh"):
        depth = shape.radius * math.sqrt(1 - upward**2)
    return float(rotation[2] @ shape.at) - depth


def eccentricity(shape: Shape, axis: Vector) -> float:
    """Return the distance of a shape's centre from an axis through its link's origin [radii]."""
    return float(np.linalg.norm(np.cross(shape.at, axis))) / shape.radius


def is_about(shape: Shape, axis: Vector) -> bool:
    """Return whether a shape is rotationally symmetric about an axis through its link's origin."""
    along = float(rotation_of(shape.turned)[:, 2] @ axis)
    parallel = shape.kind == "sphere" or math.isclose(abs(along), 1, abs_tol=MAX_ECCENTRICITY)
    return parallel and eccentricity(shape, axis) <= MAX_ECCENTRICITY


def facing_forward(tree: Tree, forward: str) -> Tree:
    """Return a URDF with its root rotated so that the forward axis, such as ``"-y"``, becomes x."""
    yaw = FORWARD_YAW[forward]
    back = rotation_of((0.0, 0.0, -yaw))
    joints = dict(tree.joints)
    for name, joint in joints.items():
        if joint.parent == tree.root:
            turned = (joint.turned[0], joint.turned[1], joint.turned[2] - yaw)
            joints[name] = joint._replace(at=vector_of(back @ joint.at), turned=turned)
    root = tree.links[tree.root]
    inertia = None if root.inertia is None else in_axes(back, root.inertia)
    root = root._replace(
        center=vector_of(back @ root.center),
        inertia=inertia,
        collisions=tuple(placed(each, back, np.zeros(3)) for each in root.collisions),
    )
    return replace(tree, links=tree.links | {tree.root: root}, joints=joints)


LEAST_MOMENTS = 5.8e-4  # sum of the moments of 1 kg in a ball of osmium, the densest [kg m^2]
MAX_GYRATION = 5.0  # largest plausible radius of gyration of a link [extent of all links' origins]
# a text is the kind of the joint
EXPANDED = BeforeValidator(lambda value: {"kind": value} if isinstance(value, str) else value)
UnitAxis = Annotated[Axis, AfterValidator(unit_vector)]


class JointRole(Record):
    """Table of a joint in a file that completes a URDF: its kind, and keys of its coordinate.

    A joint that is not in the URDF has the key ``carries``. The keys from ``words`` are those of
    `slipfree.vehicle.tree.Coordinate`.
    """

    kind: Literal[Kind, "fixed"]  # kind of its coordinate, if it moves
    axis: UnitAxis = None  # None for that of the URDF
    motion: Literal["turn", "slide"] | None = None  # None for that of its type
    carries: Annotated[tuple[str, ...], Field(strict=False)] = ()  # joints that a new joint carries
    at: At = ORIGIN  # of a new joint in the link that carried these joints [m]
    words: str | None = None
    lower: float | None = None
    upper: float | None = None
    stiffness: NonNegative | None = None
    rest: float | None = None
    damping: NonNegative | None = None
    bump: NonNegative | None = None
    max_rate: Positive | None = None
    drive: DriveTable = None

    @property
    def keywords(self) -> dict[str, Any]:
        """Given keyword arguments of `slipfree.vehicle.tree.Coordinate`."""
        own = {"kind", "axis", "motion", "carries", "at"}
        return {name: value for name, value in given_values(self).items() if name not in own}


@dataclass(frozen=True)
class WheelRole:
    """Table of a wheel in a file that completes a URDF; None keeps a property of the URDF.

    Attributes
    ----------
    driven : bool or None
        None to derive it from actuators, or guess it.
    radius : float or None
        Rolling radius; None for that of the shape. [m]
    tube : float or None
        Tube radius; None for that of the shape. [m]
    grip : float
        Factor of the ground's coefficient of friction. [1]
    rollers : float or bool or None
        Angle of rollers; False without; None for a guess. [rad]
    mass : float or None
        Mass; None for that of the link. [kg]
    inertia : tuple of 2 floats or None
        Moments of inertia about the axle and across it; None for those of the link. [kg m^2]
    static_depth : float or None
        As in `slipfree.vehicle.tree.Wheel`. [m]
    drive : Drive
        Drive, for dynamics.
    """

    driven: Annotated[bool | None, KEY] = None
    radius: Annotated[Length | None, KEY] = None
    tube: Annotated[NonNegative | None, KEY] = None
    grip: Annotated[Positive, KEY] = 1.0
    rollers: Annotated[Rollers, KEY] = None
    mass: Annotated[NonNegative | None, KEY] = None
    inertia: Annotated[WheelInertia | None, KEY] = None
    static_depth: Annotated[Length | None, KEY] = None
    drive: Annotated[DriveTable, KEY] = RATE


class LinkRole(Record):
    """Table of a link in a file that completes a URDF: mass properties that override the URDF's."""

    mass: NonNegative | None = None  # [kg]
    center_of_mass: At | None = None  # [m]
    inertia: Inertia | None = None  # elements of the tensor [kg m^2]


WheelRoleTable: Any = decoded(WheelRole)


class UrdfTable(Record):
    """Vehicle file with the key ``urdf``, which completes or overrides a URDF."""

    urdf: Annotated[str, Field(min_length=1)] = ""
    arguments: dict[str, str] = Field(default_factory=dict)
    name: Annotated[str, Field(min_length=1)] | None = None
    tube: NonNegative = 0.0  # tube radius of wheels, if neither a sphere nor a rounded mesh [m]
    radius: Length | None = None  # rolling radius of wheels with meshes; None to measure it [m]
    forward: Literal["x", "-x", "y", "-y"] | None = None  # axis of the root link; None for a guess
    joints: dict[str, Annotated[JointRole, EXPANDED]] = Field(default_factory=dict)  # by name
    wheels: dict[str, WheelRoleTable] = Field(default_factory=dict)  # by joint
    links: dict[str, LinkRole] = Field(default_factory=dict)
    couple: dict[str, float] = Field(default_factory=dict)  # of two joints, as a differential


NO_ROLES = UrdfTable()


def completed(tree: Tree, roles: UrdfTable) -> Tree:
    """Return a URDF completed by roles: new joints, released joints, axes and mass properties.

    Moments of inertia too large for the vehicle or too small for the mass, as in other units, are
    left out.
    A joint of type fixed that has an axis is released, so that it moves, if it or the joint that it
    mimics has a role other than ``"fixed"``.
    """
    for name, role in roles.joints.items():
        if not role.carries:
            continue
        # a new joint and a new link of the same name carry other joints
        first, moved_on = tree.joints[role.carries[0]], dict[str, UrdfJoint]()
        kind, axis = "prismatic" if role.motion == "slide" else "revolute", role.axis or ORIGIN
        new = UrdfJoint(name, kind, first.parent, name, role.at, axis=axis, line=first.line)
        for joint in tree.joints.values():
            if joint.name in role.carries:
                moved_on.setdefault(name, new)
                joint = joint._replace(parent=name, at=vector_of(np.asarray(joint.at) - role.at))
            moved_on[joint.name] = joint
        tree = replace(tree, links=tree.links | {name: Link(name)}, joints=moved_on)
    joints = dict(tree.joints)
    for name, joint in joints.items():
        if own := roles.joints.get(name):
            joints[name] = joint = joint._replace(axis=own.axis or joint.axis)
            kind = joint.type if joint.moves else "revolute"
            if own.motion:
                kind = {"slide": "prismatic", "turn": "revolute"}[own.motion]
            if own.kind != "fixed" and any(joint.axis):
                joints[name] = joint._replace(type=kind)
    freed = {name for name, joint in joints.items() if joint.moves > tree.joints[name].moves}
    fixed = [
        joint
        for name, joint in joints.items()
        if not joint.moves and any(joint.axis) and name not in {*roles.joints, *roles.wheels}
    ]
    while more := {j.name for j in fixed if j.mimic and j.mimic.joint in freed} - freed:
        freed |= more
        joints |= {name: joints[name]._replace(type="revolute") for name in more}
    places = np.array([place for _, place in tree.frames.values()])
    largest = (MAX_GYRATION * float(np.ptp(places, axis=0).max())) ** 2 or np.inf
    links = {
        name: link._replace(inertia=None)
        if link.inertia
        and link.mass
        and (
            max(link.inertia[:3]) > largest * link.mass
            or sum(link.inertia[:3]) < LEAST_MOMENTS * link.mass ** (5 / 3)
        )
        else link
        for name, link in tree.links.items()
    }
    for name, mass_role in roles.links.items():
        link = links[name]
        links[name] = link._replace(
            mass=link.mass if mass_role.mass is None else mass_role.mass,
            center=mass_role.center_of_mass or link.center,
            inertia=mass_role.inertia or link.inertia,
        )
    return replace(tree, joints=joints, links=links)


def coupled(tree: Tree, couple: Mapping[str, float]) -> Tree:
    """Return a URDF in which the second of two joints mimics the first, as ``couple`` states.

    It has their coefficients a and b: ``a q1 + b q2 = 0``.
    """
    if not couple:
        return tree
    (first, a), (second, b) = couple.items()
    mimic = Mimic(first, -a / b, 0.0)
    return replace(tree, joints=tree.joints | {second: tree.joints[second]._replace(mimic=mimic)})
