"""From the [terrain] table of a problem to a ground."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np

from slipfree.errors import DataError, ModelError
from slipfree.problem import schema
from slipfree.problem.locate import Place, ProblemError
from slipfree.problem.read import A, Problem, S
from slipfree.problem.summary import Facts
from slipfree.terrain.base import Grid
from slipfree.terrain.dem import jacksboro, read_grid
from slipfree.terrain.friction import check_friction
from slipfree.terrain.rolled import NODES, Rolled, rolled
from slipfree.terrain.synthetic import Rock, blank, craters, place_rocks, power_law, ramp, rocks

MOST_NODES = 5e7  # of a ground made or refined here: 400 MB an array


class Ground(NamedTuple):
    """The ground of a problem.

    Attributes
    ----------
    grid : Grid
        As the wheels meet it.
    source : str
        Where it comes from, in words.
    rolled : Rolled or None
        What was changed for the wheels, if that was asked for.
    mu : float, Grid or None
        Coefficient of friction, or a map of it. [1]
    friction : str
        The same in words; empty if there is none.
    """

    grid: Grid
    source: str
    rolled: Rolled | None
    mu: float | Grid | None
    friction: str


@contextmanager
def at(problem: Problem[A], place: Place) -> Iterator[None]:
    """Say which line of the problem an error of the library concerns."""
    try:
        yield
    except (ModelError, DataError) as error:
        if isinstance(error, ProblemError):
            raise
        raise ProblemError(f"{problem.source.where(place)}: {error}") from error


def build_ground(problem: Problem[S]) -> Ground:
    """Return the ground that a problem asks for."""
    spec = problem.spec.terrain
    grid, source = _source(problem)
    if spec.scale != 1 and spec.sample is None:
        grid = Grid(spec.scale * grid.x, spec.scale * grid.y, spec.scale * grid.z)
    source += f" scaled by {spec.scale:g}" if spec.scale != 1 else ""
    if spec.window is not None:
        with at(problem, ("terrain", "window")):
            grid = _cut(grid, spec.window)
    mu, friction = _friction(problem)
    if spec.rolled is None:
        return Ground(grid, source, None, mu, friction)
    with at(problem, ("terrain", "rolled")):
        _check_size(np.ptp(grid.x), np.ptp(grid.y), spec.rolled / NODES)
        felt = rolled(grid, spec.rolled)
    return Ground(felt.grid, source, felt, mu, friction)


def _cut(grid: Grid, window: tuple[float, float, float, float]) -> Grid:
    """Return the part of a grid whose nodes lie in a window."""
    columns = (grid.x >= window[0]) & (grid.x <= window[1])
    rows = (grid.y >= window[2]) & (grid.y <= window[3])
    return Grid(grid.x[columns], grid.y[rows], np.ascontiguousarray(grid.z[columns][:, rows]))


def _check_size(width: float, length: float, spacing: float) -> None:
    nodes = width / spacing * length / spacing
    if nodes > MOST_NODES:
        raise ModelError(
            f"expected a ground of at most {MOST_NODES:g} nodes, found {nodes:.2g} at a spacing "
            f"of {spacing:g} m; cut the ground to a window or choose a larger spacing or radius"
        )


def _source(problem: Problem[S]) -> tuple[Grid, str]:
    """Return the ground and what to call it."""
    spec = problem.spec.terrain
    if spec.file is not None:
        with at(problem, ("terrain", "file")):
            return read_grid(problem.folder / spec.file), spec.file
    if spec.synthetic is not None:
        with at(problem, ("terrain", "synthetic")):
            return _synthetic(spec.synthetic), "synthetic"
    with at(problem, ("terrain", "sample")):
        return jacksboro(spec.scale), "Jacksboro fault (sample of matplotlib)"


def _friction(problem: Problem[S]) -> tuple[float | Grid | None, str]:
    """Return the friction of the ground, and what to tell about it."""
    name, scale = problem.spec.terrain.friction, problem.spec.terrain.scale
    if not isinstance(name, str):
        return name, "" if name is None else f"{name:g}"
    with at(problem, ("terrain", "friction")):
        grid = read_grid(problem.folder / name)
        check_friction(grid)  # before it is scaled: the message gives places of the file
    # Both files describe one place, so that both are scaled; coefficients have no length.
    scaled = Grid(scale * grid.x, scale * grid.y, grid.z)
    return scaled, f"{name}, {grid.z.min():g} to {grid.z.max():g}"


def _synthetic(spec: schema.Synthetic) -> Grid:
    _check_size(spec.x[1] - spec.x[0], spec.y[1] - spec.y[0], spec.spacing)
    grid = blank(spec.x, spec.y, spec.spacing)
    grid = Grid(grid.x, grid.y, grid.z + spec.base)
    for rule, values in (
        (ramp, spec.ramp),
        (power_law, spec.power_law),
        (craters, spec.craters),
        (rocks, spec.rocks),
    ):
        if values is not None:
            grid = rule(grid, **dict(values))
    return place_rocks(grid, map(Rock._make, spec.placed_rocks))


def ground_facts(ground: Ground) -> Facts:
    """Return what to tell about a ground."""
    grid = ground.grid
    (n_x, n_y), (h_x, h_y) = grid.z.shape, grid.spacing
    facts = [
        ("ground", ground.source),
        ("ground size", f"{np.ptp(grid.x):g} x {np.ptp(grid.y):g} m, {n_x} x {n_y} nodes"),
        ("ground cell", f"{h_x:.4g} x {h_y:.4g} m"),
        ("ground height", f"{grid.z.min():.3f} to {grid.z.max():.3f} m"),
    ]
    if ground.friction:
        facts.append(("ground friction", ground.friction))
    if ground.rolled is not None:
        change = f"at most {ground.rolled.largest:.3g} m, rms {ground.rolled.rms:.3g} m"
        facts.append(("ground changed by rolled", change))
    return facts
