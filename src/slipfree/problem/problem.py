"""A validated problem, and where each of its values comes from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from slipfree.files.toml.source_lines import Source
from slipfree.problem.schema import Asked, Task

S = TypeVar("S", bound=Task)
A = TypeVar("A", bound=Asked)


@dataclass(frozen=True)
class Problem(Generic[A]):
    """A validated problem, and where each of its values comes from.

    Attributes
    ----------
    spec : Asked
        The record of its verb's schema.
    source : Source
        File, lines and settings of the values.
    """

    spec: A
    source: Source

    def __repr__(self) -> str:
        return f"Problem: {self.spec.verb}, {self.source.path}"

    @property
    def folder(self) -> Path:
        """Folder of relative names of input files."""
        return self.source.path.parent
