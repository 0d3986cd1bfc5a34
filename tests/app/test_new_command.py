"""Add a command: one file, ``cli/count.py``, whose public functions are commands.

Its text is in ``docs/howto/extend.md`` (4 lines without docstring and imports). ``--quiet``,
``--json``, help and exit codes come with it.
"""

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from helpers.cases import extension
from slipfree import cli
from slipfree.cli.console import store_options, with_output_options


@pytest.fixture
def app(folder: Path, monkeypatch: pytest.MonkeyPatch) -> typer.Typer:
    """Return the command line as it is with one more file in its package."""
    (folder / "count.py").write_text(extension("count"))
    monkeypatch.setattr(cli, "__path__", [*cli.__path__, str(folder)])
    store_options(quiet=False, verbose=False, json=False)  # of another test
    made = typer.Typer(cls=cli.app.info.cls)
    for command in cli.commands():
        made.command()(with_output_options(command))
    return made


def test_it_behaves_as_the_others_do(app):
    assert len(app.registered_commands) == len(cli.app.registered_commands) + 1
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
