"""Guessed wheels and casters of a URDF, and its forward direction."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from math import atan2, degrees, radians
from pathlib import Path
from typing import Any

import numpy as np

from slipfree.core.errors import DataError
from slipfree.core.records import Array
from slipfree.files.urdf.evidence import (
    AXLES,
    CAMERA,
    CASTER,
    FOOTPRINT,
    LEG,
    MECANUM,
    SIDES,
    STEERING,
    TRACK,
    TRAILER,
    USUAL,
    WHEEL,
    Choice,
    Evidence,
    evidence,
    weigh,
    wheel_evidence,
    words_of,
)
from slipfree.files.urdf.meshes import MeshFiles, angles_to
from slipfree.files.urdf.roles import UrdfTable, WheelRole
from slipfree.files.urdf.tree import Link, Shape, Tree, UrdfJoint, is_about
from slipfree.files.vehicle_toml import rotation_of
from slipfree.geometry.frame import unit_vector
from slipfree.vehicle.wheel import ORIGIN

TRAIL, MAX_TRAIL = 0.2, 2.0  # trail of wheels that swivel freely [radii]; longer ones articulate
SMALL_CASTER = (
    0.8  # largest radius of casters without a name or a swivel [radii of the other wheels]
)
PARALLEL = 0.9  # least cosine of the angle between parallel axles
TOUCH = 0.1  # a ball touches the ground of the wheels within this part of its radius
FULL_TURN = 6.2  # least range of joints whose limits are those of a careless export [rad]
MIN_ROLLERS = 3  # wheels with rollers have more of them
MIN_ROLLER_ANGLE = 10.0  # least angle of rollers [degrees]
SAME_ANGLE = 0.95  # least length of the mean of unit vectors at twice the angles of rollers
DIRECTIONS = {"x": (1.0, 0.0), "y": (0.0, 1.0), "-x": (-1.0, 0.0), "-y": (0.0, -1.0)}
OPPOSITE = {"x": "-x", "-x": "x", "y": "-y", "-y": "y"}
CLEAR = 0.5  # a piece of evidence for a direction has at least this component along it
SMALL = 1e-3  # smaller vectors between places have no direction [m]
ENDS = {"front": "rear", "left": "right"}
PARTS = (
    "wheels to the URDF: joints of type 'continuous' about a level axis to links with a cylinder, "
    "or links with a sphere at a fixed joint, as of a caster"
)
TRACKS = (
    "tracks are not modelled ({}): describe each as a row of wheels, each with a link with a "
    "cylinder at a joint of type 'continuous' about the axis to the left in the URDF, or an entry "
    "in [[wheels]] of a vehicle file (TOML)"
)
LEGS = (
    "legs are not modelled ({}): describe the robot with wheels in their place, each with a link "
    "with a cylinder at a joint of type 'continuous' about a level axis"
)


def casters(
    tree: Tree, wheels: Sequence[UrdfJoint], excluded: Collection[str]
) -> Iterator[tuple[str, frozenset[str], Evidence]]:
    """Yield the casters whose wheels do not turn about a level axis of a joint.

    A caster is a joint with "caster" in a name, with the links below it, the lowest of which
    touches the ground, or a sphere that touches the ground. Its joint there, the joints of all its
    links and the evidence are yielded. It slides freely as a ball unless its wheel trails a swivel.
    """
    bottoms = [tree.bottom(wheel.child, tree.links[wheel.child].shapes) for wheel in wheels]
    ground = min(bottoms, default=np.inf)
    known = tree.fixed_to_wheels | {wheel.name for wheel in wheels}
    for joint in tree.joints.values():
        if joint.name in known or joint.name in excluded:
            continue
        parts = [joint, *tree.below(joint.child)]
        names = frozenset(part.name for part in parts)
        shapes = tree.links[joint.child].shapes
        if CASTER.search(joint.names):
            parts = [part for part in parts if part.name not in excluded]
            if known.isdisjoint(names) and (contact := _lowest_part(tree, parts, ground)):
                part, radius, reason = contact
                trail = wheel_evidence(WheelRole(radius=radius), "trail")
                is_ball = not _trails(tree, joint, part)
                yield part.name, names, _ball(radius, reason) if is_ball else trail
            known |= names
        elif tree.is_last(joint) and [shape.kind for shape in shapes] == ["sphere"]:
            radius = shapes[0].radius
            if abs(tree.bottom(joint.child, shapes) - ground) <= TOUCH * radius:
                reason = "it is a sphere that touches the ground of the wheels"
                yield joint.name, names, _ball(radius, reason)


def _ball(radius: float, reason: str) -> Evidence:
    role = WheelRole(False, radius, radius, rollers=np.pi / 2)
    return wheel_evidence(role, "ball", reason=reason)


def _lowest_part(
    tree: Tree, parts: Sequence[UrdfJoint], ground: float
) -> tuple[UrdfJoint, float, str] | None:
    """Return the part of a caster that touches the ground, its radius [m], and its reason."""
    bottoms: list[tuple[float, int, float, str]] = []  # height, index, radius, reason
    for index, joint in enumerate(parts):
        link, (rotation, origin) = tree.links[joint.child], tree.frames[joint.child]
        for shape in link.shapes:
            bottom = tree.bottom(link.name, [shape])
            bottoms.append((bottom, index, shape.radius, "radius of its shape"))
        depth = 0.0  # of the lowest point below the origin
        for box in link.boxes:
            half = np.abs((rotation @ rotation_of(box.turned))[2]) @ np.asarray(box.size) / 2
            depth = max(depth, float(half - rotation[2] @ np.asarray(box.at)))
        if not link.shapes and not link.boxes:
            depth = _mesh_depth(tree, link, rotation)
        if depth > 0:
            bottoms.append((float(origin[2]) - depth, index, depth, "radius to its lowest point"))
    if bottoms:
        _, index, radius, reason = min(bottoms)
        return parts[index], radius, reason
    height = float(tree.frames[parts[-1].child][1][2]) - ground
    return (parts[-1], height, "radius to the ground of the wheels") if height > 0 else None


def _mesh_depth(tree: Tree, link: Link, rotation: Array) -> float:
    """Return the depth of a link's meshes below its origin; zero if they are unreadable [m]."""
    files = MeshFiles(link.meshes, Path(tree.file).parent)
    try:
        points = [files.triangles(mesh).vertices for mesh in link.meshes]
    except DataError:  # the ground of the wheels gives the radius
        return 0.0
    return max((float(-(rotation @ each.T)[2].min()) for each in points), default=0.0)


def _trails(tree: Tree, head: UrdfJoint, part: UrdfJoint) -> bool:
    """Return whether a part of a caster is a disc beside the axis of the swivel above it."""
    shapes = tree.links[part.child].shapes
    if not head.moves or tree.is_level(head) or not shapes or shapes[0].kind == "sphere":
        return False
    offset = (tree.frames[part.child][1] - tree.frames[head.child][1])[:2]
    return float(np.hypot(*offset)) > TRAIL * shapes[0].radius


def with_separate_balls(tree: Tree) -> Tree:
    """Return a URDF in which balls of casters that are part of the chassis have their own links."""
    links, joints = dict(tree.links), dict(tree.joints)
    bottoms = {name: tree.bottom(name, link.shapes) for name, link in links.items()}
    moving = [joint for joint in tree.joints.values() if joint.moves]
    for name in sorted({joint.parent for joint in moving} - {joint.child for joint in moving}):
        ground = min((z for other, z in bottoms.items() if other != name), default=np.inf)
        for k, ball in enumerate(tree.links[name].shapes):
            height = abs(tree.bottom(name, [ball]) - ground)
            new, above = f"{name}_ball_{k + 1}", TOUCH * ball.radius < height < np.inf
            if ball.kind != "sphere" or above or new in joints or new in links:
                continue
            rest = tuple(shape for shape in links[name].shapes if shape != ball)
            links[name] = links[name]._replace(shapes=rest)
            links[new] = Link(new, shapes=(ball._replace(at=ORIGIN, turned=ORIGIN),))
            joints[new] = UrdfJoint(new, "fixed", name, new, ball.at)
    return replace(tree, links=links, joints=joints)


def swivels(tree: Tree, wheels: Sequence[UrdfJoint]) -> frozenset[str]:
    """Return the names of the joints about steep axes that swivel freely, as those of casters."""
    swivelling: dict[str, set[str]] = {}
    for joint in tree.joints.values():
        below = {part.name for part in tree.below(joint.child)}
        carried = [wheel for wheel in wheels if wheel.name in below]
        if not carried or not joint.moves or joint.type == "prismatic" or tree.is_level(joint):
            continue
        trails = not STEERING.search(joint.names) and (
            TRAIL < _trail(tree, joint, carried) < MAX_TRAIL
        )
        commands = [e for e in tree.evidence.get(joint.name, ()) if e.choice == "commanded"]
        is_free = joint.mimic is None and not any(each.weight > USUAL for each in commands)
        if is_free and (TRAILER.search(joint.names) or trails):
            swivelling[joint.name] = {wheel.name for wheel in carried}
    names = {wheel.name for wheel in wheels}  # if each wheel swivels, none does so freely
    return frozenset() if names == set().union(*swivelling.values()) else frozenset(swivelling)


def caster_wheels(tree: Tree, wheels: Sequence[UrdfJoint]) -> frozenset[str]:
    """Return the names of the joints of wheels that belong to casters or trailers.

    They are below joints that swivel freely, or have "caster" in a name, or are in the middle of a
    vehicle that turns only if they slide. If all wheels do, none belongs to a caster.
    """
    heads = [tree.joints[name].child for name in swivels(tree, wheels)]
    swivelling = {below.name for head in heads for below in tree.below(head)}
    above = {joint.child for joint in tree.joints.values() if CASTER.search(joint.name)}
    names = {
        wheel.name
        for wheel in wheels
        if wheel.name in swivelling or wheel.parent in above or CASTER.search(wheel.names)
    }
    names |= _middle_wheels(tree, [wheel for wheel in wheels if wheel.name not in names])
    return frozenset() if len(names) == len(wheels) else frozenset(names)


def _middle_wheels(tree: Tree, wheels: Sequence[UrdfJoint]) -> set[str]:
    """Return the names of small wheels in the middle, with one pair of wheels and no steering."""
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
    if len(pairs) != 1 or tree.steered & {wheel.name for wheel in wheels}:
        return set()
    ends = pairs[0][0] + near, pairs[0][1] - near
    radii = np.array([tree.radius_of(wheel) for wheel in wheels])
    inside = (ends[0] < left) & (left < ends[1]) & (radii > 0) & (radii < SMALL_CASTER * max(radii))
    middle = {wheel.name for wheel, is_small in zip(wheels, inside, strict=True) if is_small}
    return middle if len(middle) == len(wheels) - 2 and not middle & tree.actuated else set()


def axle_of(tree: Tree, wheel: UrdfJoint) -> Array:
    """Return the axle of a wheel in the root's frame; to the left for one that no joint turns."""
    if wheel.type not in ("continuous", "revolute") or not tree.is_level(wheel):
        return np.array([0.0, 1.0, 0.0])
    return tree.axis(wheel)


def _trail(tree: Tree, joint: UrdfJoint, wheels: Sequence[UrdfJoint]) -> float:
    """Return the least distance of wheels from an axis, across their axles [radii]."""
    trails = []
    for wheel in wheels:
        axle = axle_of(tree, wheel)
        offset = tree.frames[wheel.child][1] - tree.frames[joint.child][1]
        across = abs(float(offset[0] * axle[1] - offset[1] * axle[0]))
        trails.append(across / (tree.radius_of(wheel) or np.inf))
    return min(trails)


def with_fixed_rollers(tree: Tree) -> tuple[Tree, dict[str, Evidence]]:
    """Return a URDF in which the rollers of wheels are fixed, and these wheels by joint.

    Rollers turn about axes around that of the wheel, at the same angle to it.
    """
    joints, links, guesses = dict(tree.joints), dict(tree.links), {}
    for joint in tree.joints.values():
        below = tree.below(joint.child)
        rollers = [roller for roller in below if roller.type == "continuous"]
        if joint.type != "continuous" or len(rollers) <= MIN_ROLLERS or not tree.is_level(joint):
            continue
        axis = np.asarray(unit_vector(joint.axis))
        far = [np.linalg.norm(np.cross(roller.at, axis)) for roller in rollers]
        if not all(r.parent == joint.child for r in rollers) or np.ptp(far) > far[0] / 10:
            continue
        joints |= {each.name: each._replace(type="fixed") for each in below}
        if not links[joint.child].shapes:
            radius = float(far[0]) + replace(tree, links=links).radius_of(rollers[0])
            shape = Shape("cylinder", radius, ORIGIN, angles_to(axis))
            links[joint.child] = links[joint.child]._replace(shapes=(shape,))
        angle = _roller_angle(rollers, axis)
        fact = "rollers" if angle else "odd"
        guesses[joint.name] = wheel_evidence(WheelRole(rollers=angle), fact)
    return replace(tree, joints=joints, links=links), guesses


def _roller_angle(rollers: Sequence[UrdfJoint], axis: Array) -> float | bool:
    """Return the angle of rollers, as in `Omni`; False if it is nearly zero or not the same [rad].

    It does not depend on the sign of any axis. Angles are rounded to hundredths of a degree.
    """
    doubled = np.zeros(2)  # of doubled angles, since axes have no direction
    for roller in rollers:
        at = np.asarray(roller.at)
        outward = at - (at @ axis) * axis
        # forward at the ground, where the wheel's axis points to the right, and outward is down
        forward = np.cross(axis, outward) / np.linalg.norm(outward)
        along = rotation_of(roller.turned) @ unit_vector(roller.axis)
        angle = 2 * np.arctan2(along @ forward, along @ axis)
        doubled += np.array([np.cos(angle), np.sin(angle)]) / len(rollers)
    cosine, sine = map(float, doubled)
    mean = float(np.round(degrees(atan2(sine, cosine)) / 2, 2))
    if np.linalg.norm(doubled) < SAME_ANGLE or abs(mean) < MIN_ROLLER_ANGLE:
        return False
    return radians(90.0 if mean == -90.0 else mean)


def mecanum_wheels(tree: Tree, wheels: Sequence[UrdfJoint]) -> Iterator[tuple[str, Evidence]]:
    """Yield the wheels called mecanum wheels, also by meshes, with the usual angles of rollers.

    The URDF faces forward along x. The rollers on top of the wheels form an X.
    """
    named: list[UrdfJoint] = []
    for joint in wheels:
        link, drive = tree.links[joint.child], tree.drives.get(joint.name)
        words = [joint.names, *(mesh.name for mesh in (*link.meshes, *link.visuals))]
        named += [joint] * bool(MECANUM.search(" ".join([*words, drive.name if drive else ""])))
    if not named:
        return
    places = np.array([tree.frames[joint.child][1][:2] for joint in named])
    for joint, (ahead, left) in zip(named, places - places.mean(axis=0), strict=True):
        if min(abs(ahead), abs(left)) > SMALL:
            angle = float(np.copysign(np.pi / 4, ahead * left))
            yield joint.name, wheel_evidence(WheelRole(rollers=angle), "mecanum")


def wheel_guesses(
    tree: Tree, wheels: Sequence[UrdfJoint], unread: Collection[str], roles: UrdfTable
) -> Iterator[tuple[str, Evidence]]:
    """Yield the wheels that joints probably carry, with the name of the joint."""
    guesses = dict(_named_wheels(tree, wheels, roles))
    rolling = [*wheels, *(tree.joints[name] for name in guesses if tree.joints[name].moves)]
    for caster, parts, guess in casters(tree, rolling, roles.joints):
        guesses = {name: each for name, each in guesses.items() if name not in parts}
        guesses[caster] = guess
    yield from guesses.items()
    sized = [
        tree.joints[name]
        for name, guess in guesses.items()
        if guess.fact.radius or tree.links[tree.joints[name].child].shapes
    ]
    everything = [*wheels, *sized]
    known = {*unread, *roles.joints, *tree.fixed_to_wheels, *(wheel.name for wheel in everything)}
    ends = [j for j in tree.joints.values() if tree.is_last(j) and j.name not in known]
    for wheel in everything:
        other = tree.mirror_image(wheel, ends)
        if other is not None and tree.mirror_image(wheel, everything) is None:
            # a counterpart gives the radius of a wheel without a shape
            role = WheelRole(radius=tree.radius_of(wheel) or None)
            if role.radius is None and wheel in sized:
                role = guesses[wheel.name].fact
            yield other.name, wheel_evidence(role, "mirrored", other=wheel.name)


def _named_wheels(
    tree: Tree, wheels: Sequence[UrdfJoint], roles: UrdfTable
) -> Iterator[tuple[str, Evidence]]:
    """Yield the wheels that names, such as "wheel", or a given radius of meshes suggest."""
    frames, on_wheels = tree.frames, tree.fixed_to_wheels
    grounds = [frames[link][1][2] for link in tree.links if FOOTPRINT.search(link)]
    heights: dict[str, float] = {}
    for joint in tree.joints.values():
        link, is_named = tree.links[joint.child], WHEEL.search(joint.names)
        known = joint in wheels or joint.name in {*roles.joints, *on_wheels}
        if known or joint.type == "prismatic" or not tree.is_last(joint):
            continue
        if joint.moves and not tree.is_level(joint):
            continue
        is_ball = {shape.kind for shape in link.shapes} == {"sphere"}
        if is_ball and CASTER.search(joint.names):
            continue
        turns = joint.type == "revolute" and joint.upper - joint.lower >= FULL_TURN
        is_round = turns and any(is_about(s, unit_vector(joint.axis)) for s in link.shapes)
        height = float(frames[joint.child][1][2] - grounds[0]) if grounds else 0.0
        drive, named = tree.drives.get(joint.name), WheelRole() if is_named else None
        is_mesh = joint.type == "continuous" and link.meshes and not link.shapes
        facts = {
            "given radius": is_mesh and roles.radius and WheelRole(radius=roles.radius),
            "plugin": drive
            and drive.radius
            and joint.moves
            and not link.shapes
            and WheelRole(radius=drive.radius),
            "full turn": is_round and WheelRole(),
            "shape and limits": link.shapes and joint.type == "revolute" and named,
            "shape": link.shapes and named,
            "name": joint.moves and not link.meshes and named,
        }
        if found := next(evidence("wheel", facts), None):
            yield joint.name, found
        elif is_named and link.meshes and height > 0:
            heights[joint.name] = height
    for name in heights:  # the radius of all is that of the lowest one
        yield name, wheel_evidence(WheelRole(radius=min(heights.values())), "footprint")


def sliding_wheels(tree: Tree, wheels: Sequence[UrdfJoint]) -> Iterator[tuple[str, Evidence]]:
    """Yield the unsteered wheels that slide: axles not parallel, or casters without a swivel."""
    casters_, turned = caster_wheels(tree, wheels), tree.steered
    rolling = [
        wheel
        for wheel in wheels
        if wheel.name not in turned
        and wheel.type in ("continuous", "revolute", "fixed")
        and (not wheel.moves or tree.is_level(wheel))
    ]
    rest = [wheel for wheel in rolling if wheel.name not in casters_]
    for wheel in rolling:
        if wheel.name in casters_:
            yield wheel.name, wheel_evidence(WheelRole(False, rollers=np.pi / 2), "no swivel")
    axles = [axle_of(tree, wheel) for wheel in rest]
    if any(abs(axle @ axles[0]) < PARALLEL for axle in axles):
        for wheel in rest:
            yield wheel.name, wheel_evidence(WheelRole(rollers=np.pi / 2), "oblique")


def unused_wheel_names(
    tree: Tree, wheels: Sequence[UrdfJoint], known: Collection[str]
) -> list[str]:
    """Return the names of last joints with "wheel" in a name that belong to no wheel."""
    on_wheels = {below.name for wheel in wheels for below in [wheel, *tree.below(wheel.child)]}
    return [
        joint.name
        for joint in tree.joints.values()
        if WHEEL.search(joint.names)
        and joint.name not in {*known, *on_wheels}
        and tree.is_last(joint)
        and on_wheels.isdisjoint(below.name for below in tree.below(joint.child))
    ]


def tracks(tree: Tree, wheels: Collection[str]) -> list[str]:
    """Return the names of links called tracks that carry no wheels, and of plugins for tracks."""
    plugins = (plugin.name.split() for plugin in tree.plugins)
    names = [word for words in plugins for word in words[:1] if "track" in word.lower()]
    for joint in tree.joints.values():
        parts = {joint.name, *(below.name for below in tree.below(joint.child))}
        if parts.isdisjoint(wheels) and any(map(TRACK.fullmatch, words_of(joint.child))):
            names.append(joint.child)
    return names


def wheel_remedy(tree: Tree, wheels: Collection[str]) -> tuple[str, dict[str, WheelRole]]:
    """Return what to do about too few wheels: words, and the wheels that names or axes suggest."""
    ends = [j for j in tree.joints.values() if tree.is_last(j) and j.name not in wheels]
    if found := tracks(tree, wheels):
        return TRACKS.format(", ".join(found)), {}
    steering = [
        j.name
        for j in ends
        if j.moves
        and j.type != "prismatic"
        and not tree.is_level(j)
        and (tree.links[j.child].shapes or STEERING.search(j.names))
    ]
    if len(steering) + len(wheels) > 2:
        return (
            f"the axles of the wheels are missing: {', '.join(steering)} turn about steep axes, "
            "which steers wheels; add to the link of each a joint of type 'continuous' about a "
            "level axis, whose child is the wheel",
            {},
        )
    chains = {
        end.name: [j for j in tree.joints.values() if j.moves and end in tree.below(j.child)]
        for end in ends
    }
    legs = [
        e.name
        for e in ends
        if any(map(LEG.fullmatch, words_of(e.names))) or (e.moves and len(chains[e.name]) > 1)
    ]
    if len(legs) > 2:
        return LEGS.format(", ".join(legs)), {}
    named = [j for j in ends if WHEEL.search(j.names) or CASTER.search(j.names)]
    level = [j for j in ends if j.type == "continuous" and tree.is_level(j)]
    radius = usual_radius(tree, named or level)
    return f"add {PARTS}", {
        joint.name: WheelRole(radius=None if tree.links[joint.child].shapes else radius)
        for joint in named or level
    }


def usual_radius(tree: Tree, joints: Sequence[UrdfJoint]) -> float:
    """Return an example of a radius: of wheels with a shape, or a quarter of the least distance."""
    radii = [tree.radius_of(j) for j in tree.joints.values() if j.type == "continuous"]
    known = [radius for radius in radii if 0 < radius < 1]
    places = [tree.frames[joint.child][1] for joint in joints]
    apart = min((float(np.linalg.norm(a - b)) for a, b in combinations(places, 2)), default=0.0)
    return float(f"{max(known, default=apart / 4 or 0.1):.2g}")


def _sides(name: str) -> set[str]:
    words = words_of(name)
    return {side for side, pattern in SIDES.items() if any(map(pattern.fullmatch, words))}


def forward_guess(tree: Tree, excluded: Collection[str] = ()) -> Choice:
    """Return the axis of the root link that probably points forward.

    The reason is empty if the evidence agrees with the convention; the choice is open without
    evidence, too.
    """
    tree, _ = with_fixed_rollers(tree)
    turning = [
        joint
        for joint in tree.joints.values()
        if joint.type == "continuous"
        and tree.is_last(joint)
        and (tree.links[joint.child].shapes or tree.links[joint.child].meshes)
        and not CASTER.search(joint.names)
        and tree.is_level(joint)
    ]
    radii = [tree.radius_of(joint) for joint in turning]
    bottoms = [tree.frames[j.child][1][2] - r for j, r in zip(turning, radii, strict=True)]
    most = min(bottoms, default=0.0) + max(radii, default=0.0)
    rolling = [j for j, low in zip(turning, bottoms, strict=True) if low <= most or not any(radii)]
    excluded = {*excluded, *caster_wheels(tree, rolling)}
    wheels = [joint for joint in rolling if joint.name not in excluded]
    line = _along(tree, wheels)
    called = [j for j in tree.joints.values() if WHEEL.search(j.names)]
    named = {ahead: _named_vector(tree, wheels, called, ahead) for ahead in ENDS}
    misplaced = _misplaced(tree, wheels, line, np.sum([v for v, _ in named.values()], axis=0))
    view = np.zeros(2)
    for link, (rotation, _) in tree.frames.items():
        if CAMERA.search(link) and not _sides(link) & {"rear", "left", "right"}:
            view += rotation[:2, 2 if "optical" in link.lower() else 0]
    vectors = {"steered": _to_steered(tree, wheels), "view": view}
    if "x" not in line:
        x, y = np.sum([tree.axis(joint)[:2] for joint in wheels], axis=0)
        vectors["axes"] = np.array([y, -x])
    for side, (vector, is_of_wheels) in named.items():
        vectors[f"{side} of wheels" if is_of_wheels and not misplaced else side] = vector
    facts: dict[str, Any] = {**misplaced, "convention": "x" in line}
    for fact, vector in vectors.items():
        size = float(np.linalg.norm(vector))
        along = {name: float(vector @ DIRECTIONS[name]) for name in line}
        ahead = max(line, key=lambda name: along[name])
        if size > SMALL and along[ahead] > CLEAR * size:
            facts[fact] = ahead
        else:
            facts[fact.replace(" of wheels", " on axles")] = size > SMALL and " of " in fact
    pieces = [*evidence("forward", facts)]
    best, reason, rival, is_open, _ = weigh(pieces, line[0])
    if "x" not in line and not any(piece.weight for piece in pieces):
        words = "the axles point along x, and no name distinguishes front from rear"
        return Choice(best, reason or words, OPPOSITE[best], True)
    if best == AXLES:
        best, rival, is_open = line[0], "", True
    is_noted = best != "x" or any(piece.choice != "x" for piece in pieces)
    other = rival if rival in OPPOSITE else OPPOSITE[best]
    return Choice(best, reason if is_noted else "", other, is_open)


def _along(tree: Tree, wheels: Sequence[UrdfJoint]) -> tuple[str, ...]:
    """Return the directions in which the unsteered wheels roll, or all without a common one."""
    turned = tree.steered
    axles = [np.abs(tree.axis(joint)) for joint in wheels if joint.name not in turned]
    least = np.min(axles, axis=0) if axles else np.zeros(3)
    if least[0] >= PARALLEL:
        return "y", "-y"
    return ("x", "-x") if least[1] >= PARALLEL else ("x", "-x", "y", "-y")


def _named_vector(
    tree: Tree, wheels: Sequence[UrdfJoint], rolling: Sequence[UrdfJoint], first: str
) -> tuple[Array, bool]:
    """Return the forward vector by names of two ends, and whether they are those of wheels."""
    ends, group = (first, ENDS[first]), [*wheels, *rolling]
    is_of_wheels = any({*ends} & _sides(j.names) for j in group)
    group = group if is_of_wheels else [*tree.joints.values()]
    ahead, behind = ([j for j in group if end in _sides(j.names)] for end in ends)
    if not (ahead or behind) or not (wheels or (ahead and behind)):
        return np.zeros(2), is_of_wheels
    to, start = (  # the mean of all wheels replaces a missing one
        np.mean([tree.frames[joint.child][1][:2] for joint in side or wheels], axis=0)
        for side in (ahead, behind)
    )
    x, y = to - start
    return np.array([y, -x] if first == "left" else [x, y]), is_of_wheels


def _misplaced(
    tree: Tree, wheels: Sequence[UrdfJoint], line: Sequence[str], forward: Array
) -> dict[str, str]:
    """Return the wheels whose names contradict the places of others, as facts on the names."""
    places = {wheel.name: tree.frames[wheel.child][1][:2] for wheel in wheels}
    along = {name: float(forward @ axis) for name, axis in DIRECTIONS.items()}
    ahead = max(along, key=lambda name: along[name])
    x, y = DIRECTIONS[ahead if along[ahead] > SMALL else line[0]]
    facts: dict[str, str] = {}
    for (first, second), axis in zip(ENDS.items(), ((x, y), (-y, x)), strict=True):
        of = {
            side: {
                wheel: float(places[wheel.name] @ axis)
                for wheel in wheels
                if _sides(wheel.names) & {first, second} == {side}
            }
            for side in (first, second)
        }
        if not all(of.values()):
            continue
        middle = sum(float(np.mean([*each.values()])) for each in of.values()) / 2
        wrong = [wheel.name for wheel, at in of[first].items() if at < middle - SMALL]
        wrong += [wheel.name for wheel, at in of[second].items() if at > middle + SMALL]
        if len(wrong) < sum(map(len, of.values())):
            facts[f"{first} misplaced"] = ", ".join(wrong)
    return {fact: names for fact, names in facts.items() if names}


def _to_steered(tree: Tree, wheels: Sequence[UrdfJoint]) -> Array:
    """Return the vector to steered wheels from the others; zero for steered wheels at both ends."""
    turned = tree.steered
    places = {wheel.name: tree.frames[wheel.child][1][:2] for wheel in wheels}
    rest = [place for name, place in places.items() if name not in turned]
    if len(rest) in (0, len(places)):
        return np.zeros(2)
    offsets = [place - np.mean(rest, axis=0) for name, place in places.items() if name in turned]
    mean = np.mean(offsets, axis=0)
    return np.asarray(mean) if min(offset @ mean for offset in offsets) > 0 else np.zeros(2)
