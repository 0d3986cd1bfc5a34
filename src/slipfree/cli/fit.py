"""Fits: ``fit`` a vehicle to a log or a soil to tests, and compute a single ``wheel`` in soil."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from slipfree.cli.common import (
    INTERRUPTED,
    STOPPED,
    Draw,
    File,
    Settings,
    Trust,
    about,
    add_json,
    output_option,
    print_error,
    print_facts,
    print_line,
    read_problem,
)
from slipfree.cli.new import write_new_file
from slipfree.cli.outputs import check_outputs, default_table, save
from slipfree.cli.outputs import draw as draw_plots
from slipfree.core.errors import ModelError
from slipfree.system.interrupt import held_interrupt, interrupt_requested

if TYPE_CHECKING:
    from slipfree.core.facts import Lines
    from slipfree.show.plots import Plot


def fit(
    file: File,
    settings: Settings = None,
    out: Annotated[
        Path | None,
        output_option(
            "OUT.csv",
            "Table of the estimates; the table of the windows and the figure have the same "
            "name with _windows.csv and .png. Default: the name of the file, in the current "
            "folder; with _fit if that is an input.",
        ),
    ] = None,
    write: Annotated[
        Path | None,
        typer.Option(metavar="FILE.toml", help="Write the fitted vehicle or soil."),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace an existing vehicle or soil file.")
    ] = False,
    predict: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="LOG",
            help="Another log, to be predicted with numbers that are fitted to all logs of the "
            "file; may be repeated. By default, windows that are left out are predicted, or over a "
            "map the logs of each folder.",
        ),
    ] = None,
    draw: Draw = True,
    trust: Trust = None,
) -> None:
    """Fit a vehicle to a log of motion, or a soil to wheel tests.

    With verb = 'fit-over-map', fit models of a skid-steered vehicle to logs of commands and
    positions over a map, and print the errors of their predictions on logs that were left out.

    Print the estimates with 95 % intervals, the combinations of unknowns that the data do not
    determine, and the errors of predictions that were not used for the fit. If the data do not
    determine an unknown, the exit code is 1 and no vehicle or soil is written. A wheel file, with
    the table [wheel], is fitted to the measured points that it names.
    """
    with about(file):
        from slipfree.files.tables import write_rows
        from slipfree.problem.wheel_test import is_wheel_file

        if is_wheel_file(file):
            work = _soil_fit(file, settings or [])
            if predict:
                raise ModelError(
                    f"{file}: expected a problem file for --predict, found a wheel file; omit "
                    "--predict"
                )
        else:
            problem: Any = read_problem(file, settings, trust, "fit")
            if problem.spec.verb == "fit-over-map":
                if write and problem.spec.vehicle is None:
                    raise ModelError(
                        f"{file}: expected the table [vehicle] for --write, found none; add it, or "
                        "omit --write: the constants are in a table"
                    )
                work = _fit_over_map(problem, predict or [])
            else:
                work = _log_fit(problem, predict or [])
        table = out or default_table(file, "fit", work.inputs)
        tables = [table, *(table.with_name(f"{table.stem}_{end}.csv") for end in work.ends)]
        picture = table.with_suffix(".png") if draw else None
        check_outputs([*tables, picture, write], work.inputs)
        with held_interrupt(from_first_poll=True) if work.is_held else nullcontext():
            result = work.solve()
            files = [
                save(path, partial(write_rows, names=rows[0], rows=rows[1]))
                for path, rows in zip(tables, result.tables, strict=True)
            ]
            if write is not None and not result.undetermined:
                write_new_file(result.text(), write, force)
                files.append(write)
            is_interrupted = work.is_held and (interrupt_requested() or result.is_interrupted)
        print_facts(result.facts)
        for key, objects in result.objects.items():
            add_json(key, partial(list, objects))
        if picture is not None and not is_interrupted:
            files += draw_plots([result.plot(picture.stem)], picture.parent)
        print_line(f"wrote {' and '.join(map(str, files))}")
        if is_interrupted:
            print_error(f"interrupted; {files[0]} contains the estimates so far")
            raise typer.Exit(INTERRUPTED)
        if result.undetermined:
            unwritten = f"; no {work.subject} was written" if write else ""
            print_error(
                f"{file}: expected {work.data} all unknowns, found no information on "
                f"{', '.join(result.undetermined)}{unwritten}; give priors, fit fewer unknowns, or "
                f"use {work.remedy}"
            )
            raise typer.Exit(STOPPED)


class _FitResult(NamedTuple):
    """Result of a fit, for the output of the command."""

    facts: Lines
    tables: list[tuple[list[str], list[list[Any]]]]
    objects: dict[str, list[dict[str, Any]]]  # of the JSON output
    text: Callable[[], str]
    plot: Callable[[str], Plot]
    undetermined: tuple[str, ...] = ()
    is_interrupted: bool = False


class _FitWork(NamedTuple):
    """A fit to be solved, with the files that it reads."""

    inputs: list[Path]
    ends: tuple[str, ...]  # of the names of further tables
    solve: Callable[[], _FitResult]
    subject: str = ""  # what is fitted
    data: str = ""
    remedy: str = ""
    is_held: bool = True  # whether an interrupted fit has a result


def _objects(table: tuple[list[str], list[list[Any]]]) -> list[dict[str, Any]]:
    return [dict(zip(table[0], row, strict=True)) for row in table[1]]


def _log_fit(problem: Any, predict: Sequence[Path]) -> _FitWork:
    from slipfree.files.vehicle_toml import vehicle_text
    from slipfree.problem.inputs import files_read
    from slipfree.problem.verbs import fit as verb
    from slipfree.show.fit_figures import fit_plot

    def solve() -> _FitResult:
        fitted = verb.fit(problem, predict)
        estimate = fitted.calibration.estimate
        estimates = verb.estimate_rows(estimate)
        comments = verb.vehicle_comments(fitted.others)
        return _FitResult(
            verb.facts(fitted),
            [estimates, verb.window_rows(fitted)],
            {"errors": verb.error_rows(fitted), "estimates": _objects(estimates)},
            partial(vehicle_text, fitted.vehicle, comments),
            partial(fit_plot, calibration=fitted.calibration),
            estimate.undetermined,
            estimate.is_interrupted,
        )

    words = "vehicle", "a log that determines", "a log with other manoeuvres"
    return _FitWork([*files_read(problem), *predict], ("windows",), solve, *words)


def _soil_fit(file: Path, settings: list[str]) -> _FitWork:
    from slipfree.problem import wheel_test
    from slipfree.show.fit_figures import soil_plot

    contents = wheel_test.read_wheel_file(file, settings)

    def solve() -> _FitResult:
        fitted = wheel_test.fit_wheel_file(contents)
        fit = fitted.fit
        constants = wheel_test.constant_rows(fit)
        return _FitResult(
            wheel_test.fit_facts(fitted),
            [constants, wheel_test.point_rows(fitted)],
            {"errors": wheel_test.error_rows(fit), "estimates": _objects(constants)},
            partial(wheel_test.soil_text, fitted),
            lambda name: soil_plot(name, fitted.runs.values, fit),
            fit.estimate.undetermined,
            fit.estimate.is_interrupted,
        )

    words = "soil", "runs that determine", "runs at other slip ratios, slip angles or loads"
    return _FitWork(contents.files, ("points",), solve, *words)


def _fit_over_map(problem: Any, predict: Sequence[Path]) -> _FitWork:
    from slipfree.files.vehicle_toml import vehicle_text
    from slipfree.problem.inputs import files_read
    from slipfree.problem.verbs import fit_over_map as verb
    from slipfree.show.fit_figures import ground_plot

    def solve() -> _FitResult:
        fitted = verb.fit_over_map(problem, predict)
        errors, constants = verb.error_rows(fitted.scores), verb.constant_rows(fitted)
        return _FitResult(
            verb.facts(fitted),
            [errors, constants, verb.window_rows(fitted)],
            {"errors": _objects(errors), "estimates": _objects(constants)},
            lambda: vehicle_text(*verb.fitted_vehicle(problem, fitted)),
            partial(ground_plot, scores=fitted.scores),
        )

    inputs, ends = [*files_read(problem), *predict], ("constants", "windows")
    return _FitWork(inputs, ends, solve, is_held=False)


def wheel(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Wheel file (TOML): wheel, load, soil and test.")
    ],
    settings: Settings = None,
    out: Annotated[
        Path | None,
        output_option(
            "OUT.csv",
            "Table of the curves; the figure has the same name with .png. "
            "Default: the name of the file, in the current folder; with _wheel if that is an "
            "input.",
        ),
    ] = None,
    draw: Draw = True,
) -> None:
    """Compute the forces on a single wheel in soil.

    Print a summary, and write drawbar pull, side force, torque and sinkage over slip ratio and
    slip angle as a table and a figure. Measured points of a CSV file are drawn over the curves,
    and compared with them.
    """
    with about(file):
        from slipfree.files.tables import write_rows
        from slipfree.fit.wheel_soil import QUANTITIES
        from slipfree.problem.wheel_test import (
            measured_points,
            run_wheel_file,
            wheel_facts,
            wheel_rows,
        )

        test = run_wheel_file(file, settings or [])
        table = out or default_table(file, "wheel", test.file.files)
        picture = table.with_suffix(".png") if draw else None
        check_outputs([table, picture], test.file.files)
        names, rows = wheel_rows(test.curves)
        files = [save(table, lambda path: write_rows(path, names, rows))]
        print_facts(wheel_facts(test))
        if picture is not None:
            from slipfree.show.sweep_figures import DrawnWheel, wheel_plot

            values = {name: getattr(test.curves, name) for name in QUANTITIES}
            points = measured_points(test.file.runs)
            load = test.file.spec.wheel.load
            drawn = DrawnWheel(*test.curves[:2], load, values, points)
            files += draw_plots([wheel_plot(picture.stem, drawn)], picture.parent)
        print_line(f"wrote {' and '.join(map(str, files))}")
