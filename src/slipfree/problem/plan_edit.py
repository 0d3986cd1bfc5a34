"""Editing of the places of a planning problem: start, goal and keep-out regions.

Comments and layout of the problem file are preserved. The text is edited table by table, since
tomlkit moves and drops comments and tables when it edits arrays of tables of a whole file.

For planning by hand, a page requests plans from a process and shows the search; see `Session`.
"""

from __future__ import annotations

import hashlib
import math
import os
import queue
import re
import secrets
import shutil
import time
import tomllib
from codecs import BOM_UTF8
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import tomlkit
from annotated_types import Gt, Len
from pydantic import AfterValidator, ConfigDict, Strict, TypeAdapter, ValidationError
from tomlkit.exceptions import TOMLKitError

from slipfree.core.errors import DataError, SlipfreeError
from slipfree.core.facts import Fact, lines, named_rows
from slipfree.core.records import Array
from slipfree.core.trajectory import outcome_words
from slipfree.files.netcdf import DEGREES
from slipfree.files.toml import decode_text, parse_unit, read_raw
from slipfree.problem.build_ground import at
from slipfree.problem.load import load_again
from slipfree.problem.problem import Problem
from slipfree.problem.schema import region_of
from slipfree.problem.verbs.base import drive_facts
from slipfree.problem.verbs.plan_setup import PlanKeys, wanted_places
from slipfree.show.html_page import PlanPage
from slipfree.show.local_server import ConflictError
from slipfree.system.processes import for_children, prepare_process
from slipfree.system.regular_files import replace_file

SAME = 1e-9  # smaller changes are rounding [m, rad]
DIGITS = 4  # decimals of changed values [m, rad]
MAX_REGIONS, MAX_CORNERS = 500, 500  # largest numbers of regions, and of corners of a region
MAX_IDENTITY = 50  # largest number of characters of the identity of a region
LINE = re.compile(r"[^\n]*\n|[^\n]+")
HEADER = re.compile(r"\s*\[[^,#]*\]\s*(#|$)")  # of a table; not a corner of a polygon
FINITE = ConfigDict(allow_inf_nan=False)
Number = Annotated[float, Strict()]  # an integer is one, true is none
Point = tuple[Number, Number]
PLACES = ("start", "goal", "keep_out")  # keys that the page changes
PLANNED = named_rows("edited_plan")  # of a plan on the page


class EditedRegion(NamedTuple):
    """A keep-out region: a disc around its only point, or a polygon without ``radius`` [m].

    Its identity remains when other regions are added or removed.
    """

    identity: Annotated[str, Len(0, MAX_IDENTITY)]
    points: Annotated[tuple[Point, ...], Len(1, MAX_CORNERS)]
    radius: Annotated[Number, Gt(0)] | None = None


def _as_they_can_be(regions: tuple[EditedRegion, ...]) -> tuple[EditedRegion, ...]:
    """Return regions of a page; raise ValueError for equal identities or numbers of points."""
    if len({each.identity for each in regions}) < len(regions):
        raise ValueError
    for each in regions:
        if len(each.points) < 3 if each.radius is None else len(each.points) > 1:
            raise ValueError
    return regions


class Places(NamedTuple):
    """Start, goal and keep-out regions of a planning problem, in map coordinates."""

    start: tuple[Number, Number, Number]  # x, y and heading in the problem's frame [m, m, rad]
    goal: Point | None  # x and y, the middles of ranges; None without both [m]
    goal_heading: Number | None  # None without a heading, and for a range [rad]
    regions: Annotated[
        tuple[EditedRegion, ...], Len(0, MAX_REGIONS), AfterValidator(_as_they_can_be)
    ]


def places_in(problem: Problem[PlanKeys]) -> Places:
    """Return the places of a problem, whose regions get new identities."""
    spec, goal = problem.spec, None
    x, y, turned = (float(spec.start.get(name, 0.0)) for name in ("x", "y", "heading"))
    bounds: Mapping[str, Any] = spec.goal
    if {"x", "y"} <= set(bounds):
        goal = (sum(bounds["x"]) / 2, sum(bounds["y"]) / 2)
    low, high = bounds.get("heading", (0.0, 1.0))
    heading = float(low) if low == high else None
    regions = []
    for index, each in enumerate(spec.keep_out):
        with at(problem, ("keep_out", index)):
            region_of(each)
        points, radius = each.points, None
        if points is None:
            points, radius = ((each.x or 0.0, each.y or 0.0),), float(each.radius or 0.0)
        corners = tuple((float(x), float(y)) for x, y in points)
        regions.append(EditedRegion(secrets.token_hex(8), corners, radius))
    return Places((x, y, turned), goal, heading, tuple(regions))


def way_points_in(problem: Problem[PlanKeys]) -> tuple[tuple[str, float, float], ...]:
    """Return name, x and y of the way-points that have both, the middles of ranges [m]."""
    return tuple(
        (name, sum(wanted["x"]) / 2, sum(wanted["y"]) / 2)
        for name, wanted in wanted_places(problem)[:-1]
        if {"x", "y"} <= wanted.keys()
    )


def places_from(data: object) -> Places:
    """Return the places in a JSON object of the page; raise DataError if it has another form."""
    try:
        return TypeAdapter(Places, config=FINITE).validate_python(data)
    except ValidationError as error:
        raise DataError(
            "expected start, goal, goal_heading and regions with finite numbers, found other "
            "values; reload the page"
        ) from error


def edited_text(text: str, old: Places, new: Places) -> str:
    """Return the text of a problem file with changed places.

    Values that have not changed keep their text; others keep their unit. A range of the goal is
    moved as a whole. New regions follow the others in the file; see `in_order_of_file`. DataError
    is raised if the text has a form that cannot be edited.
    """
    # Parts of a TOML text that begin with a table's header; each is TOML by itself.
    sections = [""]
    for line in LINE.findall(text):
        if HEADER.match(line):
            with suppress(tomllib.TOMLDecodeError):  # a line of an array or a string
                tomllib.loads(sections[-1])
                sections.append("")
        sections[-1] += line
    if old.start != new.start:
        with _edited(sections, "start") as start:
            _move_point(start, old.start[:2], new.start[:2])
            _move(start, "heading", old.start[2], new.start[2])
    if (old.goal, old.goal_heading) != (new.goal, new.goal_heading):
        with _edited(sections, "goal") as goal:
            if old.goal is not None and new.goal is not None:
                _move_point(goal, old.goal, new.goal)
            if old.goal_heading is not None and new.goal_heading is not None:
                _move(goal, "heading", old.goal_heading, new.goal_heading)
    if old.regions != new.regions:
        _edit_regions(sections, old.regions, new.regions)
    return "".join(sections)


def in_order_of_file(
    old: Sequence[EditedRegion], new: Sequence[EditedRegion]
) -> tuple[EditedRegion, ...]:
    """Return the regions of a page in the order that they have in the file after `edited_text`."""
    wanted, former = {each.identity: each for each in new}, {each.identity for each in old}
    kept = [wanted[each.identity] for each in old if each.identity in wanted]
    return (*kept, *(each for each in new if each.identity not in former))


@contextmanager
def _edited(sections: list[str], name: str, where: int | None = None) -> Iterator[Any]:
    """Yield the value of a name, by default in the first section that has it, for editing."""
    if where is None:
        where = next(k for k, part in enumerate(sections) if name in tomllib.loads(part))
    try:
        document: Any = tomlkit.parse(sections[where])
        yield document[name]
        sections[where] = document.as_string()
    except TOMLKitError as error:
        raise DataError(
            f"expected a table {name!r} that can be edited, found: {error}; edit the file by hand"
        ) from error


def _move_point(table: Any, before: Sequence[float], after: Sequence[float]) -> None:
    """Change x and y by the difference of two points; longitude and latitude become x and y."""
    if any(name in table for name in DEGREES) and tuple(before) != tuple(after):
        for name in DEGREES:
            table.pop(name, None)
        before = (math.nan, math.nan)
    for name, old, new in zip(("x", "y"), before, after, strict=True):
        _move(table, name, old, new)


def _move(table: Any, name: str, before: float, after: float) -> None:
    """Change a value, or the ends of a range, by the difference of two numbers."""
    if abs(after - before) <= SAME:
        return
    value = table.get(name)
    if isinstance(value, list):
        for k, end in enumerate(value):
            value[k] = _shifted(end, after - before)
    else:
        table[name] = round(after, DIGITS) if value is None else _shifted(value, after - before)


def _shifted(value: Any, change: float) -> float | str:
    """Return a value of a file, a number or a text with a unit, plus a number in SI units."""
    number = round(float(parse_unit(value)) + change, DIGITS)
    if not isinstance(value, str):
        return number
    in_degrees = round(math.degrees(float(parse_unit(value)) + change), DIGITS)
    return f"{in_degrees} deg" if "deg" in value else f"{number} rad"


def _edit_regions(
    sections: list[str], old: Sequence[EditedRegion], new: Sequence[EditedRegion]
) -> None:
    """Write changed, new and removed keep-out regions into the sections of a problem file."""
    kept = {each.identity: each for each in new}
    added = in_order_of_file(old, new)[sum(each.identity in kept for each in old) :]
    places = [k for k, part in enumerate(sections) if "keep_out" in tomllib.loads(part)]
    if places == [0]:
        with _edited(sections, "keep_out") as array:
            for k, former in reversed([*enumerate(old)]):
                if former.identity not in kept:
                    del array[k]
                else:
                    _edit_region(array[k], former, kept[former.identity])
            for each in added:
                array.append(tomlkit.inline_table())
                _edit_region(array[-1], None, each)
        return
    for k, former in zip(places, old, strict=True):
        if former.identity not in kept:
            sections[k] = "".join(_body_and_tail(sections[k])[1:])
        elif former != kept[former.identity]:
            with _edited(sections, "keep_out", k) as tables:
                _edit_region(tables[0], former, kept[former.identity])
    for each in added:
        table = tomlkit.table()
        _edit_region(table, None, each)
        text = f"\n[[keep_out]]\n{table.as_string()}"
        where = places[-1] if places else len(sections) - 1
        body, tail = _body_and_tail(sections[where])
        end = "" if body.endswith("\n") or not body else "\n"
        sections[where] = body + end + text + tail


def _body_and_tail(section: str) -> tuple[str, str]:
    """Return the text of a table, and the comments and empty lines after its last value."""
    lines = LINE.findall(section)
    end = len(lines)
    while end and lines[end - 1].strip()[:1] in ("", "#"):
        end -= 1
    return "".join(lines[:end]), "".join(lines[end:])


def _edit_region(table: Any, old: EditedRegion | None, new: EditedRegion) -> None:
    """Write the changes of a region to its table, so that other keys and comments stay."""
    if old is None or old.points != new.points:
        if new.radius is None:
            _assign(table, "points", new.points)
        else:
            for name, value in zip(("x", "y"), new.points[0], strict=True):
                _assign(table, name, value)
            for name in DEGREES:
                table.pop(name, None)
    if new.radius is not None and (old is None or old.radius != new.radius):
        _assign(table, "radius", new.radius)


def _assign(table: Any, key: str | int, value: float | Sequence[Any]) -> None:
    """Change a value of a table or an array; unchanged elements of an array keep their text."""
    old = table.get(key) if isinstance(key, str) else table[key]
    if isinstance(value, float):
        if not (isinstance(old, int | float) and abs(old - value) <= SAME):
            table[key] = round(value, DIGITS)
    elif isinstance(old, list) and len(old) == len(value):
        for k, element in enumerate(value):
            _assign(old, k, element)
    else:
        table[key] = [[round(x, DIGITS), round(y, DIGITS)] for x, y in value]


class Document(NamedTuple):
    """A problem file as it was read or saved.

    The regions of its places keep their identities when the page saves them.
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

    DataError is raised if the file cannot be read, is not a valid problem, has another verb than
    ``"plan"``, or has solids.
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


def saved(document: Document, places: Places) -> Document:
    """Write other places to the file of a document, and return the document with them.

    Byte order mark, line endings and permissions of the file are kept. A missing file is written
    again. DataError is raised if the file is read-only or cannot be written, or if the result is
    not a valid problem; the file is then unchanged.
    """
    path, text = document.path, document.text_with(places)
    problem = load_again(path, text, (), document.problem.trusted)
    found = places_in(problem)
    wanted = places._replace(regions=in_order_of_file(document.places.regions, places.regions))
    olds, news = tomllib.loads(decode_text(path, document.raw)), tomllib.loads(text)
    others = [{key: data[key] for key in data.keys() - {*PLACES}} for data in (olds, news)]
    shapes = [(*each[:3], [region[1:] for region in each.regions]) for each in (found, wanted)]
    if others[0] != others[1] or not _is_close(*shapes):
        raise DataError(
            f"{path}: expected tables of start, goal and keep-out regions that can be edited, "
            "found another form; the file is unchanged: edit these values in a text editor"
        )
    pairs = zip(found.regions, wanted.regions, strict=True)
    regions = tuple(new._replace(identity=sent.identity) for new, sent in pairs)
    lines = text.replace("\n", "\r\n") if _has_crlf(document.raw) else text
    raw = BOM_UTF8 * document.raw.startswith(BOM_UTF8) + lines.encode()
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
    return Document(path, raw, problem, found._replace(regions=regions))


def _has_crlf(raw: bytes) -> bool:
    return 0 < raw.count(b"\n") == raw.count(b"\r\n")


def _is_close(first: Any, second: Any) -> bool:
    """Return whether nested numbers agree up to the rounding of saved values."""
    if isinstance(first, tuple | list):
        return len(first) == len(second) and all(map(_is_close, first, second))
    if first is None or second is None:
        return first is second
    return bool(abs(first - second) <= 10**-DIGITS)


INTERVAL = 0.08  # shortest time between two reported iterates [s]
SAMPLES = 400  # largest number of points of a reported path
SHOWN = 12  # number of iterates drawn
KEPT = 2  # number of plans to compare
WATCH = 0.5  # interval between checks of the file for changes by other programs [s]
IDLE, PLANNING = "idle", "planning"


class PlanRequest(NamedTuple):
    """Planning problem to solve."""

    path: Path  # for messages and input files
    text: str
    former: Mapping[str, Array] = {}  # arrays of a plan for a warm start
    trusted: frozenset[str] = frozenset()


class FoundIterate(NamedTuple):
    """Iterate of a search: a line of text and the path, shape (n, 2) [m]."""

    line: str
    path: Array


class FoundPlan(NamedTuple):
    """Result of a search."""

    path: Array  # in the simulation of the plan, shape (n, 2) [m]
    is_complete: bool  # solved and accurate
    facts: tuple[tuple[str, str], ...]
    arrays: Mapping[str, Array]  # for a warm start


Message = FoundIterate | FoundPlan | str  # a text is the error that ended a search


class PlanWorker:
    """Process that solves one problem at a time; it must be used in the main thread.

    The process is kept for further problems. `cancel` kills it, so that a search ends at once.
    """

    def __init__(self) -> None:
        self._process: Any = None
        self._connection: Connection[Any, Any] | None = None
        self.is_busy = False

    def prepare(self) -> None:
        """Start the process, which loads its packages, so that the first search begins sooner."""
        if self._connection is None or not self._process.is_alive():
            self.cancel()
            context = get_context("spawn")  # CasADi is not safe in forked processes
            self._connection, other = context.Pipe()
            self._process = context.Process(target=_solve_requests, args=(other,), daemon=True)
            with for_children():
                self._process.start()
            other.close()

    def start(self, request: PlanRequest) -> None:
        """Begin to solve a problem; a search that still runs is cancelled."""
        if self.is_busy:
            self.cancel()
        self.prepare()
        if self._connection is not None:
            self._connection.send(request)
        self.is_busy = True

    def messages(self) -> Iterator[Message]:
        """Yield the messages that have arrived."""
        while self.is_busy and self._connection is not None:
            try:
                if not self._connection.poll():
                    return
                message: Message = self._connection.recv()
            except (EOFError, OSError):
                self.cancel()
                yield (
                    "expected a running planning process, found that it ended, possibly out of "
                    "memory; plan again, with fewer intervals"
                )
                return
            self.is_busy = isinstance(message, FoundIterate)
            yield message

    def cancel(self) -> None:
        """Kill the process; without one, do nothing."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
        if self._connection is not None:
            self._connection.close()
        self._process, self._connection, self.is_busy = None, None, False


def _solve_requests(connection: Connection[Any, Any]) -> None:
    """Solve requests of the editor until it closes the connection; runs in a process."""
    import slipfree.problem.result  # noqa: F401 - loads while the user is editing

    prepare_process()
    while True:
        try:
            request: PlanRequest = connection.recv()
        except EOFError:
            return
        connection.send(_solve(request, connection))


def _solve(request: PlanRequest, connection: Connection[Any, Any]) -> Message:
    """Return the plan of a problem, or the error; send iterates to a connection."""
    from slipfree.plan.polynomial_motion import from_arrays
    from slipfree.problem.result import run_problem

    last, line = 0.0, ""

    def keep_line(_phase: str, words: str) -> None:
        nonlocal line
        line = words

    def send_path(path: Array) -> None:
        nonlocal last
        if time.monotonic() - last >= INTERVAL:
            connection.send(FoundIterate(line, path))
            last = time.monotonic()

    begin = time.monotonic()
    try:
        problem = load_again(request.path, request.text, (), request.trusted)
        former = from_arrays(request.former, "the last plan") if request.former else None
        result = run_problem(problem, None, keep_line, former, send_path)
    except SlipfreeError as error:
        return str(error)
    except MemoryError:
        return "expected enough memory for the plan, found none left; use fewer intervals"
    seconds, run = time.monotonic() - begin, result.trajectory
    more = {"outcome": outcome_words(run), "seconds": Fact(seconds, "s")}
    facts = lines(PLANNED, {**run.facts, **drive_facts(run), **more})
    chosen = np.unique(np.linspace(0, run.t.size - 1, SAMPLES).round().astype(int))
    path = np.stack([run["x"], run["y"]], axis=1)[chosen]
    return FoundPlan(path, not result.outcome.exit_code, tuple(facts), dict(result.arrays))


class Session(NamedTuple):
    """State of a session."""

    document: Document
    page: PlanPage
    file_error: str = ""  # by which the present file cannot be used
    phase: str = IDLE
    line: str = ""  # last report of the search, or a note on what happened
    error: str = ""  # that ended the last search
    iterates: tuple[Array, ...] = ()  # paths, the newest last, shape (n, 2) [m]
    plans: tuple[FoundPlan, ...] = ()  # the newest first
    version: int = 0  # number of changes, by which a page detects that it is out of date

    def changed(self, **values: Any) -> Session:
        """Return the session with other values and the next version."""
        return self._replace(version=self.version + 1, **values)


class Command(NamedTuple):
    """Command of the page: "plan", "cancel" or "save"."""

    name: str
    revision: str = ""  # of the document from which the page was made
    places: Places | None = None  # None to cancel
    is_warm: bool = False  # whether the search begins with the last plan


def reported(session: Session, message: Message) -> Session:
    """Return the session after a message of the search."""
    if isinstance(message, FoundIterate):
        iterates = (*session.iterates, message.path)[-SHOWN:]
        return session.changed(line=message.line, iterates=iterates)
    if isinstance(message, str):
        return session.changed(phase=IDLE, line="no plan", error=message)
    words = "found a plan" if message.is_complete else "found no complete plan"
    plans = (message, *session.plans)[:KEPT]
    return session.changed(phase=IDLE, line=words, plans=plans, iterates=())


def state_of(session: Session) -> dict[str, Any]:
    """Return the state of a session as a JSON value for the page."""
    places = session.document.places
    told = ("version", "phase", "line", "error", "file_error")
    return {
        **{name: getattr(session, name) for name in told},
        "page": session.page.identity,
        "revision": session.document.revision,
        "places": places._asdict() | {"regions": [region._asdict() for region in places.regions]},
        "iterates": [_rounded(each) for each in session.iterates],
        "plans": [
            {"path": _rounded(each.path), "complete": each.is_complete, "facts": each.facts}
            for each in session.plans
        ],
    }


def _rounded(path: Array) -> list[list[float]]:
    return [[round(float(x), 4), round(float(y), 4)] for x, y in path]


class Desk:
    """Session with its worker process; ``draw`` returns the page of a document.

    Any thread may give commands; `step` must run in the main thread.
    """

    def __init__(self, document: Document, draw: Callable[[Document], PlanPage]) -> None:
        line = "drag the handles, then press Plan"
        self.session = Session(document, draw(document), line=line)
        self.worker = PlanWorker()
        self.worker.prepare()
        self._draw, self._next_watch = draw, 0.0
        self._commands: queue.SimpleQueue[tuple[Command, Future[object]]] = queue.SimpleQueue()

    def accept(self, name: str) -> Callable[[object], object]:
        """Return the function that executes a command of the page and returns the new state.

        ConflictError is raised if the page was made from another revision of the file; DataError as
        in `places_from`.
        """

        def put(data: object) -> object:
            """Queue a command of the page for the main thread, and return its answer."""
            answer, command = Future[object](), Command(name)
            if name != "cancel":
                values = data if isinstance(data, dict) else {}
                places, is_warm = places_from(values.get("places")), values.get("warm") is True
                command = Command(name, str(values.get("revision")), places, is_warm)
            self._commands.put((command, answer))
            return answer.result()

        return put

    def step(self, seconds: float) -> None:
        """Execute a command, waiting for it at most ``seconds``, then read all messages."""
        with suppress(queue.Empty):
            command, answer = self._commands.get(timeout=seconds)
            try:
                self._execute(command)
                answer.set_result(state_of(self.session))
            except SlipfreeError as error:
                answer.set_exception(error)
        if time.monotonic() > self._next_watch:
            self._next_watch = time.monotonic() + WATCH
            self._read_again()
        for message in self.worker.messages():
            self.session = reported(self.session, message)

    def close(self) -> None:
        """End the worker process."""
        self.worker.cancel()

    def _execute(self, command: Command) -> None:
        """Execute a command of the page: cancel, save, or plan."""
        if command.places is None:
            self.worker.cancel()
            self.worker.prepare()
            if self.session.phase == PLANNING:
                self.session = self.session.changed(phase=IDLE, line="cancelled")
            return
        self._read_again()
        session, document = self.session, self.session.document
        if command.revision != document.revision or session.file_error:
            raise ConflictError(state_of(session))
        if command.name == "save":
            document = saved(document, command.places)
            line = f"saved {document.path.name}"
            self.session = session.changed(document=document, line=line)
        else:
            text = document.text_with(command.places)
            former = session.plans[0].arrays if command.is_warm and session.plans else {}
            self.worker.start(PlanRequest(document.path, text, former, document.problem.trusted))
            line = "setting up the problem"
            self.session = session.changed(phase=PLANNING, line=line, error="", iterates=())

    def _read_again(self) -> None:
        """Read the problem file again if another program changed it."""
        session, document = self.session, self.session.document
        try:
            path = document.path
            if os.path.lexists(path) and read_raw(path) != document.raw:
                document = read_document(document.path, document.problem.trusted)
                line = f"{document.path.name} was changed by another program"
                self.session = session.changed(
                    document=document, page=self._draw(document), file_error="", line=line
                )
            elif session.file_error:
                self.session = session.changed(file_error="")
        except SlipfreeError as error:
            if str(error) != session.file_error:
                self.session = session.changed(file_error=str(error))
