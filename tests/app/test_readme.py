"""Tests of README: length, output of its examples, and existence of all names."""

import re
from pathlib import Path

import pytest
import typer

from helpers.commands import invoke
from slipfree.cli import app

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text()


def test_it_is_short():
    assert len(README.splitlines()) < 150


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_the_problem_file_runs():
    (text,) = re.findall(r"```toml\n(.*?)```", README, re.DOTALL)
    Path("drive.toml").write_text(text)
    invoke("run", "drive.toml", "--no-draw", code=0)
    assert Path("drive.nc").is_file()


def test_commands_it_names_exist():
    named = set(re.findall(r"`slipfree (\w+)", README)) | {"report", "show", "export"}
    assert named == set(typer.main.get_command(app).commands)


def test_links_lead_somewhere():
    links = re.findall(r"\]\(([\w/.-]+)\)", README)
    assert len(links) > 15
    for link in links:
        assert (ROOT / link).exists(), link
