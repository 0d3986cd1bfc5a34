"""Reader of XML as records with line numbers; document types and entities are rejected."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import PurePath
from xml.parsers import expat

from slipfree.errors import DataError
from slipfree.files.foreign_formats import PACKED

REMEDIES = {
    expat.errors.XML_ERROR_MISPLACED_XML_PI: "move <?xml ... ?> to the beginning of the first "
    "line, before comments, blanks and blank lines, and keep one",
    expat.errors.XML_ERROR_JUNK_AFTER_DOC_ELEMENT: "keep one root element",
    expat.errors.XML_ERROR_TAG_MISMATCH: "close each element with its own name",
    expat.errors.XML_ERROR_UNCLOSED_TOKEN: "the file may be truncated: copy it again",
    expat.errors.XML_ERROR_NO_ELEMENTS: "the file may be truncated: copy it again",
    expat.errors.XML_ERROR_DUPLICATE_ATTRIBUTE: "remove one of the attributes of the same name",
    expat.errors.XML_ERROR_UNDEFINED_ENTITY: "write the character itself",
    expat.errors.XML_ERROR_INCORRECT_ENCODING: "save the file as UTF-8 and write "
    'encoding="utf-8" in its first line',
    expat.errors.XML_ERROR_INVALID_TOKEN: "save the file as UTF-8, and write &amp; for & and "
    "&lt; for <; comments must not contain --",
}


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
            each = left.pop()
            yield each
            left += reversed(each.children)


def parse(data: bytes, name: str) -> Element:
    """Return the root element of an XML file.

    Parameters
    ----------
    data : bytes
        Contents of the file.
    name : str
        Name of the file in messages.

    Raises
    ------
    DataError
        If the file is not XML, or declares a document type, which could define entities.
    """
    _check_contents(data, name)
    parser = expat.ParserCreate()
    top = Element("", {}, 0)
    stack = [top]

    def start(tag: str, attributes: dict[str, str]) -> None:
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

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: stack.pop()
    parser.CharacterDataHandler = keep
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        words = expat.ErrorString(error.code)
        remedy = REMEDIES.get(words, "correct it")
        raise DataError(f"{name}:{error.lineno}: expected XML, found {words}; {remedy}") from error
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


def _check_contents(data: bytes, name: str) -> None:
    """Raise DataError for contents that are known not to be XML."""
    start = data[:200].lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    for found, _, head, remedy in PACKED:
        if head and start.startswith(head.lower()):
            words = remedy.format(PurePath(name).name)
            raise DataError(f"{name}: expected XML, found {found}; {words}")
    if not data.strip(b"\xef\xbb\xbf \t\r\n\0"):
        raise DataError(f"{name}: expected XML, found an empty file; copy it again")
    if not is_markup(data[:200]):
        words = "found a file that does not begin with '<'"
        raise DataError(f"{name}: expected XML, {words}; give another file, or convert it")
