"""How much a command tells, and whether in words or as JSON: options that all commands share.

Whatever a command prints stands on stdout; with ``--quiet`` nothing does, with ``--json`` one
object: what was told as facts, what the command added by `put`, and the meaning of its exit code.
Errors, warnings and details are lines on stderr. All text passes `say`, which escapes control
characters: names and titles in files must not steer the terminal.
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

DONE, STOPPED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
MEANINGS = {
    DONE: "done",
    STOPPED: "stopped early or failed; files lists what was saved",
    BAD_INPUT: "bad input, or an extra that is not installed",
    INTERRUPTED: "interrupted",
}

# C0 but for tab and the ends of lines, delete, C1, separators, directions of writing, surrogates
CONTROL = re.compile(
    r"[\0-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069"
    r"\ud800-\udfff]|\r(?!\n)"
)

Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Say on stderr what is done, and when.")
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead of words.")]


class Voice(NamedTuple):
    """What the user wants to be told.

    Attributes
    ----------
    quiet, verbose, json : bool
        As the options of these names.
    """

    quiet: bool = False
    verbose: bool = False
    json: bool = False


@dataclass
class _Answer:
    """What is told by one command, in the order in which it is told.

    Details go to the stderr of its beginning: the integrator's own messages are kept from stderr
    while it runs.
    """

    voice: Voice
    stderr: TextIO = field(default_factory=lambda: sys.stderr)
    began: float = field(default_factory=time.perf_counter)
    content: dict[str, Any] = field(default_factory=dict)


_asked = [Voice()]  # before the command's name
_speakers: list[_Answer] = []  # the command that runs, if one does


def _said() -> _Answer:
    """Return what the command has told so far; outside of commands, nothing."""
    return _speakers[-1] if _speakers else _Answer(Voice())


def ask(quiet: bool, verbose: bool, json: bool) -> None:
    """Remember options given before the command's name."""
    _asked[:] = [Voice(quiet, verbose, json)]


def voiced(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command that takes ``--quiet``, ``--verbose`` and ``--json`` as well."""
    hints = get_type_hints(command, include_extras=True)
    own = inspect.signature(command).parameters.values()
    options = {"quiet": Quiet, "verbose": Verbose, "json": Json}
    more = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False) for name in options
    ]

    @wraps(command)
    def spoken(*, quiet: bool, verbose: bool, json: bool, **values: Any) -> None:
        before = _asked[0]
        voice = Voice(quiet or before.quiet, verbose or before.verbose, json or before.json)
        with _speaking(command.__name__, voice):
            _check_folder()
            if voice.quiet and voice.verbose:
                complain("expected --quiet or --verbose, found both")
                raise typer.Exit(BAD_INPUT)
            command(**values)

    hints |= options
    given: list[inspect.Parameter] = [
        each.replace(annotation=hints[each.name], kind=inspect.Parameter.KEYWORD_ONLY)
        for each in (*own, *more)
    ]
    spoken.__dict__["__signature__"] = inspect.Signature(given)
    spoken.__annotations__ = hints
    del spoken.__dict__["__wrapped__"]  # whose signature lacks the options
    return spoken


@contextmanager
def _speaking(name: str, voice: Voice) -> Iterator[None]:
    """Let a command speak as is wanted; print the JSON object at its end."""
    answer = _Answer(voice)
    _speakers.append(answer)
    code = STOPPED
    hidden = redirect_stdout(io.StringIO()) if voice.quiet or voice.json else nullcontext()
    try:
        with hidden, warnings.catch_warnings():
            warnings.showwarning = _warn_once
            yield
        code = DONE
    except typer.Exit as end:
        code = end.exit_code
        raise
    finally:
        _speakers.pop()
        if voice.json:
            print_json(name, code, answer.content)


def _check_folder() -> None:
    """Refuse to work in a folder that is gone: libraries ask for its name."""
    try:
        Path.cwd()
    except OSError as error:
        complain(
            f"expected a current folder, found none ({error.strerror}): it was removed; change to "
            "another one"
        )
        raise typer.Exit(BAD_INPUT) from error


def visible(text: str) -> str:
    r"""Return a text with its control characters escaped: ``\x1b`` stands for the byte 0x1b."""
    return CONTROL.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def say(words: str = "", *, nl: bool = True, err: bool = False, file: TextIO | None = None) -> None:
    """Print text on stdout, stderr or another stream, control characters escaped."""
    try:
        typer.echo(visible(words), nl=nl, err=err, file=file)
    except OSError as error:
        error.filename = error.filename or ("stderr" if err or file else "stdout")
        raise


def fail(error: OSError) -> NoReturn:
    """Report a system error that has no message of its own: a full disk, a medium that fails."""
    if error.errno == errno.EPIPE:  # whoever read the output is gone: typer ends without a word
        raise error
    name = f"{error.filename}: " if error.filename else ""
    complain(f"{name}reading or writing failed ({error.strerror or error})")
    raise typer.Exit(STOPPED) from error


def print_json(command: str, code: int, content: Mapping[str, Any]) -> None:
    """Print the JSON object of a command."""
    head = {"command": command, "exit_code": code, "meaning": MEANINGS[code]}
    text = to_json.dumps(plain({**head, **content}))
    say(text.replace("\x7f", r"\u007f"))


def put(name: str, make: Callable[[], Any]) -> None:
    """Add a value to the JSON object, if one is wanted; what makes it is not called otherwise."""
    answer = _said()
    if answer.voice.json:
        answer.content[name] = make()


def put_facts(facts: list[tuple[str, str]]) -> None:
    """Add names and words to the facts of the JSON object; indented names belong to those above."""
    found, above = _said().content.setdefault("facts", {}), ""
    for name, words in facts:
        above = above if name.startswith(" ") else name
        key = f"{above}: {name.strip()}" if name.startswith(" ") and above else name.strip()
        found[key] = f"{found[key]}\n{words}" if key in found else words


def put_file(file: object) -> None:
    """Add a file that was written to the JSON object."""
    _said().content.setdefault("files", []).append(str(file))


def put_lines(name: str, words: str) -> None:
    """Add lines of words to the JSON object."""
    _said().content.setdefault(name, []).extend(words.splitlines())


def warn(words: str) -> None:
    """Print a warning on stderr, unless only errors are wanted."""
    put_lines("warnings", words)
    if not _said().voice.quiet:
        say(f"warning: {words}", err=True)


def _warn_once(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning of the library, if it is a new one."""
    if not set(str(message).splitlines()) <= set(_said().content.get("warnings", ())):
        warn(str(message))


def complain(words: str) -> None:
    """Print an error on stderr."""
    put_lines("errors", words)
    with suppress(OSError):  # of a stderr that is full: the exit code still tells
        say(words, err=True)


def detail(words: str) -> None:
    """Print on stderr what was just done and how long after the start, if that is wanted."""
    answer = _said()
    if answer.voice.verbose:
        elapsed = time.perf_counter() - answer.began
        say(f"[{elapsed:8.3f} s] {words}", file=answer.stderr)


def has_bar() -> bool:
    """Return whether progress may be shown by a bar on a terminal: nothing else is to be said."""
    return not any(_said().voice)


def is_quiet() -> bool:
    """Return whether only errors are wanted."""
    return _said().voice.quiet


def is_verbose() -> bool:
    """Return whether details are wanted."""
    return _said().voice.verbose


def plain(value: Any) -> Any:
    """Return a value as JSON has it: numbers that are not finite become null."""
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, str) or value is None:
        return value
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(each) for each in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
