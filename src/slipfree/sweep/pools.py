"""Where the runs of a sweep are done: processes of this machine, or a Dask cluster.

Both yield what comes of tasks in the order in which they finish, and call ``poll`` several times a
second: what it raises ends all.
"""

from __future__ import annotations

import asyncio
import os
import queue
import signal
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import connection, get_context
from typing import Any

from slipfree.errors import DataError, SlipfreeError
from slipfree.sweep.log import LOST
from slipfree.sweep.process import serve
from slipfree.sweep.task import Done, Task, without_motion
from slipfree.threads import NAMES
from slipfree.version import __version__

TICK = 0.2  # between two looks at Ctrl-C [s]
CONNECT = 10.0  # how long to look for a scheduler [s]
Poll = Callable[[], None]
Pool = Callable[[Sequence[Task], Poll], Generator[Done, None, None]]


class _Worker:
    """A process, the task that it is at, and the pipe to it."""

    def __init__(self) -> None:
        self.task: Task | None = None
        self.start()

    def start(self) -> None:
        self.ready = False
        spawn = get_context("spawn")  # a forked CasADi is not safe
        self.pipe, other = spawn.Pipe()
        self.process = spawn.Process(target=serve, args=(other,), daemon=True)
        with _inherited():
            self.process.start()
        other.close()

    def give(self, task: Task) -> None:
        self.task = task
        with suppress(OSError):  # it has died: its end of the pipe tells
            self.pipe.send(task)

    def take(self, task: Task) -> Done | None:
        """Return what came of its task, or None if it only says that it is ready for it.

        A process that died left only how. If it could not even start, no run is to blame.
        """
        try:
            done: Done | None = self.pipe.recv()
        except (EOFError, OSError) as error:
            self.process.join()
            how = _ended(self.process.exitcode)
            if not self.ready:
                raise SlipfreeError(
                    f"a process for the runs could not start ({how}): see what it printed; what "
                    "is finished is kept, and the same command goes on"
                ) from error
            done = without_motion(task, LOST, f"its process died ({how})")
        if done is None:
            self.ready = True
        else:
            self.task = None
        return done

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()


def processes(count: int) -> Pool:
    """Return what does tasks in so many processes of one thread each."""

    def pool(tasks: Sequence[Task], poll: Poll) -> Generator[Done, None, None]:
        waiting = deque(tasks)
        workers: list[_Worker] = []
        try:
            for _ in range(min(count, len(waiting))):
                workers.append(_Worker())
                workers[-1].give(waiting.popleft())
            while busy := [(each, each.task) for each in workers if each.task is not None]:
                heard = connection.wait([each.pipe for each, _ in busy], TICK)
                poll()
                for worker, task in ((each, task) for each, task in busy if each.pipe in heard):
                    done = worker.take(task)
                    if done is None:
                        continue
                    yield done
                    if not waiting:
                        continue
                    if not worker.process.is_alive():
                        worker.end()
                        worker.start()
                    worker.give(waiting.popleft())
        finally:
            for worker in workers:
                worker.end()

    return pool


def cluster(address: str) -> Pool:
    """Return what does tasks on the workers of a running Dask scheduler.

    Workers need the same version of slipfree, and the files that the problem names under the same
    path. A worker does one run at a time, however many threads it has.

    Raises
    ------
    DataError
        By the pool: if distributed is not installed, no scheduler answers, it has no workers, or
        these have another version.
    SlipfreeError
        By the pool: if the scheduler goes away.
    """

    def pool(tasks: Sequence[Task], poll: Poll) -> Generator[Done, None, None]:
        if not tasks:
            return  # a finished sweep needs no cluster
        from slipfree.sweep.worker import work

        with _client(address) as client:
            finished: queue.Queue[Any] = queue.Queue()
            open_tasks = {}
            for task in tasks:
                future = client.submit(work, task, key=f"slipfree-{os.urandom(8).hex()}")
                open_tasks[future.key] = (task, future)
                future.add_done_callback(finished.put)
            try:
                while open_tasks:
                    poll()
                    if client.status != "running":
                        raise _gone(address)
                    try:
                        future = finished.get(timeout=TICK)
                    except queue.Empty:
                        continue
                    task, _ = open_tasks.pop(future.key)
                    yield _result(task, future, address)
            finally:
                with suppress(Exception):  # of a scheduler that may be gone
                    client.cancel([future for _, future in open_tasks.values()])

    return pool


def _result(task: Task, future: Any, address: str) -> Done:
    if future.status == "finished":
        done: Done = future.result()
        return done
    if future.status == "error":
        return without_motion(task, LOST, f"its worker failed ({future.exception()})")
    raise _gone(address)


def _gone(address: str) -> SlipfreeError:
    return SlipfreeError(
        f"--scheduler {address}: the scheduler went away; what is finished is kept, and the same "
        "command with a running scheduler goes on"
    )


def _client(address: str) -> Any:
    """Return a client of a scheduler whose workers are fit for the runs."""
    try:
        from distributed import Client
    except ImportError as error:
        raise DataError(
            "--scheduler needs the package distributed: pip install 'slipfree[cluster]'"
        ) from error
    try:
        with ThreadPoolExecutor(1) as alone:  # a notebook's thread has an event loop of its own
            alone.submit(asyncio.run, _reach(address)).result()
        client = Client(address, timeout=CONNECT, set_as_default=False)
    except Exception as error:  # whatever the transport that the address names raises
        reason = f"{type(error).__name__}: {error}".removesuffix(": ")
        raise DataError(
            f"--scheduler {address}: expected the address of a running Dask scheduler, as in "
            f"tcp://10.0.0.1:8786, found none ({reason}); start one: dask scheduler"
        ) from error
    try:
        _check_workers(client, address)
    except BaseException:
        client.close()
        raise
    return client


async def _reach(address: str) -> None:
    """Connect to a scheduler once: a client that cannot takes 20 s to close, with a traceback."""
    from distributed.comm.core import connect
    from distributed.security import Security

    security = Security().get_connection_args("client")
    async with asyncio.timeout(CONNECT):  # connect itself waits forever for one that hangs
        comm = await connect(address, timeout=CONNECT, **security)
        await comm.close()


def _check_workers(client: Any, address: str) -> None:
    try:
        found = set(client.run(_version).values())
    except Exception as error:  # whatever the workers raise on import
        raise DataError(
            f"--scheduler {address}: expected workers that have slipfree {__version__}, found "
            f"{type(error).__name__}: {error}; install it there"
        ) from error
    if not found:
        raise DataError(
            f"--scheduler {address}: expected workers, found none; start some: "
            f"dask worker {address} --nworkers 4 --nthreads 1"
        )
    if found != {__version__}:
        raise DataError(
            f"--scheduler {address}: expected workers that have slipfree {__version__}, found "
            f"{', '.join(sorted(found))}; install the same everywhere"
        )


def _version() -> str:
    return __version__


def _ended(code: int | None) -> str:
    """Return how a process ended, in words."""
    if code is not None and code < 0:
        name = signal.Signals(-code).name
        return f"signal {name}" + ("; was memory short?" if name == "SIGKILL" else "")
    return f"exit code {code}"


@contextmanager
def _inherited() -> Iterator[None]:
    """Let a new process keep to one thread, and not see Ctrl-C even while it still imports."""
    before = {name: os.environ.get(name) for name in NAMES}
    handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.update(dict.fromkeys(NAMES, "1"))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value
