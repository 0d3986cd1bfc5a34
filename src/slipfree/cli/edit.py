"""``slipfree edit``: plan by hand on a map in a browser."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from slipfree.cli.common import Trust, reported
from slipfree.cli.messages import warn
from slipfree.cli.show import open_page

if TYPE_CHECKING:
    from slipfree.problem.plan_edit import Document
    from slipfree.show.plan_page import PlanPage

STEP = 0.05  # longest time between steps of the session [s]


def edit(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Planning problem (TOML).")],
    port: Annotated[
        int,
        typer.Option(metavar="PORT", min=0, max=65535, help="Port of the page; 0: any free port."),
    ] = 0,
    browser: Annotated[bool, typer.Option(help="Open a browser.")] = True,
    trust: Trust = None,
) -> None:
    """Plan by hand: drag start, goal and keep-out regions on a map in a web page.

    The page shows the search while it runs and compares the plan with the last one. It saves the
    start, goal and regions to the problem file.
    """
    with reported():
        _serve(file, port, trust or [], browser=browser)


def _serve(file: Path, port: int, trust: list[Path], *, browser: bool) -> None:
    """Serve the page of a problem until Ctrl-C."""
    from slipfree.files.urdf.xacro import trusted_paths
    from slipfree.problem.plan_edit import read_document
    from slipfree.problem.plan_session import Desk, state_of
    from slipfree.show.guard import Gate
    from slipfree.show.local_server import json_content, start_server

    desk = Desk(read_document(file, trusted_paths(trust)), _page_drawer())
    get = {
        "/": lambda: desk.session.page.html,
        "/map.png": lambda: desk.session.page.image,
        "/state": lambda: json_content(state_of(desk.session)),
    }
    post = {f"/{name}": desk.accept(name) for name in ("plan", "cancel", "save")}
    gate = Gate("slipfree edit", warn)
    server = start_server(port, get, post, gate)
    thread = threading.Thread(target=server.serve_forever, args=(STEP,), daemon=True)
    thread.start()
    try:
        open_page(gate.url(server.server_port), browser, "edits the plan")
        with suppress(KeyboardInterrupt):
            while True:
                desk.step(STEP)
    finally:
        desk.close()
        server.shutdown()
        server.server_close()


def _page_drawer() -> Callable[[Document], PlanPage]:
    """Return a function that draws the page of a document, again only if other keys changed."""
    from slipfree.problem.build import build_vehicle
    from slipfree.problem.build_ground import at, build_ground
    from slipfree.problem.plan_edit import PLACES, way_points_in
    from slipfree.show.plan_page import PlanMap, plan_page

    last: tuple[object, PlanPage] | None = None

    def draw(document: Document) -> PlanPage:
        nonlocal last
        problem = document.problem
        spec, file = problem.spec, document.path
        others = spec.model_dump(exclude={*PLACES})
        if last is None or last[0] != others:
            ground = build_ground(problem)
            with at(problem, ("vehicle",)):
                vehicle = build_vehicle(spec.vehicle, problem)
            title, way_points = spec.title or file.stem, way_points_in(problem)
            plan_map = PlanMap(title, file, spec.frame, ground.grid, vehicle, way_points)
            last = others, plan_page(plan_map)
        return last[1]

    return draw
