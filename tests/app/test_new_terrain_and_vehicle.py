"""Add a kind of terrain to problem files, and a vehicle to the catalogue.

`dunes` of ``docs/howto/extend.md`` is the file ``terrain/dunes.py`` (8 lines without docstrings and
imports), and ``"dunes": dunes`` the line of ``FEATURES`` in ``terrain/synthetic.py``: two files.
`tricycle` belongs in ``catalog/__init__.py``, as does its name in ``__all__``: one file. Problem
files, their errors, commands and the reference of keys take both without other changes. The record
of the keys is made at import, so that this file registers them in a process of its own.
"""

import subprocess
import sys
from pathlib import Path

import pytest

from helpers.cases import extension

PROBLEM = """\
verb = "direct"
vehicle = { catalog = "tricycle", wheelbase = 0.6 }
start = {}
inputs = { front_rate = 0.5, steer_rate = 0.0 }
time = { duration = 1.0, step = 0.5 }

[terrain.synthetic]
x = [-4, 4]
y = [-4, 4]
spacing = 0.25
dunes = { height = 0.5, length = 8.0 }
"""


REGISTER = """
import sys
from slipfree import catalog
from slipfree.terrain.synthetic import FEATURES
from dunes import dunes
from tricycle import tricycle
FEATURES["dunes"], catalog.tricycle = dunes, tricycle
catalog.__all__.append("tricycle")
from slipfree.cli import main
main()
"""


@pytest.mark.slow
def test_a_problem_file_may_ask_for_them(folder: Path) -> None:
    def called(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", REGISTER, *words]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    for name in ("dunes", "tricycle"):
        (folder / f"{name}.py").write_text(extension(name))
    (folder / "p.toml").write_text(PROBLEM)
    done = called("check", "p.toml")
    assert done.returncode == 0, done.stderr
    assert "ground height        -0.250 to 0.250 m" in done.stdout
    assert "wheelbase              0.6 m" in called("vehicle", "p.toml").stdout
    for key in ("terrain.synthetic.dunes.height", "vehicle.wheelbase"):
        done = called("check", "p.toml", "--set", f"{key}=-1")
        assert done.returncode == 2
        assert f"{key}: expected a number greater than 0" in done.stderr
