"""Starters: each alternative in their comments is accepted literally."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from slipfree.cli import app

ROOT = Path(__file__).parents[2]
STARTERS = ROOT / "src" / "slipfree" / "starters"
MAP = "terrain.synthetic=", "terrain.file=map.npz"
TIMES = "[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]"
RATES = "left_rate=0.4, steer_rate=0.1"
WAYS = {  # kind and beginning of a comment: settings of each alternative that it describes
    ("direct", "of both tables"): [MAP],
    ("atlas", "of both tables"): [MAP],
    ("atlas", "another vehicle of the catalogue"): [
        ('vehicle={catalog="rocky7"}',),
        ('vehicle={file="vehicle.toml"}',),
    ],
    ("direct", "another vehicle of the catalogue"): [
        ('vehicle={catalog="rocky7"}',),
        ('vehicle={file="vehicle.toml"}',),
    ],
    ("direct", "[inputs]"): [
        ("driver=", f"inputs={{right_rate=0.4, {RATES}}}"),
        ("driver=", f"inputs={{right_rate=[[0.0, 0.4], [2.0, 0.3]], {RATES}}}"),
    ],
    ("inverse", "of both tables"): [MAP],
    ("inverse", "[path]"): [
        (
            "given=",
            f"path={{t={TIMES}, x=[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], y={TIMES}, "
            "heading=[NORTH, NORTH, NORTH, NORTH, NORTH, NORTH]}".replace("NORTH", repr(np.pi / 2)),
            "time.duration=5",
        ),
        ("given=", 'path={file="path.csv"}', "time.duration=5"),
    ],
    ("plan", "of both tables"): [MAP],
    ("plan", "[driver]"): [('driver={name="route", speed=0.2}',)],
}


def comments() -> list[tuple[str, str]]:
    """Return the kinds of the starters, and the alternatives in their comments."""
    pattern = re.compile(r"^# Instead:? (.*)", re.MULTILINE)
    files = sorted(STARTERS.glob("*.toml"))
    return [(file.stem, words) for file in files for words in pattern.findall(file.read_text())]


@pytest.fixture
def folder(folder):
    axis = np.linspace(-5.0, 8.0, 27)
    np.savez("map.npz", x=axis, y=axis, z=0.05 * np.sin(axis)[:, None] * np.cos(axis))
    Path("vehicle.toml").write_text((ROOT / "problems" / "vehicles" / "trailer.toml").read_text())
    rows = "".join(f"{t},0.0,{0.2 * t},{np.pi / 2}\n" for t in range(6))
    Path("path.csv").write_text(f"t,x,y,heading\n{rows}")
    floor, step = "1,-5,-1\n1,5,-1\n1,5,0\n1,-5,0\n", "2,0,0\n2,4,0\n2,4,0.06\n2,0,0.06\n"
    Path("solids.csv").write_text(f"solid,x,z\n{floor}{step}")
    return folder


def test_every_other_way_is_tried() -> None:
    found = comments()
    for kind, words in found:
        assert [key for key in WAYS if key[0] == kind and words.startswith(key[1])], words
    assert len(found) == len(WAYS)


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("key", WAYS)
def test_a_starter_goes_the_other_way(key: tuple[str, str]) -> None:
    kind, beginning = key
    (words,) = (text for name, text in comments() if name == kind and text.startswith(beginning))
    runner = CliRunner()
    assert runner.invoke(app, ["new", kind, "mine"]).exit_code == 0
    for settings in WAYS[key]:
        if name := re.search(r'name = "(\w+)"', words):
            assert name[1] in " ".join(settings)
        options = [part for each in settings for part in ("--set", each)]
        result = runner.invoke(app, ["check", "mine.toml", *options])
        assert (result.exit_code, result.stdout[-3:]) == (0, "ok\n"), (settings, result.output)
