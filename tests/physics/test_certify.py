"""Tests of the single-contact certificate against brute force and closed forms."""

import re

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import RectBivariateSpline
from scipy.spatial.transform import Rotation

import slipfree as sf
from slipfree.catalog import three_wheeler
from slipfree.contact.certify import SecondContact
from slipfree.contact.closure import contact_frame, relative_curvature
from slipfree.core.lookups import LookupTable
from slipfree.terrain.base import jet_of

RADIUS = 0.3


def bump(height, width, x_0, y_0):
    return lambda x, y: height * ca.exp(-((x - x_0) ** 2 + (y - y_0) ** 2) / (2 * width**2))


def brute_clearance(run, wheel, terrain, r1=0.05, r2=0.25):
    """Least vertical gap over a fine torus, away from the contact, for an untilted vehicle."""
    center = np.array([run[f"center_{axis}", wheel][0] for axis in "xyz"])
    rotation = Rotation.from_euler("ZYX", [run[name][0] for name in ("heading", "roll", "pitch")])
    u, v = np.meshgrid(np.linspace(0, np.pi, 241), np.linspace(0, 2 * np.pi, 2881), indexing="ij")
    rho = r2 + r1 * np.sin(u)
    body = np.stack([r1 * np.cos(u), rho * np.cos(v), rho * np.sin(v)], -1)
    points = body @ rotation.as_matrix().T + center
    gap = points[..., 2] - terrain.elevation(points[..., 0], points[..., 1])
    contact = np.array([run[f"contact_{axis}", wheel][0] for axis in "xyz"])
    return gap[np.linalg.norm(points - contact, axis=-1) > 0.12].min()


def drive(dae, end, samples=6, **start):
    """Drive straight ahead."""
    rates = dae.inputs(right_rate=1.0, left_rate=1.0, steer_rate=0.0)
    return sf.simulate(dae, sf.settle(dae, **start), rates, np.linspace(0, end, samples))


def test_clearance_agrees_with_a_brute_search():
    ahead = sf.Analytic(bump(0.14, 0.06, 0.0, 1.28))  # ahead of the front wheel, which is at y = 1
    run = sf.settle(sf.direct_kinematics(three_wheeler(), ahead))
    expected = brute_clearance(run, "front", ahead)
    assert 0 < expected < 0.02
    assert_allclose(run["clearance", "front"][0], expected, atol=2e-4)


def test_second_touch_ends_a_motion_with_its_place_and_a_rest_there_touches_once():
    ground = sf.Analytic(bump(0.2, 0.06, 0.0, 1.25))
    dae = sf.direct_kinematics(three_wheeler(), ground)
    words = drive(dae, 3.0, y=-0.5).stop.words
    assert re.search(r"wheel front touches a second time at \(.*1\.[12]\d\d\) m", words)
    assert brute_clearance(sf.settle(dae), "front", ground) > -1e-6


@pytest.mark.slow
@pytest.mark.parametrize(("r1", "r2"), [(0.05, 0.25), (0.0, 0.3), (0.3, 0.0)])
def test_wheels_of_every_section_see_a_step_ahead(r1, r2):
    """Driving at a smooth step stops where the front wheel touches it, by elementary geometry."""
    rise, at, width = 0.2, 2.0, 0.01
    step = sf.Analytic(lambda _, y: rise / 2 * (1 + ca.tanh((y - at) / width)))
    run = drive(sf.direct_kinematics(three_wheeler(r1=r1, r2=r2), step), 4.0, samples=41)
    assert run.stop is not None
    assert run.stop.name == "clearance[front]"
    assert "wheel front touches a second time" in run.stop.words
    # a wheel on the floor touches a sharp edge of height h at sqrt(R^2 - (R - h)^2) before it
    reach = np.sqrt(RADIUS**2 - (RADIUS - rise) ** 2)
    assert run["center_y", "front"][-1] == pytest.approx(at - reach, abs=3 * width)


@pytest.mark.slow
@pytest.mark.parametrize("beside", [0.08, 0.20])
def test_posts_beside_a_sphere_are_seen(beside):
    """A thin post next to the contact of a fat wheel reaches into it: the wheel stands on it."""
    post = sf.Analytic(bump(0.12, 0.014, 1.0 + beside, -0.5))
    dae = sf.direct_kinematics(three_wheeler(r1=0.3, r2=0.0), post)
    assert "wheel right touches a second time" in drive(dae, 4.0, y=-1.0).stop.words
    start = sf.settle(dae)
    contact = [start[f"contact_{axis}", "right"][0] for axis in "xy"]
    assert_allclose(contact, [1.0 + beside, -0.5], atol=0.03)
    assert brute_clearance(start, "right", post, r1=0.3, r2=0.0) > -1e-6


def test_relative_curvature_of_a_cylindrical_valley():
    """A wheel across a valley of radius a: 1/R - 1/a."""
    for radius in (0.5, 1.0, 5.0):
        valley = sf.Analytic(
            lambda _, y, a=radius: a - ca.sqrt(a**2 - (y - 1.0) ** 2) + 0.0 * y,
            (-2.0, 2.0, 0.8, 1.2),
        )
        dae = sf.direct_kinematics(three_wheeler(), valley)
        limit = next(x for x in dae.limits if x.label.full == "relative_curvature[front]")
        value = ca.Function("k", list(dae.columns()[:2]), [limit.expression])
        z = np.zeros(dae.scale.size)
        z[8] = 1.0  # contact of the front wheel at the bottom
        assert_allclose(float(value(dae.start(), z)), 1 / RADIUS - 1 / radius, atol=1e-12)


def test_relative_curvature_equals_montanas_form(rng):
    """The smaller eigenvalue of ``K_w + K~_g`` changes sign with it (Montana 1988)."""
    wheel = three_wheeler().wheels[0]
    r1, r2 = wheel.section.r1, wheel.section.r2
    a, b, c, x, y = map(ca.SX.sym, "abcxy")
    axle = ca.SX.sym("axle", 3)
    form = {"jet": lambda _, x, y, _lookups: jet_of(a * x**2 + b * x * y + c * y**2, x, y)}
    contact = contact_frame(type("Quadric", (), form)(), x, y, axle, LookupTable())
    value = ca.Function("k", [x, y, axle, a, b, c], [relative_curvature(wheel, contact)])
    signs = []
    for _ in range(400):
        k, lean = rng.uniform(-15, 15, 3), rng.uniform(-0.6, 0.6)
        direction = np.array([np.cos(lean), 0, np.sin(lean)])
        ground_form = np.array([[2 * k[0], k[1]], [k[1], 2 * k[2]]])  # horizontal tangent plane
        wheel_form = np.diag([1 / r1, np.cos(lean) / (r2 + r1 * np.cos(lean))])
        signs.append(np.sign(np.linalg.eigvalsh(wheel_form - ground_form)[0]))
        assert np.sign(float(value(0, 0, direction, *k))) == signs[-1]
    assert set(signs) == {-1.0, 1.0}


def rough_map(rms, seed=3):
    axis = np.linspace(-6, 6, 121)
    waves = 0.3 * np.add.outer(np.sin(0.7 * axis), np.cos(0.5 * axis))
    noise = np.random.default_rng(seed).normal(0, rms, (axis.size, axis.size))
    return sf.Bicubic(sf.Grid(axis, axis, waves + noise))


def test_bounds_of_derivatives_hold_and_are_not_wasteful(rng):
    ground = rough_map(0.002)
    box = -1.3, -0.4, 2.05, 2.2
    x, y = rng.uniform(*box[:2], 20000), rng.uniform(*box[2:], 20000)
    spline = RectBivariateSpline(ground.grid.x, ground.grid.y, ground.grid.z, s=0)
    d = {(m, n): spline.ev(x, y, m, n) for m, n in ((1, 0), (0, 1), (2, 0), (1, 1), (0, 2))}
    slope = np.hypot(d[1, 0], d[0, 1]).max()
    hessian = np.array([[d[2, 0], d[1, 1]], [d[1, 1], d[0, 2]]]).transpose(2, 0, 1)
    curvature = np.abs(np.linalg.eigvalsh(hessian)).max()
    middle, reach = (np.array([0.5 * (box[k] + box[k + 1])]) for k in (0, 2)), 0.45
    bounds = ground.derivative_bounds(*middle, reach)
    assert slope <= bounds[0] < 3 * slope
    assert curvature <= bounds[1] < 6 * curvature
    at = np.array([0.0, 5.9])
    found = ground.derivative_bounds(at, np.zeros(2), 6.0)
    assert (np.isfinite(found) == [True, False]).all()
    each = [ground.derivative_bounds(at[k : k + 1], np.zeros(1), 0.1) for k in range(2)]
    assert_array_equal(ground.derivative_bounds(at, np.zeros(2), 0.1), np.hstack(each))


FORMULAS = {  # with the largest medians and quantiles of bounds over sampled values
    "sines": (lambda x, y: 0.1 * ca.sin(x) * ca.cos(1.3 * y), 1.3, 1.6),
    "a hump": (lambda x, y: 0.3 * ca.exp(-(x**2 + y**2) / 2), 2.2, 3.5),
    "powers": (lambda x, y: 0.2 * ca.tanh(3 * x) + 0.1 * ca.fabs(y) ** 3, 1.2, 3),
    "branches": (lambda x, y: ca.if_else(x > 0, 0.2 * x**3, 0) + ca.sqrt(1 + y**2), 1.2, 4),
    "quotients": (lambda x, y: ca.atan(x) * ca.log(2 + ca.cos(y)) / (3 + ca.sin(x)) ** 1.5, 2, 3.5),
}


@pytest.mark.parametrize("name", FORMULAS)
def test_bounds_of_derivatives_of_formulas_hold_and_are_not_wasteful(name, rng):
    formula, median, most = FORMULAS[name]
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    hessian, gradient = ca.hessian(formula(x, y), ca.vertcat(x, y))
    derivatives = ca.Function("d", [x, y], [gradient, hessian])
    ground = sf.Analytic(formula, (-3.0, 3.0, -3.0, 3.0))
    middle, shift = rng.uniform(-2.75, 2.75, (2, 60)), rng.uniform(-0.2, 0.2, (2, 200))
    bounds = np.array(ground.derivative_bounds(*middle, 0.2))
    points = (middle[..., None] + shift[:, None]).reshape(2, 1, -1)
    slopes, curvatures = (np.array(each).reshape(2, 60, 200, -1) for each in derivatives(*points))
    slopes = np.linalg.norm(slopes, axis=0)[..., 0].max(axis=-1)
    curvatures = np.linalg.norm(curvatures.transpose(1, 2, 0, 3), 2, (2, 3)).max(axis=-1)
    ratios = bounds / np.array([slopes, curvatures])
    assert (ratios >= 1).all()
    assert np.median(ratios) < median
    assert np.quantile(ratios[np.isfinite(ratios)], 0.9) < most
    assert np.isinf(ratios).mean() < 0.2  # where signs and comparisons jump
    assert np.isinf(ground.derivative_bounds(np.array([2.9]), np.zeros(1), 0.2)).all()


@pytest.mark.parametrize("kink", [ca.fabs, lambda x: ca.fmax(-x, x), lambda x: ca.sqrt(x**2)])
def test_a_valley_with_a_kink_has_a_second_contact(kink):
    """The derivatives of a formula have no bounds at a kink, so that points are compared."""
    ground = sf.Analytic(lambda x, _: 0.6 * kink(x) + 0 * x)
    _, curvature = ground.derivative_bounds(np.array([0.1, 1.0]), np.zeros(2), 0.2)
    assert np.isinf(curvature).tolist() == [True, False]
    model = sf.direct_kinematics(three_wheeler(), ground)
    assert "touches a second time" in drive(model, 5.0, x=1.5, heading=np.pi / 2).stop.words


def test_compiled_gaps_are_those_of_the_points(rng, monkeypatch):
    """The evaluator of spline grounds finds the same gaps and points as numpy."""
    check = sf.direct_kinematics(three_wheeler(), rough_map(0.01)).checks[0]
    centers = rng.uniform(-4, 4, (2, 40))
    centers = np.vstack([centers, check.terrain.elevation(*centers)])
    # near the ground, and in it
    lift, turns = rng.uniform(0.24, 0.31, 40), rng.uniform(-0.4, 0.4, 40)
    none, one = 0 * turns, 1 + 0 * turns
    axes = np.array([[np.cos(turns), none, np.sin(turns)], [none, one, none]])
    up = np.cross(axes[0], axes[1], axis=0)
    center = centers - np.array([check.terrain.origin]).T + lift * np.array([[0.0], [0.0], [1.0]])
    placed = np.vstack([center, *axes, up, np.array([[0.0], [0.0], [1.0]]) + 0 * up])
    compiled = check.margin_at(placed)
    monkeypatch.setattr(sf.Bicubic, "smallest_gaps", None)
    assert_allclose(check.margin_at(placed), compiled, atol=1e-13)
    assert (compiled < 0).any()
    assert np.isfinite(compiled[compiled > 0]).any()


@pytest.mark.slow
@pytest.mark.parametrize("rms", [0.0003, 0.002])
def test_certificate_by_curvature_agrees_with_that_by_points(rms, monkeypatch):
    """Without curvature there are at most minima beyond the top of the wheel or at an edge."""
    dae = sf.direct_kinematics(three_wheeler(), rough_map(rms))
    run = sf.simulate(
        dae,
        sf.settle(dae),
        dae.inputs(right_rate=0.5, left_rate=0.45, steer_rate=0.0),
        np.linspace(0, 5, 51),
    )
    excluded = np.isinf(run["clearance"])
    monkeypatch.setattr(
        SecondContact, "_has_single_contact", lambda _, center, __: np.zeros(center.shape[1], bool)
    )
    x, z = (np.transpose([dae.rows(record, run, k) for k in range(run.t.size)]) for record in "xz")
    by_points = np.transpose([check.margin(x, z) for check in dae.checks])
    assert excluded.all() == (rms < 0.002)
    assert (by_points[excluded] > 0.01).all()
    assert_allclose(run["clearance"][~excluded], by_points[~excluded], atol=1e-12)
