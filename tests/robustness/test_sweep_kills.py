"""Tests of sweeps with killed processes, lost workers or full disks: finished runs are kept."""

import json
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import distributed
import psutil
import pytest

from helpers import sweep_cases
from helpers.commands import refuses
from slipfree.core.errors import DataError, SlipfreeError
from slipfree.core.version import __version__
from slipfree.sweep import Rows, sweep_facts, sweep_of, without_motion, work
from slipfree.system import processes
from slipfree.system.parts import LOG
from slipfree.system.processes import DaskPool, Processes, finish_tasks

pytestmark = pytest.mark.slow

SLOW = [
    *sweep_cases.GRID,
    "--set",
    "time.step=0.003",
]  # so long that many are left when it is killed


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
        seen, end = psutil.Process(process.pid), time.monotonic() + 60
        while not any(each.cpu_times().user > 2 for each in seen.children(recursive=True)):
            assert time.monotonic() < end
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
    with pytest.raises(SlipfreeError, match="to the scheduler is lost; what is finished is kept"):
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
        rows.append(done.row)
        rows.append(failed)
        told = dict(sweep_facts(sweep, rows, {}, ()))
    assert told["  run 1 lost"] == "OSError: [Errno 28] No space left on device (time.step=0.1)"
    assert told["  run 2 failed"] == "by chance (time.step=0.1)"
    assert told["  ..."] == "the same command repeats lost runs"
    words = ["--vary", "time.step=0.1,0.05", "--processes", "1", "--no-draw"]
    result = sweep_cases.sweep_in(file.parent, *words, code=1)
    assert "2 of 2: 1 failed, 1 complete" in result.stdout
    assert "--again repeats runs that failed" in result.stdout
    result = sweep_cases.sweep_in(file.parent, *words, "--again", code=0)
    assert "2 of 2: 2 complete" in result.stdout
    assert [row["outcome"] for row in sweep_cases.table_rows(file.parent)] == [
        "complete",
        "complete",
    ]


def test_a_cluster_that_does_not_fit_is_refused(dask: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "__version__", "9.9")
    refuses(DataError, f"that have slipfree 9.9, found {__version__};", DaskPool, work, dask, print)
