"""Random runs with inertia: each completes, ends at a named limit, or is refused.

Energy balances within 100 x tolerance; mirror images and turned runs agree. ``python
benchmarks random_runs drives`` does this for 300; here every vehicle, drive and ground is drawn.
"""

from __future__ import annotations

import numpy as np
import pytest

from helpers.random_dynamics import (
    GROUNDS,
    TOLERANCE,
    VEHICLES,
    difference,
    draw,
    ending,
    ledger,
    run,
)

pytestmark = pytest.mark.slow

DRAWN = (0, 1, 3, 5, 16, 20, 26, 139)
VIEWED = (60, 100, 160)  # on hills, a ledge and a map


def test_every_vehicle_drive_and_ground_is_drawn():
    words = [draw(index).words.partition(": ")[2] for index in DRAWN]
    drawn = {word for each in words for word in each.split(", ")[:3]}
    assert drawn == {*VEHICLES, *GROUNDS, "rate", "torque", "motor", "mixed"}


@pytest.mark.parametrize("index", DRAWN)
def test_random_runs_end_as_they_should(index):
    case = draw(index)
    found = ending(case)
    assert found.kind in ("complete", "limit", "refused"), (case.words, found)
    assert (found.kind == "complete") == (found.words == ""), (case.words, found)
    assert found.ledger < 1, (case.words, found)


@pytest.mark.parametrize("index", [179, 261])
def test_energy_balances_at_any_tolerance(index):
    """Both vehicles fall, in large steps; 3.1 and 2.5 by the default of CVODES's Newton method."""
    case = draw(index)
    for tolerance in np.geomspace(1e-5, 1e-9, 5):
        assert ledger(run(case, tolerance=tolerance), tolerance) < 1, tolerance


@pytest.mark.parametrize("index", VIEWED)
@pytest.mark.parametrize("view", ["mirrored", "turned"])
def test_mirrored_and_turned_runs_agree(index, view):
    """Until a wheel leaves the ground or slides; rounding is all that differs."""
    assert difference(draw(index), view) < 10 * TOLERANCE
