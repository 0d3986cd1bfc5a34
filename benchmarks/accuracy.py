"""Accuracy of direct kinematics: references, scales, path following.

``python benchmarks accuracy [PART ...]``:

reference  another program's motion, good to 2e-10, at several tolerances
terrain    values and derivatives of a map against SciPy's spline
scales     all lengths of kinematic problems times 1e-6 to 1e6: largest difference of the scaled
           motion from that at scale 1, over all quantities and samples, in tolerances of 1e-8
follow     path following over 100 m of hills, with and without the tilt term of the law
body       clearance of bodies against dense sampling improved by Nelder and Mead's method, at 1000
           poses of three vehicles and on rougher ground
"""

from __future__ import annotations

import json

import casadi as ca
import numpy as np
from common import TESTS, run_parts
from scipy.interpolate import NdBSpline, RectBivariateSpline

from helpers.scale_cases import CASES, difference
from helpers.shaped import SHAPED, settled_poses
from slipfree import (
    Bicubic,
    Grid,
    Path,
    SlipfreeError,
    SolverOptions,
    Trajectory,
    direct_kinematics,
    follow,
    settle,
    simulate,
)
from slipfree.catalog import three_wheeler
from slipfree.control import path_following as laws
from slipfree.core.lookups import LookupTable, lookup_function
from slipfree.terrain.synthetic import blank, power_law

DATA = TESTS / "data"
NAMES = ("x", "y", "heading", "tilt_right", "tilt_left", "z")
RATES = {"right_rate": 0.5, "left_rate": 0.4, "steer_rate": 0.0}
SCALES = (1e-6, 1e-4, 1e-3, 1e-2, 1e-1, 1e1, 1e2, 1e3, 1e4, 1e6)
WIDTH = 9  # of a column
WAY = np.array([(0, 0), (25, 3), (50, 0), (75, -3), (100, 0)], dtype=float)
SPEED = 0.5  # [m/s]


def reference_motion() -> None:
    """Compare with the motion of another program, good to 2e-10, at several tolerances."""
    nodes = np.load(DATA / "case1.npz")
    terrain = Bicubic(Grid(nodes["x"], nodes["y"], nodes["z"]))
    case = json.loads((DATA / "case1.json").read_text())
    expected = {name: np.array(case["state"].get(name, case.get(name))) for name in NAMES}
    dae = direct_kinematics(three_wheeler(), terrain)
    start, tolerances = settle(dae), 10.0 ** -np.arange(5, 13)
    errors = []
    for tolerance in tolerances:
        run = simulate(
            dae,
            start,
            dae.inputs(**RATES),
            np.array(case["t"]),
            options=SolverOptions(tolerance=tolerance),
        )
        errors.append(max(np.abs(run[name] - expected[name]).max() for name in NAMES))
        print(
            f"reference motion, tolerance {tolerance:.0e}: error {errors[-1]:.1e}, "
            f"{run.statistics['steps']:.0f} steps, closure residual "
            f"{run['closure_residual'].max():.1e} m, Newton step "
            f"{run['newton_step'].max() / tolerance:.2g} x the tolerance"
        )
    slope = np.polyfit(np.log(tolerances[:-1]), np.log(errors[:-1]), 1)[0]
    print(f"error against tolerance, 1e-5 to 1e-11: slope {slope:.2f}")


def terrain() -> None:
    """Compare the terrain's value and derivatives with SciPy's spline at random points."""
    rng = np.random.default_rng(1)
    x, y = np.linspace(0, 4, 41), np.linspace(-1, 2, 31)
    z = rng.standard_normal((41, 31))
    ground = Bicubic(Grid(x, y, z))
    t_x, t_y, c = RectBivariateSpline(x, y, z, s=0).tck
    exact = NdBSpline((t_x, t_y), c.reshape(41, 31), 3)
    knots = np.meshgrid(x[:-1], y[:-1], indexing="ij")
    edges = np.concatenate([np.full(500, 4.0), rng.uniform(0, 4, 500)])
    sets = {
        "10 000 random points": (rng.uniform(0, 4, 10_000), rng.uniform(-1, 2, 10_000)),
        "all knots, right-hand": (knots[0].ravel(), knots[1].ravel()),
        "last edges": (edges, np.concatenate([rng.uniform(-1, 2, 500), np.full(500, 2.0)])),
    }
    for name, (a, b) in sets.items():
        worst = derivative_errors(ground, exact, a, b)
        print(
            f"terrain against SciPy, value to third derivatives, {name}: {worst:.1e} of the largest"
        )


def derivative_errors(ground: Bicubic, exact: NdBSpline, a: np.ndarray, b: np.ndarray) -> float:
    """Return the largest error of value and derivatives, relative to each one's largest size."""
    s = ca.SX.sym("s", 2)
    lookups = LookupTable()
    expression, o = ground.height(s[0], s[1], lookups), ground.origin
    worst = []
    for order in range(4):
        for k in range(order + 1):
            d = expression
            for axis in [0] * (order - k) + [1] * k:
                d = ca.gradient(d, s)[axis]
            function = lookup_function(lookups.lookups, "d", [s], [d])
            found = function.map(a.size)(np.vstack([a - o[0], b - o[1]]))
            want = exact(np.column_stack([a, b]), nu=(order - k, k))
            want = want - (o[2] if order == 0 else 0)
            worst.append(np.abs(np.array(found).ravel() - want).max() / np.abs(want).max())
    return max(worst)


def cell(first: Trajectory, name: str, scale: float) -> str:
    """Return the difference of a case at a scale as text of one column."""
    try:
        run = CASES[name](scale)
    except SlipfreeError:
        return "fails"
    if (run.stop and run.stop.name) != (first.stop and first.stop.name):
        return "stops"
    return f"{difference(first, run, scale)[1]:.1e}"


def scales() -> None:
    """Print a row for each case and a column for each scale."""
    print(f"{'largest difference [tolerances]':32}" + "".join(f"{s:>{WIDTH}g}" for s in SCALES))
    for name, motion in CASES.items():
        first = motion(1.0)
        cells = (cell(first, name, scale) for scale in SCALES)
        print(f"{name:32}" + "".join(f"{each:>{WIDTH}}" for each in cells), flush=True)


def cross_track(run: Trajectory, path: Path) -> float:
    """Return the largest distance of a sample from the path. [m]."""
    places = path.at(np.linspace(0, path.length, 20001))
    squares = (run["x"][:, None] - places.x) ** 2 + (run["y"][:, None] - places.y) ** 2
    return float(np.sqrt(squares.min(axis=1)).max())


def followed() -> None:
    """Print path following with and without the tilt term of the law."""
    ground = blank((-10.0, 110.0), (-30.0, 30.0), 0.25)
    ground = power_law(ground, rms=0.15, hurst=0.9, longest=20.0, shortest=6.0, seed=4)
    vehicle, path = three_wheeler(), Path(WAY)
    dae = direct_kinematics(vehicle, Bicubic(ground))
    place = path.at(np.zeros(1))
    start = settle(dae, heading=float(place.heading[0] - np.arctan(0.5 * place.curvature[0])))
    t, gain = np.linspace(0, path.length / SPEED, 401), laws.TILT_GAIN
    print(f"{path.length:.0f} m of hills, relief {np.ptp(ground.z):.2f} m, at {SPEED} m/s")
    for words, laws.TILT_GAIN in (("the law", gain), ("without the tilt term", 0.0)):
        run = simulate(dae, start, follow(dae, path, speed=SPEED), t)
        tilt = max(np.abs(run[f"tilt_{side}"]).max() for side in ("right", "left"))
        print(f"{words:22} largest tilt {tilt:.4f} rad, cross-track {cross_track(run, path):.4f} m")


def bodies() -> None:
    """Print errors of clearances."""
    for name, relief in (*((name, 0.03) for name in SHAPED), ("box", 0.06), ("box", 0.12)):
        count = 334 if relief < 0.05 else 100
        pairs = [
            (run["clearance_body"][0], exact)
            for run, exact in settled_poses(SHAPED[name], count, relief)
        ]
        values, exact = np.array(pairs).T
        errors = np.abs(values - exact)
        print(
            f"{name:7} relief {relief:.2f} m (rms), {count} poses: clearance {values.min():.3f} to "
            f"{values.max():.3f} m, largest error {errors.max():.1e} m, "
            f"{np.count_nonzero(errors > 1e-6)} above 1e-6 m"
        )


def main() -> None:
    """Print the parts."""
    run_parts(
        {
            "reference": reference_motion,
            "terrain": terrain,
            "scales": scales,
            "follow": followed,
            "body": bodies,
        }
    )
