"""HTML of the legend of a scene, of the report of a result, and of the page for planning by hand.

A report is one page without scripts, whose content security policy forbids all requests. Its
figures are vector graphics; large ones become raster graphics. The page for planning is a map with
handles, served by `slipfree.show.local_server`.
"""

from __future__ import annotations

import hashlib
import json
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.ndimage import uniform_filter

from slipfree.core.records import html_table
from slipfree.routing.traversability import free_space
from slipfree.show import style
from slipfree.show.ground_drawing import Window, muted
from slipfree.show.local_server import Content, page_file
from slipfree.show.plots import Plot, draw
from slipfree.show.scene import WORLD, Color, Layer, Scene
from slipfree.show.style import DPI, RISK, STEEP, STYLE, figure
from slipfree.terrain.base import Grid, axis_step
from slipfree.terrain.bicubic import Bicubic
from slipfree.vehicle.tree import Vehicle

SAVED_KEYS = "Keys: space: play or pause; left, right: step; home, end: first and last time."
MOST = 400_000  # larger vector graphics become raster graphics [bytes]
PIXELS, LEAST = 120, 0.62  # pixels of the page per inch of a figure; its smallest scale on phones
VECTOR = {"svg.fonttype": "path", "svg.hashsalt": "slipfree"}  # for reproducible pages
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
MAP_PIXELS, MAP_DPI = 1600, 400  # longer side of the map for planning, pixels per inch of its text
INSET_PIXELS = 400  # longer side of the map on a page whose camera follows the vehicle

NODES = 400  # largest number of nodes of the tilt along an axis of the map
FORBIDDEN = 255  # tilt at which a wheel could reach the edge of the map or a hole


def with_legend(
    html: str, scene: Scene, title: str, color: str, colored: str, words: Iterable[str]
) -> str:
    """Return a page exported by viser with title, legend, plots and notes.

    Motions of the scene have the times of the page. ``color`` names a layer of the ground,
    ``colored`` one of the tracks, or none.
    """
    switches = ""
    for entry in scene.entries:
        names, css = escape("|".join(entry.nodes)), _css(entry.color)
        look = "swatch ghost" if entry.ghost else "swatch"
        stop = f'<div class="warning">{escape(entry.stop)}</div>' if entry.stop else ""
        switches += (
            f'<label><input type="checkbox" checked data-nodes="{names}">'
            f'<span><span class="{look}" style="color:{css};background:{css}"></span>'
            f"{escape(entry.label)}{stop}</span></label>"
        )
    warned = "".join(f'<p class="warning">{escape(each)}</p>' for each in scene.warnings)
    notes = "".join(f"<p>{escape(note)}</p>" for note in (*scene.notes, SAVED_KEYS))
    grounds = {each.name: (each, [f"{WORLD}/ground {each.name}"]) for each in scene.ground.layers}
    tracks: dict[str, tuple[Layer | None, list[str]]] = {"as the vehicle": (None, [])}
    for k, actor in enumerate(scene.actors, 1):
        for layer in scene.track_layers(actor):
            _, nodes = tracks.setdefault(layer.name, (layer, []))
            nodes.append(f"{WORLD}/run {k}/tracks/{layer.name}")
    size = float(np.linalg.norm(np.ptp(scene.paths, axis=0)))
    # the camera follows the vehicle; the button shows the whole path
    paths = "|".join(f"{WORLD}/run {k}/tracks/path" for k, _ in enumerate(scene.actors, 1))
    overview = f'<button data-size="{size:.4g}" data-nodes="{paths}">overview</button>'
    box = (
        f'<style>{page_file("viewer.css")}</style><div id="slipfree"><b>{escape(title)}</b>'
        f"<div>{escape(' '.join(words))}</div>"
        f"{_choice('ground', grounds, color)}{_choice('tracks', tracks, colored)}"
        f"{overview * scene.is_far}{switches}{warned}"
        f"<details><summary>notes</summary>{notes}</details></div>"
        f'<div id="plots">{_plots(scene)}</div>{_inset(scene) if scene.is_far else ""}'
        f"<script>{page_file('viewer_keys.js')}{page_file('viewer_saved.js')}</script>"
    )
    html = html.replace("<title>Viser</title>", f"<title>{escape(title)}</title>", 1)
    end = html.rindex("</body>")
    return html[:end] + box + html[end:]


def _choice(
    name: str, layers: Mapping[str, tuple[Layer | None, Sequence[str]]], chosen: str
) -> str:
    """Return HTML to choose a colouring, each with the nodes that show it.

    ``layers`` has the colouring (None without colours) and the names of its nodes in the scene, by
    the key; ``chosen`` is the key that is shown first.
    """
    options, legends = "", ""
    for key, (layer, nodes) in layers.items():
        at = f"{name}-{key}"
        is_chosen = key == chosen
        options += (
            f'<option value="{escape(at)}" data-nodes="{escape("|".join(nodes))}"'
            f"{' selected' if is_chosen else ''}>{escape(style.words(key))}</option>"
        )
        shown = ""
        if layer:
            stops = ",".join(map(_css, layer.scale))
            look = f"background:linear-gradient(to right,{stops})"
            shown = f'<div class="scale" style="{look}"></div>'
            shown += f"<div>{escape(style.words(layer.name))}: {escape(layer.legend)}</div>"
        legends += f'<div id="{escape(at)}"{"" if is_chosen else " hidden"}>{shown}</div>'
    return f"<div>{name} <select>{options}</select></div>{legends}"


def _plots(scene: Scene) -> str:
    """Return HTML of the plots over time of a scene; vertices of lines are values at the frames."""
    names, plots = dict[str, str](), ""
    for each, (low, high) in scene.plotted.items():
        now, drawn, size = "", "", 0
        for name, color, _, values in scene.curves(each):
            names[name], size = color, values.size
            shown = np.clip(np.nan_to_num(values, nan=low), low, high).round(9)
            points = " ".join(f"{k},{value:.4g}" for k, value in enumerate(shown))
            now += f' <b style="color:{color}"></b>'
            drawn += f'<polyline stroke="{color}" points="{points}"/>'
        plots += (
            f"<div>{escape(style.words(each.name))}, {each.words(low, high)}:{now}</div>"
            f'<svg preserveAspectRatio="none" viewBox="0 {-high} {size - 1} {high - low}">'
            f'<g transform="scale(1,-1)">{drawn}<line y1="{low}" y2="{high}"/></g></svg>'
        )
    if not plots:
        return ""
    first, last = scene.span
    lines = " ".join(f'<b style="color:{color}">{escape(n)}</b>' for n, color in names.items())
    ends = f"<span>{round(first, 2):g} s</span><b></b><span>{round(last, 2):g} s</span>"
    return f'{lines}{plots}<div data-first="{first}" data-last="{last}">{ends}</div>'


def _inset(scene: Scene) -> str:
    """Return HTML of a small map of all paths; their vertices are the positions at the frames."""
    west, east, south, north = window = scene.backdrop.window
    wide, high = east - west, north - south
    ground = _uri(_bare_map(scene.backdrop.draw, window, INSET_PIXELS, DPI), "png")
    drawn = f'<image href="{ground}" width="{wide:.6g}" height="{high:.6g}"/>'
    for actor in scene.actors:
        x, y, _ = (actor.bodies[0].origins + scene.origin).T
        points = " ".join(f"{a:.6g},{b:.6g}" for a, b in zip(x - west, north - y, strict=True))
        drawn += f'<polyline points="{points}"/><circle r="2.5%" fill="{_css(actor.color)}"/>'
    drawn = f'<svg viewBox="0 0 {wide:.6g} {high:.6g}">{drawn}</svg>'
    return f'<div id="map">{drawn}{wide:.4g} x {high:.4g} m, north is up</div>'


def _css(color: Color) -> str:
    return "rgb({},{},{})".format(*color)


class Report(NamedTuple):
    """Contents of a page, in their order."""

    title: str
    lead: str  # sentence on the outcome of the motion
    good: bool  # whether the motion is complete
    main: Sequence[tuple[str, ...]]  # main facts, beside the first figure
    tables: Mapping[str, Sequence[tuple[str, ...]]]  # by heading; names may be indented
    figures: Sequence[Plot]  # the first one is shown above the tables
    note: str  # why there are no figures
    texts: Mapping[str, str]  # preformatted, by heading


def page(report: Report, progress: Callable[[int, int], object] | None = None) -> str:
    """Return a report as a self-contained HTML page without scripts."""
    figures = list[str]()
    for plot in report.figures:
        caption, (drawn,) = escape(plot.caption), draw([plot]).values()
        width = PIXELS * float(drawn.get_figwidth())
        size = f'width="{width:.0f}" style="min-width:{LEAST * width:.0f}px"'
        figures.append(
            f'<figure><img alt="{caption}" {size} src="{image(drawn)}">'
            f"<figcaption>{caption}</figcaption></figure>\n"
        )
        if progress is not None:
            progress(len(figures), len(report.figures))
    tables = {name: html_table(rows) for name, rows in report.tables.items() if rows}
    texts = {name: f"<pre>{escape(text)}</pre>" for name, text in report.texts.items()}
    others = f'<div class="columns">{"".join(figures[1:])}</div>'
    sections = {**({"Figures": others} if figures[1:] else {}), **tables, **texts}
    lines = [
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">',
        '<meta name="viewport" content="width=device-width, initial-scale=1">',
        '<link rel="icon" href="data:,">',
        f"<title>{escape(report.title)}</title>\n<style>{page_file('report.css')}</style>\n</head>\n<body>",
        f"<h1>{escape(report.title)}</h1>",
        f'<p class="lead{"" if report.good else " bad"}">{escape(report.lead)}</p>',
        f'<div class="columns">{html_table(report.main)}{"".join(figures[:1])}</div>',
        f"<p>{escape(report.note)}</p>" if report.note else "",
        *(
            f"<details>\n<summary>{escape(name)}</summary>\n{content}\n</details>"
            for name, content in sections.items()
        ),
        "</body>\n</html>\n",
    ]
    return "\n".join(lines)


def image(figure: Figure) -> str:
    """Return a figure as a data URI: SVG, or PNG if the SVG exceeds 400 000 bytes."""
    drawn, kind = _written(figure, "svg"), "svg+xml"
    if len(drawn) > MOST:
        drawn, kind = _written(figure, "png"), "png"
    return _uri(drawn, kind)


def _uri(drawn: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{b64encode(drawn).decode()}"


def _written(figure: Figure, ending: str, dpi: int = DPI) -> bytes:
    file = BytesIO()
    metadata = {"Date": None} if ending == "svg" else None
    with rc_context(STYLE | VECTOR):  # type: ignore[arg-type]  # its keys are a literal type
        figure.savefig(file, format=ending, dpi=dpi, metadata=metadata)
    return file.getvalue()


class PlanPage(NamedTuple):
    """Page for planning by hand, and its map."""

    identity: str  # text that differs between pages with different contents
    html: Content  # the HTML page, and the map as PNG
    image: Content


def plan_page(title: str, file: Path, grid: Grid, vehicle: Vehicle, **more: object) -> PlanPage:
    """Return the page for planning by hand; ``more`` are further data of its script, as JSON.

    The page shows the tilt of the ground, averaged over the size of the vehicle, in degrees.
    """
    image = map_image(grid)
    layers = free_space(terrain := Bicubic(grid), vehicle)
    every = 1 + max(layers.to_hole.shape) // NODES
    x, y = layers.x[::every], layers.y[::every]
    size = [max(1, round(2 * layers.limits.half / axis_step(axis))) for axis in (y, x)]
    z = uniform_filter(terrain.elevation(x, y[:, None]), size, mode="nearest")
    tilt = np.degrees(np.arctan(np.hypot(*np.gradient(z, y, x)))).round()
    tilt[np.isinf(layers.least_cost[::every, ::every].T)] = FORBIDDEN
    data = {
        "domain": grid.domain,
        "reach": layers.limits.reach,
        "tilt": {
            "x": (x[0], x[-1], x.size),
            "y": (y[0], y[-1], y.size),
            "values": b64encode(tilt.astype(np.uint8).tobytes()).decode(),
            "color": RISK(np.linspace(0, 1, round(STEEP) + 1), bytes=True)[:, :3].tolist(),
        },
        "file": _digest(str(file.resolve()).encode(errors="backslashreplace")),
        **more,
    }
    identity = _digest(image.body, json.dumps([data, title]).encode())
    text = page_file("plan_page.html")
    script_safe = json.dumps({**data, "page": identity}).replace("<", "\\u003c")  # </script>
    html = text.replace("@TITLE@", escape(title)).replace("@DATA@", script_safe)
    body = html.encode("utf-8", errors="backslashreplace")
    return PlanPage(identity, Content(body, "text/html; charset=utf-8"), image)


def _digest(*parts: bytes) -> str:
    return hashlib.sha256(b"".join(parts)).hexdigest()[:16]


def map_image(grid: Grid) -> Content:
    """Return the map with hillshade and contours as PNG; its edges are those of the ground."""
    draw = partial(muted, grid, window=grid.domain)
    return Content(_bare_map(draw, grid.domain, MAP_PIXELS, MAP_DPI), "image/png")


def _bare_map(draw: Callable[[Axes], Any], window: Window, pixels: int, dpi: int) -> bytes:
    """Return a map without margins as PNG, with ``pixels`` along its longer side."""
    west, east, south, north = window
    scale = pixels / max(east - west, north - south) / dpi
    drawn = figure(max((east - west) * scale, 0.1), max((north - south) * scale, 0.1))
    drawn.set_layout_engine("none")
    ax = drawn.add_axes((0, 0, 1, 1))
    draw(ax)
    ax.set_axis_off()
    ax.set(xlim=(west, east), ylim=(south, north), aspect="auto")
    return _written(drawn, "png", dpi)
