"""Checks of the files that a user names, shared by all readers."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from slipfree.errors import DataError

KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device or a terminal",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}


@contextmanager
def regular_file(path: Path, expected: str) -> Iterator[int]:
    """Yield the size of a regular file, and raise system errors of reading it as DataError.

    Parameters
    ----------
    path : Path
        The file, or a symbolic link to it.
    expected : str
        Contents that the caller expects, for messages, as in ``"a problem file"``.

    Yields
    ------
    int
        Size. [bytes]

    Raises
    ------
    DataError
        If the path cannot be used as a name, names no regular file (a pipe, a device and a process
        substitution may never end), or the file cannot be read.
    """
    size = _checked_size(path, expected)
    try:
        yield size
    except OSError as error:
        raise _unreadable(path, expected, error.strerror or error) from error


def read_bytes(path: Path, expected: str) -> bytes:
    """Return the contents of a regular file; parameters and errors are those of `regular_file`."""
    with regular_file(path, expected) as size, path.open("rb") as stream:
        return stream.read(size)  # files of /proc state a size of 0, and some never end


def check_name(path: Path) -> None:
    """Raise DataError for a path that cannot be the name of a file to write."""
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return
    except (OSError, ValueError) as error:  # ValueError: a null character
        reason = error.strerror if isinstance(error, OSError) else error
        raise DataError(
            f"{path}: expected the name of a file to write, found one that cannot be used "
            f"({reason}); choose another name"
        ) from error


def resolve_links(path: Path) -> Path:
    """Return a path with symbolic links resolved; an invalid name is returned unchanged."""
    try:
        return Path(os.path.realpath(path))
    except ValueError:  # a null character: reading or writing it reports that
        return path


def escape_name(name: str) -> str:
    r"""Return a file name as text in UTF-8: ``\udcff`` stands for the byte 0xff."""
    return name.encode(errors="backslashreplace").decode()


def unescape_name(text: str) -> str:
    """Return the file name of a text from `escape_name`."""
    return re.sub(r"\\udc([89a-f][0-9a-f])", lambda found: chr(int(f"dc{found[1]}", 16)), text)


def _checked_size(path: Path, expected: str) -> int:
    try:
        status = path.stat()
    except (OSError, ValueError) as error:  # ValueError: a null character
        reason = error.strerror if isinstance(error, OSError) else error
        raise _unreadable(path, expected, reason) from error
    if stat.S_ISREG(status.st_mode):
        return status.st_size
    kind = KINDS.get(stat.S_IFMT(status.st_mode), "something else")
    remedy = "check the name"
    if not stat.S_ISDIR(status.st_mode):
        remedy = "write the contents to a file first (/dev/stdin and <(...) are refused too)"
    raise DataError(f"{path}: expected {expected}, found {kind}, not a regular file; {remedy}")


def _unreadable(path: Path, expected: str, reason: object) -> DataError:
    return DataError(
        f"{path}: expected {expected}, found that it cannot be read ({reason}); check the name"
    )
