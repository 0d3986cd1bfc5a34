"""Least slip: rates that minimise the sum of squared slip velocities."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import casadi as ca

from slipfree.core.records import Label, pack
from slipfree.laws.protocols import Equations, Motion
from slipfree.vehicle.tree import Vehicle


class Multipliers(NamedTuple):
    """Lagrange multipliers of the constraints on the rates."""

    multipliers: tuple[Any, ...]


@dataclass(frozen=True)
class LeastSlip:
    """Law of least slip under the contact constraints, for every vehicle.

    The rates are the stationary point of ``L = 1/2 sum s.s + sum lambda n.s``: they minimise the
    sum of squares of the slip velocities ``s`` while no wheel leaves or enters the ground. Since
    ``n.s`` vanishes, only the tangential slip matters. For pressed wheels, the equations of
    relaxation replace ``n.s = 0``, and the slip of wheels in the air has almost no weight. On real
    ground the motion also depends on friction: this law gives a lower bound of the slip, not a
    prediction.
    """

    def check(self, vehicle: Vehicle) -> None:
        """Accept every vehicle: the law has a solution for any numbers of joints and wheels."""

    def unknowns(self, vehicle: Vehicle, constraints: tuple[Label, ...]) -> Multipliers:  # noqa: ARG002
        """Return the labels of the Lagrange multipliers.

        Parameters
        ----------
        vehicle : Vehicle
            Not used.
        constraints : tuple of Label
            Labels of the constraints on the rates.

        Returns
        -------
        Multipliers
            Labels, one for each constraint; units are those of squared slip over the constraint.
        """
        units = {"m s-1": "m s-1", "1": "m2 s-2", "m": "m s-2"}
        return Multipliers(
            tuple(
                Label(
                    "multiplier" if each.wheel else f"multiplier_{each.name}",
                    units[each.unit],
                    f"multiplier of the {each.words}",
                    each.wheel,
                )
                for each in constraints
            )
        )

    def equations(self, motion: Motion, unknowns: Multipliers) -> Equations:
        """Return the conditions for the least sum of squared slips under the constraints.

        Parameters
        ----------
        motion : Motion
            Rates of a vehicle, and the slips (3, 1) [m/s] that are linear in them.
        unknowns : Multipliers
            Multipliers of ``motion.constraints``.

        Returns
        -------
        Equations
            Derivatives by the rates, then by the multipliers, with their linear form.
        """
        pairs = zip(motion.weights, motion.slips, strict=True)
        cost = ca.SX(sum(0.5 * w * ca.sumsqr(s) for w, s in pairs))
        return stationarity(cost, motion, unknowns)._replace(linear=_linear_form(motion))


def stationarity(cost: ca.SX, motion: Motion, unknowns: Multipliers) -> Equations:
    """Return the stationarity conditions of rates of least cost under the constraints.

    The cost is a function of the slip velocities [m^2/s^2]; ``unknowns`` are the multipliers.
    """
    names, rows = motion.constraints[:2]
    lagrangian = cost + sum(
        multiplier * row
        for multiplier, row in zip(unknowns.multipliers, ca.vertsplit(rows), strict=True)
    )
    units = [slip_unit(label.unit) for label in motion.labels] + [label.unit for label in names]
    return Equations(
        tuple(
            Label("least_slip", unit, f"least-slip condition for {label.full}")
            for unit, label in zip(units, (*motion.labels, *names), strict=True)
        ),
        ca.gradient(lagrangian, ca.vertcat(motion.rates, pack(unknowns))),
    )


def _linear_form(motion: Motion) -> tuple[ca.SX, ca.SX]:
    """Return the stationarity conditions as linear equations of rates and multipliers.

    With the slip components ``A w + b`` in the ground and the constraints ``C w + d = 0``, they are
    ``A'W A w + C' lambda = -A'W b`` and ``C w = -d``: a third of the operations of the Hessian of
    the Lagrangian.
    """
    matrix, offset = motion.components
    tangential = [k for k in range(offset.numel()) if k % 3 != 2]
    a, b, rows = matrix[tangential, :], offset[tangential], motion.constraints.rows
    weighted = ca.SX(a)
    for k, weight in enumerate(motion.weights):
        weighted[2 * k : 2 * k + 2, :] *= weight
    c, d = motion.constraints.linear or linear_form(rows, motion.rates)
    n = rows.numel()
    hessian = ca.tril2symm(ca.tril(weighted.T @ a))  # equal entries are one expression
    return (ca.blockcat([[hessian, c.T], [c, ca.SX(n, n)]]), -ca.vertcat(weighted.T @ b, d))


def linear_form(rows: ca.SX, rates: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return matrix and constant of expressions that are linear in rates."""
    return ca.jacobian(rows, rates), ca.substitute(rows, rates, ca.SX.zeros(rates.shape))


def slip_unit(unit: str) -> str:
    """Return the unit of the derivative of squared slip velocity, for the unit of a variable."""
    return {
        "m s-1": "m s-1",
        "rad s-1": "m2 s-1",
        "m2 s-1": "rad s-1",
        "m2 s-2": "1",
        "m s-2": "m",
    }[unit]
