"""Add a figure: one line.

The figure `attitude` below belongs in the tuple ``FIGURES`` of ``show/motion_figures.py``: one file
is touched. ``slipfree run --figures-all`` and ``slipfree report`` then draw it for every motion
over terrain.
"""

from pathlib import Path

import pytest

from helpers.commands import invoke
from slipfree.show import motion_figures
from slipfree.show.motion_figures import FIGURES, over_time

PROBLEM = Path(__file__).parents[2] / "problems" / "paper_direct.toml"
ATTITUDE = over_time("attitude", "Pitch and roll over time.", "pitch roll")


@pytest.mark.slow
def test_a_new_figure_is_drawn_with_the_others(tmp_path, monkeypatch):
    monkeypatch.setattr(motion_figures, "FIGURES", (*FIGURES[:2], ATTITUDE))
    words = ["run", str(PROBLEM), "-o", str(tmp_path / "r.nc"), "--set", "time.duration=0.2"]
    invoke(*words, "--figures-all", code=0)
    assert "attitude" in {file.stem for file in (tmp_path / "r_figures").iterdir()}
