"""Freeze the results of all commands and shipped problems, and compare two frozen states.

``python benchmarks freeze run OUT [--only PATTERN] [--source SRC]`` runs the commands of
``.ci/commands.py`` and a list of faulty commands, two at a time, and stores for each its exit code,
JSON object, messages and the arrays of the files it writes. PATTERN is a regular expression of
command lines; SRC is the source folder of another checkout. The problems are those that its
``slipfree examples`` copies.

``python benchmarks freeze compare OLD NEW`` prints a line for each command: the largest
difference of its arrays in units of the solver tolerance, ``max |a - b| / (tolerance * max(1, max
|a|))``. Below it are the variables that differ by more than one tolerance or exist in one state
only, the values of the JSON object that differ (numbers by more than 1e-6 and 1e-9, relative and
absolute), and other exit codes and messages. CPU times are left out. The exit code is 1 if a
command differs.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import importlib.util
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import netcdf_file

ROOT = Path(__file__).parents[1]
PROCESSES = 2
RELATIVE, ABSOLUTE = 1e-6, 1e-9  # differences of numbers in JSON objects below which they agree
TOLERANCE = 1e-8, 1e-6  # default of the solver; of dynamics
SHOWN = 12  # largest number of differences printed for a command
NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
# CPU and wall times: in sentences, as keys and as columns
TIMES = re.compile(
    rf"{NUMBER} (?:x real time|m?s CPU|s, of which {NUMBER} s|s of search)"
    rf"|(?<=iterations, ){NUMBER} s"
)
TIME_KEY = re.compile(r"seconds|cpu|wall|date|history", re.IGNORECASE)
FAULTY = """
check missing.toml
check problems
check problems/ice.asc
check problems/skid_steer_log.csv
rum problems/paper_direct.toml
run problems/paper_direct.toml --durration 3
run problems/paper_direct.toml --set time.duration
run problems/paper_direct.toml -o missing/out.nc --no-draw
check problems/paper_direct.toml --set verb=drive
check problems/paper_direct.toml --set model=dynamic
check problems/paper_direct.toml --set vehicle.catalogue=three_wheeler
check problems/paper_direct.toml --set vehicle.catalog=three_weeler
check problems/paper_direct.toml --set vehicle.axle=loose
check problems/paper_direct.toml --set vehicle.r2=-0.25
check problems/paper_direct.toml --set vehicle=
check problems/paper_direct.toml --set time.duration=3s
check problems/paper_direct.toml --set time.duration=-1
check problems/paper_direct.toml --set time.step=0
check problems/paper_direct.toml --set solver.tolerance=1
check problems/paper_direct.toml --set solver.tolerance=1e-20
check problems/paper_direct.toml --set start.x=1e6
check problems/paper_direct.toml --set start.heading=north
check problems/paper_direct.toml --set inputs.left_rte=0.3
check problems/paper_direct.toml --set inputs.left_rate=
check problems/paper_direct.toml --set terrain.synthetic= --set terrain.file=missing.tif
check problems/paper_direct.toml --set terrain.synthetic= --set terrain.file=problems/ice.txt
check problems/paper_direct.toml --set terrain.synthetic.spacing=-1
check problems/paper_direct.toml --set terrain.synthetic.x=[5,-5]
check problems/traction_ice.toml --set terrain.friction=-0.1
check problems/traction_ice.toml --set terrain.friction=
check problems/dynamics_ice.toml --set terrain.friction=missing.asc
check problems/dynamics_ice.toml --set vehicle.file=vehicles/missing.toml
check problems/dynamics_ice.toml --set frame=ros
check problems/paper_inverse.toml --set given.velocity_z=0.1
check problems/paper_inverse.toml --set given.heading_rate=
check problems/paper_inverse.toml --set steering=angles
check problems/plan_tilt_limits.toml --set goal.y=100
check problems/plan_tilt_limits.toml --set goal.z=1
check problems/plan_tilt_limits.toml --set goal=
check problems/plan_tilt_limits.toml --set costs.slipp=1
check problems/plan_tilt_limits.toml --set limits.steer=[1,-1]
check problems/plan_tilt_limits.toml --set bounds.right_rate=2
check problems/plan_tilt_limits.toml --set plan.intervals=0
check problems/plan_tilt_limits.toml --set plan.degree=2.5
run problems/plan_tilt_limits.toml --no-draw --set plan.intervals=10 --set plan.duration=2
run problems/plan_tilt_limits.toml --no-draw --resume problems/ice.asc
run problems/paper_direct.toml --no-draw --set start.x=4.9 --set time.duration=60
run problems/fit_skid_steer.toml
fit problems/paper_direct.toml
fit problems/fit_skid_steer.toml --set data.file=missing.csv
fit problems/fit_skid_steer.toml --set unknowns.radius_left.quantity=radii
fit problems/fit_skid_steer.toml --set data.rates.front_left_rate=links
compare problems/paper_direct.toml
vehicle problems/vehicles/missing.toml
info missing.nc
info problems/ice.asc
report missing.nc
export missing.nc --path path.csv
track missing.nc
new drive drive
sweep problems/paper_direct.toml -o swept
sweep problems/paper_direct.toml --vary inputs.left_rte=0.3,0.5 -o swept
sweep problems/paper_direct.toml --vary inputs.left_rate= -o swept
pareto problems/paper_direct.toml --against effort --points 3
"""


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    actions = parser.add_subparsers(dest="action", required=True)
    freeze = actions.add_parser("run")
    freeze.add_argument("out", type=Path)
    freeze.add_argument("--only", default="", metavar="PATTERN")
    freeze.add_argument("--source", type=Path, default=ROOT / "src")
    comparison = actions.add_parser("compare")
    comparison.add_argument("old", type=Path)
    comparison.add_argument("new", type=Path)
    options = parser.parse_args()
    if options.action == "compare":
        sys.exit(print_comparison(options.old, options.new))
    run_all(options.out.resolve(), options.only, options.source.resolve())


def run_all(out: Path, only: str, source: Path) -> None:
    """Run the commands that match a pattern, with those that precede them, and store the states."""
    out.mkdir(parents=True, exist_ok=True)
    listed = load_commands()
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(PROCESSES) as pool:
        work = Path(folder)
        path = os.pathsep.join(filter(None, (str(source), os.environ.get("PYTHONPATH"))))
        settings = {"PYTHONPATH": path, "SLIPFREE_CACHE": f"{work}/cache", "OMP_NUM_THREADS": "1"}
        environment = {**os.environ, **settings, "COLUMNS": "100", "NO_COLOR": "1"}
        copy = [*slipfree_words(), "examples", "--to", "problems"]
        subprocess.run(copy, cwd=work, env=environment, check=True, capture_output=True)
        faulty = [[listed.slipfree(line)] for line in FAULTY.strip().splitlines()]
        groups = [*listed.all_commands(work / "problems"), *faulty]
        groups = [group for group in groups if any(re.search(only, each.name) for each in group)]

        def freeze(number: int, group: list[Any]) -> Iterator[str]:
            own = work / f"{number}"
            shutil.copytree(work / "problems", own / "problems")
            for command in group:
                state, arrays = run_command(command, own, environment, (source, str(work)))
                store(out, command.name, state, arrays)
                yield f"exit code {state['code']}, {len(arrays):4} arrays  {command.name}"
            shutil.rmtree(own)

        tasks = [pool.submit(lambda *a: list(freeze(*a)), *each) for each in enumerate(groups)]
        for task in as_completed(tasks):
            print(*task.result(), sep="\n", flush=True)


def load_commands() -> Any:
    """Return the module ``.ci/commands.py``."""
    spec = importlib.util.spec_from_file_location("commands", ROOT / ".ci" / "commands.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def slipfree_words() -> list[str]:
    """Return the beginning of a command line of slipfree, for this interpreter."""
    return [sys.executable, "-m", "slipfree"]


def run_command(
    command: Any, folder: Path, environment: dict[str, str], places: tuple[Path, str]
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return exit code, output and tolerance of a command, and the arrays of its files by name."""
    before = times_of(folder)
    words = list(command.words)
    if Path(words[0]).name == "slipfree":
        words = [*slipfree_words(), "--json", *words[1:]]
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)
    source, work = places

    def normalised(text: str) -> str:
        for place in (f"{folder.resolve()}/", f"{folder}/", str(source), work):
            text = text.replace(place, "")
        return text

    try:
        output = json.loads(normalised(done.stdout))
    except ValueError:
        output = {"text": normalised(done.stdout)}
    written = [name for name, t in times_of(folder).items() if before.get(name) != t]
    state = {
        "line": command.name,
        "code": done.returncode,
        "tolerance": tolerance_of(command.name, folder),
        "output": output,
        "messages": normalised(done.stderr),
        "written": sorted(name for name in written if "cache" not in name),
    }
    arrays = {
        f"{name}: {variable}": values
        for name in sorted(written)
        if Path(name).suffix in (".nc", ".csv")
        for variable, values in read(folder / name).items()
    }
    return state, arrays


def times_of(folder: Path) -> dict[str, int]:
    """Return the times of change of the files in a folder by name. [ns]."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {path.relative_to(folder).as_posix(): path.stat().st_mtime_ns for path in files}


def tolerance_of(line: str, folder: Path) -> float:
    """Return the solver tolerance of a command."""
    words = shlex.split(line)
    for word in words:
        if word.startswith("solver.tolerance="):
            return float(word.partition("=")[2])
    files = [folder / word for word in words if word.endswith(".toml")]
    for word in words:  # the problem of a result
        if word.endswith(".nc"):
            files.append(folder / "problems" / f"{Path(word).stem}.toml")
    for file in files:
        try:
            problem = tomllib.loads(file.read_text("utf-8"))
        except (OSError, ValueError):
            continue
        default = TOLERANCE[problem.get("model") == "dynamics"]
        return float(problem.get("solver", {}).get("tolerance", default))
    return TOLERANCE[0]


def read(path: Path) -> dict[str, np.ndarray]:
    """Return the variables of a result or the columns of a table, without times of computing."""
    if path.suffix == ".nc":
        with netcdf_file(path, mmap=False) as file:
            found = {name: np.array(each.data) for name, each in file.variables.items()}
    else:
        with path.open(encoding="utf-8", newline="") as file:
            head, *rows = list(csv.reader(file)) or [[]]
        found = {}
        for k, name in enumerate(head):
            column = [row[k] if k < len(row) else "" for row in rows]
            try:
                found[name] = np.array([float(word or "nan") for word in column])
            except ValueError:
                found[name] = np.array(column)
    found = {name: a.astype("U") if a.dtype.kind == "S" else a for name, a in found.items()}
    return {name: array for name, array in found.items() if not TIME_KEY.search(name)}


def store(out: Path, line: str, state: dict[str, Any], arrays: dict[str, np.ndarray]) -> None:
    """Write the state of a command."""
    mark = hashlib.sha1(line.encode(), usedforsecurity=False).hexdigest()[:8]
    name = f"{re.sub(r'[^A-Za-z0-9]+', '_', line)[:60]}_{mark}"
    (out / f"{name}.json").write_text(json.dumps(state, indent=1), "utf-8")
    np.savez_compressed(out / f"{name}.npz", **{"/": np.array(list(arrays))}, **number(arrays))


def number(arrays: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return the arrays by number; names of variables are no names of files."""
    return {f"a{k}": values for k, values in enumerate(arrays.values())}


def load(out: Path) -> dict[str, tuple[dict[str, Any], Path]]:
    """Return the states in a folder and the files of their arrays by command line."""
    states = ((json.loads(f.read_text("utf-8")), f.with_suffix(".npz")) for f in out.glob("*.json"))
    return {state["line"]: (state, file) for state, file in sorted(states, key=lambda s: s[1])}


def load_arrays(file: Path) -> dict[str, np.ndarray]:
    """Return the stored arrays of a command by name."""
    with np.load(file) as stored:
        return {str(name): stored[f"a{k}"] for k, name in enumerate(stored["/"])}


def print_comparison(old: Path, new: Path) -> int:
    """Print the differences of two states; return 1 if there are any."""
    before, after = load(old), load(new)
    counts = {"equal": 0, "within the tolerance": 0, "different": 0}
    for line in dict.fromkeys([*before, *after]):
        if line not in before or line not in after:
            print(f"{line}\n    only in {old if line in before else new}")
            counts["different"] += 1
            continue
        (a, a_file), (b, b_file) = before[line], after[line]
        gaps, differences = compare_arrays(load_arrays(a_file), load_arrays(b_file), a["tolerance"])
        if a["code"] != b["code"]:
            differences.insert(0, f"exit code: {a['code']} -> {b['code']}")
        for key in ("output", "messages", "written"):
            differences += compare_values(a[key], b[key], "" if key == "output" else key)
        worst = max(gaps, key=gaps.__getitem__, default="")
        largest = gaps.get(worst, 0.0)
        told = f"{largest:.2g} tolerances ({worst})" if largest else "0"
        print(f"{line}: {told if gaps else 'no arrays'}, {len(differences)} differences")
        for difference in differences[:SHOWN]:
            print(f"    {difference}")
        if len(differences) > SHOWN:
            print(f"    and {len(differences) - SHOWN} more")
        kind = "different" if differences else "within the tolerance" if largest else "equal"
        counts[kind] += 1
    print(f"{sum(counts.values())} commands: {', '.join(f'{n} {k}' for k, n in counts.items())}")
    return int(counts["different"] > 0)


def compare_arrays(
    old: dict[str, np.ndarray], new: dict[str, np.ndarray], tolerance: float
) -> tuple[dict[str, float], list[str]]:
    """Return differences of arrays in tolerances by name, and sentences on those that differ."""
    gaps = {name: gap(old[name], new[name], tolerance) for name in old if name in new}
    worst = sorted((name for name in gaps if gaps[name] > 1), key=lambda name: -gaps[name])
    return gaps, [
        *(f"{name} only in the old state" for name in old if name not in new),
        *(f"{name} only in the new state" for name in new if name not in old),
        *(
            f"{name} {old[name].shape}: {gaps[name]:.2g} tolerances"
            if old[name].shape == new[name].shape
            else f"{name}: shape {old[name].shape} -> {new[name].shape}"
            for name in worst
        ),
    ]


def gap(a: np.ndarray, b: np.ndarray, tolerance: float) -> float:
    """Return the largest difference in tolerances; infinite if the arrays cannot be compared."""
    if a.shape != b.shape or (a.dtype.kind == "U") != (b.dtype.kind == "U"):
        return np.inf
    if a.dtype.kind == "U":
        return 0.0 if np.array_equal(a, b) else np.inf
    a, b = a.astype(float), b.astype(float)
    finite = np.isfinite(a)
    if not np.array_equal(a[~finite], b[~finite], equal_nan=True):
        return np.inf
    a, b = a[finite], b[finite]
    size = max(1.0, np.abs(a).max(initial=0.0))
    return float(np.abs(a - b).max(initial=0.0) / (tolerance * size))


def compare_values(old: Any, new: Any, key: str) -> list[str]:
    """Return sentences on the differences of two JSON values."""
    if TIME_KEY.search(key.rpartition(".")[2]):
        return []
    if isinstance(old, dict) and isinstance(new, dict):
        names = dict.fromkeys([*old, *new])
        missing = [
            f"{key}.{name} only in the {'old' if name in old else 'new'} state".lstrip(".")
            for name in names
            if name not in old or name not in new
        ]
        shared = (name for name in names if name in old and name in new)
        deeper = [compare_values(old[n], new[n], f"{key}.{n}".lstrip(".")) for n in shared]
        return [*missing, *(each for inner in deeper for each in inner)]
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        deeper = [
            compare_values(a, b, f"{key}[{k}]")
            for k, (a, b) in enumerate(zip(old, new, strict=True))
        ]
        return [each for inner in deeper for each in inner]
    if isinstance(old, str) and isinstance(new, str):
        pattern = re.compile(NUMBER)
        old, new = TIMES.sub("TIME", old), TIMES.sub("TIME", new)
        alike = pattern.sub("#", old) == pattern.sub("#", new) and all(
            agree(float(a), float(b))
            for a, b in zip(pattern.findall(old), pattern.findall(new), strict=True)
        )
    elif isinstance(old, int | float) and isinstance(new, int | float):
        alike = agree(old, new)
    else:
        alike = old == new
    return [] if alike else [f"{key}: {old!r} -> {new!r}"]


def agree(a: float, b: float) -> bool:
    """Return whether two numbers agree."""
    return a == b or abs(a - b) <= max(ABSOLUTE, RELATIVE * max(abs(a), abs(b)))


if __name__ == "__main__":
    main()
