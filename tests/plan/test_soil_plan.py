"""A short plan over a sandy slope: limits on slip and sinkage, simulation with inertia."""

from pathlib import Path

import numpy as np
import pytest

from slipfree import load_problem, run_problem
from slipfree.problem.load import verb_of

SLOPE = Path(__file__).parents[2] / "problems" / "plan_sandy_slope.toml"
SHORT = (
    *("law.soil.regions=", "start={x=0.0, y=1.4, heading=1.1}", "goal.y=1.8"),
    *("driver.path=[[0.0, 1.4], [-1.5, 2.15]]", "time.duration=5", "time.step=0.5"),
    *("limits.slip_ratio=[-0.2, 0.22]", "plan.duration=5", "plan.intervals=4", "plan.degree=2"),
    "plan.accuracy=0.03",
)


@pytest.mark.slow
def test_a_plan_over_sand_keeps_its_limit_on_slip_and_is_confirmed_by_dynamics():
    result = run_problem(load_problem(SLOPE, SHORT))
    run, verb = result.trajectory, verb_of(result.problem)
    assert run.stop is None
    assert run["y"][-1] == pytest.approx(1.8, abs=0.02)
    assert run["slip_ratio"].max() == pytest.approx(0.22, abs=5e-3)  # a steeper path is shorter
    assert run["sinkage"].max() < 0.025
    work = run["work"][-1] - run["work"][0]  # of the drives
    assert run.facts["plan_cost_energy"].value == pytest.approx(work, rel=0.02)
    away = run.facts["soil_end_distance"].value
    assert away < 0.03
    lines = dict(verb.summary(run))
    assert lines["simulated with inertia"].startswith(f"ends {away:.3g} m from the plan")
    assert "drawbar-pull reserve" in lines["soil"]
    assert np.isfinite(run["drawbar_reserve"]).all()
    (plot,) = (each for each in verb.figures(result) if each.name == "contact")
    labels = [ax.get_ylabel() for ax in plot.make().axes]
    assert any("reserve" in each for each in labels), labels
