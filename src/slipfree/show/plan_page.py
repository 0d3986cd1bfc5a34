"""Page for planning by hand: a map with handles, served by `slipfree.show.local_server`."""

from __future__ import annotations

import hashlib
import io
import json
from html import escape
from pathlib import Path
from typing import NamedTuple

from slipfree.routing.traversability import extents
from slipfree.show.ground_drawing import muted
from slipfree.show.local_server import Content, page_file
from slipfree.show.style import figure
from slipfree.terrain.base import Grid
from slipfree.vehicle.tree import Vehicle

PIXELS, DPI = 1600, 200  # length of the longer side of the map, and pixels per inch of its text


class PlanMap(NamedTuple):
    """Fixed contents of the page."""

    title: str
    file: Path
    frame: str  # frame of the headings
    grid: Grid
    vehicle: Vehicle
    way_points: tuple[tuple[str, float, float], ...] = ()  # name, x and y of way-points [m]


class PlanPage(NamedTuple):
    """Page for planning by hand, and its map."""

    identity: str  # text that differs between pages with different contents
    html: Content  # the HTML page, and the map as PNG
    image: Content


def plan_page(plan_map: PlanMap) -> PlanPage:
    """Return the page for planning by hand."""
    x_min, x_max, y_min, y_max = plan_map.grid.domain
    image = map_image(plan_map.grid)
    data = {
        "domain": [x_min, x_max, y_min, y_max],
        "reach": extents(plan_map.vehicle)[2],
        "north_heading": plan_map.frame == "paper",
        "file": _digest(str(plan_map.file.resolve()).encode(errors="backslashreplace")),
        "way_points": plan_map.way_points,
    }
    identity = _digest(image.body, json.dumps([data, plan_map.title]).encode())
    text = page_file("plan_page.html")
    script_safe = json.dumps({**data, "page": identity}).replace("<", "\\u003c")  # </script>
    html = text.replace("@TITLE@", escape(plan_map.title)).replace("@DATA@", script_safe)
    body = html.encode("utf-8", errors="backslashreplace")
    return PlanPage(identity, Content(body, "text/html; charset=utf-8"), image)


def _digest(*parts: bytes) -> str:
    return hashlib.sha256(b"".join(parts)).hexdigest()[:16]


def map_image(grid: Grid) -> Content:
    """Return the map with hillshade and contours as PNG; its edges are those of the ground."""
    x_min, x_max, y_min, y_max = grid.domain
    width, height = x_max - x_min, y_max - y_min
    scale = PIXELS / max(width, height) / DPI
    drawn = figure(max(width * scale, 0.1), max(height * scale, 0.1))
    drawn.set_layout_engine("none")
    ax = drawn.add_axes((0, 0, 1, 1))
    muted(grid, ax, grid.domain)
    ax.set_axis_off()
    ax.set(xlim=(x_min, x_max), ylim=(y_min, y_max), aspect="auto")
    stream = io.BytesIO()
    drawn.savefig(stream, dpi=DPI, format="png")
    return Content(stream.getvalue(), "image/png")
