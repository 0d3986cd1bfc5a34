"""Tests that the sources have no import cycles, by the script that reports their structure."""

import runpy
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
TOP, LATE, TYPING = "at module level", "in functions", "under TYPE_CHECKING"
PLACES = {TOP, LATE, TYPING}


@pytest.fixture
def structure(tmp_path):
    """Return the script, and the import cycles that it finds among written modules."""
    script = runpy.run_path(str(ROOT / "benchmarks" / "structure.py"))

    def cycles(folder, places=PLACES):
        return script["find_cycles"](script["find_imports"](script["read_modules"](folder)), places)

    def written(places, **modules):
        package = tmp_path / "pack"
        package.mkdir()
        (package / "__init__.py").write_text("")
        for name, text in modules.items():
            (package / f"{name}.py").write_text(text)
        return cycles(tmp_path, places)

    return cycles, written


def test_sources_have_no_import_cycles(structure):
    cycles, _ = structure
    assert (ROOT / "src" / "slipfree" / "__init__.py").exists()
    assert cycles(ROOT / "src") == []


def test_imports_in_functions_and_for_type_checkers_are_told_apart(structure):
    _, written = structure
    late = "def late():\n    import pack.one"
    typed = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import pack.one"
    assert written({TOP}, one="import pack.two, pack.three", two=late, three=typed) == []
