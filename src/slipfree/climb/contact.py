"""Parameters of the compliant contacts of a step climber."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

from slipfree.errors import ModelError
from slipfree.laws.compliant import Compliant
from slipfree.vehicle.tree import GRAVITY


@dataclass(frozen=True)
class CompliantContact:
    """Stiffness, damping and friction of an axle's contacts, see `slipfree.laws.compliant`.

    Attributes
    ----------
    stiffness : float
        Stiffness of a contact. [N/m]
    damping : float
        Damping ``c`` of Hunt and Crossley: the normal force at depth ``s`` is ``k s max(0, 1 + c
        s')``, with the stiffness ``k``. [s/m]
    static, dynamic : float
        Static and kinetic coefficients of friction. [1]
    creep : float
        Slip speed at which friction is almost fully developed. [m/s]
    stribeck : float
        Slip speed over which friction decreases from the static to the kinetic value. [m/s]

    Raises
    ------
    ModelError
        If the damping is negative, another number is not positive, or the kinetic friction exceeds
        the static friction.
    """

    stiffness: float = 1.5e5
    damping: float = 10.0
    static: float = 0.4
    dynamic: float = 0.3
    creep: float = 5e-4
    stribeck: float = 0.01

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not value > 0 and name != "damping":
                raise ModelError(
                    f"contact: expected a positive number as {name!r}, found {value}; increase it"
                )
        if not (self.damping >= 0 and self.static >= self.dynamic):
            raise ModelError(
                "contact: expected a damping of at least 0 and a static friction not below the "
                f"kinetic friction, found damping {self.damping} s/m, static {self.static}, "
                f"kinetic {self.dynamic}; change these numbers"
            )

    def depth(self, load: float) -> float:
        """Return the depth of a contact at rest under a load [N], in metres."""
        return load / self.stiffness

    def law(self, load: float) -> Compliant:
        """Return the wheel-ground law of wheels that each carry a load [N]."""
        return Compliant(
            damping_ratio=self.damping * sqrt(GRAVITY * self.depth(load)) / 2,
            creep=self.creep,
            sliding=self.dynamic / self.static,
            stribeck_speed=self.stribeck,
        )
