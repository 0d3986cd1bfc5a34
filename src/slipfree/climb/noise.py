"""Noise of the sensors: smooth, of a limited band, the same for the same seed."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from slipfree.climb.reference import PerAxle, Tilts
from slipfree.errors import ModelError

TONES = 24  # in the noise of a sensor


@dataclass(frozen=True)
class Noise:
    """What sensors add to what they measure: root mean squares, and what they are made of.

    The noise of a sensor is a sum of tones of even strength, their frequencies spread over the band
    and their phases drawn at random, so that integrators see a smooth function of time.

    Attributes
    ----------
    tilt : float
        Of the bodies' tilts. [rad]
    tilt_rate : float
        Of their rates, which the controller measures separately. [rad/s]
    wheel_rate : float
        Of the wheels' rates. [rad/s]
    band : float
        Largest frequency; the smallest is a hundredth of it. [Hz]
    seed : int
        Of the frequencies and phases, zero or more.

    Raises
    ------
    ModelError
        If a size is negative, the band not positive, or the seed negative.
    """

    tilt: float = 0.0
    tilt_rate: float = 0.0
    wheel_rate: float = 0.0
    band: float = 50.0
    seed: int = 0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (0 <= value < math.inf and (value > 0 or name != "band")):
                raise ModelError(f"noise: {name} must be finite and not negative, found {value}")


def measured(
    noise: Noise, t: Any, tilts: Tilts, rates: Tilts, spins: PerAxle
) -> tuple[Tilts, Tilts, PerAxle]:
    """Return tilts, their rates and the wheels' rates as the sensors see them at a time.

    Parameters
    ----------
    noise : Noise
        Of the sensors.
    t : SX or float
        Time. [s]
    tilts, rates : Tilts
        True ones. [rad, rad/s]
    spins : PerAxle
        True ones. [rad/s]
    """
    rng = np.random.default_rng(noise.seed)

    def noisy(size: float, values: Iterable[Any]) -> list[Any]:
        return [value + size * _unit(rng, noise.band, t) for value in values]

    return (
        Tilts(*noisy(noise.tilt, tilts)),
        Tilts(*noisy(noise.tilt_rate, rates)),
        PerAxle(*noisy(noise.wheel_rate, spins)),
    )


def _unit(rng: np.random.Generator, band: float, t: Any) -> Any:
    """Return noise of root mean square one."""
    edges = np.linspace(0.01 * band, band, TONES + 1)
    turning = 2 * np.pi * rng.uniform(edges[:-1], edges[1:])
    phases = rng.uniform(0, 2 * np.pi, TONES)
    return math.sqrt(2 / TONES) * ca.sum1(ca.sin(ca.DM(turning) * t + ca.DM(phases)))
