"""Tests of figures of motions and plans: no warnings, and the right contents."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from weakref import ref as weakref

import casadi as ca
import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.figure import Figure

import slipfree as sf
from helpers.commands import refuses
from helpers.figures import assert_inside, moved
from slipfree.core.facts import Fact
from slipfree.core.records import Label
from slipfree.core.trajectory import Column, Trajectory, path_length
from slipfree.geometry.regions import Region
from slipfree.routing.traversability import blocked_by, free_space, traversability
from slipfree.show import ground_drawing, motion_figures, plan_figures, plots, style
from slipfree.show.motion_figures import ground_plot
from slipfree.terrain.synthetic import blank, craters

DOMAIN = (-5.0, 5.0, -4.0, 4.0)
NAMES = ["map", "elevation", "tilts", "checks", "rates"]
LOADS = ["utilisation", "forces", "energy"]
WITH_LOADS = [*NAMES[:2], LOADS[0], *NAMES[2:], *LOADS[1:]]


def hills(x, y):
    return 2 + 0.1 * ca.sin(x) * ca.cos(0.7 * y) + 0.02 * x


def drive(end: float, tilt_stop: float = np.inf) -> Trajectory:
    dae = sf.direct_kinematics(
        sf.catalog.three_wheeler(tilt_stop=tilt_stop), sf.Analytic(hills, DOMAIN)
    )
    start = sf.settle(dae, x=0.0, y=0.0, heading=-0.3)
    inputs = dae.inputs(right_rate=0.5, left_rate=0.4, steer_rate=0.02)
    return without_mass(sf.simulate(dae, start, inputs, np.arange(0.0, end, 0.1)))


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


@pytest.fixture(scope="module")
def loaded(run) -> Trajectory:
    return with_mass(run)


@pytest.fixture
def ax():
    return Figure(layout="constrained").subplots()


def changed(run: Trajectory, name: str, values: np.ndarray) -> Trajectory:
    label = run.columns[name].label if name in run else Label(name, "rad", name)
    return replace(run, columns={**run.columns, name: Column(label, values)})


def made_up_loads(run: Trajectory) -> dict[str, Column]:
    """Return columns of made-up forces: the front wheel is not driven and needs most."""
    s, wheels = np.linspace(0, 1, run.t.size), np.arange(1, len(run.wheels) + 1)
    shape = np.outer(1 + np.sin(3 * s), wheels)
    along, across, normal = 3 * shape, 4 * shape, 50 + np.outer(s, wheels)
    needed = 5 * shape / normal
    columns = {
        "force_along": ("N", along),
        "force_across": ("N", across),
        "force_normal": ("N", normal),
        "friction_needed": ("1", needed),
        "utilisation": ("1", needed / 0.8),
        "utilisation_best": ("1", needed.max(axis=1)),
        "drive_torque": ("N m", along * [0.1, 0.1, 0]),
        "steer_torque": ("N m", np.cos(s)),
        "tilt_left_torque": ("N m", 0 * s),
        "power": ("W", 2 + s),
        "dissipation": ("W", 1 + s),
        "work": ("J", 7 + 9 * s),
        "potential_energy": ("J", 300 + 4 * s),
        "tip_over_margin": ("rad", 0.3 + 0.1 * s),
    }
    return {name: Column(Label(name, unit, name), v) for name, (unit, v) in columns.items()}


def with_mass(run: Trajectory) -> Trajectory:
    columns = {**run.columns, **made_up_loads(run)}
    return replace(run, columns=columns, attributes={**run.attributes, "ground_friction": "0.8"})


def without_mass(run: Trajectory) -> Trajectory:
    columns = {k: c for k, c in run.columns.items() if k not in made_up_loads(run)}
    return replace(run, columns=columns, attributes={})


def figures(run: Trajectory, grid: sf.Grid, *only: str, surface=None) -> dict[str, Figure]:
    found = motion_figures.motion_plots(run, grid, surface)
    return plots.draw(plot for plot in found if plot.name in only or not only)


def save_figures(run: Trajectory, grid: sf.Grid, folder: Path, formats=("png",)) -> list[Path]:
    return plots.save(motion_figures.motion_plots(run, grid), folder, formats)


def drawn(figure: Figure) -> Figure:
    """Draw, so that what warns while drawing does so here."""
    figure.draw_without_rendering()
    return figure


def words(figure: Figure) -> str:
    """Return all text of a figure outside its axes."""
    legends = [text for legend in figure.legends for text in legend.get_texts()]
    return " ".join(text.get_text() for text in [*figure.texts, *legends])


def lifted(run: Trajectory, value: float = np.inf) -> Trajectory:
    """Return a motion in which the left wheel needs so much friction for three samples."""
    values = run["utilisation"].copy()
    values[10:13, 1] = value
    return changed(run, "utilisation", values)


def labels(ax) -> list[str]:
    return ax.get_legend_handles_labels()[1]


def heights_of(ax) -> np.ndarray:
    """Return the heights of a relief with a colour bar, of whose shaded colours it is an image."""
    scale = ax.child_axes[0]._colorbar.mappable
    image, light = ax.images[0].get_array()[..., :3], scale.to_rgba(scale.get_array())[..., :3]
    ratio = image / light  # the light has no colour
    np.testing.assert_allclose(ratio, ratio[..., :1] * np.ones(3), atol=1e-6)
    return scale.get_array()


def test_ground_is_a_map_of_equal_scales(grid, ax):
    assert motion_figures.ground(grid, ax) is ax
    drawn(ax.figure)
    assert ax.get_aspect() == 1.0
    assert (*ax.get_xlim(), *ax.get_ylim()) == DOMAIN
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("east $x$ [m]", "north $y$ [m]")
    heights = heights_of(ax)
    assert heights.shape == (motion_figures.HEATMAP, motion_figures.HEATMAP)
    assert heights[0, -1] == pytest.approx(grid.z[-1, 0])  # south east
    assert heights[-1, 0] == pytest.approx(grid.z[0, -1])  # north west


def test_heights_of_contours_are_dark(grid, ax):
    texts = ground_drawing.contours(grid, ax, grid.domain).texts
    assert len(texts) > 3
    assert max(max(to_rgb(each.get_color())) for each in texts) < 0.3


def test_path_marks_start_and_end(run, ax):
    assert labels(motion_figures.path(run, ax)) == ["platform", "start, 0 s", "end, 3 s"]
    line, start, end = (h for h in ax.get_legend_handles_labels()[0])
    np.testing.assert_array_equal(line.get_xydata(), np.column_stack([run["x"], run["y"]]))
    assert start.get_xydata()[0] == pytest.approx([run["x"][0], run["y"][0]])
    assert end.get_xydata()[0] == pytest.approx([run["x"][-1], run["y"][-1]])


def test_tilts_and_moving_joints_are_drawn_with_degrees(run, grid):
    rocking = changed(run, "rocker", np.sin(run.t))
    (ax,) = drawn(figures(changed(rocking, "rocker_stop", run.t), grid, "tilts")["tilts"]).axes
    assert labels(ax) == ["tilt right", "tilt left", "steer", "rocker"]  # not its stop
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time $t$ [s]", "angle [rad]")
    second = ax.child_axes[0]
    assert second.get_ylabel() == "[deg]"
    assert second.get_ylim() == pytest.approx(np.rad2deg(ax.get_ylim()))


def test_elevation_is_over_the_distance_driven(run, ax):
    motion_figures.elevation(run, sf.Analytic(hills), ax)
    contact, platform, below = ax.lines[0], ax.lines[3], ax.lines[4]
    assert platform.get_xdata()[-1] == pytest.approx(path_length(run))
    np.testing.assert_array_equal(contact.get_ydata(), run["contact_z", "right"])
    expected = sf.Analytic(hills).elevation(run["x"], run["y"])
    np.testing.assert_array_equal(below.get_ydata(), expected)


def analytic_slope(run: Trajectory) -> np.ndarray:
    x, y, heading = run["x"], run["y"], run["heading"]
    east = 0.1 * np.cos(x) * np.cos(0.7 * y) + 0.02
    north = -0.07 * np.sin(x) * np.sin(0.7 * y)
    return np.arctan(-np.sin(heading) * east + np.cos(heading) * north)


def test_slope_is_that_of_a_formula_to_rounding(run, grid, ax):
    motion_figures.slope(run, sf.Analytic(hills), ax)
    np.testing.assert_allclose(ax.lines[0].get_ydata(), analytic_slope(run), atol=1e-15)
    motion_figures.slope(run, sf.Bicubic(grid), ax)
    np.testing.assert_allclose(ax.lines[2].get_ydata(), analytic_slope(run), atol=1e-4)
    assert ax.get_ylabel() == "slope [rad]"
    lower = figures(run, grid, "elevation", surface=sf.Analytic(hills))["elevation"].axes[1]
    np.testing.assert_allclose(lower.lines[0].get_ydata(), analytic_slope(run), atol=1e-15)


def test_slip_is_drawn_in_millimetres_per_second(run, grid):
    values = np.outer(np.sin(run.t), [1e-3, 2e-3, 3e-3])
    (ax,) = figures(changed(run, "slip_across", values), grid, "slip")["slip"].axes
    assert labels(ax) == ["right", "left", "front"]
    assert ax.get_ylabel() == "slip across [mm/s]"
    np.testing.assert_allclose(ax.lines[1].get_ydata(), 2 * np.sin(run.t))
    motion_figures.tracks(changed(run, "slip_across", values), ax)  # of a motion without forces
    assert ax.child_axes[-1].get_ylabel() == "slip [mm/s]"
    assert ax.collections[-1].get_array().max() == pytest.approx(3 * np.sin(run.t).max(), rel=1e-6)


def test_checks_have_scale_and_reference(run, grid):
    residuals = {"contact error [m]", "integration error [m]"}
    axes = drawn(figures(run, grid, "checks")["checks"]).axes
    assert residuals < {" ".join(ax.get_ylabel().split()) for ax in axes}
    for ax in axes:
        is_residual = " ".join(ax.get_ylabel().split()) in residuals
        assert ax.get_yscale() == ("log" if is_residual else "linear")
        reference = [line for line in ax.lines if len(set(line.get_ydata())) == 1]
        value = run.statistics["tolerance"] if is_residual else 0.0
        assert value in [line.get_ydata()[0] for line in reference]


def test_written_figures_leave_the_memory(tmp_path):
    made = list[weakref[Figure]]()

    def make() -> Figure:
        figure = Figure()
        figure.subplots()
        made.append(weakref(figure))
        return figure

    plots.save([plots.Plot(name, "", make) for name in "ab"], tmp_path, ("png", "svg"))
    assert len([*tmp_path.iterdir()]) == 4
    assert [figure() for figure in made] == [None, None]


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "color"), [("filled", motion_figures.FILLED), ("holes", "0.4")])
def test_holes_are_hatched_in_pixels_and_nothing_is_cut(run, grid, kind, color):
    nodes = np.zeros(grid.z.shape, dtype=bool)
    nodes[34:40, 28:34] = True
    ragged = replace(grid, **{kind: nodes})
    drawings = [*figures(run, ragged, "map").values(), *plots.draw([ground_plot(ragged)]).values()]
    for figure in drawings:
        canvas, figure.dpi = FigureCanvasAgg(figure), style.DPI
        canvas.draw()
        pixels = np.asarray(canvas.buffer_rgba())[::-1, :, :3].astype(int)
        edges = pixels[[0, -1]], pixels[:, [0, -1]]
        assert all((edge == 255).all() for edge in edges)
        for ax in figure.axes if kind == "holes" else figure.axes[:1]:
            ends = grid.x[[35, 38]], grid.y[[29, 32]]
            (left, low), (right, high) = ax.transData.transform(np.transpose(ends)).astype(int)
            away = np.abs(pixels[low:high, left:right] - 255 * np.array(to_rgb(color)))
            assert 0.03 < (away.max(axis=2) < 60).mean() < 0.7, ax.get_ylabel()


@pytest.mark.slow
def test_figures_say_why_a_motion_stopped_and_nothing_reaches_over_the_edge(stopped, grid):
    kept = np.abs(grid.x) <= 2.0
    grid = sf.Grid(grid.x[kept], grid.y, grid.z[kept])
    settings = dict(mpl.rcParams)
    drawings = figures(lifted(with_mass(stopped)), grid)
    assert list(drawings) == WITH_LOADS
    for figure in drawings.values():
        assert stopped.stop.words in " ".join(words(figure).split())
        drawn(figure)
        places = [*figure.axes, *(child for ax in figure.axes for child in ax.child_axes)]
        texts = [*figure.texts, *(a.xaxis.label for a in figure.axes)]
        texts += [a.yaxis.label for a in places] + [a.title for a in figure.axes]
        texts += [text for a in figure.axes for text in a.texts if text.get_visible()]
        texts += [text for a in figure.axes if (own := a.get_legend()) for text in own.get_texts()]
        assert_inside(figure, texts)
    assert dict(mpl.rcParams) == settings


@pytest.mark.slow
def test_a_start_alone_on_level_ground_is_drawn_to_files(loaded, grid, tmp_path):
    level = replace(grid, z=0 * grid.z)
    files = save_figures(loaded.part(slice(1)), level, tmp_path / "new" / "folder")
    assert [file.name for file in files] == [f"{name}.png" for name in WITH_LOADS]
    assert all(file.stat().st_size > 1000 for file in files)


def test_figures_of_a_motion_depend_on_what_it_has(run, grid):
    def names(run):
        return [plot.name for plot in motion_figures.motion_plots(run, grid)]

    assert names(run) == NAMES  # neither slip above rounding nor loads
    assert "slip" in names(changed(run, "slip_across", np.full((run.t.size, 3), 1e-3)))
    columns = {k: c for k, c in run.columns.items() if not k.startswith(("tilt_", "steer"))}
    assert "tilts" not in names(replace(run, columns=columns))


@pytest.mark.slow
def test_large_map_coordinates_count_from_a_round_one(run, grid):
    x, y = 500_123.0, 4_512_340.0
    drawings = figures(moved(run, x=x, y=y), sf.Grid(grid.x + x, grid.y + y, grid.z), "map")
    axes = drawn(drawings["map"]).axes[0]
    assert axes.get_xlabel() == "east $x$ - 500000 [m]"
    assert axes.get_ylabel() == "north $y$ - 4512000 [m]"


def test_what_cannot_be_drawn_is_refused(run, grid, tmp_path):
    message = r"formats: expected some of .*png.*, found 'gifx'"
    refuses(sf.ModelError, message, save_figures, run, grid, tmp_path / "none", formats=("gifx",))
    assert not (tmp_path / "none").exists()  # before anything is drawn
    bare = replace(run, columns={k: c for k, c in run.columns.items() if k != "contact_z"})
    refuses(sf.ModelError, "quantity of the trajectory, found 'contact_z'", figures, bare, grid)
    message = r"expected a motion on this ground, x from -5 to 5 m"
    refuses(sf.ModelError, message, figures, moved(run, x=100.0), grid)


def test_forces_have_a_line_a_wheel(loaded, grid):
    axes = figures(loaded, grid, "forces")["forces"].axes
    ax, shown = axes[0], [each.get_ylabel() for each in axes]
    assert shown[3:] == ["drive torque [N m]", "steer torque [N m]"]  # that of the tilt is zero
    assert labels(ax) == ["right", "left", "front"]
    np.testing.assert_array_equal(ax.lines[2].get_ydata(), loaded["force_normal", "front"])
    assert ax.get_ylabel() == "force normal [N]"


def test_utilisation_is_measured_against_all_that_friction_gives(loaded, ax):
    motion_figures.utilisation(loaded, ax)
    drawn(ax.figure)
    wheels = ["right", "left", "front"]
    assert labels(ax)[:-1] == [*wheels, "optimal distribution of forces", "friction limit"]
    assert labels(ax)[-1].startswith("largest utilisation: ")
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), loaded["utilisation", "right"])
    np.testing.assert_array_equal(ax.lines[3].get_ydata(), loaded["utilisation_best"])
    assert list(ax.lines[4].get_ydata()) == [1, 1]
    assert ax.get_ylabel() == "utilisation [1]"
    assert ax.get_ylim()[1] >= 1


@pytest.mark.parametrize("value", [47.0, np.inf])
def test_huge_utilisation_is_cut_and_said_to_be(loaded, ax, value):
    motion_figures.utilisation(lifted(loaded, value), ax)
    drawn(ax.figure)
    assert ax.get_ylim() == (0, motion_figures.CEILING)
    assert ax.lines[-1].get_xydata()[0] == pytest.approx([loaded.t[10], motion_figures.CEILING])
    remark, worst = labels(ax)[-2:]
    assert remark.startswith("not drawn above 3")
    assert remark.endswith("infinite where a wheel bears no load") == np.isinf(value)
    number = "infinite" if np.isinf(value) else "47"
    assert worst == f"largest utilisation: {number}, left at {loaded.t[10]:.4g} s"
    values = ax.lines[1].get_ydata()
    assert np.isfinite(values).all()
    assert (values[10:13] > motion_figures.CEILING).all()


def test_without_the_friction_of_the_ground_it_is_the_friction_needed(loaded, ax):
    columns = {**loaded.columns, "utilisation": loaded.columns["friction_needed"]}
    run = replace(loaded, attributes={}, columns=columns)
    motion_figures.utilisation(run, ax)
    assert ax.get_ylabel() == "friction needed $|f_t|/N$ [1]"
    assert labels(ax)[-2] == "a friction coefficient of 1"
    bar = motion_figures.tracks(run, ax).child_axes[-1]
    assert bar.get_ylabel() == "friction needed $|f_t|/N$ [1]"


def test_tip_over_margin_has_degrees(loaded, grid):
    ax = figures(loaded, grid, "utilisation")["utilisation"].axes[1]
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), loaded["tip_over_margin"])
    assert ax.get_ylabel().endswith("[rad]")
    drawn(ax.figure)
    assert ax.child_axes[0].get_ylim() == pytest.approx(np.rad2deg(ax.get_ylim()))
    assert ax.get_ylim()[0] <= 0


def test_tracks_are_coloured_by_utilisation(loaded, ax):
    loaded = lifted(loaded)
    assert motion_figures.tracks(loaded, ax) is ax
    drawn(ax.figure)
    (lines,) = (each for each in ax.collections if isinstance(each, LineCollection))
    assert lines.get_clim() == (0, 1)
    values, colours = lines.get_array(), lines.get_colors()
    assert len(values) == len(lines.get_segments()) == 3 * (loaded.t.size - 1)
    assert (np.diff(values) >= 0).all()  # the largest lie on top
    over = values > 1
    assert over.sum() == 4  # three samples lie between four pieces
    np.testing.assert_allclose(colours[over], np.tile(to_rgba(motion_figures.OVER), (4, 1)))
    np.testing.assert_allclose(colours[~over], style.RISK(values[~over]))
    at = np.column_stack([loaded["contact_x", "left"], loaded["contact_y", "left"]])
    worst = [piece for piece, much in zip(lines.get_segments(), over, strict=True) if much]
    np.testing.assert_allclose(worst, np.stack([at[9:13], at[10:14]], axis=1))
    assert labels(ax) == [
        f"largest utilisation: infinite, left at {loaded.t[10]:.4g} s",
        "above the friction limit",
    ]


def test_energies_and_powers_have_panels_of_their_own(loaded, grid):
    energy, power = figures(loaded, grid, "energy")["energy"].axes
    for legend in (energy.get_legend(), power.get_legend()):  # one would have a colour twice
        assert len({line.get_color() for line in legend.get_lines()}) == 2
    assert labels(energy) == ["work", "potential energy"]
    assert labels(power) == ["power", "dissipation"]
    s = np.linspace(0, 1, loaded.t.size)
    for line, expected in zip(energy.lines, (9 * s, 4 * s), strict=False):
        np.testing.assert_allclose(line.get_ydata(), expected, atol=1e-12)
    assert energy.get_ylabel().split() == ["energy", "since", "the", "start", "[J]"]


# linear light as seen without green and without red cones (Machado et al., 2009)
NO_GREEN = [[0.367, 0.861, -0.228], [0.280, 0.673, 0.047], [-0.012, 0.043, 0.969]]
NO_RED = [[0.152, 1.053, -0.205], [0.115, 0.786, 0.099], [-0.004, -0.048, 1.052]]


@pytest.mark.parametrize("seen", [NO_GREEN, NO_RED])
def test_the_colour_blind_tell_risks_half_the_scale_apart(seen):
    light = style.RISK(np.linspace(0, 1, 41))[:, :3] ** 2.2 @ np.transpose(seen)
    colors = np.clip(light, 0, 1) ** (1 / 2.2)
    assert min(np.linalg.norm(colors[k + 20 :] - colors[k], axis=1).min() for k in range(21)) > 0.2


# The figures of plans: cost map, blocked nodes, routes, and planned quantities

START, GOAL = ("start", 6.0, 8.0), ("goal", 24.0, 20.0)
BOUNDS = {"right_rate": (-1.0, 3.0), "left_rate": (-1.0, 3.0), "steer_rate": (-0.5, np.inf)}
LIMITS = {"steer": (-0.8, 0.8), "slip_across[front]": (-0.1, 0.1)}


@pytest.fixture(scope="module")
def grid_plan() -> sf.Grid:
    hilly = craters(blank((0, 40), (0, 40), 0.5), count=6, diameters=(4, 8), seed=2)
    return sf.Grid(hilly.x, hilly.y, 2 * hilly.z)


@pytest.fixture(scope="module")
def layers(grid_plan):
    triangle = ((30.0, 30.0), (34.0, 30.0), (32.0, 35.0))
    keep_out = [Region.disc(14.0, 16.0, 1.5), Region.polygon(triangle)]
    vehicle = sf.catalog.three_wheeler(axle="fixed")
    return traversability(sf.Bicubic(grid_plan, mu=0.5), vehicle, keep_out=keep_out, spacing=2.0)


@pytest.fixture(scope="module")
def run_plan(grid_plan) -> Trajectory:
    dae = sf.direct_kinematics(
        sf.catalog.three_wheeler(axle="fixed"), sf.Bicubic(grid_plan, mu=0.5)
    )
    start = sf.settle(dae, x=6.0, y=8.0, heading=-0.9)
    inputs = dae.inputs(right_rate=0.5, left_rate=0.45, steer_rate=0.01)
    run = sf.simulate(dae, start, inputs, np.arange(0.0, 6.05, 0.2))
    return run.with_facts(
        {"plan_difference_x": Fact(1.2e-4, "m"), "plan_difference_heading": Fact(3e-5, "rad")}
    )


def way() -> np.ndarray:
    return np.array([[6.0, 8.0], [14.0, 20.0], [24.0, 20.0]])


def figures_plan(*args, **options) -> dict[str, Figure]:
    return plots.draw(plan_figures.plan_plots(*args, **options))


def test_costs_and_what_blocks_lie_where_they_belong(layers, grid_plan, ax):
    plan_figures.cost_map(layers, grid_plan, ax, grid_plan.domain)
    costs, blocked = (image.get_array() for image in ax.images[:2])
    assert costs.T.shape == layers.cost.shape[1:]
    free = np.isfinite(layers.least_cost)
    np.testing.assert_array_equal(np.ma.getmaskarray(costs).T, ~free)
    np.testing.assert_allclose(costs.T[free], layers.least_cost[free])
    # what blocks a node has a colour, what is free has none
    np.testing.assert_array_equal(blocked[..., 3].T > 0, ~free)
    assert ax.get_aspect() == 1.0
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("east $x$ [m]", "north $y$ [m]")
    assert len(ax.patches) == 2  # the outlines of what to keep out of


def test_the_legend_names_only_what_blocks_in_the_part_that_is_drawn(layers, grid_plan, ax):
    plan_figures.cost_map(layers, grid_plan, ax, grid_plan.domain)
    assert "friction holds no heading" in labels(ax)
    assert "keep-out region" in labels(ax)
    blocked = [each for each in labels(ax) if each.startswith("too close")]
    assert blocked == ["too close to a keep-out region", "too close to the edge of the map"]
    assert blocked_by(layers)["friction"].any()
    away = Figure().subplots()
    plan_figures.cost_map(layers, grid_plan, away, (20.0, 24.0, 4.0, 8.0))
    assert labels(away) == []


def test_missing_heights_are_hatched_in_the_part_that_is_drawn(grid_plan, ax):
    holes = np.zeros(grid_plan.z.shape, dtype=bool)
    holes[40:44, 40:44] = True  # at x, y from 20 to 21.5 m
    ragged = sf.Grid(grid_plan.x, grid_plan.y, grid_plan.z, holes=holes)
    found = free_space(sf.Bicubic(ragged, mu=0.5), sf.catalog.three_wheeler(axle="fixed"))
    plan_figures.cost_map(found, ragged, ax, (15.0, 25.0, 15.0, 25.0))
    assert {"no heights", "too close to a hole in the map"} <= {*labels(ax)}
    away = plan_figures.cost_map(found, ragged, Figure().subplots(), (25.0, 30.0, 25.0, 30.0))
    assert "no heights" not in labels(away)


def test_an_initial_guess_is_drawn_under_the_plan(run_plan, grid_plan, layers):
    guess = np.array([[6.0, 8.0], [9.0, 12.0], [np.nan, np.nan], [6.0, 8.0], [8.0, 12.0]])
    ax = figures_plan(run_plan, grid_plan, layers, guess=guess)["traversability"].axes[0]
    lines = {line.get_label(): line for line in ax.lines}
    np.testing.assert_array_equal(lines["initial guess"].get_xydata(), guess)
    assert lines["initial guess"].zorder < lines["planned motion"].zorder
    assert lines["initial guess"].get_linewidth() < lines["planned motion"].get_linewidth()
    assert lines["initial guess"].get_path_effects()  # a white edge on dark areas


def test_places_are_marked_by_name(run_plan, ax):
    plan_figures.motion(run_plan, (START, ("way-point 1", 14.0, 20.0), GOAL), ax)
    assert labels(ax) == ["planned motion", "start", "way-point 1", "goal"]
    np.testing.assert_array_equal(ax.lines[0].get_xdata(), run_plan["x"])
    assert ax.lines[-1].get_xydata()[0] == pytest.approx(GOAL[1:])
    area = (10.0, 14.0, 20.0, 26.0)
    plan_figures.motion(run_plan, (GOAL,), ax, {"goal": area})  # as a range
    (patch,) = ax.patches
    assert (*patch.get_xy(), patch.get_width(), patch.get_height()) == (10.0, 20.0, 4.0, 6.0)


WANTED = np.array([START[1:], GOAL[1:]])
MARKS = {"keep_out": [Region.disc(6.5, 8.0, 0.2)], "places": (START, GOAL), "wanted": WANTED}


def test_map_shows_regions_and_places_of_a_plan(run_plan, grid_plan):
    found = motion_figures.motion_plots(run_plan, grid_plan, marks=MARKS)
    for ax in plots.draw(found[:1])["map"].axes[:1]:
        (goal,) = (line for line in ax.lines if line.get_label() == "goal")
        assert goal.get_xydata()[0] == pytest.approx(GOAL[1:])
        assert {"keep-out region", "path to follow"} <= {*labels(ax)}
        assert labels(ax).count("start") == 0  # the path marks it


def test_paths_that_follow_a_plan_are_above_it(run_plan, grid_plan):
    late = moved(run_plan, x=0.1)
    plot = plan_figures.tracking_plot("t", run_plan, [("replan", late)], grid_plan, MARKS)
    left, right = plots.draw([plot])["t"].axes
    lines = {line.get_label(): line for line in left.lines}
    (follower,) = (each for each in left.lines if each.get_xdata()[0] == late["x"][0])
    assert follower.zorder > lines["plan"].zorder
    assert follower.get_linewidth() < lines["plan"].get_linewidth()
    assert left.images  # the ground
    assert left.get_xlabel() == "east $x$ [m]"
    assert "keep-out region" in labels(left)
    assert right.lines[0].get_ydata() == pytest.approx(0.1)


def test_room_is_the_distance_less_what_the_wheels_reach(run_plan, layers, ax):
    plan_figures.keep_out_distance(run_plan, layers, ax)
    expected = np.hypot(run_plan["x"] - 14, run_plan["y"] - 16) - 1.5 - layers.limits.reach
    np.testing.assert_allclose(ax.lines[0].get_ydata(), expected)
    assert labels(ax)[0] == "disc at (14, 16) of 1.5 m radius"


def test_figures_of_a_plan_are_complete_and_fit(run_plan, grid_plan, layers):
    columns = {f"steer_rear_right_{k}_rate": run_plan.columns["steer_rate"] for k in range(9)}
    many = replace(run_plan, columns={**run_plan.columns, **columns})
    bounds = BOUNDS | dict.fromkeys(columns, (-np.inf, np.inf))
    options = {"places": (START, GOAL), "found": [way()], "bounds": bounds, "limits": LIMITS}
    drawn = figures_plan(many, grid_plan, layers, **options)
    assert list(drawn) == ["plan", "traversability"]
    assert len(drawn["plan"].axes) == 1 + 2 + 1
    note = " ".join(text.get_text() for text in drawn["plan"].texts).replace("\n", " ")
    assert "deviates from the plan by x 0.12 mm, heading 0.0017 deg." in note
    for ax in drawn["plan"].axes[1:]:
        low, high = ax.get_ylim()
        limits = [line.get_ydata()[0] for line in ax.lines if line.get_label() == "limit"]
        assert low < min(limits) <= max(limits) < high
    for figure in drawn.values():
        figure.draw_without_rendering()
        axes = [axis for ax in figure.axes for axis in (ax.xaxis, ax.yaxis)]
        assert_inside(figure, [*figure.texts, *(axis.label for axis in axes)])
    boxes = [ax.yaxis.label.get_window_extent() for ax in drawn["plan"].axes]
    assert all(upper.y0 > lower.y1 for upper, lower in pairwise(boxes))
