"""Random vehicles, drives, grounds and speeds for dynamics, by index, and how their runs end."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

import slipfree as sf
from slipfree.geometry.frame import unit_vector
from slipfree.terrain.base import Terrain
from slipfree.terrain.synthetic import power_law
from slipfree.vehicle.tree import EARTH_GRAVITY, Drive

VEHICLES = ("three_wheeler", "differential_drive", "ackermann", "skid_steer", "rigid_skid_steer")
VEHICLES += ("articulated", "rocky7", "open_source_rover")
GROUNDS = ("hills", "map", "rough", "ledge", "ice", "slope", "steep")
TOLERANCE = 1e-6
SLIDING = 0.99  # utilisation of a wheel that slides
LONGEST, SHORTEST = 0.8, 0.2  # duration [s]
WAY = 0.5  # way that a duration between these covers [m]


@dataclass(frozen=True)
class Case:
    """A random run: vehicle, ground, forward speed, heading, inputs by name and times."""

    words: str
    vehicle: sf.Vehicle
    ground: Ground
    speed: float
    heading: float
    inputs: dict[str, float]
    t: np.ndarray


def draw(index: int) -> Case:
    """Return the case of an index."""
    rng = np.random.default_rng([20, index])
    name, ground = str(rng.choice(VEHICLES)), str(rng.choice(GROUNDS))
    speed = float(np.exp(rng.uniform(np.log(0.05), np.log(4.0))))
    vehicle = getattr(sf.catalog, name)()
    drives = str(rng.choice(["rate", "torque", "motor", "mixed"]))
    radius = max(wheel.radius for wheel in vehicle.wheels)
    terrain = drawn_ground(ground, radius, rng)
    share = vehicle.mass * EARTH_GRAVITY / len(vehicle.wheels)
    wheels, inputs = [], {}
    turn = rng.uniform(-0.3, 0.3)
    for wheel in vehicle.wheels:
        kind = str(rng.choice(["rate", "torque", "motor"])) if drives == "mixed" else drives
        if wheel.driven:
            wheel = replace(wheel, drive=drawn_drive(kind, share * wheel.radius, speed, wheel, rng))
            side = 1 + turn * np.sign(wheel.at[0])
            value = float(rng.uniform(-0.2, 0.6)) * share * wheel.radius
            rate = speed / wheel.radius * side
            torque = isinstance(wheel.drive, sf.Torque)
            inputs[f"{wheel.name}_{'torque' if torque else 'rate'}"] = value if torque else rate
        wheels.append(wheel)
    for c in vehicle.coordinates:
        if c.kind == "commanded":
            inputs[f"{c.name}_rate"] = float(rng.uniform(-0.3, 0.3))
    duration = float(np.clip(WAY / speed, SHORTEST, LONGEST))
    words = f"{index}: {name}, {drives}, {ground}, {speed:.3g} m/s"
    vehicle = replace(vehicle, wheels=tuple(wheels))
    heading = float(rng.uniform(-np.pi, np.pi))
    return Case(words, vehicle, terrain, speed, heading, inputs, np.linspace(0, duration, 21))


def drawn_drive(kind: str, torque: float, speed: float, wheel: Any, rng: Any) -> Drive:
    """Return a drive for a wheel whose share of the weight times its radius is ``torque``."""
    if kind != "motor":
        return {"rate": sf.Rate(), "torque": sf.Torque()}[kind]
    stall, fast = torque * rng.uniform(0.2, 2), speed / wheel.radius * rng.uniform(1.2, 4)
    rotor = float(rng.choice([0.0, 0.01]))
    return sf.Motor(float(stall), float(fast), float(stall), float(rng.choice([0, stall])), rotor)


@dataclass(frozen=True)
class Ground:
    """A ground that can be mirrored and turned: heights as a formula or a grid, and friction."""

    heights: Callable[[Any, Any], Any] | sf.Grid
    mu: Callable[[Any, Any], Any]

    def terrain(self, view: str = "as drawn") -> Terrain:
        """Return the ground as drawn, ``"mirrored"`` at x = 0, or ``"turned"`` by 90 degrees."""

        def of(function: Callable[[Any, Any], Any]) -> Callable[[Any, Any], Any]:
            if view == "mirrored":
                return lambda x, y: function(-x, y)
            return function if view == "as drawn" else lambda x, y: function(y, -x)

        if not isinstance(self.heights, sf.Grid):
            return sf.Analytic(of(self.heights), mu=of(self.mu))
        x, y, z = self.heights.x, self.heights.y, self.heights.z
        if view == "mirrored":
            return sf.Bicubic(sf.Grid(-x[::-1], y, z[::-1]), mu=of(self.mu))
        turned = sf.Grid(-y[::-1], x, z.T[::-1]) if view == "turned" else self.heights
        return sf.Bicubic(turned, mu=of(self.mu))


def drawn_ground(kind: str, radius: float, rng: Any) -> Ground:
    """Return a ground of a kind, for wheels of a radius."""
    phase, constant = rng.uniform(0, 2 * np.pi, 2), float(rng.uniform(0.3, 1.0))

    def mu(x: Any, y: Any) -> Any:
        return constant + 0 * (x + y)

    if kind in ("map", "rough"):
        half, spacing = (60 * radius, 1.5 * radius) if kind == "map" else (40 * radius, radius / 2)
        axis = spacing * np.arange(-round(half / spacing), round(half / spacing) + 1)
        rms = radius * rng.uniform(0.1, 0.5)
        flat = sf.Grid(axis, axis, np.zeros((axis.size, axis.size)))
        sizes = {"hurst": 0.8, "longest": 40 * radius, "shortest": 12 * radius}
        return Ground(power_law(flat, rms=rms, seed=int(rng.integers(1000)), **sizes), mu)
    if kind == "ledge":
        height, width = rng.uniform(0.5, 3) * radius, rng.uniform(2, 4) * radius
        return Ground(lambda x, y: -height / 2 * (1 + ca.tanh(ca.hypot(x, y) / width - 3)), mu)
    if kind == "ice":
        return Ground(
            lambda x, y: 0.02 * radius * ca.sin(x / radius / 3) * ca.cos(y / radius / 4),
            lambda x, _: 0.02 + 0.3 * (1 + ca.tanh(5 * x / radius)),
        )
    if kind in ("slope", "steep"):
        low, high = (5, 25) if kind == "slope" else (35, 55)
        rise = np.tan(np.deg2rad(rng.uniform(low, high)))
        return Ground(lambda x, y: rise * (x * np.cos(phase[0]) + y * np.sin(phase[0])), mu)
    amplitude, k = radius * rng.uniform(0.1, 0.4), 1 / (radius * rng.uniform(2.5, 8))
    return Ground(lambda x, y: amplitude * ca.sin(k * x + phase[0]) * ca.cos(k * y + phase[1]), mu)


def mirrored(vehicle: sf.Vehicle) -> sf.Vehicle:
    """Return a vehicle mirrored at its plane x = 0, with the same names and positive rates."""

    def point(at: Any) -> tuple[float, float, float]:
        return -at[0], at[1], at[2]

    def axis(given: Any) -> tuple[float, float, float]:  # of a rotation
        x, y, z = unit_vector(given)
        return x, -y, -z

    def body(given: sf.Body) -> sf.Body:
        inertia = given.inertia
        if inertia is not None:
            xx, yy, zz, xy, xz, yz = inertia
            inertia = xx, yy, zz, -xy, -xz, yz
        return replace(given, at=point(given.at), inertia=inertia)

    joints = []
    for joint in vehicle.joints:
        along = axis(joint.axis)
        if joint.motion == "slide":
            along = -along[0], -along[1], -along[2]
        roll, pitch, yaw = joint.turned
        places = {"at": point(joint.at), "turned": (roll, -pitch, -yaw)}
        joints.append(replace(joint, axis=along, body=body(joint.body), **places))
    wheels = [replace(each, at=point(each.at), axle=axis(each.axle)) for each in vehicle.wheels]
    return replace(vehicle, joints=tuple(joints), wheels=tuple(wheels), body=body(vehicle.body))


def run(case: Case, view: str = "as drawn", tolerance: float = TOLERANCE) -> sf.Trajectory:
    """Return the motion of a case, or of its mirror image, or turned by 90 degrees."""
    vehicle = mirrored(case.vehicle) if view == "mirrored" else case.vehicle
    heading = {"as drawn": 1, "mirrored": -1, "turned": 1}[view] * case.heading
    heading += np.pi / 2 * (view == "turned")
    model = sf.dynamics(vehicle, case.ground.terrain(view))
    start = sf.settle(model, x=0.0, y=0.0, heading=heading, speed=case.speed)
    inputs = model.inputs(**case.inputs)
    return sf.simulate(model, start, inputs, case.t, options=sf.SolverOptions(tolerance))


def difference(case: Case, view: str) -> float:
    """Return how far the motion in another view is from the mirrored or turned one [m].

    Motions are compared until a wheel leaves the ground or slides, since then they may diverge.
    """
    one, other = run(case), run(case, view)
    x, y = (-other["x"], other["y"]) if view == "mirrored" else (other["y"], -other["x"])
    steady = (one["force_normal"].min(1) > 0) & (one["utilisation"].max(1) < SLIDING)
    count = min(one.t.size, other.t.size, int(np.argmin([*steady, False])) + 1)
    gaps = [one["x"][:count] - x[:count], one["y"][:count] - y[:count]]
    gaps.append(one["z"][:count] - other["z"][:count])
    return float(np.abs(gaps).max())


class Ending(NamedTuple):
    """How a run ends: kind, words, and the error of its energy balance over its bound."""

    kind: str
    words: str
    ledger: float = 0.0


def told(_: Any, motion: sf.Trajectory) -> tuple[str, str]:
    """Return kind and words of the end of a motion."""
    if motion.stop is None:
        return "complete", ""
    return motion.outcome.name.lower(), f"{motion.stop.name}: {motion.stop.words}"


def ending(
    case: Any,
    run: Callable[[Any], sf.Trajectory] = run,
    told: Callable[[Any, sf.Trajectory], tuple[str, str]] = told,
    tolerance: float = TOLERANCE,
) -> Ending:
    """Return how the run of a case ends."""
    try:
        motion = run(case)
    except sf.SolverError as error:
        return Ending("failure", str(error), ledger(error.trajectory, tolerance))
    except sf.SlipfreeError as error:
        return Ending("refused", str(error))
    return Ending(*told(case, motion), ledger(motion, tolerance))


def ledger(motion: sf.Trajectory, tolerance: float = TOLERANCE) -> float:
    """Return the largest error of the energy balance, over 100 x tolerance x energy.

    The energy is one joule, since the tolerance of the work is absolute too, and the largest of
    work, lost energy, kinetic energy and change of potential energy.
    """
    kinetic, potential, contact = (
        motion[f"{name}_energy"] for name in ("kinetic", "potential", "contact")
    )
    total, work, lost = kinetic + potential + contact, motion["work"], motion["lost_energy"]
    error = np.abs(total - total[0] - work + lost).max()
    energy = 1 + max(np.abs(work).max(), lost.max(), kinetic.max(), np.ptp(potential))
    return float(error / (100 * tolerance * energy))
