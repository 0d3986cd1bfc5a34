"""Tests of full disks, Ctrl-C and kills: old files stay, new ones are complete, sweeps go on."""

import errno
import json
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing import active_children
from pathlib import Path
from typing import Any
from unittest.mock import Mock, patch

import distributed
import numpy as np
import psutil
import pytest
from matplotlib.animation import FFMpegWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from helpers import sweep_cases
from helpers.commands import invoke, refuses, sets
from helpers.fuzz_files import bases, document, results
from slipfree.core.errors import DataError, SlipfreeError
from slipfree.core.trajectory import Outcome, Trajectory
from slipfree.core.version import __version__
from slipfree.files import netcdf
from slipfree.show import film
from slipfree.show.plots import Plot
from slipfree.show.plots import save as save_figures
from slipfree.sweep import WORDS, Done, Rows, RunRow, sweep_facts, sweep_of, without_motion, work
from slipfree.system import processes
from slipfree.system.parts import LOG
from slipfree.system.processes import DaskPool, Processes, finish_tasks
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
    # a canvas has pixels once its renderer exists
    with patch.object(film, "Film", lambda *of: Mock(of=FigureCanvasAgg(of[0]).get_renderer())):
        film.animate(Mock(span=(0.0, 0.2)), file)


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
    if name.endswith(".mp4") and not FFMpegWriter.isAvailable():
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
    if name.endswith(".mp4") and not FFMpegWriter.isAvailable():
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
        rows.store(1, Done(row))
    size = (tmp_path / LOG).stat().st_size
    code = f"""
import resource, sys
from pathlib import Path
from slipfree.core.errors import DataError, WriteError
from slipfree.sweep import Done, Rows, RunRow
resource.setrlimit(resource.RLIMIT_FSIZE, ({size + 20}, {size + 20}))
try:
    with Rows(Path({str(tmp_path)!r}), 2, {HEAD!r}) as rows:
        rows.store(2, Done(RunRow(2, (), "complete", "", 1.0, {{}}, 0.1)))
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
def folder(folder: Path) -> Path:
    (folder / "p.toml").write_text(document(bases("direct")[0]))
    (folder / "p.nc").write_bytes(OLD)
    return folder


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
    found = invoke("run", "p.toml", "-o", "p.nc", "--no-draw", code=1)
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
    told = invoke("check", "p.toml", code=1).stderr
    assert told.startswith("not enough memory: reduce 'terrain.window'")


# Sweeps, processes and clusters that are killed

# so long that many are left when it is killed
SLOW = [*sweep_cases.GRID, *sets("time.step=0.003")]


@pytest.fixture
def file(folder: Path) -> Path:
    (folder / "p.toml").write_text(sweep_cases.PROBLEM)
    return folder / "p.toml"


def cluster(workers: int, **options: Any) -> Any:
    """Return a cluster on this machine, with one thread per worker."""
    return distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        dashboard_address="127.0.0.1:0",
        host="127.0.0.1",
        **options,
    )


@pytest.fixture(scope="module")
def dask() -> Iterator[str]:
    """The address of a cluster of two processes."""
    with cluster(2, processes=True) as local:
        yield local.scheduler_address


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a sweep of longer runs that nothing interrupts."""
    folder = tmp_path_factory.mktemp("slow")
    (folder / "p.toml").write_text(sweep_cases.PROBLEM)
    assert sweep_cases.sweep_in(folder, *SLOW, "--processes", "2", "--no-draw").exit_code == 0
    return folder


@pytest.mark.parametrize("pool", ["processes", "cluster"])
def test_a_killed_sweep_goes_on(
    slow: Path, file: Path, pool: str, request: pytest.FixtureRequest
) -> None:
    """Finished runs stay as they were, none is there twice, and the table is the same."""
    words = ["--processes", "2"]
    if pool == "cluster":
        words = ["--scheduler", request.getfixturevalue("dask")]
    process = sweep_cases.begin_sweep(file.parent, *SLOW, *words)
    if pool == "cluster":
        process.kill()
        process.communicate()
    else:
        sweep_cases.kill_sweep(process)
    kept = [line for line in sweep_cases.log_lines(file.parent) if line.endswith(b"\n")]
    assert 3 <= len(kept) < sweep_cases.RUNS + 1
    if pool == "processes":
        with (file.parent / "out" / LOG).open("ab") as log:
            log.write(b'{"part": 11, "settings": ["dri')  # as if it had been killed while it wrote
    sweep_cases.sweep_in(file.parent, *SLOW, *words, "--no-draw", code=0)
    lines = sweep_cases.log_lines(file.parent)
    assert lines[: len(kept)] == kept
    numbers = [json.loads(line)["part"] for line in lines[1:]]
    assert sorted(numbers) == list(range(1, sweep_cases.RUNS + 1))
    table = "out/table.csv"
    assert (file.parent / table).read_bytes() == (slow / table).read_bytes()


def test_a_process_that_dies_costs_one_run(file: Path) -> None:
    before, aims = {each.pid for each in active_children()}, [False]
    pool = Processes(1, work)

    def poll() -> None:
        if aims[0]:
            aims[0] = False
            (child,) = (each for each in active_children() if each.pid not in before)
            child.kill()

    slow = "time.step=0.00003"
    tasks = sweep_cases.tasks_of(file, "time.step=0.1", slow, "time.step=0.05")
    found = finish_tasks(tasks, pool, poll, without_motion)
    assert next(found).row.outcome == "complete"
    aims[0] = True
    row = next(found).row
    assert (row.run, row.outcome) == (2, "lost")
    assert row.words == "a worker process died (signal SIGKILL; possibly out of memory)"
    row = next(found).row
    assert (row.run, row.outcome) == (3, "complete")
    assert list(found) == []
    pool.close()
    assert {each.pid for each in active_children()} <= before


def test_processes_end_in_the_middle_of_a_run_if_the_sweep_is_killed(file: Path) -> None:
    words = f"-m slipfree sweep p.toml --set time.step=0.000001 --processes 1 -o {file.parent}/out"
    command = [sys.executable, *words.split()]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as process:
        seen, end = psutil.Process(process.pid), time.monotonic() + 600
        while not any(each.cpu_times().user > 2 for each in seen.children(recursive=True)):
            assert (process.poll(), time.monotonic() < end) == (None, True)
            time.sleep(0.05)
        children = seen.children(recursive=True)
        process.kill()
    _, alive = psutil.wait_procs(children, timeout=3)
    for each in alive:
        each.kill()
    assert not alive


def test_ctrl_c_keeps_what_is_finished(file: Path) -> None:
    process = sweep_cases.begin_sweep(file.parent, *sweep_cases.GRID, "--processes", "1")
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=20)
    assert process.returncode == 130
    assert "12 runs; repeat the command to continue" in stderr
    assert 2 <= len(sweep_cases.table_rows(file.parent)) < sweep_cases.RUNS
    assert len(sweep_cases.table_rows(file.parent)) == len(sweep_cases.log_lines(file.parent)) - 1


def test_workers_that_go_away_and_come_back(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "PATIENCE", 0.05)
    said: list[str] = []
    with cluster(1, processes=False, protocol="tcp://") as local:

        def poll() -> None:
            if len(local.workers) and not said:
                local.scale(0)
            elif len(said) == 1:
                local.scale(1)

        pool = DaskPool(work, local.scheduler_address, said.append)
        tasks = sweep_cases.tasks_of(file, "time.step=0.00003", "time.step=0.05")
        found = list(finish_tasks(tasks, pool, poll))
        pool.close()
    assert {done.row.outcome for done in found} == {"complete"}
    gone, back = said
    assert "no workers are left" in gone
    assert "workers are available again" in back


def test_a_scheduler_that_goes_away(file: Path) -> None:
    local = cluster(1, processes=False, protocol="tcp://")
    looked = []

    def poll() -> None:
        looked.append(1)
        if len(looked) == 1:
            local.close()

    tasks = sweep_cases.tasks_of(file, "time.step=0.1", "time.step=0.05")
    with pytest.raises(SlipfreeError, match="to the scheduler is lost; finished parts are kept"):
        list(finish_tasks(tasks, DaskPool(work, local.scheduler_address, print), poll))


def test_a_full_disk_is_no_fault_of_the_run(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(_: object) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as full:
        full.setattr("slipfree.sweep.run_problem", fail)
        (task,) = sweep_cases.tasks_of(file, "time.step=0.1")
        done = work(task)
    assert (done.row.outcome, done.row.t) == ("lost", None)
    assert done.row.words == "OSError: [Errno 28] No space left on device"
    sweep = sweep_of(file, ["time.step=0.1,0.05"])
    failed = done.row._replace(run=2, outcome="failed", words="by chance")
    with Rows(file.parent / "out", sweep.count, sweep.head) as rows:
        rows.store(1, done)
        rows.store(2, Done(failed))
        told = dict(sweep_facts(sweep, rows, {}))
    assert told["  run 1 lost"] == "OSError: [Errno 28] No space left on device (time.step=0.1)"
    assert told["  run 2 failed"] == "by chance (time.step=0.1)"
    assert told["  ..."] == "the same command repeats lost runs"
    words = ["--vary", "time.step=0.1,0.05", "--processes", "1", "--no-draw"]
    result = sweep_cases.sweep_in(file.parent, *words, code=1)
    assert "2 of 2: 1 failed, 1 complete" in result.stdout
    assert "--again repeats runs that failed" in result.stdout
    result = sweep_cases.sweep_in(file.parent, *words, "--again", code=0)
    assert "2 of 2: 2 complete" in result.stdout
    assert {row["outcome"] for row in sweep_cases.table_rows(file.parent)} == {"complete"}


def test_a_cluster_that_does_not_fit_is_refused(dask: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "__version__", "9.9")
    refuses(DataError, f"that have slipfree 9.9, found {__version__};", DaskPool, work, dask, print)
