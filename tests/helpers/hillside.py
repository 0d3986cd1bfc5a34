"""Logs of a skid-steered robot with known constants on a synthetic hillside, by their own steps."""

from functools import cache

import numpy as np

from slipfree.core.records import Array
from slipfree.fit.ground_motion import DriveLog
from slipfree.terrain.base import Grid

TRUE = {"scale": 1.02, "track": 0.7, "drift": 0.02, "slip_slope": 0.2, "turn_slope": 2.0}
DT, FINE = 0.2, 20  # time between samples [s], and steps of the simulation between them
AXIS = np.arange(-40.0, 41.0)


def height(x: Array, y: Array) -> Array:
    """Return the height of a hillside [m]."""
    return 2.5 * np.sin(x / 9) * np.cos(y / 11) + 0.05 * x


HILL = Grid(AXIS, AXIS, height(*np.meshgrid(AXIS, AXIS, indexing="ij")))


def gradient(x: float, y: float, size: float) -> tuple[float, float]:
    """Return the exact gradient of the hillside times a factor."""
    return (
        size * (2.5 / 9 * np.cos(x / 9) * np.cos(y / 11) + 0.05),
        -size * 2.5 / 11 * np.sin(x / 9) * np.sin(y / 11),
    )


@cache
def drive(
    seed: int,
    group: str,
    size: float = 1.0,
    *,
    lag: float = 0.0,
    sensor: tuple[complex, float] = (0j, 0.0),
) -> DriveLog:
    """Return the log of a robot with the true constants, which drives towards the middle.

    Its turns follow the commands with a lag [s]. The sensor is ahead and to the left of the centre
    [m], and measures a heading that is larger by an angle [rad].
    """
    rng, count = np.random.default_rng(seed), 700
    place, heading, path = rng.uniform(-15, 15, 2), rng.uniform(-3, 3), []
    sides, turn, difference, angles = np.empty((count, 2)), 0.0, 0.0, []
    for k in range(count):
        if k % 15 == 0:  # a new command every three seconds
            away = np.angle(-complex(*place) * np.exp(-1j * heading))
            turn = rng.normal(0, 0.06) + (0.08 * np.sign(away) if np.hypot(*place) > 20 else 0)
        sides[k] = 0.5 - turn / 2, 0.5 + turn / 2
        difference = turn if k == 0 else difference
        path.append(place)
        angles.append(heading)
        for _ in range(FINE):
            x, y = gradient(*place, size)
            c, s = np.cos(heading), np.sin(heading)
            up = (x * c + y * s) / np.sqrt(1 + (x * c + y * s) ** 2)
            mean, step = 0.5, DT / FINE
            keep = np.exp(-step / lag) if lag else 0.0
            before, difference = difference, turn + keep * (difference - turn)
            yaw = ((before + difference) / 2 if lag else turn) + 2 * TRUE["drift"] * mean
            yaw *= np.exp(-TRUE["turn_slope"] * up) / TRUE["track"]
            v = TRUE["scale"] * mean - TRUE["slip_slope"] * mean * up
            middle = heading + step * yaw / 2
            ahead = np.array([np.cos(middle), np.sin(middle)])
            place, heading = place + step * v * np.sqrt(1 - up**2) * ahead, heading + step * yaw
    angle = np.array(angles)
    receiver = np.array(path) @ [1, 1j] + sensor[0] * np.exp(1j * angle)
    exact = np.column_stack([receiver.real, receiver.imag])
    velocity = np.gradient(exact, DT, axis=0)
    speed, good = np.hypot(*velocity.T), np.ones(count, bool)
    known = exact, velocity, speed, good, np.ones(count), sides
    seen = angle + sensor[1] if sensor[1] else None
    return DriveLog(f"log {seed}", group, DT, *known, heading=seen)
