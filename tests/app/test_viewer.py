"""Tests of the viewer: its page in a real browser, and its guard."""

from __future__ import annotations

import http.client
import io
import itertools
import json
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import binary_erosion

from helpers.chromium import headless_chromium
from helpers.commands import invoke, refused, refuses, sets
from helpers.problem_files import rough_ground
from slipfree.core.errors import DataError
from slipfree.show.local_server import Guard, stop

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


# The viewer's guard: only its own page is answered, and invalid values are ignored

viser = pytest.importorskip("viser")
msgpack = pytest.importorskip("msgspec.msgpack")  # which viser needs, as the others
zstandard = pytest.importorskip("zstandard")
errors = pytest.importorskip("websockets.exceptions")
client = pytest.importorskip("websockets.sync.client")

GUARD_PATIENCE = 30.0  # [s]
EVIL = "http://evil.example"
SLIDER = (float("nan"), float("inf"), None, "boom", True, [1.0], {"a": 1}, b"1")
WRONG = {
    "speed": ("boom", "", None, 1.0, float("nan"), ["1x"], True),
    "time [s]": SLIDER,
    "play": ("boom", None, 1, 0.0, [], float("nan")),
}


@pytest.fixture
def told() -> list[str]:
    return []


@pytest.fixture
def server_guard(told: list[str]) -> Iterator[Any]:
    guard = Guard(told.append)
    found = guard.start(0)
    found.path = urlsplit(guard.gate.url(found.get_port())).path
    yield found
    stop(found)


def _get(server: Any, path: str | None = None, **headers: str) -> tuple[int, str]:
    """Return the status and the text of a request that has only these headers."""
    connection = http.client.HTTPConnection("127.0.0.1", server.get_port(), timeout=GUARD_PATIENCE)
    words = server.path if path is None else path
    connection.putrequest("GET", words, skip_host=True, skip_accept_encoding=True)
    for name, value in headers.items():
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    found = response.status, response.read().decode()
    connection.close()
    return found


def _joined(port: int, path: str, host: str | None = None, origin: str | None = None) -> Any:
    """Return a connection of WebSocket that names a host and an origin."""
    return client.connect(
        f"ws://{host or f'127.0.0.1:{port}'}{path}",
        sock=socket.create_connection(("127.0.0.1", port)),
        origin=origin,
        subprotocols=[f"viser-v{viser.__version__}"],
        open_timeout=GUARD_PATIENCE,
        max_size=None,
    )


def _await(is_so: Callable[[], bool]) -> None:
    end = time.monotonic() + GUARD_PATIENCE
    while not is_so():
        assert time.monotonic() < end
        time.sleep(0.02)


def _messages(page: Any) -> Iterator[dict[str, Any]]:
    """Yield the messages of the server."""
    while True:
        data = page.recv(timeout=GUARD_PATIENCE)
        size = int.from_bytes(data[8:16], "little")
        yield from msgpack.decode(zstandard.ZstdDecompressor().decompress(data[16 : 16 + size]))[
            "messages"
        ]


def _update(uuid: object, updates: object) -> bytes:
    return msgpack.encode({"type": "GuiUpdateMessage", "uuid": uuid, "updates": updates})


@pytest.mark.parametrize("name", ["127.0.0.1", "[::1]", "LocalHost"])
def test_own_pages_are_answered(server_guard: Any, told: list[str], name: str) -> None:
    port = server_guard.get_port()
    host = f"{name}:{port}"
    for headers in ({"Host": host}, {"Host": host, "Origin": f"http://{host}"}):
        status, text = _get(server_guard, **headers)
        assert status == 200
        assert "<title>Viser</title>" in text
    for path, origin in ((server_guard.path, None), (server_guard.path[:-1], f"http://{host}")):
        with _joined(port, path, host, origin) as page:
            assert next(_messages(page))["type"]
    assert told == []


@pytest.mark.parametrize("path", ["/", "/wrong/", "/?a={}", "/{}x/"])
def test_requests_without_the_secret_are_refused(
    server_guard: Any, told: list[str], path: str
) -> None:
    port, secret = server_guard.get_port(), server_guard.path.strip("/")
    path = path.format(secret)
    status, text = _get(server_guard, path, Host=f"127.0.0.1:{port}")
    assert status == 403
    assert "expected the address that slipfree show printed, with its secret" in text
    assert "open that address in the browser" in text
    refuses(errors.InvalidStatus, "403", _joined, port, path or "/")
    (words,) = told
    assert words.endswith("without the secret")
    assert secret not in words + text


FOREIGN = {
    "rebound": ("evil.example:{}", None),
    "rebound, with its origin": ("evil.example:{}", f"{EVIL}:{{}}"),
    "another page": ("127.0.0.1:{}", EVIL),
    "a file or a sandbox": ("127.0.0.1:{}", "null"),
    "no origin": ("127.0.0.1:{}", ""),
    "another scheme": ("127.0.0.1:{}", "https://127.0.0.1:{}"),
    "another port": ("127.0.0.1:1", None),
    "a longer name": ("127.0.0.1.evil.example:{}", None),
}


@pytest.mark.parametrize(("host", "origin"), FOREIGN.values(), ids=FOREIGN)
def test_foreign_pages_are_refused(
    server_guard: Any, told: list[str], host: str, origin: str | None
) -> None:
    port = server_guard.get_port()
    headers = {"Host": host.format(port)}
    if origin is not None:
        headers["Origin"] = origin.format(port)
    status, text = _get(server_guard, **headers)
    assert status == 403
    assert "expected the address that slipfree show printed" in text
    (words,) = told
    assert words.endswith("with the secret")
    assert headers["Host"] in words
    upgrade = {
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==",
    }
    assert _get(server_guard, **headers, **upgrade)[0] == 403
    assert server_guard.get_clients() == {}


def test_requests_without_or_with_two_hosts_are_refused(server_guard: Any, told: list[str]) -> None:
    port = server_guard.get_port()
    assert _get(server_guard)[0] == 403
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=GUARD_PATIENCE)
    connection.putrequest("GET", "/")
    connection.putheader("Host", "evil.example")
    connection.endheaders()
    assert connection.getresponse().status == 403
    connection.close()
    assert len(told) == 1


def test_warnings_are_few_and_plain(server_guard: Any, told: list[str]) -> None:
    for number in range(12):
        _get(server_guard, Host=f"{number}\x9b2J{'x' * 500}")
    assert len(told) == 2
    assert told[-1] == "refused 10 requests"
    assert all(words.isprintable() and words.isascii() and len(words) < 300 for words in told)


def test_values_that_fit_no_control_are_ignored(
    server_guard: Any, told: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("slipfree.show.local_server.MAX_WARNINGS", 100)
    gui = server_guard.gui
    controls = {
        "speed": gui.add_dropdown("speed", ("1x", "2x"), initial_value="1x"),
        "time [s]": gui.add_slider("time [s]", 0.0, 4.0, 0.1, 0.0),
        "play": gui.add_checkbox("play", False),
    }
    before = {name: control.value for name, control in controls.items()}
    with _joined(server_guard.get_port(), server_guard.path) as page:
        for name, values in WRONG.items():
            uuid = controls[name]._impl.uuid
            for value in values:
                told.clear()
                page.send(_update(uuid, {"value": value}))
                _await(lambda: bool(told))
                (words,) = told
                assert words.startswith(f"ignored a value of {name!r}: expected "), words
            for updates in ({"update_cb": 1}, {"value": before[name], "gui_api": 1}, {}, None, 1):
                told.clear()
                page.send(_update(uuid, updates))
                _await(lambda: bool(told))
                assert f"ignored a value of {name!r}: expected a value, found " in told[0]
        assert {name: control.value for name, control in controls.items()} == before
        told.clear()
        for name, value in (("speed", "2x"), ("time [s]", 3), ("play", True)):
            page.send(_update(controls[name]._impl.uuid, {"value": value}))
            _await(lambda name=name, value=value: controls[name].value == value)
    assert told == []
    assert isinstance(controls["time [s]"].value, float)


def test_what_is_no_message_closes_its_connection_alone(server_guard: Any, told: list[str]) -> None:
    box = server_guard.gui.add_checkbox("play", False)
    with _joined(server_guard.get_port(), server_guard.path) as good:
        for data in (b"", b"\xc1", b"\x01", "text", msgpack.encode({"type": "Nothing"})):
            told.clear()
            with _joined(server_guard.get_port(), server_guard.path) as bad:
                bad.send(data)
                with pytest.raises(errors.ConnectionClosed):
                    for _ in _messages(bad):
                        pass
            _await(lambda: bool(told))
            assert told[0].startswith("closed a connection: connection handler failed: ")
        told.clear()
        good.send(_update(["no", "name"], {"value": 1}))
        _await(lambda: bool(told))
        assert told[0].startswith("ignored a message: TypeError")
        good.send(_update(box._impl.uuid, {"value": True}))
        _await(lambda: box.value)


def test_nobody_can_ask_for_a_public_address(server_guard: Any) -> None:
    names = {each.__name__ for each in server_guard._websock_server._incoming_handlers}
    assert "GuiUpdateMessage" in names
    assert not any("Share" in name and "Request" in name for name in names)


def test_a_server_that_cannot_be_guarded_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    ended = []

    class Other:
        def __init__(self, **_: Any) -> None:
            pass

        def stop(self) -> None:
            ended.append(self)

    monkeypatch.setattr(viser, "ViserServer", Other)
    with pytest.raises(DataError, match="expected a version of viser whose requests"):
        Guard(print).start(0)
    assert len(ended) == 1
