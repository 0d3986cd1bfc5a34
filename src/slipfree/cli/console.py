"""Common parts of the commands: options, messages, details, JSON, progress and errors.

Commands print to stdout: text by default, nothing with ``--quiet``, and with ``--json`` one object
with facts, values added by `add_json`, and the meaning of the exit code. Errors, warnings and
details are lines on stderr, as is progress: a bar on a terminal, otherwise occasional lines.
`print_line` escapes the control characters of all texts, since names and titles in files must not
control the terminal.
"""

from __future__ import annotations

import errno
import inspect
import io
import json as to_json
import math
import re
import sys
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, nullcontext, redirect_stdout, suppress
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, NoReturn, TextIO, get_type_hints

import typer

from slipfree.core.errors import (
    DataError,
    ModelError,
    SlipfreeError,
    WriteError,
    descriptions,
    shortened,
)
from slipfree.core.facts import best_text, cells, in_short, table
from slipfree.core.version import __version__
from slipfree.system import interrupt
from slipfree.system.regular_files import regular_file

if TYPE_CHECKING:
    from slipfree.core.facts import Lines, TableColumn
    from slipfree.problem.build_ground import GroundMap
    from slipfree.problem.problem import Problem
    from slipfree.system.parts import Parts, PartsWatch
    from slipfree.terrain.base import Grid

DONE, STOPPED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
MEANINGS = {
    DONE: "done",
    STOPPED: "not complete or failed; 'files' lists the saved files, if any",
    BAD_INPUT: "bad input, or a package that is not installed",
    INTERRUPTED: "interrupted",
}

ANY_VEHICLE = "three_wheeler"  # of a problem of which only the map is read
ARGUMENTS = {  # of `slipfree atlas`, by the settings that they stand for
    "--set terrain.file": "MAP",
    "--set vehicle.file": "VEHICLE",
    "--set vehicle.catalog": "VEHICLE",
    "--set terrain.friction": "--friction",
    "--set atlas.within.": "--within ",
    **{f"--set atlas.{name}": f"--{name}" for name in ("headings", "every", "error", "guarantee")},
}

# C0 without tab and newline, delete, C1, separators, text directions, surrogates
CONTROL = re.compile(
    r"[\0-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069"
    r"\ud800-\udfff]|\r(?!\n)"
)

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print only errors.")]
Verbose = Annotated[
    bool,
    typer.Option(
        "--verbose", "-v", help="Print all facts, and every step with its time on stderr."
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
FIRST_LINE = 2.0  # time before the first line of a computation [s]
NEW_PHASE = 1.0  # shortest time between lines of different phases [s]
SAME_PHASE = 10.0  # shortest time between lines of the same phase [s]
LINES_APART = 60.0  # longest time between lines that count [s]
INTEGRATION = "integrated"
RESULT = b"CDF"  # first bytes of a netCDF file
NO_MEMORY = (
    "not enough memory: reduce 'terrain.window', or increase the spacing of the ground or "
    "'time.step', or use fewer intervals of the plan"
)
MAX_PROCESSES = 1000  # more need hundreds of gigabytes
UNEXPECTED = "expected a result or a message about the input, found an error in slipfree"
MAX_UNEXPECTED = 300  # characters of an unexpected error in a message

File = Annotated[Path, typer.Argument(metavar="FILE", help="Problem file (TOML).")]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Replace a value, as in time.duration=3, or remove it, as in terrain.rolled=; "
        "repeatable.",
    ),
]
Trust = Annotated[
    list[Path] | None,
    typer.Option(
        metavar="FILE",
        help="Expand this xacro file, which the problem or vehicle file names. Xacro is a program: "
        "trust only files that you would execute. Repeatable.",
    ),
]
Processes = Annotated[
    int | None,
    typer.Option(
        "-j",
        "--processes",
        min=1,
        max=MAX_PROCESSES,
        metavar="P",
        help="Number of processes; default: one per core.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Compute on the workers of this Dask scheduler."),
]
Draw = Annotated[bool, typer.Option("--draw/--no-draw", " /--no-figures", help="Draw figures.")]
Force = Annotated[bool, typer.Option("--force", help="Replace existing files.")]
ResultFile = Annotated[Path, typer.Argument(metavar="OUT.nc", help="Result file.")]


def output_option(metavar: str) -> Any:
    """Return the option ``-o`` of a command."""
    return typer.Option("-o", "--output", metavar=metavar)


class OutputOptions(NamedTuple):
    """Values of the output options of a command."""

    quiet: bool = False
    verbose: bool = False
    json: bool = False


@dataclass
class _CommandOutput:
    """Output of one command, collected for ``--json``."""

    options: OutputOptions
    stderr: TextIO = field(default_factory=lambda: sys.stderr)  # original: integrators redirect it
    began: float = field(default_factory=time.perf_counter)  # [s]
    content: dict[str, Any] = field(default_factory=dict)  # of the JSON object
    is_failed: bool = False  # whether a part of the command has failed


_global_options = [OutputOptions()]  # options given before the command's name
_running: list[_CommandOutput] = []  # output of the running command, if there is one


def _current_output() -> _CommandOutput:
    return _running[-1] if _running else _CommandOutput(OutputOptions())


def store_options(quiet: bool, verbose: bool, json: bool) -> None:
    """Store the output options given before the command's name, for that command."""
    _global_options[:] = [OutputOptions(quiet, verbose, json)]


def with_output_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with the additional options ``--quiet``, ``--verbose`` and ``--json``.

    The help of its own options is the description of the parameter in its docstring.
    """
    annotations = {"quiet": Quiet, "verbose": Verbose, "json": Json}
    hints = get_type_hints(command, include_extras=True) | annotations
    for name, words in descriptions(command).items():
        hints[name].__metadata__[0].help = words
    own, kind = inspect.signature(command).parameters.values(), inspect.Parameter.KEYWORD_ONLY
    more = (inspect.Parameter(name, kind, default=False) for name in annotations)

    @wraps(command)
    def wrapped(*, quiet: bool, verbose: bool, json: bool, **values: Any) -> None:
        """Run the command with the options of output, which it does not have itself."""
        pairs = zip((quiet, verbose, json), _global_options[0], strict=True)
        options = OutputOptions(*map(any, pairs))
        with _collecting(command.__name__, options):
            try:
                Path.cwd()
            except OSError as error:
                print_error(
                    "expected a current folder that exists, found that it was removed "
                    f"({error.strerror}); change to another folder: cd DIR"
                )
                raise typer.Exit(BAD_INPUT) from error
            if options.quiet and options.verbose:
                print_error("expected --quiet or --verbose, found both; remove one of them")
                raise typer.Exit(BAD_INPUT)
            with _report_unexpected(values.get("file")), reported():
                command(**values)
            if _current_output().is_failed:
                raise typer.Exit(STOPPED)

    parameters = [each.replace(annotation=hints[each.name], kind=kind) for each in (*own, *more)]
    wrapped.__dict__["__signature__"] = inspect.Signature(parameters)
    wrapped.__annotations__ = hints
    wrapped.__doc__ = (command.__doc__ or "").partition("\n\n    Parameters\n")[0]
    del wrapped.__dict__["__wrapped__"]  # its signature lacks the options
    return wrapped


@contextmanager
def _collecting(name: str, options: OutputOptions) -> Iterator[None]:
    """Collect the output of a command, and print it as one JSON object if requested."""
    output = _CommandOutput(options)
    _running.append(output)
    code = STOPPED

    def warn_once(message: Warning | str, *_: Any, **__: Any) -> None:
        known = output.content.get("warnings", ())
        if not set(str(message).splitlines()) <= set(known):
            warn(str(message))

    hidden = redirect_stdout(io.StringIO()) if options.quiet or options.json else nullcontext()
    try:
        with hidden, warnings.catch_warnings():
            warnings.showwarning = warn_once
            yield
        code = DONE
    except typer.Exit as end:
        code = end.exit_code
        raise
    finally:
        _running.pop()
        if options.json:
            print_json(name, code, output.content)


@contextmanager
def _report_unexpected(file: Path | None) -> Iterator[None]:
    """Print an unexpected error in one line, and exit.

    The line names the input file of the command; ``--verbose`` adds the traceback. The exit code is
    that of bad input, since the input is the likely cause, and the one of `STOPPED` promises that a
    result was written.
    """
    try:
        yield
    except (typer.Exit, OSError):  # the command ends, or nobody reads its output
        raise
    except Exception as error:
        if interrupt.interrupted():  # extension modules raise errors of other classes then
            raise
        if _current_output().options.verbose:
            print_line(traceback.format_exc(), err=True)
        words = shortened(" ".join(f"{type(error).__name__}: {error}".split()), MAX_UNEXPECTED)
        print_error(
            f"{file or 'command'}: {UNEXPECTED} {__version__} ({words}); report it to the "
            "developers of slipfree, with the file and the traceback that --verbose prints"
        )
        raise typer.Exit(BAD_INPUT) from error


def visible(text: str) -> str:
    r"""Return a text with its control characters escaped: ``\x1b`` stands for the byte 0x1b."""
    return CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def print_line(words: str = "", *, err: bool = False, file: TextIO | None = None) -> None:
    """Print a line, with control characters escaped, on ``file``, with ``err`` on stderr."""
    try:
        typer.echo(visible(words), err=err, file=file)
    except OSError as error:
        error.filename = error.filename or ("stderr" if err or file else "stdout")
        raise


def fail(error: OSError) -> NoReturn:
    """Print an operating-system error, such as a full disk, and exit.

    If the reader of the output has closed it, raise the error again; typer then exits silently.
    """
    if error.errno == errno.EPIPE:
        raise error
    name = f"{error.filename}: " if error.filename else ""
    print_error(
        f"{name}reading or writing failed ({error.strerror or error}); check disk, folder and "
        "permissions"
    )
    raise typer.Exit(STOPPED) from error


def print_json(command: str, code: int, content: Mapping[str, Any]) -> None:
    """Print the JSON object of a command: name, exit code and its meaning, then ``content``."""
    head = {"command": command, "exit_code": code, "meaning": MEANINGS[code]}
    print_line(to_json.dumps(plain({**head, **content})).replace("\x7f", r"\u007f"))


def add_json(name: str, make: Callable[[], Any]) -> None:
    """Add a value to the JSON object; ``make`` is called only with ``--json``."""
    output = _current_output()
    if output.options.json:
        output.content[name] = make()


def print_facts(
    facts: list[tuple[str, str]],
    details: Sequence[tuple[str, str]] = (),
    *,
    main: list[tuple[str, str]] | None = None,
) -> None:
    """Print facts (pairs of name and text), and add them to the JSON output of the command.

    ``details`` are added, but printed only with ``--verbose``; without it, ``main`` is printed in
    place of the facts if it is given, else their notes are in short. The key of an indented name is
    "NAME: INDENTED", where NAME is the last name without indent.
    """
    output = _current_output()
    values, above = output.content.setdefault("facts", {}), ""
    for name, text in (*facts, *details):
        above = above if name.startswith(" ") else name
        key = f"{above}: {name.strip()}" if name.startswith(" ") and above else name.strip()
        values[key] = f"{values[key]}\n{text}" if key in values else text
    short = in_short(facts) if main is None else main
    show([*facts, *details] if output.options.verbose else short)


def add_json_file(file: object) -> None:
    """Add the name of a written file to the JSON object."""
    _current_output().content.setdefault("files", []).append(str(file))


def print_written(file: object, more: str = "") -> None:
    """Print the name of a written file with a text, and add it to the JSON object."""
    add_json_file(file)
    print_line(f"wrote {file}{more}")


def written() -> list[str]:
    """Return a text with the files that the running command has written; an empty list if none."""
    files = dict.fromkeys(_current_output().content.get("files", ()))
    return [f"wrote {', '.join(files)}"] if files else []


def note_failure() -> None:
    """Let the running command end with exit code 1, although it continues."""
    _current_output().is_failed = True


def add_json_lines(name: str, words: str) -> None:
    """Add the lines of a text to the list ``name`` of the JSON object."""
    _current_output().content.setdefault(name, []).extend(words.splitlines())


def warn(words: str) -> None:
    """Print a warning on stderr, unless ``--quiet`` is given, and add it to the JSON object."""
    add_json_lines("warnings", words)
    if not _current_output().options.quiet:
        print_line(f"warning: {words}", err=True)


def print_error(words: str) -> None:
    """Print an error on stderr, even with ``--quiet``, and add it to the JSON object."""
    add_json_lines("errors", words)
    with suppress(OSError):  # stderr may be full: the exit code still reports the error
        print_line(words, err=True)


def detail(words: str) -> None:
    """Print a text with the elapsed time on stderr if ``--verbose`` is given."""
    output = _current_output()
    if output.options.verbose:
        elapsed = time.perf_counter() - output.began
        print_line(f"[{elapsed:8.3f} s] {words}", file=output.stderr)


def has_bar() -> bool:
    """Return whether a bar may be shown: without ``--quiet``, ``--verbose`` and ``--json``."""
    return not any(_current_output().options)


def output_options() -> OutputOptions:
    """Return the output options of the running command."""
    return _current_output().options


def plain(value: Any) -> Any:
    """Return a value converted to JSON types; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, str) or value is None:
        return value
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


class Reports(NamedTuple):
    """Callables that report progress; both raise KeyboardInterrupt after Ctrl-C."""

    time: Callable[[float], None]  # called with the time reached [s]
    search: Callable[[str, str], None]  # called with the phase and a line on the iterate


@contextmanager
def reporting(duration: float | None) -> Iterator[Reports]:
    """Yield callables that report the progress of a computation.

    ``duration`` is that of the motion, None for a search over the whole motion [s]. Ctrl-C is held
    back inside the context, see `held_interrupt`. With ``--verbose`` every iterate is printed; with
    ``--quiet`` and ``--json`` nothing is printed.
    """
    of = "" if duration is None else f" of {duration:g}"
    stderr, is_shown = sys.stderr, has_bar()  # the current stderr: integrators redirect it
    late = time.monotonic() + SAME_PHASE  # before it, phases without iterates are not worth a line
    is_verbose, begun = _current_output().options.verbose, False
    seldom = _sparse(lambda line: print_line(line, file=stderr), SAME_PHASE)
    seldom = _sparse(detail, NEW_PHASE) if is_verbose else seldom

    def show_time(t: float) -> None:
        """Show the time that the integration has reached, on a bar or now and then in a line."""
        nonlocal begun
        interrupt.check_interrupt()
        if is_verbose and not begun:
            detail("settled the vehicle at the start; integrating")
        begun = True
        if bar is not None:
            bar.update(task, completed=t)
        elif t > 0.01 * (duration or 0.0) and (is_verbose or is_shown):
            seldom(INTEGRATION, f"{INTEGRATION} to {t:.4g}{of} s")

    def show_search(phase: str, line: str) -> None:
        """Show a line on a search, on the bar or now and then in the output."""
        interrupt.check_interrupt()
        if bar is not None:
            bar.update(task, description=escape(visible(line)))
        elif is_verbose:
            detail(line)
        elif is_shown and (phase != line or time.monotonic() > late):
            seldom(phase, line)

    with interrupt.held_interrupt(from_first_poll=True), ExitStack() as stack:
        bar: Progress | None = None
        if is_shown and stderr.isatty():
            from rich.console import Console
            from rich.markup import escape
            from rich.progress import Progress

            console = Console(file=stderr, no_color=True)  # some colours are pale on white
            bar = stack.enter_context(Progress(console=console, transient=True))
            task = bar.add_task("solving", total=duration)
        yield Reports(show_time, show_search)


def _sparse(show: Callable[[str], None], apart: float) -> Callable[[str, str], None]:
    """Return a callback of phase and line that shows at most one line per ``apart`` seconds.

    The first line of a new phase is shown `NEW_PHASE` seconds after the previous line.
    """
    last, former = time.monotonic() + FIRST_LINE - NEW_PHASE, ""

    def seldom(phase: str, line: str) -> None:
        nonlocal last, former
        now = time.monotonic()
        if now - last >= (NEW_PHASE if phase != former else apart):
            last, former = now, phase
            show(line)

    return seldom


@contextmanager
def reported() -> Iterator[None]:
    """Print an error raised in the block, and exit with the exit code of its class."""
    try:
        yield
    except SlipfreeError as error:
        print_error(str(error))
        is_input = isinstance(error, DataError | ModelError) and not isinstance(error, WriteError)
        raise typer.Exit(BAD_INPUT if is_input else STOPPED) from error
    except OSError as error:
        fail(error)
    except MemoryError as error:
        print_error(NO_MEMORY)
        raise typer.Exit(STOPPED) from error
    except KeyboardInterrupt as error:
        interrupt.interrupt_arrived()
        print_error("; ".join(["interrupted", *map(str, error.args), *written()]))
        raise typer.Exit(INTERRUPTED) from error


@contextmanager
def about(file: Path) -> Iterator[None]:
    """Name the result file in the message of an error that the block raises.

    A KeyError becomes a DataError: every result of ``slipfree run`` has the requested quantities,
    statistics and attributes.
    """
    try:
        yield
    except (ModelError, DataError) as error:
        if str(file) in str(error) or isinstance(error, WriteError):
            raise
        raise DataError(f"{file}: {error}") from error
    except KeyError as error:
        raise DataError(
            f"{file}: expected a result of slipfree run, found no quantity, statistic or attribute "
            f"{error} in it; run the problem again"
        ) from error


def read_problem(
    file: Path, settings: list[str] | None, trust: list[Path] | None = None, command: str = "run"
) -> Problem[Any]:
    """Return the validated problem of a file, with the settings ``KEY=VALUE`` applied.

    Errors are those of `slipfree.problem.load.load_problem`.
    """
    from slipfree.problem.load import load_problem

    refuse_result(file)
    problem = load_problem(file, settings or [], command=command, trust=trust or [])
    detail(f"read {file}")
    return problem


def problem_of_map(
    file: Path, vehicle: str, settings: Sequence[str], trust: list[Path] | None
) -> Problem[Any]:
    """Return the problem of the mobility map of a vehicle, a file or name of the catalogue."""
    from slipfree.files.urdf.xacro import trusted_paths
    from slipfree.problem.load import load_again
    from slipfree.problem.schema import CATALOG

    if file.suffix.lower() == ".toml":
        raise DataError(
            f"{file}: expected a map before the vehicle {vehicle!r}, found a TOML file; omit "
            "VEHICLE for a problem file"
        )
    is_known = vehicle in CATALOG and not Path(vehicle).exists()
    if not is_known and not Path(vehicle).suffix:
        raise DataError(
            f"VEHICLE: expected a vehicle file, or one of {', '.join(CATALOG)}, found {vehicle!r}; "
            "correct the name"
        )
    key = "catalog" if is_known else "file"
    own = ["verb=atlas", f"terrain.file={to_json.dumps(str(file))}"]
    own.append(f"vehicle.{key}={to_json.dumps(vehicle)}")
    # names of files are relative to the current folder
    head = Path("atlas"), "", [*own, *settings], trusted_paths(trust or [])
    return load_again(*head, command="atlas")


def ground_of(
    file: Path,
    vehicle: str | None,
    settings: Sequence[str],
    trust: list[Path] | None,
    frame: str = "rep103",
) -> tuple[Problem[Any], GroundMap]:
    """Return a problem with the map, and its ground; maps in degrees are converted."""
    from slipfree.files.maps.elevation import DegreesError
    from slipfree.files.toml import ProblemError
    from slipfree.problem.build_ground import build_ground

    if file.suffix.lower() == ".toml" and vehicle is None:
        problem = read_problem(file, [*settings], trust, "vehicle")
        return problem, build_ground(problem)
    problem = problem_of_map(file, vehicle or ANY_VEHICLE, [f"frame={frame}", *settings], trust)
    try:
        return problem, build_ground(problem)
    except ProblemError as error:
        if not isinstance(error.__cause__, DegreesError):
            raise
    key = "terrain.geographic=local"
    print_line(f"the map is in degrees; it is converted to metres by --set {key}")
    return ground_of(file, vehicle, [key, *settings], trust, frame)


def start_on(problem: Problem[Any], grid: Grid) -> tuple[Mapping[str, float], Lines]:
    """Return a start at which a vehicle stands, see `stand`, and show the progress."""
    from slipfree.problem.ground_survey import stand

    with as_arguments(), counted("poses tried for a start") as progress:
        return stand(problem, grid, progress)


@contextmanager
def as_arguments() -> Iterator[None]:
    """Name the options and arguments of `slipfree atlas` in messages, not their settings."""
    from slipfree.files.toml import ProblemError

    try:
        yield
    except ProblemError as error:
        settings = re.compile(f"^({'|'.join(map(re.escape, ARGUMENTS))})")
        faults = (settings.sub(lambda found: ARGUMENTS[found[0]], each) for each in error.faults)
        raise ProblemError(*faults) from error


def refuse_result(file: Path) -> None:
    """Raise DataError for a result file instead of a problem file."""
    if begins_with(file, RESULT):
        raise DataError(
            f"{file}: expected a problem file, found a result; use slipfree info or slipfree "
            "report for a result, or slipfree info --problem to print its problem"
        )


def begins_with(file: Path, head: bytes) -> bool:
    """Return whether a file can be read and begins with given bytes."""
    try:
        with regular_file(file, "a file"), file.open("rb") as stream:
            return stream.read(len(head)) == head
    except DataError:
        return False


def show(facts: list[tuple[str, str]]) -> None:
    """Print facts (pairs of name and text), as a table on a terminal, otherwise as plain lines."""
    if not sys.stdout.isatty():
        width = max(len(name) for name, _ in facts)
        for name, value in facts:
            print_line(f"{name:{width}}  {value}")
        return
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(show_header=False, box=None, pad_edge=False)
    table.add_column(style="bold")
    for name, value in facts:  # a second column is added by its first text
        table.add_row(Text(visible(name)), Text(visible(value)))
    Console().print(table)


def print_table(columns: Sequence[TableColumn], rows: Sequence[Mapping[str, Any]]) -> None:
    """Print a table; on a terminal, the best values of columns with a sign of risk are bold."""
    if not sys.stdout.isatty():
        print_line("\n".join(table(columns, rows)))
        return
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    heads, *texts = cells(columns, rows)
    best = [best_text(column, rows) for column in columns]
    drawn = Table(*heads, box=SIMPLE_HEAD, pad_edge=False)
    for row in texts:
        marked = zip(row, best, strict=True)
        drawn.add_row(*(Text(visible(text), "bold" * (text == good)) for text, good in marked))
    Console().print(drawn)


def duration(seconds: float) -> str:
    """Return a duration as text, in the largest unit in which its value is at least 2."""
    for unit, size in (("days", 86400.0), ("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.2g} {unit}"
    return f"{float(f'{seconds:.2g}'):g} s"


def workers_of(processes: int | None, scheduler: str | None) -> int | Callable[..., Any]:
    """Return the workers of a study, see `slipfree.system.parts.study`; by default all cores.

    Raises DataError if both options that say where to compute are given.
    """
    from slipfree.system.processes import DaskPool, available_cores

    if scheduler is None:
        return processes or available_cores()
    if processes is not None:
        raise DataError(
            "--scheduler: expected --scheduler or --processes, found both; remove --processes: a "
            "cluster has as many processes as workers"
        )
    return lambda function: DaskPool(function, scheduler, warn)


@contextmanager
def studying(
    what: str, parts: Parts[Any] | None = None, words: Callable[[], str] | None = None
) -> Iterator[PartsWatch]:
    """Hold back Ctrl-C for a study, and yield its callbacks.

    ``what`` names the parts, which a message after Ctrl-C counts; ``words`` returns the text of the
    bar instead, and the last part.
    """
    from slipfree.system.parts import PartsWatch

    with interrupt.held_interrupt(from_first_poll=True), counted(what) as show:

        def progress(done: int, count: int) -> None:
            text, _, last = words().partition(": ") if words else (what, "", "")
            show(done, count, text)
            detail(f"{done} of {count} {what}{last and f', the last: {last}'}")

        try:
            yield PartsWatch(interrupt.check_interrupt, progress)
        except KeyboardInterrupt as error:
            if parts is None:
                raise
            raise KeyboardInterrupt(
                *error.args,
                f"{parts.folder} contains {len(parts)} of {parts.size} {what}; repeat the command "
                "to continue",
            ) from error


@contextmanager
def counted(words: str) -> Iterator[Callable[..., None]]:
    """Yield a function that shows progress: a bar on a terminal, otherwise lines on stderr.

    The function takes the number of completed items, their total number, and a text. The first
    line is printed after `FIRST_LINE`; the time between lines increases up to a minute.
    """
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TimeRemainingColumn

    console = Console(stderr=True, no_color=True)
    if not (console.is_terminal and has_bar()):
        begun, due = time.monotonic(), FIRST_LINE

        def print_progress(done: int, count: int, words: str = words) -> None:
            """Print a line, at most so often that lines are ever farther apart."""
            nonlocal due
            if has_bar() and (elapsed := time.monotonic() - begun) > due:
                due = elapsed + min(elapsed / 2, LINES_APART)
                left = elapsed * (count - done) / done if done else 0.0
                left_words = f", about {duration(left)} left" if left else ""
                print_line(f"{words}: {done} of {count}{left_words}", err=True)

        yield print_progress
        return
    columns = "{task.description}", BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task(words, total=None)
        yield lambda done, count, words=words: bar.update(
            task, completed=done, total=count, description=words
        )
