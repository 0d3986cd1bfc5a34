"""The command line: ``slipfree run | check | vehicle | compare | info | export``.

Exit codes: 0 done; 1 stopped early, with what was reached saved; 2 bad input; 130 interrupted.
What a command needs is imported inside it, so that ``slipfree --help`` answers at once.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import slipfree
from slipfree.errors import DataError, ModelError, SlipfreeError
from slipfree.trajectory import Stop

if TYPE_CHECKING:
    from slipfree.plan.saved import Saved
    from slipfree.problem.compare import Drive
    from slipfree.problem.read import Problem
    from slipfree.problem.run import Outcome
    from slipfree.problem.schema import Climb, Motion

STOPPED, BAD_INPUT, INTERRUPTED = 1, 2, 130
REFRESH = 0.1  # between two updates of the progress bar [s]

app = typer.Typer(
    name="slipfree",
    help="How a wheeled vehicle moves over uneven ground without slipping.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

File = Annotated[Path, typer.Argument(metavar="FILE", help="Problem file (TOML).")]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Replace a value, as in time.duration=3, or take it out, as in terrain.rolled=; "
        "repeatable.",
    ),
]


def main() -> None:
    """Run the command line."""
    app()


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"slipfree {slipfree.__version__}")
        raise typer.Exit


@app.callback()
def _common(
    _: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
) -> None:
    pass


@app.command()
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
    """Solve a problem: write the result, print a summary, draw figures."""  # fmt: skip
    with _reported():
        from slipfree.problem.read import climbs
        from slipfree.problem.run import check_cross

        problem = _read(file, settings)
        out = out or Path(_output(problem))
        folder = (figures or out.with_name(f"{out.stem}_figures")) if draw else None
        _check_places([out, csv, animation], folder, problem)
        if animation is not None:
            _check_animation(animation, problem)
        if cross_check:
            check_cross(problem)
        former = _former(problem, resume)
        outcome = _solve(problem, former)
        motion = outcome.trajectory
        _save(outcome, out, csv)
        _print_outcome(outcome)
        typer.echo(f"wrote {out}" + (f", {csv}" if csv else ""))
        if cross_check and not climbs(problem):
            _cross_check(problem, outcome)
        if folder is not None:
            _draw(outcome, folder)
        if animation is not None:
            _animate(outcome, animation)
        if motion.stop is not None:
            _say_stopped(motion.stop, out)
            raise typer.Exit(STOPPED)


@app.command()
def check(file: File, settings: Settings = None) -> None:
    """Check a problem and stand the vehicle on its start, without solving."""
    with _reported():
        from slipfree.problem.read import climbs
        from slipfree.problem.run import build, setup_facts
        from slipfree.problem.summary import certificate

        problem = _read(file, settings)
        if climbs(problem):
            _check_climb(problem)
            return
        setup = build(problem)
        start, spec = setup.start, problem.spec
        names = [*spec.start, "z", "pitch", "roll"]
        pose = ", ".join(f"{name} {start[name][0]:.10g}" for name in dict.fromkeys(names))
        facts = [
            *setup_facts(setup),
            ("start", f"{pose} (m, rad)"),
            ("contact certificate", certificate(start)),
            ("samples", f"{setup.t.size} to {setup.t[-1]:g} s"),
        ]
        _print(facts)
        typer.echo("ok")


def _check_climb(problem: Problem[Climb]) -> None:
    """Stand the vehicle of a climb before its obstacle."""
    from slipfree.problem.climb import build_climb

    setup = build_climb(problem)
    place = ", ".join(f"{name} {setup.start[name][0]:.6g}" for name in ("x", "z", "velocity_x"))
    samples = f"{setup.t.size} to {setup.t[-1]:g} s"
    _print([*setup.facts, ("start", f"{place} (m, m/s)"), ("samples", samples)])
    typer.echo("ok")


@app.command()
def vehicle(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Problem file, or vehicle file (TOML or URDF).")
    ],
    settings: Settings = None,
) -> None:
    """Describe a vehicle: parts, unknowns, equations, whether it can roll, and how well."""
    with _reported():
        from slipfree.problem.describe import describe

        found = describe(file, settings or [])
        typer.echo("\n".join([*found.tree, ""]))
        _print(found.facts)
        if found.faults:
            typer.echo("\n".join(found.faults), err=True)
            raise typer.Exit(BAD_INPUT)


@app.command()
def compare(file: File, settings: Settings = None) -> None:
    """Compare vehicles on one ground: which can roll without slip, how much the others slip."""
    with _reported():
        from slipfree.problem.compare import compare as solve
        from slipfree.problem.ground import ground_facts
        from slipfree.problem.read import read_as
        from slipfree.problem.schema import Compare

        def tell(name: str) -> None:
            if sys.stderr.isatty():
                typer.echo(f"  {name}", err=True)

        ground, rows = solve(read_as(Compare, file, settings or []), tell)
        _print(ground_facts(ground))
        width = max(len(row.name) for row in rows)
        for words, drives in (
            ("at the same rates", [row.same for row in rows]),
            ("at the rates of the driving law", [row.fitting for row in rows]),
        ):
            typer.echo(f"\n{words}: largest slip of the wheels {', '.join(rows[0].wheels)} [mm/s]")
            head = f"{'rank':6}{'along':18}{'across':18}{'measured on the poses':27}"
            typer.echo(f"{'':{width}}  {head}{'friction*':10}{'tilt [rad]':12}axle [m]")
            for row, drive in zip(rows, drives, strict=True):
                rank = f"{row.rank}/{row.conditions}"
                typer.echo(f"{row.name:{width}}  {rank:6}{_drive(drive)}")
        typer.echo("\n* largest coefficient of friction that a wheel needs, load-weighted")


def _drive(drive: Drive) -> str:
    slips = "".join(
        f"{' '.join(f'{1e3 * value:.2f}' for value in values):18}"
        for values in (drive.along, drive.across)
    )
    measured = " ".join(f"{1e3 * value:.1e}" for value in drive.measured)
    axle = " to ".join(f"{value:.3f}" for value in drive.width)
    stop = f", stopped at {drive.stop.t:.3g} s by {drive.stop.name}" if drive.stop else ""
    return f"{slips}{measured:27}{drive.friction:<10.3f}{drive.tilt:<12.3f}{axle}{stop}"


@app.command()
def info(
    file: Annotated[Path, typer.Argument(metavar="OUT.nc", help="Result file.")],
    problem: Annotated[
        bool, typer.Option("--problem", help="Print the problem file that led to it instead.")
    ] = False,
) -> None:
    """Say what a result file holds."""
    with _reported():
        from slipfree.problem.summary import motion_facts, ranges
        from slipfree.result_file import read

        motion = read(file)
        attributes = dict(motion.attributes)
        text = attributes.pop("problem", None)
        if problem:
            if text is None:
                raise DataError(f"{file}: holds no problem file: it was not written by run")
            typer.echo(text, nl=False)
            return
        words = [(name.replace("_", " "), value) for name, value in attributes.items()]
        _print(words + motion_facts(motion))
        typer.echo()
        _print(ranges(motion))


@app.command()
def export(
    file: Annotated[Path, typer.Argument(metavar="OUT.nc", help="Result file.")],
    path: Annotated[
        Path | None,
        typer.Option(metavar="FILE.csv|.geojson", help="The path, in the map's coordinates."),
    ] = None,
    rates: Annotated[
        Path | None, typer.Option(metavar="FILE.csv", help="Rates of driven wheels and joints.")
    ] = None,
) -> None:
    """Write a result for other programs: the path on its map, rates that a robot plays."""
    with _reported():
        from slipfree.problem.export import export_path, export_rates

        if path is None and rates is None:
            raise DataError("export: expected --path, --rates or both, found neither")
        for out, write in ((path, export_path), (rates, export_rates)):
            if out is not None:
                write(file, out)
                typer.echo(f"wrote {out}")


def _say_stopped(stop: Stop, out: Path) -> None:
    typer.echo(
        f"stopped early at t = {stop.t:.6g} s: {stop.words}; {out} holds the motion to there",
        err=True,
    )


@contextmanager
def _reported() -> Iterator[None]:
    """Turn the errors of the package into a message and an exit code."""
    try:
        yield
    except (DataError, ModelError) as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(BAD_INPUT) from error
    except SlipfreeError as error:
        typer.echo(str(error), err=True)
        raise typer.Exit(STOPPED) from error
    except KeyboardInterrupt as error:
        typer.echo("interrupted", err=True)
        raise typer.Exit(INTERRUPTED) from error


def _read(file: Path, settings: list[str] | None) -> Problem[Motion] | Problem[Climb]:
    from slipfree.problem.read import read

    return read(file, settings or [])


def _output(problem: Problem[Motion] | Problem[Climb]) -> str:
    spec = problem.spec.output
    return spec.file if spec else f"{problem.source.path.stem}.nc"


def _check_places(
    files: list[Path | None], folder: Path | None, problem: Problem[Motion] | Problem[Climb]
) -> None:
    """Refuse places that cannot be written to, or that are read, before anything is computed."""
    spec = problem.spec
    tables = [getattr(spec, name, None)
              for name in ("terrain", "vehicle", "driver", "path", "profile")]  # fmt: skip
    names = [getattr(table, "file", None) for table in tables]
    names += [each for each in (getattr(tables[0], "friction", None),) if isinstance(each, str)]
    taken = {problem.source.path.resolve(): "the problem file"}
    taken |= {(problem.folder / name).resolve(): f"the input {name}" for name in names if name}
    for path in files:
        if path is None:
            continue
        if path.resolve() in taken:
            raise DataError(f"{path}: expected a file of its own, found {taken[path.resolve()]}")
        taken[path.resolve()] = "another output"
        if path.is_dir():
            raise DataError(f"{path}: expected the name of a file to write, found a folder")
        if not path.parent.is_dir():
            raise DataError(f"{path}: expected a folder {path.parent} to write to, found none")
        _check_writable(path, path.parent)
    if folder is not None:
        if folder.exists() and not folder.is_dir():
            raise DataError(f"{folder}: expected a folder for figures, found a file")
        above = next(each for each in (folder, *folder.absolute().parents) if each.is_dir())
        _check_writable(folder, above)


def _check_writable(path: Path, folder: Path) -> None:
    if not os.access(folder, os.W_OK):
        raise DataError(f"{path}: expected a folder {folder} that may be written to")


def _solve(problem: Problem[Motion] | Problem[Climb], former: Saved | None) -> Outcome:
    """Return the outcome; show a bar meanwhile if somebody is looking."""
    from rich.console import Console
    from rich.progress import Progress

    from slipfree.problem.run import run as solve

    console = Console(stderr=True)
    with _interruptible() as poll:
        if not console.is_terminal:
            return solve(problem, lambda _: poll(), lambda _: poll(), former)
        with Progress(console=console, transient=True) as bar:
            task = bar.add_task(
                "solving", total=None if problem.spec.verb == "plan" else problem.spec.time.duration
            )
            show = _throttled(lambda t: bar.update(task, completed=t))
            show_line = _throttled(lambda line: bar.update(task, description=line))

            def progress(t: float) -> None:
                poll()
                show(t)

            def tell(line: str) -> None:
                poll()
                show_line(line)

            return solve(problem, progress, tell, former)


@contextmanager
def _interruptible() -> Iterator[Callable[[], None]]:
    """Give a function that raises KeyboardInterrupt if Ctrl-C was pressed since.

    An exception out of a signal handler gets lost when the integrator's own code is running.
    Pressed a second time, Ctrl-C acts wherever the program is.
    """
    pressed = False

    def remember(_signal: int, _frame: object) -> None:
        nonlocal pressed
        if pressed:
            raise KeyboardInterrupt
        pressed = True

    def poll() -> None:
        if pressed:
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, remember)
    try:
        yield poll
    finally:
        signal.signal(signal.SIGINT, before)


def _throttled(show: Callable[[Any], None]) -> Callable[[Any], None]:
    """Return the same function, which does nothing if called again too soon."""
    last = 0.0

    def seldom(what: Any) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last > REFRESH:
            last = now
            show(what)

    return seldom


def _former(problem: Problem[Motion] | Problem[Climb], file: Path | None) -> Saved | None:
    """Return the plan to start from, if one is named."""
    from slipfree.plan.saved import from_arrays
    from slipfree.result_file import read_arrays

    if file is None:
        return None
    if problem.spec.verb != "plan":
        where = problem.source.where(("verb",))
        raise DataError(f"{where}: expected 'plan' for --resume, found {problem.spec.verb!r}")
    return from_arrays(read_arrays(file), str(file))


def _save(outcome: Outcome, out: Path, csv: Path | None) -> None:
    from slipfree.result_file import write, write_csv

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
    from slipfree.problem.climb import Climbing
    from slipfree.show.climb import animate

    if isinstance(outcome.setup, Climbing):
        animate(outcome.trajectory, outcome.setup.climber, outcome.setup.profile, file)
        typer.echo(f"wrote {file}")


def _draw(outcome: Outcome, folder: Path) -> None:
    from slipfree.problem.climb import Climbing
    from slipfree.problem.plan import Planning, figure_options

    if isinstance(outcome.setup, Climbing):
        from slipfree.show.climb import save_climb_figures

        setup = outcome.setup
        paths = save_climb_figures(
            outcome.trajectory, setup.climber, setup.profile, folder, plan=setup.plan
        )
        typer.echo(f"drew {len(paths)} figures in {folder}")
        return
    grid = outcome.setup.ground.grid
    if isinstance(outcome.setup, Planning):
        from slipfree.show.plan import save_plan_figures

        layers, options = outcome.setup.layers, figure_options(outcome.setup)
        paths = save_plan_figures(outcome.trajectory, grid, layers, folder, **options)
    else:
        from slipfree.show.plot import save_figures

        paths = save_figures(outcome.trajectory, grid, folder)
    typer.echo(f"drew {len(paths)} figures in {folder}")


def _cross_check(problem: Problem[Motion], outcome: Outcome) -> None:
    """Print where the two formulations of contact differ, the largest differences first."""
    from slipfree.problem.run import check_cross, cross, other_formulation

    other = other_formulation(check_cross(problem))
    differences = sorted(cross(problem, outcome), key=lambda each: -each.size)
    typer.echo(
        f"largest differences from formulation = {other!r}, of {len(differences)} quantities:"
    )
    _print(
        [
            (f"  {each.label.full}", f"{each.size:.2e} {each.label.unit} at {each.t:g} s")
            for each in differences[:8]
        ]
    )


def _print_outcome(outcome: Outcome) -> None:
    from slipfree.problem.run import setup_facts
    from slipfree.problem.summary import motion_facts, steering_warning

    motion = outcome.trajectory
    _print(setup_facts(outcome.setup) + motion_facts(motion))
    warning = steering_warning(motion)
    if warning and not (motion.stop and warning in motion.stop.words):
        typer.echo(f"warning: {warning}", err=True)


def _print(facts: list[tuple[str, str]]) -> None:
    """Print names and values: a table on a terminal, plain lines elsewhere."""
    if not sys.stdout.isatty():
        width = max(len(name) for name, _ in facts)
        for name, value in facts:
            typer.echo(f"{name:{width}}  {value}")
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold")
    table.add_column()
    for name, value in facts:
        table.add_row(Text(name), Text(value))
    Console().print(table)
