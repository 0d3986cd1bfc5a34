"""From given rates in the platform's heading frame to a motion, for any vehicle."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np

from slipfree.control.path_tracking import track_path
from slipfree.dae import Dae
from slipfree.errors import ModelError, SlipfreeError
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
from slipfree.problem.commands import are_commands, read_commands
from slipfree.problem.load import Problem, S
from slipfree.records import Array, leaves
from slipfree.solve.options import SolverOptions
from slipfree.solve.replay import replay, round_trip
from slipfree.solve.simulate import simulate
from slipfree.solve.trim import trim_states
from slipfree.trajectory import SolverError, Trajectory
from slipfree.vehicle.formula import evaluate

LEAST_SAMPLES = 4  # between jumps of the given rates, for a replay
MOTION = ("velocity_x", "velocity_y", "heading_rate")


def is_subset(spec: schema.Motion) -> bool:
    """Return whether all given rates are in the platform's heading frame."""
    return isinstance(spec, schema.Inverse) and are_commands(spec.given or ())


def build_subset(problem: Problem[S], spec: schema.Inverse, points: Array | None = None) -> Setup:
    """Return the models, the start and the inputs of a problem under commands or along a path.

    The steering starts at the angles that the first commands lead to, but for those in `[start]`.
    """
    place, given = ("path",), dict.fromkeys(SUBSET, 0.0)
    if points is None:
        place, (given, words) = ("given",), read_commands(problem, spec)
    exact = len(given) < len(SUBSET) if spec.exact is None else spec.exact
    ground = build_ground(problem)
    with at(problem, ("vehicle",)):
        vehicle = build_vehicle(spec.vehicle, problem.folder)
        terrain = build_terrain(problem, ground)
        direct = direct_kinematics(vehicle, terrain)
    with at(problem, place):
        dae = subset_kinematics(vehicle, terrain, given=tuple(given), exact=exact)
    check_names(problem, direct, None)
    stand = build_start(problem, direct)
    t, inputs, first = _inputs(problem, spec, dae, given)
    if points is not None:
        words = f"path of {points.shape[1]} way-points in {points[0, -1]:g} s"
        dae, inputs = track_path(dae, *points)
        first = inputs
    sought = [name for name in steered(vehicle, direct) if name not in spec.start]
    with at(problem, place):
        try:
            errors = [f"{name}_error" for name in sought]
            start = trim_states(
                dae, stand, first, states=sought, least=errors, options=spec.solver.options
            )
        except ModelError:
            if exact:
                check_reach(vehicle, direct, stand, tuple(given))
            raise
    return Setup(ground, terrain, vehicle, direct, dae, start, inputs, t, words)


def _inputs(
    problem: Problem[S], spec: schema.Inverse, dae: Dae, given: Mapping[str, Any]
) -> tuple[Array, Any, Any]:
    """Return the times of the samples, the inputs, and those at the start."""
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
    return t, dae.inputs(**rates, **formulas), dae.inputs(**first, **formulas)


def _formula(name: str, text: str, time: ca.SX) -> ca.SX:
    """Return a rate as a formula of the time."""
    try:
        return evaluate(text, {"t": time})
    except ModelError as error:
        raise ModelError(f"{name}: {error}; a rate may be a formula of t, in seconds") from error


def drive_subset(
    setup: Setup, options: SolverOptions, progress: Callable[[float], None] | None
) -> Trajectory:
    """Return the motion, with how far the direct model under its wheel rates is from it."""
    dae, direct, start = setup.dae, setup.model, setup.start
    try:
        run = simulate(dae, start, setup.inputs, setup.t, options=options, progress=progress)
    except SolverError as error:
        if error.trajectory is None:
            raise
        return error.trajectory
    early: dict[str, str] = {}
    gaps: dict[str, float] = {}
    try:
        trip = round_trip(direct, run, MOTION, options=options)
        gaps = {f"round_trip_{name}": gap for name, gap in trip.items()}
        if run.t.size < 2:
            return replace(run, statistics={**run.statistics, **gaps})
        jumps = _jumps(setup, run)
        _check_samples(run.t, jumps)
        again = replay(direct, run, jumps=jumps, options=options).motion
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


def _check_samples(t: Array, jumps: Sequence[float]) -> None:
    """Raise ModelError if samples between jumps are too few for splines through the inputs."""
    places = np.searchsorted(t, [t[0], *jumps])
    if jumps and np.diff(places).min() < LEAST_SAMPLES:
        raise ModelError(
            f"not done: it needs {LEAST_SAMPLES} or more samples between changes of the commands, "
            f"found {np.diff(places).min()}; reduce 'step' in [time]"
        )


def _jumps(setup: Setup, run: Trajectory) -> list[float]:
    """Return the times at which given rates jump."""
    values: list[Any] = [v for v in leaves(setup.inputs) if isinstance(v, np.ndarray)]
    where = {k + 1 for each in values for k in np.flatnonzero(np.diff(each))}
    return [float(setup.t[k]) for k in sorted(where) if setup.t[k] < run.t[-1]]
