"""Files given by the user: checks of their names and kinds, and atomic replacement."""

from __future__ import annotations

import errno
import os
import re
import secrets
import stat
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from hashlib import file_digest
from io import BytesIO
from pathlib import Path

from slipfree.core.errors import DataError, WriteError

KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFCHR: "a device or a terminal",
    stat.S_IFBLK: "a device",
    stat.S_IFSOCK: "a socket",
}
TEMPORARY = f".{'[0-9a-f]' * 12}.part*"  # pattern of the names that `replacing` writes
# None: numpy wrote less than it should, and does not say why
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, None)
WRONG_NAME = (errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG, errno.ELOOP)


@contextmanager
def regular_file(path: Path, expected: str) -> Iterator[int]:
    """Check that a file is a regular file, and raise system errors of the context as DataError.

    Pipes, devices and process substitutions are refused, since reading them may never end. The
    context is the size in bytes; ``expected`` describes the contents in messages, as in ``"a
    problem file"``. DataError is raised if the file does not exist, is not a regular file, or
    cannot be read.
    """
    try:
        status = path.stat()
    except (OSError, ValueError) as error:  # ValueError: a null character
        reason = error.strerror if isinstance(error, OSError) else error
        raise _unreadable(path, expected, reason) from error
    if not stat.S_ISREG(status.st_mode):
        kind = KINDS.get(stat.S_IFMT(status.st_mode), "something else")
        remedy = "check the name"
        if not stat.S_ISDIR(status.st_mode):
            remedy = "write the contents to a file first (/dev/stdin and <(...) are not accepted)"
        raise DataError(f"{path}: expected {expected}, found {kind}, not a regular file; {remedy}")
    try:
        yield status.st_size
    except OSError as error:
        raise _unreadable(path, expected, error.strerror or error) from error


def read_bytes(path: Path, expected: str) -> bytes:
    """Return the contents of a regular file; parameters and errors are those of `regular_file`."""
    with regular_file(path, expected) as size, path.open("rb") as stream:
        return stream.read(size)  # not read(): some files of /proc are endless, with a size of 0


def digest(file: Path) -> str:
    """Return the SHA-256 of a file; ``"missing"`` if it cannot be read."""
    try:
        # the file may exceed the memory; some files of /proc are endless, with a size of 0
        with regular_file(file, "a file") as size, file.open("rb") as stream:
            return file_digest(stream if size else BytesIO(), "sha256").hexdigest()
    except DataError:
        return "missing"


def check_name(path: Path) -> None:
    """Raise DataError if a path cannot be a file name, for example because it is too long."""
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return
    except (OSError, ValueError) as error:  # ValueError: a null character
        reason = error.strerror if isinstance(error, OSError) else error
        raise DataError(
            f"{path}: expected the name of a file or folder to write, found one that cannot be "
            f"used ({reason}); choose another name"
        ) from error


def check_ending(path: Path, endings: Collection[str], more: str = "") -> None:
    """Raise DataError unless the name of a file to write has one of the endings.

    The message proposes the name with the first ending, followed by a text.
    """
    if path.suffix.lower() not in endings:
        proposed = f"{path.parent / path.stem}{next(iter(endings))}{more}"
        raise DataError(
            f"{path}: expected a name that ends in {' or '.join(endings)}, found "
            f"{repr(path.suffix) if path.suffix else 'no ending'}; use {proposed}"
        )


def resolve_links(path: Path) -> Path:
    """Return a path with symbolic links resolved; an invalid name is returned unchanged."""
    try:
        return Path(os.path.realpath(path))
    except ValueError:  # a null character; reading or writing the file reports it
        return path


def escape_name(name: str) -> str:
    r"""Return a file name as valid UTF-8: a byte that is not UTF-8, 0xff, becomes ``\udcff``."""
    return name.encode(errors="backslashreplace").decode()


def unescape_name(text: str) -> str:
    """Return the file name from a text that `escape_name` returned."""
    return re.sub(r"\\udc([89a-f][0-9a-f])", lambda found: chr(int(f"dc{found[1]}", 16)), text)


def _unreadable(path: Path, expected: str, reason: object) -> DataError:
    """Return the error of a file that cannot be read, with the remedy for its reason."""
    if isinstance(reason, ValueError) or reason in [os.strerror(code) for code in WRONG_NAME]:
        is_url = str(path).startswith(("http:", "https:"))
        remedy = "download it, and name the file" if is_url else "check the name"
        if odd := re.search(r"(?:^|/)~|\$|\\", str(path)):
            remedy += f": {odd[0][-1]!r} is not replaced, write the folders in full with '/'"
    elif reason == os.strerror(errno.EACCES):
        remedy = "check the permissions of the file and its folders"
    else:
        remedy = "check the file and its disk"
    return DataError(
        f"{path}: expected {expected}, found that it cannot be read ({reason}); {remedy}"
    )


def check_target(path: Path) -> None:
    """Raise DataError if a file to write is a folder, device, pipe or socket."""
    if path.exists() and not path.is_file():
        kind = "a folder" if path.is_dir() else "a device, pipe or socket"
        raise DataError(
            f"{path}: expected the name of a file to write, found {kind}; choose another name"
        )


def make_folder(folder: Path, remedy: str = "choose another folder") -> None:
    """Make a folder to write, and those above it; raise DataError if it cannot be made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(
            f"{folder}: expected a folder to write, found one that cannot be created "
            f"({error.strerror}); {remedy}"
        ) from error


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Replace a file by a new one only when the new one is complete.

    The context is the path of a temporary file in the same folder, which the block writes. After an
    error, Ctrl-C, a signal or a crash of the machine, ``path`` is either unchanged or complete. A
    symbolic link remains; its target is replaced. WriteError is raised if the file cannot be
    written, DataError if ``path`` is a folder, device, pipe or socket.
    """
    target = Path(os.path.realpath(path))  # a symbolic link stays a link
    part = target.with_name(f".{secrets.token_hex(6)}.part{target.suffix}")
    try:
        check_target(path)
        yield part
        with part.open("rb+") as file:
            os.fsync(file.fileno())
        part.replace(target)
    except WriteError as error:  # the block replaces ``part`` in the same way
        raise WriteError(str(error).replace(str(part), str(path))) from error
    except OSError as error:
        remedy = "choose another name or folder"
        if error.errno in DISK_FULL:
            remedy = "free disk space or choose another folder"
        raise WriteError(
            f"{path}: cannot be written ({error.strerror or error}); {remedy}"
        ) from error
    finally:
        with suppress(OSError):  # the folder may be read-only
            part.unlink(missing_ok=True)


def replace_file(path: Path, fill: Callable[[Path], object]) -> None:
    """Replace a file by the one that ``fill`` writes to the path that it is given.

    See `replacing`.
    """
    with replacing(path) as part:
        fill(part)
