"""Evidence for the roles of joints and links in a URDF: one table, and the function that walks it.

Each row of `ROWS` is a kind of evidence: the choice that it supports in a question, its weight, and
the words for it in notes, questions and guesses. `weigh` adds the weights. Evidence for two choices
of about the same weight is contradictory, and leaves the choice open.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

from slipfree.files.urdf.xml import Element

CONTRADICTORY = 0.85  # weight of the second choice that leaves the choice open [first choice]
HINT, USUAL, STRONG, COMMAND, NAMES = 1.0, 2.0, 3.0, 4.0, 20.0  # weights of evidence
AXLES = "along the axles"  # contradicts the direction in which wheels roll
CONVENTION = 2.5  # weight of the frame convention of URDF
RADIUS = {"wheelradius": 1.0, "wheeldiameter": 0.5}  # elements of plugins, without _
INTERFACES = ("position", "velocity", "posvel", "effort")  # of actuators


def _words(pattern: str) -> re.Pattern[str]:
    return re.compile(pattern, re.IGNORECASE)


# words in names of joints, links, meshes and plugins
WHEEL = _words("wheel|tire|tyre")
CASTER = _words("cast[eo]r|ball_?wheel|omni_?ball")
TRAILER = _words("cast[eo]r|trailer|hitch|drawbar|swivel")
SUSPENSION = _words("suspension|rocker|bogie|spring|shock|damper|strut|swing")
LIFT = _words("lift|leg|hip|knee|flipper|arm|elbow")
STEERING = _words("steer|ackerman|knuckle")
PASSIVE = _words("passive|idle|free.?wheel|undriven|odom|encoder")
OMNI = _words("omni|mecanum|swedish")
MECANUM = _words("mecanum|swedish")
FOOTPRINT = _words("footprint")  # link on the ground, by REP 120
CAMERA = _words("camera|kinect|realsense")
DRIVE = _words("drive|steer|ackerman|mecanum|joint.*controller|joint.?force")
TRACK = re.compile(r"(left|right)?(track|belt|crawler|caterpillar|tread)(s|ed)?(left|right)?")
LEG = re.compile("(left|right)?(leg|hip|thigh|knee|shin|calf|ankle|foot|femur|tibia|coxa)")

Question = Literal["kind", "driven", "ground", "radius", "forward", "wheel"]


class EvidenceRow(NamedTuple):
    """A kind of evidence. It is there if its fact is neither None, False, zero nor empty."""

    question: Question
    fact: str  # its name
    words: str  # {} is replaced by the fact, names in braces by other facts
    choice: str = ""  # that it supports, {} is replaced by the fact; empty if it supports none
    weight: float = 0.0
    pattern: re.Pattern[str] | None = None  # the first match in the fact, a text, replaces it


ROWS = (
    # kind of the coordinate of a joint that carries wheels
    EvidenceRow("kind", "rocks", "it lets wheels follow the ground", "suspension", USUAL),
    EvidenceRow("kind", "rocker", "{!r} in its name", "suspension", USUAL, SUSPENSION),
    EvidenceRow("kind", "rocker", "{!r} in its name", "commanded", HINT, LIFT),
    EvidenceRow("kind", "slides", "it slides a wheel sideways", "commanded", USUAL),
    EvidenceRow("kind", "turns", "a steep axis above a wheel steers it", "commanded", USUAL),
    EvidenceRow("kind", "swivels", "a caster or a trailer swivels", "passive", COMMAND + HINT),
    EvidenceRow("kind", "position", "{}", "commanded", COMMAND),
    EvidenceRow("kind", "velocity", "{}", "commanded", COMMAND),
    EvidenceRow("kind", "posvel", "{}", "commanded", COMMAND),
    EvidenceRow("kind", "effort", "{}", "commanded", USUAL),  # also of springs in simulators
    EvidenceRow("kind", "interface", "{}", "commanded", STRONG),
    EvidenceRow("kind", "plugin", "plugin of a simulator", "commanded", COMMAND),
    EvidenceRow("kind", "spring", "a spring in the simulator", "suspension", COMMAND),
    EvidenceRow("kind", "no wheel", "it carries no wheel", "fixed"),
    EvidenceRow("kind", "balls", "it carries only balls, which slide freely", "fixed"),
    EvidenceRow(
        "kind",
        "too many",
        "with so few wheels, it and its counterpart cannot follow the ground",
        "fixed",
    ),
    # drive of a wheel
    EvidenceRow("driven", "actuator", "it has an actuator", "driven", COMMAND),
    EvidenceRow("driven", "actuator of others", "other wheels have an actuator", "free", USUAL),
    EvidenceRow("driven", "names", "its name", "free", USUAL, PASSIVE),
    EvidenceRow("driven", "caster", "a caster", "free", USUAL),
    EvidenceRow("driven", "nothing", "no wheel has an actuator", "driven", HINT),
    # round shape far above the ground: a wheel, or a part that does not move
    EvidenceRow("ground", "high", "its shape ends far above the lowest wheel", "fixed", USUAL),
    EvidenceRow("ground", "alike", "radius of other wheels", "wheel", USUAL),
    EvidenceRow("ground", "names", "its name", "wheel", HINT, WHEEL),
    # radius of opposite wheels with different shapes
    EvidenceRow("radius", "height", "height above the ground of the other wheels", "{}", USUAL),
    EvidenceRow("radius", "plugin of large", "plugin of a simulator", "{}", COMMAND),
    EvidenceRow("radius", "plugin of small", "plugin of a simulator", "{}", COMMAND),
    EvidenceRow("radius", "large", "shape of {names[0]}", "{}", USUAL),
    EvidenceRow("radius", "small", "shape of {names[1]}", "{}", USUAL),
    EvidenceRow("radius", "tiny", "shape of {names[1]}", "{}", HINT),
    # forward direction
    EvidenceRow("forward", "front of wheels", "names of front and rear", "{}", NAMES),
    EvidenceRow("forward", "front on axles", f"names of front and rear: {AXLES}", AXLES, NAMES),
    EvidenceRow("forward", "front", "names of front and rear", "{}", HINT),
    EvidenceRow("forward", "left of wheels", "names of left and right", "{}", NAMES),
    EvidenceRow("forward", "left on axles", f"names of left and right: {AXLES}", AXLES, NAMES),
    EvidenceRow("forward", "left", "names of left and right", "{}", HINT),
    EvidenceRow("forward", "steered", "steered wheels", "{}", USUAL),
    EvidenceRow("forward", "view", "views of cameras", "{}", HINT),
    EvidenceRow("forward", "axes", "signs of the wheels' axes", "{}", HINT),
    EvidenceRow(
        "forward", "front misplaced", "names of front and rear disagree with the places of {}"
    ),
    EvidenceRow(
        "forward", "left misplaced", "names of left and right disagree with the places of {}"
    ),
    EvidenceRow("forward", "convention", "the frame convention of URDF", "x", CONVENTION),
    # wheels, whose facts are their roles: the first one counts
    EvidenceRow("wheel", "given radius", "a mesh, its given radius"),
    EvidenceRow("wheel", "plugin", "its radius in a plugin of a simulator"),
    EvidenceRow("wheel", "full turn", "a round shape and a full turn, in spite of its limits"),
    EvidenceRow("wheel", "shape and limits", "its name and a round shape, in spite of its limits"),
    EvidenceRow("wheel", "shape", "its name and a round shape"),
    EvidenceRow(
        "wheel",
        "footprint",
        "its name, without a round shape; radius from the least height above the footprint",
    ),
    EvidenceRow("wheel", "name", "its name"),
    EvidenceRow("wheel", "trail", "it trails the axis of a caster"),
    EvidenceRow("wheel", "ball", "a caster slides freely as a ball; {reason}"),
    EvidenceRow("wheel", "mirrored", "its counterpart on the other side, {other}, is one"),
    EvidenceRow("wheel", "rollers", "with rollers, at the angle of their axes"),
    EvidenceRow(
        "wheel", "odd", "its rollers have axes along its own, or at different angles to it"
    ),
    EvidenceRow(
        "wheel",
        "mecanum",
        "with oblique rollers: its name; on top of the wheels, their axes form an X",
    ),
    EvidenceRow("wheel", "no swivel", "a caster without a swivel slides freely along its axle"),
    EvidenceRow("wheel", "oblique", "with rollers, since the axles are not parallel"),
)


class Evidence(NamedTuple):
    """A piece of evidence, and its fact."""

    choice: str
    weight: float
    words: str
    fact: Any


def evidence(question: Question, facts: Mapping[str, Any]) -> Iterator[Evidence]:
    """Yield the evidence in a question, in the order of the table, from facts by their names."""
    for row in ROWS:
        fact = facts.get(row.fact) if row.question == question else None
        if fact and row.pattern:
            fact = next(iter(row.pattern.findall(fact)), None)
        if fact:
            words = row.words.format(fact, **facts)
            yield Evidence(row.choice.format(fact), row.weight, words, fact)


def wheel_evidence(role: Any, fact: str, **others: str) -> Evidence:
    """Return the evidence of a fact that a joint carries a wheel with a role."""
    return next(evidence("wheel", {fact: role, **others}))


class Choice(NamedTuple):
    """The choice that the evidence supports most, the reason with other evidence, and the rival."""

    choice: str
    reason: str
    rival: str = ""  # next choice with evidence; empty without one
    is_open: bool = False  # whether the evidence is contradictory
    alike: tuple[str, ...] = ()  # joints with the same contradictory evidence


class Plugin(NamedTuple):
    """A plugin of a simulator: its name, the words in its elements, and the radius of its wheels.

    The words are names of joints, and others; each has the tag of its element.
    """

    name: str
    words: Mapping[str, str]
    radius: float | None  # [m]; None without one

    @property
    def drives(self) -> bool:
        """Whether the plugin moves the joints in it."""
        return bool(DRIVE.search(self.name))


def weigh(pieces: Iterable[Evidence], default: str = "") -> Choice:
    """Return the choice with the largest sum of weights; the default one without any evidence."""
    pieces = [*{piece[:3]: piece for piece in pieces}.values()]
    sums = defaultdict[str, float](float)
    for piece in pieces:
        sums[piece.choice] += piece.weight
    sums.pop("", None)
    best, *others = sorted(sums, key=lambda choice: -sums[choice]) or [default]
    rival = others[0] if others else ""
    reason = ", ".join(piece.words for piece in pieces if piece.choice == best)
    against = ", ".join(
        f"{piece.words} ({piece.choice})" if piece.choice else piece.words
        for piece in pieces
        if piece.choice != best
    )
    if against:
        reason = f"{reason}; against it: {against}" if reason else against
    is_open = bool(rival) and sums[rival] >= CONTRADICTORY * sums[best]
    return Choice(best, reason, rival, is_open)


def words_of(name: str) -> list[str]:
    """Return the words of a name in lower case, such as "front" and "left" of "frontLeft_2"."""
    return re.findall("[a-z]+", re.sub("([a-z0-9])([A-Z])", r"\1 \2", name).lower())


def names_of(element: Element) -> list[str]:
    """Return the words of an element's text, such as the names of joints in a list."""
    return re.split(r"[\s,;'\"\[\]]+", "".join(element.texts).strip())


def plugins(robot: Element) -> tuple[Plugin, ...]:
    """Return the plugins of simulators in a robot."""
    found: list[Plugin] = []
    for gazebo in robot.all("gazebo"):
        for plugin in gazebo.all("plugin"):
            words: dict[str, str] = {}
            radius = None
            for part in plugin.everything():
                tag = part.tag.lower().replace("_", "")
                if "encoder" not in tag:
                    words |= dict.fromkeys(names_of(part), tag)
                if tag in RADIUS:
                    radius = RADIUS[tag] * _number("".join(part.texts)) or radius
            name = " ".join(plugin.attributes.get(key, "") for key in ("filename", "name"))
            found.append(Plugin(name, words, radius))
    return tuple(found)


def _number(text: str) -> float:
    """Return a positive number in a text; zero without one."""
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if 0 < value < math.inf else 0.0


def actuators(robot: Element) -> dict[str, list[Evidence]]:
    """Return the evidence of actuators and springs in a robot, by the name of the joint."""
    facts: list[tuple[str, str, str]] = []  # joint, fact and value
    for name, interface, kind in _interfaces(robot):
        if "state" not in interface:  # of a sensor
            fact = interface if interface in INTERFACES else "interface"
            facts.append((name, fact, " ".join(filter(None, (interface, kind)))))
    for plugin in plugins(robot):
        facts += [(word, "plugin", "drive") for word in plugin.words if plugin.drives]
    springs = [(each.attributes.get("reference", ""), each) for each in robot.all("gazebo")]
    springs += [(each.attributes.get("name", ""), each) for each in robot.all("joint")]
    for name, element in springs:
        values = [(part.tag, "".join(part.texts)) for part in element.children]
        values += [pair for part in element.children for pair in part.attributes.items()]
        if any("springstiff" in key.lower().replace("_", "") and _number(v) for key, v in values):
            facts.append((name, "spring", "spring"))
    by_name = defaultdict[str, list[Evidence]](list)
    for name, fact, value in facts:
        by_name[name] += evidence("kind", {fact: value})
    return by_name


def _interfaces(robot: Element) -> Iterator[tuple[str, str, str]]:
    """Yield joint, interface and kind of each actuator; the interface is empty if it is unknown."""
    for transmission in robot.all("transmission"):
        parts: Sequence[Element] = [*transmission.everything()]
        texts = ["".join(each.texts) for each in parts if each.tag.lower() == "hardwareinterface"]
        interfaces = [text.rpartition("/")[2].lower().removesuffix("interface") for text in texts]
        kinds = dict.fromkeys(each.removesuffix("joint") for each in interfaces) or {"": None}
        for joint in transmission.all("joint"):
            for kind in kinds:
                yield joint.attributes.get("name", ""), kind, "transmission"
    for control in robot.all("ros2_control"):
        for joint in control.all("joint"):
            for command in joint.all("command_interface"):
                name = command.attributes.get("name", "").lower()
                yield joint.attributes.get("name", ""), name, "command interface"
