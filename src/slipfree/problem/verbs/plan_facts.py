"""Facts of a plan, and the rows of its summary that show them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from slipfree.core.facts import Fact, Facts, rows, starting_with
from slipfree.core.records import leaves
from slipfree.core.trajectory import PLAN, Trajectory
from slipfree.plan.constraints import COST, DURATION, missed_words
from slipfree.plan.ipopt import TIME_STATUS
from slipfree.plan.optimality import Optimality, price_rows, prices_words
from slipfree.plan.plan import Plan
from slipfree.plan.problem import spelled
from slipfree.plan.windows import LongPlan
from slipfree.problem.verbs.plan_setup import Planning
from slipfree.solve.sampling import TURN

DIFFERENCE, VIOLATION, PLAN_COST = "plan_difference_", "plan_violation_", "plan_cost_"
ROUNDING = 1e-6  # smaller violations count as rounding, in the unit of the limit
SLIDING = 0.95  # wheels with a larger utilisation count as sliding
TIME_LIMITED = "the search ended early; the plan meets all constraints, its cost may not be least"
ROWS = rows(
    """\
*iterate: {iterate}
*!time limit: {plan_time_limit}
plan: {plan_iterations:.0f} iterations, {plan_seconds:.3g}, of which \
{plan_seconds_functions:.3g} in functions; <plan_cost_*> {name} {fact:.6g}
*whole turns: <whole_turns> {fact}
windows: {windows}
starts: {plan_optima:.0f} local optima from {start_count} starts
  {start}: <plan_starts> {outcome}, cost {cost:.6g}, duration {duration:.4g} s, path up to \
{distance:.2g} m from the best one; {seconds:.2g} s of search
*!simulated: {simulated}
!optimality: {optimality}
prices of limits: {prices}
*!robust plan: holds in {plan_share:.3g>%} of {plan_share_draws:.0f} drawn worlds \
({plan_share_low.words} {plan_share_low:.3g>%} to {plan_share_high:.3g>%}), before tightening in \
{plan_share_first:.3g>%}
  tightened: <plan_tightened> {bound} by {size:.3g}{unit}
  cost of this: total {plan_total_cost:.6g}; without tightening <plan_untightened_*> {name} \
{fact:.6g}
  violated: <plan_violated> {bound} in {draws}
  tighter limits: not solved: {plan_tightening_failure}
  end: {plan_share_distance:.3g} from that of the plan at the median, \
{plan_share_distance_95:.3g} at 95 %
!simulated with compliant contacts: on compliant contacts the platform stays within \
{momentum_distance:.2g>mm} of the plan; least normal force of a wheel \
{momentum_force_normal_plan:.3g} ({momentum_force_normal_plan.words}) in the plan, \
{momentum_force_normal:.3g} ({momentum_force_normal.words}) in the simulation
!driven slowly: without inertia the same path needs torques of {slow_torque:.3g} in all (at x = \
{slow_x:.2f}, y = {slow_y:.2f}); the plan needs at most {slow_torque_plan:.3g}
!driven slowly: {slow_failure}
*!simulated with friction: ends {friction_end_distance:.3g} from the plan, slips \
{friction_slip_per_path:.3g>mm/m} per wheel, utilisation at most \
{friction_utilisation_largest:.3g}[ ({slides})]
*!simulated with friction: {friction_failure}
!simulated with inertia: ends {soil_end_distance:.3g} from the plan, slip ratio \
{soil_slip_ratio_largest:.3g} at most, sinkage {soil_sinkage_largest:.3g>mm} at most, work \
{soil_work:.4g} (plan: {soil_slip_ratio_largest_plan:.3g}, {soil_sinkage_largest_plan:.3g>mm}, \
{soil_work_plan:.4g})
!simulated with inertia: {soil_failure}
!with wheels ten times stiffer: ends {stiff_end_distance:.3g} from the plan
!with wheels ten times stiffer: {stiff_failure}"""
)


def facts_of(plan: Plan | LongPlan, setup: Planning) -> dict[str, Fact]:
    """Return the facts of a plan: iterations, times, costs, differences and violations."""
    times = [stage.seconds for stage in plan.stages]
    is_limited = plan.accurate and any(stage.status == TIME_STATUS for stage in plan.stages)
    return {
        "plan_iterations": Fact(sum(stage.iterations for stage in plan.stages), "1"),
        "plan_seconds": Fact(sum(each["total"] for each in times), "s"),
        "plan_seconds_functions": Fact(sum(each["functions"] for each in times), "s"),
        **{f"{PLAN_COST}{name}": Fact(value) for name, value in plan.costs.items()},
        **_differences(plan),
        **{
            VIOLATION + re.sub("[^a-zA-Z0-9.]+", "_", name).strip("_"): Fact(
                size, plan.units[name], name
            )
            for name, size in plan.violation.items()
        },
        "plan_accuracy": Fact(setup.spec.plan.accuracy),
        "plan_compiled": Fact(float(plan.compiled), "1"),
        "plan_intervals": Fact(plan.motion.mesh.ends.size - 1, "1"),
        "plan_searches": Fact([stage.words for stage in plan.stages]),
        **_turns(setup, plan),
        **({"plan_time_limit": Fact(TIME_LIMITED)} if is_limited else {}),
    }


def _differences(plan: Plan | LongPlan) -> dict[str, Fact]:
    facts = dict[str, Fact]()
    for name, size in plan.difference.items():
        key = DIFFERENCE + name.partition("[")[0]  # the largest of the wheels
        if key not in facts or size > facts[key].value:
            facts[key] = Fact(size, plan.units[name])
    return facts


def _turns(setup: Planning, plan: Plan | LongPlan) -> dict[str, Fact]:
    """Return a table of angles that differ by whole turns from the goal or the plan."""
    rows = list[dict[str, Any]]()
    end = plan.motion.states(np.ones(1))[:, 0] + setup.dae.shift[0] if plan.success else ()
    for label, value in zip(leaves(setup.dae.labels.x), end, strict=False):
        if label.unit != "rad":
            continue
        name = label.full
        apart = round((float(plan.replay.of(label)[-1]) - value) / TURN)
        if apart and plan.accurate:
            rows.append({"angle": name, "turns": apart, "than": "plan"})
        low, high = setup.spec.goal.get(name, (-np.inf, np.inf))
        reached = float(value) + setup.dae.reported.get(name, 0.0)
        turns = round((reached - (low + high) / 2) / TURN) if high - low < TURN else 0
        if turns and not low - np.pi < reached < high + np.pi:
            goal = spelled((low, high))
            rows.append(
                {"angle": name, "turns": turns, "than": "goal", "end": reached, "goal": goal}
            )
    return {"plan_turns": Fact(rows)} if rows else {}


def optimality_facts(plan: Plan) -> dict[str, Fact]:
    """Return the second-order conditions and the prices of the limits of a solved plan."""
    facts = {
        f"plan_price_{price.label.name}": Fact(price.rate)
        for price in plan.prices
        if price.role in (COST, DURATION)
    }
    if plan.optimality is None:
        return facts
    checked = {f"plan_{name}": Fact(v, "1") for name, v in plan.optimality._asdict().items()}
    return {**facts, **checked, "plan_prices": Fact(price_rows(plan.prices))}


def described(run: Trajectory) -> dict[str, Fact]:
    """Return the facts of a plan in words, and its largest violation of limits."""
    facts = run.facts
    sizes = [fact.value for fact in starting_with(VIOLATION, facts).values()]
    violation = max(sizes, default=0.0)
    is_kept = run.stop is None and violation <= facts["plan_accuracy"].value
    is_solved = run.stop is None or run.stop.name != PLAN
    texts = {"simulated": _simulated_words(facts, is_solved=is_solved)}
    if not is_solved:
        texts["iterate"] = "the motion is that of an iterate, not of a solution"
    if facts.get("friction_utilisation_largest", Fact(0.0)).value > SLIDING:
        texts["slides"] = "a wheel slides"
    if "plan_windows" in facts:
        texts["windows"] = _windows_words(facts["plan_windows"].value)
    if "plan_starts" in facts:
        texts["start_count"] = str(len(facts["plan_starts"].value))
    if "plan_curvature" in facts:
        checked = Optimality(*(facts[f"plan_{name}"].value for name in Optimality._fields))
        texts |= {"optimality": checked.words, "prices": prices_words(facts["plan_prices"].value)}
    turns = facts["plan_turns"].value if "plan_turns" in facts else []
    return {
        **{name: Fact(text) for name, text in texts.items()},
        "whole_turns": Fact([_turn_words(row) for row in turns]),
        "plan_violation": Fact(violation),
        "within_limits": Fact(float(is_kept), "1"),
    }


def _turn_words(row: Mapping[str, Any]) -> str:
    turns = row["turns"]
    count = "a turn" if abs(turns) == 1 else f"{abs(turns)} turns"
    more = f"{count} {'more' if turns > 0 else 'less'}"
    if row["than"] == "plan":
        return (
            f"{row['angle']} ends {more} in the simulation than in the plan: the same position, "
            "after a swing to the other side"
        )
    return (
        f"{row['angle']} is {row['end']:.6g} rad at the end, {more} than {row['goal']}: the same "
        "position, reached the short way"
    )


def _simulated_words(facts: Facts, *, is_solved: bool) -> str:
    gaps = starting_with(DIFFERENCE, facts)
    if not gaps:
        return "not yet; the motion is that of the plan"
    listed = ", ".join(f"{name} {gap:.1e}" for name, gap in gaps.items())
    words = f"differs from the {'plan' if is_solved else 'iterate'} by at most {listed}"
    if not is_solved:  # the outcome names the violations
        return words
    violations = [f for f in starting_with(VIOLATION, facts).values() if f.value > ROUNDING]
    if not violations:
        return f"{words}; meets all constraints"
    missed = missed_words(
        {fact.words: fact.value for fact in violations},
        {fact.words: fact.unit for fact in violations},
    )
    return f"{words}; violates {missed}; plan.accuracy allows {facts['plan_accuracy'].value:g}"


def _windows_words(rows: list[dict[str, Any]]) -> str:
    metres, seconds = rows[-1]["end"], sum(row["seconds"] for row in rows)
    inaccurate = ", ".join(f"{row['t']:.6g} s" for row in rows if not row["accurate"])
    return (
        f"{len(rows)} windows up to {metres:.6g} m of the route, "
        f"{max(row['iterations'] for row in rows)} iterations at most, "
        f"{1e3 * seconds / metres:.3g} s of search per kilometre"
        + (f"; not accurate: those that begin at {inaccurate}" if inaccurate else "")
    )
