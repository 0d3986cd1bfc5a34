"""Force balance of logs: limits, known truth, ages and holds, intervals, folds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import root

import slipfree as sf
from helpers.drives import HILL, ROBOTS, TRUE, Truth, draws_of_fits, drives, log_of, model, unknowns
from slipfree.core.records import Array
from slipfree.fit.drive_fit import (
    Fitted,
    WindowKind,
    age_priors,
    conformal,
    fit_drives,
    fit_on_uncertain_map,
    folds_of,
    judge,
    manoeuvres_of,
)
from slipfree.fit.drives import (
    DriveLog,
    Predictor,
    Slopes,
    age_of_poses,
    held_for,
    windows_of,
    without_holds,
)
from slipfree.fit.estimate import Unknown
from slipfree.fit.force_balance import (
    Chassis,
    Constants,
    chassis_of,
    integrate,
    track,
    with_dimensions,
)
from slipfree.fit.force_balance import simulate as simulate_lanes
from slipfree.vehicle.tree import body_inertia, wheel_inertia

LEVEL = sf.Analytic(lambda x, _: 0 * x, mu=0.6)


def constants(chassis: Chassis, **given: Any) -> Constants:
    """Return constants of one set."""
    values = {"track": 1.0, "center": 0j, "stiffness": 6.0, "gyration": 0.2, "friction": 0.6}
    values |= {"rolling": 1.0, "anisotropy": 1.0, "turn_slope": 0.0} | given
    own = {key: values.pop(key) for key in ("inertia", "gravity") if key in values}
    radius = values.pop("radius", np.ones(len(chassis.place)))
    arrays = {name: np.full((1, 1), value) for name, value in values.items()}
    return Constants(radius=np.reshape(radius, (-1, 1, 1)), **arrays, **own)


def steady(chassis: Chassis, inputs: Array, **given: Any) -> tuple[float, float, float]:
    """Return speeds ahead and to the left [m/s] and turning rate [rad/s] at constant inputs."""
    signals = np.repeat(np.reshape(inputs, (-1, 1, 1)), 2, axis=2)
    rows = np.zeros((400, 1), int)
    v, w = simulate_lanes(chassis, constants(chassis, **given), signals, rows, 0.1)
    return float(v[-1, 0, 0].real), float(v[-1, 0, 0].imag), float(w[-1, 0, 0])


def by_wheels(vehicle: Any) -> tuple[Chassis, Array]:
    """Return the wheels of a skid-steered vehicle, driven by its sides, and their radii."""
    signals = [int(place > 0) for place in vehicle.centers[:, 0]]
    radii = np.array([float(wheel.radius) for wheel in vehicle.wheels])
    return chassis_of(vehicle, signals, {}), radii


def steady_of(dae: Any, left: float, right: float) -> tuple[float, float]:
    """Return length of the chord [m] and turn [rad] of a model in one second."""
    names = [w.name for w in dae.vehicle.wheels]
    inputs = dae.inputs(**{f"{name}_rate": left if "left" in name else right for name in names})
    run = sf.simulate(dae, sf.settle(dae), inputs, [0.0, 0.5, 1.0], options=sf.SolverOptions(1e-9))
    chord = np.hypot(run["x"][-1] - run["x"][0], run["y"][-1] - run["y"][0])
    return float(chord), float(run["heading"][-1] - run["heading"][0])


def chord_and_turn(chassis: Chassis, **given: Any) -> tuple[float, float]:
    """Return length of the chord [m] and turn [rad] in one second, without inertia."""
    ahead, left, turn = steady(chassis, np.array([2.0, 4.0]), inertia=0.0, **given)
    return float(np.hypot(ahead, left) * np.sin(turn / 2) / (turn / 2)), turn


def low_vehicle(wheels: dict[str, tuple[float, float]]) -> tuple[sf.Vehicle, complex]:
    """Return a rigid vehicle with the centre of mass at the ground, and that centre.

    Forces at the ground do not change its loads.
    """
    vehicle = sf.catalog.rigid_skid_steer()
    first = vehicle.wheels[0]
    at = (0.02, 0.05, -first.radius)
    own = tuple(replace(first, name=name, at=(*xy, 0.0)) for name, xy in wheels.items())
    low = replace(vehicle, wheels=own, body=replace(vehicle.body, at=at))
    places = np.array([at[:2], *wheels.values()])
    right, ahead = np.average(places, axis=0, weights=[low.body.mass, *(w.mass for w in own)])
    return low, complex(ahead, -right)


THREE = {"front_left": (-0.3, 0.3), "front_right": (0.3, 0.25), "rear_left": (-0.2, -0.3)}
FOUR = {wheel.name: wheel.at[:2] for wheel in sf.catalog.rigid_skid_steer().wheels}


@pytest.mark.parametrize("creep", [2.0, 0.3, 0.1, 0.01, 1e-3])
def test_without_inertia_it_is_quasi_static_friction(creep: float) -> None:
    """With the slip stiffness of the law, and with its creep."""
    vehicle, center = low_vehicle(THREE)
    chassis, radii = by_wheels(vehicle)
    found = chord_and_turn(chassis, center=center, stiffness=0.6 / creep, radius=radii)
    stiff = sf.Coulomb(1e-6, slip_stiffness=0.6 / creep)
    for law in (stiff, sf.Coulomb(creep)) if creep <= 0.3 else (stiff,):
        exact = steady_of(sf.quasi_statics(vehicle, LEVEL, law=law), 2.0, 4.0)
        assert_allclose(found, exact, rtol=1e-6)


# forces at the ground load the rocker, the more the less wheels slip
@pytest.mark.parametrize(("creep", "error"), [(0.3, 2e-3), (0.1, 4e-3)])
def test_moments_of_forces_at_the_ground_change_little(creep: float, error: float) -> None:
    vehicle = sf.catalog.skid_steer(center_of_mass=(0.0, 0.05, 0.0))
    chassis, radii = by_wheels(vehicle)
    masses = vehicle.body.mass + sum(wheel.mass for wheel in vehicle.wheels)
    center = 0.05 * vehicle.body.mass / masses + 0j
    found = chord_and_turn(chassis, center=center, stiffness=0.6 / creep, radius=radii)
    exact = steady_of(sf.quasi_statics(vehicle, LEVEL, law=sf.Coulomb(creep)), 2.0, 4.0)
    assert_allclose(found, exact, rtol=error)


@pytest.mark.parametrize("vehicle", [sf.catalog.skid_steer(), sf.catalog.rigid_skid_steer()])
def test_viscous_slip_without_inertia_is_least_slip(vehicle: sf.Vehicle) -> None:
    chassis, radii = by_wheels(vehicle)
    found = chord_and_turn(chassis, stiffness=1e-3, friction=1.0, radius=radii)
    exact = steady_of(sf.direct_kinematics(vehicle, LEVEL, slip=sf.LeastSlip()), 2.0, 4.0)
    assert_allclose(found, exact, rtol=1e-6)


def test_stiff_slip_is_coulomb_friction() -> None:
    """Forces of friction without creep are in equilibrium; level friction cancels."""
    vehicle, center = low_vehicle(FOUR)
    chassis, radii = by_wheels(vehicle)
    rims = radii * np.array([2.0, 4.0])[chassis.signal]
    arms = chassis.place[:, 0] - center
    loads = np.linalg.pinv(np.array([np.ones(4), arms.real, arms.imag])) @ [1.0, 0.0, 0.0]

    def unbalanced(motion: Array) -> Array:
        slip = motion[0] + 1j * motion[1] + 1j * motion[2] * arms - rims
        force = loads * slip / np.abs(slip)
        return np.array([force.sum().real, force.sum().imag, (arms.conj() * force).imag.sum()])

    given = {"center": center, "inertia": 0.0, "radius": radii}

    def motion(friction: float, stiffness: float) -> Array:
        inputs = np.array([2.0, 4.0])
        ahead, left, turn = steady(chassis, inputs, stiffness=stiffness, friction=friction, **given)
        moved = ahead + 1j * left + 1j * turn * center
        return np.array([moved.real, moved.imag, turn])

    found = motion(0.6, 1e8)
    exact = root(unbalanced, found, tol=1e-12)
    assert exact.success
    assert_allclose(found, exact.x, rtol=1e-6)
    assert_allclose(motion(0.3, 30.0), motion(0.6, 60.0), atol=1e-9)


def test_large_gravity_is_quasi_static() -> None:
    """Forces of friction are then large against those of inertia."""
    made = drives(1)
    chassis = log_of(made, 0).chassis
    signals = made[1].transpose(1, 2, 0)
    rows = np.arange(200)[:, None]
    turns = []
    for given in ({"gravity": 9.81e4}, {"inertia": 0.0}):
        _, w = simulate_lanes(chassis, constants(chassis, **given), signals, rows, 0.05)
        turns.append(w[:, 0, 0])
    assert_allclose(*turns, atol=2e-3 * np.abs(turns[0]).max())


def test_it_repeats_an_explicit_integration() -> None:
    truth = Truth()
    t, sides, place, heading = drives(2, truth)
    chassis = log_of((t, sides, place, heading), 0).chassis
    own = constants(
        chassis, radius=[0.98, 0.98, 1.02, 1.02], center=0.05 + 0j, stiffness=3.0, gyration=0.3
    )
    rows = np.arange(200)[:, None] + np.array([[200, 500]])
    signals = sides[:, :, [0]].transpose(1, 2, 0)
    v, w = simulate_lanes(chassis, own, signals, rows, 0.05)
    path, turned = integrate(v, w, 0.05)
    for k, first in enumerate((200, 500)):
        part = slice(first + 100, first + 200)
        exact = (place[part, 0] - place[first + 100, 0]) * np.exp(-1j * heading[first + 100, 0])
        found = (path[100:, 0, k] - path[100, 0, k]) * np.exp(-1j * turned[100, 0, k])
        assert np.abs(found - exact).max() < 0.03
        exact = heading[part, 0] - heading[first + 100, 0]
        assert_allclose(turned[100:, 0, k] - turned[100, 0, k], exact, atol=0.02)


@pytest.mark.slow
def test_it_follows_dynamics_with_compliant_contacts() -> None:
    """Twenty manoeuvres of two seconds, with a centre of mass at the ground."""
    vehicle, center = low_vehicle(FOUR)
    chassis, radii = by_wheels(vehicle)
    x, y = np.array([vehicle.body.at[:2], *(wheel.at[:2] for wheel in vehicle.wheels)]).T
    masses = np.array([vehicle.body.mass, *(wheel.mass for wheel in vehicle.wheels)])
    squares = np.abs(y - 1j * x - center) ** 2
    spin = body_inertia(vehicle, "platform")[2, 2] + sum(
        wheel_inertia(w)[1] for w in vehicle.wheels
    )
    gyration = float((spin + masses @ squares) / masses.sum())
    given = {"radius": radii, "stiffness": 6.0, "gyration": gyration, "center": center}
    dae, t = (
        sf.dynamics(vehicle, LEVEL, law=sf.Compliant(slip_stiffness=6.0)),
        np.linspace(0, 2, 41),
    )
    for seed in range(20):
        size, speed = np.random.default_rng(seed).uniform(-1, 1, (2, 2))
        rates = [
            3 + 2 * a * ca.sin((1.6 + 0.4 * b) * dae.t) ** 2
            for a, b in zip(size, speed, strict=True)
        ]
        names = {f"{w.name}_rate": rates["right" in w.name] for w in vehicle.wheels}
        run = sf.simulate(dae, sf.settle(dae, speed=3 * radii[0]), dae.inputs(**names), t)
        signals = 3 + 2 * size * np.sin((1.6 + 0.4 * speed) * t[:, None]) ** 2
        rows = np.arange(t.size)[:, None]
        moved = simulate_lanes(chassis, constants(chassis, **given), signals.T[:, None], rows, 0.05)
        path, turned = integrate(*moved, 0.05)
        heading = run["heading"] - run["heading"][0]
        place = (run["x"] - run["x"][0] + 1j * (run["y"] - run["y"][0])) / 1j
        place *= np.exp(-1j * run["heading"][0])
        length = np.abs(np.diff(place)).sum()
        assert np.abs(path[:, 0, 0] - place).max() < 0.01 * length
        assert np.abs(turned[:, 0, 0] - heading).max() < 0.01 * np.abs(heading).max()


def test_rollers_move_freely() -> None:
    """A mecanum vehicle moves sideways with least slip."""
    vehicle = sf.catalog.mecanum()
    radii = np.array([float(wheel.radius) for wheel in vehicle.wheels])
    chassis = chassis_of(vehicle, range(len(vehicle.wheels)), {})
    names = [wheel.name for wheel in vehicle.wheels]
    dae = sf.direct_kinematics(vehicle, LEVEL, slip=sf.LeastSlip())
    rates = dict(zip(names, (1.0, -1.0, -1.0, 1.0), strict=True))
    run = sf.simulate(
        dae, sf.settle(dae), dae.inputs(**{f"{k}_rate": v for k, v in rates.items()}), [0.0, 1.0]
    )
    given = {"stiffness": 100.0, "radius": radii}
    ahead, left, turn = steady(chassis, np.array([*rates.values()]), **given)
    moved = np.array([run["x"][-1] - run["x"][0], run["y"][-1] - run["y"][0]])
    assert_allclose([-left, ahead, turn], [*moved, run["heading"][-1]], atol=1e-3)


def test_known_truth_is_found() -> None:
    made = drives(2)
    logs = [log_of(made, k) for k in range(2)]
    windows = windows_of(logs, duration=2.0)
    own = model(*TRUE)
    found = fit_drives(own, Predictor(own, logs, windows), manoeuvres_of(logs, windows))
    for name, value, true in zip(TRUE, found.values, TRUE.values(), strict=True):
        assert value == pytest.approx(true, rel=0.1, abs=0.01), name
    assert np.abs(found.errors[windows.first > 0]).max() < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_bias_is_below_half_a_deviation(robot: str) -> None:
    errors, deviations, inside = draws_of_fits(*ROBOTS[robot], 20)
    bias = errors.mean(axis=0) / deviations.mean(axis=0)
    assert (np.abs(bias) < 0.5).all(), bias
    assert 0.9 <= inside.mean() <= 0.98


def late(log: DriveLog, age: int, held: int) -> DriveLog:
    """Return a log whose poses are ``age`` samples old and new every ``held`` samples."""
    n = log.place.size
    rows = np.maximum(np.arange(n) // held * held - age, 0)
    assert log.heading is not None
    return log._replace(
        place=log.place[rows], heading=log.heading[rows], fresh=np.arange(n) % held == 0
    )


@pytest.mark.parametrize("has_rate", [False, True])
def test_age_of_held_poses_is_found(has_rate: bool) -> None:
    made = drives(2)
    logs = [late(log_of(made, k), 8, 4) for k in range(2)]
    if has_rate:
        logs = [
            log._replace(yaw_rate=np.gradient(made[3][:, k], 0.05)) for k, log in enumerate(logs)
        ]
        assert age_of_poses(logs[0]) == pytest.approx(0.4, abs=0.03)
    windows = windows_of(logs, duration=4.0)
    own = model(*TRUE, "age")
    own = own._replace(unknowns=age_priors(own.unknowns, logs))
    found = fit_drives(own, Predictor(own, logs, windows), manoeuvres_of(logs, windows))
    assert found.values[-1] == pytest.approx(0.4, abs=0.02)
    assert found.values[2] == pytest.approx(3.0, rel=0.2)


def test_held_readings_are_linear_between_new_ones() -> None:
    t = np.arange(400)
    smooth = 3 + np.sin(t / 30)
    run = (t >= 200).astype(int)
    held = smooth[t // 5 * 5]
    found, period = without_holds(held, run)
    assert period == 5
    inside = (t % 200 > 5) & (t % 200 < 195)
    assert np.abs(found - smooth)[inside].max() < 0.01
    assert without_holds(smooth, run)[1] == 1
    standing = np.where((t > 60) & (t < 120), 2.0, held)
    assert_allclose(without_holds(standing, run)[0][70:110], 2.0)
    assert held_for(np.diff(held, prepend=held[0]) != 0) == 5


@pytest.mark.slow
def test_two_surfaces_share_a_vehicle() -> None:
    """Friction alone differs; the other constants follow from both."""
    logs = [
        log_of(drives(1, Truth(friction=mu)), 0, name, name)
        for mu, name in ((0.6, "road"), (0.15, "ice"))
    ]
    windows = windows_of(logs, duration=2.0)
    own = model("stiffness")
    both = tuple(Unknown(f"friction_{name}", "friction", of=name) for name in ("road", "ice"))
    own = own._replace(
        unknowns=(*unknowns(*list(TRUE)[:3]), *both),
        fixed={"gyration": 0.3, "center_of_mass_ahead": 0.05},
    )
    found = fit_drives(own, Predictor(own, logs, windows), manoeuvres_of(logs, windows))
    assert_allclose(found.values[-2:], [0.6, 0.15], rtol=0.05)
    assert found.values[2] == pytest.approx(3.0, rel=0.15)


HILLY = Truth(turn_slope=2.0, stiffness=10.0, ahead=0.0)


@pytest.mark.slow
@pytest.mark.parametrize("has_headings", [True, False])
def test_slopes_are_those_under_the_predicted_path(has_headings: bool) -> None:
    made = drives(3, HILLY, duration=60.0, size=1.0)
    logs = [log_of(made, k, "abc"[k], has_headings=has_headings) for k in range(3)]
    slopes = Slopes(HILL, 0.0)
    windows = windows_of(logs, length=5.0)
    own = model("radius_left", "radius_right", "stiffness", "turn_slope", friction=0.6)
    found = fit_drives(own, Predictor(own, logs, windows, slopes), windows.log)
    assert_allclose(found.values[:2], [0.98, 1.02], atol=0.001)
    assert found.values[2] == pytest.approx(10, rel=0.1)
    assert found.values[3] == pytest.approx(2.0, rel=0.05)
    assert np.median(np.abs(found.errors[:, :2])) < 0.02
    few = windows.take(np.arange(1))
    predict = Predictor(own, logs, few, slopes)
    with pytest.raises(sf.ModelError, match="more residuals than the 4 unknowns, found 1"):
        fit_drives(own, predict, few.log)


@pytest.mark.slow
def test_wrong_maps_widen_the_intervals() -> None:
    from slipfree.terrain.grid_ops import disturbed

    made = drives(3, HILLY, duration=60.0, size=1.0)
    logs = [log_of(made, k, has_headings=False) for k in range(3)]
    windows = windows_of(logs, length=5.0)
    own = model("radius_left", "radius_right", "turn_slope", friction=0.6, stiffness=10.0)
    grid = disturbed(HILL, 0.1, 3.0, 5)
    further = [Slopes(disturbed(grid, 0.1, 3.0, k), 0.0) for k in range(3)]
    plain = fit_on_uncertain_map(own, logs, windows, (Slopes(grid, 0.0), []))
    found = fit_on_uncertain_map(own, logs, windows, (Slopes(grid, 0.0), further))
    reach = np.diff(found.estimate.intervals, axis=1)[:, 0]
    assert (reach >= np.diff(plain.estimate.intervals, axis=1)[:, 0]).all()
    low, high = found.estimate.intervals[2]
    assert low < 2.0 < high


@pytest.mark.slow
def test_campaigns_and_manoeuvres_are_left_out() -> None:
    made = drives(4)
    logs = [log_of(made, k, "ab"[k % 2], noise=0.01) for k in range(4)]
    own = model("radius_left", "radius_right", "stiffness", center_of_mass_ahead=0.05)
    kinds = [WindowKind(0.0, 2.0), WindowKind(5.0), WindowKind(0.0, 100.0)]
    _, fitted, scores = judge(own, logs, (None, []), kinds)
    assert [*scores] == kinds[:2]  # no window is as long as the third kind
    score = scores[0.0, 2.0]
    assert score.campaigns == 1  # of the fitted ones, with one left out
    assert 0.85 < score.coverage.mean() <= 1
    assert_allclose(np.sort(folds_of(logs, windows_of(logs, duration=2.0))) < 2, 1)
    alone = [logs[0]]
    windows = windows_of(alone, duration=2.0)
    folds = folds_of(alone, windows)
    assert set(folds) == set(range(5))
    for part in range(5):
        numbers = alone[0].manoeuvre[windows.first[folds == part]]
        others = alone[0].manoeuvre[windows.first[folds != part]]
        assert not set(numbers) & set(others)
    _, _, scores = judge(own, logs, (None, []), kinds[:1], [log_of(made, 3, "c")])
    assert scores[0.0, 2.0].campaigns == 2
    assert {*fitted} == {*kinds[:2]}


def test_intervals_know_of_campaigns() -> None:
    """Half widths grow with the spread of the errors of campaigns, and with few campaigns."""
    rng = np.random.default_rng(0)

    def reach(scales: list[float]) -> float:
        errors = np.concatenate([s * rng.normal(size=(400, 3)) for s in scales])
        names = np.repeat([str(k) for k in range(len(scales))], 400)
        own = Fitted(errors, np.full(len(errors), "g"), names, np.zeros(len(errors)))
        widths, count = own.reach(np.array(["g"]), np.zeros(1))
        assert count == len(scales)
        return float(widths[2, 0]) / conformal(errors[:, 2])

    one, three, many = reach([1.0]), reach([1.0] * 3), reach([1.0] * 20)
    assert one == pytest.approx(np.exp(0.84 * 0.25 * np.sqrt(2)), rel=1e-3)
    assert one > three > many > 1
    assert reach([0.5, 1.0, 2.0]) > 1.25 * three


def test_conformal_intervals_hold() -> None:
    rng = np.random.default_rng(0)
    inside = [abs(rng.normal()) <= conformal(rng.normal(size=30)) for _ in range(4000)]
    assert 0.885 < np.mean(inside) < 0.925  # 28 / 31 = 0.903


def test_windows_leave_out_bad_positions() -> None:
    log = log_of(drives(1), 0)
    good, piece = log.good.copy(), log.piece.copy()
    good[300:360], piece[600:] = False, 1
    windows = windows_of([log._replace(good=good, piece=piece)], duration=2.0)
    for first, last in zip(windows.first, windows.last, strict=True):
        assert good[first]
        assert good[last]
        assert piece[first] == piece[last]
    pieces = windows_of([log._replace(piece=np.arange(log.place.size) // 40)])
    assert_allclose(pieces.last - pieces.first, 39)
    with pytest.raises(sf.ModelError, match="found none; use longer logs or shorter windows"):
        windows_of([log], length=1e4)


def test_slopes_of_a_plane() -> None:
    """The sine of the angle ahead, and that of the wheels' axle."""
    axis = np.arange(-40.0, 41.0)
    plane = sf.Grid(axis, axis, 0.2 * axis[:, None] - 0.1 * axis)
    place, heading = np.array([3.3 - 7.1j, 60.0 + 2.0j]), np.array([0.4, 0.4])
    up, left = Slopes(plane, 1.5).tilt(place, heading)
    normal = np.array([-0.2, 0.1, 1]) / np.sqrt(1.05)
    ahead = np.array([np.cos(0.4), np.sin(0.4), 0.2 * np.cos(0.4) - 0.1 * np.sin(0.4)])
    ahead /= np.linalg.norm(ahead)
    assert_allclose(up, ahead[2], atol=1e-9)
    assert_allclose(left, np.cross(normal, ahead)[2], atol=1e-9)


def test_dimensions_of_a_vehicle() -> None:
    vehicle = sf.catalog.skid_steer()
    changed = with_dimensions(vehicle, {"front_left": 0.2}, 0.8, {1: 0.1}, 0.3)
    assert track(changed) == pytest.approx(0.8)
    radii = {wheel.name: wheel.radius for wheel in changed.wheels}
    assert radii["front_left"] == pytest.approx(0.2)
    assert radii["rear_left"] == pytest.approx(0.15)
    assert radii["front_right"] == vehicle.wheels[0].radius
    masses = np.array([mass for _, mass, _ in changed.masses()])
    places = np.array([ca.evalf(place).full().ravel() for *_, place in changed.masses()])
    center = masses @ places / masses.sum()
    assert center[1] == pytest.approx(0.1)
    assert changed.body.at[0] == vehicle.body.at[0]
    spins = [wheel_inertia(wheel)[1] for wheel in changed.wheels]
    spins += [body_inertia(changed, name)[2, 2] for name, body in changed.bodies if body.mass]
    squares = ((places - center)[:, :2] ** 2).sum(axis=1)
    assert (masses @ squares + sum(spins)) / masses.sum() == pytest.approx(0.3)
    with pytest.raises(sf.ModelError, match=r"moment of inertia over mass above 0\.\d+ m\^2"):
        with_dimensions(vehicle, {}, gyration=0.01)
