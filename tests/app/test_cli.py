"""Tests of the command line: output, files and exit codes."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import slipfree
from helpers.problem_files import PROBLEM
from slipfree.cli import app
from slipfree.core.outcome import Outcome
from slipfree.core.trajectory import SolverError, Stop
from slipfree.files import netcdf


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "p.toml").write_text(PROBLEM, encoding="utf-8")
    return tmp_path


def _invoke(*words: str) -> Any:
    return CliRunner().invoke(app, list(words))


def _refused(*words: str) -> str:
    """Return what a command that must fail for bad input says on stderr."""
    result = _invoke(*words)
    assert result.exit_code == 2, result.output
    assert "Traceback" not in result.output
    return result.stderr


def _broken(name: str, monkeypatch: pytest.MonkeyPatch, raised: BaseException) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise raised

    monkeypatch.setattr(f"slipfree.problem.{name}", fail)


@pytest.mark.slow
def test_run_writes_the_result_and_draws(folder: Path) -> None:
    result = _invoke("run", "p.toml")
    assert result.exit_code == 0, result.output
    for words in (
        "ground height ",
        "three_wheeler: right 0.3 m driven",
        "path length ",
        "end position ",
        "a lower bound, not a prediction",
        "wheel front",
        "closure residual",
        "x the tolerance",
        "certificate  ",
        "; samples at most ",
        "steps, ",
        "outcome                complete\n",
        "wrote p.nc",
    ):
        assert words in result.stdout, words
    motion = netcdf.read("p.nc")
    assert motion.t[-1] == 0.5
    assert motion["y"][-1] == pytest.approx(0.5, abs=1e-6)
    assert motion.attributes["problem"] == PROBLEM
    assert list((folder / "p_figures").iterdir())


def test_leaving_the_map_saves_the_motion_to_the_edge(folder: Path) -> None:
    result = _invoke("run", "p.toml", "--no-draw", "--set", "time.duration=3")
    assert result.exit_code == 1
    title = "limit reached at t = 1.25 s (map_margin[front])"
    assert re.match(rf"outcome +{re.escape(title)}: wheel front leaves the map", result.stdout)
    assert result.stderr == f"{title}; p.nc contains the result so far\n"
    motion = netcdf.read(folder / "p.nc")
    assert motion.stop is not None
    assert motion.stop.name == "map_margin[front]"
    assert motion.stop.t == pytest.approx(1.25, abs=1e-5)
    assert motion.t[-1] == pytest.approx(1.25, abs=1e-5)


def test_a_failing_integrator_saves_what_was_reached(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _invoke("run", "p.toml", "--no-draw")
    reached = netcdf.read("p.nc").part(
        slice(3), Stop("solver", 0.2, "gave up", Outcome.SOLVER_FAILURE)
    )
    error = SolverError("gave up", replace(reached, attributes={}))
    _broken("verbs.base.simulate", monkeypatch, error)
    result = _invoke("run", "p.toml", "--no-draw", "-o", "q.nc")
    assert result.exit_code == 1
    assert re.match("outcome +solver failure at t = 0.2 s: gave up\n", result.stdout)
    assert result.stderr == "solver failure at t = 0.2 s; q.nc contains the result so far\n"
    found = netcdf.read(folder / "q.nc")
    assert found.t.size == 3
    assert found.attributes["title"] == "Überfahrt"


def test_a_failure_without_a_motion(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _broken("verbs.base.simulate", monkeypatch, SolverError("nothing at all"))
    result = _invoke("run", "p.toml", "--no-draw")
    assert (result.exit_code, result.stderr) == (1, "nothing at all\n")
    assert not (folder / "p.nc").exists()


@pytest.mark.usefixtures("folder")
def test_check() -> None:
    result = _invoke("check", "p.toml")
    assert result.exit_code == 0, result.output
    assert result.stdout.endswith("ok\n")
    assert "driver straight" in result.stdout
    assert "z 0.3" in result.stdout
    assert "clean: no other part of the ground near the wheels, relative" in result.stdout
    assert "a sample every" not in result.stdout  # there is but one
    assert re.search(r"^samples +6 to 0.5 s$", result.stdout, re.MULTILINE)


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_a_result_is_no_problem() -> None:
    _invoke("run", "p.toml", "--no-draw")
    for command in ("run", "check", "compare"):
        told = _refused(command, "p.nc")
        assert told.startswith("p.nc: expected a problem file, found a result; use slipfree info")


def test_info(folder: Path) -> None:
    _invoke("run", "p.toml", "--no-draw")
    result = _invoke("info", "p.nc")
    assert result.exit_code == 0, result.output
    for words in ("Überfahrt", f"slipfree version       {slipfree.__version__}", "slip_along "):
        assert words in result.stdout
    assert PROBLEM not in result.stdout
    assert _invoke("info", "p.nc", "--problem").stdout == PROBLEM
    bare = netcdf.read("p.nc")
    kept = {k: v for k, v in bare.attributes.items() if k != "problem"}
    netcdf.write(folder / "bare.nc", replace(bare, attributes=kept))
    assert "bare.nc: expected a result with its problem file" in _refused(
        "info", "bare.nc", "--problem"
    )


@pytest.mark.usefixtures("folder")
def test_bad_problems() -> None:
    settings = ["--set", "time.step=0", "--set", "solver.tol=1"]
    assert _refused("run", "p.toml", *settings).splitlines() == [
        "--set time.step: expected a number greater than 0, found 0",
        "--set solver.tol: expected one of tolerance, compiled, found the unknown key 'tol'",
    ]
    assert "--set bad: expected key=value" in _refused("check", "p.toml", "--set", "bad")


def test_places_are_checked_before_anything_is_computed(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _broken("result.build", monkeypatch, AssertionError("must not be reached"))
    assert "no/a.nc: expected a folder no" in _refused("run", "p.toml", "-o", "no/a.nc")
    assert "expected a folder no" in _refused("run", "p.toml", "--csv", "no/a.csv")
    assert "expected the name of a file" in _refused("run", "p.toml", "-o", str(folder))
    assert "p.toml: expected a folder, found a file" in _refused(
        "run", "p.toml", "--figures", "p.toml"
    )
    monkeypatch.setattr(os, "access", lambda path, _: Path(path).suffix == ".toml")
    assert "that may be written to" in _refused("run", "p.toml")


def test_help_needs_no_heavy_imports() -> None:
    code = (
        "import sys, slipfree\n"
        "heavy = {'numpy', 'pydantic', 'typer', 'rich', 'matplotlib', 'scipy'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
        "from slipfree.cli import main\n"
        "sys.argv = ['slipfree', '--help']\n"
        "try:\n    main()\n"
        "except SystemExit as end:\n    assert end.code in (0, None)\n"
        "heavy -= {'typer', 'rich'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


OPTIONAL = {"trimesh", "xacro", "laspy", "lazrs", "mcap", "mcap_ros2", "rosbags", "yourdfpy"}
OPTIONAL |= {"pyproj", "rasterio", "viser", "distributed", "xarray", "pandas"}


@pytest.mark.slow
def test_optional_libraries_are_imported_only_when_used(folder: Path) -> None:
    """A motion on a ground without reference system needs none of them."""
    lines = "--version", "run p.toml --no-draw --set time.duration=0.2", "info p.nc"
    code = (
        "import sys, slipfree\n"
        "from slipfree.cli import main\n"
        f"for line in {lines}:\n"
        "    sys.argv = ['slipfree', *line.split()]\n"
        "    try:\n        main()\n"
        "    except SystemExit as end:\n        assert end.code in (0, None)\n"
        f"    assert not {OPTIONAL} & set(sys.modules), (line, {OPTIONAL} & set(sys.modules))\n"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False
    )
    assert found.returncode == 0, found.stderr


@pytest.mark.slow
def test_as_a_module(folder: Path) -> None:
    def call(*words: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-m", "slipfree", *words]
        return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)

    assert call("--version").stdout == f"slipfree {slipfree.__version__}\n"
    result = call("run", "p.toml", "--no-draw", "-q", "--set", "time.duration=3")
    assert result.returncode == 1
    assert "\x1b" not in result.stdout + result.stderr
    assert len(result.stderr.splitlines()) == 1
    assert call("run", "p.toml", "--set", "verb=plan").returncode == 2


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_formulations_agree_at_the_shell() -> None:
    result = _invoke("run", "p.toml", "--no-draw", "--cross-check", "--set", "time.duration=0.5")
    assert result.exit_code == 0
    assert "largest differences from formulation = 'montana'" in result.stdout
    montana = _invoke(
        "run", "p.toml", "--no-draw", "--set", "formulation=montana", "--set", "time.duration=0.5"
    )
    assert montana.exit_code == 0
    assert "drift of the assembly" in montana.stdout


@pytest.mark.slow
def test_path_from_a_file(folder: Path) -> None:
    law = ["--set", 'driver={name="follow", speed=0.2, file="way.csv"}']
    (folder / "way.csv").write_text("x,y\n0.0,0.0\n0.0,1.0\n")
    result = _invoke("check", "p.toml", *law)
    assert result.exit_code == 0, result.stderr
    (folder / "way.csv").write_text("x,y\n0.0,0.0\n0.0;1.0\n")
    result = _invoke("check", "p.toml", *law)
    assert result.exit_code == 2
    assert "way.csv:3: expected two numbers x,y, found '0.0;1.0'" in result.stderr
    for wrong, words in (
        ('driver={name="follow", speed=0.2}', "driver: name = 'follow' requires either 'path'"),
        ('driver={name="follow", speed=0.2, file="no.csv"}', "found that it cannot be read"),
        (
            'driver={name="straight", speed=0.2, file="way.csv"}',
            "expected no path with name = 'straight'",
        ),
    ):
        result = _invoke("check", "p.toml", "--set", wrong)
        assert result.exit_code == 2
        assert words in result.stderr


@pytest.mark.parametrize(
    ("places", "words"),
    [
        (["-o", "p.toml"], "p.toml: expected a separate file, found the input p.toml"),
        (["-o", "a.nc", "--csv", "a.nc"], "a.nc: expected a separate file, found another output"),
    ],
)
def test_outputs_do_not_replace_inputs(folder: Path, places: list[str], words: str) -> None:
    before = (folder / "p.toml").read_text()
    result = _invoke("run", "p.toml", *places)
    assert result.exit_code == 2
    assert words in result.stderr
    assert (folder / "p.toml").read_text() == before
