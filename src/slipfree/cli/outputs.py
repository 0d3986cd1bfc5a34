"""Output files of the commands, checked before and written after a computation; their JSON."""

from __future__ import annotations

import atexit
import os
import shlex
import sys
import tempfile
import webbrowser
from collections.abc import Callable, Collection, Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slipfree.cli import console
from slipfree.core.errors import DataError, WriteError
from slipfree.system import regular_files
from slipfree.system.interrupt import held_interrupt

if TYPE_CHECKING:
    from slipfree.core.facts import Facts
    from slipfree.core.trajectory import Trajectory
    from slipfree.problem.problem import Problem
    from slipfree.show.plots import Plot

OUTPUT = ("output", "file")  # key of a problem file with the name of its result
FIGURE = b"\x89PNG"  # first bytes of a PNG file
PAGES, PICTURES = (".html", ".htm"), (".png", ".svg", ".pdf")  # endings
Picture = Annotated[
    Path | None, typer.Option(metavar="FILE.png|.svg|.pdf", help="Draw the vehicle on its ground.")
]


def motion_json(run: Trajectory, facts: Facts) -> dict[str, Any]:
    """Return the JSON object of a motion: times, stop, wheels, ranges of quantities, facts."""
    return {
        "samples": run.t.size,
        "time": {"unit": "s", "first": run.t[0], "last": run.t[-1]},
        "stop": run.stop and {"name": run.stop.name, "time": run.stop.t, "words": run.stop.words},
        "wheels": run.wheels,
        "quantities": quantities(run),
        "facts": {name: fact._asdict() for name, fact in facts.items()},
        "statistics": run.statistics,
    }


def quantities(run: Trajectory) -> dict[str, Any]:
    """Return description, unit, first, last, smallest and largest value of each quantity by name.

    For quantities of wheels, first and last values are arrays of shape (n_wheels,), and smallest
    and largest values are taken over all wheels. Headings refer to the frame of the problem file.
    """
    return {
        name: {"words": label.words, "unit": label.unit}
        | {"first": values[0], "last": values[-1], "min": values.min(), "max": values.max()}
        for name, (label, values) in run.columns.items()
    }


def print_incomplete(run: Trajectory, out: Path, go_on: str) -> None:
    """Print the outcome of an incomplete motion, its file, and the command that resumes it, if any.

    With ``--quiet``, which omits the summary, print also the reason of the outcome.
    """
    from slipfree.core.trajectory import outcome_title, outcome_words

    words = outcome_words(run) if console.output_options().quiet else outcome_title(run)
    console.print_error(f"{words}; {out} contains the result so far")
    if go_on:
        console.print_error(f"to resume: {go_on}")


def resume_command(run: Trajectory, out: Path, *options: str) -> str:
    """Return the command that resumes an interrupted plan; empty for other motions."""
    from slipfree.core.trajectory import Outcome
    from slipfree.problem.load import find_motion_verb
    from slipfree.problem.verbs.base import RESUME, VERB_ATTRIBUTE

    attributes = run.attributes
    verb = find_motion_verb(attributes.get(VERB_ATTRIBUTE))
    has_more = run.outcome in (Outcome.INTERRUPTED, Outcome.TIME_LIMIT)
    if not has_more or verb is None or RESUME not in verb.options:
        return ""
    file = Path(attributes["problem_folder"]) / attributes["problem_file"]
    lines = attributes.get("settings", "").splitlines()
    settings = [word for line in lines for word in ("--set", line)]
    return shlex.join(["slipfree", "run", str(file), *settings, *options, "--resume", str(out)])


def check_outputs(
    files: Sequence[Path | None],
    inputs: Iterable[Path] = (),
    *,
    endings: Collection[str] = (),
    folder: Path | None = None,
    names: Sequence[str] = ("*.png",),
) -> None:
    """Raise DataError for outputs that cannot be written, or that would replace another file.

    ``inputs`` are files that the command reads, ``endings`` those of the names of ``files``; by
    default a name may have any ending. Further files, whose ``names`` are patterns, go
    into the ``folder``, which is created later if it does not exist.
    """
    read, taken = list(inputs), list[Path]()

    def check_separate(path: Path) -> None:
        same = next((f"the input {each}" for each in read if _is_same(path, each)), "")
        if found := same or "another output" * any(_is_same(path, each) for each in taken):
            raise DataError(f"{path}: expected a separate file, found {found}; choose another name")

    for path in files:
        if path is not None:
            check_separate(path)
            taken.append(path)
            regular_files.check_name(path)
            regular_files.check_target(path)
            above = path.parent
            if not above.is_dir():
                found, remedy = "none", "create it, or choose another folder"
                if above.exists():
                    found, remedy = "a file", "choose another folder"
                expected = f"a folder {above} to write to"
                raise DataError(f"{path}: expected {expected}, found {found}; {remedy}")
            _check_writable(path, above)
            if endings:
                regular_files.check_ending(path, endings)
    if folder is not None:
        regular_files.check_name(folder)
        if not folder.is_dir() and (folder.exists() or folder.suffix.lower() in (".nc", ".csv")):
            proposed = folder.with_suffix("")
            raise DataError(f"{folder}: expected a folder, found a file; use, say, {proposed}")
        above = next(each for each in (folder, *folder.absolute().parents) if each.is_dir())
        _check_writable(folder, above)
        taken.clear()
        for path in (each for name in names for each in folder.glob(name)):
            check_separate(path)


def default_table(file: Path, command: str, inputs: Sequence[Path]) -> Path:
    """Return the default table of a command in the current folder: the name of the file with .csv.

    If this, or a result with the same name (.nc), is an input, the table is called
    NAME_COMMAND.csv instead.
    """
    table = Path(f"{file.stem}.csv")
    taken = (table, table.with_suffix(".nc"))
    is_taken = any(_is_same(path, each) for path in taken for each in inputs)
    return Path(f"{file.stem}_{command}.csv") if is_taken else table


def _is_same(path: Path, other: Path) -> bool:
    """Return whether two paths lead to one file, also by links or by names in other case."""
    if regular_files.resolve_links(path) == regular_files.resolve_links(other):
        return True
    try:
        return path.samefile(other)
    except (OSError, ValueError):  # one of them does not exist, or has an invalid name
        return False


def save_picture(plot: Plot, out: Path) -> None:
    """Draw a picture and write it to a file whose name ends in one of `PICTURES`."""
    draw([plot._replace(name=out.stem)], out.parent, [out.suffix[1:]])
    console.print_line(f"drew {out}")


def draw(plots: Iterable[Plot], folder: Path, formats: Sequence[str] = ("png",)) -> list[Path]:
    """Draw figures in a folder, add their files to the JSON object, and return these."""
    from slipfree.show.plots import save as save_plots

    files = save_plots(plots, folder, formats)
    for file in files:
        console.add_json_file(file)
    return files


def draw_figures(plots: Iterable[Plot], folder: Path, more: str = "") -> None:
    """Draw figures in a folder, and print their names, followed by a text."""
    names = ", ".join(file.stem for file in draw(plots, folder))
    console.print_line(f"drew {names} in {folder}{more}")


def check_default_outputs(out: Path, folder: Path | None, problem: Problem[Any]) -> None:
    """Raise DataError for default output paths that could overwrite other files of the user.

    A path must be a valid file name and, with symbolic links resolved, in the working folder or the
    problem's folder; the result's name ends in ``.nc``; an existing file must be a result or a
    figure. ``folder`` is the default folder for figures, None if it is not used.
    """
    from slipfree.files.netcdf import attributes_of

    for place in (out, folder):
        if place is not None:
            regular_files.check_name(place)
    where = problem.source.where(OUTPUT) if problem.spec.output else str(problem.source.path)
    remedy = f"choose another name, or give it on the command line: -o {shlex.quote(str(out))}"
    inside = [regular_files.resolve_links(each) for each in (Path.cwd(), problem.folder)]
    figures = [] if folder is None else [folder, *folder.glob("*.png")]
    for path in (out, *figures):
        target = regular_files.resolve_links(path)
        if not any(target.is_relative_to(each) for each in inside):
            link = "" if target == Path.cwd() / path else f", which is {target}"
            raise DataError(
                f"{where}: expected a path in the working folder or in the problem's folder, "
                f"found {path}{link}; {remedy}"
            )
    if out.suffix.lower() != ".nc":
        proposed = out.with_suffix(".nc")
        raise DataError(f"{where}: expected a name that ends in .nc, found {out}; use {proposed}")
    if out.is_file() and not attributes_of(out):
        raise DataError(
            f"{where}: expected a new file or a result of an earlier run, found the file {out}, "
            f"which is neither; {remedy}"
        )
    for path in figures[1:]:
        if not console.begins_with(path, FIGURE):
            raise DataError(
                f"{where}: expected a new file or a figure of an earlier run, found the file "
                f"{path}, which is neither; choose another folder: --figures DIR"
            )


def _check_writable(path: Path, folder: Path) -> None:
    if not os.access(folder, os.W_OK):
        raise DataError(
            f"{path}: expected a folder {folder} that may be written to, found one without write "
            "permission; choose another folder"
        )


def save(path: Path, write: Callable[[Path], object]) -> Path:
    """Write a file that took long to compute, add it to the JSON object, and return its path.

    ``write(path)`` replaces an existing file only when the new one is complete. The first Ctrl-C is
    held back until the file is written. If the file cannot be written, for example because its disk
    is full, it is written to a new temporary folder, and the command ends with exit code 1.
    WriteError is raised if that fails, too; KeyboardInterrupt after Ctrl-C: after a second one, its
    message says that the file is not written.
    """
    is_written = False
    before = "the earlier file is unchanged" if path.exists() else "there is no file of this name"
    try:
        with held_interrupt():
            try:
                write(path)
            except WriteError as error:
                words = f"{error}; {before}"
                path = Path(tempfile.mkdtemp(prefix="slipfree_")) / path.name
                try:
                    write(path)
                except WriteError as second:
                    path.parent.rmdir()
                    raise WriteError(f"{words}; {second}") from second
                console.print_error(f"{words}; saved as {path}")
                console.note_failure()
            is_written = True
            console.add_json_file(path)
    except KeyboardInterrupt:
        if is_written:
            raise
        raise KeyboardInterrupt(f"{path} is not written: {before}") from None
    return path


def write_new_file(text: str, out: Path, force: bool) -> None:
    """Write a new file; raise DataError if it exists without ``force``, or cannot be written."""
    check_new(out, force)
    regular_files.replace_file(out, lambda part: part.write_text(text, encoding="utf-8"))
    console.add_json_file(out)


def check_new(out: Path, force: bool) -> None:
    """Raise DataError if a file exists without ``force``, or cannot be written."""
    check_outputs([out])
    if out.exists() and not force:
        raise DataError(
            f"{out}: expected a new file, found an existing one; replace it with --force"
        )


def open_page(url: str, browser: bool, does: str = "shows the motions") -> None:
    """Print the address of the page, and open it if ``browser`` is set and a display exists.

    The browser gets the name of a private file that redirects to the address, since other users of
    the machine can read the arguments of its process.
    """
    console.print_line(f"{url} {does}; Ctrl-C ends the server", err=True)
    seen = sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
    if browser and seen:
        descriptor, name = tempfile.mkstemp(".html", "slipfree-")  # readable by its owner only
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(f'<meta http-equiv="refresh" content="0; url={url}">')
        atexit.register(Path(name).unlink, missing_ok=True)
        webbrowser.open(Path(name).as_uri())
