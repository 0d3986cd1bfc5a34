"""Very many poses and motions of a model, as arrays with a value for each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.batch import motion
from slipfree.batch.evaluator import Evaluator, evaluator_of
from slipfree.batch.graph import Graphs, graphs_of
from slipfree.core.arguments import BY_NAME, check_finite, checked
from slipfree.core.dae import Dae, WheelCheck, invalid_start
from slipfree.core.errors import ModelError, check_known, require
from slipfree.core.lookups import evaluate as evaluate_at
from slipfree.core.records import Array, Indices, Label, Mask, by_quantity, leaves
from slipfree.core.trajectory import WHEELS, Column, Outcome, Trajectory

if TYPE_CHECKING:
    import xarray

# lanes computed together: their states stay in the processor's cache, where rows of a power of two
# would fall into the same places
CHUNK = 1016
LARGEST = 2**22  # numbers in the samples of lanes computed together
STEP, RELAXING_STEP = 0.5, 0.05  # default length of a step [size of the vehicle]
TRAIL_STEP = 0.5  # longest default step [trail of a caster]
PLAIN_STEPS = 8  # steps of Newton's method from the guess of the model
LOWERING_STEPS = 40  # steps of a vehicle that is lowered onto the ground
RELAXATIONS = 6  # of such a vehicle, if its states relax
CONTACT_STEPS = 5  # Newton steps between two searches for deeper points
DAMPED = 12  # number of such steps after which they are limited more and more
MAX_LENGTH = 4.0  # length of a step, as the sum of the changes of positions [typical sizes]
CONTACT = 1e-7  # gap of a wheel in contact [size]
NEIGHBOUR = 0.02  # least distance of a deeper point that becomes the contact [size]
# roll and pitch added to the poses from which vehicles are lowered, one after the other [rad]
TILTS = ((0.0, 0.0), (0.1, 0.0), (-0.1, 0.0), (0.0, 0.1), (0.0, -0.1))
CONVERGED = 1e-7  # last step of Newton's method, whose error is about its square [typical size]
FAILED = "failed"  # outcome without a pose
NO_POSE = (
    "no pose was found at which all wheels touch the ground; choose another place, or a ground "
    "without hollows narrower than the wheels (terrain.rolled)"
)


class LaneResults(NamedTuple):
    """Results of n motions at m samples."""

    # quantities by name, of shape (n, m) or (n, m, n_wheels), NaN after the end of a motion, and
    # estimated errors of the states at the last sample, shape (n,)
    columns: dict[str, Column]
    wheels: tuple[str, ...]
    outcomes: list[str]  # names of outcomes in lower case; ``"failed"`` without a start
    reasons: list[str]  # messages of early ends
    end: Array  # times that the motions reached, shape (n,) [s]
    # estimates of the errors of x and y at the last sample, shape (n,) [m]; None without estimates
    error: Array | None
    # which motions `slipfree.simulate` must decide: Newton's method did not follow the contacts
    disputed: Mask


class Wanted(NamedTuple):
    """Label of a wanted quantity, and its rows: outputs if ``is_output``, otherwise states."""

    label: Label
    rows: list[int]
    is_output: bool
    shift: Array
    wheels: tuple[str, ...]


@checked
def settle_many(
    model: Dae,
    *,
    quantities: Sequence[str] | None = None,
    compiled: bool = True,
    **start: Annotated[float | Array, BY_NAME],
) -> xarray.Dataset:
    """Return the vehicle at rest at many positions.

    Each pose equals that of `settle`. On ground that is more concave than a wheel there may be
    several, of which both find one. Vehicles are lowered onto the ground from above.

    Parameters
    ----------
    model : Dae
        Model of kinematics or quasi-statics.
    quantities : sequence of str, optional
        Names of the quantities to keep; by default the states and the other coordinates of the
        pose.
    compiled : bool
        Whether to compile the equations, which takes up to half a minute once for each structure of
        a vehicle. Without a compiler they are interpreted, and a warning gives the reason.
    **start : float or ndarray, shape (n_poses,)
        States by name, such as ``x``, ``y``, ``heading``; others are zero. [m, rad]

    Returns
    -------
    xarray.Dataset
        Quantities with the dimensions ``pose`` and ``wheel``, NaN where no pose was found.
        ``outcome`` is ``"complete"``; the outcome of the violated limit in lower case, such as
        ``"limit"``; or ``"failed"`` without a pose. ``reason`` is the message of such an end.

    Raises
    ------
    ModelError
        If a name is unknown, a value is not finite, shapes differ, or the model is another one.
    SlipfreeError
        If xarray is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> from slipfree import Bicubic, Grid, catalog, direct_kinematics, settle_many
    >>> axis = np.linspace(-5.0, 5.0, 51)
    >>> ground = Bicubic(Grid(axis, axis, 0.1 * np.sin(axis)[:, None] * np.cos(axis)))
    >>> model = direct_kinematics(catalog.three_wheeler(), ground)
    >>> poses = settle_many(model, x=np.linspace(-3.0, 3.0, 1000), heading=0.3, compiled=False)
    >>> print(f"roll from {poses['roll'].values.min():.3f} to {poses['roll'].values.max():.3f} rad")
    roll from -0.070 to 0.069 rad
    """
    require("xarray")
    evaluate = evaluator_of(model, compiled=compiled)
    graphs = evaluate.graphs
    names = [label.full for label in leaves((model.labels.x, model.labels.z[0]))]
    sources = sources_of(graphs, names if quantities is None else quantities)
    columns = {name: np.asarray(values, dtype=float) for name, values in start.items()}
    count = max((values.size for values in columns.values()), default=1)
    parts, endings = list[dict[str, Array]](), list[tuple[str, str]]()
    for first in range(0, count, CHUNK):
        part = {n: v if v.size == 1 else v[first : first + CHUNK] for n, v in columns.items()}
        states = start_states(graphs, part)
        codes = stand_checked(evaluate, states, stand(evaluate, states))
        ended = {k: (outcome, words) for k, outcome, words in _ends(evaluate, codes, states)}
        if (failed := np.flatnonzero(codes == motion.UNSOLVED)).size:
            messages = obstacles(model, *columns_of(graphs, states[:, failed])[:2])
            ended |= {k: (FAILED, each) for k, each in zip(failed.tolist(), messages, strict=True)}
            states[:, failed] = np.nan
        endings += [ended.get(lane, ("complete", "")) for lane in range(codes.size)]
        parts.append(_values(evaluate, sources, states[None]))
    variables: dict[str, Any] = {}
    wheels = tuple[str, ...]()
    for name, source in sources.items():
        values = np.concatenate([part[name][:, 0] for part in parts])
        wheels = source.wheels or wheels
        metadata = Column(source.label, values).metadata
        variables[name] = ("pose", "wheel")[: values.ndim], values, metadata
    for name, texts in zip(("outcome", "reason"), zip(*endings, strict=True), strict=True):
        variables[name] = "pose", np.array(texts, dtype=str)
    coordinates = {"wheel": ("wheel", np.array(wheels), WHEELS)} if wheels else {}
    dataset: xarray.Dataset = require("xarray").Dataset(variables, coordinates)
    return dataset


class Rests(NamedTuple):
    """Which of n vehicles stand, and which wheels of these touch the ground only at contacts."""

    has_pose: Mask
    is_clear: Mask


class Placement(NamedTuple):
    """Equations of the positions of states, arrays with a row for each variable of n vehicles."""

    dae: Dae
    p: slice  # rows of the positions, the first block of the unknowns
    # one Newton step of the positions of states: new positions, and the sum of their changes in
    # typical sizes
    step: Callable[[Array], tuple[Array, Array]]
    # values of ``placing`` of each of the `wheel_checks` at states
    placed: Callable[[Array], Sequence[Array]]
    # brings the states of models that relax to rest; returns which have reached it
    relax: Callable[[Array], Mask] | None = None


def stand(evaluate: Evaluator, states: Array) -> Rests:
    """Let the vehicle stand at given states; return which poses were found."""
    guess, count = evaluate.graphs.guess, evaluate.graphs.dae.rest.numel()
    if count:
        end = evaluate.graphs.rows.x.stop
        states[end - count : end] = evaluate(guess, states)[guess.parts[3]]
    return stand_near(evaluate, states)


def stand_near(evaluate: Evaluator, states: Array) -> Rests:
    """Let the vehicle stand as `stand`; states that relax begin at their given values."""
    relaxes = evaluate.graphs.dae.rest.numel() > 0
    return solve_positions(evaluate, states, partial(motion.relax, evaluate) if relaxes else None)


def solve_positions(
    evaluate: Evaluator, states: Array, relaxing: Callable[[Array], Mask] | None = None
) -> Rests:
    """Solve the positions of states for the other rows by `find_rests`, from the model's guess."""
    graphs, placing = evaluate.graphs, evaluate.graphs.placing
    wheels = [graphs.checks.index(check) for check in wheel_checks(graphs.dae)]

    def step(states: Array) -> tuple[Array, Array]:
        values = evaluate(graphs.place, states)
        return values[graphs.place.parts[0]], values[graphs.place.parts[1]][0]

    def placed(states: Array) -> list[Array]:
        values = evaluate(placing, states)
        return [values[placing.parts[k]] for k in wheels]

    with np.errstate(all="ignore"):
        guess = evaluate(graphs.guess, states)
        for rows, part in zip(graphs.rows.z, graphs.guess.parts[:3], strict=True):
            states[rows] = guess[part]
        return find_rests(Placement(graphs.dae, graphs.rows.p, step, placed, relaxing), states)


def wheel_checks(dae: Dae) -> list[WheelCheck]:
    """Return the checks of the wheels whose contacts are positions of a model."""
    known = {label.wheel for label in leaves(dae.labels.z[:1]) if label.name == "contact_x"}
    wheels = [check for check in dae.checks if isinstance(check, WheelCheck)]
    return [check for check in wheels if check.label.wheel in known]


def find_rests(placement: Placement, states: Array) -> Rests:
    """Solve the positions of vehicles at rest from the first positions in their states.

    Newton's method starts there, and states that relax follow. Where this fails, or a wheel is in
    the ground apart from its contact, the vehicle is lowered onto the ground from several poses,
    one after the other. Poses that penetrate the ground are kept only if no other pose was found.
    The positions of a vehicle that does not stand are those of the last step.
    """
    p, relax, dae, first = placement.p, placement.relax, placement.dae, states.copy()
    wheels = wheel_checks(dae)
    rows = {label.full: p.start + k for k, label in enumerate(leaves(dae.labels.z[0]))}
    if relax:
        rows |= {name: dae.state_rows(name)[0] for name in ("z", "roll", "pitch")}
    angles = [rows[name] for name in ("roll", "pitch") if name in rows]
    has_pose = _newton(placement, states, PLAIN_STEPS, np.inf)
    if relax:
        has_pose = relax(states)
    is_clear = _clear(placement, wheels, states, has_pose)
    for attempt, tilt in enumerate(TILTS if wheels and angles else TILTS[:1]):
        lanes = np.flatnonzero(~is_clear)
        if not lanes.size:
            break
        # lowered from the worst penetration of a pose in the ground, else from the guess
        is_kept = has_pose[lanes] & (attempt == 0)
        part = np.where(is_kept, states[:, lanes], first[:, lanes])
        part[angles] += np.reshape(tilt[: len(angles)], (-1, 1))
        rests = _lower(placement, wheels, rows, part)
        is_better = rests.is_clear | ~has_pose[lanes]
        states[:, lanes[is_better]] = part[:, is_better]
        has_pose[lanes] |= rests.has_pose
        is_clear[lanes] = rests.is_clear
    return Rests(has_pose, is_clear)


def _lower(
    placement: Placement, wheels: list[WheelCheck], rows: Mapping[str, int], states: Array
) -> Rests:
    """Lower vehicles onto the ground.

    Each wheel has one contact, the point of its tread that is deepest in the ground. Newton steps
    put the contacts on the ground, and states relax; a contact leaves when another point of the
    wheel is deeper. Wheels without a check keep their contacts.
    """
    size = placement.dae.size
    contacts = [[rows[f"contact_{a}[{check.label.wheel}]"] for a in "xy"] for check in wheels]
    has_pose, is_clear = np.zeros((2, states.shape[1]), dtype=bool)
    for k in range(RELAXATIONS if placement.relax else LOWERING_STEPS):
        # what does not come to rest is left, since it overturns
        lanes = np.flatnonzero(~is_clear & has_pose if k and placement.relax else ~is_clear)
        if not lanes.size:
            break
        part = states[:, lanes]
        deepest = [c.deepest(at) for c, at in zip(wheels, placement.placed(part), strict=True)]
        if k == 0 and wheels and "z" in rows:
            part[rows["z"]] -= np.min([gap for gap, _ in deepest], axis=0)
        for contact, (gap, foot) in zip(contacts, deepest, strict=True):
            is_apart = np.hypot(*(foot - part[contact])) > NEIGHBOUR * size
            is_moved = (np.abs(gap) > CONTACT * size) & (is_apart | (k == 0))
            part[contact] = np.where(is_moved, foot, part[contact])
        longest = MAX_LENGTH * min(1.0, DAMPED / (k + 1))
        if placement.relax:
            has_pose[lanes] = placement.relax(part)
        else:
            has_pose[lanes] = _newton(placement, part, CONTACT_STEPS, longest)
        is_clear[lanes] = _clear(placement, wheels, part, has_pose[lanes])
        states[:, lanes] = part
    return Rests(has_pose, is_clear)


def _clear(placement: Placement, wheels: list[WheelCheck], states: Array, has_pose: Mask) -> Mask:
    """Return which vehicles with a pose touch the ground only at their contacts."""
    is_clear = has_pose.copy()
    if wheels and has_pose.any():
        placed = placement.placed(states if has_pose.all() else states[:, has_pose])
        margins = [c.margin_at(each) for c, each in zip(wheels, placed, strict=True)]
        is_clear[has_pose] = np.min(margins, axis=0) >= 0
    return is_clear


def _newton(placement: Placement, states: Array, count: int, longest: float) -> Mask:
    """Correct the positions by Newton steps of limited length; return which converged."""
    p, done = placement.p, np.zeros(states.shape[1], dtype=bool)
    for _ in range(count):
        # a lane that is done keeps its result, whatever the others need
        lanes: Any = np.flatnonzero(~done) if done.any() else slice(None)
        if done.all():
            break
        part = states[:, lanes]
        new, change = placement.step(part)
        new = part[p] + (new - part[p]) * np.minimum(1.0, longest / change)
        states[p, lanes] = np.where(np.isfinite(new).all(axis=0), new, part[p])
        done[lanes] = change < CONVERGED
    return done


def stand_checked(evaluate: Evaluator, states: Array, rests: Rests) -> Indices:
    """Return codes of the reasons why poses are not valid.

    Codes are `COMPLETE`, `UNSOLVED` without a pose, the index of a violated limit, or, after the
    limits, that of a failed check. The states get positions, rates and forces.
    """
    graphs = evaluate.graphs
    last = states[:, ~rests.has_pose]
    distances = motion.solve_forces(evaluate, states)
    states[:, ~rests.has_pose] = last  # of these, only the positions are of interest
    codes = np.where(rests.has_pose, motion.COMPLETE, motion.UNSOLVED)
    beyond = rests.has_pose & ~(motion.margins(distances) >= 0)
    if beyond.any():
        codes[beyond] = np.array(graphs.bounds)[motion.smallest(distances[:, beyond])]
    inside, every = codes == motion.COMPLETE, np.arange(len(graphs.checks))
    others = np.setdiff1d(every, [*graphs.wheels])
    for lanes, checks in ((inside & rests.is_clear, others), (inside & ~rests.is_clear, every)):
        if checks.size and lanes.any():
            clear = motion.clearances(evaluate, states[:, lanes], checks)
            failed = checks[motion.smallest(clear)] + len(graphs.dae.limits)
            codes[lanes] = np.where(clear.min(axis=0) >= 0, motion.COMPLETE, failed)
    return codes


def obstacles(dae: Dae, x: Array, z: Array) -> list[str]:
    """Return why vehicles do not stand: a limit that their last positions violate, if any."""
    x_symbols, unknowns, inputs = dae.columns()
    others = ca.vertcat(unknowns[dae.alg[0].numel() :], inputs, *(each.symbol for each in dae.p))
    limits = [each for each in dae.limits if not ca.depends_on(each.expression, others)]
    columns = ca.vertcat(ca.SX(0, 1), *(limit.expression for limit in limits))
    function = dae.function("limits", [x_symbols, unknowns], [ca.densify(columns)])
    messages = [NO_POSE] * x.shape[1]
    for k, values in enumerate(evaluate_at(function, x, z)[0].T):
        for limit, value in zip(limits, values, strict=True):
            if limit.violated_by(value, dae.size_of(limit.label)):
                words = limit.message(value, x[:, k], z[:, k])
                messages[k] = f"no pose was found: {words}; choose another place"
                break
    return messages


def start_states(graphs: Graphs, start: Mapping[str, Array]) -> Array:
    """Return states of a model at rest at given values by name, without positions.

    Raises ModelError if a name is unknown, a value is not finite, or shapes differ.
    """
    dae, rows = graphs.dae, graphs.rows
    dae.start(**{name: float(np.ravel(values)[0]) for name, values in start.items()})  # names
    sizes = {values.size for values in start.values()} - {1}
    if len(sizes) > 1 or any(values.ndim > 1 for values in start.values()):
        found = ", ".join(f"{name} {values.shape}" for name, values in start.items())
        raise ModelError(
            f"start: expected numbers or arrays of one shape (n,), found {found}; correct the "
            "shapes"
        )
    states = np.zeros((rows.t.stop, max(sizes, default=1)))
    for k, label in enumerate(leaves(dae.labels.x)):
        values = np.asarray(start.get(label.full, 0.0), dtype=float)
        check_finite(f"start[{label.full!r}]", values)
        states[k] = values - dae.shift[0][k]
    states[rows.c] = np.reshape([parameter.value for parameter in dae.p], (-1, 1))
    states[rows.stage] = np.reshape(graphs.stages[-1:], (-1, 1))
    return states


def states_of(graphs: Graphs, run: Trajectory) -> Array:
    """Return the state at the last sample of a motion of the model, shape (n_rows,)."""
    x, z, q = (graphs.dae.rows(record, run, -1) for record in "xzq")
    return assemble_state(graphs, x, z, q)


def assemble_state(graphs: Graphs, x: Array, z: Array, q: Array) -> Array:
    """Return a state, shape (n_rows,), from local states, unknowns and all quadratures."""
    rows, state = graphs.rows, start_states(graphs, {})[:, 0]
    state[rows.x], state[rows.q] = x, q[list(graphs.quadratures)]
    for part, block in zip(rows.z, graphs.dae.block_rows, strict=True):
        state[part] = z[block]
    return state


def lanes_at_once(graphs: Graphs, t: Array) -> int:
    """Return the largest number of lanes that are computed together."""
    return int(min(CHUNK, max(8, LARGEST // (graphs.rows.t.stop * t.size))))


def run_lanes(
    evaluate: Evaluator,
    states: Array,
    inputs: Array,
    t: Array,
    *,
    step: float | None = None,
    quantities: Sequence[str] | None = None,
    placed: bool = False,
) -> LaneResults:
    """Return the motions of lanes, with an outcome and a reason for each.

    The states (n_rows, n) at the start are those of `start_states` or, if ``placed``, have
    consistent positions; the inputs have the shape (n_u, m - 1, n). The largest length of a step is
    by default half the size of the vehicle, or half the trail of a caster [m]. ``quantities`` are
    the names of those to keep, by default all. ModelError is raised for unknown quantities.
    """
    graphs, states, n = evaluate.graphs, states.copy(), states.shape[1]
    sources = sources_of(graphs, quantities)
    if step is None:
        step = graphs.dae.size * (STEP if graphs.dae.lag is None else RELAXING_STEP)
        step = min(step, TRAIL_STEP * graphs.dae.vehicle.trail)
    has_pose = np.ones(n, dtype=bool) if placed else stand(evaluate, states).has_pose
    states[graphs.rows.p, ~has_pose] = np.nan
    motions = motion.integrate_lanes(evaluate, states, inputs, t, step)
    outcomes, reasons = ["complete"] * n, [""] * n
    disputed = has_pose & (motions.reason == motion.UNSOLVED)
    for k in np.flatnonzero(~has_pose):
        outcomes[k], reasons[k] = FAILED, NO_POSE
    codes = np.where(motions.reason < 0, motion.COMPLETE, motions.reason).astype(int)
    invalid = has_pose & (motions.reason == motion.INVALID_START)
    if invalid.any():
        distances = motions.distances[:, invalid]
        failed = motion.clearances(evaluate, motions.beyond[:, invalid]).argmin(axis=0)
        bounds = np.array([*graphs.bounds, 0])[motion.smallest(distances) if len(distances) else -1]
        is_inside = motion.margins(distances) >= 0
        codes[invalid] = np.where(is_inside, len(graphs.dae.limits) + failed, bounds)
    for k in np.flatnonzero(has_pose & (motions.reason == motion.TOO_FAST)):
        outcomes[k] = Outcome.SOLVER_FAILURE.name.lower()
        reasons[k] = (
            f"expected a motion of at most {motion.MAX_STEPS} steps of {step:.3g} m between two "
            "samples, found a faster one; correct the inputs, or give more times"
        )
    for lane, outcome, words in _ends(evaluate, codes, motions.beyond):
        outcomes[lane], reasons[lane] = outcome, words
        if invalid[lane]:
            outcomes[lane], reasons[lane] = FAILED, str(invalid_start(words))
    values = _values(evaluate, sources, motions.samples)
    columns = {name: Column(sources[name].label, each) for name, each in values.items()}
    for state, errors in zip(leaves(graphs.dae.labels.x), np.abs(motions.errors), strict=True):
        label = Label(f"error_{state.full}", state.unit, f"estimated error of: {state.words}")
        columns[label.name] = Column(label, errors)
    end = np.where(has_pose & (motions.reason != motion.INVALID_START), motions.end, np.nan)
    x, y, _ = graphs.places
    error = np.hypot(motions.errors[x], motions.errors[y])
    wheels = next((source.wheels for source in sources.values() if source.wheels), ())
    return LaneResults(columns, wheels, outcomes, reasons, end, error, disputed)


def _ends(evaluate: Evaluator, codes: Indices, states: Array) -> Iterator[tuple[int, str, str]]:
    """Yield the columns whose codes are not negative, with outcome and message.

    A code is the index of a violated limit or, after the limits, of a failed check.
    """
    dae, columns = evaluate.graphs.dae, np.flatnonzero(codes >= 0)
    x, z, _ = columns_of(evaluate.graphs, states)
    values = evaluate(evaluate.graphs.limits, states[:, columns])
    for k, code, row in zip(columns.tolist(), codes[columns], values.T, strict=True):
        if code >= len(dae.limits):
            words = dae.checks[code - len(dae.limits)].describe(x[:, k], z[:, k])
            yield k, Outcome.LIMIT.name.lower(), words
        else:
            limit = dae.limits[code]
            words = limit.message(float(row[code]), x[:, k], z[:, k])
            yield k, limit.outcome.name.lower(), words


def columns_of(graphs: Graphs, states: Array) -> tuple[Array, Array, Array]:
    """Return ``x``, ``z`` and ``u`` of states."""
    rows = graphs.rows
    return states[rows.x], np.concatenate([states[part] for part in rows.z]), states[rows.u]


def sources_of(graphs: Graphs, names: Sequence[str] | None) -> dict[str, Wanted]:
    """Return the sources of quantities; by default of all that a lane has.

    Raises ModelError if a name is unknown.
    """
    known = _known_sources(graphs.dae)
    names = list(dict.fromkeys(name.split("[")[0] for name in (known if names is None else names)))
    more = "(method='simulate' has limits, checks and work, too):"
    check_known("quantities", names, known, f"names of states, unknowns, inputs or outputs {more}")
    return {name: known[name] for name in names}


@lru_cache(maxsize=8)
def _known_sources(dae: Dae) -> dict[str, Wanted]:
    """Return the sources of all quantities of lanes; cached, since it takes milliseconds."""
    graphs = graphs_of(dae)
    rows = graphs.rows
    z_rows = [k for part in rows.z for k in range(part.start, part.stop)]
    q_labels = [list(leaves(dae.labels.q))[k] for k in graphs.quadratures]
    y, u = list(leaves(dae.labels.y)), list(leaves(dae.labels.u))
    groups: Any = (
        (leaves(dae.labels.x), range(rows.x.start, rows.x.stop), dae.shift[0], False),
        (leaves(dae.labels.z), z_rows, dae.shift[1], False),
        (q_labels, range(rows.q.start, rows.q.stop), np.zeros(len(q_labels)), False),
        (u, range(rows.u.start, rows.u.stop), np.zeros(len(u)), False),
        (y, range(len(y)), np.zeros(len(y)), True),
    )
    every: list[Any] = [
        (*each, is_output) for *group, is_output in groups for each in zip(*group, strict=True)
    ]
    known = dict[str, Wanted]()
    for name, (label, indices) in by_quantity(each[0] for each in every).items():
        labels, numbers, shift, (is_output, *_) = zip(*(every[k] for k in indices), strict=True)
        wheels = tuple(each.wheel for each in labels if each.wheel is not None)
        known[name] = Wanted(label, [*numbers], is_output, np.array(shift), wheels)
    return known


def _values(evaluate: Evaluator, sources: Mapping[str, Wanted], samples: Array) -> dict[str, Array]:
    """Return wanted quantities at samples, shape (m, n_rows, n), by name.

    The results have the shape (n, m) or, for quantities of wheels, (n, m, n_wheels).
    """
    outputs = samples
    if any(source.is_output for source in sources.values()):
        samples = np.ascontiguousarray(samples)
        for states in samples:  # while driving, forces are only as exact as limits need them
            motion.solve_forces(evaluate, states)
        outputs = np.stack([evaluate(evaluate.graphs.outputs, states) for states in samples])
    values = dict[str, Array]()
    for name, source in sources.items():
        rows = (outputs if source.is_output else samples)[:, source.rows]
        turned = (rows + source.shift[:, None]).transpose(2, 0, 1)
        values[name] = np.ascontiguousarray(turned if source.wheels else turned[..., 0])
    return values
