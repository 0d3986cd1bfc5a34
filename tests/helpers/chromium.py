"""Browser for tests of pages."""

import os
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

PATIENCE = 240.0  # for one page or picture, where many tests share few processors [s]


@contextmanager
def headless_chromium(size: tuple[int, int]) -> Iterator[Any]:
    """Yield the driver of a headless Chromium that reaches no host but this one.

    ``size`` is that of the window in pixels.
    """
    from selenium import webdriver

    places = [shutil.which(name) for name in ("chromium", "chromedriver")]
    if None in places:
        words = "needs chromium and chromedriver (Debian: apt install chromium chromium-driver)"
        if os.environ.get("CI"):
            pytest.fail(words)
        pytest.skip(words)
    options = webdriver.ChromeOptions()
    options.binary_location = places[0]
    for word in (
        "--headless=new",
        "--no-sandbox",
        "--disable-dev-shm-usage",
        "--window-size={},{}".format(*size),
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--ignore-gpu-blocklist",
        "--host-resolver-rules=MAP * ~NOTFOUND , EXCLUDE 127.0.0.1",
    ):
        options.add_argument(word)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    service = webdriver.ChromeService(places[1])
    driver = webdriver.Chrome(options, service)
    driver.set_page_load_timeout(PATIENCE)
    driver.set_script_timeout(PATIENCE)
    try:
        yield driver
    finally:
        driver.quit()


@contextmanager
def phone(driver: Any, width: int, height: int) -> Iterator[None]:
    """Show pages as a phone does, in a window of a size in pixels."""
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": True}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    try:
        yield
    finally:
        driver.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def patiently(ask: Callable[[], Any]) -> Any:
    """Return the first answer that is one: a page answers late while it draws."""
    from selenium.common.exceptions import WebDriverException

    end, last = time.monotonic() + PATIENCE, None
    while time.monotonic() < end:
        try:
            if answer := ask():
                return answer
        except WebDriverException as error:
            last = error
        time.sleep(0.1)
    raise TimeoutError(f"the page did not answer within {PATIENCE} s: {last}")


def complaints(driver: Any) -> list[str]:
    """Return the errors of pages since the last call."""
    return [entry["message"] for entry in driver.get_log("browser") if entry["level"] == "SEVERE"]
