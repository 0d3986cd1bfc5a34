"""Ground of a problem, from its table [terrain]."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from slipfree.core.errors import DataError, ModelError
from slipfree.files.cf import DEGREES, MapCoordinate
from slipfree.files.maps.elevation import Frame, Map, jacksboro, read_map, takes_key
from slipfree.files.toml.source import Place, ProblemError
from slipfree.problem import schema
from slipfree.problem.problem import A, Problem, S
from slipfree.problem.sharing import shared
from slipfree.problem.summary import Lines
from slipfree.terrain.base import Grid, check_friction
from slipfree.terrain.grid_ops import MAX_NODES, cut, disturbed, scaled, smoothed
from slipfree.terrain.rolled import NODES, Rolled, rolled
from slipfree.terrain.synthetic import Rock, blank, place_rocks

OF_FILES = ("cell", "registration", "spacing", "geographic", "fill")  # keys of map files only
LATER = {"smooth", "error", "rolled", "friction", "obstacles"}  # keys that do not affect the map
EARTH = -12000.0, 9000.0  # heights between the deepest ocean and the highest mountain [m]


class Ground(NamedTuple):
    """Ground of a problem with its friction, and facts about them.

    Attributes
    ----------
    grid : Grid
        Heights of the ground under the wheels, after all changes. [m]
    source : str
        Description of the origin of the heights: file name, synthetic or sample.
    rolled : Rolled or None
        Ground changed by the key ``rolled``, and the change of heights; None without this key.
    mu : float, Grid or None
        Coefficient of friction, or a map of it. [1]
    friction : str
        Description of the friction; empty without friction.
    facts : list of (str, str)
        Facts about map file, changes and map coordinates: pairs of name and description.
    coordinates : tuple of MapCoordinate
        Coordinates of the map file as functions of those of motions; empty if they are equal.
    """

    grid: Grid
    source: str
    rolled: Rolled | None
    mu: float | Grid | None
    friction: str
    facts: Lines
    coordinates: tuple[MapCoordinate, ...]


@contextmanager
def at(problem: Problem[A], place: Place) -> Iterator[None]:
    """Raise ModelError and DataError of the block as ProblemError, with file and line of a key.

    ``place`` is the path of the key, such as ``("terrain", "file")``.
    """
    try:
        yield
    except (ModelError, DataError) as error:
        if isinstance(error, ProblemError):
            raise
        words = str(error)
        for name in (place[0], place[-1]):  # the line of the key contains them
            words = words.removeprefix(f"{name}: ")
        raise ProblemError(f"{problem.source.where(place)}: {words}") from error


def build_ground(problem: Problem[S]) -> Ground:
    """Return the ground of a problem.

    The order of operations is: read the file inside the window, fill holes, convert degrees to
    metres, scale, cut to the window (if there is no file), smooth, add the random elevation error
    (``error``), and fill the hollows that a wheel cannot touch (``rolled``).

    Raises
    ------
    ProblemError
        If a file cannot be read, its heights cannot be metres and ``vertical_scale`` is missing,
        the ground is too large, or a key of the table is not valid or does not apply.
    """
    spec = problem.spec.terrain
    _check_keys(problem)
    horizontal, vertical = _scales(spec)
    found, source = _source(problem)
    grid = scaled(found.grid, horizontal, vertical)
    if spec.window is not None and spec.file is None:
        with at(problem, ("terrain", "window")):
            grid = cut(grid, spec.window)
    grid, changes = _changed(problem, grid)
    coordinates = _map_coordinates(found, horizontal, vertical)
    facts = [*found.facts, *changes, *_map_facts(found.crs, coordinates)]
    mu, friction = _friction(problem, found)
    if spec.rolled is None:
        return Ground(grid, source + _scale_words(spec), None, mu, friction, facts, coordinates)
    with at(problem, ("terrain", "rolled")):
        remedy = "cut the ground to a window, or increase the radius 'rolled'"
        _check_size(np.ptp(grid.x), np.ptp(grid.y), spec.rolled / NODES, remedy)
        changed = rolled(grid, spec.rolled)
    return Ground(
        changed.grid, source + _scale_words(spec), changed, mu, friction, facts, coordinates
    )


def _check_keys(problem: Problem[S]) -> None:
    """Raise ProblemError for keys that apply only to map files, if there is no map file."""
    spec = problem.spec.terrain
    for key in OF_FILES:
        read = spec.file is not None or isinstance(spec.friction, str)
        if not read and getattr(spec, key) is not None:
            where = problem.source.where(("terrain", key))
            raise ProblemError(
                f"{where}: expected this key only with a map file, found no map file; remove the "
                "key, or give a file in [terrain]"
            )


def _scales(spec: schema.Terrain) -> tuple[float, float]:
    """Return the scale factor of x and y, and that of heights [1]."""
    return spec.scale * spec.horizontal_scale, spec.scale * spec.vertical_scale


def _scale_words(spec: schema.Terrain) -> str:
    horizontal, vertical = _scales(spec)
    if horizontal == vertical:
        return f" scaled by {horizontal:g}" if horizontal != 1 else ""
    return f" scaled by {horizontal:g} in x and y, by {vertical:g} in height"


def _changed(problem: Problem[S], grid: Grid) -> tuple[Grid, Lines]:
    """Return the ground after optional smoothing and elevation error, and facts about them."""
    spec, facts = problem.spec.terrain, []
    if spec.smooth is not None:
        with at(problem, ("terrain", "smooth")):
            smooth = smoothed(grid, spec.smooth)
        grid = smooth.grid
        change = f"at most {smooth.largest:.3g} m, rms {smooth.rms:.3g} m"
        facts.append(("ground changed by smooth", f"{change} (Gaussian of {spec.smooth:g} m)"))
    if (error := spec.error) is not None:
        before = grid.z
        with at(problem, ("terrain", "error")):
            grid = disturbed(grid, error.rms, error.correlation, error.seed)
        rms = float(np.sqrt(np.mean((grid.z - before) ** 2)))
        facts.append(
            (
                "ground error added",
                f"random heights, rms {error.rms:g} m (on this ground {rms:.3g} m), correlated "
                f"over {error.correlation:g} m, seed {error.seed}",
            )
        )
    return grid, facts


def _map_coordinates(found: Map, horizontal: float, vertical: float) -> tuple[MapCoordinate, ...]:
    """Return x, y and z of a map file as functions of those of motions; empty if all are equal."""
    x0, kx, y0, ky = found.frame
    if found.frame == Frame() and (horizontal, vertical) == (1, 1):
        return ()
    x, y = ("longitude", "latitude") if found.geographic else ("x", "y")
    return (
        MapCoordinate(x, x0, kx / horizontal, "x"),
        MapCoordinate(y, y0, ky / horizontal, "y"),
        MapCoordinate("z", 0.0, 1 / vertical, "z"),
    )


def _map_facts(crs: str, coordinates: Iterable[MapCoordinate]) -> Lines:
    """Return facts about a map file: its reference system, and formulas of its coordinates."""
    facts = [("map crs", crs)] if crs else []
    formulas = [
        f"{name if name in DEGREES else f'{name}_file'} = "
        f"{f'{offset:.9g} + ' if offset else ''}{'' if factor == 1 else f'{factor:.9g} '}{axis}"
        for name, offset, factor, axis in coordinates
    ]
    if formulas:
        words = f"{', '.join(formulas)}; x, y, z are those of results, in metres"
        facts.append(("coordinates in the map file", words))
    return facts


def _check_size(width: float, length: float, spacing: float, remedy: str) -> None:
    nodes = width / spacing * length / spacing
    if nodes > MAX_NODES:
        raise ModelError(
            f"expected a ground of at most {MAX_NODES:g} nodes, found {nodes:.2g} at a spacing "
            f"of {spacing:g} m; {remedy}"
        )


def read_source(problem: Problem[Any]) -> tuple[Map, tuple[MapCoordinate, ...]]:
    """Return the map of a problem before scaling, and the coordinates of its file.

    Returns
    -------
    found : Map
        Ground before scaling.
    coordinates : tuple of MapCoordinate
        As in `Ground`.

    Raises
    ------
    ProblemError
        If the map cannot be read, or if its heights cannot be metres and ``vertical_scale`` is
        missing.
    """
    found, _ = _source(problem)
    return found, _map_coordinates(found, *_scales(problem.spec.terrain))


def _source(problem: Problem[S]) -> tuple[Map, str]:
    """Return the ground before scaling, and the description of its origin.

    Consecutive runs of a sweep share it, unless a key changes on which it depends.
    """
    key = problem.spec.terrain.model_dump_json(
        exclude=LATER, exclude_unset=True, serialize_as_any=True
    )
    return shared("map", (problem.folder, key), lambda: _read(problem))


def _read(problem: Problem[S]) -> tuple[Map, str]:
    spec = problem.spec.terrain
    if spec.file is not None:
        window, (horizontal, _) = spec.window, _scales(spec)
        if window is not None and spec.geographic is None:
            a, b, c, d = (each / horizontal for each in window)
            window = a, b, c, d
        options: dict[str, Any] = {key: getattr(spec, key) for key in OF_FILES}
        if "vertical_scale" in spec.model_fields_set:
            options["vertical_scale"] = spec.vertical_scale
        with at(problem, ("terrain", "file")):
            found = read_map(problem.folder / spec.file, window=window, **options)
            if "vertical_scale" not in spec.model_fields_set:
                _check_heights(found, spec.scale)
        return found, spec.file
    if spec.synthetic is not None:
        with at(problem, ("terrain", "synthetic")):
            return Map(_synthetic(spec.synthetic)), "synthetic"
    with at(problem, ("terrain", "sample")):
        return Map(jacksboro()), "Jacksboro fault (sample of matplotlib)"


def _check_heights(found: Map, scale: float) -> None:
    """Raise ModelError if heights are gray levels, or exceed those on the earth in metres."""
    low, high = found.grid.values.min(), found.grid.values.max()
    if found.gray:
        raise ModelError(
            "expected vertical_scale, the metres per gray level of a picture, found none; "
            "set it to the difference between the highest and the lowest height in metres divided "
            f"by {high - low:g} (the levels extend from {low:g} to {high:g}), or to 1 if the "
            "levels are metres"
        )
    if not EARTH[0] <= scale * low <= scale * high <= EARTH[1]:
        raise ModelError(
            f"expected heights from {EARTH[0]:g} to {EARTH[1]:g} m, as on the earth, found "
            f"{scale * low:g} to {scale * high:g} m; set vertical_scale, the metres per unit of "
            "the heights (0.01 for centimetres, 0.1 for decimetres, 1 if they are metres)"
        )


def _friction(problem: Problem[S], ground: Map) -> tuple[float | Grid | None, str]:
    """Return the coefficient of friction, a number or a map, and its description."""
    spec = problem.spec.terrain
    name, (horizontal, _) = spec.friction, _scales(spec)
    if not isinstance(name, str):
        return name, "" if name is None else f"{name:g}"
    ending = Path(name).suffix.lower()
    options: dict[str, Any] = {
        key: getattr(spec, key) for key in OF_FILES if takes_key(ending, key)
    }
    if ground.geographic:
        options["geographic"] = ground.frame
    with at(problem, ("terrain", "friction")):
        found = read_map(problem.folder / name, **options)
        check_friction(found.grid)  # before scaling: the message has coordinates of the file
    # both files describe the same area, so that both are scaled; coefficients are not
    mu = scaled(found.grid, horizontal, 1.0)
    details = "".join(
        f"; {key.removeprefix('ground ')} {words}"
        for key, words in found.facts
        if not key.startswith("ground map")
    )
    return mu, f"{name}, {mu.z.min():g} to {mu.z.max():g}{details}"


def _synthetic(spec: schema.Synthetic) -> Grid:
    remedy = "increase 'spacing', or reduce the extent in 'x' and 'y'"
    _check_size(spec.x[1] - spec.x[0], spec.y[1] - spec.y[0], spec.spacing, remedy)
    grid = blank(spec.x, spec.y, spec.spacing)
    grid = Grid(grid.x, grid.y, grid.z + spec.base)
    for feature in spec.features():
        grid = feature.added(grid)
    return place_rocks(grid, map(Rock._make, spec.placed_rocks))


def ground_facts(ground: Ground) -> Lines:
    """Return facts about a ground, pairs of name and text: origin, size, heights and friction."""
    grid = ground.grid
    (n_x, n_y), (h_x, h_y) = grid.z.shape, grid.spacing
    facts = [
        ("ground", ground.source),
        *ground.facts,
        ("ground size", f"{np.ptp(grid.x):g} x {np.ptp(grid.y):g} m, {n_x} x {n_y} nodes"),
        ("ground cell", f"{h_x:.4g} x {h_y:.4g} m"),
        ("ground height", f"{grid.values.min():.3f} to {grid.values.max():.3f} m"),
    ]
    if ground.friction:
        facts.append(("ground friction", ground.friction))
    if ground.rolled is not None:
        change = f"at most {ground.rolled.largest:.3g} m, rms {ground.rolled.rms:.3g} m"
        facts.append(("ground changed by rolled", change))
    return facts
