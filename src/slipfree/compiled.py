"""Functions compiled with the system's C compiler, and kept for the next time.

What is compiled stays in a folder of the user, under a name made of the text it came from. Without
a compiler, or without a place to write to, there is nothing compiled, and callers do without.
"""

from __future__ import annotations

import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import casadi as ca
import platformdirs

FOLDER = "SLIPFREE_CACHE"  # variable of the environment: another folder; empty for none
# The functions are long lists of sums and products: with more optimisation they take as long, and
# without any they take three times as long, as the interpreter does.
FLAGS = ("-O1", "-shared", "-fPIC", "-ffp-contract=off")
PATIENCE = 300.0  # with the compiler [s]
KEPT = 64  # libraries; about a megabyte each
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
        None if they are not there, and there is no compiler or it does not do its work.
    """
    place, key = folder(), _key(text)
    if place is None:
        return None
    found = _kept(place, key, names)
    command = compiler() if found is None else None
    if command is not None and _compile(place, key, make(), command):
        found = _kept(place, key, names)
    return found


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
    return Path(given) if given else None


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
            if file.suffixes[-2] == f".{digest(file.read_bytes())}":
                return tuple(ca.external(name, str(file)) for name in names)
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
) -> bool:
    """Put a library into the cache under its key and a digest of itself; return whether it is."""
    try:
        place.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=place) as scratch:
            text, file = Path(scratch) / "functions.c", Path(scratch) / "functions.so"
            text.write_text(source(functions))
            subprocess.run(
                [*command, *FLAGS, "-o", str(file), str(text), "-lm"],
                check=True, capture_output=True, timeout=PATIENCE,
            )  # fmt: skip
            file.replace(place / f"{key}.{digest(file.read_bytes())}.so")
        _tidy(place)
    except (OSError, subprocess.SubprocessError):
        return False
    return True


def _tidy(place: Path) -> None:
    """Remove the oldest libraries of those that are too many."""
    files = sorted(place.glob("*.so"), key=lambda file: -file.stat().st_mtime)
    for file in files[KEPT:]:
        file.unlink(missing_ok=True)
