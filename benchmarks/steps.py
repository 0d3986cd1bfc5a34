"""Steps: least friction with which vehicles climb them, in 3D and with inertia.

``python benchmarks steps [VEHICLE ...]`` prints, for vehicles, heights and headings, the least
coefficient of friction with which all wheels reach the top of a step. ``python benchmarks steps
check`` repeats two rows at a finer tolerance, at lower speeds and with harder wheels.

The wheels turn at the rate of 0.2 m/s, the vehicle starts 50 mm before the step, and the friction
is that of floor and step. Coefficients are tried upwards in steps of 0.16, and then by bisection to
0.04; a dash means that none up to 1.28 suffices. The results are those of simulations at one speed
with equal rates of all wheels, and no guarantee: success is not monotonic in the coefficient.

The quasi-static value is the largest along the climb of the least coefficient that an optimal
distribution of the torques needs, without inertia and with rigid wheels. For a rigid vehicle with
two driven axles it follows from three forces that meet in a point: gravity, and the forces of the
ground on both axles. For the seven-wheel vehicle it is
`slipfree.climb.contact_path.least_friction`.
"""

from __future__ import annotations

import sys
import time
from dataclasses import replace
from functools import cache, lru_cache
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from slipfree import Analytic, ModelError, SolverError, SolverOptions, catalog, dynamics, settle
from slipfree.climb.contact_path import least_friction
from slipfree.core.dae import Dae
from slipfree.core.trajectory import Trajectory
from slipfree.models.samples import is_on_top
from slipfree.solve.simulate import simulate
from slipfree.terrain.solids import Solids, placed, step
from slipfree.vehicle.tree import Vehicle

RESOLUTION, LANES = 0.04, 32  # step of the coefficient of friction [1], and number of steps
SCAN = 4  # lanes between the first tries
LANE = 10.0  # width of a lane of constant friction; one model serves all coefficients [m]
CLEARANCE = 0.05  # of the first wheel from the step at the start [m]
WAY = 2.2  # distance that the rims travel at most [lengths of the vehicle]
SAMPLES_PER_SECOND = 10
HEADINGS: dict[str, tuple[float, ...]] = {  # of other vehicles: zero [degrees]
    "rigid_skid_steer": (0.0, 20.0),
    "rocky7": (0.0, 20.0),
}
VEHICLES = {
    "rigid_skid_steer": catalog.rigid_skid_steer(),
    "skid_steer": catalog.skid_steer(),
    "rocky7": catalog.rocky7(),
    "open_source_rover": catalog.open_source_rover(),
    "seven_wheels": catalog.seven_wheels(wheel_mass=0.4),
}
TWO_AXLES = ("rigid_skid_steer", "skid_steer")  # both driven, rigid at heading zero
LOW, HIGH = (0.25, 0.5, 0.75), (0.5, 1.0, 1.4)  # heights of steps [radii]
CHECKS = (("rigid_skid_steer", 0.25), ("rocky7", 1.0))  # rows at other settings


class Setting(NamedTuple):
    """Speed of the rims [m/s], tolerance, and static depth of the wheels if changed [radii]."""

    speed: float = 0.2
    tolerance: float = 1e-5
    depth: float | None = None


class Case(NamedTuple):
    """A vehicle of `VEHICLES` by name, height of the step [m], heading [rad] and setting."""

    name: str
    height: float
    heading: float
    setting: Setting = Setting()


def vehicle_of(case: Case) -> Vehicle:
    """Return the vehicle of a case."""
    vehicle, depth = VEHICLES[case.name], case.setting.depth
    if depth is None:
        return vehicle
    wheels = (replace(each, static_depth=depth * each.radius) for each in vehicle.wheels)
    return replace(vehicle, wheels=tuple(wheels))


@cache
def at_rest(name: str, heading: float, depth: float | None) -> Trajectory:
    """Return a vehicle at rest on a floor."""
    vehicle = vehicle_of(Case(name, 0.0, heading, Setting(depth=depth)))
    model = dynamics(vehicle, Analytic(lambda x, y: 0 * (x + y), mu=1.0))
    return settle(model, x=0.0, y=0.0, heading=heading)


class Course(NamedTuple):
    """Model of a vehicle before a step, its inputs, and the times [s]."""

    model: Dae
    inputs: Any
    t: np.ndarray


@lru_cache(maxsize=1)
def course(case: Case) -> Course:
    """Return the model of a vehicle before a step, in lanes of ascending friction."""
    vehicle, rest = vehicle_of(case), at_rest(case.name, case.heading, case.setting.depth)
    radius = max(wheel.radius for wheel in vehicle.wheels)
    ahead, behind = rest["center_y"].max() + radius, radius - rest["center_y"].min()
    lanes = Analytic(lambda x, y: 0 * (x + y), mu=lambda x, _: RESOLUTION * ca.floor(x / LANE))
    model = dynamics(vehicle, Solids(lanes, placed(step(case.height), y=ahead + CLEARANCE)))
    inputs = {label.full: 0.0 for part in model.labels.u for label in part}
    for wheel in vehicle.wheels:
        if wheel.axle == "x" and wheel.driven:
            inputs[f"{wheel.name}_rate"] = case.setting.speed / wheel.radius
    duration = WAY * (ahead + behind) / case.setting.speed / np.cos(case.heading)
    t = np.linspace(0, duration, int(duration * SAMPLES_PER_SECOND) + 1)
    return Course(model, model.inputs(**inputs), t)


def climbs(case: Case, lane: int) -> bool:
    """Return whether all wheels reach the top of a step in a lane."""
    model, inputs, t = course(case)
    rest = at_rest(case.name, case.heading, case.setting.depth)
    x = rest.columns["x"]
    x = x._replace(values=x.values + (lane + 0.5) * LANE)
    beside = replace(rest, columns={**rest.columns, "x": x})
    options = SolverOptions(tolerance=case.setting.tolerance)
    try:
        run = simulate(model, beside, inputs, t, options=options)
    except (SolverError, ModelError) as error:
        print(
            f"  ({case.name}, {case.height:g} m, {RESOLUTION * lane:g}: {error})", file=sys.stderr
        )
        return False
    return bool(is_on_top(run, VEHICLES[case.name], case.height).all(axis=1).any())


def least(case: Case) -> float | None:
    """Return the least coefficient of friction that suffices; None if none does."""
    high = next((lane for lane in range(SCAN, LANES + 1, SCAN) if climbs(case, lane)), None)
    if high is None:
        return None
    low = high - SCAN
    while high - low > 1:
        middle = (low + high) // 2
        if climbs(case, middle):
            high = middle
        else:
            low = middle
    return RESOLUTION * high


def quasi_static(name: str, height: float) -> float:
    """Return the least coefficient with which two rigid driven axles can rest along a climb."""
    vehicle, rest = VEHICLES[name], at_rest(name, 0.0, None)
    radius, y = vehicle.wheels[0].radius, rest["center_y"][0]
    front = y > y.mean()
    length = y[front].mean() - y[~front].mean()
    loads = rest["force_normal"][0]
    behind = length * loads[front].sum() / loads.sum()
    above = rest["potential_energy"][0] / vehicle.weight - radius
    needed = []
    for front_climbs in (True, False):
        for rise, normal in _rises(height, radius):
            pitch = np.arcsin((rise if front_climbs else height - rise) / length)
            c, s = np.cos(pitch), np.sin(pitch)
            rear, ahead = np.zeros(2), length * np.array([c, s])
            center = behind * np.array([c, s]) + above * np.array([-s, c])
            up = np.array([0.0, 1.0])
            normals = [up, normal] if front_climbs else [normal, up]
            points = [rear - radius * normals[0], ahead - radius * normals[1]]
            needed.append(_least_ratio(points, normals, float(center[0])))
    return max(needed)


def _rises(height: float, radius: float) -> list[tuple[float, np.ndarray]]:
    """Return rises of an axle that climbs, and normals (forward, up) of the step on its wheel."""
    wall = [(rise, np.array([-1.0, 0.0])) for rise in np.linspace(0, height - radius, 20)]
    first = np.arccos(max(1 - height / radius, 0.0))
    angles = np.linspace(first, 0, 60, endpoint=False)
    edge = [
        (height - radius + radius * np.cos(a), np.array([-np.sin(a), np.cos(a)])) for a in angles
    ]
    return [*(wall if height > radius else []), *edge]


def _least_ratio(points: list[np.ndarray], normals: list[np.ndarray], middle: float) -> float:
    """Return the least largest ratio of tangential to normal forces at two contacts.

    The forces meet on the vertical line through the centre of mass, at any height.
    """
    height = np.sinh(np.linspace(-9, 9, 20001)) * 0.01
    meeting = np.stack([np.full(height.size, middle), height], axis=-1)
    one, other = (meeting - point for point in points)
    cross = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        forces = [-other[:, 0] / cross, one[:, 0] / cross]  # their sum is (0, 1)
        ratios = []
        for force, way, normal in zip(forces, (one, other), normals, strict=True):
            pressed = force * (way @ normal)
            aside = force * (way[:, 0] * normal[1] - way[:, 1] * normal[0])
            ratios.append(np.where(pressed > 0, np.abs(aside) / pressed, np.inf))
    return float(np.maximum(*ratios).min())


def demand(name: str, height: float) -> float | None:
    """Return the quasi-static value of a row at heading zero; None if there is none."""
    if name in TWO_AXLES:
        return quasi_static(name, height)
    if name == "seven_wheels":  # two bodies and three axles in the plane
        return least_friction(catalog.step_climber(), step(height)).mu
    return None


def words(value: float | None) -> str:
    """Return a coefficient as text, or a dash without one."""
    return "   -" if value is None else f"{value:4.2f}"


def rows(name: str) -> list[float]:
    """Return the heights of a vehicle's steps [m]."""
    radius = max(wheel.radius for wheel in VEHICLES[name].wheels)
    return [ratio * radius for ratio in (LOW if name in TWO_AXLES else HIGH)]


def table(names: list[str]) -> None:
    """Print the least coefficients of vehicles."""
    print(f"{'vehicle':18} {'step':>14} {'0 deg':>7} {'20 deg':>7} {'quasi-static, 0 deg':>20}")
    for name in names:
        begin = time.perf_counter()
        radius = max(wheel.radius for wheel in VEHICLES[name].wheels)
        for height in rows(name):
            headings = np.deg2rad(HEADINGS.get(name, (0.0,)))
            found = [least(Case(name, height, float(each))) for each in headings]
            aside = words(found[1]) if found[1:] else ""
            known = demand(name, height)
            statics = "" if known is None else words(known)
            step_words = f"{1e3 * height:.0f} mm, {height / radius:.2f} R"
            shown = f"{words(found[0]):>7} {aside:>7} {statics:>20}"
            print(f"{name:18} {step_words:>14} {shown}", flush=True)
        print(f"  {time.perf_counter() - begin:.0f} s", flush=True)


def check() -> None:
    """Print some rows at a finer tolerance, and at lower speeds."""
    settings = {
        "0.2 m/s, 1e-5": Setting(),
        "0.2 m/s, 1e-7": Setting(tolerance=1e-7),
        "0.05 m/s, 1e-5": Setting(speed=0.05),
        "0.05 m/s, 1e-5, depth R/500": Setting(speed=0.05, depth=1 / 500),
        "0.02 m/s, 1e-5, depth R/500": Setting(speed=0.02, depth=1 / 500),
    }
    for name, ratio in CHECKS:
        height = ratio * max(wheel.radius for wheel in VEHICLES[name].wheels)
        for label, setting in settings.items():
            found = words(least(Case(name, height, 0.0, setting)))
            print(f"{name:18} {1e3 * height:4.0f} mm, {label:28} {found}", flush=True)


def main() -> None:
    """Print the tables of the vehicles that are named, or of all."""
    if sys.argv[1:] == ["check"]:
        check()
    else:
        table(sys.argv[1:] or list(VEHICLES))
