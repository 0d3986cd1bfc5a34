"""Elements with calls, compiled and interpreted: one program; and what is kept of the former."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from slipfree import Bicubic, Grid, compiled, direct_kinematics, settle, three_wheeler
from slipfree.plan import element as module
from slipfree.plan.assemble import assembled
from slipfree.plan.element import element
from slipfree.plan.task import task_of
from slipfree.plan.transcribe import Mesh, transcribe

QUICK = ("-O0", *compiled.FLAGS[1:])
needs_compiler = pytest.mark.skipif(compiled.compiler() is None, reason="no C compiler here")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A cache of the test's own; what is optimised takes seconds."""
    monkeypatch.setattr(compiled, "FLAGS", QUICK)
    monkeypatch.setenv(compiled.FOLDER, str(tmp_path))
    return tmp_path


def program(seed, *, build=False):
    x, y = np.arange(-4.0, 5.0), np.arange(-4.0, 6.0)
    heights = 0.05 * np.random.default_rng(seed).normal(size=(x.size, y.size))
    dae = direct_kinematics(three_wheeler(axle="fixed"), Bicubic(Grid(x, y, heights)))
    task = task_of(dae, settle(dae), goal={"y": 1.0}, costs={"slip": 1.0, "effort": 0.01},
                   duration=(4.0, 6.0), limits={"steer": (-1.0, 1.0)})  # fmt: skip
    return transcribe(replace(task, compiled=build), Mesh(np.linspace(0, 1, 3), 2))


def everything(made, rng):
    """Return all that a program evaluates, at a random place."""
    w, p = rng.normal(size=made.scale.size) * 0.3, rng.uniform(size=3)
    prices = rng.normal(size=made.g_lower.size)
    names = [made.problem[name] for name in "xp"], [made.problem[name] for name in "fg"]
    found = [*ca.Function("values", *names)(w, p), made.gradient(w, p)[1], *made.jacobian(w, p),
             made.hessian(w, p, 0.4, prices)]  # fmt: skip
    return [np.array(ca.DM(each)) for each in found]


def squares(factor):
    x = ca.SX.sym("x", 2)
    return [ca.Function("squares", [x], [factor * ca.sumsqr(x)])]


def library(factor=1.0, *, build):
    return compiled.library(f"squares {factor}", ["squares"], lambda: squares(factor), build=build)


@pytest.mark.parametrize("build", [False, pytest.param(True, marks=needs_compiler)])
def test_calls_are_differentiated_with_the_rest(build, rng, monkeypatch):
    """Of several matrices, one taking the results of the other, one rounded off."""
    monkeypatch.setattr(module, "LARGE", 0)
    a, b = ca.MX.sym("a", 2, 2), ca.MX.sym("b")
    first = ca.Function("first", [a, b], [b * a @ a, ca.sum1(ca.sin(a))], {"never_inline": True})
    other = ca.Function("other", [b], [ca.exp(b / 5) * b], {"never_inline": True})

    def formula(v, q, p):
        product, total = first(ca.reshape(ca.vertcat(v[:2], v[0] * v[2], 0.7), 2, 2), v[3])
        again = other(product[0, 1] * v[1] + p[0])
        rows = ca.vertcat(ca.vec(product) * q, again * v[2], ca.floor(3 * other(v[0])) * v[1])
        return p[1] * ca.sumsqr(total) + again, rows

    v, q, p = ca.SX.sym("v", 4), ca.SX.sym("q"), ca.SX.sym("p", 2)
    cost, rows = formula(v, q, p)
    where, constants = np.array([[0, 1, 2, 3], [3, 2, 1, 1]]), np.array([[1.0], [-2.0]])
    places, scale = np.arange(12).reshape(2, 6), np.array([1.0, 0.5, 3.0, 1.0])
    one = element((v, q, p), cost, rows, where, places, constants, compile=build)
    assert one.parts.rows.is_a("SXFunction") != build
    assert [len(call.orders) for call in one.calls] == [3, 3, 1]
    made = assembled([one], scale, 2)
    w, p_all = ca.MX.sym("w", 4), ca.MX.sym("p", 2)
    parts = [formula((w * scale)[row.tolist()], c, p_all)
             for row, (c,) in zip(where, constants, strict=True)]  # fmt: skip
    total, g = sum(part[0] for part in parts), ca.vertcat(*(part[1] for part in parts))
    prices, at = rng.normal(size=12), (rng.normal(size=4), rng.normal(size=2))
    lagrangian = 0.4 * total + ca.dot(ca.DM(prices), g)
    expected = ca.Function("e", [w, p_all], [
        total, g, ca.gradient(total, w), ca.jacobian(g, w), ca.triu(ca.hessian(lagrangian, w)[0]),
    ])  # fmt: skip
    values = ca.Function("v", [made.w, made.p], [made.f, made.g])(*at)
    found = [*values, made.gradient(*at)[1], made.jacobian(*at)[1], made.hessian(*at, 0.4, prices)]
    for one, other in zip(found, expected(*at), strict=True):
        assert_allclose(np.array(ca.DM(one)), np.array(ca.DM(other)), rtol=1e-11, atol=1e-12)


@needs_compiler
def test_a_compiled_program_is_the_interpreted_one_on_every_ground(folder, monkeypatch):
    plain = everything(program(1), np.random.default_rng(0))
    assert not list(folder.iterdir())
    assert program(1, build=True).compiled
    monkeypatch.setenv("CC", "false")
    found = program(1)
    assert found.compiled
    for one, other in zip(everything(found, np.random.default_rng(0)), plain, strict=True):
        assert_allclose(one, other, rtol=1e-11, atol=1e-11)
    assert program(2).compiled
    (kept,) = folder.iterdir()
    code = (
        "from test_compiled import QUICK, compiled, program\n"
        "compiled.FLAGS = QUICK\n"
        "print(program(3).compiled)"
    )
    path = os.pathsep.join([os.path.dirname(__file__), *sys.path])  # noqa: PTH120
    told = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": path, "PYTHONHASHSEED": "3"},
    )  # fmt: skip
    assert told.stdout.strip() == "True"
    assert list(folder.iterdir()) == [kept]


def spoilt(file, content):
    """Put something else in the place of a file; what is loaded from it stays."""
    file.unlink(missing_ok=True)
    file.write_bytes(content)


@needs_compiler
def test_what_is_kept_is_used_again_and_what_is_broken_made_again(folder):
    assert library(build=False) is None
    (f,) = library(build=True)
    assert float(f([3.0, 4.0])) == 25.0
    (kept,) = folder.iterdir()
    (again,) = compiled.library("squares 1.0", ["squares"], lambda: 1 / 0, build=True)
    assert float(again([1.0, 2.0])) == 5.0
    content = kept.read_bytes()
    spoilt(kept, content[: len(content) // 2])
    assert library(build=False) is None
    assert not list(folder.iterdir())
    (mended,) = library(build=True)
    assert float(mended([1.0, 1.0])) == 2.0
    spoilt(kept, b"")
    named = kept.with_name(f"{kept.name.split('.')[0]}.{compiled.digest(b'no library')}.so")
    spoilt(named, b"no library")
    assert library(build=False) is None  # as it was written, but nothing that can be loaded
    (other,) = library(2.0, build=True)
    assert float(other([1.0, 1.0])) == 4.0


@needs_compiler
def test_only_the_newest_are_kept(folder, monkeypatch):
    monkeypatch.setattr(compiled, "KEPT", 2)
    for number in range(3):
        library(float(number), build=True)
        for file in folder.iterdir():
            os.utime(file, (file.stat().st_mtime - 10,) * 2)
    assert len(list(folder.iterdir())) == 2
    assert [library(float(k), build=False) is None for k in range(3)] == [True, False, False]


@pytest.mark.parametrize("what", ["no compiler", "one that fails", "no folder", "no place"])
def test_without_a_compiler_or_a_place_there_is_nothing_compiled(what, folder, monkeypatch):
    if what == "no compiler":
        monkeypatch.setattr(shutil, "which", lambda _: None)
    elif what == "one that fails":
        monkeypatch.setenv("CC", "false")
    elif what == "no folder":
        monkeypatch.setenv(compiled.FOLDER, "")
    else:
        (folder / "file").touch()
        monkeypatch.setenv(compiled.FOLDER, str(folder / "file"))
    assert library(build=True) is None


def test_a_program_without_a_compiler_is_interpreted(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda _: None)
    assert not program(1, build=True).compiled


def test_the_cache_is_in_the_folder_of_the_user(monkeypatch):
    monkeypatch.delenv(compiled.FOLDER)
    assert compiled.folder().parent.name == "slipfree"
