"""Processes: pools for long tasks, also of Dask, and calls with limits of time and memory."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager, suppress
from itertools import islice
from multiprocessing import parent_process
from multiprocessing.connection import wait
from multiprocessing.context import SpawnContext
from multiprocessing.process import BaseProcess
from pathlib import Path
from queue import Empty, SimpleQueue
from typing import Any, Generic, Protocol, TypeVar

from slipfree.core.errors import DataError, SlipfreeError, require
from slipfree.core.version import __version__
from slipfree.system.forks import THREAD_COUNTS

MAX_DURATION = 6.0  # longest duration of a call with limits, in its longest CPU time
TICK = 0.2  # between two polls [s]
CONNECT = 10.0  # timeout for the connection to a scheduler [s]
PATIENCE = 1.0  # time between checks of the number of workers [s]
NONE_LEFT = "no workers are left; waiting for workers (Ctrl-C ends the computation)"
BACK = "workers are available again; the computation continues"
AHEAD = 2  # tasks per worker of Dask, so that it need not wait for the next one

Poll = Callable[[], None]
T = TypeVar("T")
D = TypeVar("D")
T_contra = TypeVar("T_contra", contravariant=True)
D_co = TypeVar("D_co", covariant=True)


class ProcessDiedError(SlipfreeError):
    """Error for a task whose process died or exceeded its limits."""


class Pool(Protocol[T_contra, D_co]):
    """Interface of a pool, which executes several tasks at the same time."""

    def room(self) -> int:
        """Return the maximum number of unfinished tasks, at least 1.

        Raise SlipfreeError if the connection to the pool is lost.
        """

    def submit(self, task: T_contra) -> Any:
        """Start a task; return its future, with the interface of `concurrent.futures`."""

    def result(self, future: Any, task: T_contra) -> D_co:
        """Return the result of a finished future."""

    def close(self) -> None:
        """Terminate all tasks immediately."""


def finish_tasks(
    tasks: Iterable[T], pool: Pool[T, D], poll: Poll, lost: Callable[[T, str], D] | None = None
) -> Generator[D, None, None]:
    """Yield the results of tasks in the order of completion; the pool remains open.

    Tasks are taken one by one when the pool accepts another task. ``poll`` is called several times
    per second; an exception that it raises ends the loop. If the process of a task dies, the result
    is that of ``lost``, called with the task and the reason; without it, ProcessDiedError is
    raised. Raises SlipfreeError if the pool fails, or if a process cannot start.
    """
    waiting, running, finished = iter(tasks), dict[Any, T](), SimpleQueue[Any]()
    while True:
        for task in islice(waiting, max(0, pool.room() - len(running))):
            future = pool.submit(task)
            running[future] = task
            future.add_done_callback(finished.put)
        if not running:
            return
        poll()
        try:
            future = finished.get(timeout=TICK)
        except Empty:
            continue
        task = running.pop(future)
        try:
            yield pool.result(future, task)
        except ProcessDiedError as error:
            if lost is None:
                raise
            yield lost(task, str(error))


class Processes(Generic[T, D]):
    """Pool of processes with one thread each.

    Each process has its own `ProcessPoolExecutor`. If a process dies, its executor and all futures
    of this executor fail; with one process per executor, only one task is lost. At most ``count``
    processes start, when they are needed; they call ``function``, which is at module level, with a
    task.
    """

    def __init__(self, count: int, function: Callable[[T], D]) -> None:
        self._count, self._function = count, function
        self._idle: list[_Process] = []
        self._busy: dict[Future[D], _Process] = {}

    def room(self) -> int:
        """Return the maximum number of processes; each has at most one unfinished task."""
        return self._count

    def submit(self, task: T) -> Future[D]:
        """Start a task; return its future."""
        process = self._idle.pop() if self._idle else _Process()
        if not process.process.is_alive():  # it was killed while idle
            process = _Process()
        future = process.executor.submit(self._function, task)
        self._busy[future] = process
        return future

    def result(self, future: Future[D], task: T) -> D:  # noqa: ARG002 - interface of pools
        """Return the result of a future.

        ProcessDiedError is raised if the process of the task died, SlipfreeError if it could not
        start.
        """
        process = self._busy.pop(future)
        error = future.exception()
        if isinstance(error, BrokenProcessPool):
            process.end()
            how = _exit_words(process.process.exitcode)
            if process.started.exception():
                raise SlipfreeError(
                    f"a worker process could not start ({how}): see its output above; "
                    "finished parts are kept"
                ) from error
            raise ProcessDiedError(f"a worker process died ({how})") from error
        self._idle.append(process)
        return future.result()

    def close(self) -> None:
        """Kill all processes."""
        for process in (*self._idle, *self._busy.values()):
            process.end()


class DaskPool(Generic[T, D]):
    """A pool of the workers of a Dask scheduler.

    Workers need the same version of slipfree, and the input files of the problem at the same paths.
    A worker executes one task at a time, regardless of its number of threads; it calls
    ``function``, which is at module level. ``warn`` is called with a message when all workers are
    lost, and when workers are available again.

    DataError is raised if the package distributed is not installed, no scheduler responds at the
    address, it has no workers, or they do not have the same version of slipfree.
    """

    def __init__(
        self, function: Callable[[T], D], address: str, warn: Callable[[str], None]
    ) -> None:
        self._function, self._address, self._warn = function, address, warn
        distributed = require("distributed", "cluster", "--scheduler: ")
        import asyncio  # takes 45 ms

        from distributed.comm.core import connect
        from distributed.security import Security

        async def reach() -> None:
            """Check that the scheduler accepts a connection.

            A Dask client that cannot connect takes 20 s to close, and prints a traceback.
            """
            security = Security().get_connection_args("client")
            async with asyncio.timeout(CONNECT):  # connect itself waits forever for one that hangs
                comm = await connect(address, timeout=CONNECT, **security)
                await comm.close()

        try:
            with ThreadPoolExecutor(1) as alone:  # a notebook already runs an event loop
                alone.submit(asyncio.run, reach()).result()
            client = distributed.Client(address, timeout=CONNECT, set_as_default=False)
        except Exception as error:  # its class depends on the transport
            reason = f"{type(error).__name__}: {error}".removesuffix(": ")
            raise DataError(
                f"--scheduler {address}: expected the address of a running Dask scheduler, as in "
                f"tcp://10.0.0.1:8786, found none ({reason}); start one: dask scheduler"
            ) from error
        head = f"--scheduler {address}: expected workers"
        expected = f"{head} that have slipfree {__version__}, found"
        try:
            versions = set(client.run(_version).values())
            if not versions:
                raise DataError(
                    f"{head}, found none; start some: "
                    f"dask worker {address} --nworkers 4 --nthreads 1"
                )
            if versions != {__version__}:
                raise DataError(
                    f"{expected} {', '.join(sorted(versions))}; install the same version on all "
                    "workers"
                )
        except BaseException as error:
            client.close()
            # workers can raise any error on import
            if isinstance(error, DataError) or not isinstance(error, Exception):
                raise
            raise DataError(
                f"{expected} {type(error).__name__}: {error}; install this version on all workers"
            ) from error
        self._client = client
        self._workers, self._asked = 1, 0.0
        self._open: dict[str, Any] = {}

    def room(self) -> int:
        """Return the largest number of open tasks; warn if all workers are lost or some are back.

        Raises SlipfreeError if the connection to the scheduler is lost.
        """
        if self._client.status != "running":
            raise self._gone()
        if (now := time.monotonic()) - self._asked > PATIENCE:
            before, self._asked = self._workers, now
            with suppress(OSError):  # if the scheduler stops, the status changes
                self._workers = len(self._client.nthreads())
            if bool(before) != bool(self._workers):
                words = BACK if self._workers else NONE_LEFT
                self._warn(f"--scheduler {self._address}: {words}")
        return max(1, AHEAD * self._workers)

    def submit(self, task: T) -> Any:
        """Return the future of a task."""
        key = f"slipfree-{os.urandom(8).hex()}"
        self._open[key] = self._client.submit(self._function, task, key=key)
        return self._open[key]

    def result(self, future: Any, task: T) -> D:  # noqa: ARG002 - interface of pools
        """Return the result of a future.

        ProcessDiedError is raised if the worker of the task failed, SlipfreeError if the connection
        to the scheduler is lost.
        """
        del self._open[future.key]
        if future.status == "finished":
            done: D = future.result()
            return done
        if future.status == "error":
            raise ProcessDiedError(f"its worker failed ({future.exception()})")
        raise self._gone()

    def close(self) -> None:
        """Cancel open tasks and disconnect from the scheduler."""
        with suppress(Exception):  # the scheduler may have stopped
            self._client.cancel([*self._open.values()])
        self._client.close()

    def _gone(self) -> SlipfreeError:
        return SlipfreeError(
            f"--scheduler {self._address}: the connection to the scheduler is lost; "
            "finished parts are kept; start a scheduler and repeat the command to continue"
        )


def _version() -> str:
    return __version__


@contextmanager
def local_tasks(
    function: Callable[[T], D], most: int, here: Callable[[T], D] | None = None
) -> Iterator[Callable[[Iterable[T], Poll], Iterator[D]]]:
    """Yield a function that executes tasks in at most ``most`` processes, for several calls.

    The function takes tasks and ``poll`` as `finish_tasks` does, and yields the results in the
    order of completion. If this process is itself one of a pool, or if only one process may be
    used, it executes the tasks one after the other, by ``here`` if it is given. ``function`` is at
    module level.
    """
    count = min(available_cores(), most)

    def one_by_one(tasks: Iterable[T], poll: Poll) -> Iterator[D]:
        for task in tasks:
            poll()
            yield (here or function)(task)

    if parent_process() is not None or count == 1:
        yield one_by_one
        return
    with closing(Processes(count, function)) as pool:
        yield lambda tasks, poll: finish_tasks(tasks, pool, poll)


class _SpawnOne(SpawnContext):
    """Context of the start method ``spawn`` that stores the process which it creates.

    CasADi is not safe in forked processes.
    """

    made: BaseProcess

    def Process(self, *args: Any, **more: Any) -> BaseProcess:  # type: ignore[override]  # noqa: N802
        self.made = super().Process(*args, **more)
        return self.made


class _Process:
    """Executor with one process, which starts immediately."""

    def __init__(self) -> None:
        context = _SpawnOne()
        self.executor = ProcessPoolExecutor(1, context, prepare_process)
        with for_children():
            self.started = self.executor.submit(os.getpid)
        self.process = context.made

    def end(self) -> None:
        self.process.kill()
        self.executor.shutdown(cancel_futures=True)


def _exit_words(code: int | None) -> str:
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        return f"signal {name}" + ("; possibly out of memory" if name == "SIGKILL" else "")
    return f"exit code {code}"


@contextmanager
def for_children() -> Iterator[None]:
    """Set up this process so that new child processes use one thread and ignore Ctrl-C."""
    before = {name: os.environ.get(name) for name in THREAD_COUNTS}
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.update(dict.fromkeys(THREAD_COUNTS, "1"))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


def available_cores() -> int:
    """Return the number of processors available to this process."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def prepare_process() -> None:
    """Prepare a new process: ignore Ctrl-C and warnings, print to stderr, exit with the parent."""

    def end_with_parent() -> None:  # even in the middle of a run
        if (parent := parent_process()) is not None:
            wait([parent.sentinel])
            os._exit(1)

    threading.Thread(target=end_with_parent, daemon=True).start()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C in the terminal
    warnings.simplefilter("ignore")  # the parent reports them
    os.dup2(2, 1)  # output of solvers must not get into the summary


def bounded_call(
    function: Callable[..., T], *arguments: Any, seconds: float, memory: float = 2e9
) -> T:
    """Return the result of a function that is called in a process of its own, with limits.

    This is for libraries that may hang, crash or exhaust the memory while they read a file of
    somebody else. The process prints nothing and does not import the user's main module. The
    function is at module level, and its arguments can be pickled, as can exceptions that are raised
    again. ``seconds`` bounds the CPU time, including the start of the process of about 0.2 s; the
    duration is at most 6 times as long, since other processes may use the processors. ``memory``
    bounds the size of the process in bytes, where the operating system supports limits.

    ProcessDiedError is raised if the call exceeds a limit or its process dies; the message is a
    clause about "it".
    """
    limits = pickle.dumps((sys.path, seconds, int(memory)))
    names = {**os.environ, **dict.fromkeys(THREAD_COUNTS, "1")}
    process = subprocess.Popen(
        # -P: the current folder may contain modules of somebody else
        [sys.executable, "-P", "-c", _BOUNDED],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=names,
        start_new_session=True,
    )
    try:
        answer, _ = process.communicate(
            limits + pickle.dumps((function, arguments)), MAX_DURATION * seconds
        )
    except subprocess.TimeoutExpired as error:
        raise ProcessDiedError(f"it takes longer than {seconds:.3g} s") from error
    finally:
        if sys.platform != "win32":
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
        process.kill()
        for stream in (process.stdin, process.stdout):
            if stream is not None:
                stream.close()
        process.wait()
    if process.returncode == -getattr(signal, "SIGXCPU", 0):
        raise ProcessDiedError(f"it takes longer than {seconds:.3g} s")
    if not answer:
        how = f"its process died ({_exit_words(process.returncode)})"
        raise ProcessDiedError(how)
    succeeded, result = pickle.loads(answer)
    if succeeded:
        return result  # type: ignore[no-any-return]
    if isinstance(result, MemoryError):
        raise ProcessDiedError(f"it needs more than {memory / 1e9:g} GB of memory")
    raise result


def bounded_read(
    function: Callable[..., T], path: Path, *arguments: Any, rate: float = 1e6, growth: float = 20.0
) -> T:
    """Return the result of a function that reads a file in a process with limits by its size.

    The function is at module level; the file is the first of its arguments. The limits are 10 s of
    CPU time and 1 s per ``rate`` bytes, and 3 GB of memory and ``growth`` times the size of the
    file. DataError is raised, with the name of the file, if the function exceeds a limit or its
    process dies; exceptions of the function are raised again.
    """
    size = path.stat().st_size
    try:
        return bounded_call(
            function, path, *arguments, seconds=10 + size / rate, memory=3e9 + growth * size
        )
    except ProcessDiedError as error:
        raise DataError(
            f"{path}: expected a readable file, found that its reader crashed or exceeded its "
            f"limits ({error}): the file is probably damaged; copy, download or export it again"
        ) from error


_BOUNDED = """
import pickle, sys
sys.path[:], seconds, memory = pickle.load(sys.stdin.buffer)
from slipfree.system.processes import _answer
_answer(seconds, memory)
"""


def _answer(seconds: float, memory: int) -> None:
    """Call the function on stdin with limits, and write its result or its error to stdout."""
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # the function must not print into the result
    if sys.platform != "win32":
        import resource

        signal.alarm(int(MAX_DURATION * seconds) + 2)  # if the parent dies
        limits = {"RLIMIT_CPU": int(seconds) + 1, "RLIMIT_AS": memory, "RLIMIT_CORE": 0}
        for name, most in limits.items():
            limit = getattr(resource, name)
            hard = resource.getrlimit(limit)[1]
            most = most if hard == resource.RLIM_INFINITY else min(most, hard)
            with suppress(ValueError, OSError):  # macOS does not limit addresses
                resource.setrlimit(limit, (most, hard))
    try:
        function, arguments = pickle.load(sys.stdin.buffer)
        answer = pickle.dumps((True, function(*arguments)))
    except MemoryError:
        answer = pickle.dumps((False, MemoryError()))
    except Exception as error:
        try:
            answer = pickle.dumps((False, error.with_traceback(None)))
            pickle.loads(answer)
        except Exception:  # it cannot be pickled
            answer = pickle.dumps((False, SlipfreeError(f"{type(error).__name__}: {error}")))
    with out:
        out.write(answer)
