"""Fuzz every reader with bytes that are mutated towards unvisited code; requires atheris.

``python benchmarks/fuzz_guided.py [KIND] [RUNS]`` (urdf and 20000 by default) begins with files of
a kind of `benchmarks/fuzz.py` and prints how many were read, refused with a clear error, or
mishandled. The exit code is 1 if any was mishandled. Atheris comes with ``slipfree[bench]``.
"""

from __future__ import annotations

import os
import sys
import tempfile
from collections import Counter
from pathlib import Path
from random import Random

import atheris

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
with atheris.instrument_imports(include=["slipfree"]):
    from helpers.fuzz_checks import READ, REFUSED, judged
    from helpers.fuzz_files import drawn

SEEDS = 50  # files to begin with
LONGEST = 30  # that a file may take [s]
MEMORY = 4000  # [MB]


def guided(kind: str, runs: int) -> None:
    """Pass fuzzed files of a kind to a reader, and exit with the outcomes."""
    folder, corpus = Path(tempfile.mkdtemp()), Path(tempfile.mkdtemp())
    model = drawn(kind, Random(0))
    for seed in range(SEEDS):
        case = drawn(kind, Random(seed))
        (corpus / str(seed)).write_bytes(case.files[case.main])
    counts, faults = Counter[str](), Counter[str]()

    def one(data: bytes) -> None:
        files = {**model.files, model.main: data}
        found = judged(model._replace(files=files), folder)
        counts[found.name] += 1
        if found.name not in (READ, REFUSED):
            faults[found.words[-200:]] += 1
            (folder / f"fault-{len(faults)}").write_bytes(data)
        if counts.total() == runs:
            print(f"{kind}: {runs} files, {dict(counts)}")
            print("\n".join(f"  {n} x {words}" for words, n in faults.most_common()), folder)
            sys.stdout.flush()
            os._exit(1 if faults else 0)

    words = [f"-timeout={LONGEST}", f"-rss_limit_mb={MEMORY}", "-max_len=40000", "-verbosity=0"]
    atheris.Setup([sys.argv[0], *words, str(corpus)], one)
    atheris.Fuzz()


if __name__ == "__main__":
    asked = [*sys.argv[1:], *("urdf", "20000")[len(sys.argv) - 1 :]]
    guided(asked[0], int(asked[1]))
