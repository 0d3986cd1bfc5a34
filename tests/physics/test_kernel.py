"""Tests of the compiled evaluator of grounds against the expressions that it replaces."""

import gc
import pickle
import subprocess
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from multiprocessing import get_context

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from helpers.cases import function_of
from slipfree import Bicubic, Grid, SolverOptions, direct_kinematics, settle, simulate
from slipfree.catalog import three_wheeler
from slipfree.terrain import bicubic, kernel

pytestmark = pytest.mark.usefixtures("built")


def grid(nodes=(30, 40), seed=0, corner=(-3.0, 5.0)):
    rng = np.random.default_rng(seed)
    x, y = (at + 0.25 * np.arange(n) for at, n in zip(corner, nodes, strict=True))
    return Grid(x, y, 100 + rng.standard_normal(nodes))


def flat(jet):
    return ca.vertcat(jet.height, jet.gradient, jet.hessian[0], jet.hessian[1], jet.hessian[3])


@pytest.fixture
def interpreted(monkeypatch):
    """What makes a ground's twin that does without the kernel."""

    def twin(ground):
        with monkeypatch.context() as patch:
            patch.setattr(bicubic, "register_ground", lambda *_: None)
            copy = pickle.loads(pickle.dumps(ground))
            assert copy._kernel is None
        return copy

    return twin


def chain(ground):
    """Return a Function to a jet and its first and second derivatives."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")

    def make(lookups):
        place, values = ca.vertcat(x, y), flat(ground.jet(x, y, lookups))
        first = ca.jacobian(values, place)
        return values, first, ca.jacobian(ca.vec(first), place)

    return function_of([x, y], make)


def places(ground, count=500):
    """Random local points, points on knots, and points outside."""
    rng = np.random.default_rng(1)
    x_0, y_0, _ = ground.origin
    x = rng.choice(ground.grid.x, count) - x_0
    y = rng.choice(ground.grid.y, count) - y_0
    knots = np.array([x, y])
    half = np.array([np.ptp(ground.grid.x), np.ptp(ground.grid.y)])[:, None] / 2
    return np.hstack([knots, half * rng.uniform(-1.02, 1.02, (2, count))])


def test_it_equals_the_expressions_to_the_fourth_derivative(interpreted):
    ground = Bicubic(grid())
    at = places(ground)
    compiled = chain(ground).map(at.shape[1])(*at)
    exact = chain(interpreted(ground)).map(at.shape[1])(*at)
    for found, expected in zip(compiled, exact, strict=True):
        expected = np.array(expected)
        assert_allclose(np.array(found), expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def test_casadi_differentiates_it_in_both_directions(interpreted):
    ground = Bicubic(grid())
    p, seed = ca.SX.sym("p", 2), ca.SX.sym("seed", 2)

    def curve(ground):
        def make(lookups):
            at = [0.3 * ca.sin(p[0]) * p[1], p[0] + 0.1 * p[1] ** 2]
            values = flat(ground.jet(*at, lookups))
            bent = values[3] * values[1] / ca.sqrt(1 + ca.sumsqr(values[1:3])) + values[5] * p[0]
            both = ca.jtimes(bent, p, seed), ca.jtimes(bent, p, ca.SX(1), True)
            return bent, *both, ca.hessian(bent, p)[0]

        return function_of([p, seed], make)

    at = [0.4, 0.7], [1.0, -2.0]
    found, expected = curve(ground)(*at), curve(interpreted(ground))(*at)
    for one, other in zip(found, expected, strict=True):
        assert_allclose(np.array(one), np.array(other), rtol=1e-12, atol=1e-11)


def test_many_grounds_at_once_and_more_than_there_is_room_for():
    grounds = [Bicubic(grid(seed=seed)) for seed in range(kernel.library().kernel_slots() + 3)]
    slots = [ground._kernel and ground._kernel.slot for ground in grounds]
    taken = [slot for slot in slots if slot is not None]
    assert len(set(taken)) == len(taken)
    assert slots[-1] is None  # it does without
    x = np.linspace(-1, 1, 7)
    for ground in (grounds[0], grounds[5], grounds[-1]):
        x_0, y_0, z_0 = ground.origin
        expected = ground._local_heights(x, x) + z_0
        assert_allclose(ground.elevation(x + x_0, x + y_0), expected, rtol=1e-13)
    del grounds
    gc.collect()
    assert Bicubic(grid())._kernel is not None


def test_what_is_made_of_a_ground_keeps_it_alive():
    ground = Bicubic(grid())
    slot = ground._kernel.slot
    slope = chain(ground)
    expected = np.array(slope(0.1, 0.2)[1])
    del ground
    gc.collect()
    others = [Bicubic(grid(seed=seed)) for seed in range(1, 10)]
    assert slot not in [other._kernel.slot for other in others]
    assert_array_equal(np.array(slope(0.1, 0.2)[1]), expected)
    del slope
    gc.collect()
    assert not kernel.library().kernel_in_use(slot)


def test_the_functions_of_another_ground_give_no_numbers():
    """Nothing else would tell; also with a map over points."""
    found = Bicubic(grid())._kernel
    for key, all_finite in ((found.key, True), (found.key + 1, False)):
        many = np.array([[0.1, 0.2, 0.3], [0.2, 0.2, 0.2], [key, key, key]])
        for values in (found.function([0.1, 0.2, key]), found.function.map(3)(many)):
            finite = np.isfinite(np.array(ca.DM(values)))
            assert finite.all() if all_finite else not finite.any()


def test_a_function_that_outlives_its_ground_gives_no_numbers():
    """Serialised, it does not keep the slot; neither what was there nor zeros come out."""
    ground = Bicubic(grid())
    function = chain(ground)
    kept = pickle.dumps(function)
    found, expected = (float(each(0.1, 0.2)[0][0]) for each in (pickle.loads(kept), function))
    assert found == expected
    del ground, function
    gc.collect()
    taking_its_place = Bicubic(grid(seed=1))
    assert taking_its_place._kernel is not None
    assert np.isnan(float(pickle.loads(kept)(0.1, 0.2)[0][0]))


@pytest.mark.parametrize(("through", "order"), [(True, "C"), (False, "F")])
def test_heights_equal_the_expressions_for_maps_of_any_layout(through, order):
    made = grid()
    ground = Bicubic(Grid(made.x, made.y, np.asarray(made.z, order=order)), through=through)
    x, y = places(ground)
    expected = ground._local_heights(x, y)
    atol = 1e-13 * np.abs(expected).max()
    assert_allclose(ground._kernel.heights(x, y), expected, rtol=0, atol=atol)
    assert np.isnan(ground._kernel.heights(np.array([np.nan]), np.array([0.0]))).all()


@pytest.mark.parametrize("content", [b"", b"no library", None])
def test_a_library_that_cannot_be_used_is_left_alone(content, tmp_path, monkeypatch):
    """Cut off, of another system, or of another version, whose numbers mean other things."""
    if content is None:
        monkeypatch.setattr("slipfree.core.lookups.LAYOUT", 0)
    else:
        (tmp_path / f"_kernel{EXTENSION_SUFFIXES[0]}").write_bytes(content)
        monkeypatch.setattr("slipfree.core.lookups.KERNEL", tmp_path / "_kernel")
    assert kernel.library.__wrapped__() is None


def _drive(ground):
    dae = direct_kinematics(three_wheeler(mass=0.0, wheel_mass=0.0), ground)
    inputs = dae.inputs(right_rate=0.5, left_rate=0.4, steer_rate=0.0)
    run = simulate(dae, settle(dae), inputs, np.linspace(0, 1, 5), options=SolverOptions(1e-8))
    return np.array([run[name][-1] for name in ("x", "y", "z", "heading")])


def _gentle(seed=0):
    axis = np.linspace(-6, 6, 60)
    waves = np.random.default_rng(seed).uniform(0.3, 0.6, 2)
    return Grid(axis, axis, 0.2 * np.sin(waves[0] * axis)[:, None] * np.cos(waves[1] * axis))


@pytest.mark.slow
def test_pickled_grounds_work_here_and_in_other_processes():
    grounds = [Bicubic(_gentle(seed)) for seed in range(2)]
    here = [_drive(ground) for ground in grounds]
    assert_array_equal(_drive(pickle.loads(pickle.dumps(grounds[1]))), here[1])
    with get_context("spawn").Pool(1) as pool:
        there = pool.map(_drive, grounds)
    assert_array_equal(np.array(there), np.array(here))


def test_without_it_the_motion_is_the_same(monkeypatch):
    compiled = _drive(Bicubic(_gentle()))
    monkeypatch.setattr(bicubic, "register_ground", lambda *_: None)
    assert Bicubic(_gentle())._kernel is None
    assert_allclose(_drive(Bicubic(_gentle())), compiled, rtol=0, atol=1e-8)


def test_without_a_library_nothing_is_opened():
    code = (
        "import importlib.machinery as m; m.EXTENSION_SUFFIXES[:] = []\n"
        "from slipfree.terrain import kernel; assert kernel.library() is None\n"
        "import numpy as np; from slipfree import Bicubic, Grid\n"
        "a = np.arange(5.0); g = Bicubic(Grid(a, a, np.ones((5, 5))))\n"
        "assert g._kernel is None; print(float(g.elevation(2.5, 2.5)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert float(done.stdout) == 1.0
