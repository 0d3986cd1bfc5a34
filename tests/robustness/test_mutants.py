"""Tests of mutated URDFs and rasters: each is read or refused without a hang.

``python benchmarks fuzz --cases 2000 --kinds mutated_urdf,mutated_raster`` reads many.
"""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from helpers.fuzz_checks import READ, REFUSED
from helpers.fuzz_mutants import MUTANTS

pytestmark = pytest.mark.slow

COUNT = 30  # mutants that a process reads
TESTS = Path(__file__).parents[1]


@pytest.mark.parametrize("kind", MUTANTS)
def test_mutants_are_read_or_refused(kind: str) -> None:
    command = [sys.executable, "-m", "helpers.fuzz_mutants", kind, "0", str(COUNT)]
    done = subprocess.run(command, cwd=TESTS, capture_output=True, text=True, check=False)
    lines = [json.loads(line) for line in done.stdout.splitlines()]
    last = lines[-1] if lines else None
    assert (done.returncode, done.stderr) == (0, ""), last
    found = [line for line in lines if "name" in line]
    assert len(found) == COUNT
    assert [line for line in found if line["name"] not in (READ, REFUSED)] == []
    assert {line["name"] for line in found} == {READ, REFUSED}
