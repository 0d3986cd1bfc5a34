"""Coulomb friction, regularised by a creep speed.

A wheel that transmits a tangential force slips, the more the closer the force is to the friction
limit. The part of the friction that is used is an unknown of its own, which keeps the equations
well conditioned at any small slip. Beyond the friction limit there is no equilibrium.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import casadi as ca
import numpy as np
from annotated_types import Ge, Gt, Le, Lt, Unit, doc

from slipfree.dae import Continuation, Limit
from slipfree.errors import ModelError
from slipfree.laws.protocols import (
    NORMAL,
    Equations,
    Reaction,
    SlidingContacts,
    check_bounds,
    wheel_labels,
)
from slipfree.outcome import Outcome
from slipfree.records import Label
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle

EASIEST_CREEP = 0.3  # at which friction is nearly viscous, so that Newton's method converges [m/s]
CREEP_RATIO = 0.2  # of one creep of the continuation to the one before
RUNAWAY = 1.0  # slip above ten times the speed of the fastest rim that is no creep [m/s]


class FrictionUnknowns(NamedTuple):
    """Normal forces [N], and the parts of the friction that are used along and across [1]."""

    normal: tuple[Any, ...]
    along: tuple[Any, ...]
    across: tuple[Any, ...]


@dataclass(frozen=True)
class Coulomb:
    """Coulomb friction with creep.

    The tangential force on a wheel is ``mu N p - c N s`` with ``p sqrt(|s|^2 + eps^2) + s = 0``,
    where ``s`` is its slip velocity, ``N`` its normal force and ``p`` the part of the friction
    that is used.

    Attributes
    ----------
    creep : float
        Slip at which a wheel transmits 71 % of the friction limit, ``eps``. [m/s]
    reserve : float
        Viscous friction for each newton of normal force, ``c``: it holds the vehicle beyond the
        friction limit, at the cost of slip. [s/m]

    Raises
    ------
    ModelError
        If creep or reserve is out of its range.
    """

    creep: Annotated[
        float,
        Gt(0),
        Le(EASIEST_CREEP),
        Unit("m/s"),
        doc("slip at which a wheel transmits 71 % of the friction limit"),
    ] = 1e-4
    reserve: Annotated[
        float,
        Ge(0),
        Lt(math.inf),
        Unit("s/m"),
        doc("viscous friction for each newton of normal force"),
    ] = 0.0

    def __post_init__(self) -> None:
        check_bounds(self)

    def check(self, vehicle: Vehicle, terrain: Terrain) -> None:  # noqa: ARG002 - of the protocol
        """Raise ModelError if the ground has no friction."""
        if not terrain.has_friction:
            raise ModelError(
                "Coulomb friction: expected a ground with a coefficient of friction, found none; "
                "give the ground one (mu, terrain.friction)"
            )

    def unknowns(self, vehicle: Vehicle) -> FrictionUnknowns:
        """Return the labels of normal forces and used friction."""
        used = [
            wheel_labels(
                vehicle,
                f"friction_used_{axis}",
                "1",
                f"part of the friction that is used {axis} the wheel",
            )
            for axis in ("along", "across")
        ]
        return FrictionUnknowns(wheel_labels(vehicle, *NORMAL), *used)

    def reaction(self, contacts: SlidingContacts, unknowns: FrictionUnknowns) -> Reaction:
        """Return friction forces, and the equations of contact and friction."""
        normal, *used = unknowns
        slips = contacts.along, contacts.across
        along, across = (
            tuple(
                n * (mu * p - self.reserve * s)
                for n, mu, p, s in zip(normal, contacts.friction, parts, slip, strict=True)
            )
            for parts, slip in zip(used, slips, strict=True)
        )
        continuation = self._continuation()
        sizes = [ca.sqrt(a**2 + c**2 + continuation.symbol**2) for a, c in zip(*slips, strict=True)]
        friction = [
            p * size + s
            for parts, slip in zip(used, slips, strict=True)
            for p, size, s in zip(parts, sizes, slip, strict=True)
        ]
        return Reaction(
            along,
            across,
            normal,
            Equations(_equation_labels(contacts.vehicle), ca.vertcat(*contacts.normal, *friction)),
            () if self.reserve else (no_equilibrium(contacts),),
            continuation,
        )

    def _continuation(self) -> Continuation:
        """Return the creep from nearly viscous to Coulomb friction."""
        values = [EASIEST_CREEP]
        while values[-1] > self.creep:
            values.append(max(values[-1] * CREEP_RATIO, self.creep))
        return Continuation(ca.SX.sym("creep"), tuple(values))


def _equation_labels(vehicle: Vehicle) -> tuple[Label, ...]:
    words = "normal velocity of the contact point"
    return (
        *wheel_labels(vehicle, "touching", "m s-1", words),
        *wheel_labels(vehicle, "friction_along", "m s-1", "law of friction along the wheel"),
        *wheel_labels(vehicle, "friction_across", "m s-1", "law of friction across the wheel"),
    )


def no_equilibrium(contacts: SlidingContacts) -> Limit:
    """Return the limit of the slip beyond which friction does not hold the vehicle."""
    driven = [wheel for wheel in contacts.vehicle.wheels if wheel.driven]
    fastest, most = ca.SX(0), ca.SX(0)
    for rate, wheel in zip(contacts.driven, driven, strict=True):
        fastest = ca.fmax(fastest, ca.fabs(rate) * wheel.radius)
    for slip in zip(contacts.along, contacts.across, contacts.normal, strict=True):
        most = ca.fmax(most, ca.norm_2(ca.vertcat(*slip)))
    words = "slip of the fastest sliding wheel beyond ten times the fastest rim"
    label = Label("no_equilibrium", "m s-1", words)
    excess, outcome = most - 10 * fastest, Outcome.NO_EQUILIBRIUM
    return Limit(label, excess, -np.inf, RUNAWAY, contacts.diagnose, outcome)
