"""Tests of surface forms and contact rates against geometry and closed forms."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from helpers.cases import function_of, hills, rough_hills
from slipfree import Analytic
from slipfree.core.lookups import LookupTable, lookup_function
from slipfree.models.montana import ContactCoordinates, Forms, contact_rates, pair, patch
from slipfree.vehicle.sections import Sphere, Torus
from slipfree.vehicle.tree import Wheel

ORIGIN = (0.0, 0.0, 0.0)
WHEELS = {
    "torus": Wheel("torus", "platform", ORIGIN, Torus(0.05, 0.25), driven=True),
    "sphere": Wheel("sphere", "platform", ORIGIN, Sphere(0.3), driven=True),
}
H = 2e-4  # step of the differences, in seconds: rounding and truncation are both near 1e-9
STATES = 125  # for each of 8 pairs of surfaces: 1000


GROUNDS = {
    "plane": Analytic(lambda x, y: 0.3 * x - 0.2 * y),
    "hill": Analytic(hills),
    "saddle": Analytic(lambda x, y: 0.2 * x * x - 0.3 * y * y + 0.1 * x * y),
    "bicubic": rough_hills(2, 21, 0.005, seed=7),
}


# --- forms ------------------------------------------------------------------------------------


def numbers(c, uv):
    """Return a function of uv that gives point, frame and forms as arrays."""
    point, frame, forms = patch(c, uv)
    f = ca.Function("patch", [uv], [ca.densify(each) for each in (point, frame, *forms)])
    return lambda *at: [np.array(out) for out in f(ca.DM(at))]


@pytest.fixture
def uv():
    return ca.SX.sym("uv", 2)


def test_height_map_closed_form(uv):
    """Forms of a height map from its derivatives alone."""
    c = ca.vertcat(uv, hills(uv[0], uv[1]))
    second, gradient = ca.hessian(c[2], uv)
    jet = ca.Function("jet", [uv], [gradient, second])
    h, hh = (np.array(out) for out in jet([0.4, -0.7]))
    h_x, h_y = h.ravel()
    w, g = np.sqrt(1 + h_x**2 + h_y**2), np.sqrt(1 + h_x**2)
    to_arc = np.linalg.inv([[g, h_x * h_y / g], [0, w / g]])
    y_z = h_y / (g * w)
    _, _, metric, curvature, torsion = numbers(c, uv)(0.4, -0.7)
    assert_allclose(metric, np.linalg.inv(to_arc), atol=1e-15)
    assert_allclose(curvature, -to_arc.T @ hh @ to_arc / w, atol=1e-15)
    assert_allclose(torsion, y_z / g * hh[:1] @ to_arc, atol=1e-15)


def test_forms_are_the_derivatives_of_the_frame(uv):
    """Of a surface whose parameter lines are nowhere orthogonal."""
    (u, v), at = ca.vertsplit(uv), [0.5, -0.8]
    skew = ca.vertcat(u + 0.4 * v, v + 0.2 * u * u, 0.3 * ca.sin(u) * ca.cos(v) + 0.2 * u * v)
    _, frame, metric, curvature, torsion = numbers(skew, uv)(*at)
    moving = patch(skew, uv).frame
    slopes = [ca.jacobian(each, uv) for each in (moving[:, 0], moving[:, 2], skew)]
    d_x, d_n, c_uv = (np.array(each) for each in ca.Function("d", [uv], slopes)(at))
    assert_allclose(frame.T @ frame, np.eye(3), atol=1e-15)
    assert np.linalg.det(frame) > 0
    assert_allclose(frame[:, :2] @ metric, c_uv, atol=1e-15)
    assert_allclose(curvature @ metric, frame[:, :2].T @ d_n, atol=1e-14)
    assert_allclose(torsion @ metric, frame[:, 1:2].T @ d_x, atol=1e-14)


# --- contact rates against the motion of the geometric contact ----------------------------------


class Geometry:
    """The contact of two surfaces, found by Newton's method for many poses at once."""

    def __init__(self, wheel, ground):
        at, rotation, origin = ca.SX.sym("at", 4), ca.SX.sym("rotation", 3, 3), ca.SX.sym("o", 3)
        on_wheel = patch(wheel.section.point(at[0], at[1]), at[:2])
        lookups = LookupTable()
        on_ground = patch(height_map(ground, at[2:], lookups), at[2:])
        gap = origin + rotation @ on_wheel.point - on_ground.point
        tangents, normal = on_ground.frame[:, :2], rotation @ on_wheel.frame[:, 2]
        residual = ca.vertcat(tangents.T @ gap, tangents.T @ normal)
        turned = on_ground.frame.T @ rotation @ on_wheel.frame
        psi = ca.atan2(-turned[1, 0], turned[0, 0])
        outputs = [residual, ca.jacobian(residual, at), psi]
        symbols = [at, rotation, origin]
        self.functions = lookup_function(lookups.lookups, "contact", symbols, outputs)

    def coordinates(self, guess, rotation, origin):
        """Return ``u_w, v_w, u_g, v_g, psi`` of n poses near a guess, shape (n, 5)."""
        n, at, step = len(guess), guess.copy(), np.inf
        f, flat = self.functions.map(n), np.concatenate(list(rotation), axis=1)
        for _ in range(8):
            residual, jacobian, psi = (np.array(out) for out in f(at.T, flat, origin.T))
            blocks = jacobian.reshape(4, n, 4).transpose(1, 0, 2)
            step = np.linalg.solve(blocks, residual.T[..., None])[..., 0]
            at = at - step
        assert np.abs(step).max() < 1e-13
        return np.column_stack([at, psi.ravel()])


def height_map(ground, at, lookups):
    return ca.vertcat(at, ground.height(at[0], at[1], lookups))


def right(on, _=None):
    """The forms as they should be; the errata have others in this place."""
    return on.forms


def rates_function(wheel, ground, forms_w=right, forms_g=right):
    """Return ``(q, v, omega) -> (rates, rotation, origin, contact)``; vectors in fixed axes.

    ``q`` and the rates are ordered ``u_w, v_w, u_g, v_g, psi``.
    """
    q, v, omega = ca.SX.sym("q", 5), ca.SX.sym("v", 3), ca.SX.sym("omega", 3)
    lookups = LookupTable()
    both = pair(wheel, ground, ContactCoordinates(q[2], q[3], q[0], q[1], q[4]), lookups)
    wheel_forms, ground_forms = forms_w(both.wheel, q[:2]), forms_g(both.ground, q[2:4])
    rates = contact_rates(
        wheel_forms, ground_forms, both.psi, both.frame.T @ v, both.frame.T @ omega
    )
    outputs = [ca.vertcat(*rates), *both.pose, both.ground.point]
    outputs = [ca.densify(each) for each in outputs]
    return lookup_function(lookups.lookups, "rates", [q, v, omega], outputs)


def random_motions(rng, ground):
    """Return coordinates, tangential velocities and angular velocities, n rows each."""
    u_w = np.pi / 2 + rng.uniform(-0.9, 0.9, STATES)
    v_w, psi = rng.uniform(0, 2 * np.pi, (2, STATES))
    # inside the cells of the rough ground: the rates have a kink on its knots
    places = 0.2 * (rng.integers(-5, 5, (2, STATES)) + rng.uniform(0.05, 0.95, (2, STATES)))
    at = ca.SX.sym("at", 2)
    normal_of = function_of(
        [at], lambda lookups: [patch(height_map(ground, at, lookups), at).frame[:, 2]]
    )
    n = np.array(normal_of.map(STATES)(places)).T
    v, omega = 0.3 * rng.normal(size=(STATES, 3)), rng.normal(size=(STATES, 3))
    v -= (v * n).sum(axis=1, keepdims=True) * n
    return np.column_stack([u_w, v_w, *places, psi]), v, omega


def differences(geometry, q, v, omega, rotation, origin, contact):
    """Return the rates of the contact coordinates by central differences of order four."""
    moved = {}
    for k in (-2, -1, 1, 2):
        turn = Rotation.from_rotvec(omega * H * k).as_matrix()
        arm = np.einsum("nij,nj->ni", turn, origin - contact)
        change = geometry.coordinates(q[:, :4], turn @ rotation, contact + v * H * k + arm) - q
        change[:, 4] = (change[:, 4] + np.pi) % (2 * np.pi) - np.pi
        moved[k] = change
    return (8 * (moved[1] - moved[-1]) - (moved[2] - moved[-2])) / (12 * H)


def errors(rng, wheel, ground, forms_w=right, forms_g=right):
    """Return the largest errors of the five rates over random motions, shape (5,)."""
    q, v, omega = random_motions(rng, ground)
    f = rates_function(wheel, ground, forms_w, forms_g).map(STATES)
    rates, rotation, origin, contact = (np.array(out) for out in f(q.T, v.T, omega.T))
    rotation = rotation.reshape(3, STATES, 3).transpose(1, 0, 2)
    geometry = Geometry(wheel, ground)
    expected = differences(geometry, q, v, omega, rotation, origin.T, contact.T)
    return np.abs(rates.T - expected).max(axis=0)


@pytest.mark.parametrize("ground", GROUNDS)
@pytest.mark.parametrize("wheel", WHEELS)
def test_rates_are_those_of_the_geometric_contact(rng, wheel, ground):
    assert errors(rng, WHEELS[wheel], GROUNDS[ground]).max() < 1e-9


def fundamental(on, uv):
    """Return ``|c_u|, |c_v|``, the second fundamental form and ``c_v . c_uu, c_v . c_uv``."""
    c_u, c_v = ca.horzsplit(ca.densify(ca.jacobian(on.point, uv)))
    c_uu, c_uv = ca.horzsplit(ca.densify(ca.jacobian(c_u, uv)))
    c_vv = ca.densify(ca.jacobian(c_v, uv[1]))
    n, dot = on.frame[:, 2], ca.dot
    second = ca.blockcat([[dot(n, c_uu), dot(n, c_uv)], [dot(n, c_uv), dot(n, c_vv)]])
    return ca.norm_2(c_u), ca.norm_2(c_v), second, (dot(c_v, c_uu), dot(c_v, c_uv))


def printed_curvature(on, uv):
    """Chakraborty and Ghosal, section 2: the columns of K divided once."""
    u, v, second, _ = fundamental(on, uv)
    return on.forms._replace(curvature=-second / ca.repmat(ca.horzcat(u, v), 2, 1))


def printed_torsion(on, uv):
    """Chakraborty and Ghosal, section 2: the entries of T divided once."""
    u, v, _, (t_u, t_v) = fundamental(on, uv)
    return on.forms._replace(torsion=ca.horzcat(t_u / u, t_v / v))


def orthogonal(on, uv):
    """The same with all their factors: forms that hold where c_u and c_v are orthogonal."""
    u, v, second, (t_u, t_v) = fundamental(on, uv)
    sizes = ca.horzcat(u, v)
    torsion = ca.horzcat(t_u / (u * u * v), t_v / (u * v * v))
    return Forms(ca.diag(sizes), -second / (sizes.T @ sizes), torsion)


@pytest.mark.parametrize(
    ("forms_w", "forms_g", "ground", "contact", "psi"),
    [
        (printed_curvature, right, "plane", 1, 1),
        (right, printed_curvature, "hill", 5e-4, 5e-4),
        (printed_torsion, right, "plane", 0, 0.2),
        (right, printed_torsion, "hill", 0, 1e-4),
        (orthogonal, right, "plane", 0, 0),
        (right, orthogonal, "plane", 1e-2, 0),
        (right, orthogonal, "hill", 4e-4, 1e-4),
    ],
)
def test_printed_forms_fail(rng, forms_w, forms_g, ground, contact, psi):
    """Errata of Chakraborty and Ghosal: missing factors, and height maps are not orthogonal.

    ``contact`` and ``psi`` are what the errors exceed; zero says that these rates are right.
    """
    found = errors(rng, WHEELS["torus"], GROUNDS[ground], forms_w, forms_g)
    for error, least in ((found[:4].max(), contact), (found[4], psi)):
        assert error > least if least else error < 1e-9


# --- closed forms -------------------------------------------------------------------------------
