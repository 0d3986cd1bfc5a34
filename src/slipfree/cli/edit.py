"""``slipfree edit``: plan by hand on a map in a browser."""

from __future__ import annotations

import threading
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from slipfree.cli.common import Trust, read_problem, reported
from slipfree.cli.messages import warn
from slipfree.cli.show import open_page
from slipfree.errors import DataError

if TYPE_CHECKING:
    from slipfree.problem.problem import Problem

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
        problem = read_problem(file, None, trust)
        if problem.spec.verb != "plan":
            raise DataError(
                f"{file}: expected a problem with verb = 'plan', found verb = "
                f"{problem.spec.verb!r}; use slipfree run"
            )
        _serve(problem, port, browser=browser)


def _serve(problem: Problem[Any], port: int, *, browser: bool) -> None:
    """Serve the page of a problem until Ctrl-C."""
    from slipfree.problem.build_common import build_vehicle
    from slipfree.problem.build_ground import at, build_ground
    from slipfree.problem.plan_edit import places_in, way_points_in
    from slipfree.problem.plan_session import Desk, open_session, state_of
    from slipfree.show.guard import HOST
    from slipfree.show.local_server import json_content, start_server
    from slipfree.show.plan_page import PlanMap, map_image, page_content

    ground, source = build_ground(problem), problem.source
    with at(problem, ("vehicle",)):
        vehicle = build_vehicle(problem.spec.vehicle, problem)
    title = problem.spec.title or source.path.stem
    plan_map = PlanMap(
        title, source.path.name, problem.spec.frame, ground.grid, vehicle, way_points_in(problem)
    )
    image, html = map_image(ground.grid), page_content(plan_map)
    desk = Desk(open_session(source.path, source.text, places_in(problem), problem.trusted))
    get = {
        "/": lambda: html,
        "/map.png": lambda: image,
        "/state": lambda: json_content(state_of(desk.session)),
    }
    post = {f"/{name}": desk.accept(name) for name in ("plan", "cancel", "save")}
    server = start_server(port, get, post, warn)
    thread = threading.Thread(target=server.serve_forever, args=(STEP,), daemon=True)
    thread.start()
    try:
        open_page(f"http://{HOST}:{server.server_port}", browser, "edits the plan")
        with suppress(KeyboardInterrupt):
            while True:
                desk.step(STEP)
    finally:
        desk.close()
        server.shutdown()
        server.server_close()
