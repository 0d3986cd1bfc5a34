"""Checks of random files: each is read and used as by the commands, and the outcome is judged."""

import os
import re
import sys
import traceback
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from typer.testing import CliRunner

import slipfree as sf
from helpers.fuzz_damage import Case
from slipfree.cli import app
from slipfree.cli.console import UNEXPECTED
from slipfree.files.mcap import read_joint_commands, read_mcap
from slipfree.files.netcdf import read_arrays
from slipfree.problem.report import describe
from slipfree.problem.result import build
from slipfree.problem.schema import Time

READ, REFUSED = "read", "refused"
LONGEST = 20_000  # characters that somebody may read as a message
SHORT = Time(duration=0.02, step=0.01)
ADDRESS = re.compile(r" at 0x[0-9a-f]{6}|Traceback \(most")


class Verdict(NamedTuple):
    """Outcome of a case: `READ`, `REFUSED` by a clear error, or what is wrong, and the error."""

    name: str
    words: str = ""


def judged(case: Case, folder: Path, *, deep: bool = False) -> Verdict:
    """Return what becomes of a case whose files are written to a folder; deep: solved as well."""
    case.write(folder)
    main = folder / case.main
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        try:
            USES.get(case.kind, _use_map)(main, deep)
            found = Verdict(READ)
        except sf.SlipfreeError as error:
            found = _of_message(str(error), [str(folder), *case.files, "/dev/null"])
        except Exception as error:  # what is to be found
            place = traceback.extract_tb(error.__traceback__)
            where = " < ".join(
                f"{Path(each.filename).name}:{each.lineno}" for each in place[:-7:-1]
            )
            return Verdict("traceback", f"{type(error).__name__}: {str(error)[:120]!r} {where}")
    if told:
        first = told[0]
        return Verdict(
            "warning",
            f"{first.category.__name__}: {str(first.message)[:100]} "
            f"{Path(first.filename).name}:{first.lineno}",
        )
    return found


def judged_silently(case: Case, folder: Path, told: Path) -> Verdict:
    """Return what becomes of a case; what is printed on standard error is an error."""
    with told.open("w+") as stream:
        kept = os.dup(2)
        os.dup2(stream.fileno(), 2)
        try:
            found = judged(case, folder)
        finally:
            sys.stderr.flush()
            os.dup2(kept, 2)
            os.close(kept)
    words = told.read_text(errors="replace")
    return Verdict("print", words[:2000]) if words else found


def _of_message(words: str, names: list[str]) -> Verdict:
    """Return whether a message names a file and can be read."""
    if not any(name in words for name in names):
        return Verdict("unclear", f"names no file: {words[:200]!r}")
    if len(words) > LONGEST or ADDRESS.search(words):
        return Verdict("unclear", f"{len(words)} characters: {words[:200]!r}")
    return Verdict(REFUSED, words)


def _use_problem(file: Path, deep: bool) -> None:
    problem = sf.load_problem(file)
    build(problem)
    if deep and problem.spec.verb != "plan" and getattr(problem.spec, "path", None) is None:
        sf.run_problem(replace(problem, spec=problem.spec.model_copy(update={"time": SHORT})))  # type: ignore[arg-type]


def _use_vehicle(file: Path, _: bool) -> None:
    found = describe(file)
    if found.faults:
        raise sf.SlipfreeError("\n".join(found.faults))


def _use_cloud(file: Path, _: bool) -> None:
    grid = sf.read_map(file).grid
    sf.Bicubic(grid).elevation(grid.x[:2], grid.y[:2])


def _use_log(file: Path, deep: bool) -> None:
    read_joint_commands(file) if deep or b"JointState" in file.read_bytes() else read_mcap(
        file, "x"
    )


def _use_map(file: Path, _: bool) -> None:
    asked: list[dict[str, Any]] = [{}, {"cell": 0.5, "registration": "point"}]
    if file.suffix in (".csv", ".xyz", ".txt"):
        asked = [{"spacing": 0.5}]
    more = {"fill": "linear", "window": (0.0, 3.0, 0.0, 3.0)}
    asked += [{**each, **more} for each in asked] + [{"geographic": "local"}]
    refused = []
    for each in asked:
        try:
            grid = sf.read_map(file, **each).grid
            sf.Bicubic(grid).elevation(grid.x[:2], grid.y[:2])
        except sf.SlipfreeError as error:
            refused.append(error)
    if len(refused) == len(asked):
        raise refused[0]


def _use_result(file: Path, deep: bool) -> None:
    """Look at a result by commands; some of them ask for more than others."""
    name, refused = str(file), []
    commands = [["info", name], ["export", name, "--path", name.replace(".nc", ".geojson")]]
    more = [
        ["info", name, "--problem"],
        ["export", name, "--rates", f"{name}.csv"],
        ["report", name],
        ["show", name, "--html", f"{name}.html"],
    ]
    # By the size alone: some of these files cannot be read.
    commands = [*([] if deep else commands), more[file.lstat().st_size % len(more)]]
    for command in commands:
        result = CliRunner().invoke(app, command)
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        if UNEXPECTED in result.stderr:
            raise RuntimeError(result.stderr)
        if result.exit_code:
            refused.append(result.stderr)
    if refused:
        raise sf.SlipfreeError(min(refused, key=lambda words: name in words))
    read_arrays(file)


USES: dict[str, Callable[[Path, bool], None]] = {
    **dict.fromkeys(("direct", "inverse", "plan"), _use_problem),
    **dict.fromkeys(("vehicle", "urdf", "mesh"), _use_vehicle),
    "laz": _use_cloud,
    "mcap": _use_log,
    "result": _use_result,
}
