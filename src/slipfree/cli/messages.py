"""Output of the commands: common options, messages, details, JSON and progress.

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
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, redirect_stdout, suppress
from dataclasses import dataclass, field
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, NamedTuple, NoReturn, TextIO, get_type_hints

import typer

from slipfree.system.interrupt import check_interrupt, held_interrupt

DONE, STOPPED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
MEANINGS = {
    DONE: "done",
    STOPPED: "not complete or failed; 'files' lists the saved files, if any",
    BAD_INPUT: "bad input, or a package that is not installed",
    INTERRUPTED: "interrupted",
}

# C0 without tab and newline, delete, C1, separators, text directions, surrogates
CONTROL = re.compile(
    r"[\0-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069"
    r"\ud800-\udfff]|\r(?!\n)"
)

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print only errors.")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Print every step with its time on stderr.")
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")]
FIRST_LINE = 2.0  # time before the first line of a computation [s]
NEW_PHASE = 1.0  # shortest time between lines of different phases [s]
SAME_PHASE = 10.0  # shortest time between lines of the same phase [s]
REFRESH = 0.1  # shortest time between updates of the progress bar [s]
INTEGRATION = "integrated"


class OutputOptions(NamedTuple):
    """Values of the output options of a command.

    Attributes
    ----------
    quiet, verbose, json : bool
        Whether ``--quiet``, ``--verbose`` and ``--json`` are given.
    """

    quiet: bool = False
    verbose: bool = False
    json: bool = False


@dataclass
class _CommandOutput:
    """Output of one command, collected for ``--json``.

    Attributes
    ----------
    options : OutputOptions
        Output options of the command.
    stderr : text stream
        Stream of the details: the original stderr, since messages of integrators are redirected.
    began : float
        Start time of the command, from `time.perf_counter`. [s]
    content : dict
        Keys and values of the JSON object.
    is_failed : bool
        Whether a part of the command has failed.
    """

    options: OutputOptions
    stderr: TextIO = field(default_factory=lambda: sys.stderr)
    began: float = field(default_factory=time.perf_counter)
    content: dict[str, Any] = field(default_factory=dict)
    is_failed: bool = False


_global_options = [OutputOptions()]  # options given before the command's name
_running: list[_CommandOutput] = []  # output of the running command, if there is one


def _current_output() -> _CommandOutput:
    """Return the output of the running command, or a new one if no command is running."""
    return _running[-1] if _running else _CommandOutput(OutputOptions())


def store_options(quiet: bool, verbose: bool, json: bool) -> None:
    """Store the output options given before the command's name, for that command."""
    _global_options[:] = [OutputOptions(quiet, verbose, json)]


def with_output_options(command: Callable[..., None]) -> Callable[..., None]:
    """Return the command with the additional options ``--quiet``, ``--verbose`` and ``--json``."""
    hints = get_type_hints(command, include_extras=True)
    own = inspect.signature(command).parameters.values()
    annotations = {"quiet": Quiet, "verbose": Verbose, "json": Json}
    more = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False)
        for name in annotations
    ]

    @wraps(command)
    def wrapped(*, quiet: bool, verbose: bool, json: bool, **values: Any) -> None:
        before = _global_options[0]
        options = OutputOptions(
            quiet or before.quiet, verbose or before.verbose, json or before.json
        )
        with _collecting(command.__name__, options):
            _check_folder()
            if options.quiet and options.verbose:
                print_error("expected --quiet or --verbose, found both; remove one of them")
                raise typer.Exit(BAD_INPUT)
            command(**values)
            if _current_output().is_failed:
                raise typer.Exit(STOPPED)

    hints |= annotations
    given: list[inspect.Parameter] = [
        each.replace(annotation=hints[each.name], kind=inspect.Parameter.KEYWORD_ONLY)
        for each in (*own, *more)
    ]
    wrapped.__dict__["__signature__"] = inspect.Signature(given)
    wrapped.__annotations__ = hints
    del wrapped.__dict__["__wrapped__"]  # its signature lacks the options
    return wrapped


@contextmanager
def _collecting(name: str, options: OutputOptions) -> Iterator[None]:
    """Collect the output of a command; print the JSON object at its end."""
    output = _CommandOutput(options)
    _running.append(output)
    code = STOPPED
    hidden = redirect_stdout(io.StringIO()) if options.quiet or options.json else nullcontext()
    try:
        with hidden, warnings.catch_warnings():
            warnings.showwarning = _warn_once
            yield
        code = DONE
    except typer.Exit as end:
        code = end.exit_code
        raise
    finally:
        _running.pop()
        if options.json:
            print_json(name, code, output.content)


def _check_folder() -> None:
    """Print an error and exit if the current folder does not exist."""
    try:
        Path.cwd()
    except OSError as error:
        print_error(
            "expected a current folder that exists, found that it was removed "
            f"({error.strerror}); change to another folder: cd DIR"
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
    text = to_json.dumps(plain({**head, **content}))
    print_line(text.replace("\x7f", r"\u007f"))


def add_json(name: str, make: Callable[[], Any]) -> None:
    """Add a value to the JSON object; ``make`` is called only with ``--json``."""
    output = _current_output()
    if output.options.json:
        output.content[name] = make()


def add_json_facts(facts: list[tuple[str, str]]) -> None:
    """Add facts (pairs of name and text) to the JSON object.

    The key of an indented name is "NAME: INDENTED", where NAME is the last name without indent.
    """
    found, above = _current_output().content.setdefault("facts", {}), ""
    for name, words in facts:
        above = above if name.startswith(" ") else name
        key = f"{above}: {name.strip()}" if name.startswith(" ") and above else name.strip()
        found[key] = f"{found[key]}\n{words}" if key in found else words


def add_json_file(file: object) -> None:
    """Add the name of a written file to the JSON object."""
    _current_output().content.setdefault("files", []).append(str(file))


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


def _warn_once(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a Python warning, unless the command has printed it before."""
    if not set(str(message).splitlines()) <= set(_current_output().content.get("warnings", ())):
        warn(str(message))


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
    """Return whether a progress bar may be shown.

    It is not shown with ``--quiet``, ``--verbose`` or ``--json``.
    """
    return not any(_current_output().options)


def is_quiet() -> bool:
    """Return whether ``--quiet`` is given."""
    return _current_output().options.quiet


def is_verbose() -> bool:
    """Return whether ``--verbose`` is given."""
    return _current_output().options.verbose


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
    """Callables that report progress; both raise KeyboardInterrupt after Ctrl-C.

    Attributes
    ----------
    time : callable
        Called with the time reached. [s]
    search : callable
        Called with the phase of a search and a line that describes its iterate.
    """

    time: Callable[[float], None]
    search: Callable[[str, str], None]


@contextmanager
def reporting(duration: float | None) -> Iterator[Reports]:
    """Yield callables that report the progress of a computation.

    Ctrl-C is held back inside the context, see `held_interrupt`.
    With ``--verbose`` every iterate is printed; with ``--quiet`` and ``--json`` nothing is printed.

    Parameters
    ----------
    duration : float or None
        Duration of the motion; None for a search over the whole motion. [s]
    """
    with held_interrupt():
        if is_verbose():
            yield _reports(_detailed(), lambda _, line: detail(line), duration)
        elif not has_bar():
            yield Reports(lambda _: check_interrupt(), lambda *_: check_interrupt())
        elif sys.stderr.isatty():
            with _bar(duration) as reports:
                yield reports
        else:
            stderr = sys.stderr  # the current one: integrators redirect sys.stderr
            show = _sparse(lambda line: print_line(line, file=stderr), SAME_PHASE)
            yield _reports(show, show, duration)


def _reports(
    integration: Callable[[str, str], None],
    search: Callable[[str, str], None],
    duration: float | None,
) -> Reports:
    of = "" if duration is None else f" of {duration:g}"

    def show_time(t: float) -> None:
        check_interrupt()
        integration(INTEGRATION, f"{INTEGRATION} to {t:.4g}{of} s")

    def show_search(phase: str, line: str) -> None:
        check_interrupt()
        search(phase, line)

    return Reports(show_time, show_search)


def _detailed() -> Callable[[str, str], None]:
    """Return a callback for ``--verbose`` that prints the start of the integration, then times."""
    seldom, begun = _sparse(detail, NEW_PHASE), False

    def integrated(phase: str, line: str) -> None:
        nonlocal begun
        if not begun:
            begun = True
            detail("settled the vehicle at the start; integrating")
        seldom(phase, line)

    return integrated


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
def _bar(duration: float | None) -> Iterator[Reports]:
    """Yield callables that update a progress bar."""
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import Progress

    with Progress(console=Console(file=sys.stderr), transient=True) as bar:
        task = bar.add_task("solving", total=duration)
        move = throttled(lambda t: bar.update(task, completed=t))
        describe = throttled(lambda line: bar.update(task, description=escape(visible(line))))

        def show_time(t: float) -> None:
            check_interrupt()
            move(t)

        def show_search(_phase: str, line: str) -> None:
            check_interrupt()
            describe(line)

        yield Reports(show_time, show_search)


def throttled(show: Callable[[Any], None]) -> Callable[[Any], None]:
    """Return a callback that calls ``show`` at most once per `REFRESH` seconds."""
    last = 0.0

    def throttle(value: Any) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last > REFRESH:
            last = now
            show(value)

    return throttle
