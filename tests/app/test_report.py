"""Tests of reports of results, and of descriptions of vehicles."""

import re
import shlex
from base64 import b64decode
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from numpy.testing import assert_allclose

from helpers.cases import DATA, ROOT
from helpers.commands import invoke, refused
from helpers.problem_files import VALID
from slipfree import Analytic, direct_kinematics, settle
from slipfree.catalog import ackermann, differential_drive, rocky7, skid_steer
from slipfree.core.errors import DataError
from slipfree.core.facts import in_short
from slipfree.files import netcdf
from slipfree.models.samples import has_friction
from slipfree.problem.load import load_problem
from slipfree.problem.report import conditioning, describe, report
from slipfree.problem.result import build, run_problem
from slipfree.show.html_page import MOST, image, page

MOON = ROOT / "problems" / "moon_craters.toml"
STARTERS = ROOT / "src" / "slipfree" / "starters"
SETTINGS = {
    "direct": ["time.duration=1", "time.step=0.1", 'title="Über <Stock> & Stein"'],
    "inverse": ["time.duration=1", "time.step=0.1"],
    "plan": ["plan.intervals=8", "time.step=0.5"],
}
FIGURES = {"direct": 0, "inverse": 8, "plan": 0}
VOID = {"meta", "link", "img"}


def _result(kind: str, folder: Path, *settings: str) -> Path:
    """Return the result file of a shortened starter."""
    outcome = run_problem(load_problem(STARTERS / f"{kind}.toml", [*SETTINGS[kind], *settings]))
    file = folder / f"{kind}.nc"
    netcdf.write(file, outcome.trajectory, outcome.arrays)
    return file


class _Page(HTMLParser):
    """The tags of a page, that are properly nested, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def _invoke(*words: object, code: int | None = None) -> Any:
    return invoke("report", *words, code=code)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out what takes long."""
    monkeypatch.setattr("slipfree.problem.verbs.base.DriveVerb.figures", lambda *_: ())


@pytest.mark.slow
@pytest.mark.parametrize("kind", SETTINGS)
def test_a_page_holds_all_of_a_result(kind, tmp_path, monkeypatch):
    file = _result(kind, tmp_path)
    if kind == "plan":
        assert len(report(file).figures) == 10
    if not FIGURES[kind]:  # they are drawn as those of an inverse motion, and in test_plot.py
        for verb in ("base.DriveVerb", "plan.PlanVerb"):
            monkeypatch.setattr(f"slipfree.problem.verbs.{verb}.figures", lambda *_: ())
    _invoke(str(file), code=0)
    text = file.with_suffix(".html").read_text(encoding="utf-8")
    seen, words = _Page(text), unescape(re.sub(r"<[^>]*>", "", text))
    motion = netcdf.read(file)
    assert motion.attributes["title"] in words
    for setting in motion.attributes["settings"].splitlines():
        assert shlex.quote(setting) in words
    assert (STARTERS / f"{kind}.toml").read_text() in words
    for name, column in motion.columns.items():
        told = name != "utilisation" or has_friction(motion)
        assert name in words or not told
        assert (column.label.words in words) == told
    for name in ("slipfree", "python", "casadi", "numpy", "scipy"):
        assert motion.attributes[f"{name}_version"] in words
    assert f"slipfree info {file.name} --problem > {kind}_again.toml" in words
    checks = {
        "direct": "contact error",
        "inverse": "contact certificate",
        "plan": "differs from the plan by at most",
    }
    assert checks[kind] in words
    last = "Ground and path" if FIGURES[kind] else "<table"  # main facts and map come first
    assert text.index(last) < text.index("<details")
    _check_alone(seen, text)
    _check_pictures(seen, FIGURES[kind])
    assert len(text) < 4e6
    if kind == "direct":
        assert page(report(file)) == text


def _check_alone(seen: _Page, text: str) -> None:
    """Assert that a page asks for nothing outside of it, and runs nothing."""
    assert not {"script", "iframe", "object", "embed", "form"} & {name for name, _ in seen.tags}
    for _, attributes in seen.tags:
        assert not any(name.startswith("on") for name in attributes)
        for name in ("src", "href"):
            assert (attributes.get(name) or "data:").startswith(("data:", "#"))
    assert "url(" not in text
    assert "@import" not in text
    (policy,) = [each["content"] for each in seen.of("meta") if "http-equiv" in each]
    assert policy.startswith("default-src 'none'")
    assert not seen.of("a")


def _check_pictures(seen: _Page, count: int) -> None:
    """Assert that pictures are whole, bounded and have words."""
    pictures = seen.of("img")
    assert len(pictures) == count
    for each in pictures:
        assert each["alt"]
        kind, _, data = each["src"].partition(";base64,")
        raw = b64decode(data, validate=True)
        if kind == "data:image/png":
            assert raw.startswith(b"\x89PNG")
            continue
        assert kind == "data:image/svg+xml"
        assert ElementTree.fromstring(raw).tag.endswith("svg")
        assert len(raw) <= MOST
        assert b"<script" not in raw


def test_a_large_drawing_becomes_pixels(rng):
    figure = Figure()
    figure.subplots().plot(*rng.random((2, 30_000)), "o")
    assert image(figure).startswith("data:image/png;base64,")


@pytest.mark.usefixtures("undrawn")
def test_an_early_end_comes_first(tmp_path):
    found = report(_result("direct", tmp_path, "time.duration=30", "time.step=1"))
    assert not found.good
    assert found.lead.startswith("Limit reached at t = ")
    assert "leaves the map" in found.lead
    assert 'class="lead bad"' in page(found)
    assert "--problem > direct_again.toml" in found.texts["To repeat the run"]  # not over a file


def test_a_result_without_a_problem_has_no_figures(tmp_path):
    file = _result("direct", tmp_path)
    motion = netcdf.read(file)
    kept = {k: v for k, v in motion.attributes.items() if k not in ("problem", "settings")}
    netcdf.write(file, replace(motion, attributes=kept))
    result = _invoke(str(file), "-o", str(tmp_path / "bare.html"), code=0)
    assert "expected a result that contains its problem, found none" in result.stderr
    text = (tmp_path / "bare.html").read_text()
    assert "<img" not in text
    assert "To repeat the run" not in text
    words = refused("report", str(file), "-o", "b.pdf")
    assert "b.pdf: expected a name that ends in .html" in words


def test_a_problem_of_another_version_has_no_figures(tmp_path):
    file = _result("direct", tmp_path)
    motion = netcdf.read(file)
    changed = motion.attributes | {"problem": 'verb = "direct"\nfuture = 1\n'}
    netcdf.write(file, replace(motion, attributes=changed), netcdf.read_arrays(file))
    found = report(file)
    assert found.note.startswith("No figures: ")
    assert "future" in found.note
    assert not found.figures
    assert found.tables["Checks"]


@pytest.mark.slow
def test_figures_of_a_long_motion_show_fewer_samples(tmp_path, monkeypatch):
    monkeypatch.setattr("slipfree.problem.report.FIGURE_SAMPLES", 5)
    file = _result("direct", tmp_path, "time.step=0.001")
    found = report(file)
    assert re.match(r"The figures show \d{2,3} of 1001 samples, including the extremes", found.note)
    assert ("duration", "1 s, 1001 samples") in found.tables["Result"]


# The description of a vehicle: from its file, from a problem, and if incomplete


def facts(found):
    return dict([*found.facts, *found.details])


def test_a_vehicle_file_by_itself(tmp_path):
    found = describe(DATA / "cart.toml")
    assert not found.faults
    assert found.tree == [
        "cart, in axes x right, y forward, z up",
        "platform: 12 kg, centre of mass at (0, 0.1, 0.05) m",
        "  bracket: rigid",
        "    caster: turns about (0.02, -0.03, 0.999) by caster (passive)",
        "      wheel caster_axle: free, torus r1 0.02, r2 0.08 m",
        "  wheel left_drive: driven, torus r1 0.02, r2 0.13 m, 1.5 kg",
        "  wheel right_drive: driven, torus r1 0.02, r2 0.13 m, 1.5 kg",
    ]
    known = facts(found)
    assert known["inputs"] == "2: left_drive_rate, right_drive_rate"
    assert " 6 no-slip conditions, 5 unknown rates (platform" in known["can roll without slip"]
    assert known["the ground determines"] == "height, pitch, roll"
    assert known["suspension"] == "0 of 0 for exact contact of all wheels"
    assert known["condition of rates"].endswith("at the start, least determined: caster_rate")
    assert known["total mass"] == "15.4 kg, centre of mass at (-0.0008, 0.0863, 0.0387) m"
    assert dict(found.wheels[0]) == {
        "wheel": "left_drive", "place (m)": "-0.25, 0, 0", "radius (m)": "0.15",
        "width (m)": "0.04", "driven": "yes", "steered": "no", "mass (kg)": "1.5",
        "partner": "right_drive",
    }  # fmt: skip
    assert found.wheels[2]["steered"] == "free"
    assert known["track"] == "0.5 m"
    notes = [words for name, words in found.facts if name == "vehicle file"]
    assert notes[0] == "omitted, since they carry no wheel and no mass: lidar_mount"
    assert notes[1].startswith("wheel right_drive: its rate is positive forward, opposite")
    shown = [words for name, words in in_short(found.facts) if name == "vehicle file"]
    assert shown[-1].endswith("which --write NAME.toml makes: slipfree vehicle FILE -v")
    assert not set(shown) & set(notes[:2])
    (tmp_path / "p.toml").write_text(
        f"verb = 'direct'\nframe = 'rep103'\nvehicle.file = '{DATA / 'cart.toml'}'\n"
        "terrain.synthetic = { x = [-3, 3], y = [-3, 3], spacing = 0.5 }\n"
        "start = { x = 0.0, y = 0.0, heading = 0.0 }\ntime = { duration = 1.0, step = 0.1 }\n"
        "inputs = { left_drive_rate = 1.0, right_drive_rate = 1.0 }\n"
    )
    assert shown[-1] in invoke("check", tmp_path / "p.toml", code=0).stdout
    assert notes[1] in invoke("check", tmp_path / "p.toml", "--verbose", code=0).stdout


@pytest.mark.slow
@pytest.mark.parametrize(
    ("build", "position", "rates", "weakest"),
    [
        (differential_drive, 8, 1.2e3, "caster_angle_rate"),
        (ackermann, 8, 5e2, "front_left_rate"),
        (skid_steer, 9, 3e1, "rock_rate"),
        (rocky7, 30, 8e1, "bogie_left_rate"),
    ],
)
def test_conditions_on_level_ground(build, position, rates, weakest):
    """As measured with another program, to one digit."""
    dae = direct_kinematics(build(), Analytic(lambda x, _: 0 * x))
    found = dict(conditioning(dae, settle(dae)))
    for name, value in (("position", position), ("rates", rates)):
        assert_allclose(float(found[f"condition of {name}"].split()[0]), value, rtol=0.2)
    assert weakest in found["condition of rates"]
    assert "multiplier" not in found["condition of rates"]


def test_numbers_of_unknowns_are_printed_with_verbose():
    for more, is_shown in (([], False), (["--verbose"], True)):
        out = invoke("vehicle", DATA / "cart.toml", *more, code=0).stdout
        assert ("contact forces" in out) == is_shown
        assert "partner" in out


def test_slip_in_soil_is_not_the_least():
    found = facts(describe(MOON))
    assert found["can roll without slip"] == "the wheels slip as the wheel-ground law determines"
    assert found["the ground determines"] == "height, pitch, roll, rocker, bogie_right, bogie_left"


BROKEN = (DATA / "six_wheels_without_suspension.toml").read_text()


def test_what_can_be_said_of_what_is_no_vehicle(tmp_path):
    (tmp_path / "v.toml").write_text(BROKEN)
    result = invoke("vehicle", str(tmp_path / "v.toml"), code=2)
    assert "  p: turns about -x by a (suspension)" in result.stdout
    assert "not connected to the platform: q, on r" in result.stdout
    assert "not connected to the platform: wheel four, on hub" in result.stdout
    assert "1: a; at most 2" in result.stdout
    faults = [line.partition("v.toml:")[2] for line in result.stderr.splitlines()]
    places = [fault.partition(": expected")[0] for fault in faults]
    assert places == ["6: joints[1].parent (joint 'q')", "13: wheels[3].parent (wheel 'four')"]


def test_a_caster_without_trail_is_named(tmp_path):
    text = (DATA / "cart.urdf").read_text().replace('xyz="-0.08 0 -0.07"', 'xyz="0 0 -0.07"')
    text = text.replace('rpy="0.02 -0.03 -0.4"', 'rpy="0 0 -0.4"')
    (tmp_path / "cart.urdf").write_text(text)
    (tmp_path / "cart.toml").write_text((DATA / "cart.toml").read_text())
    found = describe(tmp_path / "cart.toml")
    (fault,) = found.faults
    assert (
        "on level ground: the model is singular here: no equation determines caster_rate" in fault
    )
    assert facts(found)["passive joints"] == "1: caster"


def test_axes_are_in_the_frame_of_the_vehicle(tmp_path):
    """Of a hinge whose own frame is turned, below a part that is turned by a constant value."""
    quarter = np.pi / 2
    (tmp_path / "v.toml").write_text(f"""\
name = "v"
frame = "rep103"
coordinates = [{{ name = "steer", kind = "commanded" }}]
joints = [{{ name = "mount", parent = "platform", axis = "z", value = "pi/2" }},
    {{ name = "hinge", parent = "mount", axis = "x", turned = [0, {quarter}, 0], value = "steer" }},
    {{ name = "arm", parent = "mount", axis = "x", value = "0.5*steer" }}]
wheels = [{{ name = "a", parent = "platform", at = [0, 0.3, 0], radius = 0.1, driven = true }},
    {{ name = "b", parent = "platform", at = [0, -0.3, 0], radius = 0.1, driven = true }},
    {{ name = "c", parent = "platform", at = [0.4, 0, 0], radius = 0.1 }}]
""")
    lines = describe(tmp_path / "v.toml").tree
    assert "    hinge: turns about -z by steer (commanded)" in lines
    assert "    arm: turns about -x by 0.5*steer (steer: commanded)" in lines  # to the left


def test_a_vehicle_that_nothing_drives_is_refused(tmp_path):
    text = (DATA.parents[1] / "problems" / "vehicles" / "trike.toml").read_text()
    free = text.replace("driven = true", "driven = false").replace('"commanded"', '"passive"')
    (tmp_path / "v.toml").write_text(free)
    found = describe(tmp_path / "v.toml")
    words = "expected a driven wheel or a commanded coordinate"
    assert words in found.faults[0]
    assert "set driven = true for some of the wheels rear" in found.faults[0]
    problem = VALID.replace('catalog = "three_wheeler"\nr1 = 0.05', 'file = "v.toml"')
    (tmp_path / "p.toml").write_text(re.sub(r"\w+_rate = .*\n", "", problem))
    with pytest.raises(DataError, match=words):
        build(load_problem(tmp_path / "p.toml"))


MECANUM = """\
name = "platform_with_rollers"
frame = "rep103"
mass = 20.0
coordinates = [{ name = "rock", kind = "suspension" }]
joints = [{ name = "axle", parent = "platform", axis = "x", value = "rock", at = [0.15, 0, 0] }]
""" + "".join(
    f'[[wheels]]\nname = "{name}"\nparent = "{part}"\nat = [{x}, {y}, 0]\nradius = 0.05\n'
    f'driven = true\nrollers = "{angle}"\n'
    for name, part, x, y, angle in (
        ("a", "axle", 0, 0.15, "A"),
        ("b", "axle", 0, -0.15, "B"),
        ("c", "platform", -0.15, 0.15, "B"),
        ("d", "platform", -0.15, -0.15, "A"),
    )
)


def test_the_mobility_on_rollers_is_counted_and_a_free_motion_named(tmp_path):
    """Each wheel on rollers has one no-slip condition and one friction force."""
    file = tmp_path / "v.toml"
    file.write_text(MECANUM.replace('"A"', '"45 deg"').replace('"B"', '"-45 deg"'))
    found = describe(file)
    assert not found.faults
    assert found.tree[3].endswith("wheel a: driven, disc radius 0.05 m on rollers at 45 degrees")
    assert facts(found)["no-slip conditions"] == "4, for 3 unknown rates"
    forces = "8: 1 of them are not determined by equilibrium: they are load-weighted"
    assert facts(found)["contact forces"] == forces
    file.write_text(MECANUM.replace('"A"', '"-45 deg"').replace('"B"', '"45 deg"'))
    found = describe(file)
    assert "resists its motion about a point 0 m to the right" in found.faults[0]
    assert facts(found)["driven wheels"] == "4: a, b, c, d"
    assert "resists its motion" in invoke("vehicle", str(file), code=2).stderr


def test_a_picture_of_the_vehicle(folder):
    """On level ground, or on that of a problem; other endings are refused before anything else."""
    (folder / "p.toml").write_text(VALID)
    for words, name in (([DATA / "cart.toml"], "cart.png"), (["p.toml"], "p.svg")):
        out = invoke("vehicle", *words, "--picture", name, code=0).stdout
        assert f"drew {name}" in out
        assert (folder / name).stat().st_size > 2e4
    assert "ends in .png" in invoke("vehicle", "p.toml", "--picture", "a.bmp", code=2).stderr
