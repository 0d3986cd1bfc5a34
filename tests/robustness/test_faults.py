"""Tests of full or read-only disks, Ctrl-C and kills: old files stay, new files are complete."""

import errno
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

from helpers.fuzz_files import bases, document, results
from slipfree.cli import app
from slipfree.core.errors import DataError
from slipfree.core.trajectory import Outcome, Trajectory
from slipfree.files import netcdf
from slipfree.show.film import film_writer, write_film
from slipfree.show.plots import Plot
from slipfree.show.plots import save as save_figures
from slipfree.sweep import WORDS, Rows, RunRow
from slipfree.system.parts import LOG
from slipfree.system.regular_files import replace_file

pytestmark = pytest.mark.slow

OLD = b"what was here before"
BEGIN = "import sys; from slipfree.__main__ import main; print('begun', flush=True); main()"
HEAD = dict.fromkeys(WORDS, 1)


@pytest.fixture(scope="module")
def motion(tmp_path_factory: pytest.TempPathFactory) -> Trajectory:
    file = tmp_path_factory.mktemp("old") / "r.nc"
    file.write_bytes(results()[1])
    return netcdf.read(file)


def _figure() -> Figure:
    figure = Figure((1, 1))
    figure.subplots().plot([0, 1])
    return figure


def _film(file: Path) -> None:
    write_film(film_writer(file, 5), _figure(), file, str, range(3))


WRITERS: dict[str, Callable[[Trajectory, Path], Any]] = {
    "r.nc": lambda run, file: netcdf.write(file, run, {"more": np.ones(9)}),
    "n.nc": lambda run, file: replace_file(file, lambda part: netcdf.write(part, run)),
    "r.csv": lambda run, file: netcdf.write_csv(file, run),
    "f.png": lambda _, file: save_figures([Plot("f", "", _figure)], file.parent),
    "f.pdf": lambda _, file: save_figures([Plot("f", "", _figure)], file.parent, ["pdf"]),
    "film.gif": lambda _, file: _film(file),
    "film.mp4": lambda _, file: _film(file),
    "page.html": lambda _, file: replace_file(file, lambda part: part.write_text("<html>")),
}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)), KeyboardInterrupt()]
)
def test_what_fails_at_its_end_leaves_the_old_file(
    motion: Trajectory, name: str, error: BaseException, tmp_path: Path, monkeypatch: Any
) -> None:
    if name.endswith(".mp4") and not _has_ffmpeg():
        pytest.skip("ffmpeg is not installed")
    (tmp_path / name).write_bytes(OLD)

    def fail(*_: Any) -> None:
        raise error

    monkeypatch.setattr(os, "fsync", fail)
    with pytest.raises(DataError if isinstance(error, OSError) else KeyboardInterrupt) as caught:
        WRITERS[name](motion, tmp_path / name)
    assert isinstance(error, KeyboardInterrupt) or f"{name}: cannot be written" in str(caught.value)
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == {name: OLD}
    monkeypatch.undo()
    WRITERS[name](motion, tmp_path / name)
    assert [each.name for each in tmp_path.iterdir()] == [name]
    assert (tmp_path / name).read_bytes() != OLD


def _has_ffmpeg() -> bool:
    from matplotlib.animation import FFMpegWriter

    return FFMpegWriter.isAvailable()


@pytest.mark.parametrize("name", [name for name in WRITERS if name[0] != "f"])
@pytest.mark.parametrize("number", [errno.EROFS, errno.EIO])
def test_a_place_that_cannot_be_renamed_in(
    motion: Trajectory, name: str, number: int, tmp_path: Path, monkeypatch: Any
) -> None:
    (tmp_path / name).write_bytes(OLD)

    def fail(*_: Any, **__: Any) -> None:
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(os, "replace", fail)
    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(DataError, match=f"{name}: cannot be written"):
        WRITERS[name](motion, tmp_path / name)
    assert {each.name: each.read_bytes() for each in tmp_path.iterdir()} == {name: OLD}


@pytest.mark.parametrize("name", WRITERS)
def test_a_place_below_a_file_is_none(motion: Trajectory, name: str, tmp_path: Path) -> None:
    if name.endswith(".mp4") and not _has_ffmpeg():
        pytest.skip("ffmpeg is not installed")
    (tmp_path / "file").write_bytes(OLD)
    with pytest.raises(DataError, match=r"cannot be written|one that cannot be created"):
        WRITERS[name](motion, tmp_path / "file" / "deep" / name)
    assert (tmp_path / "file").read_bytes() == OLD


def test_a_link_stays_one(motion: Trajectory, tmp_path: Path) -> None:
    (tmp_path / "real").mkdir()
    (tmp_path / "r.nc").symlink_to(tmp_path / "real" / "r.nc")
    netcdf.write(tmp_path / "r.nc", motion)
    assert (tmp_path / "r.nc").is_symlink()
    assert netcdf.read(tmp_path / "real" / "r.nc").t.size == motion.t.size


def test_threads_that_write_one_file_leave_it_whole(motion: Trajectory, tmp_path: Path) -> None:
    longer = [motion.part(slice(k)) for k in range(1, motion.t.size + 1)] * 8
    writers = [
        threading.Thread(target=netcdf.write, args=(tmp_path / "r.nc", each)) for each in longer
    ]
    for each in writers:
        each.start()
    for each in writers:
        each.join()
    assert 1 <= netcdf.read(tmp_path / "r.nc").t.size <= motion.t.size
    assert [each.name for each in tmp_path.iterdir()] == ["r.nc"]


def test_a_log_on_a_full_disk_tells_so_and_goes_on_later(tmp_path: Path) -> None:
    row = RunRow(1, (), "complete", "", 1.0, {"x": (1.0, "m")}, 0.1)
    with Rows(tmp_path, 2, HEAD) as rows:
        rows.append(row)
    size = (tmp_path / LOG).stat().st_size
    code = f"""
import resource, sys
from pathlib import Path
from slipfree.core.errors import DataError, WriteError
from slipfree.sweep import Rows, RunRow
resource.setrlimit(resource.RLIMIT_FSIZE, ({size + 20}, {size + 20}))
try:
    with Rows(Path({str(tmp_path)!r}), 2, {HEAD!r}) as rows:
        rows.append(RunRow(2, (), "complete", "", 1.0, {{}}, 0.1))
except WriteError as error:
    sys.exit(f"refused: {{error}}")
"""
    command = [sys.executable, "-B", "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stderr.startswith("refused: "), done.stderr
    assert "cannot be written (File too large)" in done.stderr
    with Rows(tmp_path, 2, HEAD) as rows:
        assert list(rows) == [row]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "p.toml").write_text(document(bases("direct")[0]))
    (tmp_path / "p.nc").write_bytes(OLD)
    return tmp_path


def _begun(folder: Path, *words: str, **more: Any) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", BEGIN, *words]
    return subprocess.Popen(
        command, cwd=folder, text=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, **more
    )


def test_a_disk_that_is_full_while_a_result_is_written(folder: Path) -> None:
    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (3000, 3000))

    # Python itself may leave half of a compiled module
    env = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
    process = _begun(folder, "run", "p.toml", "-o", "p.nc", "--no-draw", preexec_fn=limit, env=env)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 1
    begin, end = told.splitlines()[-1].split("; the earlier file is unchanged; ")
    assert begin.endswith("written (File too large); free disk space or choose another folder")
    assert end.endswith(begin)
    assert {each.name for each in folder.iterdir()} == {"p.toml", "p.nc"}
    assert (folder / "p.nc").read_bytes() == OLD


def test_a_full_disk_leaves_the_old_file_and_the_result_elsewhere(
    folder: Path, tmp_path_factory: pytest.TempPathFactory, monkeypatch: Any
) -> None:
    other = tmp_path_factory.mktemp("other")
    monkeypatch.setattr("tempfile.tempdir", str(other))
    monkeypatch.chdir(folder)
    replace = Path.replace

    def fail(part: Path, target: Path) -> None:
        if part.parent == folder:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replace(part, target)

    monkeypatch.setattr(Path, "replace", fail)
    found = CliRunner().invoke(app, ["run", "p.toml", "-o", "p.nc", "--no-draw"])
    assert found.exit_code == 1
    (saved,) = other.glob("slipfree_*/p.nc")
    assert netcdf.read(saved).stop is None
    assert found.stderr == (
        "p.nc: cannot be written (No space left on device); free disk space or choose another "
        f"folder; the earlier file is unchanged; saved as {saved}\n"
    )
    assert (folder / "p.nc").read_bytes() == OLD


@pytest.mark.parametrize("after", [0.05, 1.0])
def test_ctrl_c_ends_with_a_word(folder: Path, after: float) -> None:
    words = ["--set", "time.duration=6", "--set", "time.step=1e-5"]
    process = _begun(folder, "run", "p.toml", "-o", "p.nc", "--no-draw", *words)
    assert process.stdout is not None
    process.stdout.readline()  # before, it is Python that starts
    time.sleep(after)
    process.send_signal(signal.SIGINT)
    _, told = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "Traceback" not in told
    if told.splitlines()[-1:] == ["interrupted"]:
        assert (folder / "p.nc").read_bytes() == OLD
    else:  # behind the first step
        assert told.splitlines()[-1].startswith("interrupted at t = "), told
        assert netcdf.read(folder / "p.nc").outcome is Outcome.INTERRUPTED


def test_memory_that_runs_out_is_told(folder: Path, monkeypatch: Any) -> None:
    def fail(*_: Any) -> None:
        raise MemoryError

    monkeypatch.chdir(folder)
    monkeypatch.setattr("slipfree.problem.result.build", fail)
    found = CliRunner().invoke(app, ["check", "p.toml"])
    assert found.exit_code == 1
    assert found.stderr.startswith("not enough memory: reduce 'terrain.window'")
