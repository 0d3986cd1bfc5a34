"""Step climbers: two bodies on a joint with three axles, in the plane and in the catalogue.

The rear body, the platform, carries the rear and the middle axle, the front body the front axle.
x is forward, z up; tilts are nose-up from the horizontal. Positions on a body are distances ahead
of the joint, along the body, and above the joint.
"""

from __future__ import annotations

from slipfree.catalog.carts import SIDES
from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.schema import Factor, Force, Length, Mass, Position, Stiffness
from slipfree.geometry.frame import Axis, Vector
from slipfree.vehicle.drives import Torque
from slipfree.vehicle.sections import Disc, Omni
from slipfree.vehicle.tree import EARTH_GRAVITY, Body, Coordinate, Joint, Vehicle, planar
from slipfree.vehicle.wheel import ORIGIN, Wheel

AXLES = ("rear", "middle", "front")


def check_climber(vehicle: Vehicle) -> None:
    """Check that a vehicle is an articulated step climber.

    Raises
    ------
    ModelError
        If the vehicle is not locked to a plane, or is not of two bodies on a joint with three axles
        of equal driven discs, in the order rear, middle, front.
    """
    expected = _misfit(vehicle)
    if expected:
        raise ModelError(
            f"{vehicle.name!r}: expected a step climber, with {expected}, found another vehicle; "
            "use 'step_climber' of the catalogue, or a vehicle file like it"
        )


def _misfit(vehicle: Vehicle) -> str:
    """Return the property of a step climber that a vehicle lacks; empty if it has all."""
    wheels, joints, coordinates = vehicle.wheels, vehicle.joints, vehicle.coordinates
    if not vehicle.planar:
        return "a platform that is locked to a plane"
    if [w.parent for w in wheels] != ["platform", "platform", *(joint.name for joint in joints)]:
        return "two wheels on the platform and a third on the only joint"
    joint = joints[0]
    turns = (joint.axis, joint.at, joint.turned, joint.motion) == ("x", ORIGIN, ORIGIN, "turn")
    if not turns or [(c.name, c.kind) for c in coordinates] != [(joint.value, "suspension")]:
        return "a joint about x at the platform's origin, whose value is a suspension coordinate"
    if not all(isinstance(w.section, Disc) and w.driven and w.drive.takes_effort for w in wheels):
        return "discs as wheels, driven by torques"
    if len({w.radius for w in wheels}) > 1 or any(w.at[2] for w in wheels):
        return "wheels of equal radius at the height of the joint"
    if not all(w.inertia and not w.mass for w in wheels):
        return "wheels with inertia whose mass is a part of that of the bodies"
    if not all(body.mass and body.inertia for body in (vehicle.body, joint.body)):
        return "bodies with mass and inertia"
    rear, middle, front = (w.at[1] for w in wheels)
    if not rear < middle <= 0 < front:
        return "the axles rear, middle and front in this order, the joint between the last two"
    return ""


FRONT_MASS, REAR_MASS = 7.8, 13.8  # of the bodies, wheels included [kg]


@checked
def seven_wheels(
    *,
    joint: Position = 0.0,
    half_track: Length = 0.235,
    stiffness: Stiffness = 2e3,
    preload: Force = 20.0,
    grip: Factor = 1.0,
    wheel_mass: Mass = 0.0,
) -> Vehicle:
    """Return the step climber of Chugo et al. [1]_, with seven driven omni wheels.

    The platform is the rear body; its origin is the centre of the middle wheel. A pair of wheels at
    the rear, a pair at the front and the single middle wheel roll forward; between the wheels of
    each pair another wheel rolls sideways. The front body pitches and rolls on two passive joints.
    Seven contacts thus constrain five degrees of freedom: a vehicle without springs would touch the
    ground with all wheels only where the wheels of each axle stand at equal height. In this model,
    springs press the sideways wheels down, and the vehicle can stand on any ground.

    Radii, spacings and masses are those of the paper; the masses include the wheels. The paper does
    not give the following, which is assumed: the track, from the overall width; the positions of
    the sideways wheels, on the axles of the pairs; and the centres of mass, 50 mm above the axles
    in the middle of bodies that end at the outer edges of the wheels.

    Parameters
    ----------
    joint : float
        Distance of the joints ahead of the middle wheel. [m]
    half_track : float
        Distance from the middle to a wheel of a pair. [m]
    stiffness, preload : float
        Stiffness of the springs, and their force on level ground. [N/m, N]
    grip : float
        Factor that multiplies the ground's coefficient of friction at each wheel. [1]
    wheel_mass : float
        Mass of each wheel, a part of the masses of the bodies; dynamics needs it. [kg]

    Raises
    ------
    ModelError
        If the stiffness is not positive or a number is out of range.

    References
    ----------
    .. [1] D. Chugo et al., "Body configuration and control reference of a wheeled vehicle with
           passive linkages", 2009: table I and figures 1 and 8.
    """
    if not 0 <= 3 * wheel_mass < FRONT_MASS:
        raise ModelError(
            f"seven_wheels: expected a mass of wheels of at least 0 and below {FRONT_MASS / 3:g} "
            f"kg, found {wheel_mass} kg; change 'wheel_mass'"
        )
    radius, behind, ahead, lengths, above = 0.066, 0.215, 0.255, (0.400, 0.195), 0.05
    pressed = [
        Coordinate(
            f"press_{end}",
            "suspension",
            f"height of the wheel between the {end} pair, on its spring",
            stiffness=stiffness,
            rest=-preload / stiffness,
        )
        for end in ("rear", "front")
    ]
    middles = (-behind - radius + lengths[0] / 2, ahead - joint + radius - lengths[1] / 2)

    def wheel(name: str, part: str, at: Vector, axle: Axis = "x") -> Wheel:
        section, mass = Omni(Disc(radius)), wheel_mass
        return Wheel(name, part, at, section, driven=True, grip=grip, axle=axle, mass=mass)

    pairs = [
        wheel(f"{end}_{side}", part, (sign * half_track, y, 0.0))
        for end, part, y in (("rear", "platform", -behind), ("front", "twist", ahead - joint))
        for side, sign in SIDES.items()
    ]
    return Vehicle(
        "seven_wheels",
        (
            Coordinate("pitch_joint", "suspension", "pitch of the front body, nose up positive"),
            Coordinate(
                "roll_joint", "suspension", "roll of the front body, right side down positive"
            ),
            *pressed,
        ),
        (
            Joint("hinge", "platform", "x", (0.0, joint, 0.0), "pitch_joint"),
            Joint(
                "twist",
                "hinge",
                "y",
                ORIGIN,
                "roll_joint",
                body=Body(FRONT_MASS - 3 * wheel_mass, (0.0, middles[1], above)),
            ),
            Joint("rear_press", "platform", "z", (0.0, -behind, 0.0), "press_rear", "slide"),
            Joint("front_press", "twist", "z", (0.0, ahead - joint, 0.0), "press_front", "slide"),
        ),
        (
            *pairs[:2],
            wheel("rear_across", "rear_press", ORIGIN, (0.0, -1.0, 0.0)),
            wheel("middle", "platform", ORIGIN),
            *pairs[2:],
            wheel("front_across", "front_press", ORIGIN, "y"),
        ),
        Body(REAR_MASS - 4 * wheel_mass, (0.0, middles[0], above)),
    )


@checked
def step_climber(*, joint: Position = 0.0, stiffness: Stiffness = 1.5e5) -> Vehicle:
    """Return the step climber of Chugo et al. (2009), locked to the plane of its motion.

    It is the side view of `seven_wheels`, with one driven disc for the wheels of an axle; the
    inputs in dynamics are the total torques of the axles. The platform is the rear body; its origin
    is the joint. The paper gives no moments of inertia: those of the bodies are assumed to be those
    of boxes 250 mm high; those of the wheels with their rotors are estimates.

    Parameters
    ----------
    joint : float
        Distance of the joint ahead of the middle axle. [m]
    stiffness : float
        Stiffness of the contacts of an axle's wheels with the ground. [N/m]

    Raises
    ------
    ModelError
        If the stiffness is not positive.
    """
    height, lengths = 0.25, (0.400, 0.195)
    whole = seven_wheels(joint=joint)
    front = next(each.body for each in whole.joints if each.name == "twist")
    wheels = {wheel.name: wheel for wheel in whole.wheels}
    # the platform's origin is the middle wheel there, that of the front body the joint
    bodies = [
        Body(
            each.mass,
            (0.0, each.at[1] - origin, each.at[2]),
            3 * (each.mass * (length**2 + height**2) / 12,) + 3 * (0.0,),
        )
        for each, origin, length in zip((whole.body, front), (joint, 0.0), lengths, strict=True)
    ]
    depth = (FRONT_MASS + REAR_MASS) * EARTH_GRAVITY / 3 / stiffness
    axles = (
        ("rear", "platform", wheels["rear_left"].at[1] - joint, 0.010),
        ("middle", "platform", 0.0 - joint, 0.005),
        ("front", "front_body", wheels["front_left"].at[1], 0.010),
    )
    discs = tuple(
        Wheel(
            name,
            part,
            (0.0, ahead, 0.0),
            Disc(wheels["middle"].radius),
            driven=True,
            drive=Torque(),
            static_depth=depth,
            inertia=(inertia, inertia),  # the second has no effect in the plane
        )
        for name, part, ahead, inertia in axles
    )
    fold = Coordinate("fold", "suspension", "pitch of the front body relative to the rear body")
    hinge = Joint("front_body", "platform", "x", ORIGIN, "fold", body=bodies[1])
    return planar(Vehicle("step_climber", (fold,), (hinge,), discs, bodies[0]))
