"""From a problem of planning to a plan, and the motion that it leads to."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np

from slipfree.dae import Dae, Limit
from slipfree.errors import ModelError, SolverError
from slipfree.geometry.path import Path
from slipfree.kinematics.follow import follow
from slipfree.kinematics.rolling import direct_kinematics
from slipfree.named import Label, leaves
from slipfree.plan.plan import Plan, limits_of, plan
from slipfree.plan.region import Disc, Polygon, Region
from slipfree.plan.route import extents, route, traversability
from slipfree.plan.solver import Iterate
from slipfree.problem import schema
from slipfree.problem.direct import build_law
from slipfree.problem.ground import at, build_ground
from slipfree.problem.locate import ProblemError
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
from slipfree.terrain.bicubic import Bicubic
from slipfree.trajectory import Trajectory
from slipfree.vehicle.chain import Vehicle

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
    elif spec.driver.name == "route":
        inputs, lasts = _along_route(problem, spec, (dae, vehicle, terrain), start)
        t = t[: max(int((t <= lasts).sum()), 2)]  # behind its end a path leads nowhere
    else:
        inputs = build_law(problem, spec.driver, dae, vehicle, start)
    goal = ", ".join(f"{name} {_words(value)}" for name, value in spec.goal.items())
    return Setup(ground, terrain, vehicle, dae, dae, start, inputs, t, f"plan to {goal}")


def _along_route(
    problem: Problem[S],
    spec: schema.Plan,
    model: tuple[Dae[Any, Any, Any, Any, Any], Vehicle, Bicubic],
    start: Trajectory,
) -> tuple[Any, float]:
    """Return the law that follows a route to the middle of the goal, and how long that lasts."""
    dae, vehicle, terrain = model
    driver = spec.driver
    if driver is None or not {"x", "y"} <= set(spec.goal):
        raise ProblemError(f"{problem.source.where(('goal',))}: a route needs a goal in x and y")
    here = (float(start["x"][-1]), float(start["y"][-1]))
    there = (sum(spec.goal["x"]) / 2, sum(spec.goal["y"]) / 2)
    with at(problem, ("driver",)):
        layers = traversability(terrain, vehicle, keep_out=regions(problem, spec))
        points = route(layers, here, there, turning_radius=driver.turning_radius)
        path = Path(points)
        return follow(dae, vehicle, path, speed=driver.speed), path.length / abs(driver.speed)


def regions(problem: Problem[S], spec: schema.Plan) -> tuple[Region, ...]:
    """Return the places to keep out of."""
    found: list[Region] = []
    for index, each in enumerate(spec.keep_out):
        with at(problem, ("keep_out", index)):
            disc = (each.x, each.y, each.radius)
            if each.points is not None and disc == (None, None, None):
                found.append(Polygon(each.points))
            elif each.points is None and None not in disc:
                found.append(Disc(*(float(value or 0.0) for value in disc)))
            else:
                raise ModelError("keep_out: expected either x, y and radius, or points")
    return tuple(found)


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
    length = float(guess.t[-1])
    with at(problem, ("plan",)):
        found = plan(
            setup.dae, setup.start, guess, goal=goal, costs=spec.costs,
            duration=spec.plan.duration or (length, length), smooth=spec.plan.smooth,
            limits=(*limits_of(setup.dae, spec.limits), *_kept_out(problem, spec, setup)),
            inputs=spec.bounds, accelerations=spec.accelerations,
            intervals=spec.plan.intervals, degree=spec.plan.degree,
            tolerance=spec.solver.tolerance, progress=_telling(tell),
        )  # fmt: skip
    return _motion(setup, spec, found)


def _kept_out(problem: Problem[S], spec: schema.Plan, setup: Setup) -> list[Limit]:
    """Return that the circle around the wheels keeps out of the places that are named."""
    x, y = setup.dae.x.x, setup.dae.x.y
    o_x, o_y, _ = setup.terrain.origin
    _, _, reach = extents(setup.vehicle)
    return [
        Limit(Label(f"keep_out_{k}", "m", f"the vehicle touches {region.words}"),
              region.outside(x + o_x, y + o_y), reach, np.inf)
        for k, region in enumerate(regions(problem, spec))
    ]  # fmt: skip


def _guess(setup: Setup, spec: schema.Plan) -> Trajectory:
    """Return the motion of the driving law, along a route up to where it is nearest to the goal."""
    try:
        run = simulate(setup.dae, setup.start, setup.inputs, setup.t,
                       tolerance=spec.solver.tolerance)  # fmt: skip
    except SolverError as error:
        if error.trajectory is None:
            raise
        run = error.trajectory
    if spec.driver is None or spec.driver.name != "route":
        return run
    away = np.hypot(*(run[name] - sum(spec.goal[name]) / 2 for name in ("x", "y")))
    return run.part(slice(max(int(away.argmin()), 1) + 1))


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
    if not found.success and found.run.stop is not None:
        run = replace(run, stop=found.run.stop._replace(t=float(run.t[-1])))
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
