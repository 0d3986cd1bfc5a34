"""Tests of planning by hand in a browser: dragging, planning, cancelling, saving, stale pages.

One browser and one server serve all tests, since both take seconds to start.
"""

from __future__ import annotations

import time
import tomllib
from collections.abc import Iterator
from typing import Any

import pytest

from helpers.chromium import headless_chromium
from helpers.edit_page import (
    PATIENCE,
    PROBLEM,
    REGIONS,
    EditPage,
    remove_save_plan_save,
    shapes_in,
    until,
)


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[EditPage]:
    file = tmp_path_factory.mktemp("edit") / "short.toml"
    file.write_text(PROBLEM, encoding="utf-8")
    with headless_chromium((1100, 700), PATIENCE) as driver:
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
    from selenium.webdriver import ActionChains

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


def severe(page: EditPage) -> list[Any]:
    return [each for each in page.driver.get_log("browser") if each["level"] == "SEVERE"]


def test_a_plan_is_drawn_and_compared_with_the_last_one(page: EditPage) -> None:
    paths = []
    for _ in range(2):
        page.click("plan")
        until(lambda: page.driver.find_element("id", "cancel").is_enabled())
        until(lambda: page.line() == "found a plan")
        paths.append(page.driver.find_element("id", "path-plan").get_attribute("points"))
        drag(page, "goal", 30, 0)
    assert paths[0] != paths[1]
    assert page.driver.find_elements("id", "path-last")
    rows = page.driver.find_element("id", "facts").text
    assert rows.count("complete") == 2
    assert "path length" in rows


def test_dragged_handles_change_values_and_the_saved_file(page: EditPage) -> None:
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
    page.click("undo")
    page.click("add")
    drag(page, "keep-1", -round(2 * metre), 0)
    assert value(page, "keep-x") == pytest.approx(-2.0, abs=tolerance)
    before = {name: value(page, name) for name in ("start-x", "start-y", "goal-y")}
    page.click("save")
    until(lambda: page.line() == "saved short.toml")
    text, data = page.file.read_text(encoding="utf-8"), data_of(page)
    assert "# east of the origin [m]" in text
    assert data["start"]["x"] == before["start-x"]
    low, high = data["goal"]["y"]
    assert (low + high) / 2 == pytest.approx(before["goal-y"], abs=1e-3)
    assert high - low == pytest.approx(0.2)
    assert data["keep_out"][0]["radius"] == 0.5
    assert len(data["keep_out"]) == 2
    assert severe(page) == []


def test_polygons_are_added_and_saved_and_way_points_are_shown(page: EditPage) -> None:
    way = "[[way_points]]\nat = 0.5\nx = 0.4\ny = [-0.6, -0.4]\n\n[[keep_out]]"
    page.file.write_text(PROBLEM.replace("[[keep_out]]", way), encoding="utf-8")
    until(lambda: page.driver.find_elements("id", "way-name-0"))  # the page loads again
    assert page.driver.find_element("id", "way-name-0").text == "way-point at 0.5"
    metre = pixels_per_metre(page)
    page.click("polygon")
    drag(page, "keep-1-3-new", -round(metre), 0)
    assert page.driver.find_elements("id", "handle-keep-1-4")
    page.click("undo")
    assert not page.driver.find_elements("id", "handle-keep-1-4")
    drag(page, "keep-1-1-new", round(metre), 0)  # the side to the east gets a corner
    page.click("save")
    until(lambda: page.line() == "saved short.toml")
    disc, polygon = data_of(page)["keep_out"]
    assert disc["radius"] == 0.5
    points = polygon["points"]
    assert len(points) == 5
    east = max(x for x, _ in points)
    (corner,) = (point for point in points if point[0] == east)
    assert points.index(corner) == 2
    assert east == pytest.approx(points[1][0] + 1.0, abs=2 / metre)
    assert severe(page) == []


def test_a_cancelled_search_ends_at_once_and_the_page_goes_on(page: EditPage) -> None:
    page.write(PROBLEM.replace("intervals = 6", "intervals = 400"))
    page.click("plan")
    until(lambda: page.driver.find_elements("id", "iterate-0"))
    metre = pixels_per_metre(page)
    drag(page, "goal", round(metre), 0)  # the page responds during the search
    assert value(page, "goal-x") == pytest.approx(1.0, abs=1.5 / metre)
    begin = time.monotonic()
    page.click("cancel")
    until(lambda: page.line() == "cancelled")
    assert time.monotonic() - begin < 5
    assert page.driver.find_element("id", "plan").is_enabled()
    assert page.driver.find_elements("id", "iterate-0")  # its last iterates stay visible


@pytest.mark.parametrize(("region", "pause"), [(0, 0.0), (1, 0.1), (2, 0.3)])
def test_a_removed_region_is_the_only_one_that_the_file_loses(
    page: EditPage, region: int, pause: float
) -> None:
    remove_save_plan_save(page, region, pause)


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
    until(lambda: is_stale(page))
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
    until(lambda: page.places()["start"][0] == 0.25)  # without changes it shows the file
    page.run("places.start[0] = 0.75; draw();")
    page.file.write_text(PROBLEM, encoding="utf-8")
    until(lambda: is_stale(page))
    page.click("discard")
    assert page.places()["start"][0] == 0.0
    assert len(page.places()["regions"]) == 1


def test_a_restarted_server_and_double_clicks_lose_no_change(page: EditPage) -> None:
    from selenium.webdriver import ActionChains

    page.run("remember(); places.start[0] = 0.5; draw();")
    page.end()
    page.start()
    until(lambda: "was started again" in page.error())
    assert page.places()["start"][0] == 0.5
    page.open()
    assert page.places()["start"][0] == 0.5
    assert not is_stale(page)
    page.run("remember(); places.regions = []; draw();")
    save = page.driver.find_element("id", "save")
    ActionChains(page.driver).double_click(save).perform()
    page.rest()
    assert data_of(page)["start"]["x"] == 0.5
    assert "keep_out" not in data_of(page)
    page.click("undo")
    page.click("save")
    page.rest()
    assert shapes_in(data_of(page)) == [[[[3.0, 0.0]], 0.5]]
    assert page.error() == ""
