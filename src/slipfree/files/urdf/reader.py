"""Conversion of URDF to vehicles: joints, wheels from round links, masses from inertial data."""

from __future__ import annotations

from dataclasses import replace

from slipfree.files.urdf.coordinates import Coordinates
from slipfree.files.urdf.frames import facing_forward
from slipfree.files.urdf.guesses import forward_guess
from slipfree.files.urdf.roles import NO_ROLES, JointRole, Roles, completed
from slipfree.files.urdf.tree import Findings, Tree, UrdfJoint
from slipfree.files.urdf.wheels import Wheels
from slipfree.files.vehicle_draft import Draft, UnfitError, from_rep103, misfits
from slipfree.geometry.frame import Vector, unit_vector
from slipfree.vehicle.tree import Body, Joint


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
    wrong = [f"{tree.file}:1: expected {e}, found {f}" for e, f in misfits(draft)]
    wrong += [f"{tree.file}:{each}" for each in tree.unknown if wrong]
    if wrong:
        raise UnfitError(wrong, draft)
    return draft


def _draft(file: Tree, roles: Roles, findings: Findings) -> Draft:
    """Return the draft of the vehicle of a URDF, in axes x forward, y left."""
    tree = completed(file, roles)
    forward = roles.forward or forward_guess(tree, roles)
    if forward != (roles.forward or "x"):
        reason = f"forward along {forward}: the axles of the wheels point along x"
        findings.guess("", "forward", {"forward": forward}, reason)
    wheels = Wheels(facing_forward(tree, forward), roles, findings)
    tree = wheels.tree
    for name in wheels.gears:
        reason = "no wheel but fixed: its shape ends far above the lowest wheel"
        findings.guess("joints", name, {"kind": "fixed"}, reason)
    fixed = dict.fromkeys(wheels.gears, JointRole("fixed"))
    roles = replace(roles, joints={**roles.joints, **fixed})
    _check_axes(tree, roles, findings)
    kept = _used_joints(wheels, findings)
    part_of = {tree.root: "platform"} | {joint.child: joint.name for joint in kept}
    coordinates = Coordinates(tree, roles, wheels.joints, findings)
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
    notes.extend(file.notes)
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
        notes.append(f"guessed {reason}{names}; override with {alike[0].override}")
    wheels.add_notes()


def _axis(joint: UrdfJoint) -> Vector:
    return unit_vector(joint.axis) if joint.moves and any(joint.axis) else (0.0, 0.0, 1.0)


def _body(tree: Tree, link: str) -> Body:
    found = tree.links[link]
    return Body(found.mass or 0.0, found.center, found.inertia)
