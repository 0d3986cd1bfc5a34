"""Play the shell transcripts of pages: `python docs/transcript.py docs/tutorial.md docs/errors.md`.

A page with transcripts reads like any other. Two kinds of fenced blocks are played, in the order of
the page, in one empty folder:

- A block whose first line is `# NAME`, a file name alone, is written to that file.
- A block of the language `console` holds commands behind `$ ` (`> ` where one goes on) and below
  each what it prints, on stdout and stderr, without lines of progress, which depend on the speed of
  the machine. `bash` runs the commands of a block one after another.

The command above writes what was printed into the page, and copies the pictures that the page shows
from the folder of the same name. `tests/app/test_transcripts.py` plays the pages and compares:

- Words are the same; blanks and line breaks may be more or fewer.
- Numbers agree to 1 %. Below 1e-6 all are alike: they are rounding errors.
- Counts of steps, evaluations and iterations, and times of computation, are not compared.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import chdir
from itertools import zip_longest
from pathlib import Path

from typer.testing import CliRunner

from slipfree.cli import app

FENCE = re.compile(r"^(```+)(\w*)\n(.*?)^\1$", re.MULTILINE | re.DOTALL)
FILE = re.compile(r"# (\w[\w/]*\.\w+)\n")
COMMAND = re.compile(r"^\$ .*\n(?:> .*\n)*", re.MULTILINE)
SHELL = re.compile(r"[|<>&;$`*?~]")  # what only a shell understands
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")
VARIES = re.compile(
    r"[\d.e+-]+ (?:s CPU|steps|evaluations|iterations|s, of which [\d.]+ s in)|in [\d.]+ s\b"
    r"|integration error +[\d.e+-]+ m at most, [\d.]+ x"  # differs between processors
)
PROGRESS = re.compile(
    r"integrated to [\d.]+ of |.*\biteration \d+, constraints off by "
    r"|(figures|frames|tiles|poses tried for a start): \d+ of \d+|checking the motion: "
    r"|driving the initial guess|setting up the search"
)
ROUNDING, TOLERANCE = 1e-6, 0.01


def play(page: str, folder: Path) -> str:
    """Return a page with the output of its commands, run in a folder.

    Parameters
    ----------
    page : str
        Text of the page.
    folder : Path
        Where its files are written and its commands are run.

    Returns
    -------
    str
        The page; only what is printed below commands may differ.
    """

    def played(fence: re.Match[str]) -> str:
        _, language, text = fence.groups()
        if name := FILE.match(text):
            (folder / name[1]).write_text(text)
        if language != "console":
            return fence[0]
        return fence[0].replace(text, "".join(_typed(COMMAND.findall(text), folder)))

    return FENCE.sub(played, page)


def _typed(commands: list[str], folder: Path) -> Iterator[str]:
    """Yield each command, and what it prints, as a terminal shows them.

    Those of slipfree alone run in this process: an interpreter takes a second to start.
    """
    place = {"PATH": os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])}
    plain = {k: v for k, v in os.environ.items() if "COLOR" not in k and k != "COLUMNS"}
    code = 0
    for command in commands:
        line = command[2:].replace("\n> ", "\n")
        if line.startswith("slipfree ") and not SHELL.search(line):
            with chdir(folder):
                done = CliRunner(env=dict.fromkeys(os.environ.keys() - plain)).invoke(
                    app, shlex.split(line)[1:]
                )
            code, printed = done.exit_code, done.output
        else:
            found = subprocess.run(
                ["bash", "-c", f"(exit {code})\n{line}"], cwd=folder, env=plain | place, text=True,
                check=False, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
            )  # fmt: skip
            code, printed = found.returncode, found.stdout
        lines = (line.rstrip() for line in printed.splitlines() if not PROGRESS.match(line))
        yield command + "".join(f"{line}\n" for line in lines)


def difference(printed: str, found: str) -> str:
    """Return where two texts differ by more than the rules above allow; empty if nowhere."""
    lines = (VARIES.sub("?", text).splitlines() for text in (printed, found))
    for each in zip_longest(*lines, fillvalue=""):
        a, b = (" ".join(line.split()) for line in each)
        if NUMBER.split(a) != NUMBER.split(b) or not all(
            map(_alike, NUMBER.findall(a), NUMBER.findall(b))
        ):
            return f"the page has\n  {a}\nand the program prints\n  {b}"
    return ""


def _alike(a: str, b: str) -> bool:
    x, y = float(a), float(b)
    return abs(x - y) <= max(ROUNDING, TOLERANCE * max(abs(x), abs(y)))


def main(pages: list[str]) -> None:
    """Write the output of the commands, and the pictures, of pages."""
    for path in map(Path, pages):
        with tempfile.TemporaryDirectory() as name:
            page = play(path.read_text(), Path(name))
            shown = f"figures/{path.stem}/"
            for picture in re.findall(rf"\]\({shown}(.+?)\)", page):
                target = path.parent / shown / picture
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(Path(name) / picture, target)
        path.write_text(page)


if __name__ == "__main__":
    main(sys.argv[1:])
