"""From a validated problem to a motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from slipfree.dae import Dae
from slipfree.errors import DataError, ModelError, SolverError
from slipfree.kinematics.follow import straight
from slipfree.kinematics.rolling import direct_kinematics
from slipfree.named import Array, leaves
from slipfree.problem import schema
from slipfree.problem.locate import Place, ProblemError
from slipfree.problem.read import Fault, Problem, names, problem_error
from slipfree.problem.summary import Facts
from slipfree.solve.settle import settle
from slipfree.solve.simulate import simulate
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.dem import jacksboro, read_grid
from slipfree.terrain.rolled import NODES, Rolled, rolled
from slipfree.terrain.synthetic import Rock, blank, craters, place_rocks, power_law, ramp, rocks
from slipfree.trajectory import Trajectory
from slipfree.vehicle.catalog import three_wheeler
from slipfree.vehicle.chain import Vehicle

CATALOG = {"three_wheeler": three_wheeler}
MOST_NODES = 5e7  # of a ground made or refined here: 400 MB an array
NEAR = 1e-9  # times closer than this part of the duration are one


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
    """

    grid: Grid
    source: str
    rolled: Rolled | None


@dataclass(frozen=True, eq=False)
class Setup:
    """All that a problem needs before it is integrated.

    Attributes
    ----------
    ground, vehicle, dae : Ground, Vehicle, Dae
        The model.
    start : Trajectory
        The vehicle at rest at its start.
    inputs : record
        Rates, or a driving law.
    t : ndarray, shape (n,)
        Times of the samples. [s]
    """

    ground: Ground
    vehicle: Vehicle
    dae: Dae[Any, Any, Any, Any, Any]
    start: Trajectory
    inputs: Any
    t: Array


class Outcome(NamedTuple):
    """What came of a problem: the motion, whole or to where it stopped, and what it ran on."""

    trajectory: Trajectory
    setup: Setup


def build(problem: Problem) -> Setup:
    """Return the model, the settled start and the inputs of a problem.

    Raises
    ------
    ProblemError
        If the ground cannot be read or made, names are unknown, or the vehicle cannot stand at
        the start.
    """
    spec = problem.spec
    ground = _ground(problem)
    with _at(problem, ("vehicle",)):
        given = spec.vehicle.model_dump(exclude_none=True)
        vehicle = CATALOG[given.pop("catalog")](**given)
    center = spec.start.get("x", 0.0), spec.start.get("y", 0.0)
    dae = direct_kinematics(vehicle, Bicubic(ground.grid, center))
    _check_names(problem, dae)
    values: dict[str, Any] = dict(spec.start)
    if spec.frame == "rep103" and "heading" in values:
        values["heading"] -= np.pi / 2  # from the x axis to the y axis
    with _at(problem, ("start",)):
        start = settle(dae, **values)
    t, rates = samples(spec.time, spec.inputs or {})
    if spec.driver is None:
        with _at(problem, ("inputs",)):
            inputs = dae.inputs(**rates)
    else:
        with _at(problem, ("driver",)):
            inputs = straight(dae, vehicle, start, speed=spec.driver.speed)
    return Setup(ground, vehicle, dae, start, inputs, t)


def run(problem: Problem, progress: Callable[[float], None] | None = None) -> Outcome:
    """Return the motion that a problem asks for.

    Parameters
    ----------
    problem : Problem
        From ``read``.
    progress : callable, optional
        Called with the time reached. [s]

    Raises
    ------
    ProblemError
        If the problem cannot be built.
    SolverError
        If the integrator fails before the first sample; later failures are a stop of the
        trajectory.
    """
    setup, spec = build(problem), problem.spec
    with _at(problem, ("start",)):
        try:
            found = simulate(
                setup.dae, setup.start, setup.inputs, setup.t,
                tolerance=spec.solver.tolerance, progress=progress,
            )  # fmt: skip
        except SolverError as error:
            if error.trajectory is None:
                raise
            found = error.trajectory
    return Outcome(replace(found, attributes=_attributes(problem, setup)), setup)


def samples(
    time: schema.Time, inputs: Mapping[str, float | schema.Piecewise]
) -> tuple[Array, dict[str, float | Array]]:
    """Return the times of the samples, jumps of the inputs among them, and rates by interval.

    Returns
    -------
    t : ndarray, shape (n,)
        From zero to the duration. [s]
    rates : dict of str to float or ndarray of shape (n - 1,)
        Constants, and values in every interval of what is piecewise constant. [rad/s]
    """
    near = NEAR * time.duration
    regular = time.step * np.arange(int(time.duration / time.step) + 1)
    jumps = [pair[0] for value in inputs.values() if isinstance(value, tuple) for pair in value]
    t = np.sort(np.concatenate([regular, [time.duration], jumps]))
    t = t[t <= time.duration]
    t = t[np.append(True, np.diff(t) > near)]
    t[-1] = time.duration
    middles = (t[1:] + t[:-1]) / 2

    def by_interval(value: float | schema.Piecewise) -> float | Array:
        if not isinstance(value, tuple):
            return value
        times, rates = (np.array(column) for column in zip(*value, strict=True))
        return np.asarray(rates[np.searchsorted(times, middles, side="right") - 1])

    return t, {name: by_interval(value) for name, value in inputs.items()}


def _ground(problem: Problem) -> Ground:
    spec = problem.spec.terrain
    grid, source = _source(problem)
    if spec.scale != 1 and spec.sample is None:
        grid = Grid(spec.scale * grid.x, spec.scale * grid.y, spec.scale * grid.z)
    source += f" scaled by {spec.scale:g}" if spec.scale != 1 else ""
    if spec.window is not None:
        with _at(problem, ("terrain", "window")):
            grid = _cut(grid, spec.window)
    if spec.rolled is None:
        return Ground(grid, source, None)
    with _at(problem, ("terrain", "rolled")):
        _check_size(np.ptp(grid.x), np.ptp(grid.y), spec.rolled / NODES)
        felt = rolled(grid, spec.rolled)
    return Ground(felt.grid, source, felt)


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


def _source(problem: Problem) -> tuple[Grid, str]:
    """Return the ground and what to call it."""
    spec = problem.spec.terrain
    if spec.file is not None:
        with _at(problem, ("terrain", "file")):
            return read_grid(problem.folder / spec.file), spec.file
    if spec.synthetic is not None:
        with _at(problem, ("terrain", "synthetic")):
            return _synthetic(spec.synthetic), "synthetic"
    with _at(problem, ("terrain", "sample")):
        return jacksboro(spec.scale), "Jacksboro fault (sample of matplotlib)"


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


def _check_names(problem: Problem, dae: Dae[Any, Any, Any, Any, Any]) -> None:
    """Raise for all states and inputs of the problem that the model does not have, or lacks."""
    spec = problem.spec
    faults = [*names(("start",), spec.start, _names(dae.labels.x))]
    if spec.inputs is not None:
        known = _names(dae.labels.u)
        faults += names(("inputs",), spec.inputs, known)
        faults += [
            Fault(("inputs", name), "a rate", "none") for name in known if name not in spec.inputs
        ]
    if faults:
        raise problem_error(problem.source, faults)


def _names(labels: Iterable[Any]) -> list[str]:
    return [label.full for label in leaves(labels)]


@contextmanager
def _at(problem: Problem, place: Place) -> Iterator[None]:
    """Say which line of the problem an error of the library concerns."""
    try:
        yield
    except (ModelError, DataError) as error:
        if isinstance(error, ProblemError):
            raise
        raise ProblemError(f"{problem.source.where(place)}: {error}") from error


def _attributes(problem: Problem, setup: Setup) -> dict[str, str]:
    """Return what a result must know about its problem."""
    source = problem.source
    settings = {"settings": "\n".join(dict.fromkeys(source.settings.values()))}
    facts = dict(ground_facts(setup.ground) + vehicle_facts(setup.vehicle))
    return {
        "title": problem.spec.title or source.path.stem,
        "problem_file": source.path.name,
        "problem": source.text,
        **(settings if source.settings else {}),
        **{name.replace(" ", "_"): words for name, words in facts.items()},
    }


def ground_facts(ground: Ground) -> Facts:
    """Return what to tell about a ground."""
    grid = ground.grid
    (n_x, n_y), (h_x, h_y) = grid.z.shape, grid.spacing
    facts = [
        ("ground", ground.source),
        ("ground size", f"{np.ptp(grid.x):g} x {np.ptp(grid.y):g} m, {n_x} x {n_y} nodes"),
        ("ground cell", f"{h_x:.4g} x {h_y:.4g} m"),
        ("ground height", f"{grid.z.min():.4g} to {grid.z.max():.4g} m"),
    ]
    if ground.rolled is not None:
        change = f"at most {ground.rolled.largest:.3g} m, rms {ground.rolled.rms:.3g} m"
        facts.append(("ground changed by rolled", change))
    return facts


def vehicle_facts(vehicle: Vehicle) -> Facts:
    """Return what to tell about a vehicle."""
    wheels = ", ".join(
        f"{w.name} {w.radius:g} m {'driven' if w.driven else 'free'}" for w in vehicle.wheels
    )
    return [("vehicle", f"{vehicle.name}: {wheels}")]
