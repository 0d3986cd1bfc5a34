"""From a problem of planning to a plan, and the motion that it leads to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from slipfree.dae import Dae
from slipfree.errors import SolverError
from slipfree.kinematics.rolling import direct_kinematics
from slipfree.named import leaves
from slipfree.plan.plan import Plan, plan
from slipfree.plan.solver import Iterate
from slipfree.problem import schema
from slipfree.problem.direct import build_law
from slipfree.problem.ground import at, build_ground
from slipfree.problem.parts import (
    Setup,
    build_start,
    build_terrain,
    build_vehicle,
    check_names,
    samples,
    turned,
)
from slipfree.problem.read import Problem, S
from slipfree.solve.simulate import simulate
from slipfree.trajectory import Stop, Trajectory

Tell = Callable[[str], None]


def build_plan(problem: Problem[S], spec: schema.Plan) -> Setup:
    """Return the model, the settled start and the inputs that start the search."""
    ground = build_ground(problem)
    with at(problem, ("vehicle",)):
        vehicle = build_vehicle(spec.vehicle)
    terrain = build_terrain(problem, ground)
    dae: Dae[Any, Any, Any, Any, Any]
    with at(problem, ("slip",)):
        dae = direct_kinematics(vehicle, terrain, slip=spec.slip)
    check_names(problem, dae, spec.inputs)
    start = build_start(problem, dae)
    t, rates = samples(spec.time, spec.inputs or {})
    if spec.driver is None:
        with at(problem, ("inputs",)):
            inputs = dae.inputs(**rates)
    else:
        inputs = build_law(problem, spec.driver, dae, vehicle, start)
    goal = ", ".join(f"{name} {_words(value)}" for name, value in spec.goal.items())
    return Setup(ground, terrain, vehicle, dae, dae, start, inputs, t, f"plan to {goal}")


def _words(bounds: tuple[float, float]) -> str:
    low, high = bounds
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"


def planned(problem: Problem[S], spec: schema.Plan, setup: Setup, tell: Tell | None) -> Trajectory:
    """Return the motion that a plan leads to, simulated, with what the plan promised."""
    with at(problem, ("driver" if spec.driver else "inputs",)):
        guess = _guess(setup, spec)
    goal = dict(spec.goal)
    if "heading" in goal:
        goal["heading"] = tuple(value + turned(problem) for value in goal["heading"])
    with at(problem, ("plan",)):
        found = plan(
            setup.dae, setup.start, guess, goal=goal, costs=spec.costs,
            duration=spec.plan.duration or spec.time.duration, smooth=spec.plan.smooth,
            limits=spec.limits, inputs=spec.bounds, accelerations=spec.accelerations,
            intervals=spec.plan.intervals, degree=spec.plan.degree,
            tolerance=spec.solver.tolerance, progress=_telling(tell),
        )  # fmt: skip
    return _motion(setup, spec, found)


def _guess(setup: Setup, spec: schema.Plan) -> Trajectory:
    try:
        return simulate(setup.dae, setup.start, setup.inputs, setup.t,
                        tolerance=spec.solver.tolerance)  # fmt: skip
    except SolverError as error:
        if error.trajectory is None:
            raise
        return error.trajectory


def _telling(tell: Tell | None) -> Callable[[str, Iterate], bool]:
    """Return what tells every iterate in a line, and stops the search at Ctrl-C."""

    def progress(words: str, iterate: Iterate) -> bool:
        line = f"{words}: iteration {iterate.number}, cost {iterate.cost:.6g}, violation " \
               f"{iterate.violation:.1e}"  # fmt: skip
        try:
            if tell is not None:
                tell(line)
        except KeyboardInterrupt:
            return False
        return True

    return progress


def _motion(setup: Setup, spec: schema.Plan, found: Plan) -> Trajectory:
    """Return the replay, sampled as the problem asks."""
    ends = found.run.t[:: spec.plan.degree]
    parts = max(int(np.ceil(np.diff(ends).max() / spec.time.step)), 1)
    t = np.append(np.concatenate([np.linspace(a, b, parts, endpoint=False)
                                  for a, b in pairwise(ends)]),
                  ends[-1])  # fmt: skip
    names = [label.full for label in leaves(setup.dae.labels.u)]
    values = {name: np.repeat(value, parts)
              for name, value in zip(names, leaves(found.inputs), strict=True)}  # fmt: skip
    try:
        run = simulate(setup.dae, setup.start, setup.dae.inputs(**values), t,
                       tolerance=spec.solver.tolerance)  # fmt: skip
    except SolverError as error:
        if error.trajectory is None:
            raise
        run = error.trajectory
    if not found.success:
        words = f"the plan was not solved: {found.solution.status}; this is its last iterate"
        run = replace(run, stop=run.stop or Stop("plan", float(run.t[-1]), words))
    return replace(run, statistics={**run.statistics, **_statistics(found)})


def _statistics(found: Plan) -> dict[str, float]:
    """Return what a plan cost, and how far its simulation is from it."""
    times = [stage.seconds for stage in found.stages]
    return {
        "plan_iterations": float(sum(stage.iterations for stage in found.stages)),
        "plan_seconds": sum(each["total"] for each in times),
        "plan_seconds_functions": sum(each["functions"] for each in times),
        **{f"plan_cost_{name}": value for name, value in found.costs.items()},
        **{f"plan_difference_{name}": value for name, value in found.difference.items()},
    }
