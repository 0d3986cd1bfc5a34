"""Rovers of the catalogue, with rocker-bogie suspensions.

The platform's axes are x right, y forward, z up. Masses are rounded values; with ``mass = 0`` and
``wheel_mass = 0`` only kinematics is available.
"""

from __future__ import annotations

from typing import Literal

from slipfree.catalog.layouts import described
from slipfree.core.arguments import checked
from slipfree.core.schema import Factor, Mass, Radius
from slipfree.geometry.frame import Vector
from slipfree.vehicle.tree import Vehicle
from slipfree.vehicle.wheel import ORIGIN


@checked
def rocky7(
    *,
    steered: Literal["front", "corners"] = "front",
    r1: Radius = 0.02,
    mass: Mass = 10.0,
    center_of_mass: Vector = (0.0, 0.12, 0.0),
    wheel_mass: Mass = 0.5,
    grip: Factor = 1.0,
) -> Vehicle:
    """Return the Rocky 7 rover of JPL [1]_, with the dimensions used by [2]_.

    It has six driven wheels of 65 mm radius; the front pair is steered. The masses are rounded
    from the 15 kg of the whole rover. The platform's centre of mass lies on the rockers' axis. Its
    inertia is that of a homogeneous box of 0.26 x 0.40 x 0.16 m, as assumed by [3]_.

    Parameters
    ----------
    steered : {"front", "corners"}
        Steered wheels: the front pair, as built, or the front and rear pairs.
    r1 : float
        Radius of the wheels' tubes; zero for thin discs. [m]
    mass, center_of_mass : float, tuple of 3 floats
        Mass of the platform, and its centre of mass in the platform's frame. [kg, m]
    wheel_mass, grip : float
        Mass of each wheel [kg], and factor that multiplies the ground's coefficient of friction at
        each wheel [1].

    Raises
    ------
    ModelError
        If ``steered`` is unknown or a number is out of range.

    References
    ----------
    .. [1] R. Volpe et al., "Rocky 7: a next generation Mars rover prototype", Advanced Robotics
           11(4), 1997.
    .. [2] M. Tarokh and G. McDermott, "Kinematics modeling and analyses of articulated rovers",
           IEEE Transactions on Robotics 21(4), 2005; as in the vehicle file of wmrde
           (N. Seegmiller).
    .. [3] N. Seegmiller, github.com/nealseegmiller/wmrde, ``MATLAB/demo/model/rocky.m`` (Lb, Wb,
           Hb).
    """
    return described("rocky7", locals())


@checked
def open_source_rover(
    *,
    r1: Radius = 0.02,
    mass: Mass = 7.0,
    center_of_mass: Vector = ORIGIN,
    wheel_mass: Mass = 0.8,
    grip: Factor = 1.0,
) -> Vehicle:
    """Return the JPL Open Source Rover [1]_, with the front wheels on the bogies.

    It has six driven wheels of 75 mm radius; the four at the corners are steered. Horizontal
    positions of the wheels are those of its configuration file, pivots those of its simulation
    model, both rounded to 5 mm where they differ. The platform's centre is above the middle axle,
    at the height of the rockers' axis. Its inertia is estimated, since that of the simulation model
    belongs to a box of 1 x 0.55 x 0.2 m, which is larger than the rover.

    Parameters
    ----------
    r1 : float
        Radius of the wheels' tubes. [m]
    mass, center_of_mass : float, tuple of 3 floats
        Mass of the platform, and its centre of mass in the platform's frame. [kg, m]
    wheel_mass, grip : float
        Mass of each wheel [kg], and factor that multiplies the ground's coefficient of friction at
        each wheel [1].

    Raises
    ------
    ModelError
        If a number is out of range.

    References
    ----------
    .. [1] NASA JPL, github.com/nasa-jpl/osr-rover-code, ``physical_properties.yaml`` (d1 to d4,
           wheel_radius) and ``osr.urdf.xacro`` (heights and pivots). Apache-2.0.
    """
    return described("open_source_rover", locals())
