"""How a wheeled vehicle moves over uneven ground without slipping."""

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
from slipfree.version import __version__

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
