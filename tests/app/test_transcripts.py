"""Tests that pages show the current output of their commands (rules: `docs/transcript.py`)."""

from pathlib import Path
from runpy import run_path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
TRANSCRIPT = run_path(str(DOCS / "transcript.py"))
play, difference = TRANSCRIPT["play"], TRANSCRIPT["difference"]


@pytest.mark.slow
@pytest.mark.parametrize("page", ["tutorial.md", "errors.md"])
def test_a_page_prints_what_its_commands_print(page: str, tmp_path: Path) -> None:
    text = (DOCS / page).read_text()
    assert not difference(text, play(text, tmp_path))


def test_what_a_page_may_differ_in(tmp_path: Path) -> None:
    page = "```toml\n# a.txt\n1 m\n```\n```console\n$ cat a.txt\n$ false\n$ echo $?\n```\n"
    played = play(page, tmp_path)
    assert played == page.replace("a.txt\n$", "a.txt\n# a.txt\n1 m\n$").replace("?", "?\n1")
    assert "$ false" in difference(page, played)
    for a, b, alike in (
        ("x 1.000 m", "x  1.004 m", True),
        ("x 1.00 m", "x 1.02 m", False),
        ("x 1.00 m", "y 1.00 m", False),
        ("off by 3e-12", "off by -4e-9", True),
        ("597 steps, 0.2 s CPU", "600 steps, 0.3 s CPU", True),
    ):
        assert (not difference(a, b)) is alike
