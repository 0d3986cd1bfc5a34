"""What films have in common: how many pictures, and what writes them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from subprocess import CalledProcessError
from typing import TypeVar

from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.figure import Figure

from slipfree.atomic_files import replace_file
from slipfree.errors import DataError

FRAMES, FILM_DPI = 20, 110  # of a film, by second and by inch
ENDINGS = (".gif", ".mp4")
T = TypeVar("T")


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


def write_film(
    writer: AbstractMovieWriter,
    figure: Figure,
    file: Path,
    show: Callable[[T], None],
    steps: Iterable[T],
) -> None:
    """Write a film of a figure as it is after each step is shown; the file is old or whole.

    Raises
    ------
    DataError
        If the file cannot be written.
    """

    def fill(part: Path) -> None:
        with writer.saving(figure, str(part), FILM_DPI):
            for step in steps:
                show(step)
                writer.grab_frame()

    try:
        replace_file(file, fill)
    except CalledProcessError as error:
        if isinstance(error.__context__, KeyboardInterrupt):  # which ended ffmpeg as well
            raise error.__context__ from None
        raise DataError(
            f"{file}: cannot be written (ffmpeg: {error}); choose another place"
        ) from error
