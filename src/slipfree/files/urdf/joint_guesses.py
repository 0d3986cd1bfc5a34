"""Guesses for a URDF: casters, and kinds of joints (steering, swivel, suspension, differential)."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np

from slipfree.core.errors import DataError
from slipfree.core.records import Array
from slipfree.files.urdf.evidence import (
    CASTER,
    STEERING,
    TRAILER,
    USUAL,
    Choice,
    Evidence,
    evidence,
    weigh,
    wheel_evidence,
)
from slipfree.files.urdf.meshes import MeshFiles
from slipfree.files.urdf.roles import UrdfTable, WheelRole
from slipfree.files.urdf.tree import Link, Mimic, Tree, UrdfJoint
from slipfree.files.vehicle_draft import rotation_of
from slipfree.vehicle.wheel import ORIGIN

TRAIL, MAX_TRAIL = 0.2, 2.0  # trail of wheels that swivel freely [radii]; longer ones articulate
SMALL = 0.8  # largest radius of casters without a name or a swivel [radii of the other wheels]
PARALLEL = 0.9  # least cosine of the angle between parallel axles
TOUCH = 0.1  # a ball touches the ground of the wheels within this part of its radius
LATERAL = 0.9  # axes of opposite rockers have at least this component to the left, or to the right


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


def _swivels(tree: Tree, wheels: Sequence[UrdfJoint]) -> frozenset[str]:
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
    heads = [tree.joints[name].child for name in _swivels(tree, wheels)]
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
    inside = (ends[0] < left) & (left < ends[1]) & (radii > 0) & (radii < SMALL * max(radii))
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


def _fixed(fact: str) -> Choice:
    return weigh(evidence("kind", {fact: True}))._replace(rival="commanded")


NO_WHEEL, BALLS, TOO_MANY = map(_fixed, ("no wheel", "balls", "too many"))


class Joints:
    """Joints of a URDF whose values are unknown, with the wheels that they carry.

    The URDF faces forward along x. ``balls`` are the names of wheels that slide freely.
    """

    def __init__(
        self, tree: Tree, wheels: Sequence[UrdfJoint], balls: set[str], roles: UrdfTable
    ) -> None:
        self._tree, self._roles, self._balls = tree, roles, balls
        self._wheels = [*wheels]
        names = {wheel.name for wheel in wheels}
        on_wheels = {below.name for wheel in wheels for below in tree.below(wheel.child)}
        self._free = {
            name: joint
            for name, joint in tree.joints.items()
            if joint.moves
            and name not in {*names, *on_wheels}
            and joint.type not in ("floating", "planar")
            and joint.lower != joint.upper
        }
        self._own = {
            name: names & {below.name for below in tree.below(joint.child)}
            for name, joint in tree.joints.items()
        }
        self._carried = dict(self._own)
        for name in tree.joints:  # a joint also moves the wheels of the joints that mimic it
            for leader in self._leaders(name):
                self._carried[leader] = self._carried[leader] | self._carried[name]
        rolling = [wheel for wheel in self._wheels if wheel.name not in balls]
        self._swivelling = _swivels(tree, rolling)
        carrying = [each for name, each in self._free.items() if self._carried[name]]
        self._choices = {joint.name: self._choice(joint, carrying) for joint in carrying}

    def _leaders(self, name: str) -> list[str]:
        """Return the joints that a joint follows through its mimics."""
        chain = self._tree.followed(self._tree.joints[name], self._roles.joints)
        return [joint.name for joint in chain[1:]]

    def _rocks(self, joint: UrdfJoint) -> bool:
        followers = [
            follower
            for name, follower in self._tree.joints.items()
            if joint.name in self._leaders(name) and self._carried[name]
        ]
        return any(
            self._tree.is_level(mover) != (mover.type == "prismatic")
            for mover in followers or [joint]
        )

    def _choice(self, joint: UrdfJoint, carrying: Sequence[UrdfJoint]) -> Choice:
        """Return the kind of a joint by the evidence for it and its counterpart."""
        kind = self._rocks(joint), joint.type == "prismatic"
        alike = [o for o in carrying if (self._rocks(o), o.type == "prismatic") == kind]
        other = self._tree.mirror_image(joint, alike)
        both = [joint] if other is None or other.mimic else [joint, other]
        return weigh(piece for each in both for piece in self._evidence(each))

    def _evidence(self, joint: UrdfJoint) -> Iterator[Evidence]:
        rocks, slides = self._rocks(joint), joint.type == "prismatic"
        facts = {
            "rocks": rocks,
            "rocker": rocks and joint.names,
            "slides": slides and not rocks,
            "turns": not (slides or rocks),
            "swivels": joint.name in self._swivelling,
        }
        yield from evidence("kind", facts)
        yield from self._tree.evidence.get(joint.name, ())

    def kinds(self) -> dict[str, Choice]:
        """Return the probable kinds of the joints without a role, unless actuators agree."""
        declared = [role.kind for role in self._roles.joints.values()].count("suspension")
        left = len(self._wheels) - 3 - declared
        kinds: dict[str, Choice] = {}
        candidates: dict[str, UrdfJoint] = {}
        for name, joint in self._free.items():
            if name in self._roles.joints or self._leaders(name):
                continue
            choice = self._choices.get(name)
            if name in self._tree.actuated and (choice is None or choice.choice == "commanded"):
                if choice is not None and choice.rival:
                    kinds[name] = self._guess(choice, left)
            elif choice is None:
                kinds[name] = NO_WHEEL
            elif self._carried[name] <= self._balls:
                kinds[name] = BALLS
            elif choice.choice == "suspension":
                candidates[name] = joint
            else:
                kinds[name] = self._guess(choice, left)
        for name, joint in candidates.items():
            other = self._tree.mirror_image(joint, candidates.values())
            pair = {name} if other is None else {name, other.name}
            if name not in kinds:
                guess = self._guess(self._choices[name], left)
                if len(pair) > left:
                    also = f"; {guess.reason}" if guess.alike else ""
                    guess = TOO_MANY._replace(reason=TOO_MANY.reason + also, alike=guess.alike)
                left -= len(pair) if len(pair) <= left else 0
                kinds |= dict.fromkeys(pair, guess)
        return kinds

    def _guess(self, choice: Choice, left: int) -> Choice:
        """Return the guess of a choice; ``left`` suspension coordinates are possible."""
        known = self._roles.joints
        alike = tuple(
            name
            for name, each in self._choices.items()
            if each.is_open
            and each.choice == choice.choice
            and name not in known
            and not self._leaders(name)
        )
        other = choice.rival or ("commanded" if choice.choice == "passive" else "fixed")
        if other == "suspension" and left < 1:
            other = "fixed"
        return choice._replace(rival=other, alike=alike if choice.is_open else ())

    def differential(self) -> tuple[str, Mimic] | None:
        """Return the name of a rocker, and the opposite rocker that it follows; None without them.

        Two opposite rockers that carry all wheels leave the pitch of the platform free, unless a
        differential joins them.
        """
        rockers = [
            joint
            for name, joint in self._free.items()
            if self._own[name] and joint.type != "prismatic" and self._may_follow(name)
        ]
        everything = {wheel.name for wheel in self._wheels}
        for first in rockers:
            second = self._tree.mirror_image(first, rockers)
            if second is None or self._own[first.name] & self._own[second.name]:
                continue
            if self._own[first.name] | self._own[second.name] != everything:
                continue
            ahead, behind = (float(self._tree.axis(rocker)[1]) for rocker in (first, second))
            multiplier = -float(np.sign(ahead * behind))
            is_joined = any(
                one.mimic and one.mimic.joint == two.name and one.mimic.multiplier * multiplier > 0
                for one, two in ((first, second), (second, first))
            )
            if min(abs(ahead), abs(behind)) > LATERAL and not is_joined:
                leader, follower = (second, first) if first.mimic else (first, second)
                return follower.name, Mimic(leader.name, multiplier, 0.0)
        return None

    def _may_follow(self, name: str) -> bool:
        """Return whether a joint is a suspension without own keys, and follows only such joints."""
        role = self._roles.joints.get(name)
        if not all(self._own[leader] and leader in self._free for leader in self._leaders(name)):
            return False
        if role is None:
            choice = self._choices[name]
            return choice.choice == "suspension" and not choice.is_open
        return role.kind == "suspension" and not role.keywords
