"""Random climbs: each completes, ends at a named limit, or is refused; energy balances hold.

The energy balance errs by less than 100 x tolerance x energy. All of climbs 0 to 124 were run
before steps of the integrator had a bound: 47 climb, 12 stall, 15 end at a limit of a joint and 51
are unfinished when the drive ends. Longer drives do not help: with half the distance more, 15 of
the first 33 are unfinished. The test repeats half of 120.
"""

from __future__ import annotations

import pytest

from helpers.random_climbs import GROUP, draw, ending

COUNT, BATCH = 120, 2 * GROUP
GRAZING = 114  # a wheel touches the side of a ramp for 0.4 s, between steady motions
COMPLETE = ("climbs", "stalls", "tips over", "unfinished")


def check(index):
    case = draw(index)
    found = ending(case)
    assert found.kind in (*COMPLETE, "limit", "refused"), (case.words, found)
    assert found.ledger < 1, (case.words, found)


@pytest.mark.parametrize("begin", range(BATCH, COUNT, 2 * BATCH))
def test_random_climbs_end_as_they_should(begin):
    for index in range(begin, begin + BATCH):
        check(index)


def test_a_contact_between_steady_motions_is_not_missed():
    """Without a bound, one step of the integrator passes over the contact."""
    check(GRAZING)
