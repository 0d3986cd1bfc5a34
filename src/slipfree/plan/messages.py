"""Describe constraints of a plan, their bounds and their violations in words."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from slipfree.core.records import Label
from slipfree.plan.constraints import COST, EQUATION, INPUT, LIMIT

MODEL = "model"  # role of limits of the model that the program does not contain yet
DURATION = "duration"
LIMITED_SUFFIX = " is limited by the plan"  # end of the description of a limit of the plan
FIXED_POINT_FROM = 1000.0  # larger values have three decimals, since four digits are too few


def rate_of(label: Label) -> Label:
    """Return the label of the rate of an input, in 1/s2."""
    return Label(f"{label.full}_change", "s-2", f"rate of {label.full}")


def subject(label: Label, role: str) -> str:
    """Return a text for a constrained quantity, such as ``input right_rate``.

    ``role`` is the kind of constraint, as in `slipfree.plan.constraints.Violation`.
    """
    whose = "the vehicle" if label.wheel is None else f"wheel {label.wheel}"
    if role == INPUT:
        return f"input {label.full}"
    if role == DURATION:
        return "duration"
    if role == COST:
        return f"cost {label.name}"
    if role in (LIMIT, EQUATION, MODEL):
        kind = "equation " if role == EQUATION else "model's own " if role == MODEL else ""
        return f"{kind}{label.name} of {whose}"
    return f"{label.full} at the {role}"


def number(label: Label, value: float) -> str:
    """Return a text for a value with the unit of its label, such as ``0.5 rad/s``."""
    unit = unit_words(label.unit)
    return f"{_digits(value)}{unit and ' '}{unit}"


def missed_words(sizes: Mapping[str, float], units: Mapping[str, str]) -> str:
    """Return violations as text, such as ``x at the goal by 3.1e-04 m``.

    ``sizes`` and ``units`` are the violations and their units by name.
    """
    return ", ".join(
        f"{name} by {size:.1e} {unit_words(units[name])}".rstrip() for name, size in sizes.items()
    )


def _digits(value: float) -> str:
    """Return a value as text: four significant digits, or three decimals from 1000 on."""
    value = round(value, 9) + 0.0
    return f"{value:.4g}" if abs(value) < FIXED_POINT_FROM else f"{round(value, 3):.15g}"


def bounds_words(label: Label, low: float, high: float) -> str:
    """Return bounds as text with unit, such as ``0 to 1 m``, ``at most 1 m``, ``1 m`` if equal."""
    if low == high:
        return number(label, low)
    if np.isfinite(low) and np.isfinite(high):
        return f"{_digits(low)} to {number(label, high)}"
    return (
        f"at least {number(label, low)}" if np.isfinite(low) else f"at most {number(label, high)}"
    )


def unit_words(unit: str) -> str:
    """Return a unit as a fraction, such as ``"rad/s"`` for ``"rad s-1"``."""
    parts = unit.split()
    over = [part for part in parts if "-" not in part and part != "1"]
    under = [part.replace("-", "").removesuffix("1") for part in parts if "-" in part]
    return "/".join([" ".join(over) or "1", *under]) if under else " ".join(over)
