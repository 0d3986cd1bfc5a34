"""Tests of coupled joints, their formulas, and motions that are equal at any size."""

import math
from dataclasses import replace
from functools import lru_cache

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import slipfree as sf
from helpers.cases import DATA
from helpers.commands import error_of, refuses
from helpers.dynamics import FLAT
from helpers.scale_cases import CASES, TOLERANCE, difference, formula, scaled
from helpers.urdf import joint, link, wheel, written
from slipfree.catalog import three_wheeler
from slipfree.core.dae import power_of_length
from slipfree.core.records import leaves
from slipfree.files.vehicle_toml import VehicleError
from slipfree.models.given_rates import COMMANDS
from slipfree.solve.replay import replay, round_trip, trim_states
from slipfree.vehicle.formula import evaluate, names_in

ROVER = """\
name = "two rockers"
frame = "paper"
mass = 20.0
center_of_mass = [{x}, {y}, 0.1]
couple = {{ left = {left}, right = {right} }}
coordinates = [{{ name = "a", kind = "suspension" }}, {{ name = "b", kind = "suspension" }}]
joints = [{{ name = "left", parent = "platform", axis = "x", at = [-0.3, 0, 0], value = "a" }},
    {{ name = "right", parent = "platform", axis = "x", at = [0.3, 0, 0], value = "b" }}]
wheels = [{wheels}]
"""
WHEEL = (
    '{{ name = "{}{}", parent = "{}", at = [0, {}, -0.1], radius = 0.1, driven = true, '
    "mass = 1, static_depth = 1e-5 }}"
)
WHEELS = ",\n    ".join(
    WHEEL.format(side[0], end, side, y)
    for side in ("left", "right")
    for end, y in (("f", 0.3), ("r", -0.2))
)
ALIKE = ("y", "z", "pitch", "velocity_y", "velocity_z", "tip_over_margin")
OPPOSITE = ("x", "heading", "roll", "velocity_x", "heading_rate")
SWAPPED = ("force_normal", "force_along", "slip_along", "contact_z", "drive_torque")


def rover(tmp, left=1.0, right=1.0, x=0.0, y=0.05):
    path = tmp / "rover.toml"
    path.write_text(ROVER.format(left=left, right=right, x=x, y=y, wheels=WHEELS))
    return sf.read_vehicle(path)


def test_a_coupling_that_leaves_an_angle_free_is_named(tmp_path):
    """Rockers that turn alike about one axis turn as one body, against the platform."""
    words = r"pitch and a are free, .* write couple = \{ left = 1, right = 1 \}"
    refuses(VehicleError, words, rover, tmp_path, 1.0, -1.0)
    for right in (1.0, -2.0):
        assert rover(tmp_path, 1.0, right).coordinates


def bump(side):
    """Return a ground with a bump under the wheels of a side, and another between the wheels."""

    def height(x, y):
        across, along = (side * x - 0.3) / 0.2, (y - 0.8) / 0.35
        hollow = 0.03 * ca.exp(-(((side * x + 0.4) / 0.3) ** 2) - ((y - 0.2) / 0.4) ** 2)
        return 0.08 * ca.exp(-(across**2) - along**2) - hollow

    return sf.Analytic(height, mu=0.8)


def over(model, side, rate=4.0):
    fast, slow = (rate, 0.9 * rate)[::side]
    inputs = model.inputs(lf_rate=fast, lr_rate=fast, rf_rate=slow, rr_rate=slow)
    return sf.simulate(model, sf.settle(model), inputs, np.linspace(0, 3, 16))


@pytest.mark.parametrize("make", [sf.direct_kinematics, sf.quasi_statics])
def test_mirrored_bumps_move_coupled_rockers_in_mirrored_ways(make, tmp_path):
    vehicle = rover(tmp_path)
    assert [each.name for each in vehicle.coordinates] == ["a"]
    run, other = (over(make(vehicle, bump(side)), side) for side in (1, -1))
    assert run.stop is None
    assert np.ptp(run["pitch"]) > 0.02
    assert np.ptp(run["a"]) > 0.05
    for name in ALIKE:
        assert_allclose(other[name], run[name], rtol=1e-6, atol=1e-6)
    for name in OPPOSITE:
        assert_allclose(other[name], -run[name], rtol=1e-6, atol=1e-6)
    assert_allclose(other["a"], -run["a"], rtol=1e-6, atol=1e-6)  # the right rocker moves as -a
    for name in SWAPPED:
        assert_allclose(other[name][:, [2, 3, 0, 1]], run[name], rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("ratio", [1.0, 2.0, -0.5])
@pytest.mark.parametrize("make", [sf.direct_kinematics, sf.quasi_statics, sf.dynamics])
def test_a_differential_shares_loads_as_in_the_closed_form(make, ratio, tmp_path):
    """Virtual work: ``M_left = M_right / ratio`` for left + ratio * right = 0."""
    x, y, weight = 0.06, 0.04, 20 * 9.81
    run = sf.settle(make(rover(tmp_path, right=ratio, x=x, y=y), FLAT))
    sides = {"l": weight * (0.5 - x / 0.6), "r": weight * (0.5 + x / 0.6)}
    moments = {"l": weight * y / (1 + ratio), "r": weight * y * ratio / (1 + ratio)}
    for k, name in enumerate(run.wheels):
        lever = 0.2 if name[1] == "f" else 0.3
        sign = 1 if name[1] == "f" else -1
        expected = (sides[name[0]] * lever + sign * moments[name[0]]) / 0.5 + 9.81
        assert run["force_normal"][0, k] == pytest.approx(expected, abs=1e-4 * weight)


STEERED = (DATA / "coupled_steering.toml").read_text()


def test_commands_are_met_with_coupled_steering(tmp_path):
    """The axles meet in the centre of the turn: tan s / (tan s + tan(s/2)) is that of the front."""
    path = tmp_path / "steered.toml"
    path.write_text(STEERED)
    vehicle = sf.read_vehicle(path)
    direct = sf.direct_kinematics(vehicle, FLAT)
    dae = sf.inverse_kinematics(vehicle, FLAT, given=tuple(COMMANDS), exact=False)
    assert [label.full for label in leaves(direct.labels.u)][-1] == "s_rate"
    steer, forward = 0.3, 0.2
    # both axles at right angles to the radius; the centre is ahead of the platform's by `ahead`
    radius = 0.8 / (np.tan(steer) + np.tan(steer / 2))
    ahead = 0.4 - radius * np.tan(steer)
    yaw_rate = forward / radius
    command = (forward, ahead * yaw_rate, yaw_rate)
    inputs = dae.inputs(**dict(zip(COMMANDS, command, strict=True)))
    start = trim_states(dae, sf.settle(direct), inputs, states=["s"], least=["s_error"])
    assert start["s"][0] == pytest.approx(steer, abs=1e-9)
    run = sf.simulate(dae, start, inputs, np.linspace(0, 1, 6))
    assert run.stop is None
    names = ("velocity_x", "velocity_y", "heading_rate")
    assert max(round_trip(direct, run, names).values()) < 1e-9
    assert_allclose(replay(direct, run)[0]["heading_rate"], yaw_rate, rtol=0, atol=1e-8)
    assert np.abs(run["slip_across"]).max() < 1e-9


def test_a_chain_of_mimics_is_a_formula(tmp_path):
    """``first`` follows ``second``, which follows ``third``; in a vehicle file it is a value."""
    more = {
        "first": '<mimic joint="second" multiplier="-2" offset="0.1"/>',
        "second": '<mimic joint="third" multiplier="0.5" offset="0.2"/>',
        "third": "",
    }
    limit = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
    parts, at = "", {"first": 0.4, "second": 0.0, "third": -0.4}
    for name, x in at.items():
        parts += link(f"{name}_arm")
        parts += joint(
            name, "revolute", "base", f"{name}_arm", f"{x} 0 0", "0 0 1", more=limit + more[name]
        )
        parts += wheel(f"{name}_left", "0 0.3 0", parent=f"{name}_arm")
        parts += wheel(f"{name}_right", "0 -0.3 0", parent=f"{name}_arm")
    urdf = sf.read_vehicle(
        written(tmp_path, parts, 'forward = "x"\njoints = { third = "commanded" }\n')
    )
    path = tmp_path / "same.toml"
    head = (
        'name = "same"\nframe = "rep103"\ncoordinates = [{ name = "third", kind = "commanded" }]\n'
    )
    values = {"first": "-2*(0.5*third + 0.2) + 0.1", "second": "0.5*third + 0.2", "third": "third"}
    joints = ", ".join(
        f'{{ name = "{name}", parent = "platform", axis = "z", at = [{x}, 0, 0], '
        f'value = "{values[name]}" }}'
        for name, x in at.items()
    )
    wheels = ", ".join(
        f'{{ name = "{name}_{side}", parent = "{name}", at = [0, {y}, 0], radius = 0.1 }}'
        for name in at
        for side, y in (("left", 0.3), ("right", -0.3))
    )
    path.write_text(f"{head}joints = [{joints}]\nwheels = [{wheels}]\n")
    angle = ca.SX.sym("third")
    for vehicle in (urdf, sf.read_vehicle(path)):
        assert [c.name for c in vehicle.coordinates] == ["third"]
        poses = {each.name: each.pose({"third": angle}) for each in vehicle.joints}
        for name, expected in (("third", 0.3), ("second", 0.35), ("first", -0.6)):
            turned = ca.Function("turned", [angle], [poses[name].rotation])(0.3)
            found = np.arctan2(float(turned[1, 0]), float(turned[0, 0]))
            assert found == pytest.approx(expected, abs=1e-12)


# Joint formulas: allowed contents, and the errors of refused formulas

A, B = 0.3, -1.2
MEANT = {
    "-a": -A,
    "2*a + b/4 - 1e-1": 2 * A + B / 4 - 0.1,
    "atan2(0.7*tan(a), 0.7 + 0.3*tan(a))": math.atan2(0.7 * math.tan(A), 0.7 + 0.3 * math.tan(A)),
    "sqrt(a**2 + b**2) * cos(pi)": -math.hypot(A, B),
    "asin(a) + acos(a) + atan(b)": math.pi / 2 + math.atan(B),
    "abs(b) + exp(a) + log(a) - sin(b)": abs(B) + math.exp(A) + math.log(A) - math.sin(B),
    "2**3**2 + +a": 512 + A,
    "  (a)\n": A,
    "0": 0.0,
}


def test_a_formula_means_what_it_says():
    for text, expected in MEANT.items():
        found = evaluate(text, {"a": ca.SX(A), "b": ca.SX(B)})
        assert float(ca.evalf(found)) == pytest.approx(expected, rel=1e-15), text


def test_a_formula_tells_what_it_depends_on():
    assert names_in("atan2(tan(a), pi) - 2*steer_b") == {"a", "steer_b"}
    assert names_in("0") == set()


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("", "found ''"),
        ("a.real", "found 'a.real'"),
        ("__import__('os')", "found \"__import__('os')\""),
        ("sin(a, b)", "found 'sin(a, b)'"),
        ("a if b else 0", "found 'a if b else 0'"),
        ("'a'", "found \"'a'\""),
        ("1j*a", "found '1j'"),
        ("(" * 300 + "a" + ")" * 300, "found '(((("),
        ("a\0", "found 'a"),
        ("not " * 240 + "a", "found 'not "),
        ("a" + ".b" * 450, "found 'a.b"),
        ("'\\d'", "found \"'"),
        ("9" * 400, "found '9999"),
    ],
)
def test_anything_else_is_refused(text, found):
    caught = error_of(sf.ModelError, names_in, text)
    assert "expected numbers up to 1e+300, coordinates, + - * / **, pi and sin" in str(caught)
    assert found in str(caught)


def test_long_and_deep_formulas_are_refused():
    refuses(
        sf.ModelError, "expected at most 1000 characters, found 5001", names_in, "-" * 5000 + "a"
    )
    refuses(
        sf.ModelError, "expected at most 50 nested levels, found more", names_in, "-" * 900 + "a"
    )


def test_unknown_names_are_listed_with_those_that_are_known():
    words = r"formula '2\*stear': expected one of the names steer, found 'stear'"
    refuses(sf.ModelError, words, evaluate, "2*stear", {"steer": ca.SX(0)})


# Motions are equal at any size of vehicle and ground

MOST = 1.0  # tolerances
AMPLIFIED = {"inverse, steering rate": 50.0}  # rounding changes the steps, and so the error
at_scale_one = lru_cache(lambda name: CASES[name](1.0))


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_scaled_problem_has_the_scaled_motion(name):
    scale = 1e3
    first, run = at_scale_one(name), CASES[name](scale)
    assert (run.stop and run.stop.name) == (first.stop and first.stop.name)
    assert_allclose(run.t[-1], first.t[-1], rtol=0, atol=2e-6)
    quantity, gap = difference(first, run, scale)
    assert gap < AMPLIFIED.get(name, MOST), quantity


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_extreme_scales_are_not_singular(scale):
    dae = sf.direct_kinematics(scaled(three_wheeler(), scale), formula(scale))
    found, expected = sf.settle(dae, heading=0.2), _stand()
    for name in ("roll", "pitch", "singular_value"):
        assert_allclose(found[name], expected[name], rtol=0, atol=TOLERANCE, err_msg=name)
    for name in ("z", "contact_x", "contact_y"):
        assert_allclose(found[name] / scale, expected[name], rtol=0, atol=TOLERANCE, err_msg=name)


@pytest.mark.slow
def test_tolerance_of_lengths_counts_in_sizes_of_the_vehicle():
    """As many steps at every scale: the error test sees the same numbers."""
    steps = [CASES["direct, map"](scale).statistics["steps"] for scale in (1e-3, 1e3)]
    assert_allclose(steps, at_scale_one("direct, map").statistics["steps"], atol=2)


@pytest.mark.parametrize(
    ("unit", "power"), [("m", 1), ("rad", 0), ("m s-1", 1), ("m2 s-1", 2), ("m-1", -1), ("N m", 1)]
)
def test_power_of_length(unit, power):
    assert power_of_length(unit) == power


@lru_cache
def _stand():
    return sf.settle(sf.direct_kinematics(three_wheeler(), formula(1.0)), heading=0.2)


def test_size_is_a_positive_length():
    dae = sf.direct_kinematics(three_wheeler(), formula(1.0))
    assert dae.size == 1.0  # the paper's vehicle: tolerances in metres
    words = "size: expected a positive, finite length in metres, found 0"
    refuses(sf.ModelError, words, replace, dae, size=0.0)
