"""Tests of problems of rigid vehicles: summary of a drive, and plans with sharper load laws."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from helpers.commands import invoke
from helpers.problem_files import rough_ground
from slipfree.core.trajectory import PLAN, Outcome, Stop
from slipfree.files.netcdf import read
from slipfree.plan.plan import Plan
from slipfree.problem.verbs import plan_search as module

DRIVE = """\
verb = "direct"
vehicle = { catalog = "rigid_skid_steer" }
start = {}
time = { duration = 2.0, step = 0.05 }

[inputs]
front_right_rate = 4.0
front_left_rate = 4.0
rear_right_rate = 4.0
rear_left_rate = 4.0
""" + rough_ground("[-2, 2]", "[-2, 4]", 0.1, "rms = 0.04, longest = 3.0, shortest = 1.0", 4)
GOAL = """
goal = { y = 1.2 }
costs = { slip = 100.0, effort = 0.001 }
plan = { intervals = 8, smooth = 1e-4, accuracy = 0.01 }
"""


@pytest.fixture
def plan_file(folder: Path) -> str:
    """Write the problem of a plan into an empty current folder."""
    (folder / "p.toml").write_text(DRIVE.replace('"direct"', f'"plan"{GOAL}'))
    return "p.toml"


def run(file: str, *words: str, code: int = 0) -> str:
    result = invoke("run", file, "--no-draw", "-v", *words)
    assert result.exit_code == code, result.output
    return result.stdout


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_a_summary_has_wheels_in_the_air_and_rocks():
    Path("d.toml").write_text(DRIVE)
    facts = run("d.toml")
    for name in ("pressed wheels", "wheels in the air", "least loaded wheel"):
        assert f"\n{name} " in facts
    assert "x the tolerance" not in facts  # the error test ignores the unknowns


@pytest.mark.slow
def test_a_plan_is_made_with_three_widths_and_simulated_with_stiffer_wheels(plan_file, monkeypatch):
    models = observed(monkeypatch)
    assert "with wheels ten times stiffer" in run(plan_file)
    assert len(models) == 1 + len(module.SMOOTHINGS)
    assert read(Path("p.nc")).outcome is Outcome.COMPLETE


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fails", "outcome"),
    [(Outcome.SOLVER_FAILURE, Outcome.COMPLETE), 2 * (Outcome.INTERRUPTED,)],
)
def test_a_plan_survives_the_failure_of_a_sharper_law(plan_file, monkeypatch, fails, outcome):
    models = observed(monkeypatch, fails=fails)
    run(plan_file, code=outcome.exit_code)
    assert len(models) == 2
    assert read(Path("p.nc")).outcome is outcome


FIRST: list[Plan] = []  # the plan with the widest law, which all tests begin with


def observed(monkeypatch: pytest.MonkeyPatch, fails: Outcome | None = None) -> list[Any]:
    """Record the models of all plans; the second one ends with an outcome."""
    models, solve_task = list[Any](), module.solve_task

    def planned(task: Any, *words: Any, **more: Any) -> Plan:
        models.append(task.dae)
        if len(models) == 1:
            if not FIRST:
                FIRST.append(solve_task(task, *words, **more))
            return FIRST[0]
        if fails is None:
            return solve_task(task, *words, **more)
        run = FIRST[0].run
        stop = Stop(PLAN, float(run.t[-1]), "made up", fails)
        return replace(FIRST[0], success=False, run=replace(run, stop=stop))

    monkeypatch.setattr(module, "solve_task", planned)
    return models


@pytest.mark.usefixtures("folder")
def test_remedies_for_a_rigid_vehicle_are_values_of_the_file():
    """Quasi-statics cannot place a rigid vehicle; each model that its message names can."""
    text = DRIVE.replace('"direct"', '"direct"\nmodel = "quasi-static"\nterrain.friction = 0.8')
    Path("p.toml").write_text(text)
    result = invoke("run", "p.toml", "--no-draw", code=2)
    remedies = re.findall(r"'(\w+)'", result.stderr.split(";")[-1])
    assert remedies == ["dynamics", "kinematics"]
    for model in remedies:
        run("p.toml", "--set", f"model={model}", "--set", "time.duration=0.2")
