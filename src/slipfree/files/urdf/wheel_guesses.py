"""Guessed wheels of a URDF, and its forward direction."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slipfree.files.urdf.joint_guesses import CASTER, PARALLEL, axle_of, caster_wheels, casters
from slipfree.files.urdf.meshes import angles_to
from slipfree.files.urdf.roles import Roles, WheelRole
from slipfree.files.urdf.tree import (
    WHEEL,
    Link,
    Shape,
    Tree,
    UrdfJoint,
    fixed_to_wheels,
    is_about,
    is_last,
    is_level,
    mirror_image,
    radius_of,
    steered,
)
from slipfree.files.vehicle_draft import rotation_of
from slipfree.geometry.frame import unit_vector
from slipfree.records import Array
from slipfree.vehicle.wheel import ORIGIN

FOOTPRINT = re.compile("footprint", re.IGNORECASE)  # link on the ground, by REP 120
FULL_TURN = 6.2  # least range of joints whose limits are those of a careless export [rad]
MIN_ROLLERS = 3  # wheels with rollers have more of them
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
NAMES = 10  # weight of names


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


class Evidence(NamedTuple):
    """Evidence for a forward direction.

    Attributes
    ----------
    reason : str
        Description of the evidence.
    direction : str
        Axis of the root link that it indicates; empty if it contradicts the axles.
    weight : int
        Weight; that of names exceeds the sum of all other weights.
    """

    reason: str
    direction: str
    weight: int


BASE = Evidence("the frame convention of URDF", "x", 2)


class Forward(NamedTuple):
    """Forward direction of a URDF.

    Attributes
    ----------
    direction : {"x", "-x", "y", "-y"}
        Axis of the root link that probably points forward.
    reason : str
        Evidence for it, and against it; empty for evidence that only agrees with the convention.
    other : str
        Axis that the other choice would be.
    is_open : bool
        Whether the evidence is absent or contradictory, so that the direction must be given.
    """

    direction: str
    reason: str
    other: str
    is_open: bool = False


def sides(name: str) -> set[str]:
    """Return the sides in a name: "front" or "rear", and "left" or "right"."""
    spaced = re.sub("([a-z0-9])([A-Z])", r"\1 \2", name)
    words = re.findall("[a-z]+", spaced.lower())
    return {side for side, pattern in SIDES.items() if any(map(pattern.fullmatch, words))}


def forward_guess(tree: Tree, excluded: Collection[str] = ()) -> Forward:
    """Return the axis of the root link that probably points forward.

    Parameters
    ----------
    tree : Tree
        The URDF.
    excluded : collection of str
        Names of joints that carry no wheels.
    """
    tree, _ = with_fixed_rollers(tree)
    rolling = _turning(tree)
    excluded = {*excluded, *caster_wheels(tree, rolling)}
    wheels = [joint for joint in rolling if joint.name not in excluded]
    line = _along(tree, wheels)
    evidence = [*_evidence(tree, wheels, line)]
    found = {each.direction for each in evidence if each.weight == NAMES}
    reasons = "; ".join(
        f"{each.reason}: {each.direction or 'along the axles'}" for each in evidence
    )
    if len(found) > 1 or "" in found:
        first = min(found - {""}, default=line[0])
        return Forward(first, f"the evidence disagrees ({reasons})", OPPOSITE[first], True)
    scores = {
        name: sum(each.weight for each in evidence if each.direction == name) for name in line
    }
    best = max(line, key=lambda name: scores[name])
    rivals = [name for name in line if name != best and scores[name]]
    if best != "x" and scores[best] == max((scores[name] for name in rivals), default=0):
        words = reasons or "the axles point along x, and no name distinguishes front from rear"
        return Forward(best, words, OPPOSITE[best], True)
    other = max(rivals, key=lambda name: scores[name]) if rivals else OPPOSITE[best]
    return Forward(best, reasons if best != "x" or rivals else "", other)


def _turning(tree: Tree) -> list[UrdfJoint]:
    """Return the joints that probably carry rolling wheels, near the ground, but no casters."""
    found = [
        joint
        for joint in tree.joints.values()
        if joint.type == "continuous"
        and is_last(tree, joint)
        and (tree.links[joint.child].shapes or tree.links[joint.child].meshes)
        and not CASTER.search(f"{joint.name} {joint.child}")
        and is_level(tree, joint)
    ]
    radii = {joint.name: radius_of(tree, joint) for joint in found}
    bottoms = {j.name: tree.frames[j.child][1][2] - radii[j.name] for j in found}
    most = min(bottoms.values(), default=0.0) + max(radii.values(), default=0.0)
    return [joint for joint in found if bottoms[joint.name] <= most or not any(radii.values())]


def _along(tree: Tree, wheels: Sequence[UrdfJoint]) -> tuple[str, ...]:
    """Return the directions in which the unsteered wheels roll, or all without a common one."""
    frames, turned = tree.frames, steered(tree)
    axles = [
        np.abs(frames[joint.child][0] @ unit_vector(joint.axis))
        for joint in wheels
        if joint.name not in turned
    ]
    least = np.min(axles, axis=0) if axles else np.zeros(3)
    if least[0] >= PARALLEL:
        return "y", "-y"
    return ("x", "-x") if least[1] >= PARALLEL else ("x", "-x", "y", "-y")


def _evidence(tree: Tree, wheels: Sequence[UrdfJoint], line: tuple[str, ...]) -> Iterator[Evidence]:
    """Yield the evidence for directions among those in which the wheels roll."""
    frames = tree.frames
    named, weights = _named_sides(tree, wheels)
    left = _between(tree, named["left"], named["right"], wheels)
    vectors = [
        (
            "names of front and rear",
            _between(tree, named["front"], named["rear"], wheels),
            weights["rear"],
        ),
        ("names of left and right", np.array([left[1], -left[0]]), weights["right"]),
        ("steered wheels", _to_steered(tree, wheels), 2),
        ("views of cameras", _view(tree), 1),
    ]
    if "x" not in line:
        axles = [(frames[joint.child][0] @ unit_vector(joint.axis))[:2] for joint in wheels]
        x, y = np.sum(axles, axis=0)
        vectors.append(("signs of the wheels' axes", np.array([y, -x]), 1))
    for reason, vector, weight in vectors:
        size = float(np.linalg.norm(vector))
        along = {name: float(vector @ DIRECTIONS[name]) for name in line}
        best = max(line, key=lambda name: along[name])
        if size > SMALL and (along[best] > CLEAR * size or weight == NAMES):
            yield Evidence(reason, best if along[best] > CLEAR * size else "", weight)
    if "x" in line:
        yield BASE


def _named_sides(
    tree: Tree, wheels: Sequence[UrdfJoint]
) -> tuple[dict[str, list[UrdfJoint]], dict[str, int]]:
    """Return the joints whose names contain each side, and the weights of these names.

    They are those of wheels if there are any, else all other joints, with a small weight.
    """
    rolling = [j for j in tree.joints.values() if WHEEL.search(f"{j.name} {j.child}")]
    found: dict[str, list[UrdfJoint]] = {}
    weights: dict[str, int] = {}
    for pair in (("front", "rear"), ("left", "right")):
        for group, weight in (([*wheels, *rolling], NAMES), ([*tree.joints.values()], 1)):
            for side in pair:
                found[side] = [j for j in group if side in sides(j.name) | sides(j.child)]
            weights |= dict.fromkeys(pair, weight)
            if any(found[side] for side in pair):
                break
    return found, weights


def _between(
    tree: Tree, ahead: list[UrdfJoint], behind: list[UrdfJoint], wheels: Sequence[UrdfJoint]
) -> Array:
    """Return the vector between the means of places; that of all wheels replaces a missing one."""
    frames = tree.frames
    if not (ahead or behind) or not (wheels or (ahead and behind)):
        return np.zeros(2)
    first, second = (
        np.mean([frames[joint.child][1][:2] for joint in group or wheels], axis=0)
        for group in (ahead, behind)
    )
    return np.asarray(first - second)


def _to_steered(tree: Tree, wheels: Sequence[UrdfJoint]) -> Array:
    """Return the vector to steered wheels from the others; zero for steered wheels at both ends."""
    frames, turned = tree.frames, steered(tree)
    places = {wheel.name: frames[wheel.child][1][:2] for wheel in wheels}
    rest = [place for name, place in places.items() if name not in turned]
    if len(rest) in (0, len(places)):
        return np.zeros(2)
    offsets = [place - np.mean(rest, axis=0) for name, place in places.items() if name in turned]
    mean = np.mean(offsets, axis=0)
    return np.asarray(mean) if min(offset @ mean for offset in offsets) > 0 else np.zeros(2)


def _view(tree: Tree) -> Array:
    """Return the sum of the horizontal viewing directions of the cameras."""
    total = np.zeros(2)
    for link, (rotation, _) in tree.frames.items():
        if CAMERA.search(link) and not sides(link) & {"rear", "left", "right"}:
            total += rotation[:2, 2 if "optical" in link.lower() else 0]
    return total
