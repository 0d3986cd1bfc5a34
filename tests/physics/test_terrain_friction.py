"""Tests of the coefficient of friction of a ground: numbers, formulas and maps.

Rounding leaves about 1e-16 of a coefficient of about one; 1e-14 allows for other processors. An
offset of 4e6 m costs a coordinate ten digits before it reaches a map: 1e-8.
"""

import math
import pickle
from dataclasses import FrozenInstanceError

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import NdBSpline

import slipfree as sf
from helpers.cases import function_of as looked_up
from helpers.cases import hills
from helpers.commands import invoke, refuses, sets
from helpers.problem_files import VALID
from slipfree.files.toml import ProblemError
from slipfree.problem.build import build_terrain
from slipfree.problem.result import build

ROUNDING = 1e-14
OFFSET = (5e5, 4.1e6)
HEIGHTS = sf.Grid(
    np.linspace(-4, 6, 11), np.linspace(0, 5, 6), 100 + np.arange(66.0).reshape(11, 6)
)


def bands(x, y):
    """Ice in bands, in map coordinates."""
    return 0.5 + 0.3 * ca.sin(2 * x) * ca.cos(3 * y)


def patches(seed=0, shape=(14, 9)):
    """Ice beside rock, at random nodes."""
    values = np.random.default_rng(seed).choice([0.02, 0.5, 1.2], shape)
    return sf.Grid(np.linspace(-3, 5, shape[0]), np.linspace(-3, 4, shape[1]), values)


def grounds(mu, center=None):
    return {"analytic": sf.Analytic(hills, mu=mu), "bicubic": sf.Bicubic(HEIGHTS, center, mu)}


GROUNDS = pytest.mark.parametrize("kind", list(grounds(None)))


def function_of(ground):
    """Return a Function of local x, y to friction, its gradient and its Hessian."""
    q = ca.SX.sym("q", 2)

    def make(lookups):
        mu = ground.friction(q[0], q[1], lookups)
        assert mu.shape == (1, 1)
        hessian, gradient = ca.hessian(mu, q)
        return mu, gradient, hessian

    return looked_up([q], make)


def evaluate(ground, x, y):
    """Return coefficients (n,), gradients (n, 2) and Hessians (n, 2, 2) at map points."""
    x_0, y_0, _ = ground.origin
    mu, gradient, hessian = function_of(ground).map(x.size)(np.stack([x - x_0, y - y_0]))
    second = np.asarray(hessian).reshape(2, x.size, 2).swapaxes(0, 1)
    return np.asarray(mu).ravel(), np.asarray(gradient).T, second


def inside(grid, count=3000, margin=0.0):
    x_min, x_max, y_min, y_max = grid.domain
    low, high = [[x_min - margin], [y_min - margin]], [[x_max + margin], [y_max + margin]]
    return np.random.default_rng(1).uniform(low, high, (2, count))


@GROUNDS
@pytest.mark.parametrize(
    ("mu", "expected"), [(None, 1.0), (1, 1.0), (np.float64(0.3), 0.3), (lambda _x, _y: 0.25, 0.25)]
)
def test_a_number_holds_everywhere_and_is_one_where_none_is_given(kind, mu, expected):
    ground = grounds(mu)[kind]
    assert (ground.has_friction, ground.friction_domain) == (mu is not None, None)
    values, gradient, _ = evaluate(ground, *inside(HEIGHTS, 5))
    assert (values == expected).all()
    assert not gradient.any()


@GROUNDS
def test_a_function_is_of_map_coordinates(kind):
    ground = grounds(bands, center=(1.5, -0.5))[kind]
    assert (ground.has_friction, ground.friction_domain) == (True, None)
    x, y = inside(HEIGHTS)
    found = evaluate(ground, x, y)[0]
    assert_allclose(found, 0.5 + 0.3 * np.sin(2 * x) * np.cos(3 * y), rtol=0, atol=ROUNDING)


@GROUNDS
def test_a_map_is_the_spline_whose_coefficients_are_its_values(kind):
    mu = patches()
    # The border is repeated, once for the spline and twice more around it.
    knots = [
        axis[0] + step * np.arange(-5, axis.size + 5)
        for axis, step in zip((mu.x, mu.y), mu.spacing, strict=True)
    ]
    spline = NdBSpline(tuple(knots), np.pad(mu.z, 3, mode="edge"), 3)
    x, y = inside(mu)
    values, gradient, second = evaluate(grounds(mu)[kind], x, y)
    points = np.stack([x, y], axis=-1)
    for nu, found in (
        ((0, 0), values),
        ((1, 0), gradient[:, 0]),
        ((0, 1), gradient[:, 1]),
        ((2, 0), second[:, 0, 0]),
        ((1, 1), second[:, 0, 1]),
        ((0, 2), second[:, 1, 1]),
    ):
        expected = spline(points, nu=nu)
        assert_allclose(found, expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_a_map_never_leaves_the_range_of_its_values():
    mu = patches()
    ground = sf.Bicubic(HEIGHTS, mu=mu)
    assert ground.friction_domain == mu.domain == (-3, 5, -3, 4)
    # Outside too, where a solver may look on its way.
    for margin, tolerance in ((0, ROUNDING), (2, 1e-13), (100, 1e-8)):
        found = evaluate(ground, *inside(mu, 5000, margin))[0]
        assert 0.02 - tolerance <= found.min() < found.max() <= 1.2 + tolerance
    # A surface through the values leaves it, which is why friction is not laid so.
    assert sf.Bicubic(mu).elevation(*inside(mu, 5000)).min() < 0


def test_a_jump_is_smoothed_over_three_cells():
    axis = np.arange(10.0)
    values = np.repeat(np.where(axis < 4.5, 0.0, 1.0)[:, None] + 0.1, 10, axis=1)
    ground = sf.Bicubic(HEIGHTS, mu=sf.Grid(axis, axis, values))
    x = np.array([3, 3.5, 4, 4.5, 5, 5.5, 6])
    found = evaluate(ground, x, np.full(7, 5.2))[0] - 0.1
    assert_allclose(found, [0, 1 / 48, 1 / 6, 1 / 2, 5 / 6, 47 / 48, 1], rtol=0, atol=ROUNDING)


@pytest.mark.parametrize(
    ("center", "offset", "error"), [((-40.0, 70.0), (0.0, 0.0), 1e-12), (None, OFFSET, 1e-8)]
)
def test_a_map_lies_where_the_map_says_whatever_the_origin(center, offset, error):
    mu = patches()
    x, y = inside(mu)
    expected = evaluate(sf.Analytic(hills, mu=mu), x, y)[0]
    far = sf.Grid(mu.x + offset[0], mu.y + offset[1], mu.z)
    heights = sf.Grid(HEIGHTS.x + offset[0], HEIGHTS.y + offset[1], HEIGHTS.z)
    ground = sf.Bicubic(heights, center, far)
    assert ground.origin[2] == HEIGHTS.z.mean()
    found = evaluate(ground, x + offset[0], y + offset[1])[0]
    assert_allclose(found, expected, rtol=0, atol=error)


def test_a_surface_between_the_nodes_has_the_same_heights_in_numbers():
    ground = sf.Bicubic(HEIGHTS, (0.2, 0.4), through=False)
    p, q = inside(HEIGHTS)
    u, v = ca.SX.sym("u"), ca.SX.sym("v")
    height = looked_up([u, v], lambda lookups: [ground.height(u, v, lookups)]).map(p.size)
    x_0, y_0, z_0 = ground.origin
    expected = np.asarray(height((p - x_0)[None], (q - y_0)[None])).ravel() + z_0
    assert_allclose(ground.elevation(p, q), expected, rtol=1e-14)
    assert HEIGHTS.z.min() < expected.min() < expected.max() < HEIGHTS.z.max()
    copy = pickle.loads(pickle.dumps(ground))
    np.testing.assert_array_equal(copy.elevation(p, q), ground.elevation(p, q))


@GROUNDS
@pytest.mark.parametrize("mu", [bands, patches()], ids=["function", "map"])
def test_friction_changes_no_height_and_is_pickled(kind, mu):
    ground = grounds(mu, center=(0.3, 2.2))[kind]
    x, y = inside(HEIGHTS)
    np.testing.assert_array_equal(
        grounds(None, (0.3, 2.2))[kind].elevation(x, y), ground.elevation(x, y)
    )
    copy = pickle.loads(pickle.dumps(ground))
    assert copy.friction_domain == ground.friction_domain
    for expected, found in zip(evaluate(ground, x, y), evaluate(copy, x, y), strict=True):
        np.testing.assert_array_equal(found, expected)


def test_formulas_are_compared_with_their_friction():
    mu = patches()
    assert sf.Analytic(hills, mu=mu) == sf.Analytic(hills, mu=mu)
    assert len({sf.Analytic(hills), sf.Analytic(hills, mu=0.5), sf.Analytic(hills, mu=mu)}) == 3
    ground = sf.Analytic(hills, mu=mu)
    evaluate(ground, *inside(mu, 5))
    assert ground == sf.Analytic(hills, mu=mu)
    with pytest.raises(FrozenInstanceError):
        ground.mu = 0.1


@GROUNDS
@pytest.mark.parametrize(
    ("mu", "words"),
    [
        (0.0, "mu: expected a number > 0, found 0.0"),
        (math.nan, "mu: expected a number or a function or Grid, found float nan"),
        (True, "mu: expected a number or a function or Grid, found bool True"),
        ("mu.npz", "mu: expected a number or a function or Grid, found str 'mu.npz'"),
        (lambda x, y: ca.vertcat(x, y), r"friction: .* one coefficient, found shape \(2, 1\)"),
        (lambda x, _y: x + ca.SX.sym("wet"), r"coefficient .*only on x and y, found .*wet"),
    ],
)
def test_friction_that_is_none_is_refused(kind, mu, words):
    with pytest.raises(sf.ModelError, match=words):
        grounds(mu)[kind]


def test_a_map_that_is_not_positive_is_refused():
    mu = patches()
    values = mu.z.copy()
    values[4, 7], values[6, 2] = 0.0, -0.1
    bad = sf.Grid(mu.x + 0.25, mu.y, values)
    words = (
        r"friction: all coefficients must be positive, found 2 of 126 that are not, the first "
        rf"z\[4, 7\] = 0 at x = {bad.x[4]:.9g} m, y = 3\.125 m; for ice give a small number"
    )
    refuses(sf.DataError, words, sf.Bicubic, HEIGHTS, mu=bad)


PROBLEM = VALID.replace("[terrain", "[terrain]\nfriction = 0.6\n\n[terrain", 1)


@pytest.fixture
def folder(folder):
    (folder / "p.toml").write_text(PROBLEM)
    mu = patches()
    np.savez(folder / "mu.npz", x=mu.x, y=mu.y, z=mu.z)
    return folder


def _check(*settings):
    words = sets(*settings)
    result = invoke("check", "p.toml", *words, code=0)
    return [" ".join(line.split()) for line in result.stdout.splitlines()]


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_check_tells_the_friction():
    assert "ground friction 0.6" in _check()
    assert "ground friction mu.npz, 0.02 to 1.2" in _check("terrain.friction=mu.npz")
    assert not any("friction" in line for line in _check("terrain.friction="))


def test_a_problem_with_a_number(folder):
    problem = sf.load_problem(folder / "p.toml")
    terrain = build_terrain(problem, build(problem).ground)
    assert (terrain.mu, terrain.friction_domain) == (0.6, None)
    # A whole number is a number too.
    assert sf.load_problem(folder / "p.toml", ["terrain.friction=1"]).spec.terrain.friction == 1.0
    ground = build(sf.load_problem(folder / "p.toml", ["terrain.rolled=0.3"])).ground
    assert ground.rolled is not None
    assert (ground.mu, ground.friction) == (0.6, "0.6")


def test_a_problem_with_a_map_scaled_with_its_ground(folder):
    settings = ["terrain.friction=mu.npz", "terrain.scale=2", "terrain.window=[-4, 5, -4, 5]"]
    problem = sf.load_problem(folder / "p.toml", settings)
    terrain = build_terrain(problem, build(problem).ground)
    assert terrain.domain == (-4, 5, -4, 5)
    # The window cuts the ground alone.
    assert terrain.friction_domain == (-6, 10, -6, 8)
    mu = patches()
    np.testing.assert_array_equal(terrain.mu.z, mu.z)
    x, y = inside(mu)
    expected = evaluate(sf.Bicubic(HEIGHTS, mu=mu), x, y)[0]
    assert_allclose(evaluate(terrain, 2 * x, 2 * y)[0], expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (None, r"mu\.npz: expected a map, found that it cannot be read"),
        ({"z": np.full((14, 9), np.nan)}, r"mu\.npz: .* found none at any node"),
        (
            {"z": np.where(np.arange(126).reshape(14, 9) == 40, np.nan, 0.5)},
            r"a coefficient at every node, found none at 1 of 126, the first at x = .*, y = 0.5 m",
        ),
        ({"z": np.zeros((14, 9))}, r"must be positive, found 126 .* at x = -3 m, y = -3 m"),
    ],
)
def test_problem_refuses_a_map(folder, changes, words):
    mu = patches()
    if changes is None:
        (folder / "mu.npz").unlink()
    else:
        np.savez(folder / "mu.npz", **({"x": mu.x, "y": mu.y} | changes))
    (folder / "p.toml").write_text(PROBLEM.replace("0.6", '"mu.npz"') + "\n")
    problem = sf.load_problem(folder / "p.toml", ["terrain.scale=2"])
    refuses(ProblemError, rf"p\.toml:4: terrain\.friction: .*{words}", build, problem)
