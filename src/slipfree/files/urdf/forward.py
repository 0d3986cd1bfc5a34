"""Forward direction of a URDF, from axles, names, steering, sensors and conventions."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from typing import NamedTuple

import numpy as np

from slipfree.files.urdf.casters import CASTER, caster_wheels
from slipfree.files.urdf.frames import WHEEL, is_last, is_level, radius_of, steered
from slipfree.files.urdf.guesses import with_fixed_rollers
from slipfree.files.urdf.tree import Tree, UrdfJoint
from slipfree.geometry.frame import unit_vector
from slipfree.records import Array

DIRECTIONS = {"x": (1.0, 0.0), "y": (0.0, 1.0), "-x": (-1.0, 0.0), "-y": (0.0, -1.0)}
OPPOSITE = {"x": "-x", "-x": "x", "y": "-y", "-y": "y"}
PARALLEL = 0.9  # axles along an axis have at least this component along it
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


NAMES = 10  # weight of names
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
