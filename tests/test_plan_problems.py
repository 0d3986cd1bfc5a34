"""Plans over real-sized ground: routes, places to keep out of, and what is wrong with them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from slipfree.problem.locate import ProblemError
from slipfree.problem.plan import regions
from slipfree.problem.read import read
from slipfree.problem.run import build, run

FIELD = Path(__file__).parent.parent / "problems" / "plan_crater_field.toml"
SHORT = ("start.y=14.0", "goal.y=24.0", "plan.intervals=12", "time.duration=40.0", "costs.slip=",
         "start.x=17.5", "goal.x=17.5")  # fmt: skip


def test_a_route_around_a_place_to_keep_out_of_is_planned_and_simulated():
    problem = read(FIELD, SHORT)
    motion = run(problem).trajectory
    assert motion.stop is None
    assert np.hypot(motion["x"][-1] - 17.5, motion["y"][-1] - 24.0) < 0.01
    (disc,) = regions(problem, problem.spec)
    reach = np.hypot(1.0, 0.5) + 0.3  # of the rear wheels; the front one reaches 1.3 m
    assert (
        disc.distance(motion["x"], motion["y"]).min() > reach - 0.02
    )  # between the points of 12 intervals


def test_the_start_of_the_search_ends_at_the_goal():
    setup = build(read(FIELD, SHORT))
    assert setup.driven == "plan to x 17.5, y 24"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            ["keep_out=[{ x = 20.0, y = 35.0, radius = 2.0 }]"],
            "the vehicle cannot be at the goal (20, 35): inside the keep-out disc",
        ),
        (
            ["keep_out=[{ x = 1.0, y = 2.0 }]"],
            "keep_out: expected either x, y and radius, or points",
        ),
        (["keep_out=[{ points = [[0, 0], [1, 1]] }]"], "points"),
        (["goal={ heading = 0.0 }"], "a route needs a goal in x and y"),
        (["terrain.friction=0.01"], "needs a friction coefficient of 0.0563, the ground offers"),
    ],
)
def test_what_keeps_a_route_from_being_found_is_told(settings, words):
    with pytest.raises(ProblemError) as error:
        build(read(FIELD, settings))
    assert words in str(error.value)
