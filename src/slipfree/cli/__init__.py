"""The command line: ``slipfree new | examples | run | check | vehicle | compare | info ...``.

Exit codes: 0 done; 1 not complete or failed, with what was reached saved; 2 bad input, or a package
that is not installed; 130 interrupted. ``--quiet``, ``--verbose`` and ``--json`` belong
to every command (`cli.messages`). What a command needs is imported inside it, so that
``slipfree --help`` answers at once.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import slipfree
from slipfree.cli.examples import examples
from slipfree.cli.inspect import check, compare, export, info, vehicle
from slipfree.cli.messages import (
    BAD_INPUT,
    DONE,
    INTERRUPTED,
    Json,
    Quiet,
    Verbose,
    ask,
    complain,
    fail,
    print_json,
    say,
    visible,
    voiced,
)
from slipfree.cli.migrate import migrate
from slipfree.cli.new import new
from slipfree.cli.report import report
from slipfree.cli.run import run
from slipfree.cli.show import show
from slipfree.cli.sweep import sweep

UsageError: Any = typer.BadParameter.__bases__[0]  # of click, of which newer typer has a copy


class _Commands(TyperGroup):
    """The commands, with ``--json`` also for errors in the command line."""

    def make_context(self, info_name: Any, args: list[str], *rest: Any, **more: Any) -> Any:
        words = tuple(args)  # parsing consumes the list
        with self._telling(words):
            return super().make_context(info_name, args, *rest, obj=words, **more)

    def invoke(self, ctx: Any) -> Any:
        with self._telling(ctx.obj):
            return super().invoke(ctx)

    @contextmanager
    def _telling(self, words: Sequence[str]) -> Iterator[None]:
        try:
            yield
        except KeyboardInterrupt as error:  # before or after what a command does
            complain("interrupted")
            raise typer.Exit(INTERRUPTED) from error
        except OSError as error:  # of stdout or stderr
            fail(error)
        except UsageError as error:
            if "--json" in words:
                names = [word for word in words if not word.startswith("-")]
                name = next((word for word in names if word in self.commands), [*names, ""][0])
                print_json(name, BAD_INPUT, {"errors": [error.format_message()]})
            error.message = visible(error.message)
            raise


app = typer.Typer(
    name="slipfree",
    cls=_Commands,
    help="Compute how a wheeled vehicle moves over a height map, and plan its motion.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
COMMANDS = (
    new,
    examples,
    migrate,
    run,
    check,
    vehicle,
    compare,
    info,
    show,
    report,
    export,
    sweep,
)
for command in COMMANDS:
    app.command()(voiced(command))


def main() -> None:
    """Run the command line."""
    app()


def _version(ctx: typer.Context, wanted: bool) -> None:
    if not wanted:
        return
    if "--json" in ctx.obj:
        print_json("--version", DONE, {"version": slipfree.__version__})
    else:
        say(f"slipfree {slipfree.__version__}")
    raise typer.Exit


@app.callback()
def _common(
    _: Annotated[
        bool,
        typer.Option("--version", callback=_version, is_eager=True, help="Print the version."),
    ] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    json: Json = False,
) -> None:
    ask(quiet, verbose, json)
