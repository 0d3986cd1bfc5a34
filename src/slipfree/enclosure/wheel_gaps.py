"""Bounds of the gaps between wheels and ground, and of their derivatives, over boxes of poses.

The gap of a wheel is the smallest vertical distance of a point of its tread from the ground. As a
function of the coordinates of the vehicle it is Lipschitz continuous, and a generalised derivative
is an average of the derivatives at points of the tread that attain the minimum. The tread is
divided into patches. A patch is discarded if, for all poses of the box, its points are higher above
the ground than the reference point, or the distance changes along it; the remaining patches are
divided until they are small. They contain all points that touch the ground first, wherever these
are: nothing is assumed on the number of contacts.

Most wheels are bounded without patches. Let ``b0`` be the lowest point of the tread for the normal
``N0``, and ``b`` another one, whose normal from the tube is turned by a chord ``A`` and whose
direction from the axle by a chord ``V``. Then ``N0 . (b - b0) = (r1 |N0| A^2 + r2 |N0'| V^2) / 2``,
with the component ``N0'`` perpendicular to the axle. This is compared with the curvature of the
ground and the change of its normal in the box: where it is larger, ``b`` does not touch, and
the contact is a single one, in a small region about ``b0``.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache, reduce
from itertools import product
from operator import add
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.contact.closure import check_exact_closure
from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.interval import Intervals, around, evaluate_interval, exactly, stack
from slipfree.core.lookups import LookupTable, library, pointer
from slipfree.core.records import Array, Indices, Mask, leaves, pack
from slipfree.enclosure.ground_range import GroundRange, Jets
from slipfree.geometry.frame import turn, unit_vector
from slipfree.models.base import VehicleState, carriers, masses_of, platform_pose, values_of
from slipfree.terrain.bicubic import Bicubic
from slipfree.vehicle.formula import evaluate
from slipfree.vehicle.shapes import bounding_box

AROUND, ACROSS = 12, 3  # patches of a tread at the beginning
SMALLEST_TURN = 2e-3  # half-size of the smallest patches [rad]
REGION_TURN = 1e-2  # half-size of the smallest patches where a wheel may touch [rad]
REGION_SHARE = 0.1  # their half-size, relative to that of the region
SHARE = 0.15  # half-size of the smallest patches, relative to the turn of the wheel in the box
QUICK_SHARE = 0.25  # the same, if only wheels without a single contact are divided
EDGE = 1e-6  # patches closer to an edge of the tread touch it [rad]
MAX_PATCHES = 6000  # of a pose, which is given up if it has more
RINGS = 16  # parts of a tread outside the region of a single contact
FACTOR = 2.5  # half-size of this region, relative to the displacement of the contact in the box
REGION = 0.05, 0.4  # its bounds: halves of chords of the unit circle
CHUNK = 512  # boxes whose treads are divided together
SLACK = 1e-9  # for rounding in inequalities of magnitudes, relative
PARTS = 4  # boxes, one inside the other, over which slopes are averaged; a power of two


class WheelPoses(NamedTuple):
    """Enclosures of the poses of carriers; the last two axes of all shapes are wheels and boxes."""

    center: Intervals  # shape (3, n_wheels, n) [m]
    rotation: Intervals  # matrices from the frames of the carriers, shape (3, 3, n_wheels, n)


class PoseSlopes(NamedTuple):
    """Enclosures of the derivatives of poses of carriers by the directions of a frame."""

    center: Intervals  # along x and y, and above a plane, shape (n_a, 3, n_wheels, n)
    # of the same shape: elements xy, xz and yz of the skew matrices ``R' dR`` of the rotations
    turning: Intervals
    tilt: Array  # slopes of the plane, shape (2, n_wheels, n)

    def at(self, here: tuple[Indices, Indices]) -> PoseSlopes:
        """Return the derivatives for wheels and boxes."""
        center, turning = (each[:, :, *here] for each in self[:2])
        return PoseSlopes(center, turning, self.tilt[:, *here])


class Boxes(NamedTuple):
    """Curved boxes ``y + F s + s' C s / 2`` of coordinates, with ``|s| <= radius``.

    A box with edges along the coordinates also contains poses at which a wheel is far from the
    ground. If ``s_i`` changes the gap of wheel ``i`` alone, up to terms of third order, there are
    hardly any of those. The proof holds for any ``F`` and ``C``.
    """

    middle: Array  # ``y``, shape (n_y, n) [m, rad]
    frame: Array  # ``F``, shape (n_a, n_a, n), in the rows of the moving coordinates
    curve: Array  # ``C``, symmetric, shape (n_a, n_a, n_a, n)
    radius: Array  # shape (n_a, n)
    contacts: Array  # points of the ground close to the contacts: for the speed, (2, n_wheels, n)

    @property
    def reach(self) -> Array:
        """Largest changes of the moving coordinates, shape (n_a, n) [m, rad]."""
        slope = np.abs(self.frame) + self.bend / 2
        return np.asarray(np.einsum("kan,an->kn", slope, self.radius) * (1 + SLACK))

    @property
    def bend(self) -> Array:
        """Largest changes of the derivatives of the coordinates by ``s``, shape (n_a, n_a, n)."""
        return np.asarray(np.einsum("kabn,bn->kan", abs(self.curve), self.radius) * (1 + SLACK))

    def image(self, s: Intervals) -> Intervals:
        """Return bounds of the changes of the moving coordinates for ``s``, shape (n_a, n)."""
        total = exactly(np.zeros(1))
        for a, row in enumerate(s):
            slope, half = self.frame[:, a], self.curve[:, a, a] / 2
            whole = row * slope + row.square() * half
            ends = [exactly(end) * half * end + exactly(end) * slope for end in (row.low, row.high)]
            low = np.minimum(ends[0].low, ends[1].low)
            high = np.maximum(ends[0].high, ends[1].high)
            rises = np.abs(slope) > 2.1 * np.abs(half) * row.magnitude  # or falls, everywhere
            narrow = Intervals(np.where(rises, low, whole.low), np.where(rises, high, whole.high))
            mixed = (row * s[b] * self.curve[:, a, b] for b in range(a))
            total = reduce(add, mixed, total + narrow)
        return total

    def at(self, lanes: Indices | Mask) -> Boxes:
        """Return some of the boxes."""
        return Boxes(*(each[..., lanes] for each in self))


class MovingJoint(NamedTuple):
    """A joint whose value depends on coordinates that vary; the platform has six of them."""

    parent: int  # number of the joint that carries it; -1 for the ground
    is_slide: bool
    is_offset: bool  # whether it has an arm about the origin of a joint that moves and carries it


class PoseGraphs(NamedTuple):
    """Functions of the coordinates of a vehicle: the given ones, then those of the closure."""

    poses: ca.Function  # origins and axes of the joints, then origins and rotations of the wheels
    rates: ca.Function  # first and second derivatives of the joints' values
    # of coordinates, and of heights and slopes of planes under the wheels: distances of the wheels
    # from the planes, their derivatives, and the second derivatives of the rises of the wheels
    tangents: ca.Function
    bodies: ca.Function  # centre of mass, and centres and axes of the boxes about the shapes
    body_slopes: ca.Function  # their derivatives by the coordinates that vary
    joints: tuple[MovingJoint, ...]
    carriers: tuple[int, ...]  # numbers of the joints that carry the wheels
    moving: Indices  # numbers of the coordinates that vary: given ones with a spread, and the last
    given: int  # number of given coordinates: the states of the model
    names: tuple[str, ...]
    shift: Array  # from local to map coordinates
    radii: Array  # of tube and circle of tube centres of the wheels, shape (2, n_wheels) [m]


@lru_cache(maxsize=8)
def pose_graphs(dae: Dae, spread: tuple[bool, ...] = ()) -> PoseGraphs:
    """Return the functions of a model; ModelError is raised for models without guarantees.

    ``spread`` tells which states vary; none by default.
    """
    vehicle = dae.vehicle
    if vehicle is None or type(dae.ground) is not Bicubic:  # a paged map is known in part only
        raise ModelError(
            "guarantee: expected a model of a vehicle on a map (Bicubic) that is in memory as a "
            f"whole, found {type(dae.ground).__name__}; sample the ground on a grid, or cut the map"
        )
    check_exact_closure(vehicle, "guarantee", remedy="its poses are not determined by the ground")
    radii = [wheel.section.torus_radii for wheel in vehicle.numeric.wheels]
    kinds = {
        "fitted parameters": vehicle.nominal,
        "pressed wheels or inertia": dae.rest.numel() or dae.standing is not None,
        "wheels with another section": None in radii,
    }
    if found := [kind for kind, has_kind in kinds.items() if has_kind]:
        raise ModelError(
            "guarantee: expected kinematics or quasi-statics with exact contact, and wheels that "
            f"are tori, discs or spheres, found {' and '.join(found)}; use direct_kinematics with "
            "such wheels"
        )
    position: Any = dae.z[0]
    state = VehicleState(vehicle, dae.ground, LookupTable(), dae.x, position)
    closed = position.z, position.roll, position.pitch, position.suspension
    y = ca.vertcat(pack(dae.x), pack(closed))
    given = pack(dae.x).numel()
    labels: Any = dae.labels.z[0]
    known = labels.z, labels.roll, labels.pitch, labels.suspension
    names = tuple(label.full for label in leaves((dae.labels.x, known)))
    shift = np.concatenate([dae.shift[0], dae.shift[1][: len(names) - given]])
    moving = np.flatnonzero([*(spread or given * [False]), *(len(names) - given) * [True]])
    joints, placed, values, numbers = list[MovingJoint](), list[ca.SX](), list[ca.SX](), {"": -1}
    origins = list[ca.SX]()
    for name, parent, is_slide, axis, origin, value in joint_chain(state):
        numbers[name] = numbers[parent]
        if any(ca.which_depends(value, y[moving.tolist()], 1)):
            numbers[name], by = len(joints), numbers[parent]
            is_offset = by >= 0 and (is_slide or not ca.is_equal(origin, origins[by]))
            joints.append(MovingJoint(by, is_slide, is_offset))
            origins.append(origin)
            placed += [origin, axis]
            values.append(value)
    tori = np.array(radii, dtype=float)
    tilt, planes, rises = ca.SX.sym("tilt", 3, len(vehicle.wheels)), list[ca.SX](), list[ca.SX]()
    for pose, (tube, circle), plane in zip(carriers(state), tori, ca.horzsplit(tilt), strict=True):
        placed += [pose.origin, ca.vec(pose.rotation)]
        normal = ca.vertcat(-plane[1:], 1.0)
        rises.append(ca.dot(normal, pose.origin))
        across = ca.sumsqr(normal) - ca.dot(normal, pose.rotation[:, 0]) ** 2
        planes.append(rises[-1] - plane[0] - tube * ca.norm_2(normal) - circle * ca.sqrt(across))
    parts = vehicle.parts(platform_pose(state), values_of(state))
    frames = [parts[name] @ bounding_box(shape)[0] for name, shape in vehicle.shapes]
    center = sum((mass * at for _, mass, at in masses_of(state)), ca.SX.zeros(3))
    bodies = ca.vertcat(
        center / (vehicle.mass or 1.0),
        *(ca.vertcat(each.origin, ca.vec(each.rotation)) for each in frames),
    )

    def along(values: ca.SX) -> ca.SX:
        """Return the derivatives of values by the coordinates that vary, one after another."""
        return ca.vec(ca.densify(ca.jacobian(values, y)[:, moving.tolist()]))

    rate, rise = along(ca.vertcat(*values)), along(ca.vertcat(*rises))
    tangents = ca.vertcat(*planes, along(ca.vertcat(*planes)), along(rise))
    return PoseGraphs(
        ca.Function("poses", [y], [ca.densify(ca.vertcat(*placed))], {"cse": True}),
        ca.Function("rates", [y], [ca.vertcat(rate, along(rate))], {"cse": True}),
        ca.Function("tangents", [y, ca.vec(tilt)], [tangents], {"cse": True}),
        ca.Function("bodies", [y], [ca.densify(bodies)], {"cse": True}),
        ca.Function("body_slopes", [y], [along(bodies)], {"cse": True}),
        tuple(joints),
        tuple(numbers[wheel.parent] for wheel in vehicle.wheels),
        moving,
        given,
        names,
        shift,
        tori.T,
    )


def joint_chain(state: VehicleState) -> Iterator[tuple[str, str, bool, ca.SX, ca.SX, ca.SX]]:
    """Yield name, parent, whether it slides, axis, origin and value of all joints, in fixed axes.

    The platform is carried by three slides and three turns (`slipfree.geometry.frame.platform`).
    """
    base, x, position = platform_pose(state), state.x, state.position
    level, (along_x, along_y, along_z) = turn("z", x.heading).rotation, ca.horzsplit(ca.SX.eye(3))
    yield "x", "", True, along_x, base.origin, x.x
    yield "y", "x", True, along_y, base.origin, x.y
    yield "z", "y", True, along_z, base.origin, position.z
    yield "heading", "z", False, along_z, base.origin, x.heading
    yield "roll", "heading", False, level[:, 1], base.origin, position.roll
    yield "platform", "roll", False, base.rotation[:, 0], base.origin, position.pitch
    values = values_of(state)
    parts = state.vehicle.parts(base, values)
    for joint in state.vehicle.joints:
        part, value = parts[joint.name], evaluate(joint.value, values)
        axis = part.rotation @ ca.DM(unit_vector(joint.axis))
        yield joint.name, joint.parent, joint.motion == "slide", axis, part.origin, value


def tangents(
    graphs: PoseGraphs, ground: GroundRange, middle: Array, contacts: Array
) -> tuple[Array, Array, Array]:
    """Return distances of wheels from planes that touch the ground, at coordinates (n_y, n).

    Also return their derivatives by the moving coordinates, shape (n_a, n_wheels, n), and second
    derivatives of the rises of the wheels, shape (n_a, n_a, n_wheels, n). The contacts are those of
    `Boxes`. Errors of rounding are not included: this chooses boxes, which may be any.
    """
    (count, wheels), n = (graphs.moving.size, contacts.shape[1]), contacts.shape[2]
    places = contacts.reshape(2, -1)
    jets = ground.jets(places)
    planes = np.stack([jets.height - (jets.slope * places).sum(axis=0), *jets.slope])
    planes = planes.reshape(3, wheels, n).swapaxes(0, 1).reshape(-1, n)
    found = np.array(graphs.tangents(middle, planes)).reshape(-1, wheels, n)
    return found[0], found[1 : count + 1], found[count + 1 :].reshape(count, count, wheels, n)


class _BodyMotion(NamedTuple):
    """Motion of a body of a chain along the frames of boxes, in fixed axes.

    Bounds of second derivatives and of turns hold in the whole boxes.
    """

    origin: Intervals  # at the middle, shape (3, n) [m]
    velocity: Intervals  # of the origin, at the middle, shape (n_a, 3, n)
    spin: Intervals  # vectors of rotation at the middle, shape (n_a, 3, n)
    bend: Intervals  # derivatives of the velocity, shape (n_a, n_a, 3, n)
    twist: Intervals  # derivatives of the spin, of the same shape
    any_spin: Intervals  # spin in the whole box
    turn: Array  # largest components of the turn from the middle, shape (3, n) [rad]


class _Motion(NamedTuple):
    """Poses of carriers at the middles of boxes, and how they change along the frames."""

    start: WheelPoses
    # velocities along x and y and above a plane, and spins in fixed axes, (n_a, 6, n_wheels, n)
    slopes: Intervals
    bends: Array  # largest changes of the slopes in the boxes, of the same shape
    tilt: Array  # slopes of the planes under the wheels, above which they rise, (2, n_wheels, n)


def carrier_motions(graphs: PoseGraphs, boxes: Boxes, tilt: Array) -> _Motion:
    """Return the poses of carriers, with Taylor's formula of second order for their changes.

    Let a joint with axis ``a`` and value ``v`` be carried by a body with spin ``w``, by an arm
    ``r``, and ``,i`` denote derivatives along the frame. Then ``w + a v,i`` is the spin of its own
    body, whose velocity is that of the carrying body and ``w,i x r``. In fixed axes, ``a`` and
    ``r`` turn with the carrying body only as much as it turns in all: turns of joints that
    compensate each other do not add up, as they would if all coordinates varied independently.
    """
    (count, n), radius, curve = boxes.radius.shape, boxes.radius, boxes.curve
    reach, n_joints = np.zeros_like(boxes.middle), len(graphs.joints)
    reach[graphs.moving] = boxes.reach
    places = evaluate_interval(graphs.poses, exactly(boxes.middle))
    axes = _shaped(places[: 6 * n_joints], (n_joints, 2, 3, n))
    wheels = _shaped(places[6 * n_joints :], (len(graphs.carriers), 4, 3, n))

    def along(box: Intervals, frame: Intervals) -> tuple[Intervals, Intervals]:
        """Return first and second derivatives of joint values along the frame."""
        found = evaluate_interval(graphs.rates, box)
        first = _shaped(found[: count * n_joints], (count, n_joints, 1, n))
        second = _shaped(found[count * n_joints :], (count, count, n_joints, 1, 1, n))
        rows = range(count)
        bend = [first[k, :, None] * curve[k] for k in rows]
        if found.low[count * n_joints :].any() or found.high[count * n_joints :].any():
            pairs = product(rows, rows)
            bend += [second[k, j] * (frame[j][:, None] * frame[k][None]) for k, j in pairs]
        return reduce(add, (first[k] * frame[k] for k in rows)), reduce(add, bend)

    def carried(by: _BodyMotion, origin: Intervals, slide: Array) -> _BodyMotion:
        """Return the motion of a point of a body, which also slides by an amount (3, n)."""
        arm = origin - by.origin
        swept = _turned_by(arm, by.turn) + Intervals(-slide, slide)
        bend = _cross(by.any_spin[:, None], _cross(by.any_spin, swept)[None])
        bend = by.bend + bend + _cross(by.twist, swept)
        return by._replace(origin=origin, velocity=by.velocity + _cross(by.spin, arm), bend=bend)

    rates = along(exactly(boxes.middle), exactly(boxes.frame))[0]
    any_rates, bends = along(around(boxes.middle, reach), around(boxes.frame, boxes.bend))
    zero, zeros = (exactly(np.zeros((*shape, 3, n))) for shape in ((count,), (count, count)))
    still = np.zeros((3, n))
    bodies = [_BodyMotion(exactly(still), zero, zero, zeros, zeros, zero, still)]
    for number, (parent, is_slide, is_offset) in enumerate(graphs.joints):
        by, (origin, axis) = bodies[parent + 1], axes[number]
        rate, any_rate = rates[number][:, None], any_rates[number][:, None]
        any_axis = _turned_by(axis, by.turn)
        swing = _cross(by.any_spin, any_axis)
        change = swing[None] * any_rate[:, None] + any_axis * bends[number][:, :, None]
        if is_slide:
            way = (any_rate.magnitude * radius[:, None]).sum(axis=0) * (1 + SLACK)
            body = carried(by, origin, any_axis.magnitude * way) if is_offset else by
            bend = body.bend + change + swing[:, None] * any_rate[None]
            body = body._replace(velocity=body.velocity + axis * rate, bend=bend)
        else:
            spin, twist = by.spin + axis * rate, by.twist + change
            grown = np.einsum("abcn,bn->acn", twist.magnitude, radius) * (1 + SLACK)
            turn = np.einsum("acn,an->cn", spin.magnitude + grown / 2, radius) * (1 + SLACK)
            any_spin = spin + Intervals(-grown, grown)
            body = carried(by, origin, still) if is_offset else by
            body = body._replace(spin=spin, twist=twist, any_spin=any_spin, turn=turn)
        bodies.append(body._replace(origin=origin))
    slopes, second = list[Intervals](), list[Intervals]()
    for k, (parent, pose) in enumerate(zip(graphs.carriers, wheels, strict=True)):
        body = carried(bodies[parent + 1], pose[0], still)
        rows = (slopes, body.velocity, body.spin), (second, body.bend, body.twist)
        for parts, moved, turned in rows:
            x, y, z = (moved[..., j, :] for j in range(3))
            rise = z - x * tilt[0, k] - y * tilt[1, k]
            parts.append(stack([x, y, rise, *(turned[..., j, :] for j in range(3))]))
    slope, bend = stack(slopes, axis=2), stack(second)
    places = Intervals(wheels.low.transpose(1, 2, 0, 3), wheels.high.transpose(1, 2, 0, 3))
    return _Motion(
        WheelPoses(places[0], stack([places[k] for k in (1, 2, 3)], axis=1)),
        Intervals(slope.low.swapaxes(0, 1), slope.high.swapaxes(0, 1)),
        np.einsum("wcabn,bn->acwn", bend.magnitude, radius) * (1 + SLACK),
        tilt,
    )


def _cross(a: Intervals, b: Intervals) -> Intervals:
    """Return cross products; the last axes are components and boxes."""
    (a_x, a_y, a_z), (b_x, b_y, b_z) = ([e[..., j, :] for j in range(3)] for e in (a, b))
    parts = a_y * b_z - a_z * b_y, a_z * b_x - a_x * b_z, a_x * b_y - a_y * b_x
    return stack(parts, axis=-2)


def _turned_by(vectors: Intervals, turn: Array) -> Intervals:
    """Return vectors (3, ...) after rotations whose integrated spins (3, ...) are bounded.

    For a rotation ``R`` by an angle of at most ``t``, the norm of the difference of ``R - 1`` and
    the integral of the skew matrix of its spin is at most ``t^2 / 2``.
    """
    (x, y, z), (about_x, about_y, about_z) = vectors.magnitude, turn
    rest = np.sqrt(x**2 + y**2 + z**2) * (turn**2).sum(axis=0) / 2
    change = [about_y * z + about_z * y, about_x * z + about_z * x, about_x * y + about_y * x]
    reach = (np.stack(change) + rest) * (1 + SLACK)
    return vectors + Intervals(-reach, reach)


class GapBounds(NamedTuple):
    """Bounds of the gaps of n boxes of poses; not a number where they are not known."""

    gap: Intervals  # at the middle of the box, shape (n_wheels, n) [m]
    slope: Intervals  # over the box, along its frame, shape (n_a, n_wheels, n)
    mean_slope: Intervals  # averages along lines from the middle to points of the box
    on_map: Mask  # whether the wheels stay on the map, shape (n,)


class _Patches(NamedTuple):
    """Patches of treads: lane, wheel, middles (2, n) and half-sizes (2, n) of the angles [rad]."""

    lane: Indices
    wheel: Indices
    middle: Array
    half: Array

    def at(self, index: Mask | Indices | slice) -> _Patches:
        return _Patches(
            self.lane[index], self.wheel[index], self.middle[:, index], self.half[:, index]
        )


class _Examined(NamedTuple):
    """Results for patches, shape (n,)."""

    gap: Intervals  # at the middle of the box [m]
    above: Array  # upper bound of the gap at the middle of the patch [m]
    is_open: Mask  # whether a point of the patch may touch the ground first
    is_middle_known: Mask  # whether the ground is known under the middle of the patch
    is_known: Mask  # whether it is known under all poses of the patch


class _Middle(NamedTuple):
    """Enclosures at the middles of boxes; the last axes are wheels and boxes."""

    radii: Array  # of the sections
    motion: _Motion
    start: WheelPoses
    spot: Intervals  # reference points in the frames of the carriers, shape (3, n_wheels, n)
    angles: Array  # of the reference points on the tread, shape (2, n_wheels, n) [rad]
    place: Array  # horizontal positions of the reference points at the middle, shape (2, n)
    jets: Jets  # of the ground under them at the middle
    gap: Intervals  # distances of the reference points from the ground at the middle
    flat: Intervals  # slopes of the ground under the reference points at the middle


class _PoseBox(NamedTuple):
    """Enclosures over boxes of poses, and at their middles; the last axes are wheels and boxes."""

    middle: _Middle
    over: WheelPoses
    moving: PoseSlopes
    slopes: Intervals  # of the ground under the reference points, over the box, (2, n_wheels, n)
    turn: Array  # sums of the turns about the axes of the carrier, (3, n_wheels, n) [rad]
    shift: Array  # sums of the horizontal changes of the reference point, (2, n_wheels, n)


def gap_bounds(
    graphs: PoseGraphs, ground: GroundRange, boxes: Boxes, *, divided: bool = False
) -> GapBounds:
    """Return bounds of the gaps for boxes of coordinates.

    Parameters
    ----------
    graphs : PoseGraphs
        The vehicle.
    ground : GroundRange
        The map.
    boxes : Boxes
        Local coordinates.
    divided : bool
        Whether to divide all treads, which takes longer and gives narrower bounds.
    """
    region: Array | None = None
    averages = list[Intervals]()
    is_single: Mask = np.full(boxes.contacts.shape[1:], not divided)
    middle = _middle(graphs, ground, boxes)
    # a line from the middle passes through the smaller boxes first
    parts = [_over(middle, ground, boxes.radius, k / PARTS) for k in range(PARTS, 0, -1)]
    for box in parts:
        found = _single_contacts(box, ground, region)
        normals = _normals(box.over, found.slopes)
        on_axle = _on_axle(box.moving, normals, graphs.radii[1][:, None])
        averages.append((_moved(box.moving, found.slopes) + on_axle) * (1 / PARTS))
        if region is None:
            region, slope = found.region, averages[0] * PARTS
            is_single &= _are_rings_clear(box, ground, found)
        is_single &= found.is_single
    gap = Intervals(middle.gap.low - found.lost, middle.gap.high.copy())
    on_map: Mask = np.logical_and.reduce(is_single)
    bounds = GapBounds(gap, slope, reduce(add, averages), on_map)
    for rest in chunks(~on_map, CHUNK):
        others = np.zeros_like(is_single)
        others[:, rest] = ~is_single[:, rest]
        own = _divided(parts, ground, others, SHARE if divided else QUICK_SHARE)
        on_map[rest] = own.on_map[rest]
        for old, new in zip(bounds[:3], own[:3], strict=True):
            old.low[..., others] = new.low[..., others]
            old.high[..., others] = new.high[..., others]
    return bounds


def chunks(lanes: Mask, size: int) -> Iterator[Indices]:
    """Return the numbers of lanes, in parts of at most a size."""
    found = np.flatnonzero(lanes)
    return (found[first : first + size] for first in range(0, found.size, size))


def _are_rings_clear(box: _PoseBox, ground: GroundRange, found: _SingleContacts) -> Mask:
    """Return which wheels touch nowhere outside the regions, shape (n_wheels, n).

    Only the rings that are not clear by curvature are divided into patches.
    """
    is_clear: Mask = np.logical_and.reduce(found.rings)
    wheels = found.is_single & ~is_clear
    patches = _whole_treads(box.middle.radii, wheels)
    here = patches.wheel, patches.lane
    near, far = _chord_range(box, patches)
    is_open = np.zeros(patches.lane.size, dtype=bool)
    for number, ring in enumerate(found.rings):
        inner, outer = (found.region[here] ** (1 - j / RINGS) for j in (number, number + 1))
        is_open |= ~ring[here] & (far >= inner) & (near <= outer)
    target = np.maximum(SHARE * box.turn.max(axis=0), SMALLEST_TURN)
    left, _, _, is_complete = _touching(box, ground, patches.at(is_open), target, found.region)
    is_clear |= wheels & is_complete
    is_clear[left.wheel, left.lane] = False
    return is_clear


def _chord_range(box: _PoseBox, patches: _Patches) -> tuple[Array, Array]:
    """Return bounds of halves of chords around the axle, from the reference point."""
    turn = patches.middle[0] - box.middle.angles[0, patches.wheel, patches.lane]
    away, half = np.abs(np.mod(turn + np.pi, 2 * np.pi) - np.pi), patches.half[0] + SLACK
    near, far = np.maximum(away - half, 0.0), np.minimum(away + half, np.pi)
    return np.sin(near / 2) - SLACK, np.sin(far / 2) + SLACK


def _divided(
    parts: Sequence[_PoseBox], ground: GroundRange, wheels: Mask, share: float
) -> GapBounds:
    """Return the bounds of some wheels (n_wheels, n) by dividing their whole treads.

    ``parts`` are the boxes, each inside the one before; patches have a ``share`` of the turns.
    """
    box, treads = parts[0], _whole_treads(parts[0].middle.radii, wheels)
    target = np.maximum(share * box.turn.max(axis=0), SMALLEST_TURN)
    patches, least, on_map, is_complete = _touching(box, ground, treads, target)
    slope = _hull(_slopes(box, ground, patches), patches, wheels.shape)
    mean, lost = slope * (1 / PARTS), np.where(is_complete, 0.0, np.nan)
    for box in parts[1:]:
        patches = patches.at(_examine(box, ground, patches).is_open)
        mean = mean + _hull(_slopes(box, ground, patches), patches, wheels.shape) * (1 / PARTS)
    below = _hull(_examine(box, ground, patches).gap[None], patches, wheels.shape).low[0]
    gap = Intervals(np.minimum(below, least) + lost, least + lost)
    return GapBounds(gap, slope, mean, on_map)


class _SingleContacts(NamedTuple):
    """Wheels that touch the ground at one smooth point of the tread at all poses of a box."""

    is_single: Mask  # in the region, shape (n_wheels, n); elsewhere other values are meaningless
    region: Array  # halves of the chords V of the regions
    rings: Mask  # whether there is no contact in the rings outside, shape (RINGS, n_wheels, n)
    slopes: Intervals  # of the ground at the contacts, shape (2, n_wheels, n)
    lost: Array  # largest height of the reference point above the contact at the middle [m]


class _Curvature(NamedTuple):
    """Bounds of the curvature of the ground under a ring of the tread [1/m]."""

    along: Array  # along chords of the circle, signed
    mixed: Array  # norm of the product of second derivatives and the direction of such a chord
    any: Array  # magnitude in all directions


def _single_contacts(box: _PoseBox, ground: GroundRange, region: Array | None) -> _SingleContacts:
    """Return which wheels have a single contact, and bounds of the slopes there.

    Without a region that is known to contain the contacts, the rings outside of one are examined.

    With the chords ``V = 2 s`` and ``A`` of the module, a point of the tread is displaced from the
    reference point by ``r2 V (c t - s e)`` and at most ``r1 A``, for the tangent ``t`` of the
    circle, the direction ``e`` from the axle, and ``c^2 + s^2 = 1``. Its distance from the ground
    is larger by at least ``x' M x / 2 - g' x`` for ``x = (V, A)``. The contact is excluded where
    this is positive, and remains in a region. There, the normals of ground and tread agree.
    With the angle ``v`` of the chord ``V``, their difference along the tangent at the contact is
    zero, ``|N0'| sin v <= r2 V (k + 0.6 V G) + r1 A (G + 0.6 V K) + g_v / r2``, since tangent and
    chord differ by an angle ``v / 2``; in all, ``A sqrt(|N0| |N|)`` is at most the change of the
    normal. These are rows of ``M x <= g``, and ``x <= M^-1 g``, since the inverse has no negative
    elements.
    """
    (tube, circle), shape = box.middle.radii[:, :, None], box.middle.gap.low.shape
    is_disc, is_sphere = tube == 0, circle == 0
    angles, jets = exactly(box.middle.angles), box.middle.jets
    (cos_v, cos_u), (sin_v, sin_u) = ((each[0], each[1]) for each in (angles.cos(), angles.sin()))
    level = _normals(box.middle.start, box.middle.flat)
    length = np.sqrt(
        np.where(is_disc, 0, level.low[0] ** 2) + level.low[1] ** 2 + level.low[2] ** 2
    )
    plane = length * sin_u.low  # component perpendicular to the axle

    def changes(normal: Intervals) -> Array:
        """Return the largest changes of a normal along the axle, t and e."""
        along = normal[2] * cos_v - normal[1] * sin_v
        away = normal[1] * cos_v + normal[2] * sin_v + sin_u * length
        found = stack([normal[0] + cos_u * length, along, away]).magnitude
        found[0] = np.where(is_disc, 0.0, found[0])  # discs have no extent along the axle
        return found * (1 + SLACK) + SLACK**2

    change = changes(_normals(box.over, box.slopes))
    spread, turned = (np.sqrt((each**2).sum(axis=0)) for each in (change, box.turn))
    axes = (box.middle.start.rotation.low + box.middle.start.rotation.high)[:2] / 2
    tangent = axes[:, 2] * cos_v.low - axes[:, 1] * sin_v.low
    away = axes[:, 1] * cos_v.low + axes[:, 2] * sin_v.low
    xx, xy, yy = jets.second.reshape(3, *shape)
    norm = (np.abs(xx + yy) + np.hypot(xx - yy, 2 * xy)) / 2
    bent, bent_away = (
        np.stack([xx * each[0] + xy * each[1], xy * each[0] + yy * each[1]])
        for each in (tangent, away)
    )
    along, mixed, across = (
        (a * b).sum(axis=0) for a, b in ((tangent, bent), (away, bent), (away, bent_away))
    )
    lean = np.hypot(*(axes[:, 0] * cos_u.low + away * sin_u.low))
    widest = tube * np.minimum(2.0, 1 + lean + turned)  # horizontal extent of the tube
    error, moved = jets.error[2].reshape(shape), box.shift + jets.inexact.reshape(shape)

    def curvature(inner: Array, outer: Array, wide: Array, share: float) -> _Curvature:
        """Return bounds for ``inner <= s <= outer``; ``share`` of the way to the point counts."""
        c, least = np.sqrt(1 - inner**2), np.sqrt(np.maximum(1 - outer**2, 0))
        x, y = direction = c * np.abs(tangent) + outer * np.abs(away) + turned
        chord = direction * (2 * circle * outer)
        reach = (moved + chord + wide) * (1 + SLACK)
        third = ground.third_bounds(jets, reach.reshape(2, -1)).reshape(4, *shape)
        dx, dy = moved + share * (chord + wide)
        e_xx, e_xy, e_yy = third[:3] * dx + third[1:] * dy + error
        more = np.maximum(e_xx, e_yy) + e_xy
        value = np.maximum(c**2 * along, least**2 * along) + 2 * outer * c * np.abs(mixed)
        value += outer**2 * np.maximum(across, 0) + turned * (2 + turned) * norm
        value += x**2 * e_xx + 2 * x * y * e_xy + y**2 * e_yy
        product = c * np.hypot(*bent) + outer * np.hypot(*bent_away) + more + turned * norm
        return _Curvature(value, product, norm + more)

    rings = np.ones((RINGS, *shape), dtype=bool)
    if region is None:
        region = change[1] / np.maximum(plane - circle * np.maximum(along, 0), 0.2)
        region = inner = np.clip(FACTOR * region, *REGION)
        for k in range(RINGS):  # the worst A is that of the minimum
            outer = region ** (1 - (k + 1) / RINGS)
            bound = curvature(inner, outer, widest, 1 / 3)
            stiff = length - tube * bound.any
            lift = circle * (plane - circle * bound.along)
            lift -= tube / stiff * (circle * bound.mixed) ** 2
            push = circle * (change[1] + outer * change[2])
            push += tube / stiff * spread * (circle * bound.mixed + spread / (4 * inner))
            is_lower = inner * lift > push * (1 + SLACK) + SLACK * circle
            rings[k] = (stiff > 0) & is_lower | is_sphere
            inner = outer

    def solve(
        bound: _Curvature, less: tuple[Array, Array], mixed: Array, change: Array
    ) -> tuple[Mask, Array, Array, Array]:
        """Return whether M is positive definite, M^-1 g, the diagonal of M^-1, and g' M^-1 g."""
        m_v = np.where(is_sphere, 1.0, circle * (plane - less[0] - circle * bound.along))
        m_a = np.where(is_disc, 1.0, tube * (length - less[1] - tube * bound.any))
        g_v = circle * (change[1] + region * change[2])
        g_a = tube * np.sqrt((change**2).sum(axis=0))
        cross = tube * circle * mixed
        det = m_v * m_a - cross**2
        good = (m_v > 1e-3 * circle) & (m_a > 1e-3 * tube) & (det > 1e-3 * m_v * m_a)
        x = np.stack([m_a * g_v + cross * g_a, m_v * g_a + cross * g_v]) / det * (1 + 1e-6)
        return good, x, np.stack([m_a, m_v]) / det, g_v * x[0] + g_a * x[1]

    none = np.zeros(shape)
    bound = curvature(none, region, widest, 1 / 3)
    lost = solve(bound, (none, none), bound.mixed, changes(level))[3] / 2
    is_clear, x, diagonal, product = solve(bound, (none, none), bound.mixed, change)
    v, a = (x + np.sqrt(diagonal * product)) * np.stack(np.broadcast_arrays(~is_sphere, ~is_disc))
    edge = np.minimum(box.middle.angles[1], np.pi - box.middle.angles[1])
    is_clear &= (v <= 2 * region) & ((2 * np.arcsin(np.minimum(a / 2, 1)) + EDGE < edge) | is_disc)
    for _ in range(2):
        bound = curvature(none, v / 2, tube * a, 1 / 2)
        other = spread + bound.any * (circle * v + tube * a)  # change of the normal
        is_clear &= (length * (1 - a**2 / 2) > other) & (plane * (1 - v**2 / 2) > other)
        less = v * (0.6 * circle * bound.mixed + plane * v / 4) + change[2], other
        good, (smaller, narrower), _, _ = solve(
            bound, less, bound.mixed + 0.6 * v * bound.any, change
        )
        is_clear &= good
        v, a = np.minimum(v, smaller), np.minimum(a, narrower)
    reach = (np.abs(tangent) + v * np.abs(away) + turned) * (circle * v) + tube * a + moved
    reach = (reach * (1 + SLACK)).reshape(2, -1)
    slopes = ground.slopes(jets, Intervals(-reach, reach))
    whole = box.shift.max(axis=0) + 2 * (circle + tube)
    is_clear &= ground.is_known(box.middle.place, whole.ravel())[1].reshape(shape)
    return _SingleContacts(is_clear, region, rings, _shaped(slopes, (2, *shape)), lost)


def _touching(
    box: _PoseBox,
    ground: GroundRange,
    patches: _Patches,
    target: Array,
    region: Array | None = None,
) -> tuple[_Patches, Array, Mask, Mask]:
    """Return patches of half-sizes ``target`` (n_wheels, n) that may touch the ground first.

    Also return upper bounds of the gaps at the middles of the boxes, shape (n_wheels, n), and
    whether the wheels stay on the map, and whether the patches are complete, shape (n,). Patches in
    a region are left out.
    """
    n, done = box.middle.gap.low.shape[1], [patches.at(slice(0))]
    on_map, given_up = np.ones(n, dtype=bool), np.zeros(n, dtype=bool)
    least = box.middle.gap.high.copy()
    while patches.lane.size:
        if region is not None:
            outside = _chord_range(box, patches)[1] > region[patches.wheel, patches.lane]
            patches = patches.at(outside)
        found = _examine(box, ground, patches)
        np.minimum.at(least, (patches.wheel, patches.lane), found.above)
        sizes = _sizes(box.middle.radii, patches)
        small = sizes.max(axis=0) <= target[patches.wheel, patches.lane]
        on_map[patches.lane[~found.is_middle_known | (small & ~found.is_known)]] = False
        given_up |= np.bincount(patches.lane, minlength=n) > MAX_PATCHES
        keep = found.is_open & (on_map & ~given_up)[patches.lane]
        done.append(patches.at(keep & small))
        keep &= ~small
        patches = _halves(patches.at(keep), sizes[:, keep])
    return _joined(done), least, on_map, on_map & ~given_up


def contact_regions(
    graphs: PoseGraphs, ground: GroundRange, boxes: Boxes, error: float
) -> tuple[Intervals, Mask]:
    """Return bounds of the points of treads at most ``error`` above the map, (3, n_wheels, n) [m].

    A wheel that touches a ground of the band without penetrating it touches it there. Positions
    are local, turned about the vertical by the negative heading of the middles, so that the bounds
    follow the wheels. Also return whether the map is known there, shape (n,).
    """
    n = boxes.middle.shape[1]
    box = _over(_middle(graphs, ground, boxes), ground, boxes.radius, 1.0)
    # compared with the region, whose size is that of a parabola of this height
    smallest = np.maximum(REGION_TURN, REGION_SHARE * np.sqrt(error / graphs.radii.sum(axis=0)))
    patches = _whole_treads(graphs.radii, np.ones(boxes.contacts.shape[1:], dtype=bool))
    done = list[_Patches]()
    while patches.lane.size:
        here = patches.wheel, patches.lane
        radii, wide = graphs.radii[:, patches.wheel], _at(box.over, here)
        spot, turned, rolled = _tread(radii, around(patches.middle, patches.half))
        place = _placed(wide, _tread(radii, exactly(patches.middle))[0])
        center, away = _flat(place)
        jets = ground.jets(center)
        normal = _normals(wide, ground.slopes(jets, _placed(wide, spot)[:2] - center))
        spread = _dot(normal, turned).magnitude * patches.half[0]
        spread += _dot(normal, rolled).magnitude * patches.half[1]
        gap = place[2] - ground.heights(jets, away.magnitude)
        patches = patches.at(~(gap.low - error > spread * (1 + SLACK)))
        sizes = _sizes(graphs.radii, patches)
        small = sizes.max(axis=0) <= smallest[patches.wheel]
        done.append(patches.at(small))
        patches = _halves(patches.at(~small), sizes[:, ~small])
    patches = _joined(done)
    here = patches.wheel, patches.lane
    spot = _tread(graphs.radii[:, patches.wheel], around(patches.middle, patches.half))[0]
    place, known = _placed(_at(box.over, here), spot), np.ones(n, dtype=bool)
    center, away = _flat(place)
    known[patches.lane[~ground.is_known(center, away.magnitude.max(axis=0))[1]]] = False
    heading = boxes.middle[graphs.names.index("heading"), patches.lane]
    return _hull(levelled(place, heading), patches, boxes.contacts.shape[1:]), known


def levelled(place: Intervals, heading: Array) -> Intervals:
    """Return positions (3, ...) turned about the vertical by a negative heading."""
    (x, y, z), angle = place, exactly(heading)
    cos, sin = angle.cos(), angle.sin()
    return stack([x * cos + y * sin, y * cos - x * sin, z])


def _hull(values: Intervals, patches: _Patches, shape: tuple[int, int]) -> Intervals:
    """Return the hulls of intervals (n_rows, n) of patches, by wheels and lanes.

    The result has the shape (n_rows, n_wheels, n_lanes); wheels without patches have no bounds.
    """
    wheels, n = shape
    rows = values.low.shape[0]
    hulls = np.full((2, rows, wheels * n), np.nan)
    order = np.lexsort((patches.lane, patches.wheel))
    key = patches.wheel[order] * n + patches.lane[order]
    found, first = np.unique(key, return_index=True)
    if found.size:
        hulls[0][:, found] = np.minimum.reduceat(values.low[:, order], first, axis=1)
        hulls[1][:, found] = np.maximum.reduceat(values.high[:, order], first, axis=1)
    return Intervals(*hulls.reshape(2, rows, wheels, n))


def _middle(graphs: PoseGraphs, ground: GroundRange, boxes: Boxes) -> _Middle:
    """Return wheel motions and gaps of their lowest points on the ground, for boxes of poses."""
    jets = ground.jets(boxes.contacts.reshape(2, -1))
    slope = jets.slope.reshape(boxes.contacts.shape)
    motion = carrier_motions(graphs, boxes, slope)
    start = motion.start
    # any angles are valid for the reference points, so that rounding has no effect
    axes = start.rotation.low
    down = slope[0] * axes[0] + slope[1] * axes[1] - axes[2]
    across = np.arctan2(np.hypot(down[1], down[2]), down[0])
    across = np.where(graphs.radii[0, :, None] > 0, across, np.pi / 2)
    angles = np.nan_to_num(np.stack([np.arctan2(down[2], down[1]), across]))
    spot = _tread(graphs.radii[:, :, None], exactly(angles))[0]
    place = _placed(start, spot)
    center, away = _flat(place)
    jets = ground.jets(center)
    height, flat = ground.heights(jets, away.magnitude), ground.slopes(jets, away)
    gap = place[2] - _shaped(height, slope[0].shape)
    flat = _shaped(flat, slope.shape)
    return _Middle(graphs.radii, motion, start, spot, angles, center, jets, gap, flat)


def _over(middle: _Middle, ground: GroundRange, radius: Array, share: float) -> _PoseBox:
    """Return the enclosures over boxes of a share of the size of the given ones."""
    (start, base, bends, tilt), grown = middle.motion, share * (1 + SLACK)
    # integrals of the slopes along lines from the middle
    size = np.einsum("acwn,an->cwn", base.magnitude + share / 2 * bends, radius) * grown
    rise = size[2] + np.abs(tilt[0]) * size[0] + np.abs(tilt[1]) * size[1]
    reach = np.stack([size[0], size[1], rise]) * (1 + SLACK)
    over = WheelPoses(
        start.center + Intervals(-reach, reach), _turned_by(start.rotation, size[3:, None])
    )
    slopes = base + Intervals(-share * bends, share * bends)
    x, y, z = (slopes[:, j] for j in range(3, 6))
    spins = reduce(add, (over.rotation[j] * spin[:, None] for j, spin in enumerate((x, y, z))))
    about_x, about_y, about_z = (spins[:, j] for j in range(3))
    moving = PoseSlopes(slopes[:, :3], stack([-about_z, about_y, -about_x], axis=1), tilt)
    turn = np.einsum("acwn,an->cwn", moving.turning.magnitude, radius) * grown
    arm = reduce(add, (over.rotation[:, j] * middle.spot[j] for j in range(3)))
    moved = slopes[:, 0] + y * arm[2] - z * arm[1], slopes[:, 1] + z * arm[0] - x * arm[2]
    shift = np.einsum("cawn,an->cwn", stack(moved).magnitude, radius) * grown
    under = _ground_slopes(ground, _placed(over, middle.spot))
    return _PoseBox(middle, over, moving, under, turn, shift)


def _whole_treads(radii: Array, wheels: Mask) -> _Patches:
    """Return patches that cover the treads of some wheels, shape (n_wheels, n)."""
    parts = list[_Patches]()
    for wheel, tube in enumerate(radii[0]):
        lanes = np.flatnonzero(wheels[wheel])
        counts = np.array([AROUND, ACROSS if tube > 0 else 1])
        v, u = ((2 * np.arange(count) + 1) * np.pi / 2 / count for count in counts)
        grid = np.stack(np.meshgrid(2 * v, u, indexing="ij")).reshape(2, -1)
        # the halves are slightly larger, so that patches overlap
        half = np.array([[np.pi], [np.pi / 2]]) / counts[:, None] * (1 + 1e-9)
        half[1] *= tube > 0
        grid, lanes = np.tile(grid, lanes.size), np.repeat(lanes, counts.prod())
        parts.append(_Patches(lanes, np.full(lanes.size, wheel), grid, np.tile(half, lanes.size)))
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
    return point, turned, stack([-away, axial * cos_v, axial * sin_v])


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
    return _shaped(ground.slopes(ground.jets(center), away), (2, *place.low.shape[1:]))


def _shaped(values: Intervals, shape: tuple[int, ...]) -> Intervals:
    return Intervals(values.low.reshape(shape), values.high.reshape(shape))


def _normals(poses: WheelPoses, slopes: Intervals) -> Intervals:
    """Return the upward normals of the ground in the frames of carriers, shape (3, ...)."""
    return poses.rotation[2] - poses.rotation[0] * slopes[0] - poses.rotation[1] * slopes[1]


def _examine(box: _PoseBox, ground: GroundRange, patches: _Patches) -> _Examined:
    """Return which patches may touch the ground first at a pose of their boxes."""
    function = getattr(library(), "kernel_patches", None)  # older libraries have none
    if function is not None:
        return _examine_compiled(function, box, ground, patches)
    here = patches.wheel, patches.lane
    radii = box.middle.radii[:, patches.wheel]
    thin, wide = _at(box.middle.start, here), _at(box.over, here)
    middle = _placed(thin, _tread(radii, exactly(patches.middle))[0])
    spot, turned, rolled = _tread(radii, around(patches.middle, patches.half))
    place = _placed(wide, spot)

    center, near = _flat(middle)
    jets, away = ground.jets(center), place[:2] - center
    height, slopes = ground.heights(jets, near.magnitude), ground.slopes(jets, away)
    points, squares = ground.is_known(center, away.magnitude.max(axis=0))
    normal = _normals(wide, slopes)

    around_slope = _dot(normal, turned)
    across_slope = _dot(normal, rolled)
    spread = around_slope.magnitude * patches.half[0] + across_slope.magnitude * patches.half[1]
    spread *= 1 + 1e-12
    point = middle[2] - height
    gap = point + Intervals(-spread, spread)

    apart = (spot - box.middle.spot[:, *here]).magnitude
    xy, xz, yz = box.turn[:, *here]
    change = normal[0].magnitude * (xy * apart[1] + xz * apart[2])
    change += normal[1].magnitude * (xy * apart[0] + yz * apart[2])
    change += normal[2].magnitude * (xz * apart[0] + yz * apart[1])
    change += ((slopes - box.slopes[:, *here]).magnitude * box.shift[:, *here]).sum(axis=0)
    limit = box.middle.gap.high[here] + change
    higher = gap.low > limit + 1e-12 * (np.abs(limit) + change)
    inside = _is_inside(patches)
    changes = ~around_slope.contains_zero | (~across_slope.contains_zero & inside)
    return _Examined(gap, point.high, ~squares | ~(higher | changes), points, squares)


def _examine_compiled(
    function: Callable[..., int], box: _PoseBox, ground: GroundRange, patches: _Patches
) -> _Examined:
    """Return the results of `_examine`, by the function of `terrain/kernel.c`."""
    shape, n = box.middle.gap.low.shape, patches.lane.size
    parts = *box.middle.start, *box.over, box.middle.spot, box.slopes
    bounds = [getattr(part, end) for end in ("low", "high") for part in parts]
    bounds += [box.turn, box.shift, box.middle.gap.high]
    bounds = [np.ascontiguousarray(each) for each in bounds]
    gaps, flags = np.empty((3, n)), np.empty(n, dtype=np.uint8)
    inputs = box.middle.radii, patches.lane, patches.wheel, patches.middle, patches.half
    radii, *places = (pointer(np.ascontiguousarray(each)) for each in inputs)
    sizes = [ctypes.c_longlong(each) for each in (*shape, n)]
    rows = (ctypes.c_void_p * len(bounds))(*(each.ctypes.data for each in bounds))
    missed = 1
    while missed:  # once more with windows that are large enough
        missed = function(
            *ground.compiled(missed), *sizes, rows, radii, *places, pointer(gaps), pointer(flags)
        )
    known = flags & 2 > 0, flags & 4 > 0
    return _Examined(Intervals(*gaps[:2]), gaps[2], flags & 1 > 0, *known)


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
    tube, circle = radii = box.middle.radii[:, patches.wheel]
    angles = around(patches.middle, patches.half)
    spot = _tread(radii, angles)[0]
    slopes = _ground_slopes(ground, _placed(wide, spot))
    normal, moving = _normals(wide, slopes), box.moving.at(here)
    below = (angles[0].cos() * normal[1] + angles[0].sin() * normal[2]).high < 0
    is_smooth = below & (_is_inside(patches) | (tube == 0))
    xy, xz, yz = (moving.turning[:, j] for j in range(3))
    anywhere = normal[0] * (xy * spot[1] + xz * spot[2]) + normal[1] * (yz * spot[2] - xy * spot[0])
    anywhere = anywhere - normal[2] * (xz * spot[0] + yz * spot[1])
    on_axle = _on_axle(moving, normal, circle)
    low = np.where(is_smooth, on_axle.low, anywhere.low)
    high = np.where(is_smooth, on_axle.high, anywhere.high)
    return _moved(moving, slopes) + Intervals(low, high)


def _on_axle(moving: PoseSlopes, normal: Intervals, circle: Array) -> Intervals:
    """Return the terms of turns at the lowest point of the tread for a normal of the ground."""
    axial = normal[0] * (normal[1].square() + normal[2].square()).sqrt().inverse() * -circle
    return (moving.turning[:, 0] * normal[1] + moving.turning[:, 1] * normal[2]) * axial


def _moved(moving: PoseSlopes, slopes: Intervals) -> Intervals:
    """Return the terms of displacements of the centre."""
    x, y, rise = (moving.center[:, j] for j in range(3))
    steeper = slopes - moving.tilt
    return rise - x * steeper[0] - y * steeper[1]


def _at(poses: WheelPoses, here: tuple[Indices, Indices]) -> WheelPoses:
    return WheelPoses(poses.center[:, *here], poses.rotation[:, :, *here])


def _is_inside(patches: _Patches) -> Mask:
    """Return whether patches do not touch the edges of the tread."""
    u, half = patches.middle[1], patches.half[1]
    return np.asarray((u - half > EDGE) & (u + half < np.pi - EDGE))


def _dot(a: Sequence[Intervals] | Intervals, b: Sequence[Intervals] | Intervals) -> Intervals:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
