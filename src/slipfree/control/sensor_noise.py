"""Sensor noise: smooth, band-limited and reproducible by its seed."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Any

import casadi as ca
import numpy as np
from annotated_types import Ge, Gt, Lt, Unit, doc

from slipfree.control.reference_speeds import PerAxle, Tilts
from slipfree.core.schema import check_bounds

TONES = 24  # number of tones in the noise of a sensor


@dataclass(frozen=True)
class Noise:
    """Root mean squares, frequency band and seed of the sensor noise.

    The noise of a sensor is a sum of tones of equal amplitude with random phases and frequencies
    distributed over the band; it is a smooth function of time, which integrators can follow.

    Attributes
    ----------
    tilt : float
        Noise of the bodies' tilts. [rad]
    tilt_rate : float
        Noise of the tilt rates, which are measured separately. [rad/s]
    wheel_rate : float
        Noise of the wheel rates. [rad/s]
    band : float
        Largest frequency; the smallest is a hundredth of it. [Hz]
    seed : int
        Seed of frequencies and phases, nonnegative.

    Raises
    ------
    ModelError
        If a root mean square is negative, the band is not positive, or the seed is negative.
    """

    tilt: Annotated[
        float, Ge(0), Lt(math.inf), Unit("rad"), doc("root mean square for the bodies' tilts")
    ] = 0.0
    tilt_rate: Annotated[
        float, Ge(0), Lt(math.inf), Unit("rad/s"), doc("root mean square for the tilt rates")
    ] = 0.0
    wheel_rate: Annotated[
        float, Ge(0), Lt(math.inf), Unit("rad/s"), doc("root mean square for the wheel rates")
    ] = 0.0
    band: Annotated[float, Gt(0), Lt(math.inf), Unit("Hz"), doc("largest frequency")] = 50.0
    seed: Annotated[int, Ge(0), doc("seed of the random numbers")] = 0

    def __post_init__(self) -> None:
        check_bounds(self)


def measured(
    noise: Noise, t: Any, tilts: Tilts, rates: Tilts, spins: PerAxle
) -> tuple[Tilts, Tilts, PerAxle]:
    """Return tilts, tilt rates and wheel rates with sensor noise.

    Parameters
    ----------
    noise : Noise
        Noise of the sensors.
    t : SX or float
        Time. [s]
    tilts, rates : Tilts
        True tilts and tilt rates. [rad, rad/s]
    spins : PerAxle
        True wheel rates. [rad/s]
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
    """Return the value at time ``t`` of noise with unit rms and largest frequency ``band``."""
    edges = np.linspace(0.01 * band, band, TONES + 1)
    turning = 2 * np.pi * rng.uniform(edges[:-1], edges[1:])
    phases = rng.uniform(0, 2 * np.pi, TONES)
    return math.sqrt(2 / TONES) * ca.sum1(ca.sin(ca.DM(turning) * t + ca.DM(phases)))
