"""Tests of the integrator on small systems with known solutions, and of its endings."""

from dataclasses import replace
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from helpers.cases import PAPER_RATES, case1, hills
from helpers.commands import refuses
from helpers.toy_models import Values, toy
from slipfree import (
    Analytic,
    Bicubic,
    Grid,
    ModelError,
    SolverError,
    SolverOptions,
    catalog,
    direct_kinematics,
    settle,
    simulate,
)
from slipfree.catalog import three_wheeler
from slipfree.core.dae import LIMIT_ROUNDING, Limit, PiecewiseLinear
from slipfree.core.records import Label, symbols
from slipfree.core.trajectory import Outcome, joined
from slipfree.solve import integrator
from slipfree.solve import simulate as module
from slipfree.solve.simulate import Event
from slipfree.solve.system import _with_numbers as with_numbers


def model(rate_of, low=-np.inf, high=np.inf):
    """x0' = rate_of(t, x, u) within limits, and the time as a quadrature."""
    dae = toy(1, lambda t, x, _z, u: [rate_of(t, x[0], u)])
    q = Values((Label("elapsed", "s", "time"),))
    wall = Limit(Label("wall", "m", "the wall is reached"), dae.x.values[0], low, high)
    return replace(
        dae, q=symbols(q), quad=ca.SX(1), labels=dae.labels._replace(q=q), limits=(wall,)
    )


def follows_input():
    return model(lambda _t, _x, u: u)


T = np.linspace(0, 2, 21)
LIGHT = three_wheeler(mass=0.0, wheel_mass=0.0)


def test_decay_is_analytic():
    dae = model(lambda _t, x, u: u - x)
    run = simulate(dae, settle(dae, x0=3.0), dae.inputs(drive=1.0), T)
    assert_allclose(run["x0"], 1 + 2 * np.exp(-T), atol=1e-7)
    assert_allclose(run["square"], run["x0"] ** 2, atol=1e-14)
    assert_allclose(run["elapsed"], T, atol=1e-12)
    assert run.stop is None


def test_inputs_constant_piecewise_of_time_and_of_state():
    dae = follows_input()
    start = settle(dae, x0=1.0)
    steps = np.repeat([1.0, -1.0], 10)
    ramp = np.concatenate([[0], np.cumsum(steps) * 0.1])
    expected = {
        "constant": (0.5, 1 + 0.5 * T),
        "piecewise": (steps, 1 + ramp),
        "of time": (ca.cos(dae.t), 1 + np.sin(T)),
        "of state": (-dae.x.values[0], np.exp(-T)),
        "of unknowns": (-dae.z.values[0], 1 / (1 + T)),
    }
    for name, (law, solution) in expected.items():
        run = simulate(dae, start, dae.inputs(drive=law), T)
        assert_allclose(run["x0"], solution, atol=1e-6, err_msg=name)
        rate = np.gradient(solution, T)[5]
        assert_allclose(run["drive"][5], rate, atol=6e-3, err_msg=name)


def test_a_run_continues_another():
    dae = follows_input()
    first = simulate(dae, settle(dae), dae.inputs(drive=1.0), T)
    second = simulate(dae, first, dae.inputs(drive=2.0), T + 2)
    assert_allclose(second["x0"], 2 + 2 * T, atol=1e-7)
    assert_allclose(second["elapsed"], 2 + T, atol=1e-10)


def test_limit_ends_the_motion_at_the_crossing():
    dae = model(lambda _t, _x, u: u, high=0.9)
    run = simulate(dae, settle(dae), dae.inputs(drive=ca.cos(dae.t)), np.linspace(0, 3, 7))
    assert run.stop.name == "wall"
    assert run.stop.words == "the wall is reached: 0.9, allowed at most 0.9 m"
    assert_allclose(run.t[-1], np.arcsin(0.9), atol=2e-6)
    dae = model(lambda _t, _x, u: u, 0.0, 0.77)
    run = simulate(dae, settle(dae), dae.inputs(drive=1.0), np.linspace(0, 3, 7))
    assert_allclose([run.t[-1], run.stop.t], 0.77, atol=2e-6)
    assert run["x0"][-1] <= 0.77 + LIMIT_ROUNDING
    assert_array_equal(run.t[:-1], [0.0, 0.5])
    refuses(ModelError, r"the wall is reached: 2, allowed 0 to 0\.77 m", settle, dae, x0=2.0)


@pytest.mark.parametrize("start", [0.9, 0.9 + 1e-12])
def test_motion_rests_at_a_limit_and_returns(start):
    dae = model(lambda _t, _x, u: u, -0.9, 0.9)
    rest = simulate(dae, settle(dae, x0=start), dae.inputs(drive=0.0), T)
    assert rest.stop is None
    away = simulate(dae, settle(dae, x0=start), dae.inputs(drive=-1.8 / T[-1]), T)
    assert away.stop is None  # at the other wall
    assert_allclose(away["x0"][-1], -0.9, atol=1e-9)


def test_failure_keeps_what_was_reached(capfd):
    """X' = x^2 escapes to infinity at t = 1.

    The integrator's last step is so near to it that six digits of its time say 1.
    """
    dae = model(lambda _t, x, _u: x**2)
    with pytest.raises(SolverError, match=r"integrator stopped at t = (1|0\.9\d*) s") as failure:
        simulate(dae, settle(dae, x0=1.0), dae.inputs(drive=0.0), np.linspace(0, 2, 101))
    reached = failure.value.trajectory
    assert reached.stop.name == "solver"
    assert reached.outcome is Outcome.SOLVER_FAILURE
    assert 0.999 < reached.t[-1] < 1 + 1e-6
    early = reached.t < 0.99  # the error grows without bound as well
    assert_allclose(reached["x0"][early], 1 / (1 - reached.t[early]), rtol=1e-4)
    assert capfd.readouterr().err == ""


def test_times_tolerances_and_inputs_are_checked():
    dae = follows_input()
    start = settle(dae)
    for t, words in (
        ([0.0], r"at least two times in seconds, found shape \(1,\)"),
        ([0.0, 0.0], r"found t\[1\] = 0 s after 0 s"),
        ([np.nan, 1.0], r"found t\[0\] = nan s; correct"),
        ([[0.0, 1.0]], r"found shape \(1, 2\)"),
    ):
        refuses(ModelError, words, simulate, dae, start, dae.inputs(drive=0.0), np.array(t))
    for tolerance in (0.0, 0.02, np.nan):
        words = r"tolerance: expected a number( >= 1e-14| <= 0.01|, found float nan)"
        refuses(ModelError, words, SolverOptions, tolerance=tolerance)
    words = r"inputs: expected .* 'drive', found the unknown 'pace' and no value for 'drive'"
    refuses(ModelError, words, dae.inputs, pace=1.0)
    for value, words in (
        (np.zeros(7), "one value for each of the 20 intervals between samples, found shape"),
        (np.nan, "expected finite numbers"),
        (dae.u.values[0] * 2, "found one that contains inputs"),
        (ca.SX.sym("q"), "expected an expression of the symbols .*, found the symbol 'q'"),
        (ca.SX(2, 1), "expected a scalar expression"),
        ("fast", "expected real numbers or an SX expression"),
    ):
        refuses(ModelError, words, simulate, dae, start, dae.inputs(drive=value), T)


def test_mismatched_equations_are_refused():
    dae = follows_input()
    again = dae.labels._replace(u=Values((Label("x0", "m", "again"),)))
    for change, words in (
        ({"ode": ca.SX.zeros(2)}, r"ode: expected a column of 1 expressions, .* shape \(2, 1\)"),
        ({"alg": (*dae.alg, ca.SX.zeros(0, 1))}, "for each of the 1 fields of z, found 2"),
        ({"labels": again}, "found 'x0' more than once; rename a coordinate"),
    ):
        refuses(ModelError, words, replace, dae, **change)


def test_progress_does_not_change_the_motion():
    terrain, reference = case1()
    dae = direct_kinematics(three_wheeler(), terrain)
    start, seen = settle(dae), []
    plain = simulate(dae, start, dae.inputs(**PAPER_RATES), reference["t"])
    watched = simulate(dae, start, dae.inputs(**PAPER_RATES), reference["t"], progress=seen.append)
    for name in plain:
        assert_array_equal(plain[name], watched[name], err_msg=name)
    assert seen[-1] > 5.5
    assert len(seen) < 2 * plain.statistics["steps"] + 10


def test_progress_ascends_although_calls_are_repeated():
    """Here after jumps of the input and up to a limit, over several chunks of samples."""
    dae = model(lambda _t, _x, u: u, high=2.5)
    rates, seen = np.repeat([1.0, -1.0, 2.0, 1.0], 1250), []
    t = np.linspace(0, 8, 5001)
    run = simulate(dae, settle(dae), dae.inputs(drive=rates), t, progress=seen.append)
    assert run.stop.name == "wall"
    assert_allclose(run.t[-1], 5.25, atol=1e-5)
    assert (np.diff(seen) > 0).all()
    assert seen[-1] >= run.t[-1]


@pytest.mark.parametrize("kind", [bool, np.bool_])
def test_progress_that_returns_false_ends_the_motion(kind):
    dae, seen = follows_input(), []

    def progress(t):
        seen.append(t)
        return kind(t < 1.23)

    inputs = dae.inputs(drive=ca.cos(dae.t))
    run = simulate(dae, settle(dae), inputs, T, progress=progress)
    words = "Ctrl-C or the progress callable ended the integration"
    assert run.stop == ("interrupted", seen[-1], words, Outcome.INTERRUPTED)
    assert 1.23 <= run.t[-1] == seen[-1] < 1.5
    assert_allclose(run["x0"], np.sin(run.t), atol=1e-7)
    assert_array_equal(run.t[:-1], T[: run.t.size - 1])
    assert run.statistics["steps"] > 10


def test_event_of_a_linear_motion():
    dae = follows_input()
    t, x = np.arange(0, 2.01, 0.5), dae.x.values[0]
    events = [
        Event(x - 0.77, name="rising"),
        Event(0.77 - x, name="falling"),
        Event(dae.t - 1.5, name="on a sample"),
        Event(dae.z.values[0] - 0.25, name="of an unknown"),
        Event(x - 5.0, name="never"),
        Event(x, name="at the start"),
    ]
    run = simulate(dae, settle(dae), dae.inputs(drive=1.0), t, events=events)
    assert run.stop is None
    assert_array_equal(run.t, t)
    expected = ([0.77], [0.77], [1.5], [0.5], [], [])
    assert list(run.events) == [event.name for event in events]
    for times, closed in zip(run.events.values(), expected, strict=True):
        assert_allclose(times, closed, atol=1e-8)
    law = dae.inputs(drive=np.repeat([1.0, -0.3], 10))  # at a jump of an input
    run = simulate(dae, settle(dae), law, T, events=[Event(dae.u.values[0])])
    assert_allclose(run.events["event"], [1.0], atol=1e-12)


def test_every_crossing_of_an_oscillation_is_found():
    dae = follows_input()
    t, law = np.linspace(0, 10, 101), dae.inputs(drive=ca.cos(3 * dae.t))
    event = Event(dae.x.values[0], name="zero")
    run = simulate(dae, settle(dae), law, t, options=SolverOptions(tolerance=1e-10), events=[event])
    assert_allclose(run.events["zero"], np.arange(1, 10) * np.pi / 3, atol=1e-8)
    part = run.part(slice(20, 61))
    assert_allclose(part.events["zero"], np.arange(2, 6) * np.pi / 3, atol=1e-8)
    again = joined(run.part(slice(50)), run.part(slice(50, None)))
    assert_array_equal(again.events["zero"], run.events["zero"])


def test_motion_ends_at_an_event_that_stops_it_and_goes_on_from_there():
    dae = follows_input()
    t, law = np.linspace(0, 3, 7), dae.inputs(drive=ca.cos(dae.t))
    stop = Event(dae.x.values[0] - 0.9, stop=True, name="far")
    half = Event(dae.x.values[0] - 0.5, name="half")
    later = Event(dae.t - 1.4, name="later")  # within the interval in which the motion ends
    start = settle(dae)
    run = simulate(dae, start, law, t, events=[later, stop, half])
    assert run.stop == ("far", run.t[-1], "the event 'far' occurred", Outcome.COMPLETE)
    assert_allclose(run.t, [0.0, 0.5, 1.0, np.arcsin(0.9)], atol=1e-7)
    assert_allclose(run["x0"][-1], 0.9, atol=1e-12)
    assert_allclose(run["square"][-1], 0.81, atol=1e-12)
    assert_allclose(run.events["far"], run.t[-1:], atol=0)
    assert_allclose(run.events["half"], [np.pi / 6], atol=1e-7)
    assert run.events["later"].size == 0
    rest = simulate(dae, run, law, np.linspace(run.t[-1], 3, 7), events=[stop])
    assert rest.stop.name == "far"  # on the way back
    assert rest.outcome is Outcome.COMPLETE
    assert_allclose(rest.t[-1], np.pi - np.arcsin(0.9), atol=1e-6)


@pytest.mark.parametrize(("place", "name"), [(0.8, "passed"), (0.95, "wall")])
def test_the_earlier_one_of_event_and_limit_ends_the_motion(place, name):
    """Both lie between the same two samples."""
    dae = model(lambda _t, _x, u: u, high=0.9)
    event = Event(dae.x.values[0] - place, stop=True, name="passed")
    run = simulate(dae, settle(dae), dae.inputs(drive=1.0), np.linspace(0, 3, 4), events=[event])
    assert run.stop.name == name
    assert_allclose(run.t[-1], min(place, 0.9), atol=2e-6)
    assert run.events["passed"].size == (name == "passed")


def test_event_of_a_vehicle_is_where_a_limit_would_be():
    """Here on a ground that is looked up."""
    terrain, reference = case1()
    stopped = direct_kinematics(three_wheeler(tilt_stop=0.2), terrain)
    free = direct_kinematics(three_wheeler(), terrain)
    end = simulate(stopped, settle(stopped), stopped.inputs(**PAPER_RATES), reference["t"])
    assert end.stop.name == "tilt_right_stop"
    curvature = next(each for each in free.limits if each.label.full == "relative_curvature[right]")
    events = [
        Event(free.named("tilt_right")[0] - end["tilt_right"][-1], name="tilt"),
        Event(curvature.expression - end.of(curvature.label)[-1], name="curvature"),
    ]
    run = simulate(free, settle(free), free.inputs(**PAPER_RATES), reference["t"], events=events)
    assert_allclose(run.events["tilt"], end.t[-1:], atol=1e-6)
    assert np.abs(run.events["curvature"] - end.t[-1]).min() < 1e-6


def test_events_are_checked():
    dae = model(lambda _t, _x, u: u, -9.0, 9.0)
    x, start = dae.x.values[0], settle(dae)
    for events, words in (
        ([Event(x), Event(x - 1)], "found 'event' twice; rename the event"),
        ([Event(x, name="wall")], "found 'wall' twice; rename the event"),
        ([Event(ca.vertcat(x, x))], "expected a scalar SX"),
        ([Event(1.0)], "expected a scalar SX, found 1.0"),
        ([Event(x - ca.SX.sym("q"))], "event 'event': expected .*, found the symbol 'q'"),
    ):
        refuses(ModelError, words, simulate, dae, start, dae.inputs(drive=1.0), T, events=events)


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError])
def test_any_exception_of_the_progress_comes_through(error):
    dae = follows_input()

    def fail(_t):
        raise error("mine")

    with pytest.raises(error, match="mine"):
        simulate(dae, settle(dae), dae.inputs(drive=ca.cos(dae.t)), T, progress=fail)


def test_a_limit_is_named_even_if_the_integrator_fails_behind_it():
    """x' = x^2 crosses 50 at t = 0.98 and fails at 1, both within the first coarse sample."""
    dae = model(lambda _t, x, _u: x**2, high=50.0)
    run = simulate(dae, settle(dae, x0=1.0), dae.inputs(drive=0.0), np.array([0.0, 5.0, 10.0]))
    assert run.stop.name == "wall"
    assert_allclose(run.t[-1], 0.98, atol=1e-5)


def test_fold_of_a_contact_ends_the_motion_by_its_name():
    """A contact that jumps makes the equations singular: IDAS fails before a sample lies beyond."""
    x, rng = np.linspace(-3, 3, 161), np.random.default_rng(3)
    z = np.zeros((x.size, x.size))
    for _ in range(24):
        k = 2 * np.pi / rng.uniform(0.153, 0.548)
        a, phase = rng.uniform(0, 2 * np.pi), rng.uniform(0, 7)
        z += 0.00614 * np.cos(k * (np.cos(a) * x[:, None] + np.sin(a) * x) + phase)
    dae = direct_kinematics(catalog.skid_steer(), Bicubic(Grid(x, x, z)))
    rates = dae.inputs(**{label.full: 1.5 for label in dae.labels.u.wheels})
    run = simulate(dae, settle(dae, x=0.1, y=0.2, heading=0.5), rates, np.linspace(0, 2, 81))
    assert run.stop.name == "relative_curvature[front_left]"
    assert run["relative_curvature", "front_left"][-1] == pytest.approx(0, abs=1e-3)
    assert run["relative_curvature", "front_left"][0] > 1


def test_lift_off_ends_the_motion_by_its_name_where_forces_become_singular():
    """A force distribution by loads fails shortly before a load is zero."""
    trough = Analytic(lambda x, y: 0.1405 * ca.cos(2 * np.pi / 0.8 * y) + 0 * x)
    dae = direct_kinematics(catalog.ackermann(), trough)
    rates = dae.inputs(rear_right_rate=1.5, rear_left_rate=1.5, steer_rate=0.0)
    run = simulate(dae, settle(dae), rates, np.linspace(0, 2, 81))
    assert run.stop.name.startswith("lift_off")
    assert run["force_normal"][-1].min() < 1e-3 * run["force_normal"][0].min()


def test_an_unknown_quantity_is_refused():
    dae = direct_kinematics(three_wheeler(), Analytic(hills))
    run = settle(dae)
    with pytest.raises(ModelError, match=r"found 'speed'; .*use a name in .columns, or .t for"):
        run["speed"]
    with pytest.raises(ModelError, match=r"'contact_x': expected one of the wheels right.*'rear'"):
        run["contact_x", "rear"]
    assert "heading" in set(run)


def test_a_start_that_the_integrator_rejects_is_made_consistent_and_taken(monkeypatch):
    """As where IDAS's own search fails, though the unknowns are off by the tolerance only."""
    dae = direct_kinematics(LIGHT, Analytic(hills))
    start, t = settle(dae), np.linspace(0, 1, 6)
    inputs = dae.inputs(**PAPER_RATES)
    plain = simulate(dae, start, inputs, t, options=SolverOptions(tolerance=1e-6))
    run_integrator, first = integrator.run_buffered, []

    def rejecting(*given):
        if first:
            return run_integrator(*given)
        first.append(given)
        raise RuntimeError("IDA_LINESEARCH_FAIL")

    monkeypatch.setattr(integrator, "run_buffered", rejecting)
    shifted = module._initial_sample(module.with_inputs(dae, inputs, 5), start, 0.0)
    shifted = shifted._replace(z=shifted.z + 1e-3)
    monkeypatch.setattr(module, "_initial_sample", lambda *_: shifted)
    run = simulate(dae, start, inputs, t, options=SolverOptions(tolerance=1e-6))
    assert first
    for name in ("x", "y", "heading"):
        assert_allclose(run[name], plain[name], atol=1e-5)


def test_the_integrator_takes_the_jacobian_that_it_is_given(monkeypatch):
    """CasADi would say nothing if it expected it under another name, and form its own."""
    dae = direct_kinematics(LIGHT, Analytic(hills))
    start, inputs = settle(dae), dae.inputs(right_rate=0.5, left_rate=0.4, steer_rate=0.0)
    integrator, made = ca.integrator, []

    def watched(*arguments):
        made.append((integrator(*arguments), arguments))
        return made[-1][0]

    monkeypatch.setattr(ca, "integrator", watched)
    simulate(dae, start, inputs, np.linspace(0, 1, 3))
    solver, (*given, options) = made[0]
    own = options.pop("cache")["jacF"]
    assert hash(solver.get_function("jacF")) == hash(own)
    other = integrator(*given, options).get_function("jacF")
    assert hash(other) != hash(own)
    assert (other.name_in(), other.name_out()) == (own.name_in(), own.name_out())
    system = module.with_inputs(dae, inputs, 2)
    z = dae.rows("z", start, -1)[: system.motion_size]
    at = [0.0, dae.rows("x", start, -1), z, [], system.u[:, 0]]
    for one, two in zip(own.call(at), other.call(at), strict=True):
        assert_allclose(np.array(ca.DM(one)), np.array(ca.DM(two)), rtol=1e-12, atol=1e-12)


def test_inputs_that_are_linear_in_time_keep_their_slopes_beside_laws():
    """Wheels whose rates grow with time, one of them by a law that says the same."""
    dae = direct_kinematics(LIGHT, Analytic(hills))
    start, t = settle(dae), np.linspace(0, 1, 5)
    grows = PiecewiseLinear(np.full(4, 0.1), np.full(4, 0.3))
    rates = {"right_rate": grows, "left_rate": grows, "steer_rate": 0.0}
    alone = simulate(dae, start, dae.inputs(**rates), t)
    beside = simulate(dae, start, dae.inputs(**rates | {"left_rate": 0.1 + 0.3 * dae.t}), t)
    assert alone["wheel_angle"][-1, 0] > 0.2
    for name in ("x", "y", "heading", "right_rate", "left_rate"):
        assert_allclose(beside[name], alone[name], atol=1e-7)


def zigzag(times, values):
    """Return a rate that is linear between its values at times, and the way, zero at first."""
    way = np.cumsum(np.diff(times) * (values[1:] + values[:-1]) / 2)
    return PiecewiseLinear.through(times, values), np.append(0.0, way)


def test_kinks_of_inputs_take_no_new_start_and_jumps_do(monkeypatch):
    dae, made, make = follows_input(), [], ca.integrator
    monkeypatch.setattr(ca, "integrator", lambda *args: made.append(args[4]) or make(*args))
    t = np.linspace(10, 13, 31)
    rate, way = zigzag(t, np.random.default_rng(1).uniform(-1, 1, t.size))
    run = simulate(dae, settle(dae), dae.inputs(drive=rate), t)
    assert_allclose(run["x0"], way, rtol=0, atol=1e-7)
    assert_array_equal(*made, t)
    higher = PiecewiseLinear(rate.base + np.where(t[:-1] < 11.05, 0.0, 1e-6), rate.slope)
    simulate(dae, settle(dae), dae.inputs(drive=higher), t)
    assert [(each[0], each[-1]) for each in made[1:]] == [(t[0], t[11]), (t[11], t[-1])]


def test_integrators_are_kept_for_later_calls_and_end_with_their_model(monkeypatch):
    dae, made, make = follows_input(), [], ca.integrator
    monkeypatch.setattr(ca, "integrator", lambda *args: made.append(args[4]) or make(*args))
    t = np.linspace(0, 2, 5)
    monkeypatch.setattr(integrator, "_IDLE", WeakKeyDictionary())
    for rates in ((1.0, 1.0, 2.0, 2.0), (3.0, 3.0, 4.0, 4.0)):
        simulate(dae, settle(dae), dae.inputs(drive=np.array(rates)), t)
        assert integrator.count_idle() == len(made) == 2
    simulate(dae, settle(dae), dae.inputs(drive=-dae.x.values[0]), t)  # a law has its own functions
    assert len(made) == 3
    assert integrator.count_idle() == 2
    monkeypatch.setattr(integrator, "MAX_IDLE", 3)
    other = follows_input()
    simulate(other, settle(other), other.inputs(drive=np.array([1.0, 1.0, 2.0, 2.0])), t)
    assert integrator.count_idle() == 3
    simulate(dae, settle(dae), dae.inputs(drive=1.0), t)
    assert integrator.count_idle() == 3
    with_numbers.cache_clear()
    assert integrator.count_idle() == 0


@pytest.mark.slow
def test_new_starts_after_failures_pass_kinks(monkeypatch):
    """The integrator fails at every second sample: more often than one interval allows."""
    dae, solve = follows_input(), integrator._call_integrator

    def failing(solver, observer, at, t, u):
        if t.size > 3 and t[-1] == 3.0:
            solve(solver, observer, at, t[:3], u[:, :2])
            raise SolverError("none of those")
        return solve(solver, observer, at, t, u)

    t = np.linspace(0, 3, 2 * integrator.MAX_RESTARTS + 21)
    rate, way = zigzag(t, np.random.default_rng(2).uniform(-1, 1, t.size))
    given = dae, settle(dae), dae.inputs(drive=rate), t
    levels = [Event(dae.x.values[0] - at, name=f"way {at}") for at in (way[1:8] + way[:7]) / 2]
    options = SolverOptions(tolerance=1e-10)
    expected = simulate(*given, options=options, events=levels).events
    monkeypatch.setattr(integrator, "_call_integrator", failing)
    run = simulate(*given, options=options, events=levels)
    assert_array_equal(run.t, t)
    assert_allclose(run["x0"], way, rtol=0, atol=1e-7)
    for name, times in expected.items():
        assert_allclose(run.events[name], times, rtol=0, atol=1e-6)
    with pytest.raises(SolverError, match="none of those") as caught:
        simulate(dae, settle(dae), dae.inputs(drive=1.0), t)
    assert 1.5 < caught.value.trajectory.t[-1] < 2.5


@pytest.mark.parametrize(("share", "calls"), [(1.0, 1), (0.2, 2)])
def test_steps_are_bounded_by_the_pace_under_later_inputs(share, calls, monkeypatch):
    """A second call is needed only if the motion is faster than its inputs tell at the start."""
    dae = model(lambda _t, _x, u: u)
    own = dae.u.values[0]
    dae = replace(dae, pace=30 * (share * own + (1 - share) * dae.x.values[0]))
    call, made = integrator.run_buffered, []
    monkeypatch.setattr(integrator, "run_buffered", lambda *a: made.append(call(*a)) or made[-1])
    inputs = dae.inputs(drive=ca.tanh(3 * dae.t))
    run = simulate(dae, settle(dae, x0=0.0), inputs, np.linspace(0, 4, 3))
    assert len(made) == calls
    assert run.statistics["steps"] > 4 * 30 * share
    assert run["x0"][-1] == pytest.approx(np.log(np.cosh(12)) / 3, abs=1e-6)
