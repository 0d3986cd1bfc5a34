"""Folders of the packages that a URDF or xacro file names."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path


def package_folders(package: str, folder: Path) -> Iterator[Path]:
    """Yield the folders that a package of ROS may have, for a file of a folder."""
    for above in (folder.resolve(), *folder.resolve().parents):
        if above.name == package:
            yield above
        yield above / package
    for variable, inside in (("AMENT_PREFIX_PATH", "share"), ("ROS_PACKAGE_PATH", "")):
        for root in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            yield Path(root) / inside / package
