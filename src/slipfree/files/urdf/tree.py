"""Reader of the links and joints of a URDF, checked to form a tree."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal, NamedTuple, NoReturn

from slipfree.files.urdf.xml import Element, parse
from slipfree.files.vehicle_draft import MAX_LENGTH, UnfitError, degrees_words, in_order
from slipfree.geometry.frame import Vector
from slipfree.vehicle.wheel import ORIGIN

TYPES = ("fixed", "revolute", "continuous", "prismatic", "floating", "planar")
IGNORED = ("gazebo", "material", "xacro:property", "xacro:arg", "xacro:macro")  # without parts
MAX_LIMIT = 1e3  # larger limits are ignored [rad, m, rad/s or m/s]
FORWARD = (1.0, 0.0, 0.0)  # default axis of a joint


class Shape(NamedTuple):
    """A cylinder about its z axis or a sphere, in the frame of its link.

    Attributes
    ----------
    kind : {"cylinder", "sphere"}
        Kind of the shape.
    radius : float
        Radius. [m]
    at : tuple of 3 floats
        Position of the centre in the frame of the link. [m]
    turned : tuple of 3 floats
        Roll, pitch and yaw of the shape in the frame of the link. [rad]
    """

    kind: Literal["cylinder", "sphere"]
    radius: float
    at: Vector
    turned: Vector


class Box(NamedTuple):
    """A box in the frame of its link.

    Attributes
    ----------
    size : tuple of 3 floats
        Lengths of the edges. [m]
    at, turned : tuple of 3 floats
        Position of the centre, and roll, pitch, yaw. [m, rad]
    """

    size: Vector
    at: Vector
    turned: Vector


class Link(NamedTuple):
    """A link of a URDF.

    Attributes
    ----------
    name : str
        Name of the link.
    mass : float or None
        Mass; None without an element ``inertial``. [kg]
    center : tuple of 3 floats
        Centre of mass in the frame of the link. [m]
    shapes : tuple of Shape
        Cylinders and spheres among the collision shapes; otherwise among the visual shapes.
    meshed : bool
        Whether the link has a mesh.
    boxes : tuple of Box
        Boxes among the collision shapes; otherwise among the visual shapes.
    """

    name: str
    mass: float | None
    center: Vector
    shapes: tuple[Shape, ...]
    meshed: bool
    boxes: tuple[Box, ...] = ()


class Mimic(NamedTuple):
    """Dependence of a joint's value on another joint: ``offset + multiplier * other``.

    Attributes
    ----------
    joint : str
        Name of the other joint.
    multiplier, offset : float
        Coefficients of the other joint's value. [1, rad or m]
    """

    joint: str
    multiplier: float
    offset: float


class UrdfJoint(NamedTuple):
    """A joint of a URDF.

    Attributes
    ----------
    name, type : str
        Name, and type as in the URDF.
    parent, child : str
        Names of the links that it connects.
    at, turned : tuple of 3 floats
        Position, and roll, pitch, yaw of its frame in the parent link. [m, rad]
    axis : tuple of 3 floats
        Axis in the joint's frame; zero for a fixed joint without axis. [1]
    lower, upper : float
        Limits of the value; infinite without limits. [rad or m]
    max_rate : float
        Largest rate; infinite without a limit. [rad/s or m/s]
    mimic : Mimic or None
        Dependence on another joint; None for an independent joint.
    line : int
        Line of the element in the file.
    """

    name: str
    type: str
    parent: str
    child: str
    at: Vector
    turned: Vector
    axis: Vector
    lower: float
    upper: float
    max_rate: float
    mimic: Mimic | None
    line: int

    @property
    def moves(self) -> bool:
        """Whether the joint is not of type ``fixed``."""
        return self.type != "fixed"


class Tree(NamedTuple):
    """Links and joints of a URDF.

    Attributes
    ----------
    file, name, root : str
        Names of the file, the robot and the root link.
    links : dict of str to Link
        Links by name.
    joints : dict of str to UrdfJoint
        Joints by name, parents before children.
    actuated : frozenset of str
        Names of the joints with a transmission or a command interface.
    """

    file: str
    name: str
    root: str
    links: dict[str, Link]
    joints: dict[str, UrdfJoint]
    actuated: frozenset[str]

    def below(self, link: str) -> list[UrdfJoint]:
        """Return all joints below a link: its joints, the joints of their child links, etc."""
        found, known = [], {link}
        for joint in self.joints.values():
            if joint.parent in known:
                found.append(joint)
                known.add(joint.child)
        return found


class Faults:
    """Collection of the errors in a file, with their lines.

    Parameters
    ----------
    file : str
        Name of the file in messages.
    """

    def __init__(self, file: str) -> None:
        self.file = file
        self.found: list[tuple[int, str]] = []

    def add(self, line: int, words: str) -> None:
        """Add an error with its line of the file and its message."""
        self.found.append((line, words))

    @property
    def lines(self) -> list[str]:
        """Messages of all errors in the order of their lines, as ``file:line: words``."""
        return [f"{self.file}:{line}: {words}" for line, words in sorted(self.found)]

    def stop(self) -> NoReturn:
        """Raise UnfitError with all errors."""
        raise UnfitError(self.lines)


def read_tree(data: bytes, file: str) -> Tree:
    """Return the links and joints of a URDF file, checked to form a tree.

    Parameters
    ----------
    data : bytes
        Contents of the file.
    file : str
        Name of the file in messages.

    Raises
    ------
    DataError
        If the file is not XML; an `UnfitError` with all errors if its elements are not valid.
    """
    robot, faults = parse(data, file), Faults(file)
    if robot.tag != "robot":
        faults.add(
            robot.line,
            f"expected URDF with the root element <robot>, found <{robot.tag}>; give a URDF file",
        )
        faults.stop()
    for part in robot.children:
        if part.tag in IGNORED:
            continue
        for each in _everything(part):
            if each.tag.startswith("xacro:") or any("${" in t for t in each.attributes.values()):
                faults.add(
                    each.line,
                    f"expected plain URDF, found xacro in <{part.tag}>; expand it first: "
                    f"xacro {file} > robot.urdf",
                )
                faults.stop()
    for tag in ("link", "joint"):
        _check_names(robot, tag, faults)
    links = {link.name: link for link in (_link(each, faults) for each in robot.all("link"))}
    joints = {joint.name: joint for joint in (_joint(each, faults) for each in robot.all("joint"))}
    root = _root(links, joints, faults) if not faults.found else ""
    if faults.found:
        faults.stop()
    hung, _ = in_order({j.child: j.parent for j in joints.values()}, root)
    by_child = {joint.child: joint for joint in joints.values()}
    ordered = {by_child[child].name: by_child[child] for child in hung}
    name = robot.attributes.get("name", "robot")
    return Tree(file, name, root, links, ordered, frozenset(_actuated(robot)))


def _everything(element: Element) -> Iterator[Element]:
    """Yield an element and all elements in it."""
    left = [element]
    while left:
        each = left.pop()
        yield each
        left += each.children


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
    mass, center = None, ORIGIN
    if inertial is not None:
        center, _ = _origin(inertial, faults, f"link {name!r}")
        weighed = inertial.first("mass")
        if weighed is not None:
            mass = _number(weighed, "value", None, faults, f"link {name!r}: mass")
            if mass < 0:
                faults.add(
                    weighed.line,
                    f"link {name!r}: expected a mass of at least 0 kg, found {mass:g}; correct it",
                )
    shapes = {
        tag: tuple(shape for e in element.all(tag) if (shape := _shape(e, faults, name)))
        for tag in ("collision", "visual")
    }
    drawn = (geometry for tag in shapes for e in element.all(tag) for geometry in e.all("geometry"))
    meshed = any(geometry.first("mesh") is not None for geometry in drawn)
    boxes = {
        tag: tuple(box for e in element.all(tag) if (box := _box(e, faults, name)))
        for tag in ("collision", "visual")
    }
    found, boxed = shapes["collision"] or shapes["visual"], boxes["collision"] or boxes["visual"]
    return Link(name, mass, center, found, meshed, boxed)


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
        faults.add(element.line, f"{who}: expected {expected}, found {kind!r}; choose one")
    ends = []
    for tag in ("parent", "child"):
        end = element.first(tag)
        link = "" if end is None else end.attributes.get("link", "")
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

    They are infinite for kinds of joint without limits, without the attributes ``lower`` and
    ``upper``, and for absolute values of at least 1000. If only one is given, the other is zero, as
    in URDF. Their values are checked later, since a vehicle file may override them.
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
            f"{who}: expected xyz in metres, at most {MAX_LENGTH:g} (did you mean "
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
            element.line, f"{who}: expected three numbers in {key}, found {text!r}; correct them"
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
        faults.add(element.line, f"{who}: expected a number in {key}, found {found}; give one")
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
        faults.add(element.line, f"{who}: expected a name in {key}, found none; give one")
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
    """Yield the names of the joints with a transmission or a command interface."""
    for each in robot.all("transmission"):
        yield from (joint.attributes.get("name", "") for joint in each.all("joint"))
    for each in robot.all("ros2_control"):
        for joint in each.all("joint"):
            if joint.first("command_interface") is not None:
                yield joint.attributes.get("name", "")
