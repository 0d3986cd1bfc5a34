"""Plans of climbs with least time, friction or slip; a leg is the climb of one axle."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from slipfree.climb.contact_path import Leg, legs
from slipfree.climb.time_scaling import Climb, climb, history, in_sequence
from slipfree.plan.external_nlp import solve_nlp
from slipfree.problem.build_common import wheel_angles_at
from slipfree.problem.verbs import climb_schema as schema
from slipfree.records import Array, Label
from slipfree.terrain.solids import Profile
from slipfree.trajectory import Column, SolverError, Trajectory
from slipfree.vehicle.climber import FOLD, Climber

AXLE_QUANTITIES = {
    "wheel_rate": "rad s-1",
    "friction": "N",
    "load": "N",
}  # shown in figures of a plan
POSE = ("y", "z", "tilt_rear", "tilt_front")
PROGRESS = Label("progress", "m", "mean over the axles of x + z")


class Planned(NamedTuple):
    """Plan of a climb.

    Attributes
    ----------
    parts : tuple of (Climb, ndarray)
        Program and solution of every leg.
    run : Trajectory
        Motion over all legs, with the column ``progress``.
    least : tuple of float
        Smallest sufficient coefficient of friction of each leg. [1]
    iterations, seconds : float
        Number of iterations and computing time [s] of the solver.
    """

    parts: tuple[tuple[Climb, Array], ...]
    run: Trajectory
    least: tuple[float, ...]
    iterations: float
    seconds: float


def plan_climb(
    climber: Climber, profile: Profile, spec: schema.Legs, static: float, speed: float
) -> Planned:
    """Return the plan of a climb.

    Parameters
    ----------
    climber, profile : Climber, Profile
        Vehicle and ground.
    spec : Legs
        Table ``[plan]`` of the problem.
    static : float
        Coefficient of friction if ``spec.friction`` is None. [1]
    speed : float
        Largest speed of an axle if ``spec.speed`` is None. [m/s]

    Raises
    ------
    ModelError
        If the vehicle gets stuck, or a coefficient of friction is given for the cost "friction".
    SolverError
        If a leg needs more friction than is available, or the solver finds no plan of a leg.
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
        _with_progress(in_sequence([run for _, run, *_ in chosen]), climber),
        least,
        sum(each.iterations for each in chosen),
        sum(each.seconds for each in chosen),
    )


def _with_progress(run: Trajectory, climber: Climber) -> Trajectory:
    """Return the motion of a plan with the column ``progress``."""
    tilts = (run["tilt_rear"], run["tilt_rear"], run["tilt_front"])
    ahead = [
        axle.ahead * (np.cos(tilt) + np.sin(tilt))
        for axle, tilt in zip(climber.axles, tilts, strict=True)
    ]
    progress = np.asarray(run["y"] + run["z"] + np.mean(ahead, axis=0))
    return replace(run, columns={**run.columns, PROGRESS.name: Column(PROGRESS, progress)})


def plan_statistics(plan: Planned, run: Trajectory) -> dict[str, float]:
    """Return statistics of a plan, and of the motion that tracks it, by name.

    The names begin with ``climb_plan_``. ``climb_plan_driven`` is the time that the motion takes
    for the distance of the plan; it is missing if the motion ends before.

    Parameters
    ----------
    plan : Planned
        Plan of the climb.
    run : Trajectory
        Motion that tracks the plan.
    """
    begin, end = plan.run[PROGRESS.name][[0, -1]]
    progress = (run["center_y"] + run["center_z"]).mean(axis=1)
    found = {
        "climb_plan_duration": plan.run.statistics["duration"],
        "climb_plan_friction": plan.run.statistics["mu"],
        "climb_plan_iterations": plan.iterations,
        "climb_plan_seconds": plan.seconds,
    }
    found |= {f"climb_plan_least_{k + 1}": mu for k, mu in enumerate(plan.least)}
    if progress[-1] > end:
        took = run.t[(progress > end).argmax()] - run.t[(progress > begin).argmax()]
        found["climb_plan_driven"] = float(took)
    return found


def arrays_of(plan: Trajectory) -> dict[str, Array]:
    """Return the samples of a plan as arrays for a result file, by name; one per axle if needed."""
    found = {"plan_time": plan.t}
    for name, column in plan.columns.items():
        if column.values.ndim == 1:
            found[f"plan_{name}"] = column.values
        else:
            found |= {
                f"plan_{name}_{axle}": column.values[:, k] for k, axle in enumerate(plan.wheels)
            }
    return found


class _Solved(NamedTuple):
    plan: Climb
    run: Trajectory
    unknowns: Array
    iterations: float
    seconds: float


def _solved(
    climber: Climber,
    profile: Profile,
    found: Sequence[Leg],
    cost: str,
    mu: float | None,
    speed: float,
    nodes: int,
) -> list[_Solved]:
    solved = []
    for number, leg in enumerate(found):
        plan = climb(
            climber, profile, leg, cost, mu=mu, speed=speed, s=nodes, halt=number < len(found) - 1
        )
        try:
            solution = solve_nlp(plan.nlp)
        except SolverError as error:
            raise SolverError(f"plan, {_leg(number, leg)}: {error}") from error
        run = history(plan, solution.unknowns)
        solved.append(
            _Solved(plan, run, solution.unknowns, solution.iterations, solution.seconds["total"])
        )
    return solved


def _check_friction(found: Sequence[Leg], least: Sequence[float], mu: float) -> None:
    worst = max(range(len(found)), key=lambda k: least[k])
    if least[worst] > mu:
        raise SolverError(
            f"plan, {_leg(worst, found[worst])}: expected a coefficient of friction of at "
            f"least {least[worst]:.3f}, found {mu:g}; lower the obstacle, or increase the "
            "coefficient: plan.friction, or friction.static if plan.friction is not given"
        )


def _leg(number: int, leg: Leg) -> str:
    return f"leg {number + 1}, on which the {leg.axle} wheels climb"


def plan_of(run: Trajectory, arrays: Mapping[str, Array]) -> Trajectory | None:
    """Return the plan stored in the result of a climb; None if no plan is stored."""
    if "plan_time" not in arrays:
        return None
    columns = {PROGRESS.name: Column(PROGRESS, arrays[f"plan_{PROGRESS.name}"])}
    for name, unit in AXLE_QUANTITIES.items():
        values = np.stack([arrays[f"plan_{name}_{axle}"] for axle in run.wheels], axis=1)
        columns[name] = Column(Label(name, unit, f"{name} of the plan"), values)
    statistics = {"mu": run.statistics["climb_plan_friction"]}
    return Trajectory(arrays["plan_time"], columns, run.wheels, statistics=statistics)


def poses_of_plan(
    run: Trajectory, arrays: Mapping[str, Array], climber: Climber
) -> Trajectory | None:
    """Return the poses of the plan stored in the result of a climb; None if no plan is stored.

    The times of the plan are shifted so that it begins when the motion reaches the first value of
    ``progress`` in the plan.
    """
    if "plan_time" not in arrays:
        return None
    labels = {name: column.label for name, column in run.columns.items()}
    columns = {name: Column(labels[name], arrays[f"plan_{name}"]) for name in POSE}
    x, z, rear, front = (columns[name].values for name in POSE)
    ahead = np.array([axle.ahead for axle in climber.axles])
    tilts = np.stack([rear, rear, front], axis=1)
    for name, start, turned in (("center_y", x, np.cos), ("center_z", z, np.sin)):
        places = start[:, None] + ahead * turned(tilts)
        columns[name] = Column(labels[name], places)
    others = dict.fromkeys(("x", "heading", "roll"), np.zeros(x.size))
    others |= {"pitch": rear, FOLD: front - rear}
    others |= dict.fromkeys(("contact_x", "contact_y", "contact_z"), np.full((x.size, 3), np.nan))
    columns |= {name: Column(labels[name], values) for name, values in others.items()}
    progress = (run["center_y"] + run["center_z"]).mean(axis=1)
    begins = run.t[int((progress > arrays[f"plan_{PROGRESS.name}"][0]).argmax())]
    t = begins + arrays["plan_time"]
    return Trajectory(t, columns | {"wheel_angle": wheel_angles_at(run, t)}, run.wheels)
