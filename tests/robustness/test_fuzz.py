"""Tests of damaged, giant or malicious files: each is read, or refused with a clear error."""

import ast
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import slipfree as sf
from helpers.cases import ROOT
from helpers.commands import refused, refuses
from helpers.fuzz_checks import READ, REFUSED, judged, judged_silently
from helpers.fuzz_damage import Case
from helpers.fuzz_files import KINDS, SILENT_KINDS, bases, document, drawn, results
from slipfree.files import netcdf
from slipfree.files.toml import ProblemError
from slipfree.files.vehicle_toml import open_file
from slipfree.problem.result import problem_of

pytestmark = pytest.mark.slow

SOURCE = ROOT / "src" / "slipfree"
CAREFUL = settings(
    derandomize=True,
    database=None,
    deadline=None,
    max_examples=8,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
NUMBERS = st.one_of(st.floats(), st.integers(), st.sampled_from([10**400, -(10**400), 1e300]))
VALUES: st.SearchStrategy[Any] = st.recursive(
    st.one_of(
        NUMBERS, st.booleans(), st.text(st.characters(exclude_categories=["Cs"]), max_size=30)
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.text("axy.é", max_size=4), inner, max_size=3),
    ),
    max_leaves=8,
)


def _sound(case: Case, folder: Path) -> None:
    found = judged(case, Path(tempfile.mkdtemp(dir=folder)))
    assert found.name in (READ, REFUSED), found


@pytest.mark.parametrize("kind", KINDS)
@CAREFUL
@given(seed=st.integers(0, 2**32))
def test_every_drawn_file_is_read_or_refused(kind: str, seed: int, tmp_path: Path) -> None:
    _sound(drawn(kind, Random(seed)), tmp_path)


@pytest.mark.parametrize("kind", SILENT_KINDS)
def test_urdfs_and_rasters_are_read_or_refused_in_silence(kind: str, tmp_path: Path) -> None:
    """``python benchmarks fuzz --kinds urdf,raster`` reads many, each with a limit of time."""
    found = []
    for seed in range(30):
        folder = tmp_path / str(seed)
        folder.mkdir()
        case = drawn(kind, Random(seed))
        found.append(judged_silently(case, folder, tmp_path / f"{seed}.txt"))
    assert {each.name for each in found} == {READ, REFUSED}, found


@CAREFUL
@given(seed=st.integers(0, 2**32))
def test_no_file_beside_a_raster_changes_it(seed: int, tmp_path: Path) -> None:
    case = drawn("sidecar", Random(seed))
    whole, alone = tempfile.mkdtemp(dir=tmp_path), tempfile.mkdtemp(dir=tmp_path)
    case.write(Path(whole))
    (Path(alone) / case.main).write_bytes(case.files[case.main])
    found = []
    for folder in (whole, alone):
        try:
            grid, *facts = sf.read_map(Path(folder) / case.main, fill="linear")
            found.append((grid.x.tolist(), grid.y.tolist(), grid.z.tolist(), facts))
        except sf.DataError as error:
            found.append(str(error).replace(folder, ""))
    assert found[0] == found[1]


@pytest.mark.parametrize("kind", ["direct", "inverse", "plan"])
@CAREFUL
@given(value=VALUES, place=st.integers(0, 99), data=st.data())
def test_any_value_anywhere_is_read_or_refused(
    kind: str, value: Any, place: int, data: Any, tmp_path: Path
) -> None:
    problem = dict(bases(kind)[0])
    name = [*problem][place % len(problem)]
    table = problem[name]
    if isinstance(table, dict):
        key = data.draw(st.sampled_from([*table, "x"]))
        problem[name] = {**table, key: value}
    else:
        problem[name] = value
    _sound(Case(kind, {"p.toml": document(problem).encode("utf-8", "replace")}, "p.toml"), tmp_path)


@CAREFUL
@given(
    raw=st.binary(max_size=300),
    ending=st.sampled_from(
        ["p.toml", "v.urdf", "g.asc", "g.npz", "g.csv", "g.tif", "g.png", "g.img", "r.nc"]
    ),
)
def test_any_bytes_are_refused(raw: bytes, ending: str, tmp_path: Path) -> None:
    kinds = {"p.toml": "direct", "v.urdf": "urdf", "r.nc": "result"}
    found = judged(Case(kinds.get(ending, "asc"), {ending: raw}, ending), tmp_path)
    assert found.name == REFUSED, found


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a = " + "[" * 100_000, "of more than 100 nested levels"),
        ("a" + ".a" * 100_000 + " = 1", "a key of more than 60 dotted parts"),
        ("a = 1" + "0" * 10_000, "an integer of more than 4300 digits"),
        ("x" * 10_000_001, "at most 10 MB, found 10 MB"),
    ],
)
def test_toml_beyond_reason_is_refused_at_once(text: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "p.toml"
    file.write_text(text)
    for reader in (sf.load_problem, open_file):
        begin = time.process_time()
        with pytest.raises(ProblemError, match=words) as caught:
            reader(file)
        assert time.process_time() - begin < 2
        assert str(file) in str(caught.value)


@pytest.mark.parametrize("option", ["--set", "--vary"])
@pytest.mark.parametrize("value", ["title=" + "[" * 10_000, "title=" + "{a=" * 10_000, "a." * 5000])
def test_values_of_the_command_line_beyond_reason_are_refused(
    option: str, value: str, tmp_path: Path
) -> None:
    file = tmp_path / "p.toml"
    file.write_text(document(bases("direct")[0]))
    command = ["check"] if option == "--set" else ["sweep", "-o", str(tmp_path / "out")]
    errors = refused(*command, file, option, value)
    assert f"{option} {value[:5]}" in errors
    assert len(errors) < 1000


def test_a_long_text_of_dots_is_no_long_key(tmp_path: Path) -> None:
    file = tmp_path / "p.toml"
    file.write_text(f"# {'.' * 500}\n# {'and. ' * 500}\ntitle = '{'a. ' * 500}'\n")
    assert len(open_file(file).data["title"]) == 1500


def test_integers_beyond_all_floats_are_no_numbers(tmp_path: Path) -> None:
    file = tmp_path / "p.toml"
    file.write_text(document({**bases("plan")[0], "goal": {"x": 10**400, "y": [0, 10**400]}}))
    refuses(ProblemError, r"goal.x: expected a number.*\n.*goal.y: expected", sf.load_problem, file)


@pytest.mark.parametrize("name", ["..", "a\0b", "/etc/passwd"])
def test_the_name_of_a_problem_in_a_result_is_no_path(name: str, tmp_path: Path) -> None:
    file = tmp_path / "r.nc"
    file.write_bytes(results()[1])
    motion = netcdf.read(file)
    motion = replace(motion, attributes={**motion.attributes, "problem_file": name})
    assert problem_of(file, motion, netcdf.read_arrays(file)).spec.verb == "direct"
    assert [each.name for each in tmp_path.iterdir()] == ["r.nc"]


def test_devices_are_not_replaced(tmp_path: Path) -> None:
    file = tmp_path / "p.toml"
    file.write_text(document(bases("direct")[0]))
    errors = refused("run", file, "-o", "/dev/null", "--no-draw")
    assert "/dev/null: expected the name of a file" in errors
    assert Path("/dev/null").is_char_device()


def test_nothing_of_a_user_is_run_as_code() -> None:
    """No pickle, eval or exec is applied to what a file holds; arrays are read without pickles.

    Rollouts pickle a model for their own processes, and bounded calls their arguments and result;
    they unpickle nothing else.
    """
    bad = []
    for file in SOURCE.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names: list[str] = []
            if isinstance(node, ast.Import):
                names = [each.name for each in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            elif isinstance(node, ast.Call):
                names = [ast.unparse(node.func)]
                bad += [
                    f"{file.name}:{node.lineno} {each.arg}"
                    for each in node.keywords
                    if each.arg == "allow_pickle" and ast.unparse(each.value) != "False"
                ]
            bad += [
                f"{file.name}:{node.lineno} {name}"
                for name in names
                if name in FORBIDDEN
                and (file.name, name) not in [(each, "pickle") for each in OWN_PROCESSES]
            ]
    assert bad == []


OWN_PROCESSES = ("rollouts.py", "processes.py")  # modules that send objects to processes
FORBIDDEN = (
    "pickle", "dill", "cloudpickle", "marshal", "shelve", "joblib", "yaml", "eval", "exec",
    "compile", "__import__", "os.system", "os.popen",
)  # fmt: skip


def test_arrays_of_python_objects_are_refused(tmp_path: Path) -> None:
    """A numpy archive with a pickle in it is not unpickled."""
    import numpy as np

    class Trap:
        def __reduce__(self) -> Any:
            return pytest.fail, ("the pickle was loaded",)

    np.savez(tmp_path / "g.npz", x=np.array([Trap()], object), y=np.arange(4.0), z=np.eye(4))
    refuses(sf.DataError, "allow_pickle=False", sf.read_map, tmp_path / "g.npz")
