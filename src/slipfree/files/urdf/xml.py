"""Reader of XML as records with line numbers; document types and entities are rejected."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from slipfree.errors import DataError


@dataclass(frozen=True)
class Element:
    """An element of an XML file: tag, attributes, children and line number."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Element] = field(default_factory=list)

    def all(self, tag: str) -> Iterator[Element]:
        """Yield the children that have the given tag, in order."""
        return (child for child in self.children if child.tag == tag)

    def first(self, tag: str) -> Element | None:
        """Return the first child that has the given tag; None without such a child."""
        return next(self.all(tag), None)


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
        If the file is not XML, or if it declares a document type, which could define entities.
    """
    parser = expat.ParserCreate()
    top = Element("", {}, 0)
    stack = [top]

    def start(tag: str, attributes: dict[str, str]) -> None:
        element = Element(tag, attributes, parser.CurrentLineNumber)
        stack[-1].children.append(element)
        stack.append(element)

    def refuse(*_: object) -> None:
        raise DataError(
            f"{name}:{parser.CurrentLineNumber}: expected XML without a document type, found "
            "<!DOCTYPE; remove the declaration and the entities that it defines"
        )

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: stack.pop()
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        words = expat.ErrorString(error.code)
        raise DataError(
            f"{name}:{error.lineno}: expected XML, found {words}; correct it"
        ) from error
    except DataError:  # a document type; DataError is a ValueError
        raise
    except (LookupError, ValueError) as error:
        raise DataError(
            f"{name}: expected XML in a known encoding such as UTF-8, found another encoding "
            f"({error}); save the file as UTF-8"
        ) from error
    return top.children[0]
