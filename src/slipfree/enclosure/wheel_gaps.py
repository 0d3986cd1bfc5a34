"""Bounds of the gaps between wheels and ground, and of their derivatives, over boxes of poses.

The gap of a wheel is the smallest vertical distance of a point of its tread from the ground. As a
function of the coordinates of the vehicle it is Lipschitz continuous, and a generalised derivative
is an average of the derivatives at points of the tread that attain the minimum. The tread is
divided into patches. A patch is discarded if, for all poses of the box, its points are higher above
the ground than the reference point, or the distance changes along it; the remaining patches are
divided until they are small. They contain all points that touch the ground first, wherever these
are: nothing is assumed on the number of contacts.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.closure import check_exact_closure
from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.interval import Intervals, around, evaluate_interval, exactly, stack
from slipfree.core.lookups import LookupTable
from slipfree.core.records import Array, Indices, Mask, leaves, pack
from slipfree.enclosure.ground_range import GroundRange
from slipfree.models.base import VehicleState, carriers
from slipfree.terrain.bicubic import Bicubic

AROUND, ACROSS = 12, 3  # patches of a tread at the beginning
SMALLEST_TURN = 2e-3  # half-size of the smallest patches [rad]
COARSE_TURN = 2e-2  # half-size of the smallest patches for a first look [rad]
SHARE = 0.15  # half-size of the smallest patches, relative to the turn of the wheel in the box
EDGE = 1e-6  # patches closer to an edge of the tread touch it [rad]
MAX_PATCHES = 6000  # of a pose, which is given up if it has more
PARTS = 4  # boxes, one inside the other, over which slopes are averaged; a power of two


class WheelPoses(NamedTuple):
    """Enclosures of the poses of carriers; the last two axes of all shapes are wheels and boxes."""

    center: Intervals  # shape (3, n_wheels, n) [m]
    rotation: Intervals  # matrices from the frames of the carriers, shape (3, 3, n_wheels, n)


class PoseSlopes(NamedTuple):
    """Enclosures of the derivatives of poses of carriers by all coordinates."""

    center: Intervals  # shape (n_y, 3, n_wheels, n)
    # of the same shape: elements xy, xz and yz of the skew matrices ``R' dR`` of the rotations
    turning: Intervals


class PoseGraphs(NamedTuple):
    """Functions of the coordinates of a vehicle: the given ones, then those of the closure."""

    poses: ca.Function
    slopes: ca.Function
    given: int  # number of given coordinates: the states of the model
    names: tuple[str, ...]
    shift: Array  # from local to map coordinates
    radii: Array  # of tube and circle of tube centres of the wheels, shape (2, n_wheels) [m]


@lru_cache(maxsize=8)
def pose_graphs(dae: Dae) -> PoseGraphs:
    """Return the functions of a model; ModelError is raised for models without guarantees."""
    vehicle = dae.vehicle
    if vehicle is None or type(dae.ground) is not Bicubic:  # a paged map is known in part only
        raise ModelError(
            "guarantee: expected a model of a vehicle on a map (Bicubic) that is in memory as a "
            f"whole, found {type(dae.ground).__name__}; sample the ground on a grid, or cut the map"
        )
    check_exact_closure(vehicle, "guarantee", remedy="its poses are not determined by the ground")
    radii = [wheel.section.torus_radii for wheel in vehicle.numeric.wheels]
    position: Any = dae.z[0]
    if vehicle.nominal or dae.rest.numel() or dae.standing is not None or None in radii:
        raise ModelError(
            "guarantee: expected kinematics or quasi-statics with exact contact, without fitted "
            "parameters, and wheels that are tori, discs or spheres, found another model; use "
            "direct_kinematics"
        )
    poses = carriers(VehicleState(vehicle, dae.ground, LookupTable(), dae.x, position))
    closed = position.z, position.roll, position.pitch, position.suspension
    y = ca.vertcat(pack(dae.x), pack(closed))
    given = pack(dae.x).numel()
    labels: Any = dae.labels.z[0]
    known = labels.z, labels.roll, labels.pitch, labels.suspension
    names = tuple(label.full for label in leaves((dae.labels.x, known)))
    shift = np.concatenate([dae.shift[0], dae.shift[1][: len(names) - given]])
    placed = [ca.vertcat(each.origin, ca.vec(each.rotation)) for each in poses]
    slopes = list[ca.SX]()
    for each in poses:
        moved = ca.jacobian(ca.vertcat(each.origin, ca.vec(each.rotation)), y)
        for k in range(y.numel()):
            turning = each.rotation.T @ ca.reshape(moved[3:, k], 3, 3)
            slopes += [moved[:3, k], turning[0, 1], turning[0, 2], turning[1, 2]]
    return PoseGraphs(
        ca.Function("poses", [y], [ca.densify(ca.vertcat(*placed))], {"cse": True}),
        ca.Function("slopes", [y], [ca.densify(ca.vertcat(*slopes))], {"cse": True}),
        given,
        names,
        shift,
        np.array(radii, dtype=float).T,
    )


def wheel_poses(graphs: PoseGraphs, box: Intervals) -> WheelPoses:
    """Return the enclosures of poses over boxes of coordinates, shape (n_y, n)."""
    found = evaluate_interval(graphs.poses, box)
    shape = graphs.radii.shape[1], 4, 3, -1  # columns of the matrices follow the centres
    low, high = (each.reshape(shape).transpose(1, 2, 0, 3) for each in (found.low, found.high))
    center, axes = Intervals(low[0], high[0]), Intervals(low[1:], high[1:])
    return WheelPoses(center, Intervals(axes.low.swapaxes(0, 1), axes.high.swapaxes(0, 1)))


def pose_slopes(graphs: PoseGraphs, box: Intervals) -> PoseSlopes:
    """Return the enclosures of derivatives over boxes of coordinates, shape (n_y, n)."""
    found = evaluate_interval(graphs.slopes, box)
    shape = graphs.radii.shape[1], len(graphs.names), 2, 3, -1
    low, high = (each.reshape(shape).transpose(2, 1, 3, 0, 4) for each in (found.low, found.high))
    return PoseSlopes(Intervals(low[0], high[0]), Intervals(low[1], high[1]))


class GapBounds(NamedTuple):
    """Bounds of the gaps of n boxes of poses; not a number where they are not known."""

    gap: Intervals  # at the middle of the box, shape (n_wheels, n) [m]
    slope: Intervals  # over the box, by all coordinates, shape (n_wheels, n_y, n)
    mean_slope: Intervals  # averages along lines from the middle to points of the box
    on_map: Mask  # whether the wheels stay on the map, shape (n,)


class _Patches(NamedTuple):
    """Patches of treads: lane, wheel, middles (2, n) and half-sizes (2, n) of the angles [rad]."""

    lane: Indices
    wheel: Indices
    middle: Array
    half: Array

    def at(self, index: Mask | Indices) -> _Patches:
        return _Patches(
            self.lane[index], self.wheel[index], self.middle[:, index], self.half[:, index]
        )


class _Examined(NamedTuple):
    """What is known of patches, shape (n,)."""

    gap: Intervals  # at the middle of the box [m]
    above: Array  # upper bound of the gap at the middle of the patch [m]
    is_open: Mask  # whether a point of the patch may touch the ground first
    is_middle_known: Mask  # whether the ground is known under the middle of the patch
    is_known: Mask  # whether it is known under all poses of the patch


class _PoseBox(NamedTuple):
    """Enclosures over a box of poses, and at its middle; the last axes are wheels and boxes."""

    radii: Array  # of the sections
    start: WheelPoses
    over: WheelPoses
    moving: PoseSlopes
    spot: Intervals  # reference points in the frames of the carriers, shape (3, n_wheels, n)
    gap: Intervals  # distances of the reference points from the ground at the middle
    slopes: Intervals  # of the ground under the reference points, over the box, (2, n_wheels, n)
    turn: Array  # sums of the turns about the axes of the carrier, (3, n_wheels, n) [rad]
    shift: Array  # sums of the horizontal changes of the reference point, (2, n_wheels, n)


def gap_bounds(
    graphs: PoseGraphs,
    ground: GroundRange,
    middle: Array,
    radius: Array,
    contacts: Array,
    *,
    coarse: bool = False,
) -> GapBounds:
    """Return bounds of the gaps for boxes of coordinates.

    Parameters
    ----------
    graphs : PoseGraphs
        The vehicle.
    ground : GroundRange
        The map.
    middle, radius : ndarray, shape (n_y, n)
        Local coordinates, and half-sizes of the boxes. [m, rad]
    contacts : ndarray, shape (2, n_wheels, n)
        Points of the ground close to the contacts, which only affect the speed. [m]
    coarse : bool
        Whether wide bounds suffice, for small boxes.
    """
    box = _box(graphs, ground, middle, radius, contacts)
    n, shape = middle.shape[1], (graphs.radii.shape[1], middle.shape[1])
    smallest = COARSE_TURN if coarse else SMALLEST_TURN
    patches, least, on_map, is_complete = _touching(box, ground, n, smallest)
    slope = _hull(_slopes(box, ground, patches), patches, shape)
    parts = 1 if coarse else PARTS
    mean, lost = slope * (1 / parts), np.where(is_complete, 0.0, np.nan)
    # a line from the middle passes through the smaller boxes first
    inner = box
    for k in range(parts - 1, 0, -1):
        inner = _box(graphs, ground, middle, radius * (k / parts * (1 + 1e-12)), contacts)
        patches = patches.at(_examine(inner, ground, patches).is_open)
        mean = mean + _hull(_slopes(inner, ground, patches), patches, shape) * (1 / parts)
    below = _hull(_examine(inner, ground, patches).gap[None], patches, shape).low[:, 0]
    return GapBounds(Intervals(np.minimum(below, least) + lost, least + lost), slope, mean, on_map)


def _touching(
    box: _PoseBox, ground: GroundRange, n: int, smallest: float
) -> tuple[_Patches, Array, Mask, Mask]:
    """Return small patches that contain the points that may touch the ground first.

    Also return upper bounds of the gaps at the middles of the boxes, shape (n_wheels, n), and
    whether the wheels stay on the map, and whether the patches are complete, shape (n,).
    """
    patches, done = _whole_treads(box.radii, n), list[_Patches]()
    target = np.maximum(SHARE * box.turn.max(axis=0), smallest)
    on_map, given_up = np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
    least = box.gap.high.copy()
    while patches.lane.size:
        found = _examine(box, ground, patches)
        np.minimum.at(least, (patches.wheel, patches.lane), found.above)
        sizes = _sizes(box.radii, patches)
        small = sizes.max(axis=0) <= target[patches.wheel, patches.lane]
        on_map[patches.lane[~found.is_middle_known | (small & ~found.is_known)]] = False
        given_up |= np.bincount(patches.lane, minlength=n) > MAX_PATCHES
        keep = found.is_open & (on_map & ~given_up)[patches.lane]
        done.append(patches.at(keep & small))
        keep &= ~small
        patches = _halves(patches.at(keep), sizes[:, keep])
    return _joined(done), least, on_map, on_map & ~given_up


def _hull(values: Intervals, patches: _Patches, shape: tuple[int, int]) -> Intervals:
    """Return the hulls of intervals (n_rows, n) of patches, by wheels and lanes.

    The result has the shape (n_wheels, n_rows, n_lanes); wheels without patches have no bounds.
    """
    wheels, n = shape
    rows = values.low.shape[0]
    hulls = np.full((2, wheels, n, rows), np.nan)
    order = np.lexsort((patches.lane, patches.wheel))
    key = patches.wheel[order] * n + patches.lane[order]
    found, first = np.unique(key, return_index=True)
    if found.size:
        flat = hulls.reshape(2, wheels * n, rows)
        flat[0, found] = np.minimum.reduceat(values.low[:, order], first, axis=1).T
        flat[1, found] = np.maximum.reduceat(values.high[:, order], first, axis=1).T
    return Intervals(hulls[0].swapaxes(1, 2), hulls[1].swapaxes(1, 2))


def _box(
    graphs: PoseGraphs, ground: GroundRange, middle: Array, radius: Array, contacts: Array
) -> _PoseBox:
    start = wheel_poses(graphs, exactly(middle))
    over = wheel_poses(graphs, around(middle, radius))
    moving = pose_slopes(graphs, around(middle, radius))
    jets = ground.jets(contacts.reshape(2, -1))
    slope = jets.slope.reshape(contacts.shape)
    # any angles are valid for the reference points, so that rounding has no effect
    axes = start.rotation.low
    down = slope[0] * axes[0] + slope[1] * axes[1] - axes[2]
    across = np.arctan2(np.hypot(down[1], down[2]), down[0])
    across = np.where(graphs.radii[0, :, None] > 0, across, np.pi / 2)
    angles = np.nan_to_num(np.stack([np.arctan2(down[2], down[1]), across]))
    spot = _tread(graphs.radii[:, :, None], exactly(angles))[0]
    place = _placed(start, spot)
    center, away = _flat(place)
    height = ground.heights(ground.jets(center), away.magnitude)
    gap = place[2] - Intervals(
        *(each.reshape(slope[0].shape) for each in (height.low, height.high))
    )
    turns = np.einsum("k...n,kn->...n", moving.turning.magnitude, radius)
    turned = _turned(moving.turning, spot)
    moved = moving.center[:, :2]
    for j in range(3):
        moved = moved + over.rotation[:2, j] * turned[j][:, None]
    shifts = np.einsum("k...n,kn->...n", moved.magnitude, radius)
    slopes, grown = _ground_slopes(ground, _placed(over, spot)), 1 + 1e-12
    return _PoseBox(
        graphs.radii, start, over, moving, spot, gap, slopes, turns * grown, shifts * grown
    )


def _whole_treads(radii: Array, n: int) -> _Patches:
    parts = list[_Patches]()
    for wheel, tube in enumerate(radii[0]):
        counts = np.array([AROUND, ACROSS if tube > 0 else 1])
        v, u = ((2 * np.arange(count) + 1) * np.pi / 2 / count for count in counts)
        grid = np.stack(np.meshgrid(2 * v, u, indexing="ij")).reshape(2, -1)
        # the halves are slightly larger, so that patches overlap
        half = np.array([[np.pi], [np.pi / 2]]) / counts[:, None] * (1 + 1e-9)
        half[1] *= tube > 0
        lanes = np.repeat(np.arange(n), counts.prod())
        whole = np.full(lanes.size, wheel), np.tile(grid, n), np.tile(half, lanes.size)
        parts.append(_Patches(lanes, *whole))
    return _joined(parts)


def _joined(parts: Sequence[_Patches]) -> _Patches:
    return _Patches(*(np.concatenate(each, axis=-1) for each in zip(*parts, strict=True)))


def _sizes(radii: Array, patches: _Patches) -> Array:
    """Return half-sizes around and across, relative to the rolling radius."""
    tube, circle = radii[:, patches.wheel]
    return np.asarray(patches.half * np.stack([np.ones_like(tube), tube / (tube + circle)]))


def _halves(patches: _Patches, sizes: Array) -> _Patches:
    """Return the patches divided in two along their longer side."""
    longer = np.stack([sizes[0] >= sizes[1], sizes[0] < sizes[1]])
    half = np.where(longer, patches.half / 2 * (1 + 1e-9), patches.half)
    step = np.where(longer, patches.half / 2, 0.0)
    return _Patches(
        np.tile(patches.lane, 2),
        np.tile(patches.wheel, 2),
        np.concatenate([patches.middle - step, patches.middle + step], axis=1),
        np.tile(half, 2),
    )


def _tread(radii: Array, angles: Intervals) -> tuple[Intervals, Intervals, Intervals]:
    """Return points of treads in the frames of the carriers, and derivatives by both angles.

    The angles ``v`` about the axle and ``u`` of the normal from the axle have the shape (2, ...);
    the results (3, ...).
    """
    tube, circle = radii
    cos, sin = angles.cos(), angles.sin()
    (cos_v, cos_u), (sin_v, sin_u) = (cos[0], cos[1]), (sin[0], sin[1])
    axial, away = cos_u * tube, sin_u * tube
    rho = away + circle
    zero = exactly(np.zeros_like(rho.low))
    point = stack([axial, rho * cos_v, rho * sin_v])
    turned = stack([zero, -(rho * sin_v), rho * cos_v])
    rolled = stack([-away, axial * cos_v, axial * sin_v])
    return point, turned, rolled


def _placed(poses: WheelPoses, spot: Intervals) -> Intervals:
    """Return positions of points given in the frames of carriers."""
    place = poses.center
    for j in range(3):
        place = place + poses.rotation[:, j] * spot[j]
    return place


def _flat(place: Intervals) -> tuple[Array, Intervals]:
    """Return the horizontal centres of boxes of points (3, ...), and the rectangles about them.

    The shape is (2, n), with all boxes along one axis.
    """
    low, high = (each[:2].reshape(2, -1) for each in (place.low, place.high))
    center = (low + high) / 2
    return center, Intervals(low, high) - center


def _ground_slopes(ground: GroundRange, place: Intervals) -> Intervals:
    """Return bounds of the slopes of the ground under points (3, ...), shape (2, ...)."""
    center, away = _flat(place)
    found, shape = ground.slopes(ground.jets(center), away), (2, *place.low.shape[1:])
    return Intervals(found.low.reshape(shape), found.high.reshape(shape))


def _examine(box: _PoseBox, ground: GroundRange, patches: _Patches) -> _Examined:
    """Return which patches may touch the ground first at a pose of their boxes."""
    here = patches.wheel, patches.lane
    radii = box.radii[:, patches.wheel]
    thin, wide = _at(box.start, here), _at(box.over, here)
    middle = _placed(thin, _tread(radii, exactly(patches.middle))[0])
    spot, turned, rolled = _tread(radii, around(patches.middle, patches.half))
    place = _placed(wide, spot)

    center, near = _flat(middle)
    jets, away = ground.jets(center), place[:2] - center
    height, slopes = ground.heights(jets, near.magnitude), ground.slopes(jets, away)
    points, squares = ground.is_known(center, away.magnitude.max(axis=0))
    normal = wide.rotation[2] - wide.rotation[0] * slopes[0] - wide.rotation[1] * slopes[1]

    around_slope = _dot(normal, turned)
    across_slope = _dot(normal, rolled)
    spread = around_slope.magnitude * patches.half[0] + across_slope.magnitude * patches.half[1]
    spread *= 1 + 1e-12
    point = middle[2] - height
    gap = point + Intervals(-spread, spread)

    apart = (spot - box.spot[:, *here]).magnitude
    xy, xz, yz = box.turn[:, *here]
    change = normal[0].magnitude * (xy * apart[1] + xz * apart[2])
    change += normal[1].magnitude * (xy * apart[0] + yz * apart[2])
    change += normal[2].magnitude * (xz * apart[0] + yz * apart[1])
    change += ((slopes - box.slopes[:, *here]).magnitude * box.shift[:, *here]).sum(axis=0)
    limit = box.gap.high[here] + change
    higher = gap.low > limit + 1e-12 * (np.abs(limit) + change)
    inside = _is_inside(patches)
    changes = ~around_slope.contains_zero | (~across_slope.contains_zero & inside)
    return _Examined(gap, point.high, ~squares | ~(higher | changes), points, squares)


def _slopes(box: _PoseBox, ground: GroundRange, patches: _Patches) -> Intervals:
    """Return the derivatives of the distances from the ground by all coordinates, (n_y, n).

    The derivative by a coordinate that moves the centre by ``dC`` and turns the carrier by ``W`` is
    ``a . dC + N . W b``, for the upward normal ``a = (-h_x, -h_y, 1)`` of the ground, in the frame
    of the carrier ``N``, and the point ``b`` of the tread. Where the distance is smallest on the
    lower side, ``b`` is ``-r1 N / |N| - r2 e``, with the unit vector ``e`` of the component of
    ``N`` perpendicular to the axle. The term of ``N`` vanishes, and of that of ``e`` only the
    component of ``N`` along the axle remains: the bounds do not depend on the size of the patch.
    """
    here = patches.wheel, patches.lane
    wide = _at(box.over, here)
    tube, circle = radii = box.radii[:, patches.wheel]
    angles = around(patches.middle, patches.half)
    spot = _tread(radii, angles)[0]
    slopes = _ground_slopes(ground, _placed(wide, spot))
    x, y = slopes[0], slopes[1]
    normal = wide.rotation[2] - wide.rotation[0] * x - wide.rotation[1] * y
    moved, turning = box.moving.center[:, :, *here], box.moving.turning[:, :, *here]
    below = (angles[0].cos() * normal[1] + angles[0].sin() * normal[2]).high < 0
    is_smooth = below & (_is_inside(patches) | (tube == 0))
    axial = normal[0] * (normal[1].square() + normal[2].square()).sqrt().inverse() * -circle
    on_axle = (turning[:, 0] * normal[1] + turning[:, 1] * normal[2]) * axial
    anywhere = _dot(_turned(turning, spot), normal)
    low = np.where(is_smooth, on_axle.low, anywhere.low)
    high = np.where(is_smooth, on_axle.high, anywhere.high)
    return moved[:, 2] - moved[:, 0] * x - moved[:, 1] * y + Intervals(low, high)


def _at(poses: WheelPoses, here: tuple[Indices, Indices]) -> WheelPoses:
    return WheelPoses(poses.center[:, *here], poses.rotation[:, :, *here])


def _is_inside(patches: _Patches) -> Mask:
    """Return whether patches do not touch the edges of the tread."""
    u, half = patches.middle[1], patches.half[1]
    return np.asarray((u - half > EDGE) & (u + half < np.pi - EDGE))


def _turned(turning: Intervals, spot: Intervals) -> tuple[Intervals, Intervals, Intervals]:
    """Return the velocities of points of carriers for turns (n_y, 3, ...) in their own frames."""
    xy, xz, yz = (turning[:, j] for j in range(3))
    return xy * spot[1] + xz * spot[2], yz * spot[2] - xy * spot[0], -(xz * spot[0] + yz * spot[1])


def _dot(a: Sequence[Intervals] | Intervals, b: Sequence[Intervals] | Intervals) -> Intervals:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
