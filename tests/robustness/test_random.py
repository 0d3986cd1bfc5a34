"""Tests that random problems end regularly; ``benchmarks random_runs problems`` runs 500.

``python benchmarks random_runs problems --seed N`` prints a case in full and allows changes to it.
"""

import pytest

from helpers.random_cases import draw, outcome

pytestmark = pytest.mark.slow

SEEDS = {"complete": (124, 160, 202, 308), "stopped": (36, 52, 131, 257), "refused": (7, 208)}


@pytest.mark.parametrize(
    ("kind", "seed"), [(kind, seed) for kind, seeds in SEEDS.items() for seed in seeds]
)
def test_a_random_problem_ends_as_it_should(kind, seed, capfd):
    found = outcome(draw(seed))
    assert found.faults == []
    assert found.kind == kind, found.words
    assert "".join(capfd.readouterr()) == ""
