"""The cookbook: ten short recipes, and a script that needs no other imports than the page says.

The recipes are executed when the pages are built.
"""

import ast
import re
from pathlib import Path

import pytest

PAGE = (Path(__file__).parents[2] / "docs" / "howto" / "cookbook.md").read_text(encoding="utf-8")
CELL = r"```\{code-cell\} ipython3\n(.*?)```"
SCRIPT = re.findall(CELL, PAGE, re.DOTALL)[-1]


def test_ten_recipes_are_short():
    recipes = re.split(r"^## ", PAGE, flags=re.MULTILINE)[1:-1]
    assert [each.partition(".")[0] for each in recipes] == [str(k) for k in range(1, 11)]
    for each in recipes:
        (code,) = re.findall(CELL, each, re.DOTALL)
        assert len([line for line in code.splitlines() if line.strip()]) <= 15


@pytest.mark.slow
def test_the_script_of_the_page_runs(capsys):
    lines = [line for line in SCRIPT.splitlines() if line.strip()]
    assert len(lines) < 25
    imports = [n for n in ast.walk(ast.parse(SCRIPT)) if isinstance(n, ast.Import | ast.ImportFrom)]
    assert {alias.name for each in imports for alias in each.names} == {
        "casadi",
        "numpy",
        "slipfree",
    }
    names: dict = {}
    exec(SCRIPT, names)
    run, found = names["run"], names["found"]
    assert run.stop is None
    assert run["x"][-1] == pytest.approx(106.0, abs=0.02)
    assert found.accurate
    rolls = [abs(each["roll"]).max() for each in (run, found.replay)]
    assert rolls[1] < 0.7 * rolls[0]
    assert capsys.readouterr().out.count("\n") == 2
