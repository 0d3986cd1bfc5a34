"""Computation of a mobility map in tiles, which are kept until all files are written.

Processes compute tiles; each is stored in a folder as soon as it is finished, so that a killed
computation continues where it was, with equal files. Files are written tile by tile.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import scipy

from slipfree.atlas.atlas import Atlas, Band, least_bounds, tiles_of
from slipfree.atlas.summary import ALLOWED, STANDING
from slipfree.core.errors import DataError, WriteError
from slipfree.core.facts import Fact
from slipfree.core.records import Array
from slipfree.core.version import __version__
from slipfree.files.atlas_files import (
    Site,
    StoredAtlas,
    geotiff_writer,
    part_of,
    with_reasons,
    write_atlas,
)
from slipfree.problem.build_ground import Extremes
from slipfree.problem.inputs import digest, files_read
from slipfree.problem.load import load_again
from slipfree.problem.problem import Problem
from slipfree.problem.verbs.atlas import AtlasSetup, build_atlas
from slipfree.problem.verbs.base import Lines
from slipfree.show.atlas_figures import AtlasView, friction_maps
from slipfree.system.processes import Poll, Pool, finish_tasks, local_tasks
from slipfree.system.regular_files import regular_file, replace_file

DIGEST_SIZE = 32  # of SHA-256 [bytes]
DRAWN = 1000  # largest number of nodes along an axis of a figure
WIDE = 0.01  # difference of bounds of the least friction that is reported [1]
DETAIL = 24  # nodes along the side of the detail of a figure


class TileTask(NamedTuple):
    """Problem and number of a tile, for a process."""

    file: str
    text: str
    settings: tuple[str, ...]
    trusted: frozenset[str]
    key: str  # of the contents of all input files
    known: tuple[tuple[str, Extremes], ...]  # of large maps, by file
    number: int


class Tile(NamedTuple):
    """Values of the bands in a tile, shape (n_bands, n_headings, n_x, n_y)."""

    number: int
    values: Array


def compute_tile(task: TileTask) -> Tile:
    """Return a tile of a mobility map."""
    return _tile(_setup(*task[:-1]), task.number)


@lru_cache(maxsize=1)  # a process computes many tiles
def _setup(
    file: str,
    text: str,
    settings: tuple[str, ...],
    trusted: frozenset[str],
    _: str,
    known: tuple[tuple[str, Extremes], ...],
) -> AtlasSetup:
    return build_atlas(
        load_again(Path(file), text, settings, trusted, command="atlas"), dict(known)
    )


def _tile(setup: AtlasSetup, number: int) -> Tile:
    bands = setup.bands(*setup.tiles[number])
    return Tile(number, np.stack([bands[name] for name in setup.labels()]).astype(np.float32))


class TileFolder:
    """Folder with the finished tiles of a mobility map; it is made if it is missing.

    The file of a tile begins with a digest of the problem, the number of the tile, and its values.
    A file that has another one is that of another problem or damaged: its tile is not finished.
    """

    def __init__(self, path: Path, setup: AtlasSetup) -> None:
        self.path, self._setup = path, setup
        self._labels = setup.labels()
        self._reasons = setup.poses().reasons
        self._key = problem_key(setup.problem)
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise WriteError(
                f"{path}: expected a folder for the tiles, found that it cannot be made "
                f"({error.strerror}); choose another output with -o"
            ) from error
        numbers = range(len(setup.tiles))
        self._finished = {k for k in numbers if self._read(k) is not None}

    @property
    def missing(self) -> list[int]:
        """Numbers of the tiles that are not finished."""
        return [k for k in range(len(self._setup.tiles)) if k not in self._finished]

    def add(self, tile: Tile) -> None:
        """Store a tile; it is complete even if this process is killed."""
        data = np.ascontiguousarray(tile.values).tobytes()
        data = self._digest(tile.number, data) + data
        replace_file(self._file(tile.number), lambda part: part.write_bytes(data))
        self._finished.add(tile.number)

    def poses(self, number: int) -> Atlas:
        """Return the poses of a finished tile; raise DataError if its file has changed."""
        if (values := self._read(number)) is None:
            raise DataError(
                f"{self._file(number)}: expected the tile that was written, found another file; "
                "repeat the command to compute it again"
            )
        i, j = self._setup.tiles[number]
        bands = {
            name: Band(label, each)
            for (name, label), each in zip(self._labels.items(), values, strict=True)
        }
        return Atlas(self._setup.x[i], self._setup.y[j], self._setup.heading, bands, self._reasons)

    def _read(self, number: int) -> Array | None:
        """Return the values of a tile, None without a file that has the digest of this tile."""
        i, j = self._setup.tiles[number]
        sizes = self._setup.heading.size, i.stop - i.start, j.stop - j.start
        shape = len(self._labels), *sizes
        length = DIGEST_SIZE + 4 * math.prod(shape)
        with suppress(DataError), regular_file(self._file(number), "a tile") as size:
            data = self._file(number).read_bytes() if size == length else b""
            if data[:DIGEST_SIZE] == self._digest(number, data[DIGEST_SIZE:]):
                return np.frombuffer(data, np.float32, offset=DIGEST_SIZE).reshape(shape)
        return None

    def _digest(self, number: int, data: bytes) -> bytes:
        return hashlib.sha256(f"{self._key} {number} ".encode() + data).digest()

    def window(self, i: slice, j: slice) -> Atlas:
        """Return the poses of a window of nodes, which may span several tiles."""
        setup = self._setup
        shape = setup.heading.size, i.stop - i.start, j.stop - j.start
        values = {name: np.empty(shape, dtype=np.float32) for name in self._labels}
        for k, (a, b) in enumerate(setup.tiles):
            rows, columns = _overlap(a, i), _overlap(b, j)
            if rows is not None and columns is not None:
                tile = self.poses(k)
                for name, array in values.items():
                    part = tile[name][:, rows[0], columns[0]]
                    array[:, rows[1], columns[1]] = part
        bands = {name: Band(self._labels[name], each) for name, each in values.items()}
        return Atlas(setup.x[i], setup.y[j], setup.heading, bands, self._reasons)

    def remove(self) -> None:
        """Remove the tiles and the folder, unless it has other files."""
        for number in self._finished:
            self._file(number).unlink(missing_ok=True)
        with suppress(OSError):
            self.path.rmdir()

    def _file(self, number: int) -> Path:
        return self.path / f"tile_{number:06}.bin"


def _overlap(tile: slice, window: slice) -> tuple[slice, slice] | None:
    """Return the common nodes of two slices, counted in each of them; None without any."""
    start, stop = max(tile.start, window.start), min(tile.stop, window.stop)
    if start >= stop:
        return None
    return tuple(slice(start - each.start, stop - each.start) for each in (tile, window))  # type: ignore[return-value]


def problem_key(problem: Problem[Any]) -> str:
    """Return a digest of the version, the values of a problem and the contents of its files."""
    values = problem.spec.model_dump_json(exclude={"title"}, serialize_as_any=True)
    files = [file for file in files_read(problem)[1:] if file.is_file()]
    text = json.dumps([__version__, values, [(str(file), digest(file)) for file in files]])
    return hashlib.sha256(text.encode()).hexdigest()


def run_tiles(
    setup: AtlasSetup,
    folder: TileFolder,
    workers: int | Pool[TileTask, Tile],
    poll: Poll,
    progress: Callable[[int, int], None],
) -> None:
    """Compute the missing tiles of a map, and store each as soon as it is finished.

    ``workers`` is a number of processes or a pool. ``poll`` is called several times per second, and
    ends the computation by an exception; ``progress`` with the number of finished tiles and that of
    all.
    """
    problem, count = setup.problem, len(setup.tiles)
    source = problem.source
    settings = tuple(dict.fromkeys(source.settings.values()))
    missing = folder.missing
    progress(count - len(missing), count)
    if missing:  # in this process: it compiles the equations, and errors end the computation
        poll()
        folder.add(_tile(setup, missing.pop(0)))
        progress(count - len(missing), count)
    head = (
        str(source.path.absolute()),
        source.text,
        settings,
        problem.trusted,
        problem_key(problem),
        tuple(setup.known.items()),
    )
    tasks = [TileTask(*head, number) for number in missing]
    left = len(tasks)
    if not tasks:
        return
    with ExitStack() as stack:
        if isinstance(workers, int):
            execute = stack.enter_context(local_tasks(compute_tile, min(workers, left)))
            tiles = execute(tasks, poll)
        else:
            tiles = finish_tasks(tasks, workers, poll)
        for tile in tiles:
            folder.add(tile)
            left -= 1
            progress(count - left, count)


def write_file(path: Path, setup: AtlasSetup, folder: TileFolder) -> None:
    """Write a map from its finished tiles: all poses to a file ending in ``.nc``, else a GeoTIFF.

    A netCDF file needs memory for all poses.
    """
    site = setup.site
    if path.suffix.lower() == ".nc":
        poses = folder.window(slice(0, setup.x.size), slice(0, setup.y.size))
        write_atlas(path, poses, site)
        return

    def fill(part: Path) -> None:
        with geotiff_writer(part, setup.x, setup.y, site) as write:
            for k, (i, j) in enumerate(setup.tiles):
                maps, found = site.summary_of(folder.poses(k), i, j)
                write(i, j, with_reasons(maps, found))

    replace_file(path, fill)


class AtlasOverview(NamedTuple):
    """Facts of the summary, and contents of the figures of a mobility map."""

    view: AtlasView
    facts: dict[str, Fact]  # of the whole map, by name


def overview_of_tiles(setup: AtlasSetup, folder: TileFolder) -> AtlasOverview:
    """Return the overview of a map from its finished tiles."""
    tiles = ((*tile, folder.poses(k)) for k, tile in enumerate(setup.tiles))
    return _overview(setup.x, setup.y, tiles, folder.window, setup.site)


def overview_of_file(stored: StoredAtlas) -> AtlasOverview:
    """Return the overview of a map in a netCDF file."""
    poses = stored.poses
    tiles = ((i, j, part_of(poses, i, j)) for i, j in tiles_of(poses.x.size, poses.y.size))
    return _overview(poses.x, poses.y, tiles, lambda i, j: part_of(poses, i, j), stored.site)


def _overview(
    x: Array,
    y: Array,
    tiles: Iterator[tuple[slice, slice, Atlas]],
    window: Callable[[slice, slice], Atlas],
    site: Site,
) -> AtlasOverview:
    step = max(1, -(-max(x.size, y.size) // DRAWN))
    shape = -(-x.size // step), -(-y.size // step)
    maps, reasons = dict[str, Band](), tuple[str, ...]()
    counts: Array = np.zeros(1)
    least, wide = np.zeros(3), 0  # nodes where all, some and no headings are allowed
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
        a, b = (slice(-each.start % step, None, step) for each in (i, j))
        for name, (label, values) in drawn.items():
            if name not in maps:
                maps[name] = Band(label, np.full(shape, np.nan, dtype=np.float32))
            part = values[a, b]
            at = [-(-each.start // step) for each in (i, j)]
            maps[name].values[at[0] : at[0] + part.shape[0], at[1] : at[1] + part.shape[1]] = part
    facts = _facts(maps, counts, reasons, least, wide)
    place = _detail(maps, step, (x.size, y.size))
    detail = site._replace(elevation=site.elevation[place])
    view = AtlasView(x[::step], y[::step], maps, reasons, window(*place), detail)
    return AtlasOverview(view, facts)


def _detail(maps: Mapping[str, Band], step: int, sizes: tuple[int, int]) -> tuple[slice, slice]:
    """Return the window in which headings differ most."""
    share = maps[ALLOWED if ALLOWED in maps else STANDING].values
    score = share * (1 - share)
    friction = friction_maps(maps)
    if friction:  # where all headings are alike, by the coefficient
        best, worst = (band.values for band in friction)
        score = score + 1e-3 * np.clip(np.nan_to_num(worst - best), 0, 1)
    blurred = scipy.ndimage.uniform_filter(score, max(1, DETAIL // step), mode="constant")
    middle = np.unravel_index(blurred.argmax(), blurred.shape)
    window = []
    for k, size in zip(middle, sizes, strict=True):
        start = int(np.clip(int(k) * step - DETAIL // 2, 0, max(0, size - DETAIL)))
        window.append(slice(start, min(start + DETAIL, size)))
    return window[0], window[1]


def _facts(
    maps: Mapping[str, Band], counts: Array, reasons: tuple[str, ...], nodes: Array, wide: int
) -> dict[str, Fact]:
    poses = float(counts.sum())
    words = ("all headings are allowed", "some are", "none is")
    facts = {"allowed_share": Fact(counts[0] / poses, "1", "share of the poses that are allowed")}
    for name, count, meaning in zip(("all", "some", "no"), nodes, words, strict=True):
        share = float(count / nodes.sum())
        facts[f"{name}_headings_share"] = Fact(share, "1", f"share of the nodes where {meaning}")
    friction = friction_maps(maps)
    for label, values in friction:
        known = values[np.isfinite(values)]
        if known.size:
            facts[f"{label.name}_median"] = Fact(float(np.median(known)), "1", label.words)
    if friction:
        meaning = f"poses whose bounds of the least friction differ by more than {WIDE:g}"
        facts["loose_bounds_share"] = Fact(wide / poses, "1", f"share of the {meaning}")
    rows = [
        {"reason": text, "share": float(count / poses)}
        for text, count in zip(reasons, counts, strict=True)
        if count and text != reasons[0]
    ]
    facts["reasons"] = Fact(sorted(rows, key=lambda row: -float(row["share"])))
    return facts


def summary_lines(facts: Mapping[str, Fact]) -> Lines:
    """Return the summary of a mobility map, pairs of name and text, which show its facts."""
    shares = {
        name: f"{100 * float(fact.value):.3g} %"
        for name, fact in facts.items()
        if name.endswith("share")
    }
    lines = [
        ("allowed poses", shares["allowed_share"]),
        (
            "allowed headings",
            f"all at {shares['all_headings_share']} of the nodes, some at "
            f"{shares['some_headings_share']}, none at {shares['no_headings_share']}",
        ),
    ]
    for name in (name for name in facts if name.endswith("_median")):
        words = name.removesuffix("_high_median").replace("_", " ")
        lines.append((words, f"{facts[name].value:.3g} (median of the nodes)"))
    if "loose_bounds_share" in facts:
        share = shares["loose_bounds_share"]
        lines.append(("bounds of friction", f"wider than {WIDE:g} at {share} of the poses"))
    for row in facts["reasons"].value:
        lines.append(("  not allowed", f"{100 * row['share']:.3g} %: {row['reason']}"))
    return lines
