"""Keys of problem files of version 0.1, and the keys that replace them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

from slipfree.files.toml.source import Fault

VERBS = ("direct", "plan")  # verbs with changed keys


class KeyChange(NamedTuple):
    """A key of version 0.1 and the key that replaces it.

    Attributes
    ----------
    old : str
        Old key at the top level of a problem file.
    value : str or None
        Old value that is replaced; None if every value is replaced.
    new : tuple of str
        Names of the tables and of the key that replace the old key.
    new_value : str or None
        New value; None to keep the old value.
    words : tuple of str
        New key and old key, as written in a problem file.
    found : str
        Description of the old key in error messages.
    """

    old: str
    value: str | None
    new: tuple[str, ...]
    new_value: str | None
    words: tuple[str, str]
    found: str


CHANGES = (
    KeyChange(
        "slip",
        "traction",
        ("model",),
        "quasi-static",
        ("model = 'quasi-static'", "slip = 'traction'"),
        "'traction'",
    ),
    KeyChange(
        "traction",
        None,
        ("law", "coulomb"),
        None,
        ("[law.coulomb] with model = 'quasi-static'", "[traction]"),
        "the old key 'traction'",
    ),
)


def old_keys(data: Mapping[str, Any]) -> list[KeyChange]:
    """Return the changes of keys that the tables of a problem file need."""
    if data.get("verb") not in VERBS:
        return []
    return [
        each
        for each in CHANGES
        if each.old in data and each.value in (None, data[each.old])  # a table is not hashable
    ]


def upgrade_keys(data: dict[str, Any]) -> tuple[dict[str, Any], list[Fault]]:
    """Return the tables of a problem with current keys, and an error for each old key.

    Parameters
    ----------
    data : dict
        Tables of the file. If it has both keys, the new key takes precedence.
    """
    found, faults = dict(data), list[Fault]()
    for change in old_keys(data):
        old = found.pop(change.old)
        value = old if change.new_value is None else change.new_value
        first, *rest = change.new
        for name in reversed(rest):
            value = {name: value}
        found.setdefault(first, value)
        new, former = change.words
        faults.append(Fault((change.old,), f"{new}, which replaces {former}", change.found))
    return found, faults
