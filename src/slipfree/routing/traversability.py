"""What it costs a vehicle to be at a place of a map, and where it cannot be.

The map looks at the ground under the vehicle's footprint in any heading, and knows neither wheels
nor slip.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from typing import NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from slipfree.errors import ModelError
from slipfree.geometry.frame import Pose
from slipfree.records import Array, Mask
from slipfree.routing.footprint import (
    coarse_axes,
    footprint_mean,
    ground_figures,
    nearest_nodes,
    step,
)
from slipfree.routing.regions import Region
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic, friction_map
from slipfree.vehicle.tree import Vehicle

Point = tuple[float, float] | Array

# What a metre costs beyond its length. The steepest slope that can be climbed, and friction used
# to the full, are each worth a detour of four times the length: there is no margin left on them.
# Roughness as large as the wheel is an obstacle, worth ten. Ground that is everywhere too hollow
# for the wheels is worth ten too: it may be straddled, but only by luck.
SLOPE = 4.0
FRICTION = 4.0
ROUGHNESS = 10.0
HOLLOW = 10.0
STEEPEST = math.radians(30)  # where nothing says what friction can hold; loose soil slides at 30-35


class Limits(NamedTuple):
    """What the vehicle can do, as the layers were judged.

    Attributes
    ----------
    steepest : float
        Slope that can be climbed. [rad]
    radius : float
        Of the largest wheel: it is the first that a hollow is too narrow for. [m]
    reach : float
        Radius of the circle about the platform's centre that holds all wheels. [m]
    half : float
        Half the side of the square that stands for the footprint in any heading. [m]
    domain : tuple of 4 floats
        ``x_min, x_max, y_min, y_max`` of the map. [m]
    keep_out : tuple of Region
        Where not to go.
    """

    steepest: float
    radius: float
    reach: float
    half: float
    domain: tuple[float, float, float, float]
    keep_out: tuple[Region, ...]


class Traversability(NamedTuple):
    """What it costs a vehicle to be at a place, and why.

    Attributes
    ----------
    x, y : ndarray, shape (n_x,) and (n_y,)
        Axes in map coordinates. [m]
    cost : ndarray, shape (n_x, n_y)
        Of a metre; infinite where the vehicle's centre must not be. [1]
    slope : ndarray, shape (n_x, n_y)
        Of the plane that fits the ground under the footprint. [rad]
    roughness : ndarray, shape (n_x, n_y)
        Root mean square deviation of that ground from its plane. [m]
    hollow : ndarray, shape (n_x, n_y)
        Largest curvature of the ground upwards, in any direction; negative on a dome. [1/m]
    friction : ndarray, shape (n_x, n_y), or None
        Tangent of the slope over the mean friction under the footprint; None if the terrain has
        no friction. [1]
    limits : Limits
        What they were held against.
    """

    x: Array
    y: Array
    cost: Array
    slope: Array
    roughness: Array
    hollow: Array
    friction: Array | None
    limits: Limits

    @property
    def spacing(self) -> tuple[float, float]:
        """Distance between nodes along x and y [m]."""
        return step(self.x), step(self.y)


def traversability(
    terrain: Bicubic,
    vehicle: Vehicle,
    *,
    keep_out: Iterable[Region] = (),
    steepest: float | None = None,
    spacing: float | None = None,
) -> Traversability:
    """Return where a vehicle can go on a map and at what cost.

    Parameters
    ----------
    terrain : Bicubic
        The ground, with its friction if it has one.
    vehicle : Vehicle
        Its wheels, in its zero configuration, give the footprint.
    keep_out : iterable of Region
        Places that no wheel may touch.
    steepest : float, optional
        Slope that can be climbed; by default what the largest friction can hold, or 30 degrees
        on a ground without friction. [rad]
    spacing : float, optional
        Distance between nodes; by default that of the grid, or a third of half the vehicle's
        smaller extent if that is more. [m]

    Returns
    -------
    Traversability
        Blocked is a node where the slope is steeper than ``steepest`` or than friction can hold in
        any heading, where its roughness reaches the radius of the largest wheel, where the ground
        is more hollow than that wheel is round, from where a wheel may reach over the edge of the
        map, or into a region to keep out of.

    Raises
    ------
    ModelError
        If ``steepest`` is not an angle below a right one, or ``spacing`` not positive or too large.

    Notes
    -----
    A metre costs ``1 + 4 (slope / steepest)**2 + 4 friction**2 + 10 (roughness / radius)**2``
    and ten times the share of the ground under the footprint that is too hollow. Hollow ground
    blocks the vehicle's centre; that every wheel stays out of it takes the heading, which a plan
    decides and a route does not. The wheel with the best grip decides what friction can hold.
    """
    right, forward, reach = extents(vehicle)
    half, radius = math.sqrt(right * forward), max(wheel.radius for wheel in vehicle.wheels)
    grip = max(wheel.grip for wheel in vehicle.wheels)
    if spacing is None:
        spacing = max(*terrain.grid.spacing, min(right, forward) / 3)
    x, y = coarse_axes(terrain.grid, spacing)
    slope, roughness, hollow, share = ground_figures(terrain.grid, x, y, half, 1 / radius)
    held = _friction(terrain, x, y, half)
    held = None if held is None else held * grip
    if steepest is None:
        steepest = STEEPEST if held is None else math.atan(held.max())
    if not 0 < steepest < math.pi / 2:
        raise ModelError(
            f"traversability: steepest must lie between 0 and pi/2 radians, found {steepest}"
        )
    used = None if held is None else np.tan(slope) / held
    limits = Limits(steepest, radius, reach, half, terrain.domain, tuple(keep_out))
    cost = 1 + SLOPE * (slope / steepest) ** 2 + ROUGHNESS * (roughness / radius) ** 2
    cost += HOLLOW * share
    if used is not None:
        cost += FRICTION * used**2
    layers = Traversability(x, y, cost, slope, roughness, hollow, used, limits)
    cost[np.logical_or.reduce([*blocked_by(layers).values()])] = math.inf
    return layers


def reasons(layers: Traversability, x: float, y: float) -> str:
    """Return in words why a vehicle cannot be at a place of the map; empty if it can.

    Parameters
    ----------
    layers : Traversability
        The map.
    x, y : float
        Map coordinates. [m]
    """
    off = to_edge(layers.limits, np.asarray(x), np.asarray(y)) < 0
    i, j = node_at(layers, x, y)
    if not off and math.isfinite(layers.cost[i, j]):
        return ""
    at = (x, y) if off else (float(layers.x[i]), float(layers.y[j]))
    return "; ".join(faults(layers, *at).values())


def extents(vehicle: Vehicle) -> tuple[float, float, float]:
    """Return half the width and the length of the vehicle, and the circle that holds it [m].

    A wheel may be steered and tilted: from its centre it reaches its radius in every direction,
    but counts towards width and length as it stands straight.
    """
    rest = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    poses = vehicle.carriers(rest, {c.name: ca.SX(0) for c in vehicle.coordinates})
    at = np.array([np.array(ca.evalf(pose.origin)).ravel()[:2] for pose in poses])
    radius = np.array([wheel.radius for wheel in vehicle.wheels])
    half_width = np.array([wheel.half_width for wheel in vehicle.wheels])
    size = np.stack([half_width, radius], axis=1)
    right, forward = 0.5 * ((at + size).max(axis=0) - (at - size).min(axis=0))
    return float(right), float(forward), float((np.hypot(*at.T) + radius).max())


# Layers


def _friction(terrain: Bicubic, x: Array, y: Array, half: float) -> Array | None:
    """Return the mean friction under the footprint, None if the terrain has none [1]."""
    mu = terrain.mu
    if mu is None:
        return None
    if isinstance(mu, float | int):
        return np.full((x.size, y.size), float(mu))
    if isinstance(mu, Grid):
        surface = friction_map(mu, terrain.origin[:2])
        at_nodes = surface.elevation(x[:, None], y[None, :]) if surface else np.empty(0)
    else:
        at_nodes = _formula(mu, x, y)
    return footprint_mean(at_nodes, (step(x), step(y)), half)


def _formula(function: Callable[[ca.SX, ca.SX], ca.SX], x: Array, y: Array) -> Array:
    """Return the values of a formula on a grid, one line along y after the other."""
    at, line = ca.SX.sym("x"), ca.SX.sym("y", y.size)
    values = [ca.SX(function(at, line[j])) for j in range(y.size)]
    f = ca.Function("friction", [at, line], [ca.vertcat(*values)])
    return np.array([np.array(f(float(each), y)).ravel() for each in x])


def blocked_by(layers: Traversability) -> dict[str, Mask]:
    """Return where the vehicle's centre must not be, by what keeps it from there.

    Parameters
    ----------
    layers : Traversability
        The map.

    Returns
    -------
    dict of str to ndarray, shape (n_x, n_y)
        ``edge, slope, friction, roughness, hollow, keep_out``; a node may be in several.
    """
    x, y, limits = layers.x[:, None], layers.y[None, :], layers.limits
    keep_out = np.zeros(layers.cost.shape, dtype=bool)
    for region in limits.keep_out:
        part = window(layers, region.bounds, limits.reach)
        inside = region.distance(*np.broadcast_arrays(x[part[0]], y[:, part[1]])) < limits.reach
        keep_out[part] |= inside
    return {
        "edge": to_edge(limits, x, y) < limits.reach,
        "slope": layers.slope > limits.steepest,
        "friction": np.zeros_like(keep_out) if layers.friction is None else layers.friction >= 1,
        "roughness": layers.roughness >= limits.radius,
        "hollow": layers.hollow * limits.radius >= 1,
        "keep_out": keep_out,
    }


def to_edge(limits: Limits, x: Array, y: Array) -> Array:
    """Return the distance from points of the map to its edge, negative outside [m]."""
    x_min, x_max, y_min, y_max = limits.domain
    inside = np.minimum(np.minimum(x - x_min, x_max - x), np.minimum(y - y_min, y_max - y))
    outside = np.hypot(
        np.maximum(np.maximum(x_min - x, x - x_max), 0),
        np.maximum(np.maximum(y_min - y, y - y_max), 0),
    )
    return np.asarray(np.where(inside < 0, -outside, inside))


def window(
    layers: Traversability, bounds: tuple[float, float, float, float], room: float
) -> tuple[slice, slice]:
    """Return the part of the grid within some room of a rectangle."""
    i = np.searchsorted(layers.x, (bounds[0] - room, bounds[1] + room)).tolist()
    j = np.searchsorted(layers.y, (bounds[2] - room, bounds[3] + room)).tolist()
    return slice(*i), slice(*j)


def faults(layers: Traversability, x: float, y: float) -> dict[str, str]:
    """Return in words what keeps a vehicle from a place of the map, by the names of `blocked_by`.

    Edge and places to keep out of are those of the place itself, the ground is that of the nearest
    node. Off the map there is but the edge.

    Parameters
    ----------
    layers : Traversability
        The map.
    x, y : float
        Map coordinates. [m]
    """
    limits, words = layers.limits, {}
    inside = float(to_edge(limits, np.asarray(x), np.asarray(y)))
    if inside < 0:
        return {"edge": f"{-inside:.3g} m outside the map"}
    if inside < limits.reach:
        words["edge"] = (
            f"{inside:.3g} m from the edge of the map, where wheels reach {limits.reach:.3g} m"
        )
    words |= _ground_faults(layers, *node_at(layers, x, y))
    near = [
        f"inside the keep-out {region.words}"
        if distance < 0
        else f"{distance:.3g} m from the keep-out {region.words}, where wheels reach "
        f"{limits.reach:.3g} m"
        for region in limits.keep_out
        if (distance := float(region.distance(np.asarray(x), np.asarray(y)))) < limits.reach
    ]
    return words | ({"keep_out": "; ".join(near)} if near else {})


def _ground_faults(layers: Traversability, i: int, j: int) -> dict[str, str]:
    """Return in words what is wrong with the ground at a node."""
    limits, words, slope = layers.limits, {}, float(layers.slope[i, j])
    used = 0.0 if layers.friction is None else float(layers.friction[i, j])
    if used >= 1:
        words["friction"] = (
            f"slope of {math.degrees(slope):.3g} degrees needs a friction coefficient of "
            f"{math.tan(slope):.3g}, the ground offers {math.tan(slope) / used:.3g}"
        )
    elif slope > limits.steepest:
        words["slope"] = (
            f"slope of {math.degrees(slope):.3g} degrees, at most "
            f"{math.degrees(limits.steepest):.3g} can be climbed"
        )
    if layers.roughness[i, j] >= limits.radius:
        words["roughness"] = (
            f"roughness of {layers.roughness[i, j]:.3g} m, as large as a wheel of "
            f"{limits.radius:.3g} m"
        )
    if layers.hollow[i, j] * limits.radius >= 1:
        words["hollow"] = (
            f"hollow of {1 / layers.hollow[i, j]:.3g} m radius, too narrow for a wheel of "
            f"{limits.radius:.3g} m"
        )
    return words


# Nodes


def nodes_at(
    layers: Traversability, points: Array
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return the nodes nearest to points, shape (n, 2)."""
    return nearest_nodes(layers.x, points[:, 0]), nearest_nodes(layers.y, points[:, 1])


def node_at(layers: Traversability, x: float, y: float) -> tuple[int, int]:
    """Return the node nearest to a place of the map."""
    i, j = nodes_at(layers, np.array([[x, y]]))
    return int(i[0]), int(j[0])


def placed(point: Point) -> str:
    """Return a point as it is printed."""
    x, y = (round(float(each), 2) for each in point)
    return f"({x:.10g}, {y:.10g})"
