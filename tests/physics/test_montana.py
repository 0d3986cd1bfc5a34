"""Tests of Montana's equations of whole vehicles against the closure model and closed forms.

Angles may differ by whole turns; positions are compared in metres and angles in rad.
"""

from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import cumulative_simpson
from scipy.spatial.transform import Rotation

import slipfree as sf
from helpers.cases import PAPER_RATES, closure_model, drive, hills, rough_hills
from helpers.commands import refuses
from helpers.vehicles import four_wheels
from slipfree.catalog import three_wheeler
from slipfree.core.lookups import LookupTable
from slipfree.geometry.frame import turn
from slipfree.models.montana import ContactCoordinates, cross_check, montana_kinematics, pair

WHEELS = ("right", "left", "front")
T = np.linspace(0, 6, 31)
EVEN = {"right_rate": 0.45, "left_rate": 0.45, "steer_rate": 0.0}
START = {"heading": 0.3, "tilt_right": 0.1, "tilt_left": -0.05, "steer": 0.2}
montana_model = lru_cache(maxsize=8)(montana_kinematics)


GROUNDS = {"hills": sf.Analytic(hills), "rough": rough_hills(4, 33, 0.003, seed=11)}


def both(ground, t, *, vehicle=None, rates=None, tolerance=1e-8, **start):
    """Drive by either formulation from the same start."""
    vehicle = vehicle or three_wheeler()
    closure, montana = closure_model(vehicle, ground), montana_model(vehicle, ground)
    stand = sf.settle(closure, **start)
    rates, options = rates or PAPER_RATES, sf.SolverOptions(tolerance=tolerance)
    return [
        sf.simulate(dae, stand, dae.inputs(**rates), t, options=options)
        for dae in (closure, montana)
    ]


def displaced(run, **by):
    """Return a motion with quantities changed by the amounts given."""
    columns = dict(run.columns)
    for name, amount in by.items():
        columns[name] = columns[name]._replace(values=columns[name].values + amount)
    return replace(run, columns=columns)


def gap(first, second):
    """Return the largest difference of positions and angles."""
    return max(d.size for d in cross_check(first, second) if d.label.unit in ("m", "rad"))


# --- both formulations are one motion -----------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("ground", ["hills", "rough"])
def test_formulations_agree_to_their_errors(ground):
    start = {"x": 0.2, "y": -0.5} | START
    fine = both(GROUNDS[ground], T, tolerance=1e-12, **start)
    runs = both(GROUNDS[ground], T, tolerance=1e-9, **start)
    own = [gap(run, best) for run, best in zip(runs, fine, strict=True)]
    assert all(run.stop is None for run in (*runs, *fine))
    assert gap(*fine) < 1e-9
    assert gap(*runs) < sum(own)
    assert gap(*runs) < 1e-6
    assert max(own) < 1e-6


def test_four_wheels_with_suspension_slip_alike():
    ground = sf.Analytic(lambda x, y: 0.1 * ca.sin(1.3 * x) * ca.cos(0.9 * y))
    rates = {"rear_right_rate": 2.0, "rear_left_rate": 1.7, "steer_rate": 0.02}
    closure, montana = both(
        ground, T, vehicle=four_wheels(rock=True), rates=rates, tolerance=1e-10, x=0.4, heading=0.2
    )
    assert np.abs(closure["slip_along"]).max() > 1e-4
    assert np.abs(closure["rock"]).max() > 0.01
    differences = {d.label.full.split("[")[0]: d.size for d in cross_check(closure, montana)}
    assert {"rock", "psi", "slip_along", "slip_across", "wheel_angle"} <= set(differences)
    assert max(differences.values()) < 1e-7


def test_rolling_law_and_feedback_apply_here_too():
    vehicle, ground = three_wheeler(), GROUNDS["hills"]
    closure = closure_model(vehicle, ground)
    stand = sf.settle(closure, **START)
    runs = []
    for dae in (closure, montana_model(vehicle, ground, slip=sf.Rolling())):
        runs.append(sf.simulate(dae, stand, sf.straight(dae, stand, speed=0.4), T))
    assert gap(*runs) < 2e-6
    assert np.abs(runs[1]["slip_across"]).max() < 1e-12


# --- drift --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_drift_of_a_minute():
    """The error test leaves out the rates: they carry the drift times kappa, noise to it."""
    closure = closure_model(three_wheeler(), GROUNDS["hills"])
    dae = montana_model(three_wheeler(), GROUNDS["hills"])
    given = sf.settle(closure), dae.inputs(**EVEN), np.linspace(0, 60, 121)
    for tolerance, allowed in ((1e-10, 1e-8), (1e-8, 1e-6)):
        run = sf.simulate(dae, *given, options=sf.SolverOptions(tolerance=tolerance))
        assert run.stop is None
        assert 0 < run["drift_position"].max() < allowed
        assert run["drift_rotation"].max() < 2 * allowed
        assert np.abs(run["slip_along"]).max() < 1e-12
    wasteful = replace(dae, suppress_algebraic=False)
    wasteful = sf.simulate(wasteful, *given, options=sf.SolverOptions(tolerance=1e-8))
    assert wasteful.statistics["steps"] > 3 * run.statistics["steps"]


def test_drift_decays_at_kappa():
    """A vehicle put together a little wrong pulls itself right, in place and orientation."""
    vehicle, ground, kappa = three_wheeler(), GROUNDS["hills"], 2.0
    dae = montana_model(vehicle, ground, kappa=kappa)
    stand = displaced(sf.settle(closure_model(vehicle, ground), **START), x=3e-6, psi=1e-5)
    t = np.linspace(0, 1, 11)
    run = sf.simulate(
        dae, stand, dae.inputs(**PAPER_RATES), t, options=sf.SolverOptions(tolerance=1e-11)
    )
    for name, size in (("drift_position", 1e-6), ("drift_rotation", 1e-5)):
        assert run[name][0].min() > size / 2
        decayed = run[name][0] * np.exp(-kappa * t[:, None])
        assert_allclose(run[name], decayed, rtol=1e-3, atol=1e-9)


# --- every wheel knows the platform ---------------------------------------------------------------


# --- what holds the vehicle together --------------------------------------------------------------


def test_three_distances_leave_three_rates_open():
    """Of the platform's and the passive rates: erratum of Chakraborty and Ghosal, section 3."""
    run = drive(GROUNDS["hills"], T[:2], **START)
    heading, roll, pitch = (run[name][0] for name in ("heading", "roll", "pitch"))
    base = Rotation.from_euler("ZYX", [heading, roll, pitch]).as_matrix()
    steered = base @ Rotation.from_euler("z", run["steer"][0]).as_matrix()
    arms, centers = (
        [np.array([run[f"{what}_{a}", w][0] for a in "xyz"]) for w in WHEELS]
        for what in ("contact", "center")
    )
    arms = [c - g for g, c in zip(arms, centers, strict=True)]
    speeds = np.zeros((3, 3, 6))  # of the centres, by Omega, tilt rates and front wheel rate
    for k, arm in enumerate(arms):
        speeds[k, :, :3] = np.cross(np.eye(3), arm).T
    for k in (0, 1):
        speeds[k, :, 3 + k] = np.cross(base[:, 1], arms[k])
    speeds[2, :, 5] = np.cross(-steered[:, 0], arms[2])
    distances, rigid = [], []
    for i, j in ((0, 1), (1, 2), (2, 0)):
        span, apart = centers[i] - centers[j], speeds[i] - speeds[j]
        distances.append(span @ apart)
        apart[:, :3] -= np.cross(np.eye(3), span).T
        rigid.append(apart)
    assert np.linalg.matrix_rank(distances, tol=1e-6) == 3
    # turning with the platform, two of the spans determine all six rates
    assert np.linalg.svd(np.vstack(rigid[:2]))[1].min() > 0.05


def test_twelve_invariants_hold_the_vehicle():
    """Distances and orientations, of 18 states with 6 freedoms; the platform from the triangle."""
    vehicle, ground = three_wheeler(), GROUNDS["hills"]
    q = ca.SX.sym("q", 18)
    spans = [q[5 * k : 5 * k + 5] for k in range(len(vehicle.wheels))]
    poses = [
        pair(wheel, ground, ContactCoordinates(*ca.vertsplit(span)), LookupTable()).pose
        for wheel, span in zip(vehicle.wheels, spans, strict=True)
    ]
    a, b, c = (pose.origin for pose in poses)
    x, up = (a - b) / ca.norm_2(a - b), ca.cross(a - b, c - a)
    up = up / ca.norm_2(up)
    base = ca.horzcat(x, ca.cross(up, x), up)
    hubs = [base @ turn(joint.axis, q[15 + k]).rotation for k, joint in enumerate(vehicle.joints)]
    turned = [
        ca.inv_skew(0.5 * (r - r.T))
        for r in (pose.rotation @ hub.T for pose, hub in zip(poses, hubs, strict=True))
    ]
    distances = ca.vertcat(*(ca.norm_2(i - j) for i, j in ((a, b), (b, c), (c, a))))
    invariants = ca.vertcat(distances, *turned)
    run = drive(ground, T[:2], **START)
    contacts = [
        run[name, w][0]
        for w in WHEELS
        for name in ("contact_x", "contact_y", "wheel_u", "wheel_v", "psi")
    ]
    now = [*contacts, *(run[name][0] for name in ("tilt_right", "tilt_left", "steer"))]
    f = ca.Function("f", [q], [invariants, ca.jacobian(invariants, q)])
    value, jacobian = (np.array(out) for out in f(now))
    assert_allclose(value.ravel(), [2, np.sqrt(3.25), np.sqrt(3.25), *np.zeros(9)], atol=1e-12)
    singular = np.linalg.svd(jacobian)[1]
    assert singular.size == 12
    assert singular.min() > 0.5
    assert np.linalg.matrix_rank(jacobian[:3]) == 3


# --- closed forms -------------------------------------------------------------------------------


def test_straight_over_a_cylindrical_hill():
    """A wheel's path along the ground is its radius times its turn relative to the normal."""
    rates = {"right_rate": 1.2, "left_rate": 1.2, "steer_rate": 0.0}
    ground = sf.Analytic(lambda _, y: 0.4 * ca.cos(0.8 * y))
    t = np.linspace(0, 20, 101)
    for run in both(ground, t, rates=rates, tolerance=1e-10, y=-3.0):
        assert run.stop is None
        assert_allclose(run["x"], 0, atol=1e-8)
        y = np.linspace(-6, 6, 20001)
        path = cumulative_simpson(np.hypot(1, 0.32 * np.sin(0.8 * y)), x=y, initial=0)
        for wheel in WHEELS:
            at = run["contact_y", wheel]
            slope = np.arctan(-0.32 * np.sin(0.8 * at))
            turned = run["wheel_angle", wheel] - run["pitch"] + slope
            travelled = np.interp(at, y, path)
            assert_allclose(travelled - travelled[0], 0.3 * (turned - turned[0]), atol=2e-7)


# --- errors and comparison ------------------------------------------------------------------------


def test_what_is_no_montana_model_is_refused():
    ground = GROUNDS["hills"]
    words = r"wheel 'right': .* with r1 > 0, found the edge of disc radius 0.3 m"
    refuses(sf.ModelError, words, montana_model, three_wheeler(r1=0.0, r2=0.3), ground)
    with pytest.raises(sf.ModelError, match="kappa: expected a"):
        montana_model(three_wheeler(), ground, kappa=np.nan)
    dae, stand = (
        montana_model(three_wheeler(), ground),
        sf.settle(closure_model(three_wheeler(), ground)),
    )
    with pytest.raises(sf.ModelError, match="wheel right has drifted from its position"):
        sf.simulate(dae, displaced(stand, x=0.01), dae.inputs(**PAPER_RATES), T)
    refuses(sf.ModelError, "position on the vehicle; start from the closure", sf.settle, dae)


def test_cross_check_finds_the_farthest_sample():
    run = drive(GROUNDS["hills"], T[:5])
    change = np.full((5, 3), 2 * np.pi)
    change[3, 1] += 0.1
    other = displaced(run, psi=change)
    table = cross_check(run, other)
    worst = max(table, key=lambda row: row.size)
    assert (worst.label.full, worst.t) == ("psi[left]", T[3])
    assert worst.size == pytest.approx(0.1)
    assert all(row.size == 0 for row in table if row is not worst)
    short = cross_check(run.part(slice(3)), other)
    assert max(row.size for row in short) < 1e-14
    with pytest.raises(sf.ModelError, match="expected two motions with the same sample times"):
        cross_check(run, replace(run, t=run.t + 0.1))
