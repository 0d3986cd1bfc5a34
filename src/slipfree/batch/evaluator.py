"""Evaluate graphs at many states: compiled for the vector registers of the machine, or interpreted.

CasADi's list of instructions is written as C code in which every number is a vector, one lane for
each state. Numeric constants are arguments of the code, so that a library serves all vehicles of
the same structure on all maps.
"""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Mapping, Sequence
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import casadi as ca
import numpy as np

from slipfree.batch.graph import Graph, Graphs, graphs_of
from slipfree.core.dae import Dae
from slipfree.core.lookups import WIDTH, CellBounds, Cells, evaluate, evaluate_lanes
from slipfree.core.records import Array
from slipfree.system.codegen_cache import compiler, shared_library

FLAGS = ("-shared", "-fPIC", "-ffp-contract=fast", "-fno-math-errno")
LONG = 1_500_000  # characters of code that is compiled with less optimisation, which takes minutes
LANES = (("__AVX512F__", 8), ("__AVX__", 4))  # doubles in a register, by macro of the compiler
PORTABLE_LANES = 2  # on other machines
PROBE_TIMEOUT = 20.0  # [s]
BLOCK = 256  # lanes of a call of compiled steps, of less than a second; divisible by all of LANES
OPERATORS = {
    ca.OP_ADD: "{}+{}",
    ca.OP_SUB: "{}-{}",
    ca.OP_MUL: "{}*{}",
    ca.OP_SQ: "{0}*{0}",
    ca.OP_TWICE: "{0}+{0}",
    ca.OP_NEG: "-{}",
    ca.OP_ASSIGN: "{}",
}
# results of the graph "checked"
CHECKED = ("k", "p", "w", "change", "error", "speed", "f", "doubt", "distances", "before")
# functions of `lanes.c` by operation; most have the name of the operation, after a v
COMPARED = ("lt", "le", "eq", "ne", "and", "or", "not", "if_else_zero")
CALLED = (
    *("fmin", "fmax", "fabs", "sign", "copysign", "sqrt", "sin", "cos", "tan", "asin", "acos"),
    *("atan", "atan2", "sinh", "cosh", "tanh", "exp", "log", "expm1", "log1p", "pow", "fmod"),
    *("hypot", "floor", "ceil"),
)
OPERATIONS = {getattr(ca, name): name for name in dir(ca) if name.startswith("OP_")}
CALLS: dict[int, str] = {getattr(ca, f"OP_{name.upper()}"): name for name in COMPARED}
CALLS |= {getattr(ca, f"OP_{name.upper()}"): f"v{name}" for name in CALLED}
CALLS |= {ca.OP_FMIN: "vmin", ca.OP_FMAX: "vmax", ca.OP_FABS: "vabs", ca.OP_CONSTPOW: "vpow"}


class GraphSet(Protocol):
    """Graphs that are compiled together."""

    @property
    def every(self) -> tuple[Graph, ...]:
        """All graphs."""


G = TypeVar("G", bound=GraphSet)


class EvaluatorOf(Generic[G]):
    """Evaluation of graphs at the columns of an array of states, here by CasADi.

    Only compiled graphs (``is_compiled``) may be evaluated by several threads at the same time.
    """

    is_compiled = False

    def __init__(self, graphs: G) -> None:
        self.graphs = graphs

    def __call__(self, graph: Graph, states: Array) -> Array:
        """Return the results of a graph, shape (n_results, n).

        The ``states`` (n_rows, n) have contiguous rows.
        """
        if not states.shape[1]:
            return np.empty((graph.function.numel_out(0), 0))
        results = np.zeros((graph.function.size1_in(1), states.shape[1]))
        run = evaluate_lanes if states.shape[1] > WIDTH / 4 else lambda *given: evaluate(*given)[0]
        row = 0
        for lookup, argument in zip(graph.lookups, graph.arguments, strict=True):
            (values,) = evaluate(lookup.function, run(argument, states, results))
            results[row : row + len(values)] = values
            row += len(values)
        return run(graph.function, states, results)

    def drive(self, *_: Any) -> bool:
        """Fill in the results of motions if there are compiled steps; return whether there are."""
        return False


Evaluator = EvaluatorOf[Graphs]


@lru_cache(maxsize=8)
def evaluator_of(dae: Dae, *, compiled: bool = True, lanes: int | None = None) -> Evaluator:
    """Return the evaluator of a model: compiled, or interpreted if it cannot be compiled.

    A warning gives the reason if it is not compiled. ``lanes`` is the number of lanes of a vector,
    by default that of the machine's registers. ModelError is raised for a model without graphs; see
    `slipfree.batch.graph.graphs_of`.
    """
    graphs = graphs_of(dae)
    steps = _step_code(graphs) if graphs.linear else ""
    return evaluator_of_graphs(graphs, steps, compiled=compiled, lanes=lanes)


def evaluator_of_graphs(
    graphs: G, steps: str = "", *, compiled: bool = True, lanes: int | None = None
) -> EvaluatorOf[G]:
    """Return the evaluator of graphs, with C code of steps that call them."""
    if compiled and all(each.cells for graph in graphs.every for each in graph.lookups):
        source = _Source(graphs.every, steps)
        if not source.unknown:
            native, widest = _machine()
            lanes = lanes or widest
            header = Path(__file__).with_name("lanes.c").read_text(encoding="utf-8")
            splat = f"#define SPLAT(a) ((vd){{{','.join(['a'] * lanes)}}})"
            text = f"#define LANES {lanes}\n{splat}\n{header}\n{source.code}"
            flags = ("-O2" if len(text) < LONG else "-O1", *FLAGS, *native[:1])
            loaded = shared_library(f"{native}\n{text}", lambda: text, ctypes.CDLL, flags)
            if loaded is not None:
                return _Compiled(graphs, source, loaded)
    return EvaluatorOf(graphs)


class _Compiled(EvaluatorOf[G]):
    """Evaluation by a compiled library."""

    is_compiled = True

    def __init__(self, graphs: G, source: _Source, loaded: ctypes.CDLL) -> None:
        super().__init__(graphs)
        self._functions = {name: getattr(loaded, name) for name in source.names}
        self._steps = loaded if source.has_steps else None
        self._constants = np.array([*source.constants, 0.0])
        self._tables = [np.ascontiguousarray(each.coefficients) for each in source.cells]
        self._cells = (_Cells * max(1, len(self._tables)))(
            *(
                _Cells(table.ctypes.data, table.shape[1], each.numbers)
                for table, each in zip(self._tables, source.cells, strict=True)
            )
        )

    def __call__(self, graph: Graph, states: Array) -> Array:
        count, states = states.shape[1], np.ascontiguousarray(states)
        results = np.empty((graph.function.numel_out(0), count))
        self._functions[graph.name](
            ctypes.c_long(count),
            ctypes.c_void_p(states.ctypes.data),
            ctypes.c_long(states.strides[0] // 8),
            ctypes.c_void_p(results.ctypes.data),
            ctypes.c_void_p(self._constants.ctypes.data),
            self._cells,
        )
        return results

    def drive(
        self,
        states: Array,
        inputs: Array,
        t: Array,
        kept: int,
        numbers: Sequence[float],
        bounds: Mapping[int, CellBounds],
        *results: Array,
    ) -> bool:
        """Fill in the results of motions as `motion._drive_plainly`; return whether there is code.

        Arguments are those of `motion._drive_plainly`; ``numbers`` those of `motion._Numbers`.
        There is no code for a model whose rates need iterations. Samples are certified by the
        ``bounds`` of wheels, by their rows in the graph "placing". Signals are served between
        blocks of lanes.
        """
        if self._steps is None:
            return False
        states, inputs, t = (
            np.ascontiguousarray(each, dtype=float) for each in (states, inputs, t)
        )
        wheels = np.array([(row, len(each.table), *each.numbers) for row, each in bounds.items()])
        tables = np.array([each.table.ctypes.data for each in bounds.values()], dtype=np.uintp)
        n, arrays = states.shape[1], (states, inputs, t, *results, wheels, tables)
        sizes = n, len(t), kept, len(bounds)
        run = _Run(*sizes, *(each.ctypes.data for each in arrays), tuple(numbers))
        constants = ctypes.c_void_p(self._constants.ctypes.data)
        for begin in range(0, n, BLOCK):
            lanes = (ctypes.c_long(each) for each in (begin, min(begin + BLOCK, n)))
            self._steps.drive(*lanes, ctypes.byref(run), constants, self._cells)
        return True


class _Run(ctypes.Structure):
    """The structure ``Run`` of ``step.c``; its numbers are those of `motion._Numbers`."""

    _fields_ = (
        *((name, ctypes.c_long) for name in ("n", "m", "kept", "certified")),
        *((name, ctypes.c_void_p) for name in ("in", "inputs", "t", "samples", "counts", "out")),
        *((name, ctypes.c_void_p) for name in ("doubt", "wheels", "tables")),
        ("numbers", ctypes.c_double * 14),
    )


class _Cells(ctypes.Structure):
    """The structure ``Cells`` of ``lanes.c``; its numbers are those of `Cells`."""

    _fields_ = (
        ("table", ctypes.c_void_p),
        ("width", ctypes.c_longlong),
        ("numbers", ctypes.c_double * 8),
    )


class CodeWriter:
    """C code of functions of the rows ``a`` of a state and of the results ``found`` of lookups.

    ``unknown`` is the name of an operation of CasADi that has no C code; empty if each has.
    """

    one, work = "SPLAT(1.0)", "w{}"

    def __init__(self) -> None:
        self.unknown = ""
        self._constants: dict[float, int] = {}

    def constant(self, value: float) -> str:
        """Return the C code of a constant."""
        return f"splat(K[{self._constants.setdefault(value, len(self._constants))}])"

    def call(self, name: str, arguments: list[str]) -> str:
        """Return the C code of a function of `CALLS`."""
        return f"{name}({','.join(arguments)})"

    def instructions(self, function: ca.Function) -> tuple[list[int], list[str]]:
        """Return the numbers of the variables of a function, and its lines of C code.

        Quotients with equal denominators share its inverse: in vectors, a division takes as long as
        thirty products.
        """
        values, used, lines = dict[int, str](), set[int](), list[str]()
        inverses, free = dict[str, str](), function.sz_w()
        for k in range(function.n_instructions()):
            operation = function.instruction_id(k)
            given, found = function.instruction_input(k), function.instruction_output(k)
            if operation == ca.OP_CONST:
                values[found[0]] = self.constant(function.instruction_constant(k))
            elif operation == ca.OP_INPUT:
                values[found[0]] = f"{('a', 'found')[given[0]]}[{given[1]}]"
            elif operation == ca.OP_OUTPUT:
                lines.append(f"r[{found[1]}]={values[given[0]]};")
            else:
                w = [values[each] for each in given]
                if operation in (ca.OP_DIV, ca.OP_INV):
                    if w[-1] not in inverses:
                        used.add(free)
                        inverses[w[-1]] = self.work.format(free)
                        free += 1
                        lines.append(f"{inverses[w[-1]]}={self.one}/{w[-1]};")
                    operation = ca.OP_MUL if operation == ca.OP_DIV else ca.OP_ASSIGN
                    w[-1] = inverses[w[-1]]
                if operation in OPERATORS:
                    value = OPERATORS[operation].format(*w)
                elif operation in CALLS:
                    value = self.call(CALLS[operation], w)
                else:
                    self.unknown, value = OPERATIONS[operation], w[0]
                used.add(found[0])
                values[found[0]] = self.work.format(found[0])
                inverses.pop(values[found[0]], None)
                lines.append(f"{values[found[0]]}={value};")
        return sorted(used), lines


class _Source(CodeWriter):
    """C code of graphs, and the constants and cells that are its arguments."""

    def __init__(self, graphs: tuple[Graph, ...], steps: str) -> None:
        super().__init__()
        self.names, self.has_steps = tuple(graph.name for graph in graphs), bool(steps)
        self.cells: list[Cells] = []
        self.code = "\n".join((*(self._graph(graph) for graph in graphs), steps))

    def function(self, name: str, function: ca.Function) -> str:
        """Return the C function of an SX function on vectors of lanes."""
        used, lines = self.instructions(function)
        declared = f"  vd {','.join(f'w{k}' for k in used)};\n" if used else ""
        return (
            f"static void {name}(const vd *a, const vd *found, vd *r, const double *K) {{\n"
            f"{declared}" + "\n".join(lines) + "\n}\n"
        )

    @property
    def constants(self) -> tuple[float, ...]:
        return tuple(self._constants)

    def _graph(self, graph: Graph) -> str:
        """Return the C functions that evaluate a graph with its lookups, for a block of lanes."""
        functions = [self.function(f"f_{graph.name}", graph.function)]
        lines = list[str]()
        row = 0
        for k, (lookup, argument) in enumerate(zip(graph.lookups, graph.arguments, strict=True)):
            functions.append(self.function(f"q_{graph.name}_{k}", argument))
            index = next((i for i, c in enumerate(self.cells) if c is lookup.cells), None)
            if index is None and lookup.cells is not None:
                index = len(self.cells)
                self.cells.append(lookup.cells)
            lines.append(f"q_{graph.name}_{k}(a, found, q, K);")
            lines.append(f"look(cells + {index}, q[0], q[1], found + {row});")
            row += lookup.found.numel()
        n_in, n_out = graph.function.numel_in(0), max(1, graph.function.numel_out(0))
        body = "\n  ".join(lines)
        return "\n".join(functions) + (
            f"\nstatic void eval_{graph.name}(const vd *a, vd *r, const double *K, "
            "const Cells *cells) {\n"
            f"  vd found[{max(1, row)}], q[3];\n"
            f"  {body}\n"
            f"  f_{graph.name}(a, found, r, K);\n}}\n"
            f"\nvoid {graph.name}(long n, const double *in, long stride, double *out, "
            "const double *K, const Cells *cells) {\n"
            f"  vd a[{n_in}], r[{n_out}];\n"
            "  for (long g = 0; g < n; g += LANES) {\n"
            f"    for (int k = 0; k < {n_in}; k++) a[k] = load(in + k * stride + g, n - g);\n"
            f"    eval_{graph.name}(a, r, K, cells);\n"
            f"    for (int k = 0; k < {graph.function.numel_out(0)}; k++) "
            "store(out + k * n + g, r[k], n - g);\n"
            "  }\n}\n"
        )


def _step_code(graphs: Graphs) -> str:
    """Return the C code of steps of a model whose rates need no iteration."""
    parts = graphs.rows._asdict()
    results = zip(CHECKED, graphs.checked.parts, strict=True)
    parts |= {f"new_{name}": part for name, part in results}
    sizes = {f"{name}_at": part.start for name, part in parts.items()}
    sizes |= {f"{name}_end": part.stop for name, part in parts.items()}
    sizes["rest"] = graphs.dae.rest.numel()
    for name in ("motion", "checked", "placing"):
        sizes[f"{name}_results"] = getattr(graphs, name).function.numel_out(0)
    lines = [f"#define {name.upper()} {value}" for name, value in sizes.items()]
    return "\n".join([*lines, Path(__file__).with_name("step.c").read_text(encoding="utf-8")])


@cache
def _machine() -> tuple[tuple[str, ...], int]:
    """Return the flag of the machine's instructions with their macros, and doubles in a register.

    The macros are part of the cache's key: machines of a network may share a home folder.
    """
    command = compiler()
    if command is None:
        return (), PORTABLE_LANES
    flag, probe = "-march=native", ["-dM", "-E", "-x", "c", "/dev/null"]
    try:
        done = subprocess.run(
            [*command, flag, *probe], capture_output=True, text=True, timeout=PROBE_TIMEOUT
        )
    except (OSError, subprocess.SubprocessError):
        return (), PORTABLE_LANES
    if done.returncode:
        return (), PORTABLE_LANES
    macros = sorted(word for word in done.stdout.split() if word.startswith("__") and "_" in word)
    lanes = next((count for macro, count in LANES if macro in macros), PORTABLE_LANES)
    return (flag, *macros), lanes
