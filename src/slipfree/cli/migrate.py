"""``slipfree migrate``: migration of problem files of version 0.1.0."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Annotated

import typer

from slipfree.cli.common import refuse_result, reported
from slipfree.cli.messages import add_json, add_json_file, print_line, warn
from slipfree.cli.outputs import check_outputs
from slipfree.errors import DataError
from slipfree.regular_files import resolve_links

SUFFIX = ".bak"  # ending of the copy of the original file


def migrate(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Problem file (TOML) of version 0.1.0.")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="NEW.toml",
            help="File to write; default: FILE itself, with the old file kept as FILE.bak.",
        ),
    ] = None,
) -> None:
    """Rewrite a problem file of version 0.1.0 with current keys.

    Comments and layout are kept.
    """
    with reported():
        from slipfree.files.toml.source import read_text
        from slipfree.problem.migrate import migrate_text

        refuse_result(file)
        found = migrate_text(file, read_text(file))
        add_json("changes", lambda: found.changes)
        if found.note:
            warn(found.note)
        if not found.changes:
            print_line(f"{file}: nothing to change, all keys are current")
            return
        old = file.with_name(f"{file.name}{SUFFIX}")
        _check_new(old if out is None else out, file)
        if out is None:
            check_outputs([file])
            _write(old, file, file.read_bytes())
        target = out or file
        _write(target, file, found.text.encode())
        for words in found.changes:
            print_line(words)
        print_line(f"wrote {target}" + ("" if out else f"; the old file is {old}"))


def _check_new(path: Path, file: Path) -> None:
    """Raise DataError if the output file exists, cannot be written, or is the input ``file``."""
    check_outputs([path])
    if resolve_links(path) == resolve_links(file):
        raise DataError(
            f"{path}: expected a file other than FILE, found FILE itself; omit -o to rewrite it"
        )
    if path.exists():
        raise DataError(
            f"{path}: expected a new file, found an existing one; move it, or choose another "
            "name with -o"
        )


def _write(path: Path, like: Path, content: bytes) -> None:
    """Write content to ``path``, with the permissions of the file ``like``."""
    from slipfree.atomic_files import replace_file

    def fill(part: Path) -> None:
        part.write_bytes(content)
        shutil.copymode(like, part)

    replace_file(path, fill)
    add_json_file(path)
