"""The node of ROS in the documentation drives a vehicle to its goal, with a stand-in for ROS."""

import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from slipfree import Analytic, SamplingTask, catalog, commanded, direct_kinematics, settle, simulate

PAGE = Path(__file__).parents[2] / "docs" / "howto" / "control.md"


class Node:
    """What the node uses of ``rclpy.node.Node``."""

    def __init__(self, name):
        self.name, self.published, self.warnings = name, [], []

    def create_publisher(self, *_):
        return SimpleNamespace(publish=self.published.append)

    def create_subscription(self, kind, topic, receive, _):
        assert (kind.__name__, topic) == ("Odometry", "odom")
        self.on_odometry = receive

    def create_timer(self, _, send):
        self.on_timer = send

    def get_logger(self):
        return SimpleNamespace(warning=self.warnings.append)


class Twist:
    def __init__(self):
        self.linear, self.angular = SimpleNamespace(x=0.0), SimpleNamespace(z=0.0)


@pytest.fixture
def driver(monkeypatch):
    """Return the class of the documentation."""
    modules = {"geometry_msgs.msg": {"Twist": Twist}, "rclpy.node": {"Node": Node}}
    modules["nav_msgs.msg"] = {"Odometry": type("Odometry", (), {})}
    for name, values in modules.items():
        for part in (name.partition(".")[0], name):
            module = ModuleType(part)
            module.__dict__.update(values)
            monkeypatch.setitem(sys.modules, part, module)
    (text,) = (
        block.partition("```")[0]
        for block in PAGE.read_text("utf-8").split("```python\n")[1:]
        if "rclpy" in block
    )
    assert len(text.split("class Driver")[1].splitlines()) <= 30
    names: dict[str, object] = {}
    exec(text, names)
    return names["Driver"]


def odometry(run):
    yaw = run["heading"][-1] + np.pi / 2
    turn = SimpleNamespace(x=0.0, y=0.0, z=np.sin(yaw / 2), w=np.cos(yaw / 2))
    place = SimpleNamespace(x=run["x"][-1], y=run["y"][-1], z=run["z"][-1])
    return SimpleNamespace(
        pose=SimpleNamespace(pose=SimpleNamespace(position=place, orientation=turn))
    )


def test_the_node_drives_to_its_goal_and_stops_without_a_pose(driver):
    vehicle = catalog.skid_steer()
    hills = Analytic(lambda x, y: 0.03 * x * y)
    world = commanded(direct_kinematics(vehicle, hills), speed=0.4)
    ranges = {"forward": (0.0, 0.5), "yaw_rate": (-0.8, 0.8)}
    goal = {"x": -0.4, "y": 1.0}
    task = SamplingTask(
        world, {"slip": 1.0}, goal, 3.0, ranges, intervals=5, candidates=48, compiled=False
    )
    node = driver(task, period=0.5)
    node.on_timer()
    assert (node.published[-1].linear.x, node.published[-1].angular.z) == (0.0, 0.0)
    here = settle(world)
    for _ in range(10):
        node.on_odometry(odometry(here))
        node.on_timer()
        sent = node.published[-1]
        inputs = world.inputs(forward=sent.linear.x, yaw_rate=sent.angular.z)
        here = simulate(world, here, inputs, [0.0, 0.5]).part(slice(-1, None))
    assert np.hypot(here["x"][-1] + 0.4, here["y"][-1] - 1.0) < 0.2
    assert not node.warnings
    node.pose = np.full(3, np.nan)
    node.on_timer()
    assert node.warnings
    assert node.published[-1].linear.x == 0.0
