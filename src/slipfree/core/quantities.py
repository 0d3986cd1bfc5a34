"""Table of the quantities of motions: units and meanings, facts, lines of summaries, figures.

Models take the labels of their quantities from this table, and through them result files and CSV
tables have names, units and meanings. Summaries, JSON output, sweeps, reports, figures and the page
of quantities read the rest of a row. A new quantity is a row of ``quantities.toml``, and its
equation in a model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from slipfree.core.errors import read_table
from slipfree.core.facts import Fact
from slipfree.core.records import Label
from slipfree.core.trajectory import Trajectory


@dataclass(frozen=True)
class QuantityRow:
    """A quantity of a motion over terrain.

    Attributes
    ----------
    name : str
        Name of the quantity in results. Names with ``*`` stand for quantities of joints: the
        angles of those that move, their rates, or all quantities that end in this way.
    unit : str
        Unit in the spelling of the CF conventions.
    words : str
        Meaning; values in braces are set by `quantity_label`.
    shape : {"vehicle", "wheel", "joint", "pose"}
        Whether there is a value for the vehicle, each wheel, each joint, or each pose of a mobility
        map.
    facts : str
        Facts of a motion about the values over time and wheels, separated by blanks, see
        `extremes`.
    line : str
        Lines of the summary, as in `slipfree.core.facts.rows`.
    figure : str
        Name of the figure that has a panel of the quantity, if there is one.
    shown : str
        Unit in figures, if it is not the stored one, a key of `slipfree.core.facts.SCALES`.
    title : str
        Name in figures, if it is not the name with blanks.
    standard_name : str
        Standard name of the CF conventions, if there is one.
    is_residual : bool
        Whether figures have a logarithmic axis and the tolerance.
    """

    name: str
    unit: str
    words: str
    shape: str = "vehicle"
    facts: str = ""
    line: str = ""
    figure: str = ""
    shown: str = ""
    title: str = ""
    standard_name: str = ""
    is_residual: bool = False


QUANTITIES = {  # by name, in the order of facts, summaries and figures
    name: QuantityRow(name, **row) for name, row in read_table(__file__, "quantities.toml").items()
}


def quantity_label(name: str, wheel: str | None = None, **values: object) -> Label:
    """Return the label of a quantity of the table, with the values in braces of its meaning."""
    row, of = QUANTITIES[name], "the wheel" if wheel is None else f"wheel {wheel}"
    return Label(name, row.unit, row.words.format(wheel=of, **values), wheel)


def joint_angles(run: Trajectory) -> list[str]:
    """Return the names of the angles of joints in a motion."""
    columns = run.columns.items()
    angles = [n for n, each in columns if each.label.unit == "rad" and each.values.ndim == 1]
    stops = {f"{name}_stop" for name in angles}
    return [name for name in angles if name not in stops and name not in QUANTITIES]


def extremes(run: Trajectory, kinds: Mapping[str, str] | None = None) -> dict[str, Fact]:
    """Return facts about quantities of a motion, with wheel and time of extremes as description.

    Parameters
    ----------
    run : Trajectory
        The motion. Quantities that it does not have, or only as NaN, have no facts.
    kinds : mapping of str to str, optional
        Facts of each quantity, by default those of the table, separated by blanks: ``end`` (last
        value), ``gained`` (change from the first to the last value), ``least``, ``greatest``,
        ``largest`` (absolute value) or ``most`` (as ``greatest``, but named as the largest).

    Returns
    -------
    dict of str to Fact
        Facts by name: ``end_NAME``, ``NAME`` if gained, ``NAME_least``, ``NAME_greatest`` and
        ``NAME_largest``.
    """
    facts = dict[str, Fact]()
    if kinds is None:
        kinds = {each.name: each.facts for each in QUANTITIES.values() if each.facts}
    for name, listed in kinds.items():
        if name not in run.columns or np.isnan(values := run[name]).all():
            continue
        unit = run.columns[name].label.unit
        for kind in listed.split():
            if kind == "end":
                facts[f"end_{name}"] = Fact(float(values[-1]), unit)
            elif kind == "gained":
                facts[name] = Fact(float(values[-1] - values[0]), unit)
            else:
                sizes = {"largest": np.abs(values), "least": -values}.get(kind, values)
                k, *wheel = np.unravel_index(int(np.nanargmax(sizes)), values.shape)
                value = float(values[k, *wheel])
                where = f"wheel {run.wheels[wheel[0]]}, " if wheel else ""
                where = where.replace("wheel wheel", "wheel")
                facts[f"{name}_{kind.replace('most', 'largest')}"] = Fact(
                    abs(value) if kind == "largest" else value, unit, f"{where}t = {run.t[k]:.4g} s"
                )
    return facts
