"""Exact poses of a vehicle at many positions at once."""

from __future__ import annotations

import numpy as np

from slipfree.batch.evaluator import Evaluator
from slipfree.core.records import Array, Mask

PLAIN_STEPS = 8  # steps of Newton's method without bound
BOUNDED_STEPS = 40  # steps of bounded length
MAX_CHANGE = 4.0  # length of a bounded step, as the largest change of a position [typical size]
RAMP_STEPS = 8  # steps in which the slopes of the ground grow to their values
CONVERGED = 1e-7  # last step of Newton's method, whose error is about its square [typical size]
GATHER = 0.75  # the remaining lanes are gathered if their share falls below this


def solve_positions(evaluate: Evaluator, states: Array) -> Mask:
    """Solve the positions of states for the other rows; return which were found, shape (n,).

    Newton's method starts from the guess of the model. Where plain steps do not converge, steps of
    bounded length follow, and then steps on a ground whose slopes grow from zero: either finds
    poses on rough ground that the other misses.
    """
    graphs = evaluate.graphs
    with np.errstate(all="ignore"):
        guess = evaluate(graphs.guess, states)
        for rows, part in zip(graphs.rows.z, graphs.guess.parts[:3], strict=True):
            states[rows] = guess[part]
        first = guess[graphs.guess.parts[0]]
        solved = _newton(evaluate, states, PLAIN_STEPS, np.inf, 0)
        for ramp in (0, RAMP_STEPS):
            left = ~solved
            if not left.any():
                break
            some = states[:, left]
            some[graphs.rows.p] = first[:, left]
            solved[left] = _newton(evaluate, some, BOUNDED_STEPS, MAX_CHANGE, ramp)
            states[:, left] = some
    return solved


def _newton(evaluate: Evaluator, states: Array, count: int, longest: float, ramp: int) -> Mask:
    """Correct the positions by at most ``count`` steps; return which steps converged."""
    place, p = evaluate.graphs.place, evaluate.graphs.rows.p
    solved, lanes = np.zeros(states.shape[1], dtype=bool), np.arange(states.shape[1])
    part, done = states, solved.copy()
    for k in range(count):
        slope = min(1.0, (k + 1) / ramp) if ramp else 1.0
        values = evaluate(place, part, slope)
        new, change = values[place.parts[0]], values[place.parts[1]][0]
        if np.isfinite(longest):
            new = part[p] + (new - part[p]) * np.minimum(1.0, longest / change)
        # a lane that is done keeps its result, whatever the others need
        part[p] = np.where(done, part[p], new)
        done |= (change < CONVERGED) & (slope == 1.0)
        if done.mean() > 1 - GATHER or k == count - 1:
            states[:, lanes], solved[lanes] = part, done
            lanes, part, done = lanes[~done], part[:, ~done], done[~done]
            if not lanes.size:
                break
    return solved
