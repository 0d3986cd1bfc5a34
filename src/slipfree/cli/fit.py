"""Fits: ``fit`` a vehicle to a log or a soil to tests, and compute a single ``wheel`` in soil."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from slipfree.cli import console
from slipfree.cli.console import INTERRUPTED, STOPPED, Draw, Force, Settings, Trust, output_option
from slipfree.cli.outputs import check_outputs, default_table, save, write_new_file
from slipfree.cli.outputs import draw as draw_plots
from slipfree.core.errors import ModelError
from slipfree.system.interrupt import held_interrupt, interrupt_requested

if TYPE_CHECKING:
    from slipfree.core.facts import Lines
    from slipfree.show.plots import Plot


def fit(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...")],
    settings: Settings = None,
    out: Annotated[Path | None, output_option("OUT.csv")] = None,
    write: Annotated[Path | None, typer.Option(metavar="FILE.toml")] = None,
    ground: Annotated[Path | None, typer.Option("--map", metavar="MAP")] = None,
    vehicle: Annotated[Path | None, typer.Option(metavar="FILE")] = None,
    force: Force = False,
    predict: Annotated[list[Path] | None, typer.Option(metavar="LOG")] = None,
    draw: Draw = True,
    trust: Trust = None,
) -> None:
    """Fit a vehicle to logs of its motion, or a soil to wheel tests.

    The vehicle is a force balance with inertia, on level ground or over a map. Print its constants
    with 95 % intervals, and errors of predictions of whole campaigns or manoeuvres that were left
    out, with 90 % intervals. Logs need no problem file: columns are t, x, y, heading, left and
    right, and --set changes keys such as data.unit. The fit is kept in a file (.nc), which
    --predict applies to other logs.

    A wheel file, with the table [wheel], is fitted to the measured points that it names. If the
    data do not determine an unknown of the file without a prior, the exit code is 1 and no vehicle
    or soil is written.

    Parameters
    ----------
    files : list of path
        A problem file, a wheel file, logs, or a fit (.nc) for --predict.
    out : path, optional
        Table of the estimates; the table of the windows and the figure have the same name with
        _windows.csv and .png. Default: the name of the file, in the current folder; with _fit
        if that, or a fit or result of this name, is an input.
    write : path, optional
        Write the fitted vehicle or soil.
    ground : path, optional
        Map under logs without a file.
    vehicle : path, optional
        Vehicle of logs without a problem file.
    predict : list of path, optional
        Another log, to be predicted with numbers that are fitted to all logs of the file; more
        logs may follow it after a problem file or a fit. By default, windows that are left out
        are predicted, or over a map the logs of each folder.
    """
    file = files[0]
    with console.about(file):
        from slipfree.problem.wheel_test import is_wheel_file

        is_binary = file.suffix.lower() in (".nc", ".mcap")
        if not is_binary and is_wheel_file(file):
            if predict:
                raise ModelError(
                    f"{file}: expected a problem file or logs for --predict, found a wheel file; "
                    "omit --predict"
                )
            work = _soil_fit(file, settings or [])
        else:
            work = _log_fit(files, settings or [], (ground, vehicle), trust, predict or [])
        if write and work.is_without_vehicle:
            raise ModelError(
                f"{file}: expected a vehicle for --write, found none; name one, or omit --write: "
                "the constants are in a table"
            )
        _write_fit(file, work, out, write, force=force, draw=draw)


def _write_fit(
    file: Path, work: _FitWork, out: Path | None, write: Path | None, *, force: bool, draw: bool
) -> None:
    """Solve a fit, print its facts, and write its files."""
    from slipfree.files.tables import write_records

    table = out or default_table(file, "fit", work.inputs)
    kept = table.parent / f"{table.stem}.nc"
    table = table.with_suffix(".csv") if table == kept else table
    tables = [table, *(table.parent / f"{table.stem}_{end}.csv" for end in work.ends)]
    picture = table.parent / f"{table.stem}.png" if draw else None
    check_outputs([*tables, picture, write, kept], work.inputs)
    with held_interrupt(from_first_poll=True):
        result = work.solve()
        files_written = [
            save(path, partial(write_records, records=rows))
            for path, rows in zip(tables, result.tables, strict=True)
        ]
        if result.save is not None:
            files_written.append(save(kept, result.save))
        if write is not None and not result.undetermined:
            write_new_file(result.text(), write, force)
            files_written.append(write)
        is_interrupted = interrupt_requested() or result.exit_code == INTERRUPTED
    console.print_facts(result.facts)
    for key, objects in result.objects.items():
        console.add_json(key, partial(list, objects))
    if picture is not None and not is_interrupted:
        files_written += draw_plots([result.plot(picture.stem)], picture.parent)
    console.print_line(f"wrote {' and '.join(map(str, files_written))}")
    if is_interrupted:
        console.print_error(f"interrupted; {files_written[0]} contains the estimates so far")
        raise typer.Exit(INTERRUPTED)
    if result.undetermined:
        unwritten = f"; no {work.subject} was written" if write else ""
        console.print_error(
            f"{file}: expected data that determine all unknowns, found no information on "
            f"{', '.join(result.undetermined)}{unwritten}; give priors, fit fewer unknowns, or use "
            "more varied data"
        )
        raise typer.Exit(STOPPED)
    raise typer.Exit(result.exit_code)


class _FitResult(NamedTuple):
    """Result of a fit, for the output of the command."""

    facts: Lines
    tables: list[list[dict[str, Any]]]
    objects: dict[str, list[dict[str, Any]]]  # of the JSON output
    text: Callable[[], str]
    plot: Callable[[str], Plot]
    undetermined: tuple[str, ...] = ()
    exit_code: int = 0
    save: Callable[..., None] | None = None  # of the fit


class _FitWork(NamedTuple):
    """A fit to be solved, with the files that it reads."""

    inputs: list[Path]
    ends: tuple[str, ...]  # of the names of further tables
    solve: Callable[[], _FitResult]
    subject: str = ""  # what is fitted
    is_without_vehicle: bool = False


def _log_fit(
    files: Sequence[Path],
    settings: list[str],
    named: tuple[Path | None, Path | None],
    trust: list[Path] | None,
    predict: Sequence[Path],
) -> _FitWork:
    """Return the work of a fit to logs, or of a prediction by a stored fit.

    ``named`` are the files of ``--map`` and ``--vehicle``. With ``--predict``, the files after the
    first are logs to predict, too.
    """
    from slipfree.files.netcdf import FIT, attributes_of
    from slipfree.files.toml import MADE
    from slipfree.files.vehicle_toml import toml_value, vehicle_text
    from slipfree.problem.inputs import files_read
    from slipfree.problem.load import load_again
    from slipfree.problem.verbs import fit as verb
    from slipfree.show.study_figures import fit_plot

    (file, *more), contents = files, None
    is_fit = predict and file.suffix == ".nc" and FIT in attributes_of(file)
    if predict and (is_fit or file.suffix == ".toml"):
        predict, more = [*predict, *more], []
    problem: Any
    if is_fit:
        contents = verb.read_fit(file)
        problem = load_again(
            Path(contents["file"]), contents["text"], contents["settings"] + settings, command="fit"
        )
    elif file.suffix == ".toml" and not more:
        problem = console.read_problem(file, settings, trust, "fit")
    else:
        tables = {"terrain.file": named[0], "vehicle.file": named[1]}
        lines = [f"{key} = {toml_value(str(path))}" for key, path in tables.items() if path]
        names = ", ".join(toml_value(str(path)) for path in files)
        text = "\n".join(["verb = 'fit'", f"data.file = [{names}]", *lines, ""])
        problem = load_again(Path(file.name), MADE + text, settings, command="fit")

    def solve() -> _FitResult:
        """Return the result of the fit or of the prediction."""
        if contents is not None:
            is_named = any(each.startswith("data.surfaces") for each in settings)
            surfaces = problem.spec.data.surfaces if is_named else ()
            result = verb.predict_logs(problem, contents, predict, surfaces)
        else:
            result = verb.fit(problem, predict)
        fitted, tables = result.fit, [verb.error_rows(result.scores), verb.window_rows(result)]
        objects = {"errors": tables[0]}
        if fitted is not None:
            tables.insert(0, verb.constant_rows(fitted))
            objects["estimates"] = tables[0]
        kept = partial(verb.save_fit, problem=problem, settings=settings, result=result)
        return _FitResult(
            verb.facts(result),
            tables,
            objects,
            lambda: vehicle_text(*verb.fitted_vehicle(problem, fitted)) if fitted else "",
            partial(fit_plot, scores=result.scores),
            () if fitted is None else verb.undetermined(problem, fitted),
            exit_code=result.outcome.exit_code,
            save=kept if fitted else None,
        )

    ends = ("windows",) if contents is not None else ("errors", "windows")
    inputs = [*files_read(problem), *files, *predict]
    is_bare = problem.spec.vehicle is None or contents is not None
    return _FitWork(inputs, ends, solve, "vehicle", is_without_vehicle=is_bare)


def _soil_fit(file: Path, settings: list[str]) -> _FitWork:
    """Return the work of a fit of a soil to the points of a wheel file."""
    from slipfree.problem import wheel_test
    from slipfree.show.study_figures import soil_plot

    contents = wheel_test.read_wheel_file(file, settings)

    def solve() -> _FitResult:
        """Return the result of the fit of a soil."""
        fitted = wheel_test.fit_wheel_file(contents)
        fit, constants = fitted.fit, wheel_test.constant_rows(fitted.fit)
        return _FitResult(
            wheel_test.fit_facts(fitted),
            [constants, wheel_test.point_rows(fitted)],
            {"errors": wheel_test.error_rows(fit), "estimates": constants},
            partial(wheel_test.soil_text, fitted),
            lambda name: soil_plot(name, fitted.runs.values, fit),
            tuple(name for name in fit.estimate.undetermined if name not in fitted.priors),
            INTERRUPTED if fit.estimate.is_interrupted else 0,
        )

    return _FitWork(contents.files, ("points",), solve, "soil")


def wheel(
    file: Annotated[Path, typer.Argument(metavar="FILE")],
    settings: Settings = None,
    out: Annotated[Path | None, output_option("OUT.csv")] = None,
    fit: Annotated[bool, typer.Option("--fit")] = False,
    write: Annotated[Path | None, typer.Option(metavar="FILE.toml")] = None,
    force: Annotated[bool, typer.Option("--force")] = False,
    draw: Draw = True,
) -> None:
    """Compute the forces on a single wheel in soil.

    Print a summary, and write drawbar pull, side force, torque and sinkage over slip ratio and
    slip angle as a table and a figure. Measured points of a CSV file are drawn over the curves,
    and compared with them; --fit fits constants of the soil to them, from three points on.

    Parameters
    ----------
    file : path
        Wheel file (TOML): wheel, load, soil and test; or a table of tests, whose wheel --set
        names (wheel.radius, wheel.width).
    out : path, optional
        Table of the curves; the figure has the same name with .png. Default: the name of the
        file, in the current folder; with _wheel if that is an input.
    fit : bool
        Fit the soil to the measured points.
    write : path, optional
        Write the soil of --fit.
    force : bool
        Replace an existing soil file.
    """
    with console.about(file):
        if fit:
            _write_fit(file, _soil_fit(file, settings or []), out, write, force=force, draw=draw)
            return
        if write:
            raise ModelError(f"{file}: expected --fit with --write, found none; add --fit")
        from slipfree.files.tables import write_records
        from slipfree.problem import wheel_test

        test = wheel_test.run_wheel_file(file, settings or [])
        table = out or default_table(file, "wheel", test.file.files)
        picture = table.parent / f"{table.stem}.png" if draw else None
        check_outputs([table, picture], test.file.files)
        files = [save(table, partial(write_records, records=wheel_test.wheel_rows(test.curves)))]
        console.print_facts(wheel_test.wheel_facts(test))
        if picture is not None:
            from slipfree.show.study_figures import wheel_plot

            points, load = wheel_test.measured_points(test.file.runs), test.file.spec.wheel.load
            plot = wheel_plot(picture.stem, test.curves, load, points)
            files += draw_plots([plot], picture.parent)
        console.print_line(f"wrote {' and '.join(map(str, files))}")
