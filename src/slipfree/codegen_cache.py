"""Compile functions with the system's C compiler, and cache the libraries.

Libraries are stored in a folder of the user, named by a digest of their source. Code is loaded from
there, so only this user may have write access. Without a compiler or such a folder nothing is
compiled: callers interpret the functions, and a warning gives the reason.
"""

from __future__ import annotations

import hashlib
import inspect
import os
import platform
import shlex
import shutil
import signal
import stat
import subprocess
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import casadi as ca
import platformdirs

from slipfree.interrupt import ended_by_interrupt

FOLDER = "SLIPFREE_CACHE"  # variable of the environment: another folder; empty for none
# The functions are long lists of sums and products: with more optimisation they take as long, and
# without any they take three times as long, as the interpreter does.
FLAGS = ("-O1", "-shared", "-fPIC", "-ffp-contract=off")
NO_COMPILER = "no C compiler was found: cc, gcc, clang, or the command in CC"
COMPILER_TIMEOUT = 300.0  # with the compiler [s]
MIN_OPERATIONS = 300  # of a function that is worth compiling
MAX_LIBRARIES = 64  # libraries; about a megabyte each
SCRATCH_PREFIX = "making-"  # of names of folders in which a compiler works
DIGEST = 32  # digits in a name


def library(
    text: str, names: Sequence[str], make: Callable[[], Sequence[ca.Function]]
) -> tuple[ca.Function, ...] | None:
    """Return compiled functions, from the cache if they are there.

    Parameters
    ----------
    text : str
        Text that determines the functions.
    names : sequence of str
        Their names.
    make : callable
        Returns the functions, of SX and without calls of others; only if they must be compiled.

    Returns
    -------
    tuple of casadi Function, or None
        None if they are not cached and cannot be compiled; a warning gives the reason.
    """
    key = _key(text)
    try:
        if (place := folder()) is None:
            raise _UnavailableError(f"{FOLDER} is empty")
        _prepare(place)
        if found := _load_cached(place, key, names):
            return found
        if (command := compiler()) is None:
            raise _UnavailableError(NO_COMPILER)
        _compile(place, key, make(), command)
        if found := _load_cached(place, key, names):
            return found
        raise _UnavailableError(f"what {shlex.join(command)} made cannot be loaded")
    except _UnavailableError as error:
        warnings.warn(f"equations are interpreted, not compiled: {error}", stacklevel=1)
    return None


def compiled_functions(
    key: ca.Function,
    names: Sequence[str],
    make: Callable[[], Sequence[ca.Function]],
    *,
    compiled: bool,
) -> tuple[ca.Function, ...]:
    """Return functions derived from another one, compiled on request if they are large.

    Parameters
    ----------
    key : casadi Function
        Of SX; functions made of the same operations are the same.
    names : sequence of str
        Of the functions.
    make : callable
        Returns them.
    compiled : bool
        Whether to compile them where a compiler is found.
    """
    if not compiled or key.n_instructions() < MIN_OPERATIONS:
        return tuple(make())
    code = Path(inspect.getfile(make)).read_text(encoding="utf-8")
    return library("\n".join([code, source([key])]), names, make) or tuple(make())


def obstacle() -> str | None:
    """Return the reason why nothing can be compiled here, or None."""
    try:
        if folder() is None:
            return f"{FOLDER} is empty"
    except _UnavailableError as error:
        return str(error)
    return NO_COMPILER if compiler() is None else None


class _UnavailableError(Exception):
    """No compiler or no usable cache folder is available."""


def source(functions: Sequence[ca.Function]) -> str:
    """Return functions in C."""
    generator = ca.CodeGenerator("slipfree")
    for each in functions:
        generator.add(each)
    return str(generator.dump())


def _key(text: str) -> str:
    parts = (ca.CasadiMeta.version(), platform.system(), platform.machine(), *FLAGS, text)
    return digest("\n".join(parts).encode())


def folder() -> Path | None:
    """Return the folder of the cache, None if there is to be none."""
    given = os.environ.get(FOLDER)
    if given is None:
        return platformdirs.user_cache_path("slipfree") / "compiled"
    try:
        return Path(given).expanduser() if given else None
    except RuntimeError as error:  # of ~NAME
        raise _UnavailableError(
            f"{FOLDER}: expected a folder, found {given!r} of a user who has no home folder"
        ) from error


def _prepare(place: Path) -> None:
    """Make the folder if it is not there, and refuse one that others may have written to."""
    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _is_private(place.stat()):
            raise _UnavailableError(
                f"{place}: expected a folder of this user that others cannot write to"
            )
    except OSError as error:
        raise _UnavailableError(f"{place}: {error.strerror}") from error


def _is_private(about: os.stat_result) -> bool:
    """Return whether a file or folder belongs to this user and only this user may write to it."""
    if os.name != "posix":
        return True
    return about.st_uid == os.geteuid() and not about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def compiler() -> list[str] | None:
    """Return the command of the C compiler, or None."""
    try:
        named = shlex.split(os.environ.get("CC", ""))
    except ValueError:  # an open quote
        named = []
    for command in (named, ["cc"], ["gcc"], ["clang"]):
        if command and shutil.which(command[0]):
            return command
    return None


def _load_cached(place: Path, key: str, names: Sequence[str]) -> tuple[ca.Function, ...] | None:
    """Return functions of the cache, and remove damaged libraries."""
    for file in sorted(place.glob(f"{key}.*.so")):
        try:
            same = file.suffixes[-2] == f".{digest(file.read_bytes())}"
            if same and _is_private(file.lstat()) and not file.is_symlink():
                found = tuple(ca.external(name, str(file)) for name in names)
                with suppress(OSError):  # of a place where nothing can be written
                    os.utime(file)  # the last one used is the last one removed
                return found
        except (OSError, RuntimeError):  # it vanished, or cannot be loaded here
            pass
        with suppress(OSError):  # of a place where nothing can be written
            file.unlink(missing_ok=True)
    return None


def digest(content: bytes) -> str:
    """Return the digits that stand for a content in names of the cache."""
    return hashlib.sha256(content).hexdigest()[:DIGEST]


def _compile(
    place: Path, key: str, functions: Sequence[ca.Function], command: Sequence[str]
) -> None:
    """Put a library into the cache under its key and a digest of itself."""
    try:
        with tempfile.TemporaryDirectory(dir=place, prefix=SCRATCH_PREFIX) as scratch:
            text, file = Path(scratch) / "functions.c", Path(scratch) / "functions.so"
            text.write_text(source(functions), encoding="utf-8")
            _run([*command, *FLAGS, "-o", str(file), str(text), "-lm"])
            if not file.exists():
                raise _UnavailableError(
                    f"{shlex.join(command)}: expected a C compiler, found that it made no library; "
                    "name another one in CC"
                )
            file.chmod(0o700)
            file.replace(place / f"{key}.{digest(file.read_bytes())}.so")
    except OSError as error:
        raise _UnavailableError(f"{place}: {error.strerror}") from error
    except subprocess.SubprocessError as error:
        raise _UnavailableError(f"{shlex.join(command)} did not do its work") from error
    _remove_old(place)


def _run(command: Sequence[str]) -> None:
    """Run a compiler in its own session, and end it if this process is interrupted."""
    none = subprocess.DEVNULL
    with subprocess.Popen(
        command, stdin=none, stdout=none, stderr=none, start_new_session=True
    ) as process:

        def end() -> None:
            if process.returncode is None:
                with suppress(OSError):  # it has just ended
                    if os.name == "posix":
                        os.killpg(process.pid, signal.SIGKILL)  # with what it started
                    else:
                        process.kill()

        try:
            with ended_by_interrupt(end):
                code = process.wait(COMPILER_TIMEOUT)
        except BaseException:
            end()
            process.wait()
            raise
    if code:
        raise subprocess.CalledProcessError(code, command)


def _remove_old(place: Path) -> None:
    """Remove the least recently used libraries and the leftovers of interrupted compilations."""
    ages = dict[Path, float]()
    for file in place.iterdir():
        with suppress(OSError):  # another process may tidy as well
            ages[file] = file.stat().st_mtime
    libraries = sorted(
        (file for file in ages if file.suffix == ".so"), key=lambda file: -ages[file]
    )
    for file in libraries[MAX_LIBRARIES:]:
        with suppress(OSError):
            file.unlink()
    for file in ages:
        if file.name.startswith(SCRATCH_PREFIX) and ages[file] < time.time() - 2 * COMPILER_TIMEOUT:
            shutil.rmtree(file, ignore_errors=True)
