"""Tests of the progress report without a terminal: a few lines on stderr."""

import re
import sys
from pathlib import Path

import pytest

from helpers.cases import PROBLEMS
from helpers.commands import invoke
from slipfree.cli import console

PLAN = ["run", str(PROBLEMS / "plan_rigid_hills.toml"), "-o", "p.nc", "--no-draw"]
PLAN += ["--set", "plan.intervals=8", "--set", "costs.slip=1e3", "--set", "time.step=0.5"]
DIRECT = ["run", str(PROBLEMS / "paper_direct.toml"), "-o", "p.nc", "--no-draw"]
DIRECT += ["--set", "time.duration=1.5"]
ITERATE = r"iteration \d+, constraints off by [\d.e+-]+( \(rising\))?, cost [\d.e+-]+, \d+ s"


@pytest.fixture(autouse=True)
def _folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("FIRST_LINE", "NEW_PHASE"):
        monkeypatch.setattr(console, name, 0.0)


@pytest.mark.slow
def test_a_line_when_a_phase_of_a_search_begins() -> None:
    result = invoke(*PLAN, code=0)
    lines = result.stderr.splitlines()
    assert re.fullmatch(f"without slip cost: {ITERATE}", lines[0])
    assert re.fullmatch(f"with slip cost: {ITERATE}", lines[1])
    phases = [line.partition(":")[0] for line in lines]
    assert len(phases) == len(set(phases))  # it took no ten seconds


def test_more_lines_of_a_phase_that_lasts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(console, "SAME_PHASE", 0.0)
    result = invoke(*DIRECT)
    lines = result.stderr.splitlines()
    found = [re.fullmatch(r"integrated to ([\d.e-]+) of 1.5 s", line) for line in lines]
    times = [float(each[1]) for each in found if each]
    assert all(line.startswith("checking the motion: ") for line in lines[len(times) :])
    assert len(times) > 5
    assert times == sorted(times)


def test_bars_can_be_read_on_every_background(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """They have the colour of the text: the cyan of some terminals is pale on white."""
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("TERM", "xterm-256color")
    with console.counted("figures") as show:
        show(1, 2)
    with console.reporting(2.0) as reports:
        reports.time(1.0)
    printed = capsys.readouterr().err
    assert {"figures", "solving"} <= {*re.findall("[a-z]+", printed)}
    assert {*re.findall(r"\x1b\[([\d;]*)m", printed)} <= {"", "0", "1", "2"}


@pytest.mark.slow
@pytest.mark.parametrize(("words", "option"), [(PLAN, "--quiet"), (DIRECT, "--json")])
def test_no_lines_where_they_are_not_wanted(words: list[str], option: str) -> None:
    assert invoke(*words, option).stderr == ""
