"""Add a wheel section: one file and one line of registration.

The class `Ellipsoid` below is the file (12 lines; 21 with a docstring and imports), and
``SECTIONS["ellipsoid"] = Ellipsoid`` the line; nothing else of the package knows it. Vehicle files,
commands, both formulations of the contact, the certificate and the drawings take it as it is.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from helpers.commands import invoke, sets, shown
from slipfree.core.schema import Length
from slipfree.core.trajectory import Trajectory
from slipfree.files.netcdf import read
from slipfree.show.scene import Driven, drive_scene
from slipfree.vehicle.sections import SECTIONS, Section


@dataclass(frozen=True)
class Ellipsoid(Section):
    """An ellipsoid of revolution about the axle."""

    half_width: Length
    equator: Length

    def profile(self, axial: ca.SX, radial: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Return the point of the ellipse with a given outward normal."""
        x, rho = self.half_width**2 * axial, self.equator**2 * radial
        size = ca.sqrt(axial * x + radial * rho)
        return x / size, rho / size


B, R = 0.1, 0.3  # half-axes [m]
RATE = 0.8
WHEEL = """\
[[wheels]]
name = "{}"
parent = "platform"
section = "ellipsoid"
half_width = 0.1
equator = 0.3
at = {}
axle = [{cos!r}, 0, {sin!r}]
driven = {}
"""
WHEELS = (("right", [0.5, 0, 0]), ("left", [-0.5, 0, 0]), ("front", [0, 0.8, 0]))
PROBLEM = f"""\
verb = "direct"
terrain.file = "ground.npz"
vehicle.file = "trike.toml"
start = {{}}
inputs = {{ right_rate = {RATE}, left_rate = {RATE} }}
time = {{ duration = 1.0, step = 0.25 }}
"""


@pytest.fixture
def write(folder: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Register the section; return a function that writes ground, vehicle and problem."""
    monkeypatch.setitem(SECTIONS, "ellipsoid", Ellipsoid)

    def write(height: Callable[[Any, Any], Any], camber: float) -> None:
        x = np.linspace(-3, 3, 61)
        np.savez("ground.npz", x=x, y=x, z=height(*np.meshgrid(x, x, indexing="ij")))
        text = 'name = "trike"\nframe = "paper"\n'
        for name, at in WHEELS:
            sine = np.sin(camber) * (-1 if name == "left" else 1)
            axle = {"cos": float(np.cos(camber)), "sin": float(sine)}
            text += WHEEL.format(name, at, str(name != "front").lower(), **axle)
        (folder / "trike.toml").write_text(text, encoding="utf-8")
        (folder / "p.toml").write_text(PROBLEM, encoding="utf-8")

    return write


def run(*settings: str) -> Trajectory:
    invoke("run", "p.toml", "--no-draw", *sets(*settings))
    return read("p.nc")


def span(motion: Trajectory, name: str, wheel: str) -> np.ndarray:
    return np.stack([motion[f"{name}_{axis}", wheel] for axis in "xyz"], axis=-1)


@pytest.mark.slow
@pytest.mark.parametrize(("camber", "slope"), [(0.0, 0.0), (0.3, 0.2)])
def test_it_rolls_as_the_closed_form_says(write, camber, slope):
    """On a plane, wheels with camber g stand h high and roll on a circle of radius R^2 cos g / h.

    ``h^2 = R^2 cos^2 g + B^2 sin^2 g`` is the support function; the contact point lies
    ``(R^2 - B^2) sin g cos g / h`` beside the foot of the wheel's centre.
    """
    write(lambda _, y: slope * y, camber)
    motion = run()
    height = np.hypot(R * np.cos(camber), B * np.sin(camber))
    along = np.array([0, 1, slope]) / np.hypot(1, slope)
    right, up = np.array([1.0, 0, 0]), np.cross([1.0, 0, 0], along)
    beside = (R**2 - B**2) * np.sin(camber) * np.cos(camber) / height
    for wheel, sign in (("right", 1), ("left", -1), ("front", 1)):
        center, contact = span(motion, "center", wheel), span(motion, "contact", wheel)
        expected = np.tile(sign * beside * right - height * up, (motion.t.size, 1))
        assert_allclose(contact - center, expected, atol=1e-9)
        way = RATE * R**2 * np.cos(camber) / height * motion.t
        assert_allclose(center - center[0], np.outer(way, along), atol=1e-8)
        assert_allclose(motion["wheel_rate", wheel], RATE, rtol=1e-8)
    for name in ("slip_along", "slip_across"):
        assert_allclose(motion[name], 0, atol=1e-12)


def test_both_formulations_agree_on_hills(write):
    write(lambda x, y: 0.08 * np.sin(1.3 * x) * np.cos(0.9 * y), 0.2)
    closure, montana = run(), run("formulation=montana")
    for name in ("x", "y", "z", "heading", "contact_x", "contact_y", "wheel_u", "wheel_v"):
        assert_allclose(montana[name], closure[name], atol=1e-7, err_msg=name)


def test_it_is_drawn(write):
    write(lambda x, y: 0 * x * y, 0.0)
    run()
    drive = shown(Path("p.nc"), "ellipsoid")
    assert isinstance(drive, Driven)
    bodies = {body.name: body for body in drive_scene([drive]).actors[0].bodies}
    x, y, z = bodies["front"].meshes[0][0].vertices.T
    assert_allclose((x / B) ** 2 + (y**2 + z**2) / R**2, 1, rtol=1e-12)
    invoke("show", "p.nc", "--html", "page.html")
    assert Path("page.html").stat().st_size > 1e5
    assert "ellipsoid half_width 0.1, equator 0.3 m" in invoke("vehicle", "trike.toml", "-v").stdout
