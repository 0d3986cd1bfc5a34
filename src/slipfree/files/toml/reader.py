"""Reader of TOML files with line numbers in its error messages."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from slipfree.errors import DataError
from slipfree.files.toml.errors import ProblemError
from slipfree.files.toml.source_lines import load_toml
from slipfree.regular_files import read_bytes, regular_file

MAX_BYTES = 10_000_000  # size of the largest accepted TOML file


def parse_toml(path: Path, text: str) -> dict[str, Any]:
    """Return the values of a TOML text; raise ProblemError for invalid or deeply nested text."""
    try:
        return load_toml(text)
    except ValueError as error:
        raise ProblemError(_syntax(path, text, str(error))) from error


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
    """Return the message of an error of `load_toml`, with file, line and column if it has them."""
    found = re.fullmatch(r"(.*) \(at line (\d+), column (\d+)\)", message, re.DOTALL)
    if found is not None:
        return f"{path}:{found[2]}: expected TOML, found an error in column {found[3]}: {found[1]}"
    if message.endswith("(at end of document)"):
        last = len(text.splitlines()) or 1
        return f"{path}:{last}: expected TOML, found an error at the end: {message}"
    return f"{path}: expected TOML as of a problem file, found {message}; simplify it"
