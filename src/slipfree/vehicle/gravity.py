"""Gravity at the surface of planets, moons and asteroids."""

from __future__ import annotations

import math
from dataclasses import replace
from difflib import get_close_matches
from typing import Any

from slipfree.core.errors import ModelError
from slipfree.vehicle.tree import EARTH_GRAVITY, Vehicle

# G M / R^2 to three digits, except for the earth: gravitational parameters and equatorial radii of
# planets, mean radii of other bodies, by NASA/JPL Solar System Dynamics (planetary physical
# parameters; planetary satellite physical parameters; small-body database), as of 2024.
BODIES = {  # [m/s^2]
    "earth": EARTH_GRAVITY,
    "moon": 1.62,
    "mars": 3.71,
    "mercury": 3.70,
    "venus": 8.87,
    "ceres": 0.284,
    "vesta": 0.253,
    "io": 1.80,
    "europa": 1.31,
    "ganymede": 1.43,
    "callisto": 1.24,
    "titan": 1.35,
    "enceladus": 0.113,
    "triton": 0.781,
    "pluto": 0.616,
}


def gravity_of(value: Any) -> float:
    """Return the gravity of a number or of the name of a body [m/s^2].

    Parameters
    ----------
    value : float or str
        Gravitational acceleration [m/s^2], or a name of `BODIES`, such as ``"moon"``.

    Raises
    ------
    ModelError
        If the number is not positive and finite, or the body is unknown.
    """
    if isinstance(value, str):
        if value.lower() in BODIES:
            return BODIES[value.lower()]
        nearest = get_close_matches(value.lower(), BODIES, n=1)
        hint = f"did you mean {nearest[0]!r}? else " if nearest else ""
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
    name = next((name for name, value in BODIES.items() if value == gravity), None)
    return f"{gravity:g} m/s^2" + (f" ({name})" if name else "")


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
