"""Input files of a problem and their digests."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from slipfree.core.errors import DataError
from slipfree.core.version import __version__
from slipfree.files.vehicle_toml import open_file
from slipfree.problem.build_ground import convert_places
from slipfree.problem.problem import Problem, shared, validated_problem
from slipfree.problem.schema import CommonKeys
from slipfree.system.parts import Identity, Parts
from slipfree.system.regular_files import digest, read_bytes

D = TypeVar("D")
TABLES = ("terrain", "vehicle", "driver", "path", "inputs", "given", "data")  # with input files
DIGESTS = "input_sha256"  # attribute of a result: digests of the input files by name, as JSON
SIDES = (".prj", ".aux.xml", ".hdr", ".tfw", ".wld", ".ovr", ".msk")  # endings beside maps
URDF = (".urdf", ".xacro", ".xml")
# name in a package, as in package://NAME/meshes/a.stl and $(find NAME)/a.xacro, or a path
FILE_NAME = re.compile(
    r"""filename\s*=\s*["'](?:package://[^/"']*/|file://|[^"']*[)}]/)?([^"']+)"""
)


def input_names(spec: CommonKeys) -> tuple[str, ...]:
    """Return the file names in the keys ``file`` and ``friction`` of tables, as written there."""
    tables = [dict(getattr(spec, name, None) or {}) for name in TABLES]
    found = [table.get(key) for key in ("file", "friction") for table in tables]
    names = (name for each in found for name in (each if isinstance(each, tuple) else (each,)))
    return tuple(name for name in names if isinstance(name, str))


def input_files(problem: Problem[Any]) -> dict[str, Path]:
    """Return the paths of all input files by name, including the URDF of a vehicle file."""
    names = list(input_names(problem.spec))
    vehicle: Any = getattr(getattr(problem.spec, "vehicle", None), "file", None)
    with suppress(DataError):  # build_vehicle reports errors in the file
        urdf = vehicle and open_file(problem.folder / vehicle).data.get("urdf")
        names += [str(Path(vehicle).parent / urdf)] if isinstance(urdf, str) else []
    return {name: problem.folder / name for name in names}


def files_read(problem: Problem[Any]) -> list[Path]:
    """Return the paths of all files of a problem: its own, its inputs, and files that these name.

    Those are the side files of maps, such as ``.prj``, and includes and meshes of a URDF.
    """
    files = [problem.source.path]
    for path in input_files(problem).values():
        sides = [name + ending for name in (path.stem, path.name) for ending in SIDES]
        files += [path, *map(path.with_name, sides), *files_named_in(path)]
    return files


def files_named_in(urdf: Path) -> list[Path]:
    """Return the existing files that a URDF and its includes name; none for other files."""
    files, waiting = list[Path](), [urdf] if urdf.suffix.lower() in URDF else []
    while waiting:
        file = waiting.pop()
        with suppress(DataError):  # build_vehicle reports errors in the file
            text = read_bytes(file, "a URDF").decode(errors="replace")
            tops = (
                file.parent,
                *file.absolute().parents[1:4],
            )  # a package is up to 3 folders above
            places = [top / name for name in FILE_NAME.findall(text) for top in tops]
            new = [each for each in dict.fromkeys(places) if each.is_file() and each not in files]
            files += new
            waiting += [each for each in new if each.suffix.lower() in URDF]
    return files


class FileStates(NamedTuple):
    """Files of a computation in parts, as they were when it started."""

    digests: dict[str, str]  # SHA-256 by name
    stamps: dict[Path, tuple[int, int] | None]  # time of the last change, and size

    def check(self) -> None:
        """Raise DataError if a file has changed since, so that parts would not fit together."""
        for path, stamp in self.stamps.items():
            if _stamp(path) != stamp:
                raise DataError(
                    f"{path}: expected an input file that does not change during the computation, "
                    "found that it changed; repeat the command: finished parts are kept for the "
                    "earlier file"
                )


def file_states(files: Mapping[str, Path]) -> FileStates:
    """Return the states of files, by name."""
    stamps = {path: _stamp(path) for path in files.values()}
    return FileStates({name: digest(path) for name, path in sorted(files.items())}, stamps)


class ProblemParts(Parts[D]):
    """Parts of a study of a problem, in a folder beside its output; each task has its own.

    ``kind`` and ``size`` are those of `Identity`. The other values of the task are ``more``, and
    ``states`` those of its input files before they were read, by default those of the problem.
    """

    def __init__(
        self,
        out: Path,
        kind: str,
        size: int,
        problem: Problem[Any],
        ending: str = "",
        states: FileStates | None = None,
        **more: Any,
    ) -> None:
        self.states = states or file_states(input_files(problem))
        values = problem.spec.model_dump_json(exclude={"title"}, serialize_as_any=True)
        task = {"": sha256(values.encode()).hexdigest()}
        own = {"problem": task, "files": self.states.digests, **more}
        head = json.loads(json.dumps({"slipfree": __version__, **own}))  # lists for tuples
        name = f"{out.stem}_parts_{sha256(json.dumps(head).encode()).hexdigest()[:8]}"
        super().__init__(out.parent / name, Identity(kind, size, head), ending, self.states.check)


def _stamp(path: Path) -> tuple[int, int] | None:
    with suppress(OSError, ValueError):  # a missing file, a null character
        state = path.stat()
        return state.st_mtime_ns, state.st_size
    return None


def digests(problem: Problem[Any]) -> dict[str, str]:
    """Return the attribute of a result with the SHA-256 of its input files; empty without files."""
    files = input_files(problem)

    def text() -> str:
        return json.dumps({name: digest(path) for name, path in files.items()})

    return {DIGESTS: shared("digests", tuple(files.values()), text)} if files else {}


class Recipe(NamedTuple):
    """A problem for another process, which reads its input files itself."""

    schema: type[CommonKeys]  # record of its verb
    path: Path
    text: str
    settings: tuple[str, ...]
    trusted: frozenset[str] = frozenset()
    run: int = 0  # distinguishes runs in caches, so that input files are read again

    def load(self) -> Problem[Any]:
        """Return the problem; errors as in `load_problem`."""
        problem = validated_problem(lambda *_: self.schema, self.path, self.text, self.settings)
        return convert_places(replace(problem, trusted=self.trusted))


def recipe_of(problem: Problem[Any], *settings: str, run: int = 0) -> Recipe:
    """Return the recipe of a problem with further settings."""
    source = problem.source
    whole = *dict.fromkeys(source.settings.values()), *settings
    return Recipe(type(problem.spec), source.path, source.text, whole, problem.trusted, run)
