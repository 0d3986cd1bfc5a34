"""Tests of xacro files: trust, expansion, expressions in URDF; files of other formats."""

import os
import sys
import time
from pathlib import Path

import pytest

from helpers.commands import error_of, invoke, printed, refused, refuses
from slipfree.core.errors import DataError
from slipfree.files import netcdf
from slipfree.files.urdf.elements import read_tree
from slipfree.files.urdf.xacro import expanded
from slipfree.problem.build_vehicle import (
    VehicleError,
    guessed_completion,
    is_vehicle_file,
    read_vehicle,
)
from slipfree.problem.inputs import recipe_of
from slipfree.problem.load import load_problem
from slipfree.problem.result import build, open_result
from slipfree.problem.verbs.base import world_of
from slipfree.sweep import RunTask, sweep_of, work

NAMES = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
WHEEL = f"""<robot {NAMES}>
  <xacro:macro name="wheel" params="n x y">
    <link name="wheel_${{n}}"><inertial><mass value="1"/></inertial><collision>
      <origin rpy="${{pi / 2}} 0 0"/>
      <geometry><cylinder radius="$(arg radius)" length="0.05"/></geometry></collision></link>
    <joint name="joint_${{n}}" type="continuous"><parent link="base"/><child link="wheel_${{n}}"/>
      <origin xyz="${{x}} ${{y}} 0"/><axis xyz="0 1 0"/></joint>
  </xacro:macro>
</robot>"""
ROBOT = f"""<robot name="cart" {NAMES}>
  <xacro:arg name="radius" default="0.1"/>
  <xacro:include filename="$(find my_cart)/urdf/wheel.xacro"/>
  <link name="base"/>
  <xacro:wheel n="a" x="0.2" y="0.2"/>
  <xacro:wheel n="b" x="0.2" y="${{-2 * 0.1}}"/>
  <xacro:wheel n="c" x="-0.2" y="0"/>
</robot>"""


@pytest.fixture
def robot(tmp_path):
    folder = tmp_path / "my_cart" / "urdf"
    folder.mkdir(parents=True)
    (folder / "wheel.xacro").write_text(WHEEL)
    (folder / "cart.urdf.xacro").write_text(ROBOT)
    return folder / "cart.urdf.xacro"


def test_macros_includes_and_arguments_are_expanded(robot):
    vehicle = read_vehicle(robot, trust=True)
    assert [each.at for each in vehicle.wheels] == [(-0.2, 0.2, 0), (0.2, 0.2, 0), (0, -0.2, 0)]
    assert [each.radius for each in vehicle.wheels] == [0.1] * 3
    assert is_vehicle_file(robot)
    completion = robot.parent / "cart.toml"
    completion.write_text('urdf = "cart.urdf.xacro"\narguments = { radius = "0.15" }')
    assert [each.radius for each in read_vehicle(completion, trust=[robot]).wheels] == [0.15] * 3
    assert "ament_index_python" not in sys.modules


PROGRAM = (  # passes the check of xacro for names with two underscores
    "${(lambda: [c for c in ().__class__.__base__.__subclasses__() if c.__name__ == "
    "'catch_warnings'][0]()._module.__builtins__['open']('MARK', 'w').write('ran'))()}"
)
PROBLEM = """verb = "direct"
vehicle = { file = "FILE" }
terrain.synthetic = { x = [-2, 2], y = [-2, 2], spacing = 0.2 }
start = {}
driver = { name = "straight", speed = 0.2 }
time = { duration = 0.2, step = 0.1 }
"""


@pytest.fixture
def hostile(robot, monkeypatch):
    """Return a folder with files that name a xacro file with a program, as the current one."""
    folder = robot.parent
    monkeypatch.chdir(folder)
    bad = ROBOT.replace("<link", f'<xacro:property name="m" value="{PROGRAM}"/><link n="${{m}}"')
    Path("evil.xacro").write_text(bad)
    Path("evil.urdf").write_text(bad)
    Path("evil.xml").write_text(bad)
    Path("link.toml").symlink_to("evil.xacro")
    Path("link.urdf").symlink_to("evil.xacro")
    Path("part.urdf").write_text(
        f'<robot {NAMES}><xacro:include filename="evil.xacro"/><link name="b"/></robot>'
    )
    Path("v.toml").write_text('urdf = "evil.xacro"\narguments = { radius = "$(eval 1)" }\n')
    for name in ("evil.xacro", "v.toml", "link.urdf"):
        Path(f"{name}.p.toml").write_text(PROBLEM.replace("FILE", name))
    yield folder
    assert not Path("MARK").exists()


@pytest.mark.usefixtures("hostile")
def test_programs_run_only_if_the_command_line_trusts_the_file():
    files = ("evil.xacro", "evil.urdf", "evil.xml", "link.toml", "link.urdf", "part.urdf", "v.toml")
    for name in files:
        trusted = name if name != "v.toml" else "evil.xacro"
        with pytest.raises(DataError, match=rf"trust it: .* add --trust {trusted} to the command"):
            read_vehicle(name)
        refuses(DataError, "xacro is a program", read_vehicle, name, trust=["cart.urdf.xacro"])
    for name in ("evil.xacro", "v.toml", "link.urdf"):
        assert "xacro is a program" in refused("check", f"{name}.p.toml")
        task = RunTask(1, recipe_of(load_problem(f"{name}.p.toml")), ())
        assert "xacro is a program" in work(task).row.words
    for words in (["run", "v.toml.p.toml"], ["vehicle", "evil.urdf"], ["vehicle", "v.toml.p.toml"]):
        assert "xacro is a program" in refused(*words)
    assert "a xacro file to trust, found that it cannot be read" in refused(
        "check", "v.toml.p.toml", "--trust", "no.xacro"
    )
    words = refused("vehicle", "v.toml", "--trust", "evil.xacro")
    assert "v.toml:2: arguments.radius: expected letters, digits" in words


def test_trust_reaches_every_reader_and_results_need_none(robot, monkeypatch):
    monkeypatch.chdir(robot.parent)
    Path("p.toml").write_text(PROBLEM.replace("FILE", robot.name))
    trusting = ["--trust", robot.name]
    assert "guessed: driven (no wheel " in printed("run", "p.toml", "--no-draw", *trusting)
    invoke("vehicle", robot.name, *trusting, code=0)
    assert "wheels.joint_a = {" in guessed_completion(robot, robot.parent, [robot])
    problem = load_problem("p.toml", trust=[robot.name])
    assert recipe_of(problem).trusted == problem.trusted != frozenset()
    sweep = sweep_of(Path("p.toml"), ["driver.speed=0.1"], trust=[Path(robot.name)])
    recipe = recipe_of(sweep.problem, "driver.speed=0.1")
    done = work(RunTask(1, recipe, ("driver.speed=0.1",), keep=True))
    netcdf.write("run.nc", done.trajectory, done.arrays)
    vehicle = read_vehicle(robot.name, trust=True)
    assert build(problem).vehicle == vehicle
    robot.unlink()
    os.mkfifo(robot)  # reading it would not end
    for file in ("p.nc", "run.nc"):
        assert world_of(open_result(file)).vehicle == vehicle
    for words in (
        "info p.nc",
        "show p.nc --html p.html",
        "export p.nc --mcap p.mcap",
        "export p.nc --rates p.csv",
    ):
        assert "stored_world" not in printed(*words.split())


@pytest.mark.usefixtures("hostile")
def test_a_result_without_its_vehicle_reads_no_file():
    Path("p.toml").write_text(PROBLEM.replace('file = "FILE"', 'catalog = "rocky7"'))
    invoke("run", "p.toml", "--no-draw", code=0)
    run, arrays = netcdf.read("p.nc"), netcdf.read_arrays("p.nc")
    run.attributes["problem"] = PROBLEM.replace("FILE", "evil.xacro")
    netcdf.write("evil.nc", run, arrays)
    run.attributes["settings"] = "vehicle.file=link.urdf\ntrust=evil.xacro"
    netcdf.write("more.nc", run, arrays)
    for name in ("evil.nc", "more.nc"):
        invoke("info", name, code=0)
        for words in (["show", name, "--html", "a.html"], ["export", name, "--mcap", "a.mcap"]):
            words = refused(*words)
            assert "expected" in words
            assert "evil.xacro:" not in words


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ('<xacro:property name="x" value="${9**9**9}"/><link name="${x}"/>', "takes longer than"),
        ("<link name=\"${'a' * 10**10}\"/>", "needs more than 2 GB of memory"),
        ('<xacro:include filename="pipe"/>', "expected xacro, found a pipe, not a regular file"),
        ('<xacro:include filename="no.xacro"/>', "No such file or directory"),
        ("<link name=\"${xacro.fatal('\\x1b[31mred')}\"/>", "found: \\x1b[31mred when"),
    ],
)
def test_expansion_has_limits(line, words, robot, monkeypatch):
    monkeypatch.setattr("slipfree.files.urdf.xacro.MAX_SECONDS", 2.0)
    monkeypatch.chdir(robot.parent)
    os.mkfifo("pipe")
    robot.write_text(ROBOT.replace("<link", f"{line}<link", 1))
    told = refused("vehicle", robot.name, "--trust", robot.name)
    assert words in told
    assert "\x1b" not in told


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('x="-0.2"', 'x="$(arg length)"', "Undefined substitution argument length"),
        ('wheel n="c"', 'weel n="c"', "unknown macro name: xacro:weel"),
        ("-2 * 0.1", "2 *", "invalid syntax"),
        ("<xacro:incl", "<incl", "found <include>; write <xacro:include ...>"),
        (NAMES, "", "add xmlns:xacro="),
        ('link name="base"', 'link name="a"', "cart.urdf.xacro (expanded):"),
    ],
)
def test_xacro_that_cannot_be_expanded_is_named(old, new, words, robot):
    robot.write_text(ROBOT.replace(old, new))
    found = error_of(VehicleError, read_vehicle, robot, trust=True)
    assert str(robot) in str(found)
    assert words in str(found)
    assert "DataError" not in str(found)


def test_without_the_package_the_command_is_named(robot, monkeypatch):
    monkeypatch.setitem(sys.modules, "xacro", None)
    words = r"pip install .*'xacro>=2\.1'; or expand the file"
    refuses(VehicleError, words, read_vehicle, robot, trust=True)


PLAIN = f"""<robot name="cart" {NAMES}><xacro:arg name="a"/>
  <xacro:property name="r" value="0.1"/><xacro:property name="d" value="${{2 * r}}"/>
  <xacro:property name="side" value="left"/><xacro:arg name="mass" default="$(optenv MASS 3)"/>
  <link name="base"><inertial><mass value="$(arg mass)"/></inertial>
    <visual><origin xyz="${{-(r + d)**2}} ${{d / 4}} $(optenv Z 0.5)"/>
      <geometry><mesh filename="$(find pkg)/a.stl"/></geometry></visual></link>
  <link name="${{side}}_wheel"><collision>
    <geometry><cylinder radius="${{pi * d}}" length="${{9**9**9}}"/></geometry></collision></link>
  <joint name="j${{1 + 1}}" type="continuous"><parent link="base"/><child link="left_wheel"/>
  </joint>
</robot>"""


def test_plain_expressions_are_replaced_by_arithmetic(monkeypatch):
    monkeypatch.setenv("Z", "7")
    monkeypatch.setenv("MASS", "7")
    with pytest.raises(DataError, match=r"cart:8: .*'\${9\*\*9\*\*9}' in the attribute 'length'"):
        read_tree(PLAIN.encode(), "cart")
    tree = read_tree(PLAIN.replace("9**9**9", "9").encode(), "cart")
    base, wheel = tree.links["base"], tree.links["left_wheel"]
    assert base.mass == 3
    assert base.visuals[0].name == "package://pkg/a.stl"
    assert base.visuals[0].at == pytest.approx((-0.09, 0.05, 0.5))
    assert wheel.shapes[0].radius == pytest.approx(0.6283185307179586)
    assert [*tree.joints] == ["j2"]
    assert tree.notes == (
        "variables of the environment are not read, $(optenv ...) takes its default: "
        "MASS = '3', Z = '0.5'",
    )
    heavy = read_tree(PLAIN.replace("9**9**9", "9").encode(), "cart", {"mass": "4"})
    assert heavy.links["base"].mass == 4
    for text in ("$(arg a)", "$(eval 1)", "${r if r else d}", "${().__class__}", "${x}"):
        raw = PLAIN.replace("9**9**9", "9").replace("${pi * d}", text)
        with pytest.raises(DataError, match="cart:8: expected plain URDF, found xacro"):
            read_tree(raw.encode(), "cart")


def test_macros_without_prefix_are_named(robot):
    """Also in included files, whose macros are known only after the expansion."""
    robot.write_text(ROBOT.replace('xacro:wheel n="a"', 'wheel n="a"'))
    refuses(VehicleError, r"\(expanded\).*found the call <wheel>", read_vehicle, robot, trust=True)
    own = WHEEL.replace("</robot>", '<link name="base"/>\n<wheel n="a" x="0" y="0"/></robot>')
    robot.write_text(own)
    for trust in (False, True):
        words = r"xacro:10: .*<wheel> .*; write <xacro:wheel \.\.\.>"
        refuses(VehicleError, words, read_vehicle, robot, trust=trust)
    robot.write_text('<robot><link name="base"/><wheel/></robot>')
    refuses(VehicleError, "<wheel> is not an element of URDF", read_vehicle, robot)
    robot.write_text(own.replace(NAMES, "").replace("<wheel", "<xacro:wheel"))
    refuses(VehicleError, r"write <robot xmlns:xacro=.http://www\.ros\.org", read_vehicle, robot)


SDF_LINK = '<link name="base"><inertial><pose>0 0 0 0 0 0</pose><mass>5</mass></inertial></link>'


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("m.sdf", f'<sdf version="1.9"><model name="m">{SDF_LINK}</model></sdf>', "SDF of Gazebo"),
        ("m.urdf", f'<robot name="m"><static>0</static>{SDF_LINK}</robot>', "SDF of Gazebo"),
        ("m.xml", "<mujoco><worldbody/></mujoco>", "mjcf-urdf-simple-converter"),
        ("m.dae", '<COLLADA xmlns="x"/>', "a mesh, which has no joints"),
        ("m.usda", "#usda 1.0", "nvidia-srl-usd-to-urdf"),
        ("m.launch", "<launch/>", "a launch file of ROS"),
        ("m.srdf", '<robot name="a"><group name="b"/></robot>', "the URDF to which it belongs"),
        ("m.urdf", "<html><body/></html>", "found a web page; download the file itself"),
        ("m.urdf", "version https://git-lfs.github.com/spec/v1\n", "git lfs pull"),
        ("m.urdf", "robot:\n  name: m\n", "found a file that does not begin with '<'"),
        ("m.urdf", '<Robot name="a"/>', "m.urdf:1: expected <robot>, found <Robot>"),
        ("m.urdf", "", "found an empty file"),
        ("m.urdf", '<!-- a -->\n<?xml version="1.0"?>\n<robot/>', "m.urdf:2: .* move <.xml"),
        ("m.urdf", '<?xml version="1.0" encoding="utf-16"?><robot/>', 'write encoding="utf-8"'),
    ],
)
def test_other_formats_are_named_with_a_way(name, text, words, tmp_path):
    file = tmp_path / name
    file.write_text(text)
    assert is_vehicle_file(file)
    (tmp_path / "v.toml").write_text(f'urdf = "{name}"')
    for path in (file, tmp_path / "v.toml"):
        refuses(DataError, words, read_vehicle, path)


def test_the_expansion_prints_nothing(robot, capfd):
    robot.write_text(ROBOT.replace('name="base"', "name=\"base${xacro.message('hello') or ''}\""))
    assert len(read_vehicle(robot, trust=True).wheels) == 3
    assert expanded(robot, {})[1] == {"wheel"}
    assert capfd.readouterr() == ("", "")


DOUBLED = "".join(
    f'<xacro:property name="p{i + 1}" value="${{p{i}}}${{p{i}}}"/>' for i in range(24)
)
ADDED = "".join(
    f'<xacro:property name="q{i}" value="{i}"/><link name="${{q{i} + 0}}"/>' for i in range(900)
)


MANY = "r.urdf:1: expected at most 20000 expressions"


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (MANY, f'<xacro:property name="p0" value="{"x" * 100}"/>{DOUBLED}'),
        (
            MANY,
            f'<xacro:property name="p0" value="{"x" * 10_000}"/><link name="{"${p0}" * 2100}"/>',
        ),
        (MANY, f'<link name="{"${1}" * 20_001}"/>'),
        (MANY, f'<link name="{"$(optenv A)" * 20_001}"/>'),
        ("expected one root link", ADDED),
        ("r.urdf:1: expected a robot of at most 50000 elements", 50_001 * "<a/>"),
    ],
    ids=range(6),
)
def test_files_that_take_long_are_refused_at_once(words, parts):
    begin = time.process_time()
    refuses(
        DataError, words, read_tree, f'<robot name="r" {NAMES}>{parts}</robot>'.encode(), "r.urdf"
    )
    assert time.process_time() - begin < 3
