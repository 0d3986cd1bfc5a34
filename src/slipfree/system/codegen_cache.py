"""Compilation of functions with the system's C compiler, and a cache of the libraries.

Libraries are stored in a folder of the user; the file name consists of the cache key and a digest
of the library. Code is loaded from this folder, so only this user may have write access. Without a
compiler or such a folder CasADi interprets the functions, and a warning gives the reason.
"""

from __future__ import annotations

import hashlib
import inspect
import math
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
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import TypeVar

import casadi as ca
import platformdirs

from slipfree.system.interrupt import ended_by_interrupt

FOLDER = "SLIPFREE_CACHE"  # environment variable: path of the cache folder; empty for no cache
# Without optimisation the functions take three times as long, like the interpreter.
FLAGS = ("-O1", "-shared", "-fPIC", "-ffp-contract=off")
NO_COMPILER = (
    "no C compiler was found (searched: the command in CC, cc, gcc, clang); install one, or set CC"
)
CACHE_DISABLED = f"{FOLDER} is empty; unset it, or set it to a folder"
COMPILER_TIMEOUT = 300.0  # [s]
_LIMIT = ContextVar("limit", default=math.inf)  # of callers [s]
MIN_OPERATIONS = 300  # smaller functions are not compiled
T = TypeVar("T")
MAX_LIBRARIES = 64  # libraries in the cache, of about a megabyte each
SCRATCH_PREFIX = "making-"  # prefix of the compiler's working folders
DIGEST_LENGTH = 32  # number of characters of a digest


@contextmanager
def compiler_limit(seconds: float) -> Iterator[None]:
    """End compilations after a time, if it is shorter than `COMPILER_TIMEOUT` [s]."""
    before = _LIMIT.set(seconds)
    try:
        yield
    finally:
        _LIMIT.reset(before)


def load_or_compile(
    text: str, names: Sequence[str], make: Callable[[], Sequence[ca.Function]]
) -> tuple[ca.Function, ...] | None:
    """Return compiled functions, from the cache if it contains them.

    Equal texts must mean equal functions. ``make()`` is called only for a compilation, and returns
    SX functions without calls of other functions. The result is None, with a warning that gives the
    reason, if they can be neither loaded nor compiled.
    """
    return shared_library(
        text, lambda: source(make()), lambda file: tuple(ca.external(name, file) for name in names)
    )


def shared_library(
    text: str, make: Callable[[], str], load: Callable[[str], T], flags: Sequence[str] = FLAGS
) -> T | None:
    """Return the result of ``load`` for a compiled library, from the cache if possible.

    Equal texts and flags must mean equal libraries. ``make()`` returns the C source; it is called
    only for a compilation. ``load(path)`` opens the library, and raises OSError or RuntimeError if
    it is damaged. The result is None, with a warning that gives the reason, if the library can be
    neither loaded nor compiled.
    """
    parts = (ca.CasadiMeta.version(), platform.system(), platform.machine(), *flags, text)
    key = digest("\n".join(parts).encode())
    try:
        if (cache := folder()) is None:
            raise _UnavailableError(CACHE_DISABLED)
        _prepare(cache)
        if (loaded := _load_cached(cache, key, load)) is not None:
            return loaded
        if (command := compiler()) is None:
            raise _UnavailableError(NO_COMPILER)
        _compile(cache, key, make(), command, flags)
        if (loaded := _load_cached(cache, key, load)) is not None:
            return loaded
        raise _UnavailableError(
            f"the library compiled by {shlex.join(command)} cannot be loaded; set CC to another "
            "C compiler"
        )
    except _UnavailableError as error:
        warnings.warn(f"slower: equations are interpreted, not compiled: {error}", stacklevel=1)
    return None


def compiled_functions(
    key: ca.Function,
    names: Sequence[str],
    make: Callable[[], Sequence[ca.Function]],
    *,
    compiled: bool,
) -> tuple[ca.Function, ...]:
    """Return functions derived from an SX function, compiled if it has at least 300 operations.

    ``key`` is the SX function from which ``make()`` derives the functions: in the cache they are
    identified by its operations and the source file of ``make``. Without a compiler or a cache, or
    if not ``compiled``, they are interpreted; the former with a warning.
    """
    if not compiled or key.n_instructions() < MIN_OPERATIONS:
        return tuple(make())
    code = Path(inspect.getfile(make)).read_text(encoding="utf-8")
    return load_or_compile("\n".join([code, source([key])]), names, make) or tuple(make())


def obstacle() -> str | None:
    """Return the reason why functions cannot be compiled; None if they can be."""
    try:
        if folder() is None:
            return CACHE_DISABLED
    except _UnavailableError as error:
        return str(error)
    return NO_COMPILER if compiler() is None else None


class _UnavailableError(Exception):
    """Compiled functions are not available; the message gives the reason."""


def source(functions: Sequence[ca.Function]) -> str:
    """Return the C source code of functions."""
    generator = ca.CodeGenerator("slipfree")
    for each in functions:
        generator.add(each)
    return str(generator.dump())


def folder() -> Path | None:
    """Return the folder of the cache; None if ``SLIPFREE_CACHE`` is empty.

    Raises _UnavailableError if ``SLIPFREE_CACHE`` names a user without a home folder.
    """
    given = os.environ.get(FOLDER)
    if given is None:
        return platformdirs.user_cache_path("slipfree") / "compiled"
    try:
        return Path(given).expanduser() if given else None
    except RuntimeError as error:  # "~NAME" without a home folder
        raise _UnavailableError(
            f"{FOLDER}: expected a folder, found {given!r} of a user without a home folder; set "
            f"{FOLDER} to another folder"
        ) from error


def _prepare(cache: Path) -> None:
    """Create the cache folder if missing.

    Raises _UnavailableError if the folder cannot be created, or if other users may write to it.
    """
    try:
        cache.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = cache.stat()
        if not _is_private(status):
            found, remedy = "one that others can write to", "remove their write permission"
            if status.st_uid != os.geteuid():
                found, remedy = "one of another user", "change its owner"
            raise _UnavailableError(
                f"{cache}: expected a folder that only this user can write to, found {found}; "
                f"{remedy}, or set {FOLDER} to another folder"
            )
    except OSError as error:
        raise _UnavailableError(_unusable(cache, error)) from error


def _unusable(cache: Path, error: OSError) -> str:
    """Return the message of a system error in the cache folder."""
    return (
        f"{cache}: the cache folder cannot be used ({error.strerror}); set {FOLDER} to another "
        "folder"
    )


def _is_private(about: os.stat_result) -> bool:
    """Return whether a file or folder belongs to this user and no one else can write to it.

    The result is true on systems without POSIX permissions.
    """
    if os.name != "posix":
        return True
    return about.st_uid == os.geteuid() and not about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def compiler() -> list[str] | None:
    """Return the command of the C compiler, split into words; None without a compiler."""
    try:
        named = shlex.split(os.environ.get("CC", ""))
    except ValueError:  # an unbalanced quote
        named = []
    for command in (named, ["cc"], ["gcc"], ["clang"]):
        if command and shutil.which(command[0]):
            return command
    return None


def _load_cached(cache: Path, key: str, load: Callable[[str], T]) -> T | None:
    """Return the functions of the library of a key, or None; damaged libraries are removed."""
    for file in sorted(cache.glob(f"{key}.*.so")):
        try:
            same = file.suffixes[-2] == f".{digest(file.read_bytes())}"
            if same and _is_private(file.lstat()) and not file.is_symlink():
                loaded = load(str(file))
                with suppress(OSError):  # the folder may be read-only
                    os.utime(file)  # the least recently used library is removed first
                return loaded
        except (OSError, RuntimeError):  # removed by another process, or not loadable
            pass
        with suppress(OSError):  # the folder may be read-only
            file.unlink(missing_ok=True)
    return None


def digest(content: bytes) -> str:
    """Return the first 32 hexadecimal digits of the SHA-256 of bytes, for cached file names."""
    return hashlib.sha256(content).hexdigest()[:DIGEST_LENGTH]


def _compile(
    cache: Path, key: str, code: str, command: Sequence[str], flags: Sequence[str]
) -> None:
    """Compile C code and store the library in the cache; its key and digest name the file.

    Raises _UnavailableError if the cache cannot be written, or the compiler cannot be started,
    fails, takes more than its limit or writes no library.
    """
    try:
        with tempfile.TemporaryDirectory(dir=cache, prefix=SCRATCH_PREFIX) as scratch:
            text, file = Path(scratch) / "functions.c", Path(scratch) / "functions.so"
            text.write_text(code, encoding="utf-8")
            try:
                _run([*command, *flags, "-o", str(file), str(text), "-lm"])
            except OSError as error:
                raise _UnavailableError(
                    f"{shlex.join(command)}: the C compiler cannot be started ({error.strerror}); "
                    "set CC to another C compiler"
                ) from error
            if not file.exists():
                raise _UnavailableError(
                    f"{shlex.join(command)}: expected a C compiler, found a command that wrote no "
                    "library; set CC to a C compiler"
                )
            file.chmod(0o700)
            file.replace(cache / f"{key}.{digest(file.read_bytes())}.so")
    except OSError as error:
        raise _UnavailableError(_unusable(cache, error)) from error
    except subprocess.SubprocessError as error:
        how, remedy = "failed", "set CC to another C compiler"
        if isinstance(error, subprocess.TimeoutExpired):
            how = f"took more than {error.timeout:.3g} s"
            if error.timeout < COMPILER_TIMEOUT:
                how, remedy = f"{how}, its share of plan.seconds", "raise plan.seconds"
        raise _UnavailableError(f"{shlex.join(command)}: the C compiler {how}; {remedy}") from error
    # the least recently used libraries, and the leftovers of interrupted compilations
    ages = dict[Path, float]()
    for file in cache.iterdir():
        with suppress(OSError):  # another process may remove it at the same time
            ages[file] = file.stat().st_mtime
    libraries = sorted((each for each in ages if each.suffix == ".so"), key=lambda f: -ages[f])
    for file in libraries[MAX_LIBRARIES:]:
        with suppress(OSError):
            file.unlink()
    for file in ages:
        if file.name.startswith(SCRATCH_PREFIX) and ages[file] < time.time() - 2 * COMPILER_TIMEOUT:
            shutil.rmtree(file, ignore_errors=True)


def _run(command: Sequence[str]) -> None:
    """Run a compiler in its own session; kill it after an interruption or if time runs out."""
    none = subprocess.DEVNULL
    with subprocess.Popen(
        command, stdin=none, stdout=none, stderr=none, start_new_session=True
    ) as process:

        def end() -> None:
            """End the compiler with its child processes."""
            if process.returncode is None:
                with suppress(OSError):  # the compiler has just ended
                    if os.name == "posix":
                        os.killpg(process.pid, signal.SIGKILL)  # with its child processes
                    else:
                        process.kill()

        try:
            with ended_by_interrupt(end):
                code = process.wait(min(COMPILER_TIMEOUT, _LIMIT.get()))
        except BaseException:
            end()
            process.wait()
            raise
    if code:
        raise subprocess.CalledProcessError(code, command)
