"""Common set-up of problems: vehicle, start, times and names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.records import Array, leaves
from slipfree.core.trajectory import OFFSET, Column, Trajectory
from slipfree.files.toml.source import Fault, ProblemError, name_errors, problem_error
from slipfree.files.toml.source import Place as KeyPath
from slipfree.problem import schema
from slipfree.problem.build_ground import GroundMap, at, ground_facts
from slipfree.problem.build_vehicle import build_vehicle as build_vehicle
from slipfree.problem.problem import Problem, S
from slipfree.problem.summary import Lines
from slipfree.problem.unit_checks import check_units
from slipfree.solve.options import SolverOptions
from slipfree.solve.settle import SPEED, settle
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.solids import Prism
from slipfree.vehicle.tree import Vehicle

DYNAMIC_TOLERANCE = 1e-6  # default tolerance of dynamics, whose motions are less smooth
TIME_TOLERANCE = 1e-9  # relative difference of times that count as equal
EVEN = 1e-6  # smaller relative differences of periods count as zero


@dataclass(frozen=True, eq=False)
class Setup:
    """Set-up of the integration of a problem.

    Attributes
    ----------
    ground, terrain : GroundMap, Bicubic
        Ground as heights on a grid, and as a smooth surface.
    vehicle : Vehicle
        Vehicle of the problem.
    model, dae : Dae
        Model that settles the vehicle at its start, and model to integrate.
    start : Trajectory
        One sample: the vehicle at its start, at rest or with the given rates of its platform.
    inputs : record
        Inputs of ``dae``: constant rates, rates per interval of ``t``, or a driving law.
    t : ndarray, shape (n,)
        Times of the samples, or of the evaluations of a sampled driving law. [s]
    driven : str
        Description of the inputs.
    prisms : tuple of Prism
        Solids on the ground.
    every : int
        Number of evaluations of a sampled driving law per sample of the result; zero for a
        continuous one.
    """

    ground: GroundMap
    terrain: Bicubic
    vehicle: Vehicle
    model: Dae
    dae: Dae
    start: Trajectory
    inputs: Any
    t: Array
    driven: str
    prisms: tuple[Prism, ...] = field(default=(), kw_only=True)
    every: int = field(default=0, kw_only=True)

    @property
    def facts(self) -> Lines:
        """Facts about ground, vehicle and inputs: pairs of name and description."""
        drive = ("driven by", self.driven)
        return [*ground_facts(self.ground), *vehicle_facts(self.vehicle), drive]


def build_terrain(problem: Problem[S], ground: GroundMap) -> Bicubic:
    """Return the ground as a surface, with its local origin at the start.

    Raises
    ------
    ProblemError
        If the start lies off the ground.
    """
    start, grid = problem.spec.start, ground.grid
    for axis, nodes in (("x", grid.x), ("y", grid.y)):
        place = start.get(axis, 0.0)
        if not nodes[0] <= place <= nodes[-1]:
            raise ProblemError(
                f"{problem.source.where(('start', axis))}: expected a start on the map, which "
                f"extends from {nodes[0]:.10g} to {nodes[-1]:.10g} m in {axis}, found {axis} = "
                f"{place:.10g} m; move the start, or enlarge the ground in [terrain]"
            )
    return Bicubic(grid, (start.get("x", 0.0), start.get("y", 0.0)), ground.mu)


def heading_offset(problem: Problem[S]) -> float:
    """Return the angle that converts a heading of the problem to one from the y axis [rad]."""
    return -OFFSET[getattr(problem.spec, "frame", "paper")]


def in_frame(problem: Problem[S], dae: Dae) -> Dae:
    """Return a model whose conditions, costs and messages have headings of the problem's frame."""
    return replace(dae, reported={"heading": -heading_offset(problem)})


def build_start(problem: Problem[S], dae: Dae) -> Trajectory:
    """Return the vehicle settled on the ground at the start of a problem, as one sample.

    Raises
    ------
    ProblemError
        If the vehicle cannot stand at the start.
    """
    values: dict[str, Any] = dict(problem.spec.start)
    if "heading" in _start_names(dae):
        values["heading"] = values.get("heading", 0.0) + heading_offset(problem)
    with at(problem, ("start",)):
        return settle(dae, options=solver_options(problem), **values)


def solver_options(problem: Problem[S]) -> SolverOptions:
    """Return the solver options of a problem; the default tolerance depends on the model."""
    spec = problem.spec
    options: SolverOptions = spec.solver.options
    is_dynamic = getattr(spec, "model", None) == "dynamics"
    if is_dynamic and "tolerance" not in spec.solver.model_fields_set:
        return replace(options, tolerance=DYNAMIC_TOLERANCE)
    return options


def samples(
    time: schema.Time, inputs: Mapping[str, float | schema.Piecewise]
) -> tuple[Array, dict[str, float | Array]]:
    """Return the sample times, including jumps of the inputs, and the rates by interval.

    Parameters
    ----------
    time : Time
        Duration and time between samples. [s]
    inputs : mapping of str to float or tuple of (time, rate)
        Constant rates, or pairs of the time at which a rate begins and the rate. [s, rad/s or m/s]

    Returns
    -------
    t : ndarray, shape (n,)
        Times from zero to the duration. [s]
    rates : dict of str to float or ndarray of shape (n - 1,)
        Constant rates, or rates per interval of `t`. [rad/s, m/s]
    """
    near = TIME_TOLERANCE * time.duration
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


class SampledTimes(NamedTuple):
    """Times of a motion that may have a sampled controller.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times of the samples of the result, or of the steps of a sampled controller. [s]
    every : int
        Number of controller steps per sample of the result; zero for continuous control.
    """

    t: Array
    every: int


def sampled_times(problem: Problem[Any], key: KeyPath, period: float) -> SampledTimes:
    """Return the times of the steps of a sampled controller, up to the last regular sample.

    Parameters
    ----------
    problem : Problem
        The problem.
    key : tuple of str
        Key of the period, for messages.
    period : float
        Time between the steps of the controller. [s]

    Raises
    ------
    ProblemError
        If the period does not divide the time between samples, or there are more than a million
        steps.
    """
    time = problem.spec.time
    if time.duration / period > schema.MAX_SAMPLES:
        expected = f"a period with at most {schema.MAX_SAMPLES} steps in {time.duration:g} s"
        raise problem_error(problem.source, [Fault(key, expected, f"{period:g} s; increase it")])
    every = round(time.step / period)
    if every < 1 or abs(every * period - time.step) > EVEN * period:
        expected = f"a multiple of {'.'.join(map(str, key))}, {period:g} s"
        fault = Fault(("time", "step"), expected, f"{time.step:g}; change one of them")
        raise problem_error(problem.source, [fault])
    count = every * int(time.duration / time.step + EVEN) + 1
    return SampledTimes(np.asarray(period * np.arange(count)), every)


def check_names(
    problem: Problem[S], dae: Dae, inputs: Iterable[str] | None, driven: Dae | None = None
) -> None:
    """Raise ProblemError for unknown states, unknown or missing inputs, and wrong units.

    Inputs are not checked if ``inputs``, the names of the given inputs, is None. They are inputs of
    ``driven``, by default of ``dae``.
    """
    faults = [*name_errors(("start",), problem.spec.start, _start_names(dae))]
    if inputs is not None:
        known = _names((driven or dae).labels.u)
        faults += name_errors(("inputs",), inputs, known)
        faults += [
            Fault(("inputs", name), "a rate", "none") for name in known if name not in inputs
        ]
    faults = faults or [*check_units(problem.spec, dae)]
    if faults:
        raise problem_error(problem.source, faults)


def _start_names(dae: Dae) -> list[str]:
    """Return the names of the states that a start may have."""
    if dae.standing is None:
        return _names(dae.labels.x)
    return [*_names(dae.standing.model.labels.x), SPEED]


def _names(labels: Iterable[Any]) -> list[str]:
    return [label.full for label in leaves(labels)]


def vehicle_facts(vehicle: Vehicle) -> Lines:
    """Return facts about a vehicle, pairs of name and text: wheels, mass and notes of its file."""
    wheels = ", ".join(
        f"{w.name} {w.radius:g} m {'driven' if w.driven else 'free'}" for w in vehicle.wheels
    )
    facts = [("vehicle", f"{vehicle.name}: {wheels}")]
    if vehicle.mass:
        facts.append(("mass", f"{vehicle.mass:g} kg, weight {vehicle.weight:.1f} N"))
    if vehicle.notes:
        facts.append(("vehicle file", "; ".join(vehicle.notes)))
    return facts


def wheel_angles_at(run: Trajectory, t: Array) -> Column:
    """Return the column of wheel angles of a motion, interpolated at times ``t`` [s]."""
    turns = run.columns["wheel_angle"]
    values = [np.interp(t, run.t, each) for each in turns.values.T]
    return Column(turns.label, np.stack(values, axis=1))
