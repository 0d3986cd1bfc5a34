"""Interface between commands and verbs, and the lines of all summaries.

A verb is a kind of problem: the value of the key ``verb`` in a problem file. Commands use only this
interface and `slipfree.problem.load`; everything specific to a verb is in the module of the verb.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar, Generic, NamedTuple, Protocol, get_args

import numpy as np
from typing_extensions import TypeVar

from slipfree.core.facts import Fact
from slipfree.core.outcome import Outcome
from slipfree.core.records import Array
from slipfree.core.trajectory import SolverError, Stop, Trajectory, outcome_words
from slipfree.files.netcdf import NOTHING
from slipfree.problem.problem import Problem
from slipfree.problem.schema import CommonKeys
from slipfree.solve.options import SolverOptions
from slipfree.solve.simulate import simulate
from slipfree.solve.zero_order_hold import simulate_sampled
from slipfree.system.interrupt import check_interrupt

if TYPE_CHECKING:
    from slipfree.models.montana import Difference
    from slipfree.plan.polynomial_motion import SavedPlan
    from slipfree.show.plots import Plot


Lines = list[tuple[str, str]]
VERB_ATTRIBUTE = "verb"  # attribute of result files with the name of the verb
FAILED_DIAGNOSTICS = "failed_diagnostics"  # fact with names and errors of diagnostics
CROSS_CHECK, RESUME = "cross-check", "resume"  # options of slipfree run
P = TypeVar("P", bound=CommonKeys, default=Any)  # record of a problem
D = TypeVar("D", default=Any)  # its set-up, or None


def ranges(run: Trajectory) -> Lines:
    """Return the facts about the range of every quantity over time and wheels.

    On a ground without a friction coefficient, ``utilisation`` equals ``friction_needed`` and is
    omitted.
    """
    facts = []
    for name, column in run.columns.items():
        if name == "utilisation" and not has_friction(run):
            continue
        low, high = (float(end.reduce(column.values, axis=None)) for end in (np.fmin, np.fmax))
        unit = column.label.unit
        span = _number(low) if low == high else f"{_number(low)} to {_number(high)}"
        facts.append((name, span if unit == "1" or np.isinf(low) else f"{span} {unit}"))
    return facts


def _number(value: float) -> str:
    return "infinite" if np.isinf(value) else f"{value:.6g}"


def has_friction(run: Trajectory) -> bool:
    """Return whether the ground of a motion has a friction coefficient, according to its result."""
    given = "ground_friction" in run.attributes
    return given or not np.array_equal(run["utilisation"], run["friction_needed"])


def plain_facts(run: Trajectory) -> Lines:
    """Return the facts about duration and cost of a motion."""
    return [duration_fact(run), integrator_fact(run)]


def outcome_fact(run: Trajectory) -> tuple[str, str]:
    """Return the fact about the outcome of a motion, the first line of every summary."""
    return "outcome", outcome_words(run)


def duration_fact(run: Trajectory) -> tuple[str, str]:
    """Return the fact about duration and number of samples of a motion."""
    return "duration", f"{run.t[-1] - run.t[0]:g} s, {run.t.size} samples"


def integrator_fact(run: Trajectory) -> tuple[str, str]:
    """Return the fact about the cost of the integration."""
    counts = run.statistics
    if "steps" not in counts:
        return "integrator", "not used"
    return (
        "integrator",
        f"{counts['steps']:.0f} steps, {counts['residuals']:.0f} evaluations, "
        f"{counts['cpu_seconds']:.3g} s CPU, tolerance {counts['tolerance']:g}",
    )


class VerbSetup(Protocol):
    """Common attributes of the set-ups of all verbs: start, sample times and facts."""

    @property
    def start(self) -> Trajectory:
        """One sample: the vehicle at its start."""

    @property
    def t(self) -> Array:
        """Times of the samples [s]."""

    @property
    def facts(self) -> Lines:
        """Facts about ground, vehicle and inputs: pairs of name and text."""


class Watch(NamedTuple):
    """Callbacks during the solution of a problem; the first three may raise KeyboardInterrupt.

    Attributes
    ----------
    time : callable or None
        Called with the time reached. [s]
    line : callable or None
        Called for every iterate of a plan with the phase of the search and a line of text.
    path : callable or None
        Called for every iterate of a plan with the path of the platform in map coordinates, an
        ndarray of shape (n, 2). [m]
    keep : callable
        Called with a `VerbSolution` of what is computed so far, which is the result if the
        computation is interrupted or fails afterwards. The last one counts.
    """

    time: Callable[[float], None] | None = None
    line: Callable[[str, str], None] | None = None
    path: Callable[[Array], None] | None = None
    keep: Callable[[VerbSolution], None] = lambda _: None


class VerbSolution(NamedTuple):
    """Solution of a problem: a motion, its set-up and further arrays.

    Attributes
    ----------
    trajectory : Trajectory
        The motion, complete or up to its stop.
    setup : VerbSetup
        Model, start and inputs of the motion.
    arrays : mapping of str to ndarray
        Arrays for the result file besides the samples.
    """

    trajectory: Trajectory
    setup: VerbSetup
    arrays: Mapping[str, Array] = NOTHING


def integrate(setup: Any, options: SolverOptions, watch: Watch) -> Trajectory:
    """Return the motion of a set-up, or its part up to Ctrl-C or to a failure of the integrator.

    The motion has all samples of a sampled driving law.

    Raises
    ------
    SolverError
        If the integrator fails before the first sample.
    """

    def progress(t: float) -> bool:
        try:
            if watch.time is not None:
                watch.time(t)
        except KeyboardInterrupt:
            return False
        return True

    solver = simulate_sampled if setup.every else simulate
    posed = setup.dae, setup.start, setup.inputs, setup.t
    try:
        return solver(*posed, options=options, progress=progress)
    except SolverError as error:
        if error.trajectory is None:
            raise
        return error.trajectory


def with_diagnostics(
    run: Trajectory,
    diagnostics: Mapping[str, Callable[[Trajectory], Trajectory]],
    keep: Callable[[Trajectory], None],
) -> Trajectory:
    """Return a motion with diagnostics; a fact names those that fail, with the error.

    KeyboardInterrupt is raised after Ctrl-C.

    Parameters
    ----------
    run : Trajectory
        The motion.
    diagnostics : mapping of str to callable
        Functions that return a motion with one more diagnostic, by name.
    keep : callable
        Called after Ctrl-C with the motion and the diagnostics so far.
    """
    for name, diagnose in diagnostics.items():
        try:
            check_interrupt()
            run = diagnose(run)
        except KeyboardInterrupt:
            t = float(run.t[-1])
            words = f"the motion is computed to its end, but not all diagnostics: without {name}"
            stop = run.stop or Stop("interrupted", t, words, Outcome.INTERRUPTED)
            keep(replace(run, stop=stop))
            raise
        except Exception as error:  # a failed diagnostic must not lose the motion
            earlier = run.facts[FAILED_DIAGNOSTICS].value if FAILED_DIAGNOSTICS in run.facts else []
            failures = [*earlier, f"{name}: {type(error).__name__}: {error}"]
            run = run.with_facts({FAILED_DIAGNOSTICS: Fact(failures)})
    return run


class CrossCheck(NamedTuple):
    """Differences between the motions of two formulations of contact.

    Attributes
    ----------
    other : str
        Name of the other formulation.
    differences : tuple of Difference
        Largest difference of each quantity over the motion.
    """

    other: str
    differences: tuple[Difference, ...]


@dataclass(frozen=True, eq=False)
class Result(Generic[P, D]):
    """Motion of a problem, from `run_problem` or from a result file.

    Attributes
    ----------
    kind : str
        Name of the verb; empty if the result file does not name a known verb.
    trajectory : Trajectory
        The motion, complete or up to its stop.
    verification : mapping of str to Fact
        Largest differences of the motion from an independent computation, and violations of
        limits, by name; empty for verbs without verification.
    setup : VerbSetup or None
        Model, start and inputs of the motion; None if it was read from a file.
    arrays : mapping of str to ndarray
        Arrays of the result file besides the samples, such as the plan for a warm start.
    load : callable
        Function without arguments that returns the problem.
    """

    kind: str
    trajectory: Trajectory
    verification: Mapping[str, Fact]
    setup: D
    arrays: Mapping[str, Array]
    load: Callable[[], Problem[P]]

    def __repr__(self) -> str:
        return f"Result: {self.kind}, {self.outcome.title}\n{self.trajectory!r}"

    @property
    def outcome(self) -> Outcome:
        """Outcome of the motion."""
        return self.trajectory.outcome

    @property
    def problem(self) -> Problem[P]:
        """Problem of the result, read from the result file when it is needed.

        Raises
        ------
        DataError
            If the result was read from a file without a problem, or input files that the problem
            names are missing.
        ProblemError
            If the problem is not valid in this version.
        """
        return self.load()


class Verb(ABC):
    """Interface of a verb: schema and commands.

    Attributes
    ----------
    schema : type
        Record type of the verb's problem files.
    commands : tuple of str
        Names of the commands that accept the verb; the first one solves its problems.
    """

    schema: ClassVar[type[CommonKeys]]
    commands: ClassVar[tuple[str, ...]] = ("run",)

    @property
    def name(self) -> str:
        """Value of the key ``verb``."""
        (name,) = get_args(self.schema.model_fields["verb"].annotation)
        return str(name)


class MotionVerb(Verb):
    """Interface of a verb whose solution is the motion of one vehicle.

    Attributes
    ----------
    options : tuple of str
        Supported options of ``slipfree run``: some of `CROSS_CHECK` and `RESUME`.
    is_timed : bool
        Whether the solver proceeds along the time of the motion, as integrators do.
    checks : tuple of str
        Names of the facts about accuracy and validity, which reports list separately.
    metrics_shown : tuple of str
        Names of the metrics that a sweep shows by default.
    verified : tuple of str
        Beginnings of the names of facts that verify a motion; see `verification`.
    """

    options: ClassVar[tuple[str, ...]] = ()
    is_timed: ClassVar[bool] = True
    checks: ClassVar[tuple[str, ...]] = ()
    metrics_shown: ClassVar[tuple[str, ...]] = ()
    verified: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def build(self, problem: Problem[Any]) -> VerbSetup:
        """Return model, start and inputs of a problem.

        Raises
        ------
        ProblemError
            If the problem cannot be set up.
        """

    @abstractmethod
    def solve(
        self, problem: Problem[Any], setup: Any, watch: Watch, resume: SavedPlan | None
    ) -> VerbSolution:
        """Return the motion of a problem.

        Parameters
        ----------
        problem : Problem
            The problem.
        setup : VerbSetup
            Result of `build`.
        watch : Watch
            Callbacks that report the progress.
        resume : SavedPlan or None
            Plan for a warm start.

        Raises
        ------
        SolverError
            If the solver fails before the first sample; a later failure is the stop of the
            trajectory.
        """

    @abstractmethod
    def describe_start(self, problem: Problem[Any], setup: Any) -> tuple[Trajectory, Lines]:
        """Return the start, with headings in the frame of the problem, and facts about it."""

    @abstractmethod
    def facts(self, run: Trajectory) -> dict[str, Fact]:
        """Return the facts of a motion, those stored in it included, by name."""

    @abstractmethod
    def summary(self, run: Trajectory) -> Lines:
        """Return the summary of a motion, pairs of name and text, which show its facts."""

    def describe_end(self, run: Trajectory) -> str:
        """Return a description of the end of a complete motion; empty by default."""
        return ""

    @abstractmethod
    def figures(self, result: Result) -> tuple[Plot, ...]:
        """Return the figures of a result, the most important first."""

    @abstractmethod
    def shown(self, result: Result, name: str) -> Any:
        """Return the motion of a result with ground and vehicle, as input of the viewer.

        DataError is raised if ground or vehicle differ from those of the motion.
        """

    def attributes(self, problem: Problem[Any], setup: Any) -> dict[str, str]:
        """Return the attributes of the result file that only this verb has; none by default."""
        return {}

    def warnings(self, run: Trajectory) -> Sequence[str]:
        """Return warnings about a motion; none by default."""
        return ()

    def verification(self, run: Trajectory) -> dict[str, Fact]:
        """Return differences from an independent computation and violations of limits, by name."""
        return {name: fact for name, fact in run.facts.items() if name.startswith(self.verified)}

    def cross_check(self, result: Result) -> CrossCheck:
        """Return the differences from the other formulation of contact.

        Raises
        ------
        NotImplementedError
            If the verb does not offer a cross-check.
        """
        raise NotImplementedError(CROSS_CHECK)


class Extremes(NamedTuple):
    """Names of the quantities whose last values, extremes or changes are facts.

    Attributes
    ----------
    end : tuple of str
        Quantities whose last value is a fact, such as ``end_x``.
    largest : tuple of str
        Quantities whose largest absolute value is a fact, such as ``pitch_largest``.
    least, greatest : tuple of str
        Quantities whose smallest or greatest value is a fact, such as ``clearance_least`` or
        ``z_greatest``.
    gained : tuple of str
        Quantities whose change from start to end is a fact, such as ``work``.
    """

    end: tuple[str, ...] = ()
    largest: tuple[str, ...] = ()
    least: tuple[str, ...] = ()
    greatest: tuple[str, ...] = ()
    gained: tuple[str, ...] = ()

    def of(self, run: Trajectory) -> dict[str, Fact]:
        """Return the facts of a motion; those of quantities that it does not have are omitted."""
        rules: tuple[tuple[tuple[str, ...], str, Callable[[Array], Any]], ...] = (
            (self.end, "end_{}", lambda values: values[-1]),
            (self.largest, "{}_largest", lambda values: np.abs(values).max()),
            (self.least, "{}_least", np.fmin.reduce),
            (self.greatest, "{}_greatest", np.fmax.reduce),
            (self.gained, "{}", lambda values: values[-1] - values[0]),
        )
        return {
            form.format(name): Fact(float(rule(run[name].ravel())), run.columns[name].label.unit)
            for names, form, rule in rules
            for name in names
            if name in run.columns
        }
