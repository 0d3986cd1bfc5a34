"""``slipfree report``: a result as one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slipfree.cli.common import check_place, reported
from slipfree.cli.voice import detail, put_file, warn
from slipfree.errors import DataError


def report(
    file: Annotated[Path, typer.Argument(metavar="OUT.nc", help="Result file.")],
    out: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="OUT.html", help="The page; default: OUT.html."),
    ] = None,
    folder: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Folder of the problem, if it names other files."),
    ] = None,
) -> None:
    """Write a result as one HTML page: facts, checks, figures, the problem, versions."""
    with reported():
        from slipfree.problem.report import report as made
        from slipfree.result_file import replaced
        from slipfree.show.report import page

        target = out or file.with_suffix(".html")
        _check(target, file)
        found = made(file, folder)
        detail(f"made {len(found.figures)} figures of {file}")
        if found.note:
            warn(f"figures: {found.note}")
        text = page(found)
        replaced(target, lambda part: _write(part, text))
        put_file(target)
        typer.echo(f"wrote {target}")


def _check(out: Path, file: Path) -> None:
    """Refuse a place that cannot be written to, before anything is drawn."""
    if out.resolve() == file.resolve():
        raise DataError(f"{out}: expected a file of its own, found the result file")
    if out.suffix.lower() not in (".html", ".htm"):
        raise DataError(f"{out}: expected a name that ends in .html")
    check_place(out)


def _write(part: Path, text: str) -> None:
    part.write_text(text, encoding="utf-8")
