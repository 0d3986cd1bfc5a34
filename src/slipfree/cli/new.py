"""``slipfree new``: a commented problem file as a template."""

from __future__ import annotations

import shlex
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from slipfree.cli.common import reported
from slipfree.cli.messages import add_json_file, print_line
from slipfree.cli.outputs import check_outputs
from slipfree.core.errors import DataError

FOLDER = "starters"  # folder of the templates in the package
HOLE = "FILE"  # placeholder of the file name in the comments of a template


class Kind(StrEnum):
    """Kind of a problem: the name of its template."""

    direct = "direct"
    inverse = "inverse"
    plan = "plan"


def new(
    kind: Annotated[
        Kind,
        typer.Argument(metavar="KIND", help="Kind of the problem: direct, inverse or plan."),
    ],
    name: Annotated[Path, typer.Argument(metavar="NAME", help="Name of the problem.")],
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Write NAME.toml, a commented and complete problem, as a template."""
    with reported():
        from importlib.resources import files

        if not (name.name and str(name).isprintable()):
            raise DataError(
                f"NAME: expected a file name of printable characters, found {str(name)!r}; choose "
                "another name"
            )
        out = name if name.suffix == ".toml" else name.with_name(f"{name.name}.toml")
        text = (files("slipfree") / FOLDER / f"{kind}.toml").read_text(encoding="utf-8")
        word = shlex.quote(str(out))
        write_new_file(text.replace(f" {HOLE}", f" {word}"), out, force)
        print_line(f"wrote {out}: slipfree check {word} && slipfree run {word}")


def write_new_file(text: str, out: Path, force: bool) -> None:
    """Write a new file; raise DataError if it exists without ``force``, or cannot be written."""
    check_outputs([out])
    if out.exists() and not force:
        raise DataError(
            f"{out}: expected a new file, found an existing one; replace it with --force"
        )
    from slipfree.system.regular_files import replace_file

    replace_file(out, lambda part: part.write_text(text, encoding="utf-8"))
    add_json_file(out)
