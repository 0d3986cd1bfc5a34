"""Unknowns of a fit: numbers of the force balance, or constants of a law."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, get_type_hints

from slipfree.core.errors import ModelError, read_table
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


BALANCE = {
    name: BalanceQuantity(**{**row, "bounds": tuple(row["bounds"])})
    for name, row in read_table(__file__, "balance.toml").items()
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
