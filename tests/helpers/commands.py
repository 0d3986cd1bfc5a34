"""Commands of slipfree, run in the process of the tests."""

import signal
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from slipfree.cli import app
from slipfree.files.toml import ProblemError
from slipfree.problem.load import load_problem, verb_of
from slipfree.problem.result import build, open_result


def invoke(*words: object, code: int | None = None) -> Any:
    """Return the result of a command, which must end with an exit code if one is given."""
    result = CliRunner().invoke(app, [str(word) for word in words])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    assert code is None or result.exit_code == code, result.output
    return result


def printed(*words: object, code: int = 0) -> str:
    """Return what a command prints on stdout and stderr."""
    return str(invoke(*words, code=code).output)


def refused(*words: object) -> str:
    """Return the errors of a command that must fail for bad input."""
    return str(invoke(*words, code=2).stderr)


def sets(*settings: str) -> list[str]:
    """Return the words of the options ``--set``."""
    return [word for setting in settings for word in ("--set", setting)]


def shown(file: Path, name: str) -> Any:
    """Return the motion of a result file as input of the viewer."""
    result = open_result(file)
    return verb_of(result.problem).shown(result, name)


def error_of(
    error: type[Exception], function: Callable[..., Any], *args: Any, **options: Any
) -> Any:
    """Return the error with which a call ends."""
    with pytest.raises(error) as caught:
        function(*args, **options)
    return caught.value


def build_errors(file: Path, settings: Sequence[str] = ()) -> str:
    """Return the errors of a problem that cannot be built."""
    return str(error_of(ProblemError, lambda: build(load_problem(file, settings))))


def refuses(
    error: type[Exception], words: str, function: Callable[..., Any], *args: Any, **options: Any
) -> None:
    """Check that a call ends with an error whose message matches a regular expression."""
    with pytest.raises(error, match=words):
        function(*args, **options)


def press() -> None:
    """Press Ctrl-C."""
    signal.raise_signal(signal.SIGINT)


def pressing(
    function: Callable[..., Any], at: int = 1, times: int = 1
) -> tuple[Callable[..., Any], list[tuple[Any, ...]]]:
    """Return a function before whose call of that number Ctrl-C is pressed, and those calls."""
    calls = list[tuple[Any, ...]]()

    def pressed(*args: Any, **more: Any) -> Any:
        calls.append(args)
        if len(calls) == at:
            for _ in range(times):
                press()
        return function(*args, **more)

    return pressed, calls
