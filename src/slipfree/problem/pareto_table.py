"""Table and figure of a Pareto front of plans."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from slipfree.plan.constraints import unit_words
from slipfree.problem.pareto import PlanFront
from slipfree.problem.summary import Lines

if TYPE_CHECKING:
    from slipfree.show.plots import Plot

MISSING = "-"  # number of a point that is not solved


def front_facts(front: PlanFront) -> Lines:
    """Return the facts about the given plan, the least second objective, and the front's points."""
    unit, given = unit_words(front.unit), front.given
    solved = sum(each.is_solved for each in front.points)
    dominated = sum(each.is_dominated for each in front.points)
    return [
        (
            "costs of the problem",
            f"{front.against} {given.second:.4g} {unit}, slip {1e3 * given.solution.slip:.3g} mm "
            "per wheel and metre",
        ),
        (f"least {front.against}", f"{front.least.second:.4g} {unit}, slip not minimised"),
        ("front", f"{len(front.points)} points, {solved} solved, {dominated} dominated"),
    ]


def table_lines(front: PlanFront) -> Iterator[str]:
    """Yield the lines of the table of a front."""
    unit = unit_words(front.unit)
    heads = [("point", ""), (front.against, unit), ("at most", unit), ("slip*", "mm/m")]
    heads += [("slip^2", "mm2/s"), ("smoothing", "%"), ("slope", f"mm2/s per {unit}")]
    widths = [max(10, *(len(word) + 4 for word in head)) for head in heads]
    yield _line((name for name, _ in heads), widths) + "outcome"
    yield _line((unit and f"[{unit}]" for _, unit in heads), widths)
    for number, point in enumerate(front.points, 1):
        words = "dominated" if point.is_dominated else "solved"
        values = [point.second, point.bound, np.nan, np.nan, np.nan, np.nan]
        if point.is_solved:
            found = point.solution
            share = 100 * (1 - found.squared_slip / point.first)
            values[2:] = 1e3 * found.slip, 1e6 * found.squared_slip, share, 1e6 * point.slope
        else:
            words = (point.words or point.outcome.title).splitlines()[0]
        cells = (f"{value:.4g}" if np.isfinite(value) else MISSING for value in values)
        yield _line([str(number), *cells], widths) + words
    yield "* per wheel and metre of path"


def _line(cells: Iterable[str], widths: Sequence[int]) -> str:
    return "".join(f"{cell:{width}}" for cell, width in zip(cells, widths, strict=True))


def front_rows(front: PlanFront) -> tuple[list[str], list[list[object]]]:
    """Return column names and rows of the table of a front, with numbers in SI units."""
    names = ["point", "bound", front.against, "slip_per_path", "squared_slip", "smoothness_share"]
    return [*dict.fromkeys([*names, "slope", "outcome", "dominated", "reason"])], [
        [
            number,
            point.bound,
            point.second,
            point.solution.slip if point.is_solved else np.nan,
            point.solution.squared_slip if point.is_solved else np.nan,
            1 - point.solution.squared_slip / point.first if point.is_solved else np.nan,
            point.slope,
            point.outcome.name.lower(),
            int(point.is_dominated),
            point.words,
        ]
        for number, point in enumerate(front.points, 1)
    ]


def front_plot(front: PlanFront) -> Plot:
    """Return the figure of a front."""
    from slipfree.show.plots import Plot
    from slipfree.show.sweep_figures import DrawnFront, front_figure

    points, given = front.points, front.given
    drawn = DrawnFront(
        front.against,
        front.unit,
        np.array([each.bound for each in points]),
        np.array([each.second for each in points]),
        np.array([each.first for each in points]),
        np.array([each.slope for each in points]),
        np.array([each.solution.slip if each.is_solved else np.nan for each in points]),
        np.array([each.is_dominated for each in points]),
        (given.second, given.first, given.solution.slip),
    )
    return Plot("pareto", "Pareto front", partial(front_figure, drawn))
