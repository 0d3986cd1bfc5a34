"""Compare the step climber's motion with required values.

``python benchmarks/climb.py`` (some minutes) prints a line for every quantity, with the required
and the computed value; with names of parts, such as ``thresholds`` or ``random``, it prints only
these. The required values are those of a prototype with its own equations; see `slipfree.climb`.
Slip is the mean over the axles of (20), *true* that of the wheels' own slip, *disturbance* that of
(21), all in percent; ratios are to fixed references. Times are the least of three runs.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
from reference import heading

from slipfree import SolverOptions
from slipfree.catalog.step_climber import step_climber
from slipfree.climb.dynamics import floor_loads, held_torques, standing
from slipfree.climb.friction_demand import least_friction
from slipfree.control.reference_speeds import PerAxle, Tilts, motors, odometry, ratios, reference
from slipfree.control.step_climbing import Control
from slipfree.solve.settle import settle
from slipfree.solve.simulate import simulate
from slipfree.solve.zero_order_hold import simulate_sampled
from slipfree.terrain.solids import Profile, flat, step
from slipfree.trajectory import SolverError

sys.path.insert(0, str(Path(__file__).parent.parent / "tests" / "physics"))
sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
import climb_random
import climb_track
from climb_track import FINE, climbed
from test_climb_dynamics import sensitive_start
from test_climb_reference import BASE, closure

from helpers import climb_stepping as stepping
from helpers.climb_cases import (
    AMPLE,
    EXACT,
    EXACT_95,
    FIXED,
    PRINTED_6_8,
    PRINTED_14,
    PRINTED_16,
    RAMP,
    SENSED,
    SPEED,
    STEP,
    TABLE_I,
    TWICE,
    Grip,
    begin,
    climb,
    gripped,
)

CONTROLS = {
    "fixed": FIXED,
    "exact": EXACT,
    "exact .95": EXACT_95,
    "sensed": SENSED,
    "printed (6)+(8)": PRINTED_6_8,
    "printed (16)": PRINTED_16,
    "printed (14)": PRINTED_14,
}
SETS = {  # friction and torque on ramp and step, and the lab's slip/true/disturbance [%]
    "A": (
        (TABLE_I, AMPLE),
        (TWICE, AMPLE),
        {
            "fixed": (7.1, 6.8, 1.3),
            "exact": (4.1, 2.8, 1.2),
            "exact .95": (4.0, 2.7, 1.3),
            "sensed": (4.6, 3.6, 1.2),
            "printed (6)+(8)": (11.4, 10.5, 1.3),
            "printed (16)": (13.7, 13.5, 1.3),
        },
        {
            "fixed": (13.8, 12.4, 3.3),
            "exact": (14.7, 6.9, 4.5),
            "exact .95": (12.3, 3.5, 4.7),
            "sensed": (14.3, 7.9, 3.2),
        },
    ),
    "B": (
        (Grip(1.0, 0.75), 5.0),
        (Grip(1.0, 0.75), 5.0),
        {
            "fixed": (4.7, 2.6, 3.1),
            "exact": (3.9, 0.1, 1.2),
            "exact .95": (3.8, 0.1, 1.5),
            "sensed": (3.9, 0.3, 1.3),
            "printed (6)+(8)": (9.1, 7.3, 4.4),
            "printed (16)": (11.7, 10.1, 2.3),
        },
        {
            "fixed": (14.0, 12.3, 9.8),
            "exact": (24.8, 21.6, 11.4),
            "exact .95": (11.1, 3.0, 6.9),
            "sensed": (13.9, 7.1, 6.3),
        },
    ),
    "C": (
        (TABLE_I, 2.0),
        (TWICE, 4.5),
        {
            "fixed": (7.7, 7.4, 3.1),
            "exact": (5.1, 4.0, 1.4),
            "exact .95": (5.7, 4.9, 1.5),
            "sensed": (6.2, 5.5, 1.3),
            "printed (6)+(8)": (15.4, 15.7, 9.6),
            "printed (16)": (14.0, 13.9, 1.4),
        },
        {"fixed": (17.4, 16.3, 12.8), "exact .95": (13.9, 6.0, 8.9), "sensed": (16.2, 9.8, 8.6)},
    ),
}


class Means(NamedTuple):
    """Means over the axles [%], and whether the vehicle climbed."""

    slip: float
    true: float
    disturbance: float
    climbed: bool


def means(profile: Profile, control: Control, contact: Grip, **options: Any) -> Means:
    """Return the means of a climb."""
    found = climb(profile, control, contact, **options).metrics
    return Means(
        *(100 * float(each.mean()) for each in (found.slip, found.true_slip, found.disturbance)),
        found.window.climbed,
    )


def row(what: str, asked: str, found: str, reached: bool) -> None:
    """Print a line of the table."""
    print(f"{'yes' if reached else 'NO ':3}  {what:58} {asked:24} {found}", flush=True)


def kinematics() -> None:
    """Print errors of the reference law in the closure, and of the odometry."""
    rng, climber, worst, inverse = np.random.default_rng(2), step_climber(0.06), 0.0, 0.0
    for _ in range(2000):
        tilts = Tilts(*rng.uniform(-0.6, 0.6, 2))
        directions = PerAxle(*rng.uniform(-0.3, np.pi / 2, 3))
        speeds = np.array([float(each) for each in ratios(climber, tilts, directions)])
        null = closure(climber, tilts, directions)[:3]
        speeds, null = speeds / np.linalg.norm(speeds), null / np.linalg.norm(null)
        worst = max(worst, np.abs(speeds - np.sign(speeds @ null) * null).max())
        relative = PerAxle(*(float(ca.DM(v)) for v in reference(climber, tilts, directions)))
        product = np.array(odometry(BASE, relative) @ motors(BASE, relative))
        inverse = max(inverse, np.abs(product - np.eye(3)).max())
    row(
        "law against the null space, 2000 configurations", "<= 1e-12", f"{worst:.1e}", worst < 1e-12
    )
    row("J A - I", "<= 1e-14", f"{inverse:.1e}", inverse < 1e-14)


def statics() -> None:
    """Print loads and rest after a drop of a millimetre."""
    climber, dae = gripped(step_climber(), flat(), FIXED, TABLE_I)
    values = standing(climber, 0.0)
    start = settle(dae, **values | {"z": values["z"] + 1e-3})
    run = simulate(dae, start, dae.inputs(speed=0.0), np.linspace(0, 1, 11))
    loads, hand = run["solid_load_1"][-1, ::-1], np.array([67.07, 93.83, 51.00])
    speed = max(abs(run[name][-1]) for name in ("velocity_y", "velocity_z", "omega_x"))
    row(
        "loads F/M/R at rest [N]",
        "67.07/93.83/51.00 .2 %",
        "/".join(f"{v:.2f}" for v in loads),
        bool((np.abs(loads / hand - 1) < 2e-3).all()),
    )
    row("the same by hand [N]", "", "/".join(f"{v:.2f}" for v in floor_loads(climber)[::-1]), True)
    row("speed 1 s after the drop [m/s]", "< 1e-6", f"{speed:.1e}", speed < 1e-6)


def accuracy() -> None:
    """Print energy balances, convergence with the tolerance, and the effect of regularisation.

    The accuracy of the study is that of its exact law with 0.9 of the directions and a cap of two.
    """
    lab = Control(directions="contact", share=0.9, cap=2.0)
    for name, profile, contact, control in (
        ("ramp exact .9", RAMP, TABLE_I, lab),
        ("ramp exact", RAMP, TABLE_I, EXACT),
        ("step exact .9", STEP, TWICE, lab),
        ("step exact", STEP, TWICE, EXACT),
    ):
        runs = {tol: climb(profile, control, contact, tolerance=tol) for tol in (1e-6, 1e-8, 1e-10)}
        for tol, most in ((1e-6, 2e-4), (1e-8, 5e-6)):
            found = runs[tol].imbalance
            row(
                f"{name}: energy's balance at {tol:g} [J]",
                f"<= {most:g}",
                f"{found:.1e}",
                found < most,
            )
        rough, fine = runs[1e-6], runs[1e-10]
        apart = max(
            np.abs(rough.run[name] - fine.run[name]).max()
            for name in ("y", "z", "tilt_rear", "tilt_front")
        )
        row(f"{name}: dq of 1e-6 against 1e-10 [m, rad]", "<= 1e-5", f"{apart:.1e}", apart < 1e-5)
        moved = 100 * abs(rough.metrics.slip.mean() - fine.metrics.slip.mean())
        row(f"{name}: slip moves by [points]", "< .02", f"{moved:.4f}", moved < 0.02)
    for control in ("fixed", "exact"):
        sharp = TABLE_I._replace(creep=1e-4)
        moved = abs(
            means(RAMP, CONTROLS[control], sharp).slip
            - means(RAMP, CONTROLS[control], TABLE_I).slip
        )
        row(
            f"ramp {control}: creep 5e-4 to 1e-4 moves slip by",
            "< .15",
            f"{moved:.3f}",
            moved < 0.15,
        )
    for stiffness in (5e5, 1e6, 2e6):
        contact = TABLE_I._replace(stiffness=stiffness, damping=20.0)
        found = means(RAMP, EXACT, contact).slip / means(RAMP, FIXED, contact).slip
        row(
            f"ramp exact: ratio at {stiffness:.0e} N/m, c = 20",
            ".55 - .60",
            f"{found:.3f}",
            0.55 < found < 0.60,
        )


def acceptance() -> None:
    """Print the required values of ramp and step, and the results."""
    base = means(RAMP, FIXED, TABLE_I)

    def within(what: str, found: float, low: float, high: float) -> None:
        row(what, f"{low:g} - {high:g}", f"{found:.3f}", low <= found <= high)

    within("ramp fixed: slip", base.slip, 6.7, 7.5)
    within("ramp fixed: true slip", base.true, 6.4, 7.2)
    exact, sensed = means(RAMP, EXACT, TABLE_I), means(RAMP, SENSED, TABLE_I)
    within("ramp exact: slip", exact.slip, 3.8, 4.4)
    within("ramp exact: slip, ratio", exact.slip / base.slip, 0.54, 0.62)
    within("ramp exact: true slip, ratio", exact.true / base.true, 0.37, 0.46)
    within("ramp sensed: slip, ratio", sensed.slip / base.slip, 0.60, 0.70)
    within("ramp sensed: true slip, ratio", sensed.true / base.true, 0.48, 0.58)
    for law, low in ((PRINTED_16, 1.7), (PRINTED_6_8, 1.4)):
        within(f"ramp {law.law}: slip, ratio", means(RAMP, law, TABLE_I).slip / base.slip, low, 9)
    base = means(STEP, FIXED, TWICE)
    within("step fixed: slip", base.slip, 13.1, 14.5)
    for name, low, high in (("sensed", 0.58, 0.70), ("exact", 0.50, 0.62), ("exact .95", 0, 0.40)):
        found = means(STEP, CONTROLS[name], TWICE).true / base.true
        within(f"step {name}: true slip, ratio", found, low, high)
    for name, profile, contact, torque, high in (
        ("ramp, 2 N m", RAMP, TABLE_I, 2.0, 0.55),
        ("step, 4.5 N m", STEP, TWICE, 4.5, 0.75),
    ):
        parts = [means(profile, each, contact, torque=torque) for each in (SENSED, FIXED)]
        within(
            f"{name}, sensed: disturbance, ratio",
            parts[0].disturbance / parts[1].disturbance,
            0,
            high,
        )
    stiff = replace(EXACT, proportional=32.0)
    for name, profile, most, floor, apart in (
        ("ramp", RAMP, 0.3, 3.9, 0.2),
        ("step", STEP, 1.5, 9.2, 0.5),
    ):
        for mu in (1.0, 2.0):
            found = means(profile, stiff, Grip(mu, mu), torque=np.inf)
            within(f"{name}, mu {mu:g}, kp 32, exact: true slip", found.true, 0, most)
            within(
                f"{name}, mu {mu:g}, kp 32, exact: slip", found.slip, floor - apart, floor + apart
            )


def failures() -> None:
    """Print the cases that must not climb."""
    for name, contact, controls in (
        ("step, mu .9/.675", TWICE, ("printed (6)+(8)", "printed (16)", "printed (14)")),
        ("step, mu .4/.3", TABLE_I, tuple(CONTROLS)),
    ):
        found = [
            each for each in controls if means(STEP, CONTROLS[each], contact, until=7.0).climbed
        ]
        row(
            f"{name}: climbed by", "none", ", ".join(found) or f"none of {len(controls)}", not found
        )


def sets() -> None:
    """Print the tables of the study beside these results."""
    print("\nset, ground, control: slip, true slip, disturbance found (lab's) [%]")
    for name, (on_ramp, on_step, *lab) in SETS.items():
        for ground, profile, (contact, torque), known in (
            ("ramp", RAMP, on_ramp, lab[0]),
            ("step", STEP, on_step, lab[1]),
        ):
            for control, law in CONTROLS.items():
                found = means(profile, law, contact, torque=torque, until=7.0)
                if not found.climbed:
                    print(f"  {name} {ground} {control:16} does not climb", flush=True)
                    continue
                figures = zip(found[:3], known.get(control, ("-",) * 3), strict=True)
                words = "   ".join(f"{mine:5.1f} ({its})" for mine, its in figures)
                print(f"  {name} {ground} {control:16} {words}", flush=True)


def rigid() -> None:
    """Print the comparison of stiff contacts with rigid time stepping."""
    for name, profile, contact in (("ramp", RAMP, TABLE_I), ("step", STEP, TWICE)):
        stiff = contact._replace(stiffness=1e7, damping=50.0, creep=2e-4)
        for exact in (False, True):
            law = Control("projective" if exact else "fixed", "contact", share=0.9, cap=2.0)
            mine = means(profile, law, stiff, torque=np.inf).slip
            angle = float(np.arctan2(*profile.summit[::-1]))
            case = stepping.Case(angle, contact.static, contact.dynamic, exact)
            for h in (5e-4, 2e-4, 1e-4):
                theirs = 100 * stepping.climb(case, h)[0].mean()
                row(
                    f"{name} {law.law}: slip, rigid at {1e3 * h:g} ms, and this at 1e7 N/m",
                    "within 5 %" if h <= 2e-4 else "too coarse",
                    f"{theirs:.2f}, {mine:.2f}: {100 * (mine / theirs - 1):+.1f} %",
                    abs(mine / theirs - 1) < 0.05 or h > 2e-4,
                )


class Case(NamedTuple):
    """Controller, obstacle, and ratio of kinetic to static friction."""

    profile: Profile
    control: Control
    part: float
    options: dict[str, Any]


def critical(case: Case, between: np.ndarray) -> float:
    """Return the least coefficient of friction that suffices for a climb, by bisection."""
    low, high = between
    while high - low > FINE:
        mu = (low + high) / 2
        contact = Grip(mu, case.part * mu)
        up = climbed(case.profile, case.control, contact, **case.options)
        low, high = (low, mu) if up else (mu, high)
    return float(low + high) / 2


def friction() -> None:
    """Print the friction needed by slow and fast climbs."""
    grounds = {"ramp": RAMP, "50 mm": step(0.05), "90 mm": STEP}
    demands = {name: least_friction(step_climber(), each).mu for name, each in grounds.items()}
    for name, asked, apart in (
        ("ramp", 0.323, 0.005),
        ("50 mm", 0.543, 0.005),
        ("90 mm", 0.71, 0.01),
    ):
        row(
            f"{name}: least friction at rest, force program",
            f"{asked} +- {apart}",
            f"{demands[name]:.4f}",
            abs(demands[name] - asked) <= apart,
        )
    for speed, most in ((0.1, np.inf), (0.05, np.inf), (0.025, 3.0)):
        for name, profile in grounds.items():
            options = {"speed": speed, "until": 0.9 / speed + 2, "every": 0.01}
            found = critical(
                Case(profile, FIXED, 1.0, options), demands[name] * np.array([0.5, 1.2])
            )
            apart = 100 * (found / demands[name] - 1)
            row(
                f"{name} at {speed:g} m/s, fixed, mu_d = mu_s: least friction",
                f"within {most:g} %",
                f"{found:.3f}, {apart:+.1f} %",
                abs(apart) < most,
            )
    for name, known in (("ramp", ".370/.370"), ("50 mm", ".565/.575"), ("90 mm", ".785/.780")):
        found = [
            critical(Case(grounds[name], each, 0.75, {"until": 5.0}), np.array([0.25, 1.0]))
            for each in (FIXED, EXACT_95)
        ]
        row(
            f"{name} at .25 m/s, mu_d = .75 mu_s: least, fixed/exact .95",
            f"(lab {known})",
            "/".join(f"{each:.3f}" for each in found),
            True,
        )


def sensitivities() -> None:
    """Print forward sensitivities beside finite differences."""
    p, final = sensitive_start()
    outcome, slope = (
        ca.Function("outcome", [p], [each]) for each in (final, ca.jacobian(final, p))
    )
    at, size = np.array([SPEED, 0.675]), 1e-4
    clock = time.process_time()
    slopes = np.array(slope(at))
    clock = time.process_time() - clock
    for k, name in enumerate(("speed", "dynamic friction")):
        apart = size * np.eye(2)[k]
        difference = np.array(outcome(at + apart) - outcome(at - apart)).ravel() / (2 * size)
        worst = np.abs(slopes[:, k] - difference).max() / np.abs(difference).max()
        row(
            f"sensitivity to {name}, through the impact, {clock:.1f} s",
            "1e-3",
            f"{worst:.1e}",
            worst < 1e-3,
        )


def speed() -> None:
    """Print times of integrators and of sampled control."""
    for name, profile, contact in (("ramp", RAMP, TABLE_I), ("step", STEP, TWICE)):
        for control in ("fixed", "sensed"):
            dae, start = begin(step_climber(torque=AMPLE), profile, CONTROLS[control], contact)
            t = np.linspace(0, 3, 1501)
            seconds = least_time(
                lambda d=dae, s=start, t=t: simulate(
                    d, s, d.inputs(speed=SPEED), t, options=SolverOptions(tolerance=1e-6)
                )
            )
            row(
                f"{name} {control}: times real time, CVODES at 1e-6",
                ">= 10",
                f"{3 / seconds:.0f}",
                3 / seconds > 10,
            )
        dae, start = begin(step_climber(torque=AMPLE), profile, SENSED, contact)
        for tolerance in (1e-4, 1e-6):
            begun = time.process_time()
            try:
                run = simulate(
                    dae,
                    start,
                    dae.inputs(speed=SPEED),
                    np.linspace(0, 3, 1501),
                    options=SolverOptions(tolerance=tolerance, method="idas"),
                )
                words = (
                    f"{3 / (time.process_time() - begun):.1f}, {run.statistics['steps']:.0f} steps"
                )
            except SolverError as error:
                words = str(error)
            row(f"{name} sensed: times real time, IDAS at {tolerance:g}", "", words, True)
    for period in (1e-3, 2e-3):
        climber = step_climber(torque=AMPLE)
        dae, start = begin(climber, RAMP, SENSED, TABLE_I, period=period)
        held = held_torques(climber, dae)
        t = np.arange(round(3 / period) + 1) * period
        seconds = least_time(
            lambda d=dae, s=start, h=held, t=t: simulate_sampled(
                d, s, d.inputs(speed=SPEED, **h), t, options=SolverOptions(tolerance=1e-6)
            )
        )
        row(
            f"ramp sensed, sampled every {1e3 * period:g} ms: times real time",
            "(lab 3 - 5)",
            f"{3 / seconds:.1f}",
            True,
        )


def least_time(task: Callable[[], Any]) -> float:
    """Return the least CPU time of three calls. [s]."""
    times = []
    for _ in range(3):
        begun = time.process_time()
        task()
        times.append(time.process_time() - begun)
    return min(times)


PARTS = (
    kinematics,
    statics,
    accuracy,
    acceptance,
    failures,
    sensitivities,
    speed,
    rigid,
    friction,
    climb_track.thresholds,
    climb_track.robustness,
    climb_track.noise,
    climb_random.random,
    sets,
)

if __name__ == "__main__":
    heading()
    for part in PARTS:
        if part.__name__ in sys.argv[1:] or not sys.argv[1:]:
            part()
