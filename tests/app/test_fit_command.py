"""``slipfree fit``: estimates, tables, vehicle file, logs of other origin, and errors."""

from __future__ import annotations

import csv
import json
import re
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import slipfree as sf
from helpers.cases import DATA, PROBLEMS
from helpers.commands import printed, refused, sets
from helpers.drives import HALF, HILL, drives
from slipfree.files.logs import MotionLog, check_motion, rate_ratios
from slipfree.files.mcap import write_mcap
from slipfree.files.netcdf import write
from slipfree.files.tables import write_rows
from slipfree.files.vehicle_toml import vehicle_text
from slipfree.geometry.frame import unit_vector

PROBLEM = PROBLEMS / "fit_skid_steer.toml"
TRUE = {"radius_left": 0.155, "radius_right": 0.155, "track": 0.62}
TRUE |= {"center_of_mass_ahead": 0.03, "stiffness": 12.0, "friction": 0.6}
LOG = (DATA / "fit_least_slip.toml").read_text()

RUN = (DATA / "run_fitted.toml").read_text()


pytestmark = pytest.mark.usefixtures("folder")


def _estimates(path: str) -> dict[str, dict[str, str]]:
    with Path(path).open() as file:
        return {row["name"]: row for row in csv.DictReader(file)}


@pytest.mark.slow
def test_shipped_problem_finds_the_truth_and_a_vehicle_that_runs() -> None:
    words = printed("fit", str(PROBLEM), "--write", "fitted.toml")
    assert "readings new every" not in words
    found = _estimates("fit_skid_steer.csv")
    for name, true in TRUE.items():
        assert float(found[name]["lower"]) < true < float(found[name]["upper"]), name
    with Path("fit_skid_steer_windows.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if float(row["duration"]) == 2]
    assert len(rows) >= 59
    assert np.sqrt(np.mean([float(row["error_along"]) ** 2 for row in rows])) < 0.02
    assert Path("fit_skid_steer.png").is_file()
    vehicle = sf.read_vehicle("fitted.toml")
    radii = {wheel.name: wheel.radius for wheel in vehicle.wheels}
    assert_allclose(radii["front_left"], float(found["radius_left"]["value"]), atol=1e-12)
    masses = [(mass, ca.evalf(place)) for _, mass, place in vehicle.masses()]
    ahead = sum(float(place[1]) * mass for mass, place in masses) / vehicle.mass
    assert_allclose(ahead, float(found["center_of_mass_ahead"]["value"]), atol=1e-12)
    keys = dict(re.findall(r"# (\S+) = (\S+)", Path("fitted.toml").read_text()))
    assert keys["law.coulomb.slip_stiffness"] == keys["law.compliant.slip_stiffness"]
    assert_allclose(float(keys["terrain.friction"]), float(found["friction"]["value"]))
    Path("run.toml").write_text(RUN)
    assert "complete" in printed("run", "run.toml", "--no-draw")
    own = (f"{name}={value}" for name, value in keys.items() if "coulomb" not in name)
    assert "complete" in printed("run", "run.toml", "--no-draw", *sets("model=dynamics", *own))


def _motion() -> tuple[sf.Vehicle, np.ndarray, np.ndarray]:
    """Return a vehicle, and times and rates of its left and right wheels."""
    vehicle = sf.catalog.rigid_skid_steer(half_track=0.3, r2=0.12)
    times = np.linspace(0, 20, 201)
    rates = np.random.default_rng(3).uniform(1, 4, (2, 20)).repeat(10, axis=1)
    return vehicle, times, rates


def _simulated() -> tuple[sf.Vehicle, object, np.ndarray, np.ndarray]:
    vehicle, times, (left, right) = _motion()
    dae = sf.direct_kinematics(vehicle, sf.Analytic(lambda x, _: 0 * x))
    inputs = {f"{w.name}_rate": left if "left" in w.name else right for w in vehicle.wheels}
    run = sf.simulate(dae, sf.settle(dae, heading=0.4), dae.inputs(**inputs), times)
    return vehicle, run, left, right


@pytest.mark.slow
def test_a_log_with_headings_from_x() -> None:
    """Rates are constant within windows; the row after a jump has the later rate."""
    _, run, left, right = _simulated()
    rows = [
        [k, run.t[i], run["x"][i], run["y"][i], run["heading"][i] + np.pi / 2, left[j], right[j]]
        for k in range(20)
        for j in (10 * k,)
        for i in range(j, j + 11)
    ]
    write_rows(Path("log.csv"), ["n", "time", "x", "y", "heading", "l", "r"], rows)
    rates = "".join(
        f"{end}_{side}_rate = '{side[0]}'\n"
        for end in ("front", "rear")
        for side in ("left", "right")
    )
    text = LOG.replace("window = 1.0", f"window = 'n'\n[data.rates]\n{rates}")
    Path("fit.toml").write_text(f"frame = 'rep103'\n{text}")
    shown = json.loads(printed("--json", "fit", "fit.toml", "--no-draw"))
    assert {"radius", "track"} <= {each["name"] for each in shown["estimates"]}
    found = _estimates("fit.csv")
    assert_allclose(float(found["radius"]["value"]), 0.17, rtol=1e-4)
    assert_allclose(float(found["track"]["value"]), 0.6, rtol=1e-4)


@pytest.mark.slow
def test_results_of_slipfree_are_logs() -> None:
    vehicle, times, _ = _motion()
    dae = sf.direct_kinematics(vehicle, sf.Analytic(lambda x, _: 0 * x))
    speed = {"left": 2 + dae.t / 10, "right": 3 - dae.t / 20}
    inputs = {f"{w.name}_rate": speed[w.name.split("_")[1]] for w in vehicle.wheels}
    run = sf.simulate(dae, sf.settle(dae), dae.inputs(**inputs), times)
    write("log.nc", run)
    write_mcap(Path("log.mcap"), run, vehicle)
    for name in ("log.nc", "log.mcap"):
        Path("fit.toml").write_text(LOG.replace("log.csv", name))
        printed("fit", "fit.toml", "--no-draw")
        found = _estimates("fit.csv")
        assert_allclose(float(found["radius"]["value"]), 0.17, rtol=1e-4)
        assert_allclose(float(found["track"]["value"]), 0.6, rtol=1e-3)
    Path("fit.toml").write_text(
        LOG.replace("[unk", "[data.rates]\nfront_left_rate = 'a'\n[unk", 1).replace(
            "log.csv", "log.mcap"
        )
    )
    assert "found no joint 'a' among front_right" in printed("fit", "fit.toml", code=2)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("track", "mass"), r"fit.toml:10: .*one of the quantities radius, track.*found 'mass'"),
        (("verb", "frame = 'x'\nverb"), r"fit.toml:2: .*'paper' or 'rep103'.*'x'"),
        (('"fit"', "'fit-over-map'"), r"fit.toml:2: .*'fit-over-map'; use slipfree fit, verb"),
        (("verb", "train = 0.5\nverb"), r"fit.toml:2: .*'train' of earlier versions; omit it"),
        (("window = 1.0", "window = -1"), r"fit.toml:\d+: data.window: .*than 0, or text in quo"),
        (("file =", "delay = 1\nfile ="), r"fit.toml:7: .*earlier versions; use 'constants.delay'"),
    ],
)
def test_errors_name_the_line(change: tuple[str, str], words: str) -> None:
    Path("log.csv").write_text("t,x,y,heading\n0,0,0,0\n1,0,0,0\n")
    Path("fit.toml").write_text(LOG.replace(*change))
    found = printed("fit", "fit.toml", code=2)
    assert re.search(words, found), found


STRAIGHT = "".join(f"{name}_rate = 'rate'\n" for name in ("front_left", "front_right"))
STRAIGHT += "".join(f"{name}_rate = 'rate'\n" for name in ("rear_left", "rear_right"))


def test_undetermined_unknowns_end_with_exit_code_1() -> None:
    """A straight drive says nothing about the track."""
    times = np.arange(0, 20.05, 0.1)
    y = 0.17 * (2 * times + 1 - np.cos(times)) + np.random.default_rng(0).normal(0, 1e-3, 201)
    rows = zip(times, 0 * times, y, 0 * times, 2 + np.sin(times), strict=True)
    write_rows(Path("log.csv"), ["t", "x", "y", "heading", "rate_rad_s"], rows)
    Path("fit.toml").write_text(
        LOG.replace("prior = [0.57, 0.3]\n", "").replace("[unk", f"[data.rates]\n{STRAIGHT}[unk", 1)
    )
    shown = printed("fit", "fit.toml", "--no-draw", "--write", "v.toml", code=1)
    assert re.search(r"track .*as its prior: not determined by these data\)", shown)
    assert "no information on track; no vehicle was written" in shown
    assert not Path("v.toml").exists()
    assert_allclose(float(_estimates("fit.csv")["radius"]["value"]), 0.17, rtol=0.01)


@pytest.mark.parametrize("name", sf.catalog.__all__)
def test_vehicles_of_the_catalogue_are_written(name: str) -> None:
    """Axles are written as vectors, and joints are sorted by their distance from the platform."""
    vehicle = getattr(sf.catalog, name)()
    Path("v.toml").write_text(vehicle_text(vehicle, ["comment"]))
    found = sf.read_vehicle("v.toml")
    wheels = tuple(replace(wheel, axle=unit_vector(wheel.axle)) for wheel in vehicle.wheels)
    assert tuple(replace(w, axle=unit_vector(w.axle)) for w in found.wheels) == wheels
    assert sorted(found.joints, key=str) == sorted(vehicle.joints, key=str)
    assert (found.name, found.coordinates, found.body) == (
        vehicle.name,
        vehicle.coordinates,
        vehicle.body,
    )


TIMES = np.linspace(0, 20, 201)
YAW = 0.5 * TIMES  # more than a turn
CIRCLE = np.column_stack([TIMES, 3 + 0 * TIMES, 4 + 0 * TIMES, np.sin(YAW), 1 - np.cos(YAW), YAW])


@pytest.mark.parametrize(
    ("factors", "words"),
    [
        ({0: 1e3}, "times in ms, as in 't [ms]'"),
        ({0: 1 / 60}, "times in minutes, as in 't [minutes]'"),
        ({1: 30 / np.pi, 2: 30 / np.pi}, "rates in rpm, as in 'left [rpm]'"),
        ({3: 1e3, 4: 1e3}, "positions in mm, as in 'x [mm]'"),
        ({0: 1 / 86400}, "probably another unit"),
    ],
)
def test_units_by_the_travel_of_the_wheels(factors: dict[int, float], words: str) -> None:
    log = CIRCLE.copy()
    log[:, 0] /= 100  # so dense that milliseconds pass for seconds
    log[:, 1:3] *= 100
    for column, factor in factors.items():
        log[:, column] *= factor
    values = {"x": log[:, 3], "y": log[:, 4]}
    read = MotionLog(Path("log.csv"), log[:, 0], values, (), Counter(), (0.0, 0.0))
    check = partial(check_motion, read, ratios=rate_ratios([0.15, 0.15]))
    with pytest.raises(sf.DataError, match=re.escape(words)):
        check(speed=0.15 * log[:, 1:3].mean(axis=1))
    check(speed=np.where(TIMES < 10, 1.0, -0.2) * log[:, 1])  # the wheels slip


def test_missing_columns_of_logs_without_a_problem_file() -> None:
    Path("log.csv").write_text("a,b\n1,2\n2,3\n")
    assert "as in --set data.columns.x=east; the unit" in printed("fit", "log.csv", code=2)
    Path("car.toml").write_text(vehicle_text(sf.catalog.ackermann(), []))
    found = printed("fit", "log.csv", "--vehicle", "car.toml", code=2)
    assert "data.rates, as in --set data.columns.x=east, or hold joints that do not move" in found


def test_logs_without_a_problem_file_over_a_map() -> None:
    """The fit is kept, has its facts, and predicts other logs as the fit without them does."""
    t, sides, place, heading = drives(2, duration=24.0, size=1.0)
    for k, name in enumerate(("a.csv", "b.csv")):
        columns = [t, place[:, k].real, place[:, k].imag, heading[:, k], *sides[:, :, k].T]
        rows = np.column_stack(columns)[::2].tolist()
        write_rows(Path(name), ["t", "x", "y", "heading", "left", "right"], rows)
    heights = "\n".join(" ".join(map(str, row)) for row in HILL.z.T[::-1].tolist())
    head = "ncols 81\nnrows 81\nxllcenter -40\nyllcenter -40\ncellsize 1\n"
    Path("hill.asc").write_text(f"{head}{heights}\n")
    vehicle = sf.catalog.rigid_skid_steer(half_track=HALF, wheelbase=2 * HALF, r1=0.1, r2=0.1)
    Path("robot.toml").write_text(vehicle_text(vehicle, []))
    own = ["--map", "hill.asc", "--vehicle", "robot.toml", "-o", "fit.nc", *sets("frame=rep103")]
    fitted = json.loads(printed("--json", "fit", "a.csv", *own, *["--predict", "b.csv"] * 2))
    names = {each["name"] for each in fitted["estimates"]}
    assert {"radius_left", "track", "stiffness", "friction", "turn_slope"} <= names
    assert [each["position_rms"] < 0.05 for each in fitted["errors"] if each["duration"] == 2] == [
        True
    ]
    further = ["--predict", "b.csv", "--no-draw"]
    again = printed("--json", "fit", "fit.nc", *further, "b.csv", "-o", "p.csv")
    assert json.loads(again)["errors"] == fitted["errors"]
    assert json.loads(printed("--json", "info", "fit.nc"))["facts"] == fitted["facts"]
    assert "a fit, which has no motion; use slipfree info" in refused("report", "fit.nc")
    assert "wrote fit_fit.csv" in printed("fit", "fit.nc", *further)
    assert "data.rates: expected a vehicle" in refused("fit", "a.csv", *sets("data.rates.a='b'"))
    surfaces = sets("frame=rep103", "data.surfaces=['x', 'y']")
    printed("fit", "a.csv", "b.csv", "-o", "two.csv", "--no-draw", *surfaces)
    assert "one of x, y, found none" in refused("fit", "two.nc", *further)
    assert "windows" in printed("fit", "two.nc", *further, *sets("data.surfaces=['y']"))
    Path("c.nc").write_bytes(b"CDF\x01")
    assert "expected" in printed("fit", "c.nc", *further, code=2)
