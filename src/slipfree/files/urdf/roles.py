"""Roles of joints, wheels and links: information that completes or overrides a URDF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import doc
from pydantic import AfterValidator

from slipfree.files.toml.types import NonNegative, Positive
from slipfree.files.urdf.tree import Link, Mimic, Tree, UrdfJoint
from slipfree.files.vehicle_draft import vector_of
from slipfree.files.vehicle_toml import (
    At,
    Axis,
    DriveTable,
    Inertia,
    Length,
    Rollers,
    WheelInertia,
)
from slipfree.geometry.frame import unit_vector
from slipfree.vehicle.drives import RATE
from slipfree.vehicle.tree import Kind
from slipfree.vehicle.wheel import ORIGIN

COORDINATE = doc("as in `slipfree.vehicle.tree.Coordinate`")


@dataclass(frozen=True)
class JointRole:
    """Table of a joint in a file that completes a URDF: its kind, and keys of its coordinate.

    A joint that is not in the URDF has the key ``carries``.
    """

    kind: Annotated[Literal[Kind, "fixed"], doc("kind of its coordinate, if it moves")]
    axis: Annotated[Axis, AfterValidator(unit_vector), doc("None for that of the URDF")] = None
    motion: Annotated[Literal["turn", "slide"] | None, doc("None for that of its type")] = None
    carries: Annotated[tuple[str, ...], doc("joints that a new joint carries")] = ()
    at: Annotated[At, doc("of a new joint in the link that carried these joints [m]")] = ORIGIN
    words: Annotated[str | None, COORDINATE] = None
    lower: Annotated[float | None, COORDINATE] = None
    upper: Annotated[float | None, COORDINATE] = None
    stiffness: Annotated[NonNegative | None, COORDINATE] = None
    rest: Annotated[float | None, COORDINATE] = None
    damping: Annotated[NonNegative | None, COORDINATE] = None
    bump: Annotated[NonNegative | None, COORDINATE] = None
    max_rate: Annotated[Positive | None, COORDINATE] = None
    drive: Annotated[DriveTable, COORDINATE] = None

    @property
    def keywords(self) -> dict[str, Any]:
        """Given keyword arguments of `slipfree.vehicle.tree.Coordinate`."""
        given = ((each.name, getattr(self, each.name)) for each in fields(self)[5:])
        return {name: value for name, value in given if value is not None}


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


@dataclass(frozen=True)
class LinkRole:
    """Table of a link in a file that completes a URDF: mass properties that override the URDF's."""

    mass: Annotated[NonNegative | None, doc("[kg]")] = None
    center_of_mass: Annotated[At | None, doc("[m]")] = None
    inertia: Annotated[Inertia | None, doc("elements of the tensor [kg m^2]")] = None


@dataclass(frozen=True)
class Roles:
    """Information that completes or overrides a URDF."""

    joints: Mapping[str, JointRole] = field(default_factory=dict)  # by name
    wheels: Mapping[str, WheelRole] = field(default_factory=dict)  # by joint
    links: Mapping[str, LinkRole] = field(default_factory=dict)
    couple: Mapping[str, float] = field(default_factory=dict)  # of two joints, as a differential
    tube: float = 0.0  # tube radius of wheels, if neither a sphere nor a rounded mesh [m]
    radius: float | None = None  # rolling radius of wheels with meshes; None to measure it [m]
    forward: str | None = None  # axis of the root link that points forward; None for a guess


NO_ROLES = Roles()


def completed(tree: Tree, roles: Roles) -> Tree:
    """Return a URDF completed by roles: new joints, released joints, axes and mass properties.

    A joint of type fixed that has an axis is released, so that it moves, if it or the joint that it
    mimics has a role other than ``"fixed"``.
    """
    for name, role in roles.joints.items():
        if role.carries:
            tree = _with_joint(tree, name, role)
    joints = {name: _with_role(joint, roles) for name, joint in tree.joints.items()}
    freed = {name for name, joint in joints.items() if joint.moves > tree.joints[name].moves}
    fixed = [
        joint
        for name, joint in joints.items()
        if not joint.moves and any(joint.axis) and name not in {*roles.joints, *roles.wheels}
    ]
    while more := {j.name for j in fixed if j.mimic and j.mimic.joint in freed} - freed:
        freed |= more
        joints |= {name: joints[name]._replace(type="revolute") for name in more}
    links = dict(tree.links)
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


def _with_role(joint: UrdfJoint, roles: Roles) -> UrdfJoint:
    """Return a joint with the axis and the motion of its role, released if it has an axis."""
    role = roles.joints.get(joint.name)
    if role is None:
        return joint
    joint = joint._replace(axis=role.axis or joint.axis)
    if role.kind == "fixed" or not any(joint.axis):
        return joint
    kind = joint.type if joint.moves else "revolute"
    return joint._replace(
        type={"slide": "prismatic", "turn": "revolute"}[role.motion] if role.motion else kind
    )


def coupled(tree: Tree, couple: Mapping[str, float]) -> Tree:
    """Return a URDF in which the second of two joints in ``couple`` mimics the first."""
    if not couple:
        return tree
    (first, ahead), (second, behind) = couple.items()
    mimic = Mimic(first, -ahead / behind, 0.0)
    return replace(tree, joints=tree.joints | {second: tree.joints[second]._replace(mimic=mimic)})
