"""New problem files: ``slipfree new`` writes a template, ``slipfree examples`` copies problems."""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tomlkit
import typer

from slipfree.cli import console
from slipfree.cli.console import Force, Settings, Trust, add_json, print_line
from slipfree.cli.outputs import check_new, write_new_file
from slipfree.core.errors import DataError, similar
from slipfree.system.regular_files import check_name, make_folder

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable


STARTERS = "starters"  # folder of the templates in the package
HOLE = "FILE"  # placeholder of the file name in the comments of a template
SHIPPED = "problems"  # in the package
OWN = ("terrain", "vehicle")  # tables with the user's files
FRICTION = 0.6  # assumed coefficient
TABLES = {  # comments
    "terrain": "see docs/elevation.md; the coefficient of friction is an assumption",
    "start": "where the vehicle stands; height, pitch and roll follow from the ground",
    "goal": "near the start: change it",
    "bounds": "limits of the URDF [rad/s]; forward only: NAME = [0.0, ...]",
    "given": "commands of the platform: forward, to the left [m/s], counter-clockwise [rad/s]",
}
SPEED, MARGIN = r"(?m)^speed = ([\d.]+) *", 0.8  # of a starter; share of the limits of the URDF
RIGID = '"quasi-static"  # slow motion', '"dynamics"  # motion with inertia'  # of a starter
OTHER = {"name": "Rocky 7", "catalog": "rocky7"}  # vehicle of a comparison
COMMANDS = {"v_x": 0.2, "v_y": 0.0, "omega_z": 0.05}  # of an inverse problem [m/s, rad/s]
# sentences about the vehicle, the ground and removed tables of the template
SHIPPED_ONLY = re.compile(r" (A three-wheeler|Two vehicles|All others) .*")
NEEDED = re.compile(r'\b(?:file|friction) = "(.+?)"')  # keys with names of input files


Kind = Literal["direct", "inverse", "plan", "atlas", "compare"]  # name of a template


def new(
    kind: Annotated[Kind, typer.Argument(metavar="KIND")],
    name: Annotated[Path, typer.Argument(metavar="NAME")],
    force: Force = False,
    ground: Annotated[Path | None, typer.Option(metavar="MAP")] = None,
    vehicle: Annotated[str | None, typer.Option(metavar="VEHICLE")] = None,
    settings: Settings = None,
    trust: Trust = None,
) -> None:
    """Write NAME.toml, a complete problem with comments.

    With --ground and --vehicle it has your map and vehicle, with a start at which the vehicle
    stands; --set gives further keys of [terrain] or [vehicle], such as terrain.vertical_scale=0.01.

    Parameters
    ----------
    kind : {"direct", "inverse", "plan", "atlas", "compare"}
        Kind of the problem: direct, inverse, plan, atlas or compare.
    name : path
        Name of the problem.
    ground : path, optional
        Map of the heights, with --vehicle.
    vehicle : str, optional
        With --ground: vehicle file (TOML, URDF or xacro), or name of the catalogue.
    """
    if not (name.name and str(name).isprintable()):
        raise DataError(
            f"NAME: expected a file name of printable characters, found {str(name)!r}; choose "
            "another name"
        )
    out = name if name.suffix == ".toml" else name.with_name(f"{name.name}.toml")
    check_new(out, force)
    word = shlex.quote(str(out))
    text = (_folder(STARTERS) / f"{kind}.toml").read_text(encoding="utf-8")
    text = text.replace(f" {HOLE}", f" {word}")
    if ground is not None or vehicle is not None or settings:
        if ground is None or vehicle is None:
            given = {"--ground MAP": ground, "--vehicle VEHICLE": vehicle}
            missing = " and ".join(option for option, value in given.items() if value is None)
            raise DataError(
                f"new: expected --ground and --vehicle together, found no {missing}; add it, or "
                "omit all options and change the written file"
            )
        from slipfree.contact.closure import has_exact_closure
        from slipfree.files.urdf.links import wheel_joints
        from slipfree.problem.build_vehicle import build_vehicle, vehicle_file
        from slipfree.problem.ground_survey import distant_goal

        for each in settings or []:
            if not each.startswith(tuple(f"{name}." for name in OWN)):
                raise DataError(
                    f"--set: expected a key of {' or '.join(f'[{name}]' for name in OWN)}, found "
                    f"{each!r}; change other keys in the written file"
                )
        with console.as_arguments():
            problem, surface = console.ground_of(ground, vehicle, settings or [], trust)
        pose, ((_, words), *_) = console.start_on(problem, surface.grid)
        if not pose:
            raise DataError(
                f"{ground}: expected a place where the vehicle stands, found that it stands "
                f"{words}; choose another map or vehicle"
            )
        spec, built, bounds = problem.spec, build_vehicle(problem), dict[str, list[float]]()
        if robot := vehicle_file(spec.vehicle, problem).robot:
            joints = wheel_joints(robot)
            driven = [(w, joints[w.name].max_rate) for w in built.wheels if w.name in joints]
            slow = float(f"{MARGIN * min(w.radius * rate for w, rate in driven):.2g}")
            text = re.sub(SPEED, lambda each: f"speed = {min(float(each[1]), slow):<16g}", text)
            own = {w.name: rate for w, rate in driven if w.driven and rate < math.inf}
            bounds = {f"{name}_rate": [-rate, rate] for name, rate in own.items()}
        if not has_exact_closure(built):  # as required by quasi-statics
            text = text.replace(*RIGID)
        given_keys = (getattr(spec, name).model_dump(exclude_unset=True) for name in OWN)
        tables: dict[str, Any] = dict(zip(OWN, given_keys, strict=True))
        for table in tables.values():
            if "file" in table:
                table["file"] = Path(os.path.relpath(table["file"], out.parent)).as_posix()
        tables["terrain"].setdefault("friction", FRICTION)
        heading, place = pose["heading"], {name: round(pose[name], 3) for name in "xy"}
        if kind != "atlas":
            tables["start"] = {**place, "heading": f"{math.degrees(heading) % 360:g} deg"}
        if kind == "inverse":
            tables["given"] = COMMANDS
        if kind == "compare":
            tables["vehicles"] = [{"name": Path(vehicle).stem, **tables.pop("vehicle")}, OTHER]
        if kind == "plan":
            goal = distant_goal(surface.grid, built, place["x"], place["y"], heading)
            tables |= {"goal": dict(zip("xy", goal, strict=True)), "bounds": bounds}
        text = _with_tables(text, kind, f"{Path(vehicle).stem} on {ground.stem}", tables)
    write_new_file(text, out, force)
    solve = kind if kind in ("atlas", "compare") else "run"
    check = f"slipfree check {word} && " * (kind != "compare")
    print_line(f"wrote {out}: {check}slipfree {solve} {word}")


def _with_tables(text: str, kind: Kind, title: str, tables: Mapping[str, Any]) -> str:
    """Return the text of a problem with another title, and with tables in place of its own.

    In a plan, tables about the motion are removed as well: they belong to the shipped ground.
    """
    own = ""
    for name, table in filter(all, tables.items()):
        if isinstance(table, dict):
            own += f"[{name}]{f'  # {TABLES[name]}' if name in TABLES else ''}\n"
        own += f"{tomlkit.dumps(table if isinstance(table, dict) else {name: table})}\n"
    replaced = {*tables, *(("limits", "bounds", "inputs", "time", "plan") * (kind == "plan"))}
    head, *sections = re.split(r"(?m)^(?=\[)", text)
    kept = (each for each in sections if re.findall(r"\w+", each)[0] not in replaced)
    line = f"title = {json.dumps(title, ensure_ascii=False)}"
    head = re.sub(r"(?m)^title = .*", lambda _: line, head)
    return SHIPPED_ONLY.sub("", head + own + "".join(kept))


def examples(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="NAME",
            autocompletion=lambda incomplete: [k for k in _shipped() if k.startswith(incomplete)],
        ),
    ] = None,
    to: Annotated[Path | None, typer.Option(metavar="DIR")] = None,
    force: Force = False,
) -> None:
    """List the shipped problems, or copy them.

    Copies include the input files that the problems need.

    Parameters
    ----------
    names : list of str, optional
        Problems to copy; all if only --to is given.
    to : path, optional
        Destination folder, created if needed; default: the current one.
    """
    shipped = _shipped()
    if not names and to is None:
        rows, width = [], max(map(len, shipped))
        for name, file in shipped.items():
            data = tomllib.loads(file.read_text(encoding="utf-8"))
            verb, title = data.get("verb", "vehicle"), data.get("title") or data.get("name", "")
            rows.append({"name": name, "verb": verb, "title": title})
            print_line(f"{name:{width}}  {verb:8} {title}")
        add_json("examples", lambda: rows)
        print_line("\ncopy one: slipfree examples NAME; all: slipfree examples --to DIR")
        return
    waiting = [*dict.fromkeys(name.removesuffix(".toml") for name in names or shipped)]
    for name in waiting:
        if name not in shipped:
            raise DataError(
                f"NAME: expected the name of a shipped problem, found {name!r}; "
                f"{similar(name, list(shipped))}list them with slipfree examples"
            )

    # with the problems and the data files that they name
    texts = dict[str, str]()
    while waiting:
        name = waiting.pop()
        texts[f"{name}.toml"] = text = shipped[name].read_text(encoding="utf-8")
        above = PurePosixPath(name).parent
        for each in {(above / file).as_posix() for file in NEEDED.findall(text)} - {*texts}:
            if (other := each.removesuffix(".toml")) in shipped:
                waiting.append(other)
            elif (content := _folder() / each).is_file():
                texts[each] = content.read_text(encoding="utf-8")
    places = {(to or Path()) / name: text for name, text in sorted(texts.items())}
    for out in places:
        check_name(out)
    taken = [str(out) for out in places if out.exists()]
    if taken and not force:
        raise DataError(
            f"examples: expected new files, found existing: {', '.join(taken)}; use --force to "
            "replace, or choose another folder: --to DIR"
        )
    for out, text in places.items():
        make_folder(out.parent, "choose another folder: --to DIR")
        write_new_file(text, out, force)
        print_line(f"wrote {out}")


def _shipped() -> dict[str, Traversable]:
    """Return the shipped problems by name, those in folders last."""

    def below(folder: Traversable, path: str) -> Iterator[tuple[str, Traversable]]:
        for each in sorted(folder.iterdir(), key=lambda each: (each.is_dir(), each.name)):
            if each.is_dir():
                yield from below(each, f"{path}{each.name}/")
            elif each.name.endswith(".toml"):
                yield path + each.name.removesuffix(".toml"), each

    return dict(below(_folder(), ""))


def _folder(name: str = SHIPPED) -> Traversable:
    from importlib.resources import files

    return files("slipfree") / name
