"""Inverse kinematics and contact of a vehicle as C code for a controller on board.

The code is a header, a source and a test program, whose text outside the generated functions is in
``controller.h``, ``controller.c`` and ``controller_test.c``. The graphs of the model are those of
`slipfree.batch`; the reference numbers of the test program come from dense linear algebra on the
model's equations.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree.batch.evaluator import CodeWriter, evaluator_of
from slipfree.batch.graph import Graph, Solve, elimination, graph_of, state_of
from slipfree.batch.many import stand, stand_checked, start_states
from slipfree.batch.motion import COMPLETE
from slipfree.core.dae import Dae
from slipfree.core.errors import ModelError, read_table
from slipfree.core.lookups import dense, evaluate
from slipfree.core.newton import solve_equations
from slipfree.core.records import Array, Label, leaves
from slipfree.core.trajectory import Frame, heading_column
from slipfree.core.version import __version__
from slipfree.models.base import extent
from slipfree.models.given_rates import COMMANDS, ROBOT, GivenRates, derived_rates
from slipfree.models.inverse import invert
from slipfree.models.kinematics import check_driven, direct_kinematics
from slipfree.system.regular_files import make_folder, replace_file
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic
from slipfree.vehicle.tree import Vehicle

PART = 500  # instructions in a part of a function: compilers need a time that grows with its square
N_CASES = 100  # states in the test program, half of them on level ground
TRIES = 4  # drawn places for each state
MAP_NODES, MAP_HALF = (10, 9), (4.0, 3.5)  # heights of its map along x and y, and half its sides
MAP_HEIGHT = 0.15  # amplitude of its heights [size]
NEWTON_STEPS, SOLVED_RESIDUAL = 3, 1e-14  # of its reference numbers
JOINT_SPREAD, SLIDE_SPREAD = 0.3, 0.1  # of its measured joints [rad, size]
COMMAND = 0.3  # largest velocity in its commands [m/s, rad/s]
AXES = {"paper": ("right", "forward"), "rep103": ("forward", "left")}
FILES = ("{}.h", "controller.h"), ("{}.c", "controller.c"), ("{}_test.c", "controller_test.c")
STACK = 3000  # other variables on the stack [bytes]
TABLE: dict[str, Any] = read_table(__file__, "controller.toml")
RESERVED = re.compile("|".join([*TABLE["reserved"].split(), "[A-Z0-9_]*"]))
MET = {
    True: "The motion is met exactly, with the least slip of the wheels.",
    False: "Where the wheels cannot impose all velocities, the rates are of the nearest motion.",
}


class _Field(NamedTuple):
    """A number of a record in C: ``sign * value + shift`` for the value of the model."""

    name: str
    unit: str
    words: str
    sign: float = 1.0
    shift: float = 0.0

    @property
    def declaration(self) -> str:
        unit = self.unit.replace(" s-1", "/s")
        return f"  double {self.name}; /* {_comment(self.words)} [{unit}] */"

    def value(self, record: str) -> str:
        """Return the C code of the model's value."""
        value = f"{record}->{self.name}"
        if self.shift:
            value = f"({value} - {self.shift!r})"
        return value if self.sign > 0 else f"-{value}"

    def text(self, value: float) -> str:
        """Return the C code of a number from the model's value."""
        return repr(self.sign * value + self.shift)

    def assignment(self, record: str, value: str) -> str:
        """Return the C code that assigns the model's value."""
        signed = value if self.sign > 0 else f"-{value}"
        return f"  {record}->{self.name} = {signed}{f' + {self.shift!r}' if self.shift else ''};"


class _Fields(NamedTuple):
    """Numbers of the records in C."""

    place: list[_Field]
    pose: list[_Field]
    command: list[_Field]
    rates: list[_Field]


class _Model(NamedTuple):
    """Models of a vehicle on a ground, and columns of their variables.

    ``blocks`` are the equations of the rates of the inverse model, and their unknowns: a block is
    linear in its unknowns and depends on the blocks before it. ``relaxing`` is the number of
    coordinates at the beginning of the pose that follow from the loads of pressed wheels.
    """

    direct: Dae
    inverse: Dae
    relaxing: int
    place: ca.SX
    pose: ca.SX
    command: ca.SX
    blocks: list[tuple[ca.SX, ca.SX]]
    answer: ca.SX
    labels: list[Label]


class ControllerCode(NamedTuple):
    """Files of C code, and the shell command that compiles and runs their test program."""

    files: list[Path]
    command: str


def export_controller(
    vehicle: Vehicle,
    folder: Path,
    *,
    given: Sequence[str] = tuple(COMMANDS),
    exact: bool = False,
    frame: Frame = "rep103",
) -> ControllerCode:
    """Write the inverse kinematics and the contact of a vehicle as C code.

    Parameters
    ----------
    vehicle : Vehicle
        The vehicle.
    folder : Path
        Folder for the header, the source and the test program; made if it does not exist.
    given, exact : sequence of str, bool
        Velocities of the platform, and whether they are met exactly, as for
        `slipfree.inverse_kinematics`.
    frame : {"paper", "rep103"}
        Axis from which headings count, and names of the velocities.

    Returns
    -------
    ControllerCode
        The files, and the command that compiles and runs the test program, which returns zero if
        the code agrees with the models in Python within 1e-12.

    Raises
    ------
    ModelError
        If the vehicle is locked to a plane, has no input, or cannot follow ``given``; or if names
        of its wheels and joints are equal in C.
    DataError
        If a file cannot be written.
    """
    if vehicle.planar:
        raise ModelError(
            f"{vehicle.name!r}: expected a vehicle that moves in space, found one that is locked "
            "to a vertical plane; give a vehicle on a map"
        )
    check_driven(vehicle)
    rates = GivenRates(given, exact=exact)
    rates.check(vehicle)
    size = extent(vehicle)
    x, y = (size * np.linspace(-half, half, n) for half, n in zip(MAP_HALF, MAP_NODES, strict=True))
    heights = MAP_HEIGHT * size * np.sin(1.3 * x[:, None] / size) * np.cos(y / size + 0.4)
    grid = Grid(x, y, heights)
    level = _model(vehicle, Grid(x, y, 0 * heights), rates)
    fields = _fields(level, frame)
    name = _c_name(vehicle.name.lower())
    text = {
        "name": name,
        "NAME": name.upper(),
        "title": _comment(vehicle.name),
        "version": __version__,
        "met": MET[exact],
        **dict(zip("xy", AXES[frame], strict=True)),
        **_source_text(level, fields, name),
        **_test_text((level, _model(vehicle, grid, rates)), grid, fields),
    }
    templates = Path(__file__).parent
    texts = {
        file.format(name): re.sub(
            "@([A-Za-z_]+)@", lambda key: text[key[1]], (templates / template).read_text("utf-8")
        )
        for file, template in FILES
    }
    make_folder(folder)
    files = [folder / name for name in texts]
    for file, content in zip(files, texts.values(), strict=True):
        replace_file(file, partial(Path.write_text, data=content, encoding="utf-8"))
    sources = " ".join(shlex.quote(str(file)) for file in files[1:])
    program = str(files[-1].with_suffix(""))
    program = shlex.quote(program if os.sep in program else f"./{program}")
    command = f"cc -std=c99 -pedantic -Wall -O2 -o {program} {sources} -lm && {program}"
    return ControllerCode(files, command)


def _model(vehicle: Vehicle, grid: Grid, rates: GivenRates) -> _Model:
    """Return the models of a controller: poses from the places, rates from the commands."""
    direct: Dae = direct_kinematics(vehicle, Bicubic(grid, (0.0, 0.0)))
    inverse = invert(direct, rates)
    (x, z, u), relaxing = inverse.columns(), direct.rest.numel()
    n = x.numel() - relaxing
    pairs = zip(inverse.residuals, inverse.block_rows, strict=True)
    blocks = [(law, z[rows]) for law, rows in pairs][1:-1]  # neither the positions nor the forces
    # answers: rates of wheels and joints, targets of steered joints, and velocities
    answers = list[tuple[Label, ca.SX]](zip(direct.labels.u.wheels, direct.u.wheels, strict=True))
    outputs = dict(zip((label.name for label in inverse.labels.y[1]), inverse.y[1], strict=True))
    states = zip(leaves(direct.labels.x), leaves(direct.x), strict=True)
    joints = {label.name: value for label, value in states}
    for c, label in zip(vehicle.of("commanded"), direct.labels.u.joints, strict=True):
        answers.append((label, outputs.get(label.name, ca.SX(0))))
        if f"{c.name}_error" in outputs:
            words = f"target of {c.words or c.name}"
            target = Label(f"{c.name}_target", vehicle.unit(c.name), words)
            answers.append((target, joints[c.name] + outputs[f"{c.name}_error"]))
    answers += zip(direct.labels.z.rates.passive, direct.z.rates.passive, strict=True)
    derived = derived_rates(direct)
    answers += [derived[name] for name in COMMANDS]
    answer = ca.vertcat(*(expression for _, expression in answers))
    labels, pose = [label for label, _ in answers], ca.vertcat(x[n:], z[inverse.block_rows[0]])
    return _Model(direct, inverse, relaxing, x[:n], pose, u, blocks, answer, labels)


def _fields(model: _Model, frame: Frame) -> _Fields:
    """Return the C names, units and signs of the variables; ModelError if two names are equal."""
    x, p = list(leaves(model.direct.labels.x)), list(leaves(model.direct.labels.z[0]))
    count = model.place.numel()

    def field(label: Label) -> _Field:
        """Return the number in C of a variable."""
        name, words = label.full, label.words
        if name == "heading":
            label, offset = heading_column(0.0, frame)
            return _Field(name, label.unit, label.words, 1.0, float(offset))
        if name in COMMANDS and frame == "rep103":
            words = words.replace("across", "to the left of") if name == "right" else words
            robot = next(key for key, command in ROBOT.items() if command == name)
            return _Field(robot, label.unit, words, -1.0 if name == "right" else 1.0)
        return _Field(_c_name(name), label.unit, words)

    records = x[:count], [*x[count:], *p], list(leaves(model.inverse.labels.u)), model.labels
    fields = _Fields(*([field(label) for label in labels] for labels in records))
    for labels, record in zip(records, fields, strict=True):
        names = [each.name for each in record]
        if k := next((k for k, name in enumerate(names) if name in names[:k]), 0):
            raise ModelError(
                "export: expected names of wheels and joints that differ in their letters and "
                f"digits, for C, found {labels[names.index(names[k])].full!r} and "
                f"{labels[k].full!r}; rename a wheel or joint"
            )
    return fields


def _c_name(name: str) -> str:
    name = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_")
    return f"{name}_" if RESERVED.fullmatch(name) else re.sub(r"^(?=\d|$)", "_", name)


class _PlainCode(CodeWriter):
    """Plain C code of graphs, with their numbers."""

    one, work = "1.0", "w[{}]"

    def __init__(self) -> None:
        super().__init__()
        self.stack = 0  # largest array of variables and of results of lookups [numbers]

    def constant(self, value: float) -> str:
        return repr(value) if value >= 0 else f"({value!r})"

    def call(self, name: str, arguments: list[str]) -> str:
        operator: str | None = TABLE["operators"].get(name)
        return operator.format(*arguments) if operator else f"{name[1:]}({','.join(arguments)})"

    def function(self, name: str, function: ca.Function) -> str:
        """Return the code of a function, in parts that compilers translate in seconds."""
        (used, lines), parts = self.instructions(function), list[str]()
        self.stack = max(self.stack, *used, 0)
        for first in range(0, len(lines), PART):
            body = _lines(lines[first : first + PART])
            parts.append(
                f"static void {name}_{first // PART}(PARAMETERS) {{\n  UNUSED;\n{body}\n}}\n"
            )
        names = ", ".join(f"{name}_{k}" for k in range(len(parts)))
        return "".join(parts) + (
            f"static void {name}(const double *a, const double *found, double *r) {{\n"
            f"  static Part *const parts[] = {{{names}}};\n"
            f"  double w[{max(used, default=0) + 1}];\n"
            f"  int k;\n  for (k = 0; k < {len(parts)}; k++) parts[k](a, found, w, r);\n}}\n"
        )

    def graph(self, prefix: str, graph: Graph) -> str:
        """Return the code of ``eval_NAME(ground, a, r)`` for a graph."""
        functions, lines, row = [self.function(f"f_{graph.name}", graph.function)], [], 0
        for k, (lookup, argument) in enumerate(zip(graph.lookups, graph.arguments, strict=True)):
            x = argument.sx_in()  # without the key of the ground, a random number
            place = ca.Function("place", x, [argument(*x)[:2]])
            functions.append(self.function(f"q_{graph.name}_{k}", place))
            lines.append(f"  q_{graph.name}_{k}(a, found, q);\n  look(ground, q, found + {row});\n")
            row += lookup.found.numel()
        arguments = f"const {prefix}_ground *ground, const double *a, double *r"
        q = "  double q[2];\n" if lines else "  (void)ground;\n"
        return _lines(functions) + (
            f"\nstatic void eval_{graph.name}({arguments}) {{\n"
            f"  double found[{max(1, row)}] = {{0}};\n{q}{''.join(lines)}"
            f"  f_{graph.name}(a, found, r);\n}}\n"
        )


def _pose_graphs(model: _Model) -> Iterator[Graph]:
    """Yield the graphs of the pose: a guess, and steps that correct it."""
    direct, relaxing = model.direct, model.relaxing
    n, solve, pose = model.pose.numel() - relaxing, _elimination(model.direct), model.pose
    scale = ca.DM([*direct.sizes.x[len(direct.sizes.x) - relaxing :], *direct.sizes.z[:n]])
    guess = direct.guess[:n]
    if relaxing:
        (guess,) = ca.substitute([guess], [pose[:relaxing]], [direct.rest])
    yield graph_of(direct, model.place, "guess", [direct.rest, guess])

    def newton(name: str, unknowns: ca.SX, rows: ca.SX) -> Graph:
        step = solve(ca.jacobian(rows, unknowns), rows)
        change = ca.norm_1(step / scale[scale.numel() - step.numel() :])
        return graph_of(direct, ca.vertcat(model.place, pose), name, [unknowns - step, change])

    yield newton("positions", pose[relaxing:], direct.residuals[0])
    if direct.lag is not None and direct.linear is not None:
        inputs = direct.columns()[2]
        matrix, right = ca.substitute([*direct.linear], [inputs], [ca.SX.zeros(inputs.shape)])
        rates = solve(matrix, right)
        rates += solve(matrix, right - matrix @ rates)  # a wheel in the air has almost no weight
        (change,) = ca.substitute([direct.ode[-relaxing:]], [_unknowns(direct)[1]], [rates])
        yield graph_of(direct, ca.vertcat(model.place, pose, direct.lag), "relax", [change])
        yield newton("rest", pose, _at_rest(model))


def _inverse_graph(model: _Model) -> Graph:
    """Return the graph of the rates, and of the relative error of their equations."""
    solve = _elimination(model.inverse)
    before, after, error = ca.SX(0, 1), ca.SX(0, 1), ca.SX(0)
    for equations, unknowns in model.blocks:
        (rows,) = ca.substitute([equations], [before], [after])
        matrix = ca.jacobian(rows, unknowns)
        (right,) = ca.substitute([-rows], [unknowns], [ca.SX.zeros(unknowns.shape)])
        values = solve(matrix, right)
        values += solve(matrix, right - matrix @ values)  # pivots in a fixed order lose digits
        error += ca.norm_1(matrix @ values - right) / (1 + ca.norm_1(values))
        before, after = ca.vertcat(before, unknowns), ca.vertcat(after, values)
    (answer,) = ca.substitute([model.answer], [before], [after])
    state = ca.vertcat(model.place, model.pose, model.command)
    return graph_of(model.inverse, state, "inverse", [answer, error])


def _elimination(dae: Dae) -> Solve:
    rows, state = state_of(dae, _unknowns(dae))
    return elimination(dae, state, rows)


def _unknowns(dae: Dae) -> tuple[ca.SX, ca.SX, ca.SX]:
    """Return the positions, the rates and the forces of a model."""
    z, sizes = dae.columns()[1], [len(labels) for labels in dae.labels.alg]
    end = z.numel() - sizes[-1]
    return z[: sizes[0]], z[sizes[0] : end], z[end:]


def _source_text(model: _Model, fields: _Fields, prefix: str) -> dict[str, str]:
    """Return the texts of the header and of the source that depend on the vehicle."""
    code, (place, pose, command, rates) = _PlainCode(), fields
    functions = _lines(
        code.graph(prefix, graph) for graph in (*_pose_graphs(model), _inverse_graph(model))
    )
    if code.unknown:
        raise ModelError(
            f"export: expected formulas of the vehicle with operations that have C code, found "
            f"{code.unknown}; use other functions"
        )
    n, sizes = len(place), model.direct.sizes.x
    named = fields._asdict().items()
    return {
        **{f"n_{name}": str(len(record)) for name, record in named},
        **{name: _lines(f.declaration for f in record) for name, record in named},
        "n_relaxing": str(model.relaxing),
        "n_wheels": str(len(model.direct.z.position.contacts)),
        "functions": functions,
        "stack": f"{(8 * code.stack + STACK) / 1000:.0f}",
        "sizes": ", ".join(map(repr, sizes[n:].tolist())),
        "read_place": _lines(f"  a[{k}] = {f.value('place')};" for k, f in enumerate(place)),
        "read_pose": _lines(f"  a[{n + k}] = {f.value('pose')};" for k, f in enumerate(pose)),
        "write_pose": _lines(f.assignment("pose", f"a[{n + k}]") for k, f in enumerate(pose)),
        "read_command": _lines(
            f"  a[{n + len(pose) + k}] = {f.value('command')};" for k, f in enumerate(command)
        ),
        "write_rates": _lines(f.assignment("rates", f"r[{k}]") for k, f in enumerate(rates)),
    }


def _test_text(models: Sequence[_Model], grid: Grid, fields: _Fields) -> dict[str, str]:
    """Return the texts that `controller_test.c` inserts: its map, and the cases with their results.

    A case has a place, the pose there, a command, and the rates that answer it, from CasADi. The
    first model is on level ground, the second on the map ``grid``; each has half of the cases.
    """
    rng, count = np.random.default_rng(0), N_CASES // 2
    cases = [_cases(model, rng, count) for model in models]
    numbers = [np.concatenate(columns) for columns in zip(*cases, strict=True)]
    records = {
        name: _lines(
            f"  {{{', '.join(f.text(value) for f, value in zip(record, row, strict=True))}}},"
            for row in rows.tolist()
        )
        for name, record, rows in zip(
            ("places", "poses", "commands", "answers"), fields, numbers, strict=True
        )
    }
    corner = grid.x[0], grid.y[0], *grid.spacing
    return records | {
        "n_cases": str(2 * count),
        "n_level": str(count),
        "n_x": str(grid.x.size),
        "n_y": str(grid.y.size),
        "map": ", ".join(repr(float(number)) for number in corner),
        "heights": _lines(f"  {', '.join(map(repr, row))}," for row in grid.z.tolist()),
    }


def _cases(model: _Model, rng: np.random.Generator, count: int) -> tuple[Array, ...]:
    """Return random places, poses, commands and their answers, for the test of the C code."""
    size, drawn, labels = model.direct.size, TRIES * count, list(leaves(model.direct.labels.x))
    vehicle = model.direct.vehicle
    spread = {"x": (-size, size), "y": (-size, size), "heading": (-np.pi, np.pi)}
    for c in vehicle.coordinates:
        most = JOINT_SPREAD if vehicle.unit(c.name) == "rad" else SLIDE_SPREAD * size
        middle = min(max(c.lower, 0.0), c.upper)
        spread[c.name] = max(c.lower, middle - most), min(c.upper, middle + most)
    start = {
        label.name: rng.uniform(*spread[label.name], drawn)
        for label in labels[: model.place.numel()]
    }
    evaluator = evaluator_of(model.direct, compiled=False)
    states, rows = start_states(evaluator.graphs, start), evaluator.graphs.rows
    stands = stand_checked(evaluator, states, stand(evaluator, states)) == COMPLETE
    chosen = np.flatnonzero(stands)[:count]
    if chosen.size < count:
        raise ModelError(
            f"{vehicle.name!r}: expected that the vehicle can stand at random places on a gentle "
            f"hill, found only {stands.sum()} poses at {drawn} places; check the vehicle with "
            "slipfree vehicle"
        )
    standing = states[: rows.p.stop, chosen]
    place, pose = standing[: model.place.numel()], standing[model.place.numel() :]
    pose = _solved(model.direct, _at_rest(model), model.pose, [(model.place, place)], pose)
    command = rng.uniform(-COMMAND, COMMAND, (model.command.numel(), count))
    known = [(model.place, place), (model.pose, pose), (model.command, command)]
    for equations, unknowns in model.blocks:
        zero = np.zeros((unknowns.numel(), count))
        known.append((unknowns, _solved(model.inverse, equations, unknowns, known, zero)))
    symbols, values = zip(*known, strict=True)
    function = model.inverse.function("answers", [*symbols], [ca.densify(model.answer)])
    (answers,) = evaluate(function, *values)
    shift = np.concatenate(model.direct.shift)[len(place) : len(place) + len(pose)]
    pose += shift[:, None]
    return place.T, pose.T, command.T, answers.T


def _at_rest(model: _Model) -> ca.SX:
    """Return the equations of the pose: contacts and, of pressed wheels, the balance of loads."""
    direct, moving = model.direct, ca.vertcat(*model.direct.columns()[1:])
    balance = direct.alg[1][direct.alg[1].numel() - model.relaxing :]
    rates = moving[model.pose.numel() - model.relaxing :]
    (balance,) = ca.substitute([balance], [rates], [ca.SX.zeros(rates.shape)])
    return ca.vertcat(direct.alg[0], balance)


def _solved(
    dae: Dae, rows: ca.SX, unknowns: ca.SX, known: Sequence[tuple[ca.SX, Array]], start: Array
) -> Array:
    """Return the solutions of equations by Newton's method with dense matrices, from a start.

    ``known`` are pairs of a symbol and its values (n_rows, n); the start and the result have the
    shape (n_unknowns, n).
    """
    symbols, values = zip(*known, strict=True)
    results = [ca.densify(rows), ca.densify(ca.jacobian(rows, unknowns))]
    function = dae.function("equations", [*symbols, unknowns], results)

    def equations(z: Array, rows: Any) -> tuple[Array, Array]:
        right, entries = evaluate(function, *(each[:, rows] for each in values), z.T)
        return right.T, dense(entries, function.sparsity_out(1))

    return solve_equations(equations, start.T, tolerance=SOLVED_RESIDUAL, steps=NEWTON_STEPS).z.T


def _comment(words: str) -> str:
    return " ".join(words.replace("*/", "* /").replace("/*", "/ *").split())


def _lines(lines: Iterable[str]) -> str:
    return "\n".join(lines)
