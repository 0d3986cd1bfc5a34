"""Tests of angles modulo a turn: periodic states, goals, plans compared with simulations."""

from __future__ import annotations

from dataclasses import replace
from math import pi
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from slipfree import Analytic, Mesh, catalog, direct_kinematics, replan, settle, simulate
from slipfree import plan as search
from slipfree.core.dae import Dae
from slipfree.core.records import leaves
from slipfree.plan.mpc import first_cycle, horizon
from slipfree.plan.problem import limits_of, near_conditions, timed_conditions
from slipfree.plan.verification import _compare
from slipfree.solve.sampling import periodic_states, same_turn

GROUND = Analytic(lambda x, y: 0.1 * x * y)


def _periodic(dae: Dae, **limits: tuple[float, float]) -> set[str]:
    x = settle(dae, heading=0.4)
    found = periodic_states(dae, dae.rows("x", x, 0), limits_of(dae, limits))
    return {label.full for label, each in zip(leaves(dae.labels.x), found, strict=True) if each}


def test_headings_and_joints_without_stop_and_spring_are_periodic() -> None:
    cart = catalog.differential_drive()
    assert _periodic(direct_kinematics(cart, GROUND)) == {"heading", "caster_angle"}
    assert _periodic(direct_kinematics(cart, GROUND), heading=(-1.0, 1.0)) == {"caster_angle"}
    steered = catalog.three_wheeler(axle="fixed")
    assert _periodic(direct_kinematics(steered, GROUND)) == {"heading", "steer"}
    coordinates = tuple(
        replace(each, lower=-2.0, upper=2.0) if each.name == "caster_angle" else each
        for each in cart.coordinates
    )
    stopped = direct_kinematics(replace(cart, coordinates=coordinates), GROUND)
    assert _periodic(stopped) == {"heading"}


def test_angles_are_compared_modulo_a_turn() -> None:
    periodic = np.array([True, False])
    values, near = np.array([[3.1, 7.0], [3.1, 7.0]]), np.array([[-3.1, 0.5], [-3.1, 0.5]])
    found = same_turn(values, near, periodic)
    assert_allclose(found, [[3.1 - 2 * pi, 7.0 - 2 * pi], [3.1, 7.0]])


@pytest.mark.parametrize(
    ("goal", "guess", "expected"),
    [
        (0.2 - 4 * pi, 0.0, 0.2),
        (6.0, 0.0, 6.0 - 2 * pi),
        (-3.1416, 0.0, -3.1416),  # both ways are as short: the one as written
        (0.2 + 2 * pi, 6.0, 0.2 + 2 * pi),  # the guess turns around
        (0.2, 6.0, 0.2),
        ((6.0, 7.0), 0.0, (6.0 - 2 * pi, 7.0 - 2 * pi)),
        ((5.0, 12.0), 0.0, (5.0, 12.0)),  # more than a turn
    ],
)
def test_a_goal_is_reached_the_short_way(goal: Any, guess: float, expected: Any) -> None:
    dae = direct_kinematics(catalog.differential_drive(), GROUND)
    given = [*timed_conditions(dae, {"x": 9.0, "heading": goal}, {0.5: {"heading": goal}})]
    periodic = np.array([label.full == "heading" for label in leaves(dae.labels.x)])
    motions = [
        lambda _: np.where(periodic, 0.0, 1.0),
        lambda part: np.where(periodic, guess * part, 1.0),
    ]
    way, end = near_conditions(dae, given, periodic, motions)
    low, high = expected if isinstance(expected, tuple) else (expected, expected)
    x, heading = end.limits
    assert (x.lower, x.upper) == (9.0, 9.0)
    assert (heading.lower, heading.upper) == pytest.approx((low, high))
    assert abs(way.limits[0].lower) <= 2 * pi or isinstance(goal, tuple)


def test_a_caster_that_swings_to_the_other_side_is_no_error() -> None:
    part = np.linspace(0.0, 1.0, 101)
    swing = pi / 2 * (1 + np.tanh(40 * (part - 0.5)))
    planned, periodic = np.stack([swing, part]), np.array([True, False])
    near, gaps = _compare(np.stack([-swing, part]), planned, periodic, 1e-3)
    assert np.abs(near - planned).max() <= pi
    assert np.abs(gaps).max() <= 1e-3
    for wrong in (0.5 * swing, -0.8 * swing, swing + 0.01):  # ends elsewhere
        _, gaps = _compare(np.stack([wrong, part]), planned, periodic, 1e-3)
        assert np.abs(gaps).max() > 5e-3
    _, gaps = _compare(np.stack([-swing, part]), planned, np.zeros(2, dtype=bool), 1e-3)
    assert np.abs(gaps).max() == pytest.approx(2 * pi, abs=1e-3)


def test_a_measured_heading_may_be_a_turn_away_from_the_plan() -> None:
    cart = catalog.differential_drive()
    dae = direct_kinematics(cart, GROUND)
    start = settle(dae)
    guess = simulate(dae, start, dae.inputs(right_rate=1.7, left_rate=1.7), np.linspace(0, 4, 9))
    found = search(
        dae, start, guess, goal={"y": 1.0, "heading": 2 * pi}, costs={"effort": 1.0},
        duration=4.0, mesh=Mesh(4),
    )  # fmt: skip
    assert found.accurate
    assert found.replay["heading"][-1] == pytest.approx(0.0, abs=1e-3)
    window = horizon(found, span=2.0, intervals=2)
    measured = window.plan.states(np.array([0.1])).ravel()
    turned = measured + 2 * pi * np.array(
        [label.full == "heading" for label in leaves(dae.labels.x)]
    )
    first, second = (replan(window, first_cycle(window), 0.4, x) for x in (measured, turned))
    assert_allclose(second.motion.unknowns, first.motion.unknowns, atol=1e-6)
