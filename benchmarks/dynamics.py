"""Motions with inertia: cost, agreement with slow models and with MuJoCo.

``python benchmarks dynamics [PART ...]``:

search     CPU time of a search for the ground point nearest to a wheel: on a formula, on a map with
           the compiled search, and on a map without it
three_wheeler, car, rocky7
           a vehicle at four speeds, on a formula and on its bicubic map: steps, evaluations of the
           equations and of their Jacobian, and CPU time of the integration per metre, interpreted
           and compiled. The tolerance is the loosest of 1e-7 to 1e-4 for which, as for all tighter
           ones, the error against 1e-10 is below 0.1 mm.
mujoco     Rocky 7 in MuJoCo (extra ``bench``), on a height field with the nodes of our map, both
           from the pose in which MuJoCo comes to rest: the distance of the motions; CPU time per
           metre of MuJoCo by step size, with errors against the smallest one; and ours. The ends
           depend on contacts and facets, so further lines show stiffer contacts and finer nodes.
turns      four vehicles that turn over about 1 m of hills from rest: the distance between the ends
           of dynamics and of quasi-statics by speed, with a creep of 1 % of the speed in both laws,
           so that quasi-statics has the same path at every speed; its change divided by that of the
           squared speed; the distance between kinematics with least slip and quasi-statics. Ends of
           dynamics are taken 1 ms later, the time constant of its rates.
rough      a rigid four-wheeler, straight on over rough ground at 0.1 m/s: the distance of dynamics
           from kinematics with wheels pressed into the ground, and the wheels in the air in both

The time of the integration is that of `simulate` with two samples, the least of a few runs, minus
that of a run with a thousandth of the duration.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from common import run_parts
from mjcf import SOFTNESS, Motion, driven, mujoco_model, settled

from slipfree import (
    Analytic,
    Bicubic,
    Grid,
    SolverOptions,
    catalog,
    direct_kinematics,
    dynamics,
    quasi_statics,
    settle,
    simulate,
)
from slipfree.contact import touch
from slipfree.core.dae import Dae
from slipfree.core.trajectory import Trajectory, path_length
from slipfree.laws.compliant import Compliant
from slipfree.laws.coulomb import Coulomb
from slipfree.models.dynamics import LAG
from slipfree.terrain.base import Terrain
from slipfree.terrain.synthetic import power_law
from slipfree.vehicle.sections import Torus
from slipfree.vehicle.tree import Vehicle

SPEEDS = (0.1, 0.3, 1.0, 3.0)  # [m/s]
TOLERANCES = (1e-7, 1e-6, 1e-5, 3e-5, 1e-4)
EXACT, ALLOWED = 1e-10, 1e-4  # tolerance of the reference [1]; error [m]
MU, RISE = 0.8, 0.3  # friction [1]; time in which the rates rise [s]
REPEATS, PEER_REPEATS = 10, 3  # runs of which the least time counts: ours, MuJoCo's
SPACING, HALF = 0.1, 9.0  # of maps, and half their side [m]
QUESTIONS = 2000
FIELD, FINER, STIFF = 0.04, 0.02, 0.001  # of MuJoCo: spacing of nodes [m], contacts [s]
STEPS, SAMPLE = (0.00025, 0.0005, 0.001, 0.002), 0.02  # of MuJoCo; of the samples compared [s]
STIFFER = 10  # times stiffer contacts of ours, with as many times less creep
ORIGIN, SOFT = {"x": 0.0, "y": 0.0, "heading": 0.0}, Compliant()  # start; default law of contacts


def hills(x: Any, y: Any, lib: Any) -> Any:
    """Return the heights of smooth hills [m]."""
    long = 0.12 * lib.sin(2 * np.pi * x / 7) * lib.cos(2 * np.pi * y / 9)
    return long + 0.05 * lib.sin(2 * np.pi * (x + 0.6 * y) / 4.3)


def waves(x: Any, y: Any, lib: Any) -> Any:
    """Return the heights of waves of 20 mm, 0.8 m long, on longer ones [m]."""
    short = 0.02 * lib.sin(2 * np.pi * y / 0.8) * lib.cos(2 * np.pi * x / 1.1)
    return short + 0.05 * lib.sin(2 * np.pi * y / 3 + x)


Height = Callable[[Any, Any, Any], Any]
VEHICLES: dict[str, tuple[Vehicle, Height]] = {
    "three_wheeler": (catalog.three_wheeler(stiffness=150.0, damping=10.0), hills),
    "car": (catalog.ackermann(), hills),
    "rocky7": (catalog.rocky7(), waves),
}


def nodes(height: Height, spacing: float = SPACING) -> Grid:
    """Return the heights of a formula at the nodes of a map."""
    axis = np.arange(-HALF, HALF + spacing / 2, spacing)
    return Grid(axis, axis, height(axis[:, None], axis[None, :], np))


def grounds(height: Height) -> dict[str, Terrain]:
    """Return a formula and its map."""
    return {
        "formula": Analytic(lambda x, y: height(x, y, ca), mu=MU),
        "map": Bicubic(nodes(height), mu=MU),
    }


def search_times() -> None:
    """Print microseconds of CPU of one search, least of several runs over random poses."""
    section, radius = Torus(0.03, 0.12), 0.15
    formula, grid = grounds(hills).values()
    rng = np.random.default_rng(0)
    place, axle = rng.uniform(-8, 8, (2, QUESTIONS)), rng.standard_normal((3, QUESTIONS))
    axle[2] *= 0.2
    center = hills(*place, np) + radius + rng.uniform(-0.01, 0.01, QUESTIONS)
    asked = np.vstack([place, center, axle / np.linalg.norm(axle, axis=0)])
    searches = {
        "formula": (touch.search_function(formula, section, radius), 0.0),
        "map, compiled search": (touch.search_function(grid, section, radius), grid.origin[2]),
        "map, graph": (touch._search_graph(grid, section, radius), grid.origin[2]),
    }
    for name, (search, base) in searches.items():
        print(f"  {name:22} {least(search, asked - np.eye(6)[:, [2]] * base):6.2f} us a search")


def least(search: ca.Function, asked: np.ndarray) -> float:
    """Return the least CPU time of one search over several rounds [us]."""
    buffer, run = search.buffer()
    at, found = np.zeros(6), np.zeros(13)
    buffer.set_arg(0, memoryview(at))
    buffer.set_res(0, memoryview(found))
    times = []
    for _ in range(10):
        begin = time.process_time()
        for column in asked.T:
            at[:] = column
            run()
        times.append(time.process_time() - begin)
    return 1e6 * min(times) / asked.shape[1]


class Cost(NamedTuple):
    """Counts and CPU time [ms] of an integration per metre, and its error [m]."""

    steps: float
    evaluations: float
    jacobians: float
    cpu: float
    error: float
    tolerance: float


class Drive:
    """Vehicle that accelerates to a speed from rest, over 3 m, for at least 1.5 s."""

    def __init__(
        self, vehicle: Vehicle, ground: Terrain, speed: float, law: Compliant = SOFT, **place: float
    ) -> None:
        self.model = dynamics(vehicle, ground, law=law)
        self.start = settle(self.model, **(ORIGIN | place))
        rate = ca.tanh(self.model.t / RISE) * speed
        rates = {f"{wheel.name}_rate": rate / wheel.radius for wheel in vehicle.wheels}
        names = [label.full for part in self.model.labels.u for label in part]
        self.inputs = self.model.inputs(**{name: rates.get(name, 0.0) for name in names})
        self.duration = max(3.0 / speed, 1.5)

    def run(self, tolerance: float, samples: int = 2, part: float = 1.0, **more: Any) -> Trajectory:
        """Return the motion over a part of the duration."""
        t = np.linspace(0, self.duration * part, samples)
        options = SolverOptions(tolerance=tolerance, **more)
        return simulate(self.model, self.start, self.inputs, t, options=options)

    def cpu(self, tolerance: float, **more: Any) -> float:
        """Return the CPU time of the integration [s], without preparation and samples."""
        times = [
            [self.run(tolerance, 2, part, **more).statistics["cpu_seconds"] for part in (1.0, 1e-3)]
            for _ in range(REPEATS)
        ]
        whole, short = np.min(times, axis=0)
        return float(whole - short)


def loosest(drive: Drive) -> tuple[Cost, float]:
    """Return the cost at the loosest tolerance with an allowed error, and the path length [m]."""
    exact = drive.run(EXACT, 41)
    length = path_length(exact)
    for tolerance in TOLERANCES:
        run = drive.run(tolerance, 41)
        error = max(np.abs(run[name] - exact[name]).max() for name in "xyz")
        if error > ALLOWED:
            break
        counts = [run.statistics[name] / length for name in ("steps", "residuals", "set_ups")]
        cost = Cost(*counts, 0.0, error, tolerance)
    return cost._replace(cpu=1e3 * drive.cpu(cost.tolerance) / length), length


def vehicle_costs(name: str) -> None:
    """Print the costs of a vehicle."""
    vehicle, height = VEHICLES[name]
    counts = "steps + evaluations + Jacobians per metre"
    print(f"{name}: speed; formula, map: tolerance, error, {counts}, ms/m, compiled ms/m")
    for speed in SPEEDS:
        words = []
        for kind, ground in grounds(height).items():
            drive = Drive(vehicle, ground, speed)
            cost, length = loosest(drive)
            compiled = 1e3 * drive.cpu(cost.tolerance, compiled=True) / length
            words.append(
                f"{kind} {cost.tolerance:.0e} {1e3 * cost.error:.3f} mm {cost.steps:3.0f} + "
                f"{cost.evaluations:3.0f} + {cost.jacobians:2.0f} {cost.cpu:5.1f} {compiled:5.1f}"
            )
        print(f"  {speed:3g} m/s: " + "; ".join(words), flush=True)


class Peer:
    """MuJoCo's model of a vehicle on waves at its equilibrium, and its motions."""

    def __init__(self, vehicle: Vehicle, spacing: float, softness: float = SOFTNESS) -> None:
        grid = nodes(waves, spacing)
        self.vehicle, self.model = vehicle, mujoco_model(vehicle, grid, MU, softness)
        start = settle(dynamics(vehicle, Bicubic(grid, mu=MU)), **ORIGIN)
        self.state = settled(self.model, vehicle, start, STEPS[0])
        rest = Motion(self.state[None])
        places = (*rest.position[0, :2], rest.heading[0])
        self.place = dict(zip(ORIGIN, map(float, places), strict=True))

    def drive(
        self, speed: float, duration: float, step: float, repeats: int
    ) -> tuple[float, Motion]:
        """Return the least CPU time of a few motions [s], and the motion at the samples."""
        t = step * np.arange(round(duration / step))
        rates = [np.tanh(t / RISE) * speed / wheel.radius for wheel in self.vehicle.wheels]
        given = self.model, self.state, np.transpose(rates), step
        runs = [driven(*given) for _ in range(repeats)]
        return min(cpu for cpu, _ in runs), Motion(runs[0][1][:: round(SAMPLE / step)])


def states(run: Trajectory) -> np.ndarray:
    """Return time, position and quaternion of the platform in the form of MuJoCo's states."""
    names = ("x", "y", "z", *(f"attitude_{k}" for k in "wxyz"))
    return np.column_stack([run.t, *(run[name] for name in names)])


def apart(one: Motion, other: Motion) -> str:
    """Return the distance between the ends of two motions, across and along the heading."""
    x, y = 1e3 * (one.position[-1] - other.position[-1])[:2]
    c, s = np.cos(other.heading[-1]), np.sin(other.heading[-1])
    return f"{np.hypot(x, y):.1f} mm ({c * x + s * y:+.1f} aside, {c * y - s * x:+.1f} along)"


def rms(values: np.ndarray) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(values**2)))


def beside_mujoco() -> None:
    """Print the distance of Rocky 7's motions from MuJoCo's, and the costs of both."""
    import mujoco

    vehicle = VEHICLES["rocky7"][0]
    depths = [wheel.radius / 250 / STIFFER for wheel in vehicle.wheels]
    pairs = zip(vehicle.wheels, depths, strict=True)
    stiff = replace(vehicle, wheels=tuple(replace(w, static_depth=d) for w, d in pairs))
    law = Compliant(creep=SOFT.creep / STIFFER)
    peer = Peer(vehicle, FIELD)
    others = {
        f"with contacts of {1e3 * STIFF:g} ms, not {1e3 * SOFTNESS:g}": Peer(vehicle, FIELD, STIFF),
        f"with nodes {FINER} m apart": Peer(vehicle, FINER),
    }
    ground = Bicubic(nodes(waves, FIELD), mu=MU)
    print(f"rocky7 and MuJoCo {mujoco.__version__} on waves, nodes {FIELD} m apart")
    for speed in (0.3, 1.0):
        drive = Drive(vehicle, ground, speed, **peer.place)
        duration, samples = drive.duration, round(drive.duration / SAMPLE) + 1
        cost, length = loosest(drive)
        compiled = 1e3 * drive.cpu(cost.tolerance, compiled=True) / length
        ours = Motion(states(drive.run(EXACT, samples)))
        stiffer = Motion(states(Drive(stiff, ground, speed, law, **peer.place).run(EXACT, samples)))
        found = {step: peer.drive(speed, duration, step, PEER_REPEATS) for step in STEPS}
        theirs = found[STEPS[0]][1]
        higher = 1e3 * (theirs.position - ours.position)[:, 2]
        pitch = np.degrees(theirs.pitch - ours.pitch)
        print(
            f"  {speed} m/s, {length:.2f} m: MuJoCo ends {apart(theirs, ours)} from ours; "
            f"height {higher.mean():+.2f} mm, rms {rms(higher):.2f} mm; "
            f"pitch rms {rms(pitch):.3f} deg of {np.degrees(np.ptp(ours.pitch)):.0f}"
        )
        for words, other in others.items():
            motion = other.drive(speed, duration, STEPS[0], 1)[1]
            same = Motion(states(Drive(vehicle, ground, speed, **other.place).run(EXACT, samples)))
            print(f"    {words}: {apart(motion, same)} from ours")
        print(f"    {apart(theirs, stiffer)} from ours {STIFFER} times stiffer")
        for step, (cpu, motion) in found.items():
            error = 1e3 * np.abs(motion.position - theirs.position).max()
            took = 1e3 * cpu / length
            print(f"    MuJoCo {1e3 * step:4g} ms: error {error:.3f} mm, {took:5.1f} ms/m")
        print(
            f"    ours {cost.tolerance:.0e}: error {1e3 * cost.error:.3f} mm, {cost.steps:.0f} "
            f"steps/m, {cost.cpu:.1f} ms/m, compiled {compiled:.1f} ms/m",
            flush=True,
        )


SLOW_SPEEDS = (0.8, 0.4, 0.2, 0.1, 0.05)  # [m/s]
FINE = SolverOptions(1e-8)
SLOW_HILLS = Analytic(lambda x, y: hills(x, y, ca), mu=MU)
TURNING = {
    "skid_steer": catalog.skid_steer(),
    "ackermann": catalog.ackermann(),
    "rocky7": catalog.rocky7(),
    "open_source_rover": catalog.open_source_rover(),
}
ROUGH = (0.01, 0.02)  # rms of the heights below a rigid four-wheeler [m]


def turns() -> None:
    """Print the distance between the ends of turns in three models."""
    print("dynamics from quasi-statics, ends apart [m], by speed [m/s]; kinematics, the same")
    print(
        f"{'vehicle':18}"
        + "".join(f"{speed:>10g}" for speed in SLOW_SPEEDS)
        + f"{'kinematics':>12}"
    )
    for name, vehicle in TURNING.items():
        gaps = []
        for speed in SLOW_SPEEDS:
            still = _turn(
                quasi_statics(vehicle, SLOW_HILLS, law=Coulomb(0.01 * speed)), vehicle, speed
            )
            law = Compliant(creep=0.01 * speed)
            moved = _turn(dynamics(vehicle, SLOW_HILLS, law=law), vehicle, speed, LAG)
            gaps.append(moved - still)
        least = _turn(direct_kinematics(vehicle, SLOW_HILLS), vehicle, SLOW_SPEEDS[-1]) - still
        ends = "".join(f"{np.linalg.norm(gap):10.1e}" for gap in gaps)
        print(f"{name:18}{ends}{np.linalg.norm(least):12.1e}")
        steps = np.linalg.norm(np.diff(gaps, axis=0), axis=1) / -np.diff(np.square(SLOW_SPEEDS))
        rates = "".join(f"{rate:10.1e}" for rate in steps)
        print(f"{'  / v^2 [s^2/m]':18}{'':10}{rates}", flush=True)


def rough_ground() -> None:
    """Print the agreement of dynamics and kinematics of a rigid four-wheeler."""
    print("rigid four-wheeler, straight on, 2.3 m at 0.1 m/s")
    for rms in ROUGH:
        _rock(rms)


def _turn(model: Dae, vehicle: Vehicle, speed: float, delay: float = 0.0) -> np.ndarray:
    """Return the end of a turn from rest, x and y, after a delay [m]."""
    ramp = ca.tanh(model.t * speed / 0.3) ** 2
    given = {label.full: 0.0 for part in model.labels.u for label in part}
    for wheel in vehicle.wheels:
        side = 1.2 if wheel.at[0] > 0 else 0.8
        if wheel.driven:
            given[f"{wheel.name}_rate"] = side * speed / wheel.radius * ramp
    t = np.linspace(0, 1.3 / speed + delay, 3)
    run = simulate(model, settle(model), model.inputs(**given), t, options=FINE)
    if run.stop is not None:
        raise SystemExit(f"{vehicle.name}: {run.stop.words}")
    return np.array([run["x"][-1], run["y"][-1]])


def _rock(rms: float) -> None:
    """Print the agreement of dynamics and kinematics of a rigid four-wheeler on rough ground."""
    vehicle = catalog.rigid_skid_steer()
    axis = np.arange(-3, 5.05, 0.1)
    flat = Grid(axis, axis, np.zeros((axis.size, axis.size)))
    rough = power_law(flat, rms=rms, hurst=0.8, longest=3.0, shortest=0.6, seed=7)
    ground = Bicubic(rough, mu=0.8)
    wheels = tuple(replace(wheel, static_depth=wheel.radius / 250) for wheel in vehicle.wheels)
    vehicle = replace(vehicle, wheels=wheels)
    moving, still = (
        straight_on(model, vehicle)
        for model in (dynamics(vehicle, ground), direct_kinematics(vehicle, ground))
    )
    apart = np.hypot(*(moving[key] - still[key] for key in "xy"))
    high = np.abs(moving["z"] - still["z"])
    air, raised = moving["depth"] <= 0, still["depth"] <= 0
    agree = (air == raised).all(1).mean()
    names = [
        ", ".join(w.name for k, w in enumerate(vehicle.wheels) if each[:, k].any())
        for each in (air, raised)
    ]
    print(
        f"  heights of {1e3 * rms:g} mm rms: end {1e3 * apart[-1]:.2f} mm apart, at most "
        f"{1e3 * apart.max():.2f} mm, heights {1e3 * high.max():.2f} mm; in the air with inertia: "
        f"{names[0] or 'none'}; without: {names[1] or 'none'}; the same wheels at "
        f"{100 * agree:.0f} % of the samples"
    )


def straight_on(model: Dae, vehicle: Vehicle) -> Trajectory:
    """Return the motion straight on over 2.3 m at 0.1 m/s."""
    rates = {f"{wheel.name}_rate": 0.1 / wheel.radius for wheel in vehicle.wheels}
    t = np.linspace(0, 23, 231)
    return simulate(model, settle(model), model.inputs(**rates), t, options=FINE)


def main() -> None:
    """Print the parts."""
    vehicles = {name: partial(vehicle_costs, name) for name in VEHICLES}
    last = {"mujoco": beside_mujoco, "turns": turns, "rough": rough_ground}
    run_parts({"search": search_times, **vehicles, **last})
