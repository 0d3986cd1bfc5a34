"""Vehicles of the catalogue: functions with the keywords of the rows in ``vehicles.toml``.

The platform's axes are x right, y forward, z up. Masses are rounded values; with ``mass = 0`` and
``wheel_mass = 0`` only kinematics is available.

Step climbers are two bodies on a joint with three axles: the rear body, the platform, carries the
rear and the middle axle, the front body the front axle. In the plane, x is forward, z up; tilts are
nose-up from the horizontal. Positions on a body are distances ahead of the joint, along the body,
and above the joint.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from math import inf, pi
from typing import Annotated, Any, Literal

import casadi as ca
from annotated_types import Gt, Unit

from slipfree.core import schema
from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError, read_table, similar
from slipfree.geometry.frame import ORIGIN, Vector
from slipfree.vehicle.formula import evaluate
from slipfree.vehicle.sections import Disc, section_of_radii
from slipfree.vehicle.tree import DRIVES, Body, Coordinate, Joint, Vehicle, Wheel

Axle = Literal["tilting", "sliding", "prismatic_undriven", "prismatic", "actuated", "fixed"]
MAX_TILT = 1.5  # a wheel with a larger tilt lies on its side [rad]


@checked
def three_wheeler(
    *,
    axle: Axle = "tilting",
    half_track: schema.Length = 1.0,
    wheelbase: schema.Length = 1.5,
    r1: schema.Radius = 0.05,
    r2: schema.Radius = 0.25,
    tilt_stop: schema.Angle = MAX_TILT,
    slide_stop: Annotated[float, Gt(0), Unit("m")] = inf,
    stiffness: schema.JointConstant = 0.0,
    damping: schema.JointConstant = 0.0,
    bump: schema.JointConstant = 0.0,
    mass: schema.Mass = 30.0,
    center_of_mass: tuple[float, float, float] = ORIGIN,
    wheel_mass: schema.Mass = 2.0,
    grip: schema.Factor = 1.0,
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


@checked
def differential_drive(
    *,
    half_track: schema.Length = 0.25,
    caster_ahead: schema.Length = 0.35,
    trail: schema.Position = 0.08,
    r1: schema.Radius = 0.03,
    r2: schema.Radius = 0.12,
    caster_scale: schema.Factor = 2 / 3,
    mass: schema.Mass = 20.0,
    center_of_mass: Vector = (0.0, 0.1, 0.0),
    wheel_mass: schema.Mass = 1.0,
    grip: schema.Factor = 1.0,
) -> Vehicle:
    """Return a cart with two driven wheels and a free caster ahead of them.

    The platform's centre is the middle of the driven axle; it is level on level ground.

    Parameters
    ----------
    half_track, caster_ahead, trail : float
        Distance from the platform's centre to a driven wheel, from the driven axle forward to the
        caster's pivot, and from the pivot back to the centre of the caster's wheel. [m]
    r1, r2 : float
        Radius of the driven wheels' tube, and radius of the circle of tube centres. [m]
    caster_scale : float
        Size of the caster's wheel relative to the driven wheels. [1]
    mass, center_of_mass : float, tuple of 3 floats
        Mass of the platform, and its centre of mass in the platform's frame. [kg, m]
    wheel_mass, grip : float
        Mass of each wheel [kg], and factor that multiplies the ground's coefficient of friction at
        each wheel [1].

    Raises
    ------
    ModelError
        If ``half_track`` or ``caster_ahead`` is not positive, or another number is out of range.
    """
    return described("differential_drive", locals())


@checked
def ackermann(
    *,
    half_track: schema.Length = 0.3,
    wheelbase: schema.Length = 0.7,
    r1: schema.Radius = 0.03,
    r2: schema.Radius = 0.12,
    steer_stop: schema.Angle = 0.7,
    mass: schema.Mass = 40.0,
    center_of_mass: Vector = (0.0, 0.35, 0.0),
    wheel_mass: schema.Mass = 2.0,
    grip: schema.Factor = 1.0,
) -> Vehicle:
    """Return a car with a rocking front axle and driven rear wheels.

    The steering angle is that of a virtual wheel in the middle of the front axle. The front wheels
    turn such that their axles intersect on the line of the rear axle (Ackermann steering).
    The platform's centre is the middle of the rear axle.

    Parameters
    ----------
    half_track, wheelbase : float
        Distance from the vehicle's centre line to a wheel, and distance between the axles. [m]
    r1, r2 : float
        Radius of the wheels' tube, and radius of the circle of tube centres. [m]
    steer_stop : float
        Largest steering angle, to either side. [rad]
    mass, center_of_mass : float, tuple of 3 floats
        Mass of the platform, and its centre of mass in the platform's frame. [kg, m]
    wheel_mass, grip : float
        Mass of each wheel [kg], and factor that multiplies the ground's coefficient of friction at
        each wheel [1].

    Raises
    ------
    ModelError
        If ``half_track`` or ``wheelbase`` is not positive, or another number is out of range.
    """
    return described("ackermann", locals())


@checked
def skid_steer(
    *,
    half_track: schema.Length = 0.3,
    wheelbase: schema.Length = 0.5,
    r1: schema.Radius = 0.03,
    r2: schema.Radius = 0.12,
    mass: schema.Mass = 30.0,
    center_of_mass: Vector = ORIGIN,
    wheel_mass: schema.Mass = 2.0,
    grip: schema.Factor = 1.0,
) -> Vehicle:
    """Return a cart with four driven wheels; the two right wheels are on a rocker.

    Parameters
    ----------
    half_track, wheelbase : float
        Distance from the vehicle's centre line to a wheel, and distance between front and rear
        wheels. [m]
    r1, r2 : float
        Radius of the wheels' tube, and radius of the circle of tube centres. [m]
    mass, center_of_mass : float, tuple of 3 floats
        Mass of the platform, and its centre of mass in the platform's frame. [kg, m]
    wheel_mass, grip : float
        Mass of each wheel [kg], and factor that multiplies the ground's coefficient of friction at
        each wheel [1].

    Raises
    ------
    ModelError
        If ``half_track`` or ``wheelbase`` is not positive, or another number is out of range.
    """
    return described("skid_steer", locals())


@checked
def rigid_skid_steer(
    *,
    axles: int = 2,
    half_track: schema.Length = 0.285,
    wheelbase: schema.Length = 0.51,
    r1: schema.Radius = 0.05,
    r2: schema.Radius = 0.115,
    mass: schema.Mass = 38.0,
    center_of_mass: Vector = (0.0, 0.0, 0.05),
    wheel_mass: schema.Mass = 2.0,
    grip: schema.Factor = 1.0,
) -> Vehicle:
    """Return a rigid robot with two driven wheels on each of its axles, and no suspension.

    Its wheels cannot all touch uneven ground: they are pressed into the ground, and the vehicle
    rocks from one set of supporting wheels to another. The platform's centre is in the middle of
    the axles. The dimensions are typical of outdoor research robots.

    Parameters
    ----------
    axles : int
        Number of axles: two for a four-wheeler, three for a six-wheeler.
    half_track, wheelbase : float
        Distance from the vehicle's centre line to a wheel, and distance between the first and the
        last axle. [m]
    r1, r2 : float
        Radius of the wheels' tube, and radius of the circle of tube centres. [m]
    mass, center_of_mass : float, tuple of 3 floats
        Mass of the platform, and its centre of mass in the platform's frame. [kg, m]
    wheel_mass, grip : float
        Mass of each wheel [kg], and factor that multiplies the ground's coefficient of friction at
        each wheel [1].

    Raises
    ------
    ModelError
        If the number of axles is not 2 or 3, or another number is out of range.
    """
    if axles not in (2, 3):
        raise ModelError(f"rigid_skid_steer: expected axles = 2 or 3, found {axles}; use 2 or 3")
    return described("rigid_skid_steer", locals())


@checked
def mecanum(
    *,
    half_track: schema.Length = 0.15,
    wheelbase: schema.Length = 0.47,
    r1: schema.Radius = 0.0125,
    r2: schema.Radius = 0.035,
    roller_angle: Annotated[float, Unit("rad")] = pi / 4,
    mass: schema.Mass = 22.0,
    center_of_mass: Vector = ORIGIN,
    wheel_mass: schema.Mass = 1.4,
    grip: schema.Factor = 1.0,
) -> Vehicle:
    """Return an omnidirectional platform with four driven mecanum wheels and a rocking front axle.

    Track, wheelbase and radius of the wheels are those of the KUKA youBot [1]_, masses those of its
    description [2]_. The rocking axle, with which all wheels touch uneven ground, and the round
    tread are assumptions. The platform's centre is in the middle of the wheels, at their height.

    Parameters
    ----------
    half_track, wheelbase : float
        Distance from the vehicle's centre line to a wheel, and distance between front and rear
        wheels. [m]
    r1, r2 : float
        Radius of the wheels' tube, and radius of the circle of tube centres. [m]
    roller_angle : float
        Angle of the rollers (`Omni`) of the front left and the rear right wheel; that of the other
        wheels is its negative. The rollers on top of the wheels form an X, or an O if it is
        negative. [rad]
    mass, center_of_mass : float, tuple of 3 floats
        Mass of the platform, and its centre of mass in the platform's frame. [kg, m]
    wheel_mass, grip : float
        Mass of each wheel [kg], and factor that multiplies the ground's coefficient of friction at
        each wheel [1].

    Raises
    ------
    ModelError
        If ``half_track`` or ``wheelbase`` is not positive, or another number is out of range.

    References
    ----------
    .. [1] Configuration of the youBot's driver, youbot/youbot_driver, ``config/youbot-base.cfg``.
    .. [2] a2s-institute/youbot_description, ``urdf/youbot_base/base.urdf.xacro``.
    """
    return described("mecanum", locals())


@checked
def articulated(
    *,
    half_track: schema.Length = 0.35,
    front: schema.Length = 0.4,
    rear: schema.Length = 0.4,
    r1: schema.Radius = 0.04,
    r2: schema.Radius = 0.16,
    bend_stop: schema.Angle = 0.7,
    mass: schema.Mass = 60.0,
    center_of_mass: Vector = ORIGIN,
    wheel_mass: schema.Mass = 4.0,
    grip: schema.Factor = 1.0,
) -> Vehicle:
    """Return an articulated loader with a driven steering joint and a free twist joint.

    All four wheels are driven. The platform is the front half; its centre is the middle of the
    front axle.

    Parameters
    ----------
    half_track, front, rear : float
        Distance from the vehicle's centre line to a wheel, and distances from the steering joint to
        the front and the rear axle. [m]
    r1, r2 : float
        Radius of the wheels' tube, and radius of the circle of tube centres. [m]
    bend_stop : float
        Largest angle between the halves, to either side. [rad]
    mass, center_of_mass : float, tuple of 3 floats
        Mass of each half, and its centre of mass (right, forward, up) from the middle of the
        half's axle. [kg, m]
    wheel_mass, grip : float
        Mass of each wheel [kg], and factor that multiplies the ground's coefficient of friction at
        each wheel [1].

    Raises
    ------
    ModelError
        If ``half_track``, ``front`` or ``rear`` is not positive, or another number is out of range.
    """
    return described("articulated", locals())


@checked
def rocky7(
    *,
    steered: Literal["front", "corners"] = "front",
    r1: schema.Radius = 0.02,
    mass: schema.Mass = 10.0,
    center_of_mass: Vector = (0.0, 0.12, 0.0),
    wheel_mass: schema.Mass = 0.5,
    grip: schema.Factor = 1.0,
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
    r1: schema.Radius = 0.02,
    mass: schema.Mass = 7.0,
    center_of_mass: Vector = ORIGIN,
    wheel_mass: schema.Mass = 0.8,
    grip: schema.Factor = 1.0,
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


SIDES = {"right": {"sign": 1.0, "plus": "+"}, "left": {"sign": -1.0, "plus": "-"}}
TEXTS = ("name", "kind", "words", "parent", "axis", "axle", "value", "motion", "drive")


def described(name: str, keywords: Mapping[str, Any]) -> Vehicle:
    """Return a vehicle of the catalogue with given keywords of its function."""
    table, known = read_table(__file__, "vehicles.toml")[name], dict(keywords)
    for key, value in keywords.items():
        if isinstance(value, tuple):
            known |= {f"{key}_{axis}": each for axis, each in zip("xyz", value, strict=True)}
    for key, value in table.get("let", {}).items():
        known[key] = _value("", value, known)
    wheels = list[Wheel]()
    for row in _rows(({**table.get("wheel", {}), **row} for row in table["wheels"]), known):
        section = section_of_radii(*row.pop("radii"), rollers=row.pop("rollers", None))
        drive = DRIVES[row.pop("drive", "rate")]()
        wheels.append(Wheel(**row, section=section, drive=drive))
    return Vehicle(
        name,
        tuple(Coordinate(**row) for row in _rows(table.get("coordinates", ()), known)),
        tuple(Joint(body=_body(row), **row) for row in _rows(table.get("joints", ()), known)),
        tuple(wheels),
        _body({key: _value(key, value, known) for key, value in table["body"].items()}),
        planar=table.get("planar", False),
    )


def _rows(rows: Iterable[dict[str, Any]], known: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Yield the rows of a table for given keywords, once for each side, with their values."""
    for row in rows:
        conditions = row.get("when", {}).items()
        if all(known[key] in values for key, values in conditions):
            for side, signs in SIDES.items() if "{side}" in row["name"] else [("", {})]:
                names = {**known, "side": side, **signs}
                yield {key: _value(key, row[key], names) for key in row if key != "when"}


def _value(key: str, value: Any, known: Mapping[str, Any]) -> Any:
    """Return a value of a row, with formulas replaced by numbers, and names in texts by values."""
    if isinstance(value, list):
        return tuple(_value(key, each, known) for each in value)
    if isinstance(value, str) and key in TEXTS:
        return value.format(**known)
    if isinstance(value, str) and value not in known:
        numbers = {name: ca.SX(x) for name, x in known.items() if isinstance(x, int | float)}
        return float(ca.evalf(evaluate(value, numbers)))
    value = known.get(value, value)
    return float(value) if type(value) is int else value


def _body(row: dict[str, Any]) -> Body:
    """Return the body of a row, whose keys are removed; without mass, it has no inertia."""
    mass, inertia = row.pop("mass", 0.0), row.pop("inertia", None)
    return Body(mass, row.pop("center_of_mass", (0.0, 0.0, 0.0)), inertia if mass else None)


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
    joint: schema.Position = 0.0,
    half_track: schema.Length = 0.235,
    stiffness: schema.Stiffness = 2e3,
    preload: schema.Force = 20.0,
    grip: schema.Factor = 1.0,
    wheel_mass: schema.Mass = 0.0,
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
def step_climber(*, joint: schema.Position = 0.0, stiffness: schema.Stiffness = 1.5e5) -> Vehicle:
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


__all__ = [
    "ackermann",
    "articulated",
    "differential_drive",
    "mecanum",
    "open_source_rover",
    "rigid_skid_steer",
    "rocky7",
    "seven_wheels",
    "skid_steer",
    "step_climber",
    "three_wheeler",
]


def __getattr__(name: str) -> None:
    """Raise AttributeError with the most similar name of the catalogue."""
    raise AttributeError(
        f"expected a vehicle of the catalogue, found {name!r}; {similar(name, __all__)}use one of "
        f"{', '.join(__all__)}"
    )
