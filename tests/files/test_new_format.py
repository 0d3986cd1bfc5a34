"""Add a file format of maps: one file, ``files/maps/json_map.py``.

Its text is in ``docs/howto/extend.md`` (5 lines without docstring and imports). Problem files,
commands and error messages then take the format as they take the others.
"""

import json

import numpy as np
import pytest

from helpers.cases import PROBLEMS, extension
from helpers.commands import printed, refuses, sets
from slipfree.core.errors import DataError
from slipfree.files import maps
from slipfree.files.maps.elevation import read_map

PROBLEM = PROBLEMS / "paper_direct.toml"


@pytest.fixture
def file(tmp_path, monkeypatch):
    (tmp_path / "json_map.py").write_text(extension("read_json"))
    monkeypatch.setattr(maps, "__path__", [*maps.__path__, str(tmp_path)])
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
