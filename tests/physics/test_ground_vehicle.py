"""Vehicles of the package fitted over a map: known truth of `simulate`, and early ends."""

from functools import partial

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import slipfree as sf
from helpers.commands import refuses
from helpers.hillside import HILL
from slipfree.batch.evaluator import evaluator_of
from slipfree.core.dae import Dae
from slipfree.fit import ground_vehicle
from slipfree.fit.ground_motion import DriveLog, GroundPredictor, MotionModel, Slopes, windows_of
from slipfree.fit.ground_vehicle import vehicle_model
from slipfree.fit.unknowns import Unknown, parametric_model, with_unknowns
from slipfree.problem.verbs.fit import build_model
from slipfree.vehicle.tree import Vehicle

DT, COUNT = 0.2, 75  # time between samples [s], number of intervals
CART = sf.catalog.skid_steer()
LEFT, RIGHT = (tuple(w.name for w in CART.wheels if side in w.name) for side in ("left", "right"))
UNKNOWNS = (
    Unknown("radius_left", "radius", LEFT),
    Unknown("radius_right", "radius", RIGHT),
    Unknown("track", "track"),
)
TRUE = (0.155, 0.152, 0.7)
SLOPES = Slopes(HILL, 0.0)


@pytest.fixture(autouse=True)
def interpreted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Interpret the equations: a compilation takes longer than these tests."""
    function = partial(evaluator_of, compiled=False)
    monkeypatch.setattr(ground_vehicle, "evaluator_of", function)


def model(vehicle: Vehicle, unknowns: tuple[Unknown, ...] = UNKNOWNS) -> MotionModel:
    """Return the motion of a vehicle with least slip."""
    build = partial(build_model, "kinematics")
    return vehicle_model("vehicle", build, vehicle, sf.LeastSlip(), unknowns, 0.6)


def drive(seed: int) -> DriveLog:
    """Return the log of a cart with the true values, by `simulate`; commands are nominal speeds."""
    rng = np.random.default_rng(seed)
    dae = build_model(
        "kinematics", sf.Bicubic(HILL, mu=0.6), with_unknowns(CART, UNKNOWNS, TRUE), sf.LeastSlip()
    )
    turn = np.repeat(rng.normal(0, 0.15, COUNT // 15), 15)
    sides = np.column_stack([0.5 - turn, 0.5 + turn])
    radius = CART.wheels[0].radius
    inputs = {f"{name}_rate": sides[:, 0] / radius for name in LEFT}
    inputs |= {f"{name}_rate": sides[:, 1] / radius for name in RIGHT}
    x, y, heading = (*rng.uniform(-10, 10, 2), rng.uniform(-3, 3))
    t = DT * np.arange(COUNT + 1)
    start = sf.settle(dae, x=x, y=y, heading=heading)
    run = sf.simulate(dae, start, dae.inputs(**inputs), t, options=sf.SolverOptions(tolerance=1e-8))
    place = np.column_stack([run["x"], run["y"]])[:-1]
    velocity = np.gradient(place, DT, axis=0)
    ahead = np.ones(COUNT)
    speed, angle = np.hypot(*velocity.T), run["heading"][:-1] + np.pi / 2
    return DriveLog(
        f"log {seed}", "a", DT, place, velocity, speed, ahead > 0, ahead, sides, heading=angle
    )


def test_true_values_follow_simulate() -> None:
    drives = [drive(k) for k in range(2)]
    predict = GroundPredictor(drives, windows_of(drives, 5.0), SLOPES)
    cart = model(CART)
    values = {
        name: np.array([nominal, true])
        for (name, nominal), true in zip(cart.start.items(), TRUE, strict=True)
    }
    found = predict(cart, values)
    # the heading at the start of a window follows from a turn over the chord before it
    assert found.position[:, 1].max() < 1e-3
    assert np.abs(found.course[:, 1]).max() < 2e-3
    assert found.position[:, 0].min() > 0.1
    single = predict(cart, cart.start)
    assert_allclose(found.along[:, 0], single.along, atol=1e-9)


def test_motions_that_end_are_refused_by_name() -> None:
    drives = [drive(0)]
    predict = GroundPredictor(drives, windows_of(drives, 5.0), SLOPES)
    tall = model(CART, (Unknown("ahead", "center_of_mass_ahead"),))
    refuses(sf.ModelError, r"with ahead = 0.4, found .*lifts off", predict, tall, {"ahead": 0.4})
    car = model(sf.catalog.ackermann(), ())
    with pytest.raises(sf.ModelError, match=r"found steer_rate; use a skid-steered vehicle"):
        predict(car, {"turn": 1.0})


def test_radius_and_constants_of_soil_are_parameters() -> None:
    """Limits keep their numbers, and the equations are those of the same numbers."""
    law = sf.Soil(frictional_modulus=3e6, creep=0.03)
    unknowns = (Unknown("radius", "radius"), Unknown("shear_along", "shear_along"))
    build = partial(build_model, "quasi-static", sf.Bicubic(HILL))
    free, fixed = parametric_model(build, CART, law, unknowns), build(CART, law)
    for one, other in zip(free.limits, fixed.limits, strict=True):
        assert (one.lower, one.upper) == (other.lower, other.upper)
    names = {name: 0.3 + 0.2 * np.sin(k) for k, name in enumerate(sorted(symbols(fixed)))}
    names |= {each.label.name: each.value for each in free.p}
    one, other = (
        ca.Function("f", list(symbols(dae).values()), [ca.vertcat(*dae.alg)])(
            *(names[name] for name in symbols(dae))
        ).full()
        for dae in (free, fixed)
    )
    assert np.isfinite(other).all()
    assert_allclose(one, other, rtol=1e-9, atol=1e-12)


def symbols(dae: Dae) -> dict[str, ca.SX]:
    """Return the symbols of the algebraic equations by name."""
    return {each.name(): each for each in ca.symvar(ca.vertcat(*dae.alg))}
