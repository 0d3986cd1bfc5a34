"""The batch: exact poses and motions of many lanes, equal to those of settle and simulate."""

from unittest.mock import Mock

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import slipfree as sf
from helpers.cases import PROBLEMS
from slipfree.batch import motion
from slipfree.batch.evaluator import evaluator_of
from slipfree.batch.graph import _sampled_states, graphs_of, state_of
from slipfree.batch.many import run_lanes, solve_positions, start_states, states_of
from slipfree.core.records import leaves
from slipfree.system import codegen_cache
from slipfree.terrain.synthetic import blank, power_law

T = np.linspace(0, 2, 6)
EXACT = sf.SolverOptions(tolerance=1e-10)


@pytest.fixture(scope="module", autouse=True)
def _cache(tmp_path_factory):
    """Share what is compiled with the other processes of the tests."""
    with pytest.MonkeyPatch.context() as patch:
        shared = tmp_path_factory.getbasetemp().parent / "compiled"
        patch.setenv(codegen_cache.FOLDER, str(shared))
        yield


def hills(rms=0.03, shortest=1.0, half=5.0):
    waves = {"rms": rms, "hurst": 0.9, "longest": 4.0, "shortest": shortest, "seed": 3}
    return sf.Bicubic(power_law(blank((-half, half), (-half, half), 0.1), **waves), mu=0.6)


@pytest.fixture(scope="module")
def model(_cache):
    return sf.direct_kinematics(sf.catalog.three_wheeler(), hills())


def rates(count, seed=0, spread=0.02, steer=0.1):
    """Rates that jump at every sample."""
    rng = np.random.default_rng(seed)
    shape = count, T.size - 1
    speed = 0.5 + spread * rng.standard_normal(shape)
    apart = spread * rng.standard_normal(shape)
    return {
        "right_rate": speed + apart,
        "left_rate": speed - apart,
        "steer_rate": steer * rng.standard_normal(shape),
    }


def same_ends(model, starts, inputs, step, tolerance=1e-10, atol=1e-3):
    """Motions of the batch and of `simulate`, which end for the same reasons at the same times."""
    exact = sf.rollouts(model, starts, inputs, T, options=sf.SolverOptions(tolerance=tolerance))
    lanes = sf.rollouts(model, starts, inputs, T, method="batch", step=step)
    assert_array_equal(lanes["outcome"], exact["outcome"])
    assert_allclose(lanes["end"], exact["end"], atol=atol)
    return lanes, exact


def near_the_edge(model, count):
    """Starts from which the front wheel may leave the map within the motion."""
    front = sf.settle(model, y=2.0)["contact_y"].max() - 2.0
    return {"y": np.linspace(4.4, 4.95, count) - front}


@pytest.mark.parametrize("name", ["three_wheeler", "rocky7", "ackermann", "trike"])
@pytest.mark.parametrize("compiled", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_graphs_equal_the_model(name, compiled, rng):
    """Derivatives, rates, forces and limits at perturbed positions are those of `simulate`."""
    own = PROBLEMS / "vehicles" / f"{name}.toml"  # pivots of the trike on the diagonal can vanish
    options = {"steered": "corners"} if name == "rocky7" else {}
    vehicle = sf.read_vehicle(own) if own.exists() else getattr(sf.catalog, name)(**options)
    dae = sf.direct_kinematics(vehicle, hills())
    evaluate = evaluator_of(dae, compiled=compiled)
    graphs = evaluate.graphs
    start = sf.settle(dae, x=0.4, y=-0.3, heading=0.7)
    inputs = dae.inputs(**{label.full: rng.uniform(-0.3, 0.6) for label in leaves(dae.labels.u)})
    run = sf.simulate(dae, start, inputs, np.linspace(0, 1e-6, 2), options=EXACT)
    states = np.zeros((graphs.rows.t.stop, 3))
    for part, record in ((graphs.rows.x, "x"), (graphs.rows.u, "u")):
        states[part] = dae.rows(record, run, 0)[:, None]
    z = dae.rows("z", run, 0)
    states[graphs.rows.p] = z[: graphs.rows.p.stop - graphs.rows.p.start, None]
    states[graphs.rows.p] += 1e-7 * rng.standard_normal(states[graphs.rows.p].shape)
    states[graphs.rows.f] = evaluate(graphs.guess, states)[graphs.guess.parts[2]]
    for _ in range(4):  # Newton steps of the forces
        values = evaluate(graphs.checked, states)
        parts = [values[part] for part in graphs.checked.parts]
        for part, values in zip(graphs.rows.z, (parts[1], parts[2], parts[6]), strict=True):
            states[part] = values
    assert_allclose(np.concatenate([parts[1], parts[2], parts[6]])[:, 0], z, atol=2e-8)
    margins = [
        sign * (run.of(limit.label)[0] - bound) / dae.size_of(limit.label)
        for limit in dae.limits
        for bound, sign in ((limit.lower, 1), (limit.upper, -1))
        if np.isfinite(bound)
    ]
    assert_allclose(parts[8][:, 0], margins, atol=1e-6, rtol=1e-6)
    outputs = evaluate(graphs.outputs, states)
    assert_allclose(outputs[:, 0], [run.of(label)[0] for label in leaves(dae.labels.y)], atol=1e-6)


def test_compiled_and_interpreted_graphs_agree(model, rng):
    compiled, interpreted = evaluator_of(model), evaluator_of(model, compiled=False)
    graphs = compiled.graphs
    states = start_states(graphs, {"heading": rng.uniform(-9, 9, 37), "x": rng.uniform(-3, 3, 37)})
    states[graphs.rows.u] = rng.uniform(-1, 1, states[graphs.rows.u].shape)
    solve_positions(compiled, states)
    for graph in (graphs.guess, graphs.place, graphs.motion, graphs.checked, graphs.outputs):
        assert_allclose(compiled(graph, states), interpreted(graph, states), rtol=1e-10, atol=1e-11)


def test_states_at_which_pivots_are_chosen_do_not_depend_on_other_rows(model):
    """Their numbers are those of names, and the first is a level start."""
    rows, state = (graphs := graphs_of(model)).rows, graphs.state
    pairs = (rows, state), state_of(model, tuple(state[part] for part in rows.z), 9, 0)
    drawn = [np.delete(_sampled_states(model, s, r), np.r_[r.q, r.v], 0) for r, s in pairs]
    assert_array_equal(*drawn)
    assert not drawn[0][rows.x, 0].any()


@pytest.mark.slow
def test_compiled_graphs_are_in_the_private_cache_of_all_equations(model, tmp_path, monkeypatch):
    monkeypatch.setenv(codegen_cache.FOLDER, str(tmp_path / "own"))
    evaluator_of.cache_clear()
    evaluate = evaluator_of(model)
    evaluate(evaluate.graphs.place, start_states(evaluate.graphs, {"x": np.zeros(5)}))
    (library,) = (tmp_path / "own").glob("*.so")
    assert library.stat().st_mode & 0o077 == 0


def test_poses_equal_those_of_settle(model, rng):
    places = dict(zip("xy", rng.uniform(-3, 3, (2, 12)), strict=True))
    places["heading"] = rng.uniform(-3, 3, 12)
    poses = sf.settle_many(model, **places, quantities=["z", "contact_x", "center_z", "roll"])
    assert (poses["outcome"] == "complete").all()
    assert poses["contact_x"].dims == ("pose", "wheel")
    assert poses["z"].attrs["units"] == "m"
    for k in range(12):
        start = sf.settle(model, **{name: values[k] for name, values in places.items()})
        for name in poses.data_vars:
            if name in start.columns:
                assert_allclose(poses[name][k], start[name][0], atol=1e-12)


@pytest.mark.parametrize(
    "vehicle", [sf.catalog.three_wheeler(axle="fixed"), sf.catalog.rigid_skid_steer()]
)
def test_rests_on_ground_rougher_than_wheels_are_found_and_penetrate_nowhere(vehicle, rng):
    """One is beyond the edge of the map, and one at the edge, where a reason is named."""
    ground, edge = hills(0.1, 0.2, 4.0), {"x": [3.9, 9.0], "y": [0.0, 0.0], "heading": [0.0, 0.0]}
    places = {k: np.append(rng.uniform(-2.5, 2.5, 200), edge[k]) for k in edge}
    dae = sf.direct_kinematics(vehicle, ground)
    depths = ["depth"] if dae.rest.numel() else []  # of pressed wheels
    names = [f"{k}_{a}" for k, axes in (("quaternion", "xyzw"), ("center", "xyz")) for a in axes]
    poses = sf.settle_many(dae, **places, quantities=[*names, "force_normal", *depths])
    # a rest may violate limits of forces
    found = [not r or "lifts off" in r for r in poses["reason"].values]
    assert poses["outcome"][-1] == "failed"
    assert all(poses["reason"].values[-2:])
    assert ((poses["outcome"] == "complete") == (poses["reason"] == "")).all()
    assert np.isnan(poses["quaternion_x"].values[poses["outcome"] == "failed"]).all()
    assert np.mean(found) > 0.98
    poses = poses.isel(pose=np.flatnonzero(found))
    assert np.isfinite(poses["force_normal"]).all()
    u, v = np.mgrid[0 : 2 * np.pi : 40j, 0 : 2 * np.pi : 240j].reshape(2, -1)
    torus = vehicle.wheels[0].section
    rho, across = torus.r2 + torus.r1 * np.sin(u), torus.r1 * np.cos(u)
    tread = np.array([rho * np.cos(v), across, rho * np.sin(v)])  # forward, left, up
    turned = Rotation.from_quat(np.array([poses[k] for k in names[:4]]).T).as_matrix() @ tread
    centers = np.array([poses[k] for k in names[4:]])[:, :, :2]  # wheels that do not steer
    px, py, pz = centers[..., None] + turned.transpose(1, 0, 2)[:, :, None]
    deep = 2 * poses["depth"].values[:, :2].clip(0.0) if depths else np.zeros(px.shape[:2])
    assert (pz > ground.elevation(px, py) - 1e-5 - deep[..., None]).all()


def test_motions_converge_with_third_order(model, monkeypatch):
    """On mild ground, compiled code certifies all samples by bounds of the ground."""
    spy = Mock(wraps=motion.clearances)
    monkeypatch.setattr(motion, "clearances", spy)
    inputs, starts = rates(4), {"heading": np.linspace(0, 1.5, 4)}
    exact = sf.rollouts(model, starts, inputs, T, options=EXACT)
    errors = []
    for step in (0.04, 0.01):
        lanes = sf.rollouts(model, starts, inputs, T, method="batch", step=step)
        assert (lanes["outcome"] == "complete").all()
        apart = np.hypot(*((lanes[name] - exact[name]).values[:, -1] for name in "xy"))
        errors.append(np.median(apart))
    spy.assert_not_called()
    assert errors[1] < 1e-7
    assert errors[0] / errors[1] > 4**2.3
    for name in ("slip_along", "force_normal", "wheel_angle", "z", "psi", "velocity_x"):
        assert_allclose(lanes[name], exact[name], atol=2e-4, rtol=2e-4, err_msg=name)


def test_the_default_step_resolves_the_swing_of_a_caster():
    """On a level plane, the tangent of half its angle decreases by exp(-path / trail)."""
    dae = sf.direct_kinematics(
        sf.catalog.differential_drive(trail=0.03), sf.Analytic(lambda x, _: 0 * x)
    )
    t, inputs = np.linspace(0, 1, 11), {"left_rate": 4.0, "right_rate": 4.0}
    lanes = sf.rollouts(dae, {"caster_angle": np.array([0.3, 1.5])}, inputs, t, method="batch")
    tangent = np.tan(np.array([[0.15], [0.75]])) * np.exp(-4.0 * 0.15 * t / 0.03)
    assert_allclose(lanes["caster_angle"], 2 * np.arctan(tangent), atol=3e-3)


def test_estimates_have_the_size_of_the_errors(model):
    inputs = rates(24, seed=2)
    both = (sf.rollouts(model, {}, inputs, T, method="batch", step=h) for h in (0.04, 0.005))
    coarse, fine = both
    ratio = coarse["error"] / np.hypot(*((coarse[n] - fine[n])[:, -1] for n in "xy"))
    assert np.mean((ratio > 0.3) & (ratio < 3)) > 0.95
    for name in ("x", "y", "heading", "tilt_right", "tilt_left"):
        error = np.abs(coarse[name] - fine[name]).values[:, -1]
        assert 0.5 < np.median(coarse[f"error_{name}"].values / error) < 2, name


def test_results_do_not_depend_on_order_or_company(model):
    """The driver in C and its specification in Python agree to rounding."""
    count = 21
    inputs = rates(count, spread=0.2, steer=0.4)
    array = np.stack([inputs[label.full].T for label in leaves(model.labels.u)])
    states = start_states(evaluator_of(model).graphs, near_the_edge(model, count))

    def motions(order, **options):
        part = run_lanes(evaluator_of(model, **options), states[:, order], array[..., order], T)
        columns = [column.values for column in part.columns.values()]
        complete = np.where(np.array(part.outcomes) == "limit", 0.0, 1.0)
        return [*columns, part.end, part.error, complete, np.array(part.reasons)]

    whole = motions(np.arange(count))
    assert set(whole[-2]) == {0.0, 1.0}
    for order in (back := np.arange(count)[::-1], np.arange(5)):
        for one, other in zip(motions(order), whole, strict=True):
            assert_array_equal(one, other[order])
    for options in ({"lanes": 1}, {"compiled": False}):
        for one, other in zip(motions(back, **options)[:-1], whole[:-1], strict=True):
            assert_allclose(one, other[back], rtol=1e-9, atol=1e-9)


def test_motions_end_at_the_limits_of_simulate(model):
    inputs = rates(12, spread=0.2, steer=0.5, seed=4)
    lanes, exact = same_ends(model, near_the_edge(model, 12), inputs, 0.1)
    assert {"complete", "limit"} <= set(exact["outcome"].values)
    for mine, other in zip(lanes["reason"].values, exact["reason"].values, strict=True):
        assert mine.split(":")[0] == other.split(":")[0]
    assert_array_equal(np.isnan(lanes["x"]), np.isnan(exact["x"]))


def test_a_second_contact_ends_a_motion_as_in_simulate():
    """The clearance of a wheel ends a lane at the same time as in `simulate`."""
    axis = np.linspace(-4, 4, 161)
    ledge = 0.12 / (1 + np.exp(-(axis - 1.4) / 0.02))
    grid = sf.Grid(axis, axis, np.tile(ledge, (axis.size, 1)))
    dae = sf.direct_kinematics(sf.catalog.three_wheeler(), sf.Bicubic(grid))
    inputs = {"right_rate": 0.5, "left_rate": 0.5, "steer_rate": np.array([[0.0], [0.1]])}
    _, exact = same_ends(dae, {}, inputs, 0.05)
    assert set(exact["outcome"].values) == {"limit"}


def test_pressed_wheels_relax_as_in_simulate():
    """Poses at rest are those of `settle`; motions converge with first order."""
    dae = sf.direct_kinematics(sf.catalog.rigid_skid_steer(), hills(rms=0.02, shortest=1.5))
    evaluate = evaluator_of(dae, compiled=False)
    poses = sf.settle_many(dae, y=[0.0, 1.0], heading=0.3, compiled=False)
    starts = [sf.settle(dae, y=y, heading=0.3) for y in (0.0, 1.0)]
    for name in ("z", "roll", "pitch"):
        assert_allclose(poses[name], [start[name][0] for start in starts], atol=1e-10)
    t = np.linspace(0, 1, 3)
    left, right = np.array([[[6.0, 4.0], [3.0, 5.0]], [[5.0, 6.0], [5.0, 2.0]]])
    inputs = {name: left if "left" in name else right for name in dae.input_names}
    exact = sf.rollouts(dae, starts, inputs, t, options=sf.SolverOptions(tolerance=1e-8))
    array = np.stack([inputs[label.full].T for label in leaves(dae.labels.u)])
    states = np.stack([states_of(evaluate.graphs, start) for start in starts], axis=1)
    errors = []
    for step in (0.02, 0.005):
        lanes = run_lanes(evaluate, states, array, t, step=step, placed=True)
        names = [label.full for label in leaves(dae.labels.x)]
        apart = [lanes.columns[name].values[:, -1] - exact[name].values[:, -1] for name in names]
        errors.append(np.hypot(*apart[:2]))
        ratio = np.abs([lanes.columns[f"error_{name}"].values for name in names] / np.array(apart))
        assert np.mean((ratio > 0.25) & (ratio < 4)) > 0.9
    assert (errors[1] < 2e-4).all()
    assert np.median(errors[0] / errors[1]) > 2
    lanes = run_lanes(evaluate, states, array, t, placed=True)
    for name in ("pitch_rate", "roll_rate", "velocity_z", "heading_rate"):
        found, known = lanes.columns[name].values, exact[name].values
        assert_allclose(found, known, atol=0.01 * np.abs(known).max(), err_msg=name)


def test_friction_is_solved_without_continuation():
    """Quasi-static motions equal those of `simulate`, also just after jumps of the inputs."""
    vehicle = sf.catalog.three_wheeler(axle="fixed")
    dae = sf.quasi_statics(vehicle, hills(rms=0.05), law=sf.Coulomb(1e-3))
    evaluate = evaluator_of(dae, compiled=False)
    inputs, start = rates(2, spread=0.1), sf.settle(dae)
    exact = sf.rollouts(dae, start, inputs, T, options=sf.SolverOptions(tolerance=1e-9))
    array = np.stack([inputs[label.full].T for label in leaves(dae.labels.u)])
    states = np.repeat(states_of(evaluate.graphs, start)[:, None], 2, axis=1)
    lanes = run_lanes(evaluate, states, array, T, step=0.01, placed=True)
    assert lanes.outcomes == ["complete"] * 2
    for name, atol in (("x", 1e-5), ("y", 1e-5), ("force_normal", 1e-2), ("utilisation", 1e-3)):
        assert_allclose(lanes.columns[name].values, exact[name].values, atol=atol, err_msg=name)


def test_starts_from_trajectories_and_formulas_of_the_ground():
    """A ground given by a formula needs no lookups; rolling without slip is linear as well."""
    dae = sf.direct_kinematics(
        sf.catalog.three_wheeler(), sf.Analytic(lambda x, y: 0.02 * x * y), slip=sf.Rolling()
    )
    inputs = rates(2)
    starts = [sf.settle(dae, heading=0.1), sf.settle(dae, y=0.5)]
    exact = sf.rollouts(dae, starts, inputs, T, options=EXACT)
    names = ["x", "pitch"]
    lanes = sf.rollouts(dae, starts, inputs, T, method="batch", step=0.05, quantities=names)
    for name in names:
        assert_allclose(lanes[name], exact[name], atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "fast"}, "method: expected 'simulate' or 'batch', found str 'fast'"),
        ({"quantities": ["works"]}, "quantities: expected names of states"),
        ({"quantities": ["work"]}, "method='simulate' has limits, checks"),
        ({"step": -0.1}, "step: expected a number > 0"),
    ],
)
def test_wrong_arguments_are_named(model, arguments, message):
    with pytest.raises(sf.ModelError, match=message):
        sf.rollouts(model, {}, rates(1), T, **({"method": "batch"} | arguments))


def test_models_and_inputs_that_the_batch_does_not_take_are_named(model):
    t = model.t
    with pytest.raises(sf.ModelError, match="expected numbers for the method 'batch', found SX"):
        sf.rollouts(model, {}, rates(1) | {"steer_rate": 0.1 * t}, T, method="batch")
    vehicle = sf.catalog.three_wheeler(axle="fixed")
    with pytest.raises(sf.ModelError, match="expected a model of kinematics or quasi-statics"):
        sf.settle_many(sf.dynamics(vehicle, hills()), x=0.0)
    with pytest.raises(sf.ModelError, match="expected numbers or arrays of one shape"):
        sf.settle_many(model, x=np.zeros(2), y=np.zeros(3))
    with pytest.raises(sf.ModelError, match="unknown 'z'"):
        sf.settle_many(model, z=np.zeros(2))


def test_motions_on_soil_follow_jumps_from_rest():
    """From rest, and at jumps of the rates, forces of soil are found as by `simulate`."""
    model = sf.quasi_statics(sf.catalog.three_wheeler(axle="fixed"), hills(), law=sf.Soil())
    wheels = np.array([[[1.0, 0.8], [1.0, 1.2]], [[0.2, 1.5], [0.3, 1.4]]])  # [rad/s]
    inputs = {"right_rate": wheels[:, 0], "left_rate": wheels[:, 1], "steer_rate": 0.1}
    t, names = np.array([0.0, 0.3, 0.6]), ["x", "y", "sinkage", "slip_along", "force_across"]
    options = sf.SolverOptions(tolerance=1e-8)
    exact = sf.rollouts(model, {}, inputs, t, quantities=names, options=options)
    evaluate = evaluator_of(model, compiled=False)
    assert [each.full for each in leaves(model.labels.u)] == [*inputs]
    columns = np.array([wheels[:, 0], wheels[:, 1], np.full((2, 2), 0.1)]).transpose(0, 2, 1)
    states = start_states(evaluate.graphs, {"x": np.zeros(2)})
    lanes = run_lanes(evaluate, states, columns, t, step=0.05, quantities=names)
    assert lanes.outcomes == ["complete"] * 2
    for name in names:
        size = model.size_of(lanes.columns[name].label)
        assert_allclose(lanes.columns[name].values, exact[name], atol=1e-6 * size, err_msg=name)
    assert (lanes.error < 1e-6).all()


def test_one_motion_is_refined_to_the_tolerance(model):
    """The explicit method reaches its tolerance, with the quantities and ends of IDAS."""
    inputs = {name: values[0] for name, values in rates(1).items()}
    start = sf.settle(model, heading=0.4)
    exact = sf.simulate(model, start, model.inputs(**inputs), T, options=EXACT)
    for tolerance in (1e-4, 1e-8):
        options = sf.SolverOptions(tolerance=tolerance, method="explicit", compiled=True)
        run = sf.simulate(model, start, model.inputs(**inputs), T, options=options)
        assert np.hypot(*(run[name][-1] - exact[name][-1] for name in "xy")) < tolerance
        assert set(run.columns) == set(exact.columns)
    for name in ("z", "slip_along", "force_normal", "wheel_angle", "velocity_x"):
        assert_allclose(run[name], exact[name], atol=1e-6, err_msg=name)
    assert_allclose(run["work"], exact["work"], rtol=0.02, atol=0.02)
    edge = sf.settle(model, y=near_the_edge(model, 2)["y"][-1])
    for t in (T, T[[0, -1]]):  # in a later interval, and in the first one
        given = model.inputs(**{name: values[: t.size - 1] for name, values in inputs.items()})
        ends = [sf.simulate(model, edge, given, t, options=each) for each in (options, EXACT)]
        assert ends[0].stop.name == ends[1].stop.name == "map_margin[front]"
        assert_allclose(ends[0].t[-1], ends[1].t[-1], atol=1e-5)
    law = model.inputs(**(inputs | {"steer_rate": 0.1 * model.t}))
    with pytest.raises(sf.ModelError, match="expected numbers for the method 'explicit'"):
        sf.simulate(model, start, law, T, options=options)


@pytest.mark.slow
@pytest.mark.parametrize("shortest", [0.5, 0.2])
def test_ends_on_rough_ground_are_those_of_simulate(rng, shortest):
    """Ground nearly as curved as the wheels: near second contacts, folds and stops."""
    dae = sf.direct_kinematics(sf.catalog.three_wheeler(), hills(rms=0.1, shortest=shortest))
    starts = dict(zip("xy", rng.uniform(-3, 3, (2, 10)), strict=True))
    inputs = {name: 3 * values for name, values in rates(10, spread=0.1).items()}
    lanes, exact = same_ends(dae, starts, inputs, 0.1, tolerance=1e-8, atol=0.01)
    assert np.isnan(lanes["error"]).sum() <= 1  # motions that are left to `simulate`
    assert ({"complete", "limit"} if shortest == 0.5 else {"limit"}) <= {*exact["outcome"].values}
