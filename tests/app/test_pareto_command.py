"""Tests of ``slipfree pareto``: fronts of a small plan, files, and errors."""

import csv

import numpy as np
import pytest

from helpers.cases import PROBLEMS
from helpers.commands import invoke, pressing, printed
from slipfree.problem import pareto

HILLS = PROBLEMS / "plan_rigid_hills.toml"
SMALL = ("--set", "plan.intervals=5", "--set", "plan.accuracy=0.05", "--set", "costs.slip=1e4")


def run(*words, code=None):
    return invoke("pareto", *words, code=code)


@pytest.mark.slow
def test_an_interrupted_front_continues_and_has_the_slopes_of_its_secants(tmp_path, monkeypatch):
    out, (pressed, begun) = tmp_path / "front", pressing(pareto._solve_point, at=4)
    monkeypatch.setattr(pareto, "_solve_point", pressed)
    words = HILLS, "--points", 2, *SMALL, "--set", "plan.duration=8", "-o"
    assert "interrupted; repeat the command to continue" in printed("pareto", *words, out, code=130)
    printed("pareto", *words, out)
    names = [task.name for task, *_ in begun]
    assert [names.count(name) for name in names[:4]] == [1, 1, 1, 2]
    assert [*tmp_path.glob("*_parts_*")] == []
    printed("pareto", *words, tmp_path / "whole")
    assert (out / "pareto.csv").read_bytes() == (tmp_path / "whole" / "pareto.csv").read_bytes()
    with (out / "pareto.csv").open() as file:
        rows = list(csv.DictReader(file))
    squared, share, second, slope = (
        np.array([float(row[name]) for row in rows])
        for name in ("squared_slip", "smoothness_share", "duration", "slope")
    )
    assert {row["outcome"] for row in rows} == {"complete"}
    files = ("pareto.png", *(f"point_{k:02}.nc" for k in (1, 2)))
    assert all((out / name).is_file() for name in files)
    first = squared / (1 - share)
    secants = np.diff(first) / np.diff(second)
    assert all(np.diff(first) < 0)
    assert all((slope[:-1] < secants) & (secants < slope[1:]))  # a convex front


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--against", "nothing"], "expected duration, effort, energy or the name of a quantity"),
        (["--set", "costs.slip="], "expected a positive weight costs.slip, found effort = "),
        (["--points", "1"], "Invalid value for '--points'"),
    ],
)
def test_errors_name_remedies(tmp_path, words, told):
    done = run(HILLS, *words, "-o", tmp_path / "front", code=2)
    assert told in " ".join(done.stderr.split())
    assert not (tmp_path / "front").exists()
