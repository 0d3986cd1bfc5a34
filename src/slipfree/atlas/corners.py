"""Models of a vehicle on a ground that is shifted vertically under each wheel.

A ground within an error of the map acts on a pose like one shift of each wheel. If a quantity is
monotone in the shifts, its extremes are those at the corners of the cube of shifts.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import casadi as ca

from slipfree.core.dae import Dae, Parameter
from slipfree.core.errors import ModelError
from slipfree.core.lookups import needed_lookups
from slipfree.core.rearrange import substitute
from slipfree.core.records import Label

HEIGHT = 2  # row of the height in the result of a lookup, which follows the centre of the cell


@lru_cache(maxsize=4)
def shifted_model(model: Dae) -> Dae:
    """Return a model whose last parameters are shifts of the ground under its wheels [m].

    The result has no checks, which know the map only. ModelError is raised if the ground is not a
    map.
    """
    heights, shifts, wheels = list[ca.SX](), list[Parameter](), model.vehicle.wheels
    closures = ca.vertsplit(model.residuals[0], model.residuals[0].numel() // len(wheels))
    for wheel, closure in zip(wheels, closures, strict=True):
        lookups = needed_lookups(model.lookups, [closure])
        if len(lookups) != 1 or lookups[0].cells is None:
            raise ModelError(
                f"atlas: expected a map (Bicubic) with 'error', found {type(model.ground).__name__}"
                "; sample the ground on a grid"
            )
        heights.append(lookups[0].found[HEIGHT])
        words = f"shift of the ground under wheel {wheel.name}"
        shifts.append(Parameter(Label("shift", "m", words, wheel.name), ca.SX.sym("shift"), 0.0))
    values = [height + each.symbol for height, each in zip(heights, shifts, strict=True)]
    holding = model.holding
    if holding is not None:
        parts = [part for part in holding if part is not None]
        moved = ca.substitute(parts, [ca.vertcat(*heights)], [ca.vertcat(*values)])
        holding = type(holding)(*moved)
    new = substitute(model, heights, values)
    return replace(new, holding=holding, checks=(), p=(*model.p, *shifts))
