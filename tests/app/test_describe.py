"""Tests of the description of a vehicle: from its file, from a problem, and if incomplete."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.cases import DATA
from helpers.commands import invoke
from helpers.problem_files import VALID
from slipfree import Analytic, direct_kinematics, settle
from slipfree.catalog import ackermann, differential_drive, rocky7, skid_steer
from slipfree.core.errors import DataError
from slipfree.problem.load import load_problem
from slipfree.problem.report import conditioning, describe
from slipfree.problem.result import build


def facts(found):
    return dict([*found.facts, *found.details])


def test_a_vehicle_file_by_itself():
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
    assert facts(found)["inputs"] == "2: left_drive_rate, right_drive_rate"
    assert facts(found)["suspension"] == "0 of 0 for exact contact of all wheels"
    assert facts(found)["condition of rates"].endswith(
        "at the start, least determined: caster_rate"
    )
    assert dict(found.wheels[0]) == {
        "wheel": "left_drive", "place (m)": "-0.25, 0, 0", "radius (m)": "0.15",
        "width (m)": "0.04", "driven": "yes", "steered": "no", "mass (kg)": "1.5",
        "partner": "right_drive",
    }  # fmt: skip
    assert found.wheels[2]["steered"] == "free"
    assert facts(found)["track"] == "0.5 m"
    notes = [words for name, words in found.facts if name == "vehicle file"]
    assert notes[0] == "omitted, since they carry no wheel and no mass: lidar_mount"
    assert notes[1].startswith("wheel right_drive: its rate is positive forward, opposite")


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
        assert ("no-slip conditions" in out) == is_shown
        assert "partner" in out


BROKEN = """\
name = "six"
frame = "rep103"
coordinates = [{ name = "a", kind = "suspension" }, { name = "b", kind = "passive" }]
joints = [
    { name = "p", parent = "platform", axis = "y", value = "a" },
    { name = "q", parent = "r", axis = "y", value = "b" },
    { name = "r", parent = "q", axis = "y", value = "0" },
]
wheels = [
    { name = "one", parent = "p", radius = 0.1, driven = true },
    { name = "two", parent = "q", radius = 0.1 },
    { name = "three", parent = "platform", at = [1, 0, 0], radius = 0.1 },
    { name = "four", parent = "hub", radius = 0.1 },
    { name = "five", parent = "platform", radius = 0.1 },
]
"""


def test_what_can_be_said_of_what_is_no_vehicle(tmp_path):
    (tmp_path / "v.toml").write_text(BROKEN)
    result = invoke("vehicle", str(tmp_path / "v.toml"), code=2)
    assert "  p: turns about -x by a (suspension)" in result.stdout
    assert "not connected to the platform: q, on r" in result.stdout
    assert "not connected to the platform: wheel four, on hub" in result.stdout
    assert "1: a; at most 2" in result.stdout
    faults = [line.partition("v.toml:")[2] for line in result.stderr.splitlines()]
    assert [fault.partition(": expected")[0] for fault in faults] == [
        "6: joints[1].parent (joint 'q')",
        "13: wheels[3].parent (wheel 'four')",
    ]


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
    assert facts(found)["no-slip conditions"].startswith("1 besides the contacts")
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
