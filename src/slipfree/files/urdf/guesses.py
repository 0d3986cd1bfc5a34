"""Guessed wheels of a URDF: from names, shapes, rollers, and the opposite wheel."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slipfree.files.urdf.casters import CASTER, PARALLEL, axle_of, caster_wheels, casters
from slipfree.files.urdf.frames import (
    WHEEL,
    fixed_to_wheels,
    is_about,
    is_last,
    is_level,
    mirror_image,
    steered,
)
from slipfree.files.urdf.meshes import angles_to
from slipfree.files.urdf.roles import Roles, WheelRole
from slipfree.files.urdf.tree import Link, Shape, Tree, UrdfJoint
from slipfree.files.vehicle_draft import rotation_of
from slipfree.geometry.frame import unit_vector
from slipfree.vehicle.wheel import ORIGIN

FOOTPRINT = re.compile("footprint", re.IGNORECASE)  # link on the ground, by REP 120
FULL_TURN = 6.2  # least range of joints whose limits are those of a careless export [rad]
MIN_ROLLERS = 3  # wheels with rollers have more of them


class WheelGuess(NamedTuple):
    """A wheel that a URDF does not describe completely.

    Attributes
    ----------
    role : WheelRole
        Its guessed properties.
    reason : str
        Reason for the guess.
    """

    role: WheelRole
    reason: str


def with_fixed_rollers(tree: Tree) -> tuple[Tree, dict[str, WheelGuess]]:
    """Return a URDF in which the rollers of wheels are fixed, and these wheels by joint.

    Rollers turn about axes around that of the wheel. If these axes are across the axle, the wheel
    slides freely along it.
    """
    joints, links, found = dict(tree.joints), dict(tree.links), {}
    for joint in tree.joints.values():
        below = tree.below(joint.child)
        rollers = [each for each in below if each.type == "continuous"]
        if joint.type != "continuous" or len(rollers) <= MIN_ROLLERS or not is_level(tree, joint):
            continue
        axis = np.asarray(unit_vector(joint.axis))
        far = [np.linalg.norm(np.cross(each.at, axis)) for each in rollers]
        if not all(each.parent == joint.child for each in rollers) or np.ptp(far) > far[0] / 10:
            continue
        joints |= {each.name: each._replace(type="fixed") for each in below}
        along = [abs(rotation_of(each.turned) @ unit_vector(each.axis) @ axis) for each in rollers]
        free = max(along) < 0.5
        size = max((shape.radius for shape in links[rollers[0].child].shapes), default=0.0)
        link = links[joint.child]
        if not link.shapes:
            x, y, z = angles_to(axis)
            shape = Shape("cylinder", float(far[0]) + size, ORIGIN, (x, y, z))
            links[joint.child] = link._replace(shapes=(shape,))
        words = "it slides along its axle on rollers"
        reason = words if free else "it does not slide along its rollers, which are oblique"
        found[joint.name] = WheelGuess(WheelRole(rollers=free), reason)
    return replace(tree, joints=joints, links=links), found


def wheel_guesses(
    tree: Tree, wheels: Sequence[UrdfJoint], unread: Collection[str], roles: Roles
) -> Iterator[tuple[str, WheelGuess]]:
    """Yield the wheels that joints probably carry, with the name of the joint.

    Parameters
    ----------
    tree : Tree
        The URDF, facing forward along x.
    wheels : sequence of UrdfJoint
        Joints whose links are wheels by their shape.
    unread : collection of str
        Names of joints whose meshes cannot be read.
    roles : Roles
        Information that completes the URDF.
    """
    found = dict(_named_wheels(tree, wheels, roles))
    rolling = [*wheels, *(tree.joints[name] for name in found if tree.joints[name].moves)]
    for caster in casters(tree, rolling, roles.joints):
        found = {name: guess for name, guess in found.items() if name not in caster.parts}
        radius = caster.radius
        role = WheelRole(False, radius, radius, rollers=True)
        reason = f"a caster slides freely as a ball; {caster.reason}"
        if not caster.is_ball:
            role, reason = WheelRole(radius=radius), "it trails the axis of a caster"
        found[caster.joint] = WheelGuess(role, reason)
    yield from found.items()  # a counterpart gives the radius of a wheel without a shape
    bare = {
        n for n in found if not (found[n].role.radius or tree.links[tree.joints[n].child].shapes)
    }
    found = {name: guess for name, guess in found.items() if name not in bare}
    yield from _counterparts(tree, wheels, found, {*unread, *roles.joints})


def _named_wheels(
    tree: Tree, wheels: Sequence[UrdfJoint], roles: Roles
) -> Iterator[tuple[str, WheelGuess]]:
    """Yield the wheels that names, such as "wheel", or a given radius of meshes suggest.

    All wheels with a radius from the height have that of the lowest one.
    """
    frames, on_wheels = tree.frames, fixed_to_wheels(tree)
    grounds = [frames[each][1][2] for each in tree.links if FOOTPRINT.search(each)]
    heights: dict[str, float] = {}
    for joint in tree.joints.values():
        link, named = tree.links[joint.child], WHEEL.search(f"{joint.name} {joint.child}")
        known = joint in wheels or joint.name in {*roles.joints, *on_wheels}
        if known or joint.type == "prismatic" or not is_last(tree, joint):
            continue
        if joint.moves and not is_level(tree, joint):
            continue
        if CASTER.search(f"{joint.name} {joint.child}") and _is_ball(link):
            continue
        turns = joint.type == "revolute" and joint.upper - joint.lower >= FULL_TURN
        round_about = (is_about(shape, unit_vector(joint.axis)) for shape in link.shapes)
        height = float(frames[joint.child][1][2] - grounds[0]) if grounds else 0.0
        if joint.type == "continuous" and roles.radius and link.meshes and not link.shapes:
            yield joint.name, WheelGuess(WheelRole(radius=roles.radius), "a mesh, its given radius")
        elif turns and any(round_about):
            reason = "a round shape and a full turn, in spite of its limits"
            yield joint.name, WheelGuess(WheelRole(), reason)
        elif named and link.shapes:
            limits = "" if joint.type != "revolute" else ", in spite of its limits"
            yield joint.name, WheelGuess(WheelRole(), f"its name and a round shape{limits}")
        elif named and link.meshes and height > 0:
            heights[joint.name] = height
        elif named and joint.moves and not link.meshes:
            yield joint.name, WheelGuess(WheelRole(), "its name")
    reason = "its name, without a round shape; radius from the least height above the footprint"
    for name in heights:
        yield name, WheelGuess(WheelRole(radius=min(heights.values())), reason)


def _is_ball(link: Link) -> bool:
    return {shape.kind for shape in link.shapes} == {"sphere"}


def _counterparts(
    tree: Tree,
    wheels: Sequence[UrdfJoint],
    guesses: Mapping[str, WheelGuess],
    excluded: Collection[str],
) -> Iterator[tuple[str, WheelGuess]]:
    """Yield the wheels opposite to a wheel that has no opposite wheel."""
    everything = [*wheels, *(tree.joints[name] for name in guesses)]
    known = {*excluded, *fixed_to_wheels(tree), *(wheel.name for wheel in everything)}
    ends = [j for j in tree.joints.values() if is_last(tree, j) and j.name not in known]
    for wheel in everything:
        other = mirror_image(tree, wheel, ends)
        if other is not None and mirror_image(tree, wheel, everything) is None:
            reason = f"its counterpart on the other side, {wheel.name}, is one"
            radii = [shape.radius for shape in tree.links[wheel.child].shapes]
            role = WheelRole(radius=max(radii, default=None))
            guess = guesses.get(wheel.name)
            yield other.name, WheelGuess(guess.role if guess and not radii else role, reason)


def sliding_wheels(tree: Tree, wheels: Sequence[UrdfJoint]) -> Iterator[tuple[str, WheelGuess]]:
    """Yield the wheels that nothing steers and that must slide along their axles.

    They are all wheels with axles that are not parallel, and those of casters without a swivel.
    """
    casters = caster_wheels(tree, wheels)
    turned = steered(tree)
    rolling = [
        wheel
        for wheel in wheels
        if wheel.name not in turned
        and wheel.type in ("continuous", "revolute", "fixed")
        and (not wheel.moves or is_level(tree, wheel))
    ]
    for wheel in rolling:
        if wheel.name in casters:
            reason = "a caster without a swivel slides freely along its axle"
            yield wheel.name, WheelGuess(WheelRole(False, rollers=True), reason)
    rest = [wheel for wheel in rolling if wheel.name not in casters]
    axles = [axle_of(tree, wheel) for wheel in rest]
    if any(abs(axle @ axles[0]) < PARALLEL for axle in axles):
        for wheel in rest:
            reason = "with rollers, since the axles are not parallel"
            yield wheel.name, WheelGuess(WheelRole(rollers=True), reason)


def unused_wheel_names(
    tree: Tree, wheels: Sequence[UrdfJoint], known: Collection[str]
) -> list[str]:
    """Return the names of last joints with "wheel" in a name that belong to no wheel."""
    on_wheels = {below.name for wheel in wheels for below in [wheel, *tree.below(wheel.child)]}
    return [
        joint.name
        for joint in tree.joints.values()
        if WHEEL.search(f"{joint.name} {joint.child}")
        and joint.name not in {*known, *on_wheels}
        and is_last(tree, joint)
        and on_wheels.isdisjoint(below.name for below in tree.below(joint.child))
    ]
