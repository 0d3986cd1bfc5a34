"""Tests of editing a planning problem: values read, changed in the file, and sent by a page."""

import json
import threading
import tomllib
from pathlib import Path
from typing import Any

import pytest

from helpers.cases import DATA, PROBLEMS
from helpers.commands import invoke, refuses
from slipfree.core.errors import DataError
from slipfree.files.toml import ProblemError
from slipfree.problem import plan_edit
from slipfree.problem.plan_edit import (
    IDLE,
    PLANNING,
    Desk,
    Document,
    EditedRegion,
    Places,
    edited_text,
    places_from,
    read_document,
    saved,
    state_of,
)
from slipfree.show.html_page import PlanPage
from slipfree.show.local_server import ConflictError, Content

PARKING = PROBLEMS / "plan_parking.toml"


PAGE = PlanPage("page", Content(b"", ""), Content(b"", ""))
# comments at all places, ranges and units, and tables between those of regions
VARIED = (DATA / "plan_in_odd_layout.toml").read_text()
INLINE = """\
keep_out = [
  { x = 3, y = 0.123456789, radius = 0.5 },
  # polygon
  { points = [[-3.0, 0.0], [-2.0, 0.0], [-2.0, 1.0]] },
  { x = 1.0, y = 4.0, radius = 0.25 },
]
start = { x = 0.0, y = -2, heading = "10 deg" }
goal.x = 0.0
goal.y = [1.0, 1.2]
goal.heading = ["20 deg", "20 deg"]
"""


@pytest.fixture
def document(tmp_path: Path) -> Document:
    file = tmp_path / "parking.toml"
    file.write_text(PARKING.read_text(encoding="utf-8"), encoding="utf-8")
    return read_document(file)


@pytest.fixture
def desk(document: Document, monkeypatch: pytest.MonkeyPatch) -> Desk:
    class Worker:
        def prepare(self) -> None: ...
        def cancel(self) -> None: ...
        def start(self, request: object) -> None: ...
        def messages(self) -> tuple[()]:
            return ()

    monkeypatch.setattr(plan_edit, "PlanWorker", Worker)
    return Desk(document, lambda _: PAGE)


def ask(desk: Desk, name: str, state: Any, **places: Any) -> Any:
    """Return the answer to a command of a page that shows a state."""
    data = {"revision": state["revision"], "places": {**state["places"], **places}}
    answers: list[Any] = []

    def post() -> None:
        try:
            answers.append(desk.accept(name)(json.loads(json.dumps(data))))
        except DataError as error:
            answers.append(str(error))
        except ConflictError as error:
            answers.append(error)

    thread = threading.Thread(target=post)
    thread.start()
    desk.step(5.0)
    thread.join(5.0)
    return answers[0]


def shapes(regions: Any) -> list[Any]:
    """Return the regions without their identities."""
    return [each[1:] for each in regions]


def test_ranges_of_a_goal_move_as_a_whole():
    text = "[start]\n[goal]\nx = [1.0, 2.0]  # wide\ny = 0.0\n"
    old = Places((0.0, 0.0, 0.0), (1.5, 0.0), None, ())
    found = edited_text(text, old, old._replace(goal=(3.5, 0.0)))
    assert tomllib.loads(found)["goal"] == {"x": [3.0, 4.0], "y": 0.0}
    assert "# wide" in found


def _text(form: str) -> str:
    """Return the problem with regions in tables, or in an array at the top of the file."""
    if form == "tables":
        return VARIED
    kept, skip = [], False
    for line in VARIED.splitlines():
        skip = (skip or line.startswith("[")) and not line.startswith(("[terrain", "[vehicle"))
        skip = skip and not line.startswith(("[costs", "[driver", "[time"))
        kept += [] if skip else [line]
    return INLINE + "\n".join(kept)


@pytest.mark.parametrize(
    ("form", "newline", "start"), [("tables", "\n", ""), ("inline", "\r\n", "\ufeff")]
)
def test_a_saved_file_has_the_places_and_all_else_of_the_former(tmp_path, form, newline, start):
    text, file = _text(form), tmp_path / "varied.toml"
    file.write_bytes((start + text.replace("\n", newline)).encode())
    old = read_document(file)
    first, polygon, last = old.places.regions
    corners = (polygon.points[0], (-1.5, 0.25), polygon.points[2])
    new = Places(
        (0.5, -2.0, old.places.start[2] + 0.1),
        (1.0, 1.1),
        (old.places.goal_heading or 0.0) + 0.1,
        (EditedRegion("new", ((4.0, -4.0),), 0.2), last, polygon._replace(points=corners)),
    )
    done = saved(old, new)
    raw = file.read_bytes()
    assert raw == done.raw
    assert raw.startswith(start.encode())
    assert raw.count(newline.encode()) == raw.count(b"\n")
    again = read_document(file)
    order = (new.regions[2], last, new.regions[0])
    assert done.places.regions == order
    assert shapes(again.places.regions) == shapes(order)
    assert again.places.start == pytest.approx(new.start, abs=1e-4)
    assert again.places.goal == pytest.approx((1.0, 1.1))
    found = raw.decode("utf-8-sig")
    assert 'heading = ["25.7296 deg", "25.7296 deg"]' in found
    comments = [line.split("#")[1].strip() for line in text.splitlines() if " # " in line]
    lost = [each for each in comments if f"# {each}" not in found]
    assert lost == (["1", "east"] if form == "tables" else [])
    data, former = tomllib.loads(found.replace("\r\n", "\n")), tomllib.loads(text)
    for name in ("start", "goal", "keep_out"):
        del data[name], former[name]
    assert data == former
    undone = saved(done, new._replace(regions=(first, *new.regions)))  # a removed one comes back
    assert shapes(undone.places.regions)[-1] == (((3.0, 0.1235),), 0.5)
    assert saved(again, again.places).raw == raw


def test_a_region_in_degrees_becomes_one_in_metres():
    text = (
        "[start]\nlongitude = 7.0\nlatitude = 46.0\n[goal]\nx = 0.0\ny = 0.0\n"
        "[[keep_out]]\nlongitude = 7.1\nlatitude = 46.1\nradius = 0.5\n"
    )
    region = EditedRegion("a", ((10.0, 20.0),), 0.5)
    old = Places((1.0, 2.0, 0.0), (0.0, 0.0), None, (region,))
    new = old._replace(start=(1.5, 2.0, 0.0), regions=(region._replace(points=((10.0, 21.0),)),))
    data = tomllib.loads(edited_text(text, old, new))
    assert data["start"] == {"x": 1.5, "y": 2.0}
    assert data["keep_out"] == [{"x": 10.0, "y": 21.0, "radius": 0.5}]
    wider = old._replace(regions=(region._replace(radius=0.75),))
    assert edited_text(text, old, wider) == text.replace("radius = 0.5", "radius = 0.75")


def test_values_of_a_page_are_checked():
    good: dict[str, Any] = {"start": [0, 1, 2], "goal": None, "goal_heading": None, "regions": []}
    assert places_from(good) == Places((0.0, 1.0, 2.0), None, None, ())
    disc = {"identity": "a", "points": [[0, 0]], "radius": 1}
    bad: list[dict[str, Any]] = [
        {"start": [0, 1]},
        {"start": [0, 1, float("nan")]},
        {"goal": [1, True]},
        {"goal_heading": "north"},
        {"regions": [{**disc, "identity": 1}]},
        {"regions": [{**disc, "identity": "a" * 51}]},
        {"regions": [disc, disc]},
        {"regions": [{**disc, "radius": 0}]},
        {"regions": [{**disc, "radius": None}]},
        {"regions": [{**disc, "identity": str(k)} for k in range(501)]},
        {"regions": 3},
    ]
    for values in bad:
        refuses(DataError, "found other values; reload the page", places_from, good | values)
    refuses(DataError, "expected start, goal", places_from, None)


def test_an_invalid_problem_is_not_saved(document):
    turned = document.places._replace(goal_heading=1e300)
    refuses(ProblemError, "heading", saved, document, turned)
    assert document.path.read_bytes() == document.raw


def test_commands_of_a_stale_page_are_refused_with_the_present_state(desk):
    first = state_of(desk.session)
    regions = first["places"]["regions"]
    second = ask(desk, "save", first, regions=regions[1:])
    assert second["line"] == "saved parking.toml"
    assert second["places"]["regions"] == regions[1:]  # with its identity
    for name in ("save", "plan"):
        answer = ask(desk, name, first, start=[9.0, 9.0, 0.0])
        assert isinstance(answer, ConflictError)
        assert answer.state == state_of(desk.session)
    assert (desk.session.phase, state_of(desk.session)["places"]) == (IDLE, second["places"])
    assert ask(desk, "plan", second)["phase"] == PLANNING


def test_a_file_that_another_program_changes_is_read_again(desk):
    path, first = desk.session.document.path, state_of(desk.session)
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("radius = 0.8", "radius = 0.9", 1), encoding="utf-8")
    answer = ask(desk, "save", first, start=[1.0, 0.0, 0.0])
    assert isinstance(answer, ConflictError)
    state: Any = answer.state
    assert state["places"]["regions"][0]["radius"] == 0.9
    assert state["line"] == "parking.toml was changed by another program"
    path.write_text("verb =", encoding="utf-8")
    for name in ("save", "plan"):
        assert isinstance(ask(desk, name, state), ConflictError)
    assert "expected TOML" in desk.session.file_error
    assert path.read_text(encoding="utf-8") == "verb ="
    path.unlink()  # of a deleted file the page has the only copy
    assert ask(desk, "save", state, start=[1.0, 0.0, 0.0])["file_error"] == ""
    assert tomllib.loads(path.read_text(encoding="utf-8"))["start"]["x"] == 1.0


def test_links_and_permissions_remain_and_read_only_files_are_refused(document):
    target = document.path.rename(document.path.with_name("target.toml"))
    target.chmod(0o640)
    document.path.symlink_to(target)
    moved = document.places._replace(start=(1.0, 0.0, 0.0))
    done = saved(document, moved)
    assert document.path.is_symlink()
    assert target.stat().st_mode & 0o777 == 0o640
    target.chmod(0o440)
    refuses(DataError, "found a read-only file; make it writable", saved, done, document.places)
    assert target.read_bytes() == done.raw


def test_only_planning_problems_are_edited():
    done = invoke("edit", str(PROBLEMS / "paper_direct.toml"), "--no-browser", code=2)
    assert "expected a problem with verb = 'plan', found verb = 'direct'" in done.stderr
