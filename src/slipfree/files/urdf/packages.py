"""Folders of the ROS packages to which URDF and xacro files refer."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path


def package_folders(package: str, folder: Path) -> Iterator[Path]:
    """Yield the possible folders of a ROS package to which a file in ``folder`` refers.

    They are in ``folder`` and the folders above it, and in those of the environment variables
    AMENT_PREFIX_PATH and ROS_PACKAGE_PATH.
    """
    for above in (folder.resolve(), *folder.resolve().parents):
        if above.name == package:
            yield above
        yield above / package
    for variable, inside in (("AMENT_PREFIX_PATH", "share"), ("ROS_PACKAGE_PATH", "")):
        for root in filter(None, os.environ.get(variable, "").split(os.pathsep)):
            yield Path(root) / inside / package
