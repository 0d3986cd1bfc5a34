"""Every public function names a wrong argument, whatever it is."""

import inspect
import sys
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

import slipfree as sf
from helpers.commands import invoke, pressing, refuses
from slipfree import catalog

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


def refusal(function, *args, **given):
    with pytest.raises(sf.ModelError) as caught:
        function(*args, **given)
    return str(caught.value)


def test_degrees_are_asked_back(calls):
    model, start = (calls["simulate"][1][key] for key in ("model", "start"))
    places, inputs, t = {"x": 5.0, "y": 5.0}, RATES, np.linspace(0.0, 0.2, 3)
    words = r"expected an angle in radians, found 90; did you mean 90 degrees\? write np.radians"
    for function, given in (
        (sf.settle, {"model": model, "heading": 90}),
        (sf.settle, {"model": model, "guess": {"roll": 90.0}, **places}),
        (sf.settle_many, {"model": model, "heading": [0.0, 90.0], "compiled": False}),
        (
            sf.rollouts,
            {"model": model, "starts": places | {"heading": 90}, "inputs": RATES, "t": t},
        ),
        (
            sf.rollouts,
            {"model": lambda: model, "starts": {"heading": 90}, "inputs": inputs, "t": t},
        ),
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
    assert "exchange 'inputs' and 't'" in refusal(sf.simulate, model, start, t, inputs)
    assert "exchange 'model' and 'start'" in refusal(sf.simulate, start, model, inputs, t)
    assert "did you mean 'half_track'" in refusal(catalog.rigid_skid_steer, half_trck=0.3)
    assert "missing a required argument: 't'" in refusal(sf.simulate, model, start, inputs)
    words = refusal(sf.settle, model, heading="90 deg")
    assert "heading: expected a number, found str '90 deg'" in words
    assert "call it: Coulomb()" in refusal(
        sf.quasi_statics, catalog.three_wheeler(), model.ground, law=sf.Coulomb
    )


def test_states_of_a_moving_horizon_are_map_coordinates(calls):
    from slipfree.plan.mpc import first_cycle, horizon

    given = calls["plan"][1] | {"goal": {"y": 5.5}, "duration": 4.0, "mesh": sf.Mesh(4)}
    found = sf.plan(**given)
    window, shift = horizon(found, span=2.0, intervals=2), given["model"].shift[0]
    assert shift[0] == 5.0
    measured = window.plan.states(np.array([0.1])).ravel() + shift
    assert sf.replan(window, first_cycle(window), 0.4, measured).violation < 1e-6
    (ax, *_) = found.plot().axes
    assert "east" in ax.get_xlabel()


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
    run = calls["plot"][1]["result"]
    flat = sf.Analytic(lambda x, y: 0.02 * x * y)
    poses = sf.atlas(**calls["atlas"][1])
    free = sf.settle(sf.direct_kinematics(catalog.three_wheeler(), flat))
    for result, name in ((run, None), (run, "slip"), (free, None), (poses, None)):
        assert result.plot(name).axes
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
    model = sf.direct_kinematics(
        catalog.three_wheeler(axle="fixed"), sf.Analytic(lambda x, y: 0.02 * x * y)
    )
    rates = {"right_rate": np.array([[rate], [1.5]]), "left_rate": 1.5, "steer_rate": 0.0}
    with pytest.warns(UserWarning, match="interpreted"):
        found = sf.rollouts(model, {}, rates, np.linspace(0, 1, 3), method="batch")
    assert found["outcome"].values.tolist() == ["solver_failure", "complete"]
    assert "20000 steps" in found["reason"].values[0]
    assert found["end"].values.tolist() == [0.0, 1.0]
