"""Problems with ``model = "dynamics"`` at the shell."""

from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from slipfree import open_result
from slipfree.cli import app

PROBLEMS = Path(__file__).parents[2] / "problems"
ROCKS = str(PROBLEMS / "dynamics_rocks.toml")


def invoke(*words):
    """Return the result of a command."""
    return CliRunner().invoke(app, [str(word) for word in words])


def test_a_run_tells_contact_and_energy_and_is_reported(tmp_path):
    file = tmp_path / "r.nc"
    done = invoke("run", ROCKS, "-o", file, "--set", "time.duration=1", "--figures-all")
    assert done.exit_code == 0, done.output
    for name in ("compliant contact", "vehicle in the air", "energy balance", "a prediction with"):
        assert name in done.output
    drawn = {each.stem for each in (tmp_path / "r_figures").iterdir()}
    assert {"contact", "energy", "checks"} <= drawn
    run = open_result(file).trajectory
    energy = run["kinetic_energy"] + run["potential_energy"] + run["contact_energy"]
    gain = energy - energy[0] - run["work"] + run["lost_energy"]
    exchanged = np.abs(run["work"]).max() + run["lost_energy"][-1]
    assert np.abs(gain).max() < 100 * 1e-6 * exchanged
    assert run["velocity_x"][0] == pytest.approx(1.0, abs=0.01)  # the initial speed
    reported = invoke("report", file, "-o", tmp_path / "r.html")
    assert reported.exit_code == 0, reported.output
    page = invoke("show", file, "--html", tmp_path / "page.html")
    assert page.exit_code == 0, page.output


def test_a_check_gives_the_start_at_equilibrium():
    done = invoke("check", ROCKS)
    assert done.exit_code == 0, done.output
    assert "lightest wheel" in done.output


@pytest.mark.parametrize(
    ("problem", "settings", "words"),
    [
        (ROCKS, ["terrain.friction="], "dynamics: expected a ground with a coefficient of"),
        (ROCKS, ["vehicle.mass=0", "vehicle.wheel_mass=0"], "dynamics: expected a vehicle with"),
        (ROCKS, ["formulation=montana"], "expected model = 'kinematics' with formulation"),
        (ROCKS, ["law.coulomb={ creep = 1e-3 }"], "model = 'quasi-static', where this law applies"),
        (ROCKS, ["start.sped=1"], "did you mean 'speed'?"),
        (
            str(PROBLEMS / "plan_real_dem.toml"),
            ["model=dynamics"],
            "model: expected 'kinematics' or 'quasi-static' in a plan, found 'dynamics'",
        ),
    ],
)
def test_mistakes_are_reported(problem, settings, words, tmp_path):
    options = [part for each in settings for part in ("--set", each)]
    done = invoke("run", problem, "-o", tmp_path / "r.nc", *options)
    assert done.exit_code == 2
    assert words in " ".join((done.output + done.stderr).split())
