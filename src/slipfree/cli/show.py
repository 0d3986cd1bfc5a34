"""``slipfree show``: show results in a browser, or save them as a page or an animation."""

from __future__ import annotations

import atexit
import os
import sys
import tempfile
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from slipfree.cli.common import InputFolder, about, reported
from slipfree.cli.messages import add_json_file, print_line, warn
from slipfree.cli.outputs import check_outputs, check_page
from slipfree.system.regular_files import escape_name

if TYPE_CHECKING:
    from slipfree.show.scene import Scene

Layer = Literal["height", "slope", "traversability"]


def show(
    files: Annotated[
        list[Path], typer.Argument(metavar="OUT.nc", help="Result files on the same ground.")
    ],
    html: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Save a self-contained page instead."),
    ] = None,
    animation: Annotated[
        Path | None, typer.Option(metavar="FILE.gif|.mp4", help="Save an animation instead.")
    ] = None,
    color: Annotated[
        Layer,
        typer.Option(metavar="LAYER", help="Initial colours: height, slope or traversability."),
    ] = "height",
    folder: InputFolder = None,
    port: Annotated[
        int,
        typer.Option(metavar="PORT", min=0, max=65535, help="Port of the page; 0: any free port."),
    ] = 0,
    browser: Annotated[bool, typer.Option(help="Open a browser.")] = True,
) -> None:
    """Show motions in a web page, or save a page or an animation.

    The page shows ground, vehicles, contact points, slip and forces in three dimensions.
    """
    with reported():
        _check_outputs(files, html, animation)
        from slipfree.show.drive_scene import drive_scene

        found = _read(files, folder)
        with about(files[0]):
            scene = drive_scene(found)
        for words in scene.warnings:
            warn(words)
        if animation is not None:
            _film(scene, _title(found), animation)
            add_json_file(animation)
        if html is not None:
            from slipfree.show.viewer import page
            from slipfree.system.atomic_files import replace_file

            text = page(scene, _title(found), color)
            replace_file(html, lambda part: _write(part, text))
            add_json_file(html)
            print_line(f"wrote {html}, {len(text) / 1e6:.1f} MB")
        if html is None and animation is None:
            from slipfree.show.viewer import serve

            serve(scene, _title(found), color, port, warn, lambda url: open_page(url, browser))


def _check_outputs(files: Sequence[Path], html: Path | None, animation: Path | None) -> None:
    """Raise DataError for a page or an animation that cannot be written."""
    if html is not None:
        check_page(html, files)
    if animation is not None:
        from slipfree.show.film import FRAMES, film_writer

        check_outputs([html, animation], files)
        film_writer(animation, FRAMES)


def _write(part: Path, text: str) -> None:
    part.write_text(
        text, encoding="utf-8", errors="backslashreplace"
    )  # file names may have invalid characters


def _read(files: Sequence[Path], folder: Path | None) -> list[Any]:
    """Return the motions in the result files."""
    from slipfree.problem.load import verb_of
    from slipfree.problem.result import open_result
    from slipfree.show.thinning import SCENE_SAMPLES

    results, found = [], []
    for file in files:
        with about(file):
            results.append(open_result(file, folder, samples=SCENE_SAMPLES))
    models = [str(each.trajectory.attributes.get("model", "")) for each in results]
    names = _named_by_model(_names(files), models)
    for file, name, result in zip(files, names, results, strict=True):
        with about(file):
            found.append(verb_of(result.problem).shown(result, name))
    return found


def _names(files: Sequence[Path]) -> list[str]:
    """Return the file names without suffix, or the whole paths if names coincide."""
    names = [file.stem for file in files]
    names = names if len({*names}) == len(names) else [str(file) for file in files]
    return [escape_name(name) for name in names]


def _named_by_model(names: Sequence[str], models: Sequence[str]) -> list[str]:
    """Return names with the models of the motions if these differ."""
    if len({*models}) == 1:
        return [*names]
    return [
        f"{name} ({model})" if model else name for name, model in zip(names, models, strict=True)
    ]


def _title(found: Sequence[Any]) -> str:
    title: str = found[0].run.attributes.get("title", found[0].name)
    return title


def _film(scene: Scene, title: str, file: Path) -> None:
    from slipfree.show.film import animate

    print_line(f"wrote {file}, {animate(scene, file, title)}")


def open_page(url: str, browser: bool, does: str = "shows the motions") -> None:
    """Print the address of the page, and open it if ``browser`` is set and a display exists.

    The browser gets the name of a private file that redirects to the address, since other users of
    the machine can read the arguments of its process.
    """
    print_line(f"{url} {does}; Ctrl-C ends the server", err=True)
    seen = sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
    if browser and seen:
        descriptor, name = tempfile.mkstemp(".html", "slipfree-")  # readable by its owner only
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(f'<meta http-equiv="refresh" content="0; url={url}">')
        atexit.register(Path(name).unlink, missing_ok=True)
        webbrowser.open(Path(name).as_uri())
