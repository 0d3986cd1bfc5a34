"""Exceptions raised by the package, texts of messages and docstrings, and tables beside modules.

The command line imports this module at its start: it has no other imports of the package.
"""

from __future__ import annotations

import inspect
import re
import tomllib
from collections.abc import Callable, Collection, Iterable, Sequence
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

MAX_LISTED = 60  # largest number of names in a message


class SlipfreeError(Exception):
    """Base class of all errors of the package."""


class ModelError(SlipfreeError, ValueError):
    """Invalid or ill-posed input, such as wrong shapes, or a start outside the ground."""


class DataError(SlipfreeError, ValueError):
    """File that cannot be read or written, or whose contents cannot be used."""


class WriteError(DataError):
    """File that cannot be written, for example because its disk is full."""


def similar(name: str, known: Iterable[str]) -> str:
    """Return a question with the most similar known name; empty without a similar one."""
    nearest = get_close_matches(name, [*known], n=1)
    return f"did you mean {nearest[0]!r}? " if nearest else ""


def check_known(
    argument: str, names: Iterable[str], known: Collection[str], kind: str = "one of"
) -> None:
    """Raise ModelError for a name that is not known, with the most similar one.

    ``argument`` has the names; ``kind`` precedes the known names in the message.
    """
    for name in names:
        if name not in known:
            raise ModelError(
                f"{argument}: expected {kind} {listed([*known]) or '(none)'}, found {name!r}; "
                f"{similar(name, known)}correct the name"
            )


def shortened(text: str, most: int = 200) -> str:
    """Return a text, or the first characters of a longer one and dots, for a message."""
    return text if len(text) <= most else f"{text[:most]}..."


def listed(known: Sequence[str]) -> str:
    """Return names separated by commas: at most 60, then the number of further names."""
    more = len(known) - MAX_LISTED
    return ", ".join(known[:MAX_LISTED]) + (f" and {more} more" if more > 0 else "")


def missing_package(package: str, extra: str) -> str:
    """Return an error message for a missing optional package, with the command to install it."""
    from importlib.metadata import distributions

    known = [each for found in distributions(name="slipfree") for each in found.requires or ()]
    of_extra = {each.partition(";")[0].strip() for each in known if f'"{extra}"' in each}
    return (
        f"expected the package {package!r}, found that it is not installed; install it: "
        f"python -m pip install {' '.join(map(repr, sorted(of_extra))) or package}"
    )


def require(package: str, extra: str = "xarray", place: str = "") -> Any:
    """Return an optional package; raise DataError if it is not installed.

    Functions ask for it before they compute. ``place`` begins the message.
    """
    try:
        return import_module(package)
    except ImportError as error:
        raise DataError(place + missing_package(package, extra)) from error


@cache
def read_table(module: str, name: str) -> dict[str, Any]:
    """Return the data in a TOML file beside a module, given as its ``__file__``."""
    return tomllib.loads(Path(module).with_name(name).read_text("utf-8"))


def descriptions(kind: Callable[..., Any]) -> dict[str, str]:
    """Return the descriptions of parameters or attributes in a numpydoc docstring, by name."""
    text, found = inspect.cleandoc(kind.__doc__ or ""), dict[str, str]()
    section = re.search(r"^(?:Parameters|Attributes)\n-+\n(.*?)(\n\n\w+\n--|\Z)", text, re.S | re.M)
    for entry in re.split(r"\n(?=\w)", section[1]) if section else ():
        names, _, words = entry.partition(" : ")
        words = " ".join(words.partition("\n")[2].split())
        found |= dict.fromkeys(names.split(", "), words)
    return found
