"""Grounds, vehicles and motions shared by several tests."""

import json
import re
from functools import lru_cache
from pathlib import Path

import casadi as ca
import numpy as np

from slipfree import Bicubic, Grid, Region, SolverOptions, direct_kinematics, settle, simulate
from slipfree.catalog import rocky7, three_wheeler
from slipfree.core.lookups import LookupTable, lookup_function

ROOT = Path(__file__).parents[2]
DATA, PROBLEMS = ROOT / "tests" / "data", ROOT / "problems"
PAPER_RATES = {"right_rate": 0.5, "left_rate": 0.4, "steer_rate": 0.0}
BOUNDED_RATES = dict.fromkeys(("right_rate", "left_rate", "steer_rate"), (-2.0, 2.0))
LIGHT = {"mass": 0.0, "wheel_mass": 0.0}  # no forces: the motion alone
# What was compiled of a model serves every motion of it.
closure_model = lru_cache(maxsize=8)(direct_kinematics)


def extension(name: str) -> str:
    """Return the code of ``docs/howto/extend.md`` that defines a function."""
    blocks = re.findall(r"(?s)```python\n(.*?)```", (ROOT / "docs/howto/extend.md").read_text())
    (text,) = (text for text in blocks if f"def {name}(" in text)
    return text


def box(x_min: float, x_max: float, y_min: float, y_max: float) -> Region:
    """Return a rectangle to keep out of."""
    return Region.polygon(((x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max)))


def function_of(symbols, make):
    """Return a Function of the expressions that ``make`` returns for a table of lookups."""
    lookups = LookupTable()
    expressions = [ca.densify(each) for each in make(lookups)]
    return lookup_function(lookups.lookups, "f", symbols, expressions)


def hills(x, y):
    """Smooth hills, relief 0.4 m, about 2 m high."""
    rolling = 0.15 * ca.sin(0.9 * x + 0.3) * ca.cos(0.7 * y)
    return 2 + rolling + 0.05 * ca.sin(1.7 * y + 0.2 * x)


def rough_hills(half, count, noise, seed):
    """Hills with normal errors of the heights of ``count`` nodes along each side of a square."""
    axis = np.linspace(-half, half, count)
    x, y = np.meshgrid(axis, axis, indexing="ij")
    errors = noise * np.random.default_rng(seed).normal(size=x.shape)
    return Bicubic(Grid(axis, axis, np.array(hills(ca.DM(x), ca.DM(y))) + errors))


def case1():
    """The reference motion: ground, and samples by name."""
    grid = np.load(DATA / "case1.npz")
    reference = json.loads((DATA / "case1.json").read_text())
    samples = {name: np.array(values) for name, values in reference["state"].items()}
    samples |= {"z": reference["z"], "roll": reference["beta"], "pitch": reference["alpha"]}
    samples["t"] = np.array(reference["t"])
    contacts = np.array(reference["contacts"])  # (right x, right y, left x, ...) by sample
    samples["contact_x"], samples["contact_y"] = contacts[0::2].T, contacts[1::2].T
    return Bicubic(Grid(grid["x"], grid["y"], grid["z"])), samples


def straight_on(vehicle, terrain, rate, t):
    """Return a model of a three-wheeler, its start, and its motion at equal rates of the wheels."""
    dae = direct_kinematics(vehicle, terrain)
    start = settle(dae)
    inputs = dae.inputs(right_rate=rate, left_rate=rate, steer_rate=0.0)
    return dae, start, simulate(dae, start, inputs, t)


def drive(terrain, t, *, vehicle=None, rates=None, tolerance=1e-8, flags=(), **start):
    """Drive a vehicle, the paper's by default, at constant rates, the paper's by default."""
    dae = closure_model(vehicle or three_wheeler(), terrain)
    inputs = dae.inputs(**(rates or PAPER_RATES))
    options = {"options": SolverOptions(tolerance=tolerance), **dict(flags)}
    return simulate(dae, settle(dae, **start), inputs, t, **options)


@lru_cache
def rover_ground():
    """The rover-scale grid of wmrde (its notice is beside the file)."""
    values = np.array((DATA / "gridsurfdata.txt").read_text().strip(" \n,").split(","), float)
    (x0, x1, nx), (y0, y1, ny) = values[:3], values[3:6]
    z = values[6:].reshape(int(ny), int(nx)).T
    return Grid(np.linspace(x0, x1, int(nx)), np.linspace(y0, y1, int(ny)), np.array(z, order="C"))


def rocky_case(ground, r1=0.02, steer=0.0):
    """Rocky 7 on a ground: the model, its start and its inputs."""
    vehicle = rocky7(r1=r1, **LIGHT)
    dae = closure_model(vehicle, Bicubic(ground))
    steering = {f"steer_front_{side}": steer for side in ("right", "left")}
    rates = {f"{wheel.name}_rate": 0.5 / 0.065 for wheel in vehicle.wheels}
    inputs = dae.inputs(**rates, **{f"{name}_rate": 0.0 for name in steering})
    return dae, settle(dae, x=1.1, y=0.0, heading=-np.pi / 2, **steering), inputs


def rocky_run(ground, r1=0.02, steer=0.0, tolerance=1e-8, duration=10.0):
    """Return a motion of Rocky 7 at 0.5 m/s."""
    t = np.linspace(0, duration, 101)
    options = SolverOptions(tolerance=tolerance)
    return simulate(*rocky_case(ground, r1, steer), t, options=options)
