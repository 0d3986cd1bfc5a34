"""Tests of the verification of plans: simulation, mesh, points between, and warm start."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import slipfree as sf
from helpers.cases import BOUNDED_RATES, hills
from slipfree.catalog import three_wheeler
from slipfree.core.dae import Limit
from slipfree.core.records import Label
from slipfree.plan import search as searching
from slipfree.plan import verification as proof
from slipfree.plan.plan import plan
from slipfree.plan.polynomial_motion import motion_of, transfer_motion
from slipfree.plan.problem import limits_of
from slipfree.plan.transcription import CollocationMesh
from slipfree.plan.verification import Verification, refine_mesh, simulate_plan

VEHICLE = three_wheeler(axle="fixed")


@pytest.fixture(scope="module")
def model():
    dae = sf.direct_kinematics(VEHICLE, sf.Analytic(hills))
    return dae, sf.settle(dae)


def guess(model, rate=0.45, turn=0.0, duration=10.0):
    dae, start = model
    inputs = dae.inputs(right_rate=rate + turn, left_rate=rate - turn, steer_rate=0.0)
    return sf.simulate(dae, start, inputs, np.linspace(0, duration, 31))


def asked(model, *guesses, goal=(0.1, 1.3), **options):
    given = {
        "costs": {"slip": 1e3, "effort": 0.01},
        "duration": 10.0,
        "smooth": 0.002,
        "inputs": BOUNDED_RATES,
        "mesh": sf.Mesh(8),
    } | options
    return plan(*model, guesses or guess(model), goal=dict(zip("xy", goal, strict=True)), **given)


def iterations(found):
    return sum(stage.iterations for stage in found.stages)


@pytest.fixture(scope="module")
def coarse(model):
    return asked(model)


@pytest.mark.slow
def test_the_course_is_the_plan_at_its_points_and_the_simulation_between(coarse):
    way, run = coarse.motion, coarse.run
    names = ("x", "y", "heading", "steer")
    assert_allclose(
        way.states(coarse.program.mesh.nodes), [run[name] for name in names], atol=1e-12
    )
    replay = coarse.replay
    between = way.states(replay.t / way.duration)
    gaps = np.abs(between - [replay[name] for name in names]).max(axis=1)
    assert_allclose(gaps, list(coarse.difference.values()), atol=1e-12)
    assert gaps.max() < 1e-3


@pytest.mark.slow
def test_a_time_limit_that_is_not_reached_changes_nothing(model, coarse):
    found = asked(model, search=sf.Search(seconds=1e4))
    assert_array_equal(found.motion.unknowns, coarse.motion.unknowns)


@pytest.mark.slow
@pytest.mark.parametrize("continuous", [False, True])
def test_inputs_are_constant_or_linear_on_every_interval_and_so_simulated(model, continuous):
    found = asked(model, mesh=sf.Mesh(5, continuous=continuous))
    replay, ends = found.replay, found.motion.ends
    rates, parts = replay["right_rate"], (replay.t.size - 1) // 5
    if continuous:
        values = found.solution.unknowns[found.motion.layout.inputs][:, 0]
        assert_allclose(rates, np.interp(replay.t, ends, values), atol=1e-12)
        return
    inner = rates[:-1].reshape(5, parts)  # at a jump the value after it
    assert_allclose(inner, np.repeat(inner[:, -1:], parts, axis=1), atol=1e-12)


@pytest.mark.slow
def test_a_mesh_is_refined_until_the_simulation_agrees(model):
    """The simulation is so exact that the difference is the collocation's error."""
    mesh, options = sf.Mesh(4, degree=2), sf.SolverOptions(tolerance=1e-11)
    coarse = asked(model, mesh=mesh, options=options)
    wanted = max(coarse.difference.values()) / 10
    found = asked(model, mesh=replace(mesh, accuracy=wanted), options=options)
    assert (coarse.accurate, found.accurate) == (True, True)
    assert max(found.difference.values()) <= wanted
    assert set(coarse.motion.mesh.ends) < set(found.motion.mesh.ends)
    assert found.stages[-1].words.endswith("intervals")


@pytest.mark.slow
def test_a_plan_that_no_mesh_makes_accurate_is_its_simulation_with_the_goal_moved(
    model, monkeypatch
):
    monkeypatch.setattr(searching, "MAX_REFINEMENTS", 0)
    options = {"mesh": sf.Mesh(4, degree=1), "duration": (5.0, 20.0)}
    found = asked(model, way_points={0.5: {"x": (0.02, 0.05)}}, **options)
    assert {stage.words for stage in found.stages[2:-1]} == {"moved goal"}
    assert found.stages[-1].words == "simulation"
    assert (found.accurate, found.optimality, found.prices) == (True, None, ())
    assert max(found.difference.values()) < 1e-3
    end, k = found.replay, np.abs(found.replay.t - found.replay.t[-1] / 2).argmin()
    assert_allclose([end["x"][-1], end["y"][-1]], (0.1, 1.3), atol=1e-3)
    assert 0.02 - 1e-3 < end["x"][k] < 0.05 + 1e-3
    again = motion_of(found.program, found.solution.unknowns).states(end.t / end.t[-1])
    assert_allclose(again[1], end["y"], atol=1e-3)
    assert found.solution.cost == pytest.approx(
        1e3 * found.costs["slip"] + 0.01 * found.costs["effort"] + 0.002 * found.costs["smoothness"]
    )


@pytest.mark.parametrize(
    ("errors", "count"),
    [
        ([1.0, 1.0, 1.1, 0.0], 3),  # two refinements without success
        ([1.0, 1.2, 0.5, 0.45, 0.1, 0.0], 6),  # one without success
        ([1.0, 0.9, 0.85, 0.8], 3),  # slow progress
    ],
)
def test_refinement_ends_if_the_error_remains(coarse, monkeypatch, errors, count):
    """The angle of a caster driven backwards differs from the plan on every mesh."""
    program, left = coarse.program, iter(errors)
    search = searching.SearchState(program, coarse.solution, coarse.solution.unknowns, ())
    verified = []

    def verify(_search):
        error = next(left)
        verified.append(error)
        worse = np.array([error > 0])
        return Verification(coarse.replay, {"x": error}, {}, {"x": "m"}, worse, accurate=not error)

    def halved(mesh, _worse):
        return refine_mesh(mesh, np.ones(mesh.ends.size - 1, dtype=bool))

    monkeypatch.setattr(searching, "refine_mesh", halved)
    monkeypatch.setattr(searching, "transcribe", lambda _, mesh, __: replace(program, mesh=mesh))
    monkeypatch.setattr(
        searching, "_solve_anew", lambda old, new, *_, **__: old._replace(program=new)
    )
    monkeypatch.setattr(searching, "_add_limits", lambda found, _progress: found)
    _, verification = searching._refine(search, verify, None)
    assert (len(verified), verification.difference["x"]) == (count, min(verified))


@pytest.mark.slow
def test_what_is_violated_between_the_points_is_told_and_made_small(model):
    """A disc that a straight way would cross; on two long intervals the way bulges into it."""
    x, y = model[0].x.x, model[0].x.y
    apart = Limit(Label("disc", "m", "too near"), (x - 0.02) ** 2 + (y - 0.7) ** 2, 0.2**2, np.inf)
    options = {
        "limits": (apart,),
        "costs": {"effort": 1.0},
        "options": sf.SolverOptions(tolerance=1e-6),
    }
    found = asked(model, **options, mesh=sf.Mesh(3, degree=2, accuracy=1.0))
    assert found.success
    replay = found.replay
    distance = (replay["x"] - 0.02) ** 2 + (replay["y"] - 0.7) ** 2
    k = distance.argmin()
    assert found.violation["disc"] == pytest.approx(0.04 - distance[k], abs=1e-9)
    at = f"at t = {replay.t[k]:.4g} s, x = {replay['x'][k]:.2f} m, y = {replay['y'][k]:.2f} m"
    assert proof.obstacle_words(found.program.task, replay, 1e-3).endswith(f" m {at}")
    finer = asked(model, **options, mesh=sf.Mesh(3, degree=2))
    assert finer.accurate
    assert not proof.obstacle_words(finer.program.task, finer.replay, 1e-3)


def test_a_limit_of_the_plan_that_the_model_has_too_is_verified_as_given(model, coarse):
    least, found = coarse.replay["tip_over"].min(), (coarse.solution.unknowns, model[1])
    for low, over in ((least - 0.1, None), (least + 0.1, pytest.approx(0.1, abs=1e-6))):
        task = replace(coarse.program.task, limits=limits_of(model[0], {"tip_over": (low, 9.0)}))
        shown = proof.verify_plan(
            replace(coarse.program, task=task), *found, accuracy=1e-3, step=0.1
        )
        assert (shown.violation.get("tip_over"), shown.accurate) == (over, over is None)


COARSE = ["without slip cost", "with slip cost"]
AGAIN = [f"from a motion without costs, {each}" for each in COARSE]
FINER = [*COARSE, "8 intervals"]


def get_stuck(monkeypatch, at, status="Restoration_Failed"):
    """Let the search ``at`` an index get stuck."""
    answers = [*[{}] * at, {"status": status, "success": False}]
    left, solve = iter(answers), searching.ipopt.solve_program

    def stuck(*args, **options):
        return solve(*args, **options)._replace(**next(left, {}))

    monkeypatch.setattr(searching.ipopt, "solve_program", stuck)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("at", "status", "most", "words"),
    [
        (0, "Restoration_Failed", 80, [*COARSE[:1], *AGAIN]),
        (0, "Maximum_Iterations_Exceeded", 80, COARSE),
        (3, "", 4, FINER),
        (2, "Restoration_Failed", 4, [*FINER, *(f"8 intervals, {each}" for each in COARSE)]),
    ],
)
def test_a_search_that_gets_stuck_starts_again(model, coarse, monkeypatch, at, status, most, words):
    """From a motion that meets all constraints; after a search on a coarser mesh from the guess."""
    get_stuck(monkeypatch, at, status)
    monkeypatch.setattr(searching, "MOST_AT_ONCE", most)
    plan = asked(model)
    assert ([stage.words for stage in plan.stages], plan.run.stop) == (words, None)
    assert_array_equal(plan.program.mesh.ends, coarse.program.mesh.ends)
    assert plan.solution.cost == pytest.approx(coarse.solution.cost, rel=1e-6)


@pytest.mark.slow
def test_a_plan_starts_from_itself_and_from_others(model, coarse):
    again = asked(model, search=sf.Search(resume=coarse.saved))
    assert (again.success, again.stages[0].words) == (True, "from the previous plan")
    assert again.stages[0].iterations <= 3
    assert_allclose(again.run["x"], coarse.run["x"], atol=1e-8)
    moved = asked(model, goal=(0.105, 1.365), search=sf.Search(resume=coarse.saved))
    assert moved.success
    assert iterations(moved) <= iterations(coarse) / 2
    assert asked(model, search=sf.Search(resume=coarse.saved), mesh=sf.Mesh(13, degree=4)).success
    ground = sf.Analytic(lambda x, y: hills(x, y) + 0.01 * x)
    dae = sf.direct_kinematics(VEHICLE, ground)
    assert asked((dae, sf.settle(dae)), search=sf.Search(resume=coarse.saved)).success


@pytest.mark.slow
def test_limits_on_which_a_plan_rests_are_there_when_it_is_resumed(monkeypatch):
    vehicle = three_wheeler(axle="fixed", center_of_mass=(0.0, 0.0, 6.0))
    dae = sf.direct_kinematics(vehicle, sf.Analytic(hills))
    high = dae, sf.settle(dae)
    first = guess(high, duration=8.0)
    options = {"goal": (0.1, 1.0), "duration": 8.0, "costs": {"effort": 1.0}}
    found = asked(high, first, **options)
    assert (found.success, found.stages[1].words[:13]) == (True, "with tip_over")
    assert found.run["tip_over"].min() > 0
    again = asked(high, first, **options, search=sf.Search(resume=found.saved))
    assert [stage.words for stage in again.stages] == ["from the previous plan"]
    assert again.stages[0].iterations <= found.stages[1].iterations
    get_stuck(monkeypatch, 1)
    anew = asked(high, first, **options)
    assert (anew.success, anew.stages[2].words) == (True, "from a motion without costs, all costs")


def test_unknowns_are_carried_to_a_finer_mesh(coarse):
    mesh = CollocationMesh(np.array([0.0, 0.5, 1.0]), 2)
    assert_allclose(refine_mesh(mesh, np.array([False, True])).ends, [0, 0.5, 0.75, 1])
    program = coarse.program
    same = transfer_motion(coarse.motion, program)
    assert_allclose(same, coarse.solution.unknowns, atol=1e-10)
    assert motion_of(program, same).duration == coarse.motion.duration


def test_another_model_runs_under_the_inputs_of_a_plan(coarse):
    dae = sf.quasi_statics(VEHICLE, sf.Analytic(hills, mu=0.6))
    run = simulate_plan(
        dae, sf.settle(dae), coarse.motion, step=0.25, options=sf.SolverOptions(tolerance=1e-6)
    )
    assert run.stop is None
    assert abs(run["y"][-1] - coarse.replay["y"][-1]) < 5e-3


@pytest.mark.slow
def test_a_stopped_refinement_leaves_the_plan_before_it(model, coarse):
    found = asked(
        model,
        mesh=sf.Mesh(8, accuracy=max(coarse.difference.values()) / 10),
        search=sf.Search(progress=lambda words, _: "intervals" not in words),
    )
    assert (found.success, found.accurate) == (True, False)
    assert_allclose(found.run["x"], coarse.run["x"], atol=1e-9)
    assert found.stages[-1].status == "User_Requested_Stop"


@pytest.mark.slow
def test_a_plan_goes_on_from_a_place_on_its_way(coarse):
    """Half the way later, on a model whose local coordinates begin there."""
    half = coarse.motion.states(np.array([0.5]))[:, 0]
    dae = sf.direct_kinematics(VEHICLE, sf.Analytic(hills))
    start = sf.settle(dae, **dict(zip(("x", "y", "heading", "steer"), half, strict=True)))
    found = asked((dae, start), duration=5.0, search=sf.Search(resume=coarse.saved))
    assert found.success
    cold = asked((dae, start), guess((dae, start), duration=5.0), duration=5.0)
    assert iterations(found) < iterations(cold)
    assert_allclose([found.run["x"][-1], found.run["y"][-1]], [0.1, 1.3], atol=1e-6)


def test_the_plan_of_another_vehicle_is_refused(coarse):
    dae = sf.direct_kinematics(three_wheeler(), sf.Analytic(hills))
    other = dae, sf.settle(dae)
    with pytest.raises(sf.ModelError, match="expected a saved plan with the states, unknowns"):
        asked(other, guess(other), search=sf.Search(resume=coarse.saved))


@pytest.mark.slow
def test_an_accuracy_that_is_not_reached_and_a_goal_that_is_missed_are_told(model, monkeypatch):
    monkeypatch.setattr(searching, "MAX_REFINEMENTS", 1)
    monkeypatch.setattr(searching, "MAX_CORRECTIONS", 0)  # or the simulation would be the plan
    found = asked(model, mesh=sf.Mesh(2, degree=1, accuracy=1e-9), costs={"effort": 1.0})
    assert (found.success, found.accurate) == (True, False)
    assert found.violation["y at the goal"] == pytest.approx(abs(found.replay["y"][-1] - 1.3))
