"""Poses of the links of random URDFs against an independent library."""

from __future__ import annotations

import adam.casadi
import numpy as np
import pytest

from helpers.urdf import adam_model
from slipfree.files.urdf.elements import read_tree
from slipfree.files.urdf.links import Robot, link_poses

INERTIAL = '<inertial><origin xyz="0 0 0"/><mass value="1"/></inertial>'


def random_urdf(rng: np.random.Generator, count: int) -> tuple[str, list[str], dict[str, tuple]]:
    """Return a URDF of random joints, the names of its independent joints, and its mimics."""
    parts, free, mimics = [f'<link name="l0">{INERTIAL}</link>'], [], {}
    for k in range(1, count):
        kind = rng.choice(["fixed", "revolute", "continuous", "prismatic"])
        at, turned = rng.uniform(-1, 1, 3), rng.uniform(-3, 3, 3)
        axis, more = rng.normal(size=3), ""
        axis /= np.linalg.norm(axis)
        if kind != "fixed" and free and rng.random() < 0.3:
            factor, offset = rng.uniform(-2, 2, 2)
            mimics[f"j{k}"] = str(rng.choice(free)), factor, offset
            more = '<mimic joint="{}" multiplier="{}" offset="{}"/>'.format(*mimics[f"j{k}"])
        elif kind != "fixed":
            free.append(f"j{k}")
        parts += [
            f'<link name="l{k}">{INERTIAL}</link>',
            f'<joint name="j{k}" type="{kind}"><parent link="l{rng.integers(k)}"/>'
            f'<child link="l{k}"/><origin xyz="{spelled(at)}" rpy="{spelled(turned)}"/>'
            f'<axis xyz="{spelled(axis)}"/><limit lower="-3" upper="3" effort="1" velocity="1"/>'
            f"{more}</joint>",
        ]
    return f'<robot name="r">{"".join(parts)}</robot>', free, mimics


def spelled(numbers: np.ndarray) -> str:
    return " ".join(map(repr, numbers.tolist()))


@pytest.mark.filterwarnings("ignore:(?s).*issue #2959:FutureWarning")  # adam's, of CasADi
@pytest.mark.parametrize("count", [3, 8, 25, 60])
def test_poses_of_links_are_those_of_adam(count, rng):
    text, free, mimics = random_urdf(rng, count)
    joints = [*free, *mimics]
    oracle = adam_model(text, joints, adam.casadi)  # numpy's fails for prismatic joints
    robot = Robot(read_tree(text.encode(), "robot.urdf"))
    for _ in range(5):
        values = dict(zip(free, rng.uniform(-3, 3, len(free)), strict=True))
        for name, (leader, factor, offset) in mimics.items():
            values[name] = offset + factor * values[leader]
        poses = {"l0": np.eye(4)}
        arrays = {name: np.array([value]) for name, value in values.items()}
        for each in link_poses(robot, arrays):
            own = np.eye(4)
            own[:3, :3], own[:3, 3] = each.rotation.as_matrix()[0], np.ravel(each.origins)[:3]
            poses[each.child] = poses[each.parent] @ own
        given = np.array([values[name] for name in joints])
        for link, pose in poses.items():
            expected = np.array(oracle.forward_kinematics_fun(link)(np.eye(4), given))
            assert np.abs(pose - expected).max() < 1e-9
