"""What films have in common: how many pictures, and what writes them."""

from __future__ import annotations

from pathlib import Path

from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter

from slipfree.errors import DataError

FRAMES, FILM_DPI = 20, 110  # of a film, by second and by inch
ENDINGS = (".gif", ".mp4")


def film_writer(file: Path, rate: int) -> AbstractMovieWriter:
    """Return what writes a film to a file, by its ending.

    Raises
    ------
    DataError
        If the ending is unknown, or what it needs is not installed.
    """
    if file.suffix not in ENDINGS:
        raise DataError(f"{file}: expected a name that ends in {' or '.join(ENDINGS)} for a film")
    if file.suffix == ".gif":
        return PillowWriter(fps=rate)
    if not FFMpegWriter.isAvailable():
        raise DataError(
            f"{file}: films in MP4 need the program ffmpeg, found none; install it (Debian: apt "
            "install ffmpeg; conda: conda install ffmpeg) or write a .gif"
        )
    return FFMpegWriter(fps=rate)
