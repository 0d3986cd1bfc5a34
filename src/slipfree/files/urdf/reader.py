"""Conversion of URDF to vehicles: joints, wheels from round links, masses from inertial data."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from slipfree.files.urdf.coordinates import Coordinates
from slipfree.files.urdf.forward import forward_guess
from slipfree.files.urdf.frames import facing_forward, is_last
from slipfree.files.urdf.kinds import Joints, coupled
from slipfree.files.urdf.roles import NO_ROLES, JointRole, Roles, completed
from slipfree.files.urdf.tree import Findings, Tree, UrdfJoint
from slipfree.files.urdf.wheels import Wheels
from slipfree.files.vehicle_draft import (
    Draft,
    UnfitError,
    from_rep103,
    misfits,
    toml_line,
    toml_value,
)
from slipfree.geometry.frame import Vector, unit_vector
from slipfree.vehicle.tree import Body, Joint

MIN_WHEELS = 3
MAX_NAMES = 12  # more joints are not listed


def read_urdf(tree: Tree, roles: Roles = NO_ROLES) -> Draft:
    """Return the vehicle of a URDF, in axes x right, y forward, z up.

    The platform is the root link. A joint carries a wheel if it has a wheel role, or if it is
    continuous with a nearly level axis, no other joint moves below it, and its link has a cylinder,
    a sphere or a round mesh about its axis. Joints that carry neither a wheel nor a mass are
    omitted.

    Parameters
    ----------
    tree : Tree
        Result of `slipfree.files.urdf.elements.read_tree`.
    roles : Roles
        Information that completes the URDF.

    Raises
    ------
    UnfitError
        If a joint or a wheel is invalid or not completely described, or if there are too few wheels
        or too many suspension coordinates.
    ModelError
        If a number in the URDF or the roles is out of range.
    """
    findings = Findings(tree.file)
    draft = from_rep103(_draft(tree, roles, findings))
    if findings.faults.found:
        raise UnfitError(findings.faults.lines, draft)
    remedy = _wheel_words(tree, draft) if len(draft.wheels) < MIN_WHEELS else ""
    wrong = [f"{tree.file}:1: expected {e}, found {f}{remedy}" for e, f in misfits(draft)]
    wrong += [f"{tree.file}:{each}" for each in tree.unknown if wrong]
    if wrong:
        raise UnfitError(wrong, draft)
    return draft


def _wheel_words(tree: Tree, draft: Draft) -> str:
    """Return how to declare wheels, with the names of the last joints that carry none."""
    known = [wheel.name for wheel in draft.wheels]
    ends = [j.name for j in tree.joints.values() if is_last(tree, j) and j.name not in known]
    names = ", ".join(ends[:MAX_NAMES]) + (", ..." if len(ends) > MAX_NAMES else "")
    if not ends:
        return ", such as a link with a sphere at a fixed joint, as of a caster"
    return (
        f" in a vehicle file with urdf = {toml_value(Path(tree.file).name)}, such as "
        f"{toml_line('wheels', ends[0], radius=0.1)}; joints without a wheel: {names}"
    )


def _draft(file: Tree, roles: Roles, findings: Findings) -> Draft:
    """Return the draft of the vehicle of a URDF, in axes x forward, y left."""
    tree = coupled(completed(file, roles), roles.couple)
    forward = roles.forward or _forward(tree, roles, findings)
    wheels = Wheels(facing_forward(tree, forward), roles, findings)
    tree = wheels.tree
    for name, (table, values, reason) in wheels.gears.items():
        if tree.joints[name].moves:
            other = toml_line(table, name, **values)
            findings.guess("joints", name, {"kind": "fixed"}, reason, other)
    fixed = dict.fromkeys(wheels.gears, JointRole("fixed"))
    roles = replace(roles, joints={**roles.joints, **fixed})
    tree, roles = _with_differential(wheels, roles, findings)
    wheels.tree = tree
    _check_axes(tree, roles, findings)
    kept = _used_joints(wheels, findings)
    part_of = {tree.root: "platform"} | {joint.child: joint.name for joint in kept}
    kinds = Joints(tree, wheels.joints, wheels.balls, roles).kinds()
    coordinates = Coordinates(tree, roles, wheels.joints, kinds, findings)
    joints = tuple(
        Joint(
            joint.name,
            part_of[joint.parent],
            _axis(joint),
            joint.at,
            coordinates.value(joint),
            "slide" if joint.type == "prismatic" else "turn",
            _body(tree, joint.child),
            joint.turned,
        )
        for joint in kept
    )
    found = (wheels.wheel(joint, part_of) for joint in wheels.joints)
    placed = tuple(wheel for wheel in found if wheel is not None)
    _add_notes(file, wheels, kept, findings)
    return Draft(
        tree.name,
        tuple(coordinates.found.values()),
        joints,
        placed,
        _body(tree, tree.root),
        tuple(findings.notes),
        tuple(findings.guesses),
    )


def _forward(tree: Tree, roles: Roles, findings: Findings) -> str:
    """Return the guessed forward axis; add an error if the evidence does not determine it."""
    guess = forward_guess(tree, roles.joints)
    if guess.is_open:
        axes = "correct the axes of the wheels, or " if "along the axles" in guess.reason else ""
        findings.faults.add(
            1,
            "expected names or axles that determine the forward direction, found that "
            f'{guess.reason}; {axes}write forward = "{guess.direction}" or forward = '
            f'"{guess.other}", the axis of the root link that points forward, in a vehicle file '
            f'with urdf = "{Path(tree.file).name}"',
        )
    elif guess.reason:
        reason = f"forward along {guess.direction}: {guess.reason}"
        other = f'forward = "{guess.other}"'
        findings.guess("", "forward", {"forward": guess.direction}, reason, other)
    return guess.direction


def _with_differential(wheels: Wheels, roles: Roles, findings: Findings) -> tuple[Tree, Roles]:
    """Return a URDF whose opposite rockers have a differential, and the roles of other joints.

    Add an error if they are coupled in another way, or if a wheel is coupled.
    """
    tree, couple = wheels.tree, dict(roles.couple)
    for name in {*couple} & {wheel.name for wheel in wheels.joints}:
        findings.faults.add(
            tree.joints[name].line,
            f'joint {name!r}: expected a joint without a wheel in "couple", found one that '
            "carries a wheel; remove it",
        )
    found = Joints(tree, wheels.joints, wheels.balls, roles).differential()
    if found is not None:
        follower, mimic = found
        old = couple or [n for n in (follower, mimic.joint) if tree.joints[n].mimic]
        couple = {mimic.joint: 1.0, follower: -mimic.multiplier}
        if old:
            findings.faults.add(
                tree.joints[follower].line,
                f"joint {follower!r}: expected opposite angles of it and {mimic.joint!r}, since "
                "otherwise nothing determines the pitch, found that other joints are coupled, or "
                f"these with another sign; write couple = {toml_value(couple)}{wheels.in_file}",
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
    return tree, replace(roles, joints=independent)


def _check_axes(tree: Tree, roles: Roles, findings: Findings) -> None:
    """Add an error for each fixed joint without an axis whose role needs one."""
    for joint in tree.joints.values():
        role = roles.joints.get(joint.name)
        if not joint.moves and role is not None and role.kind != "fixed":
            findings.faults.add(
                joint.line,
                f"joint {joint.name!r}: expected a joint with an axis, so that it can be "
                f"{role.kind}, found one of type 'fixed' without an axis; add the axis in the "
                f'vehicle file, as in {{ kind = "{role.kind}", axis = [0, 1, 0] }}, or remove the '
                'joint from "joints"',
            )


def _used_joints(wheels: Wheels, findings: Findings) -> list[UrdfJoint]:
    """Return the joints that carry a wheel or a mass, parents before children."""
    tree, names = wheels.tree, {wheel.name for wheel in wheels.joints}
    on_wheels = {j.name for wheel in wheels.joints for j in tree.below(wheel.child)}
    carrying = {wheel.parent for wheel in wheels.joints}
    kept: list[UrdfJoint] = []
    left: list[str] = []
    for joint in reversed(tree.joints.values()):
        if joint.name in names | on_wheels:
            continue
        if joint.child in carrying or tree.links[joint.child].mass:
            kept.append(joint)
            carrying.add(joint.parent)
        else:
            left.append(joint.name)
    if left:
        words = ", ".join(reversed(left))
        findings.notes.append(f"omitted, since they carry no wheel and no mass: {words}")
    return kept[::-1]


def _add_notes(file: Tree, wheels: Wheels, kept: list[UrdfJoint], findings: Findings) -> None:
    """Add notes on the assumptions made in the conversion.

    Parameters
    ----------
    file : Tree
        The URDF as in its file.
    wheels : Wheels
        Wheels, with the completed URDF.
    kept : list of UrdfJoint
        Joints that carry a wheel or a mass.
    findings : Findings
        Collection to which the notes are added.
    """
    links, notes = wheels.tree.links, findings.notes
    notes.extend([*file.notes, *(f"not read: line {each}" for each in file.unknown)])
    if file.omitted:
        notes.append(
            "omitted, since they or links above them contain xacro that is not expanded: "
            f"{', '.join(file.omitted)}"
        )
    used = [links[wheels.tree.root], *(links[j.child] for j in (*kept, *wheels.joints))]
    bare = [link.name for link in used if link.mass is None and link.name in file.links]
    if bare:
        notes.append(f"without mass, since the URDF does not contain it: {', '.join(bare)}")
    estimated = [link.name for link in used if link.mass and link.inertia is None]
    if estimated:
        notes.append(
            "moments of inertia of a box or a cylinder, since those in the file are missing or "
            f"impossible: {', '.join(estimated)}"
        )
    released = [j.name for j in kept if j.moves and not file.joints.get(j.name, j).moves]
    if released:
        notes.append(
            "of type fixed in the URDF, but treated as moving joints, since they or the joints "
            f'that they mimic are in "joints": {", ".join(released)}'
        )
    for reason in dict.fromkeys(guess.reason for guess in findings.guesses):
        alike = [guess for guess in findings.guesses if guess.reason == reason]
        names = ": " + ", ".join(guess.name for guess in alike) if alike[0].table else ""
        notes.append(f"guessed {reason}{names}; otherwise write {alike[0].other}")
    wheels.add_notes()


def _axis(joint: UrdfJoint) -> Vector:
    return unit_vector(joint.axis) if joint.moves and any(joint.axis) else (0.0, 0.0, 1.0)


def _body(tree: Tree, link: str) -> Body:
    found = tree.links[link]
    return Body(found.mass or 0.0, found.center, found.inertia)
