"""Tests of file names: only regular files are read; every other name gives a clear error."""

import errno
import json
import os
import signal
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import slipfree as sf
from helpers.commands import invoke, refused, refuses
from helpers.fuzz_files import bases, document
from slipfree.files import netcdf
from slipfree.problem.verbs.base import DriveVerb
from slipfree.sweep import sweep_of
from slipfree.system import regular_files

LIMIT = 100  # time after which a command counts as hanging [s]
KINDS = {
    "pipe": "found a pipe, not a regular file; write the contents to a file first",
    "device": "found a device or a terminal, not a regular file",
    "loop": "found that it cannot be read (Too many levels of symbolic links)",
    "folder": "found a folder, not a regular file; check the name",
    "long": "found that it cannot be read (File name too long)",
    "home": "check the name: '~' is not replaced, write the folders in full with '/'",
}


@pytest.fixture(autouse=True)
def limited():
    """End a test that waits for a pipe."""

    def end(*_):
        pytest.fail(f"no answer within {LIMIT} s")

    before = signal.signal(signal.SIGALRM, end)
    signal.setitimer(signal.ITIMER_REAL, LIMIT)
    yield
    signal.setitimer(signal.ITIMER_REAL, 0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(autouse=True)
def folder(folder):
    (folder / "p.toml").write_text(document(bases("direct")[0]))
    return folder


def _spoiled(kind, ending):
    """Return the name of a file that cannot be read."""
    path = Path(f"bad{ending}")
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "loop":
        path.symlink_to(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "home":
        path = Path(f"~/bad{ending}")
    else:
        path = Path(f"{'n' * 5000}{ending}")
    return str(path)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    ("command", "ending"),
    [
        ("run", ".toml"),
        ("compare", ".toml"),
        ("sweep", ".toml"),
        ("vehicle", ".toml"),
        ("vehicle", ".urdf"),
        ("info", ".nc"),
        ("report", ".nc"),
        ("show", ".nc"),
        ("export", ".nc"),
        ("run p.toml --resume", ".nc"),
    ],
)
def test_a_file_on_the_command_line_that_is_none(command, ending, kind):
    more = {"export": ["--path", "o.csv"], "sweep": ["--vary", "time.duration=1,2"]}
    name = _spoiled(kind, ending)
    if "--resume" in command:
        Path("p.toml").write_text(document(bases("plan")[0]))
    told = refused(*command.split(), name, *more.get(command, []))
    assert KINDS[kind] in told
    assert name in told


@pytest.mark.slow
@pytest.mark.parametrize("kind", [*KINDS, "null"])
@pytest.mark.parametrize(
    ("table", "key", "ending"),
    [
        *(("terrain", "file", each) for each in (".npz", ".asc", ".tif", ".xyz")),
        *(("vehicle", "file", each) for each in (".toml", ".urdf")),
        ("terrain", "friction", ".asc"),
        ("driver", "file", ".csv"),
    ],
)
def test_a_file_named_in_a_problem_that_is_none(table, key, ending, kind):
    problem: dict[str, Any] = deepcopy(bases("direct")[0])
    name = "n\0" + ending if kind == "null" else _spoiled(kind, ending)
    if table == "driver":
        problem["driver"] = {"name": "follow", "speed": 0.2, "file": name}
        problem.pop("inputs", None)
    elif key == "friction":
        problem["terrain"] = {**problem["terrain"], "friction": name}
    else:
        problem[table] = {"file": name}
    Path("p.toml").write_text(document(problem))
    told = refused("check", "p.toml")
    assert KINDS.get(kind, "found that it cannot be read (embedded null") in told
    assert sweep_of(Path("p.toml"), ["time.duration=1,2"]).files.digests == {name: "missing"}


@pytest.mark.parametrize("kind", KINDS)
def test_a_urdf_named_in_a_vehicle_file_that_is_none(kind):
    Path("v.toml").write_text(f'urdf = "{_spoiled(kind, ".urdf")}"\n')
    told = refused("vehicle", "v.toml")
    assert "expected a URDF (urdf of v.toml), found" in told
    assert KINDS[kind] in told


@pytest.mark.slow
def test_an_output_whose_name_cannot_be_used(folder):
    invoke("run", "p.toml", "-o", "x.nc", "--no-draw", code=0)
    before = sorted(folder.iterdir())
    for words, ending in {
        "run p.toml --no-draw -o": ".nc",
        "run p.toml --no-draw --csv": ".csv",
        "run p.toml --figures": "",
        "export x.nc --path": ".csv",
        "export x.nc --rates": ".csv",
        "report x.nc -o": ".html",
        "show x.nc --html": ".html",
        "show x.nc --animation": ".gif",
        "new direct": ".toml",
        "examples paper_direct --to": "",
        "sweep p.toml --vary time.duration=0.1,0.2 -o": "",
    }.items():
        name = f"loop{ending}"
        Path(name).symlink_to(name)
        told = refused(*words.split(), name)
        assert "(Too many levels of symbolic links)" in told, words
        Path(name).unlink()
    assert sorted(folder.iterdir()) == before


def test_a_link_to_a_regular_file_is_followed():
    Path("link.toml").symlink_to("p.toml")
    assert invoke("check", "link.toml").exit_code == 0


def test_a_medium_that_fails_while_it_is_read(tmp_path, monkeypatch):
    def fail(*_, **__):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    for name in ("a.toml", "a.asc", "a.nc"):
        (tmp_path / name).write_text("")
    monkeypatch.setattr(Path, "open", fail)
    for read in (sf.load_problem, sf.read_map, netcdf.read):
        name = {sf.load_problem: "a.toml", sf.read_map: "a.asc"}.get(read, "a.nc")
        refuses(sf.DataError, r"cannot be read \(Input/output error\)", read, tmp_path / name)


@pytest.mark.slow
def test_names_that_are_not_utf_8_are_kept_as_text(monkeypatch):
    monkeypatch.setattr(DriveVerb, "figures", lambda *_: ())  # drawing takes long
    problem = {**bases("direct")[0], "terrain": {"file": "g.npz"}}
    problem.pop("title", None)
    place = Path(os.fsdecode(b"d\xfe"))
    place.mkdir()
    stem = os.fsdecode(b"n\xff")
    file, out = place / f"{stem}.toml", f"{stem}.nc"
    file.write_text(document(problem))
    x = np.linspace(-9, 9, 40)
    np.savez(place / "g.npz", x=x, y=x, z=np.zeros((40, 40)))
    page, table = f"{stem}.html", f"{stem}.csv"
    for words in (
        ("run", str(file), "-o", out, "--csv", table, "--no-draw"),
        ("info", out),
        ("report", out, "-o", page),
        ("show", out, "--html", page),
        ("export", out, "--path", table),
        ("sweep", str(file), "--vary", "time.duration=0.1,0.2", "--processes", "1", "--no-draw"),
    ):
        found = invoke(*words, "--json", code=0)
        json.loads(found.stdout)
    attributes = netcdf.read(out).attributes
    assert attributes["title"] == r"n\udcff"
    assert attributes["problem_file"] == r"n\udcff.toml"
    assert regular_files.unescape_name(attributes["problem_folder"]) == str(place)


@pytest.mark.parametrize("command", ["run", "sweep"])
def test_a_setting_that_is_not_utf_8_is_refused_before_anything_is_computed(command):
    setting = os.fsdecode(b"title=\xff")
    option = "--vary" if command == "sweep" else "--set"
    told = refused(command, "p.toml", option, setting)
    assert f"{option} title: expected text in UTF-8, as in a problem file, found title=" in told
