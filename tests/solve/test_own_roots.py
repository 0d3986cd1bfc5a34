"""Tests of the roots that other tests compute on their own."""

import numpy as np
from scipy.linalg import hilbert

from helpers.rounding import root


def test_roots_are_as_accurate_as_their_bounds(request):
    """Of an ill-conditioned system of whole numbers, in units of its rounding errors."""
    rows = np.round(27720 * hilbert(6))
    found, rounding = root(lambda x: rows @ x**3 - rows.sum(axis=1), np.full(6, 0.9))
    assert (np.abs(found - 1) < 2 * rounding).all()
    assert rounding.max() < 1e-8
    assert request.node.get_closest_marker("rounding")
