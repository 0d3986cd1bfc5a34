"""Tests of Ctrl-C at moments at which the exception could be lost."""

import os
import re
import shlex
import signal
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, nullcontext, suppress

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

import slipfree as sf
import slipfree.__main__ as entry
from helpers.cases import BOUNDED_RATES, PROBLEMS, hills, straight_on
from helpers.commands import error_of, invoke, press, pressing, sets
from helpers.problem_files import FIT, PROBLEM
from helpers.toy_models import model
from slipfree.catalog import three_wheeler
from slipfree.core.dae import Nlp
from slipfree.files import netcdf
from slipfree.files.tables import write_rows
from slipfree.fit import drives
from slipfree.plan import ipopt, search, tracking, verification
from slipfree.plan import plan as planning
from slipfree.plan.ipopt import solve_nlp
from slipfree.plan.mpc import horizon
from slipfree.plan.verification import simulate_plan
from slipfree.problem.verbs import base as runner
from slipfree.problem.verbs import compare
from slipfree.problem.verbs import plan as plan_verb
from slipfree.solve import integrator, simulate
from slipfree.system import codegen_cache, interrupt

pytestmark = pytest.mark.slow

HILLS = PROBLEMS / "plan_rigid_hills.toml"
PLAN = (str(HILLS), *sets("plan.intervals=8", "costs.slip=1e3", "time.step=0.5"))
T = np.linspace(0, 2, 21)
OLD = b"what was here before"


@pytest.fixture(autouse=True)
def handler():
    """Python's own handler, to which everything must come back."""
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    yield
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def lost():
    with pytest.raises(KeyboardInterrupt):
        press()


# The context


def test_what_got_lost_comes_at_the_end():
    with pytest.raises(KeyboardInterrupt), interrupt.InterruptGuard():
        lost()


def test_it_comes_instead_of_what_became_of_it():
    def fail():
        lost()
        raise SystemError("returned a result with an exception set")

    assert error_of(KeyboardInterrupt, interrupt.with_interrupt_guard(fail)).__suppress_context__


def test_what_a_callback_deals_with_is_forgotten_by_all_contexts_around_it():
    with interrupt.InterruptGuard(), interrupt.InterruptGuard() as heed:
        heed.call(lost)


def test_what_was_raised_before_a_callback_ends_it():
    seen = []

    def work():
        with interrupt.InterruptGuard() as heed:
            lost()
            heed.call(seen.append, 1)

    with pytest.raises(KeyboardInterrupt):
        work()
    assert seen == []


@pytest.mark.parametrize("ignored", [False, True])
def test_a_handler_that_does_not_raise_stays_what_it_is(ignored):
    """One that only remembers Ctrl-C is called once; where it is ignored, nobody is interrupted."""
    seen = []
    handler = signal.SIG_IGN if ignored else lambda *_: seen.append(1)
    signal.signal(signal.SIGINT, handler)
    try:
        with interrupt.InterruptGuard():
            press()
        assert signal.getsignal(signal.SIGINT) == handler
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    assert seen == [1] * (not ignored)


@pytest.mark.parametrize(("name", "at"), [("_int_to_enum", 2), ("_enum_to_int", 3)])
def test_pressed_while_python_puts_a_handler_in_its_place(name, at, monkeypatch):
    """On entering and on leaving: `signal.signal` is Python code, and nothing stays behind."""
    former = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(signal, name, pressing(getattr(signal, name), at)[0])
    with pytest.raises(KeyboardInterrupt), interrupt.InterruptGuard():
        pass
    monkeypatch.undo()
    assert signal.getsignal(signal.SIGINT) is former
    with interrupt.InterruptGuard():
        pass


def test_another_thread_leaves_the_handler_alone():
    handlers, raised = [], []

    def work():
        try:
            with interrupt.ended_by_interrupt(press), interrupt.InterruptGuard() as heed:
                handlers.append(signal.getsignal(signal.SIGINT))
                with pytest.raises(ZeroDivisionError):
                    heed.call(lambda: 1 / 0)
        except ZeroDivisionError as error:
            raised.append(error)

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert handlers == [signal.default_int_handler]
    assert len(raised) == 1


# Simulation


def moved(method="cvodes", progress=None):
    dae = model(lambda _t, x, u: u - x)
    start, inputs = sf.settle(dae, x=0.0), dae.inputs(push=1.0)
    return simulate.simulate(
        dae, start, inputs, T, options=sf.SolverOptions(method=method), progress=progress
    )


def test_at_the_entry_of_a_step(monkeypatch):
    pressed, _ = pressing(integrator._Relay.eval_buffer, at=3)
    monkeypatch.setattr(integrator._Relay, "eval_buffer", pressed)
    times = []
    with pytest.raises(KeyboardInterrupt):
        moved("idas", times.append)
    assert 0 < len(times) < 5  # no step is looked at any more


@pytest.mark.parametrize(
    ("where", "name"), [(integrator._Relay, "has_eval_buffer"), (simulate, "to_trajectory")]
)
def test_while_it_is_made_and_looked_at(where, name, monkeypatch):
    monkeypatch.setattr(where, name, pressing(getattr(where, name))[0])
    with pytest.raises(KeyboardInterrupt):
        moved()


def test_swallowed_around_a_call(monkeypatch):
    """As in CasADi's own code: the call goes on, or fails with words of its own."""
    function = integrator.suppress_messages

    def swallowing(*args):
        lost()
        return function(*args)

    monkeypatch.setattr(integrator, "suppress_messages", swallowing)
    with pytest.raises(KeyboardInterrupt):
        moved()


def test_a_progress_that_returns_false_keeps_what_was_reached():
    whole, run = moved("idas"), moved("idas", lambda t: t < 0.7)
    assert run.stop.name == "interrupted"
    assert 0.7 <= run.t[-1] < whole.t[-1]
    assert_allclose(run["x"][:-1], whole["x"][: run.t.size - 1], atol=1e-8)


def test_a_progress_whose_own_motion_is_interrupted():
    """The motion inside is told of it, and what catches it there has dealt with it."""
    times = []

    def progress(t):
        times.append(t)
        if len(times) == 3:
            with pytest.raises(KeyboardInterrupt):
                moved(progress=lambda _: press())

    assert moved(progress=progress).t[-1] == T[-1]


def test_between_the_samples_of_a_controller(monkeypatch):
    calls = []

    @contextmanager
    def swallowing():
        calls.append(1)
        lost()
        yield
        raise RuntimeError("CV_RHSFUNC_FAIL")

    monkeypatch.setattr(integrator, "suppress_messages", swallowing)
    dae = model(lambda _t, _x, u: u)
    with pytest.raises(KeyboardInterrupt):
        sf.simulate(dae, sf.settle(dae, x=1.0), dae.inputs(push=1.0), T, sampled=True)
    assert len(calls) == 1


# Plans


def planned(progress=None):
    return planning.plan(
        *straight_on(three_wheeler(axle="fixed"), sf.Analytic(hills), 0.4, T),
        goal={"y": 0.2},
        costs={"effort": 0.01},
        duration=2.0,
        inputs=BOUNDED_RATES,
        mesh=sf.Mesh(3, accuracy=1.0),
        search=sf.Search(progress=progress),
    )


@pytest.mark.parametrize(
    ("where", "name"), [(ipopt._IterateWatcher, "get_sparsity_in"), (ipopt, "largest_violation")]
)
def test_in_a_search(where, name, monkeypatch):
    monkeypatch.setattr(where, name, pressing(getattr(where, name), at=2)[0])
    seen = []
    with pytest.raises(KeyboardInterrupt):
        planned(lambda _, iterate: not seen.append(iterate))
    assert len(seen) < 10


class Cost(ca.Callback):
    """A square at whose second value Ctrl-C is pressed."""

    def __init__(self):
        ca.Callback.__init__(self)
        self.calls = []
        self.construct("cost", {"enable_fd": True})

    def eval(self, arguments):
        self.calls.append(1)
        if len(self.calls) == 2:
            press()
        return [arguments[0] ** 2]


def test_in_a_program_that_comes_ready_made(capfd):
    x, cost, one = ca.MX.sym("x"), Cost(), np.ones(1)
    nlp = Nlp(x, cost(x), x, one, one, -one, one, -one, one, {})
    with pytest.raises(KeyboardInterrupt):
        solve_nlp(nlp)
    assert len(cost.calls) == 2
    capfd.readouterr()


# The compiler


def test_a_compiler_that_does_not_end_is_ended(slow):
    code = (slow / "cc.py").read_text().replace("os.kill(os.getppid(), signal.SIGINT)\n", "")
    (slow / "cc.py").write_text(code)
    with codegen_cache.compiler_limit(2.0), pytest.raises(subprocess.TimeoutExpired):
        codegen_cache._run([sys.executable, str(slow / "cc.py")])
    _, child = (slow / "told").read_text().split()
    assert _ends(int(child))


@pytest.fixture
def slow(tmp_path, monkeypatch):
    """A compiler that tells its session, starts a process of its own, and presses Ctrl-C."""
    code = (
        "import os, pathlib, signal, subprocess, sys, time\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])\n"
        f"pathlib.Path({str(tmp_path / 'told')!r}).write_text(f'{{os.getsid(0)}} {{child.pid}}')\n"
        "os.kill(os.getppid(), signal.SIGINT)\n"
        "time.sleep(60)\n"
    )
    (tmp_path / "cc.py").write_text(code)
    monkeypatch.setenv("CC", shlex.join([sys.executable, str(tmp_path / "cc.py")]))
    monkeypatch.setenv(codegen_cache.FOLDER, str(tmp_path / "cache"))
    return tmp_path


@pytest.mark.parametrize(
    "context", [nullcontext, interrupt.held_interrupt, interrupt.InterruptGuard]
)
def test_the_compiler_is_out_of_reach_and_ends_with_us(slow, context):
    """Also where the first Ctrl-C is only remembered."""
    x = ca.SX.sym("x")

    def work():
        with context():
            codegen_cache.load_or_compile("text", ["f"], lambda: [ca.Function("f", [x], [x])])

    with pytest.raises(KeyboardInterrupt):
        work()
    session, child = (slow / "told").read_text().split()
    assert int(session) != os.getsid(0)
    assert _ends(int(child))
    assert list((slow / "cache").iterdir()) == []


def _ends(number):
    """Return whether a process soon is no more, or only not yet waited for by its new parent."""
    for _ in range(100):
        found = subprocess.run(
            ["ps", "-o", "stat=", "-p", str(number)], capture_output=True, text=True, check=False
        )
        if found.stdout.strip()[:1] in ("", "Z"):
            return True
        time.sleep(0.05)
    return False


# The command line


def _called(*calls):
    for call in calls:
        call()


_held = interrupt.held_interrupt()(_called)


@pytest.mark.parametrize(
    "calls",
    [(interrupt.check_interrupt, press), (press, interrupt.check_interrupt), (press, lost)],
    ids=["behind the last poll", "at a poll", "twice"],
)
def test_a_held_interrupt_comes_once(calls):
    with pytest.raises(KeyboardInterrupt):
        _held(*calls)


def test_preparations_before_the_first_poll_are_ended_at_once():
    run, reached = interrupt.held_interrupt(from_first_poll=True)(_called), []
    with pytest.raises(KeyboardInterrupt):
        run(press, lambda: reached.append("preparations"))
    with pytest.raises(KeyboardInterrupt):
        run(interrupt.check_interrupt, press, lambda: reached.append("computation"))
    assert reached == ["computation"]


@pytest.fixture
def folder(folder):
    (folder / "p.toml").write_text(PROBLEM)
    (folder / "p.nc").write_bytes(OLD)
    return folder


def run(*words, code=None):
    return invoke("run", *words, "--no-draw", code=code)


GRIP = ("p.toml", *sets("terrain.friction=0.8"))
SO_FAR = r"interrupted at t = \S+ s.*; p.nc contains the result so far\n"
AT_END = r"interrupted at t = 0.5 s; p.nc contains the result so far\n"
WHOLE = r"interrupted; p.nc contains the result, which is complete\n"
UNCHANGED = r"interrupted; p.nc is not written: the earlier file is unchanged\n"
RESUME = r".*to resume: slipfree run .*--resume p.nc.*"
INERT = (*GRIP, *sets("model=dynamics"))
HELD = (*INERT, *sets("driver.period=0.01"))
RUNS = {  # function, its call, words of the command, what is told, and the kept stop or file
    "diagnostics": ((runner, "obstacle_ending"), GRIP[:1], AT_END, "interrupted"),
    "while written": ((os, "fsync"), GRIP[:1], WHOLE, None),
    "while written, twice": ((os, "fsync", 1, 2), GRIP[:1], UNCHANGED, OLD),
    "kinematics": ((integrator._Relay, "eval_buffer", 5), GRIP, SO_FAR, "interrupted"),
    "kinematics, twice": ((integrator._Relay, "eval_buffer", 1, 2), GRIP[:1], "interrupted\n", OLD),
    "dynamics": ((integrator._Relay, "eval_buffer", 100), INERT, SO_FAR, "interrupted"),
    "sampled": ((integrator, "run_buffered", 61), HELD, SO_FAR, "interrupted"),
    "plan that is compiled": ((search, "transcribe"), PLAN, "interrupted\n", OLD),
    "plan behind its first iteration": ((ipopt, "largest_violation", 2), PLAN, RESUME, "plan"),
}


@pytest.mark.parametrize("name", RUNS)
def test_an_interrupted_run_keeps_what_it_has(folder, monkeypatch, name):
    (where, function, *at), words, told, stop = RUNS[name]
    monkeypatch.setattr(where, function, pressing(getattr(where, function), *at)[0])
    found = run(*words, "-o", "p.nc", code=130)
    assert re.fullmatch(told, found.stderr, re.DOTALL)
    if stop == OLD:
        assert (folder / "p.nc").read_bytes() == OLD
        assert not [*folder.glob(".*.part*")]
        return
    kept = netcdf.read(folder / "p.nc")
    assert (kept.stop and kept.stop.name) == stop
    if stop == "plan":
        assert kept.facts["plan_iterations"].value == 1
    if name == "diagnostics":
        assert kept.t[-1] == 0.5
        assert "not all diagnostics" in kept.stop.words
    if told == SO_FAR:
        assert kept.outcome.name == "INTERRUPTED"
        assert 0 < kept.t[-1] < 0.5
        for command, *options in (
            ("info",),
            ("export", "--path", "p.csv"),
            ("export", "--mcap", "p.mcap"),
        ):
            invoke(command, "p.nc", *options, code=0)


@pytest.fixture
def signals():
    former = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP)}
    interrupt.interrupt_at_signals()
    yield
    interrupt.interrupt_arrived()
    for number, handler in {**former, signal.SIGINT: signal.default_int_handler}.items():
        signal.signal(number, handler)


@pytest.mark.usefixtures("signals")
@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_other_signals_interrupt_as_well(name):
    def fail():
        with suppress(KeyboardInterrupt):
            signal.raise_signal(getattr(signal, name))
        raise RuntimeError("what CasADi says")

    with pytest.raises(KeyboardInterrupt):
        _held(lambda: signal.raise_signal(getattr(signal, name)), interrupt.check_interrupt)
    with pytest.raises(KeyboardInterrupt):
        interrupt.with_interrupt_guard(fail)()


@pytest.mark.usefixtures("signals")
@pytest.mark.parametrize("pressed", [True, False])
def test_an_interrupted_import_prints_no_traceback(pressed, monkeypatch, capsys):
    def imported():
        if pressed:
            with suppress(KeyboardInterrupt):
                signal.raise_signal(signal.SIGTERM)
        raise ImportError("numpy is not complete")

    monkeypatch.setattr("slipfree.system.interrupt._received", [])
    monkeypatch.setattr("slipfree.cli.main", imported)
    ended = error_of(SystemExit if pressed else ImportError, entry.main)
    if pressed:
        assert (ended.code, capsys.readouterr().err) == (130, "interrupted\n")


@pytest.mark.parametrize("where", ["verification", "by_friction"])
def test_a_plan_interrupted_after_its_search_is_kept(folder, monkeypatch, where):
    """Also on disk while it is verified, in case that the process is killed."""
    seen = []

    def pressed(*args, **more):
        seen.append(netcdf.read(folder / "p.nc").stop.name)
        press()
        return simulate_plan(*args, **more)

    module = verification if where == "verification" else plan_verb
    monkeypatch.setattr(module, "simulate_plan", pressed)
    settings = ("--set", "terrain.friction=0.8") if where == "by_friction" else ()
    found = run(*PLAN, "-o", "p.nc", *settings, code=130)
    kept, arrays = netcdf.read(folder / "p.nc"), netcdf.read_arrays(folder / "p.nc")
    assert seen == ["plan_unverified"]
    assert kept.outcome.name == "INTERRUPTED"
    assert kept.stop.name == ("plan_unverified" if where == "verification" else "interrupted")
    assert ("plan_difference_x" in kept.facts) == (where == "by_friction")
    assert arrays["plan_unknowns"].size
    assert "--resume p.nc" in found.stderr


def test_a_plan_whose_verification_fails_is_kept(folder, monkeypatch):
    def fail(*_, **__):
        raise sf.SolverError("IDA_CONV_FAIL")

    monkeypatch.setattr(verification, "simulate_plan", fail)
    run(*PLAN, "-o", "p.nc", code=1)
    kept = netcdf.read(folder / "p.nc")
    assert kept.outcome.name == "SOLVER_FAILURE"
    assert "the plan is solved" in kept.stop.words
    assert "IDA_CONV_FAIL" in kept.stop.words


@pytest.mark.parametrize(("at", "rows"), [(1, 0), (4, 1)], ids=["start", "accepted step"])
def test_a_fit_keeps_its_last_accepted_estimate(folder, monkeypatch, at, rows):
    t = np.linspace(0, 12, 13)
    turned = -0.2 * t
    names = ["front_right", "front_left", "rear_right", "rear_left"]
    columns = [t, 5 * np.cos(turned), 5 * np.sin(turned), turned + np.pi]
    columns += [np.full(t.size, 6.0 if "left" in name else 3.0) for name in names]
    head = ["time", "x", "y", "heading", *(f"{name}_rate" for name in names)]
    write_rows(folder / "x.csv", head, np.column_stack(columns).tolist())
    (folder / "fit.toml").write_text(FIT)
    pressed, _ = pressing(drives.simulate, at)
    monkeypatch.setattr(drives, "simulate", pressed)
    found = invoke("fit", "fit.toml", "--no-draw", code=130)
    kept = "interrupted; fit.csv contains the estimates so far\n"
    assert found.stderr == (kept if rows else "interrupted\n")
    assert (folder / "fit.csv").exists() == bool(rows)


def test_a_comparison_keeps_its_finished_vehicles(monkeypatch):
    problem = HILLS.with_name("compare_axles.toml")
    pressed, _ = pressing(compare.build.build_vehicle, at=2)
    monkeypatch.setattr(compare.build, "build_vehicle", pressed)
    brief = ["--set", "time.duration=0.1", "--set", "time.step=0.02"]
    found = invoke("compare", str(problem), *brief, code=130)
    assert re.fullmatch(r"interrupted; the table contains 1 of \d+ vehicles\n", found.stderr)


def test_a_tracking_keeps_its_cycles(monkeypatch):
    dae = sf.direct_kinematics(three_wheeler(axle="fixed"), sf.Analytic(hills))
    pressed, _ = pressing(tracking._drive, at=3)
    monkeypatch.setattr(tracking, "_drive", pressed)
    frame = horizon(planned(), span=1.0)
    world = tracking.TrackingWorld(dae, None, sf.settle(dae))
    controller = tracking.Replanning(frame, period=0.25)
    with interrupt.held_interrupt():
        found = tracking.track_plan(controller, world, duration=2.0)
    assert found.run.stop.name == "interrupted"
    assert_allclose(found.run.t[-1], 0.5)


LOST = """
import signal, time, weakref
from slipfree.system.interrupt import interrupt_at_signals

class Thing:
    pass

interrupt_at_signals()
thing = Thing()
callback = weakref.ref(thing, lambda _: signal.raise_signal(signal.SIGTERM))
try:
    del thing
    time.sleep(5)
except KeyboardInterrupt:
    print("interrupted")
"""


def test_an_interruption_in_a_callback_of_the_collector_is_not_lost():
    """Python drops exceptions of such callbacks, with a traceback."""
    done = subprocess.run([sys.executable, "-c", LOST], capture_output=True, text=True, timeout=30)
    assert done.stdout == "interrupted\n"
    assert done.stderr == ""
