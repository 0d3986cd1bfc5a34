"""Tests of the clearance of the body in commands: check, run, vehicle, figures and drawings."""

import json

import numpy as np
from numpy.testing import assert_allclose

from helpers.cases import DATA
from helpers.commands import invoke
from slipfree import open_result
from slipfree.problem.load import verb_of
from slipfree.show.meshes import shape_mesh
from slipfree.show.plots import draw
from slipfree.show.scene import drive_scene
from slipfree.vehicle.shapes import Ball, Box, Hull

VEHICLE = (DATA / "cart_with_a_box.toml").read_text()
PROBLEM = """\
verb = "direct"
frame = "rep103"
vehicle.file = "cart.toml"
start = { x = -1.5, y = 0.0, heading = 0.0 }
inputs = { left_rate = 1.0, right_rate = 1.0 }
time = { duration = 8.0, step = 0.2 }
[terrain]
file = "ridge.npz"
"""


def written(folder, height):
    axis = np.linspace(-3, 3, 61)
    ridge = 0.15 * np.exp(-(((axis - 0.8) / 0.3) ** 2))[:, None] * np.exp(-((axis / 0.3) ** 2))
    np.savez(folder / "ridge.npz", x=axis, y=axis, z=ridge)
    (folder / "cart.toml").write_text(VEHICLE.replace("HEIGHT", str(height)))
    (folder / "problem.toml").write_text(PROBLEM)
    return folder / "problem.toml"


def test_a_run_reports_where_the_body_came_closest_and_ends_there(tmp_path):
    problem, out = written(tmp_path, -0.02), tmp_path / "out.nc"
    checked = invoke("check", problem)
    assert "clearance of the body" in checked.stdout
    assert "0.13 m, the platform above (" in checked.stdout
    done = invoke("run", problem, "-o", out, "--figures-all", "--json", code=1)
    printed = json.loads(done.stdout)
    assert "the platform touches the ground at (" in done.stdout
    place = printed["result"]["facts"]["clearance_body_place"]["value"]
    assert place["body"] == "platform"
    assert 0.3 < place["x"] < 0.9
    run = open_result(out).trajectory
    assert run.stop.name == "clearance_body"
    assert_allclose(run["clearance_body"][-1], 0, atol=1e-6)
    assert (tmp_path / "out_figures" / "clearance.png").exists()
    result = open_result(out)
    verb = verb_of(result.problem)
    scene = drive_scene([verb.shown(result, "out")])
    (line,) = (each for each in scene.ground.lines if each.name == "closest")
    foot = line.segments[0, 0] + scene.origin
    assert_allclose(foot, [place[axis] for axis in "xyz"])
    figure = draw(plot for plot in verb.figures(result) if plot.name == "map")["map"]
    (mark,) = (each for each in figure.axes[0].lines if "closest" in str(each.get_label()))
    assert_allclose(mark.get_xydata(), [foot[:2]])
    summary = invoke("info", out).stdout
    assert "clearance of the body" in summary


def test_the_description_of_a_vehicle_lists_shapes_and_clearance(tmp_path):
    written(tmp_path, 0.1)
    printed = invoke("vehicle", tmp_path / "cart.toml", "--verbose").stdout
    assert "box 0.6 x 0.3 x 0.1 m at (0, 0.3, 0.1) m" in printed
    assert "clearance of the body" in printed
    assert "0.25 m, the platform above (" in printed


def test_shapes_are_drawn_with_their_dimensions():
    box = shape_mesh(Box((0.2, 0.4, 0.6), (1.0, 0.0, 0.0), (0.0, 0.0, np.pi / 2)))
    assert_allclose(np.ptp(box.vertices, axis=0), (0.4, 0.2, 0.6))
    ball = shape_mesh(Ball(0.3, (0.0, 1.0, 0.0)))
    assert_allclose(np.linalg.norm(ball.vertices - (0, 1, 0), axis=1), 0.3, rtol=1e-6)
    points = np.random.default_rng(0).normal(size=(30, 3))
    for mesh in (box, shape_mesh(Hull(tuple(map(tuple, points))))):
        a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
        outward = np.cross(b - a, c - a) * (a - mesh.vertices.mean(axis=0))
        assert (outward.sum(axis=1) > 0).all()
