"""Tests of the errata of the three-wheeler paper, each by numbers.

Chakraborty and Ghosal, "Kinematics of wheeled mobile robots on uneven terrain". Tests of its
curvature and torsion forms and of the non-orthogonality of height maps are in ``test_surface.py``.
"""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.cases import drive, hills
from slipfree import Analytic, direct_kinematics, settle
from slipfree.catalog import three_wheeler
from slipfree.geometry.frame import platform, turn

LA, LS, R1 = 1.0, 1.5, 0.05  # the paper's half axle, wheelbase and tube radius [m]
U = {"right": 1.586967, "left": 1.547598, "front": 1.578296}  # printed contact parameters [rad]
CONTACTS = {  # printed contact points on the ground [m]
    "right": np.array([0.983772, -0.037978]),
    "left": np.array([-1.0, 0.0]),
    "front": np.array([0.001578, 1.549151]),
}


def moving_wheel():
    """Return rotation rates of a platform and of a tilted, spinning wheel on it."""
    q, rates = ca.SX.sym("q", 5), ca.SX.sym("rates", 5)  # heading, roll, pitch, tilt, wheel angle
    base = platform(ca.SX(0), ca.SX(0), ca.SX(0), q[0], q[1], q[2])
    wheel = base @ turn("y", q[3]) @ turn("x", q[4])
    return ca.Function("f", [q, rates], [base.twist(q, rates).omega, wheel.twist(q, rates).omega])


def test_equation_3_counts_the_platform_twice(rng):
    """The paper's R_in contains the platform's rotation: it gives the wheel's whole rotation."""
    platform_omega, wheel_omega = (
        np.array(out).ravel() for out in moving_wheel()(rng.normal(size=5), rng.normal(size=5))
    )
    omega_input = wheel_omega  # dR_in/dt R_in', with R_in as printed
    as_printed = platform_omega - omega_input
    assert np.abs(as_printed - wheel_omega).max() > 0.1
    still = moving_wheel()(np.full(5, 0.3), np.array([0.2, 0.1, -0.3, 0, 0]))
    assert_allclose(np.array(still[0]), np.array(still[1]), atol=1e-15)  # no joint moves


def test_equation_5_has_the_wrong_sign():
    """The velocity of the centre is V_w + Omega x (P - C), and P - C = -R_ci."""
    run = drive(Analytic(hills), np.linspace(0, 0.02, 5), tolerance=1e-11)
    h, k = run.t[1], 2
    rates = [run[f"{name}_rate"][k] for name in ("heading", "roll", "pitch")]
    gamma, beta = run["heading"][k], run["roll"][k]
    c, s = np.cos, np.sin
    omega = np.array(
        [  # eq. 4
            rates[2] * c(beta) * c(gamma) - rates[1] * s(gamma),
            rates[2] * c(beta) * s(gamma) + rates[1] * c(gamma),
            rates[0] - rates[2] * s(beta),
        ]
    )
    center = np.stack([run[name] for name in "xyz"])
    wheel = np.stack([run[f"center_{name}", "right"] for name in "xyz"])
    v, v_w = ((p[:, k + 1] - p[:, k - 1]) / (2 * h) for p in (center, wheel))
    arm = wheel[:, k] - center[:, k]  # from the platform's centre to the wheel, as in eq. 7
    assert_allclose(v_w - np.cross(omega, arm), v, atol=1e-7)
    assert np.abs(v_w + np.cross(omega, arm) - v).max() > 1e-2


def test_printed_start_violates_the_printed_geometry():
    def apart(one, other):
        return np.linalg.norm(CONTACTS[one] - CONTACTS[other])

    assert_allclose(apart("right", "front"), 1.866, atol=1e-3)
    assert_allclose(apart("left", "front"), 1.845, atol=1e-3)
    assert_allclose(np.hypot(LA, LS), 1.803, atol=1e-3)  # l_13 = l_23
    assert_allclose(apart("right", "left"), 1.984, atol=1e-3)
    # the contacts lie r1 cos(u) beside the wheels' middles, which are 2 l_a apart
    required = 2 * LA + R1 * (np.cos(U["right"]) - np.cos(U["left"]))
    assert_allclose(required, 1.998, atol=1e-3)


def test_upright_wheels_over_determine_the_start():
    """With v_i = 3 pi/2 for all three wheels and theta = 0 no start on hills is left."""
    dae = direct_kinematics(three_wheeler(), Analytic(hills))
    for heading in np.linspace(-3, 3, 7):
        run = settle(dae, x=0.3, y=0.2, heading=heading)
        assert np.abs(run["wheel_v"][0] - 1.5 * np.pi).max() > 1e-2
    assert sum(label.name == "closure" for label in dae.labels.alg[0]) == 9
    assert len(dae.labels.alg[0]) == dae.alg[0].numel() == 9  # not ten


def test_direct_and_inverse_examples_are_one_motion_to_the_terrains_effect():
    run = drive(Analytic(lambda x, _: 0 * x), np.linspace(0, 6, 601))
    printed = {"velocity_x": 0.01255, "velocity_y": 0.12865, "heading_rate": 0.0159}
    for name, value in printed.items():
        assert run[name][0] == pytest.approx(value, rel=0.2)
    lying = run.t[np.abs(run["tilt_right"]) > 0.35][0]
    assert lying == pytest.approx(4.6, abs=0.15)  # on its unknown ground about 4.7 s


def test_three_wheels_need_a_heading_besides_one_contact_point():
    """One contact point leaves the heading open: starts about it differ."""
    dae = direct_kinematics(three_wheeler(), Analytic(hills))
    starts = [settle(dae, heading=heading) for heading in (0.0, 0.4)]
    assert abs(starts[0]["z"][0] - starts[1]["z"][0]) > 1e-4
