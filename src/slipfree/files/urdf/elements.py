"""Reader of the elements of a URDF, checked to form a tree of links and joints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, cast

import numpy as np

from slipfree.files.urdf.evidence import actuators, plugins
from slipfree.files.urdf.joint_guesses import with_separate_balls
from slipfree.files.urdf.tree import (
    Findings,
    G,
    Geometry,
    Link,
    MeshFile,
    Mimic,
    Shape,
    Tree,
    UrdfBox,
    UrdfJoint,
)
from slipfree.files.urdf.xacro import (
    check_macro_calls,
    link_at,
    substitute,
    unknown_elements,
    without_xacro,
)
from slipfree.files.urdf.xml import Element, parse_robot
from slipfree.files.vehicle_draft import MAX_LENGTH, degrees_words, in_order, rotation_of
from slipfree.geometry.frame import Elements, Vector, in_axes, tensor
from slipfree.vehicle.wheel import ORIGIN

TYPES = ("fixed", "revolute", "continuous", "prismatic", "floating", "planar")
DUMMY_MASS = 0.01  # largest mass of links that only place the robot, in masses of the robot
MAX_LIMIT = 1e3  # larger limits are ignored [rad, m, rad/s or m/s]
FORWARD = (1.0, 0.0, 0.0)  # default axis of a joint
NOTHING: Mapping[str, str] = {}
MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
TRIANGLE = 1e-3  # relative error of the triangle inequality from rounded moments of inertia


def read_tree(
    data: bytes,
    file: str,
    arguments: Mapping[str, str] = NOTHING,
    macros: frozenset[str] = frozenset(),
) -> Tree:
    """Return the links and joints of a URDF file; an UnfitError has all errors of its elements."""
    robot, findings = parse_robot(data, file), Findings(file)
    check_macro_calls(robot, file, macros)
    notes = substitute(robot, file, arguments)
    whole = robot
    robot, omitted = without_xacro(robot, file, findings)
    for tag in ("link", "joint"):
        _check_names(robot, tag, findings)
    unread: list[str] = []
    read = (_link(each, findings, unread) for each in robot.all("link"))
    links = {link.name: link for link in read}
    joints = {
        joint.name: joint for joint in (_joint(each, findings) for each in robot.all("joint"))
    }
    root = _root(links, joints, findings) if not findings.errors else ""
    if findings.errors:
        findings.stop()
    world = _world(links, joints, root)
    for joint in world:
        root = joint.child
        del links[joint.parent], joints[joint.name]
    hung, _ = in_order({j.child: j.parent for j in joints.values()}, root)
    by_child = {joint.child: joint for joint in joints.values()}
    ordered = {by_child[child].name: by_child[child] for child in hung}
    name = robot.attributes.get("name", "robot")
    if world:
        moving = ", ".join(joint.name for joint in world)
        notes = (*notes, f"omitted, since they move the robot as a whole: {moving}")
    unknown = (*unknown_elements(robot), *unread)
    control = actuators(whole), plugins(whole)
    return with_separate_balls(
        Tree(file, name, root, links, ordered, *control, omitted, notes, unknown)
    )


def _world(links: dict[str, Link], joints: dict[str, UrdfJoint], root: str) -> list[UrdfJoint]:
    """Return the joints that move the whole robot, as a simulator's x-y-yaw base, root first."""
    chain: list[UrdfJoint] = []
    most = DUMMY_MASS * sum(link.mass or 0.0 for link in links.values())
    while True:
        link = links[chain[-1].child if chain else root]
        below = [joint for joint in joints.values() if joint.parent == link.name]
        is_dummy = not (link.shapes or link.meshes or link.boxes or (link.mass or 0.0) > most)
        if len(below) != 1 or not is_dummy:
            break
        chain += below
    while chain and not chain[-1].moves:
        chain.pop()
    return chain


def _check_names(robot: Element, tag: str, findings: Findings) -> None:
    lines: dict[str, list[int]] = {}
    for element in robot.all(tag):
        lines.setdefault(element.attributes.get("name", ""), []).append(element.line)
    for name, places in lines.items():
        if len(places) > 1:
            findings.add(
                places[1],
                f"{tag} {name!r}: expected a unique name, found {len(places)} {tag}s with it; "
                "give each a different name",
            )


def _link(element: Element, findings: Findings, unread: list[str]) -> Link:
    name = _text(element, "name", findings, "link")
    inertial, who = element.first("inertial"), f"link {name!r}"
    mass, center, inertia = None, ORIGIN, None
    if inertial is not None:
        center, turned = _origin(inertial, findings, who)
        inertia = _inertia(inertial, turned, findings, f"{who}: inertia")
        weighed = inertial.first("mass")
        if weighed is not None:
            mass = _number(weighed, "value", None, findings, f"{who}: mass")
            if mass < 0:
                message = f"{who}: expected a mass of at least 0 kg, found {mass:g}; correct it"
                findings.add(weighed.line, message)

    found: dict[str, list[Geometry]] = {"collision": [], "visual": []}
    for shape in (child for child in element.children if child.tag in found):
        if (geometry := _geometry(shape, findings, who, unread)) is not None:
            found[shape.tag].append(geometry)

    def of(kind: type[G]) -> tuple[G, ...]:
        every = ([each for each in group if isinstance(each, kind)] for group in found.values())
        return tuple(next(filter(None, every), ()))

    visuals = tuple(each for each in found["visual"] if isinstance(each, MeshFile))
    shapes, meshes, boxes = of(Shape), of(MeshFile), of(UrdfBox)
    collisions = tuple(found["collision"])
    return Link(name, mass, center, shapes, meshes, boxes, inertia, visuals, collisions)


def _inertia(inertial: Element, turned: Vector, findings: Findings, who: str) -> Elements | None:
    element = inertial.first("inertia")
    if element is None:
        return None
    xx, yy, zz, xy, xz, yz = (_number(element, key, 0.0, findings, who) for key in MOMENTS)
    moments = (xx, yy, zz, xy, xz, yz)
    least, middle, most = np.linalg.eigvalsh(tensor(moments))
    if least <= 0 or most > (1 + TRIANGLE) * (least + middle):
        return None
    return in_axes(rotation_of(turned), moments)


def _geometry(element: Element, findings: Findings, who: str, unread: list[str]) -> Geometry | None:
    """Return the shape of a collision or visual element; add one that is not read to ``unread``."""
    at, turned = _origin(element, findings, f"{who}: {element.tag}")
    geometry = element.first("geometry")
    solid = None if geometry is None else next(iter(geometry.children), None)
    kind = "" if solid is None else solid.tag.rpartition(":")[2]  # as in <drake:capsule>
    if solid is not None and kind == "mesh":
        return _mesh(solid, at, turned, findings, who)
    if solid is not None and kind == "box":
        size = _vector(solid, "size", ORIGIN, findings, f"{who}: box")
        if min(size) > 0:
            return UrdfBox(size, at, turned)
        kind = "box without size"
    if solid is None or kind not in ("cylinder", "sphere", "capsule"):
        shape = f"a <{kind}>" if kind else "no shape"
        read = "<box>, <sphere>, <cylinder>, <capsule> and <mesh> are read"
        unread.append(f"{element.line}: {who}: {shape} as <{element.tag}>; {read}")
        return None
    radius = _number(solid, "radius", None, findings, f"{who}: {kind}")
    if not 0 < radius <= MAX_LENGTH:
        findings.add(
            solid.line,
            f"{who}: expected the radius of a {kind} in metres, greater than 0 and at most "
            f"{MAX_LENGTH:g}, found {radius:g}; correct it",
        )
    length = _number(solid, "length", 0.0, findings, f"{who}: {kind}")
    return Shape(cast(Any, kind), radius, at, turned, length=length)


def _mesh(
    mesh: Element, at: Vector, turned: Vector, findings: Findings, who: str
) -> MeshFile | None:
    # three factors, one for all axes, or a fourth that is ignored
    factors = mesh.attributes.get("scale", "1").replace(",", " ").split()
    factors = factors * 3 if len(factors) == 1 else factors[:3] if len(factors) == 4 else factors
    scaled = Element("mesh", {"scale": " ".join(factors)}, mesh.line)
    scale = _vector(scaled, "scale", (1.0, 1.0, 1.0), findings, f"{who}: mesh")
    if not all(scale):
        text = mesh.attributes["scale"]
        message = f"expected factors other than zero in 'scale', found {text!r}; correct them"
        findings.add(mesh.line, f"{who}: mesh: {message}")
    return MeshFile(
        mesh.attributes.get("filename", mesh.attributes.get("uri", "")), scale, at, turned
    )


def _joint(element: Element, findings: Findings) -> UrdfJoint:
    name = _text(element, "name", findings, "joint")
    who, kind = f"joint {name!r}", element.attributes.get("type", "")
    if kind not in TYPES:
        expected = f"one of the types {', '.join(TYPES)}"
        wrong = repr(kind) if kind else "none"
        findings.add(element.line, f"{who}: expected {expected}, found {wrong}; choose one")
    ends: list[str] = []
    for tag in ("parent", "child"):
        link = link_at(element, tag)
        if not link:
            findings.add(element.line, f'{who}: expected <{tag} link="..."/>, found none; add it')
        ends.append(link)
    at, turned = _origin(element, findings, who)
    pointed, axis = element.first("axis"), ORIGIN if kind == "fixed" else FORWARD
    if pointed is not None:
        axis = _vector(pointed, "xyz", FORWARD, findings, f"{who}: axis")
        if not math.hypot(*axis) > 0 and kind not in ("fixed", "floating"):
            findings.add(
                pointed.line,
                f"{who}: expected an axis other than zero, found 0 0 0; "
                'write <axis xyz="0 1 0"/> for an axis to the left',
            )
    lower, upper = _limits(element, kind, findings, f"{who}: limit")
    if kind == "revolute" and math.isinf(lower) and math.isinf(upper):
        kind = "continuous"
    limit = element.first("limit")
    rate = 0.0 if limit is None else _number(limit, "velocity", 0.0, findings, f"{who}: limit")
    max_rate = rate if 0 < rate < MAX_LIMIT else math.inf
    mimic, follows = element.first("mimic"), None
    if mimic is not None:
        who = f"{who}: mimic"
        follows = Mimic(
            _text(mimic, "joint", findings, who),
            _number(mimic, "multiplier", 1.0, findings, who),
            _number(mimic, "offset", 0.0, findings, who),
        )
    return UrdfJoint(
        name,
        kind,
        ends[0],
        ends[1],
        at,
        turned,
        axis,
        lower,
        upper,
        max_rate,
        follows,
        element.line,
    )


def _limits(element: Element, kind: str, findings: Findings, who: str) -> tuple[float, float]:
    limit = element.first("limit")
    has_limits = limit is not None and {"lower", "upper"} & set(limit.attributes)
    if kind not in ("revolute", "prismatic", "fixed") or limit is None or not has_limits:
        return -math.inf, math.inf
    lower, upper = (_number(limit, key, 0.0, findings, who) for key in ("lower", "upper"))
    return (
        lower if abs(lower) < MAX_LIMIT else -math.inf,
        upper if abs(upper) < MAX_LIMIT else math.inf,
    )


def _origin(element: Element, findings: Findings, who: str) -> tuple[Vector, Vector]:
    """Return position [m] and roll, pitch, yaw [rad] in ``origin``; zeros without an origin."""
    origin = element.first("origin")
    if origin is None:
        return ORIGIN, ORIGIN
    at = _vector(origin, "xyz", ORIGIN, findings, f"{who}: origin")
    turned = _vector(origin, "rpy", ORIGIN, findings, f"{who}: origin")
    if max(map(abs, at)) > MAX_LENGTH:
        findings.add(
            origin.line,
            f"{who}: expected xyz in metres, from {-MAX_LENGTH:g} to {MAX_LENGTH:g} (did you mean "
            f"millimetres?), found {origin.attributes['xyz']}; correct it",
        )
    for angle in turned:
        if hint := degrees_words(angle):
            findings.add(origin.line, f"{who}: expected rpy in radians ({hint}), found {angle:g}")
    return at, turned


def _vector(element: Element, key: str, default: Vector, findings: Findings, who: str) -> Vector:
    text = element.attributes.get(key)
    if text is None:
        return default
    values = [_float(number) for number in text.replace(",", " ").split()]
    if len(values) != 3 or not all(map(math.isfinite, values)):
        message = f"{who}: expected three numbers in {key!r}, found {text!r}; correct them"
        findings.add(element.line, message)
        return default
    return values[0], values[1], values[2]


def _number(
    element: Element, key: str, default: float | None, findings: Findings, who: str
) -> float:
    """Return the number in an attribute; one without a default is required."""
    text = element.attributes.get(key)
    if text is None and default is not None:
        return default
    value = _float(text or "")
    if not math.isfinite(value):
        wrong = "none; add it" if text is None else f"{text!r}; correct it"
        findings.add(element.line, f"{who}: expected a number in {key!r}, found {wrong}")
        return default or 1.0
    return value


def _float(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan


def _text(element: Element, key: str, findings: Findings, who: str) -> str:
    if not element.attributes.get(key):
        message = f"{who}: expected a name in the attribute {key!r}, found none; add it"
        findings.add(element.line, message)
    return element.attributes.get(key, "")


def _root(links: dict[str, Link], joints: dict[str, UrdfJoint], findings: Findings) -> str:
    """Return the name of the root link; add errors if the links and joints do not form a tree."""
    parent_of: dict[str, UrdfJoint] = {}
    for joint in joints.values():
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                message = f"expected a link of this file as {role}, found {link!r}"
                findings.wrong(joint, f"{message}; correct the name or add the link")
        if joint.child in parent_of:
            findings.wrong(
                joint,
                f"expected a tree, found a closed loop: link {joint.child!r} is also the child of "
                f"joint {parent_of[joint.child].name!r}; cut the loop at one of these joints",
            )
        parent_of[joint.child] = joint
    if findings.errors:
        return ""
    roots = [name for name in links if name not in parent_of]
    if len(roots) > 1:
        names = ", ".join(map(repr, roots))
        findings.add(1, f"expected one root link, found {names}; connect them by joints")
        return ""
    root = roots[0] if roots else ""
    _, loose = in_order({child: joint.parent for child, joint in parent_of.items()}, root)
    if not links or loose:
        line = parent_of[loose[0]].line if loose else 1
        wrong = f"links in a loop: {', '.join(map(repr, loose))}" if loose else "no link"
        findings.add(line, f"expected a tree of links, found {wrong}; correct the joints")
    return root
