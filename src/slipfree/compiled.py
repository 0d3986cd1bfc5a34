"""Functions compiled with the system's C compiler, and kept for the next time.

What is compiled stays in a folder of the user, under a name made of the text it came from. Code is
loaded from there, so it must be a folder that nobody else can write to. Without a compiler, or
without such a place, there is nothing compiled: callers do without, and a warning says why.
"""

from __future__ import annotations

import hashlib
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
NO_COMPILER = "no C compiler was found: cc, gcc, clang, or what CC names"
PATIENCE = 300.0  # with the compiler [s]
KEPT = 64  # libraries; about a megabyte each
SCRATCH = "making-"  # how folders begin in which a compiler works
DIGEST = 32  # digits in a name


def library(
    text: str, names: Sequence[str], make: Callable[[], Sequence[ca.Function]]
) -> tuple[ca.Function, ...] | None:
    """Return compiled functions, from the cache if they are there.

    Parameters
    ----------
    text : str
        What the functions follow from: the same text stands for the same functions.
    names : sequence of str
        Their names.
    make : callable
        Returns the functions, of SX and without calls of others; only if they must be compiled.

    Returns
    -------
    tuple of casadi Function, or None
        None if they are not there and cannot be compiled; a warning says why.
    """
    key = _key(text)
    try:
        if (place := folder()) is None:
            raise _NothingError(f"{FOLDER} is empty")
        _prepare(place)
        if found := _kept(place, key, names):
            return found
        if (command := compiler()) is None:
            raise _NothingError(NO_COMPILER)
        _compile(place, key, make(), command)
        if found := _kept(place, key, names):
            return found
        raise _NothingError(f"what {shlex.join(command)} made cannot be loaded")
    except _NothingError as error:
        warnings.warn(f"equations are interpreted, not compiled: {error}", stacklevel=1)
    return None


def obstacle() -> str | None:
    """Return why nothing can be compiled here, None if nothing is seen that is in the way."""
    try:
        if folder() is None:
            return f"{FOLDER} is empty"
    except _NothingError as error:
        return str(error)
    return NO_COMPILER if compiler() is None else None


class _NothingError(Exception):
    """Nothing can be compiled here."""


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
        raise _NothingError(
            f"{FOLDER}: expected a folder, found {given!r} of a user who has no home folder"
        ) from error


def _prepare(place: Path) -> None:
    """Make the folder if it is not there, and refuse one that others may have written to."""
    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not _own(place.stat()):
            raise _NothingError(
                f"{place}: expected a folder of this user that others cannot write to"
            )
    except OSError as error:
        raise _NothingError(f"{place}: {error.strerror}") from error


def _own(about: os.stat_result) -> bool:
    """Return whether nobody else can have written to a file or folder."""
    if os.name != "posix":
        return True
    return about.st_uid == os.geteuid() and not about.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def compiler() -> list[str] | None:
    """Return the command of the C compiler, None if there is none."""
    try:
        named = shlex.split(os.environ.get("CC", ""))
    except ValueError:  # an open quote
        named = []
    for command in (named, ["cc"], ["gcc"], ["clang"]):
        if command and shutil.which(command[0]):
            return command
    return None


def _kept(place: Path, key: str, names: Sequence[str]) -> tuple[ca.Function, ...] | None:
    """Return functions of the cache; what is not as it was written there is removed."""
    for file in sorted(place.glob(f"{key}.*.so")):
        try:
            same = file.suffixes[-2] == f".{digest(file.read_bytes())}"
            if same and _own(file.lstat()) and not file.is_symlink():
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
        with tempfile.TemporaryDirectory(dir=place, prefix=SCRATCH) as scratch:
            text, file = Path(scratch) / "functions.c", Path(scratch) / "functions.so"
            text.write_text(source(functions), encoding="utf-8")
            _run([*command, *FLAGS, "-o", str(file), str(text), "-lm"])
            if not file.exists():
                raise _NothingError(
                    f"{shlex.join(command)}: expected a C compiler, found that it made no library; "
                    "name another one in CC"
                )
            file.chmod(0o700)
            file.replace(place / f"{key}.{digest(file.read_bytes())}.so")
    except OSError as error:
        raise _NothingError(f"{place}: {error.strerror}") from error
    except subprocess.SubprocessError as error:
        raise _NothingError(f"{shlex.join(command)} did not do its work") from error
    _tidy(place)


def _run(command: Sequence[str]) -> None:
    """Run a compiler out of reach of the terminal's Ctrl-C; what interrupts us ends it."""
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
                code = process.wait(PATIENCE)
        except BaseException:
            end()
            process.wait()
            raise
    if code:
        raise subprocess.CalledProcessError(code, command)


def _tidy(place: Path) -> None:
    """Remove the libraries that were not used for longest, and what killed compilers left."""
    ages = dict[Path, float]()
    for file in place.iterdir():
        with suppress(OSError):  # another process may tidy as well
            ages[file] = file.stat().st_mtime
    libraries = sorted(
        (file for file in ages if file.suffix == ".so"), key=lambda file: -ages[file]
    )
    for file in libraries[KEPT:]:
        with suppress(OSError):
            file.unlink()
    for file in ages:
        if file.name.startswith(SCRATCH) and ages[file] < time.time() - 2 * PATIENCE:
            shutil.rmtree(file, ignore_errors=True)
