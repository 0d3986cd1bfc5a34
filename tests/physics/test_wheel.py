"""Tests of the wheel file of the package: contents, and use without the sources."""

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from zipfile import ZipFile

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = ("src", "problems", "pyproject.toml", "README.md", "LICENSE")


def _done(command: list[str], folder: Path, **more: str) -> str:
    """Return what a program prints that must succeed."""
    found = subprocess.run(
        command, cwd=folder, env=os.environ | more, capture_output=True, text=True, check=False
    )
    assert found.returncode == 0, found.stdout + found.stderr
    return found.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from a copy of the sources, without network."""
    copy = tmp_path_factory.mktemp("sources")
    skipped = shutil.ignore_patterns("__pycache__", "*.egg-info")
    for name in SOURCES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=skipped)
        else:
            shutil.copy(ROOT / name, copy)
    build = "from setuptools.build_meta import build_wheel; build_wheel('dist')"  # as pip calls it
    _done([sys.executable, "-c", build], copy)
    (found,) = (copy / "dist").glob("*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, str]:
    """Install the wheel in a folder of its own; return what makes Python take it from there."""
    target = tmp_path_factory.mktemp("target")
    options = ["--quiet", "--no-deps", "--no-index", "--no-compile", "--target", str(target)]
    _done([sys.executable, "-m", "pip", "install", *options, str(wheel)], target)
    return {"PYTHONPATH": str(target)}


def _files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*.*")}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("packed", "folder"),
    [
        ("slipfree/problems/", ROOT / "problems"),
        ("slipfree/starters/", ROOT / "src" / "slipfree" / "starters"),
    ],
)
def test_it_holds_the_problems_as_they_are(wheel: Path, packed: str, folder: Path) -> None:
    with ZipFile(wheel) as file:
        held = {
            name.removeprefix(packed): file.read(name)
            for name in file.namelist()
            if name.startswith(packed)
        }
    assert held == _files(folder)
    assert held


def test_it_holds_the_modules_and_nothing_else(wheel: Path) -> None:
    with ZipFile(wheel) as file:
        names = {name for name in file.namelist() if name.endswith(".py")}
    sources = ROOT / "src"
    assert names == {path.relative_to(sources).as_posix() for path in sources.rglob("*.py")}


@pytest.mark.slow
def test_installed_it_lists_copies_and_runs(installed: Mapping[str, str], tmp_path: Path) -> None:
    command = [sys.executable, "-m", "slipfree"]
    where = _done(
        [sys.executable, "-c", "import slipfree; print(slipfree.__file__)"], tmp_path, **installed
    )
    assert where.startswith(installed["PYTHONPATH"])
    listed = _done([*command, "examples"], tmp_path, **installed)
    for name in filter(lambda each: each.endswith(".toml"), _files(ROOT / "problems")):
        assert f"\n{name.removesuffix('.toml')} " in f"\n{listed}"
    _done([*command, "examples", "your_vehicle"], tmp_path, **installed)
    settings = ["--set", "time.duration=1", "--no-draw"]
    _done([*command, "run", "your_vehicle.toml", *settings], tmp_path, **installed)
    assert (tmp_path / "your_vehicle.nc").is_file()
    _done([*command, "new", "direct", "mine"], tmp_path, **installed)
    assert _done([*command, "check", "mine.toml"], tmp_path, **installed).endswith("ok\n")
