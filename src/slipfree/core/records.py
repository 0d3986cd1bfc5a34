"""Named vectors: one record type for the symbols, labels and values of a vector.

A vector such as the state of a model is declared once, as a ``NamedTuple`` of scalars or of nested
records. The same type contains CasADi symbols, labels or numbers, so that ``state.contacts[0].x``
has the same meaning everywhere.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from html import escape
from itertools import accumulate, pairwise
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt
from typing_extensions import TypeVar  # with a default

R = TypeVar("R")
T = TypeVar("T", default=Any)  # type of the scalars of a record: symbols, labels or values
Record = tuple[object, ...]  # a named tuple of scalars or records, such as the inputs of a model
Array = npt.NDArray[np.float64]
ComplexArray = npt.NDArray[np.complex128]
Mask = npt.NDArray[np.bool_]
Names = npt.NDArray[np.str_]
Indices = npt.NDArray[np.intp]
LINE_WIDTH, MAX_LINES = 92, 5  # largest width and number of lines of a repr
MAX_VALUE = 60  # largest number of characters of a value in a repr


@dataclass(frozen=True)
class Label:
    """Name, unit and description of a quantity in messages, tables and files.

    Attributes
    ----------
    name : str
        Name of the quantity, such as ``"tilt_right"`` or ``"slip_along"``.
    unit : str
        Unit in the spelling of the CF conventions: ``"m"``, ``"rad"``, ``"m s-1"``, ``"1"``.
    words : str
        Description in one line.
    wheel : str or None
        Name of the wheel that the quantity belongs to, if any. Labels that differ only in the wheel
        form one quantity with a value per wheel.
    """

    name: str
    unit: str
    words: str
    wheel: str | None = None

    @property
    def full(self) -> str:
        """Name with the wheel in brackets, if there is one, as in ``slip_along[front]``."""
        return self.name if self.wheel is None else f"{self.name}[{self.wheel}]"


def by_quantity(labels: Iterable[Label]) -> dict[str, tuple[Label, list[int]]]:
    """Return the quantities of labels by name: a label without a wheel, and indices."""
    found: dict[str, tuple[Label, list[int]]] = {}
    for k, each in enumerate(labels):
        words = each.words.replace(f"wheel {each.wheel}", "the wheel")
        found.setdefault(each.name, (Label(each.name, each.unit, words), []))[1].append(k)
    return found


def leaves(record: Any) -> Iterator[Any]:
    """Yield the scalars of a record, depth first."""
    if isinstance(record, tuple):
        for item in record:
            yield from leaves(item)
    else:
        yield record


def pack(record: Any) -> ca.SX:
    """Return the scalars of a record of symbols as a column, shape (n, 1)."""
    return ca.vertcat(ca.SX(0, 1), *leaves(record))


def unpack(like: R, rows: Iterable[Any]) -> R:
    """Return a record with the structure of ``like`` and the scalars of ``rows``, depth first."""
    remaining = iter(rows)

    def build(node: Any) -> Any:
        if isinstance(node, tuple):
            children = [build(item) for item in node]
            return type(node)(*children) if hasattr(node, "_fields") else tuple(children)
        return next(remaining)

    result: R = build(like)
    return result


def consecutive(*counts: int) -> list[slice]:
    """Return the slices of consecutive parts of a column with given numbers of rows."""
    return [slice(a, b) for a, b in pairwise(accumulate(counts, initial=0))]


def symbols(labels: R) -> R:
    """Return a record of SX symbols with the structure and names of a record of labels."""
    return unpack(labels, [ca.SX.sym(label.full) for label in leaves(labels)])


def overview(title: str, **names: Iterable[object]) -> str:
    """Return the repr of a large record: a title, and a line for each nonempty list of names."""
    lists = ((key, ", ".join(map(str, each))) for key, each in names.items())
    lines = [title, *(f"{key}: {text}" for key, text in lists if text)]
    cut = [textwrap.shorten(line, LINE_WIDTH - 2, placeholder=" ...") for line in lines]
    return "\n  ".join(cut)


class HtmlRepr:
    """A record that notebooks show as a table of the lines of its `repr`."""

    def _repr_html_(self) -> str:
        """Return the HTML of the record."""
        title, *lines = repr(self).splitlines()
        rows = (line.strip().partition(": ")[::2] for line in lines)
        return f"<b>{escape(title)}</b>{html_table(rows)}"


def html_table(rows: Iterable[tuple[str, ...]]) -> str:
    """Return an HTML table with a row per name and its cells; names may be indented."""
    lines = list[str]()
    for name, *cells in rows:
        below = ' class="below"' if name.startswith(" ") else ""
        values = "".join(f"<td>{escape(cell)}</td>" for cell in cells)
        head = f'<th scope="row" style="text-align:left"{below}>{escape(name.strip())}</th>'
        lines.append(f"<tr>{head}{values}</tr>")
    return "\n".join(["<table>", *lines, "</table>"])


def field_overview(record: Any) -> str:
    """Return the repr of a dataclass or named tuple, without fields that have their defaults.

    Large values are described by type and size. The text is shortened to five lines.
    """
    if isinstance(record, tuple):
        names, defaults = record._fields, record._field_defaults  # type: ignore[attr-defined]
    else:
        defaults = {each.name: each.default for each in fields(record)}
        names = tuple(defaults)
    given = [
        f"{name}={_short(getattr(record, name))}"
        for name in names
        if name not in defaults or repr(getattr(record, name)) != repr(defaults[name])
    ]
    text = f"{type(record).__name__}({', '.join(given)})"
    return textwrap.fill(
        text, LINE_WIDTH, subsequent_indent="    ", max_lines=MAX_LINES, placeholder=" ...)"
    )


def with_overview(kind: type[T]) -> type[T]:
    """Return a class whose `repr` is `field_overview`; named tuples cannot inherit it."""
    kind.__repr__ = field_overview  # type: ignore[method-assign]
    return kind


def _short(value: Any) -> str:
    """Return the repr of a value; for arrays and long reprs, the type and size of the value."""
    if isinstance(value, str):
        return repr(textwrap.shorten(value, MAX_VALUE, placeholder=" ..."))
    if shape := getattr(value, "shape", None):
        return f"<{type(value).__name__} {tuple(shape)}>"
    text = repr(value)
    if len(text) <= MAX_VALUE and "\n" not in text:
        return text
    size = f" of {len(value)}" if hasattr(value, "__len__") else ""
    return f"<{type(value).__name__}{size}>"


def quantity_names(labels: Any) -> tuple[str, ...]:
    """Return the names of the quantities in a record of labels, without repetition per wheel."""
    return tuple(dict.fromkeys(label.name for label in leaves(labels)))
