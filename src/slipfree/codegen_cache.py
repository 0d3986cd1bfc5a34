"""Compilation of functions with the system's C compiler, and a cache of the libraries.

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

FOLDER = "SLIPFREE_CACHE"  # environment variable: path of the cache folder; empty for no cache
# The functions are long lists of sums and products: more optimisation does not make them faster,
# and without optimisation they take three times as long, like the interpreter.
FLAGS = ("-O1", "-shared", "-fPIC", "-ffp-contract=off")
NO_COMPILER = "no C compiler was found: cc, gcc, clang, or the command in CC"
COMPILER_TIMEOUT = 300.0  # [s]
MIN_OPERATIONS = 300  # smaller functions are not compiled
MAX_LIBRARIES = 64  # libraries in the cache, of about a megabyte each
SCRATCH_PREFIX = "making-"  # prefix of the compiler's working folders
DIGEST_LENGTH = 32  # characters of a digest


def library(
    text: str, names: Sequence[str], make: Callable[[], Sequence[ca.Function]]
) -> tuple[ca.Function, ...] | None:
    """Return compiled functions, from the cache if they are there.

    Parameters
    ----------
    text : str
        Text that determines the functions.
    names : sequence of str
        Names of the functions.
    make : callable
        Returns the functions, SX functions without calls; called only for a compilation.

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
        raise _UnavailableError(f"the library compiled by {shlex.join(command)} cannot be loaded")
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
        SX function whose operations identify the derived functions in the cache.
    names : sequence of str
        Names of the derived functions.
    make : callable
        Returns the derived functions.
    compiled : bool
        Whether to compile them if a compiler is found.
    """
    if not compiled or key.n_instructions() < MIN_OPERATIONS:
        return tuple(make())
    code = Path(inspect.getfile(make)).read_text(encoding="utf-8")
    return library("\n".join([code, source([key])]), names, make) or tuple(make())


def obstacle() -> str | None:
    """Return the reason why functions cannot be compiled here; None if they can."""
    try:
        if folder() is None:
            return f"{FOLDER} is empty"
    except _UnavailableError as error:
        return str(error)
    return NO_COMPILER if compiler() is None else None


class _UnavailableError(Exception):
    """No compiler or no usable cache folder is available."""


def source(functions: Sequence[ca.Function]) -> str:
    """Return the C source code of functions."""
    generator = ca.CodeGenerator("slipfree")
    for each in functions:
        generator.add(each)
    return str(generator.dump())


def _key(text: str) -> str:
    parts = (ca.CasadiMeta.version(), platform.system(), platform.machine(), *FLAGS, text)
    return digest("\n".join(parts).encode())


def folder() -> Path | None:
    """Return the folder of the cache; None if the cache is disabled."""
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
    """Create the cache folder if missing; raise an error if others may write to it."""
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
    except ValueError:  # an unbalanced quote
        named = []
    for command in (named, ["cc"], ["gcc"], ["clang"]):
        if command and shutil.which(command[0]):
            return command
    return None


def _load_cached(place: Path, key: str, names: Sequence[str]) -> tuple[ca.Function, ...] | None:
    """Return the cached functions of a key, or None; remove damaged libraries of that key."""
    for file in sorted(place.glob(f"{key}.*.so")):
        try:
            same = file.suffixes[-2] == f".{digest(file.read_bytes())}"
            if same and _is_private(file.lstat()) and not file.is_symlink():
                found = tuple(ca.external(name, str(file)) for name in names)
                with suppress(OSError):  # the folder may be read-only
                    os.utime(file)  # the least recently used library is removed first
                return found
        except (OSError, RuntimeError):  # it vanished, or cannot be loaded here
            pass
        with suppress(OSError):  # the folder may be read-only
            file.unlink(missing_ok=True)
    return None


def digest(content: bytes) -> str:
    """Return the digest of a content, as used in file names of the cache."""
    return hashlib.sha256(content).hexdigest()[:DIGEST_LENGTH]


def _compile(
    place: Path, key: str, functions: Sequence[ca.Function], command: Sequence[str]
) -> None:
    """Compile functions and store the library in the cache, named by its key and digest."""
    try:
        with tempfile.TemporaryDirectory(dir=place, prefix=SCRATCH_PREFIX) as scratch:
            text, file = Path(scratch) / "functions.c", Path(scratch) / "functions.so"
            text.write_text(source(functions), encoding="utf-8")
            _run([*command, *FLAGS, "-o", str(file), str(text), "-lm"])
            if not file.exists():
                raise _UnavailableError(
                    f"{shlex.join(command)}: expected a C compiler, found a command that wrote no "
                    "library; set CC to another one"
                )
            file.chmod(0o700)
            file.replace(place / f"{key}.{digest(file.read_bytes())}.so")
    except OSError as error:
        raise _UnavailableError(f"{place}: {error.strerror}") from error
    except subprocess.SubprocessError as error:
        raise _UnavailableError(f"{shlex.join(command)} failed") from error
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
                        os.killpg(process.pid, signal.SIGKILL)  # with its child processes
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
        with suppress(OSError):  # another process may remove it at the same time
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
