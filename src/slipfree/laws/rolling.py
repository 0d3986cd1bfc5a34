"""Rolling without slip."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from slipfree.contact.closure import check_exact_closure
from slipfree.core.errors import ModelError
from slipfree.core.records import Label
from slipfree.laws.protocols import Equations, Motion, component_labels
from slipfree.vehicle.tree import Vehicle

USE_LEAST = "use least slip: LeastSlip(), or slip = 'least' in a problem file"


@dataclass(frozen=True)
class Rolling:
    """No slip at any wheel.

    The law suits vehicles without rollers whose wheels can all touch a rigid ground, and that have
    as many passive joints and free wheels as rolling conditions, ``2 n_wheels - 3``, such as the
    tilting three-wheeler.
    """

    def check(self, vehicle: Vehicle) -> None:
        """Check that a vehicle can roll without slip.

        Raises
        ------
        ModelError
            If wheels have rollers, if they cannot all touch a rigid ground, or if passive joints
            and free wheels are not as many as the conditions that rolling adds.
        """
        if any(wheel.rollers for wheel in vehicle.wheels):
            raise ModelError(
                f"{vehicle.name!r}: expected wheels without rollers, found wheels with rollers, "
                f"whose contact points move freely across the rollers' axles; {USE_LEAST}"
            )
        check_exact_closure(vehicle, "rolling without slip")
        check_rolling_counts(vehicle, "", USE_LEAST)

    def unknowns(
        self,
        vehicle: Vehicle,  # noqa: ARG002 - of the protocol
        constraints: tuple[Label, ...],  # noqa: ARG002
    ) -> tuple[()]:
        """Return no labels: the rates are the only unknowns of the law.

        Returns
        -------
        tuple of length 0
            The record of the unknowns, for `equations`.
        """
        return ()

    def equations(self, motion: Motion, unknowns: tuple[()]) -> Equations:  # noqa: ARG002
        """Return the condition that all slip velocities vanish.

        Parameters
        ----------
        motion : Motion
            Rates of a vehicle, and the slips (3, 1) [m/s] of its n wheels.
        unknowns : tuple of length 0
            Those of `unknowns`.

        Returns
        -------
        Equations
            The 3 n components of the slips, in fixed axes. [m/s]
        """
        labels = component_labels(motion.vehicle, "no_slip", "m s-1", "slip")
        return Equations(labels, ca.vertcat(*motion.slips))


def rolling_counts(vehicle: Vehicle) -> tuple[int, int]:
    """Return the number of passive joints and free wheels, and that of rolling conditions."""
    free = sum(not wheel.driven for wheel in vehicle.wheels)
    return len(vehicle.of("passive")) + free, 2 * len(vehicle.wheels) - 3


def check_rolling_counts(vehicle: Vehicle, purpose: str, remedy: str) -> None:
    """Raise ModelError unless there is one passive joint or free wheel per rolling condition."""
    found, needed = rolling_counts(vehicle)
    if found != needed:
        raise ModelError(
            f"{vehicle.name!r} cannot roll without slip{purpose}: expected {needed} passive joints "
            f"and free wheels, one per rolling condition, found {found}; {remedy}"
        )
