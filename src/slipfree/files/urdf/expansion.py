"""Expansion of xacro files, which are programs, to URDF in a process of their own."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from slipfree.errors import DataError, missing_package
from slipfree.files.urdf.packages import package_folders
from slipfree.processes import ProcessDiedError, bounded_call
from slipfree.regular_files import regular_file, resolve_links

FINDER = "ament_index_python"  # package of ROS that xacro asks for the folders of packages
MAX_SECONDS = 6.0  # largest duration of an expansion [s]
MAX_BYTES = 20_000_000  # size of the largest accepted URDF


class Expansion(NamedTuple):
    """Result of an expansion.

    Attributes
    ----------
    data : bytes
        The URDF.
    macros : frozenset of str
        Names of all macros in the file and in the files that it includes.
    """

    data: bytes
    macros: frozenset[str]


def trusted_paths(files: Iterable[str | os.PathLike[str]]) -> frozenset[str]:
    """Return the resolved paths of xacro files that the user trusts.

    Raises
    ------
    DataError
        If one of them is not a regular file.
    """
    for file in files:
        with regular_file(Path(file), "a xacro file to trust"):
            pass
    return frozenset(str(resolve_links(Path(file).absolute())) for file in files)


def is_trusted(path: Path, trusted: frozenset[str]) -> bool:
    """Return whether a file is one of those that `trusted_paths` returned."""
    return str(resolve_links(path.absolute())) in trusted


def ways(file: str) -> str:
    """Return the two ways to use a xacro file, for messages."""
    name = shlex.quote(file)
    return (
        "xacro is a program, which runs only if you trust it: expand it yourself with xacro "
        f"{name} > robot.urdf, or add --trust {name} to the command (Python: trust=...)"
    )


def expanded(path: Path, arguments: Mapping[str, str]) -> Expansion:
    """Return the URDF that a xacro file describes; the caller checks that the user trusts it.

    Where ROS is not installed, packages in ``$(find ...)`` are searched in the folders of
    `package_folders`. The expansion may take 6 s, 2 GB of memory, and 20 MB for the URDF; what it
    prints is discarded.

    Parameters
    ----------
    path : Path
        The file.
    arguments : mapping of str to str
        Values of its arguments, which override their defaults.

    Raises
    ------
    DataError
        If the file cannot be read or expanded within the limits, if a package in ``$(find ...)`` is
        not found, or if the package ``xacro`` is not installed.
    """
    with regular_file(path, "xacro"):
        pass
    if find_spec("xacro") is None:
        hint = f"; or expand the file elsewhere: xacro {shlex.quote(str(path))} > robot.urdf"
        raise DataError(f"{path}: {missing_package('xacro', 'urdf')}{hint}")
    try:
        return bounded_call(_expand, path, dict(arguments), seconds=MAX_SECONDS)
    except ProcessDiedError as error:
        raise DataError(
            f"{path}: expected xacro that can be expanded in {MAX_SECONDS:g} s, found that "
            f"{error}; correct macros that call themselves, large powers and endless loops"
        ) from error


def _expand(path: Path, arguments: Mapping[str, str]) -> Expansion:
    """Expand a xacro file in this process; parameters and errors are those of `expanded`."""
    import xacro

    if find_spec(FINDER) is None:
        _find_packages_above(path)
    macros = _record_macros(xacro)
    parse = xacro.parse

    def parse_regular(document: Any, filename: str | None = None) -> Any:
        if filename is not None:  # not a pipe, whose reading may never end
            with regular_file(Path(filename), "xacro"):
                pass
        return parse(document, filename)

    xacro.parse = parse_regular
    try:
        document: Any = xacro.process_file(str(path), mappings=dict(arguments), verbosity=0)
        data: bytes = document.toprettyxml(indent="  ").encode()
    except Exception as error:  # xacro raises errors of many kinds
        cause = getattr(error, "exc", None) or error
        if isinstance(cause, DataError | MemoryError):
            raise cause from None
        words = " ".join(str(error).split())[:500] or type(error).__name__
        if (inside := xacro.filestack[-1:]) not in ([], [str(path)]):
            words += f" (in {inside[0]})"
        raise DataError(
            f"{path}: expected xacro that can be expanded, found: {words}; correct it, or give "
            'its arguments in a vehicle file, as in arguments = { name = "value" }'
        ) from None
    if len(data) > MAX_BYTES:
        raise DataError(
            f"{path}: expected xacro that expands to at most {MAX_BYTES / 1e6:g} MB, found "
            f"{len(data) / 1e6:.3g} MB; correct macros that multiply"
        )
    return Expansion(data, frozenset(macros))


def _record_macros(xacro: Any) -> set[str]:
    """Let xacro add the names of macros to the returned set."""
    found: set[str] = set()
    grab = xacro.grab_macro

    def record(element: Any, macros: Any) -> None:
        found.add(element.getAttribute("name").removeprefix("xacro:"))
        grab(element, macros)

    xacro.grab_macro = record
    return found


def _find_packages_above(path: Path) -> None:
    """Let xacro find packages without ROS, in the folders of `package_folders`."""

    def folder_of(package: str) -> str:
        found = [each for each in package_folders(package, path.parent) if each.is_dir()]
        if not found:
            raise DataError(
                f"{path}: expected the package {package!r} in a folder above this file or in "
                "ROS_PACKAGE_PATH, found none; put it there, or add its parent folder to "
                "ROS_PACKAGE_PATH"
            )
        return str(found[0])

    finder, packages = ModuleType(FINDER), ModuleType(f"{FINDER}.packages")
    packages.__dict__["get_package_share_directory"] = folder_of
    sys.modules.update({FINDER: finder, f"{FINDER}.packages": packages})
