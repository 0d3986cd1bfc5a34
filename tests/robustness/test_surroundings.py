"""Tests of the environment: streams, current folder, Matplotlib settings, nearby modules."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.fuzz_files import bases, document
from slipfree.show.plots import Plot, save

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX shell"),
]
FULL = pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
CHECK = "check disk, folder and permissions"


@pytest.fixture(autouse=True)
def folder(folder):
    (folder / "p.toml").write_text(document(bases("direct")[0]))
    return folder


def _shell(line: str, **more: str) -> tuple[int, str, str]:
    """Return exit code, stdout and stderr of a line in which ``slipfree`` is the command."""
    line = f'set -o pipefail; slipfree() {{ "{sys.executable}" -m slipfree "$@"; }}; {line}'
    found = subprocess.run(
        ["bash", "--norc", "-c", line],
        env={**os.environ, **more},
        capture_output=True,
        encoding="latin-1",
        check=False,
    )
    assert "Traceback" not in found.stderr, found.stderr
    assert "Exception ignored" not in found.stderr, found.stderr
    return found.returncode, found.stdout, found.stderr


@FULL
def test_a_full_stdout() -> None:
    told = f"reading or writing failed (No space left on device); {CHECK}\n"
    assert _shell("slipfree examples --json > /dev/full") == (1, "", f"stdout: {told}")
    assert _shell("slipfree --help > /dev/full") == (1, "", told)


@FULL
def test_a_full_stderr_leaves_the_exit_code() -> None:
    assert _shell("slipfree check no.toml 2> /dev/full") == (2, "", "")
    assert _shell("slipfree check no.toml > /dev/full 2>&1") == (2, "", "")


def test_a_reader_that_goes_away() -> None:
    code, shown, told = _shell("slipfree examples | true")
    assert (code, shown, told) == (1, "", "")


@FULL
def test_a_full_stdout_does_not_lose_the_result() -> None:
    code, _, told = _shell("slipfree run p.toml -o o.nc --no-draw > /dev/full")
    assert (code, told.count("\n")) == (1, 1)
    assert Path("o.nc").read_bytes()[:3] == b"CDF"


def test_closed_streams() -> None:
    assert _shell("slipfree run p.toml -o o.nc --no-draw <&- >&- 2>&-") == (0, "", "")
    whole = Path("o.nc").read_bytes()
    assert whole[:3] == b"CDF"
    assert _shell("slipfree info o.nc >&-") == (0, "", "")
    assert _shell("slipfree check no.toml 2>&-") == (2, "", "")


def test_characters_that_stdout_does_not_have() -> None:
    problem = {**bases("direct")[0], "title": "Ü\u4e2d"}
    Path("p.toml").write_text(document(problem), encoding="utf-8")
    line = "slipfree run p.toml -o o.nc --no-draw -q && slipfree info o.nc"
    code, shown, told = _shell(line, PYTHONIOENCODING="latin-1")
    assert (code, told) == (0, "")
    assert r"\u4e2d" in shown


def test_a_current_folder_that_is_gone() -> None:
    code, shown, told = _shell("mkdir gone; cd gone; rmdir ../gone; slipfree check ../p.toml")
    assert (code, shown) == (2, "")
    assert told == (
        "expected a current folder that exists, found that it was removed (No such file or "
        "directory); change to another folder: cd DIR\n"
    )


def test_settings_of_matplotlib_that_do_not_work_here() -> None:
    Path("matplotlibrc").write_text("text.usetex: True\n")
    code, _, told = _shell("slipfree run p.toml -o o.nc", MPLBACKEND="nonsense", PATH="/usr/bin")
    assert (code, told) == (0, "")
    assert Path("o_figures/map.png").exists()


def test_names_with_signs_of_latex_are_drawn_as_they_are(tmp_path: Path) -> None:
    from matplotlib import rc_context

    from slipfree.show import style

    with rc_context({"text.usetex": True}), rc_context(style.STYLE):
        figure = style.figure(1, 1)
        figure.suptitle(r"\input{/etc/hostname} _ %", parse_math=False)
    assert save([Plot("a", "", lambda: figure)], tmp_path) == [tmp_path / "a.png"]


def test_modules_in_the_current_folder_are_not_imported(folder: Path) -> None:
    for name in ("numpy", "casadi", "signal"):
        (folder / f"{name}.py").write_text("raise SystemExit('imported from here')\n")
    code, shown, told = _shell("slipfree check p.toml")
    assert (code, told) == (0, "")
    assert shown.startswith("ok ")
