"""Measure the size of the sources, and list the cycles of their imports.

``python benchmarks/structure.py [FOLDER] [--against OTHER]`` counts modules, lines, AST nodes,
``# fmt: skip`` comments and import cycles below a source folder, ``src`` by default. An import
cycle is a group of two or more modules each of which imports all others of the group, directly or
through others. Cycles are counted of the imports at module level alone, and together with those in
functions and under ``TYPE_CHECKING``; the import of a module's own packages is not counted. The
cycles of all imports are listed, and the ten largest functions, methods included, by AST nodes.
With ``--against`` the numbers of another source folder are printed beside these.

Of the packages ``problem``, ``cli``, ``sweep`` and ``show`` it also counts and lists

dispatches
    Tests of the kind of a problem or result: ``isinstance`` on schemas of verbs, their set-ups or
    shown motions, comparisons of ``.verb``, calls of predicates of a kind.
guesses
    Tests whether a name is in the columns, statistics, attributes or arrays of a result, as if to
    infer its kind. Names in `OPTIONAL` do not depend on the kind; tests in the modules of verbs are
    counted apart: there a verb reads optional quantities of its own results.

and of all modules the docstrings with the word "what" in the first line, and the lines of README.md
beside the folder.
"""

from __future__ import annotations

import argparse
import ast
import platform
import re
import sys
from collections.abc import Iterator
from importlib.util import resolve_name
from itertools import zip_longest
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components

LISTED = 10  # functions
SKIP = "# fmt: skip"
MODULE_LEVEL, IN_FUNCTIONS, TYPING = "at module level", "in functions", "under TYPE_CHECKING"
COUNTED = {
    MODULE_LEVEL: {MODULE_LEVEL},
    f"and {IN_FUNCTIONS}": {MODULE_LEVEL, IN_FUNCTIONS},
    f"and {TYPING}": {MODULE_LEVEL, TYPING},
    "all": {MODULE_LEVEL, IN_FUNCTIONS, TYPING},
}
PACKAGES = {"problem", "cli", "sweep", "show"}  # below the verbs nothing knows their kinds
VERBS = "slipfree.problem.verbs."
KINDS = {  # schemas of verbs, their set-ups, shown motions
    *("Direct", "Inverse", "Plan", "Climb", "Compare", "Motion", "Modelled"),
    *("Setup", "Planning", "Climbing", "Driven"),
}
PREDICATES = {"climbs", "is_climb"}
RECORDS = {"columns", "statistics", "attributes", "counts", "arrays"}  # of results
OPTIONAL = {  # of grounds with friction, files, integrated motions, climbs that reach an obstacle
    *("ground_friction", "problem", "steps", "tolerance", "climb_from"),
}
WHAT = re.compile(r"\bwhat\b", re.IGNORECASE)
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


class Module(NamedTuple):
    """A source file: its text, its syntax tree, and whether it is the top of a package."""

    text: str
    tree: ast.Module
    is_package: bool


class Import(NamedTuple):
    """An import of one module by another, and where the statement stands."""

    importer: str
    imported: str
    place: str


def read_modules(folder: Path) -> dict[str, Module]:
    """Return the modules below a folder by dotted name."""
    modules = {}
    for path in sorted(folder.rglob("*.py")):
        parts, is_package = path.relative_to(folder).with_suffix("").parts, path.stem == "__init__"
        text = path.read_text(encoding="utf-8")
        name = ".".join(parts[:-1] if is_package else parts)
        modules[name] = Module(text, ast.parse(text), is_package)
    return modules


def find_imports(modules: dict[str, Module]) -> set[Import]:
    """Return the imports among modules."""
    found = set()
    for importer, module in modules.items():
        package = importer if module.is_package else importer.rpartition(".")[0]
        for node, place in walk_imports(module.tree, MODULE_LEVEL):
            for name in imported_names(node, package):
                imported = name if name in modules else name.rpartition(".")[0]
                if imported in modules and imported != importer:
                    found.add(Import(importer, imported, place))
    return found


def walk_imports(node: ast.AST, place: str) -> Iterator[tuple[ast.Import | ast.ImportFrom, str]]:
    """Yield the import statements of a syntax tree, and the place of each."""
    if isinstance(node, (ast.Import, ast.ImportFrom)):
        yield node, place
    elif isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
        for child in node.body:
            yield from walk_imports(child, TYPING)
        for child in node.orelse:
            yield from walk_imports(child, place)
    else:
        place = IN_FUNCTIONS if isinstance(node, FUNCTIONS) else place
        for child in ast.iter_child_nodes(node):
            yield from walk_imports(child, place)


def imported_names(node: ast.Import | ast.ImportFrom, package: str) -> list[str]:
    """Return the dotted names that a statement imports: of modules, or of what is in them."""
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    base = resolve_name("." * node.level + (node.module or ""), package)
    return [f"{base}.{alias.name}" for alias in node.names]


def find_cycles(imports: set[Import], places: set[str]) -> list[list[str]]:
    """Return the groups of modules that import each other by statements at some places."""
    edges = [(a, b) for a, b, place in imports if place in places]
    names = sorted({name for edge in edges for name in edge})
    matrix = np.zeros((len(names), len(names)))
    for a, b in edges:
        matrix[names.index(a), names.index(b)] = 1
    _, group = connected_components(matrix, connection="strong")
    groups = [[names[k] for k in np.flatnonzero(group == g)] for g in np.unique(group)]
    return [each for each in groups if len(each) > 1]


def list_functions(modules: dict[str, Module]) -> list[tuple[int, int, str]]:
    """Return AST nodes, lines and name of every function, the largest first."""
    found = []

    def visit(node: ast.AST, name: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, FUNCTIONS):
                lines = (child.end_lineno or child.lineno) - child.lineno + 1
                found.append((count_nodes(child), lines, f"{name}.{child.name}"))
            elif isinstance(child, ast.ClassDef):
                visit(child, f"{name}.{child.name}")

    for name, module in modules.items():
        visit(module.tree, name)
    return sorted(found, reverse=True)


def count_nodes(tree: ast.AST) -> int:
    """Return the number of nodes of a syntax tree."""
    return sum(1 for _ in ast.walk(tree))


def find_kind_tests(modules: dict[str, Module]) -> dict[str, list[str]]:
    """Return places of dispatches on kinds, and of guesses outside and inside of verbs' modules."""
    found: dict[str, list[str]] = {"dispatches": [], "guesses": [], "guesses in verbs": []}
    for name, module in modules.items():
        if name.split(".")[1:2] and name.split(".")[1] in PACKAGES:
            for node in ast.walk(module.tree):
                place = f"{name}:{getattr(node, 'lineno', 0)}: "
                if is_dispatch(node):
                    found["dispatches"].append(place + ast.unparse(node))
                if is_guess(node):
                    kind = "guesses in verbs" if name.startswith(VERBS) else "guesses"
                    found[kind].append(place + ast.unparse(node))
    return found


def is_dispatch(node: ast.AST) -> bool:
    """Return whether an expression tests the kind of a problem or result."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        is_kind = node.func.id == "isinstance" and bool(KINDS & names_in(node.args[1]))
        return is_kind or node.func.id in PREDICATES
    if isinstance(node, ast.Compare):
        operands = [node.left, *node.comparators]
        return any(isinstance(each, ast.Attribute) and each.attr == "verb" for each in operands)
    return False


def is_guess(node: ast.AST) -> bool:
    """Return whether an expression tests for a name in a result that not all kinds have."""
    if not (isinstance(node, ast.Compare) and isinstance(node.ops[0], ast.In | ast.NotIn)):
        return False
    is_optional = isinstance(node.left, ast.Constant) and node.left.value in OPTIONAL
    record = node.comparators[0]
    name = getattr(record, "attr", getattr(record, "id", ""))
    return name in RECORDS and not is_optional


def names_in(node: ast.AST) -> set[str]:
    """Return the names and attributes in an expression."""
    return {getattr(each, "attr", getattr(each, "id", "")) for each in ast.walk(node)}


def count_what_clauses(modules: dict[str, Module]) -> int:
    """Return the number of docstrings with "what" in their first line."""
    documented = (ast.Module, ast.ClassDef, *FUNCTIONS)
    nodes = (n for m in modules.values() for n in ast.walk(m.tree) if isinstance(n, documented))
    texts = (ast.get_docstring(node) or "" for node in nodes)
    return sum(bool(WHAT.search(text.partition("\n")[0])) for text in texts)


def count_lines(file: Path) -> int:
    """Return the number of lines of a text; 0 if there is none."""
    return len(file.read_text(encoding="utf-8").splitlines()) if file.is_file() else 0


def report(folder: Path) -> tuple[dict[str, int], list[str], list[str], dict[str, list[str]]]:
    """Return numbers by name, import cycles, largest functions and kind tests of a folder."""
    modules = read_modules(folder)
    if not modules:
        sys.exit(f"{folder}: expected a folder with Python modules, found none")
    imports = find_imports(modules)
    cycles = {words: find_cycles(imports, places) for words, places in COUNTED.items()}
    tests = find_kind_tests(modules)
    numbers = {
        "modules": len(modules),
        "lines": sum(len(module.text.splitlines()) for module in modules.values()),
        "AST nodes": sum(count_nodes(module.tree) for module in modules.values()),
        **{f"import cycles, {words}": len(found) for words, found in cycles.items()},
        SKIP: sum(module.text.count(SKIP) for module in modules.values()),
        **{name: len(places) for name, places in tests.items()},
        'docstrings with "what" in line 1': count_what_clauses(modules),
        "lines of README.md": count_lines(folder.absolute().parent / "README.md"),
    }
    functions = list_functions(modules)[:LISTED]
    return (
        numbers,
        [", ".join(group) for group in cycles["all"]],
        [f"{nodes:6} {lines:5}  {name}" for nodes, lines, name in functions],
        tests,
    )


def main() -> None:
    """Print the numbers of one source folder, or of two beside each other."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=Path("src"))
    parser.add_argument("--against", type=Path)
    arguments = parser.parse_args()
    folders = [each for each in (arguments.against, arguments.folder) if each is not None]
    numbers, cycles, functions, tests = zip(*(report(folder) for folder in folders), strict=True)
    print(f"python {platform.python_version()}")
    print(f"{'':40}" + "".join(f"{each:>12}" for each in ("other", "this")[-len(folders) :]))
    for name in numbers[0]:
        print(f"{name:40}" + "".join(f"{each[name]:12}" for each in numbers))
    for folder, groups in zip(folders, cycles, strict=True):
        print(f"\nimport cycles of {folder}: {len(groups)}", *groups, sep="\n  ")
    for folder, places in zip(folders, tests, strict=True):
        for name, listed in places.items():
            print(f"\n{name} of {folder}: {len(listed)}", *listed, sep="\n  ")
    print("\nlargest functions: AST nodes, lines, name")
    width = max(len(line) for line in functions[0]) + 2 if len(folders) > 1 else 0
    for row in zip_longest(*functions, fillvalue=""):
        print("  ".join(line.ljust(width) for line in row).rstrip())


if __name__ == "__main__":
    main()
