"""Legend of a scene in a web page: colours and arrows."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

from slipfree.show.scene import ARROWS, Color, Layer, Scene, scale_words

BOX = (
    "position:fixed;left:8px;bottom:52px;z-index:2;max-width:22em;padding:6px 10px;"
    "font:12px/1.4 sans-serif;color:#222;background:rgba(255,255,255,.85);border-radius:4px"
)
HOLLOW = "background:none;border:2px dotted"
SQUARE = "display:inline-block;width:12px;height:12px;margin-right:6px"
WARNING = "color:#a00"


def legend(layer: Layer) -> str:
    """Return HTML that shows the scale of a layer of the ground."""
    stops = ",".join(map(_css, layer.scale))
    return (
        f'<div style="height:10px;background:linear-gradient(to right,{stops})"></div>'
        f"<div>{escape(layer.name)}: {escape(layer.legend)}</div>"
    )


def swatch(color: Color, words: str = "", *, ghost: bool = False) -> str:
    """Return HTML of a coloured square with text; with a dotted border for wireframes."""
    look = f"{HOLLOW} {_css(color)}" if ghost else f"background:{_css(color)}"
    return f'<div><span style="{SQUARE};{look}"></span>{escape(words)}</div>'


def warned(scene: Scene) -> str:
    """Return the HTML of the warnings of a scene."""
    return "".join(f'<p style="{WARNING}">{escape(each)}</p>' for each in scene.warnings)


def with_legend(html: str, scene: Scene, title: str, color: str, words: Iterable[str]) -> str:
    """Return a page that plays a scene with title and legend added.

    Parameters
    ----------
    html : str
        HTML of the page, as exported by viser.
    scene : Scene
        The scene.
    title : str
        Title of the page.
    color : str
        Name of the layer of the ground.
    words : iterable of str
        Further notes.
    """
    layer = next(each for each in scene.ground.layers if each.name == color)
    runs = "".join(
        swatch(actor.color, actor.name, ghost=actor.ghost)
        + (f'<div style="{WARNING}">{escape(actor.stop)}</div>' if actor.stop else "")
        for actor in scene.actors
    )
    arrows = "".join(
        swatch(ARROWS[name], f"{name}: {each}")
        for name in scene.scales
        if (each := scale_words(scene, name))
    )
    notes = "".join(f"<p>{escape(note)}</p>" for note in (*scene.notes, *words))
    box = (
        f'<div id="slipfree" style="{BOX}"><b>{escape(title)}</b>{legend(layer)}{runs}{arrows}'
        f"{warned(scene)}<details><summary>notes</summary>{notes}</details></div>"
    )
    html = html.replace("<title>Viser</title>", f"<title>{escape(title)}</title>", 1)
    end = html.rindex("</body>")
    return html[:end] + box + html[end:]


def _css(color: Color) -> str:
    return "rgb({},{},{})".format(*color)
