"""Tests of ``slipfree migrate``: files of version 0.1 with current keys, and refused files."""

from __future__ import annotations

import json
import os
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from slipfree.cli import app
from slipfree.files.toml.source import ProblemError
from slipfree.problem.load import load_problem
from slipfree.problem.migrate import migrate_text
from slipfree.problem.old_keys import upgrade_keys

ROOT = Path(__file__).parents[2]
OLD = """\
# A problem of version 0.1.
verb   = "direct"
slip   = 'traction'     # friction decides

terrain.sample = "jacksboro"

[vehicle]
catalog = "three_wheeler"       # of the catalogue

# How much wheels creep.
[traction]   # regularised
creep = 1e-3    # [m/s]

[start]
x = 0.0

[inputs]
right_rate = 0.5
left_rate  = 0.5
steer_rate = 0.0

[time]
duration = 1
step = 0.5
"""
NEW = (
    OLD.replace("slip   = 'traction' ", 'model = "quasi-static" ')
    .replace("model =", "model   =")
    .replace("[traction]", "[law.coulomb]")
)


@pytest.fixture(autouse=True)
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("p.toml").write_text(OLD)
    return Path("p.toml")


def _called(*words: str, code: int = 0) -> str:
    result = CliRunner().invoke(app, ["migrate", *words])
    assert result.exit_code == code, result.output
    return result.output


def test_a_file_is_rewritten_in_place_and_the_old_one_kept(file: Path) -> None:
    file.chmod(0o640)
    with pytest.raises(ProblemError, match=r"; rewrite the file: slipfree migrate p\.toml"):
        load_problem(file)
    output = _called("p.toml")
    assert "p.toml:3: slip: slip = 'traction' is now model = 'quasi-static'" in output
    assert "p.toml:11: traction: [traction] is now [law.coulomb] with model = 'quasi-st" in output
    assert "wrote p.toml; the old file is p.toml.bak" in output
    assert file.read_text() == NEW
    assert Path("p.toml.bak").read_text() == OLD
    if os.name == "posix":
        assert file.stat().st_mode & 0o777 == 0o640
    spec = load_problem(file).spec
    assert (spec.model, spec.law.coulomb.creep) == ("quasi-static", 1e-3)
    assert "p.toml: nothing to change" in _called("p.toml")


def test_another_file_is_written(file: Path) -> None:
    found = json.loads(_called("p.toml", "-o", "n.toml", "--json"))
    assert len(found["changes"]) == 2
    assert found["files"] == ["n.toml"]
    assert (file.read_text(), Path("n.toml").read_text()) == (OLD, NEW)
    assert not Path("p.toml.bak").exists()


@pytest.mark.parametrize(
    "text",
    [
        OLD.replace("\n", "\r\n"),
        OLD.replace("[traction]   # regularised\n", "").replace("creep =", "# ").replace("'", '"'),
        'verb = "plan"\nslip="traction"\ntraction = { creep = 1e-3 } # inline\n[time]\nstep = 1\n',
        'verb = "plan"\ntraction.creep = 1e-3 # dotted\ntraction.reserve = 0.1\n',
        '[time]\nstep = 1\n  ["traction"]\n  creep = 1\n[x]\n[traction.y]\nz = 1\n'.replace(
            "[traction.y]", "[x.y]"
        )
        + '[[keep_out]]\nx = 1\n\n[vehicle]\n"a b" = 1\n',
    ],
)
def test_layouts(text: str) -> None:
    if "verb" not in text:
        text = 'verb = "direct"\n' + text
    found = migrate_text(Path("p.toml"), text).text
    assert tomllib.loads(found) == upgrade_keys(tomllib.loads(text))[0]
    kept = [line for line in text.split("\n") if "traction" not in line]
    assert [line for line in found.split("\n") if line in kept] == kept
    assert found.count("#") == text.count("#")
    assert migrate_text(Path("p.toml"), found) == (found, (), "")


def test_a_file_of_today_is_not_changed() -> None:
    files = [*(ROOT / "problems").rglob("*.toml"), *(ROOT / "src/slipfree/starters").glob("*.toml")]
    assert len(files) > 10
    for path in files:
        text = path.read_text(encoding="utf-8")
        assert migrate_text(path, text)[:2] == (text, ()), path


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("verb = ", "p.toml:1: expected TOML, found an error"),
        ("x = 1", "p.toml: expected a problem file, with the key 'verb', or a vehicle file"),
        (
            OLD + "\n[law.coulomb]\ncreep = 1\n",
            "p.toml:11: traction: expected either [traction] or 'law', found both; keep one of",
        ),
        (
            OLD.replace("verb ", 'model = "kinematics"\nverb '),
            "p.toml:4: slip: expected either slip = 'traction' or 'model', found both",
        ),
    ],
)
def test_other_files_are_refused(file: Path, text: str, words: str) -> None:
    file.write_text(text)
    assert words in _called("p.toml", code=2)
    assert file.read_text() == text
    assert not Path("p.toml.bak").exists()


def test_no_file_is_replaced(file: Path) -> None:
    Path("p.toml.bak").write_text("mine")
    assert "p.toml.bak: expected a new file, found an existing one; " in _called("p.toml", code=2)
    assert "p.toml.bak: expected a new file" in _called("p.toml", "-o", "p.toml.bak", code=2)
    assert "expected a file other than FILE" in _called("p.toml", "-o", "./p.toml", code=2)
    assert "no/n.toml: expected a folder no to write to" in _called(
        "p.toml", "-o", "no/n.toml", code=2
    )
    assert "missing.toml" in _called("missing.toml", code=2)
    assert (file.read_text(), Path("p.toml.bak").read_text()) == (OLD, "mine")


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ("[start]\nx = 1.0\n", "the start now faces +x"),
        ("[start]\nheading = 1.0\n[limits]\nheading = [0, 1]\n", "limits.heading is now measured"),
        ("[start]\nheading = 1.0\n", ""),
    ],
)
def test_headings_that_mean_something_else_now_are_noted(lines: str, words: str) -> None:
    found = migrate_text(Path("p.toml"), f'verb = "direct"\nframe = "rep103"\n{lines}')
    assert found.changes == ()
    assert bool(words) == bool(found.note)
    assert words in found.note
    assert not words or found.note.startswith("p.toml:2: ")
