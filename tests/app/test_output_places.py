"""Tests of output paths in problem files: no other file of the user is overwritten."""

from pathlib import Path
from typing import Any

import pytest

from helpers.commands import invoke, refused
from helpers.problem_files import FIT, PROBLEM
from slipfree.files import netcdf

LINE = PROBLEM.count("\n") + 2  # of the key in _problem
OUTSIDE = "expected a path in the working folder or in the problem's folder, found "


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the working folder, with another folder of the user beside it."""
    work = tmp_path / "work"
    work.mkdir()
    (tmp_path / "victim.txt").write_text("precious")
    monkeypatch.chdir(work)
    return work


def _problem(file: str, name: str = "p.toml") -> str:
    Path(name).write_text(f"{PROBLEM}[output]\nfile = '{file}'\n", encoding="utf-8")
    return name


def _run(*words: str, code: int | None = None) -> Any:
    return invoke("run", *words, "--set", "time.duration=0.1", code=code)


def _refused(monkeypatch: pytest.MonkeyPatch, *words: str) -> str:
    """Return the error of a run that must be refused before anything is computed."""

    def fail(*_: Any) -> None:
        raise AssertionError("computed")

    with monkeypatch.context() as patch:
        patch.setattr("slipfree.problem.result.run_problem", fail)
        done = _run(*words, code=2)
    return str(done.stderr)


@pytest.mark.parametrize("name", ["{}/victim.nc", "in/../../victim.nc"])
def test_a_problem_names_no_result_outside(folder, monkeypatch, name):
    name = name.format(folder.parent)
    told = _refused(monkeypatch, _problem(name), "--no-draw")
    assert told.startswith(f"p.toml:{LINE}: output.file: {OUTSIDE}{name}")
    assert told.endswith(f"; choose another name, or give it on the command line: -o {name}\n")
    assert {path.name for path in folder.parent.iterdir()} == {"work", "victim.txt"}


@pytest.mark.parametrize("link", ["file", "folder", "figures", "figure"])
def test_links_lead_nowhere_else(folder, monkeypatch, link):
    other = folder.parent / "other"
    other.mkdir()
    name, where, target = {
        "file": ("r.nc", "r.nc", other / "r.nc"),
        "folder": ("in/r.nc", "in", other),
        "figures": ("r.nc", "r_figures", other),
        "figure": ("r.nc", "r_figures/map.png", other / "map.png"),
    }[link]
    Path(where).parent.mkdir(exist_ok=True)
    Path(where).symlink_to(target)
    told = _refused(monkeypatch, _problem(name))
    assert f"p.toml:{LINE}: output.file: {OUTSIDE}{where}" in told
    assert f", which is {target}" in told
    assert list(other.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("named", "content"), [(True, "precious"), (True, ""), (False, "CDF\2 of something else")]
)
def test_what_is_no_result_is_kept(monkeypatch, named, content):
    words = [_problem("p.nc"), "--no-draw", *([] if named else ["--set", "output="])]
    Path("p.nc").write_text(content)
    told = _refused(monkeypatch, *words)
    place = f"p.toml:{LINE}: output.file" if named else "p.toml"
    assert told == (
        f"{place}: expected a new file or a result of an earlier run, found the file p.nc, which "
        "is neither; choose another name, or give it on the command line: -o p.nc\n"
    )
    assert Path("p.nc").read_text() == content
    assert _run(*words, "-o", "p.nc").exit_code == 0
    assert _run(*words).exit_code == 0  # which replaces a result


@pytest.mark.slow
def test_what_is_no_figure_is_kept(monkeypatch):
    monkeypatch.setattr(  # drawn elsewhere
        "matplotlib.figure.Figure.savefig", lambda _, file, **__: Path(file).write_bytes(b"\x89PNG")
    )
    for path in ("r_figures", "other"):
        Path(path).mkdir()
        Path(path, "map.png").write_text("precious")
    told = _refused(monkeypatch, _problem("r.nc"))
    assert "found the file r_figures/map.png, which is neither" in told
    assert "; choose another folder: --figures DIR" in told
    assert Path("r_figures/map.png").read_text() == "precious"
    assert _run("p.toml", "--figures", "other").exit_code == 0
    Path("r_figures/map.png").unlink()
    for _ in range(2):  # the second replaces figures
        assert _run("p.toml").exit_code == 0


@pytest.mark.parametrize(
    "option", ["--set output.file='{}'", "--set output={{file='{}'}}", "-o {}"]
)
def test_the_command_line_names_a_result_anywhere(folder, option):
    out = folder.parent / "r.nc"
    _run(_problem("/nowhere/r.nc"), "--no-draw", *option.format(out).split(), code=0)
    assert netcdf.attributes_of(out)


def test_a_result_beside_the_problem(folder):
    beside = folder.parent / "beside"
    beside.mkdir()
    Path("link").symlink_to(beside)
    _problem(str(beside / "r.nc"), "link/p.toml")
    _run("link/p.toml", "--no-draw", code=0)
    assert [path.name for path in folder.iterdir()] == ["link"]
    assert {path.name for path in beside.iterdir()} == {"p.toml", "r.nc"}


@pytest.mark.parametrize("name", ['"a\\u0000.nc"', f'"{"a" * 5000}.nc"', f'"{"a" * 250}.nc"'])
def test_names_that_cannot_be_used(monkeypatch, name):
    Path("p.toml").write_text(f"{PROBLEM}[output]\nfile = {name}\n", encoding="utf-8")
    assert "expected the name of a file or folder to write" in _refused(monkeypatch, "p.toml")


def test_a_problem_names_results_by_their_ending(monkeypatch):
    told = _refused(monkeypatch, _problem(".zshrc"), "--no-draw")
    assert f"p.toml:{LINE}: output.file: expected a name that ends in .nc, found .zshrc; " in told
    assert told.endswith("use .zshrc.nc\n")


WHEEL = """
wheel = { radius = 0.09, width = 0.11, load = 64.0 }
soil = { name = "lunar" }
test = { points = 2, measured = "x.csv" }
"""
ROBOT = """
verb = "direct"
terrain = { file = "map.asc" }
vehicle = { file = "robot.urdf" }
start = {}
driver = { name = "straight", speed = 0.2 }
time = { duration = 0.1, step = 0.1 }
"""
URDF = """<robot name="r"><link name="a"><visual><geometry>
<mesh filename="package://r/meshes/wheel.stl"/></geometry></visual></link></robot>"""


def test_a_table_does_not_replace_the_input_of_the_same_name():
    points = "slip,slip_angle,pull\n0.2,0,1\n"
    Path("x.csv").write_text(points)
    Path("x.toml").write_text(WHEEL)
    assert "wrote x_wheel.csv" in invoke("wheel", "x.toml", "--no-draw", code=0).stdout
    Path("hard.csv").hardlink_to("x.csv")
    Path("soft.csv").symlink_to("x.csv")
    for name in ("x.csv", "hard.csv", "soft.csv", "x.toml"):
        assert f"{name}: expected a separate" in refused("wheel", "x.toml", "-o", name)
    assert ".: expected the name of a file to write" in refused("wheel", "x.toml", "-o", ".")
    assert Path("x.csv").read_text() == points


@pytest.mark.parametrize(
    ("words", "file"),
    [
        (["fit", "x.toml", "-o", "x.csv"], "x.csv"),
        (["run", "r.toml", "-o", "r.toml"], "r.toml"),
        (["fit", "x.toml", "-o", "a.csv", "--write", "x.csv", "--force"], "x.csv"),
        (["run", "r.toml", "-o", "map.asc"], "map.asc"),
        (["run", "r.toml", "--csv", "map.prj"], "map.prj"),
        (["run", "r.toml", "--csv", "meshes/wheel.stl"], "meshes/wheel.stl"),
        (["run", "r.toml", "--resume", "old.nc", "--csv", "old.nc"], "old.nc"),
        (["sweep", "s.toml", "--vary", "driver.speed=1,2", "-o", "sw"], "sw/table.csv"),
        (["vehicle", "robot.urdf", "--write", "robot.urdf", "--force"], "robot.urdf"),
        (["export", "old.nc", "--path", "old.nc"], "old.nc"),
        (["report", "old.nc", "-o", "old.nc"], "old.nc"),
        (["track", "old.nc", "-o", "old.nc"], "old.nc"),
        (["show", "old.nc", "--animation", "old.nc"], "old.nc"),
    ],
)
def test_no_command_replaces_a_file_that_it_reads(words, file):
    for name in ("meshes", "sw"):
        Path(name).mkdir()
    sweep = ROBOT.replace("map.asc", "sw/table.csv")
    texts = {"x.toml": FIT, "r.toml": ROBOT, "s.toml": sweep, "robot.urdf": URDF}
    names = "x.csv", "map.asc", "map.prj", "meshes/wheel.stl", "old.nc", "sw/table.csv"
    texts |= dict.fromkeys(names, "precious")
    for name, text in texts.items():
        Path(name).write_text(text)
    assert f"{file}: expected a separate file, found the input {file}" in refused(*words)
    twice = refused("run", "r.toml", "-o", "a.nc", "--csv", "a.nc")
    assert "a.nc: expected a separate file, found another output" in twice
    assert {name: Path(name).read_text() for name in texts} == texts
