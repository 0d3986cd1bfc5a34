"""Other programs: error and CPU time per metre of a three-wheeler.

``python benchmarks peers [MODEL ...]`` (extra ``bench``)

The paper's three-wheeler with a rigid axle drives 5 m over a map of 200 x 200 nodes, smooth and
with 2 mm of noise, in three models: kinematics, quasi-statics and dynamics. The rates of its wheels
rise smoothly from zero in half a second. CPU time is that of the integration alone, the least of
five runs, since the speed of machines varies; a line ends where a run takes more than a second. The
error is the largest position error of any sample, against ``simulate`` of the same equations at a
tolerance of 1e-10 or, for naive and MuJoCo, against their own motions at this tolerance and at the
smallest step.

ours        IDAS or CVODES on our equations, without limits and quadratures
compiled    the same with compiled equations; the compilation is not counted
simulate    the integration of ``simulate``, compiled, with limits and quadratures
naive       a straightforward implementation of kinematics with CasADi: Montana's contact equations,
            CasADi's B-spline, IDAS with its defaults and CasADi's own derivatives
scipy       our equations, interpreted, with the algebraic unknowns eliminated: LSODA, BDF, Radau,
            which form Jacobians by differences
sundae      our equations, interpreted, by scikit-sundae: IDA on residual and Jacobian, called from
            Python; CVODE on the equations with the algebraic unknowns eliminated
MuJoCo      dynamics with soft contacts of ellipsoids with the radii of the torus, on a height field
            of the same nodes, servos in place of given rates; the distance of both ends is printed
"""

from __future__ import annotations

import os
import subprocess
import tempfile
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from common import apart, run_parts
from growth import Clock
from mjcf import Motion, driven, mujoco_model, settled
from scipy.integrate import solve_ivp
from stock import Stock, surface

from slipfree import (
    Bicubic,
    Grid,
    SlipfreeError,
    SolverOptions,
    direct_kinematics,
    dynamics,
    quasi_statics,
    settle,
    simulate,
)
from slipfree.catalog import three_wheeler
from slipfree.core.records import leaves
from slipfree.core.trajectory import Trajectory
from slipfree.models.montana import montana_kinematics
from slipfree.solve.equations import scaled_jacobian
from slipfree.solve.initial_conditions import solve_initial_conditions
from slipfree.solve.integrator import NEWTON_SHARE, motion_scales
from slipfree.solve.system import System, _solve_symbolically, with_inputs
from slipfree.system.codegen_cache import FOLDER

NODES, SPEED, DURATION, SAMPLES, RISE = 200, 0.5, 10.0, 101, 0.5
START = {"x": 5.0, "y": 4.0, "heading": -0.2}
TOLERANCES = 10.0 ** -np.arange(3, 9)
EXACT, REPEATS, PATIENCE = 1e-10, 5, 600
SLOW = 1.0  # CPU time after which a line ends [s]
NOISES = (0.0, 0.002)  # of the nodes' heights, standard deviation [m]
STEPS = (0.002, 0.001, 0.0005, 0.00025)  # of MuJoCo [s]
FINEST, MU = 0.000125, 0.8  # [s]; friction [1]
OURS = ("ours", "compiled", "simulate")
LEVELS = (1e-4, 1e-6)  # errors at which lines are compared [m]
T, LENGTH = np.linspace(0, DURATION, SAMPLES), SPEED * DURATION  # [s], of the path, about [m]
VEHICLE = three_wheeler(axle="fixed")
MODELS = {"kinematics": direct_kinematics, "quasi-statics": quasi_statics, "dynamics": dynamics}
Line = list[tuple[float, float]]  # CPU time per metre [ms] and error [m]


def ground(rough: float) -> Grid:
    """Return the map of the other benchmarks, with noise of a standard deviation. [m]."""
    grid = surface(NODES)
    noise = rough * np.random.default_rng(0).standard_normal(grid.z.shape)
    return Grid(grid.x, grid.y, grid.z + noise)


class Case(NamedTuple):
    """A model with its start and inputs, and the equations without limits and quadratures."""

    dae: Any
    start: Trajectory
    inputs: Any
    system: System
    at: dict[str, Any]


def prepared(model: str, rough: float, *, naive: bool = False) -> Case:
    """Return the motion to compute in a model on a ground."""
    grid = ground(rough)
    vehicle = three_wheeler(axle="fixed", mass=0.0, wheel_mass=0.0) if naive else VEHICLE
    standing = MODELS[model](vehicle, Bicubic(grid, mu=MU))
    dae = montana_kinematics(vehicle, Stock(grid)) if naive else standing
    start = settle(standing, **START)
    rates = {f"{w.name}_rate": speed(dae.t) / w.radius for w in vehicle.wheels if w.driven}
    inputs = dae.inputs(**rates, steer_rate=0.0)
    system = with_inputs(dae, inputs, SAMPLES - 1)
    x, u = dae.rows("x", start, -1), system.u[:, 0]
    z = solve_initial_conditions(system, 0.0, x, dae.rows("z", start, -1), u)[: system.motion_size]
    return Case(dae, start, inputs, system, {"x0": x, "z0": z, "u": u})


def speed(t: Any) -> Any:
    """Return the speed at the tread of the driven wheels at a time. [m/s]."""
    return SPEED * (np if isinstance(t, np.ndarray) else ca).tanh((t / RISE) ** 2)


def least(task: Callable[[], Any]) -> tuple[float, Any]:
    """Return the least CPU time of a few calls, and the last result. [s]."""
    times = []
    for _ in range(REPEATS):
        clock = time.process_time()
        found = task()
        times.append(time.process_time() - clock)
        if times[0] > SLOW:
            break
    return min(times), found


Run = Callable[[float], tuple[float, np.ndarray]]  # tolerance -> CPU time [s], positions [m]


def points(run: Run, exact: np.ndarray) -> Line:
    """Return CPU time per metre and error for each tolerance; failed runs are omitted.

    Positions count from the start, since those of the states have the middle of the map as origin.
    """
    line, exact = [], exact - exact[:, :1]
    for tolerance in TOLERANCES:
        try:
            cpu, way = run(tolerance)
        except (RuntimeError, SlipfreeError) as error:
            print(f"    {tolerance:.0e}: {str(error).strip().splitlines()[-1]}")
            continue
        line.append((1e3 * cpu / LENGTH, float(np.abs(way - way[:, :1] - exact).max())))
        if cpu > SLOW:
            break
    return line


def simulated(case: Case, *, compiled: bool = False) -> Run:
    """Return the integration of ``simulate`` for each tolerance."""
    clock = Clock()

    def run(tolerance: float) -> tuple[float, np.ndarray]:
        options, seconds = SolverOptions(tolerance=tolerance, compiled=compiled), []
        for _ in range(REPEATS):
            clock.seconds = 0.0
            found = simulate(case.dae, case.start, case.inputs, T, options=options)
            seconds.append(clock.seconds)
        if found.stop is not None:
            raise RuntimeError(found.stop.words)
        return min(seconds), np.array([found["x"], found["y"]])

    return run


def by_us(system: System, at: dict[str, Any]) -> Run:
    """Return our integration, scaled as in ``simulate``, without limits and quadratures."""
    x_size, m_size = motion_scales(system)
    t, x, m, u = (ca.MX.sym(name, system.core.size1_in(k)) for k, name in enumerate("txmu"))
    ode, alg = system.core(t, x * ca.DM(x_size), m * ca.DM(m_size), u)
    equations = {"t": t, "x": x, "z": m, "u": u, "ode": ode / ca.DM(x_size), "alg": alg}
    own: dict[str, Any] = {"cache": {"jacF": scaled_jacobian(system.jacobian, x_size, m_size)}}
    if system.motion_size:
        kind, own["suppress_algebraic"] = "idas", system.dae.suppress_algebraic
    else:
        kind, own["nonlin_conv_coeff"] = "cvodes", NEWTON_SHARE
    scaled = at | {"x0": at["x0"] / x_size, "z0": at["z0"] / m_size}
    scaled_run = by_casadi(kind, equations, own, scaled)

    def run(tolerance: float) -> tuple[float, np.ndarray]:
        cpu, way = scaled_run(tolerance)
        return cpu, way * x_size[:2, None]

    return run


def by_casadi(kind: str, equations: dict[str, Any], own: dict[str, Any], at: dict[str, Any]) -> Run:
    """Return an integration by a method of CasADi for each tolerance, with its own options."""

    def run(tolerance: float) -> tuple[float, np.ndarray]:
        options = {"reltol": tolerance, "abstol": tolerance, "max_num_steps": 10**6, **own}
        solver = ca.integrator("motion", kind, equations, 0.0, T, options)
        cpu, found = least(lambda: solver(**at))
        return cpu, np.array(found["xf"])[:2]

    return run


def buffered(f: ca.Function, size: int) -> Callable[[float, np.ndarray], list[np.ndarray]]:
    """Return a function of time and one column, called without conversions."""
    buffer, trigger = f.buffer()
    t, x = np.zeros(1), np.zeros(size)
    results = [np.zeros(f.nnz_out(k)) for k in range(f.n_out())]
    buffer.set_arg(0, memoryview(t))
    buffer.set_arg(1, memoryview(x))
    for k, result in enumerate(results):
        buffer.set_res(k, memoryview(result))

    def call(time_: float, at: np.ndarray) -> list[np.ndarray]:
        t[0], x[:] = time_, at
        trigger()
        return results

    call.held = buffer  # type: ignore[attr-defined]
    return call


def written_out(system: System, law: Any) -> dict[str, Any]:
    """Return the DAE as one SX graph, which CasADi differentiates."""
    dae = system.dae
    x, z, u = dae.columns()
    rows = [dae.ode, ca.vertcat(*dae.alg)[: system.motion_size]]
    ode, alg = ca.substitute(rows, [u], [ca.vertcat(*leaves(law))])
    given = ca.SX.sym("given", u.numel())
    return {"t": dae.t, "x": x, "z": z[: system.motion_size], "u": given, "ode": ode, "alg": alg}


def explicit(system: System, at: dict[str, Any]) -> ca.Function:
    """Return ``(t, x) -> x'`` with the algebraic unknowns eliminated."""
    t, x, u = (
        ca.MX.sym(name, system.core.size1_in(k)) for name, k in (("t", 0), ("x", 1), ("u", 3))
    )
    z = system.dae.function("guess", [system.dae.columns()[0]], [system.dae.guess])(x)
    for block in system.blocks:
        z = _solve_symbolically(block, [t, x, z, u])
    ode = system.core(t, x, z[: system.motion_size], u)[0]
    function = ca.Function("rates", [t, x, u], [ode])
    given = [ca.MX.sym("t"), ca.MX.sym("x", x.numel())]
    return ca.Function("rates", given, [ca.densify(function(*given, at["u"]))])


def by_scipy(kind: str, rates: ca.Function, at: dict[str, Any]) -> Run:
    """Return an integration by SciPy for each tolerance."""
    call = buffered(rates, rates.size1_in(1))

    def run(tolerance: float) -> tuple[float, np.ndarray]:
        cpu, found = least(
            lambda: solve_ivp(
                lambda t, x: call(t, x)[0].copy(),
                (0.0, DURATION),
                at["x0"],
                method=kind,
                t_eval=T,
                rtol=max(tolerance, 3e-14),
                atol=tolerance,
            )
        )
        if not found.success:
            raise RuntimeError(found.message)
        return cpu, found.y[:2]

    return run


def by_cvode(kind: str, rates: ca.Function, at: dict[str, Any]) -> Run:
    """Return an integration by scikit-sundae's CVODE for each tolerance."""
    from sksundae.cvode import CVODE

    call = buffered(rates, rates.size1_in(1))

    def right(t: float, x: np.ndarray, found: np.ndarray) -> None:
        found[:] = call(t, x)[0]

    def run(tolerance: float) -> tuple[float, np.ndarray]:
        solver = CVODE(right, rtol=tolerance, atol=tolerance, method=kind, max_num_steps=10**6)
        cpu, found = least(lambda: solver.solve(T, at["x0"]))
        if not found.success:
            raise RuntimeError(found.message)
        return cpu, found.y.T[:2]

    return run


def by_ida(system: System, at: dict[str, Any]) -> Run:
    """Return an integration by scikit-sundae's IDA for each tolerance."""
    from sksundae.ida import IDA

    n, m = system.core.size1_in(1), system.core.size1_in(2)
    t, y, cj = ca.MX.sym("t"), ca.MX.sym("y", n + m), ca.MX.sym("cj")
    ode, alg = system.core(t, y[:n], y[n:], at["u"])
    rows = ca.vertcat(ode, alg)
    residual = ca.Function("residual", [t, y], [ca.densify(rows)])
    slopes = ca.jacobian(rows, y)
    slopes -= cj * ca.diag(ca.DM(np.repeat([1.0, 0.0], [n, m])))
    slope = ca.Function("slope", [ca.vertcat(t, cj), y], [ca.densify(slopes)])
    call, matrix = buffered(residual, n + m), slope

    def missed(time_: float, y: np.ndarray, rates: np.ndarray, found: np.ndarray) -> None:
        found[:] = call(time_, y)[0]
        found[:n] -= rates[:n]

    def linearised(time_, y, rates, found, cj, jacobian):  # noqa: ARG001
        jacobian[:] = np.array(matrix([time_, cj], y))

    first = np.append(at["x0"], at["z0"])
    rates = np.append(call(0.0, first)[0][:n], np.zeros(m))

    def run(tolerance: float) -> tuple[float, np.ndarray]:
        solver = IDA(
            missed,
            rtol=tolerance,
            atol=tolerance,
            jacfn=linearised,
            algebraic_idx=list(range(n, n + m)),
            max_num_steps=10**6,
        )
        cpu, found = least(lambda: solver.solve(T, first, rates))
        if not found.success:
            raise RuntimeError(found.message)
        return cpu, found.y.T[:2]

    return run


def ours(model: str, rough: float) -> dict[str, Line]:
    """Return the curves of a model of ours with every integrator."""
    case = prepared(model, rough)
    system, at, exact = case.system, case.at, simulated(case)(EXACT)[1]
    runs = {"ours": by_us(system, at), "simulate": simulated(case, compiled=True)}
    if (
        model != "quasi-statics"
    ):  # Newton's method does not eliminate its unknowns from a fixed guess
        rates = explicit(system, at)
        runs |= {f"scipy {kind}": by_scipy(kind, rates, at) for kind in ("LSODA", "BDF", "Radau")}
        runs["sundae CVODE"] = by_cvode("Adams" if model == "kinematics" else "BDF", rates, at)
    if model != "dynamics":
        runs["sundae IDA"] = by_ida(system, at)
    with tempfile.TemporaryDirectory() as folder:
        os.environ[FOLDER] = folder
        options = SolverOptions(compiled=True)
        runs["compiled"] = by_us(with_inputs(case.dae, case.inputs, SAMPLES - 1, options), at)
        return {name: points(run, exact) for name, run in runs.items()}


def naive(rough: float) -> dict[str, Line]:
    """Return the curve of a straightforward implementation with CasADi."""
    case = prepared("kinematics", rough, naive=True)
    run = by_casadi("idas", written_out(case.system, case.inputs), {}, case.at)
    return {"naive": points(run, run(EXACT)[1])}


def mujoco(rough: float) -> dict[str, Any]:
    """Return MuJoCo's curve, and the distance of its end at the smallest step from ours [m]."""
    grid = ground(rough)
    case = prepared("dynamics", rough)
    model = mujoco_model(VEHICLE, grid, MU)
    state = settled(model, VEHICLE, case.start, FINEST)

    def drive(step: float) -> tuple[float, np.ndarray]:
        driven_wheels = [wheel for wheel in VEHICLE.wheels if wheel.driven]
        t = step * np.arange(round(DURATION / step))
        rates = np.column_stack([speed(t) / wheel.radius for wheel in driven_wheels])
        runs = [driven(model, state, rates, step) for _ in range(2)]
        way = Motion(runs[0][1][:: round(T[1] / step)]).position[:, :2].T
        return min(cpu for cpu, _ in runs), way

    exact = drive(FINEST)[1]
    line = []
    for step in STEPS:
        cpu, way = drive(step)
        line.append((1e3 * cpu / LENGTH, float(np.abs(way - exact).max())))
    own = simulated(case)(EXACT)[1]
    moved = exact[:, -1] - exact[:, 0] - (own[:, -1] - own[:, 0])
    return {"MuJoCo": line, "gap": float(np.linalg.norm(moved))}


def at_error(line: Line, error: float) -> float:
    """Return the CPU time per metre at an error, interpolated on a curve. [ms].

    A line that is more exact at its loosest is charged that point.
    """
    cpu, errors = np.log(np.array(sorted(line, key=lambda p: p[1]))).T
    if not errors[0] <= np.log(error):
        return np.nan
    return float(np.exp(np.interp(np.log(error), errors, cpu)))


def beside(times: float) -> str:
    """Return a ratio as text."""
    return f"{times:.1f} times" if np.isfinite(times) else "not known"


def words(rough: float) -> str:
    """Return the name of a ground."""
    return f"with {1e3 * rough:g} mm of noise" if rough else "smooth"


PEERS = {"kinematics": naive, "dynamics": mujoco}


def measured(rough: float, model: str) -> None:
    """Print the curves of a model; each part runs in a process: it may crash."""
    lines, gap = dict[str, Line](), np.nan
    tasks = [(ours, model, rough), *([(PEERS[model], rough)] if model in PEERS else [])]
    for function, *given in tasks:
        try:
            found = apart(function, *given, timeout=PATIENCE)
        except subprocess.SubprocessError as error:
            print(f"{function.__name__}: {error}")
            if function is ours:
                return
            continue
        gap = found.pop("gap", gap)
        lines |= found
    print(f"\n{model}, {words(rough)}: ms of CPU per metre (largest error of the position [m])")
    for name, line in lines.items():
        print(f"{name:13s}" + "  ".join(f"{cpu:.2f} ({error:.0e})" for cpu, error in line))
    for level, own in ((level, own) for own in OURS[:2] for level in LEVELS):
        least = at_error(lines[own], level)
        if not np.isfinite(least):
            continue
        others = ", ".join(
            f"{name} {beside(at_error(line, level) / least)}"
            for name, line in lines.items()
            if name not in OURS
        )
        print(f"at an error of {level:.0e} m: {own} {least:.2f} ms/m; {others}")
    if np.isfinite(gap):
        print(f"MuJoCo, at its smallest step, ends {gap:.3f} m from ours")


def main() -> None:
    """Print the tables of the models that are named, or of all."""
    run_parts({model: partial(table, model) for model in MODELS})


def table(model: str) -> None:
    """Print the curves of a model on both grounds."""
    for rough in NOISES:
        measured(rough, model)
