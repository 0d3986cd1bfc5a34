"""Terramechanics: forces on a rigid wheel in loose soil by Bekker, Wong and Reece.

The wheel presses and shears the soil along its rim. With the depth ``h`` of the wheel, its radius
``r`` and width ``b``, and the angle ``theta`` from its lowest point forward, the normal stress
follows from the pressure-sinkage relation of Bekker and Reece, with its peak at ``theta_m`` (Wong
and Reece); the shear stress follows from the shear displacement of the soil at the rim (Janosi and
Hanamoto). Shear deformation moduli grow with the slip angle (Ishigami):

- Entry and exit: ``theta_f = acos(1 - h / r)`` and ``theta_r = -acos(1 - lambda h / r)`` (1).
- Peak: ``theta_m = (a_0 + a_1 s) theta_f`` (2), for the slip ratio ``s``.
- Normal stress: ``sigma = (k_c / b + k_phi) (r (cos theta_e - cos theta_f))^n`` (3), where
  ``theta_e`` is ``theta`` ahead of the peak; behind the peak it runs from ``theta_m`` to
  ``theta_f`` as ``theta`` runs from ``theta_m`` to ``theta_r``.
- Shear displacement: ``j_x = r_s (theta_f - theta - (1 - s) (sin theta_f - sin theta))`` and
  ``j_y = r_s (1 - s) (theta_f - theta) tan beta`` (4), for the slip angle ``beta`` and the shear
  radius ``r_s = r + h_g`` with the effective height ``h_g`` of grousers.
- Shear stress: ``tau_x = (c + sigma tan phi) (1 - exp(-j_x / k_x))``, likewise ``tau_y`` (5), with
  ``k_x = k_x0 + k_x1 abs(beta)`` and ``k_y = k_y0 + k_y1 abs(beta)`` (6).
- Bulldozing at the side of the wheel: ``R_b = D_1 (c h' + D_2 w h'^2 / 2)`` (7), with
  ``h' = r (cos theta - cos theta_f)``, the unit weight ``w`` of the soil,
  ``D_1 = cot X + tan(X + phi)``, ``D_2 = cot X + cot^2 X tan phi`` and ``X = pi/4 - phi/2``.
- Normal force ``r b int(sigma cos + tau_x sin)``, drawbar pull ``r b int(tau_x cos - sigma sin)``,
  side force ``int(r b tau_y + R_b (r - h' cos))`` and resistance torque ``r r_s b int(tau_x)`` (8).

Two additions, which wheel tests support (`docs/measured_wheels.md`), are off by default:

- Slip sinkage: ``n`` grows by ``n_s s+ + n_k q`` (9), where ``s+`` is the slip ratio of a driven
  wheel (Ding et al., J. Field Robotics 32(6), 2015: ``n_0 + n_1 s``), and the skid ratio
  ``q = sqrt(max(v_x - u, 0)^2 + v_y^2) / sqrt(v_x^2 + v_y^2)`` is the share of the motion in
  which the wheel pushes soil ahead or aside: one for a locked wheel in any direction. The use of
  ``q`` is our own.
- Coupled shear: ``tau = (c + sigma tan phi) (1 - exp(-J))`` (10) has the direction of
  ``(j_x, j_y)``, with ``J^2 = (j_x / k_x)^2 + (j_y / k_y)^2``, as in isotropic soil (Jia, Smith,
  Peng, Robotica 30(3), 2012). Without a slip angle it equals (5).

Each integral is computed with twelve Gauss points ahead of the peak and twelve behind it, in the
square root of the angle from the edge: there the stress has a branch point if ``n`` is not an
integer, and the shear stress of a braked wheel saturates within a small angle.

The published formulas apply to a wheel that is driven forward. Here they are expressed by the rim
speed ``u = r_s omega``, for the angular velocity ``omega`` of the wheel, and the speeds ``v_x``,
``v_y`` of its centre, where ``1 - s = v_x / u`` and ``(1 - s) tan beta = v_y / u``. They then also
hold for braked and locked wheels, wheels that spin in place, and sideways and backward motion. If
a wheel reverses, entry and exit change places smoothly; near standstill, the shear displacement is
that of the rim speed ``creep``.

A ground may have regions with another soil. The sources of the published soils give the parameters
of sinkage and strength, and the shear deformation modulus. All other parameters have the defaults
of `Soil`: angles of largest stress, exit depth and density.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import dataclass, fields
from functools import lru_cache
from math import inf, pi, radians, sqrt
from typing import Annotated, Any, ClassVar, NamedTuple, Protocol, TypeVar

import casadi as ca
import numpy as np
from annotated_types import Ge, Gt, Le, Lt, Unit

from slipfree.core.arguments import checked
from slipfree.core.dae import Limit
from slipfree.core.errors import ModelError, check_known, read_table
from slipfree.core.quantities import quantity_label
from slipfree.core.records import Array
from slipfree.core.schema import Flag
from slipfree.geometry.regions import Region
from slipfree.laws.coulomb import creep_continuation, no_equilibrium
from slipfree.laws.protocols import (
    Equations,
    GroundForce,
    Reaction,
    SlidingContacts,
    WheelContact,
    quantity_labels,
    wheel_labels,
)
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import EARTH_GRAVITY, Vehicle, Wheel

# not constants of the ground
OF_THE_LAW = "grouser_height", "damping_ratio", "creep", "coupled_shear", "regions"


class RegionalSoil(Protocol):
    """Dataclass of the constants of a soil, with regions of other soils."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def regions(self) -> tuple[SoilRegion, ...]:
        """Regions of other soils."""


S = TypeVar("S", bound=RegionalSoil)


@dataclass(frozen=True)
class SoilRegion:
    """A region of the ground with another soil.

    Across the border, the constants of the soils are blended: their weights change as the
    polynomial of degree five with two continuous derivatives at both ends.

    Attributes
    ----------
    region : Region
        The region, in map coordinates.
    soil : Soil
        Its soil. Grousers, damping ratio and creep are those of the law.
    width : float
        Width of the transition, half of it on each side of the border. [m]

    Raises
    ------
    ModelError
        If the width is not positive and finite, or the soil of the region has regions.
    """

    region: Region
    soil: RegionalSoil
    width: float

    def __post_init__(self) -> None:
        if not 0 < self.width < inf:
            raise ModelError(
                f"soil region: width: expected a finite positive width, found {self.width} m; give "
                "the width in which one soil becomes the other"
            )
        if self.soil.regions:
            raise ModelError(
                "soil region: expected a soil without regions, found one with regions; list all "
                "regions in one soil: later ones cover earlier ones"
            )

    def weight(self, x: ca.SX, y: ca.SX) -> ca.SX:
        """Return the weight of the region's soil at a point in map coordinates, 0 to 1 [1]."""
        s = ca.fmax(0, ca.fmin(0.5 - self.region.outside(x, y) / self.width, 1))
        return ca.SX(s**3 * (10 + s * (6 * s - 15)))


def soil_at(soil: S, x: ca.SX, y: ca.SX) -> S:
    """Return a soil with the constants at a map point, as expressions where regions blend them.

    Later regions cover earlier ones.
    """
    if not soil.regions:
        return soil
    names = [each.name for each in fields(soil) if each.name not in OF_THE_LAW]
    values = {name: getattr(soil, name) for name in names}
    for region in soil.regions:
        weight = region.weight(x, y)
        values = {k: v + weight * (getattr(region.soil, k) - v) for k, v in values.items()}
    here = copy(soil)  # without the check of constants, which are expressions now
    for name, value in ({"regions": ()} | values).items():
        object.__setattr__(here, name, value)
    return here


POINTS, WEIGHTS = np.polynomial.legendre.leggauss(12)  # Gauss points on each side of the peak
SMALLEST_DEPTH = 1e-9  # of a wheel; angles have no derivative at zero depth [wheel radii]
SMALLEST_PATH = 1e-9  # shear displacement below which its direction is smoothed [m]
STEADY_CREEP = 1e-8  # creep speed in steady motion [larger of rim and forward speed]
ANGLE_SMOOTHING = 0.01  # slip angle whose smoothed sign in (6) and (7) is 0.76 [rad]
RATIO_SMOOTHING = 0.02  # slip and skid ratio below which the exponent hardly changes [1]
SMALLEST_RATIO = 1e-12  # keeps the derivative of a root finite [1]
DEPTH_STEPS = 60  # of Newton's method and bisection for the sinkage
DEPTH_TOLERANCE = 1e-13  # last step of the sinkage [wheel radii]
UNKNOWNS = (
    *("force_normal", "force_along", "force_across", "soil_torque", "sinkage"),
    *("rim_speed", "speed_along", "speed_across"),
)
EQUATIONS = (
    ("touching", "m s-1", "normal velocity of the contact point"),
    ("bearing", "1", "normal force of the soil minus that of the unknowns, over the weight"),
    ("pulling", "1", "drawbar pull of the soil minus that of the unknowns, over the weight"),
    ("siding", "1", "side force of the soil minus that of the unknowns, over the weight"),
    ("resisting", "1", "torque of the soil minus that of the unknowns, over weight and radius"),
    ("rim", "m s-1", "rim speed: that of the motion minus the unknown"),
    ("forward", "m s-1", "speed along the wheel: that of the motion minus the unknown"),
    ("sideways", "m s-1", "speed across the wheel: that of the motion minus the unknown"),
)


class SoilUnknowns(NamedTuple):
    """Forces [N], torques [N m], depths [m] and speeds [m/s] of the wheels in soil.

    The forces of the soil are long expressions. With these unknowns, each of them is an expression
    of four unknowns, and its derivatives in a plan are a third as long.
    """

    normal: tuple[Any, ...]
    along: tuple[Any, ...]
    across: tuple[Any, ...]
    torque: tuple[Any, ...]
    sinkage: tuple[Any, ...]
    rim: tuple[Any, ...]
    forward: tuple[Any, ...]
    sideways: tuple[Any, ...]


class WheelSize(NamedTuple):
    """Radius [m] and width [m] of a wheel in soil."""

    radius: float
    width: float


class SoilForces(NamedTuple):
    """Forces of the soil on a wheel, of the same type as the arguments of the computation.

    Force along the normal of the ground [N], drawbar pull, positive forward [N], force across the
    wheel, positive to the right, against the sideways motion [N], and resistance torque about the
    axle: the drive torque that keeps the rate constant [N m].
    """

    normal: Any
    pull: Any
    side: Any
    torque: Any


@checked
@dataclass(frozen=True)
class Soil:
    """Loose soil under rigid wheels, for dynamics and quasi-statics.

    The defaults are the dry sand of Ishigami et al. (2007); `slipfree.laws.soil` has other soils.
    The width of a wheel is that of its section, ``2 r1`` of a torus. Equation numbers are those of
    `slipfree.laws.soil`.

    Attributes
    ----------
    cohesion : float
        Cohesion ``c``. [Pa]
    friction_angle : float
        Angle ``phi`` of internal friction. [rad]
    cohesive_modulus : float
        Modulus ``k_c`` of the pressure-sinkage relation (3). [N/m^(n+1)]
    frictional_modulus : float
        Modulus ``k_phi`` of the pressure-sinkage relation (3). [N/m^(n+2)]
    exponent : float
        Sinkage exponent ``n``. [1]
    shear_along : float
        Shear deformation modulus along the wheel, ``k_x0``. [m]
    shear_along_rate : float
        Increase of ``shear_along`` with the slip angle, ``k_x1``. [m/rad]
    shear_across : float
        Shear deformation modulus across the wheel, ``k_y0``. [m]
    shear_across_rate : float
        Increase of ``shear_across`` with the slip angle, ``k_y1``. [m/rad]
    exponent_slip : float
        Increase of ``exponent`` with the slip ratio of a driven wheel. [1]
    exponent_skid : float
        Increase of ``exponent`` with the skid ratio (9). [1]
    peak : float
        Ratio of the angle of largest stress to the entry angle at slip zero, ``a_0``. [1]
    peak_rate : float
        Increase of ``peak`` with the slip ratio, ``a_1``. [1]
    exit_depth : float
        Ratio ``lambda`` of the depth at which the soil leaves the wheel to the wheel's depth. [1]
    density : float
        Density, for bulldozing. [kg/m^3]
    grouser_height : float
        Effective height of grousers, added to the radius at which soil is sheared. [m]
    damping_ratio : float
        Damping ratio of the wheel's vertical oscillation about its static sinkage. [1]
    creep : float
        Rim speed below which the shear stress of a rolling wheel is reduced. [m/s]
    coupled_shear : bool
        Whether the resultant of the shear stresses saturates (10), not each of them (5).
    regions : tuple of SoilRegion
        Regions of the ground with other constants; a wheel's soil is that at its contact point.

    Raises
    ------
    ModelError
        If a number is outside its bounds, or the largest stress is not ahead of the lowest point
        at all slip ratios: ``peak_rate < peak`` and ``peak + peak_rate < 1``.
    """

    cohesion: Annotated[float, Ge(0), Lt(inf), Unit("Pa")] = 800.0
    friction_angle: Annotated[float, Gt(0), Lt(pi / 2), Unit("rad")] = radians(37.2)
    cohesive_modulus: Annotated[float, Ge(0), Lt(inf), Unit("N/m^(n+1)")] = 1.37e3
    frictional_modulus: Annotated[float, Gt(0), Lt(inf), Unit("N/m^(n+2)")] = 8.14e5
    exponent: Annotated[float, Gt(0), Le(3), Unit("1")] = 1.0
    shear_along: Annotated[float, Gt(0), Lt(inf), Unit("m")] = 0.036
    shear_along_rate: Annotated[float, Ge(0), Lt(inf), Unit("m/rad")] = 0.043
    shear_across: Annotated[float, Gt(0), Lt(inf), Unit("m")] = 0.013
    shear_across_rate: Annotated[float, Ge(0), Lt(inf), Unit("m/rad")] = 0.020
    exponent_slip: Annotated[float, Ge(0), Le(3), Unit("1")] = 0.0
    exponent_skid: Annotated[float, Ge(0), Le(3), Unit("1")] = 0.0
    peak: Annotated[float, Gt(0), Lt(1), Unit("1")] = 0.4
    peak_rate: Annotated[float, Ge(0), Lt(1), Unit("1")] = 0.15
    exit_depth: Annotated[float, Ge(0), Le(1.5), Unit("1")] = 0.9
    density: Annotated[float, Ge(0), Lt(inf), Unit("kg/m^3")] = 1600.0
    grouser_height: Annotated[float, Ge(0), Lt(inf), Unit("m")] = 0.0
    damping_ratio: Annotated[float, Ge(0), Le(10), Unit("1")] = 0.5
    creep: Annotated[float, Gt(0), Le(1), Unit("m/s")] = 1e-3
    coupled_shear: Flag = False
    regions: tuple[SoilRegion, ...] = ()

    def __post_init__(self) -> None:
        shape: Any = self.peak + self.peak_rate
        if isinstance(shape, ca.SX):  # a parameter
            return
        if not (self.peak_rate < self.peak and self.peak + self.peak_rate < 1):
            raise ModelError(
                "Soil: expected 'peak_rate' < 'peak' and 'peak' + 'peak_rate' < 1, so that the "
                "largest stress is between the lowest point and the entry at every slip ratio, "
                f"found peak = {self.peak:g}, peak_rate = {self.peak_rate:g}; reduce 'peak_rate'"
            )

    def check(self, vehicle: Vehicle, terrain: Terrain) -> None:  # noqa: ARG002 - of the protocol
        """Check that the law suits a vehicle; every ground suits it.

        Raises
        ------
        ModelError
            If a wheel has no width, or rollers that are oblique.
        """
        for wheel in vehicle.wheels:
            wheel_size(wheel)

    def unknowns(self, vehicle: Vehicle) -> SoilUnknowns:
        """Return the labels of the unknowns of a quasi-static model.

        Parameters
        ----------
        vehicle : Vehicle
            A vehicle with n wheels.

        Returns
        -------
        SoilUnknowns
            Labels of forces [N], torques [N m], sinkage [m] and speeds [m/s], n each.
        """
        return SoilUnknowns(*(quantity_labels(vehicle, name) for name in UNKNOWNS))

    def reaction(self, contacts: SlidingContacts, unknowns: SoilUnknowns) -> Reaction:
        """Return the forces of the ground and the equations of the law's unknowns.

        Parameters
        ----------
        contacts : SlidingContacts
            Slip [m/s], friction [1] and rates of the n wheels, in the symbols of a model.
        unknowns : SoilUnknowns
            Forces [N], torques [N m], sinkage [m] and speeds [m/s], one per wheel.

        Returns
        -------
        Reaction
            Components along, across and normal to each wheel [N],
            torques [N m], and the equations of forces, sinkage and speeds.
        """
        continuation, rows = creep_continuation(self.creep), list[list[ca.SX]]()
        weight = contacts.vehicle.weight
        for k, wheel in enumerate(contacts.vehicle.wheels):
            size, own = wheel_size(wheel), SoilUnknowns(*(each[k] for each in unknowns))
            spin, speeds = contacts.spins[k], (own.rim, own.forward, own.sideways)
            here = soil_at(self, *ca.vertsplit(contacts.places[k]))
            motion = own.sinkage, *speeds, continuation.symbol
            forces = forces_at_speeds(here, size, *motion, contacts.vehicle.gravity)
            rows.append(
                [
                    contacts.normal[k],
                    (forces.normal - own.normal) / weight,
                    (forces.pull - own.along) / weight,
                    (forces.side - own.across) / weight,
                    (forces.torque - own.torque) / (weight * size.radius),
                    (size.radius + self.grouser_height) * spin - own.rim,
                    contacts.along[k] + size.radius * spin - own.forward,
                    contacts.across[k] - own.sideways,
                ]
            )
        words = "the soil cannot hold the vehicle"
        fastest = no_equilibrium(contacts._replace(diagnose=lambda _x, _z: words))
        sunk = (
            Limit(quantity_label("sunk", wheel.name, quantity="sinkage"), depth, -inf, wheel.radius)
            for wheel, depth in zip(contacts.vehicle.numeric.wheels, unknowns.sinkage, strict=True)
        )
        return Reaction(
            unknowns.along,
            unknowns.across,
            unknowns.normal,
            Equations(
                tuple(
                    label for name in EQUATIONS for label in wheel_labels(contacts.vehicle, *name)
                ),
                ca.vertcat(*(row for kind in zip(*rows, strict=True) for row in kind)),
            ),
            (fastest, *sunk),
            continuation,
            unknowns.torque,
        )

    def static_depth(self, wheel: Wheel, load: float) -> float:
        """Return the sinkage of a wheel at rest under a load [m].

        Parameters
        ----------
        wheel : Wheel
            The wheel; its own ``static_depth`` is not used.
        load : float
            Normal force. [N]

        Raises
        ------
        ModelError
            If the wheel sinks to its axle.
        """
        return static_sinkage(self, wheel_size(wheel), load)

    def max_depth(self, wheel: Wheel) -> float:
        """Return the depth up to which the law is valid.

        Parameters
        ----------
        wheel : Wheel
            A wheel with a width.

        Returns
        -------
        float
            Radius of the wheel, which then sinks to its axle. [m]
        """
        return wheel.radius

    def force(self, contact: WheelContact) -> GroundForce:
        """Return the force and the moment of the soil on a wheel.

        Parameters
        ----------
        contact : WheelContact
            Contact and motion of the wheel.
        """
        touch, wheel = contact.touch, contact.wheel
        frame, size = touch.frame, wheel_size(wheel)
        away = ca.dot(frame.normal, contact.slip)
        forward = ca.dot(frame.along, contact.slip) + size.radius * contact.spin
        sideways = ca.dot(frame.across, contact.slip)
        rim = (size.radius + self.grouser_height) * contact.spin
        here = soil_at(self, *ca.vertsplit(contact.place))
        motion = -touch.gap, rim, forward, sideways, self.creep
        forces = forces_at_speeds(here, size, *motion, contact.gravity)
        damping = 2 * self.damping_ratio / sqrt(contact.gravity * wheel.depth)
        pressing = ca.if_else(touch.gap < 0, ca.fmax(0, 1 - damping * away), 0)
        normal, pull, side, torque = (pressing * each for each in forces)
        tangential = pull * frame.along + side * frame.across
        arm = frame.point - contact.center
        lever = ca.dot(frame.axle, ca.cross(arm, normal * frame.normal + tangential))
        return GroundForce(normal, tangential, ca.SX(0), torque - lever)


def wheel_size(wheel: Wheel) -> WheelSize:
    """Return radius and width of a wheel in soil.

    ModelError is raised if the section of the wheel is not a torus with a width, or if its rollers
    are oblique.
    """
    if wheel.rollers and abs(wheel.rollers) < pi / 2:
        raise ModelError(
            f"wheel {wheel.name!r}: expected a wheel on soil without oblique rollers, whose forces "
            f"in soil are not known, found {wheel.section}; use a ground with a coefficient of "
            "friction, or other wheels"
        )
    tube, circle = wheel.section.torus_radii or (0.0, 0.0)
    if not (tube and (isinstance(circle, ca.SX) or circle)):  # a fitted radius is an expression
        raise ModelError(
            f"wheel {wheel.name!r}: expected a torus as section, since the forces of soil depend "
            f"on the wheel's width, found {wheel.section}; set the section to "
            "Torus(r1, r2) with r1 half the width and r1 + r2 the radius"
        )
    return WheelSize(wheel.radius, 2 * tube)


def forces_at_slip(
    soil: Soil, size: WheelSize, depth: Any, slip: Any, angle: Any, gravity: float = EARTH_GRAVITY
) -> SoilForces:
    """Return the forces on a wheel in steady motion for a depth, slip ratio and slip angle.

    The depth [m] is that of the lowest point. The slip ratio, -1 to 1, is the rim speed ``u`` minus
    the forward speed ``v_x``, divided by the larger of the two. With the slip angle, less than
    pi/2, the wheel also moves to the right with ``v_x tan(angle)``.
    """
    forward, rim = 1 - ca.fmax(slip, 0), 1 + ca.fmin(slip, 0)
    speeds = rim, forward, forward * ca.tan(angle)
    return forces_at_speeds(soil, size, depth, *speeds, STEADY_CREEP, gravity)


def forces_at_speeds(
    soil: Soil,
    size: WheelSize,
    depth: Any,
    rim: Any,
    forward: Any,
    sideways: Any,
    creep: Any,
    gravity: float = EARTH_GRAVITY,
) -> SoilForces:
    """Return the forces on a wheel for a depth and speeds (8).

    A depth of the lowest point beyond the radius counts as the radius [m]. ``rim`` is the speed of
    the rim at the shear radius relative to the wheel's centre, positive forward; ``forward`` and
    ``sideways`` are the speeds of the centre along the wheel, and across it to the right; below the
    rim speed ``creep`` the shear displacement is reduced [m/s]. ``gravity`` determines the weight
    of the soil that is pushed aside [m/s^2].
    """
    radius, width = size
    relative = ca.fmin(ca.fmax(depth / radius, SMALLEST_DEPTH), 1)
    speeds = rim + forward
    # smooth sign: a wheel that reverses exchanges its entry and exit edges
    direction = speeds / ca.sqrt(speeds**2 + creep**2)
    ahead, behind = (1 + direction) / 2, (1 - direction) / 2  # shares of the edges as entry
    fastest = ca.fmax(ca.fabs(rim), ca.fabs(forward))
    slip = direction * (rim - forward) / ca.sqrt(fastest**2 + creep**2)
    peak_share = soil.peak + soil.peak_rate * ca.fmax(-1, ca.fmin(slip, 1))
    driven = _smooth_size(ca.fmax(0, ca.fmin(slip, 1)) ** 2)
    held_back = ca.fmax(0, direction * (forward - rim))
    skid = _smooth_size((held_back**2 + sideways**2) / (forward**2 + sideways**2 + creep**2))
    exponent = soil.exponent + soil.exponent_slip * driven + soil.exponent_skid * skid  # (9)
    # angles from the lowest point forward (1, 2), without the loss of digits of an arc cosine at
    # small depths
    entry, leaving = (2 * ca.asin(ca.sqrt(k * relative / 2)) for k in (1, soil.exit_depth))
    front, rear = ahead * entry + behind * leaving, -(behind * entry + ahead * leaving)
    peak = direction * peak_share * entry
    # motion of the rim relative to the soil: speeds over that of the rim, and shear moduli (6)
    speed = ca.sqrt(rim**2 + creep**2)
    rolling, ahead_speed, aside_speed = rim / speed, forward / speed, sideways / speed
    angle = ca.atan(sideways / ca.sqrt(forward**2 + creep**2))
    side = ca.tanh(angle / ANGLE_SMOOTHING)
    steep = angle * side  # smooth absolute value
    modulus_along = soil.shear_along + soil.shear_along_rate * steep
    modulus_across = soil.shear_across + soil.shear_across_rate * steep
    shear_radius, area = radius + soil.grouser_height, radius * width
    # soil that the side of the wheel pushes, equation 7
    failure = pi / 4 - soil.friction_angle / 2
    cot = 1 / ca.tan(failure)
    pushing = cot + ca.tan(failure + soil.friction_angle)
    surcharge, weight = cot + cot**2 * ca.tan(soil.friction_angle), soil.density * gravity

    def integrand(theta: Any, stress: Any) -> tuple[Any, Any, Any, Any]:
        """Return normal force, pull, side force and torque per angle (4, 5, 7, 8)."""
        sine, cosine = ca.sin(theta), ca.cos(theta)
        arc = ahead * (front - theta) + behind * (theta - rear)
        chord = ahead * (ca.sin(front) - sine)
        chord += behind * (sine - ca.sin(rear))
        path_along = shear_radius * (arc * rolling - chord * ahead_speed)
        path_across = shear_radius * arc * aside_speed
        strength = soil.cohesion + stress * ca.tan(soil.friction_angle)
        along, across = path_along / modulus_along, path_across / modulus_across
        if soil.coupled_shear:
            # the stress has the direction of the displacement, and at most the strength
            path = ca.sqrt(path_along**2 + path_across**2 + SMALLEST_PATH**2)
            share = -ca.expm1(-ca.sqrt(along**2 + across**2 + SMALLEST_PATH**2)) / path
            along, across = share * path_along, share * path_across
        else:
            along, across = _mobilised(along), _mobilised(across)
        along, across = strength * along, strength * across
        height = ca.fmax(radius * (cosine - ca.cos(entry)), 0)
        pushed = pushing * (soil.cohesion * height + surcharge * weight * height**2 / 2)
        return (
            area * (stress * cosine + along * sine),
            area * (along * cosine - stress * sine),
            -area * across - side * (pushed * (radius - height * cosine)),
            area * shear_radius * along,
        )

    totals = [0, 0, 0, 0]
    for root, factor in zip((POINTS + 1) / 2, WEIGHTS / 2, strict=True):
        point, part = root**2, 2 * root * factor  # from 0 at an edge to 1 at the peak
        # normal stress (3): r (cos theta_e - cos theta_f) as a product loses no digits at the edge
        drop = point * (1 - peak_share) * entry  # entry angle minus theta_e
        lift = 2 * radius * ca.sin(entry - drop / 2) * ca.sin(drop / 2)
        stress = (soil.cohesive_modulus / width + soil.frictional_modulus) * lift**exponent
        for edge in (front, rear):
            share = part * ca.fabs(peak - edge)
            forces = integrand(edge + point * (peak - edge), stress)
            totals = [total + share * force for total, force in zip(totals, forces, strict=True)]
    return SoilForces(*totals)


@lru_cache(maxsize=64)
def static_sinkage(soil: Soil, size: WheelSize, load: float) -> float:
    """Return the depth at which the soil bears a wheel at rest under a normal force [m].

    ModelError is raised if the wheel sinks to its axle.
    """
    depth = ca.SX.sym("depth")
    force = forces_at_speeds(soil, size, depth, 0, 0, 0, STEADY_CREEP).normal
    normal = ca.Function("normal", [depth], [ca.vertcat(force, ca.jacobian(force, depth))])
    most = float(normal(size.radius)[0])
    check_bearing(size, most, load)
    depths = depth_under_load(lambda h: normal(h[None]).full(), size.radius, np.array([load]))
    return float(depths[0])


def check_bearing(size: WheelSize, borne: float, load: float, motion: str = "") -> None:
    """Raise ModelError if soil bears less than a load [N] at the depth of a wheel's radius."""
    if borne < load:
        raise ModelError(
            f"soil: expected a sinkage smaller than the wheel's radius, {size.radius:g} m, found "
            f"that the soil bears only {borne:.4g} N of {load:.4g} N at that depth{motion}; reduce "
            "the load, or increase the wheel's width or radius"
        )


def depth_under_load(
    normal: Callable[[Array], Array], radius: float, load: Array, start: Array | None = None
) -> Array:
    """Return the depths at which soil bears loads, shape (n,) [N]; at most the radius [m].

    ``normal`` returns the normal forces and their derivatives at depths, shape (2, n).
    """
    depth = np.full_like(load, radius / 4) if start is None else start
    low, high = np.zeros_like(load), np.full_like(load, radius)
    for _ in range(DEPTH_STEPS):
        force, stiffness = normal(depth)
        deep = force > load
        low, high = np.where(deep, low, depth), np.where(deep, depth, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            new = depth - (force - load) / stiffness
        # bisection where Newton's step leaves the bracket
        new = np.where((new > low) & (new < high), new, (low + high) / 2)
        is_solved = np.abs(new - depth).max(initial=0.0) < DEPTH_TOLERANCE * radius
        depth = new
        if is_solved:
            break
    return np.where(depth > (1 - 1e-9) * radius, radius, depth)


def _smooth_size(square: Any) -> Any:
    """Return the root of a square, flat at zero and exact where it exceeds five times the width."""
    return ca.sqrt(square + SMALLEST_RATIO**2) * ca.tanh(square / RATIO_SMOOTHING**2)


def _mobilised(path: Any) -> Any:
    """Return ``1 - exp(-path)``, odd and continuously differentiable in the path [1]."""
    # one exponential for each sign of the path: neither overflows, and slope 1 at zero
    return ca.expm1(ca.fmin(path, 0)) - ca.expm1(-ca.fmax(path, 0))


class KnownSoil(NamedTuple):
    """A soil and the publication of its parameters."""

    soil: Soil
    source: str


def _read_soils() -> Iterator[tuple[str, KnownSoil]]:
    """Yield the names and constants of the known soils."""
    for name, row in read_table(__file__, "soils.toml").items():
        source, shear = row.pop("source"), row.pop("shear", None)
        if shear is not None:
            row["friction_angle"] = radians(row.pop("degrees"))
            row |= {"shear_along": shear, "shear_along_rate": 0.0}
            row |= {"shear_across": shear, "shear_across_rate": 0.0}
        yield name, KnownSoil(Soil(**row), source)


SOILS = dict(_read_soils())


def known_soil(name: str) -> Soil:
    """Return a soil of the catalogue by name; ModelError for an unknown name."""
    check_known("soil", [name], SOILS)
    return SOILS[name].soil
