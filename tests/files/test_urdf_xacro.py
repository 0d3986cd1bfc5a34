"""Tests of xacro files: expansion, and search for packages in the folders above them."""

from __future__ import annotations

import sys

import pytest

from slipfree.problem.build_vehicle import VehicleError, is_vehicle_file, read_vehicle

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


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("find my_cart", "find my_robot", "expected the package 'my_robot' in a folder above"),
        ('x="-0.2"', 'x="$(arg length)"', "Undefined substitution argument length"),
        ('wheel n="c"', 'weel n="c"', "unknown macro name: xacro:weel"),
        ("-2 * 0.1", "2 *", "invalid syntax"),
        ("</robot>", "", "expected xacro that can be expanded"),
        ('link name="base"', 'link name="a"', "cart.urdf.xacro (expanded):"),
    ],
)
def test_xacro_that_cannot_be_expanded_is_named(old, new, words, robot):
    robot.write_text(ROBOT.replace(old, new))
    with pytest.raises(VehicleError) as found:
        read_vehicle(robot, trust=True)
    assert str(robot) in str(found.value)
    assert words in str(found.value)
    assert "DataError" not in str(found.value)


def test_without_the_package_the_command_is_named(robot, monkeypatch):
    monkeypatch.setitem(sys.modules, "xacro", None)
    with pytest.raises(VehicleError, match=r"pip install '\.\[urdf\]'; or expand the file"):
        read_vehicle(robot, trust=True)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(VehicleError, match="expected xacro, found that it cannot be read"):
        read_vehicle(tmp_path / "no.xacro")
