"""Page for planning by hand: a map with handles, served by `slipfree.show.local_server`."""

from __future__ import annotations

import io
import json
from html import escape
from importlib.resources import files
from typing import NamedTuple

from slipfree.routing.traversability import extents
from slipfree.show.ground_drawing import muted, whole
from slipfree.show.local_server import Content
from slipfree.show.style import figure
from slipfree.terrain.base import Grid
from slipfree.vehicle.tree import Vehicle

PIXELS, DPI = 1600, 200  # length of the longer side of the map, and pixels per inch of its text


class PlanMap(NamedTuple):
    """Fixed contents of the page.

    Attributes
    ----------
    title : str
        Title of the problem.
    file : str
        Name of the problem file.
    frame : {"paper", "rep103"}
        Frame of the headings.
    grid : Grid
        The ground.
    vehicle : Vehicle
        The vehicle.
    way_points : tuple of (str, float, float)
        Name, x and y of way-points. [m]
    """

    title: str
    file: str
    frame: str
    grid: Grid
    vehicle: Vehicle
    way_points: tuple[tuple[str, float, float], ...] = ()


def page_content(plan_map: PlanMap) -> Content:
    """Return the HTML page for planning by hand."""
    x_min, x_max, y_min, y_max = whole(plan_map.grid)
    data = {
        "domain": [x_min, x_max, y_min, y_max],
        "reach": extents(plan_map.vehicle)[2],
        "north_heading": plan_map.frame == "paper",
        "file": plan_map.file,
        "way_points": plan_map.way_points,
    }
    text = files("slipfree.show").joinpath("plan_page.html").read_text("utf-8")
    script_safe = json.dumps(data).replace("<", "\\u003c")  # file names may contain </script>
    html = text.replace("@TITLE@", escape(plan_map.title)).replace("@DATA@", script_safe)
    return Content(html.encode("utf-8", errors="backslashreplace"), "text/html; charset=utf-8")


def map_image(grid: Grid) -> Content:
    """Return the map with hillshade and contours as PNG; its edges are those of the ground."""
    x_min, x_max, y_min, y_max = whole(grid)
    width, height = x_max - x_min, y_max - y_min
    scale = PIXELS / max(width, height) / DPI
    drawn = figure(max(width * scale, 0.1), max(height * scale, 0.1))
    drawn.set_layout_engine("none")
    ax = drawn.add_axes((0, 0, 1, 1))
    muted(grid, ax, whole(grid))
    ax.set_axis_off()
    ax.set(xlim=(x_min, x_max), ylim=(y_min, y_max), aspect="auto")
    stream = io.BytesIO()
    drawn.savefig(stream, dpi=DPI, format="png")
    return Content(stream.getvalue(), "image/png")
