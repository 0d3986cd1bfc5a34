"""Computation of a mobility map in tiles, which are kept until all files are written.

Processes compute tiles; each is stored in a folder as soon as it is finished, so that a killed
computation continues where it was, with equal files. Files are written tile by tile.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slipfree.atlas.atlas import PROVED, Atlas, Band, least_bounds
from slipfree.core.errors import DataError
from slipfree.core.facts import Fact, Lines, lines, rows
from slipfree.core.records import Array
from slipfree.files.atlas_files import Site, Tiles, write_atlas, write_geotiff
from slipfree.problem import inputs
from slipfree.problem.build_ground import Extremes
from slipfree.problem.problem import Problem
from slipfree.problem.verbs.atlas import AtlasSetup, build_atlas
from slipfree.show.atlas_figures import AtlasView, friction_maps
from slipfree.system.parts import PartsWatch, Workers, study

DRAWN = 1000  # largest number of nodes along an axis of a figure
WIDE = 0.01  # difference of bounds of the least friction that is reported [1]

ROWS = rows(
    f"""\
allowed poses: {{allowed_share:.3g>%}}
allowed headings: all at {{all_headings_share:.3g>%}} of the nodes, some at \
{{some_headings_share:.3g>%}}, none at {{no_headings_share:.3g>%}}
least friction best: {{least_friction_best_high_median:.3g}} (median of the nodes)
least friction worst: {{least_friction_worst_high_median:.3g}} (median of the nodes)
least utilisation best: {{least_utilisation_best_high_median:.3g}} (median of the nodes)
least utilisation worst: {{least_utilisation_worst_high_median:.3g}} (median of the nodes)
proved: bounds of {{proved_share:.3g>%}} of the poses that stand, for every ground near the map
!bounds of friction: wider than {WIDE:g} at {{loose_bounds_share:.3g>%}} of the poses"""
)


class TileTask(NamedTuple):
    """Set-up and number of a tile, for a process."""

    recipe: inputs.Recipe
    digests: tuple[tuple[str, str], ...]  # of all input files, by name
    known: tuple[tuple[str, Extremes], ...]  # of large maps, by file
    number: int  # from 1


def compute_tile(task: TileTask) -> Array:
    """Return the values of the bands in a tile, shape (n_bands, n_headings, n_x, n_y)."""
    return _tile(_setup(task._replace(number=0)), task.number)


@lru_cache(maxsize=1)  # a process computes many tiles
def _setup(task: TileTask) -> AtlasSetup:
    problem = task.recipe.load()
    setup = build_atlas(problem, dict(task.known))
    if input_states(problem).digests != dict(task.digests):
        raise DataError(
            f"{task.recipe.path}: expected the input files with which the computation started, "
            "found others; copy them to all workers, and repeat the command"
        )
    return setup


def _tile(setup: AtlasSetup, number: int) -> Array:
    bands = setup.bands(*setup.tiles[number - 1])
    return np.stack([bands[name] for name in setup.labels()]).astype(np.float32)


def input_states(problem: Problem[Any]) -> inputs.FileStates:
    """Return the states of the input files of a mobility map."""
    files = (file for file in inputs.files_read(problem)[1:] if file.is_file())
    return inputs.file_states({os.path.relpath(file, problem.folder): file for file in files})


class TileFolder(inputs.ProblemParts[Array]):
    """Folder beside an output with the finished tiles of a mobility map; a context manager.

    ``states`` are those of the input files before the set-up was built.
    """

    def __init__(self, out: Path, setup: AtlasSetup, states: inputs.FileStates) -> None:
        count, problem = len(setup.tiles), setup.problem
        self._setup = setup
        # before the log is opened, which an error would leave open
        self._labels, self._reasons = setup.labels(), setup.poses().reasons
        super().__init__(out, "mobility map", count, problem, ".npy", states)

    def store(self, number: int, result: Array) -> None:
        """Store a tile; raise DataError if an input file has changed since the start."""
        self.add(number, {}, lambda part: np.save(part, result))

    def tiles(self) -> Tiles:
        """Yield the places and poses of all tiles."""
        setup = self._setup
        for number, (i, j) in enumerate(setup.tiles, 1):
            values = zip(self._labels.items(), np.load(self.file(number)), strict=True)
            bands = {name: Band(label, each) for (name, label), each in values}
            yield i, j, Atlas(setup.x[i], setup.y[j], setup.heading, bands, self._reasons)

    def whole(self) -> Atlas:
        """Return the poses of all tiles."""
        setup = self._setup
        shape = setup.heading.size, setup.x.size, setup.y.size
        bands = {
            name: Band(label, np.empty(shape, np.float32)) for name, label in self._labels.items()
        }
        for i, j, tile in self.tiles():
            for name, band in bands.items():
                band.values[:, i, j] = tile[name]
        return Atlas(setup.x, setup.y, setup.heading, bands, self._reasons)


def run_tiles(setup: AtlasSetup, folder: TileFolder, workers: Workers, watch: PartsWatch) -> None:
    """Compute the missing tiles of a map, and store each as soon as it is finished.

    The other arguments are those of `study`.
    """
    digests, known = tuple(folder.states.digests.items()), tuple(setup.known.items())
    recipe = inputs.recipe_of(setup.problem)
    recipe = recipe._replace(path=recipe.path.absolute())
    with study(compute_tile, folder, workers, watch=watch) as solve:
        watch.progress(len(folder), folder.size)
        for number in folder.missing[:1]:  # here: it compiles the equations, and errors are raised
            watch.poll()
            folder.store(number, _tile(setup, number))
        for _ in solve(folder.missing, lambda number: TileTask(recipe, digests, known, number)):
            pass


def write_file(path: Path, setup: AtlasSetup, folder: TileFolder) -> None:
    """Write a map from its finished tiles: all poses to a file ending in ``.nc``, else a GeoTIFF.

    A netCDF file needs memory for all poses.
    """
    if path.suffix.lower() == ".nc":
        write_atlas(path, folder.whole(), setup.site)
    else:
        write_geotiff(path, setup.x, setup.y, setup.site, folder.tiles())


def overview(x: Array, y: Array, site: Site, tiles: Tiles) -> tuple[AtlasView, dict[str, Fact]]:
    """Return contents of the figures, and facts by name, of a map from its tiles."""
    step = max(1, -(-max(x.size, y.size) // DRAWN))
    shape = -(-x.size // step), -(-y.size // step)
    maps, reasons = dict[str, Band](), tuple[str, ...]()
    counts: Array = np.zeros(1)
    least, wide = np.zeros(3), 0  # nodes where all, some and no headings are allowed
    proved = np.zeros(2)  # poses with proved bounds, and those that stand
    for i, j, poses in tiles:
        drawn, found = site.summary_of(poses, i, j)
        reasons = found.reasons
        codes = np.bincount(found.codes.ravel(), minlength=len(reasons))
        counts = counts + codes  # all tiles have the same reasons
        share = found.allowed
        least += [(share == 1).sum(), ((share > 0) & (share < 1)).sum(), (share == 0).sum()]
        if (bounds := least_bounds(poses)) is not None:
            low, high = (poses[label.name] for label in bounds)
            wide += int((high - low > WIDE).sum())
        if PROVED.name in poses.bands:
            proved += [(poses[PROVED.name] == 1).sum(), poses.stands.sum()]
        a, b = (slice(-each.start % step, None, step) for each in (i, j))
        for name, (label, values) in drawn.items():
            if name not in maps:
                maps[name] = Band(label, np.full(shape, np.nan, dtype=np.float32))
            part = values[a, b]
            at = [-(-each.start // step) for each in (i, j)]
            maps[name].values[at[0] : at[0] + part.shape[0], at[1] : at[1] + part.shape[1]] = part
    view = AtlasView(x[::step], y[::step], maps, reasons, poses.heading.size, site)
    count = float(counts.sum())
    words = ("all headings are allowed", "some are", "none is")
    facts = {"allowed_share": Fact(counts[0] / count, "1", "share of the poses that are allowed")}
    for name, number, meaning in zip(("all", "some", "no"), least, words, strict=True):
        of_nodes = float(number / least.sum())
        facts[f"{name}_headings_share"] = Fact(of_nodes, "1", f"share of the nodes where {meaning}")
    if proved[1]:
        of_poses = float(proved[0] / proved[1])
        meaning = "share of the standing poses whose bounds are proved"
        facts["proved_share"] = Fact(of_poses, "1", meaning)
    friction = friction_maps(maps)
    for label, values in friction:
        known = values[np.isfinite(values)]
        if known.size:
            facts[f"{label.name}_median"] = Fact(float(np.median(known)), "1", label.words)
    if friction:
        meaning = f"poses whose bounds of the least friction differ by more than {WIDE:g}"
        facts["loose_bounds_share"] = Fact(wide / count, "1", f"share of the {meaning}")
    excluded = [
        {"reason": text, "share": float(number / count)}
        for text, number in zip(reasons, counts, strict=True)
        if number and text != reasons[0]
    ]
    facts["reasons"] = Fact(sorted(excluded, key=lambda row: -float(row["share"])))
    return view, facts


def summary_lines(facts: Mapping[str, Fact]) -> Lines:
    """Return the summary of a mobility map, pairs of name and text, which show its facts."""
    reasons = facts["reasons"].value
    excluded = [f"{100 * row['share']:.3g} %: {row['reason']}" for row in reasons]
    return [*lines(ROWS, facts), *(("  not allowed", words) for words in excluded)]
