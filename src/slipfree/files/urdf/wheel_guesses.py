"""Guessed wheels of a URDF, and its forward direction."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from math import atan2, degrees, radians
from typing import NamedTuple

import numpy as np

from slipfree.core.records import Array
from slipfree.files.urdf.joint_guesses import CASTER, PARALLEL, axle_of, caster_wheels, casters
from slipfree.files.urdf.meshes import angles_to
from slipfree.files.urdf.roles import Roles, WheelRole
from slipfree.files.urdf.tree import WHEEL, Shape, Tree, UrdfJoint, is_about
from slipfree.files.vehicle_draft import rotation_of
from slipfree.geometry.frame import unit_vector
from slipfree.vehicle.wheel import ORIGIN

FOOTPRINT = re.compile("footprint", re.IGNORECASE)  # link on the ground, by REP 120
FULL_TURN = 6.2  # least range of joints whose limits are those of a careless export [rad]
MIN_ROLLERS = 3  # wheels with rollers have more of them
MIN_ROLLER_ANGLE = 10.0  # least angle of rollers [degrees]
SAME_ANGLE = 0.95  # least length of the mean of unit vectors at twice the angles of rollers
MECANUM = re.compile("mecanum|swedish", re.IGNORECASE)
DIRECTIONS = {"x": (1.0, 0.0), "y": (0.0, 1.0), "-x": (-1.0, 0.0), "-y": (0.0, -1.0)}
OPPOSITE = {"x": "-x", "-x": "x", "y": "-y", "-y": "y"}
CLEAR = 0.5  # a piece of evidence for a direction has at least this component along it
SMALL = 1e-3  # smaller vectors between places have no direction [m]
CAMERA = re.compile("camera|kinect|realsense", re.IGNORECASE)
END = r"(front|rear|back|hind|mid|middle|center|centre)?"
# words of names: front, left_front, leftFront, FL, lf, ...
SIDES = {
    "front": re.compile("front|fore|(left|right)front|front(left|right)|f|[fl]f|f[lr]|rf"),
    "rear": re.compile("(left|right)?(rear|back|hind)(left|right)?|[rb][lr]|[lr]b|lr"),
    "left": re.compile(f"{END}left{END}|l|[frbmc]l|l[frbmc]"),
    "right": re.compile(f"{END}right{END}|r|[frbmc]r|r[fbmc]"),
}
NAMES = 10  # weight of names, which exceeds the sum of all other weights


class WheelGuess(NamedTuple):
    """Guessed properties of a wheel that a URDF does not describe completely, and the reason."""

    role: WheelRole
    reason: str


def with_fixed_rollers(tree: Tree) -> tuple[Tree, dict[str, WheelGuess]]:
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
        reason = "with rollers, at the angle of their axes"
        if not angle:
            reason = "its rollers have axes along its own, or at different angles to it"
        guesses[joint.name] = WheelGuess(WheelRole(rollers=angle), reason)
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


def mecanum_wheels(tree: Tree, wheels: Sequence[UrdfJoint]) -> Iterator[tuple[str, WheelGuess]]:
    """Yield the wheels called mecanum wheels, also by meshes, with the usual angles of rollers.

    The URDF faces forward along x. The rollers on top of the wheels form an X.
    """
    links = {joint.name: tree.links[joint.child] for joint in wheels}
    meshes = {name: [m.name for m in (*link.meshes, *link.visuals)] for name, link in links.items()}
    named = [j for j in wheels if MECANUM.search(" ".join([j.names, *meshes[j.name]]))]
    if not named:
        return
    places = np.array([tree.frames[joint.child][1][:2] for joint in named])
    for joint, (ahead, left) in zip(named, places - places.mean(axis=0), strict=True):
        if min(abs(ahead), abs(left)) > SMALL:
            angle = float(np.copysign(np.pi / 4, ahead * left))
            reason = "with oblique rollers: its name; on top of the wheels, their axes form an X"
            yield joint.name, WheelGuess(WheelRole(rollers=angle), reason)


def wheel_guesses(
    tree: Tree, wheels: Sequence[UrdfJoint], unread: Collection[str], roles: Roles
) -> Iterator[tuple[str, WheelGuess]]:
    """Yield the wheels that joints probably carry, with the name of the joint."""
    guesses = dict(_named_wheels(tree, wheels, roles))
    rolling = [*wheels, *(tree.joints[name] for name in guesses if tree.joints[name].moves)]
    for caster in casters(tree, rolling, roles.joints):
        guesses = {name: guess for name, guess in guesses.items() if name not in caster.parts}
        role, reason = WheelRole(radius=caster.radius), "it trails the axis of a caster"
        if caster.is_ball:
            role = WheelRole(False, caster.radius, caster.radius, rollers=np.pi / 2)
            reason = f"a caster slides freely as a ball; {caster.reason}"
        guesses[caster.joint] = WheelGuess(role, reason)
    yield from guesses.items()
    # a counterpart gives the radius of a wheel without a shape
    sized = {
        name: guess
        for name, guess in guesses.items()
        if guess.role.radius or tree.links[tree.joints[name].child].shapes
    }
    yield from _counterparts(tree, wheels, sized, {*unread, *roles.joints})


def _named_wheels(
    tree: Tree, wheels: Sequence[UrdfJoint], roles: Roles
) -> Iterator[tuple[str, WheelGuess]]:
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
        height = float(frames[joint.child][1][2] - grounds[0]) if grounds else 0.0
        role, reason = WheelRole(), ""
        if joint.type == "continuous" and roles.radius and link.meshes and not link.shapes:
            role, reason = WheelRole(radius=roles.radius), "a mesh, its given radius"
        elif turns and any(is_about(shape, unit_vector(joint.axis)) for shape in link.shapes):
            reason = "a round shape and a full turn, in spite of its limits"
        elif is_named and link.shapes:
            limits = "" if joint.type != "revolute" else ", in spite of its limits"
            reason = f"its name and a round shape{limits}"
        elif is_named and link.meshes and height > 0:
            heights[joint.name] = height
        elif is_named and joint.moves and not link.meshes:
            reason = "its name"
        if reason:
            yield joint.name, WheelGuess(role, reason)
    reason = "its name, without a round shape; radius from the least height above the footprint"
    for name in heights:  # the radius of all is that of the lowest one
        yield name, WheelGuess(WheelRole(radius=min(heights.values())), reason)


def _counterparts(
    tree: Tree,
    wheels: Sequence[UrdfJoint],
    guesses: Mapping[str, WheelGuess],
    excluded: Collection[str],
) -> Iterator[tuple[str, WheelGuess]]:
    """Yield the wheels opposite to a wheel that has no opposite wheel."""
    everything = [*wheels, *(tree.joints[name] for name in guesses)]
    known = {*excluded, *tree.fixed_to_wheels, *(wheel.name for wheel in everything)}
    ends = [j for j in tree.joints.values() if tree.is_last(j) and j.name not in known]
    for wheel in everything:
        other = tree.mirror_image(wheel, ends)
        if other is not None and tree.mirror_image(wheel, everything) is None:
            role = WheelRole(radius=tree.radius_of(wheel) or None)
            if role.radius is None and wheel.name in guesses:
                role = guesses[wheel.name].role
            reason = f"its counterpart on the other side, {wheel.name}, is one"
            yield other.name, WheelGuess(role, reason)


def sliding_wheels(tree: Tree, wheels: Sequence[UrdfJoint]) -> Iterator[tuple[str, WheelGuess]]:
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
            reason = "a caster without a swivel slides freely along its axle"
            yield wheel.name, WheelGuess(WheelRole(False, rollers=np.pi / 2), reason)
    axles = [axle_of(tree, wheel) for wheel in rest]
    if any(abs(axle @ axles[0]) < PARALLEL for axle in axles):
        for wheel in rest:
            reason = "with rollers, since the axles are not parallel"
            yield wheel.name, WheelGuess(WheelRole(rollers=np.pi / 2), reason)


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


class Evidence(NamedTuple):
    """Evidence for a forward axis of the root link, empty if it contradicts the axles."""

    reason: str
    direction: str
    weight: int


class Forward(NamedTuple):
    """Forward direction of a URDF."""

    direction: str  # axis of the root link that probably points forward
    reason: str  # evidence for it, and against it; empty if it agrees with the convention
    other: str  # axis that the other choice would be
    is_open: bool = False  # if the evidence is absent or contradictory: must be given


def _sides(name: str) -> set[str]:
    spaced = re.sub("([a-z0-9])([A-Z])", r"\1 \2", name)
    words = re.findall("[a-z]+", spaced.lower())
    return {side for side, pattern in SIDES.items() if any(map(pattern.fullmatch, words))}


def forward_guess(tree: Tree, excluded: Collection[str] = ()) -> Forward:
    """Return the axis of the root link that probably points forward."""
    tree, _ = with_fixed_rollers(tree)
    rolling = _turning(tree)
    excluded = {*excluded, *caster_wheels(tree, rolling)}
    wheels = [joint for joint in rolling if joint.name not in excluded]
    line = _along(tree, wheels)
    evidence = [*_evidence(tree, wheels, line)]
    named = {each.direction for each in evidence if each.weight == NAMES}
    reasons = "; ".join(
        f"{each.reason}: {each.direction or 'along the axles'}" for each in evidence
    )
    if len(named) > 1 or "" in named:
        first = min(named - {""}, default=line[0])
        return Forward(first, f"the evidence disagrees ({reasons})", OPPOSITE[first], True)
    scores = {
        name: sum(each.weight for each in evidence if each.direction == name) for name in line
    }
    best = max(line, key=lambda name: scores[name])
    rivals = [name for name in line if name != best and scores[name]]
    if best != "x" and scores[best] == max((scores[name] for name in rivals), default=0):
        reason = "the axles point along x, and no name distinguishes front from rear"
        return Forward(best, reasons or reason, OPPOSITE[best], True)
    other = max(rivals, key=lambda name: scores[name]) if rivals else OPPOSITE[best]
    return Forward(best, reasons if best != "x" or rivals else "", other)


def _turning(tree: Tree) -> list[UrdfJoint]:
    """Return the joints that probably carry rolling wheels, near the ground, but no casters."""
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
    return [j for j, low in zip(turning, bottoms, strict=True) if low <= most or not any(radii)]


def _along(tree: Tree, wheels: Sequence[UrdfJoint]) -> tuple[str, ...]:
    """Return the directions in which the unsteered wheels roll, or all without a common one."""
    turned = tree.steered
    axles = [np.abs(tree.axis(joint)) for joint in wheels if joint.name not in turned]
    least = np.min(axles, axis=0) if axles else np.zeros(3)
    if least[0] >= PARALLEL:
        return "y", "-y"
    return ("x", "-x") if least[1] >= PARALLEL else ("x", "-x", "y", "-y")


def _evidence(tree: Tree, wheels: Sequence[UrdfJoint], line: tuple[str, ...]) -> Iterator[Evidence]:
    """Yield the evidence for directions among those in which the wheels roll."""
    vectors = [
        *_named_vectors(tree, wheels),
        ("steered wheels", _to_steered(tree, wheels), 2),
        ("views of cameras", _view(tree), 1),
    ]
    if "x" not in line:
        x, y = np.sum([tree.axis(joint)[:2] for joint in wheels], axis=0)
        vectors.append(("signs of the wheels' axes", np.array([y, -x]), 1))
    for reason, vector, weight in vectors:
        size = float(np.linalg.norm(vector))
        along = {name: float(vector @ DIRECTIONS[name]) for name in line}
        best = max(line, key=lambda name: along[name])
        if size > SMALL and (along[best] > CLEAR * size or weight == NAMES):
            yield Evidence(reason, best if along[best] > CLEAR * size else "", weight)
    if "x" in line:
        yield Evidence("the frame convention of URDF", "x", 2)


def _named_vectors(tree: Tree, wheels: Sequence[UrdfJoint]) -> Iterator[tuple[str, Array, int]]:
    """Yield the forward vectors by names of front and rear, left and right, with their weights."""
    rolling = [j for j in tree.joints.values() if WHEEL.search(j.names)]
    for first, second in (("front", "rear"), ("left", "right")):
        group, weight = [*wheels, *rolling], NAMES
        if not any({first, second} & _sides(j.names) for j in group):
            group, weight = [*tree.joints.values()], 1
        ahead, behind = ([j for j in group if s in _sides(j.names)] for s in (first, second))
        vector = np.zeros(2)
        if (ahead or behind) and (wheels or (ahead and behind)):
            to, start = (  # the mean of all wheels replaces a missing one
                np.mean([tree.frames[joint.child][1][:2] for joint in side or wheels], axis=0)
                for side in (ahead, behind)
            )
            vector = to - start
        if first == "left":
            vector = np.array([vector[1], -vector[0]])
        yield f"names of {first} and {second}", vector, weight


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


def _view(tree: Tree) -> Array:
    total = np.zeros(2)
    for link, (rotation, _) in tree.frames.items():
        if CAMERA.search(link) and not _sides(link) & {"rear", "left", "right"}:
            total += rotation[:2, 2 if "optical" in link.lower() else 0]
    return total
