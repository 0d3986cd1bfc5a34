"""Legend of a scene in a web page: colours and arrows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files

from slipfree.show.scene import ARROWS, Color, Layer, Scene, scale_words

BOX = (
    "position:fixed;left:8px;bottom:52px;z-index:2;max-width:22em;padding:6px 10px;"
    "font:12px/1.4 sans-serif;color:#222;background:rgba(255,255,255,.85);border-radius:4px"
)
HOLLOW = "background:none;border:2px dotted"
SQUARE = "display:inline-block;width:12px;height:12px;margin-right:6px"
WARNING = "color:#a00"
CHECK = "margin:0 6px 0 0"
SAVED_KEYS = "Keys: space: play or pause; left, right: step; home, end: first and last time."


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
    runs = "".join(
        _switch(
            swatch(actor.color, actor.name, ghost=actor.ghost)
            + (f'<div style="{WARNING}">{escape(actor.stop)}</div>' if actor.stop else ""),
            [f"/world/run {k}"],
        )
        for k, actor in enumerate(scene.actors, 1)
    )
    arrows = "".join(
        _switch(
            swatch(ARROWS[name], f"{name}: {each}"),
            [f"/world/run {k}/here/{name}" for k, _ in enumerate(scene.actors, 1)],
        )
        for name in scene.scales
        if (each := scale_words(scene, name))
    )
    lines = "".join(
        _switch(swatch(each.color, f"{each.name}: {each.legend}"), [f"/world/{each.name}"])
        for each in scene.ground.lines
    )
    notes = "".join(f"<p>{escape(note)}</p>" for note in (*scene.notes, *words, SAVED_KEYS))
    box = (
        f'<div id="slipfree" style="{BOX}"><b>{escape(title)}</b>{_layers(scene, color)}{lines}'
        f"{runs}{arrows}{warned(scene)}<details><summary>notes</summary>{notes}</details></div>"
        f"<script>{page_script('viewer_keys.js')}{page_script('viewer_saved.js')}</script>"
    )
    html = html.replace("<title>Viser</title>", f"<title>{escape(title)}</title>", 1)
    end = html.rindex("</body>")
    return html[:end] + box + html[end:]


def page_script(name: str) -> str:
    """Return the text of a script of this package."""
    return files("slipfree.show").joinpath(name).read_text("utf-8")


def _layers(scene: Scene, color: str) -> str:
    """Return HTML to choose a layer of the ground, with the legends of all layers."""
    options = "".join(
        f'<option value="layer-{layer.name}" data-ground="/world/ground {layer.name}"'
        f"{' selected' if layer.name == color else ''}>{escape(layer.name)}</option>"
        for layer in scene.ground.layers
    )
    legends = "".join(
        f'<div id="layer-{layer.name}"{"" if layer.name == color else " hidden"}>'
        f"{legend(layer)}</div>"
        for layer in scene.ground.layers
    )
    return f'<div>ground <select data-layer="">{options}</select></div>{legends}'


def _switch(words: str, nodes: Sequence[str]) -> str:
    """Return HTML of a checkbox that shows or hides nodes of the scene."""
    names = escape("|".join(nodes))
    box = f'<input type="checkbox" checked data-node="{names}" style="{CHECK}">'
    return f'<label style="display:flex;align-items:baseline">{box}<span>{words}</span></label>'


def _css(color: Color) -> str:
    return "rgb({},{},{})".format(*color)
