"""Files of other formats that are given instead of a URDF, with ways to convert them."""

from __future__ import annotations

from pathlib import Path

from slipfree.errors import DataError
from slipfree.files.urdf.xml import Element, is_markup, parse
from slipfree.regular_files import regular_file

OR_TOML = "or describe the vehicle in a vehicle file (TOML)"
SDF = (
    "SDF of Gazebo",
    "convert it to URDF, for example with sdf2urdf.py of the ROS package pysdf, or give the URDF "
    f"or xacro from which it was made, {OR_TOML}",
)
MJCF = (
    "MJCF of MuJoCo",
    "convert it to URDF, for example with the Python package mjcf-urdf-simple-converter, "
    f"{OR_TOML}",
)
MESH = ("a mesh, which has no joints", f"give the URDF that names the mesh, {OR_TOML}")
USD = (
    "a scene of USD",
    f"convert it to URDF, for example with the Python package nvidia-srl-usd-to-urdf, {OR_TOML}",
)
LAUNCH = ("a launch file of ROS", "give the URDF that it loads, as 'robot_description'")
SRDF = ("SRDF of MoveIt, which has no joints", "give the URDF to which it belongs")
CAD = ("a CAD model", f"export URDF from the CAD program, {OR_TOML}")
WEBOTS = ("a world or PROTO of Webots", f"export URDF in Webots, {OR_TOML}")
PACKAGE = ("information about a package or model", "give the URDF in it")
# by the root element; ".../x" are endings
FORMATS = {
    **dict.fromkeys(("sdf", "gazebo", "world", "gazebo:world", ".sdf", ".world"), SDF),
    **dict.fromkeys(("mujoco", "mujocoinclude", ".mjcf"), MJCF),
    **dict.fromkeys(("COLLADA", "X3D", "amf", ".dae", ".stl", ".obj", ".ply", ".glb"), MESH),
    **dict.fromkeys((".gltf", ".fbx", ".3ds", ".off", ".3mf"), MESH),
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), USD),
    **dict.fromkeys(("launch", ".launch", ".py"), LAUNCH),
    **dict.fromkeys(("srdf", ".srdf"), SRDF),
    **dict.fromkeys((".step", ".stp", ".iges", ".igs", ".sldasm", ".blend", ".fcstd"), CAD),
    **dict.fromkeys((".wbt", ".proto"), WEBOTS),
    **dict.fromkeys(("model", "package", ".config"), PACKAGE),
}
ROBOTS = (".urdf", ".xacro", ".xml")  # endings of robot descriptions
HEAD = 200  # bytes that decide whether a file is XML


def is_description(path: Path) -> bool:
    """Return whether a file is a robot description, by its contents or its ending.

    Files of other formats are included, so that `parse_robot` or `check_ending` names them.
    """
    endings = [each.lower() for each in path.suffixes]
    if {*endings} & {*ROBOTS, *FORMATS} and endings[-1] != ".toml":
        return True
    try:
        with regular_file(path, "a vehicle file") as size, path.open("rb") as file:
            return is_markup(file.read(min(size, HEAD)))
    except DataError:
        return False


def check_ending(data: bytes, path: Path) -> None:
    """Raise DataError for contents that are not XML in a file with the ending of another format."""
    if path.suffix.lower() in FORMATS and not is_markup(data[:HEAD]):
        _refuse(str(path), path.suffix.lower())


def parse_robot(data: bytes, file: str) -> Element:
    """Return the root element <robot> of a URDF file; ``file`` is its name in messages.

    Raises
    ------
    DataError
        If the file is not XML, or is XML of another format.
    """
    root = parse(data, file)
    tag = root.tag.rpartition(":")[2] if root.tag not in FORMATS else root.tag
    if tag in FORMATS:
        _refuse(f"{file}:{root.line}", tag)
    for each in (root, *root.children):
        lower = each.tag.lower()
        if lower in ("robot", "link", "joint") and lower != each.tag:
            raise DataError(
                f"{file}:{each.line}: expected <{lower}>, found <{each.tag}>; write the names of "
                "elements in lower case"
            )
    if root.tag != "robot":
        raise DataError(
            f"{file}:{root.line}: expected URDF with the root element <robot>, found <{root.tag}>; "
            "give a URDF file"
        )
    if (line := _line_of_sdf(root)) is not None:
        _refuse(f"{file}:{line}", "sdf")
    tags = {each.tag for each in root.children}
    if "link" not in tags and {"group", "virtual_joint", "disable_collisions"} & tags:
        _refuse(f"{file}:{root.line}", "srdf")
    return root


def _refuse(where: str, kind: str) -> None:
    found, remedy = FORMATS[kind]
    raise DataError(f"{where}: expected URDF, found {found}, which is not read; {remedy}")


def _line_of_sdf(robot: Element) -> int | None:
    """Return the line of an element of SDF in a robot, with its value as text; None without one."""
    parts = [part for part in robot.children if part.tag in ("link", "joint")]
    inside = [each for part in parts for each in (part, *part.children) if each.tag != "sensor"]
    values = [each for part in inside for each in part.children]
    for each in [*robot.children, *values]:
        is_value = each.texts and not {"value", "link"} & {*each.attributes}
        if is_value and each.tag in ("static", "pose", "parent", "child", "mass"):
            return each.line
    return None
