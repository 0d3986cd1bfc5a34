"""Every public function names a wrong argument, whatever it is."""

from __future__ import annotations

import inspect
import sys
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

import slipfree as sf
from helpers.commands import invoke
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
def calls(tmp_path_factory):
    """Return valid arguments of every public function and class, by name."""
    ground = sf.Bicubic(sf.Grid(AXIS, AXIS, 0.02 * AXIS[:, None] * AXIS), mu=0.8)
    vehicle = catalog.three_wheeler(axle="fixed")
    model = sf.direct_kinematics(vehicle, ground)
    start = sf.settle(model, x=5.0, y=5.0)
    t, ranges = np.linspace(0.0, 0.2, 3), dict.fromkeys(RATES, (-1.0, 1.0))
    run = sf.simulate(model, start, model.inputs(**RATES), t)
    task = sf.SamplingTask(
        model, {"effort": 1.0}, {"y": 6.0}, 1.0, ranges, intervals=2, candidates=8, compiled=False
    )
    wheel, joint = vehicle.wheels[0], vehicle.joints[0]
    places = {"x": AXIS[4:6], "y": AXIS[4:6]}
    both = {"vehicle": vehicle, "terrain": ground}
    named = {
        "settle": {"dae": model, "x": 5.0, "heading": 0.1, "guess": {"z": 0.5}},
        "settle_many": {"model": model, "compiled": False, "x": 5.0, "heading": [0.1, 0.2]},
        "simulate": {"dae": model, "start": start, "inputs": model.inputs(**RATES), "t": t},
        "rollouts": {
            "model": model, "starts": {"x": 5.0, "y": 5.0}, "inputs": RATES, "t": t, "p": None,
            "quantities": ["x"], "processes": 1, "method": "simulate", "step": 0.1,
        },
        "plan": {
            "dae": model, "start": start, "goal": {"y": 6.0}, "costs": {"effort": 1.0},
            "duration": 2.0, "smooth": 0.0, "limits": {}, "way_points": None, "inputs": ranges,
            "accelerations": None, "cost_limits": None, "initial_inputs": None, "guess": None,
        },
        "sample_plan": {"task": task, "x": np.array([5.0, 5.0, 0.0, 0.0]), "keep_out": ()},
        "SamplingTask": {
            "model": model, "costs": {"effort": 1.0}, "goal": {"y": 6.0}, "span": 1.0,
            "ranges": ranges, "intervals": 2, "candidates": 8, "spread": 0.2, "threads": 1,
        },
        "follow": {
            "dae": model, "vehicle": vehicle, "path": sf.Path([(5, 5), (5, 6)]), "speed": 0.1
        },
        "straight": {"dae": model, "vehicle": vehicle, "start": start, "speed": 0.1},
        "commanded": {"dae": model, "vehicle": vehicle, "speed": 0.1},
        "atlas": {"model": model, "terrain": ground, "headings": 1, **places, "compiled": False},
        "plot": {"result": run, "terrain": ground, "name": None},
        "cross_check": {"first": run, "second": run},
        "direct_kinematics": both | {"slip": sf.LeastSlip(), "smoothing": 0.1},
        "montana_kinematics": both | {"kappa": 10.0},
        "quasi_statics": both | {"law": sf.Coulomb()},
        "rigid_dynamics": both | {"law": sf.LinearCreep()},
        "dynamics": {"vehicle": vehicle, "ground": ground, "law": sf.Compliant()},
        "inverse_kinematics": both | {
            "given": ("forward", "yaw_rate"), "solve_for": "angles", "least_margin": 1e-3
        },
        "planar": {"vehicle": catalog.step_climber()},
        "in_gravity": {"vehicle": vehicle, "gravity": "moon"},
        "read_map": {
            "path": "missing.tif", "window": None, "cell": None, "geographic": None, "fill": None,
            "friction": None,
        },
        "read_vehicle": {"path": "missing.toml", "trust": ()},
        "load_problem": {"path": "missing.toml", "settings": (), "trust": ()},
        "open_result": {"path": "missing.nc", "samples": None},
        "run_problem": {"problem": None},
        "replan": {"window": None, "former": None, "t": 0.0, "x": np.zeros(4)},
        "Analytic": {"function": lambda x, y: 0 * x * y, "domain": (0.0, 1.0, 0.0, 1.0), "mu": 1.0},
        "Bicubic": {"grid": ground.grid, "center": (5.0, 5.0), "mu": 0.7},
        "Grid": {"x": AXIS, "y": AXIS, "z": np.zeros((11, 11)), "filled": None, "holes": None},
        "Solids": {"base": ground, "prisms": ()},
        "Path": {"points": [(0.0, 0.0), (1.0, 0.0)]},
        "Body": {"mass": 1.0, "at": (0.0, 0.0, 0.0), "inertia": None, "shapes": ()},
        "Coordinate": {"name": "a", "kind": "passive", "words": "a", "lower": -1.0, "rest": 0.0},
        "Joint": {
            "name": "a", "parent": "platform", "axis": "x", "at": (0, 0, 0), "value": "0",
            "turned": (0, 0, 0),
        },
        "Wheel": {
            "name": "a", "parent": "platform", "at": (0, 0, 0), "section": wheel.section,
            "driven": True, "grip": 1.0, "mass": 1.0, "axle": "x", "inertia": (1.0, 1.0),
        },
        "Vehicle": {
            "name": "a", "coordinates": vehicle.coordinates, "joints": (*vehicle.joints[:0], joint),
            "wheels": vehicle.wheels, "gravity": 9.81,
        },
        "Motor": {"stall": 1.0, "no_load": 1.0, "kp": 1.0, "ki": 0.0},
        "Coulomb": {"creep": 1e-3, "reserve": 0.0},
        "Compliant": {"damping_ratio": 0.5, "body_depth": 0.0},
        "LinearCreep": {"creep": 1e-3},
        "Soil": {"cohesion": 800.0, "friction_angle": 0.6, "coupled_shear": False},
        "SolverOptions": {"tolerance": 1e-8, "method": None, "compiled": False},
        "Mesh": {"intervals": 4, "degree": 3, "accuracy": 1e-3},
        "Search": {"starts": 1, "seed": 0},
    }
    return {name: (getattr(sf, name), given) for name, given in named.items()}


CHECKED = [
    name
    for name in sf.__all__
    if callable(getattr(sf, name))
    and hasattr(getattr(getattr(sf, name), "__init__", None), "__wrapped__")
    or inspect.isfunction(getattr(sf, name))
]


@pytest.mark.parametrize("name", CHECKED)
def test_every_wrong_argument_is_named(calls, name, monkeypatch):
    def accepted(*_, **__):
        raise sf.SolverError("the arguments are accepted")

    monkeypatch.setattr(sys.modules["slipfree.plan.plan"], "initial_guess", accepted)
    function, given = calls[name]
    for key in given.keys() - {"compiled"}:
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
