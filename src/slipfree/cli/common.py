"""Common parts of the commands: options, checks of output paths, reports of errors."""

from __future__ import annotations

import os
import shlex
import signal
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slipfree.cli.messages import BAD_INPUT as BAD_INPUT
from slipfree.cli.messages import (
    INTERRUPTED,
    add_json_facts,
    detail,
    fail,
    print_error,
    print_line,
    visible,
)
from slipfree.cli.messages import STOPPED as STOPPED
from slipfree.errors import DataError, ModelError, SlipfreeError
from slipfree.regular_files import check_name, regular_file, resolve_links

if TYPE_CHECKING:
    from slipfree.problem.problem import Problem

RESULT, FIGURE = b"CDF", b"\x89PNG"  # first bytes of netCDF and PNG files
OUTPUT = ("output", "file")  # key of a problem file with the name of its result
NO_MEMORY = (
    "not enough memory: reduce 'terrain.window', or increase the spacing of the ground or "
    "'time.step', or use fewer intervals of the plan"
)
MAX_PROCESSES = 1000  # more need hundreds of gigabytes
REFRESH = 0.1  # shortest time between updates of the progress bar [s]

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
InputFolder = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Folder of the input files of the problem; default: the first folder that contains "
        "them: that of the problem file, that of the result, or the current one.",
    ),
]


@contextmanager
def reported() -> Iterator[None]:
    """Print an error raised in the block, and exit with the exit code of its class."""
    try:
        yield
    except (DataError, ModelError) as error:
        print_error(str(error))
        raise typer.Exit(BAD_INPUT) from error
    except SlipfreeError as error:
        print_error(str(error))
        raise typer.Exit(STOPPED) from error
    except OSError as error:
        fail(error)
    except MemoryError as error:
        print_error(NO_MEMORY)
        raise typer.Exit(STOPPED) from error
    except KeyboardInterrupt as error:
        print_error("interrupted")
        raise typer.Exit(INTERRUPTED) from error


@contextmanager
def about(file: Path) -> Iterator[None]:
    """Name the result file in the message of an error that the block raises.

    Raises
    ------
    DataError
        If the block raises a ModelError or DataError whose message lacks the name, or a KeyError:
        every result of ``slipfree run`` has the requested quantities, statistics and attributes.
    """
    try:
        yield
    except (ModelError, DataError) as error:
        if str(file) in str(error):
            raise
        raise DataError(f"{file}: {error}") from error
    except KeyError as error:  # every result has this quantity, statistic or attribute
        raise DataError(
            f"{file}: expected a result of slipfree run, found no quantity, statistic or attribute "
            f"{error} in it; run the problem again"
        ) from error


def read_problem(
    file: Path,
    settings: list[str] | None,
    trust: list[Path] | None = None,
    command: str = "run",
) -> Problem[Any]:
    """Return the validated problem of a file, with the settings ``KEY=VALUE`` applied.

    Parameters and errors are those of `slipfree.problem.load.load_problem`.
    """
    from slipfree.problem.load import load_problem

    refuse_result(file)
    problem = load_problem(file, settings or [], command=command, trust=trust or [])
    detail(f"read {file}")
    return problem


def refuse_result(file: Path) -> None:
    """Raise DataError for a result file instead of a problem file."""
    if _begins_with(file, RESULT):
        raise DataError(
            f"{file}: expected a problem file, found a result; use slipfree info or slipfree "
            "report for a result, or slipfree info --problem to print its problem"
        )


def _begins_with(file: Path, head: bytes) -> bool:
    """Return whether a file can be read and begins with given bytes."""
    try:
        with regular_file(file, "a file"), file.open("rb") as stream:
            return stream.read(len(head)) == head
    except DataError:
        return False


def check_default_outputs(out: Path, folder: Path | None, problem: Problem[Any]) -> None:
    """Raise DataError for default output paths that could overwrite other files of the user.

    Parameters
    ----------
    out : Path
        Result file: the ``[output] file`` of the problem, or the problem's name with ``.nc``.
    folder : Path or None
        Default folder for figures; None if no default folder is used.
    problem : Problem
        Problem whose results are written.

    Raises
    ------
    DataError
        If a path is not a valid file name or, with symbolic links resolved, is outside the working
        folder and the problem's folder, if the result's name does not end in ``.nc``, or if a path
        would replace a file that is not a result or a figure.
    """
    from slipfree.files.netcdf import is_result

    for place in (out, folder):
        if place is not None:
            check_name(place)
    where = problem.source.where(OUTPUT) if problem.spec.output else str(problem.source.path)
    remedy = f"choose another name, or give it on the command line: -o {shlex.quote(str(out))}"
    inside = [resolve_links(each) for each in (Path.cwd(), problem.folder)]
    figures = [] if folder is None else [folder, *folder.glob("*.png")]
    for path in (out, *figures):
        target = resolve_links(path)
        if not any(target.is_relative_to(each) for each in inside):
            link = "" if target == Path.cwd() / path else f", which is {target}"
            raise DataError(
                f"{where}: expected a path in the working folder or in the problem's folder, "
                f"found {path}{link}; {remedy}"
            )
    if out.suffix.lower() != ".nc":
        raise DataError(f"{where}: expected a name that ends in .nc, found {out}; {remedy}")
    if out.is_file() and not is_result(out):
        raise DataError(
            f"{where}: expected a new file or a result of an earlier run, found the file {out}, "
            f"which is neither; {remedy}"
        )
    for path in figures[1:]:
        if not _begins_with(path, FIGURE):
            raise DataError(
                f"{where}: expected a new file or a figure of an earlier run, found the file "
                f"{path}, which is neither; choose another folder: --figures DIR"
            )


def check_outputs(files: list[Path | None], folder: Path | None, problem: Problem[Any]) -> None:
    """Raise DataError for outputs that cannot be written or coincide with other files.

    Parameters
    ----------
    files : list of Path or None
        Files to write; None for an output that is not requested.
    folder : Path or None
        Folder for figures; created later if it does not exist.
    problem : Problem
        Problem whose file and input files must not be overwritten.
    """
    from slipfree.problem.input_files import input_names

    taken = {resolve_links(problem.source.path): "the problem file"}
    taken |= {
        resolve_links(problem.folder / name): f"the input {name}"
        for name in input_names(problem.spec)
    }
    for path in files:
        if path is None:
            continue
        target = resolve_links(path)
        if target in taken:
            raise DataError(
                f"{path}: expected a separate file, found {taken[target]}; choose another name"
            )
        taken[target] = "another output"
        check_output(path)
    if folder is not None:
        check_name(folder)
        if folder.exists() and not folder.is_dir():
            raise DataError(
                f"{folder}: expected a folder for figures, found a file; choose another folder: "
                "--figures DIR"
            )
        above = next(each for each in (folder, *folder.absolute().parents) if each.is_dir())
        check_writable(folder, above)


def check_page(out: Path, files: Sequence[Path]) -> None:
    """Raise DataError if a page cannot be written, or if its name does not end in .html or .htm.

    The page must not be one of ``files``, the result files that it shows.
    """
    check_apart(out, files)
    if out.suffix.lower() not in (".html", ".htm"):
        raise DataError(f"{out}: expected a name that ends in .html or .htm; choose another name")
    check_output(out)


def check_apart(out: Path, files: Sequence[Path]) -> None:
    """Raise DataError if an output file is one of the result files to read."""
    if resolve_links(out) in map(resolve_links, files):
        raise DataError(
            f"{out}: expected a separate file, found the result file; choose another name"
        )


def check_output(path: Path) -> None:
    """Raise DataError for a file that cannot be written, before any computation."""
    check_name(path)
    if path.is_dir():
        raise DataError(
            f"{path}: expected the name of a file to write, found a folder; choose another name"
        )
    if path.exists() and not path.is_file():
        raise DataError(
            f"{path}: expected the name of a file to write, found a device, pipe or socket; choose "
            "another name"
        )
    if not path.parent.is_dir():
        found, remedy = "none", "create it, or choose another folder"
        if path.parent.exists():
            found, remedy = "a file", "choose another folder"
        raise DataError(
            f"{path}: expected a folder {path.parent} to write to, found {found}; {remedy}"
        )
    check_writable(path, path.parent)


def check_writable(path: Path, folder: Path) -> None:
    """Raise DataError if ``folder``, which exists and will contain ``path``, is not writable."""
    if not os.access(folder, os.W_OK):
        raise DataError(
            f"{path}: expected a folder {folder} that may be written to, found one without write "
            "permission; choose another folder"
        )


@contextmanager
def interruptible() -> Iterator[Callable[[], None]]:
    """Yield a function that raises KeyboardInterrupt if Ctrl-C was pressed.

    The integrator loses exceptions of signal handlers. The handler therefore only stores the first
    Ctrl-C, and the next call of the function, or else the end of the block, raises
    KeyboardInterrupt. A second Ctrl-C raises it immediately.
    """
    pressed = raised = False

    def remember(_signal: int, _frame: object) -> None:
        nonlocal pressed
        if pressed:
            raise KeyboardInterrupt
        pressed = True

    def poll() -> None:
        nonlocal raised
        if pressed:
            raised = True
            raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, remember)
    try:
        yield poll
    finally:
        signal.signal(signal.SIGINT, before)
        if pressed and not raised:
            raise KeyboardInterrupt


def throttled(show: Callable[[Any], None], apart: float = REFRESH) -> Callable[[Any], None]:
    """Return a callback that calls ``show`` at most once per ``apart`` seconds."""
    last = 0.0

    def throttle(value: Any) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last > apart:
            last = now
            show(value)

    return throttle


def print_facts(facts: list[tuple[str, str]]) -> None:
    """Print facts (pairs of name and text), and add them to the JSON output of the command."""
    add_json_facts(facts)
    show(facts)


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
    table.add_column()
    for name, value in facts:
        table.add_row(Text(visible(name)), Text(visible(value)))
    Console().print(table)
