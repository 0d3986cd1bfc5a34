"""Protocols of slip laws and wheel-ground laws, and the records that laws and models exchange."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple, Protocol, runtime_checkable

import casadi as ca

from slipfree.contact.closure import ContactFrame
from slipfree.contact.touch import Touch
from slipfree.core.dae import Continuation, Limit
from slipfree.core.quantities import quantity_label
from slipfree.core.records import Array, Label
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle, Wheel


class Equations(NamedTuple):
    """Residuals and their labels."""

    labels: tuple[Label, ...]  # name, unit and description of each residual
    rows: ca.SX  # the residuals, in the labels' units, shape (n, 1)
    # matrix and right side of linear equations with the same solution, if the law has a form that
    # takes fewer operations than the Jacobian of the residuals, shapes (n, n) and (n, 1), or None
    linear: tuple[ca.SX, ca.SX] | None = None


class Motion(NamedTuple):
    """Rates of a vehicle and the resulting slip, in the symbols of a model."""

    vehicle: Vehicle  # the vehicle, with n_wheels wheels
    # contact frames of the wheels, in local coordinates (:ref:`local-and-map-coordinates`)
    contacts: tuple[ContactFrame, ...]
    # slip velocities of the wheels in fixed axes; linear in the rates, shape (3, 1) [m/s]
    slips: tuple[ca.SX, ...]
    rates: ca.SX  # rates that are not commanded, shape (n_rates, 1) [m/s, rad/s]
    labels: tuple[Label, ...]  # labels of these rates
    # constraints of all slip laws, linear in the rates. With exact contact: no wheel moves along
    # the ground's normal. With pressed wheels: height, inclination and suspension relax
    # (`slipfree.models.kinematics`)
    constraints: Equations
    # weight of each wheel's slip: about one on the ground, about zero in the air [1]
    weights: tuple[Any, ...]
    # derivatives of the slip components along, across and normal to every wheel with respect to the
    # rates, and the part that does not depend on the rates, shapes (3 n_wheels, n_rates) and (3
    # n_wheels, 1)
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
    """Wheels that slide over the ground, in the symbols of a quasi-static model."""

    vehicle: Vehicle  # the vehicle, with n_wheels wheels
    # along, across, normal: components of the slip velocity of each wheel along it, across it
    # and along the ground's normal [m/s]
    along: tuple[ca.SX, ...]
    across: tuple[ca.SX, ...]
    normal: tuple[ca.SX, ...]
    friction: tuple[ca.SX, ...]  # coefficient of friction at each wheel [1]
    driven: tuple[ca.SX, ...]  # rates of the driven wheels [rad/s]
    # angular velocities of all wheels about their axles, absolute, positive forward [rad/s]
    spins: tuple[ca.SX, ...]
    places: tuple[ca.SX, ...]  # contact points, x and y in map coordinates, shape (2, 1) [m]
    # ``diagnose(x, z)`` returns the reason why a state has no equilibrium, as text; empty if
    # friction is not the reason
    diagnose: Callable[[Array, Array], str]


class Reaction(NamedTuple):
    """Forces of the ground on the wheels, and the equations of the law's unknowns."""

    # along, across, normal: components of the force on each wheel along it, across it and
    # along the ground's normal [N]
    along: tuple[ca.SX, ...]
    across: tuple[ca.SX, ...]
    normal: tuple[ca.SX, ...]
    equations: Equations  # one equation for each unknown of the law
    limits: tuple[Limit, ...] = ()  # limits of the law's validity
    # continuation from a simpler law to this law, for the initial conditions
    continuation: Continuation | None = None
    # moments of the ground about the axles, positive against forward rolling; empty if these are
    # the moments of the forces at the contact points [N m]
    torques: tuple[ca.SX, ...] = ()
    discs: tuple[tuple[ca.SX, ca.SX], ...] = ()  # pairs of unknowns in the unit disc, as in `Dae`


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
    """Contact and motion of a wheel of a dynamic model."""

    wheel: Wheel  # the wheel, with a static depth
    touch: Touch  # contact with the ground
    # velocity of the wheel's material point at the contact, in fixed axes, shape (3, 1) [m/s]
    slip: ca.SX
    # angular velocity about the axle relative to fixed axes, positive forward, shape (1, 1) [rad/s]
    spin: ca.SX
    center: ca.SX  # centre of the wheel, shape (3, 1) [m]
    place: ca.SX  # contact point, x and y in map coordinates, shape (2, 1) [m]
    share: float  # share of the vehicle's weight [N]
    gravity: float  # gravitational acceleration [m/s^2]


class GroundForce(NamedTuple):
    """Force of the ground on a wheel at its contact point, and its moment about the axle."""

    normal: ca.SX  # component along the ground's normal, shape (1, 1) [N]
    tangential: ca.SX  # friction force, in fixed axes, shape (3, 1) [N]
    elastic: ca.SX  # elastic part of the normal force, without damping, shape (1, 1) [N]
    # moment about the axle in addition to that of the force, positive against forward rolling,
    # shape (1, 1) [N m]
    moment: ca.SX


class BodyTouch(NamedTuple):
    """Contact of a point of a vehicle's body with the ground, in dynamics."""

    gap: ca.SX  # distance from the ground, negative below it, shape (1, 1) [m]
    # normal and slip: direction of the gradient of the gap, which is the unit normal of a plane
    # ground, upward; velocity of the point, in fixed axes, shape (3, 1) [1, m/s]
    normal: ca.SX
    slip: ca.SX
    friction: ca.SX  # coefficient of friction of the ground, shape (1, 1) [1]
    # weight of the vehicle times the norm of the gap's gradient, which is one on a plane [N]
    weight: float | ca.SX
    gravity: float  # gravitational acceleration [m/s^2]


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


def quantity_labels(vehicle: Vehicle, name: str) -> tuple[Label, ...]:
    """Return the labels of a quantity of `slipfree.core.quantities`, one per wheel."""
    return tuple(quantity_label(name, wheel.name) for wheel in vehicle.wheels)


def wheel_limits(
    vehicle: Vehicle,
    name: str,
    values: Iterable[ca.SX],
    lower: float,
    upper: float,
    **texts: object,
) -> Iterator[Limit]:
    """Yield the limits of a quantity of `slipfree.core.quantities`, with a value per wheel."""
    for wheel, value in zip(vehicle.wheels, values, strict=True):
        yield Limit(quantity_label(name, wheel.name, **texts), value, lower, upper)


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
