"""Motion over a map fitted to commands and positions: known truth, intervals, refusals."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.hillside import AXIS, HILL, TRUE, drive
from slipfree import ModelError
from slipfree.core.records import Array
from slipfree.fit import ground_fit
from slipfree.fit.body_motion import MotionError
from slipfree.fit.ground_fit import (
    FITTED,
    GroundFit,
    conformal,
    fit_ground,
    fit_on_uncertain_map,
    judge,
)
from slipfree.fit.ground_motion import (
    MODELS,
    ComplexArray,
    DriveLog,
    GroundPredictor,
    Slopes,
    Tour,
    Values,
    windows_of,
    with_drives_and_sensors,
)
from slipfree.fit.unknowns import Unknown
from slipfree.terrain.base import Grid
from slipfree.terrain.grid_ops import disturbed


@cache
def logs(size: float = 1.0) -> list[DriveLog]:
    """Return logs of three campaigns."""
    return [drive(k, "abc"[k % 3], size) for k in range(6)]


def part(log: DriveLog, samples: slice) -> DriveLog:
    """Return some samples of a log."""
    names = ("place", "velocity", "speed", "good", "direction", "sides")
    return log._replace(**{name: getattr(log, name)[samples] for name in names})


def fitted(drives: list[DriveLog], name: str, slopes: Slopes) -> GroundFit:
    """Return the fit of a model to windows of 5 m."""
    return fit_ground(MODELS[name], GroundPredictor(drives, windows_of(drives, 5.0), slopes))


def test_fit_finds_the_truth() -> None:
    found = fitted(logs(), "slope", Slopes(HILL, 0.0))
    for name, value in TRUE.items():
        assert abs(found.values[name] - value) < 0.01 * max(abs(value), 0.1), name
    # what remains are chords of 2 s, steps of 0.2 s and the interpolation between nodes
    assert np.median(found.errors.position) < 0.01
    assert found.errors.position.max() < 0.1


def test_sensors_and_lags_are_found_beside_the_truth() -> None:
    """A receiver off the centre, a compass that is mounted askew, and a lag of the turns."""
    sensor, lag = (0.6 + 0.3j, 0.8), 0.5
    drives = [drive(k, "a", lag=lag, sensor=sensor) for k in range(6)]
    true = {"turn_lag": lag, "sensor_ahead": 0.6, "sensor_right": -0.3, "sensor_heading": 0.8}
    unknowns = [Unknown(name, name) for name in true]
    model = with_drives_and_sensors(MODELS["slope"], unknowns)
    predict = GroundPredictor(drives, windows_of(drives, 5.0), Slopes(HILL, 0.0))
    found = fit_ground(model, predict)
    for name, value in (TRUE | true).items():
        assert abs(found.values[name] - value) < 0.02 * max(abs(value), 0.1), name
    assert np.median(found.errors.position) < 0.01
    with pytest.raises(ModelError, match=r"expected windows that determine .*sensor_ahead"):
        fit_ground(with_drives_and_sensors(MODELS["icr"], unknowns[1:2]), predict)


def test_derivatives_in_one_pass_equal_single_predictions() -> None:
    """Values in arrays: the motions of different constants do not influence each other."""
    predict = GroundPredictor(logs(), windows_of(logs(), 5.0), Slopes(HILL, 0.0))
    model = with_drives_and_sensors(MODELS["slope"], [Unknown("turn_lag", "turn_lag")])
    low = {key: value + 0.01 for key, value in model.start.items()}
    both = {key: np.array([low[key], value]) for key, value in model.start.items()}
    found = predict(model, both)
    for k, values in enumerate((low, model.start)):
        single = predict(model, values)
        assert_allclose(found.along[:, k], single.along, atol=1e-9)
        assert_allclose(found.course[:, k], single.course, atol=1e-9)


def test_wrong_map_widens_the_intervals_over_the_truth() -> None:
    drives, wrong = logs(), disturbed(HILL, 0.1, 3.0, 1)
    more = [Slopes(disturbed(wrong, 0.1, 3.0, seed), 0.0) for seed in (2, 3, 4)]
    right = fitted(drives, "slope", Slopes(HILL, 0.0))
    found = fit_on_uncertain_map(
        MODELS["slope"], drives, windows_of(drives, 5.0), (Slopes(wrong, 0.0), more)
    )
    for name in ("slip_slope", "turn_slope"):
        assert found.deviation[name] > 2 * right.deviation[name], name
        low, high = found.intervals[name]
        assert low < TRUE[name] < high, name


def test_level_ground_determines_no_influence_of_the_slope() -> None:
    level = Grid(AXIS, AXIS, np.zeros_like(HILL.z))
    with pytest.raises(ModelError, match=r"slip_slope, turn_slope of the model 'slip and turning"):
        fitted(logs(0.0), "slope", Slopes(level, 0.0))


def test_groups_are_predicted_with_constants_of_the_others() -> None:
    names = ("differential", "slope")
    scores, fits = judge(logs(), Slopes(HILL, 0.0), {name: MODELS[name] for name in names})
    assert [len(fits[name]) for name in names] == [3, 3]
    for kind, score in scores["slope"].items():
        assert (
            score.errors.position.mean() < scores["differential"][kind].errors.position.mean() / 5
        )
        assert abs(score.slip()[0][3]) < 1e-3
    own = scores["slope"][FITTED]
    group, beyond = own.windows.log % 3, np.zeros(own.grade.size, dtype=bool)
    for k in range(3):
        known = own.grade[group != k]
        beyond |= (group == k) & ((own.grade < known.min()) | (own.grade > known.max()))
    assert beyond.any()
    assert (own.is_beyond == beyond).all()


def test_groups_without_windows_of_a_kind_are_judged_on_the_others() -> None:
    model, slopes = {"differential": MODELS["differential"]}, Slopes(HILL, 0.0)
    short = part(drive(9, "short"), slice(120))
    scores, fits = judge([*logs(), short], slopes, model, [(5.0, 0.0), (20.0, 0.0)])
    assert len(fits["differential"]) == 4
    judged = [set(each.windows.log.tolist()) for each in scores["differential"].values()]
    assert judged == [set(range(7)), set(range(6))]
    few = [part(drive(k, "short"), slice(120)) for k in range(4)]
    few.append(logs()[0]._replace(group="long"))
    with pytest.raises(ModelError, match="at least one in the fitted logs, found none"):
        judge(few, slopes, model, [(20.0, 0.0)])


def test_fits_that_do_not_converge_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ground_fit, "MAX_EVALUATIONS", 2)
    with pytest.raises(ModelError, match=r"convergence of the fit of .* after 2 eval"):
        fitted(logs(), "slope", Slopes(HILL, 0.0))


def test_searches_avoid_values_without_motion() -> None:
    """The first step goes from a slope of turns of 1 to 3.9; the truth is 2."""
    predict, rejected = GroundPredictor(logs(), windows_of(logs(), 5.0), Slopes(HILL, 0.0)), []

    def paths(most: float, values: Values, tour: Tour) -> tuple[ComplexArray, Array]:
        if values["turn_slope"].max() > most:
            rejected.append(values["turn_slope"].max())
            raise MotionError("the vehicle tips over", 0)
        return MODELS["slope"].paths(values, tour)

    found = fit_ground(MODELS["slope"]._replace(paths=partial(paths, 3.0)), predict)
    assert rejected
    assert abs(found.values["turn_slope"] - TRUE["turn_slope"]) < 0.01
    with pytest.raises(ModelError, match="the vehicle tips over"):
        fit_ground(MODELS["slope"]._replace(paths=partial(paths, 1.5)), predict)


def test_coarse_and_short_logs_have_no_windows() -> None:
    log = logs()[0]
    coarse, short = part(log, slice(None, None, 5))._replace(dt=1.0), part(log, slice(10))
    assert windows_of([coarse], 5.0).log.size
    windows = windows_of([short, log], 5.0)
    assert set(windows.log.tolist()) == {1}


def test_conformal_intervals_hold() -> None:
    rng = np.random.default_rng(0)
    inside = [abs(rng.normal()) <= conformal(rng.normal(size=30)) for _ in range(4000)]
    assert 0.885 < np.mean(inside) < 0.925  # 28 / 31 = 0.903


def test_windows_leave_out_bad_positions() -> None:
    log = logs()[0]
    jump = log.place.copy()
    jump[350:] += 3.0
    for bad in (log._replace(place=jump), log._replace(good=np.arange(700) < 340)):
        windows = windows_of([bad], 5.0)
        assert not ((windows.first < 349) & (windows.last > 350)).any()
        assert len(windows.log) < len(windows_of([log], 5.0).log)
    with pytest.raises(ModelError, match="found none; use longer logs or shorter windows"):
        windows_of([log._replace(good=log.good & False)], 5.0)


def test_slopes_of_a_plane() -> None:
    plane = Grid(AXIS, AXIS, 0.2 * AXIS[:, None] - 0.1 * AXIS)
    place, heading = np.array([3.3 - 7.1j, 60.0 + 2.0j]), np.array([0.4, 0.4])
    up, left = Slopes(plane, 1.5).tilt(place, heading)
    normal = np.array([-0.2, 0.1, 1]) / np.sqrt(1.05)
    ahead = np.array([np.cos(0.4), np.sin(0.4), 0.2 * np.cos(0.4) - 0.1 * np.sin(0.4)])
    ahead /= np.linalg.norm(ahead)
    assert_allclose(up, ahead[2], atol=1e-9)
    assert_allclose(left, np.cross(normal, ahead)[2], atol=1e-9)
