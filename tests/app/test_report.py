"""Tests of the report of a result: one self-contained page for all kinds of results."""

from __future__ import annotations

import re
import shlex
from base64 import b64decode
from dataclasses import replace
from html import unescape
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from matplotlib.figure import Figure

from helpers.commands import invoke
from slipfree.files import netcdf
from slipfree.models.samples import has_friction
from slipfree.problem.load import load_problem
from slipfree.problem.report import report
from slipfree.problem.result import run_problem
from slipfree.show.html_page import MOST, image, page

ROOT = Path(__file__).parents[2]
STARTERS = ROOT / "src" / "slipfree" / "starters"
SETTINGS = {
    "direct": ["time.duration=1", "time.step=0.1", 'title="Über <Stock> & Stein"'],
    "inverse": ["time.duration=1", "time.step=0.1"],
    "plan": ["plan.intervals=8", "time.step=0.5"],
}
FIGURES = {"direct": 0, "inverse": 9, "plan": 0}
VOID = {"meta", "link", "img"}


def _result(kind: str, folder: Path, *settings: str) -> Path:
    """Return the result file of a shortened starter."""
    outcome = run_problem(load_problem(STARTERS / f"{kind}.toml", [*SETTINGS[kind], *settings]))
    file = folder / f"{kind}.nc"
    netcdf.write(file, outcome.trajectory, outcome.arrays)
    return file


class _Page(HTMLParser):
    """The tags of a page, that are properly nested, and its text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def of(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes in self.tags if name == tag]


def _invoke(*words: str) -> Any:
    return invoke("report", *words)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out what takes long."""
    monkeypatch.setattr("slipfree.problem.verbs.driving.DriveVerb.figures", lambda *_: ())


@pytest.mark.slow
@pytest.mark.parametrize("kind", SETTINGS)
def test_a_page_holds_all_of_a_result(kind, tmp_path, monkeypatch):
    file = _result(kind, tmp_path)
    if kind == "plan":
        assert len(report(file).figures) == 12
    if not FIGURES[kind]:  # they are drawn as those of an inverse motion, and in test_plot_plan.py
        for verb in ("driving.DriveVerb", "plan.PlanVerb"):
            monkeypatch.setattr(f"slipfree.problem.verbs.{verb}.figures", lambda *_: ())
    result = _invoke(str(file))
    assert result.exit_code == 0, result.output
    text = file.with_suffix(".html").read_text(encoding="utf-8")
    seen, words = _Page(text), unescape(re.sub(r"<[^>]*>", "", text))
    motion = netcdf.read(file)
    assert motion.attributes["title"] in words
    for setting in motion.attributes["settings"].splitlines():
        assert shlex.quote(setting) in words
    assert (STARTERS / f"{kind}.toml").read_text() in words
    for name, column in motion.columns.items():
        told = name != "utilisation" or has_friction(motion)
        assert name in words or not told
        assert (column.label.words in words) == told
    for name in ("slipfree", "python", "casadi", "numpy", "scipy"):
        assert motion.attributes[f"{name}_version"] in words
    assert f"slipfree info {file.name} --problem > {kind}_again.toml" in words
    checks = {
        "direct": "contact error",
        "inverse": "contact certificate",
        "plan": "differs from the plan by at most",
    }
    assert checks[kind] in words
    _check_alone(seen, text)
    _check_pictures(seen, FIGURES[kind])
    assert len(text) < 4e6
    if kind == "direct":
        assert page(report(file)) == text


def _check_alone(seen: _Page, text: str) -> None:
    """Assert that a page asks for nothing outside of it, and runs nothing."""
    assert not {"script", "iframe", "object", "embed", "form"} & {name for name, _ in seen.tags}
    for _, attributes in seen.tags:
        assert not any(name.startswith("on") for name in attributes)
        for name in ("src", "href"):
            assert (attributes.get(name) or "data:").startswith(("data:", "#"))
    assert "url(" not in text
    assert "@import" not in text
    (policy,) = [each["content"] for each in seen.of("meta") if "http-equiv" in each]
    assert policy.startswith("default-src 'none'")
    assert {link["href"] for link in seen.of("a")} == {f"#{s['id']}" for s in seen.of("section")}


def _check_pictures(seen: _Page, count: int) -> None:
    """Assert that pictures are whole, bounded and have words."""
    pictures = seen.of("img")
    assert len(pictures) == count
    for each in pictures:
        assert each["alt"]
        kind, _, data = each["src"].partition(";base64,")
        raw = b64decode(data, validate=True)
        if kind == "data:image/png":
            assert raw.startswith(b"\x89PNG")
            continue
        assert kind == "data:image/svg+xml"
        assert ElementTree.fromstring(raw).tag.endswith("svg")
        assert len(raw) <= MOST
        assert b"<script" not in raw


def test_a_large_drawing_becomes_pixels(rng):
    figure = Figure()
    figure.subplots().plot(*rng.random((2, 30_000)), "o")
    assert image(figure).startswith("data:image/png;base64,")


@pytest.mark.usefixtures("undrawn")
def test_an_early_end_comes_first(tmp_path):
    found = report(_result("direct", tmp_path, "time.duration=30", "time.step=1"))
    assert not found.good
    assert found.lead.startswith("Limit reached at t = ")
    assert "leaves the map" in found.lead
    assert 'class="lead bad"' in page(found)
    assert "--problem > direct_again.toml" in found.texts["To repeat the run"]  # not over a file


def test_a_result_without_a_problem_has_no_figures(tmp_path):
    file = _result("direct", tmp_path)
    motion = netcdf.read(file)
    kept = {k: v for k, v in motion.attributes.items() if k not in ("problem", "settings")}
    netcdf.write(file, replace(motion, attributes=kept))
    result = _invoke(str(file), "-o", str(tmp_path / "bare.html"))
    assert result.exit_code == 0
    assert "expected a result that contains its problem, found none" in result.stderr
    text = (tmp_path / "bare.html").read_text()
    assert "<img" not in text
    assert "To repeat the run" not in text


def test_a_problem_of_another_version_has_no_figures(tmp_path):
    file = _result("direct", tmp_path)
    motion = netcdf.read(file)
    changed = motion.attributes | {"problem": 'verb = "direct"\nfuture = 1\n'}
    netcdf.write(file, replace(motion, attributes=changed), netcdf.read_arrays(file))
    found = report(file)
    assert found.note.startswith("No figures: ")
    assert "future" in found.note
    assert not found.figures
    assert found.tables["Checks"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["no.nc"], "no.nc: expected a result file of slipfree"),
        (["a.nc"], "a.nc: expected a result file of slipfree, found a file that is not netCDF"),
        (["a.nc", "-o", "b.pdf"], "b.pdf: expected a name that ends in .html"),
    ],
)
@pytest.mark.usefixtures("folder")
def test_bad_input(words, told):
    Path("a.nc").write_text("nothing")
    result = _invoke(*words)
    assert (result.exit_code, result.stdout) == (2, "")
    assert told in result.stderr
    assert "Traceback" not in result.stderr


@pytest.mark.slow
def test_figures_of_a_long_motion_show_fewer_samples(tmp_path, monkeypatch):
    monkeypatch.setattr("slipfree.problem.report.FIGURE_SAMPLES", 5)
    file = _result("direct", tmp_path, "time.step=0.001")
    found = report(file)
    assert re.match(r"The figures show \d{2,3} of 1001 samples, including the extremes", found.note)
    assert ("duration", "1 s, 1001 samples") in found.tables["Result"]
