"""Tests of plans against an independent transcription: Hermite-Simpson by ``casadi.Opti``."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from helpers.cases import hills
from slipfree import Analytic, direct_kinematics, settle, simulate
from slipfree.catalog import three_wheeler
from slipfree.plan.plan import plan
from slipfree.plan.transcription import Mesh

SLIP, EFFORT, SMOOTH = 1e3, 0.01, 0.002
DURATION, GOAL, STEER = 10.0, (0.15, 1.3), 0.15


def by_opti(dae, start, count):
    """Return the least cost; equations at the ends and the middles, inputs linear between ends."""
    x, z, u = dae.columns()
    z_all = dae.rows("z", start, -1)
    slip = ca.sumsqr(ca.vertcat(*dae.named("slip_along"), *dae.named("slip_across")))
    kept = [k for k in range(z.numel()) if ca.depends_on(ca.vertcat(dae.ode, slip), z[k])]
    first = dae.alg[0].numel() + dae.alg[1].numel()  # pose and rates; the forces follow from them
    assert max(kept) < first
    f = ca.Function(
        "f",
        [x, z[:first], u],
        [dae.ode, ca.vertcat(*dae.alg[:2]), SLIP * slip + EFFORT * ca.sumsqr(u)],
    )
    opti, h = ca.Opti(), DURATION / count
    states, inputs = opti.variable(x.numel(), count + 1), opti.variable(u.numel(), count + 1)
    middles = opti.variable(x.numel(), count)
    ends, insides = opti.variable(first, count + 1), opti.variable(first, count)
    opti.subject_to(states[:, 0] == dae.rows("x", start, -1))
    opti.subject_to(states[:2, -1] == ca.DM(GOAL))
    opti.subject_to(opti.bounded(-STEER, states[3, 1:], STEER))
    values = [f(states[:, k], ends[:, k], inputs[:, k]) for k in range(count + 1)]
    for _, residual, _ in values:
        opti.subject_to(residual == 0)
    cost = 0
    for k in range(count):
        (left, _, paid), (right, _, paid_after) = values[k : k + 2]
        between = (inputs[:, k] + inputs[:, k + 1]) / 2
        slope, residual, paid_inside = f(middles[:, k], insides[:, k], between)
        a, b = states[:, k], states[:, k + 1]
        opti.subject_to(residual == 0)
        opti.subject_to(middles[:, k] == (a + b) / 2 + h / 8 * (left - right))
        opti.subject_to(b == a + h / 6 * (left + 4 * slope + right))
        cost += h / 6 * (paid + 4 * paid_inside + paid_after)
        cost += SMOOTH * ca.sumsqr(inputs[:, k + 1] - inputs[:, k]) / h
    opti.minimize(cost)
    # From a straight line, not from the plan.
    places = np.linspace(0, 1, count + 1)
    run = dae.rows("x", start, -1)[:, None] + np.outer([*GOAL, 0, 0], places)
    opti.set_initial(states, run)
    opti.set_initial(middles, (run[:, 1:] + run[:, :-1]) / 2)
    opti.set_initial(ends, np.tile(z_all[:first, None], count + 1))
    opti.set_initial(insides, np.tile(z_all[:first, None], count))
    opti.set_initial(inputs, 0.45)
    opti.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "max_iter": 500})
    solution = opti.solve()
    return float(solution.value(cost)), solution.value(states)


def planned(dae, start, count):
    rates = dae.inputs(right_rate=0.45, left_rate=0.45, steer_rate=0.0)
    found = plan(
        dae,
        start,
        simulate(dae, start, rates, np.linspace(0, DURATION, 31)),
        goal=dict(zip("xy", GOAL, strict=True)),
        costs={"slip": SLIP, "effort": EFFORT},
        smooth=SMOOTH,
        duration=DURATION,
        limits={"steer": (-STEER, STEER)},
        mesh=Mesh(count, accuracy=1.0),
    )
    assert found.success
    return found


@pytest.mark.slow
def test_an_optimum_is_that_of_another_transcription():
    """The two differ by less than the mesh does: half of the intervals are another plan."""
    dae, count = direct_kinematics(three_wheeler(axle="fixed"), Analytic(hills)), 16
    start = settle(dae)
    coarse, fine = (planned(dae, start, each) for each in (count // 2, count))
    cost, states = by_opti(dae, start, count)
    assert abs(cost - fine.solution.cost) < 0.2 * abs(coarse.solution.cost - fine.solution.cost)
    layout, unknowns = fine.program.layout, fine.solution.unknowns
    places = np.vstack([unknowns[layout.first], unknowns[layout.states[:, -1]]])
    assert np.abs(places.T - states).max() < 5e-3
