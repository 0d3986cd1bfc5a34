"""Clearance of the body: a check of samples, and an expression for planners.

The check is the least distance of the shapes of a vehicle's bodies from the ground
(`slipfree.contact.nearest_points`).

For planners the clearance is also an expression, with a coarse grid on the lowest face of each box
and a single search by Newton's method.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from operator import itemgetter

import casadi as ca
import numpy as np

from slipfree.contact.nearest_points import NEWTON_STEP, NearestPoints, frame_of, plane_gap
from slipfree.contact.touch import Plane, plane_of
from slipfree.core.dae import Limit
from slipfree.core.evaluation import evaluate
from slipfree.core.lookups import LookupTable, lookup_function
from slipfree.core.quantities import quantity_label
from slipfree.core.records import Array, Label
from slipfree.geometry.frame import Pose
from slipfree.terrain.base import Jet, Terrain
from slipfree.terrain.bicubic import Bicubic
from slipfree.vehicle.shapes import Ball, BodyShape, Box, Hull
from slipfree.vehicle.tree import Vehicle

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
    """Return the axes of a box, the steepest last, a grid on its lowest face, and its bounds."""
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
    """Return the clearance of a vehicle's bodies as a check; none without shapes.

    ``parts`` are the poses of the parts by name, ``symbols`` the states and unknowns of the model,
    ``size`` is its typical length [m].
    A vehicle with parameters has no checks.
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
