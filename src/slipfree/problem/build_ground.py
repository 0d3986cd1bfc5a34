"""Ground of a problem: map or synthetic heights, friction, geographic places and obstacles."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from math import degrees, isfinite
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from slipfree.core.errors import DataError, ModelError
from slipfree.core.facts import Lines
from slipfree.core.lookups import library
from slipfree.files.maps import elevation
from slipfree.files.maps.raster import RasterParts, Reading, raster_parts
from slipfree.files.maps.reference_systems import from_degrees
from slipfree.files.netcdf import DEGREES, MapCoordinate
from slipfree.files.toml import AngleWithUnit, Fault, ProblemError
from slipfree.files.toml import Place as KeyPath
from slipfree.problem import schema
from slipfree.problem.problem import A, Problem, S, shared
from slipfree.problem.schema import TerrainKeys
from slipfree.terrain.base import MAX_HEIGHT, Grid, check_friction
from slipfree.terrain.bicubic import Outline, outline, parts_of
from slipfree.terrain.grid_ops import MAX_NODES, Changed, Window, cut, disturbed, smoothed
from slipfree.terrain.rolled import NODES, rolled
from slipfree.terrain.synthetic import FEATURES, Rock, blank, place_rocks

OF_FILES = ("cell", "registration", "spacing", "geographic", "fill")  # keys of map files only
LATER = {"smooth", "error", "rolled", "friction", "obstacles"}  # keys that do not affect the map
OF_WHOLE_MAPS = "geographic", "fill", "smooth", "error", "rolled"  # keys that need the whole map
LARGE = 2**22  # nodes of a map above which an atlas reads it by windows
EARTH = -12000.0, 9000.0  # heights between the deepest ocean and the highest mountain [m]


class GroundMap(NamedTuple):
    """Ground of a problem with its friction, and facts about them."""

    grid: Grid  # heights under the wheels, after all changes [m]
    source: str  # origin of the heights: file name, synthetic or sample
    rolled: Changed | None  # change by the key rolled
    mu: float | Grid | None  # coefficient of friction, or a map of it [1]
    friction: str  # its description; empty without friction
    facts: Lines  # about map file, changes and map coordinates
    coordinates: tuple[MapCoordinate, ...]  # of the file, if they differ from those of motions
    crs: str = ""  # reference system of the map file; empty if unknown


@contextmanager
def at(problem: Problem[A], place: KeyPath) -> Iterator[None]:
    """Raise ModelError and DataError of the block as ProblemError, with file and line of a key."""
    try:
        yield
    except (ModelError, DataError) as error:
        if isinstance(error, ProblemError):
            raise
        words = str(error)
        for name in (place[0], place[-1]):  # the line of the key contains them
            words = words.removeprefix(f"{name}: ")
        raise ProblemError(f"{problem.source.where(place)}: {words}") from error


def build_ground(problem: Problem[S]) -> GroundMap:
    """Return the ground of a problem.

    The order of operations is: read the file inside the window, fill holes, convert degrees to
    metres, scale, cut to the window (if there is no file), smooth, add the random elevation error
    (``error``), and fill the hollows that a wheel cannot touch (``rolled``).

    With `Problem.extremes`, GeoTIFFs with more than `LARGE` nodes are read by windows (`Outline`),
    unless a key changes the whole map. Extremes of further files are added, for which the whole
    file is read once.

    The ground of a result is that in its file, unless its table is changed.
    """
    spec = problem.spec.terrain
    if kept := problem.grounds.get(ground_table(spec)):
        given, stored = kept[0], cast("GroundMap", kept[1])
        if spec.friction == given:
            return stored
        if not isinstance(spec.friction, str):
            mu, friction = _friction(problem, elevation.Map(stored.grid))
            return stored._replace(mu=mu, friction=friction)
    for key in OF_FILES:
        read = spec.file is not None or isinstance(spec.friction, str)
        if not read and getattr(spec, key) is not None:
            found = "no map file; remove the key, or give a file in [terrain]"
            problem.refuse(Fault(("terrain", key), "this key only with a map file", found))
    horizontal, vertical = _scales(spec)
    ground_map, source = _source(problem)
    grid = ground_map.grid.scaled(horizontal, vertical)
    if spec.window is not None and spec.file is None:
        with at(problem, ("terrain", "window")):
            grid = cut(grid, spec.window)
    facts = [*ground_map.facts]
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
        words = f"random heights, rms {error.rms:g} m (on this ground {rms:.3g} m), correlated "
        words += f"over {error.correlation:g} m, seed {error.seed}"
        facts.append(("ground error added", words))
    coordinates = _map_coordinates(ground_map, horizontal, vertical)
    facts += [("map crs", ground_map.crs)] if ground_map.crs else []
    formulas = [
        f"{name if name in DEGREES else f'{name}_file'} = "
        f"{f'{offset:.9g} + ' if offset else ''}{'' if factor == 1 else f'{factor:.9g} '}{axis}"
        for name, offset, factor, axis in coordinates
    ]
    if formulas:
        words = f"{', '.join(formulas)}; x, y, z are those of results, in metres"
        facts.append(("file coordinates", words))
    mu, friction = _friction(problem, ground_map)
    changed = None
    if spec.rolled is not None:
        with at(problem, ("terrain", "rolled")):
            remedy = "cut the ground to a window, or increase the radius 'rolled'"
            _check_size(np.ptp(grid.x), np.ptp(grid.y), spec.rolled / NODES, remedy)
            changed = rolled(grid, spec.rolled)
            grid = changed.grid
    if horizontal != vertical:
        source += f" scaled by {horizontal:g} in x and y, by {vertical:g} in height"
    elif horizontal != 1:
        source += f" scaled by {horizontal:g}"
    return GroundMap(grid, source, changed, mu, friction, facts, coordinates, ground_map.crs)


def ground_table(spec: schema.TerrainTable) -> str:
    """Return the keys of a ground on which its heights depend, as JSON."""
    own = {"friction", "obstacles"}
    return spec.model_dump_json(exclude=own, exclude_unset=True, serialize_as_any=True)


class Extremes(NamedTuple):
    """Smallest and largest value of a map file, and its number of nodes without a value."""

    low: float
    high: float
    missing: int


def _map_of(
    problem: Problem[Any], name: str, window: Window | None, options: dict[str, Any]
) -> elevation.Map:
    """Return the map in a file; for a large GeoTIFF, only its outline.

    ``options`` are the keys of the table by which the file is read.
    """
    spec, path = problem.spec.terrain, problem.folder / name
    is_whole = any(getattr(spec, key) is not None for key in OF_WHOLE_MAPS)
    is_geotiff = path.suffix.lower() in (".tif", ".tiff")
    is_geotiff &= os.path.isfile(path)  # noqa: PTH113 - False for names that are too long, too
    known = problem.extremes
    if known is not None and is_geotiff and not is_whole and library() is not None:
        metres = options.get("vertical_scale")
        raster = raster_parts(path, Reading(window, spec.cell, spec.registration, None, metres))
        x, y = raster.nodes
        if x.size * y.size > LARGE:
            return _outline(raster, known)
    return elevation.read_map(path, window=window, **options)


def _outline(raster: RasterParts, known: dict[str, Extremes]) -> elevation.Map:
    """Return the outline of a raster, which is read once if its extremes are not known."""
    x, y = raster.nodes
    name = str(raster.path)
    if name not in known:
        extremes = Extremes(np.inf, -np.inf, 0)
        for part in parts_of(x.size, y.size):
            heights = raster.heights(*part)
            elevation.check_degrees(heights, local=False)
            z = heights.z[~np.isnan(heights.z)]
            low, high = float(z.min(initial=extremes.low)), float(z.max(initial=extremes.high))
            extremes = Extremes(low, high, extremes.missing + heights.z.size - z.size)
        known[name] = extremes
    low, high, missing = known[name]
    if not -MAX_HEIGHT <= low <= high <= MAX_HEIGHT:
        words = f"values from {low:g} to {high:g}" if low <= high else "none at any node"
        raise DataError(
            f"{name}: expected heights from -{MAX_HEIGHT:g} to {MAX_HEIGHT:g}, found {words}; use "
            "another map or window"
        )
    middle = (slice(axis.size // 2 - 2, axis.size // 2 + 2) for axis in (x, y))
    about = raster.heights(*middle)
    facts = about.facts
    if missing:
        facts += (("ground holes", elevation.hole_words(missing, x.size * y.size)),)
    grid = outline((x, y), lambda i, j: raster.heights(i, j).z, (low, high), missing)
    return elevation.Map(grid, crs=about.crs, facts=facts, gray=about.gray)


def _scales(spec: schema.TerrainTable) -> tuple[float, float]:
    return spec.scale * spec.horizontal_scale, spec.scale * spec.vertical_scale


def _map_coordinates(
    ground_map: elevation.Map, horizontal: float, vertical: float
) -> tuple[MapCoordinate, ...]:
    """Return x, y and z of a map file as functions of those of motions; empty if all are equal."""
    x0, kx, y0, ky = ground_map.frame
    if ground_map.frame == elevation.Frame() and (horizontal, vertical) == (1, 1):
        return ()
    x, y = ("longitude", "latitude") if ground_map.geographic else ("x", "y")
    return (
        MapCoordinate(x, x0, kx / horizontal, "x"),
        MapCoordinate(y, y0, ky / horizontal, "y"),
        MapCoordinate("z", 0.0, 1 / vertical, "z"),
    )


def _check_size(width: float, length: float, spacing: float, remedy: str) -> None:
    """Raise ModelError for a ground of too many nodes; sizes are in metres."""
    nodes = width / spacing * length / spacing
    if nodes > MAX_NODES:
        raise ModelError(
            f"expected a ground of at most {MAX_NODES:g} nodes, found {nodes:.2g} at a spacing "
            f"of {spacing:g} m; {remedy}"
        )


def _source(problem: Problem[S]) -> tuple[elevation.Map, str]:
    """Return the ground before scaling, and the description of its origin.

    Consecutive runs of a sweep share it, unless a key changes on which it depends.
    """
    spec = problem.spec.terrain
    key = spec.model_dump_json(exclude=LATER, exclude_unset=True, serialize_as_any=True)
    whole = problem.folder, key, problem.extremes is None

    def read() -> tuple[elevation.Map, str]:
        """Return the map of a file, a synthetic ground or the sample, and its name."""
        if spec.file is not None:
            options: dict[str, Any] = {key: getattr(spec, key) for key in OF_FILES}
            if "vertical_scale" in spec.model_fields_set:
                options["vertical_scale"] = spec.vertical_scale
            window = spec.window
            if window is not None and spec.geographic is None:  # in coordinates of the file
                a, b, c, d = (each / _scales(spec)[0] for each in window)
                window = a, b, c, d
            with at(problem, ("terrain", "file")):
                ground_map = _map_of(problem, spec.file, window, options)
                if "vertical_scale" not in spec.model_fields_set:
                    _check_heights(ground_map, spec.scale)
            return ground_map, spec.file
        if spec.synthetic is not None:
            with at(problem, ("terrain", "synthetic")):
                made = spec.synthetic
                remedy = "increase 'spacing', or reduce the extent in 'x' and 'y'"
                _check_size(made.x[1] - made.x[0], made.y[1] - made.y[0], made.spacing, remedy)
                grid = blank(made.x, made.y, made.spacing)
                grid = Grid(grid.x, grid.y, grid.z + made.base)
                for name, add in FEATURES.items():
                    if (table := getattr(made, name)) is not None:
                        grid = add(grid, **dict(table))
                grid = place_rocks(grid, map(Rock._make, made.placed_rocks))
            return elevation.Map(grid), "synthetic"
        with at(problem, ("terrain", "sample")):
            return elevation.Map(elevation.jacksboro()), "Jacksboro fault (sample of matplotlib)"

    return shared("map", whole, read)


def _check_heights(ground_map: elevation.Map, scale: float) -> None:
    """Raise ModelError if heights are gray levels, or exceed those on the earth in metres."""
    low, high = ground_map.grid.values.min(), ground_map.grid.values.max()
    if ground_map.gray:
        raise ModelError(
            "expected terrain.vertical_scale, the metres per gray level of a picture, found none; "
            "set it to the difference between the highest and the lowest height in metres divided "
            f"by {high - low:g} (the levels extend from {low:g} to {high:g}), or to 1 if the "
            "levels are metres"
        )
    if not EARTH[0] <= scale * low <= scale * high <= EARTH[1]:
        raise ModelError(
            f"expected heights from {EARTH[0]:g} to {EARTH[1]:g} m, as on the earth, found "
            f"{scale * low:g} to {scale * high:g} m; set the metres per unit of the heights, as in "
            "--set terrain.vertical_scale=0.01 for centimetres (0.1: decimetres, 1: metres)"
        )


def _friction(problem: Problem[S], ground: elevation.Map) -> tuple[float | Grid | None, str]:
    """Return the coefficient of friction, a number or a map, and its description."""
    spec = problem.spec.terrain
    name, (horizontal, _) = spec.friction, _scales(spec)
    if not isinstance(name, str):
        return name, "" if name is None else f"{name:g}"
    ending = Path(name).suffix.lower()
    options: dict[str, Any] = {
        key: getattr(spec, key) for key in OF_FILES if elevation.takes_key(ending, key)
    }
    if ground.geographic:
        options["geographic"] = ground.frame
    with at(problem, ("terrain", "friction")):
        friction_map = _map_of(problem, name, None, options)
        grid = friction_map.grid
        if isinstance(grid, Outline) and (grid.missing or grid.extremes[0] <= 0):
            raise DataError(
                f"friction: expected positive coefficients at all nodes, found a "
                f"smallest one of {grid.extremes[0]:g}, and {grid.missing} nodes without a value; "
                "correct the map"
            )
        check_friction(grid)  # before scaling: the message has coordinates of the file
    # both files describe the same area, so that both are scaled; coefficients are not
    mu = grid.scaled(horizontal, 1.0)
    details = "".join(
        f"; {key.removeprefix('ground ')} {words}"
        for key, words in friction_map.facts
        if not key.startswith("ground map")
    )
    return mu, f"{name}, {mu.values.min():g} to {mu.values.max():g}{details}"


def ground_facts(ground: GroundMap) -> Lines:
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


def convert_places(problem: Problem[A]) -> Problem[A]:
    """Return a problem with x and y instead of longitude and latitude in all places.

    The reference system is that of the map, whose file is read only if a place is in degrees.
    ProblemError is raised for places that cannot be converted.
    """
    spec = problem.spec
    if not isinstance(spec, TerrainKeys):
        return problem
    terrain, on_map = spec.terrain, cast("Problem[Any]", problem)

    @cache
    def reference_system() -> tuple[str, tuple[MapCoordinate, ...]]:
        if kept := problem.grounds.get(ground_table(terrain)):
            return kept[1].crs, kept[1].coordinates
        ground, _ = _source(on_map)
        return ground.crs, _map_coordinates(ground, *_scales(terrain))

    def converted(keys: KeyPath, place: Any) -> Any:
        """Return a table with longitude and latitude converted to x and y."""
        values = place if isinstance(place, Mapping) else place.model_dump(exclude_none=True)
        if not any(name in values for name in DEGREES):
            return place
        system = reference_system()
        with at(problem, keys):
            metres = _in_metres(values, *system)
            return metres if isinstance(place, Mapping) else type(place)(**metres)

    changes = dict[str, Any]()
    for name in ("start", "goal", "way_points", "keep_out"):
        before: Any = getattr(spec, name, None)
        after = before
        if isinstance(before, tuple):
            after = tuple(converted((name, k), each) for k, each in enumerate(before))
        elif before is not None:
            after = converted((name,), before)
        if after != before:
            changes[name] = after
    return replace(problem, spec=spec.model_copy(update=changes)) if changes else problem


def _in_metres(
    values: Mapping[str, Any], crs: str, coordinates: tuple[MapCoordinate, ...]
) -> dict[str, Any]:
    """Return values in map coordinates instead of longitude and latitude; others are kept."""
    if {"x", "y"} & {*values} or not {*DEGREES} <= {*values}:
        found = ", ".join(name for name in ("x", "y", *DEGREES) if name in values)
        raise ModelError(
            f"expected either longitude and latitude, or x and y, found {found}; give one of these "
            "pairs"
        )
    is_range = isinstance(values["longitude"], tuple)
    place = [_degrees(values[name], name) for name in DEGREES]
    if crs:
        x, y = from_degrees(crs, *place)
    elif any(each.name in DEGREES for each in coordinates):
        x, y = place  # those of the file
    else:
        raise ModelError(
            "expected a map with a reference system for longitude and latitude, found none; give "
            "x and y, or write the system into the map file: gdal_edit.py -a_srs EPSG:326xx in.tif "
            "(xx: the UTM zone; EPSG:327xx south of the equator)"
        )
    if not (isfinite(x) and isfinite(y)):
        raise ModelError(
            f"expected a place in the domain of the map's projection ({crs}), found "
            f"longitude {place[0]:.9g}, latitude {place[1]:.9g}; correct them"
        )
    for each in coordinates:
        x = (x - each.offset) / each.factor if each.axis == "x" else x
        y = (y - each.offset) / each.factor if each.axis == "y" else y
    others = {name: value for name, value in values.items() if name not in DEGREES}
    return {"x": (x, x), "y": (y, y), **others} if is_range else {"x": x, "y": y, **others}


def _degrees(value: float | tuple[float, float], name: str) -> float:
    """Return a longitude or latitude in degrees, from a number or a range with equal ends."""
    low, high = value if isinstance(value, tuple) else (value, value)
    number, last = (degrees(v) if isinstance(v, AngleWithUnit) else v for v in (low, high))
    bound = 90 if name == "latitude" else 360
    if low != high:
        raise ModelError(
            f"{name}: expected one number, found the range {number:.9g} to {last:.9g} degrees; "
            "give one number"
        )
    if abs(number) > bound:
        raise ModelError(
            f"{name}: expected a number from {-bound} to {bound} degrees, found {number:.9g}; "
            "correct it"
        )
    return float(number)
