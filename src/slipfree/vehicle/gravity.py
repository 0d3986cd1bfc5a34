"""Gravity at the surface of planets, moons and asteroids."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, NamedTuple

from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError, read_table, similar
from slipfree.vehicle.tree import Vehicle


class CelestialBody(NamedTuple):
    """A planet, moon or asteroid: gravity at its surface [m/s^2], and radius [m]."""

    gravity: float
    radius: float


BODIES = {n: CelestialBody(**row) for n, row in read_table(__file__, "bodies.toml").items()}
SAME_RADIUS = 0.005  # relative difference of the radii of one body in various reference systems


def gravity_of(value: Any) -> float:
    """Return the gravity of a number or of the name of a body [m/s^2].

    ModelError is raised if the number is not positive and finite, or the body is not one of
    `BODIES`.
    """
    if isinstance(value, str):
        if value.lower() in BODIES:
            return BODIES[value.lower()].gravity
        hint = similar(value.lower(), BODIES)
        raise ModelError(
            f"expected one of the bodies {', '.join(BODIES)}, or a number in m/s^2, found "
            f"{value!r}; {hint}give the number"
        )
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number or not 0 < value < math.inf:
        raise ModelError(
            "expected a positive, finite number in m/s^2, or the name of a body such as 'moon', "
            f"found {value!r}; change it"
        )
    return float(value)


def gravity_words(gravity: float) -> str:
    """Return a gravity in words, with the name of its body, as in ``1.62 m/s^2 (moon)``."""
    name = next((name for name, body in BODIES.items() if body.gravity == gravity), None)
    return f"{gravity:g} m/s^2" + (f" ({name})" if name else "")


def foreign_map_words(gravity: float, radius: float) -> str:
    """Return a hint on a map of another body than the earth with the earth's gravity; else "".

    ``radius`` is the semi-major axis of the map's reference system, NaN if unknown [m].
    """
    earth = BODIES["earth"]
    if gravity != earth.gravity or not abs(radius / earth.radius - 1) > SAME_RADIUS:
        return ""
    alike = (n for n, body in BODIES.items() if abs(body.radius / radius - 1) < SAME_RADIUS)
    name = next(alike, None)
    key = f'set gravity = "{name}"' if name else "set 'gravity' [m/s^2]"
    return f"; but the map is of a body with a radius of {radius / 1e3:.6g} km: {key}"


@checked
def in_gravity(vehicle: Vehicle, gravity: float | str) -> Vehicle:
    """Return the vehicle in another gravity.

    Masses, springs and dampers remain. Given static depths of wheels change with the weight, so
    that the stiffness of their contacts remains.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    gravity : float or str
        Gravitational acceleration [m/s^2], or the name of a body, such as ``"moon"``
        (`slipfree.vehicle.gravity.BODIES`).

    Raises
    ------
    ModelError
        If the number is not positive and finite, or the body is unknown.

    Examples
    --------
    >>> from slipfree import catalog, in_gravity
    >>> rover = in_gravity(catalog.rocky7(), "moon")
    >>> print(f"{rover.mass:g} kg, {rover.weight:.1f} N")
    13 kg, 21.1 N
    """
    value = gravity_of(gravity)
    ratio = value / vehicle.gravity
    wheels = tuple(
        replace(wheel, static_depth=wheel.static_depth and wheel.static_depth * ratio)
        for wheel in vehicle.wheels
    )
    return replace(vehicle, gravity=value, wheels=wheels)
