"""Keys of the problems with ``verb = "plan"``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from slipfree.files.toml.source_lines import Place as KeyPath
from slipfree.files.toml.types import (
    NonNegative,
    Pair,
    PiecewiseConstant,
    Positive,
    Range,
    Record,
)
from slipfree.problem.schema import INPUTS, VERB, Driver, Modelled, Task


class Guide(Driver):
    """What starts the search: a driving law, along paths or along routes over the ground."""

    name: Literal["straight", "follow", "route"] = Field(  # type: ignore[assignment]
        description="of the law; a route is sought over the map"
    )
    turning_radius: NonNegative = Field(default=1.0, description="of a route, at least [m]")
    paths: Annotated[
        tuple[Annotated[tuple[Pair, ...], Field(strict=False)], ...] | None,
        Field(strict=False, min_length=1),
    ] = Field(default=None, description="several paths of way-points: the cheapest plan counts [m]")
    count: Annotated[int, Field(ge=1)] = Field(
        default=1, description="of routes: of the plans they lead to the cheapest counts"
    )


class KeepOut(Record):
    """A place that the vehicle must not touch: a disc, or a polygon."""

    x: float | None = Field(default=None, description="of a disc's middle [m]")
    y: float | None = Field(default=None, description="of a disc's middle [m]")
    radius: Positive | None = Field(default=None, description="of a disc [m]")
    points: Annotated[tuple[Pair, ...], Field(strict=False)] | None = Field(
        default=None, description="corners of a polygon [m]"
    )


class Search(Record):
    """How a plan is sought."""

    intervals: Annotated[int, Field(ge=1)] = Field(
        default=40, description="of the mesh, to begin with"
    )
    degree: Annotated[int, Field(ge=1, le=5)] = Field(
        default=3, description="of the polynomials on an interval"
    )
    duration: Range = Field(
        default=None, description="of the plan; default: that of the motion it starts from [s]"
    )
    smooth: NonNegative = Field(
        default=0.0, description="weight of the squared rates of the inputs [1]"
    )
    continuous: bool = Field(
        default=True, description="inputs are linear on an interval without jumps; else constant"
    )
    accuracy: Positive = Field(
        default=1e-3,
        description="by which the simulation may miss the plan and its limits [m, rad]",
    )


class Plan(Modelled):
    """A plan: the inputs that reach a goal at the least cost; a driving law starts the search."""

    verb: Literal["plan"] = Field(description=VERB)
    goal: dict[str, Range] = Field(description="at the end, any state or unknown by name [m, rad]")
    costs: dict[str, NonNegative] = Field(
        description="weights of integrals over time: slip, effort, time, energy, or any quantity "
        "squared [1]"
    )
    limits: dict[str, Range] = Field(
        default={}, description="along the way, any quantity of the result, in its unit [m, rad, 1]"
    )
    bounds: dict[str, Range] = Field(default={}, description="of the inputs [rad/s, m/s]")
    accelerations: dict[str, Range] = Field(
        default={}, description="bounds of the inputs' rates [rad/s2, m/s2]"
    )
    plan: Search = Field(default=Search(), description="how it is sought")
    keep_out: Annotated[tuple[KeepOut, ...], Field(strict=False)] = Field(
        default=(), description="places that no wheel may touch"
    )
    way_points: Annotated[tuple[dict[str, Range], ...], Field(strict=False)] = Field(
        default=(), description="like the goal, each at a part of the duration [m, rad]"
    )
    inputs: dict[str, PiecewiseConstant] | None = Field(
        default=None, description=f"of the motion that starts the search: {INPUTS}"
    )
    driver: Guide | None = Field(default=None, description="what starts the search instead")

    alternatives: ClassVar[Mapping[KeyPath, tuple[str, ...]]] = {
        **Task.alternatives,
        (): ("inputs", "driver"),
    }
