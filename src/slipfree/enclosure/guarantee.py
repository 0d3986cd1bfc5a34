"""Guarantees for the rest poses of a vehicle on every ground within a distance of the map.

A ground is in the band if it is a continuous surface whose heights differ from those of the map by
at most ``e``. Then the gap ``g_i`` of each wheel, the smallest height of its tread above the
ground, differs by at most ``e`` from that on the map, for every pose. Let ``X`` be a box of poses
and ``[A]`` bounds of the generalised derivatives of the gaps on the map over ``X``. Krawczyk's
operator is ``q - Y (g(q) - t)`` for an approximate inverse ``Y`` of ``[A]`` and gaps ``t``. If it
maps ``X`` into its interior for every ``|t_i| <= e``, there is a pose ``q(t)`` in ``X`` with these
gaps; if also the spectral radius of the bounds of ``|1 - Y [A]|`` is below one, it is the only one,
and depends continuously on ``t``. For a ground ``h`` of the band, the map
``t -> t - g(q(t); h)`` therefore maps the cube of the ``t`` into itself, and by Brouwer's theorem
has a fixed point: a pose in ``X`` at which all wheels touch ``h`` and none penetrates it. Every
other such pose in ``X`` has gaps in the cube, too, and lies in the same enclosure.

References: Krawczyk, Computing 4 (1969) 187; Neumaier, Interval Methods for Systems of Equations
(1990), sections 5.1 and 5.2; Lebourg's mean value theorem: Clarke, Optimization and Nonsmooth
Analysis (1983), section 2.3.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import permutations, product
from typing import Annotated, Any, NamedTuple

import numpy as np

from slipfree.contact.nearest_points import CLEARANCE
from slipfree.core.arguments import checked
from slipfree.core.dae import Dae
from slipfree.core.errors import check_known
from slipfree.core.interval import TINY, Intervals, around, evaluate_interval, exactly, stack
from slipfree.core.records import Array, Indices, Mask, leaves
from slipfree.core.schema import NonNegative
from slipfree.core.trajectory import Trajectory
from slipfree.enclosure.ground_range import GroundRange, range_of
from slipfree.enclosure.wheel_gaps import (
    SLACK,
    Boxes,
    GapBounds,
    PoseGraphs,
    chunks,
    contact_regions,
    gap_bounds,
    levelled,
    pose_graphs,
    tangents,
)
from slipfree.vehicle.shapes import bounding_box

QUICK_TRIES = 2  # boxes that are tried first, without patches where a wheel has a single contact
TRIES = 8  # boxes that are tried then, each larger than the one before
INFLATION = 1.1  # of the next box, relative to the bounds found
FIRST_INFLATION = 1.05  # of the first box, relative to the bounds to first order
SMALLEST_RADIUS = 1e-8  # of a box [m, rad]
LARGEST_TURN = 0.5  # largest half-size of a box of angles that is tried [rad]
PENETRATION = 1e-6  # of a wheel of the nominal pose that refutes it [m]
MAX_CONDITION = 1e12  # of the derivatives of the gaps
POWER_STEPS = 4  # towards the weights with which uniqueness is tested
LANES = 2048  # poses that are enclosed together
TIP_OVER = "tip_over_margin"
MARGIN_LANES = 64  # boxes that are bounded together
RINGS = 4  # about a point, in each of which the slope of the ground is bounded
HALVINGS = 8  # of the faces of the boxes about bodies


class Verdict(StrEnum):
    """Verdict on a pose."""

    GUARANTEED = "guaranteed"
    UNDECIDED = "undecided"
    REFUTED = "refuted"


REASONS = {
    Verdict.GUARANTEED: "",
    Verdict.UNDECIDED: "no box around the pose was found that surely contains a pose for every "
    "ground; other grounds within the error may have none, or several",
    Verdict.REFUTED: "on the map itself, a wheel penetrates the ground",
}
OFF_MAP = "a wheel may stand beside the map or over a hole, where no height is known"


@dataclass(frozen=True, eq=False)
class Guarantee:
    """Bounds of the poses of a vehicle at n samples, for every ground within an error of the map.

    Attributes
    ----------
    error : float
        Largest difference of heights between a ground and the map. [m]
    low, high : mapping of str to ndarray, shape (n,)
        Bounds of the coordinates that the ground determines: ``z``, ``roll``, ``pitch`` and those
        of the suspension; lower bounds of ``tip_over_margin`` for a vehicle with a mass, and of
        ``clearance_body`` for bodies with shapes; NaN without a guarantee. [m, rad]
    verdicts : tuple of Verdict
        ``"guaranteed"``, ``"undecided"`` or ``"refuted"``.
    reasons : tuple of str
        Reasons of verdicts other than ``"guaranteed"``.
    """

    error: float
    low: Mapping[str, Array]
    high: Mapping[str, Array]
    verdicts: tuple[Verdict, ...]
    reasons: tuple[str, ...]

    @property
    def is_guaranteed(self) -> Mask:
        """Whether each pose is guaranteed, shape (n,)."""
        return np.array([each is Verdict.GUARANTEED for each in self.verdicts], dtype=bool)


class PoseEnclosures(NamedTuple):
    """Enclosures of n poses in local coordinates, of shape (n_wheels, n)."""

    low: Array
    high: Array
    is_enclosed: Mask  # shape (n,); elsewhere the bounds are not numbers
    on_map: Mask
    penetrates: Mask  # whether a wheel surely penetrates the map at the nominal pose
    boxes: Boxes  # curved boxes that contain the poses, where they are enclosed


@checked
def guarantee(
    model: Dae,
    run: Trajectory,
    error: NonNegative,
    *,
    spread: Mapping[str, Annotated[float, NonNegative]] | None = None,
) -> Guarantee:
    """Return bounds of rest poses that hold for every ground within an error of the map.

    The ground may be any continuous surface whose heights differ from those of the map by at most
    ``error``, with edges and stones. If a pose is guaranteed, every such ground has a rest pose
    within the bounds, for every start within the spread: all wheels touch the ground and none
    penetrates it. The computation is rigorous: rounding errors are included.

    Parameters
    ----------
    model : Dae
        Kinematics or quasi-statics of a vehicle whose wheels can all touch a rigid ground, on a
        map.
    run : Trajectory
        Poses of this model, such as the result of `settle`; every sample is one.
    error : float
        Largest difference of heights. [m]
    spread : mapping of str to float, optional
        Largest differences of given coordinates, such as ``x``, ``y``, ``heading`` and joints, from
        those of the samples; zero by default. [m, rad]

    Returns
    -------
    Guarantee
        Bounds and verdicts of all samples.

    Raises
    ------
    ModelError
        If the model has no exact contact, the ground is not a map, or a name is unknown.

    Notes
    -----
    There may be other rest poses far from the nominal one. Only treads touch the ground: that
    bodies do not, that joints do not reach their stops, and that the vehicle does not tip over
    follows from the bounds only. Friction is not included.

    Examples
    --------
    >>> import numpy as np
    >>> from slipfree import Bicubic, Grid, catalog, direct_kinematics, guarantee, settle
    >>> axis = np.linspace(-5.0, 5.0, 51)
    >>> ground = Bicubic(Grid(axis, axis, 0.1 * np.sin(axis)[:, None] * np.cos(axis)))
    >>> model = direct_kinematics(catalog.three_wheeler(), ground)
    >>> found = guarantee(model, settle(model, x=1.0, heading=0.3), 0.01)
    >>> low, high = np.rad2deg([found.low["roll"][0], found.high["roll"][0]])
    >>> print(f"{found.verdicts[0]}: roll from {low:.1f} to {high:.1f} degrees")
    guaranteed: roll from 2.3 to 3.5 degrees
    """
    graphs = pose_graphs(model)
    count = len(graphs.radii[0])
    closed = graphs.names[graphs.given :]
    given = graphs.names[: graphs.given]
    check_known("spread", spread or {}, given)
    samples = range(run.t.size)
    x = np.stack([model.rows("x", run, k) for k in samples], axis=1)
    z = np.stack([model.rows("z", run, k) for k in samples], axis=1)
    contacts = contact_points(model, z)
    radius = np.array([(spread or {}).get(name, 0.0) for name in given])
    found = enclose_poses(model, x, z[:count], contacts, error, radius)
    bounds = Intervals(found.low, found.high) + graphs.shift[graphs.given :, None]
    verdicts = [
        Verdict.REFUTED if bad else Verdict.GUARANTEED if good else Verdict.UNDECIDED
        for good, bad in zip(found.is_enclosed, found.penetrates, strict=True)
    ]
    reasons = [
        OFF_MAP if verdict is Verdict.UNDECIDED and not inside else REASONS[verdict]
        for verdict, inside in zip(verdicts, found.on_map, strict=True)
    ]
    low, high = (dict(zip(closed, each, strict=True)) for each in (bounds.low, bounds.high))
    kept = np.flatnonzero(found.is_enclosed)
    ground: Any = model.ground
    moving = pose_graphs(model, tuple((radius > 0).tolist()))
    margins = lower_margins(model, moving, range_of(ground), found.boxes.at(kept), error)
    for name, values in margins.items():
        low[name], high[name] = np.full((2, run.t.size), np.nan)
        low[name][kept], high[name][kept] = values, np.inf
    return Guarantee(error, low, high, tuple(verdicts), tuple(reasons))


def contact_points(model: Dae, z: Array) -> Array:
    """Return local contact points of unknowns (n_z, n), shape (2, n_wheels, n) [m]."""
    labels: Any = model.labels.z[0]
    wheels = len(labels.contacts)
    start = len(list(leaves(labels))) - 2 * wheels
    return z[start : start + 2 * wheels].reshape(wheels, 2, -1).swapaxes(0, 1)


def enclose_poses(
    model: Dae, x: Array, q: Array, contacts: Array, error: float, spread: Array
) -> PoseEnclosures:
    """Return enclosures of the poses of a model in a band.

    Parameters
    ----------
    model : Dae
        The model.
    x : ndarray, shape (n_x, n)
        Local states. [m, rad]
    q : ndarray, shape (n_wheels, n)
        Local height, roll, pitch and suspension at rest on the map. [m, rad]
    contacts : ndarray, shape (2, n_wheels, n)
        Local contact points. [m]
    error : float
        Largest difference of heights. [m]
    spread : ndarray, shape (n_x,)
        Half-sizes of the boxes of the states. [m, rad]
    """
    surface: Any = model.ground
    graphs, ground = pose_graphs(model, tuple((spread > 0).tolist())), range_of(surface)
    middle = np.concatenate([x, q])
    count, n = q.shape
    given = graphs.moving.size - count
    start = np.broadcast_to(spread[graphs.moving[:given], None], (given, n))
    low, high = np.full((2, count, n), np.nan)
    is_enclosed, penetrates, refined = np.zeros((3, n), dtype=bool)
    on_map, able = np.ones(n, dtype=bool), np.isfinite(middle).all(axis=0)

    def boxes(lanes: Indices) -> Boxes:
        sizes = np.concatenate([start[:, lanes], radius[:, lanes]])
        return Boxes(
            middle[:, lanes], frame[..., lanes], curve[..., lanes], sizes, contacts[..., lanes]
        )

    def fits(lanes: Indices) -> Mask:
        """Return whether no angle varies too much for a box to be tried."""
        return np.asarray((boxes(lanes).reach[given + 1 :] < LARGEST_TURN).all(axis=0))

    with np.errstate(all="ignore"):
        gap, slope, bend = tangents(graphs, ground, middle, contacts)
        frame, curve = wheel_frames(slope, bend, given)
        radius = FIRST_INFLATION * (error + np.abs(gap)) + SMALLEST_RADIUS
        tried = able & fits(np.arange(n))
        for k in range(QUICK_TRIES + TRIES):
            if k == QUICK_TRIES:  # once more, with first boxes that know all contacts
                tried = able & ~is_enclosed & ~penetrates
                for lanes in chunks(tried, LANES):
                    frame[..., lanes], curve[..., lanes] = np.eye(len(frame))[..., None], 0.0
                    radius[:, lanes] = 10 * SMALLEST_RADIUS
                    box = boxes(lanes)
                    box.radius[:given] = 0.0
                    gaps = gap_bounds(graphs, ground, box)
                    penetrates[lanes] = (gaps.gap.high < -PENETRATION).any(axis=0)
                    on_map[lanes] &= gaps.on_map
                    slope = (gaps.slope.low + gaps.slope.high) / 2
                    own = wheel_frames(slope, bend[..., lanes], given)
                    frame[..., lanes], curve[..., lanes] = own
                    radius[:, lanes] = FIRST_INFLATION * (error + gaps.gap.magnitude)
                    radius[:, lanes] += SMALLEST_RADIUS
                    tried[lanes] = fits(lanes) & ~penetrates[lanes]
            for lanes in chunks(tried, LANES):
                box = boxes(lanes)
                gaps = gap_bounds(graphs, ground, box, divided=k >= QUICK_TRIES)
                penetrates[lanes] |= (gaps.gap.high < -PENETRATION).any(axis=0)
                found, is_unique = _krawczyk(gaps, box.radius, given, error)
                size = found.magnitude
                inside = is_unique & (size < radius[:, lanes]).all(axis=0)
                low[:, lanes[inside]] = found.low[:, inside]
                high[:, lanes[inside]] = found.high[:, inside]
                is_enclosed[lanes] = inside
                on_map[lanes] &= gaps.on_map
                radius[:, lanes] = np.where(inside, size, INFLATION * size + SMALLEST_RADIUS)
                tried[lanes] = fits(lanes) & ~inside & ~penetrates[lanes]
                refined[lanes] = inside & (k > 0)
        for lanes in chunks(refined, LANES):  # once more in the smaller box that was found
            box = boxes(lanes)
            gaps = gap_bounds(graphs, ground, box._replace(radius=box.radius * (1 + 1e-12)))
            found, _ = _krawczyk(gaps, box.radius, given, error)
            low[:, lanes] = np.fmax(low[:, lanes], found.low)
            high[:, lanes] = np.fmin(high[:, lanes], found.high)
        ends = (np.concatenate([each, found]) for each, found in ((-start, low), (start, high)))
        found, whole = Intervals(*ends), boxes(np.arange(n))
        bounds = exactly(q) + whole.image(found)[given:]
    is_enclosed &= ~penetrates
    whole = whole._replace(radius=found.magnitude)
    return PoseEnclosures(bounds.low, bounds.high, is_enclosed, on_map, penetrates, whole)


def wheel_frames(slope: Array, bend: Array, given: int) -> tuple[Array, Array]:
    """Return frames and curves whose last coordinates change the gap of one wheel each.

    The first columns, of given coordinates, change none; derivatives as those of `tangents`.
    """
    slope = np.nan_to_num(slope, posinf=0.0, neginf=0.0)
    matrices = slope[given:].transpose(2, 1, 0)
    regular = np.linalg.cond(matrices) < MAX_CONDITION
    matrices = np.where(regular[:, None, None], matrices, np.eye(matrices.shape[1]))
    inverse = np.where(regular, np.linalg.inv(matrices).transpose(1, 2, 0), np.nan)
    frame = np.zeros((slope.shape[0], *slope.shape[0::2]))
    frame[range(given), range(given)] = 1.0
    frame[given:, given:] = inverse
    frame[given:, :given] = -np.einsum("ijn,kjn->ikn", inverse, slope[:given])
    bend = np.einsum("iwn,jkwn->ijkn", -inverse, bend)
    curve = np.zeros((frame.shape[0], *frame.shape))
    curve[given:] = np.einsum("ijkn,jan,kbn->iabn", bend, frame, frame, optimize=True)
    return frame, np.nan_to_num((curve + curve.swapaxes(1, 2)) / 2)


def _krawczyk(gaps: GapBounds, radius: Array, given: int, error: float) -> tuple[Intervals, Mask]:
    """Return enclosures of the images of Krawczyk's operator, minus the middles, (n_wheels, n).

    Also return whether a box has at most one pose for given gaps of the wheels, shape (n,).
    """
    n_y, count, n = gaps.slope.low.shape
    middle = (gaps.mean_slope.low[given:] + gaps.mean_slope.high[given:]) / 2
    matrices = np.nan_to_num(middle.transpose(2, 1, 0), nan=0.0, posinf=0.0, neginf=0.0)
    regular = np.linalg.cond(matrices) < MAX_CONDITION
    matrices[~regular] = np.eye(count)
    inverse = np.where(regular, np.linalg.inv(matrices).transpose(1, 2, 0), np.nan)
    images, contraction = list[Intervals](), np.empty((count, count, n))
    for i in range(count):
        unit = np.zeros((n_y, 1))
        unit[given + i] = -1.0
        offset, (mean, whole) = exactly(np.zeros(n)), (exactly(unit + np.zeros(n)),) * 2
        for j in range(count):
            offset -= gaps.gap[j] * inverse[i, j]
            mean += gaps.mean_slope[:, j] * inverse[i, j]
            whole += gaps.slope[:, j] * inverse[i, j]
        away = (mean.magnitude * radius).sum(axis=0) + np.abs(inverse[i]).sum(axis=0) * error
        images.append(offset + around(np.zeros(n), away * (1 + 1e-12)))
        contraction[i] = whole[given:].magnitude
    weights = radius[given:] + TINY
    for _ in range(POWER_STEPS):  # any positive weights are valid; these are near the best ones
        weights = np.einsum("ijn,jn->in", contraction, weights)
        weights = weights / weights.max(axis=0) + 1e-3
    growth = np.einsum("ijn,jn->in", contraction, weights) / weights
    return stack(images), (growth < 1 - 1e-9).all(axis=0)


@np.errstate(all="ignore")  # bounds that are not numbers prove nothing
def lower_margins(
    model: Dae, graphs: PoseGraphs, ground: GroundRange, boxes: Boxes, error: float
) -> dict[str, Array]:
    """Return lower bounds over boxes of poses on grounds within an error of the map, shape (n,).

    The names are `TIP_OVER` [rad], if the vehicle has a mass, and `CLEARANCE` [m], if its bodies
    have shapes. The tip-over margin is minus infinity where it may be negative, and both are where
    the ground is not known.
    """
    vehicle, n = model.vehicle, boxes.middle.shape[1]
    names = {TIP_OVER: vehicle.mass > 0 and not vehicle.planar, CLEARANCE.name: vehicle.shapes}
    found = {name: np.empty(n) for name, applies in names.items() if applies}
    for first in range(0, n, MARGIN_LANES):
        lanes = np.arange(first, min(first + MARGIN_LANES, n))
        some = boxes.at(lanes)
        middle, slopes = body_motions(graphs, some)
        if TIP_OVER in found:
            center = middle[:3]
            reach = np.einsum("akn,an->kn", slopes[:, :3].magnitude, some.radius) * (1 + SLACK)
            center = center + Intervals(-reach, reach)
            found[TIP_OVER][lanes] = tip_over_bound(graphs, ground, some, center, error)
        if CLEARANCE.name in found:
            least = np.full(lanes.size, np.inf)
            for k, (_, shape) in enumerate(vehicle.shapes):
                rows = slice(3 + 12 * k, 15 + 12 * k)
                half = bounding_box(shape)[1]
                own = clearance_bound(
                    ground, middle[rows], slopes[:, rows], some.radius, half, error
                )
                least = np.minimum(least, own - shape.radius * (1 + SLACK))
            found[CLEARANCE.name][lanes] = least
    return found


def body_motions(graphs: PoseGraphs, boxes: Boxes) -> tuple[Intervals, Intervals]:
    """Return centre of mass and frames of shapes at the middles (m, n), and slopes (n_a, m, n).

    The slopes are the derivatives along the frames of the boxes, at all poses of the boxes.
    """
    reach = np.zeros_like(boxes.middle)
    reach[graphs.moving] = boxes.reach
    middle = evaluate_interval(graphs.bodies, exactly(boxes.middle))
    found = evaluate_interval(graphs.body_slopes, around(boxes.middle, reach))
    shape = (len(graphs.moving), *middle.low.shape)
    rates = Intervals(found.low.reshape(shape), found.high.reshape(shape))
    frame = around(boxes.frame, boxes.bend)
    total = exactly(np.zeros(shape))
    for k, rate in enumerate(rates):
        total += rate[None] * frame[k][:, None]
    return middle, total


def tip_over_bound(
    graphs: PoseGraphs, ground: GroundRange, boxes: Boxes, center: Intervals, error: float
) -> Array:
    """Return lower bounds of the tip-over margin, shape (n,) [rad].

    Two points are a side of the support polygon only if no other one is surely on its right. The
    sine of the angle between gravity and the plane through the centre of mass and a side is the
    vertical component of the unit normal.
    """
    points, is_known = contact_regions(graphs, ground, boxes, error)
    place = levelled(center, boxes.middle[graphs.names.index("heading")])
    arms = [points[:, wheel] - place for wheel in range(points.low.shape[1])]
    least = np.full(is_known.size, np.pi / 2)
    for i, j in permutations(range(len(arms)), 2):
        others = [k for k in range(len(arms)) if k not in (i, j)]
        side = points[:2, j] - points[:2, i]
        to_others = (points[:2, k] - points[:2, i] for k in others)
        turns = (side[0] * other[1] - side[1] * other[0] for other in to_others)
        may_be_side = np.logical_and.reduce([~(turn.high < 0) for turn in turns])
        (x, y, z), (u, v, w) = arms[i], arms[j]
        up, across = u * y - v * x, ((v * z - w * y).square() + (w * x - u * z).square()).sqrt()
        inside = -up
        angle = np.arctan(inside.low / across.high) * (1 - SLACK)
        angle = np.where(inside.low > 0, angle, -np.inf)
        least = np.where(may_be_side, np.fmin(least, angle), least)
    return np.where(is_known, least, -np.inf)


def clearance_bound(
    ground: GroundRange,
    pose: Intervals,
    slopes: Intervals,
    radius: Array,
    half: Array,
    error: float,
) -> Array:
    """Return lower bounds of the distance of a box from all grounds of a band, shape (n,) [m].

    ``pose`` (12, n) and ``slopes`` (n_a, 12, n) are those of the frame of the box; ``half`` are its
    half edges. Of the columns of the box, the lowest points are nearest to the ground: only faces
    that may be on the lower side are divided. A patch is discarded if it is farther from the ground
    than a point of another one is above it. At the horizontal distance ``t``, the ground of slope
    ``L`` is at least ``v - L t`` below a point by ``v`` above the ground.
    """
    n = radius.shape[1]
    reach = np.einsum("akn,an->kn", slopes.magnitude, radius)
    middles, halves, lanes = list[Array](), list[Array](), list[Indices]()
    for axis, side in product(range(3), (-1, 1)):
        row = 3 + 3 * axis + 2
        lowest = np.minimum(side * pose.low[row], side * pose.high[row]) - reach[row]
        lanes.append(np.flatnonzero(~(lowest > 0)))
        face, shape = np.eye(3)[axis, :, None], (3, lanes[-1].size)
        middles.append(np.broadcast_to(side * half[:, None] * face, shape))
        halves.append(np.broadcast_to(half[:, None] * (1 - face), shape))
    middle, size = (np.concatenate(each, axis=1) for each in (middles, halves))
    lane: Indices = np.concatenate(lanes)
    for number in range(HALVINGS + 1):
        frame, slope, r = pose[:, lane], slopes[..., lane], radius[:, lane]
        place, moved = frame[:3], slope[:, :3]
        for j, (spot, part) in enumerate(zip(middle, around(middle, size), strict=True)):
            place = place + frame[3 * j + 3 : 3 * j + 6] * spot
            moved = moved + slope[:, 3 * j + 3 : 3 * j + 6] * part
        center = (place.low[:2] + place.high[:2]) / 2
        near, jets = (place[:2] - center).magnitude, ground.jets(center)
        gap = place[2] - ground.heights(jets, near) - error
        highest = np.full(n, np.inf)
        np.minimum.at(highest, lane, gap.high)
        away = near + np.einsum("akn,an->kn", moved.magnitude[:, :2], r)
        away += sum(frame[3 * j + 3 : 3 * j + 5].magnitude * size[j] for j in range(3))
        away *= 1 + SLACK
        under = ground.slopes(jets, Intervals(-away, away))
        rise = moved[:, 2] - moved[:, 0] * under[0] - moved[:, 1] * under[1]
        change = np.einsum("an,an->n", rise.magnitude, r)
        for j in range(3):
            x, y, z = frame[3 * j + 3 : 3 * j + 6]
            change += (z - x * under[0] - y * under[1]).magnitude * size[j]
        above = gap.low - change * (1 + SLACK)
        # the nearest ground is not farther away than the highest value: it lies in one of the rings
        least, far = above.copy(), np.maximum(highest[lane], 0.0)
        for ring in range(RINGS):
            inner, outer = far * ring / RINGS, far * (ring + 1) / RINGS
            wide = (away + outer) * (1 + SLACK)
            steep = ground.steepness(jets, wide) * (1 + SLACK)
            t = np.clip(above * steep / (1 + steep**2), inner, outer)
            distance = np.hypot(t, np.maximum(above - steep * t, 0.0)) * (1 - SLACK)
            least = np.where(above > 0, np.minimum(least, distance), above)
        keep = ~(least > highest[lane])
        if number < HALVINGS:
            middle, size, lane = halved(middle[:, keep], size[:, keep], lane[keep])
    least = np.where(ground.is_known(center, wide.max(axis=0))[1], least, -np.inf)
    lowest = np.full(n, np.inf)
    np.minimum.at(lowest, lane[keep], np.nan_to_num(least, nan=-np.inf)[keep])
    return lowest


def halved(middle: Array, size: Array, lane: Indices) -> tuple[Array, Array, Indices]:
    """Return patches divided in two along their longest side."""
    longest = np.arange(3)[:, None] == size.argmax(axis=0)
    size, step = np.where(longest, size / 2 * (1 + SLACK), size), np.where(longest, size / 2, 0.0)
    middle = np.concatenate([middle - step, middle + step], axis=1)
    return middle, np.tile(size, 2), np.tile(lane, 2)
