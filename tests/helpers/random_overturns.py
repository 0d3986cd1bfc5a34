"""Random hang-ups and roll-overs of vehicles whose bodies bear load, by index."""

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import casadi as ca
import numpy as np

import slipfree as sf
from helpers.random_dynamics import TOLERANCE, Case, Ground, drawn_ground
from helpers.random_dynamics import ending as ending_of
from helpers.random_dynamics import told as told_of
from slipfree.vehicle.shapes import Box

SHAPES = {  # edges and centre of the platforms; their lower faces are lowered
    "skid_steer": ((0.3, 0.7, 0.3), (0.0, 0.0, 0.15)),
    "rocky7": ((0.26, 0.4, 0.2), (0.0, 0.1, 0.15)),
}
GROUNDS = ("ridge", "bank", "cliff", "rough")
FINITE = ("x", "y", "z", "body_load", "kinetic_energy", "contact_energy", "lost_energy")
DISTANCE = 2.5  # of a drive without slip [m]
LOADED, UPRIGHT = 0.05, 0.5  # load of bodies [weight]; vertical component of the platform's axis


@dataclass(frozen=True)
class Overturn(Case):
    """A random run of a vehicle whose bodies bear load; it may begin in the air."""

    law: sf.Compliant
    fall: dict[str, float]


def draw(index: int) -> Overturn:
    """Return the case of an index."""
    rng = np.random.default_rng([21, index])
    name, ground = str(rng.choice([*SHAPES])), GROUNDS[index % len(GROUNDS)]
    vehicle = getattr(sf.catalog, name)()
    radius = max(wheel.radius for wheel in vehicle.wheels)
    size, (x, y, z) = SHAPES[name]
    box = Box(size, (x, y, z - float(rng.uniform(0, 0.7)) * radius))
    body = replace(vehicle.body, shapes=(box,))
    if ground == "bank":  # with a load on top
        x, y, z = body.at
        body = replace(body, at=(x, y, z + float(rng.uniform(0.2, 0.5))))
    vehicle = replace(vehicle, body=body)
    speed = float(np.exp(rng.uniform(np.log(0.5), np.log(3.0))))
    turn, inputs = rng.uniform(-0.1, 0.1), dict[str, float]()
    for wheel in vehicle.wheels:
        inputs[f"{wheel.name}_rate"] = speed / wheel.radius * (1 + turn * np.sign(wheel.at[0]))
    for c in vehicle.coordinates:
        if c.kind == "commanded":
            inputs[f"{c.name}_rate"] = 0.0
    fall = dict[str, float]()
    if ground == "rough":  # in the air
        attitude = rng.standard_normal(4)
        attitude /= np.linalg.norm(attitude)
        fall = dict(zip((f"attitude_{k}" for k in "wxyz"), attitude.tolist(), strict=True))
        fall["z"] = float(rng.uniform(0.8, 1.3))
        for axis in "xyz":
            fall[f"velocity_{axis}"] = float(rng.uniform(-1, 1))
            fall[f"omega_{axis}"] = float(rng.uniform(-3, 3))
    return Overturn(
        f"{index}: {name}, {ground}, {speed:.3g} m/s",
        vehicle,
        drawn_obstacle(ground, radius, rng),
        speed,
        float(rng.uniform(-0.15, 0.15)),
        inputs,
        np.linspace(0, float(np.clip(DISTANCE / speed, 1.5, 4.0)), 61),
        sf.Compliant(body_depth=float(rng.uniform(1e-3, 4e-3))),
        fall,
    )


def drawn_obstacle(kind: str, radius: float, rng: Any) -> Ground:
    """Return a ground that hangs up or overturns a vehicle that drives forward from the origin.

    The radii of its hollows exceed that of the wheels, which then touch it once.
    """
    if kind == "rough":
        return drawn_ground("rough", radius, rng)
    constant, angle = float(rng.uniform(0.4, 1.0)), rng.uniform(-0.5, 0.5)
    sine, cosine = np.sin(angle), np.cos(angle)
    curvature = rng.uniform(0.2, 0.5) / radius

    def mu(x: Any, y: Any) -> Any:
        return constant + 0 * (x + y)

    if kind == "ridge":
        height, aside = rng.uniform(0.8, 2.5) * radius, rng.uniform(-0.1, 0.1)
        narrow = np.sqrt(0.9 * height / curvature)  # the curvature beside a Gaussian ridge
        wide = narrow * rng.uniform(1, 3)
        width, length = rng.permutation([narrow, wide])
        begin = 0.6 + 1.5 * length

        def ridge(x: Any, y: Any) -> Any:
            across, along = cosine * (x - aside) - sine * (y - begin), y - begin
            return height * ca.exp(-((across / width) ** 2) - (along / length) ** 2)

        return Ground(ridge, mu)
    if kind == "bank":  # a slope that begins beside the vehicle
        rise = np.tan(np.deg2rad(rng.uniform(45, 70)))
        edge, side = rise / 2 / curvature, abs(sine)

        def bank(x: Any, y: Any) -> Any:
            aside = cosine * x + side * y - 0.5
            return rise / 2 * (aside + ca.sqrt(aside**2 + edge**2))

        return Ground(bank, lambda x, y: 1.2 * mu(x, y))
    drop = rng.uniform(0.3, 1.5)
    edge = np.sqrt(0.39 * drop / curvature)
    return Ground(
        lambda x, y: -drop / 2 * (1 + ca.tanh((sine * x + cosine * y - 0.4) / edge - 2)), mu
    )


def run(case: Overturn, tolerance: float = TOLERANCE) -> sf.Trajectory:
    """Return the motion of a case."""
    model = sf.dynamics(case.vehicle, case.ground.terrain(), law=case.law)
    if case.fall:
        start = sf.settle(replace(model, standing=None), **case.fall)
    else:
        start = sf.settle(model, x=0.0, y=0.0, heading=case.heading, speed=case.speed)
    inputs = model.inputs(**case.inputs)
    return sf.simulate(model, start, inputs, case.t, options=sf.SolverOptions(tolerance))


def told(case: Overturn, motion: sf.Trajectory) -> tuple[str, str]:
    """Return kind and words of an ending, or on which side the vehicle is after its whole run."""
    if motion.stop is not None:
        return told_of(case, motion)
    if not all(np.isfinite(motion[name]).all() for name in FINITE):
        return "not finite", ""
    up = 1 - 2 * (motion["attitude_x"][-1] ** 2 + motion["attitude_y"][-1] ** 2)
    is_loaded = motion["body_load"][-1] > LOADED * case.vehicle.weight
    side = "upright" if up > UPRIGHT else "on its roof" if up < -UPRIGHT else "on its side"
    return f"{side}{', body on the ground' if is_loaded else ''}", ""


ending = partial(ending_of, run=run, told=told)  # of an overturn
