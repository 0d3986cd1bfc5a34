"""Run every command and every shipped problem in the environment of this Python.

``python .ci/commands.py`` works in a temporary folder, on all cores, and prints a line for each
command. After the first that fails it prints what that printed, and ends with exit code 1. With
``--few`` it runs those that use every package once.
"""

from __future__ import annotations

import os
import platform
import shlex
import subprocess
import sys
import tempfile
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor, as_completed
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

SLIPFREE = Path(sys.executable).with_name("slipfree")
STOPS_EARLY = (
    "paper_inverse",
    "traction_ice",
    "dynamics_tip_over",
)  # exit code 1 (docs/problems.md)
# Problems whose kinds of figures another one draws.
UNDRAWN = (
    "real_dem_rough paper_direct rover_rocks_direct your_vehicle path_inverse crab_inverse "
    "mecanum_inverse mecanum_direct "
    "dynamics_ledge dynamics_skid_turn dynamics_ice dynamics_step climb_step climb_stairs "
    "plan_rigid_hills plan_rigid_robot plan_tilt_limits plan_climb_ramp plan_real_dem"
)
COARSER = {
    # a notebook solves it as it is
    "plan_climb_ramp": "driver.paths=[[[0,-1.5],[2,4.5],[0,10.5]]] plan.intervals=20"
    " plan.accuracy=0.05 solver.tolerance=1e-6",
    "plan_long_dem": "goal.x=740 goal.y=2880",  # two windows; the others repeat them
}
FEW = ("real_dem_direct", "plan_parking")  # of --few: a map, figures and files; rsplan and IPOPT
PACKAGES = (
    "slipfree",
    "casadi",
    "numpy",
    "scipy",
    "matplotlib",
    "pydantic",
    "typer",
    "rich",
    "tomlkit",
    "platformdirs",
    "rsplan",
    "rasterio",
    "viser",
    "distributed",
    "xarray",
    "pandas",
)

# Commands that need the result of a problem, by its name: they follow its run, one after another.
AFTER = {
    "real_dem_direct": [
        "info real_dem_direct.nc",
        "info real_dem_direct.nc --problem",
        "report real_dem_direct.nc",
        "export real_dem_direct.nc --path path.csv --rates rates.csv",
        "export real_dem_direct.nc --path path.geojson",
        "export real_dem_direct.nc --mcap motion.mcap",
        "show real_dem_direct.nc --html real_dem_direct_scene.html",
    ],
    "plan_rigid_hills": [
        "run problems/plan_rigid_hills.toml --resume plan_rigid_hills.nc -o again.nc",
        "track plan_rigid_hills.nc --disturb heights=0.01 --period 1",
        "pareto problems/plan_rigid_hills.toml --against effort --points 3 --set plan.intervals=8"
        " --set costs.slip=1e3",
    ],
    "plan_tilt_limits": ["export plan_tilt_limits.nc --rates plan_rates.csv"],
}
ALSO = [  # of --few as well: a library that is compiled and kept, a file written by tomlkit
    ["run problems/paper_direct.toml --set solver.compiled=true --no-draw -o compiled.nc"]
]
OTHERS = [
    ["--version"],
    ["--json check problems/rover_inverse.toml"],
    ["check problems/plan_crater_field.toml"],
    ["ground problems/real_dem_rough.toml"],
    ["vehicle problems/rover_inverse.toml"],
    ["vehicle problems/vehicles/trailer.toml"],
    ["vehicle problems/vehicles/trike.toml"],
    ["export problems/vehicles/trike.toml --c onboard"],
    *(
        [f"new {kind} {kind}", f"run {kind}.toml --no-draw"]
        for kind in ("direct", "inverse", "plan")
    ),
    [
        "run problems/paper_direct.toml --cross-check --csv table.csv --set time.duration=2"
        " --no-draw -o crossed.nc"
    ],
    ["run problems/traction_ice.toml --set terrain.friction=0.9 --no-draw -o arrives.nc"],
    ["run problems/dynamics_skid_turn.toml --set model=quasi-static --no-draw -o slow_turn.nc"],
    [
        "run problems/climb_step.toml --set time.duration=0.5 --no-draw -o animated.nc",
        "show animated.nc --animation climb_step.gif",
    ],
    [
        "sweep problems/paper_direct.toml --vary inputs.left_rate=0.3,0.5"
        " --vary vehicle.axle=tilting,fixed --set time.duration=2 --processes 2 -o axles"
    ],
]
# The same in Python, for what needs an extra or a map: a result as a frame, a cluster to sweep on.
GEOTIFF = """
import numpy, rasterio
x, y = numpy.meshgrid(numpy.linspace(-4, 4, 81), numpy.linspace(4, -4, 81))
place = {"crs": "EPSG:32633", "transform": rasterio.Affine(0.1, 0, -4.05, 0, -0.1, 4.05)}
shape = {"width": 81, "height": 81, "count": 1, "dtype": "float32"}
with rasterio.open("problems/site.tif", "w", driver="GTiff", **shape, **place) as file:
    file.write((0.05 * numpy.sin(x) * numpy.cos(y)).astype("float32"), 1)
"""
FRAMES = """
from slipfree.files.netcdf import read
run = read("site.nc")
assert run.to_xarray().sizes["time"] == len(run.to_pandas()) == run.t.size
"""
SCHEDULER = """
import subprocess, sys
from distributed import LocalCluster
if __name__ == "__main__":
    with LocalCluster(1, threads_per_worker=1, host="127.0.0.1", dashboard_address=None) as cluster:
        command = [*sys.argv[1:], "--scheduler", cluster.scheduler_address]
        sys.exit(subprocess.run(command).returncode)
"""
MAP = "--set terrain.synthetic= --set terrain.file=site.tif"
SWEEP = "sweep problems/paper_direct.toml --repeat 2 --set time.duration=2 -o clustered"


class Command(NamedTuple):
    """Name, command line and expected exit code of a process."""

    name: str
    words: tuple[str, ...]
    code: int = 0


def slipfree(line: str, code: int = 0) -> Command:
    """Return the command of a command line of slipfree."""
    return Command(line, (str(SLIPFREE), *shlex.split(line)), code)


def python(name: str, code: str, *words: str) -> Command:
    """Return the command that runs a piece of Python."""
    return Command(name, (sys.executable, "-c", code, *words))


def run(command: Command) -> None:
    """Run a command; end with its output if it has another exit code than expected."""
    name, words, code = command
    begun = time.perf_counter()
    done = subprocess.run(words, text=True, capture_output=True)
    print(f"{time.perf_counter() - begun:6.1f} s  {name}", flush=True)
    if done.returncode != code or (code == 1 and "contains the result so far" not in done.stderr):
        told = f"exit code {done.returncode}, expected {code}: {name}"
        raise SystemExit(f"{done.stdout}{done.stderr}{told}")
    for line in done.stderr.splitlines():
        if "Warning" in line:
            print(f"          {line}", flush=True)


def problem(file: Path) -> list[Command]:
    """Return the commands of a shipped problem."""
    name = file.stem
    verb = tomllib.loads(file.read_text("utf-8"))["verb"]
    if verb in ("compare", "fit", "atlas"):
        return [slipfree(f"{verb} problems/{file.name}")]
    words = [f"run problems/{file.name}"]
    words += ["--no-draw"] if name in UNDRAWN.split() else []
    words += [f"--set {each}" for each in COARSER.get(name, "").split()]
    first = slipfree(" ".join(words), int(name in STOPS_EARLY))
    return [first, *(slipfree(line) for line in AFTER.get(name, []))]


def all_commands(problems: Path, *, few: bool = False) -> list[list[Command]]:
    """Return the commands, in groups of some that follow one another; slow groups first."""
    shipped = sorted(
        (file for file in problems.glob("*.toml") if not few or file.stem in FEW),
        key=lambda file: (file.stem[:4] != "plan" and file.stem not in AFTER, file),
    )
    return [
        *map(problem, shipped),
        *([slipfree(line) for line in lines] for lines in (ALSO if few else [*ALSO, *OTHERS])),
        [
            python("write a GeoTIFF", GEOTIFF),
            slipfree(f"run problems/paper_direct.toml {MAP} --no-draw -o site.nc"),
            python("make an xarray Dataset and a pandas DataFrame", FRAMES),
        ],
        [python(f"{SWEEP} --scheduler ...", SCHEDULER, str(SLIPFREE), *SWEEP.split())],
    ]


def in_turn(group: list[Command]) -> None:
    """Run commands one after another."""
    for command in group:
        run(command)


def versions() -> str:
    """Return the versions of Python and of what the commands use."""
    return ", ".join(
        [f"Python {platform.python_version()}", *(f"{n} {version(n)}" for n in PACKAGES)]
    )


def main() -> None:
    """Run all commands."""
    begun = time.perf_counter()
    print(versions())
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(os.cpu_count()) as pool:
        os.chdir(folder)
        os.environ["SLIPFREE_CACHE"] = str(Path(folder, "cache"))  # nothing compiled before
        run(slipfree("examples --to problems"))
        groups = all_commands(Path("problems"), few="--few" in sys.argv)
        try:
            for group in as_completed([pool.submit(in_turn, group) for group in groups]):
                group.result()
        finally:
            pool.shutdown(cancel_futures=True)
    print(f"{sum(map(len, groups)) + 1} commands, {time.perf_counter() - begun:.0f} s")


if __name__ == "__main__":
    main()
