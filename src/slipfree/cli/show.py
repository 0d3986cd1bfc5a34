"""Pages: ``slipfree show`` plays results, ``report`` describes one, ``edit`` plans by hand."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from slipfree.cli import console
from slipfree.cli.console import ResultFile, Trust, output_option
from slipfree.cli.outputs import PAGES, PICTURES, Picture, check_outputs, open_page, save_picture
from slipfree.core.errors import DataError, require
from slipfree.system.interrupt import interrupt_arrived
from slipfree.system.regular_files import escape_name, regular_file, replace_file

if TYPE_CHECKING:
    from slipfree.problem.plan_edit import Document
    from slipfree.show.html_page import PlanPage

Layer = Literal["height", "slope", "traversability"]
Port = Annotated[
    int, typer.Option(metavar="PORT", min=0, max=65535, help="Port of the page; 0: any free port.")
]
Browser = Annotated[bool, typer.Option(help="Open a browser.")]
STEP = 0.05  # longest time between steps of the session [s]


def show(
    files: Annotated[list[Path], typer.Argument(metavar="OUT.nc")],
    html: Annotated[Path | None, typer.Option(metavar="FILE.html")] = None,
    animation: Annotated[Path | None, typer.Option(metavar="FILE.mp4|.gif")] = None,
    picture: Picture = None,
    time: Annotated[float | None, typer.Option("--at", metavar="SECONDS")] = None,
    color: Annotated[Layer, typer.Option(metavar="LAYER")] = "height",
    port: Port = 0,
    browser: Browser = True,
) -> None:
    """Show motions in a web page, or save a film or a picture.

    The page shows ground, vehicles, contact points, slip and forces in three dimensions.

    Parameters
    ----------
    files : list of path
        Result files on the same ground.
    html : path, optional
        Save a self-contained page instead.
    animation : path, optional
        Save an animation instead.
    time : float, optional
        Time of the picture; default: the end.
    color : {"height", "slope", "traversability"}
        Initial colours: height, slope or traversability, which is that of poses and takes a
        while.
    """
    check_outputs([html], files, endings=PAGES)
    if animation is not None:
        from slipfree.show.film import FRAMES, film_writer

        check_outputs([html, animation], files)
        film_writer(animation, FRAMES)
    check_outputs([picture], files, endings=PICTURES)
    if has_page := html is not None or (animation is None and picture is None):
        require("viser", "view", "show: ")
    from slipfree.core.trajectory import SCENE_SAMPLES
    from slipfree.problem.load import verb_of
    from slipfree.problem.result import open_result
    from slipfree.show.scene import drive_scene

    results, motions = list[Any](), list[Any]()
    for file in files:
        with console.about(file):
            results.append(open_result(file, samples=SCENE_SAMPLES))
    # names that differ
    models = [str(each.trajectory.attributes.get("model", "")) for each in results]
    names = [file.stem for file in files]
    if len({*names}) < len(names):
        names = [str(file) for file in files]
    names = [escape_name(name) for name in names]
    if len({*models}) > 1:
        names = [f"{n} ({model})" if model else n for n, model in zip(names, models, strict=True)]
    for file, name, result in zip(files, names, results, strict=True):
        with console.about(file):
            motions.append(verb_of(result.problem).shown(result, name))
    title = motions[0].run.attributes.get("title", motions[0].name)
    with console.about(files[0]):
        scene = drive_scene(motions, with_poses=color == "traversability")
    first, last = scene.span
    if time is not None and picture is None:
        raise DataError("--at: expected --picture with it, found none; add it, or omit --at")
    if time is not None and not first <= time <= last:
        raise DataError(
            f"--at: expected a time from {first:g} to {last:g} s, those of the motions, found "
            f"{time:g} s; choose a time in this range"
        )
    for words in scene.warnings:
        console.warn(words)
    if animation is not None:
        from slipfree.show.film import animate

        with console.counted("frames") as progress:
            speed = animate(scene, animation, title, progress)
        console.print_written(animation, f", {speed}")
    if has_page:
        from slipfree.show.viewer import page, serve

        text = page(scene, title, color)
        if html is None:
            serve(text, port, console.warn, lambda url: open_page(url, browser))
        else:
            _write_page(html, text, f", {len(text) / 1e6:.1f} MB")
    if picture is not None:
        from slipfree.show.film import picture as drawn

        save_picture(drawn(scene, title, time), picture)


def _write_page(file: Path, text: str, more: str = "") -> None:
    more += ", which replaces the earlier file" * file.exists()
    # file names in the text may have invalid characters
    replace_file(file, lambda part: part.write_text(text, "utf-8", "backslashreplace"))
    console.print_written(file, more)


def report(file: ResultFile, out: Annotated[Path | None, output_option("OUT.html")] = None) -> None:
    """Write a result as one HTML page.

    The page has facts, checks, figures, the problem file and versions.

    Parameters
    ----------
    out : path, optional
        Page to write; default: OUT.html.
    """
    with console.about(file):
        from slipfree.problem.report import report as made
        from slipfree.show.html_page import page

        with regular_file(file, "a result file of slipfree"):
            target = out or file.with_suffix(".html")
        check_outputs([target], [file], endings=PAGES)
        found = made(file)
        console.detail(f"made {len(found.figures)} figures of {file}")
        if found.note and not found.figures:
            console.warn(found.note)
        with console.counted("figures") as progress:
            text = page(found, progress)
        _write_page(target, text)


def edit(
    file: Annotated[Path, typer.Argument(metavar="FILE")],
    port: Port = 0,
    browser: Browser = True,
    trust: Trust = None,
) -> None:
    """Plan by hand on a map in a web page.

    Drag start, goal and keep-out regions. The page shows the search while it runs and compares the
    plan with the last one. It saves the start, goal and regions to the problem file.

    Parameters
    ----------
    file : path
        Planning problem (TOML).
    """
    from slipfree.files.urdf.xacro import trusted_paths
    from slipfree.problem.build_ground import build_ground
    from slipfree.problem.build_vehicle import build_vehicle
    from slipfree.problem.plan_edit import PLACES, Desk, read_document, state_of, way_points_in
    from slipfree.show.html_page import plan_page
    from slipfree.show.local_server import Gate, json_content, start_server

    last: tuple[object, PlanPage] | None = None

    def draw(document: Document) -> PlanPage:
        """Return the page of a document; it is drawn again only if a key outside `PLACES` changed.

        The places (start, goal, way-points, regions) are drawn by the browser.
        """
        nonlocal last
        problem = document.problem
        spec, file = problem.spec, document.path
        others = spec.model_dump(exclude={*PLACES})
        if last is None or last[0] != others:
            drawn = build_ground(problem).grid, build_vehicle(problem)
            more: dict[str, Any] = {"way_points": way_points_in(problem)}
            more["north_heading"] = spec.frame == "paper"  # else headings count from the x axis
            last = others, plan_page(spec.title or file.stem, file, *drawn, **more)
        return last[1]

    desk = Desk(read_document(file, trusted_paths(trust or [])), draw)
    get = {
        "/": lambda: desk.session.page.html,
        "/map.png": lambda: desk.session.page.image,
        "/state": lambda: json_content(state_of(desk.session)),
    }
    post = {f"/{name}": desk.accept(name) for name in ("plan", "cancel", "save")}
    gate = Gate("slipfree edit", console.warn)
    server = start_server(port, get, post, gate)
    threading.Thread(target=server.serve_forever, args=(STEP,), daemon=True).start()
    try:
        open_page(gate.url(server.server_port), browser, "edits the plan")
        while True:
            desk.step(STEP)
    except KeyboardInterrupt:
        interrupt_arrived()
    finally:
        desk.close()
        server.shutdown()
        server.server_close()
