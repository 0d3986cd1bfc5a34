"""Why there is no plan: bounds that conflict, what a failed search violates, and what must give."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import scipy.sparse

from slipfree.dae import Limit
from slipfree.named import Array, Label, leaves
from slipfree.plan.solver import Solution, solve
from slipfree.plan.transcribe import Index, Piece, Place, Program, Task
from slipfree.trajectory import Trajectory

WITHIN = 1e-6  # violation that is rounding, in the unit of what is violated
ROUNDING = 1e-9  # by which bounds may miss each other, in their unit
REGULAR = 1e-4  # part of the cost that decides between relaxations of equal size
ITERATIONS = 200  # of the search for a relaxation
WORST = 5  # violations that an explanation names
SHARE = 0.05  # of what gives, by which a bound matters: relaxing it by one would save as much
EQUATION, LIMIT, INPUT, GOAL, WAY_POINT = "equation", "limit", "input", "goal", "way-point"
DURATION = "duration"
SIDES = {1.0: "at least", -1.0: "at most"}  # by the sign of what is missing
MODEL = "model"  # the role of the model's own limits, before they are in the program
REMEDIES = {
    "start": "start elsewhere",
    LIMIT: "widen the limit",
    INPUT: "widen the bounds of the input",
    GOAL: "move the goal",
    WAY_POINT: "move the way-point",
    MODEL: "change the model",
}
STATUS = {  # what IPOPT's words mean for a plan
    "Solve_Succeeded": "the plan is solved",
    "Solved_To_Acceptable_Level": "the plan is solved, to a lesser accuracy",
    "Infeasible_Problem_Detected": "the constraints contradict each other where the search ended",
    "Restoration_Failed": "the search found no way back to the constraints",
    "Maximum_Iterations_Exceeded": "the search did not end within its iterations",
    "Maximum_CpuTime_Exceeded": "the search did not end within its time",
    "Maximum_WallTime_Exceeded": "the search did not end within its time",
    "User_Requested_Stop": "the search was stopped",
    "Diverging_Iterates": "the search ran away: something that pays has no bound",
    "Search_Direction_Becomes_Too_Small": "the search made no more progress",
    "Error_In_Step_Computation": "the search found no next step",
    "Not_Enough_Degrees_Of_Freedom": "there are more equations than unknowns",
    "Invalid_Number_Detected": "a function of the model has no value where the search looked",
}


class Violation(NamedTuple):
    """The worst place at which a constraint does not hold.

    Attributes
    ----------
    label : Label
        What is constrained, with its wheel.
    t : float
        When. [s]
    interval : int
        On which interval of the mesh.
    size : float
        By how much, in the label's unit.
    bound, value : float
        The bound, and what was found, in the label's unit and in map coordinates.
    role : str
        ``"equation"``, ``"limit"``, ``"input"``, ``"goal"``, or ``"way-point at 0.5"``.
    """

    label: Label
    t: float
    interval: int
    size: float
    bound: float
    value: float
    role: str


class Held(NamedTuple):
    """A bound that did not give and stands against those that did.

    Attributes
    ----------
    label, role : Label, str
        As in `Violation`; ``"duration"`` is a role as well.
    bound : float
        In the label's unit and in map coordinates.
    side : str
        ``"at least"`` or ``"at most"``; empty for what is to be equal.
    share : float
        By how much less the others would give, relative to their sizes, for each unit of its own
        size by which it were moved.
    """

    label: Label
    role: str
    bound: float
    side: str
    share: float


class Relaxation(NamedTuple):
    """What had to give so that the equations of motion have a solution.

    Attributes
    ----------
    solution : ndarray, shape (n_w,)
        Unknowns that satisfy the equations, and all bounds but the relaxed ones.
    relaxed : list of Violation
        Each bound that gave, by how much, and where first by so much.
    held : list of Held
        The bounds against which they gave, the most important first.
    success : bool
        Whether the search for it ended.
    status : str
        IPOPT's words.
    """

    solution: Array
    relaxed: list[Violation]
    held: list[Held]
    success: bool
    status: str


class _Bounds(NamedTuple):
    """What is asked for before there is a program: ``lower <= expression <= upper``.

    ``fraction`` of the duration is the time at which, nan for all along the way; ``shift`` leads to
    map coordinates.
    """

    label: Label
    role: str
    expression: ca.SX
    lower: float
    upper: float
    shift: float
    fraction: float


class _Group(NamedTuple):
    """Places of a program at which one constraint stands.

    Attributes
    ----------
    label, role : Label, str
        As in `Violation`.
    where : ndarray, shape (n,)
        Positions in the column of all rows, then all unknowns.
    intervals, parts : ndarray, shape (n,)
        Of the mesh, and fractions of the duration.
    lower, upper : float
        Bounds.
    shift : float
        What leads to map coordinates.
    typical : float
        Size of an equation's terms; zero elsewhere.
    """

    label: Label
    role: str
    where: Index
    intervals: Index
    parts: Array
    lower: float
    upper: float
    shift: float
    typical: float = 0.0


def conflicts(task: Task, start: Trajectory | None) -> list[str]:
    """Return what makes a plan impossible by itself, one sentence each; none if nothing does.

    Parameters
    ----------
    task : Task
        The problem.
    start : Trajectory or None
        Its last sample is where the plan begins; without it only what depends on nothing but states
        is compared to the start.
    """
    asked = list(_asked(task))
    along = [bounds for bounds in asked if np.isnan(bounds.fraction)]
    begin = np.full(len(task.dae.scale), np.nan) if start is None else task.dae.rows("z", start, -1)
    found = [*_crossed(task), *_outside(task, along, "start", np.append(task.start, begin))]
    for place in task.places:
        formulas = [bounds for bounds in along if _plain(task, bounds.expression) is None]
        found += _outside(task, formulas, _role(place.fraction), _known(task, place))
    for one, other in combinations(asked, 2):
        apart = max(one.lower - other.upper, other.lower - one.upper)
        together = np.isnan([one.fraction, other.fraction]).any() or one.fraction == other.fraction
        if apart > ROUNDING and together and ca.is_equal(one.expression, other.expression):
            remedies = dict.fromkeys([_remedy(one.role), _remedy(other.role)])
            found.append(f"{_must(one)}, but {_must(other)}: {' or '.join(remedies)}")
    return found


def _asked(task: Task) -> Iterator[_Bounds]:
    """Yield all bounds but those on rates of inputs, goal and way-points first."""
    for place in task.places:
        for limit in place.limits:
            yield _bounds(task, limit, _role(place.fraction), place.fraction)
    for limit in task.limits:
        yield _bounds(task, limit, LIMIT)
    for limit in task.dae.limits:
        if not any(ca.is_equal(limit.expression, own.expression) and limit.label == own.label
                   for own in task.limits):  # fmt: skip
            yield _bounds(task, limit, MODEL)
    for label, u, (low, high) in zip(
        leaves(task.dae.labels.u), leaves(task.dae.u), task.inputs, strict=True
    ):
        yield _bounds(task, Limit(label, u, low, high), INPUT)


def _bounds(task: Task, limit: Limit, role: str, fraction: float = np.nan) -> _Bounds:
    shift = _shift(task, limit.expression)
    return _Bounds(_plainly(limit.label), role, limit.expression, limit.lower, limit.upper, shift,
                   fraction)  # fmt: skip


def _crossed(task: Task) -> Iterator[str]:
    """Yield what is wrong with the bounds of inputs and of their rates by themselves."""
    for k, label in enumerate(leaves(task.dae.labels.u)):
        rate = _rate(label)
        for own, (low, high) in ((label, task.inputs[k]), (rate, task.accelerations[k])):
            if not low <= high:
                yield (f"{_subject(own, INPUT)} must be at least {_number(own, low)} and at most "
                       f"{_number(own, high)}: exchange its bounds")  # fmt: skip
        low, high = task.accelerations[k]
        if low <= high and not low <= 0 <= high:
            yield (f"{_subject(rate, INPUT)} must be {_range(rate, low, high)}, but an input does "
                   "not change on the last interval: let the bounds include 0")  # fmt: skip


def _known(task: Task, place: Place) -> Array:
    """Return the states and unknowns that a place says, nan for the others, shape (n_x + n_z,)."""
    n_x, n_z = task.start.size, task.dae.scale.size
    known = np.full(n_x + n_z, np.nan)
    for limit in place.limits:
        plain = _plain(task, limit.expression)
        if plain is not None and limit.lower == limit.upper:
            known[plain[1] + (n_x if plain[0] == "z" else 0)] = limit.lower
    return known


def _outside(task: Task, along: list[_Bounds], role: str, known: Array) -> Iterator[str]:
    """Yield which bounds along the way do not hold with the states and unknowns of a place."""
    x, z, u = task.dae.columns()
    xz = ca.vertcat(x, z)
    unknown = ca.vertcat(task.dae.t, u, xz[np.flatnonzero(np.isnan(known)).tolist()])
    for bounds in along:
        if ca.depends_on(bounds.expression, unknown):
            continue
        # What is not known is not in the expression either, but must be a number.
        here = ca.Function("here", [xz, u, task.dae.t], [bounds.expression])
        value = float(here(np.nan_to_num(known), 0.0, 0.0))
        if max(bounds.lower - value, value - bounds.upper) > WITHIN:
            plain = _plain(task, bounds.expression) is not None
            what = "" if plain else f" ({bounds.label.words})"
            yield (f"{_must(bounds)}, but the {role} has "
                   f"{_number(bounds.label, value + bounds.shift)}{what}: {_remedy(role)} or "
                   f"{_remedy(bounds.role)}")  # fmt: skip


def _must(bounds: _Bounds) -> str:
    low, high = bounds.lower + bounds.shift, bounds.upper + bounds.shift
    return f"{_subject(bounds.label, bounds.role)} must be {_range(bounds.label, low, high)}"


def _remedy(role: str) -> str:
    return REMEDIES[role.split(" ")[0]]


def violations(program: Program, solution: Solution, tolerance: float = WITHIN) -> list[Violation]:
    """Return the worst place of every constraint that does not hold, the worst constraint first.

    They are in the order of their size relative to the range of their bounds or to what else is
    typical.

    Parameters
    ----------
    program : Program
        From `transcribe`.
    solution : Solution
        Where its iteration ended.
    tolerance : float
        Violation that counts as none, in the unit of what is violated.
    """
    worst: dict[tuple[str, str], tuple[float, Violation]] = {}
    values = np.concatenate([solution.rows, solution.unknowns])
    for size, violation in _violated(program, values, tolerance):
        key = violation.role, violation.label.full
        if key not in worst or size > worst[key][0]:
            worst[key] = size, violation
    return [each for _, each in sorted(worst.values(), key=lambda pair: -pair[0])]


def words(violation: Violation) -> str:
    """Return a violation as a sentence."""
    label, role, at = violation.label, violation.role, f"at t = {violation.t:.4g} s"
    size = _number(label, violation.size)
    if role == EQUATION:
        return f"{_subject(label, role)} is not met by {size} {at}"
    side = "below" if violation.value < violation.bound else "above"
    return f"{_subject(label, role)} is {size} {side} {_number(label, violation.bound)} {at}"


def explanation(program: Program, solution: Solution, first: Array) -> str:
    """Return lines that say how a search ended, what it violates, and what had to give.

    Parameters
    ----------
    program : Program
        From `transcribe`.
    solution : Solution
        Where its iteration ended.
    first : ndarray, shape (n_w,)
        Where it began, not scaled.
    """
    meant = STATUS.get(solution.status, "the search ended")
    lines = [f"{meant} ({solution.status}, after {solution.iterations} iterations)"]
    found = violations(program, solution)
    if found:
        lines.append(f"violated most there, of {len(found)} constraints:")
        lines += [f"  {words(each)}" for each in found[:WORST]]
    # Who stopped a search does not wait for another.
    if not solution.success and solution.status != "User_Requested_Stop":
        lines += _relaxed_words(relax(program, first))
    return "\n".join(lines)


def _relaxed_words(relaxation: Relaxation) -> list[str]:
    if not relaxation.success:
        meant = STATUS.get(relaxation.status, "it ended")
        return [f"what had to give was not found: {meant} ({relaxation.status}) even with all "
                "bounds but the start and the duration given up; try another guess"]  # fmt: skip
    if not relaxation.relaxed:
        return ["nothing has to give: a motion that keeps to all constraints was found without the "
                "costs; try it as a guess, or more iterations"]  # fmt: skip
    lines = ["a motion was found that gives up (one set that suffices; others may):"]
    for each in relaxation.relaxed:
        given, needed = (_number(each.label, value) for value in (each.bound, each.value))
        lines.append(f"  {_subject(each.label, each.role)}: {needed} instead of {given} "
                     f"at t = {each.t:.4g} s")  # fmt: skip
    if relaxation.held:
        lines.append("because these hold; if one of them gives, less of the above must:")
    for held in relaxation.held:
        bound = f"{held.side} {_number(held.label, held.bound)}".lstrip()
        lines.append(f"  {_subject(held.label, held.role)}: {bound}")
    return lines


def relax(program: Program, first: Array, iterations: int = ITERATIONS) -> Relaxation:
    """Return a motion that gives up as little as possible of what is asked for.

    Equations, start and duration hold. Every other bound may move by a slack of its own, the same
    at all times, and the sum of the slacks, relative to the sizes of what they move, is least; this
    leaves few that are not zero. It is a minimum near the first guess: others may be lower.

    Parameters
    ----------
    program : Program
        From `transcribe`.
    first : ndarray, shape (n_w,)
        First guess, not scaled.
    iterations : int
        Most iterations.
    """
    weights = np.array([*(cost.weight for cost in program.task.costs), program.task.smooth])
    values = np.append(_rows(program, first, weights), first)
    soft = [(group, sign) for group in _groups(program) if group.role != EQUATION
            for sign in (1.0, -1.0) if np.isfinite(_side(group, sign))]  # fmt: skip
    sizes = np.array([_size(group, values) for group, _ in soft])
    over = [(sign * (_side(group, sign) - values[group.where])).max(initial=0.0)
            for group, sign in soft]  # fmt: skip
    elastic = _elastic(program, soft, sizes, first, weights)
    found = solve(elastic, weights, np.append(first, over), iterations=iterations)
    unknowns = found.unknowns[: first.size]
    values = np.append(_rows(program, unknowns, weights), unknowns)
    relaxed = sorted(_violated(program, values, WITHIN), key=lambda pair: -pair[0])
    gave = {(each.role, each.label.full) for _, each in relaxed}
    held = [each for each in _held(program, soft, found)
            if each.share > SHARE and (each.role, each.label.full) not in gave]  # fmt: skip
    return Relaxation(unknowns, [each for _, each in relaxed],
                      sorted(held, key=lambda each: -each.share) if relaxed else [],
                      found.success, found.status)  # fmt: skip


def _held(program: Program, soft: list[tuple[_Group, float]], found: Solution) -> Iterator[Held]:
    """Yield what every bound of an elastic program costs, from its multipliers."""
    counts = [group.where.size for group, _ in soft]
    prices = found.row_multipliers[found.rows.size - sum(counts) :]
    parts = np.split(prices, np.cumsum(counts)[:-1])
    for k, (group, sign) in enumerate(soft):
        equal, price, side = group.lower == group.upper, parts[k], SIDES[sign]
        if equal and sign < 0:
            continue
        if equal:
            # The two bounds of an equation push against each other: what is left counts.
            price, side = price + parts[k + 1], ""
        share = float(np.abs(price).sum())
        yield Held(group.label, group.role, _side(group, sign) + group.shift, side, share)
    at = program.layout.duration
    cost, duration = float(found.bound_multipliers[at]), float(found.unknowns[at])
    label = Label(DURATION, "s", "duration of the plan")
    # Multipliers of upper bounds are positive.
    yield Held(label, DURATION, duration, SIDES[-np.sign(cost) or 1.0], abs(cost) * duration)


def _elastic(
    program: Program, soft: list[tuple[_Group, float]], sizes: Array, first: Array, weights: Array
) -> Program:
    """Return the program with a slack behind its unknowns for each bound, of the sizes given."""
    hard = np.concatenate([group.where for group in _groups(program) if group.role == EQUATION])
    rows = np.concatenate([hard, *(group.where for group, _ in soft)])
    counts = [group.where.size for group, _ in soft]
    which = np.repeat(np.arange(len(soft)), counts)
    own = hard.size + np.arange(which.size)
    signs, sides = (np.array(part)[which] for part in zip(
        *((sign, _side(group, sign)) for group, sign in soft), strict=True))  # fmt: skip
    n_all = program.g_lower.size + program.scale.size
    pick = _sparse(np.ones(rows.size), np.arange(rows.size), rows, (rows.size, n_all))
    move = _sparse(signs * sizes[which], own, which, (rows.size, len(soft)))
    problem, jacobian, hessian = _problem(program, pick, move, first, weights)
    lower, upper = (_fixed(program, side, free) for side, free in
                    ((program.lower, -np.inf), (program.upper, np.inf)))  # fmt: skip
    zeros = np.zeros(hard.size)
    return replace(
        program, problem=problem, jacobian=jacobian, hessian=hessian,
        scale=np.append(program.scale, sizes),
        lower=np.append(lower, np.zeros(len(soft))),
        upper=np.append(upper, np.full(len(soft), np.inf)),
        g_lower=np.append(zeros, np.where(signs > 0, sides, -np.inf)),
        g_upper=np.append(zeros, np.where(signs > 0, np.inf, sides)),
    )  # fmt: skip


def _problem(
    program: Program, pick: ca.DM, move: ca.DM, first: Array, weights: Array
) -> tuple[dict[str, Any], ca.Function, ca.Function]:
    """Return what is solved, with the derivatives of the program reused.

    Rows are ``pick (rows, unknowns) + move slacks``.
    """
    n_w, n_g, n_s = program.scale.size, program.g_lower.size, move.shape[1]
    x, p = ca.MX.sym("x", n_w + n_s), program.problem["p"]
    w, s = x[:n_w], x[n_w:]
    cost = ca.Function("cost", [program.problem[name] for name in "xp"],
                       [program.problem[name] for name in "fg"])  # fmt: skip
    part = REGULAR / max(1.0, abs(float(cost(first / program.scale, weights)[0])))
    f, g = cost(w, p)
    rows = pick @ ca.vertcat(g, w * program.scale) + move @ s
    inner = program.jacobian(w, p)[1]
    slopes = pick @ ca.vertcat(inner, ca.MX(ca.diag(ca.DM(program.scale))))
    sigma, multipliers = ca.MX.sym("sigma"), ca.MX.sym("lambda", rows.numel())
    curved = program.hessian(w, p, sigma * part, pick[:, :n_g].T @ multipliers)
    return (
        {"x": x, "p": p, "f": ca.sum1(s) + part * f, "g": rows},
        ca.Function("jacobian", [x, p], [rows, ca.horzcat(slopes, ca.MX(move))]),
        ca.Function("hessian", [x, p, sigma, multipliers],
                    [ca.diagcat(curved, ca.MX(n_s, n_s))]),
    )  # fmt: skip


def _fixed(program: Program, bounds: Array, free: float) -> Array:
    """Return bounds of the unknowns of which only those of start and duration are left."""
    kept = np.full(bounds.size, free)
    for where in (program.layout.first, program.layout.duration):
        kept[where] = bounds[where]
    return kept


def _sparse(values: Array, rows: Index, columns: Index, shape: tuple[int, int]) -> ca.DM:
    matrix = scipy.sparse.csc_matrix((values, (rows, columns)), shape)
    starts, inside = matrix.indptr.tolist(), matrix.indices.tolist()
    return ca.DM(ca.Sparsity(*shape, starts, inside), matrix.data)


def _rows(program: Program, unknowns: Array, weights: Array) -> Array:
    """Return the values of all rows, shape (n_g,)."""
    return np.array(program.jacobian(unknowns / program.scale, weights)[0]).ravel()


def _groups(program: Program) -> Iterator[_Group]:
    """Yield the constraints of a program, each with all its places."""
    task, mesh, layout = program.task, program.mesh, program.layout
    n_g, count = program.g_lower.size, len(layout.inputs)
    yield from _along(program, program.pieces[0])
    begin = count * len(program.pieces[0].labels)
    for place, piece in zip(task.places, program.pieces[1:], strict=True):
        k = int(np.flatnonzero(np.isin(layout.states[:, -1, 0], piece.where))[0])
        for r, limit in enumerate(place.limits):
            yield _Group(_plainly(limit.label), _role(place.fraction), np.array([begin + r]),
                         np.array([k]), mesh.ends[[k + 1]], limit.lower, limit.upper,
                         _shift(task, limit.expression))  # fmt: skip
        begin += len(piece.labels)
    intervals, parts = np.repeat(np.arange(count), mesh.degree), mesh.nodes[1:]
    for limit in task.limits:
        plain = _plain(task, limit.expression)
        if plain is not None:
            record, k = plain
            where = (layout.states if record == "x" else layout.unknowns)[:, :, k].ravel()
            yield _Group(_plainly(limit.label), LIMIT, n_g + where, intervals, parts, limit.lower,
                         limit.upper, _shift(task, limit.expression))  # fmt: skip
    for k, label in enumerate(leaves(task.dae.labels.u)):
        low, high = task.inputs[k]
        yield _Group(label, INPUT, n_g + layout.inputs[:, k], np.arange(count), mesh.ends[:-1],
                     low, high, 0.0)  # fmt: skip


def _along(program: Program, piece: Piece) -> Iterator[_Group]:
    """Yield the constraints among the rows of the intervals."""
    task, mesh = program.task, program.mesh
    each, every = len(piece.labels), np.arange(len(piece.where))
    rates = int(np.isfinite(task.accelerations).any(axis=1).sum())
    size = (each - rates) // mesh.degree
    limits = [limit for limit in task.limits if _plain(task, limit.expression) is None]
    intervals, parts = np.repeat(every, mesh.degree), mesh.nodes[1:]
    points = each * every[:, None] + size * np.arange(mesh.degree)
    typical = np.append(np.ones(program.layout.first.size), task.dae.scale)
    for r in range(size):
        where, limit = (points + r).ravel(), r - (size - len(limits))
        label, role = piece.labels[r], EQUATION if limit < 0 else LIMIT
        shift = 0.0 if limit < 0 else _shift(task, limits[limit].expression)
        yield _Group(_plainly(label), role, where, intervals, parts, piece.lower[r],
                     piece.upper[r], shift, typical[r] if limit < 0 else 0.0)  # fmt: skip
    for r in range(each - rates, each):
        label = replace(piece.labels[r], wheel=None)
        yield _Group(label, INPUT, each * every + r, every, mesh.ends[1:], piece.lower[r],
                     piece.upper[r], 0.0)  # fmt: skip


def _violated(
    program: Program, values: Array, tolerance: float
) -> Iterator[tuple[float, Violation]]:
    """Yield relative size and worst place of every bound that does not hold.

    Parameters
    ----------
    program : Program
        From `transcribe`.
    values : ndarray, shape (n_g + n_w,)
        Rows and unknowns.
    tolerance : float
        Violation that counts as none.
    """
    duration = values[program.g_lower.size + program.layout.duration]
    for group in _groups(program):
        size = _size(group, values)
        for sign in (1.0, -1.0):
            bound, here = _side(group, sign), values[group.where]
            over = sign * (bound - here)
            worst = over.max()
            if not worst > tolerance:
                continue
            # Of places that are as bad as each other the first one counts.
            k = int(np.flatnonzero(over >= worst - tolerance)[0])
            yield worst / size, Violation(
                group.label, float(group.parts[k] * duration), int(group.intervals[k]),
                float(worst), float(bound + group.shift), float(here[k] + group.shift), group.role,
            )  # fmt: skip


def _side(group: _Group, sign: float) -> float:
    """Return the lower bound for a positive sign, else the upper one."""
    return group.lower if sign > 0 else group.upper


def _size(group: _Group, values: Array) -> float:
    """Return what a violation is compared to: the range of the bounds, or what is typical."""
    if group.typical:
        return max(1.0, group.typical)
    width = group.upper - group.lower
    if 0 < width < np.inf:
        return float(width)
    # A goal that is one value is missed by metres and radians, whatever the value is.
    one_sided = np.abs(values[group.where]).max() if width else 1.0
    return float(max(1.0, one_sided))


def _plain(task: Task, expression: ca.SX) -> tuple[str, int] | None:
    """Return the record and the number of the state or unknown that an expression is."""
    for record, symbols in (("x", task.dae.x), ("z", task.dae.z)):
        for k, symbol in enumerate(leaves(symbols)):
            if ca.is_equal(expression, symbol):
                return record, k
    return None


def _shift(task: Task, expression: ca.SX) -> float:
    plain = _plain(task, expression)
    return 0.0 if plain is None else float(task.dae.shift[plain[0] == "z"][plain[1]])


def _role(fraction: float) -> str:
    return GOAL if fraction == 1 else f"{WAY_POINT} at {fraction:g}"


def _plainly(label: Label) -> Label:
    """Return a label by the name of the quantity that is limited."""
    return replace(label, name=label.name.removesuffix("_limit"))


def _rate(label: Label) -> Label:
    """Return the label of an input's rate, as the program calls it."""
    return Label(f"{label.full}_change", "s-2", f"rate of {label.full}")


def _subject(label: Label, role: str) -> str:
    """Return what is constrained, and whose it is or where."""
    whose = "the vehicle" if label.wheel is None else f"wheel {label.wheel}"
    if role == INPUT:
        return f"input {label.full}"
    if role == DURATION:
        return "duration"
    if role in (LIMIT, EQUATION, MODEL):
        kind = "equation " if role == EQUATION else "model's own " if role == MODEL else ""
        return f"{kind}{label.name} of {whose}"
    return f"{label.full} at the {role}"


def _number(label: Label, value: float) -> str:
    """Return a value with its unit."""
    unit = _unit(label.unit)
    return f"{round(value, 9) + 0.0:.4g}{unit and ' '}{unit}"


def _range(label: Label, low: float, high: float) -> str:
    if low == high:
        return _number(label, low)
    if np.isfinite(low) and np.isfinite(high):
        return f"{low:.4g} to {_number(label, high)}"
    return f"at least {_number(label, low)}" if np.isfinite(low) else \
        f"at most {_number(label, high)}"  # fmt: skip


def _unit(unit: str) -> str:
    """Return a unit with a stroke, ``"rad/s"`` for ``"rad s-1"``."""
    parts = unit.split()
    over = [part for part in parts if "-" not in part and part != "1"]
    under = [part.replace("-", "").removesuffix("1") for part in parts if "-" in part]
    return "/".join([" ".join(over) or "1", *under]) if under else " ".join(over)
