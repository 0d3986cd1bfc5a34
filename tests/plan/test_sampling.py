"""Planning by sampling: costs, limits, ranges and seeds of the candidates."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import slipfree as sf
from helpers.commands import refuses

RANGES = {"right_rate": (-1.0, 3.0), "left_rate": (-1.0, 3.0), "steer_rate": (-0.5, 0.5)}


def hills(height=0.1):
    axis = np.linspace(-4.0, 4.0, 41)
    z = height * np.sin(1.2 * axis)[:, None] * np.cos(axis)
    return sf.Bicubic(sf.Grid(axis, axis, z), mu=0.6)


@pytest.fixture(scope="module")
def task():
    model = sf.direct_kinematics(sf.catalog.three_wheeler(axle="fixed"), hills())
    return sf.SamplingTask(
        model,
        {"slip": 1.0},
        {"x": 0.3, "y": 1.0},
        2.0,
        RANGES,
        goal_weight=5.0,
        intervals=5,
        candidates=48,
        compiled=False,
    )


def state(task, run):
    """Return the last state of a motion, in map coordinates."""
    return task.model.rows("x", run, -1) + task.model.shift[0]


def simulated(task, start, found):
    """Return the simulated motion of a result, with 20 samples in each interval."""
    inputs = dict(zip(RANGES, np.repeat(found.inputs, 20, axis=1), strict=True))
    return sf.simulate(task.model, start, task.model.inputs(**inputs), np.linspace(0.0, 2.0, 101))


def test_the_cost_is_that_of_a_simulation(task):
    """Motion and cost of the result are those of simulate, up to the rule of integration."""
    start = sf.settle(task.model, y=-1.0)
    found = sf.sample_plan(task, state(task, start))
    run = simulated(task, start, found)
    assert_allclose(found.x[:2, -1], [run["x"][-1], run["y"][-1]], atol=1e-4)
    slip = (run["slip_along"] ** 2 + run["slip_across"] ** 2).sum(axis=1)
    paid = ((slip[1:] + slip[:-1]) / 2 * np.diff(run.t)).sum()
    away = ((run["x"][-1] - 0.3) ** 2 + (run["y"][-1] - 1.0) ** 2) / task.model.size**2
    assert found.cost == pytest.approx(paid + 5.0 * away, rel=1e-3)


def test_cycles_lower_the_cost_and_reach_the_goal(task):
    """In closed loop, with other hills than planned, the vehicle comes to its goal."""
    world = sf.direct_kinematics(sf.catalog.three_wheeler(axle="fixed"), hills(0.13))
    here, found, costs = sf.settle(world, y=-1.0), None, []
    for _ in range(12):
        found = sf.sample_plan(task, state(task, here), found)
        costs.append(found.cost)
        for name, row in zip(RANGES, found.inputs, strict=True):
            assert RANGES[name][0] <= row.min() <= row.max() <= RANGES[name][1]
        inputs = world.inputs(**dict(zip(RANGES, found.inputs[:, :1], strict=True)))
        here = sf.simulate(world, here, inputs, [0.0, 0.4]).part(slice(-1, None))
    assert costs[-1] < 0.1 * costs[0]
    assert np.hypot(here["x"][-1] - 0.3, here["y"][-1] - 1.0) < 0.25


def test_the_seed_decides_and_threads_do_not(task, tmp_path_factory, monkeypatch):
    monkeypatch.setenv("SLIPFREE_CACHE", str(tmp_path_factory.getbasetemp().parent / "compiled"))
    x = state(task, sf.settle(task.model, y=-1.0))
    one = sf.sample_plan(replace(task, compiled=True), x)
    two = sf.sample_plan(replace(task, compiled=True, threads=2), x)
    assert_array_equal(two.inputs, one.inputs)
    assert_allclose(sf.sample_plan(task, x).inputs, one.inputs, atol=1e-9)
    assert (sf.sample_plan(replace(task, seed=1), x).inputs != one.inputs).any()
    # candidates that leave the map, and rough ground where steps are repeated
    x = state(task, sf.settle(task.model, y=2.0))
    far = {"x": 0.0, "y": 6.0}
    names = sf.sample_plan(replace(task, compiled=True), x, goal=far).ends
    assert names == sf.sample_plan(task, x, goal=far).ends
    assert names


def test_forces_are_costs(task):
    """The drives' torques follow from the motion; their cost is that of a simulation."""
    squares = ca.sumsqr(ca.vertcat(*task.model.named("drive_torque")))
    costs = [sf.Cost("torque", squares, "N2 m2 s", "squared torques")]
    loaded = replace(task, costs=costs, goal={}, candidates=1)
    start = sf.settle(task.model, y=-1.0)
    found = sf.sample_plan(loaded, state(task, start))
    run = simulated(task, start, found)
    paid = np.trapezoid((run["drive_torque"] ** 2).sum(axis=1), run.t)
    assert found.cost == pytest.approx(paid, rel=0.05)  # trapezoids of 0.4 s


def test_samples_of_a_plan_are_tracked(task):
    """Values at every sample are followed; the last ones alone leave the way open."""
    start = state(task, sf.settle(task.model, y=-1.0))
    y = -1.0 + 0.25 * task.t
    found = None
    for _ in range(8):
        found = sf.sample_plan(task, start, found, elapsed=0.0, goal={"x": 0 * y, "y": y})
    assert np.abs(found.x[1] - y).max() < 0.05
    with pytest.raises(sf.ModelError, match="goal: y: expected a number or one for each of the"):
        sf.sample_plan(task, start, goal={"y": y[:3]})
    with pytest.raises(sf.ModelError, match=r"expected finite values of the states x, y, heading"):
        sf.sample_plan(task, start[:2])
    refuses(sf.ModelError, "unknown 'z'", sf.sample_plan, task, start, goal={"z": 1.0})


def test_regions_that_are_seen_late_are_avoided(task):
    """An obstacle between start and goal: no motion that is returned enters it."""
    start, found = state(task, sf.settle(task.model, y=-1.0)), None
    rock = sf.Region.disc(0.05, 0.0, radius=0.35)
    straight = sf.sample_plan(task, start)
    for _ in range(6):
        found = sf.sample_plan(task, start, found, elapsed=0.0, keep_out=[rock])
    assert "the platform enters a keep-out region" in found.ends
    assert np.isfinite(found.cost)
    line = np.linspace(found.x[:2, :-1], found.x[:2, 1:], 9)
    assert rock.distance(*np.moveaxis(line, 1, 0)).min() > -0.01
    assert straight.complete > found.complete
    wall = sf.Region.disc(0.0, -1.5, radius=0.52)  # the start is 2 cm inside: it may leave
    assert np.isfinite(sf.sample_plan(task, start, keep_out=[wall]).cost)


@pytest.mark.slow  # a closed loop
@pytest.mark.parametrize("seed", [0, 1])
def test_an_obstacle_that_appears_on_the_way_is_passed(task, seed):
    """Seen at 0.9 m, with 5 cm to spare, on other hills than planned; the goal lies behind it."""
    world = sf.direct_kinematics(sf.catalog.three_wheeler(axle="fixed"), hills(0.13))
    x = np.random.default_rng(seed).uniform(-0.1, 0.2)
    rock, kept = (sf.Region.disc(x, 0.2, radius=radius) for radius in (0.25, 0.3))
    aware = replace(
        task, goal={"x": 0.1, "y": 1.4}, span=4.0, intervals=8, candidates=64, seed=seed
    )
    here, found, path = sf.settle(world, y=-1.0), None, []
    for _ in range(50):
        at = state(task, here)
        seen = [kept] if np.hypot(at[0] - x, at[1] - 0.2) < 0.9 else []
        found = sf.sample_plan(aware, at, found, elapsed=0.4, keep_out=seen)
        inputs = world.inputs(**dict(zip(RANGES, found.inputs[:, 0], strict=True)))
        run = sf.simulate(world, here, inputs, np.linspace(0.0, 0.4, 9))
        path.append(rock.distance(run["x"], run["y"]).min())
        here = run.part(slice(-1, None))
        if np.hypot(here["x"][-1] - 0.1, here["y"][-1] - 1.4) < 0.2:
            break
    assert min(path) > 0
    assert np.hypot(here["x"][-1] - 0.1, here["y"][-1] - 1.4) < 0.2


def test_candidates_with_a_second_contact_have_no_weight(task):
    """A trench narrower than a wheel crosses the way: the vehicle stays before it."""
    axis = np.linspace(-4.0, 4.0, 161)
    z = np.where(np.abs(axis - 0.6) < 0.06, -0.15, 0.0) * np.ones((161, 1))
    model = sf.direct_kinematics(task.model.vehicle, sf.Bicubic(sf.Grid(axis, axis, z)))
    trench = replace(task, model=model)
    found = sf.sample_plan(trench, state(trench, sf.settle(model, y=-1.0)))
    assert any("apart from the contact point" in words for words in found.ends)
    assert np.isfinite(found.cost)


def test_candidates_that_leave_the_map_have_no_weight(task):
    """Near the edge, towards a goal beyond it, the result stays on the map."""
    far = replace(task, goal={"x": 0.0, "y": 6.0}, candidates=64)
    found = sf.sample_plan(far, state(task, sf.settle(task.model, y=2.0)))
    assert found.complete < 1.0
    assert any("leaves the map" in words for words in found.ends)
    assert np.isfinite(found.cost)
    assert np.isfinite(found.x).all()


def test_early_ends_have_infinite_cost_and_starts_beyond_a_limit_are_named(task):
    """Where all candidates end early, the longest motion is kept; a wrong start says why."""
    edge = replace(task, candidates=4, ranges=RANGES | {"right_rate": (3, 3), "left_rate": (3, 3)})
    start = state(task, sf.settle(task.model, y=2.6))
    found = sf.sample_plan(edge, start)
    assert found.complete == 0.0
    assert found.cost == np.inf
    assert np.isnan(found.x[0, -1])
    start[1] = 3.6  # metres: the front wheel is off the map
    words = "cannot start at this state: wheel front leaves the map"
    refuses(sf.SolverError, words, sf.sample_plan, edge, start)


def test_inputs_are_shifted_by_the_time_since_the_last_cycle(task):
    """Without noise and weight, a cycle repeats the later inputs of the one before."""
    quiet = replace(task, candidates=1)
    start = state(task, sf.settle(task.model, y=-1.0))
    first = sf.sample_plan(quiet, start)._replace(
        inputs=np.outer([1.0, 1.0, 0.0], np.arange(5.0) / 2)
    )
    for elapsed, shift in ((None, 1), (0.8, 2), (0.2, 0.5), (9.0, 4)):
        later = sf.sample_plan(quiet, start, first, elapsed=elapsed)
        times = np.minimum(np.arange(5) + shift, 4)
        expected = [np.interp(times, np.arange(5), row) for row in first.inputs]
        assert_allclose(later.inputs, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"span": 0.0}, "span: expected a number > 0"),
        ({"candidates": 0}, "candidates: expected a number >= 1, found 0"),
        ({"candidates": "9"}, "candidates: expected an integer, found str '9'"),
        ({"ranges": {"right_rate": (0, 1)}}, "ranges: expected one for each input"),
        ({"ranges": RANGES | {"left_rate": (1, 0)}}, "left_rate.*: expected ascending bounds"),
        ({"goal": {"speed": 1.0}}, "unknown 'speed'"),
    ],
)
def test_wrong_tasks_are_named(task, changes, message):
    refuses(sf.ModelError, message, replace, task, **changes)
