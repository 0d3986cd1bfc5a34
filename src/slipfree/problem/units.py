"""Units of the keys of a problem, from the descriptions of its schema."""

from __future__ import annotations

import re
from typing import Any

from slipfree.files.toml.source import key_path
from slipfree.problem.schema import CommonKeys

UNIT = re.compile(r"\[([^\],]+)\]$")  # a single unit at the end of a description


def unit_of(spec: CommonKeys, key: str) -> str:
    """Return the unit of a dotted key of a problem, such as ``m/s``; empty without a unit."""
    table: Any = spec
    words = ""
    for part in key_path(key):
        if not isinstance(table, dict):
            field = getattr(type(table), "model_fields", {}).get(part)
            words = (field.description or "") if field else ""
        table = table.get(part) if isinstance(table, dict) else getattr(table, part, None)
    found = UNIT.search(words)
    return found[1] if found else ""
