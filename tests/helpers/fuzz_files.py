"""Random input files: valid, nearly valid, and damaged.

Every function takes a ``random.Random``, for example one of hypothesis, which can shrink examples.
"""

import json
import re
import tomllib
import types
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from random import Random
from typing import Annotated, Any, Literal, Union, get_args, get_origin
from xml.etree import ElementTree

import numpy as np
from pydantic import BaseModel, PlainValidator

from helpers.cases import DATA, ROOT
from helpers.fuzz_damage import NUMBERS, ODD, WORDS, Case, damaged, grown, shuffled
from helpers.fuzz_libraries import LIBRARY_KINDS
from helpers.fuzz_maps import archive, ascii_grid, beside, cloud, points, raster
from helpers.urdf import FOUR, link
from slipfree.core.records import Label
from slipfree.core.trajectory import Column, Outcome, Stop, Trajectory
from slipfree.files import netcdf
from slipfree.files.urdf.tree import UrdfTable
from slipfree.files.vehicle_toml import AnyShapeTable, AnyWheelTable, VehicleTable
from slipfree.problem.load import VERBS
from slipfree.problem.schema import CommonKeys
from slipfree.vehicle.sections import SECTIONS
from slipfree.vehicle.shapes import SHAPES

DEEP = 100_000
ROBOTS = ("cart", "bogie")  # with vehicle files that complete them
PRINTABLE = re.compile(r"[^\x00-\x08\x0b\x0c\x0e-\x1f\x80-\uffff]*")
Table = dict[str, Any]


def drawn(kind: str, rng: Random) -> Case:
    """Return a case of a kind."""
    return (KINDS | LIBRARY_KINDS | SILENT_KINDS)[kind](kind, rng)


# -------------------------------------------------------------------------------------------- TOML


def toml(value: Any) -> str:
    """Return a value as TOML has it; tables inline."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{toml(k)} = {toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(toml, value)) + "]"
    return repr(value) if isinstance(value, float) else _whole(value)


def _whole(value: int) -> str:
    return str(value) if abs(value) < 10**4000 else "1" + "0" * 4500


def document(data: Mapping[str, Any]) -> str:
    """Return a document of TOML, its tables one after the other."""
    heads = [f"{toml(k)} = {toml(v)}" for k, v in data.items() if not isinstance(v, Mapping)]
    parts = [
        f"\n[{toml(name)}]\n" + "\n".join(f"{toml(k)} = {toml(v)}" for k, v in table.items())
        for name, table in data.items()
        if isinstance(table, Mapping)
    ]
    return "\n".join([*heads, *parts]) + "\n"


def junk(rng: Random, depth: int = 2) -> Any:
    """Return any value."""
    kind = rng.randrange(6 if depth else 4)
    if kind < 2:
        return rng.choice(NUMBERS)
    if kind < 4:
        return rng.choice(WORDS)
    if kind == 4:
        return [junk(rng, depth - 1) for _ in range(rng.randint(0, 4))]
    return {rng.choice(WORDS): junk(rng, depth - 1) for _ in range(rng.randint(0, 3))}


def altered(data: Table, rng: Random) -> Table:
    """Return a table some of whose values are missing, of another name, type or size."""
    data = json.loads(json.dumps(data))
    for _ in range(rng.choice([1, 1, 1, 2, 3])):
        tables = [*_tables(data)]
        table = rng.choice([each for each in tables if each] or tables)
        key = rng.choice([*table] or ["x"])
        what = rng.randrange(7)
        if what == 0:
            table.pop(key, None)
        elif what == 1:
            table[rng.choice([f"{key}s", key[:-1], rng.choice(WORDS)])] = table.pop(key, 0)
        elif what == 2:
            other = rng.choice(tables)
            table[key] = json.loads(json.dumps(rng.choice([*other.values()] or [0])))
        elif what == 3:
            table[key] = rng.choice(NUMBERS)
        elif what == 4:
            table[key] = rng.choice(
                [[table.get(key)], {"x": table.get(key, 0)}, str(table.get(key))]
            )
            table[key] = [] if table[key] == [None] else table[key]
        elif what == 5 and isinstance(table.get(key), list):
            table[key] = [*table[key][: rng.randint(0, 2)], junk(rng)]
        else:
            table[key] = junk(rng)
    return data


def _tables(value: Any) -> list[Table]:
    if isinstance(value, list):
        return [found for each in value for found in _tables(each)]
    if not isinstance(value, dict):
        return []
    return [value, *(found for each in value.values() for found in _tables(each))]


NAMES = (
    "x", "y", "heading", "steer", "right_rate", "left_rate", "steer_rate", "slip", "effort", "z",
    "velocity_x", "velocity_y", "heading_rate", "tilt_right", "utilisation", "swing", "caster",
    "forward", "yaw_rate", "duration", "hitch", "left", "right", "platform", "0", "swing*2",
)  # fmt: skip


def made(model: type[BaseModel], rng: Random) -> Table:
    """Return a table that a record might hold."""
    found = {}
    for name, field in model.model_fields.items():
        if field.is_required() or rng.random() < 0.25:
            found[name] = _made(field.annotation, field.metadata, rng)
    return _of_one_kind(model, found)


def _of_one_kind(model: Any, table: Table) -> Table:
    """Return a table with the first of those keys that exclude each other."""
    given = [key for key in getattr(model, "alternatives", ()) if key in table]
    return {key: value for key, value in table.items() if key not in given[1:]}


def _made(hint: Any, facts: list[Any], rng: Random) -> Any:
    """Return a value of a type, by what pydantic knows of it."""
    if rng.random() < 0.03:
        return junk(rng)
    if any(isinstance(each, PlainValidator) for each in facts):
        return rng.choice(
            [0.3, 1, [0.0, 1.0], [[0, 0.1], [1, 0.2]], "0.1*t", "5 deg/s", "ground.asc", "x"]
        )
    origin, args = get_origin(hint), get_args(hint)
    if hint is AnyWheelTable:
        named = rng.choice([{}, *({"section": name} for name in SECTIONS)])
        return made(AnyWheelTable.schema_for(named), rng) | named
    if hint is AnyShapeTable:
        named = {"kind": rng.choice([*SHAPES])}
        return made(AnyShapeTable.schema_for(named), rng) | named
    if origin is Annotated:
        return _made(args[0], [*args[1:]], rng)
    if origin in (Union, types.UnionType):
        return _made(rng.choice([each for each in args if each is not type(None)]), facts, rng)
    if origin is Literal:
        return rng.choice(args)
    if origin is tuple:
        parts = [args[0]] * rng.randint(0, 4) if args[-1] is Ellipsis else args
        return [_made(each, [], rng) for each in parts]
    if origin is dict:
        return {rng.choice(NAMES): _made(args[1], [], rng) for _ in range(rng.randint(0, 4))}
    if isinstance(hint, type) and issubclass(hint, BaseModel):
        return made(hint, rng)
    if hint is str:
        return rng.choice(NAMES + WORDS)
    plain = {bool: (True, False), int: (0, 1, 2, 4, 20), float: (0.0, 0.05, 0.1, 0.3, 1.0, 2, -1.0)}
    return rng.choice(plain.get(hint, NUMBERS))


# ------------------------------------------------------------------------------------------- cases

GROUND = {
    "synthetic": {
        "x": [-3.0, 3.0],
        "y": [-3.0, 4.0],
        "spacing": 0.5,
        "power_law": {"rms": 0.03, "hurst": 0.9, "longest": 8.0, "shortest": 2.0, "seed": 1},
    }
}
START = {"x": 0.0, "y": 0.0, "heading": 0.0}
SCHEMAS: dict[str, type[CommonKeys]] = {verb.name: verb.schema for verb in VERBS}
SIDE = {
    "ground.asc": "ncols 13\nnrows 15\nxllcenter -3\nyllcenter -3\ncellsize 0.5\n"
    + ("0 " * 13 + "\n") * 15,
    "way.csv": "x,y\n0,0\n0.1,1\n0,2\n",
}


@cache
def bases(kind: str) -> tuple[Table, ...]:
    """Return valid problems of a verb, on small grounds."""
    starter = tomllib.loads((ROOT / "src" / "slipfree" / "starters" / f"{kind}.toml").read_text())
    time = {"time": {"duration": 0.5, "step": 0.1}}
    plain = {**starter, "terrain": GROUND, "start": START}
    step = ROOT / "problems" / ("climb_plan_step.toml" if kind == "plan" else "climb_step.toml")
    climb = tomllib.loads(step.read_text()) | time
    if kind == "plan":
        return {**plain, "plan": {"intervals": 4}}, climb
    trailer = {"vehicle": {"file": "vehicle.toml"}, "frame": "rep103"}
    if kind == "inverse":
        way = {
            "t": [0, 1, 2, 3, 4, 5],
            "x": [0.0] * 6,
            "y": [0.0, 0.2, 0.4, 0.6, 0.8, 1.0],
            "heading": [0.0] * 6,
        }
        along = {k: v for k, v in plain.items() if k != "given"} | {"path": way}
        rover = {
            "vehicle": {"catalog": "ackermann"},
            "given": {"forward": 0.1, "yaw_rate": "0.1*sin(t)"},
        }
        return plain | time, along | time, plain | time | rover
    rated = {k: v for k, v in plain.items() if k != "driver"} | time
    follow = {"driver": {"name": "follow", "speed": 0.3, "file": "way.csv"}}
    return (
        plain | time,
        plain | time | follow | {"terrain": {"file": "ground.asc", "friction": 0.7}},
        rated | trailer | {"inputs": {"left_rate": 1.0, "right_rate": [[0, 1.0], [0.2, 1.1]]}},
        climb,
    )


def _problem(kind: str, rng: Random) -> Case:
    """Return a problem, seldom with a side file that is damaged too."""
    data: Table = rng.choice(bases(kind))
    how, side = rng.random(), {name: text.encode() for name, text in SIDE.items()}
    side["vehicle.toml"] = (ROOT / "problems" / "vehicles" / "trailer.toml").read_bytes()
    if how < 0.15:
        data = _merged(kind, data, rng)
    elif how < 0.6:
        data = altered(data, rng)
    text = document(data)
    if 0.6 <= how < 0.75:
        text = shuffled(text, rng)
    raw = text.encode("utf-8", "surrogatepass")
    if 0.75 <= how < 0.85:
        raw = damaged(raw, rng)
    elif 0.85 <= how < 0.93:
        name = rng.choice([*side])
        side[name] = damaged(side[name], rng)
    elif 0.93 <= how < 0.95:
        raw = _deep(rng)
    return Case(kind, {**side, "problem.toml": raw}, "problem.toml")


def _merged(kind: str, data: Table, rng: Random) -> Table:
    """Return a valid problem some of whose tables are drawn from the schema."""
    drawn_ = made(SCHEMAS[kind], rng) | {"verb": kind}
    found = {key: value for key, value in data.items() if rng.random() < 0.8}
    found |= {key: value for key, value in drawn_.items() if key not in found or rng.random() < 0.2}
    return _of_one_kind(SCHEMAS[kind], found)


def _deep(rng: Random) -> bytes:
    """Return TOML that is nested deeply, or of a giant size in few words."""
    head = 'verb = "direct"\n'
    return (
        head
        + rng.choice(
            [
                "a = " + "[" * DEEP,
                "a = " + "{a=" * DEEP,
                "a" + ".a" * DEEP + " = 1",
                "[" + "a." * 5000 + "a]",
                "[[a]]\n" * 20_000,
                "a = " + "[" * 300 + "]" * 300,
                "start = " + "{x=" * 200 + "1" + "}" * 200,
                "a = '''" + "x" * 10**6,
                "a = 1" + "0" * 10_000,
                "a = 1e" + "9" * 4000,
                "\n" * 200_000,
                "#" * 10**6,
                'a = "' + "\\U0010ffff" * 10_000 + '"',
            ]
        )
    ).encode()


def _vehicle(kind: str, rng: Random) -> Case:
    """Return a vehicle file of TOML: a whole vehicle, or one that completes a URDF."""
    file, how = rng.choice(["trailer", "trike", *ROBOTS]), rng.random()
    place = DATA if file in ROBOTS else ROOT / "problems" / "vehicles"
    text = (place / f"{file}.toml").read_text()
    if how < 0.2:
        schema = UrdfTable if file in ROBOTS else VehicleTable
        text = document(
            {**tomllib.loads(text), **made(schema, rng)}
            if rng.random() < 0.7
            else made(schema, rng)
        )
    elif how < 0.7:
        text = document(altered(tomllib.loads(text), rng))
    elif how < 0.85:
        text = shuffled(text, rng)
    raw = text.encode("utf-8", "surrogatepass")
    if how >= 0.85:
        raw = damaged(raw, rng) if how < 0.97 else _deep(rng)
    side = {f"{name}.urdf": (DATA / f"{name}.urdf").read_bytes() for name in ROBOTS}
    return Case(kind, {**side, "vehicle.toml": raw}, "vehicle.toml")


def _chain(count: int) -> bytes:
    """Return a robot that is one long arm."""
    links = "".join(f"<link name='l{k}'/>" for k in range(count + 1))
    joints = "".join(
        f"<joint name='j{k}' type='revolute'><parent link='l{k}'/><child link='l{k + 1}'/>"
        "<limit lower='-1' upper='1'/></joint>"
        for k in range(count)
    )
    return f"<robot name='arm'>{links}{joints}</robot>".encode()


def urdf(kind: str, rng: Random) -> Case:
    """Return a robot with damaged bytes, exchanged words or mutated elements, or an odd one."""
    known = [((DATA / f"{n}.urdf").read_text(), (DATA / f"{n}.toml").read_text()) for n in ROBOTS]
    bare = f'<robot name="r">{link("base")}{FOUR}</robot>'
    text, completion = rng.choice([*known, (bare, 'urdf = "r.urdf"\n')])
    name, how = completion.partition('urdf = "')[2].partition('"')[0], rng.random()
    if how < 0.25:
        raw = damaged(text.encode(), rng)
    elif how < 0.5:
        raw = shuffled(text, rng, rng.choice([r"\S", '"', r"\w"])).encode()
    elif how < 0.9:
        robot = ElementTree.fromstring(text)
        for _ in range(rng.choice([1, 1, 2, 4])):
            rng.choice([_change_elements, *[_change_attributes] * 3])(robot, rng)
        raw = ElementTree.tostring(robot)
    else:
        odd = (
            b"<a>" * DEEP, b"<a>" * 2000 + b"</a>" * 2000, b"<robot/>", b"", b"\0", _chain(3000),
            b"<robot name='x'>" + b"<link name='a'/>" * 9999,
            b"<!DOCTYPE r [<!ENTITY a 'x'>]><r>&a;</r>",
            b"<?xml version='1.0' encoding='ebcdic'?><r/>",
        )  # fmt: skip
        raw = rng.choice(odd)
    files = {name: raw, "vehicle.toml": completion.encode()}
    return Case(kind, files, rng.choice([*files]))


def _change_elements(robot: ElementTree.Element, rng: Random) -> None:
    """Remove, repeat, rename or move an element."""
    parent = rng.choice([each for each in robot.iter() if len(each)])
    element = rng.choice(list(parent))
    how = rng.randrange(4)
    if how == 0:
        parent.remove(element)
    elif how == 1:
        parent.insert(rng.randint(0, len(parent)), element)
    elif how == 2:
        element.tag = rng.choice([each.tag for each in robot.iter()])
    else:
        parent.remove(element)
        robot.append(element)


def _change_attributes(robot: ElementTree.Element, rng: Random) -> None:
    """Remove, rename or exchange an attribute, or change a word or number of its value."""
    elements = [each for each in robot.iter() if each.attrib]
    element, other = rng.choice(elements), rng.choice(elements)
    key, second = rng.choice([*element.attrib]), rng.choice([*other.attrib])
    how = rng.randrange(6)
    if how == 0:
        del element.attrib[key]
    elif how == 1:
        element.attrib[second] = element.attrib.pop(key)
    elif how == 2:
        element.attrib[key], other.attrib[second] = other.attrib[second], element.attrib[key]
    else:
        parts = re.split(r"([ ,]+)", element.attrib[key])
        words = [word for word in WORDS if PRINTABLE.fullmatch(word)]
        numbers = [_whole(n) if isinstance(n, int) else repr(n) for n in NUMBERS]
        size = f"{rng.lognormvariate(0, 2):.3g}"
        k = rng.randrange(len(parts))
        parts[k] = rng.choice([size, f"-{parts[k]}", rng.choice(words), rng.choice(numbers)])
        element.attrib[key] = "".join(parts)


# ----------------------------------------------------------------------------------------- results


@cache
def results() -> tuple[bytes, ...]:
    """Return result files: of short motions, and of other columns."""
    import tempfile

    from slipfree.problem.load import load_problem
    from slipfree.problem.result import run_problem

    found = []
    with tempfile.TemporaryDirectory() as folder:
        problem, file = Path(folder) / "p.toml", Path(folder) / "p.nc"
        for data in (bases("direct")[0], bases("direct")[-1]):
            problem.write_text(document(data))
            spec = load_problem(problem, ["time.duration=0.1", "time.step=0.05"])
            outcome = run_problem(spec)
            netcdf.write(file, outcome.trajectory, outcome.arrays)
            found.append(file.read_bytes())
        odd = Trajectory(
            np.array([0.0, 1.0]),
            {"x": Column(Label("x", "m", "place"), np.array([np.nan, np.inf]))},
            stop=Stop("plan", 1.0, "é", Outcome.INFEASIBLE),
            statistics={"steps": 1.0},
            attributes={"problem": "x = 1"},
        )
        names = (
            "ends",
            "sizes",
            "unknowns",
            "bound_multipliers",
            "row_multipliers",
            "shift",
            "model",
        )
        arrays = {f"plan_{name}": np.array([3.0, 1e18, 2, 2, 1]) for name in names}
        netcdf.write(file, odd, arrays)
        found.append(file.read_bytes())
    return tuple(found)


def _result(kind: str, rng: Random) -> Case:
    raw, how = rng.choice(results()), rng.random()
    if how < 0.35:
        raw = (
            grown(raw[: rng.choice([400, 4000, 20_000])], rng) + raw[400:]
            if how < 0.05
            else _headed(raw, rng)
        )
    elif how < 0.9:
        raw = damaged(raw, rng)
    return Case(kind, {"run.nc": raw}, "run.nc")


def _headed(raw: bytes, rng: Random) -> bytes:
    """Return a result some of whose words are others of the same length."""
    words = [(m.start(), m.group()) for m in re.finditer(rb"[a-z_]{1,24}", raw)]
    for _ in range(rng.choice([1, 2, 4])):
        at, word = rng.choice(words)
        other = rng.choice([w for _, w in words if len(w) == len(word)])
        raw = (
            raw[:at]
            + rng.choice([other, b"/" * len(word), b"\0" * len(word), b"9" * len(word)])
            + raw[at + len(word) :]
        )
    return raw


# ------------------------------------------------------------------------------------------- names


def _named(_: str, rng: Random) -> Case:
    """Return a case whose file has a name that is not UTF-8, or is no regular file."""
    others = [kind for kind in KINDS if kind != "name"]
    case = drawn(rng.choice(others), rng)
    if rng.random() < 0.6:
        name = rng.choice([case.main, *case.files])
        case = case._replace(odd={**case.odd, name: rng.choice(ODD)})
    if rng.random() < 0.6:
        path = Path(case.main)
        main = rng.choice(["n\udcff", "\udc80", "\udced\udca0\udc80", "a\udcc3"]) + path.suffix
        files, odd = (
            {main if name == case.main else name: value for name, value in each.items()}
            for each in (case.files, case.odd)
        )
        case = case._replace(main=main, files=files, odd=odd)
    return case


KINDS: dict[str, Callable[[str, Random], Case]] = {
    **dict.fromkeys(("direct", "inverse", "plan"), _problem),
    **{"vehicle": _vehicle, "asc": ascii_grid, "npz": archive, "points": points, "ply": cloud},
    **{"pcd": cloud, "sidecar": beside, "result": _result, "name": _named},
}
# kinds of which nothing may be printed
SILENT_KINDS = {"urdf": urdf, "raster": raster}
