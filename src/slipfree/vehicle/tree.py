"""Vehicle: a tree of joints and wheels with their drives, and the gravity that acts on it."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import casadi as ca
import numpy as np
from annotated_types import Gt, Unit

from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError, check_known, listed, read_table, similar
from slipfree.core.records import Array, HtmlRepr, field_overview, overview
from slipfree.core.schema import Finite, NonNegative, Positive
from slipfree.geometry import frame
from slipfree.system.forks import cached_property
from slipfree.vehicle.formula import evaluate, names_in
from slipfree.vehicle.sections import Section
from slipfree.vehicle.shapes import BodyShape

Kind = Literal["commanded", "passive", "suspension"]
EARTH_GRAVITY = 9.81  # [m/s^2]
PARENT = "the name of the joint that carries it, or 'platform'"
LEAST_TRAIL = 1e-6  # of casters [m]
MAX_WHEELS = 100  # with more, preparing the models takes minutes


@dataclass(frozen=True)
class Drive:
    """Base class of drives; it exerts no effort, as for a wheel that is not driven.

    A drive acts on a wheel or on a commanded coordinate. Its effort is a torque on a wheel or on a
    coordinate that turns, and a force on a coordinate that slides, with the units N and m instead
    of N m and rad. Kinematic and quasi-static models use the rate of every drive.

    Attributes
    ----------
    prescribed : bool
        Whether the input is the rate, and the effort follows from the motion.
    takes_effort : bool
        Whether the input is the effort; otherwise it is a rate.
    has_integral : bool
        Whether the drive has a controller with an integral term, which is a state of the model.
    """

    prescribed: ClassVar[bool] = False
    takes_effort: ClassVar[bool] = False
    has_integral: ClassVar[bool] = False

    @property
    def added_inertia(self) -> float:
        """Inertia of the drive, which is added to that of the wheel or the coordinate [kg m^2]."""
        return 0.0

    def effort(self, wanted: ca.SX, rate: ca.SX, integral: ca.SX) -> tuple[ca.SX, ca.SX]:  # noqa: ARG002
        """Return the effort and the rate of the integral.

        Parameters
        ----------
        wanted : SX, shape (1, 1)
            The input. [rad/s or N m]
        rate : SX, shape (1, 1)
            Rate of the wheel or the coordinate. [rad/s]
        integral : SX, shape (1, 1)
            Integral of the controller. [N m]

        Returns
        -------
        tuple of 2 SX, shape (1, 1)
            Effort in the sense of the rate [N m], and rate of the integral [N m/s].
        """
        return ca.SX(0), ca.SX(0)


@dataclass(frozen=True)
class Rate(Drive):
    """Ideal drive: the input is the rate; the effort follows from the motion."""

    prescribed: ClassVar[bool] = True


@dataclass(frozen=True)
class Torque(Drive):
    """Drive without controller: the input is the effort, a torque or a force."""

    takes_effort: ClassVar[bool] = True

    def effort(self, wanted: ca.SX, rate: ca.SX, integral: ca.SX) -> tuple[ca.SX, ca.SX]:  # noqa: ARG002
        """Return the input as effort; there is no integral.

        Parameters
        ----------
        wanted : SX, shape (1, 1)
            The effort. [N m]
        rate : SX, shape (1, 1)
            Rate of the wheel or the coordinate; not used. [rad/s]
        integral : SX, shape (1, 1)
            Not used. [N m]

        Returns
        -------
        tuple of 2 SX, shape (1, 1)
            The effort [N m], and zero.
        """
        return wanted, ca.SX(0)


@checked
@dataclass(frozen=True)
class Motor(Drive):
    """Direct-current motor with a speed controller: the input is the reference rate.

    The effort is ``kp (wanted - rate) + e``, limited to ``stall min(1, 1 - rate / no_load)``
    forward and ``stall min(1, 1 + rate / no_load)`` backward. The integral ``e`` follows
    ``e' = ki (wanted - rate - (unlimited effort - effort) / kp)``; the last term prevents wind-up.
    Units are those of a rotation; for a coordinate that slides, N and m replace N m and rad.

    Attributes
    ----------
    stall : float
        Largest effort, at the output of the gear. [N m]
    no_load : float
        Rate at which the effort vanishes. [rad/s]
    kp : float
        Proportional gain. [N m s/rad]
    ki : float
        Integral gain. [N m/rad]
    rotor_inertia : float
        Moment of inertia of the rotor, times the square of the gear ratio. [kg m^2]

    Raises
    ------
    ModelError
        If a number is not positive and finite; ``ki`` and ``rotor_inertia`` may be zero.
    """

    has_integral: ClassVar[bool] = True
    stall: Annotated[Positive, Unit("N m")]
    no_load: Annotated[Positive, Unit("rad/s")]
    kp: Annotated[Positive, Unit("N m s/rad")]
    ki: Annotated[NonNegative, Unit("N m/rad")] = 0.0
    rotor_inertia: Annotated[NonNegative, Unit("kg m^2")] = 0.0

    @property
    def added_inertia(self) -> float:
        """Moment of inertia of the rotor, times the square of the gear ratio [kg m^2]."""
        return self.rotor_inertia

    def effort(self, wanted: ca.SX, rate: ca.SX, integral: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the limited effort of the controller, and the rate of its integral.

        Parameters
        ----------
        wanted : SX, shape (1, 1)
            Reference rate. [rad/s]
        rate : SX, shape (1, 1)
            Rate of the wheel or the coordinate. [rad/s]
        integral : SX, shape (1, 1)
            Integral ``e`` of the controller. [N m]

        Returns
        -------
        tuple of 2 SX, shape (1, 1)
            Effort in the sense of the rate, within the limits of the motor [N m], and rate of the
            integral [N m/s].
        """
        error = wanted - rate
        unlimited = self.kp * error + integral
        forward, backward = (
            self.stall * ca.fmin(1, 1 - sign * rate / self.no_load) for sign in (1, -1)
        )
        effort = ca.fmax(-backward, ca.fmin(forward, unlimited))
        return effort, self.ki * (error - (unlimited - effort) / self.kp)


NO_DRIVE = Drive()  # of wheels that are not driven, and of coordinates that are not commanded
RATE = Rate()  # the default
DRIVES: dict[str, type[Drive]] = {"rate": Rate, "torque": Torque, "motor": Motor}


@checked
@dataclass(frozen=True)
class Wheel:
    """A wheel, a body of revolution about its axle.

    Attributes
    ----------
    name : str
        Name, unique among the wheels.
    parent : str
        Name of the joint that carries the wheel, or ``"platform"``.
    at : tuple of 3 floats
        Centre of the wheel in the parent's frame. [m]
    section : Section
        Cross-section, such as ``Torus(0.05, 0.25)``; ``Omni(...)`` for an omni or mecanum wheel.
    driven : bool
        Whether the wheel's rate is an input; the rate of a free wheel follows from the motion.
    grip : float
        Factor that multiplies the ground's coefficient of friction. [1]
    mass : float
        Mass; its centre is the wheel's centre. [kg]
    axle : {"x", "y", "z"} or tuple of 3 floats
        Direction of the axle in the parent's frame; to the right for a wheel that rolls forward.
    static_depth : float or None
        Depth of the wheel in the ground under an equal share of the weight, for vehicles whose
        wheels cannot all touch a rigid ground, and for dynamics; None for 1/50 of the rolling
        radius, or 1/250 in the dynamics of vehicles whose wheels can all touch a rigid ground. [m]
    inertia : tuple of 2 floats or None
        Moments of inertia about the axle and about a perpendicular axis through the centre; None
        for those of a homogeneous cylinder. [kg m^2]
    drive : Drive
        Drive of a driven wheel, such as ``Rate()``, ``Torque()`` or ``Motor(...)``, for dynamics
        (`slipfree.vehicle.tree`).

    Raises
    ------
    ModelError
        If the name has other characters than letters, digits, _ and -, or if a number or the
        direction of the axle is invalid.
    """

    name: str
    parent: str
    at: frame.Vector
    section: Section
    driven: bool
    grip: Positive = 1.0
    mass: NonNegative = 0.0
    axle: frame.Axis = "x"
    static_depth: Positive | None = None
    inertia: tuple[Positive, Positive] | None = None
    drive: Drive = RATE

    __repr__ = field_overview

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[\w-]+", self.name):
            raise ModelError(
                f"wheel {self.name!r}: expected a name of letters, digits, _ and -, since it is "
                "part of names in results; rename the wheel"
            )
        try:
            frame.unit_vector(self.axle)
        except ModelError as error:
            raise ModelError(f"wheel {self.name!r}: axle: {error}") from error

    @property
    def mount(self) -> frame.Pose:
        """Pose of the carrier in the parent's frame: origin at the centre, x axis along the axle.

        The orientation is the smallest rotation that aligns the parent's x axis with the axle.
        """
        x, y, z = frame.unit_vector(self.axle)
        across = math.hypot(y, z)
        if across == 0 and x > 0:
            return frame.translation(*self.at)
        shortest = (0.0, -z, y) if across > 0 else (0.0, 0.0, 1.0)
        return frame.translation(*self.at) @ frame.turn(shortest, math.atan2(across, x))

    @property
    def depth(self) -> float:
        """Value of ``static_depth``, or 1/50 of the rolling radius if it is None [m]."""
        return self.radius / 50 if self.static_depth is None else self.static_depth

    @property
    def acting_drive(self) -> Drive:
        """Drive of the wheel; a drive without effort if the wheel is not driven."""
        return self.drive if self.driven else NO_DRIVE

    @cached_property
    def radius(self) -> float:
        """Rolling radius: distance from the axle to the middle of the tread [m].

        An expression in parameters if the section contains one.
        """
        radius: Any = ca.SX(self.section.profile(ca.SX(0), ca.SX(1))[1])
        return float(radius) if radius.is_constant() else radius

    @cached_property
    def half_width(self) -> float:
        """Largest distance of the wheel's surface from the wheel's plane [m]."""
        return float(np.abs(self.section.outline(np.array([0, np.pi]))[0]).max())

    @property
    def rollers(self) -> float | None:
        """Angle from the wheel's axle to the axles of free rollers; None without rollers [rad]."""
        return self.section.rollers


def wheel_inertia(wheel: Wheel) -> tuple[float, float]:
    """Return the moments of inertia of a wheel about its axle and across it [kg m^2].

    Without given numbers they are those of a homogeneous cylinder of the wheel's radius and width.
    """
    if wheel.inertia is not None:
        return wheel.inertia
    axial = wheel.mass * wheel.radius**2 / 2
    return axial, axial / 2 + wheel.mass * wheel.half_width**2 / 3


@checked
@dataclass(frozen=True)
class Body:
    """Mass, centre of mass, inertia and shapes of a part of a vehicle, without its wheels.

    Attributes
    ----------
    mass : float
        Mass, zero or positive. [kg]
    at : tuple of 3 floats
        Centre of mass in the part's frame. [m]
    inertia : tuple of 6 floats or None
        ``Ixx, Iyy, Izz, Ixy, Ixz, Iyz``: elements of the inertia tensor about the centre of mass,
        in the part's axes; None for those of a homogeneous box
        (`body_inertia`). [kg m^2]
    shapes : tuple of Box, Ball or Hull
        Shapes of the part (`slipfree.vehicle.shapes`), whose distance from the ground is its
        clearance. They have no effect on masses.

    Raises
    ------
    ModelError
        If the mass is negative, if a number is not finite, if ``at`` or ``inertia`` has another
        length, or if a principal moment of inertia is not positive, or above the sum of the others.
    """

    mass: NonNegative = 0.0
    at: frame.Vector = frame.ORIGIN
    inertia: frame.Elements | None = None
    shapes: tuple[BodyShape, ...] = ()

    __repr__ = field_overview

    def __post_init__(self) -> None:
        if self.inertia is not None and not frame.is_inertia(self.inertia):
            principal = np.linalg.eigvalsh(frame.tensor(self.inertia))
            moments = ", ".join(f"{each:.3g}" for each in principal)
            raise ModelError(
                "body: the principal moments of inertia must be positive, and none larger than the "
                f"sum of the others, found {moments} kg m^2; correct the inertia"
            )


@checked
@dataclass(frozen=True)
class Coordinate:
    """Coordinate of a vehicle: an angle or length on which the values of joints depend.

    Attributes
    ----------
    name : str
        Name, unique among the coordinates.
    kind : {"commanded", "passive", "suspension"}
        ``"commanded"``: the rate is an input (in dynamics, the input is that of ``drive``);
        ``"passive"``: the rate follows from the slip law or friction; ``"suspension"``: the value
        follows from the contacts of the wheels.
    words : str
        Description in one line.
    lower, upper : float
        Lower and upper stop; infinite for none. [rad or m]
    stiffness, rest : float
        Stiffness of a spring [N m/rad or N/m], and value of the coordinate at which the spring has
        no force [rad or m].
    damping : float
        Constant of a viscous damper. [N m s/rad or N s/m]
    bump : float
        Stiffness of the stops; zero for rigid stops. A rigid stop ends the motion; to continue from
        there, use the vehicle with that joint locked (`actuated`). [N m/rad or N/m]
    max_rate : float
        Largest rate of its actuator, which steering laws respect; infinite if unknown.
        [rad/s or m/s]
    drive : Drive
        Drive of a commanded coordinate, such as ``Rate()``, ``Torque()`` or ``Motor(...)``, for
        dynamics (`slipfree.vehicle.tree`); other models use the rate.

    Raises
    ------
    ModelError
        If the stops are not in ascending order, if a number is out of range, if ``bump`` is given
        without a stop, if a commanded coordinate whose rate is prescribed has a spring, a damper or
        elastic stops, or if a coordinate that is not commanded has a drive.
    """

    name: str
    kind: Kind
    words: str
    lower: Annotated[float, Unit("rad or m")] = -math.inf
    upper: Annotated[float, Unit("rad or m")] = math.inf
    stiffness: NonNegative = 0.0
    rest: Annotated[Finite, Unit("rad or m")] = 0.0
    damping: NonNegative = 0.0
    bump: NonNegative = 0.0
    max_rate: Annotated[float, Gt(0), Unit("rad/s or m/s")] = math.inf
    drive: Drive = RATE

    __repr__ = field_overview

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise ModelError(
                f"coordinate {self.name!r}: the lower stop must be below the upper one, "
                f"found lower = {self.lower} and upper = {self.upper}; exchange or correct them"
            )
        if self.bump and not (math.isfinite(self.lower) or math.isfinite(self.upper)):
            raise ModelError(
                f"coordinate {self.name!r}: bump, the stiffness of the stops, needs a lower or an "
                "upper stop, found none; give 'lower' or 'upper', or remove 'bump'"
            )
        if self.kind != "commanded" and self.drive != RATE:
            raise ModelError(
                f"coordinate {self.name!r}: expected a drive only for kind = 'commanded', found "
                f"{self.drive} for kind = {self.kind!r}; remove 'drive', or change the kind"
            )
        if self.acting_drive.prescribed and self.is_loaded:
            keys = [k for k in ("stiffness", "damping", "bump") if getattr(self, k)]
            raise ModelError(
                f"coordinate {self.name!r}: a commanded coordinate cannot have a spring, a damper "
                "or elastic stops, since its rate is an input; remove "
                f"{' and '.join(map(repr, keys))}, or use a drive with an effort, of the "
                "kind 'torque' or 'motor'"
            )

    @property
    def acting_drive(self) -> Drive:
        """Drive of the coordinate; a drive without effort if the coordinate is not commanded."""
        return self.drive if self.kind == "commanded" else NO_DRIVE

    @property
    def is_loaded(self) -> bool:
        """Whether a spring, a damper or an elastic stop acts on the coordinate."""
        return any((self.stiffness, self.damping, self.bump))

    def potential(self, value: ca.SX) -> ca.SX:
        """Return the potential energy of the spring and of the elastic stops.

        Parameters
        ----------
        value : SX, shape (1, 1)
            Value of the coordinate. [rad or m]

        Returns
        -------
        SX, shape (1, 1)
            Energy, zero at ``rest`` between the stops. [J]
        """
        energy = ca.SX(0.5 * self.stiffness * (value - self.rest) ** 2)
        for stop, outward in ((self.upper, 1), (self.lower, -1)):
            if math.isfinite(stop):
                energy += 0.5 * self.bump * ca.fmax(outward * (value - stop), 0) ** 2
        return energy


@checked
@dataclass(frozen=True)
class Joint:
    """A part that rotates about an axis or slides along it.

    Attributes
    ----------
    name : str
        Name, unique among the joints.
    parent : str
        Name of an earlier joint, or ``"platform"``.
    axis : {"x", "y", "z"} or tuple of 3 floats
        Axis of the joint in the part's frame: x (right), y (forward), z (up), or a vector.
    at : tuple of 3 floats
        Origin of the part in the parent's frame. [m]
    value : str
        Right-handed angle [rad] or displacement [m] as a formula of coordinates, such as
        ``"rocker"`` or ``"-rocker"`` (`slipfree.vehicle.formula.evaluate`); ``"0"`` for a rigid
        joint.
    motion : {"turn", "slide"}
        Rotation about the axis, or translation along it.
    body : Body
        Mass, centre of mass and inertia of the part without its wheels.
    turned : tuple of 3 floats
        Orientation of the part in the parent's frame at value zero: angles about the parent's x,
        then y, then z axis (roll, pitch, yaw). [rad]

    Raises
    ------
    ModelError
        If ``at``, ``turned``, ``axis`` or ``value`` is invalid.
    """

    name: str
    parent: str
    axis: frame.Axis
    at: frame.Vector
    value: str
    motion: Literal["turn", "slide"] = "turn"
    body: Body = Body()
    turned: frame.Vector = frame.ORIGIN

    __repr__ = field_overview

    def __post_init__(self) -> None:
        try:
            frame.unit_vector(self.axis)
        except ModelError as error:
            raise ModelError(f"joint {self.name!r}: axis: {error}") from error
        try:
            names_in(self.value)
        except ModelError as error:
            raise ModelError(f"joint {self.name!r}: {error}") from error

    @property
    def coordinates(self) -> frozenset[str]:
        """Names of the coordinates in the formula of the joint's value."""
        return names_in(self.value)

    def pose(self, values: Mapping[str, ca.SX]) -> frame.Pose:
        """Return the pose of the part in its parent's frame.

        Parameters
        ----------
        values : mapping of str to SX, shape (1, 1)
            Values of the coordinates in the formula of the joint, by name. [rad or m]

        Returns
        -------
        Pose
            Rotation (3, 3) and origin (3, 1) [m] of the part.
        """
        value = evaluate(self.value, values)
        x, y, z = self.turned
        place = frame.translation(*self.at)
        if any(self.turned):
            place = place @ frame.turn("z", z) @ frame.turn("y", y) @ frame.turn("x", x)
        if self.motion == "turn":
            return place @ frame.turn(self.axis, value)
        return place @ frame.translation(*(value * along for along in frame.unit_vector(self.axis)))


@dataclass(frozen=True)
class VehicleParts:
    """Parts of a vehicle, whether or not they fit each other; the fields are those of `Vehicle`."""

    name: str
    coordinates: tuple[Coordinate, ...]
    joints: tuple[Joint, ...]
    wheels: tuple[Wheel, ...]
    body: Body = Body()
    notes: tuple[str, ...] = ()
    planar: bool = False

    def of(self, kind: Kind) -> tuple[Coordinate, ...]:
        """Return the coordinates of a given kind, in the vehicle's order."""
        return tuple(c for c in self.coordinates if c.kind == kind)


@checked
@dataclass(frozen=True)
class Vehicle(HtmlRepr, VehicleParts):
    """A vehicle: platform, joints and wheels.

    Models and results keep the order of coordinates, joints and wheels.

    Attributes
    ----------
    name : str
        Name in results.
    coordinates : tuple of Coordinate
        Internal degrees of freedom.
    joints : tuple of Joint
        Joints; parents precede their children.
    wheels : tuple of Wheel
        Wheels, from 1 to 100. Kinematic and quasi-static models require at least 3.
    body : Body
        Mass and centre of mass of the platform. A vehicle without mass has kinematics only, no
        forces.
    notes : tuple of str
        Assumptions that were made when the vehicle was read from a file.
    planar : bool
        Whether the platform moves only in a vertical plane, see `planar`.
    nominal : Vehicle or None
        The same vehicle with numbers, if lengths or grips of this one are expressions in parameters
        of a model (`slipfree.fit.estimate`); models take scales and initial guesses from it.
    gravity : float
        Gravitational acceleration, downward, that acts on the vehicle and on the soil under it;
        `slipfree.in_gravity` changes it. [m/s^2]

    Raises
    ------
    ModelError
        If a name is used twice or is unknown, if a coordinate moves no joint, or both turning and
        sliding joints, if the number of wheels is out of range, or if the gravity is not positive
        and finite.
    """

    nominal: Vehicle | None = field(default=None, compare=False)
    gravity: Positive = EARTH_GRAVITY

    def __repr__(self) -> str:
        driven = sum(wheel.driven for wheel in self.wheels)
        return overview(
            f"Vehicle {self.name!r}: {len(self.wheels)} wheels ({driven} driven), {self.mass:g} kg",
            wheels=(wheel.name for wheel in self.wheels),
            joints=(joint.name for joint in self.joints),
            coordinates=(f"{c.name} ({c.kind})" for c in self.coordinates),
            notes=self.notes,
        )

    def __post_init__(self) -> None:
        parts = self.coordinates, self.joints, self.wheels
        for (part, index, *key), expected, found in part_faults(*parts):
            where = ": ".join([f"{part[:-1]} {getattr(self, part)[index].name!r}", *key])
            raise ModelError(f"{where}: expected {expected}, found {found}")
        known = {"platform"}
        for joint in self.joints:
            if joint.parent not in known:
                raise ModelError(
                    f"joint {joint.name!r}: parent: expected one of {', '.join(sorted(known))}, "
                    f"found {joint.parent!r}; define the parent before the joint"
                )
            known.add(joint.name)
        if not 1 <= len(self.wheels) <= MAX_WHEELS:
            raise ModelError(
                f"vehicle {self.name!r}: expected 1 to {MAX_WHEELS} wheels, found "
                f"{len(self.wheels)}; {'remove' if self.wheels else 'add'} wheels"
            )

    @property
    def numeric(self) -> Vehicle:
        """The vehicle with numbers in place of parameters."""
        return self.nominal or self

    def unit(self, name: str) -> Literal["rad", "m"]:
        """Return the unit of a coordinate.

        Parameters
        ----------
        name : str
            Name of a coordinate.

        Returns
        -------
        {"rad", "m"}
            ``"m"`` if a joint that slides depends on the coordinate, else ``"rad"``.
        """
        slides = any(name in j.coordinates and j.motion == "slide" for j in self.joints)
        return "m" if slides else "rad"

    @property
    def bodies(self) -> tuple[tuple[str, Body], ...]:
        """Names of the platform and of the joints, and their bodies."""
        return ("platform", self.body), *((joint.name, joint.body) for joint in self.joints)

    @property
    def shapes(self) -> tuple[tuple[str, BodyShape], ...]:
        """Shapes of all bodies, with the names of their parts."""
        return tuple((name, shape) for name, body in self.bodies for shape in body.shapes)

    @property
    def mass(self) -> float:
        """Total mass, wheels included [kg]."""
        return sum(body.mass for _, body in self.bodies) + sum(wheel.mass for wheel in self.wheels)

    @property
    def weight(self) -> float:
        """Total weight, wheels included [N]."""
        return self.mass * self.gravity

    @property
    def centers(self) -> Array:
        """Centres of the wheels relative to the platform at zero coordinates, (n_wheels, 3) [m]."""
        return np.array(ca.evalf(ca.horzcat(*(pose.origin for pose in self.carriers())))).T

    @property
    def trail(self) -> float:
        """Shortest trail of casters, infinite without casters [m].

        A caster turns in the direction of its motion over a path of this length: the displacement
        of its wheel along the axle, over the turn of the axle about the vertical.
        """
        trails = [math.inf]
        for coordinate in self.of("passive"):
            q = ca.SX.sym("q")
            for pose in self.numeric.carriers(values={coordinate.name: q}):
                axle = pose.rotation[:, 0]
                moved = ca.dot(ca.jacobian(pose.origin, q), axle)
                turned = ca.cross(axle, ca.jacobian(axle, q))[2]
                both = ca.Function("both", [q], [ca.fabs(moved), ca.fabs(turned)])(0)
                along, angle = map(float, both)
                if min(along, angle) > LEAST_TRAIL:  # without a trail, it does not swivel
                    trails.append(along / angle)
        return min(trails)

    def carriers(
        self, platform: frame.Pose = frame.FIXED, values: Mapping[str, ca.SX] = {}
    ) -> tuple[frame.Pose, ...]:
        """Return the pose of each wheel's carrier: origin at the centre, x axis along the axle.

        Parameters
        ----------
        platform : Pose
            Pose of the platform.
        values : mapping of str to SX
            Values of coordinates by name; the others are zero. [rad or m]
        """
        parts = self.parts(platform, values)
        return tuple(parts[wheel.parent] @ wheel.mount for wheel in self.wheels)

    def masses(
        self, platform: frame.Pose = frame.FIXED, values: Mapping[str, ca.SX] = {}
    ) -> Iterator[tuple[str, float, ca.SX]]:
        """Yield name, mass [kg] and centre of mass [m] of every part and wheel with a mass.

        The name of a wheel is that of its parent part.

        Parameters are those of `carriers`.
        """
        parts = self.parts(platform, values)
        bodies = [*self.bodies]
        bodies += [(wheel.parent, Body(wheel.mass, wheel.at)) for wheel in self.wheels]
        for part, body in bodies:
            if body.mass:
                yield part, body.mass, (parts[part] @ frame.translation(*body.at)).origin

    def parts(
        self, platform: frame.Pose = frame.FIXED, values: Mapping[str, ca.SX] = {}
    ) -> dict[str, frame.Pose]:
        """Return the poses of the platform and of the parts of all joints, by name.

        Parameters are those of `carriers`.
        """
        parts = {"platform": platform}
        values = {c.name: ca.SX(0) for c in self.coordinates} | dict(values)
        for joint in self.joints:
            parts[joint.name] = parts[joint.parent] @ joint.pose(values)
        return parts


@checked
def planar(vehicle: Vehicle) -> Vehicle:
    """Return a vehicle whose platform moves only in the plane x = 0 of the map, for dynamics.

    The platform moves along y and z and pitches; its x, heading and roll are zero. The forces that
    keep it in the plane do no work.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle. Its joints are not changed.
    """
    return replace(vehicle, planar=True)


def actuated(vehicle: Vehicle, *names: str) -> Vehicle:
    """Return the vehicle with actuators in passive joints, whose rates become inputs.

    ``names`` are the passive coordinates of these joints. An actuator with rate zero locks its
    joint. The torque or force of the actuator is an output. Springs, dampers and elastic stops of
    these coordinates are removed.

    Raises
    ------
    ModelError
        If a name is not the name of a passive coordinate.
    """
    passive = [c.name for c in vehicle.of("passive")]
    check_known("actuated", names, passive, "one of the passive coordinates")
    coordinates = tuple(
        replace(c, kind="commanded", stiffness=0.0, damping=0.0, bump=0.0) if c.name in names else c
        for c in vehicle.coordinates
    )
    return replace(vehicle, coordinates=coordinates)


def part_faults(
    coordinates: Sequence[Any],
    joints: Sequence[Any],
    wheels: Sequence[Any],
    add: str = "a coordinate {!r}",
) -> Iterator[tuple[tuple[Any, ...], str, str]]:
    """Yield place, expected and found value for each part of a vehicle that does not fit others.

    A place is the kind of the part, its index and the name of a field. Parts are records, or tables
    of a file, with these fields; ``add`` says how to add a coordinate with a name.
    """
    for parts in ({"coordinates": coordinates, "wheels": wheels}, {"joints": joints}):
        seen = {"platform": "the platform"} if "joints" in parts else {}
        for part, rows in parts.items():
            for index, name in enumerate(row.name for row in rows):
                if name in seen:
                    remedy = "it" if name == "platform" else "one of them"
                    found = f"{name!r}, also the name of {seen[name]}; rename {remedy}"
                    yield (part, index, "name"), "a unique name", found
                seen.setdefault(name, f"{part}[{index}]")
    carriers = ["platform", *(joint.name for joint in joints)]
    for part, rows in (("joints", joints), ("wheels", wheels)):
        for index, row in enumerate(rows):
            if row.parent not in carriers:
                found = f"{row.parent!r}; {similar(row.parent, carriers)}correct the name"
                yield (part, index, "parent"), f"{PARENT}: {listed(carriers)}", found
    known = [c.name for c in coordinates]
    motions: dict[str, set[str]] = {name: set() for name in known}
    for index, joint in enumerate(joints):
        place = ("joints", index, "value")
        try:
            used = names_in(joint.value)
        except ModelError as error:
            yield place, "a formula of coordinates, '0' for a rigid joint", str(error)
            continue
        for name in sorted(used):
            if name not in motions:
                expected = f"a formula of the coordinates ({', '.join(known) or 'none'})"
                hint = f"{similar(name, known)}correct it, or add {add.format(name)}"
                yield place, expected, f"{name!r}; {hint}"
            motions.setdefault(name, set()).add(joint.motion)
    for index, name in enumerate(known):
        if not motions[name]:
            found = "none; remove the coordinate, or add such a joint"
            yield ("coordinates", index), "a joint whose value uses the coordinate", found
        if len(motions[name]) > 1:
            expected = "only turning or only sliding joints whose value uses the coordinate"
            yield ("coordinates", index), expected, "both; use two coordinates"


def body_inertia(vehicle: Vehicle, part: str) -> Array:
    """Return the inertia tensor of a part about its centre of mass, shape (3, 3) [kg m^2].

    The tensor is in the part's axes, without the wheels; ``part`` is the name of a joint, or
    ``"platform"``. If the part has no given inertia, it is that of a homogeneous box with the
    extent of the part: its origin, its centre of mass, the joints and the wheels that it carries.
    No side is shorter than the smallest wheel radius.
    """
    body = body_of(vehicle, part)
    if body.inertia is not None:
        return frame.tensor(body.inertia)
    places = [(0.0, 0.0, 0.0), body.at]
    places += [joint.at for joint in vehicle.joints if joint.parent == part]
    places += [wheel.at for wheel in vehicle.wheels if wheel.parent == part]
    sides = np.maximum(np.ptp(places, axis=0), min(wheel.radius for wheel in vehicle.wheels))
    return np.asarray(body.mass / 12 * np.diag((sides**2).sum() - sides**2))


def body_of(vehicle: Vehicle, part: str) -> Body:
    """Return the body of a joint, or of the platform."""
    if part == "platform":
        return vehicle.body
    return next(joint.body for joint in vehicle.joints if joint.name == part)


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
        (`slipfree.vehicle.tree.BODIES`).

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
