"""Integrate one motion with the fixed steps of the batch, refined until its error is small."""

from __future__ import annotations

import casadi as ca
import numpy as np

from slipfree.batch.evaluator import evaluator_of
from slipfree.batch.many import assemble_state
from slipfree.batch.motion import ORDER, RELAXING_ORDER, integrate_lanes
from slipfree.core.dae import PiecewiseLinear
from slipfree.core.errors import ModelError
from slipfree.core.evaluation import evaluate
from slipfree.core.records import Array, Record, leaves
from slipfree.solve.options import SolverOptions
from slipfree.solve.sampling import Samples
from slipfree.solve.system import System

FIRST_STEP = 0.5  # length of the steps of the first try [size of the vehicle]
SAFETY, MIN_RATIO = 0.8, 0.02  # of the step that an estimated error suggests; of two steps
MAX_TRIES = 12


def integrate_explicitly(
    system: System, inputs: Record, first: Samples, t: Array, options: SolverOptions
) -> tuple[Samples, dict[str, float]]:
    """Return the samples that a motion reaches, and counts of the integrator.

    The whole motion is repeated with smaller steps until the estimated error of ``x`` and ``y`` at
    its end is below the tolerance, times the size of the vehicle. Quadratures that depend on forces
    are integrated from the samples by the trapezoidal rule. Beyond a limit there are no samples.
    ModelError is raised if the batch does not take the model or an input, or the tolerance is not
    reached.
    """
    dae = system.dae
    for label, value in zip(leaves(dae.labels.u), leaves(inputs), strict=True):
        if isinstance(value, ca.SX | PiecewiseLinear):
            raise ModelError(
                f"input {label.full}: expected numbers for the method 'explicit', found "
                f"{type(value).__name__}; give a value for each interval, or use the method 'idas'"
            )
    evaluator = evaluator_of(dae, compiled=options.compiled)
    state = assemble_state(evaluator.graphs, first.x[:, 0], first.z[:, 0], first.q[:, 0])
    order = ORDER if dae.lag is None else RELAXING_ORDER
    step, wanted = FIRST_STEP * dae.size, options.tolerance * dae.size
    total, inputs_of_lane = 0, system.u[..., None]
    for _ in range(MAX_TRIES):
        run = integrate_lanes(evaluator, state[:, None], inputs_of_lane, t, step, certify=False)
        total += int(run.steps[0])
        error = float(np.hypot(*run.errors[list(evaluator.graphs.places[:2]), 0]))
        if error <= wanted or np.isnan(error):  # NaN: the first interval is not solved
            break
        step *= float(np.clip(SAFETY * (wanted / error) ** (1 / order), MIN_RATIO, SAFETY))
    else:
        raise ModelError(
            f"method: 'explicit' did not reach the tolerance {options.tolerance:g} in {MAX_TRIES} "
            f"refinements, the last with steps of {step:.2g} m; use a larger tolerance, or 'idas'"
        )
    counts = {"steps": float(run.steps[0]), "residuals": 9.0 * total, "set_ups": 0.0}
    states = run.samples[..., 0]
    count = int(np.isfinite(states[:, 0]).sum())
    if count < 2:  # no interval to integrate over
        return first, counts
    graphs, t, columns = evaluator.graphs, t[:count], states[:count].T
    rows, u = graphs.rows, np.append(system.u, system.u[:, -1:], axis=1)[:, :count]
    z = np.concatenate([np.arange(len(columns))[part] for part in rows.z])
    motion = z[: system.motion_size]

    def rates(t: Array, columns: Array, u: Array) -> Array:
        return evaluate(system.watch, t[None], columns[rows.x], columns[motion], u)[0]

    before = columns[:, 1:].copy()  # with the inputs of the interval that ends at a sample
    before[rows.u] = u[:, :-1]
    before[rows.w] = evaluator(graphs.motion, before)[graphs.motion.parts[2]]
    mean = (rates(t[:-1], columns[:, :-1], u[:, :-1]) + rates(t[1:], before, u[:, :-1])) / 2
    q = first.q + np.cumsum(np.append(0 * first.q, np.diff(t) * mean, axis=1), axis=1)
    q[list(graphs.quadratures)] = columns[rows.q]
    return Samples(t, columns[rows.x], columns[z], q, u), counts
