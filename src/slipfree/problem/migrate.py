"""Problem and vehicle files of version 0.1, rewritten with today's keys in their own layout."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import tomlkit
from tomlkit.items import Key, KeyType, SingleKey, Table

from slipfree.files.toml.errors import Fault, ProblemError, problem_error
from slipfree.files.toml.reader import parse_toml
from slipfree.files.toml.source_lines import Source, key_lines
from slipfree.problem.old_keys import KeyChange, old_keys, upgrade_keys


class Migrated(NamedTuple):
    """A file with today's keys.

    Attributes
    ----------
    text : str
        The file.
    changes : tuple of str
        Line, old and new key of each change; empty if none is needed.
    """

    text: str
    changes: tuple[str, ...]


def migrate_text(path: Path, text: str) -> Migrated:
    """Return a problem or vehicle file with today's keys.

    Parameters
    ----------
    path : Path
        The name of the file, for errors.
    text : str
        The file.

    Raises
    ------
    ProblemError
        If it is not TOML, not a problem or vehicle, has an old key and its new one, or has old
        keys in a layout that cannot be kept.
    """
    data = parse_toml(path, text)
    if not {"verb", "wheels"} & set(data):
        raise ProblemError(
            f"{path}: expected a problem file, with the key 'verb', or a vehicle file, with "
            "'wheels', found neither key"
        )
    source = Source(path, text, key_lines(text))
    found = old_keys(data)
    if not found:
        return Migrated(text, ())
    both = [
        Fault((each.old,), f"{each.words[1]} or {'.'.join(each.new)}", "both; remove one of them")
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
            f"{path}: expected keys in a usual layout, found one that cannot be kept; replace "
            f"{wanted} by hand"
        )
    words = (f"{source.where((c.old,))}: {c.words[1]} is now {c.words[0]}" for c in found)
    return Migrated(changed, tuple(words))


def _rename(document: tomlkit.TOMLDocument, change: KeyChange) -> None:
    """Replace a key, and its value if that changes too, where it stands."""
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
    """Return a key, perhaps a dotted one, with the spaces and the equals sign of another."""
    text = old.as_string()
    spaces = text[len(text.rstrip()) :]
    new = SingleKey(name, t=KeyType.Bare, sep=old.sep, original=name + spaces)
    new._dotted = old.is_dotted()  # the first part of a dotted key
    return new
