"""Published parameters of soils.

Each source gives the parameters of sinkage and strength, and the shear deformation modulus. All
other parameters have the defaults of `Soil`: angles of largest stress, exit depth and density.
"""

from __future__ import annotations

from dataclasses import replace
from math import radians
from typing import NamedTuple

from slipfree.core.errors import ModelError
from slipfree.laws.soil import Soil


class KnownSoil(NamedTuple):
    """A soil and the publication of its parameters."""

    soil: Soil
    source: str


ISHIGAMI = (
    "G. Ishigami, A. Miwa, K. Nagatani, K. Yoshida, Terramechanics-based model for steering "
    "maneuver of planetary exploration rovers on loose soil, J. Field Robotics 24(3), 2007, as "
    "quoted by codes that cite it; cohesion, friction angle and sinkage also in G. Ishigami, "
    "K. Mizuuchi, K. Yoshida, JSME ROBOMEC 2005, 1A1-S-055, table 1"
)
DING_2015 = "L. Ding et al., 2015, as tabulated in the configuration of gz-terramechanics"
DING_2011 = (
    "L. Ding et al., J. Terramechanics 48(1), 2011, pp. 27-45, table 2, as tabulated by "
    "roverdevkit; the shear modulus is 9.7 to 13.1 mm"
)


def isotropic(
    cohesion: float, degrees: float, moduli: tuple[float, float], exponent: float, shear: float
) -> Soil:
    """Return a soil with one shear deformation modulus [m] for all directions.

    Cohesion [Pa], angle of internal friction [deg], cohesive and frictional modulus of sinkage
    [N/m^(n+1), N/m^(n+2)] and the sinkage exponent ``n``.
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
    "dry_sand": KnownSoil(isotropic(1040.0, 28.0, (0.99e3, 1528e3), 1.1, 0.010), DING_2015),
    "lunar": KnownSoil(isotropic(170.0, 35.0, (1.4e3, 820e3), 1.0, 0.018), DING_2015),
    "planetary_simulant": KnownSoil(
        replace(isotropic(250.0, 31.9, (15.6e3, 2407.4e3), 1.1, 0.011), density=1605.0), DING_2011
    ),
}


def known_soil(name: str) -> Soil:
    """Return a soil of the catalogue by name; ModelError if there is no soil of this name."""
    if name not in SOILS:
        raise ModelError(
            f"soil: expected one of {', '.join(SOILS)}, found {name!r}; choose one of them, or "
            "give the constants of Soil(...)"
        )
    return SOILS[name].soil
