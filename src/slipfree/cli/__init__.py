"""The command line: ``slipfree new | examples | run | check | vehicle | compare | info ...``.

Exit codes: 0 done; 1 not complete or failed; 2 bad input, or a package that is not installed; 130
interrupted. Every command has the options ``--quiet``, ``--verbose`` and ``--json``
(`cli.console`). Public functions of the other modules are commands. They import their modules when
they run, so that ``slipfree --help`` is fast.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from inspect import isfunction
from pkgutil import iter_modules
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

import slipfree
from slipfree.cli import console
from slipfree.cli.console import BAD_INPUT, DONE, INTERRUPTED, Json, Quiet, Verbose
from slipfree.system.interrupt import interrupt_arrived

# class of click, or of the copy of click in typer
UsageError: Any = typer.BadParameter.__bases__[0]


class _CommandGroup(TyperGroup):
    """Group of the commands; with ``--json`` it prints errors of the command line as JSON."""

    def make_context(self, info_name: Any, args: list[str], *rest: Any, **more: Any) -> Any:
        words = tuple(args)  # parsing consumes the list
        with self._reporting(words):
            return super().make_context(info_name, args, *rest, obj=words, **more)

    def invoke(self, ctx: Any) -> Any:
        with self._reporting(ctx.obj):
            return super().invoke(ctx)

    @contextmanager
    def _reporting(self, words: Sequence[str]) -> Iterator[None]:
        """Report errors outside of the command: of its options, and of closed streams."""
        try:
            yield
        except KeyboardInterrupt as error:  # before or after the command
            interrupt_arrived()
            console.print_error("interrupted")
            raise typer.Exit(INTERRUPTED) from error
        except OSError as error:  # of stdout or stderr
            console.fail(error)
        except UsageError as error:
            if "--json" in words:
                names = [word for word in words if not word.startswith("-")]
                name = next((word for word in names if word in self.commands), [*names, ""][0])
                console.print_json(name, BAD_INPUT, {"errors": [error.format_message()]})
            error.message = console.visible(error.message)
            raise


app = typer.Typer(
    name="slipfree",
    cls=_CommandGroup,
    help="Compute how a wheeled vehicle moves over a height map, and plan its motion.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
FIRST = ("new", "run", "inspect", "show")  # modules whose commands the help lists first
NO_COMMANDS = ("console", "outputs")  # modules of functions that several commands use


def commands() -> Iterator[Callable[..., None]]:
    """Yield the commands: the public functions of the modules of this package."""
    names = dict.fromkeys([*FIRST, *(each.name for each in iter_modules(__path__))])
    for name in (name for name in names if name not in NO_COMMANDS):
        module = import_module(f"{__name__}.{name}")
        for word, value in vars(module).items():
            if isfunction(value) and value.__module__ == module.__name__ and word[0] != "_":
                yield value


for command in commands():
    app.command()(console.with_output_options(command))


def main() -> None:
    """Run the command line."""
    app()


def _version(ctx: typer.Context, wanted: bool) -> None:
    """Print the version, in JSON on request, and exit."""
    if not wanted:
        return
    if "--json" in ctx.obj:
        console.print_json("--version", DONE, {"version": slipfree.__version__})
    else:
        console.print_line(f"slipfree {slipfree.__version__}")
    raise typer.Exit


@app.callback()
def _common(
    _: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    json: Json = False,
) -> None:
    console.store_options(quiet, verbose, json)
