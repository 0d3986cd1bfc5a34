"""Add a figure: one function and one line of registration.

The function `pitch_plot` below belongs in ``show/motion_figures.py``, and its name in the tuple
``FIGURES`` there: one file is touched. ``slipfree run --figures-all`` and ``slipfree report`` then
draw it for every motion over terrain.
"""

from functools import partial
from pathlib import Path

import pytest

from helpers.commands import invoke
from slipfree.show import motion_figures
from slipfree.show.motion_figures import FIGURES, history
from slipfree.show.plots import Panel, Plot, PlottedDrive, stack

PROBLEM = Path(__file__).parents[2] / "problems" / "paper_direct.toml"


def pitch_plot(drive: PlottedDrive) -> Plot:
    """Return the figure of pitch and roll."""
    panels = [Panel(partial(history, drive.run, name)) for name in ("pitch", "roll")]
    return Plot("attitude", "Pitch and roll over time.", lambda: stack(drive.run, panels))


@pytest.mark.slow
def test_a_new_figure_is_drawn_with_the_others(tmp_path, monkeypatch):
    monkeypatch.setattr(motion_figures, "FIGURES", (*FIGURES[:2], pitch_plot))
    words = ["run", str(PROBLEM), "-o", str(tmp_path / "r.nc"), "--set", "time.duration=0.2"]
    invoke(*words, "--figures-all", code=0)
    assert "attitude" in {file.stem for file in (tmp_path / "r_figures").iterdir()}
