"""Functions that return the vehicles of the catalogue."""

from slipfree.catalog.step_climber import seven_wheels, step_climber
from slipfree.catalog.vehicles import (
    ackermann,
    articulated,
    differential_drive,
    mecanum,
    open_source_rover,
    rigid_skid_steer,
    rocky7,
    skid_steer,
    three_wheeler,
)
from slipfree.core.errors import similar

__all__ = [
    "ackermann",
    "articulated",
    "differential_drive",
    "mecanum",
    "open_source_rover",
    "rigid_skid_steer",
    "rocky7",
    "seven_wheels",
    "skid_steer",
    "step_climber",
    "three_wheeler",
]


def __getattr__(name: str) -> None:
    """Raise AttributeError with the most similar name of the catalogue."""
    raise AttributeError(
        f"expected a vehicle of the catalogue, found {name!r}; {similar(name, __all__)}use one of "
        f"{', '.join(__all__)}"
    )
