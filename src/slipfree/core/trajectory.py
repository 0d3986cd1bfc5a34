"""Trajectory: the samples of a motion, which every solver returns."""

from __future__ import annotations

import json
import re
from base64 import b64encode
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from io import BytesIO
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from slipfree.core.errors import (
    ModelError,
    SlipfreeError,
    check_known,
    read_table,
    require,
    similar,
)
from slipfree.core.facts import Fact, Facts
from slipfree.core.records import Array, HtmlRepr, Indices, Label, overview, with_overview

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


SMALL_DPI = 72  # of figures of records in notebooks
INTERRUPTED_EXIT_CODE = 130  # convention of shells for programs ended by Ctrl-C
INCOMPLETE_EXIT_CODE = 1
FUTILE_STATUS = "Violation_Not_Reduced"  # own status: IPOPT was stopped
TABLES = read_table(__file__, "statuses.toml")
IPOPT_STATUSES, SUNDIALS_FLAGS = (  # meanings of status codes
    {code: words for words, codes in table.items() for code in codes.split()}
    for table in TABLES.values()
)
NO_START = SUNDIALS_FLAGS["NO_RECOVERY"]
FLAG = re.compile(r"\b(IDA|CV)_[A-Z_]+\b")
SOURCE = re.compile(r"^\S+\.[ch]pp:\d+: ")  # line of CasADi's source code in a message


class Outcome(Enum):
    """Outcome of a motion or a plan: complete, or the category of the stop reason.

    The value of a member is the title in summaries, a colon, and an explanation. Result files
    contain the name of the member in lower case.
    """

    COMPLETE = "complete: the motion reaches its end, or an event that ends it"
    LIMIT = "limit reached: a limit of the vehicle, the ground or the model ends the motion early"
    NO_EQUILIBRIUM = "no equilibrium: the forces that friction allows cannot continue the motion"
    INFEASIBLE = "infeasible: the search ended without a plan that meets all constraints"
    INACCURATE = "inaccurate: a simulated plan or a predicted log deviates by more than allowed"
    TIME_LIMIT = "time limit reached: the search ended without a verified plan; the best is kept"
    INTERRUPTED = "interrupted: Ctrl-C or a progress callable ended the run; its samples are kept"
    SOLVER_FAILURE = "solver failure: the solver found no solution; earlier samples are kept"

    @property
    def title(self) -> str:
        """Title of the outcome in summaries, such as ``"limit reached"``."""
        return self.value.partition(":")[0]

    @property
    def exit_code(self) -> int:
        """Exit code of a command with this outcome: 0 if complete, 130 if interrupted, else 1."""
        if self is Outcome.COMPLETE:
            return 0
        return INTERRUPTED_EXIT_CODE if self is Outcome.INTERRUPTED else INCOMPLETE_EXIT_CODE


def ipopt_words(status: str) -> str:
    """Return the meaning of a status of IPOPT, followed by the status in parentheses."""
    words = IPOPT_STATUSES.get(status, "the search failed")
    return words if status == FUTILE_STATUS else f"{words} (IPOPT: {status})"


def sundials_words(message: str) -> str:
    """Return the meaning of the SUNDIALS flag in an error message of CasADi, and the flag.

    For a message without a flag, return its last line.
    """
    if found := FLAG.search(message):
        meanings = (words for part, words in SUNDIALS_FLAGS.items() if part in found[0])
        return f"{next(meanings, 'the integrator failed')} ({found[0]})"
    return SOURCE.sub("", message.strip().splitlines()[-1])


TIME = {"units": "s", "long_name": "time", "standard_name": "time", "axis": "T"}
WHEELS = {"long_name": "name of the wheel"}
STATISTICS = "statistics_"  # prefix of the solver's statistics in the metadata
STOP = ("stop_name", "stop_time", "stop_words")
OUTCOME, FACTS = "outcome", "facts"
Frame = Literal["paper", "rep103"]  # headings count from the y axis, or from the x axis (ROS)
FRAME = "frame"  # attribute of every file: frame of its headings; "paper" without it
HEADINGS: dict[str, tuple[str, float]] = {  # axis, and heading of the y axis [rad], by frame
    "paper": ("y", 0.0),
    "rep103": ("x", np.pi / 2),
}
PLAN, PLAN_ACCURACY, PLAN_SHARE = "plan", "plan_accuracy", "plan_share"
PLAN_UNVERIFIED = "plan_unverified"
PLAN_STOPS = (PLAN, PLAN_ACCURACY, PLAN_SHARE, PLAN_UNVERIFIED)  # names of stops of plans
FIGURE_SAMPLES = 4000  # number of samples in figures, a few per pixel
SCENE_SAMPLES = 20_000  # number of samples in scenes and films


@with_overview
class Stop(NamedTuple):
    """Reason why a motion ended before the last requested time, or why a plan is incomplete.

    Attributes
    ----------
    name : str
        Name of the limit, check, residual or event that ended the motion. Other names:

        ``"fold"``
            The equilibrium continues only with a jump.
        ``"solver"``
            The integrator failed.
        ``"interrupted"``
            The progress callable returned False.
        ``"plan"``
            The search ended without a plan that meets all constraints.
        ``"plan_accuracy"``
            The simulation deviates from a solved plan by more than the required accuracy.
        ``"plan_share"``
            A robust plan holds on too few of the drawn worlds, or they were not all simulated; a
            plan with a guarantee does not hold on every ground.
        ``"plan_unverified"``
            The plan is solved, but the simulation that verifies it was interrupted.
    t : float
        Time of the last sample. It has no meaning for the four stops of plans. [s]
    words : str
        Message: the cause, its location, and a remedy if there is one.
    outcome : Outcome
        Category of the reason. A motion that ends at an event of the caller is complete, as in
        SciPy's ``solve_ivp``.
    """

    name: str
    t: float
    words: str
    outcome: Outcome


@with_overview
class Column(NamedTuple):
    """One quantity over time: its label and its values."""

    label: Label  # name, unit and description
    # samples in the label's unit, shape (n,) or, for quantities of wheels, (n, n_wheels)
    values: Array

    @property
    def dimensions(self) -> tuple[str, ...]:
        """Names of the dimensions: ``("time",)`` or ``("time", "wheel")``."""
        return ("time", "wheel")[: self.values.ndim]

    @property
    def metadata(self) -> dict[str, str]:
        """Unit and description under the keys ``units`` and ``long_name`` of the CF conventions."""
        return {"units": self.label.unit, "long_name": self.label.words}


def heading_column(heading: Array | float, frame: str, *, own: str = "paper") -> Column:
    """Return headings of the frame ``own`` as a quantity in another frame [rad].

    Every file, figure and summary takes its headings and their description from this function.
    """
    axis, offset = HEADINGS[frame]
    words = f"counter-clockwise angle of the forward axis from the {axis} axis"
    values = np.asarray(heading + (offset - HEADINGS[own][1]))
    return Column(Label("heading", "rad", words), values)


class Drawable(HtmlRepr):
    """A result that is drawn over its ground, or a ground."""

    if TYPE_CHECKING:

        @property
        def ground(self) -> object:
            """Ground of the result; None if it is unknown."""

    def plot(self, name: str | None = None) -> Figure:
        """Draw the result over its ground.

        Parameters
        ----------
        name : str, optional
            Name of the figure, as in `slipfree.plot`, such as ``"slip"``; by default the first one.

        Returns
        -------
        Figure
            A figure of Matplotlib, which notebooks show.

        Raises
        ------
        ModelError
            If there is no figure of this name, or the ground is unknown, as in a result from a
            file: use `slipfree.plot` then.
        """
        import slipfree  # its public function: figures are above this package

        return slipfree.plot(self, name)  # type: ignore[arg-type]

    def _repr_html_(self) -> str:
        """Return the HTML of the record, with its first figure if the ground is known."""
        html, file = super()._repr_html_(), BytesIO()
        if self.ground is None:
            return html
        self.plot().savefig(file, dpi=SMALL_DPI)
        return f'{html}<img src="data:image/png;base64,{b64encode(file.getvalue()).decode()}">'


@dataclass(frozen=True, eq=False)
class Trajectory(Drawable):
    """Samples of a motion, by name of the quantity.

    ``run["heading"]`` is an array over time, shape (n,). ``run["slip_along"]`` has one column per
    wheel, shape (n, n_wheels), and ``run["slip_along", "front"]`` is the column of one wheel.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times of the samples. [s]
    columns : mapping of str to Column
        Sampled quantities, by name.
    wheels : tuple of str
        Names of the wheels, in the order of the columns of quantities of wheels.
    stop : Stop or None
        Reason of an early end, or of an incomplete plan; None for a motion that reached the last
        requested time.
    statistics : mapping of str to float
        Statistics of the solver, such as numbers of steps and computing times, by name.
    facts : mapping of str to Fact
        Numbers of diagnostics that the samples do not contain, such as prices of limits, by name.
    attributes : mapping of str to str
        Descriptions of the motion, such as its problem file and versions, by name.
    events : mapping of str to ndarray
        Times of the events passed to `simulate`, by name; result files do not contain them. [s]
    ground : Terrain, Solids or None
        Ground of the motion, for `plot`; None for motions from files and other processes.

    Examples
    --------
    >>> from slipfree import Analytic, catalog, direct_kinematics, settle
    >>> start = settle(direct_kinematics(catalog.three_wheeler(), Analytic(lambda x, y: 0 * x)))
    >>> start
    Trajectory: 1 sample from 0 to 0 s; complete
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
    facts: Mapping[str, Fact] = field(default_factory=dict)
    events: Mapping[str, Array] = field(default_factory=dict)
    ground: object = field(default=None, repr=False, compare=False)

    def __getstate__(self) -> dict[str, Any]:
        """Return the fields for pickling, without the ground: a formula may not be pickled."""
        return self.__dict__ | {"ground": None}

    def __repr__(self) -> str:
        span = f" from {self.t[0]:.6g} to {self.t[-1]:.6g} s" if self.t.size else ""
        stop = {} if self.stop is None else {"stop": (self.stop.name, self.stop.words)}
        samples = "1 sample" if self.t.size == 1 else f"{self.t.size} samples"
        return overview(
            f"Trajectory: {samples}{span}; {self.outcome.title}",
            quantities=self.columns,
            wheels=self.wheels,
            events=self.events,
            **stop,
        )

    def __getitem__(self, name: str | tuple[str, str]) -> Array:
        """Return the samples of a quantity, shape (n,) or (n, n_wheels).

        Parameters
        ----------
        name : str or (str, str)
            Name of the quantity; or names of quantity and wheel, for the samples of one wheel.

        Raises
        ------
        ModelError
            If the quantity or the wheel is unknown, or if the quantity has no values per wheel.
        """
        quantity, wheel = (name, None) if isinstance(name, str) else name
        if quantity not in self.columns:
            raise ModelError(
                f"expected a quantity of the trajectory, found {quantity!r}; "
                f"{similar(quantity, self.columns)}use a name in .columns, or .t for the times"
            )
        values = self.columns[quantity].values
        if wheel is None:
            return values
        if values.ndim == 1:
            raise ModelError(
                f"expected the name of a quantity with one value per wheel, found {quantity!r} "
                f"with the wheel {wheel!r}; use the name alone: run[{quantity!r}]"
            )
        check_known(repr(quantity), [wheel], self.wheels, "one of the wheels")
        return values[:, self.wheels.index(wheel)]

    def of(self, label: Label) -> Array:
        """Return the samples of the quantity of a label, of one wheel if the label has a wheel.

        Headings are those of models, which count from the y axis in every motion.

        Raises
        ------
        ModelError
            As for ``run[name]``.
        """
        if label.name == "heading":
            return self.in_frame("paper")["heading"]
        return self[label.name] if label.wheel is None else self[label.name, label.wheel]

    def __iter__(self) -> Iterator[str]:
        """Yield the names of the quantities."""
        return iter(self.columns)

    def with_facts(self, facts: Facts) -> Trajectory:
        """Return the motion with further facts.

        Parameters
        ----------
        facts : mapping of str to Fact
            Facts by name; they replace those of the same names.

        Returns
        -------
        Trajectory
            The motion with the same samples.
        """
        return replace(self, facts={**self.facts, **facts})

    def in_frame(self, frame: str) -> Trajectory:
        """Return the motion with headings that count from the axis of a frame.

        Parameters
        ----------
        frame : {"paper", "rep103"}
            Headings count from the y axis, or from the x axis as in ROS.
        """
        own = self.attributes.get(FRAME, "paper")
        if frame == own or "heading" not in self.columns:
            return self
        heading = heading_column(self["heading"], frame, own=own)
        columns = {**self.columns, "heading": heading}
        return replace(self, columns=columns, attributes={**self.attributes, FRAME: frame})

    def part(self, span: slice | Indices, stop: Stop | None = None) -> Trajectory:
        """Return a part of the trajectory.

        Parameters
        ----------
        span : slice or array of int
            Range or indices of the samples to keep. Events within their times are kept.
        stop : Stop, optional
            Stop of the part; without it, the part is complete.
        """
        columns = {k: Column(c.label, c.values[span]) for k, c in self.columns.items()}
        t = self.t[span]
        first, last = t.min(initial=np.inf), t.max(initial=-np.inf)
        events = {k: v[(v >= first) & (v <= last)] for k, v in self.events.items()}
        return replace(self, t=t, columns=columns, stop=stop, events=events)

    @property
    def outcome(self) -> Outcome:
        """Outcome of the motion; complete if there is no stop."""
        return self.stop.outcome if self.stop else Outcome.COMPLETE

    @property
    def metadata(self) -> dict[str, str | float]:
        """Attributes, statistics, facts, outcome and stop reason of the motion in one mapping."""
        found: dict[str, str | float] = dict(self.attributes)
        found |= {f"{STATISTICS}{name}": value for name, value in self.statistics.items()}
        found[OUTCOME] = self.outcome.name.lower()
        found |= {FACTS: json.dumps(self.facts)} if self.facts else {}
        return found | (dict(zip(STOP, self.stop[:3], strict=True)) if self.stop else {})

    def to_xarray(self) -> xarray.Dataset:
        """Return the samples as an xarray Dataset with dimensions ``time`` and ``wheel``.

        Each variable has the attributes ``units`` and ``long_name``. The attributes of the dataset
        are the `metadata` of the motion.

        Raises
        ------
        SlipfreeError
            If xarray is not installed.
        """
        coordinates = {"time": ("time", self.t, TIME)}
        if self.wheels:
            coordinates["wheel"] = ("wheel", np.array(self.wheels), WHEELS)
        variables = {k: (c.dimensions, c.values, c.metadata) for k, c in self.columns.items()}
        dataset: xarray.Dataset = require("xarray").Dataset(variables, coordinates, self.metadata)
        return dataset

    def to_pandas(self) -> pandas.DataFrame:
        """Return the samples as a pandas DataFrame with one row per time.

        Columns have two levels, quantity and wheel, so that a frame has the indices of a
        trajectory: ``frame["heading"]`` and ``frame["slip_along", "front"]`` are series, and
        ``frame["slip_along"]`` has one column per wheel. ``frame.attrs["units"]`` and
        ``frame.attrs["long_name"]`` map quantities to their units and descriptions. The other
        entries of ``frame.attrs`` are the `metadata` of the motion.

        Raises
        ------
        SlipfreeError
            If pandas is not installed.
        """
        pandas = require("pandas")
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


class SolverError(SlipfreeError, RuntimeError):
    """Failure of a solver for valid input.

    Attributes
    ----------
    trajectory : Trajectory or None
        Motion up to the failure; None if there is none.
    """

    def __init__(self, message: str, trajectory: Trajectory | None = None) -> None:
        super().__init__(message)
        self.trajectory = trajectory


def joined(*runs: Trajectory) -> Trajectory:
    """Return consecutive motions of one model as one motion, with the stop of the last.

    Counts and times in the statistics are sums; the tolerance is that of the first motion.
    """
    columns = {
        name: Column(column.label, np.concatenate([run[name] for run in runs]))
        for name, column in runs[0].columns.items()
    }
    t = np.concatenate([run.t for run in runs])
    events = {k: np.concatenate([run.events[k] for run in runs]) for k in runs[0].events}
    statistics = {
        name: value
        if name == "tolerance"
        else float(sum(run.statistics.get(name, 0.0) for run in runs))
        for name, value in runs[0].statistics.items()
    }
    return replace(
        runs[0], t=t, columns=columns, stop=runs[-1].stop, events=events, statistics=statistics
    )


def outcome_title(run: Trajectory) -> str:
    """Return the outcome of a motion in words, with time and name of its stop.

    For the stop of a plan the time is omitted, since a plan is solved for all times at once. A name
    that repeats the title is omitted too.
    """
    stop, title = run.stop, run.outcome.title
    if stop is None or stop.name in PLAN_STOPS:
        return title
    name = "" if stop.name.replace("_", " ") in title else f" ({stop.name})"
    return f"{title} at t = {stop.t:.6g} s{name}"


def outcome_words(run: Trajectory) -> str:
    """Return the outcome of a motion in words, followed by the message of its stop."""
    return f"{outcome_title(run)}: {run.stop.words}" if run.stop else outcome_title(run)


def stop_words(run: Trajectory) -> str:
    """Return the time of a stop, or the outcome of a plan, and the message; empty if complete."""
    if run.stop is None:
        return ""
    is_plan = run.stop.name in PLAN_STOPS
    title = run.outcome.title if is_plan else f"stopped at t = {run.stop.t:.4g} s"
    return f"{title}: {run.stop.words}"


def path_length(run: Trajectory) -> float:
    """Return the length of the platform's path.

    Parameters
    ----------
    run : Trajectory
        A motion with ``x``, ``y`` and ``z``.

    Returns
    -------
    float
        Sum of the distances between consecutive samples in space. [m]
    """
    steps = [np.diff(run[name]) for name in ("x", "y", "z")]
    return float(np.sqrt(sum(step**2 for step in steps)).sum())


def thin(run: Trajectory, count: int) -> Trajectory:
    """Return a motion with about ``count`` equally spaced samples, and all extremes.

    The samples with the smallest and the largest value of each quantity and wheel are kept. A
    motion with at most ``count`` samples is returned unchanged.
    """
    if run.t.size <= count:
        return run
    kept = {int(k) for k in np.linspace(0, run.t.size - 1, count).round()}
    for column in run.columns.values():
        for values in np.atleast_2d(column.values.T):
            if (known := np.flatnonzero(~np.isnan(values))).size:
                ends = values[known].argmin(), values[known].argmax()
                kept |= {int(known[k]) for k in ends}
    span = np.array(sorted(kept))
    return run.part(span, run.stop)
