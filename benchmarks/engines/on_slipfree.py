"""slipfree: kinematics by IDAS, explicit steps and the batch; dynamics with compliant contacts."""

from __future__ import annotations

import tempfile
import time
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from scenes import Motion, Pose, Scene, share
from scipy.spatial.transform import Rotation

from slipfree import (
    Analytic,
    Bicubic,
    Compliant,
    Grid,
    Solids,
    SolverOptions,
    direct_kinematics,
    dynamics,
    read_vehicle,
    rollouts,
    settle,
    simulate,
)
from slipfree.core.dae import PiecewiseLinear
from slipfree.terrain.solids import placed
from slipfree.terrain.solids import step as step_of

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-8)
SERIES: dict[str, list[dict[str, Any]]] = {
    "slipfree, IDAS": [{"tolerance": each} for each in TOLERANCES],
    "slipfree, explicit": [{"tolerance": each, "method": "explicit"} for each in TOLERANCES],
    "slipfree, batch": [{"step": each} for each in (0.5, 0.25, 0.12, 0.06, 0.03)],
    "slipfree, dynamics": [{"tolerance": each, "creep": 1e-3} for each in TOLERANCES],
    "slipfree, stiff": [{"tolerance": each, "creep": 1e-5, "depth": 6e-5} for each in TOLERANCES],
}
LANES = 1016  # motions side by side in the batch


@cache
def vehicle_of(urdf: str) -> Any:
    """Return the vehicle of a text."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "vehicle.urdf")
        file.write_text(urdf)
        return read_vehicle(file)


def start_of(model: Any, scene: Scene) -> Any:
    """Return the vehicle at rest at the start of a scene."""
    x, y, heading = scene.start
    return settle(model, x=x, y=y, heading=heading - np.pi / 2)


def poses(run: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and rotations of the root link."""
    turned = Rotation.from_quat(np.column_stack([run[f"quaternion_{k}"] for k in "xyzw"]))
    return np.column_stack([run[k] for k in "xyz"]), turned.as_matrix()


def model_of(scene: Scene, creep: float | None, depth: float | None) -> Any:
    """Return dynamics with a creep speed [m/s] and static depth [m], or kinematics."""
    vehicle = vehicle_of(scene.urdf)
    wheels = tuple(replace(wheel, static_depth=depth) for wheel in vehicle.wheels)
    vehicle = replace(vehicle, wheels=wheels)
    if not scene.slabs:
        ground: Any = Bicubic(Grid(scene.x, scene.y, scene.nodes), mu=scene.friction)
    else:
        ground = Analytic(lambda x, _: 0 * x, mu=scene.friction)
        if steps := [placed(step_of(z), x=x, heading=-np.pi / 2) for x, z in scene.slabs[1:]]:
            ground = Solids(ground, tuple(prism for each in steps for prism in each))
    if creep is None and isinstance(ground, Solids):
        raise ValueError("kinematics ends where a wheel touches twice")
    if creep is None:
        return direct_kinematics(vehicle, ground)
    return dynamics(
        vehicle, ground, law=Compliant(creep=creep, slip_stiffness=scene.slip_stiffness)
    )


def signal_of(scene: Scene, model: Any, rate: Any) -> Any:
    """Return the rate of a wheel as an input: a formula, or linear between samples."""
    if not np.ndim(rate):
        return rate * share(model.t, ca)
    slope = np.diff(rate) / np.diff(scene.t)
    return PiecewiseLinear(rate[:-1] - slope * scene.t[:-1], slope)


def motion(
    scene: Scene,
    pose: Pose,  # noqa: ARG001 - found by `settle`
    tolerance: float = 1e-8,
    step: float | None = None,
    method: Any = None,
    creep: float | None = None,
    depth: float | None = None,
) -> Motion:
    """Return the motion of a scene, or its rest."""
    model = model_of(scene, creep, depth)
    start = start_of(model, scene)
    if scene.raised and (method is not None or step is not None):
        raise ValueError("a rest has no steps")
    if scene.raised:
        begin = time.process_time()
        start = start_of(model, scene)
        return Motion(time.process_time() - begin, *poses(start))
    if creep or (method is None and step is None):
        rates = {name: signal_of(scene, model, rate) for name, rate in scene.rates.items()}
    else:  # constant in each interval, with the same angles at the samples
        fine = np.linspace(0, scene.t[-1], 20 * scene.t.size - 19)
        means = scene.rates_at((fine[:-1] + fine[1:]) / 2).reshape(scene.t.size - 1, 20, -1).mean(1)
        rates = dict(zip(scene.rates, means.T, strict=True))
    inputs = {f"{k}_rate": rate for k, rate in rates.items()}
    if step is None:
        options = SolverOptions(tolerance=tolerance, method=method, compiled=True)
        for _ in range(2):  # the first one compiles
            run = simulate(model, start, model.inputs(**inputs), scene.t, options=options)
        return Motion(run.statistics["cpu_seconds"], *poses(run))
    lanes = {k: np.tile(v, (LANES, 1)) for k, v in inputs.items()}
    for _ in range(2):
        begin = time.process_time()
        many = rollouts(model, [start] * LANES, lanes, scene.t, method="batch", step=step)
        seconds = time.process_time() - begin
    return Motion(seconds / LANES, *poses({k: many[k].values[0] for k in many}))
