"""Add a verb of problem files: one module and one entry of `VERBS`.

`Stand` and `StandVerb` are the module ``problem/verbs/stand.py`` (26 lines without docstrings and
imports), and ``StandVerb()`` is the entry of ``VERBS`` in ``problem/load.py``: two files.
Problem files, commands, sweeps, reports and result files accept the verb without other changes.
"""

from concurrent.futures import Future
from pathlib import Path
from typing import Any, Literal

import pytest
from matplotlib.figure import Figure
from pydantic import Field

from helpers.commands import printed
from slipfree.core.facts import Fact, rows
from slipfree.core.records import leaves
from slipfree.files.netcdf import NOTHING
from slipfree.models.kinematics import direct_kinematics
from slipfree.problem import load
from slipfree.problem.build import Setup, build_start, build_world
from slipfree.problem.result import open_result
from slipfree.problem.schema import MotionKeys, Time
from slipfree.problem.verbs.base import DriveVerb
from slipfree.show.plots import Plot
from slipfree.system.processes import Processes


class Stand(MotionKeys):
    """Standing: the pose of the vehicle at its start, and the loads on its wheels."""

    verb: Literal["stand"]
    time: Time = Field(default=Time(duration=1.0, step=1.0), description="of no importance")


class StandVerb(DriveVerb):
    """Pose at the start, and loads on the wheels."""

    schema = Stand
    metrics_shown = ("load_least",)
    rows = rows("*load on wheel {name}: <loads> {fact:.4g} N")

    def build(self, problem: Any) -> Setup:
        """Return the model and the settled start."""
        world = build_world(problem)
        dae = direct_kinematics(world.vehicle, world.terrain)
        start = build_start(problem, dae)
        inputs = dae.inputs(**{label.full: 0.0 for label in leaves(dae.labels.u)})
        drive = {"start": start, "inputs": inputs, "t": start.t, "driven": "nothing"}
        return Setup(**vars(world), model=dae, dae=dae, **drive)

    def drive(self, problem: Any, setup: Setup, watch: Any, resume: Any) -> Any:
        """Return the start."""
        return setup.start, NOTHING

    def facts(self, run: Any) -> dict[str, Fact]:
        """Return the loads and the least load beside the facts of every motion."""
        loads = dict(zip(run.wheels, run["force_normal"][0].tolist(), strict=True))
        least = Fact(min(loads.values()), "N")
        return super().facts(run) | {"loads": Fact(loads), "load_least": least}

    def figures(self, result: Any) -> tuple[Plot, ...]:
        """Return a bar for each wheel."""
        run = result.trajectory

        def loads() -> Figure:
            figure = Figure()
            figure.subplots().bar(run.wheels, run["force_normal"][0])
            return figure

        return (Plot("loads", "Loads on the wheels.", loads),)


PROBLEM = """\
verb = "stand"
terrain.synthetic = { x = [-3, 3], y = [-3, 3], spacing = 0.25 }
vehicle = { catalog = "three_wheeler", mass = 30.0 }
start = { heading = 0.5 }
"""


@pytest.fixture(autouse=True)
def _added(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "p.toml").write_text(PROBLEM)
    monkeypatch.setattr(load, "VERBS", (*load.VERBS, StandVerb()))


@pytest.mark.slow
def test_commands_take_a_new_verb() -> None:
    found = printed("run", "p.toml", "--draw")
    assert "load on wheel front" in found
    assert Path("p_figures/loads.png").is_file(), found
    assert "ok" in printed("check", "p.toml")
    assert "wheel front" in printed("vehicle", "p.toml", "--verbose")
    assert "load on wheel front" in printed("info", "p.nc")
    assert "figures: " not in printed("report", "p.nc")
    assert "load on wheel front" in Path("p.html").read_text()


def test_its_results_are_of_its_kind() -> None:
    printed("run", "p.toml", "--no-draw")
    result = open_result("p.nc")
    assert (result.kind, result.verification) == ("stand", {})
    assert result.problem.spec.start == {"heading": 0.5}
    assert result.trajectory["force_normal"].sum() == pytest.approx((30 + 3 * 2) * 9.81)


class InProcess(Processes[Any, Any]):
    """A pool in this process: those of others do not have the verb."""

    def submit(self, task: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(self._function(task))
        return future

    def result(self, future: Future[Any], task: Any) -> Any:
        return future.result()


@pytest.mark.slow
def test_it_is_swept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slipfree.sweep.Processes", InProcess)
    found = printed("sweep", "p.toml", "--vary", "vehicle.mass=20:40:3", "--no-draw")
    assert "load_least" in found
    assert len(Path("p_sweep/table.csv").read_text().splitlines()) == 4
