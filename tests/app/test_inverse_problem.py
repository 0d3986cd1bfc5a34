"""Tests of inverse problems on the command line: results and errors."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.cases import PROBLEMS
from helpers.commands import invoke, printed, refused, sets
from slipfree.core.trajectory import Outcome, SolverError, Stop
from slipfree.files import netcdf
from slipfree.problem.load import load_problem
from slipfree.problem.result import run_problem
from slipfree.problem.verbs import inverse

GIVEN = """\
[given]
velocity_x = 0.01255
velocity_y = 0.12865
heading_rate = 0.0159
"""
PATH = """\
[path]
t = [0, 1, 2, 3, 4, 5]
x = [0, 0, 0, 0, 0, 0]
y = [0, 0.135, 0.27, 0.405, 0.54, 0.675]
heading = [0, 0, 0, 0, 0, 0]
"""
PROBLEM = f"""\
verb = "inverse"
terrain.synthetic = {{ x = [-3, 3], y = [-3, 4], spacing = 0.25 }}
vehicle.catalog = "three_wheeler"
start.heading = 0
time = {{ duration = 0.5, step = 0.1 }}
{GIVEN}"""
RIDGES = "terrain.synthetic.power_law={rms=0.05, hurst=0.9, longest=8.0, shortest=2.0, seed=3}"
LOOSE = "solver.tolerance=1e-5"
CSV = "t,x,y,heading\n" + "".join(f"{k},0.0,{0.135 * k:.3f},0\n" for k in range(6))


@pytest.fixture(autouse=True)
def folder(folder):
    (folder / "p.toml").write_text(PROBLEM)
    (folder / "path.toml").write_text(PROBLEM.replace(GIVEN, PATH))
    (folder / "file.toml").write_text(PROBLEM.replace(GIVEN, '[path]\nfile = "way.csv"\n'))
    (folder / "way.csv").write_text(CSV)
    return folder


@pytest.mark.slow
def test_given_rates(folder: Path) -> None:
    result = invoke("run", "p.toml", "--csv", "p.csv")
    assert (result.exit_code, result.stderr) == (0, ""), result.output
    assert "drew " in result.stdout
    told = invoke("info", "p.nc").stdout
    for words in (
        "driven by  ",
        "velocity_x 0.01255 m/s, velocity_y 0.12865 m/s, heading_rate 0.0159 rad/s",
        *("the steering angle is unknown", "rate of wheel right ", "rad/s at the end", "margin "),
        *("steering angle ", "steering slip ", "outcome "),
    ):
        assert words in told, words
    motion = netcdf.read("p.nc")
    assert_allclose(motion["x"][-1], 0.5 * 0.01255, atol=1e-9)
    assert_allclose(motion["steer"][0], np.arctan2(-0.01255 + 0.0159, 0.12865), atol=1e-9)
    assert_allclose(motion["right_rate"][0] - motion["left_rate"][0], 2 * 0.0159 / 0.3, atol=1e-9)
    assert {"steer_rate", "steering_slip"} < set(motion)
    trip = max(v.value for k, v in motion.facts.items() if k.startswith("round_trip_"))
    assert trip < 1.1 * motion["steering_slip"].max() + 1e-12  # no more than the steering slips
    assert motion.facts["replay_x"].value < 1e-4
    assert motion.attributes["driven_by"].startswith("velocity_x 0.01255 m/s")
    assert "steering_slip" in (folder / "p.csv").read_text().splitlines()[0]
    info = invoke("info", "p.nc", code=0)
    assert "driven by  " in info.stdout
    assert "rate of wheel left " in info.stdout


def test_given_rates_come_back_as_wheel_rates_and_omega_is_known_too() -> None:
    omega = ["--set", "given={velocity_y=-0.2, velocity_x=0.0, omega_z=0.01}"]
    invoke("run", "p.toml", "--no-draw", *omega, code=0)
    motion = netcdf.read("p.nc")  # backwards
    assert_allclose(motion["right_rate"][0], (-0.2 + 0.01) / 0.3, atol=1e-9)
    assert_allclose(motion["steer"][0], np.arctan(1.5 * 0.01 / -0.2) + 0.0, atol=0.05)


def test_check_and_vehicle() -> None:
    for file, words in (
        ("p.toml", "heading_rate 0.0159 rad/s; the steering angle is unknown"),
        ("path.toml", "path of 6 way-points in 5 s; the steering angle is unknown"),
    ):
        result = invoke("check", file, code=0)
        assert words in result.stdout
        assert result.stdout.startswith("ok ")
    assert "yes (slip = 'rolling')" in invoke("vehicle", "p.toml", "--verbose", code=0).stdout


@pytest.mark.slow
def test_along_a_path() -> None:
    result = invoke("run", "file.toml", "--no-draw", *sets("time.duration=1", LOOSE, RIDGES))
    assert (result.exit_code, result.stderr) == (0, ""), result.output
    told = invoke("info", "file.nc").stdout
    for words in ("path of 6 way-points in 5 s", "collocation ", "differs by at most x "):
        assert words in told, words
    motion = netcdf.read("file.nc")
    assert_allclose(motion["y"], 0.135 * motion.t, atol=1e-6)
    assert 0 < motion.facts["replay_steer"].value < 1e-3
    assert "replay by the direct model" in told


def test_headings_of_a_path_are_in_the_frame_of_the_problem() -> None:
    quarter = f"path.heading=[{', '.join(['1.5707963267948966'] * 6)}]"
    words = sets("frame=rep103", "start.heading=1.5707963267948966", quarter)
    assert invoke("check", "path.toml", *words).exit_code == 0


@pytest.mark.slow
def test_a_tilt_stop_ends_the_motion() -> None:
    for file, words in (("p.toml", []), ("path.toml", sets("time.duration=3", LOOSE))):
        result = invoke(
            "run", file, "--no-draw", *words, *sets("vehicle.tilt_stop=0.004", RIDGES), code=1
        )
        assert "limit reached at t = " in result.stderr
        assert "reaches its stop" in result.stdout
        assert netcdf.read(file.replace("toml", "nc")).stop is not None


@pytest.mark.slow
def test_steering_by_rate_warns_where_it_is_unstable() -> None:
    settings = sets("steering=rate", "time.duration=0.03", "time.step=0.01")
    result = invoke("run", str(PROBLEMS / "paper_inverse.toml"), "--no-draw", *settings, code=0)
    assert result.stderr.startswith("warning: unstable steering from t = 0 s: errors of the")
    assert "warning  " in result.stdout
    told = invoke("info", "paper_inverse.nc").stdout
    assert all(name in told for name in ("warning  ", "steering rate  "))
    assert "steering mode" not in invoke("run", "p.toml", "--no-draw").output


def test_steering_by_rate_is_stable_where_its_contact_trails() -> None:
    down = "terrain.synthetic.placed_rocks=[[0.0, 0.4, 2.4, 0.15]]"
    settings = sets("steering=rate", "time.duration=0.3", down)
    result = invoke("run", "p.toml", "--no-draw", *settings)
    assert (result.exit_code, result.stderr) == (0, ""), result.output
    motion = netcdf.read("p.nc")
    assert motion["steering_growth"].max() < 0
    trip = [v.value for k, v in motion.facts.items() if k.startswith("round_trip_")]
    assert len(trip) == 3
    assert max(trip) < 1e-12
    assert motion.facts["replay_x"].value < 1e-6


@pytest.mark.slow
def test_a_failure_of_unstable_steering_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = load_problem(PROBLEMS / "paper_inverse.toml", ["steering=rate", "time.duration=0.1"])
    motion = run_problem(problem).trajectory
    assert motion.stop is not None  # it runs into the axis
    assert motion.statistics["steps"] < 5000  # what is singular is noticed, not ground through
    stop = Stop("solver", float(motion.t[-1]), "gave up", Outcome.SOLVER_FAILURE)
    reached = replace(motion, stop=stop, attributes={})

    def fail(*_: Any, **__: Any) -> None:
        raise SolverError("gave up", reached)

    monkeypatch.setattr("slipfree.solve.simulate.simulate", fail)
    file = str(PROBLEMS / "paper_inverse.toml")
    result = invoke("run", file, "--no-draw", "-o", "q.nc", *sets("steering=rate"), code=1)
    assert len(result.stderr.splitlines()) == 1
    line = result.stdout.splitlines()[0]
    assert "gave up; unstable steering from t = 0 s: errors of the steering angle grow" in line
    stop = netcdf.read("q.nc").stop
    assert stop is not None
    assert (stop.name, stop.t) == ("solver", motion.stop.t)


def test_failures_along_a_path(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise error

    error: BaseException = SolverError("it gave up")
    monkeypatch.setattr(inverse, "replay", fail)
    result = invoke("run", "path.toml", "--no-draw", *sets(LOOSE))
    assert (result.exit_code, result.stderr) == (0, "")
    assert re.search("replay stopped early +it gave up\n", result.stdout)
    assert_allclose(netcdf.read("path.nc")["y"][-1], 0.135 * 0.5, atol=1e-6)
    monkeypatch.setattr(inverse, "drive", fail)
    result = invoke("run", "path.toml", "--no-draw")
    assert (result.exit_code, result.stderr) == (1, "it gave up\n")
    error = KeyboardInterrupt()
    result = invoke("run", "path.toml", "--no-draw")
    assert (result.exit_code, result.stderr) == (130, "interrupted\n")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, "way.csv: expected way-points as text, found that it cannot be read"),
        (CSV.replace("3,0.0,", "3,"), "way.csv:5: expected four numbers t,x,y,heading, found '3,"),
        (
            CSV.replace(",0.0,", "000,0.0,").replace("0000,", "0,"),
            "found rows 1000 s apart (median); if the times are in other units, name them in the",
        ),
    ],
)
def test_what_is_wrong_with_the_file_of_a_path(text: str | None, words: str) -> None:
    Path("way.csv").unlink()
    if text is not None:
        Path("way.csv").write_text(text)
    assert words in refused("check", "file.toml")


def test_what_belongs_to_direct_kinematics_is_refused() -> None:
    assert "p.toml:1: verb: expected 'direct' for --cross-check, found 'inverse'" in refused(
        "run", "p.toml", "--no-draw", "--cross-check"
    )
    assert "expected 'compare' for this command, found 'inverse'; use slipfree run p.toml" in (
        refused("compare", "p.toml")
    )
    words = refused("check", "p.toml", "--set", "verb=compare")
    assert "found 'compare'; use slipfree compare p.toml" in words


@pytest.mark.slow
def test_the_shipped_problems_run() -> None:
    given = run_problem(load_problem(PROBLEMS / "paper_inverse.toml", ["time.step=0.5"])).trajectory
    assert given.stop is not None
    assert given.stop.name == "tilt_right_stop"
    assert_allclose(given.stop.t, 4.33, atol=0.02)
    path = run_problem(load_problem(PROBLEMS / "path_inverse.toml", ["time.duration=3.0", LOOSE]))
    motion = path.trajectory
    assert motion.stop is None
    assert motion.t[-1] == 3.0
    assert motion["steering_growth"].max() > 0  # integrating it would be unstable
    assert max(v.value for k, v in motion.facts.items() if k.startswith("replay_")) < 1e-3


def test_a_path_may_be_sampled_more_coarsely_than_it_is_solved(tmp_path):
    """Elements of the collocation without a sample are no trouble."""
    file = str(PROBLEMS / "path_inverse.toml")
    coarse = sets("time.duration=6", "time.step=6")
    invoke("run", file, "--no-draw", "-o", str(tmp_path / "p.nc"), *coarse, code=0)


def test_a_path_of_another_program() -> None:
    """Separators, decimal commas, milliseconds and degrees are read; the summary says so."""
    rows = [line.split(",") for line in CSV.splitlines()[1:]]
    lines = [f"{int(t) * 1000};{x};{y};0;odom".replace(".", ",") for t, x, y, _ in rows]
    Path("way.csv").write_text("\n".join(["time [ms];X;Y;yaw_deg;frame", *lines]))
    words = " ".join(printed("check", "file.toml").split())
    assert "path of 6 way-points in 5 s; " in words
    assert "time [ms] converted from ms to s; yaw_deg converted from deg to rad" in words
