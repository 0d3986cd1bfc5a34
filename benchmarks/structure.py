"""Size and structure of a checkout: lines, names, imports, largest functions, import cycles.

``python benchmarks structure [TREE] [--against OTHER]`` counts below ``src``, ``tests`` and
``benchmarks`` of a checkout, by default this one; with ``--against``, also of one before:

code lines      lines with a statement or a part of one: no blank lines, comments, docstrings
import lines    lines of import statements, also of those in functions
private functions with one reference
                functions and methods whose name begins with one underscore, and which are named
                once outside of themselves: in their module, or by an import into another
class names that occur twice
                names of classes at module level that several modules define
comments        comments on a line of their own
test functions  functions whose name begins with ``test_``
scripts         modules with a function ``main`` or a test of ``__name__``, in ``benchmarks``

An import cycle is a group of two or more modules each of which imports all others of the group,
directly or through others. Cycles are counted of the imports at module level alone, and together
with those in functions and under ``TYPE_CHECKING``; the import of a module's own packages is not
counted. The cycles of all imports are listed.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import sys
import tokenize
import tomllib
from collections import Counter
from collections.abc import Iterator
from importlib.util import resolve_name
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.sparse.csgraph import connected_components

PARTS = ("src", "tests", "benchmarks")
MODULE_LEVEL, IN_FUNCTIONS, TYPING = "at module level", "in functions", "under TYPE_CHECKING"
COUNTED = {
    MODULE_LEVEL: {MODULE_LEVEL},
    f"and {IN_FUNCTIONS}": {MODULE_LEVEL, IN_FUNCTIONS},
    f"and {TYPING}": {MODULE_LEVEL, TYPING},
    "all": {MODULE_LEVEL, IN_FUNCTIONS, TYPING},
}
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
PRIVATE = re.compile("_(?!_)")
DOCUMENTED = (ast.Module, ast.ClassDef, *FUNCTIONS)
LAYOUT = {
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
    *(tokenize.ENCODING, tokenize.ENDMARKER),
}


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


def count_lines(module: Module) -> Counter[str]:
    """Return the numbers of lines, code lines, import lines and own-line comments of a module."""
    tokens = list(tokenize.generate_tokens(io.StringIO(module.text).readline))
    code = {
        line
        for token in tokens
        if token.type not in LAYOUT
        for line in range(token.start[0], token.end[0] + 1)
    }
    imports = set[int]()
    for node in ast.walk(module.tree):
        if isinstance(node, DOCUMENTED) and ast.get_docstring(node) is not None:
            code -= lines_of(node.body[0])
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            imports |= lines_of(node)
    comments = (
        t for t in tokens if t.type == tokenize.COMMENT and not t.line[: t.start[1]].strip()
    )
    return Counter(
        {
            "files": 1,
            "lines": len(module.text.splitlines()),
            "code lines": len(code),
            "AST nodes": sum(1 for _ in ast.walk(module.tree)),
            "import lines": len(imports),
            "comments": sum(1 for _ in comments),
        }
    )


def lines_of(node: ast.stmt) -> set[int]:
    """Return the numbers of the lines of a statement."""
    return set(range(node.lineno, (node.end_lineno or node.lineno) + 1))


def list_functions(modules: dict[str, Module]) -> list[tuple[int, str]]:
    """Return the lines and names of all functions and methods, the longest first."""
    found = []
    for name, module in modules.items():
        for node in ast.walk(module.tree):
            if isinstance(node, FUNCTIONS):
                found.append((len(lines_of(node)), f"{name}.{node.name}"))
    return sorted(found, reverse=True)


def count_single_use(modules: dict[str, Module], imports: Counter[tuple[str, str]]) -> int:
    """Return the number of private functions that are named once outside of themselves.

    ``imports`` counts the imports of a name from a module by another module.
    """
    count = 0
    for name, module in modules.items():
        named = Counter(names_in(module.tree))
        for node in ast.walk(module.tree):
            if isinstance(node, FUNCTIONS) and PRIVATE.match(node.name):
                inside = Counter(names_in(node))[node.name]
                count += named[node.name] - inside + imports[name, node.name] == 1
    return count


def names_in(tree: ast.AST) -> Iterator[str]:
    """Yield the names and attributes in a syntax tree."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr


def imported_from(modules: dict[str, Module]) -> Counter[tuple[str, str]]:
    """Return the number of imports of each name from each module."""
    found = Counter[tuple[str, str]]()
    for importer, module in modules.items():
        package = importer if module.is_package else importer.rpartition(".")[0]
        for node, _ in walk_imports(module.tree, MODULE_LEVEL):
            if isinstance(node, ast.ImportFrom):
                parts = (name.rpartition(".") for name in imported_names(node, package))
                found.update((base, name) for base, _, name in parts)
    return found


def is_script(name: str, module: Module) -> bool:
    """Return whether a module has a function ``main`` or a test of ``__name__``."""
    starts = (
        (isinstance(node, FUNCTIONS) and node.name == "main")
        or (isinstance(node, ast.If) and "__name__" in ast.unparse(node.test))
        for node in module.tree.body
    )
    return name != "__main__" and any(starts)


def report(folder: Path) -> dict[str, int | str]:
    """Return the numbers of the modules below a folder by name; none without modules."""
    modules = read_modules(folder)
    if not modules:
        return {}
    lines = {name: count_lines(module) for name, module in modules.items()}
    classes = Counter(
        node.name
        for m in modules.values()
        for node in m.tree.body
        if isinstance(node, ast.ClassDef)
    )
    functions = list_functions(modules)
    largest = max(lines, key=lambda name: lines[name]["code lines"])
    imports = find_imports(modules)
    numbers: dict[str, int | str] = dict(sum(lines.values(), Counter[str]()))
    numbers |= {
        "functions": len(functions),
        "private functions with one reference": count_single_use(modules, imported_from(modules)),
        "class names that occur twice": sum(count > 1 for count in classes.values()),
        "test functions": sum(name.rpartition(".")[2].startswith("test_") for _, name in functions),
        "scripts": sum(is_script(name, module) for name, module in modules.items()),
        **{
            f"import cycles, {words}": len(find_cycles(imports, places))
            for words, places in COUNTED.items()
        },
        "largest file": f"{largest}, {lines[largest]['code lines']} code lines",
        "largest function": "{1}, {0} lines".format(*functions[0]) if functions else "none",
    }
    return numbers


def over_budget(tree: Path) -> str:
    """Return a message about numbers above the budget of `pyproject.toml`; empty if none is."""
    text = (tree / "pyproject.toml").read_text(encoding="utf-8")
    budget = tomllib.loads(text)["tool"]["slipfree"]["budget"]
    above = []
    for part, numbers in budget.items():
        found = report(tree / part)
        for name, most in numbers.items():
            print(f"{part}: {name} {found[name]} of {most}")
            if found[name] > most:
                above.append(f"{part}: expected at most {most} {name}, found {found[name]}")
    remedy = "remove repetitions: the budget in pyproject.toml only falls"
    return "\n".join([*above, remedy]) if above else ""


ONLY_IN = {"test functions": "tests", "scripts": "benchmarks"}


def main() -> None:
    """Print the numbers of one checkout, or of two beside each other."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tree", nargs="?", type=Path, default=Path(__file__).parents[1])
    parser.add_argument("--against", type=Path, metavar="OTHER", help="checkout before")
    parser.add_argument("--budget", action="store_true", help="fail above the budget")
    options = parser.parse_args()
    if options.budget:
        sys.exit(over_budget(options.tree) or None)  # an empty text would be an error
    trees = [tree for tree in (options.against, options.tree) if tree is not None]
    for tree in trees:
        if not (tree / "src").is_dir():
            sys.exit(f"{tree}: expected a checkout with the folder 'src', found none")
    titles = ("before", "after") if len(trees) > 1 else ("this",)
    for part in PARTS:
        numbers = [report(tree / part) for tree in trees]
        print(f"\n{part:40}" + "".join(f"{title:>12}" for title in titles))
        for name in dict.fromkeys(key for each in numbers for key in each):
            values = [each.get(name, 0) for each in numbers]
            if ONLY_IN.get(name, part) != part or ("cycles" in name and part != "src"):
                continue
            if name.startswith("largest"):
                print(*(f"  {name}: {value}" for value in dict.fromkeys(values)), sep="\n")
            else:
                print(f"  {name:38}" + "".join(f"{value:12}" for value in values))
    for tree in trees:
        groups = find_cycles(find_imports(read_modules(tree / "src")), COUNTED["all"])
        lines = (f"\n  {', '.join(group)}" for group in groups)
        print(f"\nimport cycles of {tree / 'src'}: {len(groups)}", *lines, sep="")
