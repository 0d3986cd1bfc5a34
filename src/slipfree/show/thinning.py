"""Reduction of the samples of long motions, for figures and films."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slipfree.core.records import Array
from slipfree.core.trajectory import Column, Trajectory

FIGURE_SAMPLES = 4000  # number of samples in figures, a few per pixel
SCENE_SAMPLES = 20_000  # number of samples in scenes and films


def thin(run: Trajectory, count: int) -> Trajectory:
    """Return a motion with about ``count`` equally spaced samples, and all extremes.

    The samples with the smallest and the largest value of each quantity and wheel are kept. A
    motion with at most ``count`` samples is returned unchanged.
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
