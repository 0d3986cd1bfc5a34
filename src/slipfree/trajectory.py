"""Trajectory: the numeric result of every solver, for figures and files."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from slipfree.errors import ModelError, SlipfreeError, missing_package
from slipfree.outcome import Outcome
from slipfree.records import Array, Label, field_overview, overview

if TYPE_CHECKING:
    import pandas
    import xarray

TIME = {"units": "s", "long_name": "time", "standard_name": "time", "axis": "T"}
WHEELS = {"long_name": "name of the wheel"}
STATISTICS = "statistics_"  # prefix of the solver's counts among the metadata
STOP = ("stop_name", "stop_time", "stop_words")
OUTCOME = "outcome"
PLAN, PLAN_ACCURACY = "plan", "plan_accuracy"  # names of the stops of plans


class Stop(NamedTuple):
    """Reason why a motion ended before the last requested time.

    Attributes
    ----------
    name : str
        Name of the limit, check or event that was reached; ``"fold"``, ``"solver"``,
        ``"interrupted"``, ``"plan"`` or ``"plan_accuracy"`` otherwise.
    t : float
        Time of the last sample. [s]
    words : str
        Description of what happened, where, and what to do.
    outcome : Outcome
        Kind of the reason. A motion ended by an event that the caller gave is complete, as in
        SciPy's ``solve_ivp``.
    """

    name: str
    t: float
    words: str
    outcome: Outcome

    def __repr__(self) -> str:
        return field_overview(self)


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

    def __repr__(self) -> str:
        return field_overview(self)

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names of the dimensions: ``("time",)`` or ``("time", "wheel")``."""
        return ("time", "wheel")[: self.values.ndim]

    @property
    def metadata(self) -> dict[str, str]:
        """Unit and description, as CF names them."""
        return {"units": self.label.unit, "long_name": self.label.words}


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

    Examples
    --------
    >>> from slipfree import Analytic, catalog, direct_kinematics, settle
    >>> start = settle(direct_kinematics(catalog.three_wheeler(), Analytic(lambda x, y: 0 * x)))
    >>> start
    Trajectory: 1 samples from 0 to 0 s; complete
      quantities: x, y, heading, tilt_right, tilt_left, steer, z, roll, pitch, contact_x, ...
      wheels: right, left, front
    >>> start["contact_x"].shape, start["contact_x", "right"].shape
    ((1, 3), (1,))
    """

    t: Array
    columns: Mapping[str, Column]
    wheels: tuple[str, ...] = ()
    stop: Stop | None = None
    statistics: Mapping[str, float] = field(default_factory=dict)
    attributes: Mapping[str, str] = field(default_factory=dict)
    events: Mapping[str, Array] = field(default_factory=dict)

    def __repr__(self) -> str:
        span = f" from {self.t[0]:.6g} to {self.t[-1]:.6g} s" if self.t.size else ""
        stop = {} if self.stop is None else {"stop": (self.stop.name, self.stop.words)}
        return overview(
            f"Trajectory: {self.t.size} samples{span}; {self.outcome.title}",
            quantities=self.columns,
            wheels=self.wheels,
            events=self.events,
            **stop,
        )

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

    @property
    def outcome(self) -> Outcome:
        """Outcome of the stop; complete without one."""
        return self.stop.outcome if self.stop else Outcome.COMPLETE

    @property
    def metadata(self) -> dict[str, str | float]:
        """Attributes, statistics, outcome and stop reason of the motion in one mapping."""
        found: dict[str, str | float] = dict(self.attributes)
        found |= {f"{STATISTICS}{name}": value for name, value in self.statistics.items()}
        found[OUTCOME] = self.outcome.name.lower()
        return found | (dict(zip(STOP, self.stop[:3], strict=True)) if self.stop else {})

    def to_xarray(self) -> xarray.Dataset:
        """Return the samples as an xarray Dataset with dimensions ``time`` and ``wheel``.

        Each variable has the attributes ``units`` and ``long_name``; the dataset has the `metadata`
        of the motion, as ``xarray.open_dataset`` reads from its result file.

        Raises
        ------
        SlipfreeError
            If xarray is not installed.
        """
        coordinates = {"time": ("time", self.t, TIME)}
        if self.wheels:
            coordinates["wheel"] = ("wheel", np.array(self.wheels), WHEELS)
        variables = {k: (c.dimensions, c.values, c.metadata) for k, c in self.columns.items()}
        dataset: xarray.Dataset = _require("xarray").Dataset(variables, coordinates, self.metadata)
        return dataset

    def to_pandas(self) -> pandas.DataFrame:
        """Return the samples as a pandas DataFrame with one row per time.

        Columns have two levels, quantity and wheel, so that a frame is indexed as a trajectory:
        ``frame["heading"]`` and ``frame["slip_along", "front"]`` are series, and
        ``frame["slip_along"]`` has a column per wheel. ``frame.attrs["units"]`` and
        ``frame.attrs["long_name"]`` map quantities to their units and descriptions; other entries
        are the `metadata` of the motion.

        Raises
        ------
        SlipfreeError
            If pandas is not installed.
        """
        pandas = _require("pandas")
        values = {
            (name, wheel): samples
            for name, column in self.columns.items()
            for wheel, samples in zip(
                ("",) if column.values.ndim == 1 else self.wheels,
                np.atleast_2d(column.values.T),
                strict=True,
            )
        }
        columns = pandas.MultiIndex.from_tuples(values, names=("quantity", "wheel"))
        frame = pandas.DataFrame(values, pandas.Index(self.t, name="time"), columns)
        for key in ("units", "long_name"):
            frame.attrs[key] = {name: c.metadata[key] for name, c in self.columns.items()}
        frame.attrs |= self.metadata
        return frame


def _require(package: str) -> Any:
    """Import an optional package."""
    try:
        return import_module(package)
    except ImportError as error:
        raise SlipfreeError(missing_package(package, "xarray")) from error


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


def outcome_title(run: Trajectory) -> str:
    """Return the outcome of a motion, with time and name of a stop that has a time.

    Plans are solved as a whole: the stop of one that was not solved has no time.
    """
    stop, title = run.stop, run.outcome.title
    if stop is None or stop.name in (PLAN, PLAN_ACCURACY):
        return title
    name = "" if stop.name.replace("_", " ") in title else f" ({stop.name})"
    return f"{title} at t = {stop.t:.6g} s{name}"


def outcome_words(run: Trajectory) -> str:
    """Return the outcome of a motion with its reason."""
    return f"{outcome_title(run)}: {run.stop.words}" if run.stop else outcome_title(run)


def path_length(run: Trajectory) -> float:
    """Return the length of the platform's path over the samples [m]."""
    steps = [np.diff(run[name]) for name in ("x", "y", "z")]
    return float(np.sqrt(sum(step**2 for step in steps)).sum())
