"""Reader of TOML files with line numbers in its error messages."""

from __future__ import annotations

import re
import sys
import tomllib
from pathlib import Path
from typing import Any

from slipfree.errors import DataError
from slipfree.files.toml.errors import ProblemError
from slipfree.regular_files import read_bytes, regular_file

MAX_BYTES = 10_000_000  # size of the largest accepted TOML file
# keys with at least 64 parts: tomllib takes hours for thousands of them
LONG_KEY = re.compile(
    r"""(?m)(?:^|[\[{,])[ \t]*+(?:(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')[ \t]*+\.[ \t]*+){64}"""
)


def parse_toml(path: Path, text: str) -> dict[str, Any]:
    """Return the values of a TOML text; raise ProblemError for invalid or deeply nested text."""
    if (found := LONG_KEY.search(text)) is not None:
        line = text.count("\n", 0, found.start()) + 1
        raise ProblemError(
            f"{path}:{line}: expected keys with at most 60 dotted parts, found more; use fewer "
            "nested tables"
        )
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ProblemError(_syntax(path, text, str(error))) from error
    except RecursionError as error:
        raise ProblemError(
            f"{path}: expected arrays and tables with a few nested levels, found hundreds; reduce "
            "the nesting"
        ) from error
    except ValueError as error:  # Python limits the length of integers
        raise ProblemError(
            f"{path}: expected integers of at most {sys.get_int_max_str_digits()} digits, found a "
            "longer one; shorten it"
        ) from error


def read_text(path: Path, expected: str = "a problem file") -> str:
    """Return the text of a TOML file.

    Parameters
    ----------
    path : Path
        The file.
    expected : str
        Description of the file in messages.

    Raises
    ------
    ProblemError
        If the file cannot be read, is not UTF-8, or is larger than 10 MB.
    """
    return decode_text(path, read_raw(path, expected))


def read_raw(path: Path, expected: str = "a problem file") -> bytes:
    """Return the bytes of a TOML file; parameters and errors are those of `read_text`."""
    try:
        with regular_file(path, expected) as size:
            if size > MAX_BYTES:
                raise DataError(
                    f"{path}: expected a TOML file of at most {MAX_BYTES / 1e6:g} MB, found "
                    f"{size / 1e6:.3g} MB; check the name"
                )
            return read_bytes(path, expected)
    except DataError as error:
        raise ProblemError(str(error)) from error


def decode_text(path: Path, raw: bytes) -> str:
    """Return the text of a TOML file without its byte order mark; errors as in `read_text`."""
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        raise ProblemError(
            f"{path}:{line}: expected text in UTF-8, found the byte {raw[error.start]:#04x}; save "
            "the file as UTF-8"
        ) from error


def _syntax(path: Path, text: str, message: str) -> str:
    """Return the message of a syntax error, with file, line and column, from that of tomllib."""
    found = re.fullmatch(r"(.*) \(at line (\d+), column (\d+)\)", message, re.DOTALL)
    if found is None:
        last = len(text.splitlines()) or 1
        return f"{path}:{last}: expected TOML, found an error at the end: {message}"
    return f"{path}:{found[2]}: expected TOML, found an error in column {found[3]}: {found[1]}"
