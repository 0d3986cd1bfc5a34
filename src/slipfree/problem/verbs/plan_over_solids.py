"""Plans of a step climber over solids: time scaling along the contact path, leg by leg."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from math import inf
from typing import Any, NamedTuple

import numpy as np

from slipfree.catalog import check_climber
from slipfree.climb import contact_path
from slipfree.climb.contact_path import COSTS
from slipfree.control.step_climbing import climbing
from slipfree.core.errors import ModelError
from slipfree.core.facts import Fact
from slipfree.core.records import Array
from slipfree.core.trajectory import PLAN_ACCURACY, Outcome, SolverError, Stop, Trajectory
from slipfree.files.netcdf import NOTHING
from slipfree.files.toml import Fault, problem_error
from slipfree.plan.constraints import missed_words
from slipfree.plan.ipopt import solve_nlp
from slipfree.problem import build
from slipfree.problem.build_ground import at
from slipfree.problem.problem import Problem
from slipfree.problem.schema import STEP_CLIMBING, Modelled
from slipfree.problem.verbs.base import Watch, integrate
from slipfree.problem.verbs.plan_setup import GuideTable, PlanKeys
from slipfree.solve.sampling import input_samples
from slipfree.terrain.solids import Profile
from slipfree.vehicle.tree import Vehicle

KEYS = {
    "": {"goal", "costs", "limits", "plan", "driver"},
    "goal": {"y"},
    "costs": {*COSTS},
    "limits": {"utilisation"},
    "plan": {"intervals"},
    "driver": {"name", "speed", "control"},
    "driver.control": {"proportional", "torque", "motors"},
}  # supported keys of plans over solids, by table; other keys of plans are errors
LEG_INTERVALS = 40  # default number per leg
OF_PLANS = {*PlanKeys.model_fields} - {*Modelled.model_fields}


class Planned(NamedTuple):
    """Plan of a climb: program, solution and history of every leg, and the solver's effort."""

    parts: tuple[tuple[contact_path.Climb, Array, contact_path.ClimbHistory], ...]
    least: tuple[float, ...]  # smallest sufficient friction of each leg [1]
    iterations: float
    seconds: float  # computing time of the solver [s]
    functions: float  # part of it in functions [s]


@dataclass(frozen=True, eq=False)
class OverSolids(build.Setup):
    """Set-up of the simulation of a plan over solids; ``dae`` has the controller that tracks it."""

    plan: Planned


def build_over_solids(problem: Problem[PlanKeys]) -> OverSolids:
    """Return the plan of a problem over solids, and the set-up of its simulation.

    SolverError is raised if a leg needs more friction than is available, or has no plan.
    """
    spec = problem.spec
    faults = [*_faults(spec)]
    if faults or spec.driver is None:
        raise problem_error(problem.source, faults)
    world, driver = build.build_world(problem), spec.driver
    model = build.build_shared_model(problem, world)
    with at(problem, ("vehicle",)):
        check_climber(world.vehicle)
    with at(problem, ("terrain",)):
        section = build.level_section(world)
        if section is None:
            raise ModelError(
                "plan: expected a level ground below the solids, found another one; make its "
                "heights equal"
            )
    with at(problem, ("plan",)):
        plan = plan_climb(spec, driver, world.vehicle, section)
        tracking = contact_path.Tracking(
            contact_path.tracked_plan([part[:2] for part in plan.parts]),
            **driver.control.model_dump(exclude_unset=True),
        )
    dae = climbing(model, tracking)
    start, (t, _) = (
        build.build_start(problem, dae),
        input_samples(spec.time.duration, spec.time.step, {}),
    )
    inputs = dae.inputs(reference_speed=driver.speed)
    driven = f"plan over solids, tracked at {driver.speed:g} m/s before and after it"
    drive: dict[str, Any] = {"start": start, "inputs": inputs, "t": t, "driven": driven}
    return OverSolids(**vars(world), model=model, dae=dae, **drive, plan=plan)


def _faults(spec: PlanKeys) -> Iterator[Fault]:
    """Yield the keys that a plan over solids requires or does not support."""
    tables = {"": spec, **{name: getattr(spec, name) for name in KEYS if name.isalpha()}}
    if spec.driver is None or spec.driver.name != STEP_CLIMBING:
        found = "another guide; change it"
        yield Fault(("driver", "name"), f"{STEP_CLIMBING!r} for a plan over solids", found)
        return
    if spec.time.duration == inf:
        yield Fault(
            ("time", "duration"), "the duration of the simulation of the plan", "none; add it"
        )
    tables["driver.control"] = spec.driver.control
    for name, table in tables.items():
        keys = {*table} if isinstance(table, Mapping) else table.model_fields_set
        for key in sorted((keys & OF_PLANS if not name else keys) - KEYS[name]):
            place = *filter(None, name.split(".")), key
            known = ", ".join(sorted(KEYS[name]))
            yield Fault(place, f"one of {known} for a plan over solids", f"{key!r}; remove it")
    if sum(weight > 0 for weight in spec.costs.values()) != 1:
        yield Fault(("costs",), f"one cost, of {', '.join(COSTS)}", f"{len(spec.costs)}")
    if "utilisation" in spec.limits and spec.costs.get("friction"):
        found = "it; remove it, or choose another cost"
        yield Fault(("limits", "utilisation"), "no limit with the cost 'friction'", found)


def plan_climb(spec: PlanKeys, driver: GuideTable, climber: Vehicle, section: Profile) -> Planned:
    """Return the plan of a climb; errors are those of `build_over_solids`."""
    cost = next(name for name, weight in spec.costs.items() if weight > 0)
    if not isinstance(spec.terrain.friction, float):
        raise ModelError(
            f"expected a coefficient of friction in [terrain], found {spec.terrain.friction!r}; "
            "give a number"
        )
    most = spec.limits.get("utilisation", (0.0, 1.0))[1] * spec.terrain.friction
    parts = contact_path.legs(climber, section)
    options: dict[str, Any] = {
        "speed": driver.speed,
        "torques": [driver.control.torque * n for n in driver.control.motors],
        "s": (spec.plan.intervals or LEG_INTERVALS) + 1,
    }

    def solved(
        cost: str, mu: float | None
    ) -> Iterator[tuple[contact_path.Climb, Array, contact_path.ClimbHistory, Array]]:
        for k, leg in enumerate(parts):
            halt = leg is not parts[-1]
            plan = contact_path.climb(climber, section, leg, cost, mu=mu, halt=halt, **options)
            try:
                solution = solve_nlp(plan.nlp)
            except SolverError as error:
                raise SolverError(f"plan, {_leg(k, leg)}: {error}") from error
            costs = np.array([solution.iterations, *solution.seconds.values()])
            yield plan, solution.unknowns, contact_path.history(plan, solution.unknowns), costs

    chosen = [*solved("friction", None)]
    least = tuple(told.mu for _, _, told, _ in chosen)
    if cost != "friction":
        worst = int(np.argmax(least))
        if least[worst] > most:
            raise SolverError(
                f"plan, {_leg(worst, parts[worst])}: expected a coefficient of friction of at "
                f"least {least[worst]:.3f}, found {most:g}; lower the obstacle, or increase "
                "terrain.friction or limits.utilisation"
            )
        chosen = [*solved(cost, most)]
    effort = np.sum([costs for *_, costs in chosen], axis=0)[:3]
    return Planned(tuple(each[:3] for each in chosen), least, *effort)


def _leg(number: int, leg: contact_path.Leg) -> str:
    return f"leg {number + 1}, on which the {leg.axle} wheels climb"


def drive_over_solids(
    problem: Problem[PlanKeys], setup: OverSolids, watch: Watch
) -> tuple[Trajectory, Mapping[str, Array]]:
    """Return the simulated motion that tracks a plan, with the errors and costs of the plan."""
    spec, plan = problem.spec, setup.plan
    run = integrate(setup, build.solver_options(problem), watch)
    low, high = spec.goal.get("y", (-np.inf, np.inf))
    y = float(run["y"][-1])
    missed = max(low - y, y - high, 0.0)
    facts = {
        "plan_iterations": Fact(plan.iterations, "1"),
        "plan_seconds": Fact(plan.seconds, "s"),
        "plan_seconds_functions": Fact(plan.functions, "s"),
        "plan_cost_time": Fact(sum(told.duration for *_, told in plan.parts), "s"),
        "plan_cost_friction": Fact(max(told.mu for *_, told in plan.parts), "1"),
        "plan_violation_y_goal": Fact(missed, "m", "y at the goal"),
        "plan_accuracy": Fact(spec.plan.accuracy),
        **{f"plan_least_friction_{k + 1}": Fact(mu, "1") for k, mu in enumerate(plan.least)},
        **_tracking(setup, run),
    }
    stop = run.stop
    if missed:
        words = missed_words({"y at the goal": missed}, {"y at the goal": "m"})
        reason = f"no usable plan: its simulation misses {words}; see 'obstacles'"
        stop = stop or Stop(PLAN_ACCURACY, float(run.t[-1]), reason, Outcome.INACCURATE)
    return replace(run, stop=stop).with_facts(facts), NOTHING


def _tracking(setup: OverSolids, run: Trajectory) -> dict[str, Fact]:
    """Return the time of the motion for the distance of the plan, and its largest errors, by name.

    Both are compared at equal progress, the mean of y + z over the axles, as far as the motion
    reaches; the time is missing if it does not reach the end.
    """
    paths = [plan.middles for plan, *_ in setup.plan.parts]
    planned = np.concatenate([contact_path.progress(path) for path in paths])
    _, z, rear, front = np.concatenate([path.q for path in paths]).T
    reached = np.maximum.accumulate((run["center_y"] + run["center_z"]).mean(axis=1))
    part = planned <= reached[-1]
    pose = {"z": z, "pitch": rear, setup.vehicle.coordinates[0].name: front - rear}
    facts = dict[str, Fact]()
    for name, values in pose.items():
        errors = np.abs(np.interp(planned[part], reached, run[name]) - values[part])
        unit = run.columns[name].label.unit
        facts[f"plan_difference_{name}"] = Fact(float(errors.max(initial=0.0)), unit)
    if part.all():
        begin, end = np.searchsorted(reached, planned[[0, -1]])
        facts["plan_driven"] = Fact(float(run.t[end] - run.t[begin]), "s")
    return facts
