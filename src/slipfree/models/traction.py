"""How a vehicle moves when friction decides: equilibrium with a law of friction at every wheel.

Contact forces are Coulomb friction, regularised: a wheel that transmits a tangential force slips,
by the more the nearer the force comes to what friction gives. The friction that is used is an
unknown of its own, which keeps the equations well conditioned for any small slip. Inertia is left
out, so that there may be no motion at all: beyond what friction can hold there is no equilibrium.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.closure import ContactFrame
from slipfree.dae import Continuation, Limit
from slipfree.errors import ModelError
from slipfree.lookups import LookupTable
from slipfree.models.friction_feasibility import diagnosis
from slipfree.models.records import Algebraic, Configuration, Forces, Inputs, Rates
from slipfree.models.statics import Mechanics, equilibrium
from slipfree.models.tip_over import tip_over_margin
from slipfree.records import Array, Label, pack
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle

EASIEST = 0.3  # creep at which friction is nearly viscous, so that Newton's method converges [m/s]
EASE = 0.2  # factor from one creep to the next
RUNAWAY = 1.0  # slip beyond ten times the speed of the fastest rim that is no creep [m/s]


class Traction(NamedTuple):
    """The law of friction.

    Attributes
    ----------
    creep : float
        Slip at which a wheel transmits 71 % of what friction gives, ``eps``. [m/s]
    reserve : float
        Viscous friction for each newton of normal force, ``c``: what holds the vehicle beyond its
        friction, at a price in slip. [s/m]
    """

    creep: float = 1e-4
    reserve: float = 0.0


def check_traction(vehicle: Vehicle, terrain: Terrain, law: Traction) -> None:
    """Raise ModelError if vehicle and ground do not suit the law of friction."""
    if not vehicle.mass:
        raise ModelError(f"traction: {vehicle.name} has no mass; give its platform or wheels one")
    if not terrain.has_friction:
        raise ModelError("traction: the ground has no friction; give it a coefficient (mu)")
    if not 0 < law.creep <= EASIEST:
        raise ModelError(
            f"traction: expected a creep above 0 and up to {EASIEST:g} m/s, found {law.creep}"
        )
    if not 0 <= law.reserve < np.inf:
        raise ModelError(f"traction: expected a reserve of zero or more, found {law.reserve} s/m")


class FrictionLaw(NamedTuple):
    """What a law of friction makes of a model.

    Attributes
    ----------
    equations : SX, shape (n, 1)
        For rates, normal forces and used friction.
    forces : Forces
        Of the ground on the wheels, by these unknowns. [N]
    limits : tuple of Limit
        Where there is no equilibrium; with a reserve there always is one.
    continuation : Continuation
        The creep, from viscous to Coulomb friction.
    """

    equations: ca.SX
    forces: Forces
    limits: tuple[Limit, ...]
    continuation: Continuation


def friction_law(
    vehicle: Vehicle,
    law: Traction,
    parts: Mechanics,
    contacts: Sequence[ContactFrame],
    slips: Sequence[ca.SX],
    state: tuple[Configuration, Algebraic, Inputs],
    lookups: LookupTable,
) -> FrictionLaw:
    """Return what the law of friction makes of a model of the given symbols."""
    x, z, u = state
    margin = tip_over_margin(vehicle, x, z.position, contacts)
    why = diagnosis(parts, contacts, margin, x, z, lookups)
    values = [EASIEST]
    while values[-1] > law.creep:
        values.append(max(values[-1] * EASE, law.creep))
    eased = Continuation(ca.SX.sym("creep"), tuple(values))
    return FrictionLaw(
        traction_balance(parts, z.rates, u, law, eased.symbol),
        friction_forces(parts, z.rates, u, law),
        () if law.reserve else (no_equilibrium(vehicle, slips, u, why),),
        eased,
    )


def friction_forces(parts: Mechanics, rates: Rates, u: Inputs, law: Traction) -> Forces:
    """Return the forces of the ground, as far as the law gives them, by the unknowns. [N]."""
    slip = parts.free @ pack(rates.motion) + parts.driven @ pack(u)
    along, across = [], []
    for k, (n, mu) in enumerate(zip(rates.normal, parts.friction, strict=True)):
        along.append(n * (mu * rates.along[k] - law.reserve * slip[3 * k]))
        across.append(n * (mu * rates.across[k] - law.reserve * slip[3 * k + 1]))
    return Forces(tuple(along), tuple(across), rates.normal)


def traction_balance(
    parts: Mechanics, rates: Rates, u: Inputs, law: Traction, creep: ca.SX
) -> ca.SX:
    """Return the equations for rates, normal forces and used friction.

    ``A' lambda + Q = 0``; ``n . s = 0``; ``p sqrt(|s|^2 + eps^2) + s = 0`` with the tangential slip
    ``s`` and force ``mu N p - c N s``.
    """
    forces = friction_forces(parts, rates, u, law).column
    slip = parts.free @ pack(rates.motion) + parts.driven @ pack(u)
    sizes = [
        ca.sqrt(slip[3 * k] ** 2 + slip[3 * k + 1] ** 2 + creep**2)
        for k in range(len(rates.normal))
    ]
    laws = [
        used * size + slip[3 * k + offset]
        for offset, parts_used in enumerate((rates.along, rates.across))
        for k, (used, size) in enumerate(zip(parts_used, sizes, strict=True))
    ]
    touching = [slip[3 * k + 2] for k in range(len(rates.normal))]
    return ca.vertcat(equilibrium(parts, forces), *touching, *laws)


def no_equilibrium(
    vehicle: Vehicle, slips: Sequence[ca.SX], u: Inputs, why: Callable[[Array, Array], str]
) -> Limit:
    """Return the limit beyond which slip runs away, since friction does not hold the vehicle."""
    driven = [wheel for wheel in vehicle.wheels if wheel.driven]
    fastest, most = ca.SX(0), ca.SX(0)
    for rate, wheel in zip(u.wheels, driven, strict=True):
        fastest = ca.fmax(fastest, ca.fabs(rate) * wheel.radius)
    for slip in slips:
        most = ca.fmax(most, ca.norm_2(slip))
    words = "slip of the fastest sliding wheel beyond ten times the fastest rim"
    label = Label("no_equilibrium", "m s-1", words)
    return Limit(label, most - 10 * fastest, -np.inf, RUNAWAY, why)
