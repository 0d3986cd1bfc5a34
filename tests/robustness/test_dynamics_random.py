"""300 random runs with inertia: each completes, ends at a named limit, or is refused.

Energy balances within 100 x tolerance; mirror images and turned runs agree.
"""

from __future__ import annotations

import numpy as np
import pytest

from helpers.random_dynamics import TOLERANCE, difference, draw, ending, ledger, run

COUNT, BATCH = 300, 10


@pytest.mark.parametrize("begin", range(0, COUNT, BATCH))
def test_random_runs_end_as_they_should(begin):
    for index in range(begin, begin + BATCH):
        case = draw(index)
        found = ending(case)
        assert found.kind in ("complete", "limit", "refused"), (case.words, found)
        assert (found.kind == "complete") == (found.words == ""), (case.words, found)
        assert found.ledger < 1, (case.words, found)


@pytest.mark.parametrize("index", [179, 261])
def test_energy_balances_at_any_tolerance(index):
    """Both vehicles fall, in large steps; 3.1 and 2.5 by the default of CVODES's Newton method."""
    case = draw(index)
    for tolerance in np.geomspace(1e-5, 1e-9, 13):
        assert ledger(run(case, tolerance=tolerance), tolerance) < 1, tolerance


@pytest.mark.parametrize("index", range(0, COUNT, 20))
@pytest.mark.parametrize("view", ["mirrored", "turned"])
def test_mirrored_and_turned_runs_agree(index, view):
    """Until a wheel leaves the ground or slides; rounding is all that differs."""
    assert difference(draw(index), view) < 10 * TOLERANCE


def test_the_draws_differ():
    words = {draw(index).words.partition(": ")[2] for index in range(COUNT)}
    assert len(words) == COUNT
    assert np.ptp([draw(index).speed for index in range(COUNT)]) > 3.5
