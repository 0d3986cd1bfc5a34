"""Tests of MCAP files of ROS 2 messages: exported motions, imported commands and paths."""

import sys
from types import SimpleNamespace
from xml.etree import ElementTree

import mcap.writer
import mcap_ros2.writer
import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType
from mcap_ros2.decoder import DecoderFactory
from numpy.testing import assert_allclose
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial.transform import Rotation

from helpers.cases import DATA
from helpers.commands import invoke, refused, refuses
from helpers.urdf import adam_model
from slipfree.catalog import rocky7
from slipfree.core.errors import DataError
from slipfree.files import netcdf
from slipfree.files.mcap import DEFINITIONS, read_joint_commands, read_mcap
from slipfree.files.tables import read_columns, read_names
from slipfree.problem.load import load_problem
from slipfree.problem.result import export_mcap, run_problem

pytestmark = pytest.mark.usefixtures("direct_reads")
DRIVE = (DATA / "drive_of_a_log.toml").read_text()
STORE = get_typestore(Stores.ROS2_HUMBLE)


def _ground(folder):
    x, y = np.meshgrid(np.linspace(-5, 5, 41), np.linspace(-5, 5, 41), indexing="ij")
    axis = np.linspace(-5, 5, 41)
    np.savez(folder / "ground.npz", x=axis, y=axis, z=0.1 * np.sin(x) + 0.02 * x * y)


def _exported(folder, text):
    """Return the motion of a problem whose result and MCAP file are in a folder."""
    _ground(folder)
    (folder / "p.toml").write_text(text)
    result = run_problem(load_problem(folder / "p.toml"))
    netcdf.write(folder / "out.nc", result.trajectory, result.arrays)
    export_mcap(folder / "out.nc", folder / "out.mcap")
    return result.trajectory


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Return the folder of a result and its motion."""
    folder = tmp_path_factory.mktemp("drive")
    return folder, _exported(folder, DRIVE)


def _read(path, library):
    """Return the messages of each topic, with their times [ns], as a library reads them."""
    found: dict[str, list[tuple[int, object]]] = {}
    if library == "mcap":
        with path.open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            for _, channel, record, message in reader.iter_decoded_messages():
                found.setdefault(channel.topic, []).append((record.log_time, message))
        return found
    with AnyReader([path], default_typestore=STORE) as reader:
        for connection, time, content in reader.messages():
            message = reader.deserialize(content, connection.msgtype)
            found.setdefault(connection.topic, []).append((time, message))
    return found


def _numbers(vector, names="xyz"):
    return [getattr(vector, name) for name in names]


@pytest.mark.slow
@pytest.mark.parametrize("library", ["mcap", "rosbags"])
def test_two_libraries_read_the_numbers_of_the_motion(drive, library):
    folder, run = drive
    found, exact = _read(folder / "out.mcap", library), {"rtol": 0, "atol": 1e-12}
    slips = {f"/slip/{wheel}" for wheel in run.wheels}
    assert set(found) == {"/path", "/tf", "/joint_states"} | slips
    times = [time for time, _ in found["/tf"]]
    assert_allclose(np.array(times) / 1e9, run.t, rtol=0, atol=5e-10)
    places = np.column_stack([run[name] for name in "xyz"])
    turns = Rotation.from_quat(np.column_stack([run[f"quaternion_{name}"] for name in "xyzw"]))

    ((_, path),) = found["/path"]
    assert path.header.frame_id == "map"
    assert_allclose([_numbers(each.pose.position) for each in path.poses], places, **exact)

    centers = np.stack([run[f"center_{name}"] for name in "xyz"], axis=-1)
    for k, (_, message) in enumerate(found["/tf"]):
        base, *wheels = message.transforms
        assert (base.header.frame_id, base.child_frame_id) == ("map", "base_link")
        assert [each.child_frame_id for each in wheels] == list(run.wheels)
        turn = Rotation.from_quat(_numbers(base.transform.rotation, "xyzw"))
        assert (turn * turns[k].inv()).magnitude() < 1e-12
        local = [_numbers(each.transform.translation) for each in wheels]
        assert_allclose(turn.apply(local) + places[k], centers[k], rtol=0, atol=1e-11)

    first, last = found["/joint_states"][0][1], found["/joint_states"][-1][1]
    names = list(last.name)
    assert names[-len(run.wheels) :] == list(run.wheels)
    assert_allclose(last.position[-len(run.wheels) :], run["wheel_angle"][-1], **exact)
    assert_allclose(last.velocity[-len(run.wheels) :], run["wheel_rate"][-1], **exact)
    assert len(first.position) == len(names)
    moving = [joint for joint in rocky7().joints if joint.value in run.columns]
    assert len(moving) >= 3
    for joint in moving:
        k = names.index(joint.name)
        assert last.position[k] == pytest.approx(run[joint.value][-1], abs=1e-12)
        if f"{joint.value}_rate" in run.columns:
            assert last.velocity[k] == pytest.approx(run[f"{joint.value}_rate"][-1], abs=1e-12)
    for wheel in run.wheels:
        slip = [(each.vector.x, each.vector.y) for _, each in found[f"/slip/{wheel}"]]
        expected = run["slip_along", wheel], -run["slip_across", wheel]
        assert_allclose(np.transpose(slip), expected, **exact)


def test_messages_and_their_definitions_are_those_of_ros(drive):
    folder, run = drive
    kinds = {"/path": "nav_msgs/msg/Path", "/tf": "tf2_msgs/msg/TFMessage"}
    kinds["/joint_states"] = "sensor_msgs/msg/JointState"
    kinds |= {f"/slip/{wheel}": "geometry_msgs/msg/Vector3Stamped" for wheel in run.wheels}
    counts = {topic: 1 if topic == "/path" else run.t.size for topic in kinds}
    with AnyReader([folder / "out.mcap"]) as reader:  # the definitions in the file suffice
        assert {c.topic: c.msgtype for c in reader.connections} == kinds
        assert {c.topic: c.msgcount for c in reader.connections} == counts
        for connection, _, content in reader.messages():
            reader.deserialize(content, connection.msgtype)
        for connection in reader.connections:
            bare = get_typestore(Stores.EMPTY)
            bare.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
            kind = connection.msgtype
            assert bare.hash_rihs01(kind) == STORE.hash_rihs01(kind)


def test_wheels_turn_forward_about_the_left_axis(drive):
    folder, run = drive
    messages = _read(folder / "out.mcap", "mcap")["/tf"]
    before, after = (
        Rotation.from_quat(_numbers(m.transforms[1].transform.rotation, "xyzw"))
        for _, m in (messages[0], messages[-1])
    )
    turned = (before.inv() * after).as_rotvec()
    assert turned[1] == pytest.approx(run["wheel_angle"][-1, 0] - run["wheel_angle"][0, 0], abs=0.1)
    assert turned[1] > 0.5


def _chained(message):
    """Return the poses of all frames in the map from a message of /tf, parents first."""
    poses = {"map": (Rotation.identity(), np.zeros(3))}
    for each in message.transforms:
        turn, place = poses[each.header.frame_id]
        local = np.array(_numbers(each.transform.translation))
        own = Rotation.from_quat(_numbers(each.transform.rotation, "xyzw"))
        poses[each.child_frame_id] = turn * own, place + turn.apply(local)
    return poses


@pytest.mark.slow
@pytest.mark.parametrize("forward", ["x", "-x"])
def test_links_and_joints_of_a_urdf_are_those_of_adam(forward, tmp_path):
    robot = (DATA / "cart.urdf").read_text()
    (tmp_path / "cart.urdf").write_text(robot)
    completion = (DATA / "cart.toml").read_text()
    (tmp_path / "cart.toml").write_text(f'forward = "{forward}"\n{completion}')
    run = _exported(
        tmp_path, DRIVE.replace('vehicle.catalog = "rocky7"', 'vehicle.file = "cart.toml"')
    )
    found = _read(tmp_path / "out.mcap", "mcap")
    names = found["/joint_states"][0][1].name
    elements = ElementTree.fromstring(robot).findall("joint")
    assert set(names) == {j.get("name") for j in elements if j.get("type") != "fixed"}
    children = {j.get("name"): j.find("child").get("link") for j in elements}
    oracle = adam_model(robot, list(names))
    for k, (_, states) in enumerate(found["/joint_states"]):
        poses = _chained(found["/tf"][k][1])
        assert set(poses) == {"map", "base_link", *children.values()}
        root = np.eye(4)
        root[:3, :3], root[:3, 3] = poses["base_link"][0].as_matrix(), poses["base_link"][1]
        for link in children.values():
            expected = oracle.forward_kinematics(link, root, np.array(states.position))
            turn, place = poses[link]
            assert_allclose(place, expected[:3, 3], rtol=0, atol=1e-12)
            assert_allclose(turn.as_matrix(), expected[:3, :3], rtol=0, atol=1e-12)
        for i, wheel in enumerate(run.wheels):
            center = [run[f"center_{axis}"][k, i] for axis in "xyz"]
            assert_allclose(poses[children[wheel]][1], center, rtol=0, atol=1e-11)
    # the axis of the left wheel points left, that of the right wheel points right
    signs = {"x": (1, -1), "-x": (-1, 1)}[forward]
    last = found["/joint_states"][-1][1]
    for joint, sign in zip(("left_drive", "right_drive"), signs, strict=True):
        k, i = list(names).index(joint), run.wheels.index(joint)
        assert last.position[k] == pytest.approx(sign * run["wheel_angle"][-1, i], abs=1e-12)
        assert last.velocity[k] == pytest.approx(sign * run["wheel_rate"][-1, i], abs=1e-12)
        assert abs(last.position[k]) > 0.5


def test_the_command(drive, tmp_path):
    folder, _ = drive
    out = tmp_path / "a.mcap"
    invoke("export", folder / "out.nc", "--mcap", out, code=0)
    assert out.read_bytes()[:5] == b"\x89MCAP"
    assert "ends in .mcap" in refused("export", folder / "out.nc", "--mcap", "a.csv")


def test_without_the_package(drive, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mcap_ros2.writer", None)
    with pytest.raises(DataError, match=r"mcap-ros2-support', .*install 'mcap-ros2-support>"):
        export_mcap(drive[0] / "out.nc", tmp_path / "a.mcap")
    assert not list(tmp_path.iterdir())


def _bag(folder, *topics):
    """Return an MCAP file written by rosbags: one message per 0.5 s since 2023."""
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, kind, messages in topics:
            connection = writer.add_connection(topic, kind, typestore=STORE)
            for k, message in enumerate(messages):
                time = 1_700_000_000_000_000_000 + k * 500_000_000
                writer.write(connection, time, STORE.serialize_cdr(message, kind))
    (file,) = (folder / "bag").glob("*.mcap")
    return file


def _twists():
    t = STORE.types
    vector = t["geometry_msgs/msg/Vector3"]
    twist = t["geometry_msgs/msg/Twist"]
    return [twist(vector(0.1 * k, 0.01, 0.0), vector(0.0, 0.0, -0.2 * k)) for k in range(3)]


def _poses(yaws):
    t = STORE.types
    time, header = t["builtin_interfaces/msg/Time"], t["std_msgs/msg/Header"]
    point, turn = t["geometry_msgs/msg/Point"], t["geometry_msgs/msg/Quaternion"]
    pose, stamped = t["geometry_msgs/msg/Pose"], t["geometry_msgs/msg/PoseStamped"]
    return [
        stamped(
            header(time(1_700_000_000 + k, 250_000_000), "map"),
            pose(point(float(k), 0.1 * k, 0.0), turn(0.0, 0.0, np.sin(y / 2), np.cos(y / 2))),
        )
        for k, y in enumerate(yaws)
    ]


def test_commands_are_read(tmp_path):
    file = _bag(tmp_path, ("/cmd_vel", "geometry_msgs/msg/Twist", _twists()))
    names = read_names(file, "commands")
    assert names == ["t", "v_x", "v_y", "omega_z"]
    rows = read_columns(file, names, "commands").rows()
    assert_allclose(rows, [[0.5 * k, 0.1 * k, 0.01, -0.2 * k] for k in range(3)], atol=1e-15)
    stamped = STORE.types["geometry_msgs/msg/TwistStamped"]
    head = SimpleNamespace(header=_poses([0.0])[0].header)
    messages = [stamped(head.header, each) for each in _twists()]
    other = tmp_path / "other"
    other.mkdir()
    file = _bag(other, ("/cmd", "geometry_msgs/msg/TwistStamped", messages))
    assert_allclose(read_mcap(file, "v_x")["t"], 0)  # the time of the header, not of the recording


def test_paths_are_read(tmp_path):
    poses = _poses([3.0, 3.1, -3.1])
    path = STORE.types["nav_msgs/msg/Path"](poses[0].header, poses)
    file = _bag(tmp_path, ("/plan", "nav_msgs/msg/Path", [path]))
    rows = read_columns(file, ("t", "x", "y", "heading")).rows()
    expected = [[0, 0, 0, 3], [1, 1, 0.1, 3.1], [2, 2, 0.2, 2 * np.pi - 3.1]]
    assert_allclose(rows, expected, rtol=0, atol=1e-12)
    assert_allclose(read_columns(file, "xy").rows(), np.array(expected)[:, 1:3], rtol=0, atol=1e-15)


def test_what_cannot_be_read(tmp_path):
    kind = "geometry_msgs/msg/Twist"
    file = _bag(tmp_path, ("/a", kind, _twists()), ("/b", kind, _twists()))
    refuses(DataError, r"expected one topic .*, found /a, /b", read_names, file, "commands")
    refuses(DataError, "Odometry, found none", read_columns, file, "xy")
    refuses(DataError, "expected a CSV file, found MCAP", read_columns, file, ("solid", "x", "z"))
    with pytest.raises(DataError, match=r"JointState, found none among /a \(geometry_msgs/msg/Twi"):
        read_joint_commands(file)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda _: b"", "EndOfFile"),
        (lambda data: b"\x89HDF" + data[4:], "InvalidMagic"),
        (lambda data: data[: len(data) // 2], "repair it with 'mcap recover'"),
        (lambda data: data.replace(bytes(np.float64(0.125)), bytes(np.float64(0.5))), "CRCVal"),
    ],
)
def test_damaged_files_are_refused(damage, words, tmp_path):
    file = tmp_path / "a.mcap"
    kind, fields = "geometry_msgs/Twist", {"x": 0.125, "y": 0.0, "z": 0.0}
    vector = f"{'=' * 80}\nMSG: geometry_msgs/Vector3\n{DEFINITIONS['geometry_msgs/Vector3']}"
    text = f"geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular\n{vector}"
    _recorded(file, kind, text, {"linear": fields, "angular": fields})
    assert read_names(file, "commands") == ["t", "v_x", "v_y", "omega_z"]
    file.write_bytes(damage(file.read_bytes()))
    refuses(DataError, rf"a\.mcap: expected .*{words}", read_names, file, "commands")


def _recorded(file, kind, text, message):
    """Write one message of a type whose definition the file states."""
    with file.open("wb") as stream:
        writer = mcap_ros2.writer.Writer(stream, compression=CompressionType.NONE)
        schema = writer.register_msgdef(kind.replace("/", "/msg/"), text)
        writer.write_message("/a", schema, message, log_time=1)
        writer.finish()


@pytest.mark.bounded
def test_messages_in_other_encodings_are_refused(tmp_path):
    file = tmp_path / "a.mcap"
    with file.open("wb") as stream:
        writer = mcap.writer.Writer(stream)
        writer.start()
        schema = writer.register_schema("geometry_msgs/msg/Twist", "jsonschema", b"{}")
        channel = writer.register_channel("/a", "json", schema)
        writer.add_message(channel, log_time=1, publish_time=1, data=b'{"linear": 1}')
        writer.finish()
    with pytest.raises(DataError, match=r"found 'json' with definitions in 'jsonschema' in topic"):
        read_mcap(file, "v_x")


@pytest.mark.slow
def test_a_problem_with_commands_and_one_with_a_path(drive, tmp_path):
    _ground(tmp_path)
    _bag(tmp_path, ("/cmd_vel", "geometry_msgs/msg/Twist", _twists())).rename(tmp_path / "c.mcap")
    start, _, rest = DRIVE.partition("[driver]")
    given = start.replace("direct", "inverse") + '[given]\nfile = "c.mcap"\n'
    (tmp_path / "p.toml").write_text(given + rest[rest.index("[time]") :])
    run = run_problem(load_problem(tmp_path / "p.toml")).trajectory
    assert run.t[-1] == 1
    assert "v_x, v_y, omega_z of c.mcap" in str(run.attributes)
    path = drive[0] / "out.mcap"
    (tmp_path / "d.toml").write_text(
        DRIVE.replace('"straight"', f'"follow"\nfile = "{path.as_posix()}"')
    )
    run = run_problem(load_problem(tmp_path / "d.toml")).trajectory
    assert run["x"][-1] == pytest.approx(drive[1]["x"][-1], abs=0.01)
    wrong = given.replace("[given]", "[path]").replace("c.mcap", path.as_posix())
    wrong = wrong.replace('frame = "rep103"\n', "")
    (tmp_path / "w.toml").write_text(wrong + rest[rest.index("[time]") :])
    with pytest.raises(DataError, match="expected frame = 'rep103' for a path in MCAP"):
        run_problem(load_problem(tmp_path / "w.toml"))


def _states(folder, *messages):
    """Return an MCAP file of JointState messages, one per 0.5 s: names, positions, velocities."""
    kind, found = "sensor_msgs/msg/JointState", []
    time, header = STORE.types["builtin_interfaces/msg/Time"], STORE.types["std_msgs/msg/Header"]
    for k, (names, positions, velocities) in enumerate(messages):
        stamp = header(time(1_700_000_000 + k // 2, 500_000_000 * (k % 2)), "")
        arrays = (np.array(each, dtype=float) for each in (positions, velocities, []))
        found.append(STORE.types[kind](stamp, names, *arrays))
    folder.mkdir()
    return _bag(folder, ("/joint_command", kind, found))


CART = """\
verb = "direct"
terrain.file = "ground.npz"
vehicle.file = "cart.toml"
start.x = 0
inputs.file = "c.mcap"
time = { duration = 1, step = 0.25 }
"""


def _cart(folder, *messages):
    """Return a problem of the cart with commands of its joints."""
    _ground(folder)
    for name in ("cart.urdf", "cart.toml"):
        (folder / name).write_text((DATA / name).read_text())
    _states(folder / "states", *messages).rename(folder / "c.mcap")
    (folder / "p.toml").write_text(CART)
    return folder / "p.toml"


def test_commands_of_joints_have_the_signs_of_the_urdf(tmp_path):
    """The axis of the right wheel points right; joints of no input are ignored."""
    names = ["lidar_mount", "right_drive", "left_drive"]
    moves = [(names, [], [9.0, -1.0 - k, 1.0]) for k in range(3)]
    run = run_problem(load_problem(_cart(tmp_path, *moves))).trajectory
    rates = run["left_drive_rate"], run["right_drive_rate"]
    before, after = run.t < 0.45, run.t > 0.55
    assert_allclose(rates[0], 1)
    assert_allclose(rates[1][before], 1)
    assert_allclose(rates[1][after & (run.t < 0.95)], 2)
    assert "of c.mcap" in str(run.attributes)


def test_positions_of_joints_are_reached_at_the_next_message(tmp_path):
    moves = [(["left_drive", "right_drive"], [5 + k, -2 * k], []) for k in range(3)]
    problem = load_problem(_cart(tmp_path, *moves), ["inputs.left_drive_rate=3"])
    run = run_problem(problem).trajectory
    angles = run["wheel_angle"][-1] - run["wheel_angle"][0]
    expected = {"left_drive": 3.0, "right_drive": 4.0}
    for wheel, angle in expected.items():
        assert angles[run.wheels.index(wheel)] == pytest.approx(angle, abs=1e-6)


@pytest.mark.parametrize(
    ("rows", "words"),
    [
        ("t,left_drive_rate,right_drive_rate [deg/s]\n0,0,180\n1,2,180\n1,4,180\n2,4,180\n", ""),
        ("t,arm\n0,1\n", "left_drive_rate, right_drive_rate, found none of them"),
        ("t,left_drive_rate\n1,0\n0,1\n", "0 to time.duration, 1.5 s, or further, found 1 to 0 s"),
    ],
)
def test_rates_in_a_csv_file_are_linear_between_rows(rows, words, tmp_path):
    problem = _cart(tmp_path, (["arm"], [], [1.0]))
    (tmp_path / "c.csv").write_text(rows)
    loaded = load_problem(problem, ["inputs.file=c.csv", "time.duration=1.5"])
    if words:
        refuses(DataError, words, run_problem, loaded)
        return
    run = run_problem(loaded).trajectory
    angles = dict(zip(run.wheels, run["wheel_angle"][-1] - run["wheel_angle"][0], strict=True))
    assert angles["left_drive"] == pytest.approx(1 + 2, abs=1e-6)
    assert angles["right_drive"] == pytest.approx(1.5 * np.pi, abs=1e-6)


@pytest.mark.parametrize(
    ("messages", "words"),
    [
        ([(["arm"], [], [1.0])], "commands of one or more of the joints .*right_drive, found thos"),
        ([(["left_drive"], [], [1.0])], "right_drive_rate: expected a rate, found none"),
        ([(["left_drive"], [1.0], []), (["left_drive"], [], [1.0])], "in every message"),
    ],
)
def test_commands_of_joints_that_do_not_suffice(messages, words, tmp_path):
    refuses(DataError, words, run_problem, load_problem(_cart(tmp_path, *messages)))


def test_steering_starts_at_its_first_command(tmp_path):
    _ground(tmp_path)
    names = ["steer", "right", "left"]
    moves = [(names, [0.1 + 0.1 * k, k, k], []) for k in range(3)]
    _states(tmp_path / "states", *moves).rename(tmp_path / "c.mcap")
    text = CART.replace('file = "cart.toml"', 'catalog = "three_wheeler"')
    (tmp_path / "p.toml").write_text(text)
    with pytest.raises(DataError, match=r"found steer = 0; set steer = 0.1 in \[start\]"):
        run_problem(load_problem(tmp_path / "p.toml"))
    run = run_problem(load_problem(tmp_path / "p.toml", ["start.steer=0.1"])).trajectory
    assert run["steer"][-1] == pytest.approx(0.3, abs=1e-6)
