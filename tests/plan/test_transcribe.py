"""Tests of collocation: exact derivatives, order, known optima, elements at once, windows."""

import pickle
from functools import partial
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import slipfree as sf
from helpers.cases import hills
from helpers.commands import refuses
from helpers.toy_models import task, toy
from slipfree.catalog import three_wheeler
from slipfree.core import lookups
from slipfree.core.dae import Limit
from slipfree.core.lookups import OPERATIONS, evaluate, evaluate_lanes, in_lanes
from slipfree.core.records import Label
from slipfree.plan.constraints import conflicts
from slipfree.plan.explanation import violations
from slipfree.plan.ipopt import solve_program
from slipfree.plan.polynomial_motion import first_intervals, joined_motions
from slipfree.plan.problem import task_of
from slipfree.plan.sparse_assembly import assemble, nlp_block
from slipfree.plan.transcription import CollocationMesh, Cost, TimedCondition, completed, transcribe
from slipfree.plan.verification import simulate_plan
from slipfree.plan.windows import plan_windows


def at_end(*values):
    """Return conditions by which quantities have given values, one limit each."""
    return tuple(
        Limit(Label(f"end{k}", "m", ""), quantity, value, value)
        for k, (quantity, value) in enumerate(values)
    )


def solved(program, first=None):
    """Solve with weights of one; the duration of the guess is the least allowed."""
    w = np.zeros(program.scale.size) if first is None else first
    w[program.layout.duration] = program.task.duration[0]
    weights = np.append(np.ones(len(program.task.costs)), program.task.smooth)
    found = solve_program(program, weights, w)
    assert found.success
    return found


def shift_at_rest(cost="effort", places=(), **options):
    """A task for x'' = u, at rest from 0 to 1."""
    dae = toy(2, lambda _t, x, _z, u: [x[1], u])
    (x, v), u = dae.x.values, dae.u.values[0]
    paid = u**2 if cost == "effort" else ca.SX(1)
    ways = [TimedCondition(part, at_end((u, value))) for part, value in places]
    ways.append(TimedCondition(1.0, at_end((x, 1.0), (v, 0.0))))
    return task(dae, [0.0, 0.0], costs=[Cost(cost, paid, "", "")], places=ways, **options)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
def test_order_at_the_ends_of_intervals_is_twice_the_degree_less_one(degree):
    """x' = cos t z / x, z = x^2: x = exp(sin t)."""
    dae = toy(1, lambda t, x, z, _u: [ca.cos(t) * z / x[0]])
    counts = {1: (64, 128, 256), 2: (16, 32, 64), 3: (8, 16, 32), 4: (6, 9, 13)}[degree]
    errors = []
    for count in counts:
        mesh = CollocationMesh(np.linspace(0, 1, count + 1), degree)
        program = transcribe(task(dae, [1.0], inputs=(0, 0), duration=4.0), mesh)
        found = solved(program, np.ones(program.scale.size))
        ends = found.unknowns[program.layout.states[:, -1, 0]]
        errors.append(np.abs(ends - np.exp(np.sin(4 * mesh.ends[1:]))).max())
    order = -np.polyfit(np.log(counts), np.log(errors), 1)[0]
    assert order == pytest.approx(2 * degree - 1, abs=0.35)


def test_the_least_effort_of_two_integrators_is_approached_in_second_order():
    """x'' = u, at rest 0 to 1 in 1 s: u = 6 - 12 t, cost 12; inputs are constant by intervals."""
    counts, errors = (5, 10, 20), []
    for count in counts:
        mesh = CollocationMesh(np.linspace(0, 1, count + 1), 3)
        errors.append(solved(transcribe(shift_at_rest(), mesh)).cost - 12)
    # By constants the least is 12 / (1 - 1/n^2): the mean of a line over an interval.
    assert_allclose(errors, [12 / (1 - n**-2.0) - 12 for n in counts], rtol=1e-6)


def test_the_least_effort_of_two_integrators_is_met_by_continuous_inputs():
    """The same; a way-point asks for a u it has."""
    mesh = CollocationMesh(np.array([0.0, 0.1, 0.25, 0.6, 1.0]), 2)
    program = transcribe(shift_at_rest(places=[(0.25, 3.0)], continuous=True), mesh)
    found = solved(program)
    assert program.layout.inputs.shape == (5, 1)
    assert_allclose(found.unknowns[program.layout.inputs][:, 0], 6 - 12 * mesh.ends, atol=1e-9)
    ends = found.unknowns[program.layout.states[:, -1, 0]]
    # Radau points of degree 2 are exact at the ends for cubics.
    assert_allclose(ends, 3 * mesh.ends[1:] ** 2 - 2 * mesh.ends[1:] ** 3, atol=1e-10)
    assert found.cost == pytest.approx(12.0, abs=1e-9)


def test_slopes_of_continuous_inputs_keep_to_their_bounds():
    """x' = u to 7/8 in 2 s, u = 0 there, u' >= -1: the least effort is u = min(1/2, 2 - t)."""
    dae = toy(1, lambda _t, _x, _z, u: [u])
    u = dae.u.values[0]
    goal = TimedCondition(1.0, at_end((dae.x.values[0], 0.875), (u, 0.0)))
    asked = task(
        dae,
        [0.0],
        costs=[Cost("effort", u**2, "", "")],
        places=[goal],
        duration=2.0,
        rates=(-1.0, 5.0),
        continuous=True,
    )
    mesh = CollocationMesh(np.linspace(0, 1, 9), 2)
    program = transcribe(asked, mesh)
    found = solved(program)
    inputs = found.unknowns[program.layout.inputs][:, 0]
    assert_allclose(inputs, np.minimum(0.5, 2 - 2 * mesh.ends), atol=1e-6)
    assert found.cost == pytest.approx(0.375 + 1 / 24, abs=1e-6)


def test_bounds_that_the_last_of_continuous_inputs_misses_are_told_there():
    dae = toy(1, lambda _t, _x, _z, u: [u])
    goal = TimedCondition(1.0, at_end((dae.u.values[0], 3.0)))
    asked = task(dae, [0.0], places=[goal], inputs=(-1.0, 1.0), rates=(0.5, 9.0), continuous=True)
    assert not [words for words in conflicts(asked, None) if "last interval" in words]
    program = transcribe(asked, CollocationMesh(np.linspace(0, 1, 4), 2))
    blank = solve_program(program, np.zeros(1), np.zeros(program.scale.size), iterations=0)
    w = np.zeros(program.scale.size)
    w[program.layout.inputs[:, 0]], w[program.layout.duration] = (0.0, 1.0, 1.0, 3.0), 1.0
    told = {each.label.full: each for each in violations(program, blank._replace(unknowns=w))}
    assert (told["drive"].t, told["drive"].interval, told["drive"].size) == (1.0, 2, 2.0)


def test_the_smoothest_continuous_input_is_known():
    """x' = u to 1 in 1 s, u = 0 there: by lines between n + 1 values the least is 3 / (1 - h2/4).

    Of all functions it is u = 3/2 (1 - t^2), cost 3. Lines through its values have the integral
    (2/3 - h2/6) 3/2 and the squared slopes (4/3 - h2/3) 9/4; they are scaled to reach 1.
    """
    dae = toy(1, lambda _t, _x, _z, u: [u])
    goal = TimedCondition(1.0, at_end((dae.x.values[0], 1.0), (dae.u.values[0], 0.0)))
    for count in (2, 5):
        mesh = CollocationMesh(np.linspace(0, 1, count + 1), 2)
        found = solved(
            transcribe(task(dae, [0.0], places=[goal], smooth=1.0, continuous=True), mesh)
        )
        assert found.cost == pytest.approx(3 / (1 - count**-2 / 4), abs=1e-8)


def test_roots_of_a_cost_are_unknowns_and_change_nothing_but_the_search():
    """Of squares of a formula and of an input, against the same written so that no root is seen."""
    dae = toy(2, lambda t, x, z, u: [x[1] + ca.sin(t) * z, u])
    (x, y), z, u = dae.x.values, dae.z.values[0], dae.u.values[0]
    formula = x * y - z + u * ca.cos(dae.t) - 1
    goal = TimedCondition(1.0, at_end((x, 1.0), (y, 0.5)))
    mesh, found = CollocationMesh(np.linspace(0, 1, 6), 3), []
    for cost in (
        Cost("miss", formula**2 + u**2, "", ""),
        Cost("miss", (2 * formula**2 + 2 * u**2) / 2, "", ""),
    ):
        program = transcribe(task(dae, [0.1, 0.2], costs=[cost], places=[goal]), mesh)
        found.append((program, solved(program)))
    (program, one), (plain, other) = found
    layout, w = program.layout, one.unknowns
    assert layout.roots.shape == (5, 3, 1)
    assert plain.layout.roots.shape == (5, 3, 0)
    assert one.cost == pytest.approx(other.cost, abs=1e-9)
    assert_allclose(w[: layout.duration + 1], other.unknowns, atol=1e-5)
    value = ca.Function("value", [dae.t, ca.vertcat(x, y), z, u], [formula])
    at = zip(
        mesh.nodes[1:],
        w[layout.states].reshape(-1, 2),
        w[layout.unknowns].ravel(),
        np.repeat(w[layout.inputs], 3),
        strict=True,
    )
    expected = [float(value(*each)) for each in at]
    assert_allclose(w[layout.roots].ravel(), expected, atol=1e-7)
    blank = w.copy()
    blank[layout.roots] = 9.0
    assert_allclose(completed(program, blank)[layout.roots].ravel(), expected, atol=1e-13)
    rows = np.array(program.jacobian(blank / program.scale, np.ones(2))[0]).ravel()
    (told,) = violations(program, one._replace(unknowns=blank, rows=rows))
    assert (told.label.full, told.role) == ("miss_root", "equation")
    assert told.size == pytest.approx(9.0 - min(expected), abs=1e-6)


def test_the_least_time_is_known():
    """x'' = u, |u| <= 1, at rest 0 to 1: two seconds, full forward and full back."""
    asked = shift_at_rest("time", inputs=(-1, 1), duration=(0.5, 9.0))
    program = transcribe(asked, CollocationMesh(np.linspace(0, 1, 11), 3))
    found = solved(program, np.ones(program.scale.size))
    assert found.unknowns[program.layout.duration] == pytest.approx(2.0, abs=1e-6)
    inputs = found.unknowns[program.layout.inputs][:, 0]
    assert_allclose(inputs, [1] * 5 + [-1] * 5, atol=1e-6)


def test_a_limit_along_the_way_and_a_way_point_hold():
    dae = toy(1, lambda _t, _x, _z, u: [u])
    x, cost = dae.x.values[0], Cost("effort", dae.u.values[0] ** 2, "", "")
    places = [TimedCondition(0.5, at_end((x, 2.0))), TimedCondition(1.0, at_end((x, 0.0)))]
    low = Limit(Label("square_limit", "m", ""), dae.z.values[0] + 0.1 * x, -np.inf, 4.2)
    asked = task(dae, [0.0], costs=[cost], places=places, limits=[low], duration=4.0)
    program = transcribe(asked, CollocationMesh(np.linspace(0, 1, 9), 3))
    found = solved(program, np.full(program.scale.size, 0.5))
    states = found.unknowns[program.layout.states[..., 0]]
    assert states[3, -1] == pytest.approx(2.0)
    assert (states**2 + 0.1 * states).max() <= 4.2 + 1e-6
    assert found.cost == pytest.approx(4.0, abs=1e-6)  # two metres in two seconds, and back


@pytest.mark.parametrize("continuous", [False, True])
def test_derivatives_are_those_of_the_functions(continuous, rng, monkeypatch):
    """Put together by index they are what CasADi makes of cost and rows as a whole."""
    dae = toy(2, lambda t, x, z, u: [ca.sin(t * x[1]) * u, z * u**2])
    (x, _), z, u = dae.x.values, dae.z.values[0], dae.u.values[0]
    cost = Cost("cost", z * u**2 + ca.cos(x * dae.t), "", "")
    places = [TimedCondition(part, at_end((x * u * dae.t, 1.0))) for part in (0.4, 1.0)]
    limit = Limit(Label("pace", "m", ""), x * u**2, -1.0, 2.0)
    asked = task(
        dae,
        [0.1, 0.2],
        costs=[cost],
        places=places,
        limits=[limit],
        duration=(1.0, 3.0),
        rates=(-1.0, 1.0),
        smooth=0.1,
        continuous=continuous,
    )
    mesh = CollocationMesh(np.array([0.0, 0.3, 0.4, 1.0]), 2)
    w, p, f, g = map(transcribe(asked, mesh).problem.get, "xpfg")
    monkeypatch.setattr(lookups, "MIN_INSTRUCTIONS", 0)
    monkeypatch.setitem(assemble.__globals__, "in_lanes", in_lanes.__wrapped__)
    program = transcribe(asked, mesh)
    at = rng.normal(size=w.numel()) + 1.0, np.array([0.7, 0.2])
    sigma, multipliers = 0.6, rng.normal(size=g.numel())
    rows, slopes = program.jacobian(*at)
    whole = ca.Function("whole", [w, p], [g, ca.jacobian(g, w)])(*at)
    assert_allclose(np.array(rows), np.array(whole[0]), atol=1e-13)
    assert_allclose(np.array(ca.DM(slopes)), np.array(ca.DM(whole[1])), atol=1e-12)
    lagrangian = sigma * f + ca.dot(ca.DM(multipliers), g)
    curved = ca.Function("curved", [w, p], [ca.hessian(lagrangian, w)[0]])(*at)
    half = program.hessian(*at, sigma, multipliers)
    assert_allclose(np.array(ca.DM(half)), np.triu(np.array(ca.DM(curved))), atol=1e-11)


# Elements evaluated at all points at once: equal to one evaluation after the other


@pytest.mark.usefixtures("built")
@pytest.mark.parametrize("count", [1, 300])
def test_lanes_are_what_one_number_after_the_other_gives(count, rng, monkeypatch):
    monkeypatch.setattr(lookups, "MIN_INSTRUCTIONS", 0)
    v, q = ca.SX.sym("v", 2), ca.SX.sym("q")
    value = ca.if_else(v[0] > v[1], ca.fmin(v[0], 0.3) * ca.sin(v[1]), 2 / (1 + v[1] ** 2)) * q
    every = [ca.SX.binary(getattr(ca, f"OP_{name}"), v[0], v[1]) for name in OPERATIONS[4:]]
    f = ca.Function("f", [v, q], [value, ca.triu(ca.hessian(value, v)[0]), ca.vertcat(4, *every)])
    together = in_lanes(f, (count, 1))
    at, factor = rng.uniform(-2.0, 2.0, (count, 2)), 1.7
    for k in range(count):
        for one, found in zip(f(at[k], factor), together(at, factor), strict=True):
            assert_array_equal(np.array(found[k, :]).ravel(), np.array(one.nonzeros()))
    lanes = at.T, np.full((1, count), factor)
    assert_array_equal(evaluate_lanes(f, *lanes), evaluate(f, *lanes)[0])
    kept = pickle.dumps(together)  # serialised, it keeps no slot; another function has it then
    in_lanes.cache_clear()
    del together
    others = [in_lanes(ca.Function("g", [v, q], [value + k]), (count, 1)) for k in range(65)]
    assert others[-1] is None  # there are 64 slots
    assert np.isnan(np.array(pickle.loads(kept)(at, factor)[0])).all()


def test_rows_with_the_same_index_are_summed(rng):
    """Sum of q v^3 over three points, as one row, beside a row of each point."""
    v, q, p = ca.SX.sym("v"), ca.SX.sym("q"), ca.SX.sym("p", 0)
    rows = ca.vertcat(ca.sin(v), q * v**3)
    indices = np.arange(3)[:, None], np.array([[0, 3], [1, 3], [2, 3]])
    constants = np.array([1.0, -2.0, 0.5])
    made = assemble(
        [nlp_block((v, q, p), v**2, rows, (), indices, constants[:, None])], np.ones(3), 0
    )
    w, prices = rng.normal(size=3), rng.normal(size=4)
    g = np.append(np.sin(w), constants @ w**3)
    slopes = np.vstack([np.diag(np.cos(w)), 3 * constants * w**2])
    curvature = np.diag(2 - prices[:3] * np.sin(w) + 6 * prices[3] * constants * w)
    values = ca.Function("v", [made.w, made.p], [made.g])(w, [])
    assert_allclose(np.array(values).ravel(), g, atol=1e-14)
    found, jacobian = made.jacobian(w, [])
    assert_allclose(np.array(found).ravel(), g, atol=1e-14)
    assert_allclose(np.array(ca.DM(jacobian)), slopes, atol=1e-14)
    assert_allclose(np.array(ca.DM(made.hessian(w, [], 1.0, prices))), curvature, atol=1e-14)


# Long plans in windows: transitions, agreement with one plan, interruption, failure

SPEED = 0.3
GOAL = {"x": 0.3, "y": 4.5}
COMMON = {
    "costs": {"slip": 1e4, "effort": 0.01},
    "smooth": 0.002,
    "inputs": dict.fromkeys(("right_rate", "left_rate", "steer_rate"), (-2.0, 2.0)),
}


@pytest.fixture(scope="module")
def case():
    vehicle = three_wheeler(axle="fixed")
    dae = sf.direct_kinematics(vehicle, sf.Analytic(hills))
    start = sf.settle(dae)
    route = sf.Path(np.array([[0.0, 0.0], [0.2, 1.5], [0.35, 3.0], [GOAL["x"], GOAL["y"]]]))
    return dae, partial(sf.follow, dae, speed=SPEED), start, route


def windows(case, **options):
    dae, law, start, route = case
    asked = task_of(dae, start, goal=GOAL, limits=options.pop("limits", {}), **COMMON)
    given = {"speed": SPEED, "length": 1.8, "overlap": 0.6, "mesh": sf.Mesh(8)}
    return plan_windows(asked, law, start, route, **(given | options))


@pytest.fixture(scope="module")
def found(case):
    return windows(case)


def assert_continuous(found, t):
    """Inputs are continuous at the hand-over at time t."""
    around = t / found.motion.duration + np.array([-1e-9, 1e-9])
    before, after = found.motion.inputs(around).T
    assert_allclose(before, after, atol=1e-6)


def assert_repeated(case, found):
    """One simulation of the joined inputs repeats the motion."""
    dae, _, start, _ = case
    options = sf.SolverOptions(tolerance=1e-9)
    again = simulate_plan(dae, start, found.motion, step=0.25, options=options)
    for name in ("x", "y", "heading", "steer"):
        assert_allclose(again[name][-1], found.replay[name][-1], atol=1e-5)


@pytest.mark.slow
def test_the_goal_is_reached_in_several_accurate_windows(case, found):
    assert found.success
    assert found.accurate
    assert len(found.windows) >= 3
    assert found.windows[-1].end == case[-1].length
    run = found.replay
    assert run.stop is None
    assert_allclose([run["x"][-1], run["y"][-1]], list(GOAL.values()), atol=1e-3)
    assert_allclose(run.t[-1], found.motion.duration, rtol=1e-12)
    assert max(found.difference.values()) < 1e-3
    for before, after in pairwise(found.windows):
        assert after.begin < before.end
        assert_allclose(after.t, before.t + before.duration, rtol=1e-12)
        assert_continuous(found, after.t)
    assert_repeated(case, found)


@pytest.mark.slow
def test_windows_cost_little_more_than_one_plan(case, found):
    dae, law, start, route = case
    guess = sf.simulate(dae, start, law(route), np.linspace(0, route.length / SPEED, 61))
    whole = sf.plan(
        dae, start, guess, goal=GOAL, duration=found.motion.duration, mesh=sf.Mesh(36), **COMMON
    )
    assert whole.success

    def total(costs):
        return 1e4 * costs["slip"] + 0.01 * costs["effort"] + 0.002 * costs["smoothness"]

    ratio = total(found.costs) / total(whole.costs)
    assert 0.999 < ratio < 1.1


@pytest.mark.slow
def test_an_interrupted_plan_keeps_its_windows_and_is_resumed(case, found):
    kept = windows(case, progress=lambda words, _iterate: not words.startswith("2 to"))
    assert kept.replay.outcome is sf.Outcome.INTERRUPTED
    assert not kept.success
    assert 1 <= len(kept.windows) < len(found.windows)
    assert kept.replay.t[-1] == pytest.approx(kept.motion.duration)
    resumed = windows(case, resume=kept.saved)
    assert resumed.accurate
    assert_allclose([resumed.replay["x"][-1], resumed.replay["y"][-1]], [0.3, 4.5], atol=1e-3)
    assert_continuous(resumed, kept.motion.duration)
    assert_repeated(case, resumed)
    shared = kept.replay.t.size - 1
    assert_allclose(resumed.replay["y"][:shared], kept.replay["y"][:shared], atol=1e-6)


@pytest.mark.slow
def test_a_window_without_solution_is_named_and_the_others_are_kept(case):
    kept = windows(case, limits={"y": (-1.0, 2.2)}, mesh=sf.Mesh(5))
    assert not kept.success
    assert kept.windows
    assert "m of the route" in kept.replay.stop.words
    assert kept.replay["y"].max() < 2.3


@pytest.mark.slow
def test_parts_of_a_motion_join_to_the_motion(found):
    motion = found.motion
    first = first_intervals(motion, 7)
    assert_allclose(first.duration, motion.ends[7], rtol=1e-12)
    at = np.linspace(0, 1, 20)
    inside = at * first.duration / motion.duration
    assert_allclose(first.states(at), motion.states(inside), atol=1e-12)
    assert_allclose(first.inputs(at), motion.inputs(inside), atol=1e-12)
    twice = joined_motions([first, first])
    assert_allclose(twice.duration, 2 * first.duration)
    assert_allclose(twice.algebraic(at[1:] / 2), first.algebraic(at[1:]), atol=1e-9)


def test_lengths_and_speeds_that_do_not_fit_are_refused(case):
    for change, words in (
        ({"overlap": 1.8}, "overlap shorter than the window"),
        ({"overlap": 0.0}, "overlap shorter than the window"),
        ({"speed": 0.0}, "speed: expected a number > 0, found 0"),
    ):
        refuses(sf.ModelError, words, windows, case, **change)


@pytest.mark.slow
def test_initial_inputs_of_a_plan(case):
    dae, law, start, route = case
    guess = sf.simulate(dae, start, law(route), np.linspace(0, 3, 13))
    goal = {"y": float(guess["y"][-1])}
    still = {"right_rate": 0.0, "left_rate": 0.0, "steer_rate": 0.0}
    wish = {"goal": goal, "duration": 4.0, **COMMON}
    found = sf.plan(dae, start, guess, mesh=sf.Mesh(8), initial_inputs=still, **wish)
    assert found.success
    assert_allclose(found.motion.inputs(np.array([0.0])), 0.0, atol=1e-9)
    with pytest.raises(sf.ModelError, match="initial value of 'left_rate'"):
        sf.plan(dae, start, guess, initial_inputs={"left_rate": 3}, **wish)
