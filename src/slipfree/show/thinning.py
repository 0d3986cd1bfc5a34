"""Fewer samples of long motions, for figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slipfree.records import Array
from slipfree.trajectory import Column, Trajectory

FIGURE_SAMPLES = 4000  # of figures, a few per pixel
SCENE_SAMPLES = 20_000  # of scenes and films


def thin(run: Trajectory, count: int) -> Trajectory:
    """Return a motion of fewer samples: about ``count`` at equal distances, and all extremes.

    Of each quantity, and of each wheel, the samples with the least and the largest value are kept.
    A motion of no more samples is returned as it is. Quantities are read one after the other.
    """
    if run.t.size <= count:
        return run
    kept = {int(k) for k in np.linspace(0, run.t.size - 1, count).round()}
    for column in run.columns.values():
        kept |= {k for values in np.atleast_2d(column.values.T) for k in _extremes(values)}
    span = np.array(sorted(kept))
    columns = {k: Column(c.label, c.values[span]) for k, c in run.columns.items()}
    return replace(run, t=run.t[span], columns=columns)


def _extremes(values: Array) -> list[int]:
    known = np.flatnonzero(~np.isnan(values)) if np.isnan(values).any() else None
    if known is None:
        return [int(values.argmin()), int(values.argmax())]
    if not known.size:
        return []
    return [int(known[values[known].argmin()]), int(known[values[known].argmax()])]
