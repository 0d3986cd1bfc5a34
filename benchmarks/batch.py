"""Batch: rates, errors and ends of many motions and poses at once, beside `simulate`.

``python benchmarks batch [PART ...]`` prints, for vehicles and laws on a map of 120 x 120 cells of
0.1 m with 3 cm rms, motions of 2 m in 4 s whose rates jump ten times:

``rates``
    Motions a second of CPU in one process by step, with limits and error estimates, errors at the
    end against `simulate` at 1e-9 (median, 95 %), and the ratio to compiled `simulate` at 1e-4.
``estimates``
    Quantiles of estimate over true error, and shares from 0.3 to 3 for each state.
``poses``
    Poses a second of CPU on maps of growing roughness, the share that was found, and the largest
    difference from `settle`.
``ends``
    Random motions on rough maps: motions a second with those that are left to `simulate`, outcomes
    and times of ends beside `simulate`.
``explicit``
    Single motions of five vehicles with 41 and 101 samples by ``SolverOptions(method="explicit")``
    and by IDAS: times and errors by tolerance, which ``docs/figures/work_precision.png`` shows.
``machines``
    Lanes, processes and interpreted graphs: rates and differences.
``soak``
    Rates and memory while a million motions are written to a file.
``signals``
    Times from a signal to its exception in calls of the batch.
``controller``
    C code of `slipfree export --c`: size, time of compilation, the largest difference from Python
    in 100 states, and times of a call, a pose from 1 cm above it.

Rates are the best of three repetitions.
"""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path
from threading import Timer
from typing import Any, NamedTuple

import casadi as ca
import matplotlib as mpl
import numpy as np
from common import cpu, run_parts

from slipfree import (
    Analytic,
    Bicubic,
    Coulomb,
    ModelError,
    Soil,
    SolverOptions,
    catalog,
    direct_kinematics,
    quasi_statics,
    rollouts,
    settle,
    settle_many,
    simulate,
)
from slipfree.batch.evaluator import evaluator_of
from slipfree.batch.many import run_lanes, start_states
from slipfree.core.dae import Dae
from slipfree.core.records import leaves
from slipfree.files.controller import export_controller
from slipfree.terrain.synthetic import blank, power_law
from slipfree.vehicle.tree import Vehicle

T = np.linspace(0.0, 4.0, 11)
SPEED, SPREAD, STEERING = 0.5, 0.1, 0.15  # [m/s], of the speed, [rad/s]
RUNS, COMPARED, MANY = 512, 24, 10_000_000
KEPT = ["x", "y"]
FIGURE = Path(__file__).parent.parent / "docs" / "figures" / "work_precision.png"
TOLERANCES = 10.0 ** np.arange(-2, -9, -1)  # explicit, pressed: two
ROUNDING = 1e-12  # of states that are integrated exactly [m, rad]


class Case(NamedTuple):
    """Vehicle and law of a row, and the steps of its motions [m]."""

    vehicle: Vehicle
    law: Callable[[Vehicle, Bicubic], Dae] = direct_kinematics
    steps: tuple[float, ...] = (0.25, 0.1, 0.05)


FORMULA = Analytic(lambda x, y: 0.05 * ca.sin(1.5 * x) * ca.cos(1.5 * y))
ROCKY, PRESSED = catalog.rocky7(steered="corners"), (0.1, 0.05, 0.025)
CASES = {
    "Rocky 7": Case(ROCKY),
    "three-wheeler": Case(catalog.three_wheeler()),
    "Ackermann car": Case(catalog.ackermann()),
    "articulated cart": Case(catalog.articulated()),
    "rigid four-wheeler": Case(catalog.rigid_skid_steer(), steps=PRESSED),
    "rigid six-wheeler": Case(catalog.rigid_skid_steer(axles=3), steps=PRESSED),
    "Rocky 7 on a formula": Case(ROCKY, lambda vehicle, _: direct_kinematics(vehicle, FORMULA)),
    "Rocky 7, creep 1e-3 m/s": Case(ROCKY, partial(quasi_statics, law=Coulomb(creep=1e-3))),
    "Rocky 7 on soil": Case(ROCKY, partial(quasi_statics, law=Soil())),
}
SINGLE, SIGNALLED = list(CASES)[:5], ("Rocky 7", "Rocky 7, creep 1e-3 m/s")
ROUGH = {  # rms and shortest wave [m], cell [m], Hurst exponent: for poses and ends
    "3 cm, 0.8 m": (0.03, 0.8, 0.1, 0.9),
    "10 cm, 0.5 m": (0.1, 0.5, 0.1, 0.9),
    "5 cm, 0.2 m": (0.05, 0.2, 0.05, 0.5),
    "10 cm, 0.2 m": (0.1, 0.2, 0.05, 0.5),
    "40 cm, 1.5 m": (0.4, 1.5, 0.1, 0.9),
}
EXACT, USUAL = (SolverOptions(tolerance=each, compiled=True) for each in (1e-9, 1e-4))


@cache
def ground(
    rms: float = 0.03, shortest: float = 0.8, spacing: float = 0.1, hurst: float = 0.9
) -> Bicubic:
    """Return a rough map about the origin."""
    sheet = blank((-6.0, 6.0), (-6.0, 6.0), spacing)
    grid = power_law(sheet, rms=rms, hurst=hurst, longest=4.0, shortest=shortest, seed=3)
    return Bicubic(grid, mu=0.6)


@cache
def model_of(name: str) -> Dae:
    """Return the model of a case on the common map."""
    case = CASES[name]
    return case.law(case.vehicle, ground())


def inputs_of(model: Dae, vehicle: Vehicle, count: int, seed: int = 1) -> dict[str, Any]:
    """Return rates that jump at every sample, shape (count, n_intervals)."""
    rng = np.random.default_rng(seed)
    shape = count, T.size - 1
    rate = SPEED / vehicle.wheels[0].radius * (1 + SPREAD * rng.standard_normal(shape))
    turn = STEERING * rng.standard_normal(shape)
    names = [label.full for label in leaves(model.labels.u)]
    driven = {f"{wheel.name}_rate" for wheel in vehicle.wheels}
    steered = any(name not in driven for name in names)
    found = {}
    for name in names:
        if name not in driven:
            found[name] = -turn if "rear" in name else turn
        else:
            found[name] = rate if steered or "right" not in name else rate * (1 + turn)
    return found


def motions_of(name: str, count: int, seed: int = 1) -> Callable[..., Any]:
    """Return `rollouts` of motions of a case, in the batch for a given ``step``."""
    model, vehicle = model_of(name), CASES[name].vehicle
    start, inputs = settle(model, y=-1.5), inputs_of(model, vehicle, count, seed)
    return partial(rollouts, model, start, inputs, T, method="batch", quantities=KEPT)


def distance(one: Any, other: Any, count: int) -> Any:
    """Return the distances of the ends of motions [m]."""
    return np.hypot(*((one[name][:count, -1] - other[name][:count, -1]).values for name in KEPT))


def rates() -> None:
    """Print rates and errors of all cases."""
    print(
        f"{'':24}{'step':>7}{'motions/s':>11}{'of simulate':>12}{'median':>9}{'95 %':>9}"
        f"{'estimate':>9}  simulated   (errors in mm)"
    )
    for name, case in CASES.items():
        batched = motions_of(name, RUNS)
        model, start, inputs, _ = batched.args
        few = {key: values[:COMPARED] for key, values in inputs.items()}
        simulated = partial(rollouts, model, start, few, T, quantities=KEPT, options=USUAL)
        exact = simulated(options=EXACT)
        simulated()  # compiles
        slow, usual = cpu(simulated, 1)
        slow /= COMPARED
        error = 1e3 * np.nanmedian(distance(usual, exact, COMPARED))
        print(f"{name:24}{'':7}{1 / slow:11.1f}{1:12.0f}{error:9.3f}  simulate, 1e-4", flush=True)
        for step in case.steps:
            batched(step=step)  # compiles
            took, batch = cpu(partial(batched, step=step))
            errors = 1e3 * distance(batch, exact, COMPARED)
            estimate = 1e3 * float(np.nanmedian(batch["error"]))
            left = int(np.isnan(batch["error"]).sum())
            quantiles = np.nanquantile(errors, (0.5, 0.95))
            print(
                f"{'':24}{step:7.3g}{RUNS / took:11.0f}{RUNS / took * slow:12.0f}"
                f"{quantiles[0]:9.4f}{quantiles[1]:9.4f}{estimate:9.4f}  {left}",
                flush=True,
            )


def estimates() -> None:
    """Print the ratios of estimates and true errors of 400 motions, and shares for states."""
    print(f"{'':24}{'step':>7}  quantiles 2.5, 25, 50, 75, 97.5 %; shares from 0.3 to 3")
    for name, case in CASES.items():
        batched, states = motions_of(name, 400, seed=2), list(leaves(model_of(name).labels.x))
        run = partial(batched, quantities=[label.full for label in states])
        for step in case.steps[:2]:
            coarse, fine = run(step=step), run(step=step / 20)
            errors = {"error": distance(coarse, fine, 400)}
            for label in states:
                apart = np.abs(coarse[label.full] - fine[label.full]).values[:, -1]
                if np.nanmedian(apart) > ROUNDING:
                    errors[f"error_{label.full}"] = apart
            ended = np.isnan(errors["error"])
            ratios = {key: (coarse[key].values / e)[~ended] for key, e in errors.items()}
            shares = [
                f"{key.removeprefix('error_')} {np.mean((ratio > 0.3) & (ratio < 3)):.3f}"
                for key, ratio in ratios.items()
            ]
            quantiles = np.quantile(ratios["error"], (0.025, 0.25, 0.5, 0.75, 0.975))
            print(f"{name:24}{step:7.3g} ", np.round(quantiles, 2), ", ".join(shares), flush=True)


def poses() -> None:
    """Print rates of poses of Rocky 7 and of a rigid four-wheeler, and differences from settle."""
    count = 8192
    for vehicle in (ROCKY, catalog.rigid_skid_steer()):
        for name, rough in ROUGH.items():
            model = direct_kinematics(vehicle, ground(*rough))
            rng = np.random.default_rng(0)
            place = {"x": rng.uniform(-4.5, 4.5, count), "y": rng.uniform(-4.5, 4.5, count)}
            place["heading"] = rng.uniform(-3.0, 3.0, count)
            took, many = cpu(partial(settle_many, model, **place), 2)
            found = np.mean(many["outcome"] != "failed")
            apart, settled = [], 0
            for k in np.flatnonzero(many["outcome"].values == "complete")[:40]:
                try:
                    one = settle(model, **{key: float(values[k]) for key, values in place.items()})
                except ModelError:
                    continue
                settled += 1
                apart.append(
                    max(abs(float(many[q][k]) - one[q][0]) for q in ("z", "roll", "pitch"))
                )
            print(
                f"{vehicle.name:18} {name:13} {count / took:8.0f} poses/s; found {found:.4f};",
                f"40 of settle: {settled} settle, {np.sum(np.array(apart) < 1e-7)} equal to 1e-7,",
                f"median {np.median(apart) if apart else np.nan:.0e} m or rad",
                dict(Counter(many["outcome"].values.tolist())),
                flush=True,
            )


def ends() -> None:
    """Print outcomes and times of ends on rough maps, beside those of `simulate`."""
    count = 48
    for name in ("Rocky 7", "three-wheeler"):
        for rough_name, rough in ROUGH.items():
            model = direct_kinematics(CASES[name].vehicle, ground(*rough))
            rng = np.random.default_rng(7)
            start = {"x": rng.uniform(-4.5, 4.5, count), "y": rng.uniform(-4.5, 4.5, count)}
            start["heading"] = rng.uniform(-3.0, 3.0, count)
            inputs = inputs_of(model, CASES[name].vehicle, count, seed=3)
            both = partial(rollouts, model, start, inputs, T, quantities=KEPT)
            exact = both(options=EXACT)
            took, batch = cpu(partial(both, method="batch", step=0.1), 2)
            kinds = [
                [each.split(" at (")[0].split(":")[0] for each in run["reason"].values]
                for run in (batch, exact)
            ]
            same = np.array(kinds[0]) == kinds[1]
            same &= batch["outcome"].values == exact["outcome"].values
            late = np.abs((batch["end"] - exact["end"]).values)
            simulated = int(np.isnan(batch["error"]).sum())
            print(
                f"{name:14} {rough_name:13}{count / took:7.1f}/s, same end {same.sum()} of "
                f"{count}, within {1e3 * np.nanmax(late):.2f} ms, {simulated} left to simulate;",
                dict(Counter(exact["outcome"].values.tolist())),
                flush=True,
            )


def explicit() -> None:
    """Print median times and errors of three motions by both methods, and draw them."""
    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(
        1, len(SINGLE), figsize=(13, 3.5), sharey=True, layout="constrained"
    )
    for name, ax in zip(SINGLE, axes, strict=True):
        model, pressed = model_of(name), CASES[name].steps == PRESSED
        inputs = inputs_of(model, CASES[name].vehicle, 3)
        run = partial(simulate, model, settle(model, y=-1.5))
        for samples, method in product((41, 101), (None, "explicit")):
            t, line = np.linspace(0.0, T[-1], samples), []
            long = {key: np.repeat(v, samples // 10, axis=1) for key, v in inputs.items()}
            given = [model.inputs(**{key: v[k] for key, v in long.items()}) for k in range(3)]
            exact = [run(each, t, options=replace(EXACT, tolerance=1e-10)) for each in given]
            for tolerance in TOLERANCES[: 2 if pressed and method else None]:
                options = SolverOptions(tolerance=tolerance, method=method, compiled=True)
                run(given[0], t, options=options)  # compiles
                done = [cpu(partial(run, each, t, options=options)) for each in given]
                errors = [
                    np.hypot(*(one[key][-1] - other[key][-1] for key in KEPT))
                    for (_, one), other in zip(done, exact, strict=True)
                ]
                line.append((1e3 * np.median([took for took, _ in done]), np.median(errors)))
            label = f"{method or 'idas'}, {samples} samples"
            text = "".join(f"{took:8.1f} ms {error:.1e} m" for took, error in line)
            print(f"{name:19}{label:22}{text}", flush=True)
            style = {"color": "C1" if method else "C0", "ls": "-" if samples == 41 else ":"}
            ax.loglog(*zip(*line, strict=True), marker="o", ms=3, label=label, **style)
        ax.set(title=name, xlabel="CPU time [ms]", xlim=(8, 250))
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("error [m]")
    figure.legend(*ax.get_legend_handles_labels(), loc="outside lower center", ncols=4)
    figure.savefig(FIGURE, dpi=110)


def machines() -> None:
    """Print what lanes, processes and interpretation change."""
    model, case = model_of("Rocky 7"), CASES["Rocky 7"]
    inputs = inputs_of(model, case.vehicle, RUNS)
    array = np.stack([inputs[label.full].T for label in leaves(model.labels.u)])
    ends_ = {}
    for tag, evaluate in (
        *((f"{lanes} lanes", evaluator_of(model, lanes=lanes)) for lanes in (1, 2, 4, 8)),
        ("interpreted", evaluator_of(model, compiled=False)),
    ):
        states = start_states(evaluate.graphs, {"y": np.full(RUNS, -1.5)})
        lanes = partial(run_lanes, evaluate, states, array, T, step=0.25, quantities=KEPT)
        took, done = cpu(lanes, 1 if tag == "interpreted" else 3)
        ends_[tag] = np.stack([done.columns[key].values[:, -1] for key in KEPT])
        apart = np.abs(ends_[tag] - ends_["1 lanes"]).max()
        print(
            f"{tag:12} {RUNS / took:8.0f} motions/s, largest difference {apart:.1e} m", flush=True
        )
    many = {key: np.tile(values, (256, 1)) for key, values in inputs.items()}
    options = {"p": {"name": ["Rocky 7"]}, "quantities": KEPT, "method": "batch", "step": 0.25}
    results = {}
    for processes in (1, 2):
        begin = time.perf_counter()
        results[processes] = rollouts(
            model_of, {"y": -1.5}, many, T, processes=processes, **options
        )
        rate = 256 * RUNS / (time.perf_counter() - begin)
        print(f"{processes} processes: {rate:.0f} motions/s of wall time, with their start")
    print("equal bits:", all(np.array_equal(results[1][key], results[2][key]) for key in KEPT))


def soak() -> None:
    """Print rates and the largest memory of ten million motions of Rocky 7, written to a file.

    A row of the file has the samples of ``x`` and ``y`` of a motion.
    """
    model, size = model_of("Rocky 7"), 2**14
    start = settle(model, y=-1.5)
    with tempfile.TemporaryFile() as file:
        begin = time.perf_counter()
        for k in range(MANY // size + 1):
            inputs = inputs_of(model, ROCKY, size, seed=k)
            found = rollouts(model, start, inputs, T, method="batch", step=0.25, quantities=KEPT)
            file.write(np.stack([found[name] for name in KEPT], axis=1).tobytes())
            if k % 50 == 0:
                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
                rate = (k + 1) * size / (time.perf_counter() - begin)
                text = f"{(k + 1) * size:8d} motions, {rate:6.0f}/s of wall time"
                print(f"{text}, {file.tell() / 1e6:6.1f} MB, memory {peak:.0f} MiB", flush=True)


def signals() -> None:
    """Print the longest times from a signal to its exception in long calls [s]."""
    rough = direct_kinematics(catalog.rigid_skid_steer(), ground(*ROUGH["10 cm, 0.2 m"]))
    calls = {name: partial(motions_of(name, 2**17), step=0.05) for name in SIGNALLED}
    calls["poses"] = partial(settle_many, rough, x=np.linspace(-4.5, 4.5, 2**14))
    signal.signal(signal.SIGINT, signal.default_int_handler)  # shells ignore it in the background
    for name, call in calls.items():
        late = []
        for pause in np.linspace(1.0, 3.0, 10):
            begin = time.perf_counter()
            Timer(pause, os.kill, (os.getpid(), signal.SIGINT)).start()
            with suppress(KeyboardInterrupt):
                call()
            late.append(time.perf_counter() - begin - pause)
        print(f"{name:24}{max(late):.2f} s", flush=True)


def controller() -> None:
    """Print sizes, differences and times of the C code of vehicles."""
    vehicles = [catalog.differential_drive(), catalog.ackermann(), catalog.mecanum()]
    for vehicle in (*vehicles, catalog.rocky7(), catalog.rigid_skid_steer()):
        with tempfile.TemporaryDirectory() as folder:
            files, command = export_controller(vehicle, Path(folder))
            build, run = command.split(" && ")
            before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            subprocess.run(build, shell=True, check=True)
            spent = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
            size = files[1].stat().st_size / 1000
            print(f"{vehicle.name}: {size:.0f} kB of C, compiled in {spent:.0f} s of CPU")
            print(subprocess.run(run, shell=True, capture_output=True, text=True).stdout, end="")


def main() -> None:
    """Print the parts that the command line names."""
    run_parts(
        {
            "rates": rates,
            "estimates": estimates,
            "poses": poses,
            "ends": ends,
            "explicit": explicit,
            "machines": machines,
            "soak": soak,
            "signals": signals,
            "controller": controller,
        }
    )


if __name__ == "__main__":
    main()
