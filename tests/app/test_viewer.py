"""Tests of the viewer: its page in a real browser, and the server of the page."""

from __future__ import annotations

import io
import itertools
import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.error import HTTPError
from urllib.parse import urlsplit
from urllib.request import urlopen

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import binary_erosion

from helpers.chromium import complaints, headless_chromium, patiently, phone
from helpers.commands import invoke, refused, refuses, sets, shown
from helpers.problem_files import rough_ground
from slipfree.core.errors import DataError
from slipfree.show import html_page, style, viewer
from slipfree.show.plots import Plot
from slipfree.show.scene import drive_scene
from slipfree.show.viewer import recorder, stop, tracks
from slipfree.terrain.base import Grid
from slipfree.terrain.bicubic import Bicubic

SIZE = (1000, 480)
PROBLEM = """\
verb = "direct"
title = "Over <hills> & back"
vehicle = { catalog = "three_wheeler" }
start = { x = 0.0, y = -2.0, heading = 0.0 }
driver = { name = "straight", speed = 0.5 }
time = { duration = 4.0, step = 0.05 }
""" + rough_ground("[-5, 5]", "[-5, 5]", 0.25, "rms = 0.1, longest = 8.0, shortest = 2.0", 11)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return results of a vehicle that tilts, and of a rigid one beside it."""
    pytest.importorskip("viser")
    folder = tmp_path_factory.mktemp("seen")
    (folder / "p.toml").write_text(PROBLEM, encoding="utf-8")
    found = []
    for axle, x in (("tilting", 0), ("fixed", 3)):  # apart: faces in one place flicker
        found.append(folder / f"{axle}.nc")
        settings = sets(f"vehicle.axle={axle}", f"start.x={x}")
        invoke("run", folder / "p.toml", "-o", found[-1], "--no-draw", *settings, code=0)
    return found


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with headless_chromium(SIZE) as driver:
        yield driver


def picture(driver: Any) -> np.ndarray:
    """Return the scene as it is when it no longer changes, without what lies on top of it."""
    return part(still(driver))


def still(driver: Any) -> np.ndarray:
    """Return the whole page when it no longer changes."""

    def shot() -> Image.Image:
        return Image.open(io.BytesIO(patiently(driver.get_screenshot_as_png))).convert("RGB")

    before = np.asarray(shot())
    for _ in range(60):
        time.sleep(0.3)
        after = np.asarray(shot())
        if np.array_equal(before, after) and colors(part(after)) > 60:
            return after
        before = after
    raise AssertionError("the scene does not come to rest")


def part(whole: np.ndarray) -> np.ndarray:
    """Return the middle of a picture: controls lie around it."""
    height, width, _ = whole.shape
    return whole[int(0.1 * height) : int(0.8 * height), int(0.3 * width) : int(0.66 * width)]


def colors(seen: np.ndarray) -> int:
    return len(np.unique(seen.reshape(-1, 3), axis=0))


def orange(seen: np.ndarray) -> np.ndarray:
    """Return where the second run's platform is seen; no ground by height has its color."""
    red, green, blue = np.moveaxis(seen.astype(int), -1, 0)
    return np.asarray((red > 90) & (red - green > 60) & (green - blue > 20) & (blue < 90))


def gray(seen: np.ndarray) -> np.ndarray:
    """Return where tyres are seen, and edges of letters."""
    red, green, blue = np.moveaxis(seen.astype(int), -1, 0)
    even = (abs(red - green) < 10) & (abs(green - blue) < 10)
    return np.asarray(even & (red > 20) & (red < 130))


def missing(seen: list[np.ndarray]) -> list[str]:
    """Return what pictures at a time, another and the first again lack of vehicles that move.

    Labels and tracks are there without a vehicle, thin ones.
    """
    faults = []
    for mask, least in ((orange, 1000), (gray, 100)):
        # Letters of a label are thinner than two points.
        places = [np.argwhere(binary_erosion(mask(each), np.ones((2, 2)))) for each in seen]
        if min(map(len, places)) < least:
            faults.append(f"{mask.__name__}: {[len(each) for each in places]} points")
            continue
        before, after, again = (each.mean(axis=0) for each in places)
        if np.linalg.norm(after - before) < 20 or np.linalg.norm(again - before) > 2:
            faults.append(f"{mask.__name__} is at {before}, {after}, {again}")
    return faults


def slide(driver: Any, share: float) -> None:
    """Press the slider of time at a place, as a hand would."""
    from selenium.webdriver import ActionChains

    slider = driver.find_element("css selector", ".mantine-Slider-track")
    width = slider.rect["width"]
    aside = round((share - 0.5) * width)
    ActionChains(driver).move_to_element_with_offset(slider, aside, 0).click().perform()


def faded_in(driver: Any) -> None:
    """Move the slider, once it is there, until the scene, which fades in, is all there."""
    patiently(lambda: driver.find_elements("css selector", ".mantine-Slider-track"))
    script = "return [...document.querySelectorAll('canvas')].map(c => getComputedStyle(c).opacity)"
    shares = itertools.cycle((0.3, 0.6))

    def shown() -> bool:
        slide(driver, next(shares))
        return set(driver.execute_script(script)) == {"1"}

    patiently(shown)


def fineness(driver: Any) -> list[int]:
    """Return how many points wide the scene is drawn: a slow page makes them fewer as it goes."""
    script = "return [...document.querySelectorAll('canvas')].map(c => c.width)"
    return list(patiently(lambda: driver.execute_script(script)))


def watched(driver: Any) -> list[np.ndarray]:
    """Return pictures of a page at a time, another and the first again, by its slider."""
    faded_in(driver)
    for _ in range(6):
        fine, seen = fineness(driver), []
        for share in (0.05, 0.95, 0.05):
            patiently(lambda share=share: slide(driver, share) or True)
            seen.append(picture(driver))
        if fineness(driver) == fine:
            break
    return seen


def check_plots(driver: Any) -> None:
    """Assert that cursors, values and clock of plots are those of the time that a click sets."""
    run = """const plots = [...document.querySelectorAll("#plots svg")];
      const {left, top, width} = plots[0].getBoundingClientRect();
      const x = left + arguments[0] * width, event = {clientX: x, clientY: top + 5};
      plots[0].dispatchEvent(new MouseEvent("click", event));
      setTimeout(() => arguments[1](plots.map(plot => {
        const k = plot.querySelector("line").transform.baseVal[0].matrix.e;
        const {points} = plot.querySelector("polyline");
        const {textContent} = plot.previousElementSibling.querySelector("b");
        const clock = parseFloat(document.querySelector("#plots > div:last-child b").textContent);
        return [k / points.length - arguments[0], textContent - points[k].y,
          10 * (clock - 4 * k / (points.length - 1))];
      })), 1500)"""

    def is_shown(share: float) -> bool:
        plots = driver.execute_async_script(run, share)
        return len(plots) >= 2 and np.allclose(plots, 0.0, atol=0.03)

    for share in (0.25, 0.74):  # a busy machine shows a time late
        assert patiently(lambda share=share: is_shown(share))


def asked(driver: Any) -> set[tuple[str, str]]:
    """Return schemes and hosts of the addresses that the page asked for since the last call."""
    events = [json.loads(entry["message"])["message"] for entry in driver.get_log("performance")]
    kinds = "Network.requestWillBeSent", "Network.webSocketCreated"
    requests = [event["params"] for event in events if event["method"] in kinds]
    return {urlsplit(each.get("request", each)["url"])[:2] for each in requests}


@pytest.mark.slow
def test_the_page_shows_what_moves(files: list[Path], browser: Any) -> None:
    command = [sys.executable, "-m", "slipfree", "show", *map(str, files), "--no-browser"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            line = process.stderr.readline() if process.stderr else ""
            address = line.split()[0]
            assert address.startswith("http://127.0.0.1:")
            asked(browser), complaints(browser)  # those of other pages
            browser.get(address)
            assert missing(watched(browser)) == []
            text = browser.find_element("tag name", "body").text
            process.send_signal(signal.SIGINT)
            assert process.wait(30) == 0
        finally:
            process.kill()
    slip = "slip: 1 m of arrow length represents"
    for words in ("Over <hills> & back", "height: ", slip, "tilting", "fixed"):
        assert words in text
    assert {host for _, host in asked(browser)} - {""} == {address.split("/")[2]}
    assert complaints(browser) == []


@pytest.mark.slow
def test_a_saved_page_plays_from_disk(files: list[Path], browser: Any, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    done = invoke("show", *files, "--html", out, code=0)
    assert done.stdout == f"wrote {out}, {len(out.read_text(encoding='utf-8')) / 1e6:.1f} MB\n"
    browser.get("about:blank")  # ends the other page, whose server is gone
    asked(browser), complaints(browser)  # those of the other page
    browser.get(out.as_uri())
    assert missing(watched(browser)) == []
    check_plots(browser)
    before = picture(browser).astype(int)
    browser.execute_script("""const choice = document.querySelectorAll("#slipfree select")[1];
      choice.value = "tracks-slip";
      choice.dispatchEvent(new Event("change", {bubbles: true}))""")
    assert (np.abs(picture(browser) - before).max(axis=2) > 60).sum() > 100  # other tracks
    text = browser.find_element("id", "slipfree").text
    assert all(words in text for words in ("Over <hills> & back", "height: "))
    assert {kind for kind, _ in asked(browser)} <= {"file", "data", "blob"}
    assert complaints(browser) == []


@pytest.mark.slow
def test_a_hill_on_a_page_is_bright_in_the_north_west_and_nothing_is_cut(
    files: list[Path], browser: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Seen from above; its flanks have the same heights, and therefore the same colours."""
    monkeypatch.setattr(viewer, "VIEW", np.array([0.0, -0.01, 1.0]))
    drive = shown(files[0], "a")
    x, y = drive.terrain.grid.x, drive.terrain.grid.y
    hill = Bicubic(Grid(x, y, np.exp(-(x[:, None] ** 2 + (y + 1) ** 2) / 8)))
    scene = drive_scene([drive._replace(terrain=hill)])._replace(reach=2.0)
    out = tmp_path / "hill.html"
    out.write_text(viewer.page(scene, "hill", "height"), encoding="utf-8")
    browser.get("about:blank")
    browser.get(out.as_uri())
    faded_in(browser)
    boxes = """return [...document.querySelectorAll("#slipfree, #plots")].map(each => {
        const box = each.getBoundingClientRect();
        return [box.left, box.top, innerWidth - box.right, innerHeight - box.bottom]})"""
    assert np.min(browser.execute_script(boxes)) >= 0
    hide = """document.querySelectorAll("#slipfree input").forEach(each => each.click());
        const box = document.querySelector("canvas").getBoundingClientRect();
        return [box.left + box.width / 2, box.top + box.height / 2]"""
    column, row = map(round, browser.execute_script(hide))
    light = still(browser).astype(float).mean(axis=2)
    flanks = ((-1, -1), (-1, 1), (1, 1))  # north-west, south-west, south-east
    north_west, south_west, south_east = (
        light[row + 40 * down - 4 :, column + 40 * right - 4 :][:9, :9].mean()
        for right, down in flanks
    )
    assert north_west > 1.1 * south_west > 1.2 * south_east
    script = boxes.replace("box.top,", "box.height,")
    with phone(browser, 360, 740):
        heights = patiently(lambda: browser.execute_script(script))
    assert np.max(heights, axis=0)[1] < 0.36 * 740  # the scene is seen above


@pytest.mark.slow
def test_a_printed_report_is_unfolded_and_its_figures_are_legible_on_a_phone(
    browser: Any, tmp_path: Path
) -> None:
    out, texts = tmp_path / "report.html", {"Problem": "many\n" * 9}
    figures = [Plot("wide", "", lambda: style.figure(style.PAGE, 1))]
    report = html_page.Report("title", "lead", True, (), {}, figures, "", texts)
    out.write_text(html_page.page(report))
    browser.get(out.as_uri())
    heights = []
    for media in ("print", ""):
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media})
        heights.append(browser.find_element("tag name", "details").size["height"])
    assert heights[0] > heights[1] + 100
    with phone(browser, 390, 700):
        browser.refresh()
        script = "return [document.documentElement.scrollWidth, document.images[0].clientWidth]"
        page, figure = browser.execute_script(script)
    assert page == 390
    assert 7 / 72 * figure / style.PAGE > 7.0  # height of the letters of its axes, in pixels


def test_a_quiet_page_says_where_it_is(files: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(viewer, "serve", lambda *words: words[-1]("http://127.0.0.1:1"))
    done = invoke("show", files[0], "--no-browser", "--quiet", code=0)
    assert done.stderr == "http://127.0.0.1:1 shows the motions; Ctrl-C ends the server\n"


def test_run_shows_its_result(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pages = list[str]()
    monkeypatch.setattr(viewer, "serve", lambda html, *_: pages.append(html))
    (folder / "p.toml").write_text(PROBLEM, encoding="utf-8")
    invoke("run", "p.toml", "--no-draw", "--show", *sets("time.duration=0.2"), code=0)
    assert "Over &lt;hills&gt; &amp; back" in pages[0]


def test_the_colors_of_a_page_are_those_asked_for(files: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    invoke("show", files[0], "--html", out, "--color", "slope", code=0)
    assert 'data-nodes="/world/ground slope" selected>' in out.read_text(encoding="utf-8")


def test_without_viser_it_says_what_to_install(
    files: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    told = refused("show", files[0], "--no-browser")
    assert "expected the package 'viser', found that it is not installed" in told
    assert "python -m pip install 'viser<1.2,>=1.1'" in told


def test_a_port_that_is_taken_is_refused(files: list[Path]) -> None:
    import socket

    with socket.create_server(("127.0.0.1", 0)) as other:
        port = other.getsockname()[1]
        told = refused("show", files[0], "--no-browser", "--port", port)
    assert f"--port: expected a free port, found {port} in use" in told


def motion_nodes(files: list[Path], times: np.ndarray) -> tuple[Any, Any]:
    """Return a recorder, and the nodes of the first motion at given times."""
    server = viewer.recorder()
    return server, viewer._RunNodes(server, drive_scene([shown(files[0], "a")]), 0, times)


def test_the_port_of_a_recorder_is_closed() -> None:
    pytest.importorskip("viser")
    server = recorder()
    refuses(HTTPError, "403", urlopen, f"http://127.0.0.1:{server.get_port()}/")
    stop(server)


def test_a_recorder_that_cannot_be_closed_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    ended: list[int] = []
    other = SimpleNamespace(stop=lambda: ended.append(1))
    monkeypatch.setattr(pytest.importorskip("viser"), "ViserServer", lambda **_: other)
    refuses(DataError, "expected a version of viser whose port", recorder)
    assert ended == [1]


def test_nodes_have_the_poses_of_the_motion(files: list[Path]) -> None:
    times = np.array([-1.0, 2.0, 2.025, 9.0])
    server, nodes = motion_nodes(files, times)
    origins = nodes.actor.bodies[0].origins
    platform = server.scene.get_handle_by_name("/world/run 1/body 1")
    for k, t in enumerate((0.0, 2.0, 2.025, 4.0)):
        nodes.show(k)
        assert nodes.label.text == f"a, t = {t:.2f} s"
        assert np.allclose(platform.position, origins[k])
    assert np.allclose(nodes.here.position, origins[-1])
    stop(server)


def test_tracks_are_ribbons_with_a_white_edge_beside_the_contact_points(files: list[Path]) -> None:
    server, _ = motion_nodes(files, np.zeros(1))
    root = "/world/run 1/tracks"
    edge, track = (server.scene.get_handle_by_name(f"{root}/{name}") for name in ("edge", "own"))
    assert tuple(edge.color) == (255, 255, 255)
    assert edge.vertices[..., 2].max() < track.vertices[..., 2].max()
    widths = [np.linalg.norm(np.diff(each.vertices[:2], axis=0)) for each in (edge, track)]
    assert widths[0] > 1.5 * widths[1] > 0
    stop(server)
    points = np.stack(np.broadcast_arrays([0.0, 5.0], np.arange(4.0)[:, None], 0.0), axis=-1)
    points[2, 1] = np.nan  # without contact
    mesh = tracks(points, 0.2, dashed=False)
    assert sorted(set(mesh.vertices[:8, 0])) == pytest.approx([-0.1, 0.1])
    assert len(mesh.faces) == 6 + 2


@pytest.mark.parametrize("is_far", [False, True])
def test_long_motions_are_followed_and_shown_faster(files: list[Path], is_far: bool) -> None:
    scene = drive_scene([shown(files[0], "a")])
    actor = scene.actors[0]._replace(t=60 * scene.actors[0].t)
    scene = scene._replace(actors=(actor,), reach=0.05 if is_far else scene.reach)
    html = viewer.page(scene, "title", "height")
    assert "Played at 8 times real speed." in html
    words = "The view follows a.", '/world/run 1/tracks/path">overview<', '<div id="map"><svg'
    assert [each in html for each in words] == [is_far] * 3 == [scene.is_far] * 3
    drawn = re.findall(r'([\d.]+),([\d.]+)[ "]', html_page._inset(scene).partition("<poly")[2])
    places = np.array(drawn, float) * (1, -1) + scene.backdrop.window[::3]  # west, north
    assert np.allclose(places, (scene.paths + scene.origin)[:, :2], atol=1e-3)
