"""Describe constraints and their values."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from slipfree.plan.constraints import EQUATION, INPUT, LIMIT
from slipfree.records import Label

MODEL = "model"  # the role of the model's own limits, before they are in the program
DURATION = "duration"
LIMITED_SUFFIX = " is limited by the plan"  # ends the words of a limit of the plan
FIXED_POINT_FROM = 1000.0  # larger values have three decimals, since four digits are too few


def rate_of(label: Label) -> Label:
    """Return the label of an input's rate in the program."""
    return Label(f"{label.full}_change", "s-2", f"rate of {label.full}")


def subject(label: Label, role: str) -> str:
    """Return the constrained quantity, with its owner or its role."""
    whose = "the vehicle" if label.wheel is None else f"wheel {label.wheel}"
    if role == INPUT:
        return f"input {label.full}"
    if role == DURATION:
        return "duration"
    if role in (LIMIT, EQUATION, MODEL):
        kind = "equation " if role == EQUATION else "model's own " if role == MODEL else ""
        return f"{kind}{label.name} of {whose}"
    return f"{label.full} at the {role}"


def number(label: Label, value: float) -> str:
    """Return a value with its unit."""
    unit = _unit(label.unit)
    return f"{_digits(value)}{unit and ' '}{unit}"


def missed_words(sizes: Mapping[str, float], units: Mapping[str, str]) -> str:
    """Return a text of violations, such as ``x at the goal by 3.1e-04 m``."""
    return ", ".join(
        f"{name} by {size:.1e} {_unit(units[name])}".rstrip() for name, size in sizes.items()
    )


def _digits(value: float) -> str:
    """Return a value with four digits, or with three decimals if large, as map coordinates are."""
    value = round(value, 9) + 0.0
    return f"{value:.4g}" if abs(value) < FIXED_POINT_FROM else f"{round(value, 3):.15g}"


def bounds_words(label: Label, low: float, high: float) -> str:
    """Return a range with its unit."""
    if low == high:
        return number(label, low)
    if np.isfinite(low) and np.isfinite(high):
        return f"{_digits(low)} to {number(label, high)}"
    return (
        f"at least {number(label, low)}" if np.isfinite(low) else f"at most {number(label, high)}"
    )


def _unit(unit: str) -> str:
    """Return a unit with a stroke, ``"rad/s"`` for ``"rad s-1"``."""
    parts = unit.split()
    over = [part for part in parts if "-" not in part and part != "1"]
    under = [part.replace("-", "").removesuffix("1") for part in parts if "-" in part]
    return "/".join([" ".join(over) or "1", *under]) if under else " ".join(over)
