"""Casters of a URDF: balls on fixed or turning links, and swivels of wheels and trailers."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slipfree.errors import DataError
from slipfree.files.urdf.frames import (
    fixed_to_wheels,
    is_last,
    is_level,
    lowest,
    radius_of,
    steered,
)
from slipfree.files.urdf.meshes import MeshFiles
from slipfree.files.urdf.tree import Box, Link, Shape, Tree, UrdfJoint
from slipfree.files.vehicle_draft import rotation_of
from slipfree.geometry.frame import unit_vector
from slipfree.records import Array
from slipfree.vehicle.wheel import ORIGIN

CASTER = re.compile("cast[eo]r|ball_?wheel|omni_?ball", re.IGNORECASE)
TRAILER = re.compile("cast[eo]r|trailer|hitch|drawbar|swivel", re.IGNORECASE)
STEERING = re.compile("steer|ackerman|knuckle", re.IGNORECASE)
TRAIL, MAX_TRAIL = 0.2, 2.0  # trail of wheels that swivel freely [radii]; longer ones articulate
SMALL = 0.8  # largest radius of casters without a name or a swivel [radii of the other wheels]
PARALLEL = 0.9  # least cosine of the angle between parallel axles
TOUCH = 0.1  # a ball touches the ground of the wheels within this part of its radius


class Caster(NamedTuple):
    """A caster: links that belong together, of which one touches the ground.

    Attributes
    ----------
    joint : str
        Joint of the link that touches the ground.
    parts : frozenset of str
        Joints of all its links.
    radius : float
        Radius of the ball or wheel. [m]
    is_ball : bool
        Whether it slides freely as a ball; else it is a wheel that trails the axis of a swivel.
    reason : str
        Reason for the radius.
    """

    joint: str
    parts: frozenset[str]
    radius: float
    is_ball: bool
    reason: str


def casters(tree: Tree, wheels: Sequence[UrdfJoint], excluded: Collection[str]) -> Iterator[Caster]:
    """Yield the casters whose wheels do not turn about a level axis of a joint.

    A caster is a joint with "caster" in a name, with the links below it; the lowest of them touches
    the ground. A sphere that touches the ground of the wheels is one without a name.

    Parameters
    ----------
    tree : Tree
        The URDF, facing forward along x.
    wheels : sequence of UrdfJoint
        Joints whose links are wheels that roll.
    excluded : collection of str
        Names of joints that carry no wheel.
    """
    frames = tree.frames
    bottoms = [_bottom(tree.links[wheel.child].shapes, frames[wheel.child]) for wheel in wheels]
    ground = min(bottoms, default=np.inf)
    known = fixed_to_wheels(tree) | {wheel.name for wheel in wheels}
    for joint in tree.joints.values():
        parts = [joint, *tree.below(joint.child)]
        names = frozenset(part.name for part in parts)
        if joint.name in known or joint.name in excluded:
            continue
        if CASTER.search(f"{joint.name} {joint.child}"):
            parts = [part for part in parts if part.name not in excluded]
            if known.isdisjoint(names) and (found := _lowest_part(tree, parts, ground)):
                part, radius, reason = found
                yield Caster(part.name, names, radius, not _trails(tree, joint, part), reason)
            known |= names
            continue
        link = tree.links[joint.child]
        if is_last(tree, joint) and [shape.kind for shape in link.shapes] == ["sphere"]:
            radius = link.shapes[0].radius
            if abs(_bottom(link.shapes, frames[joint.child]) - ground) <= TOUCH * radius:
                reason = "it is a sphere that touches the ground of the wheels"
                yield Caster(joint.name, names, radius, True, reason)


def _bottom(shapes: Sequence[Shape], frame: tuple[Array, Array]) -> float:
    """Return the height of the lowest point of round shapes of a link; infinite without any [m]."""
    return min((lowest(each, frame[0]) + float(frame[1][2]) for each in shapes), default=np.inf)


def _lowest_part(
    tree: Tree, parts: Sequence[UrdfJoint], ground: float
) -> tuple[UrdfJoint, float, str] | None:
    """Return the part of a caster that touches the ground, its radius [m], and its reason.

    The result is None for a caster without shapes that is not above the ground of the wheels.
    """
    frames = tree.frames
    found: list[tuple[float, int, float, str]] = []  # height of the lowest point, index, result
    for index, joint in enumerate(parts):
        link, (rotation, origin) = tree.links[joint.child], frames[joint.child]
        for shape in link.shapes:
            bottom = _bottom([shape], (rotation, origin))
            found.append((bottom, index, shape.radius, "radius of its shape"))
        depth = max((_depth(box, rotation) for box in link.boxes), default=0.0)
        if not link.shapes and not link.boxes:
            depth = _mesh_depth(tree, joint, rotation)
        if depth > 0:
            found.append((float(origin[2]) - depth, index, depth, "radius to its lowest point"))
    if found:
        _, index, radius, reason = min(found)
        return parts[index], radius, reason
    height = float(frames[parts[-1].child][1][2]) - ground
    return (parts[-1], height, "radius to the ground of the wheels") if height > 0 else None


def _depth(box: Box, rotation: Array) -> float:
    """Return the depth of the lowest point of a box below the origin of its link [m]."""
    half = np.abs((rotation @ rotation_of(box.turned))[2]) @ np.asarray(box.size) / 2
    return float(half - rotation[2] @ np.asarray(box.at))


def _mesh_depth(tree: Tree, joint: UrdfJoint, rotation: Array) -> float:
    """Return the depth of a link's meshes below its origin; zero if they are unreadable [m]."""
    meshes = tree.links[joint.child].meshes
    files = MeshFiles(meshes, Path(tree.file).parent)
    try:
        points = [files.triangles(mesh).vertices for mesh in meshes]
    except DataError:  # the ground of the wheels gives the radius
        return 0.0
    return max((float(-(rotation @ each.T)[2].min()) for each in points), default=0.0)


def _trails(tree: Tree, head: UrdfJoint, part: UrdfJoint) -> bool:
    """Return whether a part of a caster is a disc beside the axis of the swivel above it."""
    shapes = tree.links[part.child].shapes
    if not head.moves or is_level(tree, head) or not shapes or shapes[0].kind == "sphere":
        return False
    offset = (tree.frames[part.child][1] - tree.frames[head.child][1])[:2]
    return float(np.hypot(*offset)) > TRAIL * shapes[0].radius


def with_separate_balls(tree: Tree) -> Tree:
    """Return a URDF with links of their own for spheres of the chassis that touch the ground.

    Simple robots have the ball of their caster in the link that carries the wheels.
    """
    frames, links, joints = tree.frames, dict(tree.links), dict(tree.joints)
    bottoms = {name: _bottom(link.shapes, frames[name]) for name, link in links.items()}
    moving = [joint for joint in tree.joints.values() if joint.moves]
    for name in sorted({each.parent for each in moving} - {each.child for each in moving}):
        ground = min((z for other, z in bottoms.items() if other != name), default=np.inf)
        for k, ball in enumerate(tree.links[name].shapes):
            height = abs(_bottom([ball], frames[name]) - ground)
            new, above = f"{name}_ball_{k + 1}", TOUCH * ball.radius < height < np.inf
            if ball.kind != "sphere" or above or new in joints or new in links:
                continue
            rest = tuple(shape for shape in links[name].shapes if shape != ball)
            links[name] = links[name]._replace(shapes=rest)
            links[new] = Link(new, None, ORIGIN, (ball._replace(at=ORIGIN, turned=ORIGIN),))
            limits = (-np.inf, np.inf, np.inf)
            joints[new] = UrdfJoint(
                new, "fixed", name, new, ball.at, ORIGIN, ORIGIN, *limits, mimic=None, line=1
            )
    return replace(tree, links=links, joints=joints)


def swivels(tree: Tree, wheels: Sequence[UrdfJoint]) -> frozenset[str]:
    """Return the names of the joints about steep axes that swivel freely, as those of casters.

    They have no actuator, and a name such as "caster" or "hitch" or wheels that trail them. If each
    wheel is below such a joint, none of them swivels freely.

    Parameters
    ----------
    tree : Tree
        The URDF, facing forward along x.
    wheels : sequence of UrdfJoint
        Joints whose links are wheels that roll.
    """
    found: dict[str, set[str]] = {}
    for joint in tree.joints.values():
        name = f"{joint.name} {joint.child}"
        below = {each.name for each in tree.below(joint.child)}
        carried = [wheel for wheel in wheels if wheel.name in below]
        free = joint.name not in tree.actuated and joint.mimic is None
        if not carried or not joint.moves or joint.type == "prismatic" or is_level(tree, joint):
            continue
        trails = not STEERING.search(name) and TRAIL < _trail(tree, joint, carried) < MAX_TRAIL
        if free and (TRAILER.search(name) or trails):
            found[joint.name] = {wheel.name for wheel in carried}
    held = {wheel.name for wheel in wheels}
    return frozenset() if held == set().union(*found.values()) else frozenset(found)


def caster_wheels(tree: Tree, wheels: Sequence[UrdfJoint]) -> frozenset[str]:
    """Return the names of the joints of wheels that belong to casters or trailers.

    They are below joints that swivel freely, or have "caster" in a name, or are in the middle of a
    vehicle that turns only if they slide. If all wheels do, none belongs to a caster.
    """
    free = {below.name for name in swivels(tree, wheels) for below in _below(tree, name)}
    above = {joint.child for joint in tree.joints.values() if CASTER.search(joint.name)}
    found = {
        wheel.name
        for wheel in wheels
        if wheel.name in free
        or wheel.parent in above
        or CASTER.search(f"{wheel.name} {wheel.child}")
    }
    found |= _middle_wheels(tree, [wheel for wheel in wheels if wheel.name not in found])
    return frozenset() if len(found) == len(wheels) else frozenset(found)


def _middle_wheels(tree: Tree, wheels: Sequence[UrdfJoint]) -> set[str]:
    """Return the names of small wheels in the middle, with one pair of wheels and no steering.

    The wheels are those that belong to no other casters.
    """
    places = np.array([tree.frames[wheel.child][1] for wheel in wheels]).reshape(-1, 3)
    axles = [axle_of(tree, wheel) for wheel in wheels]
    if len(wheels) < 3 or any(abs(axle @ axles[0]) < PARALLEL for axle in axles):
        return set()
    along, left = places @ np.cross(axles[0], (0, 0, 1)), places @ axles[0]
    near = TRAIL * max(float(np.ptp(left)), float(np.ptp(along)))
    pairs = [
        sorted((float(left[i]), float(left[j])))
        for i, j in combinations(range(len(wheels)), 2)
        if abs(along[i] - along[j]) < near < abs(left[i] - left[j])
    ]
    if len(pairs) != 1 or steered(tree) & {wheel.name for wheel in wheels}:
        return set()
    ends = pairs[0][0] + near, pairs[0][1] - near
    radii = np.array([radius_of(tree, wheel) for wheel in wheels])
    inside = (ends[0] < left) & (left < ends[1]) & (radii > 0) & (radii < SMALL * max(radii))
    middle = {wheel.name for wheel, is_small in zip(wheels, inside, strict=True) if is_small}
    return middle if len(middle) == len(wheels) - 2 and not middle & tree.actuated else set()


def axle_of(tree: Tree, wheel: UrdfJoint) -> Array:
    """Return the axle of a wheel in the root's frame; to the left for one that no joint turns."""
    if wheel.type not in ("continuous", "revolute") or not is_level(tree, wheel):
        return np.array([0.0, 1.0, 0.0])
    return np.asarray(tree.frames[wheel.child][0] @ unit_vector(wheel.axis))


def _below(tree: Tree, joint: str) -> list[UrdfJoint]:
    return tree.below(tree.joints[joint].child)


def _trail(tree: Tree, joint: UrdfJoint, wheels: Sequence[UrdfJoint]) -> float:
    """Return the least distance of wheels from an axis, across their axles [radii]."""
    frames, trails = tree.frames, []
    for wheel in wheels:
        axle = axle_of(tree, wheel)
        offset = frames[wheel.child][1] - frames[joint.child][1]
        across = abs(float(offset[0] * axle[1] - offset[1] * axle[0]))
        trails.append(across / (radius_of(tree, wheel) or np.inf))
    return min(trails)
