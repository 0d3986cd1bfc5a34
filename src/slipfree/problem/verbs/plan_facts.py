"""Facts of a plan, and the lines of its summary that show them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from slipfree.core.facts import Fact, Facts, starting_with
from slipfree.core.records import leaves
from slipfree.core.trajectory import PLAN, Trajectory, path_length
from slipfree.plan.constraints import COST, DURATION, missed_words
from slipfree.plan.optimality import Optimality, price_rows, prices_words
from slipfree.plan.plan import Plan
from slipfree.plan.windows import LongPlan
from slipfree.problem.verbs.plan_schema import spelled
from slipfree.problem.verbs.plan_setup import Planning
from slipfree.solve.sampling import TURN

ROBUST = "robust plan"
IN_SOIL = "simulated with inertia"
MOMENTUM, SLOWLY = "simulated with compliant contacts", "driven slowly"
CHECKS = (
    "simulated",
    "optimality",
    ROBUST,
    MOMENTUM,
    SLOWLY,
    "simulated with friction",
    IN_SOIL,
    "with wheels ten times stiffer",
)  # lines about accuracy and validity
DIFFERENCE, VIOLATION, PLAN_COST = "plan_difference_", "plan_violation_", "plan_cost_"
ROUNDING = 1e-6  # smaller violations count as rounding, in the unit of the limit
SLIDING = 0.95  # wheels with a larger utilisation count as sliding
SIMULATED = {  # further simulations of a plan, by the prefix of their facts
    "friction": (
        "simulated with friction",
        "ends {end_distance:.3g} m from the plan, slips {slip_per_path:.3g} mm per wheel and "
        "metre, utilisation at most {utilisation_largest:.3g}{slides}",
    ),
    "soil": (
        IN_SOIL,
        "ends {end_distance:.3g} m from the plan, slip ratio {slip_ratio_largest:.3g} at most, "
        "sinkage {sinkage_largest:.3g} mm at most, work {work:.4g} J (plan: "
        "{slip_ratio_largest_plan:.3g}, {sinkage_largest_plan:.3g} mm, {work_plan:.4g} J)",
    ),
    "stiff": ("with wheels ten times stiffer", "ends {end_distance:.3g} m from the plan"),
}
MILLIMETRES = re.compile("slip_per_path|sinkage_")  # numbers that a summary shows in mm
MAX_LISTED = 4  # largest number of bounds in a line of the summary


def facts_of(plan: Plan | LongPlan, setup: Planning) -> dict[str, Fact]:
    """Return the facts of a plan: iterations, times, costs, differences and violations."""
    times = [stage.seconds for stage in plan.stages]
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


def plan_lines(run: Trajectory) -> Iterator[tuple[str, str]]:
    """Yield the lines of a plan: costs, differences of its simulation, slip, friction."""
    facts = run.facts
    solved = run.stop is None or run.stop.name != PLAN
    plan = "plan" if solved else "iterate"
    costs = starting_with(PLAN_COST, facts)
    yield (
        plan,
        ", ".join(f"{name} {cost.value:.6g}" for name, cost in costs.items())
        + f"; {facts['plan_iterations'].value:.0f} iterations, {facts['plan_seconds'].value:.3g} "
        f"s, of which {facts['plan_seconds_functions'].value:.3g} s in functions",
    )
    if "plan_turns" in facts:
        yield "whole turns", "; ".join(map(_turn_words, facts["plan_turns"].value))
    if "plan_windows" in facts:
        yield "windows", _windows_words(facts["plan_windows"].value)
    if "plan_starts" in facts:
        yield from _starts_lines(facts)
    yield "simulated", _simulated_words(facts, plan, solved=solved)
    if "plan_curvature" in facts:
        checked = Optimality(*(facts[f"plan_{name}"].value for name in Optimality._fields))
        yield "optimality", checked.words
        yield "prices of limits", prices_words(facts["plan_prices"].value)
    if "plan_share" in facts:
        yield from _robust_lines(facts)
    slip = np.hypot(run["slip_along"], run["slip_across"])
    duration, length = run.t[-1] - run.t[0], path_length(run)
    total = np.trapezoid(slip, run.t, axis=0)
    squares = np.trapezoid(slip**2, run.t, axis=0)
    yield (
        f"slip of the {plan}",
        f"rms {np.sqrt(squares.mean() / duration):.3g} m/s per wheel, "
        f"{1e3 * total.mean() / length:.3g} mm per wheel and metre",
    )
    yield from _momentum_lines(facts)
    for prefix, (name, template) in SIMULATED.items():
        numbers = {key: fact.value for key, fact in starting_with(f"{prefix}_", facts).items()}
        if "failure" in numbers:
            yield name, numbers["failure"]
        elif "end_distance" in numbers:
            slides = numbers.get("utilisation_largest", 0.0) > SLIDING
            in_mm = {key: 1e3 * numbers[key] for key in numbers if MILLIMETRES.match(key)}
            words = template.format(**numbers | in_mm, slides=" (a wheel slides)" * slides)
            yield name, words


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


def violations_words(facts: Facts) -> str:
    """Return the violations of limits in the simulation of a plan; empty if there are none."""
    sizes = {
        fact.words: fact
        for fact in starting_with(VIOLATION, facts).values()
        if fact.value > ROUNDING
    }
    if not sizes:
        return ""
    missed = missed_words(
        {name: fact.value for name, fact in sizes.items()},
        {name: fact.unit for name, fact in sizes.items()},
    )
    return f"{missed}; plan.accuracy allows {facts['plan_accuracy'].value:g}"


def _simulated_words(facts: Facts, plan: str, *, solved: bool) -> str:
    gaps = starting_with(DIFFERENCE, facts)
    if not gaps:
        return "not yet; the motion is that of the plan"
    listed = ", ".join(f"{name} {gap.value:.1e} {gap.unit}" for name, gap in gaps.items())
    violated = violations_words(facts)
    kept = f"; violates {violated}" if violated else "; meets all constraints"
    # without a solution, the outcome names the violations
    return f"differs from the {plan} by at most {listed}{kept if solved else ''}"


def _windows_words(rows: list[dict[str, Any]]) -> str:
    metres, counts = rows[-1]["end"], [row["iterations"] for row in rows]
    seconds = sum(row["seconds"] for row in rows)
    inaccurate = [f"{row['t']:.6g} s" for row in rows if not row["accurate"]]
    number = "one window" if len(rows) == 1 else f"{len(rows)} windows"
    return (
        f"{number} up to {metres:.6g} m of the route, {min(counts)} to {max(counts)} iterations "
        f"each (median {np.median(counts):.0f}), {1e3 * seconds / metres:.3g} s of search per "
        "kilometre"
        + (f"; not accurate: those that begin at {', '.join(inaccurate)}" if inaccurate else "")
    )


def _starts_lines(facts: Facts) -> Iterator[tuple[str, str]]:
    rows, optima = facts["plan_starts"].value, facts["plan_optima"].value
    noun, starts = "optimum" if optima == 1 else "optima", f"start{'s' * (len(rows) != 1)}"
    yield "starts", f"{optima} local {noun} from {len(rows)} {starts}"
    for row in rows:
        terms = ", ".join(f"{name} {value:.4g}" for name, value in row["terms"].items())
        yield (
            f"  {row['start']}",
            f"{row['outcome']}, cost {row['cost']:.6g} ({terms}), duration {row['duration']:.4g} "
            f"s, path up to {row['distance']:.2g} m from the best one; {row['seconds']:.2g} s of "
            "search",
        )


def _robust_lines(facts: Facts) -> Iterator[tuple[str, str]]:
    names = ("", "_first", "_draws", "_rounds", "_low", "_high", "_distance", "_distance_95")
    values = (facts[f"plan_share{name}"].value for name in names)
    share, first, draws, rounds, low, high, half, most = values
    earlier = f"; without tightening in {first * draws:.0f}" if rounds else "; no limit tightened"
    yield (
        ROBUST,
        f"holds in {share * draws:.0f} of {draws:.0f} drawn worlds ({100 * share:.3g} %, "
        f"{facts['plan_share_low'].words} {100 * low:.3g} to {100 * high:.3g} %){earlier}",
    )
    if tightened := facts["plan_tightened"].value:
        yield (
            "  tightened",
            _listed(f"{row['bound']} by {row['size']:.3g}{row['unit']}" for row in tightened),
        )
        before, after = (starting_with(name, facts) for name in ("plan_untightened_", PLAN_COST))
        total = _change(before.pop("total").value, facts["plan_total_cost"].value)
        terms = (f"{k} {_change(cost.value, after[k].value)}" for k, cost in before.items())
        yield "  cost of this", f"{total}: {', '.join(terms)}"
    if violated := facts["plan_violated"].value:
        yield "  violated", _listed(f"{row['bound']} in {row['draws']}" for row in violated)
    if "plan_tightening_failure" in facts:
        yield "  tighter limits", f"not solved: {facts['plan_tightening_failure'].value}"
    yield "  end", f"{half:.3g} m from that of the plan at the median, {most:.3g} m at 95 %"


def _listed(items: Iterator[str]) -> str:
    texts = list(items)
    rest = len(texts) - MAX_LISTED
    return ", ".join(texts[:MAX_LISTED]) + (f" and {rest} more" if rest > 0 else "")


def _change(before: float, after: float) -> str:
    return f"{100 * (after / before - 1):+.3g} %" if before else f"{after:.3g}"


def _momentum_lines(facts: Facts) -> Iterator[tuple[str, str]]:
    if "momentum_distance" in facts:
        planned, simulated = (
            f"{fact.value:.3g} N ({fact.words})"
            for fact in (facts["momentum_force_normal_plan"], facts["momentum_force_normal"])
        )
        yield (
            MOMENTUM,
            "on compliant contacts the platform stays within "
            f"{1e3 * facts['momentum_distance'].value:.2g} mm of the plan; least normal force of a "
            f"wheel {planned} in the plan, {simulated} in the simulation",
        )
    slow = {key: fact.value for key, fact in starting_with("slow_", facts).items()}
    if "torque" in slow:
        stopped = f"; {slow['failure']}" if "failure" in slow else ""
        yield (
            SLOWLY,
            f"without inertia the same path needs torques of {slow['torque']:.3g} N m in all (at x "
            f"= {slow['x']:.2f} m, y = {slow['y']:.2f} m); the plan needs at most "
            f"{slow['torque_plan']:.3g} N m{stopped}",
        )
    elif slow:
        yield SLOWLY, slow["failure"]
