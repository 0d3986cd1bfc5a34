"""Rovers of the catalogue, with rocker-bogie suspensions.

The platform's axes are x right, y forward, z up. Masses are rounded values; with ``mass = 0`` and
``wheel_mass = 0`` only kinematics is available.
"""

from __future__ import annotations

from dataclasses import replace
from math import cos, radians, sin
from typing import Literal, NamedTuple

from slipfree.catalog.carts import SIDES, Mounted, assembled
from slipfree.core.arguments import checked
from slipfree.core.schema import Factor, Mass, Radius
from slipfree.geometry.frame import Vector
from slipfree.vehicle.sections import section_of_radii
from slipfree.vehicle.tree import Body, Coordinate, Joint, Vehicle
from slipfree.vehicle.wheel import ORIGIN


class Station(NamedTuple):
    """Position of a pair of wheels of a rocker-bogie, at rest on level ground [m]."""

    half_track: float  # of the wheels' centres from the platform's centre
    ahead: float
    above: float
    on_bogie: bool  # whether the bogies carry the wheels; otherwise the rockers do
    steered: bool  # about a vertical axis through the centre


def rocker_bogie(
    name: str,
    stations: dict[str, Station],
    *,
    differential: tuple[float, float],
    bogie: tuple[float, float],
    radius: float,
    r1: float,
    mass: float,
    center_of_mass: Vector,
    wheel_mass: float,
    grip: float,
) -> Vehicle:
    """Return a rocker-bogie rover, with two rockers coupled by a differential.

    ``stations`` are the front, middle and rear wheels; ``differential`` and ``bogie`` the positions
    of the axes of the rockers and of the bogies: distances ahead of and above the platform's
    centre, at rest on level ground [m]. ``radius`` is the rolling radius of the wheels. Other
    parameters and errors are those of `rocky7`.
    """
    coordinates = [
        Coordinate(
            "rocker",
            "suspension",
            "angle of the right rocker, front up positive; the left rocker has the opposite angle",
        )
    ]
    joints, wheels = [], list[Mounted]()
    section = section_of_radii(r1, radius - r1)
    side_of = stations["middle"].half_track
    for side, sign in SIDES.items():
        coordinates.append(
            Coordinate(
                f"bogie_{side}",
                "suspension",
                f"angle of the {side} bogie on its rocker, front up positive",
            )
        )
        joints.append(
            Joint(
                f"rocker_{side}",
                "platform",
                "x",
                (sign * side_of, *differential),
                "rocker" if sign > 0 else "-rocker",
            )
        )
        arm = (0.0, bogie[0] - differential[0], bogie[1] - differential[1])
        joints.append(Joint(f"bogie_{side}", f"rocker_{side}", "x", arm, f"bogie_{side}"))
    for end, place in stations.items():
        for side, sign in SIDES.items():
            carrier, (y, z) = ("bogie", bogie) if place.on_bogie else ("rocker", differential)
            part = f"{carrier}_{side}"
            at = (sign * (place.half_track - side_of), place.ahead - y, place.above - z)
            if place.steered:
                steer = f"steer_{end}_{side}"
                words = f"steering angle of the {side} {end} wheel, left positive"
                coordinates.append(Coordinate(steer, "commanded", words))
                joints.append(Joint(steer, part, "z", at, steer))
                part, at = steer, ORIGIN
            wheels.append((f"{end}_{side}", part, at, section, True))
    return assembled(
        name,
        tuple(coordinates),
        tuple(joints),
        wheels,
        Body(mass, center_of_mass),
        wheel_mass=wheel_mass,
        grip=grip,
    )


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
    ahead, above, down, half_track = 0.12075, 0.105, 0.125, 0.2
    arm, angle, half, drop = 0.16, radians(49), 0.069, 0.02
    bogie = (ahead - arm * sin(angle), above - arm * cos(angle))
    axles = bogie[1] - drop
    corners = steered == "corners"
    stations = {
        "front": Station(half_track, ahead + 0.288, above - down, on_bogie=False, steered=True),
        "middle": Station(half_track, bogie[0] + half, axles, on_bogie=True, steered=False),
        "rear": Station(half_track, bogie[0] - half, axles, on_bogie=True, steered=corners),
    }
    rover = rocker_bogie(
        "rocky7",
        stations,
        differential=(ahead, above),
        bogie=bogie,
        radius=0.065,
        r1=r1,
        mass=mass,
        center_of_mass=center_of_mass,
        wheel_mass=wheel_mass,
        grip=grip,
    )
    x, y, z = (mass / 12 * side**2 for side in (0.26, 0.40, 0.16))
    inertia = (y + z, x + z, x + y, 0.0, 0.0, 0.0) if mass else None
    return replace(rover, body=replace(rover.body, inertia=inertia))


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
    axles = -0.185
    stations = {
        "front": Station(0.184, 0.267, axles, on_bogie=True, steered=True),
        "middle": Station(0.2556, 0.0, axles, on_bogie=True, steered=False),
        "rear": Station(0.184, -0.267, axles, on_bogie=False, steered=True),
    }
    return rocker_bogie(
        "open_source_rover",
        stations,
        differential=(-0.02, 0.0),
        bogie=(0.095, axles + 0.095),
        radius=0.075,
        r1=r1,
        mass=mass,
        center_of_mass=center_of_mass,
        wheel_mass=wheel_mass,
        grip=grip,
    )
