"""Random and damaged files, read as the commands do: read, refused or mishandled.

``python benchmarks fuzz --cases 10000 [--seed N]`` prints, for every kind of file, how many
cases were read, refused with a clear error that names the file, or ended in a traceback, a warning,
an unclear error, a hang, or the death of the process; also the slowest case and the largest memory.
Cases run in separate processes with limited address space, which are killed if they take too long.
The exit code is 1 if a case was mishandled.

``python benchmarks fuzz --only direct:17 [--seed N]`` repeats one case and keeps its files.
What URDFs and rasters print on standard error is an error too.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from common import apart

from helpers.fuzz_checks import READ, REFUSED, Verdict, judged, judged_silently
from helpers.fuzz_files import KINDS, SILENT_KINDS, drawn
from helpers.fuzz_libraries import LIBRARY_KINDS

SHARES = {"direct": 4, "inverse": 2, "plan": 2, "vehicle": 3, "result": 2}  # others: 2
ALL_KINDS = KINDS | LIBRARY_KINDS | SILENT_KINDS
MEMORY = 6 * 2**30  # of addresses that a process may have [B]
LONGEST = 60.0  # that a case may take, on a busy machine [s]
MAX_SECONDS = 20.0  # CPU time of a case, with the processes that it starts [s]
MAX_RESIDENT = 2**30  # memory of a process [B]
BEGIN = 60.0  # that a process may take to start [s]
BATCH = 100  # cases of a process
DEEP = 0.04  # part of the cases that are solved as well, for a short time
FAULTS = ("traceback", "warning", "unclear", "hang", "death", "print", "slow", "memory")
HEAD = f"{'kind':15}{'cases':>7}{'read':>7}{'refused':>9}" + "".join(
    f"{n + 's':>12}" for n in FAULTS
)


@dataclass
class Tally:
    """Outcomes of the cases of a kind."""

    counts: Counter[str] = field(default_factory=Counter)
    slowest: tuple[float, int] = (0.0, 0)
    memory: int = 0
    faults: dict[str, tuple[int, str]] = field(default_factory=dict)

    def add(self, number: int, name: str, words: str, seconds: float) -> None:
        """Count a case, and keep the first case of each error."""
        self.counts[name] += 1
        self.slowest = max(self.slowest, (seconds, number))
        if name in FAULTS:
            self.faults.setdefault(f"{name}: {words[:300]}", (number, name))

    def line(self, kind: str) -> str:
        """Return a line of the table."""
        numbers = [sum(self.counts.values()), self.counts[READ], self.counts[REFUSED]]
        widths = (7, 7, 9)
        cells = "".join(f"{n:>{w}}" for n, w in zip(numbers, widths, strict=True))
        cells += "".join(f"{self.counts[name]:>12}" for name in FAULTS)
        seconds, number = self.slowest
        return f"{kind:15}{cells}{seconds:>9.2f} s (case {number}){self.memory / 1e6:>8.0f} MB"


def one(kind: str, number: int, seed: int, folder: Path) -> Verdict:
    """Return the outcome of a case."""
    rng = Random(f"{seed}-{kind}-{number}")
    if kind in SILENT_KINDS:
        with tempfile.TemporaryDirectory() as told:
            return judged_silently(drawn(kind, rng), folder, Path(told) / "stderr")
    return judged(drawn(kind, rng), folder, deep=rng.random() < DEEP)


def run_cases(kind: str, first: int, last: int, seed: int) -> list[list[object]]:
    """Return number, outcome, message, time [s] and peak memory [B] of cases of a kind."""
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    found, printed = list[list[object]](), [os.dup(stream) for stream in (1, 2)]
    with Path(os.devnull).open("w") as nothing:
        for stream in (1, 2):  # libraries print there
            os.dup2(nothing.fileno(), stream)
        for number in range(first, last):
            begin, before, above = time.perf_counter(), *_used()
            with tempfile.TemporaryDirectory() as folder:
                verdict = one(kind, number, seed, Path(folder))
            cpu, peak = _used()
            if cpu - before > MAX_SECONDS:
                verdict = Verdict("slow", f"{cpu - before:.1f} s of CPU time")
            elif peak > MAX_RESIDENT > above:
                verdict = Verdict("memory", f"{peak / 1e9:.2f} GB")
            found.append([number, *verdict, time.perf_counter() - begin, peak])
        for stream, kept in zip((1, 2), printed, strict=True):
            os.dup2(kept, stream)
    return found


def _used() -> tuple[float, int]:
    """Return the CPU time [s] and the largest memory [B] of this process and its children."""
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    seconds = sum(each.ru_utime + each.ru_stime for each in both)
    return seconds, 1024 * max(each.ru_maxrss for each in both)


def run_batch(kind: str, first: int, last: int, seed: int, tally: Tally) -> None:
    """Count cases that run in a separate process; halve the batch after a hang or a death."""
    wait = BEGIN + LONGEST + 2.0 * (last - first)
    try:
        found = apart(run_cases, kind, first, last, seed, timeout=wait)
    except subprocess.SubprocessError as error:
        if last - first > 1:
            middle = (first + last) // 2
            run_batch(kind, first, middle, seed, tally)
            run_batch(kind, middle, last, seed, tally)
            return
        name = "hang" if isinstance(error, subprocess.TimeoutExpired) else "death"
        tally.add(first, name, str(error).rpartition("]")[2], 0.0)
        return
    for number, name, message, seconds, peak in found:
        tally.add(number, name, message, seconds)
        tally.memory = max(tally.memory, peak)


def kind_of_cases(kind: str, count: int, seed: int) -> Tally:
    """Return the outcomes of cases of a kind."""
    tally = Tally()
    for first in range(0, count, BATCH):
        run_batch(kind, first, min(first + BATCH, count), seed, tally)
    return tally


def shared(cases: int, kinds: list[str]) -> dict[str, int]:
    """Return the number of cases of each kind."""
    parts = {kind: SHARES.get(kind, 2) for kind in kinds}
    counts = {kind: cases * part // sum(parts.values()) for kind, part in parts.items()}
    counts[kinds[0]] += cases - sum(counts.values())
    return counts


def main() -> int:
    """Run all kinds, and print a table."""
    parser = argparse.ArgumentParser(description="Fuzz the readers.")
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kinds", default=",".join(ALL_KINDS), help="which, with commas between")
    parser.add_argument("--only", metavar="KIND:NUMBER")
    asked = parser.parse_args()
    if asked.only:
        kind, number = asked.only.split(":")
        folder = Path(tempfile.mkdtemp(prefix="fuzz-"))
        print(one(kind, int(number), asked.seed, folder), folder)
        return 0
    return table(asked.cases, asked.seed, asked.kinds.split(","))


def table(cases: int, seed: int, kinds: list[str]) -> int:
    """Print the outcomes of cases; return 1 if any is an error."""
    print(f"seed {seed}; a process may have {MEMORY / 2**30:g} GiB of addresses")
    print(f"{HEAD}  slowest              memory")
    total, begin, bad = Tally(), time.perf_counter(), []
    for kind, count in shared(cases, kinds).items():
        found = kind_of_cases(kind, count, seed)
        print(found.line(kind), flush=True)
        total.counts += found.counts
        total.slowest = max(total.slowest, found.slowest)
        total.memory = max(total.memory, found.memory)
        bad += [f"  {kind}:{number} {words}" for words, (number, _) in found.faults.items()]
    print(total.line("all"))
    wrong = sum(total.counts[name] for name in FAULTS)
    print(
        f"{wrong} faults of {sum(total.counts.values())} cases, {time.perf_counter() - begin:.0f} s"
    )
    print("\n".join(bad))
    return 1 if wrong else 0
