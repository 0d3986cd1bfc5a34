"""From given rates in the platform's heading frame to a motion, for any vehicle."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from slipfree.errors import ModelError, SlipfreeError
from slipfree.files.toml.errors import Fault, problem_error
from slipfree.models.kinematics import direct_kinematics
from slipfree.models.platform_rates import steered, subset_kinematics
from slipfree.models.reach import SUBSET, check_reach
from slipfree.problem import schema
from slipfree.problem.build_common import (
    Setup,
    build_start,
    build_terrain,
    build_vehicle,
    check_names,
    samples,
)
from slipfree.problem.build_ground import at, build_ground
from slipfree.problem.load import Problem, S
from slipfree.records import leaves
from slipfree.solve.replay import replay, round_trip
from slipfree.solve.simulate import simulate
from slipfree.solve.trim import trim_states
from slipfree.trajectory import SolverError, Trajectory
from slipfree.vehicle.formula import evaluate

MOTION = ("velocity_x", "velocity_y", "heading_rate")


def is_subset(spec: schema.Motion) -> bool:
    """Return whether all given rates are in the platform's heading frame."""
    given = spec.given if isinstance(spec, schema.Inverse) else None
    return bool(given) and set(given or ()) <= set(SUBSET)


def build_subset(problem: Problem[S], spec: schema.Inverse) -> Setup:
    """Return the models, the start and the inputs of a problem.

    The steering starts at the angles that the given rates ask for, but for what is given of it.
    """
    given = dict(spec.given or {})
    if faults := [*_steering(spec)]:
        raise problem_error(problem.source, faults)
    ground = build_ground(problem)
    with at(problem, ("vehicle",)):
        vehicle = build_vehicle(spec.vehicle, problem.folder)
        terrain = build_terrain(problem, ground)
        direct = direct_kinematics(vehicle, terrain)
    with at(problem, ("given",)):
        dae = subset_kinematics(vehicle, terrain, given=tuple(given))
    direct = replace(direct, compiled=spec.solver.compiled)
    dae = replace(dae, compiled=spec.solver.compiled)
    check_names(problem, direct, None)
    stand = build_start(problem, direct)
    formulas = {}
    for name, value in given.items():
        if isinstance(value, str):
            with at(problem, ("given", name)):
                formulas[name] = _formula(name, value, dae.t)
    numbers = {name: value for name, value in given.items() if name not in formulas}
    t, rates = samples(spec.time, numbers)
    first = {
        name: value[0] if isinstance(value, np.ndarray) else value for name, value in rates.items()
    }
    sought = [name for name in steered(vehicle, direct) if name not in spec.start]
    errors = [f"{name}_error" for name in sought]
    with at(problem, ("given",)):
        inputs = dae.inputs(**rates, **formulas)
        try:
            start = trim_states(
                dae, stand, dae.inputs(**first, **formulas), states=sought, least=errors
            )
        except ModelError:
            check_reach(vehicle, direct, stand, tuple(given))
            raise
    words = ", ".join(f"{name} {_words(given[name])} {_unit(name)}" for name in given)
    return Setup(ground, terrain, vehicle, direct, dae, start, inputs, t, words)


def _steering(spec: schema.Inverse) -> Iterator[Fault]:
    if spec.steering != "angle":
        expected = f"'angle', which the steering follows with {', '.join(SUBSET)}"
        yield Fault(("steering",), expected, repr(spec.steering))


def _formula(name: str, text: str, time: ca.SX) -> ca.SX:
    """Return a rate as a formula of the time."""
    try:
        return evaluate(text, {"t": time})
    except ModelError as error:
        raise ModelError(f"{name}: {error}; a rate may be a formula of t, in seconds") from error


def _words(value: float | schema.Piecewise | str) -> str:
    if isinstance(value, tuple):
        return " then ".join(f"{rate:g}" for _, rate in value)
    return value if isinstance(value, str) else f"{value:g}"


def _unit(name: str) -> str:
    return SUBSET[name].unit.replace(" s-1", "/s")


def drive_subset(
    setup: Setup, tolerance: float, progress: Callable[[float], None] | None
) -> Trajectory:
    """Return the motion, with how far the direct model under its wheel rates is from it."""
    dae, direct, start = setup.dae, setup.model, setup.start
    try:
        run = simulate(dae, start, setup.inputs, setup.t, tolerance=tolerance, progress=progress)
    except SolverError as error:
        if error.trajectory is None:
            raise
        return error.trajectory
    early: dict[str, str] = {}
    gaps: dict[str, float] = {}
    try:
        trip = round_trip(direct, run, MOTION)
        gaps = {f"round_trip_{name}": gap for name, gap in trip.items()}
        if run.t.size < 2:
            return replace(run, statistics={**run.statistics, **gaps})
        again = replay(direct, run, jumps=_jumps(setup, run), tolerance=tolerance).motion
    except (SlipfreeError, np.linalg.LinAlgError) as error:
        early["replay_stopped"] = str(error)
    else:
        n = again.t.size if again.stop is None else again.t.size - 1
        names = [label.full for label in leaves(direct.labels.x)]
        gaps |= {
            f"replay_{name}": float(np.abs(again[name][:n] - run[name][:n]).max()) for name in names
        }
        if again.stop is not None and run.stop is None:
            early["replay_stopped"] = f"at {again.stop.t:.6g} s: {again.stop.words}"
    return replace(run, statistics={**run.statistics, **gaps}, attributes=early)


def _jumps(setup: Setup, run: Trajectory) -> list[float]:
    """Return the times at which given rates jump."""
    values: list[Any] = [v for v in leaves(setup.inputs) if isinstance(v, np.ndarray)]
    where = {k + 1 for each in values for k in np.flatnonzero(np.diff(each))}
    return [float(setup.t[k]) for k in sorted(where) if setup.t[k] < run.t[-1]]
