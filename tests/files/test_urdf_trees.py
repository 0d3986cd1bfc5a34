"""Tests of link poses of random URDFs against an independent library."""

from __future__ import annotations

import io

import numpy as np
import pytest
import yourdfpy

from slipfree.files.urdf.elements import read_tree
from slipfree.files.urdf.links import Robot, link_poses

INERTIAL = '<inertial><origin xyz="0 0 0"/><mass value="1"/></inertial>'


def random_urdf(rng, count):
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


def spelled(numbers):
    return " ".join(map(repr, numbers.tolist()))


@pytest.mark.parametrize("count", [8, 60])
def test_poses_of_links_are_those_of_yourdfpy(count, rng):
    text, free, mimics = random_urdf(rng, count)
    oracle = yourdfpy.URDF.load(io.StringIO(text), build_scene_graph=True, load_meshes=False)
    robot = Robot(read_tree(text.encode(), "robot.urdf"))
    for _ in range(5):
        values = dict(zip(free, rng.uniform(-3, 3, len(free)), strict=True))
        oracle.update_cfg(values)
        for name, (leader, factor, offset) in mimics.items():
            values[name] = offset + factor * values[leader]
        poses = {"l0": np.eye(4)}
        arrays = {name: np.array([value]) for name, value in values.items()}
        for each in link_poses(robot, arrays):
            own = np.eye(4)
            own[:3, :3], own[:3, 3] = each.rotation.as_matrix()[0], each.origins.ravel()
            poses[each.child] = poses[each.parent] @ own
        for link, pose in poses.items():
            assert np.abs(pose - oracle.get_transform(link, "l0")).max() < 1e-9
