"""Keys of the problems with ``verb = "plan"``."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from slipfree.files.toml.source import Fault
from slipfree.files.toml.source import Place as KeyPath
from slipfree.files.toml.types import (
    NonNegative,
    Pair,
    PiecewiseConstant,
    Positive,
    Range,
    Record,
)
from slipfree.problem.region_table import RegionTable
from slipfree.problem.schema import INPUTS, VERB, Modelled, TerrainKeys
from slipfree.problem.schema_climbing import STEP_CLIMBING, ClimbingDriver
from slipfree.problem.schema_ground import HeightErrors

MAX_INTERVALS = 2000  # a plan with more needs gigabytes and hours; windows divide it

GuideName = Literal["straight", "follow", "route", "reeds-shepp", "step-climbing"]


class GuideTable(ClimbingDriver):
    """Initial guess of a plan: a driving law along paths or along routes over the ground."""

    name: GuideName = Field(  # type: ignore[assignment]
        description="law; 'route': follow a path that a search finds on the map; 'reeds-shepp': "
        "drive forwards and backwards along the shortest path of a car on even ground; "
        "'step-climbing': plan of a step climber over solids"
    )
    turning_radius: NonNegative = Field(
        default=1.0,
        description="smallest turning radius of a route, or of the shortest path of a car [m]",
    )
    paths: Annotated[
        tuple[Annotated[tuple[Pair, ...], Field(strict=False)], ...] | None,
        Field(strict=False, min_length=1),
    ] = Field(
        default=None,
        description="several paths of way-points; the plan of least cost is returned [m]",
    )
    count: Annotated[int, Field(ge=1, le=100)] = Field(
        default=1,
        description="number of routes, which pass obstacles on different sides; the plan of least "
        "cost is returned",
    )


class KeepOut(RegionTable):
    """A region that no wheel may touch: a disc or a polygon."""

    longitude: float | None = Field(default=None, description="longitude, instead of x [deg]")
    latitude: float | None = Field(default=None, description="latitude, instead of y [deg]")


class Robust(Record):
    """Random worlds in which a plan is simulated, and the share in which its limits must hold."""

    share: Annotated[float, Field(gt=0, lt=1)] = Field(
        default=0.95, description="share of draws for which the plan must satisfy its limits [1]"
    )
    draws: Annotated[int, Field(ge=1, le=100_000)] = Field(
        default=50, description="number of draws that determine the tightening of a round"
    )
    final_draws: Annotated[int, Field(ge=1, le=100_000)] = Field(
        default=200, description="number of further draws, which determine the final share"
    )
    seed: Annotated[int, Field(ge=0)] = Field(default=0, description="seed of all draws")
    map: HeightErrors | None = Field(default=None, description="errors of the heights of the map")
    friction: NonNegative = Field(
        default=0.0, description="relative standard deviation of the friction of the ground [1]"
    )
    inputs: NonNegative = Field(
        default=0.0, description="relative standard deviation of the gain of each input [1]"
    )
    goal: Positive | None = Field(
        default=None,
        description="tolerance of goals and way-points that are values, not ranges; by default "
        "draws may miss them [m, rad]",
    )


class Search(Record):
    """Options of the search for a plan."""

    intervals: Annotated[int, Field(ge=1)] = Field(
        default=40, description="number of intervals of the first mesh"
    )
    degree: Annotated[int, Field(ge=1, le=5)] = Field(
        default=3, description="degree of the polynomials on an interval"
    )
    duration: Range = Field(
        default=None, description="duration of the plan; default: that of the initial guess [s]"
    )
    smooth: NonNegative = Field(
        default=0.0, description="weight of the squared rates of the inputs [1]"
    )
    continuous: bool = Field(
        default=True,
        description="whether inputs are continuous and linear on intervals; otherwise constant",
    )
    starts: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=1,
        description="number of starts, in parallel processes: routes, the guess, reversed gears, "
        "perturbed inputs; the verified plan of least cost is returned",
    )
    seed: Annotated[int, Field(ge=0)] = Field(
        default=0, description="seed of the perturbations of the starts"
    )
    window: Positive | None = Field(
        default=None,
        description="length of the windows of a long plan along its route, with 'intervals' each; "
        "default: one plan for the whole motion [m]",
    )
    overlap: Positive | None = Field(
        default=None,
        description="length at the end of a window that is planned again in the next window; "
        "default: a third of the window [m]",
    )
    robust: Robust | None = Field(
        default=None, description="random worlds in which the plan must satisfy its limits"
    )
    sliding: bool = Field(
        default=False,
        description="with model = 'dynamics': whether wheels may slide, as in a turn of a "
        "skid-steered vehicle; otherwise they roll within the limits of friction",
    )
    accuracy: Annotated[float, Field(gt=0, le=1)] = Field(
        default=1e-3,
        description="largest deviation of the simulation from the plan and its limits [m, rad]",
    )


class PlanKeys(Modelled):
    """Planning problem: the inputs that reach a goal at least cost."""

    verb: Literal["plan"] = Field(description=VERB)
    goal: dict[str, Range] = Field(
        description="ranges of states or unknowns at the end, by name; also longitude and latitude "
        "in degrees, as in start [m, rad]"
    )
    costs: dict[str, NonNegative] = Field(
        description="weights of integrals over time: slip, effort, time, energy, or any quantity "
        "squared [1]"
    )
    cost_limits: dict[str, Positive] = Field(
        default={}, description="upper bounds of integrals over time, named as in costs [1]"
    )
    limits: dict[str, Range] = Field(
        default={}, description="ranges of quantities during the motion, in their units [m, rad, 1]"
    )
    bounds: dict[str, Range] = Field(default={}, description="ranges of the inputs [rad/s, m/s]")
    accelerations: dict[str, Range] = Field(
        default={}, description="ranges of the time derivatives of the inputs [rad/s2, m/s2]"
    )
    plan: Search = Field(default=Search(), description="options of the search")
    keep_out: Annotated[tuple[KeepOut, ...], Field(strict=False)] = Field(
        default=(), description="regions that no wheel may touch"
    )
    way_points: Annotated[tuple[dict[str, Range], ...], Field(strict=False)] = Field(
        default=(),
        description="ranges as in the goal, at the fraction 'at' of the duration [m, rad]",
    )
    inputs: dict[str, PiecewiseConstant] | None = Field(
        default=None,
        description=f"inputs of the initial guess, rates with any model: {INPUTS}",
    )
    driver: GuideTable | None = Field(
        default=None, description="driving law of the initial guess, instead of inputs"
    )

    alternatives: ClassVar[Mapping[KeyPath, tuple[str, ...]]] = {
        **TerrainKeys.alternatives,
        (): ("inputs", "driver"),
    }

    def faults(self) -> Iterator[Fault]:
        """Yield the errors of common keys, and of options that do not suit the model."""
        yield from super().faults()
        search, driver = self.plan, self.driver
        if driver is not None:
            yield from driver.climbing_faults(self.model)
            if driver.name == STEP_CLIMBING and not self.terrain.obstacles:
                expected = f"solids, [[terrain.obstacles]], with name = {STEP_CLIMBING!r}"
                yield Fault(("driver", "name"), expected, "none; add one")
        if search.intervals > MAX_INTERVALS:
            found = f"{search.intervals}; reduce it, or divide a long plan with 'window'"
            yield Fault(("plan", "intervals"), f"at most {MAX_INTERVALS} intervals", found)
        if self.model != "dynamics":
            if search.sliding:
                found = f"model = {self.model!r}; set model = 'dynamics', or remove the key"
                yield Fault(("plan", "sliding"), "model = 'dynamics', where wheels slide", found)
            return
        given = {
            "window": search.window is not None,
            "robust": search.robust is not None,
            "starts": search.starts > 1,
        }
        for name in (name for name, is_given in given.items() if is_given):
            expected = f"no {name!r} with model = 'dynamics'"
            yield Fault(("plan", name), expected, "it; remove it, or plan without inertia")
