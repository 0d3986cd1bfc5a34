"""``slipfree run``: solve a problem, write and draw the result."""

from __future__ import annotations

import shlex
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slipfree.cli import console, outputs
from slipfree.cli.console import INTERRUPTED, Draw, File, Settings, Trust, output_option
from slipfree.cli.outputs import OUTPUT
from slipfree.cli.show import show as show_results
from slipfree.core.errors import SlipfreeError, WriteError, require
from slipfree.system.interrupt import held_interrupt, interrupt_requested
from slipfree.system.regular_files import check_ending

if TYPE_CHECKING:
    from collections.abc import Iterator

    from slipfree.problem.verbs.base import Result


def run(
    file: File,
    out: Annotated[Path | None, output_option("OUT.nc")] = None,
    csv: Annotated[Path | None, typer.Option(metavar="OUT.csv")] = None,
    settings: Settings = None,
    figures: Annotated[Path | None, typer.Option(metavar="DIR")] = None,
    draw: Draw = True,
    figures_all: Annotated[bool, typer.Option("--figures-all")] = False,
    show_page: Annotated[bool, typer.Option("--show")] = False,
    cross_check: Annotated[bool, typer.Option("--cross-check")] = False,
    resume: Annotated[Path | None, typer.Option(metavar="OUT.nc")] = None,
    trust: Trust = None,
) -> None:
    """Solve a problem and write the result.

    Print a summary and draw figures.

    Parameters
    ----------
    out : path, optional
        Result file; default: the [output] file of the problem, or its name with .nc in the current
        folder.
    csv : path, optional
        Also write the samples as CSV.
    figures : path, optional
        Folder for figures; default: OUT_figures beside OUT.nc.
    figures_all : bool
        Draw all figures, not only the main ones.
    show_page : bool
        Show the motion in a browser afterwards.
    cross_check : bool
        Also solve with the other formulation of contact (closure or montana), and print the largest
        differences.
    resume : path, optional
        Start the search from the plan in a result file; mesh, ground or goal may differ.
    """
    from slipfree.files.netcdf import read_arrays, write, write_csv
    from slipfree.plan.polynomial_motion import from_arrays
    from slipfree.problem.inputs import files_read
    from slipfree.problem.load import check_option, verb_of
    from slipfree.problem.result import cross_check as find_differences
    from slipfree.problem.result import run_problem
    from slipfree.problem.verbs.base import CROSS_CHECK, RESUME, outcome_fact

    if show_page:
        require("viser", "view", "run --show: ")
    problem = console.read_problem(file, settings, trust)
    verb = verb_of(problem)
    options = [*(["-o", str(out)] if out else []), *["--no-draw"] * (not draw)]
    options += [word for each in trust or () for word in ("--trust", str(each))]
    output = problem.spec.output
    is_named = bool(out or (output and problem.source.is_set(OUTPUT)))
    out = out or Path(output.file if output else f"{problem.source.path.stem}.nc")
    folder = (figures or out.parent / f"{out.stem}_figures") if draw else None
    if not is_named:
        outputs.check_default_outputs(out, None if figures else folder, problem)
    # the search may go on in the file from which it resumes
    outputs.check_outputs([csv], [*files_read(problem), *([resume] if resume else [])])
    outputs.check_outputs([out, csv], files_read(problem), folder=folder)
    check_ending(out, (".nc",), "; --csv OUT.csv also writes a table")
    for option, value in ((CROSS_CHECK, cross_check), (RESUME, resume)):
        if value:
            check_option(problem, option)
    former = None if resume is None else from_arrays(read_arrays(resume), str(resume))

    place = out

    def keep(result: Result) -> None:
        with suppress(WriteError), held_interrupt():
            write(place, result.trajectory, result.arrays)
        console.detail(f"wrote {place}: {result.outcome.title}")

    with console.reporting(problem.spec.time.duration if verb.is_timed else None) as reports:
        # a solved plan is written before it is verified, in case that this process is killed
        result = run_problem(problem, *reports, former, keep=keep, beside=out)
        counts = result.trajectory.statistics.items()
        console.detail("solved: " + ", ".join(f"{name} {value:.6g}" for name, value in counts))
        files = [outputs.save(out, lambda path: write(path, result.trajectory, result.arrays))]
        if csv is not None:
            files.append(outputs.save(csv, lambda path: write_csv(path, result.trajectory)))
        is_interrupted = interrupt_requested() or result.outcome.exit_code == INTERRUPTED
    with _after(files[0], "summary"):
        motion = result.trajectory
        outcome = outcome_fact(motion)
        main = [outcome, *verb.summary(motion, main=True)]
        console.print_facts([outcome, *result.setup.facts, *verb.summary(motion)], main=main)
        console.add_json("outcome", motion.outcome.name.lower)
        console.add_json("result", lambda: outputs.motion_json(motion, verb.facts(motion)))
        for words in verb.warnings(motion):
            console.warn(words)
    names = ", ".join(map(str, files))
    facts = shlex.join(["slipfree", "info", str(files[0])])
    console.print_line(f"wrote {names}; all facts: {facts}")
    console.detail(f"wrote {names}")
    if cross_check and not is_interrupted:
        with _after(files[0], "cross-check"):
            other, differences = find_differences(result)
            differences = tuple(sorted(differences, key=lambda each: -each.size))
            count = f"of {len(differences)} quantities"
            console.print_line(f"largest differences from formulation = {other!r}, {count}:")
            rows = [
                {"name": label.full, "unit": label.unit, "difference": size, "time": t}
                for label, size, t in differences
            ]
            console.add_json("cross_check", lambda: rows)
            line = "{difference:.2e} {unit} at {time:g} s"
            console.show([(f"  {row['name']}", line.format(**row)) for row in rows[:8]])
    if folder is not None and not is_interrupted:
        with _after(files[0], "figures"):
            from slipfree.show.plots import MAIN_COUNT

            plots = verb.figures(result)
            drawn = plots if figures_all else plots[:MAIN_COUNT]
            rest = len(plots) - len(drawn)
            outputs.draw_figures(drawn, folder, f"; {rest} more with --figures-all" * bool(rest))
    if show_page and not is_interrupted:
        with _after(files[0], "show"):
            show_results([files[0]])
    if result.outcome.exit_code:
        again = outputs.resume_command(motion, files[0], *options)
        outputs.print_incomplete(motion, files[0], again)
    elif is_interrupted:
        console.print_error(f"interrupted; {files[0]} contains the result, which is complete")
    if code := INTERRUPTED if is_interrupted else result.outcome.exit_code:
        raise typer.Exit(code)


@contextmanager
def _after(out: Path, name: str) -> Iterator[None]:
    """Print an error of a step after the result is written; the command ends with exit code 1."""
    try:
        yield
    except OSError:  # of stdout or a disk
        raise
    except Exception as error:  # it must not hide where the result is
        kind = "" if isinstance(error, SlipfreeError) else f"{type(error).__name__}: "
        console.print_error(f"{name}: {kind}{error}; {out} contains the result")
        console.note_failure()
