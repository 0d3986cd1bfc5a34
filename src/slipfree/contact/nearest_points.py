"""Nearest points of the shapes of bodies and the ground.

The distance is that of the nearest pair of a point ``P`` of a shape and a point ``F`` of the
ground. It is measured along the ground's unit normal ``n`` at ``F``, as ``(P - F) . n``, and is
negative if the shape penetrates the ground. On a plane it follows from the support point of the
shape. On other grounds the search has two stages.

1. A grid of ground points under the shape and around it is compared by the distance from the
   shape, which has a closed form. The grid finds ground that rises between the corners of a box.
   Its spacing suits the curvature of the ground. Ground more than `MAX_REACH` beside the shape is
   not searched, so that larger distances are upper bounds.
2. From each local minimum of the grid that may become the least, and from the lowest corners of a
   box or the lowest points of a hull, Newton's method improves the point of the shape and the foot
   of its perpendicular together. The point of a box moves in the directions in which it is not at a
   bound; at the solution the ground's normal is perpendicular to the edge or face on which the
   point lies.

Between points with a spacing ``s``, the distance is lower than at the points by at most
``k s^2 / 4``, with the largest curvature ``k`` of the ground. Minima within `SLACK` of the least
are improved, which covers curvatures up to ``1 / s``. The spacing of the grid is therefore ``1 /
k``, and not less than half that of the map, whose cells rarely have two minima each.

The clearance of the bodies of a vehicle is their least distance from the ground, a check of
samples. For planners it is also an expression, with a coarse grid on the lowest face of each box
and a single search by Newton's method.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import itemgetter
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.touch import Plane, jet_function, plane_of
from slipfree.core.dae import Limit
from slipfree.core.lookups import LookupTable, evaluate, lookup_function
from slipfree.core.quantities import quantity_label
from slipfree.core.records import Array, Indices, Label, Mask
from slipfree.geometry.frame import Pose, translation
from slipfree.system.forks import cached_property
from slipfree.terrain.base import Jet, Terrain
from slipfree.terrain.bicubic import Bicubic
from slipfree.vehicle.shapes import Ball, BodyShape, Box, Hull
from slipfree.vehicle.tree import Vehicle

STEPS = 2  # Newton steps between tests of convergence
ROUNDS = 12  # largest number of such tests
STILL_LOWER = 1.0  # a search may still reduce the distance by this [last change]
FEWEST_POINTS = 25  # number of grid points a side on smooth ground
MAX_CELLS = 2_000_000  # number of grid points evaluated together, which limits the memory
USUAL_SPACING = 1 / 12  # spacing of the grid on a ground without nodes [longest edge]
MAX_REACH = 0.3  # largest distance of the grid's border from the sides of a shape [m]
SLACK = 0.25  # local minima of the grid may be lower by this [spacing]
STEEPEST = 0.3  # least ratio of the distance of a point to its vertical gap, on steep ground
OUTSIDE = 3  # the same beside a shape, where the distance rises like a cone [slacks]
SIMILAR = 0.02  # corners with gaps within this of the least also start [least gap]
CORNERS = np.array([[1, 1], [1, -1], [-1, 1], [-1, -1]])  # of the lowest face [half edges]
MAX_STARTS = 4  # number of points of a hull that are improved, those with the least vertical gaps
COARSE_POINTS = 12  # number of points a side of the grid under the vehicle
BOUND_POINTS = 5  # the same for quick lower bounds
CONVERGED = 1e-7  # largest change of a converged search, whose distance is far more exact [m]
MIN_CURVATURE = 1e-9  # smaller convexity along a face counts as none [1/m]
MIN_CONVEXITY = 1e-3  # determinant of a convex function [product of the diagonal]
MIN_DETERMINANT = 1e-2  # of the equations of a foot; a smaller one means several feet [1]
ROOT_OFFSET = 1e-24  # keeps the derivatives of square roots finite [m2]
CHUNK = 256  # largest number of samples evaluated together


class Nearest(NamedTuple):
    """Nearest points of n samples: clearance (n,) [m], foot on the ground (n, 3) [m], and shape.

    Feet are in map coordinates; ``shape`` is the index of the nearest shape, (n,).
    """

    gap: Array
    foot: Array
    shape: Indices


@dataclass(frozen=True, eq=False)
class NearestPoints:
    """Search for the nearest points of shapes and ground; ``shapes`` have names of their parts."""

    terrain: Terrain
    shapes: tuple[tuple[str, BodyShape], ...]

    def body_of(self, shape: int) -> str:
        """Return the name of the body of a shape, as the subject of a sentence."""
        part = self.shapes[shape][0]
        return f"the {part}" if part == "platform" else f"the body of joint {part!r}"

    def __call__(self, placed: Array) -> Nearest:
        """Return the nearest points in n poses.

        Each column of ``placed`` (12 n_shapes, n) has origin and rotation matrix (by columns) of
        the frame of each shape, in local coordinates.
        """
        size, side = CHUNK, max(_radius(shape) for _, shape in self.shapes) + MAX_REACH
        if isinstance(self.terrain, Bicubic):
            cells = (4 * side / max(self.terrain.grid.spacing) + 4) ** 2
            size = max(1, min(CHUNK, int(MAX_CELLS / cells)))
        nearest = list[tuple[Array, Array, Indices]]()
        for k in range(0, placed.shape[1], size):  # origins and axes, (n_shapes, 12, n)
            part = placed[:, k : k + size].reshape(len(self.shapes), 12, -1)
            if self._over_plane:
                pairs = [
                    evaluate(function, at[:3], at[3:])
                    for function, at in zip(self._over_plane, part, strict=True)
                ]
                gaps, feet = (np.stack(each) for each in zip(*pairs, strict=True))
                shape, pose = gaps[:, 0].argmin(axis=0), np.arange(part.shape[2])
                nearest.append((gaps[shape, 0, pose], feet[shape, :, pose], shape))
                continue
            starts = self._starts(part)
            gaps, feet = self._improved(starts)
            order = np.lexsort((gaps, starts.pose))  # the least of each pose first
            rows = order[np.unique(starts.pose[order], return_index=True)[1]]
            nearest.append((gaps[rows], feet[rows], starts.shape[rows]))
        gap, foot, shape = (np.concatenate(each) for each in zip(*nearest, strict=True))
        return Nearest(gap, foot + np.array(self.terrain.origin), shape)

    def lower_bounds(self, placed: Array, far: float) -> Array:
        """Return quick lower bounds of clearances up to ``far``, (n,), minus infinity if unknown.

        The heights of a coarse grid and the bound of the slope limit the height of the ground.
        """
        shapes = placed.reshape(len(self.shapes), 12, -1)
        lowest = np.min(
            [_lowest(shape, at) for (_, shape), at in zip(self.shapes, shapes, strict=True)], axis=0
        )
        x, y, heights = self._coarse_ground(shapes, BOUND_POINTS, far)
        slope, _ = self._derivative_bounds(x, y)
        highest = heights.max(axis=(0, 1)) + slope * np.hypot(x[1] - x[0], y[1] - y[0]) / 2
        return np.asarray(np.minimum(lowest - highest, far))

    def _starts(self, placed: Array) -> _Starts:
        """Return starts of searches at all poses, of shapes that may be the closest ones.

        Shapes are visited from the lowest upward; ``upper`` is the least clearance so far, and a
        shape whose lower bound exceeds it is left out.
        """
        n = placed.shape[2]
        upper, rows = np.full(n, np.inf), list[_Starts]()
        lowest = np.array([_lowest(s, at) for (_, s), at in zip(self.shapes, placed, strict=True)])
        ground = None
        if len(lowest) > 1:
            x, y, heights = self._coarse_ground(placed, COARSE_POINTS, MAX_REACH)
            _, curvature = self._derivative_bounds(x, y)
            squares = (x[1] - x[0]) ** 2 + (y[1] - y[0]) ** 2
            # between the points; less than for unknown curvatures, as in `_grid_starts`
            rise = np.minimum(SLACK * np.sqrt(squares / 2), curvature * squares / 8)
            ground = x, y, heights + rise
            highest = ground[2].max(axis=(0, 1))
        for k in np.argsort(lowest.mean(axis=1)):
            shape, open_ = self.shapes[k][1], np.arange(n)
            if ground is not None:
                open_ = np.flatnonzero(lowest[k] - highest < upper)
                at, low = placed[k][:2, open_], lowest[k, open_]
                near = [each[..., open_] for each in ground]
                bound = _coarse_bound(near, at, _radius(shape), low)
                open_ = open_[(bound < upper[open_]) | (bound == 0)]
            if open_.size:
                find = self._hull_starts if isinstance(shape, Hull) else self._grid_starts
                least, starts = find(shape, placed[k][:, open_])
                # depths in the axes of a box and vertical ones exceed those along the normal
                upper[open_] = np.minimum(upper[open_], np.maximum(least, 0))
                pose, own = open_[starts.pose], np.full(starts.pose.size, k)
                rows.append(starts._replace(pose=pose, shape=own))
        columns: list[Any] = [np.concatenate(each) for each in zip(*rows, strict=True)]
        joined = _Starts(*columns)
        lows = np.full(n, np.inf)
        np.minimum.at(lows, joined.pose, joined.low)
        needed = joined.low <= np.maximum(upper, lows)[joined.pose]
        columns = [each[needed] for each in joined]
        return _Starts(*columns)

    def _coarse_ground(
        self, placed: Array, count: int, margin: float
    ) -> tuple[Array, Array, Array]:
        """Return a grid below the vehicle and a margin around it, and the heights of its points.

        Coordinates are of shape (count, n), heights of shape (count, count, n).
        """
        sizes = np.array([_radius(shape) for _, shape in self.shapes])[:, None, None] + margin
        low = (placed[:, :2] - sizes).min(axis=0)
        side = (placed[:, :2] + sizes).max(axis=0) - low
        steps = np.linspace(0, 1, count)[:, None]
        x, y = (low[k] + side[k] * steps for k in (0, 1))
        return x, y, self._heights(*np.broadcast_arrays(x[:, None], y))

    def _derivative_bounds(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return bounds of slope and curvature of the ground of n grids; infinite if unknown."""
        bounds = getattr(self.terrain, "derivative_bounds", None)
        if bounds is None:
            return np.full(x.shape[1], np.inf), np.full(x.shape[1], np.inf)
        side = max((axis[-1] - axis[0]).max() for axis in (x, y))
        reach = math.ceil(5 * side) / 10  # few values, to be cached
        x_0, y_0, _ = self.terrain.origin
        slope, curvature = bounds(x.mean(axis=0) + x_0, y.mean(axis=0) + y_0, reach)
        return slope, curvature

    @cached_property
    def _over_plane(self) -> tuple[ca.Function, ...]:
        """Clearance and foot of each shape as functions of origin and axes; none if not a plane."""
        plane, functions = plane_of(self.terrain), list[ca.Function]()
        if plane is None:
            return ()
        center, columns = ca.SX.sym("center", 3), ca.SX.sym("columns", 9)
        for _, shape in self.shapes:
            results = plane_gap(shape, Pose(ca.reshape(columns, 3, 3), center), plane)
            functions.append(ca.Function("plane", [center, columns], [*results]))
        return tuple(functions)

    @cached_property
    def _steps(self) -> ca.Function:
        """Some steps of Newton's method, and the signed distance after them.

        It maps the point, the foot, the frame and the bounds of `NEWTON_STEP` to point, foot, the
        largest change by the last step, the signed distance, and the ground point at the foot.
        """
        jet, sizes = jet_function(self.terrain), (3, 2, 12, 6)
        inputs = [ca.MX.sym("given", size) for size in sizes]
        at, foot, frame, bounds = inputs
        before = ca.vertcat(at, foot)
        for _ in range(STEPS):
            before = ca.vertcat(at, foot)
            at, foot = NEWTON_STEP(jet(foot), at, foot, frame, bounds)
        end = jet(foot)
        ground = ca.vertcat(foot, end[0])
        away = frame[:3] + ca.reshape(frame[3:], 3, 3) @ at - ground
        above = away[2] - ca.dot(away[:2], end[1:3])
        gap = ca.if_else(above < 0, -1, 1) * ca.norm_2(away)
        change = ca.norm_inf(ca.vertcat(at, foot) - before)
        return ca.Function("steps", inputs, [at, foot, change, gap, ground])

    def _heights(self, x: Array, y: Array) -> Array:
        x_0, y_0, z_0 = self.terrain.origin
        return self.terrain.elevation(x + x_0, y + y_0) - z_0

    def _grid_starts(self, shape: Box | Ball, placed: Array) -> tuple[Array, _Starts]:
        """Return the least distance of a shape from a grid of ground points, and local minima."""
        center, axes = placed[:3].T, placed[3:].T.reshape(-1, 3, 3).transpose(0, 2, 1)
        n = len(center)
        radius, half = shape.radius, np.zeros((n, 3))
        if isinstance(shape, Box):  # its axes, the steepest last
            order = (np.abs(axes[:, 2]).argmax(axis=1)[:, None] + (1, 2, 3)) % 3
            axes = np.take_along_axis(axes, order[:, None], axis=2)
            half = (np.array(shape.size) / 2)[order]
        below = -np.sign(axes[:, 2, 2]) * half[:, 2]
        lowest = center[:, 2] - (np.abs(axes[:, 2]) * half).sum(axis=1)
        above = lowest - self._heights(center[:, 0], center[:, 1])
        reach = half[:, :2] + np.clip(above, 0.0, MAX_REACH)[:, None]
        spacing = USUAL_SPACING * 2 * max(half.max(), MAX_REACH)
        if isinstance(self.terrain, Bicubic):
            ends = (center[:, k] + np.outer((-1, 1), reach.max(axis=1)) for k in (0, 1))
            _, curvature = self._derivative_bounds(*ends)
            cell = max(self.terrain.grid.spacing)
            coarse = max(cell, 2 * reach.max() / FEWEST_POINTS)
            spacing = float(np.clip(1 / max(curvature.max(), 1 / coarse), cell / 2, coarse))
        reach += spacing
        counts = [2 + int(2 * reach[:, k].max() / spacing) for k in (0, 1)]
        u = reach[:, 0, None, None] * np.linspace(-1, 1, counts[0])[:, None]
        v = reach[:, 1, None, None] * np.linspace(-1, 1, counts[1])
        x, y, z = (
            (center[:, k] + below * axes[:, k, 2])[:, None, None]
            + axes[:, k, 0, None, None] * u
            + axes[:, k, 1, None, None] * v
            for k in (0, 1, 2)
        )
        height = self._heights(x, y)
        # ground points in the box's axes: those of the grid, moved vertically
        seen = [
            each + (height - z) * axes[:, 2, k, None, None]
            for k, each in enumerate((u, v, below[:, None, None]))
        ]
        beyond = [np.abs(each) - half[:, k, None, None] for k, each in enumerate(seen)]
        inside = np.maximum(np.maximum(beyond[0], beyond[1]), beyond[2])
        distance = sum(np.maximum(each, 0) ** 2 for each in beyond)
        distance = np.sqrt(distance) + np.minimum(inside, 0)
        steps = 2 * reach / (np.array(counts) - 1)
        slack = SLACK * steps.max(axis=1)
        least = distance.reshape(n, -1).min(axis=1)
        chosen = minima(distance) & (distance <= (least + slack)[:, None, None])
        slopes = (
            np.abs(np.diff(height, axis=k + 1)).max(axis=(1, 2)) / steps[:, k] for k in (0, 1)
        )
        upright = 1 / np.sqrt(1 + sum(slope**2 for slope in slopes))  # least component n_z
        # corners of the lowest face with almost the least vertical gaps
        signs = CORNERS[: 4 if half.any() else 1]
        corners = np.stack([np.column_stack([a * half[:, :2], below]) for a in signs], axis=1)
        places = np.einsum("nij,nkj->nki", axes, corners) + center[:, None]
        gaps = places[..., 2] - self._heights(places[..., 0], places[..., 1])
        low_gap = gaps.min(axis=1, keepdims=True)
        own, k = np.nonzero(gaps <= low_gap + SIMILAR * np.abs(low_gap))
        corner, place, gap = corners[own, k], places[own, k, :2], gaps[own, k]
        pose, i, j = np.nonzero(chosen)
        at = np.stack([each[pose, i, j] for each in seen], axis=1)
        start = np.clip(at, -half[pose], half[pose])
        under = (np.abs(at[:, :2]) < half[pose, :2]).all(axis=1)
        start[under, 2] = below[pose[under]]
        # beside the face the distance rises like a cone from its edge, faster than by curvature
        low = distance[pose, i, j] - np.where(under, 1, OUTSIDE) * slack[pose]
        spot = np.column_stack([x[pose, i, j], y[pose, i, j]])
        pose = np.concatenate([pose, own])
        starts = _Starts(
            pose,
            pose,
            np.concatenate([low, np.minimum(gap, upright[own] * gap)]) - radius,
            np.full(pose.size, radius),
            np.concatenate([start, corner]),
            np.concatenate([spot, place]),
            np.column_stack([center, axes.transpose(0, 2, 1).reshape(-1, 9)])[pose],
            np.column_stack([half, steps, half[:, 2]])[pose],
        )
        return np.minimum(least, low_gap[:, 0]) - radius, starts

    def _hull_starts(self, shape: Hull, placed: Array) -> tuple[Array, _Starts]:
        """Return the least vertical gap of a hull's points, and the points with the least gaps."""
        axes, points = placed[3:].T.reshape(-1, 3, 3).transpose(0, 2, 1), np.array(shape.points)
        places = np.einsum("nij,pj->npi", axes, points) + placed[:3].T[:, None]
        gaps = places[..., 2] - self._heights(places[..., 0], places[..., 1])
        chosen = np.argsort(gaps, axis=1)[:, :MAX_STARTS]
        pose, k = np.repeat(np.arange(len(gaps)), chosen.shape[1]), chosen.reshape(-1)
        place, gap = places[pose, k], gaps[pose, k]
        starts = _Starts(
            pose,
            pose,
            np.where(gap > 0, STEEPEST * gap, gap),
            np.zeros(pose.size),
            np.zeros_like(place),
            place[:, :2],
            np.column_stack([place, placed[3:].T[pose]]),
            np.zeros((pose.size, 6)),
        )
        return gaps.min(axis=1), starts

    def _improved(self, starts: _Starts) -> tuple[Array, Array]:
        """Return clearances (m,) and feet (m, 3) of the starts after steps of Newton's method.

        A search goes on while it may still become the closest one of its pose: the others keep a
        clearance that is too large, but not the least.
        """
        fixed, left = (starts.frame.T, starts.bounds.T), np.arange(starts.pose.size)
        at, foot = starts.start.T.copy(), starts.spot.T.copy()
        gap, ground = np.empty(left.size), np.empty((3, left.size))
        for _ in range(ROUNDS):
            here = (each[:, left] for each in (at, foot, *fixed))
            at[:, left], foot[:, left], change, distance, ground[:, left] = evaluate(
                self._steps, *here
            )
            gap[left] = distance[0] - starts.radius[left]
            least = np.full(starts.pose.max() + 1, np.inf)
            np.minimum.at(least, starts.pose, gap)
            is_open = change[0] > CONVERGED
            left = left[is_open & (gap[left] < least[starts.pose[left]] + STILL_LOWER * change[0])]
            if not left.size:
                break
        return gap, ground.T


def _coarse_bound(ground: Sequence[Array], center: Array, radius: float, lowest: Array) -> Array:
    """Return lower bounds of the distances of a shape from a coarse ground, (n,); zero if inside.

    The shape is above the height ``lowest`` and within ``radius`` of its centre. A point of the
    ground is not above the highest node of its cell, which is at most a step beside it.
    """
    x, y, heights = ground
    beside = [
        np.maximum(np.abs(axis - at) - (axis[1] - axis[0]) - radius, 0) ** 2
        for axis, at in zip((x, y), center, strict=True)
    ]
    squares = beside[0][:, None] + beside[1] + np.maximum(lowest - heights, 0) ** 2
    return np.asarray(np.sqrt(squares.min(axis=(0, 1))))


def _lowest(shape: BodyShape, placed: Array) -> Array:
    """Return the height of the lowest point of a shape at origins and axes (12, n), (n,) [m]."""
    up = placed[[5, 8, 11]]
    if isinstance(shape, Hull):
        return np.asarray(placed[2] + (np.array(shape.points) @ up).min(axis=0))
    depth = shape.radius if isinstance(shape, Ball) else np.abs(up.T) @ shape.size / 2
    return np.asarray(placed[2] - depth)


def _radius(shape: BodyShape) -> float:
    if isinstance(shape, Ball):
        return shape.radius
    if isinstance(shape, Box):
        return float(np.linalg.norm(shape.size)) / 2
    return float(np.linalg.norm(shape.points, axis=1).max())


class _Starts(NamedTuple):
    """Starts of m searches for the nearest points.

    Indices of pose and shape, a lower bound of the distance and the radius of a ball (m,), the
    point of the box in its axes (m, 3), the ground point (m, 2), centre and axes by columns of the
    box (m, 12), and half its edges with the longest steps along them (m, 6). [m]
    """

    pose: Indices
    shape: Indices
    low: Array
    radius: Array
    start: Array
    spot: Array
    frame: Array
    bounds: Array


def minima(values: Array) -> Mask:
    """Return the mask of the local minima of each grid, (n, i, j); also at its border."""
    padded = np.pad(values, ((0, 0), (1, 1), (1, 1)), constant_values=np.inf)
    rows, columns = values.shape[1:]
    low = np.ones(values.shape, dtype=bool)
    for i in (0, 1, 2):
        for j in (0, 1, 2):
            low &= values <= padded[:, i : i + rows, j : j + columns]
    return low


def _free_solution(matrix: ca.SX, right: ca.SX, free: ca.SX) -> ca.SX:
    """Return the solution of a symmetric system (3, 3) in the rows and columns that are free.

    It minimises a quadratic function, which is made convex if it is not.
    """
    both = free @ free.T * ca.triu2symm(ca.triu(matrix)) + ca.diag(1 - free)
    (a, b, c), diagonal = ca.horzsplit(both), ca.diag(both)
    product, minor = diagonal[0] * diagonal[1] * diagonal[2], a[0] * b[1] - a[1] ** 2
    is_convex = ca.logic_and(ca.dot(a, ca.cross(b, c)) > MIN_CONVEXITY * product, minor > 0)
    # a dominant diagonal makes the step descend: plain steps would converge to a saddle
    sums = ca.sum2(ca.fabs(both - ca.diag(diagonal)))
    a, b, c = ca.horzsplit(both + ca.diag(ca.if_else(is_convex, 0, sums)))
    adjugate = ca.horzcat(ca.cross(b, c), ca.cross(c, a), ca.cross(a, b))
    return adjugate @ ca.if_else(free, right, 0) / ca.dot(a, ca.cross(b, c))


def _step_function() -> ca.Function:
    """Return the function of the next point of a box, in its axes, and of the next foot.

    Its arguments are the jet of the ground at the foot of the perpendicular, the point, the foot,
    the box's frame (origin and axes by columns), and bounds of the coordinates of the point and of
    their steps.

    With the tangents ``T`` and the normal ``N = (-h_x, -h_y, 1)``, the equations are
    ``T' (P - F) = 0`` and, for each edge ``e`` along which the point is free, ``e . N = 0``.
    """
    jet, at, foot, frame, bounds = (
        ca.SX.sym(name, size)
        for name, size in (("jet", 7), ("at", 3), ("foot", 2), ("frame", 12), ("bounds", 6))
    )
    gradient, hessian, axes = jet[1:3], ca.reshape(jet[3:], 2, 2), ca.reshape(frame[3:], 3, 3)
    away = frame[:3] + axes @ at - ca.vertcat(foot, jet[0])
    residual = away[:2] + away[2] * gradient
    metric = ca.SX.eye(2) + gradient @ gradient.T
    matrix = metric - away[2] * hessian
    # in a hollow whose radius is smaller than the distance, the foot is a maximum of the distance
    is_least = ca.logic_and(ca.det(matrix) > MIN_DETERMINANT, ca.trace(matrix) > 0)
    matrix = ca.if_else(is_least, matrix, metric)
    a, b, c = matrix[0, 0], matrix[0, 1], matrix[1, 1]
    inverse = ca.blockcat([[c, -b], [-b, a]]) / (a * c - b**2)
    farthest = ca.sqrt(ca.sumsqr(away) + ROOT_OFFSET)
    half, most = bounds[:3], bounds[3:]
    along = axes[:2, :] + gradient @ axes[2, :]
    slope = axes.T @ ca.vertcat(-gradient, 1)
    turning = axes[:2, :].T @ hessian @ inverse
    bend, wanted = -turning @ along, turning @ residual - slope
    held = ca.logic_or(ca.logic_and(at <= -half, slope >= 0), ca.logic_and(at >= half, slope <= 0))
    # along a concave direction the least distance is at a bound
    free = ca.logic_and(ca.logic_not(held), ca.diag(bend) > MIN_CURVATURE)
    solved = _free_solution(bend, wanted, free)
    change = ca.if_else(free, solved, ca.if_else(held, 0, -ca.sign(slope) * most))
    change = ca.fmin(ca.fmax(change, -most), most)
    change = ca.fmin(ca.fmax(at + change, -half), half) - at
    farthest += ca.sqrt(ca.sumsqr(change) + ROOT_OFFSET)
    move = inverse @ (residual + along @ change)
    results = (
        at + change,
        foot + move * ca.fmin(1, farthest / ca.sqrt(ca.sumsqr(move) + ROOT_OFFSET)),
    )
    return ca.Function("step", [jet, at, foot, frame, bounds], [*results], {"cse": True})


NEWTON_STEP = _step_function()


def plane_gap(shape: BodyShape, frame: Pose, plane: Plane) -> tuple[ca.SX, ca.SX]:
    """Return the clearance of a shape from a plane, and the foot of its perpendicular."""
    gradient = ca.SX(plane.gradient)
    up, radius = ca.vertcat(-gradient, 1) / ca.sqrt(1 + ca.sumsqr(gradient)), 0.0
    if isinstance(shape, Box):
        side = ca.if_else(frame.rotation.T @ up > 0, -0.5, 0.5) * ca.DM(shape.size)
        places = [frame.origin + frame.rotation @ side]
    elif isinstance(shape, Ball):
        places, radius = [frame.origin], shape.radius
    else:
        places = [frame.origin + frame.rotation @ ca.DM(point) for point in shape.points]
    heights = [ca.dot(up, at) - up[2] * plane.height for at in places]
    gaps = [(h - radius, at - h * up) for h, at in zip(heights, places, strict=True)]
    least, foot = gaps[0]
    for gap, at in gaps[1:]:
        foot = ca.if_else(gap < least, at, foot)
        least = ca.fmin(gap, least)
    return least, foot


def frame_of(shape: BodyShape, part: Pose) -> Pose:
    """Return the frame of a shape: its axes and centre, or the part's frame for a hull."""
    if isinstance(shape, Box):
        return part @ shape.pose
    return part @ translation(*shape.at) if isinstance(shape, Ball) else part


FAR = 0.06  # larger clearances need only a lower bound where only contacts matter [size]
PLANNED_MARGIN = 1e-3  # clearance that planners keep, for the motion between their points [m]
PLANNED_STEPS = 3  # number of Newton steps of the expression for planners
PLANNED_POINTS = 5  # largest number of grid points a side, of the expression for planners
CLEARANCE = quantity_label("clearance_body")
TOUCHES = "the body of the vehicle touches the ground (clearance)"


@dataclass(frozen=True, eq=False)
class BodyClearance:
    """Clearance of the bodies of a vehicle, a check of samples.

    ``pose`` maps ``x`` and ``z`` to ``placing``, the argument of ``search``. ``limit`` is the same
    condition as an expression, ``size`` the typical length of the vehicle [m].
    """

    search: NearestPoints
    pose: ca.Function
    placing: ca.SX
    limit: Limit
    size: float

    @property
    def label(self) -> Label:
        """Name, unit and description of the clearance."""
        return CLEARANCE

    def margin(self, x: Array, z: Array) -> Array:
        """Return the clearances for n columns of states ``x`` and unknowns ``z``, (n,) [m]."""
        return self.search(evaluate(self.pose, x, z)[0]).gap

    def margin_at(self, placed: Array) -> Array:
        """Return the clearances at n values of ``placing``, (12 n_shapes, n), or lower bounds.

        Where quick lower bounds exceed `FAR`, they are returned: only contacts matter here.
        """
        far = FAR * self.size
        margins = self.search.lower_bounds(placed, far)
        near = np.flatnonzero(~(margins >= far))
        if near.size:
            margins[near] = self.search(placed[:, near]).gap
        return margins

    def describe(self, x: Array, z: Array) -> str:
        """Return a message with the body that touches the ground, and the place on the map."""
        at = self.search(evaluate(self.pose, x[:, None], z[:, None])[0])
        x_0, y_0, _ = at.foot[0]
        body = self.search.body_of(int(at.shape[0]))
        return f"{body} touches the ground at ({x_0:.3f}, {y_0:.3f}) m; choose another path"


def planned_gap(
    shape: BodyShape, frame: Pose, terrain: Terrain, plane: Plane | None, lookups: LookupTable
) -> ca.SX:
    """Return the clearance of a shape as an expression, for planners [m].

    Candidates are the centre of a ball, the points of a hull and a grid on the face of a box that
    is lowest with the platform level. The one with the least vertical gap, times ``n_z`` of the
    ground below, is improved by Newton's method.
    """
    if plane is not None:
        return plane_gap(shape, frame, plane)[0]
    jet_at = _jet_of_expressions(terrain, lookups)
    axes, points = frame.rotation, np.zeros((1, 3))
    if isinstance(shape, Hull):
        points = np.array(sorted(shape.points, key=itemgetter(2))[: PLANNED_POINTS**2])
    elif isinstance(shape, Box):
        axes, points, bounds = _lowest_face(shape, frame, terrain)
    start, least = ca.SX(ca.DM(points[0])), ca.SX(np.inf)
    for point in points if len(points) > 1 else ():
        place = frame.origin + axes @ ca.DM(point)
        height, gradient, _ = jet_at(place[0], place[1])
        gap = (place[2] - height) / ca.sqrt(1 + ca.sumsqr(gradient))
        start = ca.if_else(gap < least, ca.DM(point), start)
        least = ca.fmin(gap, least)
    center, at = frame.origin, start
    if not isinstance(shape, Box):  # the point does not move
        center, at, bounds = center + axes @ start, ca.SX.zeros(3), np.zeros(6)
    foot = (center + axes @ at)[:2]
    for _ in range(PLANNED_STEPS):
        height, gradient, hessian = jet_at(foot[0], foot[1])
        jet = ca.vertcat(height, gradient, ca.vec(hessian))
        at, foot = NEWTON_STEP(jet, at, foot, ca.vertcat(center, ca.vec(axes)), bounds)
    height, gradient, _ = jet_at(foot[0], foot[1])
    normal = ca.vertcat(-gradient, 1) / ca.sqrt(1 + ca.sumsqr(gradient))
    away = center + axes @ at - ca.vertcat(foot, height)
    return ca.dot(away, normal) - (shape.radius if isinstance(shape, Ball) else 0.0)


def _jet_of_expressions(terrain: Terrain, lookups: LookupTable) -> Callable[[ca.SX, ca.SX], Jet]:
    """Return the jet of a ground as a function of expressions; `Terrain.jet` takes symbols."""
    x, y, table = ca.SX.sym("x"), ca.SX.sym("y"), LookupTable()
    jet = terrain.jet(x, y, table)
    if table.lookups:  # polynomials, which take expressions
        return lambda u, v: terrain.jet(u, v, lookups)
    function = ca.Function("jet", [x, y], [ca.densify(each) for each in jet])
    return lambda u, v: Jet(*function(u, v))


def _lowest_face(shape: Box, frame: Pose, terrain: Terrain) -> tuple[ca.SX, Array, Array]:
    """Return the axes of a box, the steepest last, a grid on its lowest face, and its bounds.

    The face is the lowest one with the platform level. Its points (n, 3) are along the returned
    axes, from the centre [m]. Bounds are half the edges, the distances of points along the first
    two axes, and half the last edge, as `NEWTON_STEP` takes them. [m]
    """
    rest = np.array(ca.evalf(shape.pose.rotation))
    order = (np.abs(rest[2]).argmax() + np.arange(1, 4)) % 3
    half = np.array(shape.size)[order] / 2
    spacing = max(terrain.grid.spacing) if isinstance(terrain, Bicubic) else 0.0
    counts = [
        int(min(PLANNED_POINTS, 1 + np.ceil(2 * half[k] / spacing))) if spacing else PLANNED_POINTS
        for k in (0, 1)
    ]
    u, v = (np.linspace(-half[k], half[k], counts[k]) for k in (0, 1))
    below = -np.sign(rest[2, order[2]]) * half[2]
    points = np.array([(a, b, below) for a in u for b in v])
    steps = [2 * half[k] / (counts[k] - 1) for k in (0, 1)]
    bounds = np.array([*half, *steps, half[2]])
    return frame.rotation[:, order.tolist()], points, bounds


def body_clearance(
    vehicle: Vehicle,
    parts: Mapping[str, Pose],
    terrain: Terrain,
    lookups: LookupTable,
    symbols: tuple[ca.SX, ca.SX],
    size: float,
) -> tuple[BodyClearance, ...]:
    """Return the clearance of a vehicle's bodies as a check, or nothing if it has no shapes.

    Simulations sample the exact clearance of the check; plans use its ``limit``, an expression of a
    few candidate points (`planned_gap`).

    ``parts`` are the poses of the parts by name in local coordinates, ``symbols`` the states and
    unknowns of the model, ``size`` is its typical length [m]. A vehicle with parameters, as in
    fits, has no checks: they need numbers.
    """
    shapes = vehicle.shapes
    if not shapes or vehicle.nominal:
        return ()
    frames = [frame_of(shape, parts[name]) for name, shape in shapes]
    plane, table = plane_of(terrain), lookups.lookups
    placing = ca.densify(
        ca.vertcat(*(ca.vertcat(each.origin, ca.vec(each.rotation)) for each in frames))
    )
    gaps = (
        planned_gap(shape, frame, terrain, plane, lookups)
        for (_, shape), frame in zip(shapes, frames, strict=True)
    )
    least = ca.mmin(ca.vertcat(*gaps))
    limit = Limit(replace(CLEARANCE, words=TOUCHES), least, PLANNED_MARGIN, np.inf)
    pose = lookup_function(table, "shapes", [*symbols], [placing])
    return (BodyClearance(NearestPoints(terrain, shapes), pose, placing, limit, size),)
