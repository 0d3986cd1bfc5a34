"""Find a consistent start: the pose in which a vehicle stands on the ground."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from slipfree.dae import Dae, Limit
from slipfree.errors import ModelError
from slipfree.forks import computing
from slipfree.outcome import Outcome
from slipfree.records import Array, Mask, leaves, unpack
from slipfree.solve.initial_conditions import limit_message, solve_initial_conditions
from slipfree.solve.options import SolverOptions
from slipfree.solve.sampling import UNSOLVED_RESIDUAL, Samples, correct_samples, to_trajectory
from slipfree.solve.system import System, with_inputs
from slipfree.trajectory import Stop, Trajectory


@computing
def settle(
    dae: Dae,
    *,
    guess: Mapping[str, float] | None = None,
    options: SolverOptions = SolverOptions(),
    **start: float,
) -> Trajectory:
    """Return the vehicle at rest at a position, as a trajectory of one sample.

    Parameters
    ----------
    dae : Dae
        The model.
    guess : mapping of str to float, optional
        Initial guesses of unknowns, by name, such as ``{"z": 2.0}``; the model has its own for the
        others. [m, rad]
    options : SolverOptions
        Options of the solvers.
    **start : float
        Differential states by name, such as ``x``, ``y``, ``heading``; others are zero. [m, rad]

    Returns
    -------
    Trajectory
        One sample at time zero, in map coordinates: where `simulate` and `plan` start.

    Raises
    ------
    ModelError
        If a name is unknown, the vehicle cannot stand there, a limit is violated, or no equation
        determines one of the unknowns.

    Examples
    --------
    >>> from slipfree import Analytic, catalog, direct_kinematics, settle
    >>> model = direct_kinematics(catalog.three_wheeler(), Analytic(lambda x, y: 0.2 * y))
    >>> start = settle(model, x=1.0, y=2.0, heading=0.0)
    >>> print(f"z = {start['z'][0]:.3f} m, pitch = {start['pitch'][0]:.3f} rad")
    z = 0.706 m, pitch = 0.197 rad
    """
    x = dae.start(**start)
    system = with_inputs(dae, unpack(dae.u, [0.0] * len(list(leaves(dae.u)))), 0, options)
    z = solve_initial_conditions(system, 0.0, x, first_guess(dae, x, guess or {}), system.u[:, 0])
    samples = Samples(
        np.zeros(1), x[:, None], z[:, None], np.zeros((dae.quad.numel(), 1)), system.u
    )
    samples, report = correct_samples(system, samples)
    run = to_trajectory(system, samples, report)
    violation = first_violation(system, run, samples)
    if violation is not None:
        raise ModelError(f"the start is not valid: {violation[1].words}")
    return run


def first_guess(dae: Dae, x: Array, given: Mapping[str, float]) -> Array:
    """Return an initial guess of ``z`` in local coordinates, from values in map coordinates."""
    z = np.array(dae.function("guess", [dae.columns()[0]], [dae.guess])(x)).ravel()
    names = [label.full for label in leaves(dae.labels.z)]
    for name, value in given.items():
        if name not in names:
            raise ModelError(f"guess: {name!r} is not known; known: {', '.join(names)}")
        index = names.index(name)
        z[index] = value - dae.shift[1][index]
    return z


def _limit_message(limit: Limit, value: float, x: Array, z: Array) -> str:
    if limit.describe is not None and (words := limit.describe(x, z)):
        return words
    label = limit.label
    return limit_message(label.words, value, limit.lower, limit.upper, label.unit)


def first_violation(
    system: System, run: Trajectory, samples: Samples, unsolved: float = UNSOLVED_RESIDUAL
) -> tuple[int, Stop] | None:
    """Return the first sample that violates a limit or a check, and the stop.

    ``unsolved`` is the residual, without unit, above which the motion's equations count as not
    solved.
    """
    found: tuple[int, Stop] | None = None

    def consider(bad: Mask, name: str, words: Any, outcome: Outcome = Outcome.LIMIT) -> None:
        nonlocal found
        if bad.any() and (found is None or int(bad.argmax()) < found[0]):
            k = int(bad.argmax())
            found = k, Stop(name, float(run.t[k]), words(k), outcome)

    for limit in system.dae.limits:
        label, lower, upper = limit.label, limit.lower, limit.upper
        values = run.of(label)
        consider(
            ~((values >= lower) & (values <= upper)),
            label.full,
            lambda k, v=values, of=limit: _limit_message(
                of, float(v[k]), samples.x[:, k], samples.z[:, k]
            ),
            limit.outcome,
        )
    for block in (*system.blocks, *system.dependent_blocks):
        if not block.linear or block in system.dependent_blocks:
            label = run.columns[f"{block.labels[0].name}_residual"].label
            most = UNSOLVED_RESIDUAL if block in system.dependent_blocks else unsolved
            values, most = run.of(label), most * system.dae.size_of(block.labels[0])
            consider(
                ~(values <= most),
                label.name,
                lambda k, v=values, lb=label, most=most: (
                    f"the equations have no exact solution here: {lb.name} {v[k]:.1e} {lb.unit}, "
                    f"allowed at most {most:g}; a smaller tolerance may help"
                ),
                Outcome.SOLVER_FAILURE,
            )
    for check in system.dae.checks:
        label = check.label
        values = run.of(label)
        consider(
            ~(values >= 0),
            label.full,
            lambda k, c=check, v=values: (
                f"{c.label.full}: no value could be computed"
                if np.isnan(v[k])
                else c.describe(samples.x[:, k], samples.z[:, k])
            ),
        )
    return found
