"""Whether friction can hold a vehicle at all, however the forces of its contacts distribute."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import casadi as ca
import numpy as np

from slipfree.contact.closure import Touch, touch
from slipfree.geometry.frame import platform
from slipfree.kinematics.distribution import least_utilisation
from slipfree.kinematics.model import carriers
from slipfree.kinematics.records import Algebraic, Configuration, labels_of
from slipfree.kinematics.statics import Mechanics, mechanics
from slipfree.named import Array, Label, leaves, pack, symbols
from slipfree.terrain.base import Terrain
from slipfree.trajectory import Column, Trajectory
from slipfree.vehicle.chain import Vehicle

LEVEL = 0.005  # slope that is none [rad]
HELD = 0.99  # utilisation up to which friction is not the reason for a failure
BEST = Label(
    "utilisation_best", "1", "least largest utilisation over all distributions of the forces"
)


def best_utilisation(vehicle: Vehicle, terrain: Terrain, run: Trajectory) -> Trajectory:
    """Return a motion with the column ``utilisation_best``.

    Of a vehicle whose contact forces equilibrium leaves open, ``utilisation`` belongs to one
    distribution, the load-weighted one. This is the least that the most used wheel must bear in any
    distribution; above one, friction cannot hold the vehicle. It is infinite where the vehicle
    tips over.

    Parameters
    ----------
    vehicle : Vehicle
        What moved, with mass.
    terrain : Terrain
        What it moved on.
    run : Trajectory
        Of any model of the two.
    """
    labels = labels_of(vehicle, "least")
    sought = labels.x, labels.z.position, labels.z.rates.motion, labels.u
    x, z, u = symbols(labels.x), symbols(labels.z), symbols(labels.u)
    contacts = [
        touch(terrain, place.x, place.y, pose.rotation[:, 0])
        for place, pose in zip(z.position.contacts, carriers(vehicle, x, z.position), strict=True)
    ]
    parts = mechanics(vehicle, terrain, x, z.position, contacts, z.rates, u)
    f = ca.Function("hold", [pack((x, z.position, z.rates.motion, u))], _held(parts))
    origin = dict(zip(("x", "y", "z"), terrain.origin, strict=True))
    origin |= {f"contact_{axis}": origin[axis] for axis in ("x", "y")}
    rows = np.array([run.of(label) - origin.get(label.name, 0.0) for label in leaves(sought)])
    columns, loads, friction = (np.array(out) for out in f.map(run.t.size)(rows))
    matrix = columns.reshape(len(columns), run.t.size, -1).transpose(1, 0, 2)
    best = least_utilisation(matrix, loads.T, friction.T)
    return replace(run, columns={**run.columns, BEST.name: Column(BEST, best.utilisation)})


def _held(parts: Mechanics) -> list[ca.SX]:
    """Return equilibrium's matrix and load, over the weight, and friction at the wheels."""
    return [parts.free.T, parts.load / parts.weight, ca.vertcat(*parts.friction)]


def diagnosis(
    parts: Mechanics, contacts: Sequence[Touch], x: Configuration, z: Algebraic
) -> Callable[[Array, Array], str]:
    """Return what says, of a state, which friction it would take to hold the vehicle there.

    It says nothing where friction does hold it.
    """
    normal = sum((each.normal for each in contacts), ca.SX.zeros(3))
    uphill, slope = -normal[:2], ca.acos(normal[2] / ca.norm_2(normal))
    base = platform(x.x, x.y, z.position.z, x.heading, z.position.roll, z.position.pitch)
    forward = base.rotation[:2, 1]
    aside = ca.fabs(uphill[0] * forward[1] - uphill[1] * forward[0])
    angles = [slope, ca.atan2(aside, ca.dot(uphill, forward))]
    f = ca.Function("hold", [pack(x), pack(z)], [*_held(parts), *angles])

    def describe(x: Array, z: Array) -> str:
        matrix, load, friction, slope, aside = (np.array(each) for each in f(x, z))
        factor = float(least_utilisation(matrix[None], load.T, friction.T).utilisation[0])
        place = (
            f"headed {np.degrees(aside.item()):.0f} degrees from uphill on a slope of "
            f"{np.degrees(slope.item()):.1f} degrees"
            if slope > LEVEL
            else "on level ground"
        )
        if factor < HELD:
            return ""
        if np.isinf(factor):
            return f"no quasi-static equilibrium: {place} the vehicle tips over"
        low, high = friction.min(), friction.max()
        even = high - low < 1e-9 * high
        offered = f"{low:.4g}" if even else f"{low:.4g} to {high:.4g}"
        needed = (
            f"a coefficient of friction of at least {factor * low:.4g}"
            if even
            else f"{factor:.4g} times the friction that it finds"
        )
        return (
            f"no quasi-static equilibrium: {place} the vehicle needs {needed}, "
            f"the ground offers {offered}"
        )

    return describe
