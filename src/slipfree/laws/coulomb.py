"""Coulomb friction, regularised by a creep speed or a slip stiffness.

A wheel that transmits a tangential force slips; the slip grows as the force approaches the friction
limit. The used fraction of the friction is a separate unknown, which keeps the equations well
conditioned at arbitrarily small slip. Beyond the friction limit there is no equilibrium.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar, NamedTuple

import casadi as ca
import numpy as np
from annotated_types import Ge, Gt, Le, Lt, Unit

from slipfree.core.arguments import checked
from slipfree.core.dae import Continuation, Limit
from slipfree.core.errors import ModelError
from slipfree.core.quantities import quantity_label
from slipfree.core.records import Label
from slipfree.core.trajectory import Outcome
from slipfree.laws.protocols import (
    Equations,
    Reaction,
    SlidingContacts,
    quantity_labels,
    wheel_labels,
)
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle

MAX_CREEP = 0.3  # creep speed at which friction is nearly viscous: Newton's method converges [m/s]
CREEP_RATIO = 0.2  # ratio of consecutive creep speeds of the continuation
MAX_EXCESS_SLIP = 1.0  # a motion ends if slip exceeds ten times the rim speed by this [m/s]


SlipStiffness = Annotated[float, Gt(0), Unit("s/m")]


def squared_creep(creep: Any, slip_stiffness: float, friction: Any) -> Any:
    """Return the square of the slip at which friction reaches 71 % of its limit [m^2/s^2]."""
    # the terms of a law without slip stiffness stay as they are
    return creep**2 + ((friction / slip_stiffness) ** 2 if slip_stiffness < math.inf else 0)


class FrictionUnknowns(NamedTuple):
    """Normal forces [N] and used fractions of the friction, along and across the wheels [1]."""

    normal: tuple[Any, ...]
    along: tuple[Any, ...]
    across: tuple[Any, ...]


class OfFriction:
    """Part of a law whose unknowns are normal forces and used fractions of the friction."""

    subject: ClassVar[str]  # beginning of messages

    def check(self, vehicle: Vehicle, terrain: Terrain) -> None:  # noqa: ARG002 - of the protocol
        """Raise ModelError if the ground has no friction coefficient."""
        check_friction(self.subject, terrain)

    def unknowns(self, vehicle: Vehicle) -> FrictionUnknowns:
        """Return the labels of the normal forces and of the used friction."""
        names = "force_normal", "friction_used_along", "friction_used_across"
        return FrictionUnknowns(*(quantity_labels(vehicle, name) for name in names))


@checked
@dataclass(frozen=True)
class Coulomb(OfFriction):
    """Coulomb friction with creep.

    The tangential force on a wheel is ``mu N p - c N s`` with ``p sqrt(|s|^2 + eps^2 + (mu / K)^2)
    + s = 0``, where ``s`` is its slip velocity, ``N`` its normal force and ``p`` the used fraction
    of the friction. Without creep, small slip needs the force ``K N s``.

    Attributes
    ----------
    creep : float
        Slip velocity ``eps`` at which a wheel transmits 71 % of the friction limit. [m/s]
    reserve : float
        Coefficient ``c`` of viscous friction per newton of normal force. If it is positive,
        equilibria with fast slip exist beyond the friction limit. [s/m]
    slip_stiffness : float
        Slip stiffness ``K``: force over normal force and slip velocity. [s/m]

    Raises
    ------
    ModelError
        If a number is outside its bounds.
    """

    creep: Annotated[float, Gt(0), Le(MAX_CREEP), Unit("m/s")] = 1e-4
    reserve: Annotated[float, Ge(0), Lt(math.inf), Unit("s/m")] = 0.0
    slip_stiffness: SlipStiffness = math.inf
    subject: ClassVar = "Coulomb friction"

    def reaction(self, contacts: SlidingContacts, unknowns: FrictionUnknowns) -> Reaction:
        """Return the forces of the ground and the equations of the law's unknowns.

        Parameters
        ----------
        contacts : SlidingContacts
            Slip [m/s], friction [1] and rates of the n wheels, in the symbols of a model.
        unknowns : FrictionUnknowns
            Normal forces [N], and used shares of friction along and across [1], one per wheel.

        Returns
        -------
        Reaction
            Components along, across and normal to each wheel [N],
            the equations of contact and friction, and the continuation from a larger creep speed.
        """
        normal, *used = unknowns
        slips = contacts.along, contacts.across
        along, across = (
            tuple(
                n * (mu * p - self.reserve * s)
                for n, mu, p, s in zip(normal, contacts.friction, parts, slip, strict=True)
            )
            for parts, slip in zip(used, slips, strict=True)
        )
        continuation = creep_continuation(self.creep)
        sizes = [
            ca.sqrt(a**2 + c**2 + squared_creep(continuation.symbol, self.slip_stiffness, mu))
            for a, c, mu in zip(*slips, contacts.friction, strict=True)
        ]
        # the used fraction p stays an unknown: eliminated, -s / size would be stiff in 1 / eps
        friction = [
            p * size + s
            for parts, slip in zip(used, slips, strict=True)
            for p, size, s in zip(parts, sizes, slip, strict=True)
        ]
        return Reaction(
            along,
            across,
            normal,
            Equations(equation_labels(contacts.vehicle), ca.vertcat(*contacts.normal, *friction)),
            () if self.reserve else (no_equilibrium(contacts),),
            continuation,
            discs=tuple(zip(*used, strict=True)),
        )


def creep_continuation(creep: float) -> Continuation:
    """Return the continuation in the creep speed, from nearly viscous friction to a given value."""
    values = [MAX_CREEP]
    while values[-1] > creep:
        values.append(max(values[-1] * CREEP_RATIO, creep))
    return Continuation(ca.SX.sym("creep"), tuple(values))


def check_friction(law: str, terrain: Terrain) -> None:
    """Raise ModelError if a ground has no friction coefficient; ``law`` begins the message."""
    if not terrain.has_friction:
        raise ModelError(
            f"{law}: expected a ground with a coefficient of friction, found none; set 'mu' of the "
            "ground, or 'terrain.friction' in a problem file"
        )


def equation_labels(vehicle: Vehicle) -> tuple[Label, ...]:
    """Return the labels of the equations of contact and friction, one of each kind per wheel."""
    words = "normal velocity of the contact point"
    return (
        *wheel_labels(vehicle, "touching", "m s-1", words),
        *wheel_labels(vehicle, "friction_along", "m s-1", "friction law along the wheel"),
        *wheel_labels(vehicle, "friction_across", "m s-1", "friction law across the wheel"),
    )


def no_equilibrium(contacts: SlidingContacts) -> Limit:
    """Return the limit of the slip velocity: ten times the largest rim speed, plus 1 m/s.

    A wheel slips faster only where friction cannot hold the vehicle: there is no equilibrium.
    """
    driven = [wheel for wheel in contacts.vehicle.wheels if wheel.driven]
    fastest, most = ca.SX(0), ca.SX(0)
    for rate, wheel in zip(contacts.driven, driven, strict=True):
        fastest = ca.fmax(fastest, ca.fabs(rate) * wheel.radius)
    for slip in zip(contacts.along, contacts.across, contacts.normal, strict=True):
        most = ca.fmax(most, ca.norm_2(ca.vertcat(*slip)))
    label = quantity_label("no_equilibrium")
    excess, outcome = most - 10 * fastest, Outcome.NO_EQUILIBRIUM
    return Limit(label, excess, -np.inf, MAX_EXCESS_SLIP, contacts.diagnose, outcome)
