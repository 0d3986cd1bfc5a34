"""Studies: computations in parts, such as runs and tiles, kept in a folder where they continue.

The first line of the log describes the computation, and each other line a finished part, in JSON
and synchronised to disk. Lines and files that were damaged, truncated or exchanged do not match
their digests: their parts are computed again.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from hashlib import sha256
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Generic, NamedTuple, Self, TypeVar

from slipfree.core.errors import DataError, WriteError, shortened
from slipfree.system.interrupt import interrupt_requested
from slipfree.system.processes import Poll, Pool, finish_tasks, local_tasks
from slipfree.system.regular_files import TEMPORARY, check_name, digest, replace_file

try:
    import fcntl
except ImportError:  # Windows has no such lock: the user must avoid two computations at a time
    fcntl = None  # type: ignore[assignment]

LOG = "parts.jsonl"
PART, KEY, FILE, DIGEST = "part", "key", "file", "sha256"  # keys of the line of a part
ANOTHER_FOLDER = "choose another folder with -o"
T = TypeVar("T")
D = TypeVar("D")
Workers = int | Callable[[Callable[..., Any]], Pool[Any, Any]]  # their number, or a maker of pools


class Identity(NamedTuple):
    """Identity of a computation, whose finished parts have the numbers from 1 to ``size``."""

    kind: str  # as in "sweep"
    size: int  # number of parts
    head: Mapping[str, Any]  # equal for computations whose parts may be mixed
    words: Mapping[str, str] = {}  # descriptions of the keys of the head in messages


class Parts(Generic[D]):
    """The open folder of a computation with its finished parts; a context manager.

    Subclasses define how the result of a part is stored and loaded.

    Parameters
    ----------
    folder : Path
        The folder; made if it is missing.
    identity : Identity
        The computation.
    ending : str, optional
        Ending of the files of parts, as in ``".npy"``; by default a part has no file.
    check : callable, optional
        Called before a part is added; raises an error if parts would not fit together.

    Raises
    ------
    DataError
        If the log is used by another process, or belongs to another computation; as `WriteError`,
        if it cannot be written.
    """

    def __init__(
        self,
        folder: Path,
        identity: Identity,
        ending: str = "",
        check: Callable[[], None] = lambda: None,
    ) -> None:
        self.folder, self._identity, self._ending = folder, identity, ending
        self._check_inputs = check
        self._log = folder / LOG
        self._offsets: dict[int, int] = {}  # byte at which the line of a part begins
        self._keys: dict[int, str] = {}
        check_name(folder)
        if self._log.exists() and not self._log.is_file():
            raise DataError(
                f"{self._log}: expected a log of finished parts, found no regular file; "
                f"{ANOTHER_FOLDER}, or remove it"
            )
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._stream: IO[bytes] = self._log.open("a+b")
        except OSError as error:
            raise self._unwritable(error) from error
        try:
            if fcntl is not None:  # until the log is closed or this process ends
                try:
                    fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except OSError as error:
                    raise DataError(
                        f"{self._log}: expected a log that no other process writes, found one in "
                        f"use; wait until the other {identity.kind} ends, or {ANOTHER_FOLDER}"
                    ) from error
            for file in folder.glob(TEMPORARY):  # of a killed process: the lock excludes others
                file.unlink(missing_ok=True)
            self._read()
        except BaseException:
            self.close()
            raise

    def __len__(self) -> int:
        """Return the number of finished parts."""
        return len(self._offsets)

    def __contains__(self, number: int) -> bool:
        """Return whether a part is finished."""
        return number in self._offsets

    @property
    def finished(self) -> list[int]:
        """Numbers of the finished parts, in ascending order."""
        return sorted(self._offsets)

    @property
    def missing(self) -> list[int]:
        """Numbers of the parts that are not finished, in ascending order."""
        return [k for k in range(1, self.size + 1) if k not in self._offsets]

    @property
    def size(self) -> int:
        """Number of all parts."""
        return self._identity.size

    def store(self, number: int, result: D) -> None:
        """Store the result of a part by `add`."""
        raise NotImplementedError

    def load(self, number: int) -> D:
        """Return the result of a finished part."""
        raise NotImplementedError

    def record(self, number: int) -> dict[str, Any]:
        """Return the record of a finished part, as given to `add`."""
        line = self._line(number)
        return {key: value for key, value in line.items() if key not in (PART, KEY, FILE, DIGEST)}

    def file(self, number: int) -> Path:
        """Return the path of the file of a part."""
        return self.folder / f"part_{number:06}{self._ending}"

    def is_whole(self, number: int, written: str | None) -> bool:
        """Return whether the file of a part has the digest with which it was written, if any."""
        return written is None or written == digest(self.file(number))

    def add(
        self, number: int, record: Mapping[str, Any], fill: Callable[[Path], object] | None = None
    ) -> None:
        """Store a part: its file, written by ``fill`` if it has one, and its record."""
        self._check_inputs()
        if fill is not None:
            replace_file(self.file(number), fill)
        elif self._ending:
            self.file(number).unlink(missing_ok=True)
        found = None if fill is None else digest(self.file(number))
        line = {PART: number, KEY: self._keys.get(number, ""), FILE: found, **record}
        self._offsets[number] = self._write(line | {DIGEST: _digest(line)})

    def expect(self, number: int, key: str) -> None:
        """Set the key of the task of a part; a finished part with another key is then missing."""
        if key:
            self._keys[number] = key
        if key and number in self and self._line(number).get(KEY) != key:
            self.discard(number)

    def discard(self, number: int) -> None:
        """Forget a part, which is then missing, if it is finished."""
        self._offsets.pop(number, None)

    def remove(self) -> None:
        """Remove the log, the files of all parts, and the folder unless it has other files."""
        files = map(self.file, range(1, self.size + 1)) if self._ending else ()
        for file in (*files, self._log):
            with suppress(OSError):  # something else of this name remains
                file.unlink()
        self.close()
        with suppress(OSError):
            self.folder.rmdir()

    def close(self) -> None:
        """Close the log, which releases its lock."""
        with suppress(OSError):  # the error of the write was reported
            self._stream.close()

    def __enter__(self) -> Self:
        """Return the parts."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the log, and remove it after an error without any finished part."""
        if error is not None and not self._offsets:
            self.remove()
        self.close()

    def _line(self, number: int) -> dict[str, Any]:
        with self._log.open("rb") as stream:
            stream.seek(self._offsets[number])
            line: dict[str, Any] = json.loads(stream.readline())
        return line

    def _read(self) -> None:
        """Read the log, remove an incomplete line at its end, and begin it if it is empty."""
        self._stream.seek(0)
        offset = 0
        for line in self._stream:
            if not line.endswith(b"\n"):
                self._stream.truncate(offset)
                break
            record: Any = None
            with suppress(ValueError, RecursionError):  # a damaged line
                record = json.loads(line)
            record = record if isinstance(record, dict) else {}
            number = record.get(PART)
            if not offset:
                self._check(record)
            elif (
                isinstance(number, int)
                and 1 <= number <= self.size
                and record.pop(DIGEST, None) == _digest(record)
                and self.is_whole(number, record.get(FILE))
            ):
                self._offsets[number] = offset
            offset += len(line)
        if not offset:
            self._write(self._identity.head)

    def _check(self, found: Mapping[str, Any]) -> None:
        """Raise DataError unless a log describes the same computation."""
        kind, _, head, known = self._identity
        if not found:
            raise DataError(
                f"{self._log}:1: expected the description of a {kind} in JSON, found something "
                f"else; {ANOTHER_FOLDER}, or remove this file"
            )
        for key, value in head.items():
            if (old := found.get(key)) != value:
                words = ": {}, now {}".format(*(shortened(json.dumps(v), 60) for v in (old, value)))
                if isinstance(old, dict) and isinstance(value, dict):  # files, or varied keys
                    names = [n for n in {**old, **value} if n and old.get(n) != value.get(n)]
                    words = f": {', '.join(names)}" if names else ""
                raise DataError(
                    f"{self._log}: expected results of this {kind}, found some with another "
                    f"{known.get(key, key)}{words}; {ANOTHER_FOLDER}, or remove this file"
                )

    def _write(self, line: Mapping[str, Any]) -> int:
        """Write a line of JSON; return the byte at which it begins; raise DataError on failure."""
        try:
            offset = self._stream.seek(0, os.SEEK_END)
            self._stream.write(json.dumps(line).encode() + b"\n")
            self._stream.flush()
            os.fsync(self._stream.fileno())
        except OSError as error:
            raise self._unwritable(error) from error
        return offset

    def _unwritable(self, error: OSError) -> WriteError:
        return WriteError(
            f"{self._log}: cannot be written ({error.strerror}); free disk space or "
            f"{ANOTHER_FOLDER}; finished parts are kept"
        )


class PartsWatch(NamedTuple):
    """Callbacks during a study."""

    # called several times per second; ends the study by an exception
    poll: Poll = lambda: None
    # called with the numbers of finished and of all parts, or of those of the call without a
    # folder, first and after every part
    progress: Callable[[int, int], None] = lambda _, __: None


@contextmanager
def study(
    function: Callable[[T], D],
    parts: Parts[D] | None = None,
    workers: Workers = 1,
    *,
    here: Callable[[T], D] | None = None,
    lost: Callable[[T, str], D] | None = None,
    watch: PartsWatch = PartsWatch(),
) -> Iterator[Callable[..., Iterator[tuple[int, D]]]]:
    """Yield a function that computes parts of a study, for several calls.

    The function takes the numbers of parts, a function that returns the task of a number when it
    can begin, and optionally one that returns its key, see `Parts.expect`. It yields numbers and
    results: first those which ``parts`` has, then the others in the order of completion, each as
    soon as it is stored.

    Parameters
    ----------
    function : callable
        Returns the result of a task; at module level.
    parts : Parts, optional
        Where results are stored and found.
    workers : int or callable
        Number of processes, see `local_tasks`; or returns a pool that calls the function which it
        is given. The pool is opened if parts are missing.
    here, lost : callable, optional
        See `local_tasks` and `finish_tasks`.
    watch : PartsWatch, optional
        Callbacks.
    """
    poll, progress = watch
    call, own = partial(_numbered, function), here and partial(_numbered, here)
    with ExitStack() as stack:
        if isinstance(workers, int):
            finish = stack.enter_context(local_tasks(call, workers, own))
        elif parts is None or parts.missing:
            pool = stack.enter_context(closing(workers(call)))
            lose = lost and partial(_lost, lost)

            def finish(tasks: Iterable[tuple[int, T]], poll: Poll) -> Iterator[tuple[int, D]]:
                return finish_tasks(tasks, pool, poll, lose)

        def run(
            numbers: Iterable[int],
            task: Callable[[int], T],
            key: Callable[[int], str] = lambda _: "",
        ) -> Iterator[tuple[int, D]]:
            """Yield results of numbered tasks, stored or computed; store those that are computed.

            ``key`` returns a text that must be equal for a stored result to be used.
            """
            missing = [*numbers]
            done, count = 0, len(missing)
            if parts is not None:
                for k in missing:
                    parts.expect(k, key(k))
                done, count = len(parts), parts.size
            progress(done, count)
            if parts is not None:
                yield from ((k, parts.load(k)) for k in missing if k in parts)
                missing = [k for k in missing if k not in parts]
            for number, result in finish(((k, task(k)) for k in missing), poll) if missing else ():
                if parts is not None:
                    parts.store(number, result)
                done += 1
                progress(done, count)
                yield number, result

        yield run


def until_interrupt(results: Iterable[D]) -> list[D]:
    """Return the results of a study, those so far if Ctrl-C is held back by `held_interrupt`.

    KeyboardInterrupt is raised if there are none.
    """
    finished = list[D]()
    try:
        for result in results:
            finished.append(result)
    except KeyboardInterrupt:
        if not (finished and interrupt_requested()):
            raise
    return finished


def _digest(line: Mapping[str, Any]) -> str:
    return sha256(json.dumps(line, sort_keys=True).encode()).hexdigest()


def _numbered(function: Callable[[T], D], numbered: tuple[int, T]) -> tuple[int, D]:
    number, task = numbered
    return number, function(task)


def _lost(lost: Callable[[T, str], D], numbered: tuple[int, T], why: str) -> tuple[int, D]:
    return numbered[0], lost(numbered[1], why)
