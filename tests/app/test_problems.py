"""Tests of shipped problem files, and of the alternatives in the comments of starters."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from helpers.cases import DATA, PROBLEMS, ROOT
from helpers.commands import build_errors, error_of, invoke, refuses, sets
from helpers.problem_files import FILE, VALID, _read
from slipfree.files.toml import EXAMPLE, ProblemError
from slipfree.problem.load import load_problem
from slipfree.problem.result import build, run_problem
from slipfree.problem.verbs.direct import Direct
from slipfree.solve.sampling import input_samples

HALF_RADIUS = 0.15


def motion(name, *settings):
    return run_problem(load_problem(PROBLEMS / f"{name}.toml", settings)).trajectory


def test_kilometres_over_a_real_map():
    trajectory = motion("real_dem_direct", "time.step=10.0")
    x, y, z = (trajectory[name] for name in "xyz")
    assert trajectory.stop is None
    assert np.hypot(x[-1] - x[0], y[-1] - y[0]) > 3000
    assert np.ptp(x) / 74.4 + np.ptp(y) / 92.7 > 30  # cells of the map
    assert np.ptp(z) > 200
    assert trajectory["closure_residual"].max() < 1e-12


def rocks_on_tracks(trajectory, rocks):
    """Count the rocks higher than half a wheel radius that a contact passes over."""
    return sum(
        height > HALF_RADIUS
        and np.hypot(trajectory["contact_x"] - x, trajectory["contact_y"] - y).min() < diameter / 4
        for x, y, diameter, height in rocks
    )


@pytest.mark.slow
def test_rocks_stop_a_rigid_wheel_and_are_crossed_as_it_feels_them():
    problem = load_problem(PROBLEMS / "rover_rocks_direct.toml")
    crossed = run_problem(problem).trajectory
    assert rocks_on_tracks(crossed, problem.spec.terrain.synthetic.placed_rocks) >= 5
    assert crossed.stop is None
    assert crossed["clearance"].min() >= 0
    assert crossed["relative_curvature"].min() > 0
    bare = motion("rover_rocks_direct", "terrain.rolled=")
    assert bare.stop.name == "clearance[right]"
    assert "wheel right touches a second time at (1.0" in bare.stop.words


def test_a_mecanum_platform_carries_out_commands_without_slip():
    trajectory = motion("mecanum_inverse")
    assert trajectory.stop is None
    assert np.hypot(trajectory["slip_along"], trajectory["slip_across"]).max() < 1e-12
    for name in ("forward", "right", "yaw_rate"):
        assert np.abs(trajectory[f"{name}_error"]).max() < 1e-12
    assert max(trajectory.facts[f"replay_{name}"].value for name in ("x", "y")) < 1e-4
    assert trajectory["utilisation"].max() < 0.3


def test_three_models_of_a_mecanum_platform_agree():
    """Friction, least slip, and inertia with compliant contacts, sideways over uneven ground."""
    friction = motion("mecanum_direct")
    least = motion("mecanum_direct", "model=kinematics", "law=")
    inertia = motion("mecanum_direct", "model=dynamics", "law=", "solver.tolerance=1e-6")
    for run in (friction, least, inertia):
        assert run.stop is None
        assert 1.59 < np.hypot(run["x"], run["y"])[-1] < 1.61  # 0.2 m/s in 8 s
        assert np.abs(run["heading"] - run["heading"][0]).max() < 5e-3
    slips = (
        np.sqrt(np.mean(run["slip_along"] ** 2 + run["slip_across"] ** 2, axis=0))
        for run in (friction, inertia)
    )
    np.testing.assert_allclose(*slips, rtol=0.03)
    start = inertia.t > 0.5  # started at rest
    np.testing.assert_allclose(
        inertia["utilisation"][start], friction["utilisation"][start], rtol=0, atol=0.02
    )


@pytest.mark.slow
def test_a_rover_with_four_steered_wheels_carries_out_commands():
    trajectory = motion("crab_inverse")
    assert trajectory.stop is None
    assert trajectory.facts["replay_x"].value < 1e-3
    steering = [name for name in trajectory if name.startswith("steer_") and name[-6:] == "_error"]
    assert len(steering) == 4
    settled = np.max([np.abs(trajectory[name]) for name in steering], axis=0) < 0.02
    assert settled.mean() > 0.6
    for name in ("forward", "right", "yaw_rate"):
        assert np.abs(trajectory[f"{name}_error"][settled]).max() < 5e-3
    assert np.abs(trajectory["steer_rear_left_rate"]).max() <= 1.5


# Starters: each alternative in their comments is accepted literally

STARTERS = ROOT / "src" / "slipfree" / "starters"
MAP = "terrain.synthetic=", "terrain.file=map.npz"
TIMES = "[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]"
RATES = "left_rate=0.4, steer_rate=0.1"
OTHERS = [('vehicle={catalog="rocky7"}',), ('vehicle={file="vehicle.toml"}',)]
WAYS = {  # kind and beginning of a comment: settings of each alternative that it describes
    ("direct", "of both tables"): [MAP],
    ("atlas", "of both tables"): [MAP],
    ("atlas", "another vehicle of the catalogue"): OTHERS,
    ("direct", "another vehicle of the catalogue"): OTHERS,
    ("direct", "[inputs]"): [
        ("driver=", f"inputs={{right_rate=0.4, {RATES}}}"),
        ("driver=", f"inputs={{right_rate=[[0.0, 0.4], [2.0, 0.3]], {RATES}}}"),
    ],
    ("inverse", "of both tables"): [MAP],
    ("inverse", "[path]"): [
        (
            "given=",
            f"path={{t={TIMES}, x=[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], y={TIMES}, "
            "heading=[NORTH, NORTH, NORTH, NORTH, NORTH, NORTH]}".replace("NORTH", repr(np.pi / 2)),
            "time.duration=5",
        ),
        ("given=", 'path={file="path.csv"}', "time.duration=5"),
    ],
    ("plan", "of both tables"): [MAP],
    ("plan", "[driver]"): [('driver={name="route", speed=0.2}',)],
}


def comments() -> list[tuple[str, str]]:
    """Return the kinds of the starters, and the alternatives in their comments."""
    pattern = re.compile(r"^# Instead:? (.*)", re.MULTILINE)
    files = sorted(STARTERS.glob("*.toml"))
    return [(file.stem, words) for file in files for words in pattern.findall(file.read_text())]


@pytest.fixture
def folder(folder):
    axis = np.linspace(-5.0, 8.0, 27)
    np.savez("map.npz", x=axis, y=axis, z=0.05 * np.sin(axis)[:, None] * np.cos(axis))
    Path("vehicle.toml").write_text((ROOT / "problems" / "vehicles" / "trailer.toml").read_text())
    rows = "".join(f"{t},0.0,{0.2 * t},{np.pi / 2}\n" for t in range(6))
    Path("path.csv").write_text(f"t,x,y,heading\n{rows}")
    floor, step = "1,-5,-1\n1,5,-1\n1,5,0\n1,-5,0\n", "2,0,0\n2,4,0\n2,4,0.06\n2,0,0.06\n"
    Path("solids.csv").write_text(f"solid,x,z\n{floor}{step}")
    return folder


def test_every_other_way_is_tried() -> None:
    found = comments()
    for kind, words in found:
        assert [key for key in WAYS if key[0] == kind and words.startswith(key[1])], words
    assert len(found) == len(WAYS)


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize("key", WAYS)
def test_a_starter_goes_the_other_way(key: tuple[str, str]) -> None:
    kind, beginning = key
    (words,) = (text for name, text in comments() if name == kind and text.startswith(beginning))
    invoke("new", kind, "mine", code=0)
    for settings in WAYS[key]:
        if name := re.search(r'name = "(\w+)"', words):
            assert name[1] in " ".join(settings)
        assert invoke("check", "mine.toml", *sets(*settings), code=0).stdout.startswith("ok")


REFUSED = tomllib.loads((DATA / "refused_settings.toml").read_text())
SLOW = [
    *("plan_crater_field", "plan_parking", "plan_rigid_robot"),
    *("dynamics_rocks", "rover_inverse", "paper_inverse"),
]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        pytest.param(name, words, marks=[pytest.mark.slow] * (name.removesuffix(".toml") in SLOW))
        for name, table in REFUSED.items()
        for words in table
    ],
)
def test_settings_that_cannot_be_built_are_refused(name, words):
    (file,) = (folder / name for folder in (PROBLEMS, DATA) if (folder / name).exists())
    assert words in " ".join(build_errors(file, REFUSED[name][words]).split())


def _faults(folder: Path, text: str, *settings: str) -> list[str]:
    """Return the faults with the path of the file taken out."""
    caught = error_of(ProblemError, _read, folder, text, *settings)
    path = str(folder / "p.toml")
    assert all(each.startswith((path, "--set")) for each in caught.faults)
    return [each.replace(path, "p.toml") for each in caught.faults]


def _changed(old: str, new: str) -> str:
    assert VALID.count(old) == 1
    return VALID.replace(old, new)


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("r1 = 0.05", "r3 = 0.05", "p.toml:11: vehicle.r3: expected one of catalog, axle, half_tr"),
        ("x = 0.1", "x = -1e155", "p.toml:14: start.x: expected a number with an absolute value o"),
        ("x = 0.1", f"x = 0x{'f' * 5000}", "p.toml:14: start.x: expected a number, found a whole"),
        ("x = 0.1", 'x = "1 m"', f"p.toml:14: start.x: expected {EXAMPLE}, found '1 m'; write"),
        ("step = 0.25", "step = 2", "p.toml:24: time.step: expected at most the duration, 1 s, fo"),
        ("step = 0.25", "step = 1\n[solver]\ntolerance = 0", "p.toml:26: solver.tolerance: expect"),
        ("step = 0.25", 'step = 1\n[output]\nfile = ""', "p.toml:26: output.file: expected text t"),
        ("steer_rate = 0", "steer_rate = [[0, 1], [0, 2]]", "p.toml:20: inputs.steer_rate: expect"),
        (
            "base = 2.0",
            "ramp = { start = 1, end = 2, rise = 1, smooth = 1 }",
            "p.toml:7: terrain.synthetic.ramp.smooth: expected true or false, found 1",
        ),
    ],
)
def test_one_fault(old: str, new: str, fault: str, tmp_path: Path) -> None:
    (found,) = _faults(tmp_path, _changed(old, new))
    assert found.startswith(fault)


def test_all_faults_at_once_in_order(tmp_path: Path) -> None:
    text = _changed("spacing = 0.5", 'spacing = "a"').replace("r1", "rr").replace("step", "stepp")
    found = _faults(tmp_path, text, "time.duration=-1", "frame=map")
    assert [re.split(":? expected", each)[0] for each in found] == [
        *("p.toml:6: terrain.synthetic.spacing", "p.toml:11: vehicle.rr", "p.toml:22: time.step"),
        *("p.toml:24: time.stepp: did you mean 'step'?", "--set time.duration", "--set frame"),
    ]


def test_an_empty_file_lacks_its_verb_and_then_its_tables(tmp_path: Path) -> None:
    (found,) = _faults(tmp_path, "")
    assert found.endswith(" or 'inverse' or 'plan' for this command, found none; add the key")
    found = _faults(tmp_path, "verb = 'direct'")
    assert found[0] == "p.toml:1: expected exactly one of inputs, driver, found none"
    assert "p.toml:1: time: expected a table [time], found none" in found


def test_inputs_and_driver_exclude_each_other(tmp_path: Path) -> None:
    driver = '[driver]\nname = "straight"\nspeed = 1\n'
    (both,) = _faults(tmp_path, VALID + driver)
    assert both.startswith("p.toml:25: driver: expected exactly one of inputs, driver, found inp")
    inputs = VALID[VALID.index("[inputs]") : VALID.index("[time]")]
    (none,) = _faults(tmp_path, VALID.replace(inputs, ""))
    assert none == "p.toml:1: expected exactly one of inputs, driver, found none"


def test_unreadable_files(tmp_path: Path) -> None:
    (found,) = _faults(tmp_path, 'verb = "direct"\nx = 0,5\n')
    assert found.startswith("p.toml:2: expected TOML, found an error in column 6: Expected newline")
    assert found.endswith("; write key = value once on a line, numbers with a decimal point")
    (found,) = _faults(tmp_path, 'verb = "direct"\nx = \u22120.5\n')
    assert found.startswith("p.toml:2: ")
    assert found.endswith("; replace the character '\u2212'")
    with pytest.raises(ProblemError, match=r"no\.toml: expected a problem file.*No such file"):
        load_problem(tmp_path / "no.toml")
    (tmp_path / "p.toml").write_bytes(b'a = 1\nb = "\xff"\n')
    with pytest.raises(ProblemError, match=r"p\.toml:2: expected text in UTF-8, found the byte 0x"):
        load_problem(tmp_path / "p.toml")


def test_a_byte_order_mark_and_windows_lines_are_fine(tmp_path: Path) -> None:
    path = tmp_path / "p.toml"
    path.write_bytes(b"\xef\xbb\xbf" + VALID.replace("\n", "\r\n").encode())
    assert load_problem(path).spec.start == {"x": 0.1, "heading": 0.2}


def test_settings(tmp_path: Path) -> None:
    settings = ["time.duration=2", "title=a-b", "frame='rep103'", "vehicle.r1="]
    settings += ["inputs.steer_rate=[[0, 0.1], [1, 0.2]]", "solver.tolerance=1e-6"]
    spec = _read(tmp_path, VALID, *settings).spec
    assert spec.time.duration == 2
    assert (spec.title, spec.frame) == ("a-b", "rep103")
    assert spec.inputs["steer_rate"] == ((0.0, 0.1), (1.0, 0.2))
    assert "r1" not in spec.vehicle.keywords
    assert spec.solver.tolerance == 1e-6


@pytest.mark.parametrize("setting", ["time.step", "time.step=[1", "time.step=1\nb=2"])
def test_bad_settings(setting: str, tmp_path: Path) -> None:
    (found,) = _faults(tmp_path, VALID, setting)
    assert found.startswith(f"--set {setting.partition('=')[0]}: expected key=value with")


def test_settings_that_do_not_fit(tmp_path: Path) -> None:
    assert "percent? write 0.7)" in _faults(tmp_path, VALID, "terrain.friction=70")[0]
    settings = "vehicle.r1=-1", "solver.bar=1", "time={step=1, stp=1}"
    assert _faults(tmp_path, VALID, *settings) == [
        "--set time: time.duration: expected a value (duration of the motion [s]), found none",
        "--set time: time.stp: did you mean 'step'? expected one of duration, step, found the "
        "unknown key 'stp'",
        "--set solver.bar: expected one of tolerance, compiled, found the unknown key 'bar'",
        "--set vehicle.r1: expected a number of at least 0 (radius of the wheels' tube, zero for "
        "discs, and of the circle of tube centres [m]), found -1",
    ]


def test_every_table_is_frozen_and_strict() -> None:
    wanted = {"frozen": True, "strict": True, "extra": "forbid"}
    for name, field in Direct.model_fields.items():
        kind = field.annotation
        if hasattr(kind, "model_config"):
            assert kind.model_config.items() >= wanted.items(), name


def test_samples_contain_the_jumps() -> None:
    inputs = {"a": ((0.0, 1.0), (0.5, 2.0), (0.8, 3.0), (7.0, 4.0)), "b": 5.0}
    t, rates = input_samples(1.0, 0.4, inputs)
    np.testing.assert_allclose(t, [0, 0.4, 0.5, 0.8, 1.0])
    np.testing.assert_array_equal(rates["a"], [1, 1, 2, 3])
    assert rates["b"] == 5.0
    assert input_samples(0.3, 0.1, {})[0].tolist() == pytest.approx([0, 0.1, 0.2, 0.3])


def test_piecewise_inputs_on_flat_ground(tmp_path: Path) -> None:
    rates = [f"inputs.{side}_rate=[[0, 0.5], [0.3, 1.0]]" for side in ("right", "left")]
    motion = run_problem(_read(tmp_path, VALID, *rates)).trajectory
    expected = 0.3 * (0.5 * 0.3 + 1.0 * 0.7)
    assert motion["wheel_angle", "left"][-1] == pytest.approx(0.5 * 0.3 + 0.7, abs=1e-9)
    assert np.hypot(motion["x"][-1] - 0.1, motion["y"][-1]) == pytest.approx(expected, abs=1e-7)


def test_a_bad_map_is_refused_at_its_key(tmp_path: Path) -> None:
    x, y = np.linspace(-3, 3, 25), np.linspace(-3, 4, 29)
    np.savez(tmp_path / "g.npz", x=x**3, y=y, z=np.zeros((25, 29)))
    words = r"p\.toml:4: terrain\.file: .*g\.npz: .*axis x must be uniform"
    refuses(ProblemError, words, build, _read(tmp_path, FILE))


def test_a_wheel_over_a_narrow_pit_stands_on_its_rim(tmp_path: Path) -> None:
    x, y = np.linspace(-3, 3, 121), np.linspace(-3, 4, 141)
    pit = -0.5 * np.exp(-((x[:, None] - 1.0) ** 2 + (y + 0.5) ** 2) / 0.01)
    np.savez(tmp_path / "g.npz", x=x, y=y, z=pit)
    start = build(_read(tmp_path, FILE, "start.x=0", "start.heading=0")).start
    assert start["clearance", "right"][0] >= 0
    assert np.hypot(start["contact_x", "right"] - 1, start["contact_y", "right"] + 0.5)[0] > 0.1


def test_the_sample_and_rolled(tmp_path: Path) -> None:
    settings = ["synthetic=", "sample=jacksboro", "scale=0.005", "rolled=0.3"]
    settings = [f"terrain.{each}" for each in (*settings, "window=[90, 100, 110, 120]")]
    settings += ["start.x=95", "start.y=115"]
    ground = build(_read(tmp_path, VALID, *settings)).ground
    assert ground.rolled is not None
    assert 0 < ground.rolled.rms < ground.rolled.largest < 0.1
    assert ground.source.endswith("scaled by 0.005")
