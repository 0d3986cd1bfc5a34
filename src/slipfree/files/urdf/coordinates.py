"""Coordinates of a URDF: values of its joints as formulas, kinds, stops and rates."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from slipfree.files.urdf.kinds import NO_WHEEL, KindGuess
from slipfree.files.urdf.roles import JointRole, Roles
from slipfree.files.urdf.tree import Findings, Mimic, Tree, UrdfJoint
from slipfree.files.vehicle_draft import (
    MAX_LENGTH,
    degrees_words,
    is_symbol,
    length_words,
    toml_key,
    toml_line,
)
from slipfree.vehicle.tree import Coordinate


class Coordinates:
    """Conversion of the values of a URDF's joints to formulas of coordinates.

    Parameters
    ----------
    tree : Tree
        The URDF.
    roles : Roles
        Information that completes the URDF.
    wheels : sequence of UrdfJoint
        Joints that carry wheels.
    kinds : mapping of str to KindGuess
        Probable kinds of joints without a role.
    findings : Findings
        Collection to which errors, notes and guesses are added.

    Attributes
    ----------
    found : dict of str to Coordinate
        Coordinates in the formulas so far, by name.
    """

    def __init__(
        self,
        tree: Tree,
        roles: Roles,
        wheels: Sequence[UrdfJoint],
        kinds: Mapping[str, KindGuess],
        findings: Findings,
    ) -> None:
        self._tree, self._roles, self._kinds = tree, roles, kinds
        self._wheels, self._findings = frozenset(wheel.name for wheel in wheels), findings
        self.found: dict[str, Coordinate] = {}

    def value(self, joint: UrdfJoint) -> str:
        """Return the formula of a joint's value; create its coordinate if it is new."""
        if joint.type in ("floating", "planar"):
            self._findings.faults.add(
                joint.line,
                f"joint {joint.name!r}: expected the type 'fixed', 'revolute', 'continuous' or "
                f"'prismatic', found {joint.type!r}; replace it with such joints",
            )
            return "0"
        leader, multiplier, offset = self._leader(joint)
        role = self._roles.joints.get(leader.name)
        if role is None and leader.moves and leader.lower == leader.upper:
            values, reason = {"kind": "fixed"}, "fixed: its limits are equal"
            other = toml_line("joints", leader.name, kind="commanded", lower=-1.5, upper=1.5)
            self._findings.guess("joints", leader.name, values, reason, other)
            return repr(offset + multiplier * leader.lower)
        if role is None and leader.moves and leader.name not in self._tree.actuated:
            role = self._guessed_role(leader)
        if not leader.moves or (role is not None and role.kind == "fixed"):
            return repr(offset)
        name = self._coordinate(leader, role)
        self._restrict(name, joint, leader, multiplier, offset)
        if (multiplier, offset) == (1.0, 0.0):
            return name
        scaled = f"-{name}" if multiplier == -1 else f"{multiplier!r}*{name}"
        return scaled + (f" + {offset!r}" if offset else "")

    def _leader(self, joint: UrdfJoint) -> tuple[UrdfJoint, float, float]:
        """Return the joint that a joint follows through its mimics, with factor and offset."""
        chain, multiplier, offset = [joint], 1.0, 0.0
        while (mimic := self._mimic(chain[-1])) is not None:
            leader = self._tree.joints.get(mimic.joint)
            wrong = (
                "no joint of that name; correct the name"
                if leader is None
                else "a wheel; choose another joint, or remove the mimic"
                if leader.name in self._wheels
                else "a joint that follows this one; remove one of the mimics"
                if leader in chain
                else ""
            )
            if leader is None or wrong:
                words = f"expected a mimic of an independent joint, found {mimic.joint!r}, {wrong}"
                self._findings.faults.add(chain[-1].line, f"joint {chain[-1].name!r}: {words}")
                break
            offset += multiplier * mimic.offset
            multiplier *= mimic.multiplier
            chain.append(leader)
        return chain[-1], multiplier, offset

    def _mimic(self, joint: UrdfJoint) -> Mimic | None:
        return None if joint.name in self._roles.joints or not joint.moves else joint.mimic

    def _guessed_role(self, joint: UrdfJoint) -> JointRole:
        """Return the probable role of a joint that has none and no actuator."""
        guess = self._kinds.get(joint.name, NO_WHEEL)
        word = guess.kind or "fixed"
        other = toml_line("joints", joint.name, kind=guess.other)
        reason = f"{word}: {guess.reason}"
        self._findings.guess("joints", joint.name, {"kind": word}, reason, other)
        return JointRole(word)

    def _coordinate(self, joint: UrdfJoint, given: JointRole | None) -> str:
        """Return the name of a joint's coordinate; create the coordinate if it is new."""
        name = self._symbol(joint.name)
        if name in self.found:
            return name
        role = given or JointRole("commanded")
        if name != joint.name:
            self._findings.notes.append(f"joint {joint.name} is the coordinate {name}")
        for key in ("lower", "upper", "rest"):
            value = role.keywords.get(key, 0.0)
            if joint.type != "prismatic" and (words := degrees_words(value)):
                self._findings.faults.add(
                    joint.line,
                    f"joint {joint.name!r}: {key}: expected radians ({words}), found {value:g}",
                )
        words = f"joint {joint.name} of the URDF"
        kind: Any = role.kind
        self.found[name] = Coordinate(name, kind, **{"words": words, **role.keywords})
        return name

    def _symbol(self, joint: str) -> str:
        """Return a valid coordinate name for the name of a joint."""
        name = re.sub(r"\W", "_", joint)
        name = name if name.isidentifier() else f"_{name}"
        while not is_symbol(name) or (name != joint and name in self._tree.joints):
            name += "_"
        return name

    def _restrict(
        self, name: str, joint: UrdfJoint, leader: UrdfJoint, multiplier: float, offset: float
    ) -> None:
        """Restrict the stops and the rate of a coordinate to the limits of a joint that it moves.

        Limits in the role of the leading joint take precedence.

        Parameters
        ----------
        name : str
            Name of the coordinate.
        joint, leader : UrdfJoint
            Joint that the coordinate moves, and the joint that it follows.
        multiplier, offset : float
            Value of the joint: ``offset + multiplier * coordinate``. [rad or m]
        """
        c, role = self.found.get(name), self._roles.joints.get(leader.name)
        if multiplier == 0:
            return
        sides = ("lower", "upper") if multiplier > 0 else ("upper", "lower")
        ends = {
            side: (self._limit(joint, key) - offset) / multiplier
            for key, side in zip(("lower", "upper"), sides, strict=True)
            if role is None or side not in role.keywords
        }
        if c is None:
            return
        lower = max(c.lower, ends.get("lower", -math.inf))
        upper = min(c.upper, ends.get("upper", math.inf))
        if not lower < upper:
            self._findings.faults.add(
                joint.line,
                f"joint {joint.name!r}: expected a lower limit of {name} below the "
                f"upper one, found {lower:g} and {upper:g}; in a vehicle file with urdf = "
                f'"{Path(self._tree.file).name}", write {toml_key(leader.name)} = "fixed" in '
                '"joints" if it does not move, else its "lower" and "upper", which override '
                "those of the URDF",
            )
            return
        rate = c.max_rate
        if role is None or "max_rate" not in role.keywords:
            rate = min(rate, joint.max_rate / abs(multiplier))
        self.found[name] = replace(c, lower=lower, upper=upper, max_rate=rate)

    def _limit(self, joint: UrdfJoint, key: str) -> float:
        """Return a limit of a joint in the URDF; add an error if its unit looks wrong."""
        value = joint.lower if key == "lower" else joint.upper
        expected = ""
        if not math.isinf(value) and joint.type == "prismatic" and abs(value) > MAX_LENGTH:
            expected = length_words(value)
        elif not math.isinf(value) and joint.type != "prismatic" and degrees_words(value):
            expected = f"radians ({degrees_words(value)})"
        if expected:
            self._findings.faults.add(
                joint.line,
                f"joint {joint.name!r}: expected {key} in {expected}, found {value:g}",
            )
        return value
