"""Step climbers: two bodies on a joint with three axles, in the plane and in the catalogue.

The rear body, the platform, carries the rear and the middle axle, the front body the front axle.
x is forward, z up; tilts are nose-up from the horizontal. Positions on a body are distances ahead
of the joint, along the body, and above the joint.
"""

from __future__ import annotations

from slipfree.catalog.vehicles import described
from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.schema import Factor, Force, Length, Mass, Position, Stiffness
from slipfree.vehicle.sections import Disc
from slipfree.vehicle.tree import Vehicle
from slipfree.vehicle.wheel import ORIGIN

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


FRONT_MASS = 7.8  # of the front body, wheels included [kg]


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
    return described("seven_wheels", locals())


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
    return described("step_climber", locals())
