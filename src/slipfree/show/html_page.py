"""HTML of the legend of a scene, and of the report of a result: one page without scripts.

Figures of a report are vector graphics; large ones become raster graphics. The content security
policy of the page forbids all requests.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from html import escape
from io import BytesIO
from typing import NamedTuple

from matplotlib import rc_context
from matplotlib.figure import Figure

from slipfree.show.local_server import page_script
from slipfree.show.plots import Plot, draw
from slipfree.show.scene import Color, Entry, Layer, Scene
from slipfree.show.style import DPI, STYLE

BOX = (
    "position:fixed;left:8px;bottom:52px;z-index:2;max-width:22em;padding:6px 10px;"
    "font:12px/1.4 sans-serif;color:#222;background:rgba(255,255,255,.85);border-radius:4px"
)
HOLLOW = "background:none;border:2px dotted"
SQUARE = "display:inline-block;width:12px;height:12px;margin-right:6px"
WARNING = "color:#a00"
CHECK = "margin:0 6px 0 0"
SAVED_KEYS = "Keys: space: play or pause; left, right: step; home, end: first and last time."
MOST = 400_000  # larger vector graphics become raster graphics [bytes]
PIXELS = 120  # pixels of the page per inch of a figure
VECTOR = {"svg.fonttype": "path", "svg.hashsalt": "slipfree"}  # for reproducible pages
STYLES = """
body { font: 16px/1.45 system-ui, sans-serif; color: #1a1a1a; background: #fff;
       max-width: 60rem; margin: 0 auto; padding: 1rem 1.2rem 4rem; }
h1 { line-height: 1.15; margin-bottom: .2rem; } h2 { margin-top: 2.2rem; }
nav a { margin-right: 1rem; } .lead { color: #444; margin-top: 0; }
.bad { border-left: .4rem solid #D55E00; padding-left: .8rem; }
table { border-collapse: collapse; width: 100%; font-size: .92rem; }
td, th { text-align: left; vertical-align: top; padding: .22rem .8rem .22rem 0;
         border-bottom: 1px solid #e3e3e3; overflow-wrap: anywhere; }
th { font-weight: 600; width: 14rem; } th.below { font-weight: 400; padding-left: 1rem; }
figure { margin: 1.4rem 0; break-inside: avoid; } figure img { max-width: 100%; height: auto; }
figcaption { color: #444; font-size: .92rem; }
@media (max-width: 40rem) { th { width: 35%; } td, th { padding-right: .4rem; } }
pre { background: #f5f5f5; padding: .8rem; overflow-x: auto; font-size: .85rem; }
"""
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


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
    """Return a page exported by viser with title, legend and notes; ``color`` names a layer."""
    switches = "".join(map(_switch, scene.entries))
    notes = "".join(f"<p>{escape(note)}</p>" for note in (*scene.notes, *words, SAVED_KEYS))
    box = (
        f'<div id="slipfree" style="{BOX}"><b>{escape(title)}</b>{_layers(scene, color)}'
        f"{switches}{warned(scene)}<details><summary>notes</summary>{notes}</details></div>"
        f"<script>{page_script('viewer_keys.js')}{page_script('viewer_saved.js')}</script>"
    )
    html = html.replace("<title>Viser</title>", f"<title>{escape(title)}</title>", 1)
    end = html.rindex("</body>")
    return html[:end] + box + html[end:]


def _layers(scene: Scene, color: str) -> str:
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


def _switch(entry: Entry) -> str:
    names = escape("|".join(entry.nodes))
    box = f'<input type="checkbox" checked data-node="{names}" style="{CHECK}">'
    words = swatch(entry.color, entry.label, ghost=entry.ghost)
    if entry.stop:
        words += f'<div style="{WARNING}">{escape(entry.stop)}</div>'
    return f'<label style="display:flex;align-items:baseline">{box}<span>{words}</span></label>'


def _css(color: Color) -> str:
    return "rgb({},{},{})".format(*color)


class Report(NamedTuple):
    """Contents of a page, in their order."""

    title: str
    lead: str  # sentence on the outcome of the motion
    good: bool  # whether the motion is complete
    tables: Mapping[str, Sequence[tuple[str, ...]]]  # by heading; names may be indented
    figures: Sequence[Plot]
    note: str  # why there are no figures
    texts: Mapping[str, str]  # preformatted, by heading


def page(report: Report, progress: Callable[[int, int], object] | None = None) -> str:
    """Return a report as a self-contained HTML page without scripts."""
    parts = {name: _table(rows) for name, rows in report.tables.items() if rows}
    first, *others = parts
    figures = list[str]()
    for plot in report.figures:
        figures.append(_figure(plot))
        if progress is not None:
            progress(len(figures), len(report.figures))
    note = f"<p>{escape(report.note)}</p>\n" if report.note else ""
    shown = note + "".join(figures)
    sections = {
        first: parts[first],
        **({"Figures": shown} if shown else {}),
        **{name: parts[name] for name in others},
        **{name: f"<pre>{escape(text)}</pre>" for name, text in report.texts.items()},
    }
    return "\n".join(_lines(report, sections)) + "\n"


def _lines(report: Report, sections: Mapping[str, str]) -> Iterator[str]:
    """Yield the lines of the HTML page of a report."""
    ids = {name: name.lower().replace(" ", "-") for name in sections}
    yield '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">'
    yield f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
    yield '<meta name="viewport" content="width=device-width, initial-scale=1">'
    yield '<link rel="icon" href="data:,">'
    yield f"<title>{escape(report.title)}</title>\n<style>{STYLES}</style>\n</head>\n<body>"
    yield f"<h1>{escape(report.title)}</h1>"
    yield f'<p class="lead{"" if report.good else " bad"}">{escape(report.lead)}</p>'
    links = "\n".join(f'<a href="#{ids[name]}">{escape(name)}</a>' for name in sections)
    yield f"<nav>\n{links}\n</nav>"
    for name, content in sections.items():
        yield f'<section id="{ids[name]}">\n<h2>{escape(name)}</h2>\n{content}\n</section>'
    yield "</body>\n</html>"


def _table(rows: Sequence[tuple[str, ...]]) -> str:
    lines = []
    for name, *cells in rows:
        below = ' class="below"' if name.startswith(" ") else ""
        values = "".join(f"<td>{escape(cell)}</td>" for cell in cells)
        lines.append(f'<tr><th scope="row"{below}>{escape(name.strip())}</th>{values}</tr>')
    return "<table>\n" + "\n".join(lines) + "\n</table>"


def _figure(plot: Plot) -> str:
    caption, (figure,) = escape(plot.caption), draw([plot]).values()
    width = PIXELS * float(figure.get_figwidth())
    return (
        f'<figure><img alt="{caption}" width="{width:.0f}" src="{image(figure)}">'
        f"<figcaption>{caption}</figcaption></figure>\n"
    )


def image(figure: Figure) -> str:
    """Return a figure as a data URI: SVG, or PNG if the SVG exceeds 400 000 bytes."""
    drawn = _written(figure, "svg")
    kind = "svg+xml"
    if len(drawn) > MOST:
        drawn, kind = _written(figure, "png"), "png"
    return f"data:image/{kind};base64,{b64encode(drawn).decode()}"


def _written(figure: Figure, ending: str) -> bytes:
    file = BytesIO()
    metadata = {"Date": None} if ending == "svg" else None
    with rc_context(STYLE | VECTOR):  # type: ignore[arg-type]  # its keys are a literal type
        figure.savefig(file, format=ending, dpi=DPI, metadata=metadata)
    return file.getvalue()
