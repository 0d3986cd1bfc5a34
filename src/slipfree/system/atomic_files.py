"""Atomic replacement of files."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from slipfree.core.errors import DataError, WriteError


def replace_file(path: Path, fill: Callable[[Path], object]) -> None:
    """Replace a file by a new one only when the new one is complete.

    After an error, Ctrl-C, a signal or a crash of the machine, ``path`` is either unchanged or
    complete.

    Parameters
    ----------
    path : Path
        File to write. A symbolic link remains; its target is replaced.
    fill : callable
        ``fill(part)`` writes the contents to ``part``, a temporary file in the same folder.

    Raises
    ------
    WriteError
        If the file cannot be written.
    DataError
        If ``path`` is a folder, device, pipe or socket.
    """
    target = Path(os.path.realpath(path))  # a symbolic link stays a link
    part = target.with_name(f".{secrets.token_hex(6)}.part{target.suffix}")
    try:
        if target.exists() and not target.is_file():
            kind = "a folder" if target.is_dir() else "a device, pipe or socket"
            raise DataError(
                f"{path}: expected the name of a file to write, found {kind}; choose another name"
            )
        fill(part)
        with part.open("rb+") as file:
            os.fsync(file.fileno())
        part.replace(target)
    except OSError as error:
        raise WriteError(
            f"{path}: cannot be written ({error.strerror or error}); choose another name or folder"
        ) from error
    finally:
        with suppress(OSError):  # the folder may be read-only
            part.unlink(missing_ok=True)
