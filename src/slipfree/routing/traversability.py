"""Traversability of a map: costs of the poses of a vehicle, and blocked positions.

Costs are those of exact poses at several headings (`slipfree.atlas`), at nodes about a third of
its size or a quarter of a cell of the map apart, and interpolated between them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from slipfree.atlas.atlas import Atlas, atlas
from slipfree.batch.evaluator import evaluator_of
from slipfree.core.arguments import checked
from slipfree.core.errors import ModelError
from slipfree.core.records import Array, Mask
from slipfree.core.schema import Finite, Positive
from slipfree.geometry.regions import Region
from slipfree.models.kinematics import direct_kinematics
from slipfree.system.codegen_cache import compiler_limit
from slipfree.terrain.base import Grid, axis_step
from slipfree.terrain.bicubic import Bicubic
from slipfree.terrain.grid_ops import hole_distance
from slipfree.vehicle.tree import Vehicle

Point = tuple[Finite, Finite] | Array
# Costs per metre, added to the cost 1 of level ground. An inclination of `STEEP`, full use of the
# friction, and a pose about to tip over leave no margin: each adds 4.
INCLINATION = 4.0
FRICTION = 4.0
TIPPING = 4.0
SLIDING = 30.0  # where friction is not enough: routes avoid it by long detours
STEEP = math.radians(30)  # loose soil slides at 30 to 35 degrees
MAX_UTILISATION = 1.5  # poses between nodes and headings may need less: only more than this blocks
QUANTITIES = "roll", "pitch", "utilisation", "tip_over_margin"
HEADINGS = 8  # moves between two of them take the mean of their costs
AWAY = 4  # times as far apart are poses away from the places, and half their distance around them
MAX_POSES = 250_000  # on larger maps the nodes of the poses are farther apart
CELL_POSES = 4  # poses per cell of the map, between whose nodes the ground is smooth, are enough
INTERPRETED = 20_000  # number of poses up to which compiling the equations takes longer
MAP_SHARE = 0.2  # of the time limit of a plan; compilations for its map end after it
RESTING = 5  # times for a pose of pressed wheels, relative to exact contact
UNKNOWN = 1e-6  # weight of nodes that are blocked anyway, for the interpolation


class Limits(NamedTuple):
    """Limits of the vehicle's positions.

    Attributes
    ----------
    reach : float
        Radius of the circle about the platform's centre that contains all wheels. [m]
    half : float
        Half the side of the square that represents the footprint in any heading. [m]
    domain : tuple of 4 floats
        ``x_min, x_max, y_min, y_max`` of the map. [m]
    keep_out : tuple of Region
        Keep-out regions.
    """

    reach: float
    half: float
    domain: tuple[float, float, float, float]
    keep_out: tuple[Region, ...]


class Traversability(NamedTuple):
    """Cost of a map for a vehicle, and the reasons of blocked nodes."""

    x: Array  # shape (n_x,): axes in map coordinates [m]
    y: Array
    heading: Array  # shape (n_headings,): directions of motion, equally spaced from zero [rad]
    cost: Array  # shape (n_headings, n_x, n_y): per metre in a direction; infinite if blocked [1]
    to_hole: Array  # shape (n_x, n_y): distance to a missing height, negative inside [m]
    limits: Limits
    poses: Atlas | None = None  # at some of the nodes; None if poses were not computed

    @property
    def least_cost(self) -> Array:
        """Cost in the best direction, shape (n_x, n_y) [1]."""
        return np.asarray(self.cost.min(axis=0))

    @property
    def spacing(self) -> tuple[float, float]:
        """Distances between neighbouring nodes along x and along y [m]."""
        return axis_step(self.x), axis_step(self.y)

    def cost_toward(self, direction: Array | float, *at: Any) -> Array:
        """Return the cost in a direction [rad], interpolated between headings.

        It has the shape (n_x, n_y), or that of the indices ``at`` of nodes and of the directions.
        """
        turn = np.asarray(direction) / (2 * math.pi) * self.heading.size
        k = np.floor(turn + 1e-9).astype(np.intp)
        first, second = (self.cost[(m % self.heading.size, *at)] for m in (k, k + 1))
        part = np.where(turn - k < 1e-6, 0.0, turn - k)
        # without the second one if its share is zero, since it may be infinite
        return np.asarray((1 - part) * first + part * np.where(part > 0, second, 0.0))


@checked
def free_space(
    terrain: Bicubic,
    vehicle: Vehicle,
    *,
    keep_out: Iterable[Region] = (),
    spacing: Positive | None = None,
) -> Traversability:
    """Return where the wheels of a vehicle stay on a map in any heading, at a cost of 1.

    Parameters
    ----------
    terrain : Bicubic
        The ground.
    vehicle : Vehicle
        The vehicle; its wheels in the zero configuration determine its size.
    keep_out : iterable of Region
        Regions that no wheel may touch.
    spacing : float, optional
        Distance between nodes; by default a sixth of the smaller of the vehicle's width and length,
        but not less than the node spacing of the ground. [m]

    Raises
    ------
    ModelError
        If ``spacing`` is not positive or more than half the smaller side of the map.
    """
    right, forward, reach = extents(vehicle)
    if spacing is None:
        spacing = max(*terrain.grid.spacing, min(right, forward) / 3)
    x, y = coarse_axes(terrain.grid, spacing)
    limits = Limits(reach, math.sqrt(right * forward), terrain.domain, tuple(keep_out))
    to_hole = np.full((x.size, y.size), math.inf)
    if terrain.grid.holes is not None:
        to_hole = interpolate_layer(
            hole_distance(terrain.grid), terrain.grid.x, terrain.grid.y, x, y
        )
    cost = np.ones((1, x.size, y.size))
    layers = Traversability(x, y, np.zeros(1), cost, to_hole, limits)
    cost[:, np.logical_or.reduce([*out_of_bounds(layers).values()])] = math.inf
    return layers


@checked
def traversability(
    terrain: Bicubic,
    vehicle: Vehicle,
    *,
    keep_out: Iterable[Region] = (),
    spacing: Positive | None = None,
    backwards: bool = False,
    places: Array | None = None,
    seconds: float = math.inf,
) -> Traversability:
    """Return the traversability of a map for a vehicle, from its poses at 8 headings.

    Parameters
    ----------
    terrain, vehicle, keep_out, spacing
        As for `free_space`; the ground may have a friction coefficient.
    backwards : bool
        Whether the vehicle drives backwards.
    places : ndarray, shape (n, 2), optional
        Places of the map between which a route is sought. Away from them poses are farther apart.
        [m]
    seconds : float
        Time limit of the search for a route. Equations that are not compiled in a fifth of it are
        interpreted, and poses are then farther apart. [s]

    Returns
    -------
    Traversability
        The cost and the poses. A node is blocked in a direction if the vehicle does not stand there
        at this heading, or needs more than 1.5 times the friction, or without friction is inclined
        by more than 30 degrees; and in all directions if in some
        heading a wheel could reach over the edge of the map, into a hole or into a keep-out region.

    Raises
    ------
    ModelError
        As `free_space` does.

    Notes
    -----
    The cost per metre is ``1 + 4 (inclination / 30 degrees)**2``, plus ``4 utilisation**2`` on
    ground with friction, with the largest utilisation of a wheel for forces distributed by load,
    plus ``4 (inclination / (inclination + margin))**2`` with the tip-over margin of a vehicle with
    mass. A utilisation of at least 1 adds 30. The poses are those at nodes a third of the smaller
    of the vehicle's width and length apart, or a quarter of a larger cell of the map, but more on
    very large maps. On level ground, and
    between places closer to each other than the vehicle is large, the cost is 1.
    """
    layers = free_space(terrain, vehicle, keep_out=keep_out, spacing=spacing)
    right, forward, reach = extents(vehicle)
    low, high = np.array([-np.inf] * 2), np.array([np.inf] * 2)
    if places is not None:
        low, high = places.min(axis=0), places.max(axis=0)
    distance = float(np.linalg.norm(high - low))
    if terrain.is_level or distance < 2 * reach:
        return layers
    apart = max(min(right, forward) / 1.5, min(terrain.grid.spacing) / CELL_POSES)
    step = max(1, round(apart / max(layers.spacing)))
    step = max(step, math.ceil(math.sqrt(HEADINGS * layers.to_hole.size / MAX_POSES)))
    room = max(distance / 2, 3 * reach)
    model = direct_kinematics(vehicle, terrain)
    heading = 2 * np.pi * np.arange(HEADINGS) / HEADINGS

    def nodes_of(step: int) -> list[Array]:
        """Return some nodes of both axes and their last, farther apart outside the room."""
        nodes = list[Array]()
        for axis, a, b in zip((layers.x, layers.y), low - room, high + room, strict=True):
            index, near = np.arange(axis.size), (axis >= a) & (axis <= b)
            chosen = (index % np.where(near, step, AWAY * step) == 0) | (index == axis.size - 1)
            nodes.append(axis[chosen])
        return nodes

    x, y = nodes_of(step)
    count = HEADINGS * x.size * y.size * (RESTING if model.rest.numel() else 1)
    with compiler_limit(MAP_SHARE * seconds):
        compiled = count > INTERPRETED and evaluator_of(model, compiled=True).is_compiled
        if seconds < math.inf and count > INTERPRETED and not compiled:
            x, y = nodes_of(math.ceil(step * math.sqrt(count / INTERPRETED)))
        headings = (heading + np.pi * backwards).tolist()
        poses = atlas(model, headings=headings, x=x, y=y, quantities=QUANTITIES, compiled=compiled)
    outside = out_of_bounds(layers)
    nodes = nearest_nodes(layers.x, poses.x), nearest_nodes(layers.y, poses.y)
    is_known = ~(outside["edge"] | outside["hole"])[np.ix_(*nodes)]
    cost = _spread(pose_costs(poses), is_known, poses, layers)
    cost[:, np.isinf(layers.cost[0])] = math.inf
    return layers._replace(heading=heading, cost=cost, poses=poses)


def pose_costs(poses: Atlas) -> Array:
    """Return the costs per metre of poses, infinite where the vehicle must not be [1]."""
    with np.errstate(invalid="ignore"):
        inclination = np.arccos(np.cos(poses["roll"]) * np.cos(poses["pitch"]))
        cost = 1 + INCLINATION * (inclination / STEEP) ** 2
        if "utilisation" in poses.bands:
            # the square of a utilisation without equilibrium may overflow
            used = np.minimum(poses["utilisation"], MAX_UTILISATION)
            cost += np.where(used < MAX_UTILISATION, FRICTION * used**2, math.inf)
            cost += np.where(used < 1, 0.0, SLIDING)
        else:
            cost += np.where(inclination < STEEP, 0.0, math.inf)
        if "tip_over_margin" in poses.bands:
            margin = poses["tip_over_margin"]
            cost += TIPPING * (inclination / np.maximum(inclination + margin, 1e-9)) ** 2
    return np.where(poses.stands, cost, math.inf).astype(float)


def _spread(cost: Array, is_known: Mask, poses: Atlas, layers: Traversability) -> Array:
    """Return costs of poses at all nodes: means of the free poses around, weighted by distance.

    A node is blocked if the poses around are blocked by more than half. Poses that are not known
    count only if there are no others.
    """
    axes = poses.x, poses.y, layers.x, layers.y
    spread = np.empty((len(cost), layers.x.size, layers.y.size))
    weight = np.where(is_known, 1.0, UNKNOWN)
    total = interpolate_layer(weight, *axes)
    for k, each in enumerate(cost):
        free = weight * np.isfinite(each)
        share = interpolate_layer(free, *axes)
        sums = interpolate_layer(np.where(np.isfinite(each), each, 0.0) * weight, *axes)
        with np.errstate(invalid="ignore", divide="ignore"):
            spread[k] = np.where(share >= 0.5 * total, sums / share, math.inf)
    return spread


def coarse_axes(grid: Grid, spacing: float) -> tuple[Array, Array]:
    """Return the axes of the cost grid; the axes of the ground if they have the given spacing."""
    extent = min(float(np.ptp(grid.x)), float(np.ptp(grid.y)))
    if spacing > extent / 2:
        raise ModelError(
            "traversability: expected a 'spacing' of at most half the smaller side of the map, "
            f"{extent / 2:.4g} m, found {spacing:.4g} m; use a smaller spacing or a larger map"
        )
    axes = []
    for axis, h in zip((grid.x, grid.y), grid.spacing, strict=True):
        count = round(float(np.ptp(axis)) / spacing)
        same = abs(spacing - h) < 1e-9 * h
        axes.append(np.array(axis) if same else np.linspace(axis[0], axis[-1], count + 1))
    return axes[0], axes[1]


def interpolate_layer(layer: Array, x: Array, y: Array, new_x: Array, new_y: Array) -> Array:
    """Return a layer at new nodes by linear interpolation."""
    for axis, (old, new) in enumerate(((x, new_x), (y, new_y))):
        if old.size == new.size:
            continue
        first = np.clip(np.searchsorted(old, new, side="right") - 1, 0, old.size - 2)
        weight = np.expand_dims((new - old[first]) / (old[first + 1] - old[first]), 1 - axis)
        low, high = np.take(layer, first, axis), np.take(layer, first + 1, axis)
        layer = low + weight * (high - low)
    return layer


def nearest_nodes(axis: Array, at: Array) -> npt.NDArray[np.intp]:
    """Return the indices of the nodes of a uniform axis nearest to positions."""
    cells = np.rint((at - axis[0]) / axis_step(axis))
    return np.asarray(np.clip(cells, 0, axis.size - 1), dtype=np.intp)


def extents(vehicle: Vehicle) -> tuple[float, float, float]:
    """Return half the width and half the length of a vehicle, and the radius of its circle [m].

    The circle about the platform's centre encloses all wheels, each as a sphere, since a wheel may
    be steered and tilted.
    """
    at = vehicle.centers[:, :2]
    radius = np.array([wheel.radius for wheel in vehicle.wheels])
    half_width = np.array([wheel.half_width for wheel in vehicle.wheels])
    size = np.stack([half_width, radius], axis=1)
    right, forward = 0.5 * ((at + size).max(axis=0) - (at - size).min(axis=0))
    return float(right), float(forward), float((np.hypot(*at.T) + radius).max())


# Blocked nodes


def blocking_reasons(layers: Traversability, x: float, y: float) -> str:
    """Return the reasons why a vehicle cannot be at a position, as text; empty if it can."""
    off = to_edge(layers.limits, np.asarray(x), np.asarray(y)) < 0
    i, j = node_at(layers, x, y)
    if not off and math.isfinite(layers.least_cost[i, j]):
        return ""
    at = (x, y) if off else (float(layers.x[i]), float(layers.y[j]))
    return "; ".join(reasons_by_kind(layers, *at).values())


def out_of_bounds(layers: Traversability) -> dict[str, Mask]:
    """Return the masks of nodes at which a wheel could leave its bounds, by reason.

    It could reach over the ``"edge"`` of the map, into a ``"hole"`` or into a ``"keep_out"``
    region.
    """
    x, y, limits = layers.x[:, None], layers.y[None, :], layers.limits
    keep_out = np.zeros(layers.to_hole.shape, dtype=bool)
    for region in limits.keep_out:
        part = window(layers, region.bounds, limits.reach)
        inside = region.distance(*np.broadcast_arrays(x[part[0]], y[:, part[1]])) < limits.reach
        keep_out[part] |= inside
    return {
        "edge": to_edge(limits, x, y) < limits.reach,
        "hole": layers.to_hole < limits.reach,
        "keep_out": keep_out,
    }


def blocked_by(layers: Traversability) -> dict[str, Mask]:
    """Return the masks of blocked nodes, by reason; a node may have several.

    The reasons are those of `out_of_bounds`; ``"friction"``, which holds no heading at the nearest
    pose although the vehicle stands; and ``"pose"``, if no heading is possible otherwise.
    """
    masks, blocked = out_of_bounds(layers), np.isinf(layers.least_cost)
    slides = np.zeros_like(blocked)
    if layers.poses is not None and "utilisation" in layers.poses.bands:
        used, stands = layers.poses["utilisation"], layers.poses.stands
        at_poses = np.asarray(stands.any(axis=0) & ~(used < MAX_UTILISATION).any(axis=0))
        nearest = [
            np.abs(axis[:, None] - at).argmin(axis=1)
            for axis, at in ((layers.x, layers.poses.x), (layers.y, layers.poses.y))
        ]
        slides = blocked & at_poses[np.ix_(*nearest)]
    return masks | {"friction": slides, "pose": blocked & ~slides}


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
    layers: Traversability, bounds: tuple[float, float, float, float], margin: float
) -> tuple[slice, slice]:
    """Return the slices of the grid inside a rectangle extended by a margin [m]."""
    i = np.searchsorted(layers.x, (bounds[0] - margin, bounds[1] + margin)).tolist()
    j = np.searchsorted(layers.y, (bounds[2] - margin, bounds[3] + margin)).tolist()
    return slice(*i), slice(*j)


def reasons_by_kind(layers: Traversability, x: float, y: float) -> dict[str, str]:
    """Return the reasons why a vehicle cannot be at a position, by kind.

    The kinds are those of `out_of_bounds`, and ``"pose"`` if no heading is possible.
    """
    limits, words = layers.limits, {}
    inside = float(to_edge(limits, np.asarray(x), np.asarray(y)))
    if inside < 0:
        return {"edge": f"{-inside:.3g} m outside the map"}
    if inside < limits.reach:
        words["edge"] = (
            f"{inside:.3g} m from the edge of the map, and wheels reach {limits.reach:.3g} m"
        )
    i, j = node_at(layers, x, y)
    if layers.to_hole[i, j] < limits.reach:
        words["hole"] = (
            f"{max(layers.to_hole[i, j], 0):.3g} m from a hole in the map, where heights are "
            f"missing, and wheels reach {limits.reach:.3g} m"
        )
    near = [
        f"inside the keep-out {region.words}"
        if distance < 0
        else f"{distance:.3g} m from the keep-out {region.words}, and wheels reach "
        f"{limits.reach:.3g} m"
        for region in limits.keep_out
        if (distance := float(region.distance(np.asarray(x), np.asarray(y)))) < limits.reach
    ]
    words |= {"keep_out": "; ".join(near)} if near else {}
    if layers.poses is not None and not words and math.isinf(layers.least_cost[i, j]):
        poses = layers.poses
        i, j = (int(np.abs(axis - at).argmin()) for axis, at in ((poses.x, x), (poses.y, y)))
        codes = poses["reason"][:, i, j]
        named = [poses.reasons[int(code)] for code in np.unique(codes[codes > 0])]
        if "utilisation" in poses.bands and (codes == 0).any():
            least = float(np.nanmin(poses["utilisation"][:, i, j]))
            named.insert(0, more_friction_words(least))
        words["pose"] = f"no heading is possible: {' or '.join(named)}"
    return words


def more_friction_words(factor: float) -> str:
    """Return a message for a vehicle that needs ``factor`` times the friction of the ground."""
    return f"the vehicle needs at least {factor:.3g} times the friction of the ground"


# Nodes


def nodes_at(
    layers: Traversability, points: Array
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return the indices of the nodes nearest to points in map coordinates, shape (n, 2)."""
    return nearest_nodes(layers.x, points[:, 0]), nearest_nodes(layers.y, points[:, 1])


def nearest_headings(layers: Traversability, steps: Array) -> npt.NDArray[np.intp]:
    """Return the indices of the headings nearest to the directions of steps, shape (n, 2)."""
    turns = np.arctan2(-steps[:, 0], steps[:, 1]) / (2 * np.pi) * layers.heading.size
    return np.mod(np.rint(turns), layers.heading.size).astype(np.intp)


def node_at(layers: Traversability, x: float, y: float) -> tuple[int, int]:
    """Return the indices of the node nearest to a position."""
    i, j = nodes_at(layers, np.array([[x, y]]))
    return int(i[0]), int(j[0])


def point_text(point: Point) -> str:
    """Return the coordinates of a point as text, rounded to 0.01 m."""
    x, y = (round(float(each), 2) for each in point)
    return f"({x:.10g}, {y:.10g})"
