"""Docstrings: descriptions of parameters, for schemas and the help of commands.

The command line imports this module at its start: it has no other imports of the package.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Callable
from typing import Any


def descriptions(kind: Callable[..., Any]) -> dict[str, str]:
    """Return the descriptions of parameters or attributes in a numpydoc docstring, by name."""
    text, found = inspect.cleandoc(kind.__doc__ or ""), dict[str, str]()
    section = re.search(r"^(?:Parameters|Attributes)\n-+\n(.*?)(\n\n\w+\n--|\Z)", text, re.S | re.M)
    for entry in re.split(r"\n(?=\w)", section[1]) if section else ():
        names, _, words = entry.partition(" : ")
        words = " ".join(words.partition("\n")[2].split())
        found |= dict.fromkeys(names.split(", "), words)
    return found
