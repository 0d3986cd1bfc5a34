"""Read and drive published URDFs, and count the completions that they need.

``python benchmarks/robots.py FOLDER`` prints for each URDF of a folder the reasons of a refusal,
the lines that follow the advice of the message, the number of notes and guesses, and a drive of 5 m
straight on over rough ground, with kinematics and with dynamics. The heights have an rms of a third
of the smallest driven wheel's radius R, and wavelengths of 15 R to 60 R.
"""

from __future__ import annotations

import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from reference import heading

from slipfree import SlipfreeError
from slipfree.problem.build_vehicle import read_vehicle
from slipfree.problem.load import load_problem
from slipfree.problem.solve import run_problem
from slipfree.vehicle.tree import Vehicle

LENGTH, SPEED = 5.0, 0.3  # [m], [m/s]
REMEDIES = {"scout_mini": "radius = 0.08"}  # line that the message asks for, a round figure
PROBLEM = """
verb = "direct"
model = "{model}"
frame = "rep103"
[terrain]
friction = 0.7
[terrain.synthetic]
x = [{low!r}, {high!r}]
y = [{low!r}, {high!r}]
spacing = {spacing!r}
[terrain.synthetic.power_law]
rms = {rms!r}
hurst = 0.8
longest = {longest!r}
shortest = {shortest!r}
seed = 1
[vehicle]
file = "{file}"
[start]
x = 0.0
y = 0.0
heading = 0.0
[driver]
name = "straight"
speed = {speed!r}
[time]
duration = {duration!r}
step = 0.05
"""


def main(folder: Path) -> None:
    """Print the table of a folder."""
    heading()
    plain = completed = 0
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() == ".urdf")
    for path in paths:
        print(f"\n{path.name}: slipfree vehicle {path.name}")
        with tempfile.TemporaryDirectory() as work:
            file = path.resolve()
            try:
                vehicle = read_vehicle(file)
                plain += 1
            except SlipfreeError as error:
                print(f"  refused: {str(error).splitlines()[0].replace(str(file), path.name)}")
                lines = REMEDIES.get(path.stem)
                if lines is None:
                    continue
                print(f"  with: {lines}")
                completion = Path(work) / "robot.toml"
                completion.write_text(f'urdf = "{file}"\n{lines}\n')
                vehicle, file = read_vehicle(completion), completion
                completed += 1
            guesses = sum("guessed" in note for note in vehicle.notes)
            print(
                f"  {len(vehicle.wheels)} wheels of {_radii(vehicle)} m, {vehicle.mass:.4g} kg, "
                f"{len(vehicle.notes)} notes, {guesses} of them guesses"
            )
            for model in ("", "dynamics"):
                print(f"  {model or 'no inertia'}: {_driven(file, Path(work), vehicle, model)}")
    print(f"\n{plain} of {len(paths)} as they are, {completed} with one line")


def _radii(vehicle: Vehicle) -> str:
    return ", ".join(f"{radius:.4g}" for radius in sorted({each.radius for each in vehicle.wheels}))


def _driven(file: Path, work: Path, vehicle: Vehicle, model: str) -> str:
    """Return the outcome of a drive of 5 m."""
    radius = min(wheel.radius for wheel in vehicle.wheels if wheel.driven)
    half = 1.5 * radius * np.ceil(1.5 * LENGTH / (1.5 * radius))
    text = PROBLEM.format(
        model=model,
        spacing=1.5 * radius,
        low=float(-half),
        high=float(half),
        rms=radius / 3,
        longest=60 * radius,
        shortest=15 * radius,
        file=file,
        speed=SPEED,
        duration=LENGTH / SPEED,
    )
    (work / "p.toml").write_text(text if model else text.replace('model = ""\n', ""))
    began = time.perf_counter()
    try:
        run = run_problem(load_problem(work / "p.toml")).trajectory
    except SlipfreeError as error:
        return f"refused: {str(error).splitlines()[0]}"
    spent = time.perf_counter() - began
    way = float(np.hypot(np.diff(run["x"]), np.diff(run["y"])).sum())
    stop = "" if run.stop is None else f" ({run.stop.words})"
    return f"{way:.2f} m, heights {np.ptp(run['z']):.3f} m, {run.outcome.name}{stop}, {spent:.1f} s"


if __name__ == "__main__":
    main(Path(sys.argv[1]))
