"""Grounds given by a formula."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from slipfree.errors import ModelError
from slipfree.named import Array

CHUNK = 4096  # points evaluated at once; any other number would be a slow call
EVERYWHERE = (-math.inf, math.inf, -math.inf, math.inf)


@dataclass(frozen=True)
class Analytic:
    """A ground whose height is a formula; its local coordinates are its map coordinates.

    Attributes
    ----------
    function : callable
        ``function(x, y)`` of two SX scalars that returns the height, built from operators and
        CasADi functions, at least twice continuously differentiable. [m]
    domain : tuple of 4 floats
        ``x_min, x_max, y_min, y_max`` where the formula is meant to hold. [m]

    Raises
    ------
    ModelError
        If the domain is empty, or the function does not return one height that depends on
        ``x`` and ``y`` alone.

    Notes
    -----
    An instance can be pickled if its function can: use one defined at the top of a module.

    Examples
    --------
    >>> ground = Analytic(lambda x, y: 0.1 * ca.sin(x) * ca.cos(y))
    """

    function: Callable[[Any, Any], Any]
    domain: tuple[float, float, float, float] = EVERYWHERE

    def __post_init__(self) -> None:
        x_min, x_max, y_min, y_max = self.domain
        if not (x_min < x_max and y_min < y_max):
            raise ModelError(
                "terrain: domain must be x_min < x_max, y_min < y_max in metres, "
                f"found {self.domain}"
            )
        x, y = ca.SX.sym("x"), ca.SX.sym("y")
        height = ca.SX(self.function(x, y))
        if height.shape != (1, 1):
            raise ModelError(f"terrain: function must return one height, found {height.shape}")
        foreign = [s for s in ca.symvar(height) if not (ca.is_equal(s, x) or ca.is_equal(s, y))]
        if foreign:
            raise ModelError(
                f"terrain: the height may depend on x and y alone, found the symbols {foreign}"
            )

    def __getstate__(self) -> dict[str, Any]:
        """Return what makes the ground; compiled parts are made again when they are needed."""
        return {"function": self.function, "domain": self.domain}

    @property
    def origin(self) -> tuple[float, float, float]:
        """The map's own origin [m]."""
        return (0.0, 0.0, 0.0)

    def height(self, x: ca.SX, y: ca.SX) -> ca.SX:
        """Return the height at a point [m]."""
        return ca.SX(self.function(x, y))

    def elevation(self, x: Array, y: Array) -> Array:
        """Return the heights at points of equal shape [m]."""
        x, y = np.broadcast_arrays(x, y)
        count = -(-x.size // CHUNK)
        padded = [np.resize(each.reshape(-1), (max(count, 1), 1, CHUNK)) for each in (x, y)]
        heights = [np.array(self._numeric(*rows)) for rows in zip(*padded, strict=True)]
        return np.concatenate(heights, axis=None)[: x.size].reshape(x.shape)

    @cached_property
    def _numeric(self) -> ca.Function:
        x, y = ca.SX.sym("x"), ca.SX.sym("y")
        height = ca.Function("elevation", [x, y], [ca.densify(self.height(x, y))])
        return height.map(CHUNK)
