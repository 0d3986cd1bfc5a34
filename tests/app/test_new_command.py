"""Add a command: one file and one line of registration.

The function `count` is the file ``cli/count.py`` (4 lines without docstring and imports), and
``count`` the line of ``COMMANDS`` in ``cli/__init__.py``: two files. ``--quiet``, ``--json``, help
and exit codes come with it.
"""

import json
from pathlib import Path
from typing import Annotated

import pytest
import typer
from typer.testing import CliRunner

from slipfree import cli
from slipfree.cli.console import print_facts, reported, with_output_options


def count(file: Annotated[Path, typer.Argument(metavar="OUT.nc", help="Result file.")]) -> None:
    """Print the number of samples of a result."""
    with reported():
        from slipfree.files.netcdf import read

        print_facts([("samples", str(read(file).t.size))])


@pytest.fixture
def app() -> typer.Typer:
    """Return the command line as it is with one more line."""
    cli.console.store_options(quiet=False, verbose=False, json=False)  # of another test
    made = typer.Typer(cls=cli.app.info.cls)
    for command in (*cli.COMMANDS, count):
        made.command()(with_output_options(command))
    return made


@pytest.mark.usefixtures("folder")
def test_it_behaves_as_the_others_do(app):
    runner = CliRunner()
    runner.invoke(app, ["new", "direct", "p"])
    runner.invoke(app, ["run", "p.toml", "--no-draw", "--set", "time.duration=1"])
    found = runner.invoke(app, ["count", "p.nc"])
    assert found.exit_code == 0, found.output
    assert found.stdout.startswith("samples")
    assert runner.invoke(app, ["count", "p.nc", "--quiet"]).stdout == ""
    told = json.loads(runner.invoke(app, ["count", "p.nc", "--json"]).stdout)
    assert (told["command"], "samples" in told["facts"]) == ("count", True)
    missing = runner.invoke(app, ["count", "q.nc"])
    assert missing.exit_code == 2
    assert "q.nc: expected a result file" in missing.stderr
    assert "Print the number of samples" in runner.invoke(app, ["count", "--help"]).stdout
