"""The numeric record that every solver returns and every plot and file takes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from slipfree.errors import ModelError, SlipfreeError
from slipfree.records import Array, Label


class Stop(NamedTuple):
    """Why a motion ended before the last time asked for.

    Attributes
    ----------
    name : str
        The limit that was reached, or ``"solver"``.
    t : float
        When. [s]
    words : str
        What happened, where, and what to do.
    """

    name: str
    t: float
    words: str


class Column(NamedTuple):
    """One quantity over time: its label and its values.

    Attributes
    ----------
    label : Label
        Name, unit and words.
    values : ndarray, shape (n,) or (n, n_wheels)
        Samples; one column a wheel where the quantity belongs to the wheels.
    """

    label: Label
    values: Array


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Samples of a motion, by name.

    ``run["heading"]`` is an array over time; ``run["slip_along"]`` has one column a wheel, and
    ``run["slip_along", "front"]`` is the column of one wheel.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times. [s]
    columns : mapping of str to Column
        Everything that was sampled.
    wheels : tuple of str
        Names of the wheels, in the order of the columns.
    stop : Stop or None
        Why the motion ended early; None if it reached the last time asked for.
    statistics : mapping of str to float
        Counts and times of the solver.
    attributes : mapping of str to str
        Words about the whole: problem file, versions.
    events : mapping of str to ndarray
        Times at which the events that `simulate` was given occurred, by name; result files do not
        keep them. [s]
    """

    t: Array
    columns: Mapping[str, Column]
    wheels: tuple[str, ...] = ()
    stop: Stop | None = None
    statistics: Mapping[str, float] = field(default_factory=dict)
    attributes: Mapping[str, str] = field(default_factory=dict)
    events: Mapping[str, Array] = field(default_factory=dict)

    def __getitem__(self, name: str | tuple[str, str]) -> Array:
        """Return the samples of a quantity, or those of one wheel.

        Raises
        ------
        ModelError
            If the quantity or the wheel is not in this trajectory; the message lists what is.
        """
        quantity, wheel = (name, None) if isinstance(name, str) else name
        if quantity not in self.columns:
            known = ", ".join(sorted(self.columns))
            raise ModelError(f"the trajectory has no {quantity!r}; it has {known}")
        values = self.columns[quantity].values
        if wheel is None:
            return values
        if values.ndim == 1 or wheel not in self.wheels:
            known = ", ".join(self.wheels) if values.ndim == 2 else "none"
            raise ModelError(f"{quantity!r} has no wheel {wheel!r}; its wheels: {known}")
        return values[:, self.wheels.index(wheel)]

    def of(self, label: Label) -> Array:
        """Return the samples of the quantity of a label, of one wheel if the label names one."""
        return self[label.name] if label.wheel is None else self[label.name, label.wheel]

    def __iter__(self) -> Iterator[str]:
        """Yield the names of the quantities."""
        return iter(self.columns)

    def part(self, span: slice, stop: Stop | None = None) -> Trajectory:
        """Return some of the samples, ended for the reason given."""
        columns = {k: Column(c.label, c.values[span]) for k, c in self.columns.items()}
        t = self.t[span]
        first, last = t.min(initial=np.inf), t.max(initial=-np.inf)
        events = {k: v[(v >= first) & (v <= last)] for k, v in self.events.items()}
        return replace(self, t=t, columns=columns, stop=stop, events=events)


class SolverError(SlipfreeError, RuntimeError):
    """The question was fine, but the solver found no answer.

    Attributes
    ----------
    trajectory : Trajectory or None
        The motion that was reached before the solver stopped.
    """

    def __init__(self, message: str, trajectory: Trajectory | None = None) -> None:
        super().__init__(message)
        self.trajectory = trajectory


def joined(*runs: Trajectory) -> Trajectory:
    """Return motions of one model, one after the other, as one; the last one's end counts."""
    columns = {
        name: Column(column.label, np.concatenate([run[name] for run in runs]))
        for name, column in runs[0].columns.items()
    }
    t = np.concatenate([run.t for run in runs])
    events = {k: np.concatenate([run.events[k] for run in runs]) for k in runs[0].events}
    return replace(runs[0], t=t, columns=columns, stop=runs[-1].stop, events=events)


def path_length(run: Trajectory) -> float:
    """Return the length of the platform's path over the samples. [m]."""
    steps = [np.diff(run[name]) for name in ("x", "y", "z")]
    return float(np.sqrt(sum(step**2 for step in steps)).sum())
