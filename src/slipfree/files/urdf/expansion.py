"""Expansion of xacro files to URDF."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any

from slipfree.errors import DataError, missing_package
from slipfree.files.urdf.packages import package_folders
from slipfree.regular_files import regular_file

FINDER = "ament_index_python"  # package of ROS that xacro asks for the folders of packages


def expanded(path: Path, arguments: Mapping[str, str]) -> bytes:
    """Return the URDF that a xacro file describes.

    Where ROS is not installed, packages in ``$(find ...)`` are searched in the folders of
    `package_folders`.

    Parameters
    ----------
    path : Path
        The file.
    arguments : mapping of str to str
        Values of its arguments, which override their defaults.

    Raises
    ------
    DataError
        If the file cannot be read or expanded, if a package in ``$(find ...)`` is not found, or if
        the package ``xacro`` is not installed.
    """
    try:
        import xacro
    except ImportError as error:
        hint = f"; or expand the file elsewhere: xacro {path} > robot.urdf"
        raise DataError(f"{path}: {missing_package('xacro', 'urdf')}{hint}") from error
    with regular_file(path, "xacro"), _packages_above(path):
        try:
            document: Any = xacro.process_file(str(path), mappings=dict(arguments), verbosity=0)
        except OSError:
            raise
        except Exception as error:  # xacro raises errors of many kinds
            if isinstance(missing := getattr(error, "exc", None), DataError):
                raise missing from error
            words = " ".join(str(error).split())
            raise DataError(
                f"{path}: expected xacro that can be expanded, found: {words}; correct it, or give "
                'its arguments in a vehicle file, as in arguments = { name = "value" }'
            ) from error
    text: str = document.toprettyxml(indent="  ")
    return text.encode()


@contextmanager
def _packages_above(path: Path) -> Iterator[None]:
    """Let xacro find packages without ROS, in the folders of `package_folders`."""
    if find_spec(FINDER) is not None:
        yield
        return

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
    names = {FINDER: finder, f"{FINDER}.packages": packages}
    sys.modules.update(names)
    try:
        yield
    finally:
        for name in names:
            del sys.modules[name]
