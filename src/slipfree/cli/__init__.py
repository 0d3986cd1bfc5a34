"""The command line: ``slipfree run | check | vehicle | compare | info | export``.

Exit codes: 0 done; 1 stopped early, with what was reached saved; 2 bad input; 130 interrupted.
What a command needs is imported inside it, so that ``slipfree --help`` answers at once.
"""

from __future__ import annotations

from typing import Annotated

import typer

import slipfree
from slipfree.cli.look import check, compare, export, info, vehicle
from slipfree.cli.run import run

app = typer.Typer(
    name="slipfree",
    help="How a wheeled vehicle moves over uneven ground without slipping.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for command in (run, check, vehicle, compare, info, export):
    app.command()(command)


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
