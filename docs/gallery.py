"""Draw the pictures of the gallery: ``python docs/gallery.py [NAME ...]``, in a few minutes.

Each picture is a figure of a shipped problem, as `slipfree run` writes it, with fewer pixels and
colours. The page `gallery.md` shows them.
"""

import sys
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from PIL import Image

from slipfree import load_problem, run_problem
from slipfree.problem.load import verb_of
from slipfree.show.plots import draw

DOCS = Path(__file__).parent
FOLDER = DOCS / "figures" / "gallery"
DPI, COLORS = 150, 256  # of the figures, which pages show at half their size or less
OCTREE = Image.Quantize.FASTOCTREE  # keeps greys grey, and the few pixels of arrows magenta


class Picture(NamedTuple):
    """Picture of a gallery: its name, a problem, the figure, and changed settings."""

    name: str
    problem: str
    figure: str
    settings: tuple[str, ...] = ()


PICTURES = (
    Picture("climb", "climb_step", "side"),
    Picture("craters", "plan_crater_field", "traversability"),
    Picture("inputs", "plan_crater_field", "plan"),
    Picture("parking", "plan_parking", "traversability"),
    Picture("map", "rover_rocks_direct", "map"),
    Picture("elevation", "rover_rocks_direct", "elevation"),
    Picture("friction", "traction_hills", "map"),
    Picture("checks", "rover_rocks_direct", "checks"),
    Picture("energy", "dynamics_ledge", "energy"),
)


def write(picture: Picture, result) -> Path:
    """Draw a picture of a result and return its file."""
    verb = verb_of(result.problem)
    (plot,) = (each for each in verb.figures(result) if each.name == picture.figure)
    stream = BytesIO()
    draw([plot])[plot.name].savefig(stream, dpi=DPI)
    file = FOLDER / f"{picture.name}.png"
    Image.open(stream).convert("RGB").quantize(COLORS, OCTREE).save(file, optimize=True)
    return file


def main(names: list[str]) -> None:
    """Write the pictures with the given names; all without names."""
    results = {}
    for picture in PICTURES:
        if names and picture.name not in names:
            continue
        key = picture.problem, picture.settings
        if key not in results:
            path = DOCS.parent / "problems" / f"{picture.problem}.toml"
            results[key] = run_problem(load_problem(path, picture.settings))
        file = write(picture, results[key])
        print(f"{file.relative_to(DOCS)}, {file.stat().st_size / 1e3:.0f} kB", flush=True)


if __name__ == "__main__":
    FOLDER.mkdir(exist_ok=True)
    main(sys.argv[1:])
