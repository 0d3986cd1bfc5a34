"""Linear creep: friction of rolling wheels up to the friction limit.

The slip of a wheel is proportional to the used fraction of the friction. This is the law of
`slipfree.laws.coulomb` at small slip; it is not valid for sliding wheels. The equations are linear
in slip and used friction. They determine the friction even where equilibrium alone does not, as
for the side forces of a rigid axle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

import casadi as ca
import numpy as np
from annotated_types import Gt, Le, Unit

from slipfree.core.arguments import checked
from slipfree.laws import coulomb
from slipfree.laws.protocols import Equations, Reaction, SlidingContacts, wheel_limits


@checked
@dataclass(frozen=True)
class LinearCreep(coulomb.OfFriction):
    """Linear creep up to the friction limit.

    The tangential force on a wheel is ``mu N p`` with ``sqrt(eps^2 + (mu / K)^2) p + s = 0``, where
    ``s`` is its slip velocity, ``N`` its normal force and ``p`` the used fraction of the friction.
    The law is valid for ``|p| <= 1``: the friction cone.

    Attributes
    ----------
    creep : float
        Slip velocity ``eps`` at the friction limit. [m/s]
    slip_stiffness : float
        Slip stiffness ``K``: force over normal force and slip velocity. [s/m]

    Raises
    ------
    ModelError
        If a number is outside its bounds.
    """

    creep: Annotated[float, Gt(0), Le(coulomb.MAX_CREEP), Unit("m/s")] = 1e-3
    slip_stiffness: coulomb.SlipStiffness = math.inf
    subject: ClassVar = "linear creep"

    def reaction(self, contacts: SlidingContacts, unknowns: coulomb.FrictionUnknowns) -> Reaction:
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
            the equations of contact and creep, and the cone of friction as a limit.
        """
        normal, *used = unknowns
        slips = contacts.along, contacts.across
        along, across = (
            tuple(n * mu * p for n, mu, p in zip(normal, contacts.friction, parts, strict=True))
            for parts in used
        )
        creep = [
            ca.sqrt(coulomb.squared_creep(self.creep, self.slip_stiffness, mu)) * p + s
            for parts, slip in zip(used, slips, strict=True)
            for p, s, mu in zip(parts, slip, contacts.friction, strict=True)
        ]
        labels = coulomb.equation_labels(contacts.vehicle)
        squares = (a**2 + c**2 for a, c in zip(*used, strict=True))
        limits = wheel_limits(contacts.vehicle, "friction_cone", squares, -np.inf, 1.0)
        rows = ca.vertcat(*contacts.normal, *creep)
        return Reaction(along, across, normal, Equations(labels, rows), tuple(limits))
