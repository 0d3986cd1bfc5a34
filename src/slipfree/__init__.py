"""How a wheeled vehicle moves over uneven ground without slipping."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from slipfree.version import __version__

if TYPE_CHECKING:
    from slipfree.control.path_following import follow, straight
    from slipfree.dae import Dae
    from slipfree.errors import DataError, ModelError, SlipfreeError
    from slipfree.geometry.path import Path
    from slipfree.laws.coulomb import Coulomb
    from slipfree.laws.least_slip import LeastSlip
    from slipfree.laws.rolling import Rolling
    from slipfree.models.friction_feasibility import best_utilisation
    from slipfree.models.inverse import inverse_kinematics
    from slipfree.models.kinematics import direct_kinematics
    from slipfree.models.quasi_statics import quasi_statics
    from slipfree.solve.options import SolverOptions
    from slipfree.solve.settle import settle
    from slipfree.solve.simulate import simulate
    from slipfree.terrain.analytic import Analytic
    from slipfree.terrain.base import Grid, Terrain
    from slipfree.terrain.bicubic import Bicubic
    from slipfree.trajectory import SolverError, Trajectory
    from slipfree.vehicle.catalogue.carts import (
        ackermann,
        articulated,
        differential_drive,
        skid_steer,
    )
    from slipfree.vehicle.catalogue.rovers import open_source_rover, rocky7
    from slipfree.vehicle.catalogue.step_climber import seven_wheels
    from slipfree.vehicle.catalogue.three_wheeler import three_wheeler
    from slipfree.vehicle.tree import Vehicle, actuated

__all__ = [
    "Analytic",
    "Bicubic",
    "Coulomb",
    "Dae",
    "DataError",
    "Grid",
    "LeastSlip",
    "ModelError",
    "Path",
    "Rolling",
    "SlipfreeError",
    "SolverError",
    "SolverOptions",
    "Terrain",
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
    "inverse_kinematics",
    "open_source_rover",
    "quasi_statics",
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
    "errors": ("DataError", "ModelError", "SlipfreeError"),
    "geometry.path": ("Path",),
    "control.path_following": ("follow", "straight"),
    "laws.coulomb": ("Coulomb",),
    "laws.least_slip": ("LeastSlip",),
    "laws.rolling": ("Rolling",),
    "models.friction_feasibility": ("best_utilisation",),
    "models.inverse": ("inverse_kinematics",),
    "models.kinematics": ("direct_kinematics",),
    "models.quasi_statics": ("quasi_statics",),
    "solve.options": ("SolverOptions",),
    "solve.settle": ("settle",),
    "solve.simulate": ("simulate",),
    "terrain.analytic": ("Analytic",),
    "terrain.base": ("Grid", "Terrain"),
    "terrain.bicubic": ("Bicubic",),
    "trajectory": ("SolverError", "Trajectory"),
    "vehicle.catalogue.three_wheeler": ("three_wheeler",),
    "vehicle.tree": ("Vehicle", "actuated"),
    "vehicle.catalogue.carts": ("ackermann", "articulated", "differential_drive", "skid_steer"),
    "vehicle.catalogue.rovers": ("open_source_rover", "rocky7"),
    "vehicle.catalogue.step_climber": ("seven_wheels",),
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
