"""Links and joints of a URDF, and the errors, notes and guesses of their conversion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, NoReturn

import numpy as np

from slipfree.files.vehicle_draft import Guess, UnfitError, Value, rotation_of
from slipfree.geometry.frame import Vector
from slipfree.geometry.tensor import Elements
from slipfree.records import Array


class Shape(NamedTuple):
    """A round shape in the frame of its link: a sphere, or a body of revolution about its z axis.

    Attributes
    ----------
    kind : {"cylinder", "sphere", "mesh"}
        Kind of the shape.
    radius : float
        Radius; of a mesh, the largest distance of its points from the axis. [m]
    at : tuple of 3 floats
        Position of the centre in the frame of the link. [m]
    turned : tuple of 3 floats
        Roll, pitch and yaw of the shape in the frame of the link. [rad]
    tube : float
        Radius of the tube of a mesh with a rounded tread; zero for other shapes. [m]
    """

    kind: Literal["cylinder", "sphere", "mesh"]
    radius: float
    at: Vector
    turned: Vector
    tube: float = 0.0


class Box(NamedTuple):
    """A box in the frame of its link.

    Attributes
    ----------
    size : tuple of 3 floats
        Lengths of the edges. [m]
    at, turned : tuple of 3 floats
        Position of the centre, and roll, pitch, yaw. [m, rad]
    """

    size: Vector
    at: Vector
    turned: Vector


class Mesh(NamedTuple):
    """A mesh in the frame of its link.

    Attributes
    ----------
    name : str
        Name of its file, as in the URDF.
    scale : tuple of 3 floats
        Factors of the coordinates in the file.
    at, turned : tuple of 3 floats
        Position of its origin, and roll, pitch, yaw. [m, rad]
    """

    name: str
    scale: Vector
    at: Vector
    turned: Vector


class Link(NamedTuple):
    """A link of a URDF.

    Attributes
    ----------
    name : str
        Name of the link.
    mass : float or None
        Mass; None if the URDF does not contain it. [kg]
    center : tuple of 3 floats
        Centre of mass in the frame of the link. [m]
    shapes : tuple of Shape
        Cylinders and spheres among the collision shapes; if there are none, among the visual
        shapes.
    meshes : tuple of Mesh
        Meshes among the collision shapes; if there are none, among the visual shapes.
    boxes : tuple of Box
        Boxes among the collision shapes; if there are none, among the visual shapes.
    inertia : tuple of 6 floats or None
        ``Ixx, Iyy, Izz, Ixy, Ixz, Iyz`` about the centre of mass, in the axes of the link; None if
        they are missing, or impossible for a body. [kg m^2]
    visuals : tuple of Mesh
        Meshes among the visual shapes.
    """

    name: str
    mass: float | None
    center: Vector
    shapes: tuple[Shape, ...] = ()
    meshes: tuple[Mesh, ...] = ()
    boxes: tuple[Box, ...] = ()
    inertia: Elements | None = None
    visuals: tuple[Mesh, ...] = ()


class Mimic(NamedTuple):
    """Dependence of a joint's value on another joint: ``offset + multiplier * other``.

    Attributes
    ----------
    joint : str
        Name of the other joint.
    multiplier, offset : float
        Coefficients of the other joint's value. [1, rad or m]
    """

    joint: str
    multiplier: float
    offset: float


class UrdfJoint(NamedTuple):
    """A joint of a URDF.

    Attributes
    ----------
    name, type : str
        Name, and type as in the URDF.
    parent, child : str
        Names of the links that it connects.
    at, turned : tuple of 3 floats
        Position, and roll, pitch, yaw of its frame in the parent link. [m, rad]
    axis : tuple of 3 floats
        Axis in the joint's frame; zero for a fixed joint without axis. [1]
    lower, upper : float
        Limits of the value; infinite without limits. [rad or m]
    max_rate : float
        Largest rate; infinite without a limit. [rad/s or m/s]
    mimic : Mimic or None
        Dependence on another joint; None for an independent joint.
    line : int
        Line of the element in the file.
    """

    name: str
    type: str
    parent: str
    child: str
    at: Vector
    turned: Vector
    axis: Vector
    lower: float
    upper: float
    max_rate: float
    mimic: Mimic | None
    line: int

    @property
    def moves(self) -> bool:
        """Whether the joint is not of type ``fixed``."""
        return self.type != "fixed"


@dataclass(frozen=True)
class Tree:
    """Links and joints of a URDF.

    Attributes
    ----------
    file, name, root : str
        Names of the file, the robot and the root link.
    links : dict of str to Link
        Links by name.
    joints : dict of str to UrdfJoint
        Joints by name, parents before children.
    actuated : frozenset of str
        Names of the joints with a transmission, a command interface or a drive of Gazebo.
    omitted : tuple of str
        Names of the omitted links: links with unexpanded xacro, and the links below them.
    notes : tuple of str
        Notes on values that replace expressions of xacro.
    unknown : tuple of str
        Elements of the robot that URDF does not have, with their lines.
    """

    file: str
    name: str
    root: str
    links: dict[str, Link]
    joints: dict[str, UrdfJoint]
    actuated: frozenset[str]
    omitted: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    unknown: tuple[str, ...] = ()

    @cached_property
    def frames(self) -> dict[str, tuple[Array, Array]]:
        """Rotation and origin [m] of each link in the root's frame, with all joints at zero."""
        frames = {self.root: (np.eye(3), np.zeros(3))}
        for joint in self.joints.values():
            rotation, origin = frames[joint.parent]
            frames[joint.child] = (
                rotation @ rotation_of(joint.turned),
                origin + rotation @ np.asarray(joint.at),
            )
        return frames

    def below(self, link: str) -> list[UrdfJoint]:
        """Return all joints below a link: its joints, those of their child links, and so on."""
        found, known = [], {link}
        for joint in self.joints.values():
            if joint.parent in known:
                found.append(joint)
                known.add(joint.child)
        return found


class Faults:
    """Collection of the errors in a file, with their lines.

    Parameters
    ----------
    file : str
        Name of the file in messages.
    """

    def __init__(self, file: str) -> None:
        self.file = file
        self.found: list[tuple[int, str]] = []

    def add(self, line: int, words: str) -> None:
        """Add an error with its line of the file and its message."""
        self.found.append((line, words))

    @property
    def lines(self) -> list[str]:
        """Messages of all errors in the order of their lines, as ``file:line: words``."""
        return [f"{self.file}:{line}: {words}" for line, words in sorted(self.found)]

    def stop(self) -> NoReturn:
        """Raise UnfitError with all errors."""
        raise UnfitError(self.lines)


class Findings:
    """Errors, notes and guesses that the conversion of a URDF collects.

    Parameters
    ----------
    file : str
        Name of the file in messages.
    """

    def __init__(self, file: str) -> None:
        self.faults = Faults(file)
        self.notes: list[str] = []
        self.guesses: list[Guess] = []

    def guess(
        self, table: str, name: str, values: Mapping[str, Value], reason: str, other: str
    ) -> None:
        """Record a guess unless it is recorded already."""
        guess = Guess(table, name, values, reason, other)
        if guess not in self.guesses:
            self.guesses.append(guess)
