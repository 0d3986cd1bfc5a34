"""Tests of problem files: lines and wording of all errors, and objects built from a valid file."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from helpers.problem_files import FILE, VALID, _read
from slipfree.core.errors import DataError
from slipfree.files.toml.source import ProblemError, key_lines
from slipfree.problem.build import samples
from slipfree.problem.load import load_problem
from slipfree.problem.result import build, run_problem
from slipfree.problem.schema import Time
from slipfree.problem.verbs.direct import Direct

OTHERS = (
    "tilt_stop, slide_stop, stiffness, damping, bump, mass, center_of_mass, wheel_mass, grip, "
    "actuated"
)


def _faults(folder: Path, text: str, *settings: str) -> list[str]:
    """Return the faults with the path of the file taken out."""
    with pytest.raises(ProblemError) as caught:
        _read(folder, text, *settings)
    path = str(folder / "p.toml")
    assert all(each.startswith((path, "--set")) for each in caught.value.faults)
    return [each.replace(path, "p.toml") for each in caught.value.faults]


def _changed(old: str, new: str) -> str:
    assert VALID.count(old) == 1
    return VALID.replace(old, new)


def test_lines_of_keys() -> None:
    text = (
        '# a = 1\nverb = "di#rect" # x = 1\n[terrain] # [foo]\nfile = """\n[no]\na = 3 """\n'
        "\"quoted.key\" . b = 'x=]'\nlist = [\n  [1, 2], # ]\n  [3, 4],\n]\ninline = { a = 1 }\n"
        "[a.b]\nc.d = 1\n[[rocks]]\nx = 1\n[rocks.sub]\ny=2\n[[rocks]]\r\nx = 3\n"
        "[ sp . 'a b' ]\nlast = '''it''s\n'''\nend=1"
    )
    tomllib.loads(text)
    assert key_lines(text) == {
        ("verb",): 2,
        ("terrain",): 3,
        ("terrain", "file"): 4,
        ("terrain", "quoted.key"): 7,
        ("terrain", "quoted.key", "b"): 7,
        ("terrain", "list"): 8,
        ("terrain", "inline"): 12,
        ("a",): 13,
        ("a", "b"): 13,
        ("a", "b", "c"): 14,
        ("a", "b", "c", "d"): 14,
        ("rocks",): 15,
        ("rocks", 0): 15,
        ("rocks", 0, "x"): 16,
        ("rocks", 0, "sub"): 17,
        ("rocks", 0, "sub", "y"): 18,
        ("rocks", 1): 19,
        ("rocks", 1, "x"): 20,
        ("sp",): 21,
        ("sp", "a b"): 21,
        ("sp", "a b", "last"): 22,
        ("sp", "a b", "end"): 24,
    }


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        (
            '"direct"',
            '"drive"',
            "p.toml:1: verb: expected 'direct' or 'inverse' or 'plan' for this command, found 'dr",
        ),
        (
            "spacing = 0.5",
            "spacing = -1",
            "p.toml:6: terrain.synthetic.spacing: expected a number greater than 0, found -1",
        ),
        (
            "r1 = 0.05",
            "r1 = -0.05",
            "p.toml:11: vehicle.r1: expected a number of at least 0, found -0.05",
        ),
        (
            "r1 = 0.05",
            "r3 = 0.05",
            "p.toml:11: vehicle.r3: expected one of catalog, axle, "
            "half_track, wheelbase, r1, r2, " + OTHERS + ", found the unknown key 'r3'",
        ),
        (
            "r1 = 0.05",
            "wheel_base = 2",
            "p.toml:11: vehicle.wheel_base: did you mean "
            "'wheelbase'? expected one of catalog, axle, half_track, wheelbase, r1, r2, "
            + OTHERS
            + ", found the unknown key "
            "'wheel_base'",
        ),
        ("r1 = 0.05", 'r1 = "5 cm"', "p.toml:11: vehicle.r1: expected a number, found '5 cm'"),
        ("x = 0.1", "x = nan", "p.toml:14: start.x: expected a finite number, found nan"),
        (
            "x = 0.1",
            "x = -1e155",
            "p.toml:14: start.x: expected a number with an absolute value of "
            "at most 1e+100, found -1e+155",
        ),
        (
            "x = [-3, 3]",
            "x = [-3, 1e200]",
            "p.toml:4: terrain.synthetic.x[1]: expected a number with an absolute value of "
            "at most 1e+100, found 1e+200",
        ),
        (
            "x = 0.1",
            f"x = 0x{'f' * 5000}",
            "p.toml:14: start.x: expected a number, found a whole number of 20000 bits",
        ),
        ("x = 0.1", "x = true", "p.toml:14: start.x: expected a number, found true"),
        (
            "duration = 1",
            "duration = 0",
            "p.toml:23: time.duration: expected a number greater than 0, found 0",
        ),
        ("duration = 1\n", "", "p.toml:22: time.duration: expected a value, found none"),
        (
            "step = 0.25",
            "step = 2",
            "p.toml:24: time.step: expected at most the duration, 1 s, found 2",
        ),
        ("step = 0.25", "step = 1e-9", "p.toml:24: time.step: expected a step with at most"),
        (
            "step = 0.25",
            "step = 1\n[solver]\ntolerance = 0",
            "p.toml:26: solver.tolerance: expected a number of at least 1e-14, found 0",
        ),
        (
            "step = 0.25",
            "step = 1\n[solver]\ntolerance = 1",
            "p.toml:26: solver.tolerance: expected a number of at most 0.01, found 1",
        ),
        (
            "step = 0.25",
            'step = 1\n[output]\nfile = ""',
            "p.toml:26: output.file: expected text that is not empty, found ''",
        ),
        (
            "x = [-3, 3]",
            "x = [-3]",
            "p.toml:4: terrain.synthetic.x[1]: expected a number, found none",
        ),
        (
            "x = [-3, 3]",
            "x = [-3, 3, 4]",
            "p.toml:4: terrain.synthetic.x: expected an array of 2 elements, found [-3, 3, 4]",
        ),
        (
            "x = [-3, 3]",
            "x = 1979-05-27",
            "p.toml:4: terrain.synthetic.x: expected an array, found 1979-05-27",
        ),
        (
            "steer_rate = 0",
            "steer_rate = [[0, 1], [0, 2]]",
            "p.toml:20: inputs.steer_rate: "
            "expected [time, value] pairs whose times ascend from 0, found [[0, 1], [0, 2]]",
        ),
        (
            "steer_rate = 0",
            "steer_rate = [0, 1]",
            "p.toml:20: inputs.steer_rate: expected a "
            "number, or an array of [time, value] pairs, found [0, 1]",
        ),
        ("[vehicle]", "[extra]\na = 1\n[vehicle]", "p.toml:9: extra: expected one of verb, title,"),
        (
            "[vehicle]",
            "rocks = { count = 2.5, diameters = [1, 2], height_ratio = 1, seed = 1 }\n[vehicle]",
            "p.toml:9: terrain.synthetic.rocks.count: expected a whole number, found 2.5",
        ),
        (
            "base = 2.0",
            "ramp = { start = 1, end = 2, rise = 1, smooth = 1 }",
            "p.toml:7: terrain.synthetic.ramp.smooth: expected true or false, found 1",
        ),
        (
            "base = 2.0",
            "power_law = 3",
            "p.toml:7: terrain.synthetic.power_law: expected a table, found 3",
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
        "p.toml:6: terrain.synthetic.spacing",
        "p.toml:11: vehicle.rr",
        "p.toml:22: time.step",
        "p.toml:24: time.stepp: did you mean 'step'?",
        "--set time.duration",
        "--set frame",
    ]


def test_an_empty_file_lacks_its_tables(tmp_path: Path) -> None:
    found = _faults(tmp_path, "")
    assert "p.toml:1: expected exactly one of inputs, driver, found none" in found
    assert "p.toml:1: time: expected a table [time], found none" in found
    assert "p.toml:1: verb: expected a value, found none" in found
    assert len(found) == 6


def test_inputs_and_driver_exclude_each_other(tmp_path: Path) -> None:
    driver = '[driver]\nname = "straight"\nspeed = 1\n'
    (both,) = _faults(tmp_path, VALID + driver)
    assert both.startswith("p.toml:25: driver: expected exactly one of inputs, driver, found inp")
    inputs = VALID[VALID.index("[inputs]") : VALID.index("[time]")]
    (none,) = _faults(tmp_path, VALID.replace(inputs, ""))
    assert none == "p.toml:1: expected exactly one of inputs, driver, found none"
    (still,) = _faults(tmp_path, VALID.replace(inputs, "") + driver, "driver.speed=0")
    assert still == "--set driver.speed: expected a speed other than zero, found 0"


def test_sources_of_the_ground_exclude_each_other(tmp_path: Path) -> None:
    (found,) = _faults(tmp_path, VALID, "terrain.sample=jacksboro")
    assert found == (
        "p.toml:3: terrain.synthetic: expected exactly one of file, sample, synthetic, "
        "found sample and synthetic"
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('verb = "direct"\nx = = 1\n', "p.toml:2: expected TOML, found an error in column 5"),
        ("a = 1\na = 2\n", "p.toml:2: expected TOML, found an error in column 6: Cannot overwr"),
        ("a = 1\nb = [1,\n", "p.toml:2: expected TOML, found an error at the end"),
    ],
)
def test_syntax_errors(text: str, words: str, tmp_path: Path) -> None:
    (found,) = _faults(tmp_path, text)
    assert found.startswith(words)


def test_unreadable_files(tmp_path: Path) -> None:
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
    problem = _read(
        tmp_path,
        VALID,
        "time.duration=2",
        "title=a b".replace(" ", "-"),
        "frame='rep103'",
        "inputs.steer_rate=[[0, 0.1], [1, 0.2]]",
        "vehicle.r1=",
        "solver.tolerance=1e-6",
    )
    spec = problem.spec
    assert spec.time.duration == 2
    assert (spec.title, spec.frame) == ("a-b", "rep103")
    assert spec.inputs["steer_rate"] == ((0.0, 0.1), (1.0, 0.2))
    assert "r1" not in spec.vehicle.keywords
    assert spec.solver.tolerance == 1e-6


@pytest.mark.parametrize(
    "setting",
    ["time.step", "a b=1", "time.step=[1", "time.step=1\nb=2", "=1"],
)
def test_bad_settings(setting: str, tmp_path: Path) -> None:
    (found,) = _faults(tmp_path, VALID, setting)
    assert found.startswith(f"--set {setting.partition('=')[0]}: expected key=value with")


def test_settings_of_keys_that_do_not_exist(tmp_path: Path) -> None:
    settings = "time.step.x=1", "no.key=", "time.step.x=", "time.step.x.y="
    missing = "expected a key to remove, found no such key; correct the key"
    assert _faults(tmp_path, VALID, *settings) == [
        "--set time.step.x: expected a key of a table, found that 'time.step' is not a table; "
        "correct the key",
        *(f"--set {key}: {missing}" for key in ("no.key", "time.step.x", "time.step.x.y")),
    ]


def test_settings_that_do_not_fit(tmp_path: Path) -> None:
    assert _faults(tmp_path, VALID, "vehicle.r1=-1", "foo.bar=1", "time={duration=1, stp=1}") == [
        "--set time: time.step: expected a value, found none",
        "--set time: time.stp: did you mean 'step'? expected one of duration, step, found the "
        "unknown key 'stp'",
        "--set vehicle.r1: expected a number of at least 0, found -1",
        "--set foo: expected one of verb, title, time, solver, output, terrain, start, frame, "
        "vehicle, model, slip, law, inputs, driver, formulation, found the unknown key 'foo'",
    ]


def test_every_table_is_frozen_and_strict() -> None:
    wanted = {"frozen": True, "strict": True, "extra": "forbid"}
    for name, field in Direct.model_fields.items():
        kind = field.annotation
        if hasattr(kind, "model_config"):
            assert kind.model_config.items() >= wanted.items(), name


def test_build(tmp_path: Path) -> None:
    setup = build(_read(tmp_path, VALID))
    assert setup.start["z"][0] == pytest.approx(2.3, abs=1e-12)
    assert setup.start["heading"][0] == 0.2
    np.testing.assert_allclose(setup.t, [0, 0.25, 0.5, 0.75, 1])
    assert setup.ground.grid.z.shape == (13, 15)


def test_frame_rep103_counts_the_heading_from_x(tmp_path: Path) -> None:
    setup = build(_read(tmp_path, VALID, "frame=rep103"))
    assert setup.start["yaw"][0] == pytest.approx(0.2, abs=1e-12)


def test_samples_contain_the_jumps() -> None:
    time = Time(duration=1.0, step=0.4)
    inputs = {"a": ((0.0, 1.0), (0.5, 2.0), (0.8, 3.0), (7.0, 4.0)), "b": 5.0}
    t, rates = samples(time, inputs)
    np.testing.assert_allclose(t, [0, 0.4, 0.5, 0.8, 1.0])
    np.testing.assert_array_equal(rates["a"], [1, 1, 2, 3])
    assert rates["b"] == 5.0
    assert samples(Time(duration=0.3, step=0.1), {})[0].tolist() == pytest.approx(
        [0, 0.1, 0.2, 0.3]
    )


def test_piecewise_inputs_on_flat_ground(tmp_path: Path) -> None:
    rates = [f"inputs.{side}_rate=[[0, 0.5], [0.3, 1.0]]" for side in ("right", "left")]
    motion = run_problem(_read(tmp_path, VALID, *rates)).trajectory
    expected = 0.3 * (0.5 * 0.3 + 1.0 * 0.7)
    assert motion["wheel_angle", "left"][-1] == pytest.approx(0.5 * 0.3 + 0.7, abs=1e-9)
    assert np.hypot(motion["x"][-1] - 0.1, motion["y"][-1]) == pytest.approx(expected, abs=1e-7)


def test_result_knows_its_problem(tmp_path: Path) -> None:
    motion = run_problem(_read(tmp_path, VALID + "# Ü\n", "time.step=0.5")).trajectory
    assert motion.attributes["problem"] == VALID + "# Ü\n"
    assert motion.attributes["settings"] == "time.step=0.5"
    assert motion.attributes["title"] == "p"
    assert motion.attributes["ground_height"] == "2.000 to 2.000 m"


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            ["start.bogus=1"],
            "--set start.bogus: expected one of x, y, heading, tilt_right, "
            "tilt_left, steer, found the unknown key 'bogus'",
        ),
        (
            ["inputs.rigth_rate=1"],
            "--set inputs.rigth_rate: did you mean 'right_rate'\\? expected one of right_rate, "
            "left_rate, steer_rate, found the unknown key 'rigth_rate'",
        ),
        (
            ["start.x=50"],
            "--set start.x: expected a start on the map, which extends from -3 to 3 m",
        ),
        (
            ["vehicle.r1=0", "vehicle.r2=0"],
            r"p.toml:9: vehicle: r1, r2: expected a positive radius",
        ),
        (["terrain.synthetic.x=[3, -3]"], "p.toml:3: terrain.synthetic: .*x_range"),
        (["terrain.synthetic.x=[0, 1]"], "p.toml:3: terrain.synthetic: .*at least 4 nodes"),
        (["terrain.synthetic.spacing=1e-6"], "expected a ground of at most 5e.07 nodes, found 4"),
        (["terrain.rolled=1e-4"], "--set terrain.rolled: expected a ground of at most 5e.07 nodes"),
        (["terrain.window=[7, 8, 7, 8]"], "--set terrain.window: .*at least 4 nodes.*found 0"),
        (["terrain.synthetic.placed_rocks=[[0, 0, 1, 0]]"], "diameter and height must be positive"),
    ],
)
def test_what_only_the_model_knows(settings: list[str], words: str, tmp_path: Path) -> None:
    problem = _read(tmp_path, VALID, *settings)
    with pytest.raises(ProblemError, match=words):
        build(problem)


def test_missing_inputs_are_listed(tmp_path: Path) -> None:
    problem = _read(tmp_path, _changed("left_rate = 0.5\n", ""))
    with pytest.raises(
        ProblemError, match=r"p.toml:17: inputs.left_rate: expected a rate, found no"
    ):
        build(problem)


def _npz(path: Path, **changes: object) -> None:
    x, y = np.linspace(-3, 3, 25), np.linspace(-3, 4, 29)
    arrays = {"x": x, "y": y, "z": np.zeros((25, 29))} | changes
    np.savez(path, **{name: array for name, array in arrays.items() if array is not None})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"z": np.full((25, 29), np.nan)},
            "expected heights, found none at any node",
        ),
        ({"x": np.linspace(-3, 3, 25) ** 3}, "axis x must be uniform"),
        ({"y": np.linspace(4, -3, 29)}, "axis y must increase, found it decreasing"),
        (
            {"x": np.arange(3.0), "z": np.zeros((3, 29))},
            "at least 4 nodes for a cubic spline, found",
        ),
        ({"z": np.zeros((29, 25))}, r"z must have the shape .* pass z\.T"),
        ({"z": None}, "expected the arrays x, y, z"),
    ],
)
def test_bad_grounds(changes: dict[str, object], words: str, tmp_path: Path) -> None:
    _npz(tmp_path / "g.npz", **changes)
    problem = _read(tmp_path, FILE)
    with pytest.raises(ProblemError, match=rf"p\.toml:4: terrain\.file: .*g\.npz: .*{words}"):
        build(problem)


def test_ground_file_that_is_not_there(tmp_path: Path) -> None:
    problem = _read(tmp_path, FILE)
    with pytest.raises(
        DataError, match=r"p\.toml:4: terrain\.file: .*g\.npz: expected a map, found"
    ):
        build(problem)


def test_ground_file_scaled_and_cut(tmp_path: Path) -> None:
    _npz(tmp_path / "g.npz", z=np.full((25, 29), 3.0))
    setup = build(_read(tmp_path, FILE, "terrain.scale=2", "terrain.window=[-4, 5, -6, 8]"))
    grid = setup.ground.grid
    assert (grid.x[0], grid.x[-1], grid.y[0], grid.y[-1]) == (-4, 5, -6, 8)
    assert grid.z.max() == 6
    assert setup.start["z"][0] == pytest.approx(6.3, abs=1e-12)


def test_a_wheel_over_a_narrow_pit_cannot_stand(tmp_path: Path) -> None:
    x, y = np.linspace(-3, 3, 121), np.linspace(-3, 4, 141)
    pit = -0.5 * np.exp(-((x[:, None] - 1.0) ** 2 + (y + 0.5) ** 2) / 0.01)
    np.savez(tmp_path / "g.npz", x=x, y=y, z=pit)
    problem = _read(tmp_path, FILE, "start.x=0", "start.heading=0")
    with pytest.raises(ProblemError, match=r"p\.toml:\d+: start: .*wheel right.*terrain\.rolled"):
        build(problem)


def test_the_sample_and_rolled(tmp_path: Path) -> None:
    settings = [
        "terrain.synthetic=",
        "terrain.sample=jacksboro",
        "terrain.scale=0.005",
        "terrain.window=[90, 100, 110, 120]",
        "terrain.rolled=0.3",
        "start.x=95",
        "start.y=115",
    ]
    ground = build(_read(tmp_path, VALID, *settings)).ground
    assert ground.rolled is not None
    assert 0 < ground.rolled.rms < ground.rolled.largest < 0.1
    assert ground.source.endswith("scaled by 0.005")
