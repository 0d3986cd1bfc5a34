"""Vehicles of the catalogue beside the three-wheeler: carts, cars and rovers.

The platform's axes are x right, y forward, z up. Masses are round figures; ``mass = 0`` and
``wheel_mass = 0`` leave the kinematics alone.
"""

from __future__ import annotations

from math import cos, inf, radians, sin
from typing import Literal, NamedTuple

from slipfree.errors import ModelError
from slipfree.geometry.frame import Axis, Vector
from slipfree.vehicle.chain import Body, Coordinate, Joint, Vehicle
from slipfree.vehicle.wheel import ORIGIN, Wheel

SIDES = {"right": 1.0, "left": -1.0}


def differential_drive(
    *,
    half_track: float = 0.25,
    caster_ahead: float = 0.35,
    trail: float = 0.08,
    r1: float = 0.03,
    r2: float = 0.12,
    caster_scale: float = 2 / 3,
    mass: float = 20.0,
    center_of_mass: Vector = (0.0, 0.1, 0.0),
    wheel_mass: float = 1.0,
    grip: float = 1.0,
) -> Vehicle:
    """Return a cart with two driven wheels and a free caster ahead of them.

    The platform's centre is the middle of the driven axle; it is level on level ground.

    Parameters
    ----------
    half_track, caster_ahead, trail : float
        From the centre to a driven wheel, from the axle to the caster's pivot, and from the pivot
        back to the caster's contact. [m]
    r1, r2 : float
        Of the driven wheels. [m]
    caster_scale : float
        Size of the caster's wheel over theirs. [1]
    mass, center_of_mass, wheel_mass, grip
        As in `three_wheeler`.

    Raises
    ------
    ModelError
        If a length that must be positive is not.
    """
    _positive("differential_drive", half_track=half_track, caster_ahead=caster_ahead)
    drop = -(r1 + r2) * (1 - caster_scale)
    caster = Wheel("caster", "fork", (0.0, -trail, drop), r1 * caster_scale, r2 * caster_scale,
                   driven=False, mass=wheel_mass, grip=grip)  # fmt: skip
    return Vehicle(
        "differential_drive",
        (Coordinate("caster_angle", "passive", "angle of the caster, left positive"),),
        (Joint("fork", "platform", "z", (0.0, caster_ahead, 0.0), "caster_angle"),),
        (*_pair("", "platform", half_track, 0.0, r1, r2, mass=wheel_mass, grip=grip), caster),
        Body(mass, center_of_mass),
    )


def ackermann(
    *,
    half_track: float = 0.3,
    wheelbase: float = 0.7,
    r1: float = 0.03,
    r2: float = 0.12,
    steer_stop: float = 0.7,
    mass: float = 40.0,
    center_of_mass: Vector = (0.0, 0.35, 0.0),
    wheel_mass: float = 2.0,
    grip: float = 1.0,
) -> Vehicle:
    """Return a car whose front axle rocks and whose rear wheels are driven.

    One steering angle, that of a wheel in the middle of the front axle, turns both front wheels
    such that their axles meet on the rear one. The platform's centre is the middle of the rear
    axle.

    Parameters
    ----------
    half_track, wheelbase : float
        From the middle to a wheel, and between the axles. [m]
    r1, r2 : float
        Of the wheels. [m]
    steer_stop : float
        Largest steering angle, either way. [rad]
    mass, center_of_mass, wheel_mass, grip
        As in `three_wheeler`.

    Raises
    ------
    ModelError
        If a length that must be positive is not.
    """
    _positive("ackermann", half_track=half_track, wheelbase=wheelbase)
    turned = "atan2({0}*tan(steer), {0} {2} {1}*tan(steer))"
    knuckles = tuple(
        Joint(f"{side}_knuckle", "axle", "z", (way * half_track, 0.0, 0.0),
              turned.format(repr(wheelbase), repr(half_track), "+" if way > 0 else "-"))
        for side, way in SIDES.items()
    )  # fmt: skip
    return Vehicle(
        "ackermann",
        (
            Coordinate("rock", "suspension", "rocking of the front axle, right side down positive"),
            Coordinate("steer", "commanded", "steering angle in the middle of the front axle, "
                       "left positive", -steer_stop, steer_stop),
        ),
        (Joint("axle", "platform", "y", (0.0, wheelbase, 0.0), "rock"), *knuckles),
        (
            *_pair("rear_", "platform", half_track, 0.0, r1, r2, mass=wheel_mass, grip=grip),
            *(Wheel(f"front_{side}", f"{side}_knuckle", ORIGIN, r1, r2, driven=False,
                    mass=wheel_mass, grip=grip) for side in SIDES),
        ),
        Body(mass, center_of_mass),
    )  # fmt: skip


def skid_steer(
    *,
    half_track: float = 0.3,
    wheelbase: float = 0.5,
    r1: float = 0.03,
    r2: float = 0.12,
    mass: float = 30.0,
    center_of_mass: Vector = ORIGIN,
    wheel_mass: float = 2.0,
    grip: float = 1.0,
) -> Vehicle:
    """Return a cart with four driven wheels, those of the right side on a rocker.

    Parameters
    ----------
    half_track, wheelbase : float
        From the middle to a wheel, and between front and rear wheels. [m]
    r1, r2 : float
        Of the wheels. [m]
    mass, center_of_mass, wheel_mass, grip
        As in `three_wheeler`.

    Raises
    ------
    ModelError
        If a length that must be positive is not.
    """
    _positive("skid_steer", half_track=half_track, wheelbase=wheelbase)
    wheels = tuple(
        Wheel(f"{end}_{side}", *(("rocker", (0.0, y, 0.0)) if side == "right" else
                                 ("platform", (-half_track, y, 0.0))), r1, r2,
              driven=True, mass=wheel_mass, grip=grip)
        for side in SIDES for end, y in (("front", wheelbase / 2), ("rear", -wheelbase / 2))
    )  # fmt: skip
    return Vehicle(
        "skid_steer",
        (Coordinate("rock", "suspension", "rocking of the right side, front up positive"),),
        (Joint("rocker", "platform", "x", (half_track, 0.0, 0.0), "rock"),),
        wheels,
        Body(mass, center_of_mass),
    )


def articulated(
    *,
    half_track: float = 0.35,
    front: float = 0.4,
    rear: float = 0.4,
    r1: float = 0.04,
    r2: float = 0.16,
    bend_stop: float = 0.7,
    mass: float = 60.0,
    center_of_mass: Vector = ORIGIN,
    wheel_mass: float = 4.0,
    grip: float = 1.0,
) -> Vehicle:
    """Return a loader bent by a driven joint between its halves, which also twist freely.

    All four wheels are driven. The platform is the front half, its centre the middle of the front
    axle.

    Parameters
    ----------
    half_track, front, rear : float
        From the middle to a wheel, and from the joint to the front and to the rear axle. [m]
    r1, r2 : float
        Of the wheels. [m]
    bend_stop : float
        Largest angle between the halves, either way. [rad]
    mass, center_of_mass : float, tuple of 3 floats
        Of each half; place in the half's frame, from the middle of its axle. [kg, m]
    wheel_mass, grip
        As in `three_wheeler`.

    Raises
    ------
    ModelError
        If a length that must be positive is not.
    """
    _positive("articulated", half_track=half_track, front=front, rear=rear)
    x, y, z = center_of_mass
    return Vehicle(
        "articulated",
        (
            Coordinate("bend", "commanded", "angle of the rear half, left positive",
                       -bend_stop, bend_stop),
            Coordinate("twist", "suspension", "twist of the rear half, right side down positive"),
        ),
        (
            Joint("hinge", "platform", "z", (0.0, -front, 0.0), "bend"),
            Joint("rear_half", "hinge", "y", ORIGIN, "twist", body=Body(mass, (x, y - rear, z))),
        ),
        (
            *_pair("front_", "platform", half_track, 0.0, r1, r2, mass=wheel_mass, grip=grip),
            *_pair("rear_", "rear_half", half_track, -rear, r1, r2, mass=wheel_mass, grip=grip),
        ),
        Body(mass, center_of_mass),
    )  # fmt: skip


class Station(NamedTuple):
    """Where a pair of wheels of a rocker-bogie is, at rest on level ground. [m].

    Attributes
    ----------
    half_track, ahead, above : float
        Of the wheels' centres, from the platform's centre.
    on_bogie : bool
        Whether they are on the bogies, and not on the rockers.
    steered : bool
        Whether they steer, about a vertical axis through their centres.
    """

    half_track: float
    ahead: float
    above: float
    on_bogie: bool
    steered: bool


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
    """Return a rover on two rockers that a differential couples, each with a bogie.

    Parameters
    ----------
    name : str
        What it is called.
    stations : dict of str to Station
        Front, middle and rear wheels.
    differential, bogie : tuple of 2 floats
        Axes of the rockers on the platform, and of the bogies on the rockers: ahead and above, at
        rest on level ground. [m]
    radius, r1 : float
        Of the wheels, and of their tubes. [m]
    mass, center_of_mass, wheel_mass, grip
        As in `three_wheeler`.

    Raises
    ------
    ModelError
        If a radius or a place is not one.
    """
    coordinates = [Coordinate("rocker", "suspension", "right rocker, front up positive; the left "
                              "one turns the other way")]  # fmt: skip
    joints, wheels = [], []
    side_of = stations["middle"].half_track
    for side, way in SIDES.items():
        coordinates.append(Coordinate(f"bogie_{side}", "suspension", f"{side} bogie on its rocker, "
                                      "front up positive"))  # fmt: skip
        joints.append(Joint(f"rocker_{side}", "platform", "x", (way * side_of, *differential),
                            "rocker" if way > 0 else "-rocker"))  # fmt: skip
        arm = (0.0, bogie[0] - differential[0], bogie[1] - differential[1])
        joints.append(Joint(f"bogie_{side}", f"rocker_{side}", "x", arm, f"bogie_{side}"))
    for end, place in stations.items():
        for side, way in SIDES.items():
            carrier, (y, z) = ("bogie", bogie) if place.on_bogie else ("rocker", differential)
            part = f"{carrier}_{side}"
            at = (way * (place.half_track - side_of), place.ahead - y, place.above - z)
            if place.steered:
                steer = f"steer_{end}_{side}"
                words = f"steering angle of the {side} {end} wheel, left positive"
                coordinates.append(Coordinate(steer, "commanded", words))
                joints.append(Joint(steer, part, "z", at, steer))
                part, at = steer, ORIGIN
            wheels.append(Wheel(f"{end}_{side}", part, at, r1, radius - r1, driven=True,
                                mass=wheel_mass, grip=grip))  # fmt: skip
    body = Body(mass, center_of_mass)
    return Vehicle(name, tuple(coordinates), tuple(joints), tuple(wheels), body)


def rocky7(
    *,
    steered: Literal["front", "corners"] = "front",
    r1: float = 0.02,
    mass: float = 10.0,
    center_of_mass: Vector = (0.0, 0.12, 0.0),
    wheel_mass: float = 0.5,
    grip: float = 1.0,
) -> Vehicle:
    """Return the Rocky 7 rover of JPL [1]_, with the dimensions used by [2]_.

    Six driven wheels of 65 mm radius; its front pair steers. The masses are rounded from the 15 kg
    of the whole rover, the platform's centre of mass lies on the rockers' axis.

    Parameters
    ----------
    steered : {"front", "corners"}
        As built, or with the rear pair steered too.
    r1 : float
        Radius of the wheels' tubes; zero for discs. [m]
    mass, center_of_mass, wheel_mass, grip
        As in `three_wheeler`.

    Raises
    ------
    ModelError
        If ``steered`` is not known or a number is not allowed.

    References
    ----------
    .. [1] R. Volpe et al., "Rocky 7: a next generation Mars rover prototype", Advanced Robotics
           11(4), 1997.
    .. [2] M. Tarokh and G. McDermott, "Kinematics modeling and analyses of articulated rovers",
           IEEE Transactions on Robotics 21(4), 2005; as in the vehicle file of wmrde
           (N. Seegmiller).
    """
    if steered not in ("front", "corners"):
        raise ModelError(f"rocky7: steered must be 'front' or 'corners', found {steered!r}")
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
    return rocker_bogie("rocky7", stations, differential=(ahead, above), bogie=bogie, radius=0.065,
                        r1=r1, mass=mass, center_of_mass=center_of_mass, wheel_mass=wheel_mass,
                        grip=grip)  # fmt: skip


def open_source_rover(
    *,
    r1: float = 0.02,
    mass: float = 7.0,
    center_of_mass: Vector = ORIGIN,
    wheel_mass: float = 0.8,
    grip: float = 1.0,
) -> Vehicle:
    """Return the JPL Open Source Rover [1]_, whose bogies carry the front wheels.

    Six driven wheels of 75 mm radius, the four at the corners steered. Wheels in plan are those of
    its configuration file, pivots those of its simulation model, both rounded to 5 mm where they
    differ. The platform's centre is above the middle axle, at the height of the rockers' axis.

    Parameters
    ----------
    r1 : float
        Radius of the wheels' tubes. [m]
    mass, center_of_mass, wheel_mass, grip
        As in `three_wheeler`.

    Raises
    ------
    ModelError
        If a number is not allowed.

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
    return rocker_bogie("open_source_rover", stations, differential=(-0.02, 0.0),
                        bogie=(0.095, axles + 0.095), radius=0.075, r1=r1, mass=mass,
                        center_of_mass=center_of_mass, wheel_mass=wheel_mass,
                        grip=grip)  # fmt: skip


def seven_wheels(
    *,
    joint: float = 0.0,
    half_track: float = 0.235,
    stiffness: float = 2e3,
    preload: float = 20.0,
    grip: float = 1.0,
) -> Vehicle:
    """Return the step climber of Chugo et al. [1]_ on seven driven wheels with free rollers.

    The platform is the rear body, its centre the middle wheel's. Pairs of wheels roll forward at
    the rear and at the front, one in the middle; between each pair one rolls sideways. The front
    body pitches and rolls on two passive joints. So there are seven contacts, but five freedoms for
    the ground to decide: rigid, the vehicle stands only where its axles' wheels happen to find the
    ground at one height, as where that varies forward alone. Here the wheels that roll sideways are
    pressed down by springs, and it stands anywhere.

    Radii, spacings and masses are the paper's, the masses with their wheels. What its text leaves
    open is assumed: the track from its width, wheels between pairs on their axle, centres of mass
    in the middle of bodies whose ends are flush with the tyres, 50 mm above the axles.

    Parameters
    ----------
    joint : float
        How far the joints are ahead of the middle wheel. [m]
    half_track : float
        From the middle to a wheel of a pair. [m]
    stiffness, preload : float
        Of the springs, and their force on level ground. [N/m, N]
    grip
        As in `three_wheeler`.

    Raises
    ------
    ModelError
        If the springs are not, or a number is not allowed.

    References
    ----------
    .. [1] D. Chugo et al., "Body configuration and control reference of a wheeled vehicle with
           passive linkages", 2009: table I and figures 1 and 8.
    """
    _positive("seven_wheels", half_track=half_track)
    if not 0 < stiffness < inf:
        raise ModelError(
            "seven_wheels: seven rigid contacts are too many for five freedoms; expected springs "
            f"with a positive stiffness, found {stiffness} N/m"
        )
    radius, behind, ahead, lengths, above = 0.066, 0.215, 0.255, (0.400, 0.195), 0.05
    pressed = [Coordinate(f"press_{end}", "suspension",
                          f"height of the wheel between the {end} pair on its springs",
                          stiffness=stiffness, rest=-preload / stiffness)
               for end in ("rear", "front")]  # fmt: skip
    middles = (-behind - radius + lengths[0] / 2, ahead - joint + radius - lengths[1] / 2)

    def wheel(name: str, part: str, at: Vector, axle: Axis = "x") -> Wheel:
        return Wheel(name, part, at, 0.0, radius, driven=True, grip=grip, axle=axle, rollers=True)

    pairs = [wheel(f"{end}_{side}", part, (way * half_track, y, 0.0))
             for end, part, y in (("rear", "platform", -behind), ("front", "twist", ahead - joint))
             for side, way in SIDES.items()]  # fmt: skip
    return Vehicle(
        "seven_wheels",
        (
            Coordinate("pitch_joint", "suspension", "pitch of the front body, nose up positive"),
            Coordinate("roll_joint", "suspension", "roll of the front body, right side down "
                       "positive"),
            *pressed,
        ),
        (
            Joint("hinge", "platform", "x", (0.0, joint, 0.0), "pitch_joint"),
            Joint("twist", "hinge", "y", ORIGIN, "roll_joint",
                  body=Body(7.8, (0.0, middles[1], above))),
            Joint("rear_press", "platform", "z", (0.0, -behind, 0.0), "press_rear", "slide"),
            Joint("front_press", "twist", "z", (0.0, ahead - joint, 0.0), "press_front", "slide"),
        ),
        (
            *pairs[:2], wheel("rear_across", "rear_press", ORIGIN, (0.0, -1.0, 0.0)),
            wheel("middle", "platform", ORIGIN),
            *pairs[2:], wheel("front_across", "front_press", ORIGIN, "y"),
        ),
        Body(13.8, (0.0, middles[0], above)),
    )  # fmt: skip


def _pair(
    prefix: str, part: str, half_track: float, ahead: float, r1: float, r2: float, *,
    mass: float, grip: float,
) -> tuple[Wheel, ...]:  # fmt: skip
    """Return driven wheels right and left of a part."""
    return tuple(
        Wheel(f"{prefix}{side}", part, (way * half_track, ahead, 0.0), r1, r2, driven=True,
              mass=mass, grip=grip)
        for side, way in SIDES.items()
    )  # fmt: skip


def _positive(name: str, **lengths: float) -> None:
    for key, length in lengths.items():
        if not 0 < length < inf:
            raise ModelError(f"{name}: {key} must be a positive length, found {length} m")
