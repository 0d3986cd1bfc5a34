"""A validated problem, and the origin of each value."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

from slipfree.files.toml.source import Source
from slipfree.problem.schema import CommonKeys, TerrainKeys

S = TypeVar("S", bound=TerrainKeys)
A = TypeVar("A", bound=CommonKeys)


@dataclass(frozen=True)
class Problem(Generic[A]):
    """A validated problem, and the origin of each value.

    Attributes
    ----------
    spec : CommonKeys
        Values of the problem file, a record of the schema of its verb.
    source : Source
        File, lines and settings of the values.
    trusted : frozenset of str
        Paths of xacro files that the command line allows to be expanded; no file can do so.
    vehicles : dict
        Contents of the vehicle files that were read, by name. Those of a result are stored in it,
        so that none is read.
    """

    spec: A
    source: Source
    trusted: frozenset[str] = frozenset()
    vehicles: dict[str, Any] = field(default_factory=dict, compare=False, repr=False)

    def __repr__(self) -> str:
        return f"Problem: {self.spec.verb}, {self.source.path}"

    @property
    def folder(self) -> Path:
        """Folder of the problem file, to which the names of input files are relative."""
        return self.source.path.parent
