"""Tests of starts: from a pose or a contact, of rearranged models, and of rollouts."""

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import slipfree as sf
from helpers.cases import LIGHT, case1, closure_model, hills
from helpers.commands import refuses
from slipfree import Analytic, ModelError, direct_kinematics, settle
from slipfree.catalog import rigid_skid_steer, three_wheeler
from slipfree.core.rearrange import blocks, rearrange, substitute, variables, with_outputs
from slipfree.core.records import Label
from slipfree.solve.settle import settle_contact

HILLS = sf.Analytic(hills)


@pytest.mark.slow
def test_start_from_one_contact(rng):
    for terrain in (HILLS, case1()[0]):
        dae = closure_model(three_wheeler(), terrain)
        for wheel in ("right", "left", "front"):
            names = ("heading", "tilt_right", "tilt_left", "steer")
            joints = dict(zip(names, rng.uniform(-0.2, 0.2, 4), strict=True))
            stood = sf.settle(dae, x=0.4, y=0.2, **joints)
            place = {name: stood[name, wheel][0] for name in ("contact_x", "contact_y")}
            found = settle_contact(dae, wheel, **place, **joints)
            for name in ("x", "y", "z", "heading", "roll", "pitch"):
                assert_allclose(found[name][0], stood[name][0], rtol=0, atol=1e-12, err_msg=name)


def test_starts_from_a_contact_are_checked():
    dae = closure_model(three_wheeler(), HILLS)
    with pytest.raises(sf.ModelError, match=r"front, left, right.*, found 'rear'"):
        settle_contact(dae, "rear", contact_x=0.0, contact_y=0.0)
    with pytest.raises(sf.ModelError, match="which follow from the contact point, found y"):
        settle_contact(dae, "left", contact_x=0.0, contact_y=0.0, y=1.0)
    with pytest.raises(sf.ModelError, match="found the unknown 'azimuth'"):
        settle_contact(dae, "left", contact_x=0.0, contact_y=0.0, azimuth=1.0)


# Rearranged models: labels, guesses, numbers and checks

AXIS = np.linspace(-4, 4, 41)
GROUNDS = {
    "formula": sf.Analytic(hills),
    "map": sf.Bicubic(
        sf.Grid(AXIS + 100, AXIS, 0.1 * np.sin(AXIS)[:, None] * np.cos(AXIS)), (100.0, 0.0)
    ),
}


@pytest.fixture(params=GROUNDS)
def direct(request):
    return sf.direct_kinematics(three_wheeler(), GROUNDS[request.param])


def evaluated(dae, start):
    """Guess and residuals at a start."""
    symbols = [*dae.columns()]
    function = dae.function("all", symbols, [dae.guess, ca.vertcat(*dae.alg)])
    x, z = dae.rows("x", start, 0), dae.rows("z", start, 0)
    return [np.array(part) for part in function(x, z, np.full(symbols[2].shape, 0.3))]


def test_the_same_places_give_the_same_model(direct):
    same = rearrange(direct, *variables(direct), blocks(direct))
    assert same.labels == direct.labels
    assert_array_equal(same.scale, direct.scale)
    for record in (0, 1):
        assert_array_equal(same.shift[record], direct.shift[record])
    start = sf.settle(direct, x=float(direct.shift[0][0]), heading=0.2)
    for one, other in zip(evaluated(same, start), evaluated(direct, start), strict=True):
        assert_array_equal(one, other)
    x, z = direct.rows("x", start, 0), direct.rows("z", start, 0)
    for one, other in zip(same.checks, direct.checks, strict=True):
        assert one.label == other.label
        assert_array_equal(one.margin(x[:, None], z[:, None]), other.margin(x[:, None], z[:, None]))


def test_a_state_among_the_unknowns_is_zero_in_the_guess_and_keeps_its_shift(direct):
    x, z, u = variables(direct)
    z = z._replace(position=z.position._replace(z=x.x))
    moved = rearrange(direct, x._replace(x=variables(direct)[1].position.z), z, u, blocks(direct))
    assert moved.labels.x.x.name == "z"
    assert_allclose([each[0] for each in moved.shift[:2]], [direct.shift[k][0] for k in (1, 0)])
    at = np.array([7.0, 0.5, 0.1, 0.0, 0.0, 0.0])  # z, y, heading, joints
    former = np.array([0.0, 0.5, 0.1, 0.0, 0.0, 0.0])
    guess = moved.function("guess", [moved.columns()[0]], [moved.guess])(at)
    other = direct.function("guess", [direct.columns()[0]], [direct.guess])(former)
    assert_allclose(np.array(guess)[0], 0.0)
    assert_array_equal(np.array(guess)[1:], np.array(other)[1:])
    assert moved.ode[0].is_zero()


def test_values_take_the_place_of_inputs_and_outputs_are_added(direct):
    half = substitute(direct, direct.u.wheels, [ca.SX(0.5), 2 * direct.t])
    assert not ca.depends_on(ca.vertcat(*half.alg, half.quad), ca.vertcat(*direct.u.wheels))
    named = with_outputs(half, [(Label("twice", "s", "twice the time"), 2 * direct.t)])
    assert ca.is_equal(named.named("twice")[0], 2 * direct.t, 3)


# Rollouts: each run equals one simulation, whatever the processes; errors stop one run only

T = np.linspace(0, 2, 5)
OPTIONS = sf.SolverOptions(tolerance=1e-6)


def on_hills(trail=0.0):
    """A model of a vehicle without masses, with a parameter that lifts the ground."""
    return sf.direct_kinematics(
        three_wheeler(**LIGHT), sf.Analytic(lambda x, y: hills(x, y) + trail)
    )


@pytest.fixture(scope="module")
def dae():
    return on_hills()


def rates(count, seed=0):
    found = np.random.default_rng(seed).uniform(0.2, 0.6, (2, count, T.size - 1))
    return {"right_rate": found[0], "left_rate": found[1], "steer_rate": 0.0}


def test_each_run_equals_a_simulation(dae):
    headings, inputs = np.array([0.0, -1.1]), rates(2)
    found = sf.rollouts(dae, {"heading": headings, "x": 0.2}, inputs, T, options=OPTIONS)
    assert found["slip_along"].dims == ("run", "time", "wheel")
    assert found["x"].attrs["units"] == "m"
    for k, heading in enumerate(headings):
        start = sf.settle(dae, heading=heading, x=0.2, options=OPTIONS)
        own = {name: each[k] if np.ndim(each) == 2 else each for name, each in inputs.items()}
        run = sf.simulate(dae, start, dae.inputs(**own), T, options=OPTIONS)
        for name in run:
            assert_array_equal(found[name][k], run[name], err_msg=name)
    assert (found["outcome"] == "complete").all()
    assert (found["end"] == T[-1]).all()


@pytest.mark.slow
def test_results_do_not_depend_on_processes_or_order():
    inputs, p = rates(7), {"trail": [0.0, 0.3, 0.0, 0.3, 0.0, 0.0, 0.3]}
    arguments = {"p": p, "quantities": ("x", "z", "clearance"), "options": OPTIONS}
    alone = sf.rollouts(on_hills, {}, inputs, T, **arguments)
    assert set(alone) == {"x", "z", "clearance", "outcome", "reason", "end"}
    two = sf.rollouts(on_hills, {}, inputs, T, processes=2, **arguments)
    assert alone.identical(two)
    back = {k: v[::-1] if np.ndim(v) else v for k, v in inputs.items()}
    reverse = sf.rollouts(on_hills, {}, back, T, **(arguments | {"p": {"trail": p["trail"][::-1]}}))
    for name in alone:
        assert_array_equal(reverse[name][::-1], alone[name])
    assert np.ptp(alone["z"].values[:, 0]) > 0.29  # the parameter has an effect


def test_a_run_that_ends_early_or_has_no_start_does_not_stop_the_others():
    ground = sf.Analytic(hills, (-3.0, 3.0, -3.0, 1.3))
    dae = sf.direct_kinematics(three_wheeler(**LIGHT), ground)
    speeds = {"right_rate": [[0.1], [2.0], [0.1]], "left_rate": [[0.1], [2.0], [0.1]]}
    starts = {"y": [0.0, 0.0, 5.0]}
    found = sf.rollouts(dae, starts, speeds | {"steer_rate": 0.0}, T, options=OPTIONS)
    assert found["outcome"].values.tolist() == ["complete", "limit", "failed"]
    complete, limit, failed = found["reason"].values.tolist()
    assert (complete, "map" in limit, "start" in failed) == ("", True, True)
    assert 0 < found["end"][1] < T[-1]
    assert np.isnan(found["end"][2])
    assert_array_equal(np.isnan(found["x"]).all(axis=1), [False, False, True])
    assert_array_equal(np.isnan(found["x"][1]), found["end"][1].item() < T)


def test_trajectories_and_expressions_are_starts_and_inputs(dae):
    starts = [sf.settle(dae, heading=heading) for heading in (0.0, 0.5)]
    law = {"right_rate": 0.3 + 0.1 * ca.sin(dae.t), "left_rate": 0.3, "steer_rate": 0.0}
    found = sf.rollouts(dae, starts, law, T)
    run = sf.simulate(dae, starts[1], dae.inputs(**law), T)
    assert_array_equal(found["heading"][1], run["heading"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"starts": {"x": np.zeros((2, 2))}}, r"starts\['x'\]: expected .*found shape \(2, 2\)"),
        ({"starts": {"x": np.zeros(3)}}, r"starts\['x'\]: expected values for 1 run or for 4 runs"),
        (
            {"starts": 1.0},
            "starts: expected Trajectory or a sequence of Trajectory or a mapping, found float",
        ),
        ({"inputs": rates(4) | {"steer_rate": np.zeros(3)}}, r"steer_rate.*found shape \(3,\)"),
        ({"inputs": {"right_rate": 0.1}}, "inputs: expected values for .*no value for"),
        ({"p": {"trail": [0.0]}}, "model: expected a function of the parameters in p"),
        ({"processes": 2}, "model: expected a function for 2 processes, found a model"),
        ({"processes": 0}, "processes: expected a number >= 1, found 0"),
        ({"quantities": ["speed"]}, "found 'speed'; .*use a name in .columns, or .t for the times"),
        (
            {"model": lambda: None, "processes": 2},
            "model: expected a function at the level of a module.*pickle",
        ),
    ],
)
def test_wrong_arguments_are_refused(dae, arguments, words):
    given = {"model": dae, "starts": {}, "inputs": rates(4), "t": T} | arguments
    if callable(given["model"]):
        given["model"] = lambda: dae
    refuses(sf.ModelError, words, sf.rollouts, **given)


@pytest.mark.filterwarnings("ignore:slower:UserWarning")
def test_runs_at_absurd_speeds_end_by_name(dae):
    inputs = {"right_rate": np.array([[1e9], [0.5]]), "left_rate": 0.5, "steer_rate": 0.0}
    found = sf.rollouts(dae, {"heading": 0.3}, inputs, np.linspace(0, 1, 3), method="batch")
    assert found["outcome"].values.tolist() == ["solver_failure", "complete"]
    assert "at most 20000 steps of" in found["reason"].values[0]


# Poses at rest


@pytest.fixture(scope="module")
def hilly():
    return direct_kinematics(three_wheeler(), Analytic(hills))


@pytest.mark.slow
def test_vehicles_settle_on_ground_that_is_rougher_than_their_wheels_as_many_do(rng):
    axis = np.arange(0, 4.01, 0.05)
    z = 0.1 * np.sin(axis)[:, None] * np.cos(axis) + rng.normal(0, 0.01, (axis.size, axis.size))
    dae = direct_kinematics(rigid_skid_steer(), sf.Bicubic(sf.Grid(axis, axis, z)))
    places = dict(zip("xy", rng.uniform(1, 3, (2, 8)), strict=True))
    heights = sf.settle_many(dae, **places, compiled=False)["z"].values
    found = [settle(dae, x=x, y=y)["z"][0] for x, y in zip(*places.values(), strict=True)]
    assert_allclose(found, heights, rtol=0, atol=1e-2)  # there may be several rests


@pytest.mark.slow
def test_poor_starts_settle_to_the_right_root(hilly, rng):
    """The explicit closure has no root with a wheel under the ground."""
    for _ in range(20):
        x, y, heading = *rng.uniform(-3, 3, 2), rng.uniform(-np.pi, np.pi)
        nominal = settle(hilly, x=x, y=y, heading=heading)
        guess = {name: nominal[name][0] + rng.uniform(-0.4, 0.4) for name in ("roll", "pitch")}
        guess["z"] = nominal["z"][0] + rng.uniform(-0.2, 0.2)
        for wheel in nominal.wheels:
            for name in ("contact_x", "contact_y"):
                guess[f"{name}[{wheel}]"] = nominal[name, wheel][0] + rng.uniform(-0.2, 0.2)
        found = settle(hilly, guess=guess, x=x, y=y, heading=heading)
        for name in ("z", "roll", "pitch"):
            assert_allclose(found[name], nominal[name], atol=1e-10)
        ground = Analytic(hills).elevation(found["center_x"], found["center_y"])
        assert (found["center_z"] > ground).all()
        assert found["closure_residual"][0] < 1e-12


def test_stands_at_rest(hilly):
    run = settle(hilly, x=0.3, heading=1.0, tilt_right=0.1)
    assert run["tilt_right"][0] == 0.1
    assert_allclose([run[f"velocity_{axis}"][0] for axis in "xyz"], 0, atol=1e-15)


def test_plane_is_exact():
    """On a plane a level vehicle lies parallel to it, a rolling radius above."""
    slope = 0.25
    dae = direct_kinematics(three_wheeler(), Analytic(lambda _, y: slope * y))
    run = settle(dae, x=2.0, y=1.0)
    wanted = np.arctan(slope), 0.0, slope * 1.0 + 0.3 * np.hypot(1, slope)
    assert_allclose([run[n][0] for n in ("pitch", "roll", "z")], wanted, rtol=0, atol=1e-13)
    assert_allclose(run["uprightness"][0], 1, atol=1e-12)


PIT = Analytic(lambda x, y: -0.4 * ca.exp(-((x - 1) ** 2 + (y + 0.5) ** 2) / 0.05))


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ({"azimuth": 0.1}, "start: expected values only for 'x', 'y', .*, found the unknown 'azim"),
        ({"guess": {"height": 1.0}}, "guess: expected names of unknowns of the model, z, roll"),
        ({"x": np.nan}, "x: expected a number, found float nan"),
        ({"tilt_left": 0.3}, r"tilt_left .* its stop: 17.19, allowed -11.4592 to 11.4592 deg"),
        ({"x": 4.5}, r"wheel right leaves the map.*-0\.49\d*, allowed at least 0 m"),
    ],
)
def test_starts_that_are_none_are_refused(start, words):
    ground = Analytic(hills, (-5.0, 5.0, -5.0, 5.0))
    dae = direct_kinematics(three_wheeler(tilt_stop=0.2), ground)
    refuses(ModelError, words, settle, dae, **start)


def test_a_wheel_stands_on_the_rim_of_a_pit_and_is_refused_upside_down(hilly):
    run = settle(direct_kinematics(three_wheeler(), PIT))
    assert run["clearance", "right"][0] >= 0
    words = r"tilt_right .* reaches its stop: .* allowed -85.9437 to 85.9437 deg"
    refuses(ModelError, words, settle, hilly, tilt_right=3.2)


def test_uprightness_of_a_tilted_wheel():
    """The sine of axle to normal, with the pitch by which the lowered rear end tips the axle."""
    dae = direct_kinematics(three_wheeler(tilt_stop=2.0), Analytic(lambda x, _: 0 * x))
    for tilt in (0.0, 1.2, 1.56):
        run = settle(dae, tilt_right=tilt, tilt_left=tilt)
        expected = np.sqrt(1 - (np.sin(tilt) * np.cos(run["pitch"][0])) ** 2)
        assert_allclose(run["uprightness", "right"][0], expected, atol=1e-12)
