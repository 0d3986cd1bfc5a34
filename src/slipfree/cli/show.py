"""``slipfree show``: look at results in space, in a browser, as a page or as a film."""

from __future__ import annotations

import os
import sys
import webbrowser
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from slipfree.cli.common import about, check_apart, check_page, check_place, reported
from slipfree.cli.voice import put_file, say, warn
from slipfree.errors import DataError
from slipfree.files import escape_name

if TYPE_CHECKING:
    from slipfree.show.climb_scene import Climbed
    from slipfree.show.drive_scene import Driven
    from slipfree.show.scene import Scene

Layer = Literal["height", "slope", "traversability"]


def show(
    files: Annotated[
        list[Path], typer.Argument(metavar="OUT.nc...", help="Result files, of one ground.")
    ],
    html: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="Save one page that plays by itself instead."),
    ] = None,
    animation: Annotated[
        Path | None, typer.Option(metavar="FILE.gif|.mp4", help="Save a film instead.")
    ] = None,
    color: Annotated[Layer, typer.Option(help="What colors the ground at first.")] = "height",
    folder: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Where files that the problem names are; default: beside the result, or here.",
        ),
    ] = None,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of the page; default: any free one.")
    ] = 0,
    browser: Annotated[bool, typer.Option(help="Open a browser.")] = True,
) -> None:
    """Show motions in a web page: ground, vehicles, contact points, slip and forces."""
    with reported():
        _check_places(files, html, animation)
        found = _read(files, folder)
        with about(files[0]):
            scene = _scene(found)
        for words in scene.warnings:
            warn(words)
        if animation is not None:
            _film(found, animation)
            put_file(animation)
        if html is not None:
            from slipfree.result_file import replaced
            from slipfree.show.viewer import page

            text = page(scene, _title(found), color)
            replaced(html, lambda part: _write(part, text))
            put_file(html)
            say(f"wrote {html}, {len(text) / 1e6:.1f} MB")
        if html is None and animation is None:
            from slipfree.show.viewer import serve

            serve(scene, _title(found), color, port, warn, lambda url: _ready(url, browser))


def _check_places(files: Sequence[Path], html: Path | None, animation: Path | None) -> None:
    """Refuse places that cannot be written to, before anything is computed."""
    if html is not None:
        check_page(html, files)
    if animation is not None:
        from slipfree.show.film import FRAMES, film_writer

        check_apart(animation, files)
        film_writer(animation, FRAMES)
        check_place(animation)


def _write(part: Path, text: str) -> None:
    part.write_text(text, encoding="utf-8", errors="backslashreplace")  # names of files


def _read(files: Sequence[Path], folder: Path | None) -> list[Driven] | list[Climbed]:
    from slipfree.problem.shown import shown
    from slipfree.show.climb_scene import Climbed
    from slipfree.show.drive_scene import Driven

    found = []
    for file, name in zip(files, _names(files), strict=True):
        with about(file):
            found.append(shown(file, name, folder))
    driven = [each for each in found if isinstance(each, Driven)]
    climbed = [each for each in found if isinstance(each, Climbed)]
    if driven and climbed:
        raise DataError("show: expected motions over terrain or climbs alone, found both")
    return driven or climbed


def _names(files: Sequence[Path]) -> list[str]:
    """Return the names of files as far as they tell them apart."""
    names = [file.stem for file in files]
    names = names if len({*names}) == len(names) else [str(file) for file in files]
    return [escape_name(name) for name in names]


def _scene(found: list[Driven] | list[Climbed]) -> Scene:
    from slipfree.show.climb_scene import Climbed, climb_scene
    from slipfree.show.drive_scene import drive_scene

    climbs = [each for each in found if isinstance(each, Climbed)]
    if climbs:
        return climb_scene(climbs)
    return drive_scene([each for each in found if not isinstance(each, Climbed)])


def _title(found: list[Driven] | list[Climbed]) -> str:
    return found[0].run.attributes.get("title", found[0].name)


def _film(found: list[Driven] | list[Climbed], file: Path) -> None:
    from slipfree.show.animate import animate_drives
    from slipfree.show.climb import animate
    from slipfree.show.climb_scene import Climbed

    climbs = [each for each in found if isinstance(each, Climbed)]
    if len(climbs) > 1:
        raise DataError(f"--animation: expected one climb, found {len(climbs)}")
    if climbs:
        animate(climbs[0].run, climbs[0].climber, climbs[0].profile, file)
        say(f"wrote {file}")
        return
    words = animate_drives([each for each in found if not isinstance(each, Climbed)], file)
    say(f"wrote {file}, {words}")


def _ready(url: str, browser: bool) -> None:
    """Say where the page is, however quiet all else is, and open it if somebody can see it."""
    say(f"{url} shows it; Ctrl-C ends it", err=True)
    seen = sys.platform in ("darwin", "win32") or any(
        os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")
    )
    if browser and seen:
        webbrowser.open(url)
