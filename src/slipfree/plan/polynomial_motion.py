"""Motions as polynomials: between programs, to samples, to files for a warm start."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from slipfree.core.dae import Dae
from slipfree.core.errors import DataError, ModelError
from slipfree.core.records import Array, leaves, with_overview
from slipfree.core.trajectory import Trajectory
from slipfree.plan.ipopt import NlpSolution
from slipfree.plan.transcription import (
    CollocationMesh,
    Index,
    Program,
    VariableLayout,
    completed,
    variable_layout,
)
from slipfree.solve.collocation import radau_basis
from slipfree.solve.sampling import Samples, complete_samples, to_trajectory
from slipfree.solve.system import solve_initial_conditions, with_inputs

SAME_STATE_DISTANCE = 1e-6  # largest distance of states that count as equal [m, rad]
FRACTION_TOLERANCE = 1e-12  # relative difference of times that count as equal
ARRAY_PREFIX = "plan_"  # prefix of the names of the arrays in a file


@with_overview
class PolynomialMotion(NamedTuple):
    """Motion as polynomials of time on the intervals of a mesh, in local coordinates."""

    mesh: CollocationMesh  # mesh of the polynomials
    layout: VariableLayout  # indices among the unknowns
    unknowns: Array  # shape (n_w,): unknowns of a program, not scaled

    @property
    def duration(self) -> float:
        """Duration of the motion in s."""
        return float(self.unknowns[self.layout.duration])

    @property
    def ends(self) -> Array:
        """Times of the ends of the intervals in s, shape (n + 1,)."""
        return self.mesh.ends * self.duration

    def states(self, at: Array) -> Array:
        """Return the states at fractions of the duration, shape (n_x, n_at)."""
        k, inside = self._where(at)
        values, layout = self.unknowns, self.layout
        inner = values[layout.states]
        first = np.concatenate([values[layout.first][None], inner[:-1, -1]])
        nodes = np.concatenate([first[:, None], inner], axis=1)
        weights = radau_basis(self.mesh.degree).values(inside, tied=True)
        return np.asarray(np.einsum("ij,ijx->xi", weights, nodes[k]))

    def algebraic(self, at: Array) -> Array:
        """Return the algebraic unknowns at fractions of the duration, shape (n_z, n_at)."""
        k, inside = self._where(at)
        weights = radau_basis(self.mesh.degree).values(inside, tied=False)
        return np.asarray(np.einsum("ij,ijz->zi", weights, self.unknowns[self.layout.unknowns][k]))

    def inputs(self, at: Array) -> Array:
        """Return the inputs at fractions of the duration, shape (n_u, n_at)."""
        k, inside = self._where(at)
        values = self.unknowns[self.layout.inputs]
        if not self.continuous:
            return np.asarray(values[k].T)
        return np.asarray((values[k] + inside[:, None] * (values[k + 1] - values[k])).T)

    @property
    def continuous(self) -> bool:
        """Whether inputs are continuous and linear on intervals; otherwise they are constant."""
        return len(self.layout.inputs) == self.mesh.ends.size

    def _where(self, at: Array) -> tuple[Index, Array]:
        """Return indices and positions on intervals, 0 to 1; their ends belong to them."""
        ends = self.mesh.ends
        k = np.searchsorted(ends[1:-1], at - FRACTION_TOLERANCE)
        return k, (at - ends[k]) / (ends[k + 1] - ends[k])


def motion_of(program: Program, unknowns: Array) -> PolynomialMotion:
    """Return the motion for unknowns of a program that are not scaled."""
    return PolynomialMotion(program.mesh, program.layout, unknowns)


def first_intervals(motion: PolynomialMotion, count: int) -> PolynomialMotion:
    """Return the part of a motion on its first ``count`` intervals."""
    mesh, old, values = motion.mesh, motion.layout, motion.unknowns
    n_u = old.inputs.shape[1]
    own = mesh._replace(ends=mesh.ends[: count + 1] / mesh.ends[count])
    sizes = old.first.size, old.unknowns.shape[2], n_u
    layout = variable_layout(own, sizes, continuous=motion.continuous)
    duration = mesh.ends[count] * motion.duration
    where = old.first, old.states[:count], old.unknowns[:count], old.inputs[: len(layout.inputs)]
    parts = (values[each] for each in where)
    return PolynomialMotion(own, layout, _filled(layout, layout.duration + 1, duration, *parts))


def _filled(layout: VariableLayout, size: int, duration: float, *parts: Array) -> Array:
    """Return the column of all unknowns, with roots of zero.

    The parts are the states at the beginning and at the points, the algebraic unknowns and the
    inputs.
    """
    values = np.zeros(size)
    places = layout.first, layout.states, layout.unknowns, layout.inputs
    for where, part in zip(places, parts, strict=True):
        values[where] = part
    values[layout.duration] = duration
    return values


def joined_motions(motions: Sequence[PolynomialMotion]) -> PolynomialMotion:
    """Return consecutive motions of one model as one; junctions have the earlier one's values."""
    times = np.cumsum([0.0, *(each.duration for each in motions)])
    ends = [t + each.ends[1:] for t, each in zip(times, motions, strict=False)]
    mesh = CollocationMesh(np.concatenate([[0.0], *ends]) / times[-1], motions[0].mesh.degree)
    first = motions[0].layout
    sizes = first.first.size, first.unknowns.shape[2], first.inputs.shape[1]
    layout = variable_layout(mesh, sizes, continuous=motions[0].continuous)
    states, unknowns = (
        np.concatenate([each.unknowns[getattr(each.layout, name)] for each in motions])
        for name in ("states", "unknowns")
    )
    skipped = int(motions[0].continuous)  # inputs at a junction belong to both motions
    inputs = [each.unknowns[each.layout.inputs[skipped:]] for each in motions]
    start = motions[0].unknowns[first.inputs[:skipped]]
    parts = motions[0].unknowns[first.first], states, unknowns, np.concatenate([start, *inputs])
    values = _filled(layout, layout.duration + 1, times[-1], *parts)
    return PolynomialMotion(mesh, layout, values)


def transfer_motion(former: PolynomialMotion, program: Program, after: float = 0.0) -> Array:
    """Return unknowns of a program, sampled from the part of another's motion after a fraction.

    Algebraic unknowns that the motion lacks are computed from the equations of the model.
    """
    task, need = program.task, program.layout.unknowns.shape[2]
    nodes = after + (1 - after) * program.mesh.nodes
    x, u, z = former.states(nodes), former.inputs(nodes), former.algebraic(nodes)
    if len(z) < need:
        t = nodes * former.duration
        full = np.full((task.dae.scale.size, t.size), np.nan)
        full[: len(z)] = z
        samples = Samples(t, x, full, np.zeros((0, t.size)), u)
        z = complete_samples(numeric_system(program), samples)[0].z
    inputs = former.inputs(after + (1 - after) * input_fractions(program))
    unknowns = unknowns_of(program, x, z, inputs, (1 - after) * former.duration)
    return completed(program, _within_task(program, unknowns))


def input_fractions(program: Program) -> Array:
    """Return the fractions of the duration to which the inputs of a program belong."""
    ends = program.mesh.ends
    is_continuous = len(program.layout.inputs) == ends.size
    return ends if is_continuous else (ends[1:] + ends[:-1]) / 2


def unknowns_of(program: Program, x: Array, z: Array, u: Array, duration: float) -> Array:
    """Return unknowns for states and algebraic unknowns at the nodes, inputs and duration [s]."""
    layout = program.layout
    states = x[:, 1:].T.reshape(layout.states.shape)
    unknowns = z[: layout.unknowns.shape[2], 1:].T.reshape(layout.unknowns.shape)
    return _filled(layout, program.scale.size, duration, x[:, 0], states, unknowns, u.T)


def _within_task(program: Program, unknowns: Array) -> Array:
    """Set the start of the task, and clip inputs and duration to their bounds."""
    task, layout = program.task, program.layout
    unknowns[layout.first] = task.start
    unknowns[layout.inputs] = np.clip(unknowns[layout.inputs], *task.inputs.T)
    unknowns[layout.duration] = np.clip(unknowns[layout.duration], *task.duration)
    return unknowns


def nearest_fraction(former: PolynomialMotion, start: Array) -> float:
    """Return the fraction of the duration at which a motion is nearest to a state."""
    nodes = former.mesh.nodes
    away = np.linalg.norm(former.states(nodes) - start[:, None], axis=0)
    if away[0] < SAME_STATE_DISTANCE:  # also if a closed path passes its start again
        return 0.0
    return float(nodes[away[:-1].argmin()])  # nothing of the motion would follow its last node


def numeric_system(program: Program) -> Any:
    """Return the model of a program as a `System` under numeric inputs."""
    dae = program.task.dae
    return with_inputs(dae, dae.zero_inputs, 0, program.options)


def guess_unknowns(program: Program, guess: Trajectory) -> Array:
    """Return unknowns of a program from a guess, scaled to the duration and clipped to bounds."""
    dae, mesh, layout = program.task.dae, program.mesh, program.layout

    def at(record: str, count: int, fractions: Array) -> Array:
        labels = list(leaves(getattr(dae.labels, record)))[:count]
        t = guess.t[0] + fractions * (guess.t[-1] - guess.t[0])
        return np.array([np.interp(t, guess.t, guess.of(label)) for label in labels])

    n_z = layout.unknowns.shape[2]
    x, z = at("x", layout.first.size, mesh.nodes), at("z", n_z, mesh.nodes)
    x, z = x - dae.shift[0][:, None], z - dae.shift[1][:n_z, None]
    n_u = layout.inputs.shape[1]
    if len(layout.inputs) == mesh.ends.size:
        u = at("u", n_u, mesh.ends)
    else:
        u = at("u", n_u, mesh.nodes)[:, 1:].reshape(n_u, -1, mesh.degree).mean(axis=2)
    return _within_task(program, unknowns_of(program, x, z, u, guess.t[-1] - guess.t[0]))


def mesh_along(
    mesh: CollocationMesh, fractions: Array, x: Array, accuracy: float
) -> CollocationMesh:
    """Return a mesh on which polynomials through states, shape (n_x, n), are close to all of them.

    Intervals of ``mesh`` are halved until no state at the ``fractions`` of the duration differs by
    more than ``accuracy``.
    """
    while True:
        ends, degree = mesh.ends, mesh.degree
        k = np.clip(np.searchsorted(ends, fractions - FRACTION_TOLERANCE) - 1, 0, None)
        inside = (fractions - ends[k]) / np.diff(ends)[k]
        weights = radau_basis(degree).values(inside, tied=True)
        nodes = np.array([np.interp(mesh.nodes, fractions, row) for row in x])
        values = nodes[:, degree * k[:, None] + np.arange(degree + 1)]
        apart = np.abs((weights * values).sum(axis=2) - x).max(axis=0) > accuracy
        if not apart.any():
            return mesh
        mesh = mesh._replace(ends=np.union1d(ends, (ends[k] + ends[k + 1])[apart] / 2))


def sample_plan(program: Program, unknowns: Array) -> Trajectory:
    """Return the motion of a program, sampled at the beginning and all collocation points."""
    motion, system = motion_of(program, unknowns), numeric_system(program)
    nodes, n_z = program.mesh.nodes, program.layout.unknowns.shape[2]
    inner = unknowns[program.layout.unknowns].reshape(-1, n_z).T
    z = np.full((program.task.dae.scale.size, nodes.size), np.nan)
    z[:n_z] = np.column_stack([inner[:, :1], inner])
    x, u = motion.states(nodes), motion.inputs(nodes)
    t = nodes * motion.duration
    # The program has no unknowns at the beginning; without a solution, the next point's are kept.
    with suppress(ModelError):
        z[:, 0] = solve_initial_conditions(system, 0.0, x[:, 0], z[:, 1], u[:, 0])
    try:
        watch = system.watch.map(t.size)
        rates = np.array(watch(t[None], x, z[: system.motion_size], u)[0])[:, 1:]
    except RuntimeError:  # for a failed iterate, forces may have no solution
        rates = np.full((program.task.dae.quad.numel(), t.size - 1), np.nan)
    q = _integrate(rates.reshape(len(rates), -1, program.mesh.degree), np.diff(motion.ends))
    samples, report = complete_samples(system, Samples(t, x, z, q, u))
    return to_trajectory(system, samples, report)


def _integrate(rates: Array, lengths: Array) -> Array:
    """Return integrals from the beginning to all collocation points, shape (n_q, 1 + n degree)."""
    count, degree = rates.shape[1:]
    inside = radau_basis(degree).integrals(radau_basis(degree).points)
    gains = np.einsum("pj,qij->qip", inside, rates) * lengths[:, None]
    before = np.cumsum(gains[:, :, -1], axis=1) - gains[:, :, -1]
    total = (gains + before[:, :, None]).reshape(len(rates), count * degree)
    return np.column_stack([np.zeros(len(rates)), total])


@with_overview
class SavedPlan(NamedTuple):
    """Arrays of a plan, for a warm start of another plan.

    Attributes
    ----------
    ends : ndarray, shape (n + 1,)
        Ends of the intervals, as fractions of the duration.
    sizes : ndarray, shape (5,)
        Degree; numbers of states, algebraic unknowns and inputs; 1 if inputs are continuous,
        otherwise 0.
    unknowns : ndarray, shape (n_w,)
        Unknowns, not scaled, in local coordinates.
    bound_multipliers : ndarray, shape (n_w,)
        Multipliers of the bounds of the scaled unknowns; empty if not known.
    row_multipliers : ndarray, shape (n_g,)
        Multipliers of the rows; empty if not known.
    shift : ndarray, shape (n_x + n_z,)
        Map coordinates minus local coordinates of the states and algebraic unknowns.
    model : ndarray, shape (1,)
        CRC-32 of the names of the states, algebraic unknowns and inputs.
    """

    ends: Array
    sizes: Array
    unknowns: Array
    bound_multipliers: Array
    row_multipliers: Array
    shift: Array
    model: Array

    @property
    def motion(self) -> PolynomialMotion:
        """Motion of the plan, in the local coordinates of its model."""
        degree, n_x, n_z, n_u, continuous = (int(value) for value in self.sizes)
        mesh = CollocationMesh(self.ends, degree)
        layout = variable_layout(mesh, (n_x, n_z, n_u), continuous=bool(continuous))
        return PolynomialMotion(mesh, layout, self.unknowns)

    @property
    def arrays(self) -> dict[str, Array]:
        """Arrays to write to a file, by name; files have no empty arrays."""
        return {
            f"{ARRAY_PREFIX}{name}": value for name, value in self._asdict().items() if value.size
        }


def save_plan(program: Program, solution: NlpSolution) -> SavedPlan:
    """Return the arrays of a solution for a later warm start."""
    motion = motion_of(program, solution.unknowns)
    return save_motion(motion, program.task.dae)._replace(
        bound_multipliers=solution.bound_multipliers, row_multipliers=solution.row_multipliers
    )


def save_motion(motion: PolynomialMotion, dae: Dae) -> SavedPlan:
    """Return the arrays of a motion of a model, without multipliers."""
    layout = motion.layout
    sizes = [
        motion.mesh.degree,
        layout.first.size,
        layout.unknowns.shape[2],
        layout.inputs.shape[1],
        motion.continuous,
    ]
    return SavedPlan(
        motion.mesh.ends,
        np.array(sizes, dtype=float),
        motion.unknowns,
        np.zeros(0),
        np.zeros(0),
        np.concatenate(dae.shift),
        _model_number(dae),
    )


def _model_number(dae: Dae) -> Array:
    names = " ".join(
        label.full for part in (dae.labels.x, dae.labels.z, dae.labels.u) for label in leaves(part)
    )
    return np.array([float(zlib.crc32(names.encode()))])


def local_motion(former: SavedPlan, dae: Dae) -> PolynomialMotion:
    """Return a saved motion in the local coordinates of a model, which must be the same."""
    if not np.array_equal(former.model, _model_number(dae)):
        raise ModelError(
            "plan: expected a saved plan with the states, unknowns and inputs of this model, found "
            "others (of another vehicle, model or law); restore the vehicle, model and law of the "
            "saved plan, or plan without the saved plan"
        )
    motion, away = former.motion, former.shift - np.concatenate(dae.shift)
    unknowns, layout, n_x = motion.unknowns.copy(), motion.layout, dae.shift[0].size
    unknowns[layout.first] += away[:n_x]
    unknowns[layout.states] += away[:n_x]
    unknowns[layout.unknowns] += away[n_x : n_x + layout.unknowns.shape[2]]
    return motion._replace(unknowns=unknowns)


def from_arrays(arrays: Mapping[str, Array], where: str) -> SavedPlan:
    """Return the saved plan in the arrays of a file; ``where`` names the file in error messages."""
    multipliers = {"bound_multipliers", "row_multipliers"}
    fields = {name: arrays.get(f"{ARRAY_PREFIX}{name}") for name in SavedPlan._fields}
    if any(value is None for name, value in fields.items() if name not in multipliers):
        raise DataError(
            f"{where}: expected the result of a plan, found no plan in it; give a file that "
            'slipfree run wrote for a problem with verb = "plan"'
        )
    saved = SavedPlan(*(np.zeros(0) if value is None else value for value in fields.values()))
    if not _is_consistent(saved):
        raise DataError(
            f"{where}: expected the arrays of one plan, found sizes or values that contradict each "
            "other: the file is damaged; use another result, or plan without it"
        )
    return saved


def _is_consistent(saved: SavedPlan) -> bool:
    """Return whether the arrays of a file are finite and have the sizes of one plan."""
    known = [*saved[:3], *saved[5:]]
    if not all(value.ndim == 1 and np.isfinite(value).all() for value in known):
        return False
    sizes = saved.sizes.tolist()
    if len(sizes) != 5 or any(size < 0 or size != round(size) for size in sizes):
        return False
    degree, n_x, n_z, n_u, continuous = sizes
    count, ends = saved.ends.size - 1, saved.ends
    block = n_u + degree * (n_x + n_z)
    return (
        min(degree, n_x, count) > 0
        and continuous <= 1
        and bool((ends[0], ends[-1]) == (0, 1) and (np.diff(ends) > 0).all())
        and saved.unknowns.size > n_x + block * count + n_u * continuous
        and saved.shift.size >= n_x + n_z
        and saved.model.size == 1
    )
