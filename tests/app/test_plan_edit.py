"""Tests of editing a planning problem: values read, changed in the file, and sent by a page."""

from __future__ import annotations

import http.client
import json
import threading
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from slipfree.cli import app
from slipfree.errors import DataError
from slipfree.files.toml.errors import ProblemError
from slipfree.problem.load import load_problem
from slipfree.problem.plan_edit import Places, Region, edited_text, places_from, places_in
from slipfree.problem.plan_session import (
    IDLE,
    PLANNING,
    SHOWN,
    Session,
    begun,
    cancelled,
    open_session,
    reported,
    saved,
    state_of,
)
from slipfree.problem.plan_worker import FoundError, FoundIterate, FoundPlan
from slipfree.show.guard import is_own_request
from slipfree.show.local_server import json_content, start_server

PROBLEMS = Path(__file__).parents[2] / "problems"
PARKING = PROBLEMS / "plan_parking.toml"
PATH = np.array([[0.0, 0.0], [1.0, 2.0]])


@pytest.fixture
def session(tmp_path: Path) -> Session:
    file = tmp_path / "parking.toml"
    file.write_text(PARKING.read_text(encoding="utf-8"), encoding="utf-8")
    text = file.read_text(encoding="utf-8")
    return open_session(file, text, places_in(load_problem(file)))


def test_places_of_a_problem() -> None:
    places = places_in(load_problem(PARKING))
    discs = tuple(Region(k, ((2.0, y),), 0.8) for k, y in enumerate((2.5, -2.5)))
    assert places == Places((0.0, 0.0, 0.0), (2.0, 0.0), 0.0, discs)


def test_a_problem_without_changes_keeps_its_text() -> None:
    text, places = PARKING.read_text(encoding="utf-8"), places_in(load_problem(PARKING))
    assert edited_text(text, places, places) == text


def test_changed_places_keep_comments_and_other_values() -> None:
    text, places = PARKING.read_text(encoding="utf-8"), places_in(load_problem(PARKING))
    moved = places._replace(start=(0.5, 0.0, 1.0), goal_heading=0.25)
    found = edited_text(text, places, moved)
    changed = [line for line in found.splitlines() if line not in text.splitlines()]
    assert [line.split() for line in changed] == [
        ["x", "=", "0.5", "#", "[m]"],
        ["heading", "=", "1.0", "#", "[rad]"],
        ["heading", "=", "0.25", "#", "[rad]"],
    ]


def test_regions_are_moved_removed_and_added() -> None:
    text, places = PARKING.read_text(encoding="utf-8"), places_in(load_problem(PARKING))
    first, _ = places.regions
    triangle = Region(None, ((0.0, 3.0), (1.0, 3.0), (0.5, 4.0)))
    regions = (first._replace(points=((2.5, 2.5),)), Region(None, ((4.0, 0.0),), 0.3), triangle)
    data = tomllib.loads(edited_text(text, places, places._replace(regions=regions)))
    assert data["keep_out"] == [
        {"x": 2.5, "y": 2.5, "radius": 0.8},
        {"x": 4.0, "y": 0.0, "radius": 0.3},
        {"points": [[0.0, 3.0], [1.0, 3.0], [0.5, 4.0]]},
    ]
    assert "keep_out" not in tomllib.loads(edited_text(text, places, places._replace(regions=())))


def test_ranges_of_a_goal_move_as_a_whole() -> None:
    text = "[start]\n[goal]\nx = [1.0, 2.0]  # wide\ny = 0.0\n"
    old = Places((0.0, 0.0, 0.0), (1.5, 0.0), None, ())
    found = edited_text(text, old, old._replace(goal=(3.5, 0.0)))
    assert tomllib.loads(found)["goal"] == {"x": [3.0, 4.0], "y": 0.0}
    assert "# wide" in found


def test_inline_regions_stay_inline() -> None:
    text = "keep_out = [{ x = 1.0, y = 2.0, radius = 0.5 }]\n[start]\n[goal]\nx = 1.0\ny = 0.0\n"
    old = Places((0.0, 0.0, 0.0), (1.0, 0.0), None, (Region(0, ((1.0, 2.0),), 0.5),))
    new = old._replace(regions=(Region(0, ((1.0, 3.0),), 0.5), Region(None, ((0.0, 1.0),), 0.2)))
    found = tomllib.loads(edited_text(text, old, new))["keep_out"]
    assert found == [{"x": 1.0, "y": 3.0, "radius": 0.5}, {"x": 0.0, "y": 1.0, "radius": 0.2}]


def test_values_of_a_page_are_checked() -> None:
    good: dict[str, Any] = {"start": [0, 1, 2], "goal": None, "goal_heading": None, "regions": []}
    assert places_from(good) == Places((0.0, 1.0, 2.0), None, None, ())
    disc = {"row": 0, "points": [[0, 0]], "radius": 1}
    bad: list[dict[str, Any]] = [
        {"start": [0, 1]},
        {"start": [0, 1, float("nan")]},
        {"goal": [1, True]},
        {"goal_heading": "north"},
        {"regions": [{**disc, "row": -1}]},
        {"regions": [{**disc, "radius": 0}]},
        {"regions": [{**disc, "radius": None}]},
        {"regions": [disc] * 501},
        {"regions": 3},
    ]
    for values in bad:
        with pytest.raises(DataError, match="found other values; reload the page"):
            places_from(good | values)
    with pytest.raises(DataError, match="expected start, goal"):
        places_from(None)


def test_a_session_shows_iterates_then_the_last_two_plans(session: Session) -> None:
    now = begun(session)
    assert now.phase == PLANNING
    for k in range(SHOWN + 3):
        now = reported(now, FoundIterate(f"iteration {k}", PATH + k))
    assert now.line == f"iteration {SHOWN + 2}"
    assert len(now.iterates) == SHOWN
    for k in range(3):
        now = reported(now, FoundPlan(PATH, True, (("cost", str(k)),), {}))
    assert now.phase == IDLE
    assert now.iterates == ()
    assert [plan["facts"] for plan in state_of(now)["plans"]] == [
        (("cost", "2"),),
        (("cost", "1"),),
    ]
    failed = reported(begun(now), FoundError("too steep"))
    assert (failed.phase, failed.error) == (IDLE, "too steep")
    assert failed.plans == now.plans
    assert cancelled(begun(now)).line == "cancelled"
    assert failed.version > now.version > session.version
    json.dumps(state_of(now))


def test_an_invalid_problem_is_not_saved(session: Session) -> None:
    turned = session.places._replace(goal_heading=1e300)
    with pytest.raises(ProblemError, match="heading"):
        saved(session, turned)
    assert session.path.read_text(encoding="utf-8") == session.text


def test_a_file_that_changed_is_not_overwritten(session: Session) -> None:
    session.path.write_text("# mine\n", encoding="utf-8")
    with pytest.raises(DataError, match="expected an unchanged file, found that it was changed"):
        saved(session, session.places)
    assert session.path.read_text(encoding="utf-8") == "# mine\n"


def test_only_planning_problems_are_edited() -> None:
    done = CliRunner().invoke(app, ["edit", str(PROBLEMS / "paper_direct.toml"), "--no-browser"])
    assert done.exit_code == 2
    assert "expected a problem with verb = 'plan', found verb = 'direct'" in done.stderr


@pytest.mark.parametrize(
    ("hosts", "origins", "is_own"),
    [
        (["127.0.0.1:8000"], [], True),
        (["LocalHost:8000"], ["http://localhost:8000"], True),
        (["127.0.0.1:8000"], ["http://evil.example"], False),
        (["127.0.0.1:8000"], ["https://127.0.0.1:8000"], False),
        (["evil.example:8000"], [], False),
        (["127.0.0.1:8001"], [], False),
        (["127.0.0.1:8000", "127.0.0.1:8000"], [], False),
        ([], [], False),
    ],
)
def test_requests_of_other_pages_are_refused(
    hosts: list[str], origins: list[str], is_own: bool
) -> None:
    assert is_own_request(hosts, origins, 8000) == is_own


class Client:
    """Connection to a server that echoes what is posted to ``/echo``."""

    def __init__(self, port: int, warnings: list[str]) -> None:
        self.port, self.warnings = port, warnings

    def ask(self, method: str, path: str, body: str = "", **headers: str) -> tuple[int, str]:
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=20)
        names = {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request(method, path, body or None, names)
        answer = connection.getresponse()
        return answer.status, answer.read().decode()


@pytest.fixture
def client() -> Iterator[Client]:
    warnings: list[str] = []

    def refuse(_: object) -> object:
        raise DataError("expected another value")

    get = {"/": lambda: json_content("page")}
    server = start_server(0, get, {"/echo": lambda data: data, "/no": refuse}, warnings.append)
    thread = threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True)
    thread.start()
    yield Client(server.server_port, warnings)
    server.shutdown()
    server.server_close()
    thread.join()


def test_a_server_answers_its_own_page_only(client: Client) -> None:
    kind = "application/json"
    assert client.ask("GET", "/") == (200, '"page"')
    assert client.ask("POST", "/echo", "[1]", Content_Type=kind) == (200, "[1]")
    assert client.ask("GET", "/other")[0] == 404
    assert client.ask("POST", "/", "[1]", Content_Type=kind)[0] == 404
    assert client.ask("POST", "/no", "[1]", Content_Type=kind) == (400, "expected another value")
    assert client.ask("POST", "/echo", "[1]", Content_Type="text/plain")[0] == 400
    assert client.ask("POST", "/echo", "{", Content_Type=kind)[0] == 400
    assert client.ask("POST", "/echo", "[" * 100_000, Content_Type=kind)[0] == 400
    assert client.ask("POST", "/echo", Content_Type=kind, Content_Length="9" * 9)[0] == 400
    assert client.warnings == []
    assert (
        client.ask("POST", "/echo", "[1]", Content_Type=kind, Origin="http://a.example")[0] == 403
    )
    status, words = client.ask("GET", "/", Host="a.example")
    assert status == 403
    assert "from the page itself" in words
    assert len(client.warnings) == 2
    assert "found host 'a.example'" in client.warnings[1]


def test_a_port_in_use_is_refused(client: Client) -> None:
    with pytest.raises(DataError, match=f"expected a free port, found {client.port} in use"):
        start_server(client.port, {}, {}, print)
