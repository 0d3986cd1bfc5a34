"""Tests of the search for the nearest ground point: compiled code against the graph."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from helpers.dynamics import four_wheels
from slipfree import Bicubic, Grid, SolverOptions, settle, simulate
from slipfree.contact import touch
from slipfree.models.dynamics import dynamics
from slipfree.terrain import bicubic
from slipfree.vehicle.sections import Disc, Omni, Sphere, Torus

pytestmark = pytest.mark.usefixtures("built")

RADIUS, COUNT = 0.15, 1500
SECTIONS = [Torus(0.03, 0.12), Disc(0.15), Sphere(0.15), Omni(Torus(0.05, 0.1))]


def ground(noise, nodes=40, spacing=0.1):
    """Return waves with noise [m], and a hole in the data."""
    axis = spacing * np.arange(nodes)
    z = 0.15 * np.sin(2 * axis)[:, None] * np.cos(3 * axis)
    z += noise * np.random.default_rng(0).standard_normal(z.shape)
    holes = np.zeros(z.shape, dtype=bool)
    holes[10:14, 20:23] = True
    return Bicubic(Grid(axis, axis, z, holes=holes), mu=0.8)


def questions(terrain):
    """Return centres and axles of wheels in, near, on and above the ground, beyond the map too."""
    rng = np.random.default_rng(1)
    place = rng.uniform(-2.3, 2.3, (2, COUNT))
    x_0, y_0, z_0 = terrain.origin
    height = terrain.elevation(place[0] + x_0, place[1] + y_0) - z_0
    axle = rng.standard_normal((3, COUNT)) * [[1.0], [1.0], [0.4]]
    center = height + RADIUS + rng.uniform(-0.04, 0.06, COUNT)
    return np.vstack([place, center, axle / np.linalg.norm(axle, axis=0)])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("section", "noise"), [*((each, 0.005) for each in SECTIONS), (SECTIONS[0], 0.0)], ids=str
)
def test_the_compiled_search_equals_the_graph(section, noise):
    """The same searches fail in both."""
    terrain = ground(noise)
    compiled = touch.search_function(terrain, section, RADIUS)
    graph = touch._search_graph(terrain, section, RADIUS)
    at = questions(terrain)
    found, expected = (np.array(each.map(COUNT)(at)) for each in (compiled, graph))
    failed = np.isnan(expected)
    assert_array_equal(np.isnan(found), failed)
    assert failed.any() == (noise > 0)
    in_air = (expected[2:6] == 0).all(axis=0)
    assert in_air.any() or not noise
    # a point moves by the inverse Jacobian times a rounding of the residual; the inverse and the
    # Hessian change with the point
    inverse, hessian = (
        np.maximum(1, np.abs(part).max(axis=0)) for part in (expected[2:6], expected[9:])
    )
    # beyond the map, the cubic polynomial of the last cell increases its rounding
    x_0, y_0, _ = terrain.origin
    half = terrain.domain[1] - x_0, terrain.domain[3] - y_0
    cells = np.maximum(0, (np.abs(expected[:2].T) - half).max(axis=1) / 0.1)
    off, kept = np.abs(found - expected), ~failed.any(axis=0)
    assert off[:2, kept].max() < 1e-12
    assert (off / (inverse**2 * hessian * (1 + cells) ** 3))[:, kept].max() < 1e-12


@pytest.mark.parametrize("bad", [0, 4])
def test_a_pose_that_is_not_a_number_gives_none(bad):
    at = np.array([0.1, 0.2, 0.3, 1.0, 0.0, 0.0])
    at[bad] = np.nan
    terrain = ground(0.0)
    for search in (touch.search_function, touch._search_graph):
        found = np.array(search(terrain, SECTIONS[0], RADIUS)(at)).ravel()
        assert np.isnan(found[2:6]).all()


@pytest.mark.slow
def test_a_dynamic_motion_is_the_same_without_the_kernel(monkeypatch):
    def motion():
        terrain = ground(0.0)
        model = dynamics(four_wheels(), terrain)
        start = settle(model, x=1.5, y=0.5, heading=0.2)
        inputs = model.inputs(**{label.full: 5.0 for label in model.labels.u.wheels})
        run = simulate(model, start, inputs, np.linspace(0, 0.3, 4), options=SolverOptions(1e-9))
        return np.array([run[name] for name in ("x", "y", "z", "heading", "pitch", "roll")])

    compiled = motion()
    monkeypatch.setattr(bicubic, "register_ground", lambda *_: None)
    assert ground(0.0)._kernel is None
    assert_allclose(motion(), compiled, rtol=1e-6, atol=1e-6)


def test_a_level_map_is_a_plane():
    axis, heights = np.linspace(0.0, 2.0, 9), np.full((9, 9), 3.25)
    level = touch.plane_of(Bicubic(Grid(axis, axis, heights)))
    assert level is not None
    assert float(level.height) == 0.0  # relative to the local origin
    heights[4, 4] += 1e-9
    assert touch.plane_of(Bicubic(Grid(axis, axis, heights))) is None
