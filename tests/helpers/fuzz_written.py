"""Damaged files that the commands write themselves and read again, and the commands that do so."""

import json
from collections.abc import Callable, Mapping
from contextlib import chdir
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from typer.testing import CliRunner

from helpers.fuzz_damage import NUMBERS, ODD, Case, damaged
from helpers.problem_files import PROBLEM
from helpers.sweep_cases import PROBLEM as SWEPT
from slipfree.cli import app
from slipfree.cli.console import UNEXPECTED
from slipfree.core.errors import SlipfreeError

HEAD = "ncols 9\nnrows 9\nxllcenter -2\nyllcenter -2\ncellsize 0.5\n"
GROUND = HEAD + 9 * (3 * "0 0.1 0 " + "\n")
ATLAS = "atlas ground.asc three_wheeler --no-draw --headings 1 -j 1 --set atlas.compiled=false"
SWEEP = "sweep p.toml --vary driver.speed=0.5,1.0 -o out -j 1 --no-draw"
RUN = "run p.toml --no-draw -o a.nc"
EXPORTS = ("export a.nc --rates rates.csv", "show a.nc --html page.html")
# by kind: the problem, the command that writes a file, that file, and the commands that read it
WRITTEN: dict[str, tuple[str, str, str, tuple[str, ...]]] = {
    "tile": ("", f"{ATLAS} -o a.tif", "a_parts_*/part_000001.npy", (f"{ATLAS} -o a.tif",)),
    "atlas": ("", f"{ATLAS} -o a.nc", "a.nc", ("info a.nc", "report a.nc")),
    "log": (SWEPT, SWEEP, "out/parts.jsonl", (SWEEP,)),
    "motion": (PROBLEM, RUN, "a.nc", ("info a.nc", "report a.nc", *EXPORTS)),
    "warm": ("plan", RUN, "a.nc", ("run p.toml --resume a.nc --no-draw",)),
}


@cache
def _sound(kind: str) -> tuple[Mapping[str, bytes], str]:
    """Return the files of a kind, as the commands write them, and the output that they give."""
    from slipfree.problem.verbs import atlas

    problem, command, name, readers = WRITTEN[kind]
    if kind == "warm":
        from helpers.fuzz_files import bases, document

        problem = document(bases("plan")[0])
    kept = atlas.TileFolder.remove
    with TemporaryDirectory() as folder, chdir(folder):
        Path("p.toml").write_text(problem)
        Path("ground.asc").write_text(GROUND)
        atlas.TileFolder.remove = lambda _: None  # type: ignore[method-assign]
        try:
            _run(command)
        finally:
            atlas.TileFolder.remove = kept  # type: ignore[method-assign]
        names = ("p.toml", "ground.asc", *map(str, Path().glob(f"{Path(name).parent}/*")))
        sound = {each: Path(each).read_bytes() for each in names if Path(each).is_file()}
        return sound, _run(readers[0])


def _run(command: str) -> str:
    """Return the output of a command; raise SlipfreeError if it fails, and an unexpected error."""
    done = CliRunner().invoke(app, command.split())
    if UNEXPECTED in done.stderr:
        raise RuntimeError(done.stderr)
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    if done.exit_code:
        raise SlipfreeError(done.stderr)
    return done.stdout


def written(kind: str, rng: Random) -> Case:
    """Return a file that a command has written, damaged, mutated by words or no regular file."""
    files, _ = _sound(kind)
    (name,) = (each for each in files if Path(each).match(WRITTEN[kind][2]))
    how, raw = rng.random(), files[name]
    odd = (
        {name: rng.choice([each for each in ODD if not each.startswith("/")])} if how < 0.1 else {}
    )
    if kind == "log" and how < 0.6:
        raw = _changed_lines(raw, rng)
    elif how < 0.3:
        raw = raw[: len(raw) // 2] + bytes(len(raw) - len(raw) // 2)
    else:
        raw = damaged(raw, rng)
    return Case(kind, {**files, name: raw}, name, odd)


def _changed_lines(raw: bytes, rng: Random) -> bytes:
    """Return a log in which a line is repeated, exchanged, or has another value."""
    lines = raw.splitlines(keepends=True)
    k = rng.randrange(len(lines))
    what = rng.randrange(3)
    if what == 0:
        lines.insert(rng.randrange(len(lines)), lines[k])
    elif what == 1:
        lines[k] = lines[rng.randrange(len(lines))]
    else:
        line = json.loads(lines[k])
        line[rng.choice([*line])] = rng.choice(
            [*NUMBERS[:20], "x", None, [], {}, {"a": [1]}, [[1]]]
        )
        lines[k] = json.dumps(line).encode() + b"\n"
    return b"".join(lines)


def use_written(kind: str, file: Path, rng: Random) -> None:
    """Run a command that reads the file; check that a damaged tile or log changes no result."""
    folder = file.parents[len(Path(WRITTEN[kind][2]).parts) - 1]
    command = rng.choice(WRITTEN[kind][3])
    with chdir(folder):
        out = _run(command)
    if kind == "tile" and out != _sound(kind)[1]:
        raise ValueError(f"another result: {out}")


WRITTEN_KINDS: dict[str, Callable[[str, Random], Case]] = dict.fromkeys(WRITTEN, written)
