"""Evidence for the roles of joints and links in a URDF: one table, and the function that walks it.

Each row of ``evidence.toml`` is a kind of evidence: the choice that it supports in a question, its
weight, and the words for it in notes, questions and guesses. `weigh` adds the weights. Evidence for
two choices of about the same weight is contradictory, and leaves the choice open.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal, NamedTuple

from slipfree.core.errors import read_table
from slipfree.files.urdf.xml import Element, number_in

CONTRADICTORY = 0.85  # weight of the second choice that leaves the choice open [first choice]
TABLE: dict[str, Any] = read_table(__file__, "evidence.toml")
WEIGHTS: dict[str | float, float] = TABLE.pop("weights")
REMEDIES: dict[str, str] = TABLE.pop("remedies")
# of elements; others are errors where one of the first four is missing
ATTRIBUTES: dict[str, list[str]] = TABLE.pop("attributes")
# factors that correct the scale of a mesh, and their reasons
UNITS: dict[float, str] = {float(unit): words for unit, words in TABLE.pop("scales").items()}
USUAL = WEIGHTS["usual"]
SIDES = {side: re.compile(pattern) for side, pattern in TABLE.pop("sides").items()}
AXLES = "along the axles"  # contradicts the direction in which wheels roll
SIZES = TABLE.pop("sizes")  # elements of plugins, without _: attribute and factor
INTERFACES = ("position", "velocity", "posvel", "effort")  # of actuators


def _words(pattern: str) -> re.Pattern[str]:
    return re.compile(pattern, re.IGNORECASE)


# words in names of joints, links, meshes and plugins
WHEEL = _words("wheel|tire|tyre|rueda|roue|ruota")
FREE = "cast[eo]r|loca(?![a-z])|folle|lenkrolle"  # also in Spanish, French, Italian and German
CASTER = _words(f"{FREE}|ball_?wheel|omni_?ball")
TRAILER = _words(f"{FREE}|trailer|hitch|drawbar|swivel")
STEERING = _words("steer|ackerman|knuckle|articulat")
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
    pattern: str = ""  # the first match in the fact, a text, replaces it


ROWS = [
    EvidenceRow(**{**row, "question": question, "weight": WEIGHTS.get(weight, weight)})
    for question, rows in TABLE.items()
    for row in rows
    for weight in [row.get("weight", 0.0)]
]


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
            fact = next(iter(re.findall(row.pattern, fact, re.IGNORECASE)), None)
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
    """A plugin of a simulator: its name, the words in its elements, and sizes of its wheels.

    The words are names of joints, and others; each has the tag of its element.
    """

    name: str
    words: Mapping[str, str]
    radius: float = 0.0  # of the wheels; zero without one [m]
    track: float = 0.0  # distance between the wheels on the left and on the right; the same [m]

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


def plugins(robot: Element) -> tuple[Plugin, ...]:
    """Return the plugins of simulators in a robot."""
    found: list[Plugin] = []
    for gazebo in robot.all("gazebo"):
        for plugin in gazebo.all("plugin"):
            words, sizes = dict[str, str](), dict[str, float]()
            for part in plugin.everything():
                tag = part.tag.lower().replace("_", "")
                if "encoder" not in tag:
                    names = re.split(r"[\s,;'\"\[\]]+", "".join(part.texts).strip())
                    words |= dict.fromkeys(names, tag)
                if tag in SIZES:
                    key, factor = SIZES[tag]
                    sizes[key] = factor * _number("".join(part.texts)) or sizes.get(key, 0.0)
            name = " ".join(plugin.attributes.get(key, "") for key in ("filename", "name"))
            found.append(Plugin(name, words, **sizes))
    return tuple(found)


def _number(text: str) -> float:
    """Return a positive number in a text; zero without one."""
    value = number_in(text)
    return value if 0 < value < math.inf else 0.0


def actuators(robot: Element) -> dict[str, list[Evidence]]:
    """Return the evidence of actuators and springs in a robot, by the name of the joint."""
    interfaces: list[tuple[str, str, str]] = []  # joint, interface, empty if unknown, and kind
    for transmission in robot.all("transmission"):
        parts: Sequence[Element] = [*transmission.everything()]
        texts = ["".join(each.texts) for each in parts if each.tag.lower() == "hardwareinterface"]
        names = [text.rpartition("/")[2].lower().removesuffix("interface") for text in texts]
        names = [*dict.fromkeys(each.removesuffix("joint") for each in names)] or [""]
        for joint in transmission.all("joint"):
            own = joint.attributes.get("name", "")
            interfaces += [(own, name, "transmission") for name in names]
    for joint in (joint for control in robot.all("ros2_control") for joint in control.all("joint")):
        for command in joint.all("command_interface"):
            name = command.attributes.get("name", "").lower()
            interfaces.append((joint.attributes.get("name", ""), name, "command interface"))
    facts: list[tuple[str, str, str]] = []  # joint, fact and value
    for name, interface, kind in interfaces:
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
