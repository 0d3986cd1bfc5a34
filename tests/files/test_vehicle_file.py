"""Tests of vehicle files: the described vehicle, and errors with their lines."""

import math
import re
from dataclasses import fields
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from helpers.cases import DATA, PROBLEMS, hills
from helpers.commands import error_of, invoke, refused, refuses, sets
from slipfree import Analytic, direct_kinematics, settle, simulate
from slipfree.files import vehicle_toml
from slipfree.files.maps import elevation
from slipfree.files.toml import ProblemError
from slipfree.files.vehicle_toml import Draft, from_rep103, rotation_of, vehicle_text
from slipfree.geometry.frame import Pose, unit_vector
from slipfree.problem.build_vehicle import VehicleError, read_vehicle
from slipfree.problem.schema import CATALOG
from slipfree.vehicle.sections import Disc, Omni, Sphere, Torus
from slipfree.vehicle.tree import Joint, Motor, Torque, VehicleParts


def rep103(vector):
    """Return a vector of axes x right, y forward in axes x forward, y left."""
    right, forward, up = vector
    return (forward, -right, up)


def driven(vehicle):
    """Drive over hills at rates that differ from wheel to wheel and from joint to joint."""
    dae = direct_kinematics(vehicle, Analytic(hills))
    names = [
        *(f"{w.name}_rate" for w in vehicle.wheels if w.driven),
        *(f"{c.name}_rate" for c in vehicle.of("commanded")),
    ]
    rates = {name: 0.5 + 0.1 * k if k < 2 else 0.2 for k, name in enumerate(names)}
    return simulate(dae, settle(dae), dae.inputs(**rates), np.linspace(0, 0.5, 6))


def numbers(draft):
    """Return all numbers of a draft."""
    return np.array(re.findall(r"-?\d+(?:\.\d+)?(?:e-?\d+)?", repr(draft)), float)


@pytest.mark.parametrize("name", CATALOG)
def test_four_quarter_turns_of_the_axes_are_none(name):
    """Of all places, axes, shapes and inertias: x to the right becomes x forward, and so on."""
    vehicle = CATALOG[name]()
    parts = {part.name: getattr(vehicle, part.name) for part in fields(VehicleParts)}
    turned = [from_rep103(Draft(**parts))]
    for _ in range(4):
        turned.append(from_rep103(turned[-1]))
    assert_allclose(numbers(turned[4]), numbers(turned[0]), rtol=0, atol=1e-12)
    assert not np.array_equal(numbers(turned[1]), numbers(turned[0]))


def test_turned_parts_of_any_frame(rng):
    """Axes, places and turns convert together, at a quarter turn of the middle angle as well."""
    turns = [tuple(rng.uniform(-3, 3, 3)) for _ in range(20)]
    turns += [(0.3, np.pi / 2, -0.4), (0.3, -np.pi / 2, -0.4), (0.0, 0.0, 0.7)]
    base = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for turned in turns:
        axis, at = tuple(rng.normal(size=3)), tuple(rng.normal(size=3))
        joint = Joint("part", "platform", axis, at, "angle", turned=turned)
        (ours,) = from_rep103(Draft("", (), (joint,), ())).joints
        pose = ours.pose({"angle": ca.SX(0.6)})
        inside = Rotation.from_rotvec(0.6 * np.array(unit_vector(axis))).as_matrix()
        expected = Rotation.from_euler("xyz", turned).as_matrix()
        assert_allclose(rotation_of(turned), expected, atol=1e-14)
        assert_allclose(
            np.array(ca.evalf(pose.rotation)), base @ expected @ inside @ base.T, atol=1e-13
        )
        assert_allclose(np.array(ca.evalf(pose.origin)).ravel(), base @ at, atol=1e-15)


LONG = (DATA / "cart_in_long_form.toml").read_text()
SHORT = (DATA / "cart_in_short_form.toml").read_text()


def read(folder, text):
    (folder / "v.toml").write_text(text)
    return read_vehicle(folder / "v.toml")


def faults(folder, text):
    caught = error_of(VehicleError, read, folder, text)
    return [each.replace(f"{folder}/", "") for each in caught.faults], caught.draft


def test_long_and_short_form_are_one_vehicle(tmp_path):
    vehicle = read(tmp_path, LONG)
    assert vehicle == read(tmp_path, SHORT)
    assert len(SHORT.splitlines()) < 10
    caster = vehicle.wheels[2]
    assert (caster.section, caster.driven, caster.at) == (Disc(0.1), False, (0, -0.08, -0.05))
    assert {wheel.axle for wheel in vehicle.wheels} == {(1.0, 0.0, 0.0)}


FAULTS = r"""
frame = "rep103"\n|  |v.toml:1: frame: expected 'paper' (x right, y forward, z up) or 'rep103' (x
axis = "z"|axis = [0, 0, 0]|v.toml:11: joints[0].axis (joint 'fork'): expected 'x', 'y', 'z' or a
parent = "fork"|parent = "frok"|'platform': platform, fork, found 'frok'; did you mean 'fork'?
"fork"\nparent = "platform"|"fork"\nparent = "fork"|a loop: fork on fork; cut the loop at one joint
at = [0.35, 0, 0]|at = [0.08, 0, 0]|v.toml:1: vehicle 'cart': expected wheels that are not all on
name = "right"|name = "left"|v.toml:23: wheels[1].name (wheel 'left'): expected a unique name, found
name = "right"|name = "swivel"|found 'swivel', also the name of coordinates[0]
kind = "passive"|kind = "suspension"|(swivel); remove it, set its kind to 'passive' or 'commanded',
value = "swivel"|value = "swivl"|found 'swivl'; did you mean 'swivel'? correct it, or add { name =
value = "swivel"|value = "2 swivel"|v.toml:13: joints[0].value (joint 'fork'): expected a formula of
value = "swivel"|value = "0"|v.toml:4: coordinates[0] (coordinate 'swivel'): expected a joint whose
name = "swivel"|name = "sin"|v.toml:5: coordinates[0].name (coordinate 'sin'): expected a name other
kind = "passive"|kind = "passive"\nupper = 45|radians (did you mean 45 degrees? write "45 deg"),
kind = "passive"|kind = "passive"\nlower = 1.0\nupper = 0.5|the lower stop must be below the upper
at = [0, -0.25, 0]|at = [0, -250, 0]|at least -100 (did you mean millimetres? write -0.25), found
at = [0, -0.25, 0]|at = [0, -0.25, 0]\nmass = 1e200|v.toml:26: wheels[1].mass (wheel 'right'):
radius = 0.1\n|radius = 100\n|wheel caster in m that suits its place, at most 2.83, found 100 (did
radius = 0.1\n|radius = 0.1\ntube = 0.2|expected at most the radius, 0.1 m (a ball), found 0.2
frame = "rep103"|frame = "rep103"\ncenter_of_mass = [0, 0]|v.toml:3: center_of_mass[2]: expected a
frame = "rep103"|frame = "rep103"\nweight = 3|v.toml:3: weight: expected one of name, frame, mass,
"""  # old and new text of the file, and words of the error
SLIDES = """value = "swivel"
motion = "slide"
[[joints]]
name = "b"
parent = "platform"
axis = "z"
value = "swivel"
"""
DRIVE = "{ kind = 'motor', stall = 2.0, no_load = 20, kp = 5.0 }"
ADDED = [  # after what: a line, and words of the error
    ('"rep103"', "inertia = [1, 2, -3, 0, 0, 0]", "principal moments of inertia must be"),
    ('"rep103"', "inertia = [1, 1, 5, 0, 0, 0]", "sum of the others, found 1, 1, 5 kg m^2; c"),
    ("radius = 0.1\n", "drive = { kind = 'steam' }", "'kind' is one of 'rate', 'torque', 'm"),
    ("radius = 0.1\n", "drive = { kind = 'motor', stall = 2 }", "drive.no_load"),
    ('"passive"', "drive = { kind = 'steam' }", "v.toml:7: coordinates[0].drive (coordinate 'swi"),
    ('"passive"', f"drive = {DRIVE}", "expected a drive only for kind = 'commanded', found Motor"),
]
RIGHT = LONG[LONG.index('[[wheels]]\nname = "right"') : LONG.index('[[wheels]]\nname = "caster"')]


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        *(
            [part.replace("\\n", "\n").strip(" ") for part in line.split("|")]
            for line in FAULTS.strip().splitlines()
        ),
        *((old, f"{old.rstrip()}\n{line}\n", fault) for old, line, fault in ADDED),
        (RIGHT, "", "v.toml:15: wheels: expected at least three wheels, so that the vehicle can"),
        ('value = "swivel"\n', SLIDES, "expected only turning or only sliding joints whose value"),
        ('axis = "z"', f"axis = [{10**400}, 0, 0]", "v.toml:11: joints[0].axis (joint 'fork'):"),
        ('"swivel"\n\n', f'"{"-" * 990}swivel"\n\n', "v.toml:13: joints[0].value (joint 'fork'):"),
        ('value = "swivel"', 'value = "swivel/0"', "expected a finite value, found none; corr"),
    ],
)
def test_one_fault(old, new, fault, tmp_path):
    assert LONG.count(old) == 1
    assert any(fault in message for message in faults(tmp_path, LONG.replace(old, new))[0])


def test_a_syntax_error_has_its_line(tmp_path):
    with pytest.raises(ProblemError, match=r"v.toml:8: expected TOML, found an error in column 9"):
        read(tmp_path, LONG.replace("[[joints]]", "[[joints]"))


def test_a_wheels_axle_may_point_anywhere(tmp_path):
    text = LONG.replace("radius = 0.1\n", "radius = 0.1\naxle = [1, -1, 0]\nrollers = '90 deg'\n")
    wheel = read(tmp_path, text).wheels[2]
    assert_allclose(unit_vector(wheel.axle), np.array([1, 1, 0]) / np.sqrt(2))
    assert wheel.rollers
    rest = Pose(ca.SX.eye(3), ca.SX.zeros(3))
    forward = ca.evalf(read(tmp_path, LONG).carriers(rest, {"swivel": ca.SX(0.1)})[2].rotation)
    assert_allclose(np.array(forward)[:2, 1], [-np.sin(0.1), np.cos(0.1)])


@pytest.mark.parametrize(
    ("keys", "section"),
    [
        ('section = "torus"\nr1 = 0.02\nr2 = 0.08', Torus(0.02, 0.08)),
        ('section = "disc"\nradius = 0.1', Disc(0.1)),
        ('section = "sphere"\nradius = 0.1\nrollers = "90 deg"', Omni(Sphere(0.1))),
        ("radius = 0.1\ntube = 0.1", Sphere(0.1)),
        ("radius = 0.1\nrollers = '90 deg'", Omni(Disc(0.1))),
        ("radius = 0.1\nrollers = '-45 deg'", Omni(Disc(0.1), -np.pi / 4)),
        ("radius = 0.1\nrollers = 0.5", Omni(Disc(0.1), 0.5)),
        ("radius = 0.1\nrollers = 1", Omni(Disc(0.1), 1.0)),
        ("radius = 0.1\nrollers = false", Disc(0.1)),
    ],
)
def test_sections_by_name_or_by_radius_and_tube(tmp_path, keys, section):
    assert read(tmp_path, LONG.replace("radius = 0.1\n", f"{keys}\n")).wheels[2].section == section


@pytest.mark.parametrize("angle", [np.pi / 2, -np.pi / 4, 0.5, math.radians(30)])
def test_rollers_are_written_as_they_are_read(tmp_path, angle):
    text = LONG.replace("radius = 0.1\n", f"radius = 0.1\nrollers = {angle!r}\n")
    vehicle = read(tmp_path, text)
    again = vehicle_text(vehicle)
    assert read(tmp_path, again).wheels == vehicle.wheels
    if angle == -np.pi / 4:
        assert 'rollers = "-45 deg"' in again


@pytest.mark.parametrize("value", ["true", '"45 deg/s"', '"135 deg"', "0", "[1.0]", "45"])
def test_wrong_angles_of_rollers_are_refused(tmp_path, value):
    text = LONG.replace("radius = 0.1\n", f"radius = 0.1\nrollers = {value}\n")
    words = r"rollers.*: expected the angle from the wheel's axle to the axles of its rollers"
    words = "did you mean 45 degrees" if value == "45" else words
    refuses(VehicleError, words, read, tmp_path, text)


ROCKERS = """\
name = "rover"
frame = "rep103"
{}
coordinates = [{{ name = "a", kind = "suspension" }}, {{ name = "b", kind = "suspension"{} }}]
joints = [{{ name = "left", parent = "platform", axis = "y", at = [0, 0.3, 0], value = "a" }},
    {{ name = "right", parent = "platform", axis = "y", at = [0, -0.3, 0], value = "{}" }}]
wheels = [{{ name = "lf", parent = "left", at = [0.3, 0, 0], radius = 0.1, driven = true }},
    {{ name = "lr", parent = "left", at = [-0.3, 0, 0], radius = 0.1 }},
    {{ name = "rf", parent = "right", at = [0.3, 0, 0], radius = 0.1, driven = true }},
    {{ name = "rr", parent = "right", at = [-0.3, 0, 0], radius = 0.1 }}]
"""


def test_coupled_joints_have_a_common_coordinate(tmp_path):
    vehicle = read(tmp_path, ROCKERS.format("couple = { left = 1, right = 1 }", "", "b"))
    assert [c.name for c in vehicle.coordinates] == ["a"]
    assert [joint.value for joint in vehicle.joints] == ["a", "-a"]
    geared = read(tmp_path, ROCKERS.format("couple = { right = 1, left = -2 }", "", "b"))
    assert [joint.value for joint in geared.joints] == ["0.5*b", "b"]


@pytest.mark.parametrize(
    ("couple", "more", "value", "words"),
    [
        ("{ left = 1, right = 1 }", "", "b + a", "couple.left: expected a joint whose value is a"),
        ("{ left = 1, right = 1 }", ", lower = -1", "b", "found lower in 'b'; move them to 'a'"),
    ],
)
def test_wrong_couplings_are_named(couple, more, value, words, tmp_path):
    found, _ = faults(tmp_path, ROCKERS.format(f"couple = {couple}", more, value))
    assert any(words in each for each in found)


@pytest.mark.parametrize("name", ["trike", "trailer"])
def test_examples_written_by_the_page_alone(name):
    path = PROBLEMS / "vehicles" / f"{name}.toml"
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    assert len(lines) <= 10
    run = driven(read_vehicle(path))
    assert run.stop is None
    assert run["closure_residual"].max() < 1e-12


def test_the_trike_turns_about_one_point():
    """All three axles meet in one point: on level ground nothing slips."""
    vehicle = read_vehicle(PROBLEMS / "vehicles" / "trike.toml")
    dae = direct_kinematics(vehicle, Analytic(lambda x, _: 0 * x))
    rates = dae.inputs(rear_rate=2.0, steer_rate=0.0)
    run = simulate(dae, settle(dae, steer=0.4), rates, np.linspace(0, 2, 5))
    assert_allclose(run["heading"], run.t * 2.0 * 0.25 * np.tan(0.4), atol=1e-9)
    for slip in ("slip_along", "slip_across"):
        assert_allclose(run[slip], 0, atol=1e-12)


def test_the_page_holds_what_it_says(tmp_path):
    """The examples of the documentation are vehicles of ten lines."""
    page = (PROBLEMS.parent / "docs" / "vehicles.md").read_text()
    blocks = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    vehicles = [block for block in blocks if "wheels = [" in block]
    assert len(vehicles) == 3
    for block in vehicles:
        assert len(block.splitlines()) <= 10
        assert driven(read(tmp_path, block)).stop is None
    for name in CATALOG:
        assert f"| `{name}` |" in page
    for name in ("Coordinate", "Joint", "Wheel", "Vehicle"):
        table = getattr(vehicle_toml, f"{name}Table")
        for key in table.model_fields:
            assert f"`{key}`" in page


PROBLEM = """\
verb = "direct"
terrain.synthetic = { x = [-3, 3], y = [-3, 3], spacing = 0.5 }
vehicle.file = "v.toml"
start = {}
inputs = { left_rate = 1.0, right_rate = 1.0 }
time = { duration = 1.0, step = 0.5 }
"""


@pytest.fixture
def folder(folder):
    (folder / "v.toml").write_text(SHORT)
    (folder / "p.toml").write_text(PROBLEM)
    return folder


@pytest.mark.slow
def test_a_file_lies_beside_the_problem(folder, monkeypatch):
    (folder / "elsewhere").mkdir()
    monkeypatch.chdir(folder / "elsewhere")
    assert invoke("check", "../p.toml").exit_code == 0
    example = invoke("check", PROBLEMS / "your_vehicle.toml", code=0)
    assert "tractor and trailer: left 0.2 m driven" in example.stdout


@pytest.mark.usefixtures("folder")
def test_a_problem_drives_a_vehicle_file():
    result = invoke("run", "p.toml", "--no-draw", "-v", code=0)
    assert "cart: left 0.15 m driven, right 0.15 m driven, caster 0.1 m free" in result.stdout
    invoke("check", "p.toml", *sets('vehicle.actuated=["swivel"]', "inputs.swivel_rate=0"), code=0)
    scaled = 'vehicle={catalog="differential_drive", caster_scale=0.5}'
    assert "caster 0.075 m free" in invoke("check", "p.toml", "--set", scaled).stdout
    assert "found the input v.toml" in refused("run", "p.toml", "-o", "v.toml")


@pytest.mark.usefixtures("folder")
def test_a_run_parses_its_vehicle_and_reads_its_map_once(monkeypatch):
    axis = np.linspace(-3, 3, 13)
    np.savez("g.npz", x=axis, y=axis, z=np.zeros((13, 13)))
    Path("v.toml").write_text(f"# parsed once\n{SHORT}")
    files = []
    for module, name in ((vehicle_toml.toml, "parse_toml"), (elevation, "read_map")):
        original = getattr(module, name)

        def counted(path, *rest, original=original, **options):
            files.append(path.name)
            return original(path, *rest, **options)

        monkeypatch.setattr(module, name, counted)
    ground = ["--set", "terrain={file='g.npz'}"]
    assert "cart: left" in invoke("run", "p.toml", "-v", *ground, code=0).stdout
    assert sorted(files) == ["g.npz", "v.toml"]


def test_inertia_and_drives_are_read_with_the_axes_of_the_file(tmp_path):
    text = LONG.replace('frame = "rep103"', 'frame = "rep103"\ninertia = [2, 3, 4, 0.1, 0.2, 0.3]')
    text = text.replace(
        "radius = 0.1\n", f"radius = 0.1\ninertia = [0.01, 0.006]\ndrive = {DRIVE}\n"
    )
    (tmp_path / "v.toml").write_text(text)
    vehicle = read_vehicle(tmp_path / "v.toml")
    assert vehicle.body.inertia == (3, 2, 4, -0.1, -0.3, 0.2)
    assert vehicle.wheels[2].inertia == (0.01, 0.006)
    assert vehicle.wheels[2].drive == Motor(2.0, 20.0, 5.0)


def test_drives_of_coordinates_are_read(tmp_path):
    for drive, words in (
        (Torque(), "{ kind = 'torque' }"),
        (Motor(2.0, 20.0, 5.0, 1.0, 0.1), DRIVE.replace("}", ", ki = 1, rotor_inertia = 0.1 }")),
    ):
        text = LONG.replace(
            'kind = "passive"', f'kind = "commanded"\nstiffness = 3\ndrive = {words}'
        )
        (swivel,) = read(tmp_path, text).coordinates
        assert (swivel.drive, swivel.stiffness) == (drive, 3.0)


SHAPED = """
name = "cart"
frame = "{frame}"
shapes = [
    {{ kind = "box", size = [{size}], at = [{at}], turned = [0, 0, "90 deg"] }},
    {{ kind = "ball", radius = 0.05, at = [{ball}] }},
    {{ kind = "hull", points = [[{at}], [{ball}]] }}]
wheels = [
    {{ name = "right", parent = "platform", at = [{right}], radius = 0.2, driven = true }},
    {{ name = "left", parent = "platform", at = [{left}], radius = 0.2, driven = true }},
    {{ name = "front", parent = "platform", at = [{front}], radius = 0.2 }}]
"""


def test_shapes_are_read_in_the_frame_of_the_file_and_written_back(tmp_path):
    """A file in either frame has the same shapes; the box keeps its own axes."""
    places = {
        "at": (0.1, 0.3, 0.1),
        "ball": (0.0, 0.1, 0.4),
        "right": (0.4, 0, 0),
        "left": (-0.4, 0, 0),
        "front": (0, 0.7, 0),
    }
    ground, clear = Analytic(lambda x, y: 0.05 * x * y), []
    for frame, turned in (("paper", tuple), ("rep103", rep103)):
        texts = {name: ", ".join(map(str, turned(place))) for name, place in places.items()}
        text = SHAPED.format(frame=frame, size="0.6, 0.2, 0.1", **texts)
        vehicle = read(tmp_path, text)
        run = settle(direct_kinematics(vehicle, ground), x=0.3, y=0.2, heading=0.4)
        clear.append(run["clearance_body"][0])
        again = read(tmp_path, vehicle_text(vehicle))
        assert again.body.shapes == vehicle.body.shapes
        box, ball, _ = vehicle.body.shapes
        assert_allclose(box.at, places["at"], atol=1e-12)
        assert_allclose(ball.at, places["ball"], atol=1e-12)
    # the box's x axis is the y axis of either frame: forward, or to the left
    assert len({round(value, 6) for value in clear}) == 2
    text = SHAPED.format(frame="rep103", size="0.2, 0.6, 0.1", **texts)
    run = settle(direct_kinematics(read(tmp_path, text), ground), x=0.3, y=0.2, heading=0.4)
    assert_allclose(run["clearance_body"][0], clear[0], atol=1e-12)


def test_errors_in_shapes_name_the_key_and_what_is_expected(tmp_path):
    numbers = dict.fromkeys(("at", "ball", "right", "left", "front"), "0.1, 0.2, 0.3")
    text = SHAPED.format(frame="paper", size="0.6, 0, 0.1", **numbers)
    text = text.replace('"ball"', '"cube"').replace("points = [", "points = [], point = [")
    error = error_of(VehicleError, read, tmp_path, text)
    for words in (
        "shapes[0].size[1]: expected a number greater than 0, found 0",
        "shapes[1]: expected a table whose 'kind' is one of 'box', 'ball', 'hull'",
        "shapes[2].points: expected",
        "shapes[2].point: did you mean 'points'?",
    ):
        assert words in str(error)
