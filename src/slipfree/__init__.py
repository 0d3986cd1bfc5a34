"""How a wheeled vehicle moves over uneven ground without slipping."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from slipfree.version import __version__

if TYPE_CHECKING:
    from slipfree.dae import Dae
    from slipfree.errors import DataError, ModelError, SlipfreeError, SolverError
    from slipfree.geometry.path import Path
    from slipfree.kinematics.follow import follow, straight
    from slipfree.kinematics.hold import best_utilisation
    from slipfree.kinematics.rolling import direct_kinematics
    from slipfree.kinematics.traction import Traction
    from slipfree.solve.settle import settle
    from slipfree.solve.simulate import simulate
    from slipfree.terrain.analytic import Analytic
    from slipfree.terrain.base import Grid, Terrain
    from slipfree.terrain.bicubic import Bicubic
    from slipfree.trajectory import Trajectory
    from slipfree.vehicle.catalog import three_wheeler
    from slipfree.vehicle.chain import Vehicle, actuated
    from slipfree.vehicle.rovers import (
        ackermann,
        articulated,
        differential_drive,
        open_source_rover,
        rocky7,
        seven_wheels,
        skid_steer,
    )

__all__ = [
    "Analytic",
    "Bicubic",
    "Dae",
    "DataError",
    "Grid",
    "ModelError",
    "Path",
    "SlipfreeError",
    "SolverError",
    "Terrain",
    "Traction",
    "Trajectory",
    "Vehicle",
    "__version__",
    "ackermann",
    "actuated",
    "articulated",
    "best_utilisation",
    "differential_drive",
    "direct_kinematics",
    "follow",
    "open_source_rover",
    "rocky7",
    "settle",
    "seven_wheels",
    "simulate",
    "skid_steer",
    "straight",
    "three_wheeler",
]

_HOMES = {
    "dae": ("Dae",),
    "errors": ("DataError", "ModelError", "SlipfreeError", "SolverError"),
    "geometry.path": ("Path",),
    "kinematics.follow": ("follow", "straight"),
    "kinematics.hold": ("best_utilisation",),
    "kinematics.rolling": ("direct_kinematics",),
    "kinematics.traction": ("Traction",),
    "solve.settle": ("settle",),
    "solve.simulate": ("simulate",),
    "terrain.analytic": ("Analytic",),
    "terrain.base": ("Grid", "Terrain"),
    "terrain.bicubic": ("Bicubic",),
    "trajectory": ("Trajectory",),
    "vehicle.catalog": ("three_wheeler",),
    "vehicle.chain": ("Vehicle", "actuated"),
    "vehicle.rovers": (
        "ackermann",
        "articulated",
        "differential_drive",
        "open_source_rover",
        "rocky7",
        "seven_wheels",
        "skid_steer",
    ),
}  # of what is imported when it is asked for, so that the command line answers at once
_HOME = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Return what the package offers, from the module it is in."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the names that the package offers."""
    return sorted({*globals(), *__all__})
