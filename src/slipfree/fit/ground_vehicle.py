"""Motion over a map of a vehicle of the package, by the batch.

The commanded speeds of the sides are the rim speeds of the driven wheels on either side with their
nominal radii. The vehicle stands at the start of a window by its closure or its balance of forces,
and each motion has its own values of the unknowns, so that all derivatives come from one batch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from slipfree.batch.evaluator import Evaluator, evaluator_of
from slipfree.batch.many import run_lanes, stand, start_states
from slipfree.batch.motion import candidate_lanes
from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, leaves
from slipfree.fit.body_motion import MotionError
from slipfree.fit.ground_motion import DRIVES_AND_SENSORS, ComplexArray, MotionModel, Slopes, Tour
from slipfree.fit.ground_motion import Values as LaneValues
from slipfree.fit.unknowns import (
    Unknown,
    label_of,
    lateral_places,
    limits_of,
    parametric_model,
    value_of,
)
from slipfree.terrain.base import Friction, Terrain
from slipfree.terrain.bicubic import Bicubic
from slipfree.vehicle.tree import Vehicle

LANES = 512  # computed together; lanes of similar length
STEP = 0.5  # longest step [size of the vehicle]
Build = Callable[[Terrain, Vehicle, Any], Dae]


class _Driven(NamedTuple):
    """A vehicle that is driven by the speeds of its sides."""

    build: Build
    vehicle: Vehicle
    law: Any
    unknowns: tuple[Unknown, ...]
    friction: Friction


def vehicle_model(
    words: str,
    build: Build,
    vehicle: Vehicle,
    law: Any,
    unknowns: Sequence[Unknown],
    friction: Friction,
) -> MotionModel:
    """Return the motion of a vehicle with unknowns of it and of its law.

    Parameters
    ----------
    words : str
        Name of the model in messages and tables.
    build : callable
        ``build(ground, vehicle, law)`` returns the model, of kinematics or quasi-statics.
    vehicle : Vehicle
        Vehicle with nominal values; all of its inputs are rates of driven wheels.
    law : object
        Law of the model, with nominal values.
    unknowns : sequence of Unknown
        Unknowns; those of drives and sensors are left to `with_drives_and_sensors`.
    friction : float, Grid, callable or None
        Coefficient of friction of the ground, as for `Bicubic`. [1]
    """
    own = tuple(each for each in unknowns if each.quantity not in DRIVES_AND_SENSORS)
    start = {each.name: value_of(each, vehicle, law) for each in own}
    bounds = {each.name: limits_of(each, vehicle, law) for each in own}
    return MotionModel(
        words,
        {name: float(np.clip(value, *bounds[name])) for name, value in start.items()},
        bounds,
        {each.name: label_of(each, law).unit for each in own},
        partial(_paths, _Driven(build, vehicle, law, own, friction)),
    )


def _paths(driven: _Driven, values: LaneValues, tour: Tour) -> tuple[ComplexArray, Array]:
    """Return positions (complex) and headings along paths that the vehicle drives on the map."""
    evaluate, sides = _over(driven, tour.slopes)
    graphs = evaluate.graphs
    rows, names = graphs.rows, [label.full for label in leaves(graphs.dae.labels.x)]
    x, y, heading = (names.index(name) for name in ("x", "y", "heading"))
    count = len(tour.left)
    places = np.full((count + 1, len(tour.place)), np.nan, dtype=complex)
    headings = places.real.copy()
    step = STEP * graphs.dae.size
    for first in range(0, len(tour.place), LANES):
        part = slice(first, first + LANES)
        steps = np.minimum(tour.steps[part], count)  # the first lane is the longest
        t = tour.dt * np.arange(steps[0] + 1)
        start = {"x": tour.place[part].real, "y": tour.place[part].imag}
        states = start_states(graphs, start | {"heading": tour.heading[part] - np.pi / 2})
        states[rows.c] = [values[each.label.name][part] for each in graphs.dae.p]
        inputs = np.stack(
            [
                (tour.left if on_left else tour.right)[: steps[0], part] / radius
                for on_left, radius in sides
            ]
        )
        stands = stand(evaluate, states)
        motions = candidate_lanes(evaluate, states.copy(), inputs, t, step)
        reached = np.isfinite(motions.samples[:, x]).sum(axis=0) > steps
        if not (stands & reached).all():
            k = int(np.argmin(stands & reached))
            place = tour.place[first + k]
            message = _reason(evaluate, states[:, [k]], inputs[..., [k]], t, place)
            raise MotionError(message, first + k)
        shift = graphs.dae.shift[0]
        own = motions.samples[:, [x, y, heading]] + shift[[x, y, heading], None]
        places[: t.size, part] = own[:, 0] + 1j * own[:, 1]
        headings[: t.size, part] = own[:, 2] + np.pi / 2
    return places, headings


def _reason(evaluate: Evaluator, states: Array, inputs: Array, t: Array, place: complex) -> str:
    """Return the message of a motion that ends early."""
    lanes = run_lanes(evaluate, states, inputs, t, quantities=["x", "y"])
    numbers = states[evaluate.graphs.rows.c, 0]
    constants = ", ".join(
        f"{each.label.name} = {value:.4g}"
        for each, value in zip(evaluate.graphs.dae.p, numbers, strict=True)
    )
    return (
        f"expected a motion of the vehicle from x = {place.real:.2f}, y = {place.imag:.2f} m"
        f"{f' with {constants}' if constants else ''}, found "
        f"{lanes.reasons[0] or 'contacts that the batch does not follow'}; remove trees and "
        "buildings from the map, increase 'smoothing', or give bounds of the unknowns"
    )


@lru_cache(maxsize=8)
def _over(driven: _Driven, slopes: Slopes) -> tuple[Evaluator, list[tuple[bool, float]]]:
    """Return the model over a map, and for each input whether its wheel is left, and its radius."""
    vehicle, ground = driven.vehicle, Bicubic(slopes.grid, mu=driven.friction)
    build = partial(driven.build, ground)
    dae = parametric_model(build, vehicle, driven.law, driven.unknowns)
    wheels = {
        f"{wheel.name}_rate": (place < 0, float(wheel.radius))
        for wheel, place in lateral_places(vehicle)
    }
    names = [label.full for label in leaves(dae.labels.u)]
    if others := [name for name in names if name not in wheels]:
        raise ModelError(
            "expected a vehicle whose inputs are the rates of its driven wheels, found "
            f"{', '.join(others)}; use a skid-steered vehicle"
        )
    return evaluator_of(dae), [wheels[name] for name in names]
