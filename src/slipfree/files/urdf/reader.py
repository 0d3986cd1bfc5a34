"""Conversion of a URDF to a vehicle: forward direction, kinds of joints, coordinates, masses."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from slipfree.core.records import Array
from slipfree.files import vehicle_toml
from slipfree.files.urdf import evidence
from slipfree.files.urdf.meshes import body_shapes
from slipfree.files.urdf.tree import (
    NO_ROLES,
    Findings,
    JointRole,
    Mimic,
    Tree,
    UrdfJoint,
    UrdfTable,
    WheelRole,
    completed,
    coupled,
    facing_forward,
)
from slipfree.files.urdf.wheels import (
    PARALLEL,
    SMALL,
    Wheels,
    caster_wheels,
    swivels,
    usual_radius,
    with_fixed_rollers,
)
from slipfree.files.vehicle_toml import toml_key, toml_value
from slipfree.geometry.frame import unit_vector
from slipfree.vehicle.shapes import BodyShape
from slipfree.vehicle.tree import Body, Coordinate, Joint

MIN_WHEELS = 3
LATERAL = 0.9  # axes of opposite rockers have at least this component to the left, or to the right
DIRECTIONS = {"x": (1.0, 0.0), "y": (0.0, 1.0), "-x": (-1.0, 0.0), "-y": (0.0, -1.0)}
OPPOSITE = {"x": "-x", "-x": "x", "y": "-y", "-y": "y"}
CLEAR = 0.5  # a piece of evidence for a direction has at least this component along it
ENDS = {"front": "rear", "left": "right"}


def read_urdf(tree: Tree, roles: UrdfTable = NO_ROLES) -> vehicle_toml.Draft:
    """Return the vehicle of a URDF, in axes x right, y forward, z up, with its root as platform.

    A joint carries a wheel if it has a wheel role, or if it is continuous with a nearly level axis,
    no other joint moves below it, and its link has a cylinder, a sphere or a round mesh about its
    axis. Joints that carry neither a wheel nor a mass are omitted.
    """
    findings = Findings(tree.file)
    draft = vehicle_toml.from_rep103(_draft(tree, roles, findings))
    # the other choice of a guess does not correct an error
    notes = tuple(note.partition("; otherwise write ")[0] for note in draft.notes)
    refused = replace(draft, notes=notes)
    if findings.errors:
        raise vehicle_toml.VehicleError(*findings.lines, draft=refused)
    few = _wheel_remedy(tree, roles, draft) if len(draft.wheels) < MIN_WHEELS else ""
    wrong = [f"{tree.file}:1: expected {e}, found {f}" for e, f in vehicle_toml.misfits(draft, few)]
    wrong += [f"{tree.file}:{element}" for element in tree.unknown if wrong]
    if wrong:
        raise vehicle_toml.VehicleError(*wrong, draft=refused)
    return draft


def _draft(file: Tree, roles: UrdfTable, findings: Findings) -> vehicle_toml.Draft:
    """Return the vehicle of a URDF before its checks: roles and shapes given or guessed."""
    tree = coupled(completed(file, roles), roles.couple)
    forward: str = roles.forward or ""
    if not forward:
        guess = forward_guess(tree, roles.joints)
        forward, reason = guess.choice, f"forward along {guess.choice}: {guess.reason}"
        if guess.is_open:
            axes = "correct the axes of the wheels, or " * ("along the axles" in guess.reason)
            findings.add(
                1,
                "expected names or axles that determine the forward direction, found that "
                f'{guess.reason}; {axes}write forward = "{forward}" or forward = "{guess.rival}", '
                f"the axis of the root link that points forward, {findings.completion}",
            )
        elif guess.reason:
            other = f'forward = "{guess.rival}"'
            findings.guess("", "forward", {"forward": forward}, reason, other)
    wheels = Wheels(facing_forward(tree, forward), roles, findings)
    for name, (table, values, reason) in wheels.gears.items():
        if wheels.tree.joints[name].moves:
            other = vehicle_toml.toml_line(table, name, **values)
            findings.guess("joints", name, {"kind": "fixed"}, reason, other)
    fixed = dict.fromkeys(wheels.gears, JointRole(kind="fixed"))
    roles = roles.model_copy(update={"joints": {**roles.joints, **fixed}})
    wheels.tree, roles = _with_differential(wheels, roles, findings)
    tree = wheels.tree
    for joint in tree.joints.values():
        role = roles.joints.get(joint.name)
        if not joint.moves and role is not None and role.kind != "fixed":
            findings.wrong(
                joint,
                f"expected a joint with an axis, so that it can be {role.kind}, found one of type "
                "'fixed' without an axis; add the axis in the vehicle file, as in "
                f'{{ kind = "{role.kind}", axis = [0, 1, 0] }}, or remove the joint from "joints"',
            )
    kept = _used_joints(wheels, findings)
    part_of = {tree.root: "platform"} | {joint.child: joint.name for joint in kept}
    kinds = Joints(tree, wheels.joints, wheels.balls, roles).kinds()
    shapes, shape_notes = body_shapes(tree, part_of, wheels.joints, wheels.ground)
    coordinates = _Coordinates(tree, roles, wheels.joints, kinds, findings)
    joints = tuple(
        Joint(
            joint.name,
            part_of[joint.parent],
            unit_vector(joint.axis) if joint.moves and any(joint.axis) else (0.0, 0.0, 1.0),
            joint.at,
            coordinates.value(joint),
            "slide" if joint.type == "prismatic" else "turn",
            _body(tree, joint.child, shapes),
            joint.turned,
        )
        for joint in kept
    )
    built = [wheels.wheel(joint, part_of) for joint in wheels.joints]
    _add_notes(file, wheels, kept, findings)
    return vehicle_toml.Draft(
        tree.name,
        tuple(coordinates.known.values()),
        joints,
        tuple(wheel for wheel in built if wheel is not None),
        _body(tree, tree.root, shapes),
        (*findings.notes, *shape_notes),
        guesses=tuple(findings.guesses),
    )


def _with_differential(
    wheels: Wheels, roles: UrdfTable, findings: Findings
) -> tuple[Tree, UrdfTable]:
    """Return a URDF whose opposite rockers have a differential, and the roles of other joints."""
    tree, couple = wheels.tree, dict(roles.couple)
    for name in {*couple} & {wheel.name for wheel in wheels.joints}:
        message = 'expected a joint without a wheel in "couple", found one that carries a wheel'
        findings.wrong(tree.joints[name], f"{message}; remove it")
    differential = Joints(tree, wheels.joints, wheels.balls, roles).differential()
    if differential is not None:
        follower, mimic = differential
        old = couple or [n for n in (follower, mimic.joint) if tree.joints[n].mimic]
        couple = {mimic.joint: 1.0, follower: -mimic.multiplier}
        if old:
            findings.wrong(
                tree.joints[follower],
                f"expected opposite angles of it and {mimic.joint!r}, since otherwise nothing "
                "determines the pitch, found that other joints are coupled, or these with another "
                f"sign; write couple = {toml_value(couple)}, {findings.completion}",
            )
            return tree, roles
        tree = coupled(tree, couple)
        reason = (
            f"a differential between {mimic.joint} and {follower}, since without one nothing "
            "determines the pitch"
        )
        other = f"joints = {toml_value(dict.fromkeys(couple, 'fixed'))}"
        findings.guess("", "couple", {"couple": couple}, reason, other)
    independent = {name: role for name, role in roles.joints.items() if name not in [*couple][1:]}
    return tree, roles.model_copy(update={"joints": independent})


def _used_joints(wheels: Wheels, findings: Findings) -> list[UrdfJoint]:
    """Return the joints that carry a wheel or a mass, parents before children."""
    tree = wheels.tree
    on_wheels = {j.name for wheel in wheels.joints for j in [wheel, *tree.below(wheel.child)]}
    carrying = {wheel.parent for wheel in wheels.joints}
    kept: list[UrdfJoint] = []
    left: list[str] = []
    for joint in reversed(tree.joints.values()):
        if joint.name in on_wheels:
            continue
        if joint.child in carrying or tree.links[joint.child].mass:
            kept.append(joint)
            carrying.add(joint.parent)
        else:
            left.append(joint.name)
    findings.note("omitted, since they carry no wheel and no mass", reversed(left))
    return kept[::-1]


def _add_notes(file: Tree, wheels: Wheels, kept: list[UrdfJoint], findings: Findings) -> None:
    """Add notes on guesses, omissions and replacements."""
    links, notes = wheels.tree.links, findings.notes
    followers = [wheel.name for wheel in wheels.joints if wheel.mimic]
    findings.note("wheels with rates of their own, in spite of <mimic>: give equal ones", followers)
    notes.extend([*file.notes, *(f"not read: line {element}" for element in file.unknown)])
    used = [links[wheels.tree.root], *(links[j.child] for j in (*kept, *wheels.joints))]
    named = {
        "omitted, since they or links above them contain xacro that is not expanded": file.omitted,
        "without mass, since the URDF does not contain it": [
            link.name for link in used if link.mass is None and link.name in file.links
        ],
        "moments of inertia of a box or a cylinder, since those in the file are missing, "
        "impossible, too large for the vehicle or too small for the mass, as in other units than "
        "kg m^2": [link.name for link in used if link.mass and link.inertia is None],
        "of type fixed in the URDF, but treated as moving joints, since they or the joints that "
        'they mimic are in "joints"': [
            j.name for j in kept if j.moves and not file.joints.get(j.name, j).moves
        ],
    }
    for words, names in named.items():
        findings.note(words, names)
    for reason in dict.fromkeys(guess.reason for guess in findings.guesses):
        alike = [guess for guess in findings.guesses if guess.reason == reason]
        listed = ": " + ", ".join(guess.name for guess in alike) if alike[0].table else ""
        other = f"; otherwise write {alike[0].other}" if alike[0].other else ""
        notes.append(f"{'guessed ' if other else ''}{reason}{listed}{other}")
    if found := tracks(wheels.tree, [wheel.name for wheel in wheels.joints]):
        notes.append(evidence.REMEDIES["tracks"].format(", ".join(found)))
    wheels.add_notes()


def _body(tree: Tree, name: str, shapes: Mapping[str, tuple[BodyShape, ...]]) -> Body:
    link = tree.links[name]
    return Body(link.mass or 0.0, link.center, link.inertia, shapes.get(name, ()))


NO_WHEEL, BALLS, TOO_MANY = (
    evidence.weigh(evidence.evidence("kind", {fact: True}))._replace(rival="commanded")
    for fact in ("no wheel", "balls", "too many")
)


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
        self._swivelling = swivels(tree, rolling)
        carrying = [each for name, each in self._free.items() if self._carried[name]]
        self._choices = {joint.name: self._choice(joint, carrying) for joint in carrying}

    def _leaders(self, name: str) -> list[str]:
        """Return the joints that a joint follows through its mimics."""
        chain, *_ = self._tree.followed(self._tree.joints[name], self._roles.joints)
        return [joint.name for joint in chain[1:]]

    def _rocks(self, joint: UrdfJoint) -> bool:
        """Return whether a joint, or a joint that follows it and carries a wheel, is level.

        A level revolute or a steep prismatic joint moves its wheel up and down.
        """
        followers = [
            follower
            for name, follower in self._tree.joints.items()
            if joint.name in self._leaders(name) and self._carried[name]
        ]
        return any(
            self._tree.is_level(mover) != (mover.type == "prismatic")
            for mover in followers or [joint]
        )

    def _choice(self, joint: UrdfJoint, carrying: Sequence[UrdfJoint]) -> evidence.Choice:
        """Return the kind of a joint by the evidence for it and its counterpart."""
        rocks, slides = self._rocks(joint), joint.type == "prismatic"
        alike = [o for o in carrying if (self._rocks(o), o.type == "prismatic") == (rocks, slides)]
        other = self._tree.mirror_image(joint, alike)
        pieces = list[evidence.Evidence]()
        for each in [joint] if other is None or other.mimic else [joint, other]:
            facts = {
                "rocks": rocks,
                "rocker": rocks and each.names,
                "slides": slides and not rocks,
                "turns": not (slides or rocks),
                "swivels": each.name in self._swivelling,
            }
            pieces += evidence.evidence("kind", facts)
            pieces += self._tree.evidence.get(each.name, ())
        return evidence.weigh(pieces)

    def kinds(self) -> dict[str, evidence.Choice]:
        """Return the probable kinds of the joints without a role, unless actuators agree."""
        declared = [role.kind for role in self._roles.joints.values()].count("suspension")
        left = len(self._wheels) - 3 - declared
        kinds: dict[str, evidence.Choice] = {}
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

    def _guess(self, choice: evidence.Choice, left: int) -> evidence.Choice:
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
        rockers = list[UrdfJoint]()
        for name, joint in self._free.items():
            if not self._own[name] or joint.type == "prismatic":
                continue
            # a suspension without own keys that follows only joints with wheels
            role, choice = self._roles.joints.get(name), self._choices[name]
            is_suspension = choice.choice == "suspension" and not choice.is_open
            if role is not None:
                is_suspension = role.kind == "suspension" and not role.keywords
            leaders = self._leaders(name)
            if is_suspension and all(self._own[each] and each in self._free for each in leaders):
                rockers.append(joint)
        everything = {wheel.name for wheel in self._wheels}
        for first in rockers:
            second = self._tree.mirror_image(first, rockers)
            own = self._own[first.name]  # and all others are those of the second one
            if second is None or self._own[second.name] != everything - own:
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


class _Coordinates:
    """Conversion of the values of a URDF's joints to formulas of coordinates, in ``known``."""

    def __init__(
        self,
        tree: Tree,
        roles: UrdfTable,
        wheels: Sequence[UrdfJoint],
        kinds: Mapping[str, evidence.Choice],
        findings: Findings,
    ) -> None:
        self._tree, self._roles, self._kinds = tree, roles, kinds
        self._wheels, self._findings = frozenset(wheel.name for wheel in wheels), findings
        self.known: dict[str, Coordinate] = {}

    def value(self, joint: UrdfJoint) -> str:
        """Return the formula of a joint's value; create its coordinate if it is new."""
        if joint.type in ("floating", "planar"):
            message = "expected the type 'fixed', 'revolute', 'continuous' or 'prismatic', found"
            self._findings.wrong(joint, f"{message} {joint.type!r}; replace it with such joints")
            return "0"
        leader, multiplier, offset = self._leader(joint)
        role = self._roles.joints.get(leader.name)
        if role is None and leader.moves and leader.lower == leader.upper:
            values, reason = {"kind": "fixed"}, "fixed: its limits are equal"
            other = vehicle_toml.toml_line(
                "joints", leader.name, kind="commanded", lower=-1.5, upper=1.5
            )
            self._findings.guess("joints", leader.name, values, reason, other)
            return repr(offset + multiplier * leader.lower)
        unknown = None if leader.name in self._tree.actuated else NO_WHEEL
        guess = self._kinds.get(leader.name, unknown)
        if role is None and leader.moves and guess is not None:
            kind: Any = guess.choice
            role, lines = JointRole(kind=kind), dict.fromkeys((kind, guess.rival))
            if not guess.alike:
                other = vehicle_toml.toml_line("joints", leader.name, kind=guess.rival)
                reason = f"{kind}: {guess.reason}"
                self._findings.guess("joints", leader.name, {"kind": kind}, reason, other)
            elif leader.name == guess.alike[0]:
                names = f" (also {', '.join(guess.alike[1:])})" if guess.alike[1:] else ""
                self._findings.ask(
                    [leader],
                    f"expected evidence for one kind of joint, found {guess.reason}{names};",
                    *(f"joints = {toml_value(dict.fromkeys(guess.alike, each))}" for each in lines),
                )
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
        roles, joints = self._roles.joints, self._tree.joints
        chain, factor, offset = self._tree.followed(joint, {*roles, *self._wheels})
        last, wrong = chain[-1], ""
        if last.name in self._wheels:
            last, wrong = chain[-2], "a wheel; choose another joint, or remove the mimic"
        elif last.moves and last.mimic and last.name not in roles:
            wrong = "no joint of that name; correct the name"
            if last.mimic.joint in joints:
                wrong = "a joint that follows this one; remove one of the mimics"
        if last.mimic and wrong:
            message = f"expected a mimic of an independent joint, found {last.mimic.joint!r}"
            self._findings.wrong(last, f"{message}, {wrong}")
        return last, factor, offset

    def _coordinate(self, joint: UrdfJoint, joint_role: JointRole | None) -> str:
        """Return the name of a joint's coordinate; create the coordinate if it is new."""
        name = re.sub(r"\W", "_", joint.name)
        name = name if name.isidentifier() else f"_{name}"
        while not vehicle_toml.is_symbol(name) or (
            name != joint.name and name in self._tree.joints
        ):
            name += "_"
        if name in self.known:
            return name
        role = joint_role or JointRole(kind="commanded")
        if name != joint.name:
            self._findings.notes.append(f"joint {joint.name} is the coordinate {name}")
        for key in ("lower", "upper", "rest"):
            value = role.keywords.get(key, 0.0)
            if joint.type != "prismatic" and (hint := vehicle_toml.degrees_words(value)):
                self._findings.wrong(joint, f"{key}: expected radians ({hint}), found {value:g}")
        kind: Any = role.kind
        words = {"words": f"joint {joint.name} of the URDF"}
        self.known[name] = Coordinate(name, kind, **{**words, **role.keywords})
        return name

    def _restrict(
        self, name: str, joint: UrdfJoint, leader: UrdfJoint, multiplier: float, offset: float
    ) -> None:
        """Restrict stops and rate of a coordinate to the limits of a joint that it moves.

        The value of ``joint`` is ``multiplier`` times the coordinate plus ``offset``, as in a
        mimic; ``leader`` is the joint of the coordinate ``name``.
        """
        c, role = self.known[name], self._roles.joints.get(leader.name)
        keywords = {} if role is None else role.keywords
        if multiplier == 0:
            return
        ends = {"lower": -math.inf, "upper": math.inf}
        sides = ("lower", "upper") if multiplier > 0 else ("upper", "lower")
        for key, side in zip(("lower", "upper"), sides, strict=True):
            if side in keywords:
                continue
            limit: float = getattr(joint, key)
            hint = vehicle_toml.degrees_words(limit)
            expected = f"radians ({hint})" if hint else ""
            if joint.type == "prismatic":
                is_long = abs(limit) > vehicle_toml.MAX_LENGTH
                expected = vehicle_toml.length_words(limit) if is_long else ""
            if expected and not math.isinf(limit):  # its unit looks wrong
                self._findings.wrong(joint, f"expected {key} in {expected}, found {limit:g}")
            ends[side] = (limit - offset) / multiplier
        lower, upper = max(c.lower, ends["lower"]), min(c.upper, ends["upper"])
        if not lower < upper:
            self._findings.ask(
                [joint],
                f"expected a lower limit of {name} below the upper one, found {lower:g} and "
                f"{upper:g};",
                f'{toml_key(leader.name)} = "fixed" in "joints" if it does not move, else its '
                '"lower" and "upper", which override those of the URDF',
            )
            return
        own = math.inf if "max_rate" in keywords else joint.max_rate / abs(multiplier)
        self.known[name] = replace(c, lower=lower, upper=upper, max_rate=min(c.max_rate, own))


def tracks(tree: Tree, wheels: Collection[str]) -> list[str]:
    """Return the names of links called tracks that carry no wheels, and of plugins for tracks."""
    plugins = (plugin.name.split() for plugin in tree.plugins)
    names = [word for words in plugins for word in words[:1] if "track" in word.lower()]
    for joint in tree.joints.values():
        parts = {joint.name, *(below.name for below in tree.below(joint.child))}
        if parts.isdisjoint(wheels) and any(
            map(evidence.TRACK.fullmatch, evidence.words_of(joint.child))
        ):
            names.append(joint.child)
    return names


def _wheel_remedy(tree: Tree, roles: UrdfTable, draft: vehicle_toml.Draft) -> str:
    """Return the remedy for too few wheels, with the wheels that names or axes suggest."""
    wheels = [wheel.name for wheel in draft.wheels]
    ends = [j for j in tree.joints.values() if tree.is_last(j) and j.name not in wheels]
    if found := tracks(tree, wheels):
        return evidence.REMEDIES["tracks"].format(", ".join(found))
    steering = [
        j.name
        for j in ends
        if j.moves
        and j.type != "prismatic"
        and not tree.is_level(j)
        and (tree.links[j.child].shapes or evidence.STEERING.search(j.names))
    ]
    if len(steering) + len(wheels) > 2:
        return (
            f"the axles of the wheels are missing: {', '.join(steering)} turn about steep axes, "
            "which steers wheels; add to the link of each a joint of type 'continuous' about a "
            "level axis, whose child is the wheel; or, if z of the root link does not point up, "
            "add a root link with a joint of type 'fixed' that turns the robot upright"
        )
    chains = {
        end.name: [j for j in tree.joints.values() if j.moves and end in tree.below(j.child)]
        for end in ends
    }
    legs = [
        e.name
        for e in ends
        if any(map(evidence.LEG.fullmatch, evidence.words_of(e.names)))
        or (e.moves and len(chains[e.name]) > 1)
    ]
    if len(legs) > 2:
        return evidence.REMEDIES["legs"].format(", ".join(legs))
    named = [j for j in ends if evidence.WHEEL.search(j.names) or evidence.CASTER.search(j.names)]
    level = [j for j in ends if j in tree.turning]
    radius = usual_radius(tree, named or level)
    sizes: dict[str, dict[str, float]] = {
        joint.name: {} if tree.links[joint.child].shapes else {"radius": radius}
        for joint in named or level
    }
    more = {name: WheelRole(radius=size.get("radius")) for name, size in sizes.items()}
    findings = Findings(tree.file)
    trial = roles.model_copy(update={"wheels": {**roles.wheels, **more}})
    add = f"add {evidence.REMEDIES['parts']}"
    if not sizes or [*vehicle_toml.misfits(_draft(tree, trial, findings))] or findings.errors:
        return add
    return f"{add}; or {findings.completion}, write wheels = {toml_value(sizes)}"


def _sides(name: str) -> set[str]:
    words = evidence.words_of(name)
    return {side for side, pattern in evidence.SIDES.items() if any(map(pattern.fullmatch, words))}


def forward_guess(tree: Tree, excluded: Collection[str] = ()) -> evidence.Choice:
    """Return the axis of the root link that probably points forward.

    The reason is empty if the evidence agrees with the convention; the choice is open without
    evidence, too.
    """
    tree, _ = with_fixed_rollers(tree)
    turning = [
        joint
        for joint in filter(tree.is_last, tree.turning)
        if tree.links[joint.child].shapes or tree.links[joint.child].meshes
        if not evidence.CASTER.search(joint.names)
    ]
    radii = [tree.radius_of(joint) for joint in turning]
    bottoms = [tree.frames[j.child][1][2] - r for j, r in zip(turning, radii, strict=True)]
    most = min(bottoms, default=0.0) + max(radii, default=0.0)
    rolling = [j for j, low in zip(turning, bottoms, strict=True) if low <= most or not any(radii)]
    excluded = {*excluded, *caster_wheels(tree, rolling)}
    wheels = [joint for joint in rolling if joint.name not in excluded]
    # directions in which the unsteered wheels roll, or all without a common one
    axles = [np.abs(tree.axis(joint)) for joint in wheels if joint.name not in tree.steered]
    along_x, along_y, _ = np.min(axles, axis=0) if axles else np.zeros(3)
    line = ("x", "-x") if along_y >= PARALLEL else ("x", "-x", "y", "-y")
    line = ("y", "-y") if along_x >= PARALLEL else line
    called = [j for j in tree.joints.values() if evidence.WHEEL.search(j.names)]
    named = {ahead: _named_vector(tree, wheels, called, ahead) for ahead in ENDS}
    misplaced = _misplaced(tree, wheels, line, np.sum([v for v, _ in named.values()], axis=0))
    view = np.zeros(2)
    for link, (rotation, _) in tree.frames.items():
        if evidence.CAMERA.search(link) and not _sides(link) & {"rear", "left", "right"}:
            view += rotation[:2, 2 if "optical" in link.lower() else 0]
    # from the other wheels to steered ones; zero for steered wheels at both ends
    places = {wheel.name: tree.frames[wheel.child][1][:2] for wheel in wheels}
    rest = [place for name, place in places.items() if name not in tree.steered]
    steered = np.zeros(2)
    if 0 < len(rest) < len(places):
        ahead = np.array([places[name] for name in places if name in tree.steered])
        ahead -= np.mean(rest, axis=0)
        mean = ahead.mean(axis=0)
        steered = mean if (ahead @ mean).min() > 0 else steered
    vectors = {"steered": steered, "view": view}
    if "x" not in line:
        x, y = np.sum([tree.axis(joint)[:2] for joint in wheels], axis=0)
        vectors["axes"] = np.array([y, -x])
    for side, (vector, is_of_wheels) in named.items():
        vectors[f"{side} of wheels" if is_of_wheels and not misplaced else side] = vector
    facts: dict[str, Any] = {**misplaced, "convention": "x" in line}
    for fact, vector in vectors.items():
        size = float(np.linalg.norm(vector))
        along = {name: float(vector @ DIRECTIONS[name]) for name in line}
        best = max(line, key=lambda name: along[name])
        if size > SMALL and along[best] > CLEAR * size:
            facts[fact] = best
        else:
            facts[fact.replace(" of wheels", " on axles")] = size > SMALL and " of " in fact
    pieces = [*evidence.evidence("forward", facts)]
    best, reason, rival, is_open, _ = evidence.weigh(pieces, line[0])
    if "x" not in line and not any(piece.weight for piece in pieces):
        words = "the axles point along x, and no name distinguishes front from rear"
        return evidence.Choice(best, reason or words, OPPOSITE[best], True)
    if best == evidence.AXLES:
        best, rival, is_open = line[0], "", True
    is_noted = best != "x" or any(piece.choice != "x" for piece in pieces)
    other = rival if rival in OPPOSITE else OPPOSITE[best]
    return evidence.Choice(best, reason if is_noted else "", other, is_open)


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
