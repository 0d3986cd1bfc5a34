"""Problem file that a page edits: read, watched for changes by other programs, and saved."""

from __future__ import annotations

import hashlib
import os
import shutil
import tomllib
from codecs import BOM_UTF8
from pathlib import Path
from typing import Any, NamedTuple

from slipfree.core.errors import DataError
from slipfree.files.toml.source import decode_text, read_raw
from slipfree.problem.load import load_again
from slipfree.problem.plan_edit import (
    DIGITS,
    Places,
    edited_text,
    in_order_of_file,
    places_in,
)
from slipfree.problem.problem import Problem
from slipfree.problem.verbs.plan_schema import PlanKeys
from slipfree.system.atomic_files import replace_file

PLACES = ("start", "goal", "keep_out")  # keys that the page changes


class Document(NamedTuple):
    """A problem file as it was read or saved.

    Attributes
    ----------
    path : Path
        The file.
    raw : bytes
        Contents of the file.
    problem : Problem
        The problem in the file.
    places : Places
        Its places; the regions keep their identities when the page saves them.
    """

    path: Path
    raw: bytes
    problem: Problem[PlanKeys]
    places: Places

    @property
    def revision(self) -> str:
        """Text that differs between different contents of the file."""
        return hashlib.sha256(self.raw).hexdigest()[:16]

    def text_with(self, places: Places) -> str:
        """Return the text of the file with other places; CRLF at all lines becomes LF."""
        text = decode_text(self.path, self.raw)
        text = text.replace("\r\n", "\n") if _has_crlf(self.raw) else text
        return edited_text(text, self.places, places)


def read_document(path: Path, trusted: frozenset[str] = frozenset()) -> Document:
    """Return the document in a file; ``trusted`` is that of its problem.

    Raises
    ------
    DataError
        If the file cannot be read, is not a valid problem, has another verb than ``"plan"``, or has
        solids.
    """
    raw = read_raw(path)
    problem: Problem[Any] = load_again(path, decode_text(path, raw), (), trusted)
    if problem.spec.verb != "plan":
        raise DataError(
            f"{path}: expected a problem with verb = 'plan', found verb = {problem.spec.verb!r}; "
            "use slipfree run"
        )
    if problem.spec.terrain.obstacles:
        raise DataError(
            f"{path}: expected a plan without [[terrain.obstacles]], since a plan over solids has "
            "no places to edit, found obstacles; use slipfree run"
        )
    return Document(path, raw, problem, places_in(problem))


def is_current(document: Document) -> bool:
    """Return whether the file still has the contents of the document, or is missing.

    Raises
    ------
    DataError
        If the file cannot be read.
    """
    return not os.path.lexists(document.path) or read_raw(document.path) == document.raw


def saved(document: Document, places: Places) -> Document:
    """Write other places to the file of a document, and return the document with them.

    Byte order mark, line endings and permissions of the file are kept. A missing file is written
    again.

    Raises
    ------
    DataError
        If the file is read-only or cannot be written, or if the result is not a valid problem; the
        file is then unchanged.
    """
    path, text = document.path, document.text_with(places)
    problem = load_again(path, text, (), document.problem.trusted)
    found = places_in(problem)
    wanted = places._replace(regions=in_order_of_file(document.places.regions, places.regions))
    _check_edit(document, text, found, wanted)
    pairs = zip(found.regions, wanted.regions, strict=True)
    regions = tuple(new._replace(identity=sent.identity) for new, sent in pairs)
    raw = _encoded(text, document.raw)
    _write(path, raw)
    return Document(path, raw, problem, found._replace(regions=regions))


def _encoded(text: str, like: bytes) -> bytes:
    """Return a text with the byte order mark and the line endings of other bytes."""
    text = text.replace("\n", "\r\n") if _has_crlf(like) else text
    return BOM_UTF8 * like.startswith(BOM_UTF8) + text.encode()


def _has_crlf(raw: bytes) -> bool:
    return 0 < raw.count(b"\n") == raw.count(b"\r\n")


def _check_edit(document: Document, text: str, found: Places, wanted: Places) -> None:
    """Raise DataError unless a text has the wanted places and all other values of a document."""
    old, new = tomllib.loads(decode_text(document.path, document.raw)), tomllib.loads(text)
    others = [{key: data[key] for key in data.keys() - {*PLACES}} for data in (old, new)]
    if others[0] == others[1] and _is_close(_shape(found), _shape(wanted)):
        return
    raise DataError(
        f"{document.path}: expected tables of start, goal and keep-out regions that can be edited, "
        "found another form; the file is unchanged: edit these values in a text editor"
    )


def _shape(places: Places) -> Any:
    """Return the values of places without identities of regions."""
    return places[:3], [each[1:] for each in places.regions]


def _is_close(first: Any, second: Any) -> bool:
    """Return whether nested numbers agree up to the rounding of saved values."""
    if isinstance(first, tuple | list):
        return len(first) == len(second) and all(map(_is_close, first, second))
    if first is None or second is None:
        return first is second
    return bool(abs(first - second) <= 10**-DIGITS)


def _write(path: Path, raw: bytes) -> None:
    """Replace the contents of a file that is not read-only, and keep its permissions."""
    is_there = path.exists()
    if is_there and not (os.access(path, os.W_OK) and path.stat().st_mode & 0o222):
        raise DataError(
            f"{path}: expected a file that can be written, found a read-only file; make it "
            "writable (chmod u+w), then save again"
        )

    def fill(part: Path) -> None:
        part.write_bytes(raw)
        if is_there:
            shutil.copymode(path, part)

    replace_file(path, fill)
