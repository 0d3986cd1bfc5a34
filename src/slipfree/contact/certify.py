"""Certificate that a wheel touches the ground at one point only.

The closure equations hold at the contact point. Elsewhere the ground may still penetrate the wheel
(a rock beside it, a step ahead of it); the computed motion is then not that of a rigid wheel.
Therefore the surface of the wheel is compared with the ground around its lower part, unless the
curvature of the ground is so small that there cannot be a second point.

The bound on the curvature: let the wheel be the convex hull of a torus with rolling radius R and
axle ``a``, and ``N = (-h_x, -h_y, 1)`` a normal of the ground. At a critical point of the vertical
gap, ``N`` is a normal of the wheel, and the wheel's surface, as a height, has second derivatives of
at least ``p/R`` in every direction, where ``p`` is the length of the part of ``N`` perpendicular to
the axle; ``p >= |a_xy| - slope |a_z|``. If the curvature of the ground is below ``p/R`` everywhere
under the wheel, all critical points of the lower side are strict minima and all of the upper side
strict maxima. A function on a surface like a sphere with no saddle has one minimum and one maximum.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from slipfree.contact.nearest_points import minima
from slipfree.core.lookups import CellBounds, evaluate, lookup_function
from slipfree.core.quantities import quantity_label
from slipfree.core.records import Array, Label, Mask, pack
from slipfree.geometry.frame import Pose
from slipfree.terrain.base import Terrain
from slipfree.vehicle.sections import arc_lengths
from slipfree.vehicle.tree import Wheel

RIM_ANGLES = np.deg2rad(np.linspace(-180.0, 180.0, 121))  # about the axle, from the contact [rad]
CIRCLE = np.stack([np.cos(RIM_ANGLES), np.sin(RIM_ANGLES)], axis=1)
SPACING = np.deg2rad(3.0)  # distance of neighbouring points on the tread [rolling radii]
CHUNK = 256  # number of samples evaluated together, which limits the memory
NEAR = 0.1  # gaps below which minima are refined [rolling radius]
SEARCHED = 0.02  # gap of a clear wheel: parabolas are not as deep [rolling radius]
TOLERANCE = 1e-7  # penetration that counts as contact [size]


@dataclass(frozen=True, eq=False)
class SecondContact:
    """Clearance between a wheel and the ground, apart from the contact point.

    The clearance is the smallest vertical gap over a grid of points on the tread, whose spacing is
    a twentieth of the rolling radius; a parabola refines each local minimum. Narrower obstacles may
    be missed. The clearance is a numeric check, not an expression, since the nearest point jumps.
    ``pose`` maps ``x`` and ``z`` to the centre of the wheel in local coordinates, its rotation
    matrix (by columns) and the ground normal at its contact, one column of 15 rows; ``placing`` is
    the same as an expression. ``size`` is the typical length of the vehicle, the unit of
    `TOLERANCE` [m].
    """

    terrain: Terrain
    wheel: Wheel
    pose: ca.Function
    placing: ca.SX
    size: float = 1.0

    @property
    def label(self) -> Label:
        """Name, unit and description of the clearance."""
        return quantity_label("clearance", self.wheel.name)

    def margin(self, x: Array, z: Array) -> Array:
        """Return the clearances for n columns of states ``x`` and unknowns ``z``, shape (n,) [m].

        A penetration below `TOLERANCE` does not make a clearance negative. Where the curvature of
        the ground excludes a second contact, the clearance is infinite.
        """
        return self._clearances(evaluate(self.pose, x, z)[0], np.inf)

    def margin_at(self, placed: Array) -> Array:
        """Return the clearances of wheels at n values of ``placing``, (15, n), or lower bounds.

        Clearances above `SEARCHED` are not searched: only contacts matter here.
        """
        return self._clearances(placed, SEARCHED * self.wheel.radius)

    def _clearances(self, placed: Array, most: float) -> Array:
        """Return the clearances of wheels; at most ``most`` where a second contact is possible."""
        clearance = np.full(placed.shape[1], np.inf)
        open_ = np.flatnonzero(~self._has_single_contact(*np.split(placed, (3, 12))[:2]))
        touching = TOLERANCE * self.size
        clearance[open_] = self._nearest(placed[:, open_], touching, most)[0] + touching
        return clearance

    def deepest(self, placed: Array) -> tuple[Array, Array]:
        """Return the smallest gaps at n values of ``placing``, with the contact, and their places.

        The gaps are vertical, shape (n,) [m]; the places are local points x, y, shape (2, n) [m].
        """
        gaps, points = self._nearest(placed, -np.inf)
        return gaps, points[:, :2].T

    def _has_single_contact(self, center: Array, rotation: Array) -> Mask:
        """Return at which samples the curvature of the ground excludes a second contact."""
        bounds = getattr(self.terrain, "derivative_bounds", None)
        if bounds is None or self.wheel.section.torus_radii is None:
            return np.zeros(center.shape[1], dtype=bool)
        radius, (x_0, y_0, _) = self.wheel.radius, self.terrain.origin
        slope, curvature = bounds(center[0] + x_0, center[1] + y_0, radius)
        level, upright = np.hypot(rotation[0], rotation[1]), np.abs(rotation[2])
        slope[np.isinf(slope)] = 0.0  # near an edge, where the curvature is infinite
        return np.asarray(radius * curvature < level - slope * upright)

    def known_bounds(self) -> CellBounds:
        """Return the known bounds of the ground for `_has_single_contact`."""
        known = getattr(self.terrain, "known_bounds", None)
        if known is None or self.wheel.section.torus_radii is None:
            return CellBounds(np.empty((0, 3), dtype=np.int64), (0.0,) * 10, [])
        bounds: CellBounds = known(self.wheel.radius)
        return bounds

    def describe(self, x: Array, z: Array) -> str:
        """Return a message that locates the second contact, in map coordinates."""
        placed = evaluate(self.pose, x[:, None], z[:, None])[0]
        spot = self._nearest(placed, TOLERANCE * self.size)[1][0] + self.terrain.origin
        return (
            f"wheel {self.wheel.name} touches a second time at ({spot[0]:.3f}, {spot[1]:.3f}) m, "
            "apart from its contact point; fill hollows narrower than the wheel (terrain.rolled), "
            "or choose another path"
        )

    def _nearest(self, placed: Array, touching: float, most: float = np.inf) -> tuple[Array, Array]:
        """Return the smallest gaps apart from the contact or above a penetration, and the points.

        Gaps are at most ``most``. The points of the tread are local, shape (n, 3) [m].
        """
        gaps, points = np.empty(placed.shape[1]), np.empty((placed.shape[1], 3))
        compiled = getattr(self.terrain, "smallest_gaps", None)
        near = NEAR * self.wheel.radius
        for k in range(0, gaps.size, CHUNK):
            part = slice(k, k + CHUNK)
            middles, radii, turned = tread = self._tread(*np.split(placed[:, part], (3, 12)))
            if compiled is None:
                ground = self.terrain
                spokes = (CIRCLE @ turned)[:, :, None]
                at = middles[:, None] + radii[:, None, :, None] * spokes + ground.origin
                gap = at[..., 2] - ground.elevation(at[..., 0], at[..., 1])
                (i, j), low = (size // 2 for size in gap.shape[1:]), minima(gap)
                # the contact point lies in the middle of the grid, which starts from its normal
                low[:, i - 1 : i + 2, max(j - 1, 0) : j + 2] = False
                # points inside the ground count everywhere, also next to the contact point
                values = np.where(low | (gap < -touching), gap, np.inf)
                for place in zip(*np.nonzero(low & (gap < near)), strict=True):
                    values[place] = _vertex(gap[place[0]], *place[1:])
                flat = values.reshape(len(values), -1)
                index = flat.argmin(axis=1)
                least = flat[np.arange(len(values)), index]
            else:
                least, index = compiled(*tread, CIRCLE, touching, near, most)
            gaps[part] = np.minimum(least, most)
            rim, across = np.divmod(index, radii.shape[1])
            rows = np.arange(index.size)
            spokes = (CIRCLE[rim, None] @ turned)[:, 0]
            points[part] = middles[rows, across] + radii[rows, across, None] * spokes
        return gaps, points

    def _tread(self, center: Array, rotation: Array, normal: Array) -> tuple[Array, Array, Array]:
        """Return points on the axles (n, section, 3) in local coordinates, radii, and directions.

        Points of the tread are ``middles + radii * spokes``; radii have the shape (n, section). The
        directions (n, 2, 3) are spokes to the contact and a quarter of a turn from it; spokes at
        `RIM_ANGLES` from the contact are ``CIRCLE @ directions``.
        """
        axes = rotation.T.reshape(-1, 3, 3)  # axle, forward, up; column by column
        down = -(axes @ normal.T[..., None])[..., 0]
        v = np.arctan2(down[:, 2], down[:, 1])[:, None]
        u_0 = np.arctan2(np.hypot(down[:, 1], down[:, 2]), down[:, 0])
        # around this angle of the normal, points at equal distances along the section
        angles, lengths = arc_lengths(self.wheel.section)
        half = int(np.ceil(lengths[-1] / 2 / (SPACING * self.wheel.radius)))
        steps = np.linspace(-0.5, 0.5, 2 * half + 1) * lengths[-1] if half else np.zeros(1)
        at = np.interp(u_0, angles, lengths)[:, None] + steps
        along, radii = self.wheel.section.outline(np.interp(at, lengths, angles))
        axle, forward, up = np.moveaxis(axes, 1, 0)
        contact, quarter = (
            np.cos(v) * forward + np.sin(v) * up,
            np.cos(v) * up - np.sin(v) * forward,
        )
        turned = np.stack([contact, quarter], axis=1)
        return center.T[:, None] + along[..., None] * axle[:, None], radii, turned


def second_contacts(
    q: Any, x: Any, z: Any, poses: Sequence[Pose], size: float
) -> tuple[SecondContact, ...]:
    """Return the certificates of the wheels of a model at given poses.

    ``q`` are its quantities: vehicle, ground, contacts and lookups; ``x`` and ``z`` its states and
    unknowns, ``size`` its typical length [m]. A vehicle with parameters has no certificates.
    """
    if q.vehicle.nominal:
        return ()
    checks = list[SecondContact]()
    for wheel, pose, contact in zip(q.vehicle.wheels, poses, q.contacts, strict=True):
        placing = ca.densify(ca.vertcat(pose.origin, ca.vec(pose.rotation), contact.normal))
        function = lookup_function(q.lookups.lookups, "wheel", [pack(x), pack(z)], [placing])
        checks.append(SecondContact(q.terrain, wheel, function, placing, size))
    return tuple(checks)


def _vertex(gap: Array, i: int, j: int) -> float:
    """Return the refined value of the gap's local minimum at (i, j) [m].

    The value is the vertex of parabolas through the minimum and its neighbours.
    """
    drop = 0.0
    for line, k in ((gap[:, j], i), (gap[i, :], j)):
        if 0 < k < line.size - 1:
            slope = (line[k + 1] - line[k - 1]) / 2
            bend = line[k + 1] - 2 * line[k] + line[k - 1]
            drop += slope**2 / (2 * bend) if bend > 0 else 0.0
    return float(gap[i, j] - drop)
