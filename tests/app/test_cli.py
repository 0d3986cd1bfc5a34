"""Tests of the command line: problems, output, JSON, exit codes, colours, control characters."""

import json
import os
import re
import subprocess
import sys
import tomllib
from copy import deepcopy
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import slipfree
from helpers.cases import DATA, ROOT
from helpers.commands import invoke, printed, refused, sets
from helpers.fuzz_files import bases, document
from helpers.problem_files import PROBLEM
from slipfree.cli import app, console
from slipfree.core.trajectory import Outcome, SolverError, Stop
from slipfree.files import netcdf
from slipfree.system import forks

KINDS = ("direct", "inverse", "plan")


@pytest.fixture(autouse=True)
def folder(folder):
    (folder / "p.toml").write_text(PROBLEM, encoding="utf-8")
    return folder


def _json(*words: str, code: int = 0) -> dict[str, Any]:
    """Return the one object on stdout of a command that must end with a code."""
    result = invoke(*words, "--json", code=code)
    found = json.loads(result.stdout, parse_constant=lambda word: pytest.fail(word))
    assert (found["command"], found["exit_code"]) == (words[0], code)
    assert found["meaning"] == console.MEANINGS[code]
    return found


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_a_new_problem_runs_as_it_is(kind: str) -> None:
    assert "wrote mine.toml" in invoke("new", kind, "mine", code=0).stdout
    text = Path("mine.toml").read_text()
    assert "slipfree run mine.toml" in text
    assert "FILE" not in text
    result = invoke("check", "mine.toml")
    assert (result.exit_code, result.stdout[:2]) == (0, "ok"), result.output
    assert f'verb = "{kind}"' in text
    result = invoke("run", "mine.toml", "--no-draw", "--verbose", code=0)
    iterates = re.findall(r"iteration \d+, constraints ", result.stderr)
    assert (len(iterates) > 3) == (kind == "plan")


def test_a_new_comparison_runs_as_it_is() -> None:
    assert "slipfree compare mine.toml" in invoke("new", "compare", "mine", code=0).stdout
    assert "three-wheeler" in invoke("compare", "mine.toml", code=0).stdout


def test_new_replaces_nothing_unasked() -> None:
    Path("a.toml").write_text("mine")
    result = invoke("new", "plan", "a.toml", code=2)
    assert result.stderr == (
        "a.toml: expected a new file, found an existing one; replace it with --force\n"
    )
    assert Path("a.toml").read_text() == "mine"
    assert invoke("new", "plan", "a", "--force").exit_code == 0
    assert 'verb = "plan"' in Path("a.toml").read_text()
    assert "expected a folder no to write to" in invoke("new", "plan", "no/a").stderr
    Path("b.toml").mkdir()
    assert "found a folder" in invoke("new", "plan", "b", "--force").stderr
    for name in ("", ".", "a\nb"):
        assert "expected a file name of printable characters" in invoke("new", "plan", name).stderr
    assert "slipfree run 'a b.toml'" in invoke("new", "plan", "a b").stdout
    assert "'direct', 'inverse', 'plan'" in refused("new", "walk", "a")


def test_examples_are_the_shipped_problems() -> None:
    lines = invoke("examples").stdout.splitlines()
    shipped = {
        path.relative_to(ROOT / "problems").with_suffix("").as_posix(): path
        for path in (ROOT / "problems").rglob("*.toml")
    }
    listed = {line.split()[0]: line for line in lines if line and "slipfree" not in line}
    assert listed.keys() == shipped.keys()
    for name, path in shipped.items():
        data = tomllib.loads(path.read_text())
        assert data.get("title", data.get("name")) in listed[name]
        assert data.get("verb", "vehicle") in listed[name]
    found = _json("examples")["examples"]
    assert {each["name"] for each in found} == shipped.keys()


@pytest.mark.slow
def test_an_example_is_copied_with_what_it_needs(folder: Path) -> None:
    invoke("examples", "your_vehicle.toml", "--to", "deep/er", code=0)
    copied = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("deep/**/*.toml"))
    assert copied == ["deep/er/vehicles/trailer.toml", "deep/er/your_vehicle.toml"]
    assert invoke("check", "deep/er/your_vehicle.toml").exit_code == 0
    assert invoke("examples", "dynamics_ice", "--to", "map").exit_code == 0
    assert invoke("check", "map/dynamics_ice.toml").exit_code == 0
    assert "use --force to replace" in refused("examples", "your_vehicle", "--to", "deep/er")
    assert invoke("examples", "your_vehicle", "--to", "deep/er", "--force").exit_code == 0


def test_all_examples_at_once_make_the_commands_of_the_readme_work() -> None:
    assert invoke("examples", "--to", "problems").exit_code == 0
    for path in (ROOT / "problems").rglob("*.toml"):
        copy = Path("problems") / path.relative_to(ROOT / "problems")
        assert copy.read_bytes() == path.read_bytes()


@pytest.mark.slow
def test_quiet_prints_errors_alone() -> None:
    result = invoke("run", "p.toml", "--no-draw", "-q")
    assert (result.exit_code, result.output) == (0, "")
    assert netcdf.read("p.nc").t[-1] == 0.5
    assert invoke("-q", "check", "p.toml").output == ""
    result = invoke("run", "p.toml", "--no-draw", "--quiet", "--set", "time.duration=3")
    assert (result.exit_code, result.stdout) == (1, "")
    assert "limit reached at t = 1.25 s (map_margin[front]): wheel front leaves" in result.stderr
    assert invoke("check", "no.toml", "-q").stderr.startswith("no.toml: expected a problem file")
    assert invoke("check", "p.toml").stdout.startswith("ok ")  # it is not remembered


@pytest.mark.slow
def test_verbose_says_what_is_done_and_when() -> None:
    plain = invoke("run", "p.toml", "--no-draw")
    result = invoke("run", "p.toml", "--no-draw", "-v", code=0)
    lines = result.stderr.splitlines()
    times = [float(re.match(r"\[ *([\d.]+) s\] ", line)[1]) for line in lines]
    assert times == sorted(times)
    done = ("read p.toml", "settled the vehicle at the start", "solved: steps ", "wrote p.nc")
    assert all(words in result.stderr for words in done)
    assert "integrated to" not in result.stderr  # it took no second
    names = [{line.split("  ")[0] for line in each.stdout.splitlines()} for each in (plain, result)]
    assert names[0] < names[1]
    both = invoke("run", "p.toml", "-v", "-q", code=2)
    assert both.stderr == "expected --quiet or --verbose, found both; remove one of them\n"


def test_run_in_json() -> None:
    found = _json("run", "p.toml", "--no-draw", "--csv", "p.csv")
    assert found["files"] == ["p.nc", "p.csv"]
    assert found["facts"]["vehicle"].startswith("three_wheeler")
    assert "largest along" in found["facts"]["slip: wheel front"]
    result, motion = found["result"], netcdf.read("p.nc")
    assert result["stop"] is None
    assert result["wheels"] == ["right", "left", "front"]
    assert result["time"] == {"unit": "s", "first": 0.0, "last": 0.5}
    assert set(result["quantities"]) == set(motion)
    y, slip = (result["quantities"][name] for name in ("y", "slip_along"))
    assert (y["unit"], y["last"]) == ("m", motion["y"][-1])
    assert (slip["unit"], slip["last"]) == ("m s-1", motion["slip_along"][-1].tolist())
    assert slip["max"] == motion["slip_along"].max()
    assert result["statistics"]["steps"] > 10


def test_early_ends_and_bad_input_in_json() -> None:
    """The motion to the edge of the map is saved."""
    found = _json("run", "p.toml", "--no-draw", "--set", "time.duration=3", code=1)
    motion = netcdf.read("p.nc")
    assert found["result"]["stop"]["name"] == motion.stop.name == "map_margin[front]"
    assert found["result"]["stop"]["time"] == motion.stop.t == pytest.approx(1.25, abs=1e-5)
    assert motion.t[-1] == pytest.approx(1.25, abs=1e-5)
    words = "wheel front leaves the map, which extends from -3.00 to 3.00 m in x"
    assert motion.stop.words.startswith(words)
    assert (found["outcome"], found["exit_code"]) == ("limit", 1)
    title = "limit reached at t = 1.25 s (map_margin[front])"
    assert found["errors"] == [f"{title}; p.nc contains the result so far"]
    assert found["facts"]["outcome"] == f"{title}: {found['result']['stop']['words']}"
    found = _json("check", "p.toml", "--set", "time.step=0", "--set", "solver.tol=1", code=2)
    places = [each.split(":")[0] for each in found["errors"]]
    assert places == ["--set time.step", "--set solver.tol"]
    assert _json("info", "no.nc", code=2)["errors"][0].startswith("no.nc: expected a result file")


@pytest.mark.parametrize(
    ("words", "command", "told"),
    [
        (["run", "p.toml", "--bogus"], "run", "No such option: --bogus"),
        (["bogus"], "bogus", "No such command 'bogus'"),
        (["--frob", "check", "p.toml"], "check", "No such option: --frob"),
        ([], "", "Missing command"),
    ],
)
def test_words_that_are_no_command_in_json(words: list[str], command: str, told: str) -> None:
    result = invoke(*words, "--json", code=2)
    found = json.loads(result.stdout)
    assert (found["command"], found["exit_code"]) == (command, 2)
    assert found["meaning"] == console.MEANINGS[2]
    assert len(found["errors"]) == 1
    assert told in found["errors"][0]
    assert told in result.stderr
    assert invoke(*words).stdout == ""


def test_the_version_in_json() -> None:
    result = invoke("--version", "--json", code=0)
    assert json.loads(result.stdout)["version"] == slipfree.__version__


def test_an_unexpected_error_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("slipfree.problem.load.load_problem", lambda *_, **__: [][1])
    error = refused("check", "p.toml")
    assert re.fullmatch(
        rf"p.toml: {console.UNEXPECTED} {re.escape(slipfree.__version__)} \(IndexError: list index "
        r"out of range\); report it to the developers of slipfree, .*--verbose prints\n",
        error,
    )
    assert "Traceback (most recent call last)" in refused("check", "p.toml", "--verbose")
    found = json.loads(invoke("check", "p.toml", "--json", code=2).stdout)
    assert found["errors"] == [error.strip()]


def test_interruption_in_json(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("slipfree.problem.result.build", interrupted)
    assert _json("check", "p.toml", code=130)["errors"] == ["interrupted"]


@pytest.mark.slow
def test_check_vehicle_info_and_export_in_json() -> None:
    found = _json("check", "p.toml")
    assert found["start"]["z"]["unit"] == "m"
    assert found["start"]["z"]["last"] == pytest.approx(0.3)
    found = _json("vehicle", "p.toml")
    assert found["tree"][0].startswith("three_wheeler")
    assert found["facts"]["inputs"].startswith("3: right_rate")
    assert found["facts"]["rates: equations"]
    assert invoke("run", "p.toml", "--no-draw").exit_code == 0
    found = _json("info", "p.nc")
    assert found["attributes"]["title"] == "Überfahrt"
    assert found["result"]["quantities"]["heading"]["unit"] == "rad"
    assert _json("info", "p.nc", "--problem")["problem"] == PROBLEM
    assert _json("export", "p.nc", "--path", "way.csv")["files"] == ["way.csv"]
    assert _json("new", "plan", "c")["files"] == ["c.toml"]


def test_every_command_can_be_quiet_verbose_and_json() -> None:
    for name in [each.callback.__name__ for each in app.registered_commands]:
        words = invoke(name, "--help").stdout
        for option in ("--quiet", "--verbose", "--json"):
            assert option in words, (name, option)


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("slipfree r", {"run", "report"}),
        ("slipfree new pl", {"plan"}),
        ("slipfree examples plan_cr", {"plan_crater_field"}),
        ("slipfree run --ver", {"--verbose"}),
    ],
)
def test_completion(line: str, found: set[str]) -> None:
    count = str(len(line.split(" ")) - 1)
    words = {"_SLIPFREE_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": count}
    assert set(CliRunner().invoke(app, [], env=words, prog_name="slipfree").output.split()) == found


def _printed(stdout: Any, **more: str) -> bytes:
    """Return what ``slipfree check`` prints to a pipe or a terminal."""
    command = [sys.executable, "-m", "slipfree", "check", "p.toml"]
    names = ("NO_COLOR", "FORCE_COLOR", "TERM")
    environment = {name: value for name, value in os.environ.items() if name not in names}
    return subprocess.run(
        command, stdout=stdout, env=environment | {"TERM": "xterm-256color", **more}, check=True
    ).stdout


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX terminal")
def test_colours_are_for_terminals_that_want_them() -> None:
    assert b"\x1b" not in _printed(subprocess.PIPE)
    master, slave = os.openpty()
    _printed(slave, NO_COLOR="1")
    os.close(slave)
    seen = os.read(master, 100_000)
    os.close(master)
    assert b"ok" in seen
    assert not re.search(rb"\x1b\[(?:\d+;)*[349]\dm", seen)


def test_linear_algebra_keeps_to_one_thread_unless_told_otherwise(monkeypatch):
    """It is asked for before numpy is there."""
    code = "import sys, slipfree.__main__ as m; print('numpy' in sys.modules)"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "False"
    for name in forks.THREAD_COUNTS:
        monkeypatch.setenv(name, "2")
    monkeypatch.delenv("OMP_NUM_THREADS")
    forks.single_thread()
    assert os.environ["OPENBLAS_NUM_THREADS"] == "2"
    assert os.environ["OMP_NUM_THREADS"] == "1"


def _broken(name: str, monkeypatch: pytest.MonkeyPatch, raised: BaseException) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise raised

    monkeypatch.setattr(f"slipfree.{name}", fail)


@pytest.mark.usefixtures("folder")
def test_runs_print_the_main_facts_and_info_all_of_them():
    names = ["outcome", "path length", "end position", "slip", "largest angles", "friction"]
    main = invoke("run", "p.toml", "--no-figures", "-o", "a b.nc", code=0).stdout.splitlines()
    all_facts = invoke("run", "p.toml", "--no-draw", "-v", code=0).stdout.splitlines()
    assert [line.partition("  ")[0] for line in main[:-1]] == names
    assert main[-1] == "wrote a b.nc; all facts: slipfree info 'a b.nc'"
    shown = invoke("info", "p.nc", code=0).stdout
    assert all(line.partition("  ")[2].strip() in shown for line in all_facts[:-1])


def test_a_failing_integrator_saves_what_was_reached(folder, monkeypatch):
    invoke("run", "p.toml", "--no-draw")
    reached = netcdf.read("p.nc").part(
        slice(3), Stop("solver", 0.2, "gave up", Outcome.SOLVER_FAILURE)
    )
    error = SolverError("gave up", replace(reached, attributes={}))
    _broken("solve.simulate.simulate", monkeypatch, error)
    result = invoke("run", "p.toml", "--no-draw", "-o", "q.nc", code=1)
    assert re.match("outcome +solver failure at t = 0.2 s: gave up\n", result.stdout)
    assert result.stderr == "solver failure at t = 0.2 s; q.nc contains the result so far\n"
    found = netcdf.read(folder / "q.nc")
    assert found.t.size == 3
    assert found.attributes["title"] == "Überfahrt"


def test_a_failure_without_a_motion(folder, monkeypatch):
    _broken("solve.simulate.simulate", monkeypatch, SolverError("nothing at all"))
    result = invoke("run", "p.toml", "--no-draw")
    assert (result.exit_code, result.stderr) == (1, "nothing at all\n")
    assert not (folder / "p.nc").exists()


def test_check():
    result = invoke("check", "p.toml", code=0)
    assert result.stdout.startswith("ok ")
    assert "driver straight" in result.stdout
    assert "z 0.3" in result.stdout
    assert "clean: no other part of the ground near the wheels, relative" in result.stdout
    assert "a sample every" not in result.stdout  # there is but one
    assert re.search(r"^samples +6 to 0.5 s$", result.stdout, re.MULTILINE)


@pytest.mark.slow
def test_a_result_is_no_problem():
    invoke("run", "p.toml", "--no-draw")
    for command in ("run", "check", "compare"):
        told = refused(command, "p.nc")
        assert told.startswith("p.nc: expected a problem file, found a result; use slipfree info")


def test_info(folder):
    invoke("run", "p.toml", "--no-draw")
    result = invoke("info", "p.nc", code=0)
    for words in ("Überfahrt", f"slipfree version {slipfree.__version__}", "info -v p.nc"):
        assert words in " ".join(result.stdout.split())
    assert "slip_along " in printed("info", "-v", "p.nc")
    assert PROBLEM not in result.stdout
    assert invoke("info", "p.nc", "--problem").stdout == PROBLEM
    bare = netcdf.read("p.nc")
    kept = {k: v for k, v in bare.attributes.items() if k != "problem"}
    netcdf.write(folder / "bare.nc", replace(bare, attributes=kept))
    assert "bare.nc: expected a result with its problem file" in refused(
        "info", "bare.nc", "--problem"
    )


def test_places_are_checked_before_anything_is_computed(folder, monkeypatch):
    _broken("problem.result.build", monkeypatch, AssertionError("must not be reached"))
    assert "no/a.nc: expected a folder no" in refused("run", "p.toml", "-o", "no/a.nc")
    assert "expected a folder no" in refused("run", "p.toml", "--csv", "no/a.csv")
    assert "expected the name of a file" in refused("run", "p.toml", "-o", str(folder))
    assert "p.toml: expected a folder, found a file" in refused(
        "run", "p.toml", "--figures", "p.toml"
    )
    monkeypatch.setattr(os, "access", lambda path, _: Path(path).suffix == ".toml")
    assert "that may be written to" in refused("run", "p.toml")


def test_help_needs_no_heavy_imports():
    code = (
        "import sys, slipfree\n"
        "heavy = {'numpy', 'pydantic', 'annotated_types', 'typer', 'rich', 'matplotlib', 'scipy'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
        "from slipfree.cli import main\nsys.argv = ['slipfree', '--help']\n"
        "try:\n    main()\n"
        "except SystemExit as end:\n    assert end.code in (0, None)\n"
        "heavy -= {'typer', 'rich'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


OPTIONAL = {"trimesh", "xacro", "laspy", "lazrs", "mcap", "mcap_ros2", "rosbags", "yourdfpy"}
OPTIONAL |= {"pyproj", "rasterio", "viser", "distributed", "xarray", "pandas"}
# their import takes as long as all others
OPTIONAL |= {"matplotlib", "scipy.interpolate", "scipy.optimize", "scipy.signal", "scipy.stats"}
OPTIONAL |= {f"slipfree.problem.verbs.{verb}" for verb in ("atlas", "compare", "fit")}


@pytest.mark.slow
def test_optional_libraries_are_imported_only_when_used(folder):
    """A motion or a plan without reference system and figures needs none of them."""
    plan = f"run {DATA / 'plan_of_a_short_way.toml'} --no-draw -o plan.nc --set driver="
    lines = "--version", "run p.toml --no-draw --set time.duration=0.2", "info p.nc", plan
    code = (
        "import sys, slipfree\n"
        "from slipfree.cli import main\n"
        f"for line in {lines}:\n"
        "    sys.argv = ['slipfree', *line.split()]\n"
        "    try:\n        main()\n"
        "    except SystemExit as end:\n        assert end.code in (0, None)\n"
        f"    assert not {OPTIONAL} & set(sys.modules), (line, {OPTIONAL} & set(sys.modules))\n"
    )
    found = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=False
    )
    assert found.returncode == 0, found.stderr


@pytest.mark.slow
def test_formulations_agree_at_the_shell():
    run = ("run", "p.toml", "--no-draw", *sets("time.duration=0.5"))
    told = invoke(*run, "--cross-check", code=0).stdout
    assert "largest differences from formulation = 'montana'" in told
    montana = invoke(*run, "-v", *sets("formulation=montana"), code=0)
    assert "drift of the assembly" in montana.stdout


@pytest.mark.slow
def test_path_from_a_file(folder):
    law = ["--set", 'driver={name="follow", speed=0.2, file="way.csv"}']
    (folder / "way.csv").write_text("x,y\n0.0,0.0\n0.0,1.0\n")
    told = invoke("run", "p.toml", "--no-draw", *law, *sets("time.duration=6.0"), code=0).stdout
    assert "end of the path at t = 5 s, passed by 0.2 m" in told
    (folder / "way.csv").write_text("x,y\n0.0,0.0\n0.0,99.0\n")
    told = invoke("check", "p.toml", *law, code=2).stderr
    assert "expected way-points on the map, which extends from x = -3, y = -3 to x = 3, " in told
    (folder / "way.csv").write_text("x,y\n0.0,0.0\n0.0;1.0\n")
    result = invoke("check", "p.toml", *law, code=2)
    assert "way.csv:3: expected two numbers x,y, found '0.0;1.0'" in result.stderr


# Control characters in what is printed

NASTY = "\x1b]0;owned\x07\x9b31m\rback\b\x7f\u202eabc\u2066\u200f\x85\u2028"
SHOWN = (
    r"\x1b]0;owned\x07\x9b31m\rback\x08\x7f\u202eabc\u2066\u200f\x85\u2028"  # what NASTY becomes
)
RAW = re.compile(
    "[\\0-\\x08\\x0b-\\x1f\\x7f-\\x9f\\u061c\\u200e\\u200f\\u2028-\\u202e\\u2066-\\u2069]"
)


def _problem(name: str = "p.toml", **more: Any) -> str:
    problem: dict[str, Any] = deepcopy(bases("direct")[0]) | more
    text = document(problem).replace("\x7f", r"\u007f")  # which TOML demands
    Path(name).write_text(text, encoding="utf-8")
    return name


def _output(*words: str, code: int) -> str:
    """Return what a command prints, which must be free of control characters."""
    found = printed(*words, code=code)
    assert not RAW.search(found), found
    return found


def test_what_is_escaped_and_what_stays() -> None:
    assert console.visible(NASTY) == SHOWN
    assert not RAW.search(console.visible("".join(map(chr, range(0x3000)))).replace("\r\n", ""))
    for text in (
        "Überfahrt\n\tüber 3°, 10 µm\r\n",
        "\u4e2d\u6587 \U0001f600",
        "\u06cc\u200c\u062e \u0915\u094d\u200d",
    ):
        assert console.visible(text) == text
    assert console.visible("\ud800 n\udcff") == r"\ud800 n\udcff"


def test_keys_values_and_names_of_problems() -> None:
    assert SHOWN in _output("check", _problem(**{NASTY: 1}), code=2)
    assert SHOWN in _output("check", _problem(verb=NASTY), code=2).replace("\\\\", "\\")
    shown = _output("check", _problem(terrain={"file": f"{NASTY.replace('/', '')}.asc"}), code=2)
    assert SHOWN in shown
    assert SHOWN in _output("check", f"{NASTY}.toml", code=2)
    assert SHOWN in _output("check", _problem(), "--set", f"{NASTY}=1", code=2)


@pytest.mark.parametrize("words", [(f"--{NASTY}",), (NASTY,), ("new", NASTY, "x")])
def test_words_on_the_command_line(words: tuple[str, ...]) -> None:
    assert "owned" in _output(*words, code=2)


def test_titles_and_attributes_of_results() -> None:
    name = _problem(title=NASTY)
    assert "wrote" in _output("run", name, "-o", f"{NASTY}.nc", "--no-draw", code=0)
    assert SHOWN in _output("info", f"{NASTY}.nc", code=0)
    run = netcdf.read(f"{NASTY}.nc")
    run.attributes["name\x1b[31m"] = NASTY
    netcdf.write("o.nc", run)
    shown = _output("info", "o.nc", code=0)
    assert re.search(r"^name\\x1b\[31m +" + re.escape(SHOWN), shown, re.MULTILINE)
    found = _output("info", "o.nc", "--json", code=0)
    assert json.loads(found)["attributes"]["title"] == NASTY


def test_names_of_vehicles() -> None:
    name = NASTY.replace("\x1b", "").replace("\x07", "").replace("\b", "")  # XML has no others
    text = f'<robot name="{name}"><link name="{name}"/></robot>'.replace("\r", "&#13;")
    Path("v.urdf").write_text(text, encoding="utf-8")
    assert r"\u202eabc" in _output("vehicle", "v.urdf", code=2)


def test_warnings_and_details() -> None:
    words = CliRunner()
    with (
        words.isolation() as (_, stderr, _both),
        console._collecting("x", console.OutputOptions(verbose=True)),
    ):
        console.warn(NASTY)
        console.detail(NASTY)
        console.print_error(NASTY)
        shown = stderr.getvalue().decode()
    assert shown.count(SHOWN) == 3
    assert not RAW.search(shown)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX terminal")
def test_a_terminal() -> None:
    name = _problem(title=NASTY)
    invoke("run", name, "-o", "o.nc", "--no-draw", code=0)
    run = netcdf.read("o.nc")
    run.attributes["problem"] += f"# {NASTY}\r\n"
    netcdf.write("o.nc", run)
    command = [sys.executable, "-m", "slipfree", "info", "o.nc", "--problem"]
    environment = {**os.environ, "NO_COLOR": "1", "COLUMNS": "1000", "TERM": "xterm"}
    master, slave = os.openpty()
    with subprocess.Popen(command, stdout=slave, stderr=slave, env=environment) as process:
        os.close(slave)
        seen = b""
        while True:
            try:
                seen += os.read(master, 100_000)
            except OSError:  # all is read and the process has ended
                break
        assert process.wait() == 0
    os.close(master)
    shown = re.sub(r"\x1b\[[0-9;]*m|\r+(?=\n)", "", seen.decode())  # bold, ends of lines
    assert SHOWN in shown
    assert not RAW.search(shown)
    piped = subprocess.run(command, capture_output=True, check=True, env=environment).stdout
    assert "\u202e" in piped.decode()  # a file is copied as it is
