"""Tests of motion determined by friction, of least utilisation, and of the registry of laws."""

from dataclasses import replace
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import CubicSpline
from scipy.linalg import block_diag
from scipy.optimize import linprog

import slipfree as sf
from helpers.cases import hills
from helpers.commands import error_of, refuses
from helpers.dynamics import slope
from helpers.friction_cases import (
    FIXED,
    UNEQUAL,
    T,
    dissipation,
    from_linear,
    from_rolling,
    least_slip_rates,
    moved,
    order,
    random_starts,
)
from helpers.vehicles import four_wheels
from slipfree.catalog import rigid_skid_steer, three_wheeler
from slipfree.core.records import leaves
from slipfree.models import force_distribution
from slipfree.models.force_distribution import least_utilisation
from slipfree.models.friction_feasibility import best_utilisation
from slipfree.models.kinematics import contact_labels
from slipfree.problem.schema import GROUND_LAWS, SLIP_LAWS
from slipfree.terrain.synthetic import blank, power_law


def standing(vehicle, ground, law=sf.Coulomb(), **start):  # noqa: B008
    return sf.settle(sf.quasi_statics(vehicle, ground, law=law), **start)


def creeps(run):
    return np.hypot(run["slip_along"], run["slip_across"])[-1]


@pytest.mark.parametrize(("degrees", "eps"), [(10, 1e-2), (30, 1e-6)])
def test_a_rigid_axle_creeps_straight_down_across_a_slope(degrees, eps):
    """``eps tan s / sqrt(mu^2 - tan^2 s)``: every wheel uses the same part of its friction."""
    s = np.radians(degrees)
    run = standing(FIXED, slope(degrees, 0.6, across=True), sf.Coulomb(eps))
    expected = eps * np.tan(s) / np.sqrt(0.6**2 - np.tan(s) ** 2)
    assert_allclose(creeps(run), expected, rtol=1e-6)
    assert run["velocity_x"][0] < 0  # downhill
    assert_allclose(run["utilisation"], np.tan(s) / 0.6, rtol=1e-6)


def test_a_driven_wheel_creeps_by_what_it_uses():
    """Uphill on free tilts: ``eps U / sqrt(1 - U^2)`` at the rear wheels, none at the front."""
    s = np.radians(20)
    run = standing(three_wheeler(), slope(20, 0.6))
    used = np.tan(s) / (2 / 3 + 0.3 / 1.5 * np.tan(s)) / 0.6
    expected = 1e-4 * used / np.sqrt(1 - used**2)
    assert_allclose(creeps(run), [expected, expected, 0], rtol=1e-6, atol=1e-15)


@pytest.mark.parametrize("reserve", [1.0, 0.05])
def test_the_reserve_holds_beyond_friction(reserve):
    """A block on a slope of 35 degrees: ``mu p + c s = tan s``, about ``(tan s - mu) / c``."""
    s, mu, eps = np.radians(35), 0.6, 1e-3
    run = standing(FIXED, slope(35, mu, across=True), sf.Coulomb(eps, reserve))
    slip = creeps(run)
    assert_allclose(slip, slip[0], rtol=1e-9)
    assert_allclose(mu * slip / np.hypot(slip, eps) + reserve * slip, np.tan(s), rtol=1e-9)
    assert_allclose(slip, (np.tan(s) - mu) / reserve, rtol=1e-3)


def test_beyond_friction_a_start_is_refused_with_what_it_needs():
    error = error_of(sf.ModelError, standing, three_wheeler(), slope(25, 0.6))
    s = np.tan(np.radians(25))
    assert str(error) == (
        "the vehicle cannot stand at the start: headed 0 degrees from uphill on a slope of 25.0 "
        "degrees, the vehicle needs a coefficient of friction of at least "
        f"{s / (2 / 3 + 0.2 * s):.4g}, the ground offers 0.6"
    )


@pytest.mark.slow
def test_small_creep_leads_to_rolling():
    """First order in the creep where the vehicle can roll; steps do not grow."""
    creep = np.array([1e-4, 1e-6])
    errors, steps = zip(*from_rolling("tilting", creep), strict=True)
    assert order(creep, errors) == pytest.approx(1, abs=0.02)
    assert max(steps) < 250


@pytest.mark.slow
def test_large_friction_leads_to_the_linear_law():
    """mu to infinity at fixed eps/mu: second order."""
    scale = np.array([1.0, 10.0, 100.0])
    errors = [from_linear(hills, mu) for mu in scale]
    assert order(1 / scale, errors) == pytest.approx(2, abs=0.1)
    assert errors[-1] < 1e-5


def test_small_creep_of_a_rigid_axle_leads_to_least_dissipation(rng):
    """Not to least slip: ``sum mu N |s| - Q w`` is least among the rates that keep contact."""
    creep = np.array([1e-4, 1e-5, 1e-6])
    for each in (found := [dissipation(eps) for eps in creep]):
        for size in np.logspace(-6, -1, 60):
            other = each.rates + size * rng.normal(size=len(each.keeping)) @ each.keeping
            assert each.cost(other) > each.cost(each.rates) - each.gap
    assert order(creep, [each.gap for each in found]) > 0.95
    best = found[-1]
    assert best.gap < 1e-4 * best.cost(best.rates)
    assert best.cost(least_slip_rates()) > best.cost(best.rates) + 100 * best.gap


@pytest.mark.slow
@pytest.mark.parametrize(("axle", "mu"), [("fixed", 0.6), ("sliding", 1.5)])
def test_random_starts_lead_to_one_solution(axle, mu, rng):
    converged, apart = random_starts(axle, mu, 1e-3, 20, rng)
    assert converged >= 8
    assert apart < 1e-8


def test_no_equilibrium_is_a_stop_by_name():
    """Up a ground that steepens: when the friction that rolling needs reaches the ground's."""
    ground = sf.Analytic(lambda x, y: 0.05 * ca.fmax(y, 0) ** 3 + 0 * x, mu=0.35)
    rates = {"right_rate": 1.0, "left_rate": 1.0, "steer_rate": 0.0}
    t = np.linspace(0, 12, 121)
    rolling = sf.direct_kinematics(three_wheeler(), ground)
    held = sf.simulate(
        rolling,
        sf.settle(rolling),
        rolling.inputs(**rates),
        t,
        options=sf.SolverOptions(tolerance=1e-11),
    )
    needed = held["friction_needed"].max(axis=1)
    k = int(np.argmax(needed > 0.35))
    expected = held.t[k - 1] + 0.1 * (0.35 - needed[k - 1]) / (needed[k] - needed[k - 1])
    run = moved(three_wheeler(), ground, sf.Coulomb(1e-6), t, rates)
    assert run.stop.name == "no_equilibrium"
    assert run.outcome is sf.Outcome.NO_EQUILIBRIUM
    assert run.stop.t == pytest.approx(expected, abs=2e-3)
    assert run.stop.words.startswith("headed 0 degrees from uphill on a slope of ")
    assert run.stop.words.endswith(
        "the vehicle needs all the friction that the ground offers, 0.35"
    )


@pytest.mark.slow
@pytest.mark.parametrize(("damping", "tolerance"), [(0.0, 1e-9), (100.0, 1e-7)])
def test_a_stuck_vehicle_with_spinning_wheels_is_an_equilibrium(damping, tolerance):
    """All friction is used for long; states that miss by the tolerance do not end that."""
    ground = sf.Analytic(lambda x, y: 0.03 * y * y + 0.1 * x, mu=0.6)
    rates = {"right_rate": 1.0, "left_rate": 1.0, "steer_rate": 0.0}
    vehicle = three_wheeler(stiffness=60.0, damping=damping)
    t = np.linspace(0, 60, 301)
    run = moved(vehicle, ground, sf.Coulomb(), t, rates, tolerance=tolerance)
    assert run.stop is None
    assert np.ptp(run["y"][200:]) < 0.1
    assert run["slip_along", "right"][-1] < -0.1


@pytest.mark.slow
def test_a_fold_is_a_stop_by_name_whatever_the_tolerance():
    """Friction couples normal forces to the motion, which may go on with a jump only."""
    size = {"rms": 0.09746552344891801, "hurst": 0.9539057256615531, "longest": 8.0}
    grid = power_law(blank((-6, 6), (-6, 6), 0.25), shortest=2.743039400737338, seed=67, **size)
    rates = {"right_rate": 0.7521118439376475, "left_rate": 0.6014304356887998}
    rates["steer_rate"] = -0.23850475241570412
    start = {"x": 0.06577387785453626, "y": -0.0420728627881235, "heading": 0.3860773330023184}
    ground, law = sf.Bicubic(grid, mu=0.048397107850166564), sf.Coulomb(3.4290050665254273e-06)
    t = np.linspace(0, 10, 51)
    runs = [moved(FIXED, ground, law, t, rates, tolerance=each, **start) for each in (1e-8, 1e-10)]
    for run in runs:
        assert run.stop.name == "fold"
        assert run.outcome is sf.Outcome.NO_EQUILIBRIUM
        assert "it can continue only with a jump, for example of front_rate from " in run.stop.words
    assert runs[0].stop.t == pytest.approx(runs[1].stop.t, abs=1e-3)


@pytest.mark.slow
def test_friction_that_a_formula_makes_zero_is_a_stop_by_name():
    ground = sf.Analytic(lambda x, y: 0 * x + 0 * y, mu=lambda _, y: 0.5 - 0.3 * y)
    rates = {"right_rate": 1.0, "left_rate": 1.0, "steer_rate": 0.0}
    run = moved(FIXED, ground, sf.Coulomb(1e-6), T, rates)
    assert run.stop.name == "friction[front]"
    assert run["contact_y", "front"][-1] == pytest.approx(0.5 / 0.3, abs=1e-4)
    assert "the coefficient of friction under wheel front is not positive" in run.stop.words
    rooted = sf.Analytic(ground.function, mu=lambda _, y: ca.sqrt(0.5 - 0.3 * y))
    least = sf.direct_kinematics(FIXED, rooted)
    run = sf.simulate(least, sf.settle(least), least.inputs(**rates), T)
    assert run.stop.name == "friction[front]"
    assert np.isfinite(best_utilisation(FIXED, rooted, run)["utilisation_best"][:-1]).all()


def test_a_vehicle_that_would_roll_away_is_not_said_to_tip_over():
    vehicle = replace(four_wheels(rock=True), body=sf.Body(30.0, (0.0, 0.5, 0.0)))
    free = tuple(replace(wheel, driven=False) for wheel in vehicle.wheels)
    words = "no contact forces balance the vehicle: a wheel without"
    refuses(sf.ModelError, words, standing, replace(vehicle, wheels=free), slope(5, 0.6))


def test_ice_is_a_stop_by_name_even_where_friction_jumps():
    ground = sf.Analytic(
        lambda x, y: hills(x, y) + 0.2 * y, mu=lambda _, y: ca.if_else(y > 0.9, 0.02, 0.6)
    )
    run = moved(FIXED, ground, sf.Coulomb(), T, x=0.013, y=0.017)
    assert run.stop.name == "no_equilibrium"
    assert run.outcome is sf.Outcome.NO_EQUILIBRIUM
    assert run["contact_y", "right"][-1] == pytest.approx(0.9, abs=1e-3)
    assert "times the friction of the ground, the ground offers 0.02 to 0.6" in run.stop.words


def test_the_edge_of_a_friction_map_is_a_stop_by_name():
    axis = np.linspace(-3, 3, 13)
    mu = sf.Grid(axis, np.linspace(-3, 1.5, 10), np.full((13, 10), 0.6))
    heights = sf.Grid(axis, axis, np.zeros((13, 13)))
    ground = sf.Bicubic(heights, mu=mu)
    rates = {"right_rate": 0.5, "left_rate": 0.5, "steer_rate": 0.0}
    run = moved(FIXED, ground, sf.Coulomb(1e-6), T, rates)
    assert run.stop.name == "friction_margin[front]"
    assert run.outcome is sf.Outcome.LIMIT
    assert run.stop.t == pytest.approx(0.5 / 0.15, abs=2e-4)
    assert "wheel front leaves the friction map, which extends from -3.00 to 3.00 m in x and " in (
        run.stop.words
    )


def test_only_a_stiff_spring_holds_a_tilt_upright():
    """The tilt is an inverted pendulum; the spring it needs is the load times r2."""

    def falls(**changes):
        ground = slope(0.0, 0.6)
        run = standing(three_wheeler(**changes), ground, tilt_right=0.01, tilt_left=0.01)
        return run["tilt_right_rate"][0]

    load = three_wheeler().weight / 3 * 0.25
    assert falls(stiffness=1.05 * load) < 0 < falls(stiffness=0.95 * load)
    assert 0 < falls(damping=100.0) < falls()


@pytest.mark.slow
def test_work_is_what_is_gained_and_what_is_lost():
    t = np.linspace(0, 4, 401)
    run = moved(FIXED, sf.Analytic(hills, mu=0.6), sf.Coulomb(1e-3), t, UNEQUAL, tolerance=1e-10)
    lost = CubicSpline(run.t, run["dissipation"]).antiderivative()(run.t)
    gained = run["potential_energy"] - run["potential_energy"][0]
    assert lost[-1] > 0.1
    assert_allclose(run["work"], gained + lost, atol=1e-6 * lost[-1])


def test_what_does_not_suit_is_refused():
    ground = slope(0.0, 0.6)
    for words, vehicle, terrain, make in (
        ("a vehicle with mass", three_wheeler(mass=0.0, wheel_mass=0.0), ground, sf.Coulomb),
        ("a ground with a coefficient of friction, found none", FIXED, slope(0.0), sf.Coulomb),
        ("creep: expected a number, found float nan", FIXED, ground, lambda: sf.Coulomb(np.nan)),
        ("creep: expected a number <= 0.3, found 1", FIXED, ground, lambda: sf.Coulomb(1.0)),
        ("reserve: expected a number >= 0, found -1", FIXED, ground, lambda: sf.Coulomb(0.1, -1.0)),
        ("give a wheel-ground law, such as Coulomb", FIXED, ground, sf.LeastSlip),
        (r"call it: Coulomb\(\)", FIXED, ground, lambda: sf.Coulomb),
    ):
        with pytest.raises(sf.ModelError, match=words):
            sf.quasi_statics(vehicle, terrain, law=make())
    for of in (sf.direct_kinematics, sf.montana_kinematics):
        refuses(sf.ModelError, "give a slip law, such as", of, FIXED, ground, slip=sf.Coulomb())


def test_a_rigid_vehicle_is_refused_with_the_models_that_answer():
    words = "found 0 in 'rigid_skid_steer'; use the model 'dynamics'.*'kinematics'"
    with pytest.raises(sf.ModelError, match=words):
        sf.quasi_statics(rigid_skid_steer(), sf.Analytic(lambda x, _: 0 * x, mu=0.8))


# Contact forces of least utilisation: closed forms, bounds, and special cases

RADIUS = 0.3  # of a wheel, the lever arm of the rolling direction's force [m]
FLAT = np.column_stack([(0, 1, 0), (-1, 0, 0), (0, 0, 1)])  # along, across, normal of a plane
SQUARE = np.array([(1.0, 1.0, 0.0), (-1.0, 1.0, 0.0), (-1.0, -1.0, 0.0), (1.0, -1.0, 0.0)])


def equations(points, frames, cg, gravity, free=()):
    """Balance of forces and of moments about the cg, and no force along a free wheel."""
    matrix = np.zeros((6 + len(free), 3 * len(points)))
    for k, (point, frame) in enumerate(zip(points, frames, strict=True)):
        matrix[:3, 3 * k : 3 * k + 3] = frame
        matrix[3:6, 3 * k : 3 * k + 3] = np.cross(point - cg, frame.T).T
    for row, wheel in enumerate(free):
        matrix[6 + row, 3 * wheel] = RADIUS
    return matrix, np.concatenate([gravity, np.zeros(3 + len(free))])


def on_slope(slope, heading):
    """Gravity in the axes of a vehicle on a plane, heading zero is up the slope."""
    down = np.array([np.sin(heading), -np.cos(heading), 0.0])
    return np.sin(slope) * down - np.cos(slope) * np.array([0.0, 0.0, 1.0])


def random_cases(seed, n, m, n_free):
    """Vehicles of m wheels, two rows, on ground that is rough in height and in slope."""
    rng = np.random.default_rng(seed)
    cases = []
    for _ in range(n):
        rows = np.column_stack([1.0 - 2.0 * (np.arange(m) % 2), np.linspace(-1, 1, m), np.zeros(m)])
        points = rows + rng.normal(0, [0.1, 0.1, 0.1], (m, 3))
        frames = []
        for _ in range(m):
            normal = np.append(rng.normal(0, 0.15, 2), 1.0)
            normal /= np.linalg.norm(normal)
            across = np.cross(normal, (0.0, 1.0, 0.0))
            across /= -np.linalg.norm(across)
            frames.append(np.column_stack([np.cross(across, normal), across, normal]))
        gravity = on_slope(rng.uniform(0.1, 0.5), rng.uniform(0, 2 * np.pi))
        cg = np.append(rng.normal(0, 0.2, 2), 0.4)
        cases.append(equations(points, frames, cg, gravity, free=range(n_free)))
    matrix, load = (np.array(part) for part in zip(*cases, strict=True))
    return matrix, load, rng.uniform(0.4, 1.0, (n, m))


def wheels(force):
    """Tangential size and normal force of every wheel."""
    parts = force.reshape(*force.shape[:-1], -1, 3)
    return np.hypot(parts[..., 0], parts[..., 1]), parts[..., 2]


def room_in_polygons(matrix, load, friction, utilisation, force):
    """Largest slack that any forces leave in polygons around the friction discs.

    The facets are tangents of the discs, so a negative slack proves that no forces within the
    discs are in equilibrium, whatever the facets; they crowd where ``force`` points.
    """
    m = friction.size
    crowd = 2.0 ** -np.arange(1, 16)
    spread = np.concatenate([np.linspace(-np.pi, np.pi, 48, endpoint=False), crowd, -crowd])
    angles = np.arctan2(force[1::3], force[0::3])[:, None] + spread
    limits = np.broadcast_to(-utilisation * friction[:, None], angles.shape)
    cones = block_diag(*np.stack([np.cos(angles), np.sin(angles), limits], axis=-1))
    facets = np.column_stack([cones, np.ones(len(cones))])
    found = linprog(
        -np.eye(3 * m + 1)[-1],
        A_ub=facets,
        b_ub=np.zeros(len(facets)),
        A_eq=np.column_stack([matrix, np.zeros(len(matrix))]),
        b_eq=-load,
        bounds=[(None, None), (None, None), (0, None)] * m + [(None, 1)],
    )
    assert found.status == 0
    return found.x[-1]


@pytest.mark.parametrize(
    ("count", "m", "n_free"), [(50, 3, 3), (12, 3, 1), (12, 4, 2), (12, 8, 6)]
)  # the first leave the forces no choice, and few of them can be held
def test_forces_attain_the_least_utilisation(count, m, n_free):
    matrix, load, friction = random_cases(m + n_free, count, m, n_free)
    best = least_utilisation(matrix, load, friction)
    held = np.isfinite(best.utilisation)
    assert held.sum() > 6
    for k in np.flatnonzero(held):
        s, force = best.utilisation[k], best.force[k]
        tangential, normal = wheels(force)
        np.testing.assert_allclose(matrix[k] @ force, -load[k], atol=1e-9)
        assert (normal > -1e-9).all()
        assert (tangential <= s * friction[k] * (normal + 2e-9)).all()
        assert room_in_polygons(matrix[k], load[k], friction[k], (1 - 1e-4) * s, force) < 0


@pytest.mark.parametrize("slope", [0.0, np.radians(25)])
def test_locked_block_on_a_slope(slope):
    matrix, load = equations(SQUARE, [FLAT] * 4, np.array([0.1, -0.2, 0.4]), on_slope(slope, 0.7))
    best = least_utilisation(matrix[None], load[None], np.full((1, 4), 0.6))
    assert best.force.shape == (1, 12)
    np.testing.assert_allclose(
        best.utilisation, np.tan(slope) / 0.6, rtol=1e-6, atol=1e-7 * (slope == 0)
    )


def test_tipping_angle_is_sharp():
    """A block whose cg is 0.4 m high tips sideways where tan(slope) exceeds 1 / 0.4."""
    cg, angle = np.array([0.0, 0.0, 0.4]), np.arctan(1 / 0.4)
    cases = [
        equations(SQUARE, [FLAT] * 4, cg, on_slope(angle + turn, np.pi / 2))
        for turn in (-1e-6, 1e-6)
    ]
    matrix, load = (np.array(part) for part in zip(*cases, strict=True))
    best = least_utilisation(matrix, load, np.ones((2, 4)))
    assert best.utilisation[0] == pytest.approx(np.tan(angle), rel=1e-4)
    assert np.isinf(best.utilisation[1])
    assert np.isnan(best.force[1]).all()


def test_samples_do_not_disturb_each_other():
    """Some tip, some have no solution at all, and the null spaces differ."""
    matrix, load, friction = random_cases(5, 30, 4, 2)
    outside = np.array([1.2, 0.0, 0.3])
    matrix[3], load[3] = equations(SQUARE, [FLAT] * 4, outside, on_slope(0.0, 0.0), free=[0, 1])
    matrix[7, 7] = matrix[7, 6]  # one equation less
    load[7, 7] = load[7, 6]
    matrix[9, 7], load[9, 7] = matrix[9, 6], 1.0  # two equations contradict each other
    together = least_utilisation(matrix, load, friction)
    assert np.isinf(together.utilisation[[3, 9]]).all()
    assert np.isfinite(together.utilisation).sum() > 20
    for k in range(30):
        alone = least_utilisation(matrix[k : k + 1], load[k : k + 1], friction[k : k + 1])
        np.testing.assert_allclose(alone.utilisation[0], together.utilisation[k], rtol=1e-7)
    order = np.random.default_rng(0).permutation(30)
    permuted = least_utilisation(matrix[order], load[order], friction[order])
    np.testing.assert_allclose(permuted.utilisation, together.utilisation[order], rtol=1e-7)


def test_one_equation_less_is_no_worse_and_units_do_not_matter():
    matrix, load, friction = random_cases(6, 20, 4, 2)
    bound = least_utilisation(matrix, load, friction).utilisation
    scale = 10.0 ** np.linspace(-6, 6, 8)
    again = least_utilisation(matrix * scale[:, None], load * scale, friction)
    np.testing.assert_allclose(again.utilisation, bound, rtol=1e-7)
    matrix[:, 7], load[:, 7] = matrix[:, 6], load[:, 6]
    freed = least_utilisation(matrix, load, friction).utilisation
    assert (freed <= bound * (1 + 1e-7)).all()
    assert (freed < 0.999 * bound).any()


def test_wheel_without_normal_force_holds_nothing():
    matrix = np.tile(np.eye(6), (2, 1, 1))
    load = np.array([(0.1, 0, -0.5, 0.0, 0, 0), (0.1, 0, -0.5, 0.1, 0, 0)])
    best = least_utilisation(matrix, load, np.ones((2, 2)))
    np.testing.assert_allclose(best.utilisation, [0.2, np.inf])
    assert np.isnan(best.force[1]).all()


def test_jammed_vehicle_has_bounded_forces():
    """Between two walls the utilisation goes to zero as the walls are pressed apart."""
    points = np.array([(-1.0, 0.0, 0.0), (1.0, 0.0, 0.0)])
    facing = [np.column_stack([(0, 0, 1), (0, side, 0), (side, 0, 0)]) for side in (1, -1)]
    matrix, load = equations(points, facing, np.zeros(3), np.array([0.0, 0.0, -1.0]))
    best = least_utilisation(matrix[None], load[None], np.ones((1, 2)))
    tangential, normal = wheels(best.force[0])
    np.testing.assert_allclose(tangential, 0.5)
    assert (normal < force_distribution.MAX_INTERNAL_FORCE).all()
    np.testing.assert_allclose(best.utilisation, 0.5 / normal.min(), rtol=1e-6)
    assert best.utilisation < 1e-3


@pytest.mark.parametrize("rounds", [0, 3])
def test_a_sample_that_does_not_converge_is_nan(monkeypatch, rounds):
    monkeypatch.setattr(force_distribution, "MAX_NEWTON_STEPS", rounds)
    matrix, load, friction = random_cases(7, 4, 4, 2)
    best = least_utilisation(matrix, load, friction)
    assert np.isnan(best.utilisation).all()
    assert np.isnan(best.force).all()


def test_a_robot_whose_caster_lifts_off():
    """Samples of a TurtleBot3 burger on rough ground, where its ball caster bears nothing."""
    with np.load(Path(__file__).parents[1] / "data" / "lifted_caster.npz") as samples:
        matrix, load = samples["matrix"], samples["load"]
    best = least_utilisation(matrix, load, np.ones((2, 3)))
    np.testing.assert_allclose(best.utilisation, [0.16348431, 0.18084844], rtol=1e-7)
    for k in range(2):
        below = best.utilisation[k] - 1e-4
        assert room_in_polygons(matrix[k], load[k], np.ones(3), below, best.force[k]) < 0


# Slip laws and wheel-ground laws: their protocols and registry

VEHICLE = three_wheeler()
GROUND = sf.Analytic(lambda x, y: 0.1 * ca.sin(x + y), mu=0.6)
LAWS = {**SLIP_LAWS, **GROUND_LAWS}


@pytest.mark.parametrize("name", LAWS)
def test_a_law_has_a_label_for_every_equation_and_unknown(name):
    law = LAWS[name]()
    if name in GROUND_LAWS:
        models = [sf.quasi_statics(VEHICLE, GROUND, law=law)]
    else:
        models = [
            of(VEHICLE, GROUND, slip=law) for of in (sf.direct_kinematics, sf.montana_kinematics)
        ]
    for dae in models:
        rates, labels = dae.labels.z.rates, dae.labels.alg[-2]
        given = (VEHICLE,) if name in GROUND_LAWS else (VEHICLE, contact_labels(VEHICLE))
        assert list(leaves(rates.law)) == list(leaves(law.unknowns(*given)))
        assert len(labels) == len(list(leaves(rates))) == dae.alg[-2].numel()
        assert all(label.words and label.name for label in labels)
