"""Common parts of the commands: options, reading of problems, reports of errors."""

from __future__ import annotations

import sys
from collections.abc import Iterator
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
    written,
)
from slipfree.cli.messages import STOPPED as STOPPED
from slipfree.core.errors import DataError, ModelError, SlipfreeError, WriteError
from slipfree.system.regular_files import regular_file

if TYPE_CHECKING:
    from slipfree.problem.problem import Problem

RESULT = b"CDF"  # first bytes of a netCDF file
NO_MEMORY = (
    "not enough memory: reduce 'terrain.window', or increase the spacing of the ground or "
    "'time.step', or use fewer intervals of the plan"
)
MAX_PROCESSES = 1000  # more need hundreds of gigabytes

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
    except WriteError as error:
        print_error(str(error))
        raise typer.Exit(STOPPED) from error
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
        print_error("; ".join(["interrupted", *map(str, error.args), *written()]))
        raise typer.Exit(INTERRUPTED) from error


@contextmanager
def about(file: Path) -> Iterator[None]:
    """Name the result file in the message of an error that the block raises.

    Raises DataError if the block raises a ModelError or DataError whose message lacks the name, or
    a KeyError: every result of ``slipfree run`` has the requested quantities, statistics and
    attributes.
    """
    try:
        yield
    except (ModelError, DataError) as error:
        if str(file) in str(error) or isinstance(error, WriteError):
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
