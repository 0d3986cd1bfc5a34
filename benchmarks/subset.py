"""Measure slip and round-trip errors of the inverse kinematics of an over-actuated rover.

``python benchmarks/subset.py`` prints, for Rocky 7 with steered corner wheels on level and on rough
ground, the slip (rms over the wheels) and the round-trip error: the difference between the given
rates and those of the direct model under the wheel rates found. Columns are steering angles: locked
straight ahead; those of least slip across (the guide), with the wheel rates of least slip alone and
with the direct model's equations as constraints; those of least slip. The last part is a motion
over the rough ground.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from reference import heading

from slipfree import (
    Analytic,
    Bicubic,
    Grid,
    ModelError,
    Trajectory,
    direct_kinematics,
    settle,
    simulate,
)
from slipfree.catalog import rocky7
from slipfree.models.given_rates import derived_rates
from slipfree.models.inverse import inverse_kinematics
from slipfree.models.steering_guide import steering_effects
from slipfree.models.wheel_authority import wheel_rates
from slipfree.records import leaves, pack
from slipfree.solve.replay import replay, round_trip
from slipfree.solve.trim import apply_inputs, trim_states
from slipfree.terrain.base import Terrain

GROUND = Path(__file__).parent.parent / "tests" / "data" / "gridsurfdata.txt"
ROVER = rocky7(steered="corners", mass=0.0, wheel_mass=0.0)  # no forces: the motion alone
START = {"x": 2.0, "y": 0.2, "heading": -np.pi / 2 + 0.1}
GIVEN: tuple[dict[str, float], ...] = (
    {"forward": 0.2, "yaw_rate": 0.0},
    {"forward": 0.2, "yaw_rate": 0.2},
    {"forward": 0.0, "yaw_rate": 0.3},
    {"forward": 0.2, "yaw_rate": 0.2, "right": 0.0},
)
MOTION = ("velocity_x", "velocity_y", "heading_rate")


def rough() -> Bicubic:
    """Return the ground of the file: six header numbers, then heights, with x varying fastest."""
    values = [float(each) for each in GROUND.read_text().split(",") if each.strip()]
    n_x, n_y = int(values[2]), int(values[5])
    x, y = np.linspace(*values[:2], n_x), np.linspace(*values[3:5], n_y)
    return Bicubic(Grid(x, y, np.reshape(values[6 : 6 + n_x * n_y], (n_y, n_x)).T))


def slip(run: Trajectory) -> float:
    """Return the root mean square of the wheels' slip at the last sample. [m/s]."""
    return float(np.sqrt(np.mean(run["slip_along"][-1] ** 2 + run["slip_across"][-1] ** 2)))


def driven(direct: Any, stand: Trajectory, rates: dict[str, float], given: dict[str, float]) -> str:
    """Return slip and round trip of the direct model under inputs."""
    run = apply_inputs(direct, stand, direct.inputs(**rates))
    plane = derived_rates(direct)
    found = ca.Function(
        "plane", list(direct.columns()[:2]), [plane[name].expression for name in given]
    )
    values = found(direct.rows("x", run, -1), direct.rows("z", run, -1))
    gap = max(abs(float(v) - g) for v, g in zip(values, given.values(), strict=True))
    return f"{slip(run):8.1e} / {gap:7.1e}"


def least(direct: Any, stand: Trajectory, given: dict[str, float]) -> dict[str, float]:
    """Return wheel rates of least slip at the given rates, without the direct model's equations.

    Joints are at rest.
    """
    count, driving = len(direct.z.rates.law.multipliers), len(direct.u.wheels)
    unknown = ca.vertcat(*leaves(direct.z.rates.motion), *direct.u.wheels)
    plane = derived_rates(direct)
    kept = ca.vertcat(direct.alg[1][-count:], *(plane[name].expression for name in given))
    slips = ca.vertcat(*direct.y.slip_along, *direct.y.slip_across)
    # They are linear, whatever rates their Jacobian is asked for at.
    rates = [pack(direct.z.rates.motion), pack(direct.u)]
    function = direct.function(
        "rows",
        [pack(direct.x), pack(direct.z.position), *rates],
        [ca.jacobian(slips, unknown), ca.jacobian(kept, unknown)],
    )
    pose = direct.rows("z", stand, -1)[: len(list(leaves(direct.z.position)))]
    a, c = (np.array(part) for part in function(direct.rows("x", stand, -1), pose, 0, 0))
    matrix = np.block([[a.T @ a, c.T], [c, np.zeros((len(c), len(c)))]])
    right = np.concatenate([np.zeros(a.shape[1] + count), list(given.values())])
    found = np.linalg.lstsq(matrix, right, rcond=1e-12)[0][a.shape[1] - driving : a.shape[1]]
    names = [label.full for label in leaves(direct.labels.u)]
    return dict(zip(names, [*found.tolist(), *[0.0] * len(direct.u.joints)], strict=True))


def row(terrain: Terrain, given: dict[str, float]) -> str:
    """Return slip and round trip at all steering angles."""
    direct = direct_kinematics(ROVER, terrain)
    dae = inverse_kinematics(ROVER, terrain, given=tuple(given))
    inputs, joints = dae.inputs(**given), list(steering_effects(ROVER, direct))
    stand = settle(direct, **START)
    guide = trim_states(
        dae, stand, inputs, states=joints, least=[f"{name}_error" for name in joints]
    )
    best = trim_states(dae, guide, inputs, states=joints, least=["slip_along", "slip_across"])
    cells = []
    for at, naive in ((stand, False), (guide, True), (guide, False), (best, False)):
        try:
            rates = least(direct, at, given) if naive else wheel_rates(ROVER, direct, at, **given)
            cells.append(driven(direct, at, rates, given))
        except ModelError:
            cells.append("not reached".rjust(18))
    return "  ".join(cells)


def in_time(terrain: Terrain) -> None:
    """Print slip, errors and cost of a motion over the ground."""
    direct = direct_kinematics(ROVER, terrain)
    dae = inverse_kinematics(ROVER, terrain, given=("forward", "yaw_rate"))
    inputs, joints = dae.inputs(forward=0.1, yaw_rate=0.05), list(steering_effects(ROVER, direct))
    errors = [f"{name}_error" for name in joints]
    start = trim_states(dae, settle(direct, **START), inputs, states=joints, least=errors)
    t = np.linspace(0, 10, 201)
    begin = time.process_time()
    run = simulate(dae, start, inputs, t)
    spent = time.process_time() - begin
    begin = time.process_time()
    again = replay(direct, run).motion
    print(
        f"10 s, forward 0.1 m/s, yaw rate 0.05 rad/s: {spent:.2f} s CPU, the direct model alone "
        f"{time.process_time() - begin:.2f} s"
    )
    total = np.sqrt(np.mean(run["slip_along"] ** 2 + run["slip_across"] ** 2))
    off = max(np.abs(run[name]).max() for name in errors)
    print(f"slip {total:.1e} m/s rms a wheel; steering off by {off:.1e} rad at most")
    trip = max(round_trip(direct, run, MOTION).values())
    gap = np.hypot(again["x"] - run["x"], again["y"] - run["y"]).max()
    print(f"round trip {trip:.1e} at the samples; replay from the samples off by {gap:.1e} m")


def main() -> None:
    """Print the table and the motion."""
    heading()
    names = "locked", "guide, naive", "guide", "least slip"
    print(f"{'ground, given':42}{''.join(f'{name:>18}  ' for name in names)}")
    ground = rough()
    for words, terrain in (("level", Analytic(lambda x, _: 0 * x)), ("rough", ground)):
        for given in GIVEN:
            asked = " ".join(f"{name} {value:g}" for name, value in given.items())
            print(f"{f'{words}: {asked}':42}{row(terrain, given)}", flush=True)
    in_time(ground)


if __name__ == "__main__":
    main()
