"""Unknowns of a fit: numbers of the force balance, or constants of a law."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, get_type_hints

from slipfree.core.errors import ModelError
from slipfree.core.records import Label
from slipfree.core.schema import keys_of


@dataclass(frozen=True)
class Unknown:
    """A number to be fitted.

    Attributes
    ----------
    name : str
        Name in results.
    quantity : str
        One of `BALANCE`, or a constant of a law.
    wheels : tuple of str
        Names of the wheels that share the number, for a quantity of wheels; empty for all wheels.
    lower, upper : float
        Bounds, in the unit of the quantity; infinite for none.
    prior : tuple of 2 floats or None
        Mean and standard deviation of a normal prior, in the unit of the quantity.
    of : str
        Name of the surface or campaign whose number it is; by default of all.

    Raises
    ------
    ModelError
        If the bounds are not in ascending order, or the deviation of the prior is not positive.
    """

    name: str
    quantity: str
    wheels: tuple[str, ...] = ()
    lower: float = -math.inf
    upper: float = math.inf
    prior: tuple[float, float] | None = None
    of: str = ""

    def __post_init__(self) -> None:
        if not self.lower < self.upper:
            raise ModelError(
                f"unknown {self.name!r}: expected a lower bound below the upper one, found "
                f"{self.lower:g} and {self.upper:g}"
            )
        if self.prior is not None and not 0 < self.prior[1] < math.inf:
            raise ModelError(
                f"unknown {self.name!r}: expected a finite positive standard deviation of the "
                f"prior, found {self.prior[1]:g}"
            )


class BalanceQuantity(NamedTuple):
    """A number of the force balance, its usual value, bounds and prior."""

    unit: str  # unit and description
    words: str
    start: float
    bounds: tuple[float, float]
    deviation: float  # of the prior; of the natural logarithm if ``is_log``
    is_log: bool = False
    of: str = ""  # "surface" or "campaign": each may have its own number


BALANCE: dict[str, BalanceQuantity] = {
    "radius": BalanceQuantity(
        "m",
        "rolling radius of wheels, or factor of the speed of a side",
        1.0,
        (1e-3, 10),
        0.1,
        True,
    ),
    "track": BalanceQuantity(
        "m", "lateral distance between the outermost wheels", 1.0, (0.01, 20), 0.1, True
    ),
    "center_of_mass_ahead": BalanceQuantity("m", "centre of mass, ahead", 0.0, (-2, 2), 0.1),
    "center_of_mass_right": BalanceQuantity("m", "centre of mass, to the right", 0.0, (-2, 2), 0.1),
    "stiffness": BalanceQuantity(
        "s/m", "slip stiffness: force over load and slip velocity", 1.0, (0.02, 1e4), 1.5, True
    ),
    "gyration": BalanceQuantity(
        "m^2", "moment of inertia about the vertical over mass", 0.35, (1e-3, 100), 0.2, True
    ),
    "friction": BalanceQuantity(
        "1", "coefficient of friction", 0.5, (0.01, 3), 1.0, True, "surface"
    ),
    "rolling": BalanceQuantity(
        "1", "factor of the radii on a surface", 1.0, (0.5, 1.5), 0.05, True, "surface"
    ),
    "anisotropy": BalanceQuantity(
        "1", "friction across over friction along the wheels", 1.0, (0.2, 5), 0.3, True
    ),
    "turn_slope": BalanceQuantity(
        "1", "exponent of the influence of the slope on turns", 0.0, (-8, 8), 3.0
    ),
    "turn": BalanceQuantity(
        "1", "factor of the difference between the sides", 1.0, (0.05, 20), 1.0, True
    ),
    "delay": BalanceQuantity(
        "s", "time from an input to the motion; readings may be late", 0.0, (-1, 2), 0.2
    ),
    "lag": BalanceQuantity("s", "first-order lag of the drives", 0.0, (0, 3), 0.3),
    "age": BalanceQuantity("s", "age of the poses", 0.0, (0, 1), 0.5, False, "campaign"),
    "sensor_right": BalanceQuantity("m", "position of the sensor, to the right", 0.0, (-5, 5), 1.0),
    "sensor_ahead": BalanceQuantity("m", "position of the sensor, ahead", 0.0, (-5, 5), 1.0),
    "sensor_heading": BalanceQuantity(
        "rad", "orientation of the sensor, left positive", 0.0, (-7, 7), 1.0
    ),
}


def check_nominal(
    unknown: Unknown, value: float, limits: tuple[float, float], subject: str
) -> None:
    """Raise ModelError unless the value of a ``subject`` before the fit is within the bounds."""
    low, high = limits
    if not low <= value <= high:
        raise ModelError(
            f"unknown {unknown.name!r}: expected a nominal value within the bounds, {low:g} to "
            f"{high:g}, found {value:g}; change the bounds, or the {subject}"
        )


def law_limits(unknown: Unknown, law: Any) -> tuple[float, float]:
    """Return the bounds of a constant of a law: its own, and those of its annotation."""
    least, most = unknown.lower, unknown.upper
    hint = get_type_hints(type(law), include_extras=True)[unknown.quantity]
    for bound in getattr(hint, "__metadata__", ()):
        least = max(least, getattr(bound, "gt", least), getattr(bound, "ge", least))
        most = min(most, getattr(bound, "lt", most), getattr(bound, "le", most))
    return least, most


def law_constants(law: Any) -> dict[str, Label]:
    """Return the constants of a law, by name, from the annotations of its dataclass."""
    return {key.name: Label(key.name, key.unit or "1", key.meaning) for key in keys_of(type(law))}
