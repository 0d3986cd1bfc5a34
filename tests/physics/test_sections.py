"""Tests of wheel cross-sections: normals, curvature and drawings against closed forms."""

import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import ZipFile

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from helpers.cases import ROOT, hills
from helpers.commands import refuses
from slipfree import Analytic, ModelError, direct_kinematics, settle, simulate
from slipfree.catalog import three_wheeler
from slipfree.models.montana import montana_kinematics, patch
from slipfree.vehicle import sections


@dataclass(frozen=True)
class OffsetTorus(sections.Section):
    """A torus whose tread lies beside the wheel's centre."""

    tube: float
    circle: float
    offset: float

    def profile(self, axial, radial):
        return self.offset + self.tube * axial, self.circle + self.tube * radial


@dataclass(frozen=True)
class Ellipsoid(sections.Section):
    """An ellipsoid of revolution about the axle."""

    half_width: float
    equator: float

    def profile(self, axial, radial):
        x, rho = self.half_width**2 * axial, self.equator**2 * radial
        scale = ca.sqrt(axial * x + radial * rho)
        return x / scale, rho / scale


SMOOTH = {
    "torus": sections.Torus(0.05, 0.25),
    "sphere": sections.Sphere(0.3),
    "omni": sections.Omni(sections.Torus(0.02, 0.08)),
    "offset": OffsetTorus(0.05, 0.25, 0.02),
    "ellipsoid": Ellipsoid(0.1, 0.3),
}
SECTIONS = SMOOTH | {"disc": sections.Disc(0.3)}
U, V = ca.SX.sym("u"), ca.SX.sym("v")


def angles(rng, count=50):
    """Return random angles of normals, and the normals, shapes (count,) and (count, 3)."""
    u, v = rng.uniform(0.1, np.pi - 0.1, count), rng.uniform(0, 2 * np.pi, count)
    return u, v, np.stack([np.cos(u), np.cos(v) * np.sin(u), np.sin(v) * np.sin(u)], axis=-1)


@pytest.mark.parametrize("name", SECTIONS)
def test_support_and_point_are_one_surface_in_any_axes(rng, name):
    section, (n, a) = SECTIONS[name], (ca.SX.sym("n", 3), ca.SX.sym("a", 3))
    support = ca.Function("support", [n, a], [section.support(n, a)])
    general = ca.Function("general", [n, a], [sections.Section.support(section, n, a)])
    own = ca.Function("own", [n], [section.support(n)])
    point = ca.Function("point", [U, V], [section.point(U, V)])
    for u, v, normal in zip(*angles(rng), strict=True):
        expected = np.array(point(u, v)).ravel()
        assert_allclose(np.array(own(normal)).ravel(), expected, atol=1e-15)
        turn = Rotation.random(random_state=rng).as_matrix()
        for found in (support, general):
            world = np.array(found(turn @ normal, turn[:, 0])).ravel()
            assert_allclose(world, turn @ expected, atol=1e-15)


@pytest.mark.parametrize("name", SMOOTH)
def test_normals_and_curvatures_are_those_of_the_surface(rng, name):
    """The radius of the section is its principal one; rho over the radial component the other."""
    section, uv = SMOOTH[name], ca.vertcat(U, V)
    _, frame, forms = patch(section.point(U, V), uv)
    c, s = ca.SX.sym("c"), ca.SX.sym("s")
    radii = [found.tread_radius(section, c, s) for found in (type(section), sections.Section)]
    surface = ca.Function("surface", [uv], [frame[:, 2], forms.curvature])
    radius = ca.Function("radius", [c, s], radii)
    for u, v, normal in zip(*angles(rng), strict=True):
        found, curvature = (np.array(each) for each in surface([u, v]))
        assert_allclose(found.ravel(), normal, atol=1e-14)
        _, rho = section.outline(np.array(u))
        for each in radius(np.cos(u), np.sin(u)):
            expected = np.diag([1 / float(each), np.sin(u) / rho])
            assert_allclose(curvature, expected, rtol=1e-12, atol=1e-12)


def test_supports_of_an_ellipsoid_have_a_closed_form(rng):
    """The support function is ``sqrt(b^2 n_x^2 + R^2 (n_y^2 + n_z^2))``."""
    u, _, n = angles(rng)
    x, rho = SMOOTH["ellipsoid"].outline(u)
    expected = np.sqrt((0.1 * n[:, 0]) ** 2 + (0.3 * np.sin(u)) ** 2)
    assert_allclose(np.cos(u) * x + np.sin(u) * rho, expected, rtol=1e-14)
    assert_allclose((x / 0.1) ** 2 + (rho / 0.3) ** 2, 1, rtol=1e-14)


def test_meshes_are_closed_and_on_the_surface():
    for name, volume in (
        ("torus", 2 * np.pi**2 * 0.25 * 0.05**2),
        ("sphere", 4 / 3 * np.pi * 0.3**3),
        ("ellipsoid", 4 / 3 * np.pi * 0.1 * 0.3**2),
    ):
        mesh = SECTIONS[name].mesh()
        a, b, c = np.moveaxis(mesh.vertices[mesh.faces.astype(int)], 1, 0)
        assert_allclose((a * np.cross(b, c)).sum() / 6, volume, rtol=0.15)
        assert_allclose(np.hypot(*mesh.vertices[:, 1:].T).max(), 0.3)
    # narrow sections are drawn a little wide
    for section, circle, tube in (
        (SECTIONS["torus"], 0.25, 0.05),
        (sections.Disc(0.3), 0.288, 0.012),
        (sections.Torus(0.004, 0.296), 0.288, 0.012),
    ):
        x, y, z = section.mesh().vertices.T
        assert_allclose(np.hypot(np.hypot(y, z) - circle, x), tube, rtol=1e-12)


def test_arc_lengths():
    u, length = sections.arc_lengths(sections.Torus(0.05, 0.25))
    assert_allclose(length, 0.05 * u, rtol=1e-5)
    assert sections.arc_lengths(sections.Disc(0.3))[1].max() == 0


def test_radii_name_the_torus_or_its_limits():
    assert sections.section_of_radii(0.05, 0.25) == sections.Torus(0.05, 0.25)
    assert sections.section_of_radii(0.0, 0.3) == sections.Disc(0.3)
    assert sections.section_of_radii(0.3, 0.0) == sections.Sphere(0.3)
    rolling = sections.Omni(sections.Disc(0.3))
    assert sections.section_of_radii(0.0, 0.3, rollers=np.pi / 2) == rolling
    assert str(rolling) == "disc radius 0.3 m on rollers at 90 degrees"
    assert str(sections.Torus(0.05, 0.25)) == "torus r1 0.05, r2 0.25 m"


def test_dimensions_that_are_not_positive_are_refused():
    for value in (0.0, np.nan):
        refuses(ModelError, r"Torus: r1: expected a (finite )?number", sections.Torus, value, 0.25)


@pytest.mark.slow
@pytest.mark.parametrize("model", [direct_kinematics, montana_kinematics])
def test_an_offset_tread_is_a_wheel_beside_its_place(model):
    """A section need not be symmetric: the same motion as of wheels that are moved instead."""
    vehicle, ground, runs = three_wheeler(), Analytic(hills), []
    for shift, section in ((0.0, SECTIONS["offset"]), (0.02, SECTIONS["torus"])):
        wheels = tuple(
            replace(wheel, at=(wheel.at[0] + shift, *wheel.at[1:]), section=section)
            for wheel in vehicle.wheels
        )
        twin = replace(vehicle, wheels=wheels)
        start, dae = settle(direct_kinematics(twin, ground), heading=0.3), model(twin, ground)
        rates = dae.inputs(right_rate=0.5, left_rate=0.4, steer_rate=0.1)
        runs.append(simulate(dae, start, rates, np.linspace(0, 1, 5)))
    for name in ("x", "y", "z", "heading", "contact_x", "contact_z", "relative_curvature"):
        assert_allclose(runs[0][name], runs[1][name], atol=1e-6, err_msg=name)
    assert_allclose(runs[0]["clearance"], runs[1]["clearance"], atol=1e-6)


SOURCES = ("src", "problems", "pyproject.toml", "README.md", "LICENSE")


def _done(command: list[str], folder: Path, **more: str) -> str:
    """Return what a program prints that must succeed."""
    found = subprocess.run(
        command, cwd=folder, env=os.environ | more, capture_output=True, text=True, check=False
    )
    assert found.returncode == 0, found.stdout + found.stderr
    return found.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from a copy of the sources, without network."""
    copy = tmp_path_factory.mktemp("sources")
    skipped = shutil.ignore_patterns("__pycache__", "*.egg-info")
    for name in SOURCES:
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, copy / name, symlinks=True, ignore=skipped)
        else:
            shutil.copy(ROOT / name, copy)
    build = "from setuptools.build_meta import build_wheel; build_wheel('dist')"  # as pip calls it
    _done([sys.executable, "-c", build], copy)
    (found,) = (copy / "dist").glob("*.whl")
    return found


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, str]:
    """Install the wheel in a folder of its own; return what makes Python take it from there."""
    target = tmp_path_factory.mktemp("target")
    options = ["--quiet", "--no-deps", "--no-index", "--no-compile", "--target", str(target)]
    _done([sys.executable, "-m", "pip", "install", *options, str(wheel)], target)
    return {"PYTHONPATH": str(target)}


def _files(folder: Path) -> dict[str, bytes]:
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*.*")}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("packed", "folder"),
    [
        ("slipfree/problems/", ROOT / "problems"),
        ("slipfree/starters/", ROOT / "src" / "slipfree" / "starters"),
    ],
)
def test_it_holds_the_problems_as_they_are(wheel: Path, packed: str, folder: Path) -> None:
    with ZipFile(wheel) as file:
        held = {
            name.removeprefix(packed): file.read(name)
            for name in file.namelist()
            if name.startswith(packed)
        }
    assert held == _files(folder)
    assert held


def test_it_holds_the_modules_and_nothing_else(wheel: Path) -> None:
    with ZipFile(wheel) as file:
        names = {name for name in file.namelist() if name.endswith(".py")}
    sources = ROOT / "src"
    assert names == {path.relative_to(sources).as_posix() for path in sources.rglob("*.py")}


@pytest.mark.slow
def test_installed_it_lists_copies_and_runs(installed: Mapping[str, str], tmp_path: Path) -> None:
    command = [sys.executable, "-m", "slipfree"]
    where = _done(
        [sys.executable, "-c", "import slipfree; print(slipfree.__file__)"], tmp_path, **installed
    )
    assert where.startswith(installed["PYTHONPATH"])
    listed = _done([*command, "examples"], tmp_path, **installed)
    for name in filter(lambda each: each.endswith(".toml"), _files(ROOT / "problems")):
        assert f"\n{name.removesuffix('.toml')} " in f"\n{listed}"
    _done([*command, "examples", "your_vehicle"], tmp_path, **installed)
    settings = ["--set", "time.duration=1", "--no-draw"]
    _done([*command, "run", "your_vehicle.toml", *settings], tmp_path, **installed)
    assert (tmp_path / "your_vehicle.nc").is_file()
    _done([*command, "new", "direct", "mine"], tmp_path, **installed)
    assert _done([*command, "check", "mine.toml"], tmp_path, **installed).startswith("ok ")
