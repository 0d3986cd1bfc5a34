"""Tests that the documentation covers pages, modules, notebooks, keys, and of its recipes."""

import ast
import inspect
import json
import re
from collections.abc import Iterator
from functools import reduce
from importlib import import_module
from pathlib import Path
from runpy import run_path
from typing import Any, get_args, get_origin

import pytest
import typer

import slipfree
from helpers.cases import ROOT
from helpers.commands import invoke
from slipfree.cli import app
from slipfree.files.toml import Record
from slipfree.problem.load import VERBS
from slipfree.problem.schema import law_tables

DOCS = ROOT / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "_build" not in path.parts)
NOTEBOOKS = sorted(path.stem for path in (ROOT / "notebooks").glob("*.py"))
SOURCES = Path(slipfree.__file__).parent


def listed(page):
    """Return the pages that the tables of contents of a page lead to."""
    trees = re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(), re.DOTALL)
    names = [line for tree in trees for line in tree.split("\n") if line and line[0] != ":"]
    return [(page.parent / name).resolve().relative_to(DOCS.resolve()).as_posix() for name in names]


def text_of(name):
    return (DOCS / name).read_text()


def test_every_page_is_in_one_table_of_contents():
    found = [name for page in PAGES for name in listed(page)]
    pages = [page.relative_to(DOCS).with_suffix("").as_posix() for page in PAGES]
    assert sorted(found) == sorted(
        [name for name in pages if name != "index"] + [f"notebooks/{name}" for name in NOTEBOOKS]
    )


def test_the_generated_parts_of_all_pages_are_made():
    """Every key of a problem file has words for its type, every listed name exists."""
    fill = run_path(str(DOCS / "made.py"))["fill"]
    for page in PAGES:
        text = page.read_text()
        assert (fill(text) != text) == bool(re.search(r"<!-- \w+: ", text)), page


def test_every_package_is_in_the_reference():
    text = "".join(page.read_text() for page in PAGES if "reference" in page.parts)
    shown = re.findall(r"<!-- modules: ([\w.]+) -->", text)
    packages = {path.relative_to(SOURCES).parts[:-1] for path in SOURCES.rglob("*.py")}
    names = {".".join(("slipfree", *parts[:1])) for parts in packages}  # with what is inside
    assert sorted(shown) == sorted(names - {"slipfree", "slipfree.cli"})
    assert "<!-- commands: slipfree -->" in text


def described():
    """Return the objects that the pages of the reference list, by name."""
    pages = "".join(page.read_text() for page in (DOCS / "reference").glob("*.md"))
    listed = re.findall(r"<!-- names: ([\w.,\s]+?) -->", pages)
    names = re.split(r"[,\s]+", ",".join(listed))
    parts = {name: f"slipfree.{name}".rpartition(".") for name in names}
    assert len(parts) == len(names)
    return {key: getattr(import_module(home), name) for key, (home, _, name) in parts.items()}


def test_every_public_name_is_described_once():
    names = described()
    offered = {*slipfree.__all__, *(f"catalog.{name}" for name in slipfree.catalog.__all__)}
    assert offered - set(names) == {"__version__", "catalog"}
    assert len({*map(id, names.values())}) == len(names)


def test_the_gallery_shows_every_picture_that_its_command_draws():
    drawn = set(re.findall(r'Picture\("(\w+)"', text_of("gallery.py")))
    files = [*(DOCS / "figures" / "gallery").iterdir()]
    assert drawn == {file.stem for file in files}
    shown = re.findall(r"figures/gallery/(\S+)", text_of("gallery.md"))
    assert sorted(shown) == sorted(file.name for file in files)
    assert sum(file.stat().st_size for file in files) < 1e6


def test_no_public_signature_has_a_value_of_any_type():
    untyped = [
        f"{owner.__name__}: {name}: {annotation}"
        for each in described().values()
        for owner in (each, *signatures(each))
        for name, annotation in inspect.get_annotations(owner).items()
        if re.search(r"\bAny\b", str(annotation))
    ]
    assert untyped == []


def signatures(thing):
    """Yield the functions behind a public function, or behind the public members of a class."""
    if not isinstance(thing, type):
        yield inspect.unwrap(thing)
        return
    for name, member in vars(thing).items():
        parts = (getattr(member, key, None) for key in ("fget", "func", "__func__"))
        found = next((part for part in parts if part is not None), member)
        if inspect.isfunction(found) and (name == "__init__" or name[0] != "_"):
            yield found


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_is_listed_and_its_imports_and_arguments_exist(name):
    """Notebooks run when the pages are built; names and keywords change before."""
    assert f"({name}.py)" in text_of("notebooks/index.md")
    code = (ROOT / "notebooks" / f"{name}.py").read_text()
    bind_calls(code)
    assert re.search(r"^# # \S", code, re.MULTILINE), "a title"


def bind_calls(code):
    """Bind the arguments of calls of imported functions of slipfree to their signatures."""
    names: dict[str, Any] = {}
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            exec(ast.unparse(node), names)
        if isinstance(node, ast.Call):
            first, *rest = ast.unparse(node.func).split(".")
            function = reduce(lambda home, part: getattr(home, part, None), rest, names.get(first))
            if str(getattr(function, "__module__", "")).startswith("slipfree"):
                keywords = {each.arg: each for each in node.keywords if each.arg}
                inspect.signature(function).bind_partial(*node.args, **keywords)


@pytest.mark.parametrize("call", ["plan(model, goall={})", "catalog.rocky7(half_track=1)"])
def test_a_lost_keyword_argument_is_seen(call):
    with pytest.raises(TypeError, match="unexpected keyword argument"):
        bind_calls(f"from slipfree import catalog, plan\n{call}")


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_shows_its_script_executed(name):
    script, notebook = (ROOT / "notebooks" / f"{name}.{end}" for end in ("py", "ipynb"))
    cells = json.loads(notebook.read_text())["cells"]
    parts = re.split(r"(?m)^# %%.*\n", script.read_text())[1:]

    def bare(text):  # markdown and magic commands are comments in the script
        return [line.strip().lstrip("# ") for line in text.strip().splitlines()]

    assert [bare("".join(cell["source"])) for cell in cells] == [bare(part) for part in parts]
    outputs = [out for cell in cells for out in cell.get("outputs", ())]
    assert any("image/png" in out.get("data", ()) for out in outputs)
    assert not any(out["output_type"] == "error" for out in outputs)
    assert f"({name}.ipynb)" in (ROOT / "notebooks" / "README.md").read_text()


@pytest.mark.parametrize("page", ["conventions.md", "papers.md"])
def test_tests_that_a_page_names_exist(page):
    names = re.findall(r"`(test_\w+\.py)(?:::(\w+))?`", text_of(page))
    assert names
    for file, test in names:
        (path,) = (ROOT / "tests").rglob(file)
        code = path.read_text()
        assert f"def {test}" in code, (file, test)


def test_every_shipped_problem_is_described_once():
    named = re.findall(r"`(\w+\.toml)`", re.sub(r"(?m)^[^|].*$", "", text_of("problems.md")))
    assert sorted(named) == sorted(path.name for path in (ROOT / "problems").glob("*.toml"))


def test_stops_that_are_explained_exist():
    code = "".join(path.read_text() for path in SOURCES.rglob("*.py"))
    rows = re.findall(r"^\| (`.*?) \|", text_of("howto/stops.md"), re.MULTILINE)
    names = re.findall(r"`(\w+)(?:\[WHEEL\])?`", " ".join(rows))
    assert len(names) > 15
    composed = {"NAME_stop", "tilt_right_stop", "rear_upright", "front_upright"}
    for name in set(names) - composed:
        assert f'"{name}"' in code, name


def test_links_lead_somewhere():
    for page in (*PAGES, ROOT / "README.md"):
        for target in re.findall(r"\]\(([\w./-]+)(?:#[\w-]*)?\)", page.read_text()):
            here = (page.parent / target).resolve()
            source = ROOT / "notebooks" / here.name
            is_script = here.parent.name == "notebooks" and source.exists()
            assert here.exists() or is_script, (page.name, target)


# The cookbook: ten short recipes, and a script that needs no other imports than the page says

PAGE = (ROOT / "docs" / "howto" / "cookbook.md").read_text(encoding="utf-8")
CELL = r"```\{code-cell\} ipython3\n(.*?)```"
SCRIPT = re.findall(CELL, PAGE, re.DOTALL)[-1]


def test_ten_recipes_are_short():
    recipes = re.split(r"^## ", PAGE, flags=re.MULTILINE)[1:-1]
    assert [each.partition(".")[0] for each in recipes] == [str(k) for k in range(1, 11)]
    for each in recipes:
        (code,) = re.findall(CELL, each, re.DOTALL)
        assert len([line for line in code.splitlines() if line.strip()]) <= 15


@pytest.mark.slow
def test_the_script_of_the_page_runs(capsys):
    assert len([line for line in SCRIPT.splitlines() if line.strip()]) < 25
    imports = [n for n in ast.walk(ast.parse(SCRIPT)) if isinstance(n, ast.Import | ast.ImportFrom)]
    names = {alias.name for each in imports for alias in each.names}
    assert names == {"casadi", "numpy", "slipfree"}
    names: dict = {}
    exec(SCRIPT, names)
    run, found = names["run"], names["found"]
    assert run.stop is None
    assert run["x"][-1] == pytest.approx(106.0, abs=0.02)
    assert found.accurate
    rolls = [abs(each["roll"]).max() for each in (run, found.replay)]
    assert rolls[1] < 0.7 * rolls[0]
    assert capsys.readouterr().out.count("\n") == 2


# README: length, output of its examples, and existence of all names

README = (ROOT / "README.md").read_text()


def test_it_is_short():
    assert len(README.splitlines()) < 150


@pytest.mark.slow
@pytest.mark.usefixtures("folder")
def test_the_problem_file_runs():
    (text,) = re.findall(r"```toml\n(.*?)```", README, re.DOTALL)
    Path("drive.toml").write_text(text)
    invoke("run", "drive.toml", "--no-draw", code=0)
    assert Path("drive.nc").is_file()


def test_commands_it_names_exist():
    named = set(re.findall(r"`slipfree (\w+)", README)) | {"report", "show", "export"}
    assert named == set(typer.main.get_command(app).commands)


# The descriptions of keys in the schemas of problem files

SCHEMAS = [verb.schema for verb in VERBS]
UNIT = re.compile(r" \[(?:1|(?:[mNs]|Pa|kg|rad|deg|Hz)[\w/ ^()+]*|1/s)(?:, (?:1|[\w/ ]+))*\]$")


def records(found: Any, seen: set[type[Record]]) -> Iterator[type[Record]]:
    """Yield the tables in an annotation, and those in them."""
    if isinstance(found, type) and issubclass(found, Record):
        if found in seen:
            return
        seen.add(found)
        yield found
        for field in found.model_fields.values():
            yield from records(field.annotation, seen)
    for each in get_args(found):
        yield from records(each, seen)


def is_numeric(annotation: Any) -> bool:
    """Return whether real numbers may stand for a key, in arrays or by name as well."""
    if annotation in (float, Any) or get_origin(annotation) is dict:
        return True
    return any(map(is_numeric, get_args(annotation)))


TABLES = list(records(tuple[*SCHEMAS, law_tables()], set()))  # type: ignore[misc]


@pytest.mark.parametrize("table", TABLES, ids=lambda table: table.__name__)
def test_every_key_says_what_it_means_and_in_which_unit(table: type[Record]) -> None:
    for key, field in table.model_fields.items():
        assert field.description, key
        has_unit = UNIT.search(field.description) is not None
        assert has_unit == is_numeric(field.annotation), (key, field.description)


def test_all_tables_are_looked_at() -> None:
    names = {table.__name__ for table in TABLES}
    some = "TerrainTable PowerLaw DriverTable GuideTable KeepOut StepClimbing"
    assert names >= {*some.split()}
    assert len(names) > 35
