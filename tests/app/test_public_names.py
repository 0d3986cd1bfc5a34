"""Tests of the public names: exports, help page, examples, reprs, and errors of wrong arguments."""

import doctest
import inspect
import pydoc
import sys
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

import slipfree as sf
from helpers.commands import invoke, pressing, refuses
from slipfree import Analytic, Bicubic, catalog, direct_kinematics, settle, simulate, straight
from slipfree.files.maps.elevation import Map, jacksboro
from slipfree.plan.mpc import first_cycle, horizon
from slipfree.solve.simulate import Event

PAGE = 60  # lines of a terminal
LINES, WIDTH = 5, 100  # of a repr
DOCUMENTED = (
    *("direct_kinematics", "inverse_kinematics", "quasi_statics", "montana_kinematics"),
    *("dynamics", "rigid_dynamics", "settle", "settle_many", "simulate", "rollouts"),
    *("follow", "plan", "replan", "cross_check", "atlas"),
    *("Cost", "Region", "Path", "Grid", "Bicubic", "Analytic", "Trajectory", "Dae"),
)


def test_all_names_are_there():
    assert set(sf.__all__) == set(dir(sf))
    for name in sf.__all__:
        assert getattr(sf, name) is not None


def test_plan_is_the_function_although_its_package_is_imported():
    assert first_cycle.__module__ == "slipfree.plan.mpc"
    assert inspect.isfunction(sf.plan)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="settled"):
        _ = sf.settled


def test_help_is_a_page_that_names_everything():
    page = inspect.getdoc(sf)
    assert len(page.splitlines()) <= PAGE
    assert all(f"`{name}`" in page for name in {*sf.__all__} - {"__version__"})
    assert pydoc.render_doc(sf).splitlines()[0].startswith("Python Library Documentation")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["slipfree", *DOCUMENTED])
def test_examples_run(name):
    thing = sf if name == "slipfree" else getattr(sf, name)
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
    lines_of(sf.Path(np.arange(2000.0).reshape(-1, 2)))
    lines_of(sf.Route(np.zeros((5000, 2)), 1.0, 1.0))
    circle = [(np.cos(t), np.sin(t)) for t in np.linspace(0, 6, 500)]
    assert lines_of(sf.Region.polygon(circle))[0].startswith("Region: polygon of 500 points")
    lines_of(sf.Region.disc(1.0, 2.0, 3.0))


@pytest.mark.slow
def test_reprs_of_models_and_their_motions():
    dae = direct_kinematics(catalog.open_source_rover(), Bicubic(jacksboro(scale=0.005)))
    assert lines_of(dae)[1].startswith("  states: x, y, ")
    start = settle(dae, x=136.0, y=79.0)
    assert lines_of(start)[0] == "Trajectory: 1 sample from 0 to 0 s; complete"
    for record in (*start.columns.values(), *dae.limits, Event(dae.x.heading)):
        lines_of(record)
    lines_of(sf.Cost("rolling", dae.ode[0], "rad2 s-1", "squared roll rate " * 20))


@pytest.mark.slow
def test_reprs_of_a_plan_and_all_in_it():
    vehicle = catalog.three_wheeler(axle="fixed", tilt_stop=0.3)
    dae = direct_kinematics(vehicle, Analytic(lambda x, y: 0.1 * x * y))
    start, t = settle(dae), np.linspace(0, 4, 9)
    guess = simulate(dae, start, straight(dae, start, speed=0.3), t)
    wish = {"goal": {"y": 1.0}, "costs": {"slip": 1.0, "effort": 0.1}, "duration": 4.0}
    found = sf.plan(dae, start, guess, **wish, mesh=sf.Mesh(4))
    assert lines_of(found)[0].startswith("Plan: accurate; 4 s on 4 intervals, ")
    for name in ("run", "motion", "replay", "program", "solution", "saved"):
        lines_of(getattr(found, name))
    window = horizon(found, span=2.0, intervals=2)
    for record in (window, first_cycle(window), found.program.task, *found.stages):
        lines_of(record)


def test_a_motion_that_ends_early_says_why():
    vehicle = catalog.three_wheeler()
    dae = direct_kinematics(vehicle, Analytic(lambda x, _: 0 * x, domain=(-2, 2, -2, 2)))
    rates = dae.inputs(right_rate=2.0, left_rate=2.0, steer_rate=0.0)
    run = simulate(dae, settle(dae), rates, [0.0, 4.0, 8.0])
    lines = lines_of(run)
    assert "; limit reached" in lines[0]
    assert lines[-1].startswith(f"  stop: {run.stop.name}, ")


def test_reprs_of_laws_and_options():
    for law in (sf.LeastSlip, sf.Rolling, sf.Coulomb):
        assert lines_of(law())[0].startswith(law.__name__)
    lines_of(sf.SolverOptions())


# Every public function names a wrong argument, whatever it is

RATES = {"right_rate": 0.5, "left_rate": 0.5, "steer_rate": 0.0}
AXIS = np.linspace(0.0, 10.0, 11)
WRONG = {
    "text": "90 deg",
    "empty text": "",
    "empty list": [],
    "empty array": np.array([]),
    "None": None,
    "True": True,
    "nan": np.nan,
    "infinity": np.inf,
    "negative": -1,
    "huge": 1e9,
    "beyond all floats": 10**400,
    "beyond all texts": 10**5000,
    "texts": ["a", "b"],
    "rows of different lengths": [[1.0], [1.0, 2.0]],
    "nested": [[[1.0]]],
    "array of nan": np.array([np.nan, 1.0]),
    "unknown name": {"nothing": 1.0},
    "text by name": {"x": "1", "right_rate": "1"},
    "numbers as names": {1: 2.0},
    "degrees by name": {"heading": 90.0},
    "complex": 1j,
    "object": object(),
    "class": int,
    "function": lambda *_: "text",
    "symbol": ca.SX.sym("s"),
    "swapped": np.linspace(0.0, 1.0, 3),
}


@pytest.fixture(scope="module")
def calls():
    """Return all public functions and classes that check arguments, with valid ones, by name."""
    ground = sf.Bicubic(sf.Grid(AXIS, AXIS, 0.02 * AXIS[:, None] * AXIS), mu=0.8)
    vehicle = catalog.three_wheeler(axle="fixed")
    model = sf.direct_kinematics(vehicle, ground)
    start = sf.settle(model, x=5.0, y=5.0)
    t, ranges = np.linspace(0.0, 0.2, 3), dict.fromkeys(RATES, (-1.0, 1.0))
    motion = {"model": model, "start": start, "inputs": model.inputs(**RATES), "t": t}
    run, goal = sf.simulate(**motion), {"costs": {"effort": 1.0}, "goal": {"y": 6.0}}
    task = {"model": model, **goal, "span": 1.0, "ranges": ranges, "intervals": 2}
    task |= {"candidates": 8, "compiled": False}
    driven, both = {"model": model}, {"vehicle": vehicle, "ground": ground}
    part = {"name": "a", "parent": "platform", "at": (0.0, 0.0, 0.0)}
    places, slow = {"x": AXIS[4:6], "y": AXIS[4:6]}, {"compiled": False}
    named = {
        "settle": {"model": model, "x": 5.0, "heading": 0.1, "guess": {"z": 0.5}},
        "settle_many": {"model": model, "x": 5.0, "heading": [0.1, 0.2], **slow},
        "simulate": motion,
        "rollouts": {"model": model, "starts": {"x": 5.0, "y": 5.0}, "inputs": RATES, "t": t},
        "plan": {"model": model, "start": start, **goal, "duration": 2.0},
        "sample_plan": {"task": sf.SamplingTask(**task), "x": np.array([5.0, 5.0, 0.0, 0.0])},
        "SamplingTask": task,
        "follow": driven | {"path": sf.Path([(5, 5), (5, 6)]), "speed": 0.1},
        "straight": driven | {"start": start, "speed": 0.1},
        "commanded": driven | {"speed": 0.1},
        "atlas": {"model": model, "headings": 1, **places, **slow},
        "plot": {"result": run},
        "cross_check": {"first": run, "second": run},
        "dynamics": {"vehicle": vehicle, "ground": ground},
        "inverse_kinematics": both | {"given": ("forward", "yaw_rate")},
        "planar": {"vehicle": catalog.step_climber()},
        "in_gravity": {"vehicle": vehicle, "gravity": "moon"},
        "run_problem": {"problem": None},
        "replan": {"window": None, "former": None, "t": 0.0, "x": np.zeros(4)},
        "Analytic": {"function": lambda x, y: 0 * x * y},
        "Bicubic": {"grid": ground.grid},
        "Grid": {"x": AXIS, "y": AXIS, "z": np.zeros((11, 11))},
        "Solids": {"base": ground, "prisms": ()},
        "Path": {"points": [(0.0, 0.0), (1.0, 0.0)]},
        "Coordinate": {"name": "a", "kind": "passive", "words": "a"},
        "Joint": part | {"axis": "x", "value": "0"},
        "Wheel": part | {"section": vehicle.wheels[0].section, "driven": True},
        "Vehicle": {k: getattr(vehicle, k) for k in ("name", "coordinates", "joints", "wheels")},
        "Motor": {"stall": 1.0, "no_load": 1.0, "kp": 1.0},
    }
    models = ("direct_kinematics", "montana_kinematics", "quasi_statics", "rigid_dynamics")
    named |= dict.fromkeys(models, both)
    files = ("read_map", "read_vehicle", "load_problem", "open_result")
    named |= {name: {"path": "missing.npz"} for name in files}
    return {name: (getattr(sf, name), named.get(name, {})) for name in CHECKED}


CHECKED = [
    name
    for name in sf.__all__
    if (
        callable(getattr(sf, name))
        and hasattr(getattr(getattr(sf, name), "__init__", None), "__wrapped__")
    )
    or inspect.isfunction(getattr(sf, name))
]


@pytest.mark.parametrize("name", CHECKED)
def test_every_wrong_argument_is_named(calls, name, monkeypatch):
    def accepted(*_, **__):
        raise sf.SolverError("the arguments are accepted")

    monkeypatch.setattr(sys.modules["slipfree.plan.plan"], "initial_guess", accepted)
    function, given = calls[name]
    several = {"compiled", "start"} if name.startswith("settle") else {"compiled"}
    for key in {*given, *inspect.signature(function).parameters} - several:
        for words, value in WRONG.items():
            if isinstance(function, type) and isinstance(value, ca.SX):
                continue  # a parameter of a fit
            try:
                function(**(given | {key: value}))
            except sf.SlipfreeError:
                pass
            except Exception as error:
                error.add_note(f"{name}({key}={words})")
                raise


def test_degrees_are_asked_back(calls):
    model, start = (calls["simulate"][1][key] for key in ("model", "start"))
    places, many = {"x": 5.0, "y": 5.0}, {"inputs": RATES, "t": np.linspace(0.0, 0.2, 3)}
    words = r"expected an angle in radians, found 90; did you mean 90 degrees\? write np.radians"
    for function, given in (
        (sf.settle, {"model": model, "heading": 90}),
        (sf.settle, {"model": model, "guess": {"roll": 90.0}, **places}),
        (sf.settle_many, {"model": model, "heading": [0.0, 90.0], "compiled": False}),
        (sf.rollouts, {"model": model, "starts": places | {"heading": 90}, **many}),
        (sf.rollouts, {"model": lambda: model, "starts": {"heading": 90}, **many}),
        (sf.plan, calls["plan"][1] | {"goal": {"heading": (0.0, 90.0)}}),
        (sf.plan, calls["plan"][1] | {"way_points": {0.5: {"heading": 90.0}}}),
        (sf.SamplingTask, calls["SamplingTask"][1] | {"goal": {"heading": 90.0}}),
        (sf.sample_plan, calls["sample_plan"][1] | {"goal": {"heading": 90.0}}),
        (sf.atlas, calls["atlas"][1] | {"headings": [0.0, 90.0]}),
        (catalog.three_wheeler, {"tilt_stop": 90}),
    ):
        refuses(sf.ModelError, words, function, **given)
    assert start["heading"] == sf.settle(model, heading=2 * np.pi, **places)["heading"] - 2 * np.pi


def test_remedies_fit_the_error(calls):
    model, start, inputs, t = calls["simulate"][1].values()
    vehicle, ground = model.vehicle, model.ground
    for call, words in (
        (lambda: sf.simulate(model, start, t, inputs), "exchange 'inputs' and 't'"),
        (lambda: sf.simulate(start, model, inputs, t), "exchange 'model' and 'start'"),
        (lambda: sf.simulate(model, start, inputs), "missing a required argument: 't'"),
        (lambda: sf.simulate(model, (0, 0, 0), inputs, t), "start: .*tuple.*settle"),
        (lambda: sf.simulate(model, start, RATES, t), "model.inputs"),
        (lambda: start["heding"], "did you mean 'heading'"),
        (lambda: sf.settle(model, heading="90 deg"), "heading: .* number, found str '90 deg'"),
        (lambda: sf.quasi_statics(vehicle, ground, law=sf.Coulomb), r"call it: Coulomb\(\)"),
        (lambda: sf.direct_kinematics("rover.urdf", ground), "vehicle: .*str.*read_vehicle"),
        (lambda: sf.direct_kinematics(vehicle, "site.tif"), "ground: .*str.*read_map"),
        (lambda: sf.Bicubic("site.tif"), "grid: expected Grid, found str 'site.tif'; .*read_map"),
        (lambda: sf.rollouts(model, start, np.zeros(3), t), "inputs: expected a mapping"),
        (lambda: sf.follow(model, [(0, 0)], speed=1.0), "path: expected Path"),
        (lambda: catalog.rigid_skid_steer(half_trck=0.3), "did you mean 'half_track'"),
    ):
        refuses(sf.ModelError, words, call)
    with pytest.raises(AttributeError, match="did you mean 'rocky7'"):
        catalog.roky7  # noqa: B018


def test_states_of_a_moving_horizon_are_map_coordinates(calls):
    given = calls["plan"][1] | {"goal": {"y": 5.5}, "duration": 4.0, "mesh": sf.Mesh(4)}
    found = sf.plan(**given)
    window, shift = horizon(found, span=2.0, intervals=2), given["model"].shift[0]
    assert shift[0] == 5.0
    measured = window.plan.states(np.array([0.1])).ravel() + shift
    assert sf.replan(window, first_cycle(window), 0.4, measured).violation < 1e-6
    assert "east" in found.plot().axes[0].get_xlabel()


def test_packages_are_asked_for_before_the_work(calls, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    for name in ("simulate", "start_states"):  # would raise TypeError
        monkeypatch.setattr(sys.modules["slipfree.solve.rollouts"], name, None)
    monkeypatch.setattr(sys.modules["slipfree.batch.many"], "evaluator_of", None)
    for name in ("rollouts", "settle_many"):
        refuses(sf.SlipfreeError, "expected the package 'xarray'", calls[name][0], **calls[name][1])
    monkeypatch.setitem(sys.modules, "viser", None)
    result = tmp_path / "missing.nc"
    assert "expected the package 'viser'" in invoke("show", str(result)).stderr


def test_results_and_maps_draw_themselves(tmp_path, calls):
    run, model = calls["plot"][1]["result"], calls["simulate"][1]["model"]
    poses, drawn = sf.atlas(**calls["atlas"][1]), ((None, "east"), ("rates", "time"))
    for result, name, axes in (*((run, *each) for each in drawn), (poses, *drawn[0])):
        for figure in (sf.plot(result, name), result.plot(name)):
            assert axes in figure.axes[0].get_xlabel()
    for record in (run, poses, model.ground, model, model.vehicle):
        assert (html := record._repr_html_()).count("<tr>") == len(lines_of(record)) - 1 > 1
        assert ("<img" in html) == hasattr(record, "plot")
    refuses(sf.ModelError, "did you mean 'rates'", sf.plot, run, "rate")
    refuses(sf.ModelError, "result: expected Trajectory", sf.plot, model)
    flat = sf.Analytic(lambda x, y: 0.02 * x * y)
    assert sf.settle(sf.direct_kinematics(catalog.three_wheeler(), flat)).plot().axes
    np.savez(tmp_path / "a.npz", x=AXIS, y=AXIS, z=0 * AXIS[:, None] * AXIS)
    ground = sf.read_map(tmp_path / "a.npz", friction=0.7)
    model = sf.quasi_statics(catalog.three_wheeler(axle="fixed"), ground)
    assert sf.settle(model, x=5.0, y=5.0).plot().axes
    assert (ground.mu, ground.crs, ground.grid.z.shape) == (0.7, "", (11, 11))


def test_an_interrupted_front_keeps_its_first_plans(monkeypatch):
    from slipfree.core.trajectory import Outcome
    from slipfree.plan.pareto import FrontPoint
    from slipfree.problem import pareto
    from slipfree.problem.load import load_problem

    plan = SimpleNamespace(saved=None, duration=8.0, slip=0.01, squared_slip=1.0)
    solved = FrontPoint(np.nan, 1.0, 8.0, outcome=Outcome.COMPLETE, solution=plan)
    for count in (1, 2, 3):
        pressed, kept = pressing(lambda *_, **__: solved, at=count + 1)[0], []
        monkeypatch.setattr(pareto, "_solve_point", pressed)
        problem = load_problem("problems/plan_rigid_hills.toml", ["costs.slip=1e4"])
        front = pareto.plan_front(problem, count=4, keep=lambda k, _, kept=kept: kept.append(k))
        assert kept == [pareto.GIVEN, 0, 3][:count]
        assert front.outcome is Outcome.INTERRUPTED
        assert len(pareto.front_rows(front)) == 4


@pytest.mark.parametrize("rate", [1e9, 1e300])
def test_lanes_that_are_too_fast_end_by_name(rate):
    vehicle, ground = catalog.three_wheeler(axle="fixed"), Analytic(lambda x, y: 0.02 * x * y)
    model = direct_kinematics(vehicle, ground)
    rates = {"right_rate": np.array([[rate], [1.5]]), "left_rate": 1.5, "steer_rate": 0.0}
    with pytest.warns(UserWarning, match="interpreted"):
        found = sf.rollouts(model, {}, rates, np.linspace(0, 1, 3), method="batch")
    assert found["outcome"].values.tolist() == ["solver_failure", "complete"]
    assert "20000 steps" in found["reason"].values[0]
    assert found["end"].values.tolist() == [0.0, 1.0]
