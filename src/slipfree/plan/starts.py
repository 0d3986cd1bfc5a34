"""Create further initial guesses for a plan, and compare the local optima found from them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.records import Array, field_overview, leaves
from slipfree.core.trajectory import SolverError, Trajectory
from slipfree.solve.options import SolverOptions
from slipfree.solve.simulate import simulate

PERTURBATION = 0.3  # standard deviation of a perturbation, relative to the rms of the input
MODES = 4  # number of cosines in a perturbation
MAX_HALVINGS = 4  # of a perturbation whose motion ends early
SHORTEST = 0.5  # shortest motion that is used as a guess, relative to the duration
GUESS_TOLERANCE = 1e-5  # tolerance of the simulation of guesses [m, rad]
PATH_SAMPLES = 201  # samples at which the paths of two plans are compared
SAME_PATH = 1e-3  # largest distance of paths that count as one optimum [m]
VERIFIED, INACCURATE, SOLVED, NOT_SOLVED = "verified", "inaccurate", "solved", "not solved"
RANKS = (VERIFIED, SOLVED, INACCURATE, NOT_SOLVED)


class LocalOptimum(NamedTuple):
    """Result of the search from one initial guess.

    Attributes
    ----------
    start : str
        Name of the initial guess, such as ``"guess 1"``, ``"reversed"`` or ``"perturbed 2"``.
    outcome : str
        ``"verified"`` (the simulation agrees with the plan), ``"inaccurate"`` (it does not),
        ``"solved"`` (not simulated) or ``"not solved"``.
    cost : float
        Cost of the plan, the sum of all weighted terms.
    terms : dict of str to float
        Unweighted integrals of the terms of the cost, in their units, by name.
    duration : float
        Duration of the plan. [s]
    seconds : float
        Wall time of the search. [s]
    path : ndarray, shape (2, n)
        Positions ``x``, ``y`` at n equally spaced times, in local coordinates; shape (0, n) if the
        model has no such states. [m]
    """

    start: str
    outcome: str
    cost: float
    terms: dict[str, float]
    duration: float
    seconds: float
    path: Array

    def __repr__(self) -> str:
        return field_overview(self)

    @property
    def rank(self) -> tuple[int, float]:
        """Sort key, smallest for the best plan: rank of the outcome, then cost."""
        return RANKS.index(self.outcome), self.cost


def further_guesses(
    dae: Dae, start: Trajectory, guess: Trajectory, bounds: Array, count: int, seed: int
) -> Iterator[tuple[str, Trajectory]]:
    """Yield names and motions of further guesses: reversed inputs, then perturbed inputs.

    Parameters
    ----------
    dae, start : Dae, Trajectory
        Model, and trajectory whose last sample is the start.
    guess : Trajectory
        Motion whose inputs are changed.
    bounds : ndarray, shape (n_u, 2)
        Bounds of the inputs. The reversed guess is left out if the bounds of an input that is not
        zero exclude positive or negative values.
    count : int
        Largest number of guesses. A perturbed guess is left out if its motion ends before half of
        the duration, even with the perturbation halved four times.
    seed : int
        Seed of the random perturbations.

    Raises
    ------
    SolverError
        If a simulation fails before its first sample.
    """
    t = guess.t - guess.t[0]
    inputs = np.array([guess.of(label) for label in leaves(dae.labels.u)])
    sides = bounds[np.abs(inputs).max(axis=1) > 0]
    if count and ((sides[:, 0] < 0) & (sides[:, 1] > 0)).all():
        run = _simulated(dae, start, np.clip(-inputs, bounds[:, :1], bounds[:, 1:]), t)
        if run.t[-1] > 0:
            count -= 1
            yield "reversed", run
    sizes = np.sqrt((inputs**2).mean(axis=1, keepdims=True))
    sizes = np.where(sizes > 0, sizes, np.sqrt((inputs**2).mean()))
    for number in range(1, count + 1):
        rng = np.random.default_rng([seed, number])
        weights = rng.standard_normal((len(inputs), MODES)) / np.sqrt(MODES)
        waves = np.cos(np.pi * np.outer(np.arange(MODES), t / t[-1]))
        change = PERTURBATION * sizes * (weights @ waves)
        for k in range(MAX_HALVINGS + 1):
            values = np.clip(inputs + change / 2**k, bounds[:, :1], bounds[:, 1:])
            run = _simulated(dae, start, values, t)
            if run.t[-1] >= SHORTEST * t[-1]:
                yield f"perturbed {number}", run
                break


def _simulated(dae: Dae, start: Trajectory, inputs: Array, t: Array) -> Trajectory:
    """Simulate inputs given at times ``t``, to the last time or to the first failure."""
    names = [label.full for label in leaves(dae.labels.u)]
    middles = (inputs[:, 1:] + inputs[:, :-1]) / 2
    rough = SolverOptions(tolerance=GUESS_TOLERANCE)
    try:
        return simulate(
            dae, start, dae.inputs(**dict(zip(names, middles, strict=True))), t, options=rough
        )
    except SolverError as error:
        if error.trajectory is None:
            raise
        return error.trajectory


def count_distinct(optima: Sequence[LocalOptimum]) -> int:
    """Return the number of solved plans whose paths differ by more than 1 mm."""
    kept: list[Array] = []
    for each in optima:
        apart = (np.linalg.norm(each.path - path, axis=0).max(initial=0.0) for path in kept)
        if each.outcome != NOT_SOLVED and all(gap > SAME_PATH for gap in apart):
            kept.append(each.path)
    return len(kept)


def distances(optima: Sequence[LocalOptimum]) -> list[float]:
    """Return the largest distance of each path from the first in m, at equal fractions of time."""
    first = optima[0].path
    return [float(np.linalg.norm(each.path - first, axis=0).max(initial=0.0)) for each in optima]
