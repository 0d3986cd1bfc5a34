"""Guessed kinds of the joints of a URDF: steering, swivels, suspension, and its differential."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slipfree.files.urdf.casters import swivels
from slipfree.files.urdf.frames import is_level, mirror_image
from slipfree.files.urdf.roles import Roles
from slipfree.files.urdf.tree import Mimic, Tree, UrdfJoint
from slipfree.geometry.frame import unit_vector
from slipfree.vehicle.tree import Kind

LATERAL = 0.9  # axes of opposite rockers have at least this component to the left, or to the right


class KindGuess(NamedTuple):
    """Probable kind of a joint.

    Attributes
    ----------
    kind : Kind or None
        Kind of its coordinate; None for a joint that does not move.
    reason : str
        Reason for the guess.
    other : Kind or "fixed"
        The other choice.
    """

    kind: Kind | None
    reason: str
    other: str


NO_WHEEL = KindGuess(None, "it carries no wheel", "commanded")
BALLS = KindGuess(None, "it carries only balls, which slide freely", "commanded")
SWIVEL = KindGuess("passive", "a caster or a trailer swivels", "commanded")
STEERS = KindGuess("commanded", "a steep axis above a wheel steers it", "passive")
SLIDES = KindGuess("commanded", "it slides a wheel sideways", "fixed")
FOLLOWS = KindGuess("suspension", "it lets wheels follow the ground", "fixed")
TOO_MANY = KindGuess(
    None, "with so few wheels, it and its counterpart cannot follow the ground", "commanded"
)


class Joints:
    """Joints of a URDF whose values are unknown, with the wheels that they carry.

    Parameters
    ----------
    tree : Tree
        The URDF, facing forward along x.
    wheels : sequence of UrdfJoint
        Joints that carry wheels.
    balls : set of str
        Names of those that carry balls, which slide freely.
    roles : Roles
        Information that completes the URDF.
    """

    def __init__(
        self, tree: Tree, wheels: Sequence[UrdfJoint], balls: set[str], roles: Roles
    ) -> None:
        self._tree, self._roles, self._balls = tree, roles, balls
        self._wheels = [*wheels]
        names = {wheel.name for wheel in wheels}
        on_wheels = {below.name for wheel in wheels for below in tree.below(wheel.child)}
        self._free = {
            name: joint
            for name, joint in tree.joints.items()
            if joint.moves
            and name not in {*names, *on_wheels, *tree.actuated}
            and joint.type not in ("floating", "planar")
            and joint.lower != joint.upper
        }
        self._carried = {
            name: names & {each.name for each in tree.below(joint.child)}
            for name, joint in tree.joints.items()
        }
        self._own = dict(self._carried)
        for name in tree.joints:  # a joint also moves the wheels of the joints that mimic it
            for leader in self._leaders(name):
                self._carried[leader] = self._carried[leader] | self._carried[name]

    def _leaders(self, name: str) -> list[str]:
        """Return the joints that a joint follows through its mimics."""
        chain = {name: None}  # a set in order, since chains may be long
        while True:
            joint = self._tree.joints[name]
            mimic = None if joint.name in self._roles.joints else joint.mimic
            if mimic is None or mimic.joint not in self._tree.joints or mimic.joint in chain:
                return [*chain][1:]
            name = mimic.joint
            chain[name] = None

    def _rocks(self, joint: UrdfJoint) -> bool:
        """Return whether a joint that carries wheels lets them follow the ground."""
        followers = [
            self._tree.joints[name]
            for name in self._tree.joints
            if joint.name in self._leaders(name) and self._carried[name]
        ]
        return any(
            is_level(self._tree, each) != (each.type == "prismatic")
            for each in followers or [joint]
        )

    def kinds(self) -> dict[str, KindGuess]:
        """Return the probable kinds of the joints without a role and without an actuator."""
        tree, rolling = self._tree, [w for w in self._wheels if w.name not in self._balls]
        swivelling = swivels(tree, rolling)
        declared = [role.kind for role in self._roles.joints.values()].count("suspension")
        left = len(self._wheels) - 3 - declared
        found: dict[str, KindGuess] = {}
        candidates: dict[str, UrdfJoint] = {}
        for name, joint in self._free.items():
            if name in self._roles.joints or self._leaders(name):
                continue
            if not self._carried[name]:
                found[name] = NO_WHEEL
            elif self._carried[name] <= self._balls:
                found[name] = BALLS
            elif self._rocks(joint):
                candidates[name] = joint
            elif joint.type == "prismatic":
                found[name] = SLIDES
            else:
                found[name] = SWIVEL if name in swivelling else STEERS
        for name, joint in candidates.items():
            other = mirror_image(tree, joint, candidates.values())
            pair = {name} if other is None else {name, other.name}
            if name not in found:
                found |= dict.fromkeys(pair, FOLLOWS if len(pair) <= left else TOO_MANY)
                left -= len(pair) if len(pair) <= left else 0
        return found

    def differential(self) -> tuple[str, Mimic] | None:
        """Return the name of a rocker, and the opposite rocker that it follows; None without them.

        Two opposite rockers that carry all wheels leave the pitch of the platform free, unless a
        differential joins them: relative to the platform they turn by opposite angles. The result
        is None if they do.
        """
        frames = self._tree.frames
        rockers = [
            joint
            for name, joint in self._free.items()
            if self._own[name]
            and self._rocks(joint)
            and joint.type != "prismatic"
            and self._may_follow(name)
        ]
        everything = {wheel.name for wheel in self._wheels}
        for first in rockers:
            second = mirror_image(self._tree, first, rockers)
            if second is None or self._own[first.name] & self._own[second.name]:
                continue
            if self._own[first.name] | self._own[second.name] != everything:
                continue
            ahead, behind = (
                float((frames[each.child][0] @ unit_vector(each.axis))[1])
                for each in (first, second)
            )
            multiplier = -float(np.sign(ahead * behind))
            mimics = [(one.mimic, two.name) for one, two in ((first, second), (second, first))]
            joined = [
                m.multiplier * multiplier > 0 for m, other in mimics if m and m.joint == other
            ]
            if min(abs(ahead), abs(behind)) > LATERAL and not any(joined):
                leader, follower = (second, first) if first.mimic else (first, second)
                return follower.name, Mimic(leader.name, multiplier, 0.0)
        return None

    def _may_follow(self, name: str) -> bool:
        """Return whether a joint has no role but suspension, and follows only such joints."""
        role, leaders = self._roles.joints.get(name), self._leaders(name)
        if not all(self._own[leader] and leader in self._free for leader in leaders):
            return False
        return role is None or (role.kind == "suspension" and not role.keywords)


def coupled(tree: Tree, couple: Mapping[str, float]) -> Tree:
    """Return a URDF in which the second of two joints mimics the first.

    Parameters
    ----------
    tree : Tree
        The URDF.
    couple : mapping of str to float
        Coefficients of the joints' values, whose sum with these coefficients is zero; empty for
        none.
    """
    if not couple:
        return tree
    (first, ahead), (second, behind) = couple.items()
    mimic = Mimic(first, -ahead / behind, 0.0)
    return replace(tree, joints=tree.joints | {second: tree.joints[second]._replace(mimic=mimic)})
