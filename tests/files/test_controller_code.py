"""C code for a controller: it agrees with the models in Python, and with closed forms."""

import ctypes
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.commands import printed, refused
from slipfree import Bicubic, Grid, ModelError, catalog, inverse_kinematics, settle, simulate
from slipfree.files.controller import _c_name, export_controller
from slipfree.system import codegen_cache
from slipfree.vehicle.sections import section_of_radii
from slipfree.vehicle.tree import Vehicle, Wheel

pytestmark = pytest.mark.skipif(codegen_cache.compiler() is None, reason="no C compiler here")
STRICT = ["cc", "-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror"]
OK, NO_POSE, OFF_MAP, BAD_MAP = 0, 1, 2, 4
POSE, RATES = ("z", "roll", "pitch"), ("right_rate", "left_rate")


class Code:
    """Functions of generated code, called with records of numbers."""

    def __init__(self, files):
        header, source, test = self.files = files
        self.name, self.object = header.stem, source.with_suffix(".o")
        subprocess.run([*STRICT, "-fPIC", "-c", source, "-o", self.object], check=True)
        library, self.program = source.with_suffix(".so"), test.with_suffix("")
        subprocess.run(["cc", "-shared", self.object, "-o", library, "-lm"], check=True)
        self.library = ctypes.CDLL(str(library))
        records = re.findall(
            rf"typedef struct \{{(.*?)\}} {self.name}_(\w+);", header.read_text(), re.S
        )
        self.fields = {kind: re.findall(r"double (\w+); /\*", body) for body, kind in records}

    def run_test(self, test=None):
        """Return the finished test program."""
        test = test or self.files[2]
        place = ["-I", self.files[0].parent, self.object, test, "-o", self.program, "-lm"]
        subprocess.run([*STRICT, *place], check=True)
        return subprocess.run([self.program], capture_output=True, text=True, check=False)

    def call(self, function, *arguments):
        return getattr(self.library, f"{self.name}_{function}")(*arguments)

    def record(self, kind, **values):
        fields = self.fields[kind]
        assert set(values) <= set(fields)
        return (ctypes.c_double * len(fields))(*(values.get(name, 0.0) for name in fields))

    def values(self, kind, record):
        return dict(zip(self.fields[kind], record, strict=True))

    def ground(self, grid):
        """Return the ground of a map, and what must be kept alive with it."""
        table = (ctypes.c_double * ((grid.x.size + 2) * (grid.y.size + 2)))()
        heights = np.ascontiguousarray(grid.z)
        numbers = [ctypes.c_double(n) for n in (grid.x[0], grid.y[0], *grid.spacing)]
        counts = [ctypes.c_size_t(n) for n in grid.z.shape]
        ground = ctypes.create_string_buffer(64)
        at = ctypes.c_void_p(heights.ctypes.data)
        code = self.call("map", ground, at, *counts, *numbers, table)
        return code, (ground, table)

    def settled(self, ground, place):
        pose = self.record("pose")
        self.call("guess", ground, place, pose)
        return self.call("settle", ground, place, pose), pose

    def rates(self, ground, place, pose, **command):
        rates = self.record("rates")
        given = self.record("command", **command)
        assert self.call("inverse", ground, place, pose, given, rates) == OK
        return self.values("rates", rates)


PROBLEM = """\
verb = "inverse"
vehicle.catalog = "differential_drive"
start = { x = 0, y = 0, heading = 0 }
given = { forward = 0.2, yaw_rate = 0.1 }
time = { duration = 1, step = 0.5 }
terrain.synthetic = { x = [-2, 2], y = [-2, 2], spacing = 0.5 }
"""


@pytest.fixture(scope="module")
def cart(tmp_path_factory):
    """Code of an inverse problem, written by the command."""
    folder = tmp_path_factory.mktemp("cart")
    (folder / "problem.toml").write_text(PROBLEM)
    lines = printed("export", folder / "problem.toml", "--c", folder / "onboard").splitlines()
    code = Code([Path(line.removeprefix("wrote ")) for line in lines[:-1]])
    code.command = lines[-1]
    return code


def test_another_export_writes_the_same_code(cart, tmp_path):
    printed("export", cart.files[0].parents[1] / "problem.toml", "--c", tmp_path)
    for file in cart.files:
        assert (tmp_path / file.name).read_text() == file.read_text()


def test_code_agrees_with_the_models_in_100_states(cart):
    run = cart.run_test()
    assert run.returncode == 0, run.stdout
    assert "100 states, 0 failures" in run.stdout


def test_test_program_notices_an_error_of_1e_11(cart, tmp_path):
    text = cart.files[2].read_text()
    number = re.search(r"_pose poses\[CASES\] = \{\n  \{([^,]+),", text)
    wrong = tmp_path / "wrong.c"
    wrong.write_text(text.replace(number[0], f"{number[0][:-1]} + 1e-11,"))
    assert cart.run_test(wrong).returncode == 1


def test_command_prints_the_command_that_tests_the_code(cart):
    _, source, test = cart.files
    names = [f"differential_drive{ending}" for ending in (".h", ".c", "_test.c")]
    assert [file.name for file in cart.files] == names
    program = test.with_suffix("")
    compile_ = f"cc -std=c99 -pedantic -Wall -O2 -o {program} {source} {test} -lm"
    assert cart.command == f"to test: {compile_} && {program}"


def test_velocities_are_those_that_the_problem_gives_in_its_frame(cart):
    assert cart.fields["command"] == ["forward", "yaw_rate"]
    header = cart.files[0].read_text()
    assert "x right, y forward" in header
    assert "met exactly" in header


def test_cart_on_level_ground_drives_as_the_unicycle_model(cart):
    place = cart.record("place", x=1.0, y=2.0, heading=0.7, caster_angle=0.2)
    code, pose = cart.settled(None, place)
    assert code == OK
    assert_allclose(list(pose)[:3], [0.15, 0, 0], atol=1e-12)
    rates = cart.rates(None, place, pose, forward=0.4, yaw_rate=0.3)
    sides = [rates["right_rate"], rates["left_rate"]]
    assert_allclose(sides, [(0.4 + 0.25 * 0.3) / 0.15, (0.4 - 0.25 * 0.3) / 0.15], rtol=1e-12)
    assert_allclose(
        [rates["forward"], rates["right"], rates["yaw_rate"]], [0.4, 0, 0.3], atol=1e-15
    )


def test_cart_on_a_map_has_pose_and_rates_of_settle_and_simulate(cart):
    axis = np.linspace(-3.0, 3.0, 25)
    grid = Grid(axis, axis, 2.0 + 0.2 * np.sin(1.1 * axis)[:, None] * np.cos(0.9 * axis))
    code, (ground, _table) = cart.ground(grid)
    assert code == OK
    given = ["forward", "yaw_rate"]
    model = inverse_kinematics(catalog.differential_drive(), Bicubic(grid), given=given)
    at = {"x": 0.4, "y": -0.3, "heading": 0.5, "caster_angle": 0.1}
    start, place = settle(model, **at), cart.record("place", **at)
    code, pose = cart.settled(ground, place)
    assert code == OK
    values = cart.values("pose", pose)
    assert_allclose([values[n] for n in POSE], [start[n][0] for n in POSE], rtol=1e-11)
    inputs = model.inputs(forward=0.3, yaw_rate=0.2)
    run = simulate(model, start, inputs, np.array([0.0, 1e-3]))
    rates = cart.rates(ground, place, pose, forward=0.3, yaw_rate=0.2)
    assert_allclose([rates[n] for n in RATES], [run[n][0] for n in RATES], rtol=1e-9)


def test_codes_of_failures(cart):
    axis = np.linspace(-1.0, 1.0, 5)
    code, (ground, _table) = cart.ground(Grid(axis, axis, np.zeros((5, 5))))
    assert code == OK
    assert cart.settled(ground, cart.record("place", x=0.9))[0] == OFF_MAP
    pose = cart.record("pose", z=7.0)
    assert cart.call("settle", None, cart.record("place", x=np.nan), pose) == NO_POSE
    assert pose[0] == 7.0  # unchanged
    few = Grid(axis, axis, np.zeros((5, 5)))
    few.z.setflags(write=True)
    few.z[2, 2] = np.nan
    assert cart.ground(few)[0] == BAD_MAP


def test_code_calls_only_the_mathematical_library_and_has_no_data_that_change(cart):
    command = ["nm", "-f", "sysv", cart.object]
    rows = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    symbols = [[part.strip() for part in row.split("|")] for row in rows if row.count("|") == 6]
    sections = {row[6] for row in symbols[1:]}
    assert sections <= {".text", ".rodata", ".data.rel.ro.local", "*UND*"}
    outside = {row[0] for row in symbols[1:] if row[6] == "*UND*"} - {"_GLOBAL_OFFSET_TABLE_"}
    known = "sin cos tan atan atan2 tanh hypot sqrt floor fmin fmax __stack_chk_fail"
    assert outside <= {*known.split()}


@pytest.mark.slow  # three vehicles more: steered, six wheels, pressed wheels; 4 to 10 s each
@pytest.mark.parametrize("name", ["ackermann", "rocky7", "rigid_skid_steer"])
def test_code_of_other_vehicles_agrees_with_the_models(name, tmp_path):
    vehicle = getattr(catalog, name)()
    if name == "ackermann":  # its words would end a comment
        steer = replace(vehicle.coordinates[0], words="angle */ int x; /* left\npositive")
        vehicle = replace(vehicle, coordinates=(steer, *vehicle.coordinates[1:]))
    code = Code(export_controller(vehicle, tmp_path).files)
    run = code.run_test()
    assert run.returncode == 0, run.stdout
    if name == "ackermann":
        _check_bicycle(code)


def _check_bicycle(car):
    """Check a car on level ground against the bicycle model."""
    place = car.record("place", heading=0.7, steer=0.2)
    code, pose = car.settled(None, place)
    assert code == OK
    turn = 0.4 * np.tan(0.2) / 0.7
    rates = car.rates(None, place, pose, v_x=0.4, omega_z=turn)
    expected = [(0.4 + 0.3 * turn) / 0.15, (0.4 - 0.3 * turn) / 0.15]
    assert_allclose([rates["rear_right_rate"], rates["rear_left_rate"]], expected, rtol=1e-6)
    assert_allclose(rates["steer_target"], 0.2, rtol=1e-6)
    for _ in range(4):  # the target is a Gauss-Newton step, since the joint steers two wheels
        sharper = car.rates(None, place, pose, v_x=0.4, omega_z=2 * turn)
        place[3] = sharper["steer_target"]
        assert car.call("settle", None, place, pose) == OK
    assert_allclose(place[3], np.arctan(2 * 0.7 * turn / 0.4), rtol=1e-6)


def test_refusals_name_the_remedy(tmp_path):
    given = "velocity_x = 0.2, velocity_y = 0, heading_rate"
    (tmp_path / "p.toml").write_text(PROBLEM.replace("forward = 0.2, yaw_rate", given))
    message = refused("export", tmp_path / "p.toml", "--c", tmp_path / "out")
    assert "expected velocities from forward, right, yaw_rate" in message
    assert "give velocities in the frame of the heading" in message
    message = refused("export", tmp_path / "p.toml", "--c", tmp_path, "--path", tmp_path / "a.csv")
    assert "found both; omit --c" in message
    (tmp_path / "out.nc").write_bytes(b"CDF")
    assert "expected a problem file" in refused("export", tmp_path / "out.nc", "--c", tmp_path)
    with pytest.raises(ModelError, match="locked to a vertical"):
        export_controller(catalog.step_climber(), tmp_path)


def test_names_that_are_equal_in_c_are_refused(tmp_path):
    wheels = [("a-b", 0.3, 0.0), ("a_b", -0.3, 0.0), ("front", 0.0, 0.5)]
    disc = section_of_radii(0.0, 0.1)
    twins = Vehicle(
        "x", (), (), tuple(Wheel(n, "platform", (x, y, 0.0), disc, True) for n, x, y in wheels)
    )
    with pytest.raises(ModelError, match=r"'contact_x\[a-b\]' and 'contact_x\[a_b\]'; rename"):
        export_controller(twins, tmp_path)


@pytest.mark.parametrize("name", ["NULL", "M_PI", "bool", "linux", "operator"])
def test_names_of_macros_and_keywords_are_no_names_in_c(name):
    assert _c_name(name) == f"{name}_"
    assert _c_name("left") == "left"
