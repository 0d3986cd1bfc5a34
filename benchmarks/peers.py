"""Compare error and CPU time per metre of other ways to compute the three-wheeler's motion.

``python benchmarks/peers.py --plot peers.png`` (extra ``bench``)

The paper's three-wheeler drives 5 m straight over a map of 200 x 200 nodes, smooth and with 2 mm of
noise; the driving law limits its tilts. CPU time is that of the integration alone, the least of
three rounds of a few runs, since the speed of machines varies. The error of a curve is the largest
position error of any sample, against its own model at the tightest tolerance or, for MuJoCo,
against its own motion at the smallest step.

ours        closure and least slip, IDAS as in ``simulate``, but without evaluation of limits
compiled    the same with compiled equations; the compilation is not counted
naive       a straightforward implementation with CasADi: Montana's contact equations, CasADi's
            B-spline, IDAS with its defaults and CasADi's own derivatives
scipy       our model, interpreted, with the algebraic unknowns eliminated: LSODA, DOP853, Radau,
            which form Jacobians by differences
sundae      our model, interpreted, by scikit-sundae: IDA on residual and Jacobian, called from
            Python; CVODE on the equations with the algebraic unknowns eliminated
MuJoCo      a dynamic simulation, which solves another problem: soft contacts of ellipsoids with the
            radii of the torus, on a height field of the same nodes, servos in place of given rates.
            Its vehicle has a rigid axle, since free tilts fall over in dynamics, and its wheels
            turn as those of our model with that axle; the distance of both ends is printed.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import matplotlib as mpl
import numpy as np
from direct import Stock, surface, wrapped, written_out
from reference import heading
from scipy.integrate import solve_ivp
from work_precision import cvodes

from slipfree import Bicubic, Grid, SolverOptions, direct_kinematics, settle, simulate, straight
from slipfree.catalog import three_wheeler
from slipfree.codegen_cache import FOLDER
from slipfree.models.montana import montana_kinematics
from slipfree.solve.initial_conditions import solve_initial_conditions
from slipfree.solve.system import System, with_inputs
from slipfree.trajectory import Trajectory, path_length

NODES, SPEED, DURATION, SAMPLES = 200, 0.5, 10.0, 101
START = {"x": 5.0, "y": 4.0, "heading": -0.2}
TOLERANCES = 10.0 ** -np.arange(3, 9)
EXACT, REPEATS, ROUNDS, PATIENCE = 1e-10, 3, 3, 400
NOISES = (0.0, 0.002)  # of the nodes' heights, standard deviation [m]
STEPS = (0.02, 0.01, 0.005, 0.002, 0.001)  # of MuJoCo [s]
FINEST = 0.00025
OURS = ("ours", "compiled")
LEVELS = (1e-4, 1e-6)  # errors at which lines are compared [m]
T = np.linspace(0, DURATION, SAMPLES)
Line = list[tuple[float, float]]  # CPU time per metre [ms] and error [m]


def ground(rough: float) -> Grid:
    """Return the map of the other benchmarks, with noise of a standard deviation. [m]."""
    grid = surface(NODES)
    noise = rough * np.random.default_rng(0).standard_normal(grid.z.shape)
    return Grid(grid.x, grid.y, grid.z + noise)


def prepared(
    rough: float, axle: str = "tilting", *, naive: bool = False, compiled: bool = False
) -> tuple[Any, Trajectory, System, Any]:
    """Return the model, its start, and its equations under the driving law."""
    grid = ground(rough)
    vehicle = three_wheeler(axle=axle, mass=0.0, wheel_mass=0.0)
    model = montana_kinematics if naive else direct_kinematics
    dae = model(vehicle, Stock(grid) if naive else Bicubic(grid))
    standing = direct_kinematics(vehicle, Bicubic(grid)) if naive else dae
    start = settle(standing, **START)
    law = straight(dae, vehicle, start, speed=SPEED)
    options = SolverOptions(compiled=compiled)
    return dae, start, with_inputs(dae, law, SAMPLES - 1, options), law


def least(task: Callable[[], Any]) -> tuple[float, Any]:
    """Return the least CPU time of a few calls, and the last result. [s]."""
    times = []
    for _ in range(REPEATS):
        clock = time.process_time()
        found = task()
        times.append(time.process_time() - clock)
    return min(times), found


def points(run: Callable[[float], tuple[float, np.ndarray]], metres: float) -> Line:
    """Return CPU time per metre and error for each tolerance; failed runs are omitted."""
    exact = run(EXACT)[1]
    line = []
    for tolerance in TOLERANCES:
        try:
            cpu, way = run(tolerance)
        except RuntimeError as error:
            print(f"    {tolerance:.0e}: {str(error).strip().splitlines()[-1]}", file=sys.stderr)
            continue
        line.append((1e3 * cpu / metres, float(np.abs(way - exact).max())))
    return line


def by_idas(
    equations: dict[str, Any], own: dict[str, Any], at: dict[str, Any]
) -> Callable[[float], Any]:
    """Return an integration by CasADi's IDAS for each tolerance, with its own options."""

    def run(tolerance: float) -> tuple[float, np.ndarray]:
        options = {"reltol": tolerance, "abstol": tolerance, "max_num_steps": 10**6, **own}
        solver = ca.integrator("motion", "idas", equations, 0.0, T, options)
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


def explicit(system: System, at: dict[str, Any]) -> ca.Function:
    """Return ``(t, x) -> x'`` with the algebraic unknowns eliminated."""
    equations = cvodes(system)
    t, x, u = (equations[name] for name in "txu")
    function = ca.Function("rates", [t, x, u], [equations["ode"]])
    given = [ca.MX.sym("t"), ca.MX.sym("x", x.numel())]
    return ca.Function("rates", given, [ca.densify(function(*given, at["u"]))])


def by_scipy(kind: str, rates: ca.Function, at: dict[str, Any]) -> Callable[[float], Any]:
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


def by_cvode(rates: ca.Function, at: dict[str, Any]) -> Callable[[float], Any]:
    """Return an integration by scikit-sundae's CVODE for each tolerance."""
    from sksundae.cvode import CVODE

    call = buffered(rates, rates.size1_in(1))

    def right(t: float, x: np.ndarray, found: np.ndarray) -> None:
        found[:] = call(t, x)[0]

    def run(tolerance: float) -> tuple[float, np.ndarray]:
        solver = CVODE(right, rtol=tolerance, atol=tolerance, method="Adams", max_num_steps=10**6)
        cpu, found = least(lambda: solver.solve(T, at["x0"]))
        return cpu, found.y.T[:2]

    return run


def by_ida(system: System, at: dict[str, Any]) -> Callable[[float], Any]:
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
        return cpu, found.y.T[:2]

    return run


def ours(rough: float) -> dict[str, Line]:
    """Return the curves of our model with every integrator."""
    dae, start, system, _ = prepared(rough)
    x = dae.rows("x", start, -1)
    u = system.u[:, 0]
    z = solve_initial_conditions(system, 0.0, x, dae.rows("z", start, -1), u)[: system.motion_size]
    at = {"x0": x, "z0": z, "u": u}
    metres = SPEED * DURATION
    rates = explicit(system, at)
    lines = {"ours": points(by_idas(*wrapped(system), at), metres)}
    lines |= compiled(rough, at)
    for kind in ("LSODA", "DOP853", "Radau"):
        lines[f"scipy {kind}"] = points(by_scipy(kind, rates, at), metres)
    lines["sundae CVODE"] = points(by_cvode(rates, at), metres)
    lines["sundae IDA"] = points(by_ida(system, at), metres)
    return lines


def compiled(rough: float, at: dict[str, Any]) -> dict[str, Line]:
    """Return the curve of our model with compiled equations."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ[FOLDER] = folder
        _, _, system, _ = prepared(rough, compiled=True)
        return {"compiled": points(by_idas(*wrapped(system), at), SPEED * DURATION)}


def naive(rough: float) -> dict[str, Line]:
    """Return the curve of a straightforward implementation with CasADi."""
    dae, start, system, law = prepared(rough, naive=True)
    x = dae.rows("x", start, -1)
    u = system.u[:, 0]
    z = solve_initial_conditions(system, 0.0, x, dae.rows("z", start, -1), u)[: system.motion_size]
    at = {"x0": x, "z0": z, "u": u}
    return {"naive": points(by_idas(written_out(system, law), {}, at), SPEED * DURATION)}


def quicker(one: Line, other: Line) -> Line:
    """Return the points of a curve with the least CPU time of two rounds; errors are equal."""
    least = {error: cpu for cpu, error in other}
    least |= {error: min(cpu, least.get(error, cpu)) for cpu, error in one}
    return [(least[error], error) for error in sorted(least, reverse=True)]


BODY = """<mujoco>
<option integrator="implicitfast" cone="elliptic" impratio="10" timestep="{step}"/>
<asset><hfield name="ground" nrow="{n}" ncol="{n}" size="{half} {half} {relief} 1"/></asset>
<worldbody><geom type="hfield" hfield="ground" pos="{half} {half} {low}" friction="1 0.01 0.0001"/>
<body name="platform" pos="{x} {y} {z}" quat="{quaternion}"><freejoint/>
<inertial pos="0 0 0" mass="30" diaginertia="3 3 3"/>{rear}
<body name="fork" pos="0 1 0"><joint name="steer" axis="0 0 1"/>
<inertial pos="0 0 0" mass="0.5" diaginertia="0.01 0.01 0.01"/>{front}</body></body></worldbody>
<actuator><velocity joint="right" kv="100"/><velocity joint="left" kv="100"/>
<position joint="steer" kp="300" kv="20"/></actuator></mujoco>"""
WHEEL = """<body name="{name}" pos="{at}"><joint name="{name}" axis="-1 0 0"/>
<geom type="ellipsoid" size="0.12247 0.3 0.3" mass="2" condim="3" friction="1 0.01 0.0001"/>
</body>"""


def mujoco(rough: float) -> dict[str, Any]:
    """Return MuJoCo's curve, and the distance of its end at the smallest step from ours [m]."""
    import mujoco as mj

    dae, start, *_ = prepared(rough, "fixed")
    vehicle = three_wheeler(axle="fixed", mass=0.0, wheel_mass=0.0)
    law = straight(dae, vehicle, start, speed=SPEED)
    run = simulate(dae, start, law, T, options=SolverOptions(tolerance=1e-8))
    grid = ground(rough)
    low, relief = float(grid.z.min()), float(np.ptp(grid.z))
    turn = np.array(run["heading"][0])
    placed = {
        "n": NODES,
        "half": grid.x[-1] / 2,
        "relief": relief,
        "low": low,
        "x": run["x"][0],
        "y": run["y"][0],
        "z": run["z"][0] + 0.003,
        "quaternion": f"{np.cos(turn / 2)} 0 0 {np.sin(turn / 2)}",
        "rear": WHEEL.format(name="right", at="1 -0.5 0")
        + WHEEL.format(name="left", at="-1 -0.5 0"),
        "front": WHEEL.format(name="front", at="0 0 0"),
    }

    def drive(step: float) -> tuple[float, np.ndarray]:
        model = mj.MjModel.from_xml_string(BODY.format(step=step, **placed))
        model.hfield_data[:] = ((grid.z.T - low) / relief).ravel()
        best, way = np.inf, np.zeros((2, SAMPLES))
        for _ in range(REPEATS if step > FINEST else 1):
            data = mj.MjData(model)
            mj.mj_forward(model, data)
            for _ in range(round(1.0 / step)):  # it sinks in
                mj.mj_step(model, data)
            moved = data.qpos[:2].copy()
            each, clock = round(T[1] / step), time.process_time()
            for k in range(SAMPLES):
                way[:, k] = data.qpos[:2] - moved
                data.ctrl[:] = run["right_rate"][k], run["left_rate"][k], run["steer"][k]
                if k < SAMPLES - 1:
                    mj.mj_step(model, data, each)
            best = min(best, time.process_time() - clock)
        return best, way.copy()

    exact = drive(FINEST)[1]
    metres = path_length(run)
    line = []
    for step in STEPS:
        cpu, way = drive(step)
        line.append((1e3 * cpu / metres, float(np.abs(way - exact).max())))
    own = np.array([run["x"] - run["x"][0], run["y"] - run["y"][0]])
    return {"MuJoCo": line, "gap": float(np.linalg.norm(exact[:, -1] - own[:, -1]))}


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
    return f"{times:.1f} times" if np.isfinite(times) else "not reached"


def plot(found: dict[float, dict[str, Line]], file: Path) -> None:
    """Draw all curves, one panel per ground."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, len(found), figsize=(11, 5), sharey=True, layout="constrained")
    for axes, (rough, lines) in zip(panels, found.items(), strict=True):
        for k, (name, line) in enumerate(lines.items()):
            axes.loglog(*np.array(line).T, "osx^vDP*X"[k % 9] + "-", label=name)
        axes.set(xlabel="CPU time per metre [ms/m]", title=words(rough))
        axes.grid(visible=True, alpha=0.3)
    panels[0].set_ylabel("largest error of the position [m]")
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=5)
    figure.savefig(file, dpi=150)


def words(rough: float) -> str:
    """Return the name of a ground."""
    return f"with {1e3 * rough:g} mm of noise" if rough else "smooth"


PARTS = {"ours": ours, "naive": naive, "mujoco": mujoco}


def measured(rough: float) -> dict[str, Line]:
    """Return the curves on a ground and print them; each runs in a process, since it may crash."""
    lines, gap = dict[str, Line](), np.nan
    for part in ROUNDS * [*PARTS]:
        command = [sys.executable, __file__, "--part", part, "--noise", str(rough)]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=PATIENCE, check=False
            )
        except subprocess.TimeoutExpired:
            print(f"{part}: no result in {PATIENCE} s")
            continue
        print(done.stderr, end="")
        if done.returncode:
            print(f"{part}: ended with code {done.returncode}")
            continue
        found = json.loads(done.stdout.splitlines()[-1])
        gap = found.pop("gap", gap)
        lines |= {name: quicker(line, lines.get(name, line)) for name, line in found.items()}
    print(f"\n{words(rough)}: ms of CPU a metre (largest error of the position [m])")
    for name, line in lines.items():
        print(f"{name:13s}" + "  ".join(f"{cpu:.2f} ({error:.0e})" for cpu, error in line))
    for level, own in ((level, own) for own in OURS for level in LEVELS):
        least = at_error(lines[own], level)
        others = ", ".join(
            f"{name} {beside(at_error(line, level) / least)}"
            for name, line in lines.items()
            if name not in OURS
        )
        print(f"at an error of {level:.0e} m: {own} {least:.2f} ms/m; {others}")
    print(
        f"MuJoCo, at its smallest step, ends {gap:.3f} m from ours with the rigid axle", flush=True
    )
    return lines


def main() -> None:
    """Print the tables and draw the plot."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plot", type=Path, metavar="FILE.png", help="where to draw the lines")
    parser.add_argument("--part", choices=PARTS, help="print one part as JSON")
    parser.add_argument("--noise", type=float, default=0.0, help="of the part's ground [m]")
    given = parser.parse_args()
    if given.part:
        print(json.dumps(PARTS[given.part](given.noise)))
        return
    heading()
    found = {rough: measured(rough) for rough in NOISES}
    if given.plot:
        plot(found, given.plot)


if __name__ == "__main__":
    main()
