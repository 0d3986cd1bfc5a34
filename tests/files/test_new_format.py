"""Add a file format of maps: one function and one line of registration.

The function `read_json` below belongs in a new file ``files/maps/json_map.py``, and the
``MapReader`` of the test is a line of ``READERS`` in ``files/maps/elevation.py``: two files are
touched. Problem files, commands and error messages then take the format as they take the others.
"""

import json

import numpy as np
import pytest

from helpers.cases import PROBLEMS
from helpers.commands import printed, refuses, sets
from slipfree.core.errors import DataError
from slipfree.files.maps import elevation
from slipfree.files.maps.elevation import READERS, MapReader, read_map
from slipfree.terrain.grid_ops import Heights, axes_of, parts

PROBLEM = PROBLEMS / "paper_direct.toml"


def read_json(path, ask):
    """Return the map in a JSON file with the arrays x, y and z."""
    x, y, z = (np.array(json.loads(path.read_text())[name], dtype=float) for name in "xyz")
    i, j = parts(*axes_of(x, y), ask.window)
    return Heights(x[i], y[j], z[i, j], (("ground map", "JSON"),))


@pytest.fixture
def file(tmp_path, monkeypatch):
    monkeypatch.setattr(elevation, "READERS", (*READERS, MapReader((".json",), read_json)))
    x = np.linspace(-5, 5, 21)
    z = 0.1 * np.sin(x)[:, None] * np.cos(x)
    path = tmp_path / "map.json"
    path.write_text(json.dumps({"x": x.tolist(), "y": x.tolist(), "z": z.tolist()}))
    return path


def test_a_problem_drives_on_a_map_of_the_new_format(file, tmp_path):
    text = PROBLEM.read_text()
    begin, end = text.index("[terrain.synthetic]"), text.index("[vehicle]")
    problem = tmp_path / "p.toml"
    problem.write_text(f'{text[:begin]}[terrain]\nfile = "{file.name}"\n\n{text[end:]}')
    words = ("run", problem, "-o", tmp_path / "r.nc", "--no-draw", "-v", *sets("time.duration=0.2"))
    assert "JSON" in printed(*words)


def test_keys_of_other_formats_are_refused(file):
    assert read_map(file, window=(-1, 1, -1, 1)).grid.z.shape == (5, 5)
    refuses(DataError, r"no 'spacing' for a \.json file", read_map, file, spacing=0.1)


def test_the_endings_of_all_formats_are_named(file):
    refuses(DataError, r"\.pcd, \.json, or .* found '\.shp'", read_map, file.with_suffix(".shp"))
