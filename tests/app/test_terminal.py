"""Tests that text from files reaches the terminal without control characters."""

import json
import os
import re
import subprocess
import sys
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from helpers.fuzz_files import bases, document
from slipfree.cli import app, console
from slipfree.files import netcdf

NASTY = "\x1b]0;owned\x07\x9b31m\rback\b\x7f\u202eabc\u2066\u200f\x85\u2028"
SHOWN = (
    r"\x1b]0;owned\x07\x9b31m\rback\x08\x7f\u202eabc\u2066\u200f\x85\u2028"  # what NASTY becomes
)
RAW = re.compile(
    "[\\0-\\x08\\x0b-\\x1f\\x7f-\\x9f\\u061c\\u200e\\u200f\\u2028-\\u202e\\u2066-\\u2069]"
)


pytestmark = pytest.mark.usefixtures("folder")


def _problem(name: str = "p.toml", **more: Any) -> str:
    problem: dict[str, Any] = deepcopy(bases("direct")[0]) | more
    text = document(problem).replace("\x7f", r"\u007f")  # which TOML demands
    Path(name).write_text(text, encoding="utf-8")
    return name


def _output(*words: str, code: int) -> str:
    """Return what a command prints, which must be free of control characters."""
    found = CliRunner().invoke(app, list(words))
    assert found.exit_code == code, (found.output, found.exception)
    assert not RAW.search(found.output), found.output
    return found.output


def test_what_is_escaped_and_what_stays() -> None:
    assert console.visible(NASTY) == SHOWN
    assert not RAW.search(console.visible("".join(map(chr, range(0x3000)))).replace("\r\n", ""))
    for text in (
        "Überfahrt\n\tüber 3°, 10 µm\r\n",
        "\u4e2d\u6587 \U0001f600",
        "\u06cc\u200c\u062e \u0915\u094d\u200d",
    ):
        assert console.visible(text) == text
    assert console.visible("\ud800 n\udcff") == r"\ud800 n\udcff"


def test_keys_values_and_names_of_problems() -> None:
    assert SHOWN in _output("check", _problem(**{NASTY: 1}), code=2)
    assert SHOWN in _output("check", _problem(verb=NASTY), code=2).replace("\\\\", "\\")
    shown = _output("check", _problem(terrain={"file": f"{NASTY.replace('/', '')}.asc"}), code=2)
    assert SHOWN in shown
    assert SHOWN in _output("check", f"{NASTY}.toml", code=2)
    assert SHOWN in _output("check", _problem(), "--set", f"{NASTY}=1", code=2)


@pytest.mark.parametrize("words", [(f"--{NASTY}",), (NASTY,), ("new", NASTY, "x")])
def test_words_on_the_command_line(words: tuple[str, ...]) -> None:
    assert "owned" in _output(*words, code=2)


def test_titles_and_attributes_of_results() -> None:
    name = _problem(title=NASTY)
    assert "wrote" in _output("run", name, "-o", f"{NASTY}.nc", "--no-draw", code=0)
    assert SHOWN in _output("info", f"{NASTY}.nc", code=0)
    run = netcdf.read(f"{NASTY}.nc")
    run.attributes["name\x1b[31m"] = NASTY
    netcdf.write("o.nc", run)
    shown = _output("info", "o.nc", code=0)
    assert re.search(r"^name\\x1b\[31m +" + re.escape(SHOWN), shown, re.MULTILINE)
    found = CliRunner().invoke(app, ["info", "o.nc", "--json"])
    assert not RAW.search(found.stdout)
    assert json.loads(found.stdout)["attributes"]["title"] == NASTY


def test_names_of_vehicles() -> None:
    name = NASTY.replace("\x1b", "").replace("\x07", "").replace("\b", "")  # XML has no others
    text = f'<robot name="{name}"><link name="{name}"/></robot>'.replace("\r", "&#13;")
    Path("v.urdf").write_text(text, encoding="utf-8")
    assert r"\u202eabc" in _output("vehicle", "v.urdf", code=2)


def test_warnings_and_details() -> None:
    words = CliRunner()
    with (
        words.isolation() as (_, stderr, _both),
        console._collecting("x", console.OutputOptions(verbose=True)),
    ):
        console.warn(NASTY)
        console.detail(NASTY)
        console.print_error(NASTY)
        shown = stderr.getvalue().decode()
    assert shown.count(SHOWN) == 3
    assert not RAW.search(shown)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX terminal")
def test_a_terminal() -> None:
    name = _problem(title=NASTY)
    assert CliRunner().invoke(app, ["run", name, "-o", "o.nc", "--no-draw"]).exit_code == 0
    run = netcdf.read("o.nc")
    run.attributes["problem"] += f"# {NASTY}\r\n"
    netcdf.write("o.nc", run)
    command = [sys.executable, "-m", "slipfree", "info", "o.nc", "--problem"]
    environment = {**os.environ, "NO_COLOR": "1", "COLUMNS": "1000", "TERM": "xterm"}
    master, slave = os.openpty()
    with subprocess.Popen(command, stdout=slave, stderr=slave, env=environment) as process:
        os.close(slave)
        seen = b""
        while True:
            try:
                seen += os.read(master, 100_000)
            except OSError:  # all is read and the process has ended
                break
        assert process.wait() == 0
    os.close(master)
    shown = re.sub(r"\x1b\[[0-9;]*m|\r+(?=\n)", "", seen.decode())  # bold, ends of lines
    assert SHOWN in shown
    assert not RAW.search(shown)
    piped = subprocess.run(command, capture_output=True, check=True, env=environment).stdout
    assert "\u202e" in piped.decode()  # a file is copied as it is
