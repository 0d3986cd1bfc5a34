"""Vehicles that come with the package."""

from __future__ import annotations

from math import inf

from slipfree.errors import ModelError
from slipfree.vehicle.chain import Coordinate, Joint, Vehicle
from slipfree.vehicle.wheel import Wheel


def three_wheeler(
    *,
    half_track: float = 1.0,
    wheelbase: float = 1.5,
    r1: float = 0.05,
    r2: float = 0.25,
    tilt_stop: float = inf,
) -> Vehicle:
    """Return the three-wheeler with passive lateral tilt of Chakraborty and Ghosal [1]_.

    Two driven rear wheels that tilt freely about their forward axes, and one free front wheel
    that is steered. The platform's centre lies on the centre line, a third of the wheelbase
    ahead of the rear axle, at the height of the wheel centres. The defaults are the paper's.

    Parameters
    ----------
    half_track : float
        Half the length of the rear axle, ``l_a``. [m]
    wheelbase : float
        Distance from the middle of the axle to the centre of the front wheel, ``l_s``. [m]
    r1, r2 : float
        Radius of the wheels' tube and of the circle of tube centres. [m]
    tilt_stop : float
        Largest lateral tilt either way. [rad]

    Raises
    ------
    ModelError
        If a length is not positive.

    References
    ----------
    .. [1] N. Chakraborty and A. Ghosal, "Kinematics of wheeled mobile robots on uneven terrain",
           sections 3 and 4.
    """
    for key, length in (("half_track", half_track), ("wheelbase", wheelbase)):
        if not 0 < length < inf:
            raise ModelError(f"three_wheeler: {key} must be a positive length, found {length} m")
    rear, front = -wheelbase / 3, 2 * wheelbase / 3
    origin = (0.0, 0.0, 0.0)
    stops = (-tilt_stop, tilt_stop)
    return Vehicle(
        "three_wheeler",
        coordinates=(
            Coordinate("tilt_right", "passive", "lateral tilt of the right rear wheel", *stops),
            Coordinate("tilt_left", "passive", "lateral tilt of the left rear wheel", *stops),
            Coordinate("steer", "commanded", "steering angle of the front wheel, left positive"),
        ),
        joints=(
            Joint("right_hub", "platform", "y", (half_track, rear, 0.0), "tilt_right"),
            Joint("left_hub", "platform", "y", (-half_track, rear, 0.0), "tilt_left"),
            Joint("fork", "platform", "z", (0.0, front, 0.0), "steer"),
        ),
        wheels=(
            Wheel("right", "right_hub", origin, r1, r2, driven=True),
            Wheel("left", "left_hub", origin, r1, r2, driven=True),
            Wheel("front", "fork", origin, r1, r2, driven=False),
        ),
    )
