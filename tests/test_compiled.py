"""Elements with calls, compiled and interpreted: one program; and what is kept of the former."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from warnings import catch_warnings

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose
from typer.testing import CliRunner

from slipfree import (
    Bicubic,
    Grid,
    ModelError,
    calls,
    compiled,
    direct_kinematics,
    settle,
    simulate,
    straight,
    three_wheeler,
)
from slipfree.cli import app
from slipfree.named import leaves
from slipfree.plan.assemble import assembled
from slipfree.plan.element import element
from slipfree.plan.task import task_of
from slipfree.plan.transcribe import Mesh, transcribe
from slipfree.solve.loop import close

QUICK = ("-O0", *compiled.FLAGS[1:])
needs_compiler = pytest.mark.skipif(compiled.compiler() is None, reason="no C compiler here")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A cache of the test's own; what is optimised takes seconds."""
    monkeypatch.setattr(compiled, "FLAGS", QUICK)
    monkeypatch.setenv(compiled.FOLDER, str(tmp_path))
    return tmp_path


def hilly(seed):
    x, y = np.arange(-4.0, 5.0), np.arange(-4.0, 6.0)
    return Bicubic(Grid(x, y, 0.05 * np.random.default_rng(seed).normal(size=(x.size, y.size))))


def program(seed, *, build=False):
    dae = direct_kinematics(three_wheeler(axle="fixed"), hilly(seed))
    dae = replace(dae, compiled=build)
    task = task_of(dae, settle(dae), goal={"y": 1.0}, costs={"slip": 1.0, "effort": 0.01},
                   duration=(4.0, 6.0), limits={"steer": (-1.0, 1.0)})  # fmt: skip
    return transcribe(task, Mesh(np.linspace(0, 1, 3), 2))


def driven(seed, *, build=False):
    """Return a model on a map, its start, and a law that feeds the state back."""
    vehicle = three_wheeler()
    dae = replace(direct_kinematics(vehicle, hilly(seed)), compiled=build)
    start = settle(dae)
    return dae, start, straight(dae, vehicle, start, speed=0.3)


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


def library(factor=1.0):
    return compiled.library(f"squares {factor}", ["squares"], lambda: squares(factor))


def kept(factor=1.0):
    """Return what is in the cache, without compiling."""
    with pytest.MonkeyPatch.context() as patch, catch_warnings(action="ignore"):
        patch.setattr(compiled, "compiler", lambda: None)
        return library(factor)


@pytest.mark.parametrize("build", [False, pytest.param(True, marks=needs_compiler)])
def test_calls_are_differentiated_with_the_rest(build, rng, monkeypatch):
    """Of several matrices, one taking the results of the other, one rounded off."""
    monkeypatch.setattr(calls, "LARGE", 0)
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
    one = element((v, q, p), cost, rows, where, places, constants, compiled=build)
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
    found = program(1, build=True)
    assert found.compiled
    for one, other in zip(everything(found, np.random.default_rng(0)), plain, strict=True):
        assert_allclose(one, other, rtol=1e-11, atol=1e-11)
    assert program(2, build=True).compiled
    files = sorted(folder.iterdir())
    assert len(files) == 2  # one of the motion, one of the program
    code = (
        "from test_compiled import QUICK, compiled, program\n"
        "compiled.FLAGS = QUICK\n"
        "print(program(3, build=True).compiled)"
    )
    path = os.pathsep.join([os.path.dirname(__file__), *sys.path])  # noqa: PTH120
    told = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": path, "PYTHONHASHSEED": "3"},
    )  # fmt: skip
    assert told.stdout.strip() == "True"
    assert sorted(folder.iterdir()) == files


@needs_compiler
def test_a_compiled_motion_is_the_interpreted_one_on_every_ground(folder, monkeypatch):
    """Equations and Jacobian with a law that feeds back, and the motion; one library for all."""
    t = np.linspace(0, 2, 5)
    for seed in (1, 2):
        runs = [simulate(*driven(seed, build=build), t, tolerance=1e-9) for build in (False, True)]
        plain, found = (close(dae, law, 4) for dae, _, law in
                        (driven(seed, build=build) for build in (False, True)))  # fmt: skip
        assert found.core.jacobian().n_instructions() < 100  # of calls
        dae, last = driven(seed)[0], runs[0]
        x, z = dae.rows("x", last, -1), dae.rows("z", last, -1)[: plain.moving]
        for one, other in ((plain.core, found.core), (plain.core.jacobian(), found.core.jacobian()),
                           (plain.newton, found.newton)):  # fmt: skip
            given = [1.7, x, z, plain.u[:, 0], 0, 0][: one.n_in()]
            for a, b in zip(one.call(given), other.call(given), strict=True):
                assert_allclose(np.array(ca.DM(a)), np.array(ca.DM(b)), rtol=1e-11, atol=1e-11)
        for name in ("x", "y", "heading"):
            assert_allclose(runs[1][name], runs[0][name], atol=1e-7)
        assert len(list(folder.iterdir())) == 1
        monkeypatch.setenv("CC", "false")


def test_the_jacobian_of_a_motion_under_a_law_is_that_of_its_expressions():
    dae, start, law = driven(1)
    loop = close(dae, law, 4)
    x, z, u = dae.columns()
    m = z[: loop.moving]
    rows = ca.vertcat(dae.ode, ca.vertcat(*dae.alg)[: loop.moving])
    rows = ca.substitute(rows, u, ca.vertcat(*leaves(law)))
    exact = ca.Function("exact", [dae.t, x, m], [calls.jacobian(rows, ca.vertcat(x, m))])
    at = [0.4, dae.rows("x", start, -1), dae.rows("z", start, -1)[: loop.moving]]
    t, x, m, u = loop.core.mx_in()
    found = ca.Function("found", [t, x, m], [
        ca.jacobian(ca.vertcat(*loop.core(t, x, m, loop.u[:, 0])), ca.vertcat(x, m))
    ])  # fmt: skip
    expected = np.array(ca.DM(exact(*at)))
    assert np.abs(expected).max() > 1
    assert_allclose(np.array(ca.DM(found(*at))), expected, rtol=1e-11, atol=1e-11)


def spoilt(file, content):
    """Put something else in the place of a file; what is loaded from it stays."""
    file.unlink(missing_ok=True)
    file.write_bytes(content)


@needs_compiler
def test_what_is_kept_is_used_again_and_what_is_broken_made_again(folder):
    assert kept() is None
    (f,) = library()
    assert float(f([3.0, 4.0])) == 25.0
    (file,) = folder.iterdir()
    (again,) = compiled.library("squares 1.0", ["squares"], lambda: 1 / 0)
    assert float(again([1.0, 2.0])) == 5.0
    content = file.read_bytes()
    spoilt(file, content[: len(content) // 2])
    assert kept() is None
    assert not list(folder.iterdir())
    (mended,) = library()
    assert float(mended([1.0, 1.0])) == 2.0
    spoilt(file, b"")
    named = file.with_name(f"{file.name.split('.')[0]}.{compiled.digest(b'no library')}.so")
    spoilt(named, b"no library")
    assert kept() is None  # as it was written, but nothing that can be loaded
    (other,) = library(2.0)
    assert float(other([1.0, 1.0])) == 4.0


@needs_compiler
def test_only_the_newest_are_kept(folder, monkeypatch):
    monkeypatch.setattr(compiled, "KEPT", 2)
    for number in range(3):
        library(float(number))
        for file in folder.iterdir():
            os.utime(file, (file.stat().st_mtime - 10,) * 2)
    assert len(list(folder.iterdir())) == 2
    assert [kept(float(k)) is None for k in range(3)] == [True, False, False]


@pytest.mark.parametrize(("what", "words"), [
    ("no compiler", "no C compiler was found"), ("one that fails", "false did not do its work"),
    ("one that does nothing", "true: expected a C compiler, found that it made no library"),
    ("no folder", "SLIPFREE_CACHE is empty"), ("no place", "File exists"),
    ("nobody's home", "expected a folder, found '~no user/x' of a user who has no home folder"),
    ("open to others", "others cannot write to"),
])  # fmt: skip
def test_where_nothing_can_be_compiled_a_warning_says_why(what, words, folder, monkeypatch):
    if what == "no compiler":
        monkeypatch.setattr(shutil, "which", lambda _: None)
    elif what == "one that fails":
        monkeypatch.setenv("CC", "false")
    elif what == "one that does nothing":
        monkeypatch.setenv("CC", "true")
    elif what == "nobody's home":
        monkeypatch.setenv(compiled.FOLDER, "~no user/x")
        assert words in compiled.obstacle()
    elif what == "no folder":
        monkeypatch.setenv(compiled.FOLDER, "")
    elif what == "no place":
        (folder / "file").touch()
        monkeypatch.setenv(compiled.FOLDER, str(folder / "file"))
    else:
        folder.chmod(0o777)
    with pytest.warns(UserWarning, match=f"interpreted, not compiled: .*{words}"):
        assert library() is None


@needs_compiler
@pytest.mark.parametrize("how", ["writable", "link"])
def test_what_others_may_have_written_is_not_loaded(how, folder, tmp_path_factory):
    library()
    (file,) = folder.iterdir()
    if how == "writable":
        file.chmod(0o777)
    else:
        elsewhere = tmp_path_factory.mktemp("elsewhere") / "other.so"
        shutil.copy(file, elsewhere)
        file.unlink()
        file.symlink_to(elsewhere)
    assert kept() is None
    assert not list(folder.iterdir())


@needs_compiler
def test_what_a_killed_compiler_left_is_removed_some_day(folder):
    left, at_work = folder / f"{compiled.SCRATCH}1", folder / f"{compiled.SCRATCH}2"
    for place in (left, at_work):
        place.mkdir()
    os.utime(left, (0, 0))
    library()
    assert not left.exists()
    assert at_work.exists()


@needs_compiler
def test_another_process_that_tidies_up_does_no_harm(folder, monkeypatch):
    library(2.0)
    (file,) = folder.iterdir()
    of_file = Path.stat

    def vanishing(path, **options):
        if path == file:
            raise FileNotFoundError(path)
        return of_file(path, **options)

    monkeypatch.setattr(Path, "stat", vanishing)
    assert library() is not None


@needs_compiler
def test_calls_that_take_numbers_elsewhere_are_other_functions(monkeypatch):
    """Of ``f(v, 3)`` and ``f(3, v)`` the sums are the same, and the derivatives are not."""
    monkeypatch.setattr(calls, "LARGE", 0)
    a, b = ca.MX.sym("a"), ca.MX.sym("b")
    power = ca.Function("power", [a, b], [a**2 * b], {"never_inline": True})
    v, none, at = ca.SX.sym("v"), ca.SX.sym("none", 0), np.zeros((1, 1), dtype=int)
    for given, slope in (((v, 3.0), 12.0), ((3.0, v), 9.0)):
        one = element((v, none, none), ca.SX(0), power(*given), at, at, np.zeros((1, 0)),
                      compiled=True)  # fmt: skip
        assert not one.parts.rows.is_a("SXFunction")
        assert float(assembled([one], np.ones(1), 0).jacobian(2.0, [])[1]) == slope


@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize(("verb", "settings"), [
    ("direct", ["time.duration=0.5"]), ("inverse", ["time.duration=0.4"]),
    ("climb", ["time.duration=0.01"]),
])  # fmt: skip
def test_problems_ask_for_it_and_a_warning_says_if_it_is_not_done(
    verb, settings, tmp_path, monkeypatch
):
    monkeypatch.setenv(compiled.FOLDER, "")
    monkeypatch.chdir(tmp_path)
    words = [word for setting in ("solver.compiled=true", "solver.tolerance=1e-4", *settings)
             for word in ("--set", setting)]  # fmt: skip
    assert CliRunner().invoke(app, ["new", verb, "p"]).exit_code == 0
    result = CliRunner().invoke(app, ["run", "p.toml", "--no-draw", *words])
    assert result.exit_code in (0, 1), result.output
    words = "warning: equations are interpreted, not compiled: SLIPFREE_CACHE is empty"
    assert result.stderr.count(words) == 1


def test_a_sweep_says_it_once_whatever_its_processes_find(tmp_path, monkeypatch, capfd):
    monkeypatch.setenv(compiled.FOLDER, "")
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, ["new", "direct", "p"]).exit_code == 0
    words = [word for setting in ("solver.compiled=true", "time.duration=0.2")
             for word in ("--set", setting)]  # fmt: skip
    sweep = ["sweep", "p.toml", "--repeat", "2", "--processes", "2", "--no-draw", *words]
    result = CliRunner().invoke(app, sweep)
    assert result.exit_code == 0, result.output
    assert result.stderr.count("are interpreted, not compiled: SLIPFREE_CACHE is empty") == 1
    assert "UserWarning" not in capfd.readouterr().err


def test_a_program_without_a_compiler_is_interpreted(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with pytest.warns(UserWarning, match="no C compiler was found"):
        assert not program(1, build=True).compiled


def test_a_function_whose_slopes_take_its_results_is_refused():
    p, root = ca.SX.sym("p"), ca.SX.sym("root")
    slope = ca.Function("jac_root", [p, root], [1 / (2 * root)])
    options = {"custom_jacobian": slope, "never_inline": True}
    function = ca.Function("root", [p], [ca.sqrt(p)], options)
    (call,) = calls.lifted([p], [function.call([p], False, True)[0]]).calls
    assert len(call.orders(1)) == 2
    with pytest.raises(ModelError, match="found root, whose Jacobian takes its results"):
        call.orders(2)


def test_the_cache_is_in_the_folder_of_the_user(monkeypatch):
    monkeypatch.delenv(compiled.FOLDER)
    assert compiled.folder().parent.name == "slipfree"
    monkeypatch.setenv(compiled.FOLDER, "~/elsewhere")  # as it may come from no shell
    assert compiled.folder() == Path.home() / "elsewhere"
