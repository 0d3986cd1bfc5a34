"""Compare results and times of two versions of the package.

``python benchmarks/versions.py results OUT [--against OTHER] [--compiled] [--only NAME ...]`` runs
all shipped problems of motions, writes their results to the folder OUT and prints the exit code and
the CPU time of each. With ``--against`` it prints the largest difference to the results of the same
names in another folder, in units of the range of each variable (between 0.01 and 10). ``--no-run``
compares existing results.

``python benchmarks/versions.py times --old PYTHON [--new PYTHON] [--cases NAME ...]`` times the
cases below with the interpreters of two environments in which the package is installed. One
process each stays open, and they are called alternately, so that both see the same load. It prints
the least CPU time of each and the ratio of these minima. A climb is the command in a new process;
with ``motion`` it is the simulation alone, as the summary states it.

``python benchmarks/versions.py points --old PYTHON [--new PYTHON]`` evaluates residuals, Jacobians
and the Hessians of plans at random points, for all models on all kinds of ground, and prints the
largest difference over the largest entry.

``python benchmarks/versions.py stations --old PYTHON [--new PYTHON]`` runs a small problem on a map
and prints the functions between the problem and the integrator, and those that a height passes
between the map file and the Jacobian of IDAS.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from reference import heading
from scipy.io import netcdf_file

PROBLEMS = Path(__file__).parent.parent / "problems"
REPEATS = 9
SMALLEST, LARGEST = 1e-2, 10.0  # ranges that differences are divided by
CASES = (
    "three_wheeler",
    "rover",
    "plan 50",
    "plan 200",
    "three_wheeler compiled",
    "rover compiled",
    "plan 50 compiled",
    "three_wheeler without kernel",
    "rover without kernel",
    "model three_wheeler",
    "model rover",
    "residual three_wheeler",
    "residual rover",
    "jacobian three_wheeler",
    "jacobian rover",
    "hessian 50",
    "climb ramp",
    "climb step",
    "climb stairs",
    "climb plan_step",
    "climb ramp motion",
    "climb step motion",
    "climb stairs motion",
    "climb plan_step motion",
)
WORKER = r"""
import json, re, resource, subprocess, sys, tempfile, time
import casadi as ca, numpy as np
import slipfree as sf
from dataclasses import replace
from slipfree.plan.plan import plan
try:
    from slipfree.records import leaves
    from slipfree.solve.system import with_inputs
except ModuleNotFoundError:  # version 0.1.0
    from slipfree.named import leaves
    from slipfree.solve.loop import close as with_inputs
from slipfree.terrain import kernel

name = sys.argv[1]
compiled = name.endswith(" compiled")
new = hasattr(sf, "SolverOptions")  # version 0.1.0 has it in the model
options = {"options": sf.SolverOptions(compiled=compiled)} if new else {}
catalog = sf.catalog if new else sf
if name.endswith("without kernel"):
    kernel.library = lambda: None
x, y = np.linspace(-6, 6, 241), np.linspace(-3, 9, 241)
hills = 0.1 * np.sin(1.3 * x)[:, None] * np.cos(0.9 * y) + 0.02 * np.sin(4 * x)[:, None]


def vehicle():
    if "rover" in name:
        return catalog.rocky7()
    planned = name.startswith(("plan", "hessian"))
    return catalog.three_wheeler(axle="fixed" if planned else "tilting")


def model():
    dae = sf.direct_kinematics(vehicle(), sf.Bicubic(sf.Grid(x, y, hills)))
    return dae if options else replace(dae, compiled=compiled)


def best(function, number=200):
    least = float("inf")
    for _ in range(5):
        begin = time.process_time()
        for _ in range(number):
            function()
        least = min(least, (time.process_time() - begin) / number)
    return least


if name.startswith("climb"):  # the command in a new process, or its simulation alone
    problem = name.split()[1]
    def call():
        begin = resource.getrusage(resource.RUSAGE_CHILDREN)
        with tempfile.TemporaryDirectory() as folder:
            words = subprocess.run(
                [sys.executable, "-m", "slipfree", "run", f"{sys.argv[2]}/climb_{problem}.toml",
                 "--no-draw", "-o", folder + "/a.nc"], check=True, capture_output=True, text=True,
            ).stdout
        if name.endswith("motion"):
            return float(re.search(r"([0-9.]+) s CPU", words).group(1))
        end = resource.getrusage(resource.RUSAGE_CHILDREN)
        return end.ru_utime + end.ru_stime - begin.ru_utime - begin.ru_stime
elif name.startswith("model"):
    def call():
        dae = model()
        begin = time.process_time()
        rest = {each.full: 0.0 for each in leaves(dae.labels.u)}
        with_inputs(dae, dae.inputs(**rest), 0, **options)
        return time.process_time() - begin
elif name.startswith(("residual", "jacobian")):
    dae = model()
    law = {each.full: 0.4 for each in leaves(dae.labels.u)}
    system, start = with_inputs(dae, dae.inputs(**law), 0, **options), sf.settle(dae, **options)
    point = [0.0, dae.rows("x", start, 0), dae.rows("z", start, 0)[: system.core.size1_in(2)],
             system.u[:, 0]]
    function = system.core
    if name.startswith("jacobian"):
        function = function.jacobian()
        point += [np.zeros(function.size1_in(4 + k)) for k in range(function.n_in() - 4)]
    buffer, memory = function.buffer()
    held = [np.zeros(function.nnz_in(k)) + np.ravel(each) for k, each in enumerate(point)]
    outs = [np.zeros(function.nnz_out(k)) for k in range(function.n_out())]
    for k, each in enumerate(held):
        buffer.set_arg(k, memoryview(each))
    for k, each in enumerate(outs):
        if each.size:
            buffer.set_res(k, memoryview(each))
    def call():
        return best(memory, 2000)
elif name.startswith(("plan", "hessian")):
    dae = model()
    start = sf.settle(dae, x=0.0, y=0.0, heading=0.0, **options)
    law = dae.inputs(right_rate=0.45, left_rate=0.45, steer_rate=0.0)
    guess = sf.simulate(dae, start, law, np.linspace(0, 20, 201), **options)
    rates = {f"{each}_rate": (-2.0, 2.0) for each in ("right", "left", "steer")}
    def found():
        return plan(dae, start, guess, goal={"x": 0.6, "y": 2.6}, duration=20.0, inputs=rates,
                    costs={"slip": 7e4, "effort": 0.01}, limits={"steer": (-1.0, 1.0)},
                    smooth=0.002, intervals=int(name.split()[1]), **options)
    if name.startswith("plan"):
        def call():
            begin = time.process_time()
            found()
            return time.process_time() - begin
    else:
        kept = []
        make = ca.nlpsol
        def watching(label, solver, problem, options=None):
            result = make(label, solver, problem, options or {})
            kept.append(options["hess_lag"])
            return result
        ca.nlpsol = watching
        found()
        hessian = kept[0]
        point = [np.full(hessian.sparsity_in(k).shape, 0.3) for k in range(hessian.n_in())]
        def call():
            return best(lambda: hessian.call(point), 20)
else:
    dae = model()
    v = vehicle()
    def call():
        begin = time.process_time()
        start = sf.settle(dae, x=0.0, y=0.0, heading=0.0, **options)
        law = sf.straight(dae, v, start, speed=0.5)
        sf.simulate(dae, start, law, np.linspace(0, 10, 101), **options)
        return time.process_time() - begin

call()
print("ready", flush=True)
for _ in sys.stdin:
    print(json.dumps(call()), flush=True)
"""


POINTS = r"""
import sys
from dataclasses import replace
import casadi as ca, numpy as np
import slipfree as sf
from slipfree.terrain import kernel
try:
    from slipfree.models.inverse import inverse_kinematics
    from slipfree.models.kinematics import direct_kinematics
    from slipfree.models.montana import montana_kinematics
    from slipfree.plan.problem import task_of
    from slipfree.plan.transcription import CollocationMesh as Mesh, transcribe
    from slipfree.records import leaves
    from slipfree.solve.system import with_inputs
    from slipfree.terrain.rolled import rolled
except ModuleNotFoundError:  # version 0.1.0
    from slipfree.kinematics.inverse import inverse_kinematics
    from slipfree.kinematics.montana import montana_kinematics
    from slipfree.kinematics.rolling import direct_kinematics
    from slipfree.kinematics.subset import subset_kinematics
    from slipfree.named import leaves
    from slipfree.plan.task import task_of
    from slipfree.plan.transcribe import Mesh, transcribe
    from slipfree.solve.loop import close as with_inputs
    from slipfree.terrain.rolled import rolled
try:
    from slipfree.laws.rolling import Rolling
    from slipfree.models.quasi_statics import quasi_statics
except ModuleNotFoundError:  # version 0.1.0
    def Rolling():
        return "rolling"
    def quasi_statics(vehicle, ground):
        return direct_kinematics(vehicle, ground, slip="traction")
def inverse(vehicle, ground, solve_for, given=("velocity_x", "velocity_y", "heading_rate")):
    try:
        return inverse_kinematics(vehicle, ground, given=given, solve_for=solve_for)
    except TypeError:  # version 0.1.0
        if "forward" in given:
            return subset_kinematics(vehicle, ground, given=given)
        return inverse_kinematics(vehicle, ground, given=given, steering=solve_for[:-1])

x = np.linspace(-6, 6, 121)
z = 0.1 * np.sin(1.3 * x)[:, None] * np.cos(0.9 * x) + 0.02 * np.sin(4 * x)[:, None]
mu = 0.6 + 0.1 * np.sin(x)[:, None] * np.cos(x)
a = ca.MX.sym("a")
wave = ca.Function("wave", [a], [0.1 * ca.sin(1.3 * a)], {"never_inline": True})
grids = sf.Grid(x, x, z), sf.Grid(x, x, mu)
table, library = kernel.library(), kernel.library
GROUNDS = {
    "formula": lambda: sf.Analytic(lambda x, y: 0.1 * ca.sin(1.3 * x) * ca.cos(0.9 * y), mu=0.6),
    "formula that calls": lambda: sf.Analytic(lambda x, y: wave(x) * ca.cos(0.9 * y), mu=0.6),
    "map": lambda: sf.Bicubic(grids[0], mu=0.6),
    "map without kernel": lambda: sf.Bicubic(grids[0], mu=0.6),
    "rolled map": lambda: sf.Bicubic(rolled(grids[0], 0.3).grid, mu=0.6),
    "map of friction": lambda: sf.Bicubic(grids[0], mu=grids[1]),
    "formula of friction": lambda: sf.Bicubic(grids[0], mu=lambda x, y: 0.6 + 0.1 * ca.sin(x)),
}
catalog = getattr(sf, "catalog", sf)  # version 0.1.0 has its vehicles at the top
three, rover = catalog.three_wheeler(), catalog.rocky7()
MODELS = {
    "least slip": lambda g: direct_kinematics(three, g),
    "least slip, rover": lambda g: direct_kinematics(rover, g),
    "rolling": lambda g: direct_kinematics(three, g, slip=Rolling()),
    "traction": lambda g: quasi_statics(catalog.three_wheeler(axle="fixed"), g),
    "Montana": lambda g: montana_kinematics(three, g),
    "inverse, steering rate": lambda g: inverse(three, g, "rates"),
    "inverse, steering angle": lambda g: inverse(three, g, "angles"),
    "platform rates, rover": lambda g: inverse(rover, g, "angles", ("forward", "yaw_rate")),
}
found = {}
for ground_name, make in GROUNDS.items():
    kernel.library = (lambda: None) if "without" in ground_name else library
    ground = make()
    stand = sf.settle(direct_kinematics(three, ground), heading=0.2)
    for model_name, of in MODELS.items():
        dae, rng = of(ground), np.random.default_rng(7)
        law = dae.inputs(**{each.full: 0.0 for each in leaves(dae.labels.u)})
        system = with_inputs(dae, law, 0)
        n_x, n_z = dae.ode.numel(), system.core.size1_in(2)
        start = 0.3 * rng.normal(size=n_x), 0.3 * rng.normal(size=n_z)
        if model_name == "Montana":  # contacts of wheels that stand
            start = np.array([stand.of(each)[0] if each.full in stand.columns or each.name in
                              stand.columns else 0.1 for each in leaves(dae.labels.x)]), start[1]
            start = start[0] - dae.shift[0], start[1]
        for k in range(5):
            off = rng.normal(size=n_x), rng.normal(size=n_z), rng.normal(size=system.u.shape[0])
            at = [0.3, start[0] + 0.05 * off[0], start[1] + 0.05 * off[1], 0.3 * off[2]]
            key = f"{model_name} | {ground_name} | {k}"
            for name, each in zip(("ode", "residual"), system.core(*at)):
                found[f"{key} | {name}"] = np.array(ca.DM(each))
            slopes = system.core.jacobian()(*at, *(0 for _ in range(system.core.n_out())))
            whole = [np.array(ca.DM(slopes[j])).ravel() for j in (1, 2, 5, 6)]
            found[f"{key} | Jacobian"] = np.concatenate(whole)
    for slip, model in (("least", direct_kinematics), ("traction", quasi_statics)):
        dae = model(catalog.three_wheeler(axle="fixed"), ground)
        task = task_of(dae, sf.settle(dae), goal={"y": 1.0}, costs={"slip": 1.0, "effort": 0.01},
                       duration=(4.0, 6.0), limits={"steer": (-1.0, 1.0)})
        program, rng = transcribe(task, Mesh(np.linspace(0, 1, 3), 2)), np.random.default_rng(3)
        for k in range(3):
            w = 0.3 * rng.normal(size=program.scale.size)
            p = rng.uniform(size=3)
            w[program.layout.duration] = 4.5
            prices = rng.normal(size=program.g_lower.size)
            key = f"plan, {slip} | {ground_name} | {k}"
            found[f"{key} | Jacobian"] = np.array(ca.DM(program.jacobian(w, p)[1]))
            found[f"{key} | Hessian"] = np.array(ca.DM(program.hessian(w, p, 0.4, prices)))
np.savez(sys.argv[1], **found)
"""


STATIONS = r'''
import sys, tempfile
from pathlib import Path
import casadi as ca, numpy as np
import slipfree
try:
    from slipfree.problem.load import load_problem
    from slipfree.problem.solve import run_problem
except ModuleNotFoundError:  # version 0.1.0
    from slipfree.problem.read import read as load_problem
    from slipfree.problem.run import run as run_problem
root, make, stacks, order = str(Path(slipfree.__file__).parent), ca.integrator, [], []
HEIGHT = ("terrain.bicubic", "terrain.kernel", "terrain.base.poly", "terrain.base._sums",
          "contact.closure.closure", "contact.closure.touch", "contact.closure.contact_frame",
          "calls",
          "lookups", "solve.equations", "compiled", "codegen_cache", "dae.Dae.function")


def name(code):
    module = Path(code.co_filename).relative_to(root).with_suffix("").as_posix().replace("/", ".")
    return f"{module}.{code.co_qualname}".replace("<locals>.", "")


def watching(*args, **options):
    frame, stack = sys._getframe(1), []
    while frame:
        if frame.f_code.co_filename.startswith(root) and "forks" not in frame.f_code.co_filename:
            stack.append(name(frame.f_code))
        frame = frame.f_back
    stacks.append(stack[::-1])
    return make(*args, **options)


def profile(frame, event, _):
    if event == "call" and frame.f_code.co_filename.startswith(root):
        found = name(frame.f_code)
        if found.startswith(HEIGHT) and "<" not in found and found not in order:
            order.append(found)


folder, x = Path(tempfile.mkdtemp()), np.linspace(-3, 3, 25)
np.savez(folder / "g.npz", x=x, y=x, z=np.zeros((25, 25)))
(folder / "p.toml").write_text("""verb = "direct"
terrain.file = "g.npz"
vehicle.catalog = "three_wheeler"
start.heading = 0
inputs = {right_rate = 0.5, left_rate = 0.4, steer_rate = 0}
time = {duration = 1, step = 0.5}
""")
ca.integrator = watching
sys.setprofile(profile)
run_problem(load_problem(folder / "p.toml"))
sys.setprofile(None)
for title, found in (("a wheel rate", stacks[0]), ("a height", order)):
    print(f"{title}: {len(found)}")
    print("\n".join(f"  {each}" for each in found))
'''


def print_points(old: str, new: str) -> None:
    """Print the largest differences of two versions at random points."""
    with tempfile.TemporaryDirectory() as folder:
        before, after = (Path(folder) / f"{name}.npz" for name in ("old", "new"))
        for python, file in ((old, before), (new, after)):
            subprocess.run([python, "-c", POINTS, str(file)], check=True)
        one, other = np.load(before), np.load(after)
        worst = dict[tuple[str, str, str], float]()
        for name in one:
            model, ground, _, what = name.split(" | ")
            a, b = one[name], other[name]
            finite = np.isfinite(a)
            same = np.array_equal(finite, np.isfinite(b))
            size = np.abs(a[finite]).max(initial=0.0) or 1.0
            gap = np.abs(a[finite] - b[finite]).max(initial=0.0) / size if same else np.inf
            key = model, ground, what
            worst[key] = max(worst.get(key, 0.0), float(gap))
    grounds = list(dict.fromkeys(ground for _, ground, _ in worst))
    for model in dict.fromkeys(model for model, _, _ in worst):
        for what in dict.fromkeys(w for m, _, w in worst if m == model):
            gaps = "  ".join(f"{worst[model, ground, what]:.0e}" for ground in grounds)
            print(f"{model:24} {what:9} {gaps}")
    print("grounds:", ", ".join(grounds))
    print(f"largest: {max(worst.values()):.1e}")


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    commands = parser.add_subparsers(dest="command", required=True)
    runs = commands.add_parser("results")
    runs.add_argument("out", type=Path)
    runs.add_argument("--against", type=Path)
    runs.add_argument("--compiled", action="store_true")
    runs.add_argument("--only", nargs="*", default=[])
    runs.add_argument("--no-run", action="store_true")
    times = commands.add_parser("times")
    times.add_argument("--old", required=True)
    times.add_argument("--new", default=sys.executable)
    times.add_argument("--cases", nargs="*", default=CASES)
    times.add_argument("--repeats", type=int, default=REPEATS)
    stations = commands.add_parser("stations")
    stations.add_argument("--old", required=True)
    stations.add_argument("--new", default=sys.executable)
    points = commands.add_parser("points")
    points.add_argument("--old", required=True)
    points.add_argument("--new", default=sys.executable)
    asked = parser.parse_args()
    heading()
    if asked.command == "stations":
        for python in (asked.old, asked.new):
            print(
                subprocess.run(
                    [python, "-c", STATIONS], check=True, text=True, capture_output=True
                ).stdout
            )
        return
    if asked.command == "points":
        print_points(asked.old, asked.new)
        return
    if asked.command == "times":
        print_times(asked.old, asked.new, asked.cases, asked.repeats)
        return
    asked.out.mkdir(parents=True, exist_ok=True)
    if not asked.no_run:
        run_problems(asked.out, asked.only, compiled=asked.compiled)
    if asked.against:
        print_differences(asked.against, asked.out, asked.only)


def names(only: list[str]) -> list[str]:
    """Return the names of the shipped problems that make results."""
    found = sorted(path.stem for path in PROBLEMS.glob("*.toml"))
    others = ("compare_axles", "fit_skid_steer")
    return [name for name in found if name not in others and (not only or name in only)]


def run_problems(out: Path, only: list[str], *, compiled: bool) -> None:
    """Run the shipped problems; print exit codes and wall time."""
    more = ["--set", "solver.compiled=true"] if compiled else []
    for name in names(only):
        command = [sys.executable, "-m", "slipfree", "run", str(PROBLEMS / f"{name}.toml")]
        begin = time.perf_counter()
        done = subprocess.run(
            [*command, "--no-draw", "-o", str(out / f"{name}.nc"), *more],
            check=False,
            capture_output=True,
            text=True,
        )
        if done.returncode == 2 and more:  # a step climber, which is not compiled
            done = subprocess.run(
                [*command, "--no-draw", "-o", str(out / f"{name}.nc")],
                check=False,
                capture_output=True,
                text=True,
            )
        seconds = time.perf_counter() - begin
        print(f"{name:22} exit code {done.returncode}, {seconds:6.1f} s", flush=True)


def variables(path: Path) -> dict[str, np.ndarray]:
    """Return the variables of a result."""
    with netcdf_file(path, mmap=False) as file:
        return {name: np.array(each.data) for name, each in file.variables.items()}


def differences(old: dict[str, np.ndarray], new: dict[str, np.ndarray]) -> dict[str, float]:
    """Return the largest difference of each variable over its range; infinite if none is left."""
    found = dict[str, float]()
    for name, before in old.items():
        if before.dtype.kind != "f":
            continue
        after = new.get(name)
        if after is None or after.shape != before.shape:
            found[name] = np.inf
            continue
        both = np.isfinite(before) & np.isfinite(after)
        if (np.isfinite(before) != both).any():
            found[name] = np.inf
        elif both.any():
            size = float(np.clip(np.ptp(before[both]), SMALLEST, LARGEST))
            found[name] = float(np.abs(before - after)[both].max()) / size
    return found


def print_differences(old: Path, new: Path, only: list[str]) -> None:
    """Print the largest differences of results of the same names."""
    for name in names(only):
        if not (old / f"{name}.nc").exists() or not (new / f"{name}.nc").exists():
            print(f"{name:22} no result of that name in both folders")
            continue
        found = differences(variables(old / f"{name}.nc"), variables(new / f"{name}.nc"))
        worst = sorted(found, key=lambda each: -found[each])[:3]
        words = ", ".join(f"{each} {found[each]:.1e}" for each in worst)
        print(f"{name:22} {len(found)} variables, largest differences: {words}")


def print_times(old: str, new: str, cases: list[str], repeats: int) -> None:
    """Print the least time of each case with two interpreters, and the ratio."""
    print(f"{'case':30} {'old':>10} {'new':>10} {'new / old':>10}")
    for case in cases:
        workers = [worker(python, case) for python in (old, new)]
        found: list[list[float]] = [[], []]
        for _ in range(repeats):
            for each, values in zip(workers, found, strict=True):
                values.append(asked(each))
        for each in workers:
            each.stdin.close()
            each.wait()
        before, after = (min(values) for values in found)
        print(f"{case:30} {before:10.3g} {after:10.3g} {after / before:10.2f}", flush=True)


def worker(python: str, case: str) -> Any:
    """Start a process that times a case on request."""
    process = subprocess.Popen(
        [python, "-c", WORKER, case, str(PROBLEMS)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    if process.stdout.readline().strip() != "ready":
        raise SystemExit(f"{python}: {case} did not start")
    return process


def asked(process: Any) -> float:
    """Return one measured time [s]."""
    process.stdin.write("\n")
    process.stdin.flush()
    return float(json.loads(process.stdout.readline()))


if __name__ == "__main__":
    main()
