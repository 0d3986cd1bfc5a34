"""Tests of the comparison of axles in the paper: which can roll, and the slip of the others."""

import re

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import slipfree as sf
from helpers.cases import PROBLEMS, hills
from helpers.commands import invoke
from slipfree.catalog import three_wheeler
from slipfree.models.samples import measured_slip
from slipfree.problem.load import load_problem
from slipfree.problem.verbs.compare import compare

FILE = PROBLEMS / "compare_axles.toml"
# 6 rates of the platform, and the passive joints and free wheels; 9 conditions.
RANKS = (9, 9, 9, 9, 9, 9, 8, 8, 7, 7, 7, 7)


@pytest.fixture(scope="module")
def rows():
    problem = load_problem(FILE, ["time.duration=2.0"], command="compare")
    return {row["name"]: row for row in compare(problem)[1]}


def slips_of(row):
    """Return the slip along, across and from the poses at the same rates, and with the law."""
    names = ("slip_along", "slip_across", "slip_measured")
    return [[row[drive][name]["max"] for name in names] for drive in ("same_rates", "driving_law")]


def test_rank_says_who_can_roll(rows):
    assert tuple(row["rank"] for row in rows.values()) == RANKS
    for name, row in rows.items():
        slips = [max(along.max(), across.max()) for along, across, _ in slips_of(row)]
        if row["rank"] == row["conditions"]:
            assert max(slips) < 1e-12, name
            assert max(measured.max() for *_, measured in slips_of(row)) < 1e-7, name
        else:
            assert min(slips) > 1e-5, name


def test_slip_measured_on_poses_is_that_of_the_model(rows):
    for name, row in rows.items():
        for along, across, measured in slips_of(row):
            model = np.hypot(along, across)
            # the largest along and across need not meet at one time
            assert (measured <= model * (1 + 1e-6) + 1e-7).all(), name
            largest = np.maximum(along, across)
            # the first two samples, where slip may be largest, cannot be measured
            assert (measured >= largest * (1 - 5e-3) - 1e-7).all(), name


def test_rates_that_fit_slip_less(rows):
    for row in rows.values():
        if row["rank"] < row["conditions"]:
            (*_, same), (*_, fitting) = slips_of(row)
            assert fitting.max() < same.max() / 5


@pytest.mark.parametrize("axle", ["prismatic", "actuated", "fixed"])
def test_axles_that_slip_are_refused_for_rolling(axle):
    with pytest.raises(sf.ModelError, match="cannot roll without slip"):
        sf.direct_kinematics(three_wheeler(axle=axle), sf.Analytic(hills), slip=sf.Rolling())


def test_measured_slip_needs_even_samples():
    dae = sf.direct_kinematics(three_wheeler(), sf.Analytic(hills))
    start = sf.settle(dae)
    rates = dae.inputs(right_rate=0.5, left_rate=0.4, steer_rate=0.0)
    for t, words in (
        ([0.0, 0.1, 0.2], "at least five samples, found 3"),
        ([0.0, 0.1, 0.2, 0.3, 0.5], "equally spaced samples, found steps of 0.1 to 0.2 s"),
    ):
        run = sf.simulate(dae, start, rates, np.array(t))
        with pytest.raises(sf.ModelError, match=words):
            measured_slip(three_wheeler(), run)


def axle_mismatch(run, rates):
    """Return the least slip of the two rear wheels alone, on a rigid axle, at given rates.

    A rigid axle with spinning wheels: 6 rates of the axle, 6 conditions, one of which is
    redundant (it may turn about the line of contacts), so one condition on the rates is left.
    """
    heading, roll = run["heading"][0], run["roll"][0]
    axle = np.array([np.cos(heading) * np.cos(roll), np.sin(heading) * np.cos(roll), -np.sin(roll)])
    rows, spin = [], []
    for wheel, rate in zip(("right", "left"), rates, strict=True):
        contact = np.array([run[f"contact_{a}", wheel][0] for a in "xyz"])
        arm = contact - [run[f"center_{a}", wheel][0] for a in "xyz"]
        x, y, z = contact - [run[a][0] for a in "xyz"]
        rows.append(np.hstack([np.eye(3), [[0, z, -y], [-z, 0, x], [y, -x, 0]]]))
        spin.append(rate * np.cross(axle, arm))
    matrix, right = np.vstack(rows), np.concatenate(spin)
    return np.abs(matrix @ np.linalg.lstsq(matrix, right, rcond=1e-10)[0] - right).max()


def test_no_slip_conditions_of_a_rigid_axle():
    """Cited by the paper: equal rates, or the line of contacts coplanar with the axle."""
    dae = sf.direct_kinematics(three_wheeler(axle="fixed"), sf.Analytic(hills))
    uneven = sf.settle(dae, x=0.3, y=0.4, heading=0.5)
    assert axle_mismatch(uneven, (0.5, 0.5)) < 1e-15  # equal rates: never any slip
    assert axle_mismatch(uneven, (0.5, 0.4)) > 1e-5  # different rates, generic ground
    ridge = sf.Analytic(lambda x, y: 0.2 * ca.cos(0.8 * y) + 0.05 * x)
    dae = sf.direct_kinematics(three_wheeler(axle="fixed"), ridge)
    coplanar = sf.settle(dae, heading=0.0, y=0.7)  # both rear wheels meet the same slope
    assert axle_mismatch(coplanar, (0.5, 0.4)) < 1e-12


def test_command_prints_the_table():
    two = '[{name="a", catalog="three_wheeler"}, {name="b", catalog="three_wheeler", axle="fixed"}]'
    short = ["--set", f"vehicles={two}", "--set", "time.duration=0.4", "--set", "time.step=0.05"]
    result = invoke("compare", str(FILE), *short, code=0)
    rolls = dict(re.findall(r"^(a|b) +(yes|no)", result.stdout, re.MULTILINE))
    assert rolls == {"a": "yes", "b": "no"}


def test_faults_of_a_vehicle_are_located(tmp_path):
    text = FILE.read_text().replace('axle = "fixed"', 'axle = "stiff"', 1)
    path = tmp_path / "c.toml"
    path.write_text(text)
    result = invoke("compare", str(path))
    line = text[: text.index('"stiff"')].count("\n") + 1
    assert result.exit_code == 2
    assert f"c.toml:{line}: vehicles[10].axle: expected" in result.stderr


def test_rates_hold_for_every_sample_of_a_run():
    """Measured slip of a slipping vehicle equals the model's at every sample, by components."""
    vehicle = three_wheeler(axle="fixed")
    dae = sf.direct_kinematics(vehicle, sf.Analytic(hills))
    rates = dae.inputs(right_rate=0.5, left_rate=0.4, steer_rate=0.0)
    run = sf.simulate(
        dae,
        sf.settle(dae),
        rates,
        np.linspace(0, 2, 101),
        options=sf.SolverOptions(tolerance=1e-11),
    )
    size = np.linalg.norm(measured_slip(vehicle, run), axis=2)
    expected = np.hypot(run["slip_along"], run["slip_across"])[2:-2]
    assert_allclose(size, expected, rtol=0, atol=1e-7)
