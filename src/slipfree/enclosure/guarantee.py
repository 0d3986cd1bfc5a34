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
from typing import Annotated, Any, NamedTuple

import numpy as np

from slipfree.core.arguments import checked
from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError
from slipfree.core.interval import TINY, Intervals, around, exactly, stack
from slipfree.core.records import Array, Indices, Mask, leaves
from slipfree.core.schema import NonNegative
from slipfree.core.trajectory import Trajectory
from slipfree.enclosure.ground_range import GroundRange, range_of
from slipfree.enclosure.wheel_gaps import Boxes, GapBounds, PoseGraphs, gap_bounds, pose_graphs

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
        of the suspension; NaN without a guarantee. [m, rad]
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
    There may be other rest poses far from the nominal one. Only treads touch the ground: bodies,
    the limits of joints, the stability against tipping over and friction are not included.

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
    if unknown := [name for name in spread or {} if name not in given]:
        raise ModelError(
            f"spread: expected names among {', '.join(given)}, found {unknown[0]!r}; correct it"
        )
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
    parts = list[PoseEnclosures]()
    for first in range(0, x.shape[1], LANES):
        k = slice(first, first + LANES)
        parts.append(_enclose(graphs, ground, x[:, k], q[:, k], contacts[..., k], error, spread))
    return PoseEnclosures(*(np.concatenate(each, axis=-1) for each in zip(*parts, strict=True)))


def _enclose(
    graphs: PoseGraphs,
    ground: GroundRange,
    x: Array,
    q: Array,
    contacts: Array,
    error: float,
    spread: Array,
) -> PoseEnclosures:
    """Return the enclosures of poses that are computed together, as `enclose_poses`."""
    middle = np.concatenate([x, q])
    count, n = q.shape
    given = graphs.moving.size - count
    start = np.broadcast_to(spread[graphs.moving[:given], None], (given, n))
    frame = np.zeros((given + count, given + count, n))
    frame[range(given + count), range(given + count)] = 1.0
    curve = np.zeros((given + count, *frame.shape))
    radius = np.full((count, n), 10 * SMALLEST_RADIUS)
    low, high = np.full((2, count, n), np.nan)
    is_enclosed, penetrates, refined = np.zeros((3, n), dtype=bool)
    on_map, tried = np.ones(n, dtype=bool), np.isfinite(middle).all(axis=0)
    first, able = radius, tried

    def boxes(lanes: Indices) -> Boxes:
        sizes = np.concatenate([start[:, lanes], radius[:, lanes]])
        return Boxes(
            middle[:, lanes], frame[..., lanes], curve[..., lanes], sizes, contacts[..., lanes]
        )

    with np.errstate(all="ignore"):
        for k in range(QUICK_TRIES + TRIES + 1):
            if k == QUICK_TRIES + 1:
                tried, radius = (
                    able & ~is_enclosed & ~penetrates,
                    np.where(is_enclosed, radius, first),
                )
            lanes = np.flatnonzero(tried)
            if not lanes.size:
                continue
            box = boxes(lanes)
            if not k:  # a box without extent: bounds to first order
                box.radius[:given] = 0.0
            gaps = gap_bounds(graphs, ground, box, coarse=not k, divided=k > QUICK_TRIES)
            penetrates[lanes] |= (gaps.gap.high < -PENETRATION).any(axis=0)
            if not k:
                frame[..., lanes], curve[..., lanes] = wheel_frames(gaps, given)
                radius[:, lanes] = FIRST_INFLATION * (error + gaps.gap.magnitude) + SMALLEST_RADIUS
                on_map[lanes] &= gaps.on_map
                tried[lanes] = (boxes(lanes).reach[given + 1 :] < LARGEST_TURN).all(axis=0)
                tried &= ~penetrates
                first, able = radius.copy(), tried.copy()
                continue
            found, is_unique = _krawczyk(gaps, box.radius, given, error)
            size = found.magnitude
            inside = is_unique & (size < radius[:, lanes]).all(axis=0)
            low[:, lanes[inside]] = found.low[:, inside]
            high[:, lanes[inside]] = found.high[:, inside]
            is_enclosed[lanes] = inside
            on_map[lanes] &= gaps.on_map
            radius[:, lanes] = np.where(inside, size, INFLATION * size + SMALLEST_RADIUS)
            valid = (boxes(lanes).reach[given + 1 :] < LARGEST_TURN).all(axis=0)
            tried[lanes] = valid & ~inside & ~penetrates[lanes]
            refined |= (k > 1) & is_enclosed & ~tried
        lanes = np.flatnonzero(refined)
        if lanes.size:  # once more in the smaller box that was found
            box = boxes(lanes)
            gaps = gap_bounds(graphs, ground, box._replace(radius=box.radius * (1 + 1e-12)))
            found, _ = _krawczyk(gaps, box.radius, given, error)
            low[:, lanes] = np.fmax(low[:, lanes], found.low)
            high[:, lanes] = np.fmin(high[:, lanes], found.high)
        ends = (np.concatenate([each, found]) for each, found in ((-start, low), (start, high)))
        bounds = exactly(q) + boxes(np.arange(n)).image(Intervals(*ends))[given:]
    is_enclosed &= ~penetrates
    return PoseEnclosures(bounds.low, bounds.high, is_enclosed, on_map, penetrates)


def wheel_frames(gaps: GapBounds, given: int) -> tuple[Array, Array]:
    """Return frames and curves whose last coordinates change the gap of one wheel each.

    The first columns, of given coordinates, change none.
    """
    slope = np.nan_to_num((gaps.slope.low + gaps.slope.high) / 2, posinf=0.0, neginf=0.0)
    matrices = slope[given:].transpose(2, 1, 0)
    regular = np.linalg.cond(matrices) < MAX_CONDITION
    matrices = np.where(regular[:, None, None], matrices, np.eye(matrices.shape[1]))
    inverse = np.where(regular, np.linalg.inv(matrices).transpose(1, 2, 0), np.nan)
    frame = np.zeros((slope.shape[0], *slope.shape[0::2]))
    frame[range(given), range(given)] = 1.0
    frame[given:, given:] = inverse
    frame[given:, :given] = -np.einsum("ijn,kjn->ikn", inverse, slope[:given])
    bend = np.einsum("iwn,jkwn->ijkn", -inverse, gaps.bend)
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
