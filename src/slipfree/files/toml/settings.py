"""Settings: values given on the command line that replace values of a TOML file."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

from slipfree.files.toml.errors import ProblemError
from slipfree.files.toml.source_lines import Place, key_path, load_toml, shortened
from slipfree.regular_files import escape_name

BARE = re.compile(r"""[^\s"'\[\]{}=,#]+""")  # a value that needs no quotes


def replace_values(
    data: dict[str, Any], settings: Sequence[str], option: str = "--set"
) -> dict[Place, str]:
    """Replace values in the tables of a file by settings; ``data`` is modified in place.

    Parameters
    ----------
    data : dict
        Contents of the file.
    settings : sequence of str
        Texts ``key=value`` with a dotted key and a value in TOML or a bare word; ``key=`` removes
        the key.
    option : str
        Name of the command-line option in error messages.

    Returns
    -------
    dict of tuple to str
        The setting that changed, added or removed a value or table, by the keys of the value.

    Raises
    ------
    ProblemError
        If a setting is not UTF-8 or not ``key=value``, if it sets a key inside a value that is not
        a table, or if it removes a key that does not exist.
    """
    places: dict[Place, str] = {}
    faults = []
    for setting in settings:
        key, equals, text = setting.partition("=")
        if (readable := escape_name(setting)) != setting:
            faults.append(
                f"{option} {escape_name(key.strip())}: expected text in UTF-8, as in a problem "
                f"file, found {readable}; rename the file if the value is a file name"
            )
            continue
        try:
            path = key_path(key)
            if not equals:
                raise ValueError
            new = _insert(data, path, _value(text)) if text.strip() else _remove(data, path)
        except _KeyPlaceError as error:
            faults.append(f"{option} {key.strip()}: {error}")
        except ValueError:
            faults.append(
                f"{option} {shortened(key.strip())}: expected key=value with a value in TOML or a "
                f"bare word, or key= to remove a key, found {shortened(setting)!r}"
            )
        else:
            places |= dict.fromkeys(new, setting)
    if faults:
        raise ProblemError(*faults)
    return places


class _KeyPlaceError(ValueError):
    """Error for a valid key that cannot be set or removed in the given tables."""


def _value(text: str) -> Any:
    """Return the value of a text, which is TOML or a bare word; raise ValueError otherwise."""
    try:
        found = load_toml(f"value = {text}")
    except ValueError:
        if BARE.fullmatch(text.strip()):
            return text.strip()
        raise
    if len(found) > 1:
        raise ValueError(text)
    return found["value"]


def _insert(data: dict[str, Any], path: tuple[str, ...], value: Any) -> list[Place]:
    """Insert a value into nested tables; return its path and the paths of new tables.

    Raise `_KeyPlaceError` if the path leads through a value that is not a table.
    """
    places: list[Place] = [path]
    *tables, last = path
    for depth, name in enumerate(tables, start=1):
        if name not in data:
            places.append(path[:depth])
        data = data.setdefault(name, {})
        if not isinstance(data, dict):
            raise _KeyPlaceError(
                f"expected a key of a table, found that {'.'.join(path[:depth])!r} is not a table; "
                "correct the key"
            )
    data[last] = value
    return places


def _remove(data: dict[str, Any], path: tuple[str, ...]) -> list[Place]:
    """Remove a key from nested tables; return its path in a list.

    Raise `_KeyPlaceError` if there is no such key.
    """
    for name in path[:-1]:
        data = data.get(name, {}) if isinstance(data, dict) else {}
    if not isinstance(data, dict) or path[-1] not in data:
        raise _KeyPlaceError("expected a key to remove, found no such key; correct the key")
    del data[path[-1]]
    return [path]
