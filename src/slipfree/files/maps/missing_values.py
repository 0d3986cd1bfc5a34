"""Markers of missing heights that a map file does not declare, such as -9999."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from slipfree.core.errors import DataError
from slipfree.core.records import Array

NINES = re.compile(r"-?9{3,}(\.[09]+)?")  # -999, -9999, 99999.9
BEYOND_EARTH = 1e4  # values above it are no heights of the ground [units of the file]
MAX_SORTED = 500_000  # largest number of heights that are sorted
MARKERS = 4  # largest number of different markers in a file
RATIO = 10.0  # least distance of a marker from other heights, relative to the gaps among these
# least distances of a value from all other heights that relief cannot explain [m]
NAMED_GAP, LOW_GAP, MIDDLE_GAP, DEEP_GAP, HIGH_GAP = 30.0, 50.0, 100.0, 300.0, 1000.0
MAX_SHARE = 0.1  # largest share of nodes with a marker near other heights [1]
# least difference of neighbouring nodes [m], slope [1] and ratio to the median of interpolated
# markers, and heights between which there are none [m]
JUMP, SLOPE, STEEPER, PLAUSIBLE = 100.0, 10.0, 50.0, (-1000.0, 10000.0)


class Marker(NamedTuple):
    """A value that is probably a marker of missing heights, in units of the file."""

    value: float  # the extreme one of interpolated markers
    low: float  # range of the other values
    high: float
    is_exact: bool  # repeated exactly, not interpolated between markers and heights


def check_values(
    z: Array,
    place: Callable[[tuple[int, ...]], str],
    remedy: Callable[[Marker, str], str],
    *,
    metres: float = 1.0,
    steps: tuple[float, float] | None = None,
) -> None:
    """Raise DataError if heights contain markers of missing heights.

    ``place(index)`` returns the position of a height as text, ``remedy(marker, text)`` what to do
    with a marker whose value is ``text``. Without ``steps``, the distances of nodes [m], markers
    that were interpolated are not found.
    """
    z = np.where(np.isfinite(z), z, np.nan)
    if np.isnan(z).all():
        return
    with np.errstate(over="ignore"):  # differences of the largest numbers
        marker = _repeated_marker(z, metres)
        if marker is None and steps is not None:
            marker = _interpolated_marker(z, metres, steps)
    if marker is None:
        return
    value, low, high, is_exact = marker
    marked = z == value if is_exact else z < low if value < low else z > high
    text = f"{value:.0f}" if value.is_integer() and abs(value) < 1e15 else repr(value)
    first = tuple(int(k[0]) for k in np.nonzero(marked))
    count = f"{np.count_nonzero(marked)} of {z.size} {'nodes' if z.ndim > 1 else 'points'}"
    where = f"at {count}, first at {place(first)}"
    others = f"the others are from {low:.6g} to {high:.6g}"
    if not is_exact:
        raise DataError(
            f"expected heights, found steps of a cell that no ground has and values to {text} "
            f"{where}, while {others}: probably markers of missing heights that were interpolated; "
            "declare their value before resampling, as in gdal_edit.py -a_nodata -9999 original.tif"
        )
    raise DataError(
        f"expected heights, found the value {text} {where}, while {others}: probably missing "
        f"heights that the file does not declare; {remedy(marker, text)}"
    )


def _repeated_marker(z: Array, metres: float) -> Marker | None:
    """Return a value that is far from all others; None without one.

    Distances are judged in metres, and relative to the gaps among the other heights: maps of few
    nodes have large gaps. Deep pits without walls are rarer than towers.
    """
    finite = z[np.isfinite(z)]
    if np.ptp(finite) * metres < NAMED_GAP:
        return None
    values = _distinct_values(finite)
    gaps = np.diff(values)
    inner = float(np.sort(gaps)[-MARKERS - 1]) if gaps.size > MARKERS else 0.0
    ends = np.flatnonzero(gaps >= max(NAMED_GAP / metres, RATIO * inner)) + 1
    groups = np.split(np.arange(values.size), ends)
    body = max(
        groups,
        key=lambda group: (
            group.size > 1 or not _is_named(values[group[0]]),
            group.size,
            group.size == 1 and np.count_nonzero(finite == values[group[0]]),
        ),
    )
    low, high = float(values[body[0]]), float(values[body[-1]])
    for group in groups:
        value = float(values[group[0]])
        gap = max(low - value, value - high)
        is_one = group.size == 1 or all(_is_named(float(each)) for each in values[group])
        # Least distance that relief cannot explain: the smaller the relief is relative to the
        # distance, the smaller, unless many nodes have the value: the sea below a cliff.
        relief = (high - low) / (low - value) if value < low else np.inf
        least = LOW_GAP if relief <= 1 / RATIO else MIDDLE_GAP if relief <= 1 else DEEP_GAP
        if np.count_nonzero(finite == value) > MAX_SHARE * finite.size:
            least = DEEP_GAP
        least = HIGH_GAP if value > high else least
        least = NAMED_GAP if _is_named(value) else least
        if is_one and gap > 0 and gap * metres >= least:
            return Marker(value, low, high, is_exact=True)
    return None


def _distinct_values(z: Array) -> Array:
    """Return the distinct heights in ascending order, of large maps all extremes and a part."""
    if z.size <= MAX_SORTED:
        return np.unique(z)
    parts = [z[:: z.size // MAX_SORTED]]
    for sign, end in zip((1, -1), np.quantile(parts[0], (0.01, 0.99)), strict=True):
        rest = sign * z[sign * z <= sign * end]
        for _ in range(2 * MARKERS):
            least = rest.min()
            parts.append(sign * least[None])
            rest = rest[rest > least]
            if not rest.size:
                break
    return np.unique(np.concatenate(parts))


def _is_named(value: float) -> bool:
    """Return whether a value is one that programs use for missing heights."""
    return abs(value) >= BEYOND_EARTH or NINES.fullmatch(f"{value:.7g}") is not None


def _interpolated_marker(z: Array, metres: float, steps: tuple[float, float]) -> Marker | None:
    """Return the extreme of values between markers and heights; None without steep steps."""
    lowest, highest = float(np.nanmin(z)), float(np.nanmax(z))
    if PLAUSIBLE[0] <= lowest * metres <= highest * metres <= PLAUSIBLE[1]:
        return None
    rises = [np.abs(np.diff(z, axis=axis)) for axis in (0, 1)]
    steep = any(
        np.nanmax(rise, initial=0.0) * metres >= max(JUMP, SLOPE * step)
        for rise, step in zip(rises, steps, strict=True)
    )
    if not steep:
        return None
    every = np.concatenate([rise[np.isfinite(rise)] for rise in rises])
    jump = float(every.max())
    if jump < STEEPER * np.median(every):
        return None
    plausible = (z * metres >= PLAUSIBLE[0]) & (z * metres <= PLAUSIBLE[1])
    middle = float(np.nanmedian(z[plausible] if plausible.any() else z))  # markers may be most
    near = z[np.abs(z - middle) < jump / 2]
    value = lowest if middle - lowest > highest - middle else highest
    return Marker(value, float(near.min()), float(near.max()), is_exact=False)
