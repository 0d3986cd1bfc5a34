"""Vehicles with pressed wheels: steps per metre, and plans.

``python benchmarks rigid [drive|plan ...]``
"""

from __future__ import annotations

import time
from dataclasses import replace

import casadi as ca
import numpy as np
from common import run_parts

from slipfree import (
    Analytic,
    Bicubic,
    Grid,
    LeastSlip,
    Mesh,
    Path,
    Search,
    catalog,
    direct_kinematics,
    follow,
    plan,
    settle,
    simulate,
)
from slipfree.models.kinematics import SMOOTHING, pressed_dae
from slipfree.solve.system import SolverOptions

ROBOTS = {
    "rigid four wheels": catalog.rigid_skid_steer(),
    "rigid six wheels": catalog.rigid_skid_steer(axles=3),
    "four wheels, rocker": catalog.skid_steer(),
    "three-wheeler": catalog.three_wheeler(axle="fixed"),
}
LENGTH = 100.0  # [m]
GOAL = {"x": 0.5, "y": 4.8}


def hills(rms: float, sine=np.sin, seed: int = 3, count: int = 14):
    """Return a height function: waves of 1 to 4 m with a root mean square [m]."""
    rng = np.random.default_rng(seed)
    lengths, ways = rng.uniform(1, 4, count), rng.uniform(0, 2 * np.pi, count)
    phases, size = rng.uniform(0, 2 * np.pi, count), rms * np.sqrt(2 / count)
    k = 2 * np.pi / lengths

    def height(x, y):
        waves = zip(k * np.cos(ways), k * np.sin(ways), phases, strict=True)
        return sum(size * sine(a * x + b * y + phase) for a, b, phase in waves)

    return height


def hills_map(rms: float, across: float, along: float) -> Bicubic:
    """Return hills as a map with nodes 0.1 m apart."""
    x, y = np.arange(-across, across, 0.1), np.arange(-3.0, along, 0.1)
    return Bicubic(Grid(x, y, hills(rms)(*np.meshgrid(x, y, indexing="ij"))))


def pressed(vehicle, terrain, share=1 / 50, smoothing=SMOOTHING):
    """Return the model of pressed wheels with a static depth in rolling radii."""
    wheels = tuple(replace(w, static_depth=share * w.radius) for w in vehicle.wheels)
    return pressed_dae(replace(vehicle, wheels=wheels), terrain, LeastSlip(), smoothing)


def forward(model, vehicle, speed: float, weave: float = 0.0):
    """Return inputs that drive forward at a speed, with an oscillating difference of the sides."""
    swing = weave * ca.cos(0.5 * model.t)
    rates = {
        f"{w.name}_rate": speed / w.radius * (1 - swing * np.sign(w.at[0]))
        for w in vehicle.wheels
        if w.driven
    }
    others = [label.full for label in model.labels.u.joints]
    return model.inputs(**rates, **dict.fromkeys(others, 0.0))


def drives() -> None:
    """Print steps and times per metre over rough ground."""
    print(f"\n{LENGTH:g} m at 1 m/s, weaving; tolerance 1e-8 | 1e-6: steps/m, ms/m integrated")
    for rms in (0.02, 0.05):
        ground = hills_map(rms, 25.0, LENGTH + 5)
        for name, vehicle in ROBOTS.items():
            model, words = pressed(vehicle, ground), []
            start = settle(model)
            for tolerance in (1e-8, 1e-6):
                clock = time.perf_counter()
                run = simulate(
                    model,
                    start,
                    forward(model, vehicle, 1.0, 0.2),
                    np.linspace(0, LENGTH, 101),
                    options=SolverOptions(tolerance=tolerance),
                )
                spent = 1e3 * (time.perf_counter() - clock)
                steps = run.statistics["steps"] / LENGTH
                end = "" if run.stop is None else f" ended: {run.stop.words}"
                words.append(f"{steps:.0f}, {spent / LENGTH:.1f}{end}")
            print(f"rms {rms:g} {name:22} {' | '.join(words)}")


def plans() -> None:
    """Print plans of a rigid four-wheeler: cold, on flat ground, and `follow`."""
    vehicle = ROBOTS["rigid four wheels"]
    print("\nplan over 5 m: iterations, s; slip; end missed at the sharp law, ten times stiffer")
    for rms in (0.02, 0.05):
        ground = Analytic(hills(rms, ca.sin), mu=0.8)
        flat = Analytic(lambda x, y: 0 * x + 0 * y, mu=0.8)
        found = {
            name: _planned(vehicle, under) for name, under in (("plan", ground), ("flat", flat))
        }
        for name, made in found.items():
            for width, each in made.items():
                ends = [_replayed(vehicle, ground, each, k) for k in (1, 10)]
                print(f"rms {rms:g} {name}, width {width}: {' '.join(ends)}")
        print(f"rms {rms:g} follow: {_followed(vehicle, ground)}")


def _planned(vehicle, ground):
    """Return plans with increasingly sharp load laws, by width, each from the previous one."""
    names, made, saved = [f"{w.name}_rate" for w in vehicle.wheels], {}, None
    for width in (1.0, 0.3, 0.1):
        model = direct_kinematics(vehicle, ground, smoothing=width)
        start = settle(model)
        guess = simulate(model, start, forward(model, vehicle, 1.0), np.linspace(0, 5, 51))
        clock = time.perf_counter()
        found = plan(
            model,
            start,
            guess,
            goal=GOAL,
            costs={"slip": 100.0, "effort": 0.001},
            duration=8.0,
            inputs=dict.fromkeys(names, (-12.0, 12.0)),
            smooth=1e-4,
            mesh=Mesh(40, accuracy=5e-3),
            search=Search(resume=saved),
        )
        spent = time.perf_counter() - clock
        count = sum(stage.iterations for stage in found.stages)
        print(f"  width {width}: {count} iterations, {spent:.1f} s, accurate: {found.accurate}")
        made[width], saved = found, found.saved
    return made


def _replayed(vehicle, ground, made, factor: float) -> str:
    """Return slip and missed distance of a plan's inputs with stiffer wheels."""
    model = pressed(vehicle, ground, 1 / 50 / factor)
    run = simulate(model, settle(model), made.inputs, made.motion.ends)
    missed = np.hypot(run["x"][-1] - GOAL["x"], run["y"][-1] - GOAL["y"])
    return f"{_slip(run)}, missed {1e3 * missed:.1f} mm;"


def _followed(vehicle, ground) -> str:
    """Return the slip of the driving law along a straight path to the goal."""
    model = pressed(vehicle, ground)
    start = settle(model)
    path = Path(np.array([[0.0, 0.0], [0.2, 2.4], [GOAL["x"], GOAL["y"]]]))
    law = follow(model, path, speed=np.hypot(*GOAL.values()) / 8.0)
    run = simulate(model, start, law, np.linspace(0, 8, 81))
    missed = np.hypot(run["x"][-1] - GOAL["x"], run["y"][-1] - GOAL["y"])
    return f"{_slip(run)}, missed {1e3 * missed:.1f} mm"


def _slip(run) -> str:
    slip = np.hypot(run["slip_along"], run["slip_across"])
    squares = np.trapezoid(slip**2, run.t, axis=0).mean() / run.t[-1]
    return f"rms slip {1e3 * np.sqrt(squares):.2f} mm/s"


def main() -> None:
    """Print the parts."""
    run_parts({"drive": drives, "plan": plans})
