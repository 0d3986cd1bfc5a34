"""Add a limit: one function and one line of registration, in one file.

The function `nose_up` below and its name in the tuple ``LIMITS``, both in ``models/limits.py``, are
all that it takes (4 lines); nothing else of the package knows it. Every model of a vehicle has it,
commands end a motion there by name, and results have its column.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from helpers.commands import invoke
from slipfree.core.dae import Limit
from slipfree.core.records import Label
from slipfree.files.netcdf import read
from slipfree.models import limits
from slipfree.models.base import Quantities

STEEPEST = 0.1


def nose_up(q: Quantities) -> Iterator[Limit]:
    """Yield the pitch at which the load slides off the platform."""
    label = Label("nose_up", "rad", "the load slides off the platform (pitch)")
    yield Limit(label, q.position.pitch, -np.inf, STEEPEST)


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
@pytest.mark.usefixtures("folder")
def test_a_limit_ends_the_motions_of_all_models(setting, monkeypatch):
    monkeypatch.setattr(limits, "LIMITS", (*limits.LIMITS, nose_up))
    Path("p.toml").write_text(PROBLEM)
    result = invoke("run", "p.toml", "--no-draw", "--set", setting)
    run = read(Path("p.nc"))
    if setting == "time.duration=2":  # before the ramp is as steep
        assert (result.exit_code, run.stop) == (0, None)
        assert run["nose_up"].max() < STEEPEST
        return
    assert result.exit_code == 1, result.output
    assert "the load slides off the platform (pitch)" in result.stdout
    assert run.stop is not None
    assert run.stop.name == "nose_up"
    assert 3 < run.stop.t < 12
    assert run["pitch"][-1] == pytest.approx(STEEPEST, abs=1e-5)
    assert run["pitch"].max() <= STEEPEST
