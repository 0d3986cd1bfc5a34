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
    "actuated",
    "best_utilisation",
    "direct_kinematics",
    "follow",
    "settle",
    "simulate",
    "straight",
    "three_wheeler",
]
