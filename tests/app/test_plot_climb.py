"""Tests of the figures of climbs."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib import image
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from numpy.testing import assert_allclose
from PIL import Image

from helpers.climb_cases import SENSED, STEP, TWICE, climb
from slipfree.climb.metrics import disturbance_ratio, metrics, slip_ratio
from slipfree.errors import ModelError
from slipfree.records import Label
from slipfree.show import climb_figures as show
from slipfree.show import plots
from slipfree.show.climb_scene import climb_scene, in_space
from slipfree.show.film import animate
from slipfree.trajectory import Column, Trajectory
from slipfree.vehicle.climber import AXLES


@pytest.fixture(scope="module")
def case():
    return climb(STEP, SENSED, TWICE)


@pytest.fixture
def ax():
    return Figure(layout="constrained").subplots()


def named(ax):
    return {line.get_label(): line for line in ax.lines if not line.get_label().startswith("_")}


def test_the_strobe_shows_vehicle_and_ground(case, ax):
    climber, profile, run = case
    show.strobe(run, climber, profile, ax, every=0.5)
    solids = [patch for patch in ax.patches if isinstance(patch, Polygon)]
    wheels = [patch for patch in ax.patches if isinstance(patch, Circle)]
    assert_allclose(solids[1].get_xy()[:-1], profile.solids[1].points)
    shown = range(0, run.t.size, 500)  # every second: every other dot
    assert_allclose(
        [wheel.center for wheel in wheels],
        [(run["center_y"][k, i], run["center_z"][k, i]) for k in shown for i in range(3)],
        atol=1e-12,
    )
    assert {wheel.radius for wheel in wheels} == {climber.radius}
    dots = [line.get_xydata() for line in ax.lines if line.get_marker() == "o"]
    assert len(dots) == 8  # 3.6 s, every 0.5 s
    assert_allclose(dots[3][:, 0], run["center_y"][750])
    assert ax.get_aspect() == 1
    low, high = ax.get_xlim()
    assert low < run["center_y"].min() - climber.radius
    assert high > run["center_y"].max() + climber.radius


def test_links_meet_in_the_joint_and_carry_their_centers(case):
    climber, _, run = case
    for k in (0, 700, 1500):
        links, centers = show._skeleton(run, climber, k)
        assert_allclose(np.hypot(*np.diff(links)), [-climber.rear.ahead, climber.front.ahead])
        assert_allclose(
            np.hypot(*(centers - links[:, 1:2])),
            [np.hypot(b.ahead, b.above) for b in (climber.rear_body, climber.front_body)],
        )


def test_ratios_over_time_average_to_the_metrics(case, ax):
    climber, profile, run = case
    show.slip(run, climber, ax)
    for k, axle in enumerate(AXLES):
        shown = np.clip(100 * slip_ratio(run, climber)[:, k], -100, 100)
        assert_allclose(named(ax)[axle].get_ydata(), shown)
    span = metrics(run, climber, profile).window.span
    lines = named(show.true_slip(run, climber, profile, Figure().subplots()))
    for k, axle in enumerate(AXLES):  # ways slipped over ways of the rim
        rim = np.abs(run["spin", axle][span])
        slipped = np.nan_to_num(np.abs(lines[axle].get_ydata()[span])) / 100 * rim
        expected = metrics(run, climber, profile).true_slip[k]
        assert slipped.sum() / rim.sum() == pytest.approx(expected, rel=0.05)  # cut at 100 %
    lines = named(show.disturbance(run, Figure().subplots()))
    assert_allclose(
        lines["rear"].get_ydata(), np.clip(100 * disturbance_ratio(run)[:, 0], -100, 100)
    )


def test_references_are_rim_speeds(case, ax):
    climber, _, run = case
    show.references(run, climber, ax)
    assert list(named(ax)) == list(AXLES)
    assert_allclose(named(ax)["front"].get_ydata(), 0.066 * run["reference", "front"])
    assert max(named(ax)["front"].get_ydata()) == pytest.approx(1.5 * 0.25)  # the cap


def test_peaks_of_loads_are_cut_off_and_the_limit_is_drawn_when_near(case, ax):
    climber, _, run = case
    show.loads(run, ax)
    assert_allclose(named(ax)["middle"].get_ydata(), run["force_normal", "middle"])
    assert ax.get_ylim()[1] < run["force_normal"].max() / 2
    torques = show.torques(run, climber, Figure().subplots())
    limits = {line.get_ydata()[0] for line in torques.lines[4:]}
    assert limits == {-climber.torque, climber.torque}


def test_plan_and_motion_over_the_way(case):
    climber, profile, run = case
    n = 4
    plan = Trajectory(
        np.arange(n),
        {
            "progress": Column(Label("progress", "m", ""), np.linspace(-0.2, 0.4, n)),
            "wheel_rate": Column(Label("wheel_rate", "rad s-1", ""), np.full((n, 3), 2.0)),
            "friction": Column(Label("friction", "N", ""), np.full((n, 3), -30.0)),
            "load": Column(Label("load", "N", ""), np.full((n, 3), 60.0)),
        },
        AXLES,
        statistics={"mu": 0.6},
    )
    lines = named(show.planned_friction(run, plan, profile, Figure().subplots()))
    assert_allclose(lines["rear"].get_xydata(), [[s, 0.5] for s in plan["progress"]])
    driven = show.planned_friction(run, plan, profile, Figure().subplots()).lines[1]
    assert_allclose(driven.get_xdata()[0], (run["center_y"] + run["center_z"])[0].mean())
    used = np.nan_to_num(driven.get_ydata())
    assert 0.6 < used.max() <= 0.9 + 1e-9  # static friction
    lines = named(show.planned_speeds(run, plan, climber, Figure().subplots()))
    assert_allclose(lines["front"].get_ydata(), 2 * 0.066)
    assert "plan" in plots.draw(show.climb_plots(run, climber, profile, plan))


@pytest.mark.slow
def test_figures_are_written(case, tmp_path):
    climber, profile, run = case
    files = plots.save(show.climb_plots(run, climber, profile), tmp_path / "figures")
    assert [file.stem for file in files] == ["strobe", "references", "slip", "forces"]
    for file in files:
        pixels = image.imread(file)
        assert pixels.shape[1] == pytest.approx(200 * 180 / 25.4, abs=2)
        assert pixels[..., :3].std() > 0.05
    with pytest.raises(ModelError, match=r"expected some of .* found 'bmpx'"):
        plots.save(show.climb_plots(run, climber, profile), tmp_path, ["bmpx"])


@pytest.mark.slow
def test_the_film_moves(case, tmp_path):
    climber, profile, run = case
    short = run.part(slice(int(np.searchsorted(run.t, run.t[0] + 0.6))))
    scene = climb_scene([in_space("step", short, climber, profile)])
    animate(scene, tmp_path / "a.gif", "a step")
    with Image.open(tmp_path / "a.gif") as film:
        assert film.info["duration"] == 50  # in real time
        first = np.asarray(film.convert("L"), dtype=float)
        film.seek(film.n_frames - 1)
        last = np.asarray(film.convert("L"), dtype=float)
    dark = [np.flatnonzero((frame[20:-40] < 60).any(axis=0)) for frame in (first, last)]
    assert np.abs(first - last).max() > 100
    assert dark[0].size > 0
