"""Report of a result as one self-contained HTML page without scripts.

Figures are vector graphics; large ones become raster graphics. The content security policy of the
page forbids all requests.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from io import BytesIO
from typing import NamedTuple

from matplotlib import rc_context
from matplotlib.figure import Figure

from slipfree.show.plots import Plot, draw
from slipfree.show.style import DPI, STYLE

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
pre { background: #f5f5f5; padding: .8rem; overflow-x: auto; font-size: .85rem; }
"""
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"


class Report(NamedTuple):
    """Contents of a page, in their order.

    Attributes
    ----------
    title, lead : str
        Title, and a sentence on the outcome of the motion.
    good : bool
        Whether the motion is complete.
    tables : mapping of str to sequence of (str, ...)
        Rows by heading; the first cell of a row is its name, indented if it is subordinate to the
        row above.
    figures : sequence of Plot
        Figures to draw.
    note : str
        Reason why there are no figures; empty if there are figures.
    texts : mapping of str to str
        Preformatted texts by heading.
    """

    title: str
    lead: str
    good: bool
    tables: Mapping[str, Sequence[tuple[str, ...]]]
    figures: Sequence[Plot]
    note: str
    texts: Mapping[str, str]


def page(report: Report) -> str:
    """Return a report as a self-contained HTML page without scripts."""
    parts = {name: _table(rows) for name, rows in report.tables.items() if rows}
    first, *others = parts
    shown = _note(report.note) + "".join(_figure(plot) for plot in report.figures)
    sections = {
        first: parts[first],
        **({"Figures": shown} if shown else {}),
        **{name: parts[name] for name in others},
        **{name: f"<pre>{escape(text)}</pre>" for name, text in report.texts.items()},
    }
    return "\n".join(_lines(report, sections)) + "\n"


def _lines(report: Report, sections: Mapping[str, str]) -> Iterator[str]:
    """Yield the lines of a page."""
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


def _note(words: str) -> str:
    return f"<p>{escape(words)}</p>\n" if words else ""


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
