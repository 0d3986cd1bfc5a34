"""Random runs with inertia: each completes, ends at a named limit, or is refused.

Energy balances within 100 x tolerance; mirror images and turned runs agree. ``python
benchmarks random_runs drives`` does this for 300; here every vehicle, drive and ground is drawn.
``python benchmarks random_runs overturns`` runs 100 hang-ups and roll-overs.
"""

import numpy as np
import pytest

from helpers import random_overturns
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
OVERTURNED = range(9)
ENDS = {"upright", "upright, body on the ground", "on its side", "on its roof, body on the ground"}


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


def test_energy_balances_at_any_tolerance():
    """The vehicle falls, in large steps; 3.1 by the default of CVODES's Newton method."""
    case = draw(179)
    for tolerance in np.geomspace(1e-5, 1e-9, 3):
        assert ledger(run(case, tolerance=tolerance), tolerance) < 1, tolerance


@pytest.mark.parametrize(
    ("index", "view"), [(60, "mirrored"), (100, "turned"), (160, "mirrored")]
)  # on hills, a ledge and a map
def test_mirrored_and_turned_runs_agree(index, view):
    """Until a wheel leaves the ground or slides; rounding is all that differs."""
    assert difference(draw(index), view) < 10 * TOLERANCE


def test_hang_ups_and_roll_overs_end_as_they_should():
    """A run ends at a limit, or with the vehicle upright, on its side or roof; energy balances."""
    kinds = set()
    for index in OVERTURNED:
        case = random_overturns.draw(index)
        found = random_overturns.ending(case)
        kinds.add(found.kind)
        assert found.kind not in ("failure", "unfinished", "not finite"), (case.words, found)
        assert found.ledger < 1, (case.words, found)
    assert kinds >= ENDS, kinds
