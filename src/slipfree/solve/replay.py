"""Trimmed starts under given inputs, and motions repeated by another model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.records import Array, Record, leaves, unpack
from slipfree.core.trajectory import Trajectory, joined
from slipfree.geometry.path import spline_function
from slipfree.solve.sampling import Samples, correct_samples, periodic_states, same_turn
from slipfree.solve.settle import settle_at
from slipfree.solve.simulate import consistent_start, simulate
from slipfree.solve.system import SolverOptions, solve_initial_conditions, with_inputs

MAX_EVALUATIONS = 50  # maximum number of evaluations per state to find
TRIM_TOLERANCE = 1e-13  # relative change at which states count as found
SPLINE_DEGREE = 5  # degree of the spline through the inputs


def apply_inputs(
    dae: Dae, start: Trajectory, inputs: Record, *, options: SolverOptions = SolverOptions()
) -> Trajectory:
    """Return a start whose unknowns satisfy the equations under given inputs.

    Raises ModelError if the equations have no solution or do not determine the unknowns, or a limit
    is violated.
    """
    return consistent_start(
        with_inputs(dae, inputs, 0, options), dae.rows("x", start, -1), _known_unknowns(dae, start)
    )


def trim_states(
    dae: Dae,
    start: Trajectory,
    inputs: Record,
    *,
    states: Sequence[str],
    least: Sequence[str],
    options: SolverOptions = SolverOptions(),
) -> Trajectory:
    """Return a start at the states that minimise the mean square of outputs.

    The last sample of ``start``, of this model or one with the same states, is the initial guess,
    with zero for unknowns that it lacks; states that are not in ``states`` keep their values. The
    inputs are constants or expressions. The name of an output of wheels in ``least`` includes all
    wheels.

    ModelError is raised if the equations have no solution at a tried state, or a limit is violated.
    """
    from scipy.optimize import least_squares  # imported where it is used: it takes 0.2 s

    rows = [k for k, label in enumerate(leaves(dae.labels.y)) if label.name in least]
    where = dae.state_rows(*states)
    system = with_inputs(dae, inputs, 0, options)
    together, unknowns = ca.vertcat(*(list(leaves(dae.y))[k] for k in rows)), dae.columns()[1]
    needed = (ca.depends_on(together, unknowns[block.span]) for block in system.blocks)
    count = max((k for k, each in enumerate(needed, 1) if each), default=1)
    part = system._replace(blocks=system.blocks[:count])  # up to the last on which outputs depend
    x, first = dae.rows("x", start, -1), _known_unknowns(dae, start)

    def outputs(values: Array) -> Array:
        x[where] = values
        z = solve_initial_conditions(part, 0.0, x, first, system.u[:, 0])
        return np.array(system.outputs(0.0, x, z, system.u[:, 0])[0]).ravel()[rows]

    if where:
        result = least_squares(
            outputs,
            x[where],
            method="lm",
            max_nfev=MAX_EVALUATIONS * len(where),
            xtol=TRIM_TOLERANCE,
            ftol=TRIM_TOLERANCE,
            gtol=TRIM_TOLERANCE,
        )
        x[where] = result.x
    return consistent_start(system, x, first)


def _known_unknowns(dae: Dae, start: Trajectory) -> Array:
    """Return the unknowns of a start in local coordinates; zero for those that it lacks."""
    pairs = zip(leaves(dae.labels.z), dae.shift[1], strict=True)
    return np.array(
        [
            start.of(label)[-1] - shift if label.name in start.columns else 0.0
            for label, shift in pairs
        ]
    )


def round_trip(
    dae: Dae, run: Trajectory, names: Sequence[str], *, options: SolverOptions = SolverOptions()
) -> dict[str, float]:
    """Return the differences between unknowns of a model and of a motion under the same inputs.

    The model is solved at every sample separately, with the states and inputs of the motion, which
    also contains its pose (first field of ``z``). The result is the largest absolute difference by
    name.
    """
    system = with_inputs(dae, dae.zero_inputs, 0, options)
    x, u, pose = (
        np.array([run.of(label) for label in leaves(record)])
        for record in (dae.labels.x, dae.labels.u, dae.labels.z[0])
    )
    z = np.zeros((dae.columns()[1].numel(), run.t.size))
    z[: len(pose)] = pose - dae.shift[1][: len(pose), None]
    still = np.zeros((dae.quad.numel(), run.t.size))
    found, _ = correct_samples(system, Samples(run.t, x - dae.shift[0][:, None], z, still, u))
    rows = {label.full: row for label, row in zip(leaves(dae.labels.z), found.z, strict=True)}
    return {name: float(np.abs(rows[name] - run[name]).max()) for name in names}


def replay(
    dae: Dae,
    run: Trajectory,
    inputs: Record | None = None,
    *,
    jumps: Sequence[float] = (),
    options: SolverOptions = SolverOptions(),
) -> tuple[Trajectory, dict[str, float]]:
    """Repeat a motion by another model, from the same start under the same inputs.

    Parameters
    ----------
    dae : Dae
        The model. The motion must contain its states, pose (first field of ``z``) and inputs.
    run : Trajectory
        The motion.
    inputs : record of SX, optional
        Inputs of the model, see `spline_inputs`; by default splines through the samples of the
        motion, from each jump to the next.
    jumps : sequence of float
        Times at which inputs may jump. Samples at these times have the inputs after the jump. [s]
    options : SolverOptions
        Options of the solvers.

    Returns
    -------
    motion : Trajectory
        Motion of the model.
    difference : dict of str to float
        Largest absolute difference between the two motions, by state of the model. [m, rad]

    Raises
    ------
    ModelError
        If the model has no solution at the start of the motion or violates a limit there.
    SolverError
        If the integrator fails.
    """
    t = run.t
    start = settle_at(dae, run, options)
    cuts = [k for k in range(1, t.size - 1) if inputs is None and np.isin(t[k], jumps)]
    parts: list[Trajectory] = []
    for left, right in zip([0, *cuts], [*cuts, t.size - 1], strict=True):
        last = right + (right == t.size - 1)
        law = inputs
        if law is None:
            values = {each.full: run.of(each)[left:last] for each in leaves(dae.labels.u)}
            law = spline_inputs(dae, t[left:last], values, end=float(t[right]))
        start = simulate(dae, start, law, t[left : right + 1], options=options)
        parts.append(start)
        if start.stop is not None:
            break
    motion = joined(*(part.part(slice(-1)) for part in parts[:-1]), parts[-1])
    n = motion.t.size if motion.stop is None else motion.t.size - 1
    first, second = (dae.rows("x", each, slice(n)) for each in (motion, run))
    periodic = periodic_states(dae, dae.rows("x", motion, 0))
    gaps = np.abs(same_turn(first, second, periodic) - second).max(axis=1, initial=0.0)
    return motion, dict(zip(dae.state_names, gaps.tolist(), strict=True))


def spline_inputs(
    dae: Dae, t: Array, values: Mapping[str, Array], *, end: float | None = None
) -> Any:
    """Return the inputs of a model as splines through samples.

    Inputs are constant before the first sample, and after the last or the time ``end``, up to which
    the splines are extrapolated [s].
    """
    names = [label.full for label in leaves(dae.labels.u)]
    samples = np.column_stack([values[name] for name in names])
    if t.size == 1:
        return unpack(dae.u, samples[0].tolist())
    degree = min(SPLINE_DEGREE, t.size - 1 - t.size % 2)  # it is odd
    if end is not None and end > t[-1]:
        from scipy.interpolate import make_interp_spline  # imported here: the import takes 0.2 s

        spline, t = make_interp_spline(t, samples, k=degree), np.append(t, end)
        samples = spline(t)
    inside = ca.fmin(ca.fmax(dae.t, t[0]), t[-1])
    return unpack(dae.u, ca.vertsplit(spline_function("law", t, samples, degree)(inside)))
