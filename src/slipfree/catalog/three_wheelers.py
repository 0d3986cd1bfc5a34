"""Tilting three-wheeler of the catalogue and its variants."""

from __future__ import annotations

from dataclasses import replace
from math import inf
from typing import Annotated, Literal

from annotated_types import Gt, Unit

from slipfree.catalog.layouts import described
from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.schema import Angle, Factor, JointConstant, Length, Mass, Radius
from slipfree.vehicle.tree import Vehicle

Axle = Literal["tilting", "sliding", "prismatic_undriven", "prismatic", "actuated", "fixed"]
ORIGIN = (0.0, 0.0, 0.0)
MAX_TILT = 1.5  # a wheel with a larger tilt lies on its side [rad]


@checked
def three_wheeler(
    *,
    axle: Axle = "tilting",
    half_track: Length = 1.0,
    wheelbase: Length = 1.5,
    r1: Radius = 0.05,
    r2: Radius = 0.25,
    tilt_stop: Angle = MAX_TILT,
    slide_stop: Annotated[float, Gt(0), Unit("m")] = inf,
    stiffness: JointConstant = 0.0,
    damping: JointConstant = 0.0,
    bump: JointConstant = 0.0,
    mass: Mass = 30.0,
    center_of_mass: tuple[float, float, float] = ORIGIN,
    wheel_mass: Mass = 2.0,
    grip: Factor = 1.0,
) -> Vehicle:
    """Return the three-wheeler of Chakraborty and Ghosal [1]_ with one of six rear axles.

    It has two rear wheels and one free, steered front wheel. The platform's centre lies on the
    centre line, a third of the wheelbase ahead of the rear axle, at the height of the wheel
    centres. The defaults describe the vehicle of the paper, the other axles its alternatives.

    Parameters
    ----------
    axle : str
        ``"tilting"``: both rear wheels are driven and tilt freely about their forward axes;
        ``"sliding"``: both driven, each half of the axle slides freely;
        ``"prismatic"``: both driven, the right half slides freely;
        ``"prismatic_undriven"``: the same with a free right wheel;
        ``"actuated"``: both driven, the sliding rate of the right half is an input;
        ``"fixed"``: both driven, a rigid axle.
    half_track : float
        Half the length of the rear axle, ``l_a``. [m]
    wheelbase : float
        Distance from the middle of the axle to the centre of the front wheel, ``l_s``. [m]
    r1, r2 : float
        Radius of the wheels' tube, zero for discs, and of the circle of tube centres. [m]
    tilt_stop, slide_stop : float
        Largest lateral tilt, and largest sliding of half an axle, to either side. [rad, m]
    stiffness, damping, bump : float
        Stiffness of a spring [N m/rad or N/m], constant of a damper [N m s/rad or N s/m], and
        stiffness of the stops [N m/rad or N/m] (zero for rigid stops) in every free joint of the
        axle. A tilting wheel is an inverted pendulum: only a spring with a stiffness above the
        wheel load times ``r2`` keeps it upright. Where the rates cause a tilt, a stiffer spring
        needs more friction.
    mass, center_of_mass : float, tuple of 3 floats
        Mass of the platform, and its centre of mass in the platform's frame; the paper gives
        neither. [kg, m]
    wheel_mass, grip : float
        Mass of each wheel [kg], and factor that multiplies the ground's coefficient of friction at
        each wheel [1].

    Raises
    ------
    ModelError
        If a number is out of range, if the axle is unknown, or if the axle has no free joint for a
        given spring, damper or elastic stop.

    References
    ----------
    .. [1] N. Chakraborty and A. Ghosal, "Kinematics of wheeled mobile robots on uneven terrain",
           sections 3 and 4.
    """
    vehicle = described("three_wheeler", locals())
    if any((stiffness, damping, bump)) and not vehicle.of("passive"):
        raise ModelError(
            "three_wheeler: expected an axle with a free joint for a spring, damper or elastic "
            f"stop, found the {axle} axle; remove stiffness, damping and bump, or choose another "
            "axle"
        )
    return (
        vehicle if axle == "tilting" else replace(vehicle, name=f"{vehicle.name} with {axle} axle")
    )
