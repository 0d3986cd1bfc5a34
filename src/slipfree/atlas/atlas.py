"""Mobility maps: where and how a vehicle stands, for every node and heading of a map.

A ground within an error of the map acts on a pose like one vertical shift of the ground under each
wheel. If a quantity is monotone in the shifts, its extremes are those at the corners of the cube of
shifts.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import Annotated, Any, NamedTuple

import casadi as ca
import numpy as np
from annotated_types import Unit

from slipfree.atlas.friction import (
    FrictionGraphs,
    Terms,
    friction_graphs,
    least_friction,
    least_friction_of_loads,
)
from slipfree.batch import many
from slipfree.batch.evaluator import Evaluator, EvaluatorOf, evaluator_of, evaluator_of_graphs
from slipfree.batch.graph import Graph, graph_of
from slipfree.batch.motion import COMPLETE, UNSOLVED, solve_forces
from slipfree.contact.nearest_points import CLEARANCE
from slipfree.core.arguments import checked
from slipfree.core.dae import Dae, Parameter, SampledCheck
from slipfree.core.errors import ModelError, check_known
from slipfree.core.lookups import needed_lookups
from slipfree.core.quantities import quantity_label
from slipfree.core.rearrange import substitute
from slipfree.core.records import Array, Indices, Label, Mask, leaves, overview
from slipfree.core.schema import Count
from slipfree.core.trajectory import Drawable, heading_column
from slipfree.enclosure.guarantee import contact_points, enclose_poses
from slipfree.enclosure.wheel_gaps import pose_graphs

HEIGHT = 2  # row of the height in the result of a lookup, which follows the centre of the cell


@lru_cache(maxsize=4)
def shifted_model(model: Dae) -> Dae:
    """Return a model whose last parameters are shifts of the ground under its wheels [m].

    The result has no checks, which know the map only. ModelError is raised if the ground is not a
    map.
    """
    heights, shifts, wheels = list[ca.SX](), list[Parameter](), model.vehicle.wheels
    closures = ca.vertsplit(model.residuals[0], model.residuals[0].numel() // len(wheels))
    for wheel, closure in zip(wheels, closures, strict=True):
        lookups = needed_lookups(model.lookups, [closure])
        if len(lookups) != 1 or lookups[0].cells is None:
            raise ModelError(
                f"atlas: expected a map (Bicubic) with 'error', found {type(model.ground).__name__}"
                "; sample the ground on a grid"
            )
        heights.append(lookups[0].found[HEIGHT])
        words = f"shift of the ground under wheel {wheel.name}"
        shifts.append(Parameter(Label("shift", "m", words, wheel.name), ca.SX.sym("shift"), 0.0))
    values = [height + each.symbol for height, each in zip(heights, shifts, strict=True)]
    holding = model.holding
    if holding is not None:
        parts = [part for part in holding if part is not None]
        moved = ca.substitute(parts, [ca.vertcat(*heights)], [ca.vertcat(*values)])
        holding = type(holding)(*moved)
    new = substitute(model, heights, values)
    return replace(new, holding=holding, checks=(), p=(*model.p, *shifts))


TOLERANCE = 1e-3  # largest width of the bounds of the least friction coefficient
STANDS = "the vehicle stands"
NO_POSE = "no pose was found at which all wheels touch the ground"
HEADINGS = 16
TILE = 64  # nodes of the side of a tile
SMALL = 16 * TILE**2  # nodes of a map with tiles of half this side
LEAST_FRICTION = quantity_label("least_friction_low"), quantity_label("least_friction_high")
LEAST_UTILISATION = (  # where friction differs from place to place
    quantity_label("least_utilisation_low"),
    quantity_label("least_utilisation_high"),
)
CHECKED = {  # words of failed checks
    "clearance": "a wheel touches the ground a second time",
    "clearance_body": "a body touches the ground",
}
REASON, RESTS = quantity_label("reason"), quantity_label("rests")
ENERGY = quantity_label("energy_per_metre")
TILT = 0.06  # of the starts from which other rests are sought [rad]
SAME_REST = 2e-3  # difference of inclinations up to which rests are the same [rad]
PROVED_TOGETHER = 16  # chunks of poses that are proved together: few need most of the time
COMPUTED = "tip_over_margin", CLEARANCE.name  # quantities beside pose and friction
EXTREMES = {"low": "smallest", "high": "largest"}
OUTWARD = {"low": np.float32(-np.inf), "high": np.float32(np.inf)}
PROVED = Label("proved", "1", "1 where the bounds hold for every ground of the band; 0: undecided")


class Band(NamedTuple):
    """A quantity of the poses: its label, and values of shape (n_headings, n_x, n_y)."""

    label: Label
    values: Array


@dataclass(frozen=True, eq=False)
class Atlas(Drawable):
    """Poses of a vehicle at the nodes of a map, for several headings.

    Attributes
    ----------
    x, y : ndarray, shapes (n_x,) and (n_y,)
        Ascending map coordinates of the platform's centre. [m]
    heading : ndarray, shape (n_headings,)
        Headings. [rad]
    bands : mapping of str to Band
        Quantities by name; NaN where the vehicle does not stand.
    reasons : tuple of str
        Meanings of the values of the band ``reason``.
    ground : Terrain or None
        The ground, for `plot`.
    """

    x: Array
    y: Array
    heading: Array
    bands: Mapping[str, Band]
    reasons: tuple[str, ...]
    ground: object = None

    def __repr__(self) -> str:
        spans = {n: (f"{v[0]:.9g} to {v[-1]:.9g} m",) for n, v in (("x", self.x), ("y", self.y))}
        title = f"Atlas: {self.x.size} x {self.y.size} nodes, {self.heading.size} headings"
        return overview(title, **spans, bands=self.bands)

    def __getitem__(self, name: str) -> Array:
        """Return the values of a band, shape (n_headings, n_x, n_y)."""
        check_known("atlas", [name], self.bands, "one of the bands")
        return self.bands[name].values

    @property
    def stands(self) -> Mask:
        """Whether the vehicle stands, shape (n_headings, n_x, n_y)."""
        return np.asarray(self["reason"] == 0)

    def held(self, friction: float) -> tuple[Mask, Mask]:
        """Return the poses that friction surely holds, and those that it surely does not hold.

        Parameters
        ----------
        friction : float
            Coefficient of friction of the ground times the grip of the wheel with the best grip. On
            a ground with a map of friction, bounds are factors of the map: 1 is the map itself. [1]

        Returns
        -------
        held, not_held : ndarray of bool, shape (n_headings, n_x, n_y)
            Elsewhere the bounds do not decide. A vehicle that does not stand is not held.
        """
        low, high = (self[label.name] for label in least_bounds(self) or LEAST_FRICTION)
        return self.stands & (high <= friction), ~self.stands | (low > friction)

    def share(self, **bounds: tuple[float, float]) -> Array:
        """Return the share of headings at which the vehicle stands within bounds, (n_x, n_y).

        Parameters
        ----------
        **bounds : tuple of 2 floats
            Smallest and largest value of bands by name, in their units.
        """
        valid = self.stands.copy()
        for name, (low, high) in bounds.items():
            values = self[name]
            valid &= (values >= low) & (values <= high)
        return np.asarray(valid.mean(axis=0))

    def extreme(self, name: str, *, largest: bool = True) -> tuple[Array, Array]:
        """Return the largest or smallest value of a band over the headings, and that heading.

        Both have the shape (n_x, n_y), and are NaN where the vehicle stands at no heading.
        """
        values = self[name]
        empty = np.isnan(values).all(axis=0)
        signed = values if largest else -values
        index = np.where(np.isnan(values), -np.inf, signed).argmax(axis=0)
        chosen = np.take_along_axis(values, index[None], axis=0)[0]
        return chosen, np.where(empty, np.nan, self.heading[index])


def least_bounds(poses: Atlas) -> tuple[Label, Label] | None:
    """Return the labels of both bounds of the least friction; None without them."""
    known = LEAST_FRICTION, LEAST_UTILISATION
    return next((labels for labels in known if labels[0].name in poses.bands), None)


class AtlasGraphs(NamedTuple):
    """Graphs of the quantities of poses: equilibrium and least friction."""

    hold: Graph | None
    friction: FrictionGraphs | None

    @property
    def every(self) -> tuple[Graph, ...]:
        """All graphs."""
        hold = () if self.hold is None else (self.hold,)
        return hold if self.friction is None else (*hold, self.friction.start, self.friction.step)


class Reduction(NamedTuple):
    """A band: the rows of a quantity, its label, and the reduction over the rows."""

    source: many.Wanted
    label: Label
    reduce: Callable[..., Array]


class PoseEvaluator(NamedTuple):
    """Evaluators of the poses of a model, reductions of their quantities to bands, and reasons."""

    evaluate: Evaluator
    more: EvaluatorOf[AtlasGraphs]
    reductions: Mapping[str, Reduction]
    least: tuple[Label, Label] | None
    codes: Indices
    reasons: tuple[str, ...]
    power: int | None  # row of the drives' power in the outputs, of vehicles with mass
    quantities: frozenset[str] | None  # names of the bands to compute; None for all
    corners: PoseEvaluator | None  # that of the model with shifts of the ground under the wheels

    @property
    def has_rests(self) -> bool:
        """Whether to count the rests of pressed wheels, which may rest in several ways."""
        return bool(self.evaluate.graphs.dae.rest.numel()) and self.computes(RESTS.name)

    def computes(self, name: str) -> bool:
        """Whether a band is computed if the model has it."""
        return self.quantities is None or name in self.quantities


@checked
def atlas(
    model: Dae,
    *,
    headings: Count | Annotated[Sequence[float], Unit("rad")] = HEADINGS,
    x: Array | None = None,
    y: Array | None = None,
    error: float | None = None,
    guarantee: float | None = None,
    inputs: Mapping[str, float] | None = None,
    tolerance: float = TOLERANCE,
    quantities: Sequence[str] | None = None,
    compiled: bool = True,
    progress: Callable[[float], object] | None = None,
) -> Atlas:
    """Return where and how a vehicle stands on a map, at many places and headings.

    Poses, loads and limits are exact, those of `settle`: nothing is fitted to the ground under the
    vehicle. The least coefficient of friction is enclosed by bounds: no distribution of forces
    holds the vehicle below the lower one, and forces were found for the upper one.

    Parameters
    ----------
    model : Dae
        Model of kinematics or quasi-statics of the vehicle on the ground. A ground that is a map
        gives the places by default.
    headings : int or sequence of float
        Number of equally spaced headings from zero, or headings. [rad]
    x, y : ndarray, optional
        Ascending map coordinates of the places; by default the nodes of the map. [m]
    error : float, optional
        Largest difference between the ground and the map, for bands of the extremes of pose,
        tip-over margin, clearance of bodies and least friction that follow from shifts of the
        ground under the wheels by this length; computed but not proved. [m]
    guarantee : float, optional
        Largest difference between the ground and the map, for bands of the bounds of the poses on
        every such ground, as of `slipfree.guarantee`. [m]
    inputs : mapping of str to float, optional
        Inputs of the model at the poses, zero by default. On soil they set the slip. [rad/s, m/s]
    tolerance : float
        Width of the bounds of the least coefficient of friction that is aimed at. [1]
    quantities : sequence of str, optional
        Names of the bands to compute beside the reasons, if the model has them; by default all.
    compiled : bool
        Whether to compile the equations.
    progress : callable, optional
        Called with the finished share after each tile.

    Returns
    -------
    Atlas
        Quantities of the poses, and the reasons for which the vehicle does not stand.

    Raises
    ------
    ModelError
        If the model is of another kind, a name is unknown, or places or headings are missing.

    Examples
    --------
    >>> import numpy as np
    >>> from slipfree import Bicubic, Grid, atlas, catalog, direct_kinematics
    >>> x = np.linspace(0.0, 12.0, 13)
    >>> ground = Bicubic(Grid(x, x, np.tan(0.2) * np.tile(x, (13, 1))))  # slopes up to the north
    >>> model = direct_kinematics(catalog.three_wheeler(), ground)
    >>> found = atlas(model, headings=4, compiled=False)
    >>> np.rint(100 * found["pitch"][:, 6, 6]).astype(int).tolist()  # north, west, south, east
    [20, 0, -20, 0]
    """
    grid = getattr(model.ground, "grid", None)
    x, y = (
        getattr(grid, name, None) if given is None else np.asarray(given, dtype=float)
        for name, given in (("x", x), ("y", y))
    )
    if x is None or y is None:
        raise ModelError(
            "atlas: expected a map, or the places 'x' and 'y', found a ground "
            "without nodes and no 'x' and 'y'; give both"
        )
    check_known("inputs", inputs or {}, model.input_names)
    heading: Array = np.array(headings, dtype=np.float64)
    if not heading.ndim:  # a number of them
        heading = 2 * np.pi * np.arange(float(heading)) / max(float(heading), 1.0)
    if not heading.size:
        raise ModelError(f"headings: expected at least one, found {headings}; correct it")
    names = None if quantities is None else frozenset(quantities)
    evaluator = pose_evaluator(
        model, with_corners=error is not None, quantities=names, compiled=compiled
    )
    shape = heading.size, x.size, y.size
    labels = bands_of(evaluator, error=error, guarantee=guarantee, is_moving=bool(inputs))
    values = {name: np.full(shape, np.nan, dtype=np.float32) for name in labels}
    tiles = list(tiles_of(x.size, y.size))
    for k, (i, j) in enumerate(tiles):
        tile = tile_of(evaluator, x[i], y[j], heading, inputs or {}, error, tolerance, guarantee)
        for name, found in tile.items():
            values[name][:, i, j] = found
        if progress is not None:
            progress((k + 1) / len(tiles))
    bands = {name: Band(label, values[name]) for name, label in labels.items()}
    return Atlas(x, y, heading, bands, evaluator.reasons, model.ground)


def tile_side(nodes: int) -> int:
    """Return the nodes of a tile's side; small maps have many tiles, too, for all processes."""
    return TILE if nodes > SMALL else TILE // 2


def tiles_of(n_x: int, n_y: int) -> Iterator[tuple[slice, slice]]:
    """Yield the tiles of a map as slices of its two axes, in rows from the north-western corner.

    They are blocks of a raster, whose first row is the northernmost one.
    """
    side = tile_side(n_x * n_y)
    for j in range(n_y, 0, -side):
        for i in range(0, n_x, side):
            yield slice(i, min(i + side, n_x)), slice(max(j - side, 0), j)


@lru_cache(maxsize=4)
def pose_evaluator(
    model: Dae,
    *,
    with_corners: bool,
    quantities: frozenset[str] | None = None,
    compiled: bool = True,
) -> PoseEvaluator:
    """Return the evaluators of the poses of a model; cached, since they serve all tiles.

    ``with_corners`` adds poses on the ground shifted under each wheel; ``quantities`` are the names
    of the bands, by default all.
    """
    evaluate = evaluator_of(model, compiled=compiled)
    graphs = evaluate.graphs
    holding = None if graphs.stages else model.holding  # soil holds wheels, not friction
    bounds = {label.name for label in (*LEAST_FRICTION, *LEAST_UTILISATION)}
    if quantities is not None and not bounds & quantities:
        holding = None
    hold = friction = least = None
    if holding is not None:
        entries = (holding.matrix.nz[:], holding.load, holding.friction)
        least = LEAST_UTILISATION
        if all(each.is_constant() for each in ca.vertsplit(holding.friction)):
            least, entries = (
                LEAST_FRICTION,
                (*entries[:2], holding.friction / ca.mmax(holding.friction)),
            )
        if holding.normal is None:
            friction = friction_graphs(holding.matrix.sparsity())
        else:
            entries = ca.densify(ca.vec(holding.matrix)), entries[1], entries[2] * holding.normal
        hold = graph_of(model, graphs.state, "hold", entries)
    extra = AtlasGraphs(hold, friction)
    more = evaluator_of_graphs(extra, compiled=compiled and bool(extra.every))
    reasons, codes = _reasons(model)
    names = [label.name for label in leaves(model.labels.y)]
    power = names.index("power") if "power" in names else None
    first = graphs.rows.x.stop - graphs.dae.rest.numel()  # the states before are given
    reductions = dict[str, Reduction]()  # rows of states and outputs, or summaries of several
    for name, source in many.sources_of(graphs, None).items():
        is_pose = first <= source.rows[0] < graphs.rows.p.stop and not source.is_output
        if quantities is not None and name not in quantities:
            continue
        if is_pose and name != "z" and not source.wheels:
            reductions[name] = Reduction(source, source.label, np.min)
        elif name in REDUCTIONS:
            reduce, words = REDUCTIONS[name]
            label = replace(source.label, words=words or source.label.words)
            reductions[name] = Reduction(source, label, reduce)
    corners = None
    if with_corners:
        wanted = {*pose_names(reductions), *COMPUTED, *bounds}
        corners = pose_evaluator(
            shifted_model(model),
            with_corners=False,
            quantities=frozenset(wanted if quantities is None else wanted & quantities),
            compiled=compiled,
        )
    return PoseEvaluator(
        evaluate, more, reductions, least, codes, reasons, power, quantities, corners
    )


def bands_of(
    evaluator: PoseEvaluator,
    *,
    error: float | None,
    guarantee: float | None = None,
    is_moving: bool = False,
) -> dict[str, Label]:
    """Return the labels of the bands; there is one of energy if the vehicle moves.

    ``error`` is the shift of the ground at corner poses, ``guarantee`` the largest error of heights
    for proved bounds [m]; both may be None.
    """
    labels = {REASON.name: REASON} | {
        name: each.label for name, each in evaluator.reductions.items()
    }
    labels |= {label.name: label for label in evaluator.least or ()}
    labels |= {RESTS.name: RESTS} if evaluator.has_rests else {}
    checks = (check.label for check in evaluator.evaluate.graphs.dae.checks)
    if evaluator.computes(CLEARANCE.name):
        labels |= {label.name: label for label in checks if label.name == CLEARANCE.name}
    labels |= {ENERGY.name: ENERGY} if is_moving and evaluator.power is not None else {}

    def add_ends(names: Iterable[str], template: str, where: str) -> None:
        for old, (end, words) in product([labels[name] for name in names], EXTREMES.items()):
            name = template.format(old.full, end)
            labels[name] = Label(name, old.unit, f"{old.words}: {words} {where}")

    if evaluator.corners is not None:
        names = [name for name in labels if name in (evaluator.corners.quantities or ())]
        add_ends(names, "{}_computed_{}", f"with the ground shifted by up to {error:g} m")
    if guarantee is not None:
        pose_graphs(evaluator.evaluate.graphs.dae)  # raises errors for models without guarantees
        words = f"on grounds within {guarantee:g} m of the map"
        add_ends(pose_names(evaluator.reductions), "{}_{}", words)
        labels[PROVED.name] = PROVED
    return labels


def pose_names(reductions: Mapping[str, Reduction]) -> list[str]:
    """Return the names of the bands that are coordinates of the pose."""
    return [name for name, each in reductions.items() if not each.source.is_output]


def tile_of(
    evaluator: PoseEvaluator,
    x: Array,
    y: Array,
    heading: Array,
    inputs: Mapping[str, float],
    error: float | None,
    tolerance: float,
    guarantee: float | None = None,
) -> dict[str, Array]:
    """Return the bands of a tile, shape (n_headings, n_x, n_y).

    ``x``, ``y`` are nodes [m], ``heading`` headings [rad], ``inputs`` rates of a moving vehicle by
    name; ``error`` and ``guarantee`` are those of `bands_of`, ``tolerance`` is that of the least
    friction.

    Bands at the corners of the cube of shifts of the ground under the wheels have no numbers where
    the vehicle does not stand at a corner, nor where the pose on the map is not between those at
    the corners: there, a corner pose is another rest, as beside a wall.
    """
    evaluate, graphs, corners = evaluator.evaluate, evaluator.evaluate.graphs, evaluator.corners
    dae, rows, wheels = graphs.dae, graphs.rows, len(graphs.dae.vehicle.wheels)
    given = np.array([[inputs.get(label.full, 0.0)] for label in leaves(dae.labels.u)])

    def bands_at(places: Array) -> tuple[dict[str, Array], Array]:
        """Return the bands of some poses, shape (n,), and states, NaN where they do not stand."""
        states = many.start_states(graphs, dict(zip(("heading", "x", "y"), places, strict=True)))
        states[rows.u] = given
        stands = many.stand(evaluate, states)
        if evaluator.has_rests:
            rests = other_rests(evaluate, states, stands.has_pose)
        states[rows.u] = given  # a vehicle relaxes at rest
        outcomes = many.stand_checked(evaluate, states, stands)
        lost = np.flatnonzero(outcomes == UNSOLVED)
        distances = solve_forces(evaluate, states[:, lost])
        for distance, k in zip(distances, graphs.bounds, strict=True):
            if dae.limits[k].label.name in ("upright", "hole_margin"):  # why no pose was found
                outcomes[lost[distance < 0]] = k
        bands = _quantities(evaluator, dae.checks, states, tolerance)
        if evaluator.has_rests:
            bands[RESTS.name] = rests.astype(float)
        if inputs and evaluator.power is not None:
            power = evaluate(graphs.outputs, states)[evaluator.power]
            rates = evaluate(graphs.motion, states)[graphs.motion.parts[0]]
            bands[ENERGY.name] = power / np.hypot(*rates[graphs.places[:2]])  # over the speed
        stands = outcomes == COMPLETE
        if corners is not None and error is not None:
            signs = product((-1.0, 1.0), repeat=wheels)
            cube = [shifted(corners, states, stands, error * np.array(each)) for each in signs]
            between = np.ones(stands.shape, dtype=bool)
            for name in pose_names(evaluator.reductions):
                away = np.array([each[name] - bands[name] for each in cube])
                between &= (away.min(axis=0) <= SAME_REST) & (away.max(axis=0) >= -SAME_REST)
            for name, (end, sign) in product(cube[0], (("low", -1.0), ("high", 1.0))):
                extreme = sign * np.max([sign * each[name] for each in cube], axis=0)
                # the ground under the bodies shifts, too
                extreme += sign * error * (name == CLEARANCE.name)
                bands[f"{name}_computed_{end}"] = np.where(between, extreme, np.nan)
        bands = {name: np.where(stands, values, np.nan) for name, values in bands.items()}
        # an outcome is the index of a limit or check, `COMPLETE` (-1) or `UNSOLVED` (-2)
        bands = {REASON.name: evaluator.codes[outcomes + 2].astype(float)} | bands
        return bands, np.where(stands, states, np.nan)

    def shifted(
        corner: PoseEvaluator, states: Array, stands: Mask, shifts: Array
    ) -> dict[str, Array]:
        """Return the bands of poses with shifts of the ground under the wheels [m]."""
        evaluate = corner.evaluate
        moved = np.insert(states, [rows.c.stop] * wheels, shifts[:, None], axis=0)
        rests = many.stand_near(evaluate, moved)  # relaxes to the rest near that of the pose
        moved[evaluate.graphs.rows.u] = states[rows.u]
        known = stands & (many.stand_checked(evaluate, moved, rests) == COMPLETE)
        bands = _quantities(corner, dae.checks, moved, tolerance)
        return {name: np.where(known, values, np.nan) for name, values in bands.items()}

    places = np.stack([each.ravel() for each in np.meshgrid(heading, x, y, indexing="ij")])
    parts = list[dict[str, Array]]()
    for first in range(0, places.shape[1], PROVED_TOGETHER * many.CHUNK):
        some = places[:, first : first + PROVED_TOGETHER * many.CHUNK]
        with np.errstate(all="ignore"):
            chunks = range(0, some.shape[1], many.CHUNK)
            own = [bands_at(some[:, k : k + many.CHUNK]) for k in chunks]
        parts.append(_joined([bands for bands, _ in own]))
        if guarantee is not None:
            states = np.concatenate([states for _, states in own], axis=1)
            parts[-1] |= _proved_bands(evaluator, states, guarantee)
    shape = heading.size, x.size, y.size
    whole = _joined(parts)
    with np.errstate(over="ignore"):  # a wheel without load uses any multiple of its friction
        return {name: each.reshape(shape).astype(np.float32) for name, each in whole.items()}


def _joined(parts: Sequence[dict[str, Array]]) -> dict[str, Array]:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _quantities(
    evaluator: PoseEvaluator, checks: Sequence[SampledCheck], states: Array, tolerance: float
) -> dict[str, Array]:
    """Return the bands of poses that do not depend on other poses, shape (n,) each.

    ``checks`` have the clearances; ``tolerance`` is that of the bounds of the least friction.
    """
    evaluate, graphs = evaluator.evaluate, evaluator.evaluate.graphs
    outputs = evaluate(graphs.outputs, states)
    bands = dict[str, Array]()
    for name, (source, _, reduce) in evaluator.reductions.items():
        values = (outputs if source.is_output else states)[source.rows]
        bands[name] = reduce(values, axis=0)
    for check in checks:
        # `margin`, since `margin_at` returns only a bound of large clearances
        if check.label.name == CLEARANCE.name and evaluator.computes(CLEARANCE.name):
            bands[CLEARANCE.name] = check.margin(*many.columns_of(graphs, states)[:2])
    more = evaluator.more.graphs
    if more.hold is not None and evaluator.least is not None:  # forces hold it by friction
        entries = evaluator.more(more.hold, states)
        terms = Terms(*(entries[part] for part in more.hold.parts))
        if more.friction is None:
            bounds = least_friction_of_loads(terms, tolerance)
        else:
            bounds = least_friction(evaluator.more, more.friction, terms, tolerance)
        bands |= zip((label.name for label in evaluator.least), bounds, strict=True)
    return bands


def _proved_bands(evaluator: PoseEvaluator, states: Array, error: float) -> dict[str, Array]:
    """Return the bounds of poses that stand, on grounds within an error of the map [m]."""
    model, rows = evaluator.evaluate.graphs.dae, evaluator.evaluate.graphs.rows
    stands = np.isfinite(states[rows.p]).all(axis=0)
    x, p = states[rows.x][:, stands], states[rows.p][:, stands]
    closed = [label.full for label in leaves(model.labels.z[0])][: len(model.vehicle.wheels)]
    places = x, p[: len(closed)], contact_points(model, p)
    found = enclose_poses(model, *places, error, np.zeros(len(x)))
    bands = {PROVED.name: np.full(stands.size, np.nan)}
    bands[PROVED.name][stands] = found.is_enclosed
    for name, (end, away) in product(pose_names(evaluator.reductions), OUTWARD.items()):
        band = bands[f"{name}_{end}"] = np.full(stands.size, np.nan)
        bound = getattr(found, end)[closed.index(name)]
        band[stands] = np.nextafter(bound.astype(np.float32), away)  # bands have single precision
    return bands


def other_rests(evaluate: Evaluator, states: Array, solved: Mask) -> Indices:
    """Return how many rests of pressed wheels were found; the states become the steepest one.

    A rigid vehicle with four wheels may rock: it relaxes from the rest that was found, tilted
    towards each of its four corners.
    """
    dae = evaluate.graphs.dae
    count = solved.astype(int)
    if not dae.rest.numel():
        return count
    tilt = dae.state_rows("roll", "pitch")
    rests, is_stable = [states.copy()], np.zeros_like(solved)
    for turn in np.pi / 4 + np.pi / 2 * np.arange(4):
        other = rests[0].copy()
        other[tilt] += TILT * np.array([[np.cos(turn)], [np.sin(turn)]])
        part = other[:, solved]
        is_solved = many.stand_near(evaluate, part).has_pose
        other[:, solved] = np.where(is_solved, part, np.nan)
        apart = np.array([np.hypot(*(other[tilt] - each[tilt])) for each in rests])
        is_stable |= apart[0] <= SAME_REST
        new = ~(apart <= SAME_REST).any(axis=0) & np.isfinite(other[tilt[0]])
        count += new
        rests.append(np.where(new, other, np.nan))
    steepness = np.array([np.hypot(*each[tilt]) for each in rests])
    balanced = ~is_stable & (count > 1)  # on an edge: the vehicle returns from no tilt
    count -= balanced
    steepness[0, balanced] = np.nan
    worst = np.where(np.isnan(steepness), -1.0, steepness).argmax(axis=0)
    for k, each in enumerate(rests[1:], start=1):
        states[:, worst == k] = each[:, worst == k]
    return count


def _reasons(dae: Dae) -> tuple[tuple[str, ...], Indices]:
    """Return the reasons, and the reason of each code of `stand_checked`, plus two.

    Limits and checks that differ only in the wheel share a reason.
    """
    names, reasons, codes = list[str](), [STANDS, NO_POSE], [1, 0]
    for label in (each.label for part in (dae.limits, dae.checks) for each in part):
        if label.name not in names:
            names.append(label.name)
            words = CHECKED.get(label.name, label.words).replace(f"wheel {label.wheel}", "a wheel")
            words = re.sub(r" \([^()]*\)", "", words)
            reasons.append(re.split(r"; |, which ", words)[0])  # without remedies and numbers
        codes.append(2 + names.index(label.name))
    return tuple(reasons), np.array(codes)


REDUCTIONS: dict[str, tuple[Any, str]] = {  # of several wheels
    "tip_over_margin": (np.min, ""),
    "utilisation": (np.max, "largest utilisation of the wheels, for the load-weighted forces"),
    "drive_torque": (lambda values, axis: np.abs(values).max(axis), "largest torque of a drive"),
    "slip_ratio": (np.max, "largest slip ratio of the wheels"),
    "sinkage": (np.max, "largest sinkage of the wheels"),
}


ELEVATION = quantity_label("elevation")
SLIDES = "friction does not hold the vehicle"
UNDECIDED = "the bounds of the least friction do not decide"
OUT_OF_BOUNDS = "{} is not within its bounds"
# beginnings of bands whose smallest values matter
SMALLEST = "tip_over_margin", "clearance", "proved"
SIGNED = "energy_per_metre"  # negative where the vehicle brakes
STANDING, ALLOWED, LIMIT = "share_standing", "share_allowed", "limit"
Bounds = Mapping[str, tuple[float, float]]


class Verdicts(NamedTuple):
    """Why the vehicle may not stay at each pose.

    ``codes``, shape (n_headings, n_x, n_y), are indices of ``reasons``; 0 where it may stay.
    """

    codes: Indices
    reasons: tuple[str, ...]

    @property
    def allowed(self) -> Array:
        """Share of headings at which the vehicle may stay, shape (n_x, n_y)."""
        return np.asarray((self.codes == 0).mean(axis=0))

    @property
    def limit(self) -> Array:
        """Most frequent reason at each node, shape (n_x, n_y); 0 if every heading is allowed."""
        codes = range(1, len(self.reasons))
        counts = np.stack([(self.codes == code).sum(axis=0) for code in codes])
        return np.where(counts.any(axis=0), 1 + counts.argmax(axis=0), 0)


def verdicts(poses: Atlas, *, friction: float | None, within: Bounds) -> Verdicts:
    """Return the reasons for which a vehicle may not stay at the poses of an atlas.

    ``friction`` is the coefficient at the wheel with the best grip, which must hold the vehicle; 1
    with a map of friction, None on a ground without. ``within`` are bounds of bands by name;
    ModelError is raised for an unknown one.
    """
    reasons, codes = list(poses.reasons), poses[REASON.name].astype(int)
    least = least_bounds(poses)
    if friction is not None and least is not None:
        reasons += [SLIDES, UNDECIDED]
        for bound, reason in zip(least, (SLIDES, UNDECIDED), strict=True):
            codes[(codes == 0) & (poses[bound.name] > friction)] = reasons.index(reason)
    for name, (low, high) in within.items():
        values = poses[name]
        reasons.append(OUT_OF_BOUNDS.format(name))
        codes[(codes == 0) & ~((values >= low) & (values <= high))] = len(reasons) - 1
    return Verdicts(codes, tuple(reasons))


def summary(
    poses: Atlas, found: Verdicts, elevation: Array, frame: str = "paper"
) -> dict[str, Band]:
    """Return maps over the headings, by name: bands of shape (n_x, n_y).

    ``elevation`` are the heights of the nodes [m], ``frame`` is that of headings.
    """
    words = "share of headings at which the vehicle stands"
    maps = [Band(Label(STANDING, "1", words), np.asarray(poses.stands.mean(axis=0)))]
    if len(found.reasons) > len(poses.reasons):
        words += f" and none of the reasons of the band '{LIMIT}' applies"
        maps.append(Band(Label(ALLOWED, "1", words), found.allowed))
    maps.append(
        Band(Label(LIMIT, "1", "most frequent reason that excludes headings; 0: none"), found.limit)
    )
    least = least_bounds(poses)
    if least is not None:
        maps += _friction_maps(poses, least, frame)
    for label, values in poses.bands.values():
        if label in (REASON, *(least or ())):
            continue
        # the smallest value of margins, both of signed quantities, or the largest magnitude
        extremes = {"largest magnitude": np.fmax.reduce(np.abs(values))}
        if label.name == SIGNED or label.name.startswith(SMALLEST):
            extremes = {"smallest value": np.fmin.reduce(values)}
        if label.name == SIGNED:
            extremes["largest value"] = np.fmax.reduce(values)
        for kind, extreme in extremes.items():
            name = f"{label.name}_{kind.split()[0]}"
            new = Label(name, label.unit, f"{kind} over the headings: {label.words}")
            maps.append(Band(new, extreme))
    maps.append(Band(ELEVATION, elevation))
    return {band.label.name: band for band in maps}


def _friction_maps(poses: Atlas, least: tuple[Label, Label], frame: str) -> Sequence[Band]:
    """Return both bounds of the least friction at the best and the worst heading, and these.

    Coefficients without a bound are NaN: then no forces were found that hold the vehicle.
    """
    maps = list[Band]()
    for name, largest in (("best", False), ("worst", True)):
        for label in least:
            values = poses.extreme(label.name, largest=largest)[0]
            base, _, end = label.name.rpartition("_")
            words = f"{name} of the headings at which the vehicle stands: {label.words}"
            renamed = Label(f"{base}_{name}_{end}", label.unit, words)
            maps.append(Band(renamed, np.where(np.isfinite(values), values, np.nan)))
        bound, at = poses.extreme(least[1].name, largest=largest)
        if not largest:  # all headings are equally bad without forces
            at = np.where(np.isfinite(bound), at, np.nan)
        label, turned = heading_column(at, frame)
        words = f"heading with the {'largest' if largest else 'smallest'} {least[1].name}"
        label = Label(f"heading_{name}", "degree", f"{words}; {label.words}")
        maps.append(Band(label, np.mod(np.rad2deg(turned), 360.0)))
    return maps
