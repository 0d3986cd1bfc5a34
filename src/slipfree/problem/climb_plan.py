"""Plans of climbs: least time, friction or slip, leg by leg, and the friction that they need."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from slipfree.climb.path import Climb, climb, history, in_sequence
from slipfree.climb.profile import Profile
from slipfree.climb.vehicle import Climber
from slipfree.climb.way import Leg, legs
from slipfree.errors import SolverError
from slipfree.named import Array
from slipfree.plan.nlp import solve_nlp
from slipfree.problem import schema
from slipfree.trajectory import Trajectory


class Planned(NamedTuple):
    """A planned climb.

    Attributes
    ----------
    parts : tuple of (Climb, ndarray)
        Program and solution of every leg.
    run : Trajectory
        All legs, one after the other.
    least : tuple of float
        Coefficients of friction without which no leg can be climbed. [1]
    iterations, seconds : float
        Of the solver, for the plan itself.
    """

    parts: tuple[tuple[Climb, Array], ...]
    run: Trajectory
    least: tuple[float, ...]
    iterations: float
    seconds: float


def plan_climb(
    climber: Climber, profile: Profile, spec: schema.Legs, static: float, speed: float
) -> Planned:  # fmt: skip
    """Return the plan of a climb.

    Parameters
    ----------
    climber, profile : Climber, Profile
        What climbs what.
    spec : Legs
        What is asked of the plan.
    static : float
        Coefficient of friction that it may use, unless it names its own. [1]
    speed : float
        Largest of an axle, unless it names its own. [m/s]

    Raises
    ------
    ModelError
        If the vehicle gets stuck, or the plan is asked for the least friction and given one.
    SolverError
        If a leg needs more friction than there is, or none is enough.
    """
    found = legs(climber, profile)
    fastest = speed if spec.speed is None else spec.speed
    mu = static if spec.friction is None and spec.cost != "friction" else spec.friction
    cheapest = _solved(climber, profile, found, "friction", None, fastest, spec.nodes)
    least = tuple(run.statistics["mu"] for _, run, *_ in cheapest)
    if mu is not None:
        _check_friction(found, least, mu)
    chosen = cheapest
    if spec.cost != "friction" or mu is not None:
        chosen = _solved(climber, profile, found, spec.cost, mu, fastest, spec.nodes)
    return Planned(
        tuple((plan, unknowns) for plan, _, unknowns, *_ in chosen),
        in_sequence([run for _, run, *_ in chosen]), least,
        sum(each.iterations for each in chosen), sum(each.seconds for each in chosen),
    )  # fmt: skip


class _Solved(NamedTuple):
    plan: Climb
    run: Trajectory
    unknowns: Array
    iterations: float
    seconds: float


def _solved(
    climber: Climber, profile: Profile, found: Sequence[Leg], cost: str, mu: float | None,
    speed: float, nodes: int,
) -> list[_Solved]:  # fmt: skip
    solved = []
    for number, leg in enumerate(found):
        plan = climb(climber, profile, leg, cost, mu=mu, speed=speed, s=nodes,
                     halt=number < len(found) - 1)  # fmt: skip
        try:
            solution = solve_nlp(plan.nlp)
        except SolverError as error:
            raise SolverError(f"plan, {_leg(number, leg)}: {error}") from error
        run = history(plan, solution.unknowns)
        solved.append(_Solved(plan, run, solution.unknowns, solution.iterations,
                              solution.seconds["total"]))  # fmt: skip
    return solved


def _check_friction(found: Sequence[Leg], least: Sequence[float], mu: float) -> None:
    worst = max(range(len(found)), key=lambda k: least[k])
    if least[worst] > mu:
        raise SolverError(
            f"plan, {_leg(worst, found[worst])}: needs a coefficient of friction of at least "
            f"{least[worst]:.3f}, found {mu:g}; take a lower obstacle or better ground"
        )


def _leg(number: int, leg: Leg) -> str:
    return f"leg {number + 1}, on which the {leg.axle} wheels climb"
