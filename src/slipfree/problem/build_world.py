"""Ground, vehicle and model of a problem."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

from slipfree.core.dae import Dae
from slipfree.problem.build_common import build_terrain, build_vehicle
from slipfree.problem.build_ground import GroundMap, at, build_ground
from slipfree.problem.build_model import build_model
from slipfree.problem.build_solids import build_solids
from slipfree.problem.problem import Problem
from slipfree.problem.schema import Modelled
from slipfree.problem.sharing import shared
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.solids import Prism
from slipfree.vehicle.tree import Vehicle

S = TypeVar("S", bound=Modelled)
OF_THE_MOTION = {"title", "start", "inputs", "driver", "time", "solver", "output"}
ORIGIN = ("x", "y")  # states at the start that the ground depends on


class World(NamedTuple):
    """Ground and vehicle of a problem, and its model.

    Attributes
    ----------
    ground : GroundMap
        Heights on a grid, with their origin and facts.
    terrain : Bicubic
        The ground as a surface, with its local origin at the start.
    vehicle : Vehicle
        The vehicle.
    prisms : tuple of Prism
        Solids on the ground.
    dae : Dae
        Model of the vehicle on the ground.
    """

    ground: GroundMap
    terrain: Bicubic
    vehicle: Vehicle
    prisms: tuple[Prism, ...]
    dae: Dae


def build_world(problem: Problem[S]) -> World:
    """Return ground, vehicle and model of a problem.

    Consecutive runs of a sweep share them, unless a key changes on which they depend.

    Raises
    ------
    ProblemError
        If ground, vehicle, law or solids are not valid, or the start lies off the ground.
    """
    spec = problem.spec
    rest = spec.model_dump_json(exclude=OF_THE_MOTION, exclude_unset=True, serialize_as_any=True)
    origin = tuple(spec.start.get(name) for name in ORIGIN)
    return shared("world", (problem.folder, rest, origin), lambda: _built(problem))


def _built(problem: Problem[S]) -> World:
    """Return ground, vehicle and model of a problem, built anew."""
    ground = build_ground(problem)
    with at(problem, ("vehicle",)):
        vehicle = build_vehicle(problem.spec.vehicle, problem)
    terrain = build_terrain(problem, ground)
    prisms = build_solids(problem, terrain)
    dae = build_model(problem, problem.spec, vehicle, terrain, prisms)
    return World(ground, terrain, vehicle, prisms, dae)
