"""Pool of the workers of Dask."""

from __future__ import annotations

import asyncio
import os
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any, Generic, TypeVar

from slipfree.core.errors import DataError, SlipfreeError, require
from slipfree.core.version import __version__
from slipfree.system.processes import ProcessDiedError

CONNECT = 10.0  # timeout for the connection to a scheduler [s]
PATIENCE = 1.0  # time between checks of the number of workers [s]
NONE_LEFT = "no workers are left; waiting for workers (Ctrl-C ends the computation)"
BACK = "workers are available again; the computation continues"
AHEAD = 2  # tasks per worker, so that it need not wait for the next one


T = TypeVar("T")
D = TypeVar("D")


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
        try:
            with ThreadPoolExecutor(1) as alone:  # a notebook already runs an event loop
                alone.submit(asyncio.run, _reach(address)).result()
            client = distributed.Client(address, timeout=CONNECT, set_as_default=False)
        except Exception as error:  # its class depends on the transport
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
            f"--scheduler {self._address}: the connection to the scheduler is lost; what is "
            "finished is kept; start a scheduler and repeat the command to continue"
        )


async def _reach(address: str) -> None:
    """Check that a scheduler accepts a connection.

    A Dask client that cannot connect takes 20 s to close, and prints a traceback.
    """
    from distributed.comm.core import connect
    from distributed.security import Security

    security = Security().get_connection_args("client")
    async with asyncio.timeout(CONNECT):  # connect itself waits forever for one that hangs
        comm = await connect(address, timeout=CONNECT, **security)
        await comm.close()


def _check_workers(client: Any, address: str) -> None:
    try:
        versions = set(client.run(_version).values())
    except Exception as error:  # workers can raise any error on import
        raise DataError(
            f"--scheduler {address}: expected workers that have slipfree {__version__}, found "
            f"{type(error).__name__}: {error}; install this version on all workers"
        ) from error
    if not versions:
        raise DataError(
            f"--scheduler {address}: expected workers, found none; start some: "
            f"dask worker {address} --nworkers 4 --nthreads 1"
        )
    if versions != {__version__}:
        raise DataError(
            f"--scheduler {address}: expected workers that have slipfree {__version__}, found "
            f"{', '.join(sorted(versions))}; install the same version on all workers"
        )


def _version() -> str:
    return __version__
