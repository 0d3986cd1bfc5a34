"""Replay plans on drawn worlds: errors of the map, of friction and of the wheels' rates."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slipfree.plan.polynomial_motion import PolynomialMotion
from slipfree.plan.robust import Draw
from slipfree.problem.build_common import Setup
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.grid_ops import disturbed


def drawn_terrain(
    setup: Setup, draw: Draw, rms: float, correlation: float, friction: float
) -> Bicubic:
    """Return the ground of a problem with drawn errors of heights and of friction."""
    map_seed, friction_rng = _seed(draw, 0), np.random.default_rng(_seed(draw, 1))
    grid = setup.ground.grid
    if rms > 0:
        grid = disturbed(grid, rms, correlation, map_seed)
    factor = max(1 + friction * friction_rng.standard_normal(), 0.0)
    mu = setup.ground.mu
    if isinstance(mu, Grid):
        mu = replace(mu, z=mu.z * factor)
    elif mu is not None:
        mu = mu * factor
    return Bicubic(grid, setup.terrain.origin[:2], mu)


def drawn_motion(found: PolynomialMotion, draw: Draw, inputs: float) -> PolynomialMotion:
    """Return a plan with a drawn relative error of each input."""
    where = found.layout.inputs
    errors = np.random.default_rng(_seed(draw, 2)).standard_normal(where.shape[1])
    unknowns = found.unknowns.copy()
    unknowns[where] *= 1 + inputs * errors
    return found._replace(unknowns=unknowns)


def _seed(draw: Draw, part: int) -> int:
    """Return the seed of a part of a draw."""
    return int(np.random.SeedSequence((*draw, part)).generate_state(1)[0])
