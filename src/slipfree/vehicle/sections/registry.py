"""Names of the wheel sections in vehicle files."""

from __future__ import annotations

from math import inf

from slipfree.core.errors import ModelError
from slipfree.vehicle.sections.base import Section
from slipfree.vehicle.sections.disc import Disc
from slipfree.vehicle.sections.omni import Omni
from slipfree.vehicle.sections.sphere import Sphere
from slipfree.vehicle.sections.torus import Torus

SECTIONS: dict[str, type[Section]] = {
    "torus": Torus,
    "disc": Disc,
    "sphere": Sphere,
}


def section_of_radii(r1: float, r2: float, *, rollers: bool = False) -> Section:
    """Return the torus of two radii; a disc for ``r1 = 0``, a sphere for ``r2 = 0``.

    Parameters
    ----------
    r1, r2 : float
        Radius of the tube, and radius of the circle of tube centres. [m]
    rollers : bool
        Whether the wheel has free rollers.

    Raises
    ------
    ModelError
        If a radius is negative or not finite, or both are zero.
    """
    for key, radius in (("r1", r1), ("r2", r2)):
        if not 0 <= radius < inf:
            raise ModelError(
                f"{key}: expected a finite radius of zero or more, found {radius} m; change it"
            )
    if r1 + r2 <= 0:
        raise ModelError("r1, r2: expected a positive radius, found two zeros; increase r1 or r2")
    section = Disc(r2) if r1 == 0 else Sphere(r1) if r2 == 0 else Torus(r1, r2)
    return Omni(section) if rollers else section
