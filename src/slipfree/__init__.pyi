"""Public names of `slipfree` and the modules that define them, for lazy_loader and mypy."""

from . import catalog
from .atlas.atlas import atlas
from .batch.many import settle_many
from .control.path_following import commanded, follow, straight
from .core.dae import Dae
from .core.errors import DataError, ModelError, SlipfreeError
from .core.outcome import Outcome
from .core.trajectory import SolverError, Trajectory
from .core.version import __version__
from .files.maps.elevation import read_map
from .geometry.path import Path
from .geometry.regions import Region
from .laws.compliant import Compliant
from .laws.coulomb import Coulomb
from .laws.least_slip import LeastSlip
from .laws.linear_creep import LinearCreep
from .laws.rolling import Rolling
from .laws.soil import Soil
from .models.dynamics import dynamics
from .models.inverse import inverse_kinematics
from .models.kinematics import direct_kinematics
from .models.montana import cross_check, montana_kinematics
from .models.quasi_statics import quasi_statics
from .models.rigid_dynamics import rigid_dynamics
from .plan.mpc import replan
from .plan.plan import plan
from .plan.sampling import SamplingTask, sample_plan
from .plan.search import Search
from .plan.stage import Cost
from .plan.transcription import Mesh
from .problem.build_vehicle import read_vehicle
from .problem.load import load_problem
from .problem.result import open_result, run_problem
from .routing.search import Route
from .show.motion_figures import plot
from .solve.options import SolverOptions
from .solve.rollouts import rollouts
from .solve.settle import settle
from .solve.simulate import simulate
from .terrain.analytic import Analytic
from .terrain.base import Grid
from .terrain.bicubic import Bicubic
from .terrain.solids import Solids
from .vehicle.drives import Motor, Rate, Torque
from .vehicle.gravity import in_gravity
from .vehicle.tree import Body, Coordinate, Joint, Vehicle, planar
from .vehicle.wheel import Wheel

__all__ = [
    "Analytic",
    "Bicubic",
    "Body",
    "Compliant",
    "Coordinate",
    "Cost",
    "Coulomb",
    "Dae",
    "DataError",
    "Grid",
    "Joint",
    "LeastSlip",
    "LinearCreep",
    "Mesh",
    "ModelError",
    "Motor",
    "Outcome",
    "Path",
    "Rate",
    "Region",
    "Rolling",
    "Route",
    "SamplingTask",
    "Search",
    "SlipfreeError",
    "Soil",
    "Solids",
    "SolverError",
    "SolverOptions",
    "Torque",
    "Trajectory",
    "Vehicle",
    "Wheel",
    "__version__",
    "atlas",
    "catalog",
    "commanded",
    "cross_check",
    "direct_kinematics",
    "dynamics",
    "follow",
    "in_gravity",
    "inverse_kinematics",
    "load_problem",
    "montana_kinematics",
    "open_result",
    "plan",
    "planar",
    "plot",
    "quasi_statics",
    "read_map",
    "read_vehicle",
    "replan",
    "rigid_dynamics",
    "rollouts",
    "run_problem",
    "sample_plan",
    "settle",
    "settle_many",
    "simulate",
    "straight",
]
