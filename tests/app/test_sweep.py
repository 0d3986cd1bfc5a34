"""Tests of sweeps: runs, log, messages and figures."""

import json
import os
import re
import socket
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from helpers.cases import PROBLEMS
from helpers.commands import error_of, invoke, refused, refuses, sets
from helpers.sweep_cases import (
    GRID,
    PROBLEM,
    ROUGH,
    RUNS,
    SPEED,
    log_lines,
    sweep_in,
    table_rows,
    tasks_of,
)
from slipfree.cli.studies import _print_metrics
from slipfree.core.errors import DataError, SlipfreeError
from slipfree.files import netcdf
from slipfree.problem.inputs import recipe_of
from slipfree.problem.load import load_problem
from slipfree.show import study_figures as show
from slipfree.show.plots import Swept, Varied
from slipfree.sweep import Done, Rows, RunRow, RunTask, axis_of, drawn_grids, grids, sweep_of, work
from slipfree.system import processes
from slipfree.system.parts import LOG
from slipfree.system.processes import finish_tasks


@pytest.fixture
def file(folder: Path) -> Path:
    (folder / "p.toml").write_text(PROBLEM)
    return folder / "p.toml"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """A sweep that nothing interrupts, and what it printed."""
    folder = tmp_path_factory.mktemp("whole")
    (folder / "p.toml").write_text(PROBLEM)
    return folder, sweep_in(folder, *GRID, "--processes", "2", "--keep")


@pytest.mark.parametrize(
    ("text", "key", "values"),
    [
        ("a.b=0:1:5", "a.b", ("0.0", "0.25", "0.5", "0.75", "1.0")),
        ("a.b=0.1:0.5:5", "a.b", ("0.1", "0.2", "0.3", "0.4", "0.5")),
        ("a=4:1:4", "a", ("4", "3", "2", "1")),
        ("a = fixed,tilting", "a", ("fixed", "tilting")),
        ('a="x,y",z', "a", ('"x', 'y"', "z")),
        ("a=[-0.1, 0.1],[-0.2, 0.2]", "a", ("[-0.1, 0.1]", "[-0.2, 0.2]")),
    ],
)
def test_values_of_a_key(text, key, values):
    assert axis_of(text)[:2] == (key, values)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a", "expected key=a:b:n for n numbers from a to b, or key=v1,v2"),
        ("a=1:2:1", "expected 2 to 100000 values, found 1"),
        ("a=1:1:3", "expected two different finite ends, found 1 and 1"),
        ("a=1,2,1.0", "found 1 and 1.0, which are equal"),
        ("a=1e999:2:3", "finite ends, found 1e999 and 2"),
        ("a=x,,y", "found an empty value"),
    ],
)
def test_values_that_are_none(text, words):
    assert words in str(error_of(DataError, axis_of, text))


def test_a_grid_with_seeds(file):
    error = ["terrain.error={ rms = 0.01, correlation = 0.5, seed = 0 }"]
    sweep = sweep_of(file, [f"{SPEED}=1,2"], error, repeat=3, seed=10)
    runs = [sweep.run(number) for number in range(1, sweep.count + 1)]
    assert sweep.count == len(runs) == 6
    assert sweep.seeds == ("terrain.synthetic.power_law.seed", "terrain.error.seed")
    assert [run.values for run in runs] == [("1",)] * 3 + [("2",)] * 3
    assert [run.seeds for run in runs] == [(10, 13), (11, 14), (12, 15)] * 2
    assert runs[4].number == 5
    seeds = (f"{key}={seed}" for key, seed in zip(sweep.seeds, (11, 14), strict=True))
    assert runs[4].settings == (*error, f"{SPEED}=2", *seeds)


def test_a_dry_run_says_what_would_be_run(file):
    words = ["--vary", "time.step=0.05:0.3:11", "--repeat", "2", "--processes", "1"]
    result = sweep_in(file.parent, *words, "--dry-run", code=0)
    assert "22 = 11 x 2" in result.stdout
    assert "0.05, 0.075, 0.1, ..., 0.3 (11 values)" in result.stdout
    assert "1 to 2" in result.stdout
    assert "not known before the first run" in result.stdout
    assert not (file.parent / "out").exists()
    sweep = sweep_of(file, ["time.step=0.05:0.3:11"], repeat=2)
    with Rows(file.parent / "out", sweep.count, sweep.head) as rows:
        rows.store(1, Done(ROW._replace(seconds=6.0)))
        rows.store(2, Done(ROW._replace(run=2, seconds=8.0)))
    result = sweep_in(file.parent, *words, "--dry-run")
    assert "about 2.3 min: 7 s per run on 1 process\n" in result.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["--repeat", "2", "--set", "terrain.synthetic.power_law="],
            "add a table with a seed, such as",
        ),
        (["--vary", f"{SPEED}=1,2", "--set", f"{SPEED}=3"], "remove one of the two"),
        (
            ["--vary", f"{ROUGH}=1,2", "--vary", "terrain.synthetic.power_law=1,2"],
            "expected keys that do not contain one another",
        ),
        (["--vary", f"{SPEED}=1,0"], f"--vary {SPEED}: expected a speed other than zero, found 0"),
        (["--vary", "driver.sped=1,2"], "--vary driver.sped: did you mean 'speed'?"),
        (["--vary", f"{SPEED}=1:2:1000", "--repeat", "1000"], "at most 100000 runs, found 1000000"),
        (["--scheduler", "tcp://x:1", "--processes", "2"], "expected --scheduler or --processes"),
        (["-o", "p.toml"], "expected a folder, found a file"),
        (["-o", "out.nc"], "expected a folder, found a file; use, say, out"),
    ],
)
def test_bad_input_is_refused_before_anything_runs(file, words, said):
    assert said in refused("sweep", "p.toml", *words)
    assert {path.name for path in file.parent.iterdir()} == {"p.toml"}


def test_a_sweep_tells_tabulates_and_draws(whole):
    folder, result = whole
    assert result.exit_code == 0, result.output
    for words in (
        "12 of 12: 12 complete",
        "power_law.seed  ",
        "1 to 3",
        "slip_rms ",
        "driver.speed [m/s]  ",
        f"{ROUGH} [m]",
        "0.02  ",
        "all runs  ",
        "drew slip_rms, ",
    ):
        assert words in result.stdout, words
    table = table_rows(folder)
    assert [row["run"] for row in table] == [str(k) for k in range(1, RUNS + 1)]
    assert [row[SPEED] for row in table] == ["0.5"] * 6 + ["1.0"] * 6
    assert [row["terrain.synthetic.power_law.seed"] for row in table] == ["1", "2", "3"] * 4
    assert {row["outcome"] for row in table} == {"complete"}
    assert {float(row["time_reached"]) for row in table} == {0.3}
    assert not any("seconds" in name for name in table[0])
    names = {path.name for path in (folder / "out" / "figures").iterdir()}
    assert names == {"slip_rms.png", "tilt_largest.png", "utilisation_largest.png"}


def test_the_table_holds_what_the_results_hold(whole):
    folder, _ = whole
    files = sorted((folder / "out").glob("run_*.nc"))
    assert [path.name for path in files] == [f"run_{k:04d}.nc" for k in range(1, RUNS + 1)]
    for path, row in zip(files, table_rows(folder), strict=True):
        run = netcdf.read(path)
        assert run.attributes["problem"] == PROBLEM
        assert f"{ROUGH}={row[ROUGH]}" in run.attributes["settings"].splitlines()
        assert run.t[-1] == float(row["time_reached"])
        assert run["x"][-1] == float(row["end_x"])
        assert np.abs(run["pitch"]).max() == float(row["pitch_largest"])
        slip = run["slip_along"] ** 2 + run["slip_across"] ** 2
        mean = np.trapezoid(slip, run.t, axis=0).mean() / (run.t[-1] - run.t[0])
        assert float(row["slip_rms"]) == pytest.approx(np.sqrt(mean), rel=1e-12)


def test_the_same_run_by_itself_is_the_same(whole, tmp_path):
    folder, _ = whole
    line = json.loads(next(line for line in log_lines(folder) if b'{"part": 3,' in line))
    words = [word for setting in line["settings"] for word in ("--set", setting)]
    command = ["run", str(folder / "p.toml"), "--no-draw", "-o", str(tmp_path / "a.nc"), *words]
    assert invoke(*command).exit_code == 0
    alone, swept = (netcdf.read(p) for p in (tmp_path / "a.nc", folder / "out/run_0003.nc"))
    assert list(alone) == list(swept)
    for name in ("x", "y", "heading", "tilt_right", "utilisation"):
        # Sums of linear algebra round by the number of threads, which is not always one here.
        np.testing.assert_allclose(alone[name], swept[name], rtol=1e-9, atol=1e-12)


def test_a_finished_sweep_runs_nothing(whole):
    folder, first = whole
    before, table = log_lines(folder), table_rows(folder)
    result = sweep_in(
        folder, *GRID, "--scheduler", "tcp://127.0.0.1:1", "--figure", "end_y", "-v", code=0
    )
    assert "12 of 12 runs" in result.stderr
    assert log_lines(folder) == before
    assert table_rows(folder) == table
    assert "end_y " in result.stdout
    assert "slip_rms" in first.stdout
    assert "slip_rms" not in result.stdout


def test_an_unknown_figure_is_refused_with_those_there_are(whole):
    result = sweep_in(whole[0], *GRID, "--figure", "slip_mean", code=2)
    assert "--figure slip_mean: expected one of the metrics of these runs (" in result.stderr
    assert "slip_rms" in result.stderr


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (["--repeat", "2"], "some with another --repeat: 3, now 2"),
        (["--set", "time.step=0.05"], 'some with another --set: [], now ["time.step=0.05"]'),
    ],
)
def test_results_of_another_sweep_are_not_mixed(whole, change, said):
    before = log_lines(whole[0])
    result = sweep_in(whole[0], *GRID, *change, code=2)
    assert said in result.stderr
    assert "choose another folder with -o, or remove this file" in result.stderr
    assert log_lines(whole[0]) == before


@pytest.mark.parametrize(
    ("settings", "vary", "name"),
    [
        (["terrain.file=map.npz", "terrain.synthetic="], [], "map.npz"),
        (["terrain.synthetic="], ["terrain.file=other.npz,map.npz"], "map.npz"),
        (["vehicle.file=parts/of.toml", "vehicle.catalog="], [], "parts/rover.urdf"),
        (["driver.file=way.csv", "driver.name=follow"], [], "way.csv"),
    ],
)
def test_results_of_other_input_files_are_not_mixed(file, settings, vary, name):
    folder = file.parent
    (folder / "parts").mkdir()
    (folder / "parts/of.toml").write_text('urdf = "rover.urdf"')
    changed = folder / name
    changed.write_text("one")
    for _ in range(2):
        with Rows(folder, 1, sweep_of(file, vary, settings).head):
            pass
    changed.write_text("other")
    with pytest.raises(DataError, match=f"some with another input file: {name}; choose another"):
        Rows(folder, 1, sweep_of(file, vary, settings).head)
    changed.unlink()
    assert sweep_of(file, vary, settings).files.digests[name] == "missing"


ROW = RunRow(1, ("a=1",), "complete", "", 0.5, {"end_x": (1.25, "m")}, 0.1)
HEAD: dict[str, Any] = {
    "slipfree": "0",
    "problem": "",
    "files": {},
    "settings": [],
    "vary": {},
    "repeat": 1,
    "seeds": {},
}


def rows_in(folder: Path, *, again: bool = False) -> list[RunRow]:
    with Rows(folder, 3, HEAD, again=again) as rows:
        return list(rows)


def test_the_log_keeps_what_was_written(tmp_path):
    folder = tmp_path / "new"
    with Rows(folder, 3, HEAD) as rows:
        assert list(rows) == []
        rows.store(1, Done(ROW))
        refuses(DataError, "no other process writes, found one in use", Rows, folder, 3, HEAD)
    log = folder / LOG
    whole = log.read_bytes()
    log.write_bytes(whole + b'{"part": 2, "sett')
    assert rows_in(folder) == [ROW]
    assert log.read_bytes() == whole
    log.write_bytes(whole[:20])  # not even the first line
    assert rows_in(folder) == []


def test_runs_that_were_lost_or_damaged_are_done_again(tmp_path, monkeypatch):
    """A result that was moved elsewhere is not damaged."""
    monkeypatch.setattr("slipfree.sweep.write", lambda part, *_: part.write_bytes(b"motion"))
    outcomes = enumerate(("complete", "lost", "failed"), 1)
    written = [ROW._replace(run=number, outcome=outcome) for number, outcome in outcomes]
    with Rows(tmp_path, 3, HEAD) as rows:
        for row in written:
            rows.store(row.run, Done(row, True))
    rows.file(3).unlink()
    assert rows_in(tmp_path) == [written[0], written[2]]
    with Rows(tmp_path, 3, HEAD, again=True) as rows:
        assert list(rows) == [written[0]]
        assert rows.outcomes["failed"] == 0
        for row in written[1:]:
            rows.store(row.run, Done(row._replace(outcome="complete")))
    assert [row.outcome for row in rows_in(tmp_path)] == ["complete"] * 3
    rows.file(1).write_bytes(b"damage")
    assert [row.run for row in rows_in(tmp_path)] == [2, 3]


@pytest.mark.slow
def test_results_that_were_not_kept_are_told(file):
    words = ["--set", "time.step=0.15", "--no-draw", "--processes", "1"]
    assert sweep_in(file.parent, *words).exit_code == 0
    result = sweep_in(file.parent, *words, "--keep", code=0)
    assert "--keep: finished runs without a result file: 1" in result.stderr
    assert "sweep into another folder with -o" in result.stderr


def test_places_of_figures_are_checked_before_anything_runs(file):
    (file.parent / "out").mkdir()
    (file.parent / "out" / "figures").write_text("")
    result = sweep_in(file.parent, "--repeat", "2", code=2)
    assert "figures: expected a folder, found a file" in result.stderr
    assert [path.name for path in (file.parent / "out").iterdir()] == ["figures"]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b'"end_x": [1.25', b'"end_x": [1.35'),
        (b'{"part": 1', b'{"part": 2'),
        (b'{"part": 1', b'{"part": Infinity'),
        (b'"settings": ["a=1"]', b'"settings": ["a=2"]'),
        (b"{", b""),
        (b"{", b"[" * 100_000),
        (b"{", b"\0"),
    ],
)
def test_runs_whose_line_was_changed_are_done_again(tmp_path, old, new):
    with Rows(tmp_path, 3, HEAD) as rows:
        rows.store(1, Done(ROW))
        rows.store(3, Done(ROW._replace(run=3)))
    log = tmp_path / LOG
    head, first, second = log.read_bytes().splitlines(keepends=True)
    log.write_bytes(head + first.replace(old, new, 1) + second)
    assert [row.run for row in rows_in(tmp_path)] == [3]


def test_a_log_of_something_else_is_refused(tmp_path):
    (tmp_path / LOG).write_bytes(b"{\n")
    refuses(DataError, "parts.jsonl:1: expected the description", Rows, tmp_path, 3, HEAD)
    (tmp_path / LOG).unlink()
    os.mkfifo(tmp_path / LOG)
    refuses(DataError, "found no regular file", Rows, tmp_path, 3, HEAD)


def test_a_map_that_changes_during_a_sweep_ends_it(file, monkeypatch):
    axis = np.linspace(-3, 3, 25)

    def write_map(z: float) -> None:
        np.savez("map.npz", x=axis, y=axis, z=z + 0 * axis * axis[:, None])

    write_map(0.0)
    store = Rows.store
    monkeypatch.setattr(Rows, "store", lambda *words: (store(*words), write_map(0.1)))
    words = [*GRID[:2], *sets("terrain.synthetic=", "terrain.file=map.npz"), "--no-draw", "-j", "1"]
    result = sweep_in(file.parent, *words, code=2)
    assert "map.npz: expected an input file that does not change" in result.stderr
    assert len(log_lines(file.parent)) == 2


@pytest.mark.slow
def test_runs_that_fail_are_rows_and_counted_in_the_bar(file, monkeypatch):
    monkeypatch.setattr("rich.console.Console.is_terminal", True)
    words = ["--vary", "start.x=0,40", "--vary", "terrain.file=gone.npz"]
    words += ["--set", "terrain.synthetic=", "--processes", "1"]
    result = sweep_in(file.parent, *words, code=1)
    for words in ("2 of 2: 2 failed", "run 2 failed", "(start.x=40, terrain.file=gone.npz)"):
        assert words in result.stdout
    assert "runs, 2 failed" in result.stderr
    assert "2/2" in result.stderr
    for row in table_rows(file.parent):
        assert row["outcome"] == "failed"
        assert "gone.npz" in row["words"]
        assert str(file.parent) not in row["words"]
        assert row["time_reached"] == ""
        assert row["complete"] == "0.0"


def test_processes_that_cannot_start_are_no_fault_of_the_runs(file, monkeypatch):
    monkeypatch.setattr(processes, "prepare_process", sys.exit)  # ends at once
    pool = processes.Processes(1, work)
    words = r"could not start \(exit code 0\): see its output above; finished parts are kept"
    with pytest.raises(SlipfreeError, match=words):
        list(finish_tasks(tasks_of(file, "time.step=0.1"), pool, lambda: None))


def test_an_error_that_nobody_expects_is_a_row(file, monkeypatch):
    def fail(_: object) -> None:
        raise ZeroDivisionError("by chance")

    monkeypatch.setattr("slipfree.sweep.run_problem", fail)
    (task,) = tasks_of(file, "time.step=0.1")
    assert work(task).row.words == "ZeroDivisionError: by chance"


@pytest.mark.parametrize(
    ("first", "second", "same"),
    [
        ("driver.speed=0.5", "driver.speed=0.6", True),
        ("start.heading=0.1", "start.heading=0.2", True),
        ("terrain.friction=0.5", "terrain.friction=0.6", False),
        ("vehicle.axle='tilting'", "vehicle.axle='sliding'", False),
    ],
)
def test_runs_share_a_model_unless_it_depends_on_the_key(file, monkeypatch, first, second, same):
    shared = dict[str, Any]()
    monkeypatch.setattr("slipfree.sweep.KEPT", shared)
    before, after = tasks_of(file, first, second)
    work(before)
    model = shared["model"][1]
    row = work(after).row
    assert (shared["model"][1] is model) == same
    shared.clear()
    alone = work(after).row
    assert row.figures == alone.figures
    assert row.outcome == alone.outcome == "complete"


def test_runs_with_other_input_files_share_nothing(file, monkeypatch):
    shared = dict[str, Any]()
    monkeypatch.setattr("slipfree.sweep.KEPT", shared)
    (task,) = tasks_of(file, "time.step=0.1")
    work(task)
    found = shared["map"][1]
    work(task)
    assert shared["map"][1] is found
    work(task._replace(files="others"))
    assert shared["map"][1] is not found


def figures_of(name: str, *settings: str) -> dict[str, tuple[float, str]]:
    row = work(RunTask(1, recipe_of(load_problem(PROBLEMS / name), *settings), ())).row
    assert row.outcome == "complete", row.words
    return row.figures


@pytest.mark.slow
def test_every_verb_has_figures():
    found = figures_of("paper_inverse.toml", "time.duration=0.3")
    own = {"inverse_margin_least", "slip_rms", "steering_slip_largest", "tilt_largest"}
    assert found.keys() >= own
    short = "plan.intervals=4", "plan.duration=10.0", "goal.x=0.1", "goal.y=1.3", "costs.slip="
    found = figures_of("plan_rigid_hills.toml", *short)
    assert found.keys() >= {"plan_cost_effort", "plan_difference_x"}
    each = [value for name, (value, _) in found.items() if name.startswith("plan_violation_")]
    assert found["plan_violation"][0] == max(each)
    assert found["within_limits"][0] == float(max(each) <= 1e-3)


def test_a_run_that_stops_is_told_by_name(file):
    sweep = sweep_of(file, [f"{SPEED}=1.0,6.0"])
    rows = [
        work(RunTask(run.number, recipe_of(load_problem(file), *run.settings), run.settings)).row
        for run in map(sweep.run, (1, 2))
    ]
    assert [row.outcome for row in rows] == ["complete", "stopped by map_margin[front]"]
    assert "leaves the map" in rows[1].words
    assert rows[1].t == pytest.approx(1.25 / 6.0, abs=1e-3)
    assert rows[1].settings == (f"{SPEED}=6.0",)
    with Rows(file.parent, sweep.count, sweep.head) as log:
        for row in rows:
            log.store(row.run, Done(row))
    share = drawn_grids(log, grids(sweep, log, ["end_y"]), ["end_y"])[-1]
    assert share.name == "complete"
    np.testing.assert_array_equal(share.values, [[1.0], [0.0]])


def test_no_cluster_is_refused(file, monkeypatch):
    monkeypatch.setattr(processes, "CONNECT", 0.3)
    begun = time.monotonic()
    with socket.create_server(("127.0.0.1", 0)) as dead:  # it does not answer
        addresses = {
            "tcp://127.0.0.1:1": "",
            f"tcp://127.0.0.1:{dead.getsockname()[1]}": "",
            "nonsense": "ValueError: missing port",
            "tls://127.0.0.1:1": "TypeError: TLS",
        }
        for address, found in addresses.items():
            told = sweep_in(file.parent, "--scheduler", address, code=2).stderr
            expected = f"--scheduler {address}: expected the address of a running Dask scheduler"
            assert (told.count("\n"), expected in told) == (1, True)
            assert f"found none ({found}" in told
    assert time.monotonic() - begun < 10
    monkeypatch.setitem(sys.modules, "distributed", None)
    result = sweep_in(file.parent, "--scheduler", "tcp://127.0.0.1:1", code=2)
    assert "pip install 'distributed>=" in result.stderr


SPEEDS = Varied("driver.speed", ("2.0", "0.5", "1.0"), "m/s")
AXLES = Varied("vehicle.axle", ('"fixed"', '"tilting"'))


def _swept(axes: Sequence[Varied], values: Any) -> Swept:
    return Swept("slip_rms", "m s-1", tuple(axes), np.array(values, dtype=float))


def test_a_table_of_each_key_has_short_values_and_bold_best_ones(monkeypatch, capsys):
    thirds = Varied("driver.speed", ("0.0866666666667", "0.2", "0.3"), "m s-1")
    swept = _swept([thirds], [[1.0, np.nan], [2.0, 3.0], [np.nan, np.nan]])
    _print_metrics([swept])
    head, rule, *told = capsys.readouterr().out.splitlines()[1:]
    assert ({*rule}, head.split("  ")[0]) == ({"-", " "}, "driver.speed [m/s]")
    rows = ["0.08667", "1"], ["0.2", "2.5 (2 to 3)"], ["0.3", "-"], ["all runs", "2 (1 to 3)"]
    assert [re.split("  +", line) for line in told] == [*rows]
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    for name, bold in ((swept.name, ["1"]), ("tip_over_margin_least", ["2.5 (2 to 3)"])):
        _print_metrics([swept._replace(name=name)])
        told = capsys.readouterr().out.splitlines()[4:]
        assert [w for line in told for w in re.findall(r"\x1b\[1m(\S.*?) *\x1b", line)] == bold


def test_a_curve_with_its_spread():
    ax = Figure().subplots()
    show.curve(_swept([SPEEDS], [[5.0, 7.0], [1.0, 3.0], [np.nan, 4.0]]), ax)
    mean = ax.lines[0]
    np.testing.assert_array_equal(mean.get_xdata(), [0.5, 1.0, 2.0])
    np.testing.assert_array_equal(mean.get_ydata(), [2.0, 4.0, 6.0])
    (band,) = ax.collections
    np.testing.assert_array_equal(band.get_segments()[2], [(2.0, 5.0), (2.0, 7.0)])
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("driver.speed [m/s]", "slip_rms [m/s]")
    assert ax.get_legend_handles_labels()[1] == ["mean", "range", "runs"]


def test_a_heat_map():
    ax = Figure().subplots()
    values = [[[1.0, 3.0], [5.0, 5.0]], [[0.0, 0.0], [np.nan, 1.0]], [[7.0, 7.0], [np.nan] * 2]]
    numbers = SPEEDS._replace(values=("2000000.5", "0.333333333333", "2000000"))
    show.heat_map(_swept([numbers, AXLES], values), ax)
    shown = ax.images[0].get_array().filled(np.nan)
    np.testing.assert_array_equal(shown, [[0.0, 7.0, 2.0], [1.0, np.nan, 5.0]])
    labels = [label.get_text() for label in ax.get_xticklabels()]
    assert labels == ["0.33333333", "2000000", "2000000.5"]
    assert sorted(words.get_text() for words in ax.texts) == ["0", "1", "2", "5", "7"]
    assert ax.figure.axes[1].get_ylabel() == "slip_rms, mean [m/s]"
    assert ax.images[0].get_cmap().name == "risk"
