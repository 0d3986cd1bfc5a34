"""Least slip: rates that minimise the sum of squared slip velocities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca

from slipfree.laws.protocols import Equations, Motion, wheel_labels
from slipfree.records import Label, pack
from slipfree.vehicle.tree import Vehicle


class Multipliers(NamedTuple):
    """Lagrange multipliers of the contact conditions, one per wheel [m/s]."""

    multipliers: tuple[Any, ...]


@dataclass(frozen=True)
class LeastSlip:
    """Least slip that the contacts allow; suits every vehicle.

    The rates are the stationary point of ``L = 1/2 sum s.s + sum lambda n.s``: they minimise the
    sum of squares of the slip velocities ``s`` while no wheel leaves or enters the ground. Since
    ``n.s`` vanishes, only the tangential slip counts. On real ground the motion also depends on
    friction: this law gives a lower bound of the slip, not a prediction.
    """

    def check(self, vehicle: Vehicle) -> None:
        """Accept every vehicle."""

    def unknowns(self, vehicle: Vehicle) -> Multipliers:
        """Return the labels of the multipliers."""
        words = "multiplier of the contact in the least-slip condition"
        return Multipliers(wheel_labels(vehicle, "multiplier", "m s-1", words))

    def equations(self, motion: Motion, unknowns: Multipliers) -> Equations:
        """Return the stationarity conditions with respect to rates and multipliers."""
        cost = ca.SX(sum(0.5 * ca.sumsqr(slip) for slip in motion.slips))
        return stationarity(cost, motion, unknowns, self.unknowns(motion.vehicle))


def stationarity(
    cost: ca.SX, motion: Motion, unknowns: Multipliers, labels: Multipliers
) -> Equations:
    """Return the conditions for the rates of least cost at which all wheels keep contact.

    Parameters
    ----------
    cost : SX, shape (1, 1)
        Function of the slip velocities. [m^2/s^2]
    motion : Motion
        Rates and slip velocities.
    unknowns, labels : Multipliers
        Multipliers of the contacts and their labels.
    """
    lagrangian = cost
    for slip, contact, multiplier in zip(
        motion.slips, motion.contacts, unknowns.multipliers, strict=True
    ):
        lagrangian += multiplier * ca.dot(contact.normal, slip)
    return Equations(
        tuple(
            Label("least_slip", slip_unit(label.unit), f"least-slip condition for {label.full}")
            for label in (*motion.labels, *labels.multipliers)
        ),
        ca.gradient(lagrangian, ca.vertcat(motion.rates, pack(unknowns))),
    )


def slip_unit(unit: str) -> str:
    """Return the unit of the derivative of a squared slip velocity with respect to a rate."""
    return {"m s-1": "m s-1", "rad s-1": "m2 s-1", "m2 s-1": "rad s-1"}[unit]
