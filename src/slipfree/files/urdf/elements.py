"""Reader of the elements of a URDF, checked to form a tree of links and joints."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from typing import TypeVar

import numpy as np

from slipfree.files.urdf.joint_guesses import with_separate_balls
from slipfree.files.urdf.tree import (
    Box,
    Faults,
    Link,
    Mesh,
    Mimic,
    Shape,
    Tree,
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
from slipfree.geometry.frame import Vector
from slipfree.geometry.tensor import Elements, in_axes, tensor
from slipfree.vehicle.wheel import ORIGIN

DRIVE = re.compile("drive|steer|ackerman|joint.?controller", re.IGNORECASE)  # plugins of Gazebo
TYPES = ("fixed", "revolute", "continuous", "prismatic", "floating", "planar")
DUMMY_MASS = 0.01  # largest mass of links that only place the robot, in masses of the robot
MAX_LIMIT = 1e3  # larger limits are ignored [rad, m, rad/s or m/s]
FORWARD = (1.0, 0.0, 0.0)  # default axis of a joint
UNIT_SCALE = (1.0, 1.0, 1.0)
NOTHING: Mapping[str, str] = {}
MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
T = TypeVar("T")
TRIANGLE = 1e-3  # relative error of the triangle inequality from rounded moments of inertia


def read_tree(
    data: bytes,
    file: str,
    arguments: Mapping[str, str] = NOTHING,
    macros: frozenset[str] = frozenset(),
) -> Tree:
    """Return the links and joints of a URDF file, checked to form a tree.

    Parameters
    ----------
    data : bytes
        Contents of the file.
    file : str
        Name of the file in messages.
    arguments : mapping of str to str
        Values of ``$(arg NAME)``, which override the defaults in the file.
    macros : frozenset of str
        Names of macros of the xacro from which the file was expanded.

    Raises
    ------
    DataError
        If the file is not XML; an `UnfitError` with all errors if its elements are not valid.
    """
    robot, faults = parse_robot(data, file), Faults(file)
    check_macro_calls(robot, file, macros)
    notes = substitute(robot, arguments)
    actuated = frozenset(_actuated(robot))
    robot, omitted = without_xacro(robot, file, faults)
    for tag in ("link", "joint"):
        _check_names(robot, tag, faults)
    links = {link.name: link for link in (_link(each, faults) for each in robot.all("link"))}
    joints = {joint.name: joint for joint in (_joint(each, faults) for each in robot.all("joint"))}
    root = _root(links, joints, faults) if not faults.found else ""
    if faults.found:
        faults.stop()
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
    unknown = unknown_elements(robot)
    tree = Tree(file, name, root, links, ordered, actuated, omitted, notes, unknown)
    return with_separate_balls(tree)


def _world(links: dict[str, Link], joints: dict[str, UrdfJoint], root: str) -> list[UrdfJoint]:
    """Return the joints that move the whole robot, as a simulator's x-y-yaw base, root first.

    Above the last of them are only links with one joint each, without a shape and almost without
    mass.
    """
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


def _check_names(robot: Element, tag: str, faults: Faults) -> None:
    """Add an error for each name that several elements with the same tag have."""
    lines: dict[str, list[int]] = {}
    for element in robot.all(tag):
        lines.setdefault(element.attributes.get("name", ""), []).append(element.line)
    for name, found in lines.items():
        if len(found) > 1:
            words = (
                f"{tag} {name!r}: expected a unique name, found {len(found)} {tag}s with it; "
                "give each a different name"
            )
            faults.add(found[1], words)


def _link(element: Element, faults: Faults) -> Link:
    """Return the link of an element."""
    name = _text(element, "name", faults, "link")
    inertial = element.first("inertial")
    mass, center, inertia = None, ORIGIN, None
    if inertial is not None:
        center, turned = _origin(inertial, faults, f"link {name!r}")
        inertia = _inertia(inertial, turned, faults, f"link {name!r}: inertia")
        weighed = inertial.first("mass")
        if weighed is not None:
            mass = _number(weighed, "value", None, faults, f"link {name!r}: mass")
            if mass < 0:
                faults.add(
                    weighed.line,
                    f"link {name!r}: expected a mass of at least 0 kg, found {mass:g}; correct it",
                )
    shapes = _of_geometry(element, _shape, faults, name)
    meshes = _of_geometry(element, _mesh, faults, name)
    boxes = _of_geometry(element, _box, faults, name)
    seen = (_mesh(each, faults, name) for each in element.all("visual"))
    visuals = tuple(each for each in seen if each is not None)
    return Link(name, mass, center, shapes, meshes, boxes, inertia, visuals)


def _of_geometry(
    element: Element, read: Callable[[Element, Faults, str], T | None], faults: Faults, link: str
) -> tuple[T, ...]:
    """Return the shapes that ``read`` finds in a link's collision elements, else in visual ones."""
    for tag in ("collision", "visual"):
        found = (read(each, faults, link) for each in element.all(tag))
        if known := tuple(each for each in found if each is not None):
            return known
    return ()


def _inertia(inertial: Element, turned: Vector, faults: Faults, who: str) -> Elements | None:
    """Return the inertia tensor of an element in the axes of its link [kg m^2].

    The result is None without the element ``inertia``, or for impossible moments: principal
    moments that are not positive, or one of which exceeds the sum of the others.
    """
    element = inertial.first("inertia")
    if element is None:
        return None
    xx, yy, zz, xy, xz, yz = (_number(element, key, 0.0, faults, who) for key in MOMENTS)
    found = (xx, yy, zz, xy, xz, yz)
    least, middle, most = np.linalg.eigvalsh(tensor(found))
    if least <= 0 or most > (1 + TRIANGLE) * (least + middle):
        return None
    return in_axes(rotation_of(turned), found)


def _mesh(element: Element, faults: Faults, link: str) -> Mesh | None:
    """Return the mesh of a collision or visual element; None for other shapes."""
    geometry = element.first("geometry")
    found = geometry.first("mesh") if geometry is not None else None
    if found is None:
        return None
    who = f"link {link!r}"
    at, turned = _origin(element, faults, f"{who}: {element.tag}")
    scale = _scale(found, faults, f"{who}: mesh")
    return Mesh(found.attributes.get("filename", ""), scale, at, turned)


def _scale(element: Element, faults: Faults, who: str) -> Vector:
    """Return the scale of a mesh: three numbers, one for all axes, or a fourth that is ignored."""
    values = element.attributes.get("scale", "1").replace(",", " ").split()
    values = values * 3 if len(values) == 1 else values[:3] if len(values) == 4 else values
    scale = Element("mesh", {"scale": " ".join(values)}, element.line)
    found = _vector(scale, "scale", UNIT_SCALE, faults, who)
    if not all(found):
        text = element.attributes["scale"]
        faults.add(
            element.line,
            f"{who}: expected factors other than zero in 'scale', found {text!r}; correct them",
        )
    return found


def _box(element: Element, faults: Faults, link: str) -> Box | None:
    """Return the box of a collision or visual element; None for other shapes."""
    geometry = element.first("geometry")
    found = geometry.first("box") if geometry is not None else None
    if found is None:
        return None
    who = f"link {link!r}"
    at, turned = _origin(element, faults, f"{who}: {element.tag}")
    return Box(_vector(found, "size", ORIGIN, faults, f"{who}: box"), at, turned)


def _shape(element: Element, faults: Faults, link: str) -> Shape | None:
    """Return the cylinder or sphere of a collision or visual element; None for other shapes."""
    geometry = element.first("geometry")
    at, turned = _origin(element, faults, f"link {link!r}: {element.tag}")
    for kind in ("cylinder", "sphere"):
        found = geometry.first(kind) if geometry is not None else None
        if found is not None:
            radius = _number(found, "radius", None, faults, f"link {link!r}: {kind}")
            if not 0 < radius <= MAX_LENGTH:
                faults.add(
                    found.line,
                    f"link {link!r}: expected the radius of a {kind} in metres, greater than 0 and "
                    f"at most {MAX_LENGTH:g}, found {radius:g}; correct it",
                )
            return Shape("cylinder" if kind == "cylinder" else "sphere", radius, at, turned)
    return None


def _joint(element: Element, faults: Faults) -> UrdfJoint:
    """Return the joint of an element."""
    name = _text(element, "name", faults, "joint")
    who, kind = f"joint {name!r}", element.attributes.get("type", "")
    if kind not in TYPES:
        expected = f"one of the types {', '.join(TYPES)}"
        found = repr(kind) if kind else "none"
        faults.add(element.line, f"{who}: expected {expected}, found {found}; choose one")
    ends = []
    for tag in ("parent", "child"):
        link = link_at(element, tag)
        if not link:
            faults.add(element.line, f'{who}: expected <{tag} link="..."/>, found none; add it')
        ends.append(link)
    at, turned = _origin(element, faults, who)
    pointed, axis = element.first("axis"), ORIGIN if kind == "fixed" else FORWARD
    if pointed is not None:
        axis = _vector(pointed, "xyz", FORWARD, faults, f"{who}: axis")
        if not math.hypot(*axis) > 0 and kind not in ("fixed", "floating"):
            faults.add(
                pointed.line,
                f"{who}: expected an axis other than zero, found 0 0 0; "
                'write <axis xyz="0 1 0"/> for an axis to the left',
            )
    lower, upper = _limits(element, kind, faults, who)
    if kind == "revolute" and math.isinf(lower) and math.isinf(upper):
        kind = "continuous"
    max_rate = _max_rate(element, faults, who)
    mimic = element.first("mimic")
    follows = (
        None
        if mimic is None
        else Mimic(
            _text(mimic, "joint", faults, f"{who}: mimic"),
            _number(mimic, "multiplier", 1.0, faults, f"{who}: mimic"),
            _number(mimic, "offset", 0.0, faults, f"{who}: mimic"),
        )
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


def _limits(element: Element, kind: str, faults: Faults, who: str) -> tuple[float, float]:
    """Return the lower and upper limit of a joint [rad or m].

    A limit is infinite if its absolute value is at least 1000. Both are infinite if the joint is of
    a type without limits, or has neither ``lower`` nor ``upper``. If one of these attributes is
    missing, its limit is zero, as in URDF. The values are checked later, since a vehicle file may
    override them.
    """
    limit = element.first("limit")
    if kind not in ("revolute", "prismatic", "fixed") or limit is None:
        return -math.inf, math.inf
    if not {"lower", "upper"} & set(limit.attributes):
        return -math.inf, math.inf
    found = []
    for key, sign in (("lower", -1), ("upper", 1)):
        value = _number(limit, key, 0.0, faults, f"{who}: limit")
        found.append(sign * math.inf if abs(value) >= MAX_LIMIT else value)
    return found[0], found[1]


def _max_rate(element: Element, faults: Faults, who: str) -> float:
    """Return the rate limit of a joint [rad/s, m/s]; infinite if absent, zero or at least 1000."""
    limit = element.first("limit")
    found = 0.0 if limit is None else _number(limit, "velocity", 0.0, faults, f"{who}: limit")
    return found if 0 < found < MAX_LIMIT else math.inf


def _origin(element: Element, faults: Faults, who: str) -> tuple[Vector, Vector]:
    """Return position [m] and roll, pitch, yaw [rad] in ``origin``; zeros without an origin."""
    origin = element.first("origin")
    if origin is None:
        return ORIGIN, ORIGIN
    at = _vector(origin, "xyz", ORIGIN, faults, f"{who}: origin")
    turned = _vector(origin, "rpy", ORIGIN, faults, f"{who}: origin")
    if max(map(abs, at)) > MAX_LENGTH:
        faults.add(
            origin.line,
            f"{who}: expected xyz in metres, from {-MAX_LENGTH:g} to {MAX_LENGTH:g} (did you mean "
            f"millimetres?), found {origin.attributes['xyz']}; correct it",
        )
    for angle in turned:
        if words := degrees_words(angle):
            faults.add(origin.line, f"{who}: expected rpy in radians ({words}), found {angle:g}")
    return at, turned


def _vector(element: Element, key: str, default: Vector, faults: Faults, who: str) -> Vector:
    """Return three numbers of an attribute; add an error if they are invalid."""
    text = element.attributes.get(key)
    if text is None:
        return default
    values = [_float(part) for part in text.replace(",", " ").split()]
    if len(values) != 3 or not all(map(math.isfinite, values)):
        faults.add(
            element.line, f"{who}: expected three numbers in {key!r}, found {text!r}; correct them"
        )
        return default
    return values[0], values[1], values[2]


def _number(element: Element, key: str, default: float | None, faults: Faults, who: str) -> float:
    """Return the number in an attribute, or ``default`` if the attribute is missing.

    An error is added to ``faults`` if the number is invalid, or if it is missing and ``default`` is
    None.
    """
    text = element.attributes.get(key)
    if text is None and default is not None:
        return default
    value = _float(text or "")
    if not math.isfinite(value):
        found = "none" if text is None else repr(text)
        remedy = "add it" if text is None else "correct it"
        faults.add(element.line, f"{who}: expected a number in {key!r}, found {found}; {remedy}")
        return default or 1.0
    return value


def _float(text: str) -> float:
    """Return the number in a text; NaN without a number."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def _text(element: Element, key: str, faults: Faults, who: str) -> str:
    """Return the name in an attribute; add an error if it is missing."""
    if not element.attributes.get(key):
        words = f"{who}: expected a name in the attribute {key!r}, found none; add it"
        faults.add(element.line, words)
    return element.attributes.get(key, "")


def _root(links: dict[str, Link], joints: dict[str, UrdfJoint], faults: Faults) -> str:
    """Return the name of the root link; add errors if the links and joints do not form a tree."""
    parent_of: dict[str, UrdfJoint] = {}
    for joint in joints.values():
        for role, link in (("parent", joint.parent), ("child", joint.child)):
            if link not in links:
                faults.add(
                    joint.line,
                    f"joint {joint.name!r}: expected a link of this file as {role}, found "
                    f"{link!r}; correct the name or add the link",
                )
        if joint.child in parent_of:
            other = parent_of[joint.child].name
            faults.add(
                joint.line,
                f"joint {joint.name!r}: expected a tree, found a closed loop: "
                f"link {joint.child!r} is also the child of joint {other!r}; cut the loop at "
                "one of these joints",
            )
        parent_of[joint.child] = joint
    if faults.found:
        return ""
    roots = [name for name in links if name not in parent_of]
    if len(roots) > 1:
        faults.add(
            1,
            f"expected one root link, found {', '.join(map(repr, roots))}; connect them by joints",
        )
        return ""
    root = roots[0] if roots else ""
    _, loose = in_order({child: joint.parent for child, joint in parent_of.items()}, root)
    if not links or loose:
        line = parent_of[loose[0]].line if loose else 1
        found = f"links in a loop: {', '.join(map(repr, loose))}" if loose else "no link"
        faults.add(line, f"expected a tree of links, found {found}; correct the joints")
    return root


def _actuated(robot: Element) -> Iterator[str]:
    """Yield the names of the joints with a transmission, a command interface or a Gazebo drive."""
    for each in robot.all("transmission"):
        yield from (joint.attributes.get("name", "") for joint in each.all("joint"))
    for each in robot.all("ros2_control"):
        for joint in each.all("joint"):
            if joint.first("command_interface") is not None:
                yield joint.attributes.get("name", "")
    for each in robot.all("gazebo"):
        for plugin in each.all("plugin"):
            if DRIVE.search(plugin.attributes.get("filename", "")):
                parts = (part for part in plugin.everything() if "encoder" not in part.tag.lower())
                yield from ("".join(part.texts).strip() for part in parts)
