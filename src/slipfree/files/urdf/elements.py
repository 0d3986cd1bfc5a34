"""Reader of the elements of a URDF, checked to form a tree of links and joints."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any, cast

from slipfree.files.urdf import tree, xacro
from slipfree.files.urdf.evidence import ATTRIBUTES, actuators, plugins
from slipfree.files.urdf.wheels import with_separate_balls
from slipfree.files.urdf.xml import Element, number_in, parse_robot
from slipfree.files.vehicle_toml import MAX_LENGTH, degrees_words, in_order, rotation_of
from slipfree.geometry.frame import ORIGIN, Vector, in_axes, is_inertia
from slipfree.vehicle.shapes import Box

TYPES = ("fixed", "revolute", "continuous", "prismatic", "floating", "planar")
DUMMY_MASS = 0.01  # largest mass of links that only place the robot, in masses of the robot
MAX_LIMIT = 1e3  # larger limits mean none, as 1e16 from SDF [rad, m, rad/s or m/s]
FORWARD = (1.0, 0.0, 0.0)  # default axis of a joint
NOTHING: Mapping[str, str] = {}
MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
NEAR = 0.8  # least similarity of a misspelt name


def read_tree(
    data: bytes,
    file: str,
    arguments: Mapping[str, str] = NOTHING,
    macros: frozenset[str] = frozenset(),
) -> tree.Tree:
    """Return the links and joints of a URDF file; a VehicleError has all errors of its elements."""
    robot, findings = parse_robot(data, file), tree.Findings(file)
    xacro.check_macro_calls(robot, file, macros)
    notes = xacro.substitute(robot, file, arguments)
    whole = robot
    robot, omitted = xacro.without_xacro(robot, file, findings)
    for part in [*robot.all("link"), *robot.all("joint")]:
        who = f"{part.tag} {part.attributes.get('name', '')!r}"
        pairs = ((each, child) for each in part.everything() for child in each.children)
        for parent, child in pairs:  # misspelt elements, and attributes that are those of others
            tags = {each.tag for each in parent.children}
            names = xacro.PARTS - tags if child.tag not in xacro.PARTS else ()
            for name in get_close_matches(child.tag.lower(), names, n=1, cutoff=NEAR):
                message = f"{who}: expected <{name}>, found <{child.tag}>; correct the name"
                findings.add(child.line, message)
            known = ATTRIBUTES.get(child.tag, [])
            wrong = [key for key in child.attributes if known and key not in known]
            if wrong and not {*known[:4]} <= {*child.attributes}:
                expected = f"{who}: {child.tag}: expected the attributes {', '.join(known)}"
                findings.add(child.line, f"{expected}, found {', '.join(wrong)}; correct them")
    for tag in ("link", "joint"):
        lines = defaultdict[str, list[int]](list)
        for element in robot.all(tag):
            lines[element.attributes.get("name", "")].append(element.line)
        for name, places in lines.items():
            if len(places) > 1:
                findings.add(
                    places[1],
                    f"{tag} {name!r}: expected a unique name, found {len(places)} {tag}s with it; "
                    "give each a different name",
                )
    unread: list[str] = []
    read = (_link(each, findings, unread) for each in robot.all("link"))
    links = {link.name: link for link in read}
    joints = {
        joint.name: joint for joint in (_joint(each, findings) for each in robot.all("joint"))
    }
    root = _root(links, joints, findings) if not findings.errors else ""
    if findings.errors:
        findings.stop()
    chain: list[tree.UrdfJoint] = []
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
    for joint in chain:
        root = joint.child
        del links[joint.parent], joints[joint.name]
    hung, _ = in_order({j.child: j.parent for j in joints.values()}, root)
    by_child = {joint.child: joint for joint in joints.values()}
    ordered = {by_child[child].name: by_child[child] for child in hung}
    name = robot.attributes.get("name", "robot")
    if chain:
        moving = ", ".join(joint.name for joint in chain)
        notes = (*notes, f"omitted, since they move the robot as a whole: {moving}")
    unknown = (*xacro.unknown_elements(robot), *unread)
    control = actuators(whole), plugins(whole)
    return with_separate_balls(
        tree.Tree(file, name, root, links, ordered, *control, omitted, notes, unknown)
    )


class _UrdfElement:
    """An element of a URDF whose values are read; ``who`` names it in messages of errors."""

    def __init__(self, element: Element, findings: tree.Findings, who: str) -> None:
        self.element, self.who, self._findings = element, who, findings
        self.attributes = element.attributes

    def wrong(self, message: str) -> None:
        """Add an error of the element."""
        self._findings.add(self.element.line, f"{self.who}: {message}")

    def first(self, tag: str, words: str = "") -> _UrdfElement | None:
        """Return the first child with a tag, described by words; None without such a child."""
        child = self.element.first(tag)
        return None if child is None else self.about(child, words)

    def about(self, child: Element, words: str = "") -> _UrdfElement:
        """Return a child, described by words."""
        return _UrdfElement(child, self._findings, f"{self.who}: {words}" if words else self.who)

    def name(self, key: str) -> str:
        """Return a required name."""
        if not self.attributes.get(key):
            self.wrong(f"expected a name in the attribute {key!r}, found none; add it")
        return self.attributes.get(key, "")

    def number(self, key: str, default: float | None = None, *, is_bound: bool = False) -> float:
        """Return a number, infinite only if it is a bound; one without a default is required."""
        text = self.attributes.get(key)
        if text is None and default is not None:
            return default
        value = number_in(text or "")
        if math.isnan(value) or (math.isinf(value) and not is_bound):
            wrong = "none; add it" if text is None else f"{text!r}; correct it"
            self.wrong(f"expected a number in {key!r}, found {wrong}")
            return default or 1.0
        return value

    def vector(self, key: str, default: Vector = ORIGIN, text: str | None = None) -> Vector:
        """Return the three numbers in a text, by default an attribute; ones if they are invalid."""
        text = self.attributes.get(key) if text is None else text
        if text is None:
            return default
        values = [number_in(number) for number in text.replace(",", " ").split()]
        if len(values) != 3 or not all(map(math.isfinite, values)):
            self.wrong(f"expected three numbers in {key!r}, found {text!r}; correct them")
            return 1.0, 1.0, 1.0
        return values[0], values[1], values[2]

    def origin(self) -> tuple[Vector, Vector]:
        """Return position [m] and roll, pitch, yaw [rad] in ``origin``; zeros without an origin."""
        origin = self.first("origin", "origin")
        if origin is None:
            return ORIGIN, ORIGIN
        at, turned = origin.vector("xyz"), origin.vector("rpy")
        origin = self.about(origin.element)
        if max(map(abs, at)) > MAX_LENGTH:
            origin.wrong(
                f"expected xyz in metres, from {-MAX_LENGTH:g} to {MAX_LENGTH:g} (did you mean "
                f"millimetres?), found {origin.attributes['xyz']}; correct it"
            )
        for angle in turned:
            if hint := degrees_words(angle):
                origin.wrong(f"expected rpy in radians ({hint}), found {angle:g}")
        return at, turned


def _link(element: Element, findings: tree.Findings, unread: list[str]) -> tree.Link:
    """Return the link of a ``<link>`` element."""
    name = _UrdfElement(element, findings, "link").name("name")
    link = _UrdfElement(element, findings, f"link {name!r}")
    mass, center, inertia = None, ORIGIN, None
    if (inertial := link.first("inertial")) is not None:
        center, turned = inertial.origin()
        if (tensor := inertial.first("inertia", "inertia")) is not None:
            xx, yy, zz, xy, xz, yz = (tensor.number(key, 0.0) for key in MOMENTS)
            moments = (xx, yy, zz, xy, xz, yz)
            inertia = in_axes(rotation_of(turned), moments) if is_inertia(moments) else None
        if (weighed := inertial.first("mass", "mass")) is not None:
            mass = weighed.number("value")
            if mass < 0:
                message = f"expected a mass of at least 0 kg, found {mass:g}; correct it"
                link.about(weighed.element).wrong(message)

    found: dict[str, list[tree.Geometry]] = {"collision": [], "visual": []}
    for shape in (child for child in element.children if child.tag in found):
        if (geometry := _geometry(link, shape, unread)) is not None:
            found[shape.tag].append(geometry)

    def of(kind: type[tree.G]) -> tuple[tree.G, ...]:
        every = ([each for each in group if isinstance(each, kind)] for group in found.values())
        return tuple(next(filter(None, every), ()))

    shapes, meshes, boxes = of(tree.Shape), of(tree.MeshFile), of(Box)
    visuals, collisions = tuple(found["visual"]), tuple(found["collision"])
    return tree.Link(name, mass, center, shapes, meshes, boxes, inertia, visuals, collisions)


def _geometry(link: _UrdfElement, shape: Element, unread: list[str]) -> tree.Geometry | None:
    """Return the shape of a collision or visual element; add one that is not read to ``unread``."""
    at, turned = link.about(shape, shape.tag).origin()
    geometry = shape.first("geometry")
    child = None if geometry is None else next(iter(geometry.children), None)
    kind = "" if child is None else child.tag.rpartition(":")[2]  # as in <drake:capsule>
    solid = None if child is None else link.about(child, kind)
    if solid is not None and kind == "mesh":
        # three factors, one for all axes, or a fourth that is ignored
        factors = solid.attributes.get("scale", "1").replace(",", " ").split()
        factors = {1: factors * 3, 4: factors[:3]}.get(len(factors), factors)
        scale = solid.vector("scale", text=" ".join(factors))
        if not all(scale):
            text = solid.attributes["scale"]
            solid.wrong(
                f"expected factors other than zero in 'scale', found {text!r}; correct them"
            )
        file = solid.attributes.get("filename", solid.attributes.get("uri", ""))
        return tree.MeshFile(file, scale, at, turned)
    if solid is not None and kind == "box":
        size = solid.vector("size")
        if min(size) > 0:
            return Box(size, at, turned)
        kind = "box without size"
    if solid is None or kind not in ("cylinder", "sphere", "capsule"):
        found = f"a <{kind}>" if kind else "no shape"
        read = "<box>, <sphere>, <cylinder>, <capsule> and <mesh> are read"
        unread.append(f"{shape.line}: {link.who}: {found} as <{shape.tag}>; {read}")
        return None
    radius = solid.number("radius")
    if not 0 < radius <= MAX_LENGTH:
        link.about(solid.element).wrong(
            f"expected the radius of a {kind} in metres, greater than 0 and at most "
            f"{MAX_LENGTH:g}, found {radius:g}; correct it"
        )
    return tree.Shape(cast(Any, kind), radius, at, turned, length=solid.number("length", 0.0))


def _joint(element: Element, findings: tree.Findings) -> tree.UrdfJoint:
    """Return the joint of a ``<joint>`` element.

    A revolute joint without finite limits is ``continuous``, as wheels are. If one
    of ``lower`` and ``upper`` is missing, it is zero, as URDF specifies; without both, there is no
    limit. A largest rate of zero means none.
    """
    name = _UrdfElement(element, findings, "joint").name("name")
    kind = element.attributes.get("type", "")
    joint = _UrdfElement(element, findings, f"joint {name!r}")
    if kind not in TYPES:
        wrong = repr(kind) if kind else "none"
        joint.wrong(f"expected one of the types {', '.join(TYPES)}, found {wrong}; choose one")
    parent, child = ends = [xacro.link_at(element, tag) for tag in ("parent", "child")]
    for tag, link in zip(("parent", "child"), ends, strict=True):
        if not link:
            joint.wrong(f'expected <{tag} link="..."/>, found none; add it')
    at, rpy = joint.origin()
    pointed, axis = joint.first("axis", "axis"), ORIGIN if kind == "fixed" else FORWARD
    if pointed is not None:
        axis = pointed.vector("xyz", FORWARD)
        if not math.hypot(*axis) > 0 and kind not in ("fixed", "floating"):
            joint.about(pointed.element).wrong(
                "expected an axis other than zero, found 0 0 0; "
                'write <axis xyz="0 1 0"/> for an axis to the left'
            )
    limit, lower, upper = joint.first("limit", "limit"), -math.inf, math.inf
    rate = effort = math.inf
    if limit is not None:
        if kind in ("revolute", "prismatic", "fixed") and {"lower", "upper"} & {*limit.attributes}:
            low, high = (limit.number(key, 0.0, is_bound=True) for key in ("lower", "upper"))
            lower = low if abs(low) < MAX_LIMIT else lower
            upper = high if abs(high) < MAX_LIMIT else upper
        given = (limit.number(key, 0.0, is_bound=True) for key in ("velocity", "effort"))
        rate, effort = (most if 0 < most < MAX_LIMIT else math.inf for most in given)
    if kind == "revolute" and math.isinf(lower) and math.isinf(upper):
        kind = "continuous"
    follows = None
    if (mimic := joint.first("mimic", "mimic")) is not None:
        factor, offset = mimic.number("multiplier", 1.0), mimic.number("offset", 0.0)
        follows = tree.Mimic(mimic.name("joint"), factor, offset)
    return tree.UrdfJoint(
        name, kind, parent, child, at, rpy, axis, lower, upper, rate, effort, follows, element.line
    )


def _root(
    links: dict[str, tree.Link], joints: dict[str, tree.UrdfJoint], findings: tree.Findings
) -> str:
    """Return the name of the root link; add errors if the links and joints do not form a tree."""
    parent_of: dict[str, tree.UrdfJoint] = {}
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
