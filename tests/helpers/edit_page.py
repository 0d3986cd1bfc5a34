"""Page of ``slipfree edit`` in a browser, shared by its tests and a benchmark."""

from __future__ import annotations

import hashlib
import json
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

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

[[keep_out]]  # rock
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
    """Server of a problem file and its page in a browser.

    Parameters
    ----------
    driver : WebDriver
        The browser.
    file : Path
        Problem file, which exists.
    """

    def __init__(self, driver: Any, file: Path) -> None:
        self.driver, self.file, self.port = driver, file, 0
        self.start()

    def start(self) -> None:
        """Start the server, on its former port if it had one, and open the address it prints."""
        command = [sys.executable, "-m", "slipfree", "edit", str(self.file), "--no-browser"]
        command += ["--port", str(self.port)] if self.port else []
        self.process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        line = self.process.stderr.readline() if self.process.stderr else ""
        self.address = line.split()[0]
        self.port = int(self.address.split(":")[2].split("/")[0])

    def open(self) -> None:
        """Open the address in the present tab, and wait for the places."""
        self.driver.get(self.address)
        until(lambda: self.driver.find_elements("id", "handle-goal"))

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
        until(lambda: self.run(f"return base?.revision === '{revision}'"))

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
        found: dict[str, Any] = json.loads(self.run("return JSON.stringify(places)"))
        return found

    def line(self) -> str:
        """Return the report of the page."""
        return str(self.driver.find_element("id", "line").text)

    def error(self) -> str:
        """Return the error message of the page."""
        return str(self.driver.find_element("id", "error").text)


def until(ask: Callable[[], Any]) -> Any:
    """Return the first answer that is true."""
    end = time.monotonic() + PATIENCE
    while time.monotonic() < end:
        if answer := ask():
            return answer
        time.sleep(0.05)
    raise TimeoutError(f"no answer within {PATIENCE} s")


def shapes_in(data: dict[str, Any]) -> list[Any]:
    """Return the regions of a problem file as the page lists them."""
    return [
        [each["points"], None] if "points" in each else [[[each["x"], each["y"]]], each["radius"]]
        for each in data.get("keep_out", ())
    ]


def remove_save_plan_save(page: EditPage, region: int, pause: float) -> None:
    """Remove a region, save, plan, turn the start and save; check the file after each save.

    Parameters
    ----------
    page : EditPage
        The page.
    region : int
        Index of the region to remove.
    pause : float
        Time between two commands. [s]
    """
    text = PROBLEM + REGIONS
    page.write(text)
    page.run(f"chosen = {region}; draw(); buttons();")
    page.click("remove")
    page.click("save")
    time.sleep(pause)
    page.click("plan")
    time.sleep(pause)
    page.run("remember(); places.start[2] = 0.05; draw();")
    page.click("save")
    page.rest()
    page.click("cancel")
    page.rest()
    found = page.file.read_text(encoding="utf-8")
    data, wanted = tomllib.loads(found), tomllib.loads(text)
    shown = [[each["points"], each["radius"]] for each in page.places()["regions"]]
    del wanted["keep_out"][region]
    wanted["start"]["heading"] = 0.05
    assert data == wanted
    assert shown == shapes_in(data)
    comments = ["# east of the origin [m]", "# rock", "# a tree", "# pond"]
    comments.remove(("# rock", "", "# pond")[region]) if region != 1 else None
    assert [each for each in comments if each not in found] == []
    assert page.error() == ""
