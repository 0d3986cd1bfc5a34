"""Check of the header of a netCDF file, before the netCDF library reads it."""

from __future__ import annotations

from pathlib import Path

import scipy  # scipy.io is imported when it is used, since this takes 0.2 s

from slipfree.errors import DataError

CLASSIC = (b"CDF\1", b"CDF\2")
DAMAGED = (ValueError, LookupError, TypeError, OverflowError, MemoryError)


def check_header(path: Path) -> None:
    """Raise DataError for a damaged header of a classic netCDF file.

    The netCDF library allocates as much memory as a header claims, up to gigabytes.
    """
    with path.open("rb") as stream:
        if stream.read(4) not in CLASSIC:
            return
    try:
        with path.open("rb") as stream, scipy.io.netcdf_file(stream, mmap=True):
            pass
    except DAMAGED as error:
        raise DataError(
            "expected a readable netCDF file, found a damaged header; copy or download it again"
        ) from error.with_traceback(None)
