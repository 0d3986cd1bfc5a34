"""``slipfree run``: solve a problem, write and draw what came of it."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slipfree.cli.common import (
    OUTPUT,
    File,
    Settings,
    check_default_places,
    check_places,
    interruptible,
    read_problem,
    reported,
    show,
    tell,
    throttled,
)
from slipfree.cli.json_output import motion_answer
from slipfree.cli.messages import (
    complain,
    detail,
    has_bar,
    is_verbose,
    put,
    put_file,
    say,
    visible,
    warn,
)
from slipfree.errors import DataError

if TYPE_CHECKING:
    from collections.abc import Callable

    from slipfree.plan.warm_start import SavedPlan
    from slipfree.problem.load import Problem
    from slipfree.problem.schema import Climb, Motion
    from slipfree.problem.solve import Outcome
    from slipfree.trajectory import Stop

SELDOM = 1.0  # between two lines on the time reached [s]


def run(
    file: File,
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="OUT.nc",
            help="Result file; default: the problem's [output] file, or its name with .nc, here.",
        ),
    ] = None,
    csv: Annotated[
        Path | None, typer.Option(metavar="OUT.csv", help="Write the samples as a table as well.")
    ] = None,
    settings: Settings = None,
    figures: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder for figures; default: OUT_figures beside OUT.nc."),
    ] = None,
    draw: Annotated[bool, typer.Option("--draw/--no-draw", help="Draw figures.")] = True,
    cross_check: Annotated[
        bool,
        typer.Option(
            "--cross-check", help="Solve in the other formulation of contact too, and compare."
        ),
    ] = False,
    resume: Annotated[
        Path | None,
        typer.Option(
            metavar="OUT.nc",
            help="Start a plan from the one in a result file, whatever its mesh, ground or goal.",
        ),
    ] = None,
    animation: Annotated[
        Path | None, typer.Option(metavar="OUT.gif", help="Write a climb as a moving picture.")
    ] = None,
) -> None:
    """Solve a problem: write the result, print a summary, draw figures."""
    with reported():
        from slipfree.problem.load import climbs
        from slipfree.problem.solve import check_cross

        problem = read_problem(file, settings)
        is_named = bool(out or (problem.spec.output and problem.source.is_set(OUTPUT)))
        out = out or Path(output_of(problem))
        folder = (figures or out.parent / f"{out.stem}_figures") if draw else None
        if not is_named:
            check_default_places(out, None if figures else folder, problem)
        check_places([out, csv, animation], folder, problem)
        if animation is not None:
            _check_animation(animation, problem)
        if cross_check:
            check_cross(problem)
        former = _former(problem, resume)
        outcome = _solve(problem, former)
        motion = outcome.trajectory
        _save(outcome, out, csv)
        _print_outcome(outcome)
        _wrote(out, *([csv] if csv else []))
        if cross_check and not climbs(problem):
            _cross_check(problem, outcome)
        if folder is not None:
            _draw(outcome, folder)
        if animation is not None:
            _animate(outcome, animation)
        if motion.stop is not None:
            say_stopped(motion.stop, out)
            raise typer.Exit(motion.outcome.exit_code)


def output_of(problem: Problem[Motion] | Problem[Climb]) -> str:
    """Return the name of the result file."""
    spec = problem.spec.output
    return spec.file if spec else f"{problem.source.path.stem}.nc"


def _solve(problem: Problem[Motion] | Problem[Climb], former: SavedPlan | None) -> Outcome:
    """Return the outcome; show a bar meanwhile if somebody is looking."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    from slipfree.problem.solve import run_problem

    console = Console(file=sys.stderr)  # as it is now: messages of integrators are kept from it
    with interruptible() as poll:
        if is_verbose():
            return _told(run_problem(problem, *_telling(poll, problem.spec.time.duration), former))
        if not (console.is_terminal and has_bar()):
            return run_problem(problem, lambda _: poll(), lambda _: poll(), former)
        with Progress(console=console, transient=True) as bar:
            task = bar.add_task(
                "solving", total=None if problem.spec.verb == "plan" else problem.spec.time.duration
            )
            show = throttled(lambda t: bar.update(task, completed=t))
            show_line = throttled(lambda line: bar.update(task, description=escape(visible(line))))

            def progress(t: float) -> None:
                poll()
                show(t)

            def show_what(line: str) -> None:
                poll()
                show_line(line)

            return run_problem(problem, progress, show_what, former)


def _telling(
    poll: Callable[[], None], duration: float
) -> tuple[Callable[[float], None], Callable[[str], None]]:
    """Return what says the time reached, and every iterate of a plan, as details."""
    last = 0.0

    def progress(t: float) -> None:
        nonlocal last
        poll()
        now = time.monotonic()
        if not last:
            last = now
            detail("stood the vehicle on its start; integrates")
        elif now - last > SELDOM:
            last = now
            detail(f"integrated to {t:.4g} of {duration:g} s")

    def line(words: str) -> None:
        poll()
        detail(words)

    return progress, line


def _told(outcome: Outcome) -> Outcome:
    """Say what the solver counted."""
    counts = outcome.trajectory.statistics.items()
    detail("solved: " + ", ".join(f"{name} {value:.6g}" for name, value in counts))
    return outcome


def _former(problem: Problem[Motion] | Problem[Climb], file: Path | None) -> SavedPlan | None:
    """Return the plan to start from, if one is named."""
    from slipfree.files.netcdf import read_arrays
    from slipfree.plan.warm_start import from_arrays

    if file is None:
        return None
    if problem.spec.verb != "plan":
        where = problem.source.where(("verb",))
        raise DataError(f"{where}: expected 'plan' for --resume, found {problem.spec.verb!r}")
    return from_arrays(read_arrays(file), str(file))


def _wrote(*files: Path) -> None:
    """Say which files were written."""
    for file in files:
        put_file(file)
    names = ", ".join(map(str, files))
    say(f"wrote {names}")
    detail(f"wrote {names}")


def _save(outcome: Outcome, out: Path, csv: Path | None) -> None:
    from slipfree.files.netcdf import write, write_csv

    write(out, outcome.trajectory, outcome.arrays)
    if csv is not None:
        write_csv(csv, outcome.trajectory)


def _check_animation(file: Path, problem: Problem[Motion] | Problem[Climb]) -> None:
    if problem.spec.verb != "climb":
        where = problem.source.where(("verb",))
        raise DataError(f"{where}: expected 'climb' for --animation, found {problem.spec.verb!r}")
    if file.suffix != ".gif":
        raise DataError(f"{file}: expected a name that ends in .gif for an animation")


def _animate(outcome: Outcome, file: Path) -> None:
    from slipfree.problem.verbs.climb import Climbing
    from slipfree.show.climb_figures import animate

    if isinstance(outcome.setup, Climbing):
        animate(outcome.trajectory, outcome.setup.climber, outcome.setup.profile, file)
        _wrote(file)


def _draw(outcome: Outcome, folder: Path) -> None:
    from slipfree.problem.verbs.climb import Climbing
    from slipfree.problem.verbs.plan import Planning, figure_options

    if isinstance(outcome.setup, Climbing):
        from slipfree.show.climb_figures import save_climb_figures

        setup = outcome.setup
        paths = save_climb_figures(
            outcome.trajectory, setup.climber, setup.profile, folder, plan=setup.plan
        )
        _drew(paths, folder)
        return
    grid = outcome.setup.ground.grid
    if isinstance(outcome.setup, Planning):
        from slipfree.show.plan_figures import save_plan_figures

        layers, options = outcome.setup.layers, figure_options(outcome.setup)
        paths = save_plan_figures(outcome.trajectory, grid, layers, folder, **options)
    else:
        from slipfree.show.motion_figures import save_figures

        paths = save_figures(outcome.trajectory, grid, folder)
    _drew(paths, folder)


def _drew(files: list[Path], folder: Path) -> None:
    """Say which figures were drawn."""
    for file in files:
        put_file(file)
    say(f"drew {len(files)} figures in {folder}")
    detail(f"drew {len(files)} figures in {folder}")


def _cross_check(problem: Problem[Motion], outcome: Outcome) -> None:
    """Print where the two formulations of contact differ, the largest differences first."""
    from slipfree.problem.solve import check_cross, cross, other_formulation

    other = other_formulation(check_cross(problem))
    differences = sorted(cross(problem, outcome), key=lambda each: -each.size)
    say(f"largest differences from formulation = {other!r}, of {len(differences)} quantities:")
    put(
        "cross_check",
        lambda: [
            {
                "name": each.label.full,
                "unit": each.label.unit,
                "difference": each.size,
                "time": each.t,
            }
            for each in differences
        ],
    )
    show(
        [
            (f"  {each.label.full}", f"{each.size:.2e} {each.label.unit} at {each.t:g} s")
            for each in differences[:8]
        ]
    )


def _print_outcome(outcome: Outcome) -> None:
    from slipfree.problem.solve import setup_facts
    from slipfree.problem.summary import motion_facts, steering_warning

    motion = outcome.trajectory
    tell(setup_facts(outcome.setup) + motion_facts(motion))
    put("result", lambda: motion_answer(motion))
    warning = steering_warning(motion)
    if warning and not (motion.stop and warning in motion.stop.words):
        warn(warning)


def say_stopped(stop: Stop, out: Path) -> None:
    """Say why a motion ends early, and where it is kept."""
    complain(f"stopped early at t = {stop.t:.6g} s: {stop.words}; {out} holds the motion to there")
