"""Files that are replaced whole or not at all."""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

from slipfree.errors import DataError

if TYPE_CHECKING:
    pass


def replace_file(path: Path, fill: Callable[[Path], object]) -> None:
    """Let ``fill`` write a file beside ``path``, then put it in its place.

    Whatever ends this, an error, Ctrl-C, a signal or the machine, ``path`` is what it was before,
    or whole.

    Raises
    ------
    DataError
        If it cannot be written, or is no file but a device.
    """
    target = Path(os.path.realpath(path))  # a link goes on to be one
    part = target.with_name(f".{secrets.token_hex(6)}.part{target.suffix}")
    try:
        if target.exists() and not target.is_file():
            raise DataError(f"{path}: expected the name of a file to write, found another thing")
        fill(part)
        with part.open("rb+") as file:
            os.fsync(file.fileno())
        part.replace(target)
    except OSError as error:
        raise DataError(
            f"{path}: cannot be written ({error.strerror or error}); choose another place"
        ) from error
    finally:
        with suppress(OSError):  # of a place where nothing can be written
            part.unlink(missing_ok=True)
