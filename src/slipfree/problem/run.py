"""From a validated problem to a motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from slipfree.dae import Dae
from slipfree.errors import DataError, ModelError, SolverError
from slipfree.geometry.path import Path
from slipfree.kinematics.follow import follow, straight
from slipfree.kinematics.montana import Difference, cross_check, montana_kinematics
from slipfree.kinematics.rolling import direct_kinematics
from slipfree.named import Array, leaves
from slipfree.problem import schema
from slipfree.problem.ground import Ground, at, build_ground, ground_facts
from slipfree.problem.read import Fault, Problem, S, names, problem_error
from slipfree.problem.summary import Facts
from slipfree.solve.settle import settle
from slipfree.solve.simulate import simulate
from slipfree.terrain.bicubic import Bicubic
from slipfree.trajectory import Trajectory
from slipfree.vehicle.catalog import three_wheeler
from slipfree.vehicle.chain import Vehicle

CATALOG = {"three_wheeler": three_wheeler}
NEAR = 1e-9  # times closer than this part of the duration are one


@dataclass(frozen=True, eq=False)
class Setup:
    """All that a problem needs before it is integrated.

    Attributes
    ----------
    ground, vehicle : Ground, Vehicle
        What moves, and on what.
    model, dae : Dae
        The closure model, which settles the start, and what is integrated.
    start : Trajectory
        The vehicle at rest at its start.
    inputs : record
        Rates, or a driving law.
    t : ndarray, shape (n,)
        Times of the samples. [s]
    """

    ground: Ground
    vehicle: Vehicle
    model: Dae[Any, Any, Any, Any, Any]
    dae: Dae[Any, Any, Any, Any, Any]
    start: Trajectory
    inputs: Any
    t: Array


class Outcome(NamedTuple):
    """What came of a problem: the motion, whole or to where it stopped, and what it ran on."""

    trajectory: Trajectory
    setup: Setup


def build(problem: Problem[schema.Direct]) -> Setup:
    """Return the model, the settled start and the inputs of a problem.

    Raises
    ------
    ProblemError
        If the ground cannot be read or made, names are unknown, or the vehicle cannot stand at
        the start.
    """
    spec = problem.spec
    ground = build_ground(problem)
    with at(problem, ("vehicle",)):
        vehicle = build_vehicle(spec.vehicle)
    terrain = Bicubic(ground.grid, (spec.start.get("x", 0.0), spec.start.get("y", 0.0)))
    dae: Dae[Any, Any, Any, Any, Any]
    with at(problem, ("slip",)):
        model = dae = direct_kinematics(vehicle, terrain, slip=spec.slip)
    check_names(problem, dae, spec.inputs)
    start = build_start(problem, dae)
    t, rates = samples(spec.time, spec.inputs or {})
    if spec.formulation == "montana":
        with at(problem, ("formulation",)):
            dae = montana_kinematics(vehicle, terrain, slip=spec.slip)
    if spec.driver is None:
        with at(problem, ("inputs",)):
            inputs = dae.inputs(**rates)
    else:
        inputs = build_law(problem, dae, vehicle, start)
    return Setup(ground, vehicle, model, dae, start, inputs, t)


def build_vehicle(spec: schema.Vehicle) -> Vehicle:
    """Return a vehicle of the catalogue."""
    given = spec.model_dump(exclude_none=True, exclude={"catalog", "name"})
    return CATALOG[spec.catalog](**given)


def build_start(problem: Problem[S], dae: Dae[Any, Any, Any, Any, Any]) -> Trajectory:
    """Return the vehicle at rest where the problem starts."""
    values: dict[str, Any] = dict(problem.spec.start)
    if getattr(problem.spec, "frame", "paper") == "rep103" and "heading" in values:
        values["heading"] -= np.pi / 2  # from the x axis to the y axis
    with at(problem, ("start",)):
        return settle(dae, **values)


def build_law(
    problem: Problem[S], dae: Dae[Any, Any, Any, Any, Any], vehicle: Vehicle, start: Trajectory
) -> Any:
    """Return the inputs of the driving law of a problem."""
    driver = problem.spec.driver
    with at(problem, ("driver",)):
        if driver is None:
            raise ModelError("expected a [driver]")
        if driver.name == "straight":
            if driver.path is not None or driver.file is not None:
                raise ModelError("driver: 'straight' takes no path; use name = 'follow'")
            return straight(dae, vehicle, start, speed=driver.speed)
        if (driver.path is None) == (driver.file is None):
            raise ModelError("driver: 'follow' needs either path, an array of [x, y], or file")
        points = driver.path or read_points(problem.folder / str(driver.file))
        return follow(dae, vehicle, Path(np.array(points)), speed=driver.speed)


def read_points(file: Any) -> list[tuple[float, float]]:
    """Return the way-points in a CSV file: x and y in two columns, one line of names allowed."""
    try:
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"{file}: expected way-points as CSV, found no text file") from error
    rows = []
    for number, line in enumerate(text.splitlines(), 1):
        cells = line.split(",")
        try:
            x, y = (float(cell) for cell in cells)
        except ValueError as error:
            if number == 1 or not line.strip():
                continue
            raise DataError(
                f"{file}:{number}: expected two numbers x,y, found {line.strip()!r}"
            ) from error
        rows.append((x, y))
    return rows


def run(
    problem: Problem[schema.Direct], progress: Callable[[float], None] | None = None
) -> Outcome:
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
    with at(problem, ("start",)):
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


def cross(problem: Problem[schema.Direct], outcome: Outcome) -> tuple[Difference, ...]:
    """Return where the same problem in the other formulation of contact ends up differently."""
    other = "montana" if problem.spec.formulation == "closure" else "closure"
    spec = problem.spec.model_copy(update={"formulation": other})
    return cross_check(outcome.trajectory, run(replace(problem, spec=spec)).trajectory)


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


def check_names(
    problem: Problem[S], dae: Dae[Any, Any, Any, Any, Any], inputs: Iterable[str] | None
) -> None:
    """Raise for all states and inputs of the problem that the model does not have, or lacks."""
    faults = [*names(("start",), problem.spec.start, _names(dae.labels.x))]
    if inputs is not None:
        known = _names(dae.labels.u)
        faults += names(("inputs",), inputs, known)
        faults += [
            Fault(("inputs", name), "a rate", "none") for name in known if name not in inputs
        ]
    if faults:
        raise problem_error(problem.source, faults)


def _names(labels: Iterable[Any]) -> list[str]:
    return [label.full for label in leaves(labels)]


def _attributes(problem: Problem[schema.Direct], setup: Setup) -> dict[str, str]:
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


def vehicle_facts(vehicle: Vehicle) -> Facts:
    """Return what to tell about a vehicle."""
    wheels = ", ".join(
        f"{w.name} {w.radius:g} m {'driven' if w.driven else 'free'}" for w in vehicle.wheels
    )
    return [("vehicle", f"{vehicle.name}: {wheels}")]
