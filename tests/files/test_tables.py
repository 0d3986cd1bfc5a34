"""Tests of tables of comma-separated values: written tables can be read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slipfree.errors import DataError
from slipfree.files.netcdf import write_csv
from slipfree.files.tables import read_columns
from slipfree.records import Label
from slipfree.trajectory import Column, Trajectory


def test_a_result_is_a_path(tmp_path: Path) -> None:
    """Its columns are found by name, ``time`` as ``t``, and others are skipped."""
    t = np.linspace(0, 1, 9001)  # more than a block
    columns = {
        name: Column(Label(name, "m", name), values)
        for name, values in {"y": t**2, "slip": np.ones((t.size, 2)), "x": 3 * t}.items()
    }
    write_csv(tmp_path / "run.csv", Trajectory(t, columns, ("left", "right")))
    assert (tmp_path / "run.csv").read_text().startswith("time,y,slip[left],slip[right],x\n0.0,")
    found = np.array(read_columns(tmp_path / "run.csv", ("t", "x", "y")))
    np.testing.assert_array_equal(found, np.stack([t, 3 * t, t**2], axis=1))


@pytest.mark.parametrize("row", ["1,2", "1,2,3,4", "1,2,x", "1,2,nan"])
def test_rows_as_long_as_the_first_line(tmp_path: Path, row: str) -> None:
    (tmp_path / "a.csv").write_text(f"y,other,x\n0,0,0\n{row}\n")
    with pytest.raises(
        DataError,
        match=r"a.csv:3: expected 3 values as in line 1, with numbers for x,y, found '1,2",
    ):
        read_columns(tmp_path / "a.csv", "xy")
