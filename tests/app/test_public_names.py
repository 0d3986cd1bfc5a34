"""Tests of the public names: exports, help page, examples, and reprs of a few lines."""

import doctest
import inspect
import pydoc

import numpy as np
import pytest

import slipfree
from helpers.commands import refuses
from slipfree import Analytic, Bicubic, catalog, direct_kinematics, settle, simulate, straight
from slipfree.files.maps.elevation import Map, jacksboro
from slipfree.plan.mpc import first_cycle, horizon
from slipfree.solve.simulate import Event

PAGE = 60  # lines of a terminal
LINES, WIDTH = 5, 100  # of a repr
NAMES = {
    *("Grid", "Bicubic", "Analytic", "Solids", "read_map"),
    *("Vehicle", "Coordinate", "Joint", "Body", "Wheel", "catalog", "read_vehicle"),
    *("direct_kinematics", "inverse_kinematics", "montana_kinematics", "quasi_statics"),
    *("dynamics", "rigid_dynamics", "planar", "in_gravity", "Compliant", "Rate", "Torque", "Motor"),
    *("LeastSlip", "Rolling", "Coulomb", "LinearCreep", "Soil"),
    *("follow", "commanded", "straight", "Path"),
    *("settle", "settle_many", "guarantee", "simulate", "rollouts", "plan", "replan"),
    *("sample_plan", "cross_check", "atlas", "plot"),
    *("Cost", "Mesh", "Region", "Route", "SamplingTask", "Search"),
    *("Dae", "Trajectory", "Outcome", "SolverOptions"),
    *("load_problem", "run_problem", "open_result"),
    *("SlipfreeError", "ModelError", "DataError", "SolverError"),
    "__version__",
}
DOCUMENTED = (
    *("direct_kinematics", "inverse_kinematics", "quasi_statics", "montana_kinematics"),
    *("dynamics", "rigid_dynamics", "settle", "settle_many", "simulate", "rollouts"),
    *("follow", "plan", "replan", "cross_check", "atlas"),
    *("Cost", "Region", "Path", "Grid", "Bicubic", "Analytic", "Trajectory", "Dae"),
)


def test_all_names_are_there():
    assert set(slipfree.__all__) == set(dir(slipfree)) == NAMES
    for name in NAMES:
        assert getattr(slipfree, name) is not None


def test_plan_is_the_function_although_its_package_is_imported():
    import slipfree.plan.mpc

    assert inspect.isfunction(slipfree.plan)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="settled"):
        _ = slipfree.settled


def test_wrong_arguments_get_a_remedy():
    vehicle, ground = catalog.three_wheeler(), Bicubic(jacksboro(0.005))
    model = direct_kinematics(vehicle, ground)
    start = settle(model, x=60.0, y=60.0)
    rates = {"right_rate": 0.5, "left_rate": 0.5, "steer_rate": 0.0}
    t = np.linspace(0, 1, 3)
    for call, words in (
        (lambda: direct_kinematics("rover.urdf", ground), "vehicle: .*str.*read_vehicle"),
        (lambda: direct_kinematics(vehicle, "site.tif"), "ground: .*str.*read_map"),
        (lambda: Bicubic("site.tif"), "grid: expected Grid, found str 'site.tif'; .*read_map"),
        (lambda: start["heding"], "did you mean 'heading'"),
        (lambda: simulate(model, (0, 0, 0), model.inputs(**rates), t), "start: .*tuple.*settle"),
        (lambda: simulate(model, start, rates, t), "model.inputs"),
        (lambda: slipfree.rollouts(model, start, np.zeros(3), t), "inputs: expected a mapping"),
        (lambda: slipfree.follow(model, [(0, 0)], speed=1.0), "path: expected Path"),
    ):
        refuses(slipfree.ModelError, words, call)
    with pytest.raises(AttributeError, match="did you mean 'rocky7'"):
        catalog.roky7  # noqa: B018


def test_results_are_drawn():
    vehicle, ground = catalog.three_wheeler(), Bicubic(jacksboro(0.005), mu=0.6)
    model = direct_kinematics(vehicle, ground)
    rates = model.inputs(right_rate=0.5, left_rate=0.5, steer_rate=0.0)
    run = simulate(model, settle(model, x=60.0, y=60.0), rates, np.linspace(0, 5, 6))
    x, y = np.linspace(55.0, 65.0, 6), np.linspace(56.0, 66.0, 5)
    poses = slipfree.atlas(model, headings=4, x=x, y=y, compiled=False)
    for result, name, axes in ((run, None, "east"), (run, "tilts", "time"), (poses, None, "east")):
        (ax, *_) = slipfree.plot(result, name).axes
        assert axes in ax.get_xlabel()
    for record in (run, poses, model.vehicle, model.ground):
        assert record._repr_html_().count("<tr>") == len(lines_of(record)) - 1 > 1
    refuses(slipfree.ModelError, "did you mean 'tilts'", slipfree.plot, run, "tilt")
    refuses(slipfree.ModelError, "result: expected Trajectory", slipfree.plot, model)


def test_help_is_a_page_that_names_everything():
    page = inspect.getdoc(slipfree)
    assert len(page.splitlines()) <= PAGE
    assert all(f"`{name}`" in page for name in NAMES - {"__version__"})
    assert pydoc.render_doc(slipfree).splitlines()[0].startswith("Python Library Documentation")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["slipfree", *DOCUMENTED])
def test_examples_run(name):
    thing = slipfree if name == "slipfree" else getattr(slipfree, name)
    parser, runner = doctest.DocTestParser(), doctest.DocTestRunner()
    text = inspect.getdoc(thing)
    assert ">>>" in text
    runner.run(parser.get_doctest(text, {}, name, None, None))
    assert runner.summarize(verbose=False).failed == 0


def lines_of(record):
    lines = repr(record).splitlines()
    assert 0 < len(lines) <= LINES, lines
    assert max(map(len, lines)) <= WIDTH, lines
    return lines


def test_reprs_of_grounds():
    grid = jacksboro(scale=0.005)
    assert lines_of(grid)[0].startswith("Grid: 403 x 344 nodes")
    lines_of(Map(grid))
    for mu in (None, 0.6, grid, lambda x, _: 0.6 + 0 * x):
        lines_of(Bicubic(grid, mu=mu))
    lines_of(Analytic(lambda x, _: 0 * x))
    lines_of(slipfree.Path(np.arange(2000.0).reshape(-1, 2)))
    lines_of(slipfree.Route(np.zeros((5000, 2)), 1.0, 1.0))
    circle = [(np.cos(t), np.sin(t)) for t in np.linspace(0, 6, 500)]
    assert lines_of(slipfree.Region.polygon(circle))[0].startswith("Region: polygon of 500 points")
    lines_of(slipfree.Region.disc(1.0, 2.0, 3.0))


@pytest.mark.slow
def test_reprs_of_models_and_their_motions():
    dae = direct_kinematics(catalog.open_source_rover(), Bicubic(jacksboro(scale=0.005)))
    assert lines_of(dae)[1].startswith("  states: x, y, ")
    start = settle(dae, x=136.0, y=79.0)
    assert lines_of(start)[0] == "Trajectory: 1 sample from 0 to 0 s; complete"
    for record in (*start.columns.values(), *dae.limits, Event(dae.x.heading)):
        lines_of(record)
    lines_of(slipfree.Cost("rolling", dae.ode[0], "rad2 s-1", "squared roll rate " * 20))


@pytest.mark.slow
def test_reprs_of_a_plan_and_all_in_it():
    vehicle = catalog.three_wheeler(axle="fixed", tilt_stop=0.3)
    dae = direct_kinematics(vehicle, Analytic(lambda x, y: 0.1 * x * y))
    start, t = settle(dae), np.linspace(0, 4, 9)
    guess = simulate(dae, start, straight(dae, start, speed=0.3), t)
    wish = {"goal": {"y": 1.0}, "costs": {"slip": 1.0, "effort": 0.1}, "duration": 4.0}
    found = slipfree.plan(dae, start, guess, **wish, mesh=slipfree.Mesh(4))
    assert lines_of(found)[0].startswith("Plan: accurate; 4 s on 4 intervals, ")
    for name in ("run", "motion", "replay", "program", "solution", "saved"):
        lines_of(getattr(found, name))
    window = horizon(found, span=2.0, intervals=2)
    for record in (window, first_cycle(window), found.program.task, *found.stages):
        lines_of(record)


def test_a_motion_that_ends_early_says_why():
    vehicle = catalog.three_wheeler()
    dae = direct_kinematics(vehicle, Analytic(lambda x, _: 0 * x, domain=(-2, 2, -2, 2)))
    run = simulate(
        dae, settle(dae), dae.inputs(right_rate=2.0, left_rate=2.0, steer_rate=0.0), [0.0, 4.0, 8.0]
    )
    lines = lines_of(run)
    assert "; limit reached" in lines[0]
    assert lines[-1].startswith(f"  stop: {run.stop.name}, ")


def test_reprs_of_laws_and_options():
    for law in (slipfree.LeastSlip, slipfree.Rolling, slipfree.Coulomb):
        assert lines_of(law())[0].startswith(law.__name__)
    lines_of(slipfree.SolverOptions())
