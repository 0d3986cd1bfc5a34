"""Keys of the problems with ``verb = "inverse"``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import ClassVar, Literal

from pydantic import Field

from slipfree.files.toml.source import Fault, format_value
from slipfree.files.toml.source import Place as KeyPath
from slipfree.files.toml.types import Angles, Column, Record, TimeFunction, bare_words
from slipfree.problem.schema import FILE, VERB, MotionKeys, TerrainKeys


class PathTable(Record):
    """Timed path: positions and headings of the platform's centre, as arrays or from a file."""

    t: Column | None = Field(default=None, description="times, increasing from 0 [s]")
    x: Column | None = Field(default=None, description="x at these times [m]")
    y: Column | None = Field(default=None, description="y at these times [m]")
    heading: Angles | None = Field(default=None, description="headings at these times [rad]")
    file: str | None = Field(default=None, description="CSV file with the columns t, x, y, heading")


class Inverse(MotionKeys):
    """Inverse problem: wheel and steering rates for given platform rates or a platform path."""

    verb: Literal["inverse"] = Field(description=VERB)
    given: dict[str, TimeFunction] | None = Field(
        default=None,
        description="rates of the platform by name, or 'file', a CSV file of rates over time "
        "[m/s, rad/s]",
    )
    exact: bool | None = Field(
        default=None,
        description="whether rates in the heading frame are met exactly; otherwise their errors "
        "are minimised; true by default unless all three are given",
    )
    path: PathTable | None = Field(default=None, description="a timed path, instead of given rates")
    steering: Literal["rate", "angle"] = Field(
        default="angle", description="unknown of the steering: its rate or its angle"
    )

    alternatives: ClassVar[Mapping[KeyPath, tuple[str, ...]]] = {
        **TerrainKeys.alternatives,
        (): ("given", "path"),
        ("path",): ("t", "file"),
    }

    @property
    def named_files(self) -> tuple[str, ...]:
        """Name of the CSV file of commands; empty without such a file."""
        file = (self.given or {}).get(FILE)
        return (file,) if isinstance(file, str) else ()

    def faults(self) -> Iterator[Fault]:
        """Yield the errors of values that contradict each other, such as arrays of a path."""
        yield from super().faults()
        path = self.path
        if path is None:
            return
        times = path.t or ()
        if path.heading and (words := bare_words(path.heading[0])):
            yield Fault(("path", "heading"), words, format_value(path.heading[0]))
        for name in ("x", "y", "heading"):
            place, column = ("path", name), getattr(path, name)
            if path.file is not None and column is not None:
                yield Fault(
                    place, "no array beside 'file'", f"{format_value(list(column))}; remove one"
                )
            elif path.file is None and len(column or ()) != len(times):
                expected = f"an array of {len(times)} numbers, one for each time in 't'"
                found = "none" if column is None else f"an array of {len(column)}"
                yield Fault(place, expected, found)
