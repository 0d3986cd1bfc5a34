"""Tests of planning by hand in a browser: dragging, planning, cancelling, saving, stale pages.

One browser and one server serve all tests, since both take seconds to start.
"""

import hashlib
import re
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from selenium.webdriver import ActionChains

from helpers.cases import DATA
from helpers.chromium import PATIENCE, complaints, headless_chromium, patiently, phone

PROBLEM = (DATA / "plan_of_a_short_way.toml").read_text()
REGIONS = """
# a tree
[[keep_out]]
x = -3.0
y = 1.0
radius = 0.3

[[keep_out]]
points = [[2.0, 3.0], [3.0, 3.0], [3.0, 4.0]]  # pond
"""


class EditPage:
    """Server of a problem file and its page in a browser."""

    def __init__(self, driver: Any, file: Path) -> None:
        self.driver, self.file, self.port = driver, file, 0
        self.start()

    def start(self) -> None:
        """Start the server, on its former port if it had one, and open the address it prints."""
        command = [sys.executable, "-m", "slipfree", "edit", str(self.file), "--no-browser"]
        command += ["--port", str(self.port)] if self.port else []
        for _ in range(20):
            self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
            line = self.process.stderr.readline() if self.process.stderr else ""
            if line.startswith("http"):
                break
            self.process.wait()  # another program has the port for a moment
            time.sleep(0.5)
        self.address = line.split()[0]
        self.port = int(self.address.split(":")[2].split("/")[0])

    def open(self) -> None:
        """Open the address in the present tab, and wait for the places."""
        self.driver.get(self.address)
        patiently(lambda: self.driver.find_elements("id", "handle-goal"))

    def end(self) -> str:
        """End the server by Ctrl-C, and return what it printed after its address."""
        self.process.send_signal(signal.SIGINT)
        _, words = self.process.communicate(timeout=PATIENCE)
        assert self.process.returncode == 0
        return str(words)

    def write(self, text: str) -> None:
        """Write the file as an editor does, and wait until the page shows it."""
        self.file.write_text(text, encoding="utf-8")
        revision = hashlib.sha256(text.encode()).hexdigest()[:16]
        self.run("sessionStorage.clear(); adopt(state);")
        patiently(lambda: self.run(f"return base?.revision === '{revision}'"))

    def run(self, script: str) -> Any:
        """Return the value of a script in the page."""
        return self.driver.execute_script(script)

    def click(self, name: str) -> None:
        """Press a button."""
        self.driver.find_element("id", name).click()

    def rest(self) -> None:
        """Wait until all requests of the page are answered."""
        self.driver.execute_async_script("later(() => {}).then(arguments[0])")

    def places(self) -> dict[str, Any]:
        """Return the places on the page."""
        return dict(self.run("return places"))

    def words(self, name: str) -> str:
        """Return the text of an element, such as the report ``line`` or the ``error``."""
        return str(self.driver.find_element("id", name).text)


def shapes_in(data: dict[str, Any]) -> list[Any]:
    """Return the regions of a problem file as the page lists them."""
    return [
        [each["points"], None] if "points" in each else [[[each["x"], each["y"]]], each["radius"]]
        for each in data.get("keep_out", ())
    ]


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EditPage]:
    file = tmp_path_factory.mktemp("edit") / "short.toml"
    file.write_text(PROBLEM, encoding="utf-8")
    with headless_chromium((1100, 700)) as driver:
        page = EditPage(driver, file)
        try:
            page.open()
            yield page
            assert "Traceback" not in page.end()
        finally:
            page.process.kill()


@pytest.fixture
def page(served: EditPage) -> EditPage:
    served.write(f"{PROBLEM}# {time.monotonic_ns()}\n")  # a change, so that the page reads it
    served.driver.get_log("browser")
    return served


def drag(page: EditPage, handle: str, right: int, down: int) -> None:
    element = page.driver.find_element("id", f"handle-{handle}")
    ActionChains(page.driver, duration=50).drag_and_drop_by_offset(element, right, down).perform()


def value(page: EditPage, name: str) -> float:
    return float(page.driver.find_element("id", f"value-{name}").get_property("value"))


def pixels_per_metre(page: EditPage) -> float:
    return float(page.run("return view.scale"))


def is_stale(page: EditPage) -> bool:
    return bool(page.run("return !document.getElementById('stale').hidden"))


def data_of(page: EditPage) -> dict[str, Any]:
    return tomllib.loads(page.file.read_text(encoding="utf-8"))


def test_a_plan_is_drawn_and_compared_with_the_last_one(page: EditPage) -> None:
    paths = []
    for _ in range(2):
        page.click("plan")
        patiently(lambda: page.driver.find_element("id", "cancel").is_enabled())
        patiently(lambda: page.words("line") == "found a plan")
        paths.append(page.driver.find_element("id", "path-plan").get_attribute("points"))
        drag(page, "goal", 30, 0)
    assert paths[0] != paths[1]
    assert page.driver.find_elements("id", "path-last")
    rows = page.driver.find_element("id", "facts").text
    assert rows.count("complete") == 2
    assert all(words in rows for words in ("path length", "mm/s", "tip-over margin"))


def test_dragged_handles_change_values_and_the_saved_file(page: EditPage) -> None:
    metre = pixels_per_metre(page)
    tolerance = 1.5 / metre  # of the pointer, which moves by whole pixels
    drag(page, "start", round(metre), -round(metre / 2))
    assert value(page, "start-x") == pytest.approx(1.0, abs=tolerance)
    assert value(page, "start-y") == pytest.approx(-1.5, abs=tolerance)
    drag(page, "start-heading", -46, 46)  # from north to west
    assert value(page, "start-heading") == pytest.approx(1.5708, abs=0.05)
    goal = page.driver.find_element("id", "handle-goal")
    ActionChains(page.driver).click_and_hold(goal).move_by_offset(0, -round(metre)).perform()
    assert page.driver.find_element("id", "tilt").get_attribute("width")
    assert re.fullmatch(r"goal: the ground tilts by \d+ deg", page.words("check"))
    ActionChains(page.driver).release().perform()
    assert page.words("check") == ""
    assert not page.driver.find_elements("id", "tilt")
    assert value(page, "goal-y") == pytest.approx(2.1, abs=tolerance)
    drag(page, "keep-0-radius", round(metre), 0)
    assert value(page, "keep-radius") == pytest.approx(1.5, abs=tolerance)
    page.click("undo")
    page.click("add")
    drag(page, "keep-1", -round(2 * metre), 0)
    assert value(page, "keep-x") == pytest.approx(-2.0, abs=tolerance)
    field, moved = page.driver.find_element("id", "value-start-y"), value(page, "start-y")
    field.clear()
    field.send_keys("1e9\t")
    assert value(page, "start-y") == 5.0  # the edge of the map
    assert page.words("check") == "start: a wheel could reach the edge of the map or a hole"
    page.click("undo")
    assert value(page, "start-y") == moved
    before = {name: value(page, name) for name in ("start-x", "start-y", "goal-y")}
    page.click("save")
    patiently(lambda: page.words("line") == "saved short.toml")
    text, data = page.file.read_text(encoding="utf-8"), data_of(page)
    assert "# east of the origin [m]" in text
    assert data["start"]["x"] == before["start-x"]
    low, high = data["goal"]["y"]
    assert (low + high) / 2 == pytest.approx(before["goal-y"], abs=1e-3)
    assert high - low == pytest.approx(0.2)
    assert data["keep_out"][0]["radius"] == 0.5
    assert len(data["keep_out"]) == 2
    assert complaints(page.driver) == []


def test_polygons_are_added_and_saved_and_way_points_are_shown(page: EditPage) -> None:
    way = "[[way_points]]\nat = 0.5\nx = 0.4\ny = [-0.6, -0.4]\n\n[[keep_out]]"
    page.file.write_text(PROBLEM.replace("[[keep_out]]", way), encoding="utf-8")
    patiently(lambda: page.driver.find_elements("id", "way-name-0"))  # the page loads again
    assert page.driver.find_element("id", "way-name-0").text == "way-point at 0.5"
    metre = pixels_per_metre(page)
    page.click("polygon")
    drag(page, "keep-1-3-new", -round(metre), 0)
    assert page.driver.find_elements("id", "handle-keep-1-4")
    page.click("undo")
    assert not page.driver.find_elements("id", "handle-keep-1-4")
    drag(page, "keep-1-1-new", round(metre), 0)  # the side to the east gets a corner
    page.click("save")
    patiently(lambda: page.words("line") == "saved short.toml")
    disc, polygon = data_of(page)["keep_out"]
    assert disc["radius"] == 0.5
    points = polygon["points"]
    assert len(points) == 5
    east = max(x for x, _ in points)
    (corner,) = (point for point in points if point[0] == east)
    assert points.index(corner) == 2
    assert east == pytest.approx(points[1][0] + 1.0, abs=2 / metre)
    assert complaints(page.driver) == []


def test_a_cancelled_search_ends_at_once_and_the_page_goes_on(page: EditPage) -> None:
    page.write(PROBLEM.replace("intervals = 6", "intervals = 2000"))  # the search outlasts the test
    page.click("plan")
    patiently(lambda: page.driver.find_elements("id", "iterate-0"))
    metre = pixels_per_metre(page)
    drag(page, "goal", round(metre), 0)  # the page responds during the search
    assert value(page, "goal-x") == pytest.approx(1.0, abs=1.5 / metre)
    begin = time.monotonic()
    page.click("cancel")
    patiently(lambda: page.words("line") == "cancelled")
    assert time.monotonic() - begin < 5
    assert page.driver.find_element("id", "plan").is_enabled()
    assert page.driver.find_elements("id", "iterate-0")  # its last iterates stay visible


def test_a_removed_region_is_the_only_one_that_the_file_loses(page: EditPage) -> None:
    text = PROBLEM + REGIONS
    page.write(text)
    page.run("chosen = 1; draw(); buttons();")
    for name in ("remove", "save", "plan"):
        page.click(name)
        time.sleep(0.1)
    page.run("remember(); places.start[2] = 0.05; draw();")
    for name in ("save", "cancel"):
        page.click(name)
        page.rest()
    found = page.file.read_text(encoding="utf-8")
    data, wanted = tomllib.loads(found), tomllib.loads(text)
    del wanted["keep_out"][1]
    wanted["start"]["heading"] = 0.05
    assert data == wanted
    shown = [[each["points"], each["radius"]] for each in page.places()["regions"]]
    assert shown == shapes_in(data)
    for comment in ("# east of the origin [m]", "# rock", "# pond"):
        assert comment in found
    assert page.words("error") == ""


def test_a_stale_page_keeps_its_changes_until_the_user_chooses(page: EditPage) -> None:
    page.write(PROBLEM + REGIONS)
    first = page.driver.current_window_handle
    page.driver.switch_to.new_window("tab")
    second = page.driver.current_window_handle
    page.open()
    page.run("places.start[0] = 0.25; places.regions.splice(1, 1); draw();")
    page.driver.switch_to.window(first)
    page.run("places.start[1] = -2.5; places.regions.splice(0, 1); draw();")
    page.click("save")
    page.rest()
    page.driver.switch_to.window(second)
    patiently(lambda: is_stale(page))
    page.run("command('save', {})")  # refused also without the disabled button
    page.rest()
    assert len(data_of(page)["keep_out"]) == 2
    assert len(page.places()["regions"]) == 2
    page.click("reapply")
    assert not is_stale(page)
    page.click("save")
    page.rest()
    data = data_of(page)
    assert (data["start"]["x"], data["start"]["y"]) == (0.25, -2.5)
    assert shapes_in(data) == [[[[2.0, 3.0], [3.0, 3.0], [3.0, 4.0]], None]]
    page.driver.close()
    page.driver.switch_to.window(first)
    patiently(lambda: page.places()["start"][0] == 0.25)  # without changes it shows the file
    page.run("places.start[0] = 0.75; draw();")
    page.file.write_text(PROBLEM, encoding="utf-8")
    patiently(lambda: is_stale(page))
    page.click("discard")
    assert page.places()["start"][0] == 0.0
    assert len(page.places()["regions"]) == 1


def test_a_restarted_server_and_double_clicks_lose_no_change(page: EditPage) -> None:
    page.run("remember(); places.start[0] = 0.5; draw();")
    page.end()
    page.start()
    patiently(lambda: "was started again" in page.words("error"))
    assert page.places()["start"][0] == 0.5
    page.open()
    assert page.places()["start"][0] == 0.5
    assert not is_stale(page)
    page.run("remember(); places.regions = []; draw();")
    ActionChains(page.driver).double_click(page.driver.find_element("id", "save")).perform()
    page.rest()
    assert data_of(page)["start"]["x"] == 0.5
    assert "keep_out" not in data_of(page)
    page.click("undo")
    page.click("save")
    page.rest()
    assert shapes_in(data_of(page)) == [[[[3.0, 0.0]], 0.5]]
    assert page.words("error") == ""


@pytest.mark.parametrize("width", [320, 390])
def test_a_phone_shows_map_and_panel_without_scrolling_sideways(page: EditPage, width: int) -> None:
    with phone(page.driver, width, 700):
        page.open()
        seen = "return [innerWidth, document.documentElement.scrollWidth, svg.clientWidth]"
        assert page.run(seen) == [width] * 3
        assert page.run("return svg.clientHeight") > 300
        finger = "svg.dispatchEvent(new PointerEvent('pointer{}', {{pointerId: {}, clientX: {}}}));"
        moves = [("down", 1, 100), ("down", 2, 200), ("move", 2, 300), ("up", 1, 0), ("up", 2, 0)]
        fingers = "".join(finger.format(*move) for move in moves)
        before = pixels_per_metre(page)
        page.run(f"svg.setPointerCapture = () => {{}}; {fingers}")
        assert pixels_per_metre(page) == pytest.approx(2 * before)
    page.open()
