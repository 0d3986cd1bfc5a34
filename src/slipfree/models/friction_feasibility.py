"""Friction feasibility: the least utilisation of friction over all equilibrium contact forces."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import casadi as ca
import numpy as np

from slipfree.contact.closure import check_exact_closure, contact_frame
from slipfree.core.errors import ModelError
from slipfree.core.lookups import LookupTable, lookup_function
from slipfree.core.records import Array, Label, leaves, pack, symbols
from slipfree.core.trajectory import Column, Trajectory
from slipfree.geometry.frame import platform
from slipfree.models.base import carriers
from slipfree.models.force_distribution import least_utilisation
from slipfree.models.labels import labels_of
from slipfree.models.quantities import Mechanics, Quantities
from slipfree.models.records import Algebraic
from slipfree.models.statics import mechanics
from slipfree.terrain.base import Terrain
from slipfree.vehicle.tree import Vehicle

MAX_LEVEL_SLOPE = 0.005  # smaller slopes count as level ground [rad]
MAX_HELD_UTILISATION = 0.99  # below it, friction is not the reason for a failure
MAX_EXHAUSTED_UTILISATION = 1.001  # below it, friction is just exhausted
MAX_UPRIGHT_LEAN = 0.02  # a wheel with a smaller lean counts as upright [rad]
BEST = Label("utilisation_best", "1", "smallest possible utilisation of the most used wheel")


def best_utilisation(vehicle: Vehicle, terrain: Terrain, run: Trajectory) -> Trajectory:
    """Return a motion with the additional column ``utilisation_best``.

    If equilibrium does not determine the contact forces, ``utilisation`` is computed for one
    distribution, the load-weighted one. ``utilisation_best`` is the largest utilisation among the
    wheels, minimised over all distributions; above one, friction cannot hold the vehicle. It is
    infinite where no contact forces balance the vehicle, because the vehicle tips over or a wheel
    or joint is free to move. It is NaN where the optimisation does not converge, or where the
    friction is not positive or a value is not finite.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle, with mass.
    terrain : Terrain
        The ground; without a friction coefficient, the utilisation is that for the coefficient 1.
    run : Trajectory
        A motion of any model of the vehicle on this ground.

    Raises
    ------
    ModelError
        If the vehicle has no mass, if not all of its wheels can touch a rigid ground, or if the
        motion lacks a coordinate or a rate.
    """
    if not vehicle.mass:
        raise ModelError(
            f"best friction utilisation: expected a vehicle with mass, found none in "
            f"{vehicle.name!r}; give its platform or its wheels a mass"
        )
    check_exact_closure(
        vehicle,
        "best friction utilisation",
        "use 'utilisation', which holds for the loads of pressed wheels",
    )
    labels = labels_of(vehicle)
    required = labels.x, labels.z.position, labels.z.rates.motion, labels.u
    x, z, u = symbols(labels.x), symbols(labels.z), symbols(labels.u)
    lookups = LookupTable()
    contacts = [
        contact_frame(terrain, place.x, place.y, pose.rotation[:, 0], lookups)
        for place, pose in zip(z.position.contacts, carriers(vehicle, x, z.position), strict=True)
    ]
    parts = mechanics(vehicle, terrain, x, z.position, contacts, z.rates, u, lookups)
    given = [pack((x, z.position, z.rates.motion, u))]
    f = lookup_function(lookups.lookups, "hold", given, _equilibrium_terms(parts))
    origin = dict(zip(("x", "y", "z"), terrain.origin, strict=True))
    origin |= {f"contact_{axis}": origin[axis] for axis in ("x", "y")}
    rows = np.array([run.of(label) - origin.get(label.name, 0.0) for label in leaves(required)])
    columns, loads, friction = (np.array(out) for out in f.map(run.t.size)(rows))
    matrix = columns.reshape(len(columns), run.t.size, -1).transpose(1, 0, 2)
    known = np.isfinite(matrix).all(axis=(1, 2)) & (friction > 0).all(axis=0)
    best = np.full(run.t.size, np.nan)
    found = least_utilisation(matrix[known], loads.T[known], friction.T[known])
    best[known] = found.utilisation
    return replace(run, columns={**run.columns, BEST.name: Column(BEST, best)})


def _equilibrium_terms(parts: Mechanics) -> list[ca.SX]:
    """Return the equilibrium's matrix, its load divided by the weight, and the wheels' friction."""
    return [parts.free.T, parts.load / parts.weight, ca.vertcat(*parts.friction)]


def diagnosis(z: Algebraic, q: Quantities) -> Callable[[Array, Array], str]:
    """Return a function ``describe(x, z)`` that reports why there is no equilibrium at a state.

    The text names the friction needed, and the largest lean of a wheel if it exceeds 0.02 rad. It
    is empty if friction holds the vehicle or the friction needed cannot be computed.
    """
    x, contacts = q.x, q.contacts
    normal = sum((each.normal for each in contacts), ca.SX.zeros(3))
    uphill, slope = -normal[:2], ca.acos(normal[2] / ca.norm_2(normal))
    base = platform(x.x, x.y, z.position.z, x.heading, z.position.roll, z.position.pitch)
    forward = base.rotation[:2, 1]
    aside = ca.fabs(uphill[0] * forward[1] - uphill[1] * forward[0])
    angles = [slope, ca.atan2(aside, ca.dot(uphill, forward))]
    lean = ca.acos(ca.fmin(ca.mmin(ca.vertcat(*(each.uprightness for each in contacts))), 1))
    results = [*_equilibrium_terms(q.mechanics), *angles, q.tip_over_margin, lean]
    f = lookup_function(q.lookups.lookups, "hold", [pack(x), pack(z)], results)

    def describe(x: Array, z: Array) -> str:
        matrix, load, friction, *rest = (np.array(each) for each in f(x, z))
        slope, aside, margin, lean = (float(each.item()) for each in rest)
        if not all(np.isfinite(each).all() for each in (matrix, load, friction)):
            return ""
        factor = float(least_utilisation(matrix[None], load.T, friction.T).utilisation[0])
        place = "on level ground"
        if slope > MAX_LEVEL_SLOPE:
            place = (
                f"headed {np.degrees(aside):.0f} degrees from uphill on a slope of "
                f"{np.degrees(slope):.1f} degrees"
            )
        words = _friction_words(factor, friction, tips=margin < 0)
        leans = f"; a wheel leans by {lean:.3g} rad" if lean > MAX_UPRIGHT_LEAN else ""
        return f"no quasi-static equilibrium: {place} {words}{leans}" if words else ""

    return describe


def _friction_words(factor: float, friction: Array, *, tips: bool) -> str:
    """Return the reason why there is no quasi-static equilibrium; empty if friction suffices.

    ``factor`` is the least utilisation, ``friction`` the wheels' coefficients of friction. The text
    is empty also if ``factor`` is NaN.
    """
    if tips:
        return "the vehicle tips over"
    if np.isinf(factor):
        return (
            "no contact forces balance the vehicle: a wheel without drive or a passive joint is "
            "free to move"
        )
    low, high = friction.min(), friction.max()
    even = high - low < 1e-9 * high
    offered = f"{low:.4g}" if even else f"{low:.4g} to {high:.4g}"
    if not factor >= MAX_HELD_UTILISATION:  # also for NaN
        return ""
    if factor < MAX_EXHAUSTED_UTILISATION:
        return f"the vehicle needs all the friction that the ground offers, {offered}"
    needed = (
        f"a coefficient of friction of at least {factor * low:.4g}"
        if even
        else f"{factor:.4g} times the friction of the ground"
    )
    return f"the vehicle needs {needed}, the ground offers {offered}"
