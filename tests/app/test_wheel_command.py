"""Tests of ``slipfree wheel`` (table, figure, measured points, errors) and of soil in problems."""

import csv
import re
import tomllib
from dataclasses import replace
from math import radians
from pathlib import Path

import numpy as np
import pytest

from helpers.cases import DATA
from helpers.commands import invoke, sets
from slipfree import Region
from slipfree.laws.soil import Soil, WheelSize, known_soil
from slipfree.models.single_wheel import single_wheel
from slipfree.problem.build import model_law
from slipfree.problem.load import load_problem
from slipfree.problem.result import build

WHEEL = """
wheel = { radius = 0.09, width = 0.11, load = 64.68 }
soil = { name = "lunar", friction_angle = "34 deg" }
test = { slip = [-0.2, 0.6], points = 5, slip_angles = ["0 deg", "16 deg"] }
"""
SAND = (DATA / "cart_on_sand.toml").read_text()


def run(*words, code=None):
    return invoke("wheel", *words, code=code)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "wheel.toml"
    path.write_text(WHEEL)
    return path


def columns(path: Path) -> dict[str, np.ndarray]:
    with path.open() as stream:
        rows = list(csv.DictReader(stream))
    return {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}


def test_table_and_figure(file, tmp_path):
    out = tmp_path / "curves.csv"
    done = run(file, "-o", out, code=0)
    assert "slip angle 16 deg  drawbar pull" in done.output
    assert (tmp_path / "curves.png").is_file()
    found = columns(out)
    values = {name: getattr(known_soil("lunar"), name) for name in Soil.__dataclass_fields__}
    soil = Soil(**(values | {"friction_angle": radians(34)}))
    slips, angles = np.linspace(-0.2, 0.6, 5), [0.0, radians(16)]
    curves = single_wheel(soil, WheelSize(0.09, 0.11), 64.68, slips, angles)
    assert found["slip"] == pytest.approx(np.tile(slips, 2))
    for name in ("pull", "side", "torque", "sinkage"):
        assert found[name] == pytest.approx(getattr(curves, name).ravel(), rel=1e-9, abs=1e-12)


def test_gravity_weighs_the_soil_that_a_wheel_pushes_aside(file, tmp_path):
    tables = []
    for gravity in ("earth", "moon"):
        out = tmp_path / f"{gravity}.csv"
        done = run(file, "-o", out, "--set", f"gravity={gravity}", code=0)
        tables.append(columns(out))
    earth, moon = tables
    assert moon["pull"] == pytest.approx(earth["pull"], rel=1e-12)
    aside = moon["slip_angle"] > 0
    assert (moon["side"][aside] < 0.99 * earth["side"][aside]).all()
    assert "gravity" in done.output
    assert "1.62 m/s^2 (moon)" in done.output


def test_measured_points_have_their_own_loads(file, tmp_path):
    """Loads and slip angles are columns; without them they are wheel.load and zero."""
    soil = replace(known_soil("lunar"), friction_angle=radians(34))
    lines, size = [], WheelSize(0.09, 0.11)
    for slip, angle, load in ((0.1, 0.0, 64.68), (0.1, 0.3, 30.0), (-0.2, 0.3, 90.0)):
        found = single_wheel(soil, size, load, [slip], [angle])
        lines.append(f"{load},{found.side[0, 0] + 1},{slip},{angle}")
    (tmp_path / "points.csv").write_text("\n".join(["load,side,slip,slip_angle", *lines]))
    straight = single_wheel(soil, size, 64.68, [0.1]).sinkage[0, 0] - 0.001
    (tmp_path / "few.csv").write_text(f"slip,sinkage\n0.1,{straight}\n")
    for name, words in (
        ("points", "3 points, computed minus measured rms 1 N, mean -1 N"),
        ("few", "1 points, computed minus measured rms 0.001 m, mean 0.001 m"),
    ):
        measured = f"test.measured={name}.csv"
        done = run(file, "-o", tmp_path / "x.csv", "--no-draw", "--set", measured, code=0)
        assert not (tmp_path / "x.png").exists()
        assert words in done.output


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (["soil.name=mud"], "soil.name: expected one of regolith_simulant"),
        (["test.slip=[0.5, 0.1]"], "test.slip: expected two slip ratios in ascending order"),
    ],
)
def test_errors_name_the_value(file, tmp_path, settings, words):
    options = sets(*settings)
    done = run(file, "-o", tmp_path / "x.csv", *options, code=2)
    assert words in done.output
    assert not (tmp_path / "x.csv").exists()


@pytest.mark.slow
@pytest.mark.parametrize("model", ["dynamics", "quasi-static"])
def test_problems_take_soil(tmp_path, model):
    path = tmp_path / "sand.toml"
    path.write_text(SAND.replace('"dynamics"', f'"{model}"'))
    problem = load_problem(path)
    assert problem.spec.law.parameters("soil")["friction_angle"] == pytest.approx(radians(30))
    labels = build(problem).dae.labels
    assert ("sinkage" in str(labels.z)) == (model == "quasi-static")


PATCH = """
[[law.soil.regions]]
x = 0.0
y = 1.0
radius = 0.5
width = 0.2
name = "dry_sand"
cohesion = 700.0
"""


def test_problems_take_soils_by_name_and_regions(tmp_path):
    path = tmp_path / "p.toml"
    path.write_text(SAND.replace('friction_angle = "30 deg"', 'name = "lunar"') + PATCH)
    law = model_law(load_problem(path))
    assert replace(law, regions=()) == replace(known_soil("lunar"), cohesion=500.0)
    (region,) = law.regions
    assert region.soil == replace(known_soil("dry_sand"), cohesion=700.0)
    assert (region.width, region.region) == (0.2, Region.disc(0.0, 1.0, 0.5))


FIT = (DATA / "fit_soil.toml").read_text()


@pytest.fixture
def tested(tmp_path):
    """Return a wheel file with runs in a soil of 30 degrees; speeds instead of slip ratios."""
    path = tmp_path / "sand.toml"
    path.write_text(FIT)
    true = Soil(
        friction_angle=radians(30), shear_along=0.02, shear_along_rate=0.0, shear_across_rate=0.0
    )
    lines = ["run,rim_speed [mm/s],speed [mm/s],slip_angle [deg],pull,sinkage [mm]"]
    for run, rim in enumerate((5, 8, 12, 16, 20, 30)):
        forward = 10 * np.cos(radians(20))
        slip = (rim - forward) / max(rim, forward)
        found = single_wheel(true, WheelSize(0.09, 0.11), 50.0, [slip], [radians(20)])
        for error in (-0.01, 0.01):
            pull, sinkage = found.pull[0, 0] + error, 1e3 * found.sinkage[0, 0] + error
            lines.append(f"{run},{rim},10,20,{pull},{sinkage}")
    (tmp_path / "points.csv").write_text("\n".join(lines))
    return path


def test_fit_of_a_soil(tested, tmp_path):
    """The same file serves `slipfree fit` and `slipfree wheel`; the fitted soil is a TOML table."""
    table, written = tmp_path / "fit.csv", tmp_path / "soil.toml"
    done = invoke("fit", str(tested), "-o", str(table), "--write", str(written), code=0)
    assert "12 points of 6 runs" in " ".join(done.output.split())
    assert (tmp_path / "fit.png").is_file()
    soil = tomllib.loads(written.read_text())["law"]["soil"]
    assert soil["friction_angle"] == pytest.approx(radians(30), rel=1e-3)
    assert soil["shear_along"] == pytest.approx(0.02, rel=1e-2)
    assert soil["shear_along_rate"] == 0
    with table.open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["name"] for row in rows] == ["friction_angle", "shear_along"]
    points = columns(tmp_path / "fit_points.csv")
    assert points["pull_left_out"] == pytest.approx(points["pull_measured"], abs=0.03)
    done = run(tested, "-o", tmp_path / "x.csv", "--no-draw")
    assert "measured pull" in done.output


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[unknowns.shear_along]", "[unknowns.creep]", "expected one of the constants of soil"),
        ('lower = "20 deg"', 'lower = "20 mm"', 'expected a number, or text as in "30 deg"'),
        ('measured = "points.csv"', "", "test.measured: expected a CSV file of measured points"),
        ("folds = 3", "folds = 12", "expected at least 12 runs, for 2 unknowns and 12 folds"),
    ],
)
def test_errors_of_fits_of_soil(tested, tmp_path, old, new, words):
    tested.write_text(FIT.replace(old, new))
    done = invoke("fit", str(tested), "-o", str(tmp_path / "fit.csv"), code=2)
    assert words in " ".join(done.output.split())
    done = invoke("fit", str(tested), "--predict", str(tested))
    assert "found a wheel file; omit --predict" in " ".join(done.output.split())


def test_three_tests_without_a_wheel_file(tmp_path):
    """Usual constants have priors, and those that the tests do not determine are named."""
    truth = replace(known_soil("lunar"), friction_angle=radians(28))
    found = single_wheel(truth, WheelSize(0.09, 0.11), 60.0, [0.1, 0.3, 0.5])
    rows = zip(found.slip, found.pull[0], found.sinkage[0], strict=True)
    lines = ["slip,pull,sinkage,load", *(f"{s},{pull},{depth},60" for s, pull, depth in rows)]
    table, written = tmp_path / "tests.csv", tmp_path / "soil.toml"
    table.write_text("\n".join(lines))
    words = [table, "--fit", "-o", tmp_path / "fit.csv", "--write", written]
    options = sets("wheel.radius=0.09", "wheel.width=0.11", "soil.name=lunar")
    done = run(*words, *options, code=0)
    shown = " ".join(done.output.split())
    assert "3 points of 3 runs" in shown
    assert re.search(r"cohesion [^)]*as its prior: not determined by these data", shown)
    assert "weakly determined frictional_modulus" in shown
    with (tmp_path / "fit.csv").open() as stream:
        rows = {row["name"]: row for row in csv.DictReader(stream)}
    angle = rows["friction_angle"]
    assert float(angle["lower"]) < radians(28) < float(angle["upper"])
    assert abs(float(angle["value"]) - radians(28)) < radians(2)
    assert tomllib.loads(written.read_text())["law"]["soil"]["shear_across"] == truth.shear_across
    done = run(table, "--fit", *sets("wheel.radius=0.09"))
    assert "tests.csv: wheel.width: expected a value (width [m]), found none" in done.output
    done = run(table, "--write", written, *options)
    assert "expected --fit with --write" in done.output


def test_undetermined_soil_is_not_written(tested, tmp_path):
    tested.write_text(FIT.replace("[unknowns.shear_along]", "[unknowns.shear_across]"))
    settings = sets("unknowns.shear_across=")  # without its prior
    written = tmp_path / "soil.toml"
    words = [str(tested), "-o", str(tmp_path / "fit.csv"), "--write", str(written)]
    done = invoke("fit", *words, *settings, "--set", "unknowns.shear_across.lower=0.001", code=1)
    assert "found no information on shear_across" in " ".join(done.output.split())
    assert not written.exists()
