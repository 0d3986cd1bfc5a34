"""XML as records with line numbers; other formats that are given instead of URDF are refused."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from xml.parsers import expat

from slipfree.core.errors import DataError
from slipfree.files.foreign_formats import FORMATS, TABLE
from slipfree.system.regular_files import regular_file

FAULTS = {getattr(expat.errors, f"XML_ERROR_{name}"): text for name, text in TABLE["xml"].items()}
# by endings, and by names of root elements
REFUSED = {key: each for each in FORMATS if each.robot for key in (*each.endings, *each.roots)}
ROBOTS = (".urdf", ".xacro", ".xml")  # endings of robot descriptions
MAX_ELEMENTS = 50_000  # robots have at most some thousands
HEAD = 200  # bytes that decide whether a file is XML


@dataclass(frozen=True)
class Element:
    """An element of an XML file: tag, attributes, line number, children, and parts of its text."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Element] = field(default_factory=list)
    texts: list[str] = field(default_factory=list)

    def all(self, tag: str) -> Iterator[Element]:
        """Yield the children that have the given tag, in order."""
        return (child for child in self.children if child.tag == tag)

    def first(self, tag: str) -> Element | None:
        """Return the first child that has the given tag; None without such a child."""
        return next(self.all(tag), None)

    def everything(self) -> Iterator[Element]:
        """Yield the element and all elements in it."""
        left = [self]
        while left:
            element = left.pop()
            yield element
            left += reversed(element.children)


def number_in(text: str) -> float:
    """Return the number in a text; NaN without one."""
    try:
        return float(text)
    except ValueError:
        return math.nan


def parse(data: bytes, name: str) -> Element:
    """Return the root element of an XML file; document types, which define entities, are errors.

    So are more than `MAX_ELEMENTS` elements.
    """
    start = data[:HEAD].lstrip(b"\xef\xbb\xbf \t\r\n")
    for known in FORMATS:
        if known.packed and start.startswith(known.magic):
            words = known.packed.format(PurePath(name).name)
            raise DataError(f"{name}: expected XML, found {known.name}; {words}")
    if not data.strip(b"\xef\xbb\xbf \t\r\n\0"):
        raise DataError(f"{name}: expected XML, found an empty file; copy it again")
    if not is_markup(data[:HEAD]):
        words = "found a file that does not begin with '<'"
        raise DataError(f"{name}: expected XML, {words}; give another file, or convert it")
    parser = expat.ParserCreate()
    top = Element("", {}, 0)
    stack = [top]

    count = itertools.count(1)

    def begin(tag: str, attributes: dict[str, str]) -> None:
        """Add an element to the one that is open."""
        if next(count) > MAX_ELEMENTS:
            raise DataError(
                f"{name}:{parser.CurrentLineNumber}: expected a robot of at most {MAX_ELEMENTS} "
                "elements, found more; remove those that do not belong to the vehicle"
            )
        element = Element(tag, attributes, parser.CurrentLineNumber)
        stack[-1].children.append(element)
        stack.append(element)

    def keep(text: str) -> None:
        if not text.isspace():
            stack[-1].texts.append(text)

    def refuse(*_: object) -> None:
        raise DataError(
            f"{name}:{parser.CurrentLineNumber}: expected XML without a document type, found "
            "<!DOCTYPE; remove the declaration and the entities that it defines"
        )

    parser.StartElementHandler = begin
    parser.EndElementHandler = lambda _: stack.pop()
    parser.CharacterDataHandler = keep
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        fault = expat.ErrorString(error.code)
        words = FAULTS.get(fault, f"{fault}; correct it")
        raise DataError(f"{name}:{error.lineno}: expected XML, found {words}") from error
    except DataError:  # a document type; DataError is a ValueError
        raise
    except (LookupError, ValueError) as error:
        raise DataError(
            f"{name}: expected XML in a known encoding such as UTF-8, found another encoding "
            f"({error}); save the file as UTF-8"
        ) from error
    return top.children[0]


def is_markup(head: bytes) -> bool:
    """Return whether the first bytes of a file are those of XML or HTML, in any encoding."""
    return head.replace(b"\0", b"").lstrip(b"\xef\xbb\xbf\xff\xfe \t\r\n").startswith(b"<")


def is_description(path: Path) -> bool:
    """Return whether a file is to be read as a robot description, by its contents or its ending.

    This includes endings of formats that `parse_robot` or `check_ending` refuses by their name. The
    file need not exist if its ending decides.
    """
    endings = [each.lower() for each in path.suffixes]
    if {*endings} & {*ROBOTS, *REFUSED} and endings[-1] != ".toml":
        return True
    try:
        with regular_file(path, "a vehicle file") as size, path.open("rb") as file:
            return is_markup(file.read(min(size, HEAD)))
    except DataError:
        return False


def check_ending(data: bytes, path: Path) -> None:
    """Raise DataError for contents that are not XML in a file with the ending of another format."""
    if path.suffix.lower() in REFUSED and not is_markup(data[:HEAD]):
        _refuse(str(path), path.suffix.lower())


def parse_robot(data: bytes, file: str) -> Element:
    """Return the root element <robot> of a URDF file; raise DataError for another format."""
    root = parse(data, file)
    tag = root.tag.rpartition(":")[2] if root.tag not in REFUSED else root.tag
    if tag in REFUSED:
        _refuse(f"{file}:{root.line}", tag)
    for each in (root, *root.children):
        lower = each.tag.lower()
        if lower in ("robot", "link", "joint") and lower != each.tag:
            raise DataError(
                f"{file}:{each.line}: expected <{lower}>, found <{each.tag}>; write the names of "
                "elements in lower case"
            )
    if root.tag != "robot":
        raise DataError(
            f"{file}:{root.line}: expected URDF with the root element <robot>, found <{root.tag}>; "
            "give a URDF file"
        )
    parts = [part for part in root.children if part.tag in ("link", "joint")]
    inside = [each for part in parts for each in (part, *part.children) if each.tag != "sensor"]
    for each in [*root.children, *(value for part in inside for value in part.children)]:
        is_value = each.texts and not {"value", "link"} & {*each.attributes}
        if is_value and each.tag in ("static", "pose", "parent", "child"):
            _refuse(f"{file}:{each.line}", "sdf")  # which has values as text
    tags = {each.tag for each in root.children}
    if "link" not in tags and {"group", "virtual_joint", "disable_collisions"} & tags:
        _refuse(f"{file}:{root.line}", "srdf")
    return root


def _refuse(where: str, kind: str) -> None:
    found = REFUSED[kind]
    raise DataError(f"{where}: expected URDF, found {found.name}, which is not read; {found.robot}")
