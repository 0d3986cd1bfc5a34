"""Migration of problem and vehicle files of version 0.1 to current keys.

Comments and layout of the files are preserved.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import tomlkit
from tomlkit.items import Key, KeyType, SingleKey, Table

from slipfree.files.toml.source import (
    Fault,
    ProblemError,
    Source,
    key_lines,
    parse_toml,
    problem_error,
)
from slipfree.problem.old_keys import KeyChange, old_keys, upgrade_keys


class Migrated(NamedTuple):
    """A migrated file.

    Attributes
    ----------
    text : str
        Text with current keys.
    changes : tuple of str
        Description of each change, with line, old and new key; empty without changes.
    note : str
        Note on keys whose meaning has changed; empty without such keys.
    """

    text: str
    changes: tuple[str, ...]
    note: str = ""


def migrate_text(path: Path, text: str) -> Migrated:
    """Rename the old keys in the text of a problem or vehicle file.

    Parameters
    ----------
    path : Path
        Name of the file, for errors.
    text : str
        Text of the file.

    Raises
    ------
    ProblemError
        If the text is not TOML or not that of a problem or vehicle file, has both an old key and
        its replacement, or has old keys in a layout that cannot be preserved.
    """
    data = parse_toml(path, text)
    if not {"verb", "wheels"} & set(data):
        raise ProblemError(
            f"{path}: expected a problem file, with the key 'verb', or a vehicle file, with "
            "'wheels', found neither key; check the name of the file"
        )
    source = Source(path, text, key_lines(text))
    found = old_keys(data)
    note = _note(source, data)
    if not found:
        return Migrated(text, (), note)
    both = [
        Fault((each.old,), f"either {each.words[1]} or {each.new[0]!r}", "both; keep one of them")
        for each in found
        if each.new[0] in data
    ]
    if both:
        raise problem_error(source, both)
    document = tomlkit.parse(text)
    for change in found:
        _rename(document, change)
    changed = document.as_string()
    if parse_toml(path, changed) != upgrade_keys(data)[0]:
        wanted = ", ".join(f"{each.words[1]} by {each.words[0]}" for each in found)
        raise ProblemError(
            f"{path}: expected old keys that can be replaced without changing the layout of the "
            f"file, found others; in an editor, replace {wanted}"
        )
    words = (f"{source.where((c.old,))}: {c.words[1]} is now {c.words[0]}" for c in found)
    return Migrated(changed, tuple(words), note)


def _note(source: Source, data: dict[str, Any]) -> str:
    """Return the note on headings in files with ``frame = "rep103"``; empty for others."""
    if "verb" not in data or data.get("frame") != "rep103":
        return ""
    start, limits = data.get("start", {}), data.get("limits", {})
    remedies = []
    if "heading" not in start:
        remedies.append(
            "the start now faces +x (0.1.0: +y): to face +y, set start.heading = '90 deg'"
        )
    if "heading" in limits:
        remedies.append("limits.heading is now measured from the x axis (0.1.0: from the y axis)")
    return f"{source.where(('frame',))}: {'; '.join(remedies)}" if remedies else ""


def _rename(document: tomlkit.TOMLDocument, change: KeyChange) -> None:
    """Replace an old key and its value in a document, at the same position."""
    for index, (key, item) in enumerate(document.body):
        if key is None or key.key != change.old:
            continue
        if change.new_value is not None:
            value = tomlkit.string(change.new_value)
            for part in ("indent", "comment_ws", "comment", "trail"):
                setattr(value.trivia, part, getattr(item.trivia, part))
            item = value
        if isinstance(item, Table) and not key.is_dotted():
            item.display_name = ".".join(change.new)
        document.body[index] = (_key(key, ".".join(change.new)), item)


def _key(old: Key, name: str) -> SingleKey:
    """Return a key, possibly dotted, with spaces and equals sign as those of the key ``old``."""
    text = old.as_string()
    spaces = text[len(text.rstrip()) :]
    new = SingleKey(name, t=KeyType.Bare, sep=old.sep, original=name + spaces)
    new._dotted = old.is_dotted()  # the first part of a dotted key
    return new
