"""Tests of forks of a process in which another thread computes."""

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from helpers.commands import refuses
from slipfree import Analytic, SlipfreeError, direct_kinematics, settle, simulate
from slipfree.catalog import three_wheeler
from slipfree.system import forks

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork"),
    pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning"),
]
LIMIT = 60.0  # time after which a child counts as hanging [s]


def _compute() -> None:
    """Build a model and integrate it for an instant."""
    dae = direct_kinematics(three_wheeler(), Analytic(lambda x, y: 0.05 * x + 0.02 * y**2))
    start = settle(dae, x=0.0, y=0.0, heading=0.1)
    inputs = dae.inputs(right_rate=1.0, left_rate=1.0, steer_rate=0.0)
    assert simulate(dae, start, inputs, [0.0, 0.05, 0.1]).t[-1] == 0.1


def _child(do: Callable[[], None]) -> int:
    """Return the exit code of a forked process that calls a function."""
    child = os.fork()
    if not child:
        try:
            do()
        except BaseException:
            os._exit(1)
        os._exit(0)
    end = time.monotonic() + LIMIT
    while time.monotonic() < end:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.01)
    os.kill(child, 9)
    os.waitpid(child, 0)
    pytest.fail("the child hangs")


@contextmanager
def _running(do: Callable[[], object], over: threading.Event) -> Iterator[None]:
    """Call a function in another thread, which ends at the event."""
    thread = threading.Thread(target=do)
    thread.start()
    try:
        yield
    finally:
        over.set()
        thread.join()


def test_children_compute_while_another_thread_does() -> None:
    over = threading.Event()

    def compute() -> None:
        while not over.is_set():
            _compute()

    with _running(compute, over):
        assert [_child(_compute) for _ in range(6)] == [0] * 6


def test_a_child_reads_a_property_that_another_thread_computed() -> None:
    begun, over = threading.Event(), threading.Event()

    class Owner:
        @forks.cached_property
        def value(self) -> bool:
            begun.set()
            return over.wait()

    with _running(lambda: Owner().value, over):
        begun.wait()
        assert _child(lambda: over.set() or os._exit(0 if Owner().value else 2)) == 0


def test_a_fork_waits_for_a_computation_and_no_longer() -> None:
    ended = []

    @forks.computing
    def compute() -> None:
        begun.set()
        time.sleep(0.3)
        ended.append(True)

    begun = threading.Event()
    with _running(compute, begun):
        begun.wait()
        assert _child(lambda: os._exit(0 if ended else 2)) == 0


def test_a_child_of_a_long_computation_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(forks, "MAX_WAIT", 0.1)
    begun, over = threading.Event(), threading.Event()

    @forks.computing
    def compute() -> None:
        begun.set()
        over.wait()

    def refused() -> None:
        refuses(SlipfreeError, "forked while another thread computed", _compute)

    with _running(compute, over):
        begun.wait()
        assert _child(refused) == 0
    _compute()  # the parent goes on


def test_a_computation_may_fork() -> None:
    inside = forks.computing(lambda: _child(_compute))
    assert inside() == 0
