"""Tests of collocation: exact derivatives, order on a known solution, known optima."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.toy_models import task, toy
from slipfree import ModelError
from slipfree.core.dae import Limit
from slipfree.core.records import Label
from slipfree.plan.constraints import conflicts
from slipfree.plan.explanation import violations
from slipfree.plan.ipopt import solve_program
from slipfree.plan.transcription import CollocationMesh, Cost, TimedCondition, completed, transcribe


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
def test_derivatives_are_those_of_the_functions(continuous, rng):
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
    program = transcribe(asked, CollocationMesh(np.array([0.0, 0.3, 0.4, 1.0]), 2))
    w, p, f, g = (program.problem[name] for name in "xpfg")
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


def test_a_degree_that_is_not_offered_is_refused():
    dae = toy(1, lambda _t, _x, _z, u: [u])
    with pytest.raises(ModelError, match="expected a degree of 1 to 5, found 6"):
        transcribe(task(dae, [0.0]), CollocationMesh(np.linspace(0, 1, 3), 6))
