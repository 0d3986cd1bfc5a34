"""Logs of skid-steered vehicles with known constants, by explicit steps of their own, and fits."""

from __future__ import annotations

from functools import cache
from itertools import product
from typing import NamedTuple

import numpy as np

from slipfree.core.records import Array
from slipfree.fit.drive_fit import Scale, fit_drives
from slipfree.fit.drives import DriveLog, Model, Predictor, windows_of
from slipfree.fit.estimate import Unknown
from slipfree.fit.force_balance import Chassis
from slipfree.terrain.base import Grid

AXIS = np.arange(-40.0, 41.0)
HALF = 0.4  # half track and half wheelbase [m]
GRAVITY = 9.81  # [m/s^2]


class Truth(NamedTuple):
    """Constants of a vehicle."""

    radius_left: float = 0.98
    radius_right: float = 1.02
    friction: float = 0.6
    stiffness: float = 3.0  # [s/m]
    gyration: float = 0.3  # [m^2]
    ahead: float = 0.05  # centre of mass [m]
    turn_slope: float = 0.0
    half_base: float = HALF  # [m]
    half_track: float = HALF


TRUTH = Truth()


def four_wheels(half_track: float, half_wheelbase: float) -> Chassis:
    """Return four wheels whose sides are driven by the inputs 0, left, and 1, right."""
    x, y = half_wheelbase * np.array([1, -1, 1, -1]), half_track * np.array([1, 1, -1, -1])
    place = (x + 1j * y)[:, None]
    ones, signal = np.ones_like(place), np.array([0, 0, 1, 1])
    return Chassis(place, ones, 0 * ones, signal, np.ones(4), np.empty((4, 0)))


def height(x: Array, y: Array) -> Array:
    """Return the height of a hillside [m]."""
    return 2.5 * np.sin(x / 9) * np.cos(y / 11) + 0.05 * x


HILL = Grid(AXIS, AXIS, height(*np.meshgrid(AXIS, AXIS, indexing="ij")))


def gradient(place: Array, size: float) -> Array:
    """Return the exact gradient of the hillside times a factor, as x + i y."""
    x, y = place.real / 9, place.imag / 11
    across = -2.5 / 11 * np.sin(x) * np.sin(y)
    return size * (2.5 / 9 * np.cos(x) * np.cos(y) + 0.05 + 1j * across)


def rates_of(state: Array, sides: Array, truth: Truth, size: float) -> Array:
    """Return derivatives of place, heading, velocity and turning rate, shape (4, n), complex."""
    place, heading, v, w = state[0], state[1].real, state[2], state[3].real
    ahead = np.exp(1j * heading)
    slope = gradient(place, size) * ahead.conj()
    along = slope.real / np.sqrt(1 + slope.real**2)
    left = slope.imag / np.sqrt(1 + slope.real**2) / np.sqrt(1 + np.abs(slope) ** 2)
    cosine = 1 / np.sqrt(1 + np.abs(slope) ** 2)
    factor = np.exp(-truth.turn_slope * along)
    speeds = sides * np.array([[truth.radius_left], [truth.radius_right]])
    mean = speeds.mean(axis=0)
    speeds = mean + (speeds - mean) * factor
    force, moment = -GRAVITY * (along + 1j * left), 0.0
    base, width = truth.half_base, truth.half_track
    for x in (base, -base):
        for side, y in enumerate((width, -width)):
            r = x - truth.ahead + 1j * y
            load = GRAVITY * cosine * (1 + truth.ahead * x / base**2) / 4
            slip = v + 1j * w * r - speeds[side]
            size_of_slip = np.hypot(np.abs(slip), truth.friction / truth.stiffness)
            own = -truth.friction * load * slip / size_of_slip
            force, moment = force + own, moment + (np.conj(r) * own).imag
    center = v - 1j * w * truth.ahead  # the platform's centre
    along_map = center.real * np.sqrt(1 - along**2) + 1j * center.imag * np.sqrt(1 - left**2)
    return np.array([along_map * ahead, w + 0j, force - 1j * w * v, moment / truth.gyration + 0j])


@cache
def drives(
    count: int,
    truth: Truth = TRUTH,
    *,
    duration: float = 40.0,
    speed: float = 1.0,
    size: float = 0.0,
    seed: int = 0,
) -> tuple[Array, Array, Array, Array]:
    """Return times, speeds of sides (n, 2, count), places and headings (n, count) every 0.05 s.

    Speeds of sides are linear between knots two seconds apart; vehicles far away turn back.
    """
    rng, fine, dt = np.random.default_rng(seed), 5, 0.05
    t = np.arange(0, duration, dt)
    knots = rng.uniform(0.2, 1.8, (2, int(duration / 2) + 2, count)) * speed
    if size:
        turn = 0.35 * (knots[1] - knots[0])
        knots = np.array([0.5 - turn / 2, 0.5 + turn / 2])
    sides = np.empty((t.size, 2, count))
    state = np.zeros((4, count), complex)
    state[0], state[1] = (
        rng.uniform(-15, 15, (2, count)).T @ [1, 1j] * (size > 0),
        rng.uniform(-3, 3, count),
    )
    path = np.empty((t.size, 2, count), complex)

    def at(time: float) -> Array:
        k = int(time // 2)
        return knots[:, k] + (time / 2 - k) * (knots[:, k + 1] - knots[:, k])

    state[2] = at(0.0).mean(axis=0)
    for k, time in enumerate(t.tolist()):
        sides[k], path[k] = at(time), state[:2]
        h = dt / fine
        for j in range(fine):
            now = time + j * h
            a = rates_of(state, at(now), truth, size)
            b = rates_of(state + h / 2 * a, at(now + h / 2), truth, size)
            c = rates_of(state + h / 2 * b, at(now + h / 2), truth, size)
            d = rates_of(state + h * c, at(now + h), truth, size)
            state = state + h / 6 * (a + 2 * b + 2 * c + d)
    return t, sides, path[:, 0], path[:, 1].real


def log_of(
    made: tuple[Array, Array, Array, Array],
    k: int,
    campaign: str = "a",
    surface: str = "ground",
    *,
    noise: float = 0.0,
    has_headings: bool = True,
) -> DriveLog:
    """Return the log of one vehicle, with normal errors of positions [m] and headings [rad]."""
    t, sides, place, heading = made
    rng, n = np.random.default_rng(k), t.size
    z = place[:, k] + noise * (rng.normal(size=(n, 2)) @ [1, 1j])
    return DriveLog(
        *(f"log {k}", campaign, surface, 0.05, four_wheels(HALF, HALF), sides[:, :, k]),
        *(np.zeros(n, int), np.zeros(n, int), (t // 5).astype(int), z),
        *(np.ones(n, bool), np.ones(n, bool)),
        heading[:, k] + noise * rng.normal(size=n) if has_headings else None,
    )


WHEELS = ("front_left", "rear_left", "front_right", "rear_right")
TRUE = {"radius_left": 0.98, "radius_right": 1.02, "stiffness": 3.0, "gyration": 0.3}
TRUE |= {"friction": 0.6, "center_of_mass_ahead": 0.05}
DRAWN = tuple(name for name in TRUE if name != "gyration")


def unknowns(*names: str) -> tuple[Unknown, ...]:
    """Return unknowns of a vehicle that is driven by its sides."""
    sides = {"radius_left": WHEELS[:2], "radius_right": WHEELS[2:]}
    return tuple(
        Unknown(name, "radius" if name in sides else name, sides.get(name, ())) for name in names
    )


def model(*names: str, **fixed: float) -> Model:
    """Return the model of the synthetic vehicle."""
    return Model(unknowns(*names), {"gyration": 0.3} | fixed, np.ones(4), WHEELS, HALF)


ROBOTS = {  # constants, factor of the speed
    "usual": (Truth(), 1.0),
    "on ice": (Truth(1.0, 1.0, 0.15, 2.0, 0.5, -0.08), 1.0),
    "fast": (Truth(0.95, 1.05, 0.8, 1.5, 0.15, 0.1), 2.0),
}


def draws_of_fits(truth: Truth, speed: float, count: int) -> tuple[Array, Array, Array]:
    """Return errors, deviations and whether intervals hold of fits to logs with errors of 1 cm.

    Each drive has two draws with errors of opposite signs, whose mean is the bias.
    """
    made = drives(count // 2, truth, speed=speed)
    own = model(*DRAWN, gyration=truth.gyration)
    named = truth._asdict() | {"center_of_mass_ahead": truth.ahead}
    true = Scale.of(own.unknowns).sought(np.array([named[name] for name in DRAWN]))
    rows = []
    for k, sign in product(range(count // 2), (1, -1)):
        logs = [log_of(made, k, noise=sign * 0.01)]
        windows = windows_of(logs, duration=2.0)
        found = fit_drives(own, Predictor(own, logs, windows), np.arange(windows.log.size))
        low, high = found.estimate.intervals.T
        deviation = np.sqrt(np.diag(found.estimate.covariance))
        rows.append([found.estimate.values - true, deviation, (low < true) & (true < high)])
    errors, deviations, inside = np.array(rows).swapaxes(0, 1)
    return errors, deviations, inside
