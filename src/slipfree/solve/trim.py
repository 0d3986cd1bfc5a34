"""Solve for the unknowns of a start under inputs, and for states that minimise outputs."""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Record, leaves
from slipfree.core.trajectory import Trajectory
from slipfree.solve.initial_conditions import solve_initial_conditions
from slipfree.solve.options import SolverOptions
from slipfree.solve.sampling import Samples, correct_samples, to_trajectory
from slipfree.solve.system import Block, System, with_inputs
from slipfree.solve.violations import first_violation, invalid_start

MAX_EVALUATIONS = 50  # maximum number of evaluations per state to find
TRIM_TOLERANCE = 1e-13  # relative change at which states count as found


def apply_inputs(
    dae: Dae, start: Trajectory, inputs: Record, *, options: SolverOptions = SolverOptions()
) -> Trajectory:
    """Return a start whose unknowns satisfy the equations under given inputs.

    Raises
    ------
    ModelError
        If the equations have no solution or do not determine the unknowns, or a limit is violated.
    """
    return _consistent_start(
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

    Parameters
    ----------
    dae : Dae
        The model.
    start : Trajectory
        Motion of this model or of a model with the same states. Its last sample is the initial
        guess, with zero for unknowns that it lacks; states that are not in ``states`` keep their
        values.
    inputs : record
        From ``dae.inputs(...)``; constants or expressions.
    states : sequence of str
        Names of the states to find.
    least : sequence of str
        Names of the outputs to minimise; the name of an output of wheels includes all wheels.
    options : SolverOptions
        Options of the solvers.

    Returns
    -------
    Trajectory
        One sample, with unknowns that satisfy the equations under the inputs.

    Raises
    ------
    ModelError
        If a name is unknown, the equations have no solution at a tried state, or a limit is
        violated.
    """
    from scipy.optimize import least_squares  # imported where it is used: it takes 0.2 s

    x_names = [label.full for label in leaves(dae.labels.x)]
    rows = [k for k, label in enumerate(leaves(dae.labels.y)) if label.name in least]
    found = {label.name for label in leaves(dae.labels.y)}
    for argument, names, known in (("states", states, x_names), ("least", least, sorted(found))):
        for name in names:
            if name not in known:
                raise ModelError(
                    f"trim_states: {argument}: expected one of {', '.join(known)}, found {name!r}; "
                    "correct the name"
                )
    where = [x_names.index(name) for name in states]
    system = with_inputs(dae, inputs, 0, options)
    part = system._replace(blocks=_needed_blocks(system, [list(leaves(dae.y))[k] for k in rows]))
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
    return _consistent_start(system, x, first)


def _known_unknowns(dae: Dae, start: Trajectory) -> Array:
    """Return the unknowns of a start in local coordinates; zero for those that it lacks."""
    pairs = zip(leaves(dae.labels.z), dae.shift[1], strict=True)
    return np.array(
        [
            start.of(label)[-1] - shift if label.name in start.columns else 0.0
            for label, shift in pairs
        ]
    )


def _needed_blocks(system: System, outputs: Sequence[ca.SX]) -> tuple[Block, ...]:
    """Return the first blocks of equations, up to the last block on which outputs depend."""
    z, together = system.dae.columns()[1], ca.vertcat(*outputs)
    last = [k for k, block in enumerate(system.blocks) if ca.depends_on(together, z[block.span])]
    return system.blocks[: max(last, default=0) + 1]


def _consistent_start(system: System, x: Array, z: Array) -> Trajectory:
    u = system.u[:, :1]
    z = solve_initial_conditions(system, 0.0, x, z, u[:, 0])
    still = np.zeros((system.dae.quad.numel(), 1))
    found, report = correct_samples(system, Samples(np.zeros(1), x[:, None], z[:, None], still, u))
    run = to_trajectory(system, found, report)
    fault = first_violation(system, run, found)
    if fault is not None:
        raise invalid_start(fault[1].words)
    return run
