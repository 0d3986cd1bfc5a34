"""GeoTIFF files of tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from rasterio.transform import Affine

from slipfree import DataError
from slipfree.files.maps.elevation import read_map


def from_origin(west: float, north: float, cell: float) -> Affine:
    """Return the transform of square cells from the north-western corner."""
    return Affine(cell, 0, west, 0, -cell, north)


def geotiff(
    path: Path,
    rows: Any,
    transform: Affine,
    *,
    crs: str | None = "EPSG:32633",
    dtype: str = "float32",
    **options: Any,
) -> Path:
    """Write rows from the north, of one band or more, and return the path."""
    bands = np.atleast_3d(np.asarray(rows, dtype).T).T
    count, height, width = bands.shape
    profile = {"width": width, "height": height, "count": count, "dtype": dtype, "crs": crs}
    profile |= {"driver": "GTiff", "transform": transform} | options
    with rasterio.open(path, "w", **profile) as file:
        file.write(bands)
    return path


def refuses(path: Path, words: str, **keys: Any) -> None:
    """Check that a map is refused with words that match a pattern."""
    with pytest.raises(DataError, match=words):
        read_map(path, **keys)
