"""Soils with sources.

Sources give the constants of sinkage and strength, and the shear deformation modulus. Constants
that a source does not give are those of `Soil`: angles of the largest stress, exit depth and
density.
"""

from __future__ import annotations

from math import radians
from typing import NamedTuple

from slipfree.errors import ModelError
from slipfree.laws.soil import Soil


class KnownSoil(NamedTuple):
    """A soil, and the publication with its constants."""

    soil: Soil
    source: str


ISHIGAMI = (
    "G. Ishigami, A. Miwa, K. Nagatani, K. Yoshida, Terramechanics-based model for steering "
    "maneuver of planetary exploration rovers on loose soil, J. Field Robotics 24(3), 2007, as "
    "quoted by codes that cite it; cohesion, friction angle and sinkage also in G. Ishigami, "
    "K. Mizuuchi, K. Yoshida, JSME ROBOMEC 2005, 1A1-S-055, table 1"
)
DING = (
    "L. Ding et al., Planetary rovers' wheel-soil interaction mechanics, 2015, as tabulated in the "
    "configuration of gz-terramechanics"
)


def isotropic(
    cohesion: float, degrees: float, moduli: tuple[float, float], exponent: float, shear: float
) -> Soil:
    """Return a soil with one shear deformation modulus for all directions.

    Parameters
    ----------
    cohesion : float
        Cohesion. [Pa]
    degrees : float
        Angle of internal friction. [deg]
    moduli : tuple of 2 floats
        Cohesive and frictional modulus of sinkage. [N/m^(n+1), N/m^(n+2)]
    exponent : float
        Sinkage exponent ``n``. [1]
    shear : float
        Shear deformation modulus. [m]
    """
    return Soil(
        cohesion=cohesion,
        friction_angle=radians(degrees),
        cohesive_modulus=moduli[0],
        frictional_modulus=moduli[1],
        exponent=exponent,
        shear_along=shear,
        shear_along_rate=0.0,
        shear_across=shear,
        shear_across_rate=0.0,
    )


SOILS: dict[str, KnownSoil] = {
    "regolith_simulant": KnownSoil(Soil(), ISHIGAMI),
    "dry_sand": KnownSoil(isotropic(1040.0, 28.0, (0.99e3, 1528e3), 1.1, 0.010), DING),
    "lunar": KnownSoil(isotropic(170.0, 35.0, (1.4e3, 820e3), 1.0, 0.018), DING),
    "hit_lss1": KnownSoil(isotropic(250.0, 31.9, (15.6e3, 2407e3), 1.1, 0.010), DING),
}


def known_soil(name: str) -> Soil:
    """Return a soil of the catalogue by name.

    Raises
    ------
    ModelError
        If there is no soil of this name.
    """
    if name not in SOILS:
        raise ModelError(
            f"soil: expected one of {', '.join(SOILS)}, found {name!r}; choose one of them, or "
            "give the constants of Soil(...)"
        )
    return SOILS[name].soil
