"""Add a kind of terrain to problem files: one file and one line of registration.

`dunes` is the file ``terrain/dunes.py`` (8 lines without docstrings and imports), and
``"dunes": dunes`` the line of ``FEATURES`` in ``terrain/synthetic.py``: two files. Problem
files, their errors, commands and the reference of keys take the table ``[terrain.synthetic.dunes]``
without other changes. The record of the keys is made at import, so that this file registers its
feature in a process of its own.
"""

import subprocess
import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import pytest
from annotated_types import doc

from slipfree.core.schema import Length
from slipfree.terrain.base import Grid


def dunes(
    grid: Grid,
    *,
    height: Annotated[Length, doc("from trough to crest")],
    length: Annotated[Length, doc("from crest to crest")],
) -> Grid:
    """Return the grid with dunes along x added."""
    wave = np.cos(2 * np.pi * grid.y / length)
    return Grid(grid.x, grid.y, grid.z + height / 2 * wave)


PROBLEM = """\
verb = "direct"
vehicle = { catalog = "three_wheeler" }
start = {}
inputs = { right_rate = 0.5, left_rate = 0.5, steer_rate = 0.0 }
time = { duration = 1.0, step = 0.5 }

[terrain.synthetic]
x = [-4, 4]
y = [-4, 4]
spacing = 0.25
dunes = { height = 0.5, length = 8.0 }
"""


def called(*words: str) -> subprocess.CompletedProcess[str]:
    """Run ``slipfree`` with the feature registered."""
    code = (
        f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); "
        "import test_new_terrain_kind as new; from slipfree.terrain.synthetic import FEATURES; "
        "FEATURES['dunes'] = new.dunes; from slipfree.cli import main; main()"
    )
    return subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, check=False
    )


@pytest.mark.slow
def test_a_problem_file_may_ask_for_it(tmp_path: Path) -> None:
    file = tmp_path / "dunes.toml"
    file.write_text(PROBLEM)
    done = called("check", str(file))
    assert done.returncode == 0, done.stderr
    assert "ground height        -0.250 to 0.250 m" in done.stdout
    done = called("check", str(file), "--set", "terrain.synthetic.dunes.height=-1")
    assert done.returncode == 2
    assert "terrain.synthetic.dunes.height: expected a number greater than 0" in done.stderr
