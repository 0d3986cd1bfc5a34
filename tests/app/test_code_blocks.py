"""Tests of every block of code in README and docs, by its language.

- ``python`` blocks and code cells are executed in the order of the page, in one namespace. What a
  page takes as given is in `given`. Pages of code cells alone are executed when they are built,
  closed forms here as well.
- ``toml`` is read: a problem, a vehicle, a wheel test, or keys that complete one of them.
- ``bash`` has commands of slipfree with arguments and options that exist.
- ``c`` is compiled with the code that it includes.
- ``console`` is only in the pages that `test_transcripts.py` plays, with their other blocks.
- ``text`` is no code. A block without a language is refused.
"""

import re
import shlex
import shutil
import subprocess
import sys
from functools import partial
from itertools import count
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
import rasterio
import typer

import slipfree as sf
from helpers.cases import ROOT
from helpers.commands import printed
from helpers.fuzz_files import document
from slipfree.cli import app
from slipfree.files.atlas_files import Site, write_atlas
from slipfree.files.toml import load_toml
from slipfree.files.urdf.tree import UrdfTable
from slipfree.files.vehicle_toml import file_of, validated
from slipfree.problem.wheel_test import read_wheel_file

PAGES = [
    ROOT / "README.md",
    *(page for page in sorted((ROOT / "docs").rglob("*.md")) if "_build" not in page.parts),
]
FENCE = re.compile(r"^(```+)([^\n]*)\n(.*?)^\1$", re.MULTILINE | re.DOTALL)
LANGUAGES = {"python", "toml", "bash", "console", "c", "text"}
PLAYED = {"tutorial.md", "errors.md"}  # by test_transcripts.py
CLOSED_FORMS = pytest.param(ROOT / "docs" / "closed_forms.md", id="closed_forms")
PLAIN = {"x": [-5, 5], "y": [-5, 5], "spacing": 0.5}
PROBLEMS = {  # shipped problems that the keys of a verb complete
    "direct": "paper_direct",
    "inverse": "paper_inverse",
    "plan": "plan_rigid_hills",
    "fit": "fit_skid_steer",
    "atlas": "jacksboro_atlas",
}
VERBS = {"inverse": "inverse", "plan": "plan"}  # of blocks without one, by page
EXCLUSIVE = {"driver": "inputs", "inputs": "driver", "path": "given", "given": "path"}
VEHICLE, WHEEL = {"wheels", "shapes"}, {"wheel", "soil", "test"}  # keys of other files


def blocks_of(page, *languages):
    """Return the texts of the blocks of languages in a page."""
    return [text for _, words, text in FENCE.findall(page.read_text()) if words in languages]


def pages_with(language):
    """Return the pages with blocks of a language, except those that are played, as parameters."""
    pages = [page for page in PAGES if page.name not in PLAYED and blocks_of(page, language)]
    return [pytest.param(page, id=page.stem) for page in pages]


def test_every_block_has_a_language():
    for page in PAGES:
        for _, language, text in FENCE.findall(page.read_text()):
            assert language in LANGUAGES or language.startswith("{"), (page.name, text)
            assert language != "console" or page.name in PLAYED, page.name


def given(page: str) -> dict[str, Any]:
    """Return the names that a page takes as given; write the files that it reads."""
    axis = np.linspace(-4.0, 4.0, 17)
    ground = sf.Bicubic(sf.Grid(axis, axis, np.zeros((17, 17))), mu=0.6)
    vehicle = sf.catalog.skid_steer() if page == "soil" else sf.catalog.three_wheeler()
    model = sf.direct_kinematics(vehicle, ground)
    names = {"ground": ground, "vehicle": vehicle, "model": model, "Cost": sf.Cost}
    if page == "atlas":
        poses = sf.atlas(model, headings=2, compiled=False)
        write_atlas("poses.nc", poses, Site(ground.grid.z, 0.6))
    if page in ("speed", "control"):
        found = sf.plan(
            model, sf.settle(model), goal={"y": 1.2}, costs={"effort": 1}, duration=10.0
        )
        names |= {"found": found}
        names |= {"measured": partial(next, (model.rows("x", found.replay, k) for k in count()))}
    return names


@pytest.mark.slow
@pytest.mark.usefixtures("folder", "ros")
@pytest.mark.parametrize("page", [*pages_with("python"), CLOSED_FORMS])
def test_python_runs(page, monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    names = {"__name__": "page"} | given(page.stem)
    for text in blocks_of(page, "python", "{code-cell} ipython3"):
        exec(compile(text, page.name, "exec"), names)


def write(file, keys):
    file.write_text(document(keys))
    return file


def shipped(name):
    return load_toml((ROOT / "problems" / f"{name}.toml").read_text())


def completed(keys, before):
    """Return a problem with the keys of a block, whose tables replace those before."""
    rest = {k: v for k, v in before.items() if k not in {EXCLUSIVE.get(key) for key in keys}}
    terrain = keys.get("terrain", {})
    if "obstacles" in terrain and "synthetic" not in terrain:
        rest |= {"model": "dynamics", "terrain": {"friction": 0.9, "synthetic": PLAIN}}
    if "friction" in keys.get("plan", {}).get("robust", {}):
        rest |= {"terrain": rest["terrain"] | {"friction": 0.6}}
    if "longitude" in keys.get("start", {}):
        rest |= {"model": "kinematics", "terrain": {"file": "site.tif"}}
    if "terrain" in keys and not terrain.keys() & {"file", "sample", "synthetic"}:
        keys = keys | {"terrain": rest["terrain"] | terrain}
    return rest | keys


@pytest.mark.parametrize("page", pages_with("toml"))
def test_toml_is_accepted(page, folder):
    """A block without verb completes the last one of the page that has one."""
    (folder / "points.csv").write_text("slip,pull\n0.1,2.0\n0.4,9.0\n")
    place = rasterio.Affine(10, 0, 440_000, 0, -10, 5_101_000)
    profile = {"width": 200, "height": 200, "count": 1, "dtype": "float32", "crs": "EPSG:32633"}
    with rasterio.open(
        folder / "site.tif", "w", driver="GTiff", transform=place, **profile
    ) as file:
        file.write(np.zeros((1, 200, 200), "f4"))
    verb, before = VERBS.get(page.stem, "direct"), None
    for text in blocks_of(page, "toml"):
        keys = load_toml(text)
        if "urdf" in keys:
            validated(UrdfTable, file_of(folder / "p.toml", text))
        elif keys.keys() & VEHICLE:
            base = {} if "wheels" in keys else shipped("vehicles/trike")
            assert sf.read_vehicle(write(folder / "vehicle.toml", base | keys)).wheels
        elif keys.keys() & WHEEL:
            before = (before if before and "wheel" in before else {}) | keys
            read_wheel_file(write(folder / "wheel.toml", before), [])
        else:
            if "verb" in keys or before is None or "wheel" in before:
                verb, before = keys.get("verb", verb), None
            shown = shipped(PROBLEMS[verb]) if verb in PROBLEMS else {}
            before = completed(keys, before or shown)
            command = "run" if verb in ("direct", "inverse", "plan") else verb.split("-")[0]
            sf.load_problem(write(folder / "p.toml", before), command=command)


@pytest.mark.parametrize("page", pages_with("bash"))
def test_commands_have_known_options(page):
    commands = typer.main.get_command(app).commands
    text = "".join(blocks_of(page, "bash")).replace("\\\n", "")
    found = [shlex.split(line, comments=True) for line in text.splitlines()]
    for _, name, *words in (line for line in found if line[:1] == ["slipfree"]):
        with commands[name].make_context(name, words, resilient_parsing=False):
            pass


@pytest.mark.slow
@pytest.mark.skipif(not shutil.which("cc"), reason="needs a C compiler")
@pytest.mark.parametrize("page", pages_with("c"))
def test_c_compiles_with_the_exported_code(page, folder):
    for text in blocks_of(page, "bash"):
        for line in text.splitlines():
            printed(*shlex.split(line)[1:])
    for text in blocks_of(page, "c"):
        (folder / "main.c").write_text(text)
        (source,) = (f for f in (folder / "onboard").glob("*.c") if not f.stem.endswith("_test"))
        subprocess.run(["cc", "-std=c99", "-o", "main", "main.c", source, "-lm"], check=True)
        subprocess.run(["./main"], check=True)


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
def ros(monkeypatch):
    """Offer the names that a node of ROS 2 imports."""
    modules = {"geometry_msgs.msg": {"Twist": Twist}, "rclpy.node": {"Node": Node}}
    modules["nav_msgs.msg"] = {"Odometry": type("Odometry", (), {})}
    for name, values in modules.items():
        for part in (name.partition(".")[0], name):
            module = ModuleType(part)
            module.__dict__.update(values)
            monkeypatch.setitem(sys.modules, part, module)


def driver():
    """Return the class of the documentation."""
    page = ROOT / "docs" / "howto" / "control.md"
    (text,) = (text for text in blocks_of(page, "python") if "rclpy" in text)
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


@pytest.mark.usefixtures("ros")
def test_the_node_drives_to_its_goal_and_stops_without_a_pose():
    vehicle = sf.catalog.skid_steer()
    hills = sf.Analytic(lambda x, y: 0.03 * x * y)
    world = sf.commanded(sf.direct_kinematics(vehicle, hills), speed=0.4)
    ranges = {"forward": (0.0, 0.5), "yaw_rate": (-0.8, 0.8)}
    goal = {"x": -0.4, "y": 1.0}
    task = sf.SamplingTask(
        world, {"slip": 1.0}, goal, 3.0, ranges, intervals=5, candidates=48, compiled=False
    )
    node = driver()(task, period=0.5)
    node.on_timer()
    assert (node.published[-1].linear.x, node.published[-1].angular.z) == (0.0, 0.0)
    here = sf.settle(world)
    for _ in range(10):
        node.on_odometry(odometry(here))
        node.on_timer()
        sent = node.published[-1]
        inputs = world.inputs(forward=sent.linear.x, yaw_rate=sent.angular.z)
        here = sf.simulate(world, here, inputs, [0.0, 0.5]).part(slice(-1, None))
    assert np.hypot(here["x"][-1] + 0.4, here["y"][-1] - 1.0) < 0.2
    assert not node.warnings
    node.pose = np.full(3, np.nan)
    node.on_timer()
    assert node.warnings
    assert node.published[-1].linear.x == 0.0
