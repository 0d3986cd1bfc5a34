"""Tests of problems with forces on the command line: results and errors."""

import re
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.cases import DATA, PROBLEMS
from helpers.commands import invoke, printed, sets
from helpers.dynamics import slope
from slipfree import direct_kinematics, settle
from slipfree.catalog import three_wheeler
from slipfree.files import netcdf
from slipfree.models import friction_feasibility
from slipfree.models.force_distribution import least_utilisation
from slipfree.models.friction_feasibility import best_utilisation
from slipfree.problem.load import load_problem
from slipfree.problem.result import build, run_problem
from slipfree.problem.verbs import base as runner

PROBLEM = (DATA / "quasi_static_hill.toml").read_text()


@pytest.fixture(autouse=True)
def file(folder):
    path = folder / "p.toml"
    path.write_text(PROBLEM)
    return path


def called(verb, *settings, code=0):
    words = sets(*settings)
    draw = ["--no-draw"] if verb == "run" else []
    return invoke(verb, "p.toml", *draw, *words, code=code)


def facts(verb, *settings, code=0):
    told = called(verb, *settings, code=code)
    shown = invoke("info", "p.nc") if verb == "run" else told
    lines = shown.stdout.splitlines()
    return {name.strip(): words for name, _, words in (line.partition("  ") for line in lines)}


def test_run_tells_what_the_motion_takes():
    told = {name: words.strip() for name, words in facts("run").items()}
    assert told["mass"] == "36 kg, weight 353.2 N"
    assert told["gravity"] == "9.81 m/s^2 (earth)"
    assert told["ground friction"] == "0.6"
    assert told["slip"].endswith("; a quasi-static prediction by the wheel-ground law 'coulomb'")
    shown = r"utilisation at most 0\..* of the coefficient 0\.6 by the law 'coulomb'; at most 0"
    assert re.match(shown, told["friction"])
    written = netcdf.read(Path("p.nc"))
    k, i = np.unravel_index(written["utilisation"].argmax(), written["utilisation"].shape)
    where = f"wheel {written.wheels[i]}, load {written['force_normal'][k, i]:.4g} N, t = "
    assert f"{where}{written.t[k]:.4g} s" in told["friction"]
    assert written["utilisation_best"].max() <= written["utilisation"].max() + 1e-9
    written["utilisation"][k, i] = 3.5  # of a wheel that bears almost nothing
    words = runner.drive_facts(written)["friction"].value
    assert re.fullmatch(r"utilisation at most 3.5 .* 0\.\d+ .*: friction can be sufficient", words)
    power = np.sum(written["drive_torque"] * written["wheel_rate"], axis=1)
    assert_allclose(written["power"], power, atol=1e-12)
    assert written.attributes["ground_friction"] == "0.6"


def test_gravity_is_a_number_of_the_problem():
    def loads(*settings):
        called("run", *settings)
        return netcdf.read(Path("p.nc"))

    earth, moon = loads(), loads("gravity=moon")
    assert facts("check", "gravity=moon")["gravity"].strip() == "1.62 m/s^2 (moon)"
    assert moon.attributes["gravity"] == "1.62 m/s^2 (moon)"
    assert moon.attributes["mass"] == "36 kg, weight 58.3 N"
    assert moon.facts["gravity"].value == 1.62
    assert earth.facts["gravity"].value == 9.81
    assert_allclose(moon["force_normal"], earth["force_normal"] * 1.62 / 9.81, rtol=1e-6)
    assert_allclose(moon["utilisation"], earth["utilisation"], rtol=1e-6, atol=1e-9)
    assert "3.71" in printed("sweep", "p.toml", "--vary", "gravity=1.62,3.71", "--processes", "1")


def test_samples_that_do_not_converge_are_counted(monkeypatch):
    def some_fail(matrix, load, friction):
        best = least_utilisation(matrix, load, friction)
        return best._replace(utilisation=np.where(np.arange(9) == 3, np.nan, best.utilisation))

    monkeypatch.setattr(friction_feasibility, "least_utilisation", some_fail)
    called("run")
    told = invoke("info", "p.nc").stdout
    assert re.search("^not converged +utilisation_best at 1 of 9 samples$", told, re.MULTILINE)
    assert re.search(r"^friction .*; at most 0\.\d+ with the best dis", told, re.MULTILINE)
    assert np.isnan(netcdf.read(Path("p.nc"))["utilisation_best"]).sum() == 1


def test_a_diagnostic_that_fails_loses_no_motion(monkeypatch):
    def fail(*_):
        raise np.linalg.LinAlgError("gave up")

    monkeypatch.setattr(runner, "best_utilisation", fail)
    assert facts("run")["diagnostics failed"].strip() == "utilisation_best: LinAlgError: gave up"
    assert netcdf.read(Path("p.nc")).t[-1] == 2.0


def test_a_motion_that_friction_does_not_hold_is_said_not_to_be():
    told = facts("run", "model=kinematics", "terrain.friction=0.001", "vehicle.axle=tilting")
    assert told["friction"].endswith("; friction is not sufficient for this motion")
    assert "distribution" not in told["friction"]  # equilibrium leaves nothing open


def test_a_vehicle_without_mass_bears_nothing():
    told = facts("run", "model=kinematics", "vehicle.mass=0", "vehicle.wheel_mass=0")
    assert not {"friction", "mass", "normal forces", "drives"} & set(told)
    assert "force_normal" not in netcdf.read(Path("p.nc")).columns


def test_no_equilibrium_is_an_early_stop_with_what_was_reached():
    # On the level, ice bears standing; on the ramp it does not bear driving down.
    settings = ("terrain.friction=0.1", "terrain.synthetic.ramp.rise=-2.0", "time.duration=20")
    result = called("run", *settings, code=1)
    # Where the equilibrium folds, rounding decides how far beyond it the last sample lies.
    needed = r"(all the friction that|.* at least 0\.100\d,) the ground offers,? 0\.1\n"
    ended = "no equilibrium at t = .* s"
    words = f"{ended}: headed 180 degrees from uphill.* needs {needed}"
    assert re.search(words, result.stdout)
    assert re.fullmatch(f"{ended}; p.nc contains the result so far\n", result.stderr)
    assert netcdf.read(Path("p.nc")).stop.name == "no_equilibrium"
    assert "leans" not in result.stdout  # its wheels are upright


def test_a_motion_that_ends_where_the_model_is_singular_is_explained():
    settings = ["model=quasi-static", "terrain.friction=0.6"]
    stop = run_problem(load_problem(PROBLEMS / "paper_direct.toml", settings)).trajectory.stop
    assert stop.name == "no_equilibrium"
    assert "coefficient of friction" in stop.words


def test_no_equilibrium_tells_how_far_a_wheel_leans():
    settings = (
        *("vehicle.axle=tilting", "terrain.friction=0.2", "inputs.left_rate=0.4", "start.y=-2.5"),
        "time.duration=4",
    )
    result = called("run", *settings, code=1)
    run = netcdf.read(Path("p.nc"))
    assert run.stop.name == "no_equilibrium"
    lean = max(abs(run[name][-1]) for name in ("tilt_right", "tilt_left"))
    told = re.search(r"the ground offers 0.2; a wheel leans by ([\d.]+) rad\n", result.stdout)
    assert float(told[1]) == pytest.approx(lean, abs=2e-3)  # it is that soon after the end
    assert lean > 0.05


def test_springs_masses_and_actuators_reach_the_vehicle(file):
    settings = [
        *("vehicle.axle=tilting", "vehicle.stiffness=60", "vehicle.damping=5", "vehicle.bump=100"),
        *("vehicle.mass=50", "vehicle.center_of_mass=[0, 0.1, 0.2]", "vehicle.wheel_mass=3"),
        "vehicle.grip=0.9",
    ]
    vehicle = build(load_problem(file, settings)).vehicle
    tilt = vehicle.of("passive")[0]
    assert (tilt.stiffness, tilt.damping, tilt.bump) == (60, 5, 100)
    assert (vehicle.body.mass, vehicle.body.at) == (50, (0, 0.1, 0.2))
    assert {(w.mass, w.grip) for w in vehicle.wheels} == {(3, 0.9)}
    settings = [
        "vehicle.axle=tilting",
        "vehicle.actuated=['tilt_right', 'tilt_left']",
        "inputs={ right_rate = 0.5, left_rate = 0.5, steer_rate = 0.0, "
        "tilt_right_rate = 0.0, tilt_left_rate = 0.0 }",
    ]
    motion = run_problem(load_problem(file, settings)).trajectory
    assert np.abs(motion["tilt_right"]).max() < 1e-12
    assert np.abs(motion["tilt_right_torque"]).max() > 0


def test_the_papers_direct_run_needs_more_friction_than_most_grounds_give():
    """The figures of README."""
    motion = run_problem(load_problem(PROBLEMS / "paper_direct.toml")).trajectory
    assert_allclose(motion["tilt_right"][-1], 0.075 * 6, atol=0.1)  # the wheels lie down
    at = [int(np.argmin(np.abs(motion.t - t))) for t in range(7)]
    needed = motion["friction_needed"][at].max(axis=1)
    expected = [0.070, 0.179, 0.289, 0.402, 0.523, 0.654, 0.801]
    assert_allclose(needed, expected, rtol=0, atol=6e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axle", "discs", "expected"),
    [
        ("tilting", False, (0.529, 1.092, 0.936, 0.492, 0.613)),
        ("prismatic", True, (0.258, 0.509, 0.457, 0.492, 0.613)),
        ("fixed", False, (0.177, 0.364, 0.432, 0.492, 0.613)),
    ],
)
def test_least_friction_on_which_the_axles_stand(axle, discs, expected):
    """An earlier study's table (massless wheels, best distribution), within 2 %."""
    size = {"r1": 0.005, "r2": 0.295} if discs else {}
    vehicle = three_wheeler(axle=axle, wheel_mass=0.0, **size)
    poses = (10, 90), (20, 90), (20, 45), (20, 0), (20, 180)
    for (degrees, way), mu in zip(poses, expected, strict=True):
        ground = slope(degrees)
        start = settle(direct_kinematics(vehicle, ground), heading=np.radians(way))
        found = best_utilisation(vehicle, ground, start)["utilisation_best"][0]
        assert found == pytest.approx(mu, rel=0.02)
