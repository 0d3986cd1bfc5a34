"""Tests of fits of soil constants to single-wheel tests: truth, intervals, cross-validation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slipfree import ModelError, Soil
from slipfree.fit.estimate import Unknown
from slipfree.fit.wheel_soil import SoilProblem, fit_soil, repeat_spread
from slipfree.laws.soil import WheelSize
from slipfree.models.single_wheel import WheelRuns, motion_at_slip, single_wheel, steady_forces

SIZE = WheelSize(0.09, 0.11)
NOMINAL = replace(Soil(), shear_along_rate=0.0, shear_across_rate=0.0)
TRUTH = {
    "cohesion": 400.0,
    "friction_angle": 0.55,
    "frictional_modulus": 6e5,
    "shear_along": 0.02,
    "shear_across": 0.018,
}
UNKNOWNS = tuple(Unknown(name, name) for name in TRUTH)
NOISE = np.array([0.5, 0.5, 0.05, 0.0005])  # of pull [N], side [N], torque [N m], sinkage [m]


@pytest.fixture(scope="module")
def runs() -> WheelRuns:
    """Return runs of a wheel in the true soil, without errors."""
    cases = np.meshgrid([-0.4, 0.1, 0.2, 0.4], [0.0, 0.3], [40.0, 60.0])
    s, b, load = (each.ravel() for each in cases)
    run = np.repeat(np.arange(s.size), 2)
    motion, load = motion_at_slip(s, b)[:, run], load[run]
    forces = steady_forces(replace(NOMINAL, **TRUTH), SIZE, motion, load)
    values = np.column_stack([forces.pull, forces.side, forces.torque, forces.sinkage])
    return WheelRuns(motion, load, values, run.astype(float))


def noisy(runs: WheelRuns, seed: int) -> WheelRuns:
    errors = np.random.default_rng(seed).normal(size=runs.values.shape) * NOISE
    return runs._replace(values=runs.values + errors)


def fitted(runs: WheelRuns, **options):
    return fit_soil(NOMINAL, SIZE, UNKNOWNS, runs, **({"folds": 2, "resamples": 0} | options))


def test_predictions_are_those_of_the_single_wheel(runs):
    problem, truth = SoilProblem(NOMINAL, SIZE, UNKNOWNS, runs), np.array([*TRUTH.values()])
    values, slopes = problem.predict(runs, truth)
    assert values == pytest.approx(runs.values, rel=1e-9, abs=1e-11)
    for k, step in enumerate(1e-6 * truth):
        low, high = (
            problem.predict(runs, truth + sign * step * np.eye(5)[k])[0] for sign in (-1, 1)
        )
        difference = (high - low) / 2 / step
        assert np.abs(slopes[..., k] - difference).max() < 1e-4 * np.abs(difference).max()


def test_known_constants_are_found(runs):
    found = fitted(runs)
    assert found.estimate.values == pytest.approx([*TRUTH.values()], rel=1e-4)
    assert found.soil == replace(NOMINAL, **dict(zip(TRUTH, found.estimate.values, strict=True)))
    assert found.validated == pytest.approx(runs.values, rel=1e-3, abs=1e-5)
    assert not found.estimate.undetermined
    assert not found.sunk


def test_intervals_contain_the_truth(runs):
    """The binomial 99.9 % interval of 20 draws of 5 intervals of 95 %: at least 85 %."""
    inside, stated, values = [], [], []
    truth = np.array([*TRUTH.values()])
    for seed in range(20):
        problem = SoilProblem(NOMINAL, SIZE, UNKNOWNS, noisy(runs, seed))
        found = problem.estimate(*problem.solve(noisy(runs, seed), problem.nominal)[:2])
        inside.append((found.intervals[:, 0] <= truth) & (truth <= found.intervals[:, 1]))
        stated.append(np.sqrt(np.diag(found.covariance)))
        values.append(found.values)
    assert np.mean(inside) >= 0.85
    ratio = np.mean(stated, axis=0) / np.std(values, axis=0)
    assert ((ratio > 0.5) & (ratio < 2)).all()


def test_errors_of_runs_left_out_are_those_of_the_repeats(runs):
    found = fitted(noisy(runs, 1), resamples=20)
    assert [each.name for each in found.errors] == ["pull", "side", "torque", "sinkage"]
    for each, noise in zip(found.errors, NOISE, strict=True):
        assert each.repeats == pytest.approx(noise, rel=0.4)
        assert each.validated.value < 1.6 * noise < each.nominal.value
        assert each.validated.lower < each.validated.value < each.validated.upper
    assert 0.6 < found.excess < 1.5
    spread = found.resampled[:, 1] - found.resampled[:, 0]
    stated = found.estimate.intervals[:, 1] - found.estimate.intervals[:, 0]
    assert ((spread / stated > 0.3) & (spread / stated < 1.5)).all()


def test_repeats_have_the_same_motion(runs):
    assert np.isnan(repeat_spread(runs.take(np.arange(0, runs.load.size, 2)))).all()
    sweep = runs._replace(run=np.zeros_like(runs.run))
    assert np.isnan(repeat_spread(sweep)).all()


def test_constants_that_the_data_do_not_determine_are_named(runs):
    """Runs without a slip angle do not depend on the shear modulus across the wheel."""
    straight = runs.take(runs.motion[2] == 0)
    assert fitted(noisy(straight, 0)).estimate.undetermined == ("shear_across",)
    some = (UNKNOWNS[1], Unknown("cohesive_modulus", "cohesive_modulus"), UNKNOWNS[2])
    found = fit_soil(NOMINAL, SIZE, some, noisy(straight, 0), folds=2, resamples=0)
    assert set(found.estimate.undetermined) == {"cohesive_modulus", "frictional_modulus"}


def test_priors_determine_constants(runs):
    prior = Unknown("shear_across", "shear_across", prior=(0.015, 0.001))
    straight = runs.take(runs.motion[2] == 0)
    unknowns = (*UNKNOWNS[:4], prior)
    found = fit_soil(NOMINAL, SIZE, unknowns, noisy(straight, 0), folds=2, resamples=0)
    assert found.estimate.values[-1] == pytest.approx(0.015, rel=1e-6)
    assert not found.estimate.undetermined


@pytest.mark.parametrize(
    ("unknowns", "options", "words"),
    [
        (("creep",), {}, r"expected one of the constants of soil cohesion, .*found 'creep'"),
        (("cohesion", "cohesion"), {}, "expected each constant once, found 'cohesion' twice"),
        (("cohesion",), {"folds": 40}, "expected at least 40 runs.*found 16; give each"),
    ],
)
def test_fits_that_cannot_be_made_are_refused(runs, unknowns, options, words):
    names = [Unknown(name, name) for name in unknowns]
    with pytest.raises(ModelError, match=words):
        fit_soil(NOMINAL, SIZE, names, runs, **options)
    low = Unknown("cohesion", "cohesion", lower=1e4)
    with pytest.raises(ModelError, match="nominal value within the bounds, 10000 to inf"):
        fit_soil(NOMINAL, SIZE, (low,), runs)
    peaks = Unknown("peak", "peak", lower=0.2, upper=0.3), Unknown("rate", "peak_rate")
    with pytest.raises(ModelError, match=r"'peak': .* found 0\.3333 and 0\.3 with the limits of"):
        fit_soil(replace(NOMINAL, peak=0.25, peak_rate=0.1), SIZE, peaks, runs)


def test_a_wheel_that_is_dragged_sideways():
    """A motion is given by speeds where a slip ratio and a slip angle do not determine it."""
    motion = np.array([[0.5, 0.0], [0.0, 0.0], [1.0, 1.0]])
    forces = steady_forces(NOMINAL, SIZE, motion, np.full(2, 40.0))
    assert (forces.side > 0).all()
    assert forces.pull[0] > 0
    assert forces.pull[1] == pytest.approx(0, abs=1e-9)
    near = single_wheel(NOMINAL, SIZE, 40.0, [-1.0], [1.57])
    assert forces.side[1] == pytest.approx(near.side[0, 0], rel=0.2)
