"""Roles of joints, wheels and links: information that completes or overrides a URDF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import doc
from pydantic import AfterValidator, BeforeValidator, Field

from slipfree.files.toml import NonNegative, Positive, Record, decoded, given_values
from slipfree.files.urdf.tree import Link, Mimic, Tree, UrdfJoint
from slipfree.files.vehicle_toml import (
    At,
    Axis,
    DriveTable,
    Inertia,
    Length,
    Rollers,
    WheelInertia,
    vector_of,
)
from slipfree.geometry.frame import unit_vector
from slipfree.vehicle.tree import Kind
from slipfree.vehicle.wheel import ORIGIN, RATE

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
    """Table of a wheel in a file that completes a URDF; None keeps a property of the URDF."""

    driven: Annotated[bool | None, doc("None to derive it from actuators, or guess it")] = None
    radius: Annotated[Length | None, doc("rolling radius; None for that of the shape [m]")] = None
    tube: Annotated[NonNegative | None, doc("tube radius; None for that of the shape [m]")] = None
    grip: Annotated[Positive, doc("factor of the ground's coefficient of friction [1]")] = 1.0
    rollers: Annotated[Rollers, doc("angle [rad]; False without; None for a guess")] = None
    mass: Annotated[NonNegative | None, doc("[kg]")] = None
    inertia: Annotated[WheelInertia | None, doc("about the axle and across it [kg m^2]")] = None
    static_depth: Annotated[Length | None, doc("as in `slipfree.vehicle.wheel.Wheel` [m]")] = None
    drive: Annotated[DriveTable, doc("drive, for dynamics")] = RATE


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
        if role.carries:
            tree = _with_joint(tree, name, role)
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


def _with_joint(tree: Tree, name: str, role: JointRole) -> Tree:
    """Return a URDF with a new joint and a new link of the same name, which carry other joints."""
    first = tree.joints[role.carries[0]]
    kind = "prismatic" if role.motion == "slide" else "revolute"
    axis = role.axis or ORIGIN
    new = UrdfJoint(name, kind, first.parent, name, role.at, axis=axis, line=first.line)
    joints: dict[str, UrdfJoint] = {}
    for joint in tree.joints.values():
        if joint.name in role.carries:
            joints.setdefault(name, new)
            joint = joint._replace(parent=name, at=vector_of(np.asarray(joint.at) - role.at))
        joints[joint.name] = joint
    return replace(tree, links=tree.links | {name: Link(name)}, joints=joints)


def coupled(tree: Tree, couple: Mapping[str, float]) -> Tree:
    """Return a URDF in which the second of two joints in ``couple`` mimics the first."""
    if not couple:
        return tree
    (first, ahead), (second, behind) = couple.items()
    mimic = Mimic(first, -ahead / behind, 0.0)
    return replace(tree, joints=tree.joints | {second: tree.joints[second]._replace(mimic=mimic)})
