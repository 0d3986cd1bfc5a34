"""The command line: ``slipfree new | examples | run | check | vehicle | compare | info ...``.

Exit codes: 0 done; 1 stopped early or failed, with what was reached saved; 2 bad input; 130
interrupted. ``--quiet``, ``--verbose`` and ``--json`` belong to every command (`cli.voice`).
What a command needs is imported inside it, so that ``slipfree --help`` answers at once.
"""

from __future__ import annotations

from typing import Annotated

import typer

import slipfree
from slipfree.cli.examples import examples
from slipfree.cli.look import check, compare, export, info, vehicle
from slipfree.cli.new import new
from slipfree.cli.report import report
from slipfree.cli.run import run
from slipfree.cli.show import show
from slipfree.cli.sweep import sweep
from slipfree.cli.voice import Json, Quiet, Verbose, ask, voiced

app = typer.Typer(
    name="slipfree",
    help="How a wheeled vehicle moves over uneven ground without slipping.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for command in (new, examples, run, check, vehicle, compare, info, show, report, export, sweep):
    app.command()(voiced(command))


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
    quiet: Quiet = False,
    verbose: Verbose = False,
    json: Json = False,
) -> None:
    ask(quiet, verbose, json)
