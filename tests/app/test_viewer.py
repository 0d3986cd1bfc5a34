"""Tests of the page in a real browser: contents, motion, and absence of network requests.

Without a graphics card a picture takes long, so there is one browser and one motion for all.
"""

from __future__ import annotations

import io
import itertools
import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import binary_erosion

from helpers.chromium import headless_chromium
from helpers.commands import invoke, refused, sets

if TYPE_CHECKING:
    from slipfree.show.scene import Scene

PATIENCE = 240.0  # for one picture, where many tests share few processors [s]
SIZE = (1000, 480)
PROBLEM = """\
verb = "direct"
title = "Over <hills> & back"
vehicle = { catalog = "three_wheeler" }
start = { x = 0.0, y = -2.0, heading = 0.0 }
driver = { name = "straight", speed = 0.5 }
time = { duration = 4.0, step = 0.05 }

[terrain.synthetic]
x = [-5, 5]
y = [-5, 5]
spacing = 0.25
power_law = { rms = 0.1, hurst = 0.9, longest = 8.0, shortest = 2.0, seed = 11 }
"""


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
    with headless_chromium(SIZE, PATIENCE) as driver:
        yield driver


def patiently(ask: Callable[[], Any]) -> Any:
    """Return the first answer that is one: the page answers late while it draws."""
    from selenium.common.exceptions import WebDriverException

    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        try:
            if answer := ask():
                return answer
        except WebDriverException as error:
            last: Any = error
        else:
            last = "nothing"
        time.sleep(0.3)
    raise TimeoutError(f"the page did not answer within {PATIENCE} s: {last}")


def picture(driver: Any) -> np.ndarray:
    """Return the scene as it is when it no longer changes, without what lies on top of it."""

    def shot() -> Image.Image:
        return Image.open(io.BytesIO(patiently(driver.get_screenshot_as_png))).convert("RGB")

    before = np.asarray(shot())
    for _ in range(60):
        time.sleep(0.3)
        after = np.asarray(shot())
        if np.array_equal(before, after) and colors(part(after)) > 60:
            return part(after)
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
    return list(
        patiently(
            lambda: driver.execute_script(
                "return [...document.querySelectorAll('canvas')].map(c => c.width)"
            )
        )
    )


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
    assert min(map(colors, seen)) > 60
    return seen


def asked(driver: Any) -> set[str]:
    """Return the addresses that the page asked for since the last call."""
    found = set()
    for entry in driver.get_log("performance"):
        event = json.loads(entry["message"])["message"]
        if event["method"] in ("Network.requestWillBeSent", "Network.webSocketCreated"):
            found.add(event["params"].get("request", event["params"])["url"])
    return found


def complaints(driver: Any) -> list[str]:
    return [entry["message"] for entry in driver.get_log("browser") if entry["level"] == "SEVERE"]


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
    assert "Over <hills> & back" in text
    for words in ("height: ", "slip: 1 m of arrow length represents", "tilting", "fixed"):
        assert words in text
    addresses = {
        each.split("://")[1].split("/")[0]
        for each in asked(browser)
        if not each.startswith(("data:", "blob:"))
    }
    assert addresses == {address.split("/")[2]}
    assert [each for each in complaints(browser) if "WebSocket" not in each] == []


@pytest.mark.slow
def test_a_saved_page_plays_from_disk(files: list[Path], browser: Any, tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    done = invoke("show", *files, "--html", out, code=0)
    assert done.stdout == f"wrote {out}, {len(out.read_text(encoding='utf-8')) / 1e6:.1f} MB\n"
    browser.get("about:blank")  # ends the other page, whose server is gone
    asked(browser), complaints(browser)  # those of the other page
    browser.get(out.as_uri())
    assert missing(watched(browser)) == []
    text = browser.find_element("id", "slipfree").text
    assert "Over <hills> & back" in text
    assert "height: " in text
    kinds = {each.split(":")[0] for each in asked(browser)}
    assert kinds <= {"file", "data", "blob"}
    assert complaints(browser) == []


def scene_of(files: list[Path]) -> Scene:
    from helpers.commands import shown
    from slipfree.show.drive_scene import Driven, drive_scene

    found = [shown(file, file.stem) for file in files]
    return drive_scene([each for each in found if isinstance(each, Driven)])


def test_a_quiet_page_says_where_it_is(files: list[Path], monkeypatch: pytest.MonkeyPatch) -> None:
    from slipfree.show import viewer

    def serve(*words: Any) -> None:
        words[-1]("http://127.0.0.1:1")

    monkeypatch.setattr(viewer, "serve", serve)
    done = invoke("show", files[0], "--no-browser", "--quiet", code=0)
    assert done.stderr == "http://127.0.0.1:1 shows the motions; Ctrl-C ends the server\n"


def test_the_colors_of_a_page_are_those_asked_for(files: list[Path], tmp_path: Path) -> None:
    out = tmp_path / "page.html"
    invoke("show", files[0], "--html", out, "--color", "slope", code=0)
    assert "slope: 0 to" in out.read_text(encoding="utf-8")


@pytest.fixture
def server() -> Iterator[Any]:
    pytest.importorskip("viser")
    from slipfree.show import local_server

    found = local_server.Guard(print).start(0)
    yield found
    local_server.stop(found)


def controls(server: Any, scene: Scene) -> Any:
    from slipfree.show import viewer

    stage = viewer.Stage(server, scene, "height")
    return viewer._Controls(server, stage, scene, "title", "height")


@pytest.mark.slow
def test_what_follows_keeps_the_vehicle_where_it_is_seen(files: list[Path], server: Any) -> None:
    from slipfree.show import viewer

    scene = scene_of(files)
    panel = controls(server, scene)
    world = server.scene.get_handle_by_name("/world")
    origins = scene.actors[0].bodies[0].origins
    panel.stage.show(4.0)
    assert np.allclose(world.position, 0)
    panel.stage.follow(True)
    assert np.allclose(world.position, 0)  # nothing jumps
    panel.stage.show(0.0)
    assert np.allclose(world.position, origins[-1] - origins[0])
    panel.stage.follow(False)
    assert np.allclose(world.position, 0)
    assert not panel.following.value
    far = viewer.Stage(server, scene._replace(reach=0.05), "height")
    assert scene._replace(reach=0.05).is_far
    camera = server.initial_camera
    assert np.allclose(camera.look_at, origins[0])
    assert np.linalg.norm(camera.position - camera.look_at) < 10 * 0.05
    far.show(4.0)
    assert np.allclose(far.world.position, origins[0] - origins[-1])


def test_without_viser_it_says_what_to_install(
    files: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    told = refused("show", files[0], "--no-browser")
    assert "expected the package 'viser', found that it is not installed" in told
    assert "python -m pip install '.[view]'" in told


def test_a_port_that_is_taken_is_refused(files: list[Path]) -> None:
    import socket

    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        told = refused("show", files[0], "--no-browser", "--port", port)
    assert f"--port: expected a free port, found {port} in use" in told


def test_play_goes_on_from_the_end_to_the_start(files: list[Path], server: Any) -> None:
    scene = scene_of(files[:1])
    panel = controls(server, scene)
    panel.advance(0.5)
    assert panel.time.value == 0
    panel.playing.value = True
    panel.speed.value = "2x"
    panel.advance(0.5)
    assert panel.time.value == pytest.approx(1)
    panel.advance(2)
    assert panel.time.value == 0
    for far in (-1e300, 1e300):
        panel.time.value = far
        panel.stage.show(far)
        panel.advance(0.5)
        panel.advance(0.5)
        assert 0 <= panel.time.value <= 4
    panel.stage.show(2.0)
    moved = server.scene.get_handle_by_name("/world/run 1/body 1")
    middle = scene.actors[0].t.size // 2
    assert np.allclose(moved.position, scene.actors[0].bodies[0].origins[middle])


def test_keys_step_through_the_time_and_change_the_speed(files: list[Path], server: Any) -> None:
    panel = controls(server, scene_of(files[:1]))
    by_key = {each.key: each.act for each in panel._actions()}
    presses = (
        ("arrowright", 0.08, False, "1x"),
        ("end", 4.0, False, "1x"),
        ("arrowleft", 3.92, False, "1x"),
        ("home", 0.0, False, "1x"),
        ("space", 0.0, True, "1x"),
        ("arrowright", 0.08, False, "1x"),
        ("arrowup", 0.08, False, "2x"),
    )
    for key, t, playing, speed in presses:
        by_key[key]()
        assert panel.time.value == pytest.approx(t)
        assert (panel.playing.value, panel.speed.value) == (playing, speed)
    for _ in range(9):
        by_key["arrowdown"]()
    assert panel.speed.value == "0.1x"
