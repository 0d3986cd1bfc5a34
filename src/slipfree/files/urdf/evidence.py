"""Evidence for choices that a URDF leaves open: from names, actuators, axes, places and partners.

Each piece of evidence supports one choice with a weight; `weigh` adds the weights. Evidence for two
choices of about the same weight is contradictory, and leaves the choice open.
"""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import NamedTuple

from slipfree.files.urdf.xml import Element

CONTRADICTORY = 0.85  # weight of the second choice that leaves the choice open [first choice]
HINT, USUAL, STRONG, COMMAND, NAMES = 1.0, 2.0, 3.0, 4.0, 20.0  # weights of evidence
CONVENTION = 2.5  # weight of the frame convention of URDF
DRIVE = re.compile("drive|steer|ackerman|mecanum|joint.*controller|joint.?force", re.IGNORECASE)
RADIUS = {"wheelradius": 1.0, "wheeldiameter": 0.5}  # elements of plugins, without _
INTERFACES = {  # weights of the interfaces of actuators; springs in simulators have efforts, too
    "position": COMMAND,
    "velocity": COMMAND,
    "posvel": COMMAND,
    "effort": USUAL,
}
TRACK = re.compile(r"(left|right)?(track|belt|crawler|caterpillar|tread)(s|ed)?(left|right)?")
LEG = re.compile("(left|right)?(leg|hip|thigh|knee|shin|calf|ankle|foot|femur|tibia|coxa)")


class Evidence(NamedTuple):
    """A piece of evidence; the choice is empty if it supports none."""

    choice: str
    weight: float
    words: str


class Choice(NamedTuple):
    """The choice that the evidence supports most, the reason with other evidence, and the rival."""

    choice: str
    reason: str
    rival: str  # next choice with evidence; empty without one
    is_open: bool  # whether the evidence is contradictory


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
    pieces, sums = [*dict.fromkeys(pieces)], defaultdict[str, float](float)
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
    evidence = defaultdict[str, list[Evidence]](list)
    for name, interface, kind in _interfaces(robot):
        if "state" not in interface:  # of a sensor
            words = " ".join(filter(None, (interface, kind)))
            weight = INTERFACES.get(interface, STRONG)
            evidence[name].append(Evidence("commanded", weight, words))
    for plugin in plugins(robot):
        if plugin.drives:
            for word in plugin.words:
                evidence[word].append(Evidence("commanded", COMMAND, "plugin of a simulator"))
    springs = [(each.attributes.get("reference", ""), each) for each in robot.all("gazebo")]
    springs += [(each.attributes.get("name", ""), each) for each in robot.all("joint")]
    for name, element in springs:
        values = [(part.tag, "".join(part.texts)) for part in element.children]
        values += [pair for part in element.children for pair in part.attributes.items()]
        if any("springstiff" in key.lower().replace("_", "") and _number(v) for key, v in values):
            evidence[name].append(Evidence("suspension", COMMAND, "a spring in the simulator"))
    return evidence


def _interfaces(robot: Element) -> Iterator[tuple[str, str, str]]:
    """Yield joint, interface and kind of each actuator; the interface is empty if it is unknown."""
    for transmission in robot.all("transmission"):
        parts: Sequence[Element] = [*transmission.everything()]
        texts = ["".join(each.texts) for each in parts if each.tag.lower() == "hardwareinterface"]
        found = [text.rpartition("/")[2].lower().removesuffix("interface") for text in texts]
        kinds = dict.fromkeys(each.removesuffix("joint") for each in found) or {"": None}
        for joint in transmission.all("joint"):
            for kind in kinds:
                yield joint.attributes.get("name", ""), kind, "transmission"
    for control in robot.all("ros2_control"):
        for joint in control.all("joint"):
            for command in joint.all("command_interface"):
                name = command.attributes.get("name", "").lower()
                yield joint.attributes.get("name", ""), name, "command interface"
