"""Generate parts of pages from the package: docstrings, commands and keys of problem files."""

import json
import math
import re
from collections import defaultdict
from collections.abc import Iterator, Sequence
from importlib import import_module
from inspect import get_annotations
from pathlib import Path
from types import UnionType
from typing import Any, Literal, get_args, get_origin

from slipfree.core.quantities import QUANTITIES
from slipfree.files.toml import Record
from slipfree.models.given_rates import LEAST_MARGIN
from slipfree.models.limits import MIN_INCLINATION_COSINE
from slipfree.models.single_wheel import SLIP_LIMIT
from slipfree.problem import schema
from slipfree.problem.load import VERBS
from slipfree.problem.schema import SLIP_LAWS, law_tables
from slipfree.solve.sampling import STRIDE

DOCS = Path(__file__).parent
LISTED = r"<!-- {kind}: ([\w.,\s]+?) -->"
TAKES = {
    "SlipName": ", ".join(f'`"{name}"`' for name in SLIP_LAWS),
    "Positive": "a positive number",
    "Gravity": "a positive number, or a name",
    "NonNegative": "a number, at least 0",
    "NonNegativeAngle": "a number, at least 0",
    "NonNegativeRate": "a number, at least 0",
    "Count": "an integer, at least 0",
    "float": "a number",
    "int": "an integer",
    "bool": "`true` or `false`",
    "str": "text",
    "Name": "text",
    "Quantity": 'a number, or text as in `"30 deg"`',
    "tuple": "`[numbers]`",
    "tuple[Angle, Angle]": "`[mean, deviation]`",
    "tuple[Positive, ...]": "`[numbers]`",
    "Pair": "`[a, b]`",
    "Column": "`[numbers]`",
    "Window": "`[x_min, x_max, y_min, y_max]`",
    "Range": "a number, or `[low, high]`",
    "PiecewiseConstant": "a number, or `[[time, value], ...]`",
    "float | str": "a number, or a file name",
    "tuple[Pair, ...]": "`[[x, y], ...]`",
    "tuple[Annotated[tuple[Pair, ...]": "`[[[x, y], ...], ...]`",
    "tuple[str, ...]": "`[names]`",
    "tuple[Name, ...]": "`[names]`",
    "tuple[Name, Name]": "`[name, name]`",
    "Name | tuple[Name, ...]": "text, or `[names]`",
    "Positive | Name": "a positive number, or a name",
    "tuple[Rock, ...]": "`[[x, y, diameter, height], ...]`",
    "dict[str, str]": "a table of names by name",
    "Positive | str": "a positive number, or a name",
    "dict[str, float]": "a table of numbers by name",
    "dict[str, Quantity]": 'a table of numbers by name; angles also as `"30 deg"`',
    "Angle": 'a number, or text as in `"30 deg"`',
    "Angles": '`[numbers]`, or text as in `"30 deg"`',
    "dict[str, NonNegative]": "a table of numbers by name",
    "dict[str, Positive]": "a table of positive numbers by name",
    "dict[str, Range]": "a table by name: numbers, or `[low, high]`",
    "dict[str, PiecewiseConstant]": "a table by name: numbers, or `[[time, value], ...]`",
    "dict[str, PiecewiseConstantOrFile]": (
        'a table by name: numbers, or `[[time, value], ...]`; `file = "x.mcap"` reads commands'
    ),
    "dict[str, TimeFunction]": (
        "a table by name: numbers, `[[time, value], ...]`, or formulas of `t`"
    ),
    "tuple[dict[str, Range], ...]": "an array of tables by name, each with `at`",
}


def _names(listed: str) -> str:
    """Return a table of public names, and a section for each: its import and its docstring.

    A name without a dot is one of `slipfree`; others follow their module (``solve.replay.replay``).
    """
    entries = _entries(listed)
    rows = (f"| [`{name}`](#{name.lower()}) | {_summary(value)} |" for _, name, value in entries)
    sections = (_section(*entry) for entry in entries)
    return "\n".join(["| name | summary |", "| --- | --- |", *rows, "", *sections])


def _entries(listed: str) -> list[tuple[str, str, Any]]:
    """Return the module, the name and the object of each name of a list."""
    pairs = (f"slipfree.{entry}".rpartition(".")[::2] for entry in re.split(r"[,\s]+", listed))
    return [(module, name, getattr(import_module(module), name)) for module, name in pairs]


def _summary(value: Any) -> str:
    """Return the first paragraph of a docstring, in Markdown."""
    first = (value.__doc__ or "").partition("\n\n")[0]
    return re.sub(r"`+", "`", " ".join(first.split())).replace("|", "\\|")


def _section(module: str, name: str, value: Any) -> str:
    """Return the section of a public name."""
    kind, members = ("class", "\n   :members:") if isinstance(value, type) else ("function", "")
    return (
        f"## {name}\n\n```python\nfrom {module} import {name}\n```\n\n```{{eval-rst}}\n"
        f".. auto{kind}:: {value.__module__}.{name}{members}\n```\n"
    )


def public_names() -> dict[str, set[str]]:
    """Return the names that the pages of the reference describe, by the module of their object."""
    pages = "".join(page.read_text() for page in (DOCS / "reference").glob("*.md"))
    found: dict[str, set[str]] = {}
    for listed in re.findall(LISTED.format(kind="names"), pages):
        for _, name, value in _entries(listed):
            found.setdefault(value.__module__, set()).add(name)
    return found


def _modules(package: str) -> str:
    """Return a section for every module of a package; public names are on pages of their own."""
    folder = DOCS.parent / "src" / package.replace(".", "/")
    files = (path for path in folder.rglob("*.py") if path.stem[0] != "_")
    parts = (path.relative_to(folder).with_suffix("").parts for path in files)
    modules = sorted(".".join((package, *each)) for each in parts) or [package]
    public = public_names()
    return "\n".join(
        f"## {module.removeprefix(f'{package}.')}\n\n```{{eval-rst}}\n"
        f".. automodule:: {module}\n   :members:\n"
        f"   :exclude-members: {', '.join(sorted(public.get(module, ())))}\n```\n"
        for module in modules
    )


def _commands(_: str) -> str:
    """Return a section for each command with its help text."""
    import typer
    from typer.testing import CliRunner

    from slipfree.cli import app

    names = typer.main.get_command(app).commands
    texts = {name: CliRunner().invoke(app, [name, "--help"]).output.strip() for name in names}
    return "\n".join(f"## {name}\n\n```text\n{text}\n```\n" for name, text in texts.items())


def _keys(_: str) -> str:
    """Return a section for each verb: its keys, then those of tables not described before."""
    seen: set[tuple[str, ...]] = set()
    parts = []
    for verb in VERBS:
        parts += [f"## {verb.name}", _summary(verb.schema), *_tables(verb.schema, (), seen)]
    return "\n\n".join(parts)


def _tables(
    record: type[Record], path: tuple[str, ...], seen: set[tuple[str, ...]]
) -> Iterator[str]:
    """Yield the table of the keys of a record, and those of the records in it."""
    rows = ["| key | meaning | unit | value | default |", "| --- | --- | --- | --- | --- |"]
    inner = []
    for key, field in record.model_fields.items():
        found, place = _record_in(field.annotation), (*path, key)
        takes = _titled(place, field) if found else _words(record, key, field.annotation)
        meaning, unit = _meaning(field)
        rows.append(f"| `{key}` | {meaning} | {unit} | {takes} | {_default(field)} |")
        if found is schema.Law:
            found = law_tables()
        if found and (*place, found.__name__) not in seen:
            seen.add((*place, found.__name__))
            inner.append((found, place))
    if path:
        yield f"`[{'.'.join(path)}]`: {_summary(record)}"
    yield "\n".join(rows)
    for found, place in inner:
        yield from _tables(found, place, seen)


def _meaning(field: Any) -> tuple[str, str]:
    """Return the meaning and the unit of a key."""
    words, _, unit = field.description.removesuffix("]").partition(" [")
    return words, unit


def _titled(place: tuple[str, ...], field: Any) -> str:
    """Return the heading of a table, of tables by name, or of an array of tables."""
    name = ".".join(place)
    if "dict[" in str(field.annotation):
        return f"tables `[{name}.NAME]`"
    return f"tables `[[{name}]]`" if "tuple" in str(field.annotation) else f"table `[{name}]`"


def _record_in(annotation: Any) -> type[Record] | None:
    """Return the record that a key accepts, alone or in an array; None if it accepts none."""
    if isinstance(annotation, type) and issubclass(annotation, Record):
        return annotation
    return next(filter(None, map(_record_in, get_args(annotation))), None)


def _options(annotation: Any) -> tuple[str, ...]:
    """Return the names that a key accepts, if any."""
    if get_origin(annotation) is Literal:
        return get_args(annotation)
    return next(filter(None, map(_options, get_args(annotation))), ())


def _alias(annotation: Any, bounds: Sequence[Any]) -> str:
    """Return the name of a type with bounds: that of a table's annotation with the same meaning."""
    if annotation == tuple[float, float]:
        return "Pair"
    if isinstance(annotation, UnionType):  # or None
        annotation = get_args(annotation)[0]
    name = str(annotation.__name__)
    if any(getattr(bound, "gt", None) == 0 for bound in bounds) and name == "float":
        return "Positive"
    if any(getattr(bound, "ge", None) == 0 for bound in bounds):
        return {"float": "NonNegative", "int": "Count"}.get(name, name)
    return name


def _words(record: type[Record], key: str, annotation: Any) -> str:
    """Return the description of the values of a key: names, or its annotation in words."""
    if names := _options(annotation):
        return ", ".join(f'`"{name}"`' for name in names)
    written = next(w for w in map(get_annotations, record.__mro__) if key in w)[key]
    if not isinstance(written, str):  # of a dataclass or function
        return TAKES[_alias(annotation, record.model_fields[key].metadata)]
    names = re.sub(r"\b\w+\.", "", written)  # without their modules
    text = re.sub(r"Annotated\[(.+?), \w+\(.*", r"\1", names)
    return TAKES[text.removesuffix(" | None")]


def _default(field: Any) -> str:
    if field.is_required():
        return "required"
    if isinstance(field.default, Record):
        return "its defaults"
    if field.default == math.inf:
        return "none"
    return f"`{json.dumps(field.default)}`" if field.default not in (None, (), {}) else "none"


def _quantities(_: str) -> str:
    """Return the table of quantities of motions."""
    known = {"wheel": "the wheel", "stride": STRIDE, "slip": SLIP_LIMIT, "least": LEAST_MARGIN}
    known["degrees"] = math.degrees(math.acos(MIN_INCLINATION_COSINE))
    values = defaultdict(lambda: "...", known)
    rows = (
        f"| `{each.name}` | {each.unit} | {each.words.format_map(values)} | {each.shape} | "
        f"{each.facts.replace('most', 'largest') or '-'} | {each.figure or '-'} |"
        for each in QUANTITIES.values()
    )
    return "\n".join(
        ["| name | unit | meaning | of each | facts | figure |", "| --- " * 6 + "|", *rows]
    )


MADE = {
    **{"names": _names, "modules": _modules, "commands": _commands, "keys": _keys},
    "quantities": _quantities,
}


def fill(text: str) -> str:
    """Replace comments such as ``<!-- modules: slipfree.plan -->`` by the text that they name."""
    for kind, make in MADE.items():
        text = re.sub(LISTED.format(kind=kind), lambda match, make=make: make(match[1]), text)
    return text
