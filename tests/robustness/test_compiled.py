"""Tests of compiled and interpreted elements with lookups: equal programs, and the cache."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from warnings import catch_warnings

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import slipfree as sf
from helpers.commands import invoke, sets
from slipfree.catalog import three_wheeler
from slipfree.contact.touch import search_function
from slipfree.core.lookups import LookupTable
from slipfree.core.records import leaves
from slipfree.plan.problem import task_of
from slipfree.plan.sparse_assembly import assemble, nlp_block
from slipfree.plan.transcription import CollocationMesh, transcribe
from slipfree.solve.replay import apply_inputs, replay, trim_states
from slipfree.solve.settle import settle_contact
from slipfree.solve.system import _compiled_lookup, with_inputs
from slipfree.system import codegen_cache
from slipfree.vehicle.sections import Torus

pytestmark = pytest.mark.slow

QUICK = ("-O0", *codegen_cache.FLAGS[1:])
needs_compiler = pytest.mark.skipif(codegen_cache.compiler() is None, reason="no C compiler here")


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """A cache of the test's own; what is optimised takes seconds."""
    monkeypatch.setattr(codegen_cache, "FLAGS", QUICK)
    monkeypatch.setenv(codegen_cache.FOLDER, str(tmp_path))
    return tmp_path


def hilly(seed):
    x, y = np.arange(-4.0, 5.0), np.arange(-4.0, 6.0)
    return sf.Bicubic(
        sf.Grid(x, y, 0.05 * np.random.default_rng(seed).normal(size=(x.size, y.size)))
    )


def program(seed, *, build=False):
    dae = sf.direct_kinematics(three_wheeler(axle="fixed"), hilly(seed))
    options = sf.SolverOptions(compiled=build)
    task = task_of(
        dae,
        sf.settle(dae, options=options),
        goal={"y": 1.0},
        costs={"slip": 1.0, "effort": 0.01},
        duration=(4.0, 6.0),
        limits={"steer": (-1.0, 1.0)},
    )
    return transcribe(task, CollocationMesh(np.linspace(0, 1, 3), 2), options)


def driven(seed):
    """Return a model on a map, its start, and a law that feeds the state back."""
    vehicle = three_wheeler()
    dae = sf.direct_kinematics(vehicle, hilly(seed))
    start = sf.settle(dae)
    return dae, start, sf.straight(dae, start, speed=0.3)


def everything(made, rng):
    """Return all that a program evaluates, at a random place."""
    w, p = rng.normal(size=made.scale.size) * 0.3, rng.uniform(size=3)
    prices = rng.normal(size=made.g_lower.size)
    names = [made.problem[name] for name in "xp"], [made.problem[name] for name in "fg"]
    found = [
        *ca.Function("values", *names)(w, p),
        made.gradient(w, p)[1],
        *made.jacobian(w, p),
        made.hessian(w, p, 0.4, prices),
    ]
    return [np.array(ca.DM(each)) for each in found]


def squares(factor):
    x = ca.SX.sym("x", 2)
    return [ca.Function("squares", [x], [factor * ca.sumsqr(x)])]


def library(factor=1.0):
    return codegen_cache.load_or_compile(f"squares {factor}", ["squares"], lambda: squares(factor))


def kept(factor=1.0):
    """Return what is in the cache, without compiling."""
    with pytest.MonkeyPatch.context() as patch, catch_warnings(action="ignore"):
        patch.setattr(codegen_cache, "compiler", lambda: None)
        return library(factor)


@pytest.mark.parametrize("build", [False, pytest.param(True, marks=needs_compiler)])
def test_lookups_are_constants_of_the_rest(build, rng, monkeypatch):
    """Of several results, one asked for with the result of another, at places of an element."""
    monkeypatch.setattr(codegen_cache, "MIN_OPERATIONS", 0)
    a, b = ca.MX.sym("a", 2), ca.MX.sym("b", 3)
    first = ca.Function("first", [a], [ca.vertcat(ca.floor(3 * a), a[0] * a[1])])
    other = ca.Function("other", [b], [ca.floor(b[0] + b[2]) + 0.1 * ca.floor(5 * b[1])])

    def formula(v, q, p, one, two):
        rows = ca.vertcat(one * q * v[0] ** 2, two * ca.sin(v[1]) * v[3], v[2])
        return p[1] * ca.sumsqr(v) * one[0] + two, rows

    v, q, p = ca.SX.sym("v", 4), ca.SX.sym("q"), ca.SX.sym("p", 2)
    lookups = LookupTable()
    one = lookups.find(first, v[:2])
    two = lookups.find(other, ca.vertcat(v[2] * q, p[0], one[2]))
    assert lookups.find(first, v[:2]) is one
    cost, rows = formula(v, q, p, one, two)
    where, constants = np.array([[0, 1, 2, 3], [3, 2, 1, 1]]), np.array([[1.0], [-2.0]])
    places, scale = np.arange(10).reshape(2, 5), np.array([1.0, 0.5, 3.0, 1.0])
    made = nlp_block(
        (v, q, p), cost, rows, lookups.lookups, (where, places), constants, compiled=build
    )
    assert made.rows.is_a("SXFunction") != build
    made = assemble([made], scale, 2)
    at = rng.normal(size=4), rng.normal(size=2)
    w, total, g = ca.MX.sym("w", 4), ca.MX(0), list[ca.MX]()
    for row, (c,) in zip(where, constants, strict=True):
        here = (at[0] * scale)[row]
        one = first(here[:2])
        two = other(ca.vertcat(here[2] * c, at[1][0], one[2]))
        part = formula((w * scale)[row.tolist()], c, at[1], one, two)
        total, g = total + part[0], [*g, part[1]]
    g, prices = ca.vertcat(*g), rng.normal(size=10)
    lagrangian = 0.4 * total + ca.dot(ca.DM(prices), g)
    expected = ca.Function(
        "e",
        [w],
        [total, g, ca.gradient(total, w), ca.jacobian(g, w), ca.triu(ca.hessian(lagrangian, w)[0])],
    )
    values = ca.Function("v", [made.w, made.p], [made.f, made.g])(*at)
    found = [*values, made.gradient(*at)[1], made.jacobian(*at)[1], made.hessian(*at, 0.4, prices)]
    for one, other in zip(found, expected(at[0]), strict=True):
        assert_allclose(np.array(ca.DM(one)), np.array(ca.DM(other)), rtol=1e-11, atol=1e-12)


@needs_compiler
def test_a_compiled_program_is_the_interpreted_one_on_every_ground(folder, monkeypatch):
    plain = everything(program(1), np.random.default_rng(0))
    assert not list(folder.iterdir())
    assert program(1, build=True).compiled
    files = sorted(folder.iterdir())
    assert files
    monkeypatch.setenv("CC", "false")
    found = program(1, build=True)
    assert found.compiled
    for one, other in zip(everything(found, np.random.default_rng(0)), plain, strict=True):
        assert_allclose(one, other, rtol=1e-11, atol=1e-11)
    assert program(2, build=True).compiled
    code = (
        "from test_compiled import QUICK, codegen_cache, program\n"
        "codegen_cache.FLAGS = QUICK\n"
        "print(program(3, build=True).compiled)"
    )
    path = os.pathsep.join([os.path.dirname(__file__), *sys.path])  # noqa: PTH120
    told = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": path, "PYTHONHASHSEED": "3"},
    )
    assert told.stdout.strip() == "True"
    assert sorted(folder.iterdir()) == files


@needs_compiler
def test_a_compiled_motion_is_the_interpreted_one_on_every_ground(folder, monkeypatch):
    """Equations and Jacobian with a law that feeds back, and the motion; one library for all."""
    t = np.linspace(0, 2, 5)
    for seed in (1, 2):
        options = [sf.SolverOptions(tolerance=1e-9, compiled=build) for build in (False, True)]
        dae, start, law = driven(seed)
        runs = [sf.simulate(dae, start, law, t, options=each) for each in options]
        plain, found = (with_inputs(dae, law, 4, each) for each in options)
        assert found.core.jacobian().n_instructions() < 100  # of calls
        last = runs[0]
        x, z, u = dae.rows("x", last, -1), dae.rows("z", last, -1), plain.u[:, 0]
        motion = [1.7, x, z[: plain.motion_size], u, 0, 0]
        blocks = zip(plain.blocks, found.blocks, strict=True)
        for one, other, point in (
            (plain.core, found.core, motion),
            (plain.core.jacobian(), found.core.jacobian(), motion),
            *((a.newton, b.newton, [1.7, x, z, u, 0]) for a, b in blocks),
        ):
            given = point[: one.n_in()]
            for a, b in zip(one.call(given), other.call(given), strict=True):
                assert_allclose(np.array(ca.DM(a)), np.array(ca.DM(b)), rtol=1e-11, atol=1e-11)
        for name in ("x", "y", "heading"):
            assert_allclose(runs[1][name], runs[0][name], atol=1e-7)
        # motion, quadratures and limits, and one for each block
        assert len(list(folder.iterdir())) == 2 + len(plain.blocks + plain.dependent_blocks)
        monkeypatch.setenv("CC", "false")


@needs_compiler
def test_the_contact_search_on_a_formula_is_compiled():
    hills = sf.Analytic(lambda x, y: 0.15 * ca.sin(2 * x) * ca.cos(3 * y), mu=0.8)
    search = search_function(hills, Torus(0.03, 0.12), 0.15)
    compiled = _compiled_lookup(search)
    assert any(each.class_name() == "External" for each in compiled.find_functions())
    rng = np.random.default_rng(0)
    at = np.vstack(
        [rng.uniform(-1, 1, (2, 200)), rng.uniform(0, 0.4, 200), *np.eye(3)[:, [0] * 200]]
    )
    assert_allclose(compiled.map(200)(at), search.map(200)(at), rtol=1e-9, atol=1e-9)


def test_the_jacobian_of_a_motion_under_a_law_is_that_of_its_expressions():
    dae, start, law = driven(1)
    system = with_inputs(dae, law, 4)
    x, z, u = dae.columns()
    m = z[: system.motion_size]
    rows = ca.vertcat(dae.ode, ca.vertcat(*dae.alg)[: system.motion_size])
    rows = ca.substitute(rows, u, ca.vertcat(*leaves(law)))
    exact = dae.function("exact", [dae.t, x, m], [ca.jacobian(rows, ca.vertcat(x, m))])
    at = [0.4, dae.rows("x", start, -1), dae.rows("z", start, -1)[: system.motion_size]]
    t, x, m, u = system.core.mx_in()
    found = ca.Function(
        "found",
        [t, x, m],
        [ca.jacobian(ca.vertcat(*system.core(t, x, m, system.u[:, 0])), ca.vertcat(x, m))],
    )
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
    (again,) = codegen_cache.load_or_compile("squares 1.0", ["squares"], lambda: 1 / 0)
    assert float(again([1.0, 2.0])) == 5.0
    content = file.read_bytes()
    spoilt(file, content[: len(content) // 2])
    assert kept() is None
    assert not list(folder.iterdir())
    (mended,) = library()
    assert float(mended([1.0, 1.0])) == 2.0
    spoilt(file, b"")
    named = file.with_name(f"{file.name.split('.')[0]}.{codegen_cache.digest(b'no library')}.so")
    spoilt(named, b"no library")
    assert kept() is None  # as it was written, but nothing that can be loaded
    (other,) = library(2.0)
    assert float(other([1.0, 1.0])) == 4.0


@needs_compiler
def test_only_the_newest_are_kept(folder, monkeypatch):
    monkeypatch.setattr(codegen_cache, "MAX_LIBRARIES", 2)
    for number in range(3):
        library(float(number))
        for file in folder.iterdir():
            os.utime(file, (file.stat().st_mtime - 10,) * 2)
    assert len(list(folder.iterdir())) == 2
    assert [kept(float(k)) is None for k in range(3)] == [True, False, False]


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("no compiler", "no C compiler was found"),
        ("one that fails", "false: the C compiler failed"),
        ("no folder", "SLIPFREE_CACHE is empty"),
        ("nobody's home", "expected a folder, found '~no user/x' of a user without a home folder"),
        ("open to others", "only this user can write to"),
    ],
)
def test_where_nothing_can_be_compiled_a_warning_says_why(what, words, folder, monkeypatch):
    if what == "no compiler":
        monkeypatch.setattr(shutil, "which", lambda _: None)
    elif what == "one that fails":
        monkeypatch.setenv("CC", "false")
    elif what == "nobody's home":
        monkeypatch.setenv(codegen_cache.FOLDER, "~no user/x")
        assert words in codegen_cache.obstacle()
    elif what == "no folder":
        monkeypatch.setenv(codegen_cache.FOLDER, "")
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
    left, at_work = (folder / f"{codegen_cache.SCRATCH_PREFIX}{k}" for k in (1, 2))
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


@pytest.mark.filterwarnings("default")
def test_problems_ask_for_it_and_a_warning_says_if_it_is_not_done(tmp_path, monkeypatch):
    monkeypatch.setenv(codegen_cache.FOLDER, "")
    monkeypatch.chdir(tmp_path)
    words = sets("solver.compiled=true", "time.duration=0.4")
    assert invoke("new", "inverse", "p").exit_code == 0
    result = invoke("run", "p.toml", "--no-draw", *words)
    assert result.exit_code in (0, 1), result.output
    words = "warning: slower: equations are interpreted, not compiled: SLIPFREE_CACHE is empty"
    assert result.stderr.count(words) == 1


def test_a_sweep_says_it_once_whatever_its_processes_find(tmp_path, monkeypatch, capfd):
    monkeypatch.setenv(codegen_cache.FOLDER, "")
    monkeypatch.chdir(tmp_path)
    assert invoke("new", "direct", "p").exit_code == 0
    words = sets("solver.compiled=true", "time.duration=0.2")
    sweep = ["sweep", "p.toml", "--repeat", "2", "--processes", "2", "--no-draw", *words]
    assert invoke(*sweep, code=0).stderr.count("cannot be compiled: SLIPFREE_CACHE is empty") == 1
    assert "UserWarning" not in capfd.readouterr().err


@pytest.mark.parametrize("kind", ["settle", "contact", "inputs", "trim", "replay"])
def test_every_solver_takes_the_options(kind, monkeypatch):
    """Those that do not ask for compiled equations would not warn."""
    monkeypatch.setenv(codegen_cache.FOLDER, "")
    dae = sf.direct_kinematics(three_wheeler(), hilly(1))
    start, law = sf.settle(dae), {"right_rate": 0.4, "left_rate": 0.4, "steer_rate": 0.0}
    run = sf.simulate(dae, start, dae.inputs(**law), np.linspace(0, 0.2, 3))
    place = {"contact_x": 0.9, "contact_y": 0.1}
    calls = {
        "settle": lambda options: sf.settle(dae, options=options),
        "contact": lambda options: settle_contact(dae, "right", **place, options=options),
        "inputs": lambda options: apply_inputs(dae, start, dae.inputs(**law), options=options),
        "trim": lambda options: trim_states(
            dae, start, dae.inputs(**law), states=["steer"], least=["slip_across"], options=options
        ),
        "replay": lambda options: replay(dae, run, options=options),
    }
    with pytest.warns(UserWarning, match="interpreted, not compiled: SLIPFREE_CACHE is empty"):
        calls[kind](sf.SolverOptions(compiled=True))


def test_what_plans_cannot_differentiate_is_refused():
    v, at = ca.SX.sym("v"), np.zeros((1, 1), dtype=int)
    none = ca.SX.sym("none", 0)
    a = ca.MX.sym("a")
    square = ca.Function("square", [a], [a**2], {"never_inline": True})
    lookups = LookupTable()
    found = lookups.find(square, v, order=1)
    with pytest.raises(sf.ModelError, match="derivatives up to order 1"):
        nlp_block((v, none, none), ca.SX(0), found * v, lookups.lookups, (at, at), np.zeros((1, 0)))


def test_the_cache_is_in_the_folder_of_the_user(monkeypatch):
    monkeypatch.delenv(codegen_cache.FOLDER)
    assert codegen_cache.folder().parent.name == "slipfree"
    monkeypatch.setenv(codegen_cache.FOLDER, "~/elsewhere")  # as it may come from no shell
    assert codegen_cache.folder() == Path.home() / "elsewhere"
