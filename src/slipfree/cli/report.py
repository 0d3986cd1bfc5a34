"""``slipfree report``: a result as one HTML page."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from slipfree.cli.common import InputFolder, about, reported
from slipfree.cli.messages import add_json_file, detail, print_line, warn
from slipfree.cli.outputs import check_page
from slipfree.system.regular_files import regular_file


def report(
    file: Annotated[Path, typer.Argument(metavar="OUT.nc", help="Result file.")],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--output", metavar="OUT.html", help="Page to write; default: OUT.html."
        ),
    ] = None,
    folder: InputFolder = None,
) -> None:
    """Write a result as one HTML page.

    The page has facts, checks, figures, the problem file and versions.
    """
    with reported(), about(file):
        from slipfree.problem.report import report as made
        from slipfree.show.html_page import page
        from slipfree.system.regular_files import replace_file

        with regular_file(file, "a result file of slipfree"):
            target = out or file.with_suffix(".html")
        check_page(target, [file])
        found = made(file, folder)
        detail(f"made {len(found.figures)} figures of {file}")
        if found.note and not found.figures:
            warn(found.note)
        text = page(found)
        replace_file(target, lambda part: _write(part, text))
        add_json_file(target)
        print_line(f"wrote {target}")


def _write(part: Path, text: str) -> None:
    part.write_text(
        text, encoding="utf-8", errors="backslashreplace"
    )  # file names may have invalid characters
