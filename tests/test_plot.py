"""Plots draw without a warning, say what they show, and say why a motion stopped."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure

import slipfree as sf
from slipfree.named import Label
from slipfree.show import plot
from slipfree.trajectory import Column, Trajectory

DOMAIN = (-5.0, 5.0, -4.0, 4.0)
NAMES = ["map", "terrain", "tilts", "loci", "elevation", "slip", "checks"]


def hills(x, y):
    return 2 + 0.1 * ca.sin(x) * ca.cos(0.7 * y) + 0.02 * x


def drive(end: float, tilt_stop: float = np.inf) -> Trajectory:
    dae = sf.direct_kinematics(sf.three_wheeler(tilt_stop=tilt_stop), sf.Analytic(hills, DOMAIN))
    start = sf.settle(dae, x=0.0, y=0.0, heading=-0.3)
    inputs = dae.inputs(right_rate=0.5, left_rate=0.4, steer_rate=0.02)
    return sf.simulate(dae, start, inputs, np.arange(0.0, end, 0.1))


@pytest.fixture(scope="module")
def grid() -> sf.Grid:
    x, y = np.linspace(-5, 5, 61), np.linspace(-4, 4, 51)
    z = sf.Analytic(hills).elevation(*np.meshgrid(x, y, indexing="ij"))
    return sf.Grid(x, y, z)


@pytest.fixture(scope="module")
def run() -> Trajectory:
    return drive(3.05)


@pytest.fixture(scope="module")
def stopped() -> Trajectory:
    return drive(4.0, tilt_stop=0.1)


@pytest.fixture
def ax():
    return Figure(layout="constrained").subplots()


def changed(run: Trajectory, name: str, values: np.ndarray) -> Trajectory:
    label = run.columns[name].label if name in run else Label(name, "rad", name)
    return replace(run, columns={**run.columns, name: Column(label, values)})


def moved(run: Trajectory, x: float, y: float) -> Trajectory:
    by = {"x": x, "contact_x": x, "center_x": x, "y": y, "contact_y": y, "center_y": y}
    for name, shift in by.items():
        run = changed(run, name, run[name] + shift)
    return run


def drawn(figure: Figure) -> Figure:
    """Draw, so that what warns while drawing does so here."""
    figure.draw_without_rendering()
    return figure


def words(figure: Figure) -> str:
    """Return all text of a figure outside its axes."""
    legends = [text for legend in figure.legends for text in legend.get_texts()]
    return " ".join(text.get_text() for text in [*figure.texts, *legends])


def labels(ax) -> list[str]:
    return ax.get_legend_handles_labels()[1]


def test_ground_is_a_map_of_equal_scales(grid, ax):
    assert plot.ground(grid, ax) is ax
    drawn(ax.figure)
    assert ax.get_aspect() == 1.0
    assert (*ax.get_xlim(), *ax.get_ylim()) == DOMAIN
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("east $x$ [m]", "north $y$ [m]")
    heights = ax.images[0].get_array()
    assert heights.shape == (plot.HEATMAP, plot.HEATMAP)
    assert heights.min() == pytest.approx(grid.z.min(), abs=1e-3)


def test_heights_lie_where_they_belong(ax):
    x, y = np.linspace(0, 10, 11), np.linspace(0, 5, 6)
    plot.ground(sf.Grid(x, y, x[:, None] + 100 * y[None, :]), ax)
    heights = ax.images[0].get_array()
    assert heights[0, -1] == pytest.approx(10)  # south east
    assert heights[-1, 0] == pytest.approx(500)  # north west


def test_large_grids_are_thinned(ax):
    x, y = np.linspace(0, 30, 3001), np.linspace(0, 20, 2001)
    plot.ground(sf.Grid(x, y, np.sin(x)[:, None] * np.cos(y)), ax)
    assert ax.images[0].get_array().shape == (plot.HEATMAP, plot.HEATMAP)


def test_flat_ground_is_one_colour(ax):
    x = np.linspace(0, 5, 6)
    plot.ground(sf.Grid(x, x, np.ones((6, 6))), ax)
    drawn(ax.figure)
    assert np.ptp(ax.images[0].get_array()) == 0
    assert not [each for each in ax.collections if len(each.get_paths()) > 1]


def test_path_marks_start_and_end(run, ax):
    assert labels(plot.path(run, ax)) == ["platform", "start, 0 s", "end, 3 s"]
    line, start, end = (h for h in ax.get_legend_handles_labels()[0])
    np.testing.assert_array_equal(line.get_xydata(), np.column_stack([run["x"], run["y"]]))
    assert start.get_xydata()[0] == pytest.approx([run["x"][0], run["y"][0]])
    assert end.get_xydata()[0] == pytest.approx([run["x"][-1], run["y"][-1]])
    drawn(ax.figure)


@pytest.mark.parametrize(("way", "angle"), [((1, 0), -90), ((0, 1), 0), ((-1, 0), 90)])
def test_arrows_point_the_way(run, ax, way, angle):
    s = np.linspace(0, 3, run.t.size)
    run = changed(changed(run, "x", way[0] * s), "y", way[1] * s)
    plot.path(run, ax)
    arrows = [line for line in ax.lines if isinstance(line.get_marker(), tuple)]
    assert len(arrows) == 3
    assert [arrow.get_marker()[2] for arrow in arrows] == pytest.approx([angle] * 3)


def test_path_names_the_stop(stopped, ax):
    assert stopped.stop is not None
    assert labels(plot.path(stopped, ax))[-1].endswith(f"s: {stopped.stop.name}")


def test_tracks_have_a_line_a_wheel(run, ax):
    assert labels(plot.tracks(run, ax)) == ["contact right", "contact left", "contact front"]
    assert len(ax.lines) == 3


def test_terrain_says_how_heights_are_enlarged(run, grid):
    ax = Figure().add_subplot(projection="3d")
    assert plot.terrain(run, grid, ax) is ax
    drawn(ax.figure)
    assert len(ax.lines) == 4
    assert ax.get_zlabel().startswith("height $z$ [m], ")
    assert ax.get_zlabel().endswith(":1")


def test_tilts_and_moving_joints_are_drawn_with_degrees(run, ax):
    assert labels(plot.tilts(run, ax)) == ["tilt right", "tilt left", "steer"]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time $t$ [s]", "joint angle [rad]")
    second = ax.child_axes[0]
    drawn(ax.figure)
    assert second.get_ylabel() == "[deg]"
    assert second.get_ylim() == pytest.approx(np.rad2deg(ax.get_ylim()))


def test_a_joint_at_rest_is_not_drawn(run, ax):
    run = changed(run, "steer", np.zeros(run.t.size))
    assert labels(plot.tilts(run, ax)) == ["tilt right", "tilt left"]


def test_other_joints_are_found_but_not_their_stops(stopped, ax):
    assert "tilt_left_stop" in stopped
    stopped = changed(stopped, "rocker", np.sin(stopped.t))
    assert labels(plot.tilts(stopped, ax)) == ["tilt right", "tilt left", "steer", "rocker"]


def test_a_vehicle_without_joints_is_said_to_have_none(run, ax):
    columns = {k: c for k, c in run.columns.items() if not k.startswith(("tilt_", "steer"))}
    plot.tilts(replace(run, columns=columns), ax)
    assert not ax.lines
    assert ax.texts[0].get_text() == "no joint moves"


@pytest.mark.parametrize("view", [("x", "y"), ("x", "z"), ("y", "z")])
def test_loci_show_centres_contacts_and_platform(run, ax, view):
    plot.loci(run, ax, view)
    drawn(ax.figure)
    assert len(labels(ax)) == 2 * len(run.wheels) + 1
    assert "[m]" in ax.get_xlabel()
    assert "[m]" in ax.get_ylabel()


def test_elevation_is_over_the_distance_driven(run, grid, ax):
    plot.elevation(run, grid, ax)
    contact, platform, below = ax.lines[0], ax.lines[3], ax.lines[4]
    assert platform.get_xdata()[-1] == pytest.approx(sf.trajectory.path_length(run))
    np.testing.assert_array_equal(contact.get_ydata(), run["contact_z", "right"])
    expected = sf.Analytic(hills).elevation(run["x"], run["y"])
    np.testing.assert_allclose(below.get_ydata(), expected, atol=2e-3)


def test_slope_is_that_of_a_ramp(run, ax):
    x, y = np.linspace(-5, 5, 21), np.linspace(-4, 4, 17)
    ramp = sf.Grid(x, y, 0.3 * y + 0 * x[:, None])
    plot.slope(changed(run, "heading", np.zeros(run.t.size)), ramp, ax)
    np.testing.assert_allclose(ax.lines[0].get_ydata(), np.arctan(0.3), atol=1e-12)
    assert ax.get_ylabel() == "slope [rad]"


def test_slip_at_rounding_is_said_to_be_none(run, ax):
    plot.slip(run, "along", ax)
    assert not labels(ax)
    assert "rounding" in ax.texts[0].get_text()
    assert ax.get_ylabel() == "slip along the wheel [mm/s]"


def test_slip_is_drawn_in_millimetres_per_second(run, ax):
    values = np.outer(np.sin(run.t), [1e-3, 2e-3, 3e-3])
    plot.slip(changed(run, "slip_across", values), "across", ax)
    assert labels(ax) == ["right", "left", "front"]
    np.testing.assert_allclose(ax.lines[1].get_ydata(), 2 * np.sin(run.t))


@pytest.mark.parametrize(
    ("name", "lines", "unit"),
    [("wheel_rate", 3, "[rad/s]"), ("relative_curvature", 3, "[1/m]"), ("velocity_x", 1, "[m/s]")],
)
def test_history_draws_any_quantity(run, ax, name, lines, unit):
    plot.history(run, name, ax)
    assert len(ax.lines) == lines
    assert ax.get_ylabel().endswith(unit)


@pytest.mark.parametrize("name", plot.CHECKS)
def test_checks_have_scale_and_reference(run, ax, name):
    plot.check(run, name, ax)
    drawn(ax.figure)
    assert ax.get_yscale() == plot.CHECKS[name]
    reference = run.statistics["tolerance"] if plot.CHECKS[name] == "log" else 0.0
    assert ax.lines[-1].get_ydata()[0] == reference


def test_figures_come_by_name(run, grid):
    settings = dict(mpl.rcParams)
    figures = plot.figures(run, grid)
    assert list(figures) == NAMES
    assert dict(mpl.rcParams) == settings
    for name, figure in figures.items():
        assert "Stopped" not in words(figure)
        assert figure.axes, name
    assert "least slip" in words(figures["slip"])
    assert {"whole ground", "around the path"} <= {ax.get_title() for ax in figures["map"].axes}


def test_every_figure_says_why_the_motion_stopped(stopped, grid):
    assert stopped.stop is not None
    for figure in plot.figures(stopped, grid).values():
        text = " ".join(words(figure).split())
        assert stopped.stop.words in text


def test_nothing_reaches_over_the_edge(stopped, grid):
    for name, figure in plot.figures(stopped, grid).items():
        drawn(figure)
        width, height = figure.bbox.size
        texts = [*figure.texts, *(a.xaxis.label for a in figure.axes)]
        texts += [a.yaxis.label for a in figure.axes] + [a.title for a in figure.axes]
        texts += [a.zaxis.label for a in figure.axes if hasattr(a, "zaxis")]
        for box in (text.get_window_extent() for text in texts if text.get_text()):
            assert min(box.x0, box.y0) >= -1, name
            assert box.x1 <= width + 1, name
            assert box.y1 <= height + 1, name


@pytest.mark.parametrize("count", [1, 2])
def test_very_short_motions_are_drawn(run, grid, count):
    for figure in plot.figures(run.part(slice(count)), grid).values():
        drawn(figure)


def test_large_map_coordinates_count_from_a_round_one(run, grid):
    x, y = 500_123.0, 4_512_340.0
    figures = plot.figures(moved(run, x, y), sf.Grid(grid.x + x, grid.y + y, grid.z))
    for name in ("map", "terrain", "loci"):
        axes = drawn(figures[name]).axes[0]
        assert axes.get_xlabel() == "east $x$ - 500000 [m]"
        assert axes.get_ylabel() == "north $y$ - 4512000 [m]"


def test_files_are_written(run, grid, tmp_path):
    files = plot.save_figures(run, grid, tmp_path / "new" / "folder", formats=("png", "pdf"))
    assert [f.name for f in files] == [f"{n}.{end}" for n in NAMES for end in ("png", "pdf")]
    assert all(file.stat().st_size > 1000 for file in files)


def test_unknown_formats_are_refused_before_anything_is_drawn(run, grid, tmp_path):
    with pytest.raises(sf.ModelError, match=r"formats: 'gifx' is not known; known: .*png"):
        plot.save_figures(run, grid, tmp_path / "none", formats=("gifx",))
    assert not (tmp_path / "none").exists()


def test_missing_quantities_are_named(run, grid):
    columns = {k: c for k, c in run.columns.items() if k != "slip_across"}
    with pytest.raises(sf.ModelError, match="the trajectory has no 'slip_across'"):
        plot.figures(replace(run, columns=columns), grid)


def test_a_motion_on_another_ground_is_refused(run, grid):
    with pytest.raises(sf.ModelError, match=r"not on this ground: x is .* reaches from -5 to 5 m"):
        plot.figures(moved(run, 100.0, 0.0), grid)
