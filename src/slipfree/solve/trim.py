"""A start under inputs, and states at which some outputs of a model are least."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from slipfree.dae import Dae
from slipfree.errors import ModelError
from slipfree.records import Array, leaves
from slipfree.solve.initial_conditions import consistent
from slipfree.solve.sampling import Samples, corrected, table
from slipfree.solve.settle import first_violation
from slipfree.solve.system import Block, System, with_inputs
from slipfree.trajectory import Trajectory

TRIALS = 50  # evaluations of all sought states' effects at most
SETTLED = 1e-13  # relative change at which states count as found


def moving(dae: Dae, start: Trajectory, inputs: Any) -> Trajectory:
    """Return a start with the unknowns that its inputs lead to.

    Raises
    ------
    ModelError
        If they do not determine them, or a limit is violated.
    """
    return _under(with_inputs(dae, inputs, 0), dae.rows("x", start, -1), _known(dae, start))


def seek(
    dae: Dae, start: Trajectory, inputs: Any, *, states: Sequence[str], least: Sequence[str]
) -> Trajectory:
    """Return a start at the states at which some outputs are least in the mean square.

    Parameters
    ----------
    dae : Dae
        The model.
    start : Trajectory
        Its last sample is where the search starts, of this model or of one with its pose; states
        that are not sought stay.
    inputs : record
        From ``dae.inputs(...)``; constants or expressions.
    states : sequence of str
        States that are sought, by name.
    least : sequence of str
        Outputs that are to be least, by name; of those of wheels, all wheels'.

    Returns
    -------
    Trajectory
        One sample, moving under the inputs.

    Raises
    ------
    ModelError
        If a name is unknown, the vehicle cannot stand at what is tried, or a limit is violated.
    """
    from scipy.optimize import least_squares  # imported where it is used: it takes 0.2 s

    x_names = [label.full for label in leaves(dae.labels.x)]
    rows = [k for k, label in enumerate(leaves(dae.labels.y)) if label.name in least]
    found = {label.name for label in leaves(dae.labels.y)}
    for name in (*(each for each in states if each not in x_names), *(set(least) - found)):
        raise ModelError(f"seek: the model has no {name!r}; states are {', '.join(x_names)}")
    where = [x_names.index(name) for name in states]
    loop = with_inputs(dae, inputs, 0)
    part = loop._replace(blocks=_needed(loop, [list(leaves(dae.y))[k] for k in rows]))
    x, first = dae.rows("x", start, -1), _known(dae, start)

    def outputs(values: Array) -> Array:
        x[where] = values
        z = consistent(part, 0.0, x, first, loop.u[:, 0])
        return np.array(loop.outputs(0.0, x, z, loop.u[:, 0])[0]).ravel()[rows]

    if where:
        result = least_squares(
            outputs,
            x[where],
            method="lm",
            max_nfev=TRIALS * len(where),
            xtol=SETTLED,
            ftol=SETTLED,
            gtol=SETTLED,
        )
        x[where] = result.x
    return _under(loop, x, first)


def _known(dae: Dae, start: Trajectory) -> Array:
    """Return the unknowns of a start, local; zero where it has none of that name."""
    pairs = zip(leaves(dae.labels.z), dae.shift[1], strict=True)
    return np.array(
        [
            start.of(label)[-1] - shift if label.name in start.columns else 0.0
            for label, shift in pairs
        ]
    )


def _needed(loop: System, outputs: Sequence[ca.SX]) -> tuple[Block, ...]:
    """Return the first blocks of equations, up to the last on which outputs depend."""
    z, together = loop.dae.columns()[1], ca.vertcat(*outputs)
    last = [k for k, block in enumerate(loop.blocks) if ca.depends_on(together, z[block.span])]
    return loop.blocks[: max(last, default=0) + 1]


def _under(loop: System, x: Array, z: Array) -> Trajectory:
    u = loop.u[:, :1]
    z = consistent(loop, 0.0, x, z, u[:, 0])
    still = np.zeros((loop.dae.quad.numel(), 1))
    found, report = corrected(loop, Samples(np.zeros(1), x[:, None], z[:, None], still, u))
    run = table(loop, found, report)
    fault = first_violation(loop, run, found)
    if fault is not None:
        raise ModelError(f"the start is not valid: {fault[1].words}")
    return run
