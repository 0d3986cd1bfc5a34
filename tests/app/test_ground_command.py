"""Tests of ``slipfree ground``: statistics against closed forms, doubtful heights, and a start."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from helpers.cases import DATA
from helpers.commands import invoke, printed, sets
from slipfree import Bicubic, Grid, catalog, direct_kinematics, settle

pytestmark = pytest.mark.usefixtures("folder")
AXIS = np.linspace(-10.0, 10.0, 41)
BOWL = 25.0  # radius of curvature at the lowest point [m]


def described(z, *words, code=0):
    np.savez("site.npz", x=AXIS, y=AXIS, z=z)
    result = invoke("ground", "site.npz", *words, "--json", code=code)
    return json.loads(result.stdout)


def test_slopes_and_hollows_of_a_bowl():
    x, y = np.meshgrid(AXIS, AXIS, indexing="ij")
    found = described((x**2 + y**2) / (2 * BOWL), "--no-draw")["ground"]
    values = {name: fact["value"] for name, fact in found.items()}
    # in a paraboloid the slope is the distance from the middle over the radius
    share = np.mean(np.hypot(x, y) / BOWL > np.tan(np.radians(20.0)))
    assert values["share_above_20"] == pytest.approx(share, abs=0.02)
    median = np.degrees(np.arctan(np.median(np.hypot(x, y)) / BOWL))
    assert values["slope_median"] == pytest.approx(median, rel=1e-2)
    assert values["wheel_radius"] == pytest.approx(BOWL, rel=1e-9)
    assert values["spikes"] == values["hole_share"] == values.get("rounded_to", 0) == 0
    assert (values["west"], values["north"]) == (-10.0, 10.0)


def test_the_curvature_is_that_of_the_spline():
    """Through heights that alternate by a it is 12 a / h^2 at every other node, more at edges."""
    found = described(0.001 * (-1.0) ** np.arange(41)[:, None] + 0 * AXIS, "--no-draw")["ground"]
    assert 0.5 * 0.5**2 / 0.012 < found["wheel_radius"]["value"] < 1.001 * 0.5**2 / 0.012


def test_spikes_holes_and_rounded_heights_are_named():
    z = np.round(2.0 * np.sin(AXIS[:, None] / 3) * np.cos(AXIS / 4))
    z[20, 8], z[30, 30] = 9.0, np.nan
    found = described(z)
    values = {name: fact["value"] for name, fact in found["ground"].items()}
    assert values["rounded_to"] == 1.0
    assert (values["spikes"], values["spike_x"], values["spike_y"]) == (1, AXIS[20], AXIS[8])
    assert values["hole_share"] == pytest.approx(9 / z.size)
    assert found["files"] == ["site_figures/ground.png"]
    assert Path("site_figures/ground.png").stat().st_size > 1e4
    assert "terrain.smooth of two to three cells" in found["facts"]["rounded heights"]


def test_a_vehicle_stands_at_the_start():
    """The start is a level pose of a coarse grid with room, as the vehicle's settling has it."""
    z = 0.1 * AXIS[:, None] * np.sin(AXIS / 3)
    found = described(z, "three_wheeler", "--no-draw")
    start = found["start"]
    model = direct_kinematics(catalog.three_wheeler(), Bicubic(Grid(AXIS, AXIS, z)))
    pose = settle(model, x=start["x"], y=start["y"], heading=start["heading"] - np.pi / 2)
    for name in ("roll", "pitch"):
        assert start[name] == pytest.approx(pose[name][0], abs=1e-6)
    assert "rep103" in found["facts"]["start"]
    assert "153 of 196 places that were tried, 4" in found["facts"]["three_wheeler stands"]
    z[24:26, 20] = np.nan
    start = described(z, "three_wheeler", "--no-draw")["start"]
    assert max(abs(start["x"]), abs(start["y"])) < 8  # further out, there is no room


def test_maps_in_degrees_are_converted():
    z = 500.0 + 100.0 * np.random.default_rng(0).random((20, 20))
    np.savez("deg.npz", x=np.linspace(7.0, 7.01, 20), y=np.linspace(45, 45.01, 20), z=z)
    out = printed("ground", "deg.npz", "--no-draw")
    assert out.startswith("the map is in degrees; it is converted to metres")
    assert "786.199 x 1111.95 m, 20 x 20 nodes" in out  # 0.01 deg of the mean sphere
    words = "deg.npz", "three_wheeler", "--every", "9", "--headings", "1", "--no-draw"
    assert "converted to metres by" in invoke("atlas", *words).stdout


def test_the_ground_of_a_problem_and_errors():
    np.savez("site.npz", x=AXIS, y=AXIS, z=0.0 * AXIS[:, None] * AXIS)
    Path("p.toml").write_text(
        'verb = "direct"\nstart = {}\ninputs = {}\ntime = { duration = 1.0, step = 0.1 }\n'
        '[terrain]\nfile = "site.npz"\n[vehicle]\ncatalog = "rocky7"\n'
    )
    out = printed("ground", "p.toml", "--no-draw", *sets("terrain.window=[-5,5,-5,5]"))
    assert "10 x 10 m, 21 x 21 nodes" in out
    assert "rocky7 stands" in out
    coarse = printed("ground", "p.toml", "--no-draw", *sets("terrain.scale=10"))
    assert "larger than the vehicle (" in coarse
    filled = printed("ground", "p.toml", "--no-draw", *sets("terrain.rolled=0.5"))
    assert "has filled those that a wheel of 0.5 m" in filled
    holes = np.where(np.indices((AXIS.size, AXIS.size)).max(axis=0) % 2, np.nan, 0.0)
    np.savez("holes.npz", x=AXIS, y=AXIS, z=holes)
    assert "found a hole at or beside every node" in printed("ground", "holes.npz", code=2)
    np.savez("site.npz", x=AXIS, y=AXIS, z=1e5 + AXIS[:, None] * AXIS)
    assert "vertical_scale" in printed("ground", "site.npz", code=2)
    assert "VEHICLE: expected a vehicle file" in printed("ground", "site.npz", "tank", code=2)
    assert "omit VEHICLE" in printed("ground", "p.toml", "rocky7", code=2)


@pytest.mark.slow  # poses of each problem are built twice
def test_a_new_problem_has_map_vehicle_and_start():
    z = 0.05 * AXIS[:, None] * np.sin(AXIS / 3)
    np.savez("site.npz", x=AXIS, y=AXIS, z=z)
    files = "--ground", "site.npz", "--vehicle", "three_wheeler"
    for kind in ("direct", "inverse", "plan", "atlas"):
        printed("new", kind, kind, *files)
        assert printed("check", f"{kind}.toml").startswith("ok ")
    plan = tomllib.loads(Path("plan.toml").read_text())
    assert plan["terrain"] == {"file": "site.npz", "friction": 0.6}
    assert {*plan} >= {"start", "goal", "costs"}
    assert not {*plan} & {"bounds", "inputs", "time"}
    assert 'model = "quasi-static"' in Path("direct.toml").read_text()
    axis = '<axis xyz="0 1 0"/>'
    text = (DATA / "cart.urdf").read_text().replace(axis, axis + '<limit velocity="1"/>', 1)
    Path("slow.urdf").write_text(text)
    printed("new", "direct", "slow", *files[:3], "slow.urdf")
    assert "speed = 0.12 " in Path("slow.toml").read_text()  # 0.8 times 1 rad/s, 0.15 m
    printed("new", "direct", "rigid", *files[:3], "rigid_skid_steer")
    assert 'model = "dynamics"' in Path("rigid.toml").read_text()
    assert "compare c.toml" in printed("new", "compare", "c", *files)
    assert "Rocky 7" in printed("compare", "c.toml")
    printed("new", "direct", "more", *files, *sets("terrain.window=[-5,5,-5,5]"))
    assert "window = [-5.0, 5.0, -5.0, 5.0]" in Path("more.toml").read_text()
    assert "together" in printed("new", "direct", "no", *files[:2], code=2)
    assert "found 'frame=paper'" in printed(
        "new", "direct", "no", *files, *sets("frame=paper"), code=2
    )


def test_a_new_problem_on_a_small_map_with_a_foreign_name():
    """The goal is on the map, which is smaller than the distance ahead, as the start is."""
    axis = np.linspace(0.0, 4.0, 21)
    np.savez("gelände FILE.npz", x=axis, y=axis, z=0.02 * axis[:, None] * axis)
    printed("new", "plan", "p", "--ground", "gelände FILE.npz", "--vehicle", "three_wheeler")
    assert printed("check", "p.toml").startswith("ok ")
    problem = tomllib.loads(Path("p.toml").read_text(encoding="utf-8"))
    assert problem["title"] == "three_wheeler on gelände FILE"
    assert problem["terrain"]["file"] == "gelände FILE.npz"
    start, goal = ([problem[name][axis] for axis in "xy"] for name in ("start", "goal"))
    assert 1.0 < np.hypot(*np.subtract(goal, start)) < 4.0
