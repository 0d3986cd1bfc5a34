"""Tests of planning by hand in a browser: dragging handles, planning, and cancelling a search."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from helpers.chromium import headless_chromium

PATIENCE = 60.0  # for one step, where many tests share few processors [s]
PROBLEM = """\
verb = "plan"
title = "Short <way>"

[terrain.synthetic]
x = [-5, 5]
y = [-5, 5]
spacing = 0.5
power_law = { rms = 0.02, hurst = 0.9, longest = 8.0, shortest = 4.0, seed = 1 }

[vehicle]
catalog = "three_wheeler"
axle = "fixed"

[start]
x = 0.0     # east of the origin [m]
y = -2.0
heading = 0.0

[goal]
x = 0.0     # [m]
y = [1.0, 1.2]

[[keep_out]]
x = 3.0
y = 0.0
radius = 0.5

[costs]
effort = 1.0

[plan]
intervals = 6

[driver]
name = "straight"
speed = 0.5

[time]
duration = 6.0
step = 0.1
"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with headless_chromium((1100, 700), PATIENCE) as driver:
        yield driver


@contextmanager
def served(browser: Any, file: Path, text: str) -> Iterator[Any]:
    """Yield the browser with the page of a problem, whose file is ``browser.file``."""
    file.write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "slipfree", "edit", str(file), "--no-browser"]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process:
        try:
            line = process.stderr.readline() if process.stderr else ""
            browser.get(line.split()[0])
            browser.file = file
            until(lambda: browser.find_elements("id", "handle-goal"))
            yield browser
            process.send_signal(signal.SIGINT)
            assert process.wait(PATIENCE) == 0
        finally:
            process.kill()


@pytest.fixture(scope="module")
def page(browser: Any, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    with served(browser, tmp_path_factory.mktemp("edit") / "short.toml", PROBLEM) as driver:
        yield driver


def until(ask: Callable[[], Any]) -> Any:
    """Return the first answer that is true."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if answer := ask():
            return answer
        time.sleep(0.05)
    raise TimeoutError(f"no answer within {PATIENCE} s")


def drag(driver: Any, handle: str, right: int, down: int) -> None:
    from selenium.webdriver import ActionChains

    element = driver.find_element("id", f"handle-{handle}")
    ActionChains(driver, duration=50).drag_and_drop_by_offset(element, right, down).perform()


def value(driver: Any, name: str) -> float:
    return float(driver.find_element("id", f"value-{name}").get_property("value"))


def pixels_per_metre(driver: Any) -> float:
    return float(driver.execute_script("return view.scale"))


def line(driver: Any) -> str:
    return str(driver.find_element("id", "line").text)


def test_a_plan_is_drawn_and_compared_with_the_last_one(page: Any) -> None:
    paths = []
    for _ in range(2):
        page.find_element("id", "plan").click()
        until(lambda: page.find_element("id", "cancel").is_enabled())
        until(lambda: line(page) == "found a plan")
        paths.append(page.find_element("id", "path-plan").get_attribute("points"))
        drag(page, "goal", 30, 0)
    page.get(page.current_url)  # with the places of the file
    until(lambda: page.find_elements("id", "handle-goal"))
    assert paths[0] != paths[1]
    assert page.find_elements("id", "path-last")
    rows = page.find_element("id", "facts").text
    assert rows.count("complete") == 2
    assert "path length" in rows


def test_dragged_handles_change_values_and_the_saved_file(page: Any) -> None:
    metre = pixels_per_metre(page)
    tolerance = 1.5 / metre  # of the pointer, which moves by whole pixels
    drag(page, "start", round(metre), -round(metre / 2))
    assert value(page, "start-x") == pytest.approx(1.0, abs=tolerance)
    assert value(page, "start-y") == pytest.approx(-1.5, abs=tolerance)
    drag(page, "start-heading", -46, 46)  # from north to west
    assert value(page, "start-heading") == pytest.approx(1.5708, abs=0.05)
    drag(page, "goal", 0, -round(metre))
    assert value(page, "goal-y") == pytest.approx(2.1, abs=tolerance)
    drag(page, "keep-0-radius", round(metre), 0)
    assert value(page, "keep-radius") == pytest.approx(1.5, abs=tolerance)
    page.find_element("id", "undo").click()
    page.find_element("id", "add").click()
    drag(page, "keep-1", -round(2 * metre), 0)
    assert value(page, "keep-x") == pytest.approx(-2.0, abs=tolerance)
    before = {name: value(page, name) for name in ("start-x", "start-y", "goal-y")}
    page.find_element("id", "save").click()
    until(lambda: line(page) == "saved short.toml")
    text = page.file.read_text(encoding="utf-8")
    data = tomllib.loads(text)
    assert "# east of the origin [m]" in text
    assert data["start"]["x"] == before["start-x"]
    low, high = data["goal"]["y"]
    assert (low + high) / 2 == pytest.approx(before["goal-y"], abs=1e-3)
    assert high - low == pytest.approx(0.2)
    assert data["keep_out"][0]["radius"] == 0.5
    assert len(data["keep_out"]) == 2
    severe = [each for each in page.get_log("browser") if each["level"] == "SEVERE"]
    assert severe == []


@pytest.mark.slow
def test_polygons_are_added_and_saved_and_way_points_are_shown(
    browser: Any, tmp_path: Path
) -> None:
    way = "[[way_points]]\nat = 0.5\nx = 0.4\ny = [-0.6, -0.4]\n\n[[keep_out]]"
    with served(browser, tmp_path / "poly.toml", PROBLEM.replace("[[keep_out]]", way)) as page:
        assert page.find_element("id", "way-name-0").text == "way-point at 0.5"
        metre = pixels_per_metre(page)
        page.find_element("id", "polygon").click()
        drag(page, "keep-1-3-new", -round(metre), 0)
        assert page.find_elements("id", "handle-keep-1-4")
        page.find_element("id", "undo").click()
        assert not page.find_elements("id", "handle-keep-1-4")
        drag(page, "keep-1-1-new", round(metre), 0)  # the side to the east gets a corner
        page.find_element("id", "save").click()
        until(lambda: line(page) == "saved poly.toml")
        text = page.file.read_text(encoding="utf-8")
        disc, polygon = tomllib.loads(text)["keep_out"]
        assert disc["radius"] == 0.5
        points = polygon["points"]
        assert len(points) == 5
        east = max(x for x, _ in points)
        (corner,) = (point for point in points if point[0] == east)
        assert points.index(corner) == 2
        assert east == pytest.approx(points[1][0] + 1.0, abs=2 / metre)
        severe = [each for each in page.get_log("browser") if each["level"] == "SEVERE"]
        assert severe == []


@pytest.mark.slow
def test_a_cancelled_search_ends_at_once_and_the_page_goes_on(browser: Any, tmp_path: Path) -> None:
    text = PROBLEM.replace("intervals = 6", "intervals = 400")
    with served(browser, tmp_path / "long.toml", text) as page:
        cancel_search(page)


def cancel_search(page: Any) -> None:
    page.find_element("id", "plan").click()
    until(lambda: page.find_elements("id", "iterate-0"))
    metre = pixels_per_metre(page)
    drag(page, "goal", round(metre), 0)  # the page responds during the search
    assert value(page, "goal-x") == pytest.approx(1.0, abs=1.5 / metre)
    begin = time.monotonic()
    page.find_element("id", "cancel").click()
    until(lambda: line(page) == "cancelled")
    assert time.monotonic() - begin < 5
    assert page.find_element("id", "plan").is_enabled()
    assert page.find_elements("id", "iterate-0")  # its last iterates stay visible
