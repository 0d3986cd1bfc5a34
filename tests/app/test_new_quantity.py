"""Add a quantity, a limit and a figure: a row of a table, one function, and two lines.

The row `NOSE_UP` below belongs in ``core/quantities.toml``. The function `nose_up` and its name in
the tuple ``LIMITS`` of ``models/limits.py`` are a limit of this quantity (3 lines), the figure is a
line of ``FIGURES`` in ``show/motion_figures.py``. Nothing else of the package knows them: every
model of a vehicle has the limit, commands end a motion there by name, and result files, CSV tables,
summaries, JSON output and figures have the quantity.
"""

import json
from collections.abc import Iterator

import numpy as np
import pytest

from helpers.commands import invoke, printed
from slipfree.core.dae import Limit
from slipfree.core.quantities import QUANTITIES, QuantityRow, quantity_label
from slipfree.files.netcdf import read
from slipfree.models import limits
from slipfree.models.base import Quantities
from slipfree.show.motion_figures import FIGURES, over_time

STEEPEST = 0.1
NOSE_UP = QuantityRow(
    *("nose_up", "rad", "the load slides off the platform (pitch)"),
    facts="greatest",
    line="load: slides off above {nose_up_greatest:.3g>deg} ({nose_up_greatest.words})",
    figure="load",
)


def nose_up(q: Quantities) -> Iterator[Limit]:
    """Yield the pitch at which the load slides off the platform."""
    yield Limit(quantity_label("nose_up"), q.position.pitch, -np.inf, STEEPEST)


PROBLEM = """\
verb = "direct"
terrain.friction = 0.9
vehicle = { catalog = "three_wheeler", axle = "fixed" }
start = { y = -1.0 }
inputs = { right_rate = 1.0, left_rate = 1.0, steer_rate = 0.0 }
time = { duration = 12, step = 0.25 }

[terrain.synthetic]
x = [-3, 3]
y = [-3, 9]
spacing = 0.25
ramp = { start = 0.0, end = 6.0, rise = 1.0 }
"""


@pytest.mark.slow
@pytest.mark.parametrize("setting", ["model=quasi-static", "time.duration=2"])
def test_a_quantity_with_a_limit_and_a_figure(setting, folder, monkeypatch):
    monkeypatch.setitem(QUANTITIES, "nose_up", NOSE_UP)
    monkeypatch.setattr(limits, "LIMITS", (*limits.LIMITS, nose_up))
    figures = (*FIGURES[:2], over_time("load", "Pitch of the load over time."))
    monkeypatch.setattr("slipfree.show.motion_figures.FIGURES", figures)
    (folder / "p.toml").write_text(PROBLEM)
    result = invoke("run", "p.toml", "-v", "--figures-all", "--csv", "p.csv", "--set", setting)
    run = read("p.nc")
    metadata, greatest = run.columns["nose_up"].metadata, run["nose_up"].max()
    assert metadata == {"units": "rad", "long_name": NOSE_UP.words}
    assert "nose_up" in (folder / "p.csv").read_text().splitlines()[0].split(",")
    assert f" slides off above {np.rad2deg(greatest):.3g} deg (t = " in result.stdout
    fact = json.loads(printed("info", "p.nc", "--json"))["result"]["facts"]["nose_up_greatest"]
    assert (fact["value"], fact["unit"]) == (greatest, "rad")
    assert (folder / "p_figures/load.png").stat().st_size > 1000
    if setting == "time.duration=2":  # before the ramp is as steep
        assert (result.exit_code, run.stop) == (0, None)
        assert greatest < STEEPEST
        return
    assert (result.exit_code, run.stop.name) == (1, "nose_up")
    assert NOSE_UP.words in result.stdout
    assert 3 < run.stop.t < 12
    assert run["pitch"][-1] == pytest.approx(STEEPEST, abs=1e-5)
    assert run["pitch"].max() <= STEEPEST
