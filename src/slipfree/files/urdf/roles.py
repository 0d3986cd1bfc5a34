"""Roles of joints, wheels and links: information that completes or overrides a URDF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from slipfree.files.urdf.tree import Link, Mimic, Tree, UrdfJoint
from slipfree.files.vehicle_draft import vector_of
from slipfree.geometry.frame import Elements, Vector
from slipfree.vehicle.drives import RATE, Drive
from slipfree.vehicle.tree import Kind
from slipfree.vehicle.wheel import ORIGIN


class JointRole(NamedTuple):
    """Properties of a joint that complete or override those in the URDF."""

    kind: Kind | Literal["fixed"]  # kind of its coordinate; ``"fixed"`` if it does not move
    keywords: Mapping[str, Any] = {}  # keyword arguments of `slipfree.vehicle.tree.Coordinate`
    axis: Vector | None = None  # axis in the joint's frame; None for that of the URDF
    motion: Literal["turn", "slide"] | None = None  # None for that of its type in the URDF
    carries: tuple[str, ...] = ()  # joints that a new joint carries; empty for joints of the URDF
    at: Vector = ORIGIN  # position of a new joint in the link that carried these joints [m]


@dataclass(frozen=True)
class WheelRole:
    """Properties of a wheel that complete or override those in the URDF; None keeps them."""

    driven: bool | None = None  # None to derive it from actuators of the URDF, or guess it
    radius: float | None = None  # rolling radius; None for that of the shape, or `Roles` [m]
    tube: float | None = None  # tube radius; None for that of the shape, or of `Roles` [m]
    grip: float = 1.0  # factor that multiplies the ground's coefficient of friction [1]
    rollers: float | bool | None = None  # their angle [rad]; False without; None for a guess
    mass: float | None = None
    inertia: tuple[float, float] | None = None  # moments about the axle and across it [kg m^2]
    static_depth: float | None = None  # under an equal share of the weight; None: default [m]
    drive: Drive = RATE  # for dynamics


class LinkRole(NamedTuple):
    """Mass properties of a link as in `Link` that override those in the URDF; None keeps them."""

    mass: float | None = None
    center_of_mass: Vector | None = None
    inertia: Elements | None = None


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
