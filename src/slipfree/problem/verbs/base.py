"""Interface between commands and verbs, and the lines of all summaries.

A verb is a kind of problem: the value of the key ``verb`` in a problem file. Commands use only this
interface and `slipfree.problem.load`; everything specific to a verb is in the module of the verb.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, get_args

import numpy as np
from typing_extensions import TypeVar

from slipfree.core.facts import Fact, Facts, Lines, rows
from slipfree.core.outcome import Outcome
from slipfree.core.records import Array
from slipfree.core.trajectory import SolverError, Stop, Trajectory, outcome_words
from slipfree.files.netcdf import NOTHING
from slipfree.models.samples import has_friction
from slipfree.problem.problem import Problem
from slipfree.problem.schema import CommonKeys
from slipfree.solve.options import SolverOptions
from slipfree.solve.simulate import simulate
from slipfree.solve.zero_order_hold import simulate_sampled
from slipfree.system.interrupt import check_interrupt

if TYPE_CHECKING:
    from slipfree.models.montana import Difference


VERB_ATTRIBUTE = "verb"  # attribute of result files with the name of the verb
FAILED_DIAGNOSTICS = "failed_diagnostics"  # fact with names and errors of diagnostics
PLAIN_ROWS = rows(
    """\
duration: {duration:g}, {samples} samples
!integrator: {steps:.0f} steps, {residuals:.0f} evaluations, {cpu_seconds:.3g} s CPU, tolerance \
{tolerance:g}"""
)
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
        ends = ("infinite" if np.isinf(end) else f"{end:.6g}" for end in dict.fromkeys((low, high)))
        span = " to ".join(ends)
        facts.append((name, span if unit == "1" or np.isinf(low) else f"{span} {unit}"))
    return facts


def outcome_fact(run: Trajectory) -> tuple[str, str]:
    """Return the fact about the outcome of a motion, the first line of every summary."""
    return "outcome", outcome_words(run)


def values_of(run: Trajectory, facts: Facts) -> dict[str, Any]:
    """Return the values in the rows of summaries: facts, attributes, statistics, samples."""
    duration, share = Fact(float(run.t[-1] - run.t[0]), "s"), ""
    # the integrator's error test ignores the unknowns of pressed wheels
    if "newton_step_largest" in facts and "steps" in run.statistics and "depth" not in run:
        error = facts["newton_step_largest"].value / run.statistics["tolerance"]
        share = f", {error:.3g} x the tolerance"
    counted = {"samples": run.t.size, "duration": duration, "of_tolerance": share}
    return {**counted, **run.attributes, **run.statistics, **facts}


class Watch(NamedTuple):
    """Callbacks during the solution of a problem; the first three may raise KeyboardInterrupt."""

    time: Callable[[float], None] | None = None  # called with the time reached [s]
    line: Callable[[str, str], None] | None = None  # phase of the search, and a line, per iterate
    path: Callable[[Array], None] | None = None  # path of an iterate on the map, shape (n, 2) [m]
    # what is computed so far: the last one is the result if the computation ends early
    keep: Callable[[Trajectory, Mapping[str, Array]], None] = lambda *_: None
    beside: Path | None = None  # output, next to which a folder keeps finished parts


def integrate(setup: Any, options: SolverOptions, watch: Watch) -> Trajectory:
    """Return the motion of a set-up, or its part up to Ctrl-C or to a failure of the integrator.

    The motion has all samples of a sampled driving law. SolverError is raised if the integrator
    fails before the first sample.
    """

    def progress(t: float) -> bool:
        try:
            if watch.time is not None:
                watch.time(t)
        except KeyboardInterrupt:
            return False
        return True

    solver = simulate_sampled if setup.every else simulate
    problem = setup.dae, setup.start, setup.inputs, setup.t
    try:
        return solver(*problem, options=options, progress=progress)
    except SolverError as error:
        if error.trajectory is None:
            raise
        return error.trajectory


def with_diagnostics(
    run: Trajectory,
    diagnostics: Mapping[str, Callable[[Trajectory], Trajectory]],
    watch: Watch,
    arrays: Mapping[str, Array] = NOTHING,
) -> Trajectory:
    """Return a motion with diagnostics, by name; a fact names those that fail, with the error.

    After Ctrl-C the motion is kept with the diagnostics so far, and KeyboardInterrupt is raised.
    """
    for name, diagnose in diagnostics.items():
        try:
            check_interrupt()
            run = diagnose(run)
        except KeyboardInterrupt:
            t = float(run.t[-1])
            words = f"the motion is computed to its end, but not all diagnostics: without {name}"
            stop = run.stop or Stop("interrupted", t, words, Outcome.INTERRUPTED)
            watch.keep(replace(run, stop=stop), arrays)
            raise
        except Exception as error:  # a failed diagnostic must not lose the motion
            earlier = run.facts[FAILED_DIAGNOSTICS].value if FAILED_DIAGNOSTICS in run.facts else []
            failures = [*earlier, f"{name}: {type(error).__name__}: {error}"]
            run = run.with_facts({FAILED_DIAGNOSTICS: Fact(failures)})
    return run


class CrossCheck(NamedTuple):
    """Largest differences of the quantities from the motion in another formulation of contact."""

    other: str  # name of the other formulation
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
    setup : Setup or None
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
            If the result was read from a file without its problem, ground and vehicle.
        ProblemError
            If the problem is not valid in this version.
        """
        return self.load()


class Verb:
    """A kind of problem: the record of its files, and the commands that accept them."""

    schema: type[CommonKeys]
    commands: tuple[str, ...]  # the first one solves the problems

    def __init__(self, schema: type[CommonKeys], *commands: str) -> None:
        self.schema, self.commands = schema, commands

    @property
    def name(self) -> str:
        """Value of the key ``verb``."""
        (name,) = get_args(self.schema.model_fields["verb"].annotation)
        return str(name)
