"""Protocols of slip laws and wheel-ground laws, and the records that laws and models exchange."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import casadi as ca

from slipfree.contact.closure import ContactFrame
from slipfree.contact.touch import Touch
from slipfree.core.dae import Continuation, Limit
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Label
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle
from slipfree.vehicle.wheel import Wheel

ALONG = "force_along", "N", "force of the ground on the wheel along it, positive forward"
ACROSS = "force_across", "N", "force of the ground on the wheel across it, positive to the right"
NORMAL = "force_normal", "N", "force of the ground on the wheel along the normal"


class Equations(NamedTuple):
    """Residuals and their labels.

    Attributes
    ----------
    labels : tuple of Label
        Name, unit and description of each residual.
    rows : SX, shape (n, 1)
        The residuals, in the labels' units.
    linear : tuple of two SX, shapes (n, n) and (n, 1), or None
        Matrix and right side of linear equations with the same solution, if the law has a form
        that takes fewer operations than the Jacobian of the residuals.
    """

    labels: tuple[Label, ...]
    rows: ca.SX
    linear: tuple[ca.SX, ca.SX] | None = None


class Motion(NamedTuple):
    """Rates of a vehicle and the resulting slip, in the symbols of a model.

    Attributes
    ----------
    vehicle : Vehicle
        The vehicle, with n_wheels wheels.
    contacts : tuple of ContactFrame
        Contact frames of the wheels, in local coordinates (:ref:`local-and-map-coordinates`).
    slips : tuple of SX, shape (3, 1)
        Slip velocities of the wheels in fixed axes; linear in the rates. [m/s]
    rates : SX, shape (n_rates, 1)
        Rates that are not commanded. [m/s, rad/s]
    labels : tuple of Label
        Labels of these rates.
    constraints : Equations
        Constraints of all slip laws, linear in the rates. With exact contact: no wheel moves along
        the ground's normal. With pressed wheels: height, inclination and suspension relax
        (`slipfree.models.kinematics`).
    weights : tuple of SX or float
        Weight of each wheel's slip: about one on the ground, about zero in the air. [1]
    components : tuple of two SX, shapes (3 n_wheels, n_rates) and (3 n_wheels, 1)
        Derivatives of the slip components along, across and normal to every wheel with respect to
        the rates, and the part that does not depend on the rates.
    """

    vehicle: Vehicle
    contacts: tuple[ContactFrame, ...]
    slips: tuple[ca.SX, ...]
    rates: ca.SX
    labels: tuple[Label, ...]
    constraints: Equations
    weights: tuple[Any, ...]
    components: tuple[ca.SX, ca.SX]


@runtime_checkable
class SlipLaw(Protocol):
    """Condition on the slip velocities of a kinematic model.

    The unknowns of a law are a ``NamedTuple`` of tuples, or an empty tuple. There is one equation
    for each rate and for each unknown.
    """

    def check(self, vehicle: Vehicle) -> None:
        """Raise ModelError if the law cannot be used with the vehicle."""

    def unknowns(self, vehicle: Vehicle, constraints: tuple[Label, ...]) -> Any:
        """Return the labels of the unknowns that the law adds to the rates."""

    def equations(self, motion: Motion, unknowns: Any) -> Equations:
        """Return the equations of the rates and of the law's unknowns."""


class SlidingContacts(NamedTuple):
    """Wheels that slide over the ground, in the symbols of a quasi-static model.

    Attributes
    ----------
    vehicle : Vehicle
        The vehicle, with n_wheels wheels.
    along, across, normal : tuple of SX
        Components of the slip velocity of each wheel along it, across it and along the ground's
        normal. [m/s]
    friction : tuple of SX
        Coefficient of friction at each wheel. [1]
    driven : tuple of SX
        Rates of the driven wheels. [rad/s]
    spins : tuple of SX
        Angular velocities of all wheels about their axles relative to fixed axes, positive forward.
        [rad/s]
    places : tuple of SX, shape (2, 1)
        Contact points, x and y in map coordinates. [m]
    diagnose : callable
        ``diagnose(x, z)`` returns the reason why a state has no equilibrium, as text; empty if
        friction is not the reason.
    """

    vehicle: Vehicle
    along: tuple[ca.SX, ...]
    across: tuple[ca.SX, ...]
    normal: tuple[ca.SX, ...]
    friction: tuple[ca.SX, ...]
    driven: tuple[ca.SX, ...]
    spins: tuple[ca.SX, ...]
    places: tuple[ca.SX, ...]
    diagnose: Callable[[Array, Array], str]


class Reaction(NamedTuple):
    """Forces of the ground on the wheels, and the equations of the law's unknowns.

    Attributes
    ----------
    along, across, normal : tuple of SX
        Components of the force on each wheel along it, across it and along the ground's normal.
        [N]
    equations : Equations
        One equation for each unknown of the law.
    limits : tuple of Limit
        Limits of the law's validity.
    continuation : Continuation or None
        Continuation from a simpler law to this law, for the initial conditions.
    torques : tuple of SX
        Moments of the ground about the axles, positive against forward rolling; empty if these are
        the moments of the forces at the contact points. [N m]
    discs : tuple of pairs of SX
        Pairs of unknowns in the unit disc, as in `Dae`.
    """

    along: tuple[ca.SX, ...]
    across: tuple[ca.SX, ...]
    normal: tuple[ca.SX, ...]
    equations: Equations
    limits: tuple[Limit, ...] = ()
    continuation: Continuation | None = None
    torques: tuple[ca.SX, ...] = ()
    discs: tuple[tuple[ca.SX, ca.SX], ...] = ()


@runtime_checkable
class GroundLaw(Protocol):
    """Forces of the ground on the wheels of a quasi-static model.

    The unknowns of a law are a ``NamedTuple`` of tuples. The model adds the equilibrium of the
    vehicle, one equation for each rate.
    """

    def check(self, vehicle: Vehicle, terrain: Terrain) -> None:
        """Raise ModelError if the law cannot be used with the vehicle or the ground."""

    def unknowns(self, vehicle: Vehicle) -> Any:
        """Return the labels of the unknowns that the law adds to the rates."""

    def reaction(self, contacts: SlidingContacts, unknowns: Any) -> Reaction:
        """Return the forces of the ground and the equations of the law's unknowns."""


class WheelContact(NamedTuple):
    """Contact and motion of a wheel of a dynamic model.

    Attributes
    ----------
    wheel : Wheel
        The wheel, with a static depth.
    touch : Touch
        Contact with the ground.
    slip : SX, shape (3, 1)
        Velocity of the wheel's material point at the contact, in fixed axes. [m/s]
    spin : SX, shape (1, 1)
        Angular velocity about the axle relative to fixed axes, positive forward. [rad/s]
    center : SX, shape (3, 1)
        Centre of the wheel. [m]
    place : SX, shape (2, 1)
        Contact point, x and y in map coordinates. [m]
    share : float
        Share of the vehicle's weight. [N]
    gravity : float
        Gravitational acceleration. [m/s^2]
    """

    wheel: Wheel
    touch: Touch
    slip: ca.SX
    spin: ca.SX
    center: ca.SX
    place: ca.SX
    share: float
    gravity: float


class GroundForce(NamedTuple):
    """Force of the ground on a wheel at its contact point, and its moment about the axle.

    Attributes
    ----------
    normal : SX, shape (1, 1)
        Component along the ground's normal. [N]
    tangential : SX, shape (3, 1)
        Friction force, in fixed axes. [N]
    elastic : SX, shape (1, 1)
        Elastic part of the normal force, without damping. [N]
    moment : SX, shape (1, 1)
        Moment about the axle in addition to that of the force, positive against forward rolling.
        [N m]
    """

    normal: ca.SX
    tangential: ca.SX
    elastic: ca.SX
    moment: ca.SX


class BodyTouch(NamedTuple):
    """Contact of a point of a vehicle's body with the ground, in dynamics.

    Attributes
    ----------
    gap : SX, shape (1, 1)
        Distance from the ground, negative below it. [m]
    normal, slip : SX, shape (3, 1)
        Direction of the gradient of the gap, which is the unit normal of a plane ground, upward;
        velocity of the point, in fixed axes. [1, m/s]
    friction : SX, shape (1, 1)
        Coefficient of friction of the ground. [1]
    weight : float or SX, shape (1, 1)
        Weight of the vehicle times the norm of the gradient of the gap, which is one on a plane
        ground. [N]
    gravity : float
        Gravitational acceleration. [m/s^2]
    """

    gap: ca.SX
    normal: ca.SX
    slip: ca.SX
    friction: ca.SX
    weight: float | ca.SX
    gravity: float


@runtime_checkable
class BodyLaw(Protocol):
    """Part of a contact law with which bodies of a vehicle may bear load.

    With other laws, a motion ends where a body touches the ground.
    """

    @property
    def bears_bodies(self) -> bool:
        """Whether bodies bear load; otherwise a motion ends where one touches the ground."""

    def body_force(self, touch: BodyTouch) -> GroundForce:
        """Return the force of the ground on a point of a body, without moment."""


@runtime_checkable
class ContactLaw(Protocol):
    """Forces of the ground on the wheels of a dynamic model, as functions of depth and motion."""

    def check(self, vehicle: Vehicle, terrain: Terrain) -> None:
        """Raise ModelError if the law cannot be used with the vehicle or the ground."""

    def static_depth(self, wheel: Wheel, load: float) -> float:
        """Return the depth of a wheel at rest under a load [m]; `Wheel.static_depth` is set."""

    def max_depth(self, wheel: Wheel) -> float:
        """Return the depth up to which the law is valid; infinity without limit [m]."""

    def force(self, contact: WheelContact) -> GroundForce:
        """Return force and moment of the ground on a wheel."""


def wheel_labels(vehicle: Vehicle, name: str, unit: str, words: str) -> tuple[Label, ...]:
    """Return the labels of a quantity, one per wheel."""
    return tuple(Label(name, unit, words, wheel.name) for wheel in vehicle.wheels)


def component_labels(vehicle: Vehicle, name: str, unit: str, words: str) -> tuple[Label, ...]:
    """Return labels of the x, y and z components of a vector of each wheel, wheel by wheel."""
    return tuple(
        Label(name, unit, f"{axis} component of the {words}", wheel.name)
        for wheel in vehicle.wheels
        for axis in "xyz"
    )


def check_law(law: object, protocol: type, expected: str) -> None:
    """Raise ModelError if an argument does not implement the protocol of a law.

    The message begins with ``expected``, the name of the argument and the expected object.
    """
    if not isinstance(law, protocol):
        raise ModelError(f"{expected}, found {law!r}; give an instance of such a class")
    if isinstance(law, type):
        raise ModelError(f"{expected}, found the class {law.__name__}; call it: {law.__name__}()")
