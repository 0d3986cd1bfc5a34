"""Find zero crossings of expressions along a motion by sign changes between samples."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import casadi as ca
import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.evaluation import evaluate
from slipfree.core.lookups import found_column
from slipfree.core.records import Array, field_overview
from slipfree.solve.sampling import Samples
from slipfree.solve.system import System


class Event(NamedTuple):
    """A zero crossing of an expression along a motion, in either direction.

    Attributes
    ----------
    expression : SX, shape (1, 1)
        Expression in the symbols of the model; positions in it are local
        (:ref:`local-and-map-coordinates`).
    stop : bool
        Whether the motion ends at the first crossing, with a stop called ``name``.
    name : str
        Key of the times in `Trajectory.events`.
    """

    expression: ca.SX
    stop: bool = False
    name: str = "event"

    def __repr__(self) -> str:
        return field_overview(self)


class WatchedEvent(NamedTuple):
    """An event, and its expression as a function of ``t, x, z`` and the values of the inputs."""

    event: Event
    function: ca.Function


def watch_events(dae: Dae, events: Sequence[Event]) -> tuple[WatchedEvent, ...]:
    """Return the events with their expressions as functions.

    Raises
    ------
    ModelError
        If a name is used by two events or by a limit of the model, or an expression is not a scalar
        in the symbols of the model.
    """
    symbols, watched = (dae.t, *dae.columns()), list[WatchedEvent]()
    names = {limit.label.full for limit in dae.limits}
    for event in events:
        name, expression = event.name, event.expression
        if name in names:
            raise ModelError(
                f"events: expected a different name for each event and limit, found {name!r} "
                "twice; rename the event"
            )
        names.add(name)
        if not isinstance(expression, ca.SX) or expression.shape != (1, 1):
            raise ModelError(
                f"event {name!r}: expected a scalar SX, found {expression!r}; use one expression "
                "in the symbols of the model"
            )
        (expression,) = dae.without_continuation([expression])
        known = [*symbols, found_column(dae.lookups)]
        if free := ca.Function("event", known, [expression], {"allow_free": True}).free_sx():
            raise ModelError(
                f"event {name!r}: expected symbols of the model, found {free[0]}; use "
                "the symbols of its Dae"
            )
        watched.append(
            WatchedEvent(event, dae.function("event", symbols, [ca.densify(expression)]))
        )
    return tuple(watched)


def event_values(watched: WatchedEvent, system: System, samples: Samples) -> Array:
    """Return the values of an event's expression, shape (n,), at samples."""
    at = samples.t[None], samples.x, samples.z
    inputs = evaluate(system.outputs, *at, samples.u)[2]
    (values,) = evaluate(watched.function, *at, inputs)
    return values.reshape(-1)


def crossing_indices(
    watched: WatchedEvent, system: System, samples: Samples, tolerance: float
) -> list[int]:
    """Return the indices of the first samples at or after the zero crossings of an event.

    A first value within the tolerance of zero counts as zero and begins no crossing.
    """
    values = event_values(watched, system, samples)
    if abs(values[0]) <= tolerance:
        values[0] = 0.0
    before, after = values[:-1], values[1:]
    crossed = ((before < 0) & (after >= 0)) | ((before > 0) & (after <= 0))
    return [int(k) + 1 for k in np.flatnonzero(crossed)]
