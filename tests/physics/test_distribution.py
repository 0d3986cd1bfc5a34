"""Tests of contact forces of least utilisation: closed forms, bounds, and special cases."""

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.optimize import linprog

from slipfree.core.errors import ModelError
from slipfree.models import force_distribution
from slipfree.models.force_distribution import least_utilisation

RADIUS = 0.3  # of a wheel, the lever arm of the rolling direction's force [m]
FLAT = np.column_stack([(0, 1, 0), (-1, 0, 0), (0, 0, 1)])  # along, across, normal of a plane
THREE = np.array([(1.0, -0.5, 0.0), (-1.0, -0.5, 0.0), (0.0, 1.0, 0.0)])  # right, left, front [m]
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


def three_wheeler(heading):
    gravity = on_slope(np.radians(20), heading)
    return equations(THREE, [FLAT] * 3, np.array([0.0, 0.0, 0.3]), gravity, free=[2])


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


@pytest.mark.parametrize(("heading", "expected"), [(0, 0.4922), (45, 0.4366), (90, 0.3640)])
def test_three_wheeler_on_a_slope(heading, expected):
    matrix, load = three_wheeler(np.radians(heading))
    best = least_utilisation(matrix[None], load[None], np.ones((1, 3)))
    assert best.utilisation == pytest.approx(expected, abs=1e-4)
    below = best.utilisation[0] - 1e-4
    assert room_in_polygons(matrix, load, np.ones(3), below, best.force[0]) < 0
    if heading == 0:
        sine, cosine = np.sin(np.radians(20)), np.cos(np.radians(20))
        front = (0.5 * cosine - 0.3 * sine) / 1.5  # moments about the rear axle's contacts
        np.testing.assert_allclose(best.utilisation, sine / (cosine - front), rtol=1e-7)


@pytest.mark.parametrize(("m", "n_free"), [(3, 1), (4, 2), (8, 6)])
def test_forces_attain_the_least_utilisation(m, n_free):
    matrix, load, friction = random_cases(m + n_free, 12, m, n_free)
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


def test_determinate_vehicle_equals_the_direct_solve():
    matrix, load, friction = random_cases(4, 50, 3, 3)
    direct = np.linalg.solve(matrix, -load[..., None])[..., 0]
    tangential, normal = wheels(direct)
    held = (normal > 0).all(1)
    assert 0 < held.sum() < 50
    best = least_utilisation(matrix, load, friction)
    assert (np.isfinite(best.utilisation) == held).all()
    np.testing.assert_allclose(best.force[held], direct[held], atol=1e-10)
    ratio = (tangential / (friction * normal)).max(1)
    np.testing.assert_allclose(best.utilisation[held], ratio[held], rtol=1e-6)


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


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"friction": np.ones(3)}, "friction: expected shape"),
        ({"matrix": np.ones((7, 9))}, "matrix: expected shape"),
        ({"load": np.ones((1, 6))}, "load: expected shape"),
        ({"friction": np.array([[1.0, 0.0, 1.0]])}, "friction: expected positive"),
        ({"load": np.full((1, 7), np.nan)}, "load: expected finite"),
    ],
)
def test_wrong_arrays_are_refused(changes, message):
    matrix, load = three_wheeler(0.0)
    given = {"matrix": matrix[None], "load": load[None], "friction": np.ones((1, 3))}
    with pytest.raises(ModelError, match=message):
        least_utilisation(**(given | changes))


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
