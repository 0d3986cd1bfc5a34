"""Damage to files: odd numbers and words, and missing, flipped or superfluous bytes.

Every function takes a ``random.Random``.
"""

import math
import os
import re
import struct
from collections.abc import Mapping
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

NUMBERS: tuple[Any, ...] = (
    0, 1, -1, 2, 3, 7, 0.0, -0.0, 0.1, -0.5, 0.3, 1.5, 10.0, 1e-9, 1e9, 1e-300, 1e300, -1e308,
    5e-324, math.nan, math.inf, -math.inf, 2**31, 2**63, -(2**64), 10**30, 10**400, True, False,
)  # fmt: skip
WORDS = (
    "30 deg", "5 deg/s", "1e3 rad/s2", "3 dog", "", " ", "x", "y", "t", "wheel", "right_rate",
    "steer", "front", "platform", "swing", "ground.asc", "way.csv", "solids.csv", "vehicle.toml",
    "..", "/", "/dev/null", "../../../etc/passwd", "a\0b.asc", "é😀", "\u202e", "A" * 300 + ".asc",
    "nan", "1e400", "0.1*sin(t)", "9**9**9", "t**t**t", "1/0", "not " * 200 + "t", "t" + ".a" * 400,
    "(" * 200 + "t", "-" * 900 + "t", "__import__('os').abort()", "1if t else 2", "'\\d'",
    "0x" + "f" * 400, "lambda: t", "[t for t in t]", "sin(*t)", "{t}", "%s%n",
)  # fmt: skip
# a link to itself, to another that leads back, or to what is no file on a disk
ODD = (
    "pipe", "folder", "loop", "loop of two", "missing", "/dev/null", "/dev/zero", "/dev/full",
    "/dev/stdin", "/dev/random", "/proc/self/environ", "/proc/self/mem",
)  # fmt: skip
SIZES = (0, 1, 3, 7, 2**16, 2**31 - 1, 2**31, 2**32 - 1)


class Case(NamedTuple):
    """Files of a folder, and the one that is read.

    The kind is one of `fuzz_files.KINDS`. Contents of files, and what of `ODD` stands in their
    place, are mapped by the names of the files; ``main`` is the name of the one that is read.
    """

    kind: str
    files: Mapping[str, bytes]
    main: str
    odd: Mapping[str, str] = {}

    def write(self, folder: Path) -> None:
        """Write the files to a folder."""
        for name, data in self.files.items():
            if name not in self.odd:
                (folder / name).parent.mkdir(exist_ok=True)
                (folder / name).write_bytes(data)
        for name, kind in self.odd.items():
            path = folder / name
            path.parent.mkdir(exist_ok=True)
            if kind == "pipe":
                os.mkfifo(path)
            elif kind == "folder":
                path.mkdir()
            elif kind == "loop of two":
                other = folder / f"other than {len(name)} {name[-8:]}"
                path.symlink_to(other)
                other.symlink_to(path)
            else:
                path.symlink_to(path if kind == "loop" else kind)


def damaged(data: bytes, rng: Random) -> bytes:
    """Return bytes with a few faults in them."""
    for _ in range(rng.choice([1, 1, 1, 2, 5])):
        data = rng.choice(DAMAGES)(data, rng)
    return data


def perhaps_damaged(kind: str, name: str, data: bytes, rng: Random, share: float) -> Case:
    """Return a case of one file, which is damaged in a share of the cases."""
    return Case(kind, {name: damaged(data, rng) if rng.random() < share else data}, name)


def _cut(data: bytes, rng: Random) -> bytes:
    return data[: rng.randint(0, len(data))]


def _flipped(data: bytes, rng: Random) -> bytes:
    if not data:
        return b"\xff"
    found = bytearray(data)
    for _ in range(rng.choice([1, 1, 3, 20])):
        found[rng.randrange(len(found))] ^= 1 << rng.randrange(8)
    return bytes(found)


def _inserted(data: bytes, rng: Random) -> bytes:
    at = rng.randint(0, len(data))
    junk = (
        b"\0", b"\n", b"\xff\xfe", b"\xed\xa0\x80", b"\r", b'"', b"[", b"A" * 10_000, b"1" * 5000,
        b"\0" * 64, "\u2028".encode(), b"-", b"e", b".", b"#", b"=",
    )  # fmt: skip
    return data[:at] + rng.choice(junk) + data[at:]


def _taken(data: bytes, rng: Random) -> bytes:
    first = rng.randint(0, len(data))
    return data[:first] + data[first + rng.randint(1, 40) :]


def _repeated(data: bytes, rng: Random) -> bytes:
    first = rng.randint(0, len(data))
    part = data[first : first + rng.randint(1, 200)]
    return data[:first] + part * rng.randint(2, 4) + data[first:]


def grown(data: bytes, rng: Random) -> bytes:
    """Overwrite four or eight bytes with a size that is too large."""
    if len(data) < 8:
        return data
    at, order = rng.randrange(len(data) - 7), rng.choice("<>")
    word = struct.pack(f"{order}I", rng.choice(SIZES)) * rng.choice([1, 2])
    return data[:at] + word + data[at + len(word) :]


def _recoded(data: bytes, rng: Random) -> bytes:
    text = data.decode("latin-1")
    return text.encode(rng.choice(["utf-16", "utf-8-sig", "utf-8", "utf-32"]))


def _ended(data: bytes, rng: Random) -> bytes:
    return data.replace(b"\n", rng.choice([b"\r\n", b"\r", b"", b"\n\n", b"\0"]))


DAMAGES = (_cut, _flipped, _inserted, _taken, _repeated, grown, _recoded, _ended)


def shuffled(text: str, rng: Random, of: str = r"\S") -> str:
    """Return a text some of whose words, those that match, are missing, exchanged or replaced."""
    parts = re.findall(r'\w[\w.+-]*|"[^"]*"|\s+|.', text, re.DOTALL)
    places = [k for k, part in enumerate(parts) if re.match(of, part)]
    if not places:
        return text
    for _ in range(rng.choice([1, 1, 1, 2, 4])):
        k, what = rng.choice(places), rng.random()
        if what < 0.3:
            parts[k] = ""
        elif what < 0.7:
            parts[k] = parts[rng.choice(places)]
        else:
            junk = (
                "0", "-1", '"0"', '"1 0 0"', '"-1"', '"x"', '"1e9"', '"nan"', '""', "nan", "inf",
                "1e400", "1e9", "[]", "{}", "true", "\0", "é", "1979-05-27", "07:32:00", "9" * 5000,
            )  # fmt: skip
            parts[k] = rng.choice(junk)
    return "".join(parts)
